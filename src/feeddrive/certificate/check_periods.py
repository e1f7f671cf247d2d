"""The checker's second file, for a law with two rates: discs around a loop that repeats itself after N samples.

Standard library alone: copy it beside `check.py`, which takes it from there.  Lifted (Meyer 1990), with θ = 2πfNT:

    x(k+N) = A x(k) + B u,   y = C x(k) + D u       u, y: all N samples at the plant's input and of the force
    Hl(f) = part at f + l/(NT) of the force that a sine of 1 N at f adds to, l = 0 .. N-1, in the closed loop
    r(f) Σl |Hl(f)| < 1 at all f from 0 to half the sample rate

A, B, C, D are computed without rounding and then rounded once.  Over a stretch |θ - θ0| <= h the states are taken as
x0 + t x1 with a bound of the rest, in which every rounding is counted: with R near (ζ0 - A)⁻¹, W = |R|, t = θ - θ0

    (I - E + (ζ - ζ0) R) (x - x0 - t x1) = rest,   |x - x0 - t x1| <= (I - |E| - h W)⁻¹ |rest|,   E = I - R (ζ0 - A)

A stretch that is too wide for its bound is halved.  The bound also says that no pole lies on the circle, with the
matrices before and after their rounding and on the way between; so both have as many poles outside.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from operator import mul
from typing import Any, NamedTuple

Matrix = list[list[float]]
System = dict[str, Matrix]  # A, B, C, D
Complexes = list[complex]
Need = Callable[..., None]
Stable = Callable[[System], bool]

ROUND = 1e-12  # of a sum of at most 200 products of floats: thirty times what it can be wrong by
NODES, DEPTH = 20_000, 40  # stretches before the check gives up
NEAR = 0.75  # of |E| + h W: the spectral radius up to which a stretch is tried


class Lifted(NamedTuple):
    """Over a period: A (n rows), B (N columns of n), C (N rows of n), D (row a has the samples before a)."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


def lifted(samples: Sequence[System], plant: System) -> Lifted:
    """The closed loop of a plant with the samples of a control, from the plant's input to the force."""
    exact = [_closed(each, plant) for each in samples]
    n, bits = len(exact[0]) - 1, max(x.denominator.bit_length() for rows in exact for line in rows for x in line) - 1
    into = [0] * len(samples[0]["A"]) + [int(Fraction(x) * 2**bits) for (x,) in plant["B"]]
    through = [[int(i == j) for j in range(n)] for i in range(n)]  # of the states, then of the samples so far
    C, D, before, after = list[list[float]](), list[list[float]](), 1, 1  # `through` over `after`, a power of two
    for rows in exact:
        sparse = [[(j, int(x * 2**bits)) for j, x in enumerate(line) if x] for line in rows]
        moved = [[sum(x * through[j][k] for j, x in line) for k in range(len(through[0]))] for line in sparse]
        before, after = after, after << bits
        seen = [_float(x, after) for x in moved.pop()]
        C.append(seen[:n])
        D.append(seen[n:])
        through = [[*line, x * before] for line, x in zip(moved, into, strict=True)]
    last = [[_float(x, after) for x in line] for line in through]
    return Lifted([line[:n] for line in last], [list(column) for column in zip(*last, strict=True)][n:], C, D)


def _closed(control: System, plant: System) -> list[list[Fraction]]:
    """A sample of the closed loop: A, and the row that gives the force below it."""
    Ac, Bc, Cc, Dc, Ap, Bp, Cp = (
        [[Fraction(x) for x in line] for line in each]
        for each in (*(control[name] for name in "ABCD"), *(plant[name] for name in "ABC"))
    )

    def whole(own: list[Fraction], gains: list[Fraction]) -> list[Fraction]:
        return own + [sum(map(mul, gains, column), Fraction(0)) for column in zip(*Cp, strict=True)]

    m, force = len(Ac), whole(Cc[0], Dc[0])
    axis = [[Fraction(0)] * m + line for line in Ap]
    driven = [[x + b * y for x, y in zip(line, force, strict=True)] for line, (b,) in zip(axis, Bp, strict=True)]
    return [*(whole(line, gains) for line, gains in zip(Ac, Bc, strict=True)), *driven, force]


def _float(x: int, scale: int) -> float:
    value = x / scale
    if x and not 1e-280 < abs(value) < 1e280:
        raise ArithmeticError("a number of the loop over a period is out of range")
    return value


