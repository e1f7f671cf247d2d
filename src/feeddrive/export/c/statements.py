"""The statements and expressions of exported C, from the nodes of a graph."""

from __future__ import annotations

import math
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib import import_module
from types import ModuleType

import numpy as np

from feeddrive.export.identifiers import C_WORDS, bare, identifier
from feeddrive.export.layout import truths, word
from feeddrive.language import mathematics
from feeddrive.language.graph import ELEMENTARY, Graph, arguments, reachable
from feeddrive.language.matrix import SQUARINGS, TOO_LARGE
from feeddrive.language.naming import Name
from feeddrive.language.primitives import MIX, STRIDES

_LINE = 112  # characters of a line, indented by 4
# words that the functions themselves use
_TAKEN = frozenset(
    {"controller", "plant", "parameters", "design", "state", "inputs", "outputs", "old", "before", "matrix"}
)


class Body:
    """Statements that compute some nodes of a graph, in the order of the law's text.

    `leaves` gives the text of what is there already, `makers` and `titles` what stands above the lines of a block.
    """

    def __init__(
        self,
        graph: Graph,
        truth: list[bool],
        leaves: Mapping[int, str],
        names: Mapping[int, Name],
        makers: Mapping[int, str],
        real: str,
        titles: Callable[[str], str],
    ) -> None:
        self.graph, self.truth, self.real = graph, truth, real
        self.names, self.makers, self.titles = names, makers, titles
        self.texts: dict[int, str] = dict(leaves)
        self.lines: list[str] = []
        self.used: set[str] = set()
        self._taken = {*_TAKEN, *CALLS.values(), *FUNCTIONS}
        self._owner: str | None = None
        self._unnamed = 0
        self._counts: Counter[int] = Counter()

    def text(self, index: int) -> str:
        """The text of a node: what stands for it, or a constant."""
        node = self.graph.nodes[index]
        if index not in self.texts and node[0] == "const":
            self.texts[index] = number(float.fromhex(node[1]), self.real)
        if index not in self.texts and node[0] == "truth":
            self.texts[index] = "true" if node[1] else "false"
        return self.texts[index]

    def compute(self, order: Iterable[int], kept: Iterable[int]) -> None:
        """Statements for the nodes of an order; those that are kept, or used more than once, get a name."""
        order = [index for index in order if index not in self.texts]
        self._counts = Counter(i for index in order for i in arguments(self.graph.nodes[index]))
        self._counts.update(2 * list(kept))
        chosen = {i for index in order if self.graph.name(index) == "select" for i in self.graph.nodes[index][2:]}
        for index in order:
            node = self.graph.nodes[index]
            values = [self.text(i) for i in arguments(node)]
            if node[0] == "decays":
                self.used.add(node[0])
                self._matrix(index, values)
                continue
            if node[0] in ELEMENTARY:
                text = f"exact_{node[0]}{'f' if self.real == 'float' else ''}({bare(values[0])})"
            else:
                text = expression(node[0], values, self.real)
            self.used.add(node[0])
            named = self.names.get(index)
            # what a `?:` chooses stays in it, however long: with a name it would be computed in every sample
            inner = node[0] == "select" and index in chosen and self._counts[index] == 1
            long = len(text) > WIDTH and node[0] != "select"
            if (named is not None and not inner) or self._counts[index] > 1 or long:
                self._declare(index, named, bare(text))
            else:
                self.texts[index] = text

    def _matrix(self, index: int, values: list[str]) -> None:
        """Whether the powers of a matrix decay, in a block of its own, so that its numbers are soon forgotten."""
        size = math.isqrt(len(values))
        self._unnamed += 1
        self.texts[index] = f"v{self._unnamed}"
        self.lines += [f"bool v{self._unnamed};", "{", f"    double matrix[{2 * len(values)}] = {{0}};"]
        self.lines += [f"    matrix[{k}] = {bare(text)};" for k, text in enumerate(values) if text != "0.0"]
        self.lines += [f"    v{self._unnamed} = decays(matrix, {size});", "}"]

    def _declare(self, index: int, named: Name | None, text: str) -> None:
        owner = named.owner if named is not None else self.makers.get(index)
        if owner is not None and owner != self._owner:
            self._owner = owner
            self.lines += ["", f"/* {self.titles(owner)} */"]
        if named is None:
            self._unnamed += 1
        name = f"v{self._unnamed}" if named is None else identifier(word(named), self._taken, C_WORDS)
        self.texts[index] = name
        line = f"const {'bool' if self.truth[index] else self.real} {name} = {text};"
        self.lines += wrapped(line)

    def assign(self, targets: Iterable[tuple[str, int]], cast: str = "") -> None:
        """`place = number;` for each, at once: what is overwritten and still wanted is taken first."""
        moved = [(place, self.text(index)) for place, index in targets if self.text(index) != place]
        places = {place for place, _ in moved}
        held: dict[str, str] = {}
        for _, text in moved:
            if text in places and text not in held:
                held[text] = identifier(f"last_{text.rpartition('>')[2]}", self._taken, C_WORDS)
                self.lines.append(f"const {self.real} {held[text]} = {text};")
        self.lines += [f"{place} = {cast}{held.get(text, text if cast else bare(text))};" for place, text in moved]


