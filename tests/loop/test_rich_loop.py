"""Loops with everything in them: native code, batches and the Python source compute the same bits."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Reference
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.filter.second_order import SecondOrder
from feeddrive.blocks.force.backlash import Backlash
from feeddrive.blocks.force.cogging import Cogging
from feeddrive.blocks.force.force_map import ForceMap
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.force.harmonic import Harmonic
from feeddrive.blocks.force.ripple import Ripple
from feeddrive.blocks.friction.lugre import Lugre
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.lead_error import LeadError
from feeddrive.blocks.plant.modal import Modal
from feeddrive.blocks.plant.mode import Mode
from feeddrive.blocks.plant.three_mass_chain import ThreeMassChain
from feeddrive.blocks.sensor.eccentricity import Eccentricity
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.sensor.interpolation import Interpolation
from feeddrive.blocks.signals import Noise, Setpoint
from feeddrive.language.block import Number, parameter
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import simulate
from feeddrive.loop.trace import concrete


class Swing(Reference):
    """x = size (1 - cos 2π frequency t)."""

    size: Number = parameter("m", "amplitude", above=0)
    frequency: Number = parameter("Hz", "frequency", above=0)

    @property
    def duration(self) -> float:
        return 0.2

    def at(self, t: np.ndarray) -> Setpoint:
        w, a = 2 * np.pi * self.frequency, self.size
        s, c = np.sin(w * t), np.cos(w * t)
        return Setpoint(a * (1 - c), a * w * s, a * w**2 * c, -a * w**3 * s, -a * w**4 * c)  # type: ignore[arg-type]


THREE_MASS = Loop(
    sample_time=2e-4,
    control=Control(
        law=CascadePPI(Kv=25.0, Kp=1.2e4, Tn=0.05, position_every=4, velocity_samples=2),
        filters=(
            Notch(frequency=450.0),
            LowPass(frequency=1500.0),
            LowPass2(frequency=1800.0),
            SecondOrder(frequency_zero=900.0, frequency_pole=700.0),
        ),
        feedforward=(
            Inertia(mass=163.0, viscous=1500.0),
            FrictionFeedforward(
                coulomb_positive=70.0,
                coulomb_negative=60.0,
                breakaway=90.0,
                stribeck_velocity=0.004,
                smoothing=2e-4,
            ),
        ),
        force_limit=3000.0,
        guard=Guard(following_error_limit=0.01),
    ),
    axis=Axis(
        plant=ThreeMassChain(
            mass_motor=85.0,
            mass_screw=45.0,
            mass_load=33.0,
            coupling_stiffness=2.352e8,
            coupling_damping=2496.0,
            stiffness=1.8e7,
            damping=700.0,
            viscous_motor=750.0,
            viscous_screw=750.0,
        ),
        actuator=Actuator(dead_time=2.7e-4, current_loop=800.0),
        friction_motor=Lugre(
            coulomb=70.0, breakaway=110.0, stribeck_velocity=0.004, bristle_stiffness=1e7, bristle_damping=2e3
        ),
        friction_load=Regularised(coulomb=15.0, transition_velocity=2e-4),
        forces=(
            Backlash(gap=3e-6, lead_error=LeadError(row=[0.0, 5e-6, -2e-6], start=-0.01, spacing=0.02)),
            Cogging(force=10.0, period=0.005, harmonics=(Harmonic(order=1, share=1.0), Harmonic(order=3, share=0.2))),
            Ripple(period=0.005, harmonics=(Harmonic(order=6, share=0.01),)),
            Gravity(force=-50.0),
            ForceMap(row=[0.0, 40.0, 10.0], begin=0.0, spacing=0.01, swing=0.5, frequency=60.0),
        ),
        encoder_motor=Encoder(
            resolution=1e-8,
            jitter=1.5e-3,
            largest_rate=7e8,
            eccentricity=Eccentricity(amplitude=1e-6, period=0.02),
        ),
        encoder_load=Encoder(
            resolution=1e-8,
            noise=5e-9,
            offset=1e-6,
            interpolation=Interpolation(signal_period=4e-6, first=1e-8, second=5e-9),
        ),
        substeps=2,
    ),
)
MODAL = Loop(
    sample_time=2e-4,
    control=Control(law=CascadePPI(Kv=40.0, Kp=1.5e4, Tn=0.02), feedforward=(Inertia(mass=163.0),)),
    axis=Axis(
        plant=Modal(
            mass=163.0,
            modes=(
                Mode(frequency=131.6, damping_ratio=0.018, mass=650.0, load=-3.9),
                Mode(frequency=38.0, damping_ratio=0.03, mass=2500.0, motor=-1.0),
            ),
        ),
        friction_load=Stribeck(coulomb=70.0, breakaway=110.0, stribeck_velocity=0.004),
        encoder_load=Encoder(resolution=1e-8),
    ),
)
RECORD = ["position_load", "velocity_load", "velocity_motor", "reading_motor", "force", "drive_force", "friction_load"]


def by_hand(loop: Loop, reference: Reference, seed: int) -> np.ndarray:
    """The loop in Python, sample by sample, shape (n, signals)."""
    plain, timing = concrete(loop), loop.timing()
    T = np.float64(loop.sample_time)
    n = round(reference.duration / float(T))
    with np.errstate(all="ignore"):
        setpoints = reference.at(np.arange(n) * float(T))
        prepared = plain.prepare(timing)
        rows = [Setpoint(*(np.float64(field[k]) for field in setpoints)) for k in range(n)]
        start = rows[0]
        state = plain.start(prepared, timing, start, np.float64(start.position), np.float64(start.velocity))
        found = []
        for k, setpoint in enumerate(rows):
            noise = Noise(np.float64(seed), np.float64(k))
            state, signals = plain.step(prepared, state, setpoint, None, noise, 1.0, np.float64(k) * T)
            found.append([float(getattr(signals, name)) for name in RECORD])
    return np.array(found)


@pytest.mark.parametrize("loop", [THREE_MASS, MODAL], ids=["three_mass", "modal"])
def test_native_code_computes_the_bits_of_the_source(loop: Loop) -> None:
    reference = Swing(size=2e-3, frequency=5.0)
    run = simulate(loop, reference, record=RECORD, seed=5)
    true = by_hand(loop, reference, 5)
    assert np.max(np.abs(true[:, 0])) > 1e-3
    for i, name in enumerate(RECORD):
        assert np.array_equal(run[name][: len(true)], true[:, i]), name


def test_the_rich_loop_follows_its_reference() -> None:
    run = simulate(THREE_MASS, Swing(size=2e-3, frequency=5.0), record=["following_error", "trip"], seed=5)
    # 4 mm of travel at 63 mm/s, reversing twice: the disturbances (120 N of friction and map, 10 N of cogging) move the
    # loop of 12 kN s/m · 25 1/s = 0.3 N/µm by at most 0.4 mm before its integral answers
    assert np.all(run["trip"] == 0.0)
    assert np.max(np.abs(run["following_error"])) < 0.4e-3


def test_a_modal_axis_stands_still_in_native_code_too() -> None:
    still = simulate(MODAL, Swing(size=1e-12, frequency=1.0), record=["velocity_load", "position_load"])
    assert np.all(still["velocity_load"] == 0.0)
