"""Answers of a study: intervals that cover, indices that are known, worst machines that run again, fronts, the page."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as arrow
import pytest
from scipy import stats

from feeddrive.files.job import read_job
from feeddrive.jobs.run_laws import numbers, run_laws
from feeddrive.language.errors import ParameterError
from feeddrive.report.page import html
from feeddrive.study import distributions as points
from feeddrive.study import statistics as sampled
from feeddrive.study.answers import Answers, answers_of, short
from feeddrive.study.chunk import run_chunk
from feeddrive.study.page import report_files, study_report, write_report
from feeddrive.study.statistics import (
    INSIDE,
    QUANTILES,
    Sampled,
    Share,
    YieldCount,
    clopper_pearson,
    front,
    judged,
    parts,
    rank_correlations,
    sobol,
)
from feeddrive.study.study import Study, read_study

# A mass on a guideway under P-P control, pushed by 100 N: it is off by F / (Kp Kv) at the end, and never by more, since
# its poles are real: Kp > 4 m Kv.
MACHINE = """
sample_time_us = 100
[axis.x.plant]
kind = "rigid"
mass = 10
[axis.x.encoder_load]
kind = "encoder"
noise = 1e-12
[axis.x.control.law]
kind = "cascade_ppi"
Kv = 100
Kp = 10000
"""
STUDY = """
title = "Stiff <b>or</b> not"
machine = "mass.toml"
sampler = "{sampler}"
count = {count}
chunk = 64
seed = 5
noise = "each"
measure = ["force_peak_N"{more}]

[reference]
kind = "linear_move"
distance = 0
travel_time = 0.15

[load]
kind = "step_force"
force = 100

[specification]
tracking_error_peak_m = {{ most_um = 110 }}

[[vary]]
parameter = "axis.x.control.law.Kv"
least = 60
most = 140

