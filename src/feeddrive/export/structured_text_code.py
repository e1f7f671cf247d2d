"""Structured Text: declarations, expressions, statements generated from a graph, functions missing in IEC 61131-3."""

from __future__ import annotations

import math
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import NamedTuple, cast

import numpy as np

from feeddrive.export.identifiers import ST_WORDS, bare, identifier
from feeddrive.export.layout import word
from feeddrive.language.block import Block
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.language.graph import ELEMENTARY, TRUTH, Graph, arguments, reachable
from feeddrive.language.matrix import SQUARINGS, TOO_LARGE
from feeddrive.language.naming import Name
from feeddrive.language.quantity import Quantity

# Program organisation units of Structured Text: declarations and expressions.
#
# Structured Text expressions for the nodes of a graph: numbers and operations.
#
# Every operation stands in its own parentheses, so that no compiler's precedence or order matters, and every number
# keeps all of its bits.

INDENT = "    "
WIDTH = 116
INPUTS, OUTPUTS, VARIABLES, CONSTANTS = "VAR_INPUT", "VAR_OUTPUT", "VAR", "VAR CONSTANT"
SECTIONS = (INPUTS, OUTPUTS, VARIABLES, CONSTANTS)


@dataclass(frozen=True)
class Array:
    """A named array type, indexed from 0.

    It has a name since two anonymous array types of one form are different types in IEC 61131-3: neither assignment nor
    call may mix them.
    """

    prefix: str
    element: str
    size: int

    @property
    def name(self) -> str:
        """The name of the type: `axis_x_lreal_49`."""
        return f"{self.prefix}_{self.element.lower()}_{self.size}"

    def __str__(self) -> str:
        return self.name

    def text(self) -> str:
        """Return the declaration as source text."""
        return f"TYPE {self.name} : ARRAY[0..{self.size - 1}] OF {self.element}; END_TYPE\n"


class Declared(NamedTuple):
    """The declaration of a variable or a field: name, type, initial value as text, meaning, and a comment above it."""

    name: str
    kind: str | Array
    value: str = ""
    meaning: str = ""
    above: str = ""


@dataclass(frozen=True)
class Structure:
    """A data type with fields."""

    name: str
    comment: str
    fields: Sequence[Declared]

    def declared(self) -> Sequence[Declared]:
        """Return the fields, or a dummy field if there are none, since an empty structure is illegal."""
        return self.fields or [Declared("none", "BOOL", "", "nothing is kept here")]

    def text(self) -> str:
        """Return the declaration as source text."""
        lines = [f"TYPE {self.name} :", "STRUCT", *_declared(self.declared()), "END_STRUCT;", "END_TYPE"]
        return _joined([*comment(self.comment), *lines])


@dataclass(frozen=True)
class Unit:
    """A function block, or a function if it has a result type."""

    name: str
    comment: str
    result: str = ""
    sections: dict[str, list[Declared]] = field(default_factory=dict)
    body: Sequence[str] = ()

    @property
    def keyword(self) -> str:
        """The keyword FUNCTION or FUNCTION_BLOCK."""
        return "FUNCTION" if self.result else "FUNCTION_BLOCK"

    def declaration(self) -> str:
        """Return the header with the variables, without END_FUNCTION or END_FUNCTION_BLOCK."""
        head = f"{self.keyword} {self.name}{' : ' + self.result if self.result else ''}"
        lines = [*comment(self.comment), head]
        for section in SECTIONS:
            if self.sections.get(section):
                lines += [section, *_declared(self.sections[section]), "END_VAR"]
        return _joined(lines)

    def implementation(self) -> str:
        """Return the statements; an empty statement if there are none."""
        return _joined(self.body or [";"])

    def text(self) -> str:
        """Return the unit as source text."""
        return f"{self.declaration()}\n{self.implementation()}END_{self.keyword}\n"


def arrays(units: Iterable[Unit]) -> list[Array]:
    """Return the array types that the variables of some units have, each once."""
    declared = (variable.kind for unit in units for section in unit.sections.values() for variable in section)
    return list(dict.fromkeys(kind for kind in declared if isinstance(kind, Array)))


