"""Cross-coupled control: a contour controller between the controllers of the axes that trace a contour."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from feeddrive.blocks.families import Coupling
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import StructureError


class CrossCoupled(Coupling):
    """Cross-coupled control of the contour error of two or three axes, in the frame of the path.

        e      = set positions - readings,   t = v / |v| of the set path,   e_t = t e
        normal = (e - t e_t) + curvature e_t² / 2,   curvature = (a - t (t a)) / |v|²
        velocity added to the commands of the laws = contour_gain · normal

    `normal` is the vector from the tool back to the path, to second order in e, or with `estimate = "linear"` without
    the curvature.  Identical axes follow exactly as with the position gain Kv + contour_gain across the path and Kv
    along it; so the largest contour_gain is the largest stable Kv minus Kv.  Axes that differ have the contour error
    e0/(1 + contour_gain n C P n), where e0 is the error without this coupling, n the unit normal, and C and P the
    velocity controller and the compliance of each axis.  Below `freeze_velocity` the frame keeps its last direction;
    before the first motion nothing is added.  The readings are those of the same sample; while an axis is off, tripped
    or without a reading, nothing is added to the others.
    The coupling runs on the controller, and is exported with the controllers of the machine.

    When to use: for contours of axes that differ, or that lag because they have no feedforward.  Do not use it instead
    of feedforward and equal gains, which cost nothing; to reduce the lag along the path, which it does not affect; or
    at a sharp corner, where the normal jumps.
    Source: Koren & Lo 1991 (variable gain), in the task frame of Chiu & Tomizuka 2001; their circular estimate has the
    term |e|²/2R, whereas the correct second-order term is e_t²/2R.
    """

    controls = True

    contour_axes: tuple[str, ...] = choice("axes that make the contour: two or three")
    contour_gain: Number = parameter("1/s", "velocity across the path per contour error", least=0)
    estimate: str = choice("order of the contour error", options=("second_order", "linear"), default="second_order")
    freeze_velocity: Number = parameter("m/s", "feed below which the frame keeps its direction", above=0, default=1e-6)

    class State(NamedTuple):
        """The direction of the set path; zeros before its first motion."""

        direction: tuple[Number, ...]

    def check(self) -> None:
        """Raise StructureError unless two or three different axes are named."""
        names = self.contour_axes
        if len(names) not in (2, 3) or len(set(names)) < len(names):
            raise StructureError(
                f"cross_coupled.contour_axes must name two or three axes, each once, not {', '.join(names) or 'none'}"
            )

    def axes(self) -> tuple[str, ...]:
        """Return the names of the axes that trace the contour."""
        return self.contour_axes

    def listen(self, setpoints: Mapping[str, Setpoint]) -> State:
        """Return the state with the direction of the set motion."""
        zero = ops.zero(next(iter(setpoints.values())).position)
        return self.State(self._direction(tuple(zero for _ in setpoints), setpoints)[0])

    def _direction(
        self, last: tuple[Number, ...], setpoints: Mapping[str, Setpoint]
    ) -> tuple[tuple[Number, ...], Any, Number]:
        """Return the unit tangent, True if the set path moves, and the square of the feed (1 at standstill)."""
        speeds = tuple(each.velocity for each in setpoints.values())
        square = _dot(speeds, speeds)
        moves = square > self.freeze_velocity * self.freeze_velocity
        # 1 at standstill: both branches of a choice are computed, and neither may divide by 0
        squared = ops.where(moves, square, 1.0)
        feed = ops.sqrt(squared)
        found = tuple(ops.where(moves, each / feed, held) for each, held in zip(speeds, last, strict=True))
        return found, moves, squared

    def correct(
        self, state: State, setpoints: Mapping[str, Setpoint], positions: Mapping[str, Number]
    ) -> tuple[State, dict[str, Number]]:
        tangent, moves, squared = self._direction(state.direction, setpoints)
        error = tuple(setpoint.position - positions[name] for name, setpoint in setpoints.items())
        along = _dot(tangent, error)
        # 1, or 0 before the first motion, when there is no path and nothing may be corrected
        known = _dot(tangent, tangent)
        normal = tuple(known * e - along * t for e, t in zip(error, tangent, strict=True))
        if self.estimate == "second_order":
            gained = tuple(setpoint.acceleration for setpoint in setpoints.values())
            forward = _dot(tangent, gained)
            share = ops.where(moves, 0.5 * (along * along) / squared, 0.0)
            bend = (a - forward * t for a, t in zip(gained, tangent, strict=True))
            normal = tuple(n + share * b for n, b in zip(normal, bend, strict=True))
        return self.State(tangent), {
            name: self.contour_gain * n for name, n in zip(self.contour_axes, normal, strict=True)
        }


def _dot(a: tuple[Any, ...], b: tuple[Any, ...]) -> Any:
    """Return the inner product."""
    first, *rest = (x * y for x, y in zip(a, b, strict=True))
    for each in rest:
        first = first + each
    return first
