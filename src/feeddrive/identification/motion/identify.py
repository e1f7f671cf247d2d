"""Complete identification from one log: inverse dynamics, dead time, control law, output error, recommendation."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from feeddrive.analysis.friction_map import FrictionMap, friction_map
from feeddrive.blocks.families import Force, Friction, Law
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.friction.viscous import Viscous
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.identification.motion import control_law
from feeddrive.identification.motion.control_law import LawCheck
from feeddrive.identification.motion.identify_law import ControlFit, identify_control
from feeddrive.identification.motion.motion_log import MotionLog, Preparation, checked, count_of, drawn, prepare
from feeddrive.identification.motion.output_error import Refinement, dead_time, refine
from feeddrive.identification.motion.rigid import (
    MORE_RAMPS,
    SURE_MASS,
    DelayFit,
    RigidFit,
    find_delay,
    identify_rigid,
    widened,
)
from feeddrive.identification.plausibility import out_of_range, outside, remedy, sizes
from feeddrive.identification.regression import NORMAL, SHAFT, Estimate
from feeddrive.language import tree
from feeddrive.language.errors import DivergedError, FeeddriveError, LogError, NotIdentifiableError
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

# The update of a known axis by a log of a motion: mass, friction and constant force change, the rest is kept.

_PLAIN = (Coulomb, Directional, Viscous)  # friction models whose parameters the inverse dynamics identify completely
_FAR = 0.05  # share by which the sum of the masses may differ without a remark


def with_rigid(axis: Axis, rigid: RigidFit, *, richer: bool = False) -> Axis:
    """Return the axis with the identified mass, friction and constant force.

    A significant constant force is added if the axis has none. A plant with several bodies keeps its masses and
    dampers, which a rigid fit cannot separate; if it also has friction at the motor, the axis is returned unchanged.
    With `richer`, the friction model of the axis keeps its shape near standstill and is scaled to the identified
    levels.
    """
    if not isinstance(axis.plant, Rigid) and axis.friction_motor is not None:
        return axis
    plant = rigid.plant() if isinstance(axis.plant, Rigid) else axis.plant
    friction = _without(rigid.friction_block(), 0.0 if isinstance(axis.plant, Rigid) else own_viscous(axis))
    if richer and axis.friction_load is not None:
        friction = _scaled(axis.friction_load, friction)
    others: tuple[Force, ...] = tuple(force for force in axis.forces if not isinstance(force, Gravity))
    along = rigid.position_force()
    if along is not None and not others:
        # forces of the machine file along the travel are known better than from one move
        others = (along,)
    pulled = rigid.is_pulled or any(isinstance(force, Gravity) for force in axis.forces)
    gravity = rigid.gravity() if pulled else None
    forces = others if gravity is None else (*others, gravity)
    return replace(axis, plant=plant, friction_load=friction, forces=forces)


def is_richer(axis: Axis) -> bool:
    """Return True if the friction model has a Stribeck curve, presliding or a table, not only levels and slopes."""
    return axis.friction_load is not None and not isinstance(axis.friction_load, _PLAIN)


def own_viscous(axis: Axis) -> float:
    """Return the viscous friction of the plant in N s/m, eᵀ C e, for rigid-body motion e and damping matrix C."""
    mechanics = axis.plant.mechanics()
    e = [float(share) for share in mechanics.rigid_motion()]
    return sum(e[i] * float(mechanics.damping[i][j]) * e[j] for i in range(len(e)) for j in range(len(e)))


def refined_names(loop: Loop) -> tuple[str, ...] | None:
    """Return the names of the parameters to be fitted by output error.

    The result is None for a rigid axis with plain friction, for which `refine` fits its default parameters (`physics`).
    Otherwise these are the nonzero parameters of friction and constant forces, and the mass of a rigid plant. Of a
    richer friction model only levels and slopes are fitted; its parameters near standstill are kept.
    """
    if isinstance(loop.axis.plant, Rigid) and not is_richer(loop.axis):
        return None
    ends = ("coulomb", "coulomb_positive", "coulomb_negative", "viscous", "viscous_positive", "viscous_negative")
    axis = loop.place_of("axis")
    names = [
        name
        for name, value in tree.parameters(loop).items()
        if isinstance(value, float)
        and value != 0.0
        and (
            name == f"{axis}.plant.mass"
            or (name.startswith(f"{axis}.friction_load.") and name.endswith(ends))
            or (name.startswith(f"{axis}.forces.") and name.endswith(".force"))
        )
    ]
    return tuple(name for name in names if isinstance(loop.axis.plant, Rigid) or name != f"{axis}.plant.mass")


def axis_remarks(axis: Axis, rigid: RigidFit) -> list[Text]:
    """Return remarks on a plant with several bodies, whose individual masses a motion log cannot identify."""
    if isinstance(axis.plant, Rigid):
        return []
    mass, their_sum = rigid["mass"], float(axis.plant.rigid_mass())
    off = mass.value - their_sum
    remarks = [
        Text(
            f"the axis is a {axis.plant.kind}: a log of a motion shows the sum of its masses, {mass.quantity}, but "
            "not each of them; its masses, springs and dampers stay as they are"
        )
    ]
    if abs(off) > max(3.0 * mass.error, _FAR * their_sum):
        remarks[0] += Text(
            f". Their sum, {Quantity(their_sum, mass.unit):5}, is off by {Quantity(off / their_sum, 'share'):+.2g}: "
            "measure a frequency response (feeddrive excite, frf) and identify that"
        )
    if axis.friction_motor is not None:
        levels = joined(", ", (f"{e.name} {Quantity(e.value, e.unit)}" for e in rigid.estimates if e.name != "mass"))
        remarks.append(
            Text(f"friction acts on both bodies, and the log shows only its sum ({levels}): both stay as they are")
        )
    return remarks


def _without(friction: Friction, viscous: float) -> Friction:
    """Return the friction reduced by the viscous friction of the plant's dampers."""
    if isinstance(friction, Coulomb):
        return replace(friction, viscous=max(0.0, float(friction.viscous) - viscous))
    if isinstance(friction, Directional):
        return replace(
            friction,
            viscous_positive=max(0.0, float(friction.viscous_positive) - viscous),
            viscous_negative=max(0.0, float(friction.viscous_negative) - viscous),
        )
    return friction


