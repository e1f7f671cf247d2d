"""Program organisation units of Structured Text: declarations and expressions.

Structured Text expressions for the nodes of a graph: numbers and operations.

Every operation stands in its own parentheses, so that no compiler's precedence or order matters, and every number keeps
all of its bits.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from feeddrive.export.identifiers import bare
from feeddrive.language.graph import ELEMENTARY

INDENT = "    "
WIDTH = 116
INPUTS, OUTPUTS, VARIABLES, CONSTANTS = "VAR_INPUT", "VAR_OUTPUT", "VAR", "VAR CONSTANT"
SECTIONS = (INPUTS, OUTPUTS, VARIABLES, CONSTANTS)


class Declared(NamedTuple):
    """A variable or a field: name, type, first value as text, meaning, and the comment above it."""

    name: str
    kind: str
    value: str = ""
    meaning: str = ""
    above: str = ""


@dataclass(frozen=True)
class Structure:
    """A data type with fields."""

    name: str
    said: str
    fields: Sequence[Declared]

    def declared(self) -> Sequence[Declared]:
        """Its fields; a structure without any is not legal, so it gets one."""
        return self.fields or [Declared("none", "BOOL", "", "nothing is kept here")]

    def text(self) -> str:
        """As it stands in a source file."""
        lines = [f"TYPE {self.name} :", "STRUCT", *_declared(self.declared()), "END_STRUCT;", "END_TYPE"]
        return _joined([*comment(self.said), *lines])


@dataclass(frozen=True)
class Unit:
    """A function (`result` is its type) or a function block."""

    name: str
    said: str
    result: str = ""
    sections: dict[str, list[Declared]] = field(default_factory=dict)
    body: Sequence[str] = ()

    @property
    def keyword(self) -> str:
        """FUNCTION or FUNCTION_BLOCK."""
        return "FUNCTION" if self.result else "FUNCTION_BLOCK"

    def declaration(self) -> str:
        """The upper part, without its end."""
        head = f"{self.keyword} {self.name}{' : ' + self.result if self.result else ''}"
        lines = [*comment(self.said), head]
        for section in SECTIONS:
            if self.sections.get(section):
                lines += [section, *_declared(self.sections[section]), "END_VAR"]
        return _joined(lines)

    def implementation(self) -> str:
        """The statements; an empty one where there is nothing to do."""
        return _joined(self.body or [";"])

    def text(self) -> str:
        """As it stands in a source file."""
        return f"{self.declaration()}\n{self.implementation()}END_{self.keyword}\n"


def _declared(variables: Iterable[Declared]) -> list[str]:
    """One line each, with the meanings below one another where that leaves the lines short."""
    variables = list(variables)
    lines = [f"{INDENT}{v.name} : {v.kind}{' := ' + v.value if v.value else ''};" for v in variables]
    wide = min(44, max((len(line) for line, v in zip(lines, variables, strict=True) if v.meaning), default=0))
    found: list[str] = []
    for line, variable in zip(lines, variables, strict=True):
        found += [f"{INDENT}{text}".rstrip() for text in comment(variable.above)]
        if len(line) > WIDTH:  # a row of first values
            found += textwrap.wrap(
                line.strip(), WIDTH, initial_indent=INDENT, subsequent_indent=2 * INDENT, break_on_hyphens=False
            )
        else:
            found.append(f"{line:<{wide}} (* {plain(variable.meaning)} *)" if variable.meaning else line)
    return found


def comment(text: str) -> list[str]:
    """A comment of one or more lines; none for an empty text."""
    if not text.strip():
        return []
    first, *others = plain(text).strip("\n").split("\n")
    lines = [f"(* {first}", *(f"   {line}".rstrip() for line in others)]
    return [*lines[:-1], f"{lines[-1]} *)"]


def plain(text: str) -> str:
    """Text that cannot begin or end a comment."""
    return text.replace("(*", "( *").replace("*)", "* )")


def _joined(lines: Iterable[str]) -> str:
    return "\n".join(lines) + "\n"


def huge(real: str) -> Declared:
    """The variable whose square is infinite."""
    return Declared(HUGE, real, "1.0E300" if real == "LREAL" else "1.0E30", "its square is infinite")


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
    """The shortest decimal number that reads back to the same bits; in a declaration the type is given separately."""
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
