"""Pictures over time: runs, logs, moves, step responses, predictions compared with measurements, and live signals.

The picture of live signals has a panel for each unit, the trigger, and two cursors.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.analysis.friction_map import Window, set_velocity
from feeddrive.analysis.oscilloscope import Readout, Shown
from feeddrive.analysis.step_response import settling_time
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import DRAWN, USUAL, Quantity, Units, signal_unit, unit_name
from feeddrive.language.text import Text, joined
from feeddrive.loop.simulate import Run, root_mean_square
from feeddrive.plot import style
from feeddrive.plot.chart import ALERT, DASHED, NEUTRAL, PANELS, PLAIN, WIDE, Chart, Curve, Level, Mark, Panel
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import POINTS, envelope, written

if TYPE_CHECKING:
    from feeddrive.analysis.replay import Replay
    from feeddrive.analysis.step_response import StepResponse
    from feeddrive.cosimulation.simulate_with_fmu import Cosimulation
    from feeddrive.files.log import Log
    from feeddrive.files.mapping import Guess
    from feeddrive.files.preview import Preview
    from feeddrive.identification.motion.output_error import Refinement


Runs = Run | Mapping[str, Run] | Sequence[Run]


def run_chart(run: Run) -> Chart:
    """Plot the following error, force and velocity of a run."""
    velocities = [Curve(*envelope(run.time, 1e3 * set_velocity(run)), "set", NEUTRAL, DASHED, size=0.7)]
    # Optional in an FMU.
    if "velocity_load" in run.signals:
        velocities.insert(0, Curve(*envelope(run.time, 1e3 * run["velocity_load"]), "actual", 2, PLAIN))
    # a law around the velocity loop of a drive commands a velocity, shown in mm/s as the others
    leads = run.units["force"] == "m/s"
    words, unit, factor = ("commanded\nvelocity", "m/s", 1e3) if leads else ("force", "N", 1.0)
    panels = (
        Panel(
            f"following error\n({unit_name('m')})",
            (Curve(*envelope(run.time, 1e6 * run["following_error"])),),
            caption=Text(f"RMS {Quantity(root_mean_square(run['following_error']), 'm')}"),
        ),
        Panel(
            f"{words}\n({unit_name(unit)})",
            (Curve(*envelope(run.time, factor * run["force"]), number=1, look=PLAIN),),
        ),
        Panel(f"velocity\n({unit_name('m/s')})", tuple(velocities)),
    )
    return Chart("time (s)", panels, height=5.4, legend=PANELS)


run = figure_of(run_chart)


def following_error_chart(runs: Runs, window: Window | None = None, points: int = POINTS) -> Chart:
    """Plot the following error of each run in its own row, over the whole time or in a time window."""
    chosen = style.named(runs)
    values = {name: run["following_error"] for name, run in chosen.items()}
    notes = {name: _sizes(v, "m") for name, v in values.items()}
    if window is not None:
        inside = {name: _inside(run, window) for name, run in chosen.items()}
        notes = {name: Text(f"peak here {Quantity(_peak(values[name][inside[name]]), 'm')}") for name in chosen}
    values = {name: 1e6 * error for name, error in values.items()}
    chart = _rows(chosen, values, notes, f"following error ({unit_name('m')})", window, points)
    if window is None or window.reversal is None:
        return chart
    caption = "the setpoint starts off in the other direction"
    line = Level(window.reversal, upright=True, dashed=True, caption=caption)
    return replace(chart, panels=tuple(replace(panel, levels=(line,)) for panel in chart.panels))


following_error = figure_of(following_error_chart)


def force_chart(runs: Runs, limits: Mapping[str, float] | None = None, points: int = POINTS) -> Chart:
    """Plot the force of each run in its own row, with the limits in N by name as lines on both sides of zero."""
    chosen = style.named(runs)
    values = {name: run["force"] for name, run in chosen.items()}
    notes = {name: _sizes(v, "N") for name, v in values.items()}
    # One scale, since all runs are compared with the same limits.
    chart = _rows(chosen, values, notes, f"force ({unit_name('N')})", None, points, one_scale=True)
    largest = max(_peak(v) for v in values.values())
    captions = {name: Text(f"{name} ±{Quantity(limit, 'N')}") for name, limit in (limits or {}).items()}
    # a limit farther than four times the force would flatten it: it is stated in words
    near = {name: limit for name, limit in (limits or {}).items() if limit <= 4.0 * largest}
    lines = tuple(
        Level(side * limit, dashed=True, number=ALERT, caption=captions[name])
        for name, limit in near.items()
        for side in (-1.0, 1.0)
    )
    reach = 1.12 * max(near.values(), default=0.0)
    outside = joined(", ", (captions[name] for name in captions if name not in near))
    panels = [
        replace(panel, levels=lines, low=min(panel.low or 0.0, -reach), high=max(panel.high or 0.0, reach))
        for panel in chart.panels
    ]
    if outside:
        panels[-1] = replace(panels[-1], caption=Text(f"{panels[-1].caption}; outside of the picture: {outside}"))
    return replace(chart, panels=tuple(panels))


force = figure_of(force_chart)


def comparison_chart(chosen: Mapping[str, Run]) -> Chart:
    """Plot the following error of each run in its own row, and the forces of all runs in the last row."""
    errors = {name: 1e6 * run["following_error"] for name, run in chosen.items()}
    notes = {name: _sizes(run["following_error"], "m") for name, run in chosen.items()}
    above = _rows(chosen, errors, notes, "", None, POINTS).panels
    label = f"error ({unit_name('m')})"
    forces = tuple(
        Curve(*envelope(run.time, run["force"]), number=i, look=PLAIN) for i, run in enumerate(chosen.values())
    )
    panels = (*(replace(panel, label=label) for panel in above), Panel(f"force ({unit_name('N')})", forces))
    return Chart("time (s)", panels, height=0.9 + 1.45 * len(panels), legend=PANELS)


comparison = figure_of(comparison_chart)


def motion_chart(runs: Runs, points: int = POINTS) -> Chart:
    """Plot the actual and commanded velocity and acceleration of the table."""
    chosen = style.named(runs)
    first = next(iter(chosen.values()))
    velocities, accelerations = list[Curve](), list[Curve]()
    ends = list[float]()
    for i, (name, run) in enumerate(chosen.items()):
        velocity = run["velocity_load"]
        acceleration = np.gradient(velocity, run.sample_time)
        velocities.append(Curve(*envelope(run.time, 1e3 * velocity, points), name or "actual", i))
        accelerations.append(Curve(*envelope(run.time, acceleration, points), number=i))
        ends += [float(np.min(acceleration)), float(np.max(acceleration))]
    wanted = set_velocity(first)
    set_acceleration = np.gradient(wanted, first.sample_time)
    velocities.append(Curve(*envelope(first.time, 1e3 * wanted, points), "set", NEUTRAL, DASHED, size=0.7))
    accelerations.append(Curve(*envelope(first.time, set_acceleration, points), "", NEUTRAL, DASHED, size=0.7))
    # a log that starts in motion has a jump in its first set velocity, which is no acceleration of the axis
    low, high = style.padded(min(ends), max(ends))
    panels = (
        Panel(f"velocity ({unit_name('m/s')})", tuple(velocities)),
        Panel(f"acceleration ({unit_name('m/s²')})", tuple(accelerations), low=low, high=high),
    )
    return Chart("time (s)", panels, height=4.2)


motion = figure_of(motion_chart)


def _rows(
    chosen: Mapping[str, Run],
    values: Mapping[str, np.ndarray],
    notes: Mapping[str, str],
    quantity: str,
    window: Window | None,
    points: int,
    one_scale: bool = False,
) -> Chart:
    """Return a chart with one row per run over the same time, with a common scale if the peaks are similar."""
    panels, ends = list[Panel](), list[np.ndarray]()
    for i, (name, run) in enumerate(chosen.items()):
        inside = slice(None) if window is None else _inside(run, window)
        shown = values[name][inside]
        ends.append(shown)
        line = Curve(*envelope(run.time[inside], shown, points), name, i, PLAIN)
        panels.append(Panel(quantity if len(chosen) == 1 else "", (line,), caption=notes[name]))
    if one_scale or alike(ends):
        low, high = style.padded(float(min(np.min(v) for v in ends)), float(max(np.max(v) for v in ends)))
        panels = [replace(panel, low=low, high=high) for panel in panels]
    rows = len(panels)
    return Chart(
        "time (s)",
        tuple(panels),
        height=2.7 if rows == 1 else 0.7 + 1.45 * rows,
        side=quantity if rows > 1 else "",
        legend=PANELS,
    )


def alike(curves: Iterable[np.ndarray]) -> bool:
    """Return True if the peaks of the curves are similar enough for a common scale."""
    peaks = [_peak(curve) for curve in curves]
    return max(peaks) <= style.WIDE * min(peaks)


def _inside(run: Run, window: Window) -> np.ndarray:
    return (run.time >= window.begin) & (run.time <= window.end)


def _sizes(values: np.ndarray, unit: str) -> Text:
    """Return the RMS and the peak of values in SI units as text."""
    return Text(f"RMS {Quantity(root_mean_square(values), unit)}, peak {Quantity(_peak(values), unit)}")


def _peak(values: np.ndarray) -> float:
    return float(np.max(np.abs(values), initial=0.0))


def cosimulation_chart(cosimulation: Cosimulation) -> Chart:
    """Plot the following error of each law."""
    return following_error_chart({row.name: row.run for row in cosimulation.rows})


MOST = 12  # largest number of rows; of a log with more channels the first ones are shown


def log_chart(log: Log) -> Chart:
    """Plot the channels of a log versus time, each in its usual unit."""
    panels = list[Panel]()
    for name, values in list(log.channels.items())[:MOST]:
        si = log.units.get(name, "")
        unit, factor = USUAL.of(si, signal_unit(si))
        head = name.replace("_", " ")
        label = f"{head}\n({unit_name(style.written(unit))})" if unit else head
        panels.append(Panel(label, (Curve(*envelope(log.time, factor * values, POINTS)),)))
    return Chart("time (s)", tuple(panels), height=1.0 + 1.3 * len(panels))


log = figure_of(log_chart)


def guess_chart(guess: Guess) -> Chart:
    """Plot the signals of the guessed roles with their peaks. Raises ParameterError if there is no position."""
    if guess.preview is None:
        raise ParameterError(f"{guess.name}: no column is a position, so that there is no motion to show; plot the log")
    return preview_chart(guess.preview)


def preview_chart(preview: Preview) -> Chart:
    """Plot the position, speed and force over time, in the user's units, with the peaks of speed and force marked."""
    panels = list[Panel]()
    for unit, group in groupby(preview.traces, key=lambda trace: trace.unit):
        traces = list(group)
        role = traces[-1].role
        head = role if role in ("speed", "force", "torque", "command", "current") else "position"
        peak = max(traces, key=lambda trace: _peak(trace.values))
        k = int(np.argmax(np.abs(peak.values)))
        # the peak of a position depends on its origin: only those of speed and force mean something
        marks = (Mark(float(peak.time[k]), float(peak.values[k]), NEUTRAL),) if head != "position" else ()
        curves = tuple(
            Curve(trace.time, trace.values, trace.name, i, DASHED if trace.role.startswith("setpoint") else PLAIN)
            for i, trace in enumerate(traces)
        )
        written_unit = {"percent": "%", "permille": "‰"}.get(unit, unit) or "no unit"
        panels.append(Panel(f"{head}\n({written_unit})", curves, marks=marks))
    return Chart("time (s)", tuple(panels), height=1.0 + 1.5 * len(panels), legend=PANELS)


