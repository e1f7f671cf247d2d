"""`feeddrive adjust`: filters and numbers of a control in its machine file, which keeps all else as it is written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import feeddrive as fd
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError


def pack(machine: Any) -> list[tuple[str, dict[str, float]]]:
    return [(each.kind, dict(tree.leaves(each))) for each in machine.loop(None).control.filters]


def test_filters_are_removed_and_added_and_numbers_set(tmp_path: Path) -> None:
    """The file that is written is read back to the same control; what stays keeps its unit and its comments."""
    before = fd.read_machine("ball_screw")
    found = fd.workflow.adjust(
        "ball_screw",
        remove=("filters.0",),
        add=("notch:frequency=222,damping_pole=0.3",),
        set=("filters.0.frequency=2000", "filters.1.damping_zero=0.1", "law.Kv=90"),
        out=tmp_path / "m.toml",
    )
    wanted = [
        ("low_pass2", {"frequency": 2000.0, "damping": 0.7}),
        ("notch", {"frequency": 222.0, "damping_zero": 0.1, "damping_pole": 0.3}),
    ]
    assert pack(found) == pack(fd.read_machine(tmp_path / "m.toml")) == wanted
    text = (tmp_path / "m.toml").read_text(encoding="utf-8")
    assert "frequency_kHz = 2.0  # was 2.5" in text
    head = before.file.text.partition("[axis.x.control.law]")[0]
    assert text.startswith(head)


def test_added_and_removed_again_the_control_is_the_same(tmp_path: Path) -> None:
    fd.workflow.adjust("ball_screw", add=("notch:frequency=222",), out=tmp_path / "more.toml")
    back = fd.workflow.adjust(tmp_path / "more.toml", remove=("filters.2",))
    assert pack(back) == pack(fd.read_machine("ball_screw"))


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({}, "nothing to do: give --set"),
        ({"remove": ("filters.5",)}, r"no filters\.5 to remove"),
        ({"remove": ("law",)}, r"--remove law: write each filter once as filters\.0"),
        ({"remove": ("filters.0", "filters.0")}, "each filter once"),
        ({"add": ("notch",)}, "needs frequency in Hz"),
        ({"add": ("notch:frequency=99999",)}, "below half the sample rate"),
        ({"remove": ("filters.1",), "set": ("filters.1.damping=1",)}, r"no number 'filters\.1\.damping'"),
    ],
)
def test_what_cannot_be_done_says_why(given: Any, reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        fd.workflow.adjust("ball_screw", **given)


def test_a_list_in_one_line_is_not_half_removed(tmp_path: Path) -> None:
    text = fd.read_machine("ball_screw").file.text
    begin, end = text.index("[[axis.x.control.filters]]"), text.index("[[axis.x.control.feedforward]]")
    line = "[axis.x.control]\nfilters = [{kind = 'notch', frequency = 460}]\n"
    path = tmp_path / "inline.toml"
    path.write_text((text[:begin] + text[end:]).replace("[axis.x.control]\n", line), encoding="utf-8")
    with pytest.raises(FeeddriveError, match=r"write axis\.x\.control\.filters as a section"):
        fd.workflow.adjust(path, remove=("filters.0",))


def test_limits_of_the_machine_are_written_too(tmp_path: Path) -> None:
    """What the table says was set stands in the file, also beside the law: force limit and guard."""
    path = tmp_path / "m.toml"
    fd.workflow.adjust("ball_screw", set=("force_limit=5000", "guard.velocity_limit=2"), out=path)
    before, control = (fd.read_machine(each).loop(None).control for each in ("ball_screw", path))
    assert before.guard is not None
    assert control.force_limit == 5000.0
    wanted = replace(before.guard, velocity_limit=2.0)
    assert dict(tree.leaves(control.guard)) == dict(tree.leaves(wanted))


def test_a_control_without_a_guard_gets_one(tmp_path: Path) -> None:
    """And nothing else in the file moves; a second call changes it."""
    text = fd.read_machine("ball_screw").file.text
    begin, end = text.index("[axis.x.control.guard]"), text.index("[axis.x.control.law]")
    path = tmp_path / "bare.toml"
    path.write_text(text[:begin] + text[end:], encoding="utf-8")
    assert fd.read_machine(path).loop(None).control.guard is None
    fd.workflow.adjust(path, guard="following_error_limit=0.002, velocity_limit=1.5", out=tmp_path / "m.toml")
    made = fd.read_machine(tmp_path / "m.toml")
    guard = made.loop(None).control.guard
    assert guard is not None
    assert (guard.following_error_limit, guard.velocity_limit, guard.travel_most) == (0.002, 1.5, None)
    assert made.file.text.startswith(path.read_text(encoding="utf-8").rstrip())
    again = fd.workflow.adjust(tmp_path / "m.toml", guard="travel_most=0.4").loop(None).control.guard
    assert again is not None
    assert (again.following_error_limit, again.travel_most) == (0.002, 0.4)


@pytest.mark.parametrize(
    ("guard", "reason"),
    [
        ("velocity", "--guard velocity: write it as NAME=VALUE"),
        ("velocity_limt=1", "no number 'velocity_limt'; did you mean velocity_limit"),
        ("velocity_limit=fast", "'fast' is no number"),
        ("velocity_limit=-1", "must be > 0"),
    ],
)
def test_a_guard_that_cannot_be_says_why(guard: str, reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        fd.workflow.adjust("ball_screw", guard=guard)


@pytest.mark.parametrize("given", [{"set": ("law.Kv=90", "law.Kv=80")}, {"guard": "velocity_limit=1,velocity_limit=2"}])
def test_a_number_that_is_given_twice_is_refused(given: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match="is given twice: leave one out"):
        fd.workflow.adjust("ball_screw", **given)


def test_a_control_that_gets_a_guard_can_be_exported_and_holds_a_hanging_axis(tmp_path: Path) -> None:
    """10 kg hang: the force while the loop is off is their weight, and the next command is the export."""
    from feeddrive.files.machine import BUNDLED
    from feeddrive.language.progress import Progress
    from feeddrive.workflow.command import load

    whole = (BUNDLED / "machines" / "emps.toml").read_text(encoding="utf-8")
    text = re.sub(r"(?ms)^\[axis\.x\.control\.guard\]\n.*?(?=^\[)", "", whole)
    path = tmp_path / "machine.toml"
    for forces, held in (("", 0.0), ('\n[[axis.x.forces]]\nkind = "gravity"\nforce_N = -98.1\n', 98.1)):
        path.write_text(text + forces, encoding="utf-8")
        command = load("adjust")
        done = command.run(command.build_request(machine=path, guard="velocity_limit=0.5", out=path), Progress())
        guard = fd.read_machine(path).loop(None).control.guard
        assert guard is not None
        assert (guard.velocity_limit, guard.safe_force) == (0.5, held)
        assert done.then == f"feeddrive export {path} -t c"
