"""The report: self-contained, small, valid, readable in both color schemes, and safe with any text in it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from importlib import import_module
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import scipy.io

from feeddrive.analysis.replay import replay
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.actuator.direct import Direct
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Reference
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import DRAWN, Quantity, number, unit_name
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import compliance, loop_gain, tracking
from feeddrive.loop.loop import Loop, Signals
from feeddrive.loop.simulate import Run, simulate
from feeddrive.plot import style
from feeddrive.plot.chart import Chart, Curve, Panel
from feeddrive.plot.drawing import drawn as draw_chart
from feeddrive.report import machining_report as part_report
from feeddrive.report.laws import Entry, LawsContents, _judged, remark_sentences, response_lines, result_sentences
from feeddrive.report.laws_report import chosen, laws_report
from feeddrive.report.laws_report import pictures as laws_pictures
from feeddrive.report.page import THEME, html, svg
from feeddrive.report.report import Picture, Report, Section, Verdict

LOG = Path(__file__).parents[2].parent / "shared" / "data" / "emps" / "DATA_EMPS.mat"
GTAU = 35.15065188248547  # N at the carriage per V, published
F = np.geomspace(1.0, 500.0, 1500)
NAMES = ("today", "with feedforward")
# the axis of Janot, Gautier & Brunot 2019, with their direction-dependent friction
AXIS = Axis(
    plant=Rigid(mass=95.1540),
    friction_load=Directional(
        coulomb_positive=20.1440, coulomb_negative=20.6277, viscous_positive=166.7061, viscous_negative=240.4236
    ),
    actuator=Actuator(motor=Direct(force_constant=GTAU, peak_force=10 * GTAU, continuous_force=40.0)),
    encoder_load=Encoder(resolution=50e-9),
)


class Stroke(Reference):
    """Out and back by 0.2 m with sin² velocity."""

    @property
    def duration(self) -> float:
        return 3.0

    def at(self, t: np.ndarray) -> Setpoint:
        w = 2 * np.pi / 3.0
        c, s = 0.1 * np.cos(w * t), 0.1 * np.sin(w * t)
        return Setpoint(0.1 - c, w * s, w**2 * c, -(w**3) * s, -(w**4) * c)


def loop(feedforward: bool, encoder: Encoder | None = None) -> Loop:
    law = CascadePPI(Kv=160.18, Kp=243.45 * GTAU, velocity_feedforward=1.0 if feedforward else 0.0, velocity_samples=2)
    forward = (Inertia(mass=95.1540, viscous=203.56),) if feedforward else ()
    axis = AXIS if encoder is None else replace(AXIS, encoder_load=encoder)
    return Loop(sample_time=1e-3, control=Control(law=law, feedforward=forward, force_limit=10 * GTAU), axis=axis)


def entry(name: str, made: Loop, **more) -> Entry:
    more.setdefault("run", simulate(made, Stroke(), name=name))
    return Entry(
        name=name,
        description="a P-PI cascade",
        loop=made,
        loop_gain=loop_gain(made, F),
        compliance=compliance(made, F),
        tracking=tracking(made, F),
        **more,
    )


@cache
def compared() -> LawsContents:
    entries = [entry(name, loop(feedforward)) for name, feedforward in zip(NAMES, (False, True), strict=True)]
    return LawsContents(
        title="EMPS axis: what is feedforward worth?",
        entries=entries,
        facts={"Machine": "EMPS ball-screw axis", "Noise": "seed 0"},
        rule="Equal gains; not equal margins.",
        job='title = "EMPS"\nmachine = "emps"\n',
        versions={"feeddrive": "0.1.0"},
        notes=["Nothing was fitted."],
    )


@cache
def page() -> str:
    return build(compared())


@cache
def bare() -> LawsContents:
    """One law without responses."""
    return LawsContents("bare", [replace(compared().entries[0], loop_gain=None, compliance=None, tracking=None)])


@cache
def bare_page() -> str:
    return build(bare())


@cache
def replayed() -> LawsContents:
    if not LOG.exists():
        pytest.skip(
            f"THE MEASURED LOG IS MISSING: {LOG.name} is not at ../shared/data/emps; the report of it is not tested"
        )
    log = {key: value.ravel() for key, value in scipy.io.loadmat(LOG).items() if isinstance(value, np.ndarray)}
    measured = {"set_position": log["qg"], "position_load": log["qm"], "force": GTAU * log["vir"]}
    made = loop(False)
    again = replay(made, measured, skip=49)
    return replace(compared(), title="measured", entries=[entry("today", made, run=again.run, replay=again)])


def build(contents: LawsContents) -> str:
    return html(laws_report(contents))


class Structure(HTMLParser):
    """Collects what a page is made of, and checks that every element is closed."""

    VOID = frozenset({"meta", "br", "hr"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def read(value: float, unit: str) -> str:
    """A number as a page shows it."""
    return DRAWN.text(Quantity(value, unit, form="3"))


def structure(text: str) -> Structure:
    found = Structure()
    found.feed(text)
    found.close()
    assert found.open == []
    return found


def pictures(text: str) -> list[str]:
    return re.findall(r"<svg.*?</svg>", text, flags=re.DOTALL)


def check_page(text: str) -> None:
    """What holds for every report."""
    assert len(text.encode()) < 1_000_000
    assert re.findall(r"https?:|//[a-z]|\ssrc=|@import|<script|<link|<iframe|\bon[a-z]+=", text) == []
    assert re.findall(r"url\((?!#)|href=\"(?!#)", text) == []
    assert re.search(r"\bnan\b", text, flags=re.IGNORECASE) is None
    found = structure(text)
    names = [name for name, _ in found.tags]
    assert names.count("h1") == names.count("main") == names.count("title") == 1
    assert dict(found.tags[[name for name, _ in found.tags].index("html")][1]) == {"lang": "en"}
    policy = next(
        attrs["content"] for name, attrs in found.tags if attrs.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy is not None
    assert policy.startswith("default-src 'none'")
    ids = [attrs["id"] for _, attrs in found.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    targets = [attrs["href"] for _, attrs in found.tags if "href" in attrs] + re.findall(r"url\((#[^)]*)\)", text)
    assert {target.lstrip("#") for target in targets if target} <= set(ids)
    assert names.count("figure") == names.count("figcaption") == names.count("svg") == len(pictures(text))


def check_order(text: str) -> None:
    """The verdict, then a picture, then tables, then folded details."""
    places = [text.find(each) for each in ('<div class="lead', "<figure", "<table", "<details")]
    there = [place for place in places if place >= 0]
    assert places[0] > 0
    assert there == sorted(there)
    assert "<section" not in text[text.index("<details") :] if "<details" in text else True


def check_pictures(text: str) -> None:
    """Each is XML by itself, says what it shows, and takes all its colors from the page."""
    for drawing in pictures(text):
        root = ET.fromstring(drawing)
        assert root.attrib["role"] == "img"
        assert len(root.attrib["aria-label"]) > 20
        assert (
            re.findall(
                r"#[0-9a-f]{6}\b|#[0-9a-f]{3}\b|\bblack\b|\bwhite\b", re.sub(r"(href=\"|url\()#\w+", "", drawing)
            )
            == []
        )
        assert "var(--ink)" in drawing


def test_the_report_of_a_comparison() -> None:
    text = page()
    check_page(text)
    check_pictures(text)
    found = structure(text)
    for expected in (*NAMES, "EMPS ball-screw axis", "Equal gains", "seed 0", 'machine = "emps"', "Nothing was fitted"):
        assert expected in found.text
    titles = re.findall(r"<h3>(.*?)</h3>", text)
    check_order(text)
    for expected in (
        "Following error over time",
        "Amplitude spectrum of the following error",
        "Force",
        "Friction",
        "Velocity and acceleration",
        "Open loop and its margins",
        "Nyquist plot near -1",
        "Closed loop",
        "Dynamic stiffness",
    ):
        assert expected in titles
    assert "Measured and predicted" not in titles


def test_the_report_of_a_measured_log() -> None:
    text = build(replayed())
    check_page(text)
    check_pictures(text)
    found = structure(text).text
    assert "Measured and predicted" in found
    again = replayed().entries[0].replay
    assert again is not None
    # the published replay of this axis with this friction stands at 1.23 um (RMS after the first 49 samples)
    assert 1e6 * again.rms("position_load") == pytest.approx(1.23, abs=0.05)
    assert f"{read(again.rms('position_load'), 'm')} RMS" in found
    # table and picture count the same samples
    one = replayed().entries[0]
    assert number(1e6 * one.rms("following_error"), 3) in found
    assert f"RMS {1e6 * one.rms('following_error'):.4g} µm, peak {1e6 * one.peak('following_error'):.4g} µm" in found


def test_the_table_holds_the_figures_of_the_run() -> None:
    text = structure(page()).text
    for one in compared().entries:
        assert number(1e6 * one.rms("following_error"), 3) in text
        force = one.rms("force")
        assert f"{number(force, 3)} ({read(force / 40.0, 'share')})" in text
        assert one.margins is not None
        assert one.stiffness is not None
        for value, at in (
            (one.margins.sensitivity_peak, one.margins.modulus_frequency),
            (1e-6 * one.stiffness.minimum, one.stiffness.minimum_frequency),
        ):
            assert f"{number(value, 3)} ({number(at, 3)})" in text


def test_the_same_contents_give_the_same_text() -> None:
    assert build(bare()) == bare_page()


@pytest.mark.slow(reason="twenty laws full of noise are drawn")
def test_many_noisy_laws_stay_below_a_megabyte_and_the_pictures_show_the_best() -> None:
    noisy = loop(True, Encoder(resolution=50e-9, noise=2e-6))
    entries = [entry(f"law {i}", noisy, run=simulate(noisy, Stroke(), seed=i)) for i in range(20)]
    text = build(replace(compared(), entries=entries))
    assert len(text.encode()) < 1_000_000
    assert "The pictures show 8 of 20 laws" in text
    best = min(entries, key=lambda one: one.rms("following_error"))
    assert f">{best.name}<" in pictures(text)[0]
    assert all(one.name in structure(text).text for one in entries)


HOSTILE = ["</title><script>alert(1)</script>", '"><img src=x onerror=y>', "a & b < c", "\x00\x1b[31m\x07", "$x_1$ _y_"]


def test_every_text_of_the_user_is_shown_and_not_run() -> None:
    entries = [replace(compared().entries[0], name=text, description=f"{text} said") for text in HOSTILE]
    every = " ".join(HOSTILE)
    made = build(LawsContents(every, entries, {every: every}, every, every, {every: every}, [every]))
    found = structure(made)
    assert not {name for name, _ in found.tags} & {"script", "img"}
    for text in HOSTILE:
        # title, headline, headline of a fact, its text, rule, job, version and its name, note; description; tables
        shown = "".join(c for c in text if c.isprintable())
        assert found.text.count(shown) >= 9 + 1 + 3
    assert not set(made) & set(map(chr, range(9)))
    check_pictures(made)


def test_what_is_not_there_is_left_out() -> None:
    text = bare_page()
    check_page(text)
    assert "Open loop" not in text
    assert "Robustness" not in text
    with pytest.raises(ParameterError, match="at least one law"):
        build(LawsContents("empty", []))


class Rest(Reference):
    """Nothing to do, for a time."""

    def __init__(self, duration: float) -> None:
        object.__setattr__(self, "seconds", duration)

    @property
    def duration(self) -> float:
        return self.seconds  # type: ignore[attr-defined]

    def at(self, t: np.ndarray) -> Setpoint:
        zero = np.zeros_like(t)
        return Setpoint(zero, zero, zero, zero, zero)


@pytest.mark.parametrize("duration", [0.5, 0.0])
def test_an_axis_at_rest_and_a_run_of_one_sample_have_a_report(duration: float) -> None:
    made = replace(loop(False), axis=Axis(plant=Rigid(mass=10.0)))
    still = entry("still", made, run=simulate(made, Rest(duration)))
    text = build(LawsContents("rest", [replace(still, loop_gain=None, compliance=None, tracking=None)]))
    check_page(text)
    assert ("Following error over time" in text) == (duration == 0.5)


def test_both_color_schemes_define_the_same_variables_and_are_readable() -> None:
    sheet = page()
    light, *dark = [
        dict(re.findall(r"(--[\w-]+): (#[0-9a-f]{6})", block))
        for block in re.findall(r"\{[^{}]*--ink: [^{}]*\}", sheet)
    ]
    assert len(dark) == 2  # as the system says, and forced
    assert dark[0] == dark[1]
    assert set(dark[0]) == set(light) - {"--font", "--mono"}
    assert "prefers-color-scheme: dark" in sheet
    assert "@media print" in sheet
    assert set(THEME.values()) <= {f"var({name})" for name in light}
    # the light scheme is the house style of the pictures
    assert [light[f"--curve-{i}"] for i in range(6)] == list(style.COLORS)
    assert (light["--ink"], light["--paper"]) == (style.INK, style.PAPER)
    for scheme in (light, dark[0]):
        # WCAG 2: text 4.5 to 1; curves 3 to 1, for the first three that most pictures need
        for name in ("--ink", "--muted", "--alert", "--link"):
            assert contrast(scheme[name], scheme["--paper"]) > 4.5
        for i in range(3):
            assert contrast(scheme[f"--curve-{i}"], scheme["--paper"]) > 3.0
        assert contrast(scheme["--ink"], scheme["--page"]) > 7.0
        assert contrast(scheme["--ink"], scheme["--warm"]) > 7.0


def contrast(a: str, b: str) -> float:
    """The contrast ratio of WCAG 2, section 1.4.3."""

    def luminance(color: str) -> float:
        parts = [int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(a), luminance(b)))
    return (high + 0.05) / (low + 0.05)


def test_a_curve_keeps_its_place_in_the_page() -> None:
    rng = np.random.default_rng(1)
    x, y = np.linspace(0.0, 1.0, 900), np.cumsum(rng.normal(size=900))
    chart = Chart("x", (Panel("y", (Curve(x, y),)),))
    figure = draw_chart(chart)
    figure.savefig(BytesIO(), format="svg")  # which places the axes
    (line,) = figure.axes[0].lines
    text = svg(chart, "k", "a random walk of nine hundred steps")
    path = max(re.findall(r' d="([^"]*)"', text), key=len)
    places = np.array(drawn(path))
    height = 72.0 * figure.get_figheight()
    expected = line.get_transform().transform(np.column_stack([x, y])) * 72.0 / figure.dpi
    expected[:, 1] = height - expected[:, 1]
    # matplotlib drops points that lie within 1/9 of a pixel of a straight line, we round to a hundredth of a point
    for place in places:
        assert np.min(np.hypot(*(expected - place).T)) < 0.5
    assert places[:, 1].min() == pytest.approx(expected[:, 1].min(), abs=0.06)
    assert places[:, 1].max() == pytest.approx(expected[:, 1].max(), abs=0.06)
    assert places[0] == pytest.approx(expected[0], abs=0.06)
    assert places[-1] == pytest.approx(expected[-1], abs=0.06)


def drawn(path: str) -> list[tuple[float, float]]:
    """The points of a path of M and L."""
    points: list[tuple[float, float]] = []
    for rest in re.findall(r"[ML]([^MLz]*)", path):
        x, y = map(float, rest.split())
        points.append((x, y))
    return points


def test_the_first_sentence_names_the_best_law_and_its_price() -> None:
    said = result_sentences(compared())
    assert said[0].startswith("Of 2 laws 'with feedforward' follows best")
    first, best = compared().entries
    ringing = replace(best, loop_gain=best.loop_gain * np.exp(-0.8j))  # 46 deg less phase
    priced = result_sentences(replace(compared(), entries=(first, ringing)))
    assert priced[0].startswith("What 'with feedforward' costs: its sensitivity peak is")
    assert priced[1] == said[0]
    turned = replace(compared(), entries=compared().entries[::-1])
    assert result_sentences(turned)[0].startswith("None of the others follows better than 'with feedforward'")
    alone = result_sentences(replace(compared(), entries=compared().entries[:1]))
    assert alone[0].startswith("'today' follows its setpoint with")
    assert "of the motor peak" in alone[0]


def test_remarks_say_what_must_not_be_overlooked() -> None:
    soft = replace(AXIS, actuator=Actuator(motor=Direct(force_constant=GTAU, peak_force=30.0, continuous_force=5.0)))
    made = replace(loop(True), axis=soft, control=replace(loop(True).control, force_limit=60.0))
    found = "\n".join(remark_sentences(LawsContents("x", [entry("weak", made)], rule="r", notes=["r", "n"])))
    assert "the force is at its limit for" in found
    assert "above the motor's peak of 30 N" in found
    assert "overheats the motor" in found
    assert found.endswith("\nn")


KEEPS_QUANTITIES = True  # in the f-strings of this module


def test_a_page_is_read_in_the_units_of_its_axis() -> None:
    """Quantities of the sentences, tables and pictures are turned; texts of a person are not."""
    chart = Chart("x", (Panel(f"force ({unit_name('N')}) of '5 kg'"),), height=2.0)
    shown = Picture("k", "5 kg", Text(f"at {Quantity(2e-6, 'm')}"), "a picture of a force", lambda: chart)
    table = Table("5 mm", [Column("5 kg"), Column("RMS", "m")], [["3 N", 1e-6]])
    report = Report("5 kg", "feeddrive", Verdict(("5 s",)), (Section("a", "A", (table,)),), shown, rotary=True)
    text = structure(html(report)).text
    for expected in ("force (N m) of '5 kg'", "at 2 µrad", "RMS µrad", "5 mm", "3 N"):
        assert expected in text


def test_a_table_that_is_cut_off_on_a_narrow_screen_says_so() -> None:
    """The class names the width of the screen below which it is; the rule of that width shows the words."""
    narrow = Table("Two.", ["what", "size"], [["mass", "12.5 kg"], ["a long name that breaks", "3 N"]])
    wide = Table("Many.", ["what", *"abcdefg"], [["mass", *["123.456 N/um"] * 7]])
    longer = Table("Words.", ["what", "said"], [["mass", "a sentence in a cell, which does not break " * 3]])
    section = Section("tables", "Tables", (narrow, wide, longer))
    text = html(Report("Tables", "feeddrive", Verdict(("Three.",)), (section,)))
    assert re.findall(r'class="scroll( beyond-\d+)? ?"', text) == ["", " beyond-60", " beyond-65"]
    assert "Swipe: the table goes on to the right" in text
    # the title breaks at the frame, not at the end of the table beyond it
    assert "<caption><span>Many.</span></caption>" in text
    assert "caption span { display: block; position: sticky; left: 0; max-width: 100cqw; }" in text
    for each in re.findall(r'class="scroll beyond-(\d+)"', text):
        assert f"(max-width: {each}rem) {{ .beyond-{each}::before {{ display: block; }} }}" in text


@pytest.mark.parametrize(("peak", "where"), [(1.6, "within"), (2.5, "above")])
def test_a_sensitivity_peak_of_two_is_usual(peak: float, where: str) -> None:
    law: Any = SimpleNamespace(margins=SimpleNamespace(sensitivity_peak=peak))
    assert _judged(law) == f"{where} the usual bound of 2"


@pytest.mark.parametrize(("samples", "shown"), [(12, False), (20, True)])
def test_a_run_of_a_few_samples_has_no_picture_over_time(samples: int, shown: bool) -> None:
    signals = {name: np.zeros(samples) for name in Signals._fields}
    law = Entry("short", "", Run("short", signals, 1e-3, samples), loop(False))
    assert ("error" in [picture.key for picture in laws_pictures(LawsContents("x", [law]))]) is shown


# how much a report lists: a case on either side


def test_a_mode_of_a_hundredth_is_seen_to_a_twentieth_of_its_peak() -> None:
    """Midway between two lines a response of damping ζ is 1/√(1 + (δ/ζ)²) of its peak, δ half of their distance."""
    lines = response_lines(Loop(sample_time=1e-4, control=Control(law=CascadePPI(Kv=20.0, Kp=1e3)), axis=AXIS))
    half = 0.5 * np.max(np.diff(np.log(lines)))
    assert 1.0 / np.hypot(1.0, half / 0.01) > 0.95


def named(count: int) -> LawsContents:
    """Laws of which each follows less well than the one before."""
    laws: list[Any] = [SimpleNamespace(name=f"law {i}", rms=lambda _, i=i: float(i)) for i in range(count)]
    return LawsContents("laws", laws)


@pytest.mark.parametrize(("count", "shown"), [(6, 6), (8, 8), (12, 8)])
def test_pictures_show_the_first_law_and_the_seven_best(count: int, shown: int) -> None:
    assert [law.name for law in chosen(named(count)).entries] == [f"law {i}" for i in range(shown)]


def test_of_eight_laws_each_curve_has_a_point_for_each_pixel_but_not_for_two(monkeypatch: pytest.MonkeyPatch) -> None:
    """A report is 8.6 inches of 100 pixels wide; a curve alone has more than two points for each."""
    module = import_module("feeddrive.report.laws_report")  # the package may have a function of this name
    drawn: list[int] = []
    monkeypatch.setattr(module, "_measured", lambda _, points: drawn.append(points) or ())
    contents = named(8)
    for law in contents.entries:
        cast("Any", law).counted = lambda _: np.zeros(3)
    for name in ("_open_loop", "_closed_loop"):
        monkeypatch.setattr(module, name, lambda _: ())
    assert not list(laws_pictures(contents))
    assert 860 <= drawn[0] < 2 * 860


def plan_of(stops: int) -> Any:
    """A plan with stops, and with ten limits each of which is used for longer than the one before."""
    rows = [SimpleNamespace(time=float(i), line=i, duration=0.1, position=()) for i in range(stops)]
    limits = SimpleNamespace(letters=(), shown=(), rotary=())
    seconds = {f"limit {i}": float(i) for i in range(10)}
    return SimpleNamespace(
        stops=rows, stop_count=stops, stop_reasons={"dwell": stops}, limits=limits, seconds=seconds, cycle_time=45.0
    )


@pytest.mark.parametrize(
    ("stops", "rows", "caption"), [(150, 150, "All of them."), (300, 200, "The first 200 of 300.")]
)
def test_two_hundred_stops_are_listed(stops: int, rows: int, caption: str) -> None:
    table: Any = part_report._stops(plan_of(stops))[1]
    assert (len(table.rows), str(table.title)) == (rows, caption)


def test_the_six_limits_that_are_used_for_longest_are_listed() -> None:
    assert [row[0] for row in part_report._causes(plan_of(1)).rows] == [f"limit {i}" for i in (9, 8, 7, 6, 5, 4)]


def test_the_eight_worst_places_of_the_first_law_are_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    places = [SimpleNamespace(position=(), line=i, time=float(i)) for i in range(30)]
    first: Any = SimpleNamespace(name="law 0", worst=lambda count: places[:count])
    monkeypatch.setattr(part_report, "_place", lambda *_, **__: "")
    monkeypatch.setattr(part_report, "_near", lambda *_: 0.0)
    assert [row[1] for row in part_report._places([(named(1).entries[0], first)]).rows] == list(range(8))
