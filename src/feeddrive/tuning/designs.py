"""The laws that can go on an axis, each where its tuning begins; and those that cannot, with the reason."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from feeddrive.blocks.compensation.disturbance_rejection import DisturbanceRejection
from feeddrive.blocks.controller.active_disturbance_rejection import ActiveDisturbanceRejection
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.controller.pole_placement import PolePlacement
from feeddrive.blocks.families import Feedforward, Law, Plant
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.feedforward.inverse_dynamics import InverseDynamics
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.observer.gpi_observer import GpiObserver
from feeddrive.blocks.plant.three_mass_chain import ThreeMassChain
from feeddrive.blocks.plant.two_bodies import two_bodies
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.language import matrix
from feeddrive.language.errors import FeeddriveError, StructureError
from feeddrive.loop.loop import Loop

_MOTION = ("acceleration", "velocity")
_RATE = 0.1  # of 1/(time until a reading has become a force): a loop that is certainly slow enough to begin with


@dataclass(frozen=True)
class Design:
    """A loop that can be tuned: a control law on the axis, and which of its parameters are knobs.

    prefilter   whether a trajectory prefilter is fitted once it is tuned
    like        the design whose tuning it takes over, if it differs in the setpoint's path only
    remark      what must be known of it: the model behind the law, what of today's control was changed
    """

    name: str
    loop: Loop
    knobs: tuple[str, ...]
    remark: str = ""
    like: str = ""
    prefilter: bool = False
    compensator: bool = False


@dataclass(frozen=True)
class Refusal:
    """A law that does not go on this axis, and why."""

    name: str
    reason: str


def two_mass_model(plant: Plant) -> Plant:
    """The model of screw and table that a law may place poles on, from a plant.

    A chain of motor, screw and table becomes two masses: motor and screw are one body, which holds below the coupling's
    mode.  Raises StructureError, with the reason, for a plant that has no such model.
    """
    if isinstance(plant, ThreeMassChain):
        return TwoMass(
            mass_motor=plant.mass_motor + plant.mass_screw,
            mass_load=plant.mass_load,
            stiffness=plant.stiffness,
            damping=plant.damping,
            viscous_motor=plant.viscous_motor + plant.viscous_screw,
            viscous_load=plant.viscous_load,
        )
    mechanics = plant.mechanics()
    if mechanics.motor == mechanics.load and len(mechanics.mass) == 1:
        raise StructureError(
            f"the plant '{plant.kind}' is one mass: it has no mode between motor and load that poles could be placed on"
        )
    two_bodies("pole_placement", plant)
    return plant


def designs(loop: Loop) -> tuple[tuple[Design, ...], tuple[Refusal, ...]]:
    """All laws that this library knows, on the axis of a loop: what can be tuned, and what is refused.

    Filters, limit, guard, friction feedforward and the encoder of the velocity are those of the present control.  Each
    law has feedforward of acceleration and velocity: its own, that of the present control, or else that of the plant's
    mass and viscous friction, which is also what every law believes the axis to be.
    """
    found: list[Design] = []
    refused: list[Refusal] = []
    for name, make in _makers(loop):
        try:
            found.append(make(name))
        except FeeddriveError as error:
            refused.append(Refusal(name, str(error)))
    return tuple(found), tuple(refused)


def _makers(loop: Loop) -> Iterator[tuple[str, Callable[[str], Design]]]:
    """Names in the order of the report."""
    axis = _Axis(loop)
    yield "P-PI", axis.cascade
    yield "P-PI + compensator", axis.compensator
    yield "P-PI + recovery", lambda name: axis.recovery(name, axis.cascade(name))
    yield "DADSC", axis.dadsc
    yield "DADSC + recovery", lambda name: axis.recovery(name, axis.dadsc(name))
    yield "GPI, 5 Taylor states", lambda name: axis.gpi(name, 5)
    yield "GPI, 1 Taylor state", lambda name: axis.gpi(name, 1)
    yield "pole placement", axis.placement
    yield "placement + prefilter", lambda name: replace(axis.placement(name), like="pole placement", prefilter=True)


class _Axis:
    """What the designs share: the model of the axis and a rate to begin with."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.control = replace(loop.control, prefilter=None, compensation=())
        mechanics = loop.axis.mechanics()
        along = mechanics.rigid_motion()
        self.mass = float(matrix.dot([matrix.dot(row, along) for row in mechanics.mass], along))
        self.viscous = float(matrix.dot([matrix.dot(row, along) for row in mechanics.damping], along))
        actuator = loop.axis.actuator
        lag = 0.0 if actuator.current_loop is None else 1.0 / (2.0 * math.pi * actuator.current_loop)
        self.rate = _RATE / (actuator.dead_time + lag + loop.sample_time)
        law = loop.control.law
        self.encoder = str(getattr(law, "velocity_encoder", "motor"))

    @property
    def believed(self) -> str:
        """The model in words."""
        return f"believes the axis to be {self.mass:.6g} kg with {self.viscous:.6g} N s/m"

    def _with(self, name: str, law: Law, feedforward: Feedforward | None, remark: str) -> Design:
        """A design with a law: filters and friction feedforward stay, what the law feeds itself goes."""
        taken = set(law.feeds)
        blocks: list[Feedforward] = []
        for block in self.control.feedforward:
            kept = _without(block, taken) if feedforward is None else _without(block, {*taken, *_MOTION})
            if kept is not None:
                blocks.append(kept)
        fed = {*taken, *(each for block in blocks for each in block.fed())}
        own = feedforward
        if own is None and not fed & set(_MOTION):
            own = Inertia(mass=self.mass, viscous=self.viscous)
        if own is not None:
            blocks.append(own)
        control = replace(self.control, law=law, feedforward=tuple(blocks))
        loop = replace(self.loop, control=control)
        return Design(name, loop, tuple(f"control.law.{knob}" for knob in law.knobs), remark)

    def cascade(self, name: str) -> Design:
        """P-PI from the present gains, or from the rate; with an integral, and with each loop in every sample."""
        present: Any = self.control.law
        rate = self.rate
        begun = CascadePPI(Kv=0.7 * rate, Kp=2.5 * self.mass * rate, Tn=1.4 / rate, velocity_encoder=self.encoder)
        if not isinstance(present, CascadePPI):
            return self._with(name, begun, None, "")
        law = replace(present, position_every=1, velocity_feedforward=1.0)
        if present.Tn is None:
            law = replace(law, Kv=begun.Kv, Kp=begun.Kp, Tn=begun.Tn)
        changed = [
            text
            for text, differs in (
                ("with an integral, which it has not today", present.Tn is None),
                ("the position loop in every sample", present.position_every != 1),
                ("the whole set velocity fed forward", present.velocity_feedforward != 1.0),
            )
            if differs
        ]
        return self._with(name, law, None, "; ".join(changed))

    def compensator(self, name: str) -> Design:
        """P-PI with the feedforward of Wu et al.: motion and friction in one, its levels those of the axis."""
        friction = self._friction()
        block = DisturbanceCompensator(mass=self.mass, viscous=self.viscous, **friction)
        plain = self.cascade(name)
        kept = tuple(
            each
            for each in (_without(block, {*_MOTION, "friction"}) for block in self.control.feedforward)
            if each is not None
        )
        control = replace(plain.loop.control, feedforward=(*kept, block))
        shown = ", ".join(f"{key.replace('_', ' ')} {value:.4g}" for key, value in friction.items())
        return replace(
            plain,
            loop=replace(plain.loop, control=control),
            like="P-PI",
            remark=f"feedforward of motion and friction, levels of the axis's own friction: {shown} (SI)",
        )

    def _friction(self) -> dict[str, float]:
        """Levels of the axis's friction at speed, in both directions, with its Stribeck curve if it has one."""
        axis = self.loop.axis
        there = [each for each in (axis.friction_motor, axis.friction_load) if each is not None]
        if not there:
            raise StructureError("the axis has no friction that could be fed forward: it would be plain P-PI")
        speed = 0.05  # m/s: beyond the Stribeck curve of a guideway
        up = sum(-float(each.steady(speed)) - float(each.linear()) * speed for each in there)
        down = sum(float(each.steady(-speed)) - float(each.linear()) * speed for each in there)
        if max(abs(up), abs(down)) < 1e-9:
            raise StructureError("the axis has no dry friction that could be fed forward: it would be plain P-PI")
        found = {"coulomb_positive": max(abs(up), 0.0), "coulomb_negative": max(abs(down), 0.0)}
        curves = [each for each in there if getattr(each, "stribeck_velocity", None) is not None]
        if len(curves) == 1:
            block: Any = curves[0]
            extra = float(getattr(block, "breakaway", 0.0)) - float(
                getattr(block, "coulomb", found["coulomb_positive"])
            )
            found |= {"stribeck": extra, "stribeck_velocity": float(block.stribeck_velocity)}
        return found

    def dadsc(self, name: str) -> Design:
        """Three equal rates to begin with."""
        law = DADSC(
            mass=self.mass, viscous=self.viscous, tracking_rate=self.rate, reaching_rate=self.rate,
            adaptation_rate=self.rate, velocity_encoder=self.encoder,
        )  # fmt: skip
        return self._with(name, law, None, self.believed)

    def recovery(self, name: str, base: Design) -> Design:
        """A law with the recovered disturbance subtracted; the corner of the recovery is a knob more."""
        observer = DisturbanceRecovery(
            mass=self.mass, viscous=self.viscous, frequency=0.2 * self.rate, delay_samples=self._delay()
        )
        control = replace(base.loop.control, compensation=(DisturbanceRejection(observer=observer),))
        remark = f"recovery {self.believed}, a command to act after {observer.delay_samples} samples"
        return replace(
            base,
            loop=replace(base.loop, control=control),
            knobs=(*base.knobs, "control.compensation.0.observer.frequency"),
            remark=f"{base.remark}; {remark}" if base.remark else remark,
        )

    def _delay(self) -> int:
        actuator = self.loop.axis.actuator
        lag = 0.0 if actuator.current_loop is None else 1.0 / (2.0 * math.pi * actuator.current_loop)
        return round((actuator.dead_time + lag) / self.loop.sample_time)

    def gpi(self, name: str, states: int) -> Design:
        """A PD law on the observer's velocity and disturbance."""
        # wide apart and well damped: a fast observer amplifies what it sees near its own frequency
        damping, slower = (3.0, 1.0) if states > 1 else (1.5, 0.5)
        observer = GpiObserver(
            mass=self.mass, taylor_states=states, omega_o=3.0 * slower * self.rate, zeta_o=damping, encoder=self.encoder
        )
        law = ActiveDisturbanceRejection(mass=self.mass, omega_c=slower * self.rate, zeta_c=0.5, observer=observer)
        made = self._with(name, law, None, f"believes the axis to be {self.mass:.6g} kg")
        own = ("control.law.observer.omega_o", "control.law.observer.zeta_o")
        return replace(made, knobs=tuple(dict.fromkeys((*made.knobs, *own))))

    def placement(self, name: str) -> Design:
        """Pole placement on screw and table with the inverse dynamics of the same model."""
        if self.loop.axis.encoders() < 2:
            raise StructureError(
                "pole placement needs the position of the motor and that of the load; the controller reads one encoder"
            )
        model = two_mass_model(self.loop.axis.plant)
        mode = float(two_bodies("pole_placement", model).mode) / (2.0 * math.pi)
        law = PolePlacement(model=model, bandwidth=min(0.3 * mode, self.rate / (2.0 * math.pi)))
        shown = two_bodies("pole_placement", model)
        return self._with(
            name, law, InverseDynamics(model=model),
            f"model: {float(shown.m11):.5g} kg and {float(shown.m22):.5g} kg, spring {1e-6 * float(shown.k):.4g} N/um "
            f"({mode:.4g} Hz), friction {float(shown.c11 + shown.c12):.4g} and "
            f"{float(shown.c22 + shown.c12):.4g} N s/m",
        )  # fmt: skip


def _without(block: Feedforward, taken: set[str]) -> Feedforward | None:
    """A feedforward block without what is fed already; None if nothing of it is left."""
    fed = set(block.fed())
    if not fed & taken:
        return block
    if isinstance(block, DisturbanceCompensator) and "friction" in fed - taken:
        return replace(block, mass=None, viscous=None, jerk_feedforward=None, snap_feedforward=None)
    return None
