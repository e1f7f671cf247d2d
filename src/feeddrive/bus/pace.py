"""The cycle clock of the bus: waits for the next cycle and records how late each cycle was."""

from __future__ import annotations

import contextlib
import gc
import os
import time
from collections.abc import Generator
from typing import NamedTuple

import numpy as np

_PRIORITY = 60  # SCHED_FIFO, below the interrupts of a real-time kernel


class Lateness(NamedTuple):
    """The lateness of cycles, in s: median, 99 %, maximum; the number late by more than a cycle; and the slip of the
    clock.

    It describes the computer, not the drive.
    """

    median: float
    often: float
    most: float
    missed: int
    slipped: float


class Pace:
    """Begins cycle k at start + k · cycle_time on the monotonic clock; without one, as fast as the drive answers.

    A cycle late by more than a cycle is not made up by sending faster, as the drive would get jumps: the schedule
    slips, the motion pauses for that long, and the log counts such cycles.  How late a cycle may be
    in motion is `late_cycles` of the drive file; `DriveClient.cycle` keeps it.
    """

    def __init__(self, cycle_time: float | None) -> None:
        self.cycle_time = cycle_time
        self.slips = False  # whether the last cycle began more than a cycle late
        self._next = 0.0
        self._late: list[float] = []
        self._missed, self._slipped = 0, 0.0

    def begin(self) -> None:
        """Start the schedule."""
        self._late, self._missed, self._slipped = [], 0, 0.0

    def wait(self) -> float:
        """Wait until the next cycle is due; return its lateness in s."""
        if self.cycle_time is None:
            return 0.0
        now = time.monotonic()
        if self._next == 0.0:
            self._next = now
        if now < self._next:
            time.sleep(self._next - now)
            now = time.monotonic()
        late = max(0.0, now - self._next)
        self._late.append(late)
        self.slips = late > self.cycle_time
        if self.slips:
            self._missed += 1
            self._slipped += late
            self._next = now
        self._next += self.cycle_time
        return late

    def lateness(self) -> Lateness | None:
        """Return the lateness since `begin`; None without a clock."""
        if not self._late:
            return None
        median, often, most = np.quantile(self._late, [0.5, 0.99, 1.0]).tolist()
        return Lateness(median, often, most, self._missed, self._slipped)


@contextlib.contextmanager
def urgent(wanted: bool) -> Generator[bool]:
    """Run a block with real-time scheduling, if permitted, and without garbage collection.

    Its value: whether it was permitted.
    """
    before = None
    if wanted and hasattr(os, "sched_setscheduler"):
        with contextlib.suppress(OSError):
            before = os.sched_getscheduler(0), os.sched_getparam(0)
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    collected = gc.isenabled()
    gc.disable()
    try:
        yield before is not None
    finally:
        if collected:
            gc.enable()
        if before is not None:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, *before)
