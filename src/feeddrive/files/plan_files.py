"""The files of a plan:

setpoints.parquet   time, set_position .. set_snap of each axis (x.set_position ...), line of the program; SI
streamer.txt        positions in mm, A B C in degrees, one line per sample: input of LinuxCNC's `halstreamer`
streamer.hal        HAL commands that load it
plan.json           cycle time, limits and their utilization, stops, where and why the feed fell, proof
stops.parquet       all stops, if there are more than 1,000
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Generator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.files.columns import arrow_column
from feeddrive.files.run_files import parquet_stream, run_stream
from feeddrive.path.geometry.weights import ROTARY
from feeddrive.path.limits import DERIVATIVES, MachineLimits
from feeddrive.path.planned import FEW, Planned
from feeddrive.path.proof import WIDENED
from feeddrive.path.setpoints import REASONS, Samples, Standstill
from feeddrive.version import __version__

SETPOINTS, STREAMER, HAL, PLAN, STOPS = (
    "setpoints.parquet",
    "streamer.txt",
    "streamer.hal",
    "plan.json",
    "stops.parquet",
)
_ROWS = 32768  # of a row group
_SIGNALS = ("set_position", "set_velocity", "set_acceleration", "set_jerk", "set_snap")
_PER = ("", "/s", "/s2", "/s3", "/s4")


class SetpointWriter:
    """A writer that buffers setpoints and stops and writes them to files, in constant memory."""

    def __init__(
        self,
        limits: MachineLimits,
        sample_time: float,
        parquet: Callable[[np.ndarray, Mapping[str, np.ndarray]], None],
        stops: Callable[[Mapping[str, np.ndarray]], None],
        stream: Callable[[np.ndarray], None],
    ) -> None:
        self._letters, self._sample_time = limits.letters, sample_time
        self._shown = np.array([factor for factor, _ in limits.shown])
        self._parquet, self._stops, self._stream = parquet, stops, stream
        self._held: list[Samples] = []
        self._stood: list[Standstill] = []
        self._rows = 0

    def add(self, samples: Samples) -> None:
        """Add the next samples."""
        self._held.append(samples)
        self._rows += len(samples.values)
        if self._rows >= _ROWS:
            self.flush()

    def stops(self, stops: Sequence[Standstill]) -> None:
        """Add the next stops."""
        self._stood += stops
        if len(self._stood) >= _ROWS:
            self.flush()

    def flush(self) -> None:
        """Write the buffered samples and stops."""
        if self._rows:
            self._write_samples()
        if self._stood:
            self._write_stops()

    def _write_samples(self) -> None:
        values = np.concatenate([samples.values for samples in self._held])
        line = np.concatenate([samples.line for samples in self._held]).astype(float)
        first = self._held[0].first
        # Released before writing: the copy above holds all values.
        self._held, self._rows = [], 0
        columns = {
            f"{letter.lower()}.{name}": values[:, i, k]
            for i, letter in enumerate(self._letters)
            for k, name in enumerate(_SIGNALS)
        }
        self._parquet((first + np.arange(len(values))) * self._sample_time, {**columns, "line": line})
        self._stream(self._shown * values[:, :, 0])

    def _write_stops(self) -> None:
        stops, self._stood = self._stood, []
        columns: dict[str, np.ndarray] = {
            "time": np.array([stop.time for stop in stops]),
            "duration": np.array([stop.duration for stop in stops]),
            "line": np.array([stop.line for stop in stops], float),
            "reason": np.array([REASONS.index(stop.reason) for stop in stops], float),
            "angle": np.array([stop.angle for stop in stops]),
        }
        places = np.array([stop.position for stop in stops])
        columns |= {f"{letter.lower()}.position": places[:, i] for i, letter in enumerate(self._letters)}
        self._stops(columns)


@contextlib.contextmanager
def setpoint_files(folder: Path, limits: MachineLimits, sample_time: float, program: str) -> Generator[SetpointWriter]:
    """Yield a writer of setpoint and stop files in a folder; the files appear at the end, or not at all."""
    letters = [letter.lower() for letter in limits.letters]
    base = {letter.lower(): "rad" if letter in ROTARY else "m" for letter in limits.letters}
    units = {
        f"{letter}.{name}": base[letter] + per for letter in letters for name, per in zip(_SIGNALS, _PER, strict=True)
    }
    about = {"program": program, "written_by": f"feeddrive {__version__}"}
    names = ["time", "duration", "line", "reason", "angle", *(f"{letter}.position" for letter in letters)]
    stood = {"time": "s", "duration": "s", "angle": "rad", **{f"{letter}.position": base[letter] for letter in letters}}
    told = {"units": stood, "reasons": list(REASONS), **about}
    with (
        run_stream(folder / SETPOINTS, {**units, "line": ""}, sample_time, about) as parquet,
        parquet_stream(folder / STOPS, names, told) as stops,
        (folder / STREAMER).open("wb") as text,
    ):
        writer = SetpointWriter(limits, sample_time, parquet, stops, lambda rows: _lines(text, rows))
        yield writer
        writer.flush()
    # Last, since only a complete streamer.txt may be loaded by it.
    (folder / HAL).write_text(_hal(letters, sample_time, program), encoding="utf-8")


def _lines(file: Any, rows: np.ndarray) -> None:
    """Write rows of numbers separated by spaces, with the fewest digits that reproduce each number exactly."""
    import pyarrow as arrow
    from pyarrow import csv

    table = arrow.Table.from_arrays(list(map(arrow_column, rows.T)), names=list(map(str, range(rows.shape[1]))))
    csv.write_csv(table, file, csv.WriteOptions(include_header=False, delimiter=" "))


def _hal(letters: Sequence[str], sample_time: float, program: str) -> str:
    """Return the HAL commands by which LinuxCNC loads the setpoints."""
    pins = [f"# net {letter}-set streamer.0.pin.{i} => pid.{letter}.command" for i, letter in enumerate(letters)]
    lines = [
        f"# Setpoints of {program}: positions of {', '.join(letters)} in mm, a line every {1e3 * sample_time:.12g} ms.",
        f"# To be read when the thread servo-thread is there; its period must be {1e9 * sample_time:.12g} ns.",
        f"loadrt streamer depth=16000 cfg={'f' * len(letters)}",
        "setp streamer.0.enable 0",
        "addf streamer.0 servo-thread",
        f"loadusr halstreamer {STREAMER}",
        "# Connect the pins, then start with  setp streamer.0.enable 1",
        *pins,
    ]
    return "\n".join(lines) + "\n"


def plan_record(plan: Planned) -> dict[str, Any]:
    """Return the content of `plan.json`, in SI units."""
    proof = plan.proof
    uses = {
        letter: {
            # null for no limit: JSON has no infinity
            name: {"limit": float(limit), "largest_use": float(use)}
            if isfinite(limit)
            else {"limit": None, "largest_use": None}
            for name, limit, use in zip(DERIVATIVES, limits, shares, strict=True)
        }
        for letter, limits, shares in zip(plan.limits.letters, plan.limits.array, proof.use, strict=True)
    }
    tolerances = zip(plan.limits.letters, plan.limits.angle_tolerances, strict=True)
    angles = {letter: float(tolerance) for letter, tolerance in tolerances if letter in ROTARY}
    return {
        "program": plan.program,
        "machine": plan.machine,
        "written_by": f"feeddrive {__version__}",
        "cycle_time_s": plan.cycle_time,
        "blocks": plan.blocks,
        "runs": plan.runs,
        "sample_time_s": plan.sample_time,
        "samples": plan.samples,
        "violations": plan.violations,
        "proof": {
            "widened": WIDENED,
            "spans": proof.spans,
            "largest_jump_at_a_joint": proof.jump,
            "farthest_apart_at_a_joint_m": proof.apart,
            "faults": [plan.limits.named(str(fault)) for fault in proof.faults],
        },
        "for": {
            "purpose": plan.settings.purpose or None,
            "tolerance_m": plan.settings.tolerance,
            **{f"{name}_share": share for name, share in plan.settings.dynamics._asdict().items()},
            "replaced_by_options": list(plan.settings.options),
        },
        "limits": uses,
        **_tip(plan),
        **({"angle_tolerance_rad": angles} if angles else {}),
        "seconds_by_cause": dict(plan.seconds),
        "feed": _feed(plan),
        "stop_count": plan.stop_count,
        "stops_by_reason": dict(plan.stop_reasons),
        "stops_file": STOPS if plan.stop_count > FEW else None,
        "stops": [_stop(plan.limits.letters, stop) for stop in plan.stops],
    }


def _feed(plan: Planned) -> dict[str, Any]:
    """Return what a plan loses against its feed, by cause, and its falls."""
    loss = plan.loss
    causes = [
        {
            "cause": row.cause,
            "limit": row.limit or None,
            "falls": row.falls,
            "lost_s": row.lost,
            "length_m": row.length,
        }
        for row in loss.causes
    ]
    falls = [
        {
            "time_s": fall.time,
            "duration_s": fall.duration,
            "lines": [fall.first, fall.last],
            "length_m": fall.length,
            "lost_s": fall.lost,
            "slowest_m_per_s": fall.slowest,
            "feed_m_per_s": fall.feed,
            "cause": fall.cause,
            "limit": fall.limit or None,
        }
        for fall in loss.falls
    ]
    return {
        "time_at_feed_s": plan.cycle_time - loss.lost,
        "lost_s": loss.lost,
        "by_cause": causes,
        "fall_count": loss.fall_count,
        "falls": falls,
    }


def _tip(plan: Planned) -> dict[str, Any]:
    """Return what is proven of the tip of the tool; empty if the program never moves it."""
    tip = plan.tip
    if tip is None:
        return {}
    return {
        "tip_deviation_m": tip.deviation,
        "tip_angle_rad": tip.angle,
        "tip_proof": {"pieces": tip.pieces, "faults": tip.faults, "deviation_of_joint_polynomials_m": tip.mapped},
    }


def _stop(letters: str, stop: Standstill) -> dict[str, Any]:
    place = {letter: float(x) for letter, x in zip(letters, stop.position, strict=True)}
    turned = {letter: place.pop(letter) for letter in letters if letter in ROTARY}
    return {
        "time_s": stop.time,
        "duration_s": stop.duration,
        "line": stop.line,
        "reason": str(stop),
        "position_m": place,
        **({"position_rad": turned} if turned else {}),
    }


def write_plan(folder: Path, plan: Planned) -> None:
    """Write `plan.json`, and remove the setpoint files if the plan is not proven."""
    proven = plan.violations == 0
    # An unproven motion must not be loaded into a controller.
    for name in () if proven else (SETPOINTS, STREAMER, HAL, STOPS):
        (folder / name).unlink(missing_ok=True)
    if plan.stop_count <= FEW:
        (folder / STOPS).unlink(missing_ok=True)
    (folder / PLAN).write_text(json.dumps(plan_record(plan), indent=1) + "\n", encoding="utf-8")
