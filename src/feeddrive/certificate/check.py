"""Checks a certificate of a servo loop in exact integer arithmetic. Standard library alone: copy this file anywhere.

    python check.py CERTIFICATE.json        exit code 0: proven; 1: refused, with one line that says why

For a law with two rates it takes `check_periods.py`, which must stand beside it.
It trusts no figure that it can compute.  With C = Nc/Dc of the control (force over readings), P = Np/Dp of a plant:

    F = Dc Dp - Σ Nci Npi           characteristic polynomial of the closed loop, of degree n: all states of both
    |F(z)| > Σ ri |Nci Npi|         for every |z| = 1; with one disc for all readings: r |Σ Nci Npi|

Nominal stability: the Routh array of F((1 + s)/(1 - s)), free of fractions, has a positive first column.
All frequencies: with u = sin²(πfT), |F|² and |N|² on the unit circle are polynomials in u.  Over a stretch of u the
difference is positive if all its Bernstein coefficients are; a stretch where they are not is halved, exactly.
By Rouché's theorem every plant in the discs, P (1 + Δ), then has a stable loop.
"""

from __future__ import annotations

import bisect
import hashlib
import json
import math
import pathlib
import re
import runpy
import struct
import sys
from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from operator import mul
from typing import Any

Poly = list[int]  # whole coefficients, lowest power first
Matrix = list[list[float]]
Numerators = dict[tuple[int, int], Poly]  # by output and input
Polynomials = tuple[Poly, Numerators]

FORMAT, VERSION, MOST_BYTES = "feeddrive certificate", 1, 64_000_000
OTHER = "it is no certificate; give the certificate.json that `feeddrive certify` wrote"
KEPT = Fraction(999, 1000)  # of a claimed reserve that is proven
NODES, DEPTH = 20_000, 160  # stretches of u before the check gives up
BROKEN = (LookupError, TypeError, AttributeError, ValueError, ArithmeticError, RecursionError)
HEX = re.compile(r"-?0x[01](\.[0-9a-f]{1,13})?p[+-]\d{1,4}")


class RefusedError(Exception):
    """The reason why a certificate is refused, in one line, with the frequency in Hz, if there is one."""

    def __init__(self, reason: str, frequency: float | None = None) -> None:
        super().__init__(reason)
        self.frequency = frequency


def need(condition: Any, reason: str, frequency: float | None = None) -> None:
    """Refuse unless the condition holds."""
    if not condition:
        raise RefusedError(reason, frequency)


def exact(text: Any, what: str) -> float:
    """A number in hexadecimal, as a float: no digit can be lost."""
    need(isinstance(text, str) and HEX.fullmatch(text), f"{what} is not a hexadecimal number")
    need(abs(int(text.partition("p")[2])) <= 300, f"{what} is out of range")
    return float.fromhex(text)


def plain(value: Any, what: str, least: float = 0.0, most: float = 1e12) -> float:
    """A number of a JSON file between two bounds."""
    fine = isinstance(value, (int, float)) and not isinstance(value, bool) and least <= value <= most
    need(fine, f"{what} is not a number from {least:g} to {most:g}")
    return float(value)


def row(value: Any, length: int | None, what: str) -> list[Any]:
    """A list, of a length if one is given."""
    need(isinstance(value, list) and (length is None or len(value) == length), f"{what} has not the right length")
    return value


def system(given: Any, what: str) -> dict[str, Matrix]:
    """A, B, C, D of a linear system."""
    need(isinstance(given, dict) and {"A", "B", "C", "D"} <= set(given), f"{what} has no matrices A, B, C, D")
    A = row(given["A"], None, what)
    n, outputs = len(A), len(row(given["C"], None, what))
    inputs = len(row(given["D"], outputs, what)[0]) if outputs and isinstance(given["D"][0], list) else 0
    need(1 <= inputs <= 2 and 1 <= outputs <= 2 and n <= 60, f"{what} is empty or too large")
    sizes = {"A": (n, n), "B": (n, inputs), "C": (outputs, n), "D": (outputs, inputs)}
    return {
        name: [[exact(x, what) for x in row(line, n, what)] for line in row(given[name], m, what)]
        for name, (m, n) in sizes.items()
    }