preview = figure_of(preview_chart)


# SI unit, shown unit of the signal, words
_SHOWN = {
    "position_load": ("m", "mm", "position"),
    "following_error": ("m", "", "following error"),
    "force": ("N", "", "force"),
}


def replay_chart(replay: Replay, points: int = POINTS) -> Chart:
    """Plot the measured and predicted position, following error and force, with the residuals below."""
    signals = [name for name in _SHOWN if name in replay.measured and name in replay.run.signals]
    residuals = [name for name in signals if name != "following_error"]
    rows = [(name, False) for name in signals] + [(name, True) for name in residuals]
    # the residual of the position below the following error, with which it is compared
    rows.sort(key=lambda row: (signals.index("following_error" if row == ("position_load", True) else row[0]), row[1]))
    panels, time = list[Panel](), replay.run.time
    for name, is_residual in rows:
        unit, in_unit, words = _SHOWN[name]
        if is_residual:
            off, factor = replay.residual(name), DRAWN.of(unit)[1]
            left = Curve(*envelope(time[replay.skipped :], factor * off, points), number=1, look=PLAIN, size=0.65)
            caption = Text(f"predicted - measured: {_sizes(off, unit)}")
            panels.append(Panel(f"{words}\nresidual ({unit_name(unit)})", (left,), caption=caption))
            continue
        factor = DRAWN.of(unit, in_unit)[1]
        both = (
            Curve(*envelope(time, factor * replay.measured[name], points), "measured", NEUTRAL, WIDE),
            Curve(*envelope(time, factor * replay.run[name], points), "predicted", size=0.7),
        )
        size = Quantity(root_mean_square(replay.measured[name][replay.skipped :]), unit)
        caption = "" if name == "position_load" else Text(f"measured RMS {size}")
        panels.append(Panel(f"{words}\n({unit_name(unit, in_unit)})", both, caption=caption))
    return Chart("time (s)", tuple(panels), height=0.8 + 1.45 * len(panels))


