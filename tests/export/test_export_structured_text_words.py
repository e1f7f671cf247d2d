"""Numbers and functions in Structured Text: every bit is kept, and strictness of the machine that runs the text."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from structured_text_grammar import IllegalTextError
from structured_text_machine import program

from feeddrive.export.identifiers import bare
from feeddrive.export.structured_text_code import decimal, functions, initial, literal
from feeddrive.language import mathematics, ops
from feeddrive.language.errors import ParameterError
from feeddrive.language.graph import ELEMENTARY, Graph
from feeddrive.language.single import single_values
from slow_share import all_but

finite = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False)


def bits(x: float) -> bytes:
    """NaN has one meaning only; everything else, -0 as well, is compared by its bits."""
    return b"nan" if x != x else struct.pack("<d", x)


def constant(text: str, kind: str) -> float:
    """What an expression without variables is."""
    source = f"FUNCTION f : {kind}\nVAR_INPUT\n    x : {kind};\nEND_VAR\nf := {text};\nEND_FUNCTION\n"
    return program(source).functions["f"][0](0.0)


SAMPLES = [
    0.0,
    -0.0,
    0.1,
    1 / 3,
    -1 / 3,
    1e-5,
    1e16,
    2.0**53 + 2,
    1.7976931348623157e308,
    2.2250738585072014e-308,
    -7.5,
]


@given(finite)
def test_a_decimal_reads_back_to_the_same_bits(value: float) -> None:
    assert bits(float(decimal(value))) == bits(value)
    inside = literal(value)
    assert bits(constant(bare(inside), "LREAL")) == bits(value)
    assert "." in inside
    if "#" not in inside:
        assert float(np.float32(value)) == value


@pytest.mark.parametrize("value", [3e38, 3.1e38, 1.3e-38, 1.1e-38, 1e150, -(2.0**-1022), 2.0**1023])
def test_a_number_outside_of_short_reals_is_a_product_of_numbers_inside(value: float) -> None:
    """matiec reads an LREAL literal by `strtof` and refuses one that overflows or underflows there."""
    text = literal(value)
    assert ("*" in text) == (not 1.2e-38 < abs(value) <= 3e38)
    assert bits(constant(bare(text), "LREAL")) == bits(value)
    if "*" in text:
        with pytest.raises(ParameterError, match=r"law\.Kp = .* cannot be an initial value in Structured Text"):
            initial(value, "LREAL", "law.Kp")
    else:
        assert float(initial(value, "LREAL", "law.Kp")) == value


def test_the_machine_refuses_literals_and_arrays_that_matiec_refuses() -> None:
    with pytest.raises(IllegalTextError, match="beyond a short real"):
        constant("LREAL#1.0E39", "LREAL")
    with pytest.raises(IllegalTextError, match="beyond a short real"):
        constant("LREAL#1.0E-39", "LREAL")
    with pytest.raises(IllegalTextError, match="without the name of a type"):
        program(wrapped("y := x;", "    row : ARRAY[0..1] OF LREAL;\n"))


@given(st.floats(width=32, allow_nan=False, allow_infinity=False, allow_subnormal=False))
def test_a_short_decimal_reads_back_to_the_same_bits(value: float) -> None:
    assert np.float32(decimal(value, "REAL")).tobytes() == np.float32(value).tobytes()
    assert "REAL#" in literal(value, "REAL")


@pytest.mark.parametrize("value", SAMPLES)
def test_the_machine_reads_the_same_number(value: float) -> None:
    assert bits(constant(bare(literal(value)), "LREAL")) == bits(value)


INTERESTING = {
    "floor": [
        0.0,
        -0.0,
        0.3,
        -0.3,
        2.0**52,
        -(2.0**52),
        2.0**51 + 0.5,
        -(2.0**51) - 0.5,
        1e300,
        -1e300,
        4503599627370495.5,
    ],
    "power_of_two": [float(k) for k in range(-1022, 1024)],
    "exponent": [0.0, 1.0, -1.0, 2.0**-1022, 2.0**1023, 1.7976931348623157e308, 0.9999999999999999, 2.0 - 2.0**-52],
}


def own(name: str, real: str) -> Any:
    """A function that is printed with a block."""
    text = "\n".join(unit.text() for unit in functions([name], "own", real))
    return program(text, flush=real == "REAL").functions[f"own_{name}{'_real' if real == 'REAL' else ''}"][0]


def arguments(name: str) -> list[float]:
    """Where a function is to be tried."""
    rng = np.random.default_rng(1)
    points = INTERESTING.get(name, [0.0, -0.0, 1.0, -1.0, 1e-300, 800.0, -800.0, 1e9, 1.1e9, 1e308, -1e308])
    if name == "power_of_two":
        return points
    far = 10.0 ** rng.uniform(-300.0, 300.0, 300)
    return [*points, *map(float, rng.normal(0.0, 10.0, 700)), *map(float, far), math.inf, -math.inf, math.nan]


@pytest.mark.parametrize("name", sorted({*ELEMENTARY, *INTERESTING}))
def test_own_functions_have_the_bits_of_the_simulator(name: str) -> None:
    ours = own(name, "LREAL")
    function = getattr(mathematics, name, None) or getattr(ops, name)
    with np.errstate(all="ignore"):
        for x in arguments(name):
            assert bits(ours(x)) == bits(float(function(np.float64(x)))), (name, x)


@pytest.mark.parametrize(
    "name",
    all_but(
        ("exp", "sin", "floor"),
        sorted({*ELEMENTARY, *INTERESTING}),
        "the text of LREAL with other constants",
    ),
)
def test_own_functions_have_the_bits_of_single_precision(name: str) -> None:
    """Against the oracle of single precision, over its range: numbers below the normal ones count as zero."""
    ours = own(name, "REAL")
    with np.errstate(all="ignore"):
        points = np.array(arguments(name), dtype=np.float32)
    kept = np.isnan(points) | (points == 0.0) | (np.abs(points) >= np.float32(2.0**-126))
    points = points[kept & (np.isfinite(points) | (name in ELEMENTARY) | (name == "floor"))]
    if name == "power_of_two":
        points = points[np.abs(points) <= 126.0]
    graph = Graph()
    result = graph.apply(name, graph.input("x")).index
    (wanted,) = single_values(graph, [result], {"x": points})
    for x, expected in zip(points, wanted, strict=True):
        assert bits(ours(float(x))) == bits(float(expected)), (name, x)


def wrapped(body: str, declared: str = "") -> str:
    return (
        "TYPE pair :\nSTRUCT\n    a : LREAL := 1.0;\nEND_STRUCT;\nEND_TYPE\n"
        f"FUNCTION_BLOCK fb\nVAR_INPUT\n    x : LREAL;\n    go : BOOL;\n    k : DINT;\nEND_VAR\n"
        f"VAR_OUTPUT\n    y : LREAL;\nEND_VAR\nVAR\n    both : pair;\n    w : LREAL;\n{declared}END_VAR\n{body}\n"
        "END_FUNCTION_BLOCK\n"
    )


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("y := z;", "not declared"),
        ("y := X;", "not declared"),
        ("y := x + k;", "DINT where LREAL"),
        ("y := x + 1;", "DINT where LREAL"),
        ("y := x + go;", "BOOL where LREAL"),
        ("y := x * 0.1;", "needs its type"),
        ("y := x * REAL#0.5;", "REAL where LREAL"),
        ("x := 1.0;", "is an input"),
        ("y := both.b;", "pair has no b"),
        ("y := both;", "pair where LREAL"),
        ("IF x THEN\n    y := x;\nEND_IF;", "LREAL where BOOL"),
        ("y := EXP(x);", "no EXP"),
        ("y := k[LREAL_TO_DINT(x)];", "no elements"),
    ],
)
def test_the_machine_refuses(body: str, said: str) -> None:
    with pytest.raises(IllegalTextError, match=said):
        program(wrapped(body)).blocks["fb"].instance()


@pytest.mark.parametrize(
    "declared", ["    step : LREAL;\n", "    W : LREAL;\n", "    fb__x : LREAL;\n", "    q : FLOAT;\n"]
)
def test_the_machine_refuses_names(declared: str) -> None:
    with pytest.raises(IllegalTextError):
        program(wrapped("y := x;", declared))


def test_the_machine_refuses_what_was_never_written() -> None:
    block = program(wrapped("y := w + x;")).blocks["fb"].instance()
    with pytest.raises(TypeError):
        block.call(x=1.0, go=True, k=1)


def test_the_machine_computes() -> None:
    block = program(
        wrapped("w := x / 0.0;\nIF go AND (x > 1.0) THEN\n    y := both.a - x;\nELSE\n    y := -w;\nEND_IF;")
    )
    instance = block.blocks["fb"].instance()
    assert instance.call(x=3.0, go=True, k=0).y == -2.0
    assert instance.call(x=1.0).y == -np.inf


SOUND = wrapped("y := x;")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("END_STRUCT;", "END_STRUCT", "; is missing"),
        ("y := x;", "y := x", "; is missing"),
        ("y := x;", "IF go THEN y := x; END_IF", "; is missing"),
        ("y := x;", "IF go THEN END_IF;", "a name is missing"),
        ("y := x;", "", "a name is missing"),
        ("y := x;", "y := 1.;", "; is missing"),
        ("y := x;", "y := 1E5;", "is no number"),
        ("y := x;", "y := x;;;", ""),
        ("y := x;", "y = x;", ":= is missing"),
        ("y := x;", "y := x; (* a (* b *) c *)", "comment within a comment"),
        ("y := x;", "y := x; // so", "a name is missing"),
        ("y := x;", "y := - - x;", "a name is missing"),
        ("y := x;", "y := x \u00b7 x;", "is no symbol"),
        ("k : DINT;", "k_ : DINT;", "a legal name"),
        ("k : DINT;", "k__k : DINT;", "a legal name"),
        ("a : LREAL := 1.0;", "", "a name is missing"),
        ("END_VAR\nVAR_OUTPUT", "VAR_OUTPUT", "a name is missing"),
        ("END_FUNCTION_BLOCK", "END_FUNCTION", "a name is missing"),
    ],
)
def test_the_grammar_refuses(old: str, new: str, said: str) -> None:
    """What some vendors take and the standard does not; blark, a grammar of TwinCAT's dialect, takes some of it."""
    program(SOUND)
    changed = SOUND.replace(old, new, 1)
    assert changed != SOUND
    if not said:
        program(changed)
        return
    with pytest.raises(IllegalTextError, match=said):
        program(changed)
