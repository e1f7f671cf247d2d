"""`feeddrive verify`: the equality proof of an export, on the user's machine."""

from __future__ import annotations

from pathlib import Path

import typer

from feeddrive.cli.terminal import open_console
from feeddrive.export.verify import MOST, verify
from feeddrive.files.atomic_io import write_whole
from feeddrive.language.errors import ParameterError


def perform(
    directory: Path, samples: int | None, seed: int, compiler: str | None, flags: tuple[str, ...], out: Path | None
) -> None:
    """Verify, show, write."""
    if samples is not None and not 1 <= samples <= MOST:
        raise ParameterError(f"--samples = {samples} must be from 1 to {MOST}")
    if seed < 0:
        raise ParameterError(f"--seed = {seed} must be a whole number >= 0")
    console = open_console()
    with console.status(f"verifying {directory}"):
        found = verify(directory, samples=samples, seed=seed, flags=flags, command=compiler)
    text = found.sentences()
    console.print(text, markup=False, soft_wrap=True)
    if out is not None:
        write_whole(out, text + "\n")
        console.print(f"Certificate: {out}", markup=False, soft_wrap=True)
    if not found.holds:
        raise typer.Exit(1)
