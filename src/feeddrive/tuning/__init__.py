"""Tuning of controls: optimization within robustness limits, and classical tuning rules."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "criteria": "Limits",
        "operating_point": "OperatingPoint measured_point modelled_point",
        "poles": "Placement placement",
        "recipes": "Recipe half_antiresonance kv_rule makers_rule margin_goals symmetric_optimum",
        "scaling": "DelayMap delay_map",
        "travel": "Travel TunedTravel along_travel frozen tune_travel",
        "tune": "Tuned assess tune_control",
        "worst": "OverBox",
    },
)
