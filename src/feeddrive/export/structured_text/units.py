"""Program organisation units: structures, functions and function blocks, with what is declared in them."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from feeddrive.export.structured_text.expressions import HUGE

INDENT = "    "
WIDTH = 116
INPUTS, OUTPUTS, VARIABLES, CONSTANTS = "VAR_INPUT", "VAR_OUTPUT", "VAR", "VAR CONSTANT"
SECTIONS = (INPUTS, OUTPUTS, VARIABLES, CONSTANTS)


class Declared(NamedTuple):
    """A variable or a field: name, type, first value as text, what it is, and what stands above it."""

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
        """Its fields; a structure without any is not legal, so one stands there."""
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
