"""The oracle of kernels: the same calls by the interpreter and by machine code, to the last bit."""

from __future__ import annotations

import linecache
import math
import random
import re
import struct
from collections.abc import Callable, Iterable, Iterator
from types import FunctionType
from typing import Any, cast

import numpy as np

from feeddrive.language.kernels.kernel import Kernel, interpreted
from feeddrive.language.kernels.module import QUICK, THOROUGH

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


def arguments(kernel: Kernel[..., Any], draw: random.Random) -> list[Any]:
    """Arguments of a kernel; whole numbers with the name of an index are small."""
    given: list[Any] = []
    for name, kind in zip(kernel.source.signature.names, map(str, kernel.source.signature.parameters), strict=True):
        if kind == "float":
            given.append(a_float(draw))
        elif kind == "int":
            given.append(draw.randint(-5, 5) if name in "ijkn" else a_whole(draw))
        elif kind == "bool":
            given.append(draw.random() < 0.5)
        else:
            sizes = SIZES[kind] if draw.random() < 0.9 else tuple(draw.randint(0, 4) for _ in SIZES[kind])
            count = math.prod(sizes)
            numbers = [draw.randint(-3, 3) if kind == "Ints" else a_float(draw) for _ in range(count)]
            given.append(np.array(numbers, dtype=np.int64 if kind == "Ints" else np.float64).reshape(sizes))
    return given


def bits(value: Any) -> Any:
    """A number by its bits, NaN as one."""
    if isinstance(value, np.ndarray):
        return value.shape, [bits(each) for each in value.ravel().tolist()]
    if isinstance(value, tuple):
        return [bits(each) for each in value]
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


def outcome(kernel: Callable[..., Any], given: list[Any]) -> Any:
    """Results and arrays after a call, or the error, its text if a kernel raised it, and its line."""
    held = [each.copy() if isinstance(each, np.ndarray) else each for each in given]
    try:
        found = kernel(*held)
    except Exception as error:
        written = "raise " in linecache.getline(*place_of(error))
        return type(error), str(error) if written else "", place_of(error), bits(tuple(held))
    results = found if isinstance(found, tuple) else (found,)
    if any(isinstance(each, int) and not -(2**63) <= each < 2**63 for each in results):
        return OverflowError
    return bits(results), bits(tuple(held))


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
