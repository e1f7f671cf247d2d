"""From runs over the travel to the harmonics of the cogging, with friction and chance apart from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from feeddrive.engineer.identification.cogging import CoggingFit, CoggingOrder
from feeddrive.engineer.identification.cogging_run import CoggingRun
from feeddrive.engineer.identification.covariance import robust_groups
from feeddrive.engineer.identification.parameters import Estimate
from feeddrive.language.errors import NotIdentifiableError, ParameterError

RISK = 0.05  # that any order at all is called significant where there is none
_ROWS = 3  # rows a column needs


def identify_cogging(runs: Sequence[CoggingRun], orders: Sequence[int] | None = None, *, unit: str = "A") -> CoggingFit:
    """Harmonics of the position by least squares over all runs together, with the friction apart.

        force = offset + d coulomb + Σ over orders of (even + d odd),   d = ±1 the direction
        even, odd: a cos(2π order x) + b sin(2π order x)

    Cogging does not know the direction of motion and friction changes its sign with it; so with runs in both directions
    even is cogging and odd is friction that varies along the travel.  With one direction only their sum is seen.

    orders  default: all up to 128, or as many as a third of the visited positions can carry

    An order is significant if its Wald statistic exceeds what the strongest of all orders would show by chance in 5 %
    of cases without any (Bonferroni).  Errors are robust to the residual's autocorrelation.
    Raises NotIdentifiableError for runs that do not go round once.
    """
    if not runs:
        raise ParameterError("identify_cogging needs at least one run")
    chosen = tuple(orders) if orders is not None else tuple(range(1, _most(runs) + 1))
    if not chosen or min(chosen) < 1 or len(set(chosen)) != len(chosen):
        raise ParameterError("orders must be whole numbers >= 1, each once")
    for i, run in enumerate(runs):
        covered = np.unique(np.floor(np.mod(run.turns, 1.0) * 2 * max(chosen))).size
        if covered < 0.95 * min(2 * max(chosen), run.turns.size):
            raise NotIdentifiableError(
                f"run {i + 1} visits {covered} of {2 * max(chosen)} places of a turn that order {max(chosen)} needs; "
                f"record next a whole turn at low speed, or ask for fewer orders"
            )
    both = len({run.direction for run in runs}) == 2
    columns, force = _columns(runs, chosen, both), np.concatenate([run.force for run in runs])
    values = np.linalg.lstsq(columns, force, rcond=None)[0]
    residual = force - columns @ values
    width, first = (4, 2) if both else (2, 1)
    groups = [np.arange(first), *(np.arange(width) + first + width * i for i in range(len(chosen)))]
    levels, *shared = robust_groups(columns, residual, groups)
    found = [
        _order(n, values[group], spread, runs, unit, len(chosen))
        for n, group, spread in zip(chosen, groups[1:], shared, strict=True)
    ]
    found.sort(key=lambda each: -each.amplitude)
    constants = [
        Estimate(name, float(values[k]), unit, float(np.sqrt(levels[k, k])), float("nan"))
        for k, name in enumerate(("offset", "coulomb")[:first])
    ]
    coulomb = constants[1] if both else None
    return CoggingFit(tuple(found), coulomb, constants[0], residual, unit, _remarks(found, both))


def _most(runs: Sequence[CoggingRun]) -> int:
    places = min(np.unique(np.mod(run.turns, 1.0)).size for run in runs)
    return max(1, min(128, places // (2 * _ROWS)))


def _columns(runs: Sequence[CoggingRun], orders: Sequence[int], both: bool) -> np.ndarray:
    """1, d, and for each order cos, sin, d cos, d sin; those with d only for both directions."""
    parts = []
    for run in runs:
        one = np.ones(run.turns.size)
        columns = [one, run.direction * one] if both else [one]
        for n in orders:
            angle = 2.0 * np.pi * n * run.turns
            pair = [np.cos(angle), np.sin(angle)]
            columns += [*pair, *(run.direction * each for each in pair)] if both else pair
        parts.append(np.column_stack(columns))
    return np.concatenate(parts)


def _order(
    n: int, pairs: np.ndarray, shared: np.ndarray, runs: Sequence[CoggingRun], unit: str, tried: int
) -> CoggingOrder:
    """Amplitudes of an order by direction, and its significance."""
    width, both = pairs.size, pairs.size == 4
    statistic = float(pairs @ np.linalg.solve(shared, pairs))
    p_value = float(chi2.sf(statistic, width))

    def amplitude(name: str, weights: tuple[float, float]) -> tuple[Estimate, float]:
        turn = np.hstack([w * np.eye(2) for w in weights[: width // 2]])
        (a, b), spread = turn @ pairs, turn @ shared @ turn.T
        size = float(np.hypot(a, b))
        along = np.array([a, b]) / (size or 1.0)
        error = float(np.sqrt(along @ spread @ along))
        return Estimate(name, size, unit, error, float("nan")), float(np.arctan2(a, b))

    only = runs[0].direction
    forward = amplitude("forward", (1.0, 1.0)) if both or only == 1 else None
    backward = amplitude("backward", (1.0, -1.0)) if both or only == -1 else None
    even = amplitude("even", (1.0, 0.0)) if both else None
    odd = amplitude("odd", (0.0, 1.0)) if both else None
    shown = forward or backward
    assert shown is not None
    return CoggingOrder(
        n, None if even is None else even[0], 0.0 if even is None else even[1], None if odd is None else odd[0],
        None if forward is None else forward[0], None if backward is None else backward[0], shown[1], p_value,
        p_value < RISK / tried,
    )  # fmt: skip


def _remarks(found: Sequence[CoggingOrder], both: bool) -> tuple[str, ...]:
    if not both:
        return (
            "all runs go one way: friction is in the offset, and friction that varies along the travel in the "
            "harmonics; record next the same travel the other way",
        )
    flipped = [
        each.order
        for each in found
        if each.significant and each.even is not None and each.odd is not None and each.odd.value > each.even.value
        and each.amplitude > 0.05 * found[0].amplitude
    ]  # fmt: skip
    if not flipped:
        return ()
    listed = ", ".join(map(str, flipped))
    return (
        f"order {listed}: changes its sign with the direction of motion, so it is no cogging but friction that "
        f"varies along the travel, or an error of the current's zero; a compensation "
        f"by position alone must know the direction",
    )
