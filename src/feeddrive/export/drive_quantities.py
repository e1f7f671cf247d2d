"""A P-PI design in the quantities of drive manufacturers, and the parts of a design that a target cannot represent."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, SupportsFloat

from feeddrive.blocks.actuator.screw import Screw
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.feedforward.inverse_dynamics import InverseDynamics
from feeddrive.blocks.plant.transmission import radians_per_metre
from feeddrive.blocks.plant.two_bodies import two_bodies
from feeddrive.language import tree, units
from feeddrive.language.block import Block, declarations
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop


class DriveQuantity(NamedTuple):
    """A quantity of a drive: its units at the table and at the motor's shaft, and the power of r that converts it.

    The value at the shaft is the value at the table times r^power, with r = gear · 2π / lead in rad/m.  `path` is the
    name of the quantity in a machine file.
    """

    table: str
    shaft: str
    power: int
    path: str


QUANTITIES: Mapping[str, DriveQuantity] = {
    "Kv": DriveQuantity("1/s", "1/s", 0, "control.law.Kv"),
    "Kp": DriveQuantity("N s/m", "N m s/rad", -2, "control.law.Kp"),
    "Kp/Tn": DriveQuantity("N/m", "N m/rad", -2, "control.law.Kp / control.law.Tn"),
    "Tn": DriveQuantity("s", "s", 0, "control.law.Tn"),
    "velocity_feedforward": DriveQuantity("", "", 0, "control.law.velocity_feedforward"),
    "mass": DriveQuantity("kg", "kg m2", -2, "control.feedforward, mass"),
    "viscous": DriveQuantity("N s/m", "N m s/rad", -2, "control.feedforward, viscous"),
    "force_limit": DriveQuantity("N", "N m", -1, "control.force_limit"),
    "following_error_limit": DriveQuantity("m", "m", 0, "control.guard.following_error_limit"),
    "velocity_limit": DriveQuantity("m/s", "rad/s", 1, "control.guard.velocity_limit"),
    "table_velocity_limit": DriveQuantity("m/s", "m/s", 0, "control.guard.velocity_limit"),
    "travel_least": DriveQuantity("m", "m", 0, "control.guard.travel_least"),
    "travel_most": DriveQuantity("m", "m", 0, "control.guard.travel_most"),
    "weight": DriveQuantity("N", "N m", -1, "control.guard.safe_force"),
    "lead": DriveQuantity("m", "m", 0, "axis.actuator.motor.lead"),
    "gear": DriveQuantity("", "", 0, "axis.actuator.motor.gear"),
}


_GUARD = "control.guard."


@dataclass(frozen=True)
class DriveTrain:
    """The drive train between motor and table: a screw with a gear, a linear motor, or the motor of a rotary axis.

    lead    m; None for a linear motor, and for a rotary axis, whose numbers are those at the motor's shaft
    turns   True for a rotary axis
    """

    lead: float | None
    gear: float = 1.0
    source: str = ""
    turns: bool = False

    @property
    def rotary(self) -> bool:
        """True for a rotary motor."""
        return self.lead is not None or self.turns

    @property
    def radians_per_metre(self) -> float:
        """The rotation of the motor's shaft per table motion, r = gear · 2π / lead, in rad/m; 1 without a screw."""
        return 1.0 if self.lead is None else float(self.gear * radians_per_metre(self.lead))


@dataclass(frozen=True)
class Cascade:
    """A P-PI design: its loop, its law, and its quantities in SI at the table; absent quantities are None."""

    loop: Loop
    law: CascadePPI
    values: Mapping[str, float | None]


def read_cascade(loop: Loop) -> Cascade:
    """Return the P-PI design of a loop. Raises StructureError if the law is not a `cascade_ppi`."""
    law = loop.control.law
    if not isinstance(law, CascadePPI):
        raise StructureError(
            f"control.law: {law.kind} is not a P-PI cascade, and only a P-PI cascade has parameters in drives: "
            "export it "
            f"with the target c or linuxcnc, which carry the law itself, or give the axis a cascade_ppi"
        )
    mass, viscous = _fed(loop)
    guard = loop.control.guard
    guarded = {
        name: None if guard is None else getattr(guard, quantity.path.removeprefix(_GUARD))
        for name, quantity in QUANTITIES.items()
        if quantity.path.startswith(_GUARD)
    }
    return Cascade(
        loop,
        law,
        {
            "Kv": law.Kv,
            "Kp": law.Kp,
            "Kp/Tn": None if law.Tn is None else law.Kp / law.Tn,
            "Tn": law.Tn,
            "velocity_feedforward": law.velocity_feedforward,
            "mass": mass or None,
            "viscous": viscous or None,
            "force_limit": loop.control.force_limit,
            **guarded,
            "weight": guarded["weight"] or None,
        },
    )


