"""Pictures of pages: points lie where the ticks say, peaks stay, texts cover no other text and stay inside."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import svg_texts
from feeddrive.plot import placing, style, ticks
from feeddrive.plot.chart import (
    DASHED,
    DEGREES,
    DOTS,
    FREQUENCY,
    LINEAR,
    LOG,
    PANELS,
    RIGHT,
    Abscissa,
    Band,
    Box,
    Chart,
    Curve,
    Field,
    Heat,
    Level,
    Mark,
    Note,
    Panel,
    Tick,
    listed,
)
from feeddrive.plot.layout import Layout
from feeddrive.plot.polyline import TOLERANCE, cut, thinned
from feeddrive.report.svg import svg_element

T = np.linspace(0.0, 2.0, 3000)
ROUNDED = 0.011  # points: places are written to a hundredth


def drawn(chart: Chart) -> str:
    return svg_element(chart, "k", "a picture of a test")


def lines(picture: str) -> list[np.ndarray]:
    """The places of each curve in points, shape (n, 2), from the steps of its path."""
    found = list[np.ndarray]()
    for path in re.findall(r'<path d="([^"]*)" transform="scale\(0.01\)"', picture):
        for piece in path.split("M")[1:]:
            first, _, steps = piece.partition("l")
            moves = np.array([int(number) for number in re.findall(r"-?\d+", steps)]).reshape(-1, 2)
            start = np.array([int(number) for number in first.split()])
            found.append(0.01 * np.vstack([start, start + np.cumsum(moves, axis=0)]))
    return found


def value(text: str) -> float:
    """The number of a tick."""
    if power := re.fullmatch(r"(?:(\d)·)?10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", text):
        raised = power[2].translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))
        return float(f"{power[1] or 1}e{raised}")
    return float(text.replace("\u2212", "-"))


def scale(picture: str, *, across: bool, log: bool) -> tuple[float, float]:
    """Slope and offset from values (of their logarithms) to places, fitted to the texts of the ticks of an axis."""
    anchor = "middle" if across else "end"
    found = re.findall(
        rf'<text x="([\d.]+)" y="([\d.]+)" font-size="8.5"[^>]* text-anchor="{anchor}">([^<]*)<', picture
    )
    at = np.array([float(x) if across else float(y) - 0.35 * style.SMALL for x, y, _ in found])
    values = np.array([value(text) for _, _, text in found])
    assert at.size >= 2
    return tuple(np.polyfit(np.log10(values) if log else values, at, 1))  # type: ignore[return-value]


@pytest.mark.parametrize("scales", [(LINEAR, LINEAR), (FREQUENCY, LOG), (LOG, LINEAR), (LINEAR, DEGREES)])
def test_points_of_a_curve_lie_where_the_ticks_say(scales: tuple[str, str]) -> None:
    """Read back by the texts of the ticks, which are placed apart from the curve."""
    x = np.geomspace(0.7, 432.1, 40)
    y = np.geomspace(3e-3, 80.0, 40)[::-1] * (1.0 + 0.5 * np.sin(np.arange(40.0)))
    low, high = (float(y.min()), float(y.max())) if scales[1] == DEGREES else (None, None)
    panel = Panel("y (µm)", (Curve(x, y),), scale=scales[1], low=low, high=high)
    picture = drawn(Chart("x (Hz)", (panel,), scales[0], 0.7, 432.1))
    (places,) = lines(picture)
    logs = scales[0] in (LOG, FREQUENCY), scales[1] == LOG
    across, up = (scale(picture, across=each, log=log) for each, log in zip((True, False), logs, strict=True))
    expected = np.column_stack(
        [
            np.polyval(across, np.log10(x) if logs[0] else x),
            np.polyval(up, np.log10(y) if logs[1] else y),
        ]
    )
    assert len(places) > 20
    for place in places:
        assert np.min(np.hypot(*(expected - place).T)) < 2.0 * ROUNDED
    assert places[0] == pytest.approx(expected[0], abs=2.0 * ROUNDED)
    assert places[-1] == pytest.approx(expected[-1], abs=2.0 * ROUNDED)


def test_a_peak_of_one_sample_in_300000_is_drawn_at_its_height() -> None:
    x, y = np.linspace(0.0, 10.0, 300_000), 0.1 * np.random.default_rng(1).normal(size=300_000)
    y[254_321], y[123_456] = 50.0, -20.0
    picture = drawn(Chart("time (s)", (Panel("force (N)", (Curve(x, y),)),)))
    (places,) = lines(picture)
    across, up = (scale(picture, across=each, log=False) for each in (True, False))
    peaks = [places[np.argmin(places[:, 1])], places[np.argmax(places[:, 1])]]
    for peak, k in zip(peaks, (254_321, 123_456), strict=True):
        # the least and the largest point of a column keep their places
        assert peak == pytest.approx([np.polyval(across, x[k]), np.polyval(up, y[k])], abs=2.0 * ROUNDED)
    assert len(picture) < 60_000


def distances(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """The distance of each point from a line through others."""
    a, d = line[:-1], np.diff(line, axis=0)
    long = np.maximum(np.sum(d * d, axis=1), 1e-300)
    part = np.clip(np.sum((points[:, None] - a) * d, axis=2) / long, 0.0, 1.0)
    return np.min(np.hypot(*np.moveaxis(points[:, None] - a - part[..., None] * d, 2, 0)), axis=1)


@given(st.integers(0, 2**32 - 1))
def test_a_thinned_line_is_near_to_every_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn = np.cumsum(rng.normal(scale=rng.choice([1e-3, 0.03, 1.0]), size=150))
    step = rng.choice([0.01, 0.5, 20.0]) * rng.random(150)
    x, y = np.cumsum(step * np.cos(turn)), np.cumsum(step * np.sin(turn))
    kept = np.column_stack(thinned(x, y))
    assert kept[0] == pytest.approx([x[0], y[0]])
    assert kept[-1] == pytest.approx([x[-1], y[-1]])
    # 0.5: a column of a dense line over x
    bound = TOLERANCE if not np.all(np.diff(x) >= 0.0) else 0.5 + TOLERANCE
    assert np.max(distances(np.column_stack([x, y]), kept)) <= bound


def test_a_smooth_line_keeps_few_points() -> None:
    angle = np.linspace(0.0, 6.0, 20_000)
    assert thinned(200.0 * np.cos(angle), 200.0 * np.sin(angle))[0].size < 800


@given(st.integers(0, 2**32 - 1))
def test_a_line_is_cut_where_it_crosses_the_edge(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(scale=30.0, size=(2, 12))
    x[rng.integers(12)] = np.nan
    box = -10.0, -20.0, 15.0, 25.0
    pieces = [np.column_stack(piece) for piece in cut(x, y, box)]
    for piece in pieces:
        assert np.all((piece[:, 0] > box[0] - 1e-9) & (piece[:, 0] < box[2] + 1e-9))
        assert np.all((piece[:, 1] > box[1] - 1e-9) & (piece[:, 1] < box[3] + 1e-9))
    part = np.linspace(0.0, 1.0, 21)[:, None]
    whole = np.column_stack([x, y])
    points = np.vstack([a + part * (b - a) for a, b in pairwise(whole)])
    inside = (points[:, 0] > box[0]) & (points[:, 0] < box[2]) & (points[:, 1] > box[1]) & (points[:, 1] < box[3])
    if np.any(inside):
        assert np.max(np.min([distances(points[inside], piece) for piece in pieces], axis=0)) < 1e-9


@given(
    st.floats(-1e7, 1e7),
    st.floats(1e-6, 1e7),
    st.floats(1.0, 10.0),
)
def test_linear_ticks_are_round_and_read_back(low: float, span: float, most: float) -> None:
    high = low + span
    if span < 1e-9 * max(abs(low), abs(high)):
        return
    found = ticks.linear(low, high, most)
    step = (high - low) / most
    assert len(found.values) <= most + 1.0 + 1e-6
    assert all(low - 1e-5 * span <= each <= high + 1e-5 * span for each in found.values)
    factor = value(found.power.removeprefix("×")) if found.power else 1.0
    steps = np.diff(found.values)
    # at most 2.5 times the least step, 1, 2 or 5 times a power of ten, and the texts say it exactly
    assert np.all((steps > 0.99 * step) & (steps < 2.51 * step))
    for each, text in zip(found.values, found.texts, strict=True):
        assert value(text) * factor == pytest.approx(each, abs=1e-6 * span, rel=1e-9)
        assert "-" not in text


@given(st.floats(-12.0, 8.0), st.floats(0.02, 14.0), st.floats(1.0, 10.0))
def test_logarithmic_ticks_read_back(start: float, decades: float, most: float) -> None:
    low, high = 10.0**start, 10.0 ** (start + decades)
    found = ticks.logarithmic(low, high, most)
    assert len(found.values) >= 1 or most < 3.0
    factor = value(found.power.removeprefix("×")) if found.power else 1.0
    for each, text in zip(found.values, found.texts, strict=True):
        assert low * (1.0 - 1e-5) <= each <= high * (1.0 + 1e-5)
        assert value(text) * factor == pytest.approx(each, rel=1e-6)
    assert not set(found.values) & set(found.minor)


def test_numbers_of_a_logarithmic_axis() -> None:
    assert list(ticks.logarithmic(11.0, 250.0, 10.0).texts) == ["20", "50", "100", "200"]
    assert list(ticks.logarithmic(1.0, 1000.0, 10.0).texts) == ["1", "10", "100", "1000"]
    assert list(ticks.logarithmic(1e-7, 1e7, 4.0).texts) == ["10⁻⁴", "1", "10000"]
    assert list(ticks.logarithmic(1.1, 1.9, 4.0).texts) == ["1.2", "1.4", "1.6", "1.8"]
    assert [ticks.decade_text(each) for each in (2e-5, 8e4, 1e5)] == ["2·10⁻⁵", "80000", "10⁵"]


def test_numbers_of_linear_axes() -> None:
    for most, step in ((10.0, 1.0), (5.0, 2.0), (2.0, 5.0), (1.0, 10.0)):
        assert list(ticks.linear(0.0, 10.0, most).values) == list(np.arange(0.0, 10.1, step))
    assert list(ticks.degrees(0.0, 360.0, 8.0).values) == list(np.arange(0.0, 361.0, 45.0))
    assert list(ticks.degrees(0.0, 60.0, 6.0).values) == list(np.arange(0.0, 61.0, 10.0))
    assert [ticks.phase_step(0.0, span) for span in (45.0, 500.0, 1e4)] == [15.0, 90.0, 720.0]
    assert [ticks.linear(0.0, high, 2.0).power for high in (8e5, 1.5e6, 1.5e-3, 8e-4)] == ["", "×10⁶", "", "×10⁻⁶"]
    assert list(ticks.linear(-0.2, 0.2, 4.0).texts) == ["−0.2", "−0.1", "0.0", "0.1", "0.2"]


LONG = "the position that the table would have without any friction of its ways"


def crowded(legend: str) -> Chart:
    """A chart with all that takes room."""
    curves = tuple(Curve(T, (k + 1.0) * np.sin((k + 5.0) * T), f"{k} {LONG}"[:58], k) for k in range(5))
    limit = Level(4.0, "a limit", dashed=True, caption="a limit that the legend names")
    near = tuple(Level(x, f"line at {x} Hz", upright=True, dashed=True) for x in (0.50, 0.51, 0.52, 1.99))
    marks = tuple(Mark(0.5, 0.1 * k, name=f"mark {k}", caption="what it says") for k in range(4))
    first = Panel(f"{LONG} (µm)", curves, marks, (limit, *near), notes=(Note(1.0, 0.0, "a note\nof two lines"),))
    second = Panel("snap (m/s⁴)", (Curve(T, 1e9 * T, "a"),), caption="a line of text above this panel")
    third = Panel("", boxes=(Box(0.0, 1.0, -0.3, 0.3, text="1", beside=True),), ticks=listed(["a long name of a row"]))
    return Chart("time (s)", (first, second, third), height=6.0, legend=legend, caption="a warning", side="all rows")


@pytest.mark.parametrize("legend", ["above", RIGHT, PANELS])
def test_no_text_covers_another_one_or_leaves_the_picture(legend: str) -> None:
    picture = drawn(crowded(legend))
    assert svg_texts.overlapping(picture) == []
    assert svg_texts.outside(picture) == []
    shown = [written.text.replace("\n", " ") for written in svg_texts.texts(picture)]
    for text in ("a warning", "all rows", "a line of text above this panel", "a limit that the legend names", "×10⁹"):
        assert text in shown
    # texts over curves keep clear of each other, too
    over = [written for written in svg_texts.texts(picture) if written.over and written.text.startswith("line at")]
    assert len(over) == 4
    assert not [
        (a.text, b.text) for i, a in enumerate(over) for b in over[:i] if placing.shared(a.box, b.box) > svg_texts.SLACK
    ]


def test_a_legend_stands_apart_from_all_panels() -> None:
    for legend in ("above", RIGHT, PANELS):
        layout = Layout(crowded(legend))
        assert all(frame.tall >= 30.0 - 1e-9 for frame in layout.frames)
        for frame in layout.frames:
            assert frame.y.end - layout.over(frame) >= layout.inside[1] - 1e-9
            assert frame.x.end <= layout.inside[2] + 1e-9
    few = Chart("x", (Panel("y", (Curve(T, T, "a"), Curve(T, -T, "b", 1))),))
    many = replace(few, panels=(Panel("y", tuple(Curve(T, k * T, f"{k} {LONG}"[:58], k) for k in range(6))),))
    short, long = Layout(few), Layout(many)
    # further rows make the picture higher, not the panel lower
    assert long.tall > short.tall + 20.0
    assert long.frames[0].tall == pytest.approx(short.frames[0].tall, abs=0.01)


def test_numbers_of_narrow_panels_do_not_touch() -> None:
    for most, least in ((1.0, 0.0), (12345.678, 0.0), (1e-5, 0.0), (3e12, 0.0), (1e-3, 1000.0)):
        panels = tuple(Panel("y", (Curve(least + most * T, most * T),), abscissa=Abscissa(f"x {k}")) for k in range(4))
        picture = drawn(Chart("", panels, across=4))
        assert svg_texts.overlapping(picture) == []
        assert "rotate(-40 " not in picture  # fewer numbers, and none slanted
    names = tuple(Tick(float(k), f"a long name for {k}") for k in range(9))
    picture = drawn(Chart("", (Panel("y", (Curve(8.0 * T / 2.0, T),)),), ticks=names))
    assert len(re.findall(r"rotate\(-40 ", picture)) == 9  # slanted where they do not fit


def test_equal_scales_of_x_and_y() -> None:
    for square in (
        Chart("x", (Panel("y", (Curve(T, 0.2 * T),)),), square=True),
        Chart("x", (Panel("y", (Curve(T, T),), low=-1.0, high=3.0),), square=True, low=-2.0, high=4.0),
    ):
        (frame,) = Layout(square).frames
        assert frame.wide / (frame.x.high - frame.x.low) == pytest.approx(frame.tall / (frame.y.high - frame.y.low))
    assert (frame.x.low, frame.x.high, frame.y.low, frame.y.high) == (-2.0, 4.0, -1.0, 3.0)  # as given


def test_texts_of_people_are_texts_and_colors_in_them_stay() -> None:
    name = '<b>&"#0072b2'
    panel = Panel(
        name, (Curve(T, T, name),), (Mark(1.0, 1.0, name=name, caption=name),), (Level(1.0, name, caption=name),)
    )
    picture = svg_element(Chart(name, (panel,)), "k", name, {style.COLORS[0]: "var(--curve-0)"})
    root = ET.fromstring(picture)
    assert root.attrib["aria-label"] == name
    shown = [written.text for written in svg_texts.texts(picture)]
    assert shown.count(name) >= 5  # labels, legend, mark, level
    assert 'stroke="var(--curve-0)"' in picture
    titles = [element.text for element in root.iter() if svg_texts.tag(element) == "title"]
    assert titles.count(name) == 2  # shown where the pointer rests on the curve and on the mark
    described = next(element.text for element in root if svg_texts.tag(element) == "desc")
    assert described == f"{name} over {name}: {name}"


def test_what_a_chart_cannot_show_is_left_out() -> None:
    """Numbers that are not finite, ranges of one value, values below zero on a logarithmic axis."""
    bad = np.array([np.nan, 1.0, np.inf, 2.0, -np.inf, 3.0, np.nan])
    x = np.arange(7.0)
    band = Band(x, bad - 1.0, bad)
    for scale_ in (LINEAR, LOG):
        picture = drawn(
            Chart("x", (Panel("y", (Curve(x, bad), Curve(x, bad, look=DOTS)), bands=(band,), scale=scale_),))
        )
        assert not re.search(r"nan|inf", picture)
        ET.fromstring(picture)
    still = drawn(Chart("x", (Panel("y", (Curve(T, np.zeros(3000)),)), Panel("z", (Curve(T, np.full(3000, 7.0)),)))))
    assert len(lines(still)) == 2
    empty = drawn(Chart("x", (Panel("y"), Panel("z", scale=LOG))))
    assert not re.search(r"nan|inf", empty)


def test_heat_is_drawn_in_its_steps_and_a_field_in_areas() -> None:
    heat = np.linspace(0.0, 12.0, 3000)
    panel = Panel("y", (Curve(T, T, heat=heat),), heat=Heat("error (µm)", 0.0, 12.0))
    picture = drawn(Chart("x", (panel,)))
    colors = re.findall(r'transform="scale\(0.01\)" fill="none" stroke="(#\w+)"', picture)
    assert colors == [style.heat(k) for k in range(12)]
    assert (colors[0], colors[-1]) == (style.HEAT[0], style.HEAT[-1])
    places = lines(picture)
    across = scale(picture, across=True, log=False)
    # the color changes where the value does: every twelfth of the way
    assert [np.polyval(across, k / 6.0) for k in range(12)] == pytest.approx([p[0, 0] for p in places], abs=0.3)
    field = Field(T[:4], np.arange(3.0), np.arange(12.0).reshape(3, 4))
    picture = drawn(Chart("x", (Panel("y", field=field, heat=Heat("z", 0.0, 12.0)),)))
    areas = re.findall(r'<path d="([^"]*)" fill="(#\w+)" shape-rendering', picture)
    assert [color for _, color in areas] == [style.heat(k) for k in range(12)]
    assert all(path.count("M") == 1 for path, _ in areas)


def test_curves_have_the_dashes_of_their_numbers() -> None:
    curves = tuple(Curve(T, T + k, f"{k}", k) for k in range(6))
    picture = drawn(Chart("x", (Panel("y", (*curves, Curve(T, -T, look=DASHED))),)))
    dashes = re.findall(r'transform="scale\(0.01\)" [^>]*stroke-width="140"(?: stroke-dasharray="([^"]*)")?', picture)
    expected = [" ".join(f"{140 * part:g}" for part in style.DASHES[k]) for k in range(6)]
    assert dashes == [*expected, "560 280"]
    # the legend shows the same, at its own scale
    legend = re.findall(
        r'H[\d.]+" fill="none" stroke="#\w+" stroke-width="1.4"(?: stroke-dasharray="([^"]*)")?', picture
    )
    assert legend == [" ".join(f"{1.4 * part:g}" for part in style.DASHES[k]) for k in range(6)]
