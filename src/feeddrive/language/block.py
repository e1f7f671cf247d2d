"""Blocks: immutable sets of declared parameters with a pure `step` function.

Each parameter is declared once, in its field; the constructor check, the file reader, the docs, the report and the
exported code take name, unit, meaning, bounds and default from this declaration. Requests of commands
(`workflow/command.py`) and sections of files (`files/section.py`) declare their fields in the same way; `Declared` is
the common base class.

    class Viscous(Friction):
        \"\"\"Viscous friction.  force = -viscous · velocity\"\"\"
        viscous: Number = parameter("N s/m", "viscous friction", least=0)

A field is one of
    parameter()  a leaf: a number that may vary from run to run, be tuned and be differentiated
    choice()     a count, a name or a flag that changes the graph; a new value requires a new trace
    table()      a row of numbers read by `ops.gather`; its length changes the graph
    part()       a nested block, a tuple of blocks, or None
    label()      a string that names the block; it has no effect on the graph
A block class is either abstract or final: except for defaults such as `check`, no method with a body is overridden.
"""

import dataclasses
import math
import re
import sys
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import MISSING, dataclass, field, replace
from functools import cache, wraps
from itertools import islice
from typing import Any, ClassVar, NamedTuple, Self, TypeAlias, dataclass_transform

import numpy as np

from feeddrive.language import units
from feeddrive.language.errors import ParameterError, StructureError, nearest
from feeddrive.language.graph import Symbol
from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.table import UNIT, Cell, Column, Table
from feeddrive.language.text import Text, joined

# "finite" is two comparisons with it, since symbols and targets have no isfinite
LARGEST = sys.float_info.max


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """The declaration of a field; `above`/`below` are exclusive bounds, `least`/`most` inclusive ones.

    infinite   True if an infinite value is allowed
    shortest   minimum number of entries of a table, or of named sections
    inline     True if the fields of this part appear among those of the block or section that contains it
    alike      True if the blocks of this tuple differ in numbers only
    example    example of a value in file syntax, for messages and documentation
    pattern    regular expression that the names of sections or values must match
    """

    role: str
    unit: str
    meaning: str
    above: float | None = None
    least: float | None = None
    below: float | None = None
    most: float | None = None
    options: tuple[Any, ...] = ()
    infinite: bool = False
    shortest: int = 0
    inline: bool = False
    alike: bool = False
    example: str = ""
    pattern: str = ""

    def of_axis(self, rotary: bool) -> Self:
        """Return the declaration with rotary units (rad, N m, kg m2) if the axis is rotary, otherwise unchanged."""
        return replace(self, unit=units.turning(self.unit)) if rotary else self

    def bounds(self) -> Text:
        """Return the bounds as text, such as `> 0 kg and <= 5 kg`; empty if there are none."""
        signs = (("> ", self.above), (">= ", self.least), ("< ", self.below), ("<= ", self.most))
        return joined(
            " and ", (f"{sign}{Quantity(bound, self.unit):6 SI}" for sign, bound in signs if bound is not None)
        )

    def conditions(self, value: Any) -> Iterator[Any]:
        """Yield the conditions on a number or symbol: within its bounds and, unless declared otherwise, finite."""
        # a NaN fails any comparison: no test for it is needed, on a target either
        yield value >= (-math.inf if self.infinite else -LARGEST)
        yield value <= (math.inf if self.infinite else LARGEST)
        if self.above is not None:
            yield value > self.above
        if self.least is not None:
            yield value >= self.least
        if self.below is not None:
            yield value < self.below
        if self.most is not None:
            yield value <= self.most

    def admits(self, value: float) -> bool:
        """Return True if a value is within the declared bounds and, unless declared otherwise, finite."""
        return all(self.conditions(value))


def check_bounds(where: str, declaration: Declaration, number: float) -> None:
    """Raise ParameterError for a number that is outside its bounds or, unless declared otherwise, not finite."""
    shown = f"{where} = {Quantity(number, declaration.unit):6 SI}"
    if math.isnan(number) or (math.isinf(number) and not declaration.infinite):
        raise ParameterError(f"{shown} ({declaration.meaning}) must be a finite number")
    if not declaration.admits(number):
        raise ParameterError(f"{shown} ({declaration.meaning}) must be {declaration.bounds()}")


