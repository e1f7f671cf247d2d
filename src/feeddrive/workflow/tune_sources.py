"""The inputs of a tuning: machine files, and measured responses by role, in m/N, checked for common mistakes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from feeddrive.files.columns import unit_of
from feeddrive.files.frf import FrfLike, read_frfs
from feeddrive.files.machine import BUNDLED, MachineFile, MachineLike, read_machine
from feeddrive.identification.response.plant_fit import fit_modal_axis
from feeddrive.language import units
from feeddrive.language.errors import FeeddriveError, ParameterError, nearest
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import control_with
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.operating_point import READINGS, OperatingPoint, measured_point, with_table_force
from feeddrive.tuning.recipes import margin_goals
from feeddrive.workflow.readings import check_response
from feeddrive.workflow.request import called, stem, told_apart

LOAD = ("reading_load", "position_load", "load")
MOTOR = ("reading_motor", "position_motor", "motor")
_BASELINE = "the plant of the baseline"
_NONE = "none"  # --motor none: the axis has one encoder
_SIZE = 3.0  # by which a response may differ from the baseline's plant before its unit is doubted
_BACKWARD = (math.radians(45.0), math.radians(150.0))  # phase of velocity over force that only a wrong sign gives
_OF_A_FIT = 250  # lines
_APART = 0.25  # by which motor and load move differently where one encoder is not enough


@dataclass(frozen=True)
class Measurement:
    """Responses of one position and load: of the load, of the motor (a file, its name, or none), and of the hammer."""

    load: FrfLike
    motor: str | None = None
    struck: Path | FRF | None = None
    struck_motor: Path | FRF | None = None

    @property
    def name(self) -> str:
        """The file of the load, by which errors call it."""
        return called(self.load)


@dataclass(frozen=True)
class Sources:
    """An axis at one or several positions and loads: machines, loops, points, and measured responses.

    source, at   what is tuned, and the same at other places
    axis         of machine files with several
    motor        response of the motor's encoder: files or names; `none` if there is one encoder
    disturbance, disturbance_motor  responses to a force on the table
    unit, sample_time, delay        of the responses, where they do not say it
    """

    source: MachineLike | Loop | FrfLike | OperatingPoint | None
    at: Sequence[MachineLike | Loop | FrfLike | OperatingPoint] = ()
    axis: str | None = None
    motor: Sequence[str] = ()
    disturbance: Path | FRF | None = None
    disturbance_motor: Path | FRF | None = None
    unit: str | None = None
    sample_time: float | None = None
    delay: float = 0.0


def points_of(given: Sources, loop: Loop | None, progress: Progress) -> tuple[list[OperatingPoint | Loop], list[str]]:
    """The axis at every place: machines, loops and points as they are, and measurements; and what must be said."""
    first, *others = (
        each if isinstance(each, OperatingPoint) else loop_or_response(each, given.axis)
        for each in (given.source, *given.at)
        if each is not None  # as of a study, which gives machines of its own
    )
    measured = [each for each in others if not isinstance(each, OperatingPoint | Loop)]
    found: list[OperatingPoint | Loop] = []
    if isinstance(first, OperatingPoint | Loop):
        if given.motor or given.disturbance:
            raise ParameterError(
                "--motor and --disturbance belong to a measured response: leave them out for a machine"
            )
        found.append(first)
        places = [Measurement(each) for each in measured]
    else:
        hammer = Measurement(first, None, given.disturbance, given.disturbance_motor)
        places = several(hammer, measured, given.motor)
    remarks: list[str] = []
    names = told_apart((stem(each.load), Path(each.name).parent.name) for each in places)
    for each, name in zip(places, names, strict=True):
        progress.step(f"reading {Path(each.name).name}")
        point, words = point_of(each, name, loop, given.sample_time, given.delay, given.unit, progress)
        found.append(point)
        remarks += words
    return [*found, *(each for each in others if isinstance(each, OperatingPoint | Loop))], remarks


def first_control(law: str | None, loop: Loop | None, points: Sequence[OperatingPoint | Loop]) -> tuple[Control, str]:
    """Where a search begins: today's control, another law on the same axis, or a P-PI by robust margins.

    Today's law by name gets an integral where today's control has none.
    And what stands in the place of today's control, if there is none.
    """
    if loop is None:
        if law not in (None, "cascade_ppi"):
            raise ParameterError(f"--law {law} needs a machine to take its model from: give it with --baseline")
        return Control(law=replace(margin_goals(points[0]).law, velocity_encoder="motor")), "rule margins-robust"
    if law is None or (law == loop.control.law.kind and has_integral(loop.control, loop.sample_time)):
        return loop.control, ""
    begun = control_with(loop, law)
    keeps = law == loop.control.law.kind and not has_integral(begun, loop.sample_time)
    return loop.control if keeps else begun, ""


def has_integral(control: Control, sample_time: float) -> bool:
    """Whether a constant force on the table leaves no offset."""
    return ControlResponse(control, float(sample_time), ()).integrates(())


def machine_of(source: object) -> MachineFile | None:
    """The machine in a TOML file or bundled under a name, or one that was read; None for what is none."""
    if isinstance(source, MachineFile):
        return source
    if not isinstance(source, str | Path):
        return None
    given = Path(source)
    bundled = not given.suffix and not given.exists()
    if given.suffix.lower() == ".toml" or (bundled and (BUNDLED / "machines" / f"{source}.toml").exists()):
        return read_machine(source)
    if bundled:
        names = [each.stem for each in (BUNDLED / "machines").glob("*.toml")]
        raise ParameterError(
            f"{source}: is neither a file nor the name of a bundled machine{nearest(str(source), names)}"
        )
    return None


def loop_or_response(source: MachineLike | Loop | FrfLike, axis: str | None) -> Loop | FrfLike:
    """The loop of a machine's axis; a loop, and a measured response with its file, as they are."""
    if isinstance(source, Loop | FRF):
        return source
    machine = machine_of(source)
    if machine is not None:
        return machine.loop(axis)
    assert not isinstance(source, MachineFile)
    return source


