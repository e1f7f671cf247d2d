"""The laws of three papers on a measured axis: identified from one half of the EMPS log, judged over its covariance.

The other half of the log is predicted under the law that ran.  Nothing was measured under the laws that are designed
here: their figures are those of simulated plants, whose spread is that of the identification.

Source of the log: Janot, Gautier, Brunot, Data Set and Reference Models of EMPS, 2019.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from feeddrive import plot
from feeddrive.analysis.replay import Replay, estimate_start, observe, replay
from feeddrive.analysis.stability import stability
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.figures.of_loops import LinearLoop
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.identification.motion.identify import Identified, identify_motion
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language import tree
from feeddrive.language.errors import LogError, NotIdentifiableError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Table
from feeddrive.language.text import Text
from feeddrive.learning.iterative_feedforward import Iteration, begin_compensation, compensated, next_iteration
from feeddrive.learning.trajectory_prefilter import PrefilterFit, fit_prefilter_to_log, tune_prefilter
from feeddrive.learning.trial import measured_trial
from feeddrive.loop.box import Box
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, root_mean_square, simulate
from feeddrive.papers.claims import KEPT, LESS, Claim, Experiment, kept, stated
from feeddrive.papers.covariance_box import DRAWS, Uncertain
from feeddrive.report.report import Picture
from feeddrive.tuning.candidates import control_with
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.tune import tune_control

SKIPPED = 49  # samples at the start of a half, as the bundled job has it: the state of the real loop is not known there
LIMITS = Limits(sensitivity_peak=2.0, delay_margin_samples=2.0)
RECOVERED = 50.0  # Hz, filter of the recovered force: a count of 50 nm at 1 kHz makes 3 N of noise without one
FORWARD = 0.05  # m/s at which loops are linearized, both ways: viscous friction differs by direction
RAN, CASCADE, DADSC = "the law that ran", "P-PI, tuned", "DADSC, tuned (paper 1)"
INVERSE, PREFILTERED = "rigid inverse (paper 2)", "rigid inverse and prefilter (paper 2)"
FITTED = "prefilter of the measured errors (paper 2)"
REGRESSORS = ("velocity", "acceleration")  # jerk and snap of the log are those of steps of acceleration
LEARNED = "learned feedforward (paper 4)"
UNMEASURED = "simulated on the identified axis: nothing was measured under this law"


@dataclass(frozen=True)
class Half:
    """One half of the log: set position, position (m) and force (N), each of shape (n,).

    reference  set positions with central differences as derivatives, which use the rows beside the half
    """

    name: str
    set_position: np.ndarray
    position: np.ndarray
    force: np.ndarray
    reference: Recorded
    sample_time: float

    @property
    def signals(self) -> dict[str, np.ndarray]:
        """The channels under the names of the loop's signals."""
        return {"set_position": self.set_position, "position_load": self.position, "force": self.force}

    @property
    def time(self) -> np.ndarray:
        """The time from the start of the half, s."""
        return self.sample_time * np.arange(self.position.size)


def halves(log: str | Path, loop: Loop) -> tuple[Half, Half]:
    """Return both halves of the EMPS log.

    Raises LogError for a log with another sample time than the machine's.
    """
    section = read_job("emps_log", log).log
    assert section is not None
    channels, motor = section.read(), loop.axis.actuator.motor
    assert motor is not None
    T = float(loop.sample_time)
    # at a difference of 1e-4 the clocks drift apart by a sample in ten thousand
    if abs(channels.sample_time / T - 1.0) > 1e-4:
        raise LogError(
            f"{channels.name}: one sample takes {Quantity(channels.sample_time, 's'):6 SI}, and the control of EMPS "
            f"runs every {Quantity(T, 's'):6 SI}: give the published log, DATA_EMPS.mat"
        )
    wanted, position = channels["setpoint_position"], channels["position_load"]
    force = float(motor.force_per_unit()) * channels["command"]
    middle = position.size // 2

    def half(name: str, first: int, last: int) -> Half:
        rows, around = slice(first, last), wanted[first - 1 : last + 1]
        reference = Recorded(
            position=wanted[rows],
            velocity=(around[2:] - around[:-2]) / (2.0 * T),
            acceleration=np.diff(around, 2) / T**2,
            sample_time=T,
        )
        return Half(name, wanted[rows], position[rows], force[rows], reference, T)

    return half("first half", 1, middle), half("second half", middle, position.size - 1)


