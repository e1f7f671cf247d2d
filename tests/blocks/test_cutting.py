"""Cutting forces: closed form against slices of the edge, energy, limits, and the force on an axis."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feeddrive.blocks.cutting.helical_cutter import HelicalCutter
from feeddrive.blocks.load.milling_force import MillingForce
from feeddrive.blocks.reference.bezier10 import Bezier10
from feeddrive.blocks.reference.linear_move import LinearMove
from feeddrive.language.errors import ParameterError, StructureError

CHIP = 5e-5  # m
SLOT = HelicalCutter.beltran2013()


def sliced(cutter: HelicalCutter, angle: float, chip_load: float, slices: int = 40_001) -> np.ndarray:
    """Feed, normal and axial force in N and torque in N m, slice by slice along each edge."""
    height = (np.arange(slices) + 0.5) / slices * cutter.axial_depth
    arc = np.pi if cutter.radial_depth is None else np.arccos(1.0 - 2.0 * cutter.radial_depth / cutter.diameter)
    entry, leave = (0.0, arc) if cutter.milling == "up" else (np.pi - arc, np.pi)
    total = np.zeros(4)
    for tooth in range(cutter.teeth):
        turned = angle + 2.0 * np.pi * tooth / cutter.teeth
        v = (turned - 2.0 * np.tan(cutter.helix_angle) / cutter.diameter * height) % (2.0 * np.pi)
        chip = np.where((v >= entry) & (v < leave), chip_load * np.sin(v), 0.0)
        tangential = cutter.specific_energy * chip * cutter.axial_depth / slices
        radial = cutter.radial_ratio * tangential
        total += [
            -np.sum(tangential * np.cos(v) + radial * np.sin(v)),
            np.sum(tangential * np.sin(v) - radial * np.cos(v)),
            cutter.axial_ratio * np.sum(tangential),
            0.5 * cutter.diameter * np.sum(tangential),
        ]
    return total


def closed(cutter: HelicalCutter, angle: Any, chip_load: float = CHIP) -> np.ndarray:
    return np.array([*cutter.forces(angle, chip_load), cutter.torque(angle, chip_load)], dtype=float)


@pytest.mark.parametrize(
    ("angle", "row"),
    [
        (0.0, (204.1755, 284.1650, 68.9547)),
        (0.5, (-17.8345, 59.4484, 36.7252)),
        (1.0, (-326.8796, 124.8485, 68.9547)),
        (2.0, (-250.7488, 674.0345, 143.4674)),
        (3.0, (216.9431, 376.2670, 86.0768)),
    ],
)
def test_the_forces_of_the_slot_to_the_printed_digits(angle: float, row: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(closed(SLOT, angle)[:3], row, rtol=0, atol=5.0e-5)


@settings(max_examples=60, deadline=None)
@given(
    teeth=st.integers(1, 7),
    axial=st.floats(1e-4, 0.06),
    helix=st.one_of(st.just(0.0), st.floats(1e-12, 1.3)),
    radial=st.one_of(st.none(), st.floats(1e-4, 0.012)),
    milling=st.sampled_from(["up", "down"]),
    angle=st.floats(-30.0, 30.0),
)
def test_the_closed_form_is_the_sum_over_slices(
    teeth: int, axial: float, helix: float, radial: float | None, milling: str, angle: float
) -> None:
    """Up to a slice too much or too little at each entry and exit of each tooth, and at a small helix a whole edge."""
    cutter = HelicalCutter(
        teeth=teeth,
        diameter=0.012,
        axial_depth=axial,
        helix_angle=helix,
        radial_depth=radial,
        milling=milling,
        specific_energy=2e9,
        radial_ratio=0.4,
        axial_ratio=0.25,
    )
    lag = 2.0 * axial * np.tan(helix) / 0.012
    # an edge that lies within a slice of entry or exit cuts whole or not at all by rounding
    tips = (angle + 2.0 * np.pi * np.arange(teeth) / teeth) % (2.0 * np.pi)
    arc = np.pi if radial is None else np.arccos(1.0 - 2.0 * radial / 0.012)
    edges = (0.0, arc) if milling == "up" else (np.pi - arc, np.pi)
    near = min(float(np.min(np.abs((tips - edge + np.pi) % (2.0 * np.pi) - np.pi))) for edge in edges)
    if lag < 1e-3 and near < 2e-3:
        return
    whole = 2e9 * CHIP * axial * teeth
    passes = 2.0 * (1.0 + np.ceil(lag / (2.0 * np.pi)))
    slack = whole * (2e-8 + 2.0 * passes / 40_001)
    np.testing.assert_allclose(closed(cutter, angle)[:3], sliced(cutter, angle, CHIP)[:3], rtol=0, atol=slack)


@pytest.mark.parametrize("teeth", [1, 2, 3, 5])
@pytest.mark.parametrize("helix", [0.2, 0.25 * np.pi, 1.2])
@pytest.mark.parametrize(("radial", "milling"), [(None, "up"), (0.003, "up"), (0.003, "down")])
def test_the_energy_is_that_of_the_chip(teeth: int, helix: float, radial: float | None, milling: str) -> None:
    """Mean torque · ω = u_s · volume per second: the mean over a turn by the middle rule, whose kinks leave 1e-7."""
    cutter = HelicalCutter(
        teeth=teeth,
        diameter=0.010,
        axial_depth=0.005,
        helix_angle=helix,
        radial_depth=radial,
        milling=milling,
        specific_energy=3e9,
    )
    angles: Any = 2.0 * np.pi * (np.arange(20_000) + 0.5) / 20_000
    power = np.mean(np.asarray(cutter.torque(angles, CHIP))) * 2.0 * np.pi * 30.0
    width = 0.010 if radial is None else radial
    assert power == pytest.approx(3e9 * (CHIP * teeth * 30.0) * width * 0.005, rel=1e-6)


def test_the_slot_means_and_power() -> None:
    angles: Any = 2.0 * np.pi * (np.arange(7200) + 0.5) / 7200
    feed, normal, _, torque = closed(SLOT, angles)
    assert np.mean(feed) == pytest.approx(-112.5, rel=1e-9)
    assert np.mean(normal) == pytest.approx(375.0, rel=1e-9)
    assert np.mean(torque) * 2.0 * np.pi * 30.0 == pytest.approx(450.0, rel=1e-9)
    assert (feed.min(), feed.max()) == (pytest.approx(-442, abs=0.5), pytest.approx(217, abs=0.5))
    assert (normal.min(), normal.max()) == (pytest.approx(46, abs=0.5), pytest.approx(704, abs=0.5))


@pytest.mark.parametrize("angle", [0.3, 1.1, 2.9])
def test_straight_edges_are_the_limit_of_helical_ones(angle: float) -> None:
    """The force differs by its slope times half the lag, which is below 2 lag of the largest force."""

    def made(helix: float) -> np.ndarray:
        return closed(
            HelicalCutter(teeth=3, diameter=0.01, axial_depth=0.005, helix_angle=helix, specific_energy=3e9), angle
        )

    straight = made(0.0)
    for helix in (1e-2, 1e-4, 1e-6, 1e-9, 1e-13):
        assert np.max(np.abs(made(helix)[:3] - straight[:3])) <= 2.0 * helix * 750.0 * 3.0 + 1e-9


def test_an_edge_that_cuts_for_a_whole_turn_has_no_ripple() -> None:
    """With a lag of 2π/teeth one edge enters where another leaves, so that the force stands still."""
    lag = np.pi  # two teeth
    cutter = HelicalCutter(
        teeth=2, diameter=0.01, axial_depth=0.005 * lag, helix_angle=0.25 * np.pi, specific_energy=3e9
    )
    rows = np.array([closed(cutter, angle) for angle in np.linspace(0.0, 6.0, 25)])
    assert np.ptp(rows, axis=0).max() <= 1e-9 * np.abs(rows).max()


def test_the_printed_data_warn_and_are_absurd() -> None:
    with pytest.warns(UserWarning, match="ten times"):
        cutter = HelicalCutter.beltran2013_as_printed()
    angles: Any = np.linspace(0.0, 2.0 * np.pi, 3601)
    assert np.max(np.abs(cutter.forces(angles, 1e-3)[1])) == pytest.approx(141e3, rel=0.002)


def test_a_cut_wider_than_the_tool_is_refused_with_the_widest() -> None:
    with pytest.raises(ParameterError, match=r"radial_depth = 0\.011 m is 0\.001 m more .* at most 0\.01 m"):
        HelicalCutter(teeth=2, diameter=0.01, axial_depth=0.005, radial_depth=0.011, specific_energy=3e9)


def milling(**changed: Any) -> MillingForce:
    return MillingForce(**({"cutter": SLOT, "spindle_speed": 1800.0, "chip_load": CHIP} | changed))


TIME = np.arange(0.0, 0.1, 1e-4)


def test_the_force_turns_with_the_feed() -> None:
    """A feed towards θ gives the force of a feed along x, turned by θ; the axial force stays."""
    x, y = (milling(component=axis).at(TIME) for axis in "xy")
    for direction in (0.3, 0.5 * np.pi, -2.0):
        turned_x, turned_y = (milling(component=axis, direction=direction).at(TIME) for axis in "xy")
        c, s = np.cos(direction), np.sin(direction)
        np.testing.assert_allclose(turned_x, c * x - s * y, rtol=0, atol=1e-9)
        np.testing.assert_allclose(turned_y, s * x + c * y, rtol=0, atol=1e-9)
    assert np.all(milling(component="z").at(TIME) < 0.0)


def test_it_passes_at_the_frequency_of_the_teeth() -> None:
    force = milling().at(np.arange(10_000) * 1e-4)
    lines = np.abs(np.fft.rfft(force - force.mean()))
    assert np.argmax(lines) == 60  # Hz in a record of 1 s: 2 teeth, 1800 rpm
    assert force.mean() == pytest.approx(-112.5, rel=1e-6)


def test_the_chip_follows_the_feed_of_the_references() -> None:
    """A leg at constant feed gives the constant chip load; a Bezier leg scales it by the speed at each instant."""
    still = LinearMove(distance=0.0, travel_time=1.0)
    line = LinearMove(distance=0.1 * 3e-3, travel_time=0.1)
    np.testing.assert_allclose(
        milling(chip_load=None, references=(line, still)).at(TIME), milling().at(TIME), rtol=0, atol=1e-9
    )
    bezier = Bezier10(distance=0.1 * 3e-3, travel_time=0.1)
    share = np.asarray(bezier.at(TIME).velocity) / 3e-3
    np.testing.assert_allclose(
        milling(chip_load=None, references=(still, bezier), component="y").at(TIME),
        share * milling().at(TIME),
        rtol=0,
        atol=1e-9,
    )
    assert np.all(milling(chip_load=None, references=(still, still)).at(TIME) == 0.0)


def test_a_straight_edge_in_a_quarter_of_the_turn_cuts_with_gaps() -> None:
    cutter = HelicalCutter(teeth=1, diameter=0.01, axial_depth=0.005, radial_depth=0.005, specific_energy=3e9)
    force = milling(cutter=cutter).at(np.arange(1000) * (60.0 / 1800.0 / 1000))
    assert np.mean(force != 0.0) == pytest.approx(0.25, abs=0.002)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"chip_load": None}, "either chip_load"),
        ({"references": (LinearMove(distance=1, travel_time=1),) * 2}, "exactly one"),
        ({"chip_load": None, "references": (LinearMove(distance=1, travel_time=1),)}, "must be two"),
    ],
)
def test_one_source_of_the_chip(changed: dict[str, Any], said: str) -> None:
    with pytest.raises(StructureError, match=said):
        milling(**changed)
