"""A random sample of the rows, for distributions, correlations and pictures: all of them up to a size."""

from __future__ import annotations

import numpy as np

from feeddrive.study.answers.judged import Judged, joined
from feeddrive.study.study import Study

MOST = 200_000  # rows; a quantile of so many is off by at most 0.4 % of the ranks in 99 of 100 samples


class Sampled:
    """Collects a random sample of the drawn machines: all, or about `MOST` of more, each with the same probability."""

    def __init__(self, study: Study) -> None:
        self._study = study
        drawn = 2 * study.points if study.sampler == "saltelli" else study.count
        self._share = min(1.0, MOST / drawn)
        self._parts: list[Judged] = []

    def add(self, rows: Judged) -> None:
        """Add a random part of some rows; the choice depends on the seed and the first variant of the rows only."""
        chosen = rows.drawn
        if self._share < 1.0 and chosen.any():
            rng = np.random.default_rng([self._study.seed, int(rows.variant[0])])
            chosen = chosen & (rng.random(chosen.size) < self._share)
        if chosen.any() or not self._parts:
            self._parts.append(rows.some(chosen))

    def result(self) -> Judged:
        """The sample; there was at least one part."""
        return joined(self._parts)
