"""Search over the views, parameters, figures, actions, commands and documentation, by the words of the trade.

The index is made from what states these things: declarations, acts of the views, the registry of commands, the glossary
and the page of the trade's words, and the headings of the documentation.
"""

from __future__ import annotations

import inspect
import posixpath
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from feeddrive.export.targets import TARGETS
from feeddrive.language.errors import ParameterError
from feeddrive.language.text import plain
from feeddrive.studio.desk import Asked, Room, Said, look
from feeddrive.studio.pictures import PICTURES
from feeddrive.studio.rooms.goal import FIELDS, WORDS
from feeddrive.studio.strip import GAUGES
from feeddrive.tuning.filters import filter_kinds
from feeddrive.workflow.command import COMMANDS, fields_of, load

_PAGE, _CLONE = Path(__file__).parents[1] / "page" / "docs", Path(__file__).parents[4]
_MOST = 12  # results
_COMMAND = "command:"  # before the name of a command in place of a page
_WORDS = "reference/words"  # the page of the words of the trade
_SHORTEST = 2  # characters of a word that is looked for
_PREFIX = 3  # characters from which the beginning of a word of the trade is enough
# of a word of a query: found in the title, in the description
_TITLE, _DETAIL = 3.0, 1.0
_ALIAS = 0.9  # share of what a word of the same meaning counts


@dataclass(frozen=True)
class Place:
    """Something that can be searched for, and where it is.

    kind     view, parameter, figure, limit, picture, action, command, word or documentation
    view     tab in which it is; empty: it is read
    element  CSS selector of what gets the focus there
    page, heading  the section of the documentation
    words    further words by which it is found
    """

    title: str
    kind: str
    detail: str = ""
    view: str = ""
    element: str = ""
    page: str = ""
    heading: str = ""
    words: str = ""


class _Section(NamedTuple):
    """A heading of a page with the text below it."""

    heading: str
    lines: tuple[str, ...]


@cache
def _tokens(text: str) -> tuple[str, ...]:
    return tuple(re.findall(r"[^\W_]+", text.casefold()))


@cache
def documents() -> Mapping[str, Path]:
    """Return the pages of the documentation by name: those of the installation, or of the clone."""
    root = _PAGE if _PAGE.is_dir() else _CLONE / "docs"
    pages = {path.relative_to(root).with_suffix("").as_posix(): path for path in sorted(root.rglob("*.md"))}
    glossary = _CLONE / "GLOSSARY.md"
    return {**pages, **({"GLOSSARY": glossary} if "GLOSSARY" not in pages and glossary.is_file() else {})}


@cache
def _sections(page: str) -> tuple[_Section, ...]:
    """Return the sections of a page; the title of the page is the first heading."""
    sections, code = [("", list[str]())], False
    for line in documents()[page].read_text(encoding="utf-8").splitlines():
        code ^= line.lstrip().startswith("```")
        head = None if code else re.match(r"#{1,4} +(.+)", line)
        if head:
            sections.append((_bare(head[1]), []))
        else:
            sections[-1][1].append(line)
    return tuple(_Section(heading, tuple(lines)) for heading, lines in sections if heading)


def _bare(text: str) -> str:
    """Return text of Markdown without its marks; links keep their words."""
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return plain(re.sub(r"[*`]|\{[^}]*\}", "", text).replace("\\|", "|")).strip()


class Called(NamedTuple):
    """A row of the page of words: what is said in the trade, the names here, and where it is explained."""

    words: tuple[str, ...]
    names: tuple[str, ...]
    meaning: str
    page: str
    heading: str


@cache
def trade_words() -> tuple[Called, ...]:
    """Return the words of the trade with the names here, from the tables of the page of words."""
    rows = list[Called]()
    for part in _sections(_WORDS) if _WORDS in documents() else ():
        for line in part.lines:
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            link = re.search(r"\]\(([^)#]*?)(?:\.md)?(?:#([^)]*))?\)", cells[-1]) if len(cells) == 3 else None
            if link is None:
                continue
            page = posixpath.normpath(posixpath.join(posixpath.dirname(_WORDS), link[1])).removeprefix("../")
            known = _sections(page) if page in documents() else ()
            heading = next((at.heading for at in known if _anchor(at.heading) == link[2]), "")
            words = tuple(word.strip() for word in _bare(cells[0]).split(","))
            names = tuple(re.findall(r"`([^`]+)`", cells[1]))
            rows.append(Called(words, names, _bare(cells[1]), page if known else "", heading))
    return tuple(rows)


