"""Pitch errors and backlash: learned from a run, taken out by the control, written for LinuxCNC."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.compensation.pitch_compensation import PitchCompensation
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.coupling.cross_coupled import CrossCoupled
from feeddrive.blocks.coupling.geometry import Geometry
from feeddrive.blocks.force.backlash import Backlash
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.plant.lead_error import LeadError
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.reference.circle import Circle
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.files.handover import comp_text, read_comp_file, write_comp_file
from feeddrive.identification.pitch import learned_from, learned_from_circles, learned_pitch
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import Run, simulate
from feeddrive.machining.circle_test import CirclePath, circle_causes, circle_of_run, circle_test

ERROR = LeadError(row=np.array([0.0, 4e-6, -2e-6, 5e-6, 1e-6]), start=0.0, spacing=0.025)
PLANT = TwoMass(mass_motor=60.0, mass_load=60.0, stiffness=8e7, damping=4000.0, viscous_motor=300.0, viscous_load=50.0)
MOVE = SnapLimitedMove(
    distance=0.1, velocity=0.1, acceleration=2.0, jerk=100.0, snap=2e4, back=True, dwell_between=0.05, dwell_after=0.3
)


def screw(compensation: tuple[PitchCompensation, ...] = ()) -> Loop:
    """A screw with a lead error and 8 um of backlash, under the encoder of its motor, on a guideway with friction."""
    law = CascadePPI(Kv=60.0, Kp=3e4, Tn=0.01)
    physics = Axis(
        plant=PLANT,
        forces=(Backlash(gap=8e-6, lead_error=ERROR),),
        friction_load=Coulomb(coulomb=40.0),
        encoder_motor=Encoder(resolution=1e-9),
        substeps=8,
    )
    return Loop(control=Control(law=law, compensation=compensation), axis=physics, sample_time=2.5e-4)


def errors(run: Run) -> np.ndarray:
    """Table less set position at constant speed, once the servo error of the start is gone, m."""
    x, v = run["set_position"], run["set_velocity"]
    steady = (np.abs(v) > 0.0999) & (x > 0.035) & (x < 0.065)
    return (run["position_load"] - x)[steady]


def test_what_a_run_teaches_takes_the_error_out():
    before = simulate(screw(), MOVE)
    learned = learned_from(before, "x", spacing=0.005, settle=0.002)
    assert learned.backlash == pytest.approx(8e-6, rel=0.05)  # the spring under friction adds 2 · 40 N / 8e7 N/m
    found = simulate(screw((learned.compensation,)), MOVE)
    assert np.sqrt(np.mean(errors(before) ** 2)) > 4e-6
    assert np.sqrt(np.mean(errors(found) ** 2)) < 0.05e-6  # servo errors and what lies between entries
    assert learned.after < 0.2 * learned.before  # with the turns of the friction in it
    for sign, row in ((1.0, learned.compensation.forward), (-1.0, learned.compensation.backward)):
        at = learned.compensation.table_start + 0.005 * np.arange(len(row))
        wanted = sign * 4.5e-6 - np.interp(at, 0.025 * np.arange(5), ERROR.row)
        inside = (at > 0.01) & (at < 0.09)
        assert np.max(np.abs(row - wanted)[inside]) < 0.6e-6  # m: entries of 5 mm on corners of 25 mm


TRAVEL = {"x": (-0.02, 0.02), "y": (-0.02, 0.02)}


def circle(machine: Machine, feed: float) -> CirclePath:
    given: dict[str, Any] = {"radius": 0.02, "feed": feed, "turns": 1.5}
    paths = {"x": Circle(**given, phase=0), "y": Circle(**given, phase=90)}
    return circle_of_run(simulate(machine, paths, record=[*(f"{a}.set_position" for a in "xy"), "tool.x", "tool.y"]))


def test_a_circle_test_teaches_scale_and_backlash():
    """Gaps of 8 and 5 um, to which 40 N of friction on 80 N/um add 1 um; scales of 30 and -20 ppm."""

    def machine(blocks: dict[str, tuple[PitchCompensation, ...]]) -> Machine:
        loops = {name: screw(blocks.get(name, ())) for name in "xy"}
        for name, gap in (("x", 8e-6), ("y", 5e-6)):
            loops[name] = replace(loops[name], axis=replace(loops[name].axis, forces=(Backlash(gap=gap),)))
        return Machine.of(loops, geometry=Geometry(scale_x=3e-5, scale_y=-2e-5))

    before = [circle(machine({}), feed) for feed in (0.02, 0.05)]
    causes = circle_causes(before)
    learned = learned_from_circles(causes, TRAVEL)
    for axis, gap, scale in (("x", 9e-6, 3e-5), ("y", 6e-6, -2e-5)):
        forward, backward = learned[axis].forward, learned[axis].backward
        assert np.mean(forward - backward) == pytest.approx(gap, rel=0.02)
        assert (forward[1] - forward[0]) / 0.04 == pytest.approx(-scale, rel=0.05)
    after = circle(machine({name: (block,) for name, block in learned.items()}), 0.05)
    figures = [circle_test([each]).figures[0] for each in (before[1], after)]
    assert figures[1].G < 0.65 * figures[0].G  # what is left are the spikes while the gap is crossed
    with pytest.raises(ParameterError, match="do not separate"):
        learned_from_circles(circle_causes(before[:1]), TRAVEL)
    with pytest.raises(ParameterError, match="axis 'y' needs its two ends"):
        learned_from_circles(causes, {"x": (-0.02, 0.02)})


def drawn(scale: float, gap: float, ripple: float) -> list[CirclePath]:
    """Circles of 20 mm with a scale error, a backlash of x, and a residual of three waves, m."""
    angle = 2.0 * np.pi * (np.arange(720) + 0.5) / 720
    circles: list[CirclePath] = []
    for feed in (0.01, 0.05):
        for d in (1, -1):
            r = (
                0.02 * (1.0 + scale)
                + 0.5 * d * gap * np.sign(np.sin(angle)) * np.cos(angle)
                + ripple * np.cos(3 * angle)
            )
            circles.append(CirclePath(r * np.cos(angle), r * np.sin(angle), d, feed, 0.02, (0.0, 0.0)))
    return circles


def test_causes_within_three_standard_errors_are_not_compensated():
    causes = circle_causes(drawn(1e-6, 0.0, 3e-6), spike="exponential", backlash="step", decay=0.01)
    with pytest.raises(ParameterError, match=r"nothing to compensate: .*backlash y .* within 3 standard errors"):
        learned_from_circles(causes, TRAVEL)
    found = circle_causes(drawn(1e-6, 9e-6, 3e-6), spike="exponential", backlash="step", decay=0.01)
    (axis,) = learned_from_circles(found, TRAVEL).items()
    assert axis[0] == "x"
    # the backlash alone: the same at both ends
    assert axis[1].forward == pytest.approx(np.full(2, 0.5 * found["backlash x"].value))
    assert axis[1].backward == pytest.approx(-axis[1].forward)


@pytest.mark.parametrize(("beyond", "refused"), [(0.0002, False), (0.0006, True)])
def test_a_travel_beyond_the_circles_is_refused(beyond, refused):
    """A hundredth of 40 mm is admitted."""
    causes = circle_causes(drawn(1e-4, 9e-6, 0.0), spike="exponential", backlash="step", decay=0.01)
    travel = {**TRAVEL, "x": (-0.02, 0.02 + beyond)}
    if not refused:
        assert "x" in learned_from_circles(causes, travel)
        return
    with pytest.raises(ParameterError, match=r"travel of 'x', -20 mm to 20.6 mm: the circles measured"):
        learned_from_circles(causes, travel)


def test_tables_made_from_themselves_come_back():
    """Positions with exactly the error of two tables, at random places: the tables, to rounding."""
    random = np.random.default_rng(3)
    forward, backward = random.normal(0.0, 1e-6, 9), random.normal(0.0, 1e-6, 9)
    x = random.uniform(-0.1, 0.3, 4000)
    x[:2] = -0.1, 0.3
    way = np.where(random.random(4000) < 0.5, 1.0, -1.0)
    way[:2] = 1.0, -1.0
    knots = np.linspace(-0.1, 0.3, 9)
    added = np.where(way > 0, np.interp(x, knots, forward), np.interp(x, knots, backward))
    learned = learned_pitch(x, x - added, 0.1 * way, spacing=0.05)
    assert np.max(np.abs(learned.compensation.forward - forward)) < 1e-15
    assert np.max(np.abs(learned.compensation.backward - backward)) < 1e-15
    assert learned.after < 1e-16


def test_a_reversal_comes_in_over_its_distance_without_a_jump():
    block = PitchCompensation(
        forward=np.full(2, 4e-6), backward=np.full(2, -4e-6), table_start=0.0, spacing=1.0, reversal_distance=2e-5
    )
    run = simulate(screw((block,)), replace(MOVE, distance=0.01))
    plain = simulate(screw(), replace(MOVE, distance=0.01))
    extra = run["reading_load"] - plain["reading_load"]
    turned = np.flatnonzero(run["set_velocity"] < -1e-3)[0]
    assert extra[turned - 40] == pytest.approx(4e-6, abs=2e-7)
    assert extra[-1] == pytest.approx(-4e-6, abs=2e-7)
    assert np.max(np.abs(np.diff(run["force"]))) < 2.0 * np.max(np.abs(np.diff(plain["force"])))


def test_cross_coupled_control_does_not_fight_it():
    """What the compensation adds is no contour error: equal ramps of both axes, with and without the coupling."""
    row = np.array([0.0, 50e-6])
    one_sided = PitchCompensation(forward=row, backward=row, table_start=0.0, spacing=0.1)
    loops = {"x": screw((one_sided,)), "y": screw()}
    move = replace(MOVE, back=False)
    found = [
        simulate(Machine.of(loops, couplings), {"x": move, "y": move}, record=["x.reading_load", "x.set_position"])
        for couplings in ((), (CrossCoupled(contour_axes=("x", "y"), contour_gain=100.0),))
    ]
    added = [run["x.reading_load"][-1] - run["x.set_position"][-1] for run in found]
    assert added[0] == pytest.approx(50e-6, abs=2e-7)
    assert added[1] == pytest.approx(50e-6, abs=2e-7)


def test_linuxcnc_reads_nominal_forward_reverse(tmp_path: Path):
    block = PitchCompensation(
        forward=np.array([0.0, 3e-6, 5e-6]), backward=np.array([-2e-6, 1e-6, 2e-6]), table_start=-0.1, spacing=0.05
    )
    assert comp_text(block).splitlines()[1] == "-50.000000000 -50.003000000 -50.001000000"  # reached positions
    assert comp_text(block, file_type=1).splitlines()[1] == "-50.000000000 0.003000000 0.001000000"
    for kind in (0, 1):
        again = read_comp_file(write_comp_file(block, tmp_path / "x.comp", file_type=kind), file_type=kind)
        assert np.max(np.abs(again.forward - block.forward)) < 1e-12  # m: nine digits of a mm
        assert np.max(np.abs(again.backward - block.backward)) < 1e-12
        assert (again.table_start, again.spacing) == pytest.approx((-0.1, 0.05), abs=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0 0 0\n1 0\n2 0 0\n", r"x\.comp:2: '1 0' is no row of three numbers"),
        ("0 0 0\n1 nan 0\n", "no row of three numbers"),
        ("0 0 0\n2 0 0\n1 0 0\n", r"x\.comp:3: nominal 1 does not lie above 2"),
        ("0 0 0\n1 0 0\n3 0 0\n", "give rows at one spacing"),
        ("0 0 0\n", "needs two at least"),
    ],
)
def test_a_wrong_file_names_its_line(tmp_path: Path, text: str, said: str):
    (tmp_path / "x.comp").write_text(text)
    with pytest.raises(FileError, match=said):
        read_comp_file(tmp_path / "x.comp")


def test_what_cannot_be_learned_is_refused():
    x = np.linspace(0.0, 0.1, 200)
    there = np.ones(200)
    with pytest.raises(ParameterError, match="one way only"):
        learned_pitch(x, x, there, spacing=0.01)
    both = np.concatenate([x, x[:100]])
    with pytest.raises(ParameterError, match="no sample between entries"):
        learned_pitch(both, both, np.concatenate([there, -there[:100]]), spacing=0.01)
    with pytest.raises(ParameterError, match="not finite"):
        learned_pitch(x, np.full(200, np.nan), there, spacing=0.01)
    with pytest.raises(ParameterError, match="forward has 2 entries and backward 3"):
        PitchCompensation(forward=np.zeros(2), backward=np.zeros(3), table_start=0.0, spacing=1.0)
    with pytest.raises(ParameterError, match="LinuxCNC reads 256"):
        comp_text(PitchCompensation(forward=np.zeros(300), backward=np.zeros(300), table_start=0.0, spacing=1e-3))


def test_a_table_holds_65536_entries():
    """50,000 pass and lack samples between them, 80,000 are too many."""
    x = np.concatenate([np.linspace(0.0, 0.5, 100), np.linspace(0.5, 0.0, 100)])
    way = np.repeat([0.1, -0.1], 100)
    with pytest.raises(ParameterError, match="no sample between entries"):
        learned_pitch(x, x, way, spacing=1e-5)
    with pytest.raises(ParameterError, match="are more than 65536"):
        learned_pitch(x, x, way, spacing=0.5 / 80_000)


@pytest.mark.parametrize(("speed", "samples"), [(0.7e-6, 20), (1.5e-6, 24)])
def test_slower_than_a_micrometer_per_second_is_standing(speed: float, samples: int):
    x = np.concatenate([np.linspace(0.0, 0.5, 12), np.linspace(0.5, 0.0, 12)])
    way = np.repeat([0.1, -0.1], 12)
    way[[3, 6, 15, 18]] = np.sign(way[[3, 6, 15, 18]]) * speed
    assert sum(learned_pitch(x, x, way, spacing=0.25).samples) == samples
