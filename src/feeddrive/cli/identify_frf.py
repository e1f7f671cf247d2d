"""`feeddrive identify FRF.csv`: masses, springs and modes of an axis from measured frequency responses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from feeddrive.blocks.families import Plant
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.cli.frf import frequencies
from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.files.frf import encoders, names_frequency, read_frfs
from feeddrive.files.machine import MachineFile, read_machine
from feeddrive.files.messages import nearest, sentence
from feeddrive.identification.response.fit_axis import AxisFits, fit_axis
from feeddrive.identification.response.modal_fit import ModalFit, fit_modes
from feeddrive.language import tree, units
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.table import Table
from feeddrive.loop.axis import Axis
from feeddrive.loop.frequency_response import FRF
from feeddrive.workflow.response_page import machine_text, recommendation, tables, told_by, write_fit

MODELS = ("auto", "rigid", "machine", "two-mass", "modal", "modes")


@dataclass(frozen=True)
class Asked:
    """What the command line says about responses; `machine` is a file in which the plant is replaced."""

    motor: str | None = None
    load: str | None = None
    model: str | None = None
    modes: int | None = None
    band: str | None = None
    unit: str | None = None
    fix: Sequence[str] = ()
    measured_input: bool = False
    force_constant: float | None = None
    lead: float | None = None
    gear: float = 1.0
    machine: str | None = None
    axis: str | None = None
    out: Path | None = None


def responses_in(path: Path) -> dict[str, FRF] | None:
    """The frequency responses of a file; None if it holds none, as a log does. Raises what is wrong with its lines."""
    try:
        return read_frfs(path)
    except FeeddriveError:
        if names_frequency(path):
            raise
        return None


def perform(path: Path, found: Mapping[str, FRF], asked: Asked) -> None:
    """Choose, fit, show, write."""
    console = open_console()
    positive(asked.force_constant, asked.lead, asked.gear)
    model = asked.model or ("modal" if asked.modes else "auto")
    if model not in MODELS:
        raise ParameterError(f"--model must be one of {', '.join(MODELS)}, not '{model}'")
    chosen = _chosen(path, found, asked, model)
    machine = None if asked.machine is None else read_machine(asked.machine)
    axis = None if machine is None else machine.loop(asked.axis).axis
    bar = Progress(SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=console,
                   transient=True)  # fmt: skip
    with bar:
        task = bar.add_task("")
        step: Callable[[str], None] = lambda text: bar.update(task, description=escape(text))  # noqa: E731
        result = _fit(chosen, asked, model, axis, step)
        step("report")
        fit = result.fit if isinstance(result, AxisFits) else result
        name = _axis_name(machine, asked.axis)
        reason = told_by(fit)
        text = None if reason or isinstance(fit, ModalFit) else machine_text(fit, machine, name)
        remarks = [*_silent(chosen), *fit.remarks]
        facts = _facts(path, chosen, asked)
        report = write_fit(
            result, remarks, text, asked.out or Path("results") / f"identify_{path.name.split('.')[0]}", facts
        )
    for each in tables(result):
        console.print(drawn(narrow(each), 4 if each.heads[0] == "structure" else None))
    not_told = {} if isinstance(fit, ModalFit) else fit.not_identifiable
    for remark in (*remarks, *(f"not identifiable: {name}: {why}" for name, why in not_told.items())):
        console.print(f"- {sentence(remark)}", markup=False)
    console.print(recommendation(result), markup=False)
    if text is not None:
        console.print(f"Machine: {report.parent / 'machine.toml'}", markup=False, soft_wrap=True)
    elif reason:
        console.print(f"- No machine file was written: {reason}.", markup=False)
    console.print(f"Report: {report}", markup=False, soft_wrap=True)


def narrow(table: Table) -> Table:
    """A table of estimates without its intervals, which the report has: a terminal of 80 columns holds it whole."""
    if table.heads[-1] != "95 % interval":
        return table
    rows = [[*row[:-1], "unknown" if row[-1].startswith("not") else ""] for row in table.rows]
    return Table(table.title, [*table.heads[:-1], ""], rows)


def positive(force_constant: float | None, lead: float | None, gear: float) -> None:
    """Raise ParameterError for a constant of the drive that cannot be."""
    for name, value in (("--force-constant", force_constant), ("--lead", lead), ("--gear", gear)):
        if value is not None and not 0.0 < value < math.inf:
            raise ParameterError(f"{name} = {value:g} must be > 0")


def _axis_name(machine: MachineFile | None, axis: str | None) -> str:
    return axis or ("x" if machine is None else next(iter(machine.loops)))


def _facts(path: Path, chosen: Mapping[str, FRF], asked: Asked) -> dict[str, str]:
    weighted = any(frf.variance is not None for frf in chosen.values())
    return {
        "File": str(path),
        "Responses": ", ".join(f"{role}: {frf.output}" for role, frf in chosen.items()),
        "Lines": ", ".join(
            f"{frf.frequency.size} from {frf.frequency[0]:.4g} to {frf.frequency[-1]:.4g} Hz" for frf in chosen.values()
        ),
        "Band": asked.band or "all lines",
        "Known before": ", ".join(asked.fix) or "nothing",
        "Cost": "weighted by the variance of each line" if weighted else "complex logarithmic ratio",
    }


def _silent(chosen: Mapping[str, FRF]) -> list[str]:
    """What was taken for granted."""
    silent = [role for role, frf in chosen.items() if not frf.unit]
    if not silent:
        return []
    return [f"no unit is stated for {' and '.join(silent)}: m/N is taken; say another one with --unit, as (m/s)/N"]


def _chosen(path: Path, found: Mapping[str, FRF], asked: Asked, model: str) -> dict[str, FRF]:
    """The responses by role: those that were named, or in files of their own, else by their names."""
    named: dict[str, FRF] = {}
    for role, name in (("motor", asked.motor), ("load", asked.load)):
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
        if asked.unit is not None and frf.unit and frf.unit != asked.unit:
            raise ParameterError(f"{path}: the response of {role} is in {frf.unit}, as its file says, not {asked.unit}")
    known = {frf.unit for frf in named.values() if frf.unit}
    unit = asked.unit or (known.pop() if len(known) == 1 else None)
    return {role: frf if unit is None or frf.unit else replace(frf, unit=unit) for role, frf in named.items()}


def _fit(
    chosen: Mapping[str, FRF], asked: Asked, model: str, axis: Axis | None, step: Callable[[str], None]
) -> AxisFits | ModalFit:
    band = frequencies(asked.band)
    if model == "modes":
        return fit_modes(chosen, asked.modes, band=band, step=step)
    if model == "machine" and axis is None:
        raise ParameterError("--model machine needs a machine file with --machine")
    return fit_axis(
        chosen.get("motor"),
        chosen.get("load"),
        plant=None if axis is None else axis.plant,
        actuator=None if axis is None else axis.actuator,
        modes=asked.modes,
        fixed=_fixed(asked.fix, None if axis is None else axis.plant),
        structure=None if model == "auto" else model,
        held=not asked.measured_input,
        band=band,
        force_per_unit=asked.force_constant,
        travel_per_unit=None if asked.lead is None else asked.lead / (2.0 * math.pi * asked.gear),
        step=step,
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
