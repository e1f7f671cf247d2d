"""Generation of C99 code from a routine: expressions and statements, checks of the arithmetic, header and sources.

The header declares structs with units and meanings; one source file contains `step` and `reset`, a second one the
functions that run outside the interrupt.  `header_only` combines all three files into a single header.
"""

import inspect
import math
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from types import ModuleType

import numpy as np

from feeddrive.export.identifiers import C_WORDS, ascii_text, bare, identifier
from feeddrive.export.layout import Layout, truths, word
from feeddrive.language import mathematics
from feeddrive.language.block import LARGEST, Block
from feeddrive.language.graph import ELEMENTARY, Graph, arguments, reachable
from feeddrive.language.matrix import SQUARINGS, TOO_LARGE
from feeddrive.language.naming import Name
from feeddrive.language.primitives import MIX, STRIDES
from feeddrive.loop import guard as guards
from feeddrive.loop.routine import Routine, Variable, off_outputs

# The statements and expressions of exported C, from the nodes of a graph.

_LINE = 112  # characters of a line, indented by 4
# names that the functions themselves use
_TAKEN = frozenset(
    {"controller", "plant", "parameters", "design", "state", "inputs", "outputs", "old", "before", "matrix"}
)


class Body:
    """The C statements that compute the given nodes of a graph, in the order of the law's source.

    `leaves` maps nodes whose values already exist to their C text.  `makers` gives the block that computes a node, and
    `titles` the heading above the lines of a block.
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
        """Return the C text of a node: a leaf, a variable, an inline expression or a constant."""
        node = self.graph.nodes[index]
        if index not in self.texts and node[0] == "const":
            self.texts[index] = number(float.fromhex(node[1]), self.real)
        if index not in self.texts and node[0] == "truth":
            self.texts[index] = "true" if node[1] else "false"
        return self.texts[index]

    def compute(self, order: Iterable[int], kept: Iterable[int]) -> None:
        """Emit statements for nodes in order.

        Nodes in `kept` and nodes used more than once become variables; others are written inline if they are short.
        """
        order = [index for index in order if index not in self.texts]
        self._counts = Counter(i for index in order for i in arguments(self.graph.nodes[index]))
        # twice: a kept node becomes a variable even if no other node reads it
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
            # branches of a `?:` stay inline, however long: as variables they would be computed in every sample
            inner = node[0] == "select" and index in chosen and self._counts[index] == 1
            long = len(text) > WIDTH and node[0] != "select"
            if (named is not None and not inner) or self._counts[index] > 1 or long:
                self._declare(index, named, bare(text))
            else:
                self.texts[index] = text

    def _matrix(self, index: int, values: list[str]) -> None:
        """Emit the test of whether the powers of a matrix decay, in a separate scope, which frees its memory early."""
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
        """Emit assignments that act as if simultaneous: values overwritten before they are read are saved first."""
        moved = [(place, self.text(index)) for place, index in targets if self.text(index) != place]
        places = {place for place, _ in moved}
        held: dict[str, str] = {}
        for _, text in moved:
            if text in places and text not in held:
                held[text] = identifier(f"last_{text.rpartition('>')[2]}", self._taken, C_WORDS)
                self.lines.append(f"const {self.real} {held[text]} = {text};")
        self.lines += [f"{place} = {cast}{held.get(text, text if cast else bare(text))};" for place, text in moved]


def wrapped(line: str) -> list[str]:
    """Wrap a long statement; a chain of conditionals gets one line per case."""
    if len(line) <= _LINE:
        return [line]
    head, assigned, value = line.partition(" = ")
    pieces = _choices(value.removesuffix(";")) if assigned else []
    if len(pieces) < 3:
        return textwrap.wrap(line, _LINE, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
    rows = [f"{head} = {pieces[0]}", *(f"    : ({piece}" for piece in pieces[1:-1]), f"    : {pieces[-1]}"]
    rows[-1] += ")" * (len(pieces) - 2) + ";"
    fill = textwrap.TextWrapper(_LINE, subsequent_indent=" " * 8, break_long_words=False, break_on_hyphens=False)
    return [text for row in rows for text in fill.wrap(row) or [row]]


def _choices(text: str) -> list[str]:
    """Split `a ? b : (c ? d : e)` into `a ? b`, `c ? d`, `e`, in evaluation order."""
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
    """Return the helper functions that the operations `used` call, dependencies first.

    The operations that the helpers themselves use are added to `used`.
    """
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
    """Return the text of a function and the operations that it uses."""
    graph = Graph()
    argument = graph.input("x")
    result = graph.symbol(getattr(_module(real), name)(argument)).index
    body = Body(graph, truths(graph), {argument.index: "x"}, {}, {}, real, str)
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
WIDTH = 72  # a longer expression is split by introducing a variable
# keywords of C, and names that the text itself uses
RESERVED = re.findall(
    r"\w+",
    "auto break case char const constants continue count default do double else enum extern first float for goto if "
    "inline inputs int k long mode outputs register restrict return short signed sizeof states static struct switch "
    "tables typedef union unsigned void volatile while HUGE_VAL flush restore",
)


def _bits(real: str, bits: int, place: int, suffix: str) -> dict[str, str]:
    """Return the C functions that read and write the exponent field of a floating-point number of `bits` bits.

    The field starts at bit `place`. The functions use memcpy, since C defines no other conversion from number to bits.
    """
    exponents = (1 << (bits - 1 - place)) - 1
    # 1.5 and not 1: the sum with a negative k keeps its exponent, too
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


# Operations without an operator in C.
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

# Subnormal numbers count as 0, as in the native code: they are slow and insignificant here.
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
    """Return a number as C source: a short decimal if that is exact, otherwise the hexadecimal form with all bits."""
    suffix = "f" if real == "float" else ""
    value = float(np.float32(value)) if real == "float" else value
    if value in (float("inf"), float("-inf")):
        most = "INFINITY" if real == "float" else "HUGE_VAL"
        return most if value > 0.0 else f"(-{most})"
    text = repr(value)
    if abs(value) >= 1e6 and value % 1e6 == 0.0 and abs(value) < 1e19:
        text = f"{value:.1f}"
    # multiples of 1/16 below a million have a decimal of at most ten digits that is exact
    elif abs(value) >= 1e6 or (16.0 * value) % 1.0 != 0.0:
        text = re.sub(r"\.?0*p", "p", value.hex())
    return f"({text}{suffix})" if text.startswith("-") else f"{text}{suffix}"


def expression(name: str, values: list[str], real: str = "double") -> str:
    """Return an operation as C text, parenthesized if it contains an operator."""
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


# Checks that the compiler rounds as the simulation does: conditions in the header, and a test at startup.
#
# A compiler may change the order of sums (-fassociative-math), divide by multiplying with a reciprocal
# (-freciprocal-math), round a product and a sum once (-ffp-contract=fast) or compute wider than the numbers (x87).
# Each changes the last bits.  If a macro reveals the option, the header does not compile; otherwise `configure`
# fails.

# With the first options a compiler assumes that NaN cannot occur, and removes the checks for it.
STRICT = (
    "#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0) || defined(_M_FP_FAST)",
    '#error "compile without -ffast-math, -ffinite-math-only, /fp:fast: broken readings could not be detected"',
    "#endif",
    "#if defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || defined(__NO_SIGNED_ZEROS__)",
    '#error "compile without -funsafe-math-optimizations and its parts: the bits would not be those of the simulation"',
    "#endif",
)


def strict(real: str) -> list[str]:
    """Return the lines of the header that refuse compiler options with which the bits would be others."""
    # 16 (ARM half precision): float and double are not widened; 1 (s390x in strict C99): float alone is
    allowed = ("0", "16", "1") if real == "double" else ("0", "16")
    return [
        *STRICT,
        f"#if defined(FLT_EVAL_METHOD) && {' && '.join(f'(FLT_EVAL_METHOD != {method})' for method in allowed)}",
        '#error "FLT_EVAL_METHOD is not 0, as on an x87: compile for SSE2, as with -msse2 -mfpmath=sse"',
        "#endif",
        "",
    ]


CODE = -1
"""The result of `P_broken_rule` if the check of the arithmetic fails, whatever the parameters are."""
SENTENCE = (
    "every operation is rounded by itself, in the order in which it is written: compile without "
    "-funsafe-math-optimizations, with -ffp-contract=off and not for an x87"
)


def rules(routine: Routine) -> dict[int, str]:
    """Return the meaning of each code of `P_broken_rule`: check of the arithmetic first, then parameter rules."""
    return {CODE: SENTENCE, **routine.sentences}


_DOUBLE, _FLOAT = "double", "float"
# a number that vanishes when added to 1; the distance from 1 of two numbers whose product rounds to 1; and a divisor
# whose product with its rounded reciprocal is not 1
_TINY = {_DOUBLE: 2.0**-60, _FLOAT: 2.0**-30}
_APART = {_DOUBLE: 2.0**-28, _FLOAT: 2.0**-13}
_DIVISOR = {_DOUBLE: 49.0, _FLOAT: 41.0}


def exact(signature: str, real: str) -> str:
    """Return a C function that tests whether sums, products and quotients are rounded as in the simulation.

    The operands are volatile, so that the test runs on the target instead of being evaluated by the compiler.
    """

    def text(value: float) -> str:
        return number(value, real)

    d = _DIVISOR[real]
    known = (1.0, _TINY[real], 1.0 + _APART[real], 1.0 - _APART[real], d, d, 2.0 * d, 4.0 * d, 8.0 * d)
    names = ("one", "tiny", "above", "below", "divisor", "first", "second", "third", "fourth")
    loads = "\n".join(f"    const {real} {name} = known[{i}];" for i, name in enumerate(names))
    return f"""\
