"""Poles: gains by pole placement, the poles that the parameters of a law set, and the shift of a closed-loop pole."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from feeddrive.analysis.stability import Stability, stability
from feeddrive.blocks.controller.active_disturbance_rejection import ActiveDisturbanceRejection
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.controller.generalized_predictive import GeneralizedPredictive
from feeddrive.blocks.controller.linear_adrc import LinearADRC
from feeddrive.blocks.controller.lqg import LQG
from feeddrive.blocks.controller.pole_placement import PolePlacement
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.plant.two_bodies import Gains
from feeddrive.language import tree
from feeddrive.language.block import Block, declarations
from feeddrive.language.errors import ParameterError, UnstableError, nearest
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.language.units import rounded
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.loop import Loop
from feeddrive.tuning.control_response import READINGS

_SMALLEST = 0.02  # of a tunable: lower end of the search for a stable value
_HALVINGS = 20


@dataclass(frozen=True, eq=False, repr=False)
class Placement(Result):
    """The result of a pole placement: gains in SI, the five placed poles in 1/s, and the poles of the sampled loop.

    poles    placed poles of the continuous-time model, slowest first
    reached  poles of the loop with its axis, delay, filters and sampling, as s = ln z / T, slowest first
    """

    gains: Gains
    poles: np.ndarray
    reached: np.ndarray
    stability: Stability

    def table(self) -> Table:
        """Tabulate the gains, the placed poles and, for comparison, as many of the slowest poles of the loop."""
        units = ("N/m", "N/m", "N s/m", "N s/m", "N/(m s)")
        rows = [
            [name, Quantity(value, unit, form="6 SI")]
            for name, value, unit in zip(Gains._fields, self.gains, units, strict=True)
        ]
        rows += [["pole placed", _words(pole)] for pole in self.poles]
        rows += [["pole of the loop", _words(pole)] for pole in self.reached[: self.poles.size]]
        return Table(self.stability.sentence(), ["pole placement", "value"], rows)


def _words(pole: complex) -> str:
    size = abs(pole)
    return Text(
        f"{number(pole.real)}{Quantity(pole.imag):+.4g}j 1/s ({Quantity(size / (2.0 * np.pi), 'Hz')}, damping "
        f"{Quantity(-pole.real / size):.3f})"
    )


def placement(loop: Loop, *, velocity: float = 0.05) -> Placement:
    """Return gains and poles of a loop whose law is designed by pole placement.

    Raises ParameterError for any other law.
    Raises UnstableError, with |z|, its bound and the nearest stable value of each tunable, if delay, filters and
    unmodelled modes of the axis prevent these poles. The law itself rejects poles that no gain can place: see
    `blocks/plant/two_bodies.py`.
    """
    law = loop.control.law
    if not isinstance(law, PolePlacement):
        raise ParameterError(f"control.law is '{law.kind}', which is not a pole placement: take pole_placement")
    sampled = stability(loop, velocity=velocity)
    if not sampled.stable:
        near = list(_stable_tunables(loop, velocity))
        remedy = joined("; or ", near) or "none by lowering a single tunable"
        raise UnstableError(
            f"control.law: the poles cannot be reached on this axis: {sampled.sentence()} (|z| = "
            f"{Quantity(sampled.growth):.6f}, must be < 1); the nearest stable values: {remedy}. If the axis has a "
            f"mode there that the model leaves out, put a notch at {Quantity(sampled.frequency, 'Hz')}"
        )
    poles = np.roots([float(a) for a in reversed(law.polynomial())])
    z = sampled.model.poles()
    # the delays of dead time and filters are poles at 0, without a finite s
    reached = np.log(z[np.abs(z) > 1e-12].astype(complex)) / sampled.model.sample_time
    return Placement(law.gains(), poles[np.argsort(np.abs(poles))], reached[np.argsort(np.abs(reached))], sampled)


def _stable_tunables(loop: Loop, velocity: float) -> Iterator[str]:
    """Yield a phrase for each tunable that can stabilize the loop if the others are unchanged.

    The phrase gives the largest value below the present one at which the loop is stable.
    """
    for tunable in loop.control.law.tunables:
        present = float(tree.get(loop.control.law, tunable))

        def is_stable(share: float, tunable: str = tunable, present: float = present) -> bool:
            law = tree.vary(loop.control.law, {tunable: share * present})
            varied = replace(loop, control=replace(loop.control, law=law))
            return stability(varied, velocity=velocity).stable

        shares = np.geomspace(1.0, _SMALLEST, 31)
        stable = next((i for i, share in enumerate(shares) if i and is_stable(float(share))), None)
        if stable is None:
            continue
        low, high = float(shares[stable]), float(shares[stable - 1])
        for _ in range(_HALVINGS):
            middle = float(np.sqrt(low * high))
            low, high = (middle, high) if is_stable(middle) else (low, middle)
        unit = tree.declaration(loop.control.law, tunable).unit
        least, now = (Quantity(value, unit, form="SI") for value in (low * present, present))
        yield Text(f"{tunable} = {least} instead of {now}")


_LEAST, _MOST = 0.01, 1.0  # range of a dragged damping ratio
_BUTTERWORTH = float(np.sqrt(0.5))


class _Placed(NamedTuple):
    """The block parameters that place a real pole or a complex pair.

    frequency  name of the field with the frequency
    damping    name of the field with the damping ratio; empty if there is none
    ratio      the damping ratio if there is no such field
    """

    label: str
    frequency: str
    damping: str = ""
    ratio: float = 1.0


_PLACED: Mapping[type[Block], tuple[_Placed, ...]] = {
    PolePlacement: (
        _Placed("real pole", "bandwidth"),
        _Placed("rigid pair", "rigid_frequency", "rigid_damping"),
        _Placed("axial pair", "axial_frequency", "axial_damping"),
    ),
    LinearADRC: (_Placed("tracking error", "omega_c", "zeta_c"), _Placed("observer, three real poles", "omega_o")),
    ActiveDisturbanceRejection: (_Placed("tracking error", "omega_c", "zeta_c"),),
    GpiObserver: (_Placed("observer, its pairs", "omega_o", "zeta_o"), _Placed("observer, real pole", "p0")),
    LQG: (
        _Placed("tracking error", "omega_c", ratio=_BUTTERWORTH),
        _Placed("filter, own frequency", "omega_o", ratio=_BUTTERWORTH),
    ),
    GeneralizedPredictive: (_Placed("observer of the prediction", "omega_o"),),
    DADSC: (
        _Placed("sliding line", "tracking_rate"),
        _Placed("reaching it", "reaching_rate"),
        _Placed("adaptation", "adaptation_rate"),
    ),
}


@dataclass(frozen=True)
class PlacedPole:
    """A pole that a law or an observer places by its parameters, disregarding delay and sampling.

    name       dotted name of the pole's frequency within the controller, such as law.axial_frequency; the frequency may
               be set or derived by a rule
    s          the pole, 1/s; for a complex pair, the one in the upper half plane
    frequency, damping  names of the parameters that move the pole; empty if there is no such parameter
    """

    name: str
    label: str
    s: complex
    frequency: str
    damping: str


def placed_poles(control: Control) -> tuple[PlacedPole, ...]:
    """Return all poles that the law and its observers place; empty for a law that is not designed by pole placement."""
    return tuple(_placed(control))


def _placed(control: Control) -> Iterator[PlacedPole]:
    blocks: list[tuple[str, Any]] = [("law", control.law)]
    blocks += [(f"compensation.{i}", block) for i, block in enumerate(control.compensation)]
    blocks += [(f"{where}.observer", block.observer) for where, block in blocks if getattr(block, "observer", None)]
    for where, block in blocks:
        for pole in _PLACED.get(type(block), ()):
            stated = getattr(block, pole.frequency)
            size = _by_rule(block, pole.frequency) if stated is None else _rate(block, pole.frequency)
            if size is None:
                continue
            ratio = min(float(getattr(block, pole.damping)), 1.0) if pole.damping else pole.ratio
            name = f"{where}.{pole.frequency}"
            yield PlacedPole(
                name,
                pole.label,
                size * complex(-ratio, np.sqrt(1.0 - ratio * ratio)),
                "" if stated is None else name,
                f"{where}.{pole.damping}" if pole.damping else "",
            )


def _rate(block: Block, field: str) -> float:
    """Return a frequency field of a block in rad/s."""
    value = float(getattr(block, field))
    return 2.0 * np.pi * value if declarations(type(block))[field].unit == "Hz" else value


def _by_rule(block: Block, field: str) -> float | None:
    """Return the value, rad/s, of a frequency that is not set but follows from others; None without such a rule."""
    if not isinstance(block, PolePlacement):
        return None
    real = _rate(block, "bandwidth")
    if field == "rigid_frequency":
        return real
    rigid = real if block.rigid_frequency is None else _rate(block, "rigid_frequency")
    # the coefficient of s⁰ is the product of all poles: the axial pair is the remaining factor
    return float(np.sqrt(float(block.polynomial()[0]) / (real * rigid**2)))


def placed_dragged(control: Control, name: str, s: complex) -> dict[str, float]:
    """Return the parameters that place a pole as close to s (1/s) as possible.

    |s| gives the frequency in rad/s, and -Re s/|s| the damping ratio, which is limited to 0.01 to 1. Without a damping
    parameter the pole moves along its ray from 0 only.
    Raises ParameterError for an unknown pole.
    """
    poles = {pole.name: pole for pole in placed_poles(control)}
    if name not in poles:
        raise ParameterError(f"the law places no pole '{name:.60}'{nearest(name, poles)}")
    values, pole, size = dict[str, float](), poles[name], abs(s)
    if pole.frequency:
        # a pole without a damping parameter can move only along its ray from 0
        along = size if pole.damping else max((s * np.conj(pole.s)).real / abs(pole.s), 0.0)
        scale = 2.0 * np.pi if tree.declaration(control, pole.frequency).unit == "Hz" else 1.0
        values[pole.frequency] = rounded(max(along, 1e-3 * abs(pole.s)) / scale, 4)
    if pole.damping and size > 0.0:
        values[pole.damping] = rounded(min(max(-s.real / size, _LEAST), _MOST), 4)
    return values


_MOVES = 0.2  # least |d ln s/d ln p| of a pole that gains can move
_SLOWEST, _FASTEST = 1e-4, 0.9  # of half the sample rate, of the poles that can be moved
_SINGLE = 1e-6  # |wᴴ v| of unit eigenvectors below which a pole counts as multiple, without derivatives
_STEP = 0.25  # of a logarithm: largest change of a gain in one step
_STEPS, _SHORTENINGS = 6, 3
_NEAR = 1e-3  # of |s|: tolerance of the location
_WEAK = 0.05  # of the strongest direction of the gains: weaker ones are not used

Model = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""A function from the gains to [A B; c d] of the control, shape (n + 1, n + 2), and its derivatives."""


