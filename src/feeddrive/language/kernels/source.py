"""The source of a kernel: the text of a Python function, the types of its annotations, its names, and its arrays.

In the interpreter, the cells of an array are returned as Python numbers, and its rows as views or records.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import linecache
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import islice
from types import FunctionType, ModuleType
from typing import (
    Annotated,
    Any,
    NamedTuple,
    NoReturn,
    Protocol,
    TypeAlias,
    TypeGuard,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

import numpy as np
from numpy.typing import NDArray

from feeddrive.language.errors import FeeddriveError

# Arrays in C order, with one, two and three indices.
Floats: TypeAlias = Annotated[NDArray[np.float64], 1]
Floats2: TypeAlias = Annotated[NDArray[np.float64], 2]
Floats3: TypeAlias = Annotated[NDArray[np.float64], 3]
Ints: TypeAlias = Annotated[NDArray[np.int64], 1]

_LLVM = {"float": "double", "int": "i64", "bool": "i1", "record": "double"}
_Record = TypeVar("_Record")


class Records(Protocol[_Record]):
    """An array of records: a two-dimensional float64 array, whose rows are records and whose columns are fields.

    `Records[Stretch]` annotates a parameter or a field.  Python callers pass a NumPy array.
    """

    def __getitem__(self, place: int, /) -> _Record: ...
    def __setitem__(self, place: int, record: _Record, /) -> None: ...
    def __len__(self) -> int: ...


class Records2(Protocol[_Record]):
    """A two-dimensional array of records: a three-dimensional float64 array whose last axis holds the fields."""

    @overload
    def __getitem__(self, place: int, /) -> Records[_Record]: ...
    @overload
    def __getitem__(self, place: tuple[int, int], /) -> _Record: ...
    def __setitem__(self, place: tuple[int, int], record: _Record, /) -> None: ...
    def __len__(self) -> int: ...


class KernelError(FeeddriveError):
    """A function with a construct outside the kernel language; the message gives file, line and replacement."""


class UnfitError(Exception):
    """A class that cannot be a kernel record; the arguments are the reason and the remedy."""


class Type(NamedTuple):
    """A number, a record, or an array of either with one to three indices."""

    element: str
    dimensions: int = 0
    layout: Layout | None = None

    def __str__(self) -> str:
        if self.layout:
            name = self.layout.name
            return f"Records{self.dimensions if self.dimensions > 1 else ''}[{name}]" if self.dimensions else name
        if not self.dimensions:
            return self.element
        return f"{self.element.capitalize()}s{self.dimensions if self.dimensions > 1 else ''}"

    @property
    def llvm(self) -> str:
        """The LLVM type of a number, or of the address of an array."""
        return "ptr" if self.dimensions else _LLVM[self.element]

    @property
    def cell(self) -> str:
        """The LLVM type of an array element."""
        return _LLVM[self.element]

    @property
    def width(self) -> int:
        """The number of columns that a record occupies in a row of an array; 1 for a number."""
        return self.layout.width if self.layout else 1

    def leaves(self, name: str) -> list[tuple[str, Type]]:
        """Return names and types of the numbers and arrays of a variable of this type; records are flattened."""
        if self.layout is None or self.dimensions:
            return [(name, self)]
        return [leaf for field, kind in self.layout.fields.items() for leaf in kind.leaves(f"{name}.{field}")]


@dataclass(frozen=True, eq=False, repr=False)
class Layout:
    """The fields of a record: a NamedTuple of numbers, arrays and other records."""

    python: Callable[..., Any]
    fields: dict[str, Type]
    defaults: dict[str, Any]
    width: int
    """The number of columns of a record in an array; 0 if a field is neither a float, a bool nor such a record."""

    @cached_property
    def records(self) -> tuple[tuple[str, Layout | None], ...]:
        """The names of the fields, with the layouts of those that are records."""
        return tuple((name, None if kind.dimensions else kind.layout) for name, kind in self.fields.items())

    @cached_property
    def flat(self) -> bool:
        """True if no field is a record."""
        return not any(layout for _, layout in self.records)

    @cached_property
    def floats(self) -> bool:
        """True if all fields are floats."""
        return all(kind == FLOAT for kind in self.fields.values())

    @property
    def name(self) -> str:
        """The name of its class."""
        return self.python.__name__

    def __repr__(self) -> str:
        return f"{self.name}({self.fields}, {self.defaults})"


FLOAT, INT, BOOL = Type("float"), Type("int"), Type("bool")
_TYPES: dict[object, Type] = {
    float: FLOAT,
    int: INT,
    bool: BOOL,
    Floats: Type("float", 1),
    Floats2: Type("float", 2),
    Floats3: Type("float", 3),
    Ints: Type("int", 1),
}
_INDICES: dict[object, int] = {Records: 1, Records2: 2}
_STARS = inspect.CO_VARARGS | inspect.CO_VARKEYWORDS
_KNOWN = "float, int, bool, Floats, Floats2, Floats3, Ints, a NamedTuple of these, or Records[of one]"


def is_record(value: object) -> TypeGuard[type]:
    """Return True if a value is a NamedTuple class."""
    return isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields")


@lru_cache(maxsize=1024)
def layout_of(record: type) -> Layout:
    """Return the layout of a NamedTuple. Raise UnfitError if a field has a type that kernels do not support."""
    try:
        hints = get_type_hints(record, include_extras=True)
    except Exception as error:
        # an annotation is evaluated here, and may raise anything
        raise UnfitError(f"the fields of '{record.__name__}' cannot be read ({error})", "define them above") from error
    fields = dict[str, Type]()
    for name, hint in hints.items():
        if record in (hint, *get_args(hint)):
            raise UnfitError(f"the record '{record.__name__}' holds itself", "keep the index of the other record")
        kind = type_of(hint)
        if kind is None:
            shown = getattr(hint, "__name__", hint)
            raise UnfitError(f"the field '{name}' of '{record.__name__}' is of type {shown}", f"write {_KNOWN}")
        fields[name] = kind
    fits = all(not kind.dimensions and kind != INT and kind.width for kind in fields.values())
    width = sum(kind.width for kind in fields.values()) if fits else 0
    return Layout(record, fields, dict(vars(record)["_field_defaults"]), width)


def described(value: object) -> str:
    """Return a description of a record type or constant record, for the cache key of machine code."""
    record, numbers = (value, "") if is_record(value) else (type(value), repr(value))
    try:
        return f"{layout_of(record)!r} {numbers}"
    except UnfitError as error:  # it is rejected where it is used
        return f"{error} {numbers}"


def type_of(hint: object) -> Type | None:
    """Return the kernel type of an annotation, or None. Raise UnfitError for a record with an unsupported field."""
    indices = _INDICES.get(get_origin(hint))
    (inner,) = get_args(hint) if indices else (hint,)
    if is_record(inner):
        layout = layout_of(inner)
        if indices and not layout.width:
            remedy = "keep whole numbers and arrays apart from the fields that a row holds"
            raise UnfitError(f"'{layout.name}' has fields that are neither float nor bool, and fits no row", remedy)
        return Type("record", indices or 0, layout)
    try:
        return None if indices else _TYPES.get(hint)
    except TypeError:  # not hashable
        return None


class Signature(NamedTuple):
    """The names and types of a kernel's parameters, and the types of its results."""

    names: tuple[str, ...]
    parameters: tuple[Type, ...]
    results: tuple[Type, ...]
    single: bool  # a single number or record is returned unchanged, several as a tuple

    @property
    def leaves(self) -> list[tuple[str, Type]]:
        """The names and types of the numbers and arrays among its parameters, with records flattened."""
        return [leaf for name, kind in zip(self.names, self.parameters, strict=True) for leaf in kind.leaves(name)]


