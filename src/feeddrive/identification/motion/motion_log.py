"""The input of an identification: position and force over time, checked, and redrawn within the encoder's counts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from feeddrive.analysis.replay import estimate_start
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.identification.estimate import TABLE, TURNING, Frame, frame_of
from feeddrive.identification.regression import short_runs, strays_said
from feeddrive.language import tree
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

# The input of an identification: position and force over time, checked.

LEAST_ROWS = 100
LARGEST = 1e100  # in SI: its square does not overflow
_USUAL_SHARE = 0.99  # of the rows, whose largest force is the usual one
_NEAR, _AROUND, _NOISE = 9, 61, 8.0  # rows of the medians about a spike; standard deviations that it exceeds
_SPIKE = 5.0  # times the usual force: no real force peak is so short and so high
_JUMP = 3.0  # usual steps by which a row of a position leaves its neighbors
_JUMP_TRAVEL = 1e-3  # of the travel, the least that counts
_BEYOND = 1.05  # times its limit, beyond which a force was not commanded under that limit
_SPIKE_ROWS = 3  # samples that a spike lasts at most
MOST_SATURATED = 0.01  # share of the samples that may sit at the largest force


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionLog:
    """Position (m, or rad of a shaft) and commanded force (N, or N m) on one clock, each of shape (n,).

    set_position  setpoint of the loop, if it was logged
    force_limit   N or N m, if it is known
    rotary        position in rad and force in N m
    turning       of those: it is the axis itself that turns, and no shaft in front of a screw

    Raises LogError for a channel that is not finite or of another length, and NotIdentifiableError for a channel that
    does not change or a force that stays at its limit.
    """

    name: str
    position: np.ndarray
    force: np.ndarray
    sample_time: float
    set_position: np.ndarray | None = None
    force_limit: float | None = None
    rotary: bool = False
    turning: bool = False

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sample_time) and self.sample_time > 0.0):
            raise ParameterError(f"{self.name}: sample_time = {Quantity(self.sample_time, 's'):6 SI} must be > 0 s")
        for channel in ("position", "force", "set_position"):
            values = getattr(self, channel)
            if values is not None:
                object.__setattr__(self, channel, self._checked(channel, np.asarray(values, dtype=np.float64)))
        if self.position.size < LEAST_ROWS:
            raise LogError(f"{self.name}: has {self.position.size} rows; identification needs at least {LEAST_ROWS}")
        self._check_saturation()
        self._check_spikes()
        self._check_jumps()

    @property
    def frame(self) -> Frame:
        """The units of a table, of a shaft, or of an axis that turns."""
        return TURNING if self.turning else frame_of(self.rotary)

    @property
    def micro(self) -> str:
        """The unit in which residuals of the position are shown, a millionth of its own."""
        return "um" if self.frame is TABLE else "urad"

    def distance(self, value: float, digits: int = 4) -> Quantity:
        """Return a residual of the position as a quantity."""
        return Quantity(value, self.frame.position, form=f"{digits} {self.micro}")

    def _checked(self, channel: str, values: np.ndarray) -> np.ndarray:
        if values.ndim != 1 or values.size != np.size(self.position):
            raise LogError(f"{self.name}: '{channel}' has {values.size} rows, position has {np.size(self.position)}")
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise LogError(
                f"{self.name}: '{channel}' is {values[bad[0]]} at row {int(bad[0]) + 1} ({bad.size} such rows); "
                f"cut the log there or repair the row"
            )
        if np.max(np.abs(values)) > LARGEST:
            raise LogError(
                f"{self.name}: '{channel}' reaches {Quantity(np.max(np.abs(values))):3}, beyond {Quantity(LARGEST)}: "
                "check the column and its unit"
            )
        if np.ptp(values) == 0.0:
            raise NotIdentifiableError(
                f"{self.name}: '{channel}' is {Quantity(values[0]):6} in all rows: it was not recorded, or nothing "
                f"moved; record a move to and fro with its {channel}"
            )
        return values

    def _check_saturation(self) -> None:
        """Refuse a saturated force: it is not the force that acted on the axis."""
        force = self.force
        most = float(np.max(np.abs(force))) if self.force_limit is None else self.force_limit
        largest = float(np.max(np.abs(force)))
        if largest > _BEYOND * most:
            unit = self.frame.force
            raise NotIdentifiableError(
                f"{self.name}: the force reaches {Quantity(largest, unit):5}, beyond the limit of "
                f"{Quantity(most, unit):5} that the machine has: one of the two is wrong; check the unit or factor of "
                "the force, and the force limit and axis of the machine file"
            )
        there = np.abs(force) >= most * (1.0 - 1e-9)
        held = there[1:] & there[:-1]  # a peak reaches its value once; a limit holds it over several samples
        share = float(np.mean(held))
        if share > MOST_SATURATED:
            raise NotIdentifiableError(
                f"{self.name}: the force sits at {Quantity(most, self.frame.force):5} in {Quantity(share, 'share'):3} "
                f"of the rows (at most {Quantity(MOST_SATURATED, 'share'):6} are admitted): the drive or its recorder "
                "is saturated, and what acted on the axis is not known; repeat the motion with a lower acceleration, "
                "or with a wider recorder range"
            )

    def _check_spikes(self) -> None:
        """Refuse spikes: single samples of a force that no drive commands, from a broken line or a recorder."""
        size = np.abs(self.force)
        most = float(np.quantile(size, _USUAL_SHARE))
        beyond = size > _SPIKE * most
        starts = np.flatnonzero(beyond & ~np.concatenate([[False], beyond[:-1]]))
        if most > 0.0 and starts.size and int(np.sum(beyond)) <= _SPIKE_ROWS * starts.size:
            k = int(starts[np.argmax(size[starts])])
            raise NotIdentifiableError(
                f"{self.name}: the force has {starts.size} spike{'s' * (starts.size != 1)}, the largest of "
                f"{Quantity(self.force[k], self.frame.force)} at row {k + 1} "
                f"({Quantity(k * self.sample_time, 's'):SI}), where {Quantity(_USUAL_SHARE, 'share'):6} of the log "
                f"stay within {Quantity(most, self.frame.force)}: no mass reacts to them; repair these rows, or cut "
                "the log there"
            )

    def _check_jumps(self) -> None:
        """Refuse rows of a position that leave their neighbors and return at once: a fault of the encoder line.

        A position that rises or falls steadily is its own median, so that only reversals and noise depart from it:

            |x - median9(x)| > 3 · usual step, which 99 % of the steps from row to row do not exceed,
                               and > 1e-3 of the travel: jumps of a few counts in a slow run stay
        """
        steps = np.abs(np.diff(self.position))
        usual = float(np.quantile(steps, _USUAL_SHARE))
        least = max(_JUMP * usual, _JUMP_TRAVEL * float(np.ptp(self.position)))
        if float(np.max(steps)) <= least:
            return
        from scipy.ndimage import median_filter  # not for commands that only read

        away = np.abs(self.position - median_filter(self.position, _NEAR, mode="nearest"))
        jumps = short_runs(away > least, _SPIKE_ROWS)
        if np.any(jumps):
            k = int(np.argmax(np.where(jumps, away, 0.0)))
            place, apart, step = (
                Quantity(value, self.frame.position, form="SI") for value in (self.position[k], away[k], usual)
            )
            raise NotIdentifiableError(
                f"{self.name}: the position has {int(np.sum(jumps))} jump{'s' * (int(np.sum(jumps)) != 1)} there and "
                f"back, the largest to {place} at row {k + 1} ({Quantity(k * self.sample_time, 's'):SI}), {apart} off "
                f"its neighbors, where {Quantity(_USUAL_SHARE, 'share'):6} of the steps stay within {step}: no axis "
                "moves so; repair these rows, or cut the log there"
            )

    def without_spikes(self) -> tuple[MotionLog, tuple[str, ...]]:
        """Replace lesser spikes of the force by the mean of the neighbors, and return a remark on them.

        A spike lasts three samples at most and is away from the median of 9 rows by more than the usual force F, within
        which 99 % of the rows stay, and by 8 standard deviations of the 61 rows around it:

            d = |f - median9(f)| > max(F, 8 · 1.4826 median61(d))

        No axis answers so short a force visibly, and a drive that really commanded it would not be fitted otherwise.
        More than 1 % of such rows are no faults of a line: coarse counts make them through a velocity gain.
        """
        from scipy.ndimage import median_filter  # not for commands that only read

        away = np.abs(self.force - median_filter(self.force, _NEAR, mode="nearest"))
        spread = 1.4826 * median_filter(away, min(_AROUND, away.size), mode="nearest")
        usual = float(np.quantile(np.abs(self.force), _USUAL_SHARE))
        spikes = short_runs(away > np.maximum(usual, _NOISE * spread), _SPIKE_ROWS)
        if not np.any(spikes) or np.mean(spikes) > 1.0 - _USUAL_SHARE:
            return self, ()
        rows, there = np.flatnonzero(~spikes), np.flatnonzero(spikes)
        force = self.force.copy()
        force[there] = np.interp(there, rows, self.force[rows])
        return replace(self, force=force), strays_said(f"{self.name}, force", self.force, spikes, self.frame.force)


def checked(log: MotionLog) -> MotionLog:
    """Return the log. Raises ParameterError, with what to write, for anything but a MotionLog."""
    if not isinstance(log, MotionLog):  # pyright: ignore[reportUnnecessaryIsInstance]  what `read_log` gives is tempting
        raise ParameterError(
            f"identification takes a MotionLog, not a {type(log).__name__}: MotionLog(name=log.name, position=log["
            "'position_load'], force=log['force'], set_position=log['setpoint_position'], sample_time=log.sample_time)"
        )
    return log


# The effect of an encoder's counts on a closed loop: the run of a log, drawn anew with other offsets of the counts.

SIGNALS = ("reading_load", "force")
_ON_COUNT = 0.05  # of a count: how far a reading may be off it by the rounding of its file
_NEAR_COUNT = 51  # rows over which the spread is averaged: of some sixteen runs each row alone knows it to a fifth
_STILL = 0.03  # s after which an axis whose setpoint stands is taken to be at rest


def count_of(position: np.ndarray) -> float:
    """Return the length of a count of readings in m: all differ by whole multiples of it. 0 if there is none."""
    levels = np.unique(position)
    steps = np.diff(levels)
    steps = steps[steps > 1e-12 * (levels[-1] - levels[0])]
    if not steps.size:
        return 0.0
    near = float(np.mean(steps[steps < 1.5 * np.min(steps)]))
    count = float((levels[-1] - levels[0]) / np.round((levels[-1] - levels[0]) / near))
    off = (levels - levels[0]) / count
    return count if np.max(np.abs(off - np.round(off))) < _ON_COUNT else 0.0


def at_rest(log: MotionLog, skip: int) -> np.ndarray:
    """True for rows where the set position has stood for `_STILL`, after `skip` samples.

    There a reading stands on its count: its error is one number for the whole dwell, and friction holds any force.
    """
    assert log.set_position is not None
    moved = np.diff(log.set_position, prepend=log.set_position[0]) != 0.0
    moved[0] = True
    rows = np.arange(moved.size)
    since = rows - np.maximum.accumulate(np.where(moved, rows, 0))
    return (since > _STILL / log.sample_time)[skip:]


def unknown_force(residual: np.ndarray, runs: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Return the force besides the model, in N, row by row of a motion without rests; 0 where counts explain it.

        d = -share · r̃,   share² = 1 - Σ s̃² / Σ r̃²

    residual  force measured - mean of the runs, shape (n,); the drive answers a force by its opposite
    runs      their forces less their mean, shape (runs, n), what counts alone make
    moving    rows that count
    r̃ and s̃ are means of `_NEAR_COUNT` rows: counts make noise that is quicker than what an axis feels.
    """
    from scipy.ndimage import uniform_filter1d  # not for commands that only read

    slow = uniform_filter1d(residual[moving], _NEAR_COUNT, mode="nearest")
    counts = uniform_filter1d(runs[:, moving], _NEAR_COUNT, axis=1, mode="nearest")
    power = float(np.mean(slow**2))
    own = float(np.mean(counts**2)) * len(runs) / (len(runs) - 1)
    return -np.sqrt(max(0.0, 1.0 - own / power)) * slow if power > 0.0 else 0.0 * slow