def inverse(given: Sequence[Complexes]) -> list[Complexes]:
    """By Gauss and Jordan, with the pivot that is largest in the scale of its row."""
    n = len(given)
    rows = [[*line, *(complex(i == j) for j in range(n))] for i, line in enumerate(given)]
    scale = [max(map(abs, line)) or 1.0 for line in given]
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(rows[i][k]) / scale[i])
        rows[k], rows[best], scale[k], scale[best] = rows[best], rows[k], scale[best], scale[k]
        pivot = rows[k][k] or 1e-300
        top = rows[k] = [x / pivot for x in rows[k]]
        for i in range(n):
            by = rows[i][k]
            if by and i != k:
                rows[i] = [x - by * y for x, y in zip(rows[i], top, strict=True)]
    return [line[n:] for line in rows]


def sums(rows: Sequence[Sequence[complex]], by: Sequence[complex]) -> list[Any]:
    """A matrix times a vector."""
    return [sum(map(mul, line, by)) for line in rows]


class Stretch:
    """(ζ - A)⁻¹ for |θ - θ0| <= h, with the bounds that hold for every input; `fits` unless it is too wide."""

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
        for _ in range(8):
            after = sums(self.M, self.p)
            self.q = max((x / y for x, y in zip(after, self.p, strict=True)), default=0.0) * (1.0 + ROUND)
            self.p = after
        self.fits = self.q <= NEAR

    def bounded(self, rest: list[float]) -> list[float]:
        """At least (I - M)⁻¹ rest: v + c p with (I - M)(v + c p) >= rest."""
        v = rest
        for _ in range(2):
            v = [x + y for x, y in zip(rest, sums(self.M, v), strict=True)]
        left = [x + y - z for x, y, z in zip(rest, sums(self.M, v), v, strict=True)]
        c = max((max(x, 0.0) / y for x, y in zip(left, self.p, strict=True)), default=0.0) / (1.0 - self.q)
        return [(x + c * y) * (1.0 + ROUND) for x, y in zip(v, self.p, strict=True)]

    def forces(self, k: int) -> tuple[Complexes, Complexes, float]:
        """Of a sine at (θ + 2πk)/(2πNT), all samples over that sine: y0 + (θ - θ0) y1, and √Σ(rest²)."""
        (_, B, C, D), h, N = self.loop, self.h, len(self.loop.C)
        turn = [cmath.exp(1j * (self.center + 2.0 * math.pi * k) * b / N) for b in range(N)]
        rows = list(zip(*B, strict=True))
        size = [sum(map(abs, line)) for line in rows]
        x0 = sums(self.R, sums(rows, turn))
        b1 = sums(rows, [1j * b / N * w for b, w in enumerate(turn)])
        x1 = sums(self.R, [b - 1j * self.zeta * x for b, x in zip(b1, x0, strict=True)])
        most = [abs(x) + h * abs(y) for x, y in zip(x0, x1, strict=True)]
        bent = [0.5 * h * h * sum((b / N) ** 2 * abs(x) for b, x in enumerate(line)) for line in rows]
        moved = [
            s + ROUND * (1.0 + h) * (b + m) + 0.5 * h * h * abs(x) + h * h * abs(y)
            for s, b, m, x, y in zip(bent, size, most, x0, x1, strict=True)
        ]
        rest = [w + e + ROUND * m for w, e, m in zip(sums(self.W, moved), sums(self.E, most), most, strict=True)]
        rest = self.bounded(rest)
        y0, y1, square = list[complex](), list[complex](), 0.0
        for a in range(N):
            back, s0, s1 = turn[a].conjugate(), sum(map(mul, C[a], x0)), sum(map(mul, C[a], x1))
            lag = [(b - a) / N for b in range(a)]
            there = [d * w * back for d, w in zip(D[a], turn, strict=False)]
            y0.append(back * s0 + sum(there))
            y1.append(back * (s1 - 1j * a / N * s0) + 1j * sum(map(mul, lag, there)))
            gains = [abs(c) for c in C[a]]
            loose = sum(map(mul, gains, rest)) + 0.5 * h * h * (a / N) ** 2 * (abs(s0) + h * abs(s1))
            loose += h * h * a / N * abs(s1) + 0.5 * h * h * sum(x * x * abs(d) for x, d in zip(lag, D[a], strict=True))
            loose += 4.0 * ROUND * (sum(map(mul, gains, most)) + sum(map(abs, D[a])))
            square += loose * loose
        return y0, y1, math.sqrt(square)


