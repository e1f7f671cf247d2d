"""`feeddrive identify FRF.csv`: masses, springs and modes of an axis from measured frequency responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.files.formats import OpenedFile
from feeddrive.files.frf import encoders, names_frequency, read_frfs
from feeddrive.files.machine import read_machine
from feeddrive.files.messages import nearest, sentence
from feeddrive.identification.estimate import lever
from feeddrive.identification.response.fit_axis import AxisFits, fit_axis
from feeddrive.identification.response.modal_fit import ModalFit, fit_modes
from feeddrive.language import tree, units
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.axis import Axis
from feeddrive.loop.frequency_response import FRF
from feeddrive.workflow.command import Outcome
from feeddrive.workflow.drive_logs import narrow, written
from feeddrive.workflow.identify_request import IdentifyRequest
from feeddrive.workflow.request import frequencies
from feeddrive.workflow.response_page import machine_text, recommendation, tables, told_by, write_fit


def responses_in(path: Path | OpenedFile) -> dict[str, FRF] | None:
    """The frequency responses of a file; None if it holds none, as a log does. Raises what is wrong with its lines."""
    try:
        return read_frfs(path)
    except FeeddriveError:
        if names_frequency(path):
            raise
        return None


def identify_responses(request: IdentifyRequest, found: Mapping[str, FRF], progress: Progress) -> Outcome[Any]:
    """Masses, springs and modes of the responses in a file; report and machine file on request."""
    path, out = request.log, request.out
    model = request.model or ("modal" if request.modes else "auto")
    chosen = _chosen(path, found, request, model)
    machine = None if request.machine is None else read_machine(request.machine)
    axis = None if machine is None else machine.loop(request.axis).axis
    result = _fit(chosen, request, model, axis, progress)
    fit = result if isinstance(result, ModalFit) else result.fit
    name = request.axis or ("x" if machine is None else next(iter(machine.loops)))
    reason = told_by(fit)
    text = None if reason or isinstance(fit, ModalFit) else machine_text(fit, machine, name)
    remarks = [*_silent(chosen), *fit.remarks]
    files: dict[str, Path] = {}
    if out is not None:
        progress.step("report")
        files = written(write_fit(result, remarks, text, out, _facts(path, chosen, request)), text)
    shown = [narrow(each) for each in tables(result)]
    shown = [replace(each, sentences=4) if each.heads[0] == "structure" else each for each in shown]
    open_ = {} if isinstance(fit, ModalFit) else fit.not_identifiable
    said = [*remarks, *(f"not identifiable: {name}: {why}" for name, why in open_.items())]
    notes = [f"No machine file was written: {reason}."] if reason else []
    return Outcome(result, shown, [sentence(each) for each in said], recommendation(result), notes, files=files)


def _facts(path: Path, chosen: Mapping[str, FRF], request: IdentifyRequest) -> dict[str, str]:
    weighted = any(frf.variance is not None for frf in chosen.values())
    return {
        "File": str(path),
        "Responses": ", ".join(f"{role}: {frf.output}" for role, frf in chosen.items()),
        "Lines": ", ".join(
            f"{frf.frequency.size} from {frf.frequency[0]:.4g} to {frf.frequency[-1]:.4g} Hz" for frf in chosen.values()
        ),
        "Band": request.band or "all lines",
        "Known before": ", ".join(request.fix) or "nothing",
        "Cost": "weighted by the variance of each line" if weighted else "complex logarithmic ratio",
    }


def _silent(chosen: Mapping[str, FRF]) -> list[str]:
    """What was taken for granted."""
    silent = [role for role, frf in chosen.items() if not frf.unit]
    if not silent:
        return []
    return [f"no unit is stated for {' and '.join(silent)}: m/N is taken; say another one with --unit, as (m/s)/N"]


def _chosen(path: Path, found: Mapping[str, FRF], request: IdentifyRequest, model: str) -> dict[str, FRF]:
    """The responses by role: those that were named, or in files of their own, else by their names."""
    named: dict[str, FRF] = {}
    for role, name in (("motor", request.motor), ("load", request.load)):
        if name is None:
            continue
        elsewhere = responses_in(Path(name)) if name not in found and Path(name).is_file() else None
        if elsewhere is not None and len(elsewhere) > 1:
            elsewhere = {each: frf for each, frf in encoders(elsewhere).items() if each == role}
        if elsewhere:
            named[role] = next(iter(elsewhere.values()))
        elif name in found:
            named[role] = found[name]
        else:
            raise ParameterError(
                f"{path}: there is no response '{name}'{nearest(name, found)}: name one of {', '.join(found)}, or a "
                f"file with one, with --{role}"
            )
    if not named and model == "modes":
        named = dict(found)
    elif not named:
        named = encoders(found)
        if len(found) > len(named):
            raise ParameterError(
                f"{path}: holds {len(found)} responses, {', '.join(found)}: say which encoder is which with --motor "
                f"NAME and --load NAME, or take --model modes for all"
            )
    if {"motor", "load"} <= set(named) and np.array_equal(named["motor"].response, named["load"].response):
        raise ParameterError(f"{path}: motor and load are the same response: name that of each encoder")
    for role, frf in named.items():
        if request.unit is not None and frf.unit and frf.unit != request.unit:
            raise ParameterError(
                f"{path}: the response of {role} is in {frf.unit}, as its file says, not {request.unit}"
            )
    known = {frf.unit for frf in named.values() if frf.unit}
    unit = request.unit or (known.pop() if len(known) == 1 else None)
    return {role: frf if unit is None or frf.unit else replace(frf, unit=unit) for role, frf in named.items()}


def _fit(
    chosen: Mapping[str, FRF], request: IdentifyRequest, model: str, axis: Axis | None, progress: Progress
) -> AxisFits | ModalFit:
    band = None if request.band is None else frequencies(request.band)
    if model == "modes":
        return fit_modes(chosen, request.modes, band=band, step=progress.step)
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
        held=not request.measured_input,
        band=band,
        force_per_unit=request.force_constant,
        travel_per_unit=None if request.lead is None else lever(request.lead, request.gear),
        step=progress.step,
    )


def _fixed(texts: Sequence[str], plant: Plant | None) -> dict[str, float]:
    """`mass_motor=85` or `stiffness_N_per_um=150` as SI values by name. Raises ParameterError."""
    of_all = [plant] if plant is not None else []
    usual = TwoMass(mass_motor=1.0, mass_load=1.0, stiffness=1.0)
    known = {name: tree.declaration(each, name).unit for each in (usual, *of_all) for name, _ in tree.leaves(each)}
    found: dict[str, float] = {}
    for text in texts:
        key, _, number = text.partition("=")
        key = key.strip()
        name = key if key in known else max((n for n in known if key.startswith(f"{n}_")), key=len, default="")
        if not name:
            raise ParameterError(f"--fix {text}: there is no parameter '{key}'{nearest(key, known)}")
        try:
            value = float(number)
        except ValueError:
            raise ParameterError(f"--fix {text}: must be NAME=NUMBER, as mass_motor=85") from None
        factor = 1.0 if key == name else units.factor(key.removeprefix(f"{name}_"), known[name])
        found[name] = value * factor
    return found
