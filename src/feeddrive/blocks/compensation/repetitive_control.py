"""Repetitive control: the set position is shifted by a correction learned from the errors of earlier periods."""

from dataclasses import replace
from typing import Any, NamedTuple, Self

from feeddrive.blocks.families import Compensation
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, choice, parameter
from feeddrive.language.errors import ParameterError
from feeddrive.language.ring import History


class RepetitiveControl(Compensation):
    """Plug-in repetitive control of a motion that repeats every N = `period_samples` samples.

        w(k) = Σ q_i [w(k-N+i) + learning_gain e(k-N+i+l)],   i = -n .. n,   e = x_set - x_load, limited to ±most_shift
        x_r  = x_set + w,   v_r = v_set + (w(k) - w(k-1))/T

    q is a zero-phase filter whose taps are (weight, 1 - 2 weight, weight) convolved n = `passes` times with itself, and
    l = `lead_samples` is the lead within the previous period.  With T_r, the response from set position to load,
    learning converges if max |q (1 - learning_gain T_r z^l)| < 1 over all frequencies; `tune_repetitive` chooses the
    lead by this criterion.  The ratio of the sensitivities with and without this block,

        |S_with / S_without| = |(1 - q z^-N)/(1 - q z^-N (1 - learning_gain T_r z^l))|

    is 6e-4 at a harmonic of the period and up to 2.7 between harmonics.  Learning starts after two periods, and
    pauses while the force is limited.  A trip, or enabling the loop, clears the memory, but the end of a motion does
    not: enable the loop again before a different motion.

    When to use: cams, turning of pistons, oscillating grinding, forces locked to a spindle, cogging at one speed.  Not
    suitable for a contour that does not repeat, or for a period known only to within 1 %, an error that spoils the
    result.
    Exported code stores each memory cell in a separate variable, so N - l - n must be at most 256.
    Source: Inoue et al. 1981; Tomizuka, Tsao & Chew 1989 (plug-in form, zero-phase q).
    """

    period_samples: int = choice("N: samples of a period", least=2, most=1_000_000)
    lead_samples: int = choice("l: samples by which the errors are taken earlier", default=0, least=0, most=1000)
    passes: int = choice("n: how often the kernel of q is convolved with itself", default=32, least=1, most=64)
    weight: Number = parameter("", "of either neighbor in the kernel of q", least=0, most=0.25, default=0.25)
    learning_gain: Number = parameter(
        "", "share of an error that is learned from period to period", least=0, most=1, default=1
    )
    most_shift: Number = parameter("m", "largest shift of the set position", above=0, default=1e-3)
    waits: bool = choice("learning starts after two periods; else at once", default=True)

    class Prepared(NamedTuple):
        """The taps q_0 .. q_n."""

        taps: tuple[Number, ...]

    class State(NamedTuple):
        """The past shifts, filter window and past filter outputs (m, newest first); samples until learning starts."""

        shifts: tuple[Any, ...]
        window: tuple[Any, ...]
        past: History
        wait: Number

    def check(self) -> None:
        """Raise ParameterError if the period is too short for filter and lead."""
        least = 2 * (self.passes + self.lead_samples)
        if self.period_samples < least:
            raise ParameterError(
                f"{self.kind}.period_samples = {self.period_samples} must be at least 2 (passes + lead_samples) = "
                f"{least}: take fewer of these, or a period of several turns"
            )

    def settled(self) -> Self:
        """Return the block as it acts once learning has started."""
        return replace(self, waits=False) if self.waits else self

    def prepare(self, T: Number) -> Prepared:
        """Compute the taps of q by n convolutions."""
        return self.Prepared(taps(self.weight, self.passes))

    def start(self, prepared: Prepared, setpoint: Setpoint, reading: Reading) -> State:
        """Return the state before anything is learned."""
        zero = ops.zero(setpoint.position)
        kept = self.period_samples - self.lead_samples - self.passes
        wait = zero + (2.0 * float(self.period_samples) if self.waits else 0.0)
        # one shift at least: the velocity of the setpoint needs the last one
        shifts = (zero,) * max(1, self.lead_samples)
        return self.State(shifts, (zero,) * (2 * self.passes + 1), History.start(kept, zero), wait)

    def step(
        self, prepared: Prepared, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Setpoint, Number]:
        n, kept = self.passes, self.period_samples - self.lead_samples - self.passes
        shift = ops.clip(state.past.ago(float(kept - 1)), -self.most_shift, self.most_shift)
        # while the force is limited an error is not that of the shift, and learning it would wind up
        free = ops.equal(reading.applied, reading.requested)
        learns = ops.both(free, state.wait <= 0.0) if self.waits else free
        error = ops.where(learns, setpoint.position - reading.position_load, 0.0)
        behind = state.shifts[-1] if self.lead_samples else shift
        window = (behind + self.learning_gain * error, *state.window[:-1])
        filtered = prepared.taps[0] * window[n]
        for i in range(1, n + 1):
            # q has no phase: both neighbors have one tap, and share its product
            filtered = filtered + prepared.taps[i] * (window[n - i] + window[n + i])
        moved = setpoint._replace(
            position=setpoint.position + shift, velocity=setpoint.velocity + (shift - state.shifts[0]) / T
        )
        wait = ops.maximum(state.wait - 1.0, 0.0) if self.waits else state.wait
        return self.State((shift, *state.shifts[:-1]), window, state.past.push(filtered), wait), moved, 0.0

    def retune(self, state: State, old: Self, old_prepared: Prepared, prepared: Prepared) -> State:
        """Return the state unchanged: the learned shifts are positions in m, which no parameter scales."""
        return state


def taps(weight: Number, count: int) -> tuple[Number, ...]:
    """Return the kernel (weight, 1 - 2 weight, weight) convolved `count` times with itself, center first."""
    middle = 1.0 - 2.0 * weight
    weights: list[Any] = [1.0]
    for _ in range(count):
        wide = [*weights, 0.0, 0.0]
        weights = [
            # the kernel is symmetric: the left neighbor of its center equals the right one
            middle * wide[i] + weight * ((wide[1] if i == 0 else wide[i - 1]) + wide[i + 1])
            for i in range(len(weights) + 1)
        ]
    return tuple(weights)