def _scaled(richer: Friction, identified: Friction) -> Friction:
    """Return a richer friction model with the identified levels; its excess at low speed is scaled in proportion."""
    leaves = dict(tree.leaves(identified))
    level = [float(value) for name, value in leaves.items() if name.startswith("coulomb")]
    slope = [float(value) for name, value in leaves.items() if name.startswith("viscous")]
    sides = {"positive": 0, "negative": -1}
    changes: dict[str, float] = {}
    old = dict(tree.leaves(richer))
    for name in old:
        head, _, side = name.partition("_")
        if head in ("coulomb", "viscous", "breakaway") and side in ("", "positive", "negative"):
            which = level if head != "viscous" else slope
            mean = which[sides[side]] if side else sum(which) / len(which)
            if head == "breakaway":
                before = float(old.get(name.replace("breakaway", "coulomb"), 0.0) or 0.0)
                changes[name] = mean * (float(old[name]) / before if before > 0.0 else 1.0)
            else:
                changes[name] = mean
    # the LuGre model refuses a level of 0
    least = {"coulomb": 1e-9, "breakaway": 1e-9}
    return tree.vary(richer, {name: max(value, least.get(name, 0.0)) for name, value in changes.items()})


# The choice between inverse dynamics and closed loop, where they contradict each other on the same log.

# runs of the closed loop with its counts: one log in 17 leaves more than the worst of 16 by chance
_RUNS = 16


