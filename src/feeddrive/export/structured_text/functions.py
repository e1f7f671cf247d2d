"""Functions that IEC 61131-3 lacks or does not define to the last bit, printed with the block that calls them.

The elementary functions are those of the simulator, traced from the same lines; a PLC's own EXP has other last bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from importlib import import_module

from feeddrive.export.identifiers import ST_WORDS, bare, identifier
from feeddrive.export.structured_text.statements import Statements
from feeddrive.export.structured_text.units import HUGE, INPUTS, OWN, VARIABLES, Declared, Unit, huge, literal, own
from feeddrive.language.graph import ELEMENTARY, Graph, reachable
from feeddrive.language.matrix import SQUARINGS, TOO_LARGE

_SAID = {
    "exp": "e^x.",
    "expm1": "e^x - 1, exact to the last bits for small x.",
    "log": "The natural logarithm; NaN for x < 0.",
    "sin": "The sine of x rad; NaN for angles too large to resolve.",
    "cos": "The cosine of x rad; NaN for angles too large to resolve.",
    "tanh": "The hyperbolic tangent.",
    "atan": "The arc tangent in rad.",
    "floor": "The largest whole number not above x. Beyond {whole} every number is whole; below, adding it rounds.",
    "power_of_two": "2^k for a whole number k from {lowest} to {highest}, by squaring: such products are exact.",
    "exponent": "The whole number k with 2^k <= |x| < 2^(k+1); {zero} for 0, {infinite} for what is not finite.",
}
_VARIABLES = {
    "floor": ("x", {"whole": "{real}"}),
    "power_of_two": ("k", {"rest": "DINT", "power": "{real}", "base": "{real}"}),
    "exponent": ("x", {"size": "{real}", "jump": "{real}", "k": "{real}"}),
}
_BODIES = {
    "floor": """\
IF x < {point} THEN
    whole := (x - {whole}) + {whole};
ELSE
    whole := (x + {whole}) - {whole};
END_IF;
IF whole > x THEN
    whole := whole - {one};
END_IF;
IF (ABS(x) < {whole}) AND (whole <> x) THEN
    {name} := whole;
ELSE
    {name} := x;
END_IF;""",
    "power_of_two": """\
rest := 0;
IF ABS(k) <= {highest} THEN
    rest := {real}_TO_DINT(ABS(k));
END_IF;
base := {two};
IF k < {point} THEN
    base := {half};
END_IF;
power := {one};
WHILE rest > 0 DO
    IF (rest MOD 2) = 1 THEN
        power := power * base;
    END_IF;
    rest := rest / 2;
    IF rest > 0 THEN
        base := base * base;
    END_IF;
END_WHILE;
{name} := power;""",
    "exponent": """\
size := ABS(x);
IF NOT (size <= {largest}) THEN
    {name} := {infinite};
ELSIF size < {least} THEN
    {name} := {zero};
ELSE
    k := {point};
    jump := {jump};
    WHILE jump >= {one} DO
        IF size >= {power}(jump) THEN
            size := size * {power}(-jump);
            k := k + jump;
        ELSIF size < {power}({one} - jump) THEN
            size := size * {power}(jump);
            k := k - jump;
        END_IF;
        jump := {half} * jump;
    END_WHILE;
    {name} := k;
