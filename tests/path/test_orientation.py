"""Rotary joints of rows of tool axes: the shortest way against all ways, the cone, turns, and interpolation."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from feeddrive.files.machine import read_machine
from feeddrive.language.errors import ParameterError
from feeddrive.path.kinematics import Kinematics, UnreachableError
from feeddrive.path.orientation import (
    MOST_WOUND,
    TURN,
    angle_between,
    choose_rotary,
    interpolate_axes,
    interpolate_plane,
    interpolate_vector,
    leaves_arc,
    unwound,
)

DEGREE = math.radians(1.0)
AC = Kinematics.of("table_table", "AC")
MACHINES = {
    "table AC": AC,
    "head CB": Kinematics.of("head_head", "CB", reversed_joints="B"),
    "nutating head, table C": Kinematics.of("head_table", "BC", nutating=True),
    "nutating table": Kinematics.of("table_table", "AC", nutating=True),
}
EVERY = pytest.mark.parametrize("machine", MACHINES.values(), ids=MACHINES)


def tool_axis(tilt: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Tool axes tilted from Z, in a direction in the plane of X and Y."""
    tilt, turn = np.broadcast_arrays(tilt, turn)
    return np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


def wander(rng: np.random.Generator, n: int, most: float = 80.0) -> np.ndarray:
    """A smooth row of tool axes within a tilt, in degrees: a random walk of few frequencies."""
    s = np.linspace(0.0, 1.0, n)

    def wave() -> np.ndarray:
        return np.sum([rng.normal() * np.sin(TURN * k * s + rng.uniform(0.0, TURN)) for k in (1, 2, 3)], axis=0)

    x, y = wave(), wave()
    size = np.hypot(x, y)
    tilt = most * DEGREE * size / (0.1 + np.max(size))
    return tool_axis(tilt, np.arctan2(y, x))


def equivalents(angle: float, least: float, most: float) -> list[float]:
    return [angle + TURN * m for m in range(-8, 9) if least <= angle + TURN * m <= most]


def sweeps(machine: Kinematics, a: np.ndarray, b: np.ndarray) -> bool:
    """True if the tool axis leaves the arc by more than 1.15 degrees, on many points of the move."""
    share = np.linspace(0.0, 1.0, 201)
    axis = interpolate_axes(machine, a[:, None], b[:, None], share)
    arc = interpolate_plane(axis[:, :1], axis[:, -1:], np.linspace(0.0, 1.0, 401))
    return max(float(np.min(angle_between(axis[:, k : k + 1], arc))) for k in range(201)) > 0.02


@EVERY
@pytest.mark.parametrize("seed", range(3))
def test_the_way_is_the_shortest_of_all(machine: Kinematics, seed: int) -> None:
    """Against every sequence of branches and turns: its length, with a whole turn for each sweep of the tool."""
    rng = np.random.default_rng(seed)
    travel = {"C": (-1.2 * math.pi, 1.9 * math.pi)}
    for letter in machine.rotary_letters.replace("C", ""):
        travel[letter] = (-1.5, 2.5)
    limited = machine.with_travel(travel)
    ends = [travel[letter] for letter in machine.rotary_letters]
    axis = tool_axis(rng.uniform(0.3, 1.2, 5), np.cumsum(rng.uniform(0.2, 2.2, 5)))
    angles = machine.rotary(axis).angles
    states = [
        [
            np.array(pair)
            for branch in (0, 1)
            for pair in itertools.product(*(equivalents(angles[branch, j, k], *ends[j]) for j in (0, 1)))
        ]
        for k in range(5)
    ]
    moves = [[[length(machine, a, b) for b in after] for a in before] for before, after in itertools.pairwise(states)]
    best = min(
        sum(moves[k][way[k]][way[k + 1]] for k in range(4))
        for way in itertools.product(*(range(len(x)) for x in states))
    )
    chosen = choose_rotary(limited, axis)
    found = sum(length(machine, a, b) for a, b in itertools.pairwise(chosen.rotary.T))
    assert found == pytest.approx(best, abs=1e-9)
    assert all(least <= x <= most for row, (least, most) in zip(chosen.rotary, ends, strict=True) for x in row)
    assert chosen.deviation.max() < 1e-14


def length(machine: Kinematics, a: np.ndarray, b: np.ndarray) -> float:
    return float(np.max(np.abs(b - a))) + (TURN if swept(machine, a, b) else 0.0)


def swept(machine: Kinematics, a: np.ndarray, b: np.ndarray) -> bool:
    """True if the middle of a move, or half a turn of it, is farther from the middle of the arc than its ends."""
    share = min(0.5, math.pi / max(1e-300, float(np.max(np.abs(b - a)))))
    ends, there = (np.array(machine.tool_axis(np.array(x).T)) for x in ([a, b], [a + share * (b - a)]))
    middle = ends[:, :1] + ends[:, 1:]
    middle /= np.linalg.norm(middle)
    return float(angle_between(there, middle)[0]) > 0.5 * float(angle_between(ends[:, :1], ends[:, 1:])[0]) + 0.02


