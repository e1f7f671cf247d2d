"""An axis alone, moved by given forces; and an event-driven truth for dry friction that shares no line with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from feeddrive.blocks.families import Feedforward
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.loop.axis import Axis
from feeddrive.loop.core import advance


@dataclass
class Record:
    """Coordinates and velocities at kT, shape (n+1, coordinates); forces over each sample, shape (n,)."""

    position: np.ndarray
    velocity: np.ndarray
    friction_motor: np.ndarray
    friction_load: np.ndarray
    drive: np.ndarray
    states: list[Any]


def move(
    axis: Axis,
    T: float,
    commands: Sequence[float],
    *,
    loads: Sequence[float] | None = None,
    position: float = 0.0,
    velocity: float = 0.0,
) -> Record:
    """The axis under commanded forces in N, one a sample."""
    timing = axis.timing(T)
    axis = tree.rebuild(axis, (np.float64(value) for _, value in tree.leaves(axis)))
    with np.errstate(all="ignore"):
        T = np.float64(T)
        prepared = axis.prepare(T, timing)
        state = axis.start(np.float64(position), np.float64(velocity), timing)
        states, steps = [state], []
        for k, command in enumerate(commands):
            load = None if loads is None else np.float64(loads[k])
            state, done = advance(axis, prepared, state, np.float64(command), load, np.float64(k) * T, T)
            states.append(state)
            steps.append(done)
    return Record(
        position=np.array([held.position for held in states], dtype=float),
        velocity=np.array([held.velocity for held in states], dtype=float),
        friction_motor=np.array([done.friction_motor for done in steps], dtype=float),
        friction_load=np.array([done.friction_load for done in steps], dtype=float),
        drive=np.array([done.drive for done in steps], dtype=float),
        states=states,
    )


def matrices(axis: Axis) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M, C, K of an axis, with the viscous part of its friction."""
    made = axis.mechanics()
    M, C, K = (np.array(part, dtype=float) for part in (made.mass, made.damping, made.stiffness))
    return M, C, K


@dataclass
class Dry:
    """Set-valued friction of one body for the truth: level towards v > 0 and towards v < 0, as functions of |v|."""

    body: int
    positive: Callable[[float], float]
    negative: Callable[[float], float]


# N, by which the pull must exceed the level to break a body away: its first acceleration then has a sure sign
_BEYOND = 1e-9


class EventDriven:
    """Bodies with a diagonal mass matrix and dry friction, integrated from event to event at 1e-10.

    Each contact sticks (0), or slips in one direction (±1).  A slipping one is watched for v = 0, a sticking one for
    the force that breaks it away; nothing is smoothed.
    """

    def __init__(self, M: np.ndarray, C: np.ndarray, K: np.ndarray, dry: Sequence[Dry]) -> None:
        self.m, self.C, self.K, self.dry = np.diag(M), C, K, dry
        self.n = len(self.m)

    def pull(self, y: np.ndarray, force: np.ndarray) -> np.ndarray:
        """All forces but dry friction."""
        return force - self.K @ y[: self.n] - self.C @ y[self.n :]

    def level(self, contact: Dry, mode: int, v: float) -> float:
        """Of a slipping contact."""
        return contact.positive(abs(v)) if mode > 0 else contact.negative(abs(v))

    def slope(self, modes: Sequence[int], force: np.ndarray) -> Callable[[float, np.ndarray], np.ndarray]:
        """y' for given modes."""

        def derivative(t: float, y: np.ndarray) -> np.ndarray:
            total = self.pull(y, force)
            v = y[self.n :].copy()
            for contact, mode in zip(self.dry, modes, strict=True):
                if mode == 0:
                    total[contact.body] = 0.0
                    v[contact.body] = 0.0
                else:
                    total[contact.body] -= mode * self.level(contact, mode, y[self.n + contact.body])
            return np.concatenate([v, total / self.m])

        return derivative

    def settle(self, y: np.ndarray, force: np.ndarray, modes: list[int], at_rest: Sequence[int]) -> None:
        """The modes of contacts whose body is at rest, by the pull on each."""
        for i in at_rest:
            contact = self.dry[i]
            y[self.n + contact.body] = 0.0
            pull = self.pull(y, force)[contact.body]
            if pull > contact.positive(0.0) + _BEYOND:
                modes[i] = 1
            elif pull < -contact.negative(0.0) - _BEYOND:
                modes[i] = -1
            else:
                modes[i] = 0

    def events(self, modes: Sequence[int], force: np.ndarray) -> list[Any]:
        """One for each contact."""
        found = []
        for contact, mode in zip(self.dry, modes, strict=True):
            if mode == 0:

                def event(t: float, y: np.ndarray, contact: Dry = contact) -> float:
                    pull = self.pull(y, force)[contact.body]
                    return min(contact.positive(0.0) - pull, pull + contact.negative(0.0)) + _BEYOND

            else:

                def event(t: float, y: np.ndarray, contact: Dry = contact, mode: int = mode) -> float:
                    # above 0 at the start of a slip, so that a return within one step of the integrator is found
                    return mode * y[self.n + contact.body] + 1e-15

            event.terminal = True  # type: ignore[attr-defined]
            event.direction = -1  # type: ignore[attr-defined]
            found.append(event)
        return found

    def run(self, T: float, forces: np.ndarray, y: np.ndarray) -> np.ndarray:
        """States at kT under forces held over each sample, shape (n, bodies); y is (positions, velocities)."""
        y = y.astype(float).copy()
        modes = [int(np.sign(y[self.n + contact.body])) for contact in self.dry]
        rows = [y.copy()]
        for force in forces:
            self.settle(y, force, modes, [i for i, mode in enumerate(modes) if mode == 0])
            t = 0.0
            for _ in range(1000):
                done = solve_ivp(
                    self.slope(modes, force),
                    (t, T),
                    y,
                    method="DOP853",
                    rtol=1e-10,
                    atol=1e-14,
                    events=self.events(modes, force),
                )
                t, y = float(done.t[-1]), done.y[:, -1].copy()
                if done.status != 1:
                    break
                for i, times in enumerate(done.t_events):
                    if times.size and modes[i] == 0:  # broken away: by the event, not by the last bit of the pull
                        modes[i] = 1 if self.pull(y, force)[self.dry[i].body] > 0.0 else -1
                    elif times.size:
                        self.settle(y, force, modes, [i])
            else:
                raise AssertionError("the truth does not get on: more than 1000 events in a sample")
            rows.append(y.copy())
        return np.array(rows)


def fed(block: Feedforward, setpoint: Setpoint, T: float) -> Any:
    """The force in N of a feedforward without a memory."""
    return block.step(block.start(setpoint), setpoint, T)[1]
