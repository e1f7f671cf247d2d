"""A profile to play on a drive: an excitation over a motion from `feeddrive excite`, or the motion of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feeddrive.bus.drive_file import BusDrive
from feeddrive.files.read_log import read_log
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined

_UNITS = {"csp": ("N", "m"), "csv": ("N", "m/s"), "cst": ("N",)}
_NEGLIGIBLE = 0.02  # of the peak, at the ends of a profile
_ABOVE_NYQUIST = 1e-3  # share of the excitation's power that may be lost between the cycles


@dataclass(frozen=True, eq=False)
class Profile:
    """Rows at the cycle time of the bus: excitation in `unit` (N, m or m/s), set position (m,
    relative to its start).

    `velocity` is that of the file, else the central difference of the set position, m/s.
    """

    name: str
    sha256: str
    sample_time: float
    unit: str
    excitation: np.ndarray
    set_position: np.ndarray
    velocity: np.ndarray


def read_profile(path: str | Path, drive: BusDrive, *, share: float = 1.0, ramp: float = 0.0) -> Profile:
    """Read time, excitation, set position and set velocity, as far as present, at the cycle time of the drive.

    share  of the excitation that is played
    ramp   s over which the excitation swells and fades, for a profile that does not do so by itself

    Raises LogError for a file that is not a log, ParameterError for one that does not fit drive, mode or limits.
    """
    log = read_log(path)
    known = {"excitation", "set_position"} & set(log.channels)
    if not known:
        raise ParameterError(
            f"{path}: has neither a column 'excitation' nor 'set_position' but {', '.join(log.channels)}; "
            "feeddrive excite writes one"
        )
    zero = np.zeros(len(log))
    excitation = share * log.channels.get("excitation", zero)
    set_position = log.channels.get("set_position", zero)
    set_position = set_position - set_position[0]
    unit = log.units.get("excitation", "") or "N"
    if unit not in _UNITS[drive.mode]:
        raise ParameterError(
            f"{path}: excitation in '{unit}' cannot be played in mode {drive.mode}, which takes "
            f"{' or '.join(_UNITS[drive.mode])}"
        )
    step, T = log.sample_time, drive.cycle_time
    every = _every(path, step, T, "design it for a machine file with that sample time")
    _check_band(str(path), excitation, every, step)
    excitation, set_position = excitation[::every].copy(), set_position[::every].copy()
    if "set_velocity" in log.channels:
        velocity = log["set_velocity"][::every].copy()
    else:
        velocity = np.gradient(set_position, T) if set_position.size > 1 else np.zeros(set_position.size)
    profile = Profile(
        str(path), str(log.provenance["sha256"]), T, unit, _ramped(excitation, round(ramp / T)), set_position, velocity
    )
    check_profile(profile, drive)
    return profile


def _every(path: str | Path, step: float, T: float, advice: str) -> int:
    """Return the number of rows of a file in a cycle of the bus."""
    every = round(T / step)
    if every < 1 or abs(T / step - every) > 1e-6 * every:
        raise ParameterError(
            f"{path}: has a row every {Quantity(step, 's'):6 us}, of which cycle_time = {Quantity(T, 's'):6 us} of the "
            f"drive file is no whole multiple: {advice}"
        )
    return every


def read_plan_profiles(setpoints: Path, drives: Mapping[str, BusDrive]) -> list[Profile]:
    """Return the motion of each axis of a plan, for the drive of this name, relative to its present position.

    setpoints  setpoints.parquet of `feeddrive plan`

    Raises ParameterError for axes without a drive, drives without an axis, other modes than csp, cycle times that
    differ, and a motion that does not fit the limits of a drive; LogError for what is no plan.
    """
    log = read_log(setpoints)
    axes = [name.removesuffix(".set_position") for name in log.channels if name.endswith(".set_position")]
    if not axes:
        raise ParameterError(f"{setpoints}: has no columns such as x.set_position, as feeddrive plan writes them")
    moving = [axis for axis in axes if np.ptp(log[f"{axis}.set_position"]) > 0.0]
    missing, strange = (
        [axis_name for axis_name in moving if axis_name not in drives],
        [axis_name for axis_name in drives if axis_name not in axes],
    )
    if missing or strange:
        raise ParameterError(
            f"{setpoints}: moves the axes {', '.join(moving) or '(none)'}, and there "
            + (f"is no drive for {', '.join(missing)}" if missing else f"is no axis {', '.join(strange)}")
            + ': give one drive file (--drive) for each axis, with its name as  axis = "x"'
        )
    turning = [axis_name for axis_name in moving if log.units.get(f"{axis_name}.set_position") == "rad"]
    if turning:
        raise ParameterError(
            f"{setpoints}: axis {turning[0]} turns, and drive files scale lengths only: take it out of the program"
        )
    times = {drive.cycle_time for drive in drives.values()}
    modes = {drive.mode for drive in drives.values()}
    if len(times) > 1 or modes != {"csp"}:
        listed = joined(", ", (Text(f"{Quantity(axis_name, 's'):6 us}") for axis_name in sorted(times)))
        raise ParameterError(
            f"the drives of a plan have one cycle_time and the mode csp, not {listed} and {', '.join(sorted(modes))}"
        )
    profiles: list[Profile] = []
    for axis, drive in drives.items():
        every = _every(setpoints, log.sample_time, drive.cycle_time, "plan it with --sample-time")
        rows = np.minimum(np.arange(0, len(log) + every - 1, every), len(log) - 1)  # the end itself, too
        position, velocity = log[f"{axis}.set_position"][rows], log[f"{axis}.set_velocity"][rows]
        rest = np.zeros(len(position))
        sha = str(log.provenance["sha256"])
        profile = Profile(
            f"{setpoints}, axis {axis}", sha, drive.cycle_time, "N", rest, position - position[0], velocity
        )
        check_profile(profile, drive)
        profiles.append(profile)
    return profiles


def _check_band(path: str, excitation: np.ndarray, every: int, step: float) -> None:
    """Refuse frequencies above half the rate of the bus, which would be aliased."""
    if every == 1 or not np.any(excitation):
        return
    power = np.abs(np.fft.rfft(excitation)) ** 2
    above = np.fft.rfftfreq(excitation.size, step) > 0.5 / (every * step)
    lost = float(power[above].sum() / power.sum())
    if lost > _ABOVE_NYQUIST:
        raise ParameterError(
            f"{path}: {Quantity(lost, 'share'):2} of the power of the excitation lie above "
            f"{Quantity(0.5 / (every * step), 'Hz'):6}, half the rate of the bus: end the band below it, or shorten "
            "cycle_time"
        )


def _ramped(excitation: np.ndarray, rows: int) -> np.ndarray:
    if rows < 1:
        return excitation
    swell = 0.5 - 0.5 * np.cos(np.pi * np.arange(rows) / rows)
    window = np.ones(excitation.size)
    rows = min(rows, excitation.size // 2)
    window[:rows] *= swell[:rows]
    window[excitation.size - rows :] *= swell[:rows][::-1]
    return window * excitation


def check_profile(profile: Profile, drive: BusDrive) -> None:
    """Raise ParameterError if the profile begins or ends with a jump, or plans more than the limits allow."""
    limits = drive.limits
    for name, row in (("excitation", profile.excitation), ("speed of the set position", profile.velocity)):
        peak = float(np.max(np.abs(row), initial=0.0))
        ends = max(abs(float(row[0])), abs(float(row[-1]))) if row.size else 0.0
        if peak > 0.0 and ends > _NEGLIGIBLE * peak:
            advice = "give --ramp" if name == "excitation" else "let it start and end at rest"
            raise ParameterError(
                f"{profile.name}: the {name} begins or ends with {Quantity(ends / peak, 'share'):3} of its peak, a "
                f"jump for the axis: {advice}"
            )
    if drive.mode == "cst" and np.any(profile.set_position):
        raise ParameterError(
            f"{profile.name}: holds a motion (set_position), and nothing follows it in mode cst: use csp, or design "
            "the excitation with --offset-velocity 0"
        )
    added = profile.excitation if profile.unit == "m" else 0.0
    planned = [
        ("travel", float(np.max(np.abs(profile.set_position + added), initial=0.0)), limits.travel, "m"),
        ("velocity", float(np.max(np.abs(profile.velocity), initial=0.0)), limits.velocity, "m/s"),
        ("force", float(np.max(np.abs(profile.excitation), initial=0.0)) * (profile.unit == "N"), limits.force, "N"),
    ]
    for key, got, most, unit in planned:
        if got > most:
            raise ParameterError(
                f"{profile.name}: plans {key} = {Quantity(got, unit):SI}, and limits.{key} of the drive file is "
                f"{Quantity(most, unit):SI}: raise the limit if the machine allows it, or design a smaller excitation"
            )