def _declared(variables: Iterable[Declared]) -> list[str]:
    """Return one line per variable, with the meanings of short lines aligned."""
    variables = list(variables)
    lines = [f"{INDENT}{v.name} : {v.kind}{' := ' + v.value if v.value else ''};" for v in variables]
    wide = min(44, max((len(line) for line, v in zip(lines, variables, strict=True) if v.meaning), default=0))
    printed: list[str] = []
    for line, variable in zip(lines, variables, strict=True):
        printed += [f"{INDENT}{text}".rstrip() for text in comment(variable.above)]
        if len(line) > WIDTH:  # initial values of an array
            printed += textwrap.wrap(
                line.strip(), WIDTH, initial_indent=INDENT, subsequent_indent=2 * INDENT, break_on_hyphens=False
            )
        else:
            printed.append(f"{line:<{wide}} (* {plain(variable.meaning)} *)" if variable.meaning else line)
    return printed


def comment(text: str) -> list[str]:
    """Return a comment of one or more lines; an empty list for an empty string."""
    if not text.strip():
        return []
    first, *others = plain(text).strip("\n").split("\n")
    lines = [f"(* {first}", *(f"   {line}".rstrip() for line in others)]
    return [*lines[:-1], f"{lines[-1]} *)"]


def plain(text: str) -> str:
    """Return a string that cannot begin or end a comment; such character pairs are split."""
    return text.replace("(*", "( *").replace("*)", "* )")


def _joined(lines: Iterable[str]) -> str:
    return "\n".join(lines) + "\n"


def huge(real: str) -> Declared:
    """Return the declaration of a variable whose value is so large that its square overflows to infinity."""
    return Declared(HUGE, real, "", "its square is infinite")


def with_huge(lines: list[str], real: str) -> list[str]:
    """Return the statements, after one that sets the variable `huge` if they read it."""
    if not any(HUGE in line for line in lines):
        return lines
    # assigned, not an initial value: the literal would exceed the range that `literal` keeps to
    return [f"{HUGE} := {bare(literal(_HUGE[real], real))};", *lines]


REALS = ("LREAL", "REAL")  # IEEE 754 numbers of 64 and of 32 bits
INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "eq": "=", "and": "AND", "or": "OR"}
HUGE = "huge"  # a variable: its square is infinite, for which there is no literal
_HUGE = {"LREAL": 2.0**630, "REAL": 2.0**100}
# matiec, the compiler of OpenPLC and Beremiz, reads every literal by `strtof` and refuses one that a short real cannot
# hold, an LREAL too: what lies outside is printed as a product of numbers inside
LEAST_LITERAL, MOST_LITERAL = 1.2e-38, 3e38
_SCALE = 2.0**120  # a power of two, so that the products are exact
OWN = frozenset({"floor", "power_of_two", "exponent"}) | ELEMENTARY  # functions printed with the block


def literal(value: float, real: str = "LREAL") -> str:
    """Return a number as an exact literal for an expression: `0.5`, `LREAL#0.1`, `(-LREAL#1.0E-7)`.

    A number that REAL and LREAL round differently gets a type prefix, since compilers disagree on the type of a plain
    0.1.
    """
    value = float(value)
    if math.isinf(value):
        return f"({HUGE} * {'(-' + HUGE + ')' if value < 0.0 else HUGE})"
    if not is_literal(value):
        return _product(value, real)
    sign, text = ("-", decimal(value, real)[1:]) if decimal(value, real).startswith("-") else ("", decimal(value, real))
    if real == "REAL" or short(value) != value:
        text = f"{real}#{text}"
    return f"(-{text})" if sign else text


def initial(value: float, real: str, path: str) -> str:
    """Return the decimal of an initial value. Raise ParameterError for one that not every compiler reads."""
    if not is_literal(value):
        raise ParameterError(
            f"{path} = {Quantity(value):3} cannot be an initial value in Structured Text: compilers read 0 and numbers "
            f"from {Quantity(LEAST_LITERAL):2} to {Quantity(MOST_LITERAL):1}; choose another, or export another target"
        )
    return decimal(value, real)


