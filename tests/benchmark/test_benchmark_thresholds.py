"""Thresholds of the benchmark: a case on either side of each."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from feeddrive.benchmark.benchmark import FIGURES, Benchmark, advice
from feeddrive.benchmark.rules import folder, read_rules
from feeddrive.evaluation.competitor import Competitor
from feeddrive.evaluation.designs import Designs
from feeddrive.evaluation.robustness import Design
from feeddrive.figures import of_runs
from feeddrive.figures.ranking import ROBUST
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import FileError
from feeddrive.plot.registry import chart_of
from feeddrive.tuning.candidates import PLAIN

SNAP = FIGURES[0]


def benchmark(ratio: float) -> Benchmark:
    """P-PI and a law that is better by a ratio, on one plant."""
    figures = {figure.key: 1.0 for figure in FIGURES}
    loop = read_machine("linear_motor").loop("x")
    law = figures | {SNAP.key: (ratio if SNAP.higher else 1.0 / ratio)}
    return Benchmark(
        read_rules(1),
        ("a",),
        (Competitor(PLAIN, loop, figures, plant="a"), Competitor("law", loop, law, plant="a")),
        0,
        {"feeddrive": "0"},
    )


@pytest.mark.parametrize(("ratio", "better"), [(1.015, False), (1.03, True)])
def test_a_law_beats_the_cascade_by_two_percent_or_not_at_all(ratio: float, better: bool) -> None:
    said = str(advice(benchmark(ratio)).sentence)
    assert ("'law' has the least rope-snap error" in said) == better
    assert f"on {0 if better else 1} of 1 plants" in said


@pytest.mark.parametrize(("peak", "said"), [(2.4, False), (math.inf, True)])
def test_the_verdict_says_that_the_best_law_is_unstable_with_wrong_numbers(peak: float, said: bool) -> None:
    found = benchmark(2.0)
    plain, law = found.rows
    law = replace(law, figures={**law.figures, ROBUST.key: peak})
    sentence = str(advice(replace(found, rows=(plain, law))).sentence)
    assert ("unstable on a plant with masses or stiffnesses 20 % off" in sentence) == said


def test_the_picture_has_the_figures_from_the_rope_snap_to_the_error_of_a_cut() -> None:
    """Rope snap, stiffness, tracking and cutting; settling, noise and effort are columns of the table alone."""
    drawn = [panel.caption for panel in chart_of(benchmark(2.0)).panels]
    assert drawn[0].startswith(SNAP.short)
    last = [figure.key for figure in FIGURES].index(of_runs.CUTTING_RMS.key)
    assert len(drawn) == last + 1


@pytest.mark.parametrize(("share", "moved"), [(0.7e-4, False), (1.5e-4, True)])
def test_a_design_is_stale_where_a_figure_moved_by_a_ten_thousandth(share: float, moved: bool) -> None:
    design = Design("law", "plant", 1, figures={SNAP.key: 2.0})
    for sign in (-1.0, 1.0):
        assert bool(design.moved({SNAP.key: 2.0 * (1.0 + sign * share)})) == moved


@pytest.mark.parametrize(("kilobytes", "read"), [(700, True), (1500, False)])
def test_a_design_of_up_to_a_megabyte_is_read(kilobytes: int, read: bool, tmp_path: Path) -> None:
    designs = Designs(tmp_path, "plant", 1)
    designs.write(Design("law", "plant", 1))
    (path,) = (tmp_path / "plant").iterdir()
    path.write_text(path.read_text(encoding="utf-8") + " " * (1000 * kilobytes), encoding="utf-8")
    if read:
        assert designs.design("law") is not None
    else:
        with pytest.raises(FileError, match="more than the"):
            designs.design("law")


def test_the_present_rules_are_the_newest_ones_under_which_every_plant_was_searched() -> None:
    """A change of a number or of a plant is a folder of its own; the newest one with a tuned P-PI is what is scored."""
    versions = [int(path.name.removeprefix("rules_")) for path in folder().parent.glob("rules_*")]

    def whole(version: int) -> bool:
        rules = read_rules(version)
        known = (Designs(rules.designs(), name, version).design(PLAIN) for name in rules.plants)
        return all(design is not None for design in known)

    assert read_rules().version == max(filter(whole, versions))
