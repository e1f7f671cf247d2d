"""Laws without a finite slope at their operating point: what needs none works, all else names the line."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.analysis.stability import require_stable
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter
from feeddrive.language.errors import NoSlopeError, ParameterError, UnstableError
from feeddrive.loop.routine import controller_routine
from feeddrive.tuning.control_response import ControlResponse

EXAMPLES = Path(__file__).parents[2] / "examples"
LINE = r"square_root_mode\.py, line \d+: force = self\.reaching \* ops\.sqrt\(abs\(s\)\)"
MOVE = fd.blocks.SnapLimitedMove(distance=0.02, velocity=0.2, acceleration=2, jerk=100, snap=1e4)
LINES = np.geomspace(1.0, 4000.0, 20)


@pytest.fixture(scope="module")
def loop() -> fd.Loop:
    """The linear motor under a square-root mode law."""
    spec = importlib.util.spec_from_file_location("square_root_mode", EXAMPLES / "square_root_mode.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["square_root_mode"] = module  # a dataclass looks up the module in which it stands
    spec.loader.exec_module(module)
    return with_law(module.SquareRootMode(rate=60.0, reaching=1000.0, twisting=3000.0))


def with_law(law: Any) -> fd.Loop:
    today = fd.read_machine("linear_motor").loop("x")
    return replace(today, control=replace(today.control, law=law))


REFUSED: dict[str, Callable[[fd.Loop], object]] = {
    "stability": fd.stability,
    "margins": lambda loop: fd.loop_gain(loop, LINES),
    "linearize": lambda loop: fd.linearize(loop, ["set_position"], ["position_load"]),
    "tune": fd.workflow.tune,
    "certify": fd.workflow.certify,
    "the response of the control": lambda loop: ControlResponse(loop.control, 1e-4, ("law.rate",)).at([60.0], LINES),
    "gradient": lambda loop: fd.gradient(loop, MOVE, ["axis.x.control.law.rate"]),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_needs_a_slope_names_the_line(what: str, loop: fd.Loop) -> None:
    """It was "a parameter is so large or so small that it overflows; check masses"; the gradient was nan."""
    with pytest.raises(NoSlopeError, match=LINE):
        REFUSED[what](loop)


def test_what_needs_none_works(loop: fd.Loop) -> None:
    run = fd.simulate(loop, MOVE)
    assert np.max(np.abs(run["tracking_error"])) < 1e-5  # m, of 20 mm: it follows
    assert controller_routine(loop, "axis_x").loop is not None


def test_numbers_that_overflow_are_not_taken_for_steep_lines() -> None:
    gains = {"axis.x.control.law.Kp": 1e200, "axis.x.control.law.Kv": 1e200}
    with pytest.raises(ParameterError, match="overflows") as refused:
        fd.stability(fd.vary(fd.read_machine("linear_motor").loop("x"), gains))
    assert not isinstance(refused.value, NoSlopeError)


class Rooted(Law):
    """F = gain √(1 + e²) e + kept √|e₀|, with e₀ = 0 in a branch that is never taken: both roots have slopes here."""

    gain: Number = parameter("N/m", "force over error", above=0)

    class State(NamedTuple):
        """Last reading, m."""

        position: Number

    def start(self, prepared: object, setpoint: Setpoint, reading: Reading) -> State:
        """At the reading."""
        return self.State(reading.position_load)

    def step(
        self, prepared: object, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        """The equation above, with damping."""
        error = setpoint.position - reading.position_load
        damping = 1e-2 * self.gain * (setpoint.velocity - (reading.position_load - state.position) / T)
        root = ops.where(self.gain > 0.0, ops.sqrt(1.0 + error * error), ops.sqrt(error))
        return self.State(reading.position_load), self.gain * root * error + damping


def test_a_root_with_a_slope_and_one_that_is_not_taken_are_no_reason() -> None:
    found = fd.stability(with_law(Rooted(gain=1e4)))
    plain = fd.linearize(with_law(Rooted(gain=1e4)), ["cut"], ["force"])
    assert found.stable
    assert np.all(np.isfinite(plain.A))


class Switched(Law):
    """F = level sign(e) + gain e, and the gain is another one in every second sample: a count at its own edge."""

    gain: Number = parameter("N/m", "force over error", above=0)
    level: Number = parameter("N", "of the jump", least=0)

    class State(NamedTuple):
        """Last reading (m) and a count."""

        position: Number
        count: Number

    def start(self, prepared: object, setpoint: Setpoint, reading: Reading) -> State:
        """At the reading."""
        return self.State(reading.position_load, 1.0)

    def step(
        self, prepared: object, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        """The equation above, with damping."""
        error = setpoint.position - reading.position_load
        error = error + 1e-2 * (setpoint.velocity - (reading.position_load - state.position) / T)
        gain = ops.where(state.count < 1.0, self.gain, 0.9 * self.gain)
        force = gain * error + self.level * ops.sign(error)
        return self.State(reading.position_load, 1.0 - state.count), force


def test_a_jump_has_no_slope_and_a_count_at_its_edge_is_none() -> None:
    """A relay had the slope 0: `certify` said that the law uses no reading, `stability` gave a verdict without it."""
    assert fd.stability(with_law(Switched(gain=1e4, level=0.0))).stable
    with pytest.raises(NoSlopeError, match=r"a choice that jumps .*test_no_slope\.py, line \d+: .*ops\.sign\(error\)"):
        fd.stability(with_law(Switched(gain=1e4, level=10.0)))


def test_an_unstable_law_without_tunables_says_which_gains_to_lower() -> None:
    """The sentence had a hole: "must be < 1): lower ; shorten dead time"."""
    with pytest.raises(UnstableError, match=r"lower gain") as refused:
        require_stable(with_law(Rooted(gain=3e7)))
    assert "lower ;" not in str(refused.value)
    assert "it is stable up to gain =" in str(refused.value)


@pytest.mark.parametrize("velocity", [0.0, 0.05, 0.08611874207529721, -0.1, 0.3])
@pytest.mark.parametrize("position", [0.0, 0.0371])
def test_a_zero_that_rounding_has_moved_is_one(velocity: float, position: float, loop: fd.Loop) -> None:
    """√|s| of an s of 1e-17 or of a count over T has a slope: `run` printed margins of it, at the speed of its job."""
    with pytest.raises(NoSlopeError, match=LINE):
        fd.linearize(loop, ["cut"], ["force"], velocity=velocity, position=position)
