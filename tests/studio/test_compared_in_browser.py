"""Pictures of Tune in a real browser: taken as SVG and data, and two controls compared by a divider."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.slow(reason="a real browser, and a server that compiles its first loop")

_SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture
def opened(studio: Any) -> Any:
    """A page of its own in Tune, with the clipboard, and a control that differs from today's."""
    found = studio.open(1280, 800)
    found.context.grant_permissions(["clipboard-read", "clipboard-write"])
    found.go("tune")
    found.page.wait_for_selector("#verdict:not(:empty)")
    field = found.page.locator("[id='number-law.Kv']")
    field.fill(str(1.4 * float(field.input_value())))
    field.press("Enter")
    found.settled()
    yield found
    assert found.said == []
    found.context.close()


def pasted(opened: Any) -> str:
    opened.settled()
    return str(opened.page.evaluate("navigator.clipboard.readText()"))


def test_a_picture_is_copied_and_saved_as_svg_and_as_data(opened: Any, tmp_path: Path) -> None:
    page = opened.page
    page.click("#picture-stiffness .menu summary")
    page.click("#picture-stiffness .menu button >> text=Copy as SVG")
    copied = pasted(opened)
    drawing = ET.fromstring(copied)
    assert drawing.tag == f"{_SVG}svg"
    texts = [each.text or "" for each in drawing.iter(f"{_SVG}text")]
    assert any(each.startswith("today: least ") for each in texts)
    assert any(each.startswith("now: least ") for each in texts)
    assert "dynamic stiffness (N/µm)" in texts
    assert "var(" not in copied  # it stands alone
    assert not page.locator("#picture-stiffness .menu[open]").count()
    # what is hidden is left out, and the keys do the same
    page.keyboard.press("t")
    page.locator("#picture-stiffness .surface").focus()
    with page.expect_download() as saved:
        page.keyboard.press("Shift+S")
    assert saved.value.suggested_filename == "stiffness.svg"
    saved.value.save_as(tmp_path / "stiffness.svg")
    text = (tmp_path / "stiffness.svg").read_text(encoding="utf-8")
    assert "now: least" in text
    assert "today: least" not in text
    page.keyboard.press("d")
    assert pasted(opened).startswith("panel,curve,x,y\n")
    page.keyboard.press("t")


def colors(page: Any, left: float, right: float) -> set[str]:
    """The colors that the canvas of the picture of stiffness has between two shares of its width, in full."""
    found = page.evaluate(
        """([left, right]) => {
            const canvas = document.querySelector("#picture-stiffness canvas");
            const box = document.querySelector("#picture-stiffness .u-over").getBoundingClientRect();
            const whole = canvas.getBoundingClientRect();
            const ratio = canvas.width / whole.width;
            const at = (share) => Math.round(ratio * (box.left - whole.left + share * box.width));
            const [from, to] = [at(left), at(right)];
            const top = Math.round(ratio * (box.top - whole.top));
            const all = canvas.getContext("2d").getImageData(from, top, to - from, Math.round(ratio * box.height)).data;
            const seen = new Set();
            const hex = (each) => each.toString(16).padStart(2, "0");
            for (let i = 0; i < all.length; i += 4)
                if (all[i + 3] === 255) seen.add("#" + hex(all[i]) + hex(all[i + 1]) + hex(all[i + 2]));
            return [...seen];
        }""",
        [left, right],
    )
    return set(found)


TODAY, NOW, A = "#66717c", "#0a5fc4", "#00735f"  # page/src/pictures/look.ts, on light paper


