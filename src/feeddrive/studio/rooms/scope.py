"""The Scope page: an oscilloscope for live signals, with trigger, cursors, and export of the window as a log."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.analysis.oscilloscope import MODES, Oscilloscope, Readout, Shown, readout
from feeddrive.files.columns import unit_of
from feeddrive.files.log import write_log
from feeddrive.files.names import words_of
from feeddrive.language import units
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.quantity import Quantity, number, signal_unit
from feeddrive.language.text import Text
from feeddrive.language.units import rounded
from feeddrive.plot.chart import Chart
from feeddrive.plot.over_time import Channel, Ranges, scope_chart
from feeddrive.plot.style import written
from feeddrive.studio.desk import Asked, Desk, Room, Said, act
from feeddrive.studio.live import EXAMPLE, OF_EXAMPLE, Following, Playback
from feeddrive.workflow.command import Field, fields_of
from feeddrive.workflow.follow import FollowRequest, between, window_log

_FIELDS: Mapping[str, Field] = {field.name: field for field in fields_of(FollowRequest)}
_SHOWN = ("window", "before", "level", "edge", "hysteresis", "hold", "sample_time", "time_unit")
_OF_CHANNEL = ("level", "hysteresis")  # in the unit in which the channel of the trigger is shown
_OF_CLOCK = ("sample_time", "time_unit")
_OF_WINDOW = ("window", "hold")
_SAMPLES = 500.0  # of a window of a source without a clock, unless somebody chooses
_FEW = 4  # channels that are shown at first
_MOST = 8  # at once
_STROKES = 2.4  # s, all strokes of the bundled source
_FINE = {"error", "err", "ferror", "lag", "deviation"}  # words of lengths that are shown in um, and not in mm
_UNITS = (
    "nm",
    "um",
    "mm",
    "m",
    "um/s",
    "mm/s",
    "m/s",
    "m/min",
    "mm/s2",
    "m/s2",
    "mN",
    "N",
    "kN",
    "mN m",
    "N m",
    "mA",
    "A",
    "mV",
    "V",
    "mdeg",
    "deg",
    "rad",
    "deg/s",
    "rad/s",
    "rpm",
    "percent",
    "1",
    "s",
    "ms",
    "us",
)


@cache
def _example() -> Chart:
    """Return the picture of the bundled source, as it looks once it has run for a while."""
    scope = Oscilloscope(_STROKES)
    scope.feed(Playback(_STROKES))
    shown = scope.shown()
    assert shown is not None
    units_of = {"set position": ("mm", 1e3), "actual position": ("mm", 1e3), "following error": ("um", 1e6)}
    drawn = [
        Channel(name, place, *units_of.get(name, (unit, 1.0)))
        for place, (name, unit) in enumerate(shown.channels.items())
    ]
    return scope_chart(shown, drawn, shown.clock)[0]


class Scope(Room):
    """The page for the oscilloscope: a live source and its display."""

    name = "scope"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.scope = Oscilloscope()
        self.following: Following | None = None
        self.chosen = ""  # the source
        self.settings: dict[str, Any] = {}  # what was set, in SI or the unit of the source
        self.mode = "auto"
        self.trigger = ""  # its channel
        self.drawn: dict[str, bool] = {}  # channels that are shown or not, as a person chose
        self.stated: dict[str, str] = {}  # units of channels whose source states none
        self.in_unit: dict[str, str] = {}  # units in which channels are shown
        self.cursors: tuple[float, float] | None = None
        self.held: Shown | None = None
        self.saved = ""
        self._counted = "s"  # unit of the window that was set
        self._ranges = Ranges()
        desk.closing.append(self._stop)

    def show(self) -> Said:
        """Return the sources, the settings, the channels, and the current window."""
        frame = self._frame()
        channels = self._units()
        empty = self.following is None and not frame.charts
        return Said(
            {
                **frame.words,
                "live": False,
                "sources": [
                    *({"name": name, "kind": source.kind} for name, source in self.desk.live.offered().items()),
                    {"name": EXAMPLE, "kind": f"bundled: {OF_EXAMPLE}"},
                ],
                "example": OF_EXAMPLE if empty else "",
                "hint": self.desk.live.hint,
                "chosen": self.chosen,
                "fields": [self._field(name) for name in _SHOWN],
                "mode": self.mode,
                "modes": dict(MODES),
                "trigger": self.trigger,
                "saved": self.saved,
                "channels": [self._channel(name) for name in channels],
            },
            {"example": _example()} if empty else frame.charts,
        )

    @act
    def frame(self, _: Asked) -> Said:
        """Return the current window and the cursor readings; requested at the drawing rate of the page."""
        return self._frame()

    @act
    def follow(self, asked: Asked) -> None:
        """Start following a source."""
        name = asked.text("name")
        request = self._request(self.settings)
        # opened before the present one is released: if this fails, that one goes on
        source = self.desk.live.open(name, request.sample_time, request.time_unit)
        self._stop()
        if name != self.chosen:
            self.trigger, self.drawn, self.stated, self.in_unit = "", {}, {}, {}
            dropped = _OF_CHANNEL if self._counted == "s" else (*_OF_CHANNEL, *_OF_WINDOW)
            self.settings = {key: value for key, value in self.settings.items() if key not in dropped}
            self.cursors, self._counted = None, "s"
        self.chosen, self.held, self._ranges = name, None, Ranges()
        request = self._request(self.settings)
        self.scope = Oscilloscope(request.window, request.before, self.mode, request.trigger())
        self.following = Following(source, self.scope, self.desk.watched)

    @act
    def stop(self, _: Asked) -> None:
        """Release the source; the recorded data are kept."""
        self._stop()

    @act
    def set(self, asked: Asked) -> None:
        """Set a field from the string that the user entered; an empty string restores the default."""
        name = asked.choice("field", _SHOWN)
        text = asked.text("value").strip()
        another = name in _OF_CLOCK and self._counted != "s"
        dropped = (name, *_OF_WINDOW) if another else (name,)
        settings = {key: value for key, value in self.settings.items() if key not in dropped}
        if text:
            settings[name] = self._read(_FIELDS[name], text)
        self._apply(settings, self.mode)
        self._counted = "s" if another else self._counted
        # the clock is determined when a source is opened
        if name in _OF_CLOCK and self.following is not None:
            self.follow(Asked({"name": self.chosen}))

    @act
    def look(self, asked: Asked) -> None:
        """Set the mode and the trigger channel; an empty name removes the trigger."""
        mode, channel = asked.choice("mode", MODES), asked.text("channel")
        known = self._units()
        if channel and channel not in known:
            raise ParameterError(f"there is no channel {channel!r:.60}{nearest(channel, known)}")
        settings = dict(self.settings)
        if channel != self.trigger:
            settings = {key: value for key, value in settings.items() if key not in _OF_CHANNEL}
            # the default level of 0 may lie outside of the signal
            if channel and (middle := self._middle(channel)) is not None:
                settings["level"] = middle
        self.trigger = channel
        self._apply(settings, mode)

    @act
    def arm(self, _: Asked) -> None:
        """Arm the trigger."""
        self.held = None
        self._apply(self.settings, self.mode)

    @act
    def hold(self, asked: Asked) -> None:
        """Freeze the picture while recording continues, or release it."""
        with self._lock():
            self.held = self.scope.shown() if asked.yes("on") else None

    @act
    def channel(self, asked: Asked) -> None:
        """Show or hide a channel, set its unit if the source states none, and choose the displayed unit."""
        name, known = asked.text("name"), self._units()
        if name not in known:
            raise ParameterError(f"there is no channel {name!r:.60}{nearest(name, known)}")
        drawn = asked.yes("shown")
        if drawn and name not in self._drawn() and len(self._drawn()) >= _MOST:
            raise ParameterError(f"{_MOST} channels are shown at most: take one away first")
        stated, shown_in = asked.text_or_none("stated") or "", asked.text_or_none("unit")
        unit = unit_of(stated)
        if unit is None:
            raise ParameterError(f"{name}: '{stated:.20}' is no unit: write it as mm, mm/s, N, rad or deg")
        of = self.scope.channels.get(name) or unit
        if shown_in is not None and shown_in not in _choices(of):
            if unit == self.stated.get(name, ""):
                raise ParameterError(f"{name} is in '{of}' and cannot be shown in '{shown_in:.20}'")
            # the displayed unit was chosen for the previous unit
            shown_in = None
        self.drawn[name] = drawn
        self.stated[name] = unit
        self.in_unit[name] = shown_in or ""

    @act
    def move(self, asked: Asked) -> Said:
        """Set a cursor to a time in the picture, or remove both cursors if no time is given."""
        place = asked.number_or_none("x")
        if place is None:
            self.cursors = None
            return self._frame()
        shown = self._shown()
        if shown is not None:
            place = min(max(place, shown.start), shown.end)
        a, b = self.cursors or (place, place)
        # a second cursor at the same time would be hidden by the first
        if self.cursors is None and shown is not None:
            other = shown.start + 0.75 * (shown.end - shown.start)
            a, b = (place, other) if asked.choice("name", ("1", "2")) == "1" else (other, place)
        self.cursors = (place, b) if asked.choice("name", ("1", "2")) == "1" else (a, place)
        return self._frame()

    @act
    def save(self, asked: Asked) -> Said:
        """Save the window, or the part between the cursors, as a log among the uploaded files."""
        shown = self._shown()
        if shown is not None and shown.triggered and not shown.whole:
            # the complete window before the one that is filling
            shown = self.scope.caught
        if shown is None or not shown.time.size or (shown.triggered and not shown.whole):
            lack = self.scope.lack or "wait for it, or follow a source first"
            raise ParameterError(f"there is no whole window yet: {lack}")
        if asked.yes("between"):
            if self.cursors is None:
                raise ParameterError("set both cursors first: what lies between them is kept")
            shown = between(shown, *self.cursors)
        folder = self.desk.folder / "brought"
        # an upload may have such a name
        taken = {*self.desk.files, *(path.name for path in folder.glob("*"))}
        name = next(candidate for i in count(1) if (candidate := f"scope_{i}.parquet") not in taken)
        log = window_log(f"{Path(self.chosen).stem}, scope", shown, self.stated, self._drawn(shown.channels))
        folder.mkdir(parents=True, exist_ok=True)
        write_log(folder / name, log)
        self.desk.files[name] = folder / name
        self.saved = name
        return Said({**self.show().words, "import": name})

    def _lock(self) -> Any:
        from contextlib import nullcontext

        return nullcontext() if self.following is None else self.following.lock

    def _stop(self) -> None:
        if self.following is not None:
            self.following.stop()

    def _request(self, settings: Mapping[str, Any]) -> FollowRequest:
        # the source is irrelevant here: the request only checks the settings
        return FollowRequest(Path("x"), channel=self.trigger or None, **settings)

    def _apply(self, settings: Mapping[str, Any], mode: str) -> None:
        with self._lock():
            self._set(settings, mode)

    def _set(self, settings: Mapping[str, Any], mode: str) -> None:
        request = self._request(settings)
        self.scope.set(request.window, request.before, mode, request.trigger())
        self.settings, self.mode = dict(settings), mode

    def _fit_clock(self) -> None:
        """Discard window settings made for another clock; without a clock the default window is `_SAMPLES` samples."""
        clock, channels = self.scope.clock, self.scope.channels
        if not channels:
            return
        dropped = () if clock == self._counted else _OF_WINDOW
        settings = {key: value for key, value in self.settings.items() if key not in dropped}
        if clock != "s":
            # without a clock the window counts samples, and the default of 1 s would be one sample
            settings.setdefault("window", _SAMPLES)
        self._counted = clock
        if settings != self.settings:
            if self.trigger not in channels:
                self.trigger = ""
            self._set(settings, self.mode)

    def _units(self, of: Mapping[str, str] | None = None) -> dict[str, str]:
        """Return the units of the current channels, or of those in `of`, as stated by the source or the user."""
        of = self.scope.channels if of is None else of
        return {name: unit or self.stated.get(name, "") for name, unit in of.items()}

    def _drawn(self, of: Mapping[str, str] | None = None) -> list[str]:
        of = self.scope.channels if of is None else of
        return [name for k, name in enumerate(of) if self.drawn.get(name, k < _FEW)]

    def _factor(self, name: str, of: Mapping[str, str] | None = None) -> tuple[str, float]:
        """Return the displayed unit of a channel, and the conversion factor from the source's unit to it."""
        unit = self._units(of).get(name, "")
        chosen = self.in_unit.get(name)
        # the choice may be that of an earlier channel of the same name
        if not chosen or chosen not in _choices(unit):
            usual = "mm" if unit == "m" and not _FINE & {*words_of(name)} else signal_unit(unit)
            chosen = usual if usual in _choices(unit) else unit
        return chosen, units.factor(unit, chosen) if unit and chosen != unit else 1.0

    def _read(self, field: Field, text: str) -> Any:
        if field.kind is str:
            return text
        try:
            # a decimal comma is what many users type
            number = float(text.replace(",", "."))
        except ValueError:
            raise ParameterError(f"{field.name.replace('_', ' ')}: '{text:.40}' is no number") from None
        factor = 1.0 / self._factor(self.trigger)[1] if field.name in _OF_CHANNEL else field.factor
        return units.scaled(number, factor)

    def _middle(self, channel: str) -> float | None:
        """Return a level that the signal crosses: the mean of its minimum and maximum in view; None if there are no
        data.
        """
        shown = self._shown()
        if shown is None or shown.channels.get(channel) != self.scope.channels[channel]:
            return None
        values = shown.values[:, [*shown.channels].index(channel)]
        values = values[np.isfinite(values)]
        return rounded(0.5 * float(np.min(values) + np.max(values)), 4) if values.size else None

    def _shown(self) -> Shown | None:
        if self.held is not None:
            return self.held
        with self._lock():
            return self.scope.shown()

    def _frame(self) -> Said:
        following = self.following
        with self._lock():
            # under one lock, so that settings, window and channels are of the same instant
            self._fit_clock()
            shown = self.scope.shown() if self.held is None else self.held
            look, channels = self._looking(shown), dict(self.scope.channels)
        words: dict[str, Any] = {
            "live": True,
            "following": following is not None and following.going,
            "state": "" if following is None else following.state(),
            "failed": following is not None and bool(following.failed),
            "rate": 0.0 if following is None else following.rate,
            "held": self.held is not None,
            "of": [f"{name} {unit}" for name, unit in channels.items()],
            "look": look,
            "readout": [],
            "cursors": None,
        }
        of = {} if shown is None else shown.channels
        drawn = [Channel(name, [*of].index(name), *self._factor(name, of)) for name in self._drawn(of)]
        if shown is None or not drawn:
            return Said(words)
        clock = shown.clock
        read = None if self.cursors is None else readout(shown, *self.cursors)
        level = (self.trigger, self.settings.get("level", 0.0)) if self.trigger else None
        chart, self._ranges = scope_chart(shown, drawn, clock, level=level, cursors=read, before=self._ranges)
        if read is not None:
            words["cursors"] = [read.a, read.b]
            words["readout"] = _readout_rows(read, drawn, clock)
        words["span"] = [shown.start, shown.end]
        charts: dict[str, Chart] = {"scope": chart}
        return Said(words, charts)

    def _looking(self, shown: Shown | None) -> str:
        """Return the state of the display and its trigger as a sentence."""
        # the first sentence that applies: whatever prevents a window comes before the state of the trigger
        waits, count = self.scope.waits, self.scope.count
        if self.held is not None:
            return "held: the picture stands still, recording goes on"
        if self.scope.lack:
            return self.scope.lack
        if self.scope.clock != "s":
            return "the source has no clock: give the sample time; until then window and cursors count samples"
        if shown is None:
            if self.following is None:
                return "Nothing is recorded yet: choose a source and press Start."
            return "waits for the trigger" if self.trigger and waits else "nothing to show yet"
        if not self.trigger:
            return "free running: choose a trigger channel to hold it still"
        if not shown.triggered:
            return "free running until the trigger fires"
        if [*shown.channels.items()] != [*self.scope.channels.items()]:
            return "the source has other channels now; what is shown was recorded before"
        if not shown.whole and shown is self.scope.caught:
            return "triggered, but the begin of the window is no longer kept: make it shorter"
        if not shown.whole:
            return "triggered: the window fills"
        if waits and not count:
            return "waits for the trigger; what is shown is the one before"
        after = "; waits for the next one" if waits else "; press Arm for another one"
        return Text(f"triggered at {Quantity(shown.zero, 's'):6 SI} of its clock, window {count}{after}")

    def _field(self, name: str) -> dict[str, Any]:
        field = _FIELDS[name]
        unit, factor = field.declared.unit, 1.0 / field.factor
        if name in _OF_WINDOW:
            unit = self.scope.clock
        if name in _OF_CHANNEL:
            unit, factor = self._factor(self.trigger) if self.trigger else ("", 1.0)
        value = self.settings.get(name, field.default)
        text = "" if value is None else number(factor * value, 6) if isinstance(value, float) else str(value)
        return {
            "name": name,
            "label": name.replace("_", " "),
            "meaning": field.declared.meaning,
            "unit": written(unit) if field.kind is float else "",
            "options": list(field.declared.options or ()),
            "value": text,
        }

    def _channel(self, name: str) -> dict[str, Any]:
        known = self.scope.channels.get(name, "")
        unit = known or self.stated.get(name, "")
        return {
            "name": name,
            "shown": name in self._drawn(),
            "states": bool(known),
            "unit": unit,
            "in_unit": self._factor(name)[0],
            "units": _choices(unit),
        }


def _choices(unit: str) -> list[str]:
    """Return the usual units of the same dimension, including the unit itself."""
    if not unit:
        return []
    same_dimension = []
    for candidate in _UNITS:
        try:
            units.factor(unit, candidate)
        except ParameterError:
            continue
        same_dimension.append(candidate)
    return same_dimension if unit in same_dimension else [unit, *same_dimension]


def _readout_rows(read: Readout, drawn: list[Channel], clock: str) -> list[list[str]]:
    """Return the rows of the cursor table: time and each channel at cursors 1 and 2, and their difference."""
    rate = "" if read.step == 0.0 else f"; 1/Δt {number(abs(read.rate), 6)} {'Hz' if clock == 's' else 'per sample'}"
    rows = [[f"time ({clock})", number(read.a, 6), number(read.b, 6), f"{number(read.step, 6)}{rate}"]]
    for channel in drawn:
        values = [channel.factor * float(row[channel.place]) for row in (read.at_a, read.at_b, read.rise)]
        head = f"{channel.name} ({written(channel.unit)})" if channel.unit else channel.name
        rows.append([head, *(number(value, 6) if math.isfinite(value) else "nothing" for value in values)])
    return rows
