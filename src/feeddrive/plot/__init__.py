"""Figures and DataFrames of results; `Result.plot()` and `.to_pandas()` find them in `registry.py` by type.

A picture is drawn with matplotlib's object API: a figure that shows itself in a notebook and writes itself with
`savefig`.  Importing this package does not import matplotlib or pandas, nor the modules that draw.
"""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "certificate": "certificate certificate_discs",
        "circle": "axis_load circle_causes circle_test circle_unrolled reversals",
        "complex_plane": "nyquist",
        "contour": "contour contour_on_path corner_zoom",
        "distributions": "batch effort gradient",
        "friction": "friction identified_friction steady_runs",
        "identification": "cogging cogging_over_turn control_fit delay_fit residuals rigid_fit validation",
        "lobes": "chatter_signs lobes",
        "over_frequency": "bode closed_loop open_loop sensitivity spectrum stiffness",
        "over_time": "comparison following_error force log motion replay run",
        "part_run": "part_cutting part_estimates part_laws part_run part_zoom",
        "planned": "plan_causes plan_profiles planned",
        "pole_map": "poles",
        "responses": "excitation frequency_estimate response_fit response_nyquist response_residuals",
        "tuning": "delay_map disturbance in_time iteration prefilter_fit trial trials",
    },
)
