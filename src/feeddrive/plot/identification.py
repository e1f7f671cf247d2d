"""Pictures of identified drives: fits over measurements, residuals and cogging."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.language.quantity import DRAWN, Quantity, Units, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style
from feeddrive.plot.chart import DOTS, NEUTRAL, THIN, Chart, Curve, Panel
from feeddrive.plot.drawing import drawn
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feeddrive.identification.cogging import CoggingFit, CoggingRun
    from feeddrive.identification.motion.control_law import ControlFit
    from feeddrive.identification.motion.delay import DelayFit
    from feeddrive.identification.motion.identify import Identified
    from feeddrive.identification.motion.rigid import RigidFit
    from feeddrive.identification.regression import Residuals, Validation

_LAGS = 40  # of an autocorrelation


def rigid_fit(fit: RigidFit) -> Any:
    """Measured and fitted force over time, and the residual."""
    return drawn(rigid_fit_chart(fit))


def rigid_fit_chart(fit: RigidFit, units: Units = DRAWN) -> Chart:
    """Measured and fitted force over time, and the residual."""
    unit, newton = unit_name(fit.frame.force), units.of(fit.frame.force)[1]
    measured, off = newton * fit.residuals.measured, newton * fit.residuals.values
    forces = (
        Curve(*envelope(fit.time, measured), "measured", NEUTRAL, DOTS),
        Curve(*envelope(fit.time, measured - off), "fitted", 0),
    )
    said = Text(f"{Quantity(fit.residuals.relative, 'share'):3} of the force's RMS")
    left = Curve(*envelope(fit.time, off), "residual", 1, THIN, said=said)
    panels = Panel(f"force ({unit})", forces, share=2.0), Panel(f"residual ({unit})", (left,))
    return Chart("time (s)", panels, low=float(fit.time[0]), high=float(fit.time[-1]), height=3.8)


def identified_chart(found: Identified, units: Units = DRAWN) -> Chart:
    """The model over the log: the loop in a simulation of the same reference if its law is known, else the force."""
    if found.refinement is None:
        return rigid_fit_chart(found.rigid, units)
    replay = found.refinement.replay
    time, after = replay.run.time, replay.run.time[replay.skipped :]
    panels = list[Panel]()
    for name, words, unit in (("following_error", "following error", "m"), ("force", "force", "N")):
        if name not in replay.measured:
            continue
        off, factor = replay.residual(name), units.of(unit)[1]
        rms, peak = (Quantity(size, unit) for size in (np.sqrt(np.mean(off**2)), np.max(np.abs(off))))
        said = Text(f"RMS {rms}, peak {peak}")
        both = (
            Curve(*envelope(time, factor * replay.measured[name]), "" if panels else "measured", NEUTRAL, DOTS),
            Curve(*envelope(time, factor * replay.run[name]), "" if panels else "model", 0),
        )
        left = Curve(*envelope(after, factor * off), f"residual of the {words}", 1, THIN, said=said)
        label = unit_name(unit)
        panels += [Panel(f"{words} ({label})", both, share=2.0), Panel(f"residual ({label})", (left,), share=1.2)]
    return Chart("time (s)", tuple(panels), low=float(time[0]), high=float(time[-1]), height=5.4)


def residuals(found: Residuals) -> Any:
    """Residual by row, and its autocorrelation with the bounds of a white one."""
    figure, axes = style.picture(2, height=3.8, share=False)
    axes[0].plot(*envelope(np.arange(found.values.size), found.values), **style.curve(1) | {"linestyle": "-"})
    style.labels(axes[0], "row", f"residual ({unit_name(found.unit, 'SI')})")
    lags = np.arange(1, min(_LAGS, found.values.size // 4) + 1)
    rho = [found.autocorrelation(int(lag)) for lag in lags]
    bound = 1.96 / np.sqrt(found.values.size)
    axes[1].bar(lags, rho, width=0.6, color=style.color(0))
    for level in (-bound, bound):
        axes[1].axhline(level, color=style.MUTED, linewidth=1.0, linestyle=(0, (4, 3)))
    style.labels(axes[1], "lag (rows)", "autocorrelation")
    style.note(axes[1], "dashed: 95 % of white residuals")
    figure.align_ylabels(axes)
    return figure


def validation(found: Validation) -> Any:
    """Error of each stretch with a fit to the others."""
    figure, (ax,) = style.picture(1, height=2.6)
    ax.bar(np.arange(1, found.errors.size + 1), 100.0 * found.errors, width=0.5, color=style.color(0))
    ax.set_xlim(0.4, found.errors.size + 0.6)
    style.labels(ax, "stretch that was left out", "error (%)")
    return figure


def delay_fit(found: DelayFit) -> Any:
    """Residual over the delay that was tried."""
    figure, (ax,) = style.picture(1, height=2.8)
    near = np.abs(found.delays - found.nearest) <= 6
    ax.plot(found.delays[near], 100.0 * found.residual[near], "o-", markersize=4.0, color=style.color(0), linewidth=1.0)
    ax.axvline(found.dead_time, color=style.color(1), linewidth=1.0)
    style.labels(ax, "dead time (samples, besides the hold)", "residual (%)")
    style.note(ax, Text(f"{Quantity(found.dead_time):.2f} ± {Quantity(found.error):.2f} samples"))
    ax.margins(x=0.03)
    return figure


def control_fit(found: ControlFit) -> Any:
    """Unexplained share of the force, for each law that was tried, by its delay."""
    figure, (ax,) = style.picture(1, height=2.8)
    for i, delay in enumerate(sorted({d for _, d in found.tried})):
        samples = [n for n, d in found.tried if d == delay]
        left = [100.0 * found.tried[n, delay] for n in samples]
        ax.plot(samples, left, marker="o", markersize=4.0, label=f"delay {delay}", **style.curve(i))
    ax.set_yscale("log")
    style.plain_decades(ax.yaxis)
    style.labels(ax, "samples over which the velocity is differenced", "unexplained share of the force (%)")
    style.legend(figure, ax)
    return figure


def cogging(fit: CoggingFit) -> Any:
    """Amplitudes by order, with twice their standard errors: cogging, and the part that changes sign with direction."""
    figure, (ax,) = style.picture(1, height=3.2)
    kinds = {"cogging": "even", "changes sign with the direction": "odd"}
    if fit.orders and fit.orders[0].even is None:
        kinds = {"as measured": "forward" if fit.orders[0].forward is not None else "backward"}
    for i, (label, field) in enumerate(kinds.items()):
        shown = [(each.order, getattr(each, field)) for each in fit.significant]
        orders = np.array([order for order, _ in shown]) + 0.4 * (i - 0.5 * (len(kinds) - 1))
        ax.errorbar(
            orders, [e.value for _, e in shown], [2.0 * e.error for _, e in shown], fmt=style.MARKERS[i],
            markersize=4.0, color=style.color(i), ecolor=style.MUTED, elinewidth=0.9, label=label,
        )  # fmt: skip
    ax.set_yscale("log")
    style.plain_decades(ax.yaxis)
    ax.margins(x=0.03)
    style.labels(ax, "order", f"amplitude ({unit_name(fit.unit, 'SI')})")
    style.legend(figure, ax)
    return figure


def cogging_over_turn(fit: CoggingFit, runs: Sequence[CoggingRun]) -> Any:
    """Measured force over one period by direction, and the cogging in it."""
    figure, (ax,) = style.picture(1, height=3.4)
    for i, (sign, label) in enumerate(((1, "forward"), (-1, "backward"))):
        for run in (each for each in runs if each.direction == sign):
            order = np.argsort(np.mod(run.turns, 1.0))
            x, y = envelope(np.mod(run.turns, 1.0)[order], run.force[order])
            ax.plot(x, y, ".", markersize=2.0, color=style.color(i + 1), alpha=0.5, label=label)
            label = None
    both = fit.coulomb is not None
    x = np.linspace(0.0, 1.0, 2001)
    y = np.full(x.size, fit.offset.value)
    for each in fit.significant:
        found = each.even if each.even is not None else each.forward or each.backward
        assert found is not None
        y += found.value * np.sin(2.0 * np.pi * each.order * x + (each.even_phase if both else each.phase))
    ax.plot(x, y, label="cogging and offset" if both else "significant orders", **style.curve(0))
    style.labels(ax, "position (periods)", f"force ({unit_name(fit.unit, 'SI')})")
    style.legend(figure, ax)
    return figure


def identified(found: Identified) -> Any:
    """The model over the log."""
    return drawn(identified_chart(found))