replay = figure_of(replay_chart)


def refinement_chart(refinement: Refinement) -> Chart:
    """Plot the predicted and measured signals of a refinement."""
    return replay_chart(refinement.replay)


_AFTER = 1.6  # range shown after the cut, in settling times
_LEAST = 0.01  # s: shortest range shown
_BEFORE = 0.04  # range shown before the cut, as a share of that after it
_SEEN = 1e-3  # of the step: smallest overshoot that is marked
_MS = 1e3


def moves_chart(runs: Mapping[str, Run], units: Units = DRAWN) -> Chart:
    """Plot the following error and force over a common time axis."""
    micro, newton = (units.of(unit)[1] for unit in ("m", "N"))
    errors, forces = list[Curve](), list[Curve]()
    for i, (name, run) in enumerate(runs.items()):
        error = run["following_error"]
        rms, peak = (Quantity(size, "m") for size in (np.sqrt(np.mean(error**2)), np.max(np.abs(error))))
        errors.append(Curve(run.time, micro * error, name, i, caption=Text(f"RMS {rms}, peak {peak}")))
        forces.append(Curve(run.time, newton * run["force"], number=i))
    panels = (
        Panel(f"following error ({unit_name('m')})", tuple(errors), share=2.0),
        Panel(f"force ({unit_name('N')})", tuple(forces)),
    )
    end = max(float(run.time[-1]) for run in runs.values())
    return Chart("time (s)", panels, low=0.0, high=end, height=4.2)


