"""A force learned over time: where it wins and where it loses; and the block that plays it back."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.compensation.learned_force import LearnedForce
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.language.errors import ParameterError
from feeddrive.learning.iterative_feedforward import error_model
from feeddrive.learning.trials import _correction, _moves, _response, iterate_trials, learn_signal
from feeddrive.loop.simulate import simulate
from trials import MOVE, OUT_AND_BACK, START, T, along, linear_loop

OTHER = SnapLimitedMove(distance=0.05, **{**OUT_AND_BACK, "velocity": 0.15})


def pulse() -> RecordedForce:
    t = along(MOVE)
    return RecordedForce(force=np.where((t > 0.2) & (t < 0.26), 150.0, 0.0), sample_time=T)


def test_the_same_reference_is_learned_to_the_end_of_the_band() -> None:
    found = learn_signal(linear_loop(START), MOVE, 8, bandwidth=60.0)
    assert found.rate < 1.0
    # without noise what is left is what the filter Q holds back, near the jumps of the jerk
    assert found.rms[-1] < 0.01 * found.rms[0]


def test_a_repeated_disturbance_is_learned_and_parameters_cannot() -> None:
    loop = linear_loop(START)
    signal = learn_signal(loop, MOVE, 6, load=pulse(), bandwidth=60.0)
    parameters = iterate_trials(loop, MOVE, 6, load=pulse())
    assert signal.rms[-1] < 0.2 * parameters.rms[-1]


def test_another_reference_gets_the_force_of_the_first() -> None:
    loop = linear_loop(START)
    turns = (MOVE, MOVE, MOVE, OTHER)
    signal, parameters = learn_signal(loop, turns, 4), iterate_trials(loop, turns, 4)
    alone = simulate(loop, OTHER)["following_error"]
    assert signal.rms[-1] > np.sqrt(np.mean(alone**2))  # worse than nothing learned
    assert parameters.rms[-1] < 0.05 * signal.rms[-1]


def test_beyond_the_band_that_is_known_it_diverges_and_says_so() -> None:
    """Half the velocity gain is believed: the model-based learning filter is wrong by two near the crossover."""
    law_of_twice = linear_loop({**START, "mass": 480.0})
    found = learn_signal(law_of_twice, MOVE, 2, bandwidth=1000.0, form="model_based")
    assert found.rate > 1.0
    assert "DIVERGES" in found.table().title


def test_it_plays_a_row_a_sample_and_rests_at_the_last() -> None:
    force = np.array([3.0, -2.0, 5.0, 0.0])
    loop = linear_loop({}, compensation=(LearnedForce(force=force),))
    found = simulate(loop, SnapLimitedMove(distance=0.0, **OUT_AND_BACK), duration=6 * T)["compensation"]
    assert list(found) == [3.0, -2.0, 5.0, 0.0, 0.0, 0.0, 0.0]


def test_bounds() -> None:
    loop = linear_loop(START)
    with pytest.raises(ParameterError, match=r"bandwidth = 3000 must be > 0 and <= 2000"):
        learn_signal(loop, MOVE, bandwidth=3000.0)
    with pytest.raises(ParameterError, match="gain"):
        learn_signal(loop, MOVE, gain=1.5)
    with pytest.raises(ParameterError, match="trials"):
        learn_signal(loop, MOVE, 1)


@pytest.mark.parametrize(("size", "least", "most"), [(1.0, 0.999, 1.0), (0.01, 0.4, 0.6), (0.001, 0.0, 0.02)])
def test_the_learning_filter_inverts_what_is_above_a_hundredth_of_the_largest_response(
    size: float, least: float, most: float
) -> None:
    """Of an error where |Ĝ_d| is a hundredth of its largest value one half is taken."""
    model = error_model(linear_loop(START), "axis_model")
    f = np.geomspace(1.0, 0.4999 / T, 20_000)
    response = _response(model, np.append(0.0, f))
    taken = _correction(model, np.append(0.0, f)) * response
    k = int(np.argmin(np.abs(np.abs(response) - size * np.max(np.abs(response)))))
    assert least <= taken[k].real <= most


@pytest.mark.parametrize(("travel", "moves"), [(0.7e-9, False), (1.5e-9, True)])
def test_an_axis_that_travels_less_than_a_nanometer_stands(travel: float, moves: bool) -> None:
    assert _moves(Recorded(position=np.linspace(0.0, travel, 100), sample_time=T), T) is moves
