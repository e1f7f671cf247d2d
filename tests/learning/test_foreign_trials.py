"""What a trial says of the axis, on logs of a foreign simulator: values, intervals, and what it cannot show."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import foreign_axis as fa
from feeddrive.language.errors import ParameterError
from feeddrive.learning.at_rest import filtered_held, force_unknown
from feeddrive.learning.axis_values import ASYMMETRY, LEFT, NORMAL_90, Seen, axis_values
from feeddrive.learning.iterative_feedforward import _matters, next_iteration
from feeddrive.learning.trial import measured_trial
from feeddrive.loop.linearize import StateSpace
from foreign_trials import NAMES, T, Table, covered, table, values


def one(positive: float, negative: float, **over: Any) -> Table:
    """One axis of 95 kg and 300 N s/m with these levels."""
    drawn = table(np.random.default_rng(5), 1)
    axes = fa.Axes(
        mass=np.array([95.0]),
        viscous=np.array([300.0]),
        coulomb_positive=np.array([positive]),
        coulomb_negative=np.array([negative]),
        resolution=1e-7,
        dead_time=np.array([3e-4]),
        **over,
    )
    law = fa.Cascade(Kv=np.array([30.0]), Kp=np.array([95.0 * 250.0]), rate=np.array([30.0]), ff=1.0)
    return Table(axes, law, np.array([[95.0, 300.0, positive, negative]]), drawn.setpoint)


BEGIN = np.array([[30.0, 0.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def skewed() -> tuple[Table, fa.Logs]:
    """The axis with levels of 70 and 55 N, and its first trial."""
    axes = one(70.0, 55.0)
    return axes, axes.run(np.random.default_rng(1), BEGIN)


@pytest.fixture(scope="module")
def even() -> tuple[Table, fa.Logs]:
    """The axis with levels of 62 N, and its first trial."""
    axes = one(62.0, 62.0)
    return axes, axes.run(np.random.default_rng(1), BEGIN)


def test_levels_that_differ_are_seen_from_a_log_with_its_force(skewed: tuple[Table, fa.Logs]) -> None:
    axes, logs = skewed
    (step,) = axes.learned(logs, BEGIN, with_force=True)
    for name, value in zip(NAMES, axes.truth[0], strict=True):
        assert step.intervals[name][0] < value < step.intervals[name][1], name
    after = step.after.parameters()
    assert after["coulomb_positive"] - after["coulomb_negative"] == pytest.approx(15.0, abs=5.0)


def test_without_the_force_the_difference_stays_and_is_said_not_to_be_shown(skewed: tuple[Table, fa.Logs]) -> None:
    axes, logs = skewed
    (step,) = axes.learned(logs, BEGIN, with_force=False)
    after = step.after.parameters()
    assert after["coulomb_positive"] == after["coulomb_negative"]
    assert any("does not show the difference of coulomb_positive" in remark for remark in step.remarks)
    assert any("commanded force does" in remark for remark in step.remarks)
    for name, value in zip(NAMES, axes.truth[0], strict=True):
        assert step.intervals[name][0] < value < step.intervals[name][1], name
    half = 0.5 * float(np.ptp(step.intervals["coulomb_positive"]))
    assert half > NORMAL_90 * ASYMMETRY * 50.0


@pytest.mark.parametrize("with_force", [True, False])
def test_no_difference_is_learned_of_symmetric_friction(even: tuple[Table, fa.Logs], with_force: bool) -> None:
    axes, logs = even
    (step,) = axes.learned(logs, BEGIN, with_force=with_force)
    after = step.after.parameters()
    assert after["coulomb_positive"] == pytest.approx(after["coulomb_negative"], rel=1e-9)


def test_the_intervals_of_eight_drawn_axes_hold() -> None:
    rng = np.random.default_rng(31)
    axes = table(rng, 8)
    theta = axes.begin(rng)
    steps = axes.learned(axes.run(rng, theta), theta, with_force=True)
    # of 32 intervals of 90 %, 25 or fewer hold their value once in a hundred draws
    assert np.count_nonzero(covered(steps, axes.truth)) >= 26
    for step, truth in zip(steps, axes.truth, strict=True):
        assert sum(step.intervals["mass"]) / 2 == pytest.approx(truth[0], rel=0.03)
        assert set(step.errors) == set(NAMES)


@pytest.mark.slow(reason="some 60 s: 400 trials of 100 drawn axes; eight axes are a quick test")
@pytest.mark.parametrize("with_force", [True, False])
@pytest.mark.parametrize(
    ("move", "trips"), [("100 mm at 0.25 m/s", 1), ("40 mm at 0.1 m/s", 1), ("200 mm at 0.5 m/s", 1)]
)
def test_90_percent_intervals_hold_on_100_logs(move: str, trips: int, with_force: bool) -> None:
    """Each parameter in 84 logs of 100 or more: a binomial 90 % falls below once in 40; all four together in 88 %."""
    rng = np.random.default_rng(61)
    axes = table(rng, 100, move, trips)
    theta = axes.begin(rng)
    for _ in range(2):
        steps = axes.learned(axes.run(rng, theta), theta, with_force=with_force)
        share = covered(steps, axes.truth).mean(axis=0)
        assert np.all(share >= 0.84), share
        assert np.mean(share) >= 0.88
        theta = values(steps)


# ------------------------------------------------------------------------------------------------- its parts


@pytest.mark.parametrize(("away", "near"), [(7e-6, True), (1.5e-5, False)])
def test_friction_has_no_level_within_10_um_of_a_rest(away: float, near: bool) -> None:
    position = np.array([0.0, 0.0, away, 0.5, 1.0, 1.0])
    velocity = np.array([0.0, 0.0, 0.1, 0.1, 0.1, 0.0])
    assert force_unknown(position, velocity, 1e-9).tolist() == [True, True, near, False, True, True]


@pytest.mark.parametrize(("away", "near"), [(0.007, True), (0.015, False)])
def test_of_a_short_move_a_hundredth_is_near_a_rest(away: float, near: bool) -> None:
    position = 1e-4 * np.array([0.0, away, 0.5, 1.0])
    assert force_unknown(position, np.array([0.0, 0.1, 0.1, 0.1]), 1e-9).tolist() == [True, near, False, False]


def test_a_reversal_without_a_stop_is_a_rest() -> None:
    velocity = np.array([0.2, 0.1, -0.1, -0.2])
    assert force_unknown(np.array([0.0, 0.5, 0.5, 0.0]), velocity, 1e-9).tolist() == [False, True, True, False]


def test_without_a_rest_the_columns_run_through_the_model() -> None:
    """100 samples, so that blocks and what is left of them are in it, against the plain recursion."""
    rng = np.random.default_rng(2)
    model = StateSpace(
        np.array([[0.9, 0.1], [0.0, 0.8]]), np.array([[0.2], [1.0]]), np.array([[1.0, 0.3]]), np.array([[0.5]]),
        T, ("a", "b"), ("force",), ("error",),
    )  # fmt: skip
    columns = rng.standard_normal((100, 2))
    seen, error, level = filtered_held([model], columns, np.zeros(100), np.zeros(100, bool))
    state, wanted = np.zeros((2, 2)), np.empty((100, 2))
    for k, row in enumerate(columns):
        wanted[k] = model.C[0] @ state + 0.5 * row
        state = model.A @ state + model.B * row
    assert np.max(np.abs(seen - wanted)) < 1e-12
    assert not np.any(error)
    # the response to a force that acted before: it fades as the slowest mode
    assert level[99] == pytest.approx(0.9 * level[98], rel=1e-6)


def test_the_prior_holds_a_difference_that_is_not_shown() -> None:
    """Two columns that are each other's opposite in sum: without a known force only the prior is left."""
    rng = np.random.default_rng(3)
    forward = np.repeat([1.0, 0.0, 1.0, 0.0], 50)
    columns = np.column_stack([forward, forward - 1.0])
    error = columns @ [60.0, 60.0] + 0.1 * rng.standard_normal(200)
    none = np.zeros((200, 0))
    known = Seen(columns, none, none, error, None, 5)
    unknown = known._replace(start=np.ones(200))
    for seen, wide in ((known, NORMAL_90 * LEFT * 60.0), (unknown, NORMAL_90 * ASYMMETRY * 60.0)):
        found = axis_values(("coulomb_positive", "coulomb_negative"), np.zeros(2), seen, seen)
        assert found.value == pytest.approx([60.0, 60.0], abs=0.5)
        assert found.half == pytest.approx([wide, wide], rel=0.05)
        assert not found.asymmetric


