"""Charts of tuning and learning: gain limits versus dead time, trials, prefilters, observer estimates."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from feeddrive.figures.of_loops import SENSITIVITY_PEAK, STIFFNESS_LEAST
from feeddrive.language import tree
from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.text import Text
from feeddrive.plot import chart, style
from feeddrive.plot.chart import Abscissa, Band, Box, Chart, Curve, Level, Panel
from feeddrive.plot.drawing import figure_of
from feeddrive.plot.style import POINTS, envelope

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from feeddrive.analysis.replay import Observation
    from feeddrive.certificate.travel_proof import TravelProof
    from feeddrive.learning.iterative_feedforward import Iteration
    from feeddrive.learning.trajectory_prefilter import PrefilterFit
    from feeddrive.learning.trial import Trial
    from feeddrive.learning.trials import Trials
    from feeddrive.tuning.scaling import DelayMap
    from feeddrive.tuning.travel import TunedTravel

_WORDS = {
    "mass": "mass",
    "viscous": "viscous",
    "coulomb_positive": "Coulomb +",
    "coulomb_negative": "Coulomb -",
    "stribeck": "Stribeck",
    "jerk_feedforward": "jerk",
    "snap_feedforward": "snap",
}
_UNITS = {"N/m": ("N/um", 1e-6), "m √s/N": ("nm √s/N", 1e9)}  # of figures, as a picture shows them, with the factor


def trial_chart(trial: Trial) -> Chart:
    """Plot the following error and, below it, the set velocity."""
    error = Curve(*envelope(trial.time, 1e6 * trial.following_error))
    caption = Text(f"RMS {Quantity(trial.rms, 'm')}, peak {Quantity(trial.peak, 'm')}")
    above = Panel(f"following error\n({unit_name('um')})", (error,), share=2.0, caption=caption)
    return Chart("time (s)", (above, _velocity(trial)), height=3.6)


trial = figure_of(trial_chart)


def travel_chart(found: TunedTravel, proof: TravelProof | None = None) -> Chart:
    """Plot goal, least stiffness and Ms over the position, of fixed gains and a schedule; shaded: proven.

    Of several payloads at a position the worst one is shown, by each figure for itself.
    """
    figures = [found.goal, *(f for f in (STIFFNESS_LEAST, SENSITIVITY_PEAK) if f.key != found.goal.key)]
    panels: list[Panel] = []
    for figure in figures:
        unit, factor = _UNITS.get(figure.unit, (figure.unit, 1.0))
        curves: list[Curve] = []
        for number, (name, rows) in enumerate((("fixed gains", found.before), ("schedule", found.after))):
            read = [(row.position, None if row.figures is None else figure.read(row.figures)) for row in rows]
            x, places = np.unique([position for position, _ in read], return_inverse=True)
            y = np.full(x.size, np.nan)
            worse = np.fmin if figure.better == "higher" else np.fmax
            worse.at(y, places, np.array([np.nan if value is None else value for _, value in read], float))
            x = 1e3 * x
            curves.append(Curve(x, factor * y, name, number, chart.MARKED))
        levels: tuple[Level, ...] = ()
        boxes: tuple[Box, ...] = ()
        if figure is SENSITIVITY_PEAK and proof is not None:
            if proof.bound is not None:
                levels = (Level(proof.bound, dashed=True, caption=Text(f"proven: Ms <= {Quantity(proof.bound):4}")),)
            if proof.cells:
                boxes = tuple(Box(1e3 * a, 1e3 * b, pale=True, number=1) for a, b in proof.intervals())
        label = figure.title if not unit or unit == "1" else f"{figure.title}\n({unit_name(unit)})"
        panels.append(Panel(label, tuple(curves), levels=levels, boxes=boxes))
    label = f"position ({unit_name('mm')})"
    return Chart(label, tuple(panels), height=1.9 * len(panels))


travel = figure_of(travel_chart)


def iteration_chart(iteration: Iteration) -> Chart:
    """Plot the error of the trial and the predicted error of the next trial with the same reference."""
    before, after = (Text(f"RMS {Quantity(rms, 'm')}") for rms in (iteration.trial.rms, iteration.predicted_rms))
    time = iteration.trial.time
    errors = (
        Curve(*envelope(time, 1e6 * iteration.trial.following_error), caption=Text(f"this trial, {before}")),
        Curve(*envelope(time, 1e6 * iteration.predicted), "", 1, chart.PLAIN, Text(f"predicted for the next, {after}")),
    )
    above = Panel(f"following error\n({unit_name('um')})", errors, share=2.0)
    return Chart("time (s)", (above, _velocity(iteration.trial)), height=3.8)


iteration = figure_of(iteration_chart)


def trials_chart(trials: Trials) -> Chart:
    """Plot the RMS error over the trials on a logarithmic scale, and each parameter with its standard error."""
    return errors_and_parameters_chart({"": trials})


trials = figure_of(trials_chart)


def errors_and_parameters_chart(named: Mapping[str, Trials]) -> Chart:
    """Plot the RMS errors of several sets of trials, one curve each, and the parameters of the last set."""
    last = list(named.values())[-1]
    values, errors = last.parameters(), last.errors()
    top = rms_panel({name: 1e6 * trials.rms for name, trials in named.items()}, "following error\nRMS")
    most = max(2, *(len(trials.trials) for trials in named.values()))
    numbers = Abscissa("", low=0.7, high=most + 0.3, ticks=chart.numbered(range(1, most + 1)))
    panels = [replace(top, share=1.8, whole=True, abscissa=numbers)]
    for i, (name, row) in enumerate(values.items()):
        trial = np.arange(1, row.size + 1, dtype=np.float64)
        # a start value was not learned and has no error
        sigma = np.where(np.isnan(errors[name]), 0.0, errors[name])
        bars = Curve(
            *chart.rods(trial, row - 2.0 * sigma, row + 2.0 * sigma), number=chart.NEUTRAL, look=chart.THIN, size=1.5
        )
        line = Curve(trial, row, number=i, look=chart.PLAIN, size=0.7)
        points = Curve(trial, row, number=i, look=chart.MARKERS, size=0.8)
        unit = style.written(tree.declaration(last.iterations[0].before, name).unit)
        label = f"{_WORDS.get(name, name)}\n({unit_name(unit, 'SI')})"
        abscissa = replace(numbers, label="trial" if i >= len(values) - 2 else "")
        panels.append(Panel(label, (bars, line, points), abscissa=abscissa))
    rows = -(-len(values) // 2)
    return Chart("", tuple(panels), across=2, height=2.6 + 1.35 * rows, columns=3)


errors_and_parameters = figure_of(errors_and_parameters_chart)


def rms_panel(rows: Mapping[str, np.ndarray], quantity: str) -> Panel:
    """Return a panel of RMS values in µm versus trial number, by name, on a logarithmic scale."""
    curves = tuple(
        Curve(np.arange(1, rms.size + 1, dtype=np.float64), rms, name, i, chart.MARKED)
        for i, (name, rms) in enumerate(rows.items())
    )
    return Panel(f"{quantity} ({unit_name('um')})", curves, scale=chart.LOG)


def _velocity(trial: Trial) -> Panel:
    set_velocity = 1e3 * np.asarray(trial.setpoint.velocity)
    line = Curve(*envelope(trial.time, set_velocity), number=chart.NEUTRAL, size=0.7)
    return Panel(f"set velocity\n({unit_name('m/s')})", (line,))


def prefilter_fit_chart(fit: PrefilterFit, points: int = POINTS) -> Chart:
    """Plot the error with the part explained by the derivatives, and below it the predicted error."""
    error, explained, left = (
        envelope(fit.time, 1e6 * values, points) for values in (fit.error, fit.explained, fit.predicted)
    )
    # Both panels have one scale, so that the reduction is visible.
    size = 1.1e6 * float(np.max(np.abs(fit.error), initial=1e-12))
    caption = Text(f"RMS {Quantity(fit.rms(fit.error), 'm')} -> {Quantity(fit.rms(fit.predicted), 'm')}")
    panels = (
        Panel(
            f"tracking error\n({unit_name('um')})",
            (Curve(*error, "error", chart.NEUTRAL, chart.WIDE), Curve(*explained, "explained")),
            low=-size,
            high=size,
        ),
        Panel(
            f"predicted with\nthe prefilter ({unit_name('um')})",
            (Curve(*left, number=1, look=chart.PLAIN),),
            low=-size,
            high=size,
            caption=caption,
        ),
    )
    return Chart("time (s)", panels, height=4.2)


prefilter_fit = figure_of(prefilter_fit_chart)


def disturbance_chart(
    observations: Observation | Mapping[str, Observation],
    true: np.ndarray | None = None,
    window: tuple[float, float] | None = None,
) -> Chart:
    """Plot estimated disturbances versus time in ms, with the true one in gray; `window` is start and end in s."""
    chosen = style.named(observations)
    first = next(iter(chosen.values()))
    low, high = window or (float(first.time[0]), float(first.time[-1]))
    shown = (first.time >= low) & (first.time <= high)
    curves = list[Curve]()
    if true is not None:
        curves.append(Curve(*chart.stairs(1e3 * first.time[shown], true[shown]), "true", chart.NEUTRAL, chart.WIDE))
    curves += [
        Curve(1e3 * observation.time[shown], observation.disturbance[shown], name, i)
        for i, (name, observation) in enumerate(chosen.items())
    ]
    return Chart("time (ms)", (Panel(f"disturbance ({unit_name('N')})", tuple(curves)),), height=3.2)


disturbance = figure_of(disturbance_chart)


def delay_map_chart(maps: DelayMap | Mapping[str, DelayMap]) -> Chart:
    """Plot the first tunable versus dead time in samples: its values at the stability limit and at the bound of Ms."""
    chosen = style.named(maps)
    curves, bands, tunable = list[Curve](), list[Band](), ""
    for i, (name, delay_map) in enumerate(chosen.items()):
        tunable = next(iter(delay_map.tunables))
        samples = delay_map.dead_time / delay_map.sample_time
        edge, robust = delay_map.at_edge(tunable), delay_map.at_robust(tunable)
        caption = Text(f"Ms = {Quantity(delay_map.sensitivity_bound)}")
        curves += [
            Curve(samples, edge, name, i, chart.PLAIN, "unstable above"),
            Curve(samples, robust, name, i, chart.DASHED, caption),
            *(Curve(samples, row, number=i, look=chart.MARKERS) for row in (edge, robust)),
        ]
        bands.append(Band(samples, np.zeros(samples.size), robust, i))
    label = f"{tunable.rpartition('.')[2].replace('_', ' ')} (1/s)"
    panel = Panel(label, tuple(curves), bands=tuple(bands), low=0.0)
    return Chart("dead time (samples)", (panel,), height=3.2, columns=2)


delay_map = figure_of(delay_map_chart)


def in_time_chart(rows: Sequence[tuple[str, str, Mapping[str, tuple[np.ndarray, np.ndarray]]]]) -> Chart:
    """Plot rows of named curves, each row over its own time: (abscissa, ordinate, {name: (times, values)})."""
    panels = list[Panel]()
    for abscissa, ordinate, lines in rows:
        curves = tuple(Curve(*envelope(*line), name, i) for i, (name, line) in enumerate(lines.items()))
        time = next(iter(lines.values()))[0]
        panels.append(Panel(ordinate, curves, abscissa=Abscissa(abscissa, low=float(time[0]), high=float(time[-1]))))
    return Chart("", tuple(panels), height=1.0 + 2.1 * len(rows))


in_time = figure_of(in_time_chart)
