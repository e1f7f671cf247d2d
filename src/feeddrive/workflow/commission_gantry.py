"""`feeddrive commission --second`: two drives on one beam, skew first; the steps of one axis, and those of the skew.

The common motion of both sides is commissioned as one axis, under a control of the whole that is split by the masses of
the sides.  The skew is the same axis under the same control at another operating point (see `bus.gantry`): its response
is measured as that of the common motion is, and tuning and certificate hold for both.

    listen  skew  small_move  start_law  friction_and_mass  excitation  responses  model  skew_responses  tune ...
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from feeddrive.analysis.stability import stability
from feeddrive.bus.gantry import SIDES, Gantry, GantryMotion
from feeddrive.bus.live import LiveAxis
from feeddrive.bus.play import Profile
from feeddrive.commissioning.first_facts import SmallMove
from feeddrive.commissioning.motions import Push, TrialMotion
from feeddrive.commissioning.record import Step
from feeddrive.commissioning.skew import (
    TWISTED,
    Beam,
    SkewFacts,
    fit_skew,
    gantry_machine,
    predicted_gantry,
    sides_of,
    skew_facts,
    skew_figures,
    skew_lines,
    skew_moves,
    skew_of,
)
from feeddrive.commissioning.trial import Figures, figures, filled
from feeddrive.export.targets import TARGETS
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.frf import read_frfs
from feeddrive.files.log import Log
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.files.read_log import read_log
from feeddrive.identification.motion.identify import own_viscous
from feeddrive.language.errors import NotIdentifiableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.workflow.commission_steps import AXIS, SHARE, SIZES, SMALLER, SURE, Chain, RefusedError, Told, excited
from feeddrive.workflow.export import ExportRequest

FOLLOWER = "x2"  # the second side in machine files
DAMPED = 0.01  # damping ratio of the skew, until it is measured: that of a welded beam
LATE = (0.3, 1.0)  # of the dead time, until it is measured: a mode is damped by the one and driven by the other
TWIST = 0.5  # of limits.skew, that a motion is planned to use
PULLED = 0.4  # of limits.force, that a side may pull against the beam at first
CLEAR = 1.0  # times the friction, that the beam's force makes once its stiffness is told well
UNEVEN = 1.5  # times its half, that a side may carry before its mass is known
SLOWER = 1.5  # times the dead time, for which a start law is computed while the skew is unstable


class GantryChain(Chain):
    """The steps of the commissioning of a gantry."""

    @property
    def work(self) -> Mapping[str, Callable[[Any], Told]]:
        """The steps in order: the skew comes first, and its responses after those of the common motion."""
        made = dict[str, Callable[[Any], Told]]()
        for name, step in super().work.items():
            made[name] = step
            if name == "listen":
                made["skew"] = GantryChain.skew
            if name == "model":
                made["skew_responses"] = GantryChain.skew_responses
        return made

    @property
    def motion(self) -> GantryMotion:
        """The common motion, which is the axis of all steps but those of the skew."""
        return self.axis

    @property
    def gantry(self) -> Gantry:
        """Both drives."""
        return self.motion.gantry

    def _resume(self, done: Step) -> None:
        super()._resume(done)
        if done.name == "skew":
            self._know_skew(done.figures)
        if done.name == "friction_and_mass":
            self._know_sides(done.figures)

    # skew first

    def skew(self) -> Told:
        """Twist the beam slightly under the drives' own controls: how they count and push, and how stiff it is."""
        most = TWISTED[-1] * self.gantry.skew
        self._ask(
            Text(
                f"Skew: the drives' own controls move both sides slowly the same way, and then each alone, by at most "
                f"{Quantity(most, 'm'):3 SI} of skew (limits.skew {Quantity(self.gantry.skew, 'm'):3 SI}), with at "
                f"most {Quantity(PULLED, 'share'):3} of limits.force."
            )
        )
        told: SkewFacts | None = None
        why = ""
        for share in TWISTED:
            moves = skew_moves(share * self.gantry.skew, self.T)
            common = self._play(self._at(SHARE), moves.same).log
            twist = self.gantry.twist
            # the force of the beam grows with the skew, and is what is looked for
            twist = twist.limited(replace(twist.limits, force=PULLED * twist.limits.force))
            try:
                first, second = (
                    self._twisted(twist, moves.skew, moves.alone(side, self.gantry.shares)) for side in SIDES
                )
            except RefusedError as refused:
                why = why or refused.why
                break
            self._kept(common=common, first=first, second=second)
            try:
                told = skew_facts(common, (first, second))
            except NotIdentifiableError as error:
                why = str(error)
                continue
            if told.shown > CLEAR * sum(told.friction):
                break
        if told is None:
            raise RefusedError(why)
        facts = {
            "beam_stiffness": told.stiffness,
            "skew_free": told.free,
            "skew_sign_first": float(told.signs[0]),
            "skew_sign_second": float(told.signs[1]),
        }
        self._know_skew(facts)
        self._write_drive()
        turned = [side for side, sign in zip(SIDES, told.signs, strict=True) if sign < 0]
        signs = f"; the force of the {' and '.join(turned)} counts against its positions" if turned else ""
        return Text(
            f"the beam resists skew with {Quantity(told.stiffness, 'N/m'):3} and is free of force where the counts "
            f"differ by {Quantity(told.free, 'm'):3 SI}; friction {Quantity(told.friction[0], 'N'):3} and "
            f"{Quantity(told.friction[1], 'N'):3}{signs}"
        ), facts

    def _know_skew(self, facts: Mapping[str, float]) -> None:
        """Take over the signs of the forces, and where the beam is free."""
        signed = [
            axis.scaled(1.0, int(facts[f"skew_sign_{side}"]))
            for side, axis in zip(SIDES, self.gantry.sides, strict=True)
        ]
        self.axis = replace(self.gantry, first=signed[0], second=signed[1], free=facts["skew_free"]).common

    # the steps of the common motion, with what a gantry adds to them

    def _push(self, told: SmallMove) -> Push:
        made = super()._push(told)
        return replace(made, profile=replace(made.profile, excitation=made.profile.excitation / UNEVEN))

    def _write_drive(self) -> None:
        for side, axis in zip(SIDES, self.gantry.sides, strict=True):
            write_whole(self.place / f"drive_{side}.toml", axis.text())

    def _started(self, axis: Axis, spread: float) -> Loop:
        """Return an axis under a start law with which the skew is stable as well, whatever the dead time."""
        dead = float(axis.actuator.delay())
        beam = self._beam(float(axis.plant.rigid_mass()))
        slower = dead
        for _ in range(SIZES):
            loop = super()._started(replace(axis, actuator=replace(axis.actuator, dead_time=slower)), spread)
            loop = replace(loop, axis=axis)
            if all(self._bears(loop, beam, share * dead) for share in LATE):
                return loop
            slower *= SLOWER
        raise RefusedError(
            Text(
                f"no start law keeps the skew stable, which swings at about {Quantity(beam.frequency, 'Hz'):2}: "
                "shorten cycle_time"
            )
        )

    def _bears(self, loop: Loop, beam: Beam, dead_time: float) -> bool:
        late = replace(loop, axis=replace(loop.axis, actuator=replace(loop.axis.actuator, dead_time=dead_time)))
        return stability(self._whole(late, beam)).stable

    def _beam(self, mass: float) -> Beam:
        """Return the skew as it was measured or, before, as it is taken to be, for the mass of the whole (kg)."""
        s1, s2 = self.gantry.shares
        stiffness = self.facts["beam_stiffness"] / (s1 * s2)
        if "beam_damping" in self.facts:
            return Beam(mass, stiffness, self.facts["beam_damping"] / (s1 * s2))
        return Beam(mass, stiffness, 2.0 * DAMPED * math.sqrt(stiffness * mass))

    def _whole(self, loop: Loop, beam: Beam) -> Machine:
        """Return the machine of both sides for a loop of the whole."""
        s1, s2 = self.gantry.shares
        part = self.facts.get("friction_first", s1)
        between = (s1 * s2 * beam.stiffness, s1 * s2 * beam.damping)
        return gantry_machine(loop, (AXIS, FOLLOWER), (s1, s2), between, (part, 1.0 - part))

    def friction_and_mass(self) -> Told:
        """Move to and fro in common, and tell the sides' masses and frictions apart: they share the control."""
        told, known = super().friction_and_mass()
        strokes = read_log(self.place / "strokes.parquet")
        first, second = sides_of(strokes, self.facts["beam_stiffness"], self.facts["skew_free"])
        mass = first.mass + second.mass
        sure = first.mass > 0.0 and second.mass > 0.0 and max(first.error, second.error) < SURE * 0.5 * mass
        rubs = first.coulomb + second.coulomb
        facts = {
            **known,
            "share_first": first.mass / mass if sure else 0.5,
            "friction_first": first.coulomb / rubs if sure and rubs > 0.0 else 0.5,
        }
        self._know_sides(facts)
        masses = (Quantity(side.mass, "kg", side.error) for side in (first, second))
        sides = Text(
            f"The sides: {' and '.join(map(str, masses))}, friction {Quantity(first.coulomb, 'N'):3} and "
            f"{Quantity(second.coulomb, 'N'):3}; the first gets {Quantity(facts['share_first'], 'share'):3} of the "
            "force."
        )
        return Text(f"{told} {sides}"), facts

    def _along(self, log: Log) -> None:
        """Return None: each of the two motors has a force of its own along the travel, and the strokes tell the sum."""

    def _know_sides(self, facts: Mapping[str, float]) -> None:
        share = facts["share_first"]
        self.axis = replace(self.gantry, shares=(share, 1.0 - share)).common

    def skew_responses(self) -> Told:
        """Shake the sides against each other while both move, and estimate the response of the skew."""
        loop = read_machine(self._in("excitation", "machine.toml")).loop(AXIS)
        files = sorted(self._in("excitation", "").glob("excitation_*.csv"))
        moves = [excited(path) for path in files]
        model = read_machine(self._in("model", "machine.toml")).loop(AXIS)
        shaken = self._shaken(replace(model, control=loop.control), moves[0])
        s1, s2 = self.gantry.shares
        self._ask(
            Text(
                f"Skew responses: both sides move slowly as before and are shaken against each other with at most "
                f"{Quantity(shaken * s1 * s2 * self.facts['amplitude'], 'N'):3}, {len(moves)} times."
            )
        )
        twist = cast(GantryMotion, self._under_control()).gantry.twist
        logs = list[Log]()
        for move in moves:
            still = np.zeros(move.set_position.size)
            force = replace(move, excitation=shaken * move.excitation, set_position=still, velocity=still)
            logs.append(self._twisted(twist, force, replace(move, excitation=still), loop.control))
        told = self._estimated(logs)
        beam = self._fitted_beam(self._skew_response())
        return Text(
            f"the skew swings at {Quantity(beam.frequency, 'Hz'):3} with {Quantity(beam.damping_ratio, 'share'):2} of "
            f"damping; the beam has {Quantity(s1 * s2 * beam.stiffness, 'N/m'):3} against it, and what swings is "
            f"{Quantity(beam.mass / float(model.axis.plant.rigid_mass()), 'share'):3} of the mass of both sides. {told}"
        ), {
            "beam_stiffness": s1 * s2 * beam.stiffness,
            # the guideways damp the skew as well
            "beam_damping": s1 * s2 * max(0.0, beam.damping - _viscous(model.axis)),
            "skew_frequency": beam.frequency,
        }

    def _twisted(self, twist: GantryMotion, profile: Profile, along: Profile, control: Control | None = None) -> Log:
        """Play a skew along a common motion; raise RefusedError with the reason if it ended early."""
        played = twist.play(profile, self.progress, control, along)
        if played.aborted:
            self._ended(played)
            raise RefusedError(Text(f"the {profile.name} ended early: {played.aborted}"))
        return filled(played.log)

    def _shaken(self, loop: Loop, move: Profile) -> float:
        """Return the share of the excitation of the common motion that the skew bears, by simulation."""
        machine = self._whole(loop, self._beam(float(loop.axis.plant.rigid_mass())))
        still = np.zeros(move.set_position.size)
        for attempt in range(2 * SIZES):
            share = SMALLER**attempt
            force = replace(move, excitation=share * move.excitation, set_position=still, velocity=still)
            if self._fits(self._simulated(machine, replace(move, excitation=still), force)):
                return share
        raise RefusedError(
            Text(
                f"no excitation of the skew stays within limits.skew = {Quantity(self.gantry.skew, 'm'):3 SI}: raise it"
            )
        )

    def _simulated(self, machine: Machine, common: Profile, skew: Profile | None = None) -> Log:
        """Return the log of a motion of the gantry as its machine is predicted to answer it."""
        gantry = self.gantry
        one, other = (side.increment for side in gantry.sides)
        # of one side: the reading of the common motion is a mean
        noise = self.facts["noise"] / float(np.hypot(*gantry.shares))
        return predicted_gantry(machine, gantry.shares, gantry.profiles(common, skew), (one, other), noise)

    def _fits(self, log: Log) -> bool:
        if "reading_first" not in log.channels:
            return super()._fits(log)
        within = all(
            float(np.max(np.abs(log[f"commanded_{name}"]))) <= side.limits.force
            for name, side in zip(SIDES, self.gantry.sides, strict=True)
        )
        return within and super()._fits(log) and float(np.max(np.abs(skew_of(log)))) <= TWIST * self.gantry.skew

    # for both motions

    def _skew_response(self) -> FRF:
        """Return the measured response of the skew."""
        found = read_frfs(self._in("skew_responses", "responses/frf.csv"))
        response = next((each for name, each in found.items() if "load" in name), next(iter(found.values())))
        return replace(response, sample_time=self.T)

    def _dead_time(self) -> float:
        return float(read_machine(self._in("model", "machine.toml")).loop(AXIS).axis.actuator.delay())

    def _fitted_beam(self, response: FRF) -> Beam:
        return fit_skew(response, self._dead_time())

    def _beside(self) -> tuple[FRF, ...]:
        response = self._skew_response()
        return (skew_lines(response, self._fitted_beam(response), self._dead_time()),)

    def _not_tried(self) -> str:
        """Write the machine of both sides, and return why its trial cannot be predicted."""
        loop = read_machine(self.place / "machine.toml").loop(AXIS)
        machine = self._whole(loop, self._beam(float(loop.axis.plant.rigid_mass())))
        if not stability(machine).stable:
            return "the control is unstable on the model of both sides with their beam"
        write_whole(
            self._controlled(),
            machine_toml(machine, self.axis.where, "feeddrive commission: a share of the tuned control on each side"),
        )
        return super()._not_tried()

    def _controlled(self) -> Path:
        return self._in("tune", "gantry.toml")

    def _export_request(self) -> ExportRequest:
        target = self.request.target
        together = target in TARGETS and TARGETS[target].together
        return ExportRequest(self._controlled(), target=target, together=together, out=self.place)

    # the trial

    def _learn(self, control: Control, log: Log) -> None:
        """Leave the model as it is: the sides share the friction by their strokes."""

    def _guarded(self, control: Control, simulated: Mapping[str, Log]) -> Control:
        """Return the control as it is: the guards of both sides see the skew as well."""
        return control

    def _tried(self, motion: TrialMotion, axis: LiveAxis, control: Control | None = None) -> dict[str, Log]:
        logs = super()._tried(motion, axis, control)
        twist = cast(GantryMotion, axis).gantry.twist
        return logs | {"twisted": self._twisted(twist, _still(motion), motion.alone, control)}

    def _expected(self, loop: Loop, motion: TrialMotion) -> dict[str, Log]:
        machine = read_machine(self._controlled()).machine()
        return {
            "alone": self._simulated(machine, motion.alone),
            "pushed": self._simulated(machine, motion.pushed),
            "twisted": self._simulated(machine, motion.alone, _still(motion)),
        }

    def _figures(self, motion: TrialMotion, logs: Mapping[str, Log]) -> Figures:
        s1, s2 = self.gantry.shares
        skew = skew_figures(motion, logs["alone"], logs["twisted"], s1 * s2 * motion.force)
        return replace(figures(motion, logs["alone"], logs["pushed"]), **skew)


def _viscous(axis: Axis) -> float:
    """Return the viscous friction of an axis, N s/m."""
    friction = axis.friction_load
    return own_viscous(axis) + (0.0 if friction is None else float(friction.linear()))


def _still(motion: TrialMotion) -> Profile:
    """Return the pulse of a trial as a force on the skew alone."""
    still = np.zeros(motion.pushed.set_position.size)
    return replace(motion.pushed, name="trial with a skew force", set_position=still, velocity=still)