def _anchor(heading: str) -> str:
    """Return the anchor that the documentation gives a heading."""
    return re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower())


@cache
def standing_places() -> tuple[Place, ...]:
    """Return what does not depend on the axis that is open."""
    return tuple(_standing())


def _standing() -> Iterator[Place]:
    from feeddrive.studio.rooms import ROOMS

    for room in ROOMS:
        # the page knows the title; what is done there is found by the words of its acts
        acts = [_first(getattr(room, name)) for name in dir(room) if room.is_act(name)]
        yield Place("", "view", _first(room), room.name, words=" ".join(acts))
    for gauge in GAUGES:
        yield Place(gauge.title, "figure", gauge.figure.description, "tune", f'[data-figure="{gauge.figure.key}"]')
    for name, field in FIELDS.items():
        label, meaning = WORDS.get(name, (name.replace("_", " "), field.declared.meaning))
        yield Place(label, "limit", meaning, "goal", f"#goal-field-{name}")
    for name, picture in PICTURES.items():
        yield Place(picture.title, "picture", "", "tune", f"#picture-{name}")
    for kind in filter_kinds():
        yield Place(f"Add a filter: {kind.replace('_', ' ')}", "action", "", "tune", "#add-kind")
    for target in TARGETS:
        yield Place(f"Export: {target}", "action", "", "take", f"#take-export-{target}")
    for name, listed in COMMANDS.items():
        yield Place(f"feeddrive {name}", "command", listed.summary, page=_COMMAND + name)
    for page in documents():
        title, *rest = _sections(page) or (_Section(page, ()),)
        yield Place(title.heading, "documentation", "", page=page)
        for part in rest:
            yield Place(part.heading, "documentation", title.heading, page=page, heading=part.heading)
    for row in trade_words():
        if row.page:
            yield Place(", ".join(row.words[:3]), "word", row.meaning, page=row.page, heading=row.heading)
    if "GLOSSARY" in documents():
        for part in _sections("GLOSSARY"):
            for line in part.lines:
                cells = [_bare(cell) for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
                if len(cells) >= 4 and line.startswith("| `"):
                    yield Place(cells[0], "word", cells[3], page="GLOSSARY", heading=part.heading)


def _first(what: Any) -> str:
    """Return the first paragraph of a docstring."""
    return " ".join((inspect.getdoc(what) or "").partition("\n\n")[0].split())


def _command_parts(name: str) -> list[dict[str, str]]:
    """Return what a command does, examples, and its options with their defaults."""
    listed, request = COMMANDS[name], load(name).request
    lines = "\n".join(f"feeddrive {name} {words}" for words in listed.examples)
    parts = [{"kind": "text", "text": listed.summary}, {"kind": "code", "text": lines}]
    for field in fields_of(request):
        unit, default = field.declared.unit, field.default
        usual = "" if field.required or default in (None, "", (), False) else f"default {default}"
        words = (field.flag or field.name.upper(), unit, field.declared.meaning, usual)
        parts.append({"kind": "row", "text": plain(" · ".join(filter(None, words)))})
    return [part for part in parts if part["text"]]


class Search(Room):
    """Search by words; it has no tab: its panel is shown above all tabs."""

    name = "search"

    @look
    def find(self, asked: Asked) -> Said:
        """Return the places that fit a text best."""
        text = asked.text("text")[:80]
        return Said(
            {"found": [asdict(replace(place, words="")) for place in found(text, self.places())], "sought": text}
        )

    @look
    def read(self, asked: Asked) -> Said:
        """Return a section of the documentation, or the beginning of a page."""
        page = asked.text("page")
        command = page.removeprefix(_COMMAND)
        if page.startswith(_COMMAND) and command in COMMANDS:
            title = f"feeddrive {command}"
            return Said({"reading": {"title": title, "page": "", "parts": _command_parts(command)}})
        if page not in documents():
            raise ParameterError(f"there is no page '{page:.60}' in the documentation")
        heading = asked.text("heading")
        sections = _sections(page)
        part = next((part for part in sections if part.heading == heading), sections[0])
        return Said({"reading": {"title": part.heading, "page": page, "parts": _paragraphs(part.lines)}})

    def places(self) -> list[Place]:
        """Return all places, first those of the axis that is open."""
        bench = self.desk.bench
        knobs = () if bench is None else bench.by_hand.knobs
        rotary = bench is not None and bench.rotary
        own = [
            Place(
                knob.name.rpartition(".")[2].replace("_", " "),
                "parameter",
                f"{knob.name}: {knob.declared.of_axis(rotary).meaning}",
                "tune",
                f'[id="number-{knob.name}"]',
            )
            for knob in knobs
        ]
        return [*own, *standing_places()]


def found(text: str, places: list[Place]) -> list[Place]:
    """Return the places that fit a text best, best first: those with all of its words or, without any, with some."""
    wanted = " ".join(_tokens(text))
    if len(wanted) < _SHORTEST:
        return []
    same, begun = list[str](), list[str]()
    for row in trade_words():
        words = [" ".join(_tokens(word)) for word in row.words]
        names = [*words, *(" ".join(_tokens(name)) for name in row.names)]
        same += names if wanted in words else []
        begun += names if len(wanted) >= _PREFIX and any(word.startswith(wanted) for word in words) else []
    # a word that is typed in part, and then a part of the words, count only where nothing fits
    for others, every in ((same, True), (begun, True), ([], False)):
        readings = [(wanted, 1.0), *((words, _ALIAS) for words in dict.fromkeys(others) if words)]
        rated = [(max(weight * _fit(words, place, every) for words, weight in readings), place) for place in places]
        order = sorted((pair for pair in rated if pair[0] > 0.0), key=lambda pair: (-pair[0], len(pair[1].title)))
        if order:
            break
    shown = dict[tuple[str, str, str], Place]()
    for _, place in order:
        shown.setdefault((place.title.casefold(), place.view, place.page), place)
    return list(shown.values())[:_MOST]


# what a person works with comes before what is read about it
_KINDS = {"parameter": 0.6, "figure": 0.5, "limit": 0.4, "picture": 0.4, "view": 0.3, "action": 0.3, "word": 0.1}


def _fit(wanted: str, place: Place, every: bool) -> float:
    """Return how well a place fits words; 0 if it has none of them or, with `every`, lacks one."""
    title, detail = _tokens(place.title), _tokens(f"{place.detail} {place.view} {place.words}")
    score = 0.0
    for word in wanted.split():
        if word in title:
            score += _TITLE
        elif any(token.startswith(word) for token in title):
            score += _TITLE - 0.5
        elif word in detail or (len(word) >= _PREFIX and any(token.startswith(word) for token in detail)):
            score += _DETAIL
        elif every:
            return 0.0
    if score == 0.0:
        return 0.0
    exact = 1.0 if " ".join(title) == wanted else 0.0
    return score / len(wanted.split()) + exact + _KINDS.get(place.kind, 0.0)


def _paragraphs(lines: tuple[str, ...]) -> list[dict[str, str]]:
    """Return text of Markdown as paragraphs, items and preformatted blocks, without marks."""
    parts, block, code = list[dict[str, str]](), list[str](), False

    def end(kind: str) -> None:
        text = "\n".join(block) if kind == "code" else _bare(" ".join(block))
        if text.strip():
            parts.append({"kind": kind, "text": plain(text)})
        block.clear()

    for line in lines:
        if line.lstrip().startswith("```"):
            end("code" if code else "text")
            code = not code
        elif code or (line.startswith("    ") and (not block or block[-1].startswith("    "))):
            block.append(line)
        elif line.startswith("|"):
            cells = [_bare(cell) for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            if not set("".join(cells)) <= set("-: "):
                parts.append({"kind": "row", "text": " · ".join(filter(None, cells))})
        else:
            if block and block[0].startswith("    "):
                end("code")
            if not line.strip() or re.match(r"\s*([-*]|\d+\.) ", line):
                end("text")
            if line.strip() and not line.startswith("!["):
                block.append(line)
    end("code" if code or (block and block[0].startswith("    ")) else "text")
    return parts
