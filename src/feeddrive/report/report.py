"""A report as a data structure: a verdict, the picture that illustrates it, and sections with all other contents.

    Report(
        "Will the cut chatter?", "feeddrive lobes", Verdict((Text(f"At {speed} it does not chatter."),), good=True),
        picture=Picture("lobes", "Depth without chatter", "Shaded: stable.", "Limits of the depth.", lobes_chart),
        sections=(Section("limits", "Limits", (table, Remarks(remarks))), Section("facts", "The cut", (Facts(facts),),
                  folded=True)),
    )

`page.html` writes it as HTML, and `Report.record` returns it for JSON.  Only these two format its numbers.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import USUAL, Units
from feeddrive.language.table import Grid, Table
from feeddrive.language.text import resolve
from feeddrive.plot.chart import Chart


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture whose chart is computed only when it is drawn.

    key      identifier, unique in its report
    caption  instructions for reading the picture
    alt      a text description for readers who cannot see the picture
    chart    the function that computes the chart
    """

    key: str
    title: str
    caption: str
    alt: str
    chart: Callable[[], Chart]


@dataclass(frozen=True, eq=False)
class Marked:
    """A table with highlighted cells or rows.

    best   for each column after the first, the row with the best cell; None if no cell is best
    alert  rows that need attention
    text   True if most cells are sentences
    """

    table: Table
    best: Sequence[int | None] = ()
    alert: Sequence[int] = ()
    text: bool = False


@dataclass(frozen=True)
class Facts:
    """An ordered list of named facts."""

    pairs: tuple[tuple[str, str], ...]

    def __init__(self, pairs: Mapping[str, str] | Iterable[tuple[str, str]]) -> None:
        # a tuple of pairs: a generator could be read once only, and a report is read by page, JSON and `is_empty`
        listed = pairs.items() if isinstance(pairs, Mapping) else pairs
        object.__setattr__(self, "pairs", tuple((name, text) for name, text in listed))


@dataclass(frozen=True)
class Remarks:
    """A list of sentences under a heading; an empty list is not shown.

    warns  True for warnings, which are highlighted
    """

    sentences: tuple[str, ...]
    head: str = "Remarks"
    warns: bool = True

    def __init__(self, sentences: Iterable[str], head: str = "Remarks", *, warns: bool = True) -> None:
        object.__setattr__(self, "sentences", tuple(sentences))
        object.__setattr__(self, "head", head)
        object.__setattr__(self, "warns", warns)


@dataclass(frozen=True)
class Code:
    """The text of a file, shown verbatim."""

    title: str
    text: str


Part: TypeAlias = Table | Grid | Marked | Picture | Facts | Remarks | Code | str


@dataclass(frozen=True, eq=False)
class Section:
    """A section of a report under a heading.

    key     identifier, unique in its report
    folded  True for details, which are collapsed until opened or printed
    file    name of another report in the same directory that the heading links to; empty if there is none
    """

    key: str
    title: str
    parts: Sequence[Part]
    folded: bool = False
    file: str = ""

    @property
    def pictures(self) -> Iterator[Picture]:
        """The pictures of the section, in order."""
        return (part for part in self.parts if isinstance(part, Picture))

    @property
    def is_empty(self) -> bool:
        """True if the section has no content."""
        return all(
            part == ""
            or (isinstance(part, Facts) and not part.pairs)
            or (isinstance(part, Remarks) and not part.sentences)
            for part in self.parts
        )


@dataclass(frozen=True)
class Verdict:
    """The outcome in sentences, the most important first.

    good  True if the result may be used, False if not; None if there is no judgment
    """

    sentences: tuple[str, ...]
    good: bool | None = None

    def __init__(self, sentences: Iterable[str], good: bool | None = None) -> None:
        object.__setattr__(self, "sentences", tuple(text for text in sentences if text))
        object.__setattr__(self, "good", good)


