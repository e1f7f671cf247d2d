"""Iterative feedforward: the error model, the update, what it freezes and refuses, and how sure it is."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.filter.low_pass import LowPass
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import tree
from feeddrive.language.errors import LogError, ParameterError, StructureError, UnstableError
from feeddrive.learning import iterative_feedforward
from feeddrive.learning.iterative_feedforward import (
    begin_compensation,
    compensated,
    compensator,
    convergence,
    error_model,
    filtered,
    not_excited,
    regressors,
    true_error_model,
)
from feeddrive.learning.trial import Trial
from feeddrive.learning.trials import iterate_trials
from feeddrive.loop.linearize import Lifted, StateSpace
from trials import (
    MOVE,
    OUT_AND_BACK,
    POSITIVE,
    START,
    TRUE,
    T,
    along,
    linear_loop,
    trial_with_friction,
)

# the law of the paper, on axes whose friction follows the set velocity and is 0 at rest
next_iteration = partial(iterative_feedforward.next_iteration, at_rest="none")
HOUSE = settings(max_examples=12, deadline=None)


def impulse(model: StateSpace | Lifted, count: int) -> np.ndarray:
    pulse = np.zeros((count, 1))
    pulse[0] = 1.0
    return filtered(model, pulse)[:, 0]


class TestErrorModel:
    def test_it_is_the_golden_vector(self) -> None:
        """a = 0.4, b = 4/3 at 300 N/A, no dead time: coefficients of an independent program, in powers of 1/z."""
        num = np.array([0.0, 7.810330294e-8, -2.169220359e-11, -7.808161073e-8])
        den = np.array([1.0, -2.951047569, 2.951466492, -1.047252271, 0.046848966])
        loop = linear_loop({"mass": 120.0, "viscous": 400.0}, dead_time=0.0)
        g = 300.0 * impulse(error_model(loop, "model_based"), 8)  # per ampere
        # den(z) times the impulse response is num(z); ten printed digits of den leave 5e-10 of the largest value
        assert np.convolve(den, g)[:8] == pytest.approx(np.append(num, np.zeros(4)), abs=2e-9 * 7.8e-8 * 30)

    def test_model_free_is_the_closed_form_of_the_cascade(self) -> None:
        """Δ/C with C = K (1 + T/Ti - 1/z)(Cp + 1/T - 1/zT), the inverse of the P-PI law in powers of 1/z."""
        loop = linear_loop(START)
        law = loop.control.law
        assert isinstance(law, CascadePPI)
        assert law.Tn is not None
        c = law.Kp * np.convolve([1.0 + T / law.Tn, -1.0], [law.Kv + 1.0 / T, -1.0 / T])
        g = impulse(error_model(loop), 400)
        found = np.convolve(c, g)[:400]
        assert found[:2] == pytest.approx([1.0, -1.0], abs=1e-12)
        assert np.max(np.abs(found[2:])) < 1e-12  # of 1

    @HOUSE
    @given(
        mass=st.floats(2.0, 800.0),
        viscous=st.floats(0.0, 3.0),
        period=st.sampled_from([1e-4, 2.5e-4, 5e-4]),
        delay=st.integers(0, 2),
        stribeck=st.booleans(),
        higher=st.booleans(),
        every=st.sampled_from([1, 3, 8]),
    )
    def test_the_difference_of_two_runs_is_the_model_times_the_columns(
        self, mass: float, viscous: float, period: float, delay: int, stribeck: bool, higher: bool, every: int
    ) -> None:
        """e(θ) - e(θ0) = G_d φᵀ (θ0 - θ) to 1e-8: other masses, sample times, delays, columns, one and two rates."""
        true = {**TRUE, "mass": mass, "viscous": viscous * mass}
        start = {**START, "mass": 0.3 * mass}
        if stribeck:
            true["stribeck"], start["stribeck"] = 35.0, 0.0
        if higher:
            true |= {"jerk_feedforward": 0.02, "snap_feedforward": 1e-5}
            start |= {"jerk_feedforward": 0.0, "snap_feedforward": 0.0}
        law = CascadePPI(Kv=40.0, Kp=0.09 / period * mass, Tn=0.015, position_every=every)
        loops = [
            linear_loop(
                theta,
                law=law,
                mass=mass,
                viscous=true["viscous"],
                sample_time=period,
                dead_time=delay * period,
                stribeck_velocity=6e-3 if stribeck else None,
            )
            for theta in (start, true)
        ]
        errors = [trial_with_friction(loop, MOVE).following_error for loop in loops]
        names, phi, _ = regressors(loops[0], compensator(loops[0]), MOVE.at(along(MOVE, period)))
        predicted = filtered(true_error_model(loops[0]), phi) @ [true[name] - start[name] for name in names]
        # 1e-8 of the largest error; a position of 0.1 m rounds to 1e-17 m, its own share is far below
        assert np.max(np.abs(errors[0] - errors[1] - predicted)) < 1e-8 * np.max(np.abs(predicted)) + 1e-13

    def test_a_model_loop_that_is_not_stable_names_the_nearest_mass(self) -> None:
        loop = linear_loop({**START, "mass": 1.2})
        with pytest.raises(UnstableError, match=r"mass of 1\.2 kg .* nearest admissible mass is (\S+) kg") as caught:
            error_model(loop, "model_based")
        near = float(str(caught.value).split("admissible mass is ")[1].split()[0])
        assert 1.2 < near < 30.0
        error_model(linear_loop({**START, "mass": 1.001 * near}), "model_based")
        with pytest.raises(UnstableError):
            error_model(linear_loop({**START, "mass": 0.95 * near}), "model_based")

    def test_gains_that_the_axis_cannot_have_are_named(self) -> None:
        law = CascadePPI(Kv=40.0, Kp=2e6, Tn=0.015)
        with pytest.raises(UnstableError, match=r"with the axis is not stable: .* these gains are not those"):
            error_model(linear_loop(START, law=law), "axis_model")

    def test_a_mass_of_zero_is_refused_in_the_same_way_and_least_mass_helps(self) -> None:
        loop = linear_loop({**START, "mass": 0.0})
        with pytest.raises(UnstableError, match="nearest admissible mass"):
            error_model(loop, "model_based")
        assert np.all(np.abs(error_model(loop, "model_based", least_mass=60.0).poles()) < 1.0)

    def test_a_filter_pack_does_not_spoil_the_model_free_form(self) -> None:
        """A low-pass by Tustin has no inverse; the form leaves the filters out."""
        loop = linear_loop(START, filters=(LowPass(frequency=400.0),))
        assert np.array_equal(impulse(error_model(loop), 50), impulse(error_model(linear_loop(START)), 50))

    def test_the_model_free_form_of_two_rates_is_the_inverse_of_the_law_in_each_sample(self) -> None:
        """What a pulse gives through Ĝ_d, read by the law itself from its start: minus the pulse, to rounding."""
        law = CascadePPI(Kv=40.0, Kp=45e3, Tn=0.015, position_every=4)
        readings = impulse(error_model(linear_loop(START, law=law)), 30)
        here = Setpoint(0.0, 0.0, 0.0, 0.0, 0.0)
        still = Reading(0.0, 0.0, 0.0, 0.0, 0.0)
        state = law.start(law.prepare(T), here, still)
        forces: list[float] = []
        for x in readings:
            last = forces[-1] if forces else 0.0
            reading = still._replace(position_motor=x, position_load=x, applied=last, requested=last)
            state, force = law.step(None, state, here, reading, T)
            forces.append(float(force))
        assert forces == pytest.approx([-1.0] + [0.0] * 29, abs=1e-9)

    def test_a_form_that_is_none_is_refused(self) -> None:
        with pytest.raises(ParameterError, match="model_free, model_based, axis_model"):
            error_model(linear_loop(START), "exact")


class TestTwoRates:
    def test_equal_samples_are_one_rate_and_a_log_in_motion_starts_steady(self) -> None:
        model = error_model(linear_loop(START), "axis_model")
        assert isinstance(model, StateSpace)
        columns = np.random.default_rng(0).standard_normal((200, 2))
        for moving in (False, True):
            one = filtered(model, columns, moving=moving)
            assert filtered(Lifted((model,) * 5), columns, moving=moving) == pytest.approx(one, rel=1e-9)
        law = CascadePPI(Kv=40.0, Kp=45e3, Tn=0.015, position_every=5)
        periodic = error_model(linear_loop(START, law=law), "axis_model")
        held = filtered(periodic, np.ones((50, 1)), moving=True)[:, 0]
        assert held == pytest.approx(np.tile(held[:5], 10), rel=1e-9)

    def test_trials_of_two_rates_converge_as_those_of_one(self) -> None:
        """One exact step leaves a thousandth of the error; a model-free one 4 %, as with one rate.

        The mass is not that of the axis: it compensates for the late command, which the iteration says.
        """
        law = CascadePPI(Kv=40.0, Kp=45e3, Tn=0.015, position_every=4)
        loop = linear_loop(START, law=law)
        found = iterate_trials(loop, MOVE, 3, form="axis_model")
        assert found.rms[1] < 1e-3 * found.rms[0]
        assert found.rms[2] < 1.01 * found.rms[1]
        assert convergence(loop, MOVE).rate < 0.06
        assert any("every 4 samples" in text for text in found.iterations[0].remarks)
        assert found.parameters()["mass"][-1] > 1.2 * TRUE["mass"]

    def test_where_in_a_period_a_log_begins_matters_little(self) -> None:
        """1e-5 of the mass, for the worst of three beginnings."""
        law = CascadePPI(Kv=40.0, Kp=45e3, Tn=0.015, position_every=4)
        loop = linear_loop(START, law=law)
        trial = trial_with_friction(loop, MOVE)
        assert trial.saturated is not None
        masses: list[float] = []
        for k in range(4):
            setpoint = Setpoint(*(np.asarray(row)[k:] for row in trial.setpoint))  # type: ignore[arg-type]
            late = dataclasses.replace(
                trial, setpoint=setpoint, following_error=trial.following_error[k:], saturated=trial.saturated[k:]
            )
            masses.append(next_iteration(loop, late, form="axis_model").after.parameters()["mass"])
        assert masses == pytest.approx([masses[0]] * 4, rel=1e-5)


class TestUpdate:
    def test_one_exact_step_finds_what_an_independent_program_found(self) -> None:
        """In units of a drive of 300 N/A; what is missing to the truth is the dead time of one sample."""
        loop = linear_loop(START)
        found = next_iteration(loop, trial_with_friction(loop, MOVE), form="axis_model", mu=0.0)
        values = np.array(list(found.after.parameters().values())) / 300.0
        assert values == pytest.approx([0.4003, 1.289, 0.323, 0.273], abs=6e-4)  # half a printed digit

    def test_without_dead_time_one_exact_step_finds_the_axis(self) -> None:
        loop = linear_loop(START, dead_time=0.0)
        found = next_iteration(loop, trial_with_friction(loop, MOVE), form="axis_model", mu=0.0)
        values = found.after.parameters()
        # the acceleration is that in the middle of a sample and not its mean: jerk is constant over most samples
        assert values["mass"] == pytest.approx(120.0, rel=1e-4)
        assert values["viscous"] == pytest.approx(400.0, rel=2e-3)
        assert values["coulomb_positive"] == pytest.approx(POSITIVE, rel=2e-3)

    def test_a_jerk_column_takes_the_dead_time(self) -> None:
        """A force that comes τ too late must be that of φ(t + τ) = φ(t) + τ φ'(t): the jerk gets mass · τ."""
        start = {**START, "jerk_feedforward": 0.0}
        loop = linear_loop(start)
        found = next_iteration(loop, trial_with_friction(loop, MOVE), form="axis_model", mu=0.0)
        values = found.after.parameters()
        # friction here acts late too, so that only inertia and viscous friction are ahead of their force
        assert values["jerk_feedforward"] == pytest.approx(120.0 * T, rel=0.02)
        assert values["viscous"] == pytest.approx(400.0, rel=5e-3)

    def test_the_prediction_is_the_error_of_the_next_trial(self) -> None:
        """With the exact model, no noise: sample by sample."""
        loop = linear_loop(START)
        found = next_iteration(loop, trial_with_friction(loop, MOVE), form="axis_model")
        after = trial_with_friction(found.loop, MOVE)
        # 1e-8 of the 19 um of the first trial
        assert np.max(np.abs(after.following_error - found.predicted)) < 1e-8 * found.trial.peak

    @HOUSE
    @given(
        mass=st.floats(5.0, 500.0),
        period=st.sampled_from([1e-4, 2.5e-4, 5e-4]),
        delay=st.integers(0, 2),
        columns=st.sampled_from([("mass", "viscous"), tuple(TRUE), (*TRUE, "stribeck"), (*TRUE, "jerk_feedforward")]),
    )
    def test_trials_converge_for_other_axes(
        self, mass: float, period: float, delay: int, columns: tuple[str, ...]
    ) -> None:
        """Model-free, from nothing: the second of two updates finds the mass within 3 %, whatever the rest."""
        law = CascadePPI(Kv=40.0, Kp=0.09 / period * mass, Tn=0.015)
        dry = DisturbanceCompensator(coulomb_positive=0.8 * mass, coulomb_negative=0.6 * mass)
        loop = linear_loop(
            dict.fromkeys(columns, 0.0),
            law=law,
            mass=mass,
            viscous=3.0 * mass,
            sample_time=period,
            dead_time=delay * period,
            stribeck_velocity=6e-3 if "stribeck" in columns else None,
        )
        if "coulomb_positive" not in columns:
            dry = DisturbanceCompensator(coulomb_positive=0.0)
        first = trial_with_friction(loop, MOVE, dry)
        for _ in range(3):
            loop = next_iteration(loop, trial_with_friction(loop, MOVE, dry)).loop
        assert compensator(loop).parameters()["mass"] == pytest.approx(mass, rel=0.03)
        assert trial_with_friction(loop, MOVE, dry).rms < 0.05 * first.rms

    def test_gamma_takes_a_share_of_the_step(self) -> None:
        loop = linear_loop(START)
        trial = trial_with_friction(loop, MOVE)
        whole, half = (next_iteration(loop, trial, gamma=gamma).after.parameters() for gamma in (1.0, 0.5))
        for name, value in START.items():
            assert half[name] - value == pytest.approx(0.5 * (whole[name] - value), rel=1e-12)

    def test_mu_draws_the_step_to_nothing(self) -> None:
        loop = linear_loop(START)
        trial = trial_with_friction(loop, MOVE)
        found = next_iteration(loop, trial, mu=1e6)
        for name, value in found.after.parameters().items():
            assert value == pytest.approx(START[name], abs=1e-3)

    def test_bounds_are_kept_and_named_and_the_others_are_fitted_again(self) -> None:
        """An axis that is pushed forward by its friction: Coulomb levels below 0 stay at 0."""
        loop = linear_loop({**START, "mass": 150.0})
        dry = DisturbanceCompensator(coulomb_positive=0.0)
        helped = linear_loop({**TRUE, "coulomb_positive": 0.0, "coulomb_negative": 0.0}, viscous=0.0)
        found = next_iteration(helped, trial_with_friction(helped, MOVE, dry))
        assert found.held
        for name in found.held:
            assert found.after.parameters()[name] == 0.0
        heavy = next_iteration(loop, trial_with_friction(loop, MOVE), least_mass=140.0)
        assert heavy.after.parameters()["mass"] == 140.0
        assert heavy.held == ("mass",)
        free = next_iteration(loop, trial_with_friction(loop, MOVE))
        assert heavy.predicted_rms > free.predicted_rms

    def test_references_may_change_between_trials(self) -> None:
        loop = linear_loop(START, dead_time=0.0)
        before = trial_with_friction(loop, MOVE).rms
        for distance, velocity in ((0.1, 0.25), (0.06, 0.15), (0.2, 0.4), (0.03, 0.1)):
            move = SnapLimitedMove(distance=distance, **{**OUT_AND_BACK, "velocity": velocity})
            loop = next_iteration(loop, trial_with_friction(loop, move)).loop
        # four updates at a rate of 0.04, judged on a move that was learned from only once
        assert trial_with_friction(loop, MOVE).rms < 0.002 * before

    def test_the_loop_of_trials_is_the_update_again_and_again(self) -> None:
        """Against the same by hand, to the bit."""
        loop = linear_loop(START)
        trials = iterate_trials(loop, MOVE, 3)
        for j, trial in enumerate(trials.trials[:-1]):
            step = next_iteration(trials.loops[j], trial)
            assert step.after.parameters() == compensator(trials.loops[j + 1]).parameters()
        assert trials.rms[2] < 0.05 * trials.rms[0]
        assert trials.table().heads == ["trial", "1", "2", "3"]

    def test_wrong_values_are_refused(self) -> None:
        loop = linear_loop(START)
        trial = trial_with_friction(loop, MOVE)
        wrong: list[dict[str, Any]] = [{"gamma": 0.0}, {"gamma": 1.5}, {"mu": -1.0}, {"saturation": "no"}, {"skip": -1}]
        for given_ in wrong:
            with pytest.raises(ParameterError, match=next(iter(given_))):
                next_iteration(loop, trial, **given_)
        with pytest.raises(ParameterError, match="no parameter 'lead'; it has mass, viscous"):
            next_iteration(loop, trial, columns=("lead",))


