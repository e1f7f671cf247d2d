"""The base class of results: a short table in a terminal and in a notebook, a plot, a DataFrame.

Results import neither matplotlib nor pandas.  Plots and frames are registered by the type of the result: by
`plot/registry.py` for the packages below `plot/`, for the others in the module of the result.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from html import escape
from typing import Any

from feeddrive.language.errors import ParameterError
from feeddrive.language.units import turning, turning_text


def visible(text: str) -> str:
    r"""The text with control characters as `\x1b`, so that no name from a file obeys a terminal; line ends stay."""
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() or each == "\n" else ascii(each)[1:-1] for each in text)


@dataclass(frozen=True)
class Table:
    """Rows under column heads; the first column is text, the others are shown as given.

    sentences  index of a column whose cells are sentences: its lines may be broken
    """

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    sentences: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "title", visible(self.title))
        object.__setattr__(self, "heads", [visible(each) for each in self.heads])
        object.__setattr__(self, "rows", [[visible(cell) for cell in row] for row in self.rows])

    def __str__(self) -> str:
        widths = [max(len(row[i]) for row in (self.heads, *self.rows)) for i in range(len(self.heads))]

        def line(cells: Sequence[str]) -> str:
            padded = [
                cell.ljust(width) if i in (0, self.sentences) else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
            ]
            return "  ".join(padded).rstrip()

        return "\n".join([self.title, line(self.heads), line(["-" * width for width in widths]), *map(line, self.rows)])

    def turning(self, kept: Collection[str] = ()) -> Table:
        """The same of an axis that turns: in rad, N m and kg m2; `kept` is what a person wrote."""
        rows = [[turning_text(cell, kept) for cell in row] for row in self.rows]
        return replace(self, title=turning_text(self.title, kept), heads=[*map(turning_text, self.heads)], rows=rows)

    def html(self) -> str:
        """The table as HTML."""
        heads = "".join(f"<th>{escape(head)}</th>" for head in self.heads)
        rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in self.rows)
        return f"<table><caption>{escape(self.title)}</caption><tr>{heads}</tr>{rows}</table>"

    def _repr_html_(self) -> str:
        return self.html()


@singledispatch
def picture_of(result: Any) -> Any:
    """The matplotlib figure of a result; `picture_of.register(type)` says how a type of result is drawn."""
    raise ParameterError(f"{type(result).__name__} has no picture: print it, or draw its fields")


@singledispatch
def frame_of(result: Any) -> Any:
    """The pandas DataFrame of a result; `frame_of.register(type)` says what its rows and columns are."""
    raise ParameterError(f"{type(result).__name__} has no DataFrame: print it, or take its fields")


_load_views: list[Callable[[type], object]] = []


def views_from(load: Callable[[type], object]) -> None:
    """Set the function that registers plot and frame of a type of result; it is called before they are looked up.

    The package `feeddrive` calls this once when it is imported, since it stands above all rooms.
    """
    _load_views[:] = [load]


class Result(ABC):
    """Base of results: they show themselves as their table, in a terminal and in a notebook."""

    @abstractmethod
    def table(self) -> Table:
        """The short table."""

    @property
    def rotary(self) -> bool:
        """Whether it is about an axis that turns: table and picture then name rad, N m and kg m2."""
        return False

    @property
    def quoted(self) -> Sequence[str]:
        """Texts of a person that it shows as they are."""
        return ()

    def _shown(self) -> Table:
        return self.table().turning(self.quoted) if self.rotary else self.table()

    def __repr__(self) -> str:
        return str(self._shown())

    def _repr_html_(self) -> str:
        return self._shown().html()

    def plot(self) -> Any:
        """The picture of this type of result, a matplotlib figure. Raises ParameterError if it has none."""
        for load in _load_views:
            load(type(self))
        figure = picture_of(self)
        for text in figure.findobj(lambda each: hasattr(each, "set_text")) if self.rotary else ():
            text.set_text(turning_text(text.get_text(), self.quoted))
        return figure

    def to_pandas(self) -> Any:
        """The numbers of this result as a pandas DataFrame, in SI.

        Raises MissingExtraError without pandas, ParameterError if this type of result has none.
        """
        for load in _load_views:
            load(type(self))
        return frame_of(self)


# what people of this field want to read, by SI unit: shown unit and factor
_ALONG = {"m": ("um", 1e6), "m/s": ("mm/s", 1e3), "m/s2": ("m/s2", 1.0), "N": ("N", 1.0), "s": ("ms", 1e3)}
SHOWN = _ALONG | {turning(unit): (turning(name), factor) for unit, (name, factor) in _ALONG.items()}


def shown(unit: str) -> tuple[str, float]:
    """The unit in which a quantity is shown to people, and the factor to it from SI."""
    return SHOWN.get(unit, (unit, 1.0))
