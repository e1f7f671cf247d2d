"""Compensation of screw pitch errors and backlash by tables over the travel."""

from typing import Any, NamedTuple, Self

from feeddrive.blocks.families import Compensation
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter, table
from feeddrive.language.errors import ParameterError


class PitchCompensation(Compensation):
    """Compensation of pitch errors and backlash by two tables, one for each direction of motion.

        side(k)  = side(k-1) + 2 T v_set / reversal_distance, limited to -1 .. 1
        shift    = (forward + backward)/2 + side (forward - backward)/2,   both at x_set
        x_r += shift,   v_r += (shift(k) - shift(k-1)) / T

    Tables are interpolated linearly between entries at table_start, table_start + spacing, ... and held beyond their
    ends.  An entry is the correction to add: nominal minus reached position.  Backlash is the difference of the two
    tables; after a reversal it is blended in over `reversal_distance` of the set path, so that the setpoint does not
    jump.  Before the first motion the mean of both tables is used.

    When to use: with an encoder on the motor and a repeatable error that was measured by laser or step gauge, or
    learned from a run (`learned_pitch`).  Not suitable for errors that the law's encoder already measures, or for
    backlash inside the position loop of a load encoder.
    Source: the screw error compensation of CNCs; ISO 230-2 for the errors; blending over a distance is specific to this
    library.
    """

    forward: Any = table("m", "correction of motion towards larger positions, along the travel")
    backward: Any = table("m", "the same of motion towards smaller positions")
    table_start: Number = parameter("m", "position of the first entry")
    spacing: Number = parameter("m", "distance between entries", above=0)
    reversal_distance: Number = parameter("m", "set path over which a reversal comes in", above=0, default=1e-5)

    class State(NamedTuple):
        """The direction, -1 to 1; the last shift of the set position, and the unshifted set position (m)."""

        side: Number
        shift: Number
        position: Number

    def check(self) -> None:
        """Raise ParameterError unless both tables have the same length."""
        if ops.length(self.forward) != ops.length(self.backward):
            raise ParameterError(
                f"pitch_compensation: forward has {ops.length(self.forward)} entries and backward "
                f"{ops.length(self.backward)}: both need one for each position, spacing apart from table_start on"
            )

    def _shift(self, side: Number, position: Number) -> Number:
        place = (position - self.table_start) / self.spacing
        forward, backward = ops.interpolate(self.forward, place), ops.interpolate(self.backward, place)
        return 0.5 * (forward + backward) + side * (0.5 * (forward - backward))

    def start(self, prepared: object, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state midway between the two directions of motion."""
        side = ops.zero(setpoint.position)
        return self.State(side, self._shift(side, setpoint.position), setpoint.position)

    def step(
        self, prepared: object, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Setpoint, Number]:
        # 2: the direction changes from -1 to 1 over the reversal distance
        side = ops.clip(state.side + 2.0 * T * setpoint.velocity / self.reversal_distance, -1.0, 1.0)
        # looked up again, not stored: after a live change of the table's position the old shift would cause a jump
        before, shift = self._shift(state.side, state.position), self._shift(side, setpoint.position)
        moved = setpoint._replace(position=setpoint.position + shift, velocity=setpoint.velocity + (shift - before) / T)
        return self.State(side, shift, setpoint.position), moved, 0.0

    def retune(self, state: State, old: Self, old_prepared: object, prepared: object) -> State:
        """Return the state unchanged: the set position jumps to the new table, but the set velocity does not jump."""
        return state

    def moved(self, state: State) -> Number:
        """Return the shift of the set position in the last sample, m."""
        return state.shift