def check_choice(where: str, declaration: Declaration, value: Any) -> None:
    """Raise ParameterError for a value that is not one of the options, or not a whole number within the bounds."""
    if declaration.options and value not in declaration.options:
        allowed = ", ".join(repr(option) for option in declaration.options)
        raise ParameterError(f"{where} = {value!r} ({declaration.meaning}) must be one of {allowed}")
    if declaration.least is not None:
        # bool is a subclass of int: True would pass as 1
        if isinstance(value, bool) or not isinstance(value, int):
            raise ParameterError(f"{where} = {value!r} ({declaration.meaning}) must be a whole number")
        if value < declaration.least:
            raise ParameterError(
                f"{where} = {value} ({declaration.meaning}) must be >= {Quantity(declaration.least):6}"
            )
    if declaration.most is not None and value > declaration.most:
        raise ParameterError(f"{where} = {value} ({declaration.meaning}) must be <= {Quantity(declaration.most):6}")


class Declared:
    """The base class of frozen dataclasses with declared fields: blocks, requests, sections of files.

    The constructor checks each field against its declaration and then calls `check`, which checks that the fields are
    consistent with each other.
    """

    def __post_init__(self) -> None:
        for name, declaration in declarations(type(self)).items():
            object.__setattr__(self, name, self._checked(name, declaration, getattr(self, name)))
        self.require()

    @abstractmethod
    def _checked(self, name: str, declaration: Declaration, value: Any) -> Any:
        """Return the checked and converted value of a field. Raise ParameterError if it violates its declaration."""

    def check(self) -> None:
        """Raise an error if fields are inconsistent with each other; the default does nothing."""

    def require(self) -> None:
        """Check the fields against each other; raise the first error."""
        self.check()


@cache
def declarations(kind: type[Declared]) -> dict[str, Declaration]:
    """Return the declarations of the fields by name, in class order; callers must not modify the result."""
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]
    return {spec.name: spec.metadata["declaration"] for spec in fields}


@cache
def defaults(kind: type[Declared]) -> dict[str, Any]:
    """Return the defaults, by name, of the fields that have one; callers must not modify the result."""
    values: dict[str, Any] = {}
    for spec in dataclasses.fields(kind):  # type: ignore[arg-type]
        if spec.default is not dataclasses.MISSING:
            values[spec.name] = spec.default
        elif spec.default_factory is not dataclasses.MISSING:
            values[spec.name] = spec.default_factory()
    return values


_EXACT = "12 SI"  # digits and unit for the display of a parameter
# A number in a law: float in a single run, array over lanes in the reference, Symbol in a trace.
Number: TypeAlias = float


class Rule(NamedTuple):
    """A condition on the parameters of a block, written in arithmetic that works on both numbers and symbols.

    The constructor checks it, and exported code evaluates it on the target.

    holds     the truth value of the condition
    sentence  the rule in words, for a user who looks up the rejection code
    refusal   returns the error message of the constructor: the values and the remedy
    """

    holds: Any
    sentence: str
    refusal: Callable[[], str]


def parameter(
    unit: str,
    meaning: str,
    *,
    default: float | object | None = MISSING,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    infinite: bool = False,
) -> Any:
    """Declare a leaf. A leaf whose default is None is absent until it is set; setting it changes the graph.

    infinite   True if the value may be infinite, for example for a limit that never acts
    """
    declaration = Declaration(
        role="parameter",
        unit=unit,
        meaning=meaning,
        above=above,
        least=least,
        below=below,
        most=most,
        infinite=infinite,
    )
    return field(default=default, metadata={"declaration": declaration})  # type: ignore[call-overload]


def choice(
    meaning: str,
    *,
    options: tuple[Any, ...] = (),
    default: Any = MISSING,
    least: int | None = None,
    most: int | None = None,
) -> Any:
    """Declare a structural choice: one of `options`, or an integer from `least` to `most`."""
    declaration = Declaration(role="choice", unit="", meaning=meaning, options=options, least=least, most=most)
    return field(default=default, metadata={"declaration": declaration})


