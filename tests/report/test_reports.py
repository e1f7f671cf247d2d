"""A report is a value: nothing outside of its room knows HTML, and each begins with its verdict and its picture."""

from __future__ import annotations

import ast
import json
import pickle
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, Units
from feeddrive.language.table import Column, Result, Table, chart_of, report_of
from feeddrive.language.text import Text
from feeddrive.plot.chart import Chart, Curve, Panel
from feeddrive.report import Code, Facts, Marked, Picture, Remarks, Report, Section, Verdict, html
from feeddrive.workflow.certify import CertifyRequest, certify
from feeddrive.workflow.circle import CircleRequest, circle
from feeddrive.workflow.command import Outcome
from feeddrive.workflow.excite import ExciteRequest, excite
from feeddrive.workflow.lobes import LobesRequest, lobes
from feeddrive.workflow.plan import PlanRequest, plan
from feeddrive.workflow.reports import REPORTS
from feeddrive.workflow.run_job import RunRequest, run

SOURCE = Path(feeddrive.__file__).parent
TAG = re.compile(
    r"</?(section|p|h[1-6]|div|figure|figcaption|ul|ol|li|dl|dt|dd|details|summary|table|thead|tbody|tr|td|th|caption|svg"
    r"|span|a|pre|html|head|body|main|nav|header|b|i|em|strong)\b[^>]*>"
)
# a table in a notebook, and the two pages of the studio before it is open: its password, and its address
OTHERS = {"language/table.py", "studio/command.py", "studio/protection.py"}
KEEPS_QUANTITIES = True  # in the f-strings of this module


