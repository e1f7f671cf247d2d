"""A corrected part as files for any control: set positions and force offsets of all axes, sample by sample.

correction.parquet    all derivatives and forces in SI units; read back by `read_correction`, bit for bit
setpoints.csv         time, program line, set positions and force offsets
streamer.txt, setpoints.hal   LinuxCNC: positions in mm, then force offsets in N
cia402_AXIS.csv       CiA 402: target position 0x607A in increments, torque offset 0x60B2 in 0.1 % of the rated torque

Text files end with rows in which the axes rest and the forces fall to 0: a control that holds its last row then holds
no force.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.bus.drive_file import DriveScaling
from feeddrive.files.read_log import OpenedFile, read_log
from feeddrive.files.run_files import write_run_parquet
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.learning.part_correction import Correction
from feeddrive.learning.planned_friction import RAMP, smooth_step
from feeddrive.version import __version__

RECORD, ROWS, TEXT, STREAMER, HAL = (
    "setpath.json",
    "correction.parquet",
    "setpoints.csv",
    "streamer.txt",
    "setpoints.hal",
)
_SETPOINT = ("set_position", "set_velocity", "set_acceleration", "set_jerk", "set_snap")
_UNITS = ("m", "m/s", "m/s2", "m/s3", "m/s4")
_CHANGE = ("path_change", "path_change_velocity", "path_change_acceleration", "path_change_jerk", "path_change_snap")
_MOST_PER_MILLE, _MOST_INCREMENTS = 2**15 - 1, 2**31 - 1  # of 0x60B2, i16, and 0x607A, i32


def write_correction(
    folder: Path,
    correction: Correction,
    line: np.ndarray | None,
    drives: Mapping[str, DriveScaling],
    *,
    before: Correction | None = None,
) -> None:
    """Write the files of a corrected part into a folder.

    line    line of the part program by sample
    drives  scaling of the drives that get a file for CiA 402, by axis
    before  correction that ran with the logged part: the next log may show that it was the better one

    Raises ParameterError for an offset or a position that does not fit into the object of a drive.
    """
    T, references = correction.sample_time, correction.references
    n = next(iter(references.values())).position.size
    time = np.arange(n) * T
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    for axis, path in references.items():
        for name, unit, row in zip(_SETPOINT, _UNITS, path.at(time), strict=True):
            columns[f"{axis}.{name}"], units[f"{axis}.{name}"] = np.asarray(row), unit
        if axis in correction.paths:
            for name, unit, row in zip(_CHANGE, _UNITS, correction.paths[axis], strict=True):
                columns[f"{axis}.{name}"], units[f"{axis}.{name}"] = row, unit
        if axis in correction.forces:
            columns[f"{axis}.added_force"], units[f"{axis}.added_force"] = correction.forces[axis], "N"
        if before is not None and axis in before.forces:
            columns[f"{axis}.added_force_before"] = before.forces[axis]
            units[f"{axis}.added_force_before"] = "N"
    about = {"passes": correction.passes, "written_by": f"feeddrive {__version__}"}
    write_run_parquet(folder / ROWS, time, columns, units, T, about)
    axes, instants, lines, positions, forces = _with_rest(correction, line)
    _write_text(folder / TEXT, axes, instants, lines, positions, forces)
    _write_streamer(folder, axes, T, positions, forces)
    for axis, scaling in drives.items():
        i = axes.index(axis)
        _write_drive(folder / f"cia402_{axis}.csv", axis, scaling, instants, positions[:, i], forces[:, i])


def write_setpoints(file: Path, correction: Correction, line: np.ndarray | None = None) -> None:
    """Write set positions and force offsets of all axes as CSV; the forces fall to 0 in a rest at the end."""
    _write_text(file, *_with_rest(correction, line))


def _with_rest(
    correction: Correction, line: np.ndarray | None
) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return axes, instants, program lines, positions and forces, with rows at rest behind the last one."""
    T, references = correction.sample_time, correction.references
    axes, n = list(references), next(iter(references.values())).position.size
    rest = max(1, round(RAMP / T))
    positions = np.column_stack(
        [np.append(references[axis].position, np.full(rest, references[axis].position[-1])) for axis in axes]
    )
    forces = np.column_stack([_faded(correction.forces.get(axis, np.zeros(n)), rest) for axis in axes])
    instants = np.arange(n + rest) * T
    lines = np.full(n + rest, -1) if line is None else np.append(line, np.full(n + rest - line.size, line[-1]))
    return axes, instants, lines, positions, forces


def _faded(force: np.ndarray, rows: int) -> np.ndarray:
    """Return a force that falls to 0 in more rows, without a jump."""
    t = np.arange(1, rows + 1) / rows
    return np.append(force, force[-1] * (1.0 - smooth_step(t)))


def _table(file: Path, columns: Mapping[str, np.ndarray], *, head: bool, delimiter: str) -> None:
    """Write columns as text with the fewest digits that give each number back."""
    import pyarrow as arrow
    from pyarrow import csv

    table = arrow.Table.from_arrays([np.ascontiguousarray(row) for row in columns.values()], names=list(columns))
    options = csv.WriteOptions(include_header=head, delimiter=delimiter, quoting_style="none")
    csv.write_csv(table, str(file), options)


