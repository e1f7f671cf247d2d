"""Which function draws a type of result, and which makes its DataFrame: by name, so that nothing is imported before.

The first `plot()` of a type imports the module that draws this type, and no other one.
"""

from __future__ import annotations

from importlib import import_module

from feeddrive.language.table import frame_of, picture_of

# module and class of a result -> the function of this package that draws it
PICTURES = {
    "analysis.effort:Effort": "distributions:effort",
    "analysis.friction_map:FrictionMap": "friction:friction_map",
    "analysis.margin_intervals:MarginIntervals": "over_frequency:measured_loop",
    "analysis.margins:Margins": "over_frequency:open_loop",
    "analysis.measured_loop:MeasuredLoop": "over_frequency:measured_loop",
    "analysis.replay:Observation": "tuning:disturbance",
    "analysis.replay:Replay": "over_time:replay",
    "analysis.spectrum:Spectrum": "over_frequency:spectrum",
    "analysis.stability:Encirclement": "complex_plane:encirclement",
    "analysis.stability:Stability": "pole_map:stability",
    "analysis.step_response:StepResponse": "settling:step_response",
    "analysis.stiffness:Stiffness": "over_frequency:stiffness",
    "certificate.certificate:Certificate": "certificate:certificate",
    "cosimulation.simulate_with_fmu:Cosimulation": "over_time:cosimulation",
    "files.guess:Guess": "over_time:guess",
    "files.log:Log": "over_time:log",
    "identification.cogging:CoggingFit": "identification:cogging",
    "identification.excitation.excitation:Excitation": "responses:excitation",
    "identification.excitation.frequency_estimate:FrequencyEstimate": "responses:frequency_estimate",
    "identification.friction_curve:FrictionCurve": "friction:identified_friction",
    "identification.friction_curve:SteadyRuns": "friction:steady_runs",
    "identification.motion.control_law:ControlFit": "identification:control_fit",
    "identification.motion.delay:DelayFit": "identification:delay_fit",
    "identification.motion.identify:Identified": "identification:identified",
    "identification.motion.output_error:Refinement": "over_time:refinement",
    "identification.motion.rigid:RigidFit": "identification:rigid_fit",
    "identification.regression:Residuals": "identification:residuals",
    "identification.regression:Validation": "identification:validation",
    "identification.response.agreement:Agreement": "responses:response_fit",
    "identification.response.fit_axis:AxisFits": "responses:axis_fits",
    "identification.response.modal_fit:ModalFit": "responses:fitted",
    "identification.response.plant_fit:PlantFit": "responses:fitted",
    "loop.frequency_response:FRF": "over_frequency:bode",
    "loop.gradient:Gradient": "distributions:gradient",
    "loop.linearize:StateSpace": "pole_map:poles",
    "loop.simulate:Batch": "distributions:batch",
    "loop.simulate:Run": "over_time:run",
    "machining.chatter_signs:ChatterSigns": "lobes:chatter_signs",
    "machining.cutting_force:CuttingForces": "lobes:cutting_forces",
    "machining.circle_causes:CircleCauses": "circle:circle_causes",
    "machining.circle_test:CircleTest": "circle:circle_test",
    "machining.contour:ContourError": "contour:contour",
    "machining.load:AxisLoad": "circle:axis_load",
    "machining.lobes:Lobes": "lobes:lobes",
    "machining.part_run:PartRun": "part_run:part_run",
    "machining.surface:Surface": "surface:surface",
    "machining.reversal:Reversals": "circle:reversals",
    "path.planned:Planned": "planned:planned",
    "tuning.delay_map:DelayMap": "tuning:delay_map",
    "learning.iterative_feedforward:Iteration": "tuning:iteration",
    "tuning.placement:Placement": "pole_map:placement",
    "tuning.recipes:Recipe": "over_frequency:recipe",
    "learning.trajectory_prefilter:PrefilterFit": "tuning:prefilter_fit",
    "learning.trial:Trial": "tuning:trial",
    "learning.trials:Trials": "tuning:trials",
    "tuning.tuned:CascadeLoops": "over_frequency:cascade_loops",
    "tuning.tuned:Tuned": "over_frequency:tuned",
}

# the same for the functions of `frames.py`
FRAMES = {
    "analysis.effort:Effort": "effort",
    "analysis.friction_map:FrictionMap": "friction_map",
    "analysis.margin_intervals:MarginIntervals": "margin_intervals",
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
    "identification.motion.control_law:ControlFit": "control_fit",
    "identification.motion.delay:DelayFit": "delay_fit",
    "identification.motion.identify:Identified": "identified",
    "identification.motion.output_error:Refinement": "refinement",
    "identification.motion.rigid:RigidFit": "rigid_fit",
    "identification.regression:Residuals": "residuals",
    "identification.regression:Validation": "validation",
    "identification.response.agreement:Agreement": "agreement",
    "identification.response.fit_axis:AxisFits": "axis_fits",
    "identification.response.modal_fit:ModalFit": "modal_fit",
    "identification.response.plant_fit:PlantFit": "plant_fit",
    "loop.frequency_response:FRF": "frf",
    "loop.gradient:Gradient": "gradient",
    "loop.linearize:StateSpace": "state_space",
    "loop.simulate:Batch": "batch",
    "loop.simulate:Run": "run",
    "machining.cutting_force:CuttingForces": "cutting_forces",
    "machining.circle_causes:CircleCauses": "circle_causes",
    "machining.contour:ContourError": "contour",
    "machining.lobes:Lobes": "lobes",
    "tuning.delay_map:DelayMap": "delay_map",
    "learning.iterative_feedforward:Iteration": "iteration",
    "tuning.placement:Placement": "placement",
    "tuning.recipes:Recipe": "recipe",
    "learning.trajectory_prefilter:PrefilterFit": "prefilter_fit",
    "learning.trial:Trial": "trial",
    "learning.trials:Trials": "trials",
    "tuning.tuned:Tuned": "tuned",
}


def register(kind: type) -> None:
    """Import and register what draws and frames a type of result, or the nearest of its bases that is listed."""
    for base in kind.__mro__:
        name = f"{base.__module__.removeprefix('feeddrive.')}:{base.__qualname__}"
        if name in PICTURES and base not in picture_of.registry:
            module, function = PICTURES[name].split(":")
            picture_of.register(base, getattr(import_module(f"feeddrive.plot.{module}"), function))
        if name in FRAMES and base not in frame_of.registry:
            frame_of.register(base, getattr(import_module("feeddrive.plot.frames"), FRAMES[name]))
