"""Proof of a tuning on machines that the tuner never saw: drawn from another stream of the study's seed.

The machines are drawn independently (Monte Carlo), whatever the study's sampler is, so that the number of good ones is
binomial and the interval of the yield holds.  Both controls are measured on the same machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.evaluation.engine import Engine
from feeddrive.figures.catalogue import limitable
from feeddrive.figures.figure import Figure, Limit
from feeddrive.figures.of_loops import COMPLIANCE_PEAK, STIFFNESS_LEAST
from feeddrive.language.progress import Progress
from feeddrive.loop.control import Control
from feeddrive.loop.runner import cores
from feeddrive.study.answers.shares import Share
from feeddrive.study.chunk import Chunk
from feeddrive.study.scenarios import with_control
from feeddrive.study.specification import Bound
from feeddrive.study.study import Study
from feeddrive.tuning.criteria import Limits

STREAM = 1  # of the seed; a study itself is stream 0


@dataclass(frozen=True, eq=False)
class Measured:
    """Fresh machines under one control: by figure the values, NaN where there is none, shape (n,)."""

    values: dict[str, np.ndarray]
    bounds: tuple[Bound, ...]
    figures: tuple[Figure, ...]

    @property
    def count(self) -> int:
        """The number of machines."""
        return len(next(iter(self.values.values())))

    def keeping(self, bound: Bound) -> Share:
        """The share of the machines that keep one bound."""
        return Share(int(np.sum(bound.kept(self.values[bound.figure.key]))), self.count)

    @property
    def good(self) -> np.ndarray:
        """True for the machines that keep all bounds, shape (n,)."""
        kept = [bound.kept(self.values[bound.figure.key]) for bound in self.bounds]
        return np.logical_and.reduce([np.ones(self.count, dtype=bool), *kept])

    @property
    def all(self) -> Share:
        """The yield: the share of the machines that keep all bounds."""
        return Share(int(np.sum(self.good)), self.count)

    def quantile(self, name: str, share: float) -> float:
        """Return a quantile of a figure over the machines that have it; NaN if none has."""
        values = self.values[name]
        values = values[~np.isnan(values)]
        return float(np.quantile(values, share)) if values.size else float("nan")


def measured(
    study: Study,
    control: Control,
    bounds: Sequence[Bound],
    also: Sequence[Figure],
    count: int,
    workers: int | None,
    progress: Progress,
) -> Measured:
    """The figures of `count` fresh machines of a study under a control."""
    wanted = {figure.key: figure for figure in (*(bound.figure for bound in bounds), *also)}
    fresh = replace(
        with_control(study, control),
        stream=STREAM,
        sampler="monte_carlo",
        points=count,
        count=count,
        chunk=max(16, min(256, -(-count // 8))),
        measure=tuple(wanted.values()),
    )
    chunks = [Chunk(fresh, number) for number in range(fresh.chunks)]
    rows = dict(Engine(workers or cores()).finished(chunks, progress))
    columns = {
        name: np.concatenate([rows[chunk].column(name).to_numpy() for chunk in chunks]).astype(np.float64)
        for name in wanted
    }
    return Measured(columns, tuple(bounds), tuple(wanted.values()))


def _limited(figure: Figure) -> tuple[Figure, bool]:
    """Return the figure of a study that a tuner's limit is about, and whether it is the inverse of the limited one."""
    return (STIFFNESS_LEAST, True) if figure == COMPLIANCE_PEAK else (figure, False)


def limits_of(study: Study, otherwise: Limits) -> Limits:
    """Return the limits of the tuner that a study's specification states; the others are those of `otherwise`.

    The least stiffness is the inverse of the largest compliance.  Figures of runs and others are not limits of the
    tuner, but the fresh machines are judged by them.
    """
    stated = {bound.figure: bound for bound in study.specification}
    limits: list[Limit] = []
    for limited in limitable():
        measurable, inverse = _limited(limited)
        bound = stated.get(measurable)
        value = None if bound is None else bound.least if measurable.higher else bound.most
        if value is not None and not _needs_noise(limited):
            limits.append(Limit(limited, 1.0 / value if inverse else value))
    return otherwise.having(*limits)


def _needs_noise(figure: Figure) -> bool:
    """Return True for a figure that follows from the noise of the readings, which a study takes from the encoders."""
    return figure.limit is not None and figure.limit.noise


def bounds_of(study: Study, limits: Limits) -> tuple[Bound, ...]:
    """The study's specification, and the tuner's limits as bounds of figures where it has none for them."""
    bounds = {bound.figure: bound for bound in study.specification}
    for limit in limits.limits:
        limited, inverse = _limited(limit.figure)
        if limited in bounds or _needs_noise(limit.figure):
            continue
        end = 1.0 / limit.bound if inverse else limit.bound
        bounds[limited] = Bound(limited, end if limited.higher else None, None if limited.higher else end)
    return tuple(bounds.values())


def is_limit(bound: Bound) -> bool:
    """Return True for a bound that the tuner can keep."""
    known = {limited for limited, _ in map(_limited, limitable()) if not _needs_noise(limited)}
    return bound.figure in known and (bound.least if bound.figure.higher else bound.most) is not None
