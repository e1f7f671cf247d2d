"""One component of a recorded force."""

from feeddrive.language.block import Block, Number, choice, table


class ForceRecord(Block):
    """One component of a measured force, F(k) = row, and the axis on whose table it acts."""

    axis: str = choice("axis on whose table the component acts", default="x")
    row: Number = table("N", "force samples, positive towards larger positions")