def at_shaft(cascade: Cascade, train: DriveTrain, quantity: str, unit: str) -> float | None:
    """Return a quantity in `unit` (one of `language.units`), referred to the shaft if the motor is rotary; None if
    absent.
    """
    own = {"lead": train.lead, "gear": train.gear if train.lead is not None else None}
    value = own[quantity] if quantity in own else cascade.values[quantity]
    if value is None:
        return None
    kind = QUANTITIES[quantity]
    if not train.rotary or train.turns:
        return value / units.factor(unit, units.turning(kind.table) if train.turns else kind.table)
    return value * train.radians_per_metre**kind.power / units.factor(unit, kind.shaft)


def _fed(loop: Loop) -> tuple[float, float]:
    """Return the mass in kg and the viscous friction in N s/m of the feedforward."""
    mass = viscous = 0.0
    for block in loop.control.feedforward:
        if isinstance(block, Inertia | DisturbanceCompensator):
            mass, viscous = mass + (block.mass or 0.0), viscous + (block.viscous or 0.0)
        elif isinstance(block, InverseDynamics):
            bodies = two_bodies(block.kind, block.model)
            # drives feed a single mass forward: that of both bodies in rigid motion
            mass = mass + bodies.m11 + 2.0 * bodies.m12 + bodies.m22
            viscous = viscous + bodies.c11 + 2.0 * bodies.c12 + bodies.c22
    return float(mass), float(viscous)


def drive_train(loop: Loop, lead: float | None = None, gear: float | None = None) -> DriveTrain:
    """Return the drive train given by the arguments, or else by the motor or the plant, or else that of a linear motor.

    A rotary axis needs no lead, since its numbers are those at the motor's shaft.
    Raises ParameterError for a lead or gear that is not positive, for a gear without a lead, and for a linear axis if
    neither a motor nor a lead is known.
    """
    for name, value in (("lead", lead), ("gear", gear)):
        if value is not None and not 0.0 < value < float("inf"):
            raise ParameterError(f"{name} = {Quantity(value):6} must be positive and finite")
    motor, plant = loop.axis.actuator.motor, loop.axis.plant
    if lead is not None:
        return DriveTrain(lead, gear or 1.0, "given with the export")
    if gear is not None:
        raise ParameterError(
            "gear is given without lead: a gear alone is not sufficient; give the lead of the screw too"
        )
    if isinstance(motor, Screw):
        return DriveTrain(motor.lead, motor.gear, "axis.actuator.motor")
    plant_lead = getattr(plant, "lead", None)
    if isinstance(plant_lead, float):
        return DriveTrain(plant_lead, getattr(plant, "gear", 1.0), "axis.plant")
    if loop.axis.rotary:
        return DriveTrain(None, source="axis.rotary: all numbers are those at the motor's shaft", turns=True)
    if motor is None:
        raise ParameterError(
            "axis.actuator.motor is not there, and neither motor nor plant states a lead: the makers' units are those "
            'of the motor\'s shaft, so give the axis a motor (kind = "screw" with lead_mm, or "direct" for a linear '
            "motor), or give lead and gear with the export"
        )
    return DriveTrain(None, source="axis.actuator.motor is direct: taken for a linear motor")


SAFETY = (
    "Text for a person to check, not a file to load blindly.  Before the first motion:",
    "1. Compare every unit with the manual of your control and drive; a gain off by 60 or 1000 is a runaway axis.",
    "2. Set torque, speed and travel limits low, and try the emergency stop while nothing moves.",
    "3. Turn the motor uncoupled from the axis first, then coupled, with free travel on both sides.",
    "4. Hold a vertical axis by more than its drive: it falls when a loop opens.",
    "5. Begin with a tenth of the gains, velocity loop before position loop; stay away from everything that can move.",
)


