"""Compare and Prove in a browser: a click on a law, a reload, and the circle plot with its peaks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from conftest import Studio


@pytest.fixture(scope="module")
def mill(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    """A server for the mill, whose travel has room for the bundled part programs."""
    made = Studio(browser, tmp_path_factory.mktemp("mill"), "mill", "--axis", "x")
    yield made
    made.close()


@pytest.fixture(scope="module")
def ran(mill: Any) -> Any:
    """A page on which a control was certified, and then a circle test was run."""
    opened = mill.open()
    opened.page.wait_for_selector("#verdict:not(:empty)")
    opened.go("prove")
    opened.page.click("#prove-certify")
    assert opened.ended() == "done"
    opened.page.click("#proofs-circle")
    opened.page.click("#prove-circle")
    assert opened.ended() == "done"
    return opened


def readout(page: Any, picture: str, across: float = 0.5, up: float = 0.5) -> str:
    """What a picture says of a place, as shares of its content."""
    content = page.locator(f"#{picture} .u-over").first
    content.scroll_into_view_if_needed()
    box = content.bounding_box()
    page.mouse.move(box["x"] + across * box["width"], box["y"] + (1.0 - up) * box["height"])
    page.wait_for_timeout(60)
    return str(page.locator(f"#{picture} .readout").first.inner_text())


_FIND = """(content, steps) => {
  const box = content.getBoundingClientRect();
  for (let i = 0; i < steps; i++) {
    for (let k = 0; k < steps; k++) {
      const [clientX, clientY] = [box.x + (i + 0.5) / steps * box.width, box.y + (k + 0.5) / steps * box.height];
      content.dispatchEvent(new MouseEvent('mousemove', {clientX, clientY, bubbles: true, view: window}));
      if (content.style.cursor === 'pointer') return [clientX, clientY];
    }
  }
  return null;
}"""


def found_mark(page: Any, picture: str, steps: int = 24) -> str:
    """Move over a picture until a mark that can be clicked is pointed at; what the picture says of it."""
    content = page.locator(f"#{picture} .u-over").first
    content.scroll_into_view_if_needed()
    # looked for within the page, since each move from here takes some ms; the place is then pointed at for real
    place = content.evaluate(_FIND, steps)
    if place is not None:
        page.mouse.move(*place)
        page.wait_for_timeout(60)
        assert content.evaluate("each => each.style.cursor") == "pointer"
        return str(page.locator(f"#{picture} .readout").first.inner_text()).splitlines()[-1]
    raise AssertionError("no mark is pointed at")


def test_a_reload_shows_what_was_proven(ran: Any) -> None:
    texts = ran.page.locator("#proof-circle .worst").all_inner_texts()
    ran.page.reload()
    ran.page.wait_for_selector("#proof-circle .worst")
    assert ran.page.locator("#proof-circle .worst").all_inner_texts() == texts
    assert ran.page.locator("#proof-circle-circle canvas").count() == 1
    assert ran.page.get_attribute("#proofs-circle", "aria-pressed") == "true"  # the latest
    ran.page.click("#proofs-certificate")
    folded = ran.page.locator("#proof-certificate .report details")  # as on the page that the command writes
    assert folded.locator("summary").all_text_contents() == ["The control", "What was certified"]
    assert not ran.page.locator("#proof-certificate .report").is_visible()  # all of it is folded, once
    ran.page.click("#proofs-circle")
    assert ran.said == []


@pytest.mark.parametrize("size", [(1280, 720), (768, 1024)])
def test_what_was_proven_is_accessible_and_fits_the_screen(ran: Any, size: tuple[int, int]) -> None:
    ran.page.set_viewport_size({"width": size[0], "height": size[1]})
    ran.page.click("#dark")
    ran.settled()
    assert ran.barriers() == []
    assert ran.page.evaluate("document.documentElement.scrollWidth") <= size[0]
    assert ran.page.locator("#proof-circle-circle canvas").is_visible()


def test_the_circle_plot_and_its_peaks(mill: Any) -> None:
    page = (opened := mill.open()).page
    page.wait_for_selector("#verdict:not(:empty)")
    opened.go("prove")
    page.click("#proofs-circle")
    page.click("#prove-circle")
    assert opened.ended() == "done"
    heads = page.locator("#proof-circle th:text-is('G µm')")
    cells = page.locator("#proof-circle table").first.locator("tbody tr td:nth-child(2)").all_text_contents()
    assert heads.count() == 1
    legend = page.locator("#proof-circle-circle .legend li").all_inner_texts()
    gaps = [float(each.partition("G ")[2].partition(" µm")[0]) for each in legend]
    assert gaps == pytest.approx([float(each) for each in cells[:4]], rel=1e-3)
    peak = page.locator("#proof-circle .worst").first
    whole = readout(page, "proof-circle-unrolled").splitlines()[0]
    peak.click()
    opened.settled()
    place = {"+x": (0.0, 360.0), "+y": (90.0,), "-x": (180.0,), "-y": (270.0,)}[
        peak.inner_text().split()[3].rstrip(",")
    ]
    middle = float(readout(page, "proof-circle-unrolled").splitlines()[0])
    assert min(abs(middle - each) for each in place) <= 12.0
    assert float(whole) == pytest.approx(180.0, abs=1.0)
    assert opened.said == []


def test_laws_are_chosen_compared_and_one_is_loaded_by_a_click(mill: Any) -> None:
    page = (opened := mill.open()).page
    page.wait_for_selector("#verdict:not(:empty)")
    opened.go("compare")
    for box in page.locator("#compare-laws > label input:enabled").all():
        box.uncheck()
        opened.settled()
    page.click("#compare-laws summary >> nth=0")
    page.locator("#compare-laws label", has_text=re.compile(r"^\s*P-PI \+ compensator$")).click()
    opened.settled()
    assert page.inner_text("#compare-start") == "Compare 2 laws"
    page.reload()
    page.wait_for_selector("#compare-laws input")
    assert page.inner_text("#compare-start") == "Compare 2 laws"  # the choice stays
    page.fill("#compare-starts", "1")
    page.click("#compare-start")
    assert opened.ended() == "done"
    table = page.locator("#room-compare table", has_text="Tune with P-PI")
    rows = table.locator("tbody tr td:first-child").all_inner_texts()
    assert rows == ["today's gains", "P-PI", "P-PI + compensator"]
    said = found_mark(page, "compare-tradeoff", steps=60)
    law = said.partition(":")[0]
    assert law in rows
    page.mouse.down()
    page.mouse.up()
    page.wait_for_selector("#tab-tune[aria-selected=true]")
    opened.settled()
    opened.go("compare")
    page.get_by_role("button", name="Tune with P-PI + compensator").click()  # the same by the keyboard
    page.wait_for_selector("#tab-tune[aria-selected=true]")
    opened.settled()
    opened.go("export")
    assert "--take 'P-PI + compensator'" in page.inner_text("#recipe-commands")
    assert opened.said == []
