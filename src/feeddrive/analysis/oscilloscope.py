"""An oscilloscope for live signals: recording, triggering and the cursor readout.

scope = Oscilloscope(window=0.5, before=0.2, mode=NORMAL, trigger=Trigger("force", 100.0))
scope.feed(source)                  # a `LiveSource`; call it repeatedly
shown = scope.shown()               # the last captured window, or None
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

RISING, FALLING = "rising", "falling"


@dataclass(frozen=True)
class Trigger:
    """The trigger condition of an oscilloscope.

    channel     name of the channel
    level       trigger level, in the unit of the channel
    edge        rising or falling
    hysteresis  distance by which the signal must have been on the other side of the level, so that noise triggers
                only once; >= 0, in the unit of the channel
    hold        holdoff: time after a trigger during which no further trigger is accepted; >= 0, s
    """

    channel: str
    level: float = 0.0
    edge: str = RISING
    hysteresis: float = 0.0
    hold: float = 0.0

    def __post_init__(self) -> None:
        if self.edge not in (RISING, FALLING):
            raise ParameterError(f"edge = '{self.edge:.20}' of the trigger must be {RISING} or {FALLING}")
        if not math.isfinite(self.level):
            raise ParameterError(f"level = {self.level} of the trigger must be a finite number")
        for name, value, unit in (("hysteresis", self.hysteresis, ""), ("hold", self.hold, "s")):
            if not 0.0 <= value < math.inf:
                least = Quantity(0.0, unit)
                raise ParameterError(
                    f"{name} = {Quantity(value, unit):6 SI} of the trigger must be >= {least:SI} and finite"
                )


class Crossings:
    """A detector of trigger instants in a signal that arrives in blocks; block boundaries do not affect the result.

    A rising edge lies between two consecutive samples a at time s and b at time t if a < level <= b, and if the signal
    has been at or below level - hysteresis since it was last at or above the level.  By linear interpolation:

        instant = s + (t - s) (level - a) / (b - a)

    A falling edge is a rising edge of the negated signal.  NaN marks a gap, which resets the detector.
    """

    def __init__(self, trigger: Trigger) -> None:
        self._sign = 1.0 if trigger.edge == RISING else -1.0
        self._level = self._sign * trigger.level
        self._low = self._level - trigger.hysteresis
        self._last: tuple[float, float] = (math.nan, math.nan)
        self._armed = False

    def take(self, time: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Return the trigger instants (s) within the next samples; time and values of shape (n,)."""
        if not time.size:
            return np.empty(0)
        t = np.concatenate([[self._last[0]], time])
        y = np.concatenate([[self._last[1]], self._sign * values])
        # comparisons with NaN are False on both sides, which is what a gap must be
        with np.errstate(invalid="ignore"):
            high, low, gap = y >= self._level, (y < self._level) & (y <= self._low), ~np.isfinite(y)
        known = high | low | gap
        # True if the last sample up to each one that was high, low or a gap was low
        index = np.where(known, np.arange(y.size), -1)
        # without a loop over samples: a drive gives thousands of rows a second
        index = np.maximum.accumulate(index)
        below = np.where(index >= 0, low[index], self._armed)
        below[0] = self._armed
        crossings = np.flatnonzero(high[1:] & below[:-1] & ~gap[:-1]) + 1
        self._last = float(t[-1]), float(y[-1])
        self._armed = bool(below[-1])
        a, b = y[crossings - 1], y[crossings]
        return t[crossings - 1] + (t[crossings] - t[crossings - 1]) * (self._level - a) / (b - a)


AUTO, NORMAL, SINGLE = "auto", "normal", "single"
MODES: Mapping[str, str] = {
    AUTO: "the last window around a trigger; without one the last seconds run by",
    NORMAL: "the last window around a trigger, until there is another",
    SINGLE: "the first window around a trigger, and no other one before it is armed again",
}
MOST_NUMBERS = 1_000_000  # of all channels and their time that are kept: 8 MB
# a shorter window is complete before a person could read a part of it
_LONG = 2.0  # s: windows from here on are shown while they fill
# a trigger near the end of one window still needs its share before it
_SPARE = 1.5  # windows that are kept