class LoopPole(NamedTuple):
    """A pole of the closed loop in 1/s, and its derivatives with respect to the logarithms of the gains."""

    s: complex
    slope: np.ndarray


def closed(axis: StateSpace, matrix: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the transition matrix Φ of a closed loop and its derivatives.

    The axis, from `cut` to both readings, has the state x; the controller [A B; c d] has the state ξ:

        x ← A_x x + b (d C x + c ξ),    ξ ← A ξ + B C x
    """
    n, many = matrix.shape[0] - 1, axis.A.shape[0]
    b = axis.B[:, axis.inputs.index("cut")]
    C = axis.C[[axis.outputs.index(reading) for reading in READINGS]]
    force = np.concatenate([matrix[n, n:] @ C, matrix[n, :n]])
    loop = np.zeros((many + n, many + n))
    loop[:many] = b[:, None] * force
    loop[:many, :many] += axis.A
    loop[many:] = np.concatenate([matrix[:n, n:] @ C, matrix[:n, :n]], axis=1)
    changes = np.zeros((many + n, many + n, slopes.shape[2]))
    readings = np.einsum("irp,rj->ijp", slopes[:, n:], C)
    along = np.concatenate([readings, slopes[:, :n]], axis=1)
    changes[:many] = b[:, None, None] * along[n]
    changes[many:] = along[:n]
    return loop, changes


def loop_poles(axis: StateSpace, model: Model, gains: np.ndarray) -> list[LoopPole]:
    """Return the closed-loop poles s = ln z/T in the upper half plane that the gains (all > 0) can move, slowest first.

        d z/d p = wᴴ (∂Φ/∂p) v / (wᴴ v),   v and w the right and the left eigenvector

    Multiple poles, poles faster than 0.9 of half the sample rate, and poles with a relative sensitivity below 1/5 to
    every gain are omitted.
    """
    from scipy.linalg import eig, matrix_balance

    T = axis.sample_time
    loop, changes = closed(axis, *model(gains))
    # the states have different units, such as m and N
    loop, (scale, _) = matrix_balance(loop, permute=False, separate=True)
    changes = changes * (scale / scale[:, None])[:, :, None]
    solved: Any = eig(loop, left=True, right=True)
    z, left, right = solved
    nyquist, poles = np.pi / T, list[LoopPole]()
    for k in range(z.size):
        if z[k].imag < 0.0 or (z[k].imag == 0.0 and z[k].real <= 0.0):
            continue
        s, alone = complex(np.log(z[k]) / T), np.vdot(left[:, k], right[:, k])
        if not (_SLOWEST * nyquist < abs(s) < _FASTEST * nyquist) or abs(alone) < _SINGLE:
            continue
        change = np.einsum("i,ijp,j->p", np.conj(left[:, k]), changes, right[:, k]) / alone
        slope = change * gains / (z[k] * T)
        if np.max(np.abs(slope), initial=0.0) > _MOVES * abs(s):
            poles.append(LoopPole(s, slope))
    return sorted(poles, key=lambda pole: abs(pole.s))


def nearest_pole(poles: list[LoopPole], s: complex) -> LoopPole | None:
    """Return the pole nearest to s; None if there is none."""
    return min(poles, key=lambda pole: abs(pole.s - s), default=None)


def pole_moved(
    axis: StateSpace, model: Model, gains: np.ndarray, s: complex, wanted: complex
) -> tuple[np.ndarray, complex]:
    """Return the gains that move the pole at s (1/s) as close to `wanted` as possible, and the resulting pole.

    The gains are found by Newton's method in their logarithms, with minimum-norm steps. No step changes a gain by more
    than a quarter of its value, and only steps that bring the pole closer are accepted. A real pole moves along the
    real axis until it meets another one.
    """
    # `loop_poles` returns the upper half plane only
    wanted = complex(wanted.real, max(wanted.imag, 0.0))
    pole = nearest_pole(loop_poles(axis, model, gains), s)
    if pole is None:
        return gains, s
    for _ in range(_STEPS):
        apart = wanted - pole.s
        if abs(apart) <= _NEAR * abs(wanted):
            break
        rows, right = [np.real(pole.slope)], [apart.real]
        if pole.s.imag > 0.0:
            rows, right = [*rows, np.imag(pole.slope)], [*right, apart.imag]
        # two equations or one for several gains: the pseudoinverse gives the shortest step
        change = np.linalg.pinv(np.array(rows), rcond=_WEAK) @ np.array(right)
        change *= min(1.0, _STEP / max(float(np.max(np.abs(change))), 1e-300))
        for _ in range(_SHORTENINGS):
            tried = gains * np.exp(change)
            candidate = nearest_pole(loop_poles(axis, model, tried), pole.s + complex(pole.slope @ change))
            if candidate is not None and abs(wanted - candidate.s) < abs(apart):
                gains, pole = tried, candidate
                break
            change = 0.5 * change
        else:
            break
    return gains, pole.s
