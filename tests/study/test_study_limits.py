"""Limits of a study: what is named, listed, drawn, kept or refused on either side of each."""

from __future__ import annotations

import tomllib
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from feeddrive.figures import of_loops
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.study import answers, distributions, page, robust, statistics, store, study
from feeddrive.study.statistics import Judged, RankCorrelation

PEAK = of_loops.SENSITIVITY_PEAK
LINES = tuple(map(of_loops.stiffness_at, (5.0, 20.0, 90.0)))
FIGURES = tuple(dict.fromkeys([*LINES, *of_loops.STIFFNESS_OVER, PEAK, of_loops.DELAY_MARGIN]))


def stated(**fields: Any) -> Any:
    """The settings of a study that are read here."""
    usual = {"specification": (), "sampler": "monte_carlo", "count": 10, "points": 10, "seed": 1, "measure": (PEAK,)}
    return SimpleNamespace(**{**usual, "columns": {}, "vary": (), **fields})


def machines(count: int, of: Any = None, varied: Any = None, bad: bool = False) -> Judged:
    of = of or stated(count=count)
    values = np.arange(1.0, count + 1.0)
    reasons = np.full(count, "no" if bad else None, dtype=object)
    return Judged(of, np.arange(count), varied or {}, {figure.key: values for figure in of.measure}, reasons)


def ranks(values: list[float], name: str = "f{}") -> list[RankCorrelation]:
    return [RankCorrelation(PEAK.key, name.format(i), value, None) for i, value in enumerate(values)]


# what is named and drawn


@pytest.mark.parametrize(("value", "named"), [(0.2, False), (0.25, True)])
def test_a_factor_with_a_twentieth_of_the_variance_is_named(value: float, named: bool) -> None:
    """The square of a rank correlation is its share: 4 % and 6 %."""
    assert bool(answers._goes_with(PEAK, ranks([value]), {"f0": "mass"})) == named


def test_a_sentence_names_three_factors() -> None:
    found = ranks([0.9, 0.8, 0.7, 0.6, 0.5, 0.4])
    text = answers._goes_with(PEAK, found, {rank.column: f"<{rank.column}>" for rank in found})[0]
    assert [name for name in ("<f0>", "<f1>", "<f2>", "<f3>") if name in text] == ["<f0>", "<f1>", "<f2>"]


@pytest.mark.parametrize(("count", "all_drawn"), [(8, True), (20, False)])
def test_a_page_has_histograms_of_a_dozen_figures(count: int, all_drawn: bool) -> None:
    figures = tuple(replace(PEAK, key=f"figure_{i}") for i in range(count))
    panels = answers.histograms_chart(machines(20, stated(measure=figures))).panels
    assert (len(panels) == count) == all_drawn


def test_sensitivities_are_those_of_four_outputs() -> None:
    bounds = tuple(SimpleNamespace(figure=figure) for figure in FIGURES)
    assert answers._outputs(stated(specification=bounds[:3])) == [*(f.key for f in FIGURES[:3]), statistics.INSIDE]
    assert len(answers._outputs(stated(specification=bounds[:6]))) == 4


def test_sensitivities_are_those_of_eight_factors() -> None:
    assert [len(answers._correlations(ranks([0.5] * n)).ticks) for n in (8, 12)] == [8, 8]


@pytest.mark.parametrize(("letters", "whole"), [(25, True), (45, False)])
def test_a_factor_is_written_with_up_to_thirty_letters(letters: int, whole: bool) -> None:
    name = "m" * letters
    (tick,) = answers._correlations(ranks([0.5], name)).ticks
    assert (tick.name == name) == whole


@pytest.mark.parametrize(("count", "cut"), [(30, False), (60, True)])
def test_a_table_of_the_front_has_forty_machines(count: int, cut: bool) -> None:
    rows = machines(count)
    table = page._front(SimpleNamespace(front=statistics.Front({"robustness": PEAK}, rows), study=rows.study))  # type: ignore[arg-type]
    assert table is not None
    assert (len(table.rows) < count) == cut == ("the first" in table.title)