@dataclass(frozen=True)
class Judged:
    """A law on the identified axis and over the box.

    peaks      Ms at the model, and the largest over the box
    slowest    largest absolute value of a pole over the box
    stiff      stiffness of the axis at 10 Hz, N/m, at the model
    follows    RMS of the tracking error along the second half, m, at the model, and the largest over the corners
    """

    name: str
    loop: Loop
    peaks: tuple[float, float]
    slowest: float
    stiff: float
    follows: tuple[float, float]

    def row(self) -> list[str | Quantity]:
        """Return the row of the table."""
        model, worst = (Quantity(peak, form=".2f") for peak in self.peaks)
        return [
            self.name,
            model,
            worst,
            Quantity(self.slowest, form=".4f"),
            Quantity(self.stiff, "N/m", form="3 N/um"),
            *(Quantity(error, "m", form="3 um") for error in self.follows),
        ]


COLUMNS = (
    "law",
    "Ms",
    "worst Ms",
    "largest pole",
    "stiffness at 10 Hz",
    "tracking RMS",
    "worst tracking RMS",
)


def follow(loop: Loop, half: Half, name: str) -> Run:
    """Simulate the set positions of a half, from the position and velocity at which it starts."""
    start = estimate_start(half.position, half.sample_time)
    return simulate(loop, half.reference, start=start, name=name, record=("tracking_error", "following_error", "force"))


def tracking(run: Run) -> float:
    """Return the RMS of the tracking error in m, without the start."""
    return root_mean_square(run["tracking_error"][SKIPPED:])


def judged(name: str, law: Loop, box: Uncertain, half: Half) -> Judged:
    """Judge a law at the model, at the corners of the box and within it."""
    peaks, poles, errors = list[float](), list[float](), list[float]()
    for place, late in box.places():
        loop = box.loop(law, place, late)
        for velocity in (FORWARD, -FORWARD):
            growth = stability(loop, velocity=velocity).growth
            poles.append(growth)
            peaks.append(LinearLoop(loop, velocity).margins.sensitivity_peak or math.inf if growth < 1.0 else math.inf)
        # the error of a run is largest at an end of the box: draws within it are left out
        if set(map(abs, place)) <= {1.0} or not any(place):
            errors.append(tracking(follow(loop, half, name)))
    return Judged(
        name,
        law,
        (peaks[0], max(peaks)),
        max(poles),
        LinearLoop(law).stiffness_at(10.0),
        (errors[0], max(errors)),
    )


def designs(model: Loop, box: Uncertain, half: Half) -> dict[str, Loop]:
    """Return the laws by name: the one that ran, a tuned cascade, and those of papers 1, 2 and 4."""
    laws = {RAN: model}
    for name, kind in ((CASCADE, "cascade_ppi"), (DADSC, "dadsc")):
        # the box of a tuning has no tolerance of friction, which hardly moves a margin: `judged` varies it
        tolerances = Box(stiffness=0.0, mass=box.mass_share, dead_time=1)
        begun = control_with(model, kind)
        if isinstance(begun.law, CascadePPI):
            # as DADSC has it: the law that ran differences the position over two samples
            begun = replace(begun, law=replace(begun.law, velocity_samples=1))
        tuned = tune_control(begun, [model], limits=LIMITS, filters="kept", box=tolerances)
        laws[name] = replace(model, control=tuned.control)
    friction = model.axis.friction_load
    assert isinstance(friction, Directional)
    viscous = 0.5 * (float(friction.viscous_positive) + float(friction.viscous_negative))
    inverse = Inertia(mass=float(tree.get(model.axis, "plant.mass")), viscous=viscous)
    law = tree.vary(model.control.law, {"velocity_feedforward": 1.0})
    laws[INVERSE] = replace(model, control=replace(model.control, law=law, feedforward=(inverse,)))
    fit = tune_prefilter(laws[INVERSE], half.reference, runs=1, regressors=REGRESSORS)[-1]
    laws[PREFILTERED] = replace(laws[INVERSE], control=replace(laws[INVERSE].control, prefilter=fit.prefilter))
    return laws


@dataclass(frozen=True)
class Taught:
    """What the measured errors of a half teach, without the identified axis: a prefilter, and a feedforward.

    Both hold for the law that ran.
    """

    prefilter: PrefilterFit
    feedforward: Iteration