class TestFrozen:
    def test_friction_without_a_reversal(self) -> None:
        one_way = SnapLimitedMove(distance=0.1, **{**OUT_AND_BACK, "back": False})
        loop = linear_loop(START)
        found = next_iteration(loop, trial_with_friction(loop, one_way))
        assert set(found.frozen) == {"coulomb_positive", "coulomb_negative"}
        assert "no reversal: 0 % of its moving samples go towards smaller positions" in found.frozen["coulomb_negative"]
        assert "at least 2 % are needed" in found.frozen["coulomb_negative"]
        assert found.after.parameters()["coulomb_negative"] == START["coulomb_negative"]
        assert "mass" in found.errors

    def test_a_trial_that_teaches_nothing_is_refused_with_the_reasons(self) -> None:
        one_way = SnapLimitedMove(distance=-0.1, **{**OUT_AND_BACK, "back": False})
        loop = linear_loop(START)
        trial = trial_with_friction(loop, one_way)
        with pytest.raises(LogError, match=r"identifies no parameter.*towards larger positions.*samples more"):
            next_iteration(loop, trial, columns=("coulomb_positive", "coulomb_negative"))

    def test_viscous_friction_at_one_speed(self) -> None:
        """Almost without acceleration: b v and the Coulomb levels are one column."""
        hard = {**OUT_AND_BACK, "acceleration": 2e3, "jerk": 2e7, "snap": 2e11}
        loop = linear_loop(START)
        one = SnapLimitedMove(distance=0.3, **hard)
        found = next_iteration(
            loop, trial_with_friction(loop, one), columns=("viscous", "coulomb_positive", "coulomb_negative")
        )
        assert "not explained by coulomb_positive and coulomb_negative" in found.frozen["viscous"]
        assert "add a second speed" in found.frozen["viscous"]

    def test_an_axis_at_rest(self) -> None:
        loop = linear_loop(START)
        rest = SnapLimitedMove(distance=0.0, **OUT_AND_BACK)
        with pytest.raises(LogError, match="does not move"):
            next_iteration(loop, trial_with_friction(loop, rest))

    def test_what_was_not_asked_for_keeps_its_value(self) -> None:
        loop = linear_loop({**START, "coulomb_positive": 7.0})
        found = next_iteration(loop, trial_with_friction(loop, MOVE), columns=("mass", "viscous"))
        assert found.after.parameters()["coulomb_positive"] == 7.0
        assert found.frozen["coulomb_positive"] == "not asked for"


