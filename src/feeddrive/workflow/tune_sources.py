"""The inputs of a tuning: machine files, and measured responses in m/N by role, checked for common mistakes."""

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
from feeddrive.loop.loop import Loop, response_unit
from feeddrive.tuning.candidates import control_with
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.operating_point import READINGS, OperatingPoint, measured_point, with_table_force
from feeddrive.tuning.recipes import margin_goals
from feeddrive.workflow.channels import check_response
from feeddrive.workflow.command import called, stem, told_apart

LOAD = ("reading_load", "position_load", "load")
MOTOR = ("reading_motor", "position_motor", "motor")
_BASELINE = "the plant of the baseline"
_NONE = "none"  # --motor none: the axis has one encoder
# factor to the baseline's plant beyond which the unit of a response is doubted: a wrong mass of the baseline is
# within it, a wrong prefix of the unit (1000) far beyond
_SIZE = 3.0
_BACKWARD = (math.radians(45.0), math.radians(150.0))  # phase of velocity/force: wrong sign
# lines of a modal fit: over three decades they are 2.8 % apart, and a mode with a damping ratio of 2 % is 4 % wide at
# half of its power
_OF_A_FIT = 250
_APART = 0.25  # relative difference of motor and load beyond which one encoder is not enough


@dataclass(frozen=True)
class Measurement:
    """The responses of the load and the motor encoder at one operating point, and those to a hammer blow on the table.

    `motor` is a file or the name of a response; `none` if there is only one encoder.
    """

    load: FrfLike
    motor: str | None = None
    struck: Path | FRF | None = None
    struck_motor: Path | FRF | None = None

    @property
    def name(self) -> str:
        """The display name of the load response, by which error messages name the measurement."""
        return called(self.load)


@dataclass(frozen=True)
class Sources:
    """An axis at one or several positions and loads: machines, loops, points, and measured responses.

    source, at   the axis to tune, and the same axis at other positions and loads
    axis         axis name in machine files with several axes
    motor        responses of the motor encoder: files or names; `none` if there is only one encoder
    disturbance, disturbance_motor  responses of the load and the motor to a force on the table
    unit, sample_time, delay        properties of the responses that their files do not state
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


def points_of(sources: Sources, loop: Loop | None, progress: Progress) -> tuple[list[OperatingPoint | Loop], list[str]]:
    """Return the operating points of all sources, and remarks on them."""
    first, *others = (
        source if isinstance(source, OperatingPoint) else loop_or_response(source, sources.axis)
        for source in (sources.source, *sources.at)
        if source is not None  # None for a study, which has its own machines
    )
    measured = [source for source in others if not isinstance(source, OperatingPoint | Loop)]
    points: list[OperatingPoint | Loop] = []
    if isinstance(first, OperatingPoint | Loop):
        if sources.motor or sources.disturbance:
            raise ParameterError(
                "--motor and --disturbance belong to a measured response: leave them out for a machine"
            )
        points.append(first)
        places = [Measurement(frf) for frf in measured]
    else:
        hammer = Measurement(first, None, sources.disturbance, sources.disturbance_motor)
        places = several(hammer, measured, sources.motor)
    remarks: list[str] = []
    names = told_apart((stem(place.load), Path(place.name).parent.name) for place in places)
    for place, name in zip(places, names, strict=True):
        progress.step(f"reading {Path(place.name).name}")
        point, words = point_of(place, name, loop, sources.sample_time, sources.delay, sources.unit, progress)
        points.append(point)
        remarks += words
    return [*points, *(source for source in others if isinstance(source, OperatingPoint | Loop))], remarks


def first_control(law: str | None, loop: Loop | None, points: Sequence[OperatingPoint | Loop]) -> tuple[Control, str]:
    """Return the initial control of a search, and the name of the tuning rule that provided it.

    The initial control is the existing one, one with another law, or a P-PI with robust margins; the name is empty
    unless a tuning rule provided a missing control. If the existing law is requested by name and has no integral
    action, it is replaced by an initial design with integral action, if the law can have it.
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
    """Return True if the control has integral action, so that a constant force causes no steady-state error."""
    return ControlResponse(control, float(sample_time), ()).integrates(())


def machine_of(source: object) -> MachineFile | None:
    """Return the machine for a TOML file or the name of a bundled machine; None for other sources.

    A `MachineFile` is returned unchanged.
    """
    if isinstance(source, MachineFile):
        return source
    if not isinstance(source, str | Path):
        return None
    path = Path(source)
    # a bare name that is no file can only be a bundled machine
    bundled = not path.suffix and not path.is_file()
    if path.suffix.lower() == ".toml" or (bundled and (BUNDLED / "machines" / f"{source}.toml").exists()):
        return read_machine(source)
    if bundled:
        names = [file.stem for file in (BUNDLED / "machines").glob("*.toml")]
        raise ParameterError(
            f"{source}: is neither a file nor the name of a bundled machine{nearest(str(source), names)}"
        )
    return None


