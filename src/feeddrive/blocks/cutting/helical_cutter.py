"""A helical end mill, with the force of each edge in closed form."""

import warnings
from typing import Any, Self

from feeddrive.blocks.cutting.engagement import arc, lag
from feeddrive.blocks.families import Cutter, Edge
from feeddrive.language import ops
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity

# rad: sin d / d is 1 to the last bit even far above it
_SMALL = 1e-9


class HelicalCutter(Cutter):
    """Forces on an end mill with helical edges, linear in the chip (the model of Kline), in closed form.

    The edge of tooth j at height z is at v = φ - lag z / axial_depth, φ = angle + 2πj/teeth.  Its chip is
    h = chip_load · sin v between entry and exit, and the force on a piece dz of it is specific_energy · h dz against
    its motion, with radial_ratio times this force towards the axis and axial_ratio times it along the axis.  Over the
    engaged part (v0, vm):

        lag    = 2 axial_depth tan(helix_angle) / diameter                       turn from the edge's tip to its top
        A      = specific_energy · chip_load · axial_depth / lag
        S(v)   = sin²v / 2,   W(v) = (v - sin v cos v) / 2
        feed   = -A [S(vm) - S(v0) + radial_ratio (W(vm) - W(v0))]                along the feed t
        normal =  A [W(vm) - W(v0) - radial_ratio (S(vm) - S(v0))]                along n = spindle axis x t
        axial  =  A axial_ratio (cos v0 - cos vm)                                 along the spindle axis

    summed over the teeth.  Entry and exit are 0 and π in a slot; with a radial_depth below the diameter up milling cuts
    from 0 to arccos(1 - 2 radial_depth / diameter), down milling over the same angle up to π.  On a straight edge
    (helix_angle = 0) the chip thickness at the tip applies to the whole length, which is the limit of the equations.

    The mean over a turn conserves energy: mean torque · ω = specific_energy · volume removed per second.
    `slices` is used only in a `MillingCut`, where the chip follows from the motion of the tool.
    Not suitable for unequal pitch.  For run-out, or for a worn or rubbing edge, whose force does not vanish with the
    chip thickness, use `MechanisticCutter`.
    Source: Beltrán-Carbajal et al. 2013, eq. (4) and the symbols around it, reconstructed from Kline's model; the
    ratios are not in the paper.
    """

    diameter: Number = parameter("m", "of the tool", above=0)
    axial_depth: Number = parameter("m", "depth of cut along the spindle", above=0)
    radial_depth: Number | None = parameter(
        "m", "width of cut across the feed; absent: a slot, the whole diameter", above=0, default=None
    )
    milling: str = choice("whether the chip starts thin (up) or ends thin (down)", options=("up", "down"), default="up")
    helix_angle: Number = parameter("rad", "of the edges; 0 for straight ones", least=0, below=1.5, default=0)
    specific_energy: Number = parameter("J/m3", "work per volume of chip, u_s; in N/m² the same number", above=0)
    radial_ratio: Number = parameter("", "radial over tangential force, K_r", least=0, default=0.3)
    axial_ratio: Number = parameter("", "axial over tangential force, K_a", least=0, default=0.2)

    def check(self) -> None:
        """Raise ParameterError if the cut is wider than the tool."""
        width, diameter = self.radial_depth, self.diameter
        # in a trace both are symbols, on which an `if` is refused
        if isinstance(width, float) and isinstance(diameter, float) and width > diameter:
            raise ParameterError(
                f"helical_cutter.radial_depth = {Quantity(width, 'm'):6 SI} is {Quantity(width - diameter, 'm'):3 SI} "
                f"more than helical_cutter.diameter = {Quantity(diameter, 'm'):6 SI}: at most "
                f"{Quantity(diameter, 'm'):6 SI}, or leave it out for a slot"
            )

    @classmethod
    def beltran2013(cls) -> Self:
        """Return the paper's tool in a slot, with u_s = 3 GJ/m³, the value for steel at a chip load of 0.05 mm."""
        return cls(
            teeth=2,
            diameter=0.010,
            axial_depth=0.005,
            helix_angle=0.25 * ops.pi,
            specific_energy=3e9,
            radial_ratio=0.3,
            axial_ratio=0.2,
        )

    @classmethod
    def beltran2013_as_printed(cls) -> Self:
        """Return the paper's tool with the printed u_s = 0.5 kW/(cm³/min) = 30 GJ/m³, and warn.

        This is ten times the handbook value for steel; with the printed chip load of 1 mm the force reaches 141 kN and
        the spindle power 90 kW. Use it only to demonstrate this error.
        """
        warnings.warn(
            "the printed specific energy of 30 GJ/m3 (0.5 kW per cm3/min) is ten times that of steel; "
            "HelicalCutter.beltran2013() has the value that fits the paper's other figures",
            stacklevel=2,
        )
        return cls(
            teeth=2,
            diameter=0.010,
            axial_depth=0.005,
            helix_angle=0.25 * ops.pi,
            specific_energy=3e10,
            radial_ratio=0.3,
            axial_ratio=0.2,
        )

    def edge(self) -> Edge:
        """Return the edges with Ktc = specific_energy, and Krc and Kac from the ratios; there is no edge force."""
        entry, leave = arc(self.milling, self.radial_depth, self.diameter)
        cutting = (
            self.specific_energy,
            self.radial_ratio * self.specific_energy,
            self.axial_ratio * self.specific_energy,
        )
        return Edge(self.teeth, self.slices, self.diameter, self.axial_depth, self.helix_angle, entry, leave, cutting)

    def forces(self, angle: Number, chip_load: Number) -> tuple[Number, Number, Number]:
        """Evaluate the equations in the class docstring at the spindle `angle` in rad, which may exceed a turn."""
        sines, areas, cosines = self._sums(angle)
        force = self.specific_energy * chip_load * self.axial_depth
        feed = -force * (sines + self.radial_ratio * areas)
        normal = force * (areas - self.radial_ratio * sines)
        return feed, normal, force * self.axial_ratio * cosines

    def torque(self, angle: Number, chip_load: Number) -> Number:
        """Return A (cos v0 - cos vm) diameter / 2, summed over the teeth: the torque of the tangential forces."""
        force = self.specific_energy * chip_load * self.axial_depth
        return 0.5 * self.diameter * force * self._sums(angle)[2]

    def _sums(self, angle: Number) -> tuple[Any, ...]:
        """Return the changes of S, W and -cos over the engaged parts of all teeth, divided by the lag."""
        edge = self.edge()
        entry, leave, turn = edge.entry, edge.exit, lag(edge)
        # an edge with more than one turn around the tool: whole turns cut the whole chip, the rest follows below
        turns = ops.floor(turn / (2.0 * ops.pi))
        rest = turn - 2.0 * ops.pi * turns
        whole = self.teeth * turns * (leave - entry) / ops.maximum(turn, _SMALL)
        sums = [whole * piece for piece in _pieces(entry, leave - entry)]
        for tooth in range(self.teeth):
            share = angle / (2.0 * ops.pi) + float(tooth) / float(self.teeth)
            tip = 2.0 * ops.pi * (share - ops.floor(share))
            # the rest of the edge reaches back by less than a turn: into this passage of the chip and the previous one
            for begin, end in ((entry, leave), (entry - 2.0 * ops.pi, leave - 2.0 * ops.pi)):
                for i, piece in enumerate(_engagement(tip, rest, turn, begin, end)):
                    sums[i] = sums[i] + piece
        return tuple(sums)


