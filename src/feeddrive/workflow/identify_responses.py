"""`feeddrive identify FRF.csv`: a fit of masses, springs and modes to responses, its report, and the machine file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from feeddrive import plot
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.files.columns import unit_of
from feeddrive.files.commissioning import Commissioning
from feeddrive.files.frf import encoders, names_frequency, read_frfs
from feeddrive.files.log import LogLike
from feeddrive.files.machine import MachineFile, MachineLike, read_machine, with_standard_errors
from feeddrive.files.mapping import MappingLike
from feeddrive.files.origins import with_origins
from feeddrive.files.read_log import OpenedFile
from feeddrive.files.section import to_toml
from feeddrive.files.toml_file import TomlEdit
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.identification.regression import lever
from feeddrive.identification.response.modal_fit import ModalFit, fit_modes
from feeddrive.identification.response.plant_fit import AxisFits, PlantFit, fit_axis
from feeddrive.language import tree, units
from feeddrive.language.errors import FeeddriveError, ParameterError, nearest, sentence
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, span
from feeddrive.language.table import Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.box import can_spread
from feeddrive.loop.frequency_response import FRF
from feeddrive.report.report import Picture, Remarks, Report, Section, Verdict, facts, further
from feeddrive.workflow.channels import ALL, check_response, units_first
from feeddrive.workflow.command import CHANNELS, OUT, Outcome, argument, called, frequencies, line, option
from feeddrive.workflow.commissioning import NO_CLOCK, drive_axis
from feeddrive.workflow.drive_logs import logs_stem, narrow, write_report, written
from feeddrive.workflow.force import DriveValues

_DECIBEL = 8.686  # dB per unit of ln


def responses_in(path: Path | OpenedFile) -> dict[str, FRF] | None:
    """Return the frequency responses of a file; None for a log. Raise FeeddriveError for unreadable responses."""
    try:
        return read_frfs(path)
    # a file without responses may be a log; one with a column of frequencies was meant as responses: its error counts
    except FeeddriveError:
        if names_frequency(path):
            raise
        return None


def identify_responses(request: IdentifyRequest, responses: Mapping[str, FRF], progress: Progress) -> Outcome[Any]:
    """Fit masses, springs and modes to the responses of a file; write a report and a machine file if requested."""
    path = Path(called(request.log))
    model = request.model or ("modal" if request.modes else "auto")
    chosen = _chosen(path, responses, request, model)
    machine = None if request.machine is None else read_machine(request.machine)
    axis = None if machine is None else machine.loop(request.axis).axis
    # with a factor still to be applied the response is not in m/N, and its mass is no mass yet
    judged = chosen.values() if request.force_constant is None and request.lead is None else ()
    doubts = [doubtful for frf in judged if (doubtful := check_response(str(path), frf, bool(request.unit), progress))]
    result = _fit(chosen, request, model, axis, progress)
    turns = request.rotary or (axis is not None and axis.rotary)
    fit = result if isinstance(result, ModalFit) else result.fit
    name = request.axis or ("x" if machine is None else next(iter(machine.loops)))
    reason = told_by(fit, turns=turns)
    drive = not request.measured_input
    text = None if reason or isinstance(fit, ModalFit) else machine_text(fit, machine, name, drive, turns=turns)
    text = None if text is None else with_origins(text, (request.log, request.motor, request.load, machine))
    judged_by = units_first(doubts) or advice(result, turns=turns)
    remarks = [*_silent(chosen), *fit.remarks, *request.about_gear()]
    return _outcome(request, result, remarks, _facts(path, chosen, request), judged_by, text, reason, progress)


def is_commissioned(request: IdentifyRequest) -> bool:
    """Return True unless the options request a general fit of responses: by encoder, as modes, or for a machine."""
    return request.machine is None and request.load is None and request.model not in ("modes", "machine")


def identify_commissioned(request: IdentifyRequest, file: Commissioning, progress: Progress) -> Outcome[Any]:
    """Fit the axis of a commissioning file; write its machine file with the existing law if requested."""
    axis = drive_axis(
        file,
        progress,
        motor=request.motor,
        band=None if request.band is None else frequencies(request.band),
        rotary=request.rotary,
        lead=request.lead,
        gear=request.geared,
        sample_time=request.sample_time,
        model=request.model or ("modal" if request.modes else "auto"),
        modes=request.modes,
        fixed=_fixed(request.fix, None),
    )
    fit, path = axis.result.fit, Path(called(request.log))
    reason = told_by(fit, turns=True) or (f"the file {NO_CLOCK}" if axis.loop is None else "")
    text = None if reason else with_origins(axis.text(), (request.log,))
    frf = axis.plant
    known = {
        "File": str(path),
        "Responses": f"motor: {request.motor or file.plant}; current loop: {file.current_loop or 'none'}",
        "Lines": Text(f"{frf.frequency.size} from {span(frf.frequency[0], frf.frequency[-1], 'Hz')}"),
        "Band of the model": request.band
        or (Text(f"{span(axis.band.low, axis.band.high, 'Hz')}") if axis.band is not None else "all lines"),
        "Known before": ", ".join(request.fix) or "nothing",
        "Cost": "weighted by the variance of each line" if frf.variance is not None else "complex logarithmic ratio",
    }
    remarks = [*axis.remarks, *fit.remarks, *request.about_gear()]
    judged_by = advice(axis.result, turns=True)
    outcome = _outcome(request, axis.result, remarks, known, judged_by, text, reason, progress)
    # the file itself is tuned: the modes above the band of the model are in it alone
    return outcome if reason or judged_by.judgment.bad else replace(outcome, then=line("tune", path))


def _outcome(
    request: IdentifyRequest,
    result: AxisFits | ModalFit,
    remarks: Sequence[str],
    known: Mapping[str, str],
    judged_by: Advice,
    text: str | None,
    reason: str,
    progress: Progress,
) -> Outcome[Any]:
    """Return the outcome of a fit, and write its report and machine file if requested.

    text    text of the machine file; None if none is written, for the given `reason`
    """
    judgment, verdict = judged_by
    fit = result if isinstance(result, ModalFit) else result.fit
    files: dict[str, Path] = {}
    page = partial(fit_report, result, remarks, known, judged_by)
    if request.out is not None:
        progress.step("report")
        files = written(write_report(page(), text, request.out), text)
    shown = [narrow(each) for each in tables(result)]
    shown = [replace(table, sentences=4) if table.heads[0] == "structure" else table for table in shown]
    *compared, own, agreement = shown
    open_ = {} if isinstance(fit, ModalFit) else fit.not_identifiable
    unknown = [sentence(f"not identifiable: {name}: {why}") for name, why in open_.items()]
    notes = [f"No machine file was written: {reason}."] if reason else []
    details = [*compared, agreement, *unknown]
    # a file without a control, as one that is new, has nothing that could be tuned
    tunable = "Machine" in files and request.machine is not None and not judgment.bad
    return Outcome(
        result,
        [own],
        [sentence(remark) for remark in remarks],
        verdict,
        notes,
        files=files,
        details=details,
        judgment=judgment,
        page=page,
        then=_tuning(request, files["Machine"]) if tunable else "",
    )


def _tuning(request: IdentifyRequest, machine: Path) -> str:
    """Return the command that tunes on the measured responses, with the identified machine file as baseline."""
    # named responses, and those whose unit or factor was given to this command, are tuned by the model
    if request.motor or request.load or request.unit or request.force_constant is not None or request.lead is not None:
        return line("tune", machine, axis=request.axis)
    return line("tune", called(request.log), "--baseline", machine, axis=request.axis)


def _facts(path: Path, chosen: Mapping[str, FRF], request: IdentifyRequest) -> dict[str, str]:
    weighted = any(frf.variance is not None for frf in chosen.values())
    return {
        "File": str(path),
        "Responses": ", ".join(f"{role}: {frf.output}" for role, frf in chosen.items()),
        "Lines": joined(
            ", ",
            (f"{frf.frequency.size} from {span(frf.frequency[0], frf.frequency[-1], 'Hz')}" for frf in chosen.values()),
        ),
        "Band": request.band or "all lines",
        "Known before": ", ".join(request.fix) or "nothing",
        "Cost": "weighted by the variance of each line" if weighted else "complex logarithmic ratio",
    }


def _silent(chosen: Mapping[str, FRF]) -> list[str]:
    """Return a remark on responses without a unit, for which m/N is assumed."""
    silent = " and ".join(role for role, frf in chosen.items() if not frf.unit)
    return [f"no unit is stated for {silent}: m/N is taken; say another one with --unit, as (m/s)/N"] if silent else []


def _chosen(path: Path, responses: Mapping[str, FRF], request: IdentifyRequest, model: str) -> dict[str, FRF]:
    """Return the responses by role: the named ones, which may be in separate files, or else those with usual names."""
    named: dict[str, FRF] = {}
    for role, name in (("motor", request.motor), ("load", request.load)):
        if name is None:
            continue
        elsewhere = responses_in(Path(name)) if name not in responses and Path(name).is_file() else None
        if elsewhere is not None and len(elsewhere) > 1:
            elsewhere = {encoder: frf for encoder, frf in encoders(elsewhere).items() if encoder == role}
        if elsewhere:
            named[role] = next(iter(elsewhere.values()))
        elif name in responses:
            named[role] = responses[name]
        else:
            raise ParameterError(
                f"{path}: there is no response '{name}'{nearest(name, responses)}: name one of "
                f"{', '.join(responses)}, or a file with one, with --{role}"
            )
    # plain modes need no roles: each response is an output of its own
    if not named and model == "modes":
        named = dict(responses)
    elif not named:
        named = encoders(responses)
        if len(responses) > len(named):
            raise ParameterError(
                f"{path}: holds {len(responses)} responses, {', '.join(responses)}: say which encoder is which with "
                f"--motor NAME and --load NAME, or take --model modes for all"
            )
    if {"motor", "load"} <= set(named) and np.array_equal(named["motor"].response, named["load"].response):
        raise ParameterError(f"{path}: motor and load are the same response: name that of each encoder")
    told, *others = [unit_of(text) or text for text in request.unit] or [None]
    if others:
        raise ParameterError(f"{path}: responses have one unit: give --unit once, not as {', '.join(request.unit)}")
    for role, frf in named.items():
        if told is not None and frf.unit and units.response(frf.unit) != units.response(told):
            raise ParameterError(f"{path}: the response of {role} is in {frf.unit}, as its file says, not {told}")
    # responses of one file have one unit, so a stated one also holds for those without
    known = {frf.unit for frf in named.values() if frf.unit}
    unit = told or (known.pop() if len(known) == 1 else None)
    return {role: frf if unit is None or frf.unit else replace(frf, unit=unit) for role, frf in named.items()}


def _fit(
    chosen: Mapping[str, FRF], request: IdentifyRequest, model: str, axis: Axis | None, progress: Progress
) -> AxisFits | ModalFit:
    band = None if request.band is None else frequencies(request.band)
    if model == "modes":
        return fit_modes(chosen, request.modes, band=band, progress=progress)
    if model == "machine" and axis is None:
        raise ParameterError("--model machine needs a machine file with --machine")
    return fit_axis(
        chosen.get("motor"),
        chosen.get("load"),
        plant=None if axis is None else axis.plant,
        actuator=None if axis is None else axis.actuator,
        modes=request.modes,
        fixed=_fixed(request.fix, None if axis is None else axis.plant),
        structure=None if model == "auto" else model,
        # a measured force has no hold, dead time or current loop before it
        held=not request.measured_input,
        band=band,
        force_per_unit=request.force_constant,
        travel_per_unit=None if request.lead is None else lever(request.lead, request.geared),
        progress=progress,
    )


def _fixed(texts: Sequence[str], plant: Plant | None) -> dict[str, float]:
    """Parse strings such as `mass_motor=85` and `stiffness_N_per_um=150` into SI values by parameter name.

    Raises ParameterError for an unknown name or an invalid value.
    """
    of_all = [plant] if plant is not None else []
    # the values do not matter: only names and units of the parameters are read
    usual = TwoMass(mass_motor=1.0, mass_load=1.0, stiffness=1.0)
    known = {name: tree.declaration(block, name).unit for block in (usual, *of_all) for name, _ in tree.leaves(block)}
    fixed: dict[str, float] = {}
    for text in texts:
        key, _, number = text.partition("=")
        key = key.strip()
        # the longest name that fits: a parameter may be the beginning of another one's name
        name = key if key in known else max((n for n in known if key.startswith(f"{n}_")), key=len, default="")
        if not name:
            raise ParameterError(f"--fix {text}: there is no parameter '{key}'{nearest(key, known)}")
        try:
            value = float(number)
        except ValueError:
            raise ParameterError(f"--fix {text}: must be NAME=NUMBER, as mass_motor=85") from None
        factor = 1.0 if key == name else units.factor(key.removeprefix(f"{name}_"), known[name])
        fixed[name] = units.scaled(value, factor)
    return fixed


def fit_report(
    result: AxisFits | ModalFit,
    remarks: Sequence[str] | None = None,
    known: Mapping[str, str] | None = None,
    verdict: Advice | None = None,
) -> Report:
    """Return the report of a model of frequency responses; `known` holds facts about the measurement."""
    fit = result if isinstance(result, ModalFit) else result.fit
    first, *others = _pictures(fit)
    texts = list(fit.remarks if remarks is None else remarks)
    if isinstance(fit, PlantFit):
        texts += [Text(f"not identifiable: {name}: {why}") for name, why in fit.not_identifiable.items()]
    judgment, told = verdict or advice(result)
    modal = isinstance(result, ModalFit)
    return Report(
        "Modes of a frequency response" if modal else "An axis from its frequency responses",
        "feeddrive identify",
        Verdict((told,), good=not judgment.bad),
        (
            Section("result", "Result", (*tables(result), Remarks(map(sentence, texts)))),
            further(others),
            facts("The measurement", known or {}),
        ),
        first,
    )


def _pictures(fit: PlantFit | ModalFit) -> Iterator[Picture]:
    agreement = fit.agreement
    coherent = any(frf.coherence is not None for frf in agreement.measured)
    yield Picture(
        "fit",
        "Fitted over measured",
        "Dots: the measurement, in its 95 % band where the variance is known. Lines: the fitted model. Error: their "
        "distance over the size of the response; the dashed line is what noise explains on each line."
        + (" Coherence: 1 is a response without noise." if coherent else ""),
        "Magnitude and phase over frequency, measured and fitted, the error between them, and the coherence.",
        agreement.chart,
    )
    yield Picture(
        "residual",
        "Residuals",
        "Noise would scatter without order, and its autocorrelation would stay between the dashed lines. Waves over "
        "several lines are something regular that is not in the model.",
        Text(
            f"Weighted residuals over frequency; autocorrelation {Quantity(agreement.autocorrelation()):.2f} from "
            "line to line."
        ),
        lambda: plot.response_residuals_chart(agreement),
    )
    yield Picture(
        "nyquist",
        "In the complex plane",
        "Velocity over force: a resonance is a circle, the wider the less damping. Dots: measured; curves: the model.",
        "Measured and fitted responses in the complex plane.",
        lambda: plot.response_nyquist_chart(agreement),
    )


def tables(result: AxisFits | ModalFit) -> list[Table]:
    """Tabulate the compared structures, the parameters with errors, and the agreement with the measured response."""
    if isinstance(result, ModalFit):
        return [result.table(), result.agreement.table()]
    compared = [result.table()] if len(result.fits) + len(result.refused) > 1 else []
    return [*compared, result.fit.table(), result.fit.agreement.table()]


def told_by(fit: PlantFit | ModalFit, *, turns: bool = False) -> str:
    """Return the reason for not writing the fit to a machine file, or an empty string if it may be written.

    turns   True for a rotary axis, whose plant is in kg m2
    """
    if isinstance(fit, ModalFit):
        return "modes without masses are no plant; --model modal makes one"
    if fit.agreement.poor:
        return Text(f"the model misses lines that were not used by {Quantity(_DECIBEL * fit.agreement.unused, 'dB'):2}")
    if fit.units.turns and not turns:
        return "the result is in kg m2 at the motor; give --force-constant and --lead, or --rotary if the axis turns"
    if not (fit.units.si or fit.units.turns):
        return f"the result is in {fit.units.of('kg')}; give --force-constant and --lead"
    kinds = {name: name.rsplit(".", 1)[-1].split("_")[0] for name, _ in tree.leaves(fit.plant)}
    open_ = [name for name in fit.not_identifiable if kinds.get(name) in ("mass", "stiffness", "frequency", "coupling")]
    damped = [name for name in open_ if not name.endswith("damping")]
    if damped and fit.plant.kind in ("two_mass", "modal"):
        return f"{', '.join(damped)} cannot be told from these lines; what to measure next stands above"
    return ""


def advice(result: AxisFits | ModalFit, *, turns: bool = False) -> Advice:
    """Return the judgment on the model and one sentence with the reason; `turns` as in `told_by`."""
    fit = result if isinstance(result, ModalFit) else result.fit
    unused = _DECIBEL * fit.agreement.unused
    if fit.agreement.poor:
        where, apart = fit.agreement.worst
        wrong = not isinstance(result, ModalFit) and result.wrong_sign
        other = (
            "the motor's encoder does not sit where the force acts: give a machine file with the structure of the axis "
            "(a chain of three masses has its encoder on the screw), or take --model modes"
            if wrong
            else "cut the band to where the coherence is high, or ask for more modes"
        )
        missed = Text(
            f"missed by {Quantity(unused, 'dB'):2} RMS, most near {Quantity(where, 'Hz')} ({Quantity(apart, 'dB'):2})"
        )
        return Judgment.DO_NOT_USE_MODEL.because(f"lines that were not used are {missed}; {other}")
    reason = told_by(fit, turns=turns)
    if reason and isinstance(fit, PlantFit) and (fit.units.si or (turns and fit.units.turns)):
        return Judgment.MODEL_IS_OPEN.because(reason)
    which = "" if isinstance(result, ModalFit) or len(result.fits) < 2 else f" ({result.chosen})"
    open_ = ""
    if isinstance(fit, PlantFit) and fit.not_identifiable:
        open_ = f"These lines do not tell {', '.join(fit.not_identifiable)}: kept as stated. "
    use = f"{open_}{Judgment.USE_MODEL.says}{which} in its band"
    return Advice(
        Judgment.USE_MODEL,
        Text(f"{use}: lines that were not used are predicted within {Quantity(unused, 'dB'):2} RMS."),
    )


def machine_text(
    fit: PlantFit, machine: MachineFile | None, axis: str, drive: bool = True, *, turns: bool = False
) -> str:
    """Return the text of the machine file with the fitted plant and, with `drive`, dead time and current loop.

    turns   True for a rotary axis, whose plant is in kg m2
    """
    plant, actuator = fit.blocks()
    section, place = to_toml(plant, f"axis.{axis}.plant", rotary=turns), ("axis", axis, "plant")
    if machine is None:
        head = "# plant and actuator of an axis, from frequency responses; add control, limits and encoders\n\n"
        kind = f"[axis.{axis}]\nrotary = true\n\n" if turns else ""
        edit = TomlEdit(f"{head}{kind}{section}\n{to_toml(actuator, f'axis.{axis}.actuator')}", "identified.toml")
    else:
        edit = TomlEdit(machine.file.text, machine.file.name)
        before = machine.loop(axis).axis
        # numbers of the same structure are changed in place, which keeps units and comments of the file
        if type(before.plant) is type(plant) and fit.plant.kind == "two_mass":
            for estimate in fit.estimates:
                if hasattr(plant, estimate.name):
                    edit.set((*place, estimate.name), estimate.value, estimate.unit)
        else:
            edit.replace(place, section)
        # a lag that the lines do not show apart is part of the fitted dead time: an old value would count it twice
        if drive and "current_loop" in fit.not_identifiable and actuator.current_loop is None:
            before = replace(before, actuator=replace(before.actuator, current_loop=None))
            edit.silence(("axis", axis, "actuator", "current_loop"), "Hz")
        if drive:
            _actuator(edit, axis, before.actuator, actuator)
    errors: dict[str, float] = {}
    for estimate in fit.estimates:
        parts = [int(part) if part.isdigit() else part for part in estimate.name.split(".")]
        at_drive = estimate.name in ("dead_time", "current_loop")
        key = ("axis", axis, "actuator", estimate.name) if at_drive else (*place, *parts)
        if edit.has(key[:-1]) and (drive or machine is None or not at_drive):
            value = (
                getattr(actuator, estimate.name)
                if len(parts) == 1 and hasattr(actuator, estimate.name)
                else estimate.value
            )
            error = Quantity(estimate.error, estimate.unit, form="2 SI")
            edit.comment(edit.set(key, float(value), estimate.unit), f"standard error {error}")
            errors[".".join(map(str, key[2:]))] = float(estimate.error)
    with_standard_errors(edit, axis, errors, _correlations(fit, errors))
    return edit.text


def _correlations(fit: PlantFit, errors: Mapping[str, float]) -> dict[tuple[str, str], float]:
    """Return the correlations of fitted masses and stiffnesses, of which a box of plants is made, by their paths."""
    axis, found = Axis(plant=fit.blocks()[0]), dict[tuple[str, str], float]()
    paths = [f"plant.{estimate.name}" for estimate in fit.estimates]
    for i, j in combinations(range(len(paths)), 2):
        pair, size = (paths[i], paths[j]), math.sqrt(fit.covariance[i, i] * fit.covariance[j, j])
        if size > 0.0 and all(path in errors and can_spread(axis, path) for path in pair):
            found[pair] = float(np.clip(fit.covariance[i, j] / size, -1.0, 1.0))
    return found


def _actuator(edit: TomlEdit, axis: str, before: Actuator, after: Actuator) -> None:
    """Write the dead time and the current loop; the motor is left unchanged."""
    # a response knows nothing of the motor's constants and limits
    kept = replace(after, motor=before.motor, current_loop=after.current_loop or before.current_loop)
    key = ("axis", axis, "actuator")
    if not edit.has(key):
        edit.add(to_toml(kept, f"axis.{axis}.actuator"))
        return
    edit.set((*key, "dead_time"), float(kept.dead_time), "s")
    if kept.current_loop is not None:
        edit.set((*key, "current_loop"), float(kept.current_loop), "Hz")


MODELS = ("auto", "rigid", "machine", "two-mass", "modal", "modes")


Measured: TypeAlias = LogLike | MotionLog | FRF
"""What `identify` takes: the file of a log, a `Log` or `MotionLog`, or frequency responses and their file."""


class IdentifyRequest(DriveValues):
    """Logs of one axis or a file of frequency responses, the roles of their columns, and known values."""

    logs: tuple[Measured, ...] | Measured = argument(
        "A log of position and force of one motion, several logs of one axis, whose values are then pooled, or a file "
        "of frequency responses"
    )
    machine: MachineLike | None = option("the machine file to start from; its comments are kept", default=None)
    axis: str | None = option(
        f"axis of the machine file, and of a log with several; {ALL} for each axis of the log", default=None
    )
    law: str | None = option(
        "law that ran, in SI, as cascade_ppi:Kv=38,Kp=9e4, or the JSON of an ODrive (odrivetool backup-config), with "
        "another axis as FILE:axis1: without a machine file",
        default=None,
    )
    friction: str = option("friction model: best, symmetric or directional", default="best")
    set_position: str | None = option("column of the set position, name:unit", default=None)
    position: str | None = option("column of the position, name:unit", default=None)
    force: str | None = option("column of the commanded force, name:unit", default=None)
    command: str | None = option("column of the command in the drive's unit", default=None)
    angle: str | None = option("column of the motor's angle, name:unit", default=None)
    set_angle: str | None = option("column of the set angle, name:unit", default=None)
    rotary: bool = option("the axis itself turns, and no screw follows: rad, N m and kg m2", default=False)
    torque: str | None = option("column of the motor's torque, name:unit", default=None)
    force_constant: float | None = option("N at the table per unit of the command", above=0.0, default=None)
    lead: float | None = option(
        "lead of the screw, to put angles and torques at the table", unit="m", above=0.0, default=None
    )
    gear: float | None = option("turns of the motor in one turn of the screw; 1", above=0.0, default=None)
    sample_time: float | None = option("sample time of a log without a clock", unit="s", default=None)
    mass: float | None = option(
        "moving mass that is known, as weighed, against which clock and scales of the log are checked",
        unit="kg",
        above=0.0,
        default=None,
    )
    feed: str | None = option(
        "feed that the motion reaches, as it was programmed, against which the clock is checked: in mm/min, deg/min of "
        "an axis that turns, or with its unit, as 6:m/min",
        default=None,
    )
    time: str | None = option("column of the time, name:unit", default=None)
    channels: MappingLike | None = option(CHANNELS, default=None)
    model: str | None = option("model of frequency responses", options=MODELS, default=None)
    modes: int | None = option("number of modes; found if left out", default=None)
    motor: str | None = option("the motor encoder's response, by name or file", default=None)
    load: str | None = option("the load encoder's response, by name or file", default=None)
    band: str | None = option("band of frequency responses, as 5..300 in Hz", default=None)
    fix: tuple[str, ...] = option("a parameter that is known, as mass_motor=85; may be repeated", default=())
    measured_input: bool = option("the responses lead from a measured force or current, not a command", default=False)
    unit: tuple[str, ...] = option(
        "unit of columns that state none, as mm or kN, or of responses, as um/N; may be repeated", default=()
    )
    out: Path | None = option(OUT, short="-o", default=None)

    def usual_out(self) -> Path:
        return Path("results") / f"identify_{logs_stem(self.sources)}"

    def check(self) -> None:
        """Raise ParameterError if there is no log, and for mutually exclusive constants."""
        if not self.logs:
            raise ParameterError("logs: identify needs a log of a motion, or a file of frequency responses")
        super().check()

    @property
    def geared(self) -> float:
        """The gear, 1 if none was given."""
        return 1.0 if self.gear is None else self.gear

    def about_gear(self) -> list[Text]:
        """Return a remark on a screw whose gear was not given."""
        if self.lead is None or self.gear is not None:
            return []
        return [
            Text(
                f"--lead {Quantity(self.lead, 'm'):6 mm} without --gear: gear 1 is taken, one turn of the motor in one "
                "turn of the screw; with another gear give --gear"
            )
        ]

    @property
    def sources(self) -> tuple[Measured, ...]:
        """The logs as a tuple, also if a single one was given."""
        assert isinstance(self.logs, tuple)
        return self.logs

    @property
    def log(self) -> Measured:
        """The only log, or the first one."""
        return self.sources[0]

    def named(self) -> dict[str, str | None]:
        """Return the column options by role; None for an omitted option."""
        return {
            "setpoint_position": self.set_position,
            "position_load": self.position,
            "force": self.force,
            "command": self.command,
            "angle_motor": self.angle,
            "torque": self.torque,
            "time": self.time,
            "setpoint_angle": self.set_angle,
        }
