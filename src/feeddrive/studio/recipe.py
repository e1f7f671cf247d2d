"""What was done on the page, as commands, as Python and as a job: who has them needs no page."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from feeddrive.files.to_toml import to_toml
from feeddrive.files.toml_values import quoted
from feeddrive.tuning.filter_pack import difference

if TYPE_CHECKING:
    from feeddrive.studio.desk import Desk


@dataclass(frozen=True)
class Recipe:
    """The same work without the page.

    commands  of the command line, one a line
    python    a script
    job       a job file that runs the control before and after over the move of the page; empty without a machine
    """

    commands: str
    python: str
    job: str


def recipe_of(desk: Desk) -> Recipe:
    """What was done on the page, in its order, and the numbers that were moved by hand."""
    steps = [(each.command, each.request) for each in desk.done]
    moved = None if desk.bench is None or desk.bench.machine is None else desk.not_yet_done()
    if moved is not None:
        steps.append(("adjust", moved))
    commands = [request.command_line(name) for name, request in steps]
    kept = [
        f"# {path}: {what}; keep this file"
        for path, what in desk.kept.items()
        if any(str(path) in each for each in commands)
    ]
    commands = [*kept, *commands]
    python = ["import feeddrive as fd", "", *kept]
    python += [request.python(name) for name, request in steps]
    return Recipe("\n".join([*commands, ""]), "\n".join([*python, ""]), _job(desk))


def _job(desk: Desk) -> str:
    """Today's control and that of now over the same move and the same force."""
    bench = desk.bench
    if bench is None or bench.machine is None:
        return ""
    move, force, duration = bench.work
    lines = [
        f"title = {quoted(f'{bench.title}: before and after')}",
        f"machine = {quoted(whole(bench.file))}",
        f"axis = {quoted(bench.axis)}",
        f"duration = {duration!r}",
        "",
        to_toml(move, "reference", rotary=bench.rotary).strip(),
        "",
        to_toml(force, "load", rotary=bench.rotary).strip(),
        "",
    ]
    before, now = bench.before.start, desk.control
    found = difference(before, replace(now, guard=before.guard))
    if found is not None and not found.removed and not found.added:
        if found.values:
            keys = {quoted(f"axis.{bench.axis}.control.{name}"): each for name, each in found.values.items()}
            pairs = ", ".join(f"{key} = {each!r}" for key, each in keys.items())
            lines += ["[[law]]", 'name = "by hand"', f"set = {{ {pairs} }}", ""]
    else:
        text = to_toml(replace(now, guard=None), "law.control", rotary=bench.rotary).strip()
        lines += ["[[law]]", 'name = "by hand"', "", text, ""]
    return "\n".join(lines)


def whole(machine: str | Path) -> str:
    """A machine as a job names it that may stand anywhere: a bundled name, or a whole path."""
    path = Path(machine)
    return str(path.resolve()) if path.exists() else str(machine)
