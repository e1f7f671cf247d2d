"""A part program on a machine: its figures against those that follow from the run itself, and the demo."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Observer
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.files.job import read_job
from feeddrive.jobs.run_laws import JobResult, run_laws
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import Run
from feeddrive.machining.contour import contour_error
from feeddrive.machining.load import MachineLoad
from feeddrive.machining.part_run import PartRun, disturbance_of, part_run
from feeddrive.workflow.run_job import DemoRequest, demo, run


@pytest.fixture(scope="module")
def circle() -> JobResult:
    """The bundled circle of two axes."""
    return run_laws(read_job("circle"))


def test_the_contour_error_of_a_circle_is_its_distance_from_the_radius(circle: JobResult) -> None:
    part = circle.parts["today"]
    away = np.hypot(part.contour.position[:, 0] - 0.1, part.contour.position[:, 1] - 0.1) - 0.02
    line = part.contour.line
    assert line is not None
    planned = np.hypot(part.contour.set_position[:, 0] - 0.1, part.contour.set_position[:, 1] - 0.1) - 0.02
    # the planner leaves the circle by up to P, 10 um, where two of its blocks join; 1 ms of lag away from there
    on = np.convolve(np.abs(planned) < 1e-10, np.ones(81), mode="same") == 81
    turns = np.isin(line, (7, 8)) & on
    assert np.count_nonzero(turns) > 5000
    # of a path of third degree between samples of 25 um: its distance from the circle is far below 1 nm
    np.testing.assert_allclose(np.abs(part.contour.error[turns]), np.abs(away[turns]), atol=1e-9)
    assert set(np.unique(line[part.contour.counted])) == {4, 6, 7, 8, 9}  # and the dwell, which is no path
    assert all(each.line in (6, 7, 8, 9) for each in part.worst())


def test_learning_dry_friction_takes_the_quadrants_out(circle: JobResult) -> None:
    """Required of the paper's circle: mass and viscous friction alone leave the quadrant glitches."""
    today, masses, dry = circle.parts.values()
    assert masses.contour.rms > 0.85 * today.contour.rms
    assert dry.contour.rms < 0.3 * today.contour.rms
    assert all(axis.glitches >= 4 for axis in today.axes.values())
    assert max(axis.glitch for axis in today.axes.values()) == pytest.approx(today.contour.largest, rel=1e-9)


def test_all_that_acts_on_an_axis_moves_it_with_its_drive(circle: JobResult) -> None:
    """m v' = drive + disturbance in each sample of a rigid axis; friction changes between its four substeps."""
    row = circle.rows[0]
    assert row.together is not None
    loop = circle.job.machines["today"].loops()["x"]
    acts = disturbance_of(row.together, loop, "x")
    velocity = row.together["x.velocity_load"]
    pushed = 120.0 * np.diff(velocity) / row.together.sample_time
    off = pushed - row.together["x.drive_force"][:-1] - acts[:-1]
    smooth = np.abs(velocity[:-1]) > 5e-3  # m/s: away from standstill, where friction is what it takes
    assert np.sqrt(np.mean(off[smooth] ** 2)) < 2e-3 * np.std(acts)


@pytest.mark.slow(reason="two reports with all their pictures")
def test_a_directory_of_results_runs_again_with_its_program(tmp_path: Path) -> None:
    job = tmp_path / "j.toml"
    job.write_text('machine = "xy_table"\n[program]\nfile = "p.ngc"\n', encoding="utf-8")
    (tmp_path / "p.ngc").write_text("G21 G90 G94\nG1 X10 Y5 F3000\nG1 X0\nM2\n", encoding="utf-8")
    run(job, out=tmp_path / "out")
    (tmp_path / "p.ngc").unlink()
    run(tmp_path / "out" / "job.toml", out=tmp_path / "again")
    first, again = (
        json.loads((tmp_path / name / "summary.json").read_text(encoding="utf-8")) for name in ("out", "again")
    )
    assert first["laws"] == again["laws"]
    assert first["program"]["cycle_time_s"] == again["program"]["cycle_time_s"]
    assert first["laws"]["today"]["x.following_error_peak_line"] in (2.0, 3.0)


@pytest.mark.slow(reason="the demo of the mill: a program of 40 s under six laws")
def test_the_demo_of_the_mill_compares_six_laws(tmp_path: Path) -> None:
    found = demo.run(DemoRequest("mill", out=tmp_path / "out")).result
    parts = found.parts
    today = parts["today"].contour.rms
    assert all(part.contour.rms < 0.5 * today for name, part in parts.items() if name != "today")
    assert min(parts, key=lambda name: parts[name].contour.rms) == "P-PI, learned feedforward"
    contour = parts["today"].contour
    assert contour.line is not None
    beside = np.isin(contour.line, (11, 12, 14, 27, 28, 30))  # ways in and out of the circle, beside the part
    assert 0.0 < np.sum(contour.weights[beside]) < 2e-3  # what is left of the arcs within the tolerance
    assert np.sum(contour.counted & np.isin(contour.line, (13, 29))) > 30_000
    assert all(verdict.growth is not None and verdict.growth < 1.0 for verdict in found.chatter)
    spindle = parts["today"].load.spindle
    assert spindle is not None
    assert spindle.specific_energy is not None
    # Ktc of 767 N/mm2 takes 0.767 J/mm3; the edges take the rest of thin chips
    assert 0.767e9 < spindle.specific_energy < 3e9
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert page.index("keeps the contour best") < page.index("<figure") < page.index("<table") < page.index("<details")
    for said in ("Worst places", "No cut chatters", "regenerative, over 3 earlier surfaces", "What limits the speed"):
        assert said in page