def _alone(lines: Sequence[str], first: int) -> ast.FunctionDef | None:
    """Return the function that begins at a line and ends before the next line that is not indented.

    The result is None if the lines cannot be parsed, because that line is within a multi-line string or brackets.
    """
    begun, last = False, first - 1
    for line in lines[first - 1 :]:
        if begun and line[0] not in " \t\f\r\n#)":
            break
        begun, last = begun or line.startswith("def "), last + 1
    try:
        body = ast.parse("\n" * (first - 1) + "".join(lines[first - 1 : last])).body
    except SyntaxError:
        return None
    return body[0] if len(body) == 1 and isinstance(body[0], ast.FunctionDef) else None


@lru_cache(maxsize=64)
def _functions(text: str) -> dict[tuple[str, int], ast.FunctionDef]:
    """Return the top-level functions of a file, by name and first line (that of the decorator)."""
    functions = [node for node in ast.parse(text).body if isinstance(node, ast.FunctionDef)]
    return {
        (node.name, min([node.lineno, *[decorator.lineno for decorator in node.decorator_list]])): node
        for node in functions
    }


@lru_cache(maxsize=1024)
def _parsed(annotation: str) -> ast.expr:
    """Return the parsed expression of a string annotation."""
    return ast.parse(annotation, mode="eval").body