def is_literal(value: float) -> bool:
    """Return True if every compiler reads the number as one literal."""
    return value == 0.0 or LEAST_LITERAL <= abs(value) <= MOST_LITERAL


def _product(value: float, real: str) -> str:
    """Return a number outside the range of literals as an exact product of a number inside and powers of two."""
    factors, scale = 0, _SCALE if abs(value) > 1.0 else 1.0 / _SCALE
    while not is_literal(value):
        value, factors = value / scale, factors + 1
    text = f"{'(-' if value < 0.0 else ''}{real}#{decimal(abs(value), real)}{')' if value < 0.0 else ''}"
    for _ in range(factors):
        text = f"({text} * {real}#{decimal(scale, real)})"
    return text


def decimal(value: float, real: str = "LREAL") -> str:
    """Return the shortest decimal with the same bits, without type prefix, since a declaration states the type."""
    mantissa, _, power = str(np.float32(value) if real == "REAL" else float(value)).partition("e")
    return f"{mantissa if '.' in mantissa else mantissa + '.0'}{f'E{int(power)}' if power else ''}"


def short(value: float) -> float:
    """Round to 32-bit floating point."""
    with np.errstate(over="ignore", under="ignore"):
        return float(np.float32(value))


def expression(name: str, values: list[str], prefix: str, real: str = "LREAL") -> str:
    """Return an operation as text, parenthesized if it contains an operator.

    `prefix` is the prefix of the names of functions that are generated along with the function block.
    """
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
    """Return the name of a function generated with the function block: `axis_x_exp`, or `axis_x_exp_real` for REAL."""
    return f"{prefix}_{name}{'' if real == 'LREAL' else '_real'}"


# From a graph to statements: every choice becomes an IF, every named number a variable.
#
# An unnamed operation that is used once is written inside the expression that uses it.  A choice is
# an IF and not SEL, which computes both sides: what is not chosen must not divide by zero on a PLC that traps it.

LINE_WIDTH = 84  # a longer expression is split by introducing a variable
LEAVES = ("input", "const", "truth", "table")


@dataclass
class Assignment:
    """An assignment, `target := text;`."""

    target: str
    text: str
    needs: frozenset[int] = frozenset()  # nodes whose variables it reads
    owner: str | None = None  # the block that computes it

    def lines(self) -> list[str]:
        """Return the statement as text."""
        return [f"{self.target} := {bare(self.text)};"]


@dataclass
class Call:
    """The call of an instance of a function block."""

    text: str
    needs: frozenset[int]
    owner: str | None = None

    def lines(self) -> list[str]:
        """Return the statement as text."""
        return [self.text]


@dataclass
class Choice:
    """An IF statement with assignments and further IF statements in its branches."""

    condition: str
    then: list[Statement]
    otherwise: list[Statement]
    needs: frozenset[int]
    owner: str | None = None
    makes: set[int] = field(default_factory=set)

    def lines(self) -> list[str]:
        """Return the statement as text; an ELSE branch that consists of a single IF statement becomes ELSIF."""
        printed = [f"IF {bare(self.condition)} THEN", *_indented(self.then)]
        rest = self.otherwise
        while len(rest) == 1 and isinstance(rest[0], Choice):
            inner = rest[0]
            printed += [f"ELSIF {bare(inner.condition)} THEN", *_indented(inner.then)]
            rest = inner.otherwise
        return [*printed, "ELSE", *_indented(rest), "END_IF;"]


def _indented(statements: Iterable[Statement]) -> list[str]:
    return [INDENT + line for statement in statements for line in statement.lines()]


Statement = Assignment | Call | Choice


