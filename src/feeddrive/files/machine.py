"""A machine file: axes with their physical models and controls, and the couplings between them.

name = "my mill"
sample_time_ms = 0.25
[axis.x]                      # the physical model: substeps, encoders, friction, forces
[axis.x.plant]
kind = "two_mass"
[axis.x.control]              # the existing control: limit, guard, filters, feedforward
[axis.x.control.law]
kind = "cascade_ppi"
[axis.x.limits]               # limits of planned motions: velocity to snap, travel
velocity = 0.5
[[couplings]]                 # interactions of the axes: structure modes, a cut, a recorded force
kind = "structure_mode"
[[couplings.shapes]]
axis = "x"
[geometry]                    # geometric errors at the tool point: squareness, scales and straightness
squareness_xy_urad = 20
[kinematics]                  # of five axes: joints and offsets between them
kind = "table_table"
[[made_from]]                 # written by a command: name and SHA-256 digest of each file that it was made from
file = "x_axis.csv"
sha256 = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

from feeddrive.blocks.coupling.geometry import Geometry
from feeddrive.blocks.families import Coupling
from feeddrive.files.origins import Origin
from feeddrive.files.section import Section, named, numbers, read_section, text, to_toml
from feeddrive.files.toml_file import Key, TomlEdit, TomlFile, parse_toml, quoted, read_toml, with_values
from feeddrive.language import tree
from feeddrive.language.block import Number, parameter, part
from feeddrive.language.errors import FileError, ParameterError, StructureError, nearest, plain
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.box import AUTO, Box, is_identified
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.path.five_axes import FiveAxes, HeadHead, HeadTable, TableTable
from feeddrive.path.geometry.weights import ROTARY
from feeddrive.path.kinematics import LINEAR, Kinematics
from feeddrive.path.limits import LETTERS, AxisLimits, MachineLimits

BUNDLED = Path(__file__).parent / "bundled"


class AxisSection(Section):
    """An axis: its physical model, its existing control, and the limits of planned motions."""

    physics: Axis = part("the physics, whose keys stand here", inline=True)
    control: Control = part("today's control")
    limits: AxisLimits | None = part("limits of planned motions", default=None)
    standard_errors: Mapping[str, float] | None = numbers(
        "standard errors of values that were identified, in SI, by path",
        default=None,
        example='standard errors by path, such as "plant.mass" = 0.3',
    )

    correlations: Mapping[str, float] | None = numbers(
        "correlations of these standard errors, by both paths with a space between them",
        default=None,
        example='correlations by two paths, such as "plant.mass plant.stiffness" = 0.9',
    )

    @property
    def correlated(self) -> Mapping[frozenset[str], float]:
        """The correlations by both paths."""
        return {frozenset(pair.split()): value for pair, value in (self.correlations or {}).items()}

    def check(self) -> None:
        """Raise ParameterError for an error that is not above 0, for one of no parameter of the axis, for correlations
        that are not between -1 and 1, and for those of values without a standard error.
        """
        there = [name for name, _ in tree.leaves(self.physics)]
        for path, error in (self.standard_errors or {}).items():
            if path not in there:
                raise self.error(
                    f"standard_errors: '{path}' is no parameter of the axis{nearest(path, there)}: write its path, "
                    "such as plant.mass, or leave it out",
                    "standard_errors",
                )
            if not 0.0 < error < math.inf:
                raise self.error(
                    f"standard_errors: that of {path} = {error} must be above 0, in the SI unit of its value: leave it "
                    "out if it is not known",
                    "standard_errors",
                )
        for pair, value in (self.correlations or {}).items():
            paths = pair.split()
            if len(paths) != 2 or paths[0] == paths[1] or not set(paths) <= set(self.standard_errors or {}):
                raise self.error(
                    f"correlations: '{pair}' must be two different paths of standard_errors with a space between them, "
                    'as "plant.mass plant.stiffness": write both paths, or leave it out',
                    "correlations",
                )
            if not -1.0 <= value <= 1.0:
                raise self.error(
                    f"correlations: that of {pair} = {value} must be from -1 to 1: leave it out if it is not known",
                    "correlations",
                )
        if len(self.correlated) < len(self.correlations or {}):
            raise self.error("correlations: a pair is stated twice: leave one of them out", "correlations")


class MachineSection(Section, kind="loop"):  # the `kind` at the top of machine files
    """A machine: axes with their physical models and existing controls."""

    name: str = text("name of the machine", default="")
    source: str = text("where the numbers come from", default="")
    remark: str = text("anything else", default="")
    sample_time: Number = parameter("s", "time from sample to sample", above=0)
    axis: Mapping[str, AxisSection] = named("axes by name: [axis.x]", least=1)
    couplings: tuple[Coupling, ...] = part(
        "interactions of the axes: structure modes that they share, a cut, a recorded force", default=()
    )
    geometry: Geometry | None = part("squareness, scales and straightness of the axes", default=None)
    kinematics: TableTable | HeadHead | HeadTable | None = part(
        "rotary joints of a five-axis machine and the offsets between them", default=None
    )
    made_from: tuple[Origin, ...] = part("files that this file was made from, with their digests", default=())

    def check(self) -> None:
        """Raise ParameterError for a name that is not one line of plain text."""
        if not self.name.isprintable():
            raise self.error("name must be one line of plain text: it is written into files of other programs", "name")


class LimitsOfAxis(Section):
    """An axis in a limits file."""

    limits: AxisLimits = part("limits of planned motions")


class LimitsSection(Section):
    """Limits of the axes that a part program moves."""

    axis: Mapping[str, LimitsOfAxis] = named("axes by name: [axis.x.limits]", least=1)


@dataclass(frozen=True, repr=False)
class MachineFile(Result):
    """The content of a machine file: a loop for each axis, the couplings, and the source of the numbers.

    `loops` are the individual axes, without couplings; `limits` are the limits of planned motions, where stated;
    `errors` are the standard errors of identified values in SI, by axis and path, and `correlations` those of these
    errors, by axis and both paths.
    """

    name: str
    source: str
    remark: str
    loops: Mapping[str, Loop]
    file: TomlFile
    couplings: tuple[Coupling, ...] = ()
    limits: Mapping[str, AxisLimits] = field(default_factory=dict[str, AxisLimits])
    geometry: Geometry | None = None
    made_from: tuple[Origin, ...] = ()
    errors: Mapping[str, Mapping[str, float]] = field(default_factory=dict[str, Mapping[str, float]])
    five_axes: FiveAxes | None = None
    correlations: Mapping[str, Mapping[frozenset[str], float]] = field(
        default_factory=dict[str, Mapping[frozenset[str], float]]
    )

    @property
    def kinematics(self) -> Kinematics | None:
        """The kinematics of a five-axis machine, with the travel of its rotary joints; None if the file has none."""
        if self.five_axes is None:
            return None
        kinematics = self.five_axes.kinematics()
        return kinematics.with_travel(
            {
                name.upper(): (
                    -math.inf if axis.travel_least is None else float(axis.travel_least),
                    math.inf if axis.travel_most is None else float(axis.travel_most),
                )
                for name, axis in self.limits.items()
            }
        )

    @property
    def quoted(self) -> tuple[str, ...]:
        """The user-defined strings in the file."""
        return self.name, self.source, self.remark

    @property
    def instead(self) -> str:
        """A hint for the error that is raised if a machine file is passed in place of a loop."""
        first = next(iter(self.loops))
        return f"a machine file holds a loop for each axis: give .loop('{first}'); fd.compare(file) puts all laws on it"

    def table(self) -> Table:
        """Tabulate the plant and control, one row per axis."""
        rows = [
            [
                name,
                loop.axis.plant.kind,
                getattr(loop.axis.friction_load or loop.axis.friction_motor, "kind", "-"),
                loop.control.law.kind,
                ", ".join(filter_.kind for filter_ in loop.control.filters) or "-",
                None
                if loop.control.force_limit is None
                else Quantity(loop.control.force_limit, "N m" if loop.axis.rotary else "N", form="6"),
                float(loop.sample_time),
            ]
            for name, loop in self.loops.items()
        ]
        between = f"; coupled by {', '.join(coupling.kind for coupling in self.couplings)}" if self.couplings else ""
        heads = ["axis", "plant", "friction", "law", "filters", "force limit", Column("sample", "s", "6 ms")]
        return Table(f"{plain(self.name)}, {self.file.name}{between}", heads, rows)

    def loop(self, axis: str | None) -> Loop:
        """Return the loop of an axis, by default that of the only axis.

        Raises ParameterError for an unknown axis, and for a coupled axis, which would move differently on its own.
        """
        name = self.named(axis)
        if self.coupled(name):
            raise ParameterError(
                f"{self.file.name}: {self.coupled(name)}: alone its motion would differ, and this works on one axis "
                f"alone. Run all axes by a job, export them, or take machine() in Python; for the axis alone take a "
                f"copy of the file without its [[couplings]]"
            )
        return self.loops[name]

    def named(self, axis: str | None) -> str:
        """Return the axis name, by default that of the only axis. Raise ParameterError if unknown or ambiguous."""
        if axis is None and len(self.loops) == 1:
            return next(iter(self.loops))
        if axis is None:
            raise ParameterError(f"{self.file.name}: there are the axes {', '.join(self.loops)}: name one of them")
        if axis not in self.loops:
            raise ParameterError(f"{self.file.name}: axis '{axis}' is not there{nearest(axis, self.loops)}")
        return axis

    def box(self, text: str, axis: str | None) -> Box | None:
        """Return the box that a text describes for an axis; the text may refer to the standard errors in the file.

        `auto` is `identified` if the file has a standard error of a mass or stiffness, and `standard` otherwise.
        Raises ParameterError like `Box.parse` and `Box.with_errors`, and for a box in which nothing of this axis
        spreads, such as `stiffness=0.3` of a rigid one: limits at the model would be called limits over a box.
        """
        box = Box.parse(text)
        if box is None:
            return None
        name = self.named(axis)
        plant, errors = self.loops[name].axis, self.errors.get(name, {})
        if text.strip() == AUTO and is_identified(plant, errors):
            box = Box.parse("identified")
            assert box is not None
        box = box.with_errors(plant, errors, self.file.name, self.correlations.get(name, {}))
        if (box.mass or box.stiffness) and not box.dead_time and not box.dimensions(plant):
            has = ", ".join(dimension.path for dimension in Box().dimensions(plant)) or "nothing"
            raise ParameterError(
                f"box '{text.strip()}': no plant but the model is in it: what may spread of axis '{name}' in "
                f"{self.file.name} is {has}: give it a tolerance, add dead_time=1sample, or take --box none"
            )
        return box

    def coupled(self, axis: str) -> str:
        """Return a clause that names the first coupling of an axis, or an empty string if the axis is not coupled."""
        for i, coupling in enumerate(self.couplings):
            if axis in coupling.axes():
                others = ", ".join(name for name in coupling.axes() if name != axis) or "the structure"
                return f"axis '{axis}' is coupled with {others} by couplings.{i} ({coupling.kind})"
        return ""

    def followers(self) -> dict[str, str]:
        """Return a dict from each follower axis, such as the second drive of a gantry, to its leader."""
        return {name: leader for coupling in self.couplings for name, leader in coupling.follows().items()}

    def machine(self, *couplings: Coupling) -> Machine:
        """Return all axes as one machine, with the couplings of the file and additional ones.

        Raises ParameterError or StructureError, like `Machine`.
        """
        return Machine.of(self.loops, (*self.couplings, *couplings), self.geometry)


MachineLike: TypeAlias = str | Path | MachineFile
"""A machine file, the name of a bundled machine, or a `MachineFile`."""


def read_machine(
    path: MachineLike, *, quoting: bool = True, values: Mapping[Key, Any] = MappingProxyType({})
) -> MachineFile:
    """Read a machine file, given by path or as the name of a bundled one; a MachineFile is returned unchanged.

    values  values by key that replace those of the file

    Raises FileError for an unreadable file, and ParameterError or StructureError for a key in it, with file and line.
    """
    if isinstance(path, MachineFile):
        return path
    if not isinstance(path, str | Path):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ParameterError(
            f"a machine is a file, a bundled name or fd.read_machine(...), not a {type(path).__name__}"
        )
    file = read_toml(find_bundled(path, "machines"), "a machine file", quoting=quoting)
    return _machine(with_values(file, values) if values else file)


def machine_of_text(text: str, name: str) -> MachineFile:
    """Parse the text of a machine file; `name` is the file name in error messages.

    Raises ParameterError or StructureError, like `read_machine`.
    """
    return _machine(parse_toml(text, name))


def _machine(file: TomlFile) -> MachineFile:
    section = read_section(MachineSection, file.root())
    loops = {name: _loop(section, name, axis) for name, axis in section.axis.items()}
    _check_together(section, loops)
    limits = {name: axis.limits for name, axis in section.axis.items() if axis.limits is not None}
    name = section.name or Path(file.name).stem
    return MachineFile(
        name,
        section.source,
        section.remark,
        loops,
        file,
        section.couplings,
        limits,
        section.geometry,
        section.made_from,
        {name: axis.standard_errors for name, axis in section.axis.items() if axis.standard_errors},
        section.kinematics,
        {name: axis.correlated for name, axis in section.axis.items() if axis.correlations},
    )


def with_standard_errors(
    edit: TomlEdit,
    axis: str,
    errors: Mapping[str, float],
    correlations: Mapping[tuple[str, str], float] = MappingProxyType({}),
) -> None:
    """Write the standard errors of identified values of an axis, in SI by path, in place of those in the file.

    correlations  correlations of the errors of masses and stiffnesses, by both paths

    Errors that are 0 or not finite are left out: such a value was not estimated from the data.
    """
    rows = [f"{quoted(path)} = {error:.3g}" for path, error in errors.items() if 0.0 < error < math.inf]
    key = ("axis", axis, "standard_errors")
    if rows:
        head = f"[axis.{axis}.standard_errors]  # SI, by path: the box `identified` is made of them"
        edit.replace(key, "\n".join([head, *rows]))
    else:
        edit.remove(key)
    known = {path for path, error in errors.items() if 0.0 < error < math.inf}
    pairs = [
        f"{quoted(' '.join(pair))} = {value:.4f}" for pair, value in correlations.items() if known.issuperset(pair)
    ]
    key = ("axis", axis, "correlations")
    if pairs:
        edit.replace(key, "\n".join([f"[axis.{axis}.correlations]  # of these errors", *pairs]))
    else:
        edit.remove(key)


def machine_toml(
    machine: Machine,
    name: str,
    source: str = "",
    remark: str = "",
    limits: Mapping[str, AxisLimits] = MappingProxyType({}),
    five_axes: FiveAxes | None = None,
) -> str:
    """Return the text of a machine file, from which `read_machine` reproduces the machine.

    Raises StructureError for a machine whose parameters are arrays of variants.
    """
    texts = [
        f"{key} = {quoted(value)}" for key, value in (("name", name), ("source", source), ("remark", remark)) if value
    ]
    parts = ["\n".join([*texts, f"sample_time = {float(machine.sample_time)!r}"]) + "\n"]
    for axis, loop in machine.axes().items():
        parts += [
            to_toml(loop.axis, f"axis.{axis}"),
            to_toml(loop.control, f"axis.{axis}.control", rotary=loop.axis.rotary),
            *([to_toml(limits[axis], f"axis.{axis}.limits", rotary=loop.axis.rotary)] if axis in limits else []),
        ]
    parts += [to_toml(coupling, "couplings", listed=True) for coupling in machine.couplings]
    more = {"geometry": machine.geometry, "kinematics": five_axes}
    return "\n".join([*parts, *(to_toml(block, key) for key, block in more.items() if block is not None)])


def _loop(machine: MachineSection, name: str, section: AxisSection) -> Loop:
    """Build the loop of an axis from its section."""
    try:
        return Loop(axis=section.physics, control=section.control, sample_time=machine.sample_time, name=name)
    except (ParameterError, StructureError) as error:
        raise machine.error(f"{error}", kind=type(error)) from None


def _check_together(section: MachineSection, loops: Mapping[str, Loop]) -> None:
    """Raise an error, with the line, if a coupling or the geometry is incompatible with the axes."""
    for k in range(len(section.couplings)):
        try:
            # one coupling more each time: the error names the first that does not fit
            Machine.of(loops, section.couplings[: k + 1])
        except (ParameterError, StructureError) as error:
            message, place = Text(f"{error}"), f"couplings.{k}"
            named = message if message.startswith(place) else f"{place}: {message}"
            raise section.error(named, ("couplings", k), type(error)) from None
    if section.kinematics is not None:
        _check_joints(section, loops, section.kinematics)
    if section.geometry is not None:
        try:
            Machine.of(loops, (), section.geometry)
        except (ParameterError, StructureError) as error:
            raise section.error(f"{error}", "geometry", type(error)) from None


def _check_joints(section: MachineSection, loops: Mapping[str, Loop], five_axes: FiveAxes) -> None:
    """Raise an error, with the line, if a joint of the kinematics is no axis of the machine, or one of another type."""
    by_letter = {name.upper(): name for name in loops}
    for letter in five_axes.kinematics().letters:
        name = by_letter.get(letter)
        if name is None:
            raise section.error(
                f"kinematics: the machine has no axis [axis.{letter.lower()}] for its joint {letter}; there are: "
                f"{', '.join(loops)}",
                "kinematics",
            )
        turns = letter not in LINEAR
        if loops[name].axis.rotary != turns:
            raise section.error(
                f"kinematics: joint {letter} is {'rotary' if turns else 'linear'}, and axis.{name} is "
                f"{'linear: write rotary = true there' if turns else 'rotary: leave rotary = true out there'}",
                "kinematics",
            )


def find_bundled(path: str | Path, folder: str, suffix: str = ".toml") -> Path:
    """Return the path if it exists or has a suffix, otherwise the path of the bundled file of that name. Raise
    FileError.

    A directory does not hide the bundled file of its name: `plan dome --out dome` can be repeated.
    """
    file = Path(path)
    # A name with a suffix is meant as a file, so that a typing error is not answered by a bundled machine.
    if file.is_file() or file.suffix:
        return file
    bundled = BUNDLED / folder / f"{file.name}{suffix}"
    if bundled.exists() and (file.parent == Path() or not file.exists()):
        return bundled
    if file.exists():
        return file
    names = sorted(bundled_file.stem for bundled_file in (BUNDLED / folder).glob(f"*{suffix}"))
    raise FileError(f"{file}: there is no such file, and no bundled one of that name{nearest(file.name, names)}")


def planned_limits(machine: MachineFile | None, limits: str | Path | None) -> MachineLimits:
    """Return the limits for planning a part program, by axis letter, taken from a machine, a limits file or both.

    A limits file has sections [axis.x.limits] like a machine file; they replace those of the machine.  Machine axes
    whose name is not an axis letter of part programs (x y z u v w, and a b c for rotary axes) are omitted.  Raises
    FileError or ParameterError.
    """
    stated: dict[str, AxisLimits] = {}
    if limits is not None:
        file = read_toml(limits)
        # a limits file does not state which axes are rotary: their letters do, in upper or lower case
        turning: dict[Key, bool] = {("axis", name.lower()): True for name in ROTARY}
        turning |= {("axis", name): True for name in ROTARY}
        section = read_section(LimitsSection, replace(file.root(), turning=turning))
        for name, axis in section.axis.items():
            if machine is not None and name not in machine.loops:
                raise axis.error(f"axis '{name}' is not in {machine.file.name}{nearest(name, machine.loops)}")
            if len(name) != 1 or name.upper() not in LETTERS:
                raise axis.error(f"axis '{name}' is none that is planned: {', '.join(LETTERS.lower())}")
        stated = {name: axis.limits for name, axis in section.axis.items()}
    if machine is None:
        return _machine_limits({name.upper(): axis_limits for name, axis_limits in stated.items()}, str(limits))
    planned: dict[str, AxisLimits] = {}
    for name, loop in machine.loops.items():
        # In part programs A, B and C are angles and all other letters lengths: other axes cannot be programmed.
        if len(name) != 1 or name.upper() not in LETTERS or loop.axis.rotary != (name.upper() in ROTARY):
            continue
        # The limits file comes first: it exists to override those of the machine.
        own = stated.get(name) or machine.limits.get(name)
        if own is None:
            raise ParameterError(
                f"{machine.file.name}: axis '{name}' has no limits: give it a section [axis.{name}.limits] with "
                "velocity, acceleration, jerk and snap, or a file with such sections (--limits)"
            )
        planned[name.upper()] = own if own.resolution is not None else replace(own, resolution=_resolution(loop))
    if not planned:
        raise ParameterError(
            f"{machine.file.name}: a part program moves axes with the names x y z u v w, and a b c if they turn, and "
            f"there is none; there are: {', '.join(machine.loops)}"
        )
    return _machine_limits(planned, machine.file.name if limits is None else f"{machine.file.name}, {limits}")


def planned_kinematics(machine: MachineFile | None, limits: MachineLimits) -> Kinematics | None:
    """Return the kinematics of a machine with the travel of the planned limits; None for a machine without."""
    kinematics = None if machine is None else machine.kinematics
    if kinematics is None or any(letter not in limits.letters for letter in kinematics.letters):
        return None
    ends = {letter: (-math.inf, math.inf) if ends is None else ends for letter, ends in limits.travel.items()}
    return kinematics.with_travel(ends)


def _machine_limits(axes: Mapping[str, AxisLimits], files: str) -> MachineLimits:
    """Return the limits of axes; raise ParameterError, with the names of their files, if they do not fit the axes."""
    try:
        return MachineLimits(axes)
    except ParameterError as error:
        raise ParameterError(f"{files}: {error}") from None


def _resolution(loop: Loop) -> float | None:
    """Return the position resolution (m) of the load encoder, or if it has none of the motor encoder, or None."""
    # The load encoder first, since it measures the planned position itself.
    for encoder in (loop.axis.encoder_load, loop.axis.encoder_motor):
        resolution = getattr(encoder, "resolution", None)
        if resolution is not None:
            return float(resolution)
    return None
