"""What was done on the page, as commands, as Python and as a job: who has them needs no page."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

from feeddrive.files.blocks_to_toml import to_toml
from feeddrive.workflow.adjust import AdjustRequest

if TYPE_CHECKING:
    from feeddrive.studio.desk import Desk

_MACHINE = "machine.toml"


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
    """What was done since the source was brought, in its order, and the numbers that were moved by hand."""
    steps = [(each.command, each.request) for each in desk.done]
    moved = _moved(desk)
    if moved is not None:
        steps.append(("adjust", moved))
    commands = [request.command_line(name) for name, request in steps]
    python = ["from pathlib import Path", "", "import feeddrive as fd", ""]
    python += [request.python(name) for name, request in steps]
    return Recipe("\n".join([*commands, ""]), "\n".join([*python, ""]), _job(desk))


def _changes(desk: Desk) -> dict[str, float]:
    """Numbers that differ from those to begin with."""
    bench = desk.bench
    if bench is None:
        return {}
    return {name: value for name, value in desk.values.items() if value != bench.by_hand.values[name]}


def _moved(desk: Desk) -> AdjustRequest | None:
    changes, bench = _changes(desk), desk.bench
    if not changes or bench is None or bench.machine is None:
        return None
    pairs = tuple(f"{name}={value!r}" for name, value in changes.items())
    return AdjustRequest(desk.base, set=pairs, axis=bench.axis, out=desk.folder / _MACHINE)


def _job(desk: Desk) -> str:
    """Today's control and that of now over the same move and the same force."""
    bench = desk.bench
    if bench is None or bench.machine is None:
        return ""
    move, force, duration = bench.work
    lines = [
        f"title = {json.dumps(f'{bench.title}: before and after')}",
        f"machine = {json.dumps(str(desk.base))}",
        f"axis = {json.dumps(bench.axis)}",
        f"duration = {duration!r}",
        "",
        to_toml(move, "reference").strip(),
        "",
        to_toml(force, "load").strip(),
        "",
    ]
    changes = _changes(desk)
    if changes:
        pairs = ", ".join(f'"axis.{bench.axis}.control.{name}" = {value!r}' for name, value in changes.items())
        lines += ["[[law]]", 'name = "by hand"', f"set = {{ {pairs} }}", ""]
    return "\n".join(lines)
