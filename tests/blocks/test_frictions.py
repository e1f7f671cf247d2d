"""Friction laws alone: does the force of a contact fit the velocity it leads to?"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from feeddrive.blocks.families import Friction
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.friction.directional_stribeck import DirectionalStribeck
from feeddrive.blocks.friction.lugre import Lugre
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.friction.viscous import Viscous
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.testing.strategies import blocks_of

drawn = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
velocities = st.floats(-1.0, 1.0)
mobilities = st.floats(-8.0, -3.0).map(lambda power: 10.0**power)  # (m/s)/N: h/m for 0.1 ms and 1 to 1e4 kg, and more


def plain(friction: Any) -> Any:
    return tree.rebuild(friction, (np.float64(value) for _, value in tree.leaves(friction)))


def contact(friction: Any, velocity: float, free: float, mobility: float, state: Any = None) -> tuple[Any, float, bool]:
    with np.errstate(all="ignore"):
        held = friction.start() if state is None else state
        after, force, stuck = plain(friction).contact(
            np.float64(1e-4), held, np.float64(velocity), np.float64(free), np.float64(mobility)
        )
    return after, float(force), bool(stuck)


SET_VALUED: list[type[Friction]] = [Coulomb, Stribeck, Directional, DirectionalStribeck]


@pytest.mark.parametrize("law", SET_VALUED, ids=lambda law: law.kind)
@drawn
@given(data=st.data(), velocity=velocities, free=velocities, mobility=mobilities)
def test_a_set_valued_contact_holds_or_brakes(
    law: type[Friction], data: st.DataObject, velocity: float, free: float, mobility: float
) -> None:
    friction: Any = data.draw(blocks_of(law))
    _, force, stuck = contact(friction, velocity, free, mobility)
    end = free + mobility * force
    if stuck:
        assert abs(end) <= 1e-15 * abs(free) + 1e-300
    else:
        # it slides on in the direction in which it would without friction, and friction opposes it
        assert np.sign(end) == np.sign(free)
        assert force * end <= 0.0
    # never more than what stops it
    assert abs(mobility * force) <= abs(free) * (1 + 1e-15)


@drawn
@given(data=st.data(), velocity=velocities, free=velocities, mobility=mobilities)
def test_a_sliding_stribeck_contact_lies_between_its_levels(
    data: st.DataObject, velocity: float, free: float, mobility: float
) -> None:
    friction = data.draw(blocks_of(Stribeck))
    _, force, stuck = contact(friction, velocity, free, mobility)
    if not stuck:
        assert friction.coulomb * (1 - 1e-15) <= abs(force) <= friction.breakaway * (1 + 1e-15)
    # at rest, the body is held up to the breakaway level and not a bit less
    for share in (0.999999, -0.999999):
        assert contact(friction, 0.0, share * friction.breakaway * mobility, mobility)[2] or friction.breakaway == 0.0
    for share in (1.000001, -1.000001):
        assume(friction.breakaway > 0.0)
        assert not contact(friction, 0.0, share * friction.breakaway * mobility, mobility)[2]


def test_equal_directions_are_the_undirected_law_to_the_last_bit() -> None:
    one = Stribeck(coulomb=70.0, breakaway=110.0, stribeck_velocity=4e-3, viscous=30.0)
    both = DirectionalStribeck(
        coulomb_positive=70.0,
        coulomb_negative=70.0,
        breakaway_positive=110.0,
        breakaway_negative=110.0,
        stribeck_velocity=4e-3,
        viscous=30.0,
    )
    for velocity, free in ((0.0, 1e-3), (1e-3, -2e-4), (-3e-3, -5e-3), (0.1, 0.0999)):
        assert contact(one, velocity, free, 1e-5) == contact(both, velocity, free, 1e-5)


@drawn
@given(data=st.data(), velocity=velocities, free=velocities, mobility=mobilities)
def test_regularised_force_fits_the_velocity_at_the_end(
    data: st.DataObject, velocity: float, free: float, mobility: float
) -> None:
    friction = data.draw(blocks_of(Regularised))
    _, force, stuck = contact(friction, velocity, free, mobility)
    end = free + mobility * force
    assert not stuck
    level = friction.coulomb if free >= 0.0 or friction.coulomb_negative is None else friction.coulomb_negative
    if friction.breakaway is None:
        # F = -level tanh(v/v_t) to 1e-12 of the level, and v only as well as it is the difference of two numbers
        slope = level / friction.transition_velocity
        loose = 1e-12 * level + 4e-16 * slope * (abs(free) + mobility * level)
        assert abs(force + level * np.tanh(end / friction.transition_velocity)) <= loose
    else:
        assert abs(force) <= friction.breakaway * (1 + 1e-15)
        assert force * free <= 0.0


def test_regularised_derivative_is_that_of_the_implicit_function() -> None:
    # dF/dv_free = -L'/(1 + mobility L') with L' = level/v_t (1 - tanh²): the last step of the iteration carries it
    friction = Regularised(coulomb=60.0, transition_velocity=2e-4)
    for mobility in (1e-6, 1e-5, 1e-3):
        for free in (1e-5, 3e-4, 2e-3, 0.0601):
            h = 1e-6 * free
            slope = (contact(friction, 0, free + h, mobility)[1] - contact(friction, 0, free - h, mobility)[1]) / (
                2 * h
            )
            end = free + mobility * contact(friction, 0, free, mobility)[1]
            steep = 60.0 / 2e-4 * (1 - np.tanh(end / 2e-4) ** 2)
            # 1e-6: rounding of the difference, 1e-16/1e-6 of a force whose slope may be 1e-3 of force / v_free
            assert slope == pytest.approx(-steep / (1 + mobility * steep), rel=1e-6, abs=1e-6 * 60.0 / free)


@drawn
@given(data=st.data(), velocity=velocities, free=velocities, mobility=mobilities, bend=st.floats(-1.0, 1.0))
def test_lugre_fits_its_equations_at_the_end_of_the_substep(
    data: st.DataObject, velocity: float, free: float, mobility: float, bend: float
) -> None:
    law = data.draw(blocks_of(Lugre))
    most = law.breakaway / law.bristle_stiffness
    before = Lugre.State(np.float64(bend * most))
    after, force, stuck = contact(law, velocity, free, mobility, before)
    z, z0, h = float(after.deflection), float(before.deflection), 1e-4
    end = free + mobility * force
    assert not stuck
    rate = (z - z0) / h
    assert force == pytest.approx(-law.bristle_stiffness * z - law.bristle_damping * rate, rel=1e-9, abs=1e-9)
    # the deflection stays below what the breakaway level bends, whatever the step: the model is passive
    assert abs(z) <= most * (1 + 1e-9)
    # z' = v - σ0 |v| z / level for some level between Coulomb and breakaway, by backward Euler
    stiff = law.bristle_stiffness * abs(end) * z
    bounds = sorted(end - stiff / level for level in (law.coulomb, law.breakaway))
    loose = 1e-9 * (abs(free) + mobility * abs(force) + abs(stiff) / law.coulomb + abs(z0) / h) + 1e-300
    assert bounds[0] - loose <= rate <= bounds[1] + loose


def test_lugre_slides_at_its_steady_level_and_springs_before() -> None:
    law = Lugre(
        coulomb=60.0, breakaway=90.0, stribeck_velocity=4e-3, bristle_stiffness=1e7, bristle_damping=1e3, viscous=100.0
    )
    state: Any = law.start()
    for _ in range(20000):
        # an immobile drive: the velocity is prescribed
        state, force, _ = contact(law, 2e-3, 2e-3, 1e-12, state)
    assert -force + law.linear() * 2e-3 == pytest.approx(float(plain(law).steady(np.float64(2e-3))), rel=1e-6)
    # presliding: 1 nm of travel pulls with the stiffness of the bristles
    state, force, _ = contact(law, 1e-5, 1e-5, 1e-12)
    assert float(state.deflection) == pytest.approx(1e-9, rel=1e-3)


@pytest.mark.parametrize("law", [*SET_VALUED, Regularised, Lugre, Viscous], ids=lambda law: law.kind)
@settings(max_examples=20, deadline=None)
@given(data=st.data(), speed=st.floats(0.05, 1.0))
def test_steady_sliding_feels_the_steady_force(law: type[Friction], data: st.DataObject, speed: float) -> None:
    friction: Any = data.draw(blocks_of(law))
    for velocity in (speed, -speed):
        steady = float(plain(friction).steady(np.float64(velocity)))
        assert steady * velocity >= 0.0
        if law in (Lugre, Regularised):
            continue
        # a body that moves on with `velocity` although friction brakes it
        mobility = 1e-9
        _, force, _ = contact(friction, velocity, velocity, mobility)
        assert -force + friction.linear() * velocity == pytest.approx(steady, rel=1e-4, abs=1e-6)


def test_a_curve_that_rises_with_speed_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"stribeck.breakaway = 50 N must be >= stribeck.coulomb = 60 N"):
        Stribeck(coulomb=60.0, breakaway=50.0, stribeck_velocity=0.01)
    with pytest.raises(ParameterError, match=r"lugre.breakaway = 50 N must be >= lugre.coulomb = 60 N"):
        Lugre(coulomb=60.0, breakaway=50.0, stribeck_velocity=0.01, bristle_stiffness=1e7)
    with pytest.raises(ParameterError, match=r"regularised.breakaway = 70 N must be >= regularised.coulomb_negative"):
        Regularised(
            coulomb=60.0, coulomb_negative=80.0, transition_velocity=1e-4, breakaway=70.0, stribeck_velocity=0.01
        )


def test_half_a_stribeck_curve_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"breakaway is given without regularised.stribeck_velocity"):
        Regularised(coulomb=60.0, transition_velocity=1e-4, breakaway=70.0)
