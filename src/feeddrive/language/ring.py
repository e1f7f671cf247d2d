"""Ring buffers in the state of a block, and the signal histories built on them.

Delays, regeneration and repetitive laws store past samples in rings.  The length is fixed and is part of the graph.
Indices are integers modulo the length: index and index + length refer to the same cell.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language.errors import StructureError
from feeddrive.language.graph import Symbol
from feeddrive.language.primitives import clip, equal, floor, minimum, where, zero


class Ring:
    """A ring buffer of cells accessed by index. A ring is immutable: `put` returns a new ring.

    cells  None for a new ring, whose cells are 0; numbers of shape (length,) or (length, variants); the symbol of a
           trace; or a symbol for each cell, for a target without indexed memory: every access then reads every cell.
    Native code writes in place, so each version of a ring may be written only once: r1 = r.put(...), then r2 =
    r1.put(...), but never a second r.put(...). A reset does not clear cells: a selection between an
    existing ring and a new one keeps the existing ring. A separate number in the state must count the cells that are
    valid after a reset (see `History`). Therefore, a controller with a guard rejects a ring that is not part of a
    `History` or a `Track`.
    """

    __slots__ = ("cells", "length")

    def __init__(self, length: int, cells: Any = None) -> None:
        if length < 1:
            raise StructureError(f"a ring has a length of at least 1, not {length}")
        self.length, self.cells = length, cells

    def __repr__(self) -> str:
        return f"Ring({self.length})"

    def put(self, index: Any, value: Any) -> Ring:
        """Return the ring with a new value in one cell."""
        place = self._place(index)
        if isinstance(self.cells, tuple):
            first, *others = self.cells
            cells = (where(equal(place, float(i)), value, cell) for i, cell in enumerate(others, 1))
            # not equal(place, 0): a NaN as index reaches cell 0, as in memory
            return Ring(self.length, (where(place > 0.5, first, value), *cells))
        symbol = next((operand for operand in (self.cells, place, value) if isinstance(operand, Symbol)), None)
        if symbol is not None:
            graph = symbol.graph
            cells = graph.ring(f"ring.{len(graph.nodes)}", self.length) if self.cells is None else self.cells
            return Ring(self.length, graph.apply("put", cells, place, value))
        return Ring(self.length, written(self._numbers(), place, value))

    def get(self, index: Any) -> Any:
        """Return the number in a cell. Its derivative with respect to the index is 0: see `interpolate`."""
        place = self._place(index)
        if isinstance(self.cells, tuple):
            chosen, *others = self.cells
            for i, cell in enumerate(others, 1):
                chosen = where(equal(place, float(i)), cell, chosen)
            return chosen
        symbol = next((operand for operand in (self.cells, place) if isinstance(operand, Symbol)), None)
        if symbol is not None and self.cells is None:
            return symbol.graph.constant(0.0)
        if symbol is not None:
            return symbol.graph.apply("get", self.cells, place)
        return read(self._numbers(), place)

    def interpolate(self, place: Any) -> Any:
        """Interpolate linearly between cells at a real-valued index; the first cell follows the last."""
        below = floor(place)
        left = self.get(below)
        return left + (place - below) * (self.get(below + 1.0) - left)

    def _numbers(self) -> np.ndarray:
        return np.zeros(self.length) if self.cells is None else self.cells

    def _place(self, index: Any) -> Any:
        """Return the index modulo the length, in 0 .. length - 1."""
        # by floor, so that the negative indices of a history wrap, too
        return index - float(self.length) * floor(index / float(self.length))


def read(cells: np.ndarray, place: Any) -> Any:
    """Return the number in a cell, or in one cell per variant. A NaN index reads cell 0."""
    at = _inside(cells, place)
    if at.ndim and cells.ndim == 2:
        return cells[at, np.arange(cells.shape[1])]
    number: Any = cells[at]
    return number if isinstance(number, np.ndarray) else np.float64(number)


def written(cells: np.ndarray, place: Any, value: Any) -> np.ndarray:
    """Return a copy of the cells with a new value in one cell, or in one cell per variant."""
    at, value = _inside(cells, place), np.asarray(value, dtype=np.float64)
    lanes = max(at.size if at.ndim else 0, value.size if value.ndim else 0)
    if lanes and cells.ndim == 1:
        cells = np.repeat(cells[:, None], lanes, axis=1)
    after = cells.copy()
    after[(at, np.arange(cells.shape[1])) if at.ndim else at] = value
    return after


def _inside(cells: np.ndarray, place: Any) -> np.ndarray:
    held = np.clip(place, 0.0, float(len(cells) - 1))
    return np.asarray(np.where(held == held, held, 0.0), dtype=np.int64)


def spread(state: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield names and values of a state, as `tree.leaves` does, with the cells of rings as separate entries."""
    if isinstance(state, Ring):
        cells = [0.0] * state.length if state.cells is None else state.cells
        yield from ((f"{prefix}.{i}", cell) for i, cell in enumerate(cells))
    elif isinstance(state, tuple):
        names = getattr(state, "_fields", None) or map(str, range(len(state)))
        for name, part in zip(names, state, strict=True):
            yield from spread(part, f"{prefix}.{name}" if prefix else name)
    elif state is not None:
        yield prefix, state