def kv_lines(Kv: float, *, turns: bool = False) -> tuple[str, ...]:
    """Return text lines that state the position gain Kv (1/s) in the units that manufacturers use."""
    if turns:
        return (
            f"Kv = {Kv:.6g} 1/s = {Kv:.6g} (deg/s)/deg",
            f"Kv = {Kv * 0.06:.6g} 1000/min; 1000/min is 16.667 1/s",
            # 1 rev/min is 6 deg/s
            f"Following error at 1 rev/min without velocity feedforward: {6.0 / Kv:.4g} deg",
        )
    return (
        f"Kv = {Kv:.6g} 1/s = {Kv:.6g} (mm/s)/mm",
        # 60 s/min / (1000 mm/m) = 0.06
        f"Kv = {Kv * 0.06:.6g} (m/min)/mm = {Kv * 0.06:.6g} 1000/min; 1 (m/min)/mm is 16.667 1/s",
        f"Kv = {Kv * 100.0:.6g} times 0.01/s",
        f"Following error at 1 m/min without velocity feedforward: {1e3 / (60.0 * Kv):.4g} mm",
    )


class Item(NamedTuple):
    """An element of a controller, such as a filter: its kind, its path in the machine file, and its values as text."""

    kind: str
    path: str
    value: str


class LostPart(NamedTuple):
    """An element that a target cannot represent, with the reason and the consequence."""

    path: str
    value: str
    why: str
    consequence: str


# Consequence of leaving an item out, for targets that do not state their own.
CONSEQUENCES: Mapping[str, str] = {
    "velocity_samples": "the velocity is noisier and its delay is smaller: margins are those of one sample, not these",
    "velocity_lag": "the velocity is noisier and its delay is smaller: margins are larger than these",
    "velocity_encoder": "the velocity loop closes on another encoder than it was designed with",
    "position_every": "the position loop runs at the target's own rate",
    "viscous": "the damping of the velocity loop grows by this number; following errors that the law took out remain",
    "model": "the velocity overshoots where the reference model of the integral had kept it from that",
    "feedback_delay": "the feedback sees following errors in acceleration that the dead time makes",
    "back_calculation": "behind a limit the integral recovers in another way: overshoot after saturation differs",
    "inertia": "following errors in acceleration grow",
    "viscous_feedforward": "following errors at speed grow until the integral has settled",
    "half_sample": "the force comes half a sample late: an error of mass · jerk · T/2 in N",
    "friction_feedforward": "reversal errors are those without friction compensation",
    "jerk_feedforward": "errors where the jerk is large grow",
    "flexible_feedforward": "the spring of the drive train is not compensated: errors at large jerk and snap grow",
    "feedforward": "its force is missing",
    "compensation": "disturbances and modes that it took out remain",
    "prefilter": "the set motion is not shaped: tracking differs from the simulation",
    "filters": "resonances that the filter suppressed remain: gains that are stable with it may be unstable without it",
    "force_limit": "the force is limited by the drive's own setting alone",
    "following_error_limit": "the axis does not stop at this following error",
    "velocity_limit": "the axis does not stop at this speed",
    "travel": "the axis does not stop at the ends of its travel",
    "broken_readings": "a reading that is not a number is not replaced: check the reaction of the target to an "
    "encoder fault",
    "hold_samples": "a broken reading is not bridged by the last command: see how the target reacts to it",
    "checks_setpoint": "a setpoint that is no number is not refused: check the sender of the setpoints",
    "safe_force": "a hanging axis sinks until its brake holds",
    "alignment": "the offset between two encoders acts at enable",
    "starts_moving": "enable an axis at standstill only: on a moving one the force steps",
}
UNKNOWN = "the target has no such element"


def _read(value: SupportsFloat, unit: str, shown: str = "SI") -> str:
    """Format a number for the README of an export: plain text with six digits, in the units of a linear axis."""
    return str(Quantity(value, unit, form=f"6 {shown}"))


