"""The linear systems of a certificate: the deployed controller and its plants.

Each number that the controller stores is rounded to the controller's arithmetic.  A plant is a sampled model, given or
fitted, with the measured frequency lines, if any.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.actuator.velocity_loop import VelocityLoop
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.signals import Setpoint
from feeddrive.identification.response.modal_fit import common_poles
from feeddrive.language import tree
from feeddrive.language.errors import NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.ring import Ring
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import MOST, Lifted, StateSpace, lifted, linearize
from feeddrive.loop.loop import Loop, response_unit

READINGS = ("reading_motor", "reading_load")
_COARSE = 0.01  # relative change of a number by rounding that is reported
_STATES = 60  # largest number of states of a control, as in the checker
_KEPT = 2.0**-300, 2.0**300  # smallest and largest magnitude of a number in a certificate


@dataclass(frozen=True, eq=False)
class Deployed:
    """The linear controller as deployed, with the rounded numbers that it stores.

    model    model from `readings` to the force; for a multirate law, one model per sample
    numbers  parameters and precomputed coefficients by name, after rounding
    coarse   relative change by name, for numbers that rounding changes by more than 1 %
    """

    model: StateSpace | Lifted
    arithmetic: str
    numbers: Mapping[str, float]
    coarse: Mapping[str, float]


def rounded(value: float, arithmetic: str) -> float:
    """Round a number to an arithmetic: float64, float32, or fixedN with N binary places.

    Raises ParameterError for an unknown name, and for a number outside the range of float32.
    """
    if arithmetic == "float64":
        return float(value)
    if arithmetic == "float32":
        with np.errstate(over="ignore"):
            near = float(np.float32(value))
        if np.isinf(near) and np.isfinite(value):
            raise ParameterError(f"{Quantity(value):6} is beyond float32, which ends at 3.4e38")
        return near
    if re.fullmatch(r"fixed[1-9]\d?", arithmetic):
        places = int(arithmetic[5:])
        return float(np.ldexp(np.rint(np.ldexp(float(value), places)), -places))
    raise ParameterError(
        f"arithmetic = '{arithmetic}' must be float64, float32, or fixedN with N binary places, as fixed24"
    )


def deployed(control: Control, sample_time: float, arithmetic: str = "float64", velocity: float = 0.05) -> Deployed:
    """Linearize a controller after rounding its parameters and precomputed coefficients.

    The traced step is linearized, so the matrices are those of the deployed code: a rounded filter coefficient
    moves the actual pole of the controller.  Guard and force limit are omitted.
    Raises ParameterError for a law with more than 64 samples per period, and for a controller with more than 60 states.
    """
    law = control.law
    if law.scheduled_at():
        raise ParameterError(
            f"the law '{law.kind}' depends on the position of the axis, and a certificate is that of one linear "
            "control: prove it along the travel (feeddrive travel with --kept --certify), or certify the law of one "
            "place (tuning.frozen)"
        )
    if law.period() > MOST:
        raise ParameterError(
            f"the law '{law.kind}' repeats itself every {law.period()} samples, and a certificate takes at most "
            f"{MOST}: set position_every <= {MOST}, or take a longer sample time"
        )
    swings = 0.1 / sample_time  # rad/s of an axis that only provides readings
    # any axis with two readings will do: only the rows and columns of the control are kept below
    plant = TwoMass(mass_motor=1.0, mass_load=1.0, stiffness=0.5 * swings * swings)
    takes = None if law.commanded == "force" else VelocityLoop(Kp=1.0)
    axis = Axis(plant=plant, actuator=Actuator(velocity_loop=takes))
    bare = control.unlimited()
    memory = bare.start(bare.prepare(sample_time), Setpoint(0.0), 0.0, 0.0).memory
    # before the linearization, which would treat each cell of a ring as a state
    _check_size(sum(ring.length for _, ring in tree.leaves(memory) if isinstance(ring, Ring)))
    numbers: dict[str, float] = {}
    coarse: dict[str, float] = {}

    def stored(name: str, value: float) -> float:
        near = rounded(value, arithmetic)
        numbers[name] = near
        if value != 0.0 and abs(near / value - 1.0) > _COARSE:
            coarse[name] = abs(near / value - 1.0)
        return near

    loop = Loop(control=bare, axis=axis, sample_time=sample_time)
    try:
        names = ["cut", *READINGS], ["force"]
        if law.period() > 1:
            samples = lifted(loop, *names, velocity=velocity, stored=stored).samples
        else:
            samples = (linearize(loop, *names, velocity=velocity, stored=stored),)
    except ParameterError:
        # a block refuses a gain that was rounded to 0 by its bound, which would not tell the user the cause
        gone = [name for name, share in coarse.items() if share == 1.0]
        if not gone:
            raise
        raise ParameterError(f"{arithmetic} has too few digits for this control: {gone[0]} becomes zero") from None
    kept = [i for i, name in enumerate(samples[0].states) if name.startswith("control.")]
    used = [i for i in (1, 2) if any(np.any(sample.B[kept, i]) or np.any(sample.D[:, i]) for sample in samples)]
    if not used:
        raise ParameterError(f"the law '{law.kind}' does not use any reading: there is no loop to certify")
    _check_size(len(kept))
    states = tuple(samples[0].states[i].removeprefix("control.") for i in kept)
    models = tuple(
        StateSpace(
            sample.A[np.ix_(kept, kept)],
            sample.B[np.ix_(kept, used)],
            sample.C[:, kept],
            sample.D[:, used],
            float(sample_time),
            states,
            tuple(READINGS[i - 1] for i in used),
            ("force",),
        )
        for sample in samples
    )
    sizes = np.abs(
        np.concatenate(
            [
                x.ravel()
                for control_sample in models
                for x in (control_sample.A, control_sample.B, control_sample.C, control_sample.D)
            ]
        )
    )
    wrong = sizes[(sizes != 0.0) & ((sizes < _KEPT[0]) | (sizes > _KEPT[1]))]
    if wrong.size:
        raise ParameterError(
            f"the control holds the coefficient {Quantity(wrong[0]):6}, too large or too small to certify"
        )
    model = models[0] if len(models) == 1 else Lifted(models)
    return Deployed(model, arithmetic, {k: v for k, v in numbers.items() if _fits(v)}, coarse)


def _check_size(states: int) -> None:
    if states > _STATES:
        raise ParameterError(
            f"the control remembers {states} numbers, and a certificate is about {_STATES} at most: certify it without "
            f"the block that keeps so many samples, such as repetitive control"
        )


def _fits(value: float) -> bool:
    return value == 0.0 or _KEPT[0] < abs(value) < _KEPT[1]


_LINES = 250  # number of fitted lines, spread over ln f
_MOST = 8  # modes
_SHARE = 0.01  # relative noise floor of a response: less noise does not increase the weight of a line
_BETTER = 0.85  # an additional mode must reduce the misfit to this fraction
_USELESS = 0.5  # largest median relative misfit of a model


def fitted_plant(name: str, measured: Sequence[FRF], T: float) -> tuple[StateSpace, float, int]:
    """Fit a sampled plant model to measured frequency lines; return it, its dead time in s and its number of modes.

        x/f = e^(-s·dead_time) hold(s) [ (a + b s)/(s (s + corner)) + Σ (aᵢ + bᵢ s)/(s² + 2ζᵢωᵢs + ωᵢ²) ]

    The outputs are in the order of `measured`. ω, ζ, corner and dead time are common to all outputs. They are
    fitted by nonlinear least squares, from which all a and b are eliminated (variable projection). Then the modes are
    sampled exactly, and a and b are fitted again.
    Raises NotIdentifiableError if the median misfit exceeds half of the response.
    """
    f = measured[0].frequency
    inside = np.flatnonzero(f < 0.45 / T)
    wanted = np.geomspace(f[inside[0]], f[inside[-1]], _LINES)
    keep = np.unique(inside[np.searchsorted(f[inside], wanted).clip(0, inside.size - 1)])
    if keep.size < 10:
        raise NotIdentifiableError(f"'{name}': {keep.size} lines are too few to fit a plant to: at least 10")
    f, G = f[keep], np.array([frf.response[keep] for frf in measured])
    noise = np.array([np.zeros(f.size) if frf.variance is None else frf.variance[keep] for frf in measured])
    weight = 1.0 / np.sqrt(noise + (_SHARE * np.abs(G)) ** 2 + 1e-300)
    best: tuple[float, np.ndarray] | None = None
    for count in range(_MOST + 1):
        # six real numbers for each coefficient, or one more mode fits the noise alone
        if 2 * f.size * len(G) < 6 * (2 + 2 * count) * len(G):
            break
        candidate = _refined(f, G, weight, T, count)
        # one more mode always fits the noise a little better: it must reduce the misfit by 15 %
        if best is None or candidate[0] < _BETTER ** (count - _modes(best[1])) * best[0]:
            best = candidate
        # stop after two modes in a row without sufficient improvement
        elif count >= _modes(best[1]) + 2:
            break
    assert best is not None
    model = _sampled(best[1], f, G, weight, T, len(measured))
    left = np.array([model.response(f, output=output).response for output in model.outputs])
    if np.median(np.abs(left / G - 1.0)) > _USELESS:
        raise NotIdentifiableError(
            f"'{name}': no model with up to {_MOST} modes fits it; give the axis as a machine, or measure with "
            f"less noise"
        )
    return model, float(best[1][-1]), _modes(best[1])


def _modes(values: np.ndarray) -> int:
    return (values.size - 2) // 2


def _columns(values: np.ndarray, s: np.ndarray, T: float) -> np.ndarray:
    """Return the basis functions of the fit at s = jω, shape (lines, columns).

    They are the responses of rigid-body motion and modes, first in position, then in velocity, with the zero-order hold
    and the delay.
    """
    k = _modes(values)
    omega, ratio = np.exp(values[:k]), np.exp(values[k : 2 * k])
    corner, late = np.exp(values[-2]), values[-1]
    late_hold = np.exp(-s * late) * (1.0 - np.exp(-s * T)) / (s * T)
    free = 1.0 / (s * (s + corner))
    modes = 1.0 / (s[:, None] ** 2 + 2.0 * np.outer(s, ratio * omega) + omega**2)
    both = np.column_stack([free, modes])
    return np.hstack([both, both * s[:, None]]) * late_hold[:, None]


def _solved(columns: np.ndarray, G: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fit each response G as a linear combination of the columns; return real coefficients and weighted residuals."""
    factors: list[np.ndarray] = []
    left: list[np.ndarray] = []
    for response, w in zip(G, weight, strict=True):
        matrix = columns * w[:, None]
        stacked = np.vstack([np.real(matrix), np.imag(matrix)])
        # columns of rigid-body motion and modes differ by many orders of magnitude
        scale = np.linalg.norm(stacked, axis=0) + 1e-300
        right = np.concatenate([np.real(response * w), np.imag(response * w)])
        x = np.linalg.lstsq(stacked / scale, right, rcond=None)[0]
        factors.append(x / scale)
        left.append(stacked / scale @ x - right)
    return np.array(factors), np.concatenate(left)


