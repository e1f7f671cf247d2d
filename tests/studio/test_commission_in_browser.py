"""The room Commission in a real browser: a virtual drive, its questions, a second tab, and what is shown in the end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from small_axis import MACHINE
from view_layout import boxes, overlaps, unscrolled

LONG = 600e3  # ms, for a computer that is busy with other work


def in_view(opened: Any, filled: str) -> None:
    """At both sizes nothing is scrolled away, nothing overlaps, and one button is filled."""
    page = opened.page
    for width, height in ((1920, 1080), (1280, 800)):
        page.set_viewport_size({"width": width, "height": height})
        opened.settled()
        unscrolled(page, ".commission", ".commission .steps", ".commission .evidence")
        for chosen in (
            ".commission > *",
            ".commission > .head > *",
            ".commission .limits > *, #commission-stop",
            "#commission-steps > li",
            ".commission .evidence > *",
            ".commission .about > *",
        ):
            assert overlaps(boxes(page, chosen)) == 0, chosen
        # what moves, how far, how fast, how hard, and the stop, are all in the window
        safety = boxes(page, ".commission .limits > *, #commission-stop")
        assert len(safety) == 6
        assert np.all(safety[:, :2] >= 0.0)
        assert np.all(safety[:, 2:] <= (width + 0.5, height))
        assert page.locator("#room-commission button.main:visible").all_inner_texts() == [filled]


def test_a_person_answers_on_the_page_and_another_tab_cannot(served: Any, tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(MACHINE, encoding="utf-8")
    studio = served(str(tmp_path / "small.toml"))
    opened = studio.open(1280, 800)
    page = opened.page
    opened.go("commission")
    page.select_option("#commission-source", "the axis of this page")
    opened.settled()
    assert page.locator("#commission-stop").is_disabled()
    in_view(opened, filled="Begin")
    page.click("#commission-start")
    page.wait_for_selector("#commission-answer-yes:enabled", timeout=LONG)
    in_view(opened, filled="Yes")
    assert page.locator("#commission-stop").is_enabled()
    assert page.inner_text("#commission-asked").startswith("Small move: the drive's own control moves the axis by")
    assert page.get_attribute("#commission-steps li:nth-child(1)", "data-state") == "done"
    assert page.inner_text("#commission-steps [aria-current=step] strong") == "Small move"
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
    # the step that was not confirmed is refused, and says why and how it was undone
    assert page.get_attribute("#commission-steps li:nth-child(4)", "data-state") == "refused"
    in_view(opened, filled="Go on")
    page.click("#commission-step-small_move")
    opened.settled()
    cards = page.locator(".commission .cards dt").all_inner_texts()
    assert {"holding force", "friction", "mass, roughly"} <= set(cards)
    assert "written back" in page.inner_text(".commission .told")
    page.click("#commission-step-friction_and_mass")
    opened.settled()
    said = page.inner_text(".commission .evidence")
    assert "The control before stays in place" in said
    assert "was not confirmed" in said
    assert [page.inner_text("#commission-start"), page.inner_text("#commission-anew")] == ["Go on", "Begin anew"]
    assert opened.barriers() == []
    assert opened.said == []
