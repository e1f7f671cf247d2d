"""The operations that a law may use in addition to + - * / and comparisons, for floats, arrays and symbols.

Both branches of `where` are always evaluated: keep their arguments in the valid range (`sqrt(maximum(v, tiny))`).
A NaN in a signal passes through `minimum`, `maximum` and `clip`; only the loop's guard catches it.
"""

from typing import Any

from feeddrive.language import mathematics
from feeddrive.language.primitives import (
    Composite,
    absolute,
    both,
    clip,
    either,
    equal,
    exponent,
    floor,
    gather,
    interpolate,
    length,
    maximum,
    minimum,
    most,
    no,
    on_symbols,
    power_of_two,
    quantise,
    sign,
    sqrt,
    uniform,
    where,
    zero,
)

__all__ = [
    "absolute",
    "atan",
    "atan2",
    "both",
    "clip",
    "cos",
    "either",
    "equal",
    "exp",
    "expm1",
    "exponent",
    "floor",
    "gather",
    "interpolate",
    "length",
    "log",
    "maximum",
    "minimum",
    "most",
    "no",
    "normal",
    "pi",
    "power",
    "power_of_two",
    "quantise",
    "sign",
    "sin",
    "sqrt",
    "tan",
    "tanh",
    "uniform",
    "where",
    "zero",
]

pi = 3.141592653589793


def exp(x: Any) -> Any:
    """Return eˣ."""
    # in a trace one node: gradients have a rule for it, and each printer chooses its arithmetic
    symbol = on_symbols("exp", x)
    return symbol if symbol is not None else mathematics.exp(x)


def expm1(x: Any) -> Any:
    """Return eˣ - 1, accurate to the last bits for small x."""
    symbol = on_symbols("expm1", x)
    return symbol if symbol is not None else mathematics.expm1(x)


def log(x: Any) -> Any:
    """Return the natural logarithm; NaN for x < 0, -inf for 0."""
    symbol = on_symbols("log", x)
    return symbol if symbol is not None else mathematics.log(x)


def sin(x: Any) -> Any:
    """Return the sine of an angle in rad; NaN beyond 1e9 rad, where the angle has lost its precision."""
    if isinstance(x, Composite):
        return x.sine_cosine[0]
    symbol = on_symbols("sin", x)
    return symbol if symbol is not None else mathematics.sin(x)


def cos(x: Any) -> Any:
    """Return the cosine of an angle in rad; NaN beyond 1e9 rad."""
    if isinstance(x, Composite):
        return x.sine_cosine[1]
    symbol = on_symbols("cos", x)
    return symbol if symbol is not None else mathematics.cos(x)


def tan(x: Any) -> Any:
    """Return the tangent of an angle in rad."""
    return sin(x) / cos(x)


def tanh(x: Any) -> Any:
    """Return the hyperbolic tangent."""
    symbol = on_symbols("tanh", x)
    return symbol if symbol is not None else mathematics.tanh(x)


def atan(x: Any) -> Any:
    """Return the arc tangent in rad."""
    symbol = on_symbols("atan", x)
    return symbol if symbol is not None else mathematics.atan(x)


def atan2(y: Any, x: Any) -> Any:
    """Return the angle of the point (x, y) in rad, in (-π, π]; 0 at the origin."""
    # both branches are computed: the one that is not selected must not divide by 0
    safe = where(equal(x, 0.0), 1.0, x)
    angle = atan(y / safe)
    beside = where(x < 0.0, where(y < 0.0, angle - pi, angle + pi), angle)
    return where(equal(x, 0.0), where(y > 0.0, 0.5 * pi, where(y < 0.0, -0.5 * pi, 0.0)), beside)


def power(x: Any, y: Any) -> Any:
    """Return xʸ for x > 0, as e^(y ln x); the relative error grows with |y ln x|."""
    return exp(y * log(x))


def normal(seed: Any, sample: Any, channel: Any) -> Any:
    """Return a standard normal random number (Box & Muller 1958) from two uniform ones."""
    # `uniform` is never 0, so that the logarithm is finite
    radius = sqrt(-2.0 * log(uniform(seed, sample, 2.0 * channel)))
    return radius * cos(2.0 * pi * uniform(seed, sample, 2.0 * channel + 1.0))
