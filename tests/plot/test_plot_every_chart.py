"""Every picture is a chart: a value, drawn in one place; each function of a chart gives one that can be drawn."""

from __future__ import annotations

import ast
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace as Stand  # in for a result, with the parts that its chart needs
from typing import Any, get_type_hints

import numpy as np
import pytest

import feeddrive as fd
import svg_texts
from feeddrive import plot
from feeddrive.analysis.margins import Margins, margins
from feeddrive.analysis.replay import Replay
from feeddrive.analysis.stability import stability
from feeddrive.analysis.stiffness import stiffness
from feeddrive.figures.ranking import CRITERIA
from feeddrive.identification.motion.pooled import LogValues, pooled
from feeddrive.identification.regression import Estimate
from feeddrive.language.lazy_package import public_names
from feeddrive.language.quantity import DRAWN, Quantity, Units
from feeddrive.language.table import chart_of
from feeddrive.language.text import Text
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import compliance, loop_gain
from feeddrive.loop.loop import Loop
from feeddrive.papers.gordon2013 import frequency, motion
from feeddrive.papers.wu2017 import testbed as of_trials
from feeddrive.plot import laws as of_laws
from feeddrive.plot import registry
from feeddrive.plot.chart import (
    ABOVE,
    ALERT,
    PANELS,
    RIGHT,
    Abscissa,
    Box,
    Chart,
    Curve,
    Field,
    Heat,
    Level,
    Panel,
    Tick,
    filled_stairs,
    listed,
    numbered,
    rods,
    side_by_side,
    stairs,
)
from feeddrive.plot.drawing import drawn
from feeddrive.plot.layout import Layout
from feeddrive.report.svg import svg_element
from feeddrive.study import answers as of_study
from feeddrive.study import robust as of_robust
from feeddrive.study.statistics import INSIDE, RankCorrelation, Share, SobolIndices
from feeddrive.study.study import Bound

KEEPS_QUANTITIES = True
SOURCE = Path(fd.__file__).parent
DRAWS = {"plot/drawing.py", "plot/style.py", "plot/picture.py"}
T = np.linspace(0.0, 2.0, 3000)
S = np.sin(8.0 * T)
F = np.geomspace(5.0, 500.0, 120)
FIGURES = CRITERIA[:4]
SCORES = of_laws.ScoreRow([0.8, 1.2], 0.9, (0.85, 1.1)), of_laws.ScoreRow([2.0], None)


class Recorded(dict[str, np.ndarray]):
    """Signals of a run."""

    time = T
    sample_time = float(T[1])


def random(*shape: int) -> np.ndarray:
    return np.random.default_rng(1).normal(size=shape)


def recorded() -> Any:
    return Recorded(tracking_error=1e-6 * S, position_load=1e-5 * S, load_force=20.0 * np.abs(S))


def estimate(value: float, error: float = 0.2) -> Any:
    return Stand(value=value, error=error)


def cogging() -> Any:
    orders = [
        Stand(order=k, even=estimate(5.0 / k), odd=estimate(1.0 / k), forward=None, backward=None, even_phase=0.3)
        for k in (1, 2, 4, 12)
    ]
    return Stand(orders=orders, significant=orders, unit="N", coulomb=estimate(3.0), offset=estimate(1.0))


def lobes() -> Any:
    speed = np.linspace(2000.0, 12000.0, 200)
    wave = np.sin(96000.0 / speed)
    own = Stand(stable=False, growth=1.23, speed=9000.0, depth=2e-3)
    return Stand(
        spindle_speed=speed,
        depth=1e-3 * (1.0 + np.abs(wave)),
        flip=wave > 0.8,
        frequency=400.0 + 100.0 * wave,
        deepest=0.01,
        islands=((5000.0, 2.2e-3, 2.6e-3),),
        passing=lambda: [(3000.0, 200.0, 4), (6000.0, 200.0, 2)],
        natural=np.array([380.0]),
        own=own,
    )


def cut() -> Any:
    angle, force = 200.0 * np.pi * T, np.maximum(0.0, S)
    return Stand(angle=angle, torque=force, feed=force, normal=force, axial=force, time=T, resultant=force, power=force)


