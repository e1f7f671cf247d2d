"""A machine file with what was identified: a given one with new values and its own comments, or a new one."""

from __future__ import annotations

from pathlib import Path

from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.files.blocks_to_toml import to_toml
from feeddrive.files.machine import MachineFile
from feeddrive.files.toml_edit import TomlEdit
from feeddrive.identification.estimate import Estimate
from feeddrive.identification.motion.identify import Identified
from feeddrive.language import tree
from feeddrive.language.block import Block, declarations
from feeddrive.loop.loop import Loop


def machine_text(found: Identified, machine: MachineFile | None, axis: str) -> str | None:
    """The text of the machine file; None if the loop is not known whole (no law, or a shaft without a lead)."""
    if found.loop is None:
        return None
    return _new(found, axis) if machine is None else _edited(found, machine, axis)


def estimates_of(found: Identified) -> tuple[Estimate, ...]:
    """The estimates that go into the file: those of the closed loop if there are such, else of the inverse dynamics."""
    return found.rigid.estimates if found.refinement is None else found.refinement.estimates


def _edited(found: Identified, machine: MachineFile, axis: str) -> str:
    assert found.loop is not None
    edit = TomlEdit(machine.file.text, machine.file.name)
    before, after = machine.loop(axis).axis, found.loop.axis
    place = ("axis", axis)
    if isinstance(before.plant, Rigid):
        _values(edit, (*place, "plant"), before.plant, after.plant)
    if type(before.friction_load) is type(after.friction_load) and before.friction_load is not None:
        assert after.friction_load is not None
        _values(edit, (*place, "friction_load"), before.friction_load, after.friction_load)
    elif after.friction_load is not None:
        edit.replace((*place, "friction_load"), to_toml(after.friction_load, f"axis.{axis}.friction_load"))
    if before.forces != after.forces:
        _forces(edit, axis, before.forces, after.forces)
    if before.actuator.dead_time != after.actuator.dead_time:
        key = (*place, "actuator")
        if edit.has(key):
            edit.set((*key, "dead_time"), float(after.actuator.dead_time), "s")
        else:
            edit.add(f"[axis.{axis}.actuator]\ndead_time = {float(after.actuator.dead_time)!r}")
    _say_errors(edit, found, axis, found.loop)
    return edit.text


def _forces(edit: TomlEdit, axis: str, before: tuple[Block, ...], after: tuple[Block, ...]) -> None:
    """The constant force changed, or came, or went; the others are as they were."""
    if len(before) == len(after) and all(type(a) is type(b) for a, b in zip(before, after, strict=True)):
        for k, (old, new) in enumerate(zip(before, after, strict=True)):
            _values(edit, ("axis", axis, "forces", k), old, new)
        return
    key = f"axis.{axis}.forces"
    sections = [to_toml(each, key).replace(f"[{key}]", f"[[{key}]]", 1) for each in after]
    edit.remove(("axis", axis, "forces"))
    for section in sections:
        edit.add(section)


def _values(edit: TomlEdit, key: tuple[str | int, ...], before: Block, after: Block) -> None:
    """Every parameter that changed."""
    for name, declared in declarations(type(after)).items():
        old, new = getattr(before, name), getattr(after, name)
        if declared.role == "parameter" and new is not None and new != old:
            edit.set((*key, name), float(new), declared.unit)


def _new(found: Identified, axis: str) -> str:
    """A whole file; each number that was estimated has its standard error beside it."""
    loop = found.loop
    assert loop is not None
    lines = [
        f'name = "axis identified from {_plain(found.log.name)}"',
        f'source = "feeddrive identify {_plain(found.log.name)}"',
        'remark = "Mass, friction and gains were found in one log; limits and encoders are not in it: add them."',
        f"sample_time = {float(loop.sample_time)!r}",
        "",
        to_toml(loop.axis, f"axis.{axis}"),
        to_toml(loop.control, f"axis.{axis}.control"),
    ]
    edit = TomlEdit("\n".join(lines), "identified.toml")
    _say_errors(edit, found, axis, loop)
    return edit.text


def _say_errors(edit: TomlEdit, found: Identified, axis: str, loop: Loop) -> None:
    """The estimates with their errors in the comments."""
    for each in estimates_of(found):
        name = each.name if each.name in tree.parameters(loop) else _place(loop, each.name)
        if name is None:
            continue
        parts = [int(part) if part.isdigit() else part for part in name.split(".")]
        key = edit.set(("axis", axis, *parts[2:]), float(tree.get(loop, name)), each.unit)
        edit.comment(key, f"standard error {each.error:.2g} {each.unit}")


def _place(loop: Loop, parameter: str) -> str | None:
    """Where a parameter of the inverse dynamics stands in a loop."""
    own = loop.place_of("axis")
    if parameter == "offset":
        return next((path for path in tree.parameters(loop) if path.startswith(f"{own}.forces.")), None)
    for part in ("plant", "friction_load"):
        if part == "plant" and not isinstance(loop.axis.plant, Rigid):
            continue
        path = f"{own}.{part}.{parameter}"
        if path in tree.parameters(loop):
            return path
    return None


def _plain(name: str) -> str:
    return "".join(c for c in Path(name).name if c.isprintable() and c not in '"\\')
