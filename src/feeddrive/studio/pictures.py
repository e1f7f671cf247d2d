"""The pictures of the page: the loop before, by hand and as it was kept, from the same charts as in reports."""

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
    """What is drawn: looks and parts of controls by name, of one bench.

    A control without parts has no runs, poles or step.
    """

    bench: Bench
    looks: Mapping[str, Look]
    parts: Mapping[str, Parts]
    units: Units

    @property
    def leading(self) -> dict[str, Figures]:
        """Of several operating points the one that leads: the largest Ms, or one that is not stable."""
        return {name: look.leading for name, look in self.looks.items()}

    @property
    def stable(self) -> dict[str, Figures]:
        """Those of them that are stable: the others have no sensitivity and no stiffness."""
        return {name: each for name, each in self.leading.items() if each.stable}

    def of_stable(self, part: Callable[[Parts], T | None]) -> dict[str, T]:
        """A part of each control that is stable and has it."""
        stable = {name: self.parts[name] for name, look in self.looks.items() if look.stable and name in self.parts}
        found = {name: part(each) for name, each in stable.items()}
        return {name: each for name, each in found.items() if each is not None}


def _open_loop(view: View) -> Chart:
    return open_loop_chart({name: each.margins for name, each in view.leading.items()}, view.units)


def _nyquist(view: View) -> Chart:
    return nyquist_chart({name: each.margins for name, each in view.leading.items()})


def _sensitivity(view: View) -> Chart | None:
    found = {name: each.margins for name, each in view.stable.items()}
    return sensitivity_chart(found, view.units) if found else None


def _stiffness(view: View) -> Chart | None:
    found = {name: each.stiffness for name, each in view.stable.items()}
    return stiffness_chart(found, view.units) if found else None


def _run(view: View) -> Chart | None:
    runs = view.of_stable(lambda each: each.run)
    return moves_chart(runs, view.units) if runs else None


def _snap(view: View) -> Chart | None:
    runs, bench = view.of_stable(lambda each: each.snap), view.bench
    return snap_chart(runs, bench.duty.begin, bench.duty.near, view.units) if runs else None


def _step(view: View) -> Chart | None:
    found = view.of_stable(lambda each: each.step)
    return step_response_chart(found) if found else None


def _poles(view: View) -> Chart | None:
    found = {name: each.linear for name, each in view.parts.items() if each.linear is not None}
    return plane_chart(found, view.units) if found else None


def _damping(view: View) -> Chart | None:
    found = {name: each.linear for name, each in view.parts.items() if each.linear is not None}
    return damping_chart(found, view.units) if found else None


def _friction(view: View) -> Chart | None:
    return view.bench.friction_shown(view.units)


def _response(view: View) -> Chart:
    leading = next(reversed(view.leading.values()))
    return overlay_chart(view.bench.overlays(leading.point), view.units)


@dataclass(frozen=True)
class Kind:
    """A picture that a person can choose: its title, how it is made, and whether it is shown until something is chosen.

    of_machine  it needs a machine
    """

    title: str
    made: Callable[[View], Chart | None]
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
USUAL = tuple(name for name, each in PICTURES.items() if each.usual)


def charts(
    bench: Bench, looks: Mapping[str, Look], parts: Mapping[str, Parts] | None = None, names: Iterable[str] = USUAL,
    units: Units = DRAWN,
) -> dict[str, Chart]:  # fmt: skip
    """The pictures that are named, as far as there is something to draw; nothing is computed for the others."""
    units = replace(units, rotary=bench.rotary)
    view = View(bench, looks, parts or {}, units)
    found = {name: numbered(chart) for name in names if (chart := PICTURES[name].made(view)) is not None}
    return {name: each.shown(units) for name, each in found.items()}


def numbered(chart: Chart) -> Chart:
    """The chart with the number of each control by its name, so that it keeps its color whatever else is shown."""
    named = {each.number: each.name for panel in chart.panels for each in panel.curves if each.name in NUMBERS}
    others = {number: NUMBERS[name] for number, name in named.items() if NUMBERS[name] != number}
    if not others:
        return chart

    def changed(things: Iterable[Thing]) -> tuple[Thing, ...]:
        return tuple(replace(each, number=others.get(each.number, each.number)) for each in things)

    panels = (
        replace(
            each, curves=changed(each.curves), marks=changed(each.marks), discs=changed(each.discs),
            notes=changed(each.notes), bands=changed(each.bands),
        )
        for each in chart.panels
    )  # fmt: skip
    return replace(chart, panels=tuple(panels))


def choices(bench: Bench, chosen: Iterable[str]) -> list[dict[str, object]]:
    """For the page: each picture, whether it is chosen, and why it cannot be drawn of this axis."""
    known = set(chosen)
    return [
        {"name": name, "title": each.title, "chosen": name in known,
         "why": _NO_MACHINE if each.of_machine and bench.loop is None else ""}
        for name, each in PICTURES.items()
    ]  # fmt: skip
