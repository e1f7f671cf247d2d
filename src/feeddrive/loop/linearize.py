"""Linearization: the exact linear state-space model of a loop from the simulated code, with its poles and zeros."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import MissingExtraError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.ring import Ring
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.language.units import units_of
from feeddrive.loop.frequency_response import FRF, transfer
from feeddrive.loop.gradient import push, require_slopes
from feeddrive.loop.loop import SETPOINT, UNITS, Loop, Probe, quantity
from feeddrive.loop.machine import Machine, System, check_system
from feeddrive.loop.runner import Prepared
from feeddrive.loop.trace import lengths, node_values

_FAR = 1e6  # |z| from which a zero is one at infinity that rounding made finite


class Natural(NamedTuple):
    """The natural frequency in Hz and damping ratio of each pole, of shape (n,); infinite and 1 for z = 0."""

    frequency: np.ndarray
    damping: np.ndarray


def continuous(z: np.ndarray, sample_time: float) -> np.ndarray:
    """Return s = ln(z)/T in 1/s, the continuous-time equivalent of a sampled pole; -∞ for z = 0."""
    z = np.asarray(z, complex)
    with np.errstate(divide="ignore"):
        return np.where(z == 0.0, complex(-np.inf), np.log(np.where(z == 0.0, 1.0, z)) / sample_time)


def natural(z: np.ndarray, sample_time: float) -> Natural:
    """Return the natural frequency |s|/2π and the damping ratio -Re s/|s| of s = ln(z)/T.

    The damping is 1 for z = 0 and for an integrator, z = 1, which has no frequency.
    """
    s = continuous(z, sample_time)
    size = np.abs(s)
    there = (size > 0.0) & np.isfinite(size)
    return Natural(size / (2.0 * np.pi), np.where(there, -np.real(s) / np.where(there, size, 1.0), 1.0))


def zeros(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: float) -> np.ndarray:
    """Return the finite zeros z of c (z - A)⁻¹ b + d, b and c of shape (n,): where [A - z, b; c, d] loses rank.

    They are generalized eigenvalues from the QZ algorithm; those beyond 10⁶ count as infinite.
    Source: Emami-Naeini & Van Dooren 1982 (the pencil).
    """
    from scipy.linalg import eigvals

    n = A.shape[0]
    scale = max(float(np.linalg.norm(A)), 1.0)  # zeros do not depend on the sizes of input and output
    wide, tall = (scale / max(float(np.linalg.norm(vector)), 1e-300) for vector in (b, c))
    pencil = np.block([[A, wide * b[:, None]], [tall * c[None, :], np.array([[wide * tall * d]])]])
    mass = np.zeros((n + 1, n + 1))
    mass[:n, :n] = np.eye(n)
    alpha, beta = np.asarray(eigvals(pencil, mass, homogeneous_eigvals=True))
    finite = np.abs(alpha) < _FAR * np.abs(beta)
    return alpha[finite] / beta[finite]


# names of the numbers that a controller stores
_OF_MEMORY = re.compile(r"(axis\.\w+\.)?control\.memory\.")  # states of laws, filters and observers
_OF_CONTROL = re.compile(r"(axis\.\w+\.)?control\.|prepared\.control\.|sample_time$")

_MANY = 60  # states: with more a Schur form is quicker than solving for each frequency, and needs no memory

INPUT_UNITS = {
    **dict(zip(SETPOINT, units_of(Setpoint).values(), strict=True)),
    "load_force": "N",
    **units_of(Probe),
}


@dataclass(frozen=True, eq=False, repr=False)
class StateSpace(Result):
    """The state-space model x(k+1) = A x + B u,  y = C x + D u  of small deviations, at a sample time in s.

    Only states that are reachable from an input and observable at an output are kept.  Poles are those of A.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    sample_time: float
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def poles(self) -> np.ndarray:
        """Return the eigenvalues of A, the largest first."""
        poles = np.linalg.eigvals(self.A)
        return poles[np.argsort(-np.abs(poles))]

    def zeros(self, output: str | None = None, input: str | None = None) -> np.ndarray:  # noqa: A002
        """Return the finite zeros in z from one input to one output (default: the first), see `zeros`."""
        row = 0 if output is None else _place(self.outputs, output, "output")
        column = 0 if input is None else _place(self.inputs, input, "input")
        return zeros(self.A, self.B[:, column], self.C[row], float(self.D[row, column]))

    def is_stable(self) -> bool:
        """True if all poles lie inside the unit circle."""
        return bool(np.all(np.abs(self.poles()) < 1.0))

    def response(self, frequency: np.ndarray, output: str | None = None, input: str | None = None) -> FRF:  # noqa: A002
        """Return C (z - A)⁻¹ B + D at z = e^(j2πfT), from one input to one output (default: the first), f in Hz up to
        Nyquist.

        A linear system is solved for each frequency, for many states by `transfer`: polynomials and eigenvectors, which
        fail for double poles, are avoided.
        """
        row = 0 if output is None else _place(self.outputs, output, "output")
        column = 0 if input is None else _place(self.inputs, input, "input")
        frequency = np.asarray(frequency, dtype=float)
        check_below_nyquist(frequency, self.sample_time)
        z = np.exp(2j * np.pi * frequency * self.sample_time)
        n = self.A.shape[0]
        if n > _MANY:
            values = transfer(self.A, self.B[:, column], self.C[row], self.D[row, column], z)
        else:
            matrix = z[:, None, None] * np.eye(n) - self.A
            right = np.broadcast_to(self.B[:, column : column + 1].astype(complex), (z.size, n, 1))
            solved = np.linalg.solve(matrix, right)[:, :, 0] if n else np.zeros((z.size, 0))
            values = solved @ self.C[row] + self.D[row, column]
        names = self.inputs[column], self.outputs[row]
        unit = f"{UNITS[quantity(names[1])]}/{INPUT_UNITS[quantity(names[0])]}"
        return FRF(frequency, values, names[0], names[1], unit, self.sample_time)

    def to_control(self) -> Any:
        """Return a python-control StateSpace, with names. Raises MissingExtraError without python-control."""
        try:
            import control
        except ImportError as error:
            raise MissingExtraError("control", "control", "handing a model to python-control") from error
        return control.ss(
            self.A,
            self.B,
            self.C,
            self.D,
            self.sample_time,
            inputs=list(self.inputs),
            outputs=list(self.outputs),
            states=[s.replace(".", "_") for s in self.states],
        )

    def to_scipy(self) -> Any:
        """Return a `scipy.signal.StateSpace` with `dt`, without names."""
        from scipy.signal import StateSpace as Theirs

        return Theirs(self.A, self.B, self.C, self.D, dt=self.sample_time)

    def table(self) -> Table:
        """Return a table of the poles, with natural frequency and damping."""
        poles = self.poles()
        rows = [
            [
                Text(f"{Quantity(pole.real):.6f}{Quantity(pole.imag):+.6f}j"),
                float(abs(pole)),
                float(frequency),
                float(damping),
            ]
            for pole, frequency, damping in zip(poles, *natural(poles, self.sample_time), strict=True)
        ]
        title = f"{len(self.states)} states, inputs {', '.join(self.inputs)}, outputs {', '.join(self.outputs)}"
        columns = [
            "pole z",
            Column("|z|", "1", ".6f"),
            Column("natural frequency", "Hz"),
            Column("damping", "1", ".3f"),
        ]
        return Table(title, columns, rows)


