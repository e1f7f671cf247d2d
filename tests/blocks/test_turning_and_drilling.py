"""Turning and drilling: closed forms, power, the chip of the actual motion, chatter, and the kernel of milling."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.coupling.drilling_cut import DrillingCut
from feeddrive.blocks.coupling.mode_shape import ModeShape
from feeddrive.blocks.coupling.structure_mode import StructureMode
from feeddrive.blocks.coupling.turning_cut import TurningCut
from feeddrive.blocks.cutting.drill import Drill
from feeddrive.blocks.cutting.edge_coefficients import EdgeCoefficients
from feeddrive.blocks.cutting.engagement import cut
from feeddrive.blocks.cutting.mechanistic_cutter import MechanisticCutter
from feeddrive.blocks.cutting.turning_tool import TurningTool
from feeddrive.blocks.families import Coupling
from feeddrive.blocks.load.drilling_force import DrillingForce
from feeddrive.blocks.load.turning_force import TurningForce
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.linear_move import LinearMove
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.signals import Motion
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate

CHIP = 2e-4  # m
STEEL = EdgeCoefficients(Ktc=1.9e9, Kfc=0.8e9, Kte=4e4, Kfe=5e4)
SHARP = EdgeCoefficients(Ktc=1.9e9, Kfc=0.8e9)
TOOL = TurningTool(cutting_depth=2e-3, lead_angle=0.3, edge=STEEL)
DRILL = Drill(diameter=0.01, chisel_length=1.6e-3, lip=STEEL, chisel=EdgeCoefficients(Ktc=4e9, Kfc=9e9, Kfe=1e5))


@pytest.mark.parametrize("lead_angle", [-0.5, 0.0, 0.3, 1.2])
@pytest.mark.parametrize("steps", [[(CHIP, 0.0)], [(CHIP, 3e-5), (1.5 * CHIP, -4e-5)], [(-CHIP, 0.0)]])
def test_an_edge_that_stands_is_a_tooth_of_a_milling_cutter(
    lead_angle: float, steps: list[tuple[float, float]]
) -> None:
    """A straight tooth at the angle 90° - lead_angle, over a millionth of a radian: 1e-13 by the curvature of sin."""
    tool = replace(TOOL, lead_angle=lead_angle)
    v = 0.5 * np.pi - lead_angle
    tooth = MechanisticCutter(
        teeth=1,
        slices=1,
        diameter=0.02,
        axial_depth=tool.cutting_depth / np.cos(lead_angle),
        entry=0.0,
        exit=np.pi,
        Ktc=STEEL.Ktc,
        Krc=STEEL.Kfc,
        Kte=STEEL.Kte,
        Kre=STEEL.Kfe,
    )
    mill = cut(tooth.edge(), v, 0.0, steps)
    radial = -(mill.feed * np.sin(v) + mill.normal * np.cos(v))
    found = tool.forces(steps)
    # the plane of the mill has its normal where the lathe has the depth
    np.testing.assert_allclose(
        [found.feed, found.depth, found.tangential],
        [-radial * np.sin(v), -radial * np.cos(v), mill.torque / 0.01],
        rtol=1e-9,
        atol=1e-9,
    )


def test_the_area_of_the_chip_is_depth_times_feed_whatever_the_lead_angle() -> None:
    """So the force of a sharp edge only turns, and its power is Ktc times the volume per second."""
    for lead_angle in (-0.4, 0.0, 0.7):
        found = replace(TOOL, edge=SHARP, lead_angle=lead_angle).forces([(CHIP, 0.0)])
        assert found.tangential == pytest.approx(1.9e9 * 2e-3 * CHIP, rel=1e-14)
        assert np.hypot(found.feed, found.depth) == pytest.approx(0.8e9 * 2e-3 * CHIP, rel=1e-14)
        assert found.depth / found.feed == pytest.approx(np.tan(lead_angle), rel=1e-13, abs=1e-15)


def test_without_feed_the_edge_is_left_and_without_a_chip_nothing() -> None:
    """N; the edge of 2 mm / cos 0.3 rubs with 40 N/mm."""
    assert TOOL.forces([(1e-9, 0.0)]).tangential == pytest.approx(4e4 * 2e-3 / np.cos(0.3), rel=1e-4)
    for nothing in ([(0.0, 0.0)], [(-CHIP, 0.0)], [(CHIP, 0.0), (-1e-6, 0.0)]):
        assert all(force == 0.0 for force in TOOL.forces(nothing))
    assert DRILL.forces(0.01, None, 0.0) == (0.0, 0.0)
    assert DRILL.forces(-1e-6, None, CHIP) == (0.0, 0.0)


def test_thrust_and_torque_are_integrals_over_the_lips_and_the_chisel() -> None:
    """By Gauss quadrature over the radius, at entry, full engagement and breakthrough of a plate of 12 mm."""
    half, c = 0.5 * DRILL.point_angle, 1e-4
    assert DRILL.chisel is not None
    for depth in (5e-4, 2e-3, 9e-3, 1.25e-2, 1.4e-2, 1.6e-2):
        # what is in the plate: radii whose height above the chisel is between depth - thickness and depth
        near = 0.8e-3 + np.tan(half) * np.clip([depth - 0.012, depth], 0.0, 4.2e-3 / np.tan(half))
        nodes, weights = np.polynomial.legendre.leggauss(8)
        r = 0.5 * (near[1] + near[0]) + 0.5 * (near[1] - near[0]) * nodes
        dr = 0.5 * (near[1] - near[0]) * weights
        db = dr / np.sin(half)
        h = c * np.sin(half)
        thrust = 2.0 * np.sum((0.8e9 * h + 5e4) * np.sin(half) * db)
        torque = 2.0 * np.sum((1.9e9 * h + 4e4) * r * db)
        if depth < 0.012:
            r, dr = 0.4e-3 * (1.0 + nodes), 0.4e-3 * weights
            thrust += 2.0 * np.sum((9e9 * c + 1e5) * dr)
            torque += 2.0 * np.sum(4e9 * c * r * dr)
        found = DRILL.forces(depth, 0.012, c)
        np.testing.assert_allclose(found, (thrust, torque), rtol=1e-12, atol=1e-12)


def test_the_energy_of_a_hole_is_ktc_times_its_volume_and_that_of_the_edges() -> None:
    """Through a plate of 8 mm; the chisel's core of 1.6 mm apart. The middle rule over kinks leaves 1e-7."""
    drill = replace(DRILL, chisel=None, lips=3)
    c, turns = 1e-4, 20.0
    speed = 3.0 * c * turns
    depth = (np.arange(200_000) + 0.5) * 0.014 / 200_000
    torque = drill.forces(depth, 0.008, c).torque
    energy = float(np.sum(torque)) * (0.014 / 200_000) / speed * 2.0 * np.pi * turns
    volume = np.pi * (0.005**2 - 0.0008**2) * 0.008
    way = volume / c / np.sin(0.5 * drill.point_angle)  # length of edge times its way
    assert energy == pytest.approx(1.9e9 * volume + 4e4 * way, rel=1e-6)


