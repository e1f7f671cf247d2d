"""Poles that are held in the pole map: those that the law places, or else those of the closed loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, Units, number
from feeddrive.language.text import Text
from feeddrive.studio.desk import Desk, Values
from feeddrive.tuning.poles import LoopPole, Model, loop_poles, nearest_pole, placed_dragged, placed_poles, pole_moved
from feeddrive.tuning.tune import own_tunables

_ACROSS = 0.02  # of |s|: a step of a key
_LOOP = "loop"  # loop.0, loop.1: poles of the closed loop


class HeldPoles:
    """The movable poles of the current control. Poles of the loop keep their names while they move."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self._named: dict[str, complex] = {}

    def shown(self, units: Units) -> tuple[list[dict[str, Any]], str]:
        """Return the handles, Hz across and a height in the unit of the picture, and a sentence that explains them.

        Nothing without a machine.
        """
        bench = self.desk.needed
        if bench.loop is None:
            return [], ""
        placed, nyquist = placed_poles(self.desk.control), 0.5 / float(bench.loop.sample_time)
        if placed:
            sentence = (
                "Dragged are the poles that the law places; the crosses are those of the sampled loop, with delay, "
                "filters and modes that the law does not know."
            )
            return [_grip(pole.name, pole.label, pole.s, nyquist, units) for pole in placed], sentence
        names, loop_poles = self._gains(), self._of_loop()
        if not loop_poles:
            return [], "No single gain of this law moves a pole: change its numbers."
        moved = f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
        sentence = f"Dragged are poles of the loop; {moved} follow with the smallest change that takes the pole there."
        return [_grip(name, "pole of the loop", s, nyquist, units) for name, s in loop_poles], sentence

    def moved(self, name: str, s: complex) -> Values:
        """Return the gains that bring a pole as near as possible to a position (1/s). Raises ParameterError."""
        if not np.isfinite(abs(s)):
            raise ParameterError("a pole must be taken to a finite place")
        if not name.startswith(f"{_LOOP}."):
            return placed_dragged(self.desk.control, name, s)
        if name not in self._named:
            self._of_loop()
        if name not in self._named:
            raise ParameterError(f"there is no pole '{name:.60}' that the gains move")
        axis, model, gains = self._loop()
        values, self._named[name] = pole_moved(axis, model, gains, self._named[name], s)
        return {gain: float(f"{value:.6g}") for gain, value in zip(self._gains(), values, strict=True)}

    def at(self, name: str) -> complex:
        """Return the position of a pole, 1/s. Raises ParameterError for an unknown one."""
        placed = {pole.name: pole.s for pole in placed_poles(self.desk.control)}
        now = placed.get(name, self._named.get(name))
        if now is None:
            raise ParameterError(f"there is no pole '{name:.60}' that can be moved")
        return now

    def stepped(self, name: str, across: float, up: float) -> Values:
        """Return the gains after a pole is moved by keys, in steps of 2 % of its distance from 0."""
        now = self.at(name)
        return self.moved(name, now + _ACROSS * abs(now) * complex(across, up))

    def _gains(self) -> Sequence[str]:
        """Return the tunables that have a logarithm."""
        control = self.desk.control
        return [name for name in own_tunables(control) if float(tree.get(control, name)) > 0.0]

    def _loop(self) -> tuple[Any, Model, np.ndarray]:
        bench, values, names = self.desk.needed, self.desk.values, self._gains()

        def model(gains: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            modelled = bench.by_hand.model({**values, **dict(zip(names, gains, strict=True))}, names)
            assert modelled is not None  # `_of_loop` has seen to it
            return modelled

        return bench.mechanics, model, np.array([values[name] for name in names])

    def _of_loop(self) -> list[tuple[str, complex]]:
        """Return the poles of the loop with their names: each takes that of the nearest earlier one."""
        names = self._gains()
        if not names or self.desk.needed.by_hand.model(self.desk.values, names) is None:
            return []
        there, before = list[LoopPole](loop_poles(*self._loop())), dict(self._named)
        self._named = {}
        for name, s in sorted(before.items(), key=lambda item: _distance(there, item[1])):
            nearest = nearest_pole(there, s)
            if nearest is not None:
                there = [pole for pole in there if pole is not nearest]
                self._named[name] = nearest.s
        fresh = (f"{_LOOP}.{i}" for i in range(len(before) + len(there)) if f"{_LOOP}.{i}" not in self._named)
        self._named |= {name: pole.s for name, pole in zip(fresh, there, strict=False)}
        return list(self._named.items())


def _grip(name: str, label: str, s: complex, nyquist: float, units: Units) -> dict[str, Any]:
    _, factor = units.of("Hz")
    hertz, ratio = abs(s) / (2.0 * np.pi), -s.real / abs(s)
    text = Text(f"{Quantity(hertz, 'Hz')}, damping ratio {number(ratio, 3)}").shown(units)
    return {
        "name": name,
        "label": label,
        "text": text,
        "low": -nyquist,
        "high": nyquist,
        "x": s.real / (2.0 * np.pi),
        "y": factor * s.imag / (2.0 * np.pi),
    }


def _distance(poles: Sequence[LoopPole], s: complex) -> float:
    return min((abs(pole.s - s) for pole in poles), default=0.0)
