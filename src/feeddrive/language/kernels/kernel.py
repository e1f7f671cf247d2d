"""The kernel decorator, kernel calls, and the machine code of the kernels of a file.

A kernel of another file is called as an external function, linked to the code of that file, so every file is
compiled only once.  The code is first compiled quickly.  A file whose kernels have run for some time, in this process
and in earlier ones, is recompiled with optimizer passes and better instruction selection; results and errors are
identical.
"""

from __future__ import annotations

import atexit
import ctypes
import hashlib
import linecache
import struct
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cached_property, lru_cache
from itertools import islice
from pathlib import Path
from threading import RLock
from time import thread_time
from types import FunctionType, ModuleType
from typing import Any, Generic, NamedTuple, NoReturn, ParamSpec, TypeVar, cast

import numpy as np

from feeddrive.language.kernels.elementary import Elementary
from feeddrive.language.kernels.llvm import Statements
from feeddrive.language.kernels.objects import DATA, DTYPES, FIRST, SIZES, UNFIT, WORD, description, reader
from feeddrive.language.kernels.source import (
    BOOL,
    FLOAT,
    INT,
    Cells,
    KernelError,
    Layout,
    Rows,
    Source,
    Type,
    described,
    is_record,
    source_of,
)
from feeddrive.language.kernels.text import Failure, Function, struct_type
from feeddrive.language.machine_code import MachineCode, linked_code, store_time_spent, target, time_spent

# no-builtins: no loop becomes a call of the C library.  branch_weights: checks hardly ever fail
_INTRINSICS = """
declare double @llvm.sqrt.f64(double)
declare double @llvm.fabs.f64(double)
declare double @llvm.floor.f64(double)
declare { i64, i1 } @llvm.sadd.with.overflow.i64(i64, i64)
declare { i64, i1 } @llvm.ssub.with.overflow.i64(i64, i64)
declare { i64, i1 } @llvm.smul.with.overflow.i64(i64, i64)
attributes #0 = { nounwind "no-builtins" }
!0 = !{!"branch_weights", i32 1048575, i32 1}
"""


class Effort(NamedTuple):
    """The optimization effort of LLVM.  No pass contracts or reorders floating-point arithmetic."""

    selection: int  # LLVM optimization level of code generation
    passes: tuple[str, ...]


QUICK = Effort(0, ("sroa",))
THOROUGH = Effort(
    2,
    (
        "always_inliner",
        "global_dead_code_eliminate",
        "sroa",
        "simplify_cfg",
        "instruction_combine",
        "new_gvn",
        "simplify_cfg",
    ),
)
_LONG = 0.25  # s in the quickly compiled code of a file, after which it is recompiled: about as long as that takes
_KERNEL, _FAILURE = 10, 13  # bits of a status for the index of a kernel in its file, and of a failure in its kernel
_ENTRY = "entry{}"
BITCODE = Path(__file__).parent / "bitcode"
# reentrant: the files of called kernels are compiled while that of the caller is
_lock = RLock()


