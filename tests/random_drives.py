"""Random drives and what a measurement would show of them: two masses, dead time, friction, periods with noise."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

import feeddrive as fd
from feeddrive.analysis.loop_model import loop_model
from feeddrive.language.errors import NotIdentifiableError, UnstableError
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.operating_point import measured_point
from feeddrive.tuning.tune import Tuned, tune_control

PERIODS = 10


class Drive(NamedTuple):
    """A loop with gains that are surely slow, and the limits that are asked for."""

    loop: fd.Loop
    limits: Limits


class Outcome(NamedTuple):
    """What became of a drive: refused with a reason, or tuned, and how the true loop is then."""

    refusal: str
    shaped: Tuned | None
    stable: bool
    holds: bool
    coherent: bool  # coherence above 0.9 up to three times the crossover


def drive(random: np.random.Generator) -> Drive:
    """Masses over two decades, mode 40 to 300 Hz, dead time 0.5 to 3 samples, Stribeck friction on the motor."""
    T = float(random.choice([1e-4, 1.25e-4, 2.5e-4]))
    motor = float(np.exp(random.uniform(np.log(5.0), np.log(300.0))))
    load = motor * float(np.exp(random.uniform(np.log(0.1), np.log(1.5))))
    reduced = motor * load / (motor + load)
    mode = 2.0 * np.pi * float(np.exp(random.uniform(np.log(40.0), np.log(300.0))))
    stiffness = reduced * mode * mode
    damping = 2.0 * float(random.uniform(0.01, 0.05)) * reduced * mode
    force = 10.0 * (motor + load)
    axis = fd.Axis(
        plant=fd.blocks.TwoMass(
            mass_motor=motor,
            mass_load=load,
            stiffness=stiffness,
            damping=damping,
            viscous_motor=float(random.uniform(0.5, 10.0)) * motor,
            viscous_load=float(random.uniform(0.0, 2.0)) * load,
        ),
        friction_motor=fd.blocks.Stribeck(coulomb=0.02 * force, breakaway=0.03 * force, stribeck_velocity=0.004),
        actuator=fd.blocks.Actuator(
            dead_time=float(random.uniform(0.5, 3.0)) * T, current_loop=float(random.uniform(600.0, 1500.0))
        ),
        encoder_motor=fd.blocks.Encoder(resolution=1e-8),
        encoder_load=fd.blocks.Encoder(resolution=1e-8),
    )
    rate = 2.0 * np.pi * 5.0
    law = fd.blocks.CascadePPI(Kv=0.3 * rate, Kp=(motor + load) * rate, Tn=5.0 / rate)
    loop = fd.Loop(
        control=fd.Control(law=law, filters=(fd.blocks.LowPass2(frequency=1000.0),)), axis=axis, sample_time=T
    )
    if random.random() < 0.5:
        return Drive(loop, Limits(sensitivity_peak=2.0))
    return Drive(loop, Limits(sensitivity_peak=2.0, phase_margin_deg=35.0, gain_margin_dB=8.0))


def measured(loop: fd.Loop, random: np.random.Generator) -> tuple[fd.FRF, fd.FRF]:
    """Load and motor over command from ten periods: mean, variance of the mean and coherence, from these periods."""
    T = float(loop.sample_time)
    lines = np.arange(1.0, min(1500.0, 0.4 / T))
    model = fd.linearize(loop, ["cut"], ["reading_load", "reading_motor"])
    # relative noise of one period: a floor, and the encoder's, which grows as the motion falls
    floor, knee = random.uniform(0.01, 0.08), random.uniform(400.0, 3000.0)
    found = []
    for name in ("reading_load", "reading_motor"):
        true = model.response(lines, output=name).response
        scale = np.abs(true) * floor + 0.1 * np.abs(true[0]) * (lines[0] / knee) ** 2
        noise = random.standard_normal((2, PERIODS, lines.size))
        periods = true + scale * (noise[0] + 1j * noise[1]) / np.sqrt(2.0)
        mean = periods.mean(axis=0)
        single = np.sum(np.abs(periods - mean) ** 2, axis=0) / (PERIODS - 1)
        coherence = np.abs(mean) ** 2 / (np.abs(mean) ** 2 + single)
        found.append(fd.FRF(lines, mean, "cut", name, "m/N", T, coherence, single / PERIODS))
    return found[0], found[1]


def outcome(seed: int, confidence: float = 0.95) -> Outcome:
    """One drive, measured, tuned and judged on what it truly is."""
    random = np.random.default_rng(seed)
    loop, limits = drive(random)
    load, motor = measured(loop, random)
    point = measured_point(load, motor, sample_time=float(loop.sample_time))
    assert load.coherence is not None
    try:
        shaped = tune_control(loop.control, point, limits=limits, filters="kept", starts=1, confidence=confidence)
    except (NotIdentifiableError, UnstableError) as error:
        # up to where it was good: three times the crossover that a perfect measurement gives
        true = tune_control(loop.control, loop, limits=limits, filters="kept", starts=1)
        crossover = true.after[0].margins.gain_crossovers[-1].frequency
        return Outcome(str(error), None, False, False, _coherent(load, crossover))
    tuned = replace(loop, control=shaped.control)
    both = loop_model(tuned)
    stable = bool(np.abs(both.closed.poles()[0]) < 1.0)
    m = fd.margins(both.loop_gain(both.lines(400)))
    bounds = {limit.figure.key: limit.bound for limit in limits.limits}
    holds = stable and m.sensitivity_peak <= bounds["sensitivity_peak"]
    holds &= m.phase_margin_deg is None or abs(m.phase_margin_deg) >= bounds.get("phase_margin_deg", 0.0)
    holds &= m.gain_increase_dB is None or m.gain_increase_dB >= bounds.get("gain_margin_dB", 0.0)
    return Outcome("", shaped, stable, holds, _coherent(load, m.gain_crossovers[-1].frequency))


def _coherent(frf: fd.FRF, crossover: float) -> bool:
    assert frf.coherence is not None
    return bool(np.all(frf.coherence[frf.frequency <= 3.0 * crossover] > 0.9))
