"""The pictures of the page: the loop under the reference controller, the current controller and stored controllers."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from feeddrive.analysis.step_response import StepResponse, step_response
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.quantity import DRAWN, Quantity, Units, number
from feeddrive.language.text import Text
from feeddrive.language.units import rounded
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.simulate import Run
from feeddrive.plot.chart import BAR, DEGREES, LOG, Band, Chart, Curve, Disc, Level, Mark, Note, Panel
from feeddrive.plot.complex_plane import damping_chart, nyquist_chart, plane_chart
from feeddrive.plot.over_frequency import open_loop_chart, overlay_chart, sensitivity_chart, stiffness_chart
from feeddrive.plot.over_time import moves_chart, snap_chart, step_response_chart
from feeddrive.studio.bench import Bench
from feeddrive.studio.desk import Desk, Values
from feeddrive.tuning.by_hand import Look
from feeddrive.tuning.closed_loop import Figures
from feeddrive.tuning.poles import LoopPole, Model, loop_poles, nearest_pole, placed_dragged, placed_poles, pole_moved
from feeddrive.tuning.tune import own_tunables

T = TypeVar("T")


class Parts:
    """The simulations of a controller on a bench.

    A simulation is None if there is no machine, the loop is unstable, or the axis leaves its bounds.
    """

    def __init__(self, bench: Bench, control: Control, name: str) -> None:
        self.bench, self.control, self.name = bench, control, name

    @cached_property
    def run(self) -> Run | None:
        """The simulated run: first the move, then a force pulse on the table."""
        return self._if_there(lambda: self.bench.run(self.control, self.name))

    @cached_property
    def snap(self) -> Run | None:
        """The rope-snap test: the response of the table to a force that is released."""
        return self._if_there(lambda: self.bench.snap(self.control, self.name))

    @cached_property
    def linear(self) -> StateSpace | None:
        """The linearized loop from set position to table position."""
        return self._if_there(lambda: self.bench.linear(self.control))

    @cached_property
    def step(self) -> StepResponse | None:
        """The response of the table to a step of the set position."""
        model = self.linear
        return None if model is None else self._if_there(lambda: step_response(model))

    def _if_there(self, compute: Callable[[], T]) -> T | None:
        if self.bench.loop is None:
            return None
        with suppress(FeeddriveError):
            return compute()
        return None


_ACROSS = 0.02  # of |s|: a step of a key
_LOOP = "loop"  # loop.0, loop.1: poles of the closed loop


class HeldPoles:
    """The movable poles of the current controller. A closed-loop pole keeps its name while it moves."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self._named: dict[str, complex] = {}

    def shown(self, units: Units) -> tuple[list[dict[str, Any]], str]:
        """Return the handles of the poles, abscissa in Hz and ordinate in the displayed unit, and an explanation.

        Both are empty if there is no machine.
        """
        bench = self.desk.needed
        if bench.loop is None:
            return [], ""
        placed, nyquist = placed_poles(self.desk.control), 0.5 / float(bench.loop.sample_time)
        if placed:
            sentence = (
                "Dragged are the poles that the law places; the crosses are those of the sampled loop, with delay, "
                "filters and modes that the law does not know."
            )
            return [_grip(pole.name, pole.label, pole.s, nyquist, units) for pole in placed], sentence
        names, loop_poles = self._gains(), self._of_loop()
        if not loop_poles:
            return [], "No single gain of this law moves a pole: change its numbers."
        moved = f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
        sentence = f"Dragged are poles of the loop; {moved} follow with the smallest change that takes the pole there."
        return [_grip(name, "pole of the loop", s, nyquist, units) for name, s in loop_poles], sentence

    def moved(self, name: str, s: complex) -> Values:
        """Return the gains that move a pole as close to `s`, 1/s, as possible. Raises ParameterError if unknown."""
        if not np.isfinite(abs(s)):
            raise ParameterError("a pole must be taken to a finite place")
        if not name.startswith(f"{_LOOP}."):
            return placed_dragged(self.desk.control, name, s)
        # a page that was reloaded may send a pole that was not yet computed
        if name not in self._named:
            self._of_loop()
        if name not in self._named:
            raise ParameterError(f"there is no pole '{name:.60}' that the gains move")
        axis, model, gains = self._loop()
        values, self._named[name] = pole_moved(axis, model, gains, self._named[name], s)
        return {gain: rounded(value, 6) for gain, value in zip(self._gains(), values, strict=True)}

    def at(self, name: str) -> complex:
        """Return the value of a pole, 1/s. Raises ParameterError for an unknown one."""
        placed = {pole.name: pole.s for pole in placed_poles(self.desk.control)}
        now = placed.get(name, self._named.get(name))
        if now is None:
            raise ParameterError(f"there is no pole '{name:.60}' that can be moved")
        return now

    def stepped(self, name: str, across: float, up: float) -> Values:
        """Return the gains that move a pole by keyboard steps of 2 % of its magnitude."""
        now = self.at(name)
        return self.moved(name, now + _ACROSS * abs(now) * complex(across, up))

    def _gains(self) -> Sequence[str]:
        """Return the names of the positive tunables, which can be varied logarithmically."""
        control = self.desk.control
        return [name for name in own_tunables(control) if float(tree.get(control, name)) > 0.0]

    def _loop(self) -> tuple[Any, Model, np.ndarray]:
        bench, values, names = self.desk.needed, self.desk.values, self._gains()

        def model(gains: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            modelled = bench.by_hand.model({**values, **dict(zip(names, gains, strict=True))}, names)
            # `_of_loop` returns no movable poles for such a control
            assert modelled is not None
            return modelled

        return bench.mechanics, model, np.array([values[name] for name in names])

    def _of_loop(self) -> list[tuple[str, complex]]:
        """Return the closed-loop poles with their names; each inherits the name of the nearest earlier pole."""
        names = self._gains()
        if not names or self.desk.needed.by_hand.model(self.desk.values, names) is None:
            return []
        there, before = list[LoopPole](loop_poles(*self._loop())), dict(self._named)
        self._named = {}
        # the closest pairs first: a pole that hardly moved keeps its name, whatever the others do
        for name, s in sorted(before.items(), key=lambda item: _distance(there, item[1])):
            nearest = nearest_pole(there, s)
            if nearest is not None:
                there = [pole for pole in there if pole is not nearest]
                self._named[name] = nearest.s
        fresh = (f"{_LOOP}.{i}" for i in range(len(before) + len(there)) if f"{_LOOP}.{i}" not in self._named)
        self._named |= {name: pole.s for name, pole in zip(fresh, there, strict=False)}
        return list(self._named.items())


def _grip(name: str, label: str, s: complex, nyquist: float, units: Units) -> dict[str, Any]:
    _, factor = units.of("Hz")
    hertz, ratio = abs(s) / (2.0 * np.pi), -s.real / abs(s)
    text = Text(f"{Quantity(hertz, 'Hz')}, damping ratio {number(ratio, 3)}").shown(units)
    return {
        "name": name,
        "label": label,
        "text": text,
        "low": -nyquist,
        "high": nyquist,
        "x": s.real / (2.0 * np.pi),
        "y": factor * s.imag / (2.0 * np.pi),
    }


def _distance(poles: Sequence[LoopPole], s: complex) -> float:
    return min((abs(pole.s - s) for pole in poles), default=0.0)


Thing = TypeVar("Thing", Curve, Mark, Disc, Note, Band)
WORST = "found, worst plant"
# from 100 on: colors, dashes and marks that the page keeps for these names, whatever other curves there are
NUMBERS = {"today": 100, "now": 101, "A": 102, "B": 103, "C": 104, "found": 105, "best so far": 105, WORST: 106}
_NAMED = min(NUMBERS.values())
_NO_MACHINE = "needs a machine file: a measured response alone has no poles, no friction and moves no axis"


@dataclass(frozen=True)
class View:
    """The input of the pictures: evaluations and simulations of controllers by name, on one bench.

    A controller without an entry in `parts` has no runs, poles or step response.
    """

    bench: Bench
    looks: Mapping[str, Look]
    parts: Mapping[str, Parts]
    units: Units

    @property
    def leading(self) -> dict[str, Figures]:
        """The figures of each controller at its critical operating point (see `Look.leading`)."""
        return {name: look.leading for name, look in self.looks.items()}

    @property
    def stable(self) -> dict[str, Figures]:
        """The figures in `leading` of stable loops only, since unstable loops have no sensitivity or stiffness."""
        return {name: figures for name, figures in self.leading.items() if figures.stable}

    def of_stable(self, part: Callable[[Parts], T | None]) -> dict[str, T]:
        """Return, for each stable controller, the simulation that `part` selects, if it is available."""
        stable = {name: self.parts[name] for name, look in self.looks.items() if look.stable and name in self.parts}
        available = {name: part(value) for name, value in stable.items()}
        return {name: value for name, value in available.items() if value is not None}


_BRANCH = -180.0  # deg: the phase is drawn within a half turn around it
_NEAR_BRANCH = 90.0  # deg to both sides of it that are in view before somebody zooms


def _open_loop(view: View) -> Chart:
    margins_by_name = {name: figures.margins for name, figures in view.leading.items()}
    return wrapped(open_loop_chart(margins_by_name, view.units))


def wrapped(chart: Chart) -> Chart:
    """Return a chart of open loops with the phase within -360 to 0 degrees, in view from -270 to -90 degrees.

    The phase margin is read at -180 degrees; a dead time alone takes the phase to -1000 degrees at high frequencies.
    A curve is interrupted where it passes from -360 to 0 degrees.
    """

    def on_branch(panel: Panel) -> Panel:
        if panel.scale != DEGREES:
            return panel
        return replace(
            panel,
            curves=tuple(_curve_on_branch(curve) for curve in panel.curves),
            bands=tuple(_band_on_branch(band) for band in panel.bands),
            marks=tuple(replace(mark, y=float(mark.y + _turns(mark.y))) for mark in panel.marks),
            levels=(Level(_BRANCH),),
            low=_BRANCH - _NEAR_BRANCH,
            high=_BRANCH + _NEAR_BRANCH,
        )

    return replace(chart, panels=tuple(map(on_branch, chart.panels)))


def _turns(phase: float | np.ndarray) -> np.ndarray:
    """Return the whole turns in degrees that take a phase to the half turn around -180 degrees."""
    return -360.0 * np.round((np.asarray(phase) - _BRANCH) / 360.0)


def _curve_on_branch(curve: Curve) -> Curve:
    if curve.look == BAR:
        # the two ends of a bar stay together: from the curve to its nearest -180 degrees
        return replace(curve, y=curve.y + _turns(float(np.nanmean(curve.y))))
    turns = _turns(curve.y)
    breaks = np.flatnonzero(np.diff(turns) != 0.0) + 1
    x, y = (np.insert(values, breaks, np.nan) for values in (curve.x, curve.y + turns))
    return replace(curve, x=np.where(np.isnan(x), np.insert(curve.x, breaks, curve.x[breaks]), x), y=y)


def _band_on_branch(band: Band) -> Band:
    turns = _turns(0.5 * (band.low + band.high))
    # the shading of a low coherence covers the whole height, whatever the branch
    whole = band.high - band.low > 1e3
    turns = np.where(whole, 0.0, turns)
    breaks = np.flatnonzero(np.diff(turns) != 0.0) + 1
    x = np.insert(band.x, breaks, band.x[breaks])
    low, high = (np.insert(values + turns, breaks, np.nan) for values in (band.low, band.high))
    return replace(band, x=x, low=low, high=high)


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
    # unstable loops too: their growing poles are what a reader looks for
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
    """A selectable picture, with its title and its drawing function.

    usual       True if it is shown by default
    of_machine  True if it needs a machine
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
    "run": Kind("Following error", _run, usual=True, of_machine=True),
    "step": Kind("Step of the set position", _step, of_machine=True),
    "snap": Kind("Rope snap: load released at once", _snap, of_machine=True),
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
    """Draw the named pictures for which data are available; nothing is computed for the others."""
    units = replace(units, rotary=bench.rotary)
    view = View(bench, looks, parts or {}, units)
    drawn = {name: numbered(chart) for name in names if (chart := PICTURES[name].draw(view)) is not None}
    return {name: chart.shown(units) for name, chart in drawn.items()}


def numbered(chart: Chart) -> Chart:
    """Assign a fixed number to each controller by its name, so that its color does not depend on the other curves."""
    named = {curve.number: curve.name for panel in chart.panels for curve in panel.curves if curve.name in NUMBERS}
    others = {number: NUMBERS[name] for number, name in named.items() if NUMBERS[name] != number}
    if not others:
        return chart

    def changed(things: Iterable[Thing]) -> tuple[Thing, ...]:
        return tuple(replace(curve, number=others.get(curve.number, curve.number)) for curve in things)

    return _changed(chart, changed)


def as_in_report(chart: Chart, hidden: Iterable[str], low: float | None, high: float | None) -> Chart:
    """Return a chart of the page as a report draws it, with the colors and dashes of its curves in their order.

    hidden     names of controllers that are not drawn
    low, high  the part of x that is in view; None for that of the chart
    """
    away = {NUMBERS[name] for name in hidden if name in NUMBERS}
    things = [thing for panel in chart.panels for part in _of_curves(panel) for thing in part]
    numbers = sorted({thing.number for thing in things if thing.number >= _NAMED} - away)
    free = (number for number in range(len(things)) if all(thing.number != number for thing in things))
    fresh = dict(zip(numbers, free, strict=False))

    def shown(part: Iterable[Thing]) -> tuple[Thing, ...]:
        return tuple(
            replace(thing, number=fresh.get(thing.number, thing.number)) for thing in part if thing.number not in away
        )

    drawn = _changed(chart, shown)
    drawn = replace(drawn, low=chart.low if low is None else low, high=chart.high if high is None else high)
    return replace(drawn, panels=tuple(_in_view(panel, drawn) for panel in drawn.panels))


def _in_view(panel: Panel, chart: Chart) -> Panel:
    """Let the ordinate of a panel without a range of its own follow what is in view, as on the page."""
    if chart.low is None or chart.high is None or panel.low is not None or panel.high is not None:
        return panel
    seen = [curve.y[(curve.x >= chart.low) & (curve.x <= chart.high)] for curve in panel.curves]
    y = np.concatenate([*seen, np.empty(0)])
    y = np.log(y[y > 0.0]) if panel.scale == LOG else y[np.isfinite(y)]
    if y.size == 0 or np.min(y) == np.max(y):
        return panel
    room = _ROOM * float(np.ptp(y))
    low, high = float(np.min(y)) - room, float(np.max(y)) + room
    return (
        replace(panel, low=float(np.exp(low)), high=float(np.exp(high)))
        if panel.scale == LOG
        else replace(panel, low=low, high=high)
    )


_ROOM = 0.06  # of the range of y: free above and below the curves
_OF_CURVES = ("curves", "marks", "discs", "notes", "bands")  # parts of a panel whose things have a number of a curve


def _of_curves(panel: Panel) -> list[tuple[Any, ...]]:
    return [getattr(panel, name) for name in _OF_CURVES]


def _changed(chart: Chart, change: Callable[[Iterable[Any]], tuple[Any, ...]]) -> Chart:
    panels = (
        replace(panel, **dict(zip(_OF_CURVES, map(change, _of_curves(panel)), strict=True))) for panel in chart.panels
    )
    return replace(chart, panels=tuple(panels))


def choices(bench: Bench, chosen: Iterable[str]) -> list[dict[str, object]]:
    """Return for each picture its name and title, whether it is selected, and why it is unavailable for this axis."""
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
