"""A learned feedforward force over time for one motion, as computed by signal-based iterative learning control."""

from typing import Any, NamedTuple, Self

from feeddrive.blocks.families import Compensation
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, table


class LearnedForce(Compensation):
    """A table with one force per sample, which starts in the sample in which the loop is enabled.

        force(k) = row k of the table, afterwards its last row, which should be 0

    When to use: for one motion that repeats exactly, sample by sample; `learn_signal` returns this block.  Not suitable
    for any other motion, since the force fits only the motion for which it was learned; use a DisturbanceCompensator
    instead.
    Source: Arimoto, Kawamura & Miyazaki 1984 (learning control).
    """

    force: Any = table("N", "learned force, sample by sample")

    class State(NamedTuple):
        """The index of the row that acts next."""

        sample: Number

    def start(self, prepared: object, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state in which the first row acts next."""
        return self.State(ops.zero(reading.applied))

    def step(
        self, prepared: object, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Setpoint, Number]:
        # beyond the table `gather` is clamped to its last row, so that no end has to be detected
        return self.State(state.sample + 1.0), setpoint, ops.gather(self.force, state.sample)

    def retune(self, state: State, old: Self, old_prepared: object, prepared: object) -> State:
        """Return the state unchanged: the table continues at its current row."""
        return state