def whole(values: Matrix) -> tuple[list[Poly], int]:
    """A matrix of floats as integers over one power of two."""
    bits = max([x.as_integer_ratio()[1].bit_length() - 1 for line in values for x in line], default=0)
    return [[int(Fraction(x) * 2**bits) for x in line] for line in values], bits


def polynomials(system: dict[str, Matrix]) -> Polynomials:
    """det(z - A) and C adj(z - A) B + D det(z - A), lowest power first, as integers over one common factor.

    Faddeev and Le Verrier: M <- A M + c, c = -trace(A M)/k.
    """
    (A, a), (B, b), (C, c), (D, d) = (whole(system[name]) for name in "ABCD")
    n, entries = len(A), [(i, j) for i in range(len(C)) for j in range(len(D[0]))]
    scale = max(b + c, d)
    det, above = [0] * n + [1 << scale], {entry: [0] * (n + 1) for entry in entries}
    m = [[int(i == j) for j in range(n)] for i in range(n)]
    sparse = [[(j, x) for j, x in enumerate(line) if x] for line in A]
    for k in range(1, n + 1):
        for i, j in entries:
            seen = sum(C[i][p] * sum(m[p][q] * B[q][j] for q in range(n)) for p in range(n) if C[i][p])
            above[i, j][n - k] = seen << (a + scale - b - c)
        m = [[sum(x * m[q][j] for q, x in line) for j in range(n)] for line in sparse]
        coefficient, rest = divmod(-sum(m[i][i] for i in range(n)), k)
        need(rest == 0, "the characteristic polynomial is not whole")
        det[n - k] = coefficient << scale
        for i in range(n):
            m[i][i] += coefficient
    # powers of z = y/2^a, all over 2^(a n): that of det(y - 2^a A) has a factor 2^(a (n - k)) at z^k
    det = [x << (a * k) for k, x in enumerate(det)]
    for i, j in entries:
        above[i, j] = [(x << (a * k)) + ((D[i][j] * det[k]) >> d) for k, x in enumerate(above[i, j])]
    return det, above


def times(p: Poly, q: Poly) -> Poly:
    """The product of two polynomials."""
    places = range(len(p) + len(q) - 1)
    return [sum(p[i] * q[k - i] for i in range(max(0, k - len(q) + 1), min(len(p), k + 1))) for k in places]


