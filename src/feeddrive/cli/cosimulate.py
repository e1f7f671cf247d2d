"""`feeddrive cosimulate`: the laws of a job against an FMU."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from feeddrive.cli.terminal import open_console
from feeddrive.cli.working import drawn
from feeddrive.cosimulation.comparison import cosimulate, write_cosimulation
from feeddrive.files.job import read_job
from feeddrive.language.errors import ParameterError


def perform(
    job: str, fmu: Path, names: Sequence[str], parameters: Sequence[str], dead_time: float, out: Path | None
) -> None:
    """Read the job, run it, show the table, and write the signals."""
    console = open_console()
    asked = read_job(job)
    values = {name: _number(name, text) for name, text in _pairs("--set", parameters).items()}
    with console.status("") as status:
        found = cosimulate(
            asked, fmu, names=_pairs("--variable", names), parameters=values, dead_time=dead_time,
            step=lambda law: status.update(law),
        )  # fmt: skip
    summary = write_cosimulation(found, out or Path("results") / f"cosimulate_{Path(job).stem}")
    console.print(drawn(found.table()))
    console.print("- No margins: an FMU states no linear model. `feeddrive run` gives those of the machine file.")
    console.print(f"Signals: {summary.parent / 'runs'}", markup=False, soft_wrap=True)


def _pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for text in texts:
        name, mark, value = text.partition("=")
        if not (mark and name and value) or name in found:
            raise ParameterError(f"{option} {text}: give each name once, as name=value")
        found[name] = value
    return found


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise ParameterError(f"--set {name}={text}: '{text}' is no number") from None