def table(
    unit: str,
    meaning: str,
    *,
    default: Any = MISSING,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    shortest: int = 2,
) -> Any:
    """Declare a table of at least `shortest` numbers, stored as a 1-D float64 array; each must be within the bounds."""
    declaration = Declaration(
        role="table", unit=unit, meaning=meaning, above=above, least=least, below=below, most=most, shortest=shortest
    )
    return field(default=default, metadata={"declaration": declaration})


def part(meaning: str, *, default: Any = MISSING, inline: bool = False, alike: bool = False) -> Any:
    """Declare a nested block, a tuple of blocks, or None for an absent part.

    The leaves of an inline part are named as if the fields of this part belonged to the enclosing block. The blocks of
    a tuple that is `alike` differ in numbers only; the enclosing block checks it.
    """
    declaration = Declaration(role="part", unit="", meaning=meaning, inline=inline, alike=alike)
    return field(default=default, metadata={"declaration": declaration})


def label(meaning: str, *, default: str) -> Any:
    """Declare a name for users and files. Blocks that differ only in a label have the same graph."""
    return field(default=default, metadata={"declaration": Declaration(role="label", unit="", meaning=meaning)})


def snake_case(name: str) -> str:
    """Convert `CascadePPI` to `cascade_ppi`: the name of a block in files, and of the module that defines it."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", "_", name).lower()


STRUCTURE = "_structure_and_values"
"""The attribute in which a block caches its structure, see `tree.structure_and_values`."""


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    eq_default=False,
    field_specifiers=(parameter, choice, table, part, label),
)
class Block(Declared):
    """The base class of all blocks. Subclasses become frozen, keyword-only dataclasses that validate their fields."""

    kind: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        cls.kind = snake_case(cls.__name__)
        # eq=False: parameters may be arrays, whose == is no truth value, and blocks are dictionary keys by identity
        dataclass(frozen=True, kw_only=True, eq=False, repr=False)(cls)
        cls.__init__ = _checking_names(cls, cls.__init__)
        for spec in dataclasses.fields(cls):  # type: ignore[arg-type]
            if "declaration" not in spec.metadata:
                raise StructureError(
                    f"{cls.__name__}.{spec.name} must be declared by parameter, choice, table, part or label"
                )

    def __getstate__(self) -> dict[str, Any]:
        # the structure contains classes created at run time, and a hash that is valid only in this process
        return {name: value for name, value in vars(self).items() if name != STRUCTURE}

    def _checked(self, name: str, declaration: Declaration, value: Any) -> Any:
        return checked(self.kind, name, declaration, value)

    def rules(self) -> Iterator[Rule]:
        """Yield the rules that the parameters must satisfy; by default there are none."""
        yield from ()

    def sampled_rules(self, T: Number) -> Iterator[Rule]:
        """Yield the rules that depend on the sample time T in s; by default there are none."""
        yield from ()

    def require(self) -> None:
        """Raise the error of `check`, or ParameterError for the first violated rule."""
        self.check()
        # a block without rules is spared the copy that `enforce` makes
        if type(self).rules is not Block.rules:
            enforce(self, lambda block: block.rules())

    def place_of(self, field: str) -> str:
        """Return the path segment of a field. It is the field's name; a loop overrides this."""
        return field

    def __repr__(self) -> str:
        if any(True for _ in _parts(self)):
            columns = ["part", "kind", Column("parameters", sentences=True)]
            return str(Table(type(self).__name__, columns, _lines(self, "")))
        shown = ", ".join(f"{name}={getattr(self, name)!r}" for name in declarations(type(self)))
        return f"{type(self).__name__}({shown})"

    def table(self) -> Table:
        """Return a table of all present parameters, including those of parts: path, value, unit, bounds and meaning."""
        columns = ["parameter", "value", "unit", "bounds", Column("meaning", sentences=True)]
        return Table(type(self).__name__, columns, _parameters(self, ""))

    def _repr_html_(self) -> str:
        return self.table().html()


