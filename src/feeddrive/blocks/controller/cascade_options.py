"""Options of the P-PI cascade that have memory: a slower position loop, a reference model, a smoothed velocity."""

from typing import NamedTuple

from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number


def commanded_velocity(Kv: Number, share: Number, setpoint: Setpoint, reading: Reading, T: Number) -> Number:
    """Return the velocity that a P position loop with velocity feedforward commands, m/s.

    wanted = Kv (x_set - x_load) + share · v_set,   v_set = (x_set(k) - x_set(k-1)) / T
    """
    wanted = Kv * (setpoint.position - reading.position_load)
    return wanted + share * setpoint.backward_velocity(T)


class Interpolator(NamedTuple):
    """The velocity command between two runs of a position loop that runs every n-th sample.

        command(k + i) = last + (i + 1)/n · (new - last),   i = 0 .. n-1,   new: the command of the position loop at k

    It changes in n equal steps and reaches `new` one sample before the position loop runs again.

    passed     samples since the last run of the position loop
    last, new  velocity commands before and after that run, m/s
    """

    passed: Number
    last: Number
    new: Number


def interpolator(every: int, zero: Number) -> tuple[Interpolator, ...]:
    """Return the initial state: the position loop runs in the first sample; empty if it runs in every sample."""
    return () if every == 1 else (Interpolator(zero, zero, zero),)


def interpolated(
    state: tuple[Interpolator, ...], wanted: Number, every: int
) -> tuple[tuple[Interpolator, ...], Number]:
    """Return the new state and the velocity command (m/s) from `wanted`, the position loop's present command."""
    if not state:
        return (), wanted
    before = state[0]
    runs = before.passed <= 0.0
    last, new = ops.where(runs, before.new, before.last), ops.where(runs, wanted, before.new)
    passed = before.passed + 1.0
    command = last + (passed / float(every)) * (new - last)
    after = ops.where(passed >= float(every), 0.0, passed)
    return (Interpolator(after, last, new),), command


class ReferenceModel(NamedTuple):
    """A model of the axis under P velocity control; its velocity is the setpoint of the integral.

        u(k) = Kp (command - v_m(k)),   v_m(k+1) = v_m(k) + T (u(k-d) + u(k-d-1))/2m

    The axis is modeled as a free mass m with d samples of dead time.

    The integral then does not wind up while the axis follows as expected: the velocity loop keeps its loop gain without
    overshoot and without the lag of a setpoint filter.

    velocity  v_m one sample earlier, m/s
    forces    past u, newest first, N
    """

    velocity: Number
    forces: tuple[Number, ...]


def reference_model(samples: int, velocity: Number, zero: Number) -> ReferenceModel:
    """Return the state at a constant velocity in m/s, for a dead time in samples."""
    return ReferenceModel(velocity, (zero,) * (samples + 2))


def expected_velocity(
    state: tuple[ReferenceModel, ...], wanted: Number, Kp: Number, mass: Number | None, T: Number
) -> tuple[tuple[ReferenceModel, ...], Number]:
    """Return the new state and the setpoint of the integral in m/s: the model velocity, or `wanted` without a model."""
    if not state or mass is None:
        return (), wanted
    before = state[0]
    # the velocity loop reads mean velocities of a sample: under held forces they change by the mean of two forces
    velocity = before.velocity + (0.5 * T / mass) * (before.forces[-2] + before.forces[-1])
    return (ReferenceModel(velocity, (Kp * (wanted - velocity), *before.forces[:-1])),), velocity


def smoothed_velocity(
    state: tuple[Number, ...], velocity: Number, lag: Number | None, T: Number
) -> tuple[tuple[Number, ...], Number]:
    """Return the new state and a velocity (m/s) after a low pass of first order, which is `velocity` without a lag.

        v(k) = v(k-1) + T / (lag + T) (velocity - v(k-1))

    lag  s.  This is the implicit Euler method, by which drives compute it: it is stable for any lag.
    """
    if not state or lag is None:
        return (), velocity
    after = state[0] + (T / (lag + T)) * (velocity - state[0])
    return (after,), after
