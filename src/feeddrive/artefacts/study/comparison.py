"""A job, run: every law over the same work, with its margins and its stiffness."""

from __future__ import annotations

import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.artefacts.files.job import Job
from feeddrive.artefacts.files.log import read_log
from feeddrive.artefacts.files.measured import Log
from feeddrive.blocks.families import Reference
from feeddrive.engineer.analysis.margins import Margins, margins
from feeddrive.engineer.analysis.stability import require_stable
from feeddrive.engineer.analysis.stiffness import Stiffness, stiffness
from feeddrive.engineer.replay import Replay, replay
from feeddrive.language import tree
from feeddrive.language.errors import LogError
from feeddrive.language.table import Result, Table
from feeddrive.loop.linearize import compliance, loop_gain
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate

LINES = 1500  # of the frequency responses, from 1 Hz to Nyquist


@dataclass(frozen=True)
class Row:
    """One law of the comparison. `replay` is there when the work is a measured log."""

    name: str
    loop: Loop
    run: Run
    replay: Replay | None
    margins: Margins
    stiffness: Stiffness


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Result):
    """All rows of a job, today's control first, and what must be said about them.

    `velocity` in m/s is the speed at which margins and stiffness are taken: the axis slides.
    """

    job: Job
    rows: tuple[Row, ...]
    log: Log | None
    velocity: float
    remarks: tuple[str, ...]
    versions: Mapping[str, str]

    def table(self) -> Table:
        """Errors, force, margins and stiffness by law."""
        heads = [
            "law",
            "error RMS um",
            "peak um",
            "force RMS N",
            "peak N",
            "crossover Hz",
            "PM deg",
            "Ms",
            "stiffness N/um",
        ]
        lines = []
        for row in self.rows:
            error, force = row.run["following_error"], row.run["force"]
            found = row.margins
            lines.append(
                [
                    row.name,
                    f"{1e6 * _rms(error):.4g}",
                    f"{1e6 * np.max(np.abs(error)):.4g}",
                    f"{_rms(force):.4g}",
                    f"{np.max(np.abs(force)):.4g}",
                    _or_dash(found.crossover, ".1f"),
                    _or_dash(found.phase_margin_deg, ".1f"),
                    f"{found.sensitivity_peak:.2f}",
                    f"{1e-6 * row.stiffness.minimum:.3g}",
                ]
            )
            if row.replay is not None:
                off, part = row.replay.rms("position_load"), row.replay.residual("position_load")
                lines.append(
                    ["  predicted - measured", f"{1e6 * off:.4g}", f"{1e6 * np.max(np.abs(part)):.4g}", *["-"] * 6]
                )
        return Table(self.job.title, heads, lines)

    def plot(self) -> Any:
        """Following error and force of all laws, as a matplotlib figure."""
        from feeddrive.artefacts import plot

        return plot.comparison(self)

    def to_pandas(self) -> Any:
        """A DataFrame with one row a law."""
        from feeddrive.artefacts.plot import frames

        names = np.array([row.name for row in self.rows])
        figures = [numbers(row) for row in self.rows]
        return frames.frame(names, {key: np.array([each[key] for each in figures], float) for key in figures[0]}, "law")


def numbers(row: Row) -> dict[str, float | None]:
    """The figures of a row by name, in SI, for a file."""
    error, force = row.run["following_error"], row.run["force"]
    found: dict[str, float | None] = {
        "following_error_rms_m": _rms(error),
        "following_error_peak_m": float(np.max(np.abs(error))),
        "tracking_error_rms_m": _rms(row.run["tracking_error"]),
        "force_rms_N": _rms(force),
        "force_peak_N": float(np.max(np.abs(force))),
        **row.margins.numbers(),
        "sensitivity_peak": row.margins.sensitivity_peak,
        "stiffness_least_N_per_m": row.stiffness.minimum,
        "stiffness_least_frequency_Hz": row.stiffness.minimum_frequency,
    }
    if row.replay is not None:
        found["position_residual_rms_m"] = row.replay.rms("position_load")
        found["position_residual_peak_m"] = float(np.max(np.abs(row.replay.residual("position_load"))))
        if "force" in row.replay.measured:
            found["force_residual_share"] = row.replay.share("force")
    return found


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values * values)))


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def compare(job: Job, step: Callable[[str], None] | None = None) -> Comparison:
    """Run all laws of a job. `step(text)` is called before each piece of work.

    Raises UnstableError for a law whose loop is not stable, DivergedError for one whose run leaves its bounds, and
    LogError for a log that does not fit the job.
    """
    log = _log(job)
    measured = None if log is None else _measured(job, log)
    velocity = _velocity(job.reference, measured, next(iter(job.loops.values())).sample_time)
    rows = []
    for name, loop in job.loops.items():
        if step is not None:
            step(name)
        require_stable(loop, velocity=velocity, where=f"{job.file.name}: law '{name}'")
        again = (
            None if measured is None else replay(loop, measured, skip=job.log.skip_samples if job.log else 0, name=name)
        )
        run = again.run if again is not None else _simulated(job, loop, name)
        nyquist = 0.5 / loop.sample_time
        frequency = np.geomspace(min(1.0, 0.01 * nyquist), nyquist, LINES)
        found = margins(loop_gain(loop, frequency, velocity=velocity))
        rows.append(Row(name, loop, run, again, found, stiffness(compliance(loop, frequency, velocity=velocity))))
    return Comparison(job, tuple(rows), log, velocity, tuple(_remarks(job, rows, velocity)), versions())