def point_of(
    given: Measurement,
    name: str,
    loop: Loop | None,
    sample_time: float | None,
    delay: float,
    unit: str | None,
    progress: Progress,
) -> tuple[OperatingPoint, list[str]]:
    """The measured point, and what must be said of it. Raises ParameterError for what does not fit, with what to do."""
    turns = loop is not None and loop.axis.rotary
    found = {key: in_metres(given.name, frf, unit, turns) for key, frf in read_frfs(given.load).items()}
    load, motor = _roles(given, found, unit, turns)
    remarks = [
        words
        for each in (load, motor)
        if each is not None and loop is None and (words := check_response(given.name, each, unit is not None, progress))
    ]
    step = sample_time or load.sample_time or (None if loop is None else float(loop.sample_time))
    if step is None:
        raise ParameterError(
            f"{given.name}: does not say with which sample time the control runs: give it with --sample-time, or "
            f"today's machine with --baseline"
        )
    struck = None
    if given.struck is not None:
        back = None if given.struck_motor is None else _only(given.struck_motor, unit, turns)
        if motor is not None and back is None:
            raise ParameterError(
                "--disturbance with two encoders needs --disturbance-motor: the motor's answer to the hammer"
            )
        struck = (_only(given.struck, unit, turns), back)
    for each in (load, motor):
        if each is not None:
            _check_sign(given.name, each)
    point = measured_point(load, motor, disturbance=struck, sample_time=step, delay=delay, name=name)
    if loop is not None:
        _check_size(given.name, point, loop, stated=bool(load.unit) or unit is not None)
        if motor is None and given.motor != _NONE:
            _check_encoders(given.name, loop)
    if point.at_drive:
        point, words_ = _on_the_table(point, loop, load, motor, step)
        remarks += words_
    elif loop is not None:
        point, words = with_table_force(point, loop, _BASELINE)
        remarks += [words] if words else []
    if not load.unit and unit is None:
        remarks.append(f"{given.name} does not say its unit: it counts as m/N (--unit)")
    return point, remarks


