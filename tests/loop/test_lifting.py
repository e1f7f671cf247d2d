"""Loops with two rates: lifted models and their figures against plain simulation of the same loop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.loop_model import delay_edge, gain_edge, loop_model
from feeddrive.analysis.stiffness import force_noise, rope_snap, rope_snap_of_run
from feeddrive.language.errors import DivergedError, ParameterError
from feeddrive.loop.linearize import Lifted, compliance, gain_of, lifted, linearize, loop_gain, tracking
from feeddrive.loop.loop import Loop

LINES = np.geomspace(1.0, 9000.0, 60)


def two_rates(loop: Loop, every: int, **changed: float) -> Loop:
    """The loop with its position loop in every so many samples."""
    return replace(loop, control=replace(loop.control, law=replace(loop.control.law, position_every=every, **changed)))


@pytest.fixture(scope="module")
def screw() -> Loop:
    """The ball screw without guard: some of these loops are unstable on purpose."""
    loop = fd.read_machine("ball_screw").loop("x")
    return replace(loop, control=replace(loop.control, guard=None, force_limit=None))


@pytest.fixture(scope="module")
def slide() -> Loop:
    """A rigid axis without dead time: a force on the table acts where the drive's does."""
    law = fd.blocks.CascadePPI(Kv=60.0, Kp=4e4, Tn=0.02)
    return Loop(sample_time=5e-4, control=fd.Control(law=law), axis=fd.Axis(plant=fd.blocks.Rigid(mass=100.0)))


def swinging(loop: Loop, frequency: float, samples: int) -> tuple[complex, complex]:
    """Table position and command at a frequency over a force of 1 N on the table, in the last two thirds of a run."""
    T = float(loop.sample_time)
    load = fd.blocks.SineForce(amplitude=1.0, frequency=frequency)
    hold = fd.blocks.Recorded(position=np.zeros(samples), velocity=np.zeros(samples), sample_time=T)
    run = fd.simulate(loop, hold, load=load, record=["position_load", "force"])
    first = samples // 3
    wave = np.exp(-2j * np.pi * frequency * T * np.arange(first, samples))
    position, force = (2j * np.mean(wave * run[name][first:]) for name in ("position_load", "force"))
    return complex(position), complex(force)


@pytest.mark.parametrize("every", [2, 8])
def test_one_sample_of_a_period_of_one_is_the_ordinary_model(screw: Loop, every: int) -> None:
    """N equal samples are the loop with one rate: to the rounding of solving 8 instead of 1 equation, 1e-9."""
    one = lifted(screw, ["cut", "load_force"], ["force", "position_load"])
    many = Lifted(one.samples * every)
    L, rest = gain_of(many, LINES)
    assert pytest.approx(loop_gain(screw, LINES).response, rel=1e-9) == L.response
    assert rest.shape == LINES.shape
    assert np.max(np.abs(many.poles())) == pytest.approx(np.max(np.abs(one.poles())) ** every, rel=1e-6)


@pytest.mark.parametrize(("every", "turns"), [(4, 7), (4, 31), (16, 7), (16, 27)])
def test_the_answer_to_a_sine_is_that_of_a_run(slide: Loop, every: int, turns: int) -> None:
    """Compliance and loop gain (1/(1 + L) = 1 + command/force) against sines, to 1e-5 of what the start leaves over.

    The run lasts 4608 samples, 2.3 s, its last 3072 hold whole turns of all frequencies here; the slowest motion falls
    to 1e-6 in the first 0.77 s.  31/384 of the sample rate is 161 Hz, above half of the position loop's 500 Hz / 2 at
    every = 16: 62.5 Hz.
    """
    loop = two_rates(slide, every)
    frequency = turns / (384.0 * slide.sample_time)
    position, force = swinging(loop, frequency, 4608)
    at = np.array([frequency])
    assert compliance(loop, at).response[0] == pytest.approx(position, rel=1e-5)
    assert 1.0 / (1.0 + loop_gain(loop, at).response[0]) == pytest.approx(1.0 + force, rel=1e-5)
    assert abs(compliance(slide, at).response[0] / position - 1.0) > 1e-3  # the loop with one rate answers otherwise


