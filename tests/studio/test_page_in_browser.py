"""The page in a real browser: what a person does in each room, and what the page may load."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pyarrow as arrow
import pytest
from pyarrow import parquet

from feeddrive.studio.server import PAGE

_LARGEST = 1_500_000  # bytes of the page: the bar of its issue
_ROOMS = ("import", "scope", "tune", "optimize", "compare", "prove", "export")


def test_the_page_is_small_and_loads_nothing_from_elsewhere(studio: Any) -> None:
    opened = studio.open()
    opened.page.wait_for_selector("#verdict:not(:empty)")
    own = urlsplit(studio.address).netloc
    assert all(urlsplit(each).netloc == own for each in opened.requests if not each.startswith(("data:", "blob:")))
    assert len(opened.requests) <= 10
    assert sum(each.stat().st_size for each in PAGE.iterdir()) <= _LARGEST
    assert opened.said == []


@pytest.mark.parametrize("look", ["light", "dark"])
def test_no_room_has_a_serious_violation_of_accessibility(studio: Any, look: str) -> None:
    opened = studio.open()
    opened.page.wait_for_selector("#verdict:not(:empty)")
    if look == "dark":
        opened.page.click("#dark")
    for room in _ROOMS:
        opened.go(room)
        assert opened.barriers() == [], room
    assert opened.said == []


def test_a_number_is_moved_by_slider_field_and_keyboard_and_undone(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("tune")
    page.wait_for_selector("#verdict:not(:empty)")
    before, words = page.input_value("[id='number-law.Kp']"), page.inner_text("#verdict")
    slider = page.locator("#numbers-list input[type=range]").nth(1)
    slider.focus()
    page.keyboard.press("ArrowRight")
    opened.settled()
    moved = page.input_value("[id='number-law.Kp']")
    assert float(moved) > float(before)
    assert page.inner_text("#verdict") != words
    page.fill("[id='number-law.Kp']", "-1")
    page.keyboard.press("Enter")
    opened.settled()
    assert "must be > 0" in page.inner_text("#error")
    page.keyboard.press("Control+z")
    opened.settled()
    assert page.inner_text("#verdict") == words


def test_a_reload_keeps_the_room_and_what_was_moved(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("tune")
    page.fill("[id='number-law.Kp']", "91000")
    page.keyboard.press("Enter")
    opened.settled()
    page.reload()
    page.wait_for_selector("#room-tune:not([hidden]) #verdict:not(:empty)")
    assert page.input_value("[id='number-law.Kp']") == "91000"
    other = studio.open()
    other.go("tune")
    assert other.page.input_value("[id='number-law.Kp']") != "91000"  # another page sees nothing of it


def test_a_work_that_is_killed_leaves_the_page_usable(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("compare")
    page.fill("#compare-starts", "20")  # it does not end by itself meanwhile
    page.click("#compare-start")
    page.wait_for_selector("#job[data-state=running]")
    begun = time.monotonic()
    # on a busy machine the process takes a while to begin
    while not (children := _children(studio.server.pid)) and time.monotonic() - begun < 20.0:
        page.wait_for_timeout(100)
    (child,) = children
    os.kill(child, signal.SIGKILL)
    assert opened.ended() == "failed"
    assert "it was killed, or memory ran out" in page.inner_text("#job")
    opened.go("prove")
    page.click("#prove-certify")
    assert opened.ended() == "done"
    assert page.locator("#proof-certificate figure:visible").count() == 2


def _children(parent: int) -> list[int]:
    """Processes that work for the server: not the one that keeps track of shared memory."""
    found = list[int]()
    for each in Path("/proc").glob("[0-9]*"):
        try:
            fields = (each / "stat").read_text(encoding="ascii").rpartition(")")[2].split()
            words = (each / "cmdline").read_bytes()
        except OSError:
            continue
        if int(fields[1]) == parent and b"spawn_main" in words:
            found.append(int(each.name))
    return found


def test_a_work_is_canceled(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("compare")
    page.click("#compare-start")
    page.wait_for_selector("#job[data-state=running]")
    page.click("#cancel")
    assert opened.ended() == "canceled"


def test_a_page_that_is_loaded_again_amid_a_work_shows_it_and_can_cancel_it(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("compare")
    page.fill("#compare-starts", "20")  # it does not end by itself meanwhile
    page.click("#compare-start")
    page.wait_for_selector("#job[data-state=running]")
    page.reload()
    page.wait_for_selector("#job[data-state=running]")
    opened.go("prove")
    page.click("#prove-certify")
    page.wait_for_selector("#error:has-text('is running: wait for its end, or cancel it')")
    page.click("#cancel")
    assert opened.ended() == "canceled"


def test_what_is_brought_is_shown_as_text_and_refused_with_what_to_do(studio: Any, tmp_path: Path) -> None:
    page = (opened := studio.open()).page
    opened.go("import")
    nasty = tmp_path / "run.parquet"
    names = ["t_s", "<img src=x onerror=alert(1)>", "\x1b[31mred"]
    parquet.write_table(arrow.table({name: 1e-3 * np.arange(200) for name in names}), nasty)
    empty = tmp_path / "part.ngc"
    empty.write_text("", encoding="utf-8")
    page.set_input_files("#files", [str(nasty), str(empty)])
    assert opened.ended() == "done"
    assert page.locator("main img[src=x]").count() == 0
    page.click("#room-import button:has-text('run.parquet')")
    opened.settled()
    assert names[1] in page.inner_text("#room-import")  # as text
    page.click("text=part.ngc >> nth=0")
    opened.settled()
    assert "is empty: a part program has lines" in page.inner_text("#room-import")
    assert opened.said == []


def test_a_picture_is_zoomed_and_its_cursor_stands_in_all_over_the_same_x(studio: Any) -> None:
    page = (opened := studio.open(1280, 1400)).page
    opened.go("tune")
    page.wait_for_selector("#verdict:not(:empty)")
    opened.settled()
    area = page.locator("#picture-sensitivity .u-over").first
    box = area.bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20)
    page.wait_for_timeout(100)
    readings = page.locator("#picture-sensitivity .readout, #picture-stiffness .readout, #picture-open_loop .readout")
    said = [each.splitlines() for each in readings.all_inner_texts()]
    assert len(said) == 5  # panels
    assert len({each[0] for each in said}) == 1, said  # one frequency
    assert all(each[1].startswith("today ") and each[2].startswith("now ") for each in said)
    middle = float(said[0][0])
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 22, steps=4)
    page.mouse.up()
    opened.settled()
    page.mouse.move(box["x"] + 1.0, box["y"] + 20)  # the left end is what was the middle
    page.wait_for_timeout(100)
    left = [float(each.splitlines()[0]) for each in readings.all_inner_texts()]
    assert left == pytest.approx([middle] * 5, rel=0.01)  # a pixel is 0.6 %
    surface = page.locator("#picture-stiffness .surface")
    surface.focus()
    page.keyboard.press("0")
    opened.settled()
    for _ in range(3):
        page.keyboard.press("Shift+ArrowRight")
    spoken = page.inner_text("#picture-stiffness .spoken")
    assert "today" in spoken
    page.mouse.move(box["x"] + 1.0, box["y"] + 20)
    page.wait_for_timeout(100)
    assert float(page.locator("#picture-sensitivity .readout").first.inner_text().splitlines()[0]) < 0.1 * middle
    assert opened.said == []


def test_two_fingers_zoom_a_picture_and_together_show_all(studio: Any) -> None:
    context = studio.admit(studio.browser.new_context(viewport={"width": 768, "height": 1024}, has_touch=True))
    page = context.new_page()
    page.goto(studio.address)
    page.click("#tab-tune")
    page.wait_for_selector("#verdict:not(:empty)")
    area = page.locator("#picture-sensitivity .u-over").first
    area.scroll_into_view_if_needed()
    page.wait_for_timeout(300)
    box = area.bounding_box()
    touch = context.new_cdp_session(page)

    def fingers(kind: str, *shares: float) -> None:
        points = [{"x": box["x"] + share * box["width"], "y": box["y"] + 30, "id": i} for i, share in enumerate(shares)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def reach() -> tuple[float, float]:
        found = list[float]()
        for share in (0.001, 0.999):
            page.mouse.move(box["x"] + share * box["width"], box["y"] + 30)
            page.wait_for_timeout(80)
            found.append(float(page.locator("#picture-sensitivity .readout").first.inner_text().splitlines()[0]))
        return found[0], found[1]

    low, high = whole = reach()
    fingers("touchStart", 0.4, 0.6)
    fingers("touchMove", 0.3, 0.7)
    fingers("touchMove", 0.2, 0.8)
    fingers("touchEnd")
    page.wait_for_timeout(500)
    # what was between 1/3 and 2/3 of the logarithmic axis; a pixel and a half of 680 is 2.4 %
    third = (high / low) ** (1.0 / 3.0)
    assert reach() == pytest.approx((low * third, high / third), rel=0.03)
    fingers("touchStart", 0.2, 0.8)
    fingers("touchMove", 0.4, 0.6)
    fingers("touchEnd")
    page.wait_for_timeout(500)
    assert reach() == pytest.approx(whole, rel=0.03)
    context.close()


@pytest.mark.parametrize("size", [(1280, 720), (768, 1024)])
def test_no_room_is_wider_than_the_screen(studio: Any, size: tuple[int, int]) -> None:
    opened = studio.open(*size)
    opened.page.wait_for_selector("#verdict:not(:empty)")
    for room in _ROOMS:
        opened.go(room)
        assert opened.page.evaluate("document.documentElement.scrollWidth") <= size[0], room
