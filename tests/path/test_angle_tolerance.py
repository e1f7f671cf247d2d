"""Rotary axes have a tolerance of their own, by which angles are weighted where corners are rounded."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from five_axes import TRUNNION, blade, blocks, farthest, tip_feeds

import feeddrive as fd
from feeddrive.files.plan_files import plan_record
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.path.geometry.segments import chains
from feeddrive.path.geometry.weights import ANGLE_TOLERANCE, Weights
from feeddrive.path.limits import AxisLimits, MachineLimits
from feeddrive.path.motion import Part, Pause
from feeddrive.path.planned import planned_of
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Prover
from feeddrive.path.setpoints import Sampler, Setpoints, planned

LIMITS = """
[axis.{}.limits]
velocity = 0.5
acceleration = 5
jerk = 100
snap = 5e4
"""
TURNING = """
[axis.{}.limits]
velocity_deg_per_s = 300
acceleration_deg_per_s2 = 2000
jerk_rad_per_s3 = 600
snap_rad_per_s4 = 3e5
"""


@pytest.mark.parametrize("angle", [0.05, 0.2])
def test_a_blade_of_joint_blocks_has_no_stop(angle: float) -> None:
    """It had 86 stops and took 20.1 s when 1 rad counted as 1 m: 10 um were 10 urad.  At 0.05 deg it takes 7.50 s.

    At 0.2 deg it takes 6.90 s, and took 59.97 s while one window crept at the cap of its slowest piece.

    Every sample is within both tolerances of the polygon of the blocks; 1e-9 relative for rounding.
    """
    tip, joints = blade()
    tolerance, turned = 1e-5, math.radians(angle)
    prover, sampler, rows, runs = Prover(TRUNNION), Sampler(2e-3), [], 0
    moves = blocks(joints, tip_feeds(tip, joints, 0.1), tolerance)
    for part in planned(moves, "XYZAC", TRUNNION, angle_tolerance=turned):
        assert isinstance(part, Part)
        assert prover.prove(part), prover.proof().faults[0]
        rows.append(sampler.sample(part)[:, :, 0])
        runs += part.ends
    samples = np.concatenate(rows)
    assert runs == 1
    assert len(samples) * 2e-3 < 7.6
    np.testing.assert_allclose(samples[0], joints[0], atol=1e-9)
    shares = np.array([1.0 / tolerance] * 3 + [1.0 / turned] * 2)
    used = farthest(samples[::8] * shares, joints * shares)
    assert np.all(used <= 1.0 + 1e-9), used
    assert np.max(used) > 0.5  # otherwise the test sees nothing


def spread(text: str, folder: Path, axes: str = "XYZAC", **given: Any) -> list[Part | Pause]:
    path = folder / "part.ngc"
    path.write_text(text, encoding="utf-8")
    limits = np.array([TRUNNION["XYZAC".index(letter)] for letter in axes])
    return list(planned(read_program(path), axes, limits, **given))


def axis_limits(row: np.ndarray) -> AxisLimits:
    velocity, acceleration, jerk, snap = row.tolist()
    return AxisLimits(velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap)


CORNERS = "G64 P{}\nF6000\nG1 X10 A1\nX20 Y1 A3\nG64 P{}\nX30 A2\nX40 Y1 A1\nM2\n"


def test_a_change_of_the_tolerance_stops_where_axes_turn(tmp_path: Path) -> None:
    """The weight of an angle is P / α for the whole run: with another P another run begins, and none without a turn."""
    found = spread(CORNERS.format(0.05, 0.02), tmp_path)
    assert [part.why for part in found if isinstance(part, Pause)] == ["Tolerance", "Spindle"]
    weights = [part.weights for part in found if isinstance(part, Part)]
    shares = {round(float(weight[3]) * ANGLE_TOLERANCE, 12) for weight in weights if weight is not None}
    assert shares == {5e-5, 2e-5}
    for same in (CORNERS.format(0.05, 0.05), CORNERS.format(0.05, 0.02).replace("A", "Z")):
        assert [part.why for part in spread(same, tmp_path) if isinstance(part, Pause)] == ["Spindle"]  # of M2
    limits = MachineLimits({letter: axis_limits(row) for letter, row in zip("XYZAC", TRUNNION, strict=True)})
    (tmp_path / "part.ngc").write_text(CORNERS.format(0.05, 0.02), encoding="utf-8")
    shown = planned_of(Setpoints(read_program(tmp_path / "part.ngc"), limits, 1e-3), "part", "table")
    assert shown.proof.count == 0
    assert [stop.reason for stop in shown.stops if "tolerance, by which" in stop.reason]


def test_weights_keep_both_tolerances() -> None:
    """Within the tolerance of a move an axis with the weight w deviates by tolerance / w, never more than its own."""
    draw = np.random.default_rng(5)
    for _ in range(300):
        angles = 10.0 ** draw.uniform(-8.0, -0.8, 2)
        weights, values = Weights("XAC", [math.inf, *angles]), None
        for _ in range(20):
            tolerance = float(draw.choice([0.0, 10.0 ** draw.uniform(-8.0, 0.0)]))
            weights.allow(tolerance)
            turns = bool(draw.random() < 0.5)
            if values is None or not weights.fit(turns) or draw.random() < 0.1:
                weights.begin()
            values = weights.values
            assert values is not None
            assert values[0] == 1.0
            allowed = weights.tolerance_of(turns)
            assert allowed <= tolerance
            if turns:
                assert np.all(allowed / values[1:] <= angles * (1.0 + 1e-9))
                assert (allowed > 0.0) == (tolerance > 0.0)


def test_axes_have_tolerances_of_their_own() -> None:
    """The ratio of two weights is the inverse of that of their tolerances."""
    moves = blocks(blade(50)[1], np.full(49, 0.1), 1e-5)
    chain = next(iter(chains(moves, "XYZAC", [math.inf] * 3 + [1e-3, 2e-3])))
    assert not isinstance(chain, Pause)
    assert chain.weights is not None
    np.testing.assert_allclose(chain.weights, [1.0, 1.0, 1.0, 0.01, 0.005], rtol=1e-12)


def test_the_proof_measures_the_feed_by_the_weights(tmp_path: Path) -> None:
    """A part at its feed is refused if an angle counts for a hundredth more."""
    part, _ = spread("G64 P0.05\nG1 X2 A90 F60\nM2\n", tmp_path)
    assert isinstance(part, Part)
    assert part.weights is not None
    assert Prover(TRUNNION).prove(part)
    wrong = Prover(TRUNNION)
    assert not wrong.prove(part._replace(weights=part.weights * [1.0, 1.0, 1.0, 1.01, 1.0]))
    assert "feed" in wrong.proof().faults[0].what


def test_the_feed_is_that_of_the_linear_axes(tmp_path: Path) -> None:
    """60 mm/min along X, whatever A turns by and whatever an angle counts for: 10 mm take 10 s, and two ramps."""
    for angle in (1e-4, 1e-3, 0.1):
        parts = spread("G64 P0.05\nG1 X10 A90 F60\nM2\n", tmp_path, angle_tolerance=angle)
        lasts = sum(float(part.motion.duration.sum()) for part in parts if isinstance(part, Part))
        assert lasts == pytest.approx(10.0, abs=0.05)


def test_the_tolerance_comes_from_file_and_option(tmp_path: Path) -> None:
    """0.05 deg if none is stated; plan.json has what was taken."""
    program, limits = tmp_path / "part.ngc", tmp_path / "limits.toml"
    program.write_text("G64 P0.01\nG1 X10 A3 F6000\nX20 A2\nX30 A4\nM2\n", encoding="utf-8")

    def taken(stated: str, **given: Any) -> float:
        limits.write_text(LIMITS.format("x") + TURNING.format("a") + stated, encoding="utf-8")
        found = fd.workflow.plan(program, limits=limits, sample_time=1e-3, **given)
        assert found.proof.count == 0
        return float(plan_record(found)["angle_tolerance_rad"]["A"])

    assert taken("") == ANGLE_TOLERANCE == math.radians(0.05)
    assert taken("tolerance_deg = 0.2\n") == pytest.approx(math.radians(0.2))
    assert taken("tolerance_deg = 0.2\n", angle_tolerance=0.01) == 0.01


@pytest.mark.parametrize(
    ("axis", "stated", "given", "said"),
    [
        (
            "x",
            "",
            {"angle_tolerance": 0.01},
            "--angle-tolerance is for axes that turn (a, b, c), and the machine has x",
        ),
        ("x", "tolerance_um = 5\n", {}, "limits.toml: axis 'x': limits.tolerance is for axes that turn"),
        (
            "a",
            "tolerance_deg = 20\n",
            {},
            "axis 'a': limits.tolerance = 20 deg is more than 10 deg: give a smaller one",
        ),
        (
            "a",
            "resolution_deg = 0.1\ntolerance_deg = 0.05\n",
            {},
            "is smaller than the resolution of the axis, 0.1 deg",
        ),
        ("a", "tolerance_deg = 1e-9\n", {}, "is smaller than what the planner resolves"),
        ("a", "", {"angle_tolerance": 1.0}, "--angle-tolerance: axis 'a': limits.tolerance = 57.3 deg is more than"),
    ],
)
def test_unfit_tolerances_are_refused(axis: str, stated: str, given: dict[str, Any], said: str, tmp_path: Path) -> None:
    """With file, axis, value, bound and what to do."""
    program, limits = tmp_path / "part.ngc", tmp_path / "limits.toml"
    program.write_text("G1 X1 F100\nM2\n", encoding="utf-8")
    limits.write_text((LIMITS if axis == "x" else TURNING).format(axis) + stated, encoding="utf-8")
    with pytest.raises(FeeddriveError) as caught:
        fd.workflow.plan(program, limits=limits, sample_time=1e-3, **given)
    assert said in str(caught.value), str(caught.value)


def test_limits_without_a_rotary_axis_have_no_weights() -> None:
    """Then nothing is multiplied, and plans keep their bits."""
    assert Weights("XYZUVW").values is None
    with pytest.raises(ParameterError, match="for axes that turn"):
        MachineLimits({"X": replace(axis_limits(TRUNNION[0]), tolerance=1e-3)})
    assert MachineLimits({"X": axis_limits(TRUNNION[0])}).angle_tolerances.tolist() == [math.inf]


def test_a_weight_is_from_1_mm_to_10_m_and_that_of_10_um_at_first() -> None:
    """P / α = 1e-5/1e-3 before any tolerance; 1.5e-3 and 8 stay, 0.8e-3 and 15 do not.

    Beyond the bounds the tolerance is that within which the axis keeps its own.
    """
    weights = Weights("A", 1e-3)
    assert weights.values == pytest.approx([0.01])
    for wanted, taken in ((1.5e-3, 1.5e-3), (0.8e-3, 1e-3), (8.0, 8.0), (15.0, 10.0)):
        weights.allow(1e-3 * wanted)
        weights.begin()
        assert weights.values == pytest.approx([taken])
        assert weights.tolerance_of(True) == pytest.approx(1e-3 * min(wanted, taken))
    # the run has turned with another weight, which differs by more than rounding
    weights.allow(1e-3 * 9.0)
    assert not weights.fit(True)


@pytest.mark.parametrize(("tolerance", "said"), [(0.8e-9, "what the planner resolves"), (1.5e-9, "")])
def test_the_least_tolerance_of_a_rotary_axis_is_a_nanoradian(tolerance: float, said: str) -> None:
    axis = replace(axis_limits(TRUNNION[3]), tolerance=tolerance)
    if said:
        with pytest.raises(ParameterError, match=said):
            MachineLimits({"A": axis})
    else:
        assert MachineLimits({"A": axis}).angle_tolerances == [tolerance]
