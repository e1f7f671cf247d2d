"""The Tune page: manual tuning of parameters, with live pictures and verdicts and stored controllers to compare."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np

from feeddrive.analysis.margins import Margins
from feeddrive.figures.of_loops import COMPLIANCE_PEAK, GAIN_MARGIN, PHASE_MARGIN, SENSITIVITY_PEAK, STIFFNESS_LEAST
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.quantity import CHOICES, DRAWN, Quantity, Units, number
from feeddrive.language.text import joined, resolve
from feeddrive.language.tree import check_sampled
from feeddrive.language.units import rounded, turning
from feeddrive.loop.control import Control
from feeddrive.plot.chart import ALERT, FREQUENCY, LOG, Band, Chart, Disc, Level, Mark, Note
from feeddrive.report.svg import svg_file
from feeddrive.studio.desk import Asked, Desk, Held, Room, Said, Values, act
from feeddrive.studio.history import History
from feeddrive.studio.pictures import PICTURES, USUAL, HeldPoles, Parts, as_in_report, charts, choices
from feeddrive.studio.strip import LIMITED, strip, verdict_line, with_limit
from feeddrive.tuning import filters
from feeddrive.tuning.by_hand import ByHand, Knob, Look, Verdict
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.scaling import quickened, speed_powers, speed_range


def verdict_words(look: Look, limits: Limits, units: Units) -> list[dict[str, Any]]:
    """Return a sentence for each limit, and True if the limit is satisfied; the most critical limit comes first."""
    several, sentences = len(look.figures) > 1, list[dict[str, Any]]()
    for verdict in look.judged:
        where = f" ({verdict.point})" if several else ""
        at = "" if verdict.frequency is None else f" at {units.value_text(verdict.frequency, 'Hz')}"
        text = f"{verdict.judged.text}{at}{where}, limit: {limits.text(verdict.judged.limit)}"
        sentences.append({"text": resolve(text, units), "keeps": verdict.keeps})
    return sentences


def figure_words(look: Look, units: Units) -> str:
    """Return the crossover, margins and minimum stiffness of the worst operating point, with their frequencies."""
    leading, parts = look.leading, list[str]()
    margins = leading.margins
    if margins.crossover is not None:
        # of several crossovers the least margin need not be at the first one
        least = min(margins.gain_crossovers, key=lambda crossing: abs(crossing.phase_margin_deg))
        where = "" if least is margins.gain_crossovers[0] else f" at {Quantity(least.frequency, 'Hz')}"
        phase = Quantity(least.phase_margin_deg, "deg", form="3")
        parts.append(f"crossover {Quantity(margins.crossover, 'Hz')}, phase margin {phase}{where}")
    if margins.gain_increase_dB is not None:
        parts.append(f"the gain may rise by {units.gain_text(margins.gain_increase_dB)}")
    if look.stable:
        stiff = leading.stiffness
        against = " against a force at the drive" if leading.at_drive else ""
        least, where = Quantity(stiff.minimum, "N/m"), Quantity(stiff.minimum_frequency, "Hz")
        parts.append(f"least stiffness{against} {least} at {where}")
    return joined("; ", parts).shown(units)


def with_verdicts(drawn: Mapping[str, Chart], look: Look, limits: Limits, units: Units) -> dict[str, Chart]:
    """Add the limits of Ms, stiffness and phase margin to the pictures, and mark violated limits.

    A limit is a line with its words; the forbidden side of it is tinted.
    """
    charts = dict(drawn)
    if (peak := limits.limit(SENSITIVITY_PEAK)) is not None and "sensitivity" in charts:
        at = _gain(units, peak.bound)
        line = Level(at, f"Ms at most {number(peak.bound, 3)}", number=ALERT)
        first, *rest = charts["sensitivity"].panels
        highest = max(float(np.nanmax(curve.y)) for curve in first.curves)
        ends = _gain(units, _SMALLEST), max(_gain(units, _ROOM * peak.bound), highest + 0.1 * abs(highest))
        first = replace(first, low=ends[0], high=ends[1])
        chart = replace(charts["sensitivity"], panels=(first, *rest))
        charts["sensitivity"] = _limited(chart, 0, line, at, _FAR)
    if (peak := limits.limit(SENSITIVITY_PEAK)) is not None and "nyquist" in charts:
        panel = charts["nyquist"].panels[0]
        disc = Disc(-1.0, 0.0, 1.0 / peak.bound, ALERT, filled=True)
        charts["nyquist"] = replace(charts["nyquist"], panels=(replace(panel, discs=(*panel.discs, disc)),))
    if (largest := limits.bound(COMPLIANCE_PEAK)) is not None and "stiffness" in charts:
        at = units.of("N/m")[1] / largest
        text = resolve(f"at least {units.value_text(1.0 / largest, 'N/m')}", units)
        charts["stiffness"] = _limited(charts["stiffness"], 0, Level(at, text, number=ALERT), 0.0, at)
    if (phase := limits.bound(PHASE_MARGIN)) is not None and "open_loop" in charts:
        chart, text = charts["open_loop"], f"closer than {number(phase, 3)}° to -180°"
        charts["open_loop"] = _limited(chart, 1, Level(-180.0, text), -180.0 - phase, phase - 180.0)
    for verdict in look.judged if look.stable else ():
        place = _place(verdict, units)
        if not verdict.keeps and place is not None and place[0] in charts and verdict.point == look.leading.point:
            name, x, y = place
            note = Note(x, y, verdict.judged.text.shown(units), ALERT)
            mark = Mark(x, y, ALERT)
            first, *rest = charts[name].panels
            first = replace(first, notes=(*first.notes, note), marks=(*first.marks, mark))
            charts[name] = replace(charts[name], panels=(first, *rest))
    return charts


_LEAST_PEAK = 1.02  # of a limit of Ms that is dragged
_FAR = 1e4  # beyond all panels
_SMALLEST, _ROOM = 0.01, 4.0  # of |S|: what is in view at first, and of the limit of Ms above it


def _limited(chart: Chart, i: int, line: Level, low: float, high: float) -> Chart:
    """Add the line of a limit to a panel, and tint the side from low to high that it forbids."""
    panel = chart.panels[i]
    x = np.concatenate([curve.x[np.isfinite(curve.x)][[0, -1]] for curve in panel.curves if curve.name or i])
    ends = np.array([np.min(x), np.max(x)])
    # a logarithmic axis has no 0
    low = max(low, 1e-9) if panel.scale == LOG else low
    band = Band(ends, np.full(2, low), np.full(2, high), ALERT)
    panel = replace(panel, levels=(*panel.levels, line), bands=(band, *panel.bands))
    return replace(chart, panels=(*chart.panels[:i], panel, *chart.panels[i + 1 :]))


def _gain(units: Units, ratio: float) -> float:
    return float(units.from_decibel(20.0 * float(np.log10(ratio))))


def _read(text: str, title: str) -> float:
    try:
        # a decimal comma is what many users type
        return float(text.replace(",", "."))
    except ValueError:
        raise ParameterError(f"the limit of {title} must be a number, not '{text:.40}'") from None


def _place(verdict: Verdict, units: Units) -> tuple[str, float, float] | None:
    """Return the picture that shows the figure of a verdict, and the position of the figure in its first panel.

    The result is None if the figure has no value or frequency.
    """
    value = verdict.judged.value
    if value is None or verdict.frequency is None:
        return None
    x = units.of("Hz")[1] * verdict.frequency
    figure = verdict.judged.figure
    if figure == SENSITIVITY_PEAK:
        return "sensitivity", x, _gain(units, value)
    if figure == COMPLIANCE_PEAK:
        return "stiffness", x, units.of("N/m")[1] / value
    # a gain margin is read at |L| below 0 dB, a phase margin at the crossover, 0 dB
    return "open_loop", x, float(units.from_decibel(-value if figure == GAIN_MARGIN else 0.0))


TODAY, NOW = "today", "now"
SNAPSHOTS = ("A", "B", "C")
_BELOW, _ABOVE = 16.0, 25.0  # times the crossover of today: what the pictures over the frequency show at first
_SEEN = 40.0  # dB: a larger gain margin limits no gain
_SLOWER = np.geomspace(1.0, 0.1, 25)[1:]  # of the crossover: where a loop that keeps all limits is looked for
_OF_LOOPS = ("open_loop", "sensitivity", "stiffness")
_REACH = 10.0  # times the crossover of today: the slider of the loop as a whole
# keys that are held, and turns of the wheel, arrive as one request with many steps
_STEPS = 100
_MOST_STEPS = 200  # of the history at once
# simulates the run on a second core while the loop is evaluated
_BESIDE = ThreadPoolExecutor(thread_name_prefix="run")


class _Seen(NamedTuple):
    """An evaluation of a controller with its simulations, cached until blocks, parameters or limits change."""

    by_hand: ByHand
    values: Values
    limits: Limits
    look: Look
    parts: Parts


class Tune(Room):
    """The page for manual tuning of the controller's parameters."""

    name = "tune"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.chosen, self.units = USUAL, DRAWN  # pictures and units stay with another source
        self.begin()

    def begin(self) -> None:
        """Clear the cache of the previous source."""
        self.snapshots: dict[str, Held] = {}
        self._seen: dict[str, _Seen] = {}
        self._poles = HeldPoles(self.desk)
        self._history = History(self.desk)
        self._from: tuple[Control, Values, float] | None = None  # where a drag of the whole loop began
        self._told: ByHand | None = None  # whose numbers the page knows

    def show(self) -> Said:
        """Return the parameters with their declarations, and the pictures."""
        if self.desk.bench is None:
            return Said({"knobs": []})
        self._told = None
        return self._pictures()

    @act
    def see(self, asked: Asked) -> Said:
        """Select the pictures to draw; nothing is computed for the others."""
        wanted = asked.texts("names")
        for picture in wanted:
            if picture not in PICTURES:
                raise ParameterError(f"there is no picture '{picture:.60}': there are {', '.join(PICTURES)}")
        self.chosen = tuple(name for name in PICTURES if name in wanted)
        self._told = None
        return self._pictures()

    @act
    def unit(self, asked: Asked) -> Said:
        """Choose the unit of lengths, forces, frequencies or gains."""
        kind = asked.choice("kind", CHOICES)
        self.units = replace(self.units, **{kind: asked.choice("unit", CHOICES[kind])})
        self._told = None
        return self._pictures()

    def do(self, name: str, asked: Asked) -> Said:
        """Run an action; if it fails, restore the previous controller."""
        try:
            with self.desk.tried():
                return super().do(name, asked)
        except FeeddriveError:
            raise
        except (ArithmeticError, ValueError):
            # from numpy and scipy: the fields accept numbers of any size
            raise ParameterError(
                "the loop cannot be computed with these numbers: take some nearer to those of before, which stand again"
            ) from None

    @act
    def move(self, asked: Asked) -> Said:
        """Set one parameter; `first` starts a drag, which is undone as a whole."""
        name, value, values = asked.text("name"), asked.number("value"), self.desk.values
        # depth and width of a notch are no numbers of the control: they stand for its two dampings
        fresh = {name: value} if name in values else filters.notch_shaped(self.desk.control, name, value)
        self.desk.change({**values, **fresh}, begins=asked.yes("first", True))
        return self._pictures()

    @act
    def undo(self, _: Asked) -> Said:
        """Undo a step."""
        self.desk.back()
        return self._pictures()

    @act
    def redo(self, _: Asked) -> Said:
        """Redo an undone step."""
        self.desk.again()
        return self._pictures()

    @act
    def reset(self, _: Asked) -> Said:
        """Restore the reference controller."""
        self.desk.take(self.desk.needed.before.start)
        return self._pictures()

    @act
    def add(self, asked: Asked) -> Said:
        """Add a filter at the requested frequency in Hz, or where the loop is likely to need it."""
        T, at = self._sample_time, asked.number_or_none("at")
        if at is not None and not at > 0.0:
            raise ParameterError(f"the frequency of a filter must be > 0 Hz, not {Quantity(at, 'Hz'):6}")
        filter_ = filters.begun_filter(asked.choice("kind", filters.filter_kinds()), self._now.leading.margins, T, at)
        check_sampled(filter_, T)
        self.desk.exchange(filters.with_filters(self.desk.control, (), (filter_,)))
        return self._pictures()

    @act
    def remove(self, asked: Asked) -> Said:
        """Remove a filter, by its index."""
        self.desk.exchange(filters.with_filters(self.desk.control, (asked.whole("place"),), ()))
        return self._pictures()

    @act
    def drag(self, asked: Asked) -> Said:
        """Drag a filter in the open-loop picture to a frequency in Hz and, if `y` is given, to a gain as displayed."""
        name, y = asked.text("name"), asked.number_or_none("y")
        y = None if y is None else self.units.to_decibel(y)
        loop = self._now.leading.margins
        x, off = asked.number("x"), self.desk.off
        return self._moved(filters.filter_dragged(self.desk.control, name, x, y, loop, self._sample_time, off), asked)

    def _moved(self, values: Mapping[str, float], asked: Asked) -> Said:
        """Move a filter by its handle; one that is off changes nothing but its own numbers."""
        begins = asked.yes("first", True)
        if any(name.startswith(f"{filters.OFF}.") for name in values):
            self.desk.change_off(values, begins=begins)
        else:
            self.desk.change({**self.desk.values, **values}, begins=begins)
        return self._pictures()

    @act
    def step(self, asked: Asked) -> Said:
        """Move a filter with the keyboard, in horizontal and vertical steps."""
        loop, steps = self._now.leading.margins, (asked.number("across"), asked.number("up"))
        if max(map(abs, steps)) > _STEPS:
            raise ParameterError(f"a filter is moved by at most {_STEPS} steps at once")
        name, off = asked.text("name"), self.desk.off
        return self._moved(filters.filter_stepped(self.desk.control, name, *steps, loop, self._sample_time, off), asked)

    @act
    def pole(self, asked: Asked) -> Said:
        """Drag a pole in the pole map to an abscissa in Hz and, if `y` is given, an ordinate in the displayed unit."""
        _, factor = self.units.of("Hz")
        name, up = asked.text("name"), asked.number_or_none("y")
        height = self._poles.at(name).imag if up is None else 2.0 * np.pi * up / factor
        values = self._poles.moved(name, complex(2.0 * np.pi * asked.number("x"), height))
        self.desk.change({**self.desk.values, **values}, begins=asked.yes("first", True))
        return self._pictures()

    @act
    def pole_step(self, asked: Asked) -> Said:
        """Move a pole with the keyboard, in horizontal and vertical steps."""
        steps = asked.number("across"), asked.number("up")
        if max(map(abs, steps)) > _STEPS:
            raise ParameterError(f"a pole is moved by at most {_STEPS} steps at once")
        values = self._poles.stepped(asked.text("name"), *steps)
        self.desk.change({**self.desk.values, **values}, begins=asked.yes("first", True))
        return self._pictures()

    @act
    def speed(self, asked: Asked) -> Said:
        """Scale the bandwidth of the whole loop to a requested crossover in Hz.

        The loop reaches this crossover exactly only if its plant behaves as a free mass.
        """
        wanted, first = asked.number("value"), asked.yes("first", True)
        if not wanted > 0.0:
            raise ParameterError(f"the crossover must be > 0 Hz, not {Quantity(wanted, 'Hz'):6}")
        if first or self._from is None:
            crossover = self._now.leading.margins.crossover
            if crossover is None:
                raise ParameterError("|L| crosses 1 nowhere: move the numbers one by one until it does")
            self._from = self.desk.control, self.desk.values, crossover
        # always from the start of the drag: factors of single steps would accumulate rounding errors
        control, values, crossover = self._from
        low, high = speed_range(control, self._sample_time)
        scaled = quickened(control, min(max(wanted / crossover, low), high))
        changed = {name: rounded(value, 7) for name, value in scaled.items()}
        self.desk.change({**values, **changed}, begins=first)
        return self._pictures()

    @act
    def go(self, asked: Asked) -> Said:
        """Undo several steps, or redo them if the count is negative: to a place in the history."""
        count = asked.whole("steps")
        if abs(count) > _MOST_STEPS:
            raise ParameterError(f"steps must be from -{_MOST_STEPS} to {_MOST_STEPS}, not {count}")
        for _ in range(abs(count)):
            (self.desk.back if count > 0 else self.desk.again)()
        return self._pictures()

    @act
    def switch(self, asked: Asked) -> Said:
        """Take a filter out of the loop, or put one that was taken out back as the last filter; its numbers stay."""
        self.desk.switch(asked.whole("place"), on=asked.yes("on"))
        return self._pictures()

    @act
    def forget(self, asked: Asked) -> Said:
        """Remove a filter that was switched off."""
        self.desk.forget(asked.whole("place"))
        return self._pictures()

    @act
    def limit(self, asked: Asked) -> Said:
        """Set a limit, which is that of the goal too: as written, or at the height to which its line was dragged.

        figure  key of a figure of the strip
        value   what was written, in the displayed unit; an empty text for no limit of one's own
        height  instead of a value: an ordinate in the picture of the figure
        """
        gauge, height = LIMITED[asked.choice("figure", LIMITED)], asked.number_or_none("height")
        factor = self.units.of(gauge.figure.unit)[1]
        if height is None:
            text = asked.text("value").strip()
            bound = _read(text, gauge.title) / factor if text else None
        elif gauge.figure == SENSITIVITY_PEAK:
            # the exponent is capped, since a power beyond 308 overflows; an Ms of 1 or less is no valid limit
            decibel = self.units.to_decibel(height)
            bound = rounded(max(10.0 ** min(decibel / 20.0, 300.0), _LEAST_PEAK), 3)
        else:
            bound = rounded(height, 3) / factor
        self.desk.aim(with_limit(self.desk.goal, gauge, bound))
        return self._pictures()

    def _levels(self, drawn: Mapping[str, Chart]) -> list[dict[str, Any]]:
        """Return the limits whose lines can be dragged, each with the key of its figure, its picture and its height."""
        limits, units = self.desk.limits, replace(self.units, rotary=self.desk.needed.rotary)
        levels = list[dict[str, Any]]()
        if (peak := limits.bound(SENSITIVITY_PEAK)) is not None and "sensitivity" in drawn:
            text = f"Ms at most {number(peak, 3)}"
            level = {"field": SENSITIVITY_PEAK.key, "picture": "sensitivity", "at": _gain(units, peak), "text": text}
            levels.append(level)
        if (largest := limits.bound(COMPLIANCE_PEAK)) is not None and "stiffness" in drawn:
            text = resolve(f"least stiffness at least {units.value_text(1.0 / largest, 'N/m')}", units)
            at = units.of("N/m")[1] / largest
            levels.append({"field": STIFFNESS_LEAST.key, "picture": "stiffness", "at": at, "text": text})
        return levels

    @act
    def remedy(self, _: Asked) -> Said:
        """Look for the highest crossover, slower than the present one, at which the loop keeps all limits."""
        control, crossover = self.desk.control, self._now.leading.margins.crossover
        if crossover is None or not speed_powers(control) or self._keeps(self.desk.values):
            return Said({"remedy": None})
        low = speed_range(control, self._sample_time)[0]
        for factor in _SLOWER[low < _SLOWER]:
            wanted = rounded(float(factor) * crossover, 3)
            scaled = quickened(control, wanted / crossover)
            if self._keeps({**self.desk.values, **{name: rounded(value, 7) for name, value in scaled.items()}}):
                text = resolve(
                    f"With a crossover of {self.units.value_text(wanted, 'Hz')} all limits are kept.", self.units
                )
                return Said({"remedy": {"crossover": wanted, "text": text}})
        return Said({"remedy": None})

    def _keeps(self, values: Values) -> bool:
        look = self.desk.needed.by_hand.at(values, self.desk.limits)
        return look.stable and all(each.keeps for each in look.judged)

    @act
    def keep(self, asked: Asked) -> Said:
        """Store the current controller under a letter."""
        self.snapshots[asked.choice("letter", SNAPSHOTS)] = self.desk.held()
        return self._pictures()

    @act
    def take(self, asked: Asked) -> Said:
        """Restore a stored controller snapshot."""
        letter = asked.choice("letter", SNAPSHOTS)
        if letter not in self.snapshots:
            raise ParameterError(f"nothing was kept as {letter} yet")
        self.desk.restore(self.snapshots[letter])
        return self._pictures()

    @act
    def drop(self, asked: Asked) -> Said:
        """Delete a stored controller snapshot."""
        self.snapshots.pop(asked.choice("letter", SNAPSHOTS), None)
        return self._pictures()

    @act
    def file(self, _: Asked) -> Said:
        """Export the machine file with the current parameters."""
        bench = self.desk.needed
        return Said(
            {"file": bench.text(self.desk.values), "file_name": bench.machine.file.name if bench.machine else ""}
        )

    @act
    def svg(self, asked: Asked) -> Said:
        """Draw a picture as a report does, for a file or the clipboard; the page sends what it hides, and the view."""
        name = asked.choice("name", self.chosen)
        chart = self._charts()[1].get(name)
        if chart is None:
            raise ParameterError(f"the picture '{PICTURES[name].title}' is not drawn for this axis")
        low, high = asked.number_or_none("low"), asked.number_or_none("high")
        if low is not None and high is not None and not low < high:
            raise ParameterError("the view of a picture must end above its beginning")
        drawn = as_in_report(chart, asked.texts("hidden"), low, high)
        return Said({"svg": {"name": name, "text": svg_file(drawn, PICTURES[name].title), "how": asked.text("how")}})

    @property
    def _now(self) -> Look:
        return self._look(NOW, self.desk.needed.by_hand, self.desk.values).look

    def _charts(self) -> tuple[dict[str, _Seen], dict[str, Chart]]:
        """Return the controllers that are compared, evaluated, and the chosen pictures of them."""
        bench, values = self.desk.needed, self.desk.values
        seen = {TODAY: self._look(TODAY, bench.before, bench.before.values)}
        seen |= {
            letter: self._look(letter, kept.bench.by_hand, kept.values)
            for letter, kept in sorted(self.snapshots.items())
        }
        # last, so that it is drawn above the others, and `_response` finds the current control at the end
        seen[NOW] = self._look(NOW, bench.by_hand, values)
        looks, parts = ({name: getattr(entry, what) for name, entry in seen.items()} for what in ("look", "parts"))
        drawn = charts(bench, looks, parts, self.chosen, self.units)
        units = replace(self.units, rotary=bench.rotary)
        drawn = with_verdicts(drawn, seen[NOW].look, self.desk.limits, units)
        return seen, self._around_crossover(drawn, seen[TODAY].look)

    def _pictures(self) -> Said:
        bench, values, limits = self.desk.needed, self.desk.values, self.desk.limits
        seen, drawn = self._charts()
        now, units = seen[NOW].look, replace(self.units, rotary=bench.rotary)
        margins = now.leading.margins
        headline, sentence = verdict_line(now, limits, units)
        answer = {
            "strip": strip(now, seen[TODAY].look, limits, units),
            "levels": self._levels(drawn),
            "headline": headline,
            "sentence": sentence,
            "history": self._history.steps(units),
            "off": [filters.filter_text(block, units) for block in self.desk.off],
            "judged": verdict_words(now, limits, units),
            "figures": figure_words(now, units),
            "grips": self._grips(margins),
            "speed": margins.crossover,
            "remarks": bench.remarks,
            "places": len(bench.by_hand.points),
            "leading": now.leading.point,
            "stable": now.stable,
            "values": values,
            "shapes": filters.notch_shapes(self.desk.control),
            "undo": len(self.desk.undo),
            "redo": len(self.desk.redo),
            "kept": sorted(self.snapshots),
        }
        if "poles" in drawn:
            answer |= dict(zip(("poles", "poles_said"), self._poles.shown(self.units), strict=True))
        # declarations change only with the blocks: a drag sends numbers alone
        if self._told is not bench.by_hand:
            answer |= {
                "knobs": self._knobs(),
                "kinds": filters.filter_kinds(),
                "faster": self._faster(),
                "pictures": choices(bench, self.chosen),
                "units": self._units(),
            }
            self._told = bench.by_hand
        return Said(answer, drawn)

    def _around_crossover(self, drawn: Mapping[str, Chart], today: Look) -> dict[str, Chart]:
        """Let the pictures over the frequency begin with the part around the crossover of today."""
        crossover = today.leading.margins.crossover
        if crossover is None or not today.leading.stable:
            return dict(drawn)
        factor = self.units.of("Hz")[1]
        # and as far as a resonance could limit the gain
        margins = [each.frequency for each in today.leading.margins.phase_crossovers if each.gain_margin_dB < _SEEN]
        lowest, highest = crossover / _BELOW, max(_ABOVE * crossover, 2.0 * max(margins, default=0.0))

        def near(name: str, chart: Chart) -> Chart:
            if name not in _OF_LOOPS or chart.scale != FREQUENCY or chart.low is None or chart.high is None:
                return chart
            panels = chart.panels
            if name == "open_loop":
                # the gain follows what is in view
                panels = (replace(panels[0], low=None, high=None), *panels[1:])
            low, high = max(chart.low, factor * lowest), min(chart.high, factor * highest)
            return replace(chart, panels=panels, low=low, high=high)

        return {name: near(name, chart) for name, chart in drawn.items()}

    def _look(self, name: str, by_hand: ByHand, values: Values) -> _Seen:
        known, limits = self._seen.get(name), self.desk.limits
        # identity, since another bench may have equal values
        if known is None or known[0] is not by_hand or known[1:3] != (values, limits):
            control = by_hand.control(values)
            parts = Parts(self.desk.needed, control, name)
            running = _BESIDE.submit(lambda: "run" in self.chosen and parts.run)
            look = by_hand.at(values, limits)
            running.result()
            known = self._seen[name] = _Seen(by_hand, dict(values), limits, look, parts)
        return known

    def _grips(self, loop: Margins) -> list[dict[str, Any]]:
        """Return the handles of the filters: frequency in Hz, and ordinate in the picture."""
        grips = filters.filter_grips(self.desk.control, loop, self._sample_time, self.desk.off)
        return [{**asdict(grip), "y": float(self.units.from_decibel(grip.y))} for grip in grips]

    def _units(self) -> list[dict[str, Any]]:
        """Return the selectable units for each kind of quantity."""
        rotary = self.desk.needed.rotary
        return [
            {
                "kind": kind,
                "chosen": getattr(self.units, kind),
                "among": [[unit, turning(unit) if rotary else unit] for unit in among],
            }
            for kind, among in CHOICES.items()
        ]

    @property
    def _sample_time(self) -> float:
        return self.desk.needed.by_hand.points[0].sample_time

    def _faster(self) -> dict[str, Any]:
        """Return the data of the bandwidth slider: its range of crossovers, Hz, and the parameters that it scales."""
        today = self.desk.needed.before
        names = list(speed_powers(self.desk.control))
        crossover = self._look(TODAY, today, today.values).look.leading.margins.crossover
        if not names or crossover is None:
            why = "no number of the law is a rate or a gain with a unit" if not names else "|L| crosses 1 nowhere"
            return {"low": 1.0, "high": 2.0, "meaning": f"The loop cannot be made faster as a whole: {why}."}
        moved = f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
        meaning = f"Moves {moved}, each with the power of 1/s in its unit; filters, feedforward and models stay."
        return {"low": crossover / _REACH, "high": crossover * _REACH, "meaning": meaning}

    def _knobs(self) -> list[dict[str, Any]]:
        """Return the data of each parameter for the page, in the displayed units.

        A notch has a depth and a width in place of its dampings, which stay as `exact` ones.
        """
        by_hand, rows = self.desk.needed.by_hand, list[dict[str, Any]]()
        shapes = filters.notch_shapes(by_hand.control(by_hand.values))
        for knob in by_hand.knobs:
            held, _, field = knob.name.rpartition(".")
            exact = f"{held}.{filters.DEPTH}" in shapes and field.startswith("damping")
            rows.append(self._row(knob, exact))
            if f"{held}.{filters.DEPTH}" in shapes and field == "frequency":
                rows += self._shape_rows(held, knob, shapes)
        return rows

    def _row(self, knob: Knob, exact: bool) -> dict[str, Any]:
        law, rotary = self.desk.control.law, self.desk.needed.rotary
        declared = knob.declared.of_axis(rotary)
        unit, factor = replace(self.units, rotary=rotary).of(knob.declared.unit)
        return {
            "name": knob.name,
            "block": knob.block,
            "title": law.title if knob.block == law.kind and law.title else knob.block.replace("_", " "),
            "unit": unit,
            "factor": factor,
            "low": knob.low,
            "high": knob.high,
            "logarithmic": knob.logarithmic,
            "meaning": declared.meaning,
            "today": knob.value,
            "dragged": knob.declared.unit == "Hz" and knob.name.startswith("filters."),
            "exact": exact,
        }

    def _shape_rows(self, held: str, knob: Knob, shapes: Mapping[str, float]) -> list[dict[str, Any]]:
        """Return depth and width of a notch as rows below that of its frequency."""
        frequency = {**self._row(knob, exact=False), "dragged": False}
        low, high = filters.width_range(knob.value)
        depth, width = (f"{held}.{part}" for part in (filters.DEPTH, filters.WIDTH))
        return [
            {
                **frequency,
                "name": depth,
                "unit": "dB",
                "factor": 1.0,
                "low": 0.0,
                "high": filters.DEEPEST,
                "logarithmic": False,
                "meaning": "attenuation at the center; the width stays",
                "today": shapes[depth],
            },
            {
                **frequency,
                "name": width,
                "low": low,
                "high": high,
                "logarithmic": True,
                "meaning": "between the two edges, where a deep notch attenuates by 3 dB; the depth stays",
                "today": shapes[width],
            },
        ]
