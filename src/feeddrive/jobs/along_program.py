"""Results that a part program adds to a row in the report of a job: figures along the program, observers, cuts and
chatter.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.cutting.engagement import arc
from feeddrive.blocks.families import Cutter, Observer
from feeddrive.files.job import Job
from feeddrive.files.part_program import Cut, PlannedProgram
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Cell, Column, Table
from feeddrive.language.text import Text
from feeddrive.loop.machine import Machine, System
from feeddrive.loop.simulate import Run
from feeddrive.machining.cutting_force import cutting_forces
from feeddrive.machining.load import SpindleLoad, spindle_load
from feeddrive.machining.part_run import PartRun, on_part, part_run
from feeddrive.machining.regeneration import ToothPassage, regeneration
from feeddrive.machining.tool_point import tool_point
from feeddrive.report.laws import Entry, block_sentence
from feeddrive.tuning.candidates import PLAIN, candidates


def out_of_the_work(job: Job, system: System) -> System:
    """Return the machine without the cuts of the job's program, for the analysis of its axes in air."""
    if not isinstance(system, Machine) or job.program is None or not job.program.cuts:
        return system
    # the cuts of the program follow the couplings of the machine file
    return dataclasses.replace(system, couplings=system.couplings[: len(job.machine.couplings)])


Listening: TypeAlias = Mapping[str, Mapping[str, Observer]]


def along_program(job: Job, machine: Machine, run: Run, observers: Listening) -> PartRun | None:
    """Return the figures of a run along the job's part program; None for other jobs."""
    program = job.program
    if program is None or program.line is None:
        return None
    speeds = [cut.spindle_speed for cut in program.cuts if cut.axial_depth > 0.0]
    return part_run(
        run,
        machine,
        program.references,
        program.line,
        counted=on_the_part(program),
        cuts=bool(speeds),
        turn=60.0 / min(speeds) if speeds else None,
        spindle=_spindle(job, machine, run),
        observers=observers,
        kinematics=program.kinematics,
    )


# the laws of a job run the same program: one entry is enough
@lru_cache(maxsize=1)
def on_the_part(program: PlannedProgram) -> np.ndarray | None:
    """Return a mask of the samples at which the tool generates a finished wall of the part (see `on_part`).

    Without a [process] section, all samples at feed rate are included, and likewise for a cut that generates no
    finished wall.
    """
    counted, process = program.counted, program.process
    if counted is None or process is None or not {"x", "y"} <= set(program.references):
        return counted
    x, y = program.references["x"], program.references["y"]
    position = np.column_stack([x.position, y.position])
    assert x.velocity is not None
    assert y.velocity is not None
    velocity = np.column_stack([x.velocity, y.velocity])
    begins = np.round(np.array([cut.begin for cut in program.cuts]) / x.sample_time).astype(np.int64)
    counts = counted.copy()
    for cut, first, last in zip(program.cuts, begins, [*begins[1:], len(counted)], strict=True):
        if cut.axial_depth > 0.0 and cut.radial_depth is not None:
            radius = 0.5 * float(process.tools[cut.tool].edge().diameter)
            here = slice(int(first), int(last))
            leaves = on_part(position[here], velocity[here], radius, cut.milling)
            counts[here] &= leaves | ~np.any(leaves)
    return counts


def _spindle(job: Job, machine: Machine, run: Run) -> SpindleLoad | None:
    """Return the spindle load due to all cuts in a run, with the chip volume; None if there are no cuts."""
    program = job.program
    cuts = [cut for cut in machine.couplings if isinstance(cut, MillingCut) and cut not in job.machine.couplings]
    if program is None or program.process is None or not cuts:
        return None
    power = sum((cutting_forces(run, cut).power for cut in cuts), np.zeros(run.samples))
    speed = np.sqrt(sum((run[f"{axis}.set_velocity"] ** 2 for axis in ("x", "y")), np.zeros(run.samples)))
    # rounding must not put the first sample of a cut into the section before it
    begins = np.searchsorted([cut.begin for cut in program.cuts], run.time + 1e-9, side="right") - 1
    areas = np.array([_area(cut, program.process.tools) for cut in program.cuts])
    volume = float(np.sum(areas[begins] * speed)) * run.sample_time
    # a load is a torque and a speed: at 30/π rpm, which is 1 rad/s, the torque in N m is the power in W
    return spindle_load(power, 30.0 / np.pi, run.sample_time, volume if volume > 0.0 else None)


def _area(cut: Cut, tools: Mapping[int, Cutter]) -> float:
    """Return the cross-section of a cut, depth times width, in m²."""
    width = float(tools[cut.tool].edge().diameter) if cut.radial_depth is None else cut.radial_depth
    return cut.axial_depth * width if cut.axial_depth > 0.0 else 0.0


def listening(job: Job) -> Listening:
    """Return the disturbance observers of the catalog by kind and axis, with their initial gains for that axis.

    The mapping is empty for a job without cuts.
    """
    observers: dict[str, dict[str, Observer]] = {}
    if job.program is None or not job.program.cuts:
        return observers
    for axis, loop in job.machine.loops.items():
        for candidate in candidates(loop)[0]:
            # other candidates compensate with the same observers: those of the reference law alone give each kind once
            for block in candidate.loop.control.compensation if candidate.name.startswith(PLAIN) else ():
                observer = getattr(block, "observer", None)
                if isinstance(observer, Observer):
                    observers.setdefault(observer.kind, {}).setdefault(axis, observer)
    return observers


