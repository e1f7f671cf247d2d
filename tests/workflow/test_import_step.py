"""The import step of a log: rated values, axes, peak figures, and wrong guesses, which are never silent."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from column_logs import drawn, motion, written
from feeddrive.cli.commands import app
from feeddrive.files import Mapping as Roles
from feeddrive.files.columns import Column
from feeddrive.files.mapping import Guess, log_preview, role_doubts
from feeddrive.files.read_log import read_log
from feeddrive.language.errors import FeeddriveError, LogError, ParameterError
from feeddrive.workflow.channels import CHOSEN, channels, proposed, told_of
from feeddrive.workflow.force import DriveValues
from feeddrive.workflow.identify import identify
from slow_share import all_but

RUN = motion(1)


def heads(changed: Mapping[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
    columns = {"t [s]": RUN.time, "x_set [mm]": 1e3 * RUN.set_position, "x_act [mm]": 1e3 * RUN.table}
    return {**columns, "force [N]": RUN.force, **(changed or {})}


def without_set(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Without the set position: of a log that has none, no law is searched, which takes 3 s."""
    return {head: values for head, values in columns.items() if not head.startswith("x_set")}


def mass(path: Path, **options: object) -> float:
    """The identified mass over the true one."""
    return identify(path, **options).rigid["mass"].value / RUN.mass  # type: ignore[arg-type]


# rated values


@pytest.mark.parametrize(
    ("head", "signal", "options"),
    [
        ("force [%]", 100.0 / RUN.rated, {"rated": f"{RUN.rated:g}N"}),
        ("force [0.1 %]", 1000.0 / RUN.rated, {"rated": f"{RUN.rated:g} N"}),
        ("torque [%]", 100.0 * 0.01 / (2.0 * np.pi) / 3.2, {"rated": "3.2Nm", "lead": 0.01}),
        ("current [A]", 1.0 / 80.0, {"motor_constant": 80.0}),
        ("current [mA]", 1e3 * 0.01 / (2.0 * np.pi) / 0.5, {"torque_constant": 0.5, "lead": 0.01}),
        ("u [V]", 10.0 / 2500.0, {"at_full": "2500:N"}),
        ("output", 1.0 / 1500.0, {"full": 1.0, "at_full": "1500:N"}),
        # a head without a unit: who gives a constant has no column in N
        ("force", 1.0 / 80.0, {"motor_constant": 80.0}),
        ("force", 1.0 / 80.0, {"motor_constant": 80.0, "force": "force"}),
        ("force", 100.0 / RUN.rated, {"rated": f"{RUN.rated:g}N"}),
        ("torque", 0.01 / (2.0 * np.pi) / 0.5, {"torque_constant": 0.5, "lead": 0.01}),
        ("force", 1.0, {"motor_constant": 80.0, "force": "force:N"}),
        ("force [N]", 1.0, {"motor_constant": 80.0}),
    ],
)
def test_the_values_of_the_drive_make_newtons_of_a_signal(
    head: str, signal: float, options: dict[str, object], tmp_path: Path
) -> None:
    """2 %: the table trails the motor, on which the force acts, and the mass is that of a rigid axis."""
    columns = without_set(heads())
    columns[head] = signal * columns.pop("force [N]")
    path = written(tmp_path / "log.csv", columns)
    assert mass(path, **options) == pytest.approx(1.0, rel=0.02)


def test_the_table_shows_the_columns_that_were_named(tmp_path: Path) -> None:
    """With their factors, so that force and mass beside it are those of the fit."""
    columns = without_set(heads())
    columns["u"] = 0.01 * columns.pop("force [N]")
    path = written(tmp_path / "log.csv", columns)
    result = CliRunner().invoke(app, ["identify", str(path), "--force", "u*100:N", "--out", str(tmp_path / "o")])
    row = next(line for line in result.output.splitlines() if line.split()[:2] == ["force", "u"])
    assert "named on the command line" in row
    peak = next(line for line in result.output.splitlines() if line.strip().startswith("largest force"))
    assert float(peak.split()[2]) == pytest.approx(np.max(np.abs(RUN.force)), rel=0.1)