def chatter() -> Any:
    frequency = np.arange(0.0, 2000.0, 2.0)
    lines = Stand(frequency=frequency, amplitude=1e-7 * np.abs(random(1000)), unit="m", name="position_load")
    harmonic = (frequency > 0.0) & (frequency % 200.0 == 0.0)
    return Stand(
        spectrum=lines, harmonic=harmonic, passing=200.0, chatter=274.0, dots=0, samples=1e-6 * S[:60], swing=1e-5
    )


def wall(rows: int) -> Any:
    heights = np.linspace(0.0, 0.01, rows)
    return Stand(heights=heights, along=T, map=1e-6 * (S + 300.0 * heights[:, None]), mark=3e-6, roughness=(1e-6, 4e-6))


def trial() -> Any:
    return Stand(time=T, following_error=1e-6 * S, rms=1e-6, peak=3e-6, setpoint=Stand(velocity=0.1 * S))


def fit() -> Any:
    return Stand(time=T, error=1e-6 * S, explained=9e-7 * S, predicted=1e-7 * S, rms=lambda row: float(np.std(row)))


def delays() -> Any:
    dead_time = 1e-3 * np.arange(6.0)
    gains = 200.0 / (1.0 + np.arange(6.0))
    return Stand(
        tunables=["axis.x.control.law.Kv"],
        dead_time=dead_time,
        sample_time=1e-3,
        at_edge=lambda _: gains,
        at_robust=lambda _: 0.5 * gains,
        sensitivity_bound=2.0,
    )


def part() -> Any:
    contour = Stand(
        time=T, error=1e-6 * np.abs(S), counted=T > 0.2, rms=1e-6, largest=4e-6, within=lambda: 3e-6, axes=("x", "y")
    )
    estimates = {"gpi": {"x": Stand(lag=1e-3, disturbance=20.0 * S)}}
    return Stand(
        contour=contour, cutting=30.0 * np.column_stack([S, S]), disturbances={"x": 25.0 * S}, estimates=estimates
    )


def agreement() -> Any:
    s = 2j * np.pi * F
    model = FRF(F, 1.0 / (s * (100.0 * s + 800.0)), "force", "position_load", "m/N")
    return Stand(
        measured=[model],
        fitted=[model],
        drawn=[model],
        residuals=[random(F.size) + 1j * random(F.size)],
        spread=1.0,
        order=0,
        autocorrelation=lambda lag: 0.2 / lag,
    )


def excitation() -> Any:
    first = Stand(excitation=20.0 * S, signals={"velocity_load": 0.01 * S, "force": 30.0 * S}, time=T)
    return Stand(drawings=[first], where="force", sample_time=float(T[1]), first=500, periods=2, period=1000)


def steady() -> Any:
    v = np.concatenate([-np.geomspace(0.001, 0.2, 9)[::-1], np.geomspace(0.001, 0.2, 9)])
    frame = Stand(force="N", velocity="m/s")
    return Stand(frame=frame, force=20.0 * np.sign(v) + 100.0 * v, velocity=v, error=np.full(18, 0.5))


def friction_curve() -> Any:
    runs = steady()
    return Stand(
        runs=runs,
        at=lambda v: 20.0 * np.sign(v),
        error=lambda v: np.full(v.shape, 0.4),
        residual=random(18),
        model=Stand(name="stribeck"),
    )


def judged() -> Any:
    values = {each.key: 1e-5 * np.exp(0.3 * random(200)) for each in FIGURES}
    study = Stand(specification=[Bound(FIGURES[0], None, 1.6e-5)], measure=FIGURES, vary=[1, 2])
    inside = values[FIGURES[0].key] < 1.2e-5
    return Stand(study=study, figures=values, variant=np.arange(200), inside=inside)


def front() -> Any:
    rows = Stand(variant=np.arange(5), figures={key: row[:5] for key, row in judged().figures.items()})
    return Stand(figures={each.key: each for each in FIGURES[:3]}, rows=rows)


def sobol() -> list[SobolIndices]:
    share = np.array([0.5, 0.3])
    around = np.array([share - 0.05, share + 0.05])
    return [SobolIndices(INSIDE, ("a.mass", "a.stiffness"), share, around, share + 0.1, around + 0.1, 100, 0)]