/* Is every operation rounded by itself, to {real}, in the order in which it is written? Once, in configure. */
{signature}
{{
    static const volatile {real} known[{len(known)}] = {{
        {", ".join(map(text, known))}
    }};
{loads}
    const {real} sum = (one + tiny) - one;
    const {real} product = (above * below) - one;
    const bool quotients = ((first / divisor) == {text(1.0)}) && ((second / divisor) == {text(2.0)}) &&
        ((third / divisor) == {text(4.0)}) && ((fourth / divisor) == {text(8.0)}) &&
        ((first / {text(d)}) == {text(1.0)});
    return (sum == {text(0.0)}) && (product == {text(0.0)}) && quotients;
}}
"""


# The header of exported C: structs with units and meanings, and the functions.

_WIDTH = 116
_FLUSHES = re.compile(r"\b(flush|restore)\b")


def header(layout: Layout, title: str, made_by: str) -> str:
    """Return the text of P.h; `title` describes the design, `made_by` names the program and the machine file."""
    routine, real, P = layout.routine, layout.precision, layout.routine.name
    held = routine.memory
    guard = f"{P.upper()}_H"
    arguments = f"{P}_{held} *{held}"
    reset_outputs = f", {P}_outputs *outputs" if layout.reset.outputs else ""
    lines = [
        *comment(f"{title}\n\n{made_by}\n\n{_USE.format(P=P, held=held)}"),
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        "#include <float.h>",
        "#include <stdbool.h>",
        "#include <stdint.h>",
        "",
        "#ifdef __cplusplus",
        'extern "C" {',
        "#endif",
        "",
        *strict(real),
        f"#define {P.upper()}_SAMPLE_TIME {routine.sample_time!r} /* s, {routine.sample_time.hex()} */",
        "",
        "/* Value of `configured` after a successful configure; uninitialized memory has another one. */",
        f"#define {mark(P)} UINT32_C(0x00C500C5)",
        "",
        *_trips(layout),
        "/* Parameters; see configure and retune. */",
        *_struct(f"{P}_parameters", [("double", v.name, _meaning(v)) for v in routine.parameters]),
        "/* Inputs of each sample. */",
        *_struct(f"{P}_inputs", [(real, v.name, _meaning(v)) for v in routine.inputs]),
        "/* Outputs of each sample. */",
        *_struct(f"{P}_outputs", [(real, v.name, _meaning(v)) for v in routine.outputs]),
        "/* Numbers that depend on parameters only. */",
        *_designed_struct(f"{P}_design", layout),
        "/* State from sample to sample. */",
        *_grouped(f"{P}_state", [(real, v.name, routine.meanings.get(v.path, "")) for v in routine.states]),
        f"/* All of a {held}: plain data, which may be copied. */",
        "typedef struct {",
        f"    {P}_design design;",
        f"    {P}_state state;",
        f"    {P}_parameters parameters;",
        f"    uint32_t configured; /* {mark(P)} after a successful configure */",
        f"}} {P}_{held};",
        "",
        "/* The values of the machine file. */",
        f"void {P}_defaults({P}_parameters *parameters);",
        "",
        "/* Does this compiler round as the simulation does? configure and broken_rule ask it. */",
        f"bool {P}_exact(void);",
        "",
        "/* 0, or the code of the first rule that the parameters break: README.md and export.json explain it.",
        f"   {CODE} if this compiler rounds otherwise than the simulation: then configure refuses, too. */",
        f"int {P}_broken_rule(const {P}_parameters *parameters);",
        "",
        "/* All work that depends on parameters only: once, outside the interrupt. The state is left alone.",
        f"   False if a rule is broken, or {P}_exact is false: {_OFF[held]}. */",
        f"bool {P}_configure({arguments}, const {P}_parameters *parameters);",
        "",
        "/* The state where the axis is: off, without a trip. Once before the first step, after configure. */",
        f"void {P}_reset({arguments}, const {P}_inputs *inputs{reset_outputs});",
        "",
        "/* One sample. */",
        f"void {P}_step({arguments}, const {P}_inputs *inputs, {P}_outputs *outputs);",
        "",
    ]
    if routine.retune is not None:
        lines += [
            "/* Other parameters between two samples: the state follows, so that the command has no bump.",
            "   False, and the old parameters go on, if a rule is broken. */",
            f"bool {P}_retune({arguments}, const {P}_parameters *parameters);",
            "",
        ]
    lines += [
        "/* Between these two calls numbers below the normal ones count as zero, as they do in the simulator. */",
        *_flushes(P),
        "#ifdef __cplusplus",
        "}",
        "#endif",
        "",
        f"#endif /* {guard} */",
    ]
    return "\n".join(lines) + "\n"


def mark(P: str) -> str:
    """Return the name of the macro whose value `configure` stores in the field `configured` when it succeeds."""
    return f"{P.upper()}_CONFIGURED"


_OFF = {
    "controller": "then a step does nothing but command the safe force of the machine file",
    "plant": "then reset and step do nothing",
}
_USE = """\
    {P}_parameters parameters;
    {P}_{held} {held};
    {P}_defaults(&parameters);
    {P}_configure(&{held}, &parameters);
    {P}_reset(&{held}, &inputs);
    each sample: {P}_step(&{held}, &inputs, &outputs);

