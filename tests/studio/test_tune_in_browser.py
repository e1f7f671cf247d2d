"""Tuning by hand in a real browser: filters added, dragged and removed in the open loop, the loop faster as a whole."""

from __future__ import annotations

from typing import Any

import pytest


@pytest.fixture
def opened(studio: Any) -> Any:
    """A page of its own in the room where one tunes by hand; nothing is wrong on its console at the end."""
    found = studio.open(1280, 900)
    found.go("tune")
    found.page.wait_for_selector("#verdict:not(:empty)")
    found.page.locator("#picture-open_loop").scroll_into_view_if_needed()
    found.settled()
    yield found
    assert found.said == []
    found.context.close()


def number(page: Any, name: str) -> float:
    return float(page.input_value(f"[id='number-{name}']"))


def drag(page: Any, name: str, across: int, up: int, shift: bool = False) -> None:
    """A grip, in a few moves, by pixels."""
    box = page.locator(f"[data-grip='{name}']").bounding_box()
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    if shift:
        page.keyboard.down("Shift")
    for share in (0.25, 0.5, 0.75, 1.0):
        page.mouse.move(x + share * across, y - share * up)
        page.wait_for_timeout(40)
    page.mouse.up()
    if shift:
        page.keyboard.up("Shift")


def add(opened: Any, place: str, at: str = "") -> None:
    """A filter by the button, and wait for the loop with it: the first one is compiled."""
    opened.page.fill("#add-at", at)
    opened.page.click("#add-filter")
    opened.page.wait_for_selector(f"[data-grip='{place}.frequency']")
    opened.settled()


def filters(page: Any) -> list[str]:
    return [each for each in page.locator("#numbers-list legend").all_inner_texts() if each.startswith("filters.")]


def test_a_filter_is_added_by_the_button_survives_a_reload_and_is_undone(opened: Any) -> None:
    page, before = opened.page, filters(opened.page)
    words = page.inner_text("#verdict")
    place = f"filters.{len(before)}"
    add(opened, place)
    assert filters(page) == [*before, f"{place} (notch)"]
    assert page.locator(f"[data-grip='{place}.width']").count() == 1
    page.reload()
    page.wait_for_selector("#room-tune:not([hidden]) #verdict:not(:empty)")
    assert filters(page) == [*before, f"{place} (notch)"]
    page.keyboard.press("Control+z")
    opened.settled()
    assert filters(page) == before
    assert page.inner_text("#verdict") == words
    page.keyboard.press("Control+Shift+z")
    opened.settled()
    page.click(f"[aria-label='Remove {place} (notch)']")
    opened.settled()
    assert filters(page) == before


def test_a_click_into_the_open_loop_picks_the_frequency(opened: Any) -> None:
    page, place = opened.page, f"filters.{len(filters(opened.page))}"
    box = page.locator("#picture-open_loop .u-over").first.bounding_box()
    page.mouse.click(box["x"] + 0.8 * box["width"], box["y"] + 0.3 * box["height"])
    picked = float(page.input_value("#add-at"))
    page.select_option("#add-kind", "low_pass2")
    add(opened, place, str(picked))
    assert number(page, f"{place}.frequency") == picked
    grip = page.locator(f"[data-grip='{place}.frequency']").bounding_box()
    assert grip["x"] + 12.0 == pytest.approx(box["x"] + 0.8 * box["width"], abs=2.0)
    page.fill("#add-at", "1e9")
    page.click("#add-filter")
    opened.settled()
    assert "must be below half the sample rate" in page.inner_text("#error")


