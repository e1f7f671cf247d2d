"""What a certificate says in words, and what is said where there is none."""

from __future__ import annotations

import numpy as np

from feeddrive.certificate.deployed import Deployed
from feeddrive.certificate.plants import NominalPlant
from feeddrive.certificate.responses import LoopResponse

CLAIM = (
    "For every plant of the list the linear loop of the control with these coefficients is stable, and it stays so for "
    "every plant P (1 + Δ) with |Δ| <= r(f) at all frequencies from 0 to half the sample rate, grid points and "
    "everything between them."
)
THEOREM = (
    "F = Dc Dp - Nc Np has all zeros inside the unit circle and |F| > r |Nc Np| on it; by Rouché's theorem "
    "F - Nc Np Δ then has as many zeros outside as F, none. Δ is any stable transfer function, or one with which "
    "P (1 + Δ) has the poles of P on and outside the circle (Doyle, Francis & Tannenbaum 1992, chapter 4)."
)
ASSUMED = [
    "The plant of the list is linear, time invariant and sampled with the control; its poles on and outside the unit "
    "circle are those of the model.",
    "The control computes its linear law with the numbers of the list.",
]
BETWEEN = (
    "Between measured lines the true plant stays in the disc around the model, with the larger radius of both; "
    "a resonance narrower than the distance of the lines, which no line shows, is not covered. Below the first and "
    "above the last line the radius is an assumption. The errors of the lines are complex normal with the variances of "
    "the list; they may hang together."
)
NOT_CHECKED = [
    "what stands there for people: claim, theorem, assumed, machine, law, parameters, units, readings, states, the "
    "plants' names and source, dead_time_s, sample_time_ms",
    "that the matrices are those of this control with these numbers: feeddrive traced it and says so",
]
OUTSIDE = [
    "saturation: force limit, current limit, anti-windup in action",
    "friction other than its slope at the stated velocity: stick, stiction, reversal; backlash",
    "rounding of signals: counts of encoders, arithmetic of the running controller, limit cycles",
    "enable, trips and start; feedforward and reference, which cannot destabilise a linear loop",
    "change in time: wear, temperature, a position or load that is not in the list",
]


def refusal(made: Deployed, plant: NominalPlant, loop: LoopResponse, place: float | None) -> str:
    """Where, by how much, and what to do. `place` in Hz; None for a loop that is not stable at all."""
    lost = ""
    if made.coarse:
        name = max(made.coarse, key=lambda each: made.coarse[each])
        lost = f"; rounding to {made.arithmetic} moves {name} by {100.0 * made.coarse[name]:.3g} %: use more digits"
    T = made.model.sample_time
    if place is None:
        turning = abs(np.angle(loop.pole)) / (2.0 * np.pi * T)
        motion = f"an oscillation of {turning:.4g} Hz" if turning > 0.0 else "a drift"
        grows = "grows" if loop.growth > 1.0 else "does not die out"
        rounded = "" if made.arithmetic == "float64" else f" with {made.arithmetic} coefficients"
        remedy = "lower the gains, or put a notch there" if turning > 0.0 else "lower the gains"
        if plant.lines and turning == 0.0:
            remedy += ", or multiply the response by -1 if its sign is reversed"
        return (
            f"not certified: '{plant.name}': the nominal loop{rounded} is not stable: {motion} {grows} "
            f"(|z| = {loop.growth:.9g}): {remedy}{lost}"
        )
    at = np.array([place])
    distance, taken = (float(each[0]) for each in loop.room(at))
    share = distance / taken if taken else np.inf
    r = float(np.max(loop.radii(at)))
    said = (
        f"not certified: '{plant.name}': at {place:.5g} Hz |1 + L| is {distance:.4g} and the disc takes {taken:.4g}: "
        f"with r = {r:.4g} there, it may be at most {r * share:.4g}"
    )
    return f"{said}: {_remedy(plant, place)}{lost}"


def _remedy(plant: NominalPlant, place: float) -> str:
    """What to do, by what makes the disc wide."""
    T = plant.model.sample_time
    if plant.lines:
        lines = plant.lines[0]
        if place > lines.frequency[-1]:
            return f"lower the gains, measure beyond {lines.frequency[-1]:.4g} Hz, or state a smaller r beyond it"
        i = int(np.argmin(np.abs(lines.frequency - place)))
        model = plant.model.response(lines.frequency[i : i + 1], output=plant.model.outputs[0]).response[0]
        noise, misfit = np.sqrt(lines.variance[i]), abs(lines.response[i] - model)
        if noise > misfit:
            return f"measure longer around {place:.4g} Hz, where noise makes the disc wide, or lower the gains"
        better = "" if "fitted" in plant.source else ", with --fit from the lines alone"
        return (
            f"lower the gains, or fit the plant better around {place:.4g} Hz, where the model misses the lines{better}"
        )
    modes = np.array([p for p in plant.model.poles() if abs(p) > 0.5 and np.imag(p) > 0.0])
    if modes.size:
        near = np.angle(modes) / (2.0 * np.pi * T)
        nearest = float(near[np.argmin(np.abs(np.log(near / place)))])
        if 0.9 < nearest / place < 1.1:
            return f"put a notch at {nearest:.4g} Hz, lower the gains, or state a smaller disc"
    return "lower the gains, or state a smaller disc"