def agreed(
    log: MotionLog, loop: Loop, fit: Refinement, delay: DelayFit, stated: float, remarks: list[str]
) -> Refinement:
    """Return the output-error fit with the dead time to be used: its own, or that of the inverse dynamics.

    The dead time of the inverse dynamics minimizes the force residual, that of the closed loop the position residual.
    They may differ. If the force residual is 10 % larger with the dead time of the closed loop, each residual is
    computed with the dead time of the other method, and the method whose residual increases by the larger factor
    determines the dead time. Otherwise that of the closed loop is used.
    """
    extra = beyond(delay, stated)
    # ratios, since one residual is a force and the other one a position
    grows = delay.left(stated + fit.delay) / delay.left(stated + extra)
    if extra == fit.delay or not delay.tells(stated + extra, stated + fit.delay):
        return fit
    try:
        other = refine(loop, log, tuple(estimate.name for estimate in fit.estimates), delays=[extra])
        value, error = dead_time(other, log)
    # a loop that diverges with this dead time is not the loop that ran
    except DivergedError:
        return fit
    left, without = other.by_delay[extra], fit.by_delay[fit.delay]
    apart = abs(delay.dead_time - stated - value)
    joint = control_law.SURE * math.hypot(error, delay.error)
    first = grows > left / without
    ways = delay.left(stated + extra), delay.left(stated + fit.delay)
    remarks.append(
        Text(
            "dead time in samples beyond the stated one: the inverse dynamics say "
            f"{Quantity(delay.dead_time - stated, error=delay.error)} and leave {Quantity(ways[0], 'share'):3} of the "
            f"force with {extra}, {Quantity(ways[1], 'share'):3} with {fit.delay}; the closed loop says "
            f"{Quantity(value, error=error)} and leaves {log.distance(left)} of the position with {extra}, "
            f"{log.distance(without)} with {fit.delay}. They "
            f"{'contradict each other' if apart > joint else 'agree within three errors'}; that of the "
            f"{'inverse dynamics' if first else 'closed loop'} is taken, whose residual grows more with the other one"
        )
    )
    return other if first else fit


def better(
    log: MotionLog, rigid: RigidFit, fit: Refinement, how: Preparation, remarks: list[str]
) -> tuple[RigidFit, Refinement | None]:
    """Return both fits, or None for the output-error fit if the inverse dynamics are to be taken.

    They are taken if the relative error of the mass of the closed loop exceeds `SURE_MASS` and its error is more than
    `SURER` times that of the inverse dynamics, or if the masses contradict each other and the inverse dynamics leave
    less of the force in their rows. Masses contradict each other if they differ by more than three joint standard
    errors: the model lacks something, so that the truth may lie anywhere between them (`Estimate.towards`).
    """
    mass = next((estimate for estimate in fit.estimates if estimate.name.endswith("plant.mass")), None)
    rigid_mass = rigid["mass"]
    if mass is not None and mass.error > max(SURE_MASS * abs(mass.value), SURER * rigid_mass.error):
        remarks.append(
            Text(
                f"the closed loop says a mass of {Quantity(mass.value, rigid_mass.unit, mass.error)}, the inverse "
                f"dynamics {rigid_mass.quantity}: these, which are surer of it, are taken"
            )
        )
        return rigid, None
    if mass is None or abs(mass.value - rigid_mass.value) < control_law.SURE * math.hypot(mass.error, rigid_mass.error):
        return rigid, fit
    rows = prepare(log, how)
    residual = log.force - fit.replay.run["force"][: log.force.size]
    left = float(np.linalg.norm(rows.force_with(residual, how.delay)) / np.linalg.norm(rows.force))
    first = rigid.residuals.relative < left
    remarks.append(
        Text(
            f"the inverse dynamics say a mass of {rigid_mass.quantity} and leave "
            f"{Quantity(rigid.residuals.relative, 'share'):3} of the force in motion, the closed loop says "
            f"{Quantity(mass.value, rigid_mass.unit, mass.error)} and leaves {Quantity(left, 'share'):3} of it: they "
            "contradict each other, as where a force acts that the model lacks; the "
            f"{'inverse dynamics' if first else 'closed loop'}, which leave{'' if first else 's'} less, "
            f"{'are' if first else 'is'} taken, with a share of the difference in the error of its mass"
        )
    )
    least, most = sorted((left, rigid.residuals.relative))
    if first:
        return widened(rigid, [rigid_mass.towards(mass, least, most)]), None
    wider = (one.towards(rigid_mass, least, most) if one is mass else one for one in fit.estimates)
    return rigid, replace(fit, estimates=tuple(wider))


def with_counts(log: MotionLog, rigid: RigidFit, fit: Refinement, how: Preparation) -> RigidFit:
    """Return the fit of the inverse dynamics with the residual due to quantization, simulated in the closed loop.

    Through a velocity gain, coarse counts excite a vibration that the readings do not show, so that the residual is
    larger than the reading errors alone would cause.  If quantization is the reason, simulations of the fitted loop
    with the counts of the log have a residual of this size; the largest of these residuals is used.
    """
    count = count_of(log.position)
    if count == 0.0:
        return rigid
    used, unused = [], []
    for position, force in drawn(fit.loop, log, 0, count, _RUNS, seed=3):
        try:
            run = identify_rigid(
                MotionLog(name=log.name, position=position, force=force, sample_time=log.sample_time),
                friction=rigid.friction,
                how=how,
            )
        except (LogError, NotIdentifiableError):
            # a run that cannot be fitted shows nothing about counts
            return rigid
        used.append(run.residuals.relative)
        unused.append(run.validation.relative)
    return replace(rigid, counts=(max(rigid.counts[0], *used), max(rigid.counts[1], *unused)))


