"""Analysis of loops and signals: margins, sensitivity, stiffness, spectrum, stability, friction map."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "contour_control": "ContourGain MatchedDynamics contour_gain contour_gains matched_dynamics",
        "conversion": "as_frf",
        "friction_map": "FrictionMap friction_map",
        "margins": (
            "coprime_margin MarginIntervals margin_intervals Margins complementary_sensitivity margins sensitivity"
        ),
        "measured_loop": "MeasuredLoop measured_loop",
        "oscilloscope": "Oscilloscope readout Trigger",
        "replay": "Observation Replay observe replay",
        "spectrum": "Spectrum spectrum",
        "stability": "Encirclement Stability encirclement stability",
        "step_response": "StepResponse step_response",
        "stiffness": "Stiffness stiffness",
    },
)