def test_a_flat_point_is_at_once_in_full_contact() -> None:
    flat = replace(DRILL, point_angle=3.1414, chisel=None)
    assert flat.forces(1e-5, None, 1e-4).thrust == pytest.approx(2.0 * (0.8e9 * 1e-4 + 5e4) * 4.2e-3, rel=1e-6)


def along(block: Any, position: Any, velocity: Any, h: float, steps: int) -> list[Any]:
    """Forces of a cut under a motion that is stated, substep by substep, at the predicted middle."""
    axes, forces = block.axes(), []

    def motions(t: float, ahead: float) -> dict[str, Motion]:
        x, v = position(t), velocity(t)
        return {axis: Motion(x, x + ahead * v, v, v) for axis in axes}

    state = block.start(None, motions(0.0, 0.0))
    for k in range(steps):
        state, found = block.forces(state, motions(k * h, 0.5 * h), h)
        forces.append(found)
    return forces


@pytest.mark.parametrize("kind", ["turning", "drilling"])
def test_the_chip_of_a_vibration_is_its_difference_with_order_two(kind: str) -> None:
    """A feed with a sine across 3.3 turns: |chip - its closed form| falls with the square of the substep."""
    tau, feed, A, w = 0.03, 0.004, 2e-5, 2.0 * np.pi * 110.0
    block: Any
    if kind == "turning":
        block = TurningCut(
            tool=replace(TOOL, edge=SHARP), spindle_speed=60.0 / tau, feed_towards="positive", surfaces=1
        )
    else:
        drill = replace(DRILL, chisel=None, lip=SHARP)
        block = DrillingCut(tool=drill, spindle_speed=30.0 / tau, towards="positive", surface=-0.1)
    errors = []
    for steps in (101, 202, 404):  # in a turn; the last 0.3 turns are between stored values
        h = tau / (steps + 0.37)
        forces = along(
            block, lambda t: feed * t + A * np.sin(w * t), lambda t: feed + A * w * np.cos(w * t), h, 3 * steps
        )
        middle = (np.arange(3 * steps) + 0.5) * h
        chip = feed * tau + A * (np.sin(w * middle) - np.sin(w * (middle - tau)))
        late = middle > 1.1 * tau
        if kind == "turning":
            area, found = 2e-3 * chip * np.cos(0.3), -np.array([force.feed for force in forces]) / 0.8e9
        else:
            area = 2.0 * 4.2e-3 * np.sin(0.5 * DRILL.point_angle) * chip
            found = np.array([force.thrust for force in forces]) / 0.8e9
        errors.append(float(np.max(np.abs(found - area)[late]) / np.max(area)))
    assert errors[0] < 2e-3
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2.0, 2.0], abs=0.1)