def beyond(delay: DelayFit, stated: float) -> int:
    """Return the additional dead time in whole samples that the inverse dynamics clearly indicate, or 0."""
    extra = max(0, round(delay.dead_time - stated))
    return extra if delay.tells(stated + extra, stated) else 0


# Complete identification of one log: inverse dynamics, dead time, control law, output error, recommendation.

_PLACE = "control"  # of a law that no machine file states
_CLEARLY = 1.02  # times the position residual of plain friction up to which the machine's own kind is kept
SURER = 2.0  # times that an error of the closed loop must be larger for the inverse dynamics to be taken
# largest relative standard error of a mass in a machine file: a start law is checked for masses off by twice that, and
# a loop with a gain margin of 6 dB bears a mass that is 30 % off
USABLE_MASS = 0.15
POOR = 0.15  # largest unexplained share of the force for which the values are recommended
_BENDS = "so the axis bends, binds or is driven by something else; measure a frequency response next"


@dataclass(frozen=True, eq=False, repr=False)
class Identified(Result):
    """The model of a drive identified from one log.

    loop        the loop with the identified values, ready to simulate; None for an unknown law or a log in shaft units
    control     the law identified from the log, or None
    refinement  the output-error fit, or None
    law         check of the law against the log; None if no law is known
    remarks     remarks on parameters that could not be identified, with the reasons
    started     description of the law of `loop` if it is a safe start law instead of the law of the log; otherwise
                empty
    doubt       reason why the magnitudes in the log are implausible for a feed drive; empty if they are plausible
    contradicted  evidence from a second source against clock or scales of the log, and the correction; otherwise empty
    """

    log: MotionLog
    rigid: RigidFit
    delay: DelayFit
    control: ControlFit | None
    refinement: Refinement | None
    friction: FrictionMap | None
    loop: Loop | None
    remarks: tuple[str, ...]
    doubt: str = ""
    law: LawCheck | None = None
    started: str = ""
    contradicted: str = ""

    @property
    def rotary(self) -> bool:
        """True for a rotary axis."""
        return self.log.turning

    def table(self) -> Table:
        """Return a table of the parameters of the inverse dynamics."""
        return self.rigid.table()

    @property
    def faulty(self) -> str:
        """The reason why the model does not describe the log, regardless of its standard errors, or an empty string."""
        rigid = self.rigid
        if self.law is not None and self.law.wrong:
            return self.law.wrong
        if rigid.left > POOR:
            return Text(
                f"a rigid drive with {rigid.friction} friction leaves {Quantity(rigid.left, 'share'):3} of the force"
            )
        if rigid.changed:
            return Text(
                f"the error on stretches that were not used is {Quantity(rigid.validation.relative, 'share'):3}, on "
                f"those that were used {Quantity(rigid.residuals.relative, 'share'):3}, so the axis changed along the "
                "log"
            )
        return ""

    @property
    def unusable(self) -> str:
        """The reason why the values must not be used in a machine file, or an empty string."""
        if self.faulty:
            return self.faulty
        if self.contradicted:
            return "a second source contradicts clock or scales of the log"
        return self.unsure if self.mass.error > USABLE_MASS * self.mass.value else ""

    @property
    def unsure(self) -> Text:
        """A phrase on how accurately the log determines the mass, and how to improve it."""
        return Text(f"the log tells {within(self.mass)}; {MORE_RAMPS}")

    @property
    def recommendation(self) -> str:
        """The recommendation as a sentence."""
        return self.advice.sentence

    @property
    def advice(self) -> Advice:
        """The recommended use of the values, with the reason."""
        why = self.unusable
        if self.doubt:
            return Judgment.UNITS_IN_DOUBT.because(self.doubt)
        if self.contradicted:
            return Judgment.SCALES_IN_DOUBT.because(self.contradicted)
        if self.law is not None and self.law.wrong:
            return Judgment.DO_NOT_TUNE.because(Text(f"{why}; state in the machine file the law that made the log"))
        if self.rigid.left > POOR:
            return Judgment.DO_NOT_TUNE.because(Text(f"{why}, {_BENDS} (feeddrive excite)"))
        if why:
            return Judgment.DO_NOT_TRUST.because(why)
        mass = self.mass
        if mass.error > SURE_MASS * mass.value:
            return Judgment.DO_NOT_TRUST.because(self.unsure)
        unused = Quantity(self.rigid.validation.relative, "share")
        reason = Text(f"they predict stretches of the log that were not used to {unused:3} of the force")
        if self.refinement is not None:
            off = self.log.distance(self.refinement.replay.rms("position_load"), 3)
            reason += Text(f", and in closed loop the position to {off} RMS")
        return Judgment.USE_VALUES.because(Text(f"{reason}{self._why_friction()}"))

    @property
    def mass(self) -> Estimate:
        """The mass for a machine file: that of the closed loop if it was fitted, otherwise that of the inverse
        dynamics.

        Its error includes half of the difference between the two masses, since effects that both models lack, such as
        the elasticity of the axis, change them differently.
        """
        fitted = () if self.refinement is None else self.refinement.estimates
        rigid = self.rigid["mass"]
        mass = next((one for one in fitted if one.name.endswith("plant.mass")), rigid)
        return replace(mass, error=math.hypot(mass.error, 0.5 * (mass.value - rigid.value)))

    def _why_friction(self) -> str:
        criterion = self.rigid.criterion
        if len(criterion) < 2:
            return ""
        other = next(name for name in criterion if name != self.rigid.friction)
        worse = criterion[other] - criterion[self.rigid.friction]
        return Text(
            f"; friction is taken as {self.rigid.friction}, as the criterion of {other} is worse by {Quantity(worse):3}"
        )


