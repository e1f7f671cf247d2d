"""`feeddrive excite`: what to send to an axis to measure its frequency response."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from feeddrive.cli.frf import frequencies
from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.files.machine import read_machine
from feeddrive.identification.excitation.design import design_excitation
from feeddrive.language.errors import ParameterError
from feeddrive.workflow.excitation_page import WARNING, write_excitation


def perform(machine: str, axis: str | None, band: str, out: Path | None, asked: dict[str, Any]) -> None:
    """Design, simulate, show, write."""
    console = open_console()
    held = read_machine(machine)
    loop = held.loop(axis)
    asked_band = frequencies(band)
    if asked_band is None:
        raise ParameterError("a band is needed, as --band 5..500")
    name = f"{Path(machine).stem}{'' if axis is None else f'_{axis}'}"
    found = design_excitation(loop, band=asked_band, name=name, **asked)
    console.print(drawn(found.table()))
    for remark in (*found.remarks, WARNING):
        console.print(f"- {remark}", markup=False)
    facts = {"Machine": held.name, "Source of its numbers": held.source or "not stated"}
    report = write_excitation(found, loop, out or Path("results") / f"excite_{name}", facts)
    console.print(f"Report: {report}, to be sent: {report.parent / 'excitation_1.csv'}", markup=False, soft_wrap=True)
