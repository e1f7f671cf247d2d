"""Structured Text expressions for the nodes of a graph: numbers and operations.

Every operation stands in its own parentheses, so that no compiler's precedence or order matters, and every number keeps
all of its bits.
"""

from __future__ import annotations

import math

import numpy as np

from feeddrive.export.identifiers import bare
from feeddrive.language.graph import ELEMENTARY

REALS = ("LREAL", "REAL")  # IEEE 754 numbers of 64 and of 32 bits
INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "eq": "=", "and": "AND", "or": "OR"}
HUGE = "huge"  # a variable: its square is infinite, for which there is no literal
OWN = frozenset({"floor", "power_of_two", "exponent"}) | ELEMENTARY  # functions that are printed with the block


def literal(value: float, real: str = "LREAL") -> str:
    """A number within an expression, as text that reads back to the same bits: `0.5`, `LREAL#0.1`, `(-LREAL#1.0E-7)`.

    The type stands in front of a number that a short and a long real round differently, since compilers do not agree on
    what a plain 0.1 is.
    """
    value = float(value)
    if math.isinf(value):
        return f"({HUGE} * {'(-' + HUGE + ')' if value < 0.0 else HUGE})"
    sign, text = ("-", decimal(value, real)[1:]) if decimal(value, real).startswith("-") else ("", decimal(value, real))
    if real == "REAL" or short(value) != value:
        text = f"{real}#{text}"
    return f"(-{text})" if sign else text


def decimal(value: float, real: str = "LREAL") -> str:
    """The shortest decimal number that reads back to the same bits; in a declaration the type stands beside it."""
    mantissa, _, power = str(np.float32(value) if real == "REAL" else float(value)).partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{f'E{int(power)}' if power else ''}"


def short(value: float) -> float:
    """Rounded to 32 bits."""
    with np.errstate(over="ignore", under="ignore"):
        return float(np.float32(value))


def expression(name: str, values: list[str], prefix: str, real: str = "LREAL") -> str:
    """An operation as text, in parentheses where it has an operator; `prefix` is that of the block's own functions."""
    if name in INFIX:
        return f"({values[0]} {INFIX[name]} {values[1]})"
    if name == "neg":
        return f"(-{values[0]})"
    if name == "not":
        return f"(NOT {values[0]})"
    if name in ("abs", "sqrt"):
        return f"{name.upper()}({bare(values[0])})"
    if name == "gather":
        return f"{values[0]}[{real}_TO_DINT({bare(values[1])})]"
    if name in OWN:
        return f"{own(prefix, name, real)}({', '.join(map(bare, values))})"
    raise AssertionError(f"no text for the operation '{name}'")


def own(prefix: str, name: str, real: str) -> str:
    """The name of a function that is printed with the block: `axis_x_exp`, or `axis_x_exp_real` for short reals."""
    return f"{prefix}_{name}{'' if real == 'LREAL' else '_real'}"