def machines() -> Any:
    bounds = [Bound(FIGURES[0], 1e-6, 1.6e-5)]
    return Stand(figures=FIGURES, count=200, bounds=bounds, values=judged().figures)


def yields() -> Any:
    bounds = [Stand(bound=bound, kept=Share(180, 200)) for bound in judged().study.specification]
    return Stand(bounds=bounds, inside=Share(140, 200))


def laws() -> list[tuple[str, dict[str, float | None]]]:
    return [
        (f"law {i}", {each.key: float(value) for each, value in zip(CRITERIA, 1e-5 * np.exp(row), strict=True)})
        for i, row in enumerate(random(8, len(CRITERIA)))
    ]


@cache
def motor() -> Loop:
    return fd.read_machine("linear_motor").loop(None)


def opened() -> Margins:
    return margins(loop_gain(motor(), F))


@cache
def moved() -> fd.Run:
    return fd.simulate(motor(), fd.blocks.JerkLimitedMove(distance=1e-3, velocity=0.1, acceleration=10.0, jerk=1e3))


def measured() -> dict[str, np.ndarray]:
    return {name: moved()[name] for name in ("position_load", "following_error", "force")}


def rigid() -> Any:
    residuals = Stand(measured=20.0 * S, values=S, relative=0.05)
    return Stand(frame=Stand(force="N"), residuals=residuals, time=T)


def learned() -> Any:
    values = {"mass": np.array([100.0, 120.0, 121.0]), "viscous": np.array([0.0, 40.0, 50.0])}
    return Stand(
        rms=np.array([3e-6, 1e-6, 5e-7]),
        trials=[None] * 3,
        parameters=lambda: values,
        errors=lambda: {name: np.array([np.nan, 1.0, 0.5]) for name in values},
        iterations=[Stand(before=fd.blocks.Inertia(mass=100.0, viscous=0.0))],
    )


BANDED = Stand(x=F, quantiles=np.outer([1.0, 1.3, 1.6, 1.9, 2.4], 1e7 * (1.0 + F)), unit="N/m")
CIRCLE = 0.02 * np.cos(3.0 * T), 0.02 * np.sin(3.0 * T)
PREVIEW = Stand(
    traces=[
        Stand(name=name, role=role, unit=unit, time=T, values=S)
        for name, role, unit in (("r", "setpoint_position", "mm"), ("x", "position_load", "mm"), ("f", "force", "N"))
    ]
)


def logged(name: str, mass: float) -> LogValues:
    return LogValues(name, (Estimate("mass", mass, "kg", 1.0, 0.5), Estimate("coulomb", 20.0, "N", 2.0, 1.0)))