def test_what_is_missing_for_percent_is_asked_for_where_the_column_is(tmp_path: Path) -> None:
    columns = without_set(heads())
    columns["torque [%]"] = columns.pop("force [N]") / 20.0
    path = written(tmp_path / "log.csv", columns)
    guess = channels(path)
    (row,) = (row for row in guess.proposed() if row.column == "torque")
    assert (row.role, row.asks, row.option) == ("torque", "rated", "--rated")
    assert any("give what 100 % is, as --rated 3.2:Nm" in remark for remark in told_of(guess))
    with pytest.raises(
        LogError, match=r"'torque' is in percent of a rated torque: give what 100 % is, as --rated 3\.2:Nm"
    ):
        identify(path)
    with pytest.raises(ParameterError, match=r"'torque' is in percent .*--rated"):
        identify(path, torque="torque:percent")
    # a rated current alone is not enough, and the option that is missing is named
    with pytest.raises(ParameterError, match="--torque-constant"):
        channels(path, rated="5.6:A")
    # the peak of the signal and the acceleration of 100 % need no rated value
    assert guess.preview is not None
    shown = str(guess.preview)
    assert "100 % would give, without friction" in shown
    assert "76.8" in shown or "%" in shown
    done = channels(path, rated="3.2:Nm", out=tmp_path / "roles.toml")
    assert done.mapping["torque"] == Column(name="torque", factor=0.032)
    assert "rated 3.2 N m / 100" in done.mapping.reasons["torque"]
    # the written roles hold the factor, so that no rated value is needed again
    assert identify(path, channels=tmp_path / "roles.toml", lead=0.01).rigid["mass"].value > 0.0


# axes


def test_each_axis_of_a_log_is_identified_on_its_own(tmp_path: Path) -> None:
    first, second = motion(1), motion(6)
    rows = min(first.table.size, second.table.size)
    assert first.T == second.T
    columns = {"time [s]": first.time[:rows]}
    for axis, run in (("X1", first), ("Y1", second)):
        if run is first:  # which must not be taken for that of the other axis
            columns[f"{axis}_CommandPosition [mm]"] = 1e3 * run.set_position[:rows]
        columns[f"{axis}_ActualPosition [mm]"] = 1e3 * run.table[:rows]
        columns[f"{axis}_CurrentFeedback [A]"] = run.force[:rows] / 80.0
        columns[f"{axis}_DCBusVoltage [V]"] = 600.0 + np.sin(np.arange(rows))
    columns["S1_ActualPosition [mm]"], columns["S1_CurrentFeedback [A]"] = np.zeros(rows), np.zeros(rows)
    path = written(tmp_path / "log.csv", columns)
    done = identify.run(identify.request(path, axis="all", motor_constant=80.0))
    for axis, run in (("x1", first), ("y1", second)):
        assert done.result[axis].rigid["mass"].value == pytest.approx(run.mass, rel=0.03)
    assert set(done.result) == {"x1", "y1"}
    assert any("axis s1 is not identified" in remark for remark in done.remarks)
    one = identify(path, axis="Y1", motor_constant=80.0)
    assert one.rigid["mass"].value == pytest.approx(second.mass, rel=0.03)
    with pytest.raises(ParameterError, match="no channel names the axis 'z'; there are: x1, y1, s1"):
        identify(path, axis="z", motor_constant=80.0)
    guesses = channels(path, axis="all", out=tmp_path / "roles.toml")
    assert set(guesses) == {"x1", "y1", "s1"}
    assert guesses["x1"].mapping["setpoint_position"].name == "X1_CommandPosition"
    assert "setpoint_position" not in guesses["y1"].mapping
    assert (tmp_path / "roles_y1.toml").exists()
    told = told_of(guesses["x1"])
    assert told[0].startswith("the log holds 3 axes; these are the columns of x1. The others: --axis y1, --axis s1")
    with pytest.raises(ParameterError, match="--axis all identifies each axis of a log by its own columns"):
        identify(path, axis="all", position="X1_ActualPosition")


# peak figures


