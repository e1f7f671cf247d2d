"""`feeddrive adjust`: remove filters from a controller, add filters to it, and set its parameters and guard limits in
the machine file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from feeddrive.export.design import weight
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.files.origins import with_origins
from feeddrive.language import tree
from feeddrive.language.block import declarations
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Cell, Table
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.tuning.filters import Difference, difference, read_filter, with_filters, written_filter
from feeddrive.workflow.command import GUARD_LIMITS, Outcome, Request, argument, command, exporting, option
from feeddrive.workflow.control_text import machine_text


class AdjustRequest(Request):
    """The machine file and the changes to its control: filters removed or added, guard limits, parameter values."""

    machine: MachineLike = argument("A machine file (TOML), or the name of a bundled machine")
    set: tuple[str, ...] = option(
        "NAME=VALUE of a number below the control, in SI, as law.Kp=52000 or filters.0.frequency=430, as the filters "
        "are numbered after --remove and --add; may be repeated",
        default=(),
    )
    add: tuple[str, ...] = option(
        "KIND:NAME=VALUE,... of a filter to add behind the others, in SI, as notch:frequency=164; may be repeated",
        default=(),
    )
    remove: tuple[str, ...] = option(
        "a filter to remove, as filters.0, as the machine file numbers them; may be repeated", default=()
    )
    guard: str | None = option(
        f"NAME=VALUE,... of bounds beyond which the loop trips, in SI, as {GUARD_LIMITS}; a control without a guard "
        "gets one, whose safe force holds a hanging axis",
        default=None,
    )
    axis: str | None = option("its axis, if it has several", default=None)
    out: Path | None = option("machine file to write", short="-o", default=None)

    def check(self) -> None:
        """Raise ParameterError if there is nothing to do."""
        if not (self.set or self.add or self.remove or self.guard):
            raise ParameterError(
                "nothing to do: give --set NAME=VALUE of a number, --add KIND:NAME=VALUE of a filter, --remove "
                "filters.0 or --guard NAME=VALUE"
            )


def adjusting(before: Control, after: Control) -> Mapping[str, tuple[str, ...]] | None:
    """Return the request fields `set`, `add` and `remove` that turn `before` into `after`; None if no request can.

    All three are empty for identical controls.
    """
    changes = difference(before, after)
    return None if changes is None else _written(changes)


def _written(changes: Difference) -> Mapping[str, tuple[str, ...]]:
    return {
        # repr is the shortest text that reads back as the same bits
        "set": tuple(f"{name}={float(value)!r}" for name, value in changes.values.items()),
        "add": tuple(written_filter(filter_) for filter_ in changes.added),
        "remove": tuple(f"filters.{i}" for i in changes.removed),
    }


@command(AdjustRequest)
def adjust(request: AdjustRequest, progress: Progress) -> Outcome[MachineFile]:
    """Remove and add filters of a controller and set its parameters; everything else in the machine file is preserved.

    The result is the changed machine file. Raises ParameterError for an unknown parameter, filter or kind of filter,
    and for a value out of bounds.
    """
    progress.step("reading")
    machine = read_machine(request.machine)
    axis = machine.named(request.axis)
    loop = machine.loops[axis]
    removed, added = _places(request.remove), tuple(read_filter(text) for text in request.add)
    edited = with_filters(loop.control, removed, added)
    bounds = {} if request.guard is None else _bounds(request.guard)
    held = float(weight(loop.axis))
    if bounds and edited.guard is None and held:
        bounds = {"safe_force": held, **bounds}
    if bounds:
        edited = replace(edited, guard=replace(edited.guard or Guard(), **bounds))
    # --set names filters as they are numbered after --remove and --add, so its names belong to the edited control
    values = _values(edited, request.set)
    loops = {**machine.loops, axis: replace(loop, control=tree.vary(edited, values))}
    changed = loops[axis].control
    text = machine_text(machine, axis, changed)
    # a file that is changed in place stays made from what it was: its own older text is gone
    if request.out is None or request.out.resolve() != Path(machine.file.name).resolve():
        text = with_origins(text, (machine,))
    rows: list[Sequence[Cell]] = [(f"filters.{i}", loop.control.filters[i].kind, "removed", "") for i in removed]
    rows += [
        (f"filters.{len(edited.filters) - len(added) + i}", "added", filter_.kind, "")
        for i, filter_ in enumerate(added)
    ]
    for name, value in bounds.items():
        before = None if loop.control.guard is None else getattr(loop.control.guard, name)
        rows.append(_changed(f"guard.{name}", before, value, declarations(Guard)[name].unit))
    for name, value in values.items():
        rows.append(_changed(name, tree.get(edited, name), value, tree.declaration(edited, name).unit))
    files: Mapping[str, Path] = {}
    if request.out is not None:
        write_whole(request.out, text)
        files = {"Machine": request.out}
    shown = Table(f"{machine.name}, axis {axis}: what was changed", ("what", "before", "now", "unit"), rows)
    # later edits of the result start from its text, so the text must hold the change too
    adjusted = replace(machine, loops=loops, file=replace(machine.file, text=text))
    # a control that got its limits is ready to be exported
    then = exporting(files["Machine"], request.axis, guarded=True)[0] if files and bounds else ""
    return Outcome(adjusted, [shown], files=files, rotary=loop.axis.rotary, then=then)


def _changed(name: str, before: float | None, now: float, unit: str) -> Sequence[Cell]:
    """Return the table row of a changed parameter, with its old and new value in the SI unit."""
    return (
        name,
        "none" if before is None else Quantity(before, unit, form="6 SI"),
        Quantity(now, unit, form="6 SI"),
        UNIT,
    )


def _bounds(text: str) -> dict[str, float]:
    """Parse the limits of a guard by name. Raise ParameterError for an unknown limit or an invalid number."""
    known = [name for name, declared in declarations(Guard).items() if declared.role == "parameter"]
    return _numbers("--guard", text.split(","), known, "a guard", "velocity_limit=1")


def _places(texts: Sequence[str]) -> tuple[int, ...]:
    places = list[int]()
    for text in texts:
        place = text.removeprefix("filters.")
        # isdigit alone is true for '²', which int() rejects
        if not place.isascii() or not place.isdigit() or place == text or int(place) in places:
            raise ParameterError(f"--remove {text}: write each filter once as filters.0, with its place in the file")
        places.append(int(place))
    return tuple(places)


def _values(control: Control, texts: Sequence[str]) -> dict[str, float]:
    known = [name for name, value in tree.leaves(control) if isinstance(value, (int, float))]
    return _numbers("--set", texts, known, "the control", "law.Kp=52000")


def _numbers(option: str, texts: Sequence[str], known: Sequence[str], whose: str, such: str) -> dict[str, float]:
    """Parse NAME=VALUE strings into numbers by name.

    Raises ParameterError for a name that is unknown or repeated, and for an invalid number.
    """
    numbers = dict[str, float]()
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise ParameterError(f"{option} {text}: write it as NAME=VALUE, such as {such}")
        if name not in known:
            raise ParameterError(f"{option} {text}: {whose} has no number '{name}'{nearest(name, known)}")
        if name in numbers:
            raise ParameterError(f"{option} {text}: {name} is given twice: leave one out")
        try:
            numbers[name] = float(value)
        except ValueError:
            raise ParameterError(f"{option} {text}: '{value}' is no number") from None
    return numbers