OF_PLOT: dict[str, Callable[[], Chart]] = {
    "curves:effort": lambda: plot.effort_chart(Stand(operations={"add": 12, "divide": 4}, total=16)),
    "identification:residuals": lambda: plot.residuals_chart(
        Stand(values=random(900), unit="N", autocorrelation=lambda lag: 1.0 / lag)
    ),
    "identification:validation": lambda: plot.validation_chart(Stand(errors=np.array([0.02, 0.03]))),
    "identification:delay_fit": lambda: plot.delay_fit_chart(
        Stand(delays=np.arange(9.0), nearest=4, residual=np.ones(9), dead_time=4.3, error=0.1)
    ),
    "identification:control_fit": lambda: plot.control_fit_chart(
        Stand(tried={(n, d): 0.01 * (n + d) for n in (1, 2, 3) for d in (0, 1)})
    ),
    "identification:pooled": lambda: plot.pooled_chart(pooled([logged("a", 90.0), logged("b", 93.0)])),
    "identification:cogging": lambda: plot.cogging_chart(cogging()),
    "identification:cogging_over_turn": lambda: plot.cogging_over_turn_chart(
        cogging(), [Stand(direction=1, turns=T, force=5.0 * S)]
    ),
    "machining:lobes": lambda: plot.lobes_chart(lobes()),
    "machining:cutting_forces": lambda: chart("machining:cutting_forces")(cut()),
    "machining:chatter_signs": lambda: plot.chatter_signs_chart(chatter()),
    "curves:surface": lambda: chart("curves:surface")(wall(9)),
    "tuning:trial": lambda: plot.trial_chart(trial()),
    "tuning:iteration": lambda: plot.iteration_chart(Stand(trial=trial(), predicted_rms=2e-7, predicted=1e-7 * S)),
    "tuning:prefilter_fit": lambda: plot.prefilter_fit_chart(fit()),
    "tuning:disturbance": lambda: plot.disturbance_chart(Stand(time=T, disturbance=S), S, (0.1, 0.4)),
    "tuning:delay_map": lambda: plot.delay_map_chart({"a": delays(), "b": delays()}),
    "tuning:in_time": lambda: plot.in_time_chart([("time (s)", "force (N)", {"a": (T, S), "b": (T, -S)})]),
    "curves:curves": lambda: chart("curves:curves")(
        "time (s)",
        T,
        [import_module("feeddrive.plot.curves").Row("error (µm)", {"a": S, "b": -S})],
        levels={"set": 0.5},
    ),
    "curves:pole_sweep": lambda: chart("curves:pole_sweep")(
        {"a": [np.array([-k + 50j, -k - 50j]) for k in (1.0, 2.0)]}
    ),
    "curves:turn": lambda: chart("curves:turn")(np.pi * T, {"feed": S}),
    "curves:by_axis": lambda: chart("curves:by_axis")(T, {"x": {"a": S, "b": -S}, "y": {"a": S}}, "error (µm)"),
    "curves:left_over": lambda: chart("curves:left_over")(
        {"a": (F, F)}, {"a": (F[::9], F[::9])}, "left over (1)", (200.0, "teeth")
    ),
    "part_program:part_run": lambda: plot.part_run_chart(part()),
    "part_program:part_laws": lambda: plot.part_laws_chart({"P-PI": part(), "GPI": part()}),
    "part_program:part_cutting": lambda: plot.part_cutting_chart(part()),
    "part_program:part_estimates": lambda: plot.part_estimates_chart(part(), "x"),
    "part_program:part_zoom": lambda: plot.part_zoom_chart({"P-PI": part()}, 1.0),
    "over_frequency:response_fit": lambda: plot.response_fit_chart(agreement()),
    "over_frequency:response_residuals": lambda: plot.response_residuals_chart(agreement()),
    "over_frequency:response_nyquist": lambda: plot.response_nyquist_chart(agreement()),
    "over_frequency:excitation": lambda: plot.excitation_chart(excitation()),
    "identification:steady_runs": lambda: plot.steady_runs_chart(steady()),
    "identification:identified_friction": lambda: plot.identified_friction_chart(friction_curve()),
    "over_time:log": lambda: plot.log_chart(Stand(channels={"force": S, "state": S}, units={"force": "N"}, time=T)),
    "over_time:preview": lambda: plot.preview_chart(PREVIEW),
    "over_time:guess": lambda: chart("over_time:guess")(Stand(preview=PREVIEW)),
}
OF_PLOT |= {
    "complex_plane:encirclement": lambda: chart("complex_plane:encirclement")(Stand(loop_gain=loop_gain(motor(), F))),
    "complex_plane:placement": lambda: chart("complex_plane:placement")(Stand(stability=stability(motor()))),
    "over_frequency:tuned": lambda: chart("over_frequency:tuned")(
        Stand(before=[], after=[Stand(stable=True, stiffness=stiffness(compliance(motor(), F)))])
    ),
    "over_frequency:measured_loop": lambda: chart("over_frequency:measured_loop")(Stand(margins=opened())),
    "over_frequency:cascade_loops": lambda: chart("over_frequency:cascade_loops")(
        Stand(velocity=opened(), position=opened())
    ),
    "over_frequency:fitted": lambda: chart("over_frequency:fitted")(Stand(agreement=agreement())),
    "over_frequency:axis_fits": lambda: chart("over_frequency:axis_fits")(Stand(fit=Stand(agreement=agreement()))),
    "over_frequency:frequency_estimate": lambda: plot.frequency_estimate_chart(
        Stand(frf=compliance(motor(), F), levels={})
    ),
    "over_time:cosimulation": lambda: chart("over_time:cosimulation")(Stand(rows=[Stand(name="law", run=moved())])),
    "over_time:refinement": lambda: chart("over_time:refinement")(Stand(replay=Replay(moved(), measured(), 10))),
    "identification:rigid_fit": lambda: plot.rigid_fit_chart(rigid()),
    "identification:identified": lambda: chart("identification:identified")(Stand(refinement=None, rigid=rigid())),
    "tuning:trials": lambda: plot.trials_chart(learned()),
    "tuning:errors_and_parameters": lambda: chart("tuning:errors_and_parameters")({"a": learned(), "b": learned()}),
}
OF_ROOMS: dict[str, Callable[[], Chart]] = {
    "trade-off": lambda: of_laws.tradeoff_chart([(name, row, "") for name, row in laws()]),
    "ratios": lambda: of_laws.ratios_chart(laws(), "law 0"),
    "recovery": lambda: of_laws.recovery_chart(
        [(f"law {i}", recorded(), recorded()) for i in range(8)], begin=0.5, near=5e-7, span=0.3
    ),
    "benchmark": lambda: of_laws.scores_chart((["a", "b"], {"tracking": SCORES})),
    "robust": lambda: of_robust.shares_chart(machines(), machines()),
    "yields": lambda: of_study.yields_chart(yields()),
    "histograms": lambda: of_study.histograms_chart(judged()),
    "correlations": lambda: of_study.decides_chart(
        judged().study, [], [RankCorrelation(INSIDE, "a.mass", 0.8, (0.7, 0.9))]
    ),
    "indices": lambda: of_study.decides_chart(judged().study, sobol(), []),
    "nothing decides": lambda: of_study.decides_chart(judged().study, [], []),
    "stiffness band": lambda: of_study.stiffness_band_chart(BANDED),
    "error band": lambda: of_study.error_band_chart(BANDED),
    "front": lambda: of_study.front_chart(front(), judged()),
    "trials": lambda: of_trials.errors_chart({"a": 1.0 / np.arange(1.0, 7.0), "b": 2.0 / np.arange(1.0, 7.0)}),
    "rates": lambda: of_trials.rates_chart(F, {"a": list(0.1 / F)}, 0.4),
    "contours": lambda: of_trials.contour_chart({"a": CIRCLE, "b": CIRCLE, "c": CIRCLE}),
    "rope": lambda: motion._rope({"a": recorded()}),
    "ablation": lambda: motion._bars({"all": 0.5, "none": 12.0}),
    "contributions": lambda: frequency._drawn(
        {"a": Stand(magnitude=np.ones(frequency.BAND_LINES.size), phase_deg=np.zeros(frequency.BAND_LINES.size))}
    ),
    "entry": lambda: motion._drawn({"a": recorded(), "b": recorded()}),
}


