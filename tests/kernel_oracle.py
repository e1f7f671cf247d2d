"""The oracle of kernels: the same calls by the interpreter and by machine code, to the last bit."""

from __future__ import annotations

import importlib.util
import linecache
import math
import random
import re
import struct
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import FunctionType
from typing import Any, cast

import numpy as np

from feeddrive.language.kernels.kernel import QUICK, THOROUGH, Kernel, interpreted
from feeddrive.language.kernels.source import BOOL, INT, Type

SPECIAL = [
    math.nan, math.inf, -math.inf, 0.0, -0.0, 5e-324, -5e-324, 2.2e-308, -1e-310, 1e308, -1.7e308, 1.0, -1.0, 0.5, 2.0,
    -2.5, 3.0, 2.0**52 + 0.5, 2.0**53, 2.0**63, -(2.0**63), 2.0**63 - 1024.0, 9.3e18, 0.1, 0.3, 1.0 - 2.0**-53,
]  # fmt: skip
WHOLE = [0, 1, -1, 2, -2, 3, 7, -7, 10**9, 2**53, 2**53 + 1, -(2**53) - 1, 2**62, 2**63 - 1, -(2**63), 2**63 - 1024]
SIZES = {"Floats": (3,), "Floats2": (4, 3), "Floats3": (4, 3, 3), "Ints": (3,)}


def a_float(draw: random.Random) -> float:
    return draw.choice(SPECIAL) if draw.random() < 0.5 else draw.uniform(-2.0, 2.0) * 10.0 ** draw.randint(-12, 12)


def a_whole(draw: random.Random) -> int:
    return draw.choice(WHOLE) if draw.random() < 0.6 else draw.randint(-(2**63), 2**63 - 1) >> draw.randint(0, 62)


def argument(name: str, kind: Type, draw: random.Random) -> Any:
    """A value of a type; whole numbers with the name of an index are small."""
    if kind.layout and not kind.dimensions:
        return kind.layout.python(*(argument(field, inner, draw) for field, inner in kind.layout.fields.items()))
    if kind.dimensions:
        shape = SIZES[f"{'Int' if kind.element == 'int' else 'Float'}s{kind.dimensions if kind.dimensions > 1 else ''}"]
        sizes = shape if draw.random() < 0.9 else tuple(draw.randint(0, 4) for _ in shape)
        sizes = (*sizes, kind.width) if kind.layout else sizes
        whole = kind.element == "int"
        numbers = [draw.randint(-3, 3) if whole else a_float(draw) for _ in range(math.prod(sizes))]
        return np.array(numbers, dtype=np.int64 if whole else np.float64).reshape(sizes)
    if kind == INT:
        return draw.randint(-5, 5) if name in "ijkn" else a_whole(draw)
    return draw.random() < 0.5 if kind == BOOL else a_float(draw)


def arguments(kernel: Kernel[..., Any], draw: random.Random) -> list[Any]:
    """Arguments of a kernel."""
    signature = kernel.source.signature
    return [argument(name, kind, draw) for name, kind in zip(signature.names, signature.parameters, strict=True)]


def copied(value: Any) -> Any:
    """An argument with arrays of its own, those in records too."""
    if isinstance(value, tuple):
        return type(value)(*map(copied, value))
    return value.copy() if isinstance(value, np.ndarray) else value


def bits(value: Any) -> Any:
    """A number by its bits, NaN as one."""
    if isinstance(value, np.ndarray):
        return value.shape, [bits(each) for each in value.ravel().tolist()]
    if isinstance(value, tuple):
        return type(value).__name__, [bits(each) for each in value]
    if isinstance(value, float):
        return "nan" if value != value else struct.pack(">d", value)
    return type(value), value


def place_of(error: Exception) -> tuple[str, int]:
    """File and line of a kernel at which an error was raised, by the interpreter or by machine code."""
    for note in getattr(error, "__notes__", []):
        if found := re.match(r"in kernel '\w+', file (.*), line (\d+): ", note):
            return found[1], int(found[2])
    trace, place = error.__traceback__, ("", 0)
    while trace:
        code = trace.tb_frame.f_code
        owner = trace.tb_frame.f_globals.get(code.co_name)
        if isinstance(owner, Kernel) and cast(FunctionType, owner.python).__code__ is code:
            place = code.co_filename, trace.tb_lineno
        trace = trace.tb_next
    return place


def flat(found: Any) -> list[Any]:
    """All numbers of what a kernel returns."""
    return [number for each in found for number in flat(each)] if isinstance(found, tuple) else [found]


def outcome(kernel: Callable[..., Any], given: list[Any]) -> Any:
    """Results and arrays after a call, or the error, its text if a kernel raised it, and its line."""
    held = [copied(each) for each in given]
    try:
        found = kernel(*held)
    except Exception as error:
        written = "raise " in linecache.getline(*place_of(error))
        return type(error), str(error) if written else "", place_of(error), bits(tuple(held))
    results = flat(found)
    if any(isinstance(each, int) and not -(2**63) <= each < 2**63 for each in results):
        return OverflowError
    return bits(found), bits(tuple(held))


def compare(kernel: Kernel[..., Any], draws: Iterable[list[Any]]) -> int:
    """How many calls ended in an error; interpreter and processor agree on all of them, errors and their lines too.

    The processor with code that was made quickly and thoroughly.
    """
    given = list(draws)
    with interpreted():
        plain = [outcome(kernel, each) for each in given]
    for effort in (QUICK, THOROUGH):
        kernel.unit.make(effort)
        for each, expected in zip(given, plain, strict=True):
            native = outcome(kernel, each)
            assert (native[0] if expected is OverflowError else native) == expected, (kernel, effort, each)
    return sum(isinstance(each, type) or isinstance(each[0], type) for each in plain)


def drawn(kernel: Kernel[..., Any], count: int, seed: int) -> Iterator[list[Any]]:
    """Random arguments of a kernel, with NaN, infinities, -0.0 and numbers below the normal ones."""
    draw = random.Random(f"{kernel.__name__} {seed}")
    for _ in range(count):
        yield arguments(kernel, draw)


def written(folder: Path, text: str, name: str = "f") -> Any:
    """A kernel of a file of its own, of the whole text of that file."""
    path = folder / f"written_{abs(hash(text))}.py"
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec
    assert spec.loader
    sys.modules[path.stem] = module = importlib.util.module_from_spec(spec)  # where the fields of records are looked up
    spec.loader.exec_module(module)
    return getattr(module, name)
