"""The substep of an axis, of axes coupled by structure modes, and of a machine with couplings between its axes."""

from __future__ import annotations

import keyword
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

from feeddrive.blocks.families import Coupling, Friction, Mechanics, SharedMode, SharedSpring
from feeddrive.blocks.signals import Motion
from feeddrive.language import matrix, ops
from feeddrive.language.block import Number, Rule
from feeddrive.language.errors import ParameterError
from feeddrive.language.matrix import Row
from feeddrive.loop.axis import Axis, slow_enough
from feeddrive.loop.hold import Columns, Hold, JointHold, Rows, Timing, hold

_ALONE = "axis"  # name of the axis in a core of one axis


class Shared(NamedTuple):
    """The coordinates (m) and velocities (m/s) of the structure modes that several axes share."""

    position: tuple[Number, ...] = ()
    velocity: tuple[Number, ...] = ()


class Acting(NamedTuple):
    """The forces on an axis during one sample: the drive commands after and before the switch from one command to the
    next (see `Columns`), and a constant force on the load.
    """

    new: Number  # N, or m/s of a drive with a velocity loop
    old: Number | None  # the same; None without a part of a sample of dead time
    load: Number | None  # N; None: none


class Push(NamedTuple):
    """The forces in N on the motor body and the load body; None for no force."""

    motor: Any = None
    load: Any = None

    def __add__(self, other: tuple[Any, ...]) -> Push:  # type: ignore[override]
        return Push(_sum(self.motor, other[0]), _sum(self.load, other[1]))


