"""A small, strict machine for Structured Text: `structured_text_grammar` reads it, Python runs it.

Stricter than a PLC: a name that is not declared, declared twice or written in another case, a number of the wrong type,
a mixture of reals and integers, a plain literal that a short real would round, a variable that is read before it was
written, an assignment to an input or a constant: each raises `IllegalTextError`.
Reals are IEEE 754 numbers, every operation rounded by itself.  With `flush`, numbers below the normal ones are zero.
"""

from __future__ import annotations

from typing import Any

from structured_text_grammar import (
    ArrayType,
    Assignment,
    Binary,
    Block,
    BlockCall,
    Choice,
    Counting,
    FunctionCall,
    IllegalTextError,
    Literal,
    Place,
    Repetition,
    Structure,
    Unary,
    parse,
)
from structured_text_values import (
    INTEGERS,
    REALS,
    Struct,
    checked_name,
    divide,
    flushed,
    initial,
    real,
    root,
    short,
    short_flushed,
    to_integer,
    truncated,
)

ARITHMETIC = {"+": "add", "-": "sub", "*": "mul", "/": "div"}
COMPARISONS = {"<": "<", "<=": "<=", ">": ">", ">=": ">=", "=": "==", "<>": "!="}


def program(text: str, flush: bool = True) -> Program:
    """Read a source text."""
    return Program(parse(text), flush)


class Program:
    """All types, functions and function blocks of a source text."""

    def __init__(self, source: tuple[Structure | ArrayType | Block, ...], flush: bool) -> None:
        self.arrays: dict[str, tuple[str, int, int, str]] = {}
        self.structs: dict[str, dict[str, tuple[Any, Any]]] = {}
        self.functions: dict[str, tuple[Any, list[tuple[str, Any]], str]] = {}
        self.blocks: dict[str, Unit] = {}
        self.flush = flush
        self.names: set[str] = set()
        for item in source:
            self.claim(item.name)
            if isinstance(item, Structure):
                self._struct(item)
            elif isinstance(item, ArrayType):
                self.arrays[item.name] = (item.name, item.first, item.last, self.known(item.kind))
            elif item.result:
                unit = Unit(self, item)
                given = [(name, unit.types[name]) for name in unit.inputs]
                self.functions[item.name] = (unit.compiled(), given, unit.result)  # known to those behind it
            else:
                self.blocks[item.name] = Unit(self, item)

    def claim(self, name: str) -> None:
        """A name of the outermost level."""
        checked_name(name, self.names)

    def _struct(self, declared: Structure) -> None:
        taken: set[str] = set()
        found: dict[str, tuple[Any, Any]] = {}
        for field in declared.fields:
            checked_name(field.name, taken)
            found[field.name] = (self.known(field.kind), initial(field.kind, field.value))
        self.structs[declared.name] = found

    def known(self, kind: Any) -> Any:
        """A type that stands before its use."""
        if kind not in {*REALS, *INTEGERS, "BOOL", *self.structs, *self.blocks}:
            raise IllegalTextError(f"{kind} is no type")
        return kind

    def value(self, kind: Any, given: Any) -> Any:
        """The first value of a variable; None for a number that was given none: reading it raises."""
        if kind in self.structs:
            return Struct({name: value for name, (_, value) in self.structs[kind].items()})
        if kind in self.blocks:
            return self.blocks[kind].instance()
        return list(given) if isinstance(given, list) else given


