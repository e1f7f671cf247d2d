"""Rope snap, noise in the force and effort: closed forms, and two independent ways to the same figure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from feeddrive.analysis.effort import effort, substeps_needed
from feeddrive.analysis.loop_model import loop_model
from feeddrive.analysis.stiffness import force_noise, mean_compliance, rope_snap, rope_snap_of_lines, summed
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import UnstableError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import compliance, linearize, loop_gain
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

STILL = SnapLimitedMove(distance=0.0, velocity=1.0, acceleration=1.0, jerk=1.0, snap=1.0)


def rigid(law, T: float = 1e-4, mass: float = 40.0, viscous: float = 0.0, encoder=None) -> Loop:
    axis = Axis(plant=Rigid(mass=mass, viscous=viscous), encoder_load=encoder)
    return Loop(control=Control(law=law), axis=axis, sample_time=T)


def dadsc(p: float) -> DADSC:
    return DADSC(mass=40.0, tracking_rate=p, reaching_rate=p, adaptation_rate=p)


@pytest.mark.parametrize(("p", "mass"), [(50.0, 40.0), (200.0, 40.0)])
def test_rope_snap_of_a_triple_pole(p: float, mass: float) -> None:
    """C = s/(m (s + p)³) gives ISE = 3/(16 m² p⁵); sampling changes it in the order of pT, here 1 % and less."""
    loop = rigid(dadsc(p), T=0.002 / p)
    expected = np.sqrt(3.0 / 16.0) / mass * p**-2.5
    assert rope_snap(loop_model(loop).closed) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("name", ["ball_screw", "linear_motor"])
def test_the_sum_over_samples_is_the_integral_over_frequency(name: str) -> None:
    """Parseval, to the error of the trapezoidal rule on 400 lines a decade."""
    loop = read_machine(name).loop("x")
    both = loop_model(loop)
    lines = both.lines(400)
    soft = compliance(loop, lines).response
    assert rope_snap(both.closed) == pytest.approx(rope_snap_of_lines(lines, soft, loop.sample_time), rel=1e-3)


def test_rope_snap_of_the_baseline_of_gordon_and_erkorkmaz() -> None:
    """P-PI on their truth plant: 9.1e-9 m s^½/N, given to two digits (and with a continuous lag of the encoder)."""
    assert rope_snap(loop_model(read_machine("ball_screw").loop("x")).closed) == pytest.approx(9.1e-9, rel=0.015)


def test_without_an_integral_the_axis_does_not_come_back() -> None:
    assert rope_snap(loop_model(rigid(CascadePPI(Kv=40.0, Kp=1e4))).closed) == np.inf


def test_an_unstable_loop_has_no_figure() -> None:
    with pytest.raises(UnstableError, match="does not end"):
        rope_snap(loop_model(rigid(CascadePPI(Kv=40.0, Kp=1e7, Tn=0.01))).closed)


def test_the_sum_by_doubling_solves_the_lyapunov_equation() -> None:
    random = np.random.default_rng(0)
    A = random.normal(size=(6, 6))
    A *= 0.97 / np.max(np.abs(np.linalg.eigvals(A)))
    Q = np.eye(6)
    P = summed(A, Q)
    assert np.allclose(P, A.T @ P @ A + Q, rtol=1e-10)


@pytest.mark.parametrize("name", ["ball_screw", "linear_motor"])
def test_a_loop_that_is_opened_and_closed_is_the_loop(name: str) -> None:
    """Poles, loop gain and compliance are those of `linearize`, `loop_gain` and `compliance`, to rounding."""
    loop = read_machine(name).loop("x")
    both = loop_model(loop)
    f = np.geomspace(1.0, 2000.0, 50)
    assert np.allclose(both.loop_gain(f).response, loop_gain(loop, f).response, rtol=1e-9)
    closed = both.closed.response(f, "position_load", "load_force").response
    assert np.allclose(closed, compliance(loop, f).response, rtol=1e-9)
    whole = linearize(loop, ["load_force"], ["position_load"])
    assert np.allclose(both.closed.poles()[:4], whole.poles()[:4], atol=1e-9)


def test_noise_in_the_force_is_what_a_run_shows() -> None:
    """White noise of 50 nm on the reading, without counts: RMS over 20000 samples, 3 % being four of its deviations."""
    loop = rigid(CascadePPI(Kv=40.0, Kp=1e4, Tn=0.02), encoder=Encoder(noise=50e-9))
    run = simulate(loop, STILL, duration=2.0, seed=3, record=["force"])
    expected = force_noise(loop_model(loop).closed, 0.0, 50e-9, shared=True)
    assert np.std(run["force"][2000:]) == pytest.approx(expected, rel=0.03)


def test_noise_in_the_force_of_a_p_law() -> None:
    """F = -G x(k) + D x(k-1) of white noise alone is √(G² + D²) σ, if the axis is too heavy to answer."""
    Kv, Kp, T = 40.0, 1e4, 1e-4
    loop = rigid(CascadePPI(Kv=Kv, Kp=Kp), T=T, mass=1e9)
    model = loop_model(loop).open
    gain, difference = Kp * (Kv + 1.0 / T), Kp / T
    through = model.D[model.outputs.index("force")][model.inputs.index("reading_load")]
    also = model.D[model.outputs.index("force")][model.inputs.index("reading_motor")]
    assert abs(through + also) == pytest.approx(gain, rel=1e-12)
    assert force_noise(loop_model(loop).closed, 0.0, 1e-9, shared=True) == pytest.approx(
        1e-9 * np.hypot(gain, difference), rel=1e-3
    )


def test_effort_counts_what_a_sample_needs() -> None:
    """A P law: set velocity by Taylor to snap and the law itself, operation by operation as the source has them."""
    plain = effort(rigid(CascadePPI(Kv=40.0, Kp=1e4)))
    # v - T (a/2 - T (j/6 - T s/24)): 6 mul, 3 sub; (x - x1)/T: sub, div by 1·T; Kv (r - x): sub, mul;
    # + share v: mul, add; - v: sub; Kp e: mul
    assert plain.operations == {"mul": 9, "sub": 6, "add": 1, "div": 1}
    assert plain.total == 17
    assert effort(rigid(CascadePPI(Kv=40.0, Kp=1e4, Tn=0.01))).total > plain.total


def test_effort_does_not_depend_on_numbers() -> None:
    loop = read_machine("ball_screw").loop("x")
    other = replace(loop, control=replace(loop.control, force_limit=1.0))
    assert effort(loop).operations == effort(other).operations


def test_mean_compliance_in_a_band() -> None:
    """|C| = c f over a decade: RMS over ln f is c [(f2² - f1²)/(2 ln f2/f1)]^½; the lines outside do not count."""
    lines = np.geomspace(1.0, 1000.0, 3001)
    expected = 2e-9 * np.sqrt((100.0**2 - 10.0**2) / (2.0 * np.log(10.0)))
    # trapezoidal rule: off by h²/3 of the integral, h = 0.0023; the band ends on lines
    found = mean_compliance(lines, 2e-9j * lines, (9.9999, 100.001))
    assert found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(("turn", "substeps"), [(0.55, 1), (0.65, 2), (1.15, 2), (1.25, 3)])
def test_a_mode_turns_by_a_tenth_of_a_turn_in_a_substep(turn: float, substeps: int) -> None:
    """2π/10 = 0.63 rad, rounded: the fastest motion of a flexible axis is followed by ten substeps a swing."""
    plant = TwoMass(mass_motor=50.0, mass_load=50.0, stiffness=1e7)
    frequency = np.sqrt(1e7 * (1.0 / 50.0 + 1.0 / 50.0))  # rad/s
    axis = Axis(plant=plant, friction_load=Coulomb(coulomb=10.0))
    law = CascadePPI(Kv=1.0, Kp=100.0)
    assert substeps_needed(Loop(control=Control(law=law), axis=axis, sample_time=turn / frequency)) == substeps