def test_a_vibration_that_repeats_with_the_turn_leaves_the_force_of_the_feed() -> None:
    """Whatever the substep, as long as a turn has a whole number of them; what is left are roundings of positions."""
    tau, w = 0.06, 2.0 * np.pi * 7.0 / 0.06
    block = TurningCut(tool=TOOL, spindle_speed=60.0 / tau, feed_towards="positive", surfaces=1)
    forces = along(
        block,
        lambda t: CHIP * t / tau + 3e-5 * np.sin(w * t),
        lambda t: CHIP / tau + 3e-5 * w * np.cos(w * t),
        tau / 80,
        200,
    )
    still = TOOL.forces([(CHIP, 0.0)])
    np.testing.assert_allclose([force.feed for force in forces[100:]], still.feed, rtol=1e-10)


def machine(axes: dict[str, Loop], *couplings: Coupling) -> Machine:
    return Machine.of(axes, couplings)


def carriage(T: float) -> Loop:
    """A carriage that no force moves, without control."""
    return Loop(
        control=Control(law=CascadePPI(Kv=1e-9, Kp=1e-9, Tn=1e9)), axis=Axis(plant=Rigid(mass=1e18)), sample_time=T
    )


@pytest.mark.parametrize(("share", "grows"), [(0.97, False), (1.03, True)])
def test_chatter_in_turning_begins_at_its_least_depth(share: float, grows: bool) -> None:
    """One mode along the feed: a = -1 / (2 Kfc min Re G) = 2 k ζ (1 + ζ) / Kfc, at ω = ω0 √(1 + 2ζ).

    The edge turned by 0.5 rad feels cos² of it in a chip that is 1 / cos as wide: the limit is 1 / cos times as deep.
    Source: Altintas, Manufacturing Automation, chapter 4 (Tobias & Fishwick 1958).
    """
    w0, zeta, mass, lead = 2.0 * np.pi * 120.0, 0.03, 20.0, 0.5
    k = mass * w0 * w0
    least = 2.0 * k * zeta * (1.0 + zeta) / SHARP.Kfc / np.cos(lead)
    w = w0 * np.sqrt(1.0 + 2.0 * zeta)
    G = 1.0 / (k - mass * w * w + 2j * zeta * mass * w0 * w)
    # 1 + Kfc a (1 - e^(-jωτ)) G = 0 at the limit
    phase = -np.angle(1.0 + 1.0 / (SHARP.Kfc * least * np.cos(lead) * G))
    tau = (phase + 2.0 * np.pi * 3.0) / w
    steps = 400
    tool = TurningTool(cutting_depth=share * least, lead_angle=lead, edge=SHARP)
    made = machine(
        {"z": carriage(tau / steps)},
        StructureMode(frequency=120.0, damping_ratio=zeta, mass=mass, shapes=(ModeShape(axis="z", load=1.0),)),
        TurningCut(tool=tool, spindle_speed=60.0 / tau, feed_towards="positive"),
    )
    run = simulate(
        made,
        {"z": LinearMove(distance=0.0, travel_time=1.0)},
        start={"z": (0.0, CHIP / tau)},
        duration=90 * tau,
        record=["z.position_load"],
    )
    x = run["z.position_load"][: 90 * steps] - CHIP / tau * run.time[: 90 * steps]
    apart = x[steps:].reshape(-1, steps) - x[:-steps].reshape(-1, steps)
    size = np.sqrt(np.mean(apart**2, axis=1))
    early, late = float(np.mean(size[30:50])), float(np.mean(size[68:88]))
    assert (late > 1.3 * early) if grows else (late < early / 1.3)
    assert late < CHIP, "it stays in the cut"


