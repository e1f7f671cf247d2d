"""The elements of a control that a target supports or not, and the consequence of each that it does not."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.feedforward.inverse_dynamics import InverseDynamics
from feeddrive.export.parameters.quantities import Cascade
from feeddrive.language import tree
from feeddrive.language.block import Block


class Item(NamedTuple):
    """Something that the control does: its kind, where it stands in the machine file, and its numbers."""

    kind: str
    path: str
    value: str


class Lost(NamedTuple):
    """What a target cannot hold: the item, why, and what happens without it."""

    path: str
    value: str
    why: str
    consequence: str


# What happens where an item is left out, for targets that say nothing more special.
CONSEQUENCES: Mapping[str, str] = {
    "velocity_samples": "the velocity is noisier and its delay is smaller: margins are those of one sample, not these",
    "velocity_encoder": "the velocity loop closes on another encoder than it was designed with",
    "position_every": "the position loop runs at the target's own rate",
    "viscous": "the damping of the velocity loop grows by this number; following errors that the law took out remain",
    "back_calculation": "behind a limit the integral comes back in another way: overshoot after saturation differs",
    "inertia": "following errors in acceleration grow",
    "viscous_feedforward": "following errors at speed grow until the integral has settled",
    "half_sample": "the force comes half a sample late: an error of mass · jerk · T/2 in N",
    "friction_feedforward": "reversal errors are those without friction compensation",
    "jerk_feedforward": "errors where the jerk is large grow",
    "flexible_feedforward": "the spring of the drive train is not led: errors where jerk and snap are large grow",
    "feedforward": "its force is missing",
    "compensation": "disturbances and modes that it took out remain",
    "prefilter": "the set motion is not shaped: tracking differs from the simulation",
    "filters": "resonances that the filter held down come back: gains that are stable with it may be unstable without",
    "force_limit": "the force is limited by the drive's own setting alone",
    "following_error_limit": "the axis does not stop at this following error",
    "velocity_limit": "the axis does not stop at this speed",
    "travel": "the axis does not stop at the ends of its travel",
    "broken_readings": "a reading that is no number is not replaced: see what the target does with an encoder fault",
    "safe_force": "a hanging axis sinks until its brake holds",
    "alignment": "the offset between two encoders acts at enable",
}
UNKNOWN = "the target has nothing like it"


def items(cascade: Cascade) -> Iterator[Item]:
    """Everything in the control of a P-PI design besides its gains, in the order of the signal."""
    control, law = cascade.loop.control, cascade.law
    if law.velocity_samples > 1:
        yield Item("velocity_samples", "control.law.velocity_samples", str(law.velocity_samples))
    if cascade.loop.axis.encoders() == 2 and law.velocity_encoder == "load":
        yield Item("velocity_encoder", "control.law.velocity_encoder", law.velocity_encoder)
    if law.position_every > 1:
        yield Item("position_every", "control.law.position_every", str(law.position_every))
    if law.viscous:
        yield Item("viscous", "control.law.viscous", f"{law.viscous:g} N s/m")
    if law.Tn is not None and control.force_limit is not None:
        yield Item("back_calculation", "control.law", "integral by back-calculation")
    if control.prefilter is not None:
        yield Item("prefilter", "control.prefilter", numbers(control.prefilter))
    for i, block in enumerate(control.compensation):
        yield Item("compensation", f"control.compensation.{i}", numbers(block))
    for i, block in enumerate(control.filters):
        yield Item("filters", f"control.filters.{i}", numbers(block))
    for i, block in enumerate(control.feedforward):
        for kind in _fed(block):
            yield Item(kind, f"control.feedforward.{i}", numbers(block))
    if control.force_limit is not None:
        yield Item("force_limit", "control.force_limit", f"{control.force_limit:g} N")
    yield from _guarded(cascade)


def _fed(block: Block) -> Iterator[str]:
    """What a feedforward does, in kinds of items."""
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


def _guarded(cascade: Cascade) -> Iterator[Item]:
    guard = cascade.loop.control.guard
    if guard is None:
        return
    if guard.following_error_limit is not None:
        value = f"{1e3 * guard.following_error_limit:g} mm"
        yield Item("following_error_limit", "control.guard.following_error_limit", value)
    if guard.velocity_limit is not None:
        yield Item("velocity_limit", "control.guard.velocity_limit", f"{guard.velocity_limit:g} m/s")
    for name in ("travel_least", "travel_most"):
        end = getattr(guard, name)
        if end is not None:
            yield Item("travel", f"control.guard.{name}", f"{1e3 * end:g} mm")
    yield Item("broken_readings", "control.guard.reading_limit", f"{guard.reading_limit:g} m")
    if guard.safe_force:
        yield Item("safe_force", "control.guard.safe_force", f"{guard.safe_force:g} N")
    if cascade.loop.axis.encoders() == 2:
        yield Item("alignment", "control.guard", "aligns motor and load encoder at enable")


def lost(cascade: Cascade, held: Sequence[str], outside: Mapping[str, tuple[str, str]]) -> tuple[Lost, ...]:
    """The items that a target does not hold.

    held     kinds of items that it holds whole
    outside  kind -> why it does not hold it, and the consequence; an empty one is the general one.  A kind in neither
             is something that the target does not know
    """
    found = []
    for item in items(cascade):
        if item.kind not in held:
            why, consequence = outside.get(item.kind, (UNKNOWN, ""))
            found.append(Lost(item.path, item.value, why, consequence or CONSEQUENCES[item.kind]))
    return tuple(found)


def numbers(block: Block) -> str:
    """A block in a line: its kind and its numbers."""
    shown = (f"{name} {value:g} {tree.declaration(block, name).unit}".rstrip() for name, value in tree.leaves(block))
    return ", ".join([block.kind, *shown])
