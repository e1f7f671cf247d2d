"""The Goal page: automatic tuning with live progress, within limits that can also be dragged in the pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.blocks.catalogue import members
from feeddrive.blocks.families import Law
from feeddrive.figures.catalogue import goals, limitable
from feeddrive.figures.figure import Figure
from feeddrive.figures.of_loops import COMPLIANCE_PEAK, SENSITIVITY_PEAK
from feeddrive.files.machine import read_machine
from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import DRAWN, number
from feeddrive.loop.box import BOXES
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.plot.chart import Chart, Curve, Panel
from feeddrive.studio.desk import Asked, Desk, Room, Said, act, free_name
from feeddrive.studio.jobs import Found
from feeddrive.studio.pictures import WORST, charts
from feeddrive.studio.works import Shown, tuned
from feeddrive.tuning.by_hand import ByHand, Look
from feeddrive.tuning.operating_point import modelled_point
from feeddrive.workflow.command import Field, fields_of
from feeddrive.workflow.tune import TuneRequest
from feeddrive.workflow.tune_sources import has_integral

_LIMITS = tuple(figure.limit.option for figure in limitable() if figure.limit is not None)
_SHOWN = ("goal", *_LIMITS, "box", "reading_noise", "band", "filters", "law", "starts")


def _option(figure: Figure) -> str:
    """Return the name of the request field that contains the limit of a figure."""
    assert figure.limit is not None
    return figure.limit.option


_PEAK, _SOFT = _option(SENSITIVITY_PEAK), _option(COMPLIANCE_PEAK)
_BY_RULE = "without a machine file the search begins with a P-PI by a rule, and not with the current control"
_NO_INTEGRAL = (
    "the current control has no integral action, which the goal rope-snap needs: write cascade_ppi into the field law, "
    "so that the search begins with one, or take the goal stiffness"
)
# label and explanation of each field on the page; a limit of a package has those of its declaration
_WORDS: Mapping[str, tuple[str, str]] = {
    "goal": ("Goal", "what the search makes as good as it can within the limits"),
    "max_ms": ("Largest Ms", "peak of the sensitivity: 2 is usual, less is more robust"),
    "gain_margin": ("Least gain margin", "by how much the gain may rise before the loop oscillates"),
    "phase_margin": ("Least phase margin", "distance to -180° at each crossover"),
    "delay_margin": ("Least delay margin", "dead time that may be added"),
    "small_gain_delay": ("Least small-gain delay", "added dead time that the small-gain theorem admits"),
    "max_compliance": ("Largest compliance", "inverse of the least dynamic stiffness"),
    "max_noise": ("Largest force noise", "RMS of the force that noise of the encoders causes"),
    "box": ("Plants to hold for", "auto, standard, none, or tolerances as stiffness=0.2,mass=0.3"),
    "reading_noise": ("Encoder noise", "RMS of white noise in the positions that are read"),
    "band": ("Frequency range", "of the stiffness, as 1..30 in Hz"),
    "filters": ("Filters", "kept, free (tuned too), or placed (notches added where they pay)"),
    "law": ("Control law", "empty for the present one, or another one by its name"),
    "starts": ("Attempts", "searches from different starts; the best one counts"),
}
_FAR = 20.0  # dB above the curves, within which the picture reaches up to the limit
_TODAY, _NOW, _BEST, _FOUND = "today", "now", "best so far", "found"
FIELDS: Mapping[str, Field] = {field.name: field for field in fields_of(TuneRequest) if field.name in _SHOWN}


def _offered(name: str) -> tuple[str, ...]:
    """Return words among which the page lets choose in a field, beside a text of one's own."""
    if name == "law":
        return tuple(members(Law))  # type: ignore[type-abstract]
    return {"box": BOXES, "filters": ("kept", "free", "placed")}.get(name, ())


