"""Rows 1.g and 1.h: tracking, and a step that saturates the drive."""

from __future__ import annotations

from typing import Any

import numpy as np

from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.families import Law
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.loop.axis import Axis
from feeddrive.loop.core import advance
from feeddrive.loop.simulate import simulate
from feeddrive.papers.altintas2009.testbed import MASS, PLANT, VISCOUS, T, cascade, dadsc, loop
from feeddrive.papers.claims import Claim
from feeddrive.plot.curves import Row, curves
from feeddrive.report.content import Shown

RATE = 300.0
MOVE = Polynomial7(distance=0.1, travel_time=0.4)
STEP, LIMIT, LENGTH = 5e-3, 400.0, 6000


def motion() -> tuple[list[Claim], list[Shown]]:
    """Claims and pictures of rows 1.g and 1.h."""
    claims, pictures = _tracking()
    more, other = _saturation()
    return claims + more, pictures + other


def _error(law: Law, mass: float = MASS) -> np.ndarray:
    found = simulate(loop(law, mass=mass), MOVE, duration=0.6, record=("tracking_error",))
    return 1e6 * found["tracking_error"]


def _tracking() -> tuple[list[Claim], list[Shown]]:
    exact = {"DADSC": _error(dadsc(RATE)), "P-PI cascade": _error(cascade(RATE))}
    light = 0.8 * MASS
    off = {"DADSC": _error(dadsc(RATE, light)), "P-PI cascade": _error(cascade(RATE, light), light)}
    largest = {name: float(np.max(np.abs(error))) for name, error in exact.items()}
    wrong = {name: float(np.max(np.abs(error))) for name, error in off.items()}
    rule = f"polynomial of degree 7, 100 mm in 0.4 s; equal velocity gain, p = 300 1/s; {PLANT}; largest true error"
    light_rule = f"{rule}; mass of law and feedforward 0.8 m"
    claims = [
        *(Claim("1.g", f"{name} with the exact model", rule, got, None, 0.01, "um") for name, got in largest.items()),
        Claim("1.g", "DADSC with 0.8 of the mass", light_rule, wrong["DADSC"], 0.73, 0.78, "um", "0.756"),
        Claim("1.g", "P-PI with 0.8 of the mass", light_rule, wrong["P-PI cascade"], 1.22, 1.30, "um", "1.261"),
        Claim("1.g", "P-PI over DADSC with 0.8 of the mass", light_rule, wrong["P-PI cascade"] / wrong["DADSC"], 1.5,
              None, "", "1.67"),
    ]  # fmt: skip
    picture = Shown(
        "tracking",
        "Tracking with a wrong mass",
        "True error over a move of 100 mm in 0.4 s; law and feedforward believe in 0.8 of the mass.",
        f"Largest error {wrong['DADSC']:.2f} um with DADSC, {wrong['P-PI cascade']:.2f} um with P-PI.",
        lambda: curves("time (ms)", 1e3 * T * np.arange(off["DADSC"].size), [Row("error (µm)", off)]),
    )
    return claims, [picture]


def step_response(law: DADSC, windup: str) -> np.ndarray:
    """Position in m after a raw step of the setpoint, the force limited; `windup` says what the estimate then does.

    none              it goes on as if nothing had been cut off
    freezing          it is held in samples with a cut force
    back-calculation  the law's own: through `applied` and `requested`
    """
    axis = Axis(plant=Rigid(mass=MASS, viscous=VISCOUS))
    timing = axis.timing(T)
    hold, state = axis.prepare(T, timing), axis.start(0.0, 0.0, timing)
    prepared = law.prepare(T)
    kept: Any = law.start(prepared, Setpoint(0.0), Reading(0.0, 0.0))
    found = np.empty(LENGTH)
    applied = requested = 0.0
    for k in range(LENGTH):
        x = state.position[0]
        found[k] = x
        seen = applied if windup == "back-calculation" else requested
        after, requested = law.step(prepared, kept, Setpoint(STEP), Reading(x, x, seen, requested), T)
        applied = min(max(requested, -LIMIT), LIMIT)
        held = windup == "freezing" and applied != requested
        kept = after._replace(estimate=kept.estimate) if held else after
        state, _ = advance(axis, hold, state, applied, None, k * T, T)
    return found


def _saturation() -> tuple[list[Claim], list[Shown]]:
    named = {windup: step_response(dadsc(RATE), windup) for windup in ("none", "freezing", "back-calculation")}
    over = {name: 1e3 * float(np.max(x) - STEP) for name, x in named.items()}
    inside = np.abs(named["back-calculation"] - STEP) <= 0.02 * STEP
    settled = 1e3 * T * float(LENGTH - np.argmin(inside[::-1]))
    rule = f"raw step of 5 mm, force limit 400 N, DADSC with p = 300 1/s; {PLANT}"
    claims = [
        Claim("1.h", "overshoot with back-calculation: no runaway", rule, over["back-calculation"], None, 1.0, "mm",
              "0.72"),
        Claim("1.h", "settled to 2 % with back-calculation", rule, settled, None, 100.0, "ms", "78"),
        Claim("1.h", "overshoot when the estimate is frozen instead", rule, over["freezing"], over["back-calculation"],
              5.0, "mm", "1.5"),
        Claim("1.h", "overshoot without any of it: it runs away", rule, over["none"], 50.0, None, "mm", "290"),
    ]  # fmt: skip
    shown = {name: 1e3 * named[name][:1500] for name in ("freezing", "back-calculation")}
    picture = Shown(
        "saturation",
        "A step that saturates the drive",
        "Set position steps by 5 mm, force limit 400 N. Without anti-windup the axis overshoots by "
        f"{over['none']:.0f} mm.",
        "Two overshoots of a step of 5 mm; the one with back-calculation is the smaller.",
        lambda: curves("time (ms)", 1e3 * T * np.arange(1500), [Row("position (mm)", shown)], levels={"set": 5.0}),
    )
    return claims, [picture]
