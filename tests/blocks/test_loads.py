"""Forces over time: which samples they act in, and what they are there."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.cutting.drill import Drill
from feeddrive.blocks.cutting.edge_coefficients import EdgeCoefficients
from feeddrive.blocks.cutting.helical_cutter import HelicalCutter
from feeddrive.blocks.cutting.turning_tool import TurningTool
from feeddrive.blocks.families import Load
from feeddrive.blocks.load.drilling_force import DrillingForce
from feeddrive.blocks.load.force_sum import ForceSum
from feeddrive.blocks.load.milling_force import MillingForce
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.load.sine_force import SineForce
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.load.turning_force import TurningForce
from feeddrive.language.errors import ParameterError, StructureError

EDGE = EdgeCoefficients(Ktc=1.2e9, Kfc=6e8, Kte=2e4, Kfe=3e4)
EXAMPLES: dict[str, Load] = {
    "step_force": StepForce(force=-40, start=0.3),
    "sine_force": SineForce(amplitude=50, frequency=7, phase=0.4, start=0.1, end=0.9),
    "recorded_force": RecordedForce(force=[1.0, -2.0, 3.0], sample_time=0.1),
    "milling_force": MillingForce(cutter=HelicalCutter.beltran2013(), spindle_speed=1800, chip_load=5e-5),
    "turning_force": TurningForce(
        tool=TurningTool(cutting_depth=2e-3, edge=EDGE), spindle_speed=1000, feed_per_turn=2e-4
    ),
    "drilling_force": DrillingForce(tool=Drill(diameter=0.01, lip=EDGE), spindle_speed=1000, feed_per_turn=2e-4),
    "force_sum": ForceSum(loads=(StepForce(force=1), StepForce(force=2, start=0.5))),
}


def test_every_load_has_an_example_here():
    assert set(EXAMPLES) == set(catalogue()[Load])


@pytest.mark.parametrize("kind", EXAMPLES)
def test_all_answer_in_float_arrays(kind: str):
    force = EXAMPLES[kind].at(np.linspace(-1.0, 2.0, 31))
    assert isinstance(force, np.ndarray)
    assert force.dtype == np.float64
    assert force.shape == (31,)
    assert np.all(np.isfinite(force))


@given(st.integers(1, 10**8), st.integers(1, 1000), st.sampled_from([1e-3, 1e-4, 5e-5, 1 / 3000, 2e-6]))
def test_a_step_begins_and_ends_in_the_sample_it_names(start: int, length: int, T: float):
    """Start and end are given as decimals of 15 digits, the samples come as k · T; both are rounded on their own."""
    step = StepForce(force=5, start=float(f"{start * T:.15g}"), end=float(f"{(start + length) * T:.15g}"))
    k = np.array([0, start - 1, start, start + 1, start + length - 1, start + length, start + length + 5])
    assert np.array_equal(step.at(k * T) != 0.0, (k >= start) & (k < start + length))


def test_a_step_between_samples_begins_with_the_next_one():
    assert StepForce(force=5, start=0.25).at(np.array([0.2, 0.3])).tolist() == [0.0, 5.0]
    assert StepForce(force=5, start=0.3).at(np.array([3 * 0.1, 0.1 + 0.2, 0.3 - 1e-9])).tolist() == [5.0, 5.0, 0.0]
    assert StepForce(force=5).at(np.array([-1e-9, 0.0, 1e6])).tolist() == [0.0, 5.0, 5.0]


def test_a_sine_force_begins_with_its_phase():
    load = SineForce(amplitude=50, frequency=7, phase=0.4, start=0.1, end=0.9)
    t = np.linspace(0.0, 1.0, 1001)
    acts = (np.arange(1001) >= 100) & (np.arange(1001) < 900)
    expected = np.where(acts, 50.0 * np.sin(2.0 * np.pi * 7.0 * (t - 0.1) + 0.4), 0.0)
    # 50 N times a rounding of an angle of 35 rad
    np.testing.assert_allclose(load.at(t), expected, rtol=0, atol=1e-12)


def test_a_sine_force_keeps_its_phase_after_an_hour():
    load = SineForce(amplitude=1, frequency=250)
    hour = 3600.0 + np.arange(80) / 20000
    # 3600 s is known to 4.5e-13 s, that is 7e-10 rad at 250 Hz
    np.testing.assert_allclose(load.at(hour), np.sin(2.0 * np.pi * 250.0 * np.arange(80) / 20000), rtol=0, atol=2e-9)


@given(st.sampled_from([1e-3, 1e-4, 5e-5, 1 / 3000, 0.7]), st.integers(1, 8))
def test_a_recorded_force_holds_each_row_over_its_sample(T: float, finer: int):
    row = np.random.default_rng(3).normal(size=5000)
    load = RecordedForce(force=row, sample_time=T)
    t = np.arange(5000 * finer) * (T / finer)
    assert np.array_equal(load.at(t), np.repeat(row, finer))
    outside = load.at(np.array([-T, -1e-3 * T, 5000 * T, 5001 * T]))
    assert outside.tolist() == [0.0] * 4


def test_a_sum_is_the_sum():
    t = np.linspace(0.0, 1.0, 101)
    parts = (StepForce(force=3, start=0.2), SineForce(amplitude=2, frequency=3))
    assert np.array_equal(ForceSum(loads=parts).at(t), parts[0].at(t) + parts[1].at(t))
    assert np.array_equal(ForceSum(loads=parts[:1]).at(t), parts[0].at(t))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: StepForce(force=1, start=2, end=2), r"step_force\.end = 2 s must be > step_force\.start = 2 s"),
        (lambda: SineForce(amplitude=1, frequency=1, start=2, end=1), "must be > sine_force.start"),
        (lambda: SineForce(amplitude=-1, frequency=1), ">= 0 N"),
        (lambda: SineForce(amplitude=1, frequency=0), "> 0 Hz"),
        (lambda: StepForce(force=float("nan")), "finite"),
        (lambda: StepForce(force=np.array([1.0, 2.0])), "holds variants"),
        (lambda: RecordedForce(force=[1.0, float("inf")], sample_time=1), "not finite"),
        (lambda: RecordedForce(force=[1.0, 2.0], sample_time=-1), "> 0 s"),
        (lambda: ForceSum(loads=()), "at least one"),
        (lambda: ForceSum(loads=StepForce(force=1)), "at least one"),
    ],
)
def test_what_is_refused(make: object, words: str):
    with pytest.raises((ParameterError, StructureError), match=words):
        make()  # type: ignore[operator]
