"""Location errors of rotary joints against their closed forms, for tables and heads."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.language.errors import ParameterError
from feeddrive.machining.pivots import PivotError, held_tip_error, with_pivot_errors
from feeddrive.path.kinematics import Kinematics

TURN = np.linspace(0.0, 2.0 * np.pi, 37)
STILL = 0.0 * TURN
TIP = (0.05, -0.03, 0.02)
TRUNNION = Kinematics.of("table_table", "AC", workpiece=(0.0, 0.0, -0.08))
FORK = Kinematics.of("head_head", "CB", (0.0, 0.0, 0.25), (0.0, 0.0, 0.25), tool_length=0.1)


def about_z(angle: np.ndarray, x: float, y: float) -> np.ndarray:
    return np.array([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, 0.0 * angle])


def test_a_machine_without_errors_holds_its_tip() -> None:
    for machine in (TRUNNION, FORK):
        same = with_pivot_errors(machine, {"C": PivotError()})
        assert np.abs(held_tip_error(machine, same, TIP, np.array([0.3 * TURN, TURN]))).max() < 1e-15


def test_a_shifted_table_c_draws_a_circle_about_the_shift() -> None:
    """error = (I - R) e: K2, C with X and Y; the same for every point of the workpiece."""
    x, y = 7e-6, -4e-6
    actual = with_pivot_errors(TRUNNION, {"C": PivotError((x, y, 3e-6))})
    for tip in (TIP, (0.2, 0.1, 0.0)):
        error = held_tip_error(TRUNNION, actual, tip, np.array([STILL, TURN]))
        # m: products of 0.2 m
        assert np.abs(error - (np.array([[x], [y], [0.0]]) - about_z(TURN, x, y))).max() < 1e-16
    half = held_tip_error(TRUNNION, actual, TIP, np.array([[0.0], [np.pi]]))
    assert half[:, 0] == pytest.approx([2.0 * x, 2.0 * y, 0.0], abs=1e-16)


def test_a_tilted_table_c_moves_the_tip_along_z_with_the_radius() -> None:
    """error = tilt x p - R(z, C) (tilt x R(z, -C) p) to first order: along z the tilt times the change of y."""
    tilt = 20e-6
    actual = with_pivot_errors(TRUNNION, {"C": PivotError(tilt=(tilt, 0.0, 0.0))})
    error = held_tip_error(TRUNNION, actual, TIP, np.array([STILL, TURN]))
    # the point of the workpiece, seen from the machine, at C: the table turns against the angle
    y = about_z(-TURN, TIP[0], TIP[1])[1]
    # second order: (20e-6)^2 times 0.1 m
    assert np.abs(error[2] - tilt * (TIP[1] - y)).max() < 1e-10


def test_a_shifted_axis_of_a_trunnion_shows_in_the_plane_across_it() -> None:
    y, z = 5e-6, -8e-6
    actual = with_pivot_errors(TRUNNION, {"A": PivotError((1e-3, y, z))})
    angle = np.linspace(-1.5, 0.5, 21)
    error = held_tip_error(TRUNNION, actual, TIP, np.array([angle, 0.0 * angle]))
    expected = np.array([y - (np.cos(angle) * y - np.sin(angle) * z), z - (np.sin(angle) * y + np.cos(angle) * z)])
    assert np.abs(error[0]).max() < 1e-16
    assert np.abs(error[1:] - expected).max() < 1e-16


def test_a_wrong_pivot_length_of_a_head_shows_with_the_tilt() -> None:
    """A pivot d too long: the tip lies d (1 - cos B) too high and d sin B behind; nothing at B = 0."""
    d = 30e-6
    actual = with_pivot_errors(FORK, {"B": PivotError((0.0, 0.0, d))})
    tilt = np.linspace(-1.2, 1.2, 13)
    error = held_tip_error(FORK, actual, TIP, np.array([tilt, 0.0 * tilt]))
    assert np.abs(error - d * np.array([-np.sin(tilt), 0.0 * tilt, 1.0 - np.cos(tilt)])).max() < 1e-15


def test_a_joint_that_the_machine_lacks_is_refused() -> None:
    with pytest.raises(ParameterError, match="the machine has no rotary joint 'B'; there are: A, C"):
        with_pivot_errors(TRUNNION, {"B": PivotError()})
