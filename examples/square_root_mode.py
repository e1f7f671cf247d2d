"""A nonlinear law of one's own: it has no slope at its operating point. What is known of its loop all the same?"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

import feeddrive as fd
from feeddrive.blocks.families import Law
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Number, parameter


class SquareRootMode(Law):
    """Second-order sliding mode: a continuous force that brings a line of position and velocity error to zero.

        s(k)   = rate (x_set - x) + v_set - (x(k) - x(k-1)) / T
        F(k)   = reaching √|s| sign(s) + w(k),    s in units of 1 m/s
        w(k+1) = w(k) + T twisting sign(s)

    Not with a coarse encoder: one count is a step of resolution/T in s.  Source: Levant 1993; Moreno & Osorio 2008.
    """

    rate: Number = parameter("1/s", "rate at which the position error falls on s = 0", above=0)
    reaching: Number = parameter("N", "force at |s| = 1 m/s", above=0)
    twisting: Number = parameter("N/s", "how fast the other part grows", above=0)

    class State(NamedTuple):
        """Last reading (m) and the part that grows (N)."""

        position: Number
        grown: Number

    def start(self, prepared: object, setpoint: Setpoint, reading: Reading) -> State:
        """At rest at the reading, with the force that acts."""
        return self.State(reading.position_load, reading.applied)

    def step(
        self, prepared: object, state: State, setpoint: Setpoint, reading: Reading, T: Number
    ) -> tuple[State, Number]:
        """The equations above."""
        velocity = (reading.position_load - state.position) / T
        s = self.rate * (setpoint.position - reading.position_load) + setpoint.velocity - velocity
        side = ops.sign(s)
        force = self.reaching * ops.sqrt(abs(s)) * side + state.grown
        return self.State(reading.position_load, state.grown + T * self.twisting * side), force

    def retune(self, state: State, old: SquareRootMode, old_prepared: object, prepared: object) -> State:
        """After a live change the force goes on: what has grown is in N."""
        return state


if __name__ == "__main__":
    today = fd.read_machine("linear_motor").loop("x")
    law = SquareRootMode(rate=60.0, reaching=1000.0, twisting=3000.0)
    loop = replace(today, control=replace(today.control, law=law))
    move = fd.blocks.SnapLimitedMove(distance=0.1, velocity=0.2, acceleration=2, jerk=100, snap=1e4)
    for name, each in (("today", today), ("square-root mode", loop)):
        run = fd.simulate(each, move)
        error = run["tracking_error"]
        ripple = np.std(np.diff(run["force"]))
        print(f"{name:14}: {1e6 * np.sqrt(np.mean(error**2)):.3f} um RMS, the force moves by {ripple:.2g} N a sample")
    try:
        fd.stability(loop)
    except fd.FeeddriveError as refused:
        print(refused)
