"""Linear models against closed forms, against an injected sine in the nonlinear loop, and against python-control."""

from __future__ import annotations

import dataclasses

import control
import numpy as np
import pytest

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import compliance, linearize, loop_gain, tracking, zeros
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

T = 5e-5


class Standing(Reference):
    """At 0 for ever."""

    @property
    def duration(self) -> float:
        return 1.0

    def at(self, t: np.ndarray) -> Setpoint:
        zero = np.zeros_like(t)
        return Setpoint(zero, zero, zero, zero, zero)


def ball_screw(**changes: object) -> Loop:
    """The design plant of Gordon & Erkorkmaz 2013 under P-PI, 20 kHz, 70 us of dead time, a 1.5 kHz current loop."""
    return Loop(
        sample_time=T,
        control=Control(law=CascadePPI(Kv=60, Kp=4e4, Tn=0.01), filters=(Notch(frequency=460),)),
        axis=Axis(
            plant=TwoMass(
                mass_motor=130, mass_load=33, stiffness=1.8e7, damping=700, viscous_motor=1500, viscous_load=20
            ),
            actuator=Actuator(dead_time=7e-5, current_loop=1500),
            **changes,  # type: ignore[arg-type]
        ),
    )


def test_rigid_compliance_has_the_closed_form_of_the_sampled_loop() -> None:
    """P position loop over a P velocity loop on a mass under zero-order hold, worked out by hand in z."""
    mass, Kv, Kp = 40.0, 100.0, 2e4
    loop = Loop(sample_time=T, control=Control(law=CascadePPI(Kv=Kv, Kp=Kp)), axis=Axis(plant=Rigid(mass=mass)))
    f = np.geomspace(1.0, 9000.0, 200)
    z = np.exp(2j * np.pi * f * T)
    plant = T * T / (2 * mass) * (z + 1) / (z - 1) ** 2
    law = Kp * (Kv + (1 - 1 / z) / T)
    # both ways solve the same rational function; rounding near z = 1 costs 1/|z-1|² = 1e7 ulp at 1 Hz
    assert compliance(loop, f).response == pytest.approx(plant / (1 + plant * law), rel=1e-8)
    assert loop_gain(loop, f).response == pytest.approx(plant * law, rel=1e-8)


@pytest.mark.parametrize("frequency", [20.0, 60.0, 150.0])
def test_compliance_equals_a_sine_injected_into_the_simulated_loop(frequency: float) -> None:
    class Sine(Load):
        def at(self, t: np.ndarray) -> np.ndarray:
            return np.sin(2 * np.pi * frequency * t)

    loop = ball_screw()
    run = simulate(loop, Standing(), load=Sine(), duration=1.0, record=["position_load"])
    last = run.time.size - 1 - round(0.4 / T)
    wave = np.exp(-2j * np.pi * frequency * run.time[last:-1])
    # 0.4 s hold whole periods of each frequency; the force is sin = Im e^jωt, so its phasor is -j
    measured = 2 * np.mean(run["position_load"][last:-1] * wave) * 1j
    modelled = compliance(loop, np.array([frequency])).response[0]
    # the transient of the slowest pole (|z| from the poles) has decayed by e^-20 before the window
    assert abs(measured / modelled - 1) < 1e-6


def test_response_equals_that_of_python_control() -> None:
    model = linearize(ball_screw(), ["load_force", "set_position"], ["position_load", "force"])
    f = np.geomspace(0.5, 9000, 50)
    theirs = model.to_control()(np.exp(2j * np.pi * f * T))
    for i, output in enumerate(model.outputs):
        for j, given in enumerate(model.inputs):
            ours = model.response(f, output, given).response
            # two solvers of one linear system; its condition grows towards z = 1
            assert ours == pytest.approx(theirs[i, j], rel=1e-7, abs=1e-25)


def test_poles_are_inside_for_a_stable_loop_and_outside_for_one_that_diverges() -> None:
    assert linearize(ball_screw(), ["load_force"], ["position_load"]).is_stable()
    rigid = Loop(sample_time=T, control=Control(law=CascadePPI(Kv=100, Kp=3e6)), axis=Axis(plant=Rigid(mass=40)))
    # Kp T/m = 3.75: each sample takes away 3.75 times the velocity error, so that the error grows from sample to sample
    assert not linearize(rigid, ["load_force"], ["position_load"]).is_stable()


def test_tracking_with_full_derivatives_of_a_feedforward_axis_is_one_at_low_frequency() -> None:
    from feeddrive.blocks.feedforward.inertia import Inertia

    loop = Loop(
        sample_time=T,
        control=Control(law=CascadePPI(Kv=100, Kp=2e4), feedforward=(Inertia(mass=40, viscous=60),)),
        axis=Axis(plant=Rigid(mass=40, viscous=60)),
    )
    f = np.array([1.0, 10.0, 50.0])
    # what is left is the hold's staircase: its relative error is of order (2πfT)², 2.5e-4 at 50 Hz
    assert np.all(np.abs(tracking(loop, f).response - 1) < (2 * np.pi * f * T) ** 2)