class Source:
    """A Python function as seen by the compiler."""

    def __init__(self, python: FunctionType) -> None:
        self.python = python
        self.name = python.__name__
        self.file = python.__code__.co_filename
        self.unit: Any = None  # all kernels of its file, once requested (`kernel.Unit`)
        self.part = False  # True for a helper that only compiled code calls

    @cached_property
    def tree(self) -> ast.FunctionDef:
        """The parsed syntax tree of the function."""
        code = self.python.__code__
        place = ast.Pass(lineno=code.co_firstlineno)
        if self.python.__qualname__ != self.name or self.name == "<lambda>":
            self.refuse(place, "a kernel stands at the top level of its file", "move it there, without a closure")
        # the file may have changed since its lines were first read
        linecache.checkcache(self.file)
        try:
            # the function alone first, since parsing whole files is slow
            tree = _alone(linecache.getlines(self.file), code.co_firstlineno)
            if tree is None:
                tree = _functions("".join(linecache.getlines(self.file))).get((self.name, code.co_firstlineno))
        except SyntaxError:
            tree = None
        names = [argument.arg for argument in [*tree.args.posonlyargs, *tree.args.args]] if tree else []
        if tree is None or (tree.name, names) != (self.name, [*code.co_varnames[: code.co_argcount]]):
            self.refuse(place, "its text is not in the file", "start Python again if the file has changed")
        if len(tree.decorator_list) > 1:
            self.refuse(tree, "a second decorator", "leave it out: a kernel has @kernel alone")
        return tree

    @cached_property
    def signature(self) -> Signature:
        """The types of parameters and results, obtained from the annotations without parsing the file."""
        code, annotations = self.python.__code__, self.python.__annotations__
        if code.co_flags & _STARS or code.co_kwonlyargcount or code.co_posonlyargcount or self.python.__defaults__:
            what = "defaults, * or / among the parameters"
            self.refuse(self.tree, what, "write plain parameters and give all of them")
        names = code.co_varnames[: code.co_argcount]
        if not {*names, "return"} <= annotations.keys() or not all(isinstance(x, str) for x in annotations.values()):
            return self._annotated([argument.annotation for argument in self.tree.args.args], self.tree.returns)
        try:
            return self._annotated([_parsed(annotations[name]) for name in names], _parsed(annotations["return"]))
        except KernelError:
            # again from the parsed file, whose nodes have line numbers for the message
            return self._annotated([argument.annotation for argument in self.tree.args.args], self.tree.returns)

    def _annotated(self, annotations: Sequence[ast.expr | None], returns: ast.expr | None) -> Signature:
        """Return the signature from the annotations."""
        names, parameters = self.python.__code__.co_varnames, list[Type]()
        for place, annotation in enumerate(annotations):
            if annotation is None:
                what = f"the parameter '{names[place]}' has no type"
                self.refuse(self.tree.args.args[place], what, f"annotate it as {_KNOWN}")
            parameters.append(self._type(annotation))
        results, single = self._results(returns)
        return Signature(names[: len(annotations)], tuple(parameters), results, single)

    def _type(self, node: ast.expr) -> Type:
        """Return the type that an annotation denotes."""
        hint = self._annotation(node)
        if isinstance(node, ast.Subscript):
            array, inner = self._annotation(node.value), self._annotation(node.slice)
            hint = cast(Any, array)[inner] if (array is Records or array is Records2) and is_record(inner) else None
        try:
            type_ = type_of(hint)
        except UnfitError as error:
            self.refuse(node, *error.args)
        return type_ or self.refuse(node, f"'{ast.unparse(node)}' is no type of a kernel", f"write {_KNOWN}")

    def layout(self, record: type, node: ast.AST) -> Layout:
        """Return the layout of a record used in the function."""
        try:
            return layout_of(record)
        except UnfitError as error:
            self.refuse(node, *error.args)

    def _results(self, node: ast.expr | None) -> tuple[tuple[Type, ...], bool]:
        """Return the types of the results, and a flag that is True if the result is a single number or record."""
        if node is None:
            self.refuse(self.tree, "no type is said to be returned", "write -> float, -> tuple[float, int] or -> None")
        if isinstance(node, ast.Constant) and node.value is None:
            return (), False
        single = not (isinstance(node, ast.Subscript) and self._annotation(node.value) is tuple)
        if isinstance(node, ast.Subscript) and not single:
            inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
            types = tuple(self._type(element) for element in inner)
        else:
            types = (self._type(node),)
        if any(leaf.dimensions for kind in types for _, leaf in kind.leaves("")):
            self.refuse(node, "an array is returned", "let the caller give the array that is filled")
        return types, single

    def _annotation(self, node: ast.expr) -> object:
        """Return the value of a name in an annotation, including module attributes; None if undefined."""
        # not from `named`: that would be read by an interpreted call, and fix what the code calls when it is compiled
        if isinstance(node, ast.Name):
            return self._outside(node.id)
        if isinstance(node, ast.Attribute):
            module = self._annotation(node.value)
            return getattr(module, node.attr, None) if isinstance(module, ModuleType) else None
        return None

    def lookup(self, node: ast.expr) -> object:
        """Return the value of a name defined outside the function, including module attributes; None if undefined."""
        if isinstance(node, ast.Name):
            return self.named[node.id] if node.id in self.named else self._outside(node.id)
        if isinstance(node, ast.Attribute):
            module = self.lookup(node.value)
            if not isinstance(module, ModuleType):
                return None
            name = f"{module.__name__}.{node.attr}"
            return self.named[name] if name in self.named else getattr(module, node.attr, None)
        return None

    @cached_property
    def named(self) -> dict[str, object]:
        """The values of the names in its code, including module attributes, read once: when it is first compiled."""
        names = self.python.__code__.co_names
        values = {name: self._outside(name) for name in names}
        # modules may refer to each other: each is visited once
        left, seen = list(values.values()), set[int]()
        while left:
            module = left.pop()
            if isinstance(module, ModuleType) and id(module) not in seen:
                seen.add(id(module))
                inner = {f"{module.__name__}.{name}": vars(module)[name] for name in names if name in vars(module)}
                values |= inner
                left += inner.values()
        return values

    def _outside(self, name: str) -> object:
        """Return the value of a name defined outside the function; None if undefined."""
        names = self.python.__globals__
        return names[name] if name in names else getattr(builtins, name, None)

    def refuse(self, node: ast.AST, what: str, remedy: str) -> NoReturn:
        """Raise KernelError for a construct outside the kernel language."""
        line = getattr(node, "lineno", self.python.__code__.co_firstlineno)
        raise KernelError(f"{self.file}, line {line}, kernel '{self.name}': {what}; {remedy}")


