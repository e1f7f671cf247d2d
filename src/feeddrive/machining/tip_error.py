"""Error of the tip and of the direction of a tool that five joints move, and what each joint adds to it.

With q the joints, p = tip(q) of the forward kinematics (`path/kinematics.py`), J its derivative, in the frame of the
workpiece:

    e(t) = tip(q(t)) - tip(q_set(t)),   along = e · t,   across = |e - along t|     t the tangent of the set path
    ε(t) = tip(q(t)) - the nearest point of the set path, at which the set point was at the time τ(t)
    ε    = Σ Jⱼ (qⱼ(t) - qⱼ,set(τ)) + O(q²)                                         what each joint adds
    at the tip, a rotary joint:   |Jⱼ eⱼ| = lever arm x |eⱼ|

A lag that all joints have in common moves the tool along its path and is no part of ε, nor are the joints' parts of it.
The direction of the tool is compared with the one that belongs to the nearest point: at the time τ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.language.quantity import Quantity
from feeddrive.language.series import Taylor
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.simulate import Run
from feeddrive.machining.contour import ContourError, Curve, contour_error, size, tool_columns, unit
from feeddrive.path.kinematics import LINEAR, Kinematics

# m/s: the polynomials of the joints leave a standing tip within 2 nm of its place (path/tip_proof.py)
STANDS = 1e-6
"""The speed of the set tip below which it stands: its path has no direction there."""


class JointPart(NamedTuple):
    """What one joint adds to the error of the tip, on the samples that count.

    letter     of the joint
    rms, peak  of its error at the same instant, actual less set, m or rad
    lever      the largest distance of the tip from its axis, m; None for a linear joint
    tip_rms, tip_peak  of |J e|, what this error moves at the tip, m: for a rotary joint its error at the radius
    share      its part of the mean square of the contour error; those of all joints sum to 1, and one whose error
               makes up for that of another joint is negative
    """

    letter: str
    rms: float
    peak: float
    lever: float | None
    tip_rms: float
    tip_peak: float
    share: float


@dataclass(frozen=True, eq=False, repr=False)
class TipError(Result):
    """The error of the tip and of the direction of the tool in a run, in the frame of the workpiece.

    contour    contour error of the tip, with its path, lag and samples that count
    along      error at the same instant along the path, m, positive ahead, shape (n,)
    across     its size across the path, m, shape (n,)
    direction  angle of the tool to its direction at the nearest point of the path, rad, shape (n,)
    direction_now  angle to its direction at the same instant, rad, shape (n,)
    letters    of the joints, such as XYZAC
    added      part of each joint in the contour error, m, shape (5, n): their sum is its size, to first order
    joints     figures of each joint
    """

    contour: ContourError
    along: np.ndarray
    across: np.ndarray
    direction: np.ndarray
    direction_now: np.ndarray
    letters: str
    added: np.ndarray
    joints: tuple[JointPart, ...]

    def rms(self, values: np.ndarray) -> float:
        """Return the RMS along the path of values of each sample, on those that count."""
        return float(np.sqrt(np.sum(self.contour.weights * values**2)))

    def peak(self, values: np.ndarray) -> float:
        """Return the largest size of values, shape (..., n), on the samples that count; 0 if there are none."""
        return float(np.max(np.abs(values[..., self.contour.counted]), initial=0.0))

    def numbers(self) -> dict[str, float | None]:
        """Return the figures by name, in SI units."""
        figures: dict[str, float | None] = {
            "tip_error_along_rms_m": self.rms(self.along),
            "tip_error_along_peak_m": self.peak(self.along),
            "tip_error_across_rms_m": self.rms(self.across),
            "tip_error_across_peak_m": self.peak(self.across),
            "direction_error_rms_rad": self.rms(self.direction),
            "direction_error_peak_rad": self.peak(self.direction),
            "direction_error_at_the_instant_peak_rad": self.peak(self.direction_now),
        }
        for joint in self.joints:
            figures |= {
                f"{joint.letter.lower()}.at_the_tip_rms_m": joint.tip_rms,
                f"{joint.letter.lower()}.at_the_tip_peak_m": joint.tip_peak,
                f"{joint.letter.lower()}.share_of_contour_error": joint.share,
            }
            if joint.lever is not None:
                figures[f"{joint.letter.lower()}.lever_arm_m"] = joint.lever
        return figures

    def table(self) -> Table:
        """Return a table with one row for each joint."""
        direction = Quantity(self.peak(self.direction), "rad", form="3 urad", stays=True)
        title = Text(
            f"{self.contour.name}: tip off by {Quantity(self.contour.largest, 'm')} at most, "
            f"{Quantity(self.contour.rms, 'm')} RMS, tool off its direction by {direction} at most"
        )
        return Table(title, ["joint", *joint_columns()], [[joint.letter, *joint_cells(joint)] for joint in self.joints])


def joint_columns() -> list[Column]:
    """Return the columns of a table of joints."""
    return [
        Column("error RMS"),
        Column("peak"),
        Column("lever arm", "m", "4 mm"),
        Column("at the tip RMS", "m", "3"),
        Column("peak", "m", "3"),
        Column("share of the contour error", "share", "3"),
    ]


def joint_cells(joint: JointPart) -> list[Quantity | float | None]:
    """Return the cells of a joint in the columns of `joint_columns`."""
    unit_, form = ("m", "3") if joint.lever is None else ("rad", "3 urad")
    errors = [Quantity(x, unit_, form=form, stays=True) for x in (joint.rms, joint.peak)]
    return [*errors, joint.lever, joint.tip_rms, joint.tip_peak, joint.share]


def tip_error(
    run: Run,
    kinematics: Kinematics,
    axes: Sequence[str],
    *,
    line: np.ndarray | None = None,
    counted: np.ndarray | None = None,
) -> TipError:
    """Compute the error of the tip and of the direction of the tool in a run of a five-axis machine.

    kinematics  of the machine, with the tool
    axes        axes of the run in the order of `kinematics.letters`
    line        part program line of each sample, shape (n,)
    counted     True for samples that are included in the figures, shape (n,); default: all

    The actual linear joints are the tool point of a machine with geometry errors, otherwise the tables.
    Raises ParameterError for an unknown axis, and for a tip that never moves.
    """
    wanted, velocity, acceleration = (np.stack([run[f"{axis}.{name}"] for axis in axes]) for name in _SET)
    linear = len(LINEAR)
    actual = np.stack(
        [
            *tool_columns(run, axes[:linear], "tool").T,
            *(run[f"{axis}.position_load"] for axis in axes[linear:]),
        ]
    )
    tip, tip_velocity, tip_acceleration = tip_motion(kinematics, wanted, velocity, acceleration)
    speed = size(tip_velocity)
    moves = speed > STANDS
    error = actual - wanted
    moved = np.stack(kinematics.tip_change(wanted[:linear], error[:linear], wanted[linear:], error[linear:]), axis=1)
    contour = contour_error(
        tip + moved,
        tip,
        axes=LINEAR.lower(),
        velocity=np.where(moves[:, None], tip_velocity, 0.0),
        acceleration=tip_acceleration,
        line=line,
        counted=counted,
        sample_time=run.sample_time,
        name=run.name,
    )
    tangent = unit(np.where(moves[:, None], tip_velocity, 0.0))
    along = np.einsum("ij,ij->i", moved, tangent)
    at = _instants(contour, speed, moves)
    there = _between(wanted, velocity, at, run.sample_time)
    normal = unit(contour.vector)
    parts = jacobian(kinematics, there) * (actual - there)[:, None, :]
    added = np.einsum("jin,ni->jn", parts, normal)
    arms = np.linalg.norm(jacobian(kinematics, wanted), axis=1)
    kept, weights = contour.counted, contour.weights
    whole = float(np.sum(weights * np.sum(added, axis=0) * size(contour.vector)))

    def figures(k: int, letter: str) -> JointPart:
        at_tip = arms[k] * np.abs(error[k])
        share = float(np.sum(weights * added[k] * size(contour.vector)))
        return JointPart(
            letter,
            float(np.sqrt(np.sum(weights * error[k] ** 2))),
            float(np.max(np.abs(error[k][kept]), initial=0.0)),
            None if letter in LINEAR else float(np.max(arms[k][kept], initial=0.0)),
            float(np.sqrt(np.sum(weights * at_tip**2))),
            float(np.max(at_tip[kept], initial=0.0)),
            share / whole if whole > 0.0 else 0.0,
        )

    return TipError(
        contour,
        along,
        size(moved - along[:, None] * tangent),
        _angle(kinematics, actual[linear:], there[linear:]),
        _angle(kinematics, actual[linear:], wanted[linear:]),
        kinematics.letters,
        added,
        tuple(figures(k, letter) for k, letter in enumerate(kinematics.letters)),
    )


_SET = ("set_position", "set_velocity", "set_acceleration")


def tip_motion(
    kinematics: Kinematics, position: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and acceleration of the tip, m .. m/s², shape (n, 3), from those of the joints.

    position, velocity, acceleration  of the joints in the order of `kinematics.letters`, shape (5, n)
    """
    series = [Taylor(*terms) for terms in zip(position, velocity, 0.5 * acceleration, strict=True)]
    tip = kinematics.tip(series[: len(LINEAR)], series[len(LINEAR) :])
    place, first, second = (np.stack([row.terms[k] for row in tip], axis=1) for k in range(3))
    return place, first, 2.0 * second


