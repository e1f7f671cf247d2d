"""Every public name of before the rooms (first version of `__init__.pyi`) works, or its error says the new one."""

from __future__ import annotations

import re

import pytest

import feeddrive as fd

# the stub of the package on 21 November 2026, before its names moved into rooms
WERE = """
    ActiveDisturbanceRejection Actuator Arena Axis Backlash Batch Bezier10 BusDrive BusLimits CascadePPI Certificate
    Chirp Circle Cogging CoggingFit CoggingRun Comparison Control ControlFit Convergence Coulomb DADSC DelayFit
    DelayMap Direct Directional DirectionalStribeck DisturbanceCompensator DisturbanceRecovery DisturbanceRejection
    DriveClient DriveScaling Eccentricity Encirclement Encoder Excitation FRF FeeddriveError ForceMap ForceSum
    FrequencyEstimate FrictionCurve FrictionFeedforward FrictionMap GpiObserver Gradient Gravity Guard Guess
    Harmonic HelicalCutter Identified Inertia Interpolation InverseDynamics Iteration JerkLimitedMove Job
    KalmanRecovery LeadError LearnedForce Limits LinearMove LinuxcncPid Log Loop LowPass LowPass2 Lugre Machine
    MachineMode MarginIntervals Margins MeasuredLoop MillingAxis MillingForce Modal Mode ModeCompensation MotionLog
    Multisine Notch Observation Placement PolePlacement Polynomial7 PrefilterFit Preparation Recipe Record Recorded
    RecordedForce Refinement Regularised Replay Rigid RigidFit Ripple Run Screw ScrewError ScrewRigid ScrewTwoMass
    SecondOrder Sequence Setpoint Shaped ShapedLoop SignalTrials Signals Sine SineForce Site SnapLimitedMove
    Spectrum Stability StateSpace SteadyRuns StepForce Stiffness StockBiquad StockPid Stribeck ThreeMassChain
    TrajectoryPrefilter TrapezoidalMove Trial Trials Tuned TwoMass Verified Viscous arena as_frf assess
    begin_compensation certify cogging_passes compare compensated complementary_sensitivity compliance convergence
    delay_map design_excitation encirclement encoders error_model estimate_frf export find_delay fit_axis
    fit_friction fit_modal_axis fit_modes fit_plant fit_prefilter fit_prefilter_to_log fit_two_mass friction_map get
    gradient guess_roles half_antiresonance identify identify_cogging identify_control identify_rigid iterate
    iterate_trials kv_rule learn_signal leaves linearize loop_gain margin_goals margin_intervals margins
    measured_loop measured_site measured_trial modelled_site observe placement play read_arrays read_certificate
    read_drive read_frf read_frfs read_job read_log read_machine read_profile read_request refine replay runs_of
    sensitivity shape simulate simulate_batch simulate_with_fmu simulated_trial spectrum stability steady_runs
    stiffness stream symmetric_optimum to_toml tracking transport_of tune tune_prefilter vary verify write_arena
    write_certificate write_frf write_log write_results write_roles
"""
OLD = WERE.split()


def found(dotted: str) -> object:
    """What a name such as `fd.tuning.OperatingPoint` stands for. Raises AttributeError if there is none."""
    held: object = fd
    for name in dotted.split(".")[1:]:
        held = getattr(held, name)
    return held


def test_the_list_is_whole() -> None:
    assert len(OLD) == len(set(OLD)) == 223


def test_old_names_work_or_say_the_new_one() -> None:
    for name in OLD:
        if hasattr(fd, name):
            continue
        with pytest.raises(AttributeError, match=rf"^fd\.{name} is now ") as error:
            found(f"fd.{name}")
        new = re.findall(r"\bfd(?:\.\w+)+", str(error.value).partition(" is now ")[2])
        assert new, str(error.value)
        for dotted in new:
            assert found(dotted) is not None


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("shape", "fd.tune"),
        ("arena", "fd.compare"),
        ("write_arena", "fd.comparison.write_comparison"),
        ("Site", "fd.tuning.OperatingPoint"),
        ("modelled_site", "fd.tuning.modelled_point"),
        ("ShapedLoop", "fd.tuning.Tuned"),
        ("Shaped", "fd.blocks.InputShaped"),
        ("CascadePPI", "fd.blocks.CascadePPI"),
        ("replay", "fd.analysis.replay"),
    ],
)
def test_what_was_renamed_and_what_moved(old: str, new: str) -> None:
    with pytest.raises(AttributeError, match=rf"^fd\.{old} is now {re.escape(new)}$"):
        getattr(fd, old)


def test_a_block_with_another_name_is_refused_in_its_room_too() -> None:
    with pytest.raises(AttributeError, match=r"fd\.blocks\.Shaped is now fd\.blocks\.InputShaped"):
        fd.blocks.Shaped  # noqa: B018


def test_the_room_that_was_a_function_says_what_to_call() -> None:
    with pytest.raises(TypeError, match=r"fd\.export is now fd\.write_export"):
        fd.export()
    assert found("fd.write_export") is not None


def test_a_machine_is_no_file_any_more() -> None:
    """`fd.Machine` is the machine of axes; what a file says is a `MachineFile`."""
    read = fd.read_machine("xy_table")
    assert isinstance(read, fd.files.MachineFile)
    assert isinstance(read.machine(), fd.Machine)
    assert not isinstance(read, fd.Machine)
