"""`commission.json`: what goes on, what is done again, and that no record leads out of its folder."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from feeddrive.commissioning.record import (
    FILE,
    FORMAT,
    Commissioned,
    Step,
    digests,
    read_commissioned,
    read_record,
    remove_stale,
    write_record,
)
from feeddrive.commissioning.trial import Figures
from feeddrive.language.errors import FileError

DRIVE = "bus = 'ethercat'\n"
ASKED = {"small_move": {"goal": "rope-snap", "max_ms": "2.0"}}
INSIDE = {"0x6060": "8", "0x6072": "3000"}
FOUND = Figures(following_rms=1e-5, following_peak=3e-5, stiffness=2e7, force_noise=1.0, position_noise=1e-8)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A commissioning of three steps with files, within a folder that holds others."""
    folder = tmp_path / "axis"
    steps = []
    for number, name in enumerate(("listen", "small_move", "start_law"), start=1):
        place = folder / f"{number}_{name}"
        (place / "deep").mkdir(parents=True)
        (place / "log.csv").write_text(f"{name}\n")
        (place / "deep" / "more.csv").write_text(f"{name} and more\n")
        files = [f"{place.name}/log.csv", f"{place.name}/deep/more.csv"]
        steps.append(Step(name, f"{name} is done", {"mass": 80.0 + number}, digests(folder, files), INSIDE))
    write_record(
        folder, DRIVE, ASKED, INSIDE, steps, {"where": "station 1", "kept": False, "questions": 2, "refusal": "no"}
    )
    return folder


def changed(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    path = folder / FILE
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))


def names(folder: Path) -> list[str]:
    record = read_record(folder, DRIVE, ASKED)
    assert record is not None
    return [step.name for step in record.steps]


# whole


def test_what_is_written_is_read(folder: Path) -> None:
    record = read_record(folder, DRIVE, ASKED)
    assert record is not None
    assert record.inside == INSIDE
    assert [step.name for step in record.steps] == ["listen", "small_move", "start_law"]
    assert record.steps[1].figures == {"mass": 82.0}
    assert record.steps[1].says == "small_move is done"
    assert record.steps[1].inside == INSIDE
    assert (record.stale, record.again) == ((), "")


def test_a_folder_without_a_record_begins_anew(tmp_path: Path) -> None:
    assert read_record(tmp_path, DRIVE, ASKED) is None
    assert read_record(tmp_path / "nothing", DRIVE, ASKED) is None


def test_the_result_of_a_folder_has_its_steps_and_figures(folder: Path) -> None:
    found = read_commissioned(str(folder))
    assert isinstance(found, Commissioned)
    assert (found.where, found.kept, found.questions, found.refusal, found.rotary) == (
        "station 1",
        False,
        2,
        "no",
        False,
    )
    assert found["small_move"].figures["mass"] == 82.0
    assert found.figures["mass"] == 83.0, "of the last step that says one"
    assert found.trial is None
    with pytest.raises(KeyError):
        found["trial"]
    text = str(found.table())
    assert "Commissioning of station 1" in text
    assert "start_law is done" in text


@pytest.mark.parametrize("with_before", [False, True])
def test_the_figures_of_the_trial_are_read(folder: Path, with_before: bool) -> None:
    closing: dict[str, Any] = {"predicted": FOUND.values(), "measured": FOUND.values(), "kept": True, "rotary": True}
    if with_before:
        closing["before"] = FOUND.values()
    write_record(folder, DRIVE, ASKED, INSIDE, (), closing)
    found = read_commissioned(folder)
    assert found.kept
    assert found.rotary
    assert found.trial is not None
    assert found.trial.predicted == found.trial.measured == FOUND
    assert found.trial.before == (FOUND if with_before else None)


# files that are not as they were


@pytest.mark.parametrize(
    ("file", "left"),
    [
        ("1_listen/log.csv", []),
        ("2_small_move/deep/more.csv", ["listen"]),
        ("3_start_law/log.csv", ["listen", "small_move"]),
    ],
)
@pytest.mark.parametrize("gone", [False, True])
def test_a_step_whose_file_is_altered_or_gone_is_done_again_with_all_after_it(
    folder: Path, file: str, left: list[str], gone: bool
) -> None:
    if gone:
        (folder / file).unlink()
    else:
        (folder / file).write_text("other numbers\n")
    record = read_record(folder, DRIVE, ASKED)
    assert record is not None
    assert [step.name for step in record.steps] == left
    assert record.again == f"{folder / file} is not what its step wrote"
    assert len(record.stale) == 2 * (3 - len(left))


@pytest.mark.parametrize(
    ("now", "says"),
    [
        ({"goal": "least-error", "max_ms": "2.0"}, "--goal was rope-snap and is now least-error"),
        ({"goal": "rope-snap", "max_ms": "1.5"}, "--max-ms was 2.0 and is now 1.5"),
        ({"goal": "rope-snap"}, "--max-ms was 2.0 and is now not given"),
        ({**ASKED["small_move"], "filters": "kept"}, "--filters was not given and is now kept"),
    ],
)
def test_a_step_with_other_options_is_done_again_with_all_after_it(
    folder: Path, now: dict[str, str], says: str
) -> None:
    record = read_record(folder, DRIVE, {"small_move": now})
    assert record is not None
    assert [step.name for step in record.steps] == ["listen"]
    assert record.again == says
    assert len(record.stale) == 4


