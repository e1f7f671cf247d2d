"""The text of a machine file with another control of an axis: what did not change stays as it is written."""

from feeddrive.files.machine import MachineFile
from feeddrive.files.section import to_toml
from feeddrive.files.toml_file import TomlEdit, key_of
from feeddrive.language import tree, units
from feeddrive.language.block import Block
from feeddrive.language.quantity import number
from feeddrive.loop.control import Control
from feeddrive.tuning.filters import aligned

_LISTS = ("filters", "feedforward", "compensation")
_DIGITS = 7


def machine_text(machine: MachineFile, axis: str, control: Control) -> str:
    """Return the text of the machine file with the control of one axis replaced.

    A law of the same structure is edited parameter by parameter.  For another kind, or another form of the same kind,
    the section is replaced: a parameter that the new form lacks must not stay in the file.  Prefilters are treated
    likewise.  Guard, force limit and delay are set, or left as they are if the control has none.  In a list of
    blocks, retained ones are edited parameter by parameter, others are removed, and new ones appended (`aligned`).
    """
    edit = TomlEdit(machine.file.text, machine.file.name)
    old = machine.loops[axis].control
    where, rotary = ("axis", axis, "control"), machine.loops[axis].axis.rotary
    if tree.structure(old.law) == tree.structure(control.law):
        _numbers(edit, (*where, "law"), old.law, control.law)
    else:
        edit.replace((*where, "law"), to_toml(control.law, ".".join((*where, "law")), rotary=rotary))
    if old.prefilter is not None and control.prefilter is None:
        edit.remove((*where, "prefilter"))
    elif control.prefilter is not None and control.prefilter != old.prefilter:
        if old.prefilter is not None and tree.structure(old.prefilter) == tree.structure(control.prefilter):
            _numbers(edit, (*where, "prefilter"), old.prefilter, control.prefilter)
        else:
            text = to_toml(control.prefilter, ".".join((*where, "prefilter")), rotary=rotary)
            edit.replace((*where, "prefilter"), text)
    if control.guard is not None and old.guard is None:
        edit.add(to_toml(control.guard, ".".join((*where, "guard")), rotary=rotary))
    elif control.guard is not None and old.guard is not None:
        _numbers(edit, (*where, "guard"), old.guard, control.guard)
    for name in ("feedback_delay", "force_limit"):
        before, after = getattr(old, name), getattr(control, name)
        if after is not None and after != before:
            edit.set((*where, name), float(after), tree.declaration(control, name).unit, _DIGITS)
    for name in _LISTS:
        before, after = getattr(old, name), getattr(control, name)
        # a removed and a new block at one index are two blocks: comments of the old one must not stay on the new one
        kept = aligned(before, after)
        # from the end, so that the indices of the blocks before stay valid
        for place in reversed(range(len(before))):
            if place not in kept:
                edit.remove((*where, name, place))
        for i, place in enumerate(kept):
            _numbers(edit, (*where, name, i), before[place], after[i])
        for block in after[len(kept) :]:
            edit.add(to_toml(block, ".".join((*where, name)), listed=True, rotary=rotary))
    return edit.text


def _numbers(edit: TomlEdit, key: tuple[str | int, ...], old: Block, new: Block) -> None:
    """Write the changed parameters of a block, each with its old value in a comment."""
    before = dict(tree.leaves(old))
    for name, value in tree.leaves(new):
        if before.get(name) != value:
            unit = tree.declaration(new, name).unit
            written = edit.set((*key, *key_of(name)), float(value), unit, _DIGITS)
            # a comment on the old number must not be read as one on the new number
            if name in before:
                scale = _scale(str(written[-1]), key_of(name)[-1], unit)
                edit.comment(written, f"was {number(before[name] / scale, 7)}")


def _scale(written: str, name: str | int, unit: str) -> float:
    """Return the factor from the unit in a file's key to the declared unit: 1000 for Kp_kN_s_per_m and 1 for Kp."""
    stated = written.removeprefix(f"{name}_")
    return 1.0 if stated == written else units.factor(stated, unit)