@dataclass(frozen=True, eq=False)
class Report:
    """A report: the verdict, the picture that illustrates it, tables, further pictures, and details.

    title     the title of the report
    command   the command that produces it, such as "feeddrive lobes"
    verdict   the outcome
    sections  the sections in order; empty ones are omitted, folded ones moved to the end
    picture   the picture that illustrates the verdict
    rotary    True for a rotary axis, whose quantities are in rad, N m and kg m2
    """

    title: str
    command: str
    verdict: Verdict
    sections: Sequence[Section] = ()
    picture: Picture | None = None
    rotary: bool = False

    def __post_init__(self) -> None:
        """Raise ParameterError if a key occurs twice, or if there are pictures but none for the verdict."""
        shown = [section for section in self.sections if not section.is_empty]
        # sorted is stable: folded details come last, all else keeps its order
        object.__setattr__(self, "sections", tuple(sorted(shown, key=lambda section: section.folded)))
        first = next((picture for section in self.sections for picture in section.pictures), None)
        if first is not None and self.picture is None:
            raise ParameterError(
                f"report '{self.title}': the picture '{first.key}' stands in a section, and none shows"
                " the verdict: name one as `picture`"
            )
        keys = [section.key for section in self.sections]
        pictures = [picture.key for picture in self.pictures]
        # a section and a picture may share a key: in the page the identifiers of pictures begin with `figure-`
        for key in (*keys, *pictures):
            if keys.count(key) > 1 or pictures.count(key) > 1:
                raise ParameterError(f"report '{self.title}': the key '{key}' is used twice")

    @property
    def pictures(self) -> list[Picture]:
        """All pictures, with the verdict's picture first."""
        listed = [picture for section in self.sections for picture in section.pictures]
        return listed if self.picture is None else [self.picture, *listed]

    def record(self, units: Units = USUAL, *, rendered: bool = False) -> dict[str, Any]:
        """Return the report for JSON: tables in SI with units, sentences as text, pictures by key.

        units     units of the sentences
        rendered  True to format the tables too, as strings in these units
        """

        def resolved(text: str) -> str:
            return str(resolve(text, units))

        return {
            "title": resolved(self.title),
            "command": self.command,
            "verdict": {"sentences": [resolved(text) for text in self.verdict.sentences], "good": self.verdict.good},
            "picture": None if self.picture is None else _recorded(self.picture, units, rendered),
            "sections": [
                {
                    "key": section.key,
                    "title": resolved(section.title),
                    "folded": section.folded,
                    "parts": [_recorded(part, units, rendered) for part in section.parts],
                }
                for section in self.sections
            ],
        }


def _recorded(part: Part, units: Units, rendered: bool) -> dict[str, Any]:
    def resolved(text: str) -> str:
        return str(resolve(text, units))

    match part:
        case Table() if rendered:
            return _recorded(part.grid(units), units, rendered)
        case Table():
            return {"kind": "table", **part.record(units)}
        case Grid():
            return {"kind": "grid", **part.shown(units)._asdict()}
        case Marked():
            table = _recorded(part.table, units, rendered)
            return {**table, "best": list(part.best), "alert": list(part.alert)}
        case Picture():
            texts = {"title": resolved(part.title), "caption": resolved(part.caption), "alt": resolved(part.alt)}
            return {"kind": "picture", "key": part.key, **texts}
        case Facts():
            return {"kind": "facts", "pairs": [[resolved(name), resolved(text)] for name, text in part.pairs]}
        case Remarks():
            sentences = [resolved(text) for text in part.sentences]
            return {"kind": "remarks", "head": resolved(part.head), "warns": part.warns, "sentences": sentences}
        case Code():
            return {"kind": "code", "title": resolved(part.title), "text": part.text}
        case str():
            return {"kind": "text", "text": resolved(part)}


def titled(table: Table, title: str) -> Table:
    """Return a table with another title."""
    return replace(table, title=title)


def further(pictures: Iterable[Picture]) -> Section:
    """Return a section that holds further pictures, to be placed after the tables."""
    return Section("pictures", "Pictures", tuple(pictures))


def facts(title: str, pairs: Mapping[str, str] | Iterable[tuple[str, str]], *parts: Part) -> Section:
    """Return a folded section with facts about the run, the measurement or the design."""
    return Section("facts", title, (Facts(pairs), *parts), folded=True)