@cache
def chart(place: str) -> Callable[..., Chart]:
    module, name = place.split(":")
    return getattr(import_module(f"feeddrive.plot.{module}"), f"{name}_chart")


@pytest.mark.parametrize("name", [*OF_PLOT, *OF_ROOMS])
def test_a_picture_is_a_chart_that_can_be_drawn(name: str) -> None:
    made = (OF_PLOT | OF_ROOMS)[name]()
    assert isinstance(made, Chart)
    shown = made.shown(DRAWN)
    assert list(texts(shown)) == [text for text in texts(shown) if "\ue000" not in text]
    picture = svg_element(shown, "k", name)
    assert not re.search(r"\b(nan|inf)\b", picture)
    assert svg_texts.overlapping(picture) == []
    assert svg_texts.outside(picture) == []
    written = {each.text.replace("\n", " ") for each in svg_texts.texts(picture)}
    axes = [each for panel in shown.panels for each in (panel.label, panel.abscissa.label if panel.abscissa else "")]
    if not made.bare:
        assert {text.replace("\n", " ") for text in (*axes, shown.label) if text} <= written


@pytest.mark.slow(reason="matplotlib draws 80 pictures")
@pytest.mark.parametrize("part", range(4))
def test_both_ways_to_draw_show_the_same(part: int) -> None:
    """Ranges of all axes, and texts of legends, ticks apart."""
    for name, make in list((OF_PLOT | OF_ROOMS).items())[part::4]:
        made = make()
        figure = drawn(made)
        figure.draw_without_rendering()
        axes = [ax for ax in figure.axes if not hasattr(ax, "_colorbar")]
        layout = Layout(made.shown(DRAWN))
        assert len(axes) == len(made.panels) == len(layout.frames)
        for ax, frame in zip(axes, layout.frames, strict=True):
            for found, axis in ((ax.get_xlim(), frame.x), (ax.get_ylim(), frame.y)):
                # of equal scales the shape of the panel decides, and a single value has no range of its own
                if frame.abscissa.square or frame.panel.ticks is not None:
                    continue
                low, high = np.log10(found) if axis.log else found
                mine = (np.log10(axis.low), np.log10(axis.high)) if axis.log else (axis.low, axis.high)
                assert mine == pytest.approx((low, high), abs=0.02 * (high - low)), (name, frame.panel.label)
        legends = [each for ax in axes for each in [ax.get_legend(), *figure.legends] if each is not None]
        named = {text.replace("\u200b", "").replace(r"\$", "$") for legend in legends for text in entries(legend)}
        assert {entry.text for frame in layout.frames for entry in (*layout.legend, *frame.legend)} == named
        for legend in legends:
            box = legend.get_window_extent()
            assert all(box.y0 >= ax.bbox.y1 - 0.03 * ax.bbox.height for ax in axes if legend.axes in (None, ax))


