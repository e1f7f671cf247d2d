"""A log identified on the page, on the command line and in Python, by the same statements of the same person.

What is stated are the options of `feeddrive identify`: values of the data sheet (`rated`, `motor_constant`,
`torque_constant`, `rotary`), and columns with their units (`position="x:mm"`). On the page they are the entries of
the rows that ask for them.
"""

from __future__ import annotations

import difflib
import html
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from feeddrive.cli.commands import app
from feeddrive.files.columns import Column
from feeddrive.language.errors import FeeddriveError, sentence
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Units
from feeddrive.language.text import resolve
from feeddrive.studio.server import FIELDS, Session
from feeddrive.workflow.identify import identify, tables
from studio_server import Served

ROLES = {
    "set_position": "setpoint_position",
    "position": "position_load",
    "set_angle": "setpoint_angle",
    "angle": "angle_motor",
    "force": "force",
    "torque": "torque",
    "time": "time",
}
"""The role that each option gives a column."""


@dataclass(frozen=True)
class Told:
    """All that an identification told a person.

    machine  the machine file: gains of the law, mass, friction with their errors, to the last digit; None if none
    report   the text of the report: roles and units of the columns, tables, remarks and verdict
    refused  the reason, if the log was refused
    """

    machine: str | None = None
    report: str = ""
    refused: str = ""


Ask = Callable[..., dict[str, Any]]
"""A request of the page, and what the server answers."""


def on_command_line(log: Path, out: Path, stated: Mapping[str, Any]) -> Told:
    """`feeddrive identify LOG ... --json`."""
    words = ["identify", str(log), "--json", "--out", str(out)]
    for name, value in stated.items():
        flag = f"--{name.replace('_', '-')}"
        words += [flag] if value is True else [flag, str(value)]
    done = CliRunner().invoke(app, words)
    assert done.exception is None or isinstance(done.exception, (SystemExit, FeeddriveError)), done.output
    said = json.loads(done.stdout)
    if said.get("error"):
        return Told(refused=_plain(said["error"]["message"], log))
    told = written(out, log)
    # what is printed is what the report says
    for told_ in (said["verdict"], *said["remarks"]):
        assert _squeezed(_plain(told_, log)) in _squeezed(told.report), told_
    return told


def in_python(log: Path, out: Path, stated: Mapping[str, Any]) -> Told:
    """`fd.identify(log, ...)`; what its result prints is in the report."""
    try:
        found = identify(log, out=out, **stated)
    except FeeddriveError as error:
        return Told(refused=_plain(str(error), log))
    told = written(out, log)
    units = Units(rotary=found.rotary)
    for said in (found.recommendation, *found.remarks):
        assert _squeezed(_plain(resolve(sentence(said), units), log)) in _squeezed(told.report), said
    assert tables(found)
    return told


def on_the_page(ask: Ask, folder: Path, log: Path, stated: Mapping[str, Any]) -> Told:
    """Open the uploaded log, enter in the rows what is stated, and press Identify.

    folder  the folder of the session
    """
    before = {*folder.rglob("identified_*")}
    try:
        shown = ask("import.look", names=[log.name]) and ask("import.show")
        wrong = next(file["wrong"] for file in shown["files"] if file["name"] == log.name)
        if wrong:
            return Told(refused=_plain(wrong, log))
        if "axis" in stated:
            ask("import.choose_axis", axis=stated["axis"])
        for option, role in ROLES.items():
            if option in stated:
                column = Column.of(stated[option])
                ask("import.role", column=column.name, role=role, unit=column.unit, factor=column.factor)
        row = _asks(ask("import.show")["columns"], stated)
        if row is not None:
            ask("import.scale", column=row["column"], signal=row["signal"], **_sheet(stated))
        ask("import.identify", rotary=bool(stated.get("rotary")))
    except RefusedError as error:
        return Told(refused=_plain(str(error), log))
    (out,) = {*folder.rglob("identified_*")} - before
    told = written(out, log)
    made = ask("import.show")["made"]
    for told_ in made["verdict"]:
        assert _squeezed(told_) in _squeezed(told.report), told_
    return told


