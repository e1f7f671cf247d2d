"""A machine file: axes with their physics, the control that runs on them, and what couples them.

name = "my mill"
sample_time_ms = 0.25
[axis.x]                      # the physics; substeps, encoders, friction, forces
[axis.x.plant]
kind = "two_mass"
[axis.x.control] # today's control: limit, guard, filters, feedforward
[axis.x.control.law]
kind = "cascade_ppi"
[axis.x.limits] # what a planned motion keeps: velocity to snap, travel
velocity = 0.5
[[couplings]] # interactions of the axes: structure modes, a cut, a recorded force
kind = "structure_mode"
[[couplings.shapes]]
axis = "x"
[geometry] # squareness, scales and straightness: where the tool point is
squareness_xy_urad = 20
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

from feeddrive.blocks.coupling.geometry import Geometry
from feeddrive.blocks.machine_families import Coupling
from feeddrive.files.blocks_from_toml import read_block
from feeddrive.files.blocks_to_toml import to_toml
from feeddrive.files.toml_file import Key, Section, TomlFile, read_toml
from feeddrive.files.toml_values import quoted, with_values
from feeddrive.language.errors import FileError, ParameterError, StructureError, nearest, plain
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.path.limits import LETTERS, ROTARY, AxisLimits, MachineLimits

BUNDLED = Path(__file__).parent / "bundled"
_TEXTS = ("name", "source", "remark")


@dataclass(frozen=True, repr=False)
class MachineFile(Result):
    """The content of a machine file: a loop for each axis, the couplings, and the source of the numbers.

    `loops` are the axes alone, without couplings; `limits` are those of planned motions, of the axes that have some.
    """

    name: str
    source: str
    remark: str
    loops: Mapping[str, Loop]
    file: TomlFile
    couplings: tuple[Coupling, ...] = ()
    limits: Mapping[str, AxisLimits] = field(default_factory=dict[str, AxisLimits])
    geometry: Geometry | None = None

    @property
    def quoted(self) -> tuple[str, ...]:
        """What a person wrote in it, in sentences."""
        return self.name, self.source, self.remark

    @property
    def instead(self) -> str:
        """The hint for a call that needs a loop."""
        first = next(iter(self.loops))
        return f"a machine file holds a loop for each axis: give .loop('{first}'); fd.compare(file) puts all laws on it"

    def table(self) -> Table:
        """One row for each axis: its plant and its control."""
        rows = [
            [name, loop.axis.plant.kind, getattr(loop.axis.friction_load or loop.axis.friction_motor, "kind", "-"),
             loop.control.law.kind, ", ".join(each.kind for each in loop.control.filters) or "-",
             None if loop.control.force_limit is None
             else Quantity(loop.control.force_limit, "N m" if loop.axis.rotary else "N", form="6"),
             float(loop.sample_time)]
            for name, loop in self.loops.items()
        ]  # fmt: skip
        between = f"; coupled by {', '.join(each.kind for each in self.couplings)}" if self.couplings else ""
        heads = ["axis", "plant", "friction", "law", "filters", "force limit", Column("sample", "s", "6 ms")]
        return Table(f"{plain(self.name)}, {self.file.name}{between}", heads, rows)

    def loop(self, axis: str | None) -> Loop:
        """The loop of an axis; the only one if none is named.

        Raises ParameterError for one that is not there, and for a coupled one: alone its motion would differ.
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
        """The name of an axis; of the only one if none is given. Raises ParameterError for one that is not there."""
        if axis is None and len(self.loops) == 1:
            return next(iter(self.loops))
        if axis is None:
            raise ParameterError(f"{self.file.name}: there are the axes {', '.join(self.loops)}: name one of them")
        if axis not in self.loops:
            raise ParameterError(f"{self.file.name}: axis '{axis}' is not there{nearest(axis, self.loops)}")
        return axis

    def coupled(self, axis: str) -> str:
        """The coupling of an axis, as a clause; empty if it has none."""
        for i, each in enumerate(self.couplings):
            if axis in each.axes():
                others = ", ".join(name for name in each.axes() if name != axis) or "the structure"
                return f"axis '{axis}' is coupled with {others} by couplings.{i} ({each.kind})"
        return ""

    def followers(self) -> dict[str, str]:
        """By axis the one whose word of a part program moves it too: second drives of gantries."""
        return {name: leader for each in self.couplings for name, leader in each.follows().items()}

    def machine(self, *couplings: Coupling) -> Machine:
        """All axes as one machine, with the couplings of the file and these.

        Raises ParameterError and StructureError as `Machine`.
        """
        return Machine.of(self.loops, (*self.couplings, *couplings), self.geometry)


