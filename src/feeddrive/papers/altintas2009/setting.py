"""The axis of all experiments, its laws under the comparison rules, and its cutting force."""

from __future__ import annotations

import numpy as np

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.families import Compensation, Friction, Law
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

MASS, VISCOUS, T = 40.0, 60.0, 1e-4
PLANT = "rigid axis m = 40 kg, b = 60 N s/m, T = 0.1 ms"
REST = Polynomial7(distance=0.0, travel_time=1.0)


def dadsc(rate: float, mass: float = MASS) -> DADSC:
    """All three rates equal: λ = K = ω_d = rate."""
    return DADSC(mass=mass, viscous=VISCOUS, tracking_rate=rate, reaching_rate=rate, adaptation_rate=rate)


def cascade(rate: float, mass: float = MASS) -> CascadePPI:
    """The cascade with the k_d = 3 m rate of `dadsc(rate)` and the most integral gain that real poles allow.

    s³ + a (s + Kv)(s + 1/Tn) with a = Kp/m has its double real root at Kv = 1/Tn = a/6.75 = 4 rate/9.
    """
    gain = 4.0 * rate / 9.0
    return CascadePPI(Kv=gain, Kp=3.0 * mass * rate, Tn=1.0 / gain, viscous=VISCOUS)


def loop(
    law: Law,
    *,
    mass: float = MASS,
    resolution: float | None = None,
    dead_time: float = 0.0,
    compensation: tuple[Compensation, ...] = (),
    friction: Friction | None = None,
) -> Loop:
    """A law on the axis; a cascade gets the acceleration feedforward, with a mass in kg, that the other has inside."""
    feedforward = () if "acceleration" in law.feeds else (Inertia(mass=mass),)
    return Loop(
        control=Control(law=law, feedforward=feedforward, compensation=compensation),
        axis=Axis(
            plant=Rigid(mass=MASS, viscous=VISCOUS),
            actuator=Actuator(dead_time=dead_time),
            friction_load=friction,
            encoder_load=None if resolution is None else Encoder(resolution=resolution),
        ),
        sample_time=T,
    )


def milling(duration: float, rms: float = 161.0) -> RecordedForce:
    """Interrupted milling along the feed: four straight teeth, 3000 rpm, up-milling from 0 to 90 degrees, K_r = 0.3.

    Tooth passing 200 Hz; scaled to an RMS in N.
    """
    t = np.arange(round(duration / T) + 1) * T
    force = np.zeros(t.size)
    for tooth in range(4):
        angle = (2.0 * np.pi * 50.0 * t + 0.5 * np.pi * tooth) % (2.0 * np.pi)
        chip = np.where(angle <= 0.5 * np.pi, np.sin(angle), 0.0)
        force -= chip * (np.cos(angle) + 0.3 * np.sin(angle))
    return RecordedForce(force=force * (rms / np.sqrt(np.mean(force**2))), sample_time=T)
