"""`feeddrive tune`: tune a controller from a machine file or a measured frequency response."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from feeddrive.certificate.certificate import Certificate
from feeddrive.export.parameters import SINUMERIK, parameters_table
from feeddrive.figures.catalogue import goals, limitable
from feeddrive.figures.figure import Figure
from feeddrive.files.commissioning import read_commissioning
from feeddrive.files.drive import axis_name
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.origins import with_origins
from feeddrive.language.errors import ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.box import AUTO, Box
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.study.study import StudyLike, read_study
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.operating_point import OperatingPoint
from feeddrive.tuning.recipes import RECIPES, JudgedRecipe, judged_recipes
from feeddrive.tuning.tune import Tuned, Verdict, assess, tune_control
from feeddrive.workflow.certify import certified
from feeddrive.workflow.command import (
    AT_THE_MODEL,
    BOX,
    OF_ERRORS,
    OUT,
    Outcome,
    Request,
    argument,
    called,
    command,
    exporting,
    frequencies,
    line,
    option,
    stem,
)
from feeddrive.workflow.commissioning import DriveAxis, drive_axis
from feeddrive.workflow.tune_files import Story, machine_text, tables, tuned_report, write_tuned
from feeddrive.workflow.tune_sources import Sources, first_control, machine_of, points_of

# options that exclude --study: its machines are models, and its job names the axis
_ALONE = {
    "recipe": None,
    "baseline": None,
    "axis": None,
    "at": (),
    "motor": (),
    "disturbance": None,
    "disturbance_motor": None,
    "unit": None,
    "sample_time": None,
    "delay": 0.0,
    "confidence": 0.95,
}


NO_MODEL = (
    "the box needs a model of the plant, and here are measured responses only: the limits hold for the responses at "
    "all places, with their noise; give more places with --at, or a machine whose plant agrees with --baseline"
)


NO_ERRORS = (
    "--box identified takes the standard errors of a machine file: give the file that feeddrive identify wrote, as the "
    "machine or as --baseline, or take --box standard"
)


def limit_options() -> dict[str, tuple[str, Any]]:
    """Return the options for the limits in the catalog of figures, by name."""
    options: dict[str, tuple[str, Any]] = {}
    for figure in limitable():
        limit = figure.limit
        assert limit is not None
        options[limit.option] = (
            # annotations as text: `fields_of` resolves them like those written in the class
            "float" if limit.usual is not None else "float | None",
            option(
                limit.meaning,
                unit=figure.unit,
                entered=limit.entered,
                above=limit.above,
                below=limit.below,
                default=limit.usual,
            ),
        )
    return options


class TuneRequest(Request, more=limit_options(), after="recipe"):
    """The axis or its measured response, the goal of the tuning, and the limits to satisfy.

    Limits are in SI here: compliance in m/N, measurement noise in m. On the command line they are in um/N and nm.
    """

    source: MachineLike | Loop | FRF | OperatingPoint | None = argument(
        "A machine file (TOML), the name of a bundled machine, or a measured response in m/N", default=None
    )
    goal: str = option("goal of the tuning", default="rope-snap", options=tuple(goals()))
    law: str | None = option(
        'another law: its kind, as pole_placement, or its name in a comparison, as "P-PI + DOB"; with --study also '
        "every",
        default=None,
    )
    recipe: str | None = option("a tuning rule instead of a search", options=tuple(RECIPES), default=None)
    reading_noise: float = option("noise of the readings, RMS, white", default=0.0, unit="m", entered="nm", least=0.0)
    box: str = option(BOX, default=AUTO)
    step_force: float | None = option(
        "a force step of this size on the table must not drive the command to the force limit of the control",
        unit="N",
        above=0.0,
        default=None,
    )
    band: str | None = option("band of the stiffness, as 1..30 in Hz", default=None)
    filters: str = option("filters: kept, free, or placed (free, and notches where they pay)", default="placed")
    baseline: MachineLike | None = option("today's machine file, to compare with and to write into", default=None)
    axis: str | None = option("its axis, if it has several", default=None)
    at: tuple[MachineLike | Loop | FRF | OperatingPoint, ...] = option(
        "the same axis at another position or load; may be repeated", default=()
    )
    motor: tuple[str, ...] = option(
        "response of the motor's encoder: a file, or its name in the files; once, or once for each place; none if "
        "there is one encoder",
        default=(),
    )
    disturbance: Path | FRF | None = option("response to a force on the table", default=None)
    disturbance_motor: Path | FRF | None = option(
        "response of the motor's encoder to a force on the table", default=None
    )
    unit: str | None = option("unit of the responses, as um/N, if the files do not state it", default=None)
    sample_time: float | None = option("sample time of the control", unit="s", above=0.0, default=None)
    delay: float = option(
        "dead time that the response does not hold: 0 if it leads from the commanded force",
        default=0.0,
        unit="s",
        least=0.0,
    )
    confidence: float = option("probability that all limits hold on the true axis", default=0.95)
    starts: int = option("number of searches; the best end counts", default=2, least=1, most=20)
    seed: int = option("seed of the searches after the first", default=0)
    study: StudyLike | None = option(
        "a study file or the name of a bundled one, in place of a machine: one control for all its machines",
        default=None,
    )
    share: float = option(
        "share of the study's machines for which limits and goal count", default=1.0, least=0.5, most=1.0
    )
    samples: int | None = option("machines of the study that the tuner may see", default=None, least=1, most=5000)
    fresh: int | None = option("further machines on which the result is proven", default=None, least=16, most=1_000_000)
    allow: tuple[str, ...] = option(
        "A module with figures of your own for the study, whose code is then run; may be repeated", default=()
    )
    out: Path | None = option(OUT, short="-o", default=None)

    def check(self) -> None:
        """Raise ParameterError for incompatible options."""
        if (self.source is None) == (self.study is None):
            raise ParameterError("give either a machine or a response, or --study with a study of many machines")
        beside = [name for name, default in _ALONE.items() if getattr(self, name) != default]
        if self.study is not None and beside:
            flag = beside[0].replace("_", "-")
            raise ParameterError(f"--{flag} belongs to one machine or response, and not to --study")
        if self.recipe is not None and self.law not in (None, "cascade_ppi"):
            raise ParameterError(f"--recipe gives a cascade_ppi, not --law {self.law}: leave one of them out")
        Box.parse(self.box)
        for figure, bound in self._bounds():
            limit = figure.limit
            if limit is not None and limit.noise and bound is not None and self.reading_noise == 0.0:
                flag = limit.option.replace("_", "-")
                raise ParameterError(f"--{flag} needs --reading-noise (in nm): the errors of the two readings")

    def limits(self) -> Limits:
        """Return the limits of the tuned loop."""
        bounds = {figure.key: bound for figure, bound in self._bounds()}
        # the noise gain is defined for white noise of equal size in both readings
        noise = (self.reading_noise, self.reading_noise)
        return Limits((), reading_noise=noise, snap_force=self.step_force, **bounds)

    def _bounds(self) -> list[tuple[Figure, float | None]]:
        """Return pairs of a figure that can be limited and its limit; the limit is None if it is not set."""
        return [(figure, getattr(self, figure.limit.option)) for figure in limitable() if figure.limit is not None]

    def sources(self) -> Sources:
        """Return the machine files or measured responses of the axis at all requested positions and loads."""
        return Sources(
            self.source,
            self.at,
            self.axis,
            self.motor,
            self.disturbance,
            self.disturbance_motor,
            self.unit,
            self.sample_time,
            self.delay,
        )

    def usual_out(self) -> Path:
        return Path("results") / f"tune_{stem(self.study if self.source is None else self.source)}"


@command(TuneRequest)
def tune(request: TuneRequest, progress: Progress) -> Outcome[Any]:
    """Tune gains and filters of an axis within limits; write machine file, certificate and report on request.

    The result is a `Tuned` or, for a study, a `Robust`.

    If the tuned loop violates a limit or a proof fails, no machine file is written and the judgment of the outcome is
    negative (`judgment.bad`).
    """
    progress.step("reading")
    if request.study is not None:
        return _of_study(request, progress)
    tuned, story, text, name, certificate, makers = _tuned(request, progress)
    files: dict[str, Path] = {}
    if request.out is not None:
        progress.step("report")
        report = write_tuned(tuned, text, name, request.out, story, certificate)
        if text is not None:
            kind = "Machine, with values that are not recommended" if tuned.verdict is Verdict.LEAVE else "Machine"
            files[kind] = report.parent / "machine.toml"
        if tuned.holds and certificate is not None:
            files["Certificate"] = report.parent / "certificate.json"
        files["Report"] = report
    verdict = {None: "not proven", True: "holds", False: "DOES NOT HOLD"}
    proof = [(line.holds, Text(f"proof, {line.what}: {verdict[line.holds]} ({line.text})")) for line in tuned.proof]
    remarks: list[str] = [claim for holds, claim in proof if not holds]
    remarks += [*story.remarks, *(Text(f"held back by {held.sentence()}") for held in tuned.held), *tuned.advice]
    # the last table is the proof, which is shown as sentences instead
    shown = tables(tuned, story)[:-1]
    first = 1 + len(tuned.after)  # the values, and the figures at each point
    details = [
        *shown[first:],
        *(claim for holds, claim in proof if holds),
        *(Text(f"notch {notch}") for notch in tuned.notches),
    ]
    taken = Judgment.LEAVE_CONTROL if tuned.verdict is Verdict.LEAVE else Judgment.TAKE_TUNING
    judgment = taken if tuned.holds else Judgment.DO_NOT_USE_TUNING
    written, told = files.get("Machine"), request.source if isinstance(request.source, str | Path) else None
    then, notes = "", tuple[str, ...]()
    if written is not None:
        then, notes = exporting(written, request.axis, guarded=tuned.control.guard is not None)
        if makers:
            parameters = line("export", written, "-t", "parameters", "--maker", SINUMERIK.key)
            notes = (*notes, f"The parameters of the control, with their sources, once there is a guard: {parameters}.")
    # with these limits nothing is gained by other gains of this law: another law may gain something
    elif told is not None and machine_of(told) is not None:
        then = line("compare", told, axis=request.axis)
    if tuned.box is None and tuned.loops:
        notes = (*notes, AT_THE_MODEL)
    if tuned.box is not None and tuned.box.box.deviations:
        notes = (*notes, OF_ERRORS)
    return Outcome(
        tuned,
        [*shown[:first], *makers],
        remarks,
        tuned.recommendation(),
        notes,
        files=files,
        details=details,
        judgment=judgment,
        failure=judgment.says if judgment.bad else "",
        rotary=story.rotary,
        page=partial(tuned_report, tuned, story),
        then=then,
    )


def _of_study(request: TuneRequest, progress: Progress) -> Outcome[Any]:
    """Tune one controller for all machines of a study."""
    # imported on use: it loads the sweeps, which tuning one axis does not need
    from feeddrive.study.robust import RobustTuner
    from feeddrive.workflow.tune_study import tuned_study

    assert request.study is not None
    tuner = RobustTuner(
        read_study(request.study, request.allow),
        goal=request.goal,
        limits=request.limits(),
        filters=request.filters,
        band=_band(request),
        share=request.share,
        samples=request.samples,
        fresh=request.fresh,
        starts=request.starts,
        seed=request.seed,
        box=_plain_box(request.box),
        progress=progress,
    )
    again = {"Study": called(request.study), "Again": request.command_line("tune"), "In Python": request.python("tune")}
    return tuned_study(tuner, request.law, request.out, again)


def _plain_box(text: str) -> Box | None:
    """Return the box beside the machines of a study; none by default, since the study states what varies.

    Raises ParameterError for one by standard errors.
    """
    box = None if text.strip() == AUTO else Box.parse(text)
    if box is not None and box.deviations:
        raise ParameterError(f"{NO_ERRORS}, and a study varies its machines by what it states")
    return box


def _tolerances(request: TuneRequest, modelled: bool, base: MachineFile | None) -> Box | None:
    """Return the box of a tuning. By default only the result of a search on a model has one.

    A rule knows no limits, and a measured response has its own standard deviations.
    """
    if request.box.strip() == AUTO and (request.recipe is not None or not modelled):
        return None
    return Box.parse(request.box) if base is None else base.box(request.box, request.axis)


def _band(request: TuneRequest) -> tuple[float, float]:
    return (0.0, math.inf) if request.band is None else frequencies(request.band)


def _tuned(
    request: TuneRequest, progress: Progress
) -> tuple[Tuned, Story, str | None, str, Certificate | None, list[Table]]:
    """Tune; return result, report data, machine file text, axis name, certificate, and table of drive parameters."""
    drive = _commissioned(request.source, request, progress)
    if drive is not None:
        request = _at_its_margins(request, drive)
    machine = machine_of(request.source) if drive is None else drive.machine()
    base = machine if request.baseline is None else read_machine(request.baseline)
    direct = request.source if isinstance(request.source, Loop) else None
    loop = direct if base is None else base.loop(request.axis)
    # an entered sample time need not have the bits of that in the file
    if loop is not None and request.sample_time and abs(request.sample_time / float(loop.sample_time) - 1.0) > 1e-6:
        raise ParameterError(
            f"--sample-time {Quantity(request.sample_time, 's'):6 SI} is not that of the machine file, "
            f"{Quantity(float(loop.sample_time), 's'):6 SI}: leave it out, or change sample_time there"
        )
    limits = request.limits()
    name = axis_name(loop, request.axis)
    sources = request.sources()
    said: list[str] = []
    if drive is not None:
        if loop is not None and loop.axis.rotary != drive.today.axis.rotary:
            kinds = ("turns", "is linear") if drive.today.axis.rotary else ("is linear", "turns")
            raise ParameterError(
                f"{drive.file.name}: its axis {kinds[0]} and that of --baseline {kinds[1]}: leave --baseline out, or "
                "identify the machine file with --lead"
            )
        point, words = drive.point()
        places = [_commissioned(place, request, progress) for place in sources.at]
        at = tuple(
            place if other is None else other.point()[0] for place, other in zip(sources.at, places, strict=True)
        )
        sources = replace(sources, source=point, motor=(), at=at)
        said = [*_asked_margins(request, drive), *drive.remarks, *words]
    points, remarks = points_of(sources, loop, progress)
    remarks = [*said, *remarks]
    control, begun = first_control(request.law, loop, points)
    band = _band(request)
    tolerances = _tolerances(request, machine is not None or direct is not None, base)
    if tolerances is not None and tolerances.deviations and not tolerances.known:
        raise ParameterError(NO_ERRORS)
    today = None if loop is None else loop.control
    if request.recipe is not None:
        recipe = RECIPES[request.recipe](points[0], control)
        rule = Text(f"{recipe.name}: {recipe.reason} ({recipe.source})")
        tuned = assess(
            replace(control, law=recipe.law, compensation=()),
            points,
            rule=rule,
            goal=request.goal,
            limits=limits,
            band=band,
            confidence=request.confidence,
            today=today,
            box=tolerances,
            progress=progress,
        )
    else:
        tuned = tune_control(
            control,
            points,
            goal=request.goal,
            limits=limits,
            filters=request.filters,
            confidence=request.confidence,
            starts=request.starts,
            seed=request.seed,
            today=today,
            band=band,
            box=tolerances,
            progress=progress,
        )
    if tolerances is not None and tuned.box is None:
        remarks.append(NO_MODEL)
    rules: tuple[JudgedRecipe, ...] = ()
    # the rules of the trade give the gains of a P-PI cascade only
    if tuned.control.law.kind == "cascade_ppi":
        rules = judged_recipes(points, control, limits, progress)
    what = f"{base.name}, axis {name}" if base is not None else Path(called(request.source)).name
    facts = {
        "Source": ", ".join(map(called, (request.source, *request.at))),
        "Today": begun or what,
        "Law": control.law.kind,
        "Sample time": Text(f"{Quantity(float(points[0].sample_time), 's'):6}"),
        "Box": Text() if tuned.box is None else Text(f"{tuned.box.text}; {tuned.box.covered}"),
        "Loops judged": str(tuned.evaluations),
        "Searches": "none, a rule"
        if tuned.recipe
        else Text(
            f"{tuned.agreed[1]}, of which {tuned.agreed[0]} end within 5 % of the best; seed {request.seed}, all ends "
            f"{Quantity(tuned.spread, 'share'):2} apart"
        ),
        "Again": request.command_line("tune"),
        "In Python": request.python("tune"),
    }
    text = None if base is None or not tuned.holds else machine_text(base, name, tuned.control)
    text = None if text is None else with_origins(text, (base, request.source, *request.at, *request.motor))
    progress.step("certificate")
    # a control that violates a limit is not proposed, so it needs no proof
    certificate, facts["Certificate"] = certified(tuned.control, points, text, name) if tuned.holds else (None, "")
    rotary = loop is not None and loop.axis.rotary
    noted = tuple(remarks)
    story = Story(
        what, {k: v for k, v in facts.items() if v}, rules, noted, begun or "today", rotary, _loops(tuned, loop)
    )
    return tuned, story, text, name, certificate, _in_its_names(tuned, drive)


def _in_its_names(tuned: Tuned, drive: DriveAxis | None) -> list[Table]:
    """Return a table of the new control in the parameters of the drive of the commissioning file."""
    if drive is None or not tuned.holds or tuned.control.law.kind != "cascade_ppi":
        return []
    return [parameters_table(SINUMERIK, replace(drive.today, control=tuned.control))]


def _commissioned(source: object, request: TuneRequest, progress: Progress) -> DriveAxis | None:
    """Return the axis of a commissioning file; None for any other source.

    If a requested motor response is not in the file, the file is treated as ordinary frequency responses.
    """
    if not isinstance(source, str | Path) or not Path(source).is_file():
        return None
    file = read_commissioning(source)
    if file is None or not file.plants or any(motor not in file.plants for motor in request.motor):
        return None
    return drive_axis(file, progress, motor=next(iter(request.motor), None), sample_time=request.sample_time)


# limits of the request that a commissioning file states, in the order in which it does
_MARGINS = ("gain_margin", "phase_margin")


def _at_its_margins(request: TuneRequest, drive: DriveAxis) -> TuneRequest:
    """Return the request with the margins stated in the commissioning file, unless the user set a margin."""
    if any(getattr(request, name) is not None for name in _MARGINS):
        return request
    return replace(request, **dict(zip(_MARGINS, drive.file.margins, strict=True)))


def _asked_margins(request: TuneRequest, drive: DriveAxis) -> list[str]:
    """Return a remark if the tuning limits are the margins stated in the file."""
    gain, phase = drive.file.margins
    if tuple(getattr(request, name) for name in _MARGINS) != (gain, phase):
        return []
    asked = [] if gain is None else [Text(f"{Quantity(gain, 'dB'):3}")]
    asked += [] if phase is None else [Text(f"{Quantity(phase, 'deg'):3}")]
    return [Text(f"tuned at the margins that the file asks for: {joined(' and ', asked)}")] if asked else []


def _loops(tuned: Tuned, loop: Loop | None) -> dict[str, Loop]:
    """Return the loops with the old and the new controller, except any that is unstable at an operating point."""
    if loop is None:
        return {}
    both = {"today": (loop, tuned.before), "new": (replace(loop, control=tuned.control), tuned.after)}
    return {name: variant for name, (variant, row) in both.items() if row and all(point.stable for point in row)}
