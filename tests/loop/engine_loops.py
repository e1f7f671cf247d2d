"""Loops on which the ways to run one law are compared: a common one, and one with a member of every family."""

from __future__ import annotations

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.force.backlash import Backlash
from feeddrive.blocks.force.cogging import Cogging
from feeddrive.blocks.force.force_map import ForceMap
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.friction.lugre import Lugre
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.plant.lead_error import LeadError
from feeddrive.blocks.plant.two_mass import TwoMass
from feeddrive.blocks.sensor.eccentricity import Eccentricity
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.blocks.sensor.interpolation import Interpolation
from feeddrive.blocks.signals import Setpoint
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.guard import Guard
from feeddrive.loop.loop import Loop

T = 50e-6


class Sway(Reference):
    """10 mm to and fro at 2 Hz, resting at first: the axis sticks and slips."""

    @property
    def duration(self) -> float:
        return 1.1

    def at(self, t: np.ndarray) -> Setpoint:
        w, moving = 4.0 * np.pi, t >= 0.1
        angle = np.where(moving, w * (t - 0.1), 0.0)
        rows = [1.0 - np.cos(angle), w * np.sin(angle), w**2 * np.cos(angle), -(w**3) * np.sin(angle)]
        rows.append(-(w**4) * np.cos(angle))
        return Setpoint(*(0.005 * np.where(moving, row, 0.0) for row in rows))


class Saw(Load):
    """A force that climbs to 100 N and falls back, 20 times a second."""

    def at(self, t: np.ndarray) -> np.ndarray:
        return 100.0 * np.mod(20.0 * t, 1.0)


def common(substeps: int = 1) -> Loop:
    """Two masses, Stribeck friction, counts on both sides, P-PI, notch, feedforward, limit, dead time."""
    return Loop(
        sample_time=T,
        control=Control(
            law=CascadePPI(Kv=60.0, Kp=2.0e5, Tn=0.01),
            filters=(Notch(frequency=164.0),),
            feedforward=(Inertia(mass=674.0, viscous=1600.0),),
            force_limit=700.0,
        ),
        axis=Axis(
            plant=TwoMass(mass_motor=474.0, mass_load=200.0, stiffness=1.5e8, damping=4000.0, viscous_motor=600.0),
            friction_load=Stribeck(coulomb=250.0, breakaway=400.0, stribeck_velocity=0.002, viscous=700.0),
            actuator=Actuator(dead_time=T),
            encoder_motor=Encoder(resolution=1e-8),
            encoder_load=Encoder(resolution=1e-8),
            substeps=substeps,
        ),
    )


def rich() -> Loop:
    """Noise, tables, sines, exponentials, a part of a sample of dead time, two contacts, a guard."""
    row = np.sin(np.arange(40.0))
    return Loop(
        sample_time=T,
        control=Control(
            law=CascadePPI(Kv=50.0, Kp=1.0e5, Tn=0.02, velocity_samples=3),
            filters=(Notch(frequency=164.0), LowPass(frequency=2500.0)),
            feedforward=(
                Inertia(mass=674.0),
                FrictionFeedforward(
                    coulomb_positive=100.0,
                    coulomb_negative=90.0,
                    breakaway=150.0,
                    stribeck_velocity=0.01,
                    smoothing=0.001,
                ),
            ),
            force_limit=3000.0,
            guard=Guard(following_error_limit=2e-3, velocity_limit=2.0, travel_most=0.5),
        ),
        axis=Axis(
            plant=TwoMass(
                mass_motor=474.0,
                mass_load=200.0,
                stiffness=1.5e8,
                damping=4000.0,
                viscous_motor=600.0,
                coupling_mass=20.0,
            ),
            friction_motor=Lugre(
                coulomb=60.0, breakaway=80.0, stribeck_velocity=0.01, bristle_stiffness=1e7, bristle_damping=1e3
            ),
            friction_load=Stribeck(coulomb=150.0, breakaway=200.0, stribeck_velocity=0.002),
            forces=(
                Backlash(gap=1e-6, lead_error=LeadError(row=2e-6 * row, start=-0.01, spacing=1e-3)),
                Cogging(force=10.0, period=0.012),
                ForceMap(row=5.0 * row, begin=-0.005, spacing=2e-3, swing=0.5, frequency=80.0),
                Gravity(force=-20.0),
            ),
            actuator=Actuator(dead_time=1.4 * T, current_loop=1000.0),
            encoder_motor=Encoder(
                resolution=1e-8,
                noise=3e-9,
                jitter=1e-3,
                largest_rate=1e8,
                eccentricity=Eccentricity(amplitude=1e-6, period=0.01),
            ),
            encoder_load=Encoder(noise=2e-9, interpolation=Interpolation(signal_period=2e-5, first=2e-8, second=1e-8)),
            substeps=2,
        ),
    )


def enabling(count: int) -> np.ndarray:
    """Off for 50 samples, on, off for a while, on again."""
    k = np.arange(count)
    return np.where((k < 50) | ((k > 700) & (k < 760)), 0.0, 1.0)