class Core:
    """Axes whose linear mechanics form one joint system.

    The coordinates are those of the axes, one axis after the other, followed by the shared modes; springs act between
    tables. A mode η adds shape · η to the position of each body that it moves, and a force on the body acts on the mode
    with the same factor:

        mass η'' + damping η' + stiffness η = Σ shape · f

    For a single axis without modes, the arithmetic is the same as for the axis alone.
    """

    def __init__(
        self, axes: Mapping[str, Axis], modes: Sequence[SharedMode] = (), springs: Sequence[SharedSpring] = ()
    ) -> None:
        self.axes, self.modes, self.springs = dict(axes), tuple(modes), tuple(springs)
        self._plain = {name: axis.plant.mechanics() for name, axis in self.axes.items()}
        self._places: dict[str, range] = {}
        for name, plain in self._plain.items():
            begin = sum(map(len, self._places.values()))
            self._places[name] = range(begin, begin + len(plain.mass))
        self._own = sum(map(len, self._places.values()))

    def prepare(self, T: Number, timings: Mapping[str, Timing]) -> JointHold:
        """Compute the exact discretization of the joint linear mechanics."""
        joint = self.mechanics()
        ports = [axis.port(self._rows(name), timings[name]) for name, axis in self.axes.items()]
        return hold(joint, ports, T, self.substeps())

    def substeps(self) -> int:
        """Return the number of substeps, the same for every axis."""
        return next(iter(self.axes.values())).substeps

    def mechanics(self) -> Mechanics:
        """Return the joint mass, damping and stiffness matrices, without a shape matrix; the damping includes viscous
        friction.
        """
        size = self._own + len(self.modes)
        mass, damping, stiffness = (matrix.zeros(size, size) for _ in range(3))
        for name, plain in self._plain.items():
            for i, row in enumerate(self._places[name]):
                for j, column in enumerate(self._places[name]):
                    mass[row][column], stiffness[row][column] = plain.mass[i][j], plain.stiffness[i][j]
                    damping[row][column] = plain.damping[i][j]
        for place, mode in enumerate(self.modes, self._own):
            mass[place][place], damping[place][place] = mode.mass, mode.damping
            stiffness[place][place] = mode.stiffness
        total: Any = tuple(map(tuple, damping))
        for name, axis in self.axes.items():
            rows = self._rows(name)
            for friction, row in ((axis.friction_motor, rows.motor), (axis.friction_load, rows.load)):
                if friction is not None:
                    total = matrix.add(total, axis.viscous(friction, row))
        stiff: Any = tuple(map(tuple, stiffness))
        for spring in self.springs:
            stretch = self._stretch(spring)
            stiff = matrix.add(stiff, _outer(spring.stiffness, stretch))
            total = matrix.add(total, _outer(spring.damping, stretch))
        return Mechanics(tuple(map(tuple, mass)), total, stiff, ())

    def _stretch(self, spring: SharedSpring) -> Row:
        """Return the row vector that maps all coordinates to the elongation of a spring."""
        rows = [matrix.scale(share, (self._rows(name).load,)) for name, share in spring.shares.items()]
        first, *rest = rows
        for row in rest:
            first = matrix.add(first, row)
        return first[0]

    def _rows(self, name: str) -> Rows:
        """Return the shape-matrix rows of the drive, the motor body and the load body of an axis over all coordinates.

        A mode acts on the drive and the motor body with its shape at the motor, and on the load body with its shape at
        the load, even where the two are one body.
        """
        plain, place = self._plain[name], self._places[name]
        before, after = (0.0,) * place.start, (0.0,) * (self._own - place.stop)
        shapes = [mode.shapes.get(name, (0.0, 0.0)) for mode in self.modes]
        motor, load = tuple(motor for motor, _ in shapes), tuple(load for _, load in shapes)
        return Rows(
            drive=(*before, *plain.shape[plain.drive], *after, *motor),
            motor=(*before, *plain.shape[plain.motor], *after, *motor),
            load=(*before, *plain.shape[plain.load], *after, *load),
        )

    def motion(self, name: str, states: Mapping[str, Axis.State], shared: Shared) -> Motion:
        """Return the true position and velocity of the motor body and the load body of an axis."""
        _, motor, load = self._rows(name)
        position, velocity = self._joined(states, shared)
        return Motion(
            position_motor=matrix.dot(motor, position),
            position_load=matrix.dot(load, position),
            velocity_motor=matrix.dot(motor, velocity),
            velocity_load=matrix.dot(load, velocity),
        )

    def middle(self, name: str, states: Mapping[str, Axis.State], shared: Shared, h: Number) -> Motion:
        """Return the predicted motion in the middle of a substep, x + v h/2."""
        motion, half = self.motion(name, states, shared), 0.5 * h
        return motion._replace(
            position_motor=motion.position_motor + half * motion.velocity_motor,
            position_load=motion.position_load + half * motion.velocity_load,
        )

    def _joined(self, states: Mapping[str, Axis.State], shared: Shared) -> tuple[Row, Row]:
        position = (x for name in self.axes for x in states[name].position)
        velocity = (x for name in self.axes for x in states[name].velocity)
        return (*position, *shared.position), (*velocity, *shared.velocity)

    def substep(
        self,
        prepared: JointHold,
        states: Mapping[str, Axis.State],
        shared: Shared,
        acting: Mapping[str, Acting],
        pushes: Mapping[str, Push],
        index: int,
        time: Number,
        h: Number,
    ) -> tuple[dict[str, Axis.State], Shared, dict[str, Axis.Step]]:
        """Compute one substep h (s) that starts at `time`: the linear mechanics are integrated exactly, friction is
        evaluated at the end of the substep, and all other forces in its middle.

        pushes  forces from outside the axes, such as those of couplings, constant over the substep
        """
        held = dict(states)
        drives: dict[str, Number] = {}
        columns = dict(zip(self.axes, prepared.axes, strict=True))
        lag = 2 * (self._own + len(self.modes))
        total: dict[str, Push] = {}
        for name, axis in self.axes.items():
            at = acting[name]
            drives[name] = _mean_drive(prepared.change, columns[name], states[name], lag, index, at)
            lag += len(states[name].drive)
            push, loop = Push(None, at.load), axis.actuator.velocity_loop
            if loop is not None:
                # the command is a velocity, and what acts is the force that the drive makes of it
                speed = self.motion(name, states, shared).velocity_motor
                after, drives[name] = loop.step(states[name].velocity_loop, drives[name], speed, h)
                held[name] = held[name]._replace(velocity_loop=after)
                push = push + Push(drives[name])
            if axis.forces:
                # at the middle: taken at the start of the substep, they would add energy to an oscillation
                motion, remembered = self.middle(name, states, shared, h), list[Any]()
                for force, memory in zip(axis.forces, states[name].forces, strict=True):
                    memory, *terms = force.step(memory, axis.plant, motion, drives[name], time + 0.5 * h, h)
                    push = push + tuple(terms)
                    remembered.append(memory)
                held[name] = held[name]._replace(forces=tuple(remembered))
            total[name] = push + pushes[name] if name in pushes else push
        free = self._free(prepared, states, shared, acting, total, columns, index)
        return self._settled(held, states, shared, free, columns, drives, h)

    def _free(
        self,
        prepared: JointHold,
        states: Mapping[str, Axis.State],
        shared: Shared,
        acting: Mapping[str, Acting],
        pushes: Mapping[str, Push],
        columns: Mapping[str, Columns],
        index: int,
    ) -> Row:
        """Return the state at the end of the substep as it would be without friction."""
        position, velocity = self._joined(states, shared)
        before = (*position, *velocity, *(x for name in self.axes for x in states[name].drive))
        free: list[Any] = []
        for i, x in enumerate(before):
            change = matrix.dot(prepared.change[i], before)
            for name, column in columns.items():
                if self.axes[name].actuator.velocity_loop is None:
                    change = plus(change, column.new[index][i], acting[name].new)
                    if acting[name].old is not None:
                        change = plus(change, column.old[index][i], acting[name].old)
                change = plus(change, column.forces[0][i], pushes[name].motor)
                change = plus(change, column.forces[1][i], pushes[name].load)
            # the change is summed alone and added last: x is much larger, and would cost the change its digits
            free.append(x if matrix.is_zero(change) else x + change)
        return tuple(free)

    def _settled(
        self,
        held: dict[str, Axis.State],
        states: Mapping[str, Axis.State],
        shared: Shared,
        free: Row,
        columns: Mapping[str, Columns],
        drives: Mapping[str, Number],
        h: Number,
    ) -> tuple[dict[str, Axis.State], Shared, dict[str, Axis.Step]]:
        """Return the state at the end of the substep with friction forces that are consistent with its velocities."""
        contacts: list[Contact] = []
        owners: list[tuple[str, str]] = []
        for name, axis in self.axes.items():
            rows, state = self._rows(name), states[name]
            if axis.friction_motor is not None:
                contacts.append(Contact(axis.friction_motor, state.friction_motor, rows.motor, columns[name].forces[0]))
                owners.append((name, "friction_motor"))
            if axis.friction_load is not None:
                contacts.append(Contact(axis.friction_load, state.friction_load, rows.load, columns[name].forces[1]))
                owners.append((name, "friction_load"))
        # Six sweeps if a force on one body moves another at once. Over a spring the effect within one substep is small,
        # and two suffice.
        at_once = bool(self.modes) or any(share_mass(plain) for plain in self._plain.values())
        sweeps = 1 if len(contacts) < 2 else 6 if at_once else 2
        position, velocity = self._joined(states, shared)
        end, answers = settle(contacts, position, velocity, free, h, sweeps)
        steps = {name: Axis.Step(0.0, 0.0, drives[name]) for name in self.axes}
        for (name, which), answer in zip(owners, answers, strict=True):
            held[name] = held[name]._replace(**{which: answer.state})
            steps[name] = steps[name]._replace(**{which: answer.force})
        n = self._own + len(self.modes)
        lag = 2 * n
        for name, place in self._places.items():
            moved = slice(place.start, place.stop), slice(n + place.start, n + place.stop)
            lags = slice(lag, lag + len(states[name].drive))
            held[name] = held[name]._replace(
                position=tuple(end[moved[0]]), velocity=tuple(end[moved[1]]), drive=tuple(end[lags])
            )
            lag = lags.stop
        return held, Shared(tuple(end[self._own : n]), tuple(end[n + self._own : 2 * n])), steps


