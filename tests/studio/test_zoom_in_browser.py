"""What a zoom of a picture keeps and what ends it, and limits that are dragged in one, in a real browser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


def box_of(page: Any, picture: str) -> dict[str, float]:
    found = page.locator(f"{picture} .u-over").first.bounding_box()
    assert found is not None
    return dict(found)


def drag(page: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(*end, steps=5)
    page.mouse.up()


def zoom_up(opened: Any, picture: str) -> None:
    """Look at the upper quarter of y."""
    box = box_of(opened.page, picture)
    x = box["x"] + 0.5 * box["width"]
    drag(opened.page, (x, box["y"] + 2.0), (x + 3.0, box["y"] + 0.25 * box["height"]))
    opened.settled()


def test_a_zoom_in_y_ends_with_another_unit_another_source_and_by_its_button(served: Callable[..., Any]) -> None:
    opened = served("xy_table", "--axis", "x").open(1280, 1400)
    page = opened.page
    opened.go("tune")
    page.wait_for_selector("#verdict:not(:empty)")
    picture = "#picture-sensitivity"
    button = page.locator(f"{picture} .whole")
    assert button.is_hidden()
    zoom_up(opened, picture)
    assert button.is_visible()
    assert button.get_attribute("aria-label").startswith("show all")
    button.focus()
    page.keyboard.press("Enter")
    assert button.is_hidden()
    assert page.evaluate("document.activeElement.className") == "surface"
    zoom_up(opened, picture)
    page.click("#see summary")
    page.select_option("#unit-gain", "absolute")
    opened.settled()
    assert button.is_hidden()
    zoom_up(opened, picture)
    assert button.is_visible()
    opened.go("import")
    page.click("#bundled-ball_screw")
    page.wait_for_selector("#tab-tune[aria-selected=true]")
    opened.settled()
    assert button.is_hidden()
    assert opened.said == []


def test_a_limit_is_set_by_a_drag_alone_and_out_of_sight_it_is_hidden(studio: Any) -> None:
    page = (opened := studio.open(1280, 1400)).page
    opened.go("optimize")
    picture = "#optimize-sensitivity"
    line, field = page.locator(f"{picture} .level"), page.locator("#optimize-field-max_ms")
    line.wait_for()
    before = field.input_value()

    def middle() -> tuple[float, float]:
        box = line.bounding_box()
        return box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]

    x, y = middle()
    page.mouse.click(x, y)
    page.mouse.click(x, y + 4.0)
    page.mouse.click(x, y, button="right")
    drag(page, (x, y), (x, y + 2.0))
    opened.settled()
    assert field.input_value() == before
    drag(page, (x - 40.0, y + 40.0), (x, y))  # a zoom that ends on the line
    opened.settled()
    assert field.input_value() == before
    assert page.locator(f"{picture} .whole").is_visible()
    page.locator(f"{picture} .whole").click()
    opened.settled()
    x, y = middle()
    drag(page, (x, y), (x, y + 10.0))
    opened.settled()
    after = float(field.input_value())
    assert 1.0 < after < float(before)
    box = box_of(page, picture)
    x = box["x"] + 0.5 * box["width"]
    drag(page, (x, box["y"] + 0.6 * box["height"]), (x + 3.0, box["y"] + 0.9 * box["height"]))
    opened.settled()
    assert line.is_hidden()
    page.locator(f"{picture} .whole").click()
    assert line.is_visible()
    assert float(field.input_value()) == after
    assert opened.said == []
