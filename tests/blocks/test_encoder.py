"""The encoder: each fault by itself against its closed form, and together in their order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.lead_error import LeadError
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.sensor.eccentricity import Eccentricity
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.sensor.interpolation import Interpolation
from feeddrive.blocks.signals import Noise, Setpoint
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

T = 1e-4
N = 3000  # values of a random sample


def read(encoder: Encoder, positions: np.ndarray, velocity: float = 0.0, seed: float = 1.0) -> np.ndarray:
    """Readings in m of positions at kT."""
    plain: Any = tree.rebuild(encoder, (np.float64(value) for _, value in tree.leaves(encoder)))
    readings = []
    with np.errstate(all="ignore"):
        state = plain.start(np.float64(positions[0]))
        for k, position in enumerate(positions):
            noise = Noise(np.float64(seed), np.float64(k), 16.0)
            state, reading = plain.step(state, np.float64(position), np.float64(velocity), noise, np.float64(T))
            readings.append(float(reading))
    return np.array(readings)


X = np.linspace(-0.03, 0.05, 1001)


def test_a_perfect_encoder_reads_the_position() -> None:
    assert np.array_equal(read(Encoder(), X), X)


def test_resolution_is_the_nearest_count() -> None:
    found = read(Encoder(resolution=1e-6), X)
    np.testing.assert_allclose(found / 1e-6, np.round(found / 1e-6), atol=1e-9)
    assert np.max(np.abs(found - X)) <= 0.5e-6 * (1 + 1e-9)


def test_noise_is_white_and_normal() -> None:
    noise = read(Encoder(noise=2e-8), np.zeros(N))
    # mean within 4 σ/√N, deviation within 4 σ/√2N, correlation of neighbors within 4/√N
    assert abs(np.mean(noise)) < 4 * 2e-8 / np.sqrt(N)
    assert np.std(noise) == pytest.approx(2e-8, rel=4 / np.sqrt(2 * N))
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4 / np.sqrt(N)
    assert not np.array_equal(noise, read(Encoder(noise=2e-8), np.zeros(N), seed=2.0))


def test_jitter_shifts_the_instant_in_proportion_to_velocity() -> None:
    at_speed = read(Encoder(jitter=1.5e-3), np.zeros(N), velocity=0.5)
    assert np.std(at_speed) == pytest.approx(1.5e-3 * T * 0.5, rel=4 / np.sqrt(2 * N))
    assert np.all(read(Encoder(jitter=1.5e-3), np.zeros(100)) == 0.0)
    np.testing.assert_allclose(read(Encoder(jitter=1.5e-3), np.zeros(N), velocity=-1.0), -2 * at_speed, rtol=1e-12)


def test_jitter_and_noise_are_independent() -> None:
    noise = read(Encoder(noise=1e-8), np.zeros(N))
    jitter = read(Encoder(jitter=1e-3), np.zeros(N), velocity=0.5)
    assert abs(np.corrcoef(noise, jitter)[0, 1]) < 4 / np.sqrt(N)
    both = read(Encoder(noise=1e-8, jitter=1e-3), np.zeros(N), velocity=0.5)
    np.testing.assert_allclose(both, noise + jitter, rtol=0, atol=1e-22)


def test_eccentricity_and_interpolation_are_sines_of_the_position() -> None:
    once = Encoder(eccentricity=Eccentricity(amplitude=5e-6, period=0.02, phase=0.7))
    np.testing.assert_allclose(read(once, X) - X, 5e-6 * np.sin(2 * np.pi * X / 0.02 + 0.7), atol=1e-17)
    fine = Encoder(interpolation=Interpolation(signal_period=2e-5, first=4e-8, second=1e-8))
    angle = 2 * np.pi * X / 2e-5
    # 1e-12 of the angle of 15,000 rad
    np.testing.assert_allclose(read(fine, X) - X, 4e-8 * np.sin(angle) + 1e-8 * np.sin(2 * angle), atol=1e-16)


def test_the_screw_is_seen_through_its_lead_error() -> None:
    error = LeadError(row=[0.0, 1e-5, -2e-5], start=0.0, spacing=0.02)
    table = np.interp(X, [0.0, 0.02, 0.04], [0.0, 1e-5, -2e-5])
    np.testing.assert_allclose(read(Encoder(lead_error=error), X), X - table, atol=1e-17)


def test_offset_is_added_behind_the_counts() -> None:
    np.testing.assert_allclose(
        read(Encoder(resolution=1e-6, offset=0.3e-6), X), read(Encoder(resolution=1e-6), X) + 0.3e-6, atol=1e-17
    )


def test_a_counter_that_is_too_slow_loses_counts_for_good() -> None:
    # at most 4 counts of 1 µm a sample; the axis moves 2, then 10, then 2 a sample, and comes back in one jump of 4
    steps = np.r_[np.full(10, 2.0), np.full(10, 10.0), np.full(10, 2.0), -4.0, 0.0]
    positions = 1e-6 * np.r_[0.0, np.cumsum(steps)]
    found = read(Encoder(resolution=1e-6, largest_rate=4.0 / T), positions)
    seen = 1e-6 * np.r_[0.0, np.cumsum(np.clip(steps, -4.0, 4.0))]
    np.testing.assert_allclose(found, seen, atol=1e-18 / 1e-3)
    assert found[-1] - positions[-1] == pytest.approx(-60e-6, abs=1e-12)


def test_a_counter_that_is_fast_enough_changes_no_bit() -> None:
    plain = Encoder(resolution=1e-8, noise=3e-8)
    counted = Encoder(resolution=1e-8, noise=3e-8, largest_rate=1e9)
    assert np.array_equal(read(counted, X), read(plain, X))
    with pytest.raises(ParameterError, match=r"largest_rate is given without encoder\.resolution"):
        Encoder(largest_rate=1e6)


def test_a_loop_starts_without_a_jump_whatever_the_encoder_reads() -> None:
    # the first sample must not see the faults as a velocity
    faulty = Encoder(
        resolution=1e-6,
        offset=2e-3,
        eccentricity=Eccentricity(amplitude=2e-5, period=0.02, phase=1.0),
        lead_error=LeadError(row=[1e-4, 2e-4], start=0.0, spacing=1.0),
    )
    loop = Loop(
        sample_time=T,
        control=Control(law=CascadePPI(Kv=50.0, Kp=1e4)),
        axis=Axis(plant=Rigid(mass=100.0), encoder_load=faulty),
    )
    loop = tree.rebuild(loop, (np.float64(value) for _, value in tree.leaves(loop)))
    timing = loop.timing()
    with np.errstate(all="ignore"):
        prepared = loop.prepare(timing)
        place = np.float64(faulty.still(0.1234))
        state = loop.start(prepared, timing, Setpoint(place), np.float64(0.1234), np.float64(0.0))
        _, signals = loop.step(prepared, state, Setpoint(place), None, Noise(0.0, 0.0), 1.0, 0.0)
    assert signals.reading_load == place
    assert signals.force == 0.0
