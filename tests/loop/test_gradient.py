"""Exact gradients against central differences of the simulated cost."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Reference
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.gradient import gradient
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate

T = 1e-4
GAINS = [
    "axis.x.control.law.Kv",
    "axis.x.control.law.Kp",
    "axis.x.control.law.Tn",
    "axis.x.control.filters.0.frequency",
    "axis.x.control.feedforward.0.mass",
    "axis.x.control.feedforward.0.viscous",
]
PHYSICS = [
    "axis.x.plant.stiffness",
    "axis.x.plant.mass_load",
    "axis.x.actuator.dead_time",
    "axis.x.actuator.current_loop",
]


class Swing(Reference):
    """50 mm back and forth, with exact derivatives."""

    @property
    def duration(self) -> float:
        return 0.5

    def at(self, t: np.ndarray) -> Setpoint:
        w, a = 2 * np.pi * 2.0, 0.025
        c, s = a * np.cos(w * t), a * np.sin(w * t)
        return Setpoint(a - c, w * s, w * w * c, -(w**3) * s, -(w**4) * c)


def loop(**sensors: object) -> Loop:
    return Loop(
        sample_time=T,
        control=Control(
            law=CascadePPI(Kv=60, Kp=4e4, Tn=0.01),
            filters=(Notch(frequency=460),),
            feedforward=(Inertia(mass=150, viscous=1400),),
        ),
        axis=Axis(
            plant=TwoMass(
                mass_motor=130, mass_load=33, stiffness=1.8e7, damping=700, viscous_motor=1500, viscous_load=20
            ),
            actuator=Actuator(dead_time=1.4 * T, current_loop=1500),
            **sensors,  # type: ignore[arg-type]
        ),
    )


def cost(variant: Loop) -> float:
    return float(np.mean(simulate(variant, Swing(), record=["tracking_error"])["tracking_error"] ** 2))


@pytest.mark.parametrize("parameters", [GAINS, PHYSICS, [*GAINS, *PHYSICS]], ids=["gains", "physics", "two passes"])
def test_gradient_equals_central_differences(parameters: list[str]) -> None:
    found = gradient(loop(), Swing(), parameters)
    assert found.cost == pytest.approx(cost(loop()), rel=1e-12)
    for name in parameters:
        value = tree.get(loop(), name)
        step = 1e-4 * value
        slope = (cost(tree.vary(loop(), {name: value + step})) - cost(tree.vary(loop(), {name: value - step}))) / (
            2 * step
        )
        # differences of step h err by h² of the curvature, 1e-8, and by rounding of the cost over h, 1e-15/1e-4 of it
        # over the relative slope: the bar of the project is 1e-5
        scale = abs(slope) + 1e-6 * found.cost / value
        assert abs(found.gradient[name] - slope) < 1e-5 * scale, name


def test_the_run_beside_its_tangents_is_the_run_itself() -> None:
    """The quantiser is a straight line for the tangents only: the cost is that of the quantised run."""
    coarse = loop(encoder_load=Encoder(resolution=1e-6), encoder_motor=Encoder(resolution=1e-6))
    # the sum is taken in another order than numpy's mean: 5000 roundings
    assert gradient(coarse, Swing(), GAINS).cost == pytest.approx(cost(coarse), rel=1e-12)


@pytest.mark.parametrize(("samples", "substeps"), [(0.0, 1), (1.0, 1), (1.0, 4), (1.5, 4)])
def test_the_slope_to_a_dead_time_of_whole_substeps_is_that_to_its_right(samples: float, substeps: int) -> None:
    base = loop()
    base = dataclasses.replace(base, axis=dataclasses.replace(base.axis, substeps=substeps))
    name = "axis.x.actuator.dead_time"
    here = tree.vary(base, {name: samples * T})
    h = 1e-4 * T
    slope = (
        4 * cost(tree.vary(base, {name: samples * T + h})) - cost(tree.vary(base, {name: samples * T + 2 * h}))
    ) / (2 * h) - 3 * cost(here) / (2 * h)
    # one-sided differences of second order: h² of the third derivative, and rounding of the cost over h
    assert gradient(here, Swing(), [name]).gradient[name] == pytest.approx(slope, rel=1e-3)


def test_the_sample_time_has_no_gradient() -> None:
    with pytest.raises(ParameterError, match="sample_time is a constant"):
        gradient(loop(), Swing(), ["sample_time"])


def test_an_objective_of_ones_own() -> None:
    found = gradient(loop(), Swing(), ["axis.x.control.law.Kv"], objective=force_squared)
    run = simulate(loop(), Swing(), record=["force"])
    assert found.cost == pytest.approx(float(np.mean(run["force"] ** 2)), rel=1e-12)


def force_squared(signals: object) -> object:
    return signals.force * signals.force  # type: ignore[attr-defined]


def test_a_parameter_that_is_not_there_is_refused_with_a_hint() -> None:
    with pytest.raises(ParameterError, match=r"no parameter 'axis.x.control.law.KV'; did you mean axis.x.control.law"):
        gradient(loop(), Swing(), ["axis.x.control.law.KV"])
