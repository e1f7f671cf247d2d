"""A short table: how every result shows itself in a terminal and in a notebook."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True)
class Table:
    """Rows under column heads; the first column is text, the others are shown as given."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]

    def __str__(self) -> str:
        widths = [max(len(row[i]) for row in (self.heads, *self.rows)) for i in range(len(self.heads))]

        def line(cells: Sequence[str]) -> str:
            padded = [
                cell.ljust(width) if i == 0 else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
            ]
            return "  ".join(padded).rstrip()

        return "\n".join([self.title, line(self.heads), line(["-" * width for width in widths]), *map(line, self.rows)])

    def html(self) -> str:
        """The table as HTML."""
        heads = "".join(f"<th>{escape(head)}</th>" for head in self.heads)
        rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in self.rows)
        return f"<table><caption>{escape(self.title)}</caption><tr>{heads}</tr>{rows}</table>"

    def _repr_html_(self) -> str:
        return self.html()


class Result(ABC):
    """Base of results: they show themselves as their table, in a terminal and in a notebook."""

    @abstractmethod
    def table(self) -> Table:
        """The short table."""

    def __repr__(self) -> str:
        return str(self.table())

    def _repr_html_(self) -> str:
        return self.table().html()


# what people of this field want to read, by SI unit: shown unit and factor
SHOWN = {"m": ("um", 1e6), "m/s": ("mm/s", 1e3), "m/s2": ("m/s2", 1.0), "N": ("N", 1.0), "s": ("ms", 1e3)}


def shown(unit: str) -> tuple[str, float]:
    """The unit in which a quantity is shown to people, and the factor to it from SI."""
    return SHOWN.get(unit, (unit, 1.0))
