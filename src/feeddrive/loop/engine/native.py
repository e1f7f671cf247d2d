"""A plan as machine code: the compiled time loop, called with the addresses of arrays."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np

from feeddrive.language.machine_code import machine_code, target
from feeddrive.loop.engine import time_loop
from feeddrive.loop.engine.plan import Plan

_SIGNATURE = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 2, *[ctypes.c_void_p] * 5, *[ctypes.c_int64] * 2)
_NUMBER = 8  # bytes
_ENTRY = "feeddrive_run"


class Native:
    """A compiled plan, which owns its machine code."""

    def __init__(self, plan: Plan, source: str, *, quick: bool = False) -> None:
        """Compile a plan; `quick` as in `native`."""
        self.plan = plan
        self._code = machine_code(source, [_ENTRY], effort=0 if quick else 2)
        self.key = self._code.key
        self._call = _SIGNATURE(self._code.addresses[_ENTRY])

    def run(
        self,
        count: int,
        first: int,
        constants: np.ndarray,
        inputs: np.ndarray,
        states: np.ndarray,
        outputs: np.ndarray | None,
        tables: Sequence[np.ndarray],
    ) -> None:
        """Compute `count` samples from sample `first` on; `states` is updated, `outputs` is filled.

        constants (n, lanes), inputs (count, n), states (n, lanes), outputs (count, n, lanes): float64, C order, but the
        inputs may have any strides.
        """
        rows = (ctypes.c_void_p * max(1, len(tables)))(*[row.ctypes.data for row in tables])
        written = 0 if outputs is None else outputs.ctypes.data
        memory = constants.ctypes.data, inputs.ctypes.data, states.ctypes.data, written, ctypes.addressof(rows)
        self.run_at(count, first, memory, inputs.strides)

    def run_at(self, count: int, first: int, memory: Sequence[int], strides: Sequence[int]) -> None:
        """Run with the addresses of constants, inputs, states, outputs and tables; strides of inputs in bytes."""
        self._call(count, first, *memory, *[stride // _NUMBER for stride in strides])


def native(plan: Plan, *, flush: bool = True, quick: bool = False) -> Native:
    """Return the machine code of a plan.

    flush  whether numbers below the normal ones count as zero; plain Python has them
    quick  compile in a third of the time, to slower code: for what runs once
    """
    return Native(plan, time_loop.text(plan, _ENTRY, target()[0], flush=flush), quick=quick)
