"""Estimation of the true mass and friction of an axis from a trial, with intervals that include model error."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feeddrive.identification.regression import robust_covariance
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

NORMAL_90 = 1.644853627  # half width of a 90 % interval of a normal error, in standard errors
# guideways and screws with seals on one side seldom differ by more than a quarter between the directions: 1.64 of these
ASYMMETRY = 0.15  # standard deviation of the half difference of the levels, of their mean, before a trial is known
# the form of Ĝ_d is improved once, from the learned parameters; what a second time would change is less than a part of
# what the first did (of model-free trials, 0.04 of the parameter error is left: `convergence`)
FORM = 0.2  # share of the change by the improved model that counts as error
# presliding before a rest and after it leaves part of the level in the integral, which no column describes: 3 to 5 % on
# foreign logs with presliding of 2 to 20 um (tests/foreign_trials.py)
LEFT = 0.03  # standard deviation of the half difference of the levels, of their mean, that no trial reduces
SHOWN = 2.0  # standard errors, `LEFT` included, beyond which a trial shows that the levels differ
ALIKE = 0.9  # correlation of two estimates beyond which the trial shows their combination rather than each
LEVELS = ("coulomb_positive", "coulomb_negative")


class Seen(NamedTuple):
    """The regressors and the error of a trial, filtered through one error model, in the samples used.

    columns  Ψ of the parameters, shape (n, parameters)
    timing   Ψ of the set jerk, shape (n, 1), or (n, 0) if the jerk is fed forward
    bump     Ψ of the excess friction at low speed, shape (n, 1), or (n, 0) if it, or no friction at all, is fed forward
    error    the error to be explained, shape (n,)
    start    the response to the unknown force at the first sample, shape (n,), or None if the force is known
    lags     samples over which residuals are correlated
    force_error  standard error of the known force at the first sample, N
    """

    columns: np.ndarray
    timing: np.ndarray
    bump: np.ndarray
    error: np.ndarray
    start: np.ndarray | None
    lags: int
    force_error: float = 0.0

    def fit(self, basis: np.ndarray, bump: bool) -> tuple[np.ndarray, np.ndarray, float]:
        """Return the step of each parameter combination in `basis`, its standard error, and the force per set jerk."""
        used = [self.columns @ basis, self.timing, *([self.bump] if bump else [])]
        if self.start is not None and np.any(self.start):
            used.append(self.start[:, None])
        columns = np.column_stack(used)
        sizes = np.linalg.norm(columns, axis=0)
        # a column that the motion does not have, as a jerk at constant speed, has neither step nor error
        there = sizes > 0.0
        columns, sizes = columns[:, there], sizes[there]
        step = np.linalg.lstsq(columns / sizes, self.error, rcond=1e-12)[0] / sizes
        covariance = robust_covariance(columns / sizes, self.error - columns @ step, self.lags)
        count = basis.shape[1]
        whole, sure = np.zeros(there.size), np.zeros(there.size)
        whole[there], sure[there] = step, np.sqrt(np.maximum(np.diag(covariance), 0.0)) / sizes
        return whole[:count], sure[:count], float(whole[count]) if self.timing.shape[1] else 0.0


@dataclass(frozen=True, eq=False)
class AxisValues:
    """The estimated true values of the axis, in the order of the names, and half the widths of their 90 % intervals.

    asymmetric  True if the trial shows that the difference of the two Coulomb levels is not the one fed forward
    remarks     remarks on parameter combinations that the trial does not determine, and the motion that would
    """

    value: np.ndarray
    half: np.ndarray
    asymmetric: bool
    remarks: tuple[str, ...]


def axis_values(names: Sequence[str], now: np.ndarray, first: Seen, better: Seen) -> AxisValues:
    """Return the estimated true values of the parameters in `names`, whose present values are `now` (SI).

    first   the trial, filtered through the error model used for learning
    better  the trial, filtered through the model with the learned mass and viscous friction; `first` if there is none

    The values are those of the better model with two additional columns. The first is the set jerk: a force delayed by
    τ has the effect of mass · τ per jerk, and changes the apparent mass by viscous · τ. The second is the excess
    friction at low speed (Stribeck, presliding).  The half width of an interval is

        √((1.645 s)² + (θ - θ')² + (FORM (θ - θ''))²)

    where θ' and s are the values and robust standard errors of the fit without the second column, and θ'' the values of
    the first model.  Half the difference of the levels has a prior standard deviation of `ASYMMETRY` times their mean;
    if the force at the first sample is unknown, only this prior is used.
    """
    both = set(LEVELS) <= set(names)
    basis = _mean_and_difference(names) if both else np.eye(len(names))
    difference = list(names).index(LEVELS[1]) if both else -1
    known = better.start is None or not np.any(better.start)
    shown = basis if known or not both else np.delete(basis, difference, axis=1)
    step, _, jerk = better.fit(shown, True)
    plain, sure, _ = better.fit(shown, False)
    rough, _, _ = first.fit(shown, True)
    half = np.sqrt((NORMAL_90 * sure) ** 2 + (step - plain) ** 2 + (FORM * (step - rough)) ** 2)
    if {"mass", "viscous"} <= set(names):
        mass, viscous = (list(names).index(name) for name in ("mass", "viscous"))
        heavy = now[mass] + step[mass]
        step[mass] -= (now[viscous] + step[viscous]) * jerk / heavy if heavy > 0.0 else 0.0
    if not both:
        return AxisValues(now + step, half, False, _alike(names, better, shown))
    if not known:
        rough = np.insert(rough, difference, 0.0)
        step, half = np.insert(step, difference, 0.0), np.insert(half, difference, np.inf)
    mean = float(np.mean([now[list(names).index(level)] for level in LEVELS])) + step[list(names).index(LEVELS[0])]
    # a constant force is the integral of the error over the whole trial: both models follow it equally well
    moved = abs(float((step - rough)[difference])) if known else 0.0
    least = NORMAL_90 * np.hypot(better.force_error, LEFT * max(mean, 0.0))
    half[difference] = float(np.linalg.norm([half[difference], moved, least]))
    asymmetric = bool(abs(step[difference]) > SHOWN * half[difference] / NORMAL_90)
    remarks = _difference_remark(now, names, step[difference], half[difference], known, asymmetric)
    prior = NORMAL_90 * ASYMMETRY * max(mean, 0.0)
    # two normal errors: the weights are the inverse variances
    share = prior**2 / (prior**2 + half[difference] ** 2) if prior > 0.0 and np.isfinite(half[difference]) else 0.0
    step[difference] *= share
    half[difference] = np.sqrt(share) * half[difference] if share > 0.0 else prior
    wide = np.sqrt(basis**2 @ half**2)
    return AxisValues(now + basis @ step, wide, asymmetric, (*remarks, *_alike(names, better, shown)))


def _mean_and_difference(names: Sequence[str]) -> np.ndarray:
    """Return the matrix that maps the mean and the half difference of the two levels to the levels themselves."""
    matrix = np.eye(len(names))
    plus, minus = (list(names).index(level) for level in LEVELS)
    matrix[minus, plus], matrix[plus, minus], matrix[minus, minus] = 1.0, 1.0, -1.0
    return matrix


def _difference_remark(
    now: np.ndarray, names: Sequence[str], step: float, half: float, known: bool, asymmetric: bool
) -> tuple[str, ...]:
    """Return a remark on the difference of the levels, unless the trial determines it."""
    if asymmetric:
        return ()
    plus, minus = (float(now[list(names).index(level)]) for level in LEVELS)
    kept = Quantity(plus - minus, "N")
    if not known:
        return (
            Text(
                "this trial does not show the difference of coulomb_positive and coulomb_negative, which stays at "
                f"{kept}: while the axis moves it is a constant force, which the integral takes up, and at rest "
                "friction holds any force; no further motion shows it, but a log that begins at rest and has the "
                "commanded force does"
            ),
        )
    found = Quantity(plus - minus + 2.0 * step, "N", 2.0 * half / NORMAL_90)
    return (
        Text(
            f"the difference of coulomb_positive and coulomb_negative, {found} in this trial, is within "
            f"{Quantity(SHOWN):6} standard errors of what is fed forward and stays at {kept}: a second round "
            "trip makes it more certain"
        ),
    )


def _alike(names: Sequence[str], seen: Seen, basis: np.ndarray) -> tuple[str, ...]:
    """Return a remark if the trial determines only the sum of viscous friction and mean level."""
    if "viscous" not in names or LEVELS[0] not in names:
        return ()
    columns = np.column_stack([seen.columns @ basis, seen.timing, seen.bump])
    sizes = np.linalg.norm(columns, axis=0)
    sizes[sizes == 0.0] = 1.0
    inverse = np.linalg.pinv((columns / sizes).T @ (columns / sizes))
    i, k = list(names).index("viscous"), list(names).index(LEVELS[0])
    alike = -float(inverse[i, k] / np.sqrt(inverse[i, i] * inverse[k, k]))
    if alike < ALIKE:
        return ()
    speed = Quantity(float(np.sqrt(inverse[k, k] / inverse[i, i]) * sizes[i] / sizes[k]), "m/s")
    return (
        Text(
            f"this trial shows viscous friction and the Coulomb levels by their sum at {speed}, and each less well: "
            "add constant speed both ways at a second, slower speed"
        ),
    )
