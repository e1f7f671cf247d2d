"""A parser of the Structured Text that exports use, by the grammar of IEC 61131-3 (Annex A of edition 3).

It takes what the standard takes and nothing that only some vendors take: every declaration and statement ends with `;`,
that of a structure too, no list is empty, comments do not nest, a real number has digits on both sides of its point, a
name has no two underscores in a row and none at its end.  Keywords stand in capitals, as exports print them.
"""

from __future__ import annotations

import re
from typing import Any, NamedTuple


class IllegalTextError(Exception):
    """Text that a PLC would refuse, or that would mean something else on another one."""


class Literal(NamedTuple):
    """A number or a truth value: its text, "real", "integer" or "truth", and the type in front, if any."""

    text: str
    form: str
    kind: str | None


class Place(NamedTuple):
    """A variable, and what follows it: ("field", name) or ("index", expression)."""

    name: str
    parts: tuple[tuple[str, object], ...]


class Unary(NamedTuple):
    """NOT or a minus."""

    op: str
    value: object


class Binary(NamedTuple):
    """Two operands and what stands between them."""

    op: str
    left: object
    right: object


class FunctionCall(NamedTuple):
    """A function of arguments in their order."""

    name: str
    arguments: tuple[object, ...]


class Assignment(NamedTuple):
    """place := value;"""

    place: Place
    value: object


class Choice(NamedTuple):
    """IF and ELSIF: conditions with their statements; ELSE: the rest, or None."""

    branches: tuple[tuple[object, tuple[object, ...]], ...]
    otherwise: tuple[object, ...] | None


class Repetition(NamedTuple):
    """WHILE condition DO statements END_WHILE."""

    condition: object
    statements: tuple[object, ...]


class Counting(NamedTuple):
    """FOR name := first TO last DO statements END_FOR."""

    name: str
    first: object
    last: object
    statements: tuple[object, ...]


class BlockCall(NamedTuple):
    """An instance of a function block, with inputs by name."""

    name: str
    inputs: tuple[tuple[str, object], ...]


class Variable(NamedTuple):
    """A declared name; its type, or (first index, last index, type) of an array; its first value or row of values."""

    name: str
    kind: str | tuple[int, int, str]
    value: Any


class Structure(NamedTuple):
    """TYPE name : STRUCT ... END_STRUCT; END_TYPE."""

    name: str
    fields: tuple[Variable, ...]


class ArrayType(NamedTuple):
    """TYPE name : ARRAY[first..last] OF type; END_TYPE."""

    name: str
    first: int
    last: int
    kind: str


class Block(NamedTuple):
    """A FUNCTION (`result` is its type) or a FUNCTION_BLOCK, with its sections by keyword."""

    name: str
    result: str
    sections: tuple[tuple[str, tuple[Variable, ...]], ...]
    statements: tuple[object, ...]


_TOKEN = re.compile(
    r"(?P<space>\s+)|(?P<comment>\(\*.*?\*\))|(?P<real>\d+\.\d+(?:E[+-]?\d+)?)|(?P<integer>\d+)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<sign>:=|\.\.|<=|>=|<>|[-+*/=<>()\[\],;:.#])",
    re.ASCII | re.DOTALL,
)
_NAME = re.compile(r"_?[A-Za-z0-9]+(?:_[A-Za-z0-9]+)*", re.ASCII)
_KEYWORDS = {
    "TYPE",
    "END_TYPE",
    "STRUCT",
    "END_STRUCT",
    "FUNCTION",
    "END_FUNCTION",
    "FUNCTION_BLOCK",
    "END_FUNCTION_BLOCK",
    "VAR",
    "VAR_INPUT",
    "VAR_OUTPUT",
    "CONSTANT",
    "END_VAR",
    "ARRAY",
    "OF",
    "IF",
    "THEN",
    "ELSIF",
    "ELSE",
    "END_IF",
    "WHILE",
    "DO",
    "END_WHILE",
    "FOR",
    "TO",
    "END_FOR",
    "AND",
    "OR",
    "XOR",
    "NOT",
    "MOD",
    "TRUE",
    "FALSE",
}
_LEVELS = (("OR",), ("XOR",), ("AND",), ("=", "<>"), ("<", ">", "<=", ">="), ("+", "-"), ("*", "/", "MOD"))


def parse(text: str) -> tuple[Structure | ArrayType | Block, ...]:
    """All declarations of a source text. Raises IllegalTextError with the line of what the standard does not take."""
    return _Parser(text).source()