# ---------------------------------------------------------------- what decides: a case on either side of each bound

T, ROWS, TURN = 1e-3, 400, 150  # s; samples; x reverses between this sample and the next one
PLAIN = Loop(
    control=Control(law=CascadePPI(Kv=20.0, Kp=1e4, Tn=0.02)), axis=Axis(plant=Rigid(mass=100.0)), sample_time=T
)
MACHINE = Machine.of({"x": PLAIN, "y": PLAIN})


def turned(feed: float, **changed: np.ndarray) -> Run:
    """A parabola on which x reverses at 0.1 m/s² while y moves with a feed in m/s; `changed` signals of x."""
    k = np.arange(ROWS)
    time = T * (k - TURN - 0.5)
    zero = np.zeros(ROWS)
    signals: dict[str, np.ndarray] = {}
    motions = {"x": (-0.05 * time**2, -0.1 * time, zero - 0.1), "y": (feed * time, zero + feed, zero)}
    for axis, (position, velocity, acceleration) in motions.items():
        own = dict.fromkeys(
            ("following_error", "drive_force", "force", "load_force", "friction_motor", "friction_load"), zero
        )
        own |= dict.fromkeys(("set_position", "position_load", "position_motor", "reading_load"), position)
        own |= {"set_velocity": velocity, "velocity_load": velocity, "set_acceleration": acceleration}
        signals |= {f"{axis}.{name}": values for name, values in (own | (changed if axis == "x" else {})).items()}
    return Run("turned", signals, T, ROWS)


def evaluated(run: Run, observers: dict[str, dict[str, Observer]] | None = None) -> PartRun:
    return part_run(run, MACHINE, ("x", "y"), np.zeros(ROWS, int), observers=observers)


@pytest.mark.parametrize(("late", "glitch"), [(0.04, True), (0.07, False)])
def test_a_glitch_is_an_error_in_the_50_ms_after_a_reversal(late: float, glitch: bool) -> None:
    """The error lies across the path, in the direction (vy, -vx)."""
    row, feed = TURN + round(late / T), 0.02
    x = np.array(turned(feed)["x.position_load"])
    x[row] += 1e-5
    found = evaluated(turned(feed, position_load=x)).axes["x"]
    assert found.glitches == 1
    assert (found.glitch > 5e-6) is glitch


@pytest.mark.parametrize(("feed", "reversals"), [(0.7e-3, 0), (1.5e-3, 1)])
def test_a_reversal_counts_while_another_axis_moves_by_a_millimeter_per_second(feed: float, reversals: int) -> None:
    assert evaluated(turned(feed)).axes["x"].glitches == reversals


@pytest.mark.parametrize(("at", "counts"), [(0.15, False), (0.3, True)])
def test_an_observer_is_compared_from_a_fifth_of_a_second_on(at: float, counts: bool) -> None:
    observers: dict[str, dict[str, Observer]] = {"recovered": {"x": DisturbanceRecovery(mass=100.0, frequency=200.0)}}
    unseen = np.zeros(ROWS)  # a force of which the readings hold nothing
    unseen[round(at / T) : round((at + 0.03) / T)] = 50.0
    errors = [
        evaluated(turned(0.02, load_force=force), observers).estimates["recovered"]["x"].error
        for force in (np.zeros(ROWS), unseen)
    ]
    assert (errors[1] > errors[0] + 1.0) is counts


def peaked(places: np.ndarray, path: float) -> PartRun:
    """Errors of 10 um over 0.1 mm at these places in m of a straight path."""
    x = np.linspace(0.0, path, 20001)
    error = np.max([1e-5 * (np.abs(x - place) < 5e-5) for place in places], axis=0)
    contour = contour_error(np.column_stack([x, error]), np.column_stack([x, np.zeros(20001)]))
    return PartRun("peaked", contour, {}, MachineLoad({}), None, {}, {})


def test_the_eight_worst_places_are_listed() -> None:
    assert len(peaked(np.linspace(0.05, 0.45, 12), 0.5).worst()) == 8


@pytest.mark.parametrize(("apart", "places"), [(2.2e-3, 1), (4.5e-3, 2)])
def test_places_within_3_mm_of_the_path_are_one(apart: float, places: int) -> None:
    assert len(peaked(np.array([0.2, 0.2 + apart]), 0.5).worst()) == places