def _refined(f: np.ndarray, G: np.ndarray, weight: np.ndarray, T: float, count: int) -> tuple[float, np.ndarray]:
    """Fit modes and dead time by nonlinear least squares; return the RMS residual and the parameters.

    The start is the best of several, which combine the poles of a vector fit with different dead times.
    """
    from scipy.optimize import least_squares  # imported late: commands that only read do not need it

    s = 2j * np.pi * f
    low = 2.0 * np.pi * f[0]
    # s² removes the rigid-body motion; the remaining dead time and hold need a few poles
    plain = [response * s * s for response in G]
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
    begin = min(starts, key=lambda start: start[0])[1]
    least = np.concatenate([np.full(count, np.log(0.3 * low)), np.full(count, np.log(1e-5)), [np.log(1e-6 * low), 0.0]])
    # a mode beyond the last line would be noise
    most = np.concatenate(
        [np.full(count, np.log(2.0 * np.pi * f[-1])), np.full(count, np.log(2.0)), [np.log(10.0 * low), 30 * T]]
    )
    fit = least_squares(
        lambda x: _solved(_columns(x, s, T), G, weight)[1],
        np.clip(begin, least + 1e-9, most - 1e-9),
        bounds=(least, most),
        x_scale=np.concatenate([np.full(2 * count, 0.1), [1.0, 0.1 * T]]),
        max_nfev=40,
    )
    return float(np.sqrt(np.mean(fit.fun**2))), fit.x