END_IF;""",
}
_RANGE = {  # of a real: digits of its fraction, its exponents, its largest number
    "LREAL": {"whole": 2.0**52, "lowest": -1022.0, "highest": 1023.0, "zero": -1023.0, "infinite": 1024.0,
              "largest": 1.7976931348623157e308, "least": 2.0**-1022, "jump": 512.0},
    "REAL": {"whole": 2.0**23, "lowest": -126.0, "highest": 127.0, "zero": -127.0, "infinite": 128.0,
             "largest": 3.4028234663852886e38, "least": 2.0**-126, "jump": 64.0},
}  # fmt: skip


def functions(used: Iterable[str], prefix: str, real: str = "LREAL") -> list[Unit]:
    """The functions that some operations need, each behind those that it calls itself."""
    found: dict[str, Unit] = {}
    for name in sorted(set(used) & OWN):
        _add(found, name, prefix, real)
    for name in sorted(each for each in used if each.startswith("decays_")):
        found[name] = _decays(int(name.removeprefix("decays_")), own(prefix, name, real), real)
    return list(found.values())


def _decays(size: int, name: str, real: str) -> Unit:
    """Whether the powers of a matrix fall towards 0."""
    n, array = math.isqrt(size), f"ARRAY[0..{size - 1}] OF {real}"
    numbers = {"one": literal(1.0, real), "large": literal(TOO_LARGE, real)}
    counts = [Declared(each, "DINT") for each in ("squaring", "i", "j", "k")]
    return Unit(
        name,
        f"Whether the powers of a matrix of {n} rows, which stand one behind the other, fall towards 0.",
        "BOOL",
        {
            INPUTS: [Declared("matrix", array)],
            VARIABLES: [
                Declared("now", array), Declared("next", array), Declared("norm", real), Declared("sum", real),
                Declared("done", "BOOL"), Declared("broken", "BOOL"), *counts,
            ],
        },
        _DECAYS.format(name=name, n=n, last=n - 1, most=SQUARINGS, **numbers).split("\n"),
    )  # fmt: skip


_DECAYS = """\
{name} := FALSE;
done := FALSE;
squaring := 0;
now := matrix;
WHILE (NOT done) AND (squaring < {most}) DO
    broken := FALSE;
    {name} := TRUE;
    FOR i := 0 TO {last} DO
        norm := ABS(now[i * {n}]);
        FOR k := 1 TO {last} DO
            norm := norm + ABS(now[(i * {n}) + k]);
        END_FOR;
        broken := broken OR (NOT (norm < {large}));
        {name} := {name} AND (norm < {one});
    END_FOR;
    done := broken OR {name};
    IF NOT done THEN
        FOR i := 0 TO {last} DO
            FOR j := 0 TO {last} DO
                sum := now[i * {n}] * now[j];
                FOR k := 1 TO {last} DO
                    sum := sum + (now[(i * {n}) + k] * now[(k * {n}) + j]);
                END_FOR;
                next[(i * {n}) + j] := sum;
            END_FOR;
        END_FOR;
        now := next;
    END_IF;
    squaring := squaring + 1;
END_WHILE;
{name} := {name} AND (NOT broken);"""


def _add(found: dict[str, Unit], name: str, prefix: str, real: str) -> None:
    if name in found:
        return
    if name in ELEMENTARY:
        graph = Graph()
        root = getattr(_module(real), name)(graph.input("x")).index
        for inner in sorted({graph.name(index) for index in reachable(graph, [root])} & OWN):
            _add(found, inner, prefix, real)
        found[name] = _elementary(name, graph, root, prefix, real)
        return
    if name == "exponent":
        _add(found, "power_of_two", prefix, real)
    found[name] = _plain(name, prefix, real)


def _module(real: str) -> object:
    return import_module(f"feeddrive.language.{'mathematics' if real == 'LREAL' else 'single'}")


def _plain(name: str, prefix: str, real: str) -> Unit:
    numbers = {"point": 0.0, "half": 0.5, "one": 1.0, "two": 2.0, **_RANGE[real]}
    texts = {key: bare(literal(value, real)) for key, value in numbers.items()}
    given, variables = _VARIABLES[name]
    names = {"real": real, "name": own(prefix, name, real), "power": own(prefix, "power_of_two", real)}
    body = _BODIES[name].format(**names, **texts)
    said = _SAID[name].format(**{key: f"{value:.0f}" for key, value in numbers.items() if abs(value) < 1e17})
    declared = [Declared(each, kind.format(real=real)) for each, kind in variables.items()]
    return Unit(
        own(prefix, name, real), said, real, {INPUTS: [Declared(given, real)], VARIABLES: declared}, body.split("\n")
    )


def _elementary(name: str, graph: Graph, root: int, prefix: str, real: str) -> Unit:
    """A function whose body is the plain arithmetic of the simulator."""
    function = own(prefix, name, real)
    taken = {"x", HUGE, function}
    variables: list[Declared] = []

    def declare(index: int, kind: str) -> str:
        if index == root:
            return function
        variables.append(Declared(identifier(f"v{len(variables) + 1}", taken, ST_WORDS), kind))
        return variables[-1].name

    statements = Statements(graph, {graph.input("x").index: "x"}, declare, (), prefix, real)
    body = [line for statement in statements.compute([root], [root]) for line in statement.lines()]
    if any(HUGE in line for line in body):
        variables.insert(0, huge(real))
    return Unit(function, _SAID[name], real, {INPUTS: [Declared("x", real)], VARIABLES: variables}, body)