def wrapped(line: str) -> list[str]:
    """A statement in lines of a readable length; one that chooses among several has a line for each."""
    if len(line) <= _LINE:
        return [line]
    head, assigned, value = line.partition(" = ")
    pieces = _choices(value.removesuffix(";")) if assigned else []
    if len(pieces) < 3:
        return textwrap.wrap(line, _LINE, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
    rows = [f"{head} = {pieces[0]}", *(f"    : ({each}" for each in pieces[1:-1]), f"    : {pieces[-1]}"]
    rows[-1] += ")" * (len(pieces) - 2) + ";"
    fill = textwrap.TextWrapper(_LINE, subsequent_indent=" " * 8, break_long_words=False, break_on_hyphens=False)
    return [text for row in rows for text in fill.wrap(row) or [row]]


def _choices(text: str) -> list[str]:
    """`a ? b : (c ? d : e)` -> `a ? b`, `c ? d`, `e`: what is asked one after the other."""
    depth, asked = 0, False
    for place, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and letter == "?":
            asked = True
        if depth == 0 and letter == ":" and asked:
            rest = text[place + 2 :]
            inner = _choices(rest[1:-1]) if rest.startswith("(") and bare(rest) == rest[1:-1] else [rest]
            return [text[: place - 1], *(inner if len(inner) > 1 else [rest])]
    return [text]


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


INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "eq": "==", "and": "&&", "or": "||"}
CALLS = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor"} | {name: name for name in ELEMENTARY}
WIDTH = 72  # an expression longer than this is cut by giving a part of it a name
# words of C, and names that the text itself uses
RESERVED = re.findall(
    r"\w+",
    "auto break case char const constants continue count default do double else enum extern first float for goto if "
    "inline inputs int k long mode outputs register restrict return short signed sizeof states static struct switch "
    "tables typedef union unsigned void volatile while HUGE_VAL flush restore",
)


def _bits(real: str, bits: int, place: int, suffix: str) -> dict[str, str]:
    """Functions on the exponent of a number of so many bits, which stands from `place` on: by memcpy, as C has it."""
    exponents = (1 << (bits - 1 - place)) - 1
    bias, whole = exponents // 2, f"{1.5 * 2.0**place:.1f}{suffix}"
    return {
        f"power_of_two{suffix}": f"""\
/* 2^k: k + 1.5 * 2^{place} holds the whole number k in its low bits; \
k + {bias} goes to where a {real} keeps its exponent. */
static {real} power_of_two{suffix}({real} k)
{{
    {real} x = k + {whole};
    uint{bits}_t bits;
    (void)memcpy(&bits, &x, sizeof bits);
    bits = (bits + {bias}u) << {place};
    (void)memcpy(&x, &bits, sizeof bits);
    return x;
}}
""",
        f"exponent{suffix}": f"""\
/* The whole number k with 2^k <= |x| < 2^(k+1). */
static {real} exponent{suffix}({real} x)
{{
    uint{bits}_t bits;
    (void)memcpy(&bits, &x, sizeof bits);
    bits = (bits >> {place}) & 0x{exponents:X}u;
    return ({real})bits - {bias}.0{suffix};
}}
""",
    }


