"""The optimizer: sequential quadratic programming with a trust region, in the logarithms of the tunables."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.loop.control import Control
from feeddrive.tuning.criteria import Bound, Criteria, Evaluation


def least_quadratic(H: np.ndarray, g: np.ndarray, A: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Return x and multipliers of  min ½ xᵀHx + gᵀx  subject to  A x >= b,  H positive definite; None if infeasible.

    Source: Lawson & Hanson 1974, chapter 23 (least distance programming).
    """
    # imported here: slow to load and not needed by commands that only read
    from scipy.optimize import nnls

    # a few tunables, hundreds of bounds: products with the small inverse do not wake the threads of the BLAS, as a
    # triangular solve does
    inverse = np.linalg.inv(np.linalg.cholesky(H))
    shift, G = inverse @ g, A @ inverse.T
    h = b + G @ shift
    # rows scaled to equal length, so that all bounds have equal weight
    scale = np.maximum(np.sqrt(np.sum(G * G, axis=1)), 1e-300)
    E = np.vstack([(G / scale[:, None]).T, h / scale])
    f = np.zeros(E.shape[0])
    f[-1] = 1.0
    try:
        u, _ = nnls(E, f, maxiter=30 * E.shape[1])
    except RuntimeError:
        return None
    r = E @ u - f
    # a residual of zero means that the bounds contradict each other
    if not -r[-1] > 1e-12:
        return None
    y = -r[:-1] / r[-1]
    return inverse.T @ (y - shift), u / (-r[-1] * scale)


_FIRST, _LARGEST, _SMALLEST = 0.25, 0.6, 2e-3  # of a logarithm: initial, largest and smallest trust region
_AGAIN = 0.1  # of a logarithm: trust region after a restart
_STEPS = 60
_ENOUGH = 1e-4  # of the goal's logarithm: less progress ends the search
PENALTY, _DEARER, _DEAREST = 5.0, 6.0, 1e3  # weight of a violated bound: initial, growth factor, largest
_CROSSED = 0.9  # share of the tunables of a trial point that come from the mutation
_FLAT = 1e-2  # smallest eigenvalue of the Hessian
# of a logarithm: reserve to every bound, for peaks between the lines of the search
_ROOM = 1e-3


class End(NamedTuple):
    """The final point of a search.

    judged  its evaluation
    force   Lagrange multiplier of each bound, by key
    broken  largest violation of a bound
    """

    x: np.ndarray
    judged: Evaluation
    force: Mapping[tuple[str, int, int], float]
    broken: float


