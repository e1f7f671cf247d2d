"""`feeddrive reproduce`: the experiments of a paper, with a table of what holds."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.files.atomic_io import new_directory
from feeddrive.language.table import Table
from feeddrive.papers.papers import Reproduced, chosen, fill, reproduce


def perform(paper: str, out: Path | None) -> None:
    """Run the papers, write the report, show the claims; exit with 1 if one does not hold."""
    names = chosen(paper)
    console = open_console()
    out = out or Path("results") / paper
    with new_directory(out) as folder:  # before the work: a place that cannot be written is refused at once
        reproduced = _run(names, console)
        fill(folder, reproduced)
    for each in reproduced:
        rows = [[claim.key, claim.claim, claim.bounds, claim.shown, claim.cells()[-1]] for claim in each.claims]
        console.print(drawn(Table(each.title, ["row", "claim", "expected", "got", "holds?"], rows), wrapped=1))
    for each in reproduced:
        console.print(f"{each.name}: {each.sentence}", markup=False)
    console.print(f"Report: {out / 'report.html'}", markup=False, soft_wrap=True)
    if not all(claim.holds for each in reproduced for claim in each.claims):
        raise SystemExit(1)


def _run(names: tuple[str, ...], console: Console) -> list[Reproduced]:
    bar = Progress(
        SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=console, transient=True
    )
    with bar:
        tasks = {name: bar.add_task(name, total=None) for name in names}
        return reproduce(names, lambda name, text: bar.update(tasks[name], description=f"{name}: {text}"))
