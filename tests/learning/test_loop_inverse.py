"""The inverse of a loop: against a dense solution, and on the axis itself."""

from __future__ import annotations

from dataclasses import replace
from math import comb, factorial

import numpy as np
import pytest
from scipy.interpolate import BSpline

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.learning.loop_inverse import DEGREE, frictionless, loop_inverse
from feeddrive.learning.set_path import cardinal_spline
from feeddrive.loop.simulate import simulate
from parts import T, loop, plan

IDEAL = replace(frictionless(loop()), axis=replace(frictionless(loop()).axis, encoder_motor=None, encoder_load=None))
INVERSE = loop_inverse(loop())


@pytest.mark.parametrize("order", range(5))
def test_the_spline_and_its_derivatives(order: int) -> None:
    """Σ (-1)^i C(6, i) max(t - i, 0)^5 / 5!, and its derivatives with lower powers; the sum rounds to below 1e-12."""
    h, power = 4, 5 - order
    t = np.arange(6 * h + 1) / h
    terms = [(-1.0) ** i * comb(6, i) / factorial(power) * np.maximum(t - i, 0.0) ** power for i in range(7)]
    expected = np.sum(terms, axis=0) / float(h) ** order
    assert cardinal_spline(DEGREE, h, order) == pytest.approx(expected, abs=1e-12)


def test_the_responses_are_those_of_the_axis() -> None:
    """A pulse of 100 N on the load and on the command in sample 20: the simulated table, to 1e-12 m of some 1e-7."""
    n = 400
    force = np.zeros(n)
    force[20] = 100.0
    rest = Recorded(position=np.zeros(n), sample_time=T)
    pulse = RecordedForce(force=force, sample_time=T)
    for run, response in (
        (simulate(IDEAL, rest, load=pulse), INVERSE.by_load),
        (simulate(IDEAL, rest, added_force=pulse), INVERSE.by_force),
    ):
        predicted = np.convolve(force, response)[:n]
        assert np.max(np.abs(predicted)) > 1e-8
        assert np.max(np.abs(run["position_load"][:n] - predicted)) < 1e-12


def test_the_circular_solution_is_the_dense_one() -> None:
    """(B'B + ridge r0 I) c = B' y with dense matrices on a displacement that rests at both ends."""
    n, h, ridge = 600, 10, 0.3
    wanted = np.zeros(n)
    wanted[200:260] = 1e-6 * np.hanning(60)
    shape = cardinal_spline(DEGREE, h)
    response = np.convolve(INVERSE.by_force, shape)
    # splines far beyond both ends, since the inverse of a loop with an integrator is long
    before = 400 * h
    count = (2 * before + n) // h
    rows = count * h + response.size
    B, N = (np.zeros((rows, count)) for _ in range(2))
    for j in range(count):
        for matrix, column in ((B, response), (N, shape)):
            matrix[j * h : j * h + column.size, j] = column
    y = np.zeros(rows)
    y[before : before + n] = wanted
    r0 = float(response @ response)
    c = np.linalg.solve(B.T @ B + ridge * r0 * np.eye(B.shape[1]), B.T @ y)
    dense = (N @ c)[before : before + n]
    ours = INVERSE.force_for(wanted, h * T, ridge)
    assert np.max(np.abs(dense)) > 1.0
    assert np.max(np.abs(ours - dense)) < 1e-4 * np.max(np.abs(dense))  # the inverse is cut below 1e-5


def test_a_displacement_that_a_spline_makes_is_reached() -> None:
    """No friction, exact model, a target of the splines: a smaller ridge comes closer, to 1 % of 3.4 um with 1e-5."""
    n = 800
    force = np.zeros(n)
    shape = cardinal_spline(DEGREE, 10)
    force[300 : 300 + shape.size] = 60.0 * shape
    wanted = INVERSE.of_command(force)
    off: list[float] = []
    for ridge in (1e-3, 1e-5):
        found = INVERSE.force_for(wanted, 10 * T, ridge)
        run = simulate(
            IDEAL,
            Recorded(position=np.zeros(n), sample_time=T),
            added_force=RecordedForce(force=found, sample_time=T),
        )
        off.append(float(np.max(np.abs(run["position_load"][:n] - wanted))))
    largest = float(np.max(np.abs(wanted)))
    assert largest > 1e-6
    assert off[1] < 0.2 * off[0]
    assert off[1] < 0.01 * largest


def test_a_change_of_the_path_is_its_splines() -> None:
    """The change is the sum of its coefficients' splines, all five rows; the table follows."""
    n, h = 1200, 20
    wanted = np.zeros(n)
    wanted[300:700] = 5e-6 * np.hanning(400) ** 2
    change, c = INVERSE.path_for(wanted, h * T, 1e-5)
    knots = h * T * np.arange(-5, c.size + 1)
    for order in range(5):
        expected = (
            BSpline(knots, c, 5).derivative(order)(np.arange(n) * T)
            if order
            else BSpline(knots, c, 5)(np.arange(n) * T)
        )
        assert np.max(np.abs(change[order] - expected)) < 1e-9 * np.max(np.abs(expected))
    position, velocity, acceleration, jerk, snap = change
    path = Recorded(
        position=position, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap, sample_time=T
    )
    run = simulate(IDEAL, path)
    assert np.max(np.abs(run["position_load"][:n] - wanted)) < 5e-8  # 1 % of 5 um, by the ridge


def test_the_model_knows_its_own_following_error() -> None:
    path = plan()["x"]
    given = frictionless(loop(velocity_feedforward=0.0))
    ideal = replace(given, axis=replace(given.axis, encoder_motor=None, encoder_load=None))
    error = loop_inverse(given).following_error(path)
    run = simulate(ideal, path)
    assert np.max(np.abs(error)) > 5e-4  # the lag of 1/Kv
    assert np.max(np.abs(run["tracking_error"] - error)) < 1e-8  # the response is cut below 1e-7 of its peak


def test_what_has_no_inverse() -> None:
    control = loop().control
    slow = replace(loop(), control=replace(control, law=replace(control.law, position_every=4)))
    with pytest.raises(ParameterError, match=r"computes its position loop every 4 samples.*position_every = 1"):
        loop_inverse(slow)
    wild = replace(loop(), control=replace(control, law=CascadePPI(Kv=500.0, Kp=4e5, Tn=1e-3)))
    with pytest.raises(UnstableError, match="axis x"):
        loop_inverse(wild)