class Search:
    """The minimization of the goal at the worst operating point.

    Every bound must be satisfied with a slack of at least `sure` standard deviations.
    """

    def __init__(self, criteria: Criteria, low: np.ndarray, high: np.ndarray, sure: float = 0.0) -> None:
        self.criteria, self.low, self.high, self.sure = criteria, low, high, sure
        self.accepted: Callable[[np.ndarray, Evaluation], None] = lambda _x, _evaluation: None
        self.penalty = PENALTY

    def report_to(self, progress: Progress, control: Control, names: Sequence[str]) -> None:
        """Report every new best controller that satisfies all bounds to `progress`."""
        best = np.inf

        def accepted(x: np.ndarray, evaluation: Evaluation) -> None:
            nonlocal best
            cost = float(np.exp(np.max(evaluation.goal)))
            # a search ends at a bound, with its reserve used up by rounding
            if cost < best and self.broken(evaluation) <= _ROOM:
                best = cost
                progress.better(cost, tree.vary(control, dict(zip(names, np.exp(x).tolist(), strict=True))))

        self.accepted = accepted

    def judge(self, x: np.ndarray) -> Evaluation | None:
        """Return the evaluation at x, or None if the loop is unstable or the evaluation fails."""
        try:
            evaluation = self.criteria(x)
        except (FeeddriveError, ArithmeticError, np.linalg.LinAlgError):
            return None
        return evaluation if evaluation.stable and np.all(np.isfinite(evaluation.goal)) else None

    def look(self, points: np.ndarray, better_than: np.ndarray | None = None) -> np.ndarray:
        """Return the merit at many points (points, tunables), clipped to the search range.

        better_than  a merit for each point: where the goal alone or a part of the points of the criteria shows that it
                     is not reached, the merit of this part is returned, which is no better; -inf: that of the points
                     with a goal

        The merit is infinite where the loop is unstable or the evaluation fails.
        """
        inside = np.clip(points, self.low, self.high)

        def promising(i: int, evaluation: Evaluation) -> bool:
            return better_than is None or self.merit(evaluation) < better_than[i]

        goal_first = better_than is not None and bool(np.all(better_than > -np.inf))
        fine = (
            evaluation if evaluation is not None and evaluation.stable and np.isfinite(evaluation.goal).all() else None
            for evaluation in self.criteria.looked(inside, promising, goal_first=goal_first)
        )
        return np.array([self.merit(evaluation) for evaluation in fine])

    def best(self, points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the best of many points, with their merits, the best first.

        At plants of a box only those are judged that may be among the best by their merit at the model, which cannot be
        worse.
        """
        merits = lower = self.look(points, np.full(len(points), -np.inf))
        if self.criteria.over_plants:
            merits = np.full(len(points), np.inf)
            for i in np.argsort(lower):
                least = np.partition(merits, count - 1)[count - 1]
                if lower[i] >= least:
                    break
                merits[i] = self.look(points[i : i + 1], np.array([least]))[0]
        order = np.argsort(merits)[:count]
        return points[order], merits[order]

    def evolve(
        self, points: np.ndarray, merits: np.ndarray, random: np.random.Generator, turns: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evolve a population (points, tunables) for `turns` generations; return it with its merits, best first.

        In each generation of differential evolution every point competes with a trial point, which is composed of the
        point itself, one of the best points and two others; the better of the two survives.
        Source: Storn & Price 1997, current-to-best/1/bin, with a random factor for each trial.
        """
        many, n = points.shape
        for _ in range(turns):
            a, b = (points[random.integers(many, size=many)] for _ in range(2))
            factor = random.uniform(0.3, 0.9, (many, 1))
            best = points[random.choice(np.argsort(merits)[: max(many // 6, 1)], size=many)]
            trial = points + factor * (best - points) + factor * (a - b)
            trial = np.where(random.random((many, n)) < _CROSSED, trial, points)
            trial_merits = self.look(trial, merits)
            better = trial_merits < merits
            points, merits = (
                np.where(better[:, None], np.clip(trial, self.low, self.high), points),
                np.minimum(trial_merits, merits),
            )
        order = np.argsort(merits)
        return points[order], merits[order]

    def broken(self, evaluation: Evaluation) -> float:
        """Return the largest violation of a bound; negative if all bounds are satisfied."""
        left = _ROOM - evaluation.slacks(self.sure)
        return float(np.max(left)) if left.size else -1.0

    def room(self, bound: Bound) -> float:
        """Return the smallest slack with which a bound counts as satisfied."""
        return _ROOM + self.sure * bound.deviation

    def merit(self, evaluation: Evaluation | None) -> float:
        """Return the value of the merit function, which every step must reduce; infinite without an evaluation."""
        if evaluation is None:
            return np.inf
        return float(np.max(evaluation.goal)) + self.penalty * max(self.broken(evaluation), 0.0)

    def descend(self, x: np.ndarray, size: float = _FIRST) -> End:
        """Minimize from a stable point; if bounds remain violated, increase the penalty and continue."""
        end = self._descend(x, size)
        while end.broken > _ROOM and self.penalty < _DEAREST:
            # if the goal falls faster than the penalty rises, the search would leave the limits
            self.penalty *= _DEARER
            end = self._descend(end.x, _FIRST)
        return end

    def _descend(self, x: np.ndarray, size: float) -> End:
        x = np.clip(x, self.low, self.high)
        here = self.judge(x)
        assert here is not None
        idle, fresh = 0, True
        curvature = _definite(here.curvature)
        force: dict[tuple[str, int, int], float] = {}
        for _ in range(_STEPS):
            step = self._step(x, here, curvature, size)
            if step is None:
                size *= 0.3
                if size < _SMALLEST:
                    break
                continue
            move, force, promised = step
            if promised < _ENOUGH * 0.3:
                if fresh:
                    break
                # the estimated curvature may stop the search: restart without it
                curvature, fresh, size = _definite(here.curvature), True, max(size, _AGAIN)
                continue
            fresh = False
            there = self.judge(x + move)
            gained = self.merit(here) - self.merit(there)
            # a curved bound cuts off long steps along it (Maratos effect)
            if there is not None and gained < 0.1 * promised and self.broken(there) > 0.0:
                # second-order correction: solve again with the true bounds at the end of the step
                again = self._step(x, here, curvature, size, self._curved(here, there, move))
                other = None if again is None else self.judge(x + again[0])
                if again is not None and self.merit(here) - self.merit(other) > max(gained, 0.0):
                    move, force, there = again[0], again[1], other
                    gained = self.merit(here) - self.merit(there)
            if there is None or gained < 0.1 * promised:
                size = 0.35 * min(size, float(np.max(np.abs(move))) + 1e-12)
                if there is not None and gained > 0.0:
                    curvature, x, here = self._bent(curvature, move, here, there, force), x + move, there
                if size < _SMALLEST:
                    break
                continue
            curvature = self._bent(curvature, move, here, there, force)
            if gained > 0.7 * promised and np.max(np.abs(move)) > 0.9 * size:
                size = min(2.0 * size, _LARGEST)
            x, here = x + move, there
            self.accepted(x, here)
            if gained < _ENOUGH:
                idle += 1
                curvature, size = _definite(here.curvature), max(size, _AGAIN)
                if idle > 2:
                    break
        return End(x, here, force, self.broken(here))

    def _curved(self, here: Evaluation, there: Evaluation, move: np.ndarray) -> dict[tuple[str, int, int], float]:
        """Return, by bound, how far the linear prediction of the slack after a move exceeds the actual slack."""
        after = dict(zip(there.bounds.keys, there.bounds.slack.tolist(), strict=True))
        columns = zip(here.bounds.keys, here.bounds.slack.tolist(), here.slopes, strict=True)
        return {key: slack + float(slope @ move) - after[key] for key, slack, slope in columns if key in after}

    def _step(
        self,
        x: np.ndarray,
        here: Evaluation,
        curvature: np.ndarray,
        size: float,
        lost: Mapping[tuple[str, int, int], float] | None = None,
    ) -> tuple[np.ndarray, dict[tuple[str, int, int], float], float] | None:
        """Return the move p, the multipliers by bound, and the predicted decrease of the merit.

            min  t + penalty e + ½ pᵀBp   subject to   t >= goal + slope p,   slack + slope p + e >= 0,   |p| <= size

        t is the worst goal and e the largest violation of a bound after the move; B is the curvature.
        """
        n = x.size
        worst = float(np.max(here.goal))
        bounds, slacks, slopes = here.bounds, here.slacks(self.sure), here.slopes
        H = np.zeros((n + 2, n + 2))
        H[:n, :n] = curvature
        # t and e enter linearly, but the solver needs a positive definite H
        H[n, n] = H[n + 1, n + 1] = _FLAT
        g = np.zeros(n + 2)
        g[n], g[n + 1] = 1.0, self.penalty
        points, many = here.goal.size, len(bounds)
        A = np.zeros((points + many + 1 + 2 * n, n + 2))
        b = np.zeros(A.shape[0])
        A[:points, :n], A[:points, n], b[:points] = -here.slope, 1.0, here.goal - worst
        of_bounds = slice(points, points + many)
        A[of_bounds, :n], A[of_bounds, n + 1], b[of_bounds] = slopes, 1.0, _ROOM - slacks
        if lost:
            b[of_bounds] += [lost.get(key, 0.0) for key in bounds.keys]
        A[points + many, n + 1] = 1.0
        low, high = np.maximum(-size, self.low - x), np.minimum(size, self.high - x)
        A[points + many + 1 : points + many + 1 + n, :n], b[points + many + 1 : points + many + 1 + n] = np.eye(n), low
        A[points + many + 1 + n :, :n], b[points + many + 1 + n :] = -np.eye(n), -high
        solved = least_quadratic(H, g, A, b)
        if solved is None:
            return None
        p, multipliers = solved
        # the bounds of the step hold only to rounding
        move = np.clip(p[:n], low, high)
        after = np.max(here.goal + here.slope @ move)
        left = float(np.max(_ROOM - slacks - slopes @ move)) if many else 0.0
        promised = float(self.merit(here) - after - self.penalty * max(left, 0.0) - 0.5 * move @ curvature @ move)
        forced = multipliers[of_bounds]
        force = {bounds.keys[i]: float(forced[i]) for i in np.flatnonzero(forced > 1e-6)}
        return move, force, promised

    def _bent(
        self,
        B: np.ndarray,
        move: np.ndarray,
        here: Evaluation,
        there: Evaluation,
        force: Mapping[tuple[str, int, int], float],
    ) -> np.ndarray:
        """Return the damped BFGS update of the Lagrangian's Hessian (Powell 1978)."""
        worst = int(np.argmax(there.goal))
        change = there.slope[worst] - here.slope[worst]
        before, after = (
            {key: slope for key, slope in zip(point.bounds.keys, point.slopes, strict=True) if key in force}
            for point in (here, there)
        )
        for key, weight in force.items():
            if key in before and key in after:
                change = change - weight * (after[key] - before[key])
        Bs = B @ move
        sBs = float(move @ Bs)
        if sBs < 1e-14:
            return B
        sy = float(move @ change)
        # Powell's constants: the update stays positive definite where the curvature along the step is negative
        if sy < 0.2 * sBs:
            part = 0.8 * sBs / (sBs - sy)
            change = part * change + (1.0 - part) * Bs
            sy = float(move @ change)
        return _definite(B - np.outer(Bs, Bs) / sBs + np.outer(change, change) / sy, 1e-3)


def _definite(H: np.ndarray, least: float = 0.05) -> np.ndarray:
    """Return the symmetric part of a matrix with its eigenvalues clipped to `least` .. 1e4."""
    values, vectors = np.linalg.eigh(0.5 * (H + H.T))
    return (vectors * np.clip(values, least, 1e4)) @ vectors.T


AGREE = 0.05  # of the goal: search results this close to the best confirm it


def unconfirmed(search: Search, ends: Sequence[End], kinds: Sequence[str]) -> str:
    """Return a sentence on the kinds of search that missed the best result by more than 5 %; empty if none did."""
    costs = [search.merit(end.judged) for end in ends]
    best = min(costs)
    texts: list[str] = []
    for kind, how in (("population", "from all over the range"), ("continuation", "by continuation in Ms")):
        of_kind = [(cost, end) for cost, end, k in zip(costs, ends, kinds, strict=True) if k == kind]
        cost, end = min(of_kind, key=lambda pair: pair[0], default=(np.inf, None))
        if cost - best < AGREE:
            continue
        if end is None or not np.isfinite(cost):
            texts.append(f"none {how}")
        # a merit with the penalty of exceeded bounds is no goal, and says nothing of how near the search was
        elif end.broken > _ROOM:
            texts.append(f"{how} outside of the bounds")
        else:
            texts.append(Text(f"{how} {Quantity(np.expm1(cost - best), 'share'):2} above the best"))
    return Text(f"searches ended {joined(' and ', texts)}") if texts else ""
