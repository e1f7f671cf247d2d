"""What the screen gets: boxes and broken lines on a terminal only; a pipe or a file gets every sentence on one line."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from typer.core import TyperCommand, TyperGroup

if TYPE_CHECKING:
    from rich.console import Console

UNBROKEN = 1_000_000
"""Columns of an output that is no terminal: wider than any sentence with its paths."""


def open_console() -> Console:
    """The standard output; as wide as the terminal, or without a margin where it is none (whatever COLUMNS says)."""
    from rich.console import Console  # not for `--help`

    return Console(highlight=False, width=None if sys.stdout.isatty() else UNBROKEN)


class Commands(TyperGroup):
    """The commands; their help and usage errors stand in boxes on a terminal, and as plain lines elsewhere."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command that the arguments name."""
        if not (sys.stdout.isatty() and sys.stderr.isatty()):
            extra["terminal_width"] = UNBROKEN
            for each in (self, *self.commands.values()):
                if isinstance(each, (TyperCommand, TyperGroup)):
                    each.rich_markup_mode = None
        return super().main(args, prog_name, complete_var, standalone_mode, windows_expand_args, **extra)
