"""Which numbers of a control are turned, how far, and where a search may begin."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.control import Control

_RANGE = math.log(1e3)  # how far a gain may move from where the search begins
_FILTER = math.log(4.0)  # and the frequency of a filter
_RATIOS = {"damping_zero": (0.02, 1.0), "damping_pole": (0.05, 1.5), "damping": (0.3, 1.5)}
_OF_OBSERVERS = ("frequency", "omega_o", "zeta_o")
_RATIO = (0.02, 5.0)  # of a law
_HIGHEST = 0.45  # of the sample rate: no filter is put beyond
# how a gain scales when all frequencies of a loop rise by a factor: to its power, by the unit
_POWERS = {"1/s": 1, "rad/s": 1, "Hz": 1, "N s/m": 1, "N/m": 2, "1/s2": 2, "N/(m s)": 3, "s": -1}


def law_knobs(control: Control) -> tuple[str, ...]:
    """Dotted names of the knobs that the law names, as far as they are there, and those of observers beside it.

    Raises ParameterError for a law that names none.
    """
    names = [f"law.{name}" for name in control.law.knobs]
    there = dict(tree.leaves(control))
    names += [name for name in there if ".observer." in name and name.rpartition(".")[2] in _OF_OBSERVERS]
    found = tuple(dict.fromkeys(name for name in names if name in there))
    if not found:
        raise ParameterError(
            f"the law '{control.law.kind}' names no knobs: say which parameters are to be tuned (knobs=...)"
        )
    return found


def filter_knobs(control: Control) -> tuple[str, ...]:
    """Frequencies and dampings of the filter pack that are above zero."""
    leaves = ((name, value) for name, value in tree.leaves(control) if name.startswith("filters."))
    return tuple(name for name, value in leaves if isinstance(value, float) and value > 0.0)


def logarithms(control: Control, names: Sequence[str]) -> np.ndarray:
    """Where the knobs stand. Raises ParameterError for one that is not a number above zero."""
    found: list[float] = []
    for name in names:
        value = tree.get(control, name)
        if not isinstance(value, (int, float)) or not value > 0.0:
            raise ParameterError(f"{name} = {value!r} is no knob: it must be a number > 0 where the search begins")
        found.append(math.log(value))
    return np.array(found)


def box(control: Control, names: Sequence[str], x: np.ndarray, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
    """How low and how high each knob may go."""
    low, high = x - _RANGE, x + _RANGE
    for i, name in enumerate(names):
        unit, last = tree.declaration(control, name).unit, name.rpartition(".")[2]
        if unit == "":
            a, b = _RATIOS.get(last, _RATIO) if name.startswith("filters.") else _RATIO
            low[i], high[i] = min(math.log(a), x[i]), max(math.log(b), x[i])
        elif name.startswith("filters."):
            low[i], high[i] = x[i] - _FILTER, x[i] + _FILTER
        if unit == "Hz":
            high[i] = min(high[i], math.log(_HIGHEST / sample_time))
    return low, np.maximum(high, low)


def speeds(control: Control, names: Sequence[str]) -> np.ndarray:
    """To which power of a common factor each knob of the law changes when the whole loop becomes faster by it."""
    return np.array(
        [
            0.0 if name.startswith("filters.") else float(_POWERS.get(tree.declaration(control, name).unit, 0))
            for name in names
        ]
    )


def readable(control: Control, name: str) -> str:
    """The name of a knob with the kind of its block: filters.0 (notch) frequency."""
    parts = name.split(".")
    if parts[0] == "filters" and len(parts) == 3:
        return f"filters.{parts[1]} ({control.filters[int(parts[1])].kind}) {parts[2]}"
    return name