def _sampled(values: np.ndarray, f: np.ndarray, G: np.ndarray, weight: np.ndarray, T: float, count: int) -> StateSpace:
    """Sample the modes exactly; fit the outputs, as combinations of positions and velocities, to the measured frequency
    lines.
    """
    k = _modes(values)
    modes = [
        Mode(frequency=float(w / (2.0 * np.pi)), damping_ratio=float(d), mass=1.0, motor=1.0, load=1.0)
        for w, d in zip(np.exp(values[:k]), np.exp(values[k : 2 * k]), strict=True)
    ]
    plant = Modal(mass=1.0, viscous=float(np.exp(values[-2])), modes=tuple(modes))
    axis = Axis(plant=plant, actuator=Actuator(dead_time=float(values[-1])))
    # the plant alone is of interest, and any law that takes such an axis will do
    loop = Loop(control=Control(law=CascadePPI(Kv=1.0, Kp=1.0)), axis=axis, sample_time=T)
    sampled = linearize(loop, ["cut"], ["reading_motor", "reading_load"][:count], velocity=0.05)
    moving = [i for i, state in enumerate(sampled.states) if state.startswith(("axis.position.", "axis.velocity."))]
    z = np.exp(2j * np.pi * f * T)
    n = len(sampled.states)
    states = np.linalg.solve(z[:, None, None] * np.eye(n) - sampled.A, np.broadcast_to(sampled.B, (z.size, n, 1)))[
        :, moving, 0
    ]
    C = np.zeros((count, n))
    C[:, moving] = _solved(states, G, weight)[0]
    return replace(sampled, C=C)


