"""Pictures of identified drives: friction curves, fits compared with measurements, residuals and cogging."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.identification.regression import NORMAL
from feeddrive.language.quantity import DRAWN, Quantity, Units, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import chart, style
from feeddrive.plot.chart import Abscissa, Band, Box, Chart, Curve, Level, Panel, Tick
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import envelope

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feeddrive.analysis.friction_map import FrictionMap
    from feeddrive.blocks.families import Friction
    from feeddrive.identification.cogging import CoggingFit, CoggingRun
    from feeddrive.identification.friction_curve import FrictionCurve, SteadyRuns
    from feeddrive.identification.motion.identify import Identified
    from feeddrive.identification.motion.identify_law import ControlFit
    from feeddrive.identification.motion.pooled import PooledFit
    from feeddrive.identification.motion.rigid import DelayFit, RigidFit
    from feeddrive.identification.regression import Residuals, Validation
    from feeddrive.loop.loop import Loop
    from feeddrive.loop.simulate import Run


CELLS = 160  # raster of the picture: of the points in a cell only one is drawn
_MET, _ALL = 5, "model with the viscous friction of the plant"
_SLOWEST = 1e-5  # of the largest velocity: lowest speed of the curves on both sides of standstill
_ZERO = Level(0.0, faint=True), Level(0.0, upright=True, faint=True)


def friction_chart(
    loops: Loop | Mapping[str, Loop],
    run: Run | None = None,
    measured: FrictionMap | None = None,
    units: Units = DRAWN,
) -> Chart:
    """Plot the friction force versus velocity in both directions, with a measured map and the residual of the model.

    Loops with equal friction share one curve. `run` adds the friction during a run of the first loop.
    """
    chosen = style.named(loops)
    reach, newton = _reach(run, measured), units.of("N")[1]
    curves = list[Curve]()
    first = next(iter(chosen.values()), None)
    if run is not None and first is not None:
        curves += _met(first, run, newton)
    for i, (name, block) in enumerate(_different(chosen).items()):
        v, force = _both(lambda v, block=block: _steady((block,), v), reach)
        curves.append(Curve(1e3 * v, newton * force, name, i))
    left = list[Curve]()
    if measured is not None:
        curves += _measured(
            measured.velocity, measured.force, measured.deviation, newton, "measured, mean and deviation"
        )
        if first is not None:
            curves += _whole(first, reach, newton, len(curves))
            rest = measured.force - _of(first, measured.velocity)
            left += _measured(measured.velocity, rest, measured.deviation, newton)
    panels = [Panel(f"friction ({unit_name('N')})", tuple(curves), levels=_ZERO, share=2.0)]
    if left:
        panels.append(Panel(f"residual ({unit_name('N')})", tuple(left), levels=_ZERO))
    end = 1.03e3 * reach
    return Chart(
        f"velocity ({unit_name('m/s')})", tuple(panels), low=-end, high=end, height=3.4 if len(panels) == 1 else 4.4
    )


friction = figure_of(friction_chart)


def _steady(blocks: Iterable[Friction], velocity: np.ndarray) -> np.ndarray:
    return np.array([sum(float(block.steady(np.float64(v))) for block in blocks) for v in velocity])


def _both(force: Any, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities in both directions with a gap at standstill, and the force at each velocity."""
    # next to standstill, with a gap at 0: the force jumps there
    ahead = reach * np.concatenate([[1e-4 * _SLOWEST], np.geomspace(_SLOWEST, 1.0, 400)])
    return (
        np.concatenate([-ahead[::-1], [np.nan], ahead]),
        np.concatenate([force(-ahead[::-1]), [np.nan], force(ahead)]),
    )


def _of(loop: Loop, velocity: np.ndarray) -> np.ndarray:
    """Return the total friction of an axis in rigid-body motion, in N: the friction of its friction blocks plus the
    viscous friction of its plant.
    """
    # Deferred: only a measured map needs the model of the whole axis.
    from feeddrive.tuning.candidates import axis_model

    model = axis_model(loop)
    return np.array([model.dry_friction(float(v)) + model.viscous * float(v) for v in velocity])


def _whole(loop: Loop, reach: float, newton: float, number: int) -> list[Curve]:
    """Return the curve of the total friction, if it differs from that of a single block."""
    blocks = [block for block in (loop.axis.friction_motor, loop.axis.friction_load) if block is not None]
    v, force = _both(lambda v: _of(loop, v), reach)
    alone = _both(lambda v: _steady(blocks, v), reach)[1] if len(blocks) == 1 else None
    if alone is not None and np.allclose(alone, force, rtol=1e-9, equal_nan=True):
        return []
    return [Curve(1e3 * v, newton * force, _ALL, number)]


