"""Work stays: when the server dies, beside another page, and in a queue; places of the page are found by keys."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from studio_server import needs_proc


def number(page: Any, name: str) -> float:
    return float(page.input_value(f"[id='number-{name}']"))


def enter(opened: Any, name: str, value: str) -> None:
    opened.page.fill(f"[id='number-{name}']", value)
    opened.page.keyboard.press("Enter")
    opened.settled()


@pytest.fixture
def opened(studio: Any) -> Iterator[Any]:
    found = studio.open(1280, 800)
    found.page.wait_for_selector("#verdict:not(:empty)")
    yield found
    found.context.close()


@needs_proc
@pytest.mark.slow(reason="two servers, of which one is killed in the middle of a job")
def test_a_server_that_is_killed_loses_nothing_and_the_page_comes_back(
    served: Callable[..., Any], browser: Any, tmp_path: Path
) -> None:
    """kill -9 in the middle of a search; the page says so, keeps what is typed, and goes on with the next server."""
    first = served("xy_table", "--axis", "x")
    page = (opened := first.open()).page
    page.wait_for_selector("#verdict:not(:empty)")
    enter(opened, "law.Kv", "41")
    page.click("#keep")
    enter(opened, "law.Kv", "43")
    history = page.inner_text("#history")
    opened.go("goal")
    page.click("#tune-start")
    page.wait_for_selector("#job[data-state=running]")
    opened.go("compare")
    page.click("#compare-start")
    page.wait_for_selector("#works-open:has-text('1 waiting')")
    opened.go("tune")
    page.wait_for_timeout(2_000)  # it is written 1.5 s after a change at the latest
    first.server.kill()
    first.server.wait(20.0)
    page.wait_for_selector("#lost:has-text('Disconnected, trying again. What you type stays.')")
    page.fill("[id='number-law.Kp']", "12345")
    page.wait_for_selector("#lost:has-text('start feeddrive studio again with the same folder')", timeout=20_000)
    assert opened.barriers() == []
    again = type(first)(browser, first.folder)
    try:
        assert again.address == first.address
        page.wait_for_selector("#lost", state="hidden", timeout=20_000)
        opened.settled()
        assert page.evaluate("location.hash") == "#tune"
        assert page.input_value("[id='number-law.Kp']") == "12345"  # not yet sent
        page.keyboard.press("Enter")
        opened.settled()
        assert (number(page, "law.Kv"), number(page, "law.Kp")) == (43.0, 12345.0)
        page.keyboard.press("Control+z")
        opened.settled()
        assert page.inner_text("#history").endswith(history)
        assert page.locator("#take-A").count() == 1
        page.click("#works-open")
        offered = page.locator("#works-list li span").all_inner_texts()
        assert offered == ["Optimize optimize", "Compare compare the laws"]
        page.click("[aria-label='Discard: compare the laws']")
        page.click("[aria-label='Go on: optimize']")
        page.wait_for_selector("#job[data-state=running]")
        assert page.evaluate("location.hash") == "#goal"
        page.click("#cancel")
        assert opened.ended() == "canceled"
        # in another browser it is offered by its name
        other = again.open()
        other.page.wait_for_selector("section[aria-label='Earlier work'] button")
        other.page.click("section[aria-label='Earlier work'] button")
        other.page.wait_for_selector("#verdict:not(:empty)")
        assert number(other.page, "law.Kv") == 43.0
    finally:
        again.close()


def test_two_pages_of_one_work_show_what_the_other_does(opened: Any) -> None:
    page = opened.page
    with opened.context.expect_page() as made:
        page.evaluate("window.open('/')")  # it takes the name of the work along
    other = made.value
    other.wait_for_selector("#room-tune:not([hidden]) #verdict:not(:empty)")
    page.wait_for_selector("#pages:has-text('2 pages')")
    before = number(page, "law.Kv")
    enter(opened, "law.Kv", "41")
    field = "[id='number-law.Kv']"
    other.wait_for_function(f"() => document.querySelector(\"{field}\").value === '41'")
    # what is being typed on the other page stays, and counts once it is entered
    other.fill("[id='number-law.Kp']", "777")
    enter(opened, "law.Kv", "42")
    other.wait_for_function(f"() => document.querySelector(\"{field}\").value === '42'")
    assert other.input_value("[id='number-law.Kp']") == "777"
    other.keyboard.press("Enter")
    page.wait_for_function("() => document.querySelector(\"[id='number-law.Kp']\").value === '777'")
    assert "in another page" in page.inner_text("#history")
    for kept in ("42", "41", f"{before:g}"):
        page.keyboard.press("Control+z")
        opened.settled()
        assert number(page, "law.Kv") == float(kept)
    other.wait_for_function(f"() => document.querySelector(\"{field}\").value === '{before:g}'")
    other.close()
    page.wait_for_selector("#pages", state="hidden")
    assert opened.said == []


@pytest.mark.slow(reason="a comparison begins and a proof is made, in processes of their own")
def test_jobs_wait_where_it_can_be_seen_and_a_shape_says_how_each_view_stands(opened: Any) -> None:
    page = opened.page
    for room, start in (("compare", "#compare-start"), ("goal", "#tune-start"), ("prove", "#prove-certify")):
        opened.go(room)
        page.click(start)
    page.wait_for_selector("#works-open:has-text('2 waiting')")
    assert page.locator("#job").is_hidden()  # in its own view alone
    said = "[...document.querySelectorAll('.mark svg')].map((each) => each.getAttribute('aria-label'))"
    assert page.evaluate(said) == ["Optimize waits for its turn", "Compare runs", "Prove waits for its turn"]
    assert (
        len(set(page.locator(".mark svg path").evaluate_all("all => all.map((each) => each.getAttribute('d'))"))) == 2
    )
    page.keyboard.press("Tab")
    page.click("#works-open")
    assert opened.barriers() == []
    page.click("[aria-label='Sooner: prove stability']")
    opened.settled()
    assert page.locator("#works-list li span").all_inner_texts() == ["Prove prove stability", "Optimize optimize"]
    page.click("[aria-label='Remove: optimize']")
    opened.settled()
    page.keyboard.press("Escape")
    assert page.locator("#works-list").is_hidden()
    opened.go("compare")
    assert re.search(r"\(\d+ s", page.inner_text("#job"))
    page.click("#works-cancel")
    page.wait_for_selector(".mark svg[aria-label='Prove has a result']", timeout=60_000)
    assert page.locator("#works").is_hidden()
    opened.go("prove")
    page.wait_for_selector("#proof-certificate figure:visible")


def test_a_place_is_found_by_the_words_of_the_trade_and_by_keys_alone(opened: Any) -> None:
    page = opened.page
    focused = "document.activeElement.id || document.activeElement.dataset.figure"

    def find(words: str) -> str:
        page.keyboard.press("Control+k")
        page.keyboard.press("Control+a")
        page.keyboard.type(words)
        opened.settled()
        page.keyboard.press("Enter")
        opened.settled()
        return str(page.evaluate(focused))

    opened.go("take")
    assert find("GSV") == "number-law.Kv"
    assert page.evaluate("location.hash") == "#tune"
    assert find("rope snap error") == "rope_snap_ISE_root_m_per_N"
    assert find("largest ms") == "goal-field-max_ms"
    assert find("add a filter notch") == "add-kind"
    assert find("prove stability") == "prove-certify"
    page.keyboard.press("Control+k")
    page.keyboard.press("Control+a")
    page.keyboard.type("lag")
    page.wait_for_selector("#search-found li:has-text('Following error')")
    assert opened.barriers() == []
    page.keyboard.press("ArrowDown")
    chosen = page.locator("#search-found [aria-selected=true]")
    assert page.get_attribute("#search-field", "aria-activedescendant") == chosen.get_attribute("id")
    page.keyboard.press("Escape")
    assert find("pitch errors and backlash") == "search-text"  # is read in place
    assert "docs/how_to/machining.md" in page.inner_text("#search-text")
    page.keyboard.press("Escape")
    assert page.locator("#search").is_hidden()
    assert opened.said == []


@pytest.mark.slow(reason="one more start of the page, and a search that is canceled")
def test_the_keys_of_the_page(opened: Any) -> None:
    page = opened.page
    opened.go("tune")
    page.focus("#tab-tune")
    page.keyboard.press("l")  # the limit that decides
    page.wait_for_selector("#limit-editor:not([hidden])")
    assert "Ms" in page.inner_text("#limit-editor")
    page.keyboard.press("Escape")
    assert page.locator("#limit-editor").is_hidden()
    # Escape leaves a field as it was
    before = number(page, "law.Kv")
    page.fill("[id='number-law.Kv']", "99")
    page.keyboard.press("Escape")
    page.focus("#tab-tune")
    opened.settled()
    assert number(page, "law.Kv") == before
    count = page.locator("#numbers-filters .card").count()
    page.keyboard.press("n")
    page.wait_for_function(f"() => document.querySelectorAll('#numbers-filters .card').length === {count + 1}")
    card = page.locator("#numbers-filters .card").last
    card.focus()
    page.keyboard.press(" ")
    page.wait_for_selector(".card.off")
    assert page.locator("#numbers-filters .card").count() == count
    # Ctrl+Enter presses the filled button of a view
    opened.go("goal")
    page.keyboard.press("Control+Enter")
    page.wait_for_selector("#job[data-state=running]")
    page.focus("#tab-goal")
    page.keyboard.press("Escape")
    assert opened.ended() == "canceled"
    # letters and digits can be switched off
    page.keyboard.press("Control+k")
    page.uncheck("#letters")
    page.keyboard.press("Escape")
    page.focus("#tab-goal")
    page.keyboard.press("4")
    opened.settled()
    assert page.evaluate("location.hash") == "#goal"
    page.keyboard.press("Control+k")
    page.check("#letters")
    page.keyboard.press("Escape")
    page.focus("#tab-goal")
    page.keyboard.press("4")
    opened.settled()
    assert page.evaluate("location.hash") == "#tune"
