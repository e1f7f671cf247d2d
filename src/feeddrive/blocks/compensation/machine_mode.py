"""One low-frequency mode of a machine, as it appears at the tool."""

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, choice, parameter
from feeddrive.language.errors import ParameterError


class MachineMode(Block):
    """One mode of the machine outside the axis, for `ModeCompensation`.

        mass (x'' + 2 damping_ratio ω x' + ω² x) = F,    ω = 2π frequency,    stiffness = mass ω²

        place     F                        motion of the tool relative to the workpiece
        tool      reaction of the cut -F_cut         axis - x: the spindle side gives way
        base      reaction of the drive -F_m         axis + x: the scale moves with the machine base
        fixture   F_cut - mass x_set''               axis + x: the workpiece swings on the table

    Specify either the stiffness, which a compliance test at the tool yields, or the modal mass.
    Source: Altintas & Okwudire 2009, end of section 3, states that modes are compensated, but not where in the machine
    they are.  The three places are this library's interpretation; the reproduction of the paper uses `tool`.
    """

    frequency: Number = parameter("Hz", "undamped natural frequency", above=0)
    damping_ratio: Number = parameter("", "damping ratio", least=0, default=0.02)
    stiffness: Number | None = parameter("N/m", "modal stiffness; absent if the mass is given", above=0, default=None)
    mass: Number | None = parameter("kg", "modal mass; absent if the stiffness is given", above=0, default=None)
    place: str = choice("part of the machine that moves", options=("tool", "base", "fixture"), default="tool")

    def check(self) -> None:
        """Raise ParameterError unless exactly one of stiffness and mass is specified."""
        if (self.stiffness is None) == (self.mass is None):
            which = "both are" if self.mass is not None else "neither is"
            raise ParameterError(
                f"machine_mode: {which} given of stiffness and mass; give exactly one, the other follows"
            )

    def omega(self) -> Number:
        """Return the natural frequency 2π frequency in rad/s."""
        return 2.0 * ops.pi * self.frequency

    def modal_mass(self) -> Number:
        """Return the modal mass in kg: `mass` if it is specified, otherwise stiffness/ω²."""
        if self.mass is not None:
            return self.mass
        assert self.stiffness is not None
        return self.stiffness / (self.omega() * self.omega())