def texts(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """All texts of a file but docstrings, with their lines."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    own = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, documented) and node.body and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in own:
            yield node.lineno, node.value


def test_no_file_outside_of_the_room_of_reports_holds_html() -> None:
    found = [
        f"{name}:{line}: {text.strip()[:60]}"
        for path in sorted(SOURCE.rglob("*.py"))
        if (name := path.relative_to(SOURCE).as_posix()) not in OTHERS and not name.startswith("report/")
        # only files with a tag somewhere are parsed: a syntax tree of all sources takes seconds
        if TAG.search(source := path.read_text(encoding="utf-8"))
        for line, text in texts(ast.parse(source))
        if TAG.search(text)
    ]
    assert found == []
    using = [
        path.relative_to(SOURCE).as_posix()
        for path in SOURCE.rglob("*.py")
        if re.search(r"from html import|markupsafe", path.read_text(encoding="utf-8"))
    ]
    assert {name for name in using if not name.startswith("report/")} <= {*OTHERS, "language/text.py"}


def test_there_is_one_template() -> None:
    assert [path.name for path in (SOURCE / "report").rglob("*.html")] == ["report.html"]


@dataclass(frozen=True, eq=False, repr=False)
class Weighed(Result):
    """A result of somebody's own, with no line of HTML."""

    mass: float

    def table(self) -> Table:
        return Table("A <mass>", [Column("body"), Column("mass", "kg")], [["table", self.mass]])


def drawn() -> Chart:
    x = np.linspace(0.0, 1.0, 5)
    return Chart("time (s)", (Panel("mass (kg)", (Curve(x, x, "it"),)),))


@report_of.register
def _report(result: Weighed) -> Report:
    picture = Picture("mass", "The mass", "A line is a line.", "A line from 0 to 1.", drawn)
    mass = Quantity(result.mass, "kg")
    return Report(
        "A mass",
        "weigh",
        Verdict((Text(f"It weighs {mass}."),), good=True),
        (
            Section("facts", "How", (Facts({"Scale": "a good one"}),), folded=True),
            Section("result", "Result", (result.table(), Remarks(["It is <heavy>."]), "Words.", Code("Text", "a < b"))),
            Section("empty", "Nothing", (Remarks([]), "")),
        ),
        picture,
    )


@chart_of.register
def _chart(result: Weighed) -> Chart:
    return Chart("time (s)", (Panel(f"{result.mass} kg"),))


def places(page: str) -> dict[str, int]:
    """Where the verdict, the first picture, the first table and the first folded section begin."""
    starts = {"verdict": '<div class="lead', "picture": "<figure", "table": "<table", "details": "<details"}
    return {name: page.find(start) for name, start in starts.items()}


def test_the_page_of_a_new_result_needs_no_html() -> None:
    report = Weighed(12.5).report()
    page = html(report)
    there = places(page)
    assert min(there.values()) > 0
    assert list(there.values()) == sorted(there.values())
    assert "It weighs 12.5 kg." in page
    assert "A &lt;mass&gt;." in page  # a title is a sentence under its table
    assert "It is &lt;heavy&gt;." in page
    assert '<div class="lead good">' in page
    assert "Nothing" not in page  # sections without content are left out
    assert html(report) == page
    assert html(report, Units(rotary=True)) != page  # it is read in the units of the reader


def test_an_outcome_has_a_report_without_a_builder() -> None:
    outcome = Outcome(Weighed(3.0), [Weighed(3.0).table()], ["A remark."], "Take it.", details=["A detail."])
    report = outcome.report()
    assert report.verdict.sentences == ("Take it.",)
    assert report.verdict.good is True
    assert report.picture is not None
    assert report.picture.chart().panels[0].label == "3.0 kg"
    assert [section.key for section in report.sections] == ["result", "details"]
    assert report.sections[1].folded
    bare = Outcome(object(), verdict="Nothing to see.").report()
    assert bare.picture is None
    assert "Nothing to see." in html(bare)


def test_a_report_with_pictures_says_which_shows_the_verdict() -> None:
    picture = Picture("a", "A", "", "A line.", drawn)
    with pytest.raises(ParameterError, match="none shows the verdict"):
        Report("x", "x", Verdict(("x",)), (Section("s", "S", (picture,)),))
    with pytest.raises(ParameterError, match="'a' is used twice"):
        Report("x", "x", Verdict(("x",)), (Section("s", "S", (picture,)),), picture)
    with pytest.raises(ParameterError, match="has no report"):
        TableOnly().report()


class TableOnly(Result):
    def table(self) -> Table:
        return Table("", [], [])


def test_marks_of_a_table_stand_out() -> None:
    table = Table("T", ["law", Column("a", "m"), Column("b", "m")], [["one", 1e-6, 2e-6], ["two", 2e-6, 1e-6]])
    report = Report("T", "x", Verdict(("x",)), (Section("s", "S", (Marked(table, best=(0, None), alert=(1,)),)),))
    page = html(report)
    assert page.count('class="best"') == 1
    assert re.search(r'<td class="best">1</td><td>2</td>', page)
    assert re.search(r'<tr class="broken"><th scope="row">two', page)


@pytest.mark.parametrize("name", sorted(REPORTS))
def test_each_type_that_is_listed_exists_with_the_function_that_reports_it(name: str) -> None:
    module, kind = name.split(":")
    assert hasattr(import_module(f"feeddrive.{module}"), kind)
    module, function = REPORTS[name].split(":")
    assert callable(getattr(import_module(f"feeddrive.{module}"), function))


PROGRAM = "G21 G90 G94\nG1 X10 Y5 F3000\nG1 X0\nM2\n"


def planned(folder: Path) -> Outcome[Any]:
    (folder / "p.ngc").write_text(PROGRAM, encoding="utf-8")
    return plan.run(PlanRequest(folder / "p.ngc", machine="xy_table"))


COMMANDS: dict[str, Callable[[Path], Outcome[Any]]] = {
    "run": lambda _: run.run(RunRequest("emps")),
    "circle": lambda _: circle.run(CircleRequest((Path("xy_table"),))),
    "plan": planned,
    "certify": lambda _: certify.run(CertifyRequest("emps")),
    "excite": lambda _: excite.run(ExciteRequest("emps", band="5..200", amplitude=20.0)),
    "lobes": lambda _: lobes.run(LobesRequest("slot", mode=("922:0.011:0.04",), rigid=True, speeds="4000:8000:5")),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_has_its_report_without_writing_a_file(name: str, tmp_path: Path) -> None:
    outcome = COMMANDS[name](tmp_path)
    report = outcome.report()
    assert report.verdict.sentences
    assert report.picture is not None
    assert report.command == f"feeddrive {name}"
    assert not report.sections[0].folded
    assert report.sections[-1].folded
    folded = [section.folded for section in report.sections]
    assert folded == sorted(folded)
    record = report.record(outcome.units)
    assert json.loads(json.dumps(record)) == record
    assert record["verdict"]["sentences"] == [Text(text).shown(outcome.units) for text in report.verdict.sentences]
    pickle.dumps(outcome.page)
    assert outcome.result.report().title == report.title