class TestSaturation:
    def limited(self) -> Any:
        loop = linear_loop(START)
        control = dataclasses.replace(loop.control, force_limit=420.0)
        return dataclasses.replace(loop, control=control)

    def test_a_saturated_trial_is_refused(self) -> None:
        loop = self.limited()
        trial = trial_with_friction(loop, MOVE)
        assert trial.saturated is not None
        count = int(np.sum(trial.saturated))
        assert count > 0
        with pytest.raises(LogError, match=f"limited in {count} samples, the first at .* s; 0 are admitted"):
            next_iteration(loop, trial)

    def test_its_samples_may_be_left_out(self) -> None:
        """The rest of the trial still finds the mass, which the whole one would miss."""
        loop = self.limited()
        trial = trial_with_friction(loop, MOVE)
        rest = next_iteration(loop, trial, saturation="left_out").after.parameters()["mass"]
        blind = next_iteration(loop, dataclasses.replace(trial, saturated=None)).after.parameters()["mass"]
        assert abs(rest - 120.0) < abs(blind - 120.0)
        assert rest == pytest.approx(120.0, rel=0.05)


class TestStandardErrors:
    @pytest.mark.slow(reason="sixty runs; the errors of white noise are compared quickly")
    def test_they_are_the_scatter_over_many_runs(self) -> None:
        """100 N white force noise, coloured by the loop: 60 runs know a scatter to ±10 %, a run its own to ±15 %."""
        loop = linear_loop(TRUE)
        found = [next_iteration(loop, trial_with_friction(loop, MOVE, noise=100.0, seed=seed)) for seed in range(60)]
        scatter = np.std([list(each.after.parameters().values()) for each in found], axis=0, ddof=1)
        reported = np.mean([[each.errors[name] for name in TRUE] for each in found], axis=0)
        ratio = reported / scatter
        assert np.all(ratio > 0.75)
        assert np.all(ratio < 1.35)

    def test_white_noise_gives_the_usual_errors(self) -> None:
        from feeddrive.identification.regression import standard_errors

        rng = np.random.default_rng(1)
        seen = rng.standard_normal((4000, 3)) * [1.0, 3.0, 0.1]
        residual = 0.5 * rng.standard_normal(4000)
        usual = 0.5 * np.sqrt(np.diag(np.linalg.inv(seen.T @ seen)))
        # 20 lags of a sampled autocorrelation are each uncertain by 1/√4000
        assert standard_errors(seen, residual, 20) == pytest.approx(usual, rel=0.1)

    def test_noise_does_not_bias(self) -> None:
        """The columns are free of noise: the mean over runs is the estimate without noise, within 3 standard errors."""
        loop = linear_loop(TRUE)
        clean = next_iteration(loop, trial_with_friction(loop, MOVE)).after.parameters()
        runs = [next_iteration(loop, trial_with_friction(loop, MOVE, noise=50.0, seed=seed)) for seed in range(25)]
        for name, value in clean.items():
            values = [run.after.parameters()[name] for run in runs]
            assert np.mean(values) == pytest.approx(value, abs=3.0 * np.std(values) / 5.0)