def within(mass: Estimate) -> Text:
    """Return the uncertainty of a mass as the end of a sentence: `the mass to +-3 % only, from ... to ... at 95 %`."""
    share = Quantity(NORMAL * mass.error / mass.value, "share")
    low, high = (Quantity(limit, mass.unit) for limit in mass.interval)
    return Text(f"the mass to +-{share:2} only, from {low:3} to {high:3} at 95 %")


def identify_motion(
    log: MotionLog,
    start: Loop | None = None,
    *,
    law: Law | None = None,
    friction: str = "best",
    how: Preparation | None = None,
    lead: float | None = None,
    gear: float = 1.0,
    motor: np.ndarray | None = None,
) -> Identified:
    """Identify a rigid drive from a log of position and force, and of the set position if available.

    start      the loop that produced the log, as far as known; its law, limits, encoders and dead time are kept
    law        the law of this loop, if `start` is not given; None: it is identified
    friction   "best", "symmetric" or "directional"
    lead, gear for a log in shaft units: lead in m and gear ratio, with which the result is referred to the table
    motor      readings of the motor encoder if the position is that of the load: the law is first identified from them,
               since most drives control the motor position

    If a step fails, a remark is added and no error is raised; only the rigid drive must be identifiable.
    Raises NotIdentifiableError with what to measure next, LogError for an unusable log.
    """
    whole, remarks = checked(log), list[str]()
    closed = log.set_position is not None and log.frame is not SHAFT
    check = _checked_law(log, start, law) if closed else None
    # a peak that the law itself commanded is no fault of the recorder
    if check is None or not check.proves:
        log, spikes = whole.without_spikes()
        remarks += spikes
    control, law_log = None, log
    if start is None and law is None and closed:
        control, law_log = _law_of(log, motor, remarks)
    # a wrong sign gives gains that no law can have: the fit of the rigid drive reports it
    blocks = None
    if control is not None:
        remarks += control.remarks
        blocks = control.control(log.force_limit)
        # other readings than those of the law contradict any law; it was found in spite of them
        if not control.other_readings:
            blocks, check = _as_blocks(law_log, control, blocks, remarks)
    # a law that reproduces the force proves that both channels are on one clock
    delay = find_delay(log, how=how, clocks=check is None or not check.proves)
    stated = 0.0 if start is None else float(start.axis.actuator.dead_time) / log.sample_time
    late = 0 if closed or start is not None or not delay.clear else max(0, delay.nearest)
    rigid = identify_rigid(log, friction=friction, how=_fixed(how, stated + late), dead_time=delay.dead_time)
    if log.frame is SHAFT:
        doubt = _doubt(log, rigid, remarks)
        rigid = rigid if lead is None else rigid.at_table(lead, gear)
        remarks += [*_about(rigid, late), _SHAFT if lead is None else _NO_LOOP]
        return Identified(log, rigid, delay, None, None, None, None, tuple(remarks), doubt)
    stated_law = Control(law=law, force_limit=log.force_limit) if law is not None and closed else None
    loop = _loop(log, rigid, start, blocks or stated_law, 0 if control is None else control.delay)
    refinement = None
    if loop is not None and closed and not (check is not None and check.disagrees):
        loop, refinement = _refined(log, start, rigid, loop, delay, stated, remarks)
    if start is not None:
        remarks += axis_remarks(start.axis, rigid)
    if loop is not None and refinement is not None and check is None and control is None:
        check = control_law.check_law(
            loop.control, log, apart=_apart(refinement, log.position.size), place=loop.place_of("control")
        )
        refinement = None if check.disagrees else refinement
    if check is not None and check.disagrees:
        remarks.append(_not_alone(check))
    if refinement is None and closed and (start is None or check is not None):  # the inverse dynamics decide
        late = beyond(delay, stated)
    elif refinement is not None:
        late = refinement.delay
    if refinement is not None:
        rigid, refinement = better(log, rigid, refinement, rigid.how, remarks)
    if refinement is not None and (rigid.left > POOR or rigid.changed):
        rigid = with_counts(log, rigid, refinement, rigid.how)
    if refinement is None and loop is not None and start is not None:
        loop = replace(start, axis=with_rigid(start.axis, rigid))
        if is_richer(start.axis):
            loop, _ = _by_friction(log, start, rigid, loop, None, remarks)
        loop = loop.later(late)
    remarks += [*log.hints(), *_counted(log, refinement), *_about(rigid, late), *_unseen_gains(check)]
    seen = friction_map(log.position, log.force, rigid["mass"].value, log.sample_time)
    final = loop if refinement is None else refinement.loop
    doubt = _doubt(log, rigid, remarks)
    return Identified(log, rigid, delay, control, refinement, seen, final, tuple(remarks), doubt, check)