def loop_or_response(source: MachineLike | Loop | FrfLike, axis: str | None) -> Loop | FrfLike:
    """Return the loop of a machine's axis; return a loop or a measured response unchanged."""
    if isinstance(source, Loop | FRF):
        return source
    machine = machine_of(source)
    if machine is not None:
        return machine.loop(axis)
    assert not isinstance(source, MachineFile)
    return source


def point_of(
    measurement: Measurement,
    name: str,
    loop: Loop | None,
    sample_time: float | None,
    delay: float,
    unit: str | None,
    progress: Progress,
) -> tuple[OperatingPoint, list[str]]:
    """Return a measured operating point and remarks. Raise ParameterError, with the remedy, for inconsistent data."""
    turns = loop is not None and loop.axis.rotary
    commanded = "force" if loop is None else loop.axis.actuator.commanded
    responses = {
        key: in_metres(measurement.name, frf, unit, turns, commanded)
        for key, frf in read_frfs(measurement.load).items()
    }
    load, motor = _roles(measurement, responses, unit, turns, commanded)
    remarks = [
        words
        for frf in (load, motor)
        if frf is not None
        and loop is None
        and (words := check_response(measurement.name, frf, unit is not None, progress))
    ]
    step = sample_time or load.sample_time or (None if loop is None else float(loop.sample_time))
    if step is None:
        raise ParameterError(
            f"{measurement.name}: does not say with which sample time the control runs: give it with --sample-time, or "
            f"today's machine with --baseline"
        )
    struck = None
    if measurement.struck is not None:
        back = None if measurement.struck_motor is None else _only(measurement.struck_motor, unit, turns)
        if motor is not None and back is None:
            raise ParameterError(
                "--disturbance with two encoders needs --disturbance-motor: the motor's answer to the hammer"
            )
        struck = (_only(measurement.struck, unit, turns), back)
    for frf in (load, motor):
        if frf is not None:
            _check_sign(measurement.name, frf)
    point = measured_point(
        load, motor, disturbance=struck, sample_time=step, delay=delay, name=name, commanded=commanded
    )
    if loop is not None:
        _check_size(measurement.name, point, loop, stated=bool(load.unit) or unit is not None)
        if motor is None and measurement.motor != _NONE:
            _check_encoders(measurement.name, loop)
    if point.at_drive:
        point, words_ = _on_the_table(point, loop, load, motor, step)
        remarks += words_
    elif loop is not None:
        point, words = with_table_force(point, loop, _BASELINE)
        remarks += [words] if words else []
    if not load.unit and unit is None:
        remarks.append(f"{measurement.name} does not say its unit: it counts as m/N (--unit)")
    return point, remarks


def _roles(
    measurement: Measurement, responses: dict[str, FRF], unit: str | None, turns: bool, commanded: str
) -> tuple[FRF, FRF | None]:
    """Return the responses of the load and the motor from one or two files; None for the motor if there is only one
    encoder.
    """
    by_output = {frf.output: key for key, frf in responses.items()}
    names = {**by_output, **{key: key for key in responses}}
    if measurement.motor is None and len(responses) > 1:
        motor = next((names[name] for name in MOTOR if name in names), None)
        load = next((names[name] for name in LOAD if name in names), None)
        if motor is None or load is None:
            raise ParameterError(
                f"{measurement.name}: holds {len(responses)} responses: {', '.join(responses)}; say which one is the "
                f"motor's with --motor NAME (the other one is the table's)"
            )
        return responses[load], responses[motor]
    if measurement.motor is not None and measurement.motor in names:
        others = [key for key in responses if key != names[measurement.motor]]
        if len(others) != 1:
            raise ParameterError(
                f"{measurement.name}: beside '{measurement.motor}' there must be one response, not {len(others)}"
            )
        return responses[others[0]], responses[names[measurement.motor]]
    if len(responses) > 1:
        raise ParameterError(
            f"{measurement.name}: holds {len(responses)} responses, {', '.join(responses)}: a file for one encoder "
            "must hold one"
        )
    load = next(iter(responses.values()))
    return load, None if measurement.motor in (None, _NONE) else _only(measurement.motor, unit, turns, commanded)


def _only(source: FrfLike, unit: str | None, turns: bool, commanded: str = "force") -> FRF:
    responses, path = read_frfs(source), called(source)
    if len(responses) != 1:
        raise ParameterError(f"{path}: holds {len(responses)} responses, {', '.join(responses)}: one is wanted here")
    return in_metres(path, next(iter(responses.values())), unit, turns, commanded)


