"""Frequency responses of a plant with its actuator and their exact derivatives, from the linear core of the loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from feeddrive.blocks.families import Plant
from feeddrive.language import matrix, ops, tree
from feeddrive.language.block import Number
from feeddrive.language.graph import Graph
from feeddrive.loop.hold import Port, Rows, Timing, rate
from feeddrive.loop.traced_model import LinearModel, TracedModel

DRIVE = ("dead_time", "current_loop")  # parameters of the actuator, in addition to those of the plant
_ALIASES = 4  # on either side, at most
_ALIAS = 3e-5  # of the response: aliases that are smaller are left out
_SENSORS = ("motor", "load")  # the outputs of the traced model, in their order


@dataclass(frozen=True)
class SensorLines:
    """One response that is fitted: its lines in Hz, its encoder, and which derivative of the position it shows."""

    frequency: np.ndarray
    sensor: str  # "motor" or "load"
    order: int = 0
    sample_time: float | None = None  # s, of a response from a held command to samples of the position


class TracedPlant:
    """x/f = e^(-s·dead_time) · s^order · Gᵢ(s) with its slopes; G is the linear core that the loop holds, traced.

    The parameters are leaves of the plant by name, then "dead_time" (s) and "current_loop" (Hz) of the actuator; the
    slopes are forward tangents of the traced core.  `fixed` holds values of others of them.  Of a sampled response,
    from a command that is held over each sample, the sum over its aliases is taken:

        (1 - e^(-jωT))/T Σ G(jω + jmω_s)/(jω + jmω_s),   |m| <= 4, or fewer where the lines are low

    It agrees with the loop's own sampled model to 2e-5 below a tenth of the sample rate and to 2e-3 at 0.4 of it.
    """

    def __init__(
        self, plant: Plant, names: Sequence[str], lines: Sequence[SensorLines], fixed: Mapping[str, float]
    ) -> None:
        self.plant, self.names, self.lines = plant, tuple(names), tuple(lines)
        known = {name: float(value) for name, value in tree.leaves(plant)} | {"dead_time": 0.0}
        self.known = {**known, **{name: float(value) for name, value in fixed.items()}}
        self.traced = _trace(plant, "current_loop" in (*self.names, *self.known))

    def values(self, parameters: np.ndarray) -> list[float]:
        """All leaves of the plant."""
        found = {**self.known, **dict(zip(self.names, map(float, parameters), strict=True))}
        return [found[name] for name, _ in tree.leaves(self.plant)]

    def responses(self, values: Mapping[str, float]) -> list[np.ndarray]:
        """Each response, without slopes, at other values of any parameters by name."""
        return [response for response, _ in self._at({**self.known, **values}, ())]

    def __call__(self, parameters: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Each response and its slopes, shape (lines, parameters)."""
        return self._at({**self.known, **dict(zip(self.names, map(float, parameters), strict=True))}, self.names)

    def _at(self, values: Mapping[str, float], names: tuple[str, ...]) -> list[tuple[np.ndarray, np.ndarray]]:
        traced = [name for name in names if name != "dead_time"]
        columns = [names.index(name) for name in traced]
        model = self.traced.at({name: np.float64(value) for name, value in values.items()}, traced)
        shared: dict[tuple[bytes, float | None], tuple[np.ndarray, ...]] = {}
        found: list[tuple[np.ndarray, np.ndarray]] = []
        for each in self.lines:
            T = None if each.order else each.sample_time
            key = each.frequency.tobytes(), T
            if key not in shared:  # encoders on the same lines share them
                shared[key] = _core(model, each.frequency, T, values["dead_time"])
            s, factor, responses, moved = shared[key]
            place = _SENSORS.index(each.sensor)
            factor = factor * s**each.order
            response, slopes = responses[:, place] * factor, np.zeros((s.size, len(names)), complex)
            slopes[:, columns] = moved[:, place] * factor[:, None]
            if "dead_time" in names:
                slopes[:, names.index("dead_time")] = -s * response
            if T is not None:
                shape = (s.size // each.frequency.size, each.frequency.size)
                response = response.reshape(shape).sum(axis=0)
                slopes = slopes.reshape((*shape, -1)).sum(axis=0)
            found.append((response, slopes))
        return found


def _core(
    model: LinearModel, frequency: np.ndarray, T: float | None, dead_time: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """s at all lines and their aliases, dead time and hold there, and the core's response and slopes at both bodies."""
    aliases = np.zeros(1) if T is None else np.arange(-(most := _aliases(frequency, T)), most + 1) / T
    s = 2j * np.pi * (frequency + aliases[:, None]).ravel()
    factor = np.exp(-s * dead_time)
    if T is not None:
        hold = (1.0 - np.exp(-2j * np.pi * frequency * T)) / T
        factor = factor * np.tile(hold, aliases.size) / s
    response, slopes = model.response(s)
    return s, factor, response[:, :, 0], slopes[:, :, 0]


def _aliases(frequency: np.ndarray, T: float) -> int:
    """How many count on either side; of a mass behind a hold they fall as (f/f_alias)³."""
    share = float(np.max(frequency)) * T
    first = range(1, _ALIASES)
    return next((m for m in first if (share / (m + 1.0 - share)) ** 3 < _ALIAS), _ALIASES)


def _trace(plant: Plant, lagging: bool) -> TracedModel:
    """The core on symbols: states q, q' and the drive's force if it lags, one input, the two bodies' positions."""
    graph = Graph()

    def leaf(name: str) -> Number:
        return cast(Number, graph.input(name))

    symbolic = tree.rebuild(plant, (leaf(name) for name, _ in tree.leaves(plant)))
    mechanics = symbolic.mechanics()
    shape = mechanics.shape
    bodies = Rows(shape[mechanics.drive], shape[mechanics.motor], shape[mechanics.load])
    lag = 2.0 * ops.pi * leaf("current_loop") if lagging else None
    made = rate(mechanics, [Port(bodies, lag, 0.0, Timing(0, False))], 1.0, 1.0)
    n = len(made) - 3
    rows = [*(row[: n + 1] for row in made[:n]), mechanics.shape[mechanics.motor], mechanics.shape[mechanics.load]]
    entries = tuple(
        (i, j, graph.symbol(value).index)
        for i, row in enumerate(rows)
        for j, value in enumerate(row)
        if not matrix.is_zero(value)
    )
    leaves = {name: graph.input(name).index for name in [name for name, _ in tree.leaves(plant)]}
    if lagging:
        leaves["current_loop"] = graph.input("current_loop").index
    return TracedModel(graph, n, (n + 2, n + 1), entries, leaves)
