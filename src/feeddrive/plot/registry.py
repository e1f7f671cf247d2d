"""Tables that map result types to the functions of their charts and data frames, by name.

The first `chart()` or `plot()` of a type imports only the module of its chart.
"""

from importlib import import_module

from feeddrive.language.table import chart_of, frame_of

# module and class of a result -> chart function of this package
# by name: the classes themselves would import every room
CHARTS = {
    "analysis.effort:Effort": "curves:effort_chart",
    "analysis.friction_map:FrictionMap": "identification:friction_map_chart",
    "analysis.margins:MarginIntervals": "over_frequency:measured_loop_chart",
    "analysis.margins:Margins": "over_frequency:open_loop_chart",
    "analysis.measured_loop:MeasuredLoop": "over_frequency:measured_loop_chart",
    "analysis.replay:Observation": "tuning:disturbance_chart",
    "analysis.replay:Replay": "over_time:replay_chart",
    "analysis.spectrum:Spectrum": "over_frequency:spectrum_chart",
    "analysis.stability:Encirclement": "complex_plane:encirclement_chart",
    "analysis.stability:Stability": "complex_plane:stability_chart",
    "analysis.step_response:StepResponse": "over_time:step_response_chart",
    "analysis.stiffness:Stiffness": "over_frequency:stiffness_chart",
    "certificate.certificate:Certificate": "complex_plane:certificate_chart",
    "commissioning.record:Commissioned": "commissioning:commissioned_chart",
    "cosimulation.simulate_with_fmu:Cosimulation": "over_time:cosimulation_chart",
    "files.mapping:Guess": "over_time:guess_chart",
    "files.log:Log": "over_time:log_chart",
    "files.preview:Preview": "over_time:preview_chart",
    "identification.cogging:CoggingFit": "identification:cogging_chart",
    "identification.excitation.excitation:Excitation": "over_frequency:excitation_chart",
    "identification.excitation.frequency_estimate:FrequencyEstimate": "over_frequency:frequency_estimate_chart",
    "identification.friction_curve:FrictionCurve": "identification:identified_friction_chart",
    "identification.motion.identify_law:ControlFit": "identification:control_fit_chart",
    "identification.motion.rigid:DelayFit": "identification:delay_fit_chart",
    "identification.motion.identify:Identified": "identification:identified_chart",
    "identification.motion.output_error:Refinement": "over_time:refinement_chart",
    "identification.motion.pooled:PooledFit": "identification:pooled_chart",
    "identification.motion.rigid:RigidFit": "identification:rigid_fit_chart",
    "identification.regression:Residuals": "identification:residuals_chart",
    "identification.regression:Validation": "identification:validation_chart",
    "identification.response.agreement:Agreement": "over_frequency:response_fit_chart",
    "identification.response.plant_fit:AxisFits": "over_frequency:axis_fits_chart",
    "identification.response.modal_fit:ModalFit": "over_frequency:fitted_chart",
    "identification.response.plant_fit:PlantFit": "over_frequency:fitted_chart",
    "identification.friction_curve:SteadyRuns": "identification:steady_runs_chart",
    "learning.part_correction:CorrectedProgram": "part_program:corrected_chart",
    "learning.part_log:LearnedPart": "part_program:learned_chart",
    "loop.frequency_response:FRF": "over_frequency:bode_chart",
    "loop.gradient:Gradient": "curves:gradient_chart",
    "loop.linearize:StateSpace": "complex_plane:poles_chart",
    "loop.simulate:Batch": "curves:batch_chart",
    "loop.simulate:Run": "over_time:run_chart",
    "machining.lobes:ChatterSigns": "machining:chatter_signs_chart",
    "machining.cutting_force:CuttingForces": "machining:cutting_forces_chart",
    "machining.circle_test:CircleCauses": "machining:circle_causes_chart",
    "machining.circle_test:CircleTest": "machining:circle_test_chart",
    "machining.contour:ContourError": "part_program:contour_chart",
    "machining.held_tip:HeldTip": "machining:held_tip_chart",
    "machining.load:AxisLoad": "machining:axis_load_chart",
    "machining.lobes:Lobes": "machining:lobes_chart",
    "machining.part_run:PartRun": "part_program:part_run_chart",
    "machining.tip_error:TipError": "part_program:tip_error_chart",
    "machining.cutting_force:Surface": "curves:surface_chart",
    "machining.reversal:Reversals": "machining:reversals_chart",
    "path.planned:Planned": "part_program:planned_chart",
    "tuning.scaling:DelayMap": "tuning:delay_map_chart",
    "learning.iterative_feedforward:Iteration": "tuning:iteration_chart",
    "tuning.poles:Placement": "complex_plane:placement_chart",
    "tuning.recipes:Recipe": "over_frequency:recipe_chart",
    "learning.trajectory_prefilter:PrefilterFit": "tuning:prefilter_fit_chart",
    "learning.trial:Trial": "tuning:trial_chart",
    "learning.trials:Trials": "tuning:trials_chart",
    "tuning.travel:TunedTravel": "tuning:travel_chart",
    "tuning.tune:CascadeLoops": "over_frequency:cascade_loops_chart",
    "tuning.tune:Tuned": "over_frequency:tuned_chart",
}

