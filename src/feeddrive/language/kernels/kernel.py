"""The decorator of kernels, and their call: as machine code, or as plain Python."""

from __future__ import annotations

import ctypes
import linecache
import struct
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cached_property
from time import thread_time
from types import FunctionType
from typing import Any, Generic, NamedTuple, NoReturn, ParamSpec, TypeVar, cast

import numpy as np

from feeddrive.language.kernels.module import Unit, unit_of
from feeddrive.language.kernels.plain import Cells, Rows
from feeddrive.language.kernels.source import BOOL, FLOAT, INT, KernelError, Source, Type
from feeddrive.language.kernels.text import Failure
from feeddrive.language.machine_code import MachineCode

_FORMATS = {"float": "d", "int": "q", "bool": "q"}
_ADDRESS, _COUNT = "P", "q"
_WORD = 8  # bytes
_CELLS: dict[str, np.dtype[Any]] = {
    "float": np.dtype(np.float64),
    "int": np.dtype(np.int64),
    "record": np.dtype(np.float64),
}
_DATA = object.__basicsize__  # in numpy's PyArrayObject the address of the first cell stands behind the object's head

_P = ParamSpec("_P")
_R = TypeVar("_R")
_mode: ContextVar[str] = ContextVar("mode", default="native")


class _Compiled(NamedTuple):
    """A kernel as machine code: the function, and how arguments and results lie in memory."""

    code: MachineCode  # holds the memory of the function
    call: Callable[[Any], int]
    arguments: struct.Struct
    returned: struct.Struct
    size: int  # of the memory of both, bytes
    kinds: tuple[tuple[object, int, int], ...]  # of each number and array that is given, see `_kind`


