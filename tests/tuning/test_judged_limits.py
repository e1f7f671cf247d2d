"""Figures against limits: proof, recommendation and search judge them by one rule, whatever the sign."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from feeddrive import FRF
from feeddrive.analysis.margins import logarithms, margins
from feeddrive.tuning.closed_loop import Figures
from feeddrive.tuning.criteria import Limits, bounds_of, judged
from feeddrive.tuning.proof import of_measurement
from feeddrive.tuning.tune import broken_limits

T = 1e-3


def loop_gain(lead: float) -> FRF:
    """|L| = 10 Hz/f, with one crossover at 10 Hz whose phase lies `lead` degrees above -180°."""
    f = np.geomspace(1.0, 100.0, 201)
    return FRF(f, -(10.0 / f) * np.exp(1j * np.radians(lead)), "cut", "force", "N/N", T)


def figures(lead: float, noise: float | None = None) -> Figures:
    L = loop_gain(lead)
    compliance = FRF(L.frequency, np.full(L.frequency.size, 1e-8 + 0j), "load_force", "position_load", "m/N", T)
    return Figures("bench", True, L, compliance, 1e-9, 10.0, noise, 0.0, False)


def slack_of_the_search(lead: float, limit: float) -> float:
    L = loop_gain(lead)
    flat = np.zeros(L.frequency.size)
    each = SimpleNamespace(
        frequency=L.frequency,
        sample_time=T,
        gain=L.response,
        gain_variance=flat,
        gain_slope=np.zeros((L.frequency.size, 1)),
        logarithms=logarithms(L.frequency, L.response),
    )
    found = bounds_of(0, each, Limits(sensitivity_peak=None, phase_margin_deg=limit))  # type: ignore[arg-type]
    return next(iter(found)).slack


@pytest.mark.parametrize("lead", [50.0, -50.0])
@pytest.mark.parametrize(("limit", "kept"), [(40.0, True), (60.0, False)])
def test_a_phase_margin_counts_by_its_size_in_proof_recommendation_and_search(
    lead: float, limit: float, kept: bool
) -> None:
    """-50 deg passes -1 on its other side as far as +50 deg does."""
    limits = Limits(sensitivity_peak=None, phase_margin_deg=limit)
    proof = of_measurement([figures(lead)], limits)[-1]
    assert proof.holds is kept
    assert (broken_limits([figures(lead)], limits) == "") is kept
    assert (slack_of_the_search(lead, limit) >= 0.0) is kept
    assert f"phase margin {lead:g} deg" in proof.text


def test_what_does_not_occur_is_called_so_and_keeps_its_limit() -> None:
    """A gain below 1 everywhere has no crossover; it was shown as a phase margin of 0 deg that holds."""
    f = np.geomspace(1.0, 100.0, 51)
    low = margins(FRF(f, np.full(51, 0.1 + 0j), "cut", "force", "N/N", T))
    found = judged(Limits(phase_margin_deg=30.0), SimpleNamespace(margins=low), 0.0)  # type: ignore[arg-type]
    assert [each.keeps for each in found] == [True, True]
    assert str(found[1]) == "no phase margin, there is no crossover"


def test_the_noise_in_the_force_is_judged_too() -> None:
    """It was a limit of the search alone."""
    limits = Limits(force_noise_N=2.0, reading_noise=(1e-8, 1e-8))
    assert broken_limits([figures(60.0, 1.9)], limits) == ""
    said = "have force noise 2.2 N, not force noise <= 2 N at 10 nm of white noise in the readings"
    assert broken_limits([figures(60.0, 2.2)], limits) == said
    assert of_measurement([figures(60.0, 2.2)], limits)[-1].holds is False


@pytest.mark.parametrize(("noise", "holds"), [(2.003, True), (2.006, False)])
def test_the_proof_leaves_two_thousandths_of_a_limit_for_other_lines(noise: float, holds: bool) -> None:
    limits = Limits(sensitivity_peak=None, force_noise_N=2.0, reading_noise=(1e-8, 1e-8))
    assert of_measurement([figures(60.0, noise)], limits)[-1].holds is holds
