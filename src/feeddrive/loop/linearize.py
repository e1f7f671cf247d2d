"""Linearization: the exact linear state-space model of a loop from the simulated code, with its poles and zeros.

A multirate loop, whose law is periodic over several samples, is lifted to a time-invariant model; frequency responses
are available for every loop.
"""

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

# |z| from which a zero counts as a zero at infinity that rounding has made finite
_FAR = 1e6
_DECAYED = 0.1  # of |z|: a pole nearer to 0, such as that of a dead time, decays in a sample and makes no peak


class Natural(NamedTuple):
    """The natural frequency in Hz and damping ratio of each pole, shape (n,); infinite and 1 for a pole at z = 0."""

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
    # b and c are scaled to the size of A, since zeros do not depend on the scale of input and output
    scale = max(float(np.linalg.norm(A)), 1.0)
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

# states: with more, a Schur form is faster than solving for each frequency, and needs less memory
_MANY = 60

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

    def oscillations(self) -> np.ndarray:
        """Return ln(z)/T of the poles with a positive imaginary part, without those near 0, which decay in a sample."""
        poles = self.poles()
        poles = poles[(np.abs(poles) > _DECAYED) & (np.imag(poles) > 0.0)]
        return np.log(poles) / self.sample_time

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

        A linear system is solved for each frequency; for many states `transfer` is used instead. This avoids
        polynomials and eigenvectors, which fail for double poles.
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
        """Return a named python-control StateSpace. Raises MissingExtraError if python-control is not installed."""
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
    """The Jacobian [A B; C D] of each sample in one period, the names of the states, and the sample time in s."""

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
    """Linearize each sample of a period in turn, as `linearize` does, during motion at constant velocity."""
    check_system(loop)
    unlimited = {axis: unlimited_loop(axis_loop) for axis, axis_loop in loop.loops().items()}
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
        # only roots, logarithms and selections store their lines: without them every slope is finite
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

    inputs    any of `set_position` ... `set_snap`, `load_force`, and the probes: `added_force`, added after the force
              limit; `reading_motor` and `reading_load`, added to the encoder readings; and `cut`, which opens the loop:
              it drives the axis in place of the controller, whose output is `force`
    outputs   names of `Signals`; for a machine inputs and outputs are prefixed by the axis: `x.load_force`
    velocity  m/s, velocity of the axis at which friction is linearized; at 0 the axis sticks
    position  m, for forces that depend on it; for a machine, velocity and position are numbers for all axes or mappings
              by axis
    settle    samples that the loop first runs at constant velocity, for friction with memory
    stored    function of name and value that rounds a parameter or precomputed coefficient of the controller that is
              stored with fewer digits

    For a multirate law with a period of n samples, the model covers one period: sample time nT, inputs held over the
    period, outputs at its first sample (`lifted` has all samples).  If no output depends on that law, as with `cut`,
    the model is that of one sample.
    Quantizers are replaced by their slope 1; guard and force limit are left out, since they have no effect within their
    bounds.
    A part that blends in after the start is treated as fully active.
    Raises ParameterError for an unknown name, an input that is named twice, and parameters for which the model
    overflows; NoSlopeError, naming the source line, for a law without a finite slope at this operating point, such as
    √|s| at s = 0.
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
        # the output does not depend on the multirate law, so all samples have one model
        lifted, period = first[:n], 1
    return _trimmed(np.vstack([lifted, first[n:]]), n, samples.names, tuple(inputs), tuple(outputs), period * T)


def _ages(state: Mapping[str, Any], name: str, size: int) -> np.ndarray:
    """Return the state index in the linear model for each cell of a ring buffer.

    In a history or a track the index is the age of the cell, since the newest value is in a different cell in each
    sample.
    """
    cells = np.arange(size)
    history = name.rpartition(".ring")[0] or name.rpartition(".values.")[0] or name.rpartition(".rates.")[0]
    if f"{history}.head" in state and f"{history}.filled" in state:
        return (int(state[f"{history}.head"]) - 1 - cells) % size
    return cells


def _row(tangent: Any, width: int) -> np.ndarray:
    return np.zeros((1, width)) if tangent is None else np.broadcast_to(tangent, (1, width))


def _after(tangent: Any, state: Mapping[str, Any], name: str, size: int | None, width: int) -> np.ndarray:
    """Return the rows of the model from which the next value of a state is computed."""
    if size is None:
        return _row(tangent, width)
    rows = np.zeros((size, width))
    if tangent is not None and tangent.cells is not None:
        rows[_ages(state, name, size)] = tangent.cells
    return rows


