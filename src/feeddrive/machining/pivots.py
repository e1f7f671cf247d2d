"""Location errors of the rotary joints of a five-axis machine, and how a test that holds the tip shows them.

The control computes the linear joints q with the kinematics it knows; the machine turns about axes that lie elsewhere.

    error(θ) = actual.tip(nominal.linear(p, θ), θ) - p

is what a probe on the spindle measures at a sphere that is fixed at p on the workpiece, while one or both rotary joints
move and the linear ones follow, as in tests of ISO 10791-6.  For a table C whose axis lies at e beside its nominal
place, error = (I - R(z, C)) e: nothing at C = 0, and 2 e after half a turn.  `held_tip.py` has such a test through the
loops.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.language.errors import ParameterError, nearest
from feeddrive.path.kinematics import Kinematics, RotaryJoint, Vector


@dataclass(frozen=True)
class PivotError:
    """The location error of the axis of a rotary joint, actual less nominal, with all joints at 0 (ISO 230-7).

    shift  of the axis along x, y, z, m: for C E_X0C and E_Y0C
    tilt   of the axis about x, y, z, rad: for C E_A0C and E_B0C

    A shift along the axis and a turn about it have no effect.
    """

    shift: Vector = (0.0, 0.0, 0.0)
    tilt: Vector = (0.0, 0.0, 0.0)


def with_pivot_errors(kinematics: Kinematics, errors: Mapping[str, PivotError]) -> Kinematics:
    """Return the machine as it is: its rotary joints, by letter, at their actual axes.

    Raises ParameterError for a letter that is none of its rotary joints.
    """
    for letter in errors:
        if letter not in kinematics.rotary_letters:
            raise ParameterError(
                f"the machine has no rotary joint '{letter}'{nearest(letter, kinematics.rotary_letters)}"
            )

    def located(joint: RotaryJoint) -> RotaryJoint:
        error = errors.get(joint.letter, PivotError())
        # of a tilt below a hundredth the second-order part is below 5e-5 of it; the length is made 1 again
        direction = np.array(joint.direction) + np.cross(error.tilt, joint.direction)
        x, y, z = (direction / np.linalg.norm(direction)).tolist()
        a, b, c = (np.array(joint.point) + error.shift).tolist()
        return replace(joint, direction=(x, y, z), point=(a, b, c))

    table, head = (tuple(located(joint) for joint in joints) for joints in (kinematics.table, kinematics.head))
    return replace(kinematics, table=table, head=head)


def held_tip_error(nominal: Kinematics, actual: Kinematics, tip: Vector, rotary: np.ndarray) -> np.ndarray:
    """Return the error of a tip that is to stay at a point of the workpiece, in the workpiece frame, m, shape (3, n).

    nominal  kinematics of the control;  actual  those of the machine
    tip      the point, m;  rotary  rotary joints in the order of their letters, rad, shape (2, n)
    """
    place = [np.full(rotary.shape[1], x) for x in tip]
    return np.array(actual.tip(nominal.linear(place, rotary), rotary)) - np.array(place)
