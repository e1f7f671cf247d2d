"""Co-simulation of a feeddrive control with an FMU as its plant: one run, or a comparison of the laws of a job."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from feeddrive.blocks.families import Load, Reference
from feeddrive.cosimulation.fmu import TAKEN, Archive, Instance, Port, needed, opened, ports
from feeddrive.files.atomic_io import new_directory, read_whole
from feeddrive.files.job import Job
from feeddrive.files.run_files import file_names, versions, write_run_csv, write_run_parquet
from feeddrive.language.errors import DivergedError, FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.loop.beginning import Work
from feeddrive.loop.loop import SETPOINT, Loop, Signals
from feeddrive.loop.routine import ControllerRun, Routine, controller_routine
from feeddrive.loop.simulate import Run, sample_count


def simulate_with_fmu(
    loop: Loop,
    fmu: str | Path,
    reference: Reference,
    *,
    names: Mapping[str, str] | None = None,
    parameters: Mapping[str, float] | None = None,
    load: Load | None = None,
    enable: np.ndarray | None = None,
    duration: float | None = None,
    dead_time: float = 0.0,
    bound: float | None = None,
    name: str = "run",
) -> Run:
    """Simulate a control with an FMU (FMI 2.0 or 3.0, co-simulation) as its plant, along a reference.

        at kT:  reading = outputs of the FMU;  force = control(setpoint, reading);  it acts from kT + dead_time on

    This is the order of `simulate`: with the exported plant of the same machine the results are bit-identical.  The
    control starts disabled, at the first reading, with the axis at rest.

    loop        its control and sample time are used; of its axis only the motor and the number of encoders
    fmu **a program**: it runs in this process, with all its rights
    names       variables of the FMU by signal, as {"force": "F_drive", "reading": "x:mm"}; a signal that the FMU
                has under its own name needs none.  Inputs are force (or command, in the unit of the drive),
                load_force and start_position; outputs are reading or reading_motor and reading_load, and further
                signals to record
    parameters  of the FMU, by its names and in its units
    load        force on the table, N; the FMU needs an input for it
    enable      1 or 0 for each sample, the last value holds on
    dead_time   s, before a command acts; a part of a sample needs an FMU whose step may vary
    bound       m, on |set position - reading|; default: the larger of 1 m and 100 times the travel

    Raises FmuError for an FMU that cannot be run, lacks a variable or refuses a step, DivergedError with the
    sample at which the bound was left, and ParameterError for arguments that do not fit.
    """
    if not 0.0 <= dead_time < 1.0:
        raise ParameterError(f"dead_time = {Quantity(dead_time, 's'):6 SI} must be >= 0 s and < 1 s")
    T = float(loop.sample_time)
    routine = controller_routine(loop, "control")
    motor = loop.axis.actuator.motor
    work = Work(loop, reference, load)
    count = sample_count(work, duration)
    setpoints = work.sampled(0, count)
    rows = np.array([setpoints[name] for name in (*SETPOINT, "load_force")])
    on = np.ones(1) if enable is None else np.asarray(enable, dtype=float)
    # far outside of any loop that works, yet soon enough that a wrong sign does not end in infinities
    limit = max(1.0, 100.0 * float(np.ptp(rows[0]))) if bound is None else bound
    with opened(fmu) as archive:
        wiring = ports(archive, names or {}, None if motor is None else motor.unit)
        wired = _connections(archive, wiring, routine, load is not None)
        taken, answers = np.empty((count, len(wired.taken))), np.empty((count, len(routine.outputs)))
        with Instance(archive) as plant:
            first = [(port, rows[0, 0]) for port in wiring.values() if port.signal == "start_position"]
            plant.begin([*first, *((port, rows[-1, 0]) for port in wired.load)], parameters or {})
            control, held = None, _DeadTime(T, dead_time)
            for k in range(count):
                taken[k] = plant.take(wired.taken)
                seen = taken[k, wired.readings]
                inputs = np.array([*rows[:-1, k], *seen, on[min(k, on.size - 1)]])
                _check_inside(inputs[0] - seen[-1], limit, k, T)
                # Created at the first reading, so that the control starts without a bump where the axis stands.
                control = control or ControllerRun(routine, inputs)
                answers[k] = control.step(inputs[None])[0]
                for time, length, acting in held.pieces(k, answers[k, wired.command]):
                    plant.give([(wired.drive, acting), *((port, rows[-1, k]) for port in wired.load)])
                    plant.step(time, length)
    return Run(name, _signals(routine, wired, rows, taken, answers), T, count)


def _signals(
    routine: Routine, wired: _Connections, rows: np.ndarray, taken: np.ndarray, answers: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the recorded signals of a run, with the names and in the order of the loop's signals."""
    signals = dict(zip(("set_position", "set_velocity", "set_acceleration"), rows, strict=False))
    signals |= {port.signal: taken[:, i] for i, port in enumerate(wired.taken)}
    signals["reading_motor"], signals["reading_load"] = (taken[:, wired.readings[i]] for i in (0, -1))
    signals |= {v.name: answers[:, i] for i, v in enumerate(routine.outputs)} | {"load_force": rows[-1]}
    signals["following_error"] = signals["set_position"] - signals["reading_load"]
    if "position_load" in signals:
        signals["tracking_error"] = signals["set_position"] - signals["position_load"]
    return {signal: signals[signal] for signal in Signals._fields if signal in signals}


