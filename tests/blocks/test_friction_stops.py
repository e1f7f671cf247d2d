"""Friction with a memory of its reversals: the Maxwell slip model of the plant, and stops on the set position."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feeddrive.analysis.stability import stability
from feeddrive.blocks import (
    CascadePPI,
    FrictionFeedforward,
    FrictionStops,
    GeneralizedMaxwellSlip,
    Inertia,
    Sine,
)
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.families import Feedforward
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.identification.friction_curve import stretches
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from field_laws import R, T

STIFFNESS, SHARE = np.array([4e6, 2e6, 1e6, 5e5]), np.array([0.3, 0.3, 0.2, 0.2])


def slip(coulomb: float = 60.0, breakaway: float = 90.0, **changes: float) -> GeneralizedMaxwellSlip:
    return GeneralizedMaxwellSlip(
        coulomb=coulomb,
        breakaway=breakaway,
        stribeck_velocity=4e-3,
        stiffness=STIFFNESS,
        share=SHARE,
        **({"attraction": 3000.0, "viscous": 100.0} | changes),
    )


def stops(level: float = 60.0, wider: float = 1.0) -> FrictionStops:
    """The same elements at one level."""
    return FrictionStops(width=wider * SHARE * level / STIFFNESS, stiffness=STIFFNESS / wider)


def test_the_golden_forces_of_the_maxwell_slip_model() -> None:
    """After each 50 samples at a velocity that is held; to the ten digits that are published."""
    friction, found = slip(), []
    state: Any = friction.start()
    for v in np.array([1.0, 1.0, 2.0, 20.0, 20.0, -1.0, -1.0, -20.0]) * 1e-3:
        for _ in range(50):
            state, force, _ = friction.contact(T, state, v, v, 0.0)
        found.append(-float(force) + friction.linear() * v)
    expected = [37.6, 61.55471757, 78.09869068, 77.49711589, 74.06916599, 34.46916599, -3.030834013, -62.0]
    assert found == pytest.approx(expected, rel=6e-10)


def test_a_start_in_motion_is_that_of_a_long_way_at_this_speed() -> None:
    """So is the linear model of an axis that slides: it has no springs to ground, and is stable."""
    friction = slip()
    state: Any = friction.start(0.02)
    after, force, _ = friction.contact(T, state, np.float64(0.02), np.float64(0.02), 0.0)
    assert -float(force) + friction.linear() * 0.02 == pytest.approx(float(friction.steady(0.02)), rel=1e-12)
    assert after.force == pytest.approx(state.force, rel=1e-12)
    axis = Axis(plant=R, actuator=Actuator(dead_time=T), encoder_load=Encoder(), friction_load=friction)
    law = CascadePPI(Kv=400.0 / 3.0, Kp=36000.0, Tn=7.5e-3)
    assert stability(Loop(control=Control(law=law), axis=axis, sample_time=T)).stable


def test_it_is_a_sum_of_stops_where_the_level_does_not_fall() -> None:
    """Whatever the attraction; and Masing: after a reversal the virgin curve at twice its scale, loops closed."""
    ways = np.concatenate([np.full(100, 6e-7), np.full(130, -6e-7), np.full(130, 6e-7)])
    position = np.concatenate([[0.0], np.cumsum(ways)])
    banked = sum(k * stretches(position, a * 60.0 / k)[1:] for k, a in zip(STIFFNESS, SHARE, strict=True))
    for attraction in (1.0, 1e9):
        friction, found = slip(breakaway=60.0, attraction=attraction, viscous=0.0), []
        state: Any = friction.start()
        for step in ways:
            state, force, _ = friction.contact(T, state, np.float64(step / T), np.float64(step / T), 0.0)
            found.append(-float(force))
        assert np.max(np.abs(np.array(found) - banked)) < 1e-9  # 1e-16 m of rounding at 7.5 N/um
        assert found[99] == pytest.approx(60.0, abs=1e-10)
        virgin, down = np.array(found[:50]), np.array(found[100:200])
        turned = 60.0 - down[1::2]
        assert np.max(np.abs(turned - 2.0 * virgin)) < 1e-10
        assert found[-1] == pytest.approx(60.0, abs=1e-10)


@settings(max_examples=60, deadline=None)
@given(
    before=st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4),
    going=st.lists(st.sampled_from([-1.0, 0.0, 1.0]), min_size=4, max_size=4),
    velocity=st.floats(-0.1, 0.1),
    free=st.floats(-0.1, 0.1),
    mobility=st.floats(1e-8, 1e-3),
)
def test_the_force_fits_the_velocity_at_the_end_of_the_substep(
    before: list[float], going: list[float], velocity: float, free: float, mobility: float
) -> None:
    """v = free + mobility F is the velocity that the elements have seen: those that stick have followed it."""
    friction = slip()
    forces = tuple(np.float64(each * share * 60.0) for each, share in zip(before, SHARE, strict=True))
    state = friction.State(forces, tuple(map(np.float64, going)))
    after, force, stuck = friction.contact(T, state, np.float64(velocity), np.float64(free), np.float64(mobility))
    assert not stuck
    end, level = free + mobility * force, friction.level(velocity)
    for i, k in enumerate(STIFFNESS):
        most = SHARE[i] * level
        assert abs(after.force[i]) <= most * (1 + 1e-12)
        if going[i] * velocity <= 0.0:
            expected = np.clip(forces[i] + k * T * end, -most, most)
            # rounding of v, which the stiffness takes up
            assert after.force[i] == pytest.approx(expected, abs=1e-9 + 1e-12 * k * T)


def test_nothing_is_fed_forward_until_the_friction_has_forgotten_how_it_began() -> None:
    """0 in the first 2 δ_max, all of it from 4 δ_max on, whichever way; the widest is 24 um."""
    block = stops()
    state, force = block.start(Setpoint(0.1)), np.empty(400)
    for k in range(400):
        way = 3e-7 * k
        state, force[k] = block.step(state, Setpoint(0.1 - way), T)
    widest = float(np.max(block.width))
    way = 3e-7 * np.arange(400)
    assert np.all(force[way < 2.0 * widest - 1e-9] == 0.0)
    assert force[way > 4.0 * widest + 1e-9] == pytest.approx(-60.0, abs=1e-9)
    assert np.all(np.diff(force) <= 0.0)


def test_bells_end_with_what_was_learned() -> None:
    """At twice the range of their data they are 0, where a polynomial is at thousands of newtons."""
    block = FrictionStops(
        width=SHARE * 60.0 / STIFFNESS,
        stiffness=STIFFNESS,
        residual_velocity=np.array([-0.1, 0.0, 0.1]),
        residual_force=np.array([5.0, 9.0, -5.0]),
        residual_width=0.03,
        residual_limit=7.0,
    )
    assert block.residual(np.float64(0.0)) == 7.0  # held to the largest residual that was seen
    assert block.residual(np.float64(0.1)) == pytest.approx(-5.0 + 9.0 * np.exp(-0.5 / 0.09), abs=1e-8)
    assert block.residual(np.float64(0.1 + 2.9 * 0.03)) < 0.0  # up to three widths of a bell
    assert block.residual(np.float64(0.1 + 3.1 * 0.03)) == 0.0
    assert block.residual(np.float64(0.2)) == 0.0
    assert block.residual(np.float64(-0.2)) == 0.0


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ParameterError, match="width has 4 entries and stiffness 3"):
        FrictionStops(width=SHARE, stiffness=STIFFNESS[:3])
    with pytest.raises(ParameterError, match="missing: residual_force, residual_width, residual_limit"):
        FrictionStops(width=SHARE, stiffness=STIFFNESS, residual_velocity=SHARE)
    with pytest.raises(ParameterError, match="stiffness has 4 entries and share 3"):
        GeneralizedMaxwellSlip(coulomb=1.0, breakaway=1.0, stribeck_velocity=1e-3, stiffness=STIFFNESS, share=SHARE[:3])


def largest_error(*feedforward: Feedforward) -> float:
    """um: of an axis of a circle of 20 mm at 0.1 m/s, P-PI with Kv 133, friction with presliding and 60 N."""
    friction = slip(breakaway=60.0, attraction=1e9, viscous=0.0)
    axis = Axis(plant=R, actuator=Actuator(dead_time=T), encoder_load=Encoder(), friction_load=friction, substeps=2)
    law = CascadePPI(Kv=400.0 / 3.0, Kp=36000.0, Tn=7.5e-3)
    control = Control(law=law, feedforward=(Inertia(mass=40.0, viscous=60.0), *feedforward))
    swing = Sine(amplitude=0.02, frequency=0.1 / (2.0 * np.pi * 0.02), cycles=2, blend_time=0.2)
    run = simulate(Loop(control=control, axis=axis, sample_time=T), swing, record=["tracking_error"])
    return 1e6 * float(np.max(np.abs(run["tracking_error"][(run.time > 0.8) & (run.time < 2.0)])))


def test_the_quadrant_errors_of_a_circle() -> None:
    """None, the sign, a smooth sign, one stop, the true stops, the true stops wider by 30 %."""
    one = FrictionStops(width=np.full(2, 60.0 / 7.5e6), stiffness=np.full(2, 3.75e6))
    sign = FrictionFeedforward(coulomb_positive=60.0, coulomb_negative=60.0)
    smooth = FrictionFeedforward(coulomb_positive=60.0, coulomb_negative=60.0, smoothing=1e-3)
    found = [largest_error(), *(largest_error(each) for each in (sign, smooth, one, stops(), stops(wider=1.3)))]
    assert found == pytest.approx([8.9, 5.9, 5.4, 1.1, 0.144, 0.96], rel=0.05)
