"""Starting values for every law that can control an axis, and the reason for each law that cannot.

The laws are those of the catalogue. Each law computes its own starting values (`Law.begin`), and each additional block
declares the laws with which it can be combined (`goes_beside`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

from feeddrive.analysis.stiffness import reading_deviation
from feeddrive.blocks.axis_model import AxisModel, Start
from feeddrive.blocks.catalogue import find, members
from feeddrive.blocks.compensation.mode_compensation import ModeCompensation
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Compensation, Feedforward, Law, Prefilter, Reference
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.friction_stops import FrictionStops
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.language import matrix, tree
from feeddrive.language.errors import FeeddriveError, ParameterError, nearest
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.learning.iterative_feedforward import begin_compensation
from feeddrive.learning.stops import learn_stops
from feeddrive.learning.trajectory_prefilter import tune_prefilter
from feeddrive.learning.trials import iterate_trials
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

PLAIN = CascadePPI.title  # the reference law of the comparison
LIKELIEST = (
    "P-PI as the reference, and the three laws with the least rope-snap error in the benchmark on axes with as many "
    "encoders, of those that can control this axis"
)
"""The rule by which `likeliest` chooses."""
# laws by their rope-snap error at equal robustness, the least first, by the number of encoders: the tables of
# docs/benchmark.md, with which a test compares them
STANDING = {
    1: (
        "P-PI + GPI recovery",
        "P-PI + Kalman recovery",
        "GPI, 1 Taylor state",
        "LQG",
        "GPI, 3 Taylor states",
        "P-PI + recovery",
        "super-twisting",
        "P-PI + DOB",
        "P-P + DOB",
    ),
    2: (
        "pole placement",
        "P-PI + GPI recovery",
        "P-PI + Kalman recovery",
        "GPI, 1 Taylor state",
        "P-PI + recovery",
        "GPI, 3 Taylor states",
        "super-twisting",
        "P-PI + DOB",
        "P-P + DOB",
    ),
}
_LIKELY = 4  # laws that are compared first
_MOTION = ("acceleration", "velocity")
ON_THE_MACHINE = ("trials", "stops")  # steps after the tuning in which a law learns from motions of its machine
_TRIALS = 6  # number of trials in which a compensator learns


@dataclass(frozen=True)
class Candidate:
    """A controller that can be tuned for an axis.

    like       the candidate whose tuned gains it adopts, if both have the same feedback loop
    then       the step after tuning: "prefilter" (fit the prefilter to the move), "trials" (let the compensator learn
               in repeated trials of the move) or "stops" (learn the stops from a simulated slow oscillation)
    remark     the axis model used for the candidate, and the changes to the present controller
    """

    name: str
    loop: Loop
    remark: str = ""
    like: str = ""
    then: str = ""

    def tuned(self, control: Control) -> Self:
        """Return the candidate with tuned gains.

        `control` is the tuned controller of this candidate, or of the candidate `like` if that is set.
        """
        if self.like:
            # filters are tuned with the law, and its gains hold with these alone
            control = replace(self.loop.control, law=control.law, filters=control.filters)
        return replace(self, loop=replace(self.loop, control=control))

    def adapted(self, move: Reference, seed: int) -> Loop:
        """Return the loop after the step `then`, in which the controller is fitted to a move or learns from motion."""
        if self.then == "trials":
            return iterate_trials(self.loop, move, _TRIALS, seed=seed).loop
        if self.then == "stops":
            return learn_stops(self.loop, seed=seed)[0]
        if self.then == "prefilter":
            fitted = tune_prefilter(self.loop, move, seed=seed)[-1].prefilter
            return replace(self.loop, control=replace(self.loop.control, prefilter=fitted))
        return self.loop


@dataclass(frozen=True)
class Refusal:
    """A law, or its combination with another block, that is refused for an axis, and the reason."""

    name: str
    reason: str


def axis_model(loop: Loop) -> AxisModel:
    """Return the axis model from which every law computes its start values."""
    axis = loop.axis
    mechanics = axis.mechanics()
    along = mechanics.rigid_motion()
    mass, viscous = (
        float(matrix.dot([matrix.dot(row, along) for row in rows], along))
        for rows in (mechanics.mass, mechanics.damping)
    )
    return AxisModel(
        mass=mass,
        viscous=viscous,
        delay=float(axis.actuator.delay()),
        sample_time=float(loop.sample_time),
        encoders=axis.encoders(),
        velocity_encoder=str(getattr(loop.control.law, "velocity_encoder", "motor")),
        plant=axis.plant,
        frictions=tuple(friction for friction in (axis.friction_motor, axis.friction_load) if friction is not None),
        reading_noise=_reading_noise(loop),
        machine_modes=tuple(
            mode for block in loop.control.compensation if isinstance(block, ModeCompensation) for mode in block.modes
        ),
    )


def _reading_noise(loop: Loop) -> float:
    """Return the standard deviation, m, of the reading from which the velocity is computed: quantization and noise."""
    motor, load = loop.axis.encoder_motor, loop.axis.encoder_load
    first, other = (motor, load) if getattr(loop.control.law, "velocity_encoder", "motor") == "motor" else (load, motor)
    return reading_deviation(other if first is None else first)


def candidates(loop: Loop, own: Sequence[type[Law]] = ()) -> tuple[tuple[Candidate, ...], tuple[Refusal, ...]]:
    """Return the candidates for the axis of a loop, P-PI first, and the refused laws with the reasons.

    Every law of the catalogue and every user-defined law is tried. Filters, limit, guard, friction feedforward and
    velocity encoder are those of the present controller. Each law has acceleration and velocity feedforward: its own,
    that of the present controller, or one computed from the mass and the viscous friction of the axis. Every law also
    receives this mass and friction as its axis model.
    """
    axis = axis_model(loop)
    offered: list[Candidate] = []
    refused: list[Refusal] = []
    # the reference law first: all others are compared with it
    shipped = sorted(members(Law).values(), key=lambda law: law is not CascadePPI)
    for law in (*shipped, *(law for law in own if law not in shipped)):
        try:
            starts = law.begin(axis, loop.control.law)
            bases = [Candidate(start.name, _with_law(loop, axis, start), start.remark) for start in starts]
        # the report lists combinations of a refused law as well, with the reason of the law
        except FeeddriveError as error:
            name = _title(law)
            refused += [
                Refusal(title, str(error)) for title in (name, *(f"{name} + {b.title}" for b in _companions(law)))
            ]
            continue
        offered += [base for base, start in zip(bases, starts, strict=True) if not start.only_with]
        for base, start in zip(bases, starts, strict=True):
            wanted = {f"{base.name} + {form}" for form in start.only_with}
            for combined in (combined for block in _companions(law) for combined in _beside(base, block, axis)):
                if not wanted or combined.name in wanted:
                    (offered if isinstance(combined, Candidate) else refused).append(combined)  # type: ignore[arg-type]
    return tuple(offered), tuple(refused)


def likeliest(loop: Loop, possible: Sequence[Candidate]) -> tuple[str, ...]:
    """Return the names of the laws to compare first on the axis of a loop, by the rule `LIKELIEST`."""
    known = {law.name for law in possible}
    return tuple(name for name in (PLAIN, *STANDING[loop.axis.encoders()]) if name in known)[:_LIKELY]


def names_of(law: str | type[Law], possible: Sequence[Candidate], refused: Sequence[Refusal]) -> list[str]:
    """Return the names of the rows of a law; a kind or class selects all forms of the law without additional blocks.

    Raises ParameterError for an unknown law, suggesting similar names.
    """
    names = list(dict.fromkeys(row.name for row in (*possible, *refused)))
    if law in names:
        return [str(law)]
    kinds = members(Law)
    kind = kinds.get(law) if isinstance(law, str) else law
    if kind is None:
        raise ParameterError(f"law '{law}' is not known here{nearest(str(law), [*names, *kinds])}")
    forms = [row.name for row in possible if type(row.loop.control.law) is kind]
    chosen = [name for name in forms if " + " not in name] or forms
    chosen += {_title(kind)}.intersection(row.name for row in refused)
    if not chosen:
        raise _without_starts(kind.kind)
    return list(dict.fromkeys(chosen))


def _title(law: type[Law]) -> str:
    return law.title or law.kind.replace("_", " ")


def _without_starts(kind: str) -> ParameterError:
    return ParameterError(
        f"the law {kind} has no start values for its tuning: put it with its parameters into the machine file"
    )


def control_with(loop: Loop, law: str) -> Control:
    """Return the controller of a loop with its law replaced by another one, at the start values for tuning.

    `law` is a kind, such as lqg, of which the first form is used, or the name of a law as in a comparison, such as
    "P-PI + DOB" or "GPI, 1 Taylor state".

    Raises ParameterError with the reason if the law is unknown, cannot control the axis, or has the gains of another
    law.
    """
    if law not in members(Law):
        return _control_named(loop, law)
    axis, kind = axis_model(loop), find(Law, law)
    try:
        starts = kind.begin(axis, loop.control.law)
    except FeeddriveError as error:
        raise ParameterError(f"the law {law} cannot control this axis: {error}") from None
    if not starts:
        raise _without_starts(law)
    return _with_law(loop, axis, starts[0]).control


def _control_named(loop: Loop, name: str) -> Control:
    """Return the start values of the law with this name in a comparison."""
    possible, refused = candidates(loop)
    reasons = {refusal.name: refusal.reason for refusal in refused}
    offered = {candidate.name: candidate for candidate in possible}
    if name in reasons:
        raise ParameterError(f"'{name}' cannot control this axis: {reasons[name]}")
    if name not in offered:
        # a name with a companion can only be one of a comparison; for all others `find` knows renamed and private kinds
        if " + " not in name:
            find(Law, name)
        raise ParameterError(f"law '{name}' is not known here{nearest(name, [*offered, *reasons])}")
    candidate = offered[name]
    if candidate.like:
        raise ParameterError(
            f"'{name}' has the gains of '{candidate.like}' and nothing else to tune: tune that law; "
            f'feeddrive compare --take "{name}" writes the machine file with both'
        )
    return candidate.loop.control


def _companions(law: type[Law]) -> tuple[type[Feedforward] | type[Compensation] | type[Prefilter], ...]:
    """Return the classes of blocks that can be combined with a law, in the order of the report."""
    blocks = (*members(Feedforward).values(), *members(Compensation).values(), *members(Prefilter).values())
    return tuple(block for block in blocks if block.goes_beside(law))


def _with_law(loop: Loop, axis: AxisModel, start: Start) -> Loop:
    """Return a loop with another law and its feedforward.

    Filters and friction feedforward remain, except the terms that the law itself feeds forward; compensations and
    prefilter are removed.
    """
    law, motion = start.law, start.feedforward
    taken = {*law.fed()} if motion is None else {*law.fed(), *_MOTION}
    blocks = [kept for block in loop.control.feedforward if (kept := _without(block, taken)) is not None]
    if motion is None and not {*law.fed(), *(term for block in blocks for term in block.fed())} & {*_MOTION}:
        motion = Inertia(mass=axis.mass, viscous=axis.viscous)
    if motion is not None:
        blocks.append(motion)
    # the prefilter was fitted to the loop of the law that is replaced; `_beside` offers prefilters and compensations
    control = replace(loop.control, law=law, feedforward=tuple(blocks), prefilter=None, compensation=())
    return replace(loop, control=control)


def _beside(
    base: Candidate, block: type[Feedforward] | type[Compensation] | type[Prefilter], axis: AxisModel
) -> Iterator[Candidate | Refusal]:
    """Yield a candidate for each form of `base` with one additional block, or a refusal with the reason."""
    control, name = base.loop.control, f"{base.name} + {block.title}"
    try:
        if issubclass(block, Prefilter):
            # outside the loop, so that the gains of the base apply (`like`)
            loop = replace(base.loop, control=replace(control, prefilter=block()))
            yield replace(base, name=name, loop=loop, like=base.name, then="prefilter")
        elif issubclass(block, Feedforward):
            feedforward = block.begin(axis)
            kept = [
                other
                for other in (_without(old, {*feedforward.fed()}) for old in control.feedforward)
                if other is not None
            ]
            loop = replace(base.loop, control=replace(control, feedforward=(*kept, feedforward)))
            if isinstance(feedforward, FrictionStops):
                remark = "stops learned from 4 s of slow swings with its own gains"
                yield replace(base, name=name, loop=loop, like=base.name, then="stops", remark=remark)
                return
            leaves = [
                (key, Quantity(value, tree.declaration(feedforward, key).unit))
                for key, value in tree.leaves(feedforward)
            ]
            shown = joined(", ", [f"{key.replace('_', ' ')} {quantity:SI}" for key, quantity in leaves])
            remark = Text(f"feedforward of the axis's own: {shown}")
            yield replace(base, name=name, loop=loop, like=base.name, remark=remark)
            if block.learned:
                name, remark = (
                    f"{base.name} + {block.learned}",
                    "mass and friction learned in trials",
                )
                yield replace(
                    base,
                    name=name,
                    loop=_learning(base.loop, feedforward),
                    like=base.name,
                    then="trials",
                    remark=remark,
                )
        else:
            yield from _compensated(base, block, axis)
    except FeeddriveError as error:
        yield Refusal(name, str(error))


def _learning(loop: Loop, feedforward: Feedforward) -> Loop:
    """Return the loop with a learning compensator.

    The compensator has a basis function for Stribeck friction if `feedforward` has one. Otherwise the estimated mass
    would absorb part of the breakaway friction, since both act at the start of an acceleration, and this part differs
    from trial to trial.
    """
    if not isinstance(feedforward, DisturbanceCompensator) or feedforward.stribeck is None:
        return begin_compensation(loop)
    return begin_compensation(begin_compensation(loop), ["stribeck"], stribeck_velocity=feedforward.stribeck_velocity)


def _compensated(base: Candidate, block: type[Compensation], axis: AxisModel) -> Iterator[Candidate | Refusal]:
    for form in block.begin(axis):
        name = f"{base.name} + {form.name}"
        if form.block is None:
            yield Refusal(name, form.remark)
            continue
        loop = replace(base.loop, control=replace(base.loop.control, compensation=(form.block,)))
        model = f"{form.name} {axis.sentence()}"
        remark = joined("; ", filter(None, (base.remark, model, form.remark)))
        yield replace(base, name=name, loop=loop, remark=remark, like="" if form.tuned else base.name)


def _without(block: Feedforward, taken: set[str]) -> Feedforward | None:
    """Return a feedforward block without the terms `taken` by other blocks; None if no term remains."""
    fed = set(block.fed())
    if not fed & taken:
        return block
    if isinstance(block, DisturbanceCompensator) and "friction" in fed - taken:
        return replace(block, mass=None, viscous=None, jerk_feedforward=None, snap_feedforward=None)
    return None
