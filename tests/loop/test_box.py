"""A box of plants: what a text says, which parameters spread and how far, and that every corner is a machine."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.box import Box, Corner
from feeddrive.loop.loop import Loop


@pytest.fixture(scope="module")
def screw() -> Loop:
    return fd.read_machine("ball_screw").loop("x")


@pytest.mark.parametrize(
    ("text", "box"),
    [
        ("stiffness=0.2,mass=0.3,dead_time=1sample", Box()),
        ("standard", Box(0.2, 0.3, 1)),
        ("none", None),
        ("mass=15%", Box(0.0, 0.15, 0)),
        ("dead_time=2samples, stiffness = 0.1", Box(0.1, 0.0, 2)),
        ("identified", Box(0.2, 0.3, 1, 2.0)),
        ("identified=3", Box(0.2, 0.3, 1, 3.0)),
        ("dead_time=2samples,identified=1.5", Box(0.0, 0.0, 2, 1.5)),
    ],
)
def test_a_text_is_a_box(text: str, box: Box | None) -> None:
    assert Box.parse(text) == box


@pytest.mark.parametrize("box", [Box(), Box(0.1, 0.0, 0), Box(0.0, 0.5, 3), Box(0.2, 0.3, 1, 2.5)])
def test_the_text_of_a_box_is_read_as_this_box(box: Box) -> None:
    assert Box.parse(str(box)) == box


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stifness=0.2", "'stifness=0.2' is no tolerance with a value; did you mean stiffness"),
        ("mass", "mass has no value: write it as stiffness=0.2,mass=0.3,dead_time=1sample"),
        ("mass=", "mass has no value"),
        ("0.2", "'0.2' is no tolerance with a value; there are: stiffness, mass, dead_time; write"),
        ("mass=1", "mass = 1.0 must be a share >= 0 and < 1"),
        ("mass=-0.1", "mass = -0.1 must be a share >= 0 and < 1"),
        ("mass=heavy", "mass = heavy is not a number"),
        ("mass=nan", "mass = nan must be a share"),
        ("mass=0.1,mass=0.2", "mass is stated twice"),
        ("dead_time=0.5sample", "the dead time is a whole number of samples, such as 1sample"),
        ("identified=0", "identified is stated once, with a number of standard errors > 0: write identified"),
        ("identified=many", "identified is stated once, with a number of standard errors > 0"),
        ("identified,identified=3", "identified is stated once"),
        ("none,identified", "identified is stated once"),
        ("dead_time=101samples", "dead_time = 101 must be a whole number of samples from 0 to 100"),
    ],
)
def test_a_wrong_text_says_what_to_write(text: str, message: str) -> None:
    with pytest.raises(ParameterError) as error:
        Box.parse(text)
    assert message in str(error.value)


def test_every_mass_and_stiffness_of_the_plant_spreads(screw: Loop) -> None:
    ends = {d.path: (d.at(-1.0), d.at(1.0)) for d in Box().dimensions(screw.axis)}
    plant = dict(tree.leaves(screw.axis.plant))
    masses, springs = ["mass_motor", "mass_screw", "mass_load"], ["coupling_stiffness", "stiffness"]
    assert ends == {
        **{name: pytest.approx((0.7 * plant[name], 1.3 * plant[name])) for name in masses},
        **{name: pytest.approx((0.8 * plant[name], 1.2 * plant[name])) for name in springs},
    }


def test_a_plant_has_its_numbers_and_is_later_by_whole_samples(screw: Loop) -> None:
    box = Box()
    moved = box.plant(screw, Corner((1.0, 0.0, -1.0, 0.5, -1.0), 1))
    changes = {
        name: (value, dict(tree.leaves(moved.axis.plant))[name]) for name, value in tree.leaves(screw.axis.plant)
    }
    changed = {name: new / old for name, (old, new) in changes.items() if new != old}
    assert changed == pytest.approx({"mass_motor": 1.3, "mass_load": 0.7, "coupling_stiffness": 1.1, "stiffness": 0.8})
    later = moved.axis.actuator.dead_time - screw.axis.actuator.dead_time
    assert later == pytest.approx(screw.sample_time, rel=1e-12)
    assert moved.control is screw.control  # it is told the model, not the plant


def test_the_frequency_of_a_mode_takes_the_root_of_the_spread(screw: Loop) -> None:
    plant = Modal(mass=100.0, modes=(Mode(frequency=200.0, mass=50.0),))
    axis = replace(screw.axis, plant=plant, friction_motor=None, friction_load=None)
    ends = {d.path: d.at(1.0) for d in Box(0.44, 0.3).dimensions(axis)}
    assert ends == pytest.approx({"mass": 130.0, "modes.0.mass": 65.0, "modes.0.frequency": 240.0})


def test_a_coupling_mass_goes_with_the_masses_it_couples(screw: Loop) -> None:
    """Varied alone, m12 = 60 kg of masses 100 and 40 kg would leave no positive definite mass matrix at corners."""
    plant = TwoMass(mass_motor=100.0, mass_load=40.0, stiffness=1e8, coupling_mass=60.0)
    loop = replace(screw, axis=replace(screw.axis, plant=plant))
    box = Box()
    for corner in box.corners(loop.axis):
        varied = box.plant(loop, corner).axis.plant
        assert isinstance(varied, TwoMass)
        assert varied.coupling_mass is not None
        share = varied.coupling_mass**2 / (varied.mass_motor * varied.mass_load)
        assert share == pytest.approx(0.9, rel=1e-12)


def test_a_rotary_axis_spreads_its_inertia() -> None:
    axis = fd.read_machine("rotary_table").loop("c").axis
    (dimension,) = Box().dimensions(axis)
    assert (dimension.path, dimension.unit) == ("mass", "kg m2")
    assert "0.56 to 1.04 kg m2" in str(Box().text(axis))


def test_all_corners_up_to_64_and_of_more_those_around_the_blocks(screw: Loop) -> None:
    box = Box()
    corners = list(box.corners(screw.axis))
    assert len(set(corners)) == len(corners) == box.all_corners(screw.axis) == 64
    plant = Modal(mass=100.0, modes=tuple(Mode(frequency=100.0 * (i + 1), mass=50.0) for i in range(4)))
    axis = replace(screw.axis, plant=plant, friction_motor=None, friction_load=None)
    many = list(box.corners(axis))
    assert len(set(many)) == len(many) == 64
    assert box.all_corners(axis) == 2**10
    masses = [d.unit == "kg" for d in box.dimensions(axis)]
    blocks = {tuple(m if is_mass else k for is_mass in masses) for m in (-1.0, 1.0) for k in (-1.0, 1.0)}
    assert {Corner(block, late) for block in blocks for late in (0, 1)} <= set(many)


def test_plants_common_to_all_laws_are_corners_of_the_box(screw: Loop) -> None:
    """Eight with masses, stiffnesses and dead time, and fewer where one of them does not spread."""
    found = list(Box().together(screw.axis))
    assert len(found) == len(set(found)) == 8
    assert set(found) <= set(Box().corners(screw.axis))
    masses = [d.unit == "kg" for d in Box().dimensions(screw.axis)]
    for corner in found:
        for kind in (True, False):
            assert len({u for u, is_mass in zip(corner.place, masses, strict=True) if is_mass is kind}) == 1
    assert [len(list(box.together(screw.axis))) for box in (Box(dead_time=0), Box(0.0, 0.3, 1), Box(0.0, 0.0, 1))] == [
        4, 4, 2,
    ]  # fmt: skip


def test_correlated_errors_lie_along_their_principal_axes(screw: Loop) -> None:
    """Three errors of 4, 3 and 5 %: what their covariance allows is in the box, and its ends are those of the sum."""
    plant = TwoMass(mass_motor=100.0, mass_load=40.0, stiffness=1e8)
    axis = replace(screw.axis, plant=plant, friction_motor=None, friction_load=None)
    names, shares = ("mass_motor", "mass_load", "stiffness"), np.array([0.04, 0.03, 0.05])
    values = np.array([100.0, 40.0, 1e8])
    R = np.array([[1.0, 0.5, 0.7], [0.5, 1.0, 0.95], [0.7, 0.95, 1.0]])
    errors = {f"plant.{name}": share * value for name, share, value in zip(names, shares, values, strict=True)}
    ties = {frozenset((f"plant.{names[i]}", f"plant.{names[j]}")): R[i, j] for i in range(3) for j in range(i)}
    box = Box(deviations=2.0, dead_time=0).with_errors(axis, errors, "x.toml", ties)

    def at(place: Any) -> np.ndarray:
        varied = box.plant_of(axis, place)
        return np.array([getattr(varied, name) for name in names]) / values[(...,) + (None,) * np.ndim(place[0])] - 1.0

    covariance = R * np.outer(shares, shares)
    axes = np.array([at(row) for row in np.eye(3).tolist()])
    # at a principal axis two standard errors away, and each axis uncorrelated with the others
    assert axes @ np.linalg.inv(covariance) @ axes.T == pytest.approx(4.0 * np.eye(3), abs=1e-9)
    random = np.random.default_rng(4)
    for w in random.uniform(-1.0, 1.0, (5, 3)):
        assert at(w.tolist()) == pytest.approx(w @ axes, abs=1e-12)
    many = random.uniform(-1.0, 1.0, (3, 7))
    assert at(tuple(many)) == pytest.approx((many.T @ axes).T, abs=1e-12)
    ends = np.array([d.at(1.0) for d in box.dimensions(axis)]) / values - 1.0
    assert ends == pytest.approx(np.sum(np.abs(axes), axis=0))
    corners = np.array([at(corner.place) for corner in box.corners(axis)])
    assert np.max(np.abs(corners), axis=0) == pytest.approx(ends)
    # stiffness over mass, by which the frequency is known: a third of what independent errors of this size allow
    ratio = np.ptp((1.0 + corners[:, 2]) / (1.0 + corners[:, 1]))
    box = box.upright()
    independent = np.array([at(corner.place) for corner in box.corners(axis)])
    assert ratio < 0.4 * np.ptp((1.0 + independent[:, 2]) / (1.0 + independent[:, 1]))
    assert np.max(np.abs(independent), axis=0) == pytest.approx(ends)


def test_a_plant_of_correlated_errors_is_named_by_its_values(screw: Loop) -> None:
    plant = TwoMass(mass_motor=100.0, mass_load=40.0, stiffness=1e8)
    axis = replace(screw.axis, plant=plant, friction_motor=None, friction_load=None)
    errors = {"plant.mass_load": 1.0, "plant.stiffness": 2.5e6}
    pair = frozenset(errors)
    box = Box(0.0, 0.0, 0, deviations=2.0).with_errors(axis, errors, "x.toml", {pair: 0.8})
    names = {str(box.named(axis, corner)) for corner in box.corners(axis)}
    # 2 s (√1.8 ± √0.2)/√2
    assert names == {"mass_load +6.3 %, stiffness +3.2 %", "mass_load +3.2 %, stiffness +6.3 %",
                     "mass_load -6.3 %, stiffness -3.2 %", "mass_load -3.2 %, stiffness -6.3 %"}  # fmt: skip
    three = {"plant.mass_motor": 1.0, **errors}
    ties = {pair: 0.9, frozenset(("plant.mass_motor", "plant.mass_load")): 0.9,
            frozenset(("plant.mass_motor", "plant.stiffness")): -0.9}  # fmt: skip
    with pytest.raises(ParameterError, match="no errors have the correlations of mass_motor, mass_load, stiffness"):
        Box(deviations=2.0).with_errors(axis, three, "x.toml", ties)


def test_the_middle_of_every_edge_is_examined(screw: Loop) -> None:
    """Five parameters have 5 · 2⁴ edges, at both dead times."""
    edges = list(Box().edges(screw.axis))
    assert len(set(edges)) == len(edges) == 160
    assert all(sorted(map(abs, edge.place)) == [0.0, 1.0, 1.0, 1.0, 1.0] for edge in edges)


def test_draws_fill_the_box(screw: Loop) -> None:
    corners = list(Box().drawn(screw.axis, 400, 3))
    places = np.array([corner.place for corner in corners])
    assert np.all(np.abs(places) <= 1.0)
    # 400 even draws leave no tenth of a range empty (probability of that: 5 · 10 · 0.9^400 < 1e-16)
    assert all(right - left < 0.2 for column in places.T for left, right in pairwise(np.sort(column)))
    assert {corner.late for corner in corners} == {0, 1}


def test_a_plant_is_named_by_what_differs(screw: Loop) -> None:
    named = Box().named(screw.axis, Corner((1.0, 0.0, -0.5, 0.0, 0.0), 1))
    assert str(named) == "mass_motor +30 %, mass_load -15 %, 1 sample later"
    assert str(Box().named(screw.axis, Corner((0.0,) * 5, 0))) == "the model"
    assert "mass_motor -99.9 %" in str(Box(mass=0.999).named(screw.axis, Corner((-1.0, 0.0, 0.0, 0.0, 0.0), 0)))


def test_identified_values_spread_by_their_standard_errors(screw: Loop) -> None:
    """Two standard errors in place of the tolerance, also for the root of a stiffness that a frequency is."""
    errors = {"plant.mass_load": 0.33, "plant.stiffness": 0.9e6, "friction_motor.coulomb": 2.0}
    box = Box(0.2, 0.3, 1, 2.0).with_errors(screw.axis, errors, "axis.toml")
    spreads = {d.path: d.spread for d in box.dimensions(screw.axis)}
    assert spreads == pytest.approx(
        {"mass_motor": 0.3, "mass_screw": 0.3, "mass_load": 0.02, "coupling_stiffness": 0.2, "stiffness": 0.1}
    )
    assert "identified values ±2 standard errors" in str(box.sentence)
    only = Box(0.0, 0.0, 0, 3.0).with_errors(screw.axis, errors, "axis.toml")
    assert {d.path: d.spread for d in only.dimensions(screw.axis)} == pytest.approx(
        {"mass_load": 0.03, "stiffness": 0.15}
    )
    plant = Modal(mass=100.0, modes=(Mode(frequency=200.0, mass=50.0),))
    axis = replace(screw.axis, plant=plant, friction_motor=None, friction_load=None)
    (mode,) = Box(0.0, 0.0, 0, 2.0).with_errors(axis, {"plant.modes.0.frequency": 1.0}, "a.toml").dimensions(axis)
    # to first order: ±2 Hz of 200 Hz
    assert (mode.at(-1.0), mode.at(1.0)) == pytest.approx((198.0, 202.0), abs=0.02)


def test_a_box_without_errors_is_not_changed_by_those_of_the_file(screw: Loop) -> None:
    assert Box().with_errors(screw.axis, {"plant.mass_load": 0.33}, "axis.toml") == Box()


@pytest.mark.parametrize(
    ("errors", "message"),
    [
        ({}, r"axis.toml states no standard error of a mass or stiffness, \[axis.NAME.standard_errors\]: identify"),
        ({"friction_motor.coulomb": 2.0}, "states no standard error of a mass or stiffness"),
        ({"plant.mass_load": 17.0}, "2 standard errors of mass_load are 103 % of its value: measure longer"),
    ],
)
def test_errors_that_are_no_box_are_refused(errors: dict[str, float], message: str, screw: Loop) -> None:
    with pytest.raises(ParameterError, match=message):
        Box(deviations=2.0).with_errors(screw.axis, errors, "axis.toml")
