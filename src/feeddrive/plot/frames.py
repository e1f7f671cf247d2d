"""Results as pandas frames, one function for each type of result; pandas is an extra and loaded when asked for.

Columns are in SI but where their name says another unit; `Result.to_pandas()` calls these functions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feeddrive.blocks.signals import Setpoint
from feeddrive.language.errors import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from feeddrive.analysis.effort import Effort
    from feeddrive.analysis.friction_map import FrictionMap
    from feeddrive.analysis.margin_intervals import MarginIntervals
    from feeddrive.analysis.margins import Margins
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
    from feeddrive.identification.motion.control_law import ControlFit
    from feeddrive.identification.motion.delay import DelayFit
    from feeddrive.identification.motion.identify import Identified
    from feeddrive.identification.motion.output_error import Refinement
    from feeddrive.identification.motion.rigid import RigidFit
    from feeddrive.identification.regression import Residuals, Validation
    from feeddrive.identification.response.agreement import Agreement
    from feeddrive.identification.response.fit_axis import AxisFits
    from feeddrive.identification.response.modal_fit import ModalFit
    from feeddrive.identification.response.plant_fit import PlantFit
    from feeddrive.learning.iterative_feedforward import Iteration
    from feeddrive.learning.trajectory_prefilter import PrefilterFit
    from feeddrive.learning.trial import Trial
    from feeddrive.learning.trials import Trials
    from feeddrive.loop.frequency_response import FRF
    from feeddrive.loop.gradient import Gradient
    from feeddrive.loop.linearize import StateSpace
    from feeddrive.loop.simulate import Batch, Run
    from feeddrive.machining.circle_causes import CircleCauses
    from feeddrive.machining.contour import ContourError
    from feeddrive.machining.cutting_force import CuttingForces
    from feeddrive.machining.lobes import Lobes
    from feeddrive.tuning.poles import Placement
    from feeddrive.tuning.recipes import Recipe
    from feeddrive.tuning.scaling import DelayMap
    from feeddrive.tuning.tune import Tuned


def frame(index: Sequence[Any] | np.ndarray, columns: Mapping[str, Any], index_name: str) -> Any:
    """A DataFrame over a named index. Raises MissingExtraError without pandas."""
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("pandas", "pandas", "a DataFrame") from error
    return pandas.DataFrame(dict(columns), index=pandas.Index(index, name=index_name))


def run(run: Run) -> Any:
    """One column a signal, over time in s."""
    return frame(run.time, run.signals, "time")


def batch(batch: Batch) -> Any:
    """One row a variant."""
    columns = {f"rms_{name}": values for name, values in batch.rms.items()}
    columns |= {f"peak_{name}": values for name, values in batch.peak.items()}
    return frame(np.arange(batch.left.size), {**columns, "left": batch.left}, "variant")


def state_space(model: StateSpace) -> Any:
    """One row a pole."""
    poles = model.poles()
    return frame(np.arange(poles.size), {"real": np.real(poles), "imaginary": np.imag(poles)}, "pole")


def step_response(found: StepResponse) -> Any:
    """The position over time in s."""
    return frame(found.time, {"position": found.position}, "time")


def gradient(found: Gradient) -> Any:
    """One row a parameter."""
    columns = {"value": np.array(list(found.values.values())), "slope": np.array(list(found.gradient.values()))}
    return frame(np.array(list(found.gradient)), columns, "parameter")


def frf(frf: FRF) -> Any:
    """Real and imaginary part, and coherence and variance if known, over frequency in Hz."""
    columns = {"real": np.real(frf.response), "imaginary": np.imag(frf.response)}
    measured = {"coherence": frf.coherence, "variance": frf.variance}
    columns |= {name: values for name, values in measured.items() if values is not None}
    return frame(frf.frequency, columns, "frequency")


def effort(effort: Effort) -> Any:
    """One row a kind of operation."""
    return frame(list(effort.operations), {"number": list(effort.operations.values())}, "operation")


def friction_map(found: FrictionMap) -> Any:
    """One row a velocity."""
    columns = {"force": found.force, "deviation": found.deviation, "count": found.count}
    return frame(found.velocity, columns, "velocity")


def margins(margins: Margins) -> Any:
    """One row a crossover; columns of the other kind of crossover are missing."""
    gain, phase = margins.gain_crossovers, margins.phase_crossovers
    gap = [None] * len(phase)
    columns = {
        "kind": ["gain crossover"] * len(gain) + ["phase crossover"] * len(phase),
        "phase_margin_deg": [c.phase_margin_deg for c in gain] + gap,
        "delay_margin": [c.delay_margin for c in gain] + gap,
        "gain_margin_dB": [None] * len(gain) + [c.gain_margin_dB for c in phase],
    }
    return frame([c.frequency for c in (*gain, *phase)], columns, "frequency")


def margin_intervals(found: MarginIntervals) -> Any:
    """One row a figure."""
    every = list(found.intervals.values())
    columns = {"value": [e.value for e in every], "low": [e.low for e in every], "high": [e.high for e in every]}
    return frame(list(found.intervals), columns, "figure")


def loop_gain(found: Encirclement | MeasuredLoop) -> Any:
    """Real and imaginary part of L over frequency in Hz."""
    return found.loop_gain.to_pandas()


def observation(found: Observation) -> Any:
    """Position, velocity and disturbance over time in s."""
    columns = {"position": found.position, "velocity": found.velocity, "disturbance": found.disturbance}
    return frame(found.time, columns, "time")


def replay(replay: Replay) -> Any:
    """Predicted and measured columns over time in s."""
    columns = {f"predicted_{name}": replay.run[name] for name in replay.measured}
    columns |= {f"measured_{name}": values for name, values in replay.measured.items()}
    return frame(replay.run.time, columns, "time")


def spectrum(found: Spectrum) -> Any:
    """Amplitude and cumulative RMS over frequency in Hz."""
    columns = {"amplitude": found.amplitude, "cumulative_rms": found.cumulative_rms}
    return frame(found.frequency, columns, "frequency")


def stability(found: Stability) -> Any:
    """One row a pole."""
    return found.model.to_pandas()


def stiffness(found: Stiffness) -> Any:
    """The stiffness in N/m over frequency in Hz."""
    return frame(found.frequency, {"stiffness": found.magnitude}, "frequency")


def lobes(found: Lobes) -> Any:
    """Limit in m, chatter frequency in Hz and whether the border is a flip, over the spindle speed in rpm."""
    columns = {"depth": found.depth, "chatter_frequency": found.frequency, "flip": found.flip}
    return frame(found.spindle_speed, columns, "spindle_speed")


def log(log: Log) -> Any:
    """One column a channel, over time in s."""
    return frame(log.time, log.channels, "time")


def cutting_forces(found: CuttingForces) -> Any:
    """Forces, torque, power and angle of the spindle over time in s."""
    names = ("angle", "spindle_speed", "feed", "normal", "axial", "torque", "power")
    return frame(found.time, {name: getattr(found, name) for name in names}, "time")


def agreement(found: Agreement) -> Any:
    """Measured and fitted response over frequency in Hz, one response below the other."""
    columns = {
        "response": np.concatenate([np.full(m.frequency.size, i) for i, m in enumerate(found.measured)]),
        "measured_real": np.concatenate([np.real(m.response) for m in found.measured]),
        "measured_imaginary": np.concatenate([np.imag(m.response) for m in found.measured]),
        "fitted_real": np.concatenate([np.real(m.response) for m in found.fitted]),
        "fitted_imaginary": np.concatenate([np.imag(m.response) for m in found.fitted]),
    }
    return frame(np.concatenate([m.frequency for m in found.measured]), columns, "frequency")


def cogging(fit: CoggingFit) -> Any:
    """One row an order."""
    rows = sorted(fit.orders, key=lambda each: each.order)
    pick = {"forward": "forward", "backward": "backward", "cogging": "even", "friction_like": "odd"}
    columns = {
        name: np.array([np.nan if (e := getattr(each, field)) is None else e.value for each in rows])
        for name, field in pick.items()
    }
    return frame(np.array([each.order for each in rows]), columns, "order")


def control_fit(found: ControlFit) -> Any:
    """One row for each law that was tried."""
    columns = {
        "velocity_samples": np.array([n for n, _ in found.tried]),
        "delay": np.array([d for _, d in found.tried]),
        "residual": np.array(list(found.tried.values())),
    }
    return frame(np.arange(len(found.tried)), columns, "law")


def delay_fit(found: DelayFit) -> Any:
    """One row a delay."""
    return frame(found.delays, {"residual": found.residual}, "samples")


def excitation(found: Excitation) -> Any:
    """The first realization over time in s."""
    drawn = found.drawings[0]
    return frame(drawn.time, {"excitation": drawn.excitation, **drawn.signals}, "time")


def axis_fits(found: AxisFits) -> Any:
    """The parameters of the chosen fit."""
    return found.fit.to_pandas()


def frequency_estimate(found: FrequencyEstimate) -> Any:
    """Response, coherence, variance and noise variance over frequency in Hz."""
    return found.frf.to_pandas().assign(noise_variance=found.noise, freedom=found.freedom)


def friction_curve(curve: FrictionCurve) -> Any:
    """Measured and fitted force by velocity."""
    columns = {"force": curve.runs.force, "fitted": curve.runs.force - curve.residual}
    return frame(curve.runs.velocity, columns, "velocity")


def identified(found: Identified) -> Any:
    """Measured and fitted force over time in s."""
    return found.rigid.to_pandas()


def modal_fit(fit: ModalFit) -> Any:
    """One row a parameter."""
    columns = {"value": [e.value for e in fit.estimates], "error": [e.error for e in fit.estimates]}
    return frame([e.name for e in fit.estimates], columns, "parameter")


def plant_fit(fit: PlantFit) -> Any:
    """One row a parameter, fitted ones first, then those that follow from them."""
    every = (*fit.estimates, *fit.derived)
    columns = {"value": [e.value for e in every], "error": [e.error for e in every], "unit": [e.unit for e in every]}
    return frame([e.name for e in every], columns, "parameter")


def refinement(found: Refinement) -> Any:
    """Predicted and measured columns over time in s."""
    return found.replay.to_pandas()


def residuals(found: Residuals) -> Any:
    """Measured value and residual by row."""
    return frame(np.arange(found.values.size), {"measured": found.measured, "residual": found.values}, "row")


def rigid_fit(fit: RigidFit) -> Any:
    """Measured and fitted force over time in s."""
    measured = fit.residuals.measured
    return frame(fit.time, {"measured": measured, "fitted": measured - fit.residuals.values}, "time")


def steady_runs(runs: SteadyRuns) -> Any:
    """One row a run."""
    return frame(runs.velocity, {"force": runs.force, "error": runs.error, "rows": runs.rows}, "velocity")


def validation(found: Validation) -> Any:
    """One row a stretch."""
    return frame(np.arange(1, found.errors.size + 1), {"error": found.errors}, "stretch")


def delay_map(found: DelayMap) -> Any:
    """Both factors over the dead time in s."""
    return frame(found.dead_time, {"edge": found.edge, "robust": found.robust}, "dead_time")


def iteration(found: Iteration) -> Any:
    """The error and the predicted one over time in s."""
    columns = {"following_error": found.trial.following_error, "predicted": found.predicted}
    return frame(found.trial.time, columns, "time")


def placement(found: Placement) -> Any:
    """One row a pole of the sampled loop."""
    return found.stability.to_pandas()


def recipe(found: Recipe) -> Any:
    """One row a gain."""
    law = found.law
    return frame(["Kv", "Kp", "Tn"], {"value": np.array([law.Kv, law.Kp, law.Tn or np.nan])}, "gain")


def tuned(found: Tuned) -> Any:
    """One row a tunable."""
    names = list(found.tunables)
    columns = {
        "today": np.array([found.started[name] for name in names]),
        "new": np.array([found.tunables[name] for name in names]),
    }
    return frame(names, columns, "tunable")


def prefilter_fit(fit: PrefilterFit) -> Any:
    """Error, explained part and prediction in m over time in s."""
    return frame(fit.time, {"error": fit.error, "explained": fit.explained, "predicted": fit.predicted}, "time")


def trial(trial: Trial) -> Any:
    """Setpoint and error over time in s."""
    columns = {f"set_{name}": np.asarray(row) for name, row in zip(Setpoint._fields, trial.setpoint, strict=True)}
    return frame(trial.time, {**columns, "following_error": trial.following_error}, "time")


def trials(trials: Trials) -> Any:
    """One row a trial."""
    errors = {f"error_{name}": values for name, values in trials.errors().items()}
    return frame(np.arange(1, len(trials.trials) + 1), {"rms": trials.rms, **trials.parameters(), **errors}, "trial")


def certificate(found: Certificate) -> Any:
    """One row a plant: reserve, its frequency, largest pole."""
    plants = found.document["plants"]
    columns = {
        "reserve": [np.nan if each["reserve"] is None else each["reserve"] for each in plants],
        "frequency": [each["reserve_at_Hz"] for each in plants],
        "largest_pole": [found.loops[each["name"]].growth for each in plants],
    }
    return frame([each["name"] for each in plants], columns, "plant")


def cosimulation(found: Cosimulation) -> Any:
    """One row a law."""
    figures = [row.figures() for row in found.rows]
    names = np.array([row.name for row in found.rows])
    return frame(names, {key: np.array([each[key] for each in figures]) for key in figures[0]}, "law")


def contour(found: ContourError) -> Any:
    """A row for each sample: path length, error, lag, and the actual position of each axis."""
    columns = {"along_m": found.along, "error_m": found.error, "lag_m": found.lag, "at_corner": found.at_corner}
    columns |= {f"{axis}_m": found.position[:, i] for i, axis in enumerate(found.axes)}
    lines = {} if found.line is None else {"line": found.line}
    return frame(found.time, {**columns, **lines}, "time_s")


def circle_causes(found: CircleCauses) -> Any:
    """A row for each cause; the unit of the value stands beside it."""
    rows = found.causes
    columns = {
        name: [getattr(each, name) for each in rows] for name in ("value", "error", "unit", "effect", "share", "note")
    }
    return frame([each.name for each in rows], columns, "cause")
