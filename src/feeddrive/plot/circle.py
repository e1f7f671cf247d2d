"""Pictures of a circular test: the circle plot, unrolled with its reversals, ranked causes; glitches and loads."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text, joined
from feeddrive.machining.circle_test import CirclePath, CircleTest, QuadrantPeak, deviations, quadrant_peaks, same_feed
from feeddrive.plot import style
from feeddrive.plot.chart import SOLID, THIN, Chart, Curve, Disc, Level, Mark, Note, Panel
from feeddrive.plot.drawing import draw_chart
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feeddrive.machining.circle_causes import CircleCauses
    from feeddrive.machining.load import AxisLoad
    from feeddrive.machining.reversal import Reversals

_DIVISIONS = 4  # between the nominal circle and the edge of the picture
_RING = 6.0  # divisions from the center to the nominal circle
_STEPS = (1.0, 2.0, 5.0, 10.0)
_NEAR = 10.0  # degrees of a zoom around a reversal
_QUADRANTS = ((0.0, "+{}"), (90.0, "+{}"), (180.0, "-{}"), (270.0, "-{}"))
_HEAD = (0.45, 0.22)  # of an arrow: length and half of its width, divisions


def _rows(test: CircleTest) -> list[tuple[CirclePath, np.ndarray, np.ndarray]]:
    """Circles with the polar angle in degrees, 0 to 360, and the radial deviation in µm, in the order of the motion."""
    rows = zip(test.circles, deviations(test), strict=True)
    return [(each, np.degrees(angle), 1e6 * r) for each, (angle, r) in rows]


def _like(circle: CirclePath, test: CircleTest) -> int:
    """The place of the circle of a test that has the direction and the feed of another one; behind all if none has."""
    there = (i for i, e in enumerate(test.circles) if e.direction == circle.direction and same_feed(e, circle))
    return next(there, len(test.circles))


def circle_test(test: CircleTest, division: float | None = None, said: str = "") -> Any:
    """The circle plot: radial deviations enlarged on the nominal circle, both directions, with a box of figures.

    division  µm of a division; default: the smallest of 1, 2, 5, 10 ... with which all is seen.  Give the same for all
              plots that are to be compared
    said      date, place, state of compensation: a line for the box
    """
    each = _scale([test]) if division is None else division
    chart = circle_chart(test, division=each)
    figure, (ax,) = style.picture(1, height=chart.height)
    draw_chart(chart, [ax])
    ax.set_anchor("W")
    ax.annotate(style.read(_box(test, each, said)), (1.02, 0.5), xycoords="axes fraction", ha="left", va="center",
                fontsize=style.SMALL, color=style.INK, linespacing=1.5)  # fmt: skip
    style.legend(figure, ax, chart.columns)
    return figure


def circle_chart(test: CircleTest, before: CircleTest | None = None, division: float | None = None) -> Chart:
    """What `circle_test` shows: x and y in µm, a point as far from the drawn nominal circle as the machine deviates.

    before  the same circles as they were, which are drawn thin
    """
    rows, old = _rows(test), [] if before is None else _rows(before)
    each = _scale([test] if before is None else [test, before]) if division is None else division
    ring, edge = _RING * each, (_RING + _DIVISIONS + 0.5) * each
    curves, marks = list[Curve](), list[Mark]()
    for circle, angle, r in old:
        curves.append(Curve(*_closed(ring + r, angle), number=_like(circle, test), look=THIN))
    for i, (circle, angle, r) in enumerate(rows):
        x, y = _closed(ring + r, angle)
        curves.append(Curve(x, y, circle.name, i, said=_gap(circle, test, before)))
        marks.append(Mark(float(x[0]), float(y[0]), i, said=f"{circle.name} begins"))
        k = len(r) // 8 + (0 if circle.direction > 0 else 3)
        curves.append(_arrow(float(ring + r[k]), float(np.radians(angle[k])), circle.direction, each, i))
    marks += [_peak(each, ring) for each in quadrant_peaks(test)]
    rings = tuple(
        Disc(0.0, 0.0, ring + k * each, faint=k != 0) for k in range(-_DIVISIONS, _DIVISIONS + 1)
    )  # fmt: skip
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
            Text(f"rings: {Quantity(1e-6 * each, 'm'):6}\ndeviation × {Quantity(1e6 * test.radius / ring):.0f}{thin}"),
            middle=True,
        )
    )
    side = edge + 0.6 * each
    panel = Panel(
        f"y ({unit_name('um')})", tuple(curves), tuple(marks), discs=rings, notes=tuple(notes), low=-side, high=side
    )
    return Chart(
        f"x ({unit_name('um')})", (panel,), low=-side, high=side, square=True, bare=True, height=6.2, columns=2
    )


def _scale(tests: Sequence[CircleTest]) -> float:
    """The division with which all deviations of some tests are seen, µm."""
    return _division(max(float(np.max(np.abs(r))) for test in tests for _, _, r in _rows(test)) / _DIVISIONS)


def _closed(place: np.ndarray, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = place * np.cos(np.radians(angle)), place * np.sin(np.radians(angle))
    return np.append(x, x[0]), np.append(y, y[0])


def _peak(peak: QuadrantPeak, ring: float) -> Mark:
    """On the drawn circle."""
    r = ring + 1e6 * peak.deviation
    said = Text(f"peak {Quantity(peak.height, 'm'):3} behind {peak.side}{peak.axis}")
    return Mark(float(r * np.cos(peak.angle)), float(r * np.sin(peak.angle)), peak.circle, True, said=said)


def _gap(circle: CirclePath, test: CircleTest, before: CircleTest | None) -> str:
    """G of a circle, and as it was."""
    own = [each for each in test.figures if not each.both]
    said = Text(f"G {Quantity(own[test.circles.index(circle)].G, 'm')}")
    if before is None or (i := _like(circle, before)) == len(before.circles):
        return said
    return Text(f"{said}, before {Quantity([each for each in before.figures if not each.both][i].G, 'm')}")


def _arrow(radius: float, angle: float, direction: int, division: float, number: int) -> Curve:
    """The head of an arrow along the circle, in the direction of the motion."""
    long, wide = (part * division for part in _HEAD)
    out = np.array([np.cos(angle), np.sin(angle)])
    along = direction * np.array([-out[1], out[0]])
    corners = np.array(
        [radius * out - long * along + wide * out, radius * out, radius * out - long * along - wide * out]
    )
    return Curve(corners[:, 0], corners[:, 1], number=number, look=SOLID)


def _box(test: CircleTest, division: float, said: str) -> str:
    first = test.circles[0]
    lines = [
        f"{Quantity(1e-6 * division, 'm'):6} per division",
        f"R {Quantity(test.radius, 'm'):5 mm}, {''.join(first.axes)} plane",
    ]
    lines += [
        f"{'both ' if each.both else ''}{each.name}: {'G(b)' if each.both else 'G'} {Quantity(each.G, 'm')}"
        for each in test.figures
    ]
    most = test.largest
    low, high = Quantity(most.F_min, "m", bare=True), Quantity(most.F_max, "m")
    lines += [f"F {low:+.4g} … {high:+.4g} ({test.about})", f"D {Quantity(most.D, 'm'):+.4g}"]
    lines += ["readings of encoders"] if first.source == "encoder" else []
    return joined("\n", [*lines, *([style.caption(said) or ""] if said else [])])


def _division(wanted: float) -> float:
    """1, 2, 5 times a power of ten µm, the smallest that is not below; 0.01 at least."""
    power = 10.0 ** np.floor(np.log10(max(wanted, 0.01)))
    return float(power * next(step for step in _STEPS if step * power >= max(wanted, 0.01) * (1.0 - 1e-9)))


def circle_unrolled(test: CircleTest) -> Any:
    """The deviations over the angle with the reversals marked, and ten degrees around each of them."""
    from feeddrive.plot.picture import Picture

    figure = Picture(figsize=(style.WIDTH, 5.6), layout="constrained", facecolor=style.PAPER)
    grid = figure.add_gridspec(2, 4, height_ratios=(1.3, 1.0))
    whole = style.dressed(figure.add_subplot(grid[0, :]))
    zooms = [style.dressed(figure.add_subplot(grid[1, k])) for k in range(4)]
    draw_chart(unrolled_chart(test), [whole])
    whole.set_xticks(np.arange(0.0, 361.0, 45.0))
    names = test.circles[0].axes
    for k, (ax, (at, text)) in enumerate(zip(zooms, _QUADRANTS, strict=True)):
        for i, (_, angle, r) in enumerate(_rows(test)):
            off = (angle - at + 180.0) % 360.0 - 180.0
            near = np.flatnonzero(np.abs(off) <= _NEAR)
            near = near[np.argsort(off[near])]
            ax.plot(off[near], r[near], **style.curve(i))
        ax.axvline(0.0, color=style.MUTED, linewidth=0.9, linestyle=(0, (4, 3)))
        ax.set_xlim(-_NEAR, _NEAR)
        style.note(ax, f"{text.format(names[k % 2])}, {names[k % 2]} reverses", x=0.5, align="center")
        style.labels(ax, "angle (deg)", f"deviation ({unit_name('um')})" if k == 0 else "")
    style.legend(figure, whole, 4)
    return figure


def unrolled_chart(test: CircleTest, before: CircleTest | None = None) -> Chart:
    """The radial deviation in µm over the polar angle in degrees, with the reversals and the peaks after them.

    before  the same circles as they were, which are drawn thin
    """
    curves, rows = list[Curve](), _rows(test)
    for circle, angle, r in [] if before is None else _rows(before):
        order = np.argsort(angle)
        curves.append(Curve(*envelope(angle[order], r[order]), number=_like(circle, test), look=THIN))
    for i, (circle, angle, r) in enumerate(rows):
        order = np.argsort(angle)
        curves.append(Curve(*envelope(angle[order], r[order]), circle.name, i))
    marks = [replace(_peak(e, 0.0), x=float(np.degrees(e.angle)), y=1e6 * e.deviation) for e in quadrant_peaks(test)]
    axes = test.circles[0].axes
    levels = tuple(
        Level(angle, text.format(axes[k % 2]), upright=True, dashed=True) for k, (angle, text) in enumerate(_QUADRANTS)
    )
    rate = max(each.feed / each.radius for each in test.circles)
    thin = "" if before is None else "; thin: before"
    said = Text(f"10 deg are {Quantity(np.radians(10.0) / rate, 's'):3} at the highest feed{thin}")
    panel = Panel(f"radial deviation ({unit_name('um')})", tuple(curves), tuple(marks), levels, said=said)
    return Chart("angle (deg)", (panel,), low=0.0, high=360.0, height=3.4)


def circle_causes(found: CircleCauses, most: int = 12) -> Any:
    """What each cause draws at most, the largest first, with its standard error, and what cannot be told apart."""
    shown = [each for each in found.ranked if each.effect > 0.0][:most]
    figure, (ax,) = style.picture(height=1.0 + 0.34 * max(len(shown), 1))
    widest = max((1e6 * each.effect for each in shown), default=1.0)
    for row, each in enumerate(shown):
        known = np.isfinite(each.error)
        look: dict[str, Any] = {"color": style.color(0)} if known else {"color": style.GRID, "hatch": "///",
                                                                        "edgecolor": style.MUTED}  # fmt: skip
        ax.barh(-row, 1e6 * each.effect, height=0.62, linewidth=0.6, **look)
        if known and each.value:
            error = 1e6 * each.effect * each.error / abs(each.value)
            ax.plot(
                [1e6 * each.effect - error, 1e6 * each.effect + error], [-row, -row], color=style.INK, linewidth=1.4
            )
        share = Text(f", {Quantity(each.share, 'share'):2} of G") if each.share > 5e-4 else ""
        note = f"; {each.note}" if each.note else ""
        text = style.read(f"{Quantity(each.effect, 'm'):3}{share}{note}")
        ax.annotate(text, (1e6 * each.effect, -row), xytext=(5, 0),
                    textcoords="offset points", va="center", fontsize=style.SMALL, color=style.MUTED)  # fmt: skip
    ax.set_yticks([-row for row in range(len(shown))], [each.name for each in shown])
    ax.set_xlim(0.0, 1.75 * widest)
    ax.set_ylim(0.5 - max(len(shown), 1), 0.6)
    ax.grid(visible=False, axis="y")
    style.labels(ax, f"largest radial deviation ({unit_name('um')})", "")
    style.note(ax, Text(f"not explained: {Quantity(found.residual, 'm'):3} RMS; bars: standard error; {_runs(found)}"))
    return figure


def _runs(found: CircleCauses) -> str:
    return f"{len(found.left)} circle{'s' if len(found.left) > 1 else ''}"


def reversals(found: Reversals) -> Any:
    """The outward error after each of the last four reversals, over the time since it; gray: where the axis stands."""
    from feeddrive.plot.picture import Picture

    figure = Picture(figsize=(style.WIDTH, 4.8), layout="constrained", facecolor=style.PAPER)
    axes = [style.dressed(ax) for ax in figure.subplots(2, 2, sharey=True).flat]
    chosen = found.reversals[-4:]
    for ax, each in zip(axes, chosen, strict=False):
        length = each.rows.stop - each.rows.start
        rows = slice(max(0, each.rows.start - length // 5), each.rows.start + max(2, (3 * length) // 4))
        ax.axvspan(1e3 * each.stick_begin, 1e3 * (each.stick_begin + each.stick_time), color=style.GRID)
        ax.plot(1e3 * (found.time[rows] - each.time), 1e6 * found.outward[rows], **style.curve(0))
        ax.axhline(1e6 * each.base, color=style.MUTED, linewidth=0.9, linestyle=(0, (4, 3)))
        text = Text(
            f"{each.axis} at {each.side}: {Quantity(each.height, 'm'):3} at {Quantity(each.peak_time, 's'):3}, stands "
            f"{Quantity(each.stick_time, 's'):3}"
        )
        style.note(ax, text)
        style.labels(ax, "since the reversal (ms)", f"outward ({unit_name('um')})")
    for ax in axes[len(chosen) :]:
        ax.set_axis_off()
    return figure


def axis_load(load: AxisLoad) -> Any:
    """Motor force over time with its limits and the running RMS; below it the heat from cold, if it is known."""
    figure, axes = style.picture(1 if load.heat is None else 2, height=3.0 if load.heat is None else 4.6)
    time = load.sample_time * np.arange(len(load.force))
    ax = axes[0]
    ax.plot(*envelope(time, load.force), **style.curve(0) | {"linewidth": 0.8}, label="motor")
    running = np.sqrt(np.cumsum(load.force**2) / np.arange(1, len(time) + 1))
    ax.plot(*envelope(time, running), **style.curve(1), label="RMS so far")
    top = 1.1 * load.peak
    for level, name, dash in (
        (load.continuous_force, "continuous", (0, (5, 2))), (load.peak_force, "peak", (0, (1.5, 1.5))),
    ):  # fmt: skip
        if level is not None and level < 2.0 * top:
            top = max(top, 1.1 * level)
            for sign in (1.0, -1.0):
                ax.axhline(sign * level, color=style.ALERT, linewidth=1.0, linestyle=dash,
                           label=style.read(f"{name} {Quantity(level, 'N')}") if sign > 0 else None)  # fmt: skip
    ax.set_ylim(-top, top)
    style.labels(ax, None if load.heat is not None else "time (s)", f"force ({unit_name('N')})")
    if load.heat is not None:
        heat = axes[1]
        heat.plot(load.sample_time * np.arange(len(load.heat)), 100.0 * load.heat, **style.curve(2))
        for level, name in ((80.0, "warns"), (100.0, "trips")):
            if level < 3.0 * 100.0 * float(np.max(load.heat)):
                heat.axhline(level, color=style.ALERT, linewidth=1.0, linestyle=(0, (5, 2)))
                heat.annotate(name, (0.0, level), xytext=(3, 2), textcoords="offset points", fontsize=style.SMALL,
                              color=style.MUTED)  # fmt: skip
        style.labels(heat, "time (s)", "heat (%)")
        style.note(
            heat,
            Text(
                f"repeated for ever at most {Quantity((load.heat_repeated or 0.0), 'share'):3} of the continuous heat"
            ),
        )
    style.legend(figure, ax)
    return figure
