"""The functions that Structured Text lacks or leaves to the maker: exact ones, printed with the block that calls them.

The elementary functions are those of the simulator, traced from the same lines; a PLC's own EXP has other last bits.
"""

from __future__ import annotations

from collections.abc import Iterable

from feeddrive.artefacts.export.identifiers import ST_WORDS, identifier
from feeddrive.artefacts.export.structured_text.statements import INDENT, Statements
from feeddrive.artefacts.export.structured_text.words import HUGE, OWN
from feeddrive.language import mathematics
from feeddrive.language.graph import ELEMENTARY, Graph, reachable

_PLAIN = {
    "floor": """\
(* The largest whole number not above x.  Adding 2^52 rounds to a whole number; beyond it every number is whole. *)
FUNCTION {prefix}_floor : LREAL
VAR_INPUT
    x : LREAL;
END_VAR
VAR
    whole : LREAL;
END_VAR
IF x < 0.0 THEN
    whole := (x - 4503599627370496.0) + 4503599627370496.0;
ELSE
    whole := (x + 4503599627370496.0) - 4503599627370496.0;
END_IF;
IF whole > x THEN
    whole := whole - 1.0;
END_IF;
IF (ABS(x) < 4503599627370496.0) AND (whole <> x) THEN
    {prefix}_floor := whole;
ELSE
    {prefix}_floor := x;
END_IF;
END_FUNCTION
""",
    "power_of_two": """\
(* 2^k for a whole number k from -1022 to 1023, by squaring: products of powers of two are exact. *)
FUNCTION {prefix}_power_of_two : LREAL
VAR_INPUT
    k : LREAL;
END_VAR
VAR
    rest : DINT;
    power : LREAL;
    base : LREAL;
END_VAR
rest := 0;
IF ABS(k) <= 1023.0 THEN
    rest := LREAL_TO_DINT(ABS(k));
END_IF;
base := 2.0;
IF k < 0.0 THEN
    base := 0.5;
END_IF;
power := 1.0;
WHILE rest > 0 DO
    IF (rest MOD 2) = 1 THEN
        power := power * base;
    END_IF;
    rest := rest / 2;
    IF rest > 0 THEN
        base := base * base;
    END_IF;
END_WHILE;
{prefix}_power_of_two := power;
END_FUNCTION
""",
    "exponent": """\
(* The whole number k with 2^k <= |x| < 2^(k+1); -1023 for 0, 1024 for what is not finite. *)
FUNCTION {prefix}_exponent : LREAL
VAR_INPUT
    x : LREAL;
END_VAR
VAR
    size : LREAL;
    jump : LREAL;
    k : LREAL;
END_VAR
size := ABS(x);
IF NOT (size <= LREAL#1.7976931348623157E308) THEN
    {prefix}_exponent := 1024.0;
ELSIF size < LREAL#2.2250738585072014E-308 THEN
    {prefix}_exponent := -1023.0;
ELSE
    k := 0.0;
    jump := 512.0;
    WHILE jump >= 1.0 DO
        IF size >= {prefix}_power_of_two(jump) THEN
            size := size * {prefix}_power_of_two(-jump);
            k := k + jump;
        ELSIF size < {prefix}_power_of_two(1.0 - jump) THEN
            size := size * {prefix}_power_of_two(jump);
            k := k - jump;
        END_IF;
        jump := 0.5 * jump;
    END_WHILE;
    {prefix}_exponent := k;
END_IF;
END_FUNCTION
""",
}


def functions(used: Iterable[str], prefix: str) -> dict[str, str]:
    """Name -> text of the functions that some operations need, each behind those that it calls itself."""
    found: dict[str, str] = {}
    for name in sorted(set(used) & OWN):
        _add(found, name, prefix)
    return found


def _add(found: dict[str, str], name: str, prefix: str) -> None:
    if name in found:
        return
    if name in _PLAIN:
        if name == "exponent":
            _add(found, "power_of_two", prefix)
        found[name] = _PLAIN[name].format(prefix=prefix)
        return
    graph, root = _traced(name)
    for inner in sorted({graph.name(index) for index in reachable(graph, [root])} & OWN):
        _add(found, inner, prefix)
    found[name] = _elementary(name, graph, root, prefix)


def _traced(name: str) -> tuple[Graph, int]:
    assert name in ELEMENTARY
    graph = Graph()
    return graph, getattr(mathematics, name)(graph.input("x")).index


def _elementary(name: str, graph: Graph, root: int, prefix: str) -> str:
    """A function whose body is the plain arithmetic of `language/mathematics.py`."""
    taken = {"x", HUGE, f"{prefix}_{name}"}
    variables: dict[str, str] = {}

    def declare(index: int, kind: str) -> str:
        if index == root:
            return f"{prefix}_{name}"
        variable = identifier(f"v{len(variables) + 1}", taken, ST_WORDS)
        variables[variable] = kind
        return variable

    x = graph.input("x").index
    statements = Statements(graph, {x: "x"}, declare, (), prefix)
    body = [line for statement in statements.compute([root], [root]) for line in statement.lines()]
    title = (getattr(mathematics, name).__doc__ or name).splitlines()[0]
    return "\n".join(
        [
            f"(* {name}: {title} *)",
            f"FUNCTION {prefix}_{name} : LREAL",
            "VAR_INPUT",
            f"{INDENT}x : LREAL;",
            "END_VAR",
            "VAR",
            *([f"{INDENT}{HUGE} : LREAL := 1.0E300;"] if any(HUGE in line for line in body) else []),
            *(f"{INDENT}{variable} : {kind};" for variable, kind in variables.items()),
            "END_VAR",
            *body,
            "END_FUNCTION",
            "",
        ]
    )
