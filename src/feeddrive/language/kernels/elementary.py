"""Elementary functions of kernels: `//` and `%` of floats, and sin, cos, tan, atan and atan2.

`//` and `%` follow Python's definition, using only exact operations. They are written in the kernel language; the
interpreter uses Python's own operators. The trigonometric functions are the arithmetic of `language/mathematics.py`,
traced to LLVM text. No library is called, so the results are bit-identical on every machine.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from feeddrive.language import mathematics, ops
from feeddrive.language.graph import Graph, arguments
from feeddrive.language.kernels.source import readable
from feeddrive.language.machine_code import number

_INFINITY = float("inf")
# 2⁵²: every float from here on is an integer
_WHOLE = 4503599627370496.0


@readable
def left_over(x: float, y: float) -> float:
    """Return the exact remainder of x / y with the sign of x (as fmod in C); NaN if x is infinite or y is 0.

    y is doubled until it would exceed x, then halved repeatedly and subtracted whenever it does not exceed the
    remainder.  Each difference is exact, since its operands are within a factor of 2.
    """
    rest, part = abs(x), abs(y)
    if not (rest < _INFINITY and part > 0.0):
        # the NaN of x or y, or of infinity - infinity
        return x - x if part == part else y
    if part == _INFINITY:
        return x
    least = part
    while part + part <= rest:
        part = part + part
    while part >= least and rest > 0.0:
        if part <= rest:
            rest = rest - part
        part = part * 0.5
    return rest if x > 0.0 else -rest


@readable
def modulo(x: float, y: float) -> float:
    """Return x % y, with the sign of y."""
    rest = left_over(x, y)
    if rest == 0.0:
        return 0.0 if y > 0.0 else -0.0
    if (y < 0.0) != (rest < 0.0):
        rest = rest + y
    return rest


@readable
def floor_division(x: float, y: float) -> float:
    """Return x // y: (x - remainder) / y, rounded to an integer."""
    rest = left_over(x, y)
    quotient = (x - rest) / y
    if rest != 0.0 and (y < 0.0) != (rest < 0.0):
        quotient = quotient - 1.0
    if quotient == 0.0:
        ratio = x / y
        return -0.0 if ratio < 0.0 else (0.0 if ratio > 0.0 else ratio)
    # "not <" instead of ">=": a NaN must not reach int()
    if not abs(quotient) < _WHOLE:
        return quotient
    down = float(int(quotient))
    if down > quotient:
        down = down - 1.0
    # the division may have rounded to just below a whole number, as in CPython's own float_divmod
    if quotient - down > 0.5:
        down = down + 1.0
    return down


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
    """An elementary function that kernels call by name; a call from Python gives bit-identical results."""

    name: str
    function: Callable[..., Any]
    arity: int

    def __call__(self, *values: float) -> float:
        """Evaluate the function on floats; NaN where it is undefined."""
        with np.errstate(all="ignore"):
            return float(self.function(*map(np.float64, values)))

    @property
    def symbol(self) -> str:
        """The name of the LLVM function."""
        return f"@elementary.{self.name}"

    def printed(self) -> tuple[str, list[Elementary]]:
        """Return the LLVM text of the function, and the elementary functions that it calls."""
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