class Chatter(NamedTuple):
    """The chatter verdict on one kind of cut under a law; |µ| is the growth factor of a vibration from tooth to tooth.

    cut        first section of the program with these cutting conditions
    growth     |µ|; None if it is unknown, for the reason in `why`
    frequency  chatter frequency in Hz; None if there is no chatter
    """

    law: str
    cut: Cut
    growth: float | None
    frequency: float | None = None
    why: str = ""


def chatter(job: Job, rows: Sequence[Entry]) -> tuple[Chatter, ...]:
    """Return the chatter verdict on each kind of cut, under the first law and the law with the least contour error.

    The feed is assumed to be along x.
    """
    program = job.program
    ran = [row for row in rows if row.part is not None]
    if program is None or program.process is None or not ran:
        return ()
    # beginning and line are no cutting conditions, and `reversed` keeps the first cut of a kind
    kinds = {cut[2:]: cut for cut in reversed(program.cuts) if cut.axial_depth > 0.0}
    best = min(ran, key=lambda row: row.part.contour.rms if row.part is not None else np.inf)
    verdicts: list[Chatter] = []
    for row in dict.fromkeys((ran[0].name, best.name)):
        idle = out_of_the_work(job, job.machines[row])
        if not isinstance(idle, Machine):
            continue
        for cut in sorted(kinds.values()):
            try:
                verdicts.append(_chatters(row, idle, cut, program.process.tools[cut.tool]))
            # a kind of cut that cannot be analyzed must not prevent the verdicts on the others
            except FeeddriveError as error:
                verdicts.append(Chatter(row, cut, None, why=str(error)))
    return tuple(verdicts)


def _chatters(law: str, idle: Machine, cut: Cut, cutter: Cutter) -> Chatter:
    point = tool_point(idle, along=("x", "y"))
    entry, leave = arc(cut.milling, cut.radial_depth, cutter.edge().diameter)
    edges = regeneration(cutter, entry=float(entry), leave=float(leave))
    passage = ToothPassage(point, edges, cut.spindle_speed)
    growth = float(np.abs(passage.multipliers([cut.axial_depth])[0]))
    return Chatter(law, cut, growth, passage.frequency(cut.axial_depth, point) if growth >= 1.0 else None)


def chatter_remarks(verdicts: Sequence[Chatter]) -> list[str]:
    """Return the chatter verdicts as sentences."""
    remarks: list[str] = [
        Text(
            f"'{verdict.law}': the cut from line {verdict.cut.line} chatters at {Quantity(verdict.frequency, 'Hz'):3}: "
            f"a vibration grows {number(verdict.growth)} times from tooth to tooth; `feeddrive lobes` shows depths and "
            "speeds at which it does not."
        )
        for verdict in verdicts
        if verdict.frequency is not None
    ]
    remarks += [
        Text(f"'{verdict.law}': whether the cut from line {verdict.cut.line} chatters is not known: {verdict.why}.")
        for verdict in verdicts
        if verdict.growth is None
    ]
    known = [verdict for verdict in verdicts if verdict.growth is not None]
    if known and not any(verdict.frequency for verdict in known):
        most = max(known, key=lambda verdict: verdict.growth or 0.0)
        remarks.append(
            f"No cut chatters: a vibration is at most multiplied by {number(most.growth)} from tooth to tooth "
            f"('{most.law}', from line {most.cut.line}), by the modes of the axes; tool and holder are taken as rigid."
        )
    return remarks


def cut_table(job: Job, row: Entry, verdicts: Sequence[Chatter]) -> list[Table]:
    """Return the table of the cuts by program line, with the cutting force under the law of `row` and the verdicts.

    The list is empty for a job without cuts.
    """
    program = job.program
    if program is None or row.part is None or row.part.cutting is None:
        return []
    ends: Mapping[int, float] = {i: cut.begin for i, cut in enumerate(program.cuts[1:])}
    time = row.part.contour.time
    force = np.linalg.norm(row.part.cutting, axis=1)
    laws = list(dict.fromkeys(verdict.law for verdict in verdicts))
    growth = {(verdict.law, verdict.cut[2:]): verdict.growth for verdict in verdicts}
    rows: list[list[Cell]] = []
    for i, cut in enumerate(program.cuts):
        if cut.axial_depth > 0.0:
            here = force[(time >= cut.begin) & (time < ends.get(i, np.inf))]
            forces = [float(np.sqrt(np.mean(here**2))), float(np.max(here))]
            rows.append([*_cells(cut), *forces, *(growth.get((law, cut[2:])) for law in laws)])
    columns = [
        Column("from line"),
        Column("at", "s", "SI"),
        Column("tool"),
        Column("depth ap", "m", "6 mm"),
        Column("width ae", "m", "6 mm"),
        Column("milling"),
        Column("", "rpm", "6"),
        Column("force RMS", "N", "3"),
        Column("peak", "N", "3"),
        *(Column(f"|µ| '{law}'", form="3") for law in laws),
    ]
    title = (
        f"What the program cuts, the resultant force on the tool with '{row.name}', and |µ|, the factor of a vibration "
        "from tooth to tooth with the feed along x: from 1 on the cut chatters."
    )
    return [Table(title, columns, rows)]


def cut_sentence(cut: MillingCut) -> str:
    """Describe a cut of a program in words, for reports."""
    regenerative = f"regenerative, over {cut.surfaces} earlier surfaces"
    return Text(f"milling cut on {', '.join(cut.axes())}, {regenerative} ({block_sentence(cut.cutter)})")


def _cells(cut: Cut) -> list[Cell]:
    slot = cut.radial_depth is None
    return [
        cut.line,
        cut.begin,
        cut.tool,
        cut.axial_depth,
        "slot" if slot else cut.radial_depth,
        None if slot else cut.milling,
        cut.spindle_speed,
    ]
