"""A machine file: axes with their physics, and the control that runs on them.

name = "my mill"
sample_time_ms = 0.25
[axis.x]                      # the physics; substeps, encoders, friction, forces
[axis.x.plant]
kind = "two_mass"
[axis.x.control]              # today's control: limit, guard, filters, feedforward
[axis.x.control.law]
kind = "cascade_ppi"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from feeddrive.blocks.machine_families import Coupling
from feeddrive.files.blocks_from_toml import read_block
from feeddrive.files.messages import nearest
from feeddrive.files.toml_file import Section, TomlFile, read_toml
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine

BUNDLED = Path(__file__).parent / "bundled"
_TEXTS = ("name", "source", "remark")


@dataclass(frozen=True)
class MachineFile:
    """What a machine file says: a loop for each axis, and where the numbers come from."""

    name: str
    source: str
    remark: str
    loops: Mapping[str, Loop]
    file: TomlFile

    def loop(self, axis: str | None) -> Loop:
        """The loop of an axis; the only one if none is named. Raises ParameterError for one that is not there."""
        if axis is None and len(self.loops) == 1:
            return next(iter(self.loops.values()))
        if axis is None:
            raise ParameterError(f"{self.file.name}: there are the axes {', '.join(self.loops)}: name one of them")
        if axis not in self.loops:
            raise ParameterError(f"{self.file.name}: axis '{axis}' is not there{nearest(axis, self.loops)}")
        return self.loops[axis]

    def machine(self, *couplings: Coupling) -> Machine:
        """All axes as one machine, with what couples them. Raises ParameterError and StructureError as `Machine`."""
        return Machine.of(self.loops, couplings)


def read_machine(path: str | Path) -> MachineFile:
    """The machine in a file, or the bundled one of that name.

    Raises FileError (the file) and ParameterError or StructureError (a key in it), all with file and line.
    """
    file = read_toml(found(path, "machines"))
    root = file.root()
    text = {name: _text(root, name) for name in _TEXTS}
    loops = {name: _loop(root, name, section) for name, section in root.named("axis").items()}
    return MachineFile(text["name"] or Path(file.name).stem, text["source"], text["remark"], loops, file)


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
    axis = read_block(Axis, section, besides={"control"})
    control = read_block(Control, section.section("control"))
    return read_block(Loop, root, besides={"axis", *_TEXTS}, given={"axis": axis, "control": control, "name": name})


def _text(section: Section, name: str) -> str:
    value = section.values.get(name, "")
    if not isinstance(value, str):
        raise section.error(f'{section.dotted(name)} must be a text in quotes ("...")', name)
    if name == "name" and not value.isprintable():
        raise section.error(
            f"{section.dotted(name)} must be one line of plain text: it goes into files of others", name
        )
    return value
