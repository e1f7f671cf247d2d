"""Charts as SVG for pages: texts stay texts, colors are the page's variables, and nothing but numpy is needed.

`plot/layout.py` places the parts, and this module writes them. Lengths are points, 72 in an inch; y points down.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

from feeddrive.plot import chart as looks
from feeddrive.plot import placing, style
from feeddrive.plot.chart import Band, Box, Chart, Curve, Disc, Field, Heat, Level, Mark, Note
from feeddrive.plot.layout import (
    BAR,
    EDGE,
    GAP,
    ROW,
    SAMPLE,
    TICK,
    TURN,
    Axis,
    Entry,
    Frame,
    Layout,
    LegendRows,
    cell_edges,
    color_scale,
    divide,
    heat_range,
    height,
    level_dashes,
)
from feeddrive.plot.placing import LINE, Extent, width
from feeddrive.plot.polyline import cut, thinned
from feeddrive.plot.style import SMALL, TEXT

_NAMESPACE = "http://www.w3.org/2000/svg"
_FINE_GRID = 25.0  # the least length of a decade that has a fine grid
_FINE = 0.01  # unit of the paths of curves
_CLIPPED = 2.0  # beyond the frame: half a line at the edge is not cut off
_DENSE = 3  # paths of a cloud of pale points, so that overlaps look darker
_NARROW = 1.0  # narrower columns of a field are joined


def svg_element(chart: Chart, key: str, alt: str, colors: Mapping[str, str] | None = None) -> str:
    """Return a chart, with its texts in display units, as an SVG element.

    key     prefix that makes its identifiers unique on a page
    alt     description of the picture
    colors  what replaces the colors of the house style, such as variables of a page; None: they stay
    """
    return _Drawing(chart, key, colors or {}).element(alt)


def svg_file(chart: Chart, alt: str) -> str:
    """Return a chart, with its texts in display units, as an SVG file: in the colors of the house style, on paper.

    alt  description of the picture
    """
    return _Drawing(chart, "p", {}).element(alt, alone=True)


class _Drawing:
    def __init__(self, chart: Chart, key: str, colors: Mapping[str, str]) -> None:
        self.chart, self.key, self.colors = chart, key, colors
        self.layout = Layout(chart)
        self.parts = list[str]()
        self.identifiers = 0

    def element(self, alt: str, *, alone: bool = False) -> str:
        """Return the SVG element; alone in its file it has a size, a paper, and no variables of a page."""
        layout = self.layout
        if alone:
            self._add(f'<rect width="100%" height="100%" fill="{style.PAPER}"/>')
        self._headings()
        for frame in layout.frames:
            self._frame(frame)
        size = f'width="{100.0 * self.chart.width / style.WIDTH:.0f}%"'
        font = "var(--font, sans-serif)"
        if alone:
            size = f'xmlns="{_NAMESPACE}" width="{_n(layout.wide)}pt" height="{_n(layout.tall)}pt"'
            font = "sans-serif"  # programs that draw know no variables
        head = (
            f'<svg viewBox="0 0 {_n(layout.wide)} {_n(layout.tall)}" {size} role="img"'
            f' aria-label="{escape(alt)}" font-family="{font}">'
        )
        return f"{head}<desc>{escape(_description(layout.frames))}</desc>{''.join(self.parts)}</svg>"

    def _headings(self) -> None:
        chart, (begin, top, end, bottom) = self.chart, self.layout.inside
        if chart.caption:
            text = style.titled(chart.caption, most=120)
            self._text(0.5 * (begin + end), EDGE + TEXT, text, TEXT, style.ALERT, "middle")
        if chart.legend == looks.RIGHT:
            self._legend(
                self.layout.legend_at, self.layout.legend_top, [[(0.0, entry)] for entry in self.layout.legend]
            )
        self._legend(self.layout.legend_at, self.layout.legend_top, self.layout.legend_rows)
        if chart.side:
            self._text(EDGE + TEXT, 0.5 * (top + bottom), chart.side, TEXT, style.INK, "middle", turn=-90.0)

    def _legend(self, x: float, y: float, rows: LegendRows) -> None:
        """Draw the rows of a legend from (x, y)."""
        for row in rows:
            for along, entry in row:
                self._entry(x + along, y + 0.5 * ROW, entry)
            y += height([row])

    def _entry(self, x: float, y: float, entry: Entry) -> None:
        """Draw an entry of a legend with its sample from x, centered on y."""
        thing, end = entry.of, x + SAMPLE - 6.0
        if isinstance(thing, Curve) and thing.look != looks.SOLID and thing.reach is None:
            stroke = style.stroke(thing)
            tint = self._tint(_color(thing.number, _neutral(thing)))
            if stroke.line:
                self._add(f'<path d="M{_n(x)} {_n(y)}H{_n(end)}" {_line(tint, stroke.line, stroke.dashes)}/>')
            if stroke.marker:
                self._markers(np.array([0.5 * (x + end)]), np.array([y]), stroke, tint)
        elif isinstance(thing, Level):
            tint = self._tint(_color(thing.number, style.MUTED if thing.dashed or thing.faint else style.INK))
            self._add(f'<path d="M{_n(x)} {_n(y)}H{_n(end)}" {_line(tint, 1.0, entry.dashes)}/>')
        else:
            look = f'fill="{self._tint(_color(thing.number, style.MUTED))}"'
            if isinstance(thing, Band):
                look += f' fill-opacity="{style.BAND}"'
            elif isinstance(thing, Curve) and thing.reach is not None:
                look += f' fill-opacity="{style.PALE}"'
            elif isinstance(thing, Box):
                look = self._box_look(thing)
            self._add(f'<rect x="{_n(x)}" y="{_n(y - 3.2)}" width="{_n(end - x)}" height="6.4" {look}/>')
        self._text(x + SAMPLE, y + 0.35 * SMALL, entry.text, SMALL, style.INK)

    def _frame(self, frame: Frame) -> None:
        panel, x, y = frame.panel, frame.x, frame.y
        bare = self.chart.bare and panel.abscissa is None
        identifier = self._identifier()
        left, top = x.begin - _CLIPPED, y.end - _CLIPPED
        self._add(
            f'<clipPath id="{identifier}"><rect x="{_n(left)}" y="{_n(top)}" '
            f'width="{_n(frame.wide + 2.0 * _CLIPPED)}" height="{_n(frame.tall + 2.0 * _CLIPPED)}"/></clipPath>'
        )
        if not bare:
            self._grid(frame)
        self._add(f'<g clip-path="url(#{identifier})" stroke-linejoin="round">')
        # what is drawn later covers what is below: areas first, then curves, then marks and words
        for curve in panel.curves:
            if curve.reach is not None:
                self._reach(frame, curve, curve.reach)
        for box in panel.boxes:
            self._box(frame, box)
        if panel.field is not None and panel.heat is not None:
            self._field(frame, panel.field, panel.heat)
        for disc in panel.discs:
            self._disc(frame, disc)
        for band in panel.bands:
            self._band(frame, band)
        for level in panel.levels:
            self._level(frame, level)
        for curve in panel.curves:
            if curve.reach is not None:
                continue
            if curve.heat is None:
                self._curve(frame, curve)
            elif panel.heat is not None:
                self._heat(frame, curve, curve.heat, panel.heat)
        self._add("</g>")
        if not bare:
            self._axes(frame)
        self._marks(frame)
        self._words(frame)
        if color_scale(panel) is not None:
            self._scale(frame)
        if self.chart.beside and frame is self.layout.frames[0]:
            lines = self.chart.beside.count("\n")
            above = 0.5 * (y.begin + y.end) - 0.5 * lines * 1.5 * SMALL + 0.35 * SMALL
            self._text(x.end + 10.0, above, self.chart.beside, SMALL, style.INK, spacing=1.5)

    def _grid(self, frame: Frame) -> None:
        panel, x, y = frame.panel, frame.x, frame.y
        if frame.table or panel.field is not None:
            return
        axes = [(x, frame.x_ticks, frame.abscissa.ticks), (y, frame.y_ticks, panel.ticks)]
        for minor in (True, False):
            path = ""
            for axis, found, given in axes:
                # positions with names have no lines, and a fine grid needs room
                if any(tick.name for tick in given or ()) or (minor and _decade(axis) < _FINE_GRID):
                    continue
                for at in (_n(axis.at(value)) for value in (found.minor if minor else found.values)):
                    path += f"M{at} {_n(y.begin)}V{_n(y.end)}" if axis is x else f"M{_n(x.begin)} {at}H{_n(x.end)}"
            if path:
                self._add(f'<path d="{path}" {_line(self._tint(style.GRID), 0.4 if minor else 0.8)}/>')

    def _axes(self, frame: Frame) -> None:
        panel, x, y, muted = frame.panel, frame.x, frame.y, self._tint(style.MUTED)
        if not frame.table:
            path = f"M{_n(x.begin)} {_n(y.end)}V{_n(y.begin)}H{_n(x.end)}"
            for at in (x.at(value) for value in frame.x_ticks.values):
                path += f"M{_n(at)} {_n(y.begin)}v{TICK}"
            for at in (y.at(value) for value in frame.y_ticks.values):
                path += f"M{_n(x.begin)} {_n(at)}h-{TICK}"
            for at in (x.at(value) for value in frame.x_ticks.minor):
                path += f"M{_n(at)} {_n(y.begin)}v2"
            for at in (y.at(value) for value in frame.y_ticks.minor):
                path += f"M{_n(x.begin)} {_n(at)}h-2"
            self._add(f'<path d="{path}" {_line(muted, 0.8)}/>')
        if frame.ends:
            slanted = self.layout.slanted(frame)
            for value, text in zip(frame.x_ticks.values, frame.x_ticks.texts, strict=True):
                if frame.table:
                    self._text(x.at(value), y.end - 4.0, text, SMALL, style.INK, turn=-TURN)
                elif slanted:
                    self._text(x.at(value) + 3.0, y.begin + TICK + SMALL, text, SMALL, style.INK, "end", -TURN)
                else:
                    self._text(x.at(value), y.begin + TICK + GAP + 0.8 * SMALL, text, SMALL, style.INK, "middle")
            if frame.x_ticks.power:
                self._text(x.end + 4.0, y.begin, frame.x_ticks.power, SMALL, style.MUTED)
        for value, text in zip(frame.y_ticks.values, frame.y_ticks.texts, strict=True):
            self._text(x.begin - TICK - GAP, y.at(value) + 0.35 * SMALL, text, SMALL, style.INK, "end")
        if frame.y_ticks.power:
            self._text(x.begin, y.end - 4.0, frame.y_ticks.power, SMALL, style.MUTED)
        if frame.labeled and frame.abscissa.label:
            lines = self.layout.x_label(frame)
            room = self.layout.around(frame)[3] - LINE * TEXT * len(lines)
            self._text(0.5 * (x.begin + x.end), y.begin + room + TEXT, "\n".join(lines), TEXT, style.INK, "middle")
        if panel.label:
            lines = "\n".join(self.layout.y_label(frame))
            left = self.layout.labels[frame.column]
            if frame.abscissa.square:  # beside the panel, which is narrower than its column
                left = x.begin - self.layout.around(frame)[0]
            self._text(left + TEXT, 0.5 * (y.begin + y.end), lines, TEXT, style.INK, "middle", -90.0)

    def _words(self, frame: Frame) -> None:
        """Write what stands above a panel and on it."""
        panel, x, y = frame.panel, frame.x, frame.y
        rows = self.layout.own_legend(frame)
        if caption := style.titled(panel.caption, most=120) if panel.caption else "":
            # above the legend, unless its last row leaves room
            up = 0.0 if self.layout.beside_legend(frame) else height(rows)
            self._text(x.end, y.end - 3.0 - up - 0.5 * ROW + 0.35 * SMALL, caption, SMALL, style.MUTED, "end")
        self._legend(x.begin + self.layout.power(frame), y.end - 3.0 - height(rows), rows)
        taken = list[Extent]()
        for level in panel.levels:
            self._level_text(frame, level, taken)
        for box in panel.boxes:
            self._box_text(frame, box)
        for curve in panel.curves:
            if curve.look == looks.BAR and curve.caption:
                self._bar_text(frame, curve)
        for note in panel.notes:
            self._note(frame, note)

    def _level(self, frame: Frame, level: Level) -> None:
        x, y = frame.x, frame.y
        if not (x if level.upright else y).holds(level.value):
            return
        at = _n((x if level.upright else y).at(level.value))
        path = f"M{at} {_n(y.begin)}V{_n(y.end)}" if level.upright else f"M{_n(x.begin)} {at}H{_n(x.end)}"
        tint = self._tint(_color(level.number, style.MUTED if level.dashed or level.faint else style.INK))
        line = _line(tint, 0.8 if level.faint else 1.0, level_dashes(frame.panel, level))
        self._add(f'<path d="{path}" {line}/>')

    def _level_text(self, frame: Frame, level: Level, taken: list[Extent]) -> None:
        """Write the text of a level where it covers no other one: beside its line at the top, or under or over it."""
        x, y = frame.x, frame.y
        if not level.text or not (x if level.upright else y).holds(level.value):
            return
        wide = width(level.text, SMALL)
        places = list[tuple[float, float]]()  # left end and base line
        if level.upright:
            at = x.at(level.value)
            for row in range(4):
                base = y.end + 2.0 + SMALL * (0.8 + LINE * row)
                places += [(at + 4.0, base), (at - 4.0 - wide, base)]
        else:
            at = y.at(level.value)
            for left in (x.begin + 4.0, x.end - 4.0 - wide, 0.5 * (x.begin + x.end - wide)):
                places += [(left, at + 2.0 + 0.8 * SMALL), (left, at - 3.0)]
        boxes = [(left, base - 0.8 * SMALL, left + wide, base + 0.25 * SMALL) for left, base in places]
        edge = x.begin, y.end, x.end, y.begin
        # a curve under a text is better than another text, and that better than a text that leaves the panel
        over = [sum(placing.shared(box, other) for other in taken) + 20.0 * placing.outside(box, edge) for box in boxes]
        costs = [cost + min(self._covered(frame, box), 9) for cost, box in zip(over, boxes, strict=True)]
        best = costs.index(min(costs))
        taken.append(boxes[best])
        self._text(*places[best], level.text, SMALL, style.MUTED, halo=True)

    def _covered(self, frame: Frame, box: Extent) -> int:
        """Return the number of points of curves in a box."""
        count = 0
        for curve in frame.panel.curves:
            x, y = frame.x(curve.x), frame.y(curve.y)
            count += int(np.count_nonzero((x > box[0]) & (x < box[2]) & (y > box[1]) & (y < box[3])))
        return count

    def _curve(self, frame: Frame, curve: Curve) -> None:
        tint = self._tint(_color(curve.number, _neutral(curve)))
        if curve.look == looks.SOLID:
            shapes = ((frame.x(x), frame.y(y)) for x, y in style.shapes(curve))
            path = "".join(_steps(*thinned(x, y)) + "z" for x, y in shapes if x.size and np.all(np.isfinite(x + y)))
            self._add(f'<path d="{path}" transform="scale({_FINE})" fill="{tint}">{_hint(curve)}</path>')
            return
        stroke = style.stroke(curve)
        x, y = frame.x(curve.x), frame.y(curve.y)
        if stroke.line and (path := self._polyline(frame, x, y)):
            opacity = f' stroke-opacity="{_n(stroke.alpha)}"' if stroke.alpha < 1.0 else ""
            line = _line(tint, stroke.line / _FINE, [each / _FINE for each in stroke.dashes])
            cap = ' stroke-linecap="round"' if not stroke.dashes and not stroke.butt else ""
            self._add(f'<path d="{path}" transform="scale({_FINE})" {line}{opacity}{cap}>{_hint(curve)}</path>')
        if stroke.marker:
            inside = (x >= frame.x.begin - 0.1) & (x <= frame.x.end + 0.1)
            inside &= (y >= frame.y.end - 0.1) & (y <= frame.y.begin + 0.1)
            self._markers(x[inside], y[inside], stroke, tint)

    def _polyline(self, frame: Frame, x: np.ndarray, y: np.ndarray) -> str:
        """Return the path of a line in units of `_FINE`, cut at the edge of the frame and thinned."""
        edge = frame.x.begin - _CLIPPED, frame.y.end - _CLIPPED, frame.x.end + _CLIPPED, frame.y.begin + _CLIPPED
        return "".join(_steps(*thinned(*piece)) for piece in cut(x, y, edge))

    def _markers(self, x: np.ndarray, y: np.ndarray, stroke: style.Stroke, tint: str) -> None:
        if not x.size:
            return
        shape, closed = _marker(stroke.marker, 0.5 * stroke.size)
        opacity = f' opacity="{_n(stroke.alpha)}"' if stroke.alpha < 1.0 else ""
        fill = "none" if stroke.hollow or not closed else tint
        look = f'fill="{fill}" stroke="{tint}" stroke-width="{_n(stroke.edge)}"{opacity}'
        # pale points that overlap become darker, which one path would not show
        groups = _DENSE if stroke.alpha < 1.0 else 1
        for first in range(min(groups, x.size)):
            places = zip(x[first::groups].tolist(), y[first::groups].tolist(), strict=True)
            path = "".join(f"M{px:.2f} {py:.2f}{shape}" for px, py in places)
            self._add(f'<path d="{path}" {look}/>')

    def _heat(self, frame: Frame, curve: Curve, heat: np.ndarray, scale: Heat) -> None:
        """Draw a curve in steps of color and width."""
        x, y = frame.x(curve.x), frame.y(curve.y)
        # a segment has the larger value of its two ends, so that a single peak keeps its color
        step = style.heat_step(np.maximum(heat[:-1], heat[1:]), scale)
        for k in range(style.HEAT_STEPS):
            rows = np.flatnonzero(step == k)
            if not rows.size or not (path := self._polyline(frame, *(style.stretches(z, rows) for z in (x, y)))):
                continue
            line = _line(self._tint(style.heat(k)), style.heat_width(k) / _FINE)
            self._add(f'<path d="{path}" transform="scale({_FINE})" {line} stroke-linecap="round"/>')

    def _band(self, frame: Frame, band: Band) -> None:
        tint = self._tint(_color(band.number, style.MUTED))
        x = frame.x(band.x)
        ends = [(frame.y(side), side) for side in (band.low, band.high)]
        # on a logarithmic axis a band that reaches 0 goes down to the edge of the panel
        low, high = (np.where(np.isnan(place) & np.isfinite(side), frame.y.begin + 9.0, place) for place, side in ends)
        low, high = (np.clip(place, frame.y.end - 9.0, frame.y.begin + 9.0) for place in (low, high))
        there = np.isfinite(x) & np.isfinite(low) & np.isfinite(high)
        path = ""
        for rows in np.split(np.arange(x.size), np.flatnonzero(np.diff(there)) + 1):
            if rows.size > 1 and there[rows[0]]:
                (ax, ay), (bx, by) = thinned(x[rows], low[rows]), thinned(x[rows], high[rows])
                path += _steps(np.concatenate([ax, bx[::-1]]), np.concatenate([ay, by[::-1]])) + "z"
        if path:
            title = f"<title>{escape(style.shortened(band.name))}</title>" if band.name else ""
            look = f'fill="{tint}" fill-opacity="{style.BAND}"'
            self._add(f'<path d="{path}" transform="scale({_FINE})" {look}>{title}</path>')

    def _reach(self, frame: Frame, curve: Curve, reach: np.ndarray) -> None:
        """Draw discs as one pale area, so that an overlap does not look like a higher probability."""
        x, y, radius = frame.x(curve.x), frame.y(curve.y), reach * abs(frame.wide / (frame.x.high - frame.x.low))
        path = ""
        for px, py, r in zip(x.tolist(), y.tolist(), radius.tolist(), strict=True):
            if np.isfinite(px + py + r) and abs(px) + abs(py) + r < 1e5:
                path += f"M{px - r:.2f} {py:.2f}{_circle(r)}"
        tint = self._tint(_color(curve.number))
        self._add(f'<path d="{path}" fill="{tint}" fill-opacity="{style.PALE}">{_hint(curve)}</path>')

    def _disc(self, frame: Frame, disc: Disc) -> None:
        x, y = frame.x.at(disc.x), frame.y.at(disc.y)
        rx = abs(disc.radius * frame.wide / (frame.x.high - frame.x.low))
        ry = abs(disc.radius * frame.tall / (frame.y.high - frame.y.low))
        tint = self._tint(style.GRID if disc.faint else _color(disc.number, style.MUTED))
        fill = f'fill="{tint}" fill-opacity="0.1"' if disc.filled else 'fill="none"'
        dashes = style.LIMITS[0] if disc.number < 0 else style.DASHES[disc.number % len(style.DASHES)]
        dashes = () if disc.faint else dashes
        line = _line(tint, 0.9, [0.9 * each for each in dashes], "")
        self._add(f'<ellipse cx="{_n(x)}" cy="{_n(y)}" rx="{_n(rx)}" ry="{_n(ry)}" {fill} {line}/>')

    def _box(self, frame: Frame, box: Box) -> None:
        left, right = sorted(frame.x.at(value) for value in (box.left, box.right))
        top, bottom = frame.y.end, frame.y.begin
        if box.low is not None and box.high is not None:
            top, bottom = sorted(frame.y.at(value) for value in (box.low, box.high))
        left, right = (float(np.clip(each, frame.x.begin - 9.0, frame.x.end + 9.0)) for each in (left, right))
        top, bottom = (float(np.clip(each, frame.y.end - 9.0, frame.y.begin + 9.0)) for each in (top, bottom))
        if not np.isfinite(left + right + top + bottom):
            return
        self._add(
            f'<rect x="{_n(left)}" y="{_n(top)}" width="{_n(right - left)}" height="{_n(bottom - top)}" '
            f"{self._box_look(box)}/>"
        )

    def _box_look(self, box: Box) -> str:
        if box.hatched:
            return f'fill="url(#{self._hatch()})" stroke="{self._tint(style.MUTED)}" stroke-width="0.6"'
        if box.level is not None:
            # from better through the color of the page to worse, so that the text is readable on light and dark
            tint = self._tint(style.BETTER if box.level < 0.0 else style.WORSE)
            return f'fill="{tint}" fill-opacity="{_n(0.84 * min(abs(box.level), 1.0))}"'
        tint = self._tint(_color(box.number, style.MUTED))
        if box.pale:
            return f'fill="{tint}" fill-opacity="0.14"'
        return f'fill="{tint}" stroke="{self._tint(style.PAPER)}" stroke-width="0.5"'

    def _hatch(self) -> str:
        identifier = f"{self.key}-hatch"
        if not any(f'id="{identifier}"' in part for part in self.parts):
            self._add(
                f'<pattern id="{identifier}" width="4" height="4" patternUnits="userSpaceOnUse" '
                f'patternTransform="rotate(45)"><rect width="4" height="4" fill="{self._tint(style.GRID)}"/>'
                f'<path d="M0 0V4" {_line(self._tint(style.MUTED), 1.2)}/></pattern>'
            )
        return identifier

    def _box_text(self, frame: Frame, box: Box) -> None:
        if not box.text or box.low is None or box.high is None:
            return
        y = frame.y.at(0.5 * (box.low + box.high)) + 0.35 * SMALL
        if not box.beside:
            x = frame.x.at(0.5 * (box.left + box.right))
            self._text(x, y, box.text, SMALL - 1.0, style.INK, "middle")
        elif box.right + box.left >= 0.0:
            self._text(frame.x.at(box.right) + 5.0, y, box.text, SMALL, style.INK, halo=True)
        else:
            self._text(frame.x.at(box.left) - 5.0, y, box.text, SMALL, style.INK, "end", halo=True)

    def _bar_text(self, frame: Frame, curve: Curve) -> None:
        """Write a text next to a bar, on the side with more room."""
        x, y = frame.x.at(float(curve.x[0])), frame.y.at(float(np.mean(curve.y)))
        right = x - frame.x.begin < 0.85 * frame.wide
        anchor = "start" if right else "end"
        y = float(np.clip(y, frame.y.end + SMALL, frame.y.begin - SMALL))
        self._text(x + (5.0 if right else -5.0), y + 0.35 * SMALL, curve.caption, SMALL, style.INK, anchor, halo=True)

    def _note(self, frame: Frame, note: Note) -> None:
        x, y, lines = frame.x.at(note.x), frame.y.at(note.y), note.text.count("\n")
        tint = _color(note.number, style.MUTED)
        down = lines * LINE * SMALL
        if note.middle:
            self._text(x, y + 0.35 * SMALL - 0.5 * down, note.text, SMALL, tint, "middle", halo=True)
        elif note.right:
            self._text(x + 3.0, y - 3.0 - down, note.text, SMALL, tint, halo=True)
        else:
            self._text(x - 5.0, y + 5.0 + 0.8 * SMALL, note.text, SMALL, tint, "end", halo=True)

    def _field(self, frame: Frame, values: Field, scale: Heat) -> None:
        """Draw a field as areas of one color step each; of more columns than points the largest value counts."""
        columns = values.values
        edges = frame.x(cell_edges(values.x))
        rows = frame.y(cell_edges(values.y))
        most = max(1, int(frame.wide / _NARROW))
        if columns.shape[1] > most:
            first = np.linspace(0, columns.shape[1], most + 1).astype(int)[:-1]
            columns, edges = np.maximum.reduceat(columns, first, axis=1), np.append(edges[first], edges[-1])
        steps = style.heat_step(columns, scale)
        paths = dict[int, list[str]]()
        for row in range(steps.shape[0]):
            ends = np.flatnonzero(np.diff(steps[row])) + 1
            top, tall = float(rows[row + 1]), float(rows[row] - rows[row + 1])
            for a, b in zip([0, *ends.tolist()], [*ends.tolist(), steps.shape[1]], strict=True):
                if np.isfinite(steps[row, a]):
                    wide = float(edges[b] - edges[a])
                    area = f"M{_n(edges[a])} {_n(top)}h{_n(wide)}v{_n(tall)}h{_n(-wide)}z"
                    paths.setdefault(int(steps[row, a]), []).append(area)
        for k, areas in sorted(paths.items()):
            tint = self._tint(style.heat(k))
            self._add(f'<path d="{"".join(areas)}" fill="{tint}" shape-rendering="crispEdges"/>')

    def _scale(self, frame: Frame) -> None:
        """Draw the color bar of a panel."""
        heat, y, steps = frame.panel.heat, frame.y, style.HEAT_STEPS
        assert heat is not None
        axis = Axis(*heat_range(frame.panel), False, y.begin, y.end)
        left, tall = frame.x.end + 8.0, frame.tall / steps
        for k in range(steps):
            place = f'x="{_n(left)}" y="{_n(y.begin - (k + 1) * tall)}" width="{BAR}" height="{_n(tall)}"'
            self._add(f'<rect {place} fill="{self._tint(style.heat(k))}" shape-rendering="crispEdges"/>')
        divided = divide(axis, looks.LINEAR, min(9.0, max(2.0, frame.tall / 22.0)))
        path = "".join(f"M{_n(left + BAR)} {_n(axis.at(value))}h{TICK}" for value in divided.values)
        self._add(f'<path d="{path}" {_line(self._tint(style.MUTED), 0.8)}/>')
        right = left + BAR + TICK + GAP
        for value, text in zip(divided.values, divided.texts, strict=True):
            self._text(right, axis.at(value) + 0.35 * SMALL, text, SMALL, style.INK)
        right += max(width(text, SMALL) for text in divided.texts) + TEXT + 3.0
        label = f"{heat.label} {divided.power}".rstrip()
        self._text(right, 0.5 * (y.begin + y.end), label, TEXT, style.INK, "middle", -90.0)

    def _marks(self, frame: Frame) -> None:
        """Draw the marks of a panel and their names."""
        x, y = frame.x, frame.y
        marks = [mark for mark in frame.panel.marks if x.holds(mark.x) and y.holds(mark.y)]
        for mark in marks:
            shape, _ = _marker(style.marker(mark.number), 0.5 * (6.0 if mark.name else 4.5))
            tint = self._tint(_color(mark.number))
            fill = self._tint(style.PAPER) if mark.hollow else tint
            hint = f"<title>{escape(mark.caption)}</title>" if mark.caption else ""
            path = f"M{_n(x.at(mark.x))} {_n(y.at(mark.y))}{shape}"
            self._add(f'<path d="{path}" fill="{fill}" stroke="{tint}">{hint}</path>')
        at = dict[tuple[float, float], list[Mark]]()
        for mark in marks:
            if mark.name:
                place = x.at(mark.x), -y.at(mark.y)  # y up, as for the places of labels
                near = next((there for there in at if np.hypot(there[0] - place[0], there[1] - place[1]) < 2.0), place)
                at.setdefault(near, []).append(mark)
        taken = [(px - 4.0, py - 4.0, px + 4.0, py + 4.0) for px, py in at]
        edge = x.begin, -y.begin, x.end, -y.end
        size = SMALL - 1.0
        for (px, py), there in at.items():
            text, tint = ", ".join(style.titled(mark.name) for mark in there), _color(there[0].number)
            box = placing.free_spot((px, py), (width(text, size), LINE * size + 1.0), taken, edge)
            taken.append(box)
            ex, ey = min(max(px, box[0]), box[2]), min(max(py, box[1]), box[3])
            if np.hypot(ex - px, ey - py) > 0.8 * placing.STEP:
                self._add(f'<path d="M{_n(px)} {_n(-py)}L{_n(ex)} {_n(-ey)}" {_line(self._tint(tint), 0.7)}/>')
            middle = -0.5 * (box[1] + box[3]) + 0.35 * size
            self._text(0.5 * (box[0] + box[2]), middle, text, size, tint, "middle", halo=True)

    def _text(
        self,
        x: float,
        y: float,
        text: str,
        size: float,
        color: str,
        anchor: str = "start",
        turn: float = 0.0,
        *,
        halo: bool = False,
        spacing: float = LINE,
    ) -> None:
        """Write a text with its first base line at y; turned about (x, y), further lines to the right of it."""
        if not text:
            return
        head = f'<text x="{_n(x)}" y="{_n(y)}" font-size="{_n(size)}" fill="{self._tint(color)}"'
        head += f' text-anchor="{anchor}"' if anchor != "start" else ""
        head += f' transform="rotate({_n(turn)} {_n(x)} {_n(y)})"' if turn else ""
        # readable over curves, too
        head += f' stroke="{self._tint(style.PAPER)}" stroke-width="2.5" paint-order="stroke"' if halo else ""
        first, *further = (escape(line, quote=False) for line in text.split("\n"))
        lines = "".join(f'<tspan x="{_n(x)}" dy="{_n(spacing * size)}">{line}</tspan>' for line in further)
        self._add(f"{head}>{first}{lines}</text>")

    def _tint(self, color: str) -> str:
        return self.colors.get(color, color)

    def _identifier(self) -> str:
        self.identifiers += 1
        return f"{self.key}-{self.identifiers}"

    def _add(self, element: str) -> None:
        self.parts.append(element)


def _description(frames: Sequence[Frame]) -> str:
    """Return what the picture shows, in words: the axes of each panel and the names of its curves."""
    said = list[str]()
    for frame in frames:
        names = list(dict.fromkeys(style.shortened(curve.name) for curve in frame.panel.curves if curve.name))
        axes = " over ".join(label.replace("\n", " ") for label in (frame.panel.label, frame.abscissa.label) if label)
        said.append(f"{axes}: {', '.join(names)}" if names and axes else axes or ", ".join(names))
    return "; ".join(text for text in said if text)


def _neutral(curve: Curve) -> str:
    return style.MUTED if curve.look == looks.WIDE else style.INK


def _color(number: int, neutral: str = style.INK) -> str:
    return style.ALERT if number == looks.ALERT else neutral if number < 0 else style.color(number)


def _decade(axis: Axis) -> float:
    """Return the length of a decade of a logarithmic axis, else of the axis."""
    return abs(axis.end - axis.begin) / (float(np.log10(axis.high / axis.low)) if axis.log else 1.0)


def _hint(curve: Curve) -> str:
    """Return the name of a curve, shown where the pointer rests on it."""
    text = style.titled(curve.name, curve.caption)
    return f"<title>{escape(text)}</title>" if text else ""


def _line(tint: str, wide: float, dashes: Sequence[float] = (), fill: str = 'fill="none" ') -> str:
    dashed = f' stroke-dasharray="{" ".join(map(_n, dashes))}"' if len(dashes) else ""
    return f'{fill}stroke="{tint}" stroke-width="{_n(wide)}"{dashed}'


def _circle(r: float) -> str:
    """Return the path of a circle from its left end."""
    arc = f"a{_n(r)} {_n(r)} 0 1 0 "
    return f"{arc}{_n(2.0 * r)} 0{arc}{_n(-2.0 * r)} 0z"


def _marker(marker: str, r: float) -> tuple[str, bool]:
    """Return the path of a marker from its middle, and True if it is an area."""
    a, d, p = _n(r), _n(r * np.sqrt(2.0)), _n(r / 3.0)
    two, q = _n(2.0 * r), _n(2.0 * r / 3.0)
    shapes = {
        "s": f"m-{a} -{a}h{two}v{two}h-{two}z",
        "^": f"m0 -{a}l{a} {two}h-{two}z",
        "v": f"m0 {a}l{a} -{two}h-{two}z",
        "D": f"m0 -{d}l{d} {d}l-{d} {d}l-{d} -{d}z",
        "P": f"m-{p} -{a}h{q}v{q}h{q}v{q}h-{q}v{q}h-{q}v-{q}h-{q}v-{q}h{q}z",
    }
    if marker == "+":
        return f"m-{a} 0h{two}m-{a} -{a}v{two}", False
    if marker == "x":
        return f"m-{a} -{a}l{two} {two}m-{two} 0l{two} -{two}", False
    return shapes.get(marker, f"m-{a} 0{_circle(r)}"), True


def _steps(x: np.ndarray, y: np.ndarray) -> str:
    """Return the path of a line in units of `_FINE`: its first place, then steps, whose sum is exact."""
    places = np.rint(np.column_stack([x, y]) / _FINE).astype(np.int64)
    steps = np.diff(places, axis=0)
    steps = steps[np.any(steps != 0, axis=1)]
    if not steps.size:
        return ""
    body = " ".join(map(str, steps.ravel().tolist())).replace(" -", "-")
    return f"M{places[0, 0]} {places[0, 1]}l{body}"


def _n(value: float) -> str:
    """Return a length to a hundredth of a point, in the shortest form."""
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