def items(cascade: Cascade) -> Iterator[Item]:
    """Yield all elements of a P-PI design except its gains, along the signal path."""
    control, law = cascade.loop.control, cascade.law
    if law.velocity_samples > 1:
        yield Item("velocity_samples", "control.law.velocity_samples", str(law.velocity_samples))
    if law.velocity_lag is not None:
        yield Item("velocity_lag", "control.law.velocity_lag", _read(law.velocity_lag, "s", "ms"))
    if cascade.loop.axis.encoders() == 2 and law.velocity_encoder == "load":
        yield Item("velocity_encoder", "control.law.velocity_encoder", law.velocity_encoder)
    if law.position_every > 1:
        yield Item("position_every", "control.law.position_every", str(law.position_every))
    if law.viscous:
        yield Item("viscous", "control.law.viscous", _read(law.viscous, "N s/m"))
    if law.Tn is not None and law.model_mass is not None:
        yield Item("model", "control.law.model_mass", _read(law.model_mass, "kg"))
    if control.feedback_delay is not None:
        yield Item("feedback_delay", "control.feedback_delay", _read(control.feedback_delay, "s", "ms"))
    if law.Tn is not None and control.force_limit is not None:
        yield Item("back_calculation", "control.law", "integral by back-calculation")
    if control.prefilter is not None:
        yield Item("prefilter", "control.prefilter", numbers(control.prefilter))
    for i, block in enumerate(control.compensation):
        yield Item("compensation", f"control.compensation.{i}", numbers(block))
    for i, block in enumerate(control.filters):
        yield Item("filters", f"control.filters.{i}", numbers(block))
    for i, block in enumerate(control.feedforward):
        for kind in _fed_items(block):
            yield Item(kind, f"control.feedforward.{i}", numbers(block))
    if control.force_limit is not None:
        yield Item("force_limit", "control.force_limit", _read(control.force_limit, "N"))
    yield from _guarded(cascade)


def _fed_items(block: Block) -> Iterator[str]:
    """Yield the kinds of elements, such as "inertia", that a feedforward block contains."""
    if isinstance(block, Inertia | DisturbanceCompensator):
        if block.mass:
            yield "inertia"
        if block.viscous:
            yield "viscous_feedforward"
        if block.mass or block.viscous:
            yield "half_sample"
    if isinstance(block, DisturbanceCompensator):
        if any((block.coulomb_positive, block.coulomb_negative, block.stribeck)):
            yield "friction_feedforward"
        if block.jerk_feedforward or block.snap_feedforward:
            yield "jerk_feedforward"
    elif isinstance(block, FrictionFeedforward):
        yield "friction_feedforward"
    elif isinstance(block, InverseDynamics):
        yield from ("inertia", "viscous_feedforward", "half_sample")
        if block.order == "full":
            yield "flexible_feedforward"
    elif not isinstance(block, Inertia):
        yield "feedforward"


# kinds of the fields of a guard that share one or have another name; any other field is a kind of its own, so that a
# new one is reported as lost until a target converts it
_GUARD_KINDS = {
    "travel_least": "travel",
    "travel_most": "travel",
    "reading_limit": "broken_readings",
    "holds": "hold_samples",
    "aligns": "alignment",
}


def _guarded(cascade: Cascade) -> Iterator[Item]:
    guard = cascade.loop.control.guard
    for name, declared in () if guard is None else declarations(Guard).items():
        value = getattr(guard, name)
        if guard is not None and _acts(cascade.loop, guard, name):
            kind = _GUARD_KINDS.get(name, name)
            shown = "mm" if declared.unit == "m" and kind != "broken_readings" else "SI"
            text = "true" if value is True else _read(value, declared.unit, shown)
            yield Item(kind, f"{_GUARD}{name}", text)


def _acts(loop: Loop, guard: Guard, name: str) -> bool:
    """Return True if a field of the guard affects the behavior of the loop."""
    if name == "aligns":
        return guard.aligns and loop.axis.encoders() == 2
    if name in ("holds", "hold_samples"):
        return guard.holds and guard.hold_samples > 0
    value = getattr(guard, name)
    return value is not None and value is not False and not (name == "safe_force" and value == 0)


def lost(cascade: Cascade, held: Sequence[str], outside: Mapping[str, tuple[str, str]]) -> tuple[LostPart, ...]:
    """Return the elements that a target cannot represent.

    held     kinds of elements that the target represents completely
    outside  by kind, the reason and the consequence; a general text is used for other kinds and empty consequences
    """
    parts = []
    for item in items(cascade):
        if item.kind not in held:
            why, consequence = outside.get(item.kind, (UNKNOWN, ""))
            parts.append(LostPart(item.path, item.value, why, consequence or CONSEQUENCES[item.kind]))
    return tuple(parts)


def numbers(block: Block) -> str:
    """Describe a block in one line by its kind and its values."""
    shown = (f"{name} {value:g} {tree.declaration(block, name).unit}".rstrip() for name, value in tree.leaves(block))
    return ", ".join([block.kind, *shown])