MachineLike: TypeAlias = str | Path | MachineFile
"""A machine file, the name of a bundled machine, or one that was read."""


def read_machine(
    path: MachineLike, *, quoting: bool = True, values: Mapping[Key, Any] = MappingProxyType({})
) -> MachineFile:
    """The machine in a file, or the bundled one of that name; one that was read is itself.

    values  of keys, in place of what the file says

    Raises FileError (the file) and ParameterError or StructureError (a key in it), all with file and line.
    """
    if isinstance(path, MachineFile):
        return path
    if not isinstance(path, str | Path):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise ParameterError(
            f"a machine is a file, a bundled name or fd.read_machine(...), not a {type(path).__name__}"
        )
    file = read_toml(found(path, "machines"), "a machine file", quoting=quoting)
    file = with_values(file, values) if values else file
    root = file.root()
    text = {name: _text(root, name) for name in _TEXTS}
    sections = root.named("axis")
    loops = {name: _loop(root, name, section) for name, section in sections.items()}
    couplings, limits = _couplings(root, loops), _limits(sections)
    geometry = _geometry(root, loops)
    name = text["name"] or Path(file.name).stem
    return MachineFile(name, text["source"], text["remark"], loops, file, couplings, limits, geometry)


def machine_toml(
    machine: Machine,
    name: str,
    source: str = "",
    remark: str = "",
    limits: Mapping[str, AxisLimits] = MappingProxyType({}),
) -> str:
    """The text of a machine file, from which `read_machine` makes the same machine.

    Raises StructureError for a machine that holds arrays of variants.
    """
    texts = [f"{key} = {quoted(text)}" for key, text in zip(_TEXTS, (name, source, remark), strict=True) if text]
    parts = ["\n".join([*texts, f"sample_time = {float(machine.sample_time)!r}"]) + "\n"]
    for axis, each in machine.axes().items():
        parts += [
            to_toml(each.axis, f"axis.{axis}"),
            to_toml(each.control, f"axis.{axis}.control", rotary=each.axis.rotary),
            *([to_toml(limits[axis], f"axis.{axis}.limits", rotary=each.axis.rotary)] if axis in limits else []),
        ]
    parts += [to_toml(each, "couplings", listed=True) for each in machine.couplings]
    return "\n".join([*parts, *([] if machine.geometry is None else [to_toml(machine.geometry, "geometry")])])


def _couplings(root: Section, loops: Mapping[str, Loop]) -> tuple[Coupling, ...]:
    """The couplings, each checked with the axes; an error names its line."""
    found: tuple[Coupling, ...] = ()
    for section in root.listed("couplings"):
        found = (*found, read_block(Coupling, section))  # type: ignore[type-abstract]
        try:
            Machine.of(loops, found)
        except (ParameterError, StructureError) as error:
            text = Text(f"{error}")
            place = "" if text.startswith(section.dotted()) else f"{section.dotted()}: "
            raise type(error)(f"{section.where()}: {place}{text}") from None
    return found


def _geometry(root: Section, loops: Mapping[str, Loop]) -> Geometry | None:
    """The geometry errors, checked with the axes."""
    section = root.optional("geometry")
    if section is None:
        return None
    geometry = read_block(Geometry, section)
    try:
        Machine.of(loops, (), geometry)
    except (ParameterError, StructureError) as error:
        raise type(error)(f"{section.where()}: {error}") from None
    return geometry