def _outer(factor: Number, row: Row) -> matrix.Matrix:
    """Return factor · rowᵀ row."""
    return matrix.multiply([[x] for x in matrix.scale(factor, (row,))[0]], (row,))


def acting(columns: Columns | Hold, state: Axis.State, command: Number, load: Number | None) -> tuple[Acting, Any]:
    """Return the forces during the sample in which a command (N) is issued, and the axis state with this command
    stored.
    """
    commands = (command, *state.pending)
    partial = len(columns.old) > 0
    # newest first: the last commands are those whose dead time ends in this sample
    forces = Acting(commands[-2] if partial else commands[-1], commands[-1] if partial else None, load)
    return forces, state._replace(pending=commands[: len(state.pending)])


def advance(
    axis: Axis, prepared: Hold, state: Axis.State, command: Number, load: Number | None, time: Number, T: Number
) -> tuple[Axis.State, Axis.Step]:
    """Advance a single axis from kT to (k+1)T under a command and a constant load force (None if absent), in N."""
    core, joint = Core({_ALONE: axis}), JointHold(prepared.change, (prepared.columns(),))
    at, after = acting(prepared, state, command, load)
    h = T / axis.substeps
    name = _ALONE
    states, shared, steps = {name: state}, Shared(), {name: Axis.Step(0.0, 0.0, at.new)}
    for index in range(axis.substeps):
        states, shared, steps = core.substep(joint, states, shared, {name: at}, {}, index, time + index * h, h)
    return states[name]._replace(pending=after.pending), steps[name]