class Kernel(Generic[_P, _R]):
    """A function over numbers and arrays that the interpreter and the processor run with the same bits and errors.

    The first call of a kernel compiles all kernels of its file and of those that they call. A call checks types: int is
    taken for float, no array is copied. `python` is the function that was decorated; `with interpreted():` runs it
    instead.
    """

    def __init__(self, python: Callable[_P, _R]) -> None:
        if not isinstance(python, FunctionType):
            raise KernelError(f"{python!r} is no Python function; decorate a def at the top level of a file")
        self.python: Callable[_P, _R] = python
        self.source = Source(python)
        self.__name__, self.__doc__, self.__module__ = self.source.name, python.__doc__, python.__module__
        self._compiled: _Compiled | None = None

    def __repr__(self) -> str:
        return f"<kernel {self.__module__}.{self.__name__}>"

    def __reduce__(self) -> str:
        return self.__name__  # pickled by its name in its module

    def __call__(self, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        """Call the kernel in the mode of this thread."""
        mode = _mode.get()
        if mode == "inside":
            return self.python(*args, **kwargs)
        values = self._in_order(args, kwargs) if kwargs else args
        count, nested = self._counted
        if len(values) != count:
            raise TypeError(f"{self.__name__}() takes {count} arguments, not {len(values)}")
        if nested:
            wanted = zip(self.source.signature.names, self.source.signature.parameters, values, strict=True)
            values = [leaf for parameter in wanted for leaf in self._flat(*parameter)]
        if mode == "interpreted":
            return self._interpret([self._checked(place, value) for place, value in enumerate(values)])
        return self._run(values)

    def _run(self, values: Sequence[Any]) -> _R:
        """Run the machine code; arguments are checked."""
        unit, compiled, words = self.unit, self._compiled, list[Any]()
        if compiled is None or compiled.code is not unit.code:
            compiled = self._compiled = self._bound()
        for place, ((cell, dimensions, width), value) in enumerate(zip(compiled.kinds, values, strict=True)):
            if not dimensions:
                plain = cell is float and type(value) is float
                words.append(value if plain else self._checked(place, value))
                continue
            if not (
                type(value) is np.ndarray
                and value.dtype is cell
                and value.flags.carray
                and (value.ndim == dimensions if not width else value.shape[dimensions:] == (width,))
            ):
                self._checked(place, value)
            words.append(_address(value))
            words += value.shape[:dimensions] if width else value.shape
        memory = ctypes.create_string_buffer(compiled.size)
        compiled.arguments.pack_into(memory, 0, *words)
        if unit.quick:
            begun = thread_time()
            status = compiled.call(memory)
            unit.ran(thread_time() - begun)
        else:
            status = compiled.call(memory)
        if status:
            _throw(unit.failure(status))
        results = compiled.returned.unpack_from(memory)
        if not self._plain:
            numbers = iter(results)
            results = tuple(_made(kind, numbers) for kind in self.source.signature.results)
        return cast(_R, results[0] if self.source.signature.single else results or None)

    @property
    def unit(self) -> Unit:
        """The kernels of its file."""
        return self.source.unit or unit_of(self.source)

    def _bound(self) -> _Compiled:
        """Return its function in the current machine code of the file."""
        code, address = self.unit.entry(self.source)
        words = [
            _FORMATS[kind.element] if not kind.dimensions else _ADDRESS + _COUNT * kind.dimensions
            for _, kind in self._leaves
        ]
        results = [_FORMATS[kind.element] for result in self.source.signature.results for _, kind in result.leaves("")]
        call = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(address)
        arguments, returned = struct.Struct(f"@{''.join(words)}"), struct.Struct(f"@{''.join(results)}")
        size = max(arguments.size, returned.size, _WORD)
        return _Compiled(code, call, arguments, returned, size, tuple(_kind(kind) for _, kind in self._leaves))

    @cached_property
    def _leaves(self) -> list[tuple[str, Type]]:
        return self.source.signature.leaves

    @cached_property
    def _counted(self) -> tuple[int, bool]:
        """The number of arguments, and True if there are records among them."""
        parameters = self.source.signature.parameters
        return len(parameters), any(parameter.layout and not parameter.dimensions for parameter in parameters)

    @cached_property
    def _plain(self) -> bool:
        """True if all results are numbers that ctypes returns as they are."""
        return all(result in (FLOAT, INT) for result in self.source.signature.results)

    @cached_property
    def _written(self) -> frozenset[int]:
        return self.unit.function(self.source).written

    def _in_order(self, args: tuple[object, ...], named: dict[str, object]) -> list[object]:
        """Arguments by position and by name, in their order."""
        names = self.source.signature.names
        if set(named) != set(names[len(args) :]):
            raise TypeError(f"{self.__name__}() takes ({', '.join(names)}), each once")
        return [*args, *[named[name] for name in names[len(args) :]]]

    def _flat(self, name: str, kind: Type, value: Any) -> list[Any]:
        """The numbers and arrays of an argument: those of a record one by one."""
        if kind.layout is None or kind.dimensions:
            return [value]
        if type(value) is not kind.layout.python:
            raise TypeError(f"{self.__name__}(): '{name}' is {type(value).__name__}: give {kind}")
        fields = zip(kind.layout.fields.items(), value, strict=True)
        return [leaf for (field, inner), part in fields for leaf in self._flat(f"{name}.{field}", inner, part)]

    def _checked(self, place: int, value: object) -> Any:
        """An argument of the type that its parameter has."""
        kind = self._leaves[place][1]
        if not kind.dimensions:
            if kind.element == "float" and isinstance(value, (float, int, np.floating, np.integer)):
                if not isinstance(value, bool):
                    return float(cast(float, value))
            elif kind.element == "int" and isinstance(value, (int, np.integer)) and not isinstance(value, bool):
                if not -(2**63) <= value < 2**63:
                    raise OverflowError(f"{self._named(place)} is beyond 64 bits")
                return int(value)
            elif kind.element == "bool" and isinstance(value, (bool, np.bool_)):
                return bool(value)
            raise TypeError(f"{self._named(place)} is {type(value).__name__}: give {kind}")
        if not isinstance(value, np.ndarray):
            raise TypeError(f"{self._named(place)} is {type(value).__name__}: give a numpy array")
        array = cast("np.ndarray[Any, Any]", value)
        wanted = _CELLS[kind.element]
        indices = kind.dimensions + bool(kind.layout)
        if array.dtype != wanted or array.ndim != indices:
            what = f"{self._named(place)} is an array of {array.dtype} with {array.ndim} indices"
            raise TypeError(f"{what}: give {wanted} with {indices}")
        if kind.layout and array.shape[-1] != kind.width:
            what = f"{self._named(place)} is an array with {array.shape[-1]} columns"
            raise TypeError(f"{what}: give {kind.width}, those of {kind.layout.name}")
        if not array.flags.c_contiguous or not array.flags.aligned:
            raise TypeError(f"{self._named(place)} does not lie in C order: give np.ascontiguousarray(...)")
        if not array.flags.writeable and place in self._written:
            raise ValueError(f"{self._named(place)} is written to and is read-only: give a copy")
        return array

    def _named(self, place: int) -> str:
        return f"{self.__name__}(): '{self._leaves[place][0]}'"

    def _interpret(self, values: list[Any]) -> _R:
        """The same call by the interpreter, with all kernels below it."""
        leaves = iter(values)
        plain = [_made(kind, leaves) for kind in self.source.signature.parameters]
        token = _mode.set("inside")
        try:
            return cast(Callable[..., _R], self.python)(*plain)
        finally:
            _mode.reset(token)


def _kind(kind: Type) -> tuple[object, int, int]:
    """The expected type of an argument: float or the dtype of an array, its number of indices, columns of records."""
    cell = _CELLS[kind.element] if kind.dimensions else float if kind == FLOAT else None
    return cell, kind.dimensions, kind.width if kind.layout else 0


def _made(kind: Type, leaves: Iterator[Any]) -> Any:
    """Build a value for the interpreter from its numbers and arrays."""
    if kind.layout is None:
        value = next(leaves)
        return Cells(value) if kind.dimensions else bool(value) if kind == BOOL else value
    if kind.dimensions:
        return Rows(next(leaves), kind.layout)
    return kind.layout.python(*[_made(field, leaves) for field in kind.layout.fields.values()])


def _address(array: np.ndarray) -> int:
    """Return the address of an array's first cell, from the object: numpy's own ways take as long as a small kernel."""
    return ctypes.c_size_t.from_address(id(array) + _DATA).value if _READS_THE_OBJECT else array.ctypes.data


def _reads_the_object() -> bool:
    """Return True if the address lies in the array object where `_address` reads it, as in every numpy so far."""
    probe = np.zeros(1)
    known = sys.implementation.name == "cpython"
    return known and ctypes.c_size_t.from_address(id(probe) + _DATA).value == probe.ctypes.data


_READS_THE_OBJECT = _reads_the_object()


def _throw(failure: Failure) -> NoReturn:
    """Raise the error that Python raises there, with file and line."""
    error, source = failure.kind(failure.text), failure.source
    text = linecache.getline(source.file, failure.line).strip()
    error.add_note(f"in kernel '{source.name}', file {source.file}, line {failure.line}: {text}")
    raise error


def kernel(python: Callable[_P, _R]) -> Kernel[_P, _R]:
    """Turn a plain Python function into a kernel; `docs/kernels.md` has the language."""
    return Kernel(python)


@contextmanager
def interpreted() -> Generator[None]:
    """Run all kernels of this thread as plain Python, as the oracle of tests and for debuggers."""
    token = _mode.set("interpreted")
    try:
        yield
    finally:
        _mode.reset(token)
