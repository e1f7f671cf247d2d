"""Check a certificate of a servo loop with proofs in exact arithmetic. Only the standard library is needed.

    python check.py CERTIFICATE.json        exit code 0: proven; 1: refused, with one line that gives the reason

This file works on its own, in any folder.  Wherever possible, it recomputes figures instead of reading them.
With the controller C = Nc/Dc (from readings to force) and a plant P = Np/Dp:

    F = Dc Dp - Σ Nci Npi           characteristic polynomial of the closed loop; its degree n counts all states
    |F(z)| > Σ ri |Nci Npi|         for every |z| = 1; with one disc for all readings: r |Σ Nci Npi|

Nominal stability: the fraction-free Routh array of F((1 + s)/(1 - s)) has a positive first column.
All frequencies: with u = sin²(πfT), |F|² and |N|² on the unit circle are polynomials in u.  On an interval of u the
difference is positive if all its Bernstein coefficients are positive; otherwise the interval is bisected exactly.
By Rouché's theorem the loop is then stable for every plant in the discs, P (1 + Δ).

A multirate controller has a period of N samples.  Its loop is lifted (Meyer 1990), with θ = 2πfNT:

    x(k+N) = A x(k) + B u,   y = C x(k) + D u       u: all N samples at the plant's input, y: those of the force
    Hl(f) = closed-loop force at f + l/(NT), l = 0 .. N-1, due to a sine of 1 N at f added at the plant's input
    r(f) Σl |Hl(f)| < 1 at all f from 0 to half the sample rate

A, B, C, D are computed without rounding and then rounded once.  On an interval |θ - θ0| <= h the states are
approximated by x0 + t x1, t = θ - θ0, with a bound on the remainder that includes every rounding error.  With
ζ = e^(jθ), ζ0 = e^(jθ0), R close to (ζ0 - A)⁻¹ and W = |R|:

    (I - E + (ζ - ζ0) R) (x - x0 - t x1) = rest,   |x - x0 - t x1| <= (I - |E| - h W)⁻¹ |rest|,   E = I - R (ζ0 - A)

An interval on which the bound is too weak is bisected.  The bound also implies that no pole lies on the unit circle,
for the matrices before rounding, after rounding and everywhere in between; so rounding moves no pole across the circle.

The work is bounded: it is estimated from the sizes of the matrices and their numbers, a certificate that would take
more than `WORK` steps is refused before the proof begins, and the bisection ends when the rest of them is used up.
"""

import bisect
import cmath
import hashlib
import json
import math
import re
import struct
import sys
from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cache
from itertools import pairwise
from operator import mul
from typing import Any, NamedTuple

Poly = list[int]  # integer coefficients, lowest power first
Matrix = list[list[float]]
System = dict[str, Matrix]  # A, B, C, D
Complexes = list[complex]
Numerators = dict[tuple[int, int], Poly]  # by output and input
Polynomials = tuple[Poly, Numerators]

FORMAT, VERSION, MOST_BYTES = "feeddrive certificate", 1, 64_000_000
OTHER = "it is no certificate; give the certificate.json that `feeddrive certify` wrote"
# less than 1: at the reserve itself both sides are equal somewhere, which no bisection ends at
KEPT = Fraction(999, 1000)  # fraction of a claimed reserve that must be proven
NODES, DEPTH = 20_000, 160  # intervals of u before the check gives up
# a step is an operation on digits of 30 bits, 1 to 3 ns: a minute at most; a law with a period of 16 samples takes 1/8
WORK = 2e10
EACH = 40.0  # steps of an operation in Python, whatever the size of its numbers
BROKEN = (LookupError, TypeError, AttributeError, ValueError, ArithmeticError, RecursionError)
MISSING = "its entry '{}' is missing: take the file as feeddrive certify wrote it, or write it again"
HEX = re.compile(r"-?0x[01](\.[0-9a-f]{1,13})?p[+-]\d{1,4}")


class RefusedError(Exception):
    """The rejection of a certificate: the reason in one line, and the `frequency` in Hz to which it applies, if any."""

    def __init__(self, reason: str, frequency: float | None = None) -> None:
        super().__init__(reason)
        self.frequency = frequency


def need(condition: Any, reason: str, frequency: float | None = None) -> None:
    """Raise RefusedError unless the condition holds."""
    if not condition:
        raise RefusedError(reason, frequency)


def exact(text: Any, what: str) -> float:
    """Read a hexadecimal number, which is exact; the conversion of decimal numbers may differ between programs."""
    need(isinstance(text, str) and HEX.fullmatch(text), f"{what} is not a hexadecimal number")
    need(abs(int(text.partition("p")[2])) <= 300, f"{what} is out of range")
    return float.fromhex(text)


def plain(value: Any, what: str, least: float = 0.0, most: float = 1e12) -> float:
    """Read a JSON number between two bounds."""
    # True and False are integers in Python, but not in JSON
    fine = isinstance(value, (int, float)) and not isinstance(value, bool) and least <= value <= most
    need(fine, f"{what} is not a number from {least:g} to {most:g}")
    return float(value)


def row(value: Any, length: int | None, what: str) -> list[Any]:
    """Read a list; `length` is the required length, None for any."""
    need(isinstance(value, list) and (length is None or len(value) == length), f"{what} has not the right length")
    return value