class TestConvergence:
    def test_the_rate_is_what_trials_show(self) -> None:
        """The slowest direction alone, without noise, shrinks by ρ from trial to trial."""
        loop = linear_loop(TRUE, dead_time=0.0)
        found = convergence(loop, MOVE)
        values, vectors = np.linalg.eig(found.matrix)
        slowest = int(np.argmax(np.abs(values)))
        _, phi, _ = regressors(loop, compensator(loop), MOVE.at(along(MOVE)))
        slow = np.real(vectors[:, slowest]) / np.linalg.norm(filtered(error_model(loop), phi), axis=0)
        slow = 0.1 * slow / np.max(np.abs(slow / list(TRUE.values())))
        moved = {name: value + float(off) for (name, value), off in zip(TRUE.items(), slow, strict=True)}
        away = compensated(loop, DisturbanceCompensator(**moved))
        ends = [
            list(next_iteration(each, trial_with_friction(each, MOVE), mu=0.0).after.parameters().values())
            for each in (loop, away)
        ]
        rate = float(np.real(values[slowest]))
        # rounding of the two runs, over the size of the deviation
        assert np.subtract(ends[1], ends[0]) == pytest.approx(rate * slow, abs=1e-6 * float(np.max(np.abs(slow))))

    def test_wrong_gains_diverge_at_gamma_1_and_converge_at_a_half(self) -> None:
        loop = linear_loop(TRUE)
        believed = tree.vary(loop, {"axis.x.control.law.Kp": 2.0 * float(tree.get(loop, "axis.x.control.law.Kp"))})
        assert not convergence(loop, MOVE, believed=believed).converges
        assert convergence(loop, MOVE, believed=believed, gamma=0.5).rate < 0.1

    def test_a_column_that_is_not_excited_is_named(self) -> None:
        with pytest.raises(ParameterError, match="does not excite coulomb_negative"):
            convergence(linear_loop(TRUE), SnapLimitedMove(distance=0.1, **{**OUT_AND_BACK, "back": False}))


