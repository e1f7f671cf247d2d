"""A tip held while a rotary joint turns, through the loops: waves of location errors by closed forms, and the loops."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.files.machine import MachineFile, planned_limits, read_machine
from feeddrive.language.errors import ParameterError, ProgramError
from feeddrive.language.quantity import DRAWN
from feeddrive.machining.held_tip import DIRECTIONS, HeldTip, _directions, held_tip_test
from feeddrive.machining.pivots import PivotError
from feeddrive.plot.drawing import drawn

TIP = (0.04, 0.03, 0.02)  # m: 50 mm from the axis of C
# rad, as quick as its limits allow without long ramps
TURN, QUICK = 2.0 * np.pi, 3.0


@pytest.fixture(scope="module")
def trunnion() -> MachineFile:
    return read_machine("trunnion_ac")


def held(
    file: MachineFile, joint: str, errors: dict[str, PivotError], begin: float = 0.0, end: float = TURN, **more: float
) -> HeldTip:
    assert file.kinematics is not None
    return held_tip_test(
        file.machine(),
        file.kinematics,
        planned_limits(file, None),
        joint,
        TIP,
        begin=begin,
        end=end,
        speed=QUICK,
        errors=errors,
        **more,  # type: ignore[arg-type]
    )


def waves(result: HeldTip) -> list[float]:
    return [wave.amplitude for wave in result.waves_of_geometry.values()]


@pytest.fixture(scope="module")
def shifted(trunnion: MachineFile) -> HeldTip:
    return held(trunnion, "C", {"C": PivotError(shift=(12e-6, -9e-6, 5e-6))})


@pytest.fixture(scope="module")
def exact(trunnion: MachineFile) -> HeldTip:
    return held(trunnion, "C", {})


def test_the_eccentricity_in_the_reading_is_the_offset_of_the_pivot(shifted: HeldTip, exact: HeldTip) -> None:
    """e = (12, -9) um: waves of 15 um, radial and tangential a quarter turn apart; a shift along C shows nothing."""
    assert waves(shifted) == pytest.approx([15e-6, 15e-6, 0.0], abs=1e-15)
    of_axes = shifted.waves_of_geometry
    # radial: r · (I - R) e, with r at 36.87 deg and e at -36.87 deg: largest where C brings e against r
    apart = np.arctan2(-9.0, 12.0) - np.arctan2(3.0, 4.0)
    assert np.cos(of_axes["radial"].angle) == pytest.approx(-np.cos(apart), abs=1e-9)
    turned = (of_axes["tangential"].angle - of_axes["radial"].angle) % TURN
    assert min(turned, TURN - turned) == pytest.approx(0.5 * np.pi, abs=1e-9)
    # the loops add less than the wave that they draw without an error of the axes
    for name in ("radial", "tangential"):
        off = abs(shifted.waves[name].amplitude - of_axes[name].amplitude)
        assert off <= exact.waves[name].amplitude * (1.0 + 1e-3) + 1e-12
        assert off < 0.5e-6
    assert shifted.lever == pytest.approx(0.05, rel=1e-12)


def test_the_loops_add_the_same_whatever_the_axes_are_off(shifted: HeldTip, exact: HeldTip) -> None:
    assert np.abs(exact.geometry).max() < 1e-16
    added = shifted.reading - shifted.geometry
    # m: angles of some 1e-4 rad times 15 um
    assert np.abs(added - exact.reading).max() < 1e-8
    # friction reverses X and Y four times a turn, later in the other direction: peaks outward
    wave = exact.waves["radial"]
    assert wave.width > 5e-6
    assert wave.hysteresis > 0.5 * wave.width
    assert exact.waves["axial"].width < 1e-12
    assert set(np.unique(exact.way)) == {-1, 0, 1}


@pytest.mark.slow(reason="six more runs of the machine: their closed forms alone stand in test_pivots.py")
def test_a_tilt_of_c_shows_in_the_axial_reading_with_the_radius(trunnion: MachineFile) -> None:
    alpha = 40e-6
    result = held(trunnion, "C", {"C": PivotError(tilt=(alpha, 0.0, 0.0))})
    # axial: alpha times 50 mm; radial and tangential: alpha times the height of the tip over the point of the axis
    # that is not off, 20 mm - 80 mm below the axis of A, where the machine has its zero
    assert waves(result) == pytest.approx([alpha * 0.06, alpha * 0.06, alpha * 0.05], rel=1e-3)


@pytest.mark.slow(reason="three more runs of the machine, as above")
@pytest.mark.parametrize(
    ("shift", "wave"), [((7e-6, 0.0, 0.0), 0.0), ((0.0, 8e-6, 0.0), 8e-6), ((0.0, 3e-6, -4e-6), 5e-6)]
)
def test_a_shift_of_a_shows_across_its_axis(
    trunnion: MachineFile, shift: tuple[float, float, float], wave: float
) -> None:
    result = held(trunnion, "A", {"A": PivotError(shift=shift)}, -0.5 * np.pi, np.pi / 6.0)
    # m: an arc of 120 deg gives the wave of the whole turn
    assert waves(result) == pytest.approx([wave, wave, 0.0], abs=1e-12)


@pytest.mark.slow(reason="another run of the machine, as above")
def test_an_error_of_the_other_joint_does_not_show_while_it_stands(trunnion: MachineFile) -> None:
    result = held(trunnion, "C", {"A": PivotError(shift=(0.0, 20e-6, 20e-6))}, held=0.0)
    # the axis of A stands: all it does is to move the tip as a whole, which the set-up takes out
    assert np.ptp(result.geometry, axis=1).max() < 1e-15


def test_table_and_chart_say_the_waves(shifted: HeldTip) -> None:
    text = f"{shifted.table()}"
    assert "C from 0 deg to 360 deg and back, tip held 50 mm from its axis" in text
    assert [line.split()[0] for line in text.splitlines()[3:]] == list(DIRECTIONS)
    panels = shifted.chart().shown(DRAWN).panels
    assert [panel.label for panel in panels] == [f"{name}\n(µm)" for name in DIRECTIONS]
    assert np.max(panels[0].curves[0].y) == pytest.approx(1e6 * np.max(shifted.reading[0][shifted.way == 1]))
    drawn(shifted.chart())


def test_what_cannot_be_read_is_refused(trunnion: MachineFile) -> None:
    machine, limits = trunnion.machine(), planned_limits(trunnion, None)
    assert trunnion.kinematics is not None

    def test(joint: str = "C", tip: tuple[float, ...] = TIP, **more: float) -> None:
        held_tip_test(machine, trunnion.kinematics, limits, joint, tip, **more)  # type: ignore[arg-type]

    with pytest.raises(ParameterError, match="no rotary joint 'B'; there are: A, C"):
        test("B")
    with pytest.raises(ParameterError, match=r"end = 45 deg must lie within the travel of joint A, -120 deg to 30 deg"):
        test("A", begin=-1.0, end=0.25 * np.pi)
    with pytest.raises(ParameterError, match=r"are 57.3 deg apart, and mean and wave of a reading need 60 deg"):
        test(end=1.0)
    with pytest.raises(ParameterError, match=r"speed = 0.0 rad/s must be > 0"):
        test(speed=0.0)
    with pytest.raises(ProgramError, match="joint X would go to"):
        test(tip=(0.3, 0.0, 0.0))


@pytest.mark.parametrize(("radius", "fine"), [(0.0007, False), (0.0015, True)])
def test_a_tip_within_a_millimeter_of_the_axis_has_no_radial_direction(
    trunnion: MachineFile, radius: float, fine: bool
) -> None:
    assert trunnion.kinematics is not None
    given = trunnion.machine(), trunnion.kinematics, planned_limits(trunnion, None), "C", (radius, 0.0, 0.0)
    if fine:
        assert held_tip_test(*given, end=1.1, speed=QUICK).lever == pytest.approx(radius)
        return
    with pytest.raises(ParameterError, match=r"the tip lies 0.7 mm from the axis of joint C, .* needs 1 mm: move it"):
        held_tip_test(*given, end=1.1, speed=QUICK)


def test_the_directions_are_those_of_the_joint_and_right_handed(trunnion: MachineFile) -> None:
    """C at 0: away from Z, along its turn, and up; A at 90 degrees: the workpiece has turned, its axis has not."""
    assert trunnion.kinematics is not None
    linear = trunnion.kinematics.linear((0.04, 0.03, 0.02), (0.0, 0.0))
    found, lever = _directions(trunnion.kinematics, "C", np.array([*linear, 0.0, 0.0])[:, None])
    assert lever == pytest.approx(0.05, rel=1e-12)
    assert found[..., 0] == pytest.approx(np.array([[0.8, 0.6, 0.0], [-0.6, 0.8, 0.0], [0.0, 0.0, 1.0]]), abs=1e-12)
    # the axis of A lies 80 mm over the workpiece: at A = -90 degrees the tip is still 3, -6 from it there
    linear = trunnion.kinematics.linear((0.04, 0.03, 0.02), (-0.5 * np.pi, 0.0))
    found, lever = _directions(trunnion.kinematics, "A", np.array([*linear, -0.5 * np.pi, 0.0])[:, None])
    away = np.array([0.0, 0.03, -0.06]) / np.hypot(0.03, 0.06)
    assert lever == pytest.approx(np.hypot(0.03, 0.06), rel=1e-12)
    assert found[..., 0] == pytest.approx(np.array([away, [0.0, -away[2], away[1]], [1.0, 0.0, 0.0]]), abs=1e-12)


def test_both_ways_are_compared_without_their_ends() -> None:
    """1 um apart in the outer hundredths, where the joint comes to rest, and 0.4 um between them."""
    there = np.linspace(0.0, TURN, 2001)
    angle, way = np.concatenate([there, there[::-1]]), np.repeat([1, -1], 2001)
    apart = np.where(np.abs(angle - 0.5 * TURN) > 0.47 * TURN, 0.5e-6, 0.2e-6) * way
    reading = np.stack([apart + 3e-6 * np.cos(angle - 0.7), apart, 0.0 * apart])
    result = HeldTip("made", "C", TIP, 0.05, angle, way, reading, 0.0 * reading, 1e-3)
    radial, _, axial = result.waves.values()
    assert (radial.amplitude, radial.angle) == pytest.approx((3e-6, 0.7), rel=1e-3)
    assert radial.hysteresis == pytest.approx(0.4e-6, rel=1e-6)
    assert axial.width == 0.0
