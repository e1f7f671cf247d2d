"""Machining: stability of the cut, contour error, circle test, reversal, load and surface."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "circle_causes": "CircleCauses circle_causes",
        "circle_test": "CirclePath CircleTest QuadrantPeak circle_of_run circle_path circle_test quadrant_peaks",
        "contour": "ContourError contour_error",
        "cutting_force": "CuttingForces cutting_forces",
        "elements": "on_part Elements elements",
        "load": "AxisLoad MachineLoad SpindleLoad axis_load machine_load spindle_load",
        "lobes": (
            "ChatterSigns chatter_signs CutStability Lobes ZeroOrder cut_stability semi_discretisation "
            "stability_lobes zero_order"
        ),
        "part_run": "PartRun part_run",
        "regeneration": "Regeneration regeneration",
        "reversal": "Reversals reversals stick_time",
        "surface": "Surface feed_mark runout_mark scallop wall",
        "tool_point": "ToolMode ToolPoint tool_modes tool_point",
    },
)