_Python = TypeVar("_Python", bound=Callable[..., object])


def readable(function: _Python) -> _Python:
    """Mark a function as a helper that is called only by compiled kernels."""
    source = Source(cast(FunctionType, function))
    source.part = True
    vars(function)["source"] = source
    return function


def source_of(value: object) -> Source | None:
    """Return the source of a kernel; None for any other object."""
    source = getattr(value, "source", None)
    return source if isinstance(source, Source) else None


class Cells:
    """An array whose elements are returned as `float` and `int`.

    NumPy numbers warn where Python raises an error (1.0 / 0.0), and NumPy integers wrap around.
    """

    __slots__ = ("held",)

    def __init__(self, held: np.ndarray) -> None:
        self.held = held

    def __len__(self) -> int:
        return len(self.held)

    def __getitem__(self, key: Any) -> Any:
        cell: Any = self.held[key]
        return cell.item() if isinstance(cell, np.generic) else Cells(cell)

    def __setitem__(self, key: Any, value: Any) -> None:
        if isinstance(value, tuple) and len(self.held[key]) != len(cast(tuple[Any, ...], value)):
            raise ValueError(f"{len(cast(tuple[Any, ...], value))} numbers for a row of {len(self.held[key])}")
        self.held[key] = value


class Rows:
    """An array of records: rows are read and assigned as records."""

    __slots__ = ("held", "layout")

    def __init__(self, held: np.ndarray, layout: Layout) -> None:
        self.held, self.layout = held, layout

    def __len__(self) -> int:
        return len(self.held)

    def __getitem__(self, key: Any) -> Any:
        row: np.ndarray = self.held[key]
        return Rows(row, self.layout) if row.ndim > 1 else _record(self.layout, iter(row.tolist()))

    def __setitem__(self, key: Any, record: Any) -> None:
        self.held[key] = columns(record)


