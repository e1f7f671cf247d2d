"""The view Program in a real browser: an example, all in view, one cursor, the tool turned, worst places, a cancel."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from conftest import Studio
from view_layout import APART, boxes, overlaps, unscrolled

SLOW = pytest.mark.slow(reason="a five-axis program that is planned and run on the page: 10 s")


@pytest.fixture(scope="module")
def five(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A page on which the example was planned and run."""
    made = Studio(browser, tmp_path_factory.mktemp("five"))
    opened = made.open(1280, 800)
    opened.go("program")
    opened.page.click("#program-example")
    assert opened.ended() == "done"
    opened.page.click("#program-run-now")
    assert opened.ended() == "done"
    yield opened
    made.close()


def seconds(page: Any) -> float:
    """The instant under the cursor."""
    return float(page.inner_text("#room-program output b").split(" s")[0])


def line(page: Any) -> int:
    """The line of the program under the cursor, as the text shows it."""
    return int(page.inner_text(".lines [aria-current] i"))


@pytest.mark.slow(reason="one more start of server and browser: 5 s")
def test_without_a_machine_an_example_is_shown_with_its_one_button(browser: Any, tmp_path: Any) -> None:
    made = Studio(browser, tmp_path / "studio")
    try:
        page = (opened := made.open(1280, 800)).page
        opened.go("program")
        page.wait_for_selector("#program-example:visible")
        assert page.locator("#room-program button.main:visible").count() == 1
        unscrolled(page)
        # the path and the tool are drawn: more than one color on the canvas
        inks = page.eval_on_selector(
            "#program-path canvas",
            """canvas => new Set(new Uint32Array(canvas.getContext('2d')
                .getImageData(0, 0, canvas.width, canvas.height).data.buffer)).size""",
        )
        assert inks > 2
        assert "example: s_curve.ngc" in page.get_attribute("#program-path canvas", "aria-label")
        assert opened.barriers() == []
        assert opened.said == []
    finally:
        made.close()


@SLOW
@pytest.mark.parametrize("size", [(1280, 800), (1920, 1080)])
def test_all_that_decides_is_in_view_without_scrolling(five: Any, size: tuple[int, int]) -> None:
    page = five.page
    page.set_viewport_size({"width": size[0], "height": size[1]})
    for _ in ("light", "dark"):
        page.click("#dark")
        five.settled()
        unscrolled(page, ".program .grid", ".program > .head", ".program .bar", ".program .cursor")
        for chosen in (".program .gauge", ".program > *", ".program > .head > *", ".program .cursor > *", *APART):
            assert overlaps(boxes(page, chosen)) == 0, chosen
        pictures = boxes(page, ".program .grid > figure")
        assert len(pictures) == 5
        area = boxes(page, ".program .grid")[0]
        covered = np.sum((pictures[:, 2] - pictures[:, 0]) * (pictures[:, 3] - pictures[:, 1]))
        assert covered == pytest.approx((area[2] - area[0]) * (area[3] - area[1]), rel=0.01)  # lines of a pixel
        # true scale: a unit is as long across as up, to a pixel over the picture
        left, top, right, bottom = boxes(page, "#program-place .u-over")[0]
        assert right - left == pytest.approx(bottom - top, abs=1.5)
        assert five.barriers() == []
    assert five.said == []


@SLOW
def test_one_cursor_in_text_path_and_pictures(five: Any) -> None:
    page = five.page
    row = page.locator("#program-worst button").nth(2)
    row.click()
    five.settled()
    wanted = int(re.search(r"line (\d+)", row.inner_text())[1])  # type: ignore[index]
    # at the end of a line the next one may have begun: a line of 0.1 mm takes a millisecond, as an instant of the path
    assert abs(line(page) - wanted) <= 1
    at = seconds(page)
    assert float(page.input_value("#program-time")) == pytest.approx(at, abs=5e-4)
    cursors = page.eval_on_selector_all(
        "#program-feed .u-cursor-x, #program-deviation .u-cursor-x, #program-axes .u-cursor-x",
        "all => all.map(each => new DOMMatrix(getComputedStyle(each).transform).e)",
    )
    assert min(cursors) > 0.0
    # from the text: the lines before and behind it
    page.focus(".program .lines")
    page.keyboard.press("ArrowDown")
    assert line(page) > wanted - 1
    assert seconds(page) >= at - 1e-3
    # from a picture: in the middle of the feed stands half of the cycle time
    content = page.locator("#program-feed .u-over").first
    box = content.bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.wait_for_timeout(100)
    cycle = float(page.inner_text("[data-figure=cycle] b"))
    assert seconds(page) == pytest.approx(0.5 * cycle, abs=0.01)  # a pixel is 10 ms
    # along time
    page.mouse.move(5, 5)
    page.select_option("#program-speed", "0.1")
    before = seconds(page)
    page.click("#program-play")
    page.wait_for_timeout(400)
    page.click("#program-play")
    assert before < seconds(page) < before + 0.5


