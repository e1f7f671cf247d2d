"""Elementary functions in single precision: error against 30-digit arithmetic, ends, symmetry, and the bits of C."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from pathlib import Path

import mpmath
import numpy as np
import pytest

from feeddrive.language import single
from feeddrive.language.graph import ELEMENTARY, Graph
from feeddrive.language.single import single_values

# The largest error in units in the last place, as docs/reference/accuracy.md states it for each function.
STATED = Path(__file__).parents[2] / "docs" / "reference" / "accuracy.md"
BOUNDS = {
    name: float(bound)
    for name, bound in re.findall(r"^\| `single\.(\w+)` \|.*\| ([\d.]+) \|$", STATED.read_text("utf-8"), re.MULTILINE)
}
POINTS = 3000
NAN, INF = math.nan, math.inf


def computed(name: str, x: object) -> np.ndarray:
    """A function of numbers that are rounded to float first."""
    graph = Graph()
    node = graph.apply(name, graph.input("x"))
    return single_values(graph, [node.index], {"x": np.asarray(x, dtype=np.float32)})[0]


def spread(least: float, most: float) -> np.ndarray:
    return np.random.default_rng(1).uniform(least, most, POINTS)


def decades(least: float, most: float) -> np.ndarray:
    random = np.random.default_rng(2)
    return np.sign(random.uniform(-1, 1, POINTS)) * 10.0 ** random.uniform(least, most, POINTS)


TURNS = np.concatenate([np.random.default_rng(3).integers(1, 6366, POINTS), np.arange(-200, 200)]) * (math.pi / 2)
ARGUMENTS = {
    "exp": [spread(-86.6, 88.3), spread(-1, 1), decades(-30, 0)],
    "expm1": [spread(-20, 88.3), spread(-1, 1), decades(-30, 0)],
    "log": [np.abs(decades(-37.8, 38.5)), spread(0.5, 2.0)],
    "sin": [spread(-10, 10), spread(-1e4, 1e4), TURNS, decades(-30, 0)],
    "cos": [spread(-10, 10), spread(-1e4, 1e4), TURNS],
    "tanh": [spread(-12, 12), spread(-1, 1), decades(-30, 0)],
    "atan": [spread(-3, 3), decades(-30, 30)],
}


def test_every_elementary_function_is_there_with_a_bound():
    assert set(single.FUNCTIONS) == ELEMENTARY == set(BOUNDS) == set(ARGUMENTS)


@pytest.mark.parametrize("name", sorted(ARGUMENTS))
def test_error_in_units_in_the_last_place(name: str):
    worst = 0.0
    with mpmath.workdps(30):
        for numbers in ARGUMENTS[name]:
            x = numbers.astype(np.float32)
            for argument, got in zip(x, computed(name, x), strict=True):
                true = getattr(mpmath, name)(mpmath.mpf(float(argument)))
                unit = float(np.spacing(np.float32(abs(float(true)))))
                worst = max(worst, abs(float((mpmath.mpf(float(got)) - true) / unit)))
    assert worst <= BOUNDS[name], f"{name}: {worst:.3f} ulp"


@pytest.mark.parametrize(
    ("name", "at", "expected"),
    [
        ("exp", [0.0, -INF, INF, 3e38, -3e38, -86.7], [1.0, 0.0, INF, INF, 0.0, 0.0]),
        ("expm1", [0.0, -INF, INF, 3e38, -3e38], [0.0, -1.0, INF, INF, -1.0]),
        ("log", [1.0, 0.0, -0.0, 1e-40, INF, -1.0, -INF], [0.0, -INF, -INF, -INF, INF, NAN, NAN]),
        ("sin", [0.0, 10001.0, INF, -INF], [0.0, NAN, NAN, NAN]),
        ("cos", [0.0, 10001.0, INF, -INF], [1.0, NAN, NAN, NAN]),
        ("tanh", [0.0, INF, -INF, 30.0], [0.0, 1.0, -1.0, 1.0]),
        ("atan", [0.0, INF, -INF, 3e38], [0.0, math.pi / 2, -math.pi / 2, math.pi / 2]),
    ],
)
def test_ends(name: str, at: list[float], expected: list[float]):
    assert np.array_equal(computed(name, at), np.array(expected, dtype=np.float32), equal_nan=True)
    assert np.isnan(computed(name, [NAN])).all()


def test_a_sine_is_right_up_to_ten_thousand_radians():
    """There neighboring floats are a thousandth of a radian apart; the argument itself is exact."""
    x = np.float32(9000.5)
    assert computed("sin", [x])[0] == pytest.approx(math.sin(float(x)), abs=1e-6)


@pytest.mark.parametrize("name", ["sin", "tanh", "atan"])
def test_odd_functions_are_odd(name: str):
    x = np.concatenate([spread(1e-3, 12.0), np.abs(decades(-30, 3))])
    assert np.array_equal(computed(name, -x), -computed(name, x))


def test_every_constant_is_a_float():
    for name, function in single.FUNCTIONS.items():
        graph = Graph()
        function(graph.input("x"))
        constants = [float.fromhex(node[1]) for node in graph.nodes if node[0] == "const"]
        assert all(float(np.float32(value)) == value for value in constants), name


OPERATORS = {"add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "eq": "==", "and": "&&", "or": "||"}
MACHINE = """\
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
static float power_of_two(float k)
{
    float x = k + 12582912.0f;
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits = (bits + 127u) << 23;
    memcpy(&x, &bits, sizeof bits);
    return x;
}
static float exponent(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (float)((bits >> 23) & 0xFFu) - 127.0f;
}
"""


def as_c(name: str) -> str:
    """A function as C, one line an operation."""
    graph = Graph()
    result = single.FUNCTIONS[name](graph.input("x")).index
    lines = []
    for index, node in enumerate(graph.nodes):
        given = [f"v{i}" for i in node[1:]] if node[0] not in ("input", "const") else []
        match node[0]:
            case "input":
                text = "x"
            case "const":
                value = float.fromhex(node[1])
                text = f"{value.hex()}f" if math.isfinite(value) else ("-" if value < 0 else "") + "INFINITY"
            case "select":
                text = f"{given[0]} ? {given[1]} : {given[2]}"
            case "neg":
                text = f"-{given[0]}"
            case "abs" | "floor" | "sqrt":
                text = f"{'fabs' if node[0] == 'abs' else node[0]}f({given[0]})"
            case other if other in OPERATORS:
                text = f"{given[0]} {OPERATORS[other]} {given[1]}"
            case other:
                text = f"{other}({given[0]})"
        kind = "int" if node[0] in ("lt", "le", "eq", "and", "or") else "float"
        lines.append(f"    const {kind} v{index} = {text};")
    return f"static float function(float x)\n{{\n{chr(10).join(lines)}\n    return v{result};\n}}\n"


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not there: apt-get install gcc libc6-dev")
@pytest.mark.parametrize("name", sorted(ARGUMENTS))
def test_c_has_the_bits_of_the_oracle(name: str, tmp_path: Path):
    ends = [0.0, -0.0, INF, -INF, 1e-40, -1e-40, 1.2e-38, 3.4e38, -3.4e38, 88.37, 88.38, -86.65, 1e4, 10001.0]
    x = np.concatenate([*ARGUMENTS[name], -ARGUMENTS[name][0], decades(-38, 38), ends]).astype(np.float32)
    main = "int main(void)\n{\n    float x;\n    _mm_setcsr(_mm_getcsr() | 0x8040u);\n"
    main += "    while (fread(&x, 4, 1, stdin) == 1) { x = function(x); fwrite(&x, 4, 1, stdout); }\n    return 0;\n}\n"
    (tmp_path / "f.c").write_text(f"#include <xmmintrin.h>\n{MACHINE}{as_c(name)}{main}")
    subprocess.run(["gcc", "-O2", "-std=c99", "-ffp-contract=off", "f.c", "-o", "f", "-lm"], cwd=tmp_path, check=True)
    got = subprocess.run([tmp_path / "f"], input=x.tobytes(), capture_output=True, check=True).stdout
    got, expected = np.frombuffer(got, np.float32), computed(name, x)
    assert np.array_equal(got, expected, equal_nan=True)
    assert np.array_equal(np.signbit(got[got == 0]), np.signbit(expected[got == 0]))
