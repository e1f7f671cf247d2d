"""A small, strict machine for Structured Text: blark reads it, Python runs it.

Stricter than a PLC: a name that is not declared, declared twice or written in another case, a number of the wrong type,
a mixture of reals and integers, a plain literal that a short real would round, a variable that is read before it was
written, an assignment to an input or a constant: each raises `IllegalTextError`.
Reals are IEEE 754 numbers, every operation rounded by itself.  With `flush`, numbers below the normal ones are zero.
"""

from __future__ import annotations

import re
from typing import Any

from blark import transform as ast
from blark.parse import parse_source_code
from structured_text_values import (
    INTEGERS,
    REALS,
    IllegalTextError,
    Struct,
    checked_name,
    divide,
    elements,
    entry,
    flushed,
    initial,
    real,
    root,
    short,
    short_flushed,
    to_integer,
    truncated,
)  # fmt: skip

ARITHMETIC = {"+": "add", "-": "sub", "*": "mul", "/": "div"}
COMPARISONS = {"<": "<", "<=": "<=", ">": ">", ">=": ">=", "=": "==", "<>": "!="}


def program(text: str, flush: bool = True) -> Program:
    """Read a source text.

    blark takes hours for a long row of first values: rows are taken out, and read by `entry`.
    """
    rows: list[list[str]] = []

    def taken_out(found: re.Match[str]) -> str:
        rows.append(re.split(r",\s+", found[1]))
        return f":= [{len(rows) - 1}.0];"

    text = re.sub(r":= \[([^\[\]]+)\];", taken_out, text)
    return Program(parse_source_code(text).transform(), flush, rows)


class Program:
    """All types, functions and function blocks of a source text."""

    def __init__(self, source: Any, flush: bool, rows: list[list[str]]) -> None:
        self.rows = rows
        self.structs: dict[str, dict[str, tuple[Any, Any]]] = {}
        self.functions: dict[str, tuple[Any, list[tuple[str, Any]], str]] = {}
        self.blocks: dict[str, Unit] = {}
        self.flush = flush
        self.names: set[str] = set()
        for item in source.items:
            match item:
                case ast.DataTypeDeclaration():
                    self._struct(item.declaration)
                case ast.Function():
                    unit = Unit(self, item, str(item.return_type.type.type))
                    self.claim(str(item.name))
                    given = [(name, unit.types[name]) for name in unit.inputs]
                    self.functions[str(item.name)] = (unit.compiled(), given, unit.result)  # known to those behind it
                case ast.FunctionBlock() | ast.Program():
                    self.claim(str(item.name))
                    self.blocks[str(item.name)] = Unit(self, item, "")
                case _:
                    raise IllegalTextError(f"{type(item).__name__} is not known")

    def claim(self, name: str) -> None:
        """A name of the outermost level."""
        checked_name(name, self.names)

    def _struct(self, declaration: Any) -> None:
        if not isinstance(declaration, ast.StructureTypeDeclaration):
            raise IllegalTextError(f"{type(declaration).__name__} is not known")
        self.claim(str(declaration.name))
        taken: set[str] = set()
        found: dict[str, tuple[Any, Any]] = {}
        for element in declaration.declarations:
            for variable in element.variables:
                name = str(variable.variable.name)
                checked_name(name, taken)
                kind = str(element.init.spec.type)
                found[name] = (kind, initial(kind, element.init.value))
        self.structs[str(declaration.name)] = found

    def value(self, kind: Any, given: Any) -> Any:
        """The first value of a variable; None for a number that was given none: reading it raises."""
        if kind in self.structs:
            return Struct({name: value for name, (_, value) in self.structs[kind].items()})
        if kind in self.blocks:
            return self.blocks[kind].instance()
        return list(given) if isinstance(given, list) else given