def _append(done: list[Statement], new: Statement) -> None:
    """Append a statement; merge an IF statement with the previous one if both have the same condition."""
    last = done[-1] if done else None
    if isinstance(last, Choice) and isinstance(new, Choice) and last.condition == new.condition:
        for branch, more in ((last.then, new.then), (last.otherwise, new.otherwise)):
            for statement in more:
                _append(branch, statement)
        last.needs |= new.needs
    else:
        done.append(new)


def _no_variable(wanted: str, kind: str | Array) -> str:
    raise AssertionError(f"no place for a variable {wanted} of the type {kind}")


class Statements:
    """The Structured Text statements that compute some nodes of a graph.

    `texts` maps leaves, and nodes already computed, to their text.  `declare(node, kind)` returns the name of the
    variable of a node and declares it with the type `kind`, unless the node is assigned directly to an existing field.
    """

    def __init__(
        self,
        graph: Graph,
        texts: Mapping[int, str],
        declare: Callable[[int, str], str],
        named: Iterable[int],
        prefix: str,
        real: str = "LREAL",
        makers: Mapping[int, str] | None = None,
    ) -> None:
        self.graph = graph
        self.texts = dict(texts)
        self.declare = declare
        self.named = set(named)
        self.prefix = prefix
        self.real = real
        self.makers = makers or {}
        self.bounds: set[int] = set()  # numbers written on the right of a comparison, such as constants
        self.used: set[str] = set()  # operations
        self.variable: Callable[[str, str | Array], str] = _no_variable
        self.done: list[Statement] = []
        self._reads: dict[int, frozenset[int]] = {}  # nodes whose variables a node's text reads
        self._held: set[int] = set()
        self._inside: set[int] = set()  # choices nested in another choice

    def compute(self, roots: Iterable[int], held: Iterable[int] = ()) -> list[Statement]:
        """Return the statements for nodes, in the order of the law; nodes in `held` always become variables."""
        roots, self._held = list(roots), set(held)
        order = self._needed(roots)
        uses = Counter(i for index in order for i in arguments(self.graph.nodes[index]))
        uses.update(roots)
        # twice: a held node becomes a variable even if no other node reads it
        uses.update(2 * list(self._held))
        alone = {index for index in order if uses[index] == 1 and index not in self.named}
        for index in order:
            name = self.graph.nodes[index][0]
            if name == "select":
                self._inside |= {
                    i
                    for i in arguments(self.graph.nodes[index])[1:]
                    if i in alone and self.graph.nodes[i][0] == "select"
                }
        for index in order:
            self._node(index, index in alone)
        return self.done

    def _needed(self, roots: list[int]) -> list[int]:
        """Return the nodes to compute, each after its arguments."""
        needed: set[int] = set()
        waiting = list(roots)
        while waiting:
            index = waiting.pop()
            if index not in needed and index not in self.texts:
                needed.add(index)
                waiting.extend(arguments(self.graph.nodes[index]))
        return sorted(needed)

    def _node(self, index: int, alone: bool) -> None:
        node = self.graph.nodes[index]
        match node[0]:
            case "const":
                self._hold(index, literal(float.fromhex(node[1]), self.real), frozenset())
            case "truth":
                self._hold(index, "TRUE" if node[1] else "FALSE", frozenset())
            case "input" | "table":
                raise AssertionError(f"no text for the leaf '{node[1]}'")
            case "select":
                if index not in self._inside:
                    self._choice(index)
            case "decays":
                size = len(node) - 1
                array = self.variable("matrix", Array(self.prefix, self.real, size))
                block = self.variable("deciding", own(self.prefix, f"decays_{size}", self.real))
                self.used.add(f"decays_{size}")
                # an array begins with zeros, and these entries are never written
                entries = [(k, self.texts[i]) for k, i in enumerate(arguments(node)) if self.texts[i] != "0.0"]
                reads = self._all_reads(arguments(node))
                for k, text in entries:
                    self.done.append(Assignment(f"{array}[{k}]", text, reads))
                self.done.append(Call(f"{block}(matrix := {array});", reads))
                self.done.append(Assignment(self._variable(index, "BOOL"), f"{block}.decays", reads))
            case name:
                self.used.add(name)
                values = arguments(node)
                text = expression(name, [self.texts[i] for i in values], self.prefix, self.real)
                if name in ("lt", "le") and (values[0] in self.bounds or self.graph.nodes[values[0]][0] == "const"):
                    text = f"({self.texts[values[1]]} {'>' if name == 'lt' else '>='} {self.texts[values[0]]})"
                reads = self._all_reads(values)
                trivial = name in ("neg", "not") and self.graph.nodes[values[0]][0] in LEAVES
                trivial = trivial and index not in self.named and index not in self._held
                if trivial or (alone and len(text) <= LINE_WIDTH):
                    self._hold(index, text, reads)
                    return
                target = self._variable(index, "BOOL" if name in TRUTH else self.real)
                self._add(Assignment(target, text, reads, self.makers.get(index)))

    def _hold(self, index: int, text: str, reads: frozenset[int]) -> None:
        self.texts[index] = text
        self._reads[index] = reads

    def _variable(self, index: int, kind: str) -> str:
        name = self.declare(index, kind)
        self._hold(index, name, frozenset({index}))
        return name

    def _all_reads(self, values: Iterable[int]) -> frozenset[int]:
        return frozenset().union(*(self._reads.get(i, frozenset({i})) for i in values))

    def _add(self, statement: Assignment) -> None:
        """Append a statement, or insert it before the last statement if that is an IF on which it does not depend.

        Successive IF statements with the same condition can then be merged.
        """
        last = self.done[-1] if self.done else None
        place = (
            len(self.done) - 1 if isinstance(last, Choice) and not (statement.needs & last.makes) else len(self.done)
        )
        self.done.insert(place, statement)

    def _choice(self, index: int) -> None:
        """Add an IF statement for a selection, or merge it with the previous one if both have the same condition."""
        choice = self._branches(index, self._variable(index, self._kind(index)))
        _append(self.done, choice)
        cast(Choice, self.done[-1]).makes.add(index)

    def _kind(self, index: int) -> str:
        """Return BOOL for a selection between truth values, else the real type."""
        name, *values = self.graph.nodes[index]
        if name == "select":
            return self._kind(values[1])
        return "BOOL" if name in TRUTH or name == "truth" else self.real

    def _branches(self, index: int, target: str) -> Choice:
        condition, *sides = arguments(self.graph.nodes[index])
        then, otherwise = (self._branch(side, target) for side in sides)
        needs = self._all_reads([condition]) | then.needs | otherwise.needs
        return Choice(self.texts[condition], [then], [otherwise], needs, self.makers.get(index))

    def _branch(self, side: int, target: str) -> Assignment | Choice:
        if side in self._inside:
            return self._branches(side, target)
        return Assignment(target, self.texts[side], self._all_reads([side]))