def texts(thing: Any) -> Iterator[str]:
    """Every text in a chart."""
    if isinstance(thing, str):
        yield thing
    elif isinstance(thing, tuple):
        for each in thing:
            yield from texts(each)
    elif is_dataclass(thing):
        for field in fields(thing):
            yield from texts(getattr(thing, field.name))


def test_every_function_of_a_chart_says_so_and_every_picture_has_one() -> None:
    for kind, place in registry.CHARTS.items():
        module, name = place.split(":")
        assert name.endswith("_chart"), kind
        function = getattr(import_module(f"feeddrive.plot.{module}"), name)
        assert str(inspect.signature(function).return_annotation) == "Chart", place
    known = public_names("feeddrive.plot")
    figures = {name for name in known if not name.endswith("_chart")} - {"Chart", "drawn"}
    assert {f"{name}_chart" for name in figures} == {name for name in known if name.endswith("_chart")}
    for name in figures:
        assert getattr(plot, name).__name__ == name
        assert getattr(plot, name).__doc__ == getattr(plot, f"{name}_chart").__doc__
    for module in pkgutil.iter_modules(plot.__path__):
        for name, function in vars(import_module(f"feeddrive.plot.{module.name}")).items():
            if name.endswith("_chart") and inspect.isfunction(function):
                assert "Chart" in str(inspect.signature(function).return_annotation), (module.name, name)


# charts of results that take real runs, by the test that draws them
ELSEWHERE = {
    "plot/test_plot_pictures.py": (
        "bode poles stability batch gradient friction friction_map closed_loop open_loop nyquist sensitivity spectrum "
        "stiffness comparison following_error force motion replay run"
    ),
    "plot/test_plot_machining.py": (
        "axis_load circle_causes circle_test circle_unrolled reversals contour_on_path corner_zoom"
    ),
    "plot/test_plot_charts.py": "certificate certificate_discs circle unrolled place",
    "plot/test_plot_uncertainty.py": "estimates overlay",
    "analysis/test_poles_and_step.py": "plane damping step_response",
    "path/test_plan_command.py": "planned plan_causes plan_losses plan_profiles",
    "path/test_tip.py": "plan_axes plan_feed plan_joints",
    "machining/test_five_axis_job.py": "tip_error tip_joints",
    "machining/test_held_tip.py": "held_tip",
    "workflow/test_setpath.py": "corrected corrected_path learned",
    "workflow/test_travel_command.py": "travel",
    "studio/test_studio_pictures.py": "moves snap",
    "studio/test_studio_program.py": "deviation",
    "workflow/test_commission.py": "commissioned strokes commissioning_responses commissioning_trial",
}
REFUSED = {"recipe_chart"}  # these results have no picture, and say so