def test_force_and_cut_agree_on_a_motion_that_the_force_does_not_move() -> None:
    """Through a plate, and along a shaft: the load at the middle of each sample is the force of the run to 1e-6."""
    T = 2.5e-4
    feed = {"start": {"z": (0.0, -0.006)}, "duration": 2.4}
    move = Recorded(position=np.array([0.0, -0.0144]), sample_time=2.4, between="linear")
    drilling = DrillingCut(tool=DRILL, spindle_speed=1500.0, surface=-1e-3, thickness=6e-3)
    rest = {"z": LinearMove(distance=0.0, travel_time=1.0)}
    run = simulate(machine({"z": carriage(T)}, drilling), rest, record=["z.load_force"], **feed)  # type: ignore[arg-type]
    load = DrillingForce(tool=DRILL, spindle_speed=1500.0, reference=move, surface=-1e-3, thickness=6e-3)
    middle = run.time + 0.5 * T
    late = (middle > 0.09) & (middle < 2.39)  # three lips after the start, before the record ends
    np.testing.assert_allclose(run["z.load_force"][late], load.at(middle)[late], rtol=1e-9, atol=1e-6)
    assert np.max(run["z.load_force"]) == pytest.approx(DRILL.forces(5e-3, 6e-3, 0.006 / 50.0).thrust, rel=1e-9)
    turning = TurningCut(tool=TOOL, spindle_speed=1500.0, along_depth="x", cut_from=0.2, cut_to=2.0)
    made = machine({"z": carriage(T), "x": carriage(T)}, turning)
    feed["start"]["x"] = (0.0, 0.0)  # type: ignore[index]
    run = simulate(made, rest | {"x": rest["z"]}, record=["z.load_force", "x.load_force"], **feed)  # type: ignore[arg-type]
    for axis, component in (("z", "feed"), ("x", "depth")):
        force = TurningForce(tool=TOOL, spindle_speed=1500.0, reference=move, component=component, start=0.2, end=2.0)
        np.testing.assert_allclose(run[f"{axis}.load_force"][late], force.at(middle)[late], rtol=1e-9, atol=1e-6)
        assert np.min(run[f"{axis}.load_force"]) >= 0.0
        assert np.max(run[f"{axis}.load_force"]) > 100.0, "it pushes the tool back and out of the work"


def test_a_drill_that_comes_back_cuts_where_the_bottom_is() -> None:
    """3 mm deep, out, quickly back: nothing to the bottom, and the same thrust below as without the way out.

    The bottom is a helicoid from 2.9 to 3 mm, the way of a lip in its 20 ms; as long the lips still cut on the way out.
    """
    h, v = 1e-3, 0.005
    block = DrillingCut(tool=DRILL, spindle_speed=1500.0, surface=0.0, towards="positive")

    def position(t: float) -> float:
        if t < 0.8:
            return -1e-3 + v * t  # to 3 mm
        if t < 1.2:
            return 3e-3 - 0.01 * (t - 0.8)  # to -1 mm
        if t < 1.55:
            return -1e-3 + 0.01 * (t - 1.2)  # to 2.5 mm
        return 2.5e-3 + v * (t - 1.55)

    def velocity(t: float) -> float:
        return v if t < 0.8 or t >= 1.55 else (0.01 if t >= 1.2 else -0.01)

    forces = np.array([found.thrust for found in along(block, position, velocity, h, 2000)])
    time = (np.arange(2000) + 0.5) * h
    assert np.all(forces[(time > 0.821) & (time < 1.629)] == 0.0)
    assert np.all(forces[(time > 0.25) & (time < 0.799)] > 0.0)
    assert forces[1960] == pytest.approx(DRILL.forces(position(1.9605), None, v / 50.0).thrust, rel=1e-9)