def most_of(stretch: Stretch, k: int, enough: float) -> float:
    """At least Σl |Hl| anywhere on the stretch; a rougher bound where that is below `enough`."""
    y0, y1, rest = stretch.forces(k)
    N, h = len(y0), stretch.h
    # the parts at all images have the mean square of all samples, and Σ|Hl| <= √N √Σ|Hl|²
    rough = math.sqrt(sum((abs(x) + h * abs(y)) ** 2 for x, y in zip(y0, y1, strict=True))) + rest
    if rough < enough:
        return rough
    ends = [0.0, 0.0]
    for each in range(N):
        back = [cmath.exp(-2j * math.pi * (each * a % N) / N) / N for a in range(N)]
        first, slope = sum(map(mul, back, y0)), h * sum(map(mul, back, y1))
        ends = [ends[0] + abs(first + slope), ends[1] + abs(first - slope)]  # convex in θ: largest at an end
    return max(ends) + rest + 10.0 * ROUND * rough


def at(loop: Lifted, f: float, T: float) -> float:
    """At least Σl |Hl| at a frequency in Hz from 0 to half the sample rate, to ten digits."""
    N = len(loop.C)
    turns = round(f * T * N)
    theta = 2.0 * math.pi * (f * T * N - turns)
    # of a negative one it is that of the image on the other side
    stretch = Stretch(loop, abs(theta), 0.0)
    return most_of(stretch, (turns if theta >= 0.0 else -turns) % N, 0.0) if stretch.fits else math.inf


def widest(bands: Any, low: float, high: float) -> float:
    """The largest radius between two frequencies in Hz; beyond half the sample rate it is that of the mirrored ones."""
    u = sorted(math.sin(math.pi * f * bands.T) ** 2 for f in (low, high))
    return bands.most(u[0] if low > 0.0 else 0.0, 1.0 if low <= 0.5 / bands.T <= high else u[1])[0]


def separated(loop: Lifted, bands: Any, factor: float, need: Need) -> int:
    """Refuses unless factor r Σl |Hl| < 1 at all frequencies; the number of stretches."""
    N, T, nodes, waiting = len(loop.C), bands.T, 0, [(0, 0)]
    per = 1.0 / (2.0 * math.pi * N * T)  # Hz
    while waiting:
        i, depth = waiting.pop()
        nodes += 1
        h = 0.5 * math.pi / 2**depth
        wide = h + 1e-14  # more than the center is rounded by
        stretch = Stretch(loop, (2 * i + 1) * h, wide)
        hertz = [(stretch.center + 2.0 * math.pi * k) * per for k in range(N)]
        near = f"near {hertz[0]:.6g} Hz and its images"
        need(nodes <= NODES and depth <= DEPTH, f"r Σ|H| < 1 cannot be shown {near}", hertz[0])
        fits = stretch.fits
        for k, f in enumerate(hertz if fits else []):
            r = widest(bands, f - wide * per, f + wide * per) * factor * (1.0 + 1e-12)
            if r == 0.0 or most_of(stretch, k, 0.999 / r) * r < 1.0:
                continue
            fits, f = False, min(f, 1.0 / T - f)
            there = bands.at(f)[0] * factor * at(loop, f, T)
            need(there < 1.0 + 1e-9, f"r Σ|H| is {there:.4g} at {f:.6g} Hz", f)
            break
        if not fits:
            waiting += [(2 * i + 1, depth + 1), (2 * i, depth + 1)]
    return nodes


def proven(
    samples: Sequence[System], plant: System, bands: Any, factor: float, f: float, need: Need, stable: Stable
) -> tuple[int, int, float]:
    """Refuses unless the loop is stable, and r Σl |Hl| < 1 with radii larger by a factor.

    Gives the number of poles, that of stretches, and r Σl |Hl| at f.  Radii, `need` and `stable` are of `check.py`.
    """
    need(len(bands.radii[0]) == 1, "with two rates there must be one disc for all readings")
    loop = lifted(samples, plant)
    n = len(loop.A)
    need(stable({"A": loop.A, "B": [[0.0]] * n, "C": [[0.0] * n], "D": [[0.0]]}), "the nominal loop is not stable")
    return n, separated(loop, bands, factor, need), bands.at(f)[0] * at(loop, f, bands.T)