# a table is an array with all its initial values in the source
MOST_ENTRIES = 10_000


class Section:
    """The statements of one function block, and the variables that they need."""

    def __init__(
        self,
        prefix: str,
        blocks: Mapping[str, Block],
        graph: Graph,
        leaves: Mapping[int, str],
        names: Mapping[int, Name],
        makers: Mapping[int, str],
        real: str,
        taken: Iterable[str],
    ) -> None:
        self.prefix, self.blocks, self.graph, self.names, self.real = prefix, blocks, graph, names, real
        self.variables: list[Declared] = []
        self.places: dict[int, str] = {}  # target of a number that needs no separate variable
        self._tables: dict[str, Declared] = {}
        self._taken = {HUGE, *taken}
        self._lines: list[str] = []
        self.statements = Statements(graph, leaves, self._declare, names, prefix, real, makers)
        self.statements.variable = self.variable

    def _declare(self, index: int, kind: str) -> str:
        if index in self.places:
            return self.places[index]
        name = identifier(self._wanted(index), self._taken, ST_WORDS)
        self.variables.append(Declared(name, kind))
        return name

    def _wanted(self, index: int) -> str:
        """Return the name for a node's variable: its name in the law, the name of a state, or else a numbered name.

        The name of a state is used for a selection that may leave this state unchanged.
        """
        if index in self.names:
            return word(self.names[index])
        node = self.graph.nodes[index]
        kept = self.statements.texts.get(node[2], "") if node[0] == "select" else ""
        return kept.removeprefix("state.") if kept.startswith("state.") else f"v{len(self.variables) + 1}"

    def variable(self, wanted: str, kind: str | Array) -> str:
        """Declare a variable, such as an array, and return its name."""
        name = identifier(wanted, self._taken, ST_WORDS)
        self.variables.append(Declared(name, kind))
        return name

    def table(self, node: int, path: str, row: list[float]) -> None:
        """Declare a table as a constant array. Raise StructureError for too many entries, and as `initial` does."""
        if len(row) > MOST_ENTRIES:
            raise StructureError(
                f"{path} has {len(row)} entries, more than the {MOST_ENTRIES} that fit into a Structured Text array; "
                f"leave it out, or export another target"
            )
        name = identifier(path.removeprefix("control."), self._taken, ST_WORDS)
        values = ", ".join(initial(value, self.real, path) for value in row)
        self._tables[name] = Declared(name, Array(self.prefix, self.real, len(row)), f"[{values}]")
        self.statements.texts[node] = name

    def switch(self, node: int, switched: str) -> None:
        """Replace the comparison of an input `enable` with 0.5 by a Boolean variable."""
        for index, operation in enumerate(self.graph.nodes):
            if (
                operation[0] == "lt"
                and operation[2] == node
                and self.graph.nodes[operation[1]] == ("const", (0.5).hex())
            ):
                self.statements.texts[index] = switched

    def compute(self, nodes: Iterable[int]) -> list[str]:
        """Return the statements for the given nodes, under headings that name the blocks that compute them."""
        nodes = list(nodes)
        self.statements.done = []
        statements = self.statements.compute(nodes, nodes)
        self._lines = []
        owner = None
        for statement in statements:
            if statement.owner is not None and statement.owner != owner:
                owner = statement.owner
                kind = self.blocks[owner].kind if owner in self.blocks else ""
                shown = owner if not kind or owner.endswith(kind) else f"{owner}: {kind}"
                self._lines += [*([""] if self._lines else []), f"(* {shown or 'the loop'} *)"]
            self._lines += statement.lines()
        if any(HUGE in line for line in self._lines):
            self.variables.append(huge(self.real))
            self._lines = with_huge(self._lines, self.real)
        return self._lines

    def constants(self) -> list[Declared]:
        """Return the tables that the statements read."""
        return [array for name, array in self._tables.items() if any(f"{name}[" in line for line in self._lines)]

    def assign(self, targets: Iterable[tuple[str, int]]) -> list[str]:
        """Return assignments that act as if simultaneous: values overwritten before they are read are saved first."""
        moved = [(place, self.statements.texts[index]) for place, index in targets]
        moved = [(place, text) for place, text in moved if place != text]
        places = {place for place, _ in moved}
        lines: list[str] = []
        held: dict[str, str] = {}
        for _, text in moved:
            if text in places and text not in held:
                name = identifier(f"last_{text.rpartition('.')[2]}", self._taken, ST_WORDS)
                self.variables.append(Declared(name, self.real))
                held[text] = name
                lines.append(f"{name} := {text};")
        return lines + [line for place, text in moved for line in Assignment(place, held.get(text, text)).lines()]


