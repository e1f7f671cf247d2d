"""The force of a milling tool, with the chip from the actual relative motion of tool and table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from feeddrive.blocks.machine_families import Coupling, Cutter
from feeddrive.blocks.signals import Motion
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, choice, parameter, part
from feeddrive.language.errors import StructureError
from feeddrive.language.ring import History


class MillingCut(Coupling):
    """Cutting forces on three axes; the chip is the relative motion of tool and table over the last tooth period τ.

        τ         = 60 / (teeth spindle_speed)
        Δ         = r(t) - r(t - τ),  r = (x, y) of the tool against the workpiece, actual, in the middle of the substep
        chip_load = |Δ|,  t = Δ / |Δ|,  n = z x t
        angle     = start_angle + 2π (spindle_speed / 60) t
        F_x, F_y  = F_feed t + F_normal n,   F_z = -F_axial

    F_feed, F_normal and F_axial come from the cutter.  Each tooth cuts the surface left by the tooth before, so that
    vibration changes the chip and the chip excites vibration (regeneration).  At the start the chip is 0 and grows over
    the first tooth period, as if the tool had stood still before.  A table moves the workpiece: where `moves` says
    "table", r is -x (or -y) of the axis, and the force on the axis is the opposite one.
    It acts for cut_from <= t < cut_to; the spindle always turns.
    When not to use it: with substeps longer than a tenth of τ; where vibration lifts a tooth out of the cut: the force
    is linear in Δ, and only the surface of the last tooth counts.
    Source: forces Beltrán-Carbajal et al. 2013, eqs. (4)-(8); regeneration Altintas & Budak 1995, eq. (2).
    """

    cutter: Cutter = part("the tool")
    spindle_speed: Number = parameter("rpm", "turns of the spindle", above=0)
    along_x: str = choice("axis that moves the tool along x", default="x")
    along_y: str = choice("axis that moves the tool along y", default="y")
    along_z: str | None = choice("axis that moves the tool along z; absent: none", default=None)
    moves: str = choice("what the axes move", options=("tool", "table"), default="tool")
    start_angle: Number = parameter("rad", "angle of the spindle at t = 0", default=0)
    cut_from: Number = parameter("s", "when the cut begins", default=0)
    cut_to: Number | None = parameter("s", "when it ends; absent: never", default=None)
    remembered: int = choice("substeps of motion that are stored; they must cover τ", default=4096, least=2)

    class State(NamedTuple):
        """The past positions of the tool relative to the workpiece along x and y, m."""

        x: History
        y: History

    def check(self) -> None:
        """Each direction has its own axis."""
        if len(set(self.axes())) < len(self.axes()):
            raise StructureError(
                f"milling_cut: x, y and z must be moved by different axes, not {', '.join(self.axes())}"
            )

    def rules(self) -> Iterator[Rule]:
        """The end comes after the beginning."""
        begin, end = self.cut_from, self.cut_to
        if end is not None:
            yield Rule(
                end > begin,
                "the cut ends after it begins",
                lambda: f"milling_cut.cut_to = {end:g} s must be > milling_cut.cut_from = {begin:g} s; absent: never",
            )

    def axes(self) -> tuple[str, ...]:
        """Of the tool or of the table."""
        return (self.along_x, self.along_y, *(() if self.along_z is None else (self.along_z,)))

    def period(self) -> Number:
        """τ in s."""
        return 60.0 / (self.cutter.teeth * self.spindle_speed)

    def substep_rules(self, h: Number) -> Iterator[Rule]:
        """The stored substeps cover the tooth period."""
        period = self.period()
        yield Rule(
            period / h <= float(self.remembered - 1),
            "the substeps that the cut stores are not shorter than the tooth period",
            lambda: (
                f"milling_cut.remembered = {self.remembered} substeps of {h:g} s are shorter than the tooth period of "
                f"{period:g} s: at least {-int(-(period / h) // 1) + 1}"
            ),
        )

    def start(self, prepared: Any, motions: Mapping[str, Motion]) -> State:
        """The tool has been at rest at its present position."""
        x, y = self._relative(motions)
        return self.State(History.start(self.remembered, x), History.start(self.remembered, y))

    def step(
        self, prepared: Any, state: State, motions: Mapping[str, Motion], time: Number, h: Number
    ) -> tuple[State, dict[str, tuple[Number, Number]]]:
        """The equations above."""
        x, y = self._relative(motions)
        state = self.State(state.x.push(x), state.y.push(y))
        ago = self.period() / h
        dx, dy = x - state.x.ago(ago), y - state.y.ago(ago)
        chip = ops.sqrt(dx * dx + dy * dy)
        safe = ops.where(chip > 0.0, chip, 1.0)
        turns = (self.spindle_speed / 60.0) * time
        angle = self.start_angle + 2.0 * ops.pi * (turns - ops.floor(turns))
        feed, normal, axial = self.cutter.forces(angle, 1.0)  # N per metre of chip
        acts = time >= self.cut_from
        if self.cut_to is not None:
            acts = ops.both(acts, time < self.cut_to)
        # chip · direction is (dx, dy) itself, which is smooth where the chip vanishes
        on = ops.where(acts, 1.0, 0.0) * (1.0 if self.moves == "tool" else -1.0)
        found = {
            self.along_x: (0.0, on * (feed * dx - normal * dy)),
            self.along_y: (0.0, on * (feed * dy + normal * dx)),
        }
        if self.along_z is not None:
            found[self.along_z] = 0.0, -(on * (axial * (safe * ops.where(chip > 0.0, 1.0, 0.0))))
        return state, found

    def _relative(self, motions: Mapping[str, Motion]) -> tuple[Any, Any]:
        """Of the tool against the workpiece."""
        x, y = motions[self.along_x].position_load, motions[self.along_y].position_load
        return (x, y) if self.moves == "tool" else (-x, -y)