class Unit:
    """The kernels of a file."""

    def __init__(self, sources: Iterable[Source]) -> None:
        self.sources = tuple(sources)
        self.spent = 0.0  # s in the quickly compiled code of this file, in all processes
        self._places = {source: place for place, source in enumerate(self.sources)}
        self._functions: dict[Source, Function] = {}
        self.latest: MachineCode | None = None
        """The machine code, once it is made."""
        self._effort = QUICK

    @cached_property
    def key(self) -> str:
        """The digest of everything that determines the machine code, except the processor.

        It covers the source, types and constants, and the called files.
        """
        with _lock:
            if self in _keyed:
                first = self.sources[0]
                first.refuse(first.tree, "files whose kernels call each other", "put them into one file")
            _keyed.append(self)
            try:
                parts = [_compiler(), _lines(self.sources[0].file), *map(self._content, self.sources)]
            finally:
                _keyed.pop()
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def _content(self, source: Source) -> str:
        """Return a string of everything on which the LLVM text of a kernel depends."""
        named = [f"{name}={self._described(value)}" for name, value in sorted(source.named.items())]
        return "\n".join([source.name, repr(source.signature), *named])

    def _described(self, value: object) -> str:
        """Describe the value of a name in a kernel, as far as the LLVM text depends on it."""
        called = source_of(value)
        if called is not None:
            return str(self._places[called]) if called in self._places else unit_of(called).symbol(called)
        if isinstance(value, float):
            return float(value).hex()
        if isinstance(value, int):
            return f"{type(value).__name__} {value!r}"
        if isinstance(value, Elementary):
            return value.name
        if is_record(value) or is_record(type(value)):
            return described(value)
        if isinstance(value, ModuleType):
            return value.__name__
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__name__)}"

    def symbol(self, source: Source) -> str:
        """Return the LLVM function name of a kernel, unique across files."""
        return f"k{self.key[:32]}.{self._places[source]}"

    @cached_property
    def number(self) -> int:
        """The number that identifies the file in the status codes of its kernels."""
        # 40 bits: with the bits of _KERNEL and _FAILURE a status stays positive in 64 bits
        return int(self.key[:10], 16)

    # text

    def function(self, source: Source) -> Function:
        """Return the LLVM function of a kernel, generated at the first call, after the functions that it calls."""
        with _lock:
            function = self._functions.get(source)
            if function is not None:
                return function
            if source in _open:
                names = " -> ".join(caller.name for caller in [*_open[_open.index(source) :], source])
                remedy = "write a loop, with a stack in an array of the caller"
                source.refuse(source.tree, f"recursion: {names}", remedy)
            _open.append(source)
            try:
                number = self.number << _KERNEL | self._places[source]
                printer = Statements(source, lambda called: unit_of(called).function(called))
                printed = printer.function(self.symbol(source), number << _FAILURE)
            finally:
                _open.pop()
            return self._functions.setdefault(source, printed)

    def text(self, effort: Effort = QUICK) -> str:
        """Return the LLVM module, with its target triple in the first line."""
        functions = [self.function(source) for source in self.sources]
        # LLVM inlines only functions whose text is in the same module: small ones are copied, all others linked
        declared, copied = list[str](), dict[str, Function]()
        left, seen = [callee for function in functions for callee in function.called], set(self.sources)
        while left:
            source = left.pop()
            if source in seen:
                continue
            seen.add(source)
            function = unit_of(source).function(source)
            if source.part or (effort == THOROUGH and function.small):
                copied[function.symbol] = function
                left += function.called
            else:
                declared.append(f"declare {function.head}\n")
        angles = dict[str, str]()
        wanted = [elementary for function in (*functions, *copied.values()) for elementary in function.elementary]
        while wanted:
            elementary = wanted.pop()
            if elementary.name not in angles:
                angles[elementary.name], called = elementary.printed()
                wanted += called
        defined = [f"define {function.text}" for function in functions] + [
            f"define internal {function.text}" for function in copied.values()
        ]
        entries = [_entry(place, source, self.symbol(source)) for place, source in enumerate(self.sources)]
        return "\n".join(
            [f'target triple = "{target()[0]}"', *declared, *defined, *angles.values(), *entries, _INTRINSICS]
        )

    # machine code

    @property
    def code(self) -> MachineCode:
        """The machine code, loaded from disk if stored there, otherwise compiled quickly."""
        if self.latest is None:
            with _lock:
                # another thread may have compiled it while this one waited for the lock
                if self.latest is None:
                    code = self._linked(THOROUGH, stored=True)
                    if code is None:
                        self.spent = time_spent(self.key)
                        # many short processes run as long in this code as one long process
                        self._effort = QUICK if self.spent <= _LONG else THOROUGH
                        code = self._linked(self._effort)
                        if self._effort is QUICK:
                            _quick.append(self)
                    else:
                        self._effort = THOROUGH
                    self.latest = code
        assert self.latest
        return self.latest

    def entry(self, source: Source) -> tuple[MachineCode, int]:
        """Return the machine code of the file and the entry address by which Python calls a kernel."""
        code = self.code
        return code, code.addresses[_ENTRY.format(self._places[source])]

    @property
    def quick(self) -> bool:
        """True until the code has been recompiled thoroughly."""
        return self._effort is QUICK

    def ran(self, seconds: float) -> None:
        """Add to the time spent in the quickly compiled code of this file; recompile it beyond a threshold."""
        self.spent += seconds
        if self.spent > _LONG:
            self.make(THOROUGH)

    def make(self, effort: Effort) -> None:
        """Compile the code of this file and of the files that it calls with the given effort, unless already done."""
        with _lock:
            # called files first: the code of a caller contains their addresses
            for unit in self.units:
                if unit.latest is None or unit._effort != effort:
                    unit.latest, unit._effort = unit._linked(effort), effort

    @cached_property
    def units(self) -> tuple[Unit, ...]:
        """The units of the called files in dependency order, followed by this unit."""
        units = dict[Unit, None]()
        for source in self.sources:
            for kernel in _kernels(source):
                if kernel not in self._places:
                    units |= dict.fromkeys(unit_of(kernel).units)
        return *units, self

    def failure(self, status: int) -> Failure:
        """Return the error for a nonzero status."""
        number, place = status >> _FAILURE + _KERNEL, status >> _FAILURE & (1 << _KERNEL) - 1
        unit = next(candidate for candidate in self.units if candidate.number == number)
        return unit.function(unit.sources[place]).failures[(status & (1 << _FAILURE) - 1) - 1]

    def _linked(self, effort: Effort, stored: bool = False) -> MachineCode | None:
        """Return machine code linked to that of the called files; with `stored`, return None if it is not on disk."""
        names = [*map(self.symbol, self.sources), *map(_ENTRY.format, range(len(self.sources)))]
        below = [unit.code for unit in self.units[:-1]]
        # every file has entry functions of the same names: only kernels, whose names are unique, are linked
        symbols = {name: place for code in below for name, place in code.addresses.items() if name.startswith("k")}
        return linked_code(
            self.key,
            lambda: self.text(effort),
            names,
            symbols,
            below,
            effort=effort.selection,
            passes=effort.passes,
            stored=stored,
            prepared=self._prepared if effort is QUICK else None,
        )

    def _prepared(self) -> bytes | None:
        """Return the module as bitcode after the passes of QUICK, if `prepared.py` has made it."""
        try:
            return (BITCODE / f"{self.key}.bc").read_bytes()
        except OSError:
            return None


