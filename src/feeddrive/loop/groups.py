"""Batches: many variants of one loop, in groups of SIMD lanes on all threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from typing import Any

import numpy as np

from feeddrive.language.recent import Recent
from feeddrive.loop.engine.native import Native
from feeddrive.loop.runner import Prepared

WIDTHS = (8, 16, 32)
# Samples of all variants together from which on wider vectors, and a trial of them, pay for being compiled.
WIDE, TRIED = 5_000_000, 100_000_000
_TRIAL = 400  # samples
_fastest: Recent[int] = Recent(64)  # by the source of the narrowest machine code


class Groups:
    """The variants of a prepared loop, dealt out to groups of lanes; a last group repeats its last variant."""

    def __init__(self, prepared: Prepared, code: Native, variants: int) -> None:
        self.code, self.variants, self.lanes = code, variants, code.plan.lanes
        self.constants = _dealt([name for name, _ in code.plan.constants], prepared.numbers, self.lanes, variants)
        first = prepared.first_states(code)
        self.states = _dealt(list(first), first, self.lanes, variants)
        self.rows = prepared.rows(code)

    def advance(self, pool: Executor, first: int, inputs: np.ndarray) -> Iterator[int]:
        """Advance all groups over the same stretch of samples; yield the number of finished variants of each group."""

        def one(group: int) -> int:
            self._run(group, first, inputs, self.states[group])
            return min(self.lanes, self.variants - group * self.lanes)

        yield from pool.map(one, range(len(self.states)))

    def _run(self, group: int, first: int, inputs: np.ndarray, states: np.ndarray) -> None:
        self.code.run(len(inputs), first, self.constants[group], inputs, states, None, self.rows)

    def ends(self) -> dict[str, np.ndarray]:
        """Return the states by name, each of shape (variants,)."""
        flat = np.moveaxis(self.states, 0, 1).reshape(self.states.shape[1], -1)[:, : self.variants]
        return {state.name: row for state, row in zip(self.code.plan.states, flat, strict=False)}

    def trial(self, inputs: np.ndarray) -> float:
        """Return the seconds for one variant over a short stretch, the least of three; the states are not changed."""
        spans: list[float] = []
        for _ in range(3):
            states = self.states[0].copy()
            begun = time.perf_counter()
            self._run(0, 0, inputs[:_TRIAL], states)
            spans.append(time.perf_counter() - begun)
        return min(spans) / self.lanes


def grouped(
    prepared: Prepared,
    native: Callable[[int], Native],
    lanes: int | None,
    samples: int,
    inputs: Callable[[Native], np.ndarray],
) -> Groups:
    """Return the variants in groups of `lanes`; None takes the fastest width on this computer, which changes no bit.

    `native(lanes)` makes the machine code and `inputs(native)` the first samples; a trial is run only for work that is
    long enough to earn it, once for each structure.
    """
    variants = prepared.lanes()
    if lanes is not None or variants == 1:
        return Groups(prepared, native(lanes or 1), variants)
    work = variants * samples
    fitting = [width for width in WIDTHS if width < 2 * variants] or [WIDTHS[0]]
    if work < WIDE:
        return Groups(prepared, native(fitting[0]), variants)
    if work < TRIED or len(fitting) < 3:
        return Groups(prepared, native(fitting[min(1, len(fitting) - 1)]), variants)
    programs = [native(width) for width in fitting]

    def tried() -> int:
        stretch = inputs(programs[0])
        return min(range(len(programs)), key=lambda i: Groups(prepared, programs[i], fitting[i]).trial(stretch))

    return Groups(prepared, programs[_fastest.get(programs[0].key, tried)], variants)


def _dealt(names: Sequence[str], values: Mapping[str, Any], lanes: int, variants: int) -> np.ndarray:
    """Return numbers by name for all groups, shape (groups, names, lanes)."""
    groups = -(-variants // lanes)
    out = np.empty((groups, len(names), lanes))
    for i, name in enumerate(names):
        value = values[name]
        if isinstance(value, np.ndarray):
            padded = np.append(value[: groups * lanes], np.repeat(value[-1], max(0, groups * lanes - value.size)))
            value = padded.reshape(groups, lanes)
        out[:, i] = value
    return out
