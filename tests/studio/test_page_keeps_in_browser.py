"""What a person writes, chooses and has in focus stays, whatever the server says meanwhile, or no longer says."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as arrow
import pytest
from pyarrow import parquet

import feeddrive as fd
from plain_drive import Cascade, PlainAxis, write_columns


def focus(page: Any) -> str:
    """The name of the element that has the focus."""
    return str(page.evaluate("document.activeElement.id"))


def test_a_search_takes_no_words_and_no_focus_away(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("optimize")
    page.click("#tune-start")
    page.wait_for_selector("#job[data-state=running]")
    field = page.locator("#room-optimize input[type=text]").first
    field.fill("1.2")
    field.press("End")
    field.press("3")
    name = focus(page)
    words = page.inner_text("#job")
    # a quick machine may have ended the search before its words were read
    changed = (
        "words => (job => job.innerText !== words || job.dataset.state !== 'running')(document.querySelector('#job'))"
    )
    page.wait_for_function(changed, arg=words, timeout=60_000)
    page.wait_for_timeout(1_000)  # of 5 messages a second
    assert (focus(page), field.input_value()) == (name, "1.23")
    page.focus("#tune-start")
    page.wait_for_timeout(1_000)
    assert focus(page) == "tune-start"
    said = page.inner_text("#job-said")
    assert said.endswith(("done", "canceled")) or ": running" in said  # a quick machine may have found it by now
    assert not re.search(r"\d of \d", said)  # counts are seen and not read aloud
    # or it would search beside the tests that follow; looked at and clicked at once, since it may end between the two
    page.evaluate("() => { const cancel = document.querySelector('#cancel'); if (!cancel.hidden) cancel.click(); }")


# where the button stands at each change of what is said beside it
_BOXES = """
() => {
  window.boxes = [];
  const job = document.querySelector("#job");
  const seen = () => {
    if (!/waiting|running/.test(job.dataset.state ?? "") || job.hidden) return;
    const { x, y, width, height } = document.querySelector("#cancel").getBoundingClientRect();
    window.boxes.push([[x, y, width, height].join(" "), job.innerText]);
  };
  new MutationObserver(seen).observe(job, { subtree: true, childList: true, characterData: true, attributes: true });
}
"""


def test_the_cancel_button_stays_where_it_is_while_a_job_reports_its_steps(studio: Any) -> None:
    """A click that is aimed at it must not miss: neither longer words nor more lines of them may move it."""
    page = (opened := studio.open(700, 800)).page
    opened.go("compare")
    page.evaluate(_BOXES)
    page.click("#compare-start")
    page.wait_for_function("() => new Set(window.boxes.map(([, words]) => words)).size >= 3", timeout=60_000)
    page.click("#cancel")
    assert opened.ended() == "canceled"
    boxes = {box for box, _ in page.evaluate("window.boxes")}
    assert len(boxes) == 1, boxes
    opened.context.close()


def test_what_is_said_of_an_ended_work_can_be_closed(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("compare")
    page.click("#compare-start")
    page.wait_for_selector("#job[data-state=running]")
    page.click("#cancel")
    assert opened.ended() == "canceled"
    page.click("#job-close")
    assert page.locator("#job").is_hidden()
    opened.go("tune")
    opened.go("optimize")
    assert page.locator("#job").is_hidden()  # messages of other things do not show it again


@pytest.mark.slow(reason="one more start of the page")
def test_a_zoom_keeps_the_place_that_was_chosen(studio: Any) -> None:
    page = (opened := studio.open()).page
    opened.go("program")
    for stage in ("plan", "run"):
        page.click(f"#program-{stage}-now")
        assert opened.ended() == "done"
    page.locator("#program-worst button").nth(1).click()
    opened.settled()
    legend = page.inner_text("#program-place .legend")
    page.focus("#program-feed .surface")
    page.keyboard.press("+")
    opened.settled()
    opened.go("tune")
    opened.go("program")
    assert page.locator("#program-worst button").nth(1).get_attribute("aria-pressed") == "true"
    assert page.inner_text("#program-place .legend") == legend


def test_fields_of_a_guard_that_are_half_filled_stay(served: Callable[..., Any], tmp_path: Path) -> None:
    text = fd.read_machine("linear_motor").file.text
    law = "[axis.x.control]\n[axis.x.control.law]\nkind = 'cascade_ppi'\nKv = 60\nKp = 2e4\n"  # no guard
    (tmp_path / "bare.toml").write_text(text[: text.index("[axis.x.control]")] + law, encoding="utf-8")
    page = (opened := served(str(tmp_path / "bare.toml")).open()).page
    opened.go("export")
    field = page.locator("#room-export .fields input").first
    field.fill("0.25")
    name = focus(page)
    page.evaluate("document.querySelector('#tab-export').click()")  # the room is shown again, and the focus stays
    opened.settled()
    assert (focus(page), field.input_value()) == (name, "0.25")
    opened.go("tune")
    page.fill("[id='number-law.Kv']", "55")  # the commands are others then
    page.keyboard.press("Enter")
    opened.settled()
    opened.go("export")
    assert page.locator(f"#{name}").input_value() == "0.25"
    assert page.locator("button[aria-label='Copy: Python']").count() == 1


def test_files_that_are_refused_are_all_named_where_it_can_be_seen(served: Callable[..., Any], tmp_path: Path) -> None:
    page = (opened := served().open()).page
    opened.go("tune")
    assert "Import a machine or a measured response" in page.inner_text("#room-tune")
    assert page.locator("#room-tune button:visible").all_inner_texts() == ["Import a machine or a measured response"]
    page.evaluate(
        """() => {
            const held = new DataTransfer();
            for (const name of ["one?.nc", "two?.nc"]) held.items.add(new File(["x"], name));
            document.dispatchEvent(new DragEvent("drop", { dataTransfer: held }));
        }"""
    )
    page.wait_for_selector("#room-import [role=alert]:has-text('two?.nc')")
    assert "one?.nc" in page.inner_text("#room-import [role=alert]")
    log = tmp_path / "run.parquet"
    parquet.write_table(arrow.table({name: 1e-3 * np.arange(200) for name in ("t_s", "x")}), log)
    page.set_input_files("#files", str(log))
    assert opened.ended() == "done"
    assert page.input_value("#files") == ""  # the same file can be chosen again
    page.click("#room-import .files button[aria-pressed]")
    opened.settled()
    page.select_option("#import-machine", "xy_table")
    page.fill("#import-pitch", "10")
    page.click("#tab-tune")
    opened.go("import")
    assert (page.input_value("#import-machine"), page.input_value("#import-pitch")) == ("xy_table", "10")


def test_a_server_that_has_ended_stays_said_and_one_that_is_back_does_not(served: Callable[..., Any]) -> None:
    server = served("xy_table", "--axis", "x")
    page = server.open().page
    page.wait_for_selector("#verdict:not(:empty)")
    server.server.kill()
    page.wait_for_selector("#lost:has-text('The connection to the server was lost')")
    page.click("#tab-import")
    page.wait_for_selector("#lost:has-text('The server has ended')", timeout=15_000)
    page.click("#tab-tune")
    assert page.locator("#lost button").is_visible()


def test_a_connection_that_breaks_comes_back_and_keeps_what_is_being_typed(studio: Any) -> None:
    opened = studio.open()
    page = opened.page
    page.close()
    page = opened.context.new_page()
    page.add_init_script(
        "const Real = WebSocket;"
        "window.WebSocket = class extends Real { constructor(at) { super(at); window.held = this } }"
    )
    page.goto(studio.address)
    page.wait_for_selector("#verdict:not(:empty)")
    page.fill("[id='number-law.Kp']", "-1")
    page.evaluate("window.held.close()")
    page.wait_for_selector("#lost:visible")
    page.wait_for_selector("#lost", state="hidden")
    opened.page = page
    opened.settled()
    field = "document.activeElement.id + ' ' + document.activeElement.value"
    assert page.evaluate(field) == "number-law.Kp -1"
    page.keyboard.press("Enter")
    page.wait_for_selector("#error:has-text('must be > 0')")


def test_a_dark_system_is_told_by_the_button_and_a_choice_stays(browser: Any, studio: Any) -> None:
    context = studio.admit(browser.new_context(color_scheme="dark"))
    page = context.new_page()
    page.goto(studio.address)
    page.wait_for_selector("#dark[aria-pressed=true]")
    page.click("#dark")
    page.reload()
    page.wait_for_selector("#dark[aria-pressed=false]")
    assert page.get_attribute("html", "data-look") == "light"
    context.close()


@pytest.mark.slow(reason="a browser and an identification; what the page asks for is checked quickly elsewhere")
def test_what_is_typed_of_a_column_is_what_it_is_read_by(served: Callable[..., Any], tmp_path: Path) -> None:
    """A factor that is typed before the role stays; text that is no number is refused, and not left out."""
    run = PlainAxis(mass=180.0).run(Cascade(30.0, 9000.0))
    log = write_columns(
        tmp_path / "axis.csv",
        {
            "t_s": run["time"],
            "x_cmd [mm]": 1e3 * run["set"],
            "x_fb [mm]": -1e3 * run["position"],
            "load [%]": run["force"] / 12.0,
        },
    )
    page = (opened := (studio := served()).open()).page
    page.set_input_files("#files", str(log))
    page.wait_for_selector("#identify")

    def field(what: str, column: str) -> Any:
        return page.get_by_label(f"{what} of {column}", exact=True)

    def typed(what: str, column: str, text: str) -> None:
        field(what, column).fill(text)
        field(what, column).press("Tab")
        opened.settled()

    assert field("Unit", "load").get_attribute("placeholder") == "percent"
    typed("Factor", "load", "12")
    typed("Factor", "x_fb", "-1")  # in mm, as the field beside it says
    assert (field("Unit", "x_fb").input_value(), field("Factor", "x_fb").input_value()) == ("mm", "-1")
    assert field("Factor", "load").input_value() == "12"  # the table was drawn anew meanwhile
    field("Role", "load").select_option("force")
    opened.settled()
    typed("Factor", "load", "12")  # that of another quantity, as which it was guessed, is gone
    typed("Factor", "load", "1.200,5")
    assert "factor must be a number, not '1.200,5'" in page.inner_text("body")
    assert field("Factor", "load").input_value() == "12"  # by which it is read
    field("Role", "x_cmd").select_option("force")
    opened.settled()
    assert (field("Role", "x_cmd").input_value(), field("Unit", "x_cmd").input_value()) == ("force", "")
    for column, role in (("x_cmd", "setpoint_position"), ("load", "force")):
        field("Role", column).select_option(role)
        opened.settled()
    typed("Factor", "load", "12,0")
    page.click("#identify")
    page.wait_for_selector("#take-identified", timeout=60e3)
    (machine,) = studio.folder.rglob("identified_*/machine.toml")
    assert float(fd.read_machine(machine).loop("x").axis.plant.mass) == pytest.approx(180.0, rel=5e-4)  # type: ignore[attr-defined]