def test_a_notch_is_dragged_in_frequency_depth_and_width_and_undone(opened: Any) -> None:
    """The grip stays under the pointer; each drag is one step."""
    page, place = opened.page, f"filters.{len(filters(opened.page))}"
    add(opened, place, "150")
    grip, begun = (
        f"{place}.frequency",
        {each: number(page, f"{place}.{each}") for each in ("frequency", "damping_zero", "damping_pole")},
    )
    at = page.locator(f"[data-grip='{grip}']").bounding_box()
    drag(page, grip, 30, -12)
    opened.settled()
    now = page.locator(f"[data-grip='{grip}']").bounding_box()
    assert (now["x"] - at["x"], now["y"] - at["y"]) == (pytest.approx(30, abs=2), pytest.approx(12, abs=2))
    assert number(page, grip) > 1.1 * begun["frequency"]
    moved = number(page, f"{place}.damping_zero")
    assert moved != begun["damping_zero"]
    drag(page, grip, 20, 30, shift=True)
    opened.settled()
    assert number(page, f"{place}.damping_zero") == moved  # with Shift the depth stays
    depth = moved / number(page, f"{place}.damping_pole")
    drag(page, f"{place}.width", 25, 0)
    opened.settled()
    assert number(page, f"{place}.damping_pole") > 1.2 * begun["damping_pole"]
    assert number(page, f"{place}.damping_zero") / number(page, f"{place}.damping_pole") == pytest.approx(
        depth, rel=2e-3
    )
    for _ in range(3):
        page.keyboard.press("Control+z")
        opened.settled()
    assert {each: number(page, f"{place}.{each}") for each in begun} == begun


def test_a_notch_is_moved_by_keys_and_told_to_a_screen_reader(opened: Any) -> None:
    page, place = opened.page, f"filters.{len(filters(opened.page))}"
    add(opened, place, "200")
    grip = page.locator(f"[data-grip='{place}.frequency']")
    grip.focus()
    assert grip.get_attribute("role") == "slider"
    said = grip.get_attribute("aria-valuetext")
    page.keyboard.press("ArrowRight")
    opened.settled()
    assert number(page, f"{place}.frequency") == 204.0
    assert grip.get_attribute("aria-valuetext") != said
    assert "204 Hz" in grip.get_attribute("aria-valuetext")
    shallow = number(page, f"{place}.damping_zero")
    page.keyboard.press("ArrowUp")
    opened.settled()
    assert number(page, f"{place}.damping_zero") == pytest.approx(shallow * 10.0 ** (0.5 / 20.0), rel=2e-3)
    width = page.locator(f"[data-grip='{place}.width']")
    width.focus()
    wide = number(page, f"{place}.damping_pole")
    page.keyboard.press("ArrowRight")
    opened.settled()
    assert number(page, f"{place}.damping_pole") == pytest.approx(1.02 * wide, rel=2e-3)
    grip.hover()
    page.mouse.wheel(0, -120)
    opened.settled()
    assert number(page, f"{place}.damping_pole") > 1.03 * wide
    low, at, high = (float(grip.get_attribute(f"aria-value{each}")) for each in ("min", "now", "max"))
    assert low < at < high
    grip.focus()
    page.keyboard.press("Delete")
    opened.settled()
    assert page.locator(f"[data-grip='{place}.frequency']").count() == 0


def test_the_bandwidth_is_slid_and_undone_as_one(opened: Any) -> None:
    """All gains of the cascade go together, by their units."""
    page, names = opened.page, ("law.Kv", "law.Kp", "law.Tn")
    begun = {name: number(page, name) for name in names}
    before = float(page.input_value("#speed-field"))
    box = page.locator("#speed").bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    for share in (0.52, 0.55, 0.6, 0.57):
        page.mouse.move(box["x"] + share * box["width"], box["y"] + 0.5 * box["height"])
        page.wait_for_timeout(40)
    page.mouse.up()
    opened.settled()
    factor = number(page, "law.Kv") / begun["law.Kv"]
    assert factor > 1.2
    assert number(page, "law.Kp") / begun["law.Kp"] == pytest.approx(factor, rel=1e-5)
    assert number(page, "law.Tn") / begun["law.Tn"] == pytest.approx(1.0 / factor, rel=1e-5)
    assert float(page.input_value("#speed-field")) > 1.1 * before
    page.keyboard.press("Control+z")
    opened.settled()
    assert {name: number(page, name) for name in names} == begun
    page.fill("#speed-field", str(0.8 * before))
    page.keyboard.press("Enter")
    opened.settled()
    assert number(page, "law.Kv") == pytest.approx(0.8 * begun["law.Kv"], rel=1e-3)


