"""`feeddrive adjust`: filters of a control removed and added, its numbers and its guard set, in its machine file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from feeddrive.files.atomic_io import write_whole
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.language import tree
from feeddrive.language.declaration import declarations
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Cell, Table
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.tuning.filters import Difference, difference, read_filter, with_filters, written_filter
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.request import Request, argument, option
from feeddrive.workflow.tune_files import machine_text


class AdjustRequest(Request):
    """Which machine file, and what is done to its control: filters removed, others added, guard, then numbers set."""

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
        "NAME=VALUE,... of bounds beyond which the loop trips, in SI, as following_error_limit=0.001,velocity_limit=1; "
        "a control without a guard gets one",
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
    """The fields `set`, `add` and `remove` that lead from one control to another; None if no request can.

    All three are empty for equal controls.
    """
    found = difference(before, after)
    return None if found is None else _written(found)


def _written(found: Difference) -> Mapping[str, tuple[str, ...]]:
    return {
        "set": tuple(f"{name}={float(value)!r}" for name, value in found.values.items()),
        "add": tuple(written_filter(each) for each in found.added),
        "remove": tuple(f"filters.{i}" for i in found.removed),
    }


@command(AdjustRequest)
def adjust(request: AdjustRequest, progress: Progress) -> Outcome[MachineFile]:
    """Remove and add filters of a control and set its numbers; all else in the machine file stays as it is written.

    The result is the machine file with them. Raises ParameterError for a number, filter or kind of filter that there is
    not, and for a value outside of its bounds.
    """
    progress.step("reading")
    machine = read_machine(request.machine)
    axis = machine.named(request.axis)
    loop = machine.loops[axis]
    removed, added = _places(request.remove), tuple(read_filter(each) for each in request.add)
    begun = with_filters(loop.control, removed, added)
    bounds = {} if request.guard is None else _bounds(request.guard)
    if bounds:
        begun = replace(begun, guard=replace(begun.guard or Guard(), **bounds))
    values = _values(begun, request.set)
    loops = {**machine.loops, axis: replace(loop, control=tree.vary(begun, values))}
    changed = loops[axis].control
    text = machine_text(machine, axis, changed)
    rows: list[Sequence[Cell]] = [(f"filters.{i}", loop.control.filters[i].kind, "removed", "") for i in removed]
    rows += [(f"filters.{len(begun.filters) - len(added) + i}", "added", each.kind, "") for i, each in enumerate(added)]
    for name, value in bounds.items():
        before = None if loop.control.guard is None else getattr(loop.control.guard, name)
        rows.append(_changed(f"guard.{name}", before, value, declarations(Guard)[name].unit))
    for name, value in values.items():
        rows.append(_changed(name, tree.get(begun, name), value, tree.declaration(begun, name).unit))
    files: Mapping[str, Path] = {}
    if request.out is not None:
        write_whole(request.out, text)
        files = {"Machine": request.out}
    shown = Table(f"{machine.name}, axis {axis}: what was changed", ("what", "before", "now", "unit"), rows)
    found = replace(machine, loops=loops, file=replace(machine.file, text=text))
    return Outcome(found, [shown], files=files, rotary=loop.axis.rotary)


def _changed(name: str, before: float | None, now: float, unit: str) -> Sequence[Cell]:
    """Return the row of a number, in the SI unit in which the option has it."""
    return (
        name,
        "none" if before is None else Quantity(before, unit, form="6 SI"),
        Quantity(now, unit, form="6 SI"),
        UNIT,
    )


def _bounds(given: str) -> dict[str, float]:
    """The numbers of a guard. Raises ParameterError for one that it has not, and for no number."""
    known = [name for name, each in declarations(Guard).items() if each.role == "parameter"]
    return _numbers("--guard", given.split(","), known, "a guard", "velocity_limit=1")


def _places(given: Sequence[str]) -> tuple[int, ...]:
    found = list[int]()
    for each in given:
        place = each.removeprefix("filters.")
        if not place.isascii() or not place.isdigit() or place == each or int(place) in found:
            raise ParameterError(f"--remove {each}: write each filter once as filters.0, with its place in the file")
        found.append(int(place))
    return tuple(found)


def _values(control: Control, given: Sequence[str]) -> dict[str, float]:
    known = [name for name, value in tree.leaves(control) if isinstance(value, (int, float))]
    return _numbers("--set", given, known, "the control", "law.Kp=52000")


def _numbers(option: str, given: Sequence[str], known: Sequence[str], whose: str, such: str) -> dict[str, float]:
    """Numbers by name, of texts NAME=VALUE. Raises ParameterError for an unknown name, one twice, and no number."""
    found = dict[str, float]()
    for each in given:
        name, equals, value = (part.strip() for part in each.partition("="))
        if not equals:
            raise ParameterError(f"{option} {each}: write it as NAME=VALUE, such as {such}")
        if name not in known:
            raise ParameterError(f"{option} {each}: {whose} has no number '{name}'{nearest(name, known)}")
        if name in found:
            raise ParameterError(f"{option} {each}: {name} is given twice: leave one out")
        try:
            found[name] = float(value)
        except ValueError:
            raise ParameterError(f"{option} {each}: '{value}' is no number") from None
    return found
