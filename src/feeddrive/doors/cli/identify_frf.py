"""`feeddrive identify FRF.csv`: masses, springs and modes of an axis from measured frequency responses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from feeddrive.artefacts.files.frf import read_frfs
from feeddrive.artefacts.files.machine import read_machine
from feeddrive.artefacts.files.messages import nearest
from feeddrive.artefacts.measurement.response_page import machine_text, recommendation, tables, write_fit
from feeddrive.doors.cli.frf import frequencies
from feeddrive.doors.cli.working import drawn
from feeddrive.engineer.identification.modal_fit import ModalFit, fit_modes
from feeddrive.engineer.identification.plant_fit import PlantFit
from feeddrive.engineer.identification.two_mass_fit import fit_modal_axis, fit_two_mass
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.loop.frequency_response import FRF

MODELS = ("two-mass", "modal", "modes")


@dataclass(frozen=True)
class Asked:
    """What the command line says about responses; `machine` is a file in which the plant is replaced."""

    motor: str | None = None
    load: str | None = None
    model: str | None = None
    modes: int | None = None
    band: str | None = None
    unit: str | None = None
    force_constant: float | None = None
    lead: float | None = None
    gear: float = 1.0
    machine: str | None = None
    axis: str | None = None
    out: Path | None = None


def responses_in(path: Path) -> dict[str, FRF] | None:
    """The frequency responses of a file; None if it holds none, as a log does."""
    try:
        return read_frfs(path)
    except FeeddriveError:
        return None


def perform(path: Path, found: Mapping[str, FRF], asked: Asked) -> None:
    """Choose, fit, show, write."""
    console = Console(highlight=False)
    chosen = _chosen(path, found, asked)
    fit = _fit(chosen, asked)
    for each in tables(fit):
        console.print(drawn(each))
    said = list(fit.remarks)
    if isinstance(fit, PlantFit):
        said += [f"not identifiable: {name}: {why}" for name, why in fit.not_identifiable.items()]
    for remark in said:
        console.print(f"- {remark[:1].upper()}{remark[1:]}.", markup=False)
    console.print(recommendation(fit), markup=False)
    machine = None if asked.machine is None else read_machine(asked.machine)
    name = asked.axis or ("x" if machine is None else next(iter(machine.loops)))
    text = machine_text(fit, machine, name) if isinstance(fit, PlantFit) and fit.units.si else None
    facts = {
        "File": str(path),
        "Responses": ", ".join(f"{role}: {frf.output}" for role, frf in chosen.items()),
        "Lines": ", ".join(
            f"{frf.frequency.size} from {frf.frequency[0]:.4g} to {frf.frequency[-1]:.4g} Hz" for frf in chosen.values()
        ),
        "Band": asked.band or "all lines",
        "Cost": "weighted by the variance of each line"
        if any(frf.variance is not None for frf in chosen.values())
        else "complex logarithmic ratio",
    }
    report = write_fit(fit, text, asked.out or Path("results") / f"identify_{path.name.split('.')[0]}", facts)
    if text is not None:
        console.print(f"Machine: {report.parent / 'machine.toml'}", markup=False, soft_wrap=True)
    elif isinstance(fit, PlantFit):
        console.print(
            f"- No machine file was written: the result is in {fit.units.of('kg')}; give --force-constant and --lead.",
            markup=False,
        )
    console.print(f"Report: {report}", markup=False, soft_wrap=True)


def _chosen(path: Path, found: Mapping[str, FRF], asked: Asked) -> dict[str, FRF]:
    """The responses by role: those that were named, else one alone counts as the motor's."""
    named = {role: name for role, name in (("motor", asked.motor), ("load", asked.load)) if name is not None}
    for role, name in named.items():
        if name not in found:
            raise ParameterError(f"{path}: there is no response '{name}'{nearest(name, found)}: name one with --{role}")
    if not named:
        if len(found) > 1 and asked.model != "modes":
            raise ParameterError(
                f"{path}: holds {len(found)} responses, {', '.join(found)}: say which encoder is which with --motor "
                f"NAME and --load NAME, or take --model modes for all"
            )
        named = {name if asked.model == "modes" else "motor": name for name in found}
    units = {frf.unit for name in named.values() if (frf := found[name]).unit}
    unit = asked.unit or (units.pop() if len(units) == 1 else None)
    return {
        role: replace(found[name], unit=found[name].unit if unit is None or found[name].unit else unit)
        for role, name in named.items()
    }


def _fit(chosen: Mapping[str, FRF], asked: Asked) -> PlantFit | ModalFit:
    model = asked.model or ("modal" if asked.modes else "two-mass")
    if model not in MODELS:
        raise ParameterError(f"--model must be one of {', '.join(MODELS)}, not '{model}'")
    band = frequencies(asked.band)
    if model == "modes":
        return fit_modes(chosen, asked.modes, band=band)
    travel = None if asked.lead is None else asked.lead / (2.0 * math.pi * asked.gear)
    motor, load = chosen.get("motor"), chosen.get("load")
    if model == "two-mass":
        return fit_two_mass(motor, load, band=band, force_per_unit=asked.force_constant, travel_per_unit=travel)
    return fit_modal_axis(
        motor, load, asked.modes, band=band, force_per_unit=asked.force_constant, travel_per_unit=travel
    )
