"""The figures of a trial, in closed form and against a foreign simulator that shares no code with the prediction."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.bus.play import Profile
from feeddrive.commissioning import motions
from feeddrive.commissioning.motions import Pace
from feeddrive.commissioning.trial import Figures, Trial, figures, filled, predicted
from feeddrive.files.log import Log
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop

T = 1e-3  # s
PACE = Pace(speed=0.1, acceleration=2.0)
MOTION = motions.trial(0.08, PACE, 200.0, T)
ROWS = MOTION.alone.set_position.size


def log_of(**channels: np.ndarray) -> Log:
    rows = next(iter(channels.values())).size
    return Log(name="trial", time=T * np.arange(rows), channels=channels, units={}, sample_time=T)


def run(error: np.ndarray, force: np.ndarray | None = None, start: float = 0.0) -> Log:
    """The log of a trial with a following error, from where the axis stands."""
    target = start + MOTION.alone.set_position
    return log_of(set_position=target, reading_load=target - error, force=np.zeros(ROWS) if force is None else force)


def pulse(deflection: float) -> np.ndarray:
    """The following error under the pulse of a spring without mass."""
    return deflection * MOTION.pushed.excitation / MOTION.force


# closed forms


def test_the_following_error_counts_from_the_beginning_of_the_motion_to_its_end() -> None:
    error = np.full(ROWS, 5e-3)
    moving = np.arange(ROWS)[MOTION.moving]
    error[moving] = 3e-6 * np.sqrt(2.0) * np.sin(2.0 * np.pi * np.arange(moving.size) / moving.size)
    found = figures(MOTION, run(error), run(error + pulse(1e-6)))
    assert found.following_rms == pytest.approx(3e-6, rel=1e-9)
    assert found.following_peak == pytest.approx(3e-6 * np.sqrt(2.0), rel=1e-5)


@pytest.mark.parametrize("start", [0.0, 0.37])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_stiffness_is_the_force_over_what_it_moves_whatever_both_runs_share(start: float, side: float) -> None:
    """Friction, cogging and lag are in both runs; the second begins at another count."""
    rng = np.random.default_rng(4)
    shared = 1e-4 * rng.standard_normal(ROWS)
    found = figures(MOTION, run(shared), run(shared + 7e-6 + side * pulse(2e-6), start=start))
    assert found.stiffness == pytest.approx(200.0 / 2e-6, rel=1e-6)


def test_an_axis_that_a_force_does_not_move_is_infinitely_stiff() -> None:
    assert figures(MOTION, run(np.zeros(ROWS)), run(np.zeros(ROWS))).stiffness == np.inf


def test_what_happens_later_than_half_a_pulse_behind_it_is_no_deflection() -> None:
    late = np.zeros(ROWS)
    late[MOTION.pulsed.stop :] = 1e-3
    found = figures(MOTION, run(np.zeros(ROWS)), run(pulse(2e-6) + late))
    assert found.stiffness == pytest.approx(1e8, rel=1e-9)


def test_noise_is_the_scatter_at_rest_of_what_was_commanded_or_else_measured() -> None:
    rng = np.random.default_rng(6)
    error, force = 2e-7 * rng.standard_normal(ROWS), 300.0 + 3.0 * rng.standard_normal(ROWS)
    alone = run(error, force)
    found = figures(MOTION, alone, alone)
    rest = MOTION.rest
    assert found.force_noise == pytest.approx(float(np.std(force[rest])))
    # a standard deviation of 400 rows is known to 3.5 %
    assert found.position_noise == pytest.approx(2e-7, rel=0.12)
    commanded = replace(alone, channels={**alone.channels, "commanded": 0.5 * force})
    assert figures(MOTION, commanded, commanded).force_noise == pytest.approx(0.5 * found.force_noise)


# lost frames


def test_readings_of_lost_frames_lie_on_a_line_between_their_neighbors() -> None:
    reading = np.array([0.0, 1.0, 1.0, 1.0, 4.0, 5.0, 5.0])
    lost = np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0])
    log = log_of(reading_load=reading, set_position=10.0 * np.arange(7.0), lost=lost)
    out = filled(log)
    assert list(out["reading_load"]) == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 5.0]
    assert list(out["set_position"]) == list(log["set_position"])
    assert list(out["lost"]) == list(lost)
    assert list(log["reading_load"]) == list(reading)


def test_a_log_without_a_frame_or_without_the_column_stays_as_it_is() -> None:
    log = log_of(reading_load=np.arange(4.0))
    assert filled(log) is log
    nothing = log_of(reading_load=np.arange(4.0), lost=np.ones(4))
    assert list(filled(nothing)["reading_load"]) == [0.0, 1.0, 2.0, 3.0]


# against a foreign simulator


MASS, KV, KP, TN = 80.0, 40.0, 12_000.0, 0.03
COULOMB = (0.0, 60.0, 60.0)
EXTRA = (0.0, 0.0, 40.0)  # N of a Stribeck curve that the model does not have


@cache
def foreign() -> list[tuple[Log, Log]]:
    """Both runs of three axes that differ in friction; a force from outside is `added` to that of the law."""
    axes = fa.Axes(
        mass=MASS,
        viscous=150.0,
        coulomb_positive=np.array(COULOMB),
        coulomb_negative=np.array(COULOMB),
        stribeck=np.array(EXTRA),
        stribeck_velocity=0.01,
        dead_time=T,
        resolution=1e-8,
        resolution_load=1e-8,
    )
    law = fa.Cascade(Kv=KV, Kp=KP, rate=1.0 / TN, ff=1.0)
    out = []
    for profile in (MOTION.alone, MOTION.pushed):
        rng = np.random.default_rng(1)
        logs = fa.simulate(axes, law, profile.set_position, T, rng, count=3, added=profile.excitation, substeps=2)
        assert np.all(logs.stable)
        out.append([logs.log(axis) for axis in range(3)])
    return [(_log(alone, MOTION.alone), _log(pushed, MOTION.pushed)) for alone, pushed in zip(*out, strict=True)]


def _log(columns: dict[str, np.ndarray], profile: Profile) -> Log:
    return log_of(
        set_position=profile.set_position,
        reading_load=columns["position"],
        force=columns["force"],
        commanded=columns["force"],
        excitation=profile.excitation,
    )


def loop(coulomb: float) -> Loop:
    """The same axis, as feeddrive describes it; in the foreign log a reading acts within its own sample."""
    axis = Axis(
        plant=Rigid(mass=MASS, viscous=150.0),
        actuator=Actuator(dead_time=T),
        friction_load=Coulomb(coulomb=coulomb) if coulomb else None,
    )
    law = CascadePPI(Kv=KV, Kp=KP, Tn=TN)
    return Loop(axis=axis, control=Control(law=law), sample_time=T, name="x")


def test_the_stiffness_of_a_foreign_axis_is_that_without_friction() -> None:
    """As long as the pulse does not turn the axis round: friction is the same in both runs."""
    stiffness = [figures(MOTION, *logs).stiffness for logs in foreign()]
    # the curve of the third falls by less than 1 N at this speed
    assert stiffness[1:] == pytest.approx([stiffness[0]] * 2, rel=0.01)


@pytest.mark.parametrize("axis", [0, 1])
def test_the_prediction_is_what_a_foreign_axis_does(axis: int) -> None:
    """Two integrators: the foreign one rounds to counts of 10 nm and steps friction four times coarser."""
    model = loop(COULOMB[axis])
    expected = figures(MOTION, *(predicted(model, each, 1e-8, 0.0) for each in (MOTION.alone, MOTION.pushed)))
    measured = figures(MOTION, *foreign()[axis])
    trial = Trial(expected, measured)
    assert trial.ratio("following_rms") == pytest.approx(1.0, abs=0.02)
    assert trial.ratio("following_peak") == pytest.approx(1.0, abs=0.02)
    assert trial.ratio("stiffness") == pytest.approx(1.0, abs=0.02)
    assert trial.agrees


def test_a_model_with_half_the_mass_or_no_integral_does_not_agree() -> None:
    measured = figures(MOTION, *foreign()[1])
    model = loop(COULOMB[1])
    light = replace(model, axis=replace(model.axis, plant=Rigid(mass=0.5 * MASS, viscous=150.0)))
    soft = replace(model, control=replace(model.control, law=CascadePPI(Kv=KV, Kp=KP)))
    for wrong in (light, soft):
        expected = figures(MOTION, *(predicted(wrong, each, 1e-8, 0.0) for each in (MOTION.alone, MOTION.pushed)))
        assert not Trial(expected, measured).agrees


def test_the_predicted_log_has_the_rows_of_the_profile_and_the_noise_of_its_encoder() -> None:
    log = predicted(loop(60.0), MOTION.pushed, 1e-7, 5e-7)
    assert len(log) == ROWS
    assert np.array_equal(log["excitation"], MOTION.pushed.excitation)
    assert log["commanded"] == pytest.approx(log["force"] + log["excitation"])
    counts = log["reading_load"] / 1e-7
    assert counts == pytest.approx(np.rint(counts), abs=1e-6)
    assert float(np.std(log["reading_load"][MOTION.rest])) > 4e-7
    # an encoder whose count is not known is a smooth one
    smooth = predicted(loop(60.0), MOTION.alone, 0.0, 0.0)
    assert float(np.std(smooth["reading_load"][MOTION.rest])) < 1e-9


# what a trial decides


FOUND = Figures(following_rms=1e-5, following_peak=3e-5, stiffness=2e7, force_noise=1.0, position_noise=1e-8)


@pytest.mark.parametrize("name", ["following_rms", "stiffness"])
@pytest.mark.parametrize(("ratio", "agrees"), [(0.91, True), (1.09, True), (0.89, False), (1.11, False)])
def test_a_trial_agrees_within_ten_percent(name: str, ratio: float, agrees: bool) -> None:
    trial = Trial(FOUND, replace(FOUND, **{name: ratio * getattr(FOUND, name)}))
    assert trial.agrees is agrees
    assert trial.ratio(name) == pytest.approx(ratio)


def test_noise_and_peak_do_not_decide() -> None:
    assert Trial(FOUND, replace(FOUND, following_peak=1.0, force_noise=50.0, position_noise=1.0)).agrees


@pytest.mark.parametrize(
    ("following", "stiffness", "worse"), [(0.9, 1.1, True), (1.1, 1.1, False), (0.9, 0.9, False), (1.1, 0.9, False)]
)
def test_a_control_is_worse_only_in_both_figures(following: float, stiffness: float, worse: bool) -> None:
    before = replace(FOUND, following_rms=following * FOUND.following_rms, stiffness=stiffness * FOUND.stiffness)
    assert Trial(FOUND, FOUND, before).is_worse is worse
    assert not Trial(FOUND, FOUND).is_worse


def test_the_table_shows_a_dash_for_what_was_not_measured() -> None:
    still = replace(FOUND, position_noise=0.0)
    text = str(Trial(still, FOUND).table())
    assert "following error, RMS" in text
    assert text.count("-") >= 6