def gathered(state: Any, values: Iterator[Any]) -> Any:
    """Copy a state with new values in the order of `spread`; each ring then has a separate value for each cell."""
    if isinstance(state, Ring):
        return Ring(state.length, tuple(next(values) for _ in range(state.length)))
    if isinstance(state, tuple):
        parts = [gathered(part, values) for part in state]
        return type(state)(*parts) if hasattr(state, "_fields") else tuple(parts)
    return None if state is None else next(values)


class History(NamedTuple):
    """The most recent values of a signal, in the order of writing; earlier values are taken as `initial`."""

    ring: Ring
    head: Any  # index of the next cell to be written
    filled: Any  # number of cells written since the start
    initial: Any

    @classmethod
    def start(cls, length: int, initial: Any) -> History:
        """Return the history of a signal that has always been `initial`; `length` values are stored."""
        nothing = zero(initial)
        return cls(Ring(length), nothing, nothing, initial)

    def settled(self) -> History:
        """Return the history of a signal that was constant for a long time: every cell holds the initial value."""
        return History(
            Ring(self.ring.length, np.full(self.ring.length, float(self.initial))),
            self.head,
            zero(self.initial) + float(self.ring.length),
            self.initial,
        )

    def push(self, value: Any) -> History:
        """Return the history with a value appended as the newest."""
        last = float(self.ring.length - 1)
        # wrapped and limited here: in single precision a counter stops at 2²⁴, after 70 min at 4 kHz
        head = where(self.head >= last, 0.0, self.head + 1.0)
        filled = minimum(self.filled + 1.0, last + 1.0)
        return History(self.ring.put(self.head, value), head, filled, self.initial)

    def ago(self, count: Any) -> Any:
        """Return the value `count` steps before the newest, interpolated linearly; `count` is clamped."""
        most = float(self.ring.length - 1)
        age = clip(count, 0.0, most)
        newer = floor(age)
        older = minimum(newer + 1.0, most)
        after = self._aged(newer)
        return after + (age - newer) * (self._aged(older) - after)

    def _aged(self, age: Any) -> Any:
        return where(age < self.filled, self.ring.get(self.head - 1.0 - age), self.initial)


