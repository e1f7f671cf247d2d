"""The oracle of programs in single precision: a graph evaluated in float, one operation after the other.

Each operation is rounded by itself, numbers below the normal ones count as 0 with their sign, and the elementary
functions are those of `single.py`: what a float build computes on any processor, bit for bit but for the payload of
NaN.  One thing a processor chooses: an exact result just below 2⁻¹²⁶ that rounds up to it is 0 on ARM, and here, and
2⁻¹²⁶ on x86.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from feeddrive.language.graph import ELEMENTARY, Graph, Symbol, arguments, reachable, rebuilt
from feeddrive.language.single import FUNCTIONS, LEAST_NORMAL


def single_lowered(graph: Graph, roots: Sequence[int]) -> tuple[Graph, dict[int, int]]:
    """The graph below the roots with the functions of `single.py` for `exp`, `sin` ..., and where nodes went."""

    def compose(made: Graph, name: str, values: list[Symbol]) -> Symbol:
        return FUNCTIONS[name](*values) if name in ELEMENTARY else made.apply(name, *values)

    return rebuilt(graph, roots, compose)


def single_values(graph: Graph, outputs: Sequence[int], leaves: Mapping[str, Any]) -> list[np.ndarray]:
    """The values of some nodes in single precision, for inputs and tables by name as numbers or arrays of one length.

    Constants and leaves are rounded to float first.  Raises KeyError for a leaf that is not given.
    """
    lowered, place = single_lowered(graph, outputs)
    found: dict[int, Any] = {}
    with np.errstate(all="ignore"):
        for index in reachable(lowered, [place[i] for i in outputs]):
            node = lowered.nodes[index]
            match node[0]:
                case "const":
                    found[index] = _flushed(np.float32(float.fromhex(node[1])))
                case "truth":
                    found[index] = np.bool_(node[1])
                case "input" | "table":
                    found[index] = _flushed(np.asarray(leaves[node[1]], dtype=np.float64).astype(np.float32))
                case name:
                    value = _OPERATIONS[name](*(found[i] for i in arguments(node)))
                    found[index] = _flushed(value) if np.asarray(value).dtype == np.float32 else value
    return [np.asarray(found[place[i]]) for i in outputs]


def _flushed(x: Any) -> Any:
    """x, with the sign of 0 in place of numbers below the normal ones."""
    return np.where(np.abs(x) < np.float32(LEAST_NORMAL), np.copysign(np.float32(0.0), x), x)


def _power_of_two(k: Any) -> Any:
    inside = (k >= -126.0) & (k <= 127.0)
    power = np.ldexp(np.float32(1.0), np.where(inside, k, 0.0).astype(np.int32))
    return np.where(inside, power, np.float32(np.nan)).astype(np.float32)


def _exponent(x: Any) -> Any:
    bits = np.asarray(x, dtype=np.float32).view(np.int32)
    return (((bits >> 23) & 0xFF) - 127).astype(np.float32)


def _gather(row: Any, index: Any) -> Any:
    place = np.where(index == index, np.clip(index, 0.0, len(row) - 1.0), 0.0)
    return row[place.astype(np.int64)]


def _quantise(x: Any, step: Any) -> Any:
    return step * np.floor(_flushed(_flushed(x / step) + np.float32(0.5)))


_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative,
    "abs": np.abs, "sqrt": np.sqrt, "floor": np.floor, "lt": np.less, "le": np.less_equal, "eq": np.equal,
    "and": np.logical_and, "or": np.logical_or, "not": np.logical_not, "select": np.where,
    "power_of_two": _power_of_two, "exponent": _exponent, "gather": _gather, "quantise": _quantise,
}  # fmt: skip
