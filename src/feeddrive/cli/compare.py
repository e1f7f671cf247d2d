"""`feeddrive compare`: all laws on one axis of a machine, at equal robustness."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.comparison.arena import Comparison, compare, pieces
from feeddrive.comparison.results import write_arena
from feeddrive.files.machine import read_machine
from feeddrive.loop.runner import cores


def perform(machine: str, axis: str | None, laws: list[str] | None, starts: int, out: Path | None) -> None:
    """Tune all laws, run them, write the report, and show the figures and who loses where."""
    console = open_console()
    found, report = _run(console, machine, axis, laws or None, starts, out)
    console.print(drawn(found.table()))
    console.print(f"- rule: {found.rule}", markup=False)
    for remark in found.remarks:
        console.print(f"- {remark}", markup=False)
    for refusal in found.refusals:
        console.print(f"- '{refusal.name}' is not on this axis: {refusal.reason}", markup=False)
    console.print(f"Report: {report}", markup=False, soft_wrap=True)


def _run(
    console: Console, name: str, axis: str | None, laws: list[str] | None, starts: int, out: Path | None
) -> tuple[Comparison, Path]:
    machine = read_machine(name)
    total = pieces(machine, axis, laws) + 1
    where = out or Path("results") / f"compare_{Path(name).stem}{'' if axis is None else f'_{axis}'}"
    bar = Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console, transient=True)
    with bar:
        task = bar.add_task(escape(machine.name), total=total)

        def step(text: str) -> None:
            bar.update(task, description=escape(text), advance=1)

        found = compare(machine, axis, laws=laws, starts=starts, workers=cores(), step=step)
        step("report")
        return found, write_arena(found, where)