def step_response_chart(responses: StepResponse | Mapping[str, StepResponse]) -> Chart:
    """Plot the position after a step of the set position, with overshoot and settling time."""
    chosen = style.named(responses)
    curves, marks = list[Curve](), list[Mark]()
    end = max(_LEAST, *(_AFTER * response.settling_time for response in chosen.values()))
    for i, (name, response) in enumerate(chosen.items()):
        caption = Text(
            f"overshoot {Quantity(response.overshoot, 'share'):.1f}, "
            f"settled to {Quantity(response.settled, 'share'):6} in {Quantity(response.settling_time, 's')}"
        )
        there = response.time <= end
        curves.append(Curve(_MS * response.time[there], response.position[there], name, i, caption=caption))
        if response.overshoot > _SEEN:
            marks.append(Mark(_MS * response.overshoot_time, response.final * (1.0 + response.overshoot), i))
        marks.append(Mark(_MS * response.settling_time, _at(response), i, hollow=True))
    near = next(iter(chosen.values())).settled
    levels = Level(1.0), Level(1.0 + near, dashed=True), Level(1.0 - near, dashed=True)
    panel = Panel("position (part of the step)", tuple(curves), marks=tuple(marks), levels=levels)
    return Chart("time (ms)", (panel,), low=0.0, high=_MS * end, columns=1)


def _at(response: StepResponse) -> float:
    return float(np.interp(response.settling_time, response.time, response.position))


