"""The skew of a gantry: the small moves that find the stiffness of its beam, and the model of both sides.

    f1 = a1 + k1 d + c1 sgn x1',    f2 = a2 + k2 d + c2 sgn x2',    d = x1 - x2,    each while the other one holds

A beam of stiffness k resists the skew with  k1 = k  and  k2 = -k:  a side with the other sign has a drive whose force
counts against its positions.  If a move of both the same way meets this stiffness twice, the positions of the drives
count against each other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.replay import path_of
from feeddrive.blocks.coupling.cross_beam import CrossBeam
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.bus.gantry import SIDES, share_of
from feeddrive.bus.play import Profile
from feeddrive.commissioning.motions import Pace, TrialMotion, path, profile
from feeddrive.commissioning.trial import counted
from feeddrive.files.log import Log
from feeddrive.language.errors import NotIdentifiableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate

TWISTED = (1 / 16, 1 / 4)  # of limits.skew, by which the first moves twist the beam, until it shows
_TIME = 0.3  # s of a move of the skew: slow, so that the drives' own integrals follow
_MOVING = 0.3  # of the largest speed, from which on friction has its sign
_BEGIN = 10  # rows at rest at the beginning of a motion
_NEAR = 2.0  # times the frequency of the skew, up to which lines tell its mass and stiffness
_LOWEST, _BELOW = 2e-3, 30  # of the first measured line of the skew, and lines from there on
_DENSE = 1.5  # ratio of neighbouring lines, from which on they are used
_RECORD = ("set_position", "reading_load", "force", "velocity_load", "velocity_motor")
_MOVED = 0.2  # of the skew, that each side moves by itself
_SMOOTH = 0.02  # s over which a speed is taken
_STIFFER = 3.0  # times the stiffness in common: that of a beam
_ALIKE = 1.5  # times the stiffness by the other side's force


class SkewMoves(NamedTuple):
    """The first moves of a gantry, slow and to and fro: both sides the same way, and a skew."""

    same: Profile
    skew: Profile

    def alone(self, side: str, shares: tuple[float, float]) -> Profile:
        """Return the common motion that makes the skew a motion of one side, while the other one holds."""
        way = shares[0] if side == SIDES[0] else -shares[1]
        return replace(self.skew, set_position=way * self.skew.set_position, velocity=way * self.skew.velocity)


def skew_moves(far: float, sample_time: float) -> SkewMoves:
    """Return the first moves of a gantry.

    far  m, by which any of them twists the beam at most, whichever way the drives count
    """
    pace = Pace(far / _TIME, far / (0.2 * _TIME**2))
    half = Pace(0.5 * pace.speed, 0.5 * pace.acceleration)

    def to_and_fro(reach: float, at: Pace) -> np.ndarray:
        return path([(reach, at), (-reach, at), (0.0, at)], sample_time, _TIME)

    return SkewMoves(
        profile("small common move", to_and_fro(0.5 * far, half), sample_time),
        profile("small skew", to_and_fro(far, pace), sample_time),
    )


@dataclass(frozen=True)
class SkewFacts:
    """What the first moves of a gantry told.

    stiffness  of the beam against skew, N/m
    free       skew at which the beam is free of force, m, as first minus second position
    friction   of each side, N
    signs      of the forces of both drives, +1 or -1
    shown      force of the beam during the moves, N
    """

    stiffness: float
    free: float
    friction: tuple[float, float]
    signs: tuple[int, int]
    shown: float


def skew_facts(common: Log, alone: tuple[Log, Log]) -> SkewFacts:
    """Return what the moves of `skew_moves` told: from the log of both sides the same way, and those of each alone.

    Raises NotIdentifiableError for a beam that does not show, for drives that count against each other, and for forces
    of both sides that contradict each other.
    """
    apart = [log["reading_first"] - log["reading_second"] for log in alone]
    first, second = (_line(log, at, side) for log, at, side in zip(alone, apart, SIDES, strict=True))
    together = [_line(common, common["reading_load"], side) for side in SIDES]
    stiff, alike = (sum(abs(line.slope) for line in lines) for lines in ((first, second), together))
    far = min(float(np.ptp(at)) for at in apart)
    shown, noise = 0.25 * stiff * far, max(first.left, second.left)
    # both sides then twist the beam, by twice the way of one
    if shown > noise and alike > stiff:
        raise NotIdentifiableError(
            "a move of both drives the same way twists the beam, more than one of a drive alone: their positions count "
            "against each other; turn the direction of the second drive (0x607E)"
        )
    if not (shown > noise and stiff > _STIFFER * alike):
        raise NotIdentifiableError(
            Text(
                f"twisted by {Quantity(far, 'm'):3 SI}, the beam resists with {Quantity(shown, 'N'):3}, beside "
                f"{Quantity(noise, 'N'):3} of other forces: it does not show; allow a larger limits.skew, or "
                "commission each drive alone if nothing couples them"
            )
        )
    signs = (1 if first.slope > 0.0 else -1, 1 if second.slope < 0.0 else -1)
    one, other = abs(first.slope), abs(second.slope)
    if max(one, other) > _ALIKE * min(one, other):
        raise NotIdentifiableError(
            Text(
                f"by the force of the first drive the beam has {Quantity(one, 'N/m'):3} against skew, and by that of "
                f"the second {Quantity(other, 'N/m'):3}: one beam has one; look at rated torque, gear and lead of both "
                "drives"
            )
        )
    free = [line.at - line.level / line.slope for line in (first, second)]
    friction = (abs(first.friction), abs(second.friction))
    return SkewFacts(0.5 * (one + other), 0.5 * (free[0] + free[1]), friction, signs, shown)


class _Line(NamedTuple):
    """A force over a position: level (N) at the mean position (m), slope (N/m), friction, and what is left, N RMS."""

    at: float
    level: float
    slope: float
    friction: float
    left: float


def _line(log: Log, position: np.ndarray, side: str) -> _Line:
    """Return the force of a side over a position (m), from the rows in which the side itself slides."""
    own, force = log[f"reading_{side}"], log[f"force_{side}"]
    if float(np.ptp(own)) <= _MOVED * float(np.ptp(position)):
        raise NotIdentifiableError(f"the {side} side stands still: its friction holds it")
    width = max(1, round(_SMOOTH / log.sample_time))
    speed = np.zeros(own.size)
    speed[width:-width] = own[2 * width :] - own[: -2 * width]
    moving = np.abs(speed) > _MOVING * float(np.max(np.abs(speed)))
    x = position - float(np.mean(position))
    columns = np.column_stack([np.ones(x.size), x, np.sign(speed)])[moving]
    found, *_ = np.linalg.lstsq(columns, force[moving], rcond=None)
    left = float(np.std(force[moving] - columns @ found))
    return _Line(float(np.mean(position)), float(found[0]), float(found[1]), float(found[2]), left)


@dataclass(frozen=True)
class Side:
    """Mass (kg), Coulomb (N) and viscous friction (N s/m) of one side, and the standard error of the mass, kg."""

    mass: float
    coulomb: float
    viscous: float
    error: float


def sides_of(strokes: Log, stiffness: float, free: float) -> tuple[Side, Side]:
    """Return mass and friction of both sides from strokes in common, without the force of the beam.

    f1 - k (d - free) = m1 x1'' + c1 sgn x1' + b1 x1',    likewise with the other sign for the second side
    """
    beam = stiffness * (strokes["reading_first"] - strokes["reading_second"] - free)
    made = [
        _side(strokes[f"reading_{side}"], strokes[f"force_{side}"] - way * beam, strokes.sample_time)
        for side, way in zip(SIDES, (1.0, -1.0), strict=True)
    ]
    return made[0], made[1]


def _side(position: np.ndarray, force: np.ndarray, sample_time: float) -> Side:
    width = max(1, round(_SMOOTH / sample_time))
    triangle = np.convolve(np.ones(width), np.ones(width)) / width**2

    # the second difference over a width is the acceleration, weighted with a triangle: so is all else
    def weighted(values: np.ndarray) -> np.ndarray:
        return np.convolve(values, triangle, "valid")

    speed = np.gradient(position, sample_time)
    smooth = np.convolve(speed, np.ones(width) / width, "same")
    slow = 0.02 * float(np.max(np.abs(smooth)))
    inside = slice(width - 1, position.size - width + 1)
    at = np.arange(position.size)[inside]
    ends = (np.minimum(at + width, position.size - 1), np.maximum(at - width, 0))
    acceleration = (position[ends[0]] - 2.0 * position[at] + position[ends[1]]) / (width * sample_time) ** 2
    signs = weighted(np.sign(smooth) * (np.abs(smooth) > slow))
    columns = np.column_stack([acceleration, signs, weighted(speed), np.ones(at.size)])
    moves = np.abs(weighted(smooth)) > slow
    wanted = weighted(force)[moves]
    found, *_ = np.linalg.lstsq(columns[moves], wanted, rcond=None)
    left = wanted - columns[moves] @ found
    # neighbours share their window: so many rows are one observation
    freedom = max(1.0, left.size / (2.0 * width) - 4.0)
    spread = np.linalg.inv(columns[moves].T @ columns[moves]) * float(left @ left) / freedom
    return Side(float(found[0]), max(0.0, float(found[1])), max(0.0, float(found[2])), float(np.sqrt(spread[0, 0])))


class Beam(NamedTuple):
    """The skew as it answers its force, in the terms of the whole: mass (kg), stiffness (N/m) and damping (N s/m)."""

    mass: float
    stiffness: float
    damping: float

    @property
    def frequency(self) -> float:
        """The frequency of the free skew, Hz."""
        return float(np.sqrt(self.stiffness / self.mass) / (2.0 * np.pi))

    @property
    def damping_ratio(self) -> float:
        """The damping ratio of the free skew."""
        return float(0.5 * self.damping / np.sqrt(self.stiffness * self.mass))


def fit_skew(response: FRF, dead_time: float) -> Beam:
    """Return mass, stiffness and damping of the skew from its response d/u, with the dead time (s) of the drives.

        e^(-jω (dead_time + T/2)) / (d/u) = k - M ω² + jω c           by least squares, lines weighted by |d/u|

    Lines far above the mode, where this is no sampled hold any more, are left out.
    Raises NotIdentifiableError if the lines hold no mass on a spring.
    """
    made = _fitted(response, dead_time)
    near = response.frequency <= _NEAR * made.frequency
    lines = FRF(response.frequency[near], response.response[near], sample_time=response.sample_time)
    return _fitted(lines, dead_time)


def _fitted(response: FRF, dead_time: float) -> Beam:
    s = 2j * np.pi * response.frequency
    hold = 0.5 * (response.sample_time or 0.0)
    stiff = np.exp(-s * (dead_time + hold)) / response.response
    weight = np.abs(response.response)
    rows = np.column_stack([(s * s).real, np.ones(s.size)]) * weight[:, None]
    (mass, stiffness), *_ = np.linalg.lstsq(rows, weight * stiff.real, rcond=None)
    damping = float(np.sum(weight**2 * s.imag * stiff.imag) / np.sum((weight * s.imag) ** 2))
    if not (mass > 0.0 and stiffness > 0.0):
        raise NotIdentifiableError(
            Text(
                f"the response of the skew is none of a mass on a spring: {Quantity(float(mass), 'kg'):3}, "
                f"{Quantity(float(stiffness), 'N/m'):3}"
            )
        )
    return Beam(float(mass), float(stiffness), max(0.0, damping))


def skew_lines(response: FRF, beam: Beam, dead_time: float) -> FRF:
    """Return the response of the skew: its measured lines and, below the first of them, those of the beam.

    A beam is a spring at low frequencies, where its answer to a force is small and known.
    """
    T = float(response.sample_time or 0.0)
    f = response.frequency
    dense = slice(int(np.argmax(f[1:] <= _DENSE * f[:-1])), None)
    first = float(f[dense][0])
    below = np.geomspace(_LOWEST * first, first, _BELOW, endpoint=False)
    s = 2j * np.pi * below
    still = np.exp(-s * (dead_time + 0.5 * T)) / (beam.mass * s * s + beam.damping * s + beam.stiffness)
    known = response.variance
    variance = None if known is None else np.concatenate([np.zeros(below.size), known[dense]])
    return FRF(
        np.concatenate([below, f[dense]]),
        np.concatenate([still, response.response[dense]]),
        response.input,
        "skew",
        "m/N",
        T,
        None,
        variance,
    )


def gantry_machine(
    whole: Loop,
    names: tuple[str, str],
    shares: tuple[float, float],
    beam: tuple[float, float],
    friction: tuple[float, float] | None = None,
) -> Machine:
    """Return the machine of both sides with their shares of the control, and the beam between them.

    whole     the loop of the common motion
    beam      stiffness (N/m) and damping (N s/m) between the sides
    friction  shares of the friction of both sides; default: those of the force
    """
    loops = dict[str, Loop]()
    for name, share, part in zip(names, shares, friction or shares, strict=True):
        axis = share_of(whole.axis, share)
        acting = whole.axis.friction_load
        axis = replace(axis, friction_load=None if acting is None else share_of(acting, part))
        loops[name] = replace(whole, control=share_of(whole.control, share), axis=axis, name=name)
    stiffness, damping = beam
    return Machine.of(loops, (CrossBeam(axis=names[0], follower=names[1], stiffness=stiffness, damping=damping),))


def predicted_gantry(
    machine: Machine,
    shares: tuple[float, float],
    profiles: tuple[Profile, Profile],
    increments: tuple[float, float],
    noise: float,
    *,
    seed: int = 0,
) -> Log:
    """Return the log of a motion of both sides as the machine is predicted to answer it, with the columns of the common
    motion and of both sides; `noise` is that of the encoder of each side, m RMS.
    """
    T = float(machine.sample_time)
    loops = {
        name: replace(loop, axis=counted(loop.axis, increment, noise))
        for (name, loop), increment in zip(machine.loops().items(), increments, strict=True)
    }
    names = list(loops)
    played = dict(zip(names, profiles, strict=True))
    run = simulate(
        Machine.of(loops, machine.couplings),
        {name: path_of(loops[name].control, each.set_position, T) for name, each in played.items()},
        added_force={
            name: RecordedForce(force=each.excitation, sample_time=T)
            for name, each in played.items()
            if np.any(each.excitation)
        }
        or None,
        seed=seed,
        record=[f"{name}.{signal}" for name in names for signal in _RECORD],
        name=profiles[0].name,
    )
    rows = slice(0, profiles[0].set_position.size)
    channels = dict[str, np.ndarray]()
    for side, (name, each) in zip(SIDES, played.items(), strict=True):
        channels[f"set_position_{side}"] = run[f"{name}.set_position"][rows]
        channels[f"reading_{side}"] = run[f"{name}.reading_load"][rows]
        channels[f"velocity_load_{side}"] = run[f"{name}.velocity_load"][rows]
        channels[f"velocity_motor_{side}"] = run[f"{name}.velocity_motor"][rows]
        channels[f"force_{side}"] = channels[f"commanded_{side}"] = run[f"{name}.force"][rows] + each.excitation

    def whole(column: str, parts: tuple[float, float]) -> np.ndarray:
        return parts[0] * channels[f"{column}_first"] + parts[1] * channels[f"{column}_second"]

    channels |= {"set_position": whole("set_position", shares), "commanded": whole("commanded", (1.0, 1.0))}
    channels |= {"reading_load": whole("reading", shares)}
    channels |= {name: whole(name, shares) for name in ("velocity_load", "velocity_motor")}
    channels["force"] = channels["commanded"]
    units = {name: "N" if name.startswith(("force", "commanded")) else "m" for name in channels}
    units |= {name: "m/s" for name in channels if name.startswith("velocity")}
    return Log(name=profiles[0].name, time=run.time[rows], channels=channels, units=units, sample_time=T)


def skew_of(log: Log) -> np.ndarray:
    """Return the skew of a motion against that at its beginning, m."""
    apart = log["reading_first"] - log["reading_second"]
    return apart - float(np.mean(apart[:_BEGIN]))


def skew_figures(motion: TrialMotion, alone: Log, twisted: Log, force: float) -> dict[str, float]:
    """Return the figures of the skew from a motion, and from the same under a pulse of `force` (N) on the first side
    and against it on the second: the largest skew (m), and force over skew (N/m).
    """
    apart = (skew_of(twisted) - skew_of(alone))[motion.pulsed]
    most = float(np.max(np.abs(apart)))
    return {
        "skew_peak": float(np.max(np.abs(skew_of(alone)[motion.moving]))),
        "skew_stiffness": force / most if most else float("inf"),
    }
