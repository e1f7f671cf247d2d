"""Error of the tip of the tool against forward kinematics of scipy's rotations, for tables and heads."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from feeddrive.language.series import Taylor
from feeddrive.loop.simulate import Run
from feeddrive.machining.tip_error import TipError, jacobian, tip_error, tip_motion
from feeddrive.path.kinematics import Kinematics, RotaryJoint

T = 1e-3  # s
KINDS = {
    "trunnion": Kinematics.of("table_table", "AC", workpiece=(0.0, 0.0, -0.08)),
    "table with offsets": Kinematics.of(
        "table_table", "BC", (0.01, -0.02, 0.03), (-0.04, 0.02, 0.01), (0.02, 0.03, -0.1), 0.12, reversed_joints="C"
    ),
    "nutating table": Kinematics.of("table_table", "BC", second=(0.0, 0.05, 0.0), nutating=True, tool_length=0.1),
    "fork head": Kinematics.of("head_head", "CB", (0.0, 0.01, 0.25), (0.0, 0.0, 0.25), (0.1, 0.2, -0.3), 0.15),
    "head and table": Kinematics.of("head_table", "BC", (0.0, 0.02, 0.2), (0.3, 0.1, 0.0), (0.3, 0.1, 0.05), 0.1),
}


def independent_tip(machine: Kinematics, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tip and tool axis of one position of the joints: homogeneous matrices, from the tool to the workpiece."""

    def about(joint: RotaryJoint) -> np.ndarray:
        angle = joints[3 + machine.rotary_letters.index(joint.letter)] * (-1.0 if joint.reversed else 1.0)
        turn, place = np.eye(4), np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec(angle * np.array(joint.direction)).as_matrix()
        place[:3, 3] = joint.point
        return place @ turn @ np.linalg.inv(place)

    whole = np.eye(4)
    whole[:3, 3] = -np.array(machine.workpiece)
    # the joint next to the workpiece acts last
    for joint in reversed(machine.table):
        whole = whole @ about(joint)
    slide = np.eye(4)
    slide[:3, 3] = joints[:3]
    whole = whole @ slide
    for joint in machine.head:
        whole = whole @ about(joint)
    return (whole @ np.array([*machine.tool, 1.0]))[:3], whole[:3, :3] @ np.array([0.0, 0.0, 1.0])


