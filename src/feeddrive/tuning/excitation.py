"""Which columns a trial has excited, and why the others must wait for another one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

LEAST_REVERSAL = 0.02  # of the moving samples: what must go in each direction for friction to be told from gravity
LEAST_OWN = 0.02  # of a column's size: what no other columns may explain, 1/50: its error grows by 50 there
FRICTION = ("coulomb_positive", "coulomb_negative", "stribeck")
# which of two columns that look alike is frozen: the later one
_ORDER = (
    "mass", "coulomb_positive", "coulomb_negative", "viscous", "stribeck", "jerk_feedforward", "snap_feedforward",
)  # fmt: skip


def not_excited(
    names: Sequence[str], columns: np.ndarray, seen: np.ndarray, velocity: np.ndarray, dead_band: float
) -> dict[str, str]:
    """Reasons, by name, why columns are to be frozen; shape of both matrices: (samples, columns).

    columns   φ, of the set motion         seen      Ψ, the same through Ĝ_d: what the error can show
    velocity  m/s, of the set motion in the middle of the samples
    """
    found = _without_reversal(names, velocity, dead_band)
    for i, name in enumerate(names):
        if name not in found and not np.any(columns[:, i]):
            found[name] = "its column is 0 in the whole trial"
    sizes = np.linalg.norm(seen, axis=0)
    alike = (seen / np.where(sizes > 0.0, sizes, 1.0)).T @ (seen / np.where(sizes > 0.0, sizes, 1.0))
    kept: list[int] = []
    for name in sorted((name for name in names if name not in found), key=_ORDER.index):
        i = names.index(name)
        left = _own(alike, i, kept)
        if left < LEAST_OWN:
            nearest = names[max(kept, key=lambda k: abs(float(alike[i, k])))] if kept else "none"
            found[name] = (
                f"only {100.0 * left:.2g} % of its column is not explained by {_listed([names[k] for k in kept])}, at "
                f"least {100.0 * LEAST_OWN:g} % is needed; it is most like {nearest}: add a second speed, or more "
                f"acceleration"
            )
        else:
            kept.append(i)
    return found


def _own(alike: np.ndarray, i: int, others: list[int]) -> float:
    """Size of what is left of a column of size 1 without its part along others; `alike` holds their products."""
    if alike[i, i] <= 0.0:
        return 0.0
    across = alike[others, i]
    between = alike[others][:, others]
    explained = float(across @ np.linalg.solve(between, across)) if others else 0.0
    return float(np.sqrt(max(0.0, 1.0 - explained)))


def _without_reversal(names: Sequence[str], velocity: np.ndarray, dead_band: float) -> dict[str, str]:
    forward, backward = int(np.sum(velocity > dead_band)), int(np.sum(velocity < -dead_band))
    moving = forward + backward
    share = min(forward, backward) / moving if moving else 0.0
    if share >= LEAST_REVERSAL:
        return {}
    towards = "smaller" if backward <= forward else "larger"
    missing = int(np.ceil(LEAST_REVERSAL * moving)) - min(forward, backward)
    reason = (
        f"the trial has no reversal: {100.0 * share:.2g} % of its moving samples go towards {towards} positions, at "
        f"least {100.0 * LEAST_REVERSAL:g} % are needed ({missing} samples more), else friction cannot be told from "
        f"gravity or an offset"
    )
    if moving == 0:
        reason = "the axis does not move in the trial"
    return {name: reason for name in names if name in FRICTION or moving == 0}


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else "".join(names)


def condition(seen: np.ndarray) -> float:
    """Condition number of columns that are scaled to the same size; 1 for none."""
    if not seen.shape[1]:
        return 1.0
    return float(np.linalg.cond(seen / np.linalg.norm(seen, axis=0)))


def reasons(frozen: Mapping[str, str]) -> str:
    """All of them as one text."""
    return "; ".join(f"{name}: {reason}" for name, reason in frozen.items())