def unlimited_loop(loop: Loop) -> Loop:
    """Return the loop without guard and force limit, with parts that blend in after the start fully active."""
    held = loop.control
    law, compensation = held.law.settled(), tuple(part.settled() for part in held.compensation)
    there = any(new is not old for new, old in zip((law, *compensation), (held.law, *held.compensation), strict=True))
    if not there and held.guard is None and held.force_limit is None:
        return loop
    control = dataclasses.replace(held, law=law, compensation=compensation, guard=None, force_limit=None)
    return dataclasses.replace(loop, control=control)


def _everywhere(loop: System, position: Any, velocity: Any) -> dict[str, tuple[float, float]]:
    """Return the position and velocity by axis; each argument may be one number for all axes, or numbers by axis."""
    values = {}
    for axis in loop.loops():
        at, speed = (value.get(axis, 0.0) if isinstance(value, Mapping) else value for value in (position, velocity))
        values[axis] = float(at), float(speed)
    return values


def _setpoints(loop: System, at: Mapping[str, tuple[float, float]], time: float) -> Any:
    """Return the setpoints at `time` (s) of a motion at constant velocity; for a machine by axis."""
    setpoints = {axis: Setpoint(*map(np.float64, (x + time * v, v, 0.0, 0.0, 0.0))) for axis, (x, v) in at.items()}
    return setpoints if isinstance(loop, Machine) else setpoints[loop.name]


def _inputs(loop: System, at: Mapping[str, tuple[float, float]], time: float) -> dict[str, Any]:
    """Return all inputs by name at `time` (s) of a motion at constant velocity."""
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
    # by structure, not by rank, which rounding would decide
    return [int(i) for i in np.flatnonzero(_reached(jacobians, n)[:n] & seen)]


def _reached(jacobians: Sequence[np.ndarray], n: int) -> np.ndarray:
    """Return a mask of the columns: True for a state that an input affects in any sample, and for every input."""
    there = np.any([jacobian != 0.0 for jacobian in jacobians], axis=0)
    links, reached = there[:n, :n], np.any(there[:n, n:], axis=1)
    for _ in range(n):
        reached = reached | np.any(links[:, reached], axis=1)
    return np.append(reached, np.ones(there.shape[1] - n, bool))


def _cells(seed: Any) -> np.ndarray:
    return seed.cells if isinstance(seed, Ring) else seed


# samples of a period: a response has as many images, and its cost grows with their square
MOST = 64
_BLOCK = 2**19  # entries of all matrices in memory at once
_ASIDE = 1e-4  # of the slow rate of a multirate loop: nearer to its multiples rounding decides