def jacobian(kinematics: Kinematics, position: np.ndarray) -> np.ndarray:
    """Return the derivative of the tip by each joint at joint positions of shape (5, n): m/m and m/rad, (5, 3, n)."""
    linear, ones, zeros = len(LINEAR), np.ones(position.shape[1]), np.zeros(position.shape[1])

    def column(k: int) -> np.ndarray:
        series = [Taylor(place, ones if i == k else zeros) for i, place in enumerate(position)]
        return np.stack([row.terms[1] for row in kinematics.tip(series[:linear], series[linear:])])

    return np.stack([column(k) for k in range(len(position))])


def _instants(contour: ContourError, speed: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Return the time, in samples, at which the set tip was at the nearest point of each position, shape (n,).

    Between two samples the set tip is taken as accelerated evenly.  Where it stands, it is the same instant, and a
    standstill before or after is not passed: the joints may turn there.
    """
    curve: Curve = contour.curve
    piece = np.clip(np.searchsorted(curve.along, contour.along, side="right") - 1, 0, len(curve.along) - 2)
    begin = curve.row[piece + 1] - 1
    share = (contour.along - curve.along[piece]) / np.diff(curve.along)[piece]
    v, w = speed[begin], speed[begin + 1]
    way = 0.5 * share * (v + w)
    root = v + np.sqrt(np.maximum(v * v + 2.0 * (w - v) * way, 0.0))
    at = begin + np.where(root > 0.0, 2.0 * way / np.where(root > 0.0, root, 1.0), share)
    now = np.arange(len(at), dtype=np.float64)
    # at a node the set tip is from its row to the one before the next node's
    waits = np.clip(now, curve.row[piece], begin)
    ended = np.clip(now, curve.row[-1], len(at) - 1.0)
    at = np.where(share <= 0.0, waits, np.where(contour.along >= curve.along[-1], ended, at))
    # the stretch without a standstill that a sample belongs to, with the samples at its ends
    edges = np.flatnonzero(np.diff(moves, prepend=not moves[0], append=not moves[-1]))
    stretch = np.searchsorted(edges, now, side="right") - 1
    least, most = np.maximum(edges[stretch] - 1, 0), np.minimum(edges[stretch + 1], len(at) - 1)
    return np.where(moves, np.clip(at, least, most), now)


def _between(position: np.ndarray, velocity: np.ndarray, at: np.ndarray, T: float) -> np.ndarray:
    """Return cubic interpolations of rows of positions at times in samples, shape (5, n)."""
    k = np.clip(at.astype(np.int64), 0, position.shape[1] - 2)
    u = at - k
    step = position[:, k + 1] - position[:, k]
    v, w = T * velocity[:, k], T * velocity[:, k + 1]
    b, c = 3.0 * step - 2.0 * v - w, v + w - 2.0 * step
    return position[:, k] + u * (v + u * (b + u * c))


def _angle(kinematics: Kinematics, rotary: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the angle between the tools at two rows of rotary joints, rad, shape (n,)."""
    ones = np.ones(rotary.shape[1])
    one, two = (np.stack([x * ones for x in kinematics.tool_axis(rows)], axis=1) for rows in (rotary, other))
    # an arccosine of the scalar product would lose angles below 1e-8 rad
    return 2.0 * np.arcsin(np.minimum(1.0, 0.5 * size(one - two)))