def _parts(block: Block) -> Iterator[tuple[str, Block]]:
    """Yield the name and value of each direct part of a block."""
    for name, declared in declarations(type(block)).items():
        value = getattr(block, name)
        if declared.role == "part" and value is not None:
            place = block.place_of(name)
            if isinstance(value, tuple):
                held: tuple[Block, ...] = value
                names = getattr(held, "_fields", None) or map(str, range(len(held)))
                yield from ((f"{place}.{index}", item) for index, item in zip(names, held, strict=True))
            else:
                yield place, value


def _lines(block: Block, place: str) -> list[list[Cell]]:
    """Return one table row per block, with its path, its kind, and its parameters with units."""
    parameters = [
        f"{name} {_text(getattr(block, name), declared.unit)}"
        for name, declared in declarations(type(block)).items()
        if declared.role != "part" and getattr(block, name) is not None
    ]
    rows = [[place or "-", block.kind, joined(", ", parameters)]] if parameters or place else []
    for name, part in _parts(block):
        rows += _lines(part, f"{place}.{name}" if place else name)
    return rows


def _parameters(block: Block, place: str) -> list[list[Cell]]:
    rows = [
        [
            f"{place}.{name}" if place else name,
            *_cells(getattr(block, name), declared.unit),
            declared.bounds() or ", ".join(map(str, declared.options)),
            declared.meaning,
        ]
        for name, declared in declarations(type(block)).items()
        if declared.role != "part" and getattr(block, name) is not None
    ]
    for name, part in _parts(block):
        rows += _parameters(part, f"{place}.{name}" if place else name)
    return rows


def _cells(value: Any, unit: str) -> tuple[Cell, Cell]:
    """Return two table cells: the value and its unit."""
    if isinstance(value, float):
        return Quantity(value, unit, form=_EXACT), UNIT
    return _text(value, ""), unit_name(unit, "SI") if unit else ""


def _text(value: Any, unit: str) -> str:
    if isinstance(value, np.ndarray):
        ends = [Quantity(end, form="6 SI") for end in (np.min(value), np.max(value))] if value.size else []
        text = f"[{value.size} values, {ends[0]} .. {ends[1]}]" if ends else "[]"
        return Text(f"{text} {unit_name(unit, 'SI')}" if unit else text)
    return Text(f"{Quantity(value, unit, form=_EXACT)}") if isinstance(value, float) else str(value)


def _checking_names(cls: type[Block], make: Callable[..., None]) -> Callable[..., None]:
    """Wrap a constructor so that its error messages for wrong or missing arguments name the parameters."""

    @wraps(make)
    def construct(self: Any, *args: Any, **values: Any) -> None:
        try:
            make(self, *args, **values)
        # Python's message counts positions of `__init__`; a user knows the names of parameters
        except TypeError:
            declared = declarations(cls)
            wrong = [name for name in values if name not in declared]
            fields = dataclasses.fields(cls)  # type: ignore[arg-type]
            needed = [spec.name for spec in fields if spec.default is MISSING and spec.name not in values]
            if args:
                raise ParameterError(f"{cls.__name__} takes its parameters by name: {', '.join(declared)}") from None
            if wrong:
                raise ParameterError(
                    f"{cls.__name__} has no parameter '{wrong[0]}'{nearest(wrong[0], declared)}"
                ) from None
            if needed:
                raise ParameterError(
                    f"{cls.__name__} needs {', '.join(f'{name} ({declared[name].meaning})' for name in needed)}"
                ) from None
            # the arguments are right: the error was raised inside the constructor
            raise

    return construct


def enforce(block: Block, rules: Callable[[Any], Iterable[Rule]]) -> None:
    """Raise ParameterError for the first rule that a block violates, naming the first variant that violates it.

    The rules are evaluated as on a target, where a division by zero gives infinity instead of an error.  In a trace,
    the parameters are symbols: the rules become conditions on the target and are not checked here.
    """
    plain = _plain(block)
    if plain is None:
        return
    with np.errstate(all="ignore"):
        for place, rule in enumerate(rules(plain)):
            if isinstance(rule.holds, np.ndarray):
                broken = np.flatnonzero(~rule.holds)
                if broken.size:
                    variant = int(broken[0])
                    # the rules once more for this variant alone: a refusal shows single numbers
                    refusal = next(islice(rules(_plain(block, variant)), place, None)).refusal()
                    raise ParameterError(
                        f"variant {variant} of 0 .. {rule.holds.size - 1}, {broken.size} of which break this rule: "
                        f"{refusal}"
                    )
            elif not rule.holds:
                raise ParameterError(rule.refusal())