@dataclass(frozen=True, eq=False)
class Lifted:
    """A loop that is periodic over N samples (multirate), as a sequence of N linear models.

        x(k+1) = A_i x(k) + B_i u(k),   y(k) = C_i x(k) + D_i u(k),   i = k mod N

    If all samples of a period are stacked into one input vector and one output vector (lifting), it is a time-invariant
    system at the sample time NT (Bamieh, Pearson, Francis & Tannenbaum 1991; Meyer 1990; Khargonekar, Poolla &
    Tannenbaum 1985).  It is stable if all eigenvalues of A_{N-1} ... A_0 lie inside the unit circle.

    The response to a sine at f has components at f and at its images f + k/(NT), k = 1 .. N-1.  `response` is the
    component at f, which a sine sweep measures.  For N = 1 it is the ordinary frequency response.
    """

    samples: tuple[StateSpace, ...]

    @property
    def sample_time(self) -> float:
        """The time T of one sample, s."""
        return self.samples[0].sample_time

    @property
    def inputs(self) -> tuple[str, ...]:
        """The names of the inputs, with their units as in `linearize`."""
        return self.samples[0].inputs

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of the recorded signals."""
        return self.samples[0].outputs

    def poles(self) -> np.ndarray:
        """Return the eigenvalues of the state transition over a period, the largest first."""
        product = np.eye(self.samples[0].A.shape[0])
        for sample in self.samples:
            product = sample.A @ product
        poles = np.linalg.eigvals(product)
        return poles[np.argsort(-np.abs(poles))]

    def stacked(self, inputs: Sequence[str], outputs: Sequence[str]) -> tuple[np.ndarray, ...]:
        """Return A, B, C, D of the lifted system; the samples of each input and output are stacked in order."""
        N, n = len(self.samples), self.samples[0].A.shape[0]
        columns = [self.inputs.index(name) for name in inputs]
        rows = [self.outputs.index(name) for name in outputs]
        through = np.hstack([np.eye(n), np.zeros((n, N * len(columns)))])
        seen = np.zeros((len(rows), N, through.shape[1]))
        for k, sample in enumerate(self.samples):
            places = n + k + N * np.arange(len(columns))
            seen[:, k] = sample.C[rows] @ through
            seen[:, k, places] += sample.D[np.ix_(rows, columns)]
            through = sample.A @ through
            through[:, places] += sample.B[:, columns]
        wide = seen.reshape(-1, through.shape[1])
        return through[:, :n], through[:, n:], wide[:, :n], wide[:, n:]

    def harmonics(self, frequency: np.ndarray, output: str, input: str) -> np.ndarray:  # noqa: A002
        """Return H of shape (lines, N, N); row m, column k is the component at f + m/(NT) of the response to a sine at
        f + k/(NT).
        """
        A, B, C, D = self.stacked([input], [output])
        N, n = len(self.samples), A.shape[0]
        turns = images_turn(frequency, N, self.sample_time)
        z = np.exp(2j * np.pi * frequency * N * self.sample_time)
        inner = np.linalg.solve(z[:, None, None] * np.eye(n) - A, np.broadcast_to(B.astype(complex), (z.size, n, N)))
        return np.conj(turns).transpose(0, 2, 1) @ (C @ inner + D) @ turns / N

    def response(self, frequency: np.ndarray, output: str, input: str) -> FRF:  # noqa: A002
        """Return the component at f of the response to a sine at f in Hz, up to the Nyquist frequency 1/(2T)."""
        A, B, C, D = self.stacked([input], [output])
        N, n = len(self.samples), A.shape[0]
        frequency = np.asarray(frequency, dtype=float)
        check_below_nyquist(frequency, self.sample_time)
        turn = images_turn(frequency, N, self.sample_time)[:, :, 0]
        z = np.exp(2j * np.pi * frequency * N * self.sample_time)
        right = turn @ B.T
        inner = np.linalg.solve(z[:, None, None] * np.eye(n) - A, right[:, :, None])[:, :, 0]
        values = np.sum(np.conj(turn) * (inner @ C.T + turn @ D.T), axis=1) / N
        unit = f"{UNITS[quantity(output)]}/{INPUT_UNITS[quantity(input)]}"
        return FRF(frequency, values, input, output, unit, self.sample_time)


def images_turn(frequency: np.ndarray, period: int, sample_time: float) -> np.ndarray:
    """Return e^(j 2π (f + m/(NT)) i T) of shape (lines, samples i, images m)."""
    i = np.arange(period)
    turns = np.exp(2j * np.pi * frequency[:, None] * i * sample_time)
    return turns[:, :, None] * np.exp(2j * np.pi * np.outer(i, i) / period)


def images_closed(gain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the loop gain for a sine with the loops of its images closed, and det(1 + L) of the images alone.

        L(f) = L₀₀ - L₀ᵢ (1 + Lᵢᵢ)⁻¹ Lᵢ₀,    1/(1 + L(f)) = [(1 + L)⁻¹]₀₀,    det(1 + L) = (1 + L(f)) det(1 + Lᵢᵢ)

    gain  the harmonics of an opened loop, shape (lines, N, N); index 0 is the sine itself, the others (i) are its
          images
    """
    others = np.eye(gain.shape[1] - 1) + gain[:, 1:, 1:]
    back = np.linalg.solve(others, gain[:, 1:, :1])
    return gain[:, 0, 0] - (gain[:, :1, 1:] @ back)[:, 0, 0], np.linalg.det(others)


def period_of(loop: System) -> int:
    """Return the period of a loop or machine in samples: the least common multiple of its laws' periods."""
    return int(np.lcm.reduce([axis_loop.control.law.period() for axis_loop in loop.loops().values()]))


def lifted(
    loop: System,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    velocity: float | Mapping[str, float] = 0.05,
    stored: Callable[[str, float], float] | None = None,
) -> Lifted:
    """Return the linear models of all samples of a period, from any inputs to any signals, as in `linearize`.

    Raises the same errors as `linearize`.
    """
    check_system(loop)
    samples = samples_of_a_period(loop, inputs, outputs, velocity=velocity, stored=stored)
    n = len(samples.names)
    keep = kept_states(samples.jacobians, n)
    names = tuple(samples.names[i] for i in keep)
    return Lifted(
        tuple(
            StateSpace(
                jacobian[np.ix_(keep, keep)],
                jacobian[keep, n:],
                jacobian[n:, keep],
                jacobian[n:, n:],
                samples.sample_time,
                names,
                tuple(inputs),
                tuple(outputs),
            )
            for jacobian in samples.jacobians
        )
    )


