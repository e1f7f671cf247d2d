"""The pictures of the page: the loop before, by hand and as stored, from the same charts as in reports."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

from feeddrive.language.quantity import DRAWN, Units
from feeddrive.plot.chart import Band, Chart, Curve, Disc, Mark, Note
from feeddrive.plot.complex_plane import nyquist_chart
from feeddrive.plot.over_frequency import open_loop_chart, sensitivity_chart, stiffness_chart
from feeddrive.plot.pole_map import damping_chart, plane_chart
from feeddrive.plot.responses import overlay_chart
from feeddrive.plot.settling import moves_chart, snap_chart, step_response_chart
from feeddrive.studio.bench import Bench
from feeddrive.studio.parts import Parts
from feeddrive.tuning.by_hand import Look
from feeddrive.tuning.closed_loop import Figures

T = TypeVar("T")
Thing = TypeVar("Thing", Curve, Mark, Disc, Note, Band)
NUMBERS = {"today": 0, "now": 1, "A": 2, "B": 3, "C": 4, "found": 5, "best so far": 5}
_NO_MACHINE = "needs a machine file: a measured response alone has no poles, no friction and moves no axis"


@dataclass(frozen=True)
class View:
    """The input of the pictures: looks and parts of controls by name, of one bench.

    A control without parts has no runs, poles or step.
    """

    bench: Bench
    looks: Mapping[str, Look]
    parts: Mapping[str, Parts]
    units: Units

    @property
    def leading(self) -> dict[str, Figures]:
        """The worst operating point of each control: the largest Ms, or an unstable one."""
        return {name: look.leading for name, look in self.looks.items()}

    @property
    def stable(self) -> dict[str, Figures]:
        """The stable ones of `leading`: the others have no sensitivity and no stiffness."""
        return {name: figures for name, figures in self.leading.items() if figures.stable}

    def of_stable(self, part: Callable[[Parts], T | None]) -> dict[str, T]:
        """Return a part of each control that is stable and has it."""
        stable = {name: self.parts[name] for name, look in self.looks.items() if look.stable and name in self.parts}
        available = {name: part(value) for name, value in stable.items()}
        return {name: value for name, value in available.items() if value is not None}


def _open_loop(view: View) -> Chart:
    return open_loop_chart({name: figures.margins for name, figures in view.leading.items()}, view.units)


def _nyquist(view: View) -> Chart:
    return nyquist_chart({name: figures.margins for name, figures in view.leading.items()})


def _sensitivity(view: View) -> Chart | None:
    margins_by_name = {name: figures.margins for name, figures in view.stable.items()}
    return sensitivity_chart(margins_by_name, view.units) if margins_by_name else None


def _stiffness(view: View) -> Chart | None:
    stiffness_by_name = {name: figures.stiffness for name, figures in view.stable.items()}
    return stiffness_chart(stiffness_by_name, view.units) if stiffness_by_name else None


def _run(view: View) -> Chart | None:
    runs = view.of_stable(lambda parts: parts.run)
    return moves_chart(runs, view.units) if runs else None


def _snap(view: View) -> Chart | None:
    runs, bench = view.of_stable(lambda parts: parts.snap), view.bench
    return snap_chart(runs, bench.duty.begin, bench.duty.near, view.units) if runs else None


def _step(view: View) -> Chart | None:
    responses = view.of_stable(lambda parts: parts.step)
    return step_response_chart(responses) if responses else None


def _poles(view: View) -> Chart | None:
    loops = {name: parts.linear for name, parts in view.parts.items() if parts.linear is not None}
    return plane_chart(loops, view.units) if loops else None


def _damping(view: View) -> Chart | None:
    loops = {name: parts.linear for name, parts in view.parts.items() if parts.linear is not None}
    return damping_chart(loops, view.units) if loops else None


def _friction(view: View) -> Chart | None:
    return view.bench.friction_shown(view.units)


def _response(view: View) -> Chart:
    leading = next(reversed(view.leading.values()))
    return overlay_chart(view.bench.overlays(leading.point), view.units)


@dataclass(frozen=True)
class Kind:
    """A picture that a person can choose: its title, the function that draws it, and if it is shown by default.

    of_machine  it needs a machine
    """

    title: str
    draw: Callable[[View], Chart | None]
    usual: bool = False
    of_machine: bool = False


PICTURES: Mapping[str, Kind] = {
    "open_loop": Kind("Open loop", _open_loop, usual=True),
    "nyquist": Kind("Nyquist", _nyquist, usual=True),
    "stiffness": Kind("Dynamic stiffness", _stiffness, usual=True),
    "sensitivity": Kind("Sensitivity", _sensitivity, usual=True),
    "run": Kind("Move, then a force on the table", _run, usual=True, of_machine=True),
    "step": Kind("Step of the set position", _step, of_machine=True),
    "snap": Kind("Rope snap: a force that is released", _snap, of_machine=True),
    "poles": Kind("Poles and zeros of the closed loop", _poles, of_machine=True),
    "damping": Kind("Damping of the poles", _damping, of_machine=True),
    "response": Kind("Response of the axis, measured and model", _response),
    "friction": Kind("Friction over velocity", _friction, of_machine=True),
}
USUAL = tuple(name for name, picture in PICTURES.items() if picture.usual)


def charts(
    bench: Bench,
    looks: Mapping[str, Look],
    parts: Mapping[str, Parts] | None = None,
    names: Iterable[str] = USUAL,
    units: Units = DRAWN,
) -> dict[str, Chart]:
    """Draw the named pictures, as far as there is something to draw; nothing is computed for the others."""
    units = replace(units, rotary=bench.rotary)
    view = View(bench, looks, parts or {}, units)
    drawn = {name: numbered(chart) for name in names if (chart := PICTURES[name].draw(view)) is not None}
    return {name: chart.shown(units) for name, chart in drawn.items()}


def numbered(chart: Chart) -> Chart:
    """Number each control by its name, so that it keeps its color whatever else is shown."""
    named = {curve.number: curve.name for panel in chart.panels for curve in panel.curves if curve.name in NUMBERS}
    others = {number: NUMBERS[name] for number, name in named.items() if NUMBERS[name] != number}
    if not others:
        return chart

    def changed(things: Iterable[Thing]) -> tuple[Thing, ...]:
        return tuple(replace(curve, number=others.get(curve.number, curve.number)) for curve in things)

    panels = (
        replace(
            curve,
            curves=changed(curve.curves),
            marks=changed(curve.marks),
            discs=changed(curve.discs),
            notes=changed(curve.notes),
            bands=changed(curve.bands),
        )
        for curve in chart.panels
    )
    return replace(chart, panels=tuple(panels))


def choices(bench: Bench, chosen: Iterable[str]) -> list[dict[str, object]]:
    """Return, for the page, each picture, if it is chosen, and why it cannot be drawn for this axis."""
    known = set(chosen)
    return [
        {
            "name": name,
            "title": picture.title,
            "chosen": name in known,
            "why": _NO_MACHINE if picture.of_machine and bench.loop is None else "",
        }
        for name, picture in PICTURES.items()
    ]