@pytest.mark.parametrize(("half", "seen"), [(0.05, False), (0.08, True)])
def test_levels_differ_beyond_two_standard_errors(half: float, seen: bool) -> None:
    """Two times 3 % of the mean."""
    rng = np.random.default_rng(3)
    forward = np.repeat([1.0, 0.0, 1.0, 0.0], 50)
    columns = np.column_stack([forward, forward - 1.0])
    error = columns @ [60.0 * (1.0 + half), 60.0 * (1.0 - half)] + 0.1 * rng.standard_normal(200)
    none = np.zeros((200, 0))
    trial = Seen(columns, none, none, error, None, 5)
    assert axis_values(("coulomb_positive", "coulomb_negative"), np.zeros(2), trial, trial).asymmetric is seen


def test_viscous_friction_and_levels_at_one_speed_are_said_to_be_alike() -> None:
    rng = np.random.default_rng(3)
    forward = np.repeat([1.0, -1.0], 100)
    for spread, alike in ((0.1, True), (0.9, False)):
        speed = forward * (0.25 + spread * 0.25 * np.tile(np.linspace(-1.0, 1.0, 100), 2))
        columns = np.column_stack([speed, forward > 0.0, -1.0 * (forward < 0.0)])
        error = columns @ [300.0, 60.0, 60.0] + 0.1 * rng.standard_normal(200)
        none = np.zeros((200, 0))
        trial = Seen(columns, none, none, error, None, 5)
        found = axis_values(("viscous", "coulomb_positive", "coulomb_negative"), np.zeros(3), trial, trial)
        assert any("by their sum at 250.4 mm/s" in remark for remark in found.remarks) is alike


