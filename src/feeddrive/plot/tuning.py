"""Plots of tuning and learning: dead time against gain, trials, a prefilter, the estimate of an observer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language import tree
from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style
from feeddrive.plot.style import POINTS, envelope

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from feeddrive.analysis.replay import Observation
    from feeddrive.learning.iterative_feedforward import Iteration
    from feeddrive.learning.trajectory_prefilter import PrefilterFit
    from feeddrive.learning.trial import Trial
    from feeddrive.learning.trials import Trials
    from feeddrive.tuning.delay_map import DelayMap

_WORDS = {
    "mass": "mass", "viscous": "viscous", "coulomb_positive": "Coulomb +", "coulomb_negative": "Coulomb -",
    "stribeck": "Stribeck", "jerk_feedforward": "jerk", "snap_feedforward": "snap",
}  # fmt: skip


def trial(trial: Trial) -> Any:
    """Following error over set velocity."""
    figure, axes = style.picture(2, height=3.6, ratios=(2, 1))
    axes[0].plot(*envelope(trial.time, 1e6 * trial.following_error), **style.curve(0))
    style.labels(axes[0], None, f"following error\n({unit_name('um')})")
    style.note(axes[0], Text(f"RMS {Quantity(trial.rms, 'm')}, peak {Quantity(trial.peak, 'm')}"))
    _velocity(axes[1], trial)
    figure.align_ylabels(axes)
    return figure


def iteration(iteration: Iteration) -> Any:
    """The error of the trial, and below it the error predicted for the next trial with the same reference."""
    figure, axes = style.picture(2, height=3.8, ratios=(2, 1))
    time = iteration.trial.time
    before = style.read(f"this trial, RMS {Quantity(iteration.trial.rms, 'm')}")
    after = style.read(f"predicted for the next, RMS {Quantity(iteration.predicted_rms, 'm')}")
    axes[0].plot(*envelope(time, 1e6 * iteration.trial.following_error), label=before, **style.curve(0))
    axes[0].plot(*envelope(time, 1e6 * iteration.predicted), label=after, **style.curve(1) | {"linestyle": "-"})
    style.labels(axes[0], None, f"following error\n({unit_name('um')})")
    _velocity(axes[1], iteration.trial)
    figure.align_ylabels(axes)
    style.legend(figure, axes[0])
    return figure


def trials(trials: Trials) -> Any:
    """RMS of the error over the trials on a logarithmic scale, and each parameter with its standard error."""
    return errors_and_parameters({"": trials})


def errors_and_parameters(named: Mapping[str, Trials]) -> Any:
    """The same for several sets of trials, each a curve; parameters are those of the last set."""
    last = list(named.values())[-1]
    values, errors = last.parameters(), last.errors()
    rows = -(-len(values) // 2)
    figure, _ = style.picture(1, height=2.6 + 1.35 * rows)
    figure.clear()
    grid = figure.add_gridspec(rows + 1, 2, height_ratios=[1.8, *[1.0] * rows])
    top = style.dressed(figure.add_subplot(grid[0, :]))
    most = 0
    for i, (name, each) in enumerate(named.items()):
        numbers = np.arange(1, len(each.trials) + 1)
        most = max(most, numbers.size)
        top.plot(
            numbers, 1e6 * each.rms, marker=style.MARKERS[i % len(style.MARKERS)], markersize=4.5,
            label=style.caption(name), **style.curve(i),
        )  # fmt: skip
    top.set_yscale("log")
    style.plain_decades(top.yaxis)
    style.labels(top, None, f"following error\nRMS ({unit_name('um')})")
    axes = [top]
    for i, (name, row) in enumerate(values.items()):
        ax = style.dressed(figure.add_subplot(grid[1 + i // 2, i % 2]))
        numbers = np.arange(1, row.size + 1)
        sigma = np.where(np.isnan(errors[name]), 0.0, errors[name])
        ax.errorbar(
            numbers, row, 2.0 * sigma, fmt="o-", markersize=3.5, color=style.color(i), ecolor=style.MUTED,
            elinewidth=0.9, capsize=2.5, linewidth=1.0,
        )  # fmt: skip
        unit = style.written(tree.declaration(last.iterations[0].before, name).unit)
        style.labels(
            ax, "trial" if i // 2 == rows - 1 else None, f"{_WORDS.get(name, name)}\n({unit_name(unit, 'SI')})"
        )
        axes.append(ax)
    for ax in axes:
        ax.set_xlim(0.7, max(most, 2) + 0.3)
        ax.set_xticks(range(1, max(most, 2) + 1))
    figure.align_ylabels(axes)
    style.legend(figure, top, columns=3)
    return figure


def _velocity(ax: Any, trial: Trial) -> None:
    ax.plot(*envelope(trial.time, 1e3 * np.asarray(trial.setpoint.velocity)), color=style.INK, linewidth=1.0)
    style.labels(ax, "time (s)", f"set velocity\n({unit_name('m/s')})")


def prefilter_fit(fit: PrefilterFit, points: int = POINTS) -> Any:
    """Above: the error and the part explained by the derivatives. Below: the predicted error."""
    figure, axes = style.picture(2, height=4.2)
    measured = {"color": style.MUTED, "linewidth": 2.6, "alpha": 0.55}
    axes[0].plot(*envelope(fit.time, 1e6 * fit.error, points), **measured, label="error")
    axes[0].plot(*envelope(fit.time, 1e6 * fit.explained, points), **style.curve(0), label="explained")
    axes[1].plot(*envelope(fit.time, 1e6 * fit.predicted, points), **style.curve(1) | {"linestyle": "-"})
    size = 1.1e6 * float(np.max(np.abs(fit.error), initial=1e-12))
    for ax in axes:
        ax.set_ylim(-size, size)
    style.labels(axes[0], None, f"tracking error\n({unit_name('um')})")
    style.labels(axes[1], "time (s)", f"predicted with\nthe prefilter ({unit_name('um')})")
    style.note(axes[1], Text(f"RMS {Quantity(fit.rms(fit.error), 'm')} -> {Quantity(fit.rms(fit.predicted), 'm')}"))
    style.legend(figure, axes[0])
    return figure


def disturbance(
    observations: Observation | Mapping[str, Observation],
    true: np.ndarray | None = None,
    window: tuple[float, float] | None = None,
) -> Any:
    """Estimated disturbances over time in ms, with the true one in gray; `window` is begin and end in s."""
    chosen = style.named(observations)
    figure, (ax,) = style.picture(1, height=3.2)
    first = next(iter(chosen.values()))
    low, high = window or (float(first.time[0]), float(first.time[-1]))
    shown = (first.time >= low) & (first.time <= high)
    if true is not None:
        ax.step(1e3 * first.time[shown], true[shown], where="post", color=style.MUTED, linewidth=2.4, alpha=0.55,
                label="true")  # fmt: skip
    for i, (name, found) in enumerate(chosen.items()):
        ax.plot(1e3 * found.time[shown], found.disturbance[shown], label=style.caption(name), **style.curve(i))
    style.labels(ax, "time (ms)", f"disturbance ({unit_name('N')})")
    style.legend(figure, ax)
    return figure


def delay_map(maps: DelayMap | Mapping[str, DelayMap]) -> Any:
    """The first tunable at the limit of stability and where Ms reaches its bound, over the dead time in samples."""
    chosen = style.named(maps)
    figure, (ax,) = style.picture(1, height=3.2)
    for i, (name, found) in enumerate(chosen.items()):
        tunable = next(iter(found.tunables))
        samples = found.dead_time / found.sample_time
        edge, robust = found.at_edge(tunable), found.at_robust(tunable)
        mark = style.MARKERS[i % len(style.MARKERS)]
        before = f"{name}: " if name else ""
        ax.plot(samples, edge, mark + "-", color=style.color(i), linewidth=style.LINE, label=f"{before}unstable above")
        ax.plot(samples, robust, mark + "--", color=style.color(i), linewidth=style.LINE,
                label=style.read(f"{before}Ms = {Quantity(found.sensitivity_bound)}"))  # fmt: skip
        ax.fill_between(samples, 0.0, robust, color=style.color(i), alpha=0.08, linewidth=0.0)
        style.labels(ax, "dead time (samples)", f"{tunable.rpartition('.')[2].replace('_', ' ')} (1/s)")
    ax.set_ylim(bottom=0.0)
    style.legend(figure, ax, 2)
    return figure


def in_time(rows: Sequence[tuple[str, str, Mapping[str, tuple[np.ndarray, np.ndarray]]]]) -> Any:
    """Rows of curves by name, each over times of its own: abscissa, ordinate, and (times, values) of each curve."""
    figure, axes = style.picture(len(rows), height=1.0 + 2.1 * len(rows), share=False)
    for ax, (abscissa, ordinate, curves) in zip(axes, rows, strict=True):
        for i, (name, (time, values)) in enumerate(curves.items()):
            ax.plot(*envelope(time, values), label=style.caption(name), **style.curve(i))
        ax.set_xlim(*(float(next(iter(curves.values()))[0][k]) for k in (0, -1)))
        style.labels(ax, abscissa, ordinate)
    style.legend(figure, axes[0])
    figure.align_ylabels(axes)
    return figure