def test_a_drill_that_lifts_off_cuts_what_the_lips_left_where_it_stands() -> None:
    """A vibration larger than the chip: against the deepest of all earlier lips at the same angle, of order two.

    Where a lip cuts again after it lifted off, the bottom has a kink, and the error there is that of a substep.
    """
    tau, feed, A, w = 0.02, 0.005, 1.5e-4, 2.0 * np.pi * 130.0
    drill = replace(DRILL, chisel=None, lip=SHARP)
    block = DrillingCut(tool=drill, spindle_speed=30.0 / tau, towards="positive", surface=-0.1)
    steps = 400
    h = tau / steps

    def position(t: Any) -> Any:
        return feed * t + A * (np.sin(w * t) if np.ndim(t) else float(np.sin(w * t)))

    forces = along(block, position, lambda t: feed + A * w * float(np.cos(w * t)), h, 8 * steps)
    middle = (np.arange(8 * steps) + 0.5) * h
    before = [np.where(middle > m * tau, position(middle - m * tau), 0.0) for m in range(1, 9)]
    chip = np.maximum(position(middle) - np.max(before, axis=0), 0.0)
    found = np.array([force.thrust for force in forces])
    still = 2.0 * 4.2e-3 * np.sin(0.5 * DRILL.point_angle) * 0.8e9
    late = middle > 2.0 * tau
    assert 0.2 < np.mean(chip[late] == 0.0) < 0.8, "it is out of the cut for a part of the time"
    error = np.abs(found / still - chip)[late]
    assert np.max(error) < (A * w + feed) * h, "the way in a substep, at a kink"
    assert np.percentile(error, 95) < 0.05 * (A * w + feed) * h


def test_a_constant_feed_comes_into_the_work_from_its_start() -> None:
    """A lip has its share of the feed; the chisel, of which nothing is in the work at first, cuts what is there."""
    load = DrillingForce(tool=DRILL, spindle_speed=1200.0, feed_per_turn=CHIP, start=0.5, towards="positive")
    depth = np.array([-1e-3, 2e-5, 1e-3, 8e-3])
    found = load.at(0.5 + depth / (CHIP * 20.0))
    expected = [-DRILL.forces(float(each), None, CHIP / 2.0).thrust for each in depth]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    chisel = 2.0 * (9e9 * 2e-5 + 1e5) * 0.8e-3
    lips = 2.0 * (0.8e9 * CHIP / 2.0 * np.sin(0.5 * DRILL.point_angle) + 5e4) * 2e-5 * np.tan(0.5 * DRILL.point_angle)
    assert -found[1] == pytest.approx(chisel + lips, rel=1e-9)


def test_what_is_refused() -> None:
    with pytest.raises(
        ParameterError, match=r"edge_coefficients\.Kfc = 900 N/m2 is that of no material .*Kfc_N_per_mm2"
    ):
        replace(STEEL, Kfc=900.0)
    with pytest.raises(ParameterError, match=r"drill\.chisel_length = 0\.02 m must be < drill\.diameter = 0\.01 m"):
        replace(DRILL, chisel_length=0.02)
    with pytest.raises(StructureError, match="turning_cut: feed and depth must be along different axes, not both"):
        TurningCut(tool=TOOL, spindle_speed=1000.0, along_depth="z")
    for make in (TurningForce, DrillingForce):
        with pytest.raises(StructureError, match=r"takes its chip from either feed_per_turn \(m\) or a reference"):
            make(tool=TOOL if make is TurningForce else DRILL, spindle_speed=1000.0)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match=r"turning_force\.end = 1 s must be > turning_force\.start = 2 s"):
        TurningForce(tool=TOOL, spindle_speed=1000.0, feed_per_turn=CHIP, start=2.0, end=1.0)
    pecks = Recorded(position=np.array([0.0, -0.01, 0.0, -0.012, 0.0]), sample_time=1.0, between="linear")
    with pytest.raises(StructureError, match="turns back and comes again into its hole"):
        DrillingForce(tool=DRILL, spindle_speed=1000.0, reference=pecks)
    once = LinearMove(distance=-0.01, travel_time=1.0, back=True)
    assert DrillingForce(tool=DRILL, spindle_speed=1000.0, reference=once).at(np.array([1.5])) == 0.0
    for block in (
        TurningCut(tool=TOOL, spindle_speed=100.0, remembered=500),
        DrillingCut(tool=DRILL, spindle_speed=100.0, remembered=500),
    ):
        with pytest.raises(ParameterError, match=r"remembered = 500 substeps of .* are shorter than the .* at least"):
            simulate(
                machine({"z": carriage(1e-4)}, block), {"z": LinearMove(distance=0.0, travel_time=1.0)}, duration=0.01
            )