_open: list[Source] = []  # kernels being printed: the chain of calls
_keyed: list[Unit] = []  # units whose keys are being computed
_quick = list["Unit"]()  # units whose code was compiled quickly
_LITTLE = 1e-3  # s: less need not be remembered


@atexit.register
def _remember() -> None:
    """Store how long the quickly compiled code of each file has run, for the processes that follow."""
    for unit in _quick:
        if unit.quick and unit.spent > _LITTLE:
            store_time_spent(unit.key, unit.spent)


def _entry(place: int, source: Source, symbol: str) -> str:
    """Return an LLVM function that reads a kernel's arguments from 64-bit words and writes its results to them."""
    words = [kind for _, kind in source.signature.leaves]
    returned = struct_type(source.signature.results)
    results = [kind for result in source.signature.results for _, kind in result.leaves("")]
    lines, operands = list[str](), list[str]()
    for at, kind in enumerate(words):
        # a bool takes a whole word, as all arguments do
        loaded = kind.llvm.replace("i1", "i64")
        lines.append(f"%p{at} = getelementptr i64, ptr %words, i64 {at}")
        lines.append(f"%w{at} = load {loaded}, ptr %p{at}")
        if loaded != kind.llvm:
            lines.append(f"%t{at} = trunc i64 %w{at} to i1")
        if not kind.dimensions:
            operands.append(f"{kind.llvm} %{'w' if loaded == kind.llvm else 't'}{at}")
            continue
        # the word of an array is the address of its object
        for name, offset in (("cells", DATA), ("sizes", SIZES)):
            lines.append(f"%{name}p{at} = getelementptr i8, ptr %w{at}, i64 {offset}")
            lines.append(f"%{name}{at} = load ptr, ptr %{name}p{at}")
        operands.append(f"ptr %cells{at}")
        for index in range(kind.dimensions):
            lines.append(f"%sp{at}.{index} = getelementptr i64, ptr %sizes{at}, i64 {index}")
            lines.append(f"%s{at}.{index} = load i64, ptr %sp{at}.{index}")
            operands.append(f"i64 %s{at}.{index}")
    lines.append(f"%made = call {returned} @{symbol}({', '.join(operands)})")
    for at, kind in enumerate(results):
        value = f"%r{at}"
        lines.append(f"{value} = extractvalue {returned} %made, {at + 1}")
        if kind.llvm == "i1":
            lines.append(f"%e{at} = zext i1 {value} to i64")
            value = f"%e{at}"
        lines.append(f"%o{at} = getelementptr i64, ptr %words, i64 {at}")
        lines.append(f"store {kind.llvm.replace('i1', 'i64')} {value}, ptr %o{at}")
    lines.append(f"%status = extractvalue {returned} %made, 0")
    return "\n".join([f"define i64 @{_ENTRY.format(place)}(ptr %words) #0 {{", *lines, "ret i64 %status", "}", ""])