class _Connections(NamedTuple):
    """The wiring: outputs of the FMU, those that the control reads, outputs of the control, and the load, if any."""

    taken: list[Port]
    readings: list[int]
    command: int
    drive: Port
    load: list[Port]


def _connections(archive: Archive, wiring: Mapping[str, Port], routine: Routine, load: bool) -> _Connections:
    """Wire control and FMU: a single `reading` serves both encoders, and `reading_load` a control with one encoder.

    Raises FmuError if the control needs a signal for which there is no variable.
    """
    readings = [v.name for v in routine.inputs if v.name.startswith("reading")]
    spare = "reading_load" if readings == ["reading"] else "reading"
    readings = [spare if reading not in wiring and spare in wiring else reading for reading in readings]
    command = "command" if "command" in wiring else "force"
    needed(wiring, [*readings, command], archive, "the control")
    needed(wiring, ["load_force"] if load else [], archive, "the load")
    taken = [port for signal, port in wiring.items() if signal in TAKEN]
    return _Connections(
        taken=taken,
        readings=[[port.signal for port in taken].index(signal) for signal in readings],
        command=[v.name for v in routine.outputs].index(command),
        drive=wiring[command],
        load=[wiring["load_force"]] if load else [],
    )


class _DeadTime:
    """The commands within the dead time: whole samples in a queue, a fraction of a sample as a separate step."""

    def __init__(self, T: float, dead_time: float) -> None:
        # 3e-4 / 1e-4 is 2.9999999999999996 in doubles: without the margin a whole number of samples would be split.
        whole = math.floor(dead_time / T + 1e-9)
        part = dead_time - whole * T
        # A remainder within rounding would be a step of almost no length, which solvers refuse.
        self.T, self.part = T, part if part > 1e-9 * T else 0.0
        self.pending = [0.0] * (whole + (self.part > 0.0))

    def pieces(self, k: int, command: float) -> list[tuple[float, float, float]]:
        """Return time, length and acting command of the communication steps of sample k."""
        commands = [command, *self.pending]
        self.pending = commands[:-1]
        start = k * self.T
        if self.part == 0.0:
            return [(start, self.T, commands[-1])]
        return [(start, self.part, commands[-1]), (start + self.part, self.T - self.part, commands[-2])]


def _check_inside(error: float, limit: float, k: int, T: float) -> None:
    if not abs(error) <= limit:
        raise DivergedError(
            f"the loop left its bounds at sample {k} (t = {Quantity(k * T, 's'):6 SI}): |set position - reading| is "
            f"{Quantity(abs(error), 'm'):SI}, not <= {Quantity(limit, 'm'):6 SI}; check sign and unit of the FMU's "
            "force and position, then the gains"
        )


MOST = 500_000_000  # bytes of an FMU


