"""A plan as C99 text: the time loop of one variant, to be read, compiled and compared.

Signature, memory and bits are those of the native code:

    void name(int64_t count, int64_t first, const double *constants, const double *inputs, double *states,
              double *outputs, const double *const *tables)

An operation that is used once stands inside the expression that uses it; all others have a name.  Of the library only
`fabs`, `floor` and `sqrt` are called, which IEEE 754 fixes to the bit, unless the plan asks for "libm".
"""

from __future__ import annotations

import re
from collections import Counter

from feeddrive.language.graph import ELEMENTARY, arguments
from feeddrive.language.primitives import MIX, STRIDES
from feeddrive.loop.engine.plan import Plan

_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "eq": "==", "and": "&&", "or": "||"}
_CALLS = {"abs": "fabs", "sqrt": "sqrt", "floor": "floor"} | {name: name for name in ELEMENTARY}
_WIDTH = 72  # an expression longer than this is cut by giving a part of it a name
# words of C, and names that the text itself uses
_RESERVED = re.findall(
    r"\w+",
    "auto break case char const constants continue count default do double else enum extern first float for goto if "
    "inline inputs int k long mode outputs register restrict return short signed sizeof states static struct switch "
    "tables typedef union unsigned void volatile while INFINITY flush restore",
)

# What C has no operator for; the bits of a double are read and written by memcpy.
_FUNCTIONS = {
    "power_of_two": """\
/* 2^k: k + 1.5 * 2^52 holds the whole number k in its low bits; k + 1023 goes to where a double keeps its exponent. */
static double power_of_two(double k)
{
    double x = k + 6755399441055744.0;
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits = (bits + 1023u) << 52;
    memcpy(&x, &bits, sizeof bits);
    return x;
}
""",
    "exponent": """\
/* The whole number k with 2^k <= |x| < 2^(k+1). */
static double exponent(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (double)((bits >> 52) & 0x7FFu) - 1023.0;
}
""",
    "uniform": f"""\
/* A random number in (0, 1) that depends on three whole numbers only: the finaliser of SplitMix64, once over each. */
static double uniform(double seed, double sample, double channel)
{{
    const double given[3] = {{seed, sample, channel}};
    const uint64_t strides[3] = {{{", ".join(f"UINT64_C(0x{stride:X})" for stride in STRIDES)}}};
    uint64_t bits = 0;
    for (int i = 0; i < 3; i++) {{
        bits = (bits + (uint64_t)given[i] + 1u) * strides[i];
        bits = (bits ^ (bits >> 30)) * UINT64_C(0x{MIX[0]:X});
        bits = (bits ^ (bits >> 27)) * UINT64_C(0x{MIX[1]:X});
        bits ^= bits >> 31;
    }}
    return ((double)(bits >> 12) + 0.5) * 0x1p-52;
}}
""",
}

# Numbers below the normal ones count as 0, as in the native code: they are slow and mean nothing here.
_FLUSH = """\
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


def number(value: float) -> str:
    """A double as C writes it: short decimals that are exact as such, all others by their bits."""
    if value in (float("inf"), float("-inf")):
        return "INFINITY" if value > 0.0 else "(-INFINITY)"
    text = repr(value)
    if abs(value) >= 1e6 or (16.0 * value) % 1.0 != 0.0:
        text = re.sub(r"\.?0*p", "p", value.hex())
    return f"({text})" if text.startswith("-") else text


class _Writer:
    """Gives every node its text, and collects the lines of the part that is being written."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.lines: list[str] = []
        self.texts: dict[int, str] = {}
        self.names = {*_RESERVED, *_CALLS.values(), *_FUNCTIONS}
        self.uses = Counter(i for index in plan.order for i in arguments(plan.graph.nodes[index]))
        self.uses.update(node for _, node in plan.outputs)
        self.uses.update(2 * [state.after for state in plan.states])  # what is carried on has a name

    def name(self, wanted: str) -> str:
        """A C name that nothing else has."""
        text = re.sub(r"\W", "_", wanted, flags=re.ASCII)
        while text in self.names:
            text += "_"
        self.names.add(text)
        return text

    def declare(self, index: int, wanted: str, text: str) -> None:
        """A line that gives a value a name."""
        self.texts[index] = self.name(wanted)
        kind = "int" if self.plan.kinds.truth[index] else "double"
        self.lines.append(f"const {kind} {self.texts[index]} = {text};")

    def node(self, index: int) -> None:
        """One operation: inside the expression that uses it if that is one alone, in the same part of the text."""
        node = self.plan.graph.nodes[index]
        if node[0] in ("input", "table"):
            return
        if node[0] == "const":
            self.texts[index] = number(float.fromhex(node[1]))
            return
        if node[0] == "truth":
            self.texts[index] = "1" if node[1] else "0"
            return
        text = self.expression(node[0], [self.texts[i] for i in arguments(node)])
        hoisted = not self.plan.kinds.moving[index]  # may be used inside the loop: worth a name
        if self.uses[index] > 1 or len(text) > _WIDTH or hoisted:
            self.declare(index, f"v{index}", _bare(text))
        else:
            self.texts[index] = text

    def expression(self, name: str, values: list[str]) -> str:
        """An operation as text, in parentheses where it has an operator."""
        if name in _INFIX:
            return f"({values[0]} {_INFIX[name]} {values[1]})"
        if name in _CALLS:
            return f"{_CALLS[name]}({_bare(values[0])})"
        if name == "select":
            return f"({values[0]} ? {values[1]} : {values[2]})"
        if name == "gather":
            return f"{values[0]}[(int64_t){values[1]}]"
        if name in ("neg", "not"):
            return f"({'-' if name == 'neg' else '!'}{values[0]})"
        if name in _FUNCTIONS:
            return f"{name}({', '.join(map(_bare, values))})"
        raise AssertionError(f"no text for the operation '{name}'")