def in_metres(path: str, frf: FRF, unit: str | None, turns: bool, commanded: str = "force") -> FRF:
    """Return a response in m/N; for a rotary axis in rad/(N m), which is also labeled m/N.  That of a drive that is
    commanded by velocities is in m/(m/s), or in rad/(rad/s), which is labeled alike.

    A velocity or acceleration is integrated.  Raises ParameterError for a response in a unit of another kind.
    """
    stated = unit or frf.unit
    if commanded == "velocity":
        wanted_unit = response_unit(commanded)
        if stated in ("", wanted_unit, units.turning(wanted_unit)):
            return replace(frf, unit=wanted_unit)
        raise ParameterError(
            f"{path}: the response from {frf.input} to {frf.output} is in {stated}, and the drive of the axis is "
            f"commanded by velocities: give the response from the commanded velocity to the position, in {wanted_unit}"
        )
    f = frf.frequency
    by_order = {"m/N": 1.0 + 0.0 * f, "(m/s)/N": 1.0 / (2j * np.pi * f), "(m/s2)/N": -1.0 / (2.0 * np.pi * f) ** 2}
    wanted = {
        units.turning(response_unit) if turns else response_unit: whole for response_unit, whole in by_order.items()
    }
    # responses of models are in m/N even for rotary axes
    if stated in ("", "m/N"):
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
    """Raise ParameterError for a response with wrong sign: velocity lags force by 0° (friction) to 90° (free mass)."""
    lines = slice(0, max(5, frf.frequency.size // 20))
    # j f x is the velocity; the sum over the lowest lines, where the axis is rigid, averages the noise of each
    turned = np.angle(np.sum(frf.frequency[lines] ** 2 * frf.response[lines] * 1j / frf.frequency[lines]))
    if _BACKWARD[0] < turned < _BACKWARD[1]:
        raise ParameterError(
            f"{path}: the axis moves against the force ({Quantity(turned, 'rad'):3 deg} from force to velocity at "
            f"{Quantity(frf.frequency[0], 'Hz')}): the sign of force or position is reversed; multiply the response by "
            "-1"
        )


def _check_size(path: str, point: OperatingPoint, loop: Loop, *, stated: bool) -> None:
    """Raise ParameterError if a response without a unit is over 3 times larger or smaller than that of the baseline."""
    model = linearize(loop, ["cut"], READINGS)
    # on the lowest lines modes and delays do not matter yet: the ratio is that of mass and friction
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
    """Raise ParameterError if the law reads both encoders and their responses differ, so that one is not enough."""
    T = float(loop.sample_time)
    model = linearize(loop, ["cut"], READINGS)
    lines = np.geomspace(1.0, 0.3 / T, 60)
    motor, load = (model.response(lines, reading, "cut").response for reading in READINGS)
    C = ControlResponse(loop.control, T, ()).at((), lines).value
    # only lines near or above the crossover decide on stability
    near = np.abs(C[0] * motor + C[1] * load) > 0.3
    # a law that reads one encoder leaves a response of rounding errors to the other
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
    """Return the point with the response to a force on the table added, and remarks.

    The response is that of the baseline's plant or, without one, of a modal fit to both encoders. If neither is
    possible, the point is returned unchanged.
    """
    remarks: list[str] = []
    if loop is not None:
        completed, words = with_table_force(point, loop, _BASELINE)
        if not completed.at_drive:
            return completed, [words]
        remarks.append(words)
    if point.commanded == "velocity":
        # a force at the drive would stand for that on the table, and its command is none
        raise ParameterError(
            f"{point.name}: {remarks[-1]}; a drive that is commanded by velocities needs a baseline whose plant "
            "agrees: identify it again"
        )
    if motor is None:
        return point, remarks
    try:
        # the control samples its readings and holds its command, even if the file does not say so
        at_motor, at_load = (replace(_fewer(frf), sample_time=step) for frf in (motor, load))
        fit = fit_modal_axis(at_motor, at_load)
        plant, actuator = fit.blocks()
        control = Control(law=margin_goals(point).law) if loop is None else loop.control
        fitted = Loop(control=control, axis=Axis(plant=plant, actuator=actuator), sample_time=step)
        completed, words = with_table_force(
            point, fitted, f"a fit of {len(getattr(plant, 'modes', ()))} modes", run=False
        )
    except FeeddriveError as error:
        # the point is still usable: it is then judged against a force at the drive
        return point, [*remarks, Text(f"no plant could be fitted for a force on the table: {error}")]
    return completed, [words] if not completed.at_drive else [*remarks, words]


def several(first: Measurement, others: Sequence[FrfLike], motors: Sequence[str]) -> list[Measurement]:
    """Return the measurements at all positions. A motor file belongs to one position; a motor name applies to all."""
    # a file has a suffix, the name of a response in a file has none
    named = [motor for motor in motors if motor == _NONE or not Path(motor).suffix]
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
    """Return the response at fewer frequency lines, evenly spaced in ln f, so that a modal fit takes a few seconds at
    most.
    """
    x = np.log(frf.frequency)
    kept = np.unique(np.searchsorted(x, np.linspace(x[0], x[-1], _OF_A_FIT)).clip(0, x.size - 1))
    variance = None if frf.variance is None else frf.variance[kept]
    return replace(frf, frequency=frf.frequency[kept], response=frf.response[kept], coherence=None, variance=variance)
