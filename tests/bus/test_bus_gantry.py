"""Two drives on one beam: in lockstep, seen as a common motion and a skew, and as a virtual pair."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.coupling.cross_beam import CrossBeam
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.bus.cia402 import PowerState
from feeddrive.bus.gantry import Gantry, share_of
from feeddrive.bus.monitor import Skew
from feeddrive.bus.virtual_gantry import DrivenGantry, virtual_gantry
from feeddrive.commissioning import motions
from feeddrive.commissioning.motions import Pace
from feeddrive.commissioning.skew import predicted_gantry
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from gantries import COUNT, MASSES, STIFFNESS, T, gantry

M = sum(MASSES)
OURS = Control(law=CascadePPI(Kv=12.0, Kp=50.0 * M, Tn=0.1), force_limit=4000.0)


def move(distance: float, pace: Pace = Pace(0.05, 1.0)) -> Any:  # noqa: B008  # a constant
    return motions.profile("move", motions.path([(distance, pace)], T, 0.05), T)


@pytest.fixture(scope="module")
def portal() -> Gantry:
    return virtual_gantry(gantry())


def test_a_share_of_a_control_has_that_share_of_its_forces() -> None:
    law = CascadePPI(Kv=20.0, Kp=800.0, Tn=0.05, viscous=40.0, model_mass=10.0)
    whole = Control(law=law, feedforward=(Inertia(mass=10.0, viscous=40.0),), force_limit=1000.0)
    made = share_of(whole, 0.25)
    wanted = Control(
        law=replace(law, Kp=200.0, viscous=10.0, model_mass=2.5),
        feedforward=(Inertia(mass=2.5, viscous=10.0),),
        force_limit=250.0,
    )
    assert tree.parameters(made) == tree.parameters(wanted)


def test_common_motion_and_skew_are_decoupled_by_shares_in_the_ratio_of_the_masses(portal: Gantry) -> None:
    """A force on the whole does not twist the beam, a force on the skew leaves the common motion at rest: by Newton."""
    gantry_ = replace(portal, shares=(MASSES[0] / M, MASSES[1] / M))
    force = replace(move(0.0), excitation=np.ones(1), set_position=np.zeros(1), velocity=np.zeros(1))
    one, other = (each.excitation[0] for each in gantry_.profiles(common=force))
    assert one / MASSES[0] == pytest.approx(other / MASSES[1])
    assert one + other == pytest.approx(1.0)
    one, other = (each.excitation[0] for each in gantry_.profiles(skew=force))
    assert one + other == pytest.approx(0.0)
    # M d'' = u
    assert one / MASSES[0] - other / MASSES[1] == pytest.approx(1.0 / M)
    moved = replace(force, excitation=np.zeros(1), set_position=np.ones(1))
    one, other = (each.set_position[0] for each in gantry_.profiles(skew=moved))
    assert one - other == pytest.approx(1.0)
    assert MASSES[0] * one + MASSES[1] * other == pytest.approx(0.0)


def test_two_sides_swing_on_their_beam_as_the_closed_form_says() -> None:
    """Two equal masses pushed apart by F each: d = F/k (1 - cos w t), w² = 2k/m; exact, as the plant has a hold."""
    off = Control(law=CascadePPI(Kv=1e-9, Kp=1e-9))
    loop = Loop(control=off, axis=Axis(plant=Rigid(mass=100.0)), sample_time=1e-3)
    driven = DrivenGantry(Machine.of({"y": loop, "y2": loop}, (CrossBeam(axis="y", follower="y2", stiffness=1e6),)))
    first, second = driven.sides
    apart = []
    for _ in range(60):
        one, other = first.push(50.0, 1), second.push(-50.0, 1)
        apart.append(one.position - other.position)
    # the answer of a side is that of the cycle before, whose reading is taken at the beginning of its sample
    t = 1e-3 * np.maximum(0, np.arange(60) - 1)
    np.testing.assert_allclose(apart, 5e-5 * (1.0 - np.cos(math.sqrt(2e4) * t)), atol=1e-15)


def test_a_side_that_is_not_exchanged_coasts() -> None:
    off = Control(law=CascadePPI(Kv=1e-9, Kp=1e-9))
    loop = Loop(control=off, axis=Axis(plant=Rigid(mass=100.0)), sample_time=1e-3)
    driven = DrivenGantry(Machine.of({"y": loop, "y2": loop}, (CrossBeam(axis="y", follower="y2", stiffness=1e6),)))
    for _ in range(50):
        driven.sides[0].push(50.0, 1)
    # the beam drags the other side along: x2 = F/(2 m) (t²/2 - (1 - cos w t)/w²)
    t, w = 0.048, math.sqrt(2e4)
    wanted = 0.25 * (0.5 * t**2 - (1.0 - math.cos(w * t)) / w**2)
    assert driven.sides[1].push(0.0, 1).position == pytest.approx(wanted, rel=1e-6)


def test_both_move_in_the_same_cycles_and_their_log_is_that_of_the_whole(portal: Gantry) -> None:
    profile = move(0.002)
    played = portal.common.play(profile)
    log = played.log
    assert played.aborted is None
    assert len(log) == profile.set_position.size
    np.testing.assert_allclose(log["reading_load"], 0.5 * (log["reading_first"] + log["reading_second"]), atol=1e-15)
    np.testing.assert_allclose(log["force"], log["force_first"] + log["force_second"], atol=1e-9)
    assert np.ptp(log["reading_load"]) == pytest.approx(0.002, rel=0.2)
    assert log.units["reading_second"] == "m"


def test_a_control_of_the_whole_moves_both_sides_by_its_shares(portal: Gantry) -> None:
    limits = replace(portal.common.limits, largest_mass=1.5 * M, breakaway_force=150.0)
    whole = replace(portal, shares=(MASSES[0] / M, MASSES[1] / M))
    log = whole.common.limited(limits).play(move(0.002), None, OURS).log
    # the shares of the commanded force differ by what the skew of the sides adds, which their friction makes
    assert np.ptp(log["reading_first"] - log["reading_second"]) < 2e-5
    np.testing.assert_allclose(log["commanded"], log["commanded_first"] + log["commanded_second"], atol=1e-9)
    assert np.max(np.abs(log["set_position"] - log["reading_load"])) < 1e-3


def test_a_gantry_in_cst_moves_as_the_machine_that_is_simulated() -> None:
    """From a reading to the force that answers it pass `lag` + 1 cycles; what is left is the rounding of the torque."""
    made = replace(virtual_gantry(gantry()), shares=(MASSES[0] / M, MASSES[1] / M))
    late = (made.first.file.drive.lag + 1) * T
    loops = {
        name: replace(
            loop,
            control=share_of(OURS, share),
            axis=replace(loop.axis, actuator=Actuator(dead_time=float(loop.axis.actuator.dead_time) + late)),
        )
        for (name, loop), share in zip(gantry().loops().items(), made.shares, strict=True)
    }
    profile = move(0.002)
    wanted = predicted_gantry(
        Machine.of(loops, gantry().couplings), made.shares, made.profiles(profile), (COUNT, COUNT), 0.0
    )
    limits = replace(made.common.limits, largest_mass=1.5 * M, breakaway_force=150.0)
    log = made.common.limited(limits).play(profile, None, OURS).log
    # half a thousandth of the rated torque on each side, by the stiffness of the law
    rounded = made.first.file.drive.scaling.newton / (12.0 * 50.0 * M)
    for name in ("reading_first", "reading_second"):
        np.testing.assert_allclose(log[name] - log[name][0], wanted[name] - wanted[name][0], atol=rounded + 2.0 * COUNT)


def test_a_skew_beyond_its_limit_stops_both(portal: Gantry) -> None:
    tight = tuple(side.limited(replace(side.limits, skew=20e-6)) for side in portal.sides)
    played = portal.with_sides(*tight).play((move(1e-3), move(-1e-3)))
    for each in played:
        assert each.aborted is not None
        assert "apart from where the beam is free of force, more than limits.skew = 2e-05 m" in each.aborted
        assert "station" not in each.aborted.partition(";")[0]
        assert len(each.log) < move(1e-3).set_position.size
    reading = played[0].log["reading_load"] - played[1].log["reading_load"]
    assert np.max(np.abs(reading)) < 40e-6  # m: what is left of a slow move once both brake


def test_the_check_of_the_skew_counts_from_where_the_beam_is_free() -> None:
    check = Skew(free=1e-3, most=1e-4)
    assert check.fault(0.0, -1.09e-3, 3) is None
    assert check.fault(0.0, -0.91e-3, 3) is None
    for second in (-1.11e-3, -0.89e-3):
        fault = check.fault(0.0, second, 3)
        assert fault is not None
        assert (fault.kind, fault.cycle) == ("skew", 3)


def test_a_fault_of_one_drive_stops_both() -> None:
    made = virtual_gantry(gantry())
    first, second = made.sides
    clients = [side.client(side.file.drive) for side in (first, second)]
    assert all(client.transport.where.startswith("EtherCAT in virtual time, station") for client in clients)
    tight = second.limited(replace(second.limits, following_error=3e-4))
    one, other = made.with_sides(first, tight).play((move(0.002), move(0.002)))
    assert one.aborted is not None
    assert other.aborted is not None
    assert "station 2" in one.aborted
    states = [clients_.transport.firmware.state for clients_ in clients]  # type: ignore[attr-defined]
    assert PowerState.ENABLED not in states


def test_what_was_inside_both_drives_is_put_back(portal: Gantry) -> None:
    before = portal.common.inside()
    assert {name.partition(",")[0] for name in before} == {"first", "second"}
    tight = portal.common.limited(replace(portal.common.limits, force=300.0))
    tight.play(move(1e-4))
    assert portal.common.inside() != before
    portal.common.restore(before)
    assert portal.common.inside() == before


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"interface": "eth9"}, "same interface"),
        ({"station": 1}, "are both station 1"),
        ({"lag": 1}, "need the same lag"),
        ({"mode": "csv"}, "in cst"),
        ({"skew": None}, "limits.skew is missing"),
    ],
)
def test_drives_that_are_no_gantry_are_refused(portal: Gantry, changes: dict[str, Any], message: str) -> None:
    side = portal.second
    drive, file = side.file.drive, side.file
    if "interface" in changes:
        file = replace(file, interface="eth9")
    elif "skew" in changes:
        file = replace(file, drive=replace(drive, limits=replace(drive.limits, skew=None)))
    else:
        file = replace(file, drive=replace(drive, **changes))
    with pytest.raises(ParameterError, match=message):
        replace(portal, second=type(side)(file, lambda _: side.client(drive).transport, False))


def test_a_machine_without_a_beam_is_no_gantry() -> None:
    machine = gantry()
    with pytest.raises(StructureError, match="cross_beam"):
        virtual_gantry(Machine.of(machine.loops()))


def test_the_limits_of_the_skew_are_those_of_both_sides(portal: Gantry) -> None:
    twist = portal.twist.limits
    assert twist.travel == portal.skew == 1e-3
    # each side gets a quarter of the force of the whole on the skew
    assert twist.force == pytest.approx(4.0 * portal.first.limits.force)
    assert portal.common.limits.force == pytest.approx(2.0 * portal.first.limits.force)
    assert STIFFNESS * twist.travel > portal.first.limits.force  # N: the force acts first