def stable(F: Poly) -> bool:
    """All zeros inside the unit circle: the Routh array of F((1 + s)/(1 - s)) (1 - s)^n has one sign (Jeltsch 1979)."""
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
        by = rows[k - 2][0] if k > 2 else 1
        rows.append([(q[0] * p[i + 1] - p[0] * q[i + 1]) // by for i in range(len(p) - 1)] or [0])
    return True


def squared(p: Poly, n: int) -> Poly:
    """Bernstein coefficients on u = 0..1 of |p|² on the unit circle, times lcm of all binomials n over k."""
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
    """The Bernstein coefficients of both halves, times 2^n."""
    n, left, right, now = len(b) - 1, [], [], b
    for k in range(n + 1):
        left.append(now[0] << (n - k))
        right.append(now[-1] << (n - k))
        now = [x + y for x, y in pairwise(now)]
    return left, right[::-1]


def ratio(a: int, b: int) -> float:
    """√(a/b) of two whole numbers >= 0, as a float."""
    try:
        return math.sqrt(a / b)
    except (OverflowError, ZeroDivisionError):
        return 1e150


class Bands:
    """The radii over u; the edges are widened by more than sin² in floats can be wrong."""

    def __init__(self, given: Any, discs: int, T: float) -> None:
        self.edges, self.radii, low = [], [], 0.0
        for k, band in enumerate(row(given, None, "radius")):
            need(isinstance(band, dict) and set(band) == {"from_Hz", "to_Hz", "r"}, f"radius.{k} is not a band")
            need(band["from_Hz"] == low, f"there is a gap in the radius at {low:.6g} Hz")
            low = plain(band["to_Hz"], f"radius.{k}.to_Hz", math.nextafter(low, math.inf), 1e9)
            self.edges.append(low)
            self.radii.append([plain(r, f"radius.{k}.r", 0.0, 1e9) for r in row(band["r"], discs, f"radius.{k}.r")])
        need(0 < len(self.edges) <= 20_000, "there is no radius, or too many")
        need(abs(low * T * 2.0 - 1.0) < 1e-9, f"the radius ends at {low:.6g} Hz and not at half the sample rate")
        self.T, self.u = T, [math.sin(math.pi * f * T) ** 2 for f in self.edges[:-1]] + [1.0]
        self.starts = [0.0, *(u * (1.0 - 1e-12) for u in self.u[:-1])]
        self.ends = [*(u * (1.0 + 1e-12) for u in self.u[:-1]), 1.0]

    def most(self, low: float, high: float) -> list[float]:
        """The largest radii on a closed stretch of u."""
        first, last = bisect.bisect_left(self.ends, low), bisect.bisect_right(self.starts, high)
        return [max(each) for each in zip(*self.radii[first:last], strict=True)]

    def at(self, f: float) -> list[float]:
        """The radii at a frequency in Hz, on an edge the larger ones."""
        u = min(1.0, math.sin(math.pi * f * self.T) ** 2)
        return self.most(u, u)


def separated(F: Poly, N: list[Poly], bands: Bands, reserve: Fraction) -> int:
    """Refuses unless |F| > reserve Σ ri |Ni| for all u in 0..1; returns the number of stretches."""
    n, nodes = len(F) - 1, 0
    waiting = [(0, 0, [squared(p, n) for p in (F, *N)])]
    while waiting:
        i, depth, parts = waiting.pop()
        nodes += 1
        low, high = i / 2**depth, (i + 1) / 2**depth
        f = math.asin(math.sqrt(low)) / (math.pi * bands.T)
        need(nodes <= NODES and depth <= DEPTH, f"|1 + L| > r|L| cannot be shown near {f:.6g} Hz", f)
        r = [Fraction(x) * reserve for x in bands.most(low, high)]
        # (Σ ri |Ni|)² <= Σ ri² |Ni|²/mi for any mi > 0 of sum 1 (Cauchy and Schwarz); it is sharp for mi as ri |Ni|
        size = [float(x) * ratio(p[0] + p[-1], parts[0][0] + parts[0][-1]) for x, p in zip(r, parts[1:], strict=True)]
        m = [Fraction(max(x, 1e-6 * max(size), 1e-200)) for x in size]
        factor = [x * x * sum(m) / y for x, y in zip(r, m, strict=True)]
        q = math.lcm(*(x.denominator for x in factor))
        p = [x.numerator * (q // x.denominator) for x in factor]
        if all(q * b[0] > sum(map(mul, p, b[1:])) for b in zip(*parts, strict=True)):
            continue
        there = float(reserve) * sum(map(mul, bands.most(low, low), (ratio(b[0], parts[0][0]) for b in parts[1:])))
        need(there < 1.0, f"r|L| is {there:.4g} of |1 + L| at {f:.6g} Hz", f)
        both = [halved(b) for b in parts]
        waiting += [(2 * i + 1, depth + 1, [b[1] for b in both]), (2 * i, depth + 1, [b[0] for b in both])]
    return nodes


def at(polynomials: Sequence[Poly], f: float, T: float) -> list[complex]:
    """Polynomials at e^(j2πfT), all over one factor: a point of 60 binary digits, and from there on exact."""
    angle, most, found = 2.0 * math.pi * f * T, max(map(len, polynomials)), []
    x, y = (round(Fraction(part) * 2**60) for part in (math.cos(angle), math.sin(angle)))
    for p in polynomials:
        re, im = 0, 0
        for k, c in enumerate(reversed(p + [0] * (most - len(p)))):
            re, im = re * x - im * y + (c << (60 * k)), re * y + im * x
        found.append((re, im))
    digits = max(0, max(abs(part) for each in found for part in each).bit_length() - 900)
    return [complex(re >> digits, im >> digits) for re, im in found]


def parse(content: bytes) -> dict[str, Any]:
    """The document; refuses JSON that other readers may read differently."""
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
    """SHA-256 over everything but the digest."""
    rest = {name: value for name, value in document.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def represented(x: float, arithmetic: str) -> bool:
    """Whether the arithmetic has the number: float64, float32, or fixed with so many binary places."""
    if arithmetic == "float32":
        return struct.unpack("f", struct.pack("f", x))[0] == x
    return not arithmetic.startswith("fixed") or (Fraction(x) * 2 ** int(arithmetic[5:])).denominator == 1


def prepared(control: Any) -> Polynomials | list[Any]:
    """The control of a certificate: its polynomials, or its linear systems over a period."""
    samples = [system(each, "control") for each in control.get("samples", [control])]
    need(all(len(each["C"]) == 1 for each in samples), "the control must have one output, the force")
    need(len({(len(each["A"]), len(each["D"][0])) for each in samples}) == 1, "its samples do not fit each other")
    return samples if "samples" in control else polynomials(samples[0])


def proven(control: Polynomials | list[Any], plant: Any, T: float) -> tuple[Poly, Numerators, Bands, int, int]:
    """Stability and margin of a plant; its det(z - A), its numerators and bands, how many poles and stretches."""
    model = system(plant["model"], "model")
    readings = len(control[1]) if isinstance(control, tuple) else len(control[0]["D"][0])
    need(len(model["D"][0]) == 1 and len(model["C"]) == readings, "it does not fit the control")
    need(not any(x for line in model["D"] for x in line), "a plant responds without delay")
    bands, reserve = Bands(plant["radius"], {"one": 1, "each": readings}[plant["discs"]], T), plant["reserve"]
    reserve = None if reserve is None else plain(reserve, "reserve", 1.0, 1e9)
    factor = max(Fraction(1), Fraction(reserve or 1) * KEPT)
    f = plain(plant["reserve_at_Hz"], "reserve_at_Hz", 0.0, 0.5 / T * (1.0 + 1e-9))
    Dp, Np = polynomials(model)
    if isinstance(control, list):
        second = pathlib.Path(__file__).with_name("check_periods.py")
        need(second.is_file(), "it has two rates: check_periods.py must stand beside the checker")
        prove = runpy.run_path(str(second))["proven"]
        poles, nodes, there = prove(control, model, bands, float(factor), f, need, lambda A: stable(polynomials(A)[0]))
    else:
        parts = [times(control[1][0, i], Np[i, 0]) for i in range(readings)]
        loop = [sum(each) for each in zip(*parts, strict=True)]
        closed = [x - y for x, y in zip(times(control[0], Dp), loop, strict=True)]
        split = parts if plant["discs"] == "each" else [loop]
        spare = min((x & -x).bit_length() for p in (closed, *split) for x in p if x) - 1
        F, *N = [[x >> spare for x in p] for p in (closed, *split)]
        need(stable(F), "the nominal loop is not stable")
        poles, nodes = len(F) - 1, separated(F, N, bands, factor)
        whole, *each = at((F, *N), f, T)
        there = sum(r * abs(x / whole) for r, x in zip(bands.at(f), each, strict=True))
    need(reserve is None or abs(reserve * there - 1.0) < 2e-3, f"its reserve is not {reserve} at {f:.6g} Hz", f)
    return Dp, Np, bands, poles, nodes


def inside(plant: Any, Dp: Poly, Np: Numerators, bands: Bands, sure: float, T: float) -> int:
    """Refuses unless |G - P| + sure √variance <= r|P| on every measured line; returns their number."""
    rows, discs = row(plant["lines"], None, "lines"), len(bands.radii[0])
    need(not rows or len(rows) == len(Np) or all(Np[i, 0] == Np[0, 0] for i in range(len(Np))), "lines are missing")
    need(len(rows) <= discs, "lines of two readings need a disc each")
    for i, lines in enumerate(rows):
        for line in row(lines, None, "lines"):
            f, re, im, variance = row(line, 4, "a line")
            f, G = plain(f, "a frequency", 0.0, 0.5 / T), complex(plain(re, "a line", -1e9), plain(im, "a line", -1e9))
            above, below = at((Np[i, 0], Dp), f, T)
            off = abs(G - above / below) + sure * math.sqrt(plain(variance, "a variance"))
            need(off <= bands.at(f)[i] * abs(above / below) * (1.0 + 1e-9), f"the line at {f:.6g} Hz is outside of r")
    return sum(map(len, rows))


def verified(document: Mapping[str, Any]) -> list[str]:
    """The proof, a sentence for each plant; RefusedError with the reason if anything does not hold."""
    need(document.get("format") == FORMAT, OTHER)
    need(document.get("version") == VERSION, f"its version is {document.get('version')!r:.20}, this is for {VERSION}")
    missing = {"sample_time_s", "arithmetic", "numbers", "control", "plants", "outside", "confidence"} - set(document)
    need(not missing, f"it has no {', '.join(sorted(missing))}")
    need(document.get("sha256") == digest(document), "its content does not fit its SHA-256: it was changed")
    T, arithmetic = exact(document["sample_time_s"], "sample_time_s"), document["arithmetic"]
    need(1e-9 < T < 10.0, "the sample time is not between 1 ns and 10 s")
    need(re.fullmatch(r"float64|float32|fixed[1-9]\d?", arithmetic), "its arithmetic is not known")
    for name, x in document["numbers"].items():
        need(represented(exact(x, name), arithmetic), f"{name} is not a number of {arithmetic}")
    outside = " ".join(document["outside"])
    need("saturation" in outside and "friction" in outside, "it does not list saturation and friction as outside")
    answers, plants, said = prepared(document["control"]), row(document["plants"], None, "plants"), []
    need(0 < len(plants) <= 100, "there is no plant, or more than a hundred")
    confidence = plain(document["confidence"], "confidence", 0.0, 1.0 - 1e-12)
    count = sum(len(lines) for plant in plants for lines in plant["lines"])
    sure = math.sqrt(math.log(max(count, 1) / (1.0 - confidence)))  # P(|dG|² > q var) = e^-q, all lines (Bonferroni)
    for plant in plants:
        name = str(plant["name"])[:60]
        try:
            Dp, Np, bands, degree, nodes = proven(answers, plant, T)
            lines = inside(plant, Dp, Np, bands, sure, T)
        except RefusedError as error:
            raise RefusedError(f"'{name}': {error}", error.frequency) from None
        room = "" if plant["reserve"] is None else f"; the discs could be {plant['reserve']:.4g} times as wide"
        r = f"{min(map(min, bands.radii)):.4g} to {max(map(max, bands.radii)):.4g}{room}"
        count = f"{degree} poles, {nodes} stretches, {lines} measured lines inside"
        margin = "|1 + L| > r|L|" if isinstance(answers, tuple) else "r sum|H| < 1"
        said.append(f"'{name}': stable, and {margin} at all frequencies, with discs of r = {r}; {count}")
    return said


def checked(path: str) -> tuple[list[str], bool]:
    """The sentences on a file, the verdict last, and whether it is proven."""
    proven = False
    try:
        with open(path, "rb") as file:
            document = parse(file.read(MOST_BYTES + 1))
        said = [*verified(document), f"outside: {'; '.join(document['outside'])}"]
        said.append(f"PROVEN: plants: {len(said) - 1}, coefficients: {document['arithmetic']}")
        proven = True
    except OSError as error:
        said = [f"REFUSED: {path} cannot be read: {error.strerror}"]
    except RefusedError as error:
        said = [f"REFUSED: {path}: {error}"]
    except BROKEN as error:
        said = [f"REFUSED: {path}: it is not built as a certificate is: {type(error).__name__} {error}"]
    shown = (" ".join(line.split()) for line in said)
    return ["".join(c if c.isprintable() and c.isascii() else "?" for c in line) for line in shown], proven


def main(arguments: list[str]) -> int:
    """Check one file; the last line is the verdict."""
    said, proven = checked(arguments[0]) if len(arguments) == 1 else (["REFUSED: give one certificate.json"], False)
    sys.stdout.write("\n".join(said) + "\n")
    return 0 if proven else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
