"""C expressions for the nodes of a graph: numbers, operations, and functions that C has no operator for."""

from __future__ import annotations

import re

import numpy as np

from feeddrive.export.identifiers import bare
from feeddrive.language.graph import ELEMENTARY
from feeddrive.language.matrix import SQUARINGS, TOO_LARGE
from feeddrive.language.primitives import MIX, STRIDES

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

# What C has no operator for; the bits of a double are read and written by memcpy.
FUNCTIONS = {
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
    "power_of_twof": """\
/* 2^k: k + 1.5 * 2^23 holds the whole number k in its low bits; k + 127 goes to where a float keeps its exponent. */
static float power_of_twof(float k)
{
    float x = k + 12582912.0f;
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    bits = (bits + 127u) << 23;
    memcpy(&x, &bits, sizeof bits);
    return x;
}
""",
    "exponentf": """\
/* The whole number k with 2^k <= |x| < 2^(k+1). */
static float exponentf(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (float)((bits >> 23) & 0xFFu) - 127.0f;
}
""",
    "decays": f"""\
/* Do the powers of a matrix of n rows fall towards 0? They stand in the 2 n n numbers from `now` on, row by row. */
static bool decays(double *now, int n)
{{
    double *next = now + n * n;
    for (int squaring = 0; squaring < {SQUARINGS}; squaring++) {{
        bool small = true;
        for (int i = 0; i < n; i++) {{
            double norm = fabs(now[i * n]);
            for (int k = 1; k < n; k++) {{
                norm = norm + fabs(now[i * n + k]);
            }}
            if (!(norm < {TOO_LARGE})) {{
                return false;
            }}
            small = small && norm < 1.0;
        }}
        if (small) {{
            return true;
        }}
        for (int i = 0; i < n; i++) {{
            for (int j = 0; j < n; j++) {{
                double sum = now[i * n] * now[j];
                for (int k = 1; k < n; k++) {{
                    sum = sum + now[i * n + k] * now[k * n + j];
                }}
                next[i * n + j] = sum;
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