@pytest.mark.parametrize(("bad", "files"), [(2, 2), (6, 3)])
def test_three_machines_without_figures_are_written_as_jobs(
    bad: int, files: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("study_report", "html", "summary", "summary_text"):
        monkeypatch.setattr(page, name, lambda *_, **__: "")
    monkeypatch.setattr(page, "replay_files", lambda _, variant: {f"{variant}.toml": ""})
    several = tuple((variant, "no") for variant in range(bad))
    found = SimpleNamespace(worst=(), bad=several, study=None, rotary=False, quoted=())
    assert sum(name.startswith("worst/") for name, _ in page.report_files(found)) == files  # type: ignore[arg-type]


# points of the samplers: rows of a sweep that goes on under a newer version must be those of the same points


def test_every_1024_variants_share_a_counter_of_philox() -> None:
    key = np.random.SeedSequence((7, 0)).generate_state(2, np.uint64)
    second = np.random.Generator(np.random.Philox(counter=[0, 0, 0, 1], key=key)).random((1, 3))
    assert np.array_equal(distributions.uniform((7, 0), 1024, 1, 3), second)


def test_sobol_points_are_the_centers_of_2_to_the_30_cells() -> None:
    at = distributions.sobol((7, 0), 4, 4, 3) * 2.0**31
    assert np.array_equal(at % 2.0, np.ones((4, 3)))


def test_a_permutation_is_a_feistel_network_of_six_rounds() -> None:
    """In plain integers, of 16 numbers: two halves of two bits."""
    keys = np.random.SeedSequence((1, 2)).generate_state(6, np.uint64).tolist()

    def image(number: int) -> int:
        left, right = divmod(number, 4)
        for key in keys:
            left, right = right, left ^ int(distributions._mixed(np.array([right ^ key], dtype=np.uint64))[0]) % 4
        return 4 * left + right

    found = distributions.permuted(np.arange(16, dtype=np.uint64), 16, (1, 2))
    assert found.tolist() == [image(number) for number in range(16)]


@pytest.mark.parametrize(("nearest", "accepted"), [(5.0, True), (7.0, False)])
def test_a_range_is_within_six_deviations(nearest: float, accepted: bool) -> None:
    """Beyond 5 deviations are 3e-7 of a normal distribution, beyond 7 are 1e-12, below the 1e-9 of the message."""
    if accepted:
        distributions.Normal(0.0, 1.0, nearest, 10.0)
    else:
        with pytest.raises(ParameterError, match="less than 1e-9 of it"):
            distributions.Normal(0.0, 1.0, nearest, 10.0)


# robust tuning


def test_a_violation_of_two_thousandths_is_kept() -> None:
    assert robust.Merits(np.zeros(2), np.array([0.0015, 0.003])).kept.tolist() == [True, False]


def test_a_violation_of_one_percent_outweighs_a_goal_a_thousand_times_as_large() -> None:
    severity = robust.Merits(np.array([0.0, np.log(1000.0)]), np.array([0.012, 0.0])).severity
    assert severity[0] > severity[1]


@pytest.mark.parametrize(("samples", "accepted"), [(4000, True), (6000, False)])
def test_five_thousand_machines_are_held_in_memory(
    samples: int, accepted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Drawn(Exception):  # noqa: N818
        pass

    def drawn(*_: Any) -> None:
        raise Drawn

    monkeypatch.setattr(robust, "_require_axis", lambda _: None)
    monkeypatch.setattr(robust, "variants", drawn)
    with pytest.raises(Drawn if accepted else ParameterError):
        robust.scenarios(stated(count=10_000), samples, Progress())


def search(goals: Any, count: int, monkeypatch: pytest.MonkeyPatch) -> tuple[list[int], str]:
    """The number of machines in each round, and why the search is unsettled, with the goals of each round."""
    tuner = SimpleNamespace(
        share=1.0,
        sample=SimpleNamespace(points=[None] * count),
        starts=2,
        judged=lambda control: robust.Merits(np.array(goals(control)), np.full(count, -1.0)),
    )
    monkeypatch.setattr(
        robust._Search, "_tuned", lambda self, *_: SimpleNamespace(control=len(self.rounds) + 1, unsettled="")
    )
    found = robust._Search(tuner)  # type: ignore[arg-type]
    unsettled = found.run(0)[1]  # type: ignore[arg-type]
    return [active for active, _ in found.rounds], unsettled


@pytest.mark.parametrize(("joining", "settles"), [(10, True), (22, False)])
def test_a_search_has_sixteen_rounds(joining: int, settles: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """One machine joins per round, each by far the worst in its round."""

    def goals(control: int) -> list[float]:
        return [1.0 if machine == control <= joining else 0.0 for machine in range(30)]

    assert (search(goals, 30, monkeypatch)[1] == "") == settles


@pytest.mark.parametrize(("worse", "join"), [(2, 2), (6, 3)])
def test_three_machines_join_in_a_round(worse: int, join: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def goals(control: int) -> list[float]:
        return [1.0 if 2 <= machine < 2 + worse and control == 1 else 0.0 for machine in range(20)]

    active = search(goals, 20, monkeypatch)[0]
    assert active[1] - active[0] == join


@pytest.mark.parametrize(("worse", "joins"), [(0.004, False), (0.007, True)])
def test_a_machine_that_is_half_a_percent_worse_joins(
    worse: float, joins: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def goals(control: int) -> list[float]:
        return [worse if machine == 2 and control >= 1 else 0.0 for machine in range(9)]

    active = search(goals, 9, monkeypatch)[0]
    assert (active[1] > active[0]) == joins


def test_fresh_machines_are_those_of_the_second_random_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    """The study itself is of the first one, so that the tuner sees none of the fresh machines."""
    fresh: dict[str, Any] = {}

    def changed(_: Any, **settings: Any) -> Any:
        fresh.update(settings)
        return SimpleNamespace(chunks=0)

    monkeypatch.setattr(robust, "replace", changed)
    monkeypatch.setattr(robust, "with_control", lambda *_: None)
    monkeypatch.setattr(robust, "Engine", lambda _: SimpleNamespace(finished=lambda *_: {}))
    robust.measured(None, None, (), (), 2, 1, Progress())  # type: ignore[arg-type]
    # numbers of the stream, as a study of the same seed draws them in order: 0 for itself, 1 next
    assert fresh["stream"] == study.Study.__dataclass_fields__["stream"].default + 1


# statistics


def test_200_000_rows_are_a_sample_of_300_000() -> None:
    """Each row with the same chance, so within five deviations; all of 150,000 rows."""
    for count, low, high in ((300_000, 592, 741), (150_000, 1000, 1000)):
        sample = statistics.Sampled(stated(count=count))
        sample.add(machines(1000, stated(count=count)))
        assert low <= sample.result().variant.size <= high


@pytest.mark.parametrize(("values", "whole"), [(40, True), (80, False)])
def test_fifty_values_of_a_choice_are_counted(values: int, whole: bool) -> None:
    of = stated(count=values)
    count = statistics.YieldCount(of)
    count.add(machines(values, of, {"law": np.array([f"law {i:02}" for i in range(values)], dtype=object)}))
    assert (len(count.result().choices["law"]) == values) == whole


def test_three_of_the_worst_machines_are_kept() -> None:
    worst = statistics.WorstKept(stated())
    worst.add(machines(7))
    (found,) = worst.result()
    assert [case.value for case in found.cases] == [7.0, 6.0, 5.0]


@pytest.mark.parametrize(("bad", "whole"), [(8, True), (15, False)])
def test_ten_machines_without_figures_are_listed(bad: int, whole: bool) -> None:
    worst = statistics.WorstKept(stated())
    worst.add(machines(bad, bad=True))
    assert (len(worst.bad) == bad) == whole


@pytest.mark.parametrize(("points", "enough"), [(16, False), (32, True)])
def test_sobol_indices_need_32_points(points: int, enough: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statistics, "_RESAMPLES", 9)  # the interval is not looked at
    values = np.random.default_rng(1).random(4 * points)
    assert (statistics.sobol("y", values, ("a", "b")) is not None) == enough


def test_a_band_has_half_and_nine_tenths_of_the_machines() -> None:
    """Of 101 machines with the values 0 to 100 the quantiles are the percentages."""
    of = stated(measure=LINES, count=101)
    band = statistics.stiffness_band(machines(101, of))
    assert band is not None
    assert (band.quantiles[:, 0] - 1.0).tolist() == pytest.approx([5.0, 25.0, 50.0, 75.0, 95.0])


def test_a_band_needs_three_frequencies() -> None:
    assert statistics.stiffness_band(machines(5, stated(measure=LINES[:2]))) is None
    assert statistics.stiffness_band(machines(5, stated(measure=LINES))) is not None


def test_an_error_is_drawn_in_500_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    class Moved(dict[str, np.ndarray]):
        samples, sample_time, time = 5000, 1e-3, np.arange(5000) * 1e-3

    monkeypatch.setattr(statistics, "_run", lambda *_: Moved(following_error=np.ones(5000)))
    band = statistics.error_band(machines(2))
    assert band is not None
    assert np.diff(band.x) == pytest.approx(np.full(499, 5.0 / 500))


# files


@pytest.mark.parametrize(("chunks", "named"), [(90_000_000, True), (110_000_000, False)])
def test_the_name_of_a_chunk_has_eight_digits(chunks: int, named: bool) -> None:
    def manifest() -> store.Manifest:
        return store.Manifest(study="s", digest="d", count=chunks, chunk=1, version="1")

    if named:
        assert manifest().chunks == chunks
    else:
        with pytest.raises(ParameterError, match="chunks have a name"):
            manifest()


@pytest.mark.parametrize("text", ["\x7f", "\U0001f527", 'a "quoted" word', "two\nlines"])
def test_every_text_of_a_replayed_job_is_read_back(text: str) -> None:
    written = f"values = {page._written({text: text, 'on': True, 'mass': 0.1})}"
    assert tomllib.loads(written)["values"] == {text: text, "on": True, "mass": 0.1}


@pytest.mark.parametrize(("lengths", "read"), [((14, 14), 196), ((20, 20), None)])
def test_a_study_reads_up_to_256_jobs(
    lengths: tuple[int, int], read: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Refused(Exception):  # noqa: N818
        pass

    tried = Counter[str]()
    monkeypatch.setattr(study, "_job_file", lambda *_: (None, None))
    monkeypatch.setattr(study, "_job", lambda *_: tried.update(["job"]))
    monkeypatch.setattr(study, "key_of", lambda name: name)
    root = SimpleNamespace(error=lambda *_: Refused())
    choices = [SimpleNamespace(choice=f"c{i}", values=tuple(range(n))) for i, n in enumerate(lengths)]
    if read is None:
        with pytest.raises(Refused):
            study.read_jobs(root, None, None, (), choices)  # type: ignore[arg-type]
    else:
        study.read_jobs(root, None, None, (), choices)  # type: ignore[arg-type]
        assert tried["job"] == read
