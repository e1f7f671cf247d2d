"""`feeddrive export`: from a machine file to what a target runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from feeddrive.cli.terminal import open_console
from feeddrive.export.targets import write_export


def perform(source: str, target: str, out: Path | None, **options: Any) -> None:
    """Write, and say where."""
    design, readme = write_export(source, target, out, **options)
    console = open_console()
    said = f"{design.title}; for the target {target}, every {design.period}"
    console.print(said, markup=False, soft_wrap=True)
    for remark in design.remarks:
        console.print(f"- Note: {remark}", markup=False, soft_wrap=True)
    console.print(f"Read first: {readme}", markup=False, soft_wrap=True)
