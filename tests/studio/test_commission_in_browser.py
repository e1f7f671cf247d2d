"""The room Commission in a real browser: a virtual drive, its questions, a second tab, and what is shown in the end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from small_axis import MACHINE

LONG = 600e3  # ms, for a computer that is busy with other work


def test_a_person_answers_on_the_page_and_another_tab_cannot(served: Any, tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(MACHINE, encoding="utf-8")
    studio = served(str(tmp_path / "small.toml"))
    opened = studio.open(1280, 900)
    page = opened.page
    opened.go("commission")
    page.select_option("#commission-source", "the axis of this page")
    opened.settled()
    page.click("#commission-start")
    page.wait_for_selector("#commission-answer-yes:enabled", timeout=LONG)
    assert page.inner_text("#commission-asked").startswith("Small move: the drive's own control moves the axis by")
    assert page.get_attribute("#commission-steps li:nth-child(1)", "data-state") == "done"
    assert page.get_attribute("#commission-steps [aria-current=step] strong", "class") is None
    assert page.inner_text("#commission-steps [aria-current=step] strong") == "small move"
    assert opened.barriers() == []

    # a tab that was duplicated has the same session, and may look and stop
    second = opened.context.new_page()
    second.goto(studio.address)
    key = page.evaluate("sessionStorage.getItem('feeddrive session')")
    second.evaluate("key => sessionStorage.setItem('feeddrive session', key)", key)
    second.reload()
    second.click("#tab-commission")
    second.wait_for_selector("#commission-question .hint")
    assert second.inner_text("#commission-question .hint") == "Answer it in the tab that began this commissioning."
    assert second.locator("#commission-question button").count() == 0
    second.close()

    page.click("#commission-answer-yes")
    page.wait_for_selector("#commission-value", timeout=LONG)
    assert "The drive counts a move of" in page.inner_text("#commission-asked")
    page.fill("#commission-value", "much")
    page.keyboard.press("Enter")
    opened.settled()
    assert "value must be a number" in page.inner_text("#error")
    page.click("#commission-answer-none")
    page.wait_for_selector("#commission-answer-no:enabled", timeout=LONG)
    begins = "() => document.querySelector('#commission-asked')?.textContent.startsWith('Friction and mass')"
    page.wait_for_function(begins, timeout=LONG)
    opened.settled()
    page.click("#commission-answer-no")
    assert opened.ended(600.0) == "done"
    page.wait_for_selector("#commission-archive")
    assert page.locator("#commission-question").is_hidden()
    said = page.inner_text(".commission .evidence")
    assert "The control before stays in place" in said
    assert "was not confirmed" in said
    assert [page.inner_text("#commission-start"), page.inner_text("#commission-anew")] == ["Go on", "Begin anew"]
    assert opened.barriers() == []
    assert opened.said == []