@SLOW
def test_the_path_is_turned_by_mouse_and_keys_and_seen_again_as_at_first(five: Any) -> None:
    page = five.page
    content = "canvas => canvas.toDataURL()"
    canvas = page.locator("#program-path canvas")
    canvas.dblclick(position={"x": 4, "y": 4})
    page.wait_for_timeout(100)
    first = canvas.evaluate(content)
    canvas.focus()
    page.keyboard.press("ArrowLeft")
    page.wait_for_timeout(100)
    assert "seen from" in page.inner_text("#program-path .spoken")
    turned = canvas.evaluate(content)
    page.keyboard.press("0")
    page.wait_for_timeout(100)
    assert turned != first == canvas.evaluate(content)
    box = canvas.bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + 180, box["y"] + 40, steps=3)
    page.mouse.up()
    page.wait_for_timeout(100)
    assert canvas.evaluate(content) not in (first, turned)
    page.keyboard.press("Enter")
    assert page.locator(".program .grid > figure:visible").count() == 1
    page.keyboard.press("Escape")
    assert page.locator(".program .grid > figure:visible").count() == 5
    page.click("#program-color-feed")
    assert "below the feed" in page.inner_text("#program-path .legend")
    page.click("#program-color-now")
    assert "contour error" in page.inner_text("#program-path .legend")


@SLOW
def test_a_reload_shows_what_was_found(five: Any) -> None:
    page = five.page
    texts = page.locator("#program-worst button").all_inner_texts()
    page.reload()
    page.wait_for_selector("#program-worst button")
    assert page.url.endswith("#program")
    assert page.locator("#program-worst button").all_inner_texts() == texts
    page.set_viewport_size({"width": 768, "height": 1024})
    five.settled()
    assert page.evaluate("document.documentElement.scrollWidth") <= 768
    assert five.barriers() == []


_WATCH = """() => {
  const job = document.querySelector('#job');
  window.reports = [];
  new MutationObserver(() => window.reports.push([job.dataset.state, job.querySelector('span')?.innerText ?? '']))
    .observe(job, {attributes: true, childList: true, characterData: true, subtree: true});
}"""


@pytest.mark.slow(reason="a plan, and a run that is canceled: 6 s")
def test_a_part_program_moves_its_bar_and_is_canceled_amid_a_step(served: Any) -> None:
    """Once the server has heard the click, the step under way is reported, and that in which the work sees it."""
    page = (opened := served("mill", "--axis", "x").open()).page
    page.wait_for_selector("#verdict:not(:empty)")
    opened.go("program")
    page.select_option("#program-chosen", "circle_diamond_square.ngc")
    opened.settled()
    page.click("#program-plan-now")
    assert opened.ended() == "done"
    page.click("#program-run-now")
    seen = set[str]()
    begun = time.monotonic()
    while len(seen) < 3 and time.monotonic() - begun < 60.0:
        text = page.locator("#job span").first.inner_text()
        seen |= {re.sub(r" \(\d+ s\)$", "", text)}
        page.wait_for_timeout(20)
    assert len(seen) >= 3, seen
    assert page.get_attribute("#job", "data-state") == "running"
    page.evaluate(_WATCH)
    page.click("#cancel")
    page.locator("html:not([data-asked])").wait_for(state="attached")
    heard = page.evaluate("() => window.reports.length")
    page.wait_for_function("() => document.querySelector('#job').dataset.state === 'canceled'", timeout=60_000)
    reports = page.evaluate("() => window.reports")[heard:]
    assert {state for state, _ in reports} <= {"running", "canceled"}
    assert len({re.sub(r" \(\d+ s\)$", "", text) for state, text in reports if state == "running"}) <= 2, reports
    assert page.locator("#program-worst").count() == 0
