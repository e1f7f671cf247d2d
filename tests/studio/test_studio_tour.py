"""The guided tour: each step names what is there, it goes on when its act is done, and stays over a reload."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from feeddrive.language.errors import ParameterError
from feeddrive.studio.command import StudioRequest
from feeddrive.studio.rooms import ROOMS
from feeddrive.studio.rooms.tour import STEPS
from feeddrive.studio.server import Session
from feeddrive.workflow.command import COMMANDS


def marked(page: Any) -> list[str]:
    """What is said to be next, as a screen reader finds it."""
    return [each.get_attribute("id") for each in page.query_selector_all("[aria-describedby=tour-text].tour-marked")]


def test_each_step_ends_with_an_act_or_a_command_that_there_is(tmp_path: Path) -> None:
    rooms = {each.name: each for each in ROOMS}
    for step in STEPS:
        assert step.room in rooms
        assert step.marked
        if step.act:
            room, _, act = step.act.partition(".")
            assert act == "show" or callable(getattr(rooms[room], act))
        if step.command:
            assert step.command in COMMANDS
        assert 1 <= step.text.count(". ") + 1 <= 2, step.title  # two sentences
    assert STEPS[-1].room == "export"


def test_next_back_and_leave(tmp_path: Path) -> None:
    session = Session(tmp_path)
    tour = session._tour
    assert tour.words is None
    tour.heard("import.tour")
    tour.heard("optimize.show")  # of a later step: nothing
    places = list[int]()
    for act in ("back", "next", "next", "back", "next", "next"):
        session.answer({"number": 1, "do": f"tour.{act}"})
        places.append(tour.words["number"])
    assert places == [1, 2, 3, 2, 3, 4]
    tour.heard("optimize.show")
    assert tour.words["number"] == 5
    session.answer({"number": 1, "do": "tour.leave"})
    assert tour.words is None


def test_a_tour_and_a_source_are_refused_together() -> None:
    with pytest.raises(ParameterError, match=r"--tour brings a log of its own: leave run\.csv out"):
        StudioRequest("run.csv", tour=True).check()


def test_the_tour_is_offered_on_an_empty_page_marks_what_is_next_and_stays_over_a_reload(
    served: Callable[..., Any],
) -> None:
    page = (opened := served().open()).page
    page.click("#import-tour")
    assert opened.ended() == "done"
    assert "step 1 of" in page.inner_text("#tour")
    assert not page.is_visible("#import-tour")
    assert page.locator("#columns-of-log tbody tr").count() == 5
    page.click("#tour-next")
    opened.settled()
    assert marked(page) == ["identify"]
    page.focus("#tour-back")
    page.click("#tour-show")
    assert page.evaluate("document.activeElement.id") == "identify"
    assert page.input_value("#import-machine") == "ball_screw"
    page.reload()
    page.wait_for_selector("#tour:not([hidden])")
    assert "step 2 of" in page.inner_text("#tour")
    page.click("#tab-optimize")
    opened.settled()
    page.click("#tour-show")  # leads back to the room of the step
    page.wait_for_selector("#identify:focus")
    page.click("#tour-leave")
    opened.settled()
    assert not page.is_visible("#tour")
    assert marked(page) == []
    assert opened.said == []


@pytest.mark.slow(reason="the whole tour: identification, a search and a proof; its parts have quick tests")
def test_the_tour_ends_with_an_exported_control(served: Callable[..., Any]) -> None:
    """Only what is marked is pressed, and a number is written that the text names."""
    page = (opened := served("--tour").open()).page
    for number, step in enumerate(STEPS, start=1):
        page.wait_for_selector(f"#tour-title:has-text('step {number} of {len(STEPS)}')", timeout=120e3)
        for each in step.marked:  # what a work makes is there at its end
            page.wait_for_selector(f"#{each}.tour-marked")
        opened.settled()
        assert set(marked(page)) == set(step.marked)
        if "optimize-field-max_compliance" in step.marked:
            assert "0.16" in step.text
            page.fill("#optimize-field-max_compliance", "6.25")
            page.keyboard.press("Tab")
        if step is STEPS[-1]:
            with page.expect_download() as waiting:
                page.click("#export-archive-c")
            assert waiting.value.suggested_filename == "export_c.zip"
        page.click(f"#{step.marked[-1]}")
    page.wait_for_selector("#tour", state="hidden")
    assert "feeddrive tour --out" in page.inner_text("#recipe-commands")
    assert opened.said == []
