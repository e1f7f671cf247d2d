"""Identification: models with standard errors from motion logs, constant-speed runs and frequency responses."""

# written by `make stubs`

from feeddrive.identification.cogging import CoggingFit as CoggingFit
from feeddrive.identification.cogging import CoggingRun as CoggingRun
from feeddrive.identification.cogging import cogging_passes as cogging_passes
from feeddrive.identification.cogging import identify_cogging as identify_cogging
from feeddrive.identification.excitation.estimate_frf import estimate_frf as estimate_frf
from feeddrive.identification.excitation.excitation import Excitation as Excitation
from feeddrive.identification.excitation.excitation import design_excitation as design_excitation
from feeddrive.identification.excitation.frequency_estimate import FrequencyEstimate as FrequencyEstimate
from feeddrive.identification.excitation.frequency_estimate import Record as Record
from feeddrive.identification.friction_curve import FrictionCurve as FrictionCurve
from feeddrive.identification.friction_curve import LearnedStops as LearnedStops
from feeddrive.identification.friction_curve import SteadyRuns as SteadyRuns
from feeddrive.identification.friction_curve import fit_friction as fit_friction
from feeddrive.identification.friction_curve import learned_stops as learned_stops
from feeddrive.identification.friction_curve import runs_of as runs_of
from feeddrive.identification.friction_curve import steady_runs as steady_runs
from feeddrive.identification.friction_curve import stretches as stretches
from feeddrive.identification.motion.identify import Identified as Identified
from feeddrive.identification.motion.identify import identify_motion as identify_motion
from feeddrive.identification.motion.identify_law import ControlFit as ControlFit
from feeddrive.identification.motion.identify_law import LawReading as LawReading
from feeddrive.identification.motion.identify_law import identify_control as identify_control
from feeddrive.identification.motion.motion_log import MotionLog as MotionLog
from feeddrive.identification.motion.motion_log import Preparation as Preparation
from feeddrive.identification.motion.output_error import Refinement as Refinement
from feeddrive.identification.motion.output_error import refine as refine
from feeddrive.identification.motion.pooled import IdentifiedLogs as IdentifiedLogs
from feeddrive.identification.motion.pooled import PooledFit as PooledFit
from feeddrive.identification.motion.pooled import identify_logs as identify_logs
from feeddrive.identification.motion.pooled import identify_pooled as identify_pooled
from feeddrive.identification.motion.rigid import DelayFit as DelayFit
from feeddrive.identification.motion.rigid import RigidFit as RigidFit
from feeddrive.identification.motion.rigid import find_delay as find_delay
from feeddrive.identification.motion.rigid import identify_rigid as identify_rigid
from feeddrive.identification.pitch import LearnedPitch as LearnedPitch
from feeddrive.identification.pitch import learned_from as learned_from
from feeddrive.identification.pitch import learned_from_circles as learned_from_circles
from feeddrive.identification.pitch import learned_pitch as learned_pitch
from feeddrive.identification.response.modal_fit import fit_modes as fit_modes
from feeddrive.identification.response.plant_fit import fit_axis as fit_axis
from feeddrive.identification.response.plant_fit import fit_modal_axis as fit_modal_axis
from feeddrive.identification.response.plant_fit import fit_plant as fit_plant
from feeddrive.identification.response.plant_fit import fit_two_mass as fit_two_mass
