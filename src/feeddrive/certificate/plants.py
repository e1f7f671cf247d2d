"""The plants of a certificate: sampled linear models, fitted ones among them, and the lines measured on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.certificate.deployed import READINGS
from feeddrive.identification.response.modal_fit import common_poles
from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop

_LINES = 250  # that are fitted, spread over ln f
_MOST = 8  # modes
_SHARE = 0.01  # of a response: less noise does not increase the weight of a line
_BETTER = 0.85  # largest share of the misfit that one more mode may leave
_USELESS = 0.5  # largest mean relative misfit of a model


def fitted_plant(name: str, measured: Sequence[FRF], control: Control, T: float) -> tuple[StateSpace, float, int]:
    """The sampled model with outputs in the order of `measured`, its dead time in s and how many modes it has.

        x/f = e^(-s·dead_time) hold(s) [ (a + b s)/(s (s + corner)) + Σ (aᵢ + bᵢ s)/(s² + 2ζᵢωᵢs + ωᵢ²) ]

    ω, ζ, corner and dead time are common and found by least squares, in which all a and b are solved for (variable
    projection); then the modes are sampled exactly, and a and b are solved for once more.
    Raises NotIdentifiableError if the misfit is half of the response.
    """
    f = measured[0].frequency
    inside = np.flatnonzero(f < 0.45 / T)
    wanted = np.geomspace(f[inside[0]], f[inside[-1]], _LINES)
    keep = np.unique(inside[np.searchsorted(f[inside], wanted).clip(0, inside.size - 1)])
    if keep.size < 10:
        raise NotIdentifiableError(f"'{name}': {keep.size} lines are too few to fit a plant to: at least 10")
    f, G = f[keep], np.array([each.response[keep] for each in measured])
    noise = np.array([np.zeros(f.size) if each.variance is None else each.variance[keep] for each in measured])
    weight = 1.0 / np.sqrt(noise + (_SHARE * np.abs(G)) ** 2 + 1e-300)
    best: tuple[float, np.ndarray] | None = None
    for count in range(_MOST + 1):
        if 2 * f.size * len(G) < 6 * (2 + 2 * count) * len(G):
            break
        found = _refined(f, G, weight, T, count)
        if best is None or found[0] < _BETTER ** (count - _modes(best[1])) * best[0]:
            best = found
        elif count >= _modes(best[1]) + 2:
            break
    assert best is not None
    model = _sampled(best[1], f, G, weight, control, T, len(measured))
    left = np.array([model.response(f, output=each).response for each in model.outputs])
    if np.median(np.abs(left / G - 1.0)) > _USELESS:
        raise NotIdentifiableError(
            f"'{name}': no model with up to {_MOST} modes fits it; give the axis as a machine, or measure with "
            f"less noise"
        )
    return model, float(best[1][-1]), _modes(best[1])


def _modes(values: np.ndarray) -> int:
    return (values.size - 2) // 2


def _columns(values: np.ndarray, s: np.ndarray, T: float) -> np.ndarray:
    """Responses of free motion and modes, position and velocity of each, held and late; shape (lines, columns)."""
    k = _modes(values)
    omega, ratio = np.exp(values[:k]), np.exp(values[k : 2 * k])
    corner, late = np.exp(values[-2]), values[-1]
    late_hold = np.exp(-s * late) * (1.0 - np.exp(-s * T)) / (s * T)
    free = 1.0 / (s * (s + corner))
    modes = 1.0 / (s[:, None] ** 2 + 2.0 * np.outer(s, ratio * omega) + omega**2)
    both = np.column_stack([free, modes])
    return np.hstack([both, both * s[:, None]]) * late_hold[:, None]


def _solved(columns: np.ndarray, G: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Real factors of the columns for each response, and the weighted residuals."""
    factors: list[np.ndarray] = []
    left: list[np.ndarray] = []
    for response, w in zip(G, weight, strict=True):
        matrix = columns * w[:, None]
        stacked = np.vstack([np.real(matrix), np.imag(matrix)])
        scale = np.linalg.norm(stacked, axis=0) + 1e-300
        right = np.concatenate([np.real(response * w), np.imag(response * w)])
        x = np.linalg.lstsq(stacked / scale, right, rcond=None)[0]
        factors.append(x / scale)
        left.append(stacked / scale @ x - right)
    return np.array(factors), np.concatenate(left)


