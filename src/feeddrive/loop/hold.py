"""The exact linear hold: how the linear core of an axis moves over a substep, for forces that are constant in it."""

from __future__ import annotations

from typing import Any, NamedTuple

from feeddrive.blocks.families import Mechanics
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number
from feeddrive.language.matrix import Matrix, Row


class Timing(NamedTuple):
    """What the dead time leaves to the structure of a loop."""

    whole: int  # samples of dead time
    partial: bool  # whether a part of a sample is left over

    def memory(self) -> int:
        """How many past commands the axis must remember."""
        return self.whole + (1 if self.partial else 0)


class Hold(NamedTuple):
    """x(t + h) = x + (Φ - 1) x + Γ u of the state x = (positions q, velocities q', drive force if it lags).

    `change` is Φ - 1, (n, n).  `new` and `old` are the columns of the drive's command in each substep: after and before
    the instant at which the dead time hands over from one command to the next; `share` is the part of each substep that
    lies after it.  `old` and `share` are empty without a partial sample.
    `forces` are the columns of a force on the motor's and on the load's body.
    """

    change: Matrix
    new: Matrix
    old: Matrix
    forces: Matrix
    share: Row = ()


def hold(mechanics: Mechanics, lag: Number | None, dead_time: Number, T: Number, substeps: int, timing: Timing) -> Hold:
    """The hold of M q'' + C q' + K q = Sᵀ f over h = T/substeps, from matrix exponentials in plain arithmetic.

    With velocities in units of a position per substep the matrix has entries of the size of (ωh)² and h/τ, so the
    series needs few squarings.  `lag` is the bandwidth of the current loop in rad/s, None without one; `dead_time` is
    in s.
    """
    h = T / substeps
    full = _columns(mechanics, lag, h, h)
    size = len(full)
    states = range(size - 3)
    change = tuple(tuple(full[i][j] for j in states) for i in states)
    forces = tuple(tuple(full[i][size - 3 + column] for i in states) for column in (1, 2))
    new = tuple(full[i][size - 3] for i in states)
    if not timing.partial:
        return Hold(change, (new,) * substeps, (), forces)
    handover = (dead_time / T - timing.whole) * substeps  # in substeps after the start of the sample
    inside = handover - ops.floor(handover)
    before = _columns(mechanics, lag, h, inside * h)
    after = _columns(mechanics, lag, h, (1.0 - inside) * h)
    late = tuple(after[i][size - 3] for i in states)
    # the old command acts first and its effect then runs on freely
    early_end = tuple(before[i][size - 3] for i in states)
    early = tuple(matrix.dot((*after[i][: size - 3], 1.0), (*early_end, early_end[i])) for i in states)
    news, olds = [], []
    for substep in range(substeps):
        passed = handover >= substep + 1.0  # the whole substep still belongs to the old command
        mixed = handover >= float(substep)  # on the boundary too: that is where the slope to the right comes from
        news.append(tuple(_pick(passed, mixed, 0.0, a, b) for a, b in zip(late, new, strict=True)))
        olds.append(tuple(_pick(passed, mixed, b, a, 0.0) for a, b in zip(early, new, strict=True)))
    share = tuple(ops.clip(substep + 1.0 - handover, 0.0, 1.0) for substep in range(substeps))
    return Hold(change, tuple(news), tuple(olds), forces, share)


def _pick(passed: Any, mixed: Any, old: Any, both: Any, new: Any) -> Any:
    if matrix.is_zero(old) and matrix.is_zero(both) and matrix.is_zero(new):
        return 0.0
    return ops.where(passed, old, ops.where(mixed, both, new))


def rate(mechanics: Mechanics, lag: Number | None, h: Number, span: Number) -> Matrix:
    """d x / d t of the linear core, times `span`, with velocities in units of a position per h.

    Rows and columns: q (n), q' (n), drive force if it lags (`lag` in rad/s), then the three inputs: the drive's command
    and the forces on the motor's and the load's body.  With h = span = 1.0 it is in SI.
    """
    n = len(mechanics.mass)
    f = [] if lag is None else [2 * n]
    size = 2 * n + len(f) + 3
    drive, motor, load = size - 3, size - 2, size - 1
    inverse = matrix.solve(mechanics.mass, _joined(mechanics))
    made = matrix.zeros(size, size)
    share = span / h
    for i in range(n):
        made[i][n + i] = share
        for j in range(n):
            made[n + i][j] = _times(-(h * span), inverse[i][j])
            made[n + i][n + j] = _times(-span, inverse[i][n + j])
        for column, row in zip((f[0] if f else drive, motor, load), inverse[i][2 * n :], strict=True):
            made[n + i][column] = _times(h * span, row)
    if lag is not None:
        made[f[0]][f[0]] = -(lag * span)
        made[f[0]][drive] = lag * span
    return tuple(tuple(row) for row in made)


def _columns(mechanics: Mechanics, lag: Number | None, h: Number, span: Number) -> Matrix:
    """Φ - 1 and the columns of drive, motor body and load body over `span`, with velocities in m/s."""
    moved = matrix.expm1(rate(mechanics, lag, h, span))
    n = len(mechanics.mass)
    velocity = range(n, 2 * n)
    return tuple(
        tuple(_unscaled(x, h, i in velocity, j in velocity) for j, x in enumerate(row)) for i, row in enumerate(moved)
    )


def _joined(mechanics: Mechanics) -> Matrix:
    """[K  C  S_driveᵀ  S_motorᵀ  S_loadᵀ], all of which are divided by M."""
    rows = (mechanics.shape[mechanics.drive], mechanics.shape[mechanics.motor], mechanics.shape[mechanics.load])
    return tuple(
        (*mechanics.stiffness[i], *mechanics.damping[i], *(row[i] for row in rows)) for i in range(len(mechanics.mass))
    )


def _times(a: Any, b: Any) -> Any:
    return 0.0 if matrix.is_zero(b) else a * b


def _unscaled(x: Any, h: Number, row_is_velocity: bool, column_is_velocity: bool) -> Any:
    """An entry of the matrix for velocities in m/s, from that for positions per substep."""
    if matrix.is_zero(x) or row_is_velocity == column_is_velocity:
        return x
    return x / h if row_is_velocity else x * h