def snap_chart(runs: Mapping[str, Run], begin: float, near: float, units: Units = DRAWN) -> Chart:
    """Plot the table error and the force after a rope under tension on the table is cut at `begin` (s).

    near  settling tolerance of the table, m
    """
    micro, newton = (units.of(unit)[1] for unit in ("m", "N"))
    reactions = dict[str, tuple[float, float]]()
    for name, run in runs.items():
        # half a sample: k T and the instant of the cut differ by rounding
        after = run.time >= begin - 0.5 * run.sample_time
        error = run["tracking_error"][after]
        reactions[name] = float(np.max(np.abs(error))), settling_time(run.time[after] - begin, error, near)
    last = max(float(run.time[-1]) - begin for run in runs.values())
    # A law that does not settle has an infinite time: the run's end bounds the view.
    end = min(max(_LEAST, *(_AFTER * settled for _, settled in reactions.values())), last)
    errors, forces = list[Curve](), list[Curve]()
    for i, (name, run) in enumerate(runs.items()):
        peak, settled = reactions[name]
        rest = "not settled" if np.isinf(settled) else f"settled in {Quantity(settled, 's')}"
        caption = Text(f"peak {Quantity(peak, 'm')}, {rest} to ±{Quantity(near, 'm'):3}")
        there = (run.time >= begin - _BEFORE * end) & (run.time <= begin + end)
        time = _MS * (run.time[there] - begin)
        errors.append(Curve(time, micro * run["tracking_error"][there], name, i, caption=caption))
        forces.append(Curve(time, newton * run["force"][there], number=i))
    levels = Level(0.0, faint=True), Level(micro * near, dashed=True), Level(-micro * near, dashed=True)
    panels = (
        Panel(f"error of the table ({unit_name('m')})", tuple(errors), levels=levels, share=2.0),
        Panel(f"force ({unit_name('N')})", tuple(forces)),
    )
    return Chart("time after the cut (ms)", panels, low=-_MS * _BEFORE * end, high=_MS * end, height=4.2, columns=1)


SCOPE_POINTS = 960  # points of a curve, two per interval of the window, and one more in an interval with a gap
_PANEL = 1.7  # inches: height of a panel
_SPACE = 0.05  # of the range of a panel: margin above and below its curves
_LEAST_USED = 0.4  # of a panel: a range is kept while its curves use at least this share
_NAME = 14  # letters of a channel name at the axis; the legend shows the full name
_STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)

Ranges = dict[str, tuple[float, float]]
"""The range of each panel by its label."""


@dataclass(frozen=True)
class Channel:
    """A displayed channel.

    name    its name in the source
    place   index of its column among the values
    unit    displayed unit; empty if unknown
    factor  conversion factor from the unit of the source to the displayed unit
    """

    name: str
    place: int
    unit: str = ""
    factor: float = 1.0