# Functions that IEC 61131-3 lacks or does not define to the last bit, printed with the block that calls them.
#
# The elementary functions are those of the simulator, traced from the same source; a PLC's EXP differs in last bits.

_SAID = {
    "exp": "e^x.",
    "expm1": "e^x - 1, exact to the last bits for small x.",
    "log": "The natural logarithm; NaN for x < 0.",
    "sin": "The sine of x rad; NaN for angles too large to resolve.",
    "cos": "The cosine of x rad; NaN for angles too large to resolve.",
    "tanh": "The hyperbolic tangent.",
    "atan": "The arc tangent in rad.",
    "floor": "The largest whole number not above x. Beyond {whole} every number is whole; below, adding it rounds.",
    "power_of_two": "2^k for a whole number k from {lowest} to {highest}, by squaring: such products are exact.",
    "exponent": "The whole number k with 2^k <= |x| < 2^(k+1); {zero} for 0, {infinite} for what is not finite.",
}
_VARIABLES = {
    "floor": ("x", {"whole": "{real}"}),
    "power_of_two": ("k", {"rest": "DINT", "power": "{real}", "base": "{real}"}),
    "exponent": ("x", {"size": "{real}", "jump": "{real}", "k": "{real}"}),
}
_BODIES = {
    "floor": """\
IF x < {point} THEN
    whole := (x - {whole}) + {whole};
ELSE
    whole := (x + {whole}) - {whole};
END_IF;
IF whole > x THEN
    whole := whole - {one};
END_IF;
IF (ABS(x) < {whole}) AND (whole <> x) THEN
    {name} := whole;
ELSE
    {name} := x;
END_IF;""",
    "power_of_two": """\
rest := 0;
IF ABS(k) <= {highest} THEN
    rest := {real}_TO_DINT(ABS(k));
END_IF;
base := {two};
IF k < {point} THEN
    base := {half};
END_IF;
power := {one};
WHILE rest > 0 DO
    IF (rest MOD 2) = 1 THEN
        power := power * base;
    END_IF;
    rest := rest / 2;
    IF rest > 0 THEN
        base := base * base;
    END_IF;
END_WHILE;
{name} := power;""",
    "exponent": """\
size := ABS(x);
IF NOT (size <= {largest}) THEN
    {name} := {infinite};
ELSIF size < {least} THEN
    {name} := {zero};
ELSE
    k := {point};
    jump := {jump};
    WHILE jump >= {one} DO
        IF size >= {power}(jump) THEN
            size := size * {power}(-jump);
            k := k + jump;
        ELSIF size < {power}({one} - jump) THEN
            size := size * {power}(jump);
            k := k - jump;
        END_IF;
        jump := {half} * jump;
    END_WHILE;
    {name} := k;
END_IF;""",
}
_RANGE = {  # floating-point format: fraction bits, exponents, largest number
    "LREAL": {
        "whole": 2.0**52,
        "lowest": -1022.0,
        "highest": 1023.0,
        "zero": -1023.0,
        "infinite": 1024.0,
        "largest": 1.7976931348623157e308,
        "least": 2.0**-1022,
        "jump": 512.0,
    },
    "REAL": {
        "whole": 2.0**23,
        "lowest": -126.0,
        "highest": 127.0,
        "zero": -127.0,
        "infinite": 128.0,
        "largest": 3.4028234663852886e38,
        "least": 2.0**-126,
        "jump": 64.0,
    },
}


