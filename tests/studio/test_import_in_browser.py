"""The import step in a browser: a row that is edited stays where it is and keeps the focus, and files wait."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from test_studio_import import RATED, RUN, written

from conftest import Studio
from plain_drive import Cascade, PlainAxis, write_columns


@pytest.fixture(scope="module")
def empty(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A server without a source."""
    made = Studio(browser, tmp_path_factory.mktemp("empty"))
    yield made
    made.close()


def rows(page: Any) -> list[tuple[str, float]]:
    """Name and height on the screen of each row of the table of columns."""
    found = page.locator("#columns-of-log tbody tr")
    return [(each.locator("th").inner_text(), each.bounding_box()["y"]) for each in found.all()]


def drop(page: Any, path: Path) -> None:
    """Drop a file on the page, as from the desktop."""
    page.evaluate(
        """([name, text]) => {
            const held = new DataTransfer();
            held.items.add(new File([text], name));
            document.dispatchEvent(new DragEvent("drop", { dataTransfer: held }));
        }""",
        [path.name, path.read_text(encoding="utf-8")],
    )


def test_a_log_is_assigned_while_another_one_arrives(empty: Any, tmp_path: Path) -> None:
    first, second = (written(tmp_path / name) for name in ("first.csv", "second.csv"))
    page = (opened := empty.open(1280, 800)).page
    page.set_input_files("#files", str(first))
    page.wait_for_selector("#columns-of-log tr")
    opened.settled()
    before = rows(page)
    assert [name for name, _ in before] == ["t_s", "load", "spare", "target", "actual"]
    chosen = page.get_by_label("Role of spare", exact=True)
    chosen.focus()
    page.keyboard.type("exc")  # a list is chosen from by the first letters
    opened.settled()
    assert chosen.input_value() == "excitation"
    assert page.evaluate("document.activeElement.getAttribute('aria-label')") == "Role of spare"
    assert rows(page) == before
    factor = page.get_by_label("Factor of spare", exact=True)
    factor.focus()
    page.keyboard.type("2.")  # not finished: a person is still typing
    drop(page, second)
    page.wait_for_selector(".waits:has-text('second.csv')")
    page.wait_for_selector(".waits:has-text('log, waits until the open file is done')")
    opened.settled()
    page.keyboard.type("5")
    assert factor.input_value() == "2.5"
    assert factor.evaluate("each => each === document.activeElement")
    assert [name for name, _ in rows(page)] == [name for name, _ in before]  # of the first log still
    assert page.locator(".files [aria-pressed=true]").inner_text() == "first.csv"
    page.get_by_label("Remove second.csv").click()
    opened.settled()
    assert page.locator(".files li").count() == 1
    assert factor.input_value() == "2.5"
    assert opened.said == []
    opened.context.close()


def test_percent_asks_for_the_rated_value_in_its_row(empty: Any, tmp_path: Path) -> None:
    page = (opened := empty.open(1280, 800)).page
    page.set_input_files("#files", str(written(tmp_path / "first.csv")))
    page.wait_for_selector("#columns-of-log tr")
    rated = page.get_by_label("Rated value of load", exact=True)
    page.get_by_label("Role of load", exact=True).select_option("force")
    opened.settled()
    places = rows(page)
    line = page.locator("#columns-of-log tr:has(th:has-text('load'))").first
    assert "force: enter its rated value" in line.inner_text()
    rated.fill(str(RATED))
    page.keyboard.press("Tab")
    opened.settled()
    assert page.get_by_label("Factor of load", exact=True).input_value() == "12"
    assert page.get_by_label("Unit of Rated value of load").evaluate("each => each === document.activeElement")
    assert "you gave rated 1200 N / 100" in line.inner_text()
    assert rows(page) == places
    page.select_option("[aria-label='Unit of Rated value of load']", "A")
    opened.settled()
    assert page.locator("#error").is_hidden()  # the constant of the motor is still to be entered
    page.get_by_label("Motor constant of load", exact=True).fill("0.5")
    page.keyboard.press("Tab")
    opened.settled()
    assert page.get_by_label("Factor of load", exact=True).input_value() == "6"
    page.reload()
    page.wait_for_selector("#columns-of-log tr")
    assert rated.input_value() == "1200"
    assert page.get_by_label("Motor constant of load", exact=True).input_value() == "0.5"
    assert opened.said == []
    opened.context.close()


