"""The observer over frequency, with noise, with a wrong mass and at long sample times."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from feeddrive.analysis.observe import observe
from feeddrive.analysis.stability import stability
from feeddrive.blocks.load.sine_force import SineForce
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.simulate import simulate
from feeddrive.papers.beltran2013.mill import LEG, Case, T, law, legs, loop, mass

RIGID = Case("", share=1.0)


def left_over(observer: GpiObserver, frequency: np.ndarray) -> np.ndarray:
    """1 - H = (ξ - ξ̂)/ξ of the paper's continuous observer: the first three terms of its polynomial over all."""
    s = 2j * np.pi * np.asarray(frequency, dtype=float) / observer.omega_o
    coefficients = [float(each) for each in observer.polynomial()]
    first = np.polyval(coefficients[:3], s) * s ** (len(coefficients) - 3)
    return first / np.polyval(coefficients, s)


def observer_of(taylor_states: int) -> GpiObserver:
    """The paper's observer on x, with another number of Taylor states."""
    observer = law("x", dataclasses.replace(RIGID, taylor_states=taylor_states)).observer
    assert isinstance(observer, GpiObserver)
    return observer


def sine_test(frequency: float, taylor_states: int = 5, share: float = 1.0) -> tuple[complex, complex]:
    """Measured in the running loop on x: (ξ - ξ̂)/ξ and position/ξ (s²), from a force of 200 N on the standing axis.

    The force is a staircase that acts half a sample late; the axis has no dry friction here, so that it is linear.
    """
    case = dataclasses.replace(RIGID, taylor_states=taylor_states, share=share)
    periods = int(np.ceil(max(20.0, 1.5 * frequency)))
    settled = int(np.ceil(frequency))  # a second
    found = simulate(
        loop("x", case, dry=False), legs("linear", LEG)["z"], load=SineForce(amplitude=200.0, frequency=frequency),
        duration=(periods + settled) / frequency, start=(0.0, 0.0),
    )  # fmt: skip
    seen = observe(law("x", case).observer, found["reading_load"], found["force"], T)
    counted = found.time >= settled / frequency
    wave = np.exp(-2j * np.pi * frequency * found.time[counted]) * np.hanning(int(np.sum(counted)))
    true, estimate, position = (
        np.sum(wave * each[counted]) for each in (found["load_force"], seen.disturbance, found["position_load"])
    )
    late = np.exp(-1j * np.pi * frequency * T)
    return complex(1.0 - estimate / (true * late)), complex(position / (true * late) * mass("x"))


def noise_gain(sample_time: float) -> float:
    """σ(ξ̂)/σ(y) in 1/s² for white noise of the reading: root of the sum of squares of the answer to one count."""
    position = np.zeros(round(1.0 / sample_time))
    position[1] = 1.0
    observer = law("x", RIGID).observer
    seen = observe(observer, position, np.zeros_like(position), sample_time)
    return float(np.sqrt(np.sum((seen.disturbance / mass("x")) ** 2)))


def _edge(holds: Callable[[float], bool], good: float, bad: float) -> float:
    """Where it stops to hold between two values, by bisection."""
    for _ in range(12):
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good


def gain_limits() -> tuple[float, float]:
    """The least and the largest true over believed input gain with a stable loop, on x."""

    def stable(gain: float) -> bool:
        return stability(loop("x", dataclasses.replace(RIGID, gain=gain))).stable

    return _edge(stable, 1.0, 0.3), _edge(stable, 1.0, 4.0)


def sample_time_limit(hold: str) -> float:
    """The longest sample time in s with which the law is not refused."""

    def admitted(sample_time: float) -> bool:
        try:
            tree.check_sampled(law("x", dataclasses.replace(RIGID, hold=hold)), sample_time)
        except ParameterError:
            return False
        return True

    return _edge(admitted, 1e-4, 4e-3 if hold == "first_order" else 4e-4)


def stable_at(hold: str, sample_time: float) -> bool:
    """Whether the whole loop on x, friction and viscous damping with it, has all its poles inside the circle."""
    return stability(loop("x", dataclasses.replace(RIGID, hold=hold), sample_time=sample_time)).stable