def grows(loop: Loop, samples: int = 6000) -> bool:
    """Whether a push on the table grows in a run: the second half against the first, after the start."""
    T = float(loop.sample_time)
    hold = fd.blocks.Recorded(position=np.zeros(samples), velocity=np.zeros(samples), sample_time=T)
    push = fd.blocks.StepForce(force=1e-3, start=T, end=3.0 * T)
    try:
        run = fd.simulate(loop, hold, load=push, record=["position_load"])
    except DivergedError:
        return True
    size = np.abs(run["position_load"])
    return float(np.max(size[2 * samples // 3 :])) > float(np.max(size[samples // 3 : 2 * samples // 3]))


@pytest.mark.parametrize("every", [2, 8, 16])
def test_the_edges_are_those_of_runs(screw: Loop, slide: Loop, every: int) -> None:
    """The gain at the edge (all of Kp, so the whole force) and the dead time: 1 % or one sample beyond, a run grows."""
    for loop in (two_rates(slide, every), two_rates(frictionless(screw), every)):
        both = loop_model(loop)
        assert isinstance(both.open, Lifted)
        edge = gain_edge(both.open)
        assert edge is not None
        law = loop.control.law
        for share, wanted in ((0.99, False), (1.01, True)):
            changed = replace(loop, control=replace(loop.control, law=replace(law, Kp=share * edge * law.Kp)))
            assert grows(changed) is wanted, (edge, share)
            assert linearize(changed, ["load_force"], ["position_load"]).is_stable() is not wanted
        late = delay_edge(both.open)
        assert late is not None
        actuator = loop.axis.actuator or fd.blocks.Actuator()
        for count, wanted in ((late, False), (late + 1, True)):
            dead = replace(actuator, dead_time=actuator.dead_time + count * loop.sample_time)
            assert grows(replace(loop, axis=replace(loop.axis, actuator=dead))) is wanted, (late, count)


def frictionless(loop: Loop) -> Loop:
    """Without what holds a small motion: friction and counts."""
    exact = fd.blocks.Encoder()
    axis = replace(loop.axis, friction_load=None, friction_motor=None, encoder_load=exact, encoder_motor=exact)
    return replace(loop, axis=axis)


@pytest.mark.parametrize("every", [4, 16])
def test_rope_snap_and_noise_of_two_rates(slide: Loop, every: int) -> None:
    """A force step at the beginning of a period, T Σ y², to 1e-6 of what 3 s leave over; noise by 2e5 samples, 2 %."""
    loop = two_rates(slide, every)
    both, T = loop_model(loop), float(loop.sample_time)
    samples = 6400
    hold = fd.blocks.Recorded(position=np.zeros(samples), velocity=np.zeros(samples), sample_time=T)
    run = fd.simulate(loop, hold, load=fd.blocks.StepForce(force=1.0, start=0.0), record=["position_load"])
    assert rope_snap(both.closed) == pytest.approx(rope_snap_of_run(run["position_load"], 1.0, T), rel=1e-6)
    samples = 200_000
    hold = fd.blocks.Recorded(position=np.zeros(samples), velocity=np.zeros(samples), sample_time=T)
    noisy = replace(loop, axis=replace(loop.axis, encoder_load=fd.blocks.Encoder(noise=1e-8)))
    run = fd.simulate(noisy, hold, record=["force"], seed=1)
    assert force_noise(both.closed, 0.0, 1e-8, shared=True) == pytest.approx(np.std(run["force"][2000:]), rel=0.02)


def test_tracking_of_two_rates_is_that_of_a_run(slide: Loop) -> None:
    """Along a sine of the setpoint and its derivatives, to 1e-4 of the amplitude."""
    loop = two_rates(slide, 8)
    T, frequency, samples = float(slide.sample_time), 12.0 / (384.0 * slide.sample_time), 4608
    angle = 2.0 * np.pi * frequency * T * np.arange(samples)
    w = 2.0 * np.pi * frequency
    sine = fd.blocks.Recorded(
        position=1e-3 * np.sin(angle),
        velocity=1e-3 * w * np.cos(angle),
        acceleration=-1e-3 * w**2 * np.sin(angle),
        jerk=-1e-3 * w**3 * np.cos(angle),
        snap=1e-3 * w**4 * np.sin(angle),
        sample_time=T,
    )
    run = fd.simulate(loop, sine, record=["position_load"])
    first = samples // 3
    found = 2j * np.mean(np.exp(-1j * angle[first:]) * run["position_load"][first:]) / 1e-3
    assert tracking(loop, np.array([frequency])).response[0] == pytest.approx(complex(found), abs=1e-4)


def test_the_axis_alone_has_one_rate(screw: Loop) -> None:
    """Opened at the actuator, no reading sees the law: the model is that of one sample, the same to the bit."""
    ports = ["cut", "load_force"], ["reading_motor", "reading_load"]
    slow, fast = linearize(two_rates(screw, 4), *ports), linearize(screw, *ports)
    assert slow.sample_time == fast.sample_time
    for a, b in ((slow.A, fast.A), (slow.B, fast.B), (slow.C, fast.C), (slow.D, fast.D)):
        assert np.array_equal(a, b)


def test_a_period_that_is_too_long_is_refused(screw: Loop) -> None:
    with pytest.raises(ParameterError, match="position_every <= 64"):
        loop_gain(two_rates(screw, 65), LINES)


def test_a_period_of_48_samples_has_a_loop_gain(screw: Loop) -> None:
    assert np.all(np.isfinite(loop_gain(two_rates(screw, 48), LINES[:2]).response))


@pytest.mark.parametrize("every", [2, 8])
def test_where_an_image_is_at_0_hz_the_loop_gain_is_that_beside_it(slide: Loop, every: int) -> None:
    """A free mass and an integral are infinite at 0 Hz; the loop of that image is closed, and its limit is finite."""
    loop = two_rates(slide, every, Tn=0.02)
    rate = 1.0 / (every * float(loop.sample_time))
    places = rate * np.arange(1, every // 2 + 1)
    # 1e-5 of the slow rate to either side is where rounding begins to decide
    there, beside = (loop_gain(loop, places + off * rate).response for off in (0.0, -1e-3))
    # 1/(1 + L) changes by 1 % over a thousandth of the slow rate at most
    assert 1.0 / (1.0 + there) == pytest.approx(1.0 / (1.0 + beside), rel=0.01)
    for off in (-0.7e-4, 0.7e-4, 1.4e-4):
        assert 1.0 / (1.0 + loop_gain(loop, places[:1] + off * rate).response) == pytest.approx(
            1.0 / (1.0 + there[:1]), rel=0.01
        )