def _engagement(tip: Any, rest: Any, turn: Any, begin: Any, end: Any) -> tuple[Any, ...]:
    """Return the changes of S, W and -cos over the part of (tip - rest, tip) inside (begin, end), divided by `turn`.

    The length of this part is computed as the whole edge minus the parts outside, since the difference of its two ends
    would lose all precision at a small lag.  A straight edge cuts with its whole length or not at all.
    """
    before, after = ops.maximum(0.0, begin - (tip - rest)), ops.maximum(0.0, tip - end)
    length = ops.clip(rest - before - after, 0.0, rest)
    inside = ops.both(tip >= begin, tip < end)
    straight = turn < _SMALL
    share = ops.where(straight, ops.where(inside, 1.0, 0.0), length / ops.where(straight, 1.0, turn))
    return tuple(share * piece for piece in _pieces(ops.clip(tip - rest, begin, end), length))


def _pieces(first: Any, length: Any) -> tuple[Any, ...]:
    """Return the changes of S, W and -cos from v = first to first + length, each divided by length, which may be 0.

    With the middle m and sinc = sin(length/2) / (length/2):
        S: sin m cos m · sinc cos(length/2),   W: (1 - (cos²m - sin²m) sinc cos(length/2)) / 2,   -cos: sin m · sinc
    """
    half = 0.5 * length
    sine, cosine = ops.sin(first + half), ops.cos(first + half)
    tiny = half < _SMALL
    sinc = ops.where(tiny, 1.0, ops.sin(half) / ops.where(tiny, 1.0, half))
    both = sinc * ops.cos(half)
    return sine * cosine * both, 0.5 * (1.0 - (cosine * cosine - sine * sine) * both), sine * sinc
