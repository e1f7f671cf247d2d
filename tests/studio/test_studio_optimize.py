"""A goal is set and searched for: limits are dragged, a search is stopped, and what it found is taken or not."""

from __future__ import annotations

import math
import time
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

import feeddrive as fd
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.studio.bench import bench_of
from feeddrive.studio.desk import Asked, Said
from feeddrive.studio.jobs import CANCELLED, DONE
from feeddrive.studio.rooms.export import recipe_of
from feeddrive.studio.server import Session

SLOW = "ball_screw"  # its search takes long enough to be stopped


@pytest.fixture
def begin(tmp_path: Path) -> Iterator[Callable[[str], Session]]:
    made = list[Session]()

    def one(machine: str) -> Session:
        folder = tmp_path / f"page_{len(made)}"
        folder.mkdir()
        made.append(Session(folder, bench_of(machine)))
        return made[-1]

    yield one
    for each in made:
        each.close()


def do(session: Session, what: str, **more: Any) -> Said:
    """An act; what is wrong with it is raised."""
    room, _, act = what.partition(".")
    found = session.rooms[room].do(act, Asked(more))
    assert isinstance(found, Said)
    return found


def done(session: Session) -> str:
    """The end of the job."""
    assert session.desk.job is not None
    session.desk.job.join(120.0)
    return session.desk.job.state.state


def test_a_level_that_is_dragged_is_a_limit_of_search_and_of_tuning_by_hand(begin: Callable[[str], Session]) -> None:
    session = begin("linear_motor")
    said = do(session, "optimize.level", field="max_ms", value=20.0 * math.log10(1.7))
    level = next(each for each in said.words["levels"] if each["field"] == "max_ms")
    assert level["picture"] == "sensitivity"
    assert 10.0 ** (level["at"] / 20.0) == pytest.approx(1.7)
    assert session.rooms["optimize"]._request().max_ms == 1.7  # type: ignore[attr-defined]
    judged = do(session, "tune.show").words["judged"]
    assert any("Ms <= 1.7" in each["text"] for each in judged)
    do(session, "optimize.level", field="max_ms", value=1e6)  # far out of the picture: no limit
    do(session, "optimize.level", field="max_compliance", value=25.0)  # N/um
    assert session.rooms["optimize"]._request().max_compliance == pytest.approx(4e-8)  # type: ignore[attr-defined]
    assert do(session, "optimize.set", field="max_compliance", value="").words["fields"]
    assert session.rooms["optimize"]._request().max_compliance is None  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("act", "more"),
    [
        ("level", {"field": "max_compliance", "value": 0.0}),
        ("level", {"field": "max_compliance", "value": -3.0}),
        ("level", {"field": "max_compliance", "value": 1e-320}),
        ("level", {"field": "phase_margin", "value": 30.0}),
        ("set", {"field": "max_ms", "value": "0.9"}),
        ("set", {"field": "max_ms", "value": "much"}),
        ("set", {"field": "starts", "value": "1.5"}),
        ("set", {"field": "starts", "value": "1e999"}),
        ("set", {"field": "out", "value": "/elsewhere"}),
    ],
)
def test_a_goal_that_cannot_be_is_refused_and_the_one_before_stays(
    begin: Callable[[str], Session], act: str, more: dict[str, Any]
) -> None:
    session = begin("linear_motor")
    do(session, "optimize.level", field="max_ms", value=4.0)
    before = dict(session.rooms["optimize"].settings)  # type: ignore[attr-defined]
    with pytest.raises(FeeddriveError):
        do(session, f"optimize.{act}", **more)
    assert session.rooms["optimize"].settings == before  # type: ignore[attr-defined]


