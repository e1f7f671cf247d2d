"""Check a proof over a box of plants (`box_proof.json`) with Python's standard library alone, in whole numbers.

    python box_check.py FILE

The file states bodies M q'' + C q' + K q = b u with readings cᵢᵀq, where each uncertain parameter p between two ends
adds p · factor · v vᵀ to M or K; a drive with dead time and current loop; and a control u = Σ Cᵢ(z) xᵢ, Cᵢ = Nᵢ/D, by
its matrices.  With θ = ωT, s = jθ/T and z = e^(jθ),

    den = det(M s² + C s + K),  numᵢ = cᵢᵀ adj(M s² + C s + K) b,  G = (1 - e^-sT)/(sT) e^(-s τ) ωc/(s + ωc)
    f = D den - Σ Nᵢ G numᵢ,    tailᵢ = Σ over k ≠ 0 of |G numᵢ/den| at θ + 2πk
    |1 + L| >= 1/Ms and 1 + L ≠ 0  where  |f| > (|D|/Ms + Σ |Nᵢ| tailᵢ) |den|

1. *Cells.*  Trees of halvings divide 0 <= θ <= π and the box.  Each leaf states a direction, in which the inequality
   must hold at all corners of its plants and over its interval of θ.  v vᵀ has rank one, so den and numᵢ are affine in
   each parameter alone; Re(f · direction) - c |den| is concave in each alone, and so positive in the whole cell.
2. *One stable plant.*  The sampled model of the middle of the box is enclosed (Taylor series of the matrix
   exponential), and the characteristic polynomial is stable by its reflection coefficients (Schur and Cohn), for each
   whole number of additional samples of dead time.
3. The degree of the characteristic polynomial is that of all plants, since det M > 0 at all corners.  No root crosses
   the unit circle between two plants, so that all plants are stable.

Every number is an integer multiple of a power of two, and every bound includes what was rounded.  That the bodies and
the control are those of a machine is not checked here.
"""

import hashlib
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise, permutations, product
from typing import Any, NamedTuple

FORMAT = "feeddrive box proof, version 1"
MOST_BYTES = 100_000_000
MOST_STATES, MOST_BODIES, MOST_PARAMETERS, MOST_LATE, MOST_DELAY = 60, 6, 12, 100, 1100
MOST_POWER = 300  # numbers other than 0 lie between 2^-300 and 2^300
MOST_NORM = 400  # of the matrix of the bodies times the sample time
BITS = 320  # a number of the cells is an integer multiple of 2^-BITS
ONE = 1 << BITS
DEEP = 64  # further bits of the corners, so that what so many halvings cut off is below a unit
IMAGES = 2  # images on either side that are computed; the others are bounded together
PRECISIONS = 512, 1024, 2048, 4096  # bits with which the plant in the middle is examined, one after the other
BROKEN = (LookupError, TypeError, AttributeError, ValueError, ArithmeticError, RecursionError)
MISSING = "its entry '{}' is missing: take the file as feeddrive certify --box wrote it, or write it again"

Polynomial = list[Fraction]  # coefficients by rising power
Matrix = list[list[Fraction]]
Corner = tuple[tuple[int, ...], ...]  # den and each numᵢ of a plant, coefficients in units of 2^-(BITS + DEEP)


class RefusedError(Exception):
    """The file does not prove what it claims."""


def need(condition: Any, reason: str) -> None:
    """Raise RefusedError unless a condition holds."""
    if not condition:
        raise RefusedError(reason)


def number(value: Any, what: str) -> Fraction:
    """Return a finite number, exactly."""
    need(isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value), f"{what}: no number")
    found = Fraction(value)
    need(not found or 2.0**-MOST_POWER <= abs(found) <= 2.0**MOST_POWER, f"{what} = {value!r} is out of range")
    return found


def row(values: Any, count: int, what: str) -> list[Fraction]:
    """Return a row of `count` numbers."""
    need(isinstance(values, list) and len(values) == count, f"{what}: {count} numbers are needed")
    return [number(value, what) for value in values]


def matrix(rows: Any, count: int, width: int, what: str) -> Matrix:
    """Return a matrix of `count` rows."""
    need(isinstance(rows, list) and len(rows) == count, f"{what}: {count} rows are needed")
    return [row(values, width, what) for values in rows]


def pi(bits: int) -> int:
    """Return the largest integer below π 2^bits, by Machin's formula."""

    def arctan(x: int) -> int:
        # of 1/x; every term is off by less than 2 units
        unit = 1 << (bits + 64)
        total, term, k = 0, unit // x, 1
        while term:
            total += term // k if k % 4 == 1 else -(term // k)
            term, k = term // (x * x), k + 2
        return total

    return (16 * arctan(5) - 4 * arctan(239)) >> 64


PI = pi(BITS)  # π lies between PI and PI + 2 units


# polynomials


def plus(a: Polynomial, b: Polynomial, factor: int = 1) -> Polynomial:
    """Return a + factor b."""
    n = max(len(a), len(b))
    first, second = ([*p, *[Fraction(0)] * (n - len(p))] for p in (a, b))
    return [x + factor * y for x, y in zip(first, second, strict=True)]


def times(a: Sequence[Any], b: Sequence[Any], zero: Any) -> list[Any]:
    """Return the product of two polynomials."""
    found = [zero] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            found[i + j] = found[i + j] + x * y
    return found