def unit_of(source: Source) -> Unit:
    """Return the compilation unit of the file that defines a kernel.

    It contains all kernels defined in that file before the first call.
    """
    with _lock:
        unit = cast("Unit | None", source.unit)
        if unit is None:
            names = source.python.__globals__
            beside = [other for other in map(source_of, names.values()) if other and other.python.__globals__ is names]
            unit = Unit(dict.fromkeys([*beside, source]))
            for member in unit.sources:
                member.unit = unit
    return unit


def _kernels(source: Source) -> list[Source]:
    """Return the kernels to which a kernel refers by name."""
    return [called for called in map(source_of, source.named.values()) if called]


def _lines(file: str) -> str:
    """Return the text of a file without lines that contain only a comment."""
    linecache.checkcache(file)
    return "".join(line for line in linecache.getlines(file) if line.lstrip()[:1] not in ("", "#"))


@lru_cache(maxsize=1)
def _compiler() -> str:
    """Return a digest of the compiler's source files."""
    here = Path(__file__).parent
    # the folder above, too: `mathematics.py` and `ops.py` are traced into the code of kernels
    texts = [path.read_text(encoding="utf-8") for path in sorted([*here.glob("*.py"), *here.parent.glob("*.py")])]
    # nothing else depends on the interpreter: bitcode that was prepared by another version of Python fits
    return hashlib.sha256("\n".join([f"{DATA}", *texts]).encode()).hexdigest()


_FORMATS = {"float": "d", "int": "q", "bool": "q"}

_P = ParamSpec("_P")
_R = TypeVar("_R")
_mode: ContextVar[str] = ContextVar("mode", default="native")


class _Compiled(NamedTuple):
    """A kernel as machine code: the function, and the memory layout of its arguments and results."""

    code: MachineCode  # keeps the memory of the function alive
    unit: Unit
    quick: bool  # True if it was compiled quickly
    call: Callable[[Any], int]
    memory: Callable[[], Any]  # makes room for arguments and results, see `reader`
    put: Callable[..., None]  # puts the words of the call into it
    described: int  # address of the description of the parameters
    results: Callable[[Any, int], tuple[Any, ...]]  # takes the results from it
    begin: int  # bytes before them
    single: bool  # True if it returns a single number
    kept: tuple[Any, ...]  # keeps the description and the reader alive