def test_a_search_that_was_stopped_gives_its_best_which_is_said_to_be_unproven(
    begin: Callable[[str], Session], tmp_path: Path
) -> None:
    session = begin(SLOW)
    goal, before = session.rooms["optimize"], dict(session.desk.values)
    with pytest.raises(FeeddriveError, match="nothing was found yet"):
        do(session, "optimize.accept")
    do(session, "optimize.tune")
    until = time.monotonic() + 60.0
    while len(goal.costs) < 2 and time.monotonic() < until:  # type: ignore[attr-defined]
        time.sleep(0.01)
    with pytest.raises(FeeddriveError, match="cancel it first"):
        do(session, "optimize.reject")
    session.answer({"number": 1, "do": "job.cancel"})
    assert done(session) == CANCELLED
    said = do(session, "optimize.show").words
    assert (said["best"], said["unfinished"], said["found"]) == (True, True, None)
    costs = list(goal.costs)  # type: ignore[attr-defined]
    assert costs == sorted(costs, reverse=True)
    assert session.desk.values == before  # nothing is taken before a person accepts
    best = goal.best  # type: ignore[attr-defined]
    assert do(session, "optimize.accept").words["go"] == "tune"
    assert numbers(session.desk.control) == numbers(best)
    assert do(session, "optimize.show").words["best"] is False
    do(session, "tune.undo")
    assert session.desk.values == before
    do(session, "tune.redo")
    do(session, "export.machine")
    check_repeated(session, tmp_path / "again")
    assert "tune" not in [each.command for each in session.desk.done]  # a search that was stopped proves nothing


def numbers(control: Any) -> dict[str, Any]:
    """All of a control by name, and the kinds of its parts."""
    parts = [control.law, *control.filters, *control.feedforward]
    return {"kinds": [each.kind for each in parts], **dict(tree.leaves(control))}


def check_repeated(session: Session, folder: Path) -> None:
    """The recipe in Python writes the machine file that the page gives, with the numbers of now in seven digits."""
    folder.mkdir()
    own = session.desk.folder
    exec(recipe_of(session.desk).python.replace(str(own), str(folder)))  # as a person would run it
    text = (folder / "machine.toml").read_text(encoding="utf-8")
    assert text == (own / "machine.toml").read_text(encoding="utf-8")
    check_alike(fd.read_machine(folder / "machine.toml").loop(None).control, session.desk.control)


def check_alike(written: Any, control: Any) -> None:
    """The same parts, and the same numbers in the seven digits of a machine file."""
    there, wanted = numbers(written), numbers(control)
    assert there.keys() == wanted.keys()
    assert there.pop("kinds") == wanted.pop("kinds")
    for name, value in wanted.items():
        assert there[name] == (pytest.approx(value, rel=1e-6) if isinstance(value, float) else value), name


def test_what_was_found_is_accepted_and_taken_away(begin: Callable[[str], Session], tmp_path: Path) -> None:
    session = begin("linear_motor")
    do(session, "optimize.set", field="starts", value="1")
    do(session, "optimize.tune")
    assert done(session) == DONE
    said = do(session, "optimize.show").words
    assert said["found"]["verdict"]
    assert "cascade" in do(session, "optimize.show").charts  # of the report; the others the room draws
    assert not said["unfinished"]
    found = session.rooms["optimize"].result.result.control  # type: ignore[attr-defined]
    do(session, "optimize.accept")
    check_alike(session.desk.control, found)
    do(session, "export.export", target="parameters")
    assert done(session) == DONE
    said = do(session, "export.show").words
    assert said["results"] == [{"name": "tuned", "said": ""}]
    archive = said["exports"]["parameters"]["archive"]
    given = do(session, "export.result", name="tuned").words["give"]
    for name in (archive, given):
        with zipfile.ZipFile(BytesIO((session.desk.folder / name).read_bytes())) as packed:
            assert packed.testzip() is None
            assert all(each.startswith(name.removesuffix(".zip") + "/") for each in packed.namelist())
            assert len(packed.namelist()) > 1
    assert not any("an earlier control" in each for each in said["exports"]["parameters"]["said"])
    do(session, "tune.undo")
    (result,) = do(session, "export.show").words["results"]
    assert result["said"].startswith("This result belongs to an earlier control")
    shown = do(session, "export.show").words["exports"]["parameters"]
    assert shown["said"][0] == "This result belongs to an earlier control. Run it again for the current one."
    do(session, "tune.redo")
    assert do(session, "export.show").words["exports"]["parameters"] == said["exports"]["parameters"]
    do(session, "export.machine")
    check_repeated(session, tmp_path / "again")
    job = tomllib.loads(recipe_of(session.desk).job)
    assert job["machine"]


