"""Export of the steps on the page as commands, Python and a job, so that they can be repeated without the page."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from feeddrive.files.from_toml import to_toml
from feeddrive.files.toml_edit import quoted
from feeddrive.tuning.filters import difference

if TYPE_CHECKING:
    from feeddrive.studio.desk import Desk


@dataclass(frozen=True)
class Recipe:
    """The steps on the page as commands, as a script and as a job.

    commands  shell commands, one per line
    python    Python script
    job       job file that simulates today's and the current control over the move of the page; empty without a machine
    """

    commands: str
    python: str
    job: str


def recipe_of(desk: Desk) -> Recipe:
    """Return the recipe of the steps on the page, in order, including parameters changed by hand."""
    steps = [(step.command, step.request) for step in desk.done]
    moved = None if desk.bench is None or desk.bench.machine is None else desk.not_yet_done()
    if moved is not None:
        steps.append(("adjust", moved))
    commands = [request.command_line(name) for name, request in steps]
    kept = [
        f"# {path}: {what}; keep this file"
        for path, what in desk.kept.items()
        if any(str(path) in step for step in commands)
    ]
    commands = [*kept, *commands]
    python = ["import feeddrive as fd", "", *kept]
    python += [request.python(name) for name, request in steps]
    return Recipe("\n".join([*commands, ""]), "\n".join([*python, ""]), _job(desk))


def _job(desk: Desk) -> str:
    """Return a job that compares today's and the current control over the same move and force."""
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
    changes = difference(before, replace(now, guard=before.guard))
    if changes is not None and not changes.removed and not changes.added:
        if changes.values:
            keys = {quoted(f"axis.{bench.axis}.control.{name}"): value for name, value in changes.values.items()}
            pairs = ", ".join(f"{key} = {value!r}" for key, value in keys.items())
            lines += ["[[law]]", 'name = "by hand"', f"set = {{ {pairs} }}", ""]
    else:
        text = to_toml(replace(now, guard=None), "law.control", rotary=bench.rotary).strip()
        lines += ["[[law]]", 'name = "by hand"', "", text, ""]
    return "\n".join(lines)


def whole(machine: str | Path) -> str:
    """Return a machine reference that is valid in a job anywhere: a bundled name, or an absolute path."""
    path = Path(machine)
    return str(path.resolve()) if path.exists() else str(machine)