# What C has no operator for.
FUNCTIONS = {
    **_bits("double", 64, 52, ""),
    **_bits("float", 32, 23, "f"),
    "decays": f"""\
/* Do the powers of a matrix of n rows fall towards 0? They stand in the 2 n n numbers of `rows`, row by row. */
static bool decays(double *rows, int n)
{{
    double *now = rows;
    double *next = &rows[n * n];
    for (int squaring = 0; squaring < {SQUARINGS}; squaring++) {{
        bool small = true;
        for (int i = 0; i < n; i++) {{
            double norm = fabs(now[i * n]);
            for (int k = 1; k < n; k++) {{
                norm = norm + fabs(now[(i * n) + k]);
            }}
            if (!(norm < {TOO_LARGE})) {{
                return false;
            }}
            small = small && (norm < 1.0);
        }}
        if (small) {{
            return true;
        }}
        for (int i = 0; i < n; i++) {{
            for (int j = 0; j < n; j++) {{
                double sum = now[i * n] * now[j];
                for (int k = 1; k < n; k++) {{
                    sum = sum + (now[(i * n) + k] * now[(k * n) + j]);
                }}
                next[(i * n) + j] = sum;
            }}
        }}
        double *const done = now;
        now = next;
        next = done;
    }}
    return false;
}}
""",
    "uniform": f"""\
/* A random number in (0, 1) that depends on three whole numbers only: the finaliser of SplitMix64, once over each. */
static double uniform(double seed, double sample, double channel)
{{
    const double given[3] = {{seed, sample, channel}};
    const uint64_t strides[3] = {{{", ".join(f"0x{stride:X}u" for stride in STRIDES)}}};
    uint64_t bits = 0;
    for (int i = 0; i < 3; i++) {{
        bits = (bits + (uint64_t)given[i] + 1u) * strides[i];
        bits = (bits ^ (bits >> 30)) * 0x{MIX[0]:X}u;
        bits = (bits ^ (bits >> 27)) * 0x{MIX[1]:X}u;
        bits = bits ^ (bits >> 31);
    }}
    bits = bits >> 12;
    return ((double)bits + 0.5) * 0x1p-52;
}}
""",
}

# Numbers below the normal ones count as 0, as in the native code: they are slow and mean nothing here.
FLUSH = """\
#if defined(__SSE2__) || defined(_M_X64)
#include <xmmintrin.h>
static uint64_t flush(void) { unsigned int mode = _mm_getcsr(); _mm_setcsr(mode | 0x8040u); return mode; }
static void restore(uint64_t mode) { _mm_setcsr((unsigned int)mode); }
#elif defined(__aarch64__) && defined(__GNUC__)
static uint64_t flush(void)
{
    uint64_t mode;
    __asm__ __volatile__("mrs %0, fpcr" : "=r"(mode));
    __asm__ __volatile__("msr fpcr, %0" : : "r"(mode | (UINT64_C(1) << 24)));
    return mode;
}
static void restore(uint64_t mode) { __asm__ __volatile__("msr fpcr, %0" : : "r"(mode)); }
#else
static uint64_t flush(void) { return 0; }
static void restore(uint64_t mode) { (void)mode; }
#endif
"""


def number(value: float, real: str = "double") -> str:
    """A number as C writes it: short decimals that are exact as such, all others by their bits."""
    suffix = "f" if real == "float" else ""
    value = float(np.float32(value)) if real == "float" else value
    if value in (float("inf"), float("-inf")):
        most = "INFINITY" if real == "float" else "HUGE_VAL"
        return most if value > 0.0 else f"(-{most})"
    text = repr(value)
    if abs(value) >= 1e6 and value % 1e6 == 0.0 and abs(value) < 1e19:
        text = f"{value:.1f}"
    elif abs(value) >= 1e6 or (16.0 * value) % 1.0 != 0.0:
        text = re.sub(r"\.?0*p", "p", value.hex())
    return f"({text}{suffix})" if text.startswith("-") else f"{text}{suffix}"


def expression(name: str, values: list[str], real: str = "double") -> str:
    """An operation as text, in parentheses where it has an operator."""
    suffix = "f" if real == "float" else ""
    if name in INFIX:
        return f"({values[0]} {INFIX[name]} {values[1]})"
    if name in CALLS:
        return f"{CALLS[name]}{suffix}({bare(values[0])})"
    if name == "select":
        return f"({values[0]} ? {values[1]} : {values[2]})"
    if name in ("gather", "get"):
        return f"{values[0]}[(int64_t){values[1]}]"
    if name in ("neg", "not"):
        return f"({'-' if name == 'neg' else '!'}{values[0]})"
    if name in FUNCTIONS:
        return f"{name}{suffix}({', '.join(map(bare, values))})"
    raise AssertionError(f"no text for the operation '{name}'")