def system(entry: Any, what: str) -> System:
    """Read A, B, C, D of a linear system."""
    need(isinstance(entry, dict) and {"A", "B", "C", "D"} <= set(entry), f"{what} has no matrices A, B, C, D")
    A = row(entry["A"], None, what)
    n, outputs = len(A), len(row(entry["C"], None, what))
    inputs = len(row(entry["D"], outputs, what)[0]) if outputs and isinstance(entry["D"][0], list) else 0
    need(1 <= inputs <= 2 and 1 <= outputs <= 2 and n <= 60, f"{what} is empty or too large")
    sizes = {"A": (n, n), "B": (n, inputs), "C": (outputs, n), "D": (outputs, inputs)}
    return {
        name: [[exact(x, what) for x in row(line, n, what)] for line in row(entry[name], m, what)]
        for name, (m, n) in sizes.items()
    }


def whole(values: Matrix) -> tuple[list[Poly], int]:
    """Convert a matrix of floats exactly to integers over a common power of two; return them and the exponent."""
    bits = max([x.as_integer_ratio()[1].bit_length() - 1 for line in values for x in line], default=0)
    return [[int(Fraction(x) * 2**bits) for x in line] for line in values], bits


def polynomials(system: System) -> Polynomials:
    """Compute det(z - A) and C adj(z - A) B + D det(z - A), lowest power first, as integers over one common factor.

    Faddeev-LeVerrier recursion: M <- A M + c, c = -trace(A M)/k.  In floating point the recursion loses all precision;
    in integers it is exact, and each division by k leaves no remainder.
    """
    (A, a), (B, b), (C, c), (D, d) = (whole(system[name]) for name in "ABCD")
    n, entries = len(A), [(i, j) for i in range(len(C)) for j in range(len(D[0]))]
    scale = max(b + c, d)
    det, above = [0] * n + [1 << scale], {entry: [0] * (n + 1) for entry in entries}
    m = [[int(i == j) for j in range(n)] for i in range(n)]
    sparse = [[(j, x) for j, x in enumerate(line) if x] for line in A]
    for k in range(1, n + 1):
        for i, j in entries:
            markov = sum(C[i][p] * sum(m[p][q] * B[q][j] for q in range(n)) for p in range(n) if C[i][p])
            above[i, j][n - k] = markov << (a + scale - b - c)
        m = [[sum(x * m[q][j] for q, x in line) for j in range(n)] for line in sparse]
        coefficient, remainder = divmod(-sum(m[i][i] for i in range(n)), k)
        need(remainder == 0, "the characteristic polynomial is not whole")
        det[n - k] = coefficient << scale
        for i in range(n):
            m[i][i] += coefficient
    # powers of z = y/2^a, all over 2^(a n): that of det(y - 2^a A) has a factor 2^(a (n - k)) at z^k
    det = [x << (a * k) for k, x in enumerate(det)]
    for i, j in entries:
        above[i, j] = [(x << (a * k)) + ((D[i][j] * det[k]) >> d) for k, x in enumerate(above[i, j])]
    return det, above


def digits(bits: float) -> float:
    """Return the number of 30-bit digits of an integer."""
    return bits / 30.0 + 1.0


def bits_of(values: Sequence[Poly]) -> int:
    """Return the number of bits of the largest integer."""
    return max([abs(x).bit_length() for line in values for x in line], default=1)


def work_of_polynomials(system: System) -> float:
    """Estimate the steps of `polynomials`: after k of n multiplications the integers are k times as long."""
    (A, _), (B, _), (C, _) = (whole(system[name]) for name in "ABC")
    n, bits, filled = len(A), bits_of(A), sum(1 for line in A for x in line if x)
    outer = len(C) * len(B[0]) * n * n if n else 0
    lengths = [digits(k * (bits + 6)) for k in range(1, n + 1)]
    return sum(
        filled * n * (EACH + digits(bits) * long) + outer * (EACH + digits(bits_of(C)) * long) for long in lengths
    )


def work_of_routh(n: int, bits: int) -> float:
    """Estimate the steps of `stable` for degree n: an entry of row k is a determinant of k coefficients."""
    # its exact division takes longest: Python divides in the square of the number of digits
    return sum((n - k + 1) / 2.0 * (3.0 * EACH + digits(k * (bits + n)) ** 2) for k in range(1, n + 1))


def work_of_interval(n: int, bits: int, parts: int, bands: int) -> float:
    """Estimate the steps of `separated` for one interval: `parts` polynomials of degree n are bisected."""
    return parts * n * n * (EACH + digits(2 * bits + n * 20)) + EACH * bands


def work_of_lifting(samples: Sequence[System], plant: System) -> float:
    """Estimate the steps of `lifted`: sample k of N multiplies integers of k times the length."""
    n, N = len(samples[0]["A"]) + len(plant["A"]), len(samples)
    bits = 2 * max(whole(matrix)[1] for entry in (*samples, plant) for matrix in (entry[name] for name in "ABCD")) + 60
    return sum(n * n * (n + k) * (EACH + digits(bits) * digits(k * bits)) for k in range(1, N + 1))


def work_of_stretch(n: int, N: int, bands: int) -> float:
    """Estimate the steps of `separated_with_images` for one interval: an inverse of n states, and N images."""
    return EACH * (4.0 * n**3 + N * (8.0 * n * n + 6.0 * N * n + 4.0 * N * N + bands))


class Work:
    """The steps that a check may still take."""

    def __init__(self, most: float = WORK) -> None:
        self.left = most

    def spend(self, steps: float) -> bool:
        """Return True if the steps can still be taken, which are then counted."""
        self.left -= steps
        return self.left >= 0.0

    def need(self, steps: float, what: str) -> None:
        """Raise RefusedError if the steps cannot be taken any more."""
        left = self.left
        need(self.spend(steps), f"{what} takes {steps:.2g} steps, and {max(left, 0.0):.2g} of {WORK:.2g} are left")