def scope_chart(
    shown: Shown,
    channels: Sequence[Channel],
    clock: str = "s",
    *,
    level: tuple[str, float] | None = None,
    cursors: Readout | None = None,
    before: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[Chart, Ranges]:
    """Return the chart of a window, and the ranges of its panels for use as `before` in the next call.

    level  trigger channel and its level in the unit of the source

    A range is retained as long as its curves fit into it and fill a good part of it, so that the axes do not jump in a
    picture that is redrawn many times a second.
    """
    grouped: dict[str, list[Channel]] = {}
    for channel in channels:
        label = f"{written(channel.unit)}" if channel.unit else channel.name
        grouped.setdefault(label, []).append(channel)
    panels, ranges = list[Panel](), Ranges()
    for unit, group in grouped.items():
        label = f"({unit})" if group[0].unit else unit
        name = group[0].name if len(group[0].name) <= _NAME else f"{group[0].name[: _NAME - 1]}…"
        label = f"{name} {label}" if len(group) == 1 and group[0].unit else label
        panels.append(_panel(label, shown, group, [*channels], level, cursors, before or {}))
        low, high = panels[-1].low, panels[-1].high
        assert low is not None
        assert high is not None
        ranges[label] = low, high
    zero = "from the trigger" if shown.triggered else "until now"
    chart = Chart(
        f"time {zero} ({clock})", tuple(panels), low=shown.start, high=shown.end, height=_PANEL * max(len(panels), 1)
    )
    return chart, ranges


def _panel(
    label: str,
    shown: Shown,
    group: Sequence[Channel],
    all_: Sequence[Channel],
    level: tuple[str, float] | None,
    cursors: Readout | None,
    before: Mapping[str, tuple[float, float]],
) -> Panel:
    curves, levels = list[Curve](), list[Level]()
    width = 2.0 * (shown.end - shown.start) / SCOPE_POINTS
    for channel in group:
        y = channel.factor * shown.values[:, channel.place]
        whole = shown.triggered and bool(np.all(np.diff(shown.time) > 0.0)) and bool(np.all(np.isfinite(y)))
        # A triggered window is not scrolled and may be enlarged, so all of its rows are kept.
        kept = np.arange(y.size) if whole else kept_points(shown.time, y, width)
        x = shown.time[kept] - shown.zero
        # Numbered among all channels: a channel keeps its color whatever panel it shares.
        number = [one.name for one in all_].index(channel.name)
        curves.append(Curve(x, y[kept], channel.name, number, caption=_caption(y, channel.unit)))
    finite = np.concatenate([curve.y for curve in curves]) if curves else np.empty(0)
    finite = finite[np.isfinite(finite)]
    place = [channel for channel in group if level is not None and channel.name == level[0]]
    if level is not None and place:
        levels.append(Level(place[0].factor * level[1], "trigger", dashed=True))
        finite = np.append(finite, levels[0].value)
    if shown.triggered:
        levels.append(Level(0.0, upright=True, faint=True))
    if cursors is not None:
        levels += [Level(cursors.a, "1", upright=True, dashed=True), Level(cursors.b, "2", upright=True, dashed=True)]
    low, high = steady_range(finite, before.get(label))
    return Panel(label, tuple(curves), levels=tuple(levels), low=low, high=high)


def _caption(y: np.ndarray, unit: str) -> str:
    there = y[np.isfinite(y)]
    return Text(f"{Quantity(there[-1], written(unit)):5 SI}") if there.size else "nothing"


def kept_points(time: np.ndarray, y: np.ndarray, width: float) -> np.ndarray:
    """Return the indices of the points of a curve to draw: the minimum and the maximum of each interval of `width` s,
    in time order.

    Intervals begin at whole multiples of the width, so that the same points are chosen while a curve scrolls. The first
    and the last row are included, and one row per interval in gaps (NaN). All rows of a short curve are included.
    """
    if time.size <= SCOPE_POINTS:
        return np.arange(time.size)
    stretch = np.floor(time / width)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(stretch)) + 1, [time.size]])
    gap = ~np.isfinite(y)
    low = _first_of_stretch(np.where(gap, np.inf, y), edges, np.minimum)
    high = _first_of_stretch(np.where(gap, -np.inf, y), edges, np.maximum)
    gaps = np.flatnonzero(gap)
    if gaps.size:  # one row per interval
        gaps = gaps[np.diff(stretch[gaps], prepend=-np.inf) > 0.0]
    return np.unique(np.concatenate([[0], low, high, gaps, [time.size - 1]]))


def _first_of_stretch(y: np.ndarray, edges: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """Return the index of the first row in each interval at which its extreme value occurs."""
    values = extreme.reduceat(y, edges[:-1])
    met = np.flatnonzero(y == np.repeat(values, np.diff(edges)))
    return met[np.searchsorted(met, edges[:-1])]


def steady_range(y: np.ndarray, before: tuple[float, float] | None = None) -> tuple[float, float]:
    """Return a range that contains the given values and ends at round numbers, or the previous range if the values fit
    into it and fill a good part of it.
    """
    if not y.size:
        return before or (-1.0, 1.0)
    low, high = float(np.min(y)), float(np.max(y))
    # A constant has a margin of half its size on either side.
    if high == low:
        low, high = low - (0.5 * abs(low) or 1.0), high + (0.5 * abs(high) or 1.0)
    span = high - low
    # axes that follow each row would jump in every frame
    if before is not None and before[0] <= low and high <= before[1] and span >= _LEAST_USED * (before[1] - before[0]):
        return before
    low, high = low - _SPACE * span, high + _SPACE * span
    step = _round_up((high - low) / 5.0)
    return float(step * np.floor(low / step)), float(step * np.ceil(high / step))


def _round_up(step: float) -> float:
    size = 10.0 ** np.floor(np.log10(step))
    # Rounding must not push a step that is already round to the next one.
    return float(next(multiple for multiple in _STEPS if step <= multiple * size * (1.0 + 1e-9)) * size)