def _record(layout: Layout, numbers: Iterator[float]) -> Any:
    """Return a record built from the numbers of a row."""
    if layout.floats:
        return layout.python(*islice(numbers, len(layout.fields)))
    return layout.python(
        *(
            _record(kind.layout, numbers) if kind.layout else bool(next(numbers)) if kind == BOOL else next(numbers)
            for kind in layout.fields.values()
        )
    )


def columns(record: tuple[Any, ...]) -> list[float]:
    """Return the numbers of a record as a row of an array; nested records are flattened."""
    return [number for part in record for number in (columns(part) if isinstance(part, tuple) else (float(part),))]


def rows_for(record: type, *sizes: int) -> NDArray[np.float64]:
    """Return an array of zeros for records, with the given sizes and one column for each number in a record."""
    return np.zeros((*sizes, layout_of(record).width))


def zeros(*sizes: int) -> NDArray[np.float64]:
    """Return a small array of fixed size for a local variable of a kernel: one to three sizes, at most 256 numbers."""
    return cast(Any, Cells(np.zeros(sizes)))


@overload
def records(record: type[_Record], size: int, /) -> Records[_Record]: ...
@overload
def records(record: type[_Record], first: int, second: int, /) -> Records2[_Record]: ...
def records(record: type, *sizes: int) -> Any:
    """Return a small array of records for a local variable of a kernel: one or two sizes, at most 256 numbers."""
    return Rows(rows_for(record, *sizes), layout_of(record))


def by_field(record: type[_Record], rows: NDArray[np.float64]) -> _Record:
    """Return an array of records as one record whose fields are the columns, as views, so that plain arithmetic on its
    fields (`kernel.python`, too) computes with all rows at once; a single row becomes a record of numbers.
    """
    if rows.ndim == 1:
        return cast(_Record, _record(layout_of(record), iter(rows.tolist())))
    return cast(_Record, _columns(layout_of(record), iter(rows.T if rows.ndim == 2 else np.moveaxis(rows, -1, 0))))


def _columns(layout: Layout, left: Iterator[np.ndarray]) -> Any:
    """Return a record of the next columns of an array."""
    if layout.floats:
        return layout.python(*islice(left, len(layout.fields)))
    return layout.python(
        *(
            _columns(kind.layout, left) if kind.layout else next(left) != 0.0 if kind == BOOL else next(left)
            for kind in layout.fields.values()
        )
    )
