"""Pictures of machining: circular tests and their causes, reversals, axis loads, stability lobes, signs of chatter."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.quantity import USUAL, Quantity, signal_unit, unit_name
from feeddrive.language.text import Text, joined
from feeddrive.machining.circle_test import CirclePath, CircleTest, QuadrantPeak, deviations, quadrant_peaks, same_feed
from feeddrive.machining.held_tip import DIRECTIONS
from feeddrive.plot import chart, style
from feeddrive.plot.chart import Abscissa, Band, Box, Chart, Curve, Disc, Level, Mark, Note, Panel
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import POINTS, envelope

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feeddrive.machining.circle_test import CircleCauses
    from feeddrive.machining.cutting_force import CuttingForces
    from feeddrive.machining.held_tip import HeldTip
    from feeddrive.machining.load import AxisLoad
    from feeddrive.machining.lobes import ChatterSigns, CutStability, Lobes
    from feeddrive.machining.reversal import Reversal, Reversals


_DIVISIONS = 4  # divisions between the nominal circle and the edge of the picture
_RING = 6.0  # divisions from the center to the nominal circle
_STEPS = (1.0, 2.0, 5.0, 10.0)
_NEAR = 10.0  # degrees: range of a detail around a reversal
_QUADRANTS = ((0.0, "+{}"), (90.0, "+{}"), (180.0, "-{}"), (270.0, "-{}"))
_HEAD = (0.45, 0.22)  # length and half width of an arrowhead, divisions


def _rows(test: CircleTest) -> list[tuple[CirclePath, np.ndarray, np.ndarray]]:
    """Return the circles with polar angle in degrees, 0 to 360, and radial deviation in µm, in order of the motion."""
    rows = zip(test.circles, deviations(test), strict=True)
    return [(circle, np.degrees(angle), 1e6 * r) for circle, (angle, r) in rows]


def _like(circle: CirclePath, test: CircleTest) -> int:
    """Return the index of the circle in a test that has the same direction and feed; the number of circles if there is
    none.
    """
    there = (i for i, e in enumerate(test.circles) if e.direction == circle.direction and same_feed(e, circle))
    return next(there, len(test.circles))


def circle_test_chart(test: CircleTest, division: float | None = None, remark: str = "") -> Chart:
    """Plot a circular test in both directions: the radial deviations, enlarged, on the nominal circle, with a box of
    key figures.

    division  µm per division; default: the smallest of 1, 2, 5, 10 ... that shows all deviations. Use the same value
              for all plots to be compared
    remark    date, place, state of compensation: a line in the box
    """
    size = _scale([test]) if division is None else division
    return replace(circle_chart(test, division=size), beside=_box(test, size, remark))


circle_test = figure_of(circle_test_chart)


def circle_chart(test: CircleTest, before: CircleTest | None = None, division: float | None = None) -> Chart:
    """Plot a circular test without the box: the deviation in µm is drawn as the distance from the nominal circle.

    before  an earlier test of the same circles, drawn thin
    """
    rows, old = _rows(test), [] if before is None else _rows(before)
    per_division = _scale([test] if before is None else [test, before]) if division is None else division
    ring, edge = _RING * per_division, (_RING + _DIVISIONS + 0.5) * per_division
    curves, marks = list[Curve](), list[Mark]()
    for circle, angle, r in old:
        curves.append(Curve(*_closed(ring + r, angle), number=_like(circle, test), look=chart.THIN))
    for i, (circle, angle, r) in enumerate(rows):
        x, y = _closed(ring + r, angle)
        curves.append(Curve(x, y, circle.name, i, caption=_gap(circle, test, before)))
        marks.append(Mark(float(x[0]), float(y[0]), i, caption=f"{circle.name} begins"))
        # at different places for both directions, so that neither arrowhead covers the other
        k = len(r) // 8 + (0 if circle.direction > 0 else 3)
        curves.append(_arrow(float(ring + r[k]), float(np.radians(angle[k])), circle.direction, per_division, i))
    marks += [_peak(peak, ring) for peak in quadrant_peaks(test)]
    rings = tuple(Disc(0.0, 0.0, ring + k * per_division, faint=k != 0) for k in range(-_DIVISIONS, _DIVISIONS + 1))
    at = [np.radians(angle) for angle, _ in _QUADRANTS]
    axes = [text.format(test.circles[0].axes[k % 2].upper()) for k, (_, text) in enumerate(_QUADRANTS)]
    notes = [
        Note(edge * float(np.cos(a)), edge * float(np.sin(a)), text, middle=True)
        for a, text in zip(at, axes, strict=True)
    ]
    thin = "" if before is None else "\nthin: before"
    notes.append(
        Note(
            0.0,
            0.0,
            Text(
                f"rings: {Quantity(1e-6 * per_division, 'm'):6}\n"
                f"deviation × {Quantity(1e6 * test.radius / ring):.0f}{thin}"
            ),
            middle=True,
        )
    )
    side = edge + 0.6 * per_division
    panel = Panel(
        f"y ({unit_name('um')})", tuple(curves), tuple(marks), discs=rings, notes=tuple(notes), low=-side, high=side
    )
    return Chart(
        f"x ({unit_name('um')})", (panel,), low=-side, high=side, square=True, bare=True, height=6.2, columns=2
    )


def _scale(tests: Sequence[CircleTest]) -> float:
    """Return the µm per division that makes all deviations of the tests visible."""
    return _division(max(float(np.max(np.abs(r))) for test in tests for _, _, r in _rows(test)) / _DIVISIONS)


def _closed(place: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = place * np.cos(np.radians(angle)), place * np.sin(np.radians(angle))
    return np.append(x, x[0]), np.append(y, y[0])


def _peak(peak: QuadrantPeak, ring: float) -> Mark:
    """Return the mark of a quadrant peak on the drawn circle."""
    r = ring + 1e6 * peak.deviation
    caption = Text(f"peak {Quantity(peak.height, 'm'):3} behind {peak.side}{peak.axis}")
    return Mark(float(r * np.cos(peak.angle)), float(r * np.sin(peak.angle)), peak.circle, True, caption=caption)


def _gap(circle: CirclePath, test: CircleTest, before: CircleTest | None) -> str:
    """Return the circularity G of a circle and its earlier value, as text."""
    figures = [figure for figure in test.figures if not figure.both]
    caption = Text(f"G {Quantity(figures[test.circles.index(circle)].G, 'm')}")
    if before is None or (i := _like(circle, before)) == len(before.circles):
        return caption
    return Text(f"{caption}, before {Quantity([figure for figure in before.figures if not figure.both][i].G, 'm')}")


def _arrow(radius: float, angle: float, direction: int, division: float, number: int) -> Curve:
    """Return an arrowhead along the circle, in the direction of motion."""
    long, wide = (part * division for part in _HEAD)
    out = np.array([np.cos(angle), np.sin(angle)])
    along = direction * np.array([-out[1], out[0]])
    corners = np.array(
        [radius * out - long * along + wide * out, radius * out, radius * out - long * along - wide * out]
    )
    return Curve(corners[:, 0], corners[:, 1], number=number, look=chart.SOLID)


def _box(test: CircleTest, division: float, remark: str) -> str:
    first = test.circles[0]
    lines = [
        f"{Quantity(1e-6 * division, 'm'):6} per division",
        f"R {Quantity(test.radius, 'm'):5 mm}, {''.join(first.axes)} plane",
    ]
    lines += [
        f"{'both ' if figure.both else ''}{figure.name}: {'G(b)' if figure.both else 'G'} {Quantity(figure.G, 'm')}"
        for figure in test.figures
    ]
    most = test.largest
    low, high = Quantity(most.F_min, "m", bare=True), Quantity(most.F_max, "m")
    lines += [f"F {low:+.4g} … {high:+.4g} ({test.about})", f"D {Quantity(most.D, 'm'):+.4g}"]
    lines += ["readings of encoders"] if first.source == "encoder" else []
    return joined("\n", [*lines, *([style.shortened(remark)] if remark else [])])


def _division(wanted: float) -> float:
    """Round a division in µm up to 1, 2 or 5 times a power of ten; at least 0.01."""
    power = 10.0 ** np.floor(np.log10(max(wanted, 0.01)))
    # Rounding must not push a division that is already round to the next step.
    return float(power * next(step for step in _STEPS if step * power >= max(wanted, 0.01) * (1.0 - 1e-9)))


def circle_unrolled_chart(test: CircleTest) -> Chart:
    """Plot the deviation versus the angle with the reversals marked, and a detail of 10° around each of them."""
    (whole,) = unrolled_chart(test).panels
    angles = Abscissa("angle (deg)", low=0.0, high=360.0, ticks=chart.numbered(np.arange(0.0, 361.0, 45.0)))
    panels = [replace(whole, abscissa=angles, share=1.3, whole=True)]
    names = test.circles[0].axes
    for k, (at, text) in enumerate(_QUADRANTS):
        curves = list[Curve]()
        for i, (_, angle, r) in enumerate(_rows(test)):
            off = (angle - at + 180.0) % 360.0 - 180.0
            near = np.flatnonzero(np.abs(off) <= _NEAR)
            # By angle, since a circle may begin within the detail.
            near = near[np.argsort(off[near])]
            curves.append(Curve(off[near], r[near], number=i))
        label = f"deviation ({unit_name('um')})" if k == 0 else ""
        caption = f"{text.format(names[k % 2])}, {names[k % 2]} reverses"
        zero = Level(0.0, upright=True, dashed=True)
        around = Abscissa("angle (deg)", low=-_NEAR, high=_NEAR)
        panels.append(Panel(label, tuple(curves), levels=(zero,), caption=caption, abscissa=around))
    return Chart("", tuple(panels), across=4, height=5.6)


circle_unrolled = figure_of(circle_unrolled_chart)


def unrolled_chart(test: CircleTest, before: CircleTest | None = None) -> Chart:
    """Plot the radial deviation in µm versus the polar angle in degrees, with the reversals and the peaks after them.

    before  an earlier test of the same circles, drawn thin
    """
    curves, rows = list[Curve](), _rows(test)
    # a circle begins anywhere: in order of time its curve would jump back across the picture
    for circle, angle, r in [] if before is None else _rows(before):
        order = np.argsort(angle)
        curves.append(Curve(*envelope(angle[order], r[order]), number=_like(circle, test), look=chart.THIN))
    for i, (circle, angle, r) in enumerate(rows):
        order = np.argsort(angle)
        curves.append(Curve(*envelope(angle[order], r[order]), circle.name, i))
    marks = [replace(_peak(e, 0.0), x=float(np.degrees(e.angle)), y=1e6 * e.deviation) for e in quadrant_peaks(test)]
    axes = test.circles[0].axes
    levels = tuple(
        Level(angle, text.format(axes[k % 2]), upright=True, dashed=True) for k, (angle, text) in enumerate(_QUADRANTS)
    )
    rate = max(circle.feed / circle.radius for circle in test.circles)
    thin = "" if before is None else "; thin: before"
    caption = Text(f"10 deg are {Quantity(np.radians(10.0) / rate, 's'):3} at the highest feed{thin}")
    panel = Panel(f"radial deviation ({unit_name('um')})", tuple(curves), tuple(marks), levels, caption=caption)
    return Chart("angle (deg)", (panel,), low=0.0, high=360.0, height=3.4)


def circle_causes_chart(causes: CircleCauses, most: int = 12) -> Chart:
    """Plot the largest radial deviation of each cause, ranked, with its standard error; a bar is hatched if no error is
    known.
    """
    shown = [cause for cause in causes.ranked if cause.effect > 0.0][:most]
    widest = max((1e6 * cause.effect for cause in shown), default=1.0)
    bars, errors = list[Box](), list[Curve]()
    for row, cause in enumerate(shown):
        certain = bool(np.isfinite(cause.error))
        share = Text(f", {Quantity(cause.share, 'share'):2} of G") if cause.share > 5e-4 else ""
        note = f"; {cause.note}" if cause.note else ""
        text = Text(f"{Quantity(cause.effect, 'm'):3}{share}{note}")
        size = 1e6 * cause.effect
        bars.append(Box(0.0, size, -row - 0.31, -row + 0.31, text=text, beside=True, hatched=not certain))
        if certain and cause.value:
            error = size * cause.error / abs(cause.value)
            errors.append(Curve(np.array([size - error, size + error]), np.full(2, -float(row)), number=chart.NEUTRAL))
    caption = Text(f"not explained: {Quantity(causes.residual, 'm'):3} RMS; bars: standard error; {_runs(causes)}")
    rows = max(len(shown), 1)
    panel = Panel(
        "",
        tuple(errors),
        boxes=tuple(bars),
        ticks=chart.listed([cause.name for cause in shown]),
        low=0.5 - rows,
        high=0.6,
        caption=caption,
    )
    label = f"largest radial deviation ({unit_name('um')})"
    return Chart(label, (panel,), low=0.0, high=1.75 * widest, height=1.0 + 0.34 * rows)


circle_causes = figure_of(circle_causes_chart)


def _runs(causes: CircleCauses) -> str:
    return f"{len(causes.left)} circle{'s' if len(causes.left) > 1 else ''}"


def held_tip_chart(test: HeldTip) -> Chart:
    """Plot the readings of a held tip over the angle of the joint, both ways, and those of the axes alone."""
    angle = np.degrees(test.angle)
    panels = list[Panel]()
    for name, reading, geometry in zip(DIRECTIONS, test.reading, test.geometry, strict=True):
        # both panels have the curves of the first one
        names = ("there", "back", "errors of the axes alone") if not panels else ("", "", "")
        order = np.argsort(angle, kind="stable")
        curves = [
            Curve(
                *envelope(angle[test.way == way], 1e6 * reading[test.way == way], POINTS // 2),
                names[k],
                k,
                chart.PLAIN,
                size=0.7,
            )
            for k, way in enumerate((1, -1))
        ]
        curves.append(Curve(*envelope(angle[order], 1e6 * geometry[order], POINTS // 2), names[2], 2, chart.DASHED))
        wave = test.waves[name]
        caption = Text(f"wave {Quantity(wave.amplitude, 'm'):3}, width {Quantity(wave.width, 'm'):3}")
        panels.append(Panel(f"{name}\n({unit_name('um')})", tuple(curves), caption=caption))
    return Chart(f"{test.joint} (deg)", tuple(panels), scale=chart.DEGREES, height=6.0)


held_tip = figure_of(held_tip_chart)


def reversals_chart(reversals: Reversals) -> Chart:
    """Plot the outward error after each of the last four reversals versus the time since reversal, in gray during
    standstill.
    """
    panels = tuple(_reversal(reversals, reversal) for reversal in reversals.reversals[-4:])
    # One scale for all, so that the heights of the peaks can be compared.
    lows, highs = ([float(end(curve.y)) for panel in panels for curve in panel.curves] for end in (np.min, np.max))
    low, high = style.padded(min(lows), max(highs))
    panels = tuple(replace(panel, low=low, high=high) for panel in panels)
    return Chart("", panels, across=2, height=0.8 + 2.0 * -(-len(panels) // 2))


reversals = figure_of(reversals_chart)


def _reversal(reversals: Reversals, reversal: Reversal) -> Panel:
    length = reversal.rows.stop - reversal.rows.start
    rows = slice(max(0, reversal.rows.start - length // 5), reversal.rows.start + max(2, (3 * length) // 4))
    time = 1e3 * (reversals.time[rows] - reversal.time)
    stands = Box(
        1e3 * reversal.stick_begin, 1e3 * (reversal.stick_begin + reversal.stick_time), number=chart.NEUTRAL, pale=True
    )
    caption = Text(
        f"{reversal.axis} at {reversal.side}: {Quantity(reversal.height, 'm'):3} at "
        f"{Quantity(reversal.peak_time, 's'):3}, stands {Quantity(reversal.stick_time, 's'):3}"
    )
    return Panel(
        f"outward ({unit_name('um')})",
        (Curve(time, 1e6 * reversals.outward[rows]),),
        boxes=(stands,),
        caption=caption,
        levels=(Level(1e6 * reversal.base, dashed=True),),
        abscissa=Abscissa("since the reversal (ms)", low=float(time[0]), high=float(time[-1])),
    )


def axis_load_chart(load: AxisLoad) -> Chart:
    """Plot the motor force versus time with its limits and the running RMS, and below it the thermal load from a cold
    start, if known.
    """
    time = load.sample_time * np.arange(len(load.force))
    running = np.sqrt(np.cumsum(load.force**2) / np.arange(1, len(time) + 1))
    curves = (
        Curve(*envelope(time, load.force), "motor", size=0.6),
        Curve(*envelope(time, running), "RMS so far", 1),
    )
    top, limits = 1.1 * load.peak, list[Level]()
    for size, name in ((load.continuous_force, "continuous"), (load.peak_force, "peak")):
        # a limit far above the force would flatten it
        if size is not None and size < 2.0 * top:
            top = max(top, 1.1 * size)
            caption = Text(f"{name} {Quantity(size, 'N')}")
            limits += [Level(sign * size, dashed=True, number=chart.ALERT, caption=caption) for sign in (1.0, -1.0)]
    panels = [Panel(f"force ({unit_name('N')})", curves, levels=tuple(limits), low=-top, high=top)]
    if load.heat is not None:
        heat = Curve(load.sample_time * np.arange(len(load.heat)), 100.0 * load.heat, number=2)
        warns = tuple(
            Level(level, name, dashed=True, number=chart.ALERT)
            # A threshold far above the heat would flatten its curve.
            for level, name in ((80.0, "warns"), (100.0, "trips"))
            if level < 3.0 * 100.0 * float(np.max(load.heat))
        )
        repeated = Quantity((load.heat_repeated or 0.0), "share")
        caption = Text(f"repeated for ever at most {repeated:3} of the continuous heat")
        panels.append(Panel("heat (%)", (heat,), levels=warns, caption=caption))
    return Chart("time (s)", tuple(panels), height=3.0 if load.heat is None else 4.6)


axis_load = figure_of(axis_load_chart)


_CROWDED = 12  # largest number of labeled tooth-passing lines; of more lines, only the upper ones have labels


def lobes_chart(lobes: Lobes) -> Chart:
    """Plot the depth limits versus spindle speed, Hopf and flip limits in different colors and the stable region
    shaded.

    The chatter frequency is plotted below.
    """
    speed, there = lobes.spindle_speed, np.isfinite(lobes.depth)
    top = 1e3 * (1.15 * np.max(lobes.depth[there]) if np.any(there) else lobes.deepest)
    if lobes.own is not None:
        top = max(top, 1.15e3 * lobes.own.depth)
    # a speed that is stable at every depth is shaded up to the edge
    shaded = np.minimum(np.where(there, 1e3 * lobes.depth, top), top)
    stable = Band(speed, np.zeros(speed.size), shaded, 2, "stable")
    borders, frequencies = list[Curve](), list[Curve]()
    for i, (flip, name) in enumerate(((False, "Hopf border"), (True, "flip border"))):
        borders += _border(speed, 1e3 * lobes.depth, there, lobes.flip == flip, i, name)
        chosen = there & (lobes.flip == flip)
        frequencies.append(Curve(speed[chosen], lobes.frequency[chosen], number=i, look=chart.MARKERS, size=0.55))
    for rpm, low, high in lobes.islands:
        height = np.array([1e3 * low, min(1e3 * high, top)])
        borders.append(Curve(np.array([rpm, rpm]), height, "stable again above the border", 2, chart.BAR))
    caption = "tooth passes every k swings of a mode"
    passing = tuple(
        Level(rpm, f"{k}" if n < _CROWDED else "", upright=True, dashed=True, faint=True, caption=caption)
        for n, (rpm, _, k) in enumerate(reversed(lobes.passing()))
    )
    marks, notes = ((), ()) if lobes.own is None else _this_cut(lobes.own, speed)
    low = float(np.nanmin(lobes.frequency)) if np.any(there) else 0.0
    high = float(np.nanmax(lobes.frequency)) if np.any(there) else 1.0
    low, high = style.padded(low, high, 0.12)
    panels = (
        Panel(
            "axial depth (mm)",
            tuple(borders),
            marks,
            levels=passing,
            notes=notes,
            bands=(stable,),
            low=0.0,
            high=float(top),
            share=2.0,
        ),
        Panel(
            "chatter (Hz)",
            tuple(frequencies),
            levels=tuple(Level(float(f), dashed=True) for f in lobes.natural),
            low=low,
            high=high,
            caption="dashed: own frequencies" if lobes.natural.size else "",
        ),
    )
    ends = float(speed[0]), float(speed[-1])
    return Chart("spindle speed (rpm)", panels, low=ends[0], high=ends[1], height=5.4, columns=3)


lobes = figure_of(lobes_chart)


def _border(
    speed: np.ndarray, depth: np.ndarray, there: np.ndarray, kind: np.ndarray, number: int, name: str
) -> list[Curve]:
    """Return the stability limit of one type, extended to the next speed so that there is no gap where the type
    changes.
    """
    chosen = there & kind
    if not np.any(chosen):
        return []
    joined = chosen | (np.roll(chosen, 1) & there & (np.arange(speed.size) > 0))
    line = Curve(speed, np.where(joined, depth, np.nan), name, number)
    # A line of one or two speeds is too short to be seen: it gets markers.
    if np.count_nonzero(chosen) >= 3:
        return [line]
    return [line, Curve(speed[chosen], depth[chosen], number=number, look=chart.MARKERS, size=0.9)]


def _this_cut(cut: CutStability, speed: np.ndarray) -> tuple[tuple[Mark, ...], tuple[Note, ...]]:
    number = 2 if cut.stable else chart.ALERT
    text = Text(f"this cut: |µ| = {Quantity(cut.growth):.3f}{'' if cut.stable else ', chatters'}")
    at = cut.speed, 1e3 * cut.depth
    # A text to the right of a point far right would leave the panel.
    left = cut.speed > 0.6 * float(speed[-1]) + 0.4 * float(speed[0])
    return (Mark(*at, number),), (Note(*at, text, number, right=not left),)


def cutting_forces_chart(cutting: CuttingForces) -> Chart:
    """Plot forces versus spindle angle in the last cutting revolution, and radial spindle force and power versus
    time.
    """
    turns = cutting.angle / (2.0 * np.pi)
    cuts = np.flatnonzero(cutting.torque != 0.0)
    forces, caption = tuple[Curve, ...](), ""
    if cuts.size:
        last = np.floor(turns[cuts[-1]])
        # the last whole turn, since the one in which the cut ends is not complete
        turn = (turns >= last - 1.0) & (turns < last) if last >= 1.0 else np.ones(turns.size, dtype=bool)
        degrees = 360.0 * (turns[turn] - np.floor(turns[turn][0]))
        names = ("feed", "normal", "axial")
        forces = tuple(Curve(degrees, getattr(cutting, name)[turn], name, i) for i, name in enumerate(names))
        caption = Text(f"the turn from {Quantity(cutting.time[turn][0], 's'):SI} on")
    angle = Abscissa("angle of the spindle (°)", low=0.0, high=360.0, ticks=chart.numbered(range(0, 361, 60)))
    panels = [Panel(f"force on the\ntool ({unit_name('N')})", forces, caption=caption, abscissa=angle)]
    for name, words, unit in (("resultant", "force across\nthe spindle", "N"), ("power", "power", "W")):
        values = getattr(cutting, name)
        mean = float(np.mean(values[cuts])) if cuts.size else 0.0
        mean, peak = (Quantity(size, unit, bare=True) for size in (mean, np.max(np.abs(values))))
        caption = Text(f"mean {mean} while it cuts, peak {peak}")
        panels.append(
            Panel(f"{words} ({unit_name(unit)})", (Curve(*style.envelope(cutting.time, values)),), caption=caption)
        )
    ends = float(cutting.time[0]), float(cutting.time[-1])
    return Chart("time (s)", tuple(panels), low=ends[0], high=ends[1], height=6.0, legend=chart.PANELS)


cutting_forces = figure_of(cutting_forces_chart)


def chatter_signs_chart(signs: ChatterSigns) -> Chart:
    """Plot the spectrum with the tooth-passing harmonics shown separately, and each once-per-tooth sample versus the
    previous one.
    """
    lines = signs.spectrum
    unit, factor = USUAL.of(lines.unit, signal_unit(lines.unit))
    name = unit_name(style.written(unit))
    # beyond the eighth harmonic of tooth or chatter nothing new appears
    top = min(float(lines.frequency[-1]), 8.0 * max(signs.passing, signs.chatter if signs.dots != 1 else 0.0))
    chosen = (lines.frequency > 0.0) & (lines.frequency <= top)
    stems = tuple(
        Curve(
            *chart.rods(lines.frequency, 0.0, np.where(kind & chosen, factor * lines.amplitude, np.nan)),
            text,
            i,
            chart.PLAIN,
        )
        for i, (kind, text) in enumerate(((signs.harmonic, "harmonics of the teeth"), (~signs.harmonic, "all else")))
    )
    notes = tuple[Note, ...]()
    if signs.dots != 1:
        peak = factor * float(lines.amplitude[np.searchsorted(lines.frequency, signs.chatter)])
        notes = (Note(signs.chatter, peak, Text(f"{Quantity(signs.chatter, 'Hz')}"), 1, right=True),)
    spectrum = Panel(
        f"{lines.name.replace('_', ' ')} ({name})",
        stems,
        notes=notes,
        low=0.0,
        width=1.7,
        high=1.12 * factor * float(np.max(lines.amplitude[chosen])),
        abscissa=Abscissa("frequency (Hz)", low=0.0, high=top),
    )
    values = factor * signs.samples
    middle, spread = float(np.mean(values)), 1.3 * float(np.ptp(values))
    # Samples of a stable cut are nearly equal: the scale follows the swing of the signal, so that they stay one dot.
    room = max(0.5 * spread, 0.5 * factor * signs.swing if signs.dots == 1 else 0.0) or 1.0
    low, high = middle - room, middle + room
    once = Curve(values[:-1], values[1:], number=0 if signs.dots == 1 else 1, look=chart.DOTS, size=2.0)
    sections = Panel(
        f"a tooth later ({name})",
        (once,),
        low=low,
        high=high,
        caption={1: "one dot: stable", 2: "two dots: flip", 0: "a ring: Hopf chatter"}[signs.dots],
        abscissa=Abscissa(f"once per tooth ({name})", low=low, high=high, square=True),
    )
    return Chart("", (spectrum, sections), across=2, height=3.6)


chatter_signs = figure_of(chatter_signs_chart)