def test_every_chart_is_drawn_by_a_test() -> None:
    head = re.compile(r"^def ([a-z]\w*_chart)\(.*?\) -> ([\w| ]+):$", re.MULTILINE | re.DOTALL)
    found = [match for path in SOURCE.rglob("*.py") for match in head.findall(path.read_text(encoding="utf-8"))]
    charts = {name for name, returned in found if returned == "Chart"} - REFUSED
    here = set[str]()
    for statement in ast.parse(Path(__file__).read_text(encoding="utf-8")).body:
        if isinstance(statement, ast.AnnAssign | ast.AugAssign) and isinstance(statement.value, ast.Dict):
            for node in (node for drawing in statement.value.values for node in ast.walk(drawing)):
                if isinstance(node, ast.Attribute):
                    here.add(node.attr)
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    here.add(f"{node.value.partition(':')[2]}_chart")
    elsewhere = {f"{name}_chart" for names in ELSEWHERE.values() for name in names.split()}
    assert charts - here - elsewhere == set()  # a new one belongs into OF_PLOT
    assert elsewhere <= charts - here
    assert [file for file in ELSEWHERE if not (Path(__file__).parent.parent / file).exists()] == []


def test_results_of_later_rooms_give_charts_too() -> None:
    for place in (
        "benchmark.benchmark:Benchmark",
        "comparison.compare:Comparison",
        "jobs.run_laws:JobResult",
        "study.answers:Answers",
        "study.robust:Robust",
    ):
        module, name = place.split(":")
        kind = getattr(import_module(f"feeddrive.{module}"), name)
        assert get_type_hints(chart_of.registry[kind])["return"] is Chart


def test_matplotlib_is_used_in_one_place() -> None:
    found = set[str]()
    for path in SOURCE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        # only files with the word are parsed: a syntax tree of all sources takes seconds
        for node in ast.walk(ast.parse(text)) if re.search("matplotlib|mpl_toolkits", text) else ():
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(name.partition(".")[0] in ("matplotlib", "mpl_toolkits") for name in names):
                found.add(path.relative_to(SOURCE).as_posix())
    assert found == DRAWS


def test_a_result_is_drawn_from_its_chart() -> None:
    response = FRF(F, 1.0 / (1.0 + 1j * F), "force", "position_load", "m/N")
    made = response.chart()
    assert isinstance(made, Chart)
    figure = response.plot()
    assert [ax.get_ylabel() for ax in figure.axes] == [panel.label for panel in made.shown(DRAWN).panels]


def test_all_texts_are_read_in_the_units_of_the_reader_and_names_stay() -> None:
    said = Text(f"{Quantity(2e-6, 'm')}")
    ticks = (Tick(0.0, "2 µm", said),)
    panel = Panel(
        said,
        (Curve(T, S, "2 µm", caption=said),),
        levels=(Level(0.0, said, caption=said),),
        caption=said,
        ticks=ticks,
        boxes=(Box(0.0, 1.0, 0.0, 1.0, name="2 µm", text=said),),
        abscissa=Abscissa(said, ticks=ticks),
    )
    made = Chart(said, (panel,), side=said, beside=said, caption=said, ticks=ticks).shown(Units(rotary=True))
    read = [text for text in texts(made) if text.startswith("2 ")]
    assert read.count("2 µm") == 5  # names
    assert read.count("2 urad") == len(read) - 5 == 14


def test_panels_stand_in_rows_and_share_the_axis_of_the_chart() -> None:
    line = (Curve(T, S),)
    own = Panel("y", line, abscissa=Abscissa("own", low=0.0, high=1.0))
    chart = Chart("shared", (Panel("wide", line, whole=True), own, Panel("a", line), Panel("b", line)), across=2)
    wide, alone, right, left = drawn(chart).axes
    assert [ax.get_xlabel() for ax in (alone, right, left)] == ["own", "shared", "shared"]
    assert wide.get_subplotspec().colspan == range(2)
    places = [(ax.get_subplotspec().rowspan.start, ax.get_subplotspec().colspan.start) for ax in (alone, right, left)]
    assert places == [(1, 0), (1, 1), (2, 0)]
    assert wide.get_xlim() == right.get_xlim() == left.get_xlim() != alone.get_xlim() == (0.0, 1.0)