def path(machine: Kinematics, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Tip and tool axis of the set path at a time."""
    return independent_tip(machine, joints_of(np.array([time]))[0][:, 0])


def joints_of(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, velocity and acceleration of smooth joints, shape (5, n)."""
    size = np.array([[0.05], [0.04], [0.02], [0.4], [0.9]])
    rate = np.array([[3.0], [4.0], [5.0], [2.5], [3.5]])
    phase = np.array([[0.1], [0.7], [1.3], [2.0], [0.4]])
    s, c = np.sin(rate * time + phase), np.cos(rate * time + phase)
    return size * s, size * rate * c, -size * rate**2 * s


def judged(machine: Kinematics, actual: np.ndarray, wanted: tuple[np.ndarray, ...], counted: np.ndarray) -> TipError:
    """The tip error of joints that are off their set positions, all of shape (5, n)."""
    axes = machine.letters.lower()
    signals: dict[str, np.ndarray] = {}
    for k, axis in enumerate(axes):
        for name, rows in zip(("position", "velocity", "acceleration"), wanted, strict=True):
            signals[f"{axis}.set_{name}"] = rows[k]
        signals[f"{axis}.position_load"] = actual[k]
    return tip_error(Run("run", signals, T, actual.shape[1]), machine, axes, counted=counted)


def errors(time: np.ndarray, scale: float = 1.0) -> np.ndarray:
    """Errors of the joints of some um and some ten urad, shape (5, n)."""
    size = scale * np.array([[5e-6], [8e-6], [3e-6], [40e-6], [60e-6]])
    return size * np.sin(np.array([[11.0], [7.0], [13.0], [9.0], [5.0]]) * time + 0.5)


def inside(n: int) -> np.ndarray:
    counted = np.ones(n, bool)
    counted[:30] = counted[-30:] = False  # the path ends there
    return counted


@pytest.mark.parametrize("name", KINDS)
def test_tip_and_direction_are_those_of_an_independent_computation(name: str) -> None:
    machine, time = KINDS[name], T * np.arange(600)
    wanted, off = joints_of(time), errors(time)
    result = judged(machine, wanted[0] + off, wanted, inside(600))
    for k in range(40, 560, 40):
        tip, axis = independent_tip(machine, wanted[0][:, k] + off[:, k])
        set_tip, _ = independent_tip(machine, wanted[0][:, k])
        near, far = (path(machine, time[k] + delay)[0] for delay in (-1e-6, 1e-6))
        along = (tip - set_tip) @ (far - near) / np.linalg.norm(far - near)
        # m: the tangent by differences of 1e-6 s is off by 1e-9 rad, of an error of 1e-5
        assert result.along[k] == pytest.approx(along, abs=1e-12)
        across = np.sqrt(np.sum((tip - set_tip) ** 2) - along**2)
        assert result.across[k] == pytest.approx(across, abs=1e-12)

        def away(delay: float, k: int = k, tip: np.ndarray = tip) -> float:
            return float(np.linalg.norm(tip - path(machine, time[k] + delay)[0]))

        best = minimize_scalar(away, bounds=(-1e-3, 1e-3), method="bounded", options={"xatol": 1e-9})
        # m: the path between samples of 1 ms is a cubic, the speed 0.4 m/s, its curve some 10 /m
        assert result.contour.error[k] == pytest.approx(best.fun, abs=2e-9)
        _, there = path(machine, time[k] + best.x)
        # rad: the time of the nearest point is known to 1e-8 s, the tool turns at 3 rad/s
        assert result.direction[k] == pytest.approx(np.linalg.norm(axis - there), abs=5e-8)


@pytest.mark.parametrize("name", KINDS)
def test_the_parts_of_the_joints_make_up_the_error_to_first_order(name: str) -> None:
    """J by differences of the independent forward kinematics; what is left falls with the square of the errors."""
    machine, time = KINDS[name], T * np.arange(600)
    wanted = joints_of(time)
    columns = jacobian(machine, wanted[0])
    for k in (100, 300):
        for j in range(5):
            step = np.zeros(5)
            step[j] = 1e-6
            ends = [independent_tip(machine, wanted[0][:, k] + s * step)[0] for s in (1.0, -1.0)]
            assert np.abs(columns[j, :, k] - (ends[0] - ends[1]) / 2e-6).max() < 1e-9  # rounding 1e-16 over 1e-6
    left = []
    for scale in (1.0, 10.0):
        result = judged(machine, wanted[0] + errors(time, scale), wanted, inside(600))
        counted = result.contour.counted
        left.append(np.abs(np.sum(result.added, axis=0) - result.contour.error)[counted].max())
        assert sum(joint.share for joint in result.joints) == pytest.approx(1.0, abs=1e-12)
    assert left[0] < 2e-9  # m: of errors of 1e-5 m and 1e-4 rad
    # 20 ms late, too: the joints are judged where the tip is, not where it should be by now
    late = judged(machine, joints_of(time - 0.02)[0] + errors(time), wanted, inside(600))
    counted = late.contour.counted & (time > 0.05)
    assert np.abs(np.sum(late.added, axis=0) - late.contour.error)[counted].max() < 4e-9
    assert left[1] > 30.0 * left[0]


@pytest.mark.parametrize("name", KINDS)
def test_joints_without_error_leave_none_at_the_tip(name: str) -> None:
    machine, time = KINDS[name], T * np.arange(400)
    wanted = joints_of(time)
    result = judged(machine, wanted[0].copy(), wanted, inside(400))
    # m and rad: some roundings of 0.5 m
    for values in (result.contour.error, result.along, result.across, result.added):
        assert np.abs(values).max() < 1e-15
    # rad: the nearest point is that of the same instant to 1e-16 m of 0.1 m/s
    assert np.abs(result.direction).max() < 1e-13
    assert all(joint.rms == joint.peak == joint.tip_peak == joint.share == 0.0 for joint in result.joints)


LEVERS = {
    # m: distance of the tip from the axis of C, at X 60 mm, Y 30 mm
    "trunnion": float(np.hypot(0.06, 0.03)),
    # of the fork with B = 0.5: pivot and tool, 0.4 m, stick out by sin B, the outer joint lies 10 mm beside
    "fork head": float(np.hypot(0.4 * np.sin(0.5), 0.01)),
}


@pytest.mark.parametrize("name", LEVERS)
def test_an_error_of_c_shows_at_the_tip_as_the_angle_times_the_lever_arm(name: str) -> None:
    """C alone turns, and is 50 urad behind: at the tip 50 urad times the distance from its axis, along its circle."""
    machine, time = KINDS[name], T * np.arange(500)
    n, late = 500, 50e-6
    turning = 3 + machine.rotary_letters.index("C")
    wanted = [np.zeros((5, n)) for _ in range(3)]
    wanted[0][:3] = [[0.06], [0.03], [0.02]]
    if "B" in machine.rotary_letters:
        wanted[0][3 + machine.rotary_letters.index("B")] = 0.5
    wanted[0][turning], wanted[1][turning] = 2.0 * time, 2.0
    actual = wanted[0].copy()
    actual[turning] -= late
    result = judged(machine, actual, tuple(wanted), inside(n))
    lever = LEVERS[name]
    joint = next(part for part in result.joints if part.letter == "C")
    assert joint.lever == pytest.approx(lever, rel=1e-12)
    assert joint.tip_rms == pytest.approx(late * lever, rel=1e-10)
    assert joint.peak == pytest.approx(late, rel=1e-10)
    # behind along its circle, whose sagitta at the same instant is the square of the angle
    assert result.along[100:400] == pytest.approx(-2.0 * lever * np.sin(0.5 * late) * np.cos(0.5 * late), rel=1e-7)
    assert result.across[100:400] == pytest.approx(2.0 * lever * np.sin(0.5 * late) ** 2, rel=1e-3)
    # m: on its circle all the same; the cubic through samples of 2 mrad is off by 1e-18
    assert result.peak(result.contour.error) < 1e-12
    assert result.peak(result.direction) < 1e-10


def test_a_lag_that_all_joints_have_in_common_is_no_contour_error() -> None:
    machine, time = KINDS["trunnion"], T * np.arange(600)
    lag = 2e-3
    wanted, late = joints_of(time), joints_of(time - lag)
    result = judged(machine, late[0], wanted, inside(600))
    speed = np.linalg.norm(tip_motion(machine, *wanted)[1], axis=1)
    # m: the same path, up to its cubic between samples; each joint is off by up to some 0.1 mm
    assert result.peak(result.contour.error) < 2e-9
    assert result.peak(result.added) < 1e-8
    assert result.peak(result.direction) < 1e-7
    assert max(joint.tip_peak for joint in result.joints) > 1e-4
    assert result.along[200] == pytest.approx(-lag * speed[200], rel=0.05)
    assert result.peak(result.direction_now) > 1e-3


def test_while_the_tip_stands_the_direction_is_that_of_the_same_instant() -> None:
    """The tip goes 20 mm along X, waits for a turn of C and A about it, and goes on: C is 100 urad off throughout."""
    machine = KINDS["trunnion"]
    n = 900
    time = T * np.arange(n)

    def smooth(begin: float, lasts: float) -> Taylor:
        x = np.clip((time - begin) / lasts, 0.0, 1.0)
        rate, bend = 30.0 * x**2 * (1.0 - x) ** 2, 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
        return Taylor(x**3 * (10.0 - 15.0 * x + 6.0 * x * x), rate / lasts, 0.5 * bend / lasts**2)

    turn = smooth(0.3, 0.3)
    rotary = [-0.5 * turn - 0.2, turn]
    place = [0.02 * (smooth(0.05, 0.2) + smooth(0.65, 0.2)), 0.0 * turn + 0.01, 0.0 * turn]
    series = [*machine.linear(place, rotary), *rotary]
    joints, velocity, half = (np.stack([row.terms[k] for row in series]) for k in range(3))
    wanted, a = (joints, velocity, 2.0 * half), joints[3]
    actual = joints.copy()
    actual[4] += 100e-6
    result = judged(machine, actual, wanted, inside(n))
    still = slice(310, 590)
    assert result.direction[still] == pytest.approx(np.abs(100e-6 * np.sin(a[still])), rel=1e-6)
    # the whole turn is 1 rad: the direction belongs to the place before and behind it, too
    assert result.peak(result.direction) < 110e-6


@pytest.mark.parametrize(("speed", "moves"), [(7e-7, False), (1.5e-6, True)])
def test_a_tip_slower_than_a_micrometer_per_second_stands(speed: float, moves: bool) -> None:
    """Its path then has no direction along which it could be behind."""
    time = T * np.arange(400)
    wanted = tuple(np.zeros((5, 400)) for _ in range(3))
    wanted[0][0], wanted[1][0] = speed * time, speed
    actual = wanted[0].copy()
    actual[0] -= 1e-6
    result = judged(KINDS["trunnion"], actual, wanted, inside(400))
    assert result.along[200] == pytest.approx(-1e-6 if moves else 0.0, rel=1e-9)
    assert result.across[200] == pytest.approx(0.0 if moves else 1e-6, abs=1e-15)


@pytest.mark.parametrize("name", ["table with offsets", "fork head"])
def test_velocity_and_acceleration_of_the_tip_are_its_derivatives(name: str) -> None:
    machine, time, step = KINDS[name], np.array([0.123]), 1e-4
    _, velocity, acceleration = tip_motion(machine, *joints_of(time))
    before, here, after = (path(machine, 0.123 + shift)[0] for shift in (-step, 0.0, step))
    # m/s, m/s2: by differences, with an error of step² times 20 m/s3, and of 1e-16 m / step²
    assert velocity[0] == pytest.approx((after - before) / (2.0 * step), abs=1e-6)
    assert acceleration[0] == pytest.approx((after - 2.0 * here + before) / step**2, abs=1e-5)


def test_the_tool_point_of_a_machine_with_geometry_errors_is_what_counts() -> None:
    machine, time = KINDS["trunnion"], T * np.arange(300)
    wanted = joints_of(time)
    axes = machine.letters.lower()
    signals = {
        f"{axis}.set_{name}": rows[k]
        for k, axis in enumerate(axes)
        for name, rows in zip(("position", "velocity", "acceleration"), wanted, strict=True)
    }
    signals |= {f"{axis}.position_load": wanted[0][k] for k, axis in enumerate(axes)}
    signals |= {f"tool.{axis}": wanted[0][k] + (3e-6 if axis == "z" else 0.0) for k, axis in enumerate("xyz")}
    result = tip_error(Run("run", signals, T, 300), machine, axes, counted=inside(300))
    assert np.hypot(result.along, result.across) == pytest.approx(3e-6, abs=1e-15)