def test_peak_figures_are_in_the_units_of_the_user(tmp_path: Path) -> None:
    """x = 0.1 m sin(2π t/s): 0.628 m/s and 3.95 m/s² = 0.40 g; 30 kg and 10 N of friction take 128 N."""
    t = 1e-3 * np.arange(4000)
    w = 2.0 * np.pi
    x = 0.1 * np.sin(w * t)
    f = -30.0 * w**2 * x + 10.0 * np.sign(np.cos(w * t))
    path = written(tmp_path / "log.csv", {"t": t, "x [in]": x / 0.0254, "f [kN]": f / 1e3})
    guess = proposed(path)
    assert guess.preview is not None
    shown = str(guess.preview)
    for words in ("7.874 in", "24.7", "in/min", "3.95 m/s2 (0.4 g)", "0.1284 kN", "30", "force over mass"):
        assert words in shown, words
    assert guess.preview.mass == pytest.approx(30.0, rel=0.01)
    assert guess.preview.per_mass == pytest.approx(0.1 * w**2 + 1.0 / 3.0, rel=0.01)
    assert "Does this look like your machine? travel 7.874 in" in guess.preview.sentence()
    panels = guess.chart().panels
    assert [panel.label for panel in panels] == ["position\n(in)", "speed\n(in/s)", "force\n(N)"]
    # 4 of 8000 points: the extremes of stretches
    assert max(curve.x.size for panel in panels for curve in panel.curves) <= 1003


