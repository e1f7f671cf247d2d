"""The gains of an ODrive from the JSON file that `odrivetool backup-config` writes, as a P-PI cascade.

The file contains the properties of the drive by name, as nested objects or with dotted names such as
axis0.controller.config.pos_gain.  Source of the format: odriverobotics/ODrive, tools/odrive/configuration.py
(`backup_config`).  Source of the units: Firmware/MotorControl/controller.hpp, comments on the fields, since firmware
0.5.
"""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.files.atomic_io import read_whole
from feeddrive.language.errors import FileError
from feeddrive.language.text import Text

_MOST_BYTES = 1_000_000  # such a file has some 20 kB
_POSITION = 3  # control_mode: the position loop runs
_SHAPED = (3, 5)  # input_mode: a filter or a trapezoid of the drive's own, which feeds the velocity forward


def read_odrive(path: str | Path, axis: str = "axis0", lever: float | None = None) -> tuple[CascadePPI, list[str]]:
    """Return the control law of one axis of an ODrive, and remarks on settings that it does not include.

        Kv = pos_gain,   Kp = vel_gain / 2π r²,   Tn = vel_gain / vel_integrator_gain

    pos_gain is in (turn/s)/turn, vel_gain in N m/(turn/s), vel_integrator_gain in N m/(turn/s)/s, all at the motor.

    lever   travel r of the table per radian of the motor, m; None for a rotary axis, for which r = 1

    Raises FileError for a file of another kind, for firmware before 0.5, whose gains are in counts and A, and for an
    axis that is not in position control.
    """
    try:
        content = json.loads(read_whole(path, _MOST_BYTES))
    except (ValueError, UnicodeDecodeError) as error:
        raise FileError(f"{path}: is no JSON file of an ODrive: {error}") from None
    values = dict(_flat(content, ""))
    axes = sorted({name.partition(".")[0] for name in values if ".controller.config." in name})
    if axis not in axes:
        there = f"has gains of {', '.join(axes)}" if axes else "has no axis0.controller.config"
        raise FileError(f"{path}: {there}: name a file of `odrivetool backup-config`, and an axis as FILE:axis1")
    if not any(name.startswith(f"{axis}.") and name.endswith("torque_constant") for name in values):
        raise FileError(
            f"{path}: {axis} has no torque_constant: its firmware is older than 0.5, and its gains are in counts and "
            "A; give them in SI, as --law cascade_ppi:Kv=20,Kp=150,Tn=0.01"
        )
    place = f"{axis}.controller.config"
    mode = values.get(f"{place}.control_mode", _POSITION)
    if mode != _POSITION:
        raise FileError(f"{path}: {place}.control_mode is {mode}: its position loop, {_POSITION}, does not run")
    position, velocity = (_gain(path, values, f"{place}.{name}") for name in ("pos_gain", "vel_gain"))
    integral = _gain(path, values, f"{place}.vel_integrator_gain", least=0.0)
    r = 1.0 if lever is None else lever
    shaped = values.get(f"{place}.input_mode") in _SHAPED
    law = CascadePPI(
        Kv=position,
        Kp=velocity / (2.0 * math.pi * r * r),
        Tn=None if integral == 0.0 else velocity / integral,
        velocity_feedforward=1.0 if shaped else 0.0,
    )
    remarks: list[str] = [
        Text(f"the law is that of {Path(path).name}, {axis}; its encoder filter and torque limit are not part of it")
    ]
    if not shaped:
        remarks.append(
            "the set velocity is taken as not fed forward: with input_vel from a sender, give the law by its numbers, "
            "with velocity_feedforward=1"
        )
    return law, remarks


def _gain(path: str | Path, values: dict[str, Any], name: str, least: float | None = None) -> float:
    """Return a gain; raise FileError unless it is a number above 0, or at least `least`."""
    value = values.get(name)
    fits = (
        isinstance(value, int | float) and math.isfinite(value) and (value > 0.0 if least is None else value >= least)
    )
    if not fits:
        raise FileError(f"{path}: {name} is {value!r}, not a number {'> 0' if least is None else f'>= {least:g}'}")
    return float(value)  # type: ignore[arg-type]


def _flat(content: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield all values in a JSON object with their dotted names."""
    if isinstance(content, dict):
        for key, value in content.items():  # pyright: ignore[reportUnknownVariableType]
            yield from _flat(value, f"{name}.{key}" if name else str(key))  # pyright: ignore[reportUnknownArgumentType]
    else:
        yield name, content