def _sum(a: Any, b: Any) -> Any:
    """Return a + b, omitting absent terms."""
    if a is None or matrix.is_zero(a):
        return b
    return a if b is None or matrix.is_zero(b) else a + b


def _mean_drive(change: matrix.Matrix, columns: Columns, state: Axis.State, lag: int, index: int, at: Acting) -> Number:
    """Return the mean drive force in N over a substep, including a switch from one command to the next within it.

    `lag` is the index of the drive force among the states, if the drive has a lag.
    """
    if state.drive:
        moved = change[lag][lag] * state.drive[0] + columns.new[index][lag] * at.new
        if at.old is not None:
            moved = moved + columns.old[index][lag] * at.old
        # mean of both ends: of second order in the substep, as the forces that it is for
        return state.drive[0] + 0.5 * moved
    return at.new if at.old is None else at.old + columns.share[index] * (at.new - at.old)


class Contact(NamedTuple):
    """The friction model of one body, its state, and the body's row and column in the linear mechanics."""

    friction: Friction
    state: Any
    row: Row  # of the shape matrix: the body's position is row · q
    column: Row  # of the hold: what a force on the body does to (q, q', ...)


class Answer(NamedTuple):
    """The result of a contact: its new state, the force in N, and whether the body is stuck."""

    state: Any
    force: Any
    stuck: Any


def settle(
    contacts: Sequence[Contact],
    position: Row,
    velocity: Row,
    free: Row,
    h: Number,
    sweeps: int,
) -> tuple[list[Any], list[Answer]]:
    """Return the state at the end of a substep h (s), including friction, and the result of each contact.

    `free` is the state at the end of the substep without friction.  Each contact is solved in turn with the latest
    forces of the others (Gauss-Seidel), `sweeps` times.
    """
    n = len(position)
    answers: list[Answer | None] = [None] * len(contacts)
    for _ in range(sweeps):
        for i, contact in enumerate(contacts):
            end = matrix.dot(contact.row, free[n : 2 * n])
            for other, answer in zip(contacts, answers, strict=True):
                if other is not contact and answer is not None:
                    end = plus(end, matrix.dot(contact.row, other.column[n : 2 * n]), answer.force)
            mobility = matrix.dot(contact.row, contact.column[n : 2 * n])
            start = matrix.dot(contact.row, velocity)
            answers[i] = Answer(*contact.friction.contact(h, contact.state, start, end, mobility))
    solved = [answer for answer in answers if answer is not None]
    after = list(free)
    # all forces before any stop, since a stop sets velocities that no later force may change
    for contact, answer in zip(contacts, solved, strict=True):
        after = [plus(x, column, answer.force) for x, column in zip(after, contact.column, strict=True)]
    for contact, answer in zip(contacts, solved, strict=True):
        # a literal False is a friction that never sticks
        if answer.stuck is not False:
            _stop(contact.row, answer.stuck, after, position, velocity, h)
    return after, solved


def plus(x: Any, column: Any, force: Any) -> Any:
    """Return x + column · force, omitting absent terms."""
    if force is None or matrix.is_zero(column) or matrix.is_zero(force):
        return x
    return column * force if matrix.is_zero(x) else x + column * force


def share_mass(mechanics: Mechanics) -> bool:
    """True if a force on the motor body directly accelerates the load body, through a full mass matrix or in a modal
    model.
    """
    n = len(mechanics.mass)
    full = any(not matrix.is_zero(mechanics.mass[i][j]) for i in range(n) for j in range(n) if i != j)
    motor, load = mechanics.shape[mechanics.motor], mechanics.shape[mechanics.load]
    return full or any(not matrix.is_zero(a) and not matrix.is_zero(b) for a, b in zip(motor, load, strict=True))


