"""The laws of a job compared on an FMU as the plant: time responses only, since an FMU has no linear model."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from feeddrive.cosimulation.simulate_with_fmu import simulate_with_fmu
from feeddrive.files.atomic_io import new_directory, read_whole
from feeddrive.files.job import Job
from feeddrive.files.provenance import file_names, versions
from feeddrive.files.run_files import write_run_csv, write_run_parquet
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.table import Result, Table
from feeddrive.loop.simulate import Run

MOST = 500_000_000  # bytes of an FMU


class Row(NamedTuple):
    """A law and its run."""

    name: str
    run: Run

    def figures(self) -> dict[str, float]:
        """Errors and force in SI, and the code of the first trip (0: none)."""
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
        """Following error, force and trip by law."""
        lines = []
        for row in self.rows:
            rms, peak, force, trip = row.figures().values()
            lines.append([row.name, f"{1e6 * rms:.4g}", f"{1e6 * peak:.4g}", f"{force:.4g}", f"{trip:g}"])
        return Table(
            f"{self.job.title}, against {Path(self.fmu).name}", ["law", "RMS um", "peak um", "force N", "trip"], lines
        )


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

    names, parameters, dead_time as `simulate_with_fmu`; `progress` reports the name of each law before it.

    Raises ParameterError for a job that replays a log, and as `simulate_with_fmu`.
    """
    if job.reference is None:
        raise ParameterError(
            f"{job.file.name}: replays a log, which tells nothing of another plant: give a [reference]"
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
                loop, fmu, job.reference, names=names, parameters=parameters, load=job.load, duration=job.duration,
                dead_time=dead_time, name=name,
            )  # fmt: skip
        except FeeddriveError as error:
            raise type(error)(f"{job.file.name}: law '{name}': {error}") from None
        rows.append(Row(name, run))
    return Cosimulation(job, str(fmu), digest, tuple(rows))


def write_cosimulation(found: Cosimulation, out: str | Path) -> Path:
    """Write summary.json, the signals as runs/LAW.parquet and .csv, and copies of job and machine; the summary's path.

    Raises FileError as `new_directory`.
    """
    with new_directory(out) as folder:
        (folder / "summary.json").write_text(json.dumps(_summary(found), indent=2) + "\n", encoding="utf-8")
        (folder / "job.toml").write_text(found.job.file.text, encoding="utf-8")
        (folder / "machine.toml").write_text(found.job.machine.file.text, encoding="utf-8")
        (folder / "runs").mkdir()
        for file, (name, run) in zip(file_names(found.rows), found.rows, strict=True):
            metadata = {"law": name, "fmu": found.digest, **versions()}
            path = folder / "runs" / file
            write_run_parquet(f"{path}.parquet", run.time, run.signals, run.units, run.sample_time, metadata)
            write_run_csv(f"{path}.csv", run.time, run.signals, run.units)
    return Path(out) / "summary.json"


def _summary(found: Cosimulation) -> dict[str, Any]:
    return {
        "title": found.job.title,
        "machine": found.job.machine.name,
        "fmu": {"file": found.fmu, "sha256": found.digest},
        "versions": dict(versions()),
        "laws": {row.name: row.figures() for row in found.rows},
    }