@EVERY
def test_smooth_rows_are_followed_without_a_sweep(machine: Kinematics) -> None:
    for seed in range(5):
        axis = wander(np.random.default_rng(seed), 400)
        chosen = choose_rotary(machine, axis)
        assert angle_between(np.array(machine.tool_axis(chosen.rotary)), axis).max() < 1e-14
        # rad: an arc of 2 degrees and a straight move of joints at a tilt differ by less than this
        for k in leaves_arc(machine, chosen.rotary, 0.02):
            assert sweeps(machine, chosen.rotary[:, k - 1], chosen.rotary[:, k])
            # only through the neighborhood of the pole
            assert np.min(np.hypot(*axis[:2, k - 1 : k + 1])) < 0.2


def test_turns_add_up_and_fit_into_the_travel() -> None:
    """A dome of 12 turns: C turns on; in a travel of 10 turns it is unwound once, with one sweep of the tool."""
    s = np.linspace(0.0, 1.0, 2000)
    axis = tool_axis(DEGREE * (70.0 - 67.0 * s), 12.0 * TURN * s)
    trunnion = read_machine("trunnion_ac").kinematics
    assert trunnion is not None
    chosen = choose_rotary(trunnion, axis)
    assert chosen.rotary[1, -1] - chosen.rotary[1, 0] == pytest.approx(12.0 * TURN)
    assert chosen.rotary[0] == pytest.approx(-DEGREE * (70.0 - 67.0 * s))
    assert not leaves_arc(trunnion, chosen.rotary, 1e-3).size
    short = trunnion.with_travel({"C": (-5.0 * TURN, 5.0 * TURN)})
    chosen = choose_rotary(short, axis)
    assert np.max(np.abs(chosen.rotary[1])) <= 5.0 * TURN
    assert leaves_arc(trunnion, chosen.rotary, 1e-3).size == 1
    # with a start the row is not moved by turns: it begins beside it
    chosen = choose_rotary(trunnion, axis, start=(-1.0, 3.1 * TURN))
    assert abs(chosen.rotary[1, 0] - 3.1 * TURN) < 0.5 * TURN


def test_several_turns_at_once_are_a_sweep() -> None:
    rotary = np.array([[-0.5, -0.5, -0.5], [0.0, 4.0 * TURN, 4.0 * TURN]])
    assert leaves_arc(AC, rotary, 1e-3).tolist() == [1]


def test_a_straight_move_of_the_joints_is_no_sweep() -> None:
    """At its shares, and not beyond its ends: over 10 degrees a joint move stays within 0.3 degrees of the arc."""
    rotary = np.array([[-0.6, -0.7], [0.0, 0.17]])
    assert not leaves_arc(AC, rotary, 0.3 * DEGREE).size
    assert leaves_arc(AC, rotary, 0.003 * DEGREE).tolist() == [1]


@pytest.mark.parametrize("aside", [1e-6, 1e-4])
def test_within_the_cone_c_does_not_turn_by_half(aside: float) -> None:
    """A row of tool axes beside the pole: A changes its sign, and the deviation is the distance from the pole."""
    x = np.linspace(-0.3, 0.3, 399)
    axis = np.array([x, np.full(399, aside), np.sqrt(1.0 - x * x - aside * aside)])
    plain = choose_rotary(AC, axis)
    assert np.max(np.abs(np.diff(plain.rotary[1]))) > 80.0 * DEGREE
    assert plain.deviation.max() < 1e-14
    cone = 0.05 * DEGREE
    kept = choose_rotary(AC, axis, cone=2e-3)
    assert kept.deviation.max() <= 1.0000001 * aside
    assert np.max(np.abs(np.diff(kept.rotary[1]))) < 4.0 * DEGREE
    assert kept.rotary[0, 0] * kept.rotary[0, -1] < 0.0
    assert np.flatnonzero(kept.branch < 0).tolist() == np.flatnonzero(np.hypot(x, aside) <= 2e-3).tolist()
    narrow = choose_rotary(AC, axis, cone=cone)
    assert narrow.deviation.max() <= cone