def _roles(given: Measurement, found: dict[str, FRF], unit: str | None, turns: bool) -> tuple[FRF, FRF | None]:
    """Response of the load, and of the motor if there is one: from one file or from two."""
    by_output = {frf.output: key for key, frf in found.items()}
    names = {**by_output, **{key: key for key in found}}
    if given.motor is None and len(found) > 1:
        motor = next((names[each] for each in MOTOR if each in names), None)
        load = next((names[each] for each in LOAD if each in names), None)
        if motor is None or load is None:
            raise ParameterError(
                f"{given.name}: holds {len(found)} responses: {', '.join(found)}; say which one is the motor's with "
                f"--motor NAME (the other one is the table's)"
            )
        return found[load], found[motor]
    if given.motor is not None and given.motor in names:
        others = [key for key in found if key != names[given.motor]]
        if len(others) != 1:
            raise ParameterError(f"{given.name}: beside '{given.motor}' there must be one response, not {len(others)}")
        return found[others[0]], found[names[given.motor]]
    if len(found) > 1:
        raise ParameterError(
            f"{given.name}: holds {len(found)} responses, {', '.join(found)}: a file for one encoder must hold one"
        )
    load = next(iter(found.values()))
    return load, None if given.motor in (None, _NONE) else _only(given.motor, unit, turns)


def _only(given: FrfLike, unit: str | None, turns: bool) -> FRF:
    found, path = read_frfs(given), called(given)
    if len(found) != 1:
        raise ParameterError(f"{path}: holds {len(found)} responses, {', '.join(found)}: one is wanted here")
    return in_metres(path, next(iter(found.values())), unit, turns)


def in_metres(path: str, frf: FRF, unit: str | None, turns: bool) -> FRF:
    """The response in m/N, or the same number of rad/(N m) if the axis turns: other units are converted to it.

    A velocity is integrated.  Raises ParameterError for what is no response of such an axis.
    """
    stated = unit or frf.unit
    f = frf.frequency
    by_order = {"m/N": 1.0 + 0.0 * f, "(m/s)/N": 1.0 / (2j * np.pi * f), "(m/s2)/N": -1.0 / (2.0 * np.pi * f) ** 2}
    wanted = {units.turning(each) if turns else each: whole for each, whole in by_order.items()}
    if stated in ("", "m/N"):  # responses of models are in m/N, also where the axis turns
        return frf
    known = units.response(unit_of(stated) or stated)
    if known is not None and known[0] in wanted:
        whole = known[1] * wanted[known[0]]
        variance = None if frf.variance is None else np.abs(whole) ** 2 * frf.variance
        return replace(frf, response=whole * frf.response, variance=variance, unit="m/N")
    if turns:
        needed = "angle (rad, deg, mdeg), its velocity or acceleration over torque (N m), since the axis turns"
    else:
        needed = (
            "position (m, um, mm), velocity or acceleration over force (N); turn torque into force and angle into "
            "travel by the lead first, or give the machine of an axis that turns (rotary = true) with --baseline"
        )
    raise ParameterError(f"{path}: the response from {frf.input} to {frf.output} is in {stated}: it must be {needed}")