def _plain(block: Block, variant: int | None = None) -> Block | None:
    """Copy a block with parameters converted to NumPy numbers, for one or all variants; None if one is a symbol."""
    # not the constructor, which enforces the rules and would end up here again
    plain = object.__new__(type(block))
    for name, declared in declarations(type(block)).items():
        value = getattr(block, name)
        if value is not None and declared.role == "parameter":
            if isinstance(value, np.ndarray):
                value = value if variant is None else np.float64(value[variant])
            elif isinstance(value, float):
                value = np.float64(value)
            else:
                return None
        elif value is not None and declared.role == "part":
            items = value if isinstance(value, tuple) else (value,)
            # an absent part keeps its place: the index of the others is part of their path
            parts = [None if item is None else _plain(item, variant) for item in items]
            if any(part is None and item is not None for part, item in zip(parts, items, strict=True)):
                return None
            if isinstance(value, tuple):
                made_of: Any = type(value)
                value = made_of(*parts) if hasattr(value, "_fields") else tuple(parts)
            else:
                value = parts[0]
        object.__setattr__(plain, name, value)
    return plain


def checked(kind: str, name: str, declaration: Declaration, value: Any) -> Any:
    """Return the checked and converted value of a field.

    Raises a ParameterError whose message names block, parameter, value, bound and unit.
    """
    where = f"{kind}.{name}" if kind else name
    match declaration.role:
        case "parameter":
            return None if value is None else _checked_number(where, declaration, value)
        case "choice":
            check_choice(where, declaration, value)
            return value
        case "table":
            return None if value is None else _checked_table(where, declaration, value)
        case "label":
            if not isinstance(value, str) or not value:
                raise ParameterError(f"{where} ({declaration.meaning}) must be a text, not {value!r}")
            return value
        case _:
            parts = value if isinstance(value, tuple) else (value,)
            for item in parts:
                if item is not None and not isinstance(item, Declared):
                    raise ParameterError(f"{where} must be a block ({declaration.meaning}), not {item!r}")
            return value


def _checked_number(where: str, declaration: Declaration, value: Any) -> Any:
    # a trace has no values: its bounds become conditions of the routine, which targets test
    if isinstance(value, Symbol):
        return value
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in "fiu":
            raise ParameterError(f"{where} ({declaration.meaning}) must be numbers, not {value.dtype}")
        lanes = value.astype(np.float64)
        kept = np.logical_and.reduce(list(declaration.conditions(lanes)))
        for item in lanes[~kept][:1]:  # the first rejected value
            check_bounds(where, declaration, float(item))
        return lanes
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        raise ParameterError(f"{where} ({declaration.meaning}) must be a number, not {value!r}")
    number = float(value)
    check_bounds(where, declaration, number)
    return number


def _checked_table(where: str, declaration: Declaration, value: Any) -> np.ndarray:
    row = np.array(value, dtype=np.float64)
    if row.ndim != 1 or row.size < declaration.shortest:
        least = {1: "one number", 2: "two numbers"}.get(declaration.shortest, f"{declaration.shortest} numbers")
        raise ParameterError(f"{where} ({declaration.meaning}) must be a row of at least {least}")
    if not np.all(np.isfinite(row)):
        raise ParameterError(f"{where} ({declaration.meaning}) holds a number that is not finite")
    if declaration.bounds():
        for i, number in enumerate(row.tolist()):
            check_bounds(f"{where}[{i}]", declaration, number)
    # a block is a value: numpy would let a caller change its row
    row.flags.writeable = False
    return row


def check_tree(tree: Any) -> None:
    """Raise ParameterError if the argument is the content of a job or study file instead of a loop or a block."""
    if getattr(tree, "instead", ""):
        raise ParameterError(f"a loop or a block has parameters, not a {type(tree).__name__}: {tree.instead}")
