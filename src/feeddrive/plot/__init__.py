"""Charts, figures and data frames of results; `Result.chart()`, `.plot()` and `.to_pandas()` select them by type.

A chart is a value (`chart.py`): `bode_chart(response)` returns the content of the figure `bode(response)`. `drawn`
draws any chart with matplotlib's object API. The resulting figure displays itself in a notebook and is saved with
`savefig`. Importing this package does not import matplotlib, pandas or the modules of the charts.
"""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "chart": "Chart",
        "complex_plane": (
            "certificate certificate_chart certificate_discs certificate_discs_chart nyquist nyquist_chart "
            "poles poles_chart"
        ),
        "curves": "batch batch_chart effort effort_chart gradient gradient_chart",
        "drawing": "drawn",
        "identification": (
            "friction friction_chart identified_friction identified_friction_chart steady_runs "
            "steady_runs_chart cogging cogging_chart cogging_over_turn cogging_over_turn_chart control_fit "
            "control_fit_chart delay_fit delay_fit_chart pooled pooled_chart residuals residuals_chart "
            "rigid_fit rigid_fit_chart validation validation_chart"
        ),
        "machining": (
            "axis_load axis_load_chart circle_causes circle_causes_chart circle_test circle_test_chart "
            "circle_unrolled circle_unrolled_chart held_tip held_tip_chart reversals reversals_chart "
            "chatter_signs chatter_signs_chart lobes lobes_chart"
        ),
        "over_frequency": (
            "bode bode_chart closed_loop closed_loop_chart open_loop open_loop_chart sensitivity "
            "sensitivity_chart spectrum spectrum_chart stiffness stiffness_chart excitation excitation_chart "
            "frequency_estimate frequency_estimate_chart response_fit response_fit_chart response_nyquist "
            "response_nyquist_chart response_residuals response_residuals_chart"
        ),
        "over_time": (
            "comparison comparison_chart following_error following_error_chart force force_chart log log_chart "
            "motion motion_chart preview preview_chart replay replay_chart run run_chart"
        ),
        "part_program": (
            "contour contour_chart contour_on_path contour_on_path_chart corner_zoom corner_zoom_chart "
            "part_cutting part_cutting_chart part_estimates part_estimates_chart part_laws part_laws_chart "
            "corrected corrected_chart corrected_path corrected_path_chart learned learned_chart "
            "part_run part_run_chart part_zoom part_zoom_chart plan_axes plan_axes_chart plan_causes plan_causes_chart "
            "plan_feed plan_feed_chart plan_joints plan_joints_chart plan_losses plan_losses_chart "
            "plan_profiles plan_profiles_chart planned planned_chart tip_error tip_error_chart "
            "tip_joints tip_joints_chart"
        ),
        "tuning": (
            "delay_map delay_map_chart disturbance disturbance_chart in_time in_time_chart iteration "
            "iteration_chart prefilter_fit prefilter_fit_chart travel travel_chart trial trial_chart "
            "trials trials_chart"
        ),
    },
)
