"""`feeddrive frf`: a frequency response from one or more logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich.console import Console

from feeddrive.artefacts.files.log import read_log
from feeddrive.artefacts.files.measured import Log
from feeddrive.artefacts.files.messages import nearest
from feeddrive.artefacts.measurement.frf_page import levels, sentences, write_estimate
from feeddrive.doors.cli.working import drawn
from feeddrive.engineer.identification.estimate_frf import estimate_frf
from feeddrive.engineer.identification.record import Record
from feeddrive.language import units
from feeddrive.language.errors import LogError, ParameterError

# names that a column may have for each role, the first that is there is taken
USUAL = {
    "input": ("force", "torque", "current", "command", "iq"),
    "output": ("position_load", "reading_load", "position", "position_motor", "reading_motor", "y", "x"),
    "reference": ("excitation", "added_force", "reference"),
}
_SI = ("m", "m/s", "m/s2", "N", "rad", "rad/s", "N m", "A")


def perform(
    logs: Sequence[Path], named: dict[str, str | None], references: Sequence[str], method: str, band: str | None,
    period: int | None, skip: int | None, segment: int | None, sample_time: float | None, out: Path | None,
) -> None:  # fmt: skip
    """Read, estimate, show, write."""
    console = Console(highlight=False)
    records = [_record(read_log(log, sample_time=sample_time), named, references) for log in logs]
    found = estimate_frf(
        records, method=method.replace("-", "_"), band=frequencies(band), period=period, skip=skip, segment=segment
    )
    console.print(drawn(found.table()))
    if found.levels:
        console.print(drawn(levels(found)))
    for sentence in (*sentences(found), *found.remarks):
        console.print(f"- {sentence}", markup=False)
    if not records[0].references:
        console.print(
            "- No reference was given: if the loop was closed, name what was added to it with --reference.",
            markup=False,
        )
    facts = {"Logs": ", ".join(str(log) for log in logs), "Input": found.frf.input, "Output": found.frf.output,
             "Sample time": f"{1e3 * records[0].sample_time:.6g} ms"}  # fmt: skip
    report = write_estimate(found, out or Path("results") / f"frf_{logs[0].name.split('.')[0]}", facts)
    console.print(f"Report: {report}, response: {report.parent / 'frf.csv'}", markup=False, soft_wrap=True)


def frequencies(band: str | None) -> tuple[float, float] | None:
    """`5..500` as two numbers. Raises ParameterError for anything else."""
    if band is None:
        return None
    parts = band.split("..")
    try:
        low, high = (float(part) for part in parts)
    except ValueError:
        raise ParameterError(f"band '{band}' must be two frequencies in Hz, as 5..500") from None
    return low, high


def _record(log: Log, named: dict[str, str | None], references: Sequence[str]) -> Record:
    """The channels of a log by name, in SI as far as their units are known."""
    names = {role: _column(log, role, named[role]) for role in ("input", "output")}
    told = [*references] or [name for name in USUAL["reference"] if name in log.channels][:1]
    found = {role: _values(log, name) for role, name in names.items() if name is not None}
    for role in ("input", "output"):
        if role not in found:
            raise LogError(
                f"{log.name}: has no column that is named like an {role}{nearest(USUAL[role][0], log.channels)}: name "
                f"it with --{role}"
            )
    kept = [_values(log, name)[0] for name in told if name != "none"]
    of_input, of_output = found["input"][1], found["output"][1]
    return Record(
        input=found["input"][0], output=found["output"][0], references=tuple(kept), sample_time=log.sample_time,
        input_name=_plain(names["input"]), output_name=_plain(names["output"]),
        unit=f"{of_output}/{of_input}" if of_input and of_output else "", name=log.name,
    )  # fmt: skip


def _plain(name: str | None) -> str:
    return str(name).partition(":")[0]


def _column(log: Log, role: str, asked: str | None) -> str | None:
    return asked or next((name for name in USUAL[role] if name in log.channels), None)


def _values(log: Log, named: str) -> tuple[np.ndarray, str]:
    """A channel, `name` or `name:unit`, and its unit in SI."""
    name, _, stated = named.partition(":")
    if name not in log.channels:
        raise LogError(f"{log.name}: there is no column '{name}'{nearest(name, log.channels)}")
    unit = stated or log.units.get(name, "")
    for si in _SI:
        try:
            return log[name] * units.factor(unit, si), si
        except ParameterError:
            continue
    return log[name], unit
