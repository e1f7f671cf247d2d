"""The response to a step of the set position: overshoot, rise time and settling time."""

from dataclasses import dataclass

import numpy as np

from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.linearize import StateSpace, linearize
from feeddrive.loop.loop import Loop

SETTLED = 0.02  # of the step: the band in which a position counts as settled
_REST = 1e-4  # of the step: what is left at the end of the second half of a response
_DOUBLINGS = 20  # of the length: a million samples
# the ends of a response creep: 10 to 90 % is the rise time of textbooks
_FIRST, _LAST = 0.1, 0.9  # of the step: between them lies the rise


@dataclass(frozen=True, eq=False, repr=False)
class StepResponse(Result):
    """The position (m) of a linear loop over time (s) after a step of the set position by 1 m at time 0.

    final      final position, m
    settled    half-width of the settling band, as a fraction of `final`
    """

    time: np.ndarray
    position: np.ndarray
    final: float
    settled: float = SETTLED

    @property
    def overshoot(self) -> float:
        """The overshoot as a fraction of the final position; 0 if there is no overshoot."""
        return max(float(np.max(self.position / self.final)) - 1.0, 0.0)

    @property
    def overshoot_time(self) -> float:
        """The time of the maximum position, s."""
        return float(self.time[int(np.argmax(self.position / self.final))])

    @property
    def settling_time(self) -> float:
        """The time in s after which the position stays within the settling band."""
        return settling_time(self.time, self.position / self.final - 1.0, self.settled)

    @property
    def rise_time(self) -> float:
        """The rise time from 10 to 90 % of the final position, s."""
        reached = self.position / self.final
        first, last = (int(np.argmax(reached >= share)) for share in (_FIRST, _LAST))
        return float(self.time[last] - self.time[first])

    def table(self) -> Table:
        """Return a table of overshoot, rise time and settling time."""
        rows = [
            [
                "overshoot",
                Quantity(self.overshoot, "share", form=".2f"),
                Text(f"at {Quantity(self.overshoot_time, 's')}"),
            ],
            ["settling time", Quantity(self.settling_time, "s"), Text(f"to {Quantity(self.settled, 'share'):6}")],
            ["rise time", Quantity(self.rise_time, "s"), "10 to 90 %"],
        ]
        return Table("step of the set position", ["what", "", ""], rows)


def settling_time(time: np.ndarray, error: np.ndarray, near: float) -> float:
    """Return the first time in s after which |error| never exceeds `near`; infinite if the last error exceeds it.

    time and error have shape (n,); near is in the unit of the error
    """
    far = np.flatnonzero(np.abs(error) > near)
    if not far.size:
        return float(time[0])
    return float("inf") if far[-1] == error.size - 1 else float(time[far[-1] + 1])


def step_response(system: StateSpace | Loop, *, velocity: float = 0.05) -> StepResponse:
    """Compute the position after a step of the set position of a linear loop, or of the first input of a model.

    The set velocity and its derivatives remain 0, so their feedforward is inactive; a law that differentiates the
    set position itself does feed the jump forward.  Guard and force limit are inactive, and friction is linearized at
    `velocity` (m/s), see `linearize`.  For a law with a period of N samples every N-th sample is returned.
    Raises UnstableError for a loop that does not come to rest within a million samples, ParameterError for one that
    does not move.
    """
    model = (
        linearize(system, ["set_position"], ["position_load"], velocity=velocity)
        if isinstance(system, Loop)
        else system
    )
    A, B, C, D = model.A, model.B[:, :1], model.C[:1], float(model.D[0, 0])
    n = A.shape[0]
    if n and float(np.max(np.abs(np.linalg.eigvals(A)))) >= 1.0:
        raise UnstableError("the loop is not stable: it has no step response that comes to rest; lower its gains first")
    final = float((C @ np.linalg.solve(np.eye(n) - A, B))[0, 0] + D)
    if final == 0.0:
        raise ParameterError("the position does not follow the set position: is a law part of the loop?")
    # states and the constant input together: with z = [x; 1], z(k + n) = Mⁿ z(k) doubles the length in one product
    power = np.block([[A, B], [np.zeros((1, n)), np.ones((1, 1))]])
    states, row = np.zeros((n + 1, 1)), np.append(C[0], D)
    states[n] = 1.0
    for _ in range(_DOUBLINGS):
        states, power = np.hstack([states, power @ states]), power @ power
        position = row @ states
        # the whole second half: an oscillation passes the final value without having come to rest
        half = position.size // 2
        if half > 8 and np.max(np.abs(position[half:] / final - 1.0)) < _REST:
            return StepResponse(model.sample_time * np.arange(position.size), position, final)
    raise UnstableError("the loop does not come to rest within a million samples: it is at the edge of stability")
