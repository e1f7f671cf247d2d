"""The `pid` component of LinuxCNC, with the arithmetic of its source."""

from dataclasses import replace
from typing import NamedTuple, Self

from feeddrive.language import ops
from feeddrive.language.block import Block, Number, choice, parameter


class StockPid(Block):
    """One `pid` of LinuxCNC's HAL, reproduced bit for bit with its pitfalls; gains have units of output per command.

        e  = command - feedback, or (previous command) - feedback with `error_previous_target`
        e  limited to ±maxerror, then moved towards 0 by `deadband`
        I  = I + e T, unless the last output was at a limit and e has the sign of that limit; limited to ±maxerrorI
        v  = (command - previous command)/T,  w = (feedback - previous feedback)/T, or the pins for them
        D  = v - w limited to ±maxerrorD
        v, (v - v₋₁)/T, ... limited to ±maxcmdD, ±maxcmdDD, ±maxcmdDDD give d1, d2, d3
        output = (bias + Pgain e + Igain I + Dgain D) + (FF0 command + FF1 d1 + FF2 d2 + FF3 d3), limited to ±maxoutput

    A limit of 0 is no limit.  Surprising behavior: `error_previous_target` is on unless it is switched off; the limit
    on e comes before the dead band; D uses neither of these two and is not the derivative of e; while a limit acts the
    integral stops but is not reduced; a NaN in `feedback` stays in the integral until `enable` falls. Without `enable`
    the output is 0 and the integral is cleared; the differences are still updated.  In the sample in which
    `index_enable` falls, v and w keep their last values, and the error uses the new command.

    Source: LinuxCNC manual page pid(9), and tests of the component itself where the page is silent or wrong.
    """

    Pgain: Number = parameter("", "output per error", default=1)
    Igain: Number = parameter("", "output per error times second", default=0)
    Dgain: Number = parameter("", "output per error per second", default=0)
    FF0: Number = parameter("", "output per command", default=0)
    FF1: Number = parameter("", "output per first derivative of the command", default=0)
    FF2: Number = parameter("", "output per second derivative of the command", default=0)
    FF3: Number = parameter("", "output per third derivative of the command", default=0)
    bias: Number = parameter("", "constant part of the output", default=0)
    deadband: Number = parameter("", "error that is ignored", least=0, default=0)
    maxerror: Number = parameter("", "limit of the error; 0 for none", least=0, default=0)
    maxerrorI: Number = parameter("", "limit of the integral of the error; 0 for none", least=0, default=0)
    maxerrorD: Number = parameter("", "limit of the derivative of the error; 0 for none", least=0, default=0)
    maxcmdD: Number = parameter("", "limit of the first derivative of the command; 0 for none", least=0, default=0)
    maxcmdDD: Number = parameter("", "limit of the second derivative of the command; 0 for none", least=0, default=0)
    maxcmdDDD: Number = parameter("", "limit of the third derivative of the command; 0 for none", least=0, default=0)
    maxoutput: Number = parameter("", "limit of the output; 0 for none", least=0, default=0)
    error_previous_target: bool = choice(
        "whether the error uses the command of the previous sample", options=(False, True), default=True
    )

    class State(NamedTuple):
        """The last command, feedback and derivatives, the integral, the limit reached (-1, 0, 1), `index_enable`."""

        command: Number
        feedback: Number
        command_deriv: Number
        feedback_deriv: Number
        commandD: Number
        commandDD: Number
        errorI: Number
        limited: Number
        index_enable: Number

    def start(self, command: Number, feedback: Number, commandD: Number = 0.0, feedbackD: Number = 0.0) -> State:
        """Return the state of a disabled pid with constant rates of command and feedback.

        HAL itself initializes the component with zeros.
        """
        zero = ops.zero(command)
        rate, back = zero + commandD, zero + feedbackD
        return self.State(command, feedback, rate, back, limited(rate, self.maxcmdD), zero, zero, zero, zero)

    def unlimited(self) -> Self:
        """Return the pid without its limits but with its dead band."""
        return replace(
            self, maxerror=0.0, maxerrorI=0.0, maxerrorD=0.0, maxcmdD=0.0, maxcmdDD=0.0, maxcmdDDD=0.0, maxoutput=0.0
        )

    def step(
        self,
        state: State,
        command: Number,
        feedback: Number,
        T: Number,
        *,
        bias: Number | None = None,
        command_deriv: Number | None = None,
        feedback_deriv: Number | None = None,
        enable: Number | None = None,
        index_enable: Number | None = None,
    ) -> tuple[State, Number]:
        """Carry out one call of the HAL function `do-pid-calcs`.

        None means that a pin is not connected; if `enable` is not connected, the pid is enabled. A connected `bias`
        replaces the parameter.
        """
        # the component multiplies by the reciprocal; a division gives other last bits
        per_second = 1.0 / T
        falls = None if index_enable is None else ops.both(state.index_enable > 0.5, ops.no(index_enable > 0.5))

        error = command - feedback
        if self.error_previous_target:
            error = _unless(falls, error, state.command - feedback)
        error = limited(error, self.maxerror)
        # without a dead band this is the error itself, so that its slope at error 0 is right in a linear model
        inside = ops.clip(error, -self.deadband, self.deadband)
        error = ops.where(self.deadband > 0.0, error - inside, error)

        # the side of the last limit: an error of the other sign is still integrated
        errorI = ops.where(error * state.limited <= 0.0, state.errorI + error * T, state.errorI)
        errorI = limited(errorI, self.maxerrorI)

        if command_deriv is None:
            command_deriv = _unless(falls, state.command_deriv, (command - state.command) * per_second)
        if feedback_deriv is None:
            feedback_deriv = _unless(falls, state.feedback_deriv, (feedback - state.feedback) * per_second)
        errorD = limited(command_deriv - feedback_deriv, self.maxerrorD)
        commandD = limited(command_deriv, self.maxcmdD)
        commandDD = limited((commandD - state.commandD) * per_second, self.maxcmdDD)
        commandDDD = limited((commandDD - state.commandDD) * per_second, self.maxcmdDDD)

        constant = self.bias if bias is None else bias
        # in the component's order of summation, for equal bits
        feedback_part = constant + self.Pgain * error + self.Igain * errorI + self.Dgain * errorD
        forward_part = command * self.FF0 + commandD * self.FF1 + commandDD * self.FF2 + commandDDD * self.FF3
        wanted = feedback_part + forward_part
        output = limited(wanted, self.maxoutput)
        side = ops.where(wanted > output, 1.0, ops.where(wanted < output, -1.0, 0.0))
        if enable is not None:
            runs = enable > 0.5
            output, side = ops.where(runs, output, 0.0), ops.where(runs, side, 0.0)
            errorI = ops.where(runs, errorI, 0.0)
        index = ops.zero(command) if index_enable is None else index_enable
        after = self.State(command, feedback, command_deriv, feedback_deriv, commandD, commandDD, errorI, side, index)
        return after, output


def limited(value: Number, most: Number) -> Number:
    """Return the value clipped to ±most; a `most` of 0 means no limit."""
    return ops.where(most > 0.0, ops.clip(value, -most, most), value)


def _unless(falls: object, held: Number, value: Number) -> Number:
    """Return `held` in the sample in which `index_enable` falls (`falls` is true), otherwise `value`."""
    return value if falls is None else ops.where(falls, held, value)
