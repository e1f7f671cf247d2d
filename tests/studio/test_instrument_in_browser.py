"""The view Tune as an instrument, in a real browser: all that decides in view, limits on the strip, addresses, keys."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.loop_model import loop_model
from feeddrive.plot.complex_plane import REACH
from view_layout import boxes, overlaps

_APART = (".gauge", "#say > *", ".snapshots > *", ".tune .grid > figure", "#numbers .number, #numbers .card > header")


@pytest.mark.parametrize("size", [(1280, 800), (1920, 1080)])
def test_all_that_decides_is_in_view_without_scrolling(studio: Any, size: tuple[int, int]) -> None:
    page = (opened := studio.open(*size)).page
    opened.go("tune")
    page.wait_for_selector("#verdict:not(:empty)")
    page.click("#keep")
    opened.settled()
    for look in ("light", "dark"):
        if look == "dark":
            page.click("#dark")
        for place in (
            "document.documentElement",
            "document.querySelector('main')",
            "document.querySelector('.tune .grid')",
        ):
            assert page.evaluate(f"{place}.scrollHeight - {place}.clientHeight") <= 0, place
            assert page.evaluate(f"{place}.scrollWidth - {place}.clientWidth") <= 0, place
        for chosen in _APART:
            assert overlaps(boxes(page, chosen)) == 0, chosen
        pictures = boxes(page, ".tune .grid > figure")
        assert len(pictures) == 5
        # no cell is empty: the pictures cover the area, but for lines of a pixel
        area = boxes(page, ".tune .grid")[0]
        covered = np.sum((pictures[:, 2] - pictures[:, 0]) * (pictures[:, 3] - pictures[:, 1]))
        assert covered == pytest.approx((area[2] - area[0]) * (area[3] - area[1]), rel=0.01)
        _, top, _, bottom = boxes(page, "#picture-open_loop")[0]
        assert bottom - top >= 0.5 * size[1] - 1.0
        # the unit circle is round: a unit is as long across as up, to a pixel over the whole picture
        left, top, right, bottom = boxes(page, "#picture-nyquist .u-over")[0]
        assert (right - left) / (REACH[1] - REACH[0]) * (REACH[3] - REACH[2]) == pytest.approx(bottom - top, abs=1.5)
    assert opened.said == []
    opened.page.close()


def test_a_limit_is_set_on_the_strip_and_is_that_of_the_goal(studio: Any) -> None:
    page = (opened := studio.open(1280, 800)).page
    opened.go("tune")
    page.wait_for_selector("#verdict:not(:empty)")
    gauge = page.locator("[data-figure=stiffness_least_N_per_m]")
    assert gauge.get_attribute("data-state") == "free"
    gauge.click()
    page.fill("#limit-field", "4")
    page.keyboard.press("Enter")
    opened.settled()
    assert "≥ 4" in gauge.inner_text()
    least = float(gauge.locator("b").inner_text())
    assert gauge.get_attribute("data-state") == (
        "kept" if least > 4.0 / 0.95 else "close" if least >= 4.0 else "broken"
    )
    opened.go("optimize")
    assert float(page.input_value("#optimize-field-max_compliance")) == pytest.approx(4.0)  # N/um
    page.go_back()
    page.wait_for_selector("#room-tune:not([hidden])")
    gauge.click()
    page.click("#limit-clear")
    opened.settled()
    assert gauge.get_attribute("data-state") == "free"
    opened.page.close()


def test_a_broken_limit_has_a_way_out_that_one_press_takes(studio: Any) -> None:
    page = (opened := studio.open(1280, 800)).page
    opened.go("tune")
    page.wait_for_selector("#verdict:not(:empty)")
    peak = page.locator("[data-figure=sensitivity_peak]")
    most = 1.0 + 0.9 * (float(peak.locator("b").inner_text()) - 1.0)
    peak.click()
    page.fill("#limit-field", f"{most:.4f}")
    page.keyboard.press("Enter")
    page.wait_for_selector("#remedy:visible")
    assert page.inner_text("#verdict").startswith("Not yet: one limit is broken. Ms is ")
    page.click("#remedy")
    opened.settled()
    assert page.inner_text("#verdict").startswith("All limits kept. Ms is ")
    page.locator("#history li button").last.click()  # the beginning
    opened.settled()
    assert page.locator("#history .undone").count() == 1
    opened.page.close()


def test_views_have_addresses_and_keys(studio: Any) -> None:
    page = (opened := studio.open(1280, 800)).page
    page.wait_for_selector("#verdict:not(:empty)")
    page.goto(f"{studio.address}#prove")
    page.reload()
    page.wait_for_selector("#room-prove:not([hidden])")
    page.keyboard.press("4")
    page.wait_for_selector("#room-tune:not([hidden]) #verdict:not(:empty)")
    assert page.url.endswith("#tune")
    page.go_back()
    page.wait_for_selector("#room-prove:not([hidden])")
    page.go_forward()
    page.wait_for_selector("#room-tune:not([hidden])")
    page.keyboard.press("Shift+A")
    page.wait_for_selector("#show-A")
    for key, name in (("t", "today"), ("a", "A")):
        page.keyboard.press(key)
        assert page.get_attribute(f"#show-{name}", "aria-pressed") == "false"
    page.locator("#picture-open_loop .surface").focus()
    page.keyboard.press("Enter")
    assert page.locator(".tune .grid > figure:visible").count() == 1
    page.keyboard.press("Escape")
    assert page.locator(".tune .grid > figure:visible").count() == 5
    assert opened.said == []
    opened.page.close()


def test_the_cursor_stands_at_the_same_frequency_in_nyquist(studio: Any) -> None:
    page = (opened := studio.open(1280, 800)).page
    opened.go("tune")
    page.wait_for_selector("#verdict:not(:empty)")
    opened.settled()
    left, top, right, _ = boxes(page, "#picture-open_loop .u-over")[0]
    page.mouse.move(left + 0.55 * (right - left), top + 20.0)
    page.wait_for_timeout(150)
    frequency = float(page.locator("#picture-open_loop .readout").first.inner_text().splitlines()[0])
    L = complex(loop_model(fd.read_machine("xy_table").loop("x")).loop_gain(np.array([frequency])).response[0])
    west, north, east, south = boxes(page, "#picture-nyquist .u-over")[0]
    x, y = (0.5 * (a + b) for a, b in np.array(boxes(page, "#picture-nyquist .dot")[0]).reshape(2, 2).T)
    found = complex(
        REACH[0] + (x - west) / (east - west) * (REACH[1] - REACH[0]),
        REACH[3] - (y - north) / (south - north) * (REACH[3] - REACH[2]),
    )
    assert abs(found - L) < 2.0 * (REACH[1] - REACH[0]) / (east - west)  # two pixels
    opened.page.close()
