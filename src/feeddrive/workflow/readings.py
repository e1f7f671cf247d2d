"""In which units a log was read, and whether a feed drive can do what it then says.

A command stops before it works on a travel of 200 m or a mass of 0.1 kg: the two likeliest readings are shown side by
side, and nothing is written until the unit is told.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from feeddrive.files.columns import ROLES, Column, unit_at_the_end, unit_of
from feeddrive.files.formats import OpenedFile
from feeddrive.files.log import Log
from feeddrive.identification.estimate import SHAFT, TABLE, Frame
from feeddrive.identification.plausibility import RANGES, out_of_range, outside, scaled, sizes, spoken, unlikely
from feeddrive.language import units
from feeddrive.language.errors import LogError, ParameterError
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.frequency_response import FRF

_MOTIONS = (
    "position_load",
    "position_motor",
    "angle_motor",
    "angle_load",
    "velocity_load",
    "velocity_motor",
    "speed_motor",
    "speed_load",
    "setpoint_position",
    "setpoint_angle",
)
_FORCES = ("force", "torque")
# in which units each quantity is logged; the first is SI
_UNITS = {
    "m": ("m", "mm", "um", "in"),
    "m/s": ("m/s", "mm/s", "m/min", "mm/min"),
    "rad": ("rad", "deg", "rev"),
    "rad/s": ("rad/s", "rpm", "deg/s"),
    "N": ("N", "kN", "mN"),
    "N m": ("N m", "mN m", "kN m"),
}
# HAL knows no units: a machine is in mm or inch, by LINEAR_UNITS of its INI file
_OF_HAL = ("mm", "in")
_HAL_FORMATS = ("halscope", "halsampler")
_HAL_PINS = ("joint.", "axis.", "pid.")


FLAGS = {
    "position_load": "--position",
    "position_motor": "--position",
    "angle_motor": "--angle",
    "torque": "--torque",
    "velocity_load": "--velocity",
    "speed_motor": "--speed",
    "force": "--force",
    "setpoint_position": "--set-position",
}


@dataclass(frozen=True)
class Doubt:
    """Why the sizes of a log are none of a feed drive, in a sentence; empty if they are.

    told      its units were told, so that the work goes on; else it must stop
    readings  the two likeliest readings side by side, where another unit makes a feed drive of it
    moves     a mass could be found in it: a log of noise has sizes too
    """

    why: str = ""
    told: bool = True
    readings: Table | None = None
    moves: bool = False

    def stop(self, progress: Progress) -> None:
        """Show the readings and raise LogError, if the units were not told."""
        if self.why and not self.told:
            if self.readings is not None:
                progress.remark(self.readings)
            raise LogError(self.why)


def units_first(doubts: Sequence[str]) -> Advice | None:
    """The judgment on values from logs whose sizes are in doubt; None if none is."""
    return Judgment.UNITS_IN_DOUBT.because(doubts[0]) if doubts else None


@dataclass(frozen=True)
class _Group:
    """The columns of the motion, or of the force: the role that is looked at, its unit as read, how it is known."""

    role: str
    column: str
    unit: str
    how: str  # told, stated or ""

    @property
    def si(self) -> str:
        return ROLES[self.role]

    def said(self) -> str:
        """How the unit came."""
        if self.how == "stated":
            return f"'{self.column}' is in {self.unit}, as the file says"
        return f"'{self.column}' states no unit"


def with_units(file: OpenedFile, mapping: Mapping[str, Column], asked: Sequence[str]) -> dict[str, Column]:
    """The mapping with the units of `--unit` for columns that state none.

    Raises ParameterError for a unit that no such column measures.
    """
    found = dict(mapping)
    for text in asked:
        unit = unit_of(text)
        if unit is None:
            raise ParameterError(f"--unit {text}: is no unit; give one as mm, um, in, N, kN, 'N m' or deg")
        hit = False
        for role, each in mapping.items():
            if each.unit or each.factor is not None or stated(file, each.name, role) or role == "time":
                continue
            try:
                units.factor(unit, ROLES[role])
            except ParameterError:
                continue
            found[role], hit = Column(name=each.name, unit=unit), True
        if not hit:
            raise ParameterError(
                f"{file}: --unit {text}: no column that states no unit is of that kind; a unit for one column is given "
                f"with its name, as --position 'x:{text}'"
            )
    return found


def stated(file: OpenedFile, column: str, role: str) -> str:
    """The unit that the file states for a column, in its head or at the end of its name; empty without one."""
    return file.columns.units.get(column, "") or unit_at_the_end(column, role)


def doubt(
    file: OpenedFile,
    log: Log,
    mapping: Mapping[str, Column],
    told: Collection[str],
    flags: Mapping[str, str] = FLAGS,
    steady: bool = False,
) -> Doubt:
    """Whether the log, as it was read, is one of a feed drive.

    told   roles whose unit or factor was given by the person
    flags  by which option of the command a role is named
    steady the log is no motion with ramps: accelerations and mass in it are not looked at

    """
    groups = [_group(file, mapping, told, roles) for roles in (_MOTIONS, _FORCES)]
    motion, force = groups
    if motion is None and force is None:
        return Doubt()
    frame = SHAFT if motion is not None and motion.si.startswith("rad") else TABLE
    torque = force if force is not None and force.role == "torque" and not force.how else None
    if force is not None and (force.role == "torque") != (frame is SHAFT):
        frame, force = (SHAFT, force) if motion is None else (frame, None)
    found = _sizes(log, frame, motion, force)
    if steady:
        found = {name: size for name, size in found.items() if name in ("travel", "speed", "force", "torque")}
    is_hal = motion is not None and not motion.how and motion.si == "m" and _hal(file, motion.column)
    # beside a motion along the table a torque is asked about too, unless a command may be what acts
    silent = torque is not None and (force is torque or "command" not in mapping)
    wrong = outside(frame, found)
    if not wrong and not is_hal and not silent:
        return Doubt()
    readings = _readings(frame, found, motion, force, is_hal)
    if silent and torque is not None and not wrong and not is_hal:
        return Doubt(_silent_torque(file, torque, log, found), told=False)
    why = out_of_range(wrong, found)
    open_ = [each for each in groups if each is not None and each.how != "told" and each in (motion, force)]
    if not open_:
        return Doubt(Text(f"{file}: as its units were told, {why}"))
    who = " and ".join(each.said() for each in open_)
    if not readings or unlikely(frame, readings[0].sizes)[0] > 0.0:
        return Doubt(
            Text(
                f"{file}: {who}, and {why}; in no usual unit is this a feed drive: check which column is what, and "
                "give each with its unit, as --position 'x:mm' --force 'f:kN'"
            ),
            told=False,
        )
    best = readings[:2]
    asked = "HAL knows no units, and a machine is in mm or inch" if is_hal else Text(f"as read, {why}")
    return Doubt(
        Text(
            f"{file}: {who}: {asked}. Likeliest: {joined(' or ', (each.sentence(frame) for each in best))}. Say which "
            f'with {" or ".join(each.options(flags) for each in best)}, or unit = "..." in a file for --channels; '
            "nothing was written"
        ),
        told=False,
        readings=_table(str(file), frame, best),
        moves=RANGES[frame][4].quantity in found,
    )


@dataclass(frozen=True)
class _Reading:
    """Units of motion and force, what the log is in them, and which of them differ from how it was read."""

    given: tuple[tuple[_Group, str], ...]
    sizes: dict[str, float]

    @property
    def changes(self) -> int:
        """How many units are others than those that were taken."""
        return sum(group.unit != unit for group, unit in self.given)

    @property
    def name(self) -> str:
        """`x in mm, f in N`."""
        return ", ".join(f"{group.column} in {unit}" for group, unit in self.given)

    def options(self, flags: Mapping[str, str]) -> str:
        """What says so on the command line."""
        open_ = [(group, unit) for group, unit in self.given if group.how != "told"]
        kept = [(group, unit) for group, unit in open_ if group.unit != unit] or open_
        words = [
            f"--unit {unit if ' ' not in unit else repr(unit)}"
            if not group.how
            else f"{flags.get(group.role, '--' + group.role)} '{group.column}:{unit}'"
            for group, unit in kept
        ]
        return " ".join(words)

    def sentence(self, frame: Frame) -> str:
        """`x in mm (travel 200 mm, ...)`."""
        sizes = [
            Text(f"{each.quantity} {spoken(self.sizes[each.quantity], each.unit)}")
            for each in RANGES[frame]
            if each.quantity in self.sizes and " over " not in each.quantity
        ]
        return Text(f"{self.name} ({joined(', ', sizes)})")


def _readings(
    frame: Frame, found: Mapping[str, float], motion: _Group | None, force: _Group | None, is_hal: bool
) -> list[_Reading]:
    """What the log is in other units, likeliest first; the fewer units are changed the likelier."""
    there = [each for each in (motion, force) if each is not None]
    choices: list[list[tuple[_Group, str]]] = []
    for each in there:
        if each.how == "told" or each.si not in _UNITS:
            choices.append([(each, each.unit)])
        elif is_hal and each is motion:
            choices.append([(each, unit) for unit in _OF_HAL])
        else:
            choices.append([(each, unit) for unit in dict.fromkeys((each.unit, *_UNITS[each.si]))])
    made: list[_Reading] = []
    for given in product(*choices):
        factors = {
            group.role: units.factor(unit, group.si) / units.factor(group.unit, group.si) for group, unit in given
        }
        by = [1.0 if group is None else factors[group.role] for group in (motion, force)]
        made.append(_Reading(given, scaled(frame, found, by[0], by[1])))

    def order(each: _Reading) -> tuple[float, int, float]:
        decades, unusual = unlikely(frame, each.sizes)
        return decades, each.changes, unusual

    return sorted(made, key=order)


def _sizes(log: Log, frame: Frame, motion: _Group | None, force: _Group | None) -> dict[str, float]:
    acting = None if force is None else log[force.role]
    if motion is not None and motion.si.endswith("/s"):
        speed = {RANGES[frame][1].quantity: float(np.max(np.abs(log[motion.role])))}
        return {**speed, **sizes(frame, log.sample_time, None, acting)}
    return sizes(frame, log.sample_time, None if motion is None else log[motion.role], acting)


def _group(
    file: OpenedFile, mapping: Mapping[str, Column], told: Collection[str], roles: Sequence[str]
) -> _Group | None:
    role = next((each for each in roles if each in mapping), None)
    if role is None:
        return None
    column = mapping[role]
    if role in told:
        return _Group(role, column.name, column.unit or ROLES[role], "told")
    said = stated(file, column.name, role)
    unit = column.unit or unit_of(said) or ROLES[role]
    return _Group(role, column.name, unit if _measures(unit, role) else ROLES[role], "stated" if said else "")


def _measures(unit: str, role: str) -> bool:
    try:
        units.factor(unit, ROLES[role])
    except ParameterError:
        return False
    return True


def _hal(file: OpenedFile, column: str) -> bool:
    return file.columns.format in _HAL_FORMATS or column.startswith(_HAL_PINS)


def _silent_torque(file: OpenedFile, force: _Group, log: Log, found: Mapping[str, float]) -> str:
    most = float(np.max(np.abs(log["torque"])))
    inertia = found.get("inertia")
    as_it_is = f"up to {Quantity(most, 'N m'):3}"
    rated = ""
    if inertia is not None:
        as_it_is += f", inertia {Quantity(inertia, 'kg m2'):3}"
        rated = f", inertia {Quantity(inertia / 100.0, 'kg m2'):3} for each N m of rated torque"
    return Text(
        f"{file}: '{force.column}' states no unit, and drives log a torque in N m or in percent of the rated one. "
        f"Likeliest: {force.column} in N m ({as_it_is}), or in percent (up to {Quantity(0.01 * most, 'share'):3} of "
        f"the rated torque{rated}). Say which with --unit 'N m', or --torque '{force.column}*FACTOR' with the rated "
        "torque in N m / 100 as FACTOR (feeddrive force computes it); nothing was written"
    )


def _table(name: str, frame: Frame, readings: Sequence[_Reading]) -> Table:
    rows = [
        [
            each.quantity,
            each.bounds(),
            *(
                Text(f"{spoken(r.sizes[each.quantity], each.unit)}{' !' if each.apart(r.sizes[each.quantity]) else ''}")
                for r in readings
            ),
        ]
        for each in RANGES[frame]
        if each.quantity in readings[0].sizes
    ]
    heads = ["", "feed drives", *(each.name for each in readings)]
    return Table(f"{name}: the two likeliest readings", heads, rows, sentences=2)


_OUTPUTS = (("m", "mm", "um", "nm"), ("m/s", "mm/s"), ("m/s2", "mm/s2"))  # of a response, by its order


def check_response(
    where: str, frf: FRF, told: bool, progress: Progress, cure: Callable[[str], str] | None = None
) -> str:
    """Raise LogError for a response whose mass is none of a feed drive, unless its unit was told: then a sentence.

    The mass is the median over the lines of |F / (ω² x)|; a response in another kind of unit is not judged.
    cure  what to give on the command line for a unit of the response, as um/N
    """
    mass, unit = RANGES[TABLE][4], frf.unit or "m/N"
    try:
        known = units.response(unit_of(unit) or unit)
    except ParameterError:
        known = None
    of_order = [f"({each[0]})/N" if n else f"{each[0]}/N" for n, each in enumerate(_OUTPUTS)]
    if known is None or known[0] not in of_order:
        return ""
    order, size = of_order.index(known[0]), 1.0 / known[1]
    there = np.abs(frf.response) > 0.0
    if not np.any(there):
        return ""
    w, response = 2.0 * np.pi * frf.frequency[there], np.abs(frf.response[there])
    masses = [w ** (n - 2) / response for n in range(len(_OUTPUTS))]
    found = float(np.median(masses[order])) / size
    if not mass.apart(found):
        return ""
    why = Text(f"read in {unit} its mass is {spoken(found, 'kg')}, where feed drives have {mass.bounds()}")
    if told:
        return Text(f"{where}: {why}, as its unit was told")
    read: list[
        tuple[str, float, float]
    ] = []  # unit, mass, and how it scatters over the lines: least in the right order
    for n in [order] if frf.unit else range(len(_OUTPUTS)):
        scatter = float(np.std(np.log(masses[n])))
        for each in _OUTPUTS[n]:
            in_it = float(np.median(masses[n])) / units.factor(each, _OUTPUTS[n][0])
            read.append((f"({each})/N" if n else f"{each}/N", in_it, scatter))
    read = sorted(read, key=lambda each: (mass.apart(each[1]), each[2], mass.unusual(each[1])))[:2]
    rows = [["mass", mass.bounds(), *(Text(f"{spoken(mass_read, 'kg')}") for _, mass_read, _ in read)]]
    heads = ["", "feed drives", *(each[0] for each in read)]
    progress.remark(Table(f"{where}: the two likeliest readings", heads, rows, sentences=2))
    said = f"is in {unit} by what the file says" if frf.unit else "states no unit"
    cure = cure or (lambda unit: f"{'--unit' if not frf.unit else 'a file that says'} '{unit}'")
    cures = " or ".join(cure(each[0]) for each in read)
    likely = joined(" or ", (f"{unit_read} ({spoken(mass_read, 'kg')})" for unit_read, mass_read, _ in read))
    raise LogError(
        f"{where}: the response to {frf.output} {said}: {why}. Likeliest: {likely}. Say which with {cures}; nothing "
        f"was written"
    )
