"""Elementary functions as C: the plain arithmetic of the simulation, since those of libraries differ in bits."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType

from feeddrive.export.c.body import Body
from feeddrive.export.c.expressions import FUNCTIONS, bare
from feeddrive.export.layout import truths
from feeddrive.language import mathematics
from feeddrive.language.graph import ELEMENTARY, Graph, reachable

_SAID = {
    "exp": "e^x",
    "expm1": "e^x - 1, exact to the last bits for small x",
    "log": "The natural logarithm; NaN for x < 0.",
    "sin": "The sine of x rad; NaN beyond 1e9 rad.",
    "cos": "The cosine of x rad; NaN beyond 1e9 rad.",
    "tanh": "The hyperbolic tangent.",
    "atan": "The arc tangent in rad.",
}


def helpers(used: set[str], real: str) -> list[str]:
    """The functions that statements need, those first that others need; `used` is told of what these need in turn."""
    suffix = "f" if real == "float" else ""
    wanted = [name for name in sorted(ELEMENTARY) if name in used]
    texts = []
    for name in wanted:
        text, more = _printed(name, real)
        used |= more
        texts.append(text)
    return [
        FUNCTIONS[f"{name}{suffix}" if f"{name}{suffix}" in FUNCTIONS else name]
        for name in ("power_of_two", "exponent", "uniform", "decays")
        if name in used
    ] + texts


@cache
def _printed(name: str, real: str) -> tuple[str, frozenset[str]]:
    """One function, and the operations that it uses."""
    graph = Graph()
    given = graph.input("x")
    result = graph.symbol(getattr(_module(real), name)(given)).index
    body = Body(graph, truths(graph), {given.index: "x"}, {}, {}, real, str)
    body.compute([i for i in reachable(graph, [result]) if graph.nodes[i][0] not in ("const", "truth")], ())
    lines = "".join(f"    {line}\n" for line in [*body.lines, f"return {bare(body.text(result))};"])
    suffix = "f" if real == "float" else ""
    text = f"/* {_SAID[name]} */\nstatic {real} exact_{name}{suffix}({real} x)\n{{\n{lines}}}\n"
    return text, frozenset(body.used)


def _module(real: str) -> ModuleType:
    if real == "double":
        return mathematics
    return import_module("feeddrive.language.single")
