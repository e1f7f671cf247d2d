"""Tables of quantities, and the base class of results, which have a short table, a plot and a DataFrame.

Results import neither matplotlib nor pandas.  Plots and frames are registered by type of result:
`plot/registry.py` registers those in the packages below `plot/`, the module of the result registers all others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from enum import Enum
from functools import singledispatch
from html import escape
from typing import Any, Final, NamedTuple, TypeAlias

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import ABSENT, DRAWN, USUAL, Quantity, Units, finite, form_unit, unit_name
from feeddrive.language.text import Text, marked, resolve


def visible(text: str) -> str:
    r"""Return the text with control characters escaped (`\x1b`), so that a terminal ignores them; keep line breaks."""
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() or letter == "\n" else ascii(letter)[1:-1] for letter in text)


class UnitOfRow(Enum):
    """A cell that shows the unit of the quantities in its row; the quantities are then shown without it."""

    UNIT = "unit"


UNIT: Final = UnitOfRow.UNIT
_LATEX = str.maketrans({"%": r"\%", "&": r"\&", "_": r"\_", "±": r"$\pm$", "½": r"\textonehalf{}", "^": ""})
Cell: TypeAlias = str | float | int | bool | Quantity | UnitOfRow | None


@dataclass(frozen=True)
class Column:
    """A column of a table.

    head       the title of the column, without unit
    unit       SI unit of its numbers, shown in the head; None for text and for quantities, which carry their own units
    form       digits and unit for display of its numbers, see `Quantity`
    sentences  True if its cells are sentences, which may be wrapped
    """

    head: str
    unit: str | None = None
    form: str = ""
    sentences: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "head", Text(self.head))

    def named(self) -> str:
        """Return the column head with the display unit of the numbers, as marked text."""
        name = "" if self.unit is None else unit_name(self.unit, form_unit(self.form))
        return f"{marked(self.head)} {name}".strip()

    def cell(self, cell: Cell, *, bare: bool = False) -> str:
        """Return a cell as marked text; with `bare`, its unit is shown in another column."""
        match cell:
            case None:
                return str(ABSENT)
            case str() | UnitOfRow():
                return "" if isinstance(cell, UnitOfRow) else marked(cell)  # `UNIT` in a row without quantities
            # before int, of which bool is a subclass
            case bool():
                return "yes" if cell else "no"
            case int() if self.unit is None:
                return str(cell)
            case Quantity():
                bare = bare or self.unit is not None
                return f"{replace(cell, form=cell.form or self.form, bare=bare)}"
            case _:
                return f"{Quantity(float(cell), self.unit or '', form=self.form, bare=True)}"


class Grid(NamedTuple):
    """A table of text cells, either marked text or rendered in display units.

    sentences  index of the column whose text may be wrapped, if any
    """

    title: str
    heads: list[str]
    rows: list[list[str]]
    sentences: int | None = None

    def shown(self, units: Units) -> Grid:
        """Return the grid in the given display units."""

        def reading(text: str) -> str:
            return visible(resolve(text, units))

        rows = [[reading(cell) for cell in row] for row in self.rows]
        return Grid(reading(self.title), [reading(head) for head in self.heads], rows, self.sentences)

    def __str__(self) -> str:
        widths = [max(len(row[i]) for row in (self.heads, *self.rows)) for i in range(len(self.heads))]

        def line(cells: Sequence[str]) -> str:
            padded = [
                cell.ljust(width) if i in (0, self.sentences) else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(cells, widths, strict=True))
            ]
            return "  ".join(padded).rstrip()

        return "\n".join([self.title, line(self.heads), line(["-" * width for width in widths]), *map(line, self.rows)])

    def html(self) -> str:
        """Return the table as HTML."""
        heads = "".join(f"<th>{escape(head)}</th>" for head in self.heads)
        rows = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in self.rows)
        return f"<table><caption>{escape(self.title)}</caption><tr>{heads}</tr>{rows}</table>"

    def markdown(self) -> str:
        """Return the table in Markdown, preceded by its title as a sentence."""
        rows = [self.heads, ["---", *["--:"] * (len(self.heads) - 1)], *self.rows]
        return "\n".join([f"{self.title}.", "", *(f"| {' | '.join(row)} |" for row in rows)])

    def latex(self) -> str:
        """Return the table as a LaTeX tabular (booktabs), without its title."""

        def line(cells: Sequence[str]) -> str:
            return " & ".join(cell.translate(_LATEX) for cell in cells) + r" \\"

        head = rf"\begin{{tabular}}{{l{'r' * (len(self.heads) - 1)}}}"
        body = [line(self.heads), r"\midrule", *map(line, self.rows)]
        return "\n".join([head, r"\toprule", *body, r"\bottomrule", r"\end{tabular}"])


@dataclass(frozen=True)
class Table:
    """A table with numbers in SI units: `grid` renders it for people, `record` for programs.

        Table("Errors", [Column("law"), Column("RMS", "m"), Column("Ms", "1")], [["P-PI", 5.88e-6, 1.9]])

    A head may be a plain string instead of a `Column`. If rows have different units, one column holds quantities and
    another one holds the cell `UNIT`.

    sentences  index of a column whose cells are sentences, if no `Column` is marked as such
    """

    title: str
    columns: Sequence[Column | str]
    rows: Sequence[Sequence[Cell]]
    sentences: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "title", Text(self.title))
        object.__setattr__(self, "columns", [Text(head) if isinstance(head, str) else head for head in self.columns])
        rows = [[Text(cell) if isinstance(cell, str) else cell for cell in row] for row in self.rows]
        object.__setattr__(self, "rows", rows)
        if self.sentences is None:
            broken = next((i for i, column in enumerate(self.made_columns) if column.sentences), None)
            object.__setattr__(self, "sentences", broken)

    @property
    def heads(self) -> list[str]:
        """The column heads in the usual units."""
        return self.grid().heads

    def marked(self) -> Grid:
        """Return the table as marked text, for a page that can be shown in other units later."""
        columns = self.made_columns
        rows = [self._row(columns, row) for row in self.rows]
        return Grid(marked(self.title), [column.named() for column in columns], rows, self.sentences)

    def grid(self, units: Units = USUAL) -> Grid:
        """Return the table in the given display units."""
        return self.marked().shown(units)

    @property
    def made_columns(self) -> list[Column]:
        """The columns, with plain heads converted to `Column`."""
        return [Column(column) if isinstance(column, str) else column for column in self.columns]

    def _row(self, columns: Sequence[Column], row: Sequence[Cell]) -> list[str]:
        pairs = list(zip(columns, row, strict=True))
        first = next(((column, cell) for column, cell in pairs if isinstance(cell, Quantity)), None)
        if UNIT not in row or first is None:
            return [column.cell(cell) for column, cell in pairs]
        column, quantity = first
        name = unit_name(quantity.unit, form_unit(quantity.form or column.form), stays=quantity.stays)
        return [name if cell is UNIT else column.cell(cell, bare=True) for column, cell in pairs]

    def record(self, units: Units = USUAL) -> dict[str, Any]:
        """Return the table as a JSON object: columns with units, cells in SI units; a quantity has value, unit and
        error.

        units  display units for the sentences in the table; they also determine whether SI units are linear or rotary
        """
        rows = [[_recorded(cell, row, units) for cell in row] for row in self.rows]
        heads = [
            {
                "head": resolve(marked(column.head), units),
                "unit": None if column.unit is None else units.name(column.unit, "SI"),
            }
            for column in self.made_columns
        ]
        return {"title": resolve(marked(self.title), units), "columns": heads, "rows": rows}

    def __str__(self) -> str:
        return str(self.grid())

    def html(self) -> str:
        """Return the table as HTML."""
        return self.grid().html()

    def _repr_html_(self) -> str:
        return self.html()


def _recorded(cell: Cell, row: Sequence[Cell], units: Units) -> Any:
    if isinstance(cell, Quantity):
        return cell.record() | {"unit": units.name(cell.unit, "SI", stays=cell.stays)}
    if cell is UNIT:
        return next((_recorded(other, row, units)["unit"] for other in row if isinstance(other, Quantity)), "")
    if isinstance(cell, str):
        return resolve(marked(cell), units)
    if cell is None or isinstance(cell, (bool, int)):
        return cell
    return finite(float(cell))


@singledispatch
def chart_of(result: Any) -> Any:
    """Return the chart of a result, a `plot.chart.Chart`; `chart_of.register(type)` registers a type of result."""
    raise ParameterError(f"{type(result).__name__} has no picture: print it, or draw its fields")


@singledispatch
def frame_of(result: Any) -> Any:
    """Return the pandas DataFrame of a result; `frame_of.register(type)` registers a type of result."""
    raise ParameterError(f"{type(result).__name__} has no DataFrame: print it, or take its fields")


@singledispatch
def report_of(result: Any) -> Any:
    """Return the `Report` of a result; `report_of.register(type)` registers a type of result."""
    raise ParameterError(f"{type(result).__name__} has no report: the outcome of its command has one")


READER: ContextVar[Units] = ContextVar("READER", default=DRAWN)
"""The display units in which a picture is drawn, since the drawing functions have no argument for them."""


@contextmanager
def drawn_in(units: Units) -> Generator[None]:
    """Draw all plots within this context in the given display units."""
    before = READER.set(units)
    try:
        yield
    finally:
        READER.reset(before)


_load_views: list[Callable[[type], object]] = []
_draw: list[Callable[[Any], Any]] = []


def views_from(load: Callable[[type], object], draw: Callable[[Any], Any]) -> None:
    """Set the function that registers chart, frame and report of a type of result, and the function that draws a chart.

    `load` is called before chart, frame and report are looked up.  The package `feeddrive` calls this once when it
    is imported, since `feeddrive.language` may not import the plotting code.
    """
    _load_views[:], _draw[:] = [load], [draw]


class Result(ABC):
    """The base class of results, which are displayed as their table in a terminal and in a notebook."""

    @abstractmethod
    def table(self) -> Table:
        """Return a short table of the result."""

    @property
    def rotary(self) -> bool:
        """True for a rotary axis: table and plot then use rad, N m and kg m2."""
        return False

    @property
    def reader(self) -> Units:
        """The units in which the result is displayed."""
        return Units(rotary=True) if self.rotary else USUAL

    def __repr__(self) -> str:
        return str(self.table().grid(self.reader))

    def _repr_html_(self) -> str:
        return self.table().grid(self.reader).html()

    def chart(self) -> Any:
        """Return the chart of this result, a `plot.chart.Chart`. Raises ParameterError if there is none."""
        for load in _load_views:
            load(type(self))
        return chart_of(self)

    def plot(self) -> Any:
        """Return the plot of this result, a matplotlib figure. Raises ParameterError if there is none."""
        chart = self.chart()
        with drawn_in(replace(self.reader, typographic=True)):
            return next(draw(chart) for draw in _draw)

    def has_picture(self) -> bool:
        """Return True if this type of result has a plot."""
        for load in _load_views:
            load(type(self))
        return chart_of.dispatch(type(self)) is not chart_of.dispatch(object)

    def report(self) -> Any:
        """Return the report of this result, a `report.Report`, which `report.html` writes as a page.

        Raises ParameterError if there is none.
        """
        for load in _load_views:
            load(type(self))
        return report_of(self)

    def to_pandas(self) -> Any:
        """Return the numbers of this result as a pandas DataFrame, in SI units.

        Raises MissingExtraError if pandas is not installed, ParameterError if this type of result has no DataFrame.
        """
        for load in _load_views:
            load(type(self))
        return frame_of(self)
