"""The axes and the stimuli on which the laws of other authors are held against what is claimed of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

import feeddrive as fd
from feeddrive.analysis.stability import stability
from feeddrive.blocks.signals import Reading, Setpoint
from field_laws import R, T, W, golden_forces
from field_laws import judged as figures

__all__ = ["R", "T", "W", "golden", "held", "judged", "loop", "overshoot", "run_on_r", "start_under_weight"]


def loop(law: Any, plant: Any = R, *, late: int = 1, resolution: float = 0.0, force_limit: float = 2000.0) -> fd.Loop:
    """A law on R with one encoder or on W with two, with `late` samples of dead time."""
    encoder = fd.blocks.Encoder(resolution=resolution) if resolution else fd.blocks.Encoder()
    both: dict[str, Any] = {} if isinstance(plant, fd.blocks.Rigid) else {"encoder_motor": encoder}
    axis = fd.Axis(plant=plant, actuator=fd.blocks.Actuator(dead_time=late * T), encoder_load=encoder, **both)
    return fd.Loop(control=fd.Control(law=law, force_limit=force_limit), axis=axis, sample_time=T)


def golden(law: Any, amplitude: float = 1e-6) -> list[float]:
    """The forces of stimulus G in N: set point 0, both readings amplitude · sin(0.3 k), states 0 at the start."""
    return golden_forces(law, amplitude=amplitude)


def judged(law: Any, plant: Any = R, **more: Any) -> dict[str, float]:
    """Ms, delay margin in samples, ISE^½ in m s^½/N and noise in N/m; infinite for a loop that is not stable."""
    made = loop(law, plant, **more)
    growth = stability(made).growth
    if growth >= 1.0:
        return {"growth": growth, "Ms": math.inf, "dm": 0.0, "ISE": math.inf, "N": math.inf}
    found = figures(made)
    return {"growth": growth, "Ms": found.peak, "dm": found.delay, "ISE": found.ise, "N": found.noise}


def held(force: float, x: float, v: float) -> tuple[float, float]:
    """R one sample later under a force that is held: the closed form of 40 v' + 60 v = force."""
    rate = 60.0 / 40.0
    decay = -math.expm1(-rate * T)
    steady = force / 60.0
    return x + steady * T + (v - steady) * decay / rate, v + (steady - v) * decay


def run_on_r(
    law: Any,
    setpoint: Callable[[int], Setpoint],
    samples: int,
    *,
    limit: float = math.inf,
    told: bool = True,
    acting: float = 0.0,
    cold: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (m) and commands (N) of a law on R with one sample of dead time, by hand and without the loop's code.

    acting   N: a constant force of the axis, balanced by the drive when the law starts
    told     whether `applied` is the force after the limit, or the law's own wish
    cold     whether the law starts as if nothing acted
    """
    prepared = law.prepare(T)
    x = v = 0.0
    held_force = -acting
    state = law.start(prepared, setpoint(0), Reading(x, x, 0.0 if cold else held_force, 0.0 if cold else held_force))
    pending = applied = requested = held_force
    positions, commands = [], []
    for k in range(samples):
        given = (applied, requested) if told else (requested, requested)
        state, wish = law.step(prepared, state, setpoint(k), Reading(x, x, *given), T)
        requested, applied = float(wish), min(max(float(wish), -limit), limit)
        positions.append(x)
        commands.append(applied)
        x, v = held(pending + acting, x, v)
        pending = applied
    return np.array(positions), np.array(commands)


def overshoot(law: Any, *, told: bool) -> float:
    """mm by which a raw step of 5 mm is passed within 0.4 s where the drive gives 400 N."""
    positions, _ = run_on_r(law, lambda _: Setpoint(5e-3), 4000, limit=400.0, told=told)
    return 1e3 * float(np.max(positions)) - 5.0


def start_under_weight(law: Any, *, cold: bool) -> tuple[float, float]:
    """Largest force step (N) and shift (um) where a law takes over an axis that holds 400 N."""
    positions, commands = run_on_r(law, lambda _: Setpoint(0.0), 3000, acting=-400.0, cold=cold)
    return float(np.max(np.abs(commands - 400.0))), 1e6 * float(np.max(np.abs(positions)))