def _refined(f: np.ndarray, G: np.ndarray, weight: np.ndarray, T: float, count: int) -> tuple[float, np.ndarray]:
    """Modes from vector fitting at several dead times, the best of them brought to the least misfit."""
    from scipy.optimize import least_squares  # not for commands that only read

    s = 2j * np.pi * f
    low = 2.0 * np.pi * f[0]
    # s² removes the free motion; the rest of dead time and hold needs a few poles
    plain = [each * s * s for each in G]
    starts: list[tuple[float, np.ndarray]] = []
    for pairs in range(count, count + 4) if count else (0,):
        poles, heights = (
            common_poles([s] * len(plain), plain, pairs, 1) if count else (np.zeros(0, complex), np.zeros(0))
        )
        if poles.size < count:
            continue
        chosen = np.sort_complex(poles[np.argsort(-heights)[:count]])
        ratio = np.clip(-np.real(chosen) / np.abs(chosen), 1e-4, 0.9)
        for late in np.arange(0.0, 4.1, 1.0) * T:
            for corner in (0.05 * low, low):
                begin = np.concatenate([np.log(np.abs(chosen)), np.log(ratio), [np.log(corner), late]])
                starts.append((float(np.sum(_solved(_columns(begin, s, T), G, weight)[1] ** 2)), begin))
    if not starts:
        return np.inf, np.concatenate([np.full(2 * count, -1.0), [np.log(low), 0.0]])
    begin = min(starts, key=lambda each: each[0])[1]
    least = np.concatenate([np.full(count, np.log(0.3 * low)), np.full(count, np.log(1e-5)), [np.log(1e-6 * low), 0.0]])
    # a mode beyond the last line would be noise
    most = np.concatenate(
        [np.full(count, np.log(2.0 * np.pi * f[-1])), np.full(count, np.log(2.0)), [np.log(10.0 * low), 30 * T]]
    )
    found = least_squares(
        lambda x: _solved(_columns(x, s, T), G, weight)[1], np.clip(begin, least + 1e-9, most - 1e-9),
        bounds=(least, most), x_scale=np.concatenate([np.full(2 * count, 0.1), [1.0, 0.1 * T]]), max_nfev=40,
    )  # fmt: skip
    return float(np.sqrt(np.mean(found.fun**2))), found.x


def _sampled(
    values: np.ndarray, f: np.ndarray, G: np.ndarray, weight: np.ndarray, control: Control, T: float, count: int
) -> StateSpace:
    """The modes held exactly over a sample, with positions and velocities mixed so that the lines are met best."""
    k = _modes(values)
    modes = [
        Mode(frequency=float(w / (2.0 * np.pi)), damping_ratio=float(d), mass=1.0, motor=1.0, load=1.0)
        for w, d in zip(np.exp(values[:k]), np.exp(values[k : 2 * k]), strict=True)
    ]
    plant = Modal(mass=1.0, viscous=float(np.exp(values[-2])), modes=tuple(modes))
    axis = Axis(plant=plant, actuator=Actuator(dead_time=float(values[-1])))
    loop = Loop(control=replace(control, guard=None, force_limit=None), axis=axis, sample_time=T)
    made = linearize(loop, ["cut"], ["reading_motor", "reading_load"][:count], velocity=0.05)
    own = [i for i, state in enumerate(made.states) if state.startswith(("axis.position.", "axis.velocity."))]
    z = np.exp(2j * np.pi * f * T)
    n = len(made.states)
    states = np.linalg.solve(z[:, None, None] * np.eye(n) - made.A, np.broadcast_to(made.B, (z.size, n, 1)))[:, own, 0]
    C = np.zeros((count, n))
    C[:, own] = _solved(states, G, weight)[0]
    return replace(made, C=C)


_SIZES = 1e-40, 1e20  # m/N
_ZERO = 1e-9  # of the numbers whose difference it is


class Lines(NamedTuple):
    """A measured response of one reading: Hz, m/N, (m/N)²."""

    frequency: np.ndarray
    response: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True, eq=False)
class NominalPlant:
    """A plant at one position and load.

    model   from the command to the readings, sampled, dead time included
    lines   the measured lines, by reading; empty for a model alone
    source  its source, as text
    """

    name: str
    model: StateSpace
    lines: tuple[Lines, ...]
    source: str
    dead_time: float