class Unit:
    """A function or a function block, compiled to Python."""

    def __init__(self, owner: Program, item: Any, result: str) -> None:
        self.owner, self.item, self.result = owner, item, result
        self.name = str(item.name)
        self.types: dict[str, Any] = {}
        self.first: dict[str, Any] = {}
        self.inputs: list[str] = []
        self.outputs: list[str] = []
        self.constants: set[str] = set()
        taken: set[str] = set()
        for block in item.declarations:
            self._declare(block, taken)
        if result:
            checked_name(self.name, taken)
            self.types[self.name] = result
        lines = self.statements(item.body, "    ") if item.body is not None else ["    pass"]
        self.python = "\n".join([f"def body(s):  # {self.name}", *lines])

    def _declare(self, block: Any, taken: set[str]) -> None:
        where = type(block).__name__
        if where not in (
            "InputDeclarations", "OutputDeclarations", "VariableDeclarations", "FunctionVariableDeclarations"
        ):  # fmt: skip
            raise IllegalTextError(f"{where} is not known")
        for item in block.items:
            kind, value = self._type(item)
            for variable in item.variables:
                name = str(getattr(variable, "variable", variable).name)
                checked_name(name, taken)
                self.types[name] = kind
                self.first[name] = value
                if where == "InputDeclarations":
                    self.inputs.append(name)
                if where == "OutputDeclarations":
                    self.outputs.append(name)
                if block.attrs is not None and "constant" in str(block.attrs):
                    self.constants.add(name)

    def _type(self, item: Any) -> tuple[Any, Any]:
        init = item.init
        spec = init.spec
        if isinstance(spec, ast.ArraySpecification):
            (bounds,) = spec.subranges
            low, high = int(bounds.start.value), int(bounds.stop.value)
            kind = ("ARRAY", low, high, str(spec.type.type_name))
            if init.value is None:
                return kind, [0.0] * (high - low + 1)
            (place,) = [int(float(each.value)) for each in elements(init.value)]
            values = [entry(text, kind[3]) for text in self.owner.rows[place]]
            if len(values) != high - low + 1:
                raise IllegalTextError(f"{len(values)} numbers for an array of {high - low + 1}")
            return kind, values
        kind = str(spec.type)
        known = {*REALS, *INTEGERS, "BOOL", *self.owner.structs, *self.owner.blocks}
        if kind not in known:
            raise IllegalTextError(f"{kind} is no type")
        return kind, initial(kind, getattr(init, "value", None))

    def fresh(self) -> Struct:
        """All variables with their first values."""
        return Struct({name: self.owner.value(kind, self.first.get(name)) for name, kind in self.types.items()})

    def body(self) -> Any:
        """The Python function."""
        z, z32 = (flushed, short_flushed) if self.owner.flush else (float, short)
        scope: dict[str, Any] = {
            "LREAL_add": lambda a, b: z(a + b), "LREAL_sub": lambda a, b: z(a - b), "LREAL_mul": lambda a, b: z(a * b),
            "LREAL_div": lambda a, b: z(divide(a, b)), "LREAL_sqrt": lambda a: z(root(a)),
            "REAL_add": lambda a, b: z32(a + b), "REAL_sub": lambda a, b: z32(a - b),
            "REAL_mul": lambda a, b: z32(a * b), "REAL_div": lambda a, b: z32(divide(a, b)),
            "REAL_sqrt": lambda a: z32(root(a)), "REAL": z32,
            "to_integer": to_integer, "truncated": truncated,
        }  # fmt: skip
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

    def statements(self, block: Any, pad: str) -> list[str]:
        found = [line for each in block.statements for line in self.statement(each, pad)]
        return found or [f"{pad}pass"]

    def statement(self, node: Any, pad: str) -> list[str]:
        match node:
            case ast.AssignmentStatement():
                (target,) = node.variables
                return [f"{pad}{self.assignment(target, node.expression)}"]
            case ast.IfStatement():
                lines = [f"{pad}if {self.truth(node.if_expression)}:", *self.statements(node.statements, pad + "    ")]
                for clause in node.else_ifs:
                    lines += [f"{pad}elif {self.truth(clause.if_expression)}:"]
                    lines += self.statements(clause.statements, pad + "    ")
                if node.else_clause is not None:
                    lines += [f"{pad}else:", *self.statements(node.else_clause.statements, pad + "    ")]
                return lines
            case ast.WhileStatement():
                return [f"{pad}while {self.truth(node.expression)}:", *self.statements(node.statements, pad + "    ")]
            case ast.ForStatement():
                name = str(node.control.name)
                if self.types.get(name) not in INTEGERS:
                    raise IllegalTextError(f"{name} cannot count")
                ends = [self.expression(each, "DINT")[0] for each in (node.from_, node.to)]
                return [
                    f"{pad}for s.{name} in range({ends[0]}, {ends[1]} + 1):",
                    *self.statements(node.statements, pad + "    "),
                ]
            case ast.FunctionCallStatement():
                return [f"{pad}{self.invocation(node)}"]
        raise IllegalTextError(f"{type(node).__name__} is not known")

    def invocation(self, node: Any) -> str:
        """A call of an instance of a function block."""
        name = str(node.name.name)
        block = self.owner.blocks.get(self.types.get(name, ""))
        if block is None:
            raise IllegalTextError(f"{name} cannot be called")
        given: list[str] = []
        for each in node.parameters:
            wanted = str(each.name.name)
            if wanted not in block.inputs:
                raise IllegalTextError(f"{block.name} has no input {wanted}")
            text, kind = self.expression(each.value, block.types[wanted])
            self.same(kind, block.types[wanted])
            given.append(f"{wanted}={text}")
        return f"s.{name}.call({', '.join(given)})"

    def assignment(self, target: Any, value: Any) -> str:
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

    def truth(self, node: Any) -> str:
        text, kind = self.expression(node, "BOOL")
        self.same(kind, "BOOL")
        return text

    def place(self, node: Any) -> tuple[str, Any]:
        """A variable, a field of a structure or an element of an array."""
        if isinstance(node, ast.SimpleVariable):
            name = str(node.name)
            if name not in self.types:
                raise IllegalTextError(f"{self.name}: {name} is not declared")
            return f"s.{name}", self.types[name]
        if isinstance(node, ast.MultiElementVariable):
            text, kind = self.place(node.name)
            for element in node.elements:
                text, kind = self._element(text, kind, element)
            return text, kind
        raise IllegalTextError(f"{type(node).__name__} is no variable")

    def _element(self, text: str, kind: Any, element: Any) -> tuple[str, Any]:
        if isinstance(element, ast.FieldSelector):
            name = str(element.field.name)
            if kind in self.owner.blocks:
                block = self.owner.blocks[kind]
                if name not in (*block.inputs, *block.outputs):
                    raise IllegalTextError(f"{kind} shows no {name}")
                return f"{text}.s.{name}", block.types[name]
            if kind not in self.owner.structs or name not in self.owner.structs[kind]:
                raise IllegalTextError(f"{kind} has no {name}")
            return f"{text}.{name}", self.owner.structs[kind][name][0]
        if isinstance(element, ast.SubscriptList) and isinstance(kind, tuple):
            (index,) = element.subscripts
            place, found = self.expression(index, "DINT")
            self.same(found, "DINT")
            return f"{text}[{place} - {kind[1]}]", kind[3]
        raise IllegalTextError(f"{kind} has no elements")

    def expression(self, node: Any, wanted: Any) -> tuple[str, Any]:
        match node:
            case ast.ParenthesizedExpression():
                return self.expression(node.expr, wanted)
            case ast.Real():
                value, kind = real(node)
                return repr(value), kind
            case ast.Integer():
                return str(int(node.value)), str(node.type_name) if node.type_name else "DINT"
            case ast.Boolean():
                return ("True" if str(node.value).upper() == "TRUE" else "False"), "BOOL"
            case ast.UnaryOperation():
                text, kind = self.expression(node.expr, wanted)
                if str(node.op).upper() == "NOT":
                    self.same(kind, "BOOL")
                    return f"(not {text})", "BOOL"
                if str(node.op) == "-" and (kind in (*REALS, *INTEGERS, "ANY_REAL")):
                    return f"(-{text})", kind
                raise IllegalTextError(f"{node.op} of {kind}")
            case ast.BinaryOperation():
                return self.binary(node, wanted)
            case ast.FunctionCall():
                return self.call(node)
        return self.place(node)

    def binary(self, node: Any, wanted: Any) -> tuple[str, Any]:
        op = str(node.op).upper()
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

    def call(self, node: Any) -> tuple[str, Any]:
        name = str(node.name.name)
        values = [self.expression(each.value, None) for each in node.parameters]
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
            setattr(self.s, name, value.copy() if isinstance(value, Struct) else value)
        self._body(self.s)
        return self.s