def test_the_force_at_the_first_sample_is_that_of_the_rest() -> None:
    axes = one(70.0, 70.0)
    loop = axes.loop(0, np.zeros(4))
    x = axes.setpoint
    noise = np.random.default_rng(4).standard_normal(x.size)
    trial = measured_trial(loop, x, x, sample_time=T, force=12.0 + noise)
    assert trial.force == pytest.approx(12.0, abs=4.0 * trial.force_error)
    # 198 rows or so at rest, of white noise of 1 N
    assert trial.force_error == pytest.approx(1.0 / np.sqrt(198.0), rel=0.4)
    assert measured_trial(loop, x[900:], x[900:], sample_time=T, force=noise[900:]).force is None


def test_another_friction_at_rest_is_refused() -> None:
    axes = one(70.0, 70.0)
    loop = axes.loop(0, np.zeros(4))
    trial = measured_trial(loop, axes.setpoint, axes.setpoint, sample_time=T)
    with pytest.raises(ParameterError, match="at_rest = 'stuck' must be one of held, none"):
        next_iteration(loop, trial, at_rest="stuck")


def test_ninety_percent_of_a_normal_error_lie_within_its_half_width() -> None:
    from scipy.stats import norm

    assert pytest.approx(float(norm.ppf(0.95)), abs=1e-8) == NORMAL_90


def test_a_fifth_of_what_a_better_model_changes_is_error() -> None:
    """Exact fits of 100 and 110 kg: nothing else is in the interval."""
    column, none = np.linspace(-1.0, 1.0, 50)[:, None], np.zeros((50, 0))
    first, better = (Seen(column, none, none, value * column[:, 0], None, 3) for value in (100.0, 110.0))
    found = axis_values(("mass",), np.zeros(1), first, better)
    assert found.value == pytest.approx([110.0])
    assert found.half == pytest.approx([0.2 * 10.0])


@pytest.mark.parametrize(("share", "matters"), [(0.007, False), (0.015, True)])
def test_a_first_force_of_less_than_a_hundredth_of_the_columns_is_forgotten(share: float, matters: bool) -> None:
    used = np.column_stack([np.ones(10), 0.1 * np.ones(10)])
    assert _matters(share * np.ones(10), used) is matters


def test_the_first_force_is_a_mean_over_200_rows() -> None:
    """Of a ramp of 1 N a row: 99.5 N."""
    axes = one(70.0, 70.0)
    x = np.concatenate([np.zeros(600), 1e-3 * np.arange(100)])
    trial = measured_trial(axes.loop(0, np.zeros(4)), x, x, sample_time=T, force=np.arange(700.0), smoothing=0)
    assert trial.force == pytest.approx(99.5)


def test_a_known_prior_is_left() -> None:
    """Without a known force: 1.645 times 0.15 of a mean level of 60 N are 14.8 N."""
    forward = np.repeat([1.0, 0.0, 1.0, 0.0], 50)
    columns, none = np.column_stack([forward, forward - 1.0]), np.zeros((200, 0))
    seen = Seen(columns, none, none, columns @ [60.0, 60.0], np.ones(200), 5)
    found = axis_values(("coulomb_positive", "coulomb_negative"), np.zeros(2), seen, seen)
    assert found.half == pytest.approx([14.8, 14.8], abs=0.1)
