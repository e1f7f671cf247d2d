"""Conversion of results to pandas data frames, with one function per result type.

Columns are in SI units unless their name states another unit. `Result.to_pandas()` calls these functions. Pandas is an
optional dependency and is imported only when needed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from feeddrive.analysis.effort import Effort
    from feeddrive.analysis.friction_map import FrictionMap
    from feeddrive.analysis.margins import MarginIntervals, Margins
    from feeddrive.analysis.measured_loop import MeasuredLoop
    from feeddrive.analysis.replay import Observation, Replay
    from feeddrive.analysis.spectrum import Spectrum
    from feeddrive.analysis.stability import Encirclement, Stability
    from feeddrive.analysis.step_response import StepResponse
    from feeddrive.analysis.stiffness import Stiffness
    from feeddrive.certificate.certificate import Certificate
    from feeddrive.cosimulation.simulate_with_fmu import Cosimulation
    from feeddrive.files.log import Log
    from feeddrive.identification.cogging import CoggingFit
    from feeddrive.identification.excitation.excitation import Excitation
    from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
    from feeddrive.identification.friction_curve import FrictionCurve, SteadyRuns
    from feeddrive.identification.motion.identify import Identified
    from feeddrive.identification.motion.identify_law import ControlFit
    from feeddrive.identification.motion.output_error import Refinement
    from feeddrive.identification.motion.rigid import DelayFit, RigidFit
    from feeddrive.identification.regression import Residuals, Validation
    from feeddrive.identification.response.agreement import Agreement
    from feeddrive.identification.response.modal_fit import ModalFit
    from feeddrive.identification.response.plant_fit import AxisFits, PlantFit
    from feeddrive.learning.iterative_feedforward import Iteration
    from feeddrive.learning.trajectory_prefilter import PrefilterFit
    from feeddrive.learning.trial import Trial
    from feeddrive.learning.trials import Trials
    from feeddrive.loop.frequency_response import FRF
    from feeddrive.loop.gradient import Gradient
    from feeddrive.loop.linearize import StateSpace
    from feeddrive.loop.simulate import Batch, Run
    from feeddrive.machining.circle_test import CircleCauses
    from feeddrive.machining.contour import ContourError
    from feeddrive.machining.cutting_force import CuttingForces
    from feeddrive.machining.lobes import Lobes
    from feeddrive.tuning.poles import Placement
    from feeddrive.tuning.recipes import Recipe
    from feeddrive.tuning.scaling import DelayMap
    from feeddrive.tuning.tune import Tuned


def frame(index: Sequence[Any] | np.ndarray, columns: Mapping[str, Any], index_name: str) -> Any:
    """Return a data frame with a named index. Raises MissingExtraError if pandas is not installed."""
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("pandas", "pandas", "a DataFrame") from error
    return pandas.DataFrame(dict(columns), index=pandas.Index(index, name=index_name))


def laws(
    names: Sequence[str],
    figures: Sequence[Mapping[str, float | None]],
    keys: Iterable[str] | None = None,
    index_name: str = "law",
) -> Any:
    """Return a data frame with one row per law, in SI units. `keys` selects the figures; default: all."""
    keys = dict.fromkeys(key for row in figures for key in row) if keys is None else keys
    return frame(names, {key: np.array([row.get(key) for row in figures], float) for key in keys}, index_name)


def run(run: Run) -> Any:
    """Return a data frame with one column per signal, versus time in s."""
    return frame(run.time, run.signals, "time")


def batch(batch: Batch) -> Any:
    """Return a data frame with one row per variant."""
    columns = {f"rms_{name}": values for name, values in batch.rms.items()}
    columns |= {f"peak_{name}": values for name, values in batch.peak.items()}
    return frame(np.arange(batch.left.size), {**columns, "left": batch.left}, "variant")


def state_space(model: StateSpace) -> Any:
    """Return a data frame with one row per pole."""
    poles = model.poles()
    return frame(np.arange(poles.size), {"real": np.real(poles), "imaginary": np.imag(poles)}, "pole")


def step_response(response: StepResponse) -> Any:
    """Return a data frame with the position versus time in s."""
    return frame(response.time, {"position": response.position}, "time")


def gradient(gradient: Gradient) -> Any:
    """Return a data frame with one row per parameter."""
    columns = {"value": np.array(list(gradient.values.values())), "slope": np.array(list(gradient.gradient.values()))}
    return frame(np.array(list(gradient.gradient)), columns, "parameter")


def frf(frf: FRF) -> Any:
    """Return a data frame with real and imaginary part, and coherence and variance if known, versus frequency in Hz."""
    columns = {"real": np.real(frf.response), "imaginary": np.imag(frf.response)}
    measured = {"coherence": frf.coherence, "variance": frf.variance}
    columns |= {name: values for name, values in measured.items() if values is not None}
    return frame(frf.frequency, columns, "frequency")


def effort(effort: Effort) -> Any:
    """Return a data frame with one row per kind of operation."""
    return frame(list(effort.operations), {"number": list(effort.operations.values())}, "operation")


def friction_map(friction_map: FrictionMap) -> Any:
    """Return a data frame with one row per velocity."""
    columns = {"force": friction_map.force, "deviation": friction_map.deviation, "count": friction_map.count}
    return frame(friction_map.velocity, columns, "velocity")


def margins(margins: Margins) -> Any:
    """Return a data frame with one row per crossover; values of the other crossover type are missing."""
    gain, phase = margins.gain_crossovers, margins.phase_crossovers
    # The two types of crossover share a table: each lacks the margins of the other.
    gap = [None] * len(phase)
    columns = {
        "kind": ["gain crossover"] * len(gain) + ["phase crossover"] * len(phase),
        "phase_margin_deg": [c.phase_margin_deg for c in gain] + gap,
        "delay_margin": [c.delay_margin for c in gain] + gap,
        "gain_margin_dB": [None] * len(gain) + [c.gain_margin_dB for c in phase],
    }
    return frame([c.frequency for c in (*gain, *phase)], columns, "frequency")


def margin_intervals(intervals: MarginIntervals) -> Any:
    """Return a data frame with one row per figure."""
    every = list(intervals.intervals.values())
    columns = {"value": [e.value for e in every], "low": [e.low for e in every], "high": [e.high for e in every]}
    return frame(list(intervals.intervals), columns, "figure")


def loop_gain(loop: Encirclement | MeasuredLoop) -> Any:
    """Return a data frame with the real and imaginary part of L versus frequency in Hz."""
    return loop.loop_gain.to_pandas()


def observation(observation: Observation) -> Any:
    """Return a data frame with position, velocity and disturbance versus time in s."""
    columns = {
        "position": observation.position,
        "velocity": observation.velocity,
        "disturbance": observation.disturbance,
    }
    return frame(observation.time, columns, "time")


def replay(replay: Replay) -> Any:
    """Return a data frame with predicted and measured columns versus time in s."""
    columns = {f"predicted_{name}": replay.run[name] for name in replay.measured}
    columns |= {f"measured_{name}": values for name, values in replay.measured.items()}
    return frame(replay.run.time, columns, "time")


def spectrum(spectrum: Spectrum) -> Any:
    """Return a data frame with amplitude and cumulative RMS versus frequency in Hz."""
    columns = {"amplitude": spectrum.amplitude, "cumulative_rms": spectrum.cumulative_rms}
    return frame(spectrum.frequency, columns, "frequency")


def stability(stability: Stability) -> Any:
    """Return a data frame with one row per pole."""
    return stability.model.to_pandas()


def stiffness(stiffness: Stiffness) -> Any:
    """Return a data frame with the stiffness in N/m versus frequency in Hz."""
    return frame(stiffness.frequency, {"stiffness": stiffness.magnitude}, "frequency")


def lobes(lobes: Lobes) -> Any:
    """Return a data frame with depth limit in m, chatter frequency in Hz and a flip flag versus spindle speed in rpm.

    `flip` is True where the stability limit is a flip (period-doubling) bifurcation.
    """
    columns = {"depth": lobes.depth, "chatter_frequency": lobes.frequency, "flip": lobes.flip}
    return frame(lobes.spindle_speed, columns, "spindle_speed")


def log(log: Log) -> Any:
    """Return a data frame with one column per channel, versus time in s."""
    return frame(log.time, log.channels, "time")


def cutting_forces(forces: CuttingForces) -> Any:
    """Return a data frame with spindle angle, forces, torque and power versus time in s."""
    names = ("angle", "spindle_speed", "feed", "normal", "axial", "torque", "power")
    return frame(forces.time, {name: getattr(forces, name) for name in names}, "time")


def agreement(agreement: Agreement) -> Any:
    """Return a data frame with measured and fitted responses versus frequency in Hz, one response after the other."""
    columns = {
        "response": np.concatenate([np.full(m.frequency.size, i) for i, m in enumerate(agreement.measured)]),
        "measured_real": np.concatenate([np.real(m.response) for m in agreement.measured]),
        "measured_imaginary": np.concatenate([np.imag(m.response) for m in agreement.measured]),
        "fitted_real": np.concatenate([np.real(m.response) for m in agreement.fitted]),
        "fitted_imaginary": np.concatenate([np.imag(m.response) for m in agreement.fitted]),
    }
    return frame(np.concatenate([m.frequency for m in agreement.measured]), columns, "frequency")


def cogging(fit: CoggingFit) -> Any:
    """Return a data frame with one row per order."""
    rows = sorted(fit.orders, key=lambda order: order.order)
    pick = {"forward": "forward", "backward": "backward", "cogging": "even", "friction_like": "odd"}
    columns = {
        name: np.array([np.nan if (e := getattr(order, field)) is None else e.value for order in rows])
        for name, field in pick.items()
    }
    return frame(np.array([order.order for order in rows]), columns, "order")


def control_fit(fit: ControlFit) -> Any:
    """Return a data frame with one row per tested law."""
    columns = {
        "velocity_samples": np.array([n for n, _ in fit.tried]),
        "delay": np.array([d for _, d in fit.tried]),
        "residual": np.array(list(fit.tried.values())),
    }
    return frame(np.arange(len(fit.tried)), columns, "law")


def delay_fit(fit: DelayFit) -> Any:
    """Return a data frame with one row per delay."""
    return frame(fit.delays, {"residual": fit.residual}, "samples")


def excitation(excitation: Excitation) -> Any:
    """Return a data frame with the first realization versus time in s."""
    drawn = excitation.drawings[0]
    return frame(drawn.time, {"excitation": drawn.excitation, **drawn.signals}, "time")


def axis_fits(fits: AxisFits) -> Any:
    """Return a data frame with the parameters of the chosen fit."""
    return fits.fit.to_pandas()


def frequency_estimate(estimate: FrequencyEstimate) -> Any:
    """Return a data frame with response, coherence, variance and noise variance versus frequency in Hz."""
    return estimate.frf.to_pandas().assign(noise_variance=estimate.noise, freedom=estimate.freedom)


def friction_curve(curve: FrictionCurve) -> Any:
    """Return a data frame with measured and fitted force versus velocity."""
    columns = {"force": curve.runs.force, "fitted": curve.runs.force - curve.residual}
    return frame(curve.runs.velocity, columns, "velocity")


def identified(identified: Identified) -> Any:
    """Return a data frame with measured and fitted force versus time in s."""
    return identified.rigid.to_pandas()


def modal_fit(fit: ModalFit) -> Any:
    """Return a data frame with one row per parameter."""
    columns = {"value": [e.value for e in fit.estimates], "error": [e.error for e in fit.estimates]}
    return frame([e.name for e in fit.estimates], columns, "parameter")


def plant_fit(fit: PlantFit) -> Any:
    """Return a data frame with one row per parameter, fitted parameters first, then derived ones."""
    every = (*fit.estimates, *fit.derived)
    columns = {"value": [e.value for e in every], "error": [e.error for e in every], "unit": [e.unit for e in every]}
    return frame([e.name for e in every], columns, "parameter")


def refinement(refinement: Refinement) -> Any:
    """Return a data frame with predicted and measured columns versus time in s."""
    return refinement.replay.to_pandas()


def residuals(residuals: Residuals) -> Any:
    """Return a data frame with measured value and residual, one row per data row."""
    return frame(
        np.arange(residuals.values.size), {"measured": residuals.measured, "residual": residuals.values}, "row"
    )


def rigid_fit(fit: RigidFit) -> Any:
    """Return a data frame with measured and fitted force versus time in s."""
    measured = fit.residuals.measured
    return frame(fit.time, {"measured": measured, "fitted": measured - fit.residuals.values}, "time")


def steady_runs(runs: SteadyRuns) -> Any:
    """Return a data frame with one row per run."""
    return frame(runs.velocity, {"force": runs.force, "error": runs.error, "rows": runs.rows}, "velocity")


def validation(validation: Validation) -> Any:
    """Return a data frame with one row per validation segment."""
    return frame(np.arange(1, validation.errors.size + 1), {"error": validation.errors}, "stretch")


def delay_map(delay_map: DelayMap) -> Any:
    """Return a data frame with the factors at the stability limit and at the bound of Ms versus dead time in s."""
    return frame(delay_map.dead_time, {"edge": delay_map.edge, "robust": delay_map.robust}, "dead_time")


def iteration(iteration: Iteration) -> Any:
    """Return a data frame with the actual and the predicted error versus time in s."""
    columns = {"following_error": iteration.trial.following_error, "predicted": iteration.predicted}
    return frame(iteration.trial.time, columns, "time")


def placement(placement: Placement) -> Any:
    """Return a data frame with one row per pole of the sampled loop."""
    return placement.stability.to_pandas()


def recipe(recipe: Recipe) -> Any:
    """Return a data frame with one row per gain."""
    law = recipe.law
    return frame(["Kv", "Kp", "Tn"], {"value": np.array([law.Kv, law.Kp, law.Tn or np.nan])}, "gain")


def tuned(tuned: Tuned) -> Any:
    """Return a data frame with one row per tunable."""
    names = list(tuned.tunables)
    columns = {
        "today": np.array([tuned.started[name] for name in names]),
        "new": np.array([tuned.tunables[name] for name in names]),
    }
    return frame(names, columns, "tunable")


def prefilter_fit(fit: PrefilterFit) -> Any:
    """Return a data frame with error, explained part and prediction in m versus time in s."""
    return frame(fit.time, {"error": fit.error, "explained": fit.explained, "predicted": fit.predicted}, "time")


def trial(trial: Trial) -> Any:
    """Return a data frame with setpoint and error versus time in s."""
    columns = {f"set_{name}": np.asarray(row) for name, row in zip(Setpoint._fields, trial.setpoint, strict=True)}
    return frame(trial.time, {**columns, "following_error": trial.following_error}, "time")


def trials(trials: Trials) -> Any:
    """Return a data frame with one row per trial."""
    errors = {f"error_{name}": values for name, values in trials.errors().items()}
    return frame(np.arange(1, len(trials.trials) + 1), {"rms": trials.rms, **trials.parameters(), **errors}, "trial")


def certificate(certificate: Certificate) -> Any:
    """Return a data frame with one row per plant: margin, its frequency, and largest pole."""
    plants = certificate.document["plants"]
    columns = {
        "reserve": [np.nan if plant["reserve"] is None else plant["reserve"] for plant in plants],
        "frequency": [plant["reserve_at_Hz"] for plant in plants],
        "largest_pole": [certificate.loops[plant["name"]].growth for plant in plants],
    }
    return frame([plant["name"] for plant in plants], columns, "plant")


def cosimulation(cosimulation: Cosimulation) -> Any:
    """Return a data frame with one row per law."""
    figures = [row.figures() for row in cosimulation.rows]
    names = np.array([row.name for row in cosimulation.rows])
    return frame(names, {key: np.array([row[key] for row in figures]) for key in figures[0]}, "law")


def contour(contour: ContourError) -> Any:
    """Return a data frame with one row per sample: path length, error, lag, and the actual position of each axis."""
    columns = {"along_m": contour.along, "error_m": contour.error, "lag_m": contour.lag, "at_corner": contour.at_corner}
    columns |= {f"{axis}_m": contour.position[:, i] for i, axis in enumerate(contour.axes)}
    lines = {} if contour.line is None else {"line": contour.line}
    return frame(contour.time, {**columns, **lines}, "time_s")


def circle_causes(causes: CircleCauses) -> Any:
    """Return a data frame with one row per cause; one column gives the unit of the value."""
    rows = causes.causes
    columns = {
        name: [getattr(cause, name) for cause in rows] for name in ("value", "error", "unit", "effect", "share", "note")
    }
    return frame([cause.name for cause in rows], columns, "cause")
