"""The impulse sequences of input shapers; a command convolved with one of them does not excite a mode."""

import math

SHAPERS = ("zv", "zvd", "ei")


def pulses(shaper: str, frequency: float, damping: float, tolerance: float) -> tuple[list[float], list[float]]:
    """Return the amplitudes Aᵢ, with sum 1, and the times tᵢ (s) of the pulses for a mode.

        shaper     "zv" (no vibration), "zvd" (also zero slope versus frequency), "ei" (`tolerance` at the frequency
                   itself and, for an undamped mode, none at one frequency on either side)
        frequency  undamped natural frequency of the mode, Hz
        damping    damping ratio ζ of the mode, 0 <= ζ < 1
        tolerance  residual vibration of "ei" divided by that of the unshaped motion

    tᵢ = i · Tᵈ/2 with the period Tᵈ = 1 / (frequency √(1 - ζ²)), and Aᵢ = aᵢKⁱ / Σ aᵢKⁱ with K = e^(-πζ/√(1 - ζ²)), the
    decay over half a period:

        zv   a = 1, 1        zvd   a = 1, 2, 1        ei   a = 1 + V, 2 - 2V, 1 + V        V = tolerance

    With damping the EI pulses are scaled in the same way as the others, instead of by the usual numerical fit: after
    the last pulse the vibration is the fraction 4VK² / Σ aᵢKⁱ <= V of that of the unshaped motion.
    Source: Singer & Seering 1990 (ZV, ZVD); Singhose, Seering & Singer 1994 (EI).
    """
    root = math.sqrt(1.0 - damping * damping)
    decay = math.exp(-math.pi * damping / root)
    shares = {"zv": (1.0, 1.0), "zvd": (1.0, 2.0, 1.0), "ei": (1.0 + tolerance, 2.0 - 2.0 * tolerance, 1.0 + tolerance)}
    scaled = [share * decay**i for i, share in enumerate(shares[shaper])]
    # exact, since the amplitudes must add up to 1 for the motion to end at its goal
    total = math.fsum(scaled)
    half = 0.5 / (frequency * root)
    return [pulse / total for pulse in scaled], [i * half for i in range(len(scaled))]