class TestBegin:
    def test_inertia_is_taken_over(self) -> None:
        loop = linear_loop(START)
        control = dataclasses.replace(loop.control, feedforward=(Inertia(mass=70.0, viscous=10.0),))
        begun = compensator(begin_compensation(dataclasses.replace(loop, control=control)))
        assert begun.parameters() == {"mass": 70.0, "viscous": 10.0, "coulomb_positive": 0.0, "coulomb_negative": 0.0}

    def test_a_law_without_compensator_is_told_what_to_do(self) -> None:
        loop = linear_loop(START)
        bare = dataclasses.replace(loop, control=dataclasses.replace(loop.control, feedforward=()))
        with pytest.raises(StructureError, match="there is none: add one"):
            next_iteration(bare, trial_with_friction(loop, MOVE))

    def test_columns_and_their_velocity(self) -> None:
        loop = linear_loop(START)
        with pytest.raises(ParameterError, match="needs the velocity"):
            begin_compensation(loop, ("stribeck",))
        with pytest.raises(ParameterError, match="there is no 'friction'; there are mass"):
            begin_compensation(loop, ("friction",))
        assert compensator(begin_compensation(loop, ("stribeck",), stribeck_velocity=5e-3)).stribeck == 0.0


def test_the_rigid_plant_may_be_given() -> None:
    loop = linear_loop({**START, "mass": 1.0})
    trial = trial_with_friction(loop, MOVE)
    found = next_iteration(loop, trial, form="model_based", plant=Rigid(mass=100.0))
    assert found.after.parameters()["mass"] == pytest.approx(120.0, rel=0.03)


