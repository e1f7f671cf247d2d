"""The velocity loop of a drive from responses to commanded velocities and to a force that is added in the drive.

    x = G_w w + G_F F             w: commanded velocity, F: force offset of the drive, x: reading
    G_w = e^(-sτ) C P/(1 + s C P),   G_F = e^(-sτ) P/(1 + s C P),   C = (Kp + Kp/(Tn s))/(1 + s lag)

P is the plant, whose form is known from responses to the force that the drive tells; τ, C and the masses of P are
fitted to both responses together.  The force that a drive tells may be late or filtered, and is not used here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.actuator.velocity_loop import VelocityLoop
from feeddrive.blocks.controller.position_loop import PositionLoop
from feeddrive.identification.response.plant_fit import on_lines
from feeddrive.language import tree
from feeddrive.language.errors import NotIdentifiableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop

SUBSTEP = 0.25e-3  # s, at most: sample times of velocity loops in drives are 62.5 to 250 us
NEAR = 0.02  # of a response: model errors that count as much as noise
POOR = 0.3  # of a response: standard deviation of a line that is left out
APART = 0.15  # of a response, RMS over its lines: a model that leaves more is none
BANDS = (np.inf, 3.0, 2.0)  # times the rate of the velocity loop: lines up to which a model is tried, in turn
_SLOWEST = 100.0  # s of the integral time and of the lag, as a bound of the fit: none
_LATEST = 0.05  # s of dead time


@dataclass(frozen=True)
class VelocityFit:
    """The axis with the velocity loop of its drive, and how far its responses are from those measured (RMS share) up
    to a frequency, Hz.
    """

    axis: Axis
    by_velocity: float
    by_force: float
    top: float

    @property
    def loop(self) -> VelocityLoop:
        """The velocity loop of the drive."""
        found = self.axis.actuator.velocity_loop
        assert found is not None
        return found

    def sentence(self) -> Text:
        """Return what was found, as a sentence."""
        loop = self.loop
        assert loop.Tn is not None
        assert loop.lag is not None
        return Text(
            f"The drive's velocity loop has Kp {Quantity(loop.Kp, 'N s/m'):3}, Tn {Quantity(loop.Tn, 's'):3}, a lag of "
            f"{Quantity(loop.lag, 's'):2} and {Quantity(self.axis.actuator.dead_time, 's'):2} of dead time; responses "
            f"to velocities {Quantity(self.by_velocity, 'share'):2} off, to forces "
            f"{Quantity(self.by_force, 'share'):2}, up to {Quantity(self.top, 'Hz'):3}."
        )


def gain_of(by_force: FRF) -> float:
    """Return the velocity gain of a drive roughly, N s/m, from the response of its reading to a force offset, m/N.

    1/(s G_F) = C + m s + b + ...,      whose least magnitude is about Kp
    """
    sizes = 1.0 / np.abs(2.0 * np.pi * by_force.frequency * by_force.response)
    known = _weight(by_force) > 0.0
    return float(np.min(sizes[known] if np.any(known) else sizes))


def fit_velocity_loop(
    axis: Axis, by_velocity: Mapping[str, FRF], by_force: Mapping[str, FRF], sample_time: float, held_force: float
) -> VelocityFit:
    """Return the axis with the velocity loop of its drive.

    axis         with the plant as it is known, which takes a force
    by_velocity  responses of the readings to a commanded velocity, by name, m/(m/s)
    by_force     the same to a force offset, m/N
    held_force   N that holds the axis

    A mode or a filter of the drive that the model lacks is left out with the lines above twice the rate of the velocity
    loop, if need be: a position loop around it is slower.  Raises NotIdentifiableError if no PI velocity loop explains
    the responses below within 15 %.
    """
    first = next(iter(by_force.values()))
    rate = gain_of(first) / (2.0 * np.pi * float(axis.plant.rigid_mass()))
    tried = list[VelocityFit]()
    for band in BANDS:
        led, pushed = (
            {name: on_lines(frf, frf.frequency <= band * rate) for name, frf in each.items()}
            for each in (by_velocity, by_force)
        )
        tried.append(_fitted(axis, led, pushed, sample_time, held_force))
        if max(tried[-1].by_velocity, tried[-1].by_force) <= APART:
            return tried[-1]
    found = tried[-1]
    raise NotIdentifiableError(
        Text(
            f"no PI velocity loop explains the responses of the drive: up to {Quantity(found.top, 'Hz'):3} those to "
            f"velocities are {Quantity(found.by_velocity, 'share'):2} off, those to forces "
            f"{Quantity(found.by_force, 'share'):2}, where {Quantity(APART, 'share'):2} are allowed: the drive has "
            'filters or an observer in its velocity loop, or the plant lacks a mode; take mode = "cst"'
        )
    )


def _fitted(
    axis: Axis, by_velocity: Mapping[str, FRF], by_force: Mapping[str, FRF], sample_time: float, held_force: float
) -> VelocityFit:
    """Return the fit to all lines of the responses, however far it is off."""
    plain = replace(axis, actuator=Actuator(), substeps=max(1, round(sample_time / SUBSTEP)))
    names = list(by_velocity)
    Kp = gain_of(by_force[names[0]])
    masses = [name for name, _ in tree.leaves(axis.plant) if "mass" in name or "inertia" in name]
    viscous = [name for name, _ in tree.leaves(axis.plant) if name.startswith("viscous")]
    total = float(axis.plant.rigid_mass())
    rate = Kp / total
    start = np.log([Kp, 6.0 / rate, 0.5 * sample_time + SUBSTEP, 2.5 * sample_time, 1.0, 1e-2 * Kp])

    def made(x: np.ndarray) -> Axis:
        gain, Tn, lag, late, scale, damping = np.exp(x).tolist()
        held = {name: scale * float(value) for name, value in tree.leaves(axis.plant) if name in masses}
        held |= dict.fromkeys(viscous[:1], damping)
        plant = tree.vary(axis.plant, held)
        loop = VelocityLoop(Kp=gain, Tn=Tn, lag=lag, held_force=held_force)
        return replace(plain, plant=plant, actuator=Actuator(dead_time=late, velocity_loop=loop))

    def apart(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        there = made(x)
        ran = Loop(control=Control(law=PositionLoop(Kv=1.0)), axis=there, sample_time=sample_time)
        model = linearize(ran, ["cut"], names)
        loop = there.actuator.velocity_loop
        assert loop is not None
        assert loop.Tn is not None
        velocities, forces = list[np.ndarray](), list[np.ndarray]()
        for name in names:
            measured, pushed = by_velocity[name], by_force[name]
            velocities.append(_log_ratio(model.response(measured.frequency, name, "cut").response, measured.response))
            # a force acts as the velocities do that `VelocityLoop.equivalent` makes of it
            z = np.exp(2j * np.pi * pushed.frequency * sample_time)
            of_force = (z - 1.0) / (z - 1.0 + sample_time / float(loop.Tn)) / float(loop.Kp)
            forces.append(
                _log_ratio(of_force * model.response(pushed.frequency, name, "cut").response, pushed.response)
            )
        return np.concatenate(velocities), np.concatenate(forces)

    weights = [np.concatenate([_weight(responses[name]) for name in names]) for responses in (by_velocity, by_force)]

    def residuals(x: np.ndarray) -> np.ndarray:
        rows: np.ndarray = np.concatenate([w * a for w, a in zip(weights, apart(x), strict=True)])
        return np.concatenate([np.real(rows), np.imag(rows)])

    # the phase is known but for whole turns: from a dead time that is far off, the fit would end in another one
    top = max(float(frf.frequency[-1]) for frf in by_velocity.values())
    ways = [[*start[:3], np.log(late), *start[4:]] for late in np.arange(sample_time, _LATEST, 0.25 / top)]
    start = min(ways, key=lambda x: float(np.sum(np.abs(residuals(np.array(x))))))
    low = np.log([1e-2 * Kp, sample_time, 0.1 * SUBSTEP, 1e-2 * sample_time, 0.3, 1e-6 * Kp])
    high = np.log([1e2 * Kp, _SLOWEST, _SLOWEST, _LATEST, 3.0, 1e1 * Kp])
    found = least_squares(
        residuals, np.clip(start, low + 1e-6, high - 1e-6), bounds=(low, high), loss="soft_l1", x_scale=0.3, max_nfev=40
    )
    # each line counts as much as it is known: noisy ones say nothing about the model
    left = [
        float(np.sqrt(np.sum(np.abs(w * a) ** 2) / np.sum(w**2))) if np.any(w) else np.inf
        for w, a in zip(weights, apart(found.x), strict=True)
    ]
    return VelocityFit(made(found.x), left[0], left[1], top)


def _log_ratio(model: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """Return ln(model/measured), the relative distance for small ones."""
    ratio = model / measured
    return np.log(np.abs(ratio)) + 1j * np.angle(ratio)


def _weight(frf: FRF) -> np.ndarray:
    """Return the inverse of the relative deviation of each line, 0 of one that is too noisy."""
    variance = frf.known_variance()
    share = np.zeros(frf.frequency.size) if variance is None else np.sqrt(variance) / frf.magnitude
    return np.where(share <= POOR, 1.0 / np.hypot(share, NEAR), 0.0)