def taught(ran: Loop, model: Loop, half: Half) -> Taught:
    """Fit the prefilter of paper 2 and the feedforward of paper 4 to the measured errors of a half.

    The feedforward's step takes the loop's response Ĝ_d from the identified axis (`axis_model`).
    """
    fit = fit_prefilter_to_log(
        half.time,
        half.set_position,
        half.position,
        half.sample_time,
        regressors=REGRESSORS,
        control=ran,
        force=half.force,
        name=half.name,
    )
    begun = begin_compensation(model)
    trial = measured_trial(
        begun, half.set_position, half.position, sample_time=half.sample_time, force=half.force, name=half.name
    )
    return Taught(fit, next_iteration(begun, trial, form="axis_model", skip=SKIPPED, at_rest="held"))


def identified(ran: Loop, half: Half) -> tuple[Identified, Uncertain]:
    """Identify the axis from a half under the law that ran; return it with the box of its covariance."""
    limit = ran.control.force_limit
    log = MotionLog(
        name=f"EMPS, {half.name}",
        position=half.position,
        force=half.force,
        sample_time=half.sample_time,
        set_position=half.set_position,
        force_limit=None if limit is None else float(limit),
    )
    found = identify_motion(log, ran)
    if found.loop is None or found.refinement is None:
        raise NotIdentifiableError(f"{log.name}: {found.recommendation}")
    # the error of the mass holds the difference of both fits too, which none of them alone shows
    estimates = tuple(
        replace(estimate, error=found.mass.error) if estimate.name.endswith("plant.mass") else estimate
        for estimate in found.refinement.estimates
    )
    return found, Uncertain(found.loop, estimates)


