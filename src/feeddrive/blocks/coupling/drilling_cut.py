"""The thrust of a drill on its axis, with the chip and the depth from the actual motion."""

from collections.abc import Iterator, Mapping
from typing import Any

from feeddrive.blocks.coupling.steady_turns import TOWARDS, covers, sign_of
from feeddrive.blocks.cutting.drill import Drill
from feeddrive.blocks.families import Coupling
from feeddrive.blocks.signals import Motion
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule, choice, parameter, part
from feeddrive.language.ring import Track


class DrillingCut(Coupling):
    """Regenerative drilling thrust on one axis: a lip cuts what the axis advanced since the lips before.

        τ      = 60 / (lips spindle_speed)
        depth  = ± (position - surface)
        c      = depth(t) - bottom(t - τ),   bottom(t) = max(depth(t), bottom(t - τ))
        force  = ∓ thrust of the drill for this depth and c

    bottom is what the lips leave at the angle at which a lip stands, so that a drill that is pulled out and comes back
    (peck drilling), or that lifts off while it vibrates, cuts again where the bottom is.  The thrust rises while the
    point enters, and falls while it breaks through a plate of `thickness`.  The depth is taken at the predicted middle
    of a substep, and the bottom in the same way, by cubic Hermite interpolation.  If the axis moves the workpiece,
    `towards` is the direction in which the work approaches the drill.
    Do not use it with substeps longer than a tenth of τ, for a spindle whose speed changes, or for torsional and
    lateral vibration of a slender drill: the chip follows the axis alone.
    Source: forces Altintas, Manufacturing Automation (2nd ed. 2012), chapter 2, mechanics of drilling; chip between
    two lips as in chapter 4.
    """

    tool: Drill = part("the drill")
    spindle_speed: Number = parameter("rpm", "turns of the spindle", above=0)
    along: str = choice("axis that moves the drill", default="z")
    towards: str = choice("direction of that axis in which the work lies", options=TOWARDS, default="negative")
    surface: Number = parameter("m", "position of the axis at which the drill touches the work", default=0)
    thickness: Number | None = parameter(
        "m", "of the plate; absent: the drill does not come out", above=0, default=None
    )
    remembered: int = choice("substeps of motion that are stored; they must cover τ", default=4096, least=4)

    def axes(self) -> tuple[str, ...]:
        """Return the name of the axis that moves the drill."""
        return (self.along,)

    def period(self) -> Number:
        """Return the time from lip to lip τ in s."""
        return 60.0 / (float(self.tool.lips) * self.spindle_speed)

    def substep_rules(self, h: Number) -> Iterator[Rule]:
        """Yield the validity rule: the stored substeps cover the time from lip to lip."""
        yield covers("drilling_cut", self.remembered, self.period(), h)

    def start(self, prepared: Any, motions: Mapping[str, Motion]) -> Track:
        """Return the state of a drill that has been at rest at its present position."""
        depth, _ = self._depth(motions)
        return Track.start(self.remembered, (depth,))

    def step(
        self, prepared: Any, state: Track, motions: Mapping[str, Motion], time: Number, h: Number
    ) -> tuple[Track, dict[str, tuple[Number, Number]]]:
        state, found = self.forces(state, motions, h)
        return state, {self.along: (0.0, -sign_of(self.towards) * found.thrust)}

    def forces(self, state: Track, motions: Mapping[str, Motion], h: Number) -> tuple[Track, Drill.Forces]:
        """Return the state after a substep, and thrust and torque of the drill."""
        depth, speed = self._depth(motions)
        lip = self.period() / h
        # the motion is that predicted for the middle of the substep; the track keeps its start, which is exact
        start = depth - 0.5 * h * speed
        (bottom,), (rate,) = state.ago(lip - 1.0, h), state.rates_ago(lip - 1.0)
        deeper = start > bottom
        state = state.push((ops.where(deeper, start, bottom),), (ops.where(deeper, speed, rate),))
        (chip,) = state.moved((depth,), lip, h)
        return state, self.tool.forces(depth, self.thickness, chip)

    def _depth(self, motions: Mapping[str, Motion]) -> tuple[Any, Any]:
        sign, motion = sign_of(self.towards), motions[self.along]
        return sign * (motion.position_load - self.surface), sign * motion.velocity_load