def gain_of(model: Lifted, frequency: np.ndarray, output: str = "force", input: str = "cut") -> tuple[FRF, np.ndarray]:  # noqa: A002
    """Return the gain L of a loop opened from `output` to `input`, with the image loops closed, and det(1 + L) of the
    images.

    For the definition of both see `images_closed`.
    Raises ParameterError for a period of more than 64 samples.
    """
    N, T = len(model.samples), model.sample_time
    if N > MOST:
        raise ParameterError(
            f"the loop repeats itself every {N} samples: loop gain and margins are computed for at most {MOST}; "
            f"set position_every <= {MOST}, or take a longer sample time"
        )
    # at a multiple of the slow rate, Nyquist among them, one image is at 0 Hz, where a free mass and an integral have
    # an infinite gain: the limit there is taken from beside it
    turns = np.round(frequency * N * T)
    on_image = (turns > 0.0) & (np.abs(frequency * N * T - turns) < _ASIDE)
    lines = np.where(on_image, (turns - _ASIDE) / (N * T), frequency)
    # N × N matrices at all frequencies at once would fill the memory
    blocks = np.array_split(lines, max(1, -(-frequency.size * N * N // _BLOCK)))
    parts = [images_closed(-model.harmonics(block, output, input)) for block in blocks if block.size]
    gain, rest = (np.concatenate([part[i] for part in parts]) for i in range(2))
    return FRF(frequency, gain, input, output, "N/N", T), rest


def loop_gain(loop: System, frequency: np.ndarray, *, velocity: float = 0.05, axis: str | None = None) -> FRF:
    """Return the sampled loop gain L = -force/cut, opened at the actuator, with all delays; 1 + L = 0 is the stability
    limit.

    For a machine it is the gain of one `axis`, with the loops of all others closed.  For a multirate law it is the gain
    for a sine with the loops of its images closed: 1/(1 + L) is the fraction that remains of a sine added to the force
    (`images_closed`).
    """
    port, _ = _port(loop, axis)
    if period_of(loop) > 1:
        model = lifted(loop, [f"{port}cut"], [f"{port}force"], velocity=velocity)
        return gain_of(model, np.asarray(frequency, dtype=float), f"{port}force", f"{port}cut")[0]
    return -linearize(loop, [f"{port}cut"], [f"{port}force"], velocity=velocity).response(frequency)


def tracking(loop: System, frequency: np.ndarray, *, velocity: float = 0.05, axis: str | None = None) -> FRF:
    """Return the response of the table position to the set position together with its exact derivatives up to snap.

    It is Σ Hₙ (j2πf)ⁿ, where Hₙ is the response to the n-th derivative alone.

    For a multirate law it is the component at the excited frequency, as in `compliance`.
    """
    port, _ = _port(loop, axis)
    model = linear_model(loop, [f"{port}{name}" for name in SETPOINT], [f"{port}position_load"], velocity)
    s = 2j * np.pi * np.asarray(frequency, dtype=float)
    total = model.response(frequency, f"{port}position_load", f"{port}{SETPOINT[0]}")
    for order, name in enumerate(SETPOINT[1:], start=1):
        total = total + s**order * model.response(frequency, f"{port}position_load", f"{port}{name}").response
    return total


def compliance(loop: System, frequency: np.ndarray, *, velocity: float = 0.05, axis: str | None = None) -> FRF:
    """Return the closed-loop compliance in m/N, table position over table force: the inverse of the dynamic stiffness.

    For a multirate law it is the component at the excited frequency, at the fast sample rate.
    """
    port, _ = _port(loop, axis)
    model = linear_model(loop, [f"{port}load_force"], [f"{port}position_load"], velocity)
    return model.response(frequency, f"{port}position_load", f"{port}load_force")


def linear_model(
    loop: System, inputs: Sequence[str], outputs: Sequence[str], velocity: float = 0.05
) -> StateSpace | Lifted:
    """Return the linear model of a loop; for a multirate loop, the models of all samples of a period."""
    return (lifted if period_of(loop) > 1 else linearize)(loop, inputs, outputs, velocity=velocity)


def _port(loop: System, axis: str | None) -> tuple[str, Loop]:
    """Return the signal prefix and the loop of an axis, which must be named for a machine."""
    check_system(loop)
    ports = dict(zip(loop.loops(), loop.ports(), strict=True))
    name = next(iter(ports)) if axis is None and len(ports) == 1 else axis
    if name not in ports:
        raise ParameterError(f"axis = {axis!r} must be one of {', '.join(ports)}")
    return ports[name], loop.loops()[name]