def recovered(model: Loop, half: Half) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the disturbance recovered from a measured half, the friction of the model, N, and the rows that count.

    The friction is that of the set velocity, delayed by the lag of the estimate; rows count from a sixth of the largest
    speed on, since friction near standstill is another one.
    """
    friction, T = model.axis.friction_load, half.sample_time
    assert isinstance(friction, Directional)
    observer = DisturbanceRecovery(mass=float(tree.get(model.axis, "plant.mass")), frequency=RECOVERED)
    start = estimate_start(half.position, T)
    seen = observe(observer, half.position, half.force, T, velocity=start[1])
    velocity = np.asarray(half.reference.velocity)
    expected = -np.asarray([float(friction.steady(v)) for v in velocity])
    expected = np.roll(expected, round(seen.lag / T))
    fast = np.abs(velocity) > np.max(np.abs(velocity)) / 6.0
    # the filter settles within these rows, and the roll brings the end of the half to its start
    fast[: 4 * SKIPPED] = False
    return np.asarray(seen.disturbance), expected, fast


def emps(log: str | Path, progress: Progress) -> Experiment:
    """Identify the axis from half of the EMPS log, predict the other half, and judge the laws of papers 1, 2 and 4.

    Raises LogError for another log, NotIdentifiableError if the first half does not give a model.
    """
    ran = read_machine("emps").loop("x")
    progress.step("reading the log")
    first, second = halves(log, ran)
    progress.step("identification from the first half")
    found, box = identified(ran, first)
    model = box.model
    progress.step("prediction of the second half")
    predicted, published = (replay(loop, second.signals, skip=SKIPPED) for loop in (model, ran))
    lessons = taught(ran, model, first)
    progress.step("laws")
    laws = designs(model, box, first)
    laws[FITTED] = replace(model, control=replace(model.control, prefilter=lessons.prefilter.prefilter))
    laws[LEARNED] = compensated(begin_compensation(model), lessons.feedforward.after)
    rows: dict[str, Judged] = {}
    for name, law in laws.items():
        progress.step(f"box: {name}")
        rows[name] = judged(name, law, box, second)
    shown = {name: follow(laws[name], second, name) for name in (DADSC, PREFILTERED, LEARNED)}
    return Experiment(
        name="emps",
        title="Three papers on a measured axis",
        citation="Log: Janot, Gautier, Brunot, Data Set and Reference Models of EMPS, Workshop on Nonlinear System "
        "Identification Benchmarks, 2019",
        claims=(
            *_measured_claims(found, model, predicted, published, second),
            *_paper_1(rows),
            *_paper_2(model, lessons, rows),
            *_paper_4(model, box, lessons, rows),
        ),
        tables=(
            box.table(ran, "the axis by the first half"),
            Table("The laws on the identified axis, and over the box", COLUMNS, [row.row() for row in rows.values()]),
        ),
        pictures=_pictures(predicted, shown),
        facts={
            "log": f"{Path(log).name}; {first.position.size} rows identify, {second.position.size} are predicted",
            "box": Text(
                f"± {Quantity(box.factor):3} errors of mass and friction (95 % ellipsoid), 0 or 1 more sample of dead "
                f"time; {2 ** (len(box.estimates) + 1)} corners and {DRAWS} draws, seed 0"
            ),
            "bounds of the designs": LIMITS.sentence(),
            "path": "the second half's own set positions, from the position and velocity at which it starts",
        },
        notes=NOTES,
    )


NOTES = (
    "Nothing was measured under the laws of this table, except under the law that ran: their figures are simulated on "
    "the identified axis and on the plants of its box.",
    "The box has what one log tells. The axis was measured twice, and the other log gave a mass that differs by 1.2 %, "
    "within the box.",
    "EMPS has one encoder: pole placement, the feedback law of paper 2, needs two and is refused. What that paper has "
    "for one encoder is the inverse dynamics and the trajectory prefilter.",
    "The set positions of the log have steps of acceleration: the prefilter takes velocity and acceleration only.",
)


def _measured_claims(
    found: Identified, model: Loop, predicted: Replay, published: Replay, half: Half
) -> Iterator[Claim]:
    mass = found.mass
    yield Claim(
        "5.a",
        "The mass of the first half is the published one: difference over its error",
        "closed-loop fit of the first half under the law that ran; the error holds half of what both fits differ by",
        abs(mass.value - 95.154) / mass.error,
        most=1.96,
        expected="95.154 kg, inverse dynamics of the whole log; within the 95 % of a normal error",
        one_sided=LESS,
    )
    rule = f"the law that ran, {predicted.residual('force').size} samples of the second half after {SKIPPED}"
    yield Claim(
        "5.b",
        "The measured position of the second half is predicted: RMS of what is left",
        rule,
        1e6 * predicted.rms("position_load"),
        least=1.1,
        most=1.4,
        unit="µm",
        expected="1.23 µm, published parameters on the whole log",
    )
    yield Claim(
        "5.c",
        "It is predicted as well as by the published parameters, which saw this half too: ratio of the RMS",
        rule,
        predicted.rms("position_load") / published.rms("position_load"),
        least=0.97,
        most=1.03,
    )
    yield Claim(
        "5.d",
        "The force of the second half is predicted: RMS of what is left over that of the force",
        rule,
        100.0 * predicted.share("force"),
        least=3.4,
        most=4.2,
        unit="%",
        expected="3.8 %, published parameters on this half",
    )
    force, friction, counted = recovered(model, half)
    left = root_mean_square((force - friction)[counted])
    yield Claim(
        "5.e",
        "Recovery (paper 1) on the measured second half finds the friction of the first: RMS of the difference",
        Text(
            f"Butterworth {Quantity(RECOVERED, 'Hz'):6}, above a sixth of the largest speed; recovered: "
            f"{Quantity(root_mean_square(force[counted]), 'N'):3} RMS"
        ),
        left,
        most=predicted.rms("force"),
        unit="N",
        expected="at most what the prediction leaves of the force",
        one_sided=LESS,
    )


def _paper_1(rows: Mapping[str, Judged]) -> Iterator[Claim]:
    law, cascade = rows[DADSC], rows[CASCADE]
    rule = f"{LIMITS.sentence()} over the box for both, velocity over one sample; {UNMEASURED}"
    yield Claim(
        "5.f",
        "DADSC keeps Ms <= 2 over the box, and uses it",
        rule,
        law.peaks[1],
        least=1.9,
        most=2.01,
        expected="2, and half a percent for the friction, which the tuner's box does not vary",
    )
    yield Claim(
        "5.g", "and is stable at every plant of it: largest pole", rule, law.slowest, most=0.9999, one_sided=LESS
    )
    yield Claim(
        "5.h",
        "At equal bounds it is softer than P-PI at 10 Hz, which may have complex poles: ratio",
        rule,
        law.stiff / cascade.stiff,
        least=0.75,
        most=0.99,
        expected="0.87, rope snap on the bundled linear motor by the same bounds",
    )
    yield Claim(
        "5.i",
        "and follows the path less closely, by the integral gain against friction: ratio of the RMS",
        f"{rule}; {KEPT}",
        law.follows[0] / cascade.follows[0],
        *kept(1.41),
        expected="no figure was given: more than 1",
    )


def _paper_2(model: Loop, lessons: Taught, rows: Mapping[str, Judged]) -> Iterator[Claim]:
    try:
        control_with(model, "pole_placement")
        refused = ""
    except ParameterError as error:
        refused = str(error)
    yield Claim(
        "5.j",
        "Pole placement is refused on an axis with one encoder (1: with this reason)",
        refused or "it was not refused",
        float("position of the motor and that of the load" in refused),
        least=1.0,
        most=1.0,
    )
    gain, levels = _static(model)
    yield Claim(
        "5.k",
        "The rigid inverse leaves Coulomb friction over Kv Kp: RMS over this figure",
        f"law that ran with set velocity, mass and mean viscous friction fed forward; {UNMEASURED}",
        rows[INVERSE].follows[0] * gain / levels,
        least=0.95,
        most=1.06,
        expected="1, and some percent for the corners of the path",
    )
    expected = lessons.prefilter.rms(lessons.prefilter.predicted)
    yield Claim(
        "5.l",
        "A prefilter fitted to the measured errors of the first half predicts what is left of the second",
        f"velocity and acceleration; simulated RMS of the second half over that of least squares on the measured first "
        f"half, {stated(1e6 * expected, 'µm', '3')}; {UNMEASURED}",
        rows[FITTED].follows[0] / expected,
        least=0.9,
        most=1.1,
    )


def _paper_4(model: Loop, box: Uncertain, lessons: Taught, rows: Mapping[str, Judged]) -> Iterator[Claim]:
    learned = lessons.feedforward.after.parameters()
    gain, _ = _static(model)
    law = model.control.law
    assert isinstance(law, CascadePPI)
    friction = model.axis.friction_load
    assert isinstance(friction, Directional)
    T = float(model.sample_time)
    rule = "one step from the measured errors of the first half, friction at rest unknown, loop of the identified axis"
    yield Claim(
        "5.m",
        "The learned mass is that of the axis less what the late velocity takes, 1.5 T Kp: ratio of the sum",
        rule,
        (learned["mass"] + 1.5 * T * float(law.Kp)) / float(tree.get(model.axis, "plant.mass")),
        least=0.97,
        most=1.03,
    )
    viscous = 0.5 * (float(friction.viscous_positive) + float(friction.viscous_negative))
    yield Claim(
        "5.n",
        "The learned viscous friction is that of the axis and Kp, since the law feeds no set velocity: difference",
        rule,
        learned["viscous"] - float(law.Kp) - viscous,
        least=-30.0,
        most=30.0,
        unit="N s/m",
        expected="0; 30 N s/m are two of its errors",
    )
    yield Claim(
        "5.o",
        "Learned from errors alone it leaves of the following error, along the other half",
        f"{rule}; {UNMEASURED}; {KEPT}",
        1e6 * rows[LEARNED].follows[0],
        least=kept(1.28)[0],
        most=min(kept(1.28)[1], 1e6 * lessons.feedforward.predicted_rms),
        unit="µm",
        expected=Text(
            f"at most what least squares predict of the next run; of {stated(1e6 * rows[RAN].follows[0], 'µm', '3')}"
        ),
    )
    spread = {estimate.name.rsplit(".", 1)[-1]: box.factor * estimate.error for estimate in box.estimates}
    speed = 0.125  # m/s
    worst = max(
        spread["coulomb_positive"] + spread["viscous_positive"] * speed,
        spread["coulomb_negative"] + spread["viscous_negative"] * speed,
    )
    yield Claim(
        "5.p",
        "Over the box the error grows by the friction that is not known, over Kv Kp: share of this bound",
        f"ends of Coulomb and viscous friction at 0.125 m/s; {UNMEASURED}",
        (rows[LEARNED].follows[1] - rows[LEARNED].follows[0]) * gain / worst,
        least=0.4,
        most=1.0,
    )


def _static(model: Loop) -> tuple[float, float]:
    """Return Kv Kp of the law that ran in N/m, and the mean Coulomb level in N."""
    law, friction = model.control.law, model.axis.friction_load
    assert isinstance(law, CascadePPI)
    assert isinstance(friction, Directional)
    return float(law.Kv) * float(law.Kp), 0.5 * (float(friction.coulomb_positive) + float(friction.coulomb_negative))


def _pictures(predicted: Replay, shown: Mapping[str, Run]) -> tuple[Picture, ...]:
    return (
        Picture(
            "predicted",
            "The second half, predicted",
            "Measured and predicted force, and what is left of the position: identified from the first half.",
            "predicted and measured force lie over each other; a few micrometers of the position are left at reversals",
            partial(plot.replay_chart, predicted),
        ),
        Picture(
            "laws",
            "Tracking error along the second half",
            "Simulated on the identified axis; nothing was measured under these laws. Each row has its own scale.",
            "tracking error of three laws, of a few micrometers at the reversals",
            partial(plot.following_error_chart, shown),
        ),
    )
