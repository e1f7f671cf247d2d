"""Machining: stability of the cut, contour error, circle test, reversal, load and surface."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "circle_test": (
            "CircleCauses circle_causes CirclePath CircleTest QuadrantPeak circle_of_run circle_path "
            "circle_test quadrant_peaks"
        ),
        "contour": "ContourError contour_error",
        "cutting_force": "CuttingForces cutting_forces Surface feed_mark runout_mark scallop wall",
        "held_tip": "HeldTip held_tip_test",
        "load": "AxisLoad MachineLoad SpindleLoad axis_load machine_load spindle_load",
        "lobes": (
            "ChatterSigns chatter_signs CutStability Lobes ZeroOrder cut_stability semi_discretisation "
            "stability_lobes zero_order"
        ),
        "pivots": "PivotError held_tip_error with_pivot_errors",
        "part_run": "on_part Elements elements PartRun part_run",
        "regeneration": "Regeneration regeneration",
        "reversal": "Reversals reversals stick_time",
        "tip_error": "TipError tip_error",
        "tool_point": "ToolMode ToolPoint tool_modes tool_point",
    },
)