def check_below_nyquist(frequency: np.ndarray, sample_time: float) -> None:
    """Raise ParameterError for a frequency in Hz above half the sample rate."""
    # 1e-9: grids end at Nyquist, and its rounding is not an error
    if frequency.size and frequency.max() > 0.5 / sample_time * (1 + 1e-9):
        raise ParameterError(
            f"frequency {Quantity(frequency.max(), 'Hz'):6} is beyond Nyquist, {Quantity(0.5 / sample_time, 'Hz'):6}: "
            "a sampled loop has no response there"
        )


def _place(names: Sequence[str], name: str, what: str) -> int:
    if name not in names:
        raise ParameterError(f"there is no {what} '{name}'; there are {', '.join(names)}")
    return list(names).index(name)


class Samples(NamedTuple):
    """The Jacobians [A B; C D] of the samples of one period, over all states by name, at the sample time in s."""

    jacobians: list[np.ndarray]
    names: list[str]
    sample_time: float


def samples_of_a_period(
    loop: System,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    velocity: float | Mapping[str, float] = 0.05,
    position: float | Mapping[str, float] = 0.0,
    settle: int = 0,
    stored: Callable[[str, float], float] | None = None,
) -> Samples:
    """Linearize each sample of a period in turn, as in `linearize`, along constant velocity."""
    check_system(loop)
    unlimited = {axis: _unlimited(axis_loop) for axis, axis_loop in loop.loops().items()}
    if any(unlimited[axis] is not axis_loop for axis, axis_loop in loop.loops().items()) or isinstance(loop, Machine):
        loop = loop.with_loops(unlimited) if isinstance(loop, Machine) else unlimited[loop.name]
    for name in inputs:
        _place([f"{port}{signal}" for port in loop.ports() for signal in INPUT_UNITS], name, "input")
    if len(set(inputs)) < len(inputs):
        raise ParameterError(f"an input is named twice in {', '.join(inputs)}: name each once")
    for name in outputs:
        _place(loop.signals(), name, "signal")
    at = _everywhere(loop, position, velocity)
    setpoint, start = _setpoints(loop, at, 0.0), at if isinstance(loop, Machine) else at[loop.name]
    prepared = Prepared(loop, setpoint, start)
    probes = tuple(f"{port}{name}" for port in loop.ports() for name in Probe._fields if f"{port}{name}" in inputs)
    program = prepared.program(load=True, enable=False, probes=probes)
    # histories are full: a model of small deviations has no first samples after a start
    first = prepared.settled()
    if settle:
        first.update(_settled(loop, prepared, at, settle))
    numbers = prepared.numbers
    if stored is not None:
        rounded = {name: stored(name, value) for name, value in numbers.items() if _OF_CONTROL.match(name)}
        numbers = {**numbers, **{name: np.float64(value) for name, value in rounded.items()}}
    T = float(loop.sample_time)
    ends = [state.after for state in program.states] + [program.outputs[name] for name in outputs]
    sizes = [lengths(program.graph, state.before) for state in program.states]
    n, m = sum(size or 1 for size in sizes), len(inputs)
    period = math.lcm(*(axis_loop.control.law.period() for axis_loop in loop.loops().values()))
    eye, places = np.eye(n + m), list[str]()
    for state, size in zip(program.states, sizes, strict=True):
        places += [state.name] if size is None else [f"{state.name}[{i}]" for i in range(size)]
    matrices: list[np.ndarray] = []
    for k in range(period):
        leaves = {
            **numbers,
            **{f"state.{name}": value for name, value in first.items()},
            **_inputs(loop, at, k * T),
            **prepared.tables,
            **dict.fromkeys(probes, np.float64(0.0)),
            "sample": np.float64(settle + k),
        }
        values = node_values(program.graph, ends, leaves)
        after = {state.name: values[state.after] for state in program.states}
        seeds = {program.inputs[name]: eye[n + i] for i, name in enumerate(inputs) if name in program.inputs}
        row = 0
        for state, size in zip(program.states, sizes, strict=True):
            seed = eye[row : row + (size or 1)]
            seeds[state.before] = seed[0] if size is None else Ring(size, seed[_ages(first, state.name, size)])
            row += size or 1
        with np.errstate(all="ignore"):
            seeds = {node: seed for node, seed in seeds.items() if node in values}
            tangents = push(program.graph, ends, values, seeds)
        rows = [_row(tangent, n + m) for tangent in tangents[len(sizes) :]]
        states = zip(tangents, program.states, sizes, strict=False)
        jacobian = np.vstack(
            [*(_after(tangent, after, state.name, size, n + m) for tangent, state, size in states), *rows]
        )
        if program.graph.lines:
            reached = _reached([jacobian], n)
            moving = {node: seed for node, seed in seeds.items() if np.any(_cells(seed)[..., reached])}
            laws = {axis_loop.control.law.kind for axis_loop in loop.loops().values()}
            require_slopes(program.graph, ends, values, seeds, moving, laws)
        if not np.all(np.isfinite(jacobian)):
            raise ParameterError(
                "the linear model of the loop holds numbers that are not finite: a parameter of axis or control is so "
                "large or so small that it overflows; check masses, stiffnesses, gains and the sample time"
            )
        matrices.append(jacobian)
        first = after
    return Samples(matrices, places, T)


