"""Pictures of identified drives: fits over measurements, residuals and cogging."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from feeddrive.language.quantity import DRAWN, Quantity, Units, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import style
from feeddrive.plot.chart import (
    DOTS,
    LOG,
    MARKED,
    MARKERS,
    NEUTRAL,
    PLAIN,
    THIN,
    Abscissa,
    Box,
    Chart,
    Curve,
    Level,
    Panel,
    numbered,
    rods,
)
from feeddrive.plot.drawing import figure_of
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
_CUT = 0.3  # of an amplitude: a bar of errors that reaches below is cut off there on the logarithmic scale


def rigid_fit_chart(fit: RigidFit, units: Units = DRAWN) -> Chart:
    """Measured and fitted force over time, and the residual."""
    unit, newton = unit_name(fit.frame.force), units.of(fit.frame.force)[1]
    measured, off = newton * fit.residuals.measured, newton * fit.residuals.values
    forces = (
        Curve(*envelope(fit.time, measured), "measured", NEUTRAL, DOTS),
        Curve(*envelope(fit.time, measured - off), "fitted", 0),
    )
    caption = Text(f"{Quantity(fit.residuals.relative, 'share'):3} of the force's RMS")
    left = Curve(*envelope(fit.time, off), "residual", 1, THIN, caption=caption)
    panels = Panel(f"force ({unit})", forces, share=2.0), Panel(f"residual ({unit})", (left,))
    return Chart("time (s)", panels, low=float(fit.time[0]), high=float(fit.time[-1]), height=3.8)


rigid_fit = figure_of(rigid_fit_chart)


def identified_chart(identified: Identified, units: Units = DRAWN) -> Chart:
    """The model over the log: the loop in a simulation of the same reference if its law is known, else the force."""
    if identified.refinement is None:
        return rigid_fit_chart(identified.rigid, units)
    replay = identified.refinement.replay
    time, after = replay.run.time, replay.run.time[replay.skipped :]
    panels = list[Panel]()
    for name, words, unit in (("following_error", "following error", "m"), ("force", "force", "N")):
        if name not in replay.measured:
            continue
        off, factor = replay.residual(name), units.of(unit)[1]
        rms, peak = (Quantity(size, unit) for size in (np.sqrt(np.mean(off**2)), np.max(np.abs(off))))
        caption = Text(f"RMS {rms}, peak {peak}")
        both = (
            Curve(*envelope(time, factor * replay.measured[name]), "" if panels else "measured", NEUTRAL, DOTS),
            Curve(*envelope(time, factor * replay.run[name]), "" if panels else "model", 0),
        )
        left = Curve(*envelope(after, factor * off), f"residual of the {words}", 1, THIN, caption=caption)
        label = unit_name(unit)
        panels += [Panel(f"{words} ({label})", both, share=2.0), Panel(f"residual ({label})", (left,), share=1.2)]
    return Chart("time (s)", tuple(panels), low=float(time[0]), high=float(time[-1]), height=5.4)


def residuals_chart(residuals: Residuals) -> Chart:
    """Residual by row, and its autocorrelation with the bounds of a white one."""
    off = Curve(*envelope(np.arange(residuals.values.size, dtype=np.float64), residuals.values), number=1, look=PLAIN)
    lags = np.arange(1, min(_LAGS, residuals.values.size // 4) + 1)
    rho = [residuals.autocorrelation(int(lag)) for lag in lags]
    bound = 1.96 / np.sqrt(residuals.values.size)
    boxes = tuple(
        Box(float(lag) - 0.3, float(lag) + 0.3, min(0.0, r), max(0.0, r)) for lag, r in zip(lags, rho, strict=True)
    )
    panels = (
        Panel(f"residual ({unit_name(residuals.unit, 'SI')})", (off,), abscissa=Abscissa("row")),
        Panel(
            "autocorrelation",
            boxes=boxes,
            levels=(Level(-bound, dashed=True), Level(bound, dashed=True)),
            caption="dashed: 95 % of white residuals",
            abscissa=Abscissa("lag (rows)", low=0.0, high=float(lags[-1]) + 1.0 if lags.size else 1.0),
        ),
    )
    return Chart("", panels, height=3.8)


residuals = figure_of(residuals_chart)


def validation_chart(validation: Validation) -> Chart:
    """Error of each stretch with a fit to the others."""
    numbers = range(1, validation.errors.size + 1)
    boxes = tuple(
        Box(n - 0.25, n + 0.25, 0.0, 100.0 * float(e)) for n, e in zip(numbers, validation.errors, strict=True)
    )
    panel = Panel("error (%)", boxes=boxes, low=0.0)
    return Chart(
        "stretch that was left out",
        (panel,),
        low=0.4,
        high=validation.errors.size + 0.6,
        ticks=numbered(numbers),
        height=2.6,
    )


validation = figure_of(validation_chart)


def delay_fit_chart(fit: DelayFit) -> Chart:
    """Residual over the delay that was tried."""
    near = np.abs(fit.delays - fit.nearest) <= 6
    delays = fit.delays[near]
    panel = Panel(
        "residual (%)",
        (Curve(delays, 100.0 * fit.residual[near], look=MARKED, size=0.9),),
        levels=(Level(fit.dead_time, upright=True, number=1),),
        caption=Text(f"{Quantity(fit.dead_time):.2f} ± {Quantity(fit.error):.2f} samples"),
    )
    low, high = style.padded(float(np.min(delays)), float(np.max(delays)), 0.03)
    return Chart("dead time (samples, besides the hold)", (panel,), low=low, high=high, height=2.8)


delay_fit = figure_of(delay_fit_chart)


def control_fit_chart(fit: ControlFit) -> Chart:
    """Unexplained share of the force, for each law that was tried, by its delay."""
    curves = list[Curve]()
    for i, delay in enumerate(sorted({d for _, d in fit.tried})):
        samples = [n for n, d in fit.tried if d == delay]
        left = [100.0 * fit.tried[n, delay] for n in samples]
        curves.append(Curve(np.array(samples, float), np.array(left), f"delay {delay}", i, MARKED, size=0.9))
    panel = Panel("unexplained share of the force (%)", tuple(curves), scale=LOG)
    return Chart("samples over which the velocity is differenced", (panel,), height=2.8)


control_fit = figure_of(control_fit_chart)


def cogging_chart(fit: CoggingFit) -> Chart:
    """Amplitudes by order, with twice their standard errors: cogging, and the part that changes sign with direction."""
    kinds = {"cogging": "even", "changes sign with the direction": "odd"}
    if fit.orders and fit.orders[0].even is None:
        kinds = {"as measured": "forward" if fit.orders[0].forward is not None else "backward"}
    bars, points = list[Curve](), list[Curve]()
    for i, (label, field) in enumerate(kinds.items()):
        shown = [(order.order, getattr(order, field)) for order in fit.significant]
        x = np.array([order for order, _ in shown], float) + 0.4 * (i - 0.5 * (len(kinds) - 1))
        value, error = (np.array([getattr(estimate, part) for _, estimate in shown]) for part in ("value", "error"))
        bars.append(
            Curve(
                *rods(x, np.maximum(value - 2.0 * error, _CUT * value), value + 2.0 * error),
                number=NEUTRAL,
                look=THIN,
                size=1.5,
            )
        )
        points.append(Curve(x, value, label, i, MARKERS, size=0.9))
    x = np.concatenate([curve.x for curve in points])
    low, high = style.padded(float(np.min(x)), float(np.max(x)), 0.03) if x.size else (0.0, 1.0)
    panel = Panel(f"amplitude ({unit_name(fit.unit, 'SI')})", (*bars, *points), scale=LOG)
    return Chart("order", (panel,), low=low, high=high, height=3.2)


cogging = figure_of(cogging_chart)


def cogging_over_turn_chart(fit: CoggingFit, runs: Sequence[CoggingRun]) -> Chart:
    """Measured force over one period by direction, and the cogging in it."""
    curves = list[Curve]()
    for i, (sign, label) in enumerate(((1, "forward"), (-1, "backward"))):
        for run in (run for run in runs if run.direction == sign):
            order = np.argsort(np.mod(run.turns, 1.0))
            x, y = envelope(np.mod(run.turns, 1.0)[order], run.force[order])
            curves.append(Curve(x, y, label, i + 1, DOTS, size=0.7))
    both = fit.coulomb is not None
    x = np.linspace(0.0, 1.0, 2001)
    y = np.full(x.size, fit.offset.value)
    for order in fit.significant:
        estimate = order.even if order.even is not None else order.forward or order.backward
        assert estimate is not None
        y += estimate.value * np.sin(2.0 * np.pi * order.order * x + (order.even_phase if both else order.phase))
    curves.append(Curve(x, y, "cogging and offset" if both else "significant orders"))
    panel = Panel(f"force ({unit_name(fit.unit, 'SI')})", tuple(curves))
    return Chart("position (periods)", (panel,), height=3.4)


cogging_over_turn = figure_of(cogging_over_turn_chart)
