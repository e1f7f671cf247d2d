"""Frequency responses from hammer blows: exact without noise, with honest errors, and nothing else taken for a blow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from feeddrive.identification.excitation.estimate_frf import estimate_frf
from feeddrive.identification.excitation.frequency_estimate import Record
from feeddrive.identification.excitation.impacts import _needed_damping, find_blows
from feeddrive.language.errors import LogError

T = 1.0 / 8192.0  # s
MODES = ((120.0, 0.02, 3e-2), (310.0, 0.015, 2e-2), (1074.0, 0.02, 1.4))  # Hz, damping ratio, (m/s2)/N
FILTERS = [
    cont2discrete(([a, 0.0, 0.0], [1.0, 2.0 * z * (w := 2.0 * np.pi * f), w * w]), T, "foh")[:2] for f, z, a in MODES
]
BAND = (60.0, 1500.0)  # Hz, in which a blow of 0.8 ms excites


def accelerance(f: np.ndarray) -> np.ndarray:
    """The exact response of the sampled structure, (m/s2)/N."""
    z = np.exp(2j * np.pi * f * T)
    return sum(np.polyval(np.ravel(num), z) / np.polyval(den, z) for num, den in FILTERS)  # type: ignore[return-value]


def struck(size: int, at: Sequence[float], noise: float = 0.0, seed: int = 0, sign: float = 1.0) -> Record:
    """Blows of 0.8 ms at some times in s, of different strength; noise as a share of force and RMS."""
    t = np.arange(size) * T
    force = np.zeros(size)
    for k, begin in enumerate(at):
        inside = (t >= begin) & (t < begin + 0.8e-3)
        force[inside] += sign * (500.0 - 40.0 * (k % 3)) * np.sin(np.pi * (t[inside] - begin) / 0.8e-3) ** 2
    answer = sum(lfilter(np.ravel(num), den, force) for num, den in FILTERS)
    rng = np.random.default_rng(seed)
    force = force + noise * 500.0 * rng.standard_normal(size)
    answer = answer + noise * np.std(answer) * rng.standard_normal(size)
    return Record(input=force, output=answer, sample_time=T, input_name="hammer", output_name="a", unit="m/s2/N")


def relative_error(record: Record) -> tuple[np.ndarray, np.ndarray]:
    found = estimate_frf(record, band=BAND).frf
    return np.abs(found.response / accelerance(found.frequency) - 1.0), found.frequency


def test_one_blow_that_decays_gives_the_exact_response() -> None:
    """The slowest mode is at exp(-0.02 · 2π · 120 · 0.9) = 1e-6 of its start when the record ends."""
    error, _ = relative_error(struck(8192, [0.1]))
    assert np.max(error) < 2e-5  # at the antiresonances, where 1e-6 of the peak is left


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_exponential_window_is_taken_out_again(sign: float) -> None:
    """A tenth of the slowest mode is left at the end of 0.15 s: without a window it leaks, uncorrected it is damped."""
    record = struck(1624, [0.05], sign=sign)
    found = estimate_frf(record, band=BAND)
    assert "exponential window" in found.method
    truth = accelerance(found.frequency)
    peak = int(np.argmax(np.abs(truth)))
    assert abs(found.frf.response[peak] / truth[peak] - 1.0) < 1e-4
    low = np.abs(found.frequency - 120.0) < 20.0
    np.testing.assert_allclose(found.frf.response[low], truth[low], rtol=0, atol=0.02 * np.max(np.abs(truth[low])))
    # 1 % is left at the end of the window, and leaks; at s = jω + σ, not corrected, the peak would be 20 % off


def test_blows_are_averaged_and_their_errors_cover() -> None:
    """20 records of five blows, 1 % of noise: at least 93 % of the discs of 95 % hold the truth, and not too wide."""
    inside, ratio = [], []
    for seed in range(20):
        found = estimate_frf(struck(3 * 8192, [0.1, 0.7, 1.2, 1.9, 2.4], 0.01, seed), band=BAND)
        away = np.abs(found.frf.response - accelerance(found.frequency))
        inside.append(np.mean(away <= found.radius()))
        assert found.frf.variance is not None
        ratio.append(np.sqrt(np.mean(away**2 / found.frf.variance)))
    assert found.counts["blows"] == 5
    assert found.total
    assert 0.93 < np.mean(inside) <= 1.0
    assert 0.5 < np.mean(ratio) < 3.0  # four degrees of freedom: the variance of a single line is wild


def test_coherence_of_blows_falls_with_noise_and_never_hides_scatter() -> None:
    quiet, loud = (estimate_frf(struck(3 * 8192, [0.1, 0.7, 1.2, 1.9], noise), band=BAND).frf for noise in (1e-4, 0.05))
    assert quiet.coherence is not None
    assert loud.coherence is not None
    assert np.median(loud.coherence) < np.median(quiet.coherence)
    assert np.median(quiet.coherence) > 0.999


def test_local_polynomials_of_a_blow_are_refused_and_do_not_claim_coherence() -> None:
    """Force and transient are both smooth over frequency: an older version gave wrong values with coherence 1."""
    record = struck(8192, [0.1])
    with pytest.raises(LogError, match=r"hammer blows.*take method 'impact'"):
        estimate_frf(record, method="local_polynomial")
    steps = np.zeros(8192)
    steps[4000:] = 1.0
    answer = sum(lfilter(np.ravel(num), den, steps) for num, den in FILTERS)
    rng = np.random.default_rng(3)
    noisy = Record(input=steps, output=answer + 0.3 * rng.standard_normal(8192), sample_time=T)
    found = estimate_frf(noisy, band=BAND)
    assert found.frf.coherence is not None
    assert found.frf.variance is not None
    scatter = np.sqrt(found.frf.variance) / found.frf.magnitude
    assert np.all(found.frf.coherence[scatter > 1.0] < 0.5)
    assert np.any(scatter > 1.0)


def test_a_bounce_belongs_to_its_blow() -> None:
    record = struck(8192, [0.1, 0.105])
    blows = find_blows(record.input)
    assert [blow.touches for blow in blows] == [1, 1] or [blow.touches for blow in blows] == [2]
    many = struck(3 * 8192, [0.1, 0.104, 0.8, 1.5, 2.3])
    assert [blow.touches for blow in find_blows(many.input)] == [2, 1, 1, 1]
    found = estimate_frf(many, band=BAND)
    assert found.counts["blows"] == 4
    assert any("1 of 4 blows touched more than once" in remark for remark in found.remarks)
    error = np.abs(found.frf.response / accelerance(found.frequency) - 1.0)
    assert np.median(error) < 1e-3


def test_weak_blows_and_short_stretches_are_left_out_and_said() -> None:
    record = struck(3 * 8192, [0.1, 0.8, 1.5, 2.2, 2.95])
    force = record.input.copy()
    force[int(0.8 / T) : int(0.801 / T)] *= 0.2
    answer = sum(lfilter(np.ravel(num), den, force) for num, den in FILTERS)
    found = estimate_frf(Record(input=force, output=answer, sample_time=T), band=BAND)
    assert found.counts["blows"] == 3
    assert any("1 blow(s) below 30 % of the usual force" in remark for remark in found.remarks)
    assert any("less than 50 % of the usual time after them" in remark for remark in found.remarks)


def test_a_sensor_at_its_limit_is_said() -> None:
    record = struck(8192, [0.1])
    cut = Record(input=np.minimum(record.input, 150.0), output=record.output, sample_time=T)
    assert any("clipped at the top" in remark for remark in estimate_frf(cut).remarks)
    assert not any("saturated" in remark for remark in estimate_frf(record).remarks)


@pytest.mark.parametrize("kind", ["noise", "chirp", "prbs", "step", "sine burst", "both ways"])
def test_nothing_else_is_taken_for_blows(kind: str) -> None:
    rng = np.random.default_rng(5)
    t = np.arange(8192) * T
    force = {
        "noise": rng.standard_normal(8192),
        "chirp": np.sin(2.0 * np.pi * (10.0 + 500.0 * t) * t),
        "prbs": np.where(np.repeat(rng.standard_normal(512), 16) > 0.0, 1.0, -1.0),
        "step": (t > 0.5).astype(float),
        "sine burst": np.where(np.abs(t - 0.5) < 0.01, np.sin(2.0 * np.pi * 300.0 * t), 0.0),
        "both ways": struck(8192, [0.1, 0.5]).input * np.where(t < 0.3, 1.0, -1.0),
    }[kind]
    assert find_blows(force) == []
    with pytest.raises(LogError, match="holds no blows of a hammer"):
        estimate_frf(Record(input=force, output=rng.standard_normal(8192), sample_time=T), method="impact")


# ---------------------------------------------------------------- what decides: a case on either side of each bound


def pulses(*each: tuple[int, float], width: int = 16, size: int = 8192) -> np.ndarray:
    """Pulses that begin at a sample and have a peak."""
    force = np.zeros(size)
    for begin, peak in each:
        force[begin : begin + width] += peak * np.sin(np.pi * (np.arange(width) + 0.5) / width) ** 2
    return force


@pytest.mark.parametrize(("peak", "blows"), [(0.07, 1), (0.14, 2)])
def test_a_pulse_above_a_tenth_of_the_largest_is_a_blow(peak: float, blows: int) -> None:
    assert len(find_blows(pulses((500, 1.0), (4000, peak)))) == blows


@pytest.mark.parametrize(("width", "blows"), [(150, 1), (300, 0)])
def test_a_pulse_with_its_ends_is_shorter_than_a_twentieth_of_the_record(width: int, blows: int) -> None:
    """Half of its length on each side is below the noise and counts: 300 and 600 of 8192 samples."""
    assert len(find_blows(pulses((4000, 1.0), width=width))) == blows


@pytest.mark.parametrize(("share", "blows"), [(0.06, 1), (0.14, 0)])
def test_blows_hold_nine_tenths_of_the_energy(share: float, blows: int) -> None:
    force = pulses((500, 1.0))
    energy = float(np.sum(force**2))
    # a hum below a tenth of the peak: 0.09² / 2 for each of its samples
    length = round(share / (1.0 - share) * energy / (0.5 * 0.09**2) / 32) * 32
    force[4000 : 4000 + length] = 0.09 * np.sin(2.0 * np.pi * np.arange(length) / 32)
    assert len(find_blows(force)) == blows


@pytest.mark.parametrize(("back", "blows"), [(0.07, 1), (0.14, 0)])
def test_a_blow_goes_back_by_a_tenth_of_its_peak(back: float, blows: int) -> None:
    assert len(find_blows(pulses((500, 1.0), (516, -back)))) == blows


@pytest.mark.parametrize(("deviations", "blows"), [(3.0, 1), (6.0, 0)])
def test_four_standard_deviations_beyond_that_are_noise(deviations: float, blows: int) -> None:
    """A force at rest of -1, 0 and 1 % of the peak has 1.4826 % as its standard deviation by the median."""
    force = pulses((500, 1.0)) + 0.01 * (np.arange(8192) % 3 - 1)
    force[517] = -0.1 * np.max(force) - deviations * 1.4826 * 0.01
    assert len(find_blows(force)) == blows


@pytest.mark.parametrize(("apart", "touches"), [(280, [2, 1]), (560, [1, 1, 1])])
def test_a_pulse_within_a_tenth_of_the_time_between_blows_is_a_bounce(apart: int, touches: list[int]) -> None:
    found = find_blows(pulses((500, 1.0), (500 + apart, 0.8), (4500 + apart, 0.9)))
    assert [blow.touches for blow in found] == touches


@pytest.mark.parametrize(("peak", "used"), [(0.22, 3), (0.42, 4)])
def test_a_blow_above_0_3_of_the_usual_peak_is_used(peak: float, used: int) -> None:
    force = pulses((500, 1.0), (2500, 1.0), (4500, peak), (6500, 1.0))
    answer = sum(lfilter(np.ravel(num), den, force) for num, den in FILTERS)
    found = estimate_frf(Record(input=force, output=np.asarray(answer), sample_time=T), method="impact")
    assert found.counts["blows"] == used


@pytest.mark.parametrize(("last", "used"), [(700, 3), (1400, 4)])
def test_a_blow_with_half_of_the_usual_time_after_it_is_used(last: int, used: int) -> None:
    """The others have 2000 samples until the next one."""
    force = pulses((500, 1.0), (2500, 1.0), (4500, 1.0), (6500, 1.0), size=6500 + last)
    answer = sum(lfilter(np.ravel(num), den, force) for num, den in FILTERS)
    found = estimate_frf(Record(input=force, output=np.asarray(answer), sample_time=T), method="impact")
    assert found.counts["blows"] == used


K = np.arange(4096)
SLOW, QUICK = np.sin(2.0 * np.pi * 20.0 * K / 1024), np.sin(2.0 * np.pi * 200.0 * K / 1024)  # in octaves of their own
FIRST, THIRD, LAST = K < 1024, (K >= 2048) & (K < 3072), K >= 3072


def left_at_the_end(answer: np.ndarray) -> float:
    """The share of a response that an exponential window leaves; 1 without a window."""
    return float(np.exp(-_needed_damping(answer[None], T) * answer.size * T))


@pytest.mark.parametrize(("left", "window"), [(0.014, False), (0.03, True)])
def test_a_response_that_has_fallen_to_2_percent_needs_no_window(left: float, window: bool) -> None:
    """From its first quarter to its last a decay falls by three quarters of the whole."""
    rate = -np.log(left) / (0.75 * 4096)
    assert (left_at_the_end(np.exp(-rate * K) * SLOW) < 1.0) is window


@pytest.mark.parametrize(("power", "window"), [(0.7e-4, False), (1.5e-4, True)])
def test_an_octave_with_less_than_1e_4_of_the_strongest_needs_no_window(power: float, window: bool) -> None:
    assert (left_at_the_end(FIRST * QUICK + np.sqrt(power) * SLOW) < 1.0) is window


@pytest.mark.parametrize(("power", "window"), [(0.6, True), (0.85, False)])
def test_what_keeps_0_7_of_its_power_from_the_third_quarter_on_is_noise(power: float, window: bool) -> None:
    answer = (FIRST + 0.1 * THIRD + 0.1 * np.sqrt(power) * LAST) * SLOW
    assert (left_at_the_end(answer) < 1.0) is window


@pytest.mark.parametrize(("size", "window"), [(0.2, False), (0.45, True)])
def test_what_keeps_0_3_of_its_start_is_no_noise(size: float, window: bool) -> None:
    assert (left_at_the_end((FIRST + size * ~FIRST) * SLOW) < 1.0) is window


def test_the_window_leaves_a_hundredth_of_a_response_that_does_not_decay() -> None:
    assert left_at_the_end(SLOW) == pytest.approx(0.01, rel=1e-6)


def test_a_single_blow_is_judged_by_nine_lines_less_four_unknowns() -> None:
    assert estimate_frf(struck(8192, [0.1])).freedom[0] == 9 - 4


@pytest.mark.parametrize(("least", "said"), [(0.07, True), (0.15, False)])
def test_a_force_that_falls_to_a_tenth_over_frequency_is_said(least: float, said: bool) -> None:
    """Three samples (a, 1, a) have the spectrum (1 + 2 a cos ωT)/(1 + 2 a), at Nyquist (1 - 2 a)/(1 + 2 a)."""
    a = 0.5 * (1.0 - least) / (1.0 + least)
    force = np.zeros(8192)
    force[499:502] = a, 1.0, a
    answer = sum(lfilter(np.ravel(num), den, force) for num, den in FILTERS)
    found = estimate_frf(Record(input=force, output=np.asarray(answer), sample_time=T), method="impact")
    assert any("the spectrum of the force falls" in remark for remark in found.remarks) is said
