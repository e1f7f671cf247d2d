"""A bad judgment of a command on its own result is seen as one on the page."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.language.errors import sentence
from feeddrive.language.judgment import Judgment
from feeddrive.language.table import Table
from feeddrive.language.text import Text
from feeddrive.report.page import page_units
from feeddrive.report.report import Report, Verdict
from feeddrive.studio.works import shown
from feeddrive.workflow.certify import CertifyRequest
from feeddrive.workflow.command import Outcome


@pytest.mark.parametrize("judgment", Judgment, ids=lambda each: each.name)
def test_a_bad_outcome_is_never_without_a_word(judgment: Judgment) -> None:
    """A refused proof of an export said nothing that the page could show as bad."""
    words = shown(Outcome(None, ["a sentence"], judgment=judgment)).words
    assert words["bad"] == judgment.bad
    assert words["verdict"] == [sentence(judgment.says)]
    told = shown(Outcome(None, verdict="Do not.", judgment=judgment, failure="Why.")).words
    assert (told["verdict"], told["failure"]) == (["Do not.", "Why."], "")  # it is said once
    bare = shown(Outcome(None, judgment=judgment, page=partial(Report, "A report", "x", Verdict(())))).words
    assert bool(bare["failure"]) == judgment.bad


def test_the_page_shows_the_sections_of_the_report_in_its_units() -> None:
    outcome = fd.workflow.certify.run(CertifyRequest("rotary_table"))
    page, report = shown(outcome), outcome.report()
    units = page_units(rotary=True)
    assert page.words["verdict"] == [Text(text).shown(units) for text in report.verdict.sentences]
    assert [each["title"] for each in page.words["sections"]] == [each.title for each in report.sections]
    assert [each["folded"] for each in page.words["sections"]] == [each.folded for each in report.sections]
    table = outcome.tables[0]
    assert isinstance(table, Table)
    part = page.words["sections"][0]["parts"][0]
    assert (part["heads"], part["rows"]) == (table.grid(units).heads, table.grid(units).rows)
    assert [*page.charts] == [picture.key for picture in report.pictures]
    one = shown(outcome, ("discs",))  # the room draws the other one
    assert [*one.charts] == ["discs"]
    assert one.words["picture"] is None


def log(path: Path, other: float) -> Path:
    """A rigid axis of 120 kg with friction, and a force on it that is in no column."""
    t = 1e-3 * np.arange(6000)
    w = 2.0 * np.pi * 0.7
    x, v = 0.09 * np.sin(w * t), 0.09 * w * np.cos(w * t)
    force = -120.0 * w * w * x + 260.0 * v + 48.0 * np.sign(v) + other * np.sin(21.0 * t)
    force += 0.4 * np.random.default_rng(9).standard_normal(t.size)
    heads = "time_s,position_mm,force_N"
    np.savetxt(path, np.column_stack([t, 1e3 * x, force]), delimiter=",", fmt="%.9g", header=heads, comments="")
    return path


def colors(page: Any, selector: str) -> tuple[str, str]:
    """The color of a sentence, and that of the page."""
    return page.evaluate(
        "(at) => [document.querySelector(at), document.body].map((each) => getComputedStyle(each).color)", selector
    )


@pytest.mark.slow(reason="two fits and a tuning in a real browser; the words have a quick test")
def test_a_bad_judgment_is_red_on_the_page(served: Callable[..., Any], tmp_path: Path) -> None:
    opened = served().open()
    page = opened.page
    for name, other, verdict in (("good.csv", 0.0, "Use these values"), ("bad.csv", 70.0, "Do not tune on these")):
        page.set_input_files("#files", str(log(tmp_path / name, other)))
        assert opened.ended() == "done"
        page.click(f"#room-import li button:text-is('{name}')")
        page.click("#identify")
        page.wait_for_selector(f"#room-import .verdict:has-text('{verdict}')", timeout=60_000)
        color, usual = colors(page, "#room-import .verdict")
        assert (color != usual) == (other != 0.0)
    machine = tmp_path / "mine.toml"
    text = fd.read_machine("linear_motor").file.text
    text, changed = re.subn(r"(?m)^following_error_limit.*$", "following_error_limit_um = 0.01", text)
    assert changed == 1
    machine.write_text(text, encoding="utf-8")
    opened = served(str(machine)).open()  # a guard that trips in every proof
    page = opened.page
    opened.go("optimize")
    page.click("#tune-start")
    page.wait_for_selector("#room-optimize .verdict:has-text('Do not use this tuning')", timeout=120_000)
    color, usual = colors(page, "#room-optimize .verdict")
    assert color != usual
    assert page.inner_text("#optimize-accept") == "Use it all the same"
