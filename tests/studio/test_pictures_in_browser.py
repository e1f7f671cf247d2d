"""The pictures of the page as a person chooses, reads and prints them, in a real browser."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feeddrive.files.frf import write_frf
from feeddrive.files.machine import read_machine
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize

_MORE = {  # by picture: what its legend says of the control of now, or of the axis
    "step": "now: overshoot",
    "snap": "now: peak",
    "poles": "now: least damping",
    "damping": "now: least damping",
    "response": "reading of the load, model",
    "friction": "model",
}


def words(page: Any, name: str) -> str:
    return str(page.inner_text(f"#picture-{name}"))


def grips(page: Any) -> list[float]:
    boxes = [each.bounding_box() for each in page.locator("[data-grip]").all() if each.is_visible()]
    return [each["x"] + each["width"] / 2.0 for each in boxes]


def inked(page: Any, name: str) -> int:
    """How many pixels of the canvases of a picture are colored: neither clear nor gray."""
    found = """(name) => [...document.querySelectorAll(`#picture-${name} canvas`)].map((canvas) => {
      const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
      let count = 0;
      for (let i = 0; i < data.length; i += 4) {
        const three = [data[i], data[i + 1], data[i + 2]];
        if (data[i + 3] > 60 && Math.max(...three) - Math.min(...three) > 60) count++;
      }
      return count;
    }).reduce((a, b) => a + b, 0)"""
    return int(page.evaluate(found, name))


def test_pictures_are_chosen_follow_a_number_and_stay_after_a_reload(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("tune")
    assert all(page.locator(f"#picture-{name}").is_hidden() for name in _MORE)
    page.click("#see summary")
    for name in _MORE:
        page.check(f"#see-{name}")
        opened.settled()
        assert _MORE[name] in words(page, name)
        assert inked(page, name) > 40
    before = {name: words(page, name) for name in ("step", "snap", "poles")}
    page.fill("[id='number-law.Kp']", "60000")
    page.keyboard.press("Enter")
    opened.settled()
    assert all(words(page, name) != before[name] for name in before)
    page.uncheck("#see-nyquist")
    opened.settled()
    assert page.locator("#picture-nyquist").is_hidden()
    page.reload()
    page.wait_for_selector("#picture-poles:not([hidden])")
    opened.settled()
    assert page.locator("#picture-nyquist").is_hidden()
    assert opened.said == []


def test_units_are_read_as_chosen_and_what_is_held_in_a_picture_stays_where_it_was(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("tune")
    page.fill("#add-at", "200")
    page.click("#add-filter")
    opened.settled()
    stood = grips(page)
    assert stood
    page.click("#see summary")
    for kind, unit in (("length", "mm"), ("force", "kN"), ("frequency", "rad/s"), ("gain", "absolute")):
        page.select_option(f"#unit-{kind}", unit)
        opened.settled()
    assert "kN/mm" in words(page, "stiffness")
    assert "rad/s" in words(page, "open_loop")
    assert "mm, peak" in words(page, "run")
    np.testing.assert_allclose(grips(page), stood, atol=1.0)  # pixels: 2π is the same on an axis of logarithms
    unit = page.locator(".number", has=page.locator("[id='number-filters.0.frequency']")).locator(".unit")
    assert unit.inner_text() == "rad/s"
    page.select_option("#unit-frequency", "Hz")
    opened.settled()
    assert unit.inner_text() == "Hz"
    assert opened.said == []


@pytest.fixture(scope="module")
def responses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Responses of the bundled ball screw, with noise of known variance and a band of low coherence."""
    loop, random = read_machine("ball_screw").loop(None), np.random.default_rng(2)
    f = np.geomspace(5.0, 1200.0, 70)
    model = linearize(loop, ["cut"], ["reading_motor", "reading_load"])
    found = list[FRF]()
    for reading in model.outputs:
        G = model.response(f, reading, "cut").response
        coherence = np.where((f > 300.0) & (f < 400.0), 0.5, 0.999)
        deviation = np.abs(G) * np.sqrt((1.0 - coherence) / coherence / 16.0)
        error = deviation * np.sqrt(0.5) * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
        found.append(FRF(f, G + error, "force", reading, "m/N", float(loop.sample_time), coherence, deviation**2))
    path = tmp_path_factory.mktemp("frf") / "screw.csv"
    write_frf(path, *found)
    return path


def test_a_measured_response_is_seen_with_its_bands_its_coherence_and_its_model(studio: Any, responses: Path) -> None:
    page = (opened := studio.open()).page
    opened.go("import")
    page.set_input_files("#files", str(responses))
    assert opened.ended() == "done"
    page.click("#identify")
    assert opened.ended() == "done"
    said = words(page, "made-fit")
    for each in ("measured", "model", "95 % of the measurement", "95 % of the model", "coherence 0.9 or less"):
        assert each in said, each
    page.locator("label", has_text="Today's machine").locator("select").select_option("ball_screw")
    page.click("#tune-responses")
    page.wait_for_selector("#title:has-text('screw.csv')")
    opened.settled()
    assert "95 % of the measurement" in words(page, "open_loop")
    assert "coherence 0.9 or less" in words(page, "open_loop")
    page.click("#see summary")
    page.check("#see-response")
    opened.settled()
    assert "reading of the motor, measured" in words(page, "response")
    assert opened.said == []


def test_what_is_printed_is_light_in_the_width_of_the_sheet_and_the_page_is_dark_again_after_it(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("tune")
    page.click("#dark")
    opened.settled()
    page.evaluate("""() => addEventListener("beforeprint", () => {
      const sheet = document.body.getBoundingClientRect().width;
      const canvases = [...document.querySelectorAll("#room-tune figure:not([hidden]) canvas")];
      document.title = JSON.stringify({
        look: document.documentElement.dataset.look, sheet,
        widest: Math.max(...canvases.map((each) => each.getBoundingClientRect().right)), canvases: canvases.length,
        paper: getComputedStyle(document.body).backgroundColor,
      });
    })""")
    found = page.pdf(format="A4")
    assert found.startswith(b"%PDF")
    told = json.loads(page.title())
    assert told["look"] == "light"
    assert told["paper"] == "rgb(255, 255, 255)"
    assert told["canvases"] >= 8
    assert told["sheet"] == pytest.approx(186.0 / 25.4 * 96.0, abs=1.0)  # mm in pixels of CSS
    assert told["widest"] <= told["sheet"] + 1.0
    assert page.get_attribute("html", "data-look") == "dark"
    opened.settled()
    assert page.locator("#picture-nyquist canvas").bounding_box()["width"] > 200.0
    page.emulate_media(media="print")
    assert page.locator("#tabs").is_hidden()
    assert page.locator("input[type=range]").first.is_hidden()
    assert page.locator("[id='number-law.Kp']").is_visible()
    assert opened.said == []


@pytest.mark.parametrize("look", ["light", "dark"])
def test_all_pictures_at_once_are_accessible_and_fit_a_tablet(studio: Any, look: str) -> None:
    page = (opened := studio.open(768, 1024)).page
    opened.go("tune")
    if look == "dark":
        page.click("#dark")
    page.focus("#see summary")
    page.keyboard.press("Enter")  # by keys alone
    for name in _MORE:
        page.focus(f"#see-{name}")
        page.keyboard.press("Space")
        opened.settled()
        assert page.evaluate("document.activeElement.id") == f"see-{name}"
        assert page.locator(f"#picture-{name}").is_visible()
    assert opened.barriers() == []
    assert page.evaluate("document.documentElement.scrollWidth") <= 768
