"""An exported FMU run in FMPy: its outputs for given inputs, to compare with the simulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.cosimulation.fmu import Archive, Instance, opened
from feeddrive.export.trial import Trial
from feeddrive.loop.routine import Routine

_ACCESS = {
    "Real": "Real", "Float64": "Float64", "Boolean": "Boolean", "Enumeration": "Integer", "Enumeration 3": "Int64"
}  # fmt: skip


def answers(path: Path, routine: Routine, tried: Trial) -> np.ndarray:
    """The outputs of a controller's FMU, shape (n, outputs), sample by sample, parameters changed between steps.

    Raises FmuError for an FMU that cannot be opened or fails, and MissingExtraError without FMPy.
    """
    parameters = {v.path: v.name for v in routine.parameters}
    T = routine.sample_time
    found = np.empty((len(tried.inputs), len(routine.outputs)))
    with opened(path) as archive, Instance(archive) as held:
        give = _access(archive, held.fmu, "set", [v.name for v in routine.inputs])
        take = _access(archive, held.fmu, "get", [v.name for v in routine.outputs])
        held.begin([], {})
        for k, row in enumerate(tried.inputs):
            for name, value in tried.changes.get(k, {}).items():
                _access(archive, held.fmu, "set", [parameters[name]])([value])
            give(row.tolist())
            held.step(k * T, T)
            found[k] = take(None)
    return found


def _access(archive: Archive, fmu: Any, verb: str, names: Sequence[str]) -> Callable[[Sequence[float] | None], Any]:
    """Sets or gets variables by name, each by the function of its type, those of one type in one call."""
    known = {each.name: each for each in archive.description.modelVariables}
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        kind = known[name].type
        three = kind == "Enumeration" and archive.three
        groups.setdefault(_ACCESS["Enumeration 3" if three else kind], []).append(i)
    calls = [
        (kind == "Boolean", places, [known[names[i]].valueReference for i in places], getattr(fmu, verb + kind))
        for kind, places in groups.items()
    ]

    def access(values: Sequence[float] | None) -> list[float]:
        row = [0.0] * len(names)
        for truth, places, references, call in calls:
            if values is not None:
                call(references, [values[i] > 0.5 if truth else values[i] for i in places])
            else:
                for i, value in zip(places, call(references), strict=True):
                    row[i] = float(value)
        return row

    return access
