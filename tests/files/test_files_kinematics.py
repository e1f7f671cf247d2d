"""`[kinematics]` of machine files: the bundled trunnion, the way back, and every refusal with its remedy."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from feeddrive.files.machine import find_bundled, machine_of_text, machine_toml, planned_limits, read_machine
from feeddrive.language.errors import ParameterError
from feeddrive.path.five_axes import TableTable
from feeddrive.path.kinematics import Kinematics

TEXT = find_bundled("trunnion_ac", "machines").read_text(encoding="utf-8")


def test_the_bundled_trunnion_is_that_of_the_prototype() -> None:
    """Its equations, whose angles count the other way: those of the table in place of the tool's."""
    kinematics = read_machine("trunnion_ac").kinematics
    assert kinematics is not None
    rng = np.random.default_rng(2)
    x, y, z, a, c = rng.uniform(-1.0, 1.0, (5, 50))
    across, along = np.sin(c) * x + np.cos(c) * y, z - 0.08
    joints = (
        np.cos(c) * x - np.sin(c) * y,
        np.cos(a) * across - np.sin(a) * along,
        np.sin(a) * across + np.cos(a) * along,
    )
    assert np.abs(np.array(kinematics.linear((x, y, z), (-a, -c))) - joints).max() < 1e-15
    first, second = kinematics.joints
    assert (first.least, first.most) == pytest.approx((math.radians(-120.0), math.radians(30.0)))
    assert (second.least, second.most) == pytest.approx((-40.0 * math.pi, 40.0 * math.pi))
    limits = planned_limits(read_machine("trunnion_ac"), None)
    assert limits.letters == kinematics.letters == "XYZAC"
    expected = [[0.5, 5, 100, 5e4]] * 3 + [[5, 30, 600, 3e5], [10, 50, 1000, 5e5]]
    assert limits.array == pytest.approx(np.array(expected, float))


def test_a_machine_without_the_section_has_no_kinematics() -> None:
    assert read_machine("machining_center").kinematics is None


def test_the_text_that_is_written_gives_the_machine_back() -> None:
    file = machine_of_text(TEXT.replace("tool_length_mm = 0 ", "tool_length_mm = 120.5 "), "m.toml")
    text = machine_toml(file.machine(), "again", limits=file.limits, five_axes=file.five_axes)
    again = machine_of_text(text, "again.toml").kinematics
    assert again == file.kinematics
    assert again is not None
    assert again.tool == (0.0, 0.0, -0.1205)


def test_each_kind_is_read_as_its_constructor_builds_it() -> None:
    outer, pivot, work = (0.01, 0.02, 0.03), (0.0, 0.05, 0.25), (0.1, 0.2, -0.3)
    section = TEXT[TEXT.index("[kinematics]") : TEXT.index("[axis.x]")]
    rest = (("joints", '"AC"'), ("workpiece_mm", "[100, 200, -300]"), ("tool_length_mm", "80"), ("reversed", '"C"'))

    def read(**keys: str) -> Kinematics:
        keys |= {key: value for key, value in rest if key not in keys}
        lines = "\n".join(f"{key} = {value}" for key, value in keys.items())
        read = machine_of_text(TEXT.replace(section, f"[kinematics]\n{lines}\n"), "m.toml").kinematics
        assert read is not None
        return read.with_travel(dict.fromkeys("AC", (-math.inf, math.inf)))

    points = {"outer_mm": "[10, 20, 30]", "inner_mm": "[0, 50, 250]"}
    assert read(kind='"table_table"', nutating="true", **points) == Kinematics.of(
        "table_table", "AC", outer, pivot, work, 0.08, nutating=True, reversed_joints="C"
    )
    points = {"outer_mm": "[10, 20, 30]", "pivot_mm": "[0, 50, 250]"}
    assert read(kind='"head_head"', joints='"CA"', nutating="true", **points) == Kinematics.of(
        "head_head", "CA", outer, pivot, work, 0.08, nutating=True, reversed_joints="C"
    )
    points = {"pivot_mm": "[0, 50, 250]", "inner_mm": "[10, 20, 30]"}
    assert read(kind='"head_table"', **points) == Kinematics.of(
        "head_table", "AC", pivot, outer, work, 0.08, reversed_joints="C"
    )