class Goal(Room):
    """The page for automatic tuning: the goal, its limits, and the result of the tuner."""

    name = "goal"

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.begin()

    @property
    def settings(self) -> dict[str, Any]:
        """Goal, limits and the other settings of a search, as fields of its request."""
        return self.desk.goal

    def begin(self) -> None:
        """Discard the result of the previous source; goal and limits are kept."""
        self.costs = list[float]()
        self.best: Control | None = None
        self.result: Shown | None = None
        self._looks: dict[str, tuple[Control, Look]] = {}
        self._integral: tuple[Control, bool] | None = None  # of the current control

    def show(self) -> Said:
        """Return the goal with its limits, the progress of the search, and the loop before and after it."""
        words: dict[str, Any] = {"fields": [self._field(FIELDS[name]) for name in _SHOWN], "ready": False}
        if self.desk.bench is None:
            return Said(words)
        drawn = self._charts()
        words |= {
            "ready": True,
            "begins": self._begins(),
            "over": self._over(),
            "levels": self._levels(drawn),
            "best": self.best is not None,
            **self._result(),
        }
        return Said(words, drawn)

    @act
    def set(self, asked: Asked) -> None:
        """Set a field from the string that the user entered; an empty string restores the default."""
        field = FIELDS[asked.choice("field", FIELDS)]
        text = asked.text("value").strip()
        settings = {key: value for key, value in self.settings.items() if key != field.name}
        if text:
            settings[field.name] = self._read(field, text)
        self.desk.aim(settings)

    @act
    def level(self, asked: Asked) -> None:
        """Set a limit to the ordinate to which it was dragged: a sensitivity in dB, or a dynamic stiffness in N/um."""
        height = asked.number("value")
        name = asked.choice("field", (_PEAK, _SOFT))
        if name == _PEAK:
            settings: dict[str, Any] = {
                **self.settings,
                # the exponent is capped, since a power beyond 308 overflows; an Ms of 1 or less is no valid limit
                name: units.rounded(max(10.0 ** min(height / 20.0, 300.0), 1.02), 3),
            }
        else:
            if not height > 0.0:
                raise ParameterError("the dynamic stiffness must be > 0")
            settings = {**self.settings, name: units.scaled(1.0 / units.rounded(height, 3), FIELDS[name].factor)}
        self.desk.aim(settings)

    @act
    def tune(self, _: Asked) -> None:
        """Run the optimizer from the current controller."""
        self.desk.check_free()
        request = self._request()
        self.costs, self.best, self.result = [], None, None

        def met(report: Found) -> None:
            # several searches report in turn: only an improvement on all of them counts
            if not self.costs or report.cost < min(self.costs):
                self.costs.append(report.cost)
                self.best = report.best

        def then(shown: Shown) -> None:
            self.result, self.best = shown, shown.result.control
            self.desk.did("tune", request, self._best())

        self.desk.start(self.name, "tune", partial(tuned, request), then, met)

    @act
    def accept(self, _: Asked) -> Said:
        """Make the result the current controller, or after a canceled search the best controller found."""
        if self.best is None:
            raise ParameterError("nothing was found yet: press Start first")
        self.desk.take(self._best() or self.best, self._written())
        self.begin()
        answer = self.show()
        return Said({**answer.words, "go": "tune"}, answer.charts)

    def _best(self) -> Control | None:
        """Return the best controller, with its parameters as rounded in the machine file if one was written."""
        written = self._written()
        return self.best if written is None else read_machine(written).loop(self.desk.needed.axis).control

    def _written(self) -> Path | None:
        """Return the machine file with the rounded result, for which the proof holds; None after a canceled search."""
        return None if self.result is None else self.result.files.get("Machine")

    @act
    def reject(self, _: Asked) -> None:
        """Discard the result. Raises ParameterError during a search."""
        state = self.desk.job_state()
        if state is not None and state.going and state.room == self.name:
            raise ParameterError(f"{state.what} is running: cancel it first, then reject what it found so far")
        self.begin()

    def _request(self) -> TuneRequest:
        bench = self.desk.needed
        source = bench.sources
        # a result that was accepted keeps its directory, to which an undo may return
        out = free_name(self.desk.folder, "tuned")
        places: dict[str, Any] = {"at": tuple(source.at), "axis": bench.axis or None}
        settings: dict[str, Any] = {**self.settings, "out": out, **places}
        if bench.from_machine:
            return TuneRequest(self.desk.machine_path(), **settings)
        baseline = None if bench.machine is None else self.desk.machine_path()
        return TuneRequest(
            source.source,
            baseline=baseline,
            motor=tuple(source.motor),
            unit=source.unit,
            sample_time=source.sample_time,
            delay=source.delay,
            **settings,
        )

    def _over(self) -> str:
        """Return over which plants the limits hold."""
        bench = self.desk.needed
        text = bench.over(self.settings.get("box", FIELDS["box"].default))
        return text.shown(replace(DRAWN, rotary=bench.rotary))

    def _begins(self) -> str:
        """Return a remark to be shown before a search starts; empty if there is none."""
        bench = self.desk.needed
        if bench.loop is None:
            return _BY_RULE
        goal, law = (self.settings.get(name, FIELDS[name].default) for name in ("goal", "law"))
        declared = goals()[goal].goal
        if declared is None or not declared.returns or law is not None:
            return ""
        control = bench.by_hand.control(self.desk.values)
        # kept with its control: the room is shown again at each report of a search
        if self._integral is None or self._integral[0] != control:
            self._integral = control, has_integral(control, bench.loop.sample_time)
        return "" if self._integral[1] else _NO_INTEGRAL

    @staticmethod
    def _read(field: Field, text: str) -> Any:
        if field.kind is str:
            return text
        try:
            # a decimal comma is what many users type
            number = float(text.replace(",", "."))
        except ValueError:
            raise ParameterError(f"{field.flag}: '{text:.40}' is no number") from None
        if field.kind is not int:
            return units.scaled(number, field.factor)
        if not number.is_integer():
            raise ParameterError(f"{field.flag} must be a whole number, not {text:.40}")
        return int(number)

    def _field(self, field: Field) -> dict[str, Any]:
        value = self.settings.get(field.name, field.default)
        shown = "" if value is None else str(value)
        if isinstance(value, float):
            shown = number(value / field.factor, 6)
        declared = field.declared.of_axis(self.desk.bench is not None and self.desk.bench.rotary)
        label, meaning = _WORDS.get(field.name, (field.flag.removeprefix("--").replace("-", " "), declared.meaning))
        return {
            "name": field.name,
            "label": label,
            "meaning": meaning,
            "unit": declared.unit if field.kind is float else "",
            "options": list(declared.options or ()),
            "offered": list(_offered(field.name)),
            "value": shown,
        }

    def _levels(self, drawn: Mapping[str, Chart]) -> list[dict[str, Any]]:
        """Return the limits that can be dragged in the pictures, each with its field and ordinate."""
        levels = list[dict[str, Any]]()
        peak = self.settings.get(_PEAK, FIELDS[_PEAK].default)
        if "sensitivity" in drawn:
            at, text = self._peak_limit(), f"Ms <= {number(peak, 6)}"
            levels.append({"field": _PEAK, "picture": "sensitivity", "at": at, "text": text})
        if "stiffness" in drawn:
            stiffness = self.settings.get(_SOFT)
            # the setting is a compliance in m/N, the picture shows its inverse in N/um
            at = self._least(drawn["stiffness"]) if stiffness is None else 1e-6 / stiffness
            text = "no limit of stiffness: drag it up"
            if stiffness is not None:
                reader = replace(DRAWN, rotary=self.desk.needed.rotary)
                text = f"stiffness >= {reader.value_text(1.0 / stiffness, 'N/m')}"
            levels.append({"field": _SOFT, "picture": "stiffness", "at": at, "text": text})
        return levels

    def _up_to_limit(self, chart: Chart) -> Chart:
        """Extend the sensitivity axis to the limit, so that it can be dragged, unless it is far above all curves."""
        first, *others = chart.panels
        limit = self._peak_limit()
        top = max(float(np.nanmax(curve.y)) for curve in first.curves)
        high = 3.0 + (max(top, limit) if limit < top + _FAR else top)
        return replace(chart, panels=(replace(first, high=high), *others))

    def _peak_limit(self) -> float:
        """Return the limit of Ms in dB."""
        return 20.0 * float(np.log10(self.settings.get(_PEAK, FIELDS[_PEAK].default)))

    @staticmethod
    def _least(chart: Chart) -> float:
        # without a limit the handle starts below all curves, where it limits nothing
        return 0.5 * min(float(np.nanmin(curve.y)) for curve in chart.panels[0].curves)

    def _look(self, name: str, control: Control) -> Look:
        known = self._looks.get(name)
        if known is None or known[0] != control:
            bench = self.desk.needed.with_control(control)
            known = self._looks[name] = (control, bench.by_hand.at(bench.by_hand.values))
        return known[1]

    def _at(self, picture: str, loop: Loop) -> Look:
        """Return the result at the worst plant of its box."""
        known = self._looks.get(picture)
        if known is None or known[0] != loop.control:
            by_hand = ByHand(loop.control, [modelled_point(loop, WORST)], self.desk.limits)
            known = self._looks[picture] = (loop.control, by_hand.at(by_hand.values))
        return known[1]

    def _charts(self) -> dict[str, Chart]:
        bench = self.desk.needed
        controls = {_TODAY: bench.before.start, _NOW: bench.by_hand.control(self.desk.values)}
        if self.best is not None:
            controls[_BEST if self.result is None else _FOUND] = self.best
        looks = {name: self._look(name, control) for name, control in controls.items()}
        drawn = charts(bench, looks)
        for picture, loop in ({} if self.result is None else self.result.result.worst).items():
            drawn |= charts(bench, {**looks, WORST: self._at(picture, loop)}, names=(picture,))
        if "sensitivity" in drawn:
            drawn["sensitivity"] = self._up_to_limit(drawn["sensitivity"])
        if len(self.costs) > 1:
            steps, costs = np.arange(1.0, len(self.costs) + 1.0), np.array(self.costs) / self.costs[0]
            curve = Curve(steps, costs, "cost of the best so far", 0, caption=f"{number(costs[-1])} of the first")
            drawn["search"] = Chart("improvements", (Panel("cost (of the first)", (curve,)),))
        shown = {name: drawn[name] for name in ("sensitivity", "stiffness", "open_loop", "search") if name in drawn}
        return shown if self.result is None else {**shown, **self.result.charts}

    def _result(self) -> dict[str, Any]:
        if self.result is None:
            return {"found": None, "unfinished": self.best is not None}
        return {"found": self.result.words, "unfinished": False}