def found(path: str | Path, folder: str) -> Path:
    """The path itself, or the file bundled in a folder under that name. Raises FileError if there is neither."""
    given = Path(path)
    if given.exists() or given.suffix:
        return given
    bundled = BUNDLED / folder / f"{given.name}.toml"
    if bundled.exists():
        return bundled
    names = sorted(each.stem for each in (BUNDLED / folder).glob("*.toml"))
    raise FileError(f"{given}: there is no such file, and no bundled one of that name{nearest(given.name, names)}")


def _loop(root: Section, name: str, section: Section) -> Loop:
    axis = read_block(Axis, section, besides={"control", "limits"})
    control = read_block(Control, section.section("control"))
    return read_block(
        Loop,
        root,
        besides={"axis", "couplings", "geometry", *_TEXTS},
        given={"axis": axis, "control": control, "name": name},
    )


def _limits(sections: Mapping[str, Section]) -> dict[str, AxisLimits]:
    """The limits of planned motions, of those axes that have a section for them."""
    given = {name: section.optional("limits") for name, section in sections.items()}
    return {name: read_block(AxisLimits, section) for name, section in given.items() if section is not None}


def planned_limits(machine: MachineFile | None, limits: str | Path | None) -> MachineLimits:
    """Limits by letter of the axes that a part program moves: of a machine, of a file of limits, or of both.

    A file of limits has sections [axis.x.limits] as a machine file has; they replace those of the machine, of which
    axes that have no name of a part program are left out: x y z u v w, and a b c if they turn.  Raises FileError or
    ParameterError.
    """
    given: dict[str, AxisLimits] = {}
    if limits is not None:
        file = read_toml(limits)
        root = file.root()
        root.refuse_unknown(("axis",))
        sections = root.named("axis")
        for name, section in sections.items():
            section.refuse_unknown(("limits",))
            section.section("limits")
            if machine is not None and name not in machine.loops:
                raise section.error(f"axis '{name}' is not in {machine.file.name}{nearest(name, machine.loops)}")
            if len(name) != 1 or name.upper() not in LETTERS:
                raise section.error(f"axis '{name}' is none that is planned: {', '.join(LETTERS.lower())}")
        given = _limits({name: replace(each, turning=name.upper() in ROTARY) for name, each in sections.items()})
    if machine is None:
        return MachineLimits({name.upper(): each for name, each in given.items()})
    found: dict[str, AxisLimits] = {}
    for name, loop in machine.loops.items():
        if len(name) != 1 or name.upper() not in LETTERS or loop.axis.rotary != (name.upper() in ROTARY):
            continue
        own = given.get(name) or machine.limits.get(name)
        if own is None:
            raise ParameterError(
                f"{machine.file.name}: axis '{name}' has no limits: give it a section [axis.{name}.limits] with "
                "velocity, acceleration, jerk and snap, or a file with such sections (--limits)"
            )
        found[name.upper()] = own if own.resolution is not None else replace(own, resolution=_resolution(loop))
    if not found:
        raise ParameterError(
            f"{machine.file.name}: a part program moves axes with the names x y z u v w, and a b c if they turn, and "
            f"there is none; there are: {', '.join(machine.loops)}"
        )
    return MachineLimits(found)


def _resolution(loop: Loop) -> float | None:
    """Of the position of an axis, m: that of the encoder at the load, else of the one at the motor."""
    for encoder in (loop.axis.encoder_load, loop.axis.encoder_motor):
        found = getattr(encoder, "resolution", None)
        if found is not None:
            return float(found)
    return None


def _text(section: Section, name: str) -> str:
    value = section.values.get(name, "")
    if not isinstance(value, str):
        raise section.error(f'{section.dotted(name)} must be a text in quotes ("...")', name)
    if name == "name" and not value.isprintable():
        raise section.error(
            f"{section.dotted(name)} must be one line of plain text: it is written into files of other programs", name
        )
    return value