WRONG = {
    "no offset": ("inner_mm = [0, 0, 0]", "#", "needs inner (m, x, y, z of a point on the axis of the second joint)"),
    "no tool": (
        "tool_length_mm = 0",
        "#",
        "needs tool_length (m, from the spindle's gauge point to the tip, >= 0 m and <= 100 m)",
    ),
    "no unit": ("outer_mm = [0", "outer = [300", "outer lies 300 m away, and 100 m is the most: check its unit"),
    "two numbers": ("outer_mm = [0, 0, 0]", "outer_mm = [0, 0]", "must be a row of at least 3 numbers"),
    "four numbers": ("outer_mm = [0, 0, 0]", "outer_mm = [0, 0, 0, 0]", "outer has 4 numbers: give x, y and z"),
    "no such joints": ('joints = "AC"', 'joints = "CC"', "kinematics.joints = 'CC' (rotary joint on the base"),
    "no axis": ('joints = "AC"', 'joints = "BC"', "the machine has no axis [axis.b] for its joint B; there are: x"),
    "no such kind": ('kind = "table_table"', 'kind = "trunnion"', "kinematics.kind = 'trunnion' is not known"),
    "negative": ("tool_length_mm = 0", "tool_length_mm = -3", "must be >= 0 m and <= 100 m (given as tool_length_mm"),
    "stranger": ('joints = "AC"', 'joints = "AC"\nreversed = "B"', "reversed names joint B, and the joints are AC"),
    "a force": ("workpiece_mm", "workpiece_N", "unit 'N' does not measure the same thing as 'm'"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_refused_with_its_line(name: str) -> None:
    old, new, message = WRONG[name]
    assert old in TEXT
    with pytest.raises(ParameterError) as error:
        machine_of_text(TEXT.replace(old, new, 1), "m.toml")
    assert message in str(error.value)
    line = int(str(error.value).split(":")[1])
    assert 7 <= line <= 13


@pytest.mark.parametrize(("far", "fine"), [(70.0, True), (150.0, False)])
def test_an_offset_beyond_100_m_is_one_in_a_wrong_unit(far: float, fine: bool) -> None:
    point, row = np.zeros(3), np.array([far, 0.0, 0.0])
    if fine:
        TableTable(joints="AC", outer=row, inner=point, workpiece=point, tool_length=far)
        return
    with pytest.raises(ParameterError, match="inner lies 150 m away"):
        TableTable(joints="AC", outer=point, inner=row, workpiece=point, tool_length=0.0)
    with pytest.raises(ParameterError, match="tool_length"):
        TableTable(joints="AC", outer=point, inner=point, workpiece=point, tool_length=far)


def test_a_joint_must_be_of_the_type_of_its_axis() -> None:
    linear = TEXT[: TEXT.index("[axis.c]")]
    part = TEXT[TEXT.index("[axis.y]") : TEXT.index("[axis.z]")].replace("axis.y", "axis.c")
    with pytest.raises(
        ParameterError, match=r"m.toml:7: .*joint C is rotary, and axis.c is linear: write rotary = true"
    ):
        machine_of_text(linear + part, "m.toml")
    turned = TEXT[TEXT.index("[axis.c]") :].replace("axis.c", "axis.y")
    swapped = TEXT.replace(TEXT[TEXT.index("[axis.y]") : TEXT.index("[axis.z]")], turned)
    with pytest.raises(ParameterError, match=r"joint Y is linear, and axis.y is rotary: leave rotary = true out there"):
        machine_of_text(swapped, "m.toml")


def test_a_directory_does_not_hide_the_bundled_file_of_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("dome", "results", "trunnion_ac"):
        (tmp_path / name).mkdir()
    assert find_bundled("dome", "programs", ".ngc").is_file()
    assert read_machine("trunnion_ac").kinematics is not None
    # another path of that name is the directory, which no reader takes for a program
    assert find_bundled(tmp_path / "dome", "programs", ".ngc") == tmp_path / "dome"
    (tmp_path / "trunnion_ac").rmdir()
    (tmp_path / "trunnion_ac").write_text("", encoding="utf-8")
    assert find_bundled("trunnion_ac", "machines") == Path("trunnion_ac")