def functions(used: Iterable[str], prefix: str, real: str = "LREAL") -> list[Unit]:
    """Return the functions that some operations need, each after its dependencies."""
    units: dict[str, Unit] = {}
    for name in sorted(set(used) & OWN):
        _add(units, name, prefix, real)
    for name in sorted(operation for operation in used if operation.startswith("decays_")):
        units[name] = _decays(int(name.removeprefix("decays_")), prefix, real)
    return list(units.values())


def _decays(size: int, prefix: str, real: str) -> Unit:
    """Return the function block that tests whether the powers of a matrix decay to 0.

    It is not a function: matiec casts an array that is the argument of one to LREAL.
    """
    name, n, array = own(prefix, f"decays_{size}", real), math.isqrt(size), Array(prefix, real, size)
    numbers = {"one": literal(1.0, real), "large": literal(TOO_LARGE, real)}
    counts = [Declared(counter, "DINT") for counter in ("squaring", "i", "j", "k")]
    return Unit(
        name,
        f"Whether the powers of a matrix of {n} rows, which stand one behind the other, fall towards 0.",
        "",
        {
            INPUTS: [Declared("matrix", array)],
            OUTPUTS: [Declared("decays", "BOOL")],
            VARIABLES: [
                Declared("now", array),
                Declared("next", array),
                Declared("norm", real),
                Declared("sum", real),
                Declared("done", "BOOL"),
                Declared("broken", "BOOL"),
                *counts,
            ],
        },
        _DECAYS.format(n=n, last=n - 1, most=SQUARINGS, **numbers).split("\n"),
    )


