"""Which channel of a log is probably what, by names and units: shown first, and as a short TOML to correct.

    guess = guess_roles(read_log("run.csv"))
    print(guess)                                  # role, channel, unit, why
    print(guess.toml("run.csv"))                  # [log] and [log.channels] for a job, or for `read_request`
    log = read_log("run.csv", guess.mapping)

A guess is never used without being shown: whoever takes it has read it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from feeddrive.files.measured import Log
from feeddrive.files.roles import OWN_UNIT, ROLES, Column
from feeddrive.files.whole import write_whole
from feeddrive.files.words import Reading, read_name
from feeddrive.language import units
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Result, Table

# what a quantity stands for: as a set value, at the motor, at the load, and if neither is said
_ROLES: Mapping[str, tuple[str, str, str, str]] = {
    "position": ("setpoint_position", "position_motor", "position_load", "position_load"),
    "velocity": ("setpoint_velocity", "velocity_motor", "velocity_load", "velocity_load"),
    "acceleration": ("", "", "acceleration_load", "acceleration_load"),
    "angle": ("setpoint_angle", "angle_motor", "angle_load", "angle_motor"),
    "speed": ("setpoint_speed", "speed_motor", "speed_load", "speed_motor"),
    "force": ("force", "force", "load_force", "force"),
    "torque": ("command", "torque", "torque", "torque"),
    "current": ("command", "current", "current", "current"),
    "command": ("command", "command", "command", "command"),
    "excitation": ("excitation", "excitation", "excitation", "excitation"),
}
# the other encoder, for a second channel of the same kind of which no side is known
_OTHER = {"position_load": "position_motor", "velocity_load": "velocity_motor", "angle_motor": "angle_load",
          "speed_motor": "speed_load"}  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class Guess(Result):
    """Roles of the channels of a log: `mapping` for `read_log`, `reasons` of each, and what stays open.

    `needs` names channels whose role is plain but whose unit needs a factor (percent of a rated torque, counts), with
    what the factor is; `unused` those that were taken for nothing, with why.
    """

    name: str
    mapping: Mapping[str, Column]
    reasons: Mapping[str, str]
    needs: Mapping[str, tuple[str, str]]
    unused: Mapping[str, str]
    sample_time: float | None = None

    def table(self) -> Table:
        """Role, channel, unit and reason; then what needs a factor, then what is unused."""
        rows = [
            [role, column.name, column.unit or ROLES[role] or "own", self.reasons[role]]
            for role, column in self.mapping.items()
        ]
        rows += [[f"{role} ?", column, "", f"needs a factor: {what}"] for role, (column, what) in self.needs.items()]
        rows += [["-", column, "", why] for column, why in self.unused.items()]
        return Table(f"{self.name}: roles guessed by names and units", ["role", "channel", "unit", "why"], rows)

    def toml(self, file: str | Path = "") -> str:
        """The sections [log] and [log.channels], as a job has them; what needs a factor stands in comments."""
        lines = ["[log]", f"file = {_quoted(str(file) or self.name)}"]
        if self.sample_time is not None:
            lines.append(f"sample_time = {self.sample_time!r}")
        lines += ["", "[log.channels]"]
        for role, column in self.mapping.items():
            unit = f", unit = {_quoted(column.unit)}" if column.unit else ""
            lines.append(f"{role} = {{ column = {_quoted(column.name)}{unit} }}")
        for role, (column, what) in self.needs.items():
            lines.append(f"# {role} = {{ column = {_quoted(column)}, factor = 1.0 }}  # {what}")
        return "\n".join(lines) + "\n"

    def plot(self) -> Any:
        """A guess has no picture: plot the log itself."""
        raise ParameterError(f"{self.name}: a guess of roles has no picture; plot the log itself")


def guess_roles(log: Log, axis: str | None = None) -> Guess:
    """The probable roles of the channels of a log that was read without a mapping.

    axis  which one, of a log with several: `x`, or the number of a joint; default: the first that is there

    Raises ParameterError for an axis that no channel names.
    """
    read = {name: read_name(name, log.units.get(name, "")) for name in log.channels}
    axes = list(dict.fromkeys(each.axis for each in read.values() if each.role_like and each.axis))
    if axis is not None and axis not in axes:
        raise ParameterError(f"{log.name}: no channel names the axis '{axis}'; there are: {', '.join(axes) or 'none'}")
    wanted = axis if axis is not None else axes[0] if axes else ""
    mapping: dict[str, Column] = {}
    reasons: dict[str, str] = {}
    needs: dict[str, tuple[str, str]] = {}
    unused: dict[str, str] = {}
    # exact names first, then those that say what they are, and last those that only might be
    for name, each in sorted(read.items(), key=lambda item: (not item[1].exact, item[1].is_weak, not item[1].side)):
        role = each.exact or _role(each)
        if not role:
            unused[name] = each.why or "like nothing that is known"
        elif each.axis not in ("", wanted):
            unused[name] = f"of axis {each.axis}, not {wanted}"
        elif role in mapping or role in needs:
            other = _OTHER.get(role, "")
            if each.side or not other or other in mapping:
                taken = mapping[role].name if role in mapping else needs[role][0]
                unused[name] = f"like {role}, which is '{taken}'"
            else:
                _second(name, each, role, other, mapping, reasons)
        else:
            _take(name, each, role, mapping, reasons, needs)
    order = [role for role in ROLES if role in mapping]
    return Guess(
        log.name,
        {role: mapping[role] for role in order},
        {role: reasons[role] for role in order},
        needs,
        unused,
        log.sample_time if log.provenance.get("clock") == "given" else None,
    )


def _role(each: Reading) -> str:
    """The role of a quantity, set or measured, at the motor, at the load or anywhere."""
    if each.quantity not in _ROLES:
        return ""
    place = 0 if each.is_set else {"motor": 1, "load": 2}.get(each.side, 3)
    return _ROLES[each.quantity][place]


def _take(
    name: str,
    each: Reading,
    role: str,
    mapping: dict[str, Column],
    reasons: dict[str, str],
    needs: dict[str, tuple[str, str]],
) -> None:
    """Give a channel its role, or say which factor it needs for that."""
    if role in OWN_UNIT:
        mapping[role] = Column(name=name, unit=each.unit if _known(each.unit) else "")
    elif not each.unit:
        mapping[role] = Column(name=name)
    elif _fits(each.unit, role):
        mapping[role] = Column(name=name, unit=each.unit)
    else:
        rated = ": the rated value / 100" if each.unit == "percent" else ""
        needs[role] = (name, f"{ROLES[role]} per {each.unit}{rated}")
        return
    said = "" if each.unit or role in OWN_UNIT else f"; no unit is stated, {ROLES[role]} is taken"
    reasons[role] = each.why + said


def _second(
    name: str, each: Reading, role: str, other: str, mapping: dict[str, Column], reasons: dict[str, str]
) -> None:
    """Two channels of one kind: the first in the file is taken for the motor's, the second for the load's."""
    motor, load = (other, role) if role.endswith("_load") else (role, other)
    first = mapping.pop(role)
    reasons.pop(role)
    mapping[motor] = first
    mapping[load] = Column(name=name, unit=each.unit)
    reasons[motor] = "the first of two of its kind"
    reasons[load] = "the second of two of its kind"


def _known(unit: str) -> bool:
    try:
        units.measure(unit)
    except ParameterError:
        return False
    return bool(unit)


def _fits(unit: str, role: str) -> bool:
    try:
        units.factor(unit, ROLES[role])
    except ParameterError:
        return False
    return True


def _quoted(text: str) -> str:
    """A basic string of TOML: JSON's escapes are TOML's."""
    return json.dumps(text, ensure_ascii=False)


def write_roles(path: str | Path, guess: Guess, file: str | Path = "") -> None:
    """Write the guess as TOML, to correct by hand. Raises FileError if it cannot be written."""
    write_whole(path, guess.toml(file))
