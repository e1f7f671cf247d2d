"""The motions of a commissioning: a small move, a push, strokes, and the trial, each as a profile that a drive plays.

All begin and end at rest, and are relative to the position at which the axis stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove
from feeddrive.bus.play import Profile
from feeddrive.identification.excitation.excitation import low_crest_phases, schroeder_phases, summed

RAMP = 0.03  # s to the full acceleration: slower than the first mode of most axes
REST = 0.25  # s at rest before, between and after moves
PUSH_BAND = (8.0, 24.0)  # Hz: above the position loops of slow drives, below the modes of most axes
PUSH_PERIOD = 0.5  # s
PUSH_PERIODS = 4  # in steady state
SPREAD = 0.06  # of a frequency, to the next line of a multisine
FADE, SETTLES = 0.25, 0.5  # s in which a multisine swells, and after which the axis has forgotten how it began


@dataclass(frozen=True)
class Pace:
    """How fast an axis may move: speed in m/s and acceleration in m/s²."""

    speed: float
    acceleration: float


def moved(distance: float, pace: Pace, sample_time: float) -> np.ndarray:
    """Return the set positions of a jerk-limited move over a distance (m) with its sign, shape (n,)."""
    if distance == 0.0:
        return np.zeros(1)
    move = JerkLimitedMove(
        distance=abs(distance),
        velocity=pace.speed,
        acceleration=pace.acceleration,
        jerk=pace.acceleration / RAMP,
    )
    count = int(np.ceil(float(move.duration) / sample_time)) + 1
    return np.sign(distance) * np.asarray(move.at(sample_time * np.arange(count)).position, dtype=np.float64)


def path(stops: Sequence[tuple[float, Pace]], sample_time: float, rest: float = REST) -> np.ndarray:
    """Return the set positions from 0 through the stops (m), each reached at its own pace, with a rest at each."""
    still = max(1, round(rest / sample_time))
    rows, here = [np.zeros(still)], 0.0
    for stop, pace in stops:
        rows += [here + moved(stop - here, pace, sample_time), np.full(still, stop)]
        here = stop
    return np.concatenate(rows)


def profile(
    name: str, position: np.ndarray, sample_time: float, excitation: np.ndarray | None = None, *, unit: str = "N"
) -> Profile:
    """Return the profile of set positions (m), with a force that is added (N)."""
    velocity = np.gradient(position, sample_time) if position.size > 1 else np.zeros(position.size)
    added = np.zeros(position.size) if excitation is None else excitation
    return Profile(name, "", sample_time, unit, added, position, velocity)


@dataclass(frozen=True, eq=False)
class Push:
    """A slow move under a multisine force: the profile, its period in samples, and the first whole period's sample."""

    profile: Profile
    period: int
    first: int
    lines: np.ndarray
    pace: Pace

    def back(self, sample_time: float) -> Profile:
        """Return the move back to where the push began."""
        way = -float(self.profile.set_position[-1])
        return profile("way back", path([(way, self.pace)], sample_time), sample_time)


def push(distance: float, pace: Pace, amplitude: float, sample_time: float) -> Push:
    """Return a slow move with a multisine of peak `amplitude` (N) on the force, from which a mass follows roughly."""
    period = round(PUSH_PERIOD / sample_time)
    lines = np.arange(round(PUSH_BAND[0] * PUSH_PERIOD), round(PUSH_BAND[1] * PUSH_PERIOD) + 1)
    sizes = np.ones(lines.size)
    phases = low_crest_phases(lines, sizes, schroeder_phases(lines, sizes))
    wave = summed(lines, sizes, phases, period)
    wave *= amplitude / float(np.max(np.abs(wave)))
    # the fade is one period, so that the wave begins in steady state
    rows = np.tile(wave, PUSH_PERIODS + 2)
    window = np.ones(rows.size)
    swell = 0.5 - 0.5 * np.cos(np.pi * np.arange(period) / period)
    window[:period], window[rows.size - period :] = swell, swell[::-1]
    set_position = np.concatenate([np.zeros(1), moved(distance, pace, sample_time)])
    still = max(1, round(REST / sample_time))
    ramp = round((pace.speed / pace.acceleration + RAMP) / sample_time)
    count = max(set_position.size, ramp + rows.size) + still
    set_position = np.concatenate([set_position, np.full(count - set_position.size, set_position[-1])])
    excitation = np.zeros(count)
    excitation[ramp : ramp + rows.size] = window * rows
    return Push(profile("push", set_position, sample_time, excitation), period, ramp + period, lines, pace)


def push_distance(pace: Pace) -> float:
    """Return the distance over which the push moves at its pace, m."""
    return pace.speed * ((PUSH_PERIODS + 2) * PUSH_PERIOD + 2.0 * (pace.speed / pace.acceleration + RAMP))


@dataclass(frozen=True, eq=False)
class Shaken:
    """A slow move with a multisine on it: the profile, its period in samples, and the first whole period's sample."""

    profile: Profile
    period: int
    first: int
    periods: int

    @property
    def whole(self) -> slice:
        """The rows of all whole periods."""
        return slice(self.first, self.first + self.periods * self.period)

    def sized(self, amplitude: float, unit: str) -> Profile:
        """Return the profile with a multisine of another peak amplitude, N or m/s."""
        excitation = amplitude / float(np.max(np.abs(self.profile.excitation))) * self.profile.excitation
        return replace(self.profile, excitation=excitation, unit=unit)


