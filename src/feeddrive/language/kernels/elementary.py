"""sin, cos, tan, atan and atan2 for kernels: the arithmetic of `language/mathematics.py`, traced, as LLVM text.

No library is called, so that angles have the same bits on every machine.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language import mathematics, ops
from feeddrive.language.graph import Graph, arguments
from feeddrive.language.machine_code import number

_BINARY = {
    "add": "fadd double",
    "sub": "fsub double",
    "mul": "fmul double",
    "div": "fdiv double",
    "lt": "fcmp olt double",
    "le": "fcmp ole double",
    "eq": "fcmp oeq double",
    "and": "and i1",
    "or": "or i1",
}
_INTRINSIC = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor"}


class Elementary(NamedTuple):
    """A function that a kernel calls by its name; called from Python it computes with the same bits."""

    name: str
    function: Callable[..., Any]
    arity: int

    def __call__(self, *values: float) -> float:
        """The function of floats; NaN where it has no value."""
        with np.errstate(all="ignore"):
            return float(self.function(*map(np.float64, values)))

    @property
    def symbol(self) -> str:
        """The name of its function in LLVM text."""
        return f"@elementary.{self.name}"

    def printed(self) -> tuple[str, list[Elementary]]:
        """The function as LLVM text, and those that it calls."""
        graph = Graph()
        result = graph.symbol(self.function(*(graph.input(f"x{place}") for place in range(self.arity)))).index
        lines, called, held = list[str](), list[Elementary](), list[str]()  # the last: operands by node
        for index, node in enumerate(graph.nodes):
            name, inner = node[0], [held[operand] for operand in arguments(node)]
            held.append(f"%n{index}")
            if name == "input":
                held[-1] = f"%{node[1]}"
                continue
            if name == "const":
                held[-1] = number(float.fromhex(node[1]))
                continue
            if name in _BINARY:
                text = f"{_BINARY[name]} {inner[0]}, {inner[1]}"
            elif name == "neg":
                text = f"fneg double {inner[0]}"
            elif name == "select":
                text = f"select i1 {inner[0]}, double {inner[1]}, double {inner[2]}"
            elif name in _INTRINSIC:
                text = f"call double @llvm.{_INTRINSIC[name]}.f64(double {inner[0]})"
            else:
                called.append(next(candidate for candidate in FUNCTIONS if candidate.name == name))
                text = f"call double {called[-1].symbol}(double {inner[0]})"
            lines.append(f"  %n{index} = {text}")
        parameters = ", ".join(f"double %x{place}" for place in range(self.arity))
        head = f"define internal double {self.symbol}({parameters}) #0 {{"
        return "\n".join([head, *lines, f"  ret double {held[result]}", "}", ""]), called


sin = Elementary("sin", mathematics.sin, 1)
cos = Elementary("cos", mathematics.cos, 1)
atan = Elementary("atan", mathematics.atan, 1)
tan = Elementary("tan", ops.tan, 1)
atan2 = Elementary("atan2", ops.atan2, 2)
FUNCTIONS = (sin, cos, atan, tan, atan2)
