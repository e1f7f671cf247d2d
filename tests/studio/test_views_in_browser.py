"""The views Import, Prove, Compare, Optimize, Scope and Export in a real browser: empty and full, at two sizes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from test_instrument_in_browser import boxes, overlaps

from conftest import Studio

VIEWS = ("import", "scope", "optimize", "compare", "prove", "export")
SIZES = [(1280, 800), (1920, 1080)]
_LEAST = 24.0  # pixels, of what is pressed: WCAG 2.5.8
# what the page said before it had the words of the trade, with which no visible text may begin, end or be equal
OLD = (
    "Bring",
    "Take away",
    "Or begin with a bundled machine",
    "Columns: what each is",
    "N per unit of the command",
    "Lead of the screw",
    "Sample time (s)",
    "Law that ran",
    "Machine file to start from",
    "Use these values",
    "Estimate frequency responses",
    "Tune on the measured response",
    "Follow",
    "Pause",
    "Keep the window as a log",
    "Take the cursors away",
    "Keep what lies between the cursors",
    "Tune by goal",
    "Accept",
    "Reject",
    "max ms",
    "max compliance",
    "reading noise",
    "max noise",
    "starts",
    "Accept the best so far",
    "Compare laws",
    "Tune on with",
    "Certify",
    "What is proven, over frequency",
    "radius r of the discs",
    "Discs of the loop in the complex plane",
    "Discs in the complex plane",
    "times as wide",
    "Run it on the machine",
    "Take away",
    "Exports",
    "Export: c",
    "Verify with this machine's compiler",
    "Guard",
    "Add the guard",
    "Nothing was done yet",
    "of now",
    "broken",
    "what each is",
)
_TEXTS = """() => [...document.querySelectorAll('[role=tabpanel]:not([hidden]) *')].flatMap((each) => [
  ...[...each.childNodes].filter((node) => node.nodeType === 3).map((node) => node.textContent.trim()),
  each.getAttribute('aria-label') ?? '', each.getAttribute('title') ?? '', each.getAttribute('placeholder') ?? '',
]).filter((text) => text)"""
_SCROLLS = """() => [document.documentElement, document.querySelector('main'),
  ...document.querySelectorAll('.fills > .pane, .fills > :not([hidden]) > .empty')].filter((each) => each.offsetParent)
  .map((each) => [each.className, each.scrollHeight - each.clientHeight, each.scrollWidth - each.clientWidth])
  .filter(([, down, across]) => down > 1 || across > 1)"""
# elements that are pressed, but for words in a line and native boxes with a label, which is pressed with them
_PRESSED = (
    "[role=tabpanel]:not([hidden]) :is(button, select, summary, a.file, input:not([type=checkbox], [type=radio]))"
)


@pytest.fixture(scope="module")
def bare(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    """A server without a machine."""
    made = Studio(browser, tmp_path_factory.mktemp("bare"))
    yield made
    made.close()


def looked_at(opened: Any, view: str) -> None:
    """What holds for a view in each state: nothing scrolls, targets are large enough, no barrier, the trade's words."""
    page = opened.page
    assert page.evaluate(_SCROLLS) == [], view
    pressed = boxes(page, _PRESSED)
    assert np.min(pressed[:, 2:] - pressed[:, :2], initial=np.inf) >= _LEAST - 0.5, view
    texts = page.evaluate(_TEXTS)
    for old in OLD:
        found = [text for text in texts if text == old or text.startswith(f"{old} ") or text.endswith(f" {old}")]
        assert found == [], (view, old)
    assert not [text for text in texts if "--" in text and not text.startswith(("feeddrive ", "#"))], view
    assert len(page.locator("[role=tabpanel]:not([hidden]) :is(button, a).main:visible").all()) <= 1, view


@pytest.mark.parametrize("size", SIZES)
def test_an_empty_view_says_what_it_is_for_with_an_example_and_one_button(bare: Any, size: tuple[int, int]) -> None:
    page = (opened := bare.open(*size)).page
    page.wait_for_selector("#choose-files")
    for look in ("light", "dark"):
        if look == "dark":
            page.click("#dark")
        for view in VIEWS:
            opened.go(view)
            room = page.locator(f"#room-{view}")
            assert room.locator(":is(button, a).main:visible").count() == 1, view
            assert room.locator("h1:visible").count() == 1, view
            example = "Example machines" if view == "import" else "Example: "
            assert example in room.inner_text(), view
            looked_at(opened, view)
            if size == SIZES[0]:
                assert opened.barriers() == [], (view, look)
    assert opened.said == []
    page.close()


