"""`feeddrive circle` from logs and from a machine: tables, report, figures, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from feeddrive.cli.commands import app
from feeddrive.language.errors import CancelledError, FeeddriveError
from feeddrive.workflow.circle import circle
from feeddrive.workflow.command import Command


def write_log(path: Path, direction: int, feed: float, squareness: float = 0.0, turns: float = 1.6) -> Path:
    """A circle of 50 mm about (120, 80) mm with an error of squareness, in mm at 500 Hz, with run-in and run-out."""
    radius, T = 0.05, 2e-3
    end = 2.0 * np.pi * turns * radius / feed
    t = np.arange(0.0, end + 0.6, T)
    ramp = 0.3
    angle = (
        direction
        * feed
        / radius
        * (
            np.clip(t, 0.0, ramp) ** 2 / (2.0 * ramp)
            + np.clip(t - ramp, 0.0, end - ramp)
            + np.where(t > end, np.clip(t - end, 0, ramp) - np.clip(t - end, 0, ramp) ** 2 / (2.0 * ramp), 0.0)
        )
    )
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    rows = np.column_stack([t, 120.0 + 1e3 * (x + squareness * y), 80.0 + 1e3 * y])
    np.savetxt(path, rows, delimiter=",", header="time [s],X,Y", comments="", fmt="%.9f")
    return path


def logs(folder: Path) -> list[Path]:
    return [
        write_log(folder / f"{'ccw' if d > 0 else 'cw'}_{round(1e3 * feed)}.csv", d, feed, 60e-6)
        for feed in (0.05, 0.1)
        for d in (1, -1)
    ]


@pytest.mark.slow(reason="5 s: a report with three pictures, and a fit of over a hundred columns")
def test_logs_give_figures_causes_and_a_report(tmp_path: Path) -> None:
    out = tmp_path / "circles"
    given = ["circle", *map(str, logs(tmp_path)), "--x", "X:mm", "--y", "Y:mm", "--out", str(out)]
    found = CliRunner().invoke(app, given)
    assert found.exit_code == 0, found.output
    assert "circular test after ISO 230-4: R 50 mm in XY" in found.output
    assert "Next:" not in found.output  # logs name no machine file to tune
    figures = json.loads((out / "circle.json").read_text())
    assert figures["radius_m"] == pytest.approx(0.05)
    causes = {each["name"]: each for each in figures["causes"]}
    assert causes["squareness"]["value"] == pytest.approx(60e-6, rel=0.02)
    both = [each for each in figures["figures"] if each["both_directions"]]
    assert len(both) == 2
    assert all(each["G_m"] == pytest.approx(60e-6 * 0.05, rel=0.01) for each in both)
    page = (out / "report.html").read_text()
    assert "Circle plot" in page
    assert "squareness" in page


def test_one_log_names_what_is_missing(tmp_path: Path) -> None:
    outcome = circle.run(circle.request((write_log(tmp_path / "a.csv", 1, 0.05, 60e-6),), x="X:mm", y="Y:mm"))
    assert any("One direction only" in each for each in outcome.remarks)
    assert any("run CW, run a second feed" in each for each in outcome.remarks)
    assert outcome.result.causes["squareness"].error == np.inf


@pytest.mark.slow(reason="5 s: four simulated circles of the bundled table with stick and slip")
def test_a_machine_runs_its_circles(tmp_path: Path) -> None:
    out = tmp_path / "table"
    found = CliRunner().invoke(app, ["circle", "xy_table", "--radius", "10", "--out", str(out)])
    assert found.exit_code == 0, found.output
    figures = json.loads((out / "circle.json").read_text())
    causes = {each["name"]: each for each in figures["causes"]}
    assert causes["reversal spike y"]["draws_m"] > 2e-5  # 120 N of friction that nothing feeds forward
    assert "Next: feeddrive tune xy_table --axis y" in found.output
    assert [each["name"] for each in figures["figures"]][:2] == ["CCW 1200 mm/min", "CW 1200 mm/min"]


@pytest.mark.slow(reason="5 s: circles of the bundled mill, and a fit")
def test_further_axes_stand_and_feeds_are_in_mm_per_min(tmp_path: Path) -> None:
    out = tmp_path / "mill"
    found = CliRunner().invoke(app, ["circle", "mill", "--radius", "5", "--feed", "3000", "--out", str(out)])
    assert found.exit_code == 0, found.output
    names = [each["name"] for each in json.loads((out / "circle.json").read_text())["figures"]]
    assert names == ["CCW 3000 mm/min", "CW 3000 mm/min", "3000 mm/min"]


def test_a_repeated_option_with_a_unit_is_in_si(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []

    def kept(_: object, request: Any, progress: object) -> None:
        seen.append(request)
        raise CancelledError("enough")

    monkeypatch.setattr(Command, "run", kept)
    CliRunner().invoke(app, ["circle", "mill", "--feed", "1200", "--feed", "6000"])
    assert seen[0].feed == pytest.approx((0.02, 0.1))


def test_what_does_not_fit_is_named(tmp_path: Path) -> None:
    short = write_log(tmp_path / "short.csv", 1, 0.05, turns=0.8)
    named = {"x": "X:mm", "y": "Y:mm"}
    xy_table = Path("xy_table")
    for sources, options, said in (
        ((short,), named, "no full circle"),
        ((short,), named | {"x": "A:mm"}, "'A'"),
        ((xy_table,), {"x": "u"}, "no axis 'u'; it has x, y"),
        ((xy_table,), {"radius": 0.5}, "axis 'x' travels 350 mm"),
        ((xy_table,), {"radius": 2e-3, "feed": (0.1,)}, "at 6000 mm/min the axes settle too late: give a lower --feed"),
        ((xy_table, short), {}, "give it alone"),
        ((tmp_path / "missing.csv",), named, r"missing\.csv"),
    ):
        with pytest.raises(FeeddriveError, match=said):
            circle(sources, **options, out=tmp_path / "out")  # type: ignore[arg-type]
        assert not (tmp_path / "out").exists()
