"""What a job with a part program adds to a row: figures along the program, observers that listen, what cuts when."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TypeAlias

import numpy as np

from feeddrive.blocks.families import Observer
from feeddrive.files.job import Job
from feeddrive.files.job_cuts import Cut
from feeddrive.language.table import Table
from feeddrive.loop.machine import Machine, System
from feeddrive.loop.simulate import Run
from feeddrive.machining.part_run import PartRun, part_run
from feeddrive.report.page import Entry, ShownTable
from feeddrive.report.sentences import number
from feeddrive.tuning.candidates import PLAIN, candidates


def out_of_the_work(job: Job, system: System) -> System:
    """The machine without what its program cuts: its margins are those before it cuts."""
    if not isinstance(system, Machine) or job.program is None or not job.program.cuts:
        return system
    return dataclasses.replace(system, couplings=system.couplings[: len(job.machine.couplings)])


Listening: TypeAlias = Mapping[str, Mapping[str, Observer]]


def along_program(job: Job, machine: Machine, run: Run, observers: Listening) -> PartRun | None:
    """The figures of a run along the job's part program; None for other jobs."""
    program = job.program
    if program is None or program.line is None:
        return None
    speeds = [each.spindle_speed for each in program.cuts if each.axial_depth > 0.0]
    return part_run(
        run, machine, program.references, program.line, counted=program.counted, cuts=bool(speeds),
        turn=60.0 / min(speeds) if speeds else None, observers=observers,
    )  # fmt: skip


def listening(job: Job) -> Listening:
    """The observers of the catalogue that recover a disturbance, by kind and axis, at the start values of a tuning;
    none for a job that does not cut.
    """
    found: dict[str, dict[str, Observer]] = {}
    if job.program is None or not job.program.cuts:
        return found
    for axis, loop in job.machine.loops.items():
        for candidate in candidates(loop)[0]:
            for block in candidate.loop.control.compensation if candidate.name.startswith(PLAIN) else ():
                observer = getattr(block, "observer", None)
                if isinstance(observer, Observer):
                    found.setdefault(observer.kind, {}).setdefault(axis, observer)
    return found


def cut_table(job: Job, row: Entry) -> list[ShownTable]:
    """What cuts while which lines run, with the force of the first row."""
    program = job.program
    if program is None or row.part is None or row.part.cutting is None:
        return []
    ends: Mapping[int, float] = {i: each.begin for i, each in enumerate(program.cuts[1:])}
    time = row.part.contour.time
    force = np.linalg.norm(row.part.cutting, axis=1)
    rows: list[list[str]] = []
    for i, each in enumerate(program.cuts):
        if each.axial_depth > 0.0:
            here = force[(time >= each.begin) & (time < ends.get(i, np.inf))]
            rows.append([*_said(each), number(float(np.sqrt(np.mean(here**2)))), number(float(np.max(here)))])
    heads = ["from line", "at s", "tool", "depth ap mm", "width ae mm", "milling", "rpm", "force RMS N", "peak N"]
    title = f"What the program cuts, and the resultant force on the tool with '{row.name}'."
    return [ShownTable(Table(title, heads, rows))]


def _said(cut: Cut) -> list[str]:
    width = "slot" if cut.radial_depth is None else f"{1e3 * cut.radial_depth:g}"
    side = "–" if cut.radial_depth is None else cut.milling
    return [
        str(cut.line),
        f"{cut.begin:.4g}",
        str(cut.tool),
        f"{1e3 * cut.axial_depth:g}",
        width,
        side,
        f"{cut.spindle_speed:g}",
    ]
