"""feeddrive: the servo loop of a machine-tool feed drive, from a measured log or a machine file to a proven loop.

Every block is a name of this package (`feeddrive.TwoMass`, `feeddrive.CascadePPI`), found by the file it stands in, and
so are the few functions that work on a loop.  Names are loaded on first use, so that `import feeddrive` stays quick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# What is not a block: name -> module that holds it.
_PLACES: dict[str, str] = {
    "Arena": "artefacts.arena.arena",
    "Axis": "loop.axis",
    "Batch": "loop.simulate",
    "Certificate": "engineer.certificate.certificate",
    "CoggingFit": "engineer.identification.cogging",
    "CoggingRun": "engineer.identification.cogging_run",
    "Comparison": "artefacts.study.comparison",
    "Control": "loop.control",
    "ControlFit": "engineer.identification.control_law",
    "Convergence": "engineer.tuning.convergence",
    "DelayFit": "engineer.identification.delay",
    "DelayMap": "engineer.tuning.delay_map",
    "Encirclement": "engineer.analysis.encirclement",
    "Excitation": "engineer.identification.excitation",
    "FRF": "loop.frequency_response",
    "FeeddriveError": "language.errors",
    "FrequencyEstimate": "engineer.identification.frequency_estimate",
    "FrictionCurve": "engineer.identification.friction_curve",
    "FrictionMap": "engineer.analysis.friction_map",
    "Gradient": "loop.gradient",
    "Guard": "loop.guard",
    "Guess": "artefacts.files.guess",
    "Identified": "engineer.identification.identify",
    "Iteration": "engineer.tuning.iterative_feedforward",
    "Job": "artefacts.files.job",
    "Limits": "engineer.tuning.shaping.limits",
    "Log": "artefacts.files.measured",
    "Loop": "loop.loop",
    "Machine": "artefacts.files.machine",
    "MarginIntervals": "engineer.analysis.margin_intervals",
    "Margins": "engineer.analysis.margins",
    "MeasuredLoop": "engineer.analysis.measured_loop",
    "MotionLog": "engineer.identification.motion_log",
    "Observation": "engineer.observe",
    "Placement": "engineer.tuning.placement",
    "PrefilterFit": "engineer.tuning.trajectory_prefilter",
    "Preparation": "engineer.identification.preparation",
    "Recipe": "engineer.tuning.recipes",
    "Record": "engineer.identification.record",
    "Refinement": "engineer.identification.output_error",
    "Replay": "engineer.replay",
    "RigidFit": "engineer.identification.rigid",
    "Run": "loop.simulate",
    "Setpoint": "blocks.signals",
    "ShapedLoop": "engineer.tuning.shaping.shaped_loop",
    "SignalTrials": "engineer.tuning.signal_ilc",
    "Signals": "loop.loop",
    "Site": "engineer.tuning.shaping.site",
    "Spectrum": "engineer.analysis.spectrum",
    "Stability": "engineer.analysis.stability",
    "StateSpace": "loop.linearize",
    "SteadyRuns": "engineer.identification.steady_runs",
    "Stiffness": "engineer.analysis.stiffness",
    "Trial": "engineer.tuning.trial",
    "Trials": "engineer.tuning.trials",
    "Tuned": "engineer.tuning.tuned",
    "arena": "artefacts.arena.arena",
    "as_frf": "engineer.analysis.conversion",
    "begin_compensation": "engineer.tuning.compensated",
    "certify": "engineer.certificate.certify",
    "compare": "artefacts.study.comparison",
    "complementary_sensitivity": "engineer.analysis.sensitivity",
    "compensated": "engineer.tuning.compensated",
    "compliance": "loop.linearize",
    "convergence": "engineer.tuning.convergence",
    "delay_map": "engineer.tuning.delay_map",
    "design_excitation": "engineer.identification.excitation_design",
    "encirclement": "engineer.analysis.encirclement",
    "error_model": "engineer.tuning.error_model",
    "estimate_frf": "engineer.identification.estimate_frf",
    "find_delay": "engineer.identification.delay",
    "fit_friction": "engineer.identification.friction_curve",
    "fit_prefilter": "engineer.tuning.trajectory_prefilter",
    "fit_prefilter_to_log": "engineer.tuning.trajectory_prefilter",
    "friction_map": "engineer.analysis.friction_map",
    "get": "language.tree",
    "gradient": "loop.gradient",
    "guess_roles": "artefacts.files.guess",
    "half_antiresonance": "engineer.tuning.recipes",
    "identify": "engineer.identification.identify",
    "identify_cogging": "engineer.identification.identify_cogging",
    "identify_control": "engineer.identification.control_law",
    "identify_rigid": "engineer.identification.rigid",
    "fit_axis": "engineer.identification.fit_axis",
    "fit_modal_axis": "engineer.identification.two_mass_fit",
    "fit_modes": "engineer.identification.modal_fit",
    "fit_plant": "engineer.identification.two_mass_fit",
    "fit_two_mass": "engineer.identification.two_mass_fit",
    "iterate": "engineer.tuning.iterative_feedforward",
    "iterate_trials": "engineer.tuning.trials",
    "kv_rule": "engineer.tuning.recipes",
    "learn_signal": "engineer.tuning.signal_ilc",
    "leaves": "language.tree",
    "linearize": "loop.linearize",
    "loop_gain": "loop.linearize",
    "margin_goals": "engineer.tuning.recipes",
    "margin_intervals": "engineer.analysis.margin_intervals",
    "margins": "engineer.analysis.margins",
    "measured_loop": "engineer.analysis.measured_loop",
    "measured_site": "engineer.tuning.shaping.site",
    "measured_trial": "engineer.tuning.trial",
    "modelled_site": "engineer.tuning.shaping.site",
    "observe": "engineer.observe",
    "placement": "engineer.tuning.placement",
    "read_arrays": "artefacts.files.log",
    "read_certificate": "artefacts.certificate.certificate_file",
    "read_frf": "artefacts.files.frf",
    "read_frfs": "artefacts.files.frf",
    "read_job": "artefacts.files.job",
    "read_log": "artefacts.files.log",
    "read_machine": "artefacts.files.machine",
    "read_request": "artefacts.files.job",
    "refine": "engineer.identification.output_error",
    "replay": "engineer.replay",
    "runs_of": "engineer.identification.steady_runs",
    "sensitivity": "engineer.analysis.sensitivity",
    "shape": "engineer.tuning.shaping.shape",
    "simulate": "loop.simulate",
    "simulate_batch": "loop.simulate",
    "simulated_trial": "engineer.tuning.trial",
    "spectrum": "engineer.analysis.spectrum",
    "stability": "engineer.analysis.stability",
    "steady_runs": "engineer.identification.steady_runs",
    "stiffness": "engineer.analysis.stiffness",
    "stream": "loop.simulate",
    "symmetric_optimum": "engineer.tuning.recipes",
    "to_toml": "artefacts.files.blocks_to_toml",
    "tracking": "loop.linearize",
    "tune": "engineer.tuning.equal_robustness",
    "tune_prefilter": "engineer.tuning.trajectory_prefilter",
    "vary": "language.tree",
    "write_arena": "artefacts.arena.results",
    "encoders": "artefacts.files.frf",
    "write_certificate": "artefacts.certificate.certificate_file",
    "write_frf": "artefacts.files.frf",
    "write_log": "artefacts.files.measured",
    "write_results": "artefacts.study.results",
    "write_roles": "artefacts.files.guess",
}

# What type checkers see; a block that is not listed is there all the same, as Any.
if TYPE_CHECKING:
    from feeddrive.artefacts.arena.arena import Arena as Arena
    from feeddrive.artefacts.arena.arena import arena as arena
    from feeddrive.artefacts.arena.results import write_arena as write_arena
    from feeddrive.artefacts.certificate.certificate_file import read_certificate as read_certificate
    from feeddrive.artefacts.certificate.certificate_file import write_certificate as write_certificate
    from feeddrive.artefacts.files.blocks_to_toml import to_toml as to_toml
    from feeddrive.artefacts.files.frf import encoders as encoders
    from feeddrive.artefacts.files.frf import read_frf as read_frf
    from feeddrive.artefacts.files.frf import read_frfs as read_frfs
    from feeddrive.artefacts.files.frf import write_frf as write_frf
    from feeddrive.artefacts.files.guess import Guess as Guess
    from feeddrive.artefacts.files.guess import guess_roles as guess_roles
    from feeddrive.artefacts.files.guess import write_roles as write_roles
    from feeddrive.artefacts.files.job import Job as Job
    from feeddrive.artefacts.files.job import read_job as read_job
    from feeddrive.artefacts.files.job import read_request as read_request
    from feeddrive.artefacts.files.log import read_arrays as read_arrays
    from feeddrive.artefacts.files.log import read_log as read_log
    from feeddrive.artefacts.files.machine import Machine as Machine
    from feeddrive.artefacts.files.machine import read_machine as read_machine
    from feeddrive.artefacts.files.measured import Log as Log
    from feeddrive.artefacts.files.measured import write_log as write_log
    from feeddrive.artefacts.study.comparison import Comparison as Comparison
    from feeddrive.artefacts.study.comparison import compare as compare
    from feeddrive.artefacts.study.results import write_results as write_results
    from feeddrive.blocks.actuator.actuator import Actuator as Actuator
    from feeddrive.blocks.actuator.direct import Direct as Direct
    from feeddrive.blocks.actuator.screw import Screw as Screw
    from feeddrive.blocks.compensation.disturbance_rejection import DisturbanceRejection as DisturbanceRejection
    from feeddrive.blocks.compensation.learned_force import LearnedForce as LearnedForce
    from feeddrive.blocks.compensation.machine_mode import MachineMode as MachineMode
    from feeddrive.blocks.compensation.mode_compensation import ModeCompensation as ModeCompensation
    from feeddrive.blocks.controller.active_disturbance_rejection import (
        ActiveDisturbanceRejection as ActiveDisturbanceRejection,
    )
    from feeddrive.blocks.controller.cascade_ppi import CascadePPI as CascadePPI
    from feeddrive.blocks.controller.dadsc import DADSC as DADSC
    from feeddrive.blocks.controller.pole_placement import PolePlacement as PolePlacement
    from feeddrive.blocks.cutting.helical_cutter import HelicalCutter as HelicalCutter
    from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator as DisturbanceCompensator
    from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward as FrictionFeedforward
    from feeddrive.blocks.feedforward.inertia import Inertia as Inertia
    from feeddrive.blocks.feedforward.inverse_dynamics import InverseDynamics as InverseDynamics
    from feeddrive.blocks.filter.low_pass import LowPass as LowPass
    from feeddrive.blocks.filter.low_pass2 import LowPass2 as LowPass2
    from feeddrive.blocks.filter.notch import Notch as Notch
    from feeddrive.blocks.filter.second_order import SecondOrder as SecondOrder
    from feeddrive.blocks.force.backlash import Backlash as Backlash
    from feeddrive.blocks.force.cogging import Cogging as Cogging
    from feeddrive.blocks.force.force_map import ForceMap as ForceMap
    from feeddrive.blocks.force.gravity import Gravity as Gravity
    from feeddrive.blocks.force.harmonic import Harmonic as Harmonic
    from feeddrive.blocks.force.ripple import Ripple as Ripple
    from feeddrive.blocks.force.screw_error import ScrewError as ScrewError
    from feeddrive.blocks.friction.coulomb import Coulomb as Coulomb
    from feeddrive.blocks.friction.directional import Directional as Directional
    from feeddrive.blocks.friction.directional_stribeck import DirectionalStribeck as DirectionalStribeck
    from feeddrive.blocks.friction.lugre import Lugre as Lugre
    from feeddrive.blocks.friction.regularised import Regularised as Regularised
    from feeddrive.blocks.friction.stribeck import Stribeck as Stribeck
    from feeddrive.blocks.friction.viscous import Viscous as Viscous
    from feeddrive.blocks.load.force_sum import ForceSum as ForceSum
    from feeddrive.blocks.load.milling_force import MillingForce as MillingForce
    from feeddrive.blocks.load.recorded_force import RecordedForce as RecordedForce
    from feeddrive.blocks.load.sine_force import SineForce as SineForce
    from feeddrive.blocks.load.step_force import StepForce as StepForce
    from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery as DisturbanceRecovery
    from feeddrive.blocks.observer.gpi_observer import GpiObserver as GpiObserver
    from feeddrive.blocks.observer.kalman_recovery import KalmanRecovery as KalmanRecovery
    from feeddrive.blocks.plant.lead_error import LeadError as LeadError
    from feeddrive.blocks.plant.milling_axis import MillingAxis as MillingAxis
    from feeddrive.blocks.plant.modal import Modal as Modal
    from feeddrive.blocks.plant.mode import Mode as Mode
    from feeddrive.blocks.plant.rigid import Rigid as Rigid
    from feeddrive.blocks.plant.screw_rigid import ScrewRigid as ScrewRigid
    from feeddrive.blocks.plant.screw_two_mass import ScrewTwoMass as ScrewTwoMass
    from feeddrive.blocks.plant.three_mass_chain import ThreeMassChain as ThreeMassChain
    from feeddrive.blocks.plant.two_mass import TwoMass as TwoMass
    from feeddrive.blocks.prefilter.trajectory_prefilter import TrajectoryPrefilter as TrajectoryPrefilter
    from feeddrive.blocks.reference.bezier10 import Bezier10 as Bezier10
    from feeddrive.blocks.reference.chirp import Chirp as Chirp
    from feeddrive.blocks.reference.circle import Circle as Circle
    from feeddrive.blocks.reference.jerk_limited_move import JerkLimitedMove as JerkLimitedMove
    from feeddrive.blocks.reference.linear_move import LinearMove as LinearMove
    from feeddrive.blocks.reference.multisine import Multisine as Multisine
    from feeddrive.blocks.reference.polynomial7 import Polynomial7 as Polynomial7
    from feeddrive.blocks.reference.recorded import Recorded as Recorded
    from feeddrive.blocks.reference.sequence import Sequence as Sequence
    from feeddrive.blocks.reference.shaped import Shaped as Shaped
    from feeddrive.blocks.reference.sine import Sine as Sine
    from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove as SnapLimitedMove
    from feeddrive.blocks.reference.trapezoidal_move import TrapezoidalMove as TrapezoidalMove
    from feeddrive.blocks.sensor.eccentricity import Eccentricity as Eccentricity
    from feeddrive.blocks.sensor.encoder import Encoder as Encoder
    from feeddrive.blocks.sensor.interpolation import Interpolation as Interpolation
    from feeddrive.blocks.signals import Setpoint as Setpoint
    from feeddrive.engineer.analysis.conversion import as_frf as as_frf
    from feeddrive.engineer.analysis.encirclement import Encirclement as Encirclement
    from feeddrive.engineer.analysis.encirclement import encirclement as encirclement
    from feeddrive.engineer.analysis.friction_map import FrictionMap as FrictionMap
    from feeddrive.engineer.analysis.friction_map import friction_map as friction_map
    from feeddrive.engineer.analysis.margin_intervals import MarginIntervals as MarginIntervals
    from feeddrive.engineer.analysis.margin_intervals import margin_intervals as margin_intervals
    from feeddrive.engineer.analysis.margins import Margins as Margins
    from feeddrive.engineer.analysis.margins import margins as margins
    from feeddrive.engineer.analysis.measured_loop import MeasuredLoop as MeasuredLoop
    from feeddrive.engineer.analysis.measured_loop import measured_loop as measured_loop
    from feeddrive.engineer.analysis.sensitivity import complementary_sensitivity as complementary_sensitivity
    from feeddrive.engineer.analysis.sensitivity import sensitivity as sensitivity
    from feeddrive.engineer.analysis.spectrum import Spectrum as Spectrum
    from feeddrive.engineer.analysis.spectrum import spectrum as spectrum
    from feeddrive.engineer.analysis.stability import Stability as Stability
    from feeddrive.engineer.analysis.stability import stability as stability
    from feeddrive.engineer.analysis.stiffness import Stiffness as Stiffness
    from feeddrive.engineer.analysis.stiffness import stiffness as stiffness
    from feeddrive.engineer.certificate.certificate import Certificate as Certificate
    from feeddrive.engineer.certificate.certify import certify as certify
    from feeddrive.engineer.identification.cogging import CoggingFit as CoggingFit
    from feeddrive.engineer.identification.cogging_run import CoggingRun as CoggingRun
    from feeddrive.engineer.identification.control_law import ControlFit as ControlFit
    from feeddrive.engineer.identification.control_law import identify_control as identify_control
    from feeddrive.engineer.identification.delay import DelayFit as DelayFit
    from feeddrive.engineer.identification.delay import find_delay as find_delay
    from feeddrive.engineer.identification.estimate_frf import estimate_frf as estimate_frf
    from feeddrive.engineer.identification.excitation import Excitation as Excitation
    from feeddrive.engineer.identification.excitation_design import design_excitation as design_excitation
    from feeddrive.engineer.identification.fit_axis import fit_axis as fit_axis
    from feeddrive.engineer.identification.frequency_estimate import FrequencyEstimate as FrequencyEstimate
    from feeddrive.engineer.identification.friction_curve import FrictionCurve as FrictionCurve
    from feeddrive.engineer.identification.friction_curve import fit_friction as fit_friction
    from feeddrive.engineer.identification.identify import Identified as Identified
    from feeddrive.engineer.identification.identify import identify as identify
    from feeddrive.engineer.identification.identify_cogging import identify_cogging as identify_cogging
    from feeddrive.engineer.identification.modal_fit import fit_modes as fit_modes
    from feeddrive.engineer.identification.motion_log import MotionLog as MotionLog
    from feeddrive.engineer.identification.output_error import Refinement as Refinement
    from feeddrive.engineer.identification.output_error import refine as refine
    from feeddrive.engineer.identification.preparation import Preparation as Preparation
    from feeddrive.engineer.identification.record import Record as Record
    from feeddrive.engineer.identification.rigid import RigidFit as RigidFit
    from feeddrive.engineer.identification.rigid import identify_rigid as identify_rigid
    from feeddrive.engineer.identification.steady_runs import SteadyRuns as SteadyRuns
    from feeddrive.engineer.identification.steady_runs import runs_of as runs_of
    from feeddrive.engineer.identification.steady_runs import steady_runs as steady_runs
    from feeddrive.engineer.identification.two_mass_fit import fit_modal_axis as fit_modal_axis
    from feeddrive.engineer.identification.two_mass_fit import fit_plant as fit_plant
    from feeddrive.engineer.identification.two_mass_fit import fit_two_mass as fit_two_mass
    from feeddrive.engineer.observe import Observation as Observation
    from feeddrive.engineer.observe import observe as observe
    from feeddrive.engineer.replay import Replay as Replay
    from feeddrive.engineer.replay import replay as replay
    from feeddrive.engineer.tuning.compensated import begin_compensation as begin_compensation
    from feeddrive.engineer.tuning.compensated import compensated as compensated
    from feeddrive.engineer.tuning.convergence import Convergence as Convergence
    from feeddrive.engineer.tuning.convergence import convergence as convergence
    from feeddrive.engineer.tuning.delay_map import DelayMap as DelayMap
    from feeddrive.engineer.tuning.delay_map import delay_map as delay_map
    from feeddrive.engineer.tuning.equal_robustness import tune as tune
    from feeddrive.engineer.tuning.error_model import error_model as error_model
    from feeddrive.engineer.tuning.iterative_feedforward import Iteration as Iteration
    from feeddrive.engineer.tuning.iterative_feedforward import iterate as iterate
    from feeddrive.engineer.tuning.placement import Placement as Placement
    from feeddrive.engineer.tuning.placement import placement as placement
    from feeddrive.engineer.tuning.recipes import Recipe as Recipe
    from feeddrive.engineer.tuning.recipes import half_antiresonance as half_antiresonance
    from feeddrive.engineer.tuning.recipes import kv_rule as kv_rule
    from feeddrive.engineer.tuning.recipes import margin_goals as margin_goals
    from feeddrive.engineer.tuning.recipes import symmetric_optimum as symmetric_optimum
    from feeddrive.engineer.tuning.shaping.limits import Limits as Limits
    from feeddrive.engineer.tuning.shaping.shape import shape as shape
    from feeddrive.engineer.tuning.shaping.shaped_loop import ShapedLoop as ShapedLoop
    from feeddrive.engineer.tuning.shaping.site import Site as Site
    from feeddrive.engineer.tuning.shaping.site import measured_site as measured_site
    from feeddrive.engineer.tuning.shaping.site import modelled_site as modelled_site
    from feeddrive.engineer.tuning.signal_ilc import SignalTrials as SignalTrials
    from feeddrive.engineer.tuning.signal_ilc import learn_signal as learn_signal
    from feeddrive.engineer.tuning.trajectory_prefilter import PrefilterFit as PrefilterFit
    from feeddrive.engineer.tuning.trajectory_prefilter import fit_prefilter as fit_prefilter
    from feeddrive.engineer.tuning.trajectory_prefilter import fit_prefilter_to_log as fit_prefilter_to_log
    from feeddrive.engineer.tuning.trajectory_prefilter import tune_prefilter as tune_prefilter
    from feeddrive.engineer.tuning.trial import Trial as Trial
    from feeddrive.engineer.tuning.trial import measured_trial as measured_trial
    from feeddrive.engineer.tuning.trial import simulated_trial as simulated_trial
    from feeddrive.engineer.tuning.trials import Trials as Trials
    from feeddrive.engineer.tuning.trials import iterate_trials as iterate_trials
    from feeddrive.engineer.tuning.tuned import Tuned as Tuned
    from feeddrive.language.errors import FeeddriveError as FeeddriveError
    from feeddrive.language.tree import get as get
    from feeddrive.language.tree import leaves as leaves
    from feeddrive.language.tree import vary as vary
    from feeddrive.loop.axis import Axis as Axis
    from feeddrive.loop.control import Control as Control
    from feeddrive.loop.frequency_response import FRF as FRF
    from feeddrive.loop.gradient import Gradient as Gradient
    from feeddrive.loop.gradient import gradient as gradient
    from feeddrive.loop.guard import Guard as Guard
    from feeddrive.loop.linearize import StateSpace as StateSpace
    from feeddrive.loop.linearize import compliance as compliance
    from feeddrive.loop.linearize import linearize as linearize
    from feeddrive.loop.linearize import loop_gain as loop_gain
    from feeddrive.loop.linearize import tracking as tracking
    from feeddrive.loop.loop import Loop as Loop
    from feeddrive.loop.loop import Signals as Signals
    from feeddrive.loop.simulate import Batch as Batch
    from feeddrive.loop.simulate import Run as Run
    from feeddrive.loop.simulate import simulate as simulate
    from feeddrive.loop.simulate import simulate_batch as simulate_batch
    from feeddrive.loop.simulate import stream as stream


def __getattr__(name: str) -> Any:
    """A public name, loaded on first use: one of `_PLACES`, or a block by the module that is named as it is."""
    from importlib import import_module

    if name in _PLACES:
        found = getattr(import_module(f"feeddrive.{_PLACES[name]}"), name)
    else:
        found = _block(name)
        if found is None:
            raise AttributeError(f"module 'feeddrive' has no name '{name}'")
    globals()[name] = found
    return found


def _block(name: str) -> Any:
    """The block with a class name, or None."""
    if not name[:1].isupper():
        return None
    from importlib import import_module

    from feeddrive.blocks.catalogue import modules
    from feeddrive.language.block import snake_case

    file = f".{snake_case(name)}"
    return next((getattr(import_module(module), name, None) for module in modules() if module.endswith(file)), None)


def __dir__() -> list[str]:
    """All public names, blocks included; imports every block."""
    from feeddrive.blocks.catalogue import catalogue

    blocks = {block.__name__ for members in catalogue().values() for block in members.values()}
    return sorted({*_PLACES, *blocks, "__version__"})
