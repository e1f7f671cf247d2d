"""The laws of three papers on the measured EMPS axis: what is measured, what is predicted, what is only simulated."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from documented import DOCS, loose
from feeddrive.analysis.replay import replay
from feeddrive.analysis.stability import stability
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.identification.motion.identify import Identified
from feeddrive.identification.regression import Estimate
from feeddrive.language import tree
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.papers import emps as paper
from feeddrive.papers.claims import Claim, Experiment, Reproduced
from feeddrive.papers.covariance_box import Uncertain
from feeddrive.papers.emps import Half, emps, halves, identified, recovered
from feeddrive.workflow.reproduce import ReproduceRequest

command = import_module("feeddrive.workflow.reproduce")  # the package has a command of this name
LOG = Path(__file__).parents[3] / "shared" / "data" / "emps" / "DATA_EMPS.mat"
needs_log = pytest.mark.skipif(not LOG.exists(), reason=f"NOT RUN: the measured log {LOG.name} is not in ../shared")
RAN = read_machine("emps").loop("x")


@cache
def parts() -> tuple[Half, Half, Identified, Uncertain]:
    first, second = halves(LOG, RAN)
    return (first, second, *identified(RAN, first))


def broken(claims: list[Claim]) -> list[tuple[object, ...]]:
    return [(claim.key, claim.claim, claim.shown, claim.bounds) for claim in claims if not claim.holds]


def measured(model: object, second: Half) -> list[Claim]:
    predicted, published = (replay(loop, second.signals, skip=paper.SKIPPED) for loop in (model, RAN))  # type: ignore[arg-type]
    return list(paper._measured_claims(parts()[2], model, predicted, published, second))  # type: ignore[arg-type]


@needs_log
def test_the_half_that_was_not_used_is_predicted_and_a_wrong_model_is_noticed() -> None:
    """Claims 5.a to 5.e; with 3 % more mass, or a tenth less friction, the position is off by more than they allow."""
    _, second, _, box = parts()
    assert not broken(measured(box.model, second))
    path = "axis.x.plant.mass"
    assert broken(measured(tree.vary(box.model, {path: 1.03 * float(tree.get(box.model, path))}), second))
    levels = [f"axis.x.friction_load.{name}" for name in ("coulomb_positive", "coulomb_negative")]
    less = {name: 0.7 * float(tree.get(box.model, name)) for name in levels}
    assert {"5.b", "5.c", "5.e"} & {str(key) for key, *_ in broken(measured(tree.vary(box.model, less), second))}


@needs_log
def test_the_halves_share_no_row_and_their_set_positions_have_no_edge() -> None:
    """12,419 and 12,420 rows; the acceleration of the path is the 0.842 m/s² of its ramps and nothing larger."""
    first, second, *_ = parts()
    assert first.position.size + second.position.size == 24841 - 2
    assert not set(first.position[-3:]) & set(second.position[:3])
    for half in (first, second):
        assert np.max(np.abs(np.asarray(half.reference.acceleration))) < 0.85


@needs_log
def test_the_recovered_force_is_not_that_of_another_mass() -> None:
    """The mass enters by the acceleration: with 20 % less the difference grows beyond what the claim allows."""
    _, second, _, box = parts()
    light = tree.vary(box.model, {"axis.x.plant.mass": 0.8 * 95.3})
    left = []
    for model in (box.model, light):
        force, friction, counted = recovered(model, second)
        left.append(np.std((force - friction)[counted]))
    right, wrong = left
    assert wrong > 1.5 * right


def test_the_box_encloses_the_ellipsoid() -> None:
    """k² is the 95 % quantile of χ²: with two parameters 5.99, so that 95 % of normal draws lie in the ellipsoid."""
    estimates = tuple(
        Estimate(f"axis.x.{name}", value, unit, error, error)
        for name, value, unit, error in (
            ("plant.mass", 95.0, "kg", 0.5),
            ("friction_load.coulomb_positive", 20.0, "N", 1.0),
        )
    )
    box = Uncertain(RAN, estimates)
    assert box.factor == pytest.approx(np.sqrt(5.991), rel=1e-3)
    assert box.mass_share == pytest.approx(np.sqrt(5.991) * 0.5 / 95.0, rel=1e-3)
    places = list(box.places())
    assert len(places) == 2 * (1 + 2**2) + 64
    corner = box.loop(RAN, (1.0, -1.0), 1)
    assert float(tree.get(corner, "axis.x.plant.mass")) == pytest.approx(95.0 + box.factor * 0.5)
    assert float(tree.get(corner, "axis.x.friction_load.coulomb_positive")) == pytest.approx(20.0 - box.factor)
    assert float(corner.axis.actuator.dead_time) == pytest.approx(1e-3)
    # the law keeps the numbers of its design
    assert corner.control == RAN.control


def test_a_law_is_judged_at_its_worst_plant() -> None:
    """The largest Ms is that of one more sample of dead time with the lightest mass, by margins of that loop."""
    estimates = (Estimate("axis.x.plant.mass", 95.154, "kg", 10.0, 10.0),)
    box = Uncertain(RAN, estimates)
    set_position = 0.01 * np.sin(np.linspace(0.0, 3.0, 600)) ** 2
    half = Half(
        "drawn",
        set_position,
        set_position,
        np.zeros(600),
        paper.Recorded(position=set_position, sample_time=1e-3),
        1e-3,
    )
    found = paper.judged("ran", RAN, box, half)
    ends = [box.loop(RAN, (u,), late) for u in (-1.0, 1.0) for late in (0, 1)]
    assert found.peaks[1] == pytest.approx(max(paper.LinearLoop(loop).margins.sensitivity_peak for loop in ends))
    assert found.peaks[1] > 1.2 * found.peaks[0]
    assert found.slowest == pytest.approx(
        max(stability(loop, velocity=v).growth for loop in ends for v in (-0.05, 0.05))
    )
    assert found.follows[1] >= found.follows[0] > 0.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"paper": "emps"}, r"emps needs its measured log: feeddrive reproduce emps --log DATA_EMPS\.mat"),
        (
            {"paper": "wu2017", "log": Path("a.mat")},
            r"--log is the measured log of emps or bench, and 'wu2017' has none",
        ),
    ],
)
def test_the_measured_axis_and_its_log_go_together(words: dict[str, object], said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        ReproduceRequest(**words)  # type: ignore[arg-type]


def test_as_many_samples_are_skipped_as_in_the_bundled_job() -> None:
    section = read_job("emps_log").log
    assert section is not None
    assert section.skip_samples == paper.SKIPPED


@needs_log
def test_a_log_on_another_clock_is_refused() -> None:
    with pytest.raises(LogError, match=r"one sample takes 0\.001 s, and the control of EMPS runs every 0\.0005 s"):
        halves(LOG, replace(RAN, sample_time=0.0005))


def test_the_command_writes_the_report_and_fails_with_a_claim(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    claim = Claim("5.a", "it is small", "alone", 2.0, most=1.0, unit="um")
    monkeypatch.setattr(paper, "emps", lambda log, _: Experiment("emps", log.name, "Somebody 2019", [claim]))
    outcome = command.reproduce.run(command.ReproduceRequest("emps", log=LOG, out=tmp_path / "out"), Progress())
    assert outcome.judgment is Judgment.CLAIM_FAILS
    assert LOG.name in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert [paper.name for paper in outcome.result] == ["emps"]


@needs_log
@pytest.mark.slow(reason="seven laws at 130 plants each; the parts of it are tested above")
@pytest.mark.pictures
def test_every_claim_holds_and_the_page_has_its_figures() -> None:
    found = emps(LOG, Progress())
    assert len(found.claims) == 16
    assert not broken(list(found.claims))
    assert not loose(found.claims)
    # every figure of a law but the one that ran is said to be simulated
    for claim in found.claims:
        if claim.key not in {"5.a", "5.b", "5.c", "5.d", "5.e", "5.j", "5.m", "5.n"}:
            assert paper.UNMEASURED in claim.rule, claim.key
    page = Reproduced(found).page
    assert "Nothing was measured under the laws" in page
    assert page.count("<svg") >= 2
    documented = (DOCS / "explanation" / "measured_axis.md").read_text(encoding="utf-8")
    rows = [*found.tables[0].grid().rows, *found.tables[1].grid().rows]
    shown = re.findall(r"(?m)^\| (.+) \|$", documented)
    for row in rows:
        assert any(row_of(line) == list(map(str, row)) for line in shown), row


def row_of(line: str) -> list[str]:
    """The cells of a row of a page, without emphasis and marks of code."""
    return [cell.strip().strip("`*") for cell in line.split(" | ")]
