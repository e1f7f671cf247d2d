"""Parameter changes during a run: the control that is active from each sample on."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np

from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.loop.engine.native import Native
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine, System
from feeddrive.loop.runner import Prepared, recorded
from feeddrive.loop.work import Work

# by sample (int) or time in s (float): a whole control, or values of some of its parameters by path
Changes: TypeAlias = Mapping[int | float, Control | Mapping[str, float]]

_CONTROL = re.compile(r"(axis\.\w+\.)?control\.")


def changed_loops(loop: System, changes: Changes | None, count: int) -> list[tuple[int, System]]:
    """Return (sample, loop from it on) of every change in a run of `count` samples, in order of time.

    A change acts between two samples: sample k is the first one that runs with the new values.  A time is taken up to
    the first sample at or after it.  Values by name change the control that is active then.

    Raises ParameterError for a sample or time outside the run or named twice, a name outside the control, a value out
    of its bounds, and StructureError for a change of the structure.
    """
    placed: dict[int, Control | Mapping[str, float]] = {}
    for key, change in (changes or {}).items():
        sample = _sample(key, float(loop.sample_time), count)
        if sample in placed:
            raise ParameterError(f"changes: there are two at sample {sample}, the second at {_shown(key)}; join them")
        placed[sample] = change
    loops = []
    for sample in sorted(placed):
        try:
            loop = _changed(loop, placed[sample])
        except (ParameterError, StructureError) as error:
            raise type(error)(f"changes at sample {sample}: {error}") from None
        loops.append((sample, loop))
    return loops


def _sample(key: int | float, T: float, count: int) -> int:
    if isinstance(key, (int, np.integer)) and not isinstance(key, bool):
        sample = int(key)
    elif isinstance(key, (float, np.floating)) and math.isfinite(key):
        sample = math.ceil(float(key) / T * (1.0 - 1e-12) - 1e-9)
    else:
        raise ParameterError(f"changes: {key!r} must be a sample (whole number) or a time in s (float)")
    if not 0 <= sample < count:
        raise ParameterError(
            f"changes: {_shown(key)} is outside of the run, which has {count} samples, 0 ... {count - 1} (0 ... "
            f"{Quantity((count - 1) * T, 's'):6 SI})"
        )
    return sample


def _shown(key: int | float) -> str:
    return Text(f"{Quantity(key, 's'):6 SI}") if isinstance(key, (float, np.floating)) else f"sample {key}"


def _changed(loop: System, change: Any) -> System:
    """Return the loop with another control, or with other values in it."""
    if isinstance(change, Control):
        if not isinstance(loop, Loop):
            raise ParameterError("a machine changes by names such as axis.x.control.law.Kv, not by a whole Control")
        changed = dataclasses.replace(loop, control=change)
    elif isinstance(change, Mapping):
        for name, value in change.items():
            if not isinstance(name, str) or not _on_controller(loop, tree.name_of(loop, name)):
                raise ParameterError(
                    f"'{name}' is no parameter of the control, such as axis.x.control.law.Kv: the axis "
                    "does not change live"
                )
            if isinstance(value, (list, tuple, np.ndarray)):
                raise ParameterError(f"{name} must be one number: a batch of variants cannot be changed live")
        changed = tree.vary(loop, change)
    else:
        raise ParameterError(
            f"{change!r} must be a Control, or values by path, as in {{'axis.x.control.law.Kv': 80.0}}"
        )
    for name, before in loop.loops().items():
        control = changed.loops()[name].control
        if any(isinstance(value, np.ndarray) for _, value in tree.leaves(control)):
            raise ParameterError("the control holds arrays of variants: a batch of variants cannot be changed live")
        control.check_live(before.control, before.place_of("control"))
    return changed


def _on_controller(loop: System, name: str) -> bool:
    """True if a parameter belongs to a control, or to a coupling between the controls of a machine."""
    first, _, rest = name.partition(".")
    if first == "couplings" and isinstance(loop, Machine):
        return loop.couplings[int(rest.partition(".")[0])].controls
    return bool(_CONTROL.match(name))


class Course:
    """A run in pieces that changes its control at given samples."""

    def __init__(self, prepared: Prepared, later: list[tuple[int, Prepared]]) -> None:
        """Begin a run. `later` holds the sample from which on each of the changed loops runs, in order."""
        self._now, self._later = prepared, list(later)

    def advance(self, code: Native, work: Work, states: np.ndarray, first: int, count: int) -> np.ndarray:
        """Compute samples first .. first + count - 1 from `states`, which are updated; return the recorded signals
        (count, signals).
        """
        work.sample(first, count)
        pieces, at, end = [], first, first + count
        while at < end:
            while self._later and self._later[0][0] == at:
                old, self._now = self._now, self._later.pop(0)[1]
                self._now.retune(old, code, states)
            until = min(end, self._later[0][0]) if self._later else end
            pieces.append(recorded(self._now, code, work, states, at, until - at))
            at = until
        return pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
