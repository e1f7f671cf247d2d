"""Tuned in the picture on measured responses: a stage that was measured, and pole placement at several positions."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from conftest import Studio
from feeddrive.language import tree
from feeddrive.tuning.candidates import control_with
from feeddrive.workflow.control_text import machine_text

STAGE = Path(__file__).parents[3] / "shared" / "data" / "tokyo_stage_frf" / "frf.csv"
LINES = np.geomspace(2.0, 1500.0, 700)


@pytest.fixture(scope="module")
def empty(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A server without a source."""
    made = Studio(browser, tmp_path_factory.mktemp("empty"))
    yield made
    made.close()


def brought(opened: Any, *files: Path) -> None:
    opened.page.set_input_files("#files", [str(each) for each in files])
    assert opened.ended() == "done"
    opened.page.click(f"#room-import li button:text-is('{files[0].name}')")
    opened.settled()


def tuned_on(opened: Any) -> None:
    opened.page.click("#tune-responses")
    opened.page.wait_for_selector("#room-tune:not([hidden]) #verdict:not(:empty)")
    opened.settled()


def moved(page: Any, grip: str, across: int, up: int) -> None:
    """A grip that is dragged, by pixels."""
    place = page.locator(f"[data-grip='{grip}']")
    place.scroll_into_view_if_needed()
    box = place.bounding_box()
    x, y = box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    for share in (0.3, 0.6, 1.0):
        page.mouse.move(x + share * across, y - share * up)
        page.wait_for_timeout(60)
    page.mouse.up()
    page.wait_for_timeout(150)


def crossover(page: Any) -> float:
    return float(page.input_value("#speed-field"))


def peak(page: Any) -> float:
    """Ms, as it is said."""
    return float(page.inner_text("[data-figure=sensitivity_peak] b"))


@pytest.mark.skipif(not STAGE.exists(), reason="NOT TESTED: the measured stage is not in ../shared")
def test_a_notch_and_the_bandwidth_on_a_stage_that_was_measured(empty: Any) -> None:
    """By the published model of the stage its second mode is at 89.17 Hz: the notch begins there, and the loop is then
    four times faster within the same limit, on 423 measured lines.
    """
    opened = empty.open(1280, 900)
    page = opened.page
    opened.go("import")
    brought(opened, STAGE)
    page.get_by_label("Response of the table").select_option("Pp2")
    page.get_by_label("Response of the motor's encoder").select_option("Pp1")
    page.fill("#import-rate", "4000")
    page.fill("#import-unit", "m/N")
    tuned_on(opened)
    begun = crossover(page)
    page.fill("#speed-field", str(4.0 * begun))
    page.keyboard.press("Enter")
    opened.settled()
    assert page.get_attribute("#verdict", "class") == "bad"  # the mode is in the way
    page.keyboard.press("Control+z")
    opened.settled()
    page.click("#add-filter")
    page.wait_for_selector("[data-grip='filters.0.width']")
    opened.settled()
    assert float(page.input_value("[id='number-filters.0.frequency']")) == pytest.approx(89.17, rel=0.02)
    page.fill("#speed-field", str(4.0 * begun))
    page.keyboard.press("Enter")
    opened.settled()
    assert page.get_attribute("#verdict", "class") == "good"
    assert crossover(page) > 3.0 * begun
    depth = page.input_value("[id='number-filters.0.damping_zero']")
    moved(page, "filters.0.frequency", 0, 10)
    opened.settled()
    assert float(page.input_value("[id='number-filters.0.damping_zero']")) > float(depth)
    assert opened.said == []
    opened.context.close()


def response(loop: Any, reading: str, seed: int) -> Any:
    """From the command, with its own error on each line."""
    true = fd.linearize(loop, ["cut"], [reading]).response(LINES).response
    a, b = np.random.default_rng(seed).standard_normal((2, LINES.size))
    values = true + 0.003 * np.abs(true) * (a + 1j * b) / np.sqrt(2.0)
    return fd.FRF(LINES, values, "force", reading, "m/N", loop.sample_time, variance=(0.003 * np.abs(true)) ** 2)


def test_poles_are_dragged_on_responses_of_three_positions(empty: Any, tmp_path: Path) -> None:
    """Pole placement (Gordon & Erkorkmaz) on a screw that is measured at three tables: the worst of them leads."""
    machine = fd.read_machine("ball_screw")
    loop = machine.loop(None)
    text = machine_text(machine, "x", control_with(loop, "pole_placement"))
    (tmp_path / "placed.toml").write_text(text, encoding="utf-8")
    mass = float(tree.get(loop, "axis.x.plant.mass_load"))
    files = [tmp_path / f"{name}.csv" for name in ("near", "middle", "far")]
    for k, (path, share) in enumerate(zip(files, (0.7, 1.0, 1.4), strict=True)):
        there = tree.vary(loop, {"axis.x.plant.mass_load": share * mass})
        fd.write_frf(path, response(there, "reading_load", k), response(there, "reading_motor", k + 10))
    opened = empty.open(1280, 900)
    page = opened.page
    opened.go("import")
    brought(opened, files[0], *files[1:], tmp_path / "placed.toml")
    page.get_by_label("Today's machine").select_option("placed.toml")
    for path in files[1:]:
        page.check(f"[id='at-{path.name}']")
    tuned_on(opened)
    said, begun = page.inner_text("#verdict"), peak(page)
    assert "Worst of 3 places:" in said
    page.click("#see summary")
    page.check("#see-poles")
    page.wait_for_selector("[data-grip='law.axial_frequency']")
    page.click("#see summary")
    assert "poles that the law places" in page.inner_text("#poles-said")
    bandwidth = float(page.input_value("[id='number-law.bandwidth']"))
    moved(page, "law.bandwidth", -12, 0)
    opened.settled()
    assert float(page.input_value("[id='number-law.bandwidth']")) > 1.05 * bandwidth
    assert peak(page) > begun
    damping = float(page.input_value("[id='number-law.axial_damping']"))
    moved(page, "law.axial_frequency", -10, 0)
    opened.settled()
    assert float(page.input_value("[id='number-law.axial_damping']")) > damping
    for _ in range(2):
        page.keyboard.press("Control+z")
        opened.settled()
    assert page.inner_text("#verdict") == said
    assert opened.said == []
    opened.context.close()
