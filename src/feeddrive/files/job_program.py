"""The section [program] of a job: a part program, planned, as the reference of all axes that it moves.

[program]
file = "part.ngc"                  # beside the job
tools = "tool.tbl"                 # optional, as offsets, tables_inch, skip_deleted of `feeddrive plan`
limits = "limits.toml"             # in place of [axis.x.limits] of the machine file
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.files.machine import MachineFile, planned_limits
from feeddrive.files.toml_file import Section
from feeddrive.language.errors import FeeddriveError, NotPlannedError
from feeddrive.path.program.reading import read_program
from feeddrive.path.setpoints import Setpoints

FILES = ("file", "tools", "offsets", "limits")
_FLAGS = ("tables_inch", "skip_deleted")
MOST = 4_000_000
"""Samples of a program that a job runs: a row of each of its signals is held in memory."""


@dataclass(frozen=True, eq=False)
class PlannedProgram:
    """A part program as references of axes, by their names in the machine file.

    said  in words, for reports
    """

    references: Mapping[str, Recorded]
    said: str


def read_planned(section: Section, place: Path, machine: MachineFile) -> PlannedProgram:
    """The program of a section, planned within the limits of the machine and proven.

    Raises ParameterError or FileError as the section and its files are wrong, ProgramError at a line of the program,
    NotPlannedError if it is too long or its proof does not hold.
    """
    section.refuse_unknown((*FILES, *_FLAGS))
    files = {name: _file(section, place, name) for name in FILES}
    inch, skip = (_flag(section, name) for name in _FLAGS)
    program = files["file"]
    if program is None:
        raise section.error('program.file is missing: file = "part.ngc"')
    try:
        limits = planned_limits(machine, files["limits"])
    except FeeddriveError as error:
        raise type(error)(f"{section.where()}: {error}") from None
    T = float(next(iter(machine.loops.values())).sample_time)
    kept: list[np.ndarray] = []
    moves = read_program(
        program, axes=limits.travel, tools=files["tools"], offsets=files["offsets"], tables_inch=inch, skip_deleted=skip
    )
    with closing(moves):
        setpoints = Setpoints(moves, limits, T)
        for samples in setpoints:
            kept.append(samples.values)
            if setpoints.samples > MOST:
                raise NotPlannedError(
                    f"{section.where()}: {program.name} lasts longer than {MOST * T:.6g} s, {MOST:,} samples, which a "
                    "job does not hold in memory: cut the program, or take feeddrive plan for its setpoints"
                )
            if not samples.proven:
                raise NotPlannedError(
                    f"{section.where()}: {program.name}: the motion could not be proven to keep its limits: "
                    f"{limits.named(str(setpoints.prover.proof().faults[0]))}. This is a fault of feeddrive, not of "
                    "the program"
                )
    rows = np.concatenate(kept)
    names = {name.upper(): name for name in machine.loops}
    references = {
        names[letter]: Recorded(
            position=rows[:, i, 0].copy(), velocity=rows[:, i, 1].copy(), acceleration=rows[:, i, 2].copy(),
            jerk=rows[:, i, 3].copy(), snap=rows[:, i, 4].copy(), sample_time=T,
        )
        for i, letter in enumerate(limits.letters)
    }  # fmt: skip
    said = f"part program {program.name}, {setpoints.blocks:,} blocks in {setpoints.time:.6g} s, planned and proven"
    return PlannedProgram(references, said)


def _file(section: Section, place: Path, name: str) -> Path | None:
    value = section.values.get(name)
    if value is not None and not isinstance(value, str):
        raise section.error(f'{section.dotted(name)} must be a text in quotes ("...")', name)
    return None if value is None else place.parent / value


def _flag(section: Section, name: str) -> bool:
    value = section.values.get(name, False)
    if not isinstance(value, bool):
        raise section.error(f"{section.dotted(name)} must be true or false", name)
    return value
