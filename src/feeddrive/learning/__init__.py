"""Learning from trials: feedforward, prefilter, force signal and repetitive control; set paths by the inverse loop."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "iterative_feedforward": (
            "error_model Convergence Iteration begin_compensation compensated convergence next_iteration"
        ),
        "loop_inverse": "LoopInverse loop_inverse",
        "part_correction": (
            "CorrectedProgram Correction Judge correct_by_plan correct_path_by_plan judged path_figures planned_rows"
        ),
        "part_log": "LearnedPart PartLog PartTrials iterate_parts learn_from_log",
        "planned_friction": "direction_along friction_along",
        "plant_box": "PlantBox",
        "repetitive": "RepetitiveDesign tune_repetitive",
        "set_path": "filtered_splines ChangedReference inverse_path zero_phase",
        "stops": "learn_stops",
        "trajectory_prefilter": "PrefilterFit fit_prefilter fit_prefilter_to_log tune_prefilter",
        "trial": "Trial measured_trial simulated_trial",
        "trials": "MachineTrials SignalTrials Trials iterate_machine iterate_trials learn_signal tune_prefilters",
    },
)
