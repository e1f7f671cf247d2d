"""One component of a recorded force."""

from feeddrive.language.block import Block, Number, choice, table


class ForceRecord(Block):
    """A component F(k) = row of a force that was measured, and the axis on whose table it acts."""

    axis: str = choice("axis on whose table the component acts", default="x")
    row: Number = table("N", "force samples, positive towards larger positions")