def times(p: Poly, q: Poly) -> Poly:
    """Multiply two polynomials."""
    places = range(len(p) + len(q) - 1)
    return [sum(p[i] * q[k - i] for i in range(max(0, k - len(q) + 1), min(len(p), k + 1))) for k in places]


def stable(F: Poly) -> bool:
    """Return True if all zeros of F lie inside the unit circle.

    In this case the first column of the Routh array of F((1 + s)/(1 - s)) (1 - s)^n has one sign (Jeltsch 1979).
    """
    n, out = len(F) - 1, [F[-1]]
    powers = [1]
    for k in range(n - 1, -1, -1):  # Horner in z = (1 + s)/(1 - s)
        powers = times(powers, [1, -1])
        out = times(out, [1, 1])
        out = [x + F[k] * y for x, y in zip(out, powers, strict=True)]
    out = [x if out[-1] > 0 else -x for x in reversed(out)]
    rows = [out[0::2], out[1::2] + [0] * (1 - n % 2)]
    for k in range(1, n + 1):
        if rows[k - 1][0] <= 0 or rows[k][0] <= 0:
            return False
        p, q = rows[k - 1], rows[k] + [0]
        # dividing by the entry two rows above is exact (Bareiss) and keeps the integers from doubling in length per row
        divisor = rows[k - 2][0] if k > 2 else 1
        rows.append([(q[0] * p[i + 1] - p[0] * q[i + 1]) // divisor for i in range(len(p) - 1)] or [0])
    return True


def squared(p: Poly, n: int) -> Poly:
    """Return the Bernstein coefficients, over u = 0..1, of |p|² on the unit circle, times the lcm of all C(n, k)."""
    p = p + [0] * (n + 1 - len(p))
    power, last, now = [0] * (n + 1), [0] * (n + 1), [1] + [0] * n
    for m in range(n + 1):  # cos(m w) = T_m(1 - 2u)
        lag = sum(p[k] * p[k + m] for k in range(n + 1 - m)) * (2 if m else 1)
        power = [x + lag * t for x, t in zip(power, now, strict=True)]
        twice = [2 * x - 4 * y for x, y in zip(now, [0, *now[:-1]], strict=True)]
        last, now = now, [x - y for x, y in zip(twice, last, strict=True)] if m else [x // 2 for x in twice]
    common = math.lcm(*(math.comb(n, k) for k in range(n + 1)))
    scaled = [x * (common // math.comb(n, k)) for k, x in enumerate(power)]
    return [sum(math.comb(k, i) * scaled[i] for i in range(k + 1)) for k in range(n + 1)]


def halved(b: Poly) -> tuple[Poly, Poly]:
    """Return the Bernstein coefficients on both halves of the interval, times 2^n (de Casteljau without divisions)."""
    n, left, right, now = len(b) - 1, [], [], b
    for k in range(n + 1):
        left.append(now[0] << (n - k))
        right.append(now[-1] << (n - k))
        now = [x + y for x, y in pairwise(now)]
    return left, right[::-1]


def ratio(a: int, b: int) -> float:
    """Return √(a/b) of two integers >= 0 as a float."""
    try:
        return math.sqrt(a / b)
    except (OverflowError, ZeroDivisionError):
        return 1e150


class Bands:
    """The disc radii as a function of u = sin²(πfT); bands overlap by more than the floating-point error of u."""

    def __init__(self, entries: Any, discs: int, T: float) -> None:
        self.edges, self.radii, low = [], [], 0.0
        for k, band in enumerate(row(entries, None, "radius")):
            need(isinstance(band, dict) and set(band) == {"from_Hz", "to_Hz", "r"}, f"radius.{k} is not a band")
            # compared exactly: within a gap of any width the radius would be undefined
            need(band["from_Hz"] == low, f"there is a gap in the radius at {low:.6g} Hz")
            low = plain(band["to_Hz"], f"radius.{k}.to_Hz", math.nextafter(low, math.inf), 1e9)
            self.edges.append(low)
            self.radii.append([plain(r, f"radius.{k}.r", 0.0, 1e9) for r in row(band["r"], discs, f"radius.{k}.r")])
        need(0 < len(self.edges) <= 20_000, "there is no radius, or too many")
        need(abs(low * T * 2.0 - 1.0) < 1e-9, f"the radius ends at {low:.6g} Hz and not at half the sample rate")
        # the last u is 1 exactly: rounding of sin² must leave no gap below half the sample rate
        self.T, self.u = T, [math.sin(math.pi * f * T) ** 2 for f in self.edges[:-1]] + [1.0]
        self.starts = [0.0, *(u * (1.0 - 1e-12) for u in self.u[:-1])]
        self.ends = [*(u * (1.0 + 1e-12) for u in self.u[:-1]), 1.0]

    def most(self, low: float, high: float) -> list[float]:
        """Return the largest radius of each disc on a closed interval of u."""
        first, last = bisect.bisect_left(self.ends, low), bisect.bisect_right(self.starts, high)
        return [max(radii) for radii in zip(*self.radii[first:last], strict=True)]

    def at(self, f: float) -> list[float]:
        """Return the radius of each disc at a frequency in Hz; at a band edge, the larger of the two radii."""
        u = min(1.0, math.sin(math.pi * f * self.T) ** 2)
        return self.most(u, u)


def separated(F: Poly, N: list[Poly], bands: Bands, reserve: Fraction, work: Work) -> int:
    """Raise RefusedError unless |F| > reserve Σ ri |Ni| for all u in 0..1; return the number of intervals used."""
    n, nodes = len(F) - 1, 0
    each = work_of_interval(n, bits_of([F, *N]), 1 + len(N), len(bands.radii))
    waiting = [(0, 0, [squared(p, n) for p in (F, *N)])]
    while waiting:
        i, depth, parts = waiting.pop()
        nodes += 1
        low, high = i / 2**depth, (i + 1) / 2**depth
        f = math.asin(math.sqrt(low)) / (math.pi * bands.T)
        need(
            nodes <= NODES and depth <= DEPTH and work.spend(each), f"|1 + L| > r|L| cannot be shown near {f:.6g} Hz", f
        )
        r = [Fraction(x) * reserve for x in bands.most(low, high)]
        # (Σ ri |Ni|)² <= Σ ri² |Ni|²/mi for any mi > 0 of sum 1 (Cauchy and Schwarz); it is sharp for mi as ri |Ni|
        size = [float(x) * ratio(p[0] + p[-1], parts[0][0] + parts[0][-1]) for x, p in zip(r, parts[1:], strict=True)]
        # any m > 0 gives a valid bound: the floor only avoids the division by 0 of a reading without gain
        m = [Fraction(max(x, 1e-6 * max(size), 1e-200)) for x in size]
        factor = [x * x * sum(m) / y for x, y in zip(r, m, strict=True)]
        q = math.lcm(*(x.denominator for x in factor))
        p = [x.numerator * (q // x.denominator) for x in factor]
        if all(q * b[0] > sum(map(mul, p, b[1:])) for b in zip(*parts, strict=True)):
            continue
        # a violation at one point ends the search at once; bisection alone would run until NODES
        there = float(reserve) * sum(map(mul, bands.most(low, low), (ratio(b[0], parts[0][0]) for b in parts[1:])))
        need(there < 1.0, f"r|L| is {there:.4g} of |1 + L| at {f:.6g} Hz", f)
        both = [halved(b) for b in parts]
        waiting += [(2 * i + 1, depth + 1, [b[1] for b in both]), (2 * i, depth + 1, [b[0] for b in both])]
    return nodes


def at(polynomials: Sequence[Poly], f: float, T: float) -> list[complex]:
    """Evaluate polynomials at e^(j2πfT), up to a common factor.

    The point is rounded to 60 binary digits; the evaluation at this point is exact.
    """
    angle, length, values = 2.0 * math.pi * f * T, max(map(len, polynomials)), []
    x, y = (round(Fraction(part) * 2**60) for part in (math.cos(angle), math.sin(angle)))
    for p in polynomials:
        re, im = 0, 0
        for k, c in enumerate(reversed(p + [0] * (length - len(p)))):
            re, im = re * x - im * y + (c << (60 * k)), re * y + im * x
        values.append((re, im))
    # float() of an integer overflows at 2^1024; ratios of the values do not change by a common shift
    digits = max(0, max(abs(part) for value in values for part in value).bit_length() - 900)
    return [complex(re >> digits, im >> digits) for re, im in values]


ROUND = 1e-12  # relative error bound of a sum of at most 200 products: thirty times the largest rounding error
ANGLE_DEPTH = 40  # bisections of the range of θ; a narrower interval is lost in the rounding of its center
NEAR = 0.75  # largest spectral radius of |E| + h W for which an interval is tried; the bound grows as 1/(1 - NEAR)


class Lifted(NamedTuple):
    """The lifted loop of N samples and n states.

    A  n rows of length n
    B  list of N columns of length n
    C  N rows of length n
    D  N rows; row a has the gains from the a input samples before it to force sample a
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


def lifted(samples: Sequence[System], plant: System) -> Lifted:
    """Lift the closed loop from the plant's input to the force; `samples` are the controller at each sample."""
    steps = [_closed(sample, plant) for sample in samples]
    n, bits = len(steps[0]) - 1, max(x.denominator.bit_length() for rows in steps for line in rows for x in line) - 1
    into = [0] * len(samples[0]["A"]) + [int(Fraction(x) * 2**bits) for (x,) in plant["B"]]
    through = [[int(i == j) for j in range(n)] for i in range(n)]  # of the states, then of the samples so far
    C, D, before, after = list[list[float]](), list[list[float]](), 1, 1  # `through` over `after`, a power of two
    for rows in steps:
        sparse = [[(j, int(x * 2**bits)) for j, x in enumerate(line) if x] for line in rows]
        moved = [[sum(x * through[j][k] for j, x in line) for k in range(len(through[0]))] for line in sparse]
        before, after = after, after << bits
        force = [_float(x, after) for x in moved.pop()]
        C.append(force[:n])
        D.append(force[n:])
        through = [[*line, x * before] for line, x in zip(moved, into, strict=True)]
    last = [[_float(x, after) for x in line] for line in through]
    return Lifted([line[:n] for line in last], [list(column) for column in zip(*last, strict=True)][n:], C, D)


def _closed(control: System, plant: System) -> list[list[Fraction]]:
    """Return the state matrix of the closed loop for one sample; an additional last row gives the force."""
    Ac, Bc, Cc, Dc, Ap, Bp, Cp = (
        [[Fraction(x) for x in line] for line in matrix]
        for matrix in (*(control[name] for name in "ABCD"), *(plant[name] for name in "ABC"))
    )

    def over_both(states: list[Fraction], gains: list[Fraction]) -> list[Fraction]:
        return states + [sum(map(mul, gains, column), Fraction(0)) for column in zip(*Cp, strict=True)]

    m, force = len(Ac), over_both(Cc[0], Dc[0])
    axis = [[Fraction(0)] * m + line for line in Ap]
    driven = [[x + b * y for x, y in zip(line, force, strict=True)] for line, (b,) in zip(axis, Bp, strict=True)]
    return [*(over_both(line, gains) for line, gains in zip(Ac, Bc, strict=True)), *driven, force]


def _float(x: int, scale: int) -> float:
    value = x / scale
    # subnormal numbers have larger relative errors than ROUND
    if x and not 1e-280 < abs(value) < 1e280:
        raise ArithmeticError("a number of the loop over a period is out of range")
    return value


def inverse(matrix: Sequence[Complexes]) -> list[Complexes]:
    """Invert a matrix by Gauss-Jordan elimination in place, with scaled partial pivoting.

    The result need not be exact: its residual E enters the bounds.
    """
    n, rows = len(matrix), list(matrix)
    scale, places = [max(map(abs, line)) or 1.0 for line in matrix], list(range(n))
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(rows[i][k]) / scale[i])
        rows[k], rows[best], scale[k], scale[best] = rows[best], rows[k], scale[best], scale[k]
        places[k], places[best] = places[best], places[k]
        # a singular matrix gets a huge inverse, whose residual then fails the bound
        pivot = rows[k][k] or 1e-300
        # column k of the inverse, of the row that was at `places[k]`, takes the place of the one that is eliminated
        top = [x / pivot for x in rows[k]]
        top[k] = 1.0 / pivot
        for i, line in enumerate(rows):
            factor = line[k]
            if factor and i != k:
                rows[i] = line = [x - factor * y for x, y in zip(line, top, strict=True)]
                line[k] = -factor * top[k]
        rows[k] = top
    order = sorted(range(n), key=places.__getitem__)
    return [[line[k] for k in order] for line in rows]


def sums(rows: Sequence[Sequence[complex]], vector: Sequence[complex]) -> list[Any]:
    """Multiply a matrix by a vector."""
    return [sum(map(mul, line, vector)) for line in rows]


class Stretch:
    """Bounds on the resolvent (ζ - A)⁻¹ for |θ - θ0| <= h; `fits` is False if h is too large for a bound to exist."""

    def __init__(self, loop: Lifted, center: float, h: float) -> None:
        self.loop, self.center, self.h, self.zeta = loop, center, h, cmath.exp(1j * center)
        shifted = [[(self.zeta if i == j else 0j) - x for j, x in enumerate(line)] for i, line in enumerate(loop.A)]
        self.R = inverse(shifted)
        self.W = [[abs(x) for x in line] for line in self.R]
        columns = [(column, [2.0 * ROUND * abs(x) for x in column]) for column in zip(*shifted, strict=True)]
        self.E = [
            [abs((i == j) - sum(map(mul, line, c))) + sum(map(mul, w, size)) for j, (c, size) in enumerate(columns)]
            for i, (line, w) in enumerate(zip(self.R, self.W, strict=True))
        ]
        self.M = [[e + h * w for e, w in zip(*lines, strict=True)] for lines in zip(self.E, self.W, strict=True)]
        self.p, self.q = [1.0] * len(loop.A), 0.0  # M p <= q p
        # any p > 0 gives a bound; power iterations bring q close to the spectral radius, the smallest one
        for _ in range(8):
            after = sums(self.M, self.p)
            self.q = max((x / y for x, y in zip(after, self.p, strict=True)), default=0.0) * (1.0 + ROUND)
            self.p = after
        self.fits = self.q <= NEAR
        # what all images share
        N = len(loop.C)
        self.rows = list(zip(*loop.B, strict=True))
        self.size = [sum(map(abs, line)) for line in self.rows]
        self.bent = [0.5 * h * h * sum((b / N) ** 2 * abs(x) for b, x in enumerate(line)) for line in self.rows]
        self.gains = [[abs(c) for c in line] for line in loop.C]
        self.lags = [[(b - a) / N for b in range(a)] for a in range(N)]
        self.through = [sum(map(abs, line)) for line in loop.D]
        self.spread = [
            0.5 * h * h * sum(x * x * abs(d) for x, d in zip(lag, line, strict=True))
            for lag, line in zip(self.lags, loop.D, strict=True)
        ]

    def bounded(self, rest: list[float]) -> list[float]:
        """Return an upper bound of (I - M)⁻¹ rest: a vector v + c p for which (I - M)(v + c p) >= rest."""
        v = rest
        for _ in range(2):
            v = [x + y for x, y in zip(rest, sums(self.M, v), strict=True)]
        left = [x + y - z for x, y, z in zip(rest, sums(self.M, v), v, strict=True)]
        c = max((max(x, 0.0) / y for x, y in zip(left, self.p, strict=True)), default=0.0) / (1.0 - self.q)
        return [(x + c * y) * (1.0 + ROUND) for x, y in zip(v, self.p, strict=True)]

    def forces(self, k: int) -> tuple[Complexes, Complexes, float]:
        """Return y0, y1 and √Σ(remainder²) for a sine at the frequency (θ + 2πk)/(2πNT) as the input.

        Each sample of the force, divided by this sine, is y0 + (θ - θ0) y1 up to a bounded remainder.
        """
        (_, _, C, D), h, N = self.loop, self.h, len(self.loop.C)
        turn = [cmath.exp(1j * (self.center + 2.0 * math.pi * k) * b / N) for b in range(N)]
        x0 = sums(self.R, sums(self.rows, turn))
        b1 = sums(self.rows, [1j * b / N * w for b, w in enumerate(turn)])
        x1 = sums(self.R, [b - 1j * self.zeta * x for b, x in zip(b1, x0, strict=True)])
        most = [abs(x) + h * abs(y) for x, y in zip(x0, x1, strict=True)]
        moved = [
            s + ROUND * (1.0 + h) * (b + m) + 0.5 * h * h * abs(x) + h * h * abs(y)
            for s, b, m, x, y in zip(self.bent, self.size, most, x0, x1, strict=True)
        ]
        rest = [w + e + ROUND * m for w, e, m in zip(sums(self.W, moved), sums(self.E, most), most, strict=True)]
        rest = self.bounded(rest)
        y0, y1, square = list[complex](), list[complex](), 0.0
        for a in range(N):
            back, s0, s1 = turn[a].conjugate(), sum(map(mul, C[a], x0)), sum(map(mul, C[a], x1))
            there = [d * w * back for d, w in zip(D[a], turn, strict=False)]
            y0.append(back * s0 + sum(there))
            y1.append(back * (s1 - 1j * a / N * s0) + 1j * sum(map(mul, self.lags[a], there)))
            gains = self.gains[a]
            loose = sum(map(mul, gains, rest)) + 0.5 * h * h * (a / N) ** 2 * (abs(s0) + h * abs(s1))
            loose += h * h * a / N * abs(s1) + self.spread[a]
            loose += 4.0 * ROUND * (sum(map(mul, gains, most)) + self.through[a])
            square += loose * loose
        return y0, y1, math.sqrt(square)


def most_of(stretch: Stretch, k: int, enough: float) -> float:
    """Return an upper bound of Σl |Hl| on the interval; a rough bound is returned if it is already below `enough`."""
    y0, y1, rest = stretch.forces(k)
    N, h = len(y0), stretch.h
    # Parseval: the images have the mean square of all samples, and Σ|Hl| <= √N √Σ|Hl|²
    rough = math.sqrt(sum((abs(x) + h * abs(y)) ** 2 for x, y in zip(y0, y1, strict=True))) + rest
    if rough < enough:
        return rough
    ends = [0.0, 0.0]
    for back in _to_images(N):
        first, slope = sum(map(mul, back, y0)), h * sum(map(mul, back, y1))
        ends = [ends[0] + abs(first + slope), ends[1] + abs(first - slope)]  # convex in θ: largest at an end
    return max(ends) + rest + 10.0 * ROUND * rough


@cache
def _to_images(N: int) -> tuple[tuple[complex, ...], ...]:
    """Return the weights of N samples in each of their N images."""
    return tuple(tuple(cmath.exp(-2j * math.pi * (image * a % N) / N) / N for a in range(N)) for image in range(N))


def image_sum(loop: Lifted, f: float, T: float) -> float:
    """Return an upper bound, tight to ten digits, of Σl |Hl| at a frequency from 0 to half the sample rate, in Hz."""
    N = len(loop.C)
    turns = round(f * T * N)
    theta = 2.0 * math.pi * (f * T * N - turns)
    # at a negative θ the sum equals that of the mirrored image
    stretch = Stretch(loop, abs(theta), 0.0)
    return most_of(stretch, (turns if theta >= 0.0 else -turns) % N, 0.0) if stretch.fits else math.inf


def widest(bands: Bands, low: float, high: float) -> float:
    """Return the largest radius between two frequencies in Hz; radii are mirrored about half the sample rate."""
    u = sorted(math.sin(math.pi * f * bands.T) ** 2 for f in (low, high))
    return bands.most(u[0] if low > 0.0 else 0.0, 1.0 if low <= 0.5 / bands.T <= high else u[1])[0]


def separated_with_images(loop: Lifted, bands: Bands, factor: float, work: Work) -> int:
    """Raise RefusedError unless factor r Σl |Hl| < 1 at all frequencies; return the number of intervals."""
    each = work_of_stretch(len(loop.A), len(loop.C), len(bands.radii))
    N, T, nodes, waiting = len(loop.C), bands.T, 0, [(0, 0)]
    per = 1.0 / (2.0 * math.pi * N * T)  # Hz
    while waiting:
        i, depth = waiting.pop()
        nodes += 1
        h = 0.5 * math.pi / 2**depth
        wide = h + 1e-14  # neighboring intervals overlap by more than the rounding of their centers
        stretch = Stretch(loop, (2 * i + 1) * h, wide)
        hertz = [(stretch.center + 2.0 * math.pi * k) * per for k in range(N)]
        near = f"near {hertz[0]:.6g} Hz and its images"
        need(
            nodes <= NODES and depth <= ANGLE_DEPTH and work.spend(each), f"r Σ|H| < 1 cannot be shown {near}", hertz[0]
        )
        fits = stretch.fits
        for k, f in enumerate(hertz if fits else []):
            r = widest(bands, f - wide * per, f + wide * per) * factor * (1.0 + 1e-12)
            if r == 0.0 or most_of(stretch, k, 0.999 / r) * r < 1.0:
                continue
            fits, f = False, min(f, 1.0 / T - f)
            there = bands.at(f)[0] * factor * image_sum(loop, f, T)
            need(there < 1.0 + 1e-9, f"r Σ|H| is {there:.4g} at {f:.6g} Hz", f)
            break
        if not fits:
            waiting += [(2 * i + 1, depth + 1), (2 * i, depth + 1)]
    return nodes


def proven_over_period(
    samples: Sequence[System], plant: System, bands: Bands, factor: float, f: float, work: Work
) -> tuple[int, int, float]:
    """Raise RefusedError unless the loop is stable and factor r Σl |Hl| < 1 at all frequencies.

    Returns the number of closed-loop poles, the number of intervals, and r Σl |Hl| at f.
    """
    need(len(bands.radii[0]) == 1, "with two rates there must be one disc for all readings")
    work.need(work_of_lifting(samples, plant), "the loop over a period")
    loop = lifted(samples, plant)
    n = len(loop.A)
    silent = {"A": loop.A, "B": [[0.0]] * n, "C": [[0.0] * n], "D": [[0.0]]}  # only the poles matter
    work.need(work_of_polynomials(silent), "the polynomial of the loop over a period")
    F = polynomials(silent)[0]
    work.need(work_of_routh(n, bits_of([F])), "the Routh array of the loop over a period")
    need(stable(F), "the nominal loop is not stable")
    return n, separated_with_images(loop, bands, factor, work), bands.at(f)[0] * image_sum(loop, f, bands.T)


def parse(content: bytes) -> dict[str, Any]:
    """Parse the document; refuse JSON that other parsers may interpret differently."""
    need(len(content) <= MOST_BYTES, f"it is larger than {MOST_BYTES} bytes")

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        need(len({name for name, _ in pairs}) == len(pairs), "a name is given twice")
        return dict(pairs)

    def refuse(text: str) -> None:
        need(False, f"it holds {text}, which is not a number")

    try:
        document = json.loads(content.decode(), object_pairs_hook=once, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise RefusedError(f"{OTHER}: not JSON, or cut off: {str(error)[:80]}") from None
    need(isinstance(document, dict), OTHER)
    return document


def digest(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the document without its digest entry."""
    rest = {name: value for name, value in document.items() if name != "sha256"}
    # sorted and without spaces: the digest must not depend on the layout of the file
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def represented(x: float, arithmetic: str) -> bool:
    """Return True if a number is exact in the arithmetic: float64, float32, or fixedN with N binary places."""
    if arithmetic == "float32":
        return struct.unpack("f", struct.pack("f", x))[0] == x
    return not arithmetic.startswith("fixed") or (Fraction(x) * 2 ** int(arithmetic[5:])).denominator == 1


def prepared(control: Any, work: Work) -> Polynomials | list[Any]:
    """Return the controller of a certificate as polynomials or, if multirate, as a list of one system per sample."""
    samples = [system(entry, "control") for entry in control.get("samples", [control])]
    need(all(len(sample["C"]) == 1 for sample in samples), "the control must have one output, the force")
    need(len({(len(sample["A"]), len(sample["D"][0])) for sample in samples}) == 1, "its samples do not fit each other")
    if "samples" in control:
        return samples
    work.need(work_of_polynomials(samples[0]), "the polynomial of the control")
    return polynomials(samples[0])


def proven(
    control: Polynomials | list[Any], plant: Any, T: float, work: Work
) -> tuple[Poly, Numerators, Bands, int, int]:
    """Prove stability and margin for a plant.

    Returns the plant's det(z - A), numerators and bands, the number of closed-loop poles and the number of intervals.
    """
    model = system(plant["model"], "model")
    readings = len(control[1]) if isinstance(control, tuple) else len(control[0]["D"][0])
    need(len(model["D"][0]) == 1 and len(model["C"]) == readings, "it does not fit the control")
    need(not any(x for line in model["D"] for x in line), "a plant responds without delay")
    bands, reserve = Bands(plant["radius"], {"one": 1, "each": readings}[plant["discs"]], T), plant["reserve"]
    reserve = None if reserve is None else plain(reserve, "reserve", 1.0, 1e9)
    # with a reserve hardly above 1 the discs as stated must hold, too
    factor = max(Fraction(1), Fraction(reserve or 1) * KEPT)
    f = plain(plant["reserve_at_Hz"], "reserve_at_Hz", 0.0, 0.5 / T * (1.0 + 1e-9))
    work.need(work_of_polynomials(model), "the polynomial of the plant")
    Dp, Np = polynomials(model)
    if isinstance(control, list):
        poles, nodes, there = proven_over_period(control, model, bands, float(factor), f, work)
    else:
        parts = [times(control[1][0, i], Np[i, 0]) for i in range(readings)]
        loop = [sum(terms) for terms in zip(*parts, strict=True)]
        closed = [x - y for x, y in zip(times(control[0], Dp), loop, strict=True)]
        split = parts if plant["discs"] == "each" else [loop]
        # a common power of two is dropped: it would be squared and slow down every product
        spare = min((x & -x).bit_length() for p in (closed, *split) for x in p if x) - 1
        F, *N = [[x >> spare for x in p] for p in (closed, *split)]
        work.need(work_of_routh(len(F) - 1, bits_of([F])), "the Routh array of the loop")
        need(stable(F), "the nominal loop is not stable")
        poles, nodes = len(F) - 1, separated(F, N, bands, factor, work)
        denominator, *numerators = at((F, *N), f, T)
        there = sum(r * abs(x / denominator) for r, x in zip(bands.at(f), numerators, strict=True))
    need(reserve is None or abs(reserve * there - 1.0) < 2e-3, f"its reserve is not {reserve} at {f:.6g} Hz", f)
    return Dp, Np, bands, poles, nodes


def inside(plant: Any, Dp: Poly, Np: Numerators, bands: Bands, sure: float, T: float, work: Work) -> int:
    """Raise RefusedError unless all measured frequency lines G lie in the discs around the model P; return their
    number.

    The condition is |G - P| + sure √variance <= r|P|.
    """
    rows, discs = row(plant["lines"], None, "lines"), len(bands.radii[0])
    need(not rows or len(rows) == len(Np) or all(Np[i, 0] == Np[0, 0] for i in range(len(Np))), "lines are missing")
    need(len(rows) <= discs, "lines of two readings need a disc each")
    n = len(Dp)
    each = 2.0 * n * (4.0 * EACH + 2.0 * n + digits(bits_of([Dp, *Np.values()])))  # a power of z has 60 bits
    work.need(each * sum(len(row(lines, None, "lines")) for lines in rows), "the comparison with the measured lines")
    for i, lines in enumerate(rows):
        for line in row(lines, None, "lines"):
            f, re, im, variance = row(line, 4, "a line")
            f, G = plain(f, "a frequency", 0.0, 0.5 / T), complex(plain(re, "a line", -1e9), plain(im, "a line", -1e9))
            above, below = at((Np[i, 0], Dp), f, T)
            off = abs(G - above / below) + sure * math.sqrt(plain(variance, "a variance"))
            need(off <= bands.at(f)[i] * abs(above / below) * (1.0 + 1e-9), f"the line at {f:.6g} Hz is outside of r")
    return sum(map(len, rows))


def verified(document: Mapping[str, Any]) -> list[str]:
    """Prove the whole certificate; return one sentence per plant. Raise RefusedError if any condition fails."""
    need(document.get("format") == FORMAT, OTHER)
    need(document.get("version") == VERSION, f"its version is {document.get('version')!r:.20}, this is for {VERSION}")
    entries = {"sample_time_s", "arithmetic", "numbers", "control", "plants", "outside", "confidence", "sha256"}
    missing = entries - set(document)
    need(not missing, MISSING.format("', '".join(sorted(missing))))
    need(document["sha256"] == digest(document), "its content does not fit its SHA-256: it was changed")
    T, arithmetic = exact(document["sample_time_s"], "sample_time_s"), document["arithmetic"]
    need(1e-9 < T < 10.0, "the sample time is not between 1 ns and 10 s")
    need(re.fullmatch(r"float64|float32|fixed[1-9]\d?", arithmetic), "its arithmetic is not known")
    for name, x in document["numbers"].items():
        need(represented(exact(x, name), arithmetic), f"{name} is not a number of {arithmetic}")
    outside = " ".join(document["outside"])
    need("saturation" in outside and "friction" in outside, "it does not list saturation and friction as outside")
    work = Work()
    control, plants, sentences = prepared(document["control"], work), row(document["plants"], None, "plants"), []
    need(0 < len(plants) <= 100, "there is no plant, or more than a hundred")
    # no finite disc holds a normal error with certainty
    confidence = plain(document["confidence"], "confidence", 0.0, 1.0 - 1e-12)
    count = sum(len(lines) for plant in plants for lines in plant["lines"])
    sure = math.sqrt(math.log(max(count, 1) / (1.0 - confidence)))  # P(|dG|² > q var) = e^-q, all lines (Bonferroni)
    for plant in plants:
        name = str(plant["name"])[:60]
        try:
            Dp, Np, bands, degree, nodes = proven(control, plant, T, work)
            lines = inside(plant, Dp, Np, bands, sure, T, work)
        except RefusedError as error:
            raise RefusedError(f"'{name}': {error}", error.frequency) from None
        room = "" if plant["reserve"] is None else f"; the discs could be {plant['reserve']:.4g} times as wide"
        r = f"{min(map(min, bands.radii)):.4g} to {max(map(max, bands.radii)):.4g}{room}"
        count = f"{degree} poles, {nodes} stretches, {lines} measured lines inside"
        margin = "|1 + L| > r|L|" if isinstance(control, tuple) else "r sum|H| < 1"
        sentences.append(f"'{name}': stable, and {margin} at all frequencies, with discs of r = {r}; {count}")
    return sentences


def checked(path: str) -> tuple[list[str], bool]:
    """Check a file; return the sentences on it, the last one being the verdict, and True if it is proven."""
    proven = False
    try:
        with open(path, "rb") as file:
            # one byte more than allowed shows that a file is too large, without reading all of it
            document = parse(file.read(MOST_BYTES + 1))
        sentences = [*verified(document), f"outside: {'; '.join(document['outside'])}"]
        sentences.append(f"PROVEN: plants: {len(sentences) - 1}, coefficients: {document['arithmetic']}")
        proven = True
    except OSError as error:
        sentences = [f"REFUSED: {path} cannot be read: {error.strerror}"]
    except RefusedError as error:
        sentences = [f"REFUSED: {path}: {error}"]
    # a damaged file must be refused, not crash the checker
    except KeyError as error:
        sentences = [f"REFUSED: {path}: {MISSING.format(error.args[0])}"]
    except BROKEN as error:
        sentences = [f"REFUSED: {path}: it is not built as a certificate is: {type(error).__name__} {error}"]
    shown = (" ".join(line.split()) for line in sentences)
    # names in the file are foreign text, which must not control a terminal
    return ["".join(c if c.isprintable() and c.isascii() else "?" for c in line) for line in shown], proven


def main(arguments: list[str]) -> int:
    """Check one file and print the sentences; the last line is the verdict."""
    sentences, proven = (
        checked(arguments[0]) if len(arguments) == 1 else (["REFUSED: give one certificate.json"], False)
    )
    sys.stdout.write("\n".join(sentences) + "\n")
    return 0 if proven else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