def test_a_search_is_not_begun_beside_another_work_and_what_was_found_stays(begin: Callable[[str], Session]) -> None:
    session = begin("linear_motor")
    do(session, "optimize.set", field="starts", value="1")
    do(session, "optimize.tune")
    assert done(session) == DONE
    found = session.rooms["optimize"].result  # type: ignore[attr-defined]
    do(session, "compare.start", laws=[], starts=2)
    do(session, "tune.move", name="law.Kp", value=0.9 * session.desk.values["law.Kp"])
    for act in ("optimize.tune", "prove.certify", "export.machine", "import.bundled"):
        with pytest.raises(FeeddriveError, match="wait for its end, or cancel it"):
            do(session, act, name="emps")
    assert session.rooms["optimize"].result is found  # type: ignore[attr-defined]
    assert not (session.desk.folder / "machine.toml").exists()
    before = dict(session.desk.values)
    assert do(session, "optimize.reject").words["best"] is False
    with pytest.raises(FeeddriveError, match="nothing was found yet"):
        do(session, "optimize.accept")
    assert session.desk.values == before


def test_the_picture_reaches_up_to_a_limit_that_can_be_dragged(begin: Callable[[str], Session]) -> None:
    session = begin("linear_motor")
    for peak, seen in (("1.7", True), ("4", True), ("1e9", False)):
        do(session, "optimize.set", field="max_ms", value=peak)
        said = do(session, "optimize.show")
        (level,) = (each for each in said.words["levels"] if each["field"] == "max_ms")
        panel = said.charts["sensitivity"].panels[0]
        assert panel.high is not None
        assert (panel.high > level["at"]) is seen
        assert panel.high > max(each.y.max() for each in panel.curves)


def test_the_limits_hold_over_the_box_that_is_chosen_and_the_worst_plant_is_drawn(
    begin: Callable[[str], Session],
) -> None:
    session = begin("linear_motor")
    said = do(session, "optimize.show").words
    assert next(each for each in said["fields"] if each["name"] == "box")["value"] == "auto"
    assert "every mass ±30 %" in said["over"]
    do(session, "optimize.set", field="box", value="none")
    assert "at the model only" in do(session, "optimize.show").words["over"]
    with pytest.raises(FeeddriveError, match="standard error"):
        do(session, "optimize.set", field="box", value="identified")
    with pytest.raises(FeeddriveError, match="stiffness=0"):
        do(session, "optimize.set", field="box", value="a large one")
    assert "at the model only" in do(session, "optimize.show").words["over"]  # the box before stays
    do(session, "optimize.set", field="box", value="mass=20%")
    do(session, "optimize.set", field="starts", value="1")
    do(session, "optimize.tune")
    assert done(session) == DONE
    shown = do(session, "optimize.show")
    curves = {curve.name: curve for curve in shown.charts["sensitivity"].panels[0].curves}
    found, worst = (max(curves[name].y) for name in ("found", "found, worst plant"))
    # of the limit of Ms, 2 or 6.02 dB, the worst plant uses all; 0.05 dB are half a percent of Ms
    assert worst == pytest.approx(20.0 * math.log10(2.0), abs=0.05)
    assert found < worst - 0.2
    tables = [part for section in shown.words["found"]["sections"] for part in section["parts"]]
    assert any("beside the worst plant" in part.get("title", "") for part in tables)


def test_laws_are_compared_over_the_box_that_is_chosen(begin: Callable[[str], Session]) -> None:
    session = begin("linear_motor")
    said = do(session, "compare.show").words
    assert said["box"] == "auto"
    assert "every mass ±30 %" in said["over"]
    with pytest.raises(FeeddriveError, match="stiffness"):
        do(session, "compare.over", box="huge")
    do(session, "compare.over", box="none")
    assert "at the model only" in do(session, "compare.show").words["over"]
    do(session, "compare.over", box=" ")
    assert do(session, "compare.show").words["box"] == "auto"
    do(session, "compare.over", box="mass=10%")
    do(session, "compare.choose", laws=["P-PI"])
    do(session, "compare.start", starts=1)
    assert session.desk.done[-1:] == [] or session.desk.done[-1].command != "compare"
    assert done(session) == DONE
    do(session, "compare.show")
    assert session.desk.done[-1].request.box == "mass=10%"  # type: ignore[union-attr]
    sections = do(session, "compare.show").words["found"]["sections"]
    assert any("at the worst plant of the box" in str(part) for section in sections for part in section["parts"])