@EVERY
def test_the_deviation_stays_within_the_cone(machine: Kinematics) -> None:
    """Random rows through the pole, for cones of 0.05 to 5 degrees."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        axis = wander(rng, 300, most=10.0)
        cone = 10.0 ** rng.uniform(-1.3, 0.7) * DEGREE
        chosen = choose_rotary(machine, axis, cone=cone)
        assert chosen.deviation.max() <= cone
        within = np.hypot(*axis[:2]) < math.sin(cone)
        assert np.all(chosen.deviation[~within] < 1e-14)


def test_the_free_joint_moves_along_the_way_and_is_held_where_nothing_follows() -> None:
    axis = tool_axis(np.array([0.2, 0.0, 0.0, 0.2]), np.array([0.0, 0.0, 0.0, 0.8]))
    c = choose_rotary(AC, axis, way=np.array([0.0, 0.1, 0.6, 1.0])).rotary[1]
    assert (c - c[0]) / (c[3] - c[0]) == pytest.approx([0.0, 0.1, 0.6, 1.0])
    c = choose_rotary(AC, axis[:, 1:3], start=(0.0, 1.7)).rotary[1]
    assert c.tolist() == [1.7, 1.7]
    c = choose_rotary(AC, axis[:, 1:]).rotary[1]
    assert c.tolist() == [c[2]] * 3


def test_rows_of_no_block_and_of_one() -> None:
    assert choose_rotary(AC, np.zeros((3, 0))).rotary.shape == (2, 0)
    assert unwound(np.zeros(0)).shape == (0,)
    offset = AC.with_travel({"C": (1.0, 9.0)})
    assert choose_rotary(offset, np.array([0.0, 0.0, 1.0])).rotary.tolist() == [[0.0], [1.0]]


def test_a_way_that_goes_back_and_a_speed_of_zero_are_refused() -> None:
    axis = tool_axis(np.array([0.2, 0.0, 0.2]), np.array(0.0))
    for way in ([0.0, 0.2, 0.1], [0.0, 1.0], [0.0, math.nan, 1.0]):
        with pytest.raises(ParameterError, match="the way must have a position for each of the 3 blocks"):
            choose_rotary(AC, axis, way=np.array(way))
    with pytest.raises(ParameterError, match="speeds of the rotary joints must be above 0, not 1, 0"):
        choose_rotary(AC, axis, speeds=(1, 0))


def test_the_other_joint_keeps_its_turns_within_the_cone() -> None:
    """A travel of 300 to 420 degrees holds the pole at 360."""
    machine = AC.with_travel({"A": (300.0 * DEGREE, 420.0 * DEGREE)})
    x = np.array([-0.2, -0.001, 0.001, 0.2])
    chosen = choose_rotary(machine, np.array([x, 0.0 * x, np.sqrt(1.0 - x * x)]), cone=0.01)
    assert np.abs(chosen.rotary[0] - TURN) == pytest.approx(np.abs(np.arcsin(x)), abs=1e-12)


def test_a_pole_that_the_travel_of_the_other_joint_ends_at() -> None:
    """A from 0 to 100 degrees cannot change its sign: in the cone the tool axis would be off by twice its tilt."""
    one_sided = AC.with_travel({"A": (0.0, 100.0 * DEGREE)})
    x = np.array([-0.3, -0.009, 0.009, 0.3])
    axis = np.array([x, 0.0 * x, np.sqrt(1.0 - x * x)])
    chosen = choose_rotary(one_sided, axis, cone=0.01)
    assert chosen.rotary[0].min() >= 0.0
    with pytest.raises(UnreachableError, match=r"within the cone .* joint A .* 60 deg to 100 deg.*larger orientation"):
        choose_rotary(
            Kinematics.of("table_table", "AC").with_travel({"A": (60.0 * DEGREE, 100.0 * DEGREE)}),
            tool_axis(np.array([1.2, 0.0, 1.2]), np.array(0.0)),
            cone=0.01,
        )


def test_a_tilt_beyond_the_travel_names_joint_angle_and_range() -> None:
    machine = AC.with_travel({"A": (-10.0 * DEGREE, 5.0 * DEGREE)})
    axis = tool_axis(DEGREE * np.array([8.0, 17.0]), np.array(0.0))
    with pytest.raises(
        UnreachableError, match=r"joint A at 17 deg, and it goes from -10 deg to 5 deg.*at -17 deg"
    ) as error:
        choose_rotary(machine, axis)
    assert error.value.block == 1
    half_open = AC.with_travel({"A": (-math.inf, 1.0)})
    with pytest.raises(ParameterError, match="travel of joint A has one end: give both"):
        choose_rotary(half_open, axis)


@pytest.mark.parametrize(("beyond", "reached"), [(0.0, True), (0.7e-9, True), (1.5e-9, False)])
def test_the_end_of_a_travel_belongs_to_it(beyond: float, reached: bool) -> None:
    machine = AC.with_travel({"A": (-0.5, 0.1)})
    axis = tool_axis(np.array([0.4, 0.5 + beyond]), np.array(0.0))
    if reached:
        assert choose_rotary(machine, axis).rotary[0] == pytest.approx([-0.4, -0.5], abs=1e-8)
        assert unwound(np.array([-0.4, -0.5 - beyond]), least=-0.5, most=0.1).min() >= -0.5
    else:
        with pytest.raises(UnreachableError):
            choose_rotary(machine, axis)
        with pytest.raises(UnreachableError, match=r"joint A at -28\.65 deg has no position in its travel"):
            unwound(np.array([-0.4, -0.5 - beyond]), least=-0.5, most=0.1, letter="A")


@pytest.mark.parametrize("seed", range(4))
def test_unwound_angles_are_equal_near_and_within_the_travel(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-20.0, 20.0, 500)
    free = unwound(angle)
    assert free == pytest.approx(np.unwrap(angle))
    assert free[0] == angle[0]
    least, most = -4.0, 5.0
    held = unwound(angle, start=0.3, least=least, most=most)
    turns = (held - angle) / TURN
    assert turns == pytest.approx(np.round(turns), abs=1e-12)
    before = np.concatenate([[0.3], held[:-1]])
    for x, last in zip(held, before, strict=True):
        others = [x + TURN * m for m in (-2, -1, 1, 2) if least <= x + TURN * m <= most]
        assert least <= x <= most
        assert all(abs(x - last) <= abs(other - last) + 1e-12 for other in others)


@pytest.mark.parametrize(("degrees", "refused"), [(0.99e6, False), (1.01e6, True)])
def test_an_angle_wound_beyond_a_million_degrees_is_refused(degrees: float, refused: bool) -> None:
    angle = np.arange(0.0, math.radians(degrees), 3.0)
    assert pytest.approx(1e6 * DEGREE) == MOST_WOUND
    if refused:
        with pytest.raises(UnreachableError, match=r"joint C would be wound to 10000\d\d deg, and at most 1000000 deg"):
            unwound(angle, letter="C")
    else:
        assert unwound(angle) == pytest.approx(angle)


def test_interpolations_begin_and_end_at_both_and_stay_in_their_plane() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 3, 50))
    a, b = a / np.linalg.norm(a, axis=0), b / np.linalg.norm(b, axis=0)
    phi = angle_between(a, b)
    for interpolate in (interpolate_vector, interpolate_plane):
        assert interpolate(a, b, np.zeros(50)) == pytest.approx(a, abs=1e-15)
        assert interpolate(a, b, np.ones(50)) == pytest.approx(b, abs=1e-15)
        normal = np.cross(a, b, axis=0)
        for share in (0.1, 0.5, 0.8):
            t = interpolate(a, b, np.full(50, share))
            assert np.linalg.norm(t, axis=0) == pytest.approx(np.ones(50), abs=1e-15)
            assert np.abs(np.einsum("in,in->n", normal, t)).max() < 1e-15
    # a great circle at a constant rate
    assert angle_between(interpolate_plane(a, b, 0.3), a) == pytest.approx(0.3 * phi, abs=1e-14)
    # the components straight: the rate in the middle is 1/cos² φ/2 of the end's
    h = 1e-6
    middle = angle_between(interpolate_vector(a, b, 0.5 + h), interpolate_vector(a, b, 0.5 - h)) / (2.0 * h)
    assert middle == pytest.approx(2.0 * np.tan(0.5 * phi), rel=1e-6)
    end = angle_between(interpolate_vector(a, b, 2.0 * h), a) / (2.0 * h)
    assert middle / end == pytest.approx(1.0 / np.cos(0.5 * phi) ** 2, rel=1e-3)


def test_interpolation_by_axes_moves_the_joints_straight() -> None:
    begin, end = np.array([[0.1], [0.2]]), np.array([[0.5], [1.2]])
    t = interpolate_axes(AC, begin, end, np.array([0.0, 0.25, 1.0]))
    assert t[:, 1] == pytest.approx(np.array(AC.tool_axis((0.2, 0.45))))


@pytest.mark.parametrize("interpolate", [interpolate_vector, interpolate_plane])
def test_opposite_tool_axes_have_no_plane(interpolate: Callable[..., np.ndarray]) -> None:
    a, b = np.array([[1.0], [0.0], [0.0]]), np.array([[-1.0], [0.0], [0.0]])
    near = np.array([[-math.cos(0.7e-6)], [math.sin(0.7e-6)], [0.0]])
    far = np.array([[-math.cos(1.5e-6)], [math.sin(1.5e-6)], [0.0]])
    for end in (b, near):
        with pytest.raises(UnreachableError, match="opposite direction in one block"):
            interpolate(a, end, 0.5)
    assert interpolate(a, far, 0.5)[1, 0] == pytest.approx(1.0)
    assert interpolate(a, a, 0.5) == pytest.approx(a)