def _bare(text: str) -> str:
    """The text without the parentheses around it, if the first one closes with the last one."""
    depth = 0
    for place, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0:
            return text[1:-1] if place == len(text) - 1 and place > 0 else text
    return text


def text(plan: Plan, name: str) -> str:
    """The C text of a plan of one variant, with `name` as its only visible function."""
    assert plan.lanes == 1, "C text is written for one variant"
    writer = _Writer(plan)
    writer.name(name)
    order = sorted(plan.order)  # that of the law's text
    needed, moving = set(order), plan.kinds.moving
    for i, (title, node) in enumerate(plan.tables):
        writer.texts[node] = writer.name(title)
        writer.lines.append(f"const double *{writer.texts[node]} = tables[{i}];")
    for i, (title, node) in enumerate(plan.constants):
        if node in needed:
            writer.declare(node, title, f"constants[{i}]")
    for i, state in enumerate(plan.states):
        still = "const " if state.before == state.after else ""
        writer.texts[state.before] = writer.name(state.name)
        writer.lines.append(f"{still}double {writer.texts[state.before]} = states[{i}];")
    for index in order:
        if not moving[index]:
            writer.node(index)
    entry, writer.lines = writer.lines, []

    for i, (title, node) in enumerate(plan.inputs):
        if node in needed:
            writer.declare(node, title, f"inputs[{len(plan.inputs)} * k + {i}]")
    if plan.sample is not None and plan.sample in needed:
        writer.declare(plan.sample, "sample", "(double)(first + k)")
    for index in order:
        if moving[index]:
            writer.node(index)
    for i, (title, node) in enumerate(plan.outputs):
        writer.lines.append(f"outputs[{len(plan.outputs)} * k + {i}] = {writer.texts[node]}; /* {title} */")
    carried = [state for state in plan.states if state.before != state.after]
    held = {}  # a state that takes over another one's value takes it before that one changes
    for before in sorted({s.before for s in carried} & {s.after for s in carried}):
        held[before] = writer.name(f"last_{writer.texts[before]}")
        writer.lines.append(f"const double {held[before]} = {writer.texts[before]};")
    for state in carried:
        writer.lines.append(f"{writer.texts[state.before]} = {held.get(state.after, writer.texts[state.after])};")
    body, writer.lines = writer.lines, []
    done = [f"states[{i}] = {writer.texts[s.before]};" for i, s in enumerate(plan.states) if s.before != s.after]

    used = {plan.graph.nodes[index][0] for index in plan.order}
    lines = [
        "#include <math.h>",
        "#include <stdint.h>",
        "#include <string.h>",
        "",
        *([] if plan.arithmetic == "fma" else ["#pragma STDC FP_CONTRACT OFF /* gcc: -ffp-contract=off */", ""]),
        _FLUSH,
        *(_FUNCTIONS[function] for function in sorted(used & set(_FUNCTIONS))),
        f"void {name}(int64_t count, int64_t first, const double *constants, const double *inputs, double *states,",
        f"{' ' * (6 + len(name))}double *outputs, const double *const *tables)",
        "{",
        *(f"    (void){unused};" for unused in ("first", "constants", "inputs", "outputs", "tables")),
        *("    " + line for line in ("const uint64_t mode = flush();", *entry)),
        "    for (int64_t k = 0; k < count; k++) {",
        *("        " + line for line in body),
        "    }",
        *("    " + line for line in (*done, "restore(mode);")),
        "}",
        "",
    ]
    return "\n".join(lines)
