"""Which function draws a type of result, and which makes its DataFrame: by name, so that nothing is imported before.

The first `plot()` of a type imports the module that draws this type, and no other one.
"""

from __future__ import annotations

from importlib import import_module

from feeddrive.language.table import frame_of, picture_of

# module and class of a result -> the function of this package that draws it
PICTURES = {
    "analysis.effort:Effort": "distributions:effort",
    "analysis.friction_map:FrictionMap": "identification:friction_map",
    "analysis.margin_intervals:MarginIntervals": "over_frequency:measured_loop",
    "analysis.margins:Margins": "over_frequency:open_loop",
    "analysis.measured_loop:MeasuredLoop": "over_frequency:measured_loop",
    "analysis.replay:Observation": "tuning:disturbance",
    "analysis.replay:Replay": "over_time:replay",
    "analysis.spectrum:Spectrum": "over_frequency:spectrum",
    "analysis.stability:Encirclement": "complex_plane:encirclement",
    "analysis.stability:Stability": "complex_plane:stability",
    "analysis.stiffness:Stiffness": "over_frequency:stiffness",
    "certificate.certificate:Certificate": "certificate:certificate",
    "cosimulation.simulate_with_fmu:Cosimulation": "over_time:cosimulation",
    "files.guess:Guess": "over_time:guess",
    "files.log:Log": "over_time:log",
    "identification.cogging:CoggingFit": "identification:cogging",
    "identification.excitation.excitation:Excitation": "responses:excitation",
    "identification.excitation.frequency_estimate:FrequencyEstimate": "responses:frequency_estimate",
    "identification.friction_curve:FrictionCurve": "identification:identified_friction",
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
    "identification.steady_runs:SteadyRuns": "identification:steady_runs",
    "loop.frequency_response:FRF": "over_frequency:bode",
    "loop.gradient:Gradient": "distributions:gradient",
    "loop.linearize:StateSpace": "complex_plane:poles",
    "loop.simulate:Batch": "distributions:batch",
    "loop.simulate:Run": "over_time:run",
    "machining.part_run:PartRun": "part_run:part_run",