class Kernel(Generic[_P, _R]):
    """A function of numbers and arrays with bit-identical results and equal errors, interpreted or compiled.

    The first call of a kernel compiles all kernels of its file and of the files whose kernels they call. A call checks
    the types of its arguments: an int is accepted for a float, and no array is copied. `python` is the decorated
    function; `with interpreted():` runs this function instead of the machine code.
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
        """Call the kernel, which runs compiled or interpreted depending on the mode of this thread."""
        compiled = self._compiled
        mode = _mode.get()
        # recompiled since the last call: the function has moved
        if compiled is None or compiled.code is not compiled.unit.latest or mode != "native":
            if mode == "inside":
                return self.python(*args, **kwargs)
            if mode == "interpreted":
                return self._interpret(self._converted(self._in_order(args, kwargs)))
            compiled = self._compiled = self._bound()
        values = self._in_order(args, kwargs) if kwargs else args
        memory = compiled.memory()
        compiled.put(memory, 0, compiled.described, 0, id(values))
        status = self._ran(compiled, memory) if compiled.quick else compiled.call(memory)
        if status:
            if status == UNFIT:
                # a number or an array of another kind: converted, or refused
                leaves = iter(self._converted(values))
                values = tuple([_nested(kind, leaves) for kind in self.source.signature.parameters])
                compiled.put(memory, 0, compiled.described, 1, id(values))
                status = self._ran(compiled, memory)
            if status:
                _throw(compiled.unit.failure(status))
        results = compiled.results(memory, compiled.begin)
        if compiled.single:
            return results[0]
        numbers = iter(results)
        if self.source.signature.single:
            return _made(self.source.signature.results[0], numbers)
        return cast(_R, tuple([_made(kind, numbers) for kind in self.source.signature.results]) or None)

    def _ran(self, compiled: _Compiled, memory: Any) -> int:
        """Run the machine code, and count the time of quickly compiled code; return its status."""
        # CPU time of this thread: neither waiting nor the work of other threads counts
        begun = thread_time()
        status = compiled.call(memory)
        compiled.unit.ran(thread_time() - begun)
        return status

    def _converted(self, values: Sequence[Any]) -> list[Any]:
        """Return the numbers and arrays of the arguments, of the types of the parameters."""
        count = len(self.source.signature.parameters)
        if len(values) != count:
            raise TypeError(f"{self.__name__}() takes {count} arguments, not {len(values)}")
        return [self._checked(place, value) for place, value in enumerate(self._flat(values))]

    @property
    def unit(self) -> Unit:
        """The unit of the kernel's file."""
        return self.source.unit or unit_of(self.source)

    def _bound(self) -> _Compiled:
        """Return this kernel's compiled function, taken from the current machine code of the file."""
        unit, signature = self.unit, self.source.signature
        code, address = unit.entry(self.source)
        read, reads = reader()
        described, begin = description(signature.parameters, address)
        results = [_FORMATS[kind.element] for result in signature.results for _, kind in result.leaves("")]
        return _Compiled(
            code,
            unit,
            unit.quick,
            ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(reads),
            ctypes.c_int64 * (begin + max(len(self._leaves), len(results))),
            struct.Struct(f"@{'n' * FIRST}").pack_into,
            ctypes.addressof(described),
            struct.Struct(f"@{''.join(results)}").unpack_from,
            begin * WORD,
            signature.single and signature.results[0] in (FLOAT, INT),
            (described, read),
        )

    @cached_property
    def _leaves(self) -> list[tuple[str, Type]]:
        return self.source.signature.leaves

    @cached_property
    def _records(self) -> tuple[tuple[str, Layout | None], ...]:
        """The names of the parameters, with the layouts of records."""
        signature = self.source.signature
        pairs = zip(signature.names, signature.parameters, strict=True)
        return tuple((name, None if kind.dimensions else kind.layout) for name, kind in pairs)

    @cached_property
    def _written(self) -> frozenset[int]:
        return self.unit.function(self.source).written

    def _in_order(self, args: tuple[object, ...], named: dict[str, object]) -> tuple[Any, ...]:
        """Return positional and named arguments in the order of the parameters."""
        if not named:
            return args
        names = self.source.signature.names
        if set(named) != set(names[len(args) :]):
            raise TypeError(f"{self.__name__}() takes ({', '.join(names)}), each once")
        return (*args, *[named[name] for name in names[len(args) :]])

    def _flat(self, values: Sequence[Any]) -> list[Any]:
        """Return the numbers and arrays of the arguments; records are flattened."""
        leaves = list[Any]()
        self._flatten("", self._records, values, leaves)
        return leaves

    def _flatten(
        self, within: str, parts: Iterable[tuple[str, Layout | None]], values: Sequence[Any], leaves: list[Any]
    ) -> None:
        """Append the numbers and arrays of arguments or of the fields of a record, by name and layout, to `leaves`."""
        for (name, layout), value in zip(parts, values, strict=True):
            if layout is None:
                leaves.append(value)
            elif type(value) is not layout.python:
                place = f"{within}{name}"
                raise TypeError(f"{self.__name__}(): '{place}' is {type(value).__name__}: give {layout.name}")
            elif layout.flat:
                leaves += value
            else:
                self._flatten(f"{within}{name}.", layout.records, value, leaves)

    def _checked(self, place: int, value: object) -> Any:
        """Return an argument converted to the type of its parameter; raise an error if it does not match that type."""
        kind = self._leaves[place][1]
        if not kind.dimensions:
            if kind.element == "float" and isinstance(value, (float, int, np.floating, np.integer)):
                # bool is an int in Python, but a type of its own in kernels
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
        wanted = DTYPES[kind.element]
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
        """Run the call, and all kernels that it calls, in the interpreter."""
        leaves = iter(values)
        plain = [_made(kind, leaves) for kind in self.source.signature.parameters]
        token = _mode.set("inside")
        try:
            return cast(Callable[..., _R], self.python)(*plain)
        finally:
            _mode.reset(token)


