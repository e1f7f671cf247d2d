"""The `biquad` component of LinuxCNC, with the arithmetic of its source."""

from typing import NamedTuple

from feeddrive.language.block import Block, Number, parameter


class StockBiquad(Block):
    """One `biquad` of LinuxCNC's HAL with arbitrary coefficients (its type 0), reproduced bit for bit.

        out = n0 in + s1,   s1 = n1 in - d1 out + s2,   s2 = n2 in - d2 out
        H(z) = (n0 + n1 z⁻¹ + n2 z⁻²) / (1 + d1 z⁻¹ + d2 z⁻²)

    Its types 1 and 2 are a low-pass and a notch of infinite depth; type 0 can be any second-order filter.
    Source: LinuxCNC manual page biquad(9); the order of the operations was found by tests of the component itself.
    """

    n0: Number = parameter("", "coefficient of the input", default=1)
    n1: Number = parameter("", "coefficient of the input one sample before", default=0)
    n2: Number = parameter("", "coefficient of the input two samples before", default=0)
    d1: Number = parameter("", "coefficient of the output one sample before", default=0)
    d2: Number = parameter("", "coefficient of the output two samples before", default=0)

    class State(NamedTuple):
        """The two delayed sums."""

        s1: Number
        s2: Number

    def start(self, zero: Number) -> State:
        """Return the state in which HAL loads the component: all zeros."""
        return self.State(zero, zero)

    def step(self, state: State, value: Number) -> tuple[State, Number]:
        # products and sums in the order of the component, for equal bits
        output = value * self.n0 + state.s1
        return self.State(value * self.n1 - output * self.d1 + state.s2, value * self.n2 - output * self.d2), output