def _write_text(
    file: Path, axes: list[str], time: np.ndarray, line: np.ndarray, positions: np.ndarray, forces: np.ndarray
) -> None:
    columns = {"time_s": time, "line": line}
    columns |= {f"{axis}_set_position_m": positions[:, i] for i, axis in enumerate(axes)}
    columns |= {f"{axis}_force_offset_N": forces[:, i] for i, axis in enumerate(axes)}
    _table(file, columns, head=True, delimiter=",")


def _write_streamer(folder: Path, axes: list[str], T: float, positions: np.ndarray, forces: np.ndarray) -> None:
    rows = {f"p{i}": 1e3 * column for i, column in enumerate(positions.T)}
    rows |= {f"f{i}": column for i, column in enumerate(forces.T)}
    _table(folder / STREAMER, rows, head=False, delimiter=" ")
    count = len(axes)
    pins = [f"# net {axis}-set streamer.0.pin.{i} => pid.{axis}.command" for i, axis in enumerate(axes)]
    pins += [
        f"# net {axis}-force-offset streamer.0.pin.{count + i} => sum2.{axis}.in1    # in N, added to the command"
        for i, axis in enumerate(axes)
    ]
    text = [
        f"# Corrected part: positions of {', '.join(axes)} in mm, then their force offsets in N, a line every "
        f"{1e3 * T:.12g} ms.",
        f"# To be read when the thread servo-thread is there; its period must be {1e9 * T:.12g} ns.",
        f"loadrt streamer depth=16000 cfg={'f' * (2 * count)}",
        "setp streamer.0.enable 0",
        "addf streamer.0 servo-thread",
        f"loadusr halstreamer {STREAMER}",
        "# Connect the pins, then start with  setp streamer.0.enable 1",
        *pins,
    ]
    (folder / HAL).write_text("\n".join(text) + "\n", encoding="utf-8")


def _write_drive(
    file: Path, axis: str, scaling: DriveScaling, time: np.ndarray, position: np.ndarray, force: np.ndarray
) -> None:
    """Write 0x607A and 0x60B2 of a drive, sample by sample."""
    increments = np.rint(position / scaling.metre)
    offset = scaling.force_sign * np.rint(force / scaling.newton)
    for what, values, most, remedy in (
        ("torque offset 0x60B2", offset, _MOST_PER_MILLE, "look at scaling.rated_torque or rated_force"),
        ("target position 0x607A", increments, _MOST_INCREMENTS, "look at scaling.counts_per_turn, lead and increment"),
    ):
        over = np.flatnonzero(np.abs(values) > most)
        if over.size:
            k = int(over[0])
            raise ParameterError(
                f"axis {axis}: the {what} is {int(values[k])} at {Quantity(float(time[k]), 's'):6 SI}, beyond {most}, "
                f"the largest that the object holds: {remedy}"
            )
    columns = {
        "time_s": time,
        "target_position_0x607A": increments.astype(np.int64),
        "torque_offset_0x60B2": offset.astype(np.int64),
    }
    _table(file, columns, head=True, delimiter=",")


def read_correction(folder: Path, plan: Mapping[str, Recorded]) -> tuple[Correction, Correction | None, dict[str, Any]]:
    """Return the correction in a directory, that of the part before it, and the record of the directory.

    Raises FileError if the directory holds no correction, and ParameterError if it is of another motion.
    """
    for name in (RECORD, ROWS):
        if not (folder / name).is_file():
            raise FileError(
                f"{folder}: has no {name}: name a directory that `feeddrive setpath JOB --out` wrote, with a "
                "correction that was accepted"
            )
    try:
        record = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except ValueError as error:
        raise FileError(f"{folder / RECORD}: is damaged: {error}") from None
    log = read_log(OpenedFile(folder / ROWS))
    n = next(iter(plan.values())).position.size
    if len(log) != n:
        raise ParameterError(f"{folder}: has {len(log)} samples, the plan of the job {n}: it is of another program")
    forces, before, paths = {}, {}, {}
    for axis, path in plan.items():
        there = set(log.channels)
        if f"{axis}.set_position" not in there:
            raise ParameterError(f"{folder}: has no axis {axis}, which the job moves: it is of another program")
        change = [log[f"{axis}.{name}"] for name in _CHANGE] if f"{axis}.{_CHANGE[0]}" in there else None
        played = log[f"{axis}.set_position"]
        off = played - (path.position if change is None else path.position + change[0])
        if float(np.max(np.abs(off))) > 0.0:
            raise ParameterError(
                f"{folder}: the set positions of axis {axis} differ from the plan of the job by up to "
                f"{Quantity(float(np.max(np.abs(off))), 'm')}: it is of another program, or of other limits"
            )
        if change is not None:
            paths[axis] = np.array(change)
        if f"{axis}.added_force" in there:
            forces[axis] = log[f"{axis}.added_force"]
        if f"{axis}.added_force_before" in there:
            before[axis] = log[f"{axis}.added_force_before"]
    last = Correction(plan, forces, paths, passes=int(record.get("passes", 0)))
    return last, Correction(plan, before) if before else None, record