def _nested(kind: Type, leaves: Iterator[Any]) -> Any:
    """Build an argument from its numbers and arrays."""
    if kind.layout is None or kind.dimensions:
        return next(leaves)
    return kind.layout.python(*[_nested(field, leaves) for field in kind.layout.fields.values()])


def _made(kind: Type, leaves: Iterator[Any]) -> Any:
    """Build an argument for the interpreter from its numbers and arrays."""
    if kind.layout is None:
        value = next(leaves)
        return Cells(value) if kind.dimensions else bool(value) if kind == BOOL else value
    if kind.dimensions:
        return Rows(next(leaves), kind.layout)
    if kind.layout.floats:
        return kind.layout.python(*islice(leaves, len(kind.layout.fields)))
    return kind.layout.python(*[_made(field, leaves) for field in kind.layout.fields.values()])


def _throw(failure: Failure) -> NoReturn:
    """Raise the error that Python would raise at the failing line, with a note that names file and line."""
    error, source = failure.kind(failure.text), failure.source
    text = linecache.getline(source.file, failure.line).strip()
    error.add_note(f"in kernel '{source.name}', file {source.file}, line {failure.line}: {text}")
    raise error


def kernel(python: Callable[_P, _R]) -> Kernel[_P, _R]:
    """Turn a plain Python function into a kernel; `docs/internals/kernels.md` describes the language."""
    return Kernel(python)


@contextmanager
def interpreted() -> Generator[None]:
    """Run all kernels of this thread as plain Python within this context, for tests and debugging."""
    token = _mode.set("interpreted")
    try:
        yield
    finally:
        _mode.reset(token)