def test_channels_and_identify_show_the_peaks_before_the_fit(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", heads())
    for line in (["channels", str(path)], ["identify", str(path), "--out", str(tmp_path / "o")]):
        done = CliRunner().invoke(app, line)
        assert done.exit_code == 0, done.output
        assert "does this look like your machine?" in done.output
        assert "112.2 mm" in done.output
        assert "--position 'x_act:mm'" in done.output
    report = (tmp_path / "o" / "report.html").read_text(encoding="utf-8")
    assert "The motion in the log" in report


def test_a_length_without_a_unit_is_asked_about(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", {"t": RUN.time, "x": 1e3 * RUN.table, "force": RUN.force})
    told = "\n".join(told_of(channels(path)))
    assert "the travel is 112 m, where feed drives have" in told
    assert "--unit mm for all columns that state none, or for one as --position 'x:mm'" in told


# wrong guesses

SECOND = motion(3)
_N = min(RUN.table.size, SECOND.table.size)


def swapped(columns: dict[str, np.ndarray], a: str, b: str) -> dict[str, np.ndarray]:
    return {**columns, a: columns[b], b: columns[a]}


# what is wrong, the columns, the kind of the contradiction, and what must be said
WRONG: dict[str, tuple[Callable[[], dict[str, np.ndarray]], str, str]] = {
    "set and actual": (
        lambda: swapped(heads(), "x_set [mm]", "x_act [mm]"),
        "swapped",
        "--set-position 'x_act:mm' --position 'x_set:mm'",
    ),
    "motor and table": (
        lambda: {**without_set(heads()), "x_motor [mm]": 1e3 * RUN.table, "x_act [mm]": 1e3 * RUN.motor},
        "encoders",
        "position_motor = 'x_act' and position_load = 'x_motor'",
    ),
    "a velocity as position": (
        lambda: {"t": RUN.time, "x_act [mm]": 1e3 * RUN.velocity, "force [N]": RUN.force},
        "velocity",
        "looks like a velocity",
    ),
    "position and velocity": (
        lambda: {**heads(), "x_act [mm]": 1e3 * RUN.velocity, "v_act [mm/s]": 1e3 * RUN.table},
        "velocity",
        "'x_act' is the rate of change of 'v_act'",
    ),
    "another axis": (
        lambda: {name: values[:_N] for name, values in {**heads(), "x_set [mm]": 1e3 * SECOND.set_position}.items()},
        "axis",
        "they are of different axes, or one of them is another quantity",
    ),
    "the sign of the position": (
        lambda: heads({"x_act [mm]": -1e3 * RUN.table}),
        "sign",
        "--position 'x_act*-1.0:mm'",
    ),
    "the sign of the force": (lambda: heads({"force [N]": -RUN.force}), "sign", "--force 'force*-1.0:N'"),
    "the unit of the setpoint": (
        lambda: {"x_set [m]" if name == "x_set [mm]" else name: values for name, values in heads().items()},
        "unit",
        "--set-position 'x_set:mm'",
    ),
    "a power as force": (
        lambda: heads({"force [N]": RUN.force * RUN.velocity}),
        "force",
        "looks like a power, not like a force",
    ),
    "a bus voltage beside the force": (
        lambda: {**heads({"force [N]": 600.0 + np.sin(np.arange(RUN.time.size))}), "aux": RUN.force},
        "force",
        "'aux' follows it to 100 %: --force 'aux'",
    ),
    "position and force": (
        lambda: {"t": RUN.time, "x_act [mm]": RUN.force, "force [N]": 1e3 * RUN.table},
        "swapped",
        "position and force are exchanged",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_guess_is_refused_with_its_cause_and_its_cure(what: str, tmp_path: Path) -> None:
    make, kind, words = WRONG[what]
    path = written(tmp_path / "log.csv", make())
    guess = channels(path)
    found = [doubt.why for doubt in guess.doubts if doubt.kind == kind and words in doubt.why]
    assert len(found) == 1, guess.doubts
    assert found[0] in told_of(guess)
    with pytest.raises(FeeddriveError):
        identify(path, out=tmp_path / "out")
    assert not (tmp_path / "out" / "machine.toml").exists()


def test_right_columns_have_no_contradiction(tmp_path: Path) -> None:
    columns = heads({"x_motor [mm]": 1e3 * RUN.motor, "v_act [mm/s]": 1e3 * RUN.velocity})
    guess = channels(written(tmp_path / "log.csv", columns))
    assert guess.doubts == ()
    moving = {"setpoint_position", "position_motor", "position_load", "velocity_load"}
    assert set(guess.mapping) == {"time", *moving, "force"}


def test_a_contradiction_stops_only_what_nobody_told(tmp_path: Path) -> None:
    """Motor and table exchanged: refused as guessed, in a file of a guess too; done if a person says so."""
    columns = {**without_set(heads()), "x_motor [mm]": 1e3 * RUN.table, "x_act [mm]": 1e3 * RUN.motor}
    path = written(tmp_path / "log.csv", columns)
    guess = channels(path, out=tmp_path / "roles.toml")
    with pytest.raises(LogError, match="motor and table are exchanged"):
        identify(path)
    with pytest.raises(LogError, match="motor and table are exchanged"):
        identify(path, channels=tmp_path / "roles.toml")
    reasons = dict.fromkeys(guess.mapping.reasons, CHOSEN)
    chosen = dataclasses.replace(guess.mapping, reasons=reasons)
    assert identify(path, channels=chosen).rigid["mass"].value == pytest.approx(RUN.mass, rel=0.02)


def test_roles_that_a_person_changed_are_judged_again(tmp_path: Path) -> None:
    path = written(tmp_path / "log.csv", WRONG["set and actual"][0]())
    log = read_log(path)
    guess: Guess = proposed(path)
    right = Roles(
        {
            **guess.mapping.columns,
            "setpoint_position": guess.mapping["position_load"],
            "position_load": guess.mapping["setpoint_position"],
        }
    )
    assert [doubt.kind for doubt in role_doubts(log, guess.mapping)] == ["swapped"]
    assert role_doubts(log, right) == ()
    preview = log_preview(log, right)
    assert preview is not None
    assert preview.mass == pytest.approx(RUN.mass, rel=0.02)


@pytest.mark.parametrize("seed", all_but([2], [2, 13], "one more drawn file"))
def test_a_drawn_file_gives_its_mass(seed: int, tmp_path: Path) -> None:
    """Percent and two axes, by a style and units that are drawn; the bar of the import is 5 %."""
    file = drawn(seed, tmp_path)
    values = DriveValues(**file.options)  # type: ignore[arg-type]
    guess = proposed(file.path, values=values)
    axis = next((axis for axis in guess.axes if axis.startswith(file.axis)), file.axis)
    found = identify(file.path, axis=axis, **file.options)  # type: ignore[arg-type]
    assert found.rigid["mass"].value == pytest.approx(file.motion.mass, rel=0.05), file.said