Compile without -ffast-math and its parts, with -ffp-contract=off and not for an x87: then the bits are those of the
simulation."""


def _trips(layout: Layout) -> list[str]:
    """Return the macros for the codes of `trip`."""
    if layout.routine.memory != "controller":
        return []
    codes = [(name, value) for name, value in vars(guards).items() if name.startswith("TRIP_")]
    P = layout.routine.name.upper()
    wide = max(len(name) for name, _ in codes)
    reasons = {0.0: "nothing", **guards.TRIPS}
    lines = [f"#define {P}_{name:<{wide}} {int(code)} /* {reasons[code]} */" for name, code in codes]
    return ["/* What outputs.trip says: tripped by ... */", *lines, ""]


def _designed_struct(name: str, layout: Layout) -> list[str]:
    """Return the struct of design numbers: parameters with unit and meaning, and coefficients grouped by block."""
    # reversed: of several paths to one node the first one gives the heading
    prepared = {node: path for path, node in reversed(layout.prepared)}
    lines, group = [], ""
    wide = max((len(field.name) for field in layout.design), default=0) + len(layout.precision) + 2
    for field in layout.design:
        kind, place = layout.leaves.get(field.node, ("", 0))
        heading = layout.routine.meanings.get(prepared.get(field.node, ""), "") if kind == "" else ""
        if heading != group:
            group = heading
            lines += [f"    {line}".rstrip() for line in comment(heading)] if heading else [""]
        member = f"{'bool' if field.truth else layout.precision} {field.name};"
        beside = _meaning(layout.routine.parameters[place]) if kind == "parameter" else "s" if kind else ""
        lines.append(f"    {member:<{wide}} /* {beside} */" if beside else f"    {member}")
    return ["typedef struct {", *(lines or ["    char none; /* nothing is kept here */"]), f"}} {name};", ""]


def _meaning(variable: Variable) -> str:
    meaning = variable.meaning
    bounds = str(variable.declared.bounds()) if variable.declared is not None else ""
    bounds = bounds.replace(f" {variable.unit}", "") if variable.unit else bounds
    unit = f"{variable.unit}: " if variable.unit else ""
    return f"{unit}{meaning}" + (f"; {bounds}" if bounds else "")


def _struct(name: str, members: Sequence[tuple[str, str, str]]) -> list[str]:
    """Return a struct with a comment on each member; an empty struct gets a dummy member, as C requires."""
    members = members or [("char", "none", "nothing is kept here")]
    lines = [f"    {kind} {member};" for kind, member, _ in members]
    wide = max(len(line) for line in lines)
    commented = [
        f"{line:<{wide}} /* {text} */" if text else line for line, (_, _, text) in zip(lines, members, strict=True)
    ]
    return ["typedef struct {", *commented, f"}} {name};", ""]


def _grouped(name: str, members: Sequence[tuple[str, str, str]]) -> list[str]:
    """Return a struct with its members in groups and a comment above each group."""
    lines, group = [], ""
    for kind, member, heading in members or [("char", "none", "")]:
        if heading != group:
            group = heading
            lines += [f"    {line}".rstrip() for line in comment(heading)] if heading else []
        lines.append(f"    {kind} {member};")
    return ["typedef struct {", *lines, f"}} {name};", ""]


def comment(text: str) -> list[str]:
    """Return a C comment of one or more lines; any `*/` or `/*` within the text is split."""
    lines = [""]
    for line in text.replace("*/", "* /").replace("/*", "/ *").split("\n"):
        lines += textwrap.wrap(line, _WIDTH, subsequent_indent=" " * (len(line) - len(line.lstrip()))) or [""]
    if len(lines) == 2:
        return [f"/* {lines[1]} */"]
    return ["/*", *(f" * {line}".rstrip() for line in lines[1:]), " */"]


def _flushes(P: str) -> list[str]:
    text = _FLUSHES.sub(lambda match: f"{P}_flush_{'begin' if match[0] == 'flush' else 'end'}", FLUSH)
    return [text.replace("static ", "static inline ")]


# The files: header, step and reset, and the functions outside the interrupt; or all in one header.
#
# P.h            structs with units and meanings, and the functions
# P.c            reset and step: what runs in the interrupt
# P_configure.c  defaults, configure and retune: what runs outside it
#
# A step has no loop, no branch that skips work, no heap, no globals and no recursion, so that it takes the same
# operations for every input.  Of <math.h> it calls `fabs`, `floor` and `sqrt` only, which IEEE 754 fixes to the last
# bit.


@dataclass(frozen=True)
class Texts:
    """The three C files of a routine."""

    header: str
    source: str
    configure: str


def texts(layout: Layout, title: str, made_by: str) -> Texts:
    """Return the C files of a routine; `title` describes it, `made_by` names the program and the machine file."""
    files = (header(layout, title, made_by), _source(layout, title, made_by), _configure(layout, title, made_by))
    return Texts(*map(ascii_text, files))


def _source(layout: Layout, title: str, made_by: str) -> str:
    routine, real, P = layout.routine, layout.precision, layout.routine.name
    held = routine.memory
    functions = []
    used: set[str] = set()
    for name, function in (("reset", layout.reset), ("step", layout.step)):
        leaves = _leaves(layout, {"state": "state->", "input": "inputs->"})
        leaves |= {field.node: f"design->{field.name}" for field in layout.design}
        body = Body(layout.graph, layout.truth, leaves, layout.names, layout.makers, real, _titles(routine))
        ends = (*function.states, *function.outputs)
        body.compute(layout.order(ends, moving=True), ends)
        body.lines.append("")
        # not strict: the reset of a controller has no outputs, that of a plant has all of them
        outputs = [(f"outputs->{v.name}", i) for v, i in zip(routine.outputs, function.outputs, strict=False)]
        body.assign([(f"state->{v.name}", i) for v, i in zip(routine.states, function.states, strict=True)] + outputs)
        used |= body.used
        text = "\n".join(body.lines)
        wanted = [
            (f"const {P}_design *const design = &{held}->design;", "design->" in text),
            (f"{P}_state *const state = &{held}->state;", "state->" in text),
            ("(void)inputs;", "inputs->" not in text),
        ]
        wanted.insert(
            0, (f"if ({held}->configured != {mark(P)}) {{\n{_off(layout, bool(outputs))}    return;\n}}", True)
        )
        more = f", {P}_outputs *outputs" if outputs else ""
        signature = f"void {P}_{name}({P}_{held} *{held}, const {P}_inputs *inputs{more})"
        functions.append(_function(signature, [line for line, needed in wanted if needed], body.lines))
    tables = _tables(routine, functions, real)
    heading = comment(f"{title}: reset and step.\n\n{made_by}\n\n{_laws(routine)}")
    check = exact(f"bool {P}_exact(void)", real)
    return _joined([*heading, f'#include "{P}.h"', "", *_needed(used, real), *tables, check, *functions])


def _configure(layout: Layout, title: str, made_by: str) -> str:
    routine, P = layout.routine, layout.routine.name
    held = routine.memory
    defaults = [_assigned(f"parameters->{v.name}", v.value) for v in routine.parameters]
    designed, used = _designed(layout)
    # one check in each file, since files may be compiled with different flags
    both = f"{P}_exact() && designs_exactly()"
    functions = [
        exact("static bool designs_exactly(void)", "double"),
        _function(f"void {P}_defaults({P}_parameters *parameters)", [], defaults or ["(void)parameters;"]),
        designed,
        _function(
            f"int {P}_broken_rule(const {P}_parameters *parameters)",
            [],
            [f"{P}_design design;", f"return ({both}) ? designed(&design, parameters) : {CODE};"],
        ),
        _function(
            f"bool {P}_configure({P}_{held} *{held}, const {P}_parameters *parameters)",
            [],
            [
                # first of all: after a refusal no older design may stay in force
                f"{held}->configured = 0U;",
                *wrapped(f"if (!({both}) || (designed(&{held}->design, parameters) != 0)) {{"),
                "    return false;",
                "}",
                f"{held}->parameters = *parameters;",
                f"{held}->configured = {mark(P)};",
                "return true;",
            ],
        ),
    ]
    if routine.retune is not None:
        text, more = _retune(layout)
        functions.append(text)
        used |= more
    heading = comment(f"{title}: what is done once, and outside the interrupt.\n\n{made_by}")
    includes = [f'#include "{P}.h"', "", *_needed(used, "double")]
    return _joined([*heading, *includes, *_tables(routine, functions, "double", _DESIGN), *functions])


def _off(layout: Layout, answers: bool) -> str:
    """Return the lines that set the outputs if the configuration is invalid, with the safe force; empty for a plant."""
    routine = layout.routine
    if routine.memory != "controller" or not answers:
        return ""
    cast = "(float)" if layout.precision == "float" else ""
    values = off_outputs(routine)
    return "".join(f"    outputs->{v.name} = {cast}{number(values[v.name])};\n" for v in routine.outputs)


def _designed(layout: Layout) -> tuple[str, set[str]]:
    """Return the function that checks the parameters and computes the design, and the operations that it uses."""
    routine, P = layout.routine, layout.routine.name
    leaves = _leaves(layout, {"parameter": "parameters->"}, _DESIGN)
    for index, node in enumerate(layout.graph.nodes):
        if node == ("const", LARGEST.hex()) or node == ("const", (-LARGEST).hex()):
            leaves[index] = "DBL_MAX" if node[1] == LARGEST.hex() else "-DBL_MAX"
    body = Body(layout.graph, layout.truth, leaves, layout.names, layout.makers, "double", _titles(routine))
    sentences, bounds = routine.sentences, len(routine.parameters)
    lines: list[str] = []
    # the bounds first: rules and design may divide by a parameter or take its root
    for code, node in enumerate(layout.conditions[:bounds], 1):
        lines += _refused(_inline(layout, node, body), code, sentences[code])
    rules = layout.conditions[bounds:]
    nodes = [*rules, *(field.node for field in layout.design)]
    body.compute(layout.order(nodes, moving=False), nodes)
    lines += body.lines
    for code, node in enumerate(rules, bounds + 1):
        lines += _refused(bare(body.text(node)), code, sentences[code])
    for field in layout.design:
        cast = "(float)" if layout.precision == "float" and not field.truth else ""
        lines.append(f"design->{field.name} = {cast}{body.text(field.node)};")
    text = "\n".join(lines)
    first = [f"(void){name};" for name in ("design", "parameters") if f"{name}->" not in text]
    heading = (
        "/* What is computed once, and 0; or the code of the first rule that the parameters break, and nothing. */\n"
    )
    function = _function(
        f"static int designed({P}_design *design, const {P}_parameters *parameters)", first, [*lines, "return 0;"]
    )
    return heading + function, body.used


def _inline(layout: Layout, index: int, body: Body) -> str:
    """Return the comparisons of a bounds check as one expression."""
    name, *values = layout.graph.nodes[index]
    if name == "and":
        return " && ".join(_inline(layout, i, body) for i in values)
    return f"({bare(expression(name, [body.text(i) for i in values]))})"


def _refused(holds: str, code: int, sentence: str) -> list[str]:
    """Return the C lines that test a condition and return its code if it is violated."""
    return [*comment(sentence), *wrapped(f"if (!({holds})) {{"), f"    return {code};", "}"]


def _assigned(place: str, value: float) -> str:
    """Return `place = number;`, with the decimal value in a comment if the number is printed in hexadecimal."""
    text = number(value)
    return f"{place} = {text};" + (f" /* {value!r} */" if "0x" in text else "")


def _retune(layout: Layout) -> tuple[str, set[str]]:
    """Return the `retune` function, which adapts the state in double precision, and the operations that it uses."""
    routine, P, real = layout.routine, layout.routine.name, layout.precision
    assert layout.retune is not None
    graph, truth = layout.retune.graph, layout.retune_truth
    wide = "(double)" if real == "float" else ""
    fields = {field.node: field.name for field in layout.design}
    leaves: dict[int, str] = {}
    for node, (kind, i) in layout.retune.leaves.items():
        if kind == "state":
            leaves[node] = f"{wide}state->{routine.states[i].name}"
        elif kind in ("old", "new"):
            name = routine.parameters[i].name
            leaves[node] = f"before.parameters.{name}" if kind == "old" else f"parameters->{name}"
        else:
            source = layout.prepared[routine.prepared_leaves.index(i)][1]
            held = "before.design." if kind == "old_prepared" else "controller->design."
            constant = graph_constant(layout, source)
            leaves[node] = constant if constant is not None else f"{wide}{held}{fields[source]}"
    body = Body(graph, truth, leaves, layout.retune.names, layout.retune.makers, "double", _titles(routine))
    pairs = zip((f"state->{v.name}" for v in routine.states), layout.retune.states, strict=True)
    targets = [(place, i) for place, i in pairs if body.texts.get(i) != f"{wide}{place}"]
    ends = [i for _, i in targets]
    order = [i for i in reachable(graph, ends) if graph.nodes[i][0] not in ("const", "truth")]
    body.compute(order, ends)
    body.assign(targets, "(float)" if real == "float" else "")
    body.lines.append("return true;")
    text = "\n".join(body.lines)
    first = [
        # a copy: the design is overwritten while the old one is still read
        *([f"const {P}_controller before = *controller;"] if "before." in text else []),
        *([f"{P}_state *const state = &controller->state;"] if "state->" in text else []),
        f"if (controller->configured != {mark(P)} || designed(&controller->design, parameters) != 0) {{",
        "    return false;",
        "}",
        "controller->parameters = *parameters;",
    ]
    signature = f"bool {P}_retune({P}_controller *controller, const {P}_parameters *parameters)"
    return _function(signature, first, body.lines), body.used


def graph_constant(layout: Layout, index: int) -> str | None:
    """Return the text of a node that is a constant; None for any other node."""
    node = layout.graph.nodes[index]
    return number(float.fromhex(node[1])) if node[0] == "const" else None


_DESIGN = "DESIGN_"  # tables of `configure`, in double precision even if those of the step are not


def _leaves(layout: Layout, prefixes: Mapping[str, str], tables: str = "") -> dict[int, str]:
    """Return the C expression of each node whose value already exists: struct members, tables and the sample time."""
    routine = layout.routine
    members: Mapping[str, Sequence[Variable]] = {
        "parameter": routine.parameters,
        "input": routine.inputs,
        "state": routine.states,
    }
    texts_by_node: dict[int, str] = {}
    for node, (kind, i) in layout.leaves.items():
        if kind == "table":
            texts_by_node[node] = _table(routine.tables[i][0], tables)
        elif kind == "sample_time":
            texts_by_node[node] = f"{routine.name.upper()}_SAMPLE_TIME"
        elif kind in prefixes:
            texts_by_node[node] = f"{prefixes[kind]}{members[kind][i].name}"
    return texts_by_node


def _table(name: str, of: str = "") -> str:
    return f"TABLE_{of}{name.removeprefix('control.').replace('.', '_').upper()}"


def _tables(routine: Routine, functions: Sequence[str], real: str, of: str = "") -> list[str]:
    """Return the declarations of the tables that the functions of a file read."""
    return [
        f"static const {real} {_table(name, of)}[{len(row)}] = {{{', '.join(number(float(x), real) for x in row)}}};"
        for name, _, row in routine.tables
        if any(f"{_table(name, of)}[" in function for function in functions)
    ]


def _function(signature: str, first: Iterable[str], lines: Iterable[str]) -> str:
    text = "\n".join([*first, *lines]).strip("\n")
    return f"{signature}\n{{\n{textwrap.indent(text, '    ')}\n}}\n"


def _laws(routine: Routine) -> str:
    """Return the docstrings of all blocks, as text for a comment."""
    parts = []
    for path, block in routine.blocks:
        if path and inspect.getdoc(type(block)):
            parts.append(f"{path}: {block.kind}\n\n{textwrap.indent(inspect.getdoc(type(block)) or '', '  ')}")
    return "\n\n".join(parts)


def _titles(routine: Routine) -> Callable[[str], str]:
    """Return a function that maps the dotted name of a block to the heading above its statements."""
    kinds: dict[str, Block] = dict(routine.blocks)

    def title(owner: str) -> str:
        block = kinds.get(owner)
        if not owner:
            return "what goes out"
        if block is None or owner.endswith(block.kind):
            return owner
        return f"{owner}: {block.kind}"

    return title


def _needed(used: set[str], real: str) -> list[str]:
    """Return the #include lines of a file and the helper functions that its statements call."""
    functions = helpers(used, real)
    lines = ["#include <math.h>"] if used & {"abs", "sqrt", "floor"} else []
    lines += ["#include <string.h>"] if used & set(FUNCTIONS) else []
    return [*lines, "", *functions] if lines else functions


