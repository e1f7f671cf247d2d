"""The variance of a measured frequency response goes along where that is right, and wrong ones are named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.margins import complementary_sensitivity, sensitivity
from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF, coherence_of, variance_of

F = np.array([1.0, 2.0, 5.0])
TRUTH = np.array([2.0 + 1.0j, 0.5 - 0.7j, -0.3 + 0.1j])
SMALL = 1e-4  # relative deviation: second order is then 1e-4 of the first


def measured(response: np.ndarray = TRUTH) -> FRF:
    return FRF(F, response, "force", "position", "m/N", coherence=np.full(3, 0.9), variance=(SMALL * abs(TRUTH)) ** 2)


EXACT = FRF(F, np.array([0.3 + 0.4j, 3.0 + 0.0j, 0.1j]))


@pytest.mark.parametrize(
    "change",
    [
        lambda G: G * 3.0,
        lambda G: 2j * G,
        lambda G: G * EXACT,
        lambda G: EXACT * G,
        lambda G: -G,
        lambda G: 1.0 + G,
        lambda G: EXACT + G,
        lambda G: G.inverse(),
        lambda G: (1.0 + EXACT * G).inverse(),
        sensitivity,
        complementary_sensitivity,
    ],
)
def test_the_variance_is_that_of_many_measurements(change: Callable[[FRF], FRF]) -> None:
    """Against 1500 draws: a variance from n complex draws deviates by 1/sqrt(n), 2.6 %; five of that."""
    rng = np.random.default_rng(3)
    draws = 1500
    noise = (rng.standard_normal((draws, 3)) + 1j * rng.standard_normal((draws, 3))) * SMALL * abs(TRUTH) / np.sqrt(2)
    seen = np.array([change(measured(TRUTH + each)).response for each in noise])
    expected = np.mean(abs(seen - change(measured()).response) ** 2, axis=0)
    assert change(measured()).variance == pytest.approx(expected, rel=0.13)


def test_two_measured_responses_leave_no_variance() -> None:
    """Their errors may hang together: 2 G has four times the variance of G, not twice."""
    G = measured()
    assert (G + G).variance is None
    assert (G * G).variance is None
    assert (G + EXACT).variance is not None


def test_coherence_and_variance_are_checked() -> None:
    with pytest.raises(ParameterError, match=r"coherence is 1.2 at 2 Hz, it must be between 0 and 1"):
        FRF(F, TRUTH, coherence=np.array([1.0, 1.2, 0.5]))
    with pytest.raises(ParameterError, match=r"variance is -1 at 5 Hz"):
        FRF(F, TRUTH, variance=np.array([1.0, 0.0, -1.0]))
    with pytest.raises(ParameterError, match="variance is nan at 1 Hz"):
        FRF(F, TRUTH, variance=np.array([np.nan, 0.0, 1.0]))
    with pytest.raises(ParameterError, match="one coherence for each frequency"):
        FRF(F, TRUTH, coherence=np.ones(2))


def test_columns_of_a_table_hold_what_is_known() -> None:
    pytest.importorskip("pandas")
    assert list(measured().to_pandas().columns) == ["real", "imaginary", "coherence", "variance"]
    assert list(EXACT.to_pandas().columns) == ["real", "imaginary"]


def test_an_added_force_acts_and_is_not_in_the_command() -> None:
    """A free mass, hardly controlled: the added force alone moves it, x = F t²/2m, and the command stays small."""
    T, F, mass = 1e-3, 3.0, 2.0
    loop = fd.Loop(
        control=fd.Control(law=fd.blocks.CascadePPI(Kv=1e-9, Kp=1e-9, Tn=1e3)),
        axis=fd.Axis(plant=fd.blocks.Rigid(mass=mass)),
        sample_time=T,
    )
    still = fd.blocks.Recorded(position=np.zeros(101), sample_time=T)
    push = fd.blocks.RecordedForce(force=np.full(101, F), sample_time=T)
    run = fd.simulate(loop, still, added_force=push)
    assert run["position_load"] == pytest.approx(0.5 * F / mass * run.time**2, rel=1e-6)
    assert np.max(np.abs(run["force"])) < 1e-6


def test_variance_and_coherence_say_the_same() -> None:
    """γ² = 1/(1 + n var(G)/|G|²) and back; a stated variance goes before a coherence; at coherence 0 it is finite."""
    G, coherence = np.array([1.0 + 2.0j, -3.0j, 0.5]), np.array([0.99, 0.7, 0.2])
    variance = variance_of(G, coherence, 5)
    np.testing.assert_allclose(coherence_of(G, variance, 5), coherence, rtol=1e-12)
    stated = FRF(np.array([1.0, 2.0, 3.0]), G, coherence=coherence)
    np.testing.assert_array_equal(stated.known_variance(5), variance)
    np.testing.assert_array_equal(replace(stated, variance=2.0 * variance).known_variance(5), 2.0 * variance)
    assert replace(stated, coherence=None).known_variance() is None
    assert np.all(np.isfinite(variance_of(G, np.zeros(3))))


def test_a_coherence_below_a_thousandth_counts_as_one() -> None:
    """γ² = 0 would be an infinite variance; var = |G|² (1 - γ²)/(γ² n)."""
    variance = variance_of(np.ones(3), np.array([0.0, 0.75e-3, 1.5e-3]), averages=10)
    assert variance == pytest.approx([0.999 / 1e-2, 0.999 / 1e-2, 0.9985 / 1.5e-2])


def test_a_coherence_alone_is_taken_for_that_of_eight_averages() -> None:
    """(1 - ½)/(½ · 8) of |G|²."""
    found = FRF(F, TRUTH, coherence=np.full(3, 0.5)).known_variance()
    assert found == pytest.approx(np.abs(TRUTH) ** 2 / 8.0)


@pytest.mark.parametrize("known", ["", "variance", "coherence"])
def test_noise_does_not_turn_the_phase(known: str) -> None:
    """A mass with 1 ms of dead time falls below the noise at some 400 Hz of 2000 Hz: plain unwrapping drifts away."""
    f, noise = np.arange(1.0, 2001.0), 1e-7
    clean = np.exp(-2j * np.pi * f * 1e-3) / (2j * np.pi * f) ** 2
    random = np.random.default_rng(0)
    response = clean + noise * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
    variance = np.full(f.size, 2.0 * noise**2)
    extra = {"variance": variance, "coherence": np.abs(clean) ** 2 / (np.abs(clean) ** 2 + variance)}
    measured = FRF(f, response, **({known: extra[known]} if known else {}))
    true = np.degrees(np.unwrap(np.angle(clean)))
    # twice the 95 % radius of the noise at 200 Hz is 26 degrees
    assert np.max(np.abs(measured.phase_deg - true)[:200]) < 26.0
    # noise is nearest to the last phase that was seen: -270 degrees at 250 Hz, and half a turn about it
    assert np.ptp(measured.phase_deg[500:]) < 2.0 * 360.0
    assert np.array_equal(FRF(f, clean).phase_deg, true)


def test_a_flip_of_one_line_is_no_noise() -> None:
    """Lightly damped poles and zeros turn the phase by 180 degrees from one line to the next."""
    w = 2.0 * np.pi * np.arange(1.0, 2001.0)
    response = np.ones(w.size, complex)
    for place, sign in ((300.0, 1.0), (500.0, -1.0), (6000.0, -1.0)):
        response *= (1.0 - (w / place) ** 2 + 2e-3j * w / place) ** sign
    frf = FRF(w / (2.0 * np.pi), response)
    assert np.array_equal(frf.phase_deg, np.degrees(np.unwrap(np.angle(response))))