def linearize(
    loop: System,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    velocity: float | Mapping[str, float] = 0.05,
    position: float | Mapping[str, float] = 0.0,
    settle: int = 0,
    stored: Callable[[str, float], float] | None = None,
) -> StateSpace:
    """Return the exact linear model of a loop from any inputs to any signals: the Jacobian of the simulated step.

    inputs    of `set_position` ... `set_snap`, `load_force`, and the probes: `added_force` behind the limit,
              `reading_motor` and `reading_load` on top of the encoders, and `cut`: the loop is then open, the axis
              follows `cut` instead of the control, and `force` is the output of the control
    outputs   names of `Signals`; for a machine inputs and outputs are prefixed by the axis: `x.load_force`
    velocity  m/s of the axis: friction is linearized at this speed.  0: the axis sticks
    position  m, for forces that depend on it; for a machine both are numbers for all axes, or mappings by axis
    settle    samples that the loop first runs at constant velocity, for friction with memory
    stored    function of name and value that rounds a parameter or prepared number of the control, if it is stored
              with fewer digits

    A multirate law with a period of n samples gives the model over a period: sample time nT, inputs held over the
    period, outputs at its first sample (`lifted` has all samples).  If no output depends on that law, as with `cut`,
    the model is that of one sample.
    Quantizers are replaced by their slope 1; guard and force limit are left out, since they do nothing within their
    bounds.
    A part that blends in after the start counts as fully active.
    Raises ParameterError for an unknown name, an input that is named twice, and parameters with which the model
    overflows; NoSlopeError, with the line, for a law without a finite slope there, such as √|s| at s = 0.
    """
    samples = samples_of_a_period(
        loop, inputs, outputs, velocity=velocity, position=position, settle=settle, stored=stored
    )
    n, T = len(samples.names), samples.sample_time
    lifted = np.eye(n, n + len(inputs))
    for jacobian in samples.jacobians:
        lifted = jacobian[:n, :n] @ lifted + np.hstack([np.zeros((n, n)), jacobian[:n, n:]])
    first = samples.jacobians[0]
    period = len(samples.jacobians)
    if period > 1 and not any(_OF_MEMORY.match(samples.names[i]) for i in kept_states(samples.jacobians, n)):
        lifted, period = first[:n], 1
    return _trimmed(np.vstack([lifted, first[n:]]), n, samples.names, tuple(inputs), tuple(outputs), period * T)