def _joined(lines: Iterable[str]) -> str:
    return "\n".join(lines).rstrip("\n") + "\n"


_SHARED = re.compile(r"\b(designed|designs_exactly|decays|exact_\w+|power_of_twof?|exponentf?|uniform)(?=\()")


def header_only(P: str, files: Texts) -> str:
    """Return declarations and definitions as one header, to be included in the file that calls the step."""
    close = f"#ifdef __cplusplus\n}}\n#endif\n\n#endif /* {P.upper()}_H */\n"
    header = files.header.removesuffix(close)
    assert header != files.header, "the header ends otherwise than expected"
    header = header.replace("#include <stdbool.h>", "#include <math.h>\n#include <stdbool.h>", 1)
    header = header.replace("#include <stdint.h>", "#include <stdint.h>\n#include <string.h>", 1)
    header = re.sub(rf"^(void|bool|int) {P}_", rf"static inline \1 {P}_", header, flags=re.MULTILINE)
    bodies, seen = [], set[str]()
    for text in (files.configure, files.source):
        for piece in _pieces(text, P):
            if piece not in seen:
                bodies.append(piece)
                seen.add(piece)
    return header + _own(P, "\n".join(bodies)) + "\n" + close


def _own(P: str, text: str) -> str:
    """Prefix the names of functions and tables with that of the axis, so that one program can contain several axes."""
    text = _SHARED.sub(lambda match: f"{P}_{match[0]}", text)
    return re.sub(r"\bTABLE_", f"{P.upper()}_TABLE_", text)


def _pieces(text: str, P: str) -> list[str]:
    """Split a file into its top comment and its functions with their comments, dropping includes."""
    lines = [line for line in text.splitlines() if not line.startswith("#include")]
    body = re.sub(rf"^(void|bool|int) {P}_", rf"static inline \1 {P}_", "\n".join(lines), flags=re.MULTILINE)
    top, rest = body.split("*/\n", 1)
    # only the end of a function has its brace in the first column
    pieces = [f"{top}*/", *re.split(r"(?<=^\})\n+", rest, flags=re.MULTILINE)]
    return [piece.strip("\n") + "\n" for piece in pieces if piece.strip()]
