"""The thrust of a drill on its axis."""

import numpy as np

from feeddrive.blocks.coupling.steady_turns import TOWARDS, sign_of
from feeddrive.blocks.cutting.drill import Drill
from feeddrive.blocks.cutting.engagement import LEAST_CHIP
from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.sampled import check_single, check_source, since
from feeddrive.language.block import Number, choice, parameter, part
from feeddrive.language.errors import StructureError

# rows in which a motion is looked through for a way back into the hole
_ROWS = 4096


class DrillingForce(Load):
    """The thrust of a drill that feeds into the work once, with a chip that does not depend on vibration.

        τ     = 60 / (lips spindle_speed)
        depth = feed_per_turn spindle_speed / 60 · (t - start),  c = feed_per_turn / lips       (constant feed)
        depth = ± (x(t) - surface),  c = depth(t) - depth(t - τ)                                (x of the reference)
        F     = ∓ thrust of the drill for this depth and c

    It acts from t = start on and is held over the sample.  The axis moves towards the work in the direction `towards`.
    When to use: for thrust, entry and breakthrough as a disturbance of one axis.
    Not suitable for a drill that comes back into its hole, or for vibration: take a `DrillingCut`.
    Source: Altintas, Manufacturing Automation (2nd ed. 2012), chapter 2, mechanics of drilling.
    Raises StructureError unless exactly one of feed_per_turn and reference is specified, and for a reference that
    drills, turns back and comes again.
    """

    tool: Drill = part("the drill")
    spindle_speed: Number = parameter("rpm", "turns of the spindle", above=0)
    towards: str = choice("direction of the axis in which the work lies", options=TOWARDS, default="negative")
    feed_per_turn: Number | None = parameter(
        "m", "feed in a turn of the spindle; absent: it follows from the reference", least=0, default=None
    )
    reference: Reference | None = part("motion of the axis, which makes depth and chip", default=None)
    surface: Number = parameter("m", "position at which the drill touches the work, for a reference", default=0)
    thickness: Number | None = parameter(
        "m", "of the plate; absent: the drill does not come out", above=0, default=None
    )
    start: Number = parameter("s", "when the drill touches the work, or begins to cut", default=0)

    def check(self) -> None:
        """Raise StructureError unless the chip has exactly one source and the drill comes only once."""
        check_single(self)
        check_source(self.kind, self.feed_per_turn, self.reference)
        if self.reference is None:
            return
        depth = self._depth(np.linspace(0.0, self.reference.duration, _ROWS))
        bottom = np.maximum.accumulate(np.maximum(depth, 0.0))
        again = (np.diff(depth) > 0.0) & (depth[:-1] < bottom[:-1] - LEAST_CHIP) & (bottom[:-1] > 0.0)
        if again.any():
            raise StructureError(
                "drilling_force.reference turns back and comes again into its hole, where there is nothing to cut: "
                "take a drilling_cut in the [[couplings]] of the machine, or give one stroke"
            )

    def at(self, t: np.ndarray) -> np.ndarray:
        times = np.asarray(t, dtype=np.float64)
        if self.reference is None:
            feed = float(self.feed_per_turn or 0.0)
            depth = feed * self.spindle_speed / 60.0 * (times - self.start)
            chip = np.full(times.shape, feed / self.tool.lips)
        else:
            depth = self._depth(times)
            chip = depth - self._depth(times - 60.0 / (self.tool.lips * self.spindle_speed))
        thrust = np.asarray(self.tool.forces(depth, self.thickness, chip).thrust)
        return np.where(since(times, self.start), -sign_of(self.towards) * thrust, 0.0)

    def _depth(self, times: np.ndarray) -> np.ndarray:
        assert self.reference is not None
        return sign_of(self.towards) * (np.asarray(self.reference.at(times).position) - self.surface)
