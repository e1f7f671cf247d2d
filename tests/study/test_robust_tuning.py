"""Tuning over the machines of a study: known worst machines, all sampled ones kept, proof on others."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from feeddrive.figures.of_loops import COMPLIANCE_PEAK, DELAY_MARGIN, SENSITIVITY_PEAK
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.progress import Progress
from feeddrive.report.page import html
from feeddrive.study import Study, read_study, tune_robust, variant_groups, variants
from feeddrive.study.robust import Robust, limits_of, scenarios, with_control
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.operating_point import modelled_point
from feeddrive.tuning.tune import tune_control

GRID = """job = "ball_screw"
sampler = "grid"
[specification]
sensitivity_peak = { most = 2 }
[[vary]]
parameter = "axis.x.actuator.dead_time"
values_us = [50, 100, 150, 200]
"""
ALIKE = 5e-3  # of the goal: what a machine that does not join may be worse by


def study_of(tmp_path: Path, text: str) -> Study:
    path = tmp_path / "study.toml"
    path.write_text(text, encoding="utf-8")
    return read_study(path)


def alone(study: Study, number: int) -> float:
    """The logarithm of the best goal on one machine of a study by itself."""
    (group,) = variant_groups(study, variants(study, number, 1))
    point = modelled_point(group.loop(0), velocity=group.speed)
    (after,) = tune_control(group.loop(0).control, point, filters="kept", velocity=group.speed).after
    return math.log(after.rope_snap)


def worst(found: Robust) -> float:
    return math.log(max(each.rope_snap for each in found.tuned.after))


def test_the_largest_dead_time_decides(tmp_path: Path) -> None:
    """Known worst case: of machines that differ in dead time alone the slowest one limits the gains.

    Dead time turns the phase down and leaves every magnitude, so |1 + L| of the slowest is the nearest to 0 and its
    tuning alone is the tuning for all.
    """
    study = study_of(tmp_path, GRID.replace("50, 100, 150, 200", "50, 150"))
    found = tune_robust(study, filters="kept", starts=1, fresh=8, workers=1)
    assert worst(found) == pytest.approx(alone(study, 1), abs=ALIKE)
    assert found.seen_new.kept.tolist() == [True, True]
    report = found.report()
    assert report.verdict.sentences == (found.sentence(),)
    assert [section.folded for section in report.sections] == [False, False, True, True]
    assert "variant 1" in html(report)  # the machine that decides


@pytest.mark.slow(reason="two tunings over machines, 10 s")
def test_a_share_leaves_the_worst_machine_out(tmp_path: Path) -> None:
    """Of four dead times the largest decides, and for three quarters of the machines the second largest."""
    study = study_of(tmp_path, GRID)
    for share, decides in ((1.0, 3), (0.75, 2)):
        found = tune_robust(study, filters="kept", share=share, fresh=16, workers=1)
        assert found.tuned.holds
        assert f"variant {decides}" in found.active
        assert worst(found) == pytest.approx(alone(study, decides), abs=ALIKE)
        assert found.seen_new.kept.tolist() == [True, True, True, share == 1.0]


@pytest.mark.slow(reason="tunings over machines, 10 to 30 s")
def test_few_machines_decide_as_all_would(tmp_path: Path) -> None:
    text = GRID.replace('"grid"', '"sobol"\ncount = 12').replace(
        "values_us = [50, 100, 150, 200]", "least_us = 50\nmost_us = 150"
    )
    text += '[[vary]]\nparameter = "axis.x.plant.mass_load"\ntolerance_percent = 20\n'
    study = study_of(tmp_path, text)
    found = tune_robust(study, filters="kept", fresh=16, workers=1)
    sample = scenarios(study, 12, Progress())
    assert len(found.active) < 12
    assert np.all(found.seen_new.kept)
    everything = tune_control(found.tuned.control, sample.points, filters="kept", velocity=sample.velocity)
    assert worst(found) == pytest.approx(math.log(max(each.rope_snap for each in everything.after)), abs=ALIKE)


@cache
def series() -> Robust:
    return tune_robust("ball_screw_series", filters="kept", samples=48, fresh=96, workers=1)


@pytest.mark.slow(reason="tunings over machines, 10 to 30 s")
def test_the_proof_is_on_machines_that_were_not_tuned_on() -> None:
    found, study = series(), read_study("ball_screw_series")
    seen = variants(study).values
    fresh = variants(replace(study, stream=1, sampler="monte_carlo")).values
    assert not any(np.any(np.isin(fresh[name], seen[name])) for name in seen)
    assert found.before.count == found.after.count == 96
    assert found.after.all.kept > found.before.all.kept
    assert "fresh machines that the tuner never saw" in found.sentence()


@pytest.mark.slow(reason="tunings over machines, 10 to 30 s")
def test_figures_of_fresh_machines_are_those_of_a_sweep_of_them() -> None:
    from feeddrive.study.chunk import run_chunk

    found, study = series(), read_study("ball_screw_series")
    fresh = replace(
        with_control(study, found.tuned.control), stream=1, sampler="monte_carlo", points=96, count=96, chunk=96
    )
    rows = run_chunk(fresh, 0)
    for name in ("sensitivity_peak", "following_error_peak_m"):
        assert np.array_equal(rows.column(name).to_numpy(), found.after.values[name])


def test_limits_follow_from_the_specification() -> None:
    limits = limits_of(read_study("ball_screw_series"), Limits(sensitivity_peak=1.7, delay_margin_samples=4.0))
    assert limits.bound(SENSITIVITY_PEAK) == 2.2
    assert limits.bound(COMPLIANCE_PEAK) == pytest.approx(1.0 / 4.5e6)
    assert limits.bound(DELAY_MARGIN) == 4.0


@pytest.mark.slow(reason="tunings over machines, 10 to 30 s")
def test_no_control_for_impossible_limits(tmp_path: Path) -> None:
    text = GRID.replace("most = 2 }", "most = 1.05 }\nstiffness_least_N_per_m = { least_N_per_um = 500 }")
    with pytest.raises(UnstableError, match=r"variant .*together.*smaller share"):
        tune_robust(study_of(tmp_path, text), filters="kept", fresh=16, workers=1)


def test_a_study_of_the_control_is_refused(tmp_path: Path) -> None:
    text = GRID + '[[vary]]\nparameter = "axis.x.control.law.Kv"\nvalues = [80, 90]\n'
    with pytest.raises(ParameterError, match="varies the control, which is what is tuned"):
        tune_robust(study_of(tmp_path, text))


def test_a_share_below_a_half_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"share = 0\.3 must be >= 0\.5"):
        tune_robust("ball_screw_series", share=0.3)
