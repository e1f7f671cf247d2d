"""Tuning of controls: optimization within robustness limits, and tuning rules."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "delay_map": "DelayMap delay_map",
        "limits": "Limits",
        "operating_point": "OperatingPoint measured_point modelled_point",
        "placement": "Placement placement",
        "recipes": "Recipe half_antiresonance kv_rule makers_rule margin_goals symmetric_optimum",
        "tune": "assess tune_control",
        "tuned": "Tuned",
    },
)
