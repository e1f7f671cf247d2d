"""One harmonic of a force that is periodic in position."""

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, choice, parameter


class Harmonic(Block):
    """One harmonic as a share of a force: harmonic = share · sin(2π order x / period + phase)."""

    order: int = choice("number of repetitions in one period", least=1)
    share: Number = parameter("", "amplitude as a share of the force")
    phase: Number = parameter("rad", "phase at x = 0", default=0)

    def at(self, angle: Number) -> Number:
        """Return the value of the harmonic at the angle 2π x / period of the fundamental."""
        # no product with 1 in the step, where each operation costs time in every substep
        turned = angle if self.order == 1 else float(self.order) * angle
        return self.share * ops.sin(turned + self.phase)


def total(harmonics: tuple[Harmonic, ...], position: Number, period: Number) -> Number:
    """Return the sum of the harmonics at a position; there must be at least one harmonic."""
    angle = 2.0 * ops.pi * position / period
    value = harmonics[0].at(angle)
    for harmonic in harmonics[1:]:
        value = value + harmonic.at(angle)
    return value
