"""Learning from trials: feedforward, prefilter, force signal and repetitive control; set paths by the inverse loop."""

# written by `make stubs`

from feeddrive.learning.iterative_feedforward import Convergence as Convergence
from feeddrive.learning.iterative_feedforward import Iteration as Iteration
from feeddrive.learning.iterative_feedforward import begin_compensation as begin_compensation
from feeddrive.learning.iterative_feedforward import compensated as compensated
from feeddrive.learning.iterative_feedforward import convergence as convergence
from feeddrive.learning.iterative_feedforward import error_model as error_model
from feeddrive.learning.iterative_feedforward import next_iteration as next_iteration
from feeddrive.learning.loop_inverse import LoopInverse as LoopInverse
from feeddrive.learning.loop_inverse import loop_inverse as loop_inverse
from feeddrive.learning.part_correction import CorrectedProgram as CorrectedProgram
from feeddrive.learning.part_correction import Correction as Correction
from feeddrive.learning.part_correction import Judge as Judge
from feeddrive.learning.part_correction import correct_by_plan as correct_by_plan
from feeddrive.learning.part_correction import correct_path_by_plan as correct_path_by_plan
from feeddrive.learning.part_correction import judged as judged
from feeddrive.learning.part_correction import path_figures as path_figures
from feeddrive.learning.part_correction import planned_rows as planned_rows
from feeddrive.learning.part_log import LearnedPart as LearnedPart
from feeddrive.learning.part_log import PartLog as PartLog
from feeddrive.learning.part_log import learn_from_log as learn_from_log
from feeddrive.learning.planned_friction import direction_along as direction_along
from feeddrive.learning.planned_friction import friction_along as friction_along
from feeddrive.learning.plant_box import PlantBox as PlantBox
from feeddrive.learning.repetitive import RepetitiveDesign as RepetitiveDesign
from feeddrive.learning.repetitive import tune_repetitive as tune_repetitive
from feeddrive.learning.set_path import ChangedReference as ChangedReference
from feeddrive.learning.set_path import filtered_splines as filtered_splines
from feeddrive.learning.set_path import inverse_path as inverse_path
from feeddrive.learning.set_path import zero_phase as zero_phase
from feeddrive.learning.stops import learn_stops as learn_stops
from feeddrive.learning.trajectory_prefilter import PrefilterFit as PrefilterFit
from feeddrive.learning.trajectory_prefilter import fit_prefilter as fit_prefilter
from feeddrive.learning.trajectory_prefilter import fit_prefilter_to_log as fit_prefilter_to_log
from feeddrive.learning.trajectory_prefilter import tune_prefilter as tune_prefilter
from feeddrive.learning.trial import Trial as Trial
from feeddrive.learning.trial import measured_trial as measured_trial
from feeddrive.learning.trial import simulated_trial as simulated_trial
from feeddrive.learning.trials import MachineTrials as MachineTrials
from feeddrive.learning.trials import SignalTrials as SignalTrials
from feeddrive.learning.trials import Trials as Trials
from feeddrive.learning.trials import iterate_machine as iterate_machine
from feeddrive.learning.trials import iterate_trials as iterate_trials
from feeddrive.learning.trials import learn_signal as learn_signal
from feeddrive.learning.trials import tune_prefilters as tune_prefilters