def determinant(entries: Sequence[Sequence[Polynomial]]) -> Polynomial:
    """Return the determinant of a matrix of polynomials."""
    n, found = len(entries), [Fraction(0)]
    for order in permutations(range(n)):
        term = [Fraction((-1) ** sum(order[i] > order[j] for i in range(n) for j in range(i + 1, n)))]
        for i, j in enumerate(order):
            term = times(term, entries[i][j], Fraction(0)) if any(entries[i][j]) else []
            if not term:
                break
        found = plus(found, term)
    return found


class Control(NamedTuple):
    """The polynomials in z of a control: D, and an Nᵢ for each reading."""

    readings: list[str]
    D: Polynomial
    N: list[Polynomial]


def control_of(entry: Mapping[str, Any]) -> Control:
    """Return D = det(z - A) and Nᵢ = C adj(z - A) Bᵢ + Dᵢ D of the control, exactly (Faddeev and LeVerrier)."""
    readings = entry["readings"]
    need(0 < len(readings) <= 2 and len(set(readings)) == len(readings), "control: one or two readings are needed")
    n, m = len(entry["A"]), len(readings)
    need(n <= MOST_STATES, f"control: at most {MOST_STATES} states")
    A, B = matrix(entry["A"], n, n, "control A"), matrix(entry["B"], n, m, "control B")
    C, D = matrix(entry["C"], 1, n, "control C")[0], matrix(entry["D"], 1, m, "control D")[0]
    # whole numbers, with one unit for all: sums of fractions would cost a greatest common divisor each
    unit = math.lcm(1, *(x.denominator for values in (*A, *B, C) for x in values))
    a, b = ([[int(x * unit) for x in values] for values in part] for part in (A, B))
    c = [int(x * unit) for x in C]
    power = [[int(i == j) for j in range(n)] for i in range(n)]  # M_k, in units of unit^-(k - 1)
    falling: list[int] = [1]  # of det(z - A), in units of unit^-k
    through: list[list[int]] = [[] for _ in readings]
    for k in range(1, n + 1):
        left = [sum(x * power[i][j] for i, x in enumerate(c) if x) for j in range(n)]
        for i in range(m):
            through[i].append(sum(x * b[j][i] for j, x in enumerate(left) if x))
        columns = list(zip(*power, strict=True))
        power = [[sum(x * y for x, y in zip(values, column, strict=True) if x) for column in columns] for values in a]
        trace = sum(power[i][i] for i in range(n))
        need(trace % k == 0, "control: its polynomial is not whole")
        falling.append(-trace // k)
        for i in range(n):
            power[i][i] += falling[-1]
    found = [Fraction(x, unit**k) for k, x in enumerate(falling)][::-1]
    passed = [[Fraction(x, unit ** (k + 2)) for k, x in enumerate(values)][::-1] for values in through]
    return Control(list(readings), found, [plus(p, [d * x for x in found]) for p, d in zip(passed, D, strict=True)])


class Parameter(NamedTuple):
    """An uncertain parameter: its ends, and the matrix of rank one that it multiplies."""

    name: str
    low: Fraction
    high: Fraction
    is_mass: bool
    factor: Fraction
    vector: list[Fraction]


class Bodies(NamedTuple):
    """The plants: the matrices without the parameters, and the drive; times in samples."""

    T: Fraction
    mass: Matrix
    damping: Matrix
    stiffness: Matrix
    force: list[Fraction]
    readings: list[list[Fraction]]
    parameters: list[Parameter]
    delay: Fraction
    lag: Fraction | None  # ωc T

    def at(self, values: Sequence[Fraction]) -> tuple[Matrix, Matrix]:
        """Return M and K with parameters of these values."""
        parts = [[list(r) for r in part] for part in (self.mass, self.stiffness)]
        for p, value in zip(self.parameters, values, strict=True):
            part = parts[0 if p.is_mass else 1]
            for i, x in enumerate(p.vector):
                for j, y in enumerate(p.vector):
                    part[i][j] += value * p.factor * x * y
        return parts[0], parts[1]

    def polynomials(self, values: Sequence[Fraction]) -> list[Polynomial]:
        """Return den and numᵢ in σ = sT, both times the same power of T."""
        M, K = self.at(values)
        n, T = len(M), self.T
        inner = [[[K[i][j] * T * T, self.damping[i][j] * T, M[i][j]] for j in range(n)] for i in range(n)]
        found = [determinant(inner)]
        for reading in self.readings:
            bordered: list[list[Polynomial]] = [[*inner[i], [self.force[i]]] for i in range(n)]
            bordered.append([*([x] for x in reading), [Fraction(0)]])
            found.append([-T * T * x for x in determinant(bordered)])
        return found


def bodies_of(document: Mapping[str, Any], readings: Sequence[str]) -> Bodies:
    """Return the plants of the file."""
    plant = document["plant"]
    n, T = len(plant["mass"]), number(document["sample_time_s"], "sample_time_s")
    need(0 < n <= MOST_BODIES and T > 0, f"plant: 1 to {MOST_BODIES} bodies and a sample time > 0 are needed")
    parts = [matrix(plant[name], n, n, name) for name in ("mass", "damping", "stiffness")]
    need(all(part[i][j] == part[j][i] for part in parts for i in range(n) for j in range(i)), "plant: not symmetric")
    need(len(document["uncertain"]) <= MOST_PARAMETERS, f"at most {MOST_PARAMETERS} parameters")
    parameters: list[Parameter] = []
    for entry in document["uncertain"]:
        name = str(entry["name"])
        low, high = number(entry["from"], name), number(entry["to"], name)
        need(low < high, f"{name}: its ends are not in order")
        need(entry["adds_to"] in ("mass", "stiffness"), f"{name}: it adds to neither mass nor stiffness")
        vector, factor = row(entry["vector"], n, name), number(entry["factor"], name)
        parameters.append(Parameter(name, low, high, entry["adds_to"] == "mass", factor, vector))
    delay = number(plant["dead_time_s"], "dead_time_s") / T
    need(0 <= delay <= MOST_DELAY, f"the dead time must be 0 to {MOST_DELAY} samples")
    stated = plant["current_loop_rad_s"]
    lag = None if stated is None else number(stated, "current_loop_rad_s") * T
    need(lag is None or lag > Fraction(1, 1000), "current_loop_rad_s must be above a thousandth of the sample rate")
    seen = [row(plant["readings"][name], n, name) for name in readings]
    M, C, K = parts
    return Bodies(T, M, C, K, row(plant["force"], n, "force"), seen, parameters, delay, lag)


# whole numbers in units of 2^-BITS


def fixed(value: Fraction, bits: int = BITS) -> int:
    """Return the largest integer below a number in units."""
    return (value.numerator << bits) // value.denominator


def size(re: int, im: int) -> int:
    """Return an upper bound of the magnitude of a complex number."""
    return math.isqrt(re * re + im * im) + 1


class Line(NamedTuple):
    """A function y of θ with |y - value - slope (θ - θ0)| <= rest where |θ - θ0| <= δ."""

    re: int
    im: int
    slope_re: int
    slope_im: int
    rest: int

    def most(self, delta: int) -> int:
        """Return an upper bound of the magnitude."""
        # that of a straight line is convex, so its largest value is at an end
        x, y = self.slope_re * delta >> BITS, self.slope_im * delta >> BITS
        return max(size(self.re + x, self.im + y), size(self.re - x, self.im - y)) + self.rest + 4

    def times(self, other: "Line", delta: int) -> "Line":
        """Return the product."""
        a, b = self, other
        slope_a = (size(a.slope_re, a.slope_im) * delta >> BITS) + 1
        slope_b = (size(b.slope_re, b.slope_im) * delta >> BITS) + 1
        size_a, size_b = size(a.re, a.im) + slope_a, size(b.re, b.im) + slope_b
        rest = (slope_a * slope_b + a.rest * (size_b + b.rest) + b.rest * size_a >> BITS) + 1
        return Line(
            a.re * b.re - a.im * b.im >> BITS,
            a.re * b.im + a.im * b.re >> BITS,
            a.re * b.slope_re - a.im * b.slope_im + a.slope_re * b.re - a.slope_im * b.im >> BITS,
            a.re * b.slope_im + a.im * b.slope_re + a.slope_re * b.im + a.slope_im * b.re >> BITS,
            # what is cut off: at most 2 units of the value, and 2 of the slope over δ < 4
            rest + 10,
        )

    def minus(self, other: "Line") -> "Line":
        """Return the difference."""
        a, b = self, other
        slope_re, slope_im = a.slope_re - b.slope_re, a.slope_im - b.slope_im
        return Line(a.re - b.re, a.im - b.im, slope_re, slope_im, a.rest + b.rest)


class Ball(NamedTuple):
    """A complex number within `radius` of re + j im."""

    re: int
    im: int
    radius: int

    def plus(self, other: "Ball") -> "Ball":
        """Return the sum."""
        return Ball(self.re + other.re, self.im + other.im, self.radius + other.radius)

    def times(self, other: "Ball") -> "Ball":
        """Return the product."""
        a, b = self, other
        far = size(a.re, a.im) * b.radius + a.radius * (size(b.re, b.im) + b.radius)
        re, im = a.re * b.re - a.im * b.im >> BITS, a.re * b.im + a.im * b.re >> BITS
        return Ball(re, im, (far >> BITS) + 3)

    def scaled(self, factor: Fraction) -> "Ball":
        """Return the number times a real one."""
        re, im = (x * factor.numerator // factor.denominator for x in (self.re, self.im))
        radius = -(-self.radius * abs(factor.numerator) // factor.denominator)
        return Ball(re, im, radius + 2)


def turned(angle: int) -> Ball:
    """Return e^(jx) of an angle in units, by its Taylor series after it was halved until it is below 2^-16."""
    halvings = max(0, (abs(angle) >> (BITS - 16)).bit_length())
    x = Ball(0, angle >> halvings, 1)
    found = term = Ball(ONE, 0, 0)
    k = 1
    while size(term.re, term.im) > 4:
        term = term.times(x).scaled(Fraction(1, k))
        found, k = found.plus(term), k + 1
    # the terms left out are less than twice the last one
    found = found._replace(radius=found.radius + 16)
    for _ in range(halvings):
        found = found.times(found)
    return found


def line_of(value: Ball, slope: Ball, rest: int, delta: int) -> Line:
    """Return a function from its value, its slope and a bound on the rest."""
    return Line(value.re, value.im, slope.re, slope.im, rest + value.radius + (slope.radius * delta >> BITS) + 2)


class Table(NamedTuple):
    """What evaluates polynomials in jθ with real coefficients on an interval |θ - θ0| <= δ.

    terms  for each power of θ - θ0, the factors of the even and of the odd coefficients, with the signs of j^m
    slop   units by which value, slope δ and rest together may be wrong
    """

    theta: int
    delta: int
    terms: list[tuple[list[tuple[int, int]], list[tuple[int, int]]]]
    powers: list[int]
    slop: int

    def line(self, p: Sequence[int]) -> Line:
        """Return a polynomial on the interval; its coefficients are in units of 2^-(BITS + DEEP)."""
        rest, ends = self.slop, list[tuple[int, int]]()
        for k, (even, odd) in enumerate(self.terms):
            re = sum([p[m] * t for m, t in even]) >> BITS + DEEP
            im = sum([p[m] * t for m, t in odd]) >> BITS + DEEP
            if k < 2:
                ends.append((re, im))
            else:
                rest += (size(re, im) * self.powers[k] >> BITS) + 1
        return Line(*ends[0], *ends[1], rest)


def table_of(theta: int, delta: int, degree: int, largest: int) -> Table:
    """Return the table of an interval, θ0 >= 0; `largest` is an upper bound of all coefficients, >= 1."""
    powers, steps = [ONE], [ONE]
    for _ in range(degree):
        powers.append(powers[-1] * theta >> BITS)
        steps.append((steps[-1] * delta >> BITS) + 1)
    terms: list[tuple[list[tuple[int, int]], list[tuple[int, int]]]] = []
    for k in range(degree + 1):
        both: tuple[list[tuple[int, int]], list[tuple[int, int]]] = [], []
        for m in range(k, degree + 1):
            factor = math.comb(m, k) * powers[m - k]
            both[m % 2].append((m, factor if m % 4 < 2 else -factor))
        terms.append(both)
    # θ0^m is off by less than m Θ^m units with Θ >= 1, θ0 and δ, and a coefficient by less than 2; each of these is
    # multiplied by at most (2 Θ)^m in the sum over all powers of δ; the rest is for what the sums cut off
    reach = max(2 * ((theta + delta >> BITS) + 1), 2)
    slop = (degree + 1) * reach**degree * (degree * largest + degree + 8)
    return Table(theta, delta, terms, steps, slop)


class Interval(NamedTuple):
    """What does not depend on the plant on one interval of θ.

    D, drives  D and each Nᵢ G;  D_most, through  upper bounds of |D| and |Nᵢ|
    main       the table of the interval itself
    images     for each image its table and a bound on |G| there
    far        Σ |G|/θ² over all other images
    """

    delta: int
    D: Line
    drives: list[Line]
    D_most: int
    through: list[int]
    main: Table
    images: list[tuple[Table, int]]
    far: int


class Frequencies:
    """The functions of frequency alone, for one number of additional samples of dead time."""

    def __init__(self, bodies: Bodies, control: Control, degree: int, largest: int, late: int) -> None:
        self.bodies, self.degree, self.largest = bodies, degree, largest
        # in w = z - 1, in which integrators lose no digits
        self.polynomials = [
            [sum((p[m] * math.comb(m, k) for m in range(k, len(p))), Fraction(0)) for k in range(len(p))]
            for p in (control.D, *control.N)
        ]
        self.behind = Fraction(1, 2) + bodies.delay + late

    def at(self, low: int, high: int) -> Interval:
        """Return the functions on low <= θ <= high, in units."""
        theta = (low + high) // 2
        delta = max(high - theta, theta - low)
        half = turned(theta // 2)
        # θ/2 is off by a unit, which is that of its value at most
        half = half._replace(radius=half.radius + 1)
        D, *Ns = self._control(half, delta)
        G = self._drive(theta, half, delta)
        stop = min(abs(half.im) + half.radius + 1 + delta // 2 + 1, ONE)
        images = [self._image(theta, delta, k, stop) for k in range(-IMAGES, IMAGES + 1) if k]
        # Σ over |k| > IMAGES of 2 stop/θ³ with θ >= 2π (|k| - 1/2)
        edge = IMAGES + Fraction(1, 2)
        factor = 4 * (1 / edge**3 + Fraction(1, 2) / edge**2) / Fraction(2 * PI, ONE) ** 3
        far = -(-stop * factor.numerator // factor.denominator)
        return Interval(
            delta, D, [N.times(G, delta) for N in Ns], D.most(delta), [N.most(delta) for N in Ns],
            table_of(theta, delta, self.degree, self.largest), images, far,
        )  # fmt: skip

    def _image(self, theta: int, delta: int, k: int, stop: int) -> tuple[Table, int]:
        """Return the table at θ + 2πk, where real polynomials have the magnitude of those at -θ - 2πk, and a |G|."""
        # 2π|k| is 2 PI |k| and less than 4 |k| units more
        there, wide = abs(theta + 2 * PI * k), delta + 4 * abs(k)
        low = there - wide
        need(low > 0, "an interval reaches its images")
        gain = -(-2 * stop * ONE // low)
        if self.bodies.lag is not None:
            lag = fixed(self.bodies.lag)
            gain = gain * (lag + 1) // math.isqrt(lag * lag + low * low) + 1
        return table_of(there, wide, self.degree, self.largest), gain

    def _control(self, half: Ball, delta: int) -> Iterator[Line]:
        """Yield D and Nᵢ; `half` is e^(jθ/2)."""
        # w = 2j sin(θ/2) e^(jθ/2)
        z, w = half.times(half), Ball(0, 2 * half.im, 2 * half.radius).times(half)
        n = len(self.polynomials[0])
        powers = [Ball(ONE, 0, 0)]
        for _ in range(n - 1):
            powers.append(powers[-1].times(w))
        turn = z.times(Ball(0, ONE, 0))
        for p in self.polynomials:
            terms: list[Ball] = []
            for k in range(n):
                term = Ball(0, 0, 0)
                for m in range(k, len(p)):
                    if p[m]:
                        term = term.plus(powers[m - k].scaled(p[m] * math.comb(m, k)))
                terms.append(term)
            rest, step = 0, delta
            for k, term in enumerate(terms):
                magnitude = size(term.re, term.im) + term.radius
                if k == 1:
                    # |z - z0 - jz0 (θ - θ0)| <= δ²/2
                    rest += (magnitude * (delta * delta >> BITS) >> BITS + 1) + 2
                if k >= 2:
                    step = (step * delta >> BITS) + 1
                    rest += (magnitude * step >> BITS) + 1
            slope = terms[1].times(turn) if n > 1 else Ball(0, 0, 0)
            yield line_of(terms[0], slope, rest, delta)

    def _drive(self, theta: int, turn: Ball, delta: int) -> Line:
        """Return G = sin(θ/2)/(θ/2) e^(-jθ behind) lag/(lag + jθ); `turn` is e^(jθ/2)."""
        x, half = theta // 2, delta // 2 + 1
        if x < ONE >> 8:
            # the next term of each series is below its last one
            square = x * x >> BITS
            sinc = ONE - square // 6 + square * square // (120 << BITS)
            slope = -x // 3 + square * x // (30 << BITS)
            off = (square * square >> BITS) * square // (5040 << BITS) + 8
            off += (square * square >> BITS) * x * half // (840 << 2 * BITS) + 8
        else:
            sinc = (turn.im << BITS) // x
            slope = (turn.re - sinc << BITS) // x
            off = ((turn.radius + 2 << BITS) // x + 2) * (3 * ONE + (half << 2)) // x + 8
        # |sinc''| <= 1/3
        held = Line(sinc, 0, slope // 2, 0, (half * half >> BITS) // 6 + 1 + off + 2 * half // ONE)
        behind = self.behind
        angle = Ball(theta, 0, 0).scaled(behind)
        turn = turned(-angle.re)
        turn = turn._replace(radius=turn.radius + angle.radius)
        second = Ball(delta, 0, 0).scaled(behind)
        late = second.re + second.radius
        whole = held.times(
            line_of(turn, turn.times(Ball(0, -ONE, 0)).scaled(behind), (late * late >> BITS + 1) + 2, delta), delta
        )
        if self.bodies.lag is None:
            return whole
        lag = fixed(self.bodies.lag)
        # lag/(lag + jθ), its slope -j lag/(lag + jθ)², and half of the second derivative, lag/|lag + jθ|³
        below = lag * lag + theta * theta
        # lag is off by a unit, and the slope of the quotient with it is below 1/lag
        pole = Ball(lag * (lag << BITS) // below, -theta * (lag << BITS) // below, 4 + ONE // lag)
        slope_ = pole.times(pole).scaled(1 / self.bodies.lag).times(Ball(0, -ONE, 0))
        near = max(theta - delta, 0)
        low = math.isqrt(lag * lag + near * near)
        rest = ((lag + 1) * delta * delta << BITS) // (low * low * low) + 2
        return whole.times(line_of(pole, slope_, rest, delta), delta)


# cells


def least_along(line: Line, x: int, y: int, delta: int) -> int:
    """Return a lower bound of Re((x - jy) · line) on the interval, less its rest times |x + jy|."""
    length = size(x, y)
    straight = x * line.re + y * line.im - (abs(x * line.slope_re + y * line.slope_im) * delta >> BITS) - 1
    return straight - line.rest * length


def direction(code: int, around: int) -> tuple[int, int]:
    """Return the vector |x| + |y| = around of a code 0 <= code < 4 around, counterclockwise from (around, 0)."""
    quarter, t = divmod(code, around)
    # in units of 2^-64: the upper bound of its magnitude is rounded up by one
    x, y = around - t << 64, t << 64
    return ((x, y), (-y, x), (-x, -y), (y, -x))[quarter]


def mean_direction(lines: Sequence[Line]) -> tuple[int, int]:
    """Return about the mean of the directions of values, in units of 2^-64; it need not be exact."""
    x = y = 0
    for line in lines:
        length = size(line.re, line.im)
        x, y = x + (line.re << 64) // length, y + (line.im << 64) // length
    return x, y


class Cells:
    """The test of cells of plants and frequencies."""

    def __init__(self, bodies: Bodies, control: Control, bound: Fraction | None) -> None:
        self.bodies, self.control, self.bound = bodies, control, bound
        ends = [(p.low, p.high) for p in bodies.parameters]
        found = [bodies.polynomials(values) for values in product(*ends)]
        top = 2 * len(bodies.mass)
        need(all(parts[0][top] > 0 for parts in found), "a plant of the box has no positive mass")
        # in a unit in which the determinant of the masses is 1 at the first corner
        unit = found[0][0][top]
        found = [[[x / unit for x in [*p, *[Fraction(0)] * (top + 1 - len(p))]] for p in parts] for parts in found]
        self.degree = top
        self.largest = math.ceil(max(1, *(abs(x) for parts in found for p in parts for x in p)))
        self.corners: list[Corner] = [tuple(tuple(fixed(x, BITS + DEEP) for x in p) for p in parts) for parts in found]
        self.beyond = self._beyond(found)
        self.least = Fraction(0) if bound is None else 1 / bound

    def _beyond(self, found: Sequence[Sequence[Polynomial]]) -> list[int]:
        """Return βᵢ with |numᵢ/den| <= βᵢ/θ² beyond the images that are computed, at all plants of the box."""
        top = self.degree
        first = (IMAGES + Fraction(1, 2)) * Fraction(2 * PI, ONE)
        largest = [[max(abs(parts[r][m]) for parts in found) for m in range(top + 1)] for r in range(len(found[0]))]
        leading = min(parts[0][top] for parts in found)
        others = sum(largest[0][m] / first ** (top - m) for m in range(top))
        need(others < leading, "the plant has a mode beyond two sample rates")
        need(all(p[m] == 0 for parts in found for p in parts[1:] for m in (top - 1, top)), "a reading sees the force")
        above = [sum(p[m] / first ** (top - 2 - m) for m in range(top - 1)) for p in largest[1:]]
        return [fixed(x / (leading - others)) + 1 for x in above]

    def tails(self, corners: Sequence[Corner], here: Interval) -> list[int]:
        """Return upper bounds of tailᵢ in a cell."""
        total = [(here.far * beta >> BITS) + 1 for beta in self.beyond]
        for table, gain in here.images:
            dens = [table.line(corner[0]) for corner in corners]
            x, y = mean_direction(dens)
            least = min(least_along(den, x, y, table.delta) for den in dens) // size(x, y)
            need(least > 0, "an image of the cell may have a pole")
            for i in range(len(total)):
                largest = max(table.line(corner[1 + i]).most(table.delta) for corner in corners)
                total[i] += gain * largest // least + 1
        return total

    def holds(self, corners: Sequence[Corner], here: Interval, x: int, y: int) -> bool:
        """Return whether the inequality holds in a cell, in the direction (x, y)."""
        delta, length = here.delta, size(x, y)
        tails = self.tails(corners, here)
        images = sum((a * b >> BITS) + 1 for a, b in zip(here.through, tails, strict=True))
        share = here.D_most * self.least.numerator // self.least.denominator + 1 + images
        for corner in corners:
            den = here.main.line(corner[0])
            f = here.D.times(den, delta)
            for drive, p in zip(here.drives, corner[1:], strict=True):
                f = f.minus(drive.times(here.main.line(p), delta))
            taken = (share * den.most(delta) >> BITS) + 1
            if least_along(f, x, y, delta) - taken * length <= 0:
                return False
        return True


def halved(corners: Sequence[Corner], bit: int) -> tuple[list[Corner], list[Corner]]:
    """Return the corners of both halves of a cell, along the parameter whose upper ends have this bit set."""
    lower, upper = list(corners), list(corners)
    for i in range(len(corners)):
        if i & bit:
            middle = tuple(
                tuple((x + y) >> 1 for x, y in zip(p, q, strict=True))
                for p, q in zip(corners[i ^ bit], corners[i], strict=True)
            )
            lower[i] = upper[i ^ bit] = middle
    return lower, upper


def tree_holds(
    tree: Sequence[Any], low: int, high: int, cells: Cells, frequencies: Frequencies, around: int, what: str
) -> int:
    """Check the cells of one interval of frequency; return how many there are."""
    count, found = len(cells.bodies.parameters), 0
    known: dict[tuple[int, int], Interval] = {}
    waiting = [(low, high, cells.corners, 0)]
    for code in tree:
        need(waiting, f"{what}: it goes on behind its last cell")
        need(isinstance(code, int) and not isinstance(code, bool), f"{what}: {code!r} is no cell")
        first, last, corners, depth = waiting.pop()
        if code >= 0:
            need(code < 4 * around, f"{what}: {code} is no direction")
            if (first, last) not in known:
                known[first, last] = frequencies.at(first, last)
            x, y = direction(code, around)
            need(cells.holds(corners, known[first, last], x, y), f"{what}: cell {found + 1} is not proven")
            found += 1
        elif -code <= count:
            need(depth < DEEP, f"{what}: more than {DEEP} halvings of the box")
            lower, upper = halved(corners, 1 << (count + code))
            waiting += [(first, last, upper, depth + 1), (first, last, lower, depth + 1)]
        else:
            need(-code == count + 1, f"{what}: there is no parameter {-code}")
            middle = (first + last) // 2
            waiting += [(middle, last, corners, depth), (first, middle, corners, depth)]
    need(not waiting, f"{what}: cells are missing")
    return found


# the plant in the middle


class Span(NamedTuple):
    """A real number between two integers, in units of 2^-bits."""

    low: int
    high: int
    bits: int

    def __add__(self, other: Any) -> "Span":
        """Return the sum."""
        return Span(self.low + other.low, self.high + other.high, self.bits)

    def __sub__(self, other: Any) -> "Span":
        """Return the difference."""
        return Span(self.low - other.high, self.high - other.low, self.bits)

    def __mul__(self, other: Any) -> "Span":
        """Return the product."""
        ends = self.low * other.low, self.low * other.high, self.high * other.low, self.high * other.high
        return Span(min(ends) >> self.bits, -(-max(ends) >> self.bits), self.bits)

    def over(self, other: "Span") -> "Span | None":
        """Return the quotient; None if the divisor may be 0."""
        if other.low <= 0 <= other.high:
            return None
        ends = [Fraction(x << self.bits, y) for x in (self.low, self.high) for y in (other.low, other.high)]
        return Span(math.floor(min(ends)), math.ceil(max(ends)), self.bits)


def span(value: Fraction, bits: int) -> Span:
    """Return a number."""
    return Span(fixed(value, bits), -fixed(-value, bits), bits)


Spans = list[list[Span]]


def product_of(a: Spans, b: Spans) -> Spans:
    """Return the product of two matrices."""
    columns, zero = list(zip(*b, strict=True)), Span(0, 0, a[0][0].bits)
    return [[sum((x * y for x, y in zip(values, column, strict=True)), zero) for column in columns] for values in a]


def exponential(A: Matrix, bits: int) -> Spans:
    """Return e^A: a Taylor series, with a bound on what is left out."""
    n = len(A)
    norm = max(sum(abs(x) for x in values) for values in A)
    need(norm <= MOST_NORM, "the plant is too stiff for its sample time")
    start = [[span(Fraction(int(i == j)), bits) for j in range(n)] for i in range(n)]
    step = [[span(x, bits) for x in values] for values in A]
    found, term, k, left = start, start, 0, Fraction(1)
    while k < 2 * norm + 2 or left > Fraction(1, 1 << bits):
        k += 1
        share = span(Fraction(1, k), bits)
        term = [[x * share for x in values] for values in product_of(term, step)]
        found = [[x + y for x, y in zip(r, s, strict=True)] for r, s in zip(found, term, strict=True)]
        left = left * norm / k
        # short fractions: rounded up
        left = Fraction(fixed(left, 2 * bits) + 1, 1 << 2 * bits)
    # of a geometric series with a ratio below 1/2, in units
    off = fixed(2 * left, bits) + 1
    return [[Span(x.low - off, x.high + off, bits) for x in values] for values in found]


def inverted(M: Matrix) -> Matrix:
    """Return the inverse of a matrix, exactly."""
    n = len(M)
    whole = [[*values, *(Fraction(int(i == j)) for j in range(n))] for i, values in enumerate(M)]
    for i in range(n):
        pivot = next((k for k in range(i, n) if whole[k][i]), None)
        need(pivot is not None, "the mass matrix is singular")
        assert pivot is not None
        whole[i], whole[pivot] = whole[pivot], whole[i]
        whole[i] = [x / whole[i][i] for x in whole[i]]
        for k in range(n):
            if k != i and whole[k][i]:
                whole[k] = [x - whole[k][i] * y for x, y in zip(whole[k], whole[i], strict=True)]
    return [values[n:] for values in whole]


def characteristic(bodies: Bodies, control: Control, late: int, bits: int) -> list[Span]:
    """Return the characteristic polynomial of the loop with the plant in the middle of the box, by rising power."""
    M, K = bodies.at([(p.low + p.high) / 2 for p in bodies.parameters])
    inverse, n, T = inverted(M), len(M), bodies.T
    lagged = bodies.lag is not None
    states = 2 * n + lagged
    # of q, T q', the force of a current loop, and the command, over a sample
    A = [[Fraction(0)] * (states + 1) for _ in range(states + 1)]
    entered = [sum((inverse[i][k] * bodies.force[k] for k in range(n)), Fraction(0)) * T * T for i in range(n)]
    for i in range(n):
        A[i][n + i] = Fraction(1)
        for j in range(n):
            A[n + i][j] = -T * T * sum((inverse[i][k] * K[k][j] for k in range(n)), Fraction(0))
            A[n + i][n + j] = -T * sum((inverse[i][k] * bodies.damping[k][j] for k in range(n)), Fraction(0))
        A[n + i][2 * n] = entered[i]  # of the force, or of the command itself
    if bodies.lag is not None:
        A[2 * n][2 * n], A[2 * n][2 * n + 1] = -bodies.lag, bodies.lag
    whole = math.floor(bodies.delay)
    part = bodies.delay - whole
    before, after = (exponential([[x * share for x in values] for values in A], bits) for share in (part, 1 - part))
    inner = [values[:states] for values in after[:states]]
    step = product_of(inner, [values[:states] for values in before[:states]])
    now = [[values[states]] for values in after[:states]]
    old = product_of(inner, [[values[states]] for values in before[:states]])
    zero, one = Span(0, 0, bits), span(Fraction(1), bits)
    # det(z - step), and its adjugate between readings and both commands
    power = [[one if i == j else zero for j in range(states)] for i in range(states)]
    falling, through = [one], [[[zero] * states for _ in range(2)] for _ in bodies.readings]
    for k in range(1, states + 1):
        for i, reading in enumerate(bodies.readings):
            seen = [[span(x, bits) for x in reading] + [zero] * (states - n)]
            for j, entry in enumerate((now, old)):
                through[i][j][states - k] = product_of(product_of(seen, power), entry)[0][0]
        moved = product_of(step, power)
        trace = sum((moved[i][i] for i in range(states)), zero)
        falling.append(zero - trace * span(Fraction(1, k), bits))
        power = [[x + falling[-1] if i == j else x for j, x in enumerate(values)] for i, values in enumerate(moved)]
    D, *Ns = ([span(x, bits) for x in p] for p in (control.D, *control.N))
    found = [zero] * (whole + late + 1) + times(D, falling[::-1], zero)
    for N, (new, previous) in zip(Ns, through, strict=True):
        # a command acts a whole number of samples later, and its rest one more
        both = [previous[0], *(a + b for a, b in zip(new, previous[1:], strict=False)), new[-1]]
        for i, x in enumerate(times(N, both, zero)):
            found[i] = found[i] - x
    return found


def stable(found: Sequence[Span]) -> bool | None:
    """Return whether all roots of a polynomial lie inside the unit circle; None if that cannot be told.

    A polynomial p of degree n is stable if |r| < 1 with r = p₀/pₙ, and (p(z) - r zⁿ p(1/z))/z is.
    """
    rest = list(found)
    while len(rest) > 1:
        r = rest[0].over(rest[-1])
        one = 1 << rest[0].bits
        if r is None or (r.low < one <= r.high) or (r.low <= -one < r.high):
            return None
        if r.low >= one or r.high <= -one:
            return False
        rest = [x - r * y for x, y in zip(rest, reversed(rest), strict=True)][1:]
    return True


def middle_is_stable(bodies: Bodies, control: Control, late: int) -> None:
    """Raise RefusedError unless the loop with the plant in the middle of the box is stable."""
    for bits in PRECISIONS:
        verdict = stable(characteristic(bodies, control, late, bits))
        if verdict is not None:
            need(verdict, f"the plant in the middle of the box is unstable with {late} more samples of dead time")
            return
    need(False, f"it cannot be told whether the plant in the middle is stable with {late} more samples of dead time")


# files


def digest(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the document without its digest entry."""
    rest = {name: value for name, value in document.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def verified(document: Any) -> list[str]:
    """Return what the document proves, in sentences. Raises RefusedError if it does not."""
    need(isinstance(document, dict) and document.get("format") == FORMAT, "it is no proof over a box of plants")
    need("sha256" in document, MISSING.format("sha256"))
    need(document["sha256"] == digest(document), "the file was changed: its digest is another one")
    need(document["verdict"] == "proven", f"its verdict is not proven, but {document['verdict']}")
    need("trees" in document, "the cells of its proof were not kept: there were too many")
    control = control_of(document["control"])
    bodies = bodies_of(document, control.readings)
    stated = document["sensitivity_peak"]
    bound = None if stated is None else number(stated, "sensitivity_peak")
    need(bound is None or bound > 1, "the bound on Ms must be above 1")
    last = document["late_samples"]
    need(isinstance(last, int) and 0 <= last <= MOST_LATE, f"late_samples must be 0 to {MOST_LATE}")
    edges = [number(x, "frequencies_rad_s") * bodies.T for x in document["frequencies_rad_s"]]
    need(len(edges) > 1 and edges[0] == 0 and all(a < b for a, b in pairwise(edges)), "the frequencies do not rise")
    places = [fixed(x) for x in edges]
    need(places[-1] >= PI + 2, "the frequencies end below that of Nyquist")
    need(places[-1] <= PI + (ONE >> 10), "the frequencies go on beyond that of Nyquist")
    around, trees = document["directions"], document["trees"]
    need(isinstance(around, int) and 1 <= around <= 10**6, "directions must be 1 to 10^6")
    need(len(trees) == (last + 1) * (len(edges) - 1), "trees: one is needed for each interval and dead time")
    cells, found = Cells(bodies, control, bound), 0
    for late in range(last + 1):
        middle_is_stable(bodies, control, late)
        frequencies = Frequencies(bodies, control, cells.degree, cells.largest, late)
        for i, (low, high) in enumerate(pairwise(places)):
            what = f"{late} samples later, from {float(edges[i] / bodies.T):.6g} rad/s"
            # the floor of an edge: the next interval begins there, and this one reaches up to it
            found += tree_holds(trees[late * (len(edges) - 1) + i], low, high, cells, frequencies, around, what)
    robust = "" if bound is None else f" and Ms <= {stated!r}"
    ends = "; ".join(f"{p.name} {float(p.low)!r} to {float(p.high)!r}" for p in bodies.parameters)
    return [f"stable{robust} at every plant: {ends}; 0 to {last} more samples of dead time", f"{found} cells"]


def checked(path: str) -> tuple[list[str], bool]:
    """Check a file; return the sentences on it, the last one being the verdict, and True if it is proven."""
    try:
        with open(path, "rb") as file:
            content = file.read(MOST_BYTES + 1)
        need(len(content) <= MOST_BYTES, "it is larger than 100 MB")
        document = json.loads(content)
        sentences = verified(document)
        sentences += [f"outside: {'; '.join(map(str, document['outside']))}", "PROVEN"]
        proven = True
    except OSError as error:
        sentences, proven = [f"REFUSED: {path} cannot be read: {error.strerror}"], False
    except RefusedError as error:
        sentences, proven = [f"REFUSED: {path}: {error}"], False
    except KeyError as error:
        sentences, proven = [f"REFUSED: {path}: {MISSING.format(error.args[0])}"], False
    except (json.JSONDecodeError, UnicodeDecodeError):
        sentences, proven = (
            [f"REFUSED: {path}: it is not whole JSON: the file was cut off or changed, copy it anew"],
            False,
        )
    except BROKEN as error:
        said = f"REFUSED: {path}: it is not built as such a proof is: {type(error).__name__} {error}"
        sentences, proven = [said], False
    shown = (" ".join(line.split()) for line in sentences)
    return ["".join(c if c.isprintable() and c.isascii() else "?" for c in line) for line in shown], proven


def main(arguments: list[str]) -> int:
    """Check one file and print the sentences; the last line is the verdict."""
    sentences, proven = checked(arguments[0]) if len(arguments) == 1 else (["REFUSED: give one file"], False)
    sys.stdout.write("\n".join(sentences) + "\n")
    return 0 if proven else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
