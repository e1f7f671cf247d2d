"""Identification: models with standard errors from motion logs, constant-speed runs and frequency responses."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "cogging": "CoggingFit CoggingRun cogging_passes identify_cogging",
        "excitation.estimate_frf": "estimate_frf",
        "excitation.excitation": "Excitation design_excitation",
        "excitation.frequency_estimate": "FrequencyEstimate Record",
        "friction_curve": (
            "FrictionCurve SteadyRuns fit_friction runs_of steady_runs LearnedStops learned_stops stretches"
        ),
        "motion.identify": "Identified identify_motion",
        "motion.identify_law": "ControlFit LawReading identify_control",
        "motion.motion_log": "MotionLog Preparation",
        "motion.output_error": "Refinement refine",
        "motion.pooled": "IdentifiedLogs PooledFit identify_logs identify_pooled",
        "motion.rigid": "DelayFit find_delay RigidFit identify_rigid",
        "pitch": "LearnedPitch learned_from learned_from_circles learned_pitch",
        "response.modal_fit": "fit_modes",
        "response.plant_fit": "fit_axis fit_modal_axis fit_plant fit_two_mass",
        "travel": "TravelFit fit_over_travel",
    },
)