class Unit:
    """A function or a function block, compiled to Python."""

    def __init__(self, owner: Program, item: Block) -> None:
        self.owner, self.name, self.result = owner, item.name, item.result
        self.types: dict[str, Any] = {}
        self.first: dict[str, Any] = {}
        self.inputs: list[str] = []
        self.outputs: list[str] = []
        self.constants: set[str] = set()
        taken: set[str] = set()
        for section, variables in item.sections:
            for variable in variables:
                checked_name(variable.name, taken)
                self.types[variable.name], self.first[variable.name] = self._type(variable.kind, variable.value)
            names = [variable.name for variable in variables]
            self.inputs += names if section == "VAR_INPUT" else []
            self.outputs += names if section == "VAR_OUTPUT" else []
            self.constants |= set(names) if section == "VAR CONSTANT" else set()
        if self.result:
            checked_name(self.name, taken)
            self.types[self.name] = owner.known(self.result)
        self.python = "\n".join([f"def body(s):  # {self.name}", *self.statements(item.statements, "    ")])

    def _type(self, kind: Any, value: Any) -> tuple[Any, Any]:
        if isinstance(kind, tuple):
            # two anonymous types are never the same
            raise IllegalTextError(f"{self.name}: an array without the name of a type")
        if kind not in self.owner.arrays:
            return self.owner.known(kind), initial(kind, value)
        made = self.owner.arrays[kind]
        _, low, high, inner = made
        if value is None:
            return made, [0.0] * (high - low + 1)
        if len(value) != high - low + 1:
            raise IllegalTextError(f"{len(value)} numbers for an array of {high - low + 1}")
        return made, [initial(inner, each) for each in value]

    def fresh(self) -> Struct:
        """All variables with their first values."""
        return Struct({name: self.owner.value(kind, self.first.get(name)) for name, kind in self.types.items()})

    def body(self) -> Any:
        """The Python function."""
        z, z32 = (flushed, short_flushed) if self.owner.flush else (float, short)
        scope: dict[str, Any] = {
            "LREAL_add": lambda a, b: z(a + b),
            "LREAL_sub": lambda a, b: z(a - b),
            "LREAL_mul": lambda a, b: z(a * b),
            "LREAL_div": lambda a, b: z(divide(a, b)),
            "LREAL_sqrt": lambda a: z(root(a)),
            "REAL_add": lambda a, b: z32(a + b),
            "REAL_sub": lambda a, b: z32(a - b),
            "REAL_mul": lambda a, b: z32(a * b),
            "REAL_div": lambda a, b: z32(divide(a, b)),
            "REAL_sqrt": lambda a: z32(root(a)),
            "REAL": z32,
            "to_integer": to_integer,
            "truncated": truncated,
        }
        for name, (function, _, _) in self.owner.functions.items():
            scope[f"call_{name}"] = function
        exec(compile(self.python, f"<{self.name}>", "exec"), scope)
        return scope["body"]

    def compiled(self) -> Any:
        """A function as a Python function."""
        body = self.body()

        def call(*values: Any) -> Any:
            s = self.fresh()
            for name, value in zip(self.inputs, values, strict=True):
                setattr(s, name, value)
            body(s)
            return getattr(s, self.name)

        return call

    def instance(self) -> Instance:
        """A function block with a memory of its own."""
        return Instance(self)

    def statements(self, statements: tuple[object, ...], pad: str) -> list[str]:
        found = [line for each in statements for line in self.statement(each, pad)]
        return found or [f"{pad}pass"]

    def statement(self, node: object, pad: str) -> list[str]:
        inner = pad + "    "
        match node:
            case Assignment():
                return [f"{pad}{self.assignment(node.place, node.value)}"]
            case Choice():
                lines: list[str] = []
                for condition, statements in node.branches:
                    lines.append(f"{pad}{'elif' if lines else 'if'} {self.truth(condition)}:")
                    lines += self.statements(statements, inner)
                if node.otherwise is not None:
                    lines += [f"{pad}else:", *self.statements(node.otherwise, inner)]
                return lines
            case Repetition():
                return [f"{pad}while {self.truth(node.condition)}:", *self.statements(node.statements, inner)]
            case Counting():
                if self.types.get(node.name) not in INTEGERS:
                    raise IllegalTextError(f"{node.name} cannot count")
                ends = [self.expression(each, "DINT")[0] for each in (node.first, node.last)]
                return [
                    f"{pad}for s.{node.name} in range({ends[0]}, {ends[1]} + 1):",
                    *self.statements(node.statements, inner),
                ]
            case BlockCall():
                return [f"{pad}{self.invocation(node)}"]
        raise IllegalTextError(f"{type(node).__name__} is not known")

    def invocation(self, node: BlockCall) -> str:
        """A call of an instance of a function block."""
        block = self.owner.blocks.get(self.types.get(node.name, ""))
        if block is None:
            raise IllegalTextError(f"{node.name} cannot be called")
        given: list[str] = []
        for wanted, value in node.inputs:
            if wanted not in block.inputs:
                raise IllegalTextError(f"{block.name} has no input {wanted}")
            text, kind = self.expression(value, block.types[wanted])
            self.same(kind, block.types[wanted])
            given.append(f"{wanted}={text}")
        return f"s.{node.name}.call({', '.join(given)})"

    def assignment(self, target: Place, value: object) -> str:
        text, kind = self.place(target)
        root_name = text.split(".")[1].split("[")[0]
        if root_name in self.inputs or root_name in self.constants:
            raise IllegalTextError(f"{root_name} is assigned to, but is an input or a constant")
        expression, found = self.expression(value, kind)
        self.same(found, kind)
        copied = kind in self.owner.structs or isinstance(kind, tuple)
        return f"{text} = {expression}.copy()" if copied else f"{text} = {expression}"

    def same(self, found: Any, wanted: Any) -> None:
        if found != wanted and not (found == "ANY_REAL" and wanted in REALS):
            raise IllegalTextError(f"{self.name}: {found} where {wanted} is needed")

    def truth(self, node: object) -> str:
        text, kind = self.expression(node, "BOOL")
        self.same(kind, "BOOL")
        return text

    def place(self, node: Place) -> tuple[str, Any]:
        """A variable, a field of a structure or an element of an array."""
        if node.name not in self.types:
            raise IllegalTextError(f"{self.name}: {node.name} is not declared")
        text, kind = f"s.{node.name}", self.types[node.name]
        for form, part in node.parts:
            text, kind = self._field(text, kind, str(part)) if form == "field" else self._element(text, kind, part)
        return text, kind

    def _field(self, text: str, kind: Any, name: str) -> tuple[str, Any]:
        if kind in self.owner.blocks:
            block = self.owner.blocks[kind]
            if name not in (*block.inputs, *block.outputs):
                raise IllegalTextError(f"{kind} shows no {name}")
            return f"{text}.s.{name}", block.types[name]
        if kind not in self.owner.structs or name not in self.owner.structs[kind]:
            raise IllegalTextError(f"{kind} has no {name}")
        return f"{text}.{name}", self.owner.structs[kind][name][0]

    def _element(self, text: str, kind: Any, index: object) -> tuple[str, Any]:
        if not isinstance(kind, tuple):
            raise IllegalTextError(f"{kind} has no elements")
        place, found = self.expression(index, "DINT")
        self.same(found, "DINT")
        return f"{text}[{place} - {kind[1]}]", kind[3]

    def expression(self, node: object, wanted: Any) -> tuple[str, Any]:
        match node:
            case Literal(form="real"):
                value, kind = real(node)
                return repr(value), kind
            case Literal(form="integer"):
                if node.kind not in (None, *INTEGERS):
                    raise IllegalTextError(f"{node.kind}#{node.text} is no whole number")
                return node.text, node.kind or "DINT"
            case Literal():
                return ("True" if node.text == "TRUE" else "False"), "BOOL"
            case Unary():
                text, kind = self.expression(node.value, wanted)
                if node.op == "NOT":
                    self.same(kind, "BOOL")
                    return f"(not {text})", "BOOL"
                if kind in (*REALS, *INTEGERS, "ANY_REAL"):
                    return f"(-{text})", kind
                raise IllegalTextError(f"{node.op} of {kind}")
            case Binary():
                return self.binary(node, wanted)
            case FunctionCall():
                return self.call(node)
            case Place():
                return self.place(node)
        raise IllegalTextError(f"{type(node).__name__} is not known")

    def binary(self, node: Binary, wanted: Any) -> tuple[str, Any]:
        op = node.op
        left, a = self.expression(node.left, wanted)
        right, b = self.expression(node.right, wanted)
        if op in ("AND", "OR"):
            self.same(a, "BOOL")
            self.same(b, "BOOL")
            return f"({left} {'&' if op == 'AND' else '|'} {right})", "BOOL"
        kind = b if a == "ANY_REAL" else a
        for each in (a, b):
            self.same(each, kind)
        if kind == "ANY_REAL":
            kind = wanted if wanted in REALS else "LREAL"
        if op in COMPARISONS:
            if kind not in (*REALS, *INTEGERS) and not (kind == "BOOL" and op in ("=", "<>")):
                raise IllegalTextError(f"{kind} {op} {kind}")
            return f"({left} {COMPARISONS[op]} {right})", "BOOL"
        if kind in INTEGERS:
            if op == "/":
                return f"truncated({left}, {right})", kind
            if op in ("+", "-", "*", "MOD"):
                return f"({left} {'%' if op == 'MOD' else op} {right})", kind
        if kind in REALS and op in ARITHMETIC:
            return f"{kind}_{ARITHMETIC[op]}({left}, {right})", kind
        raise IllegalTextError(f"{op} of {kind}")

    def call(self, node: FunctionCall) -> tuple[str, Any]:
        name = node.name
        values = [self.expression(each, None) for each in node.arguments]
        if name in self.owner.functions:
            _, wanted, result = self.owner.functions[name]
            for (_, found), (_, each) in zip(values, wanted, strict=True):
                self.same(found, each)
            return f"call_{name}({', '.join(text for text, _ in values)})", result
        (text, kind), *_ = values
        if len(values) == 1 and name in ("ABS", "SQRT") and kind in REALS:
            return (f"abs({text})" if name == "ABS" else f"{kind}_sqrt({text})"), kind
        for source in REALS:
            if name in (f"{source}_TO_INT", f"{source}_TO_DINT") and kind == source:
                made = name.removeprefix(f"{source}_TO_")
                return f"to_integer({text}, {made!r})", made
        if name == "LREAL_TO_REAL" and kind == "LREAL":
            return f"REAL({text})", "REAL"
        if name == "REAL_TO_LREAL" and kind == "REAL":
            return text, "LREAL"
        raise IllegalTextError(f"{self.name}: there is no {name} of {kind}")


class Instance:
    """A function block that runs; its variables are attributes of `s`."""

    def __init__(self, unit: Unit) -> None:
        self.unit = unit
        self.s = unit.fresh()
        self._body = unit.body()

    def copy(self) -> Instance:
        raise IllegalTextError("an instance is no value")

    def call(self, **inputs: Any) -> Struct:
        """One cycle. Inputs that are not given keep their values."""
        for name, value in inputs.items():
            if name not in self.unit.inputs:
                raise IllegalTextError(f"{self.unit.name} has no input {name}")
            if self.unit.types[name] == "REAL":
                value = short(value)
            setattr(self.s, name, value.copy() if isinstance(value, Struct | list) else value)
        self._body(self.s)
        return self.s
