"""Which parameters frequency responses cannot tell, and what to measure next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from feeddrive.identification.estimate import Estimate
from feeddrive.identification.response.refine import Refined
from feeddrive.identification.response.units import ResponseUnits

_TIED = 0.995  # correlation of two parameters from which they count as one
_BLIND = 0.01  # share of what parameters do that tells them apart: below, what the model lacks moves them as well
_SURE = 0.1  # standard error over value up to which a parameter of such a combination still counts as known


def advice(name: str, band: tuple[float, float], mass: float, error: float, units: ResponseUnits) -> str:
    """Why a parameter cannot be told from these lines, and what to measure next; band in Hz, mass as fitted."""
    low, high = band
    last = name.rsplit(".", 1)[-1]
    known = f"its standard error is {error:.2g}"
    match last:
        case "viscous_motor" | "viscous_load" | "viscous":
            # the phase of 1/(M s² + B s) leaves -180° by 3° where B = M ω/20
            below = error / (2.0 * np.pi * max(mass, 1e-300))
            return (
                f"{known} {units.of('N s/m')}: inertia hides it above {below:.2g} Hz, and the lowest line is at "
                f"{low:.3g} Hz; fix it, or take it from runs at constant speeds (a friction curve), which tell all "
                f"viscous friction together"
            )
        case "damping" | "damping_ratio":
            return (
                f"{known} {'' if last == 'damping_ratio' else units.of('N s/m')}: no line lies close enough to the "
                f"top of the resonance; measure next at least five lines within its width at -3 dB, 2 ζ f"
            )
        case "current_loop":
            return (
                f"{known} Hz: below {high:.3g} Hz a lag looks like a dead time; fix one of both (the drive's manual "
                f"states the bandwidth of its current loop), or measure next up to that bandwidth"
            )
        case "mass_motor" | "mass_load" | "stiffness" | "mass" | "coupling_mass":
            return (
                f"{known}: measure next with lines on both sides of the antiresonance and of the resonance, at the "
                f"motor's encoder too, with more amplitude or more periods where the coherence is low"
            )
        case _:
            return f"{known}: more than half of its value; measure next more lines or more periods where it acts"


def beyond(resonance: Estimate, band: tuple[float, float]) -> list[str]:
    """A sentence on a resonance in Hz that lies outside the lines."""
    low, high = band
    if low <= resonance.value <= high:
        return []
    surely = resonance.error <= 0.5 * resonance.value
    where = f"at {resonance.value:.4g} ± {resonance.error:.2g} Hz " if surely else ""
    last = (
        f"up to {1.5 * resonance.value if surely else 3.0 * high:.3g} Hz"
        if resonance.value > high or not surely
        else f"from {0.5 * resonance.value:.3g} Hz"
    )
    return [
        f"the resonance {where}lies beyond the lines ({low:.4g} to {high:.4g} Hz): its masses and its stiffness are "
        f"told only by how the response bends towards it, which any further mode does, too; measure next {last}"
    ]


def entangled(names: Sequence[str], found: Refined) -> list[str]:
    """Sentences on parameters of which the lines tell only a combination: by the singular values of the slopes.

    The slopes are scaled to columns of length one; a singular value near zero is a direction in which all parameters of
    the row may move together and nothing is seen.
    """
    return [
        f"{', '.join(together)} are told apart only by {100.0 * share:.2g} % of what each does to the "
        f"responses: fix one of them, or measure over a wider band"
        for share, together in _combinations(names, found)
    ]


def blind(estimates: Sequence[Estimate], found: Refined) -> dict[str, str]:
    """Parameters of a combination that is all but invisible, known to no better than a tenth: why they do not count.

    A standard error there holds only as long as the model lacks nothing, to a hundredth of what each parameter does.
    """
    gone: dict[str, str] = {}
    for share, together in _combinations([each.name for each in estimates], found):
        for each in estimates:
            if share < _BLIND and each.name in together and each.error > _SURE * abs(each.value):
                others = ", ".join(name for name in together if name != each.name)
                gone.setdefault(
                    each.name,
                    f"it is told from {others} by {100.0 * share:.2g} % of what it does to the responses, less than a "
                    f"model is right, and its standard error is {each.error:.2g} {each.unit}; fix one of them (--fix), "
                    f"from a data sheet",
                )
    return gone


def _combinations(names: Sequence[str], found: Refined) -> list[tuple[float, list[str]]]:
    """Parameters of which the lines tell only a combination, and the share of their effect that tells them apart."""
    loose = [i for i in range(len(names)) if not found.bound[i]]
    size = np.linalg.norm(found.slopes[:, loose], axis=0)
    seen = [i for i, s in zip(loose, size, strict=True) if s > 0.0]
    if len(seen) < 2:
        return []
    columns = found.slopes[:, seen] / np.linalg.norm(found.slopes[:, seen], axis=0)
    _, values, rows = np.linalg.svd(columns, full_matrices=False)
    combined: list[tuple[float, list[str]]] = []
    for value, row in zip(values[::-1], np.abs(rows[::-1]), strict=True):
        # two columns of correlation r have singular values √(1 ± r)
        if value > np.sqrt(1.0 - _TIED):
            break
        together = [names[i] for i, share in zip(seen, row, strict=True) if share > 0.3 * row.max()]
        combined.append((float(value), together))
    return combined