def test_the_limit_that_is_broken_is_said_with_its_place(opened: Any) -> None:
    page = opened.page
    opened.go("optimize")
    page.fill("#optimize-field-phase_margin", "85")
    page.keyboard.press("Tab")
    opened.settled()
    opened.go("tune")
    said = page.inner_text("#verdict")
    assert said.startswith("Not yet: one limit is broken. Phase margin is ")
    assert said.endswith("Hz, at least 85°.")
    gauge = page.locator("[data-figure=phase_margin_deg]")
    assert gauge.get_attribute("data-state") == "broken"
    assert "limit broken" in gauge.get_attribute("aria-label")
    assert "least stiffness" in page.text_content("#figures")


def test_a_pole_is_dragged_in_the_pole_map(opened: Any) -> None:
    """The gains follow; as by the arrow keys."""
    page, names = opened.page, ("law.Kv", "law.Kp", "law.Tn")
    page.click("#see summary")
    page.check("#see-poles")
    page.wait_for_selector("#picture-poles [data-grip]")
    page.click("#see summary")
    opened.settled()
    assert "follow with the smallest change" in page.inner_text("#poles-said")
    grip = page.locator("#picture-poles [data-grip]").last
    begun, said = {name: number(page, name) for name in names}, grip.get_attribute("aria-valuetext")
    grip.scroll_into_view_if_needed()
    box = grip.bounding_box()
    page.mouse.move(box["x"] + 12, box["y"] + 12)
    page.mouse.down()
    for share in (2, 4, 6, 8):
        page.mouse.move(box["x"] + 12 - share, box["y"] + 12 - share)
        page.wait_for_timeout(60)
    page.mouse.up()
    opened.settled()
    assert {name: number(page, name) for name in names} != begun
    assert grip.get_attribute("aria-valuetext") != said
    page.keyboard.press("Control+z")
    opened.settled()
    assert {name: number(page, name) for name in names} == begun
    grip.focus()
    page.keyboard.press("ArrowLeft")
    opened.settled()
    assert {name: number(page, name) for name in names} != begun


def test_a_field_shows_the_number_of_the_control_and_a_wrong_one_is_said(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("tune")
    field = "[id='number-law.Kv']"
    page.wait_for_selector("#verdict:not(:empty)")
    before = page.input_value(field)
    page.fill(field, "41")
    page.keyboard.press("Enter")
    opened.settled()
    page.keyboard.press("Control+z")  # the field has the focus still
    opened.settled()
    assert page.input_value(field) == before
    page.fill(field, "fast")
    page.keyboard.press("Enter")
    opened.settled()
    assert "must be a number, not 'fast'" in page.inner_text("#error")
    assert page.input_value(field) == before


def test_the_wheel_and_keys_that_are_held_are_one_step_to_undo(studio: Any) -> None:
    page = (opened := studio.open(1280, 900)).page
    opened.go("tune")
    page.wait_for_selector("#verdict:not(:empty)")
    page.click("#add-filter")
    opened.settled()
    names = page.locator("#numbers-list .number label")
    before = page.input_value("[id='number-filters.0.damping_pole']")
    grip = page.locator("[data-grip='filters.0.width']")
    box = grip.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    for _ in range(40):
        page.mouse.wheel(0, -20)  # as a trackpad sends it: 8 steps
    opened.settled()
    wide = page.input_value("[id='number-filters.0.damping_pole']")
    assert wide != before
    assert names.count() > 0
    page.keyboard.press("Control+z")
    opened.settled()
    assert page.input_value("[id='number-filters.0.damping_pole']") == before