def test_two_controls_are_compared_by_a_divider(opened: Any) -> None:
    page, picture = opened.page, opened.page.locator("#picture-stiffness")
    opened.page.evaluate("document.documentElement.dataset.look === 'light' || document.getElementById('dark').click()")
    page.click("#keep")
    page.wait_for_selector("#show-A")
    opened.settled()
    picture.locator(".surface").focus()
    page.keyboard.press("w")
    assert page.locator(".tune .grid > figure:visible").count() == 1
    divider, names = picture.locator(".divider"), picture.locator(".wipe select")
    assert [each.evaluate("(each) => each.selectedOptions[0].text") for each in names.all()] == ["today", "now"]
    assert divider.evaluate("(each) => each === document.activeElement")
    at = picture.locator(".u-over").bounding_box()
    line = divider.bounding_box()
    assert line["x"] + 0.5 * line["width"] == pytest.approx(at["x"] + 0.5 * at["width"], abs=1.0)
    left, right = colors(page, 0.0, 0.49), colors(page, 0.51, 1.0)
    assert [each in left for each in (TODAY, NOW)] == [True, False]
    assert [each in right for each in (TODAY, NOW)] == [False, True]
    # dragged by the pointer, then by the keys
    page.mouse.move(line["x"] + 12, line["y"] + 100)
    page.mouse.down()
    page.mouse.move(at["x"] + 0.8 * at["width"], line["y"] + 100, steps=3)
    page.mouse.up()
    assert int(divider.get_attribute("aria-valuenow")) == pytest.approx(80, abs=1)
    assert NOW not in colors(page, 0.0, 0.78)
    for _ in range(3):
        page.keyboard.press("Shift+ArrowLeft")
    assert int(divider.get_attribute("aria-valuenow")) == pytest.approx(50, abs=1)
    names.nth(1).select_option("A")
    assert A in colors(page, 0.52, 1.0)
    assert opened.barriers() == []
    divider.focus()
    page.keyboard.press("Escape")
    assert picture.locator(".wipe:visible").count() == 0
    assert page.locator(".tune .grid > figure:visible").count() == 1
    page.keyboard.press("Escape")
    assert page.locator(".tune .grid > figure:visible").count() == 5


def test_a_limit_is_dragged_by_its_line_and_a_notch_off_by_its_grip(opened: Any) -> None:
    page = opened.page
    line, gauge = page.locator("#picture-sensitivity .level"), page.locator("[data-figure=sensitivity_peak]")
    before = gauge.locator(".limit").inner_text()
    box = line.bounding_box()
    page.mouse.move(box["x"] + 40, box["y"] + 6)
    page.mouse.down()
    page.mouse.move(box["x"] + 40, box["y"] + 12, steps=3)
    page.mouse.up()
    opened.settled()
    after = gauge.locator(".limit").inner_text()
    assert float(after.removeprefix("≤ ")) < float(before.removeprefix("≤ "))
    gauge.click()
    page.click("#limit-clear")
    opened.settled()
    assert gauge.locator(".limit").inner_text() == before
    page.click("#add-filter")
    opened.settled()
    field = page.locator("#numbers-filters .card").last.locator(".number input[type=text]")
    labels = page.locator("#numbers-filters .card").last.locator(".number label").all_text_contents()
    assert labels == ["Frequency", "Depth", "Width", "Damping zero", "Damping pole"]
    field.nth(1).fill("30")
    field.nth(1).press("Enter")
    opened.settled()
    assert float(field.nth(4).input_value()) / float(field.nth(3).input_value()) == pytest.approx(10**1.5, rel=1e-4)
    assert page.locator("#history [aria-current]").inner_text().endswith("→ 30 dB")
    page.locator("#numbers-filters .switch").last.click()
    opened.settled()
    grip, card = page.locator("[data-grip^='off.'][data-grip$='.frequency']"), page.locator(".card.off b")
    assert grip.locator("span").evaluate("(each) => getComputedStyle(each).borderTopStyle") == "dashed"
    verdict, named = page.inner_text("#verdict"), card.inner_text()
    box = grip.bounding_box()
    page.mouse.move(box["x"] + 12, box["y"] + 12)
    page.mouse.down()
    page.mouse.move(box["x"] + 42, box["y"] + 12, steps=3)
    page.mouse.up()
    opened.settled()
    assert grip.bounding_box()["x"] == pytest.approx(box["x"] + 30, abs=2.0)
    assert card.inner_text() != named
    assert page.inner_text("#verdict") == verdict