def _measured(
    velocity: np.ndarray, force: np.ndarray, deviation: np.ndarray | None, newton: float, name: str = ""
) -> list[Curve]:
    """Return points with error bars of ±`deviation`."""
    points = Curve(1e3 * velocity, newton * force, name, chart.NEUTRAL, chart.DOTS)
    if deviation is None:
        return [points]
    x = np.column_stack([velocity, velocity, np.full(velocity.size, np.nan)]).ravel()
    y = np.column_stack([force - deviation, force + deviation, np.full(velocity.size, np.nan)]).ravel()
    return [Curve(1e3 * x, newton * y, number=chart.NEUTRAL, look=chart.THIN), points]


def has_friction(loop: Loop) -> bool:
    """Return True if the axis of a loop has friction."""
    return loop.axis.friction_load is not None or loop.axis.friction_motor is not None


def _reach(run: Run | None, measured: FrictionMap | None) -> float:
    speeds = [0.0]
    if run is not None:
        speeds.append(float(np.max(np.abs(run["velocity_load"]), initial=0.0)))
    if measured is not None:
        speeds.append(float(np.max(np.abs(measured.velocity), initial=0.0)))
    return max(speeds) or 0.1


def _different(loops: Mapping[str, Loop]) -> dict[str, Friction]:
    """Return the distinct friction models of the loops, by label."""
    frictions: dict[str, Friction] = {}
    # Compared as text: two loops on one axis hold equal blocks, not the same object.
    seen: set[str] = set()
    places = {"friction_load": "guideway", "friction_motor": "screw and bearings"}
    several = any(loop.axis.friction_motor is not None for loop in loops.values())
    for name, loop in loops.items():
        for field, place in places.items():
            block = getattr(loop.axis, field)
            if block is None or f"{field} {block!r}" in seen:
                continue
            seen.add(f"{field} {block!r}")
            label = f"model, {place}" if several else "model"
            frictions[label if label not in frictions else f"{label}, {name}"] = block
    return frictions


def _met(loop: Loop, run: Run, newton: float) -> list[Curve]:
    """Return the friction during a run; the force in a row belongs to the velocity at the end of its sample."""
    curves = list[Curve]()
    for place in ("load", "motor"):
        block = getattr(loop.axis, f"friction_{place}")
        if block is None or run.time.size < 3:
            continue
        velocity = run[f"velocity_{place}"][1:]
        # The linear part of a friction is integrated with the plant and is not in the signal.
        force = -run[f"friction_{place}"][:-1] + float(block.linear()) * velocity
        # a run has a hundred thousand rows on one curve: a point for each cell of the picture looks the same
        cells = np.column_stack([np.rint(CELLS * x / (np.max(np.abs(x)) or 1.0)) for x in (velocity, force)])
        _, kept = np.unique(cells, axis=0, return_index=True)
        name = "" if curves else "met in the run"
        curves.append(Curve(1e3 * velocity[kept], newton * force[kept], name, _MET, chart.DOTS))
    return curves


def friction_map_chart(friction_map: FrictionMap) -> Chart:
    """Plot the measured friction versus velocity."""
    return friction_chart({}, measured=friction_map)


def steady_runs_chart(runs: SteadyRuns) -> Chart:
    """Plot the force versus velocity."""
    unit, _, force_unit, newton = _scales(runs)
    panel = Panel(f"force ({unit_name(force_unit, 'SI')})", tuple(_points(runs, newton)), levels=_ZERO)
    return Chart(f"velocity ({unit_name(unit, 'SI')})", (panel,), height=3.2)


steady_runs = figure_of(steady_runs_chart)


def identified_friction_chart(curve: FrictionCurve) -> Chart:
    """Plot the runs, the fitted friction curve with its 95 % confidence band, and the residuals."""
    runs = curve.runs
    unit, factor, force_unit, newton = _scales(runs)
    v, force = _both(curve.at, float(np.max(np.abs(runs.velocity))))
    half = NORMAL * _both(curve.error, float(np.max(np.abs(runs.velocity))))[1]
    name = "95 % band of the curve"
    low, high = newton * (force - half), newton * (force + half)
    above = Panel(
        f"force ({unit_name(force_unit, 'SI')})",
        (*_points(runs, newton), Curve(factor * v, newton * force, curve.model.name)),
        levels=_ZERO,
        bands=(Band(factor * v, low, high, 0, name),),
        share=2.0,
    )
    left = Curve(factor * runs.velocity, newton * curve.residual, number=1, look=chart.DOTS)
    below = Panel(
        f"residual ({unit_name(force_unit, 'SI')})",
        (left,),
        levels=_ZERO,
        bands=(Band(factor * v, -newton * half, newton * half, 0),),
    )
    return Chart(f"velocity ({unit_name(unit, 'SI')})", (above, below), height=4.2)


