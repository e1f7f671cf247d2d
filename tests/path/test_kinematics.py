"""Kinematics of five axes: against chains of rotations, in every arithmetic, and all branches of a tool axis."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from feeddrive.certificate.enclosure import Enclosed, enclose
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import Graph, Symbol
from feeddrive.language.series import Interval, Taylor
from feeddrive.loop.trace import evaluate
from feeddrive.path.kinematics import Kind, Kinematics, RotaryJoint, UnreachableError, Vector
from feeddrive.path.orientation import angle_between

RNG = np.random.default_rng(29)


def point() -> Vector:
    x, y, z = RNG.uniform(-0.2, 0.2, 3).tolist()
    return x, y, z


MACHINES = {
    "table AC": Kinematics.of("table_table", "AC", point(), point(), point(), 0.1),
    "table BC, B reversed": Kinematics.of("table_table", "BC", point(), point(), point(), 0.1, reversed_joints="B"),
    "nutating table": Kinematics.of("table_table", "BC", point(), point(), point(), 0.1, nutating=True),
    "head CB": Kinematics.of("head_head", "CB", point(), point(), point(), 0.1),
    "head CA, C reversed": Kinematics.of("head_head", "CA", point(), point(), point(), 0.1, reversed_joints="C"),
    "fork AB": Kinematics.of("head_head", "AB", point(), point(), point(), 0.1),
    "nutating head": Kinematics.of("head_head", "CB", point(), point(), point(), 0.1, nutating=True),
    "head B, table C": Kinematics.of("head_table", "BC", point(), point(), point(), 0.1),
    "nutating head, table C": Kinematics.of("head_table", "AC", point(), point(), point(), 0.1, nutating=True),
}
EVERY = pytest.mark.parametrize("machine", MACHINES.values(), ids=MACHINES)


def drawn(n: int = 300) -> tuple[np.ndarray, np.ndarray]:
    return RNG.uniform(-0.5, 0.5, (3, n)), RNG.uniform(-3.1, 3.1, (2, n))


@EVERY
def test_joints_are_those_of_a_chain_of_rotations(machine: Kinematics) -> None:
    """Build the tip and the point of the workpiece by rotations of scipy, joint by joint, in machine coordinates."""
    tip, rotary = drawn(50)
    linear = np.array(machine.linear(tip, rotary))
    axis = np.array(machine.tool_axis(rotary))
    for k in range(50):
        angle = dict(zip(machine.rotary_letters, rotary[:, k], strict=True))

        def turn(joint: RotaryJoint, against: float, angle: dict[str, float] = angle) -> Rotation:
            return Rotation.from_rotvec(against * joint.sign * angle[joint.letter] * np.array(joint.direction))

        tool, up = np.array(machine.tool), np.array([0.0, 0.0, 1.0])
        for joint in reversed(machine.head):
            tool = turn(joint, 1.0).apply(tool - joint.point) + joint.point
            up = turn(joint, 1.0).apply(up)
        # a table turns against its sign: what counts is the tool relative to the workpiece
        held = tip[:, k] + machine.workpiece
        for joint in reversed(machine.table):
            held = turn(joint, -1.0).apply(held - joint.point) + joint.point
        for joint in machine.table:
            up = turn(joint, 1.0).apply(up)
        # m: some thirty products of numbers below 1
        assert np.abs(linear[:, k] + tool - held).max() < 1e-14
        assert np.abs(axis[:, k] - up).max() < 1e-14


@EVERY
def test_forward_is_the_inverse_of_inverse(machine: Kinematics) -> None:
    tip, rotary = drawn()
    assert np.abs(np.array(machine.tip(machine.linear(tip, rotary), rotary)) - tip).max() < 1e-14


def test_a_positive_angle_turns_the_tool_right_handed_relative_to_the_workpiece() -> None:
    quarter = math.pi / 2.0
    # A about X: Z goes to -Y;  B about Y: Z goes to X (ISO 841), for tables and heads alike
    for machine in (
        Kinematics.of("table_table", "AC"),
        Kinematics.of("head_head", "CA"),
        Kinematics.of("head_table", "AC"),
    ):
        assert np.array(machine.tool_axis((quarter, 0.0))) == pytest.approx([0.0, -1.0, 0.0], abs=1e-15)
    for machine in (
        Kinematics.of("table_table", "BC"),
        Kinematics.of("head_head", "CB"),
        Kinematics.of("head_table", "BC"),
    ):
        assert np.array(machine.tool_axis((quarter, 0.0))) == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)
        # then C about Z: X goes to Y
        assert np.array(machine.tool_axis((quarter, quarter))) == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)


def test_a_reversed_joint_counts_the_other_way() -> None:
    tip, rotary = drawn(20)
    points = (point(), point(), point(), 0.1)
    kinds: tuple[tuple[Kind, str], ...] = (("table_table", "AC"), ("head_head", "CA"), ("head_table", "AC"))
    for kind, letters in kinds:
        plain = Kinematics.of(kind, letters, *points)
        turned = Kinematics.of(kind, letters, *points, reversed_joints="A")
        counted = np.array([-rotary[0], rotary[1]])
        assert np.array(turned.linear(tip, rotary)) == pytest.approx(np.array(plain.linear(tip, counted)), abs=1e-15)
        assert np.array(turned.tool_axis(rotary)) == pytest.approx(np.array(plain.tool_axis(counted)), abs=1e-15)


def test_at_rotary_zero_the_tip_is_the_joints_less_the_tool() -> None:
    for machine in MACHINES.values():
        tip = np.array([0.01, 0.02, 0.03])
        linear = np.array(machine.linear(tip, (0.0, 0.0)))
        assert linear == pytest.approx(tip + machine.workpiece + np.array([0.0, 0.0, 0.1]), abs=1e-16)
        longer = np.array(machine.with_tool(0.15).linear(tip, (0.0, 0.0)))
        assert longer - linear == pytest.approx([0.0, 0.0, 0.05], abs=1e-16)


@EVERY
def test_symbols_have_the_bits_of_numbers(machine: Kinematics) -> None:
    tip, rotary = drawn(20)
    graph = Graph()
    names = ["x", "y", "z", *machine.rotary_letters]
    symbols = [graph.input(name) for name in names]
    outputs = [*machine.linear(symbols[:3], symbols[3:]), *machine.tip(symbols[:3], symbols[3:])]
    outputs += machine.tool_axis(symbols[3:])
    nodes = [x.index if isinstance(x, Symbol) else graph.constant(x).index for x in outputs]
    for k in range(20):
        numbers = [np.float64(x) for x in (*tip[:, k], *rotary[:, k])]
        values = evaluate(graph, nodes, dict(zip(names, numbers, strict=True)))
        plain = [*machine.linear(numbers[:3], numbers[3:]), *machine.tip(numbers[:3], numbers[3:])]
        plain += machine.tool_axis(numbers[3:])
        assert [float(x) for x in values] == [float(x) for x in plain]
    # and as Taylor models of the certificate, which take the graph: joints over a cell of 2 mm and 0.02 rad
    leaves = {
        name: Enclosed(np.array([[0.3], [0.001 if k < 3 else 0.01]]), None, np.zeros(1)) for k, name in enumerate(names)
    }
    _, enclosed = enclose(graph, nodes, leaves, 1, 0)
    for t in np.linspace(-1.0, 1.0, 21):
        numbers = [0.3 + (0.001 if k < 3 else 0.01) * t for k in range(5)]
        plain = [*machine.linear(numbers[:3], numbers[3:]), *machine.tip(numbers[:3], numbers[3:])]
        for bound, value in zip(enclosed, plain, strict=False):
            assert bound.low[0] <= value <= bound.high[0]


@EVERY
def test_taylor_series_give_the_velocity_of_the_joints(machine: Kinematics) -> None:
    """The first term is the central difference of sixth order, whose own error is below 1e-10 m at a step of 0.01."""
    tip, rotary = drawn(30)
    rate, turning = drawn(30)
    series = machine.linear(
        [Taylor(*x) for x in zip(tip, rate, strict=True)], [Taylor(*x) for x in zip(rotary, turning, strict=True)]
    )
    h, total = 0.005, np.zeros((3, 30))
    for step, weight in ((1, 0.75), (2, -0.15), (3, 1.0 / 60.0)):
        ahead = np.array(machine.linear(tip + step * h * rate, rotary + step * h * turning))
        behind = np.array(machine.linear(tip - step * h * rate, rotary - step * h * turning))
        total += weight * (ahead - behind)
    assert np.abs(np.array([x.terms[1] for x in series]) - total / h).max() < 1e-8


@EVERY
def test_a_displacement_keeps_its_digits(machine: Kinematics) -> None:
    """Over 1e-9 m and rad a subtraction of positions has errors of 1e-16 m; the displacement has those of 1e-24 m."""
    tip, rotary = drawn()
    moved, turned = (1e-9 * x for x in drawn())
    change = np.array(machine.linear_change(tip, moved, rotary, turned))
    # the first-order term is exact to the size of the second: (1e-9)^2 times the arm
    first = machine.linear(
        [Taylor(*x) for x in zip(tip, moved, strict=True)], [Taylor(*x) for x in zip(rotary, turned, strict=True)]
    )
    assert np.abs(change - [x.terms[1] for x in first]).max() < 5e-17
    second = machine.linear(
        [Taylor(x, y, 0.0 * x) for x, y in zip(tip, moved, strict=True)],
        [Taylor(x, y, 0.0 * x) for x, y in zip(rotary, turned, strict=True)],
    )
    # third order: 1e-27 m; rounding: 1e-16 of 1e-9 m
    assert np.abs(change - [x.terms[1] + x.terms[2] for x in second]).max() < 1e-23
    subtracted = np.array(machine.linear(tip + moved, rotary + turned)) - np.array(machine.linear(tip, rotary))
    assert np.abs(change - subtracted).max() > 1e-18


@EVERY
def test_intervals_hold_the_joints(machine: Kinematics) -> None:
    tip, rotary = drawn()
    reach = 1e-4
    boxes = [[Interval.around(x, reach) for x in rows] for rows in (tip, rotary)]
    for enclosed, exact in ((machine.linear(*boxes), machine.linear), (machine.tip(*boxes), machine.tip)):
        for _ in range(30):
            moved = [x + reach * RNG.uniform(-1.0, 1.0, x.shape) for x in (tip, rotary)]
            for bound, value in zip(enclosed, exact(*moved), strict=True):
                assert np.all((bound.low <= value) & (value <= bound.high))
        # an arm of 1 m over 1e-4 rad of both joints, three times over for terms that are not seen to cancel
        assert max(np.max(bound.high - bound.low) for bound in enclosed) < 2e-3


@EVERY
def test_both_branches_give_the_tool_axis_and_one_is_the_drawn(machine: Kinematics) -> None:
    rotary = RNG.uniform(-math.pi, math.pi, (2, 3000))
    axis = np.array(machine.tool_axis(rotary))
    branches = machine.rotary(axis)
    assert not np.any(branches.at_pole)
    for branch in branches.angles:
        assert np.abs(np.array(machine.tool_axis(branch)) - axis).max() < 2e-15
        assert np.all((branch > -math.pi - 1e-15) & (branch <= math.pi))
    apart = np.abs(np.angle(np.exp(1j * (branches.angles - rotary)))).max(axis=1)
    # rad: near the end of the reach, where both branches meet, the angle is a root of the rounding of the tilt
    assert np.median(apart.min(axis=0)) < 1e-15
    assert apart.min(axis=0).max() < 1e-10
    assert apart.max(axis=0).min() > 1e-6


@pytest.mark.parametrize("tilt", [1e-8, 1e-6, 1e-3])
def test_small_tilts_keep_their_digits(tilt: float) -> None:
    """A tilt from the third component alone would have an error of 1e-8 rad."""
    machine = Kinematics.of("table_table", "AC")
    for phi in np.linspace(-3.0, 3.0, 7):
        axis = np.array([math.sin(tilt) * math.cos(phi), math.sin(tilt) * math.sin(phi), math.cos(tilt)])
        branches = machine.rotary(axis)
        assert np.abs(branches.angles[:, 0, 0]) == pytest.approx(tilt, rel=1e-14)
        assert branches.angles[0, 0, 0] == -branches.angles[1, 0, 0]


@pytest.mark.parametrize(("tilt", "free"), [(0.0, True), (0.7e-9, True), (1.5e-9, False)])
def test_at_the_pole_the_angle_about_it_is_free(tilt: float, free: bool) -> None:
    for machine in (
        Kinematics.of("table_table", "AC"),
        Kinematics.of("head_head", "CB"),
        Kinematics.of("head_table", "BC", nutating=True),
    ):
        branches = machine.rotary(np.array([0.0, math.sin(tilt), math.cos(tilt)]))
        assert branches.at_pole.tolist() == [free]
        assert machine.rotary_letters[branches.free] == "C"
        if free:
            assert np.all(branches.angles[:, branches.free] == 0.0)


def test_a_fork_has_its_pole_along_the_joint_that_carries_the_other() -> None:
    machine = Kinematics.of("head_head", "AB")
    branches = machine.rotary(np.array([1.0, 0.0, 0.0]))
    assert branches.at_pole.tolist() == [True]
    assert machine.rotary_letters[branches.free] == "A"
    assert branches.angles[:, 1, 0] == pytest.approx([math.pi / 2.0] * 2)


@pytest.mark.parametrize(("beyond", "reached"), [(-1e-3, True), (0.7e-12, True), (1.5e-12, False), (1e-3, False)])
def test_a_nutating_joint_of_45_degrees_tilts_by_90(beyond: float, reached: bool) -> None:
    machine = Kinematics.of("head_table", "BC", nutating=True)
    tilt = math.pi / 2.0 + beyond
    axis = np.array([[0.0, 0.0], [0.0, math.sin(tilt)], [1.0, math.cos(tilt)]])
    if reached:
        branches = machine.rotary(axis)
        assert angle_between(np.array(machine.tool_axis(branches.angles[0])), axis).max() < 1e-11
    else:
        with pytest.raises(
            UnreachableError, match=r"lies 90\S* deg from the axis of joint C.*B reaches 0 deg to 90 deg"
        ) as error:
            machine.rotary(axis)
        assert error.value.block == 1


@pytest.mark.parametrize(("more", "fine"), [(0.7e-6, True), (1.5e-6, False), (-1.5e-6, False), (math.nan, False)])
def test_a_vector_that_is_no_unit_vector_is_refused(more: float, fine: bool) -> None:
    machine = Kinematics.of("table_table", "AC")
    axis = np.array([[0.0, 0.6], [0.0, 0.0], [1.0, 0.8]]) * np.array([1.0, 1.0 + more])
    if fine:
        assert machine.rotary(axis).angles[0, 0, 1] == pytest.approx(math.asin(0.6), abs=1e-15)
    else:
        with pytest.raises(ParameterError, match=r"of block 1 has the length .*give a unit vector"):
            machine.rotary(axis)


@EVERY
def test_terms_of_the_tool_axis_and_the_nearest_tilt(machine: Kinematics) -> None:
    rotary = RNG.uniform(-3.0, 3.0, (2, 100))
    axis = np.array(machine.tool_axis(rotary))
    terms = machine.axis_terms().reshape(3, 3, 3)
    first, second = (np.array([np.ones(100), np.cos(x), np.sin(x)]) for x in rotary)
    assert np.abs(np.einsum("ijx,in,jn->xn", terms, first, second) - axis).max() < 1e-14
    free = machine.rotary(axis).free
    # of any other tool axis, no step away from the nearest tilt is nearer
    other = axis + 0.1 * RNG.normal(size=axis.shape)
    other /= np.linalg.norm(other, axis=0)
    nearest = machine.nearest_tilt(other, rotary[free])
    near: Any = None
    for step in (0.0, -0.01, 0.01):
        both = np.array([rotary[free], nearest + step] if free == 0 else [nearest + step, rotary[free]])
        off = angle_between(np.array(machine.tool_axis(both)), other)
        near = off if near is None else near
        assert np.all(off >= near)


def test_what_is_no_machine_of_five_axes_is_refused() -> None:
    with pytest.raises(ParameterError, match="a machine is a table_table, head_head, head_table, not 'fork'"):
        Kinematics.of("fork", "AC")  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match="two different rotary joints, not 'AA'"):
        Kinematics.of("table_table", "AA")
    with pytest.raises(ParameterError, match="two letters of rotary joints are needed, such as AC, not 'A'"):
        Kinematics.of("table_table", "A")
    with pytest.raises(ParameterError, match="a nutating joint has the letter A, B, not 'C'"):
        Kinematics.of("table_table", "CB", nutating=True)
    with pytest.raises(ParameterError, match=r"a rotary joint has the letter A, B, C, not 'U'"):
        Kinematics.of("head_table", "UC")
    with pytest.raises(ParameterError, match=r"direction of joint A has the length 2\.0: give a unit vector"):
        RotaryJoint("A", (2.0, 0.0, 0.0))
    with pytest.raises(
        ParameterError, match=r"travel of joint A goes from 57\.3 deg to 0 deg: its lower end must lie below"
    ):
        RotaryJoint("A", (1.0, 0.0, 0.0), least=1.0, most=0.0)