def entries(legend: Any) -> list[str]:
    return [text.get_text() for text in legend.get_texts()]


def test_a_legend_has_each_name_once() -> None:
    limit = Level(0.5, dashed=True, caption="limit")
    both = Panel("y", (Curve(T, S, "a"), Curve(T, -S, "b", 1)), levels=(limit,))
    once = Panel("z", (Curve(T, S, "a"), Curve(T, S, "c", 2)), levels=(limit,))
    for place in (ABOVE, RIGHT):
        figure = drawn(Chart("x", (both, once), legend=place))
        assert entries(figure.legends[0]) == ["a", "b", "c", "limit"]
    figure = drawn(Chart("x", (both, once), legend=PANELS))
    assert [entries(ax.get_legend()) for ax in figure.axes] == [["a", "b"], ["a", "c"]]
    assert entries(figure.legends[0]) == ["limit"]


def test_limits_that_the_legend_tells_apart_have_other_dashes() -> None:
    levels = tuple(
        Level(side * y, dashed=True, number=ALERT, caption=f"{y}") for y in (1.0, 2.0) for side in (-1.0, 1.0)
    )
    lines = drawn(Chart("x", (Panel("y", (Curve(T, S),), levels=levels),))).axes[0].lines
    looks = [str(line.get_dashes() if hasattr(line, "get_dashes") else line._dash_pattern) for line in lines[:4]]
    assert looks[0] == looks[1] != looks[2] == looks[3]


def test_rows_with_names_cells_and_fields() -> None:
    cells = (Box(-0.4, 0.4, -0.4, 0.4, text="1.5", level=0.2), Box(-0.4, 0.4, -1.4, -0.6, text="0.5", level=-0.9))
    table = Panel("", boxes=cells, ticks=listed(["law", "$ other"]), low=-1.5, high=0.5)
    ax = drawn(Chart("", (table,), low=-0.5, high=0.5, ticks=(Tick(0.0, caption="error"),))).axes[0]
    assert [label.get_text() for label in ax.get_yticklabels()] == ["law", r"\$ other"]
    assert not any(spine.get_visible() for spine in ax.spines.values())
    better, worse = (ax.patches[k].get_facecolor() for k in (1, 0))
    assert better[2] > better[0]  # blue
    assert worse[0] > worse[2]  # orange
    field = Panel("y", field=Field(T[:4], F[:3], np.arange(12.0).reshape(3, 4)), heat=Heat("value (µm)", 0.0, 11.0))
    map_, bar = drawn(Chart("x", (field,))).axes
    assert bar.get_ylabel() == "value (µm)"
    assert map_.collections[0].get_array().size == 12


def test_shapes_of_curves() -> None:
    x, y = stairs(np.array([0.0, 1.0, 3.0]), np.array([5.0, 6.0, 7.0]))
    assert (x.tolist(), y.tolist()) == ([0.0, 1.0, 1.0, 3.0, 3.0], [5.0, 5.0, 6.0, 6.0, 7.0])
    x, y = filled_stairs(np.array([0.0, 1.0, 3.0]), np.array([5.0, 6.0]), 1.0)
    assert (x.tolist(), y.tolist()) == ([0.0, 0.0, 1.0, 1.0, 3.0, 3.0], [1.0, 6.0, 6.0, 7.0, 7.0, 1.0])
    x, y = rods(np.array([1.0, 2.0]), 0.0, np.array([5.0, 6.0]))
    assert y[[0, 1, 3, 4]].tolist() == [0.0, 5.0, 0.0, 6.0]
    assert np.isnan(y[[2, 5]]).all()
    assert np.isnan(x[[2, 5]]).all()
    assert [tick.caption for tick in numbered((0.0, 0.5, 45.0))] == ["0", "0.5", "45"]
    left = Chart("a", (Panel("y"),), square=True, low=0.0, high=1.0)
    both = side_by_side((left, Chart("b", (Panel("z"),))), 2.0)
    assert [panel.abscissa and panel.abscissa.label for panel in both.panels] == ["a", "b"]
    assert both.across == 2