def _ages(state: Mapping[str, Any], name: str, size: int) -> np.ndarray:
    """Return the index of each cell of a ring in the linear model.

    In a history or a track that is the age of the cell, since the newest value is in another cell in each sample.
    """
    cells = np.arange(size)
    history = name.rpartition(".ring")[0] or name.rpartition(".values.")[0] or name.rpartition(".rates.")[0]
    if f"{history}.head" in state and f"{history}.filled" in state:
        return (int(state[f"{history}.head"]) - 1 - cells) % size
    return cells


def _row(tangent: Any, width: int) -> np.ndarray:
    return np.zeros((1, width)) if tangent is None else np.broadcast_to(tangent, (1, width))


def _after(tangent: Any, state: Mapping[str, Any], name: str, size: int | None, width: int) -> np.ndarray:
    """Return the rows of the model for a state after the sample."""
    if size is None:
        return _row(tangent, width)
    rows = np.zeros((size, width))
    if tangent is not None and tangent.cells is not None:
        rows[_ages(state, name, size)] = tangent.cells
    return rows


def _unlimited(loop: Loop) -> Loop:
    """Return the loop without guard and force limit, with parts that blend in after the start fully active."""
    held = loop.control
    law, compensation = held.law.settled(), tuple(part.settled() for part in held.compensation)
    there = any(new is not old for new, old in zip((law, *compensation), (held.law, *held.compensation), strict=True))
    if not there and held.guard is None and held.force_limit is None:
        return loop
    control = dataclasses.replace(held, law=law, compensation=compensation, guard=None, force_limit=None)
    return dataclasses.replace(loop, control=control)


def _everywhere(loop: System, position: Any, velocity: Any) -> dict[str, tuple[float, float]]:
    """Return position and velocity of each axis, from one number for all axes or from numbers by axis."""
    values = {}
    for axis in loop.loops():
        at, speed = (value.get(axis, 0.0) if isinstance(value, Mapping) else value for value in (position, velocity))
        values[axis] = float(at), float(speed)
    return values


