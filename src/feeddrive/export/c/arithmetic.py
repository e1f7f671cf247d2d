"""What keeps a compiler from computing otherwise than the simulation: conditions in the header, and a check at start.

A compiler may change the order of sums (-fassociative-math), divide by multiplying with a reciprocal
(-freciprocal-math), round a product and a sum once (-ffp-contract=fast) or compute wider than the numbers (x87).  Each
gives other last bits.  Where a macro tells it, the header does not compile.  Where none does, `configure` refuses.
"""

from __future__ import annotations

from feeddrive.export.c.statements import number
from feeddrive.loop.routine import Routine

# with the first options a compiler takes NaN for impossible and leaves out the checks for it
STRICT = (
    "#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ > 0) || defined(_M_FP_FAST)",
    '#error "compile without -ffast-math, -ffinite-math-only, /fp:fast: broken readings could not be detected"',
    "#endif",
    "#if defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || defined(__NO_SIGNED_ZEROS__)",
    '#error "compile without -funsafe-math-optimizations and its parts: the bits would not be those of the simulation"',
    "#endif",
    # 16: the half precision of ARM is not widened, and nothing else is
    "#if defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD != 0) && (FLT_EVAL_METHOD != 16)",
    '#error "FLT_EVAL_METHOD is not 0, as on an x87: compile for SSE2, as with -msse2 -mfpmath=sse"',
    "#endif", "",
)  # fmt: skip
CODE = -1
"""What `P_broken_rule` says if the check at start fails, whatever the parameters are."""
SENTENCE = (
    "every operation is rounded by itself, in the order in which it is written: compile without "
    "-funsafe-math-optimizations, with -ffp-contract=off and not for an x87"
)


def rules(routine: Routine) -> dict[int, str]:
    """What `P_broken_rule` says of exported C, by its code: the check at start, then the rules of the parameters."""
    return {CODE: SENTENCE, **routine.sentences}


_DOUBLE, _FLOAT = "double", "float"
# a number that is lost in a sum with 1; the distance of two numbers around 1 whose product rounds to 1; and a divisor
# whose rounded reciprocal times itself is not 1
_TINY = {_DOUBLE: 2.0**-60, _FLOAT: 2.0**-30}
_APART = {_DOUBLE: 2.0**-28, _FLOAT: 2.0**-13}
_DIVISOR = {_DOUBLE: 49.0, _FLOAT: 41.0}


def exact(signature: str, real: str) -> str:
    """A function that is true if sums, products and quotients are rounded as the simulation rounds them.

    The numbers are read from volatile memory, so that a compiler cannot compute the answer itself.
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
