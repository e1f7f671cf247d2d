"""`feeddrive adjust`: named numbers of a control, set within their bounds and written into its machine file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from feeddrive.files.atomic_io import write_whole
from feeddrive.files.machine import MachineFile, MachineLike, read_machine
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.language.progress import Progress
from feeddrive.language.table import Table
from feeddrive.loop.control import Control
from feeddrive.workflow.command import Outcome, command
from feeddrive.workflow.request import Request, argument, option
from feeddrive.workflow.tune_files import machine_text


class AdjustRequest(Request):
    """Which machine file, and which numbers of its control get which values."""

    machine: MachineLike = argument("A machine file (TOML), or the name of a bundled machine")
    set: tuple[str, ...] = option(
        "NAME=VALUE of a number below the control, in SI, as law.Kp=52000 or filters.0.frequency=430; may be repeated",
        default=(),
    )
    axis: str | None = option("its axis, if it has several", default=None)
    out: Path | None = option("machine file to write", short="-o", default=None)


@command(AdjustRequest)
def adjust(request: AdjustRequest, progress: Progress) -> Outcome[MachineFile]:
    """Set named numbers of a control within their bounds; all else in the machine file stays as it is written.

    The result is the machine file with them. Raises ParameterError for a number that there is not, or outside of its
    bounds.
    """
    progress.step("reading")
    machine = read_machine(request.machine)
    axis = machine.named(request.axis)
    control = machine.loops[axis].control
    values = _values(control, request.set)
    changed = tree.vary(control, values)
    text = machine_text(machine, axis, changed)
    rows = [(name, f"{tree.get(control, name):.6g}", f"{value:.6g}", tree.declaration(control, name).unit)
            for name, value in values.items()]  # fmt: skip
    files: Mapping[str, Path] = {}
    if request.out is not None:
        write_whole(request.out, text)
        files = {"Machine": request.out}
    shown = Table(f"{machine.name}, axis {axis}: numbers that were set", ("number", "before", "now", "unit"), rows)
    loops = {**machine.loops, axis: replace(machine.loops[axis], control=changed)}
    found = replace(machine, loops=loops, file=replace(machine.file, text=text))
    return Outcome(found, [shown], files=files)


def _values(control: Control, given: Sequence[str]) -> dict[str, float]:
    known = {name for name, value in tree.leaves(control) if isinstance(value, (int, float))}
    found = dict[str, float]()
    for each in given:
        name, equals, value = each.partition("=")
        if not equals:
            raise ParameterError(f"--set {each}: write it as NAME=VALUE, such as law.Kp=52000")
        if name not in known:
            raise ParameterError(f"--set {each}: the control has no number '{name}'{nearest(name, known)}")
        try:
            found[name] = float(value)
        except ValueError:
            raise ParameterError(f"--set {each}: '{value}' is no number") from None
    if not found:
        raise ParameterError(f"--set is missing: NAME=VALUE of a number, one of {', '.join(sorted(known)[:8])}")
    return found