def test_friction_counts_with_its_slope_when_sliding_and_holds_when_stuck() -> None:
    loop = Loop(
        sample_time=T,
        control=Control(law=CascadePPI(Kv=100, Kp=2e4)),
        axis=Axis(plant=Rigid(mass=40), friction_load=Coulomb(coulomb=50, viscous=60)),
    )
    bare = Loop(sample_time=T, control=loop.control, axis=Axis(plant=Rigid(mass=40, viscous=60)))
    f = np.geomspace(1, 5000, 30)
    # Coulomb friction has slope 0 while sliding; its viscous part is the same linear core
    assert compliance(loop, f).response == pytest.approx(compliance(bare, f).response, rel=1e-12)
    stuck = linearize(loop, ["load_force"], ["position_load"], velocity=0.0)
    # a stuck body does not move, up to the rounding of one clip: 1e-16 of the free motion
    assert np.all(np.abs(stuck.response(f).response) < 1e-9 * np.abs(compliance(bare, f).response))


def test_the_quantiser_counts_as_a_straight_line() -> None:
    plain, coarse = (
        ball_screw(),
        ball_screw(encoder_load=Encoder(resolution=1e-6), encoder_motor=Encoder(resolution=1e-6)),
    )
    f = np.geomspace(1, 5000, 30)
    assert np.array_equal(loop_gain(plain, f).response, loop_gain(coarse, f).response)


@pytest.mark.parametrize(("every", "edge"), [(1, 516.0), (2, 372.0), (4, 250.0), (8, 157.0), (16, 93.0)])
def test_a_slow_position_loop_is_judged_over_its_whole_period(every: int, edge: float) -> None:
    """Edges of Kv found by simulation, to three digits, by somebody who had not read this code."""

    def stable(Kv: float) -> bool:
        loop = Loop(
            sample_time=1e-3,
            control=Control(law=CascadePPI(Kv=Kv, Kp=2e4, position_every=every)),
            axis=Axis(plant=Rigid(mass=100), actuator=Actuator(dead_time=1e-3)),
        )
        return linearize(loop, ["set_position", "load_force"], ["position_load", "force"]).is_stable()

    assert stable(0.98 * edge)
    assert not stable(1.02 * edge)


def test_the_force_limit_is_left_out() -> None:
    """At the operating point a law without velocity feedforward asks -Kp v, which may lie beyond the limit."""
    free = ball_screw()
    held = dataclasses.replace(free, control=dataclasses.replace(free.control, force_limit=1.0))
    f = np.geomspace(1, 5000, 30)
    assert np.array_equal(loop_gain(free, f).response, loop_gain(held, f).response)


def test_probes_close_the_algebra_of_the_loop() -> None:
    """With S = 1/(1 + L): added force to command is -L S; noise of the load's reading acts like -setpoint."""
    loop = ball_screw()
    f = np.geomspace(1, 9000, 60)
    L = loop_gain(loop, f).response
    model = linearize(loop, ["added_force", "reading_load", "reading_motor", "set_position"], ["force"])
    assert model.response(f, "force", "added_force").response == pytest.approx(-L / (1 + L), rel=1e-7)
    # P-PI without velocity feedforward of the position setpoint: the load's reading enters only as Kv (x_set - x_load)
    noise = model.response(f, "force", "reading_load").response
    assert noise == pytest.approx(-model.response(f, "force", "set_position").response, rel=1e-7)


def test_names_and_frequencies_that_are_not_there_are_refused() -> None:
    loop = ball_screw()
    with pytest.raises(ParameterError, match="there is no input 'load'"):
        linearize(loop, ["load"], ["force"])
    with pytest.raises(ParameterError, match="an input is named twice in cut, cut"):
        linearize(loop, ["cut", "cut"], ["force"])
    with pytest.raises(ParameterError, match="there is no signal 'forces'"):
        linearize(loop, ["load_force"], ["forces"])
    with pytest.raises(ParameterError, match="beyond Nyquist, 10000 Hz"):
        compliance(loop, np.array([20000.0]))


def test_control_sees_the_same_poles() -> None:
    model = linearize(ball_screw(), ["load_force"], ["position_load"])
    theirs = control.poles(model.to_control())
    assert np.sort_complex(theirs) == pytest.approx(np.sort_complex(model.poles()), abs=1e-9)


@pytest.mark.parametrize(("zero", "is_finite"), [(0.75e6, True), (1.5e6, False)])
def test_a_zero_beyond_a_million_is_at_infinity(zero: float, is_finite: bool) -> None:
    """(z - zero)/z = 1 - zero/z; rounding makes a zero at infinity a large finite one."""
    found = zeros(np.array([[0.0]]), np.array([1.0]), np.array([-zero]), 1.0)
    assert found == pytest.approx([zero]) if is_finite else found.size == 0
