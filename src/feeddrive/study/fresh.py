"""Proof of a tuning on machines that the tuner never saw: drawn from another stream of the study's seed.

The machines are drawn independently (Monte Carlo), whatever the study's sampler is, so that the number of good ones is
binomial and the interval of the yield holds.  Both controls are measured on the same machines.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.language.progress import Progress
from feeddrive.loop.control import Control
from feeddrive.loop.runner import cores
from feeddrive.study.answers.shares import Share
from feeddrive.study.figure import Figure
from feeddrive.study.figures import figure
from feeddrive.study.pool import finished
from feeddrive.study.scenarios import with_control
from feeddrive.study.specification import Bound
from feeddrive.study.study import Study
from feeddrive.tuning.limits import Limits

STREAM = 1  # of the seed; a study itself is stream 0


@dataclass(frozen=True, eq=False)
class Measured:
    """Fresh machines under one control: by figure the values, NaN where there is none, shape (n,)."""

    values: dict[str, np.ndarray]
    bounds: tuple[Bound, ...]
    figures: tuple[Figure, ...]

    @property
    def count(self) -> int:
        """How many machines."""
        return len(next(iter(self.values.values())))

    def keeping(self, bound: Bound) -> Share:
        """Those that keep one bound."""
        return Share(int(np.sum(bound.kept(self.values[bound.figure.name]))), self.count)

    @property
    def good(self) -> np.ndarray:
        """Which keep all bounds, shape (n,)."""
        kept = [bound.kept(self.values[bound.figure.name]) for bound in self.bounds]
        return np.logical_and.reduce([np.ones(self.count, dtype=bool), *kept])

    @property
    def all(self) -> Share:
        """Those that keep all bounds: the yield."""
        return Share(int(np.sum(self.good)), self.count)

    def quantile(self, name: str, share: float) -> float:
        """Of a figure, over the machines that have one; NaN if none has."""
        values = self.values[name]
        values = values[~np.isnan(values)]
        return float(np.quantile(values, share)) if values.size else float("nan")


def measured(
    study: Study, control: Control, bounds: Sequence[Bound], also: Sequence[Figure], count: int,
    workers: int | None, progress: Progress,
) -> Measured:  # fmt: skip
    """The figures of `count` fresh machines of a study under a control."""
    wanted = {each.name: each for each in (*(bound.figure for bound in bounds), *also)}
    fresh = replace(
        with_control(study, control), stream=STREAM, sampler="monte_carlo", points=count, count=count,
        chunk=max(16, min(256, -(-count // 8))), measure=tuple(wanted.values()),
    )  # fmt: skip
    parts = dict(finished(fresh, range(fresh.chunks), workers or cores(), progress))
    columns = {
        name: np.concatenate([parts[i].column(name).to_numpy() for i in range(fresh.chunks)]).astype(np.float64)
        for name in wanted
    }
    return Measured(columns, tuple(bounds), tuple(wanted.values()))


# figure of a study, field of the tuner's limits, whether the figure's least is bounded, from one to the other
_SAME = (
    ("sensitivity_peak", "sensitivity_peak", False),
    ("gain_margin_dB", "gain_margin_dB", True),
    ("phase_margin_deg", "phase_margin_deg", True),
    ("delay_margin_samples", "delay_margin_samples", True),
    ("stiffness_least_N_per_m", "compliance_peak", True),
)


def limits_of(study: Study, otherwise: Limits) -> Limits:
    """What the tuner can keep of a study's specification; where that is silent the limits that are given.

    The least stiffness is the inverse of the largest compliance.  Figures of runs and others are not limits of the
    tuner, but the fresh machines are judged by them.
    """
    stated = {bound.figure.name: bound for bound in study.specification}
    found: dict[str, float] = {}
    for name, field, least in _SAME:
        bound = stated.get(name)
        value = None if bound is None else bound.least if least else bound.most
        if value is not None:
            found[field] = 1.0 / value if field == "compliance_peak" else value
    return replace(otherwise, **found)


def bounds_of(study: Study, limits: Limits) -> tuple[Bound, ...]:
    """The study's specification, and the tuner's limits as bounds of figures where it has none for them."""
    found = {bound.figure.name: bound for bound in study.specification}
    for name, field, least in _SAME:
        value = getattr(limits, field)
        if value is None or name in found:
            continue
        end = 1.0 / value if field == "compliance_peak" else value
        found[name] = Bound(figure(name), end if least else None, None if least else end)
    return tuple(found.values())


def is_limit(bound: Bound) -> bool:
    """Whether a bound is one that the tuner keeps."""
    return any(
        bound.figure.name == name and (bound.least if least else bound.most) is not None for name, _, least in _SAME
    )
