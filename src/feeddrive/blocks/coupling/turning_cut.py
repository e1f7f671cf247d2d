"""The force of a turning tool, with the chip from the actual motion of its axes."""

from collections.abc import Iterator, Mapping
from typing import Any

from feeddrive.blocks.coupling.steady_turns import TOWARDS, covers, sign_of
from feeddrive.blocks.cutting.turning_tool import TurningTool
from feeddrive.blocks.families import Coupling
from feeddrive.blocks.signals import Motion
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, choice, parameter, part
from feeddrive.language.errors import StructureError
from feeddrive.language.ring import Track


class TurningCut(Coupling):
    """Regenerative turning force on one or two axes: the chip is the motion of the tool since the earlier turns.

        τ      = 60 / spindle_speed
        step_m = r(t) - r(t - mτ),   m = 1 .. surfaces,   r along feed and depth, actual
        F      = force of the tool for these steps

    along_feed moves the tool along the feed, in the direction `feed_towards`; along_depth, if there is one, moves it
    into the work, in the direction `depth_towards`.  Vibration changes the chip and the chip excites vibration
    (regeneration); where it lifts the tool out of the work, a later turn removes the chip of several turns.  r is taken
    at the predicted middle of a substep and r(t - mτ) is predicted in the same way, by cubic Hermite interpolation, so
    that a motion which repeats with τ leaves the chip of the feed.  At the start the tool has been at rest outside the
    workpiece: the chip grows over the first turn.  The force acts for cut_from <= t < cut_to.  If an axis moves the
    workpiece, its direction is that in which the work approaches the tool.
    Do not use it with substeps longer than a tenth of τ, for a spindle whose speed changes (constant cutting speed on a
    face), or for a depth of cut that changes with the position.
    Source: Altintas, Manufacturing Automation (2nd ed. 2012), chapter 4, h(t) = h0 + y(t - τ) - y(t); several surfaces
    Tlusty & Ismail 1981.
    """

    tool: TurningTool = part("the tool")
    spindle_speed: Number = parameter("rpm", "turns of the spindle", above=0)
    along_feed: str = choice("axis that moves the tool along the feed", default="z")
    along_depth: str | None = choice("axis that moves the tool into the work; absent: none", default=None)
    feed_towards: str = choice("direction of that axis in which the feed goes", options=TOWARDS, default="negative")
    depth_towards: str = choice("direction of that axis in which the work lies", options=TOWARDS, default="negative")
    cut_from: Number = parameter("s", "when the cut begins", default=0)
    cut_to: Number | None = parameter("s", "when it ends; absent: never", default=None)
    surfaces: int = choice("earlier turns whose surface the tool may meet", default=3, least=1, most=32)
    remembered: int = choice("substeps of motion that are stored; they must cover the surfaces", default=4096, least=4)

    def check(self) -> None:
        """Raise StructureError if feed and depth share an axis."""
        if self.along_depth == self.along_feed:
            raise StructureError(
                f"turning_cut: feed and depth must be along different axes, not both along {self.along_feed}"
            )

    def axes(self) -> tuple[str, ...]:
        """Return the names of the axes that move the tool."""
        return (self.along_feed,) if self.along_depth is None else (self.along_feed, self.along_depth)

    def substep_rules(self, h: Number) -> Iterator[Rule]:
        """Yield the validity rule: the stored substeps cover the turns that the tool looks back."""
        yield covers("turning_cut", self.remembered, float(self.surfaces) * (60.0 / self.spindle_speed), h)

    def start(self, prepared: Any, motions: Mapping[str, Motion]) -> Track:
        """Return the state of a tool that has been at rest at its present position."""
        return Track.start(self.remembered, self._place(motions)[0])

    def step(
        self, prepared: Any, state: Track, motions: Mapping[str, Motion], time: Number, h: Number
    ) -> tuple[Track, dict[str, tuple[Number, Number]]]:
        state, found = self.forces(state, motions, h)
        acts = time >= self.cut_from
        if self.cut_to is not None:
            acts = ops.both(acts, time < self.cut_to)
        forces = {self.along_feed: (0.0, ops.where(acts, sign_of(self.feed_towards) * found.feed, 0.0))}
        if self.along_depth is not None:
            forces[self.along_depth] = 0.0, ops.where(acts, sign_of(self.depth_towards) * found.depth, 0.0)
        return state, forces

    def forces(self, state: Track, motions: Mapping[str, Motion], h: Number) -> tuple[Track, TurningTool.Forces]:
        """Return the state after a substep and the forces on the tool, whether or not the cut is active."""
        place, velocity = self._place(motions)
        # motions are those predicted for the middle of the substep; the track keeps its start, which is exact
        state = state.push([x - 0.5 * h * v for x, v in zip(place, velocity, strict=True)], velocity)
        turn = 60.0 / (self.spindle_speed * h)
        steps = [state.moved(place, float(m) * turn, h) for m in range(1, self.surfaces + 1)]
        return state, self.tool.forces([(step[0], step[1] if len(step) == 2 else 0.0) for step in steps])

    def _place(self, motions: Mapping[str, Motion]) -> tuple[list[Any], list[Any]]:
        """Return position and velocity along the feed and, with an axis there, into the work."""
        signs = sign_of(self.feed_towards), sign_of(self.depth_towards)
        found = [(sign, motions[axis]) for sign, axis in zip(signs, self.axes(), strict=False)]
        return [sign * m.position_load for sign, m in found], [sign * m.velocity_load for sign, m in found]
