"""The mode shape of a structure mode at one axis."""

from feeddrive.language.block import Block, Number, choice, parameter


class ModeShape(Block):
    """The shape of a structure mode at one axis: position of a body = own position + shape · η.

    A force f on the body acts on the mode with shape · f.
    """

    axis: str = choice("axis that feels the mode", default="x")
    motor: Number = parameter("", "mode shape at the driven end", default=0)
    load: Number = parameter("", "mode shape at the table", default=1)