def _law_of(log: MotionLog, motor: np.ndarray | None, remarks: list[str]) -> tuple[ControlFit | None, MotionLog]:
    """Return the law, and the log with the readings it uses: those of the motor encoder if they explain the force."""
    if motor is not None:
        read = replace(log, position=motor)
        found = _attempted(lambda: identify_control(read), [])
        if found is not None and not found.other_readings and not found.near:
            remarks.append("the law reads the encoder of the motor, by which its gains were found")
            return found, read
    return _attempted(lambda: identify_control(log), remarks), log


def _as_blocks(
    log: MotionLog, found: ControlFit, blocks: Control, remarks: list[str]
) -> tuple[Control | None, LawCheck | None]:
    """Return the blocks that reproduce the force of an identified law, and their check; None for both if they do not.

    The law itself has already been validated by its own equations.  The check shows whether the blocks of the library,
    which represent some laws only approximately, produce the same force, with the same gains or with other ones.
    """
    check = _attempted(lambda: control_law.check_law(blocks, log, place=_PLACE), [])
    if check is None or not check.wrong:
        return blocks, check
    if check.proves:
        needed = {gain.name.removeprefix(f"{_PLACE}."): gain.needed for gain in check.gains}
        fitted = tree.vary(blocks, needed)
        again = _attempted(lambda: control_law.check_law(fitted, log, place=_PLACE), [])
        if again is not None and not again.wrong:
            changed = joined(
                ", ",
                (
                    f"{gain.name} = {Quantity(gain.needed, error=gain.error)}"
                    for gain in check.gains
                    if gain.off > control_law.MOST_OFF
                ),
            )
            remarks.append(
                Text(
                    f"the block of the law differs from {found.readings[0].name} as it was found: it makes the force "
                    f"of the log with {changed}, and these values are used"
                )
            )
            return fitted, again
    remarks.append(
        Text(
            f"the blocks make the force of the law that was found, {found.readings[0].name}, only up to "
            f"{Quantity(check.remains, 'share'):3}: the law is not used, and the closed loop was not simulated"
        )
    )
    return None, None


def _checked_law(log: MotionLog, start: Loop | None, law: Law | None) -> LawCheck | None:
    """Check the law against the log; return None without a law and for two encoders, as a log has only one."""
    if start is not None:
        return (
            None
            if start.axis.encoders() == 2
            else control_law.check_law(start.control, log, place=start.place_of("control"))
        )
    return (
        None if law is None else control_law.check_law(Control(law=law, force_limit=log.force_limit), log, place=_PLACE)
    )