def _check_sign(path: str, frf: FRF) -> None:
    """A force pushes the axis its own way: its velocity lags by 90° for a free mass, by 0° where friction holds it."""
    lines = slice(0, max(5, frf.frequency.size // 20))
    turned = np.angle(np.sum(frf.frequency[lines] ** 2 * frf.response[lines] * 1j / frf.frequency[lines]))
    if _BACKWARD[0] < turned < _BACKWARD[1]:
        raise ParameterError(
            f"{path}: the axis moves against the force ({Quantity(turned, 'rad'):3 deg} from force to velocity at "
            f"{Quantity(frf.frequency[0], 'Hz')}): the sign of force or position is reversed; multiply the response by "
            "-1"
        )


def _check_size(path: str, point: OperatingPoint, loop: Loop, *, stated: bool) -> None:
    """A response without a unit that is many times what the baseline's plant gives is in another unit."""
    model = linearize(loop, ["cut"], READINGS)
    low = point.frequency <= 3.0 * point.frequency[0]
    true = model.response(point.frequency[low], READINGS[1], "cut").response
    ratio = float(np.median(np.abs(point.by_force[1, low] / true)))
    if not stated and not 1.0 / _SIZE < ratio < _SIZE:
        guess = {3: "mm/N", 6: "um/N", 9: "nm/N"}.get(round(math.log10(ratio)) if ratio > 0.0 else 0)
        hint = f", as if it were in {guess}" if guess else ""
        raise ParameterError(
            f"{path}: is {number(ratio, 3)} times what the baseline's plant does at "
            f"{Quantity(point.frequency[0], 'Hz')}{hint}, and it states no unit: say it with --unit (m/N if it is "
            "right and the baseline's mass is not)"
        )


def _check_encoders(path: str, loop: Loop) -> None:
    """One response is not enough for a law that reads both encoders of an axis with a spring between them."""
    T = float(loop.sample_time)
    model = linearize(loop, ["cut"], READINGS)
    lines = np.geomspace(1.0, 0.3 / T, 60)
    motor, load = (model.response(lines, each, "cut").response for each in READINGS)
    C = ControlResponse(loop.control, T, ()).at((), lines).value
    near = np.abs(C[0] * motor + C[1] * load) > 0.3
    both = bool(np.max(np.abs(C[0])) > 1e-6 * np.max(np.abs(C[1])))
    if both and np.any(np.abs(motor / load - 1.0)[near] > _APART):
        raise ParameterError(
            f"{path}: holds one response, but '{loop.control.law.kind}' reads the encoder of the motor too, and on "
            f"this axis both differ: give the motor's with --motor FILE (or its name in the file), or "
            f"--motor none if there is only one encoder"
        )


def _on_the_table(
    point: OperatingPoint, loop: Loop | None, load: FRF, motor: FRF | None, step: float
) -> tuple[OperatingPoint, list[str]]:
    """The point with a force on the table by the baseline's plant, else by a fit of modes to both encoders."""
    said: list[str] = []
    if loop is not None:
        made, words = with_table_force(point, loop, _BASELINE)
        if not made.at_drive:
            return made, [words]
        said.append(words)
    if motor is None:
        return point, said
    try:
        # what a control reads and commands is sampled and held, also where a file does not say so
        at_motor, at_load = (replace(_fewer(each), sample_time=step) for each in (motor, load))
        fit = fit_modal_axis(at_motor, at_load)
        plant, actuator = fit.blocks()
        control = Control(law=margin_goals(point).law) if loop is None else loop.control
        fitted = Loop(control=control, axis=Axis(plant=plant, actuator=actuator), sample_time=step)
        made, words = with_table_force(point, fitted, f"a fit of {len(getattr(plant, 'modes', ()))} modes", run=False)
    except FeeddriveError as error:
        return point, [*said, Text(f"no plant could be fitted for a force on the table: {error}")]
    return made, [words] if not made.at_drive else [*said, words]


def several(first: Measurement, others: Sequence[FrfLike], motors: Sequence[str]) -> list[Measurement]:
    """The first measurement and those at other places; a motor's file stands for one place, a name for all."""
    named = [each for each in motors if each == _NONE or not Path(each).suffix]
    if len(motors) > 1 and (named or len(motors) != 1 + len(others)):
        raise ParameterError(
            f"--motor was given {len(motors)} times: once for each place, which are {1 + len(others)}, in the order of "
            f"SOURCE and --at, or once with the name that it has in every file"
        )
    if motors and not named and len(motors) != 1 + len(others):
        raise ParameterError(
            f"--motor is missing for {len(others)} place(s): give a file for SOURCE and one for each --at, in that "
            f"order"
        )
    each_motor = [*motors] * (1 if len(motors) == 1 + len(others) else 1 + len(others)) if motors else []
    rest = [Measurement(other, each_motor[i + 1] if each_motor else None) for i, other in enumerate(others)]
    return [replace(first, motor=each_motor[0] if each_motor else None), *rest]


def _fewer(frf: FRF) -> FRF:
    """The response on lines that a fit of modes takes in a second or two, evenly over ln f."""
    x = np.log(frf.frequency)
    kept = np.unique(np.searchsorted(x, np.linspace(x[0], x[-1], _OF_A_FIT)).clip(0, x.size - 1))
    variance = None if frf.variance is None else frf.variance[kept]
    return replace(frf, frequency=frf.frequency[kept], response=frf.response[kept], coherence=None, variance=variance)