_DECAYS = """\
decays := FALSE;
done := FALSE;
squaring := 0;
now := matrix;
WHILE (NOT done) AND (squaring < {most}) DO
    broken := FALSE;
    decays := TRUE;
    FOR i := 0 TO {last} DO
        norm := ABS(now[i * {n}]);
        FOR k := 1 TO {last} DO
            norm := norm + ABS(now[(i * {n}) + k]);
        END_FOR;
        broken := broken OR (NOT (norm < {large}));
        decays := decays AND (norm < {one});
    END_FOR;
    done := broken OR decays;
    IF NOT done THEN
        FOR i := 0 TO {last} DO
            FOR j := 0 TO {last} DO
                sum := now[i * {n}] * now[j];
                FOR k := 1 TO {last} DO
                    sum := sum + (now[(i * {n}) + k] * now[(k * {n}) + j]);
                END_FOR;
                next[(i * {n}) + j] := sum;
            END_FOR;
        END_FOR;
        now := next;
    END_IF;
    squaring := squaring + 1;
END_WHILE;
decays := decays AND (NOT broken);"""


def _add(units: dict[str, Unit], name: str, prefix: str, real: str) -> None:
    if name in units:
        return
    if name in ELEMENTARY:
        graph = Graph()
        root = getattr(_module(real), name)(graph.input("x")).index
        for inner in sorted({graph.name(index) for index in reachable(graph, [root])} & OWN):
            _add(units, inner, prefix, real)
        units[name] = _elementary(name, graph, root, prefix, real)
        return
    if name == "exponent":
        _add(units, "power_of_two", prefix, real)
    units[name] = _plain(name, prefix, real)


def _module(real: str) -> object:
    return import_module(f"feeddrive.language.{'mathematics' if real == 'LREAL' else 'single'}")


def _plain(name: str, prefix: str, real: str) -> Unit:
    numbers = {"point": 0.0, "half": 0.5, "one": 1.0, "two": 2.0, **_RANGE[real]}
    printed = ((key, literal(value, real)) for key, value in numbers.items())
    texts = {key: text if "*" in text else bare(text) for key, text in printed}
    argument, variables = _VARIABLES[name]
    names = {"real": real, "name": own(prefix, name, real), "power": own(prefix, "power_of_two", real)}
    body = _BODIES[name].format(**names, **texts)
    meaning = _SAID[name].format(**{key: f"{value:.0f}" for key, value in numbers.items() if abs(value) < 1e17})
    declared = [Declared(variable, kind.format(real=real)) for variable, kind in variables.items()]
    return Unit(
        own(prefix, name, real),
        meaning,
        real,
        {INPUTS: [Declared(argument, real)], VARIABLES: declared},
        body.split("\n"),
    )


def _elementary(name: str, graph: Graph, root: int, prefix: str, real: str) -> Unit:
    """Return a function for an elementary operation; its body is the same plain arithmetic as in the simulator."""
    function = own(prefix, name, real)
    taken = {"x", HUGE, function}
    variables: list[Declared] = []

    def declare(index: int, kind: str) -> str:
        # a function of Structured Text returns what is assigned to its name
        if index == root:
            return function
        variables.append(Declared(identifier(f"v{len(variables) + 1}", taken, ST_WORDS), kind))
        return variables[-1].name

    statements = Statements(graph, {graph.input("x").index: "x"}, declare, (), prefix, real)
    body = [line for statement in statements.compute([root], [root]) for line in statement.lines()]
    if any(HUGE in line for line in body):
        variables.insert(0, huge(real))
        body = with_huge(body, real)
    return Unit(function, _SAID[name], real, {INPUTS: [Declared("x", real)], VARIABLES: variables}, body)
