"""The room Scope in a real browser: a file that another process writes is followed, triggers, and is measured."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

# 2 mm of sine at 3 Hz, at 1 kHz and by the clock
WRITER = """
import math, sys, time
began, k = time.monotonic(), 0
with open(sys.argv[1], "w") as file:
    file.write("t_s,<i>x</i> [mm],force_N\\n")
    while True:
        while k * 1e-3 < time.monotonic() - began:
            turn = 2 * math.pi * 3 * k * 1e-3
            file.write(f"{k * 1e-3:.4f},{2 * math.sin(turn):.6f},{50 * math.cos(turn):.4f}\\n")
            k += 1
        file.flush()
        time.sleep(0.01)
"""


@pytest.fixture
def scope(served: Any, tmp_path: Path) -> Iterator[Any]:
    """A server that may follow a file which is written all the while."""
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path / "run.csv")])
    try:
        yield served("--follow", str(tmp_path / "run.csv"))
    finally:
        writer.kill()
        writer.wait()


def legend(page: Any) -> str:
    return str(page.inner_text("#picture-scope .legend"))


def test_the_curve_moves_triggers_and_is_read_by_cursors_and_kept(scope: Any) -> None:
    page = (opened := scope.open()).page
    opened.go("scope")
    page.click("#scope-follow")
    page.wait_for_selector("#picture-scope:not([hidden])")
    page.wait_for_timeout(500)
    legends, pictures = set[str](), set[str]()
    until = time.monotonic() + 60.0
    while min(len(legends), len(pictures)) < 5:  # figures and picture go on changing
        assert time.monotonic() < until
        legends.add(legend(page))
        pictures.add(page.evaluate("document.querySelector('#picture-scope canvas').toDataURL()"))
        page.wait_for_timeout(20)
    page.select_option("#scope-trigger", "<i>x</i>")
    page.select_option("#scope-mode", "normal")
    page.fill("#scope-field-level", "1")
    page.keyboard.press("Enter")
    page.fill("#scope-field-window", "0.5")
    page.keyboard.press("Enter")
    triggered = "() => /^triggered at .* s of its clock/.test(document.querySelector('#scope-look').textContent)"
    page.wait_for_function(triggered)
    page.click("#scope-pause")
    opened.settled()
    before = legend(page)
    page.wait_for_timeout(500)
    assert legend(page) == before  # it stands
    box = page.locator("#picture-scope .field").bounding_box()
    for share in (0.45, 0.8):  # cursor 1, then 2
        page.mouse.click(box["x"] + share * box["width"], box["y"] + 60)
        opened.settled()
    page.focus("#scope-cursor-1")
    for _ in range(3):
        page.keyboard.press("ArrowRight")
        opened.settled()
    rows = [row.split("\t") for row in page.inner_text("#scope-readout").splitlines()[1:]]
    read = {row[0]: row[1:] for row in rows if len(row) > 1}
    one, two = (float(each) for each in read["time (s)"][:2])
    assert 0.0 < one < two < 0.4
    step, _, rate = read["time (s)"][2].partition("; 1/Δt ")
    assert float(step) == pytest.approx(two - one, rel=1e-4)
    assert float(rate.removesuffix(" Hz")) == pytest.approx(1.0 / (two - one), rel=1e-4)
    for name, factor, function in (("<i>x</i> (mm)", 2.0, math.sin), ("force_N (N)", 50.0, math.cos)):
        at = [factor * function(6.0 * math.pi * t + math.asin(0.5)) for t in (one, two)]
        assert [float(each) for each in read[name]] == pytest.approx([*at, at[1] - at[0]], abs=2e-3 * factor)
    page.click("#scope-between")
    assert opened.ended() == "done"
    assert "scope_1.parquet: log" in page.inner_text("#room-import")
    opened.go("scope")
    page.reload()  # the page goes on where it was
    page.wait_for_selector("#room-scope:not([hidden]) #scope-readout table")
    assert page.input_value("#scope-trigger") == "<i>x</i>"
    assert page.input_value("#scope-field-level") == "1"
    page.click("#scope-pause")
    opened.settled()
    page.click("#scope-follow")
    page.wait_for_function("() => document.querySelector('#scope-follow').textContent === 'Follow'")
    page.fill("#scope-field-level", "much")
    page.keyboard.press("Enter")
    opened.settled()
    assert "level: 'much' is no number" in page.inner_text("#error")
    assert opened.said == []


def test_at_most_20_pictures_come_each_second_and_none_while_nobody_looks(scope: Any) -> None:
    opened = scope.open()
    came = list[int]()
    opened.page.on("websocket", lambda socket: socket.on("framereceived", lambda data: came.append(len(data))))
    opened.page.reload()
    opened.go("scope")
    opened.page.click("#scope-follow")
    opened.page.wait_for_selector("#picture-scope:not([hidden])")
    opened.page.wait_for_timeout(500)
    came.clear()
    opened.page.wait_for_timeout(2000)
    assert 4 < len(came) <= 42
    assert max(came) < 20_000  # two curves of 960 points, each 8 bytes, and words
    opened.go("import")
    came.clear()
    opened.page.wait_for_timeout(1000)
    assert len(came) <= 1
    opened.go("scope")
    came.clear()
    opened.page.wait_for_timeout(1000)
    assert len(came) > 2


@pytest.mark.parametrize("look", ["light", "dark"])
def test_the_room_that_follows_has_no_serious_violation_of_accessibility(scope: Any, look: str) -> None:
    opened = scope.open(768, 1024)
    if look == "dark":
        opened.page.click("#dark")
    opened.go("scope")
    opened.page.click("#scope-follow")
    opened.page.wait_for_selector("#picture-scope:not([hidden])")
    opened.page.wait_for_selector("#scope-shown-1")
    opened.page.click("#scope-pause")
    opened.settled()
    assert opened.barriers() == []
    assert opened.page.evaluate("document.documentElement.scrollWidth") <= 768
    assert opened.said == []
