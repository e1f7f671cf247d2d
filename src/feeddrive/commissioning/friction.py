"""The friction of an axis whose other parts are known, by simulating the strokes that it made.

Where friction acts, and whether it falls from a breakaway level, is told by evidence: each candidate is fitted by
output error, and a richer one is taken only if it leaves clearly less of the motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from feeddrive.blocks.force.backlash import Backlash
from feeddrive.blocks.force.spring import check_spring
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.commissioning.trial import COMMANDED
from feeddrive.files.log import Log
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.motion.output_error import Refinement, refine
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, NotIdentifiableError, StructureError
from feeddrive.loop.axis import Axis
from feeddrive.loop.loop import Loop

_CLEARLY = 0.95  # of what a simpler candidate leaves: a richer one must leave less
_BREAKAWAY, _STRIBECK = 1.3, 3e-3  # times the level, and m/s, with which a fit begins
_SETTLED = 0.2  # s at the beginning of the log, in which a start differs from that of the simulation


@dataclass(frozen=True)
class FrictionFit:
    """The axis with its friction, the body on which it acts, its curve, and what is left of the position, m RMS."""

    axis: Axis
    body: str
    curve: str
    left: float

    @property
    def gap(self) -> float:
        """The play between motor and load, m, which is among the forces of the axis; 0 without one."""
        return sum(float(force.gap) for force in self.axis.forces if isinstance(force, Backlash))


def fit_friction(ran: Loop, log: Log, coulomb: float, viscous: float = 0.0, *, play: bool = False) -> FrictionFit:
    """Return the axis of the loop that ran with the friction that explains the log of its strokes best.

    ran      the loop as it ran, with the plant that is known; its friction is replaced
    coulomb, viscous  N and N s/m, from which the fits begin
    play     a play in the spring between motor and load is looked for as well (`gap`, m)

    Raises NotIdentifiableError if no candidate can be fitted.
    """
    motion = MotionLog(
        name=log.name,
        position=log["reading_load"] - log["set_position"][0],
        # the command of the control, by which a run is compared with the log: a velocity where it commands one
        force=log[COMMANDED[ran.axis.actuator.commanded]],
        sample_time=log.sample_time,
        set_position=log["set_position"] - log["set_position"][0],
        rotary=ran.axis.rotary,
        turning=ran.axis.rotary,
    )
    two = ran.axis.plant.mechanics().motor != ran.axis.plant.mechanics().load
    skip = round(_SETTLED / log.sample_time)
    fits, why = dict[tuple[str, str], FrictionFit](), ""

    def tried(body: str, curve: str) -> None:
        nonlocal why
        try:
            fit = _fitted(ran, motion, body, curve, coulomb, viscous, skip)
        except FeeddriveError as error:
            why = str(error)
        else:
            fits[body, curve] = FrictionFit(fit.loop.axis, body, curve, fit.by_delay[0])

    bodies = ("load", "motor") if two else ("load",)
    for body in bodies:
        tried(body, "coulomb")
    # a curve takes longer to fit: only where a level alone leaves about as little as anywhere
    least = min((fit.left for fit in fits.values()), default=math.inf)
    levels = {body: fits[body, "coulomb"].left for body in bodies if (body, "coulomb") in fits}
    for body in bodies:
        if body not in levels or _CLEARLY * levels[body] <= least:
            tried(body, "stribeck")
    best: FrictionFit | None = None
    for (_, curve), fit in fits.items():
        if best is None or fit.left < (_CLEARLY if curve == "stribeck" else 1.0) * best.left:
            best = fit
    if best is None:
        raise NotIdentifiableError(f"no friction explains the strokes: {why}")
    with_play = _with_play(ran, motion, coulomb, viscous, skip, best.left) if play and two else None
    return with_play if with_play is not None and with_play.left < _CLEARLY * best.left else best


def _with_play(ran: Loop, log: MotionLog, coulomb: float, viscous: float, skip: int, left: float) -> FrictionFit | None:
    """Return the axis with a play in its spring and friction on both of its ends; None if that cannot be fitted."""
    try:
        check_spring("backlash", ran.axis.plant)
    except StructureError:
        return None
    # within a play each end has its own friction
    ends = {f"friction_{body}": Coulomb(coulomb=0.5 * coulomb, viscous=0.5 * viscous) for body in ("load", "motor")}
    own = {name: 0.0 for name, _ in tree.leaves(ran.axis.plant) if name.startswith("viscous")}
    # what a play leaves of the position is about as large as it
    forces = (*(force for force in ran.axis.forces if not isinstance(force, Backlash)), Backlash(gap=2.0 * left))
    loop = replace(ran, axis=replace(ran.axis, plant=replace(ran.axis.plant, **own), forces=forces, **ends))
    place = loop.place_of("axis")
    gap = f"{place}.forces.{len(forces) - 1}.gap"
    names = [f"{place}.friction_{body}.{name}" for body in ("load", "motor") for name in ("coulomb", "viscous")]
    try:
        fit = refine(loop, log, [*names, gap], delays=(0,), skip=skip)
    except FeeddriveError:
        return None
    return FrictionFit(fit.loop.axis, "motor and load", "coulomb", fit.by_delay[0])


def _fitted(ran: Loop, log: MotionLog, body: str, curve: str, coulomb: float, viscous: float, skip: int) -> Refinement:
    friction = (
        Coulomb(coulomb=coulomb, viscous=viscous)
        if curve == "coulomb"
        else Stribeck(
            coulomb=coulomb,
            breakaway=_BREAKAWAY * coulomb,
            stribeck_velocity=_STRIBECK,
            viscous=viscous,
        )
    )
    places = {"friction_load": None, "friction_motor": None, f"friction_{body}": friction}
    # small oscillations on dry friction look like much viscous friction: that of the strokes takes its place
    own = {name: 0.0 for name, _ in tree.leaves(ran.axis.plant) if name.startswith("viscous")}
    loop = replace(ran, axis=replace(ran.axis, plant=replace(ran.axis.plant, **own), **places))
    place = f"{loop.place_of('axis')}.friction_{body}"
    names = [f"{place}.coulomb", f"{place}.viscous"]
    names += [f"{place}.breakaway", f"{place}.stribeck_velocity"] if curve == "stribeck" else []
    return refine(loop, log, names, delays=(0,), skip=skip)
