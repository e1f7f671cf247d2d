"""Compliance between tool and workpiece: modes and closed loops as one linear system at the cut."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, check_system

_WORST = 0.01  # of the largest compliance: a fit that misses by more is refused
_FAST = (1.0, 2.0, 4.0, 8.0, 16.0)  # real poles at these multiples of the sampling rate stand for hold and dead time
_DISTINCT = 1e8  # condition of the mode shapes above which two poles count as one, and each line is solved separately
_MOVES = 0.01  # of the largest peak of a pole: well damped poles with smaller ones are ignored
_KNEE = 0.03  # of the sampling rate: above it the fit counts less, since images of the sampling show there


@dataclass(frozen=True)
class ToolMode:
    """A mode of tool, holder and spindle, or of the workpiece.

        m (η'' + 2 ζ ω η' + ω² η) = (feed, normal) · F,   r = shape η

    `frequency` is in Hz and `mass` in kg; `feed` and `normal` are the mode shape along t and n.
    """

    frequency: float
    damping_ratio: float
    mass: float
    feed: float = 1.0
    normal: float = 0.0

    def __post_init__(self) -> None:
        for name in ("frequency", "damping_ratio", "mass"):
            if not getattr(self, name) > 0.0:
                value = Quantity(getattr(self, name), {"frequency": "Hz", "mass": "kg"}.get(name, ""))
                raise ParameterError(f"{name} = {value:6 SI} of a tool mode must be > 0")


@dataclass(frozen=True, eq=False, repr=False)
class ToolPoint(Result):
    """The linear model from a force F (N) on the tool to its displacement r = (t, n) (m) relative to the workpiece.

        y' = A y + B F,   r = C y

    F acts on the tool and -F on the workpiece, so that their compliances add: `a + b` combines a tool with a workpiece
    or a table.
    `missed` is the largest deviation of a fitted response from the exact one, relative to the largest compliance.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    missed: float = 0.0

    def __add__(self, other: ToolPoint) -> ToolPoint:
        n, m = self.A.shape[0], other.A.shape[0]
        A = np.zeros((n + m, n + m))
        A[:n, :n], A[n:, n:] = self.A, other.A
        return ToolPoint(A, np.vstack([self.B, other.B]), np.hstack([self.C, other.C]), max(self.missed, other.missed))

    def turned(self, angle: float) -> ToolPoint:
        """Return the tool point for a feed direction rotated by an angle in rad, counterclockwise, from t towards n."""
        # rounded, so that a quarter turn leaves nothing of the other direction
        cosine, sine = round(float(np.cos(angle)), 15), round(float(np.sin(angle)), 15)
        turn = np.array([[cosine, sine], [-sine, cosine]])
        return ToolPoint(self.A, self.B @ turn.T, turn @ self.C, self.missed)

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """Return the compliance C (jω - A)⁻¹ B in m/N at frequencies in Hz, shape (n, 2, 2)."""
        s = 2j * np.pi * np.atleast_1d(np.asarray(frequency, float))
        poles, shapes = np.linalg.eig(self.A)
        if np.linalg.cond(shapes) < _DISTINCT:
            into = np.linalg.solve(shapes, self.B)
            return ((self.C @ shapes)[None] / (s[:, None] - poles)[:, None, :]) @ into
        inside = s[:, None, None] * np.eye(self.A.shape[0]) - self.A
        return self.C @ np.linalg.solve(inside, np.broadcast_to(self.B.astype(complex), (s.size, *self.B.shape)))

    def moving(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return A, B, C for the compliant directions only. Raises ParameterError if there is none."""
        kept = [i for i in range(self.C.shape[0]) if np.any(self.C[i]) and np.any(self.B[:, i])]
        if not kept:
            raise ParameterError("the tool gives way in no direction: add a mode, or an axis that feels the cut")
        return self.A, self.B[:, kept], self.C[kept]

    def directions(self) -> list[int]:
        """Return the compliant directions: 0 for t, 1 for n."""
        return [i for i in range(self.C.shape[0]) if np.any(self.C[i]) and np.any(self.B[:, i])]

    def fastest(self) -> float:
        """Return the largest frequency of a relevant pole, rad/s.

        Poles with a damping ratio of at least 30 % that hardly move the tool are not relevant.
        """
        eigen: Any = np.linalg.eig(self.A)
        poles, shapes = eigen
        counts = np.ones(poles.size, bool)
        if np.linalg.cond(shapes) < _DISTINCT:
            into = np.linalg.norm(np.linalg.solve(shapes, self.B), axis=1)
            peak = np.linalg.norm(self.C @ shapes, axis=0) * into / np.maximum(np.abs(poles.real), 1e-300)
            # Well damped poles of the control are fast but do not move the tool: resolving them would only cost points.
            counts = (-poles.real < 0.3 * np.abs(poles)) | (peak > _MOVES * peak.max())
        return float(np.max(np.abs(poles.imag[counts]), initial=0.0))

    def table(self) -> Table:
        """Return a table of the modes: frequency and damping ratio of the poles."""
        poles = np.linalg.eigvals(self.A)
        upper = sorted(poles[poles.imag >= 0.0], key=abs)
        rows = [[float(abs(p)) / (2.0 * np.pi), float(-p.real / abs(p) if p else 1.0)] for p in upper]
        return Table("what gives way at the tool", [Column("mode", "Hz", "5"), Column("damping ratio", "")], rows)


def tool_modes(*modes: ToolMode) -> ToolPoint:
    """Return the tool point of parallel modes of tool or workpiece. Raises ParameterError if there are no modes."""
    if not modes:
        raise ParameterError("a tool point needs at least one mode")
    n = len(modes)
    A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2)), np.zeros((2, 2 * n))
    for i, mode in enumerate(modes):
        w = 2.0 * np.pi * mode.frequency
        shape = np.array([mode.feed, mode.normal])
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0.0, 1.0], [-w * w, -2.0 * mode.damping_ratio * w]]
        B[2 * i + 1], C[:, 2 * i] = shape / mode.mass, shape
    return ToolPoint(A, B, C)


def tool_point(
    system: Loop | Machine | StateSpace,
    along: Sequence[str | None] = (),
    *,
    velocity: float = 0.05,
    lowest: float = 0.1,
) -> ToolPoint:
    """Return the tool point of a loop or machine with sampled controllers: the response of the load to a force on it.

    along     the axes along feed and normal, None for a rigid direction; default for a loop: its axis along the feed
    velocity  velocity of the axes for the linearization, m/s, as in `linearize`
    lowest    lowest frequency of the fit, Hz

    The sampled model, divided by the frequency response of the zero-order hold, is the response of the machine to a
    continuous force:

        G(jω) = G_d(e^(jωT)) / [(1 - e^(-jωT))/(jωT)]

    The tool point has the poles of the model, ln(z)/T, and a few fast poles that approximate the effect of the
    zero-order hold and the dead time.  The residues are fitted to G up to 0.4/T by least squares; the remaining error
    is `missed`.  Aliases, of the order of (fT)², are neglected.  If the machine has a `MillingCut`, its axes are the
    default of `along`; the cut itself is removed, since the lobes add its force.
    Raises UnstableError for a loop that is unstable without a cut, ParameterError for a fit error above 1 %.
    """
    if isinstance(system, StateSpace):
        model, size = system, len(system.inputs)
        kept = list(range(size))
        if len(system.outputs) != size or size not in (1, 2):
            raise ParameterError(
                f"a tool point needs forces and positions along feed and normal, one or two of each, not "
                f"{size} inputs and {len(system.outputs)} outputs"
            )
    else:
        check_system(system)
        names = tuple(along) or _moved(system)
        if isinstance(system, Machine):
            system = dataclasses.replace(
                system,
                # The lobes add the force of the cut themselves: it must not act twice.
                couplings=tuple(coupling for coupling in system.couplings if not isinstance(coupling, MillingCut)),
            )
        if len(names) > 2 or all(name is None for name in names):
            raise ParameterError("along names the axis of the feed and that of the normal: two, or one and None")
        ports = dict(zip(system.loops(), system.ports(), strict=True))
        for name in names:
            if name is not None and name not in ports:
                raise ParameterError(f"along: there is no axis '{name}'; there are {', '.join(ports)}")
            if name is not None and system.loops()[name].axis.rotary:
                raise ParameterError(f"axis '{name}' turns: feed and normal of a cut are axes in m, name them by along")
        kept = [i for i, name in enumerate(names) if name is not None]
        axes = [ports[name] for name in names if name is not None]
        inputs, outputs = [f"{port}load_force" for port in axes], [f"{port}position_load" for port in axes]
        model = linearize(system, inputs, outputs, velocity=velocity)
    # Lobes need continuous time: the tooth period is no multiple of the sample time.
    continuous = _continuous(model, lowest)
    B, C = np.zeros((continuous.A.shape[0], 2)), np.zeros((2, continuous.A.shape[0]))
    B[:, kept], C[kept] = continuous.B, continuous.C
    return ToolPoint(continuous.A, B, C, continuous.missed)


def cut_of(machine: Machine) -> MillingCut:
    """Return the milling cut of a machine. Raises ParameterError if it has none or several."""
    cuts = [coupling for coupling in machine.couplings if isinstance(coupling, MillingCut)]
    if len(cuts) != 1:
        count = "no milling_cut" if not cuts else f"{len(cuts)} milling_cuts"
        raise ParameterError(
            f"the machine has {count} among its couplings: the lobes need one, with cutter and spindle_speed "
            f'([[couplings]] kind = "milling_cut")'
        )
    return cuts[0]


def _moved(system: Loop | Machine) -> tuple[str, ...]:
    """Return the axes along feed and normal that the cut names, or the first two axes."""
    cuts = (
        [coupling for coupling in system.couplings if isinstance(coupling, MillingCut)]
        if isinstance(system, Machine)
        else []
    )
    return (cuts[0].along_x, cuts[0].along_y) if cuts else tuple(system.loops())[:2]


def _continuous(model: StateSpace, lowest: float) -> ToolPoint:
    """Return a continuous system with the poles of a sampled model, fitted to its response with the zero-order hold
    removed.
    """
    T, q = model.sample_time, len(model.inputs)
    z = model.poles()
    if z.size and abs(z[0]) >= 1.0:
        raise UnstableError(
            f"the machine is unstable without any cut (|z| = {Quantity(abs(z[0])):7}, must be < 1): make its loops "
            "stable first"
        )
    poles = _poles(z, T)
    # a grid over ln f would miss narrow resonances: lines are added within three half widths of each pole
    frequency = np.unique(
        np.concatenate(
            [
                np.geomspace(lowest, 0.4 / T, 400),
                *(
                    abs(p.imag) / (2.0 * np.pi) + np.linspace(-3.0, 3.0, 25) * abs(p.real) / (2.0 * np.pi)
                    for p in poles
                ),
            ]
        )
    )
    frequency = frequency[(frequency >= lowest) & (frequency <= 0.4 / T)]
    s = 2j * np.pi * frequency
    # the force of the cut is continuous: the hold of the sampled model is divided out
    hold = (1.0 - np.exp(-s * T)) / (s * T)
    responses = np.stack(
        [
            np.stack([model.response(frequency, row, column).response / hold for column in model.inputs], axis=-1)
            for row in model.outputs
        ],
        axis=-2,
    )
    columns = [column for pole in poles for column in _terms(s, pole)]
    basis = np.stack(columns, axis=1)
    size = np.abs(responses).reshape(s.size, -1).max(axis=1)
    # relative errors, with a floor so that antiresonances do not dominate
    weight = 1.0 / (size + 1e-4 * size.max()) / (1.0 + (frequency * T / _KNEE) ** 2)
    tall = np.vstack([(basis * weight[:, None]).real, (basis * weight[:, None]).imag])
    flat = responses.reshape(s.size, q * q)
    right = np.vstack([(flat * weight[:, None]).real, (flat * weight[:, None]).imag])
    # columns of fast and slow poles differ by many powers of ten
    scale = np.linalg.norm(tall, axis=0)
    residues = np.linalg.lstsq(tall / scale, right, rcond=1e-13)[0] / scale[:, None]
    missed = float(np.max(np.abs(basis @ residues - flat)) / np.max(size))
    if missed > _WORST:
        raise ParameterError(
            "the response of the machine at the tool is not that of its poles: a fit misses it by "
            f"{Quantity(missed, 'share'):3} of its largest compliance; sample faster, or give the modes by tool_modes"
        )
    return _realized(poles, residues.reshape(-1, q, q), missed)


def _poles(z: np.ndarray, T: float) -> list[complex]:
    """Return one pole of each pair, in 1/s; poles at z = 0 due to the zero-order hold and the dead time are replaced by
    a few fast ones.
    """
    slow = [complex(np.log(complex(p)) / T) for p in z if abs(p) > 1e-3 and p.imag >= 0.0 and not _alternates(p)]
    return [*slow, *(complex(-rate / T) for rate in _FAST)]


def _alternates(p: complex) -> bool:
    # ln z of a negative real pole has the imaginary part π/T without a conjugate: no real continuous system has it
    return abs(p.imag) < 1e-12 and p.real < 0.0


def _terms(s: np.ndarray, pole: complex) -> list[np.ndarray]:
    """Return the scaled basis functions of a pole: 1/(s - p), or 1/d and s/d for a pair with polynomial d."""
    if abs(pole.imag) < 1e-9 * abs(pole):
        return [abs(pole) / (s - pole.real)]
    below = s * s - 2.0 * pole.real * s + abs(pole) ** 2
    return [abs(pole) ** 2 / below, abs(pole) * s / below]


def _realized(poles: Sequence[complex], residues: np.ndarray, missed: float) -> ToolPoint:
    """Realize the residues as a state-space model, one block for each pole and each direction of the force."""
    q = residues.shape[1]
    blocks: list[tuple[np.ndarray, np.ndarray, Any]] = []
    at = 0
    for pole in poles:
        size = abs(pole)
        if abs(pole.imag) < 1e-9 * size:
            blocks.append((np.array([[pole.real]]), np.array([size]), residues[at : at + 1]))
            at += 1
        else:
            # states 1/below and s/below
            companion = np.array([[0.0, 1.0], [-size * size, 2.0 * pole.real]])
            scaled = residues[at : at + 2] * np.array([size**2, size])[:, None, None]
            blocks.append((companion, np.array([0.0, 1.0]), scaled))
            at += 2
    n = sum(block[0].shape[0] for block in blocks) * q
    A, B, C = np.zeros((n, n)), np.zeros((n, q)), np.zeros((q, n))
    row = 0
    for companion, into, left in blocks:
        for column in range(q):
            m = companion.shape[0]
            A[row : row + m, row : row + m], B[row : row + m, column] = companion, into
            C[:, row : row + m] = left[:, :, column].T
            row += m
    return ToolPoint(A, B, C, missed)
