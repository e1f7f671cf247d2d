"""The axis model from which every law derives its starting values: mass, delay, encoders, friction."""

import dataclasses
from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from typing import Any, NamedTuple, Protocol, TypeVar

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, declarations
from feeddrive.language.errors import StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

B = TypeVar("B", bound=Block)

# unit -> powers of mass and rate with which a gain of a rigid axis in this unit scales: N s/m is kg times 1/s
POWERS: Mapping[str, tuple[int, int]] = {
    "kg": (1, 0),
    "N s/m": (1, 1),
    "N/m": (1, 2),
    "N/(m s)": (1, 3),
    "1/s": (0, 1),
    "rad/s": (0, 1),
    "Hz": (0, 1),
    "1/s2": (0, 2),
    "s": (0, -1),
}
# share of 1/(time from a reading to its force): a loop with this rate is far from its limit at any dead time
_SLOW = 0.1


class SteadyForce(Protocol):
    """The steady friction force of a friction law as a function of velocity."""

    def steady(self, velocity: Number) -> Number:
        """Return the friction force in N at a constant velocity (m/s)."""
        ...

    def linear(self) -> Number:
        """Return the viscous coefficient, N s/m."""
        ...


@dataclass(frozen=True)
class AxisModel:
    """The model of an axis that laws, observers and compensations use: a rigid mass with delay, encoders and friction.

    mass, viscous      kg and N s/m of the axis as one rigid body
    delay              s from a command to its force: dead time and the lag of the current loop
    sample_time        s
    encoders           number of positions that the controller reads, 1 or 2
    velocity_encoder   the encoder from which the existing controller computes the velocity
    plant, frictions   the axis's blocks, for a law that models the axis as more than one mass
    reading_noise      m, standard deviation of the velocity encoder's reading, including quantization; 0 if not stated
    machine_modes      structural modes outside the axis, taken from the existing controller
    """

    mass: float
    viscous: float
    delay: float
    sample_time: float
    encoders: int
    velocity_encoder: str
    # Any, here and below: families.py, which declares plants and laws, imports this module
    plant: Any
    frictions: tuple[SteadyForce, ...]
    reading_noise: float = 0.0
    machine_modes: tuple[Any, ...] = ()

    @property
    def rate(self) -> float:
        """The starting value in 1/s of every rate: a tenth of 1/(delay + sample time), slow enough for any law."""
        return _SLOW / (self.delay + self.sample_time)

    @property
    def delay_samples(self) -> int:
        """The delay rounded to whole samples, as used by observers."""
        return round(self.delay / self.sample_time)

    def dry_friction(self, velocity: float) -> float:
        """Return the friction force in N at a constant velocity (m/s), without the viscous part."""
        return sum(
            float(friction.steady(velocity)) - float(friction.linear()) * velocity for friction in self.frictions
        )

    def sentence(self) -> str:
        """Return a sentence that describes the model."""
        late = f", a command to act after {self.delay_samples} samples" if self.delay_samples else ""
        return Text(
            f"designed for an axis of {Quantity(self.mass, 'kg'):6} and {Quantity(self.viscous, 'N s/m'):6}{late}"
        )


class Start(NamedTuple):
    """A variant of a law, with the parameter values from which the search on an axis starts.

    name         name of the variant in a comparison
    remark       a note for the report
    feedforward  feedforward that replaces that of the existing controller
    only_with    names (`Beside.name`) of compensations; this variant is tried only together with one of them.  If
                 empty, it is tried alone and with every suitable compensation
    """

    name: str
    law: Any
    remark: str = ""
    feedforward: Any = None
    only_with: tuple[str, ...] = ()


class Beside(NamedTuple):
    """A variant of a compensation that a comparison tries together with a law.

    name   name of the variant in a comparison
    block  the compensation; None if this variant cannot be used on the axis
    remark a note for the report, or the reason why the variant cannot be used
    tuned  True if its tunables are optimized together with those of the law; otherwise the tuning of the law is left
           unchanged
    """

    name: str
    block: Any
    remark: str = ""
    tuned: bool = True


def begun(block: type[B], axis: AxisModel, **stated: Any) -> B:
    """Return a block with starting values for an axis.

    A value in `stated` takes precedence. `mass`, `viscous`, `delay_samples` and `velocity_encoder` are taken from the
    axis, and other fields keep their defaults. A gain without a default starts at mass^a rate^b, with the exponents
    that its unit requires (`POWERS`), divided by 2π if the unit is Hz.

    Raises StructureError for any other field, since the block must then provide a starting value in its method `begin`.
    """
    from_axis = {
        "mass": axis.mass,
        "viscous": axis.viscous,
        "delay_samples": axis.delay_samples,
        "velocity_encoder": axis.velocity_encoder,
    }
    values: dict[str, Any] = dict(stated)
    declared = declarations(block)
    for spec in dataclasses.fields(block):  # type: ignore[arg-type]
        if spec.name in values:
            continue
        if spec.name in from_axis:
            values[spec.name] = from_axis[spec.name]
        elif spec.default is MISSING:
            values[spec.name] = _by_unit(block, spec.name, declared[spec.name].unit, axis)
    return block(**values)


def _by_unit(block: type[Block], name: str, unit: str, axis: AxisModel) -> Number:
    if unit not in POWERS:
        raise StructureError(
            f"{block.kind}.{name} has no start value on an axis: give it a default, or {block.__name__} a "
            f"method `begin`"
        )
    of_mass, of_rate = POWERS[unit]
    value = axis.mass**of_mass * axis.rate**of_rate
    return value / (2.0 * ops.pi) if unit == "Hz" else value