def test_the_table_of_columns_has_no_serious_violation_of_accessibility(empty: Any, tmp_path: Path) -> None:
    page = (opened := empty.open(1280, 800)).page
    page.set_input_files("#files", [str(written(tmp_path / name)) for name in ("first.csv", "second.csv")])
    page.wait_for_selector(".waits:has-text('log')")
    page.get_by_label("Role of load", exact=True).select_option("torque")
    opened.settled()
    page.locator("#columns-of-log summary:visible").click()
    for look in ("light", "dark"):
        assert opened.barriers() == [], look
        page.click("#dark")
    assert page.evaluate("document.documentElement.scrollWidth") <= 1280
    opened.context.close()


def test_an_axis_and_a_unit_are_chosen_beside_the_peak_figures(empty: Any, tmp_path: Path) -> None:
    names = {"t_s": RUN["time"]}
    for axis, share in (("X1", 1.0), ("Y1", 0.4)):
        names |= {f"{axis}_target": 1e3 * share * RUN["set"], f"{axis}_actual": 1e3 * share * RUN["position"]}
    page = (opened := empty.open(1280, 800)).page
    page.set_input_files("#files", str(write_columns(tmp_path / "two.csv", names)))
    page.wait_for_selector("#check-question:has-text('Does this look like your machine?')")
    opened.settled()
    shown = page.locator("#columns-of-log tbody tr:visible th")
    assert shown.all_inner_texts() == ["t_s", "X1_target", "X1_actual"]
    assert page.locator(".cards .bad dt").all_inner_texts() == ["travel", "speed", "acceleration"]  # in m
    page.click("button:has-text('X1_actual is in mm')")
    opened.settled()
    assert page.locator(".cards .bad").count() == 0
    assert page.locator(".cards strong").all_inner_texts()[0] == "150.1 mm"
    assert page.get_by_label("Unit of X1_target", exact=True).input_value() == "mm"
    page.select_option("#axis-of-log", "y1")
    opened.settled()
    assert shown.all_inner_texts() == ["t_s", "Y1_target", "Y1_actual"]
    page.check("#columns-of-all-axes")
    assert shown.all_inner_texts() == ["t_s", "X1_target", "X1_actual", "Y1_target", "Y1_actual"]
    assert opened.said == []
    opened.context.close()


def test_a_second_log_of_the_same_axis_is_pooled_with_the_first(empty: Any, tmp_path: Path) -> None:
    paths = list[Path]()
    for name, law in (("one.csv", Cascade(30.0, 9000.0)), ("two.csv", Cascade(24.0, 8000.0))):
        run = PlainAxis(mass=180.0).run(law)
        shown = {"t_s": run["time"], "force_N": run["force"], "target_mm": 1e3 * run["set"]}
        paths.append(write_columns(tmp_path / name, {**shown, "actual_mm": 1e3 * run["position"]}))
    first, second = paths
    page = (opened := empty.open(1280, 800)).page
    page.set_input_files("#files", str(first))
    page.wait_for_selector("#identify")
    opened.settled()
    assert page.get_by_text("their values are pooled").count() == 0  # there is no other log yet
    drop(page, second)
    page.wait_for_selector(".waits:has-text('two.csv')")
    opened.settled()
    further = page.get_by_role("group", name="their values are pooled").get_by_label("two.csv")
    further.check()
    page.click("#identify")
    assert opened.ended() == "done"
    assert page.locator("h2:has-text('Result: one.csv and two.csv')").count() == 1
    assert page.locator(".waits").count() == 0  # the second log was used, too, and needs no turn of its own
    assert "2 logs" in page.get_by_role("region", name="Result").inner_text()
    assert further.is_checked()
    assert opened.said == []
    opened.context.close()
