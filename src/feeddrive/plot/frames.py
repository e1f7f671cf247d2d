"""Results as pandas frames, one function for each type of result; pandas is an extra and loaded when asked for.

Columns are in SI but where their name says another unit; `Result.to_pandas()` calls these functions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from feeddrive.analysis.effort import Effort
from feeddrive.analysis.friction_map import FrictionMap
from feeddrive.analysis.margin_intervals import MarginIntervals
from feeddrive.analysis.margins import Margins
from feeddrive.analysis.measured_loop import MeasuredLoop
from feeddrive.analysis.replay import Observation, Replay
from feeddrive.analysis.spectrum import Spectrum
from feeddrive.analysis.stability import Encirclement, Stability
from feeddrive.analysis.stiffness import Stiffness
from feeddrive.blocks.signals import Setpoint
from feeddrive.certificate.certificate import Certificate
from feeddrive.cosimulation.simulate_with_fmu import Cosimulation
from feeddrive.files.log import Log
from feeddrive.identification.cogging import CoggingFit
from feeddrive.identification.excitation.excitation import Excitation
from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate
from feeddrive.identification.friction_curve import FrictionCurve
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
from feeddrive.identification.steady_runs import SteadyRuns
from feeddrive.language.errors import MissingExtraError
from feeddrive.language.table import frame_of
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.gradient import Gradient
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.simulate import Batch, Run
from feeddrive.tuning.delay_map import DelayMap
from feeddrive.tuning.iterative_feedforward import Iteration
from feeddrive.tuning.placement import Placement
from feeddrive.tuning.recipes import Recipe
from feeddrive.tuning.trajectory_prefilter import PrefilterFit
from feeddrive.tuning.trial import Trial
from feeddrive.tuning.trials import Trials
from feeddrive.tuning.tuned import Tuned


def frame(index: Sequence[Any] | np.ndarray, columns: Mapping[str, Any], index_name: str) -> Any:
    """A DataFrame over a named index. Raises MissingExtraError without pandas."""
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("pandas", "pandas", "a DataFrame") from error
    return pandas.DataFrame(dict(columns), index=pandas.Index(index, name=index_name))


@frame_of.register
def _run(run: Run) -> Any:
    """One column a signal, over time in s."""
    return frame(run.time, run.signals, "time")


@frame_of.register
def _batch(batch: Batch) -> Any:
    """One row a variant."""
    columns = {f"rms_{name}": values for name, values in batch.rms.items()}
    columns |= {f"peak_{name}": values for name, values in batch.peak.items()}
    return frame(np.arange(batch.left.size), {**columns, "left": batch.left}, "variant")


@frame_of.register
def _state_space(model: StateSpace) -> Any:
    """One row a pole."""
    poles = model.poles()
    return frame(np.arange(poles.size), {"real": np.real(poles), "imaginary": np.imag(poles)}, "pole")


@frame_of.register
def _gradient(found: Gradient) -> Any:
    """One row a parameter."""
    columns = {"value": np.array(list(found.values.values())), "slope": np.array(list(found.gradient.values()))}
    return frame(np.array(list(found.gradient)), columns, "parameter")


@frame_of.register
def _frf(frf: FRF) -> Any:
    """Real and imaginary part, and coherence and variance if known, over frequency in Hz."""
    columns = {"real": np.real(frf.response), "imaginary": np.imag(frf.response)}
    measured = {"coherence": frf.coherence, "variance": frf.variance}
    columns |= {name: values for name, values in measured.items() if values is not None}
    return frame(frf.frequency, columns, "frequency")


@frame_of.register
def _effort(effort: Effort) -> Any:
    """One row a kind of operation."""
    return frame(list(effort.operations), {"number": list(effort.operations.values())}, "operation")


@frame_of.register
def _friction_map(found: FrictionMap) -> Any:
    """One row a velocity."""
    columns = {"force": found.force, "deviation": found.deviation, "count": found.count}
    return frame(found.velocity, columns, "velocity")


@frame_of.register
def _margins(margins: Margins) -> Any:
    """One row a crossover; what a kind of crossover does not have is missing."""
    gain, phase = margins.gain_crossovers, margins.phase_crossovers
    gap = [None] * len(phase)
    columns = {
        "kind": ["gain crossover"] * len(gain) + ["phase crossover"] * len(phase),
        "phase_margin_deg": [c.phase_margin_deg for c in gain] + gap,
        "delay_margin": [c.delay_margin for c in gain] + gap,
        "gain_margin_dB": [None] * len(gain) + [c.gain_margin_dB for c in phase],
    }
    return frame([c.frequency for c in (*gain, *phase)], columns, "frequency")


@frame_of.register
def _margin_intervals(found: MarginIntervals) -> Any:
    """One row a figure."""
    every = list(found.intervals.values())
    columns = {"value": [e.value for e in every], "low": [e.low for e in every], "high": [e.high for e in every]}
    return frame(list(found.intervals), columns, "figure")


@frame_of.register(Encirclement)
@frame_of.register(MeasuredLoop)
def _loop_gain(found: Encirclement | MeasuredLoop) -> Any:
    """Real and imaginary part of L over frequency in Hz."""
    return frame_of(found.loop_gain)


@frame_of.register
def _observation(found: Observation) -> Any:
    """Position, velocity and disturbance over time in s."""
    columns = {"position": found.position, "velocity": found.velocity, "disturbance": found.disturbance}
    return frame(found.time, columns, "time")


@frame_of.register
def _replay(replay: Replay) -> Any:
    """Predicted and measured columns over time in s."""
    columns = {f"predicted_{name}": replay.run[name] for name in replay.measured}
    columns |= {f"measured_{name}": values for name, values in replay.measured.items()}
    return frame(replay.run.time, columns, "time")


@frame_of.register
def _spectrum(found: Spectrum) -> Any:
    """Amplitude and cumulative RMS over frequency in Hz."""
    columns = {"amplitude": found.amplitude, "cumulative_rms": found.cumulative_rms}
    return frame(found.frequency, columns, "frequency")


@frame_of.register
def _stability(found: Stability) -> Any:
    """One row a pole."""
    return frame_of(found.model)


@frame_of.register
def _stiffness(found: Stiffness) -> Any:
    """The stiffness in N/m over frequency in Hz."""
    return frame(found.frequency, {"stiffness": found.magnitude}, "frequency")


@frame_of.register
def _log(log: Log) -> Any:
    """One column a channel, over time in s."""
    return frame(log.time, log.channels, "time")


@frame_of.register
def _agreement(found: Agreement) -> Any:
    """Measured and fitted response over frequency in Hz, one response below the other."""
    columns = {
        "response": np.concatenate([np.full(m.frequency.size, i) for i, m in enumerate(found.measured)]),
        "measured_real": np.concatenate([np.real(m.response) for m in found.measured]),
        "measured_imaginary": np.concatenate([np.imag(m.response) for m in found.measured]),
        "fitted_real": np.concatenate([np.real(m.response) for m in found.fitted]),
        "fitted_imaginary": np.concatenate([np.imag(m.response) for m in found.fitted]),
    }
    return frame(np.concatenate([m.frequency for m in found.measured]), columns, "frequency")


@frame_of.register
def _cogging(fit: CoggingFit) -> Any:
    """One row an order."""
    rows = sorted(fit.orders, key=lambda each: each.order)
    pick = {"forward": "forward", "backward": "backward", "cogging": "even", "friction_like": "odd"}
    columns = {
        name: np.array([np.nan if (e := getattr(each, field)) is None else e.value for each in rows])
        for name, field in pick.items()
    }
    return frame(np.array([each.order for each in rows]), columns, "order")


@frame_of.register
def _control_fit(found: ControlFit) -> Any:
    """One row for each law that was tried."""
    columns = {
        "velocity_samples": np.array([n for n, _ in found.tried]),
        "delay": np.array([d for _, d in found.tried]),
        "residual": np.array(list(found.tried.values())),
    }
    return frame(np.arange(len(found.tried)), columns, "law")


@frame_of.register
def _delay_fit(found: DelayFit) -> Any:
    """One row a delay."""
    return frame(found.delays, {"residual": found.residual}, "samples")


@frame_of.register
def _excitation(found: Excitation) -> Any:
    """The first realization over time in s."""
    drawn = found.drawings[0]
    return frame(drawn.time, {"excitation": drawn.excitation, **drawn.signals}, "time")


@frame_of.register
def _axis_fits(found: AxisFits) -> Any:
    """The parameters of the chosen fit."""
    return frame_of(found.fit)


@frame_of.register
def _frequency_estimate(found: FrequencyEstimate) -> Any:
    """Response, coherence, variance and noise variance over frequency in Hz."""
    return frame_of(found.frf).assign(noise_variance=found.noise, freedom=found.freedom)


@frame_of.register
def _friction_curve(curve: FrictionCurve) -> Any:
    """Measured and fitted force by velocity."""
    columns = {"force": curve.runs.force, "fitted": curve.runs.force - curve.residual}
    return frame(curve.runs.velocity, columns, "velocity")


@frame_of.register
def _identified(found: Identified) -> Any:
    """Measured and fitted force over time in s."""
    return frame_of(found.rigid)


@frame_of.register
def _modal_fit(fit: ModalFit) -> Any:
    """One row a parameter."""
    columns = {"value": [e.value for e in fit.estimates], "error": [e.error for e in fit.estimates]}
    return frame([e.name for e in fit.estimates], columns, "parameter")


@frame_of.register
def _plant_fit(fit: PlantFit) -> Any:
    """One row a parameter, fitted ones first, then those that follow from them."""
    every = (*fit.estimates, *fit.derived)
    columns = {"value": [e.value for e in every], "error": [e.error for e in every], "unit": [e.unit for e in every]}
    return frame([e.name for e in every], columns, "parameter")


@frame_of.register
def _refinement(found: Refinement) -> Any:
    """Predicted and measured columns over time in s."""
    return frame_of(found.replay)


@frame_of.register
def _residuals(found: Residuals) -> Any:
    """Measured value and residual by row."""
    return frame(np.arange(found.values.size), {"measured": found.measured, "residual": found.values}, "row")


@frame_of.register
def _rigid_fit(fit: RigidFit) -> Any:
    """Measured and fitted force over time in s."""
    measured = fit.residuals.measured
    return frame(fit.time, {"measured": measured, "fitted": measured - fit.residuals.values}, "time")


@frame_of.register
def _steady_runs(runs: SteadyRuns) -> Any:
    """One row a run."""
    return frame(runs.velocity, {"force": runs.force, "error": runs.error, "rows": runs.rows}, "velocity")


@frame_of.register
def _validation(found: Validation) -> Any:
    """One row a stretch."""
    return frame(np.arange(1, found.errors.size + 1), {"error": found.errors}, "stretch")


@frame_of.register
def _delay_map(found: DelayMap) -> Any:
    """Both factors over the dead time in s."""
    return frame(found.dead_time, {"edge": found.edge, "robust": found.robust}, "dead_time")


@frame_of.register
def _iteration(found: Iteration) -> Any:
    """The error and the predicted one over time in s."""
    columns = {"following_error": found.trial.following_error, "predicted": found.predicted}
    return frame(found.trial.time, columns, "time")


@frame_of.register
def _placement(found: Placement) -> Any:
    """One row a pole of the sampled loop."""
    return frame_of(found.stability)


@frame_of.register
def _recipe(found: Recipe) -> Any:
    """One row a gain."""
    law = found.law
    return frame(["Kv", "Kp", "Tn"], {"value": np.array([law.Kv, law.Kp, law.Tn or np.nan])}, "gain")


@frame_of.register
def _tuned(found: Tuned) -> Any:
    """One row a tunable."""
    names = list(found.tunables)
    columns = {
        "today": np.array([found.started[name] for name in names]),
        "new": np.array([found.tunables[name] for name in names]),
    }
    return frame(names, columns, "tunable")


@frame_of.register
def _prefilter_fit(fit: PrefilterFit) -> Any:
    """Error, explained part and prediction in m over time in s."""
    return frame(fit.time, {"error": fit.error, "explained": fit.explained, "predicted": fit.predicted}, "time")


@frame_of.register
def _trial(trial: Trial) -> Any:
    """Setpoint and error over time in s."""
    columns = {f"set_{name}": np.asarray(row) for name, row in zip(Setpoint._fields, trial.setpoint, strict=True)}
    return frame(trial.time, {**columns, "following_error": trial.following_error}, "time")


@frame_of.register
def _trials(trials: Trials) -> Any:
    """One row a trial."""
    errors = {f"error_{name}": values for name, values in trials.errors().items()}
    return frame(np.arange(1, len(trials.trials) + 1), {"rms": trials.rms, **trials.parameters(), **errors}, "trial")


@frame_of.register
def _certificate(found: Certificate) -> Any:
    """One row a plant: reserve, its frequency, largest pole."""
    plants = found.document["plants"]
    columns = {
        "reserve": [np.nan if each["reserve"] is None else each["reserve"] for each in plants],
        "frequency": [each["reserve_at_Hz"] for each in plants],
        "largest_pole": [found.loops[each["name"]].growth for each in plants],
    }
    return frame([each["name"] for each in plants], columns, "plant")


@frame_of.register
def _cosimulation(found: Cosimulation) -> Any:
    """One row a law."""
    figures = [row.figures() for row in found.rows]
    names = np.array([row.name for row in found.rows])
    return frame(names, {key: np.array([each[key] for each in figures]) for key in figures[0]}, "law")