def modelled_plant(
    name: str, axis: Axis, control: Control, sample_time: float, readings: Sequence[str], velocity: float
) -> NominalPlant:
    """The axis that moves with `velocity` (m/s), exactly held, its dead time, current loop and friction slope with it.

    The free motion of the axis is a separate state, so that its integrator stays exactly 1 after rounding.
    Raises ParameterError if nothing moves on a command, as with an axis that sticks.
    """
    loop = Loop(control=replace(control, guard=None, force_limit=None), axis=axis, sample_time=sample_time)
    model = linearize(loop, ["cut"], list(readings), velocity=velocity)
    if not model.states:
        raise ParameterError(
            f"'{name}' does not respond to its command at {Quantity(velocity, 'm/s'):6 SI}: does it stick?"
        )
    along = [float(share) for share in axis.plant.mechanics().rigid_motion()]
    # a text of the certificate's file, which names the units of a linear axis
    speed = f"{velocity:g} {'rad/s' if axis.rotary else 'm/s'}"
    held = f"{axis.plant.kind}, held over {1e3 * sample_time:g} ms, moving with {speed}"
    return NominalPlant(name, _free(model, along), (), held, float(axis.actuator.dead_time))


def _free(model: StateSpace, along: Sequence[float]) -> StateSpace:
    """In coordinates q₁ and qᵢ - (eᵢ/e₁) q₁, e the free motion: moving along e changes nothing but q₁ itself."""
    places = [i for i, name in enumerate(model.states) if name.startswith("axis.position.")]
    e = np.array([along[int(model.states[i].rsplit(".", 1)[1])] for i in places])
    if not places or not np.any(e != 0.0):
        return model
    first = int(np.flatnonzero(e)[0])
    n, r = len(model.states), places[first]
    S, back = np.eye(n), np.eye(n)
    for i, share in zip(places, e / e[first], strict=True):
        if i != r:
            S[i, r], back[i, r] = -share, share
    A = S @ model.A @ back
    size = np.abs(S) @ np.abs(model.A) @ np.abs(back)
    unit = np.eye(n)[r]
    if np.any(np.abs(A[:, r] - unit) > _ZERO * size[:, r]):
        return model  # a spring to the ground
    A[:, r] = unit
    return replace(model, A=A, B=S @ model.B, C=model.C @ back)


def measured_plant(
    name: str,
    measured: Sequence[FRF],
    axis: Axis | None,
    control: Control,
    sample_time: float,
    readings: Sequence[str],
    velocity: float,
) -> NominalPlant:
    """A plant with its measured lines: around a known axis, or around a model that is fitted to the lines.

    `measured` has the response of the load's encoder and, if it was measured, that of the motor's; a single one
    serves all readings.
    Raises ParameterError for a unit that is not m/N or readings that were not measured, NotIdentifiableError where no
    model fits.
    """
    load, motor = measured[0], measured[1] if len(measured) > 1 else None
    for each in measured:
        if each.unit not in ("", "m/N"):
            raise ParameterError(f"'{name}' is in {each.unit}: a plant of a certificate must be in m/N")
        if np.count_nonzero(each.frequency < 0.5 / sample_time) < 2:
            raise ParameterError(f"'{name}' has fewer than two lines below half the sample rate")
        size = np.abs(each.response)
        wrong = np.flatnonzero(~((size > _SIZES[0]) & (size < _SIZES[1])))
        if wrong.size:
            raise ParameterError(
                f"'{name}' is {Quantity(size[wrong[0]], 'm/N'):3 SI} at {Quantity(each.frequency[wrong[0]], 'Hz'):6}: "
                "no axis is"
            )
    chosen = [load if motor is None or each == READINGS[1] else motor for each in readings]
    taken = chosen[:1] if all(each is chosen[0] for each in chosen) else chosen
    lines = tuple(_lines(each, sample_time) for each in taken)
    count = f"{sum(each.frequency.size for each in lines)} measured lines"
    if axis is None:
        if any(np.any(each.frequency != taken[0].frequency) for each in taken if each.frequency.size):
            raise ParameterError(f"'{name}': the responses of both encoders have different lines")
        model, late, modes = fitted_plant(name, taken, control, sample_time)
        C = model.C if len(taken) == len(readings) else np.repeat(model.C, len(readings), axis=0)
        model = replace(model, C=C, D=np.zeros((len(readings), 1)), outputs=tuple(readings))
        return NominalPlant(name, model, lines, f"free motion and {modes} modes fitted to {count}", late)
    one = modelled_plant(name, axis, control, sample_time, readings, velocity)
    if len(taken) < len(readings) and np.any(one.model.C[0] != one.model.C[-1]):
        raise ParameterError(f"'{name}': the control reads motor and load: give the motor's response, too")
    return replace(one, lines=lines, source=f"{one.source}; {count}")


def _lines(frf: FRF, sample_time: float) -> Lines:
    """Below half the sample rate, the variance from the coherence if there is no other."""
    variance = frf.known_variance()
    variance = np.zeros(frf.frequency.size) if variance is None else variance
    keep = frf.frequency < 0.5 / sample_time
    return Lines(frf.frequency[keep], frf.response[keep], variance[keep])