class Row(NamedTuple):
    """The name of a law and its run."""

    name: str
    run: Run

    def figures(self) -> dict[str, float]:
        """Return the error and force figures in SI, and the code of the first trip (0: none)."""
        error, force, trip = self.run["following_error"], self.run["force"], self.run["trip"]
        return {
            "following_error_rms_m": float(np.sqrt(np.mean(error * error))),
            "following_error_peak_m": float(np.max(np.abs(error))),
            "force_peak_N": float(np.max(np.abs(force))),
            "trip": float(next(iter(trip[trip > 0.0]), 0.0)),
        }


@dataclass(frozen=True, eq=False, repr=False)
class Cosimulation(Result):
    """The laws of a job against one FMU. `digest` is the SHA-256 of the FMU's file."""

    job: Job
    fmu: str
    digest: str
    rows: tuple[Row, ...]

    def table(self) -> Table:
        """Return a table of following error, force and trip by law."""
        lines: list[list[str | float | int]] = []
        for row in self.rows:
            rms, peak, force, trip = row.figures().values()
            lines.append([row.name, rms, peak, force, int(trip)])
        columns = ["law", Column("RMS", "m"), Column("peak", "m"), Column("force", "N"), "trip"]
        return Table(f"{self.job.title}, against {Path(self.fmu).name}", columns, lines)


def cosimulate(
    job: Job,
    fmu: str | Path,
    *,
    names: Mapping[str, str] | None = None,
    parameters: Mapping[str, float] | None = None,
    dead_time: float = 0.0,
    progress: Progress | None = None,
) -> Cosimulation:
    """Run all laws of a job against an FMU, which is a program and runs in this process.

    names, parameters, dead_time as `simulate_with_fmu`; `progress` reports the name of each law before its run.

    Raises ParameterError for a job that replays a log, and as `simulate_with_fmu`.
    """
    if job.reference is None:
        raise ParameterError(
            f"{job.file.name}: replays a log, which is valid only for its own plant: give a [reference]"
        )
    if job.machines:
        raise ParameterError(
            f"{job.file.name}: runs several axes together, which an FMU of one plant cannot be: take a job without "
            f"[others] on a machine file without [[couplings]]"
        )
    digest = hashlib.sha256(read_whole(fmu, MOST)).hexdigest()
    rows = []
    for name, loop in job.loops.items():
        if progress is not None:
            progress.step(name)
        try:
            run = simulate_with_fmu(
                loop,
                fmu,
                job.reference,
                names=names,
                parameters=parameters,
                load=job.load,
                duration=job.duration,
                dead_time=dead_time,
                name=name,
            )
        except FeeddriveError as error:
            raise type(error)(f"{job.file.name}: law '{name}': {error}") from None
        rows.append(Row(name, run))
    return Cosimulation(job, str(fmu), digest, tuple(rows))


def write_cosimulation(result: Cosimulation, out: str | Path) -> Path:
    """Write summary.json, the signals as runs/LAW.parquet and .csv, and copies of job and machine; return the summary's
    path.

    Raises FileError as `new_directory`.
    """
    with new_directory(out) as folder:
        (folder / "summary.json").write_text(json.dumps(_summary(result), indent=2) + "\n", encoding="utf-8")
        (folder / "job.toml").write_text(result.job.file.text, encoding="utf-8")
        (folder / "machine.toml").write_text(result.job.machine.file.text, encoding="utf-8")
        (folder / "runs").mkdir()
        for file, (name, run) in zip(file_names(result.rows), result.rows, strict=True):
            metadata = {"law": name, "fmu": result.digest, **versions()}
            path = folder / "runs" / file
            write_run_parquet(f"{path}.parquet", run.time, run.signals, run.units, run.sample_time, metadata)
            write_run_csv(f"{path}.csv", run.time, run.signals, run.units)
    return Path(out) / "summary.json"


def _summary(result: Cosimulation) -> dict[str, Any]:
    return {
        "title": result.job.title,
        "machine": result.job.machine.name,
        "fmu": {"file": result.fmu, "sha256": result.digest},
        "versions": dict(versions()),
        "laws": {row.name: row.figures() for row in result.rows},
    }