def _setpoints(loop: System, at: Mapping[str, tuple[float, float]], time: float) -> Any:
    """Return the setpoints at a time of a motion at constant velocities; for a machine by axis."""
    setpoints = {axis: Setpoint(*map(np.float64, (x + time * v, v, 0.0, 0.0, 0.0))) for axis, (x, v) in at.items()}
    return setpoints if isinstance(loop, Machine) else setpoints[loop.name]


def _inputs(loop: System, at: Mapping[str, tuple[float, float]], time: float) -> dict[str, Any]:
    """Return all inputs by name at a time of a motion at constant velocities."""
    inputs_: dict[str, Any] = {}
    for port, (x, v) in zip(loop.ports(), at.values(), strict=True):
        setpoint = map(np.float64, (x + time * v, v, 0.0, 0.0, 0.0))
        inputs_ |= {f"{port}{name}": value for name, value in zip(SETPOINT, setpoint, strict=True)}
        inputs_[f"{port}load_force"] = np.float64(0.0)
    return inputs_


def _settled(loop: System, prepared: Prepared, at: Mapping[str, tuple[float, float]], count: int) -> dict[str, Any]:
    """Return the states after `count` samples at constant velocity."""
    program = prepared.program(load=False, enable=False)
    compiled = prepared.native(program, record=())
    rows = np.zeros((count, len(compiled.plan.inputs)))
    # the motion ends at the operating point at t = 0
    k = np.arange(count) - count
    ports = dict(zip(loop.ports(), at.values(), strict=True))
    for column, (name, _) in enumerate(compiled.plan.inputs):
        what = quantity(name)
        position, velocity = ports[name.removesuffix(what)]
        if what == "set_position":
            rows[:, column] = position + k * loop.sample_time * velocity
        elif what == "set_velocity":
            rows[:, column] = velocity
    begun = Prepared(loop, _setpoints(loop, at, -count * float(loop.sample_time)))
    states = begun.states(compiled)
    compiled.run(count, 0, begun.constants(compiled), rows, states, None, begun.rows(compiled))
    settled: dict[str, Any] = {state.name: states[i, 0] for i, state in enumerate(compiled.plan.states)}
    first = len(compiled.plan.states)
    for name, _, length in compiled.plan.rings:
        settled[name.removeprefix("state.")] = Ring(length, states[first : first + length, 0].copy())
        first += length
    return settled


def _trimmed(
    jacobian: np.ndarray, n: int, names: Sequence[str], inputs: tuple[str, ...], outputs: tuple[str, ...], T: float
) -> StateSpace:
    """Return the model without states that are unreachable from the inputs or unobservable at the outputs."""
    A, B, C, D = jacobian[:n, :n], jacobian[:n, n:], jacobian[n:, :n], jacobian[n:, n:]
    keep = kept_states([jacobian], n)
    return StateSpace(A[np.ix_(keep, keep)], B[keep], C[:, keep], D, T, tuple(names[i] for i in keep), inputs, outputs)


def kept_states(jacobians: Sequence[np.ndarray], n: int) -> list[int]:
    """Return the indices of the n states that are reachable from an input and observable at an output in any sample."""
    there = np.any([jacobian != 0.0 for jacobian in jacobians], axis=0)
    links, seen = there[:n, :n], np.any(there[n:, :n], axis=0)
    for _ in range(n):
        seen = seen | np.any(links[seen, :], axis=0)
    return [int(i) for i in np.flatnonzero(_reached(jacobians, n)[:n] & seen)]


def _reached(jacobians: Sequence[np.ndarray], n: int) -> np.ndarray:
    """Return a mask over the columns: the n states that an input reaches in any of the samples, and all inputs."""
    there = np.any([jacobian != 0.0 for jacobian in jacobians], axis=0)
    links, reached = there[:n, :n], np.any(there[:n, n:], axis=1)
    for _ in range(n):
        reached = reached | np.any(links[:, reached], axis=1)
    return np.append(reached, np.ones(there.shape[1] - n, bool))


def _cells(seed: Any) -> np.ndarray:
    return seed.cells if isinstance(seed, Ring) else seed