identified_friction = figure_of(identified_friction_chart)


def _scales(runs: SteadyRuns) -> tuple[str, float, str, float]:
    """Return the display units and conversion factors of velocity and force for steady-velocity runs."""
    # torques of small drives: in N m all numbers of the axis would begin with 0.0
    small = runs.frame.force == "N m" and float(np.max(np.abs(runs.force))) < 0.1
    velocity, factor = ("mm/s", 1e3) if runs.frame.velocity == "m/s" else (runs.frame.velocity, 1.0)
    force, newton = ("mN m", 1e3) if small else (runs.frame.force, 1.0)
    return velocity, factor, force, newton


def _points(runs: SteadyRuns, newton: float) -> list[Curve]:
    """Return the mean of each run, with error bars of ±2 standard errors if known."""
    factor = _scales(runs)[1]
    errors = None if np.any(np.isnan(runs.error)) else 2.0 * runs.error
    return _measured(1e-3 * factor * runs.velocity, runs.force, errors, newton, "measured")


_LAGS = 40  # lags of an autocorrelation
_CUT = 0.3  # of an amplitude: lower end of error bars on the logarithmic scale


def _apart(time: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times and values, shape (n,), with a NaN inserted wherever rows were left out."""
    steps = np.diff(time)
    # rows stand a whole number of steps apart
    ends = np.flatnonzero(steps > 1.5 * np.min(steps)) + 1 if steps.size else np.zeros(0, np.intp)
    return np.insert(time, ends, time[ends]), np.insert(values, ends, np.nan)


def rigid_fit_chart(fit: RigidFit, units: Units = DRAWN) -> Chart:
    """Plot the measured and fitted force versus time, and the residual."""
    unit, newton = unit_name(fit.frame.force), units.of(fit.frame.force)[1]
    measured, off = newton * fit.residuals.measured, newton * fit.residuals.values
    forces = (
        Curve(*envelope(fit.time, measured), "measured", chart.NEUTRAL, chart.DOTS),
        Curve(*envelope(*_apart(fit.time, measured - off)), "fitted", 0),
    )
    caption = Text(f"{Quantity(fit.residuals.relative, 'share'):3} of the force's RMS")
    left = Curve(*envelope(*_apart(fit.time, off)), "residual", 1, chart.THIN, caption=caption)
    panels = Panel(f"force ({unit})", forces, share=2.0), Panel(f"residual ({unit})", (left,))
    return Chart("time (s)", panels, low=float(fit.time[0]), high=float(fit.time[-1]), height=3.8)


rigid_fit = figure_of(rigid_fit_chart)


def identified_chart(identified: Identified, units: Units = DRAWN) -> Chart:
    """Plot the model and the log: a closed-loop simulation of the same reference if the law is known, otherwise the
    measured and fitted force.
    """
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
            Curve(
                *envelope(time, factor * replay.measured[name]), "" if panels else "measured", chart.NEUTRAL, chart.DOTS
            ),
            Curve(*envelope(time, factor * replay.run[name]), "" if panels else "model", 0),
        )
        left = Curve(*envelope(after, factor * off), f"residual of the {words}", 1, chart.THIN, caption=caption)
        label = unit_name(unit)
        panels += [Panel(f"{words} ({label})", both, share=2.0), Panel(f"residual ({label})", (left,), share=1.2)]
    return Chart("time (s)", tuple(panels), low=float(time[0]), high=float(time[-1]), height=5.4)


def residuals_chart(residuals: Residuals) -> Chart:
    """Plot the residual versus row number, and its autocorrelation with the bounds for white noise."""
    off = Curve(
        *envelope(np.arange(residuals.values.size, dtype=np.float64), residuals.values), number=1, look=chart.PLAIN
    )
    # a longer lag leaves too few pairs of rows
    lags = np.arange(1, min(_LAGS, residuals.values.size // 4) + 1)
    rho = [residuals.autocorrelation(int(lag)) for lag in lags]
    # 95 % of the autocorrelations of n white residuals have less
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
    """Plot the prediction error in each segment, for a fit to the other segments."""
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
        ticks=chart.numbered(numbers),
        height=2.6,
    )


validation = figure_of(validation_chart)


def delay_fit_chart(fit: DelayFit) -> Chart:
    """Plot the residual versus the tested delay."""
    near = np.abs(fit.delays - fit.nearest) <= 6
    delays = fit.delays[near]
    panel = Panel(
        "residual (%)",
        (Curve(delays, 100.0 * fit.residual[near], look=chart.MARKED, size=0.9),),
        levels=(Level(fit.dead_time, upright=True, number=1),),
        caption=Text(f"{Quantity(fit.dead_time):.2f} ± {Quantity(fit.error):.2f} samples"),
    )
    low, high = style.padded(float(np.min(delays)), float(np.max(delays)), 0.03)
    return Chart("dead time (samples, besides the hold)", (panel,), low=low, high=high, height=2.8)


delay_fit = figure_of(delay_fit_chart)


def control_fit_chart(fit: ControlFit) -> Chart:
    """Plot the unexplained share of the force for each tested law, grouped by delay."""
    curves = list[Curve]()
    for i, delay in enumerate(sorted({d for _, d in fit.tried})):
        samples = [n for n, d in fit.tried if d == delay]
        left = [100.0 * fit.tried[n, delay] for n in samples]
        curves.append(Curve(np.array(samples, float), np.array(left), f"delay {delay}", i, chart.MARKED, size=0.9))
    panel = Panel("unexplained share of the force (%)", tuple(curves), scale=chart.LOG)
    return Chart("samples over which the velocity is differenced", (panel,), height=2.8)


control_fit = figure_of(control_fit_chart)


def cogging_chart(fit: CoggingFit) -> Chart:
    """Plot amplitudes by order with twice their standard errors: cogging, and the part that changes sign with
    direction.
    """
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
                # A bar that reaches 0 has no lower end on a logarithmic scale.
                *chart.rods(x, np.maximum(value - 2.0 * error, _CUT * value), value + 2.0 * error),
                number=chart.NEUTRAL,
                look=chart.THIN,
                size=1.5,
            )
        )
        points.append(Curve(x, value, label, i, chart.MARKERS, size=0.9))
    x = np.concatenate([curve.x for curve in points])
    low, high = style.padded(float(np.min(x)), float(np.max(x)), 0.03) if x.size else (0.0, 1.0)
    panel = Panel(f"amplitude ({unit_name(fit.unit, 'SI')})", (*bars, *points), scale=chart.LOG)
    return Chart("order", (panel,), low=low, high=high, height=3.2)


cogging = figure_of(cogging_chart)


def cogging_over_turn_chart(fit: CoggingFit, runs: Sequence[CoggingRun]) -> Chart:
    """Plot the measured force over one period for each direction, and the fitted cogging."""
    curves = list[Curve]()
    for i, (sign, label) in enumerate(((1, "forward"), (-1, "backward"))):
        for run in (run for run in runs if run.direction == sign):
            # The envelope keeps extremes of consecutive rows, which must therefore be neighbors in position, not in
            # time.
            order = np.argsort(np.mod(run.turns, 1.0))
            x, y = envelope(np.mod(run.turns, 1.0)[order], run.force[order])
            curves.append(Curve(x, y, label, i + 1, chart.DOTS, size=0.7))
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


def pooled_chart(fit: PooledFit) -> Chart:
    """Plot, for each parameter, the value of each log with its 95 % interval over the pooled value and its interval."""
    ticks = tuple(Tick(float(k), fit.name) for k, fit in enumerate(fit.fits, 1))
    ends = np.array([0.5, len(ticks) + 0.5])
    panels = []
    for pooled in fit.estimates:
        alone = [one[pooled.name] for one in fit.fits]
        places = np.arange(1.0, len(alone) + 1.0)
        low, high = (np.array([one.interval[side] for one in alone]) for side in (0, 1))
        gap = np.full(places.size, np.nan)
        across = np.column_stack([places, places, gap]).ravel()
        curves = (
            Curve(across, np.column_stack([low, high, gap]).ravel(), look=chart.PLAIN, number=1),
            Curve(places, np.array([one.value for one in alone]), look=chart.MARKERS, number=1),
        )
        bounds = (np.full(2, bound) for bound in pooled.interval)
        area = Band(ends, *bounds, number=0)
        level = Level(pooled.value, number=0)
        label = Text(f"({unit_name(pooled.unit, 'SI')})")
        panels.append(Panel(label, curves, bands=(area,), levels=(level,), caption=pooled.name.replace("_", " ")))
    return Chart("log", tuple(panels), low=0.5, high=len(ticks) + 0.5, ticks=ticks, height=1.2 + 1.2 * len(panels))


pooled = figure_of(pooled_chart)