def test_a_figure_that_is_not_finite_is_null_for_every_reader_of_json(folder: Path) -> None:
    rigid = replace(FOUND, stiffness=math.inf)
    steps = [Step("listen", "still", {"stiffness": math.inf})]
    write_record(folder, DRIVE, ASKED, INSIDE, steps, {"predicted": rigid.values(), "measured": FOUND.values()})
    text = (folder / FILE).read_text()
    assert "Infinity" not in text
    assert json.loads(text)["predicted"]["stiffness"] is None
    found = read_commissioned(folder)
    assert found.trial is not None
    assert found.trial.predicted == rigid
    assert found["listen"].figures["stiffness"] == math.inf


def test_a_file_that_no_step_wrote_changes_nothing(folder: Path) -> None:
    (folder / "2_small_move" / "notes.txt").write_text("mine")
    (folder / "report.html").write_text("")
    assert names(folder) == ["listen", "small_move", "start_law"]


def test_a_folder_in_place_of_a_file_is_another_file(folder: Path) -> None:
    (folder / "2_small_move" / "log.csv").unlink()
    (folder / "2_small_move" / "log.csv").mkdir()
    assert names(folder) == ["listen"]


@pytest.mark.parametrize("drive", ["", DRIVE + "\n", DRIVE.replace("ethercat", "canopen")])
def test_the_record_of_another_drive_file_is_refused(folder: Path, drive: str) -> None:
    with pytest.raises(FileError, match=rf"{FILE}: is the record of another drive file, .* give another --out"):
        read_record(folder, drive, ASKED)


# what is no record


def without(key: str) -> Callable[[dict[str, Any]], None]:
    return lambda document: document.pop(key)


def step_without(key: str) -> Callable[[dict[str, Any]], None]:
    return lambda document: document["steps"][1].pop(key)


def step_with(**parts: Any) -> Callable[[dict[str, Any]], None]:
    return lambda document: document["steps"][1].update(parts)


@pytest.mark.parametrize(
    "change",
    [
        lambda document: document.update(format="feeddrive commission 2"),
        lambda document: document.update(steps=5),
        lambda document: document.update(steps=["listen"]),
        lambda document: document.update(inside=["0x6060"]),
        *[without(key) for key in ("format", "drive_sha256", "asked", "inside", "steps")],
        *[step_without(key) for key in ("name", "says", "figures", "files", "inside")],
        step_with(figures={"mass": "heavy"}),
        step_with(files="log.csv"),
    ],
)
def test_a_record_with_anything_missing_is_named_and_left_alone(
    folder: Path, change: Callable[[dict[str, Any]], None]
) -> None:
    changed(folder, change)
    text = (folder / FILE).read_text()
    with pytest.raises(FileError, match=rf"axis/{FILE}: is no record of a commissioning; give another --out"):
        read_record(folder, DRIVE, ASKED)
    assert (folder / FILE).read_text() == text


@pytest.mark.parametrize("text", ["", "{", "[]", "5", '"text"', "null", "[1, 2]"])
def test_a_file_that_is_no_object_is_no_record(folder: Path, text: str) -> None:
    (folder / FILE).write_text(text)
    for read in (lambda: read_record(folder, DRIVE, ASKED), lambda: read_commissioned(folder)):
        with pytest.raises(FileError, match="is no record of a commissioning"):
            read()


@pytest.mark.parametrize("figures", [{"predicted": {"stiffness": 1.0}}, {"measured": FOUND.values()}, {"predicted": 5}])
def test_half_of_a_trial_is_no_record(folder: Path, figures: dict[str, Any]) -> None:
    changed(folder, lambda document: document.update(figures))
    with pytest.raises(FileError, match="is no record of a commissioning"):
        read_commissioned(folder)


def test_the_format_has_a_number() -> None:
    assert FORMAT == "feeddrive commission 1"


# names that lead out


@pytest.mark.parametrize("name", ["../thesis.tex", "1_listen/../../thesis.tex", "{absolute}", "link/thesis.tex"])
def test_a_name_that_leads_out_of_the_folder_removes_nothing(folder: Path, name: str) -> None:
    thesis = folder.parent / "thesis.tex"
    thesis.write_text("years of work")
    (folder / "link").symlink_to(folder.parent)
    name = name.format(absolute=thesis)
    changed(folder, step_with(files={name: "0" * 64}))
    record = read_record(folder, DRIVE, ASKED)
    assert record is not None
    assert name in record.stale
    remove_stale(folder, record.stale)
    assert thesis.read_text() == "years of work"
    assert (folder / "1_listen" / "log.csv").exists()


@pytest.mark.parametrize("name", ["", ".", "1_listen", "1_listen/deep", "3_start_law/.."])
def test_a_name_of_a_folder_removes_no_folder(folder: Path, name: str) -> None:
    remove_stale(folder, [name])
    assert len(list(folder.rglob("*.csv"))) == 6


def test_a_link_is_removed_and_what_it_shows_stays(folder: Path) -> None:
    thesis = folder / "1_listen" / "log.csv"
    link = folder / "2_small_move" / "log.csv"
    link.unlink()
    link.symlink_to(thesis)
    remove_stale(folder, ["2_small_move/log.csv"])
    assert not os.path.lexists(link)
    assert thesis.exists()


def test_stale_files_go_with_the_folders_that_are_empty_then(folder: Path) -> None:
    (folder / "2_small_move" / "notes.txt").write_text("mine")
    names = [f"{n}/{f}" for n in ("2_small_move", "3_start_law") for f in ("log.csv", "deep/more.csv", "gone.csv")]
    remove_stale(folder, names)
    left = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    assert left == ["1_listen/deep/more.csv", "1_listen/log.csv", "2_small_move/notes.txt", FILE]
    assert not (folder / "2_small_move" / "deep").exists()
    assert not (folder / "3_start_law").exists()
    assert folder.is_dir()
