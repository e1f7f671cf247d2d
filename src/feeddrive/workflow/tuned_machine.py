"""A machine file with a tuned control in it: comments, order and units of everything else stay."""

from __future__ import annotations

from feeddrive.files.blocks_to_toml import to_toml
from feeddrive.files.machine import MachineFile
from feeddrive.files.toml_edit import TomlEdit
from feeddrive.language import tree, units
from feeddrive.language.block import Block
from feeddrive.loop.control import Control

_LISTS = ("filters", "feedforward", "compensation")
_DIGITS = 7


def machine_text(machine: MachineFile, axis: str, control: Control) -> str:
    """The text of the machine's file with another control of one axis.

    A law of the same kind is changed number by number; another law takes the place of the section.  Lists of blocks are
    changed number by number as far as the kinds are the same, and are written anew otherwise.
    """
    edit = TomlEdit(machine.file.text, machine.file.name)
    old = machine.loops[axis].control
    where = ("axis", axis, "control")
    if type(old.law) is type(control.law):
        _numbers(edit, (*where, "law"), old.law, control.law)
    else:
        edit.replace((*where, "law"), to_toml(control.law, ".".join((*where, "law"))))
    if old.prefilter is not None and control.prefilter is None:
        edit.remove((*where, "prefilter"))
    for name in _LISTS:
        before, after = getattr(old, name), getattr(control, name)
        if [tree.structure(each) for each in before] == [tree.structure(each) for each in after[: len(before)]]:
            for i, (a, b) in enumerate(zip(before, after, strict=False)):
                _numbers(edit, (*where, name, i), a, b)
            fresh = after[len(before) :]
        else:
            edit.remove((*where, name))
            fresh = after
        for block in fresh:
            edit.add(_listed(block, ".".join((*where, name))))
    return edit.text


def _listed(block: Block, key: str) -> str:
    """A block as one more entry of a list."""
    text = to_toml(block, key)
    return text.replace(f"[{key}]", f"[[{key}]]", 1)


def _numbers(edit: TomlEdit, key: tuple[str | int, ...], old: Block, new: Block) -> None:
    """The numbers of a block that are others now."""
    before = dict(tree.leaves(old))
    for name, value in tree.leaves(new):
        if before.get(name) != value:
            unit = tree.declaration(new, name).unit
            written = edit.set((*key, *_path(name)), float(value), unit, _DIGITS)
            if name in before:  # what a comment says of the old number shall not be read of the new one
                edit.comment(written, f"was {before[name] / _scale(str(written[-1]), _path(name)[-1], unit):.7g}")


def _scale(written: str, name: str | int, unit: str) -> float:
    """What a number of a file counts in its declared unit: 1000 for Kp_kN_s_per_m, 1 for Kp."""
    stated = written.removeprefix(f"{name}_")
    return 1.0 if stated == written else units.factor(stated, unit)


def _path(name: str) -> tuple[str | int, ...]:
    return tuple(int(part) if part.isdigit() else part for part in name.split("."))
