"""The tunables: which parameters of a control are optimized, their ranges, and the start points of the search."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from feeddrive.blocks.axis_model import POWERS
from feeddrive.blocks.families import Observer
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.control import Control

_RANGE = math.log(1e3)  # largest factor between a gain and its start value
_FILTER = math.log(4.0)  # the same for the frequency of a filter
_RATIOS = {"damping_zero": (0.02, 1.0), "damping_pole": (0.05, 1.5), "damping": (0.3, 1.5)}
_RATIO = (0.02, 20.0)  # of a law
HIGHEST_FILTER = 0.45  # of the sample rate: upper limit of filter frequencies that are chosen or searched
HIGHEST = 0.49  # of the sample rate: of any frequency that is moved


def law_tunables(control: Control) -> tuple[str, ...]:
    """Those that a law has to be tuned by. Raises ParameterError for a law that has none."""
    names = own_tunables(control)
    if not names:
        raise ParameterError(
            f"the law '{control.law.kind}' names no tunables: state which parameters are to be tuned (tunables=...)"
        )
    return names


def own_tunables(control: Control) -> tuple[str, ...]:
    """Dotted names of the tunables declared by the law, its observers and its compensations, if present.

    Of a law that names none, its own parameters > 0 without a default; empty if it has none of these either.
    """
    law, there = control.law, dict(tree.leaves(control))
    names = [f"law.{name}" for name in law.to_tune()]
    blocks = [("law", law), *((f"compensation.{i}", block) for i, block in enumerate(control.compensation))]
    for where, block in blocks:
        observer = getattr(block, "observer", None)
        if isinstance(observer, Observer):
            names += [f"{where}.observer.{name}" for name in observer.tunables]
    return tuple(dict.fromkeys(name for name in names if name in there))


def filter_tunables(control: Control) -> tuple[str, ...]:
    """Frequencies and dampings of the filter pack that are above zero."""
    leaves = ((name, value) for name, value in tree.leaves(control) if name.startswith("filters."))
    return tuple(name for name, value in leaves if isinstance(value, float) and value > 0.0)


def logarithms(control: Control, names: Sequence[str]) -> np.ndarray:
    """Logarithms of the tunables. Raises ParameterError for one that is not a number above zero."""
    values: list[float] = []
    for name in names:
        value = tree.get(control, name)
        if not isinstance(value, (int, float)) or not value > 0.0:
            raise ParameterError(f"{name} = {value!r} is not a tunable: its start value must be a number > 0")
        values.append(math.log(value))
    return np.array(values)


def box(control: Control, names: Sequence[str], x: np.ndarray, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limit of each tunable."""
    low, high = x - _RANGE, x + _RANGE
    for i, name in enumerate(names):
        unit, last = tree.declaration(control, name).unit, name.rpartition(".")[2]
        if unit == "":
            a, b = _RATIOS.get(last, _RATIO) if name.startswith("filters.") else _RATIO
            low[i], high[i] = min(math.log(a), x[i]), max(math.log(b), x[i])
        elif name.startswith("filters."):
            low[i], high[i] = x[i] - _FILTER, x[i] + _FILTER
        if unit == "Hz":
            high[i] = min(high[i], math.log(HIGHEST_FILTER / sample_time))
    return low, np.maximum(high, low)


def speeds(control: Control, names: Sequence[str]) -> np.ndarray:
    """The exponent of each tunable of the law when the whole loop is made faster by a common factor."""
    return np.array(
        [
            0.0 if name.startswith("filters.") else float(POWERS.get(tree.declaration(control, name).unit, (0, 0))[1])
            for name in names
        ]
    )


def readable(control: Control, name: str) -> str:
    """The name of a tunable with the kind of its block: filters.0 (notch) frequency."""
    parts = name.split(".")
    if parts[0] == "filters" and len(parts) == 3:
        return f"filters.{parts[1]} ({control.filters[int(parts[1])].kind}) {parts[2]}"
    return name


_RUNGS = math.log(2.0) * np.arange(2.0, -8.0, -1.0)  # factors of speed 4 ... 1/128
_SHAPES = 8  # for each tunable but one
_WIDE, _RATIO_WIDE = math.log(30.0), math.log(6.0)  # of a gain, of a ratio, up and down


def scattered(
    x: np.ndarray, low: np.ndarray, high: np.ndarray, powers: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Points all over the box, of shape (points, tunables): shapes of the law by Latin hypercube, each fast and slow.

    Whether bounds are kept is decided by the speed of the whole loop first, so each shape is taken at ten speeds.
    Source: McKay, Beckman & Conover 1979 (Latin hypercube).
    """
    count = _SHAPES * max(x.size - 1, 2)
    wide = np.where(powers == 0.0, _RATIO_WIDE, _WIDE)
    below, above = np.maximum(low, x - wide), np.minimum(high, x + wide)
    strata = np.array([random.permutation(count) for _ in x]).T
    shapes = below + (above - below) * (strata + random.random((count, x.size))) / count
    return np.clip((shapes[:, None] + _RUNGS[:, None] * powers).reshape(-1, x.size), low, high)
