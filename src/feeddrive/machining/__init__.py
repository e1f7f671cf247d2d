"""The machine that cuts: stability of the cut, contour error, circle test, reversal, load and surface."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "chatter_signs": "ChatterSigns chatter_signs",
        "circle_causes": "CircleCauses circle_causes",
        "circle_test": "CirclePath CircleTest circle_of_run circle_path circle_test",
        "contour": "ContourError contour_error",
        "cutting_force": "CuttingForces cutting_forces",
        "elements": "Elements elements",
        "load": "AxisLoad MachineLoad SpindleLoad axis_load machine_load spindle_load",
        "lobe_theory": "ZeroOrder semi_discretisation zero_order",
        "lobes": "CutStability Lobes cut_stability stability_lobes",
        "part_run": "PartRun part_run",
        "quadrant_peaks": "QuadrantPeak quadrant_peaks",
        "regeneration": "Regeneration regeneration",
        "reversal": "Reversals reversals stick_time",
        "surface": "Surface feed_mark runout_mark scallop wall",
        "tool_point": "ToolMode ToolPoint tool_modes tool_point",
    },
)
