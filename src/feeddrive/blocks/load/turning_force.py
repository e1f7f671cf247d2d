"""The cutting force of a turning tool on one axis."""

import numpy as np

from feeddrive.blocks.coupling.steady_turns import TOWARDS, sign_of
from feeddrive.blocks.cutting.turning_tool import TurningTool
from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.sampled import check_order, check_single, check_source, since
from feeddrive.language.block import Number, choice, parameter, part


class TurningForce(Load):
    """The component along feed or depth of the force on a turning tool, with a chip that does not depend on vibration.

        c = feed_per_turn,  or of the motion of the feed x over the last turn:  c = ± (x(t) - x(t - 60 / spindle_speed))
        F = force of the tool for a step (c, 0) over a turn, in the direction of the axis

    `towards` is the direction of the axis in which the feed goes, or, for the component along the depth, in which the
    work lies.  With a `reference` the chip grows over the first turn and ends with the motion; if the motion turns
    back, the force is 0.  The force acts for start <= t < end and is held over the sample.
    When to use: to see what an axis loses to a cut, by one block per axis, each with its component.
    Not suitable for chatter: take a `TurningCut`.
    Source: Altintas, Manufacturing Automation (2nd ed. 2012), chapter 2, mechanics of turning.
    Raises StructureError unless exactly one of feed_per_turn and reference is specified.
    """

    tool: TurningTool = part("the tool")
    spindle_speed: Number = parameter("rpm", "turns of the spindle", above=0)
    component: str = choice("along which the component is taken", options=("feed", "depth"), default="feed")
    towards: str = choice("direction of the axis in which feed or work lies", options=TOWARDS, default="negative")
    feed_per_turn: Number | None = parameter(
        "m", "feed in a turn of the spindle; absent: it follows from the reference", least=0, default=None
    )
    reference: Reference | None = part("motion of the feed, which makes the chip", default=None)
    feed_towards: str = choice("direction in which the reference feeds", options=TOWARDS, default="negative")
    start: Number = parameter("s", "when the cut begins", default=0)
    end: Number | None = parameter("s", "instant at which it ends; absent: it does not end", default=None)

    def check(self) -> None:
        """Raise StructureError unless the chip has exactly one source, ParameterError unless end > start."""
        check_single(self)
        check_order(self.kind, self.start, self.end)
        check_source(self.kind, self.feed_per_turn, self.reference)

    def at(self, t: np.ndarray) -> np.ndarray:
        times = np.asarray(t, dtype=np.float64)
        if self.reference is None:
            chip = np.full(times.shape, self.feed_per_turn)
        else:
            before = self.reference.at(times - 60.0 / self.spindle_speed).position
            chip = sign_of(self.feed_towards) * (np.asarray(self.reference.at(times).position) - before)
        found = self.tool.forces([(chip, 0.0)])
        acts = since(times, self.start)
        if self.end is not None:
            acts = acts & ~since(times, self.end)
        force = found.feed if self.component == "feed" else found.depth
        return np.where(acts, sign_of(self.towards) * np.asarray(force), 0.0)