[[vary]]
parameter = "axis.x.control.law.Kp"
kind = "loguniform"
least = 7000
most = 14000
"""
BANDS = ', "stiffness_5_Hz_N_per_m", "stiffness_20_Hz_N_per_m", "stiffness_90_Hz_N_per_m", "sensitivity_peak"'


def read(folder: Path, sampler: str = "monte_carlo", count: int = 40, more: str = "") -> Study:
    (folder / "mass.toml").write_text(MACHINE, encoding="utf-8")
    file = folder / "series.toml"
    file.write_text(STUDY.format(sampler=sampler, count=count, more=more), encoding="utf-8")
    return read_study(file)


def rows(study: Study) -> arrow.Table:
    return arrow.concat_tables([run_chunk(study, number) for number in range(study.chunks)])


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> Answers:
    """Of a study whose figures are all measured."""
    study = read(tmp_path_factory.mktemp("study"), more=BANDS)
    return answers_of(rows(study), study)


@pytest.mark.parametrize(("kept", "of"), [(0, 7), (7, 7), (1, 1), (187, 200), (199, 200), (500, 1000)])
def test_the_interval_is_that_of_clopper_and_pearson(kept: int, of: int) -> None:
    """As scipy finds it by roots, to its tolerance of 1e-12; none machine and all of them in closed form."""
    low, high = clopper_pearson(kept, of)
    other = stats.binomtest(kept, of).proportion_ci(method="exact")
    assert (low, high) == pytest.approx((other.low, other.high), abs=1e-10)
    if kept == of:
        assert (low, high) == pytest.approx((0.025 ** (1.0 / of), 1.0), rel=1e-12)
    assert Share(kept, of, sampled=False).interval is None


def test_the_interval_covers() -> None:
    """Exactly, by a sum over the binomial: never below 95 %, and for the stated sizes at most 98 %.

    Its length makes it conservative where few machines are outside: at 0.99 it is below 98 % from 707 machines on.
    """
    for of in (20, 200, 1000, 3000):
        kept = np.arange(of + 1)
        low, high = clopper_pearson(kept, of)
        for share in (0.2, 0.5, 0.9, 0.99, 0.9992):
            holds = (low <= share) & (share <= high)
            covered = float(stats.binom.pmf(kept[holds], of, share).sum())
            assert covered >= 0.95, (of, share)
            assert covered <= 0.98 or of < 707 or share > 0.99, (of, share)


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99])
def test_2000_studies(share: float) -> None:
    """Of 2,000 studies of 1,000 machines 93 to 98 % have the true share in their interval.

    The exact figures are 95.4, 95.5 and 97.6 %, with a standard deviation of 0.5 % in 2,000 studies.
    """
    kept = np.random.default_rng(15).binomial(1000, share, 2000)
    low, high = clopper_pearson(kept, 1000)
    assert 0.93 <= np.mean((low <= share) & (share <= high)) <= 0.98


def test_the_indices_of_ishigami() -> None:
    """sin x1 + 7 sin² x2 + 0.1 x3⁴ sin x1: all six are within their intervals, on points as a study draws them."""
    count = 1024
    x = np.pi * (2.0 * points.saltelli((3, 0), 0, 5 * count, (1, 1, 1), count) - 1.0)
    values = np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    found = sobol("ishigami", values, ("x1", "x2", "x3"))
    assert found is not None
    # closed form, Ishigami & Homma 1990
    parts = (0.5 * (1.0 + 0.1 * np.pi**4 / 5.0) ** 2, 7.0**2 / 8.0, 0.0, 0.1**2 * np.pi**8 * 8.0 / 225.0)
    total = sum(parts)
    first = np.array(parts[:3]) / total
    whole = np.array([parts[0] + parts[3], parts[1], parts[3]]) / total
    for value, interval, known in (
        (found.first, found.first_interval, first),
        (found.total, found.total_interval, whole),
    ):
        assert np.all((interval[0] <= known) & (known <= interval[1]))
        assert np.all(interval[1] - interval[0] < 0.35)
        assert value == pytest.approx(known, abs=0.05)
    assert list(found.order) == [0, 1, 2]
    assert (found.points, found.without) == (count, 0)
    again = sobol("ishigami", values, ("x1", "x2", "x3"))
    assert again is not None
    assert np.array_equal(again.first_interval, found.first_interval)


def test_bad_points_are_left_out_of_the_indices() -> None:
    """A point counts only with all of its variants; what remains is a power of 2, and too few give nothing."""
    x = points.saltelli((1, 0), 0, 4 * 128, (1, 1), 128)
    values = x[:, 0] + 3.0 * x[:, 1]
    values[5] = np.nan
    values[3 * 128 + 9] = np.inf
    found = sobol("sum", values, ("a", "b"))
    assert found is not None
    assert (found.points, found.without) == (64, 64)
    assert found.first_interval[0, 1] <= 0.9 <= found.first_interval[1, 1]
    values[: 128 - 31] = np.nan
    assert sobol("sum", values, ("a", "b")) is None
    assert sobol("constant", np.ones(512), ("a", "b")) is None


def test_the_indices_of_a_drive(tmp_path) -> None:
    """F / (Kp Kv) is a product: S1 = v1 / (v1 + v2 + v1 v2), with v = E(z²)/E(z)² - 1 of z = 1/Kv and z = 1/Kp."""
    study = read(tmp_path, "saltelli", 128)
    table = rows(study)
    found = answers_of(table, study)
    off = 100.0 / (table.column("axis.x.control.law.Kv").to_numpy() * table.column("axis.x.control.law.Kp").to_numpy())
    # 150 ms are ten times constants of the slowest loop
    assert table.column("tracking_error_peak_m").to_numpy() == pytest.approx(off, rel=1e-3)
    a, b = 60.0, 140.0
    v1 = (1.0 / (a * b)) / (math.log(b / a) / (b - a)) ** 2 - 1.0
    a, b = 7000.0, 14000.0
    log = math.log(b / a)
    v2 = (0.5 * (a**-2 - b**-2) / log) / ((1.0 / a - 1.0 / b) / log) ** 2 - 1.0
    first, total = (
        np.array([v1, v2]) / (v1 + v2 + v1 * v2),
        np.array([v1 * (1 + v2), v2 * (1 + v1)]) / (v1 + v2 + v1 * v2),
    )
    indices = {each.output: each for each in found.sobol}["tracking_error_peak_m"]
    assert indices.factors == ("axis.x.control.law.Kv", "axis.x.control.law.Kp")
    for interval, known in ((indices.first_interval, first), (indices.total_interval, total)):
        assert np.all((interval[0] <= known) & (known <= interval[1]))
    assert indices.first == pytest.approx(first, abs=0.05)
    # rows AB repeat what A and B say: only these are a sample
    assert found.yields.inside.of == 256 < study.count
    kept = off[:256] <= 110e-6
    assert found.yields.inside.kept == int(kept.sum())
    assert {each.output for each in found.sobol} >= {INSIDE}
    assert any("Kv alone decides 6" in each for each in found.sentences)


def test_the_yield_counts_bounds_choices_and_bad_variants(tmp_path) -> None:
    study = read(tmp_path)
    kind = np.array(["a", "b"], dtype=object)[np.arange(40) % 2]
    table = _rows(study, np.where(np.arange(40) < 10, 2e-4, 1e-4), reasons={3: "no", 30: "bad"})
    part = replace(judged(table, study), varied={"row": kind})
    count = YieldCount(study)
    for chosen in (part.variant < 16, part.variant >= 16):
        count.add(part.some(chosen))
    found = count.result()
    assert (found.inside.kept, found.inside.of, found.bad) == (29, 40, 2)
    assert (found.bounds[0].kept.kept, found.bounds[0].alone) == (29, 9)
    assert {name: (each.kept, each.of) for name, each in found.choices["row"].items()} == {"a": (14, 20), "b": (15, 20)}
    assert found.hardest == found.bounds[0]


def _rows(study: Study, error: np.ndarray, reasons: dict[int, str] | None = None) -> arrow.Table:
    """Rows with these errors; those with a reason have no figures."""
    reasons = reasons or {}
    rng = np.random.default_rng(1)
    error = np.where([i in reasons for i in range(error.size)], np.nan, error)
    columns = {"variant": np.arange(error.size), **{name: rng.random(error.size) for name in study.columns}}
    columns |= {each.key: error for each in study.measure}
    return arrow.table(columns | {"reason": arrow.array([reasons.get(i) for i in range(error.size)], arrow.string())})


def test_correlations_of_ranks(tmp_path) -> None:
    """As scipy has them; the interval holds the true value, 0.5 between ranks, in 93 to 97 % of 500 studies."""
    study = read(tmp_path)
    part = judged(_rows(study, np.random.default_rng(2).random(40)), study)
    found = {(each.output, each.column): each for each in rank_correlations(part)}
    for column, values in part.varied.items():
        each = found["force_peak_N", column]
        assert each.value == pytest.approx(stats.spearmanr(values, part.figures["force_peak_N"]).statistic, abs=1e-12)
    rng = np.random.default_rng(4)
    r = 0.6
    true = 6.0 / np.pi * np.arcsin(r / 2.0)  # of the ranks of two normal numbers with the correlation r
    held = 0
    for _ in range(500):
        x = rng.standard_normal(40)
        y = r * x + np.sqrt(1.0 - r * r) * rng.standard_normal(40)
        drawn = replace(part, varied={"x": x}, figures={"y": y}, study=replace(study, specification=()))
        interval = rank_correlations(drawn)[0].interval
        assert interval is not None
        held += interval[0] <= true <= interval[1]
    assert 465 <= held <= 490


def test_the_front_is_that_of_all_pairs() -> None:
    rng = np.random.default_rng(3)
    for m in (2, 3):
        costs = rng.integers(0, 12, (300, m)).astype(float)
        costs[7, 0] = np.nan
        costs[8, 1] = np.inf
        with np.errstate(invalid="ignore"):
            better = (costs[:, None] <= costs[None]).all(axis=2) & (costs[:, None] < costs[None]).any(axis=2)
        wanted = ~better.any(axis=0) & ~np.isnan(costs).any(axis=1)
        assert np.array_equal(front(costs), wanted)


def test_a_sample_of_many_rows(tmp_path, monkeypatch) -> None:
    """Each row with the same chance, and not more of them than wanted but for chance (5 deviations)."""
    study = replace(read(tmp_path), count=4000, chunk=64)
    monkeypatch.setattr(sampled, "MOST", 1000)
    kept = Sampled(study)
    for part in parts(_rows(study, np.ones(4000)), study):
        kept.add(part)
    found = kept.result().variant
    assert abs(found.size - 1000) < 5.0 * np.sqrt(1000 * 0.75)
    assert np.unique(found).size == found.size
    assert abs(np.mean(found) - 2000.0) < 5.0 * 4000.0 / np.sqrt(12.0 * 1000.0)


def test_worst_machines_run_again(found, tmp_path) -> None:
    """The files of the worst machine of each figure give its figures in `feeddrive run`, with the noise of its own."""
    report = write_report(found, tmp_path / "out")
    assert report == tmp_path / "out" / "report.html"
    for worst in found.worst:
        case = worst.cases[0]
        sign = 1.0 if worst.figure.better == "lower" else -1.0
        assert sign * case.value == np.max(sign * found.sample.figures[worst.figure.key])
        job = read_job(tmp_path / "out" / "worst" / f"variant_{case.variant:08d}.toml")
        assert job.seed == found.study.seed + case.variant  # 1 pm of noise, which the last bits see
        row = run_laws(job).rows[0]
        known = {name: values[case.variant] for name, values in found.sample.figures.items()}
        # the lines of a frequency response are others: a peak between two of them is off by 1e-4 at most
        assert numbers(row)["sensitivity_peak"] == pytest.approx(known["sensitivity_peak"], rel=1e-3)
        assert (row.peak("force"), row.peak("tracking_error")) == (
            known["force_peak_N"],
            known["tracking_error_peak_m"],
        )


def test_bands(found) -> None:
    """Of stiffness the quantiles of the rows; of the following error what the machine with the softest loop bounds."""
    band = found.stiffness
    assert list(band.x) == [5.0, 20.0, 90.0]
    values = found.sample.figures["stiffness_20_Hz_N_per_m"]
    assert band.quantiles[:, 1] == pytest.approx(np.quantile(values, QUANTILES), rel=1e-12)
    assert found.error.machines == 40
    peaks = found.sample.figures["tracking_error_peak_m"]
    assert np.max(found.error.at(0.5)) == pytest.approx(np.median(peaks), rel=1e-3)
    assert np.all(np.diff(found.error.quantiles, axis=0) >= 0.0)


def test_the_page(found) -> None:
    """Less than 1 MB, nothing of the study is HTML, and the numbers are there as numbers."""
    page = html(study_report(found))
    assert len(page.encode()) < 1_000_000
    assert "<b>or" not in page
    assert page.count("<svg") == 6
    assert found.sentences[0] in page
    files = dict(report_files(found))
    summary = json.loads(files["summary.json"])
    inside = found.yields.inside
    assert (summary["yield"]["inside"], summary["yield"]["machines"]) == (inside.kept, 40)
    assert summary["front"]["figures"]["robustness"] == "sensitivity_peak"
    assert found.plot() is not None
    assert "all of them" in str(found)


def test_rows_of_another_study(found, tmp_path) -> None:
    study = read(tmp_path)
    with pytest.raises(ParameterError, match="there is no column 'force_peak_N'"):
        answers_of(
            arrow.table(
                {
                    "variant": [0],
                    **{name: [1.0] for name in study.columns},
                    "reason": [None],
                    "tracking_error_peak_m": [1.0],
                }
            ),
            study,
        )
    with pytest.raises(ParameterError, match="40 variants, and here are rows of 10"):
        answers_of(_rows(study, np.ones(40)).slice(0, 10), study)


def test_names_are_as_short_as_they_can_be() -> None:
    assert short(["axis.x.plant.mass", "axis.y.plant.mass", "wear", "axis.x.law.Kp"]) == {
        "axis.x.plant.mass": "x.plant.mass",
        "axis.y.plant.mass": "y.plant.mass",
        "wear": "wear",
        "axis.x.law.Kp": "Kp",
    }
    assert short(["mass", "axis.x.plant.mass"]) == {"mass": "mass", "axis.x.plant.mass": "plant.mass"}
