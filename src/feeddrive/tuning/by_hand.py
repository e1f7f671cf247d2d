"""Manual tuning: adjust the parameters of a controller and evaluate its loop at all operating points."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from feeddrive.language import tree
from feeddrive.language.block import Block, Declaration
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.tuning.closed_loop import Figures, answer, figures
from feeddrive.tuning.control_response import ControlResponse, Response
from feeddrive.tuning.criteria import Judged, Limits, judged
from feeddrive.tuning.filters import HIGHEST
from feeddrive.tuning.operating_point import OperatingPoint
from feeddrive.tuning.proof import ROOM

# largest magnitude of a response: figures contain its square, and pictures are drawn in single precision
_LARGEST = 1e30
_WIDE = 30.0  # the range of a parameter is 1/30 to 30 times its value
# limits of the machine, which tuning must not change
_SAFE = ("guard", "force_limit")
_NOT_FINITE = "the loop has no finite response with these numbers: take values nearer to the previous ones"


@dataclass(frozen=True)
class Knob:
    """An adjustable parameter of a controller.

    name         dotted name within the controller, such as law.Kv or filters.0.frequency
    block        kind of the block to which the parameter belongs
    value        present value, SI
    low, high    range of adjustment, within the bounds of the parameter
    logarithmic  True if the adjustment is logarithmic: equal steps multiply the value by equal factors
    """

    name: str
    block: str
    value: float
    low: float
    high: float
    logarithmic: bool
    declared: Declaration


def knobs(control: Control, sample_time: float) -> tuple[Knob, ...]:
    """Return all adjustable parameters of a controller.

    They are those of law, observers, filters, feedforward and compensation; guard and force limit are not adjustable.
    """
    return tuple(_knobs(control, sample_time))


def _knobs(control: Control, sample_time: float) -> Iterator[Knob]:
    for name, value in tree.leaves(control):
        if name.split(".")[0] in _SAFE or not isinstance(value, (int, float)):
            continue
        declared, kind = tree.declaration(control, name), _kind(control, name)
        least = declared.above if declared.least is None else declared.least
        most = declared.below if declared.most is None else declared.most
        if declared.unit == "Hz":
            most = min(math.inf if most is None else most, HIGHEST / sample_time)
        # gains, times and frequencies act by factors; a share or a flag, bounded by 2 or less, by differences
        if value > 0.0 and least is not None and least >= 0.0 and (most is None or most > 2.0):
            low, high, logarithmic = value / _WIDE, value * _WIDE, True
        else:
            # a parameter at 0 needs a range, too
            reach = 2.0 * abs(value) or 1.0
            low, high, logarithmic = value - reach, value + reach, False
        low = low if least is None else max(low, least)
        high = high if most is None else min(high, most)
        yield Knob(name, kind, float(value), low, high, logarithmic, declared)


def _kind(control: Control, name: str) -> str:
    """Return the kind of the block to which a parameter belongs."""
    kind, held = control.kind, cast("Any", control)
    for part in name.split(".")[:-1]:
        held = held[int(part)] if isinstance(held, tuple) else getattr(held, part)
        kind = held.kind if isinstance(held, Block) else kind
    return kind


@dataclass(frozen=True)
class Verdict:
    """A figure compared with its limit, at the operating point and frequency where it is closest to the limit.

    frequency  critical frequency, Hz; None for a figure without a frequency, such as the force noise
    used       utilization of the limit: above 1 the limit is exceeded
    """

    judged: Judged
    point: str
    frequency: float | None
    used: float

    @property
    def keeps(self) -> bool:
        """True if the limit is satisfied."""
        return self.judged.keeps

    @property
    def text(self) -> Text:
        """The figure and its critical frequency, in words."""
        where = "" if self.frequency is None else f" at {Quantity(self.frequency, 'Hz')}"
        return Text(f"{self.judged.text}{where}")

    def __str__(self) -> str:
        return str(self.text)


@dataclass(frozen=True)
class Look:
    """The evaluation of a controller at one set of values.

    figures  figures of the loop at each operating point
    judged   for each limit the verdict at its worst point, highest utilization first
    """

    figures: tuple[Figures, ...]
    judged: tuple[Verdict, ...]

    @cached_property
    def stable(self) -> bool:
        """True if the loop is stable at every point."""
        return all(loop.stable for loop in self.figures)

    @cached_property
    def leading(self) -> Figures:
        """The figures at the critical operating point.

        The critical point is an unstable one if there is any, else the point with the highest utilization of a limit
        or, without limits, the point with the largest Ms.
        """
        worst = self.judged[0].point if self.judged and self.stable else ""
        return max(self.figures, key=lambda loop: (not loop.stable, loop.point == worst, loop.margins.sensitivity_peak))


class ByHand:
    """A controller at several operating points; it is traced once, so that each evaluation takes a few milliseconds.

    limits  limits that every evaluation checks; they determine the critical point
    """

    def __init__(
        self, control: Control, points: Sequence[OperatingPoint], limits: Limits | None = None, velocity: float = 0.05
    ) -> None:
        if not points:
            raise ParameterError("tuning by hand needs an operating point: a machine, or a measured response")
        # a verdict names its point
        called = [point.name for point in points]
        if len({*called}) < len(called):
            raise ParameterError(f"operating points need names of their own, not {', '.join(called)}: rename one")
        self.start, self.points = control, tuple(points)
        self.limits = limits or Limits()
        self.knobs = knobs(control, points[0].sample_time)
        names = [knob.name for knob in self.knobs]
        self._responses = {
            T: ControlResponse(control, T, names, velocity) for T in {point.sample_time for point in points}
        }

    @property
    def values(self) -> dict[str, float]:
        """The start values of all adjustable parameters, by name."""
        return {knob.name: knob.value for knob in self.knobs}

    def control(self, values: Mapping[str, float]) -> Control:
        """Return the controller with these values.

        Raises ParameterError for a parameter that is unknown, out of bounds, or invalid at the sample time of a point.
        """
        varied = tree.vary(self.start, dict(values))
        for sample_time in self._responses:
            tree.check_sampled(varied, sample_time)
        return varied

    def at(self, values: Mapping[str, float], limits: Limits | None = None) -> Look:
        """Evaluate the loop at all points against the stored limits or the given ones.

        Raises ParameterError for a value out of bounds, and for a controller whose response is not finite at these
        values.
        """
        # for its checks only: the trace below would accept values out of bounds
        self.control(values)
        limits = limits or self.limits
        row = np.array([values.get(knob.name, knob.value) for knob in self.knobs])
        responses = [self._response(point, row) for point in self.points]
        if not all(np.all(np.isfinite(response.value)) for response in responses):
            raise ParameterError(_NOT_FINITE)
        loops = tuple(
            figures(answer(point, response), limits.reading_noise)
            for point, response in zip(self.points, responses, strict=True)
        )
        if not all(_drawable(loop.loop_gain) and _drawable(loop.compliance) for loop in loops):
            raise ParameterError(_NOT_FINITE)
        verdicts = [_verdicts(limits, loop) for loop in loops]
        worst = (max(kinds, key=lambda verdict: verdict.used) for kinds in zip(*verdicts, strict=True))
        return Look(loops, tuple(sorted(worst, key=lambda verdict: -verdict.used)))

    def model(self, values: Mapping[str, float], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray] | None:
        """Return the linear model [A B; c d] of the controller at given values, and its derivatives.

        The derivatives are those with respect to the named parameters; the sample time is that of the first point. For
        a multirate law the result is None.
        """
        response = self._responses[self.points[0].sample_time]
        if response.period > 1:
            return None
        all_names = [knob.name for knob in self.knobs]
        matrix, slopes = response.model([values.get(knob.name, knob.value) for knob in self.knobs])
        return matrix, slopes[:, :, [all_names.index(name) for name in names]]

    def _response(self, point: OperatingPoint, row: np.ndarray) -> Response:
        response = self._responses[point.sample_time]
        if response.period > 1:
            return response.at(row, point.frequency, response.images(point.by_force_at, point.frequency), slopes=False)
        return response.of_model(response.models(row[None])[0], point.frequency)


def _drawable(frf: FRF) -> bool:
    size = np.abs(frf.response)
    return bool(np.all(np.isfinite(size)) and np.max(size) < _LARGEST)


def _verdicts(limits: Limits, loop: Figures) -> list[Verdict]:
    """Compare each figure that has a limit with this limit, at one operating point."""
    judgments = judged(limits, loop, ROOM)
    return [Verdict(one, loop.point, one.limit.declared.where(loop), one.used) for one in judgments]
