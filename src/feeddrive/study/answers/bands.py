"""Quantile bands: dynamic stiffness of the machines over frequency, and their following error over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feeddrive.figures.of_loops import StiffnessAt
from feeddrive.language.errors import CancelledError, FeeddriveError
from feeddrive.language.progress import Progress
from feeddrive.loop.simulate import Run
from feeddrive.study.answers.judged import Judged
from feeddrive.study.chunk import run_of
from feeddrive.study.study import Study
from feeddrive.study.variant_groups import variant_groups
from feeddrive.study.variants import variants

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
_LEAST_LINES = 3  # frequencies that make a band
_RUNS, _FEWEST, _SAMPLES = 128, 16, 2e7  # machines that are run again, and their samples in all
_WINDOWS = 500


@dataclass(frozen=True, eq=False)
class Band:
    """Quantiles over machines, of shape (5, n), over x of shape (n,): frequency in Hz, or the middle of windows in s.

    machines  number of machines
    unit      SI
    """

    x: np.ndarray
    quantiles: np.ndarray
    unit: str
    machines: int

    def at(self, quantile: float) -> np.ndarray:
        """One of `QUANTILES`, shape (n,)."""
        return self.quantiles[QUANTILES.index(quantile)]


def stiffness_band(sample: Judged) -> Band | None:
    """The band of the figures stiffness_F_Hz_N_per_m; None for a study that measures fewer than three of them."""
    lines = {figure.of.frequency: figure.key for figure in sample.study.measure if isinstance(figure.of, StiffnessAt)}
    if len(lines) < _LEAST_LINES or sample.bad.all():
        return None
    frequency = np.array(sorted(lines))
    values = np.stack([sample.figures[lines[line]][~sample.bad] for line in frequency.tolist()], axis=1)
    return Band(frequency, np.nanquantile(values, QUANTILES, axis=0), "N/m", len(values))


def error_band(sample: Judged, progress: Progress | None = None) -> Band | None:
    """The largest absolute following error in each of 500 windows of time, of up to 128 machines that are run again.

    The machines are drawn at random from those with figures; motions of unequal length are cut to the shortest one.
    None where no machine can be run.
    """
    study, progress = sample.study, progress or Progress()
    good = sample.variant[~sample.bad]
    rng = np.random.default_rng([study.seed, 1])
    order = rng.permutation(good)[:_RUNS].tolist()
    errors: list[np.ndarray] = []
    times: list[np.ndarray] = []
    most = _RUNS
    for done, variant in enumerate(order):
        if done >= most:
            break
        progress.step("following error over time", done, min(most, len(order)))
        run = _run(study, variant)
        if run is None:
            continue
        most = max(_FEWEST, min(_RUNS, int(_SAMPLES / run.samples)))
        width = -(-run.samples // _WINDOWS)
        edges = np.arange(0, run.samples, width)
        errors.append(np.maximum.reduceat(np.abs(run["following_error"]), edges))
        times.append(run.time[0] + (edges + 0.5 * width) * run.sample_time)
    if not errors:
        return None
    shortest = min(range(len(times)), key=lambda i: float(times[i][-1]))
    x = times[shortest]
    rows = [np.interp(x, time, error) for time, error in zip(times, errors, strict=True)]
    return Band(x, np.quantile(rows, QUANTILES, axis=0), "m", len(rows))


def _run(study: Study, variant: int) -> Run | None:
    """Simulate a variant; None if it cannot be run."""
    try:
        group = next(variant_groups(study, variants(study, variant, 1)))
        return run_of(group, 0)
    except CancelledError:
        raise
    except FeeddriveError:
        return None