class Track(NamedTuple):
    """The most recent values of several signals and their rates; earlier values are taken as `initial`, rates as 0.

    Values are read by cubic Hermite interpolation, whose relative error for a sine is (ωh)⁴/384; that of linear
    interpolation is (ωh)²/8.
    """

    values: tuple[Ring, ...]
    rates: tuple[Ring, ...]
    head: Any  # index of the next cell to be written
    filled: Any  # number of cells written since the start
    initial: tuple[Any, ...]

    @classmethod
    def start(cls, length: int, initial: Sequence[Any]) -> Track:
        """Return the track of signals that have always been `initial`; `length` values of each are stored."""
        nothing, empty = zero(initial[0]), tuple(Ring(length) for _ in initial)
        return cls(empty, tuple(Ring(length) for _ in initial), nothing, nothing, tuple(initial))

    def settled(self) -> Track:
        """Return the track of signals that were constant for a long time: every cell holds the initial value."""
        length = self.values[0].length
        held = tuple(Ring(length, np.full(length, float(x))) for x in self.initial)
        still = tuple(Ring(length, np.zeros(length)) for _ in self.initial)
        return Track(held, still, self.head, zero(self.initial[0]) + float(length), self.initial)

    def push(self, values: Sequence[Any], rates: Sequence[Any]) -> Track:
        """Return the track with values and rates appended as the newest."""
        last = float(self.values[0].length - 1)
        head = where(self.head >= last, 0.0, self.head + 1.0)
        return Track(
            tuple(ring.put(self.head, x) for ring, x in zip(self.values, values, strict=True)),
            tuple(ring.put(self.head, x) for ring, x in zip(self.rates, rates, strict=True)),
            head,
            minimum(self.filled + 1.0, last + 1.0),
            self.initial,
        )

    def ago(self, count: Any, h: Any, ahead: float = 0.0) -> tuple[Any, ...]:
        """Return the values `count` steps (a real number) before the newest, extrapolated by `ahead` steps.

            x(s) + ahead x'(s)

        x(s) is the cubic Hermite polynomial between the two adjacent stored values, with s in 0 .. 1 from the older
        to the newer one, and h is the time between values.
        """
        most = float(self.values[0].length - 1)
        age = clip(count, 0.0, most)
        newer = floor(age)
        older = minimum(newer + 1.0, most)
        s = 1.0 - (age - newer)
        rest = 1.0 - s
        gained = s * s * (3.0 - 2.0 * s) + ahead * (6.0 * s * rest)
        from_old = h * (s * rest * rest + ahead * (rest * (1.0 - 3.0 * s)))
        from_new = h * (ahead * (s * (3.0 * s - 2.0)) - s * s * rest)
        stored = newer < self.filled, older < self.filled
        places = self.head - 1.0 - newer, self.head - 1.0 - older
        results: list[Any] = []
        for value, rate, initial in zip(self.values, self.rates, self.initial, strict=True):
            new, old = (where(is_, value.get(at), initial) for is_, at in zip(stored, places, strict=True))
            fast, slow = (where(is_, rate.get(at), 0.0) for is_, at in zip(stored, places, strict=True))
            results.append(old + gained * (new - old) + (from_new * fast + from_old * slow))
        return tuple(results)

    def moved(self, now: Sequence[Any], count: Any, h: Any) -> tuple[Any, ...]:
        """Return by how much the signals changed over `count` steps until the middle of the present substep.

        now  their values there, predicted from the newest sample like the earlier ones
        """
        before = self.ago(count, h, 0.5)
        return tuple(x - y for x, y in zip(now, before, strict=False))

    def rates_ago(self, count: Any) -> tuple[Any, ...]:
        """Return the rates at the last sample before the point `count` steps before the newest; 0 if not stored."""
        older = minimum(
            floor(clip(count, 0.0, float(self.values[0].length - 1))) + 1.0, float(self.values[0].length - 1)
        )
        return tuple(where(older < self.filled, rate.get(self.head - 1.0 - older), 0.0) for rate in self.rates)


def settled(state: Any) -> Any:
    """Return a copy of a state in which every history and track is settled."""
    if isinstance(state, History | Track):
        return state.settled()
    if isinstance(state, tuple):
        parts = [settled(part) for part in state]
        return type(state)(*parts) if hasattr(state, "_fields") else tuple(parts)
    return state
