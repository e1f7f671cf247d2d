"""Poles moved by hand: those that a law places against its polynomial, those of a loop against the whole loop."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.blocks.controller.linear_adrc import LinearADRC
from feeddrive.blocks.controller.lqg import LQG
from feeddrive.blocks.controller.pole_placement import PolePlacement
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.control import Control
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop
from feeddrive.tuning.by_hand import ByHand
from feeddrive.tuning.candidates import control_with
from feeddrive.tuning.operating_point import modelled_point
from feeddrive.tuning.poles import Model, loop_poles, nearest_pole, placed_dragged, placed_poles, pole_moved

GAINS = ("law.Kv", "law.Kp", "law.Tn")
Made = tuple[StateSpace, Model, np.ndarray]


@pytest.fixture(scope="module")
def loop() -> Loop:
    return fd.read_machine("ball_screw").loop(None)


@pytest.fixture(scope="module")
def made(loop: Loop) -> Made:
    by_hand = ByHand(loop.control, [modelled_point(loop)])

    def model(gains: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found = by_hand.model(by_hand.values | dict(zip(GAINS, gains, strict=True)), GAINS)
        assert found is not None
        return found

    axis = linearize(loop, ["cut"], ["reading_motor", "reading_load"])
    return axis, model, np.array([by_hand.values[name] for name in GAINS])


@pytest.mark.parametrize("given", [{}, {"rigid_frequency": 60.0}, {"rigid_frequency": 60.0, "axial_frequency": 150.0}])
def test_placed_poles_are_the_roots_of_the_law(loop: Loop, given: dict[str, float]) -> None:
    """Absent frequencies follow the rule of the law."""
    law = control_with(loop, "pole_placement").law
    assert isinstance(law, PolePlacement)
    law = replace(law, **given)
    roots = np.roots([float(each) for each in reversed(law.polynomial())])
    found = [each.s for each in placed_poles(Control(law=law))]
    wanted = roots[roots.imag > -1e-6]
    assert sorted_by_damping(found) == pytest.approx(sorted_by_damping(wanted), rel=1e-6)


def test_a_placed_pole_goes_where_it_is_dragged(loop: Loop) -> None:
    law = replace(control_with(loop, "pole_placement").law, rigid_frequency=60.0)  # type: ignore[call-arg]
    control = Control(law=law)
    s = 2.0 * np.pi * complex(-30.0, 40.0)  # 50 Hz with a damping ratio of 0.6
    assert placed_dragged(control, "law.rigid_frequency", s) == {"law.rigid_frequency": 50.0, "law.rigid_damping": 0.6}
    assert placed_dragged(control, "law.axial_frequency", s) == {
        "law.axial_damping": 0.6
    }  # its frequency is the rule's
    assert placed_dragged(control, "law.bandwidth", 2.0 * np.pi * (-44.0 + 9.0j)) == {"law.bandwidth": 44.0}
    right = placed_dragged(control, "law.rigid_frequency", complex(5.0, 100.0))
    assert right["law.rigid_damping"] == 0.01  # it stays on the left
    with pytest.raises(ParameterError, match=r"places no pole 'law\.Kv'"):
        placed_dragged(control, "law.Kv", s)


def test_a_pole_without_a_damping_ratio_stays_on_its_ray() -> None:
    control = Control(law=LQG(model=Rigid(mass=40.0, viscous=10.0), omega_c=100.0, omega_o=500.0))
    (pole, _) = placed_poles(control)
    assert pole.s == pytest.approx(100.0 * np.exp(0.75j * np.pi))
    assert placed_dragged(control, pole.name, 1.5 * pole.s) == {"law.omega_c": pytest.approx(150.0)}
    assert placed_dragged(control, pole.name, pole.s * (1.0 + 0.3j)) == {"law.omega_c": pytest.approx(100.0)}
    law = LinearADRC(mass=40.0, omega_c=100.0, omega_o=500.0)
    assert [each.s for each in placed_poles(Control(law=law))] == [-100.0, -500.0]


def test_a_law_whose_gains_are_no_poles_places_none(loop: Loop) -> None:
    assert placed_poles(loop.control) == ()


def test_the_poles_are_those_of_the_whole_loop(loop: Loop, made: Made) -> None:
    """The control traced alone and joined to the axis, and the loop linearized as a whole."""
    T = loop.sample_time
    whole = np.log(linearize(loop, ["set_position"], ["position_load"]).poles().astype(complex)) / T
    found = loop_poles(*made)
    assert len(found) >= 3
    for pole in found:
        assert np.min(np.abs(whole - pole.s)) < 1e-8 * abs(pole.s)


def test_slopes_are_those_of_differences(made: Made) -> None:
    axis, model, gains = made
    step = 1e-5
    for pole in loop_poles(axis, model, gains):
        for k in range(gains.size):
            ends = []
            for sign in (1.0, -1.0):
                other = gains.copy()
                other[k] *= np.exp(sign * step)
                near = nearest_pole(loop_poles(axis, model, other), pole.s)
                assert near is not None
                ends.append(near.s)
            assert pole.slope[k] == pytest.approx((ends[0] - ends[1]) / (2.0 * step), abs=1e-5 * abs(pole.s))


@pytest.mark.parametrize(
    ("which", "share"),
    [(0, lambda s: 1.25 * s), (1, lambda s: complex(1.3 * s.real, 1.05 * s.imag)), (2, lambda s: 1.03 * s)],
)
def test_a_pole_of_the_loop_goes_where_it_is_dragged(
    made: Made, which: int, share: Callable[[complex], complex]
) -> None:
    axis, model, gains = made
    pole = loop_poles(axis, model, gains)[which]
    wanted = share(pole.s)
    changed, reached = pole_moved(axis, model, gains, pole.s, wanted)
    assert abs(reached - wanted) <= 1e-3 * abs(wanted)
    near = nearest_pole(loop_poles(axis, model, changed), wanted)
    assert near is not None
    assert near.s == reached
    assert np.max(np.abs(np.log(changed / gains))) < 1.0


def test_a_pole_that_cannot_get_there_comes_nearer_and_stays_where_it_is_nearest(made: Made) -> None:
    """No gain takes the pair to twenty times its frequency: what is found is nearer, and finite."""
    axis, model, gains = made
    pole = loop_poles(axis, model, gains)[1]
    changed, reached = pole_moved(axis, model, gains, pole.s, 20.0 * pole.s)
    assert abs(20.0 * pole.s - reached) < abs(19.0 * pole.s)
    assert np.all(np.isfinite(changed))
    assert np.max(np.abs(np.log(changed / gains))) <= 6.0 * 0.25 + 1e-9


def test_a_control_with_two_rates_has_no_such_poles(loop: Loop) -> None:
    slow = ByHand(tree_with_slow(loop.control), [modelled_point(loop)])
    assert slow.model({}, GAINS) is None


def sorted_by_damping(poles: Iterable[complex]) -> np.ndarray:
    return np.array(sorted(poles, key=lambda s: s.real / abs(s)))


def tree_with_slow(control: Control) -> Control:
    assert tree.get(control, "law.Kv") > 0.0
    return replace(control, law=replace(control.law, position_every=4))  # type: ignore[call-arg]
