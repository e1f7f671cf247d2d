"""Tuning of controls: optimization within robustness limits, tuning rules, and iterative learning."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "delay_map": "DelayMap delay_map",
        "error_model": "error_model",
        "filtered_splines": "filtered_splines",
        "iterative_feedforward": "Iteration begin_compensation compensated next_iteration",
        "limits": "Limits",
        "machine_trials": "MachineTrials iterate_machine tune_prefilters",
        "operating_point": "OperatingPoint measured_point modelled_point",
        "placement": "Placement placement",
        "recipes": "Recipe half_antiresonance kv_rule makers_rule margin_goals symmetric_optimum",
        "repetitive": "RepetitiveDesign tune_repetitive",
        "set_path": "ChangedReference",
        "stops": "learn_stops",
        "trajectory_prefilter": "PrefilterFit fit_prefilter fit_prefilter_to_log tune_prefilter",
        "trial": "Trial measured_trial simulated_trial",
        "trials": "Convergence SignalTrials Trials convergence iterate_trials learn_signal",
        "tune": "assess tune_control",
        "tuned": "Tuned",
        "zero_phase": "inverse_path zero_phase",
    },
)
