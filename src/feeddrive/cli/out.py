"""The option `--out` of all commands that write a directory: it is refused before the work, not after it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def _writable(out: Path | None) -> Path | None:
    """The directory itself. Raises FileError if it could not be replaced or made."""
    if out is not None:
        from feeddrive.files.atomic_io import check_directory

        check_directory(out)
    return out


Out = Annotated[
    Path | None,
    typer.Option(
        "--out", "-o", help="Directory to write; one that feeddrive wrote before is replaced.", show_default=False,
        callback=_writable,
    ),
]  # fmt: skip