def lines_of(top: float, resolution: float) -> np.ndarray:
    """Return the multiples of a resolution up to `top` (Hz) that a multisine has: each of them where they are far
    apart for the frequency, then SPREAD apart from each other, so that high ones do not take the amplitude of low ones.
    """
    lines, here = list[int](), 1.0
    while here * resolution <= top:
        lines.append(round(here))
        here = max(here + 1.0, here * (1.0 + SPREAD))
    return np.array(lines)


def shaken(
    name: str, distance: float, lines: np.ndarray, period: int, periods: int, pace: Pace, sample_time: float, seed: int
) -> Shaken:
    """Return an even move over a distance (m), with a multisine of lines of size 1 and random phases on it."""
    random = np.random.default_rng(seed)
    sizes = np.ones(lines.size)
    phases = low_crest_phases(lines, sizes, random.uniform(0.0, 2.0 * np.pi, lines.size))
    wave = summed(lines, sizes, phases, period)
    fade = max(1, min(period, round(FADE / sample_time)))
    # the fades are parts of a period, and a slow axis forgets them in another half
    ahead = fade + max(period // 2, round(SETTLES / sample_time))
    rows = np.arange(-ahead, periods * period + fade)
    window = np.ones(rows.size)
    swell = 0.5 - 0.5 * np.cos(np.pi * np.arange(fade) / fade)
    window[:fade], window[rows.size - fade :] = swell, swell[::-1]
    even = rows.size * sample_time
    speed = abs(distance) / (even + 2.0 * RAMP)
    position = np.concatenate(
        [np.zeros(max(1, round(REST / sample_time))), moved(distance, Pace(speed, pace.acceleration), sample_time)]
    )
    ramp = round(REST / sample_time) + round((speed / pace.acceleration + RAMP) / sample_time)
    count = max(position.size, ramp + rows.size) + round(REST / sample_time)
    position = np.concatenate([position, np.full(count - position.size, position[-1])])
    excitation = np.zeros(count)
    excitation[ramp : ramp + rows.size] = window * wave[rows % period]
    return Shaken(profile(name, position, sample_time, excitation), period, ramp + ahead, periods)


# of the pace: viscous friction shows at the fast ones, the curve near standstill at the slow ones
STROKE_SPEEDS = (1.0, 0.5, 0.2, 0.05, 0.01)


def strokes(
    travel: float, pace: Pace, sample_time: float, speeds: Sequence[float] = STROKE_SPEEDS, name: str = "strokes"
) -> Profile:
    """Return strokes to and fro over `travel` (m) at several speeds, from which mass and friction follow."""
    stops: list[tuple[float, Pace]] = []
    for share in speeds:
        slower = Pace(share * pace.speed, pace.acceleration)
        # a slow stroke is shorter, so that it takes no longer than a fast one
        stops += [(share * travel, slower), (0.0, slower)]
    return profile(name, path(stops, sample_time), sample_time)


PULSE = 0.1  # s of a force pulse while the axis moves evenly
PULSE_EDGE = 2e-3  # s of its edges


@dataclass(frozen=True, eq=False)
class TrialMotion:
    """The motion of a closed-loop trial, once alone and once with a force pulse while the axis moves evenly.

    rest    rows at rest before the motion
    moving  rows from the beginning of the motion to its end
    pulsed  rows from the beginning of the pulse to 1.5 times its length
    travel, pace  of the motion, m
    """

    alone: Profile
    pushed: Profile
    force: float
    rest: slice
    moving: slice
    pulsed: slice
    travel: float
    pace: Pace

    def slower(self, share: float, sample_time: float) -> Profile:
        """Return a short and slow motion without a pulse: a share of travel, speed and acceleration."""
        slow = Pace(share * self.pace.speed, share * self.pace.acceleration)
        stops = [(share * self.travel, slow), (0.0, slow)]
        return profile("gentle trial", path(stops, sample_time, TRIAL_REST), sample_time)

    def weaker(self, force: float) -> TrialMotion:
        """Return the same motion with a pulse of another force, N."""
        pushed = replace(self.pushed, excitation=force / self.force * self.pushed.excitation)
        return replace(self, pushed=pushed, force=force)


TRIAL_REST = 0.6  # s


def trial(travel: float, pace: Pace, force: float, sample_time: float) -> TrialMotion:
    """Return a move to and fro over `travel` (m), and the same with a pulse of `force` (N) in its even part."""
    position = path([(travel, pace), (0.0, pace)], sample_time, TRIAL_REST)
    still = round(TRIAL_REST / sample_time)
    moving = slice(still, position.size - still)
    length, edge = round(PULSE / sample_time), max(1, round(PULSE_EDGE / sample_time))
    pulse = np.ones(length)
    pulse[:edge] = np.arange(1, edge + 1) / (edge + 1)
    pulse[length - edge :] = pulse[:edge][::-1]
    # the even part of the way out begins after the acceleration, and lasts long enough (`least_travel`)
    first = still + round((pace.speed / pace.acceleration + RAMP + EVEN) / sample_time)
    added = np.zeros(position.size)
    added[first : first + length] = force * pulse
    return TrialMotion(
        profile("trial", position, sample_time),
        profile("trial with a force", position, sample_time, added),
        force,
        slice(still // 3, still),
        moving,
        slice(first, first + round(1.5 * length)),
        travel,
        pace,
    )


EVEN = 0.1  # s of even motion before a pulse


def least_travel(pace: Pace) -> float:
    """Return the travel that a trial needs at a pace, m: acceleration, even motion, pulse and its decay, braking."""
    ramp = pace.speed / pace.acceleration + RAMP
    return pace.speed * (ramp + EVEN + 1.5 * PULSE)
