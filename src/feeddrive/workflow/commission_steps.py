"""The steps of `feeddrive commission`, from an unknown drive to a loop that runs, which ask and can be resumed.

Each step leaves the files that the command of its name leaves, so that one can go on by hand from any of them:

    DIR/1_listen  2_small_move  3_start_law  4_friction_and_mass  5_excitation  6_responses  7_model  8_tune  9_export
    DIR/10_trial, and DIR/commission.json with what was predicted and what was measured
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Filter, Force, Law
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.force.backlash import Backlash
from feeddrive.blocks.force.cogging import Cogging
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.bus.drive_file import BusLimits, DriveFile
from feeddrive.bus.live import BusAxis, LiveAxis
from feeddrive.bus.play import Played, Profile
from feeddrive.commissioning import motions
from feeddrive.commissioning.cogging import acting, described, moved, periodic_force, stated
from feeddrive.commissioning.evidence import read_evidence
from feeddrive.commissioning.first_facts import SmallMove, ratio_by_ruler, rough_mass, small_move
from feeddrive.commissioning.friction import FrictionFit, fit_friction
from feeddrive.commissioning.motions import Pace
from feeddrive.commissioning.record import (
    FILE,
    Asked,
    Commissioned,
    Record,
    Step,
    digests,
    read_record,
    remove_stale,
    write_record,
)
from feeddrive.commissioning.trial import AGREED, COMMANDED, Figures, Trial, acting_force, figures, filled, predicted
from feeddrive.export.design import read_design, weight
from feeddrive.figures.catalogue import goals, limitable
from feeddrive.files.atomic_io import files_of, new_directory, write_whole
from feeddrive.files.frf import read_frfs
from feeddrive.files.log import Log, write_log
from feeddrive.files.machine import MachineFile, MachineLike, machine_of_text, machine_toml, read_machine
from feeddrive.files.origins import with_origins
from feeddrive.files.read_log import read_log
from feeddrive.identification.excitation.excitation import Excitation, design_excitation
from feeddrive.identification.motion.identify import own_viscous
from feeddrive.language.errors import (
    AbortedError,
    CancelledError,
    DivergedError,
    FeeddriveError,
    FileError,
    LogError,
    NotCertifiedError,
    ParameterError,
)
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, Units
from feeddrive.language.text import Text, resolve
from feeddrive.language.units import turning
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.report.page import html
from feeddrive.tuning.operating_point import OperatingPoint, measured_point
from feeddrive.tuning.start_law import start_law
from feeddrive.workflow.certify import CertifyRequest, certify
from feeddrive.workflow.check import CheckRequest, check
from feeddrive.workflow.command import Outcome, Request, argument, called, option
from feeddrive.workflow.commission_report import commission_report, verdict
from feeddrive.workflow.excite import excitation_report, write_excitation
from feeddrive.workflow.export import ExportRequest, export
from feeddrive.workflow.frf import FrfRequest, frf
from feeddrive.workflow.identify import identify
from feeddrive.workflow.identify_responses import IdentifyRequest
from feeddrive.workflow.tune import TuneRequest, limit_options, tune

SHARE = 0.1  # of limits.force, for the small move
TRIES = 3  # of the small move, each with twice the force: a hanging axis may need more than a tenth
RULED, TURNED = 0.01, 0.2  # m and rad of the small move, which a person measures to 2 %
USED = 0.4  # of limits.following_error that a motion may use: the monitor acts at 0.75 of it
WORK = 0.5  # of limits.force beyond holding force and friction, that a motion may use
REACH = 0.6  # of limits.travel: the rest is for braking
LEAST_LAG = 1e-3  # s of following error over speed, which a drive with feedforward may fall short of
SURE = 0.1  # error of a mass by strokes, above which the rough one stays
ROUGH, SPREAD = 0.3, 0.2  # by which the rough mass, and the identified one, may be wrong
STRUCTURES = (None, "modal", "rigid")  # of the model: by evidence, or where that is not told apart by the lines
NARROWER = (1.0, 0.5, 0.25)  # of the band, for the model: higher modes are in the responses alone
SHORT = 0.25  # of the travel, that the slowest strokes take
SLOW, FASTER = 0.1, 3.0  # of the pace, with which strokes begin, and by which they may grow from one to the next
FED, CREEP = 0.8, 1e-3  # share of the friction that is fed forward; m/s from which on it counts
# of the rate of the bus, of the inverse of the dead time with a cycle, and Hz: highest line of the excitation
BAND, DELAYS, TOP = 0.45, 0.4, 1000.0
MODES = 400.0  # Hz up to which modes are looked for, with the finest grid that stands out there
WIDER = 0.8  # of the widest band: less may be widened
AGAIN = {"soft": "with less force, under which friction keeps a play closed", "wide": "up to higher lines"}
# of the friction: an excitation under which the load keeps its contact, if it has 0.4 of the friction and all the mass;
# and times that, the one below which another measurement would not be a different one
CLOSED, OPENS = 0.4, 1.5
LEAST = 200.0  # Hz up to which they are, before the coarsest grid is taken
SLOWER = (1.0, 0.6, 0.36, 0.2, 0.1)  # of the rates of a start law
PEAKS = (2.0, 1.5, 1.25)  # of the sensitivity: margins that are tried on the model where the responses do not suffice
BEGINS = (0, 2, 4)  # candidate with which the first, second and third trial begins: the tuned one, slower, a start law
# of limits.velocity: of a motion, with what friction and modes are predicted to add, and what a pulse of force may add
FAST, FASTEST, PUSHED = 0.6, 0.85, 0.1
DRAWN = 8  # realisations, every other one the other way, so that they need no more travel
DECADES = 50.0  # MODES, or the highest line below it, over the lowest line: low ones need a lot of travel
QUIET = 1e-12  # m: noise of a reading that shows none
STANDS_OUT = 5.0  # amplitude over noise of the highest lines
LINES = ((1.0, 4), (2.0, 4), (4.0, 4))  # Hz from line to line, and periods: longer ones need more travel
SIZES, SMALLER = 12, 0.7  # of strokes, an excitation or a trial: how many are tried, each a share of the one before
# causes of an early end for which a weaker motion or a slower control is tried; all others end the commissioning
TOO_MUCH = ("following_error", "velocity", "acceleration", "force", "travel", "guard")
STUCK = ("standstill",)  # in the small move alone: friction or a brake may hold against a tenth of the force
# times what is predicted, and at least so many counts: following error at which the guard ends a trial
ALARM, COUNTS = 3.0, 50.0
FOLLOWS = 0.5  # of the travel of a trial, that the reading is predicted to make at least
GENTLE = 0.2  # of speed, acceleration and travel of a trial, before it is run
# times what is predicted, and share of limits.force, beyond which a force is an oscillation
HARDLY, NERVOUS = 3.0, 0.01
SHAKEN = 0.1  # of the force that is free: RMS of what noise and counts make of the force of a tuned control
UNKNOWN_DELAY = 2e-3  # s that a drive may need beside its bus cycles, until it is measured
HEAVIER, HARDER = 1.5, 1.5  # times the rough mass and resistance: what the monitor takes for the largest
AXIS = "x"
STOPPED = "it was stopped by hand; the same command goes on with the step that was stopped"
"""The refusal of a commissioning that a person stopped."""


class CommissionRequest(Request, more=limit_options(), after="goal"):
    """The drive, the goal and limits of the tuning, and where the results go."""

    drive: Path | DriveFile | LiveAxis | None = argument(
        "A drive file (TOML): bus, scaling, limits; or the file of an axis of LinuxCNC", default=None
    )
    second: Path | DriveFile | BusAxis | None = option(
        "the drive file of the second drive of a gantry, on the same beam", default=None
    )
    virtual: MachineLike | None = option(
        "a virtual drive with the plant of this machine file or bundled machine, in place of a drive; two of them for "
        "a machine with a cross_beam",
        default=None,
    )
    goal: str = option("goal of the tuning", default="rope-snap", options=tuple(goals()))
    mode: str | None = option(
        "what a control in the master commands: a force (cst), or a velocity to the velocity loop of the drive (csv); "
        "default: csv if the drive file says so, else cst",
        options=("cst", "csv"),
        default=None,
    )
    target: str = option("target of the export, as of feeddrive export", default="c", short="-t")
    yes: bool = option("answer every question with yes; for a virtual drive only", default=False)
    out: Path | None = option(
        "Directory of the commissioning, with its record; one that was interrupted goes on", short="-o", default=None
    )

    def usual_out(self) -> Path:
        return Path("results") / f"commission_{Path(called(self.virtual or self.drive)).stem}"

    def check(self) -> None:
        """Raise ParameterError unless there is one drive, real or virtual."""
        if (self.drive is None) == (self.virtual is None):
            raise ParameterError("give either a drive file, or --virtual with a machine, whose drive is then simulated")
        if self.mode == "csv" and self.second is not None:
            raise ParameterError("--mode csv is for one drive: the two drives of a gantry are controlled by forces")
        if self.virtual is not None and self.second is not None:
            raise ParameterError("--second is a drive; a virtual gantry is a machine with a cross_beam")


def asked_of(request: CommissionRequest) -> Asked:
    """Return the options that decide what a step does, by the step that is the first to use them."""
    limits = [figure.limit.option for figure in limitable() if figure.limit]
    used = {"tune": ["goal", *limits], "export": ["target"]}
    if request.mode is not None:
        used["start_law"] = ["mode"]
    return {step: {option: str(getattr(request, option)) for option in options} for step, options in used.items()}


class UnlikePredictedError(Exception):
    """A motion unlike its prediction; `step` is the one that then asks for less: a weaker motion or a slower control.

    back  the step to go back to, if it is one before: what was learned of the motion changes that one
    """

    def __init__(self, why: str, step: str = "tune", back: str | None = None) -> None:
        super().__init__(why)
        self.why, self.step, self.back = why, step, back or step


class MeasureAgainError(Exception):
    """A reason to measure the responses again before all is refused.

    how  "soft": with a force under which friction keeps a play closed; "wide": up to the highest lines that stand out
    """

    def __init__(self, why: str, how: str) -> None:
        super().__init__(why)
        self.why, self.how = why, how


class RefusedError(Exception):
    """A reason to stop, with the control before in place."""

    def __init__(self, why: str) -> None:
        super().__init__(why)
        self.why = why


def excited(path: Path) -> Profile:
    """Return the profile of a file that `write_excitation` wrote."""
    log = read_log(path)
    return motions.profile(path.stem, log["set_position"], log.sample_time, log["excitation"])


class _Model(NamedTuple):
    """A model of the axis: first the one that leaves less of the strokes, then of the lines that were not used."""

    left: float
    unused: float
    place: str
    lagging: bool
    text: str
    says: str
    gap: float


def _error(signals: Mapping[str, np.ndarray]) -> float:
    """Return the largest following error of a motion, m."""
    return float(np.max(np.abs(signals["set_position"] - signals["reading_load"])))


def _quickened(alone: Log, pushed: Log) -> float:
    """Return the largest velocity that a pulse of force adds, m/s, at either end of the axis."""
    names = ("velocity_load", "velocity_motor")
    return max(float(np.max(np.abs(pushed[name] - alone[name]))) for name in names)


class _Gentle(NamedTuple):
    """The log of the first move, the force that held the axis (N), and the share of the limit that it took besides."""

    log: Log
    held: float
    share: float


def _carried(told: SmallMove, force: float) -> float:
    """Return the force that slides and shakes an axis, as a share of its limit (N)."""
    return 1.2 * (told.resistance + 2.0 * abs(told.friction)) / force + SHARE


class _Learned(NamedTuple):
    """The model with the friction that explains a trial, what was in its folder otherwise, what is said of it, and the
    play between motor and load, m.
    """

    text: str
    files: Mapping[str, bytes]
    says: str
    gap: float


Told: TypeAlias = tuple[str, Mapping[str, float]]


class Chain:
    """The steps of one commissioning, in order, with what they told so far.

    late    s from the column `commanded` of a log to the force that acts, until it is measured
    forces  file of the step `responses` with the responses to a force, and whether that force was measured, in place
            of commanded: there is no dead time in them then
    """

    late = UNKNOWN_DELAY
    forces, measured_force = "responses/frf.csv", False

    @classmethod
    def check(cls, request: CommissionRequest) -> None:
        """Raise ParameterError for options that do not fit these steps, before anything moves."""

    def __init__(self, request: CommissionRequest, axis: LiveAxis, folder: Path, progress: Progress) -> None:
        self.request, self.axis, self.folder, self.progress = request, axis, folder, progress
        self.stated = axis.text()
        self.inside: dict[str, str] = {}
        self.place = folder
        self.steps: list[Step] = []
        self.facts: dict[str, float] = {}
        self.trial: Trial | None = None
        self.planned: tuple[motions.TrialMotion, dict[str, Log]] | None = None  # the trial of the tuned control
        self.questions = 0
        self.returns: dict[str, int] = {}  # how often a step was done again, as what followed was unlike its prediction
        self.again = set[str]()  # how the responses were measured again, by the keys of `AGAIN`
        self.learned: _Learned | None = None  # of a trial that was unlike its prediction
        self.kept = False

    def run(self, *, kept: bool) -> Outcome[Commissioned]:
        """Run all steps that are not done yet, and return the outcome; without `kept` no file of it is named."""
        _check_folder(self.folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        record = read_record(self.folder, self.stated, asked_of(self.request))
        self.inside = dict(self.axis.inside())
        before: dict[str, Step] = {}
        if record is not None and record.steps:
            self._check_inside(record)
            self.inside = dict(record.inside)
            before = {step.name: step for step in record.steps}
        if record is not None:
            if record.again:
                self.progress.remark(f"- {record.again}: that step and all after it are done again.")
            remove_stale(self.folder, record.stale)
        refusal = ""
        try:
            names = list(self.work)
            while len(self.steps) < len(names):
                number = len(self.steps)
                name, work = names[number], self.work[names[number]]
                self.place = self._in(name, "")
                # a trial is of the moment: it is run again
                if name in before and name != "trial":
                    self._resume(before.pop(name))
                    continue
                # what follows a step that is done again is done again, too
                before.clear()
                self.progress.step(name.replace("_", " "), number, len(self.work))
                if self.place.is_dir():
                    # of a step that was stopped, and so is not in the record
                    remove_stale(self.folder, [f"{self.place.name}/{file}" for file in files_of(self.place)])
                try:
                    says, told = getattr(self, work.__name__)()
                except UnlikePredictedError as unlike:
                    self._go_back(unlike)
                    continue
                except MeasureAgainError as again:
                    self.again.add(again.how)
                    self.trial = self.learned = None
                    self.progress.remark(Text(f"- {again.why}: the responses are measured again {AGAIN[again.how]}."))
                    self.steps = self.steps[: names.index("excitation")]
                    continue
                self._record(name, says, told)
            self._decide()
        except RefusedError as refused:
            refusal = refused.why
        except CancelledError:
            refusal = STOPPED
        except FeeddriveError as error:
            # what was measured so far stays, and the reason is the result
            if isinstance(error, AbortedError) and not self.steps:
                raise
            refusal = str(error)
        except BaseException:
            # a fault of this program, or an interrupt: the drive is not left with the limits of a step
            self._put_back("")
            raise
        if not self.kept:
            refusal = self._put_back(refusal)
        self._write(refusal)
        return self._outcome(refusal, kept=kept)

    def _go_back(self, unlike: UnlikePredictedError) -> None:
        """Go back to a step. Raise RefusedError once it was done as often as it may be."""
        done = self.returns.get(unlike.step, 0) + 1
        if done + len(self.again) >= len(BEGINS) or unlike.step not in self.work:
            raise RefusedError(Text(f"{unlike.why}; the control before stays"))
        self.returns[unlike.step] = done
        again = Text(f"back to the step {unlike.step}, which now asks for less")
        if unlike.back != unlike.step:
            again = Text(f"its friction is fitted to that trial, and the step {unlike.step} now asks for less")
        self.progress.remark(Text(f"- {unlike.why}: {again}."))
        self.steps = self.steps[: list(self.work).index(unlike.back)]

    @property
    def work(self) -> Mapping[str, Callable[[Any], Told]]:
        """The steps in order; see `STEPS`."""
        return STEPS

    # the record

    def _record(self, name: str, says: str, told: Mapping[str, float]) -> None:
        files: dict[str, str] = {}
        if self.place.is_dir():
            files = digests(self.folder, [f"{self.place.name}/{file}" for file in files_of(self.place)])
        self.facts.update(told)
        said = str(resolve(says, Units(rotary=self.axis.rotary)))
        self.steps.append(Step(name, said, dict(told), files, dict(self.axis.inside())))
        self.progress.remark(Text(f"{name.replace('_', ' ')}: {says}"))
        self._write("")

    def _put_back(self, refusal: str) -> str:
        """Write back what was in the drive; return the refusal, with what could not be put back."""
        try:
            self.axis.restore(self.inside)
        except FeeddriveError as error:
            return Text(f"{refusal}; what was in the drive could not be put back: {error}")
        return refusal

    def _check_inside(self, record: Record) -> None:
        """Raise FileError unless the drive is as the last step left it or, after its power was lost, as before it."""
        now, last = dict(self.axis.inside()), record.steps[-1]
        if now == last.inside:
            return
        others = [
            name
            for name in {*now, *last.inside}
            if now.get(name) not in (last.inside.get(name), record.inside.get(name))
        ]
        if not others:
            self.progress.remark("- The drive is as it was at the beginning: its power was off, or it was put back.")
            return
        name = min(others)
        raise FileError(
            f"{self.folder / FILE}: after the step '{last.name}' the drive held {name} = "
            f"{last.inside.get(name, 'nothing')}, at the beginning {record.inside.get(name, 'nothing')}, and now "
            f"{now.get(name, 'nothing')}: somebody changed it; put it back, or begin anew in another --out"
        )

    def _resume(self, done: Step) -> None:
        """Take over a step that was done before."""
        self.facts.update(done.figures)
        self.steps.append(done)
        if done.name == "excitation":
            self.again = {how for how in AGAIN if done.figures.get(how, 0.0) > 0.0}
        if done.name == "small_move":
            self.axis = self.axis.scaled(done.figures["length_factor"], int(done.figures["force_sign"]))
        self.progress.remark(Text(f"{done.name.replace('_', ' ')}: done before. {done.says}"))

    def _write(self, refusal: str) -> None:
        closing: dict[str, Any] = {
            "where": self.axis.where,
            "rotary": self.axis.rotary,
            "refusal": refusal,
            "kept": self.kept,
            "questions": self.questions,
        }
        if self.trial is not None:
            closing["predicted"] = self.trial.predicted.values()
            closing["measured"] = self.trial.measured.values()
            if self.trial.before is not None:
                closing["before"] = self.trial.before.values()
        write_record(self.folder, self.stated, asked_of(self.request), self.inside, self.steps, closing)

    def _outcome(self, refusal: str, *, kept: bool) -> Outcome[Commissioned]:
        result = Commissioned(
            self.axis.where,
            tuple(self.steps),
            self.trial,
            self.kept,
            self.questions,
            refusal,
            read_evidence(self.folder),
            self.axis.rotary,
        )
        page = partial(commission_report, result, self.folder if kept else None)
        tables = [result.table(), *([] if self.trial is None else [self.trial.table()])]
        judgment = Judgment.COMMISSIONED if self.kept else Judgment.NOT_COMMISSIONED
        told = verdict(result)
        files: dict[str, str | Path] = {}
        if kept:
            files["Record"] = self.folder / FILE
            files["Report"] = self.folder / "report.html"
            write_whole(files["Report"], html(page()))
            report = self._in("tune", "report.html")
            if report.is_file():
                files["Report of the tuning"] = report
        return Outcome(
            result,
            tables,
            verdict=told if self.kept else "",
            files=files,
            judgment=judgment,
            failure="" if self.kept else told,
            page=page,
        )

    # asking and moving

    def _ask(self, question: str) -> None:
        """Ask before the axis moves. Raise AbortedError without a yes."""
        if self.request.yes:
            self.progress.remark(Text(f"- {question} (--yes)"))
            return
        self.questions += 1
        if not self.progress.confirm(Text(f"{question} Is the travel clear, and the stop at hand?")):
            raise AbortedError(f"{self.axis.where}: it was not confirmed; the axis stays as it is")

    def _play(
        self, axis: LiveAxis, profile: Profile, control: Control | None = None, *, step: str | None = None
    ) -> Played:
        """Play a profile; raise RefusedError with the reason if the motion ended early."""
        played = axis.play(profile, self.progress, control)
        if played.aborted:
            self._ended(played)
            why = Text(f"the {profile.name} ended early: {played.aborted}")
            if step is not None and played.cause in TOO_MUCH:
                raise UnlikePredictedError(why, step)
            raise RefusedError(why)
        return replace(played, log=filled(played.log))

    def _ended(self, played: Played) -> None:
        """Raise CancelledError for a motion that a person stopped: nothing moves again without being asked for."""
        if played.cause == "person":
            raise CancelledError(played.aborted or "")

    @property
    def limits(self) -> BusLimits:
        return self.axis.limits

    @property
    def T(self) -> float:
        return self.axis.sample_time

    def _kept(self, **logs: Log) -> None:
        """Write logs into the folder of the step."""
        with new_directory(self.place) as folder:
            for name, log in logs.items():
                write_log(folder / f"{name}.parquet", log)

    # the steps

    def listen(self) -> tuple[str, Mapping[str, float]]:
        """Log the drive at standstill; nothing is written to it."""
        played = self.axis.listen(1.0, self.progress)
        self._kept(listened=played.log)
        reading = played.log["reading_load"]
        noise, drift = float(np.std(reading)), float(reading[-1] - reading[0])
        if abs(drift) > self.limits.following_error:
            raise RefusedError(
                Text(
                    f"the axis moves by {Quantity(drift, 'm'):3 mm} in a second while the drive is off: hold it, or "
                    "look at its brake"
                )
            )
        told = Text(f"the reading stands still with {Quantity(noise, 'm'):3} RMS; {played.lost} frames lost")
        return told, {"listened_noise": noise}

    def small_move(self) -> tuple[str, Mapping[str, float]]:
        """Move slowly under the drive's own control, with little force: holding force, friction, sign, gear."""
        limits = self.limits
        distance = min(TURNED if self.axis.rotary else RULED, SHARE * limits.travel)
        pace = Pace(min(2.0 * limits.following_error, 0.1 * limits.velocity), 0.25 * limits.quick_stop_deceleration)
        self._ask(
            Text(
                f"Small move: the drive's own control moves the axis by {Quantity(distance, 'm'):3 mm} at "
                f"{Quantity(pace.speed, 'm/s'):3} and back, with at most {Quantity(SHARE, 'share'):3} of "
                f"limits.force beyond what holds it, or up to {Quantity(SHARE * 2 ** (TRIES - 1), 'share'):3} if it "
                "needs more, and shakes it slightly."
            )
        )
        first = self._gently(motions.profile("small move", motions.path([(distance, pace)], self.T), self.T))
        counted = float(first.log["reading_load"][-1] - first.log["reading_load"][0])
        factor = self._ruled(counted)
        self.axis = self.axis.scaled(factor, 1)
        # in true lengths forces are others, too: what holds the axis must stay within them
        # the way back may need more than the way out: friction differs by direction and place
        share, way = first.held / factor / limits.force + first.share + SHARE, factor * counted
        if share > 1.0:
            raise RefusedError(
                Text(
                    f"what holds the axis, {Quantity(first.held / factor, 'N'):3} by the lengths of the ruler, leaves "
                    f"less than {Quantity(first.share, 'share'):2} of limits.force = {Quantity(limits.force, 'N'):3}: "
                    "raise it if the machine allows it"
                )
            )
        self._play(self._at(share), motions.profile("way back", motions.path([(-way, pace)], self.T), self.T))
        to_and_fro = motions.profile("small move", motions.path([(way, pace), (0.0, pace)], self.T), self.T)
        slow = self._play(self._at(share), to_and_fro)
        told = small_move(slow.log)
        made = self._push(told)
        pushed = self._play(self._at(_carried(told, limits.force)), made.profile)
        self._play(self._at(share), made.back(self.T))
        rough = rough_mass(pushed.log, made)
        self._kept(first=first.log, to_and_fro=slow.log, push=pushed.log)
        facts = {
            "holding": told.holding * rough.force_sign,
            "friction": max(abs(told.friction), 1e-3 * limits.force),
            "resistance": told.resistance,
            "lag": told.lag,
            "noise": told.noise,
            "rough_mass": rough.mass,
            "force_sign": float(rough.force_sign),
            "length_factor": factor,
        }
        self.axis = self.axis.scaled(1.0, rough.force_sign)
        self._write_drive()
        sign = "" if rough.force_sign > 0 else "; its force counts against its positions, which is taken into account"
        gear = "" if factor == 1.0 else Text(f"; lengths are {Quantity(factor):4} times those of the drive file")
        return Text(
            f"it follows; holding force {Quantity(facts['holding'], 'N'):3}, friction "
            f"{Quantity(facts['friction'], 'N'):3}, roughly {Quantity(facts['rough_mass'], 'kg'):2}{sign}{gear}"
        ), facts

    def _write_drive(self) -> None:
        """Write the drive file with what was found."""
        write_whole(self.place / "drive.toml", self.axis.text())

    def _at(self, share: float) -> LiveAxis:
        """Return the axis under a share of its force limit."""
        return self.axis.limited(replace(self.limits, force=min(1.0, share) * self.limits.force))

    def _gently(self, profile: Profile) -> _Gentle:
        """Play a profile under the force that holds the axis and a tenth of its limit or, if that does not move it,
        two and four tenths.
        """
        still = motions.profile("hold", np.zeros(round(motions.REST / self.T)), self.T)
        try:
            hold = self._play(self.axis.as_found(), still, step="small_move")
        except UnlikePredictedError as unlike:
            raise RefusedError(
                Text(
                    f"the drive cannot hold the axis within limits.force = {Quantity(self.limits.force, 'N'):3}: "
                    f"{unlike.why}; look at lead, gear and rated torque in the drive file, or raise it if the machine "
                    "allows it"
                )
            ) from None
        held = float(np.max(np.abs(hold.log["force"])))
        why = ""
        for attempt in range(TRIES):
            share = SHARE * 2**attempt
            played = self._at(held / self.limits.force + share).play(profile, self.progress)
            if not played.aborted:
                return _Gentle(played.log, held, share)
            self._ended(played)
            why = Text(f"the {profile.name} ended early: {played.aborted}")
            if played.cause not in (*TOO_MUCH, *STUCK):
                break
            self.progress.remark(Text(f"- under {Quantity(share, 'share'):3} of limits.force {why}"))
        raise RefusedError(why)

    def _push(self, told: SmallMove) -> motions.Push:
        """Return a push that keeps sliding as far as following error and travel allow."""
        limits = self.limits
        speed = min(USED * limits.following_error / max(told.lag, LEAST_LAG), 0.2 * limits.velocity)
        pace = Pace(speed, 0.25 * limits.quick_stop_deceleration)
        # at a constant acceleration the distance grows faster than the speed
        pace = replace(pace, speed=speed * min(1.0, REACH * limits.travel / motions.push_distance(pace)))
        return motions.push(motions.push_distance(pace), pace, SHARE * limits.force, self.T)

    def _ruled(self, counted: float) -> float:
        """Return the true length of one counted metre, by a person with a ruler; 1 without one."""
        if self.request.yes:
            return 1.0
        self.questions += 1
        question = Text(
            f"The drive counts a move of {Quantity(counted, 'm'):4 mm}. Measure it: by how much did the axis move?"
        )
        measured = self.progress.measured(question, counted, turning("m") if self.axis.rotary else "m")
        if measured is None:
            return 1.0
        factor = ratio_by_ruler(measured, counted, rotary=self.axis.rotary)
        if not factor > 0.0:
            raise RefusedError(
                Text(
                    f"by the ruler it moved by {Quantity(measured, 'm'):4 mm}, against its counts of "
                    f"{Quantity(counted, 'm'):4 mm}: turn the direction of the encoder or of the drive (0x607E)"
                )
            )
        return factor

    def _under_control(self) -> LiveAxis:
        """Return the axis with what the monitor must know in cst: the largest mass and breakaway force."""
        facts = self.facts
        stuck = HARDER * facts["resistance"]
        return self.axis.limited(
            replace(self.limits, largest_mass=HEAVIER * facts["rough_mass"], breakaway_force=stuck)
        )

    @property
    def _free(self) -> float:
        """What holding force and friction leave of limits.force, N."""
        return self.limits.force - abs(self.facts["holding"]) - self.facts["friction"]

    def _pace(self, mass: float, share: float = 1.0) -> Pace:
        """Return how fast the axis may move within force, velocity, acceleration and travel, times a share."""
        limits, facts = self.limits, self.facts
        free = self._free
        acceleration = min(limits.quick_stop_deceleration, WORK * free / mass)
        if limits.acceleration is not None:
            acceleration = min(acceleration, 0.5 * limits.acceleration)
        if not acceleration > 0.0:
            raise RefusedError(
                Text(
                    f"limits.force = {Quantity(limits.force, 'N'):3} leaves nothing beyond the holding force "
                    f"{Quantity(abs(facts['holding']), 'N'):3} and friction {Quantity(facts['friction'], 'N'):3}"
                    ": raise it if the machine allows it"
                )
            )
        # three lengths of acceleration within the travel
        speed = min(FAST * limits.velocity, (acceleration * REACH * limits.travel / 3.0) ** 0.5)
        return Pace(share * speed, share * acceleration)

    def start_law(self) -> tuple[str, Mapping[str, float]]:
        """Compute a safe start law from the rough mass; nothing moves."""
        facts = self.facts
        axis = self._rigid(facts["rough_mass"], facts["friction"], 0.0, UNKNOWN_DELAY + 2.0 * self.T)
        loop = self._started(axis, ROUGH)
        with new_directory(self.place) as folder:
            write_whole(folder / "machine.toml", self._machine(loop, "safe start law of feeddrive commission"))
        law: Any = loop.control.law
        return Text(
            f"P-PI with Kv {Quantity(float(law.Kv), '1/s'):3}, Kp {Quantity(float(law.Kp), 'N s/m'):3}, which bears a "
            f"mass that is {Quantity(ROUGH, 'share'):2} off {Quantity(facts['rough_mass'], 'kg'):2}"
        ), {}

    def _rigid(self, mass: float, coulomb: float, viscous: float, dead_time: float) -> Axis:
        """Return a rigid axis; its viscous friction is in the plant, to which responses are fitted."""
        held = self.facts["holding"]
        return Axis(
            plant=Rigid(mass=mass, viscous=viscous),
            actuator=Actuator(dead_time=dead_time),
            friction_load=Coulomb(coulomb=coulomb),
            forces=(Gravity(force=-held),) if abs(held) > 0.2 * coulomb else (),
            rotary=self.axis.rotary,
        )

    def _machine(self, loop: Loop, source: str) -> str:
        return machine_toml(Machine.of({AXIS: loop}), self.axis.where, source)

    def _started(self, axis: Axis, spread: float) -> Loop:
        """Return an axis under a safe start law with a guard."""
        limits = self.limits
        pace = self._pace(float(axis.plant.rigid_mass()))
        started = start_law(
            axis,
            self.T,
            # the count whose rounding is as noisy as the reading
            count=math.sqrt(12.0) * self._noise,
            force_limit=limits.force,
            force=limits.force,
            motion=(REACH * limits.travel, pace.speed, pace.acceleration),
            spread=spread,
        )
        # what the axis needs for the set motion is fed forward, so that a slow law follows within its limits
        friction = axis.friction_load
        level = FED * max(0.0, float(friction.steady(CREEP))) if friction is not None else 0.0
        viscous = own_viscous(axis) + (float(friction.linear()) if friction is not None else 0.0)
        fed = (
            Inertia(mass=float(axis.plant.rigid_mass()), viscous=viscous),
            FrictionFeedforward(coulomb_positive=level, coulomb_negative=level, smoothing=CREEP),
        )
        # gains in a drive are those of its own structure
        fed = tuple(block for block in fed if isinstance(block, self.axis.takes))
        held = float(weight(axis))
        guard = Guard(following_error_limit=limits.following_error, velocity_limit=limits.velocity, safe_force=held)
        return replace(started.loop, control=replace(started.loop.control, feedforward=fed, guard=guard), name=AXIS)

    def friction_and_mass(self) -> tuple[str, Mapping[str, float]]:
        """Move to and fro at several speeds under the start law, and identify mass, friction and dead time."""
        machine = read_machine(self._in("start_law", "machine.toml"))
        loop = machine.loop(AXIS)
        pace, travel = self._strokes_pace(loop), REACH * self.limits.travel
        self._ask(
            Text(
                f"Friction and mass: a start law in this program moves the axis to and fro over "
                f"{Quantity(travel, 'm'):3 mm}, slowly first, then at up to {Quantity(pace.speed, 'm/s'):3} as far as "
                "its following error allows."
            )
        )
        played = self._strokes(loop.control, pace, travel)
        log, along = self._forced(played.log), self._along(played.log)
        self._kept(strokes=log if along is None else acting(log, along, self.late))
        facts, told = self._identified(self._by_force(machine), "commanded" if along is None else "acting")
        if facts["mass_error"] > SURE * facts["mass"]:
            # the responses will tell it: until then the law for the rough mass has moved the axis safely
            facts |= {"mass": self.facts["rough_mass"], "mass_error": ROUGH * self.facts["rough_mass"]}
        pull = ""
        if along is not None:
            facts |= described(along)
            pull = Text(
                f"; a force of {Quantity(float(along.force), 'N'):3} repeats every "
                f"{Quantity(float(along.period), 'm'):3 mm} along the travel"
            )
        return Text(
            f"mass {Quantity(facts['mass'], 'kg', facts['mass_error'])}, friction "
            f"{Quantity(facts['coulomb'], 'N'):3}, viscous {Quantity(facts['viscous'], 'N s/m'):3}, dead time "
            f"{Quantity(facts['dead_time'], 's'):2}{pull}. {told}"
        ), facts

    def _identified(self, machine: MachineFile, force: str) -> tuple[dict[str, float], str]:
        """Return mass, friction and dead time by the strokes, or with an infinite error those of the rough model.

        force  the column of the strokes' force
        """
        facts = {
            "mass": self.facts["rough_mass"],
            "mass_error": math.inf,
            "coulomb": self.facts["friction"],
            "viscous": 0.0,
            "dead_time": UNKNOWN_DELAY,
        }
        columns: dict[str, Any] = {"force": force}
        if self.axis.rotary:
            columns = {"angle": "reading_load", "set_angle": "set_position", "torque": force, "rotary": True}
        try:
            outcome = identify.run(
                IdentifyRequest((self.place / "strokes.parquet",), machine=machine, axis=AXIS, **columns),
                self.progress.quiet(),
            )
        except LogError as error:
            return facts, f"{error}"
        found = outcome.result
        values = {estimate.name: float(estimate.value) for estimate in found.rigid.estimates}

        def mean(name: str) -> float:
            sides = [value for key, value in values.items() if key.startswith(name)]
            return max(0.0, sum(sides) / len(sides)) if sides else 0.0

        return {
            "mass": float(found.mass.value),
            "mass_error": float(found.mass.error),
            "coulomb": mean("coulomb"),
            "viscous": mean("viscous"),
            "dead_time": max(0.0, float(found.delay.dead_time)) * self.T,
        }, f"{outcome.verdict}"

    def _strokes(self, control: Control, pace: Pace, travel: float) -> Played:
        """Play one stroke at growing paces, as far as the following error of the last one allows; then the strokes."""
        share, axis = SLOW, self._under_control()
        while True:
            slower = Pace(share * pace.speed, share * pace.acceleration)
            # a slow stroke is a short one, so that it takes no longer
            reach = max(share, SHORT) * travel
            tried = self._play(axis, motions.strokes(reach, slower, self.T, (1.0,), "first stroke"), control)
            error = float(np.max(np.abs(tried.log["set_position"] - tried.log["reading_load"])))
            # not all of it: what grows with the square of the speed is not told by a slow one
            grown = share * (FASTER if error == 0.0 else min(FASTER, 0.75 * USED * self.limits.following_error / error))
            if share >= 1.0 or grown < 1.3 * share:
                break
            share = min(1.0, grown)
        played = self._play(axis, motions.strokes(reach, slower, self.T), control)
        if share < 1.0 and self._along(played.log) is not None:
            # what acts along the travel is told by all of it
            played = self._play(axis, motions.strokes(travel, slower, self.T), control)
        return played

    def _strokes_pace(self, loop: Loop) -> Pace:
        """Return how fast the strokes may be for the following error that the start law is predicted to have."""
        pace = self._pace(float(loop.axis.plant.rigid_mass()))
        for attempt in range(SIZES):
            pace = self._pace(float(loop.axis.plant.rigid_mass()), SMALLER**attempt)
            strokes = motions.strokes(REACH * self.limits.travel, pace, self.T)
            if self._fits(self._predicted(loop, strokes)):
                return pace
        raise RefusedError(
            Text(
                f"limits.following_error = {Quantity(self.limits.following_error, 'm'):3} is too small for a safe "
                f"start law, even at {Quantity(pace.speed, 'm/s'):2}: raise it for the commissioning"
            )
        )

    def _predicted(self, loop: Loop, profile: Profile) -> Log:
        """Return the log of a motion as a loop is predicted to answer it."""
        return predicted(loop, profile, self.axis.increment, self.facts["noise"])

    def _fits(self, log: Log) -> bool:
        """Return True if a predicted motion stays within following error and force."""
        force = float(np.max(np.abs(acting_force(log))))
        fastest = max(float(np.max(np.abs(log[name]))) for name in ("velocity_load", "velocity_motor"))
        limits = self.limits
        within = _error(log.channels) <= USED * limits.following_error and force <= limits.force
        return within and fastest <= FASTEST * limits.velocity

    def excitation(self) -> tuple[str, Mapping[str, float]]:
        """Design a multisine for the axis under its start law, checked by simulation; nothing moves."""
        facts = self.facts
        loop = self._started(
            self._rigid(facts["mass"], facts["coulomb"], facts["viscous"], UNKNOWN_DELAY + 2.0 * self.T),
            max(SPREAD, 2.0 * facts["mass_error"] / facts["mass"]),
        )
        made = self._designed(loop)
        machine = self._machine(loop, "start law for the identified axis")
        write_excitation(made, self.place, excitation_report(made, {"Drive": self.axis.where}))
        write_whole(self.place / "machine.toml", machine)
        return Text(
            f"{made.lines.size} lines up to {Quantity(made.frequency[-1], 'Hz'):3}, at most "
            f"{Quantity(made.amplitude, 'N'):3}, in {len(made.drawings)} realisations"
        ), {
            "amplitude": made.amplitude,
            "period": float(made.period),
            **{how: float(how in self.again) for how in AGAIN},
        }

    def _designed(self, loop: Loop) -> Excitation:
        """Return the excitation with the finest grid whose highest line stands out of the noise, within the limits.

        A line of amplitude a moves the axis by a / (m w²), and its noise over N samples is s sqrt(4 / N), s that of the
        reading.  A resonance above the crossover can make a loop unstable, and the responses must go on until the loop
        gain is small.  The dead time bounds the crossover, and so the band; more of it takes amplitude from the lines
        that count.  Where no control could be certified from that, as with a resonance at its end, it goes further.
        """
        mass = float(loop.axis.plant.rigid_mass())
        noise = max(QUIET, self._noise)

        def stands_out(excited: Excitation) -> float:
            samples = len(excited.drawings) * excited.periods * excited.period
            line = excited.amplitude / (excited.crest * math.sqrt(0.5 * excited.lines.size))
            moved = line / (mass * (2.0 * math.pi * float(excited.frequency[-1])) ** 2)
            return moved / (noise * math.sqrt(4.0 / samples))

        widest = self._widest
        if "wide" not in self.again:
            widest = min(widest, max(MODES, DELAYS / (self.facts["dead_time"] + self.T)))
        tops = [widest * SMALLER**k for k in range(SIZES)]
        # a mode with little damping lies between coarse lines, the more so the lower it is: a fine grid counts more
        # than a band beyond the modes, and the coarsest one is that of axes with little travel
        tried = [(lines, top) for lines in LINES[:-1] for top in tops if top >= MODES]
        tried += [(lines, top) for top in tops if LEAST <= top < MODES for lines in LINES[:-1]]
        tried += [(LINES[-1], top) for top in tops if top >= LEAST]
        tried += [(lines, top) for top in tops if top < LEAST for lines in LINES]
        for (resolution, periods), top in tried:
            made = self._largest(loop, top, resolution, periods)
            if made is not None and stands_out(made) >= STANDS_OUT:
                return made
        raise RefusedError(
            Text(
                f"no excitation within limits.travel = {Quantity(self.limits.travel, 'm'):3 mm} and limits.force = "
                f"{Quantity(self.limits.force, 'N'):3} stands out of the noise of the reading, "
                f"{Quantity(noise, 'm'):2} RMS: raise them if the machine allows it"
            )
        )

    @property
    def _noise(self) -> float:
        """The noise of a reading with that of its counts, m RMS."""
        return math.hypot(self.facts["noise"], self.axis.increment / math.sqrt(12.0))

    @property
    def _widest(self) -> float:
        """The highest line that the bus allows and that is looked for, Hz."""
        return min(TOP, BAND / self.T)

    def _largest(self, loop: Loop, top: float, resolution: float, periods: int) -> Excitation | None:
        """Return the largest excitation with lines up to `top` (Hz) that the limits allow; None if there is none."""
        limits = self.limits
        free = WORK * self._free
        if "soft" in self.again:
            free = min(free, CLOSED * self.facts["coulomb"])
        free *= 0.5 ** self.returns.get("excitation", 0)
        for attempt in range(SIZES):
            try:
                made = design_excitation(
                    loop,
                    band=(max(3.0 * resolution, min(top, MODES) / DECADES), top),
                    amplitude=free * SMALLER**attempt,
                    resolution=resolution,
                    periods=periods,
                    realisations=DRAWN,
                    travel=REACH * limits.travel,
                    speed=0.8 * limits.velocity,
                    force=0.8 * limits.force,
                    name=AXIS,
                    advised=False,
                )
            except ParameterError:
                # a limit is exceeded
                continue
            if all(_error(drawn.signals) <= USED * limits.following_error for drawn in made.drawings):
                return made
        return None

    def responses(self) -> tuple[str, Mapping[str, float]]:
        """Play the excitation under the start law, and estimate the frequency responses."""
        control = read_machine(self._in("excitation", "machine.toml")).loop(AXIS).control
        files = sorted(self._in("excitation", "").glob("excitation_*.csv"))
        profiles = [excited(path) for path in files]
        # a weaker excitation than the one that was confirmed needs no other question
        far = max(float(np.ptp(profile.set_position)) for profile in profiles)
        if not self.returns.get("excitation") and not self.again:
            self._ask(
                Text(
                    f"Responses: the axis moves slowly by up to {Quantity(far, 'm'):3 mm} and is shaken with at most "
                    f"{Quantity(self.facts['amplitude'], 'N'):3}, {len(profiles)} times."
                )
            )
        axis = self._under_control()
        return self._estimated([self._excited(axis, profile, control) for profile in profiles]), {}

    def _excited(self, axis: LiveAxis, profile: Profile, control: Control) -> Log:
        """Play an excitation, with the force against that along the travel, and return its log."""
        along = stated(self.facts)
        if along is None:
            return self._play(axis, profile, control, step="excitation").log
        # the start law is soft: left to it, this force would take most of the following error
        against = self._held_against(along, profile)
        played = self._play(axis, replace(profile, excitation=profile.excitation - against), control, step="excitation")
        # no part of what the responses are correlated with
        channels = {**played.log.channels, "excitation": profile.excitation[: len(played.log)]}
        return replace(played.log, channels=channels)

    def _held_against(self, along: Cogging, profile: Profile) -> np.ndarray:
        """Return the force along the travel of a profile from where the axis stands, N, which a motion is held
        against.
        """
        force = along.at(self._stands() + profile.set_position)
        # at rest friction holds the axis, and a force that begins or ends at once is a jump
        still = round(motions.RAMP / self.T)
        fade = np.minimum(1.0, np.arange(force.size) / still)
        return fade * fade[::-1] * force

    def _estimated(self, logs: Sequence[Log]) -> str:
        """Estimate the frequency responses of logs, and return a sentence on them."""
        along = stated(self.facts)
        if along is not None:
            # in slow moves it would pass for noise
            logs = [acting(log, along, self.facts["dead_time"]) for log in logs]
        self._kept(**{f"measured_{k}": log for k, log in enumerate(logs, start=1)})
        measured = tuple(self.place / f"measured_{k}.parquet" for k in range(1, len(logs) + 1))
        outputs = tuple(name for name in ("reading_motor", "reading_load") if name in logs[0].channels)
        outcome = frf.run(
            FrfRequest(
                measured,
                input="commanded" if along is None else "acting",
                output=outputs,
                reference=("excitation",),
                method="periodic",
                period=round(self.facts["period"]),
                out=self.place / "responses",
            ),
            self.progress.quiet(),
        )
        # incoherent lines are those of noise and backlash: the certificate holds the control against each of them
        doubt = f" {outcome.failure or outcome.verdict}" if outcome.judgment.bad else ""
        return Text(f"{' and '.join(outputs)}, {len(logs)} realisations.{doubt}")

    def model(self) -> tuple[str, Mapping[str, float]]:
        """Fit masses, springs and dead time to the responses, and friction to the strokes; nothing moves.

        The band is narrower, and the structure another one, if it must be.  Where the only encoder is, is told by the
        strokes: the start law moved the axis, and a model under which it does not is none.
        """
        if self.learned is not None:
            with new_directory(self.place) as folder:
                for name, content in {**self.learned.files, "machine.toml": self.learned.text}.items():
                    (folder / name).parent.mkdir(parents=True, exist_ok=True)
                    write_whole(folder / name, content)
            return self.learned.says, {"model_band": self.facts["model_band"], "gap": self.learned.gap}
        frequency = next(iter(self._responses().values())).frequency
        # until it is found again
        self.facts["gap"] = 0.0
        refused = ""
        for structure in STRUCTURES:
            for share in NARROWER:
                high = share * float(frequency[-1])
                models: list[_Model] = []
                last = "", False
                for place in self._places():
                    # without the lag of the current loop where lines do not tell it from dead time and masses
                    for lagging in (True, False):
                        try:
                            last = place, lagging
                            outcome = self._fitted(place, structure, float(frequency[0]), high, lagging=lagging)
                            if outcome.judgment.bad or "Machine" not in outcome.files:
                                refused = refused or Text(f"{outcome.verdict} {' '.join(outcome.notes)}")
                                continue
                            models.append(self._with_friction(place, outcome, lagging=lagging))
                            break
                        except (LogError, ParameterError) as error:
                            # contradicted by the lines, as by the sign of a mode, or by the strokes
                            refused = refused or str(error)
                if not models:
                    continue
                best = min(models)
                # the report of the step is that of the last fit
                if (best.place, best.lagging) != last:
                    self._fitted(best.place, structure, float(frequency[0]), high, lagging=best.lagging)
                write_whole(self.place / "machine.toml", best.text)
                return best.says, {"model_band": high, "gap": best.gap}
        if how := self._again():
            raise MeasureAgainError(Text(f"no model: {refused}"), how)
        raise RefusedError(Text(f"model: {refused}"))

    def _with_friction(self, place: str, outcome: Outcome[Any], *, lagging: bool) -> _Model:
        """Return the model of an outcome with the friction that explains the strokes best.

        Raises NotIdentifiableError for a model under which the start law does not make the strokes.
        """
        model = self._model_of(read_machine(self.place / "machine.toml").loop(AXIS))
        strokes = self._in("friction_and_mass", "strokes.parquet")
        control = self._start_control(model)
        fit, explained = self._explained(model, control, read_log(strokes))
        text = self._machine(explained, "feeddrive commission: responses and strokes")
        says = Text(
            f"{outcome.verdict} Its friction acts on the {fit.body} with a {fit.curve} curve, which leaves "
            f"{Quantity(fit.left, 'm'):3} RMS of the strokes."
        )
        inputs = (self._in("responses", "responses/frf.csv"), strokes)
        unused = outcome.result.fit.agreement.unused
        if fit.gap:
            says = Text(f"{says} Between motor and load is a play of {Quantity(fit.gap, 'm'):3}.")
        return _Model(fit.left, unused, place, lagging, with_origins(text, inputs), says, fit.gap)

    def _model_of(self, fitted: Loop) -> Loop:
        """Return the loop of the model with the axis that was fitted to responses from forces."""
        return fitted

    def _start_control(self, model: Loop) -> Control:
        """Return the start law as it ran, on the encoder that the model says."""
        control = read_machine(self._in("start_law", "machine.toml")).loop(AXIS).control
        law: Any = model.control.law
        return replace(control, law=replace(control.law, velocity_encoder=law.velocity_encoder))

    def _explained(self, model: Loop, control: Control, log: Log) -> tuple[FrictionFit, Loop]:
        """Return the friction that explains best what a control did, and the model with it.

        Raises NotIdentifiableError for a model under which the control does not make the motion.
        """
        ran = moved(self._pulled(replace(model, control=control)), float(log["set_position"][0]))
        # a play shows where both ends of it are read
        play = "soft" in self.again and len(self._responses()) > 1
        fit = fit_friction(ran, log, self.facts["coulomb"], self.facts["viscous"], play=play)
        # as in the responses, the force along the travel and the play are not in it: they have no mean slope, by which
        # loops are judged
        return fit, replace(model, axis=replace(fit.axis, forces=model.axis.forces))

    def _learn(self, control: Control, log: Log) -> None:
        """Fit the friction of the model to a trial that was unlike its prediction, for the trial of a slower control.

        At the speeds, and under the forces, of a trial friction need not be that of slow strokes.
        """
        place, responses = self._in("model", ""), self._in("responses", "responses/frf.csv")
        model = read_machine(place / "machine.toml").loop(AXIS)
        try:
            fit, explained = self._explained(model, control, log)
        except (LogError, ParameterError) as error:
            self.progress.remark(Text(f"- Its friction cannot be fitted to that trial: {error}"))
            return
        text = self._machine(explained, "feeddrive commission: responses and a trial")
        says = Text(
            f"The model as before, with the friction of the trial: on the {fit.body} with a {fit.curve} curve, which "
            f"leaves {Quantity(fit.left, 'm'):3} RMS of it."
        )
        files = {name: (place / name).read_bytes() for name in files_of(place) if name != "machine.toml"}
        gap = fit.gap or self.facts.get("gap", 0.0)
        self.learned = _Learned(with_origins(text, (responses,)), files, says, gap)

    def _along(self, log: Log) -> Cogging | None:
        """Return the force that repeats along the strokes, if there is a clear one."""
        return periodic_force(self._forced(log), self.late)

    def _forced(self, log: Log) -> Log:
        """Return a log whose column `commanded` is the force that drives the axis, `late` seconds later."""
        return log

    def _by_force(self, machine: MachineFile) -> MachineFile:
        """Return a machine with the axis of another one that takes a force."""
        return machine

    def _pulled(self, loop: Loop) -> Loop:
        """Return a loop with the force along the travel and the play that were found, by the drive's own positions."""
        found: list[Force] = []
        if (along := stated(self.facts)) is not None:
            found.append(along)
        if gap := self.facts.get("gap", 0.0):
            found.append(Backlash(gap=gap))
        return replace(loop, axis=replace(loop.axis, forces=(*loop.axis.forces, *found)))

    def _responses(self) -> dict[str, FRF]:
        return read_frfs(self._in("responses", "responses/frf.csv"))

    def _places(self) -> tuple[str, ...]:
        """Return where the only encoder may be; of a drive with two encoders both places are known."""
        return ("both",) if len(self._responses()) > 1 else ("motor", "load")

    def _begin_of_fit(self) -> Loop:
        """Return a loop under a start law that commands a force, with whose axis a fit begins."""
        return read_machine(self._in("excitation", "machine.toml")).loop(AXIS)

    def _fitted(self, place: str, structure: str | None, low: float, high: float, *, lagging: bool) -> Outcome[Any]:
        """Fit the responses with the encoder at a place, and write the files of the step; by evidence without a
        structure.

        lagging  the lag of the current loop is fitted, too: without it, masses and dead time take its place
        """
        loop = self._begin_of_fit()
        encoder = Encoder(resolution=self.axis.increment) if self.axis.increment else Encoder()
        axis = replace(
            loop.axis,
            encoder_motor=None if place == "load" else encoder,
            encoder_load=None if place == "motor" else encoder,
            actuator=replace(loop.axis.actuator, current_loop=high if lagging else None),
        )
        law = replace(loop.control.law, velocity_encoder="load" if place == "load" else "motor")
        # without what is fed forward: the trial then shows the feedback loop, which is what is proven
        loop = replace(loop, axis=axis, control=replace(loop.control, law=law, feedforward=()))
        only = None if place == "both" else next(iter(self._responses()))
        text = self._machine(loop, "start law for the identified axis")
        return identify.run(
            IdentifyRequest(
                (self._in("responses", self.forces),),
                machine=machine_of_text(text, "machine.toml"),
                axis=AXIS,
                band=f"{low:.6g}..{high:.6g}",
                model=structure,
                measured_input=self.measured_force,
                out=self.place,
                motor=only if place == "motor" else None,
                load=only if place == "load" else None,
            ),
            self.progress.quiet(),
        )

    def tune(self) -> tuple[str, Mapping[str, float]]:
        """Tune within the limits of the request on the measured responses; nothing moves."""
        limits: dict[str, Any] = {
            figure.limit.option: getattr(self.request, figure.limit.option) for figure in limitable() if figure.limit
        }
        model, responses = self._in("model", "machine.toml"), self._in("responses", "responses/frf.csv")

        limits["box"] = "none"  # measured responses have no box, and both searches shall have equal limits
        limits |= self._tuning(limits["max_noise"])

        def tuned(source: Path, **more: Any) -> Outcome[Any]:
            request = TuneRequest(source, axis=AXIS, goal=self.request.goal, out=self.place, **{**limits, **more})
            return tune.run(request, self.progress.quiet())

        def on_responses() -> tuple[str, str]:
            outcome = tuned(responses, baseline=model, at=self._points_beside())
            return outcome.verdict, self._not_certified(outcome, fitted=True)

        def on_model(peak: float) -> tuple[str, str]:
            least = min(peak, limits["max_ms"] or peak)
            outcome = tuned(model, max_ms=least, at=self._points_beside())
            told = Text(f"On the model with Ms <= {Quantity(least):3}. {outcome.verdict}")
            return told, self._not_certified(outcome)

        def not_tuned(slower: float) -> tuple[str, str]:
            self._start_again(slower)
            told = Text(f"A safe start law, {Quantity(slower, 'share'):2} as fast as its rule.")
            return told, self._not_certified()

        candidates = [on_responses, *(partial(on_model, peak) for peak in PEAKS)]
        candidates += [partial(not_tuned, slower) for slower in SLOWER]
        whys = list[str]()
        # noise, distortion or a band that ends early: the model is fitted to all lines, and the certificate holds the
        # control against each of them
        for candidate in candidates[BEGINS[self.returns.get("tune", 0)] :]:
            try:
                told, why = candidate()
                why = why or self._not_tried()
            except FeeddriveError as error:
                told, why = "", str(error)
            if not why:
                return Text(f"{told}{f' Not the one before, as {whys[-1]}' if whys else ''}"), {}
            whys.append(why)
        if how := self._again():
            raise MeasureAgainError(Text(f"tuning: {whys[-1]}"), how)
        raise RefusedError(Text(f"tuning: {whys[-1]}"))

    def _tuning(self, most_noise: float | None) -> dict[str, Any]:
        """Return options of the tuning that drive and readings decide; `most_noise` (N) is the one asked for."""
        options: dict[str, Any] = {"filters": "placed" if Filter in self.axis.takes else "kept"}
        if self._noise > 0.0:
            # a drive takes an axis that the noise shakes for one that moves, and its limit of force cuts the peaks
            options["reading_noise"] = self._noise
            options["max_noise"] = most_noise or SHAKEN * self._free
        return options

    def _again(self, *, opens: bool = True) -> str:
        """Return how the responses may be measured again, if another trial may be asked for; "" if they may not.

        opens  False after a trial that was as predicted: no play opened

        In a play that opens and closes, a spring is softer the less it is stretched: no control of it can be predicted
        from that.  While the axis slides, friction keeps the play closed as long as the force that shakes the load is
        below it.
        """
        # each trial is a question
        if self.returns.get("tune", 0) + len(self.again) >= len(BEGINS) - 1:
            return ""
        if (
            opens
            and "soft" not in self.again
            and 0.0 < OPENS * CLOSED * self.facts["coulomb"] < self.facts["amplitude"]
        ):
            return "soft"
        highest = max(float(response.frequency[-1]) for response in self._responses().values())
        return "wide" if "wide" not in self.again and highest < WIDER * self._widest else ""

    def _not_tried(self) -> str:
        """Return why the control of this step cannot be tried; "" if a trial of it fits into the limits."""
        self.planned = None
        # a mode of the model above the measured lines, which neither tuning nor certificate has seen
        stability = read_design(self.place / "machine.toml", axis=AXIS).advice
        if stability.judgment.bad:
            return stability.sentence
        try:
            self.planned = self._trial_motion(self._real(self.place / "machine.toml"))
        except UnlikePredictedError as unlike:
            return unlike.why
        except DivergedError as error:
            return Text(f"the trial cannot be predicted: {error}")
        return ""

    def _real(self, machine: Path) -> Loop:
        """Return the loop of a machine file with the force along the travel, from where the axis stands."""
        loop = self._pulled(read_machine(machine).loop(AXIS))
        return loop if stated(self.facts) is None else moved(loop, self._stands())

    def _stands(self) -> float:
        """Return where the axis stands, by the drive's position, m."""
        return float(np.mean(self.axis.listen(motions.REST).log["reading_load"]))

    def _beside(self) -> tuple[FRF, ...]:
        """Return the responses of further motions under the same control, for which its limits hold as well."""
        return ()

    def _points_beside(self) -> tuple[OperatingPoint, ...]:
        return tuple(measured_point(frf, sample_time=self.T, name=frf.output) for frf in self._beside())

    def _start_again(self, slower: float) -> None:
        """Write the model with the start law, all of whose rates are a share of those of its rule."""
        model = self._in("model", "machine.toml")
        loop = read_machine(model).loop(AXIS)
        loop = replace(loop, control=replace(loop.control, law=self._slowed(loop.control.law, slower)))
        with new_directory(self.place) as folder:
            text = self._machine(loop, "safe start law of feeddrive commission")
            write_whole(folder / "machine.toml", with_origins(text, (model,)))

    def _slowed(self, law: Any, share: float) -> Law:
        """Return a law, all of whose rates are a share of what they were."""
        return replace(law, Kv=share * law.Kv, Kp=share * law.Kp, Tn=law.Tn / share)

    def _not_certified(self, outcome: Outcome[Any] | None = None, *, fitted: bool = False) -> str:
        """Return why the machine file of this step cannot be certified by the responses; "" if it can.

        outcome  of the tuning that wrote it
        fitted   a fit of the responses may stand for the model: for a control that was tuned on them
        """
        if outcome is not None and (outcome.judgment.bad or "Machine" not in outcome.files):
            return Text(f"{outcome.verdict} {outcome.failure}")
        try:
            why = self._certificate(self.place / "machine.toml", None)
        except NotCertifiedError as error:
            return str(error)
        return "" if fitted else why

    def _certificate(self, machine: Path, out: Path | None) -> str:
        """Certify the model within the uncertainty that the responses give it, or a fit of the responses alone.

        Returns the reason for the latter, "" for the former. Raises NotCertifiedError if neither can be certified.
        """
        responses, why = self._in("responses", "responses/frf.csv"), ""
        for fit in (False, True):
            try:
                certify.run(
                    CertifyRequest(machine, axis=AXIS, measured=responses, at=self._beside(), fit=fit, out=out),
                    self.progress.quiet(),
                )
            except NotCertifiedError as error:
                if fit:
                    raise
                why = str(error)
            else:
                break
        return why

    def certificate(self) -> tuple[str, Mapping[str, float]]:
        """Prove stability, write the certificate and check it against its sources; nothing moves."""
        machine, responses = self._in("tune", "machine.toml"), self._in("responses", "responses/frf.csv")
        try:
            why = self._certificate(machine, self.place)
        except NotCertifiedError as error:
            raise RefusedError(Text(f"certificate: {error}")) from None
        # a fit of the responses alone is not the model of the machine file, to which it is not compared then
        compared: dict[str, Any] = {} if why else {"machine": machine, "source": (responses,)}
        outcome = check.run(CheckRequest(self.place / "certificate.json", **compared), self.progress.quiet())
        if outcome.judgment.bad:
            raise RefusedError(Text(f"certificate: {outcome.verdict} {outcome.failure}"))
        return Text(f"of a fit of the responses (not of the model: {why})" if why else f"{outcome.verdict}"), {}

    def export(self) -> tuple[str, Mapping[str, float]]:
        """Write the tuned control for the target; nothing moves."""
        outcome = export.run(self._export_request(), self.progress.quiet())
        if outcome.judgment.bad:
            why = next(design.advice.sentence for design in outcome.result if design.judgment.bad)
            raise RefusedError(Text(f"export: {why}"))
        return Text(f"for {self.request.target}, in {self.place.name}"), {}

    def _controlled(self) -> Path:
        """Return the machine file whose control is exported and tried."""
        return self._in("tune", "machine.toml")

    def _export_request(self) -> ExportRequest:
        return ExportRequest(self._controlled(), target=self.request.target, axis=AXIS, out=self.place)

    def run_trial(self) -> tuple[str, Mapping[str, float]]:
        """Run the new control on the drive, and compare following error, stiffness and noise with their predictions."""
        loop = self._real(self._in("tune", "machine.toml"))
        # after an interruption it is planned again
        motion, simulated = self.planned or self._trial_motion(loop)
        expected = self._figures(motion, simulated)
        far = float(np.ptp(motion.alone.set_position))
        self._ask(
            Text(
                f"Trial: the NEW control moves the axis by {Quantity(far, 'm'):3 mm} and back, twice, the second time "
                f"with a pulse of {Quantity(motion.force, 'N'):3}. The prediction: at most "
                f"{Quantity(expected.following_peak, 'm'):3} of following error."
            )
        )
        axis, control = self._under_control(), self._guarded(loop.control, simulated)
        self._try_gently(axis, replace(loop, control=control), motion)
        logs = self._tried(motion, axis, control)
        measured = self._figures(motion, logs)
        before = self._before(motion, float(loop.axis.plant.rigid_mass()), logs)
        self._kept(**logs, **{f"predicted_{name}": log for name, log in simulated.items()})
        self.trial = Trial(expected, measured, before)
        if not self.trial.agrees:
            why = Text(f"the trial is not as predicted: {self.trial.sentence()}, where 90 to 110 % is asked for")
            # friction is in both runs, and not in their difference
            if abs(self.trial.ratio("stiffness") - 1.0) > AGREED and (how := self._again()):
                raise MeasureAgainError(why, how)
            self._learn(loop.control, logs["alone"])
            raise UnlikePredictedError(why, back=None if self.learned is None else "model")
        if self.trial.is_worse and (how := self._again(opens=False)):
            raise MeasureAgainError("the control before has the smaller following error and the larger stiffness", how)
        told = {f"predicted_{name}": value for name, value in self.trial.predicted.values().items()}
        told |= {f"measured_{name}": value for name, value in self.trial.measured.values().items()}
        return self.trial.sentence(), told

    @property
    def _unit(self) -> str:
        """The unit of what a control on trial commands."""
        return "N" if self.axis.commanded == "force" else "m/s"

    @property
    def _most_command(self) -> float:
        """The largest command of a control on trial: limits.force, N, or limits.velocity, m/s."""
        return float(self.limits.force if self.axis.commanded == "force" else self.limits.velocity)

    def _guarded(self, control: Control, simulated: Mapping[str, Log]) -> Control:
        """Return the control with the bound of its guard near to what is predicted, and so while the axis is slow.

        It then brakes on its ramp; in a runaway, which the monitor sees later, friction is all that brakes.
        """
        guard = control.guard
        if guard is None:
            return control
        most = max(ALARM * max(_error(log.channels) for log in simulated.values()), COUNTS * self.axis.increment)
        limit = min(self.limits.following_error, most)
        return replace(control, guard=replace(guard, following_error_limit=limit))

    def _try_gently(self, axis: LiveAxis, loop: Loop, motion: motions.TrialMotion) -> None:
        """Run the new control over a short and slow motion. Raise UnlikePredictedError if it works harder."""
        slow = motion.slower(GENTLE, self.T)
        expected = self._predicted(loop, slow)
        played = self._play(axis, slow, loop.control, step="tune")
        # a limit cycle shows in the changes from sample to sample, long before it leaves the following error
        column, unit, limit = COMMANDED[self.axis.commanded], self._unit, self._most_command
        most, busy = (float(np.std(np.diff(log[column]))) for log in (expected, played.log))
        if busy > HARDLY * most + NERVOUS * limit:
            raise UnlikePredictedError(
                Text(
                    f"the new control oscillates: its command changes by {Quantity(busy, unit):3} RMS from sample to "
                    f"sample, where {Quantity(most, unit):3} was predicted: the model misses a mode or a delay; "
                    "measure the responses to a higher frequency"
                )
            )

    def _tried(self, motion: motions.TrialMotion, axis: LiveAxis, control: Control | None = None) -> dict[str, Log]:
        """Play the motions of a trial; return their logs by name."""
        return {
            name: self._play(axis, profile, control, step=None if control is None else "tune").log
            for name, profile in (("alone", motion.alone), ("pushed", motion.pushed))
        }

    def _expected(self, loop: Loop, motion: motions.TrialMotion) -> dict[str, Log]:
        """Return the logs of a trial as the loop is predicted to answer it."""
        return {"alone": self._predicted(loop, motion.alone), "pushed": self._predicted(loop, motion.pushed)}

    def _figures(self, motion: motions.TrialMotion, logs: Mapping[str, Log]) -> Figures:
        """Return the figures of a trial from its logs, measured or predicted."""
        return figures(motion, logs["alone"], logs["pushed"])

    def _trial_motion(self, loop: Loop) -> tuple[motions.TrialMotion, dict[str, Log]]:
        """Return the fastest motion and the largest pulse that stay within the limits by simulation, and its logs."""
        limits, mass = self.limits, float(loop.axis.plant.rigid_mass())
        free = WORK * self._free
        pace = self._pace(mass)
        for attempt in range(SIZES):
            share = SMALLER**attempt
            pace = self._pace(mass, share)
            travel = max(REACH * limits.travel * share, motions.least_travel(pace))
            motion = motions.trial(travel, pace, free, self.T)
            alone = self._predicted(loop, motion.alone)
            # an axis that friction holds shows nothing of its control
            follows = float(np.ptp(alone["reading_load"])) >= FOLLOWS * travel
            if travel > REACH * limits.travel or not follows or not self._fits(alone):
                continue
            for smaller in range(SIZES):
                weaker = motion.weaker(free * SMALLER**smaller)
                logs = self._expected(loop, weaker)
                slow = _quickened(alone, logs["pushed"]) <= PUSHED * limits.velocity
                if slow and all(map(self._fits, logs.values())):
                    return weaker, logs
        raise UnlikePredictedError(
            Text(
                f"no trial fits into the limits, even at {Quantity(pace.speed, 'm/s'):2}: raise limits.following_error "
                f"= {Quantity(limits.following_error, 'm'):3} or limits.travel = {Quantity(limits.travel, 'm'):3 mm}"
            )
        )

    def _before(self, motion: motions.TrialMotion, mass: float, logs: dict[str, Log]) -> Figures | None:
        """Return the figures of the control that the drive has, if it can follow the trial; its logs are added.

        Its law is not known: the pulse is so small that even a free mass stays within the limit of the velocity.
        """
        speed = float(np.max(np.abs(motion.alone.velocity)))
        if self.facts["lag"] * speed > USED * self.limits.following_error:
            self.progress.remark("- The control before cannot follow the trial within limits.following_error.")
            return None
        force = min(motion.force, 0.5 * (self.limits.velocity - speed) * mass / motions.PULSE)
        weaker = motion.weaker(force)
        try:
            played = self._tried(weaker, self.axis)
        except RefusedError as refused:
            self.progress.remark(Text(f"- The control before was not measured: {refused.why}"))
            return None
        logs |= {f"before_{name}": log for name, log in played.items()}
        return self._figures(weaker, played)

    def _decide(self) -> None:
        """Keep the new control if the trial is as predicted and the user says so; otherwise put the old one back."""
        assert self.trial is not None
        if self.trial.is_worse:
            raise RefusedError(
                "the new control runs as predicted, but the control before has the smaller following error and the "
                "larger stiffness: it stays"
            )
        if not self.request.yes:
            self.questions += 1
            self.progress.remark(self.trial.table())
            if not self.progress.confirm("Keep the new control?"):
                raise RefusedError("the new control was not kept; the control before stays")
        self.progress.remark(self.axis.keep(self._controlled(), self._in("export", ""), self.inside))
        self.kept = True

    def _in(self, name: str, file: str) -> Path:
        """Return a file of the step with this name."""
        return self.folder / f"{list(self.work).index(name) + 1}_{name}" / file


STEPS: Mapping[str, Callable[[Any], Told]] = {
    "listen": Chain.listen,
    "small_move": Chain.small_move,
    "start_law": Chain.start_law,
    "friction_and_mass": Chain.friction_and_mass,
    "excitation": Chain.excitation,
    "responses": Chain.responses,
    "model": Chain.model,
    "tune": Chain.tune,
    "certificate": Chain.certificate,
    "export": Chain.export,
    "trial": Chain.run_trial,
}
"""The steps of a commissioning in order. Each returns a sentence with its result, and its figures in SI."""


def _check_folder(folder: Path) -> None:
    """Raise FileError for a folder that holds something else than a commissioning."""
    if folder.is_dir() and any(folder.iterdir()) and not (folder / FILE).is_file():
        raise FileError(f"{folder}: holds other files, and no {FILE}: give another --out")
