"""The plants of a certificate: sampled linear models with exact integrators, and the lines measured on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from feeddrive.certificate.deployed import READINGS
from feeddrive.certificate.fitted import fitted_plant
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop

_AVERAGES = 8  # behind a coherence that comes without a variance
_SIZES = 1e-40, 1e20  # m/N
_ZERO = 1e-9  # of the numbers that it is the difference of


class Lines(NamedTuple):
    """A measured response of one reading: Hz, m/N, (m/N)²."""

    frequency: np.ndarray
    response: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True, eq=False)
class NominalPlant:
    """A plant at one position and load.

    model   from the command to the readings, sampled, dead time included
    lines   what was measured, by reading; empty for a model alone
    source  where it comes from, in words
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

    The free motion of the axis is made a state of its own, so that its integrator is exactly 1 after rounding, too.
    Raises ParameterError if nothing answers to the command, as an axis that sticks.
    """
    loop = Loop(control=replace(control, guard=None, force_limit=None), axis=axis, sample_time=sample_time)
    model = linearize(loop, ["cut"], list(readings), velocity=velocity)
    if not model.states:
        raise ParameterError(f"'{name}' does not answer to its command at {velocity:g} m/s: does it stick?")
    along = [float(share) for share in axis.plant.mechanics().rigid_motion()]
    held = f"{axis.plant.kind}, held over {1e3 * sample_time:g} ms, moving with {velocity:g} m/s"
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

    `measured` is the response of the load's encoder and, if it was measured, that of the motor's; one alone is that of
    every reading.
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
            raise ParameterError(f"'{name}' is {size[wrong[0]]:.3g} m/N at {each.frequency[wrong[0]]:g} Hz: no axis is")
    chosen = [load if motor is None or each == READINGS[1] else motor for each in readings]
    taken = chosen[:1] if all(each is chosen[0] for each in chosen) else chosen
    lines = tuple(_lines(each, sample_time) for each in taken)
    count = f"{sum(each.frequency.size for each in lines)} measured lines"
    if axis is None:
        if any(np.any(each.frequency != taken[0].frequency) for each in taken if each.frequency.size):
            raise ParameterError(f"'{name}': the responses of both encoders stand on different lines")
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
    variance = frf.variance
    if variance is None and frf.coherence is not None:
        share = np.maximum(frf.coherence, 1e-3)
        variance = np.abs(frf.response) ** 2 * (1.0 - share) / (share * _AVERAGES)
    variance = np.zeros(frf.frequency.size) if variance is None else variance
    keep = frf.frequency < 0.5 / sample_time
    return Lines(frf.frequency[keep], frf.response[keep], variance[keep])