def _stop(row: Row, stuck: Any, end: list[Any], position: Row, velocity: Row, h: Number) -> None:
    """Set the velocity of a body that sticks at the end of a substep to exactly zero.

    The velocity of the last coordinate with a factor of 1 is set to minus the contribution of all others; with any
    other coordinate, rounding would keep the sum row · q' from being exactly 0.  The body is assumed to decelerate
    uniformly to rest at x + v h/2, so it keeps its position if it was at rest.  Without this correction the body would
    creep under a loaded spring, since the friction force is a mean over the substep.  Where two bodies share a
    coordinate, as in a modal model, the velocity of the second is exactly zero, that of the first only up to rounding.
    """
    last = max((i for i, share in enumerate(row) if matrix.is_one(share)), default=None)
    if last is None:
        return
    n = len(position)
    others = [*row[:last], *row[last + 1 :]]
    moving = matrix.dot(others, [*end[n : n + last], *end[n + last + 1 : 2 * n]])
    end[n + last] = ops.where(stuck, 0.0 if matrix.is_zero(moving) else -moving, end[n + last])
    # a body alone hangs on no spring that could make it creep
    if n > 1:
        place = matrix.dot(row, position) + (0.5 * h) * matrix.dot(row, velocity)
        aside = matrix.dot(others, [*end[:last], *end[last + 1 : n]])
        end[last] = ops.where(stuck, place if matrix.is_zero(aside) else place - aside, end[last])