def _apart(refinement: Refinement, rows: int) -> np.ndarray:
    """Return the position of the motor minus that of the load in the fitted loop, m."""
    run = refinement.replay.run
    return (run["position_motor"] - run["position_load"])[:rows]


def _refined(
    log: MotionLog, start: Loop | None, rigid: RigidFit, loop: Loop, delay: DelayFit, stated: float, remarks: list[str]
) -> tuple[Loop, Refinement | None]:
    """Return the loop and output-error fit, with the friction model of the machine file unless plain friction is
    better.
    """
    fit = _attempted(lambda: refine(loop, log, refined_names(loop)), remarks)
    if fit is None:
        return loop, None
    if start is not None and is_richer(start.axis):
        loop, fit = _by_friction(log, start, rigid, loop, fit, remarks)
    # without strong instruments the force of a closed loop shifts the delay of the inverse dynamics by its own lag
    if fit is None or (log.set_position is not None and not rigid.instruments):
        return loop, fit
    return loop, agreed(log, loop, fit, delay, stated, remarks)


def _not_alone(check: LawCheck) -> str:
    """Return a remark that the logged force is not the command of the stated law alone."""
    if check.added:
        return Text(
            f"a force was added to the command of the law in {Quantity(check.added, 'share'):3} of the log (RMS "
            f"{Quantity(check.left, 'share'):3} of all): the closed loop cannot be simulated without it, and mass, "
            "friction and dead time are those of the inverse dynamics, which need only the force that acted"
        )
    return "the closed loop was not simulated: its law is not that of the log; the inverse dynamics do without it"


def _counted(log: MotionLog, refinement: Refinement | None) -> list[str]:
    if refinement is None or not refinement.count:
        return []
    return [
        Text(
            f"readings stand on counts of {log.distance(refinement.count, 3)}: the output error was fitted to the mean "
            "of runs with such counts, without the rows at rest, and its errors hold what the counts do"
        )
    ]


def _unseen_gains(check: LawCheck | None) -> list[str]:
    """Return a remark on gains of the law that the log cannot verify."""
    if check is None or check.disagrees or not check.unseen:
        return []
    return [
        Text(
            f"the log does not tell {', '.join(check.unseen)} to {Quantity(control_law.MOST_OFF, 'share'):6}: with "
            "another value the law would leave as little of its force"
        )
    ]


def _doubt(log: MotionLog, rigid: RigidFit, remarks: list[str]) -> str:
    """Return the reason why the magnitudes are implausible for a feed drive, or ""; add a remark with a remedy."""
    magnitudes = sizes(log.frame, log.sample_time, log.position, log.force, rigid["mass"].value)
    wrong = outside(log.frame, magnitudes)
    if not wrong:
        return ""
    why = Text(f"{log.name}: {out_of_range(wrong, magnitudes)}")
    remarks.append(Text(f"{why}: {remedy(wrong)}"))
    return why


def swapped(channels: Mapping[str, Any]) -> bool:
    """Return True if position and force seem to be swapped: after exchanging them, a rigid drive fits the log."""
    both: dict[str, Any] = {**channels, "position": channels["force"], "force": channels["position"]}
    both |= {"set_position": None, "force_limit": None}
    try:
        return identify_rigid(MotionLog(**both), friction="symmetric").left < POOR
    # a fit that fails is no evidence for an interchange
    except FeeddriveError:
        return False


def _by_friction(
    log: MotionLog, start: Loop, rigid: RigidFit, loop: Loop, plain: Refinement | None, remarks: list[str]
) -> tuple[Loop, Refinement | None]:
    """Return the loop and fit with the friction model of the machine file, or with plain friction if clearly better."""
    kind, other = start.axis.friction_load, loop.axis.friction_load
    assert kind is not None
    assert other is not None
    richer = replace(start, axis=with_rigid(start.axis, rigid, richer=True))
    if plain is None:
        remarks.append(
            f"friction stays {kind.kind} with the levels that were found: near standstill, where it differs from "
            f"{other.kind}, a log without closed loop contains no information; runs at constant speeds do"
        )
        return richer, None
    kept = _attempted(lambda: refine(richer, log, refined_names(richer)), remarks)
    if kept is None:
        remarks.append(f"friction is {other.kind} now, and no longer {kind.kind}: with that the fit failed")
        return loop, plain
    left, without = (fit.replay.rms("position_load") for fit in (kept, plain))
    if left <= _CLEARLY * without:
        remarks.append(
            Text(
                f"friction stays {kind.kind}, with new levels: in closed loop it leaves {log.distance(left)} RMS of "
                f"the position, {other.kind} {log.distance(without)}; what it does near standstill was not fitted"
            )
        )
        return richer, kept
    remarks.append(
        Text(
            f"friction is {other.kind} now, and no longer {kind.kind}: in closed loop it leaves "
            f"{log.distance(without)} RMS of the position, {kind.kind} {log.distance(left)}; runs at constant speeds "
            "show a Stribeck curve (fit_friction)"
        )
    )
    return loop, plain