def drawn(
    loop: Loop, log: MotionLog, skip: int, count: float, runs: int, seed: int, unknown: np.ndarray | None = None
) -> np.ndarray:
    """Simulate the log with other offsets of the encoder's counts; reading and force, shape (runs, 2, n).

    From run to run the counts lie elsewhere along the travel, evenly over one count, the axis begins anywhere within
    its count, and an unknown force begins at another of its rows.  Raises DivergedError if a run diverges.
    """
    assert log.set_position is not None
    random = np.random.default_rng(seed)
    counted, offsets = _counted(loop, count)
    reference = Recorded(position=log.set_position, sample_time=float(loop.sample_time))
    position, velocity = estimate_start(log.position, log.sample_time)
    simulated = []
    for i in range(runs):
        shift = count * ((i + random.uniform()) / runs - 0.5)
        begin = position + count * random.uniform(-0.5, 0.5)
        load = None
        if unknown is not None and np.any(unknown):
            turned = np.roll(unknown, random.integers(unknown.size))
            load = RecordedForce(force=np.resize(turned, log.position.size), sample_time=float(loop.sample_time))
        run = simulate(
            tree.vary(counted, {name: value + shift for name, value in offsets.items()}),
            reference,
            load=load,
            start=(begin, velocity),
            record=SIGNALS,
            seed=i,
        )
        simulated.append([run[name][skip : log.position.size] for name in SIGNALS])
    return np.array(simulated)


def spread(runs: np.ndarray) -> np.ndarray:
    """Return the variance from run to run at each row and its neighbors, shape (2, n)."""
    from scipy.ndimage import uniform_filter1d  # not for commands that only read

    return uniform_filter1d(np.var(runs, axis=0, ddof=1), _NEAR_COUNT, axis=1, mode="nearest")


def _counted(loop: Loop, count: float) -> tuple[Loop, dict[str, float]]:
    """Return the loop with encoders that count, and their offsets by name; an axis without encoder gets one."""
    ends = {end: getattr(loop.axis, end) for end in ("encoder_motor", "encoder_load")}
    if all(encoder is None for encoder in ends.values()):
        ends["encoder_load"] = Encoder(resolution=count)
    counting_encoders = {
        end: replace(
            encoder, resolution=max(count, float(encoder.resolution or 0.0)), offset=float(encoder.offset or 0.0)
        )
        for end, encoder in ends.items()
        if isinstance(encoder, Encoder)
    }
    counted = replace(loop, axis=replace(loop.axis, **counting_encoders))
    return counted, {
        f"{loop.place_of('axis')}.{end}.offset": float(counting.offset or 0.0)
        for end, counting in counting_encoders.items()
    }
