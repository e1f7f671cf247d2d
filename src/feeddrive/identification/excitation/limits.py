"""Travel, speed and force of a simulated excitation against their limits, and what would keep one that breaks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from feeddrive.identification.excitation.excitation import Drawing, Excitation, Limit, said
from feeddrive.loop.loop import Loop

_TRIALS = 5  # simulations to find an amplitude that keeps the limits
_HOPELESS = 100.0  # times as much as may be: the amplitude that keeps such a limit measures nothing


def limits(
    loop: Loop, drawings: list[Drawing], travel: float | None, speed: float | None, force: float | None
) -> list[Limit]:
    """Peaks over all realisations against what was asked for, or what guard, control and motor say."""
    guard, motor = loop.control.guard, loop.axis.actuator.motor
    peak, continuous = (None, None) if motor is None else motor.limits()
    if force is None:
        stated = [float(each) for each in (loop.control.force_limit, peak) if each is not None]
        force = min(stated) if stated else None
    if guard is not None:
        speed = guard.velocity_limit if speed is None else speed
        if travel is None and guard.travel_least is not None and guard.travel_most is not None:
            travel = guard.travel_most - guard.travel_least
    forces = [drawn.signals["force"] for drawn in drawings]
    speeds = [np.abs(drawn.signals[name]) for drawn in drawings for name in ("velocity_load", "velocity_motor")]
    stroke = max(float(np.ptp(drawn.signals["reading_load"])) for drawn in drawings)
    rms = max(float(np.sqrt(np.mean(each**2))) for each in forces)
    return [
        Limit("travel", stroke, travel, "m"),
        Limit("speed, peak", max(float(np.max(each)) for each in speeds), speed, "m/s"),
        Limit("force, peak", max(float(np.max(np.abs(each))) for each in forces), force, "N"),
        Limit("force, RMS", rms, None if continuous is None else float(continuous), "N"),
    ]


def _worst(found: Excitation) -> tuple[Limit, float]:
    """The limit that is broken most, and by what factor."""
    shares = {limit: limit.got / limit.most if limit.most else np.inf for limit in found.limits if not limit.holds}
    worst = max(shares, key=lambda limit: shares[limit])
    return worst, shares[worst]


def broken(found: Excitation) -> str:
    """The limit that is broken most, as the beginning of a sentence."""
    worst, share = _worst(found)
    assert worst.most is not None
    got, may = said(worst.got, worst.unit), said(worst.most, worst.unit)
    text = f"{worst.what} comes to {got} in the simulation and may be {may}"
    if not np.isfinite(share):
        return text
    return f"{text}, {100.0 * (share - 1.0):.3g} % too much" if share < 3.0 else f"{text}, {share:.3g} times as much"


def advice(found: Excitation, drawn: Callable[[float], Excitation]) -> str:
    """An amplitude that was simulated and keeps all limits, or what else to change."""
    other = ""
    worst, share = _worst(found)
    if worst.what == "travel" and found.offset_velocity:
        fitting = int(found.periods / share)
        other = f"{fitting} periods" if fitting >= 2 else "a smaller offset velocity"
    tried = found
    for _ in range(_TRIALS):
        _, share = _worst(tried)
        if share > _HOPELESS:
            break
        tried = drawn(0.98 * tried.amplitude / share)
        if all(limit.holds for limit in tried.limits):
            keeps = f"an amplitude of {said(tried.amplitude, found.unit)} keeps it"
            return f"{keeps}, or {other}" if other else keeps
    return f"take {other}" if other else "no amplitude keeps it; look at the motion underneath and at the limits"