_SHAFT = "the log is that of a shaft and no lead is given: the result stays in N m and rad"
_NO_LOOP = "the log is that of a shaft: closed loop and friction over the travel need positions of the table"


def _fixed(how: Preparation | None, dead_time: float) -> Preparation | None:
    """Return the caller's preparation with a dead time in samples added; None if there is none: it is then fitted."""
    return None if how is None else replace(how, delay=how.delay + dead_time)


def _about(rigid: RigidFit, late: int) -> list[str]:
    """Return remarks on the validity of the standard errors and the model."""
    remarks: list[str] = []
    pulses = rigid.left_out.get("pulse", 0)
    if pulses:
        remarks.append(
            Text(
                f"a force that the model does not hold acts for short times: {pulses} rows, "
                f"{Quantity(pulses / (pulses + rigid.residuals.values.size), 'share'):2} of those in motion, are left "
                "out; name its column if it was recorded"
            )
        )
    if rigid.periods:
        names = joined(
            " and ",
            (
                "a force proportional to the position"
                if math.isinf(p)
                else Text(f"one that repeats every {Quantity(p, rigid.frame.position):3}")
                for p in rigid.periods
            ),
        )
        remarks.append(Text(f"the log gives evidence of a force along the travel: {names}; it is part of the model"))
    if frequency := rigid.bends_at:
        mode = "a resonance at" if rigid["bend"].value > 0.0 else "an antiresonance below"
        remarks.append(
            Text(
                "the axis bends: its force follows the fourth derivative of the position, too, as that of two masses "
                f"on a spring with {mode} {frequency}; this is part of the fit, so that the mass is not taken for "
                "less, and no part of the machine file, so that a tuning does not know the mode: measure a frequency "
                "response before (feeddrive excite, frf)"
            )
        )
    if rigid.slowest:
        remarks.append(
            Text(
                f"below {Quantity(rigid.slowest, 'share'):2} of the largest speed friction is not Coulomb plus viscous "
                "friction, and these rows are left out: the levels are those of faster motion; runs at constant speeds "
                "show the rest (feeddrive friction)"
            )
        )
    if late:
        remarks.append(f"the force acts {late} samples later than stated; that is taken into account")
    if not rigid.residuals.white:
        ratio = max(estimate.error / estimate.ols for estimate in rigid.estimates)
        remarks.append(
            Text(
                f"the residual is correlated from row to row ({Quantity(rigid.residuals.autocorrelation(1)):.2f} at "
                f"lag 1): the errors account for it and are up to {Quantity(ratio):2} times those for a white residual "
                "(ols)"
            )
        )
    return remarks


def _attempted(what: Any, remarks: list[str]) -> Any:
    """Return the result of a step, or None with a remark if the step fails."""
    try:
        return what()
    except FeeddriveError as error:
        remarks.append(Text(f"{error}"))
        return None


def _loop(log: MotionLog, rigid: RigidFit, start: Loop | None, control: Control | None, late: int) -> Loop | None:
    """Return the loop of the log with the identified values, or None for an unknown law or in shaft units.

    late  samples between the reading used by the law and its command; with a stated law the output-error fit finds
          the dead time
    """
    if rigid.frame is SHAFT:
        return None
    if start is not None:
        return replace(start, axis=with_rigid(start.axis, rigid))
    if control is None:
        return None
    T = log.sample_time
    axis = with_rigid(Axis(plant=rigid.plant(), rotary=log.turning), rigid)
    delayed = replace(axis, actuator=replace(axis.actuator, dead_time=late * T))
    return Loop(control=control, axis=delayed, sample_time=T)