class Joint:
    """The physics of axes by name with the couplings between them: a machine without its controllers.

    Axes that share structure modes are discretized together; every other axis is discretized separately.  Couplings act
    at common substeps, based on the motions of all axes at the same instant.
    """

    class Prepared(NamedTuple):
        """The numbers that `prepare` computes from the parameters of the axes and the couplings."""

        cores: tuple[JointHold, ...]
        couplings: tuple[Any, ...]

    class State(NamedTuple):
        """The states of the axes by name, of the modes of each core, and of the couplings."""

        axis: Any
        shared: tuple[Shared, ...]
        couplings: tuple[Any, ...]

    def __init__(self, axes: Mapping[str, Axis], couplings: tuple[Coupling, ...]) -> None:
        self.axes, self.couplings = dict(axes), couplings
        self.cores = self._cores()
        self._where = {name: place for place, core in enumerate(self.cores) for name in core.axes}

    def _cores(self) -> list[Core]:
        """Return the groups of axes that share modes or springs, in the order of the axes."""
        groups: list[tuple[list[str], list[Any], list[Any]]] = [([name], [], []) for name in self.axes]
        for coupling in self.couplings:
            modes, springs = coupling.modes(), coupling.springs()
            if modes or springs:
                joined = [group for group in groups if set(group[0]) & set(coupling.axes())]
                # a coupling between several groups makes them one
                first = joined[0]
                for other in joined[1:]:
                    for mine, theirs in zip(first, other, strict=True):
                        mine.extend(theirs)
                    groups.remove(other)
                first[1].extend(modes)
                first[2].extend(springs)
        axes = ({name: axis for name, axis in self.axes.items() if name in names} for names, *_ in groups)
        return [Core(group_axes, modes, springs) for group_axes, (_, modes, springs) in zip(axes, groups, strict=True)]

    def substeps(self) -> int:
        """Return the number of substeps, which is the same for every axis."""
        return self.cores[0].substeps()

    def rules(self, T: Number) -> Iterator[Rule]:
        """Yield the conditions that couplings and shared modes must satisfy at the substep length."""
        h = T / self.substeps()
        for core in self.cores:
            if core.modes or core.springs:
                yield from slow_enough(
                    core.mechanics(),
                    None,
                    h,
                    f"the {'modes' if core.modes else 'springs'} under {', '.join(core.axes)}",
                )
        for coupling in self.couplings:
            yield from coupling.substep_rules(h)

    def prepare(self, T: Number, timings: Mapping[str, Timing]) -> Prepared:
        """Compute everything that depends on parameters only."""
        h = T / self.substeps()
        holds = tuple(core.prepare(T, timings) for core in self.cores)
        return self.Prepared(holds, tuple(coupling.prepare(h) for coupling in self.couplings))

    def start(self, prepared: Prepared, states: Mapping[str, Axis.State], motions: Mapping[str, Motion]) -> State:
        """Return the joint state: the axes in `states`, the modes at rest, and the couplings started at `motions`."""
        zero = ops.zero(next(iter(motions.values())).position_load)
        shared = tuple(Shared((zero,) * len(core.modes), (zero,) * len(core.modes)) for core in self.cores)
        couplings = zip(self.couplings, prepared.couplings, strict=True)
        begun = tuple(
            coupling.start(coefficients, {name: motions[name] for name in coupling.axes()})
            for coupling, coefficients in couplings
        )
        return self.State(named(states), shared, begun)

    def motion(self, name: str, state: State) -> Motion:
        """Return the true position and velocity of the two bodies of an axis."""
        place = self._where[name]
        return self.cores[place].motion(name, state.axis._asdict(), state.shared[place])

    def columns(self, prepared: Prepared) -> dict[str, Columns]:
        """Return, for each axis by name, the columns that give the effect of its forces on the state over a substep."""
        return {
            name: axis
            for core, core_prepared in zip(self.cores, prepared.cores, strict=True)
            for name, axis in zip(core.axes, core_prepared.axes, strict=True)
        }

    def advance(
        self, prepared: Prepared, state: State, at: Mapping[str, Acting], time: Number, T: Number
    ) -> tuple[State, dict[str, Axis.Step], dict[str, Number | None]]:
        """Advance all axes from kT to (k+1)T; return the state and, for each axis, the forces to be recorded and the
        mean table force.
        """
        moved: dict[str, Axis.State] = state.axis._asdict()
        shared, remembered = list(state.shared), list(state.couplings)
        loads: dict[str, list[Any]] = {name: [] for name in self.axes}
        done: dict[str, Axis.Step] = {}
        substeps = self.substeps()
        h = T / substeps
        for index in range(substeps):
            now = time + index * h
            # before any axis moves, so that both ends of a coupling see the same instant
            pushes = self._coupled(prepared, moved, shared, remembered, now + 0.5 * h, h)
            for name, push in pushes.items():
                loads[name].append(push.load)
            for place, core in enumerate(self.cores):
                members = {name: moved[name] for name in core.axes}
                after, shared[place], steps = core.substep(
                    prepared.cores[place], members, shared[place], at, pushes, index, now, h
                )
                moved.update(after)
                done.update(steps)
        mean = {name: _mean(at[name].load, coupled) for name, coupled in loads.items()}
        return self.State(named(moved), tuple(shared), tuple(remembered)), done, mean

    def _coupled(
        self,
        prepared: Prepared,
        states: Mapping[str, Axis.State],
        shared: list[Shared],
        remembered: list[Any],
        middle: Number,
        h: Number,
    ) -> dict[str, Push]:
        """Return the coupling forces by axis at the middle of a substep, and update the coupling states in
        `remembered`.
        """
        motions: dict[str, Motion] = {}
        pushes: dict[str, Push] = {}
        for i, (coupling, coefficients) in enumerate(zip(self.couplings, prepared.couplings, strict=True)):
            for name in coupling.axes():
                if name not in motions:
                    core = self.cores[self._where[name]]
                    motions[name] = core.middle(name, states, shared[self._where[name]], h)
            involved = {name: motions[name] for name in coupling.axes()}
            remembered[i], forces = coupling.step(coefficients, remembered[i], involved, middle, h)
            for name, pair in forces.items():
                pushes[name] = pushes.get(name, Push()) + pair
        return pushes


def named(values: Mapping[str, Any]) -> Any:
    """Return a named tuple of values by axis."""
    return _type(tuple(values))(*values.values())


# cached, so that equal axes share a class: structures of trees are compared by type
@lru_cache(maxsize=256)
def _type(names: tuple[str, ...]) -> Any:
    for name in names:
        if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
            raise ParameterError(f"'{name}' cannot be the name of an axis: letters, digits and _ , first a letter")
    # functional syntax, since the names are known at run time only
    make: Any = NamedTuple
    kind = make("Axes", [(name, Any) for name in names])
    # pickle cannot find a class that is made at run time
    kind.__reduce__ = lambda axes: (named, (axes._asdict(),))
    return kind


def _mean(held: Any, coupled: list[Any]) -> Any:
    """Return the mean force on a table over a sample: `held`, constant, plus the mean of `coupled` over its substeps.
    None means no force.
    """
    total: Any = None
    for force in coupled:
        total = force if total is None else total + force
    mean = None if total is None else total / float(len(coupled)) if len(coupled) > 1 else total
    return mean if held is None else held if mean is None else held + mean