def _simulated(job: Job, loop: Loop, name: str) -> Run:
    assert job.reference is not None
    return simulate(loop, job.reference, load=job.load, duration=job.duration, seed=job.seed, name=name)


def _log(job: Job) -> Log | None:
    """The job's log, with those optional channels that it really has."""
    if job.log is None:
        return None
    asked = dict(job.log.channels)
    if job.log.optional:
        whole = read_log(job.log.path)
        names = {*whole.channels, *whole.left_out}
        asked |= {role: column for role, column in job.log.optional.items() if column.name in names}
    return read_log(job.log.path, asked)


def _measured(job: Job, log: Log) -> dict[str, np.ndarray]:
    """The log's channels under the names of the loop's signals, in SI."""
    loop = next(iter(job.loops.values()))
    channels = log.channels
    for role in ("setpoint_position", "position_load"):
        if role not in channels:
            raise LogError(f"{log.name}: the job needs the channel {role}: name its column under [log.channels]")
    if abs(log.sample_time / loop.sample_time - 1.0) > 1e-4:
        raise LogError(
            f"{log.name}: one sample takes {log.sample_time:g} s, but the machine's control runs every "
            f"{loop.sample_time:g} s: resample the log, or set sample_time in {job.machine.file.name}"
        )
    found = {"set_position": channels["setpoint_position"], "position_load": channels["position_load"]}
    if "force" in channels:
        found["force"] = channels["force"]
    elif "command" in channels:
        motor = loop.axis.actuator.motor
        if motor is None:
            raise LogError(
                f"{log.name}: the channel command needs axis.*.actuator.motor in {job.machine.file.name}, "
                f"which turns the drive's unit into N"
            )
        found["force"] = motor.force_per_unit() * channels["command"]
    if "load_force" in channels:
        found["load_force"] = channels["load_force"]
    return found


def _velocity(reference: Reference | None, measured: Mapping[str, np.ndarray] | None, T: float) -> float:
    """Half of the largest set speed, in m/s; 10 mm/s for a reference that stands still."""
    if measured is not None:
        largest = float(np.max(np.abs(np.diff(measured["set_position"])), initial=0.0)) / T
    else:
        assert reference is not None
        largest = float(np.max(np.abs(reference.at(np.linspace(0.0, reference.duration, 2001)).velocity)))
    return 0.5 * largest if largest > 0.0 else 0.01


def _remarks(job: Job, rows: list[Row], velocity: float) -> list[str]:
    """What a reader must know, and where a new law loses against today's."""
    remarks = [job.rule] if job.rule else []
    remarks.append(
        f"Margins and stiffness: exact linear model of the sampled loop, sliding at {1e3 * velocity:.4g} mm/s."
    )
    today = numbers(rows[0])
    for row in rows[1:]:
        now = numbers(row)
        worse = [
            f"{text} {_ratio(now[key], today[key])}"
            for key, text in (
                ("following_error_rms_m", "RMS error"),
                ("following_error_peak_m", "peak error"),
                ("force_peak_N", "peak force"),
                ("sensitivity_peak", "Ms"),
            )
            if _above(now[key], today[key])
        ]
        if _above(today["stiffness_least_N_per_m"], now["stiffness_least_N_per_m"]):
            worse.append(f"least stiffness {_ratio(now['stiffness_least_N_per_m'], today['stiffness_least_N_per_m'])}")
        if worse:
            remarks.append(f"'{row.name}' is worse than today in: {', '.join(worse)}.")
    return remarks


def _above(a: float | None, b: float | None) -> bool:
    return a is not None and b is not None and a > 1.01 * b


def _ratio(a: float | None, b: float | None) -> str:
    return f"x {a / b:.2f}" if a is not None and b else ""


def versions() -> dict[str, str]:
    """What is needed to repeat a run: of feeddrive, Python and the libraries that compute."""
    import llvmlite
    import scipy

    import feeddrive

    return {
        "feeddrive": feeddrive.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "llvmlite": llvmlite.__version__,
    }


def gains(loop: Loop) -> str:
    """The control of a loop in one line of names and values."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in tree.leaves(loop.control))