class Rows(NamedTuple):
    """The rows of several signals that have arrived since the last call.

    time    ascending, in s (or in samples, for a source without a clock), shape (n,)
    values  shape (n, channels); a row of NaN is a gap
    anew    True if earlier rows are invalid, since the file was replaced or truncated, or the clock restarted
    """

    time: np.ndarray
    values: np.ndarray
    anew: bool = False


class LiveSource(Protocol):
    """A source of signals that are being recorded."""

    name: str
    channels: Mapping[str, str]
    """The units by channel name, empty if unknown; the mapping is empty before the first rows."""
    clock: str
    """The unit of the time: `s`, or `samples` for a source without a clock."""
    over: bool
    """True if the source has ended."""

    def take(self) -> Rows:
        """Return the rows that have arrived since the last call, without waiting.

        Raises FeeddriveError if the source has failed.
        """
        ...

    def state(self) -> str:
        """Return the status as a sentence: rows are being received, rows were skipped, or the source is waiting."""
        ...

    def close(self) -> None:
        """Release the source; never raises."""


class Recording:
    """A buffer for the last rows of several channels, at most `MOST_NUMBERS` numbers; the oldest rows are dropped."""

    most: int
    """The number of rows that are kept."""

    def __init__(self, channels: int) -> None:
        self.most = max(2, MOST_NUMBERS // (channels + 1))
        self._rows = np.empty((64, channels + 1))
        self._from = self._to = 0

    def __len__(self) -> int:
        return self._to - self._from

    @property
    def time(self) -> np.ndarray:
        """The times in s, shape (n,), as a view that the next `add` may change."""
        return self._rows[self._from : self._to, 0]

    @property
    def values(self) -> np.ndarray:
        """The values, shape (n, channels), as a view that the next `add` may change."""
        return self._rows[self._from : self._to, 1:]

    def add(self, time: np.ndarray, values: np.ndarray) -> None:
        """Append rows with non-decreasing time."""
        if not time.size:
            return
        time, values = time[-self.most :], values[-self.most :]
        self._from += min(max(0, len(self) + time.size - self.most), len(self))
        if self._to + time.size > len(self._rows):
            self._make_room(time.size)
        there = slice(self._to, self._to + time.size)
        self._rows[there, 0], self._rows[there, 1:] = time, values
        self._to = there.stop

    def _make_room(self, more: int) -> None:
        """Move the kept rows to the front, and enlarge the buffer if less than a tenth of it would remain free."""
        held, needed = self._rows[self._from : self._to], len(self) + more
        # with less than a tenth to spare the rows would be moved again after a few additions
        fitting = needed <= 0.9 * len(self._rows)
        rows = self._rows if fitting else np.empty((needed + needed // 4 + 64, self._rows.shape[1]))
        rows[: len(held)] = held  # numpy copies rows that overlap as if they did not
        self._rows, self._from, self._to = rows, 0, len(held)

    def keep(self, seconds: float) -> None:
        """Drop rows that are older than the last row by more than `seconds`."""
        if len(self):
            self._from += int(np.searchsorted(self.time, self.time[-1] - seconds))

    def between(self, start: float, end: float) -> tuple[np.ndarray, np.ndarray]:
        """Return copies of time and values of the rows from `start` to `end`, s, both inclusive."""
        first, last = np.searchsorted(self.time, start, "left"), np.searchsorted(self.time, end, "right")
        return self.time[first:last].copy(), self.values[first:last].copy()


@dataclass(frozen=True, eq=False)
class Shown:
    """A captured window of signals.

    time, values  as recorded, shapes (n,) and (n, channels)
    channels      units of the columns of values by name, as stated by their source; empty where unknown
    zero          time origin of the window: the trigger instant, or without a trigger the end of the window
    start, end    limits of the window relative to `zero`
    triggered     True if the window belongs to a trigger
    whole         True if the recording covers the whole window
    clock         unit of the time
    """

    time: np.ndarray
    values: np.ndarray
    channels: Mapping[str, str]
    zero: float
    start: float
    end: float
    triggered: bool
    whole: bool = True
    clock: str = "s"


class Readout(NamedTuple):
    """The readings of two cursors: the values of all channels at times `a` and `b`, relative to the window's time zero.

    Values are interpolated linearly between samples; NaN outside the window and in gaps.
    """

    a: float
    b: float
    at_a: np.ndarray
    at_b: np.ndarray

    @property
    def step(self) -> float:
        """The time difference b - a."""
        return self.b - self.a

    @property
    def rate(self) -> float:
        """The frequency 1/(b - a), in Hz if the time is in s; infinite for coincident cursors."""
        return math.inf if self.b == self.a else 1.0 / (self.b - self.a)

    @property
    def rise(self) -> np.ndarray:
        """The values at b minus those at a."""
        return self.at_b - self.at_a


def readout(shown: Shown, a: float, b: float) -> Readout:
    """Return the values of all channels at two times, relative to the time zero of the window."""
    return Readout(a, b, _at(shown, a), _at(shown, b))


def _at(shown: Shown, place: float) -> np.ndarray:
    time, at = shown.time, shown.zero + place
    if not time.size or not time[0] <= at <= time[-1]:
        return np.full(shown.values.shape[1], np.nan)
    # exact on a sample: interpolation with a gap beside it would give NaN where a value was measured
    k = int(np.clip(np.searchsorted(time, at, "left"), 1, time.size - 1)) if time.size > 1 else 0
    if time[k] == at or k == 0:
        return shown.values[k].copy()
    if time[k - 1] == at:
        return shown.values[k - 1].copy()
    share = (at - time[k - 1]) / (time[k] - time[k - 1])
    return (1.0 - share) * shown.values[k - 1] + share * shown.values[k]


class Oscilloscope:
    """An oscilloscope: the last seconds of a source, and the windows captured by its trigger.

    window   length of the window, s (or samples)
    before   fraction of the window before the trigger, 0 to 0.95
    mode     one of `MODES`
    trigger  trigger condition; None: the last seconds are shown continuously in every mode

    A trigger is accepted only if the part of its window before the trigger has been recorded, and not while another
    window is being filled.  Trigger and mode may be changed at any time; a captured window is kept until the next one
    is complete.
    """

    def __init__(
        self, window: float = 1.0, before: float = 0.2, mode: str = AUTO, trigger: Trigger | None = None
    ) -> None:
        self.channels: dict[str, str] = {}
        self.clock = "s"
        self.caught: Shown | None = None
        self.recording = Recording(0)
        self._fed = -math.inf  # time of the last row
        self.rows = 0  # that have come in all
        self.set(window, before, mode, trigger)

    def set(self, window: float, before: float, mode: str, trigger: Trigger | None) -> None:
        """Change the settings and rearm the trigger. Raises ParameterError for invalid settings."""
        if not 0.0 < window < math.inf:
            raise ParameterError(f"window = {Quantity(window, 's'):6 SI} must be > 0 s and finite")
        if not 0.0 <= before <= 0.95:
            raise ParameterError(
                f"before = {Quantity(before):6}, the share of the window before the trigger, must be 0 to 0.95"
            )
        if mode not in MODES:
            raise ParameterError(f"mode = '{mode:.20}' must be one of {', '.join(MODES)}")
        self.window, self.before, self.mode, self.trigger = window, before, mode, trigger
        self.arm()

    def arm(self) -> None:
        """Rearm the trigger; in single mode, it then captures one more window.

        Raises ParameterError for an unknown channel.
        """
        if self.trigger is not None and self.channels and self.trigger.channel not in self.channels:
            raise ParameterError(
                f"there is no channel '{self.trigger.channel:.60}'{nearest(self.trigger.channel, self.channels)}"
            )
        self._crossings = None if self.trigger is None else Crossings(self.trigger)
        self._ready = -math.inf  # time from which an instant counts
        self._filling: float | None = None  # instant whose window is not yet whole
        self.count = 0  # windows that were caught

    @property
    def waits(self) -> bool:
        """True if the oscilloscope is waiting for a trigger."""
        return self._crossings is not None and not (self.mode == SINGLE and (self.count or self._filling is not None))

    def feed(self, source: LiveSource) -> int:
        """Record the new rows of a source and return their number."""
        rows = source.take()
        of, known = ([*channels.items()] for channels in (source.channels, self.channels))  # their order counts
        if of != known or source.clock != self.clock:
            self.channels, self.clock = dict(source.channels), source.clock
            self._forget()
        self.rows += rows.time.size
        if rows.time.size:
            self._add(rows)
        return rows.time.size

    def _forget(self) -> None:
        """Drop the recording after the clock or the channels have changed; the captured window is kept."""
        self.recording = Recording(len(self.channels))
        self._crossings = None if self.trigger is None else Crossings(self.trigger)
        self._ready, self._filling, self._fed = -math.inf, None, -math.inf

    def _add(self, rows: Rows) -> None:
        last = self._fed
        back = np.flatnonzero(np.diff(rows.time, prepend=last) < 0.0)
        if back.size:  # the clock began again: only what came after it is one record
            self._forget()
            rows = Rows(rows.time[back[-1] :], rows.values[back[-1] :])
        elif rows.anew and len(self.recording):  # another file, by the same clock: a gap
            gap = np.full((1, rows.values.shape[1]), np.nan)
            rows = Rows(np.concatenate([rows.time[:1], rows.time]), np.concatenate([gap, rows.values]))
        most = self._at_once
        for k in range(0, rows.time.size, most):
            self._piece(rows.time[k : k + most], rows.values[k : k + most])

    @property
    def _at_once(self) -> int:
        """The number of rows processed at a time, so small that no row is dropped before its window is complete."""
        return min(1 << 14, max(1, self.recording.most // 8))

    @property
    def lack(self) -> str:
        """The error message if the window exceeds the capacity of the recording; otherwise empty."""
        time = self.recording.time
        kept = float(time[-1] - time[self._at_once]) if time.size >= self.recording.most else math.inf
        if not 0.0 < kept < self.window:
            return ""
        # two digits, rounded down: the advice must fit
        step = 10.0 ** (math.floor(math.log10(kept)) - 1)
        window, longest = (Quantity(span, self.clock) for span in (self.window, math.floor(kept / step) * step))
        return Text(
            f"a window of {window:6 SI} is longer than what is kept of {len(self.channels)} channels at this rate: "
            f"make it {longest:6 SI} or shorter, or record fewer channels"
        )

    def _piece(self, time: np.ndarray, values: np.ndarray) -> None:
        self.recording.add(time, values)
        self._fed = float(time[-1])
        if self._crossings is not None and self.trigger is not None and self.trigger.channel in self.channels:
            for instant in self._crossings.take(time, values[:, [*self.channels].index(self.trigger.channel)]).tolist():
                self._complete(instant)
                recorded = instant - self.before * self.window >= self.recording.time[0]
                if self._filling is None and instant >= self._ready and recorded and self.waits:
                    self._filling = instant
                    self._ready = instant + self.trigger.hold
        self._complete(self._fed)
        self.recording.keep(_SPARE * self.window)

    def _complete(self, until: float) -> None:
        """Capture the window that is being filled if it ends by the time `until`."""
        if self._filling is not None and until >= self._filling + (1.0 - self.before) * self.window:
            self.caught, self._filling = self._around(self._filling), None
            self.count += 1

    def _around(self, instant: float) -> Shown:
        start, end = -self.before * self.window, (1.0 - self.before) * self.window
        time, values = self.recording.between(instant + start, instant + end)
        whole = float(self.recording.time[0]) <= instant + start and self._fed >= instant + end
        return Shown(time, values, dict(self.channels), instant, start, end, True, whole, self.clock)

    def shown(self) -> Shown | None:
        """Return the window to be displayed; None if nothing is recorded yet."""
        if self.trigger is None or (self.mode == AUTO and self._overdue):
            return self.last()
        if self._filling is not None and (self.window >= _LONG or self.caught is None):
            return self._around(self._filling)
        if self.caught is None and self.mode == AUTO:
            return self.last()
        return self.caught

    @property
    def _overdue(self) -> bool:
        """True if the last window ended longer ago than its length, the holdoff and 2 s, without a new trigger."""
        if self._filling is not None or self.caught is None or self.trigger is None:
            return False
        since = self._fed - (self.caught.zero + self.caught.end)
        # since < 0: the captured window belongs to a clock that has restarted
        return since < 0.0 or since > max(self.window, _LONG, self.trigger.hold)

    def last(self) -> Shown | None:
        """Return the latest window of the recording, with time zero at its end; None if nothing is recorded."""
        if not len(self.recording):
            return None
        end = float(self.recording.time[-1])
        time, values = self.recording.between(end - self.window, end)
        whole = float(time[0]) > float(self.recording.time[0])
        return Shown(time, values, dict(self.channels), end, -self.window, 0.0, False, whole, self.clock)