class _Parser:
    def __init__(self, text: str) -> None:
        self.tokens: list[tuple[str, str, int]] = []
        self.at = 0
        place = 0
        while place < len(text):
            found = _TOKEN.match(text, place)
            line = text.count("\n", 0, place) + 1 if found is None else 0
            if found is None:
                raise IllegalTextError(f"line {line}: {text[place : place + 10]!r} is no symbol")
            form, word = str(found.lastgroup), found[0]
            if form == "comment" and "(*" in word[2:]:
                raise IllegalTextError(f"comment within a comment: {word[:60]!r}")
            if form in ("real", "integer") and text[found.end() : found.end() + 1].isalnum():
                raise IllegalTextError(f"{text[place : found.end() + 2]!r} is no number")
            if form not in ("space", "comment"):
                if form == "name" and word in _KEYWORDS:
                    form = "word"
                self.tokens.append((form, word, place))
            place = found.end()
        self.text = text
        self.tokens.append(("end", "the end", len(text)))

    def refuse(self, wanted: str) -> IllegalTextError:
        _, word, place = self.tokens[self.at]
        return IllegalTextError(f"line {self.text.count(chr(10), 0, place) + 1}: {wanted} where {word!r} stands")

    def next(self, *words: str) -> bool:
        """Whether one of some words or signs is next."""
        form, word, _ = self.tokens[self.at]
        return form in ("word", "sign") and word in words

    def take(self, *words: str) -> str:
        """One of some words or signs, which must be next."""
        if not self.next(*words):
            raise self.refuse(f"{' or '.join(words)} is missing")
        self.at += 1
        return self.tokens[self.at - 1][1]

    def took(self, *words: str) -> bool:
        """Take a word or a sign if it is next."""
        found = self.next(*words)
        self.at += found
        return found

    def form(self, form: str) -> str:
        """A name or a number, which must be next."""
        found, word, _ = self.tokens[self.at]
        if found != form:
            raise self.refuse(f"a {form} is missing")
        if form == "name" and not _NAME.fullmatch(word):
            raise self.refuse("a legal name is missing")
        self.at += 1
        return word

    def source(self) -> tuple[Structure | ArrayType | Block, ...]:
        found: list[Structure | ArrayType | Block] = []
        while self.tokens[self.at][0] != "end":
            found.append(self.type() if self.next("TYPE") else self.block())
        return tuple(found)

    def type(self) -> Structure | ArrayType:
        self.take("TYPE")
        name = self.form("name")
        self.take(":")
        if self.took("ARRAY"):
            array = ArrayType(name, *self.array())
            self.take(";")
            self.take("END_TYPE")
            return array
        self.take("STRUCT")
        fields = self.variables("END_STRUCT")
        self.take(";")
        self.take("END_TYPE")
        return Structure(name, fields)

    def block(self) -> Block:
        keyword = self.take("FUNCTION", "FUNCTION_BLOCK")
        name, result = self.form("name"), ""
        if keyword == "FUNCTION":
            self.take(":")
            result = self.form("name")
        sections: list[tuple[str, tuple[Variable, ...]]] = []
        while self.next("VAR", "VAR_INPUT", "VAR_OUTPUT"):
            section = self.take("VAR", "VAR_INPUT", "VAR_OUTPUT")
            if section == "VAR" and self.took("CONSTANT"):
                section = "VAR CONSTANT"
            sections.append((section, self.variables("END_VAR")))
        if result and "VAR_INPUT" not in dict(sections):
            raise self.refuse(f"the function {name} needs an input")
        statements = self.statements(f"END_{keyword}")
        self.take(f"END_{keyword}")
        return Block(name, result, tuple(sections), statements)

    def variables(self, end: str) -> tuple[Variable, ...]:
        found = [self.variable()]
        while not self.took(end):
            found.append(self.variable())
        return tuple(found)

    def variable(self) -> Variable:
        name = self.form("name")
        self.take(":")
        kind: str | tuple[int, int, str] = self.array() if self.took("ARRAY") else self.form("name")
        value: Any = None
        if self.took(":="):
            value = self.row() if self.next("[") else self.literal()
        self.take(";")
        return Variable(name, kind, value)

    def array(self) -> tuple[int, int, str]:
        """What stands behind ARRAY: first index, last index, type."""
        self.take("[")
        first = int(self.form("integer"))
        self.take("..")
        last = int(self.form("integer"))
        self.take("]")
        self.take("OF")
        return first, last, self.form("name")

    def row(self) -> tuple[Literal, ...]:
        self.take("[")
        found = [self.literal()]
        while self.took(","):
            found.append(self.literal())
        self.take("]")
        return tuple(found)

    def literal(self) -> Literal:
        """A constant of a declaration, with its sign."""
        kind = self._kind_in_front()
        sign = "-" if self.took("-") else ""
        if sign and self.next("TRUE", "FALSE"):
            raise self.refuse("a number is missing")
        found = self._number(kind)
        return found._replace(text=sign + found.text)

    def _kind_in_front(self) -> str | None:
        """The type of `LREAL#0.1`."""
        if self.tokens[self.at][0] == "name" and self.tokens[self.at + 1][1] == "#":
            kind = self.form("name")
            self.take("#")
            return kind
        return None

    def _number(self, kind: str | None) -> Literal:
        if self.next("TRUE", "FALSE"):
            return Literal(self.take("TRUE", "FALSE"), "truth", kind)
        form = "real" if self.tokens[self.at][0] == "real" else "integer"
        return Literal(self.form(form), form, kind)

    def statements(self, *ends: str) -> tuple[object, ...]:
        """At least one; `;` alone is an empty one."""
        found: list[object] = []
        first = True
        while first or not self.next(*ends):
            first = False
            if self.took(";"):
                continue
            found.append(self.statement())
            self.take(";")
        return tuple(found)

    def statement(self) -> object:
        if self.took("IF"):
            return self.choice()
        if self.took("WHILE"):
            condition = self.expression()
            self.take("DO")
            inner = self.statements("END_WHILE")
            self.take("END_WHILE")
            return Repetition(condition, inner)
        if self.took("FOR"):
            name = self.form("name")
            self.take(":=")
            first = self.expression()
            self.take("TO")
            last = self.expression()
            self.take("DO")
            inner = self.statements("END_FOR")
            self.take("END_FOR")
            return Counting(name, first, last, inner)
        name = self.form("name")
        if self.took("("):
            return self.block_call(name)
        place = self.place(name)
        self.take(":=")
        return Assignment(place, self.expression())

    def choice(self) -> Choice:
        branches: list[tuple[object, tuple[object, ...]]] = []
        while True:
            condition = self.expression()
            self.take("THEN")
            branches.append((condition, self.statements("ELSIF", "ELSE", "END_IF")))
            if not self.took("ELSIF"):
                break
        otherwise = self.statements("END_IF") if self.took("ELSE") else None
        self.take("END_IF")
        return Choice(tuple(branches), otherwise)

    def block_call(self, name: str) -> BlockCall:
        inputs: list[tuple[str, object]] = []
        while not self.took(")"):
            if inputs:
                self.take(",")
            given = self.form("name")
            self.take(":=")
            inputs.append((given, self.expression()))
        return BlockCall(name, tuple(inputs))

    def expression(self, level: int = 0) -> object:
        if level == len(_LEVELS):
            return self.unary()
        left = self.expression(level + 1)
        while self.next(*_LEVELS[level]):
            op = self.take(*_LEVELS[level])
            left = Binary(op, left, self.expression(level + 1))
        return left

    def unary(self) -> object:
        if self.next("-", "NOT"):
            return Unary(self.take("-", "NOT"), self.primary())
        return self.primary()

    def primary(self) -> object:
        if self.took("("):
            inner = self.expression()
            self.take(")")
            return inner
        kind = self._kind_in_front()
        if kind is not None or self.next("TRUE", "FALSE") or self.tokens[self.at][0] in ("real", "integer"):
            sign = "-" if kind is not None and self.took("-") else ""
            found = self._number(kind)
            return found._replace(text=sign + found.text)
        name = self.form("name")
        if not self.took("("):
            return self.place(name)
        arguments = [self.expression()]
        while self.took(","):
            arguments.append(self.expression())
        self.take(")")
        return FunctionCall(name, tuple(arguments))

    def place(self, name: str) -> Place:
        parts: list[tuple[str, object]] = []
        while self.next(".", "["):
            if self.took("."):
                parts.append(("field", self.form("name")))
            else:
                self.take("[")
                parts.append(("index", self.expression()))
                self.take("]")
        return Place(name, tuple(parts))