# the same for the functions of `frames.py`
FRAMES = {
    "analysis.effort:Effort": "effort",
    "analysis.friction_map:FrictionMap": "friction_map",
    "analysis.margins:MarginIntervals": "margin_intervals",
    "analysis.margins:Margins": "margins",
    "analysis.measured_loop:MeasuredLoop": "loop_gain",
    "analysis.replay:Observation": "observation",
    "analysis.replay:Replay": "replay",
    "analysis.spectrum:Spectrum": "spectrum",
    "analysis.stability:Encirclement": "loop_gain",
    "analysis.stability:Stability": "stability",
    "analysis.step_response:StepResponse": "step_response",
    "analysis.stiffness:Stiffness": "stiffness",
    "certificate.certificate:Certificate": "certificate",
    "cosimulation.simulate_with_fmu:Cosimulation": "cosimulation",
    "files.log:Log": "log",
    "identification.cogging:CoggingFit": "cogging",
    "identification.excitation.excitation:Excitation": "excitation",
    "identification.excitation.frequency_estimate:FrequencyEstimate": "frequency_estimate",
    "identification.friction_curve:FrictionCurve": "friction_curve",
    "identification.friction_curve:SteadyRuns": "steady_runs",
    "identification.motion.identify_law:ControlFit": "control_fit",
    "identification.motion.rigid:DelayFit": "delay_fit",
    "identification.motion.identify:Identified": "identified",
    "identification.motion.output_error:Refinement": "refinement",
    "identification.motion.rigid:RigidFit": "rigid_fit",
    "identification.regression:Residuals": "residuals",
    "identification.regression:Validation": "validation",
    "identification.response.agreement:Agreement": "agreement",
    "identification.response.plant_fit:AxisFits": "axis_fits",
    "identification.response.modal_fit:ModalFit": "modal_fit",
    "identification.response.plant_fit:PlantFit": "plant_fit",
    "loop.frequency_response:FRF": "frf",
    "loop.gradient:Gradient": "gradient",
    "loop.linearize:StateSpace": "state_space",
    "loop.simulate:Batch": "batch",
    "loop.simulate:Run": "run",
    "machining.cutting_force:CuttingForces": "cutting_forces",
    "machining.circle_test:CircleCauses": "circle_causes",
    "machining.contour:ContourError": "contour",
    "machining.lobes:Lobes": "lobes",
    "tuning.scaling:DelayMap": "delay_map",
    "learning.iterative_feedforward:Iteration": "iteration",
    "tuning.poles:Placement": "placement",
    "tuning.recipes:Recipe": "recipe",
    "learning.trajectory_prefilter:PrefilterFit": "prefilter_fit",
    "learning.trial:Trial": "trial",
    "learning.trials:Trials": "trials",
    "tuning.tune:Tuned": "tuned",
}


def register(kind: type) -> None:
    """Import and register the chart and data-frame functions of a result type and of its listed base classes."""
    for base in kind.__mro__:
        name = f"{base.__module__.removeprefix('feeddrive.')}:{base.__qualname__}"
        if name in CHARTS and base not in chart_of.registry:
            module, function = CHARTS[name].split(":")
            chart_of.register(base, getattr(import_module(f"feeddrive.plot.{module}"), function))
        if name in FRAMES and base not in frame_of.registry:
            frame_of.register(base, getattr(import_module("feeddrive.plot.frames"), FRAMES[name]))