def of_page(told: Told) -> Told:
    """The same as a page says it: fields in place of options."""
    if "feeddrive " in told.refused:
        return told
    fields = re.sub(
        r"--([a-z-]+)", lambda found: f"'{FIELDS.get(found[0]) or found[1].replace('-', ' ')}'", told.refused
    )
    return replace(told, refused=fields)


def assert_same(one: Told, other: Told) -> None:
    """Say the lines that differ, and not the whole report."""
    differ: list[str] = []
    for first, second in zip(map(str, astuple(one)), map(str, astuple(other)), strict=True):
        here, there = (text.replace(". ", ".\n").split("\n") for text in (first, second))
        differ += difflib.unified_diff(here, there, n=0)
    assert one == other, "\n".join(differ)[:4000]


class RefusedError(Exception):
    """What the page was told in place of an answer."""


def asking_here(session: Session, log: Path) -> Ask:
    """Ask the handlers of the studio, whose jobs run in this process."""
    session.desk.files[log.name] = log
    session.desk.start = lambda _room, _what, work, then, *_: then(work(Progress()))  # type: ignore[method-assign]

    def ask(do: str, **more: Any) -> dict[str, Any]:
        said = session.answer({"number": 1, "do": do, "name": log.name, **more})
        words: dict[str, Any] = json.loads(said[4 : 4 + int.from_bytes(said[:4], "little")])
        if words.get("error"):
            raise RefusedError(words["error"])
        return words

    return ask


def asking(served: Served, page: Any, log: Path) -> Ask:
    """Ask a running server through its socket, after the upload of the log."""
    assert served.upload(page.session, log.name, log.read_bytes()) == (200, {"name": log.name})

    def ask(do: str, **more: Any) -> dict[str, Any]:
        page.job = None
        said: dict[str, Any] = page.ask(do, name=log.name, **more)
        if said.get("error"):
            raise RefusedError(said["error"])
        if do in ("import.look", "import.identify"):
            ended = page.ended()
            if ended["state"] != "done":
                raise RefusedError(ended["error"])
        return said

    return ask


def _asks(rows: list[dict[str, Any]], stated: Mapping[str, Any]) -> dict[str, Any] | None:
    """The row that asks for a value of the data sheet: a force in percent or A; None if there is one in N already."""
    if not _sheet(stated):
        return None
    signals = {"percent", "per-mille"} if "rated" in stated else {"A"}
    by_role = {row["role"]: row for row in rows}
    for role in ("force", "torque", "current", "command"):
        row = by_role.get(role)
        if row is not None and not row["missing"] and role in ("force", "torque"):
            return None
        if row is not None and row["signal"] in signals:
            return row
    return None


def _sheet(stated: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a row that asks for values of the data sheet."""
    entered = {name: stated[name] for name in ("motor_constant", "torque_constant") if name in stated}
    if "rated" in stated:
        value, unit = re.fullmatch(r"([0-9.e+-]+):?(.+)", stated["rated"]).groups()  # type: ignore[union-attr]
        entered |= {"rated": float(value), "rated_unit": {"Nm": "N m"}.get(unit, unit)}
    return entered


def written(out: Path, log: Path) -> Told:
    """Machine file and report of an output directory."""
    machine = out / "machine.toml"
    page = (out / "report.html").read_text(encoding="utf-8")
    page = re.sub(r"(?s)<(style|script|svg)\b.*?</\1>|data:[^\"]*", "", page)
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))
    return Told(machine.read_text(encoding="utf-8") if machine.exists() else None, _plain(text, log))


def _plain(text: str, log: Path) -> str:
    """A text in which the log is called by its name, wherever it is stored."""
    text = re.sub(rf"[\w./+-]*/{re.escape(log.name)}", log.name, text)
    return re.sub(r"[\w./+-]*/(roles_)", r"\1", text)


def _squeezed(text: str) -> str:
    """A text without blanks and typographic signs, by which page, terminal and report differ."""
    text = html.unescape(text).translate(str.maketrans({"±": "+-", "²": "2", "·": "", "−": "-", "µ": "u", "μ": "u"}))
    return re.sub(r"[\s.]+", "", text)