# m/N: ten decades beyond the response of any axis, on either side
_SIZES = 1e-40, 1e20
# relative to the sum of magnitudes: rounding is far below it, a spring to the ground far above
_ZERO = 1e-9


class Lines(NamedTuple):
    """The measured response of one reading: frequency in Hz, response in m/N, variance in (m/N)²."""

    frequency: np.ndarray
    response: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True, eq=False)
class NominalPlant:
    """A plant at one position and load.

    model   sampled model from the command to the readings, including dead time
    lines   the measured frequency lines, by reading; empty for a plant without measurement
    source  the origin of the plant, as a string
    """

    name: str
    model: StateSpace
    lines: tuple[Lines, ...]
    source: str
    dead_time: float


def modelled_plant(
    name: str, axis: Axis, control: Control, sample_time: float, readings: Sequence[str], velocity: float
) -> NominalPlant:
    """Return the plant of an axis model, linearized at `velocity` (m/s) and sampled exactly.

    It includes dead time, current loop and the slope of the friction. The rigid-body motion has a state of its own, so
    that its pole remains exactly at z = 1 after rounding.
    Raises ParameterError if a command causes no motion, for example because the axis sticks.
    """
    loop = Loop(control=control.unlimited(), axis=axis, sample_time=sample_time)
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
    """Transform the positions to q₁ and qᵢ - (eᵢ/e₁) q₁; then the rigid-body motion e changes q₁ alone."""
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
    # set exactly, so that the integrator keeps its pole at 1 in the checker's arithmetic
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
    """Return a plant with measured frequency lines; its model is that of a known axis, or is fitted to the lines.

    `measured` contains the response of the load encoder and, if measured, that of the motor encoder; a single response
    is used for all readings.
    Raises ParameterError for a unit other than m/N (m/(m/s) of a law that commands a velocity) or readings that were
    not measured, and NotIdentifiableError if no model fits.
    """
    load, motor = measured[0], measured[1] if len(measured) > 1 else None
    for frf in measured:
        wanted = response_unit(control.law.commanded)
        if frf.unit not in ("", wanted):
            raise ParameterError(
                f"'{name}' is in {frf.unit}: the plant of a law that commands a {control.law.commanded} must be in "
                f"{wanted}"
            )
        if np.count_nonzero(frf.frequency < 0.5 / sample_time) < 2:
            raise ParameterError(f"'{name}' has fewer than two lines below half the sample rate")
        size = np.abs(frf.response)
        wrong = np.flatnonzero(~((size > _SIZES[0]) & (size < _SIZES[1])))
        if wrong.size:
            raise ParameterError(
                f"'{name}' is {Quantity(size[wrong[0]], wanted):3 SI} at {Quantity(frf.frequency[wrong[0]], 'Hz'):6}: "
                "no axis is"
            )
    chosen = [load if motor is None or reading == READINGS[1] else motor for reading in readings]
    taken = chosen[:1] if all(frf is chosen[0] for frf in chosen) else chosen
    lines = tuple(_lines(frf, sample_time) for frf in taken)
    count = f"{sum(line_set.frequency.size for line_set in lines)} measured lines"
    if axis is None:
        if any(np.any(frf.frequency != taken[0].frequency) for frf in taken if frf.frequency.size):
            raise ParameterError(f"'{name}': the responses of both encoders have different lines")
        model, late, modes = fitted_plant(name, taken, sample_time)
        C = model.C if len(taken) == len(readings) else np.repeat(model.C, len(readings), axis=0)
        model = replace(model, C=C, D=np.zeros((len(readings), 1)), outputs=tuple(readings))
        return NominalPlant(name, model, lines, f"free motion and {modes} modes fitted to {count}", late)
    one = modelled_plant(name, axis, control, sample_time, readings, velocity)
    if len(taken) < len(readings) and np.any(one.model.C[0] != one.model.C[-1]):
        raise ParameterError(f"'{name}': the control reads motor and load: give the motor's response, too")
    return replace(one, lines=lines, source=f"{one.source}; {count}")


def _lines(frf: FRF, sample_time: float) -> Lines:
    """Return the frequency lines below half the sample rate; an unknown variance is computed from the coherence,
    otherwise it is 0.
    """
    variance = frf.known_variance()
    variance = np.zeros(frf.frequency.size) if variance is None else variance
    keep = frf.frequency < 0.5 / sample_time
    return Lines(frf.frequency[keep], frf.response[keep], variance[keep])