@pytest.mark.parametrize(("share", "frozen"), [(0.015, True), (0.03, False)])
def test_two_percent_of_the_samples_separate_friction_from_gravity(share: float, frozen: bool) -> None:
    back = round(1000 * share)
    velocity = np.repeat([0.1, -0.1], [1000 - back, back])
    columns = np.column_stack([np.sign(velocity), np.linspace(-1.0, 1.0, 1000)])
    reasons = not_excited(["coulomb_positive", "mass"], columns, columns, velocity, 0.01)
    assert ("coulomb_positive" in reasons) is frozen


@pytest.mark.parametrize(("own", "frozen"), [(0.015, True), (0.03, False)])
def test_a_column_needs_a_fiftieth_that_others_do_not_explain(own: float, frozen: bool) -> None:
    """Its parameter has an error that is 1/share as large as that of a column alone."""
    velocity = np.array([0.1, -0.1, 0.1, -0.1])
    mass, other = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0, 0.0])
    columns = np.column_stack([mass, np.sqrt(1.0 - own**2) * mass + own * other])
    assert ("viscous" in not_excited(["mass", "viscous"], columns, columns, velocity, 0.0)) is frozen


@pytest.mark.parametrize(("rows", "enough"), [(15, False), (30, True)])
def test_a_parameter_needs_twenty_samples(rows: int, enough: bool) -> None:
    loop = linear_loop({"mass": 30.0})
    accelerating = along(MOVE)[120 : 120 + rows]
    trial = Trial("short", MOVE.at(accelerating), np.full(rows, 1e-6), T)
    if enough:
        assert next_iteration(loop, trial).errors
        return
    with pytest.raises(LogError, match="15 samples are left for 1 parameters"):
        next_iteration(loop, trial)


def test_without_a_mass_the_model_has_a_millionth_of_that_of_the_axis() -> None:
    """A plant refuses a mass of 0, and no gain of a loop fits one that is next to nothing: 120 kg are 0.00012 kg."""
    with pytest.raises(UnstableError, match=r"a mass of 0\.00012 kg"):
        error_model(linear_loop({"mass": 0.0, "viscous": 0.0}), "model_based")
