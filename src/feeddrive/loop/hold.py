"""Exact discretization: the state transition of the linear mechanics over a substep at constant forces."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from feeddrive.blocks.families import Mechanics
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number
from feeddrive.language.matrix import Matrix, Row


class Timing(NamedTuple):
    """The properties of the dead time that determine the structure of a loop."""

    whole: int  # samples of dead time
    partial: bool  # whether a part of a sample is left over

    def memory(self) -> int:
        """Return the number of past commands that the axis must remember."""
        return self.whole + (1 if self.partial else 0)

    def unchanged(self, dead_time: Number, T: Number) -> Any:
        """True if `dead_time` (s) gives the same structure as this one."""
        samples = samples_of(dead_time, T)
        whole = ops.floor(samples)
        partial = samples > whole
        return ops.both(ops.equal(whole, float(self.whole)), partial if self.partial else ops.no(partial))

    def sentence(self) -> str:
        """Return the delay structure in words."""
        return f"{self.whole} whole samples and {'a part of one' if self.partial else 'no part of one'}"


def samples_of(dead_time: Number, T: Number) -> Number:
    """Return a dead time in samples, rounded if it differs from a whole number by rounding errors only."""
    samples = dead_time / T
    near = ops.floor(samples + 0.5)
    # a quotient of two decimal numbers misses a whole one by some 1e-16 of it; a delay of 1e-9 samples changes nothing
    return ops.where(ops.absolute(samples - near) < 1e-9 * (1.0 + near), near, samples)


class Rows(NamedTuple):
    """The rows of the shape matrix S, x = S q, of the drive, the motor body and the load body of one axis."""

    drive: Row
    motor: Row
    load: Row


class Port(NamedTuple):
    """The shape-matrix rows through which the forces of one axis act on the mechanics, with lag and dead time of its
    drive.
    """

    rows: Rows
    lag: Number | None  # bandwidth of the current loop, rad/s; None without one
    dead_time: Number  # s
    timing: Timing


class Columns(NamedTuple):
    """The columns of the input matrix Γ for the forces of one axis: their effect on the state over a substep.

    If the dead time is not a whole number of samples, the drive switches from one command to the next within a sample.
    `new` and `old` are the columns of the commands after and before this switch in each substep; `share` is the
    fraction of each substep after it.  `old` and `share` are empty if the dead time is a whole number of samples.
    `forces` are the columns of a force on the motor body and on the load body.
    """

    new: Matrix
    old: Matrix
    forces: Matrix
    share: Row = ()


class Hold(NamedTuple):
    """The step x(t + h) = x + (Φ - 1) x + Γ u of one axis; x contains q, q' and, if the drive has a lag, its force.

    `change` is Φ - 1 of shape (n, n); the other fields are those of `Columns`.
    """

    change: Matrix
    new: Matrix
    old: Matrix
    forces: Matrix
    share: Row = ()

    def columns(self) -> Columns:
        """Return the columns without Φ - 1."""
        return Columns(self.new, self.old, self.forces, self.share)


class JointHold(NamedTuple):
    """The exact discretization of several axes with coupled mechanics; x contains all q, all q' and the forces of
    drives with a lag.
    """

    change: Matrix
    axes: tuple[Columns, ...]


def hold(mechanics: Mechanics, ports: Sequence[Port], T: Number, substeps: int) -> JointHold:
    """Return the exact discretization of M q'' + C q' + K q = Sᵀ f over h = T/substeps for constant f, by matrix
    exponentials in plain arithmetic.

    With velocities in position units per substep, the entries of the matrix are of the order of (ωh)² and h/τ, so the
    series needs few squarings.
    """
    h = T / substeps
    full = _columns(mechanics, ports, h, h)
    count = len(full) - 3 * len(ports)
    states = range(count)
    change = tuple(tuple(full[i][j] for j in states) for i in states)
    return JointHold(
        change,
        tuple(
            _of_port(mechanics, ports, place, full, count + 3 * place, h, T, substeps) for place in range(len(ports))
        ),
    )


def _of_port(
    mechanics: Mechanics,
    ports: Sequence[Port],
    place: int,
    full: Matrix,
    drive: int,
    h: Number,
    T: Number,
    substeps: int,
) -> Columns:
    """Return the columns of one axis; `drive` is the index of its drive in the matrix of all states and inputs."""
    count, timing = len(full) - 3 * len(ports), ports[place].timing
    states = range(count)
    forces = tuple(tuple(full[i][drive + column] for i in states) for column in (1, 2))
    new = tuple(full[i][drive] for i in states)
    if not timing.partial:
        return Columns((new,) * substeps, (), forces)
    handover = (ports[place].dead_time / T - timing.whole) * substeps  # in substeps after the start of the sample
    inside = handover - ops.floor(handover)
    before = _columns(mechanics, ports, h, inside * h)
    after = _columns(mechanics, ports, h, (1.0 - inside) * h)
    late = tuple(after[i][drive] for i in states)
    # the old command acts first and its effect then runs on freely
    early_end = tuple(before[i][drive] for i in states)
    early = tuple(matrix.dot((*after[i][:count], 1.0), (*early_end, early_end[i])) for i in states)
    news, olds = [], []
    for substep in range(substeps):
        passed = handover >= substep + 1.0  # the whole substep still belongs to the old command
        # on the boundary, too: the right-hand derivative with respect to the dead time comes from there
        mixed = handover >= float(substep)
        news.append(tuple(_pick(passed, mixed, 0.0, a, b) for a, b in zip(late, new, strict=True)))
        olds.append(tuple(_pick(passed, mixed, b, a, 0.0) for a, b in zip(early, new, strict=True)))
    share = tuple(ops.clip(substep + 1.0 - handover, 0.0, 1.0) for substep in range(substeps))
    return Columns(tuple(news), tuple(olds), forces, share)


def _pick(passed: Any, mixed: Any, old: Any, both: Any, new: Any) -> Any:
    if matrix.is_zero(old) and matrix.is_zero(both) and matrix.is_zero(new):
        return 0.0
    return ops.where(passed, old, ops.where(mixed, both, new))


def rate(mechanics: Mechanics, ports: Sequence[Port], h: Number, span: Number) -> Matrix:
    """Return the matrix of dx/dt of the linear mechanics times `span`, with velocities in position units per h.

    Rows and columns: q (n), q' (n), the forces of drives with a lag, then three inputs of each axis: the drive's
    command and the forces on the motor body and the load body.  With h = span = 1.0 it is in SI units.
    """
    n = len(mechanics.mass)
    lagging = [place for place, port in enumerate(ports) if port.lag is not None]
    first = 2 * n + len(lagging)  # input
    size = first + 3 * len(ports)
    inverse = matrix.solve(mechanics.mass, _joined(mechanics, ports))
    rows = matrix.zeros(size, size)
    share = span / h
    for i in range(n):
        rows[i][n + i] = share
        for j in range(n):
            rows[n + i][j] = _times(-(h * span), inverse[i][j])
            rows[n + i][n + j] = _times(-span, inverse[i][n + j])
        for place in range(len(ports)):
            drive, motor, load = range(first + 3 * place, first + 3 * place + 3)
            acting = 2 * n + lagging.index(place) if place in lagging else drive
            for column, row in zip((acting, motor, load), inverse[i][2 * n + 3 * place :], strict=False):
                rows[n + i][column] = _times(h * span, row)
    for state, place in enumerate(lagging, 2 * n):
        lag = ports[place].lag
        assert lag is not None
        rows[state][state] = -(lag * span)
        rows[state][first + 3 * place] = lag * span
    return tuple(tuple(row) for row in rows)


def _columns(mechanics: Mechanics, ports: Sequence[Port], h: Number, span: Number) -> Matrix:
    """Return Φ - 1 and the columns of drive, motor body and load body of each axis over `span`, velocities in m/s."""
    moved = matrix.expm1(rate(mechanics, ports, h, span))
    n = len(mechanics.mass)
    velocity = range(n, 2 * n)
    return tuple(
        tuple(_unscaled(x, h, i in velocity, j in velocity) for j, x in enumerate(row)) for i, row in enumerate(moved)
    )


def _joined(mechanics: Mechanics, ports: Sequence[Port]) -> Matrix:
    """Return [K  C  S_driveᵀ  S_motorᵀ  S_loadᵀ of each axis], before division by M."""
    rows = [row for port in ports for row in port.rows]
    return tuple(
        (*mechanics.stiffness[i], *mechanics.damping[i], *(row[i] for row in rows)) for i in range(len(mechanics.mass))
    )


def _times(a: Any, b: Any) -> Any:
    # a literal zero stays one: no operation in a trace
    return 0.0 if matrix.is_zero(b) else a * b


def _unscaled(x: Any, h: Number, row_is_velocity: bool, column_is_velocity: bool) -> Any:
    """Convert a matrix entry from velocities in position units per substep to velocities in m/s."""
    if matrix.is_zero(x) or row_is_velocity == column_is_velocity:
        return x
    return x / h if row_is_velocity else x * h