@pytest.mark.parametrize("size", SIZES)
def test_prove_opens_with_the_verdict_then_what_it_covers_then_pictures(studio: Any, size: tuple[int, int]) -> None:
    page = (opened := studio.open(*size)).page
    page.wait_for_selector("#verdict:not(:empty)")
    opened.go("prove")
    for error, word, filled in (("20", "Proven.", "Certificate"), ("150", "Not proven.", "Prove for ")):
        page.fill("#prove-error", error)
        page.click("#prove-certify")
        assert opened.ended() == "done"
        hero = page.locator("#proof-certificate .hero")
        assert hero.locator("h2 b").inner_text() == word
        assert float(hero.locator("h2").evaluate("(each) => parseFloat(getComputedStyle(each).fontSize)")) >= 28.0
        assert hero.locator("> .icon").get_attribute("data-icon") == ("kept" if word == "Proven." else "broken")
        room = float(hero.locator(".distance strong").inner_text().split()[0])
        assert (room > 1.0) == (word == "Proven.")
        for part in ("section:nth-child(1) li", "section:nth-child(2) li"):
            assert page.locator(f"#proof-certificate .foot > {part}").count() == 4
        said = page.locator("#proof-certificate .foot li").all_inner_texts()
        assert len({*said}) == len(said)  # each once
        assert page.locator("#proof-certificate :is(button, a).main:visible").inner_text().startswith(filled)
        for look in ("light", "dark"):
            if look == "dark":
                page.click("#dark")
            looked_at(opened, "prove")
            for chosen in (".side .row", ".foot > *", ".hero > *", ".cells > figure"):
                assert overlaps(boxes(page, f"#room-prove {chosen}")) == 0, chosen
            area, pictures = (
                boxes(page, "#proof-certificate .cells")[0],
                boxes(page, "#proof-certificate .cells > figure"),
            )
            covered = np.sum((pictures[:, 2] - pictures[:, 0]) * (pictures[:, 3] - pictures[:, 1]))
            assert covered == pytest.approx((area[2] - area[0]) * (area[3] - area[1]), rel=0.01)
            if size == SIZES[0]:
                assert opened.barriers() == []
        page.click("#dark")
    page.click("#prove-instead")
    assert opened.ended() == "done"
    assert page.inner_text("#proof-certificate .hero h2 b") == "Proven."
    page.fill("#prove-error", "150")
    page.keyboard.press("Enter")
    assert opened.ended() == "done"
    said = page.inner_text("#prove-tune")
    page.click("#prove-tune")
    page.wait_for_selector("#room-tune:not([hidden]) #verdict:not(:empty)")
    page.wait_for_timeout(900)
    shown = float(page.locator("#picture-open_loop .readout").first.inner_text().splitlines()[0])
    assert shown == pytest.approx(float(said.split()[1]), rel=0.02)  # a pixel of the axis is 1 %
    assert opened.said == []
    page.close()


@pytest.mark.parametrize("size", SIZES)
def test_law_filters_and_range_are_chosen_and_each_field_has_its_line(studio: Any, size: tuple[int, int]) -> None:
    page = (opened := studio.open(*size)).page
    page.wait_for_selector("#verdict:not(:empty)")
    opened.go("optimize")
    page.click("#optimize-more summary")
    for setting in page.locator(".setting").all():
        assert setting.locator("label").first.inner_text()
        assert len(setting.locator("small").inner_text()) > 10
    for name in ("goal", "law", "filters", "box"):
        assert page.locator(f"#optimize-field-{name}").evaluate("(each) => each.tagName") == "SELECT", name
    page.select_option("#optimize-field-law", label="P-PI cascade")
    page.select_option("#optimize-field-filters", label="leave them as they are")
    page.select_option("#optimize-field-box", label="tolerances of your own")
    opened.settled()
    page.fill("#optimize-field-box-stiffness", "10")
    page.keyboard.press("Tab")
    opened.settled()
    assert "every stiffness ±10 %" in page.inner_text("#optimize-over")
    page.fill("#optimize-field-band", "5")
    page.fill("#optimize-field-band-to", "60")
    page.keyboard.press("Tab")
    opened.settled()
    page.reload()
    page.wait_for_selector("#optimize-field-law")
    opened.settled()
    assert page.input_value("#optimize-field-law") == "cascade_ppi"
    assert page.input_value("#optimize-field-box-stiffness") == "10"
    assert (page.input_value("#optimize-field-band"), page.input_value("#optimize-field-band-to")) == ("5", "60")
    page.fill("#optimize-field-max_ms", "0.5")
    page.keyboard.press("Tab")
    opened.settled()
    assert page.inner_text("#error").startswith("'Largest Ms' = 0.5")
    assert "--" not in page.inner_text("#error")
    for name, value in (("law", ""), ("filters", "placed"), ("box", "auto")):
        page.select_option(f"#optimize-field-{name}", value)
    page.click("#optimize-more summary")
    page.fill("#optimize-field-max_ms", "")
    page.keyboard.press("Tab")
    opened.settled()
    looked_at(opened, "optimize")
    pictures = boxes(page, ".optimize .cells > figure")
    area = boxes(page, ".optimize .cells")[0]
    covered = np.sum((pictures[:, 2] - pictures[:, 0]) * (pictures[:, 3] - pictures[:, 1]))
    assert covered == pytest.approx((area[2] - area[0]) * (area[3] - area[1]), rel=0.01)
    assert overlaps(pictures) == 0
    if size == SIZES[0]:
        assert opened.barriers() == []
    assert opened.said == []
    page.close()


def test_the_scope_has_an_example_that_runs_and_is_saved_as_a_log(bare: Any) -> None:
    page = (opened := bare.open(*SIZES[0])).page
    page.wait_for_selector("#choose-files")
    opened.go("scope")
    page.click("#scope-example")
    page.wait_for_selector("#picture-scope canvas")
    page.wait_for_function("() => document.querySelector('#scope-state').innerText.includes('rows/s')")
    page.wait_for_timeout(1200)  # a whole window
    page.click("#scope-pause")
    opened.settled()
    looked_at(opened, "scope")
    page.click("#scope-save")
    assert opened.ended() == "done"
    page.wait_for_selector("#columns-of-log:visible")
    roles = page.locator("#columns-of-log select").evaluate_all(
        "(all) => all.map((each) => each.selectedOptions[0].text)"
    )
    assert "Set position" in roles
    looked_at(opened, "import")
    assert opened.barriers() == []
    assert opened.said == []
    page.close()
