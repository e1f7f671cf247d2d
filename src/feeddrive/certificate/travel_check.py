"""Check a proof along the travel of an axis (`travel_proof.json`) with Python's standard library alone.

    python travel_check.py FILE

The file holds, for each cell of positions, polynomials that enclose the closed loop X = [A b; c d], entry by entry, and
a matrix P at both of its ends.  Checked are that the cells cover the travel and that, at all of their positions,

    [ Π'    Xᵀ Γ   ]
    [ Γ X   2Γ - Π ]  > 0,    Γ = diag(G, 1), Π = diag(P, 1), Π' = diag(P', γ²), G the mean of P at both ends,

from which Xᵀ diag(P, 1) X < diag(P, γ²) follows: each frozen loop is stable and |S| < γ at all frequencies.  If it
moves, P is continuous from cell to cell, P' is that of the last sample, at most two steps away, and γ is left out.

Numbers are floats: every bound includes its rounding, and a Cholesky factorization of the matrix less all bounds proves
it positive definite (Rump 2006).  That the polynomials are those of a machine is not checked here.
"""

import hashlib
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise, product
from typing import Any

FORMAT = "feeddrive travel proof, version 1"
MOST_BYTES = 100_000_000
MOST_STATES = 60
UNIT = 2.0**-53
ROUND = 1.05 * UNIT  # of a sum of products, for each of its operations
BROKEN = (LookupError, TypeError, AttributeError, ValueError, ArithmeticError, RecursionError)
MISSING = "its entry '{}' is missing: take the file as feeddrive travel wrote it, or write it again"

Matrix = list[list[float]]


class RefusedError(Exception):
    """The file does not prove what it claims."""


def need(condition: Any, reason: str) -> None:
    """Raise RefusedError unless a condition holds."""
    if not condition:
        raise RefusedError(reason)


def number(value: Any, what: str) -> float:
    """Return a finite number."""
    need(isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value), f"{what}: no number")
    return float(value)


def matrix(rows: Any, n: int, what: str) -> Matrix:
    """Return a symmetric matrix from the rows of its lower half."""
    need(isinstance(rows, list) and len(rows) == n, f"{what}: {n} rows are needed")
    found = [[0.0] * n for _ in range(n)]
    for i, row in enumerate(rows):
        need(isinstance(row, list) and len(row) == i + 1, f"{what}: row {i + 1} needs {i + 1} numbers")
        for j, value in enumerate(row):
            found[i][j] = found[j][i] = number(value, what)
    return found


def times(a: Matrix, b: Matrix) -> Matrix:
    """Return the product of two matrices."""
    columns = list(zip(*b, strict=True))
    return [[sum(x * y for x, y in zip(row, column, strict=True) if x) for column in columns] for row in a]


def turned(a: Matrix) -> Matrix:
    """Return the transpose."""
    return [list(row) for row in zip(*a, strict=True)]


def size(a: Matrix) -> Matrix:
    """Return the magnitudes of all entries."""
    return [[abs(x) for x in row] for row in a]


def mixed(a: Matrix, factor: float, b: Matrix, other: float) -> Matrix:
    """Return factor A + other B."""
    return [[factor * x + other * y for x, y in zip(r, s, strict=True)] for r, s in zip(a, b, strict=True)]


def factor(a: Matrix) -> Matrix | None:
    """Return the lower Cholesky factor; None if the factorization does not end."""
    n = len(a)
    found = [[0.0] * n for _ in range(n)]
    for i in range(n):
        row = found[i]
        for j in range(i + 1):
            left = a[i][j] - sum(x * y for x, y in zip(row[:j], found[j][:j], strict=True))
            if i > j:
                row[j] = left / found[j][j]
            elif left > 0.0:
                row[j] = math.sqrt(left)
            else:
                return None
    return found


def inverse(lower: Matrix) -> Matrix:
    """Return about the inverse of a lower triangular matrix; it need not be exact."""
    n = len(lower)
    found = [[0.0] * n for _ in range(n)]
    for j in range(n):
        for i in range(j, n):
            left = (1.0 if i == j else 0.0) - sum(lower[i][k] * found[k][j] for k in range(j, i))
            found[i][j] = left / lower[i][i]
    return found


def positive(value: Matrix, rest: Matrix, before: Matrix, after: Matrix, weight: Matrix, W: Matrix) -> bool:
    """Return whether the matrix above is proven positive definite for all X with |X - value| <= rest.

    before, after, weight  Π', Π and Γ;  W  any matrix: W Γ Wᵀ should be near 1
    """
    n = len(value)
    A, Wt = size(W), turned(W)
    At = turned(A)
    upper = times(times(W, before), Wt)
    lower = times(times(W, mixed(weight, 2.0, after, -1.0)), Wt)
    cross = times(times(W, times(weight, value)), Wt)
    lost = mixed(rest, 1.0 + (3 * n + 4) * ROUND, size(value), (3 * n + 4) * ROUND)
    error = times(times(A, times(size(weight), lost)), At)
    plain = (2 * n + 12) * ROUND
    error_upper = times(times(A, size(before)), At)
    error_lower = times(times(A, mixed(size(weight), 2.0, size(after), 1.0)), At)
    whole = [[*upper[i], *(cross[j][i] for j in range(n))] for i in range(n)]
    whole += [[*cross[i], *lower[i]] for i in range(n)]
    whole = [[0.5 * (whole[i][j] + whole[j][i]) for j in range(2 * n)] for i in range(2 * n)]
    trace = sum(abs(whole[i][i]) for i in range(2 * n))
    for i in range(n):
        up = plain * max(sum(error_upper[i]), sum(row[i] for row in error_upper)) + sum(row[i] for row in error)
        low = plain * max(sum(error_lower[i]), sum(row[i] for row in error_lower)) + sum(error[i])
        for place, taken in ((i, up), (n + i, low)):
            whole[place][place] -= taken * (1.0 + 1e-10) + (2 * n + 2) * 2.0 * UNIT * trace
            whole[place][place] -= abs(whole[place][place]) * 1e-15 + 1e-300
    return factor(whole) is not None


def bernstein(terms: Sequence[float]) -> list[float]:
    """Return the coefficients of a polynomial on -1 <= t <= 1 in Bernstein's basis."""
    n = len(terms) - 1
    # t = 2 s - 1
    powers = [
        sum(math.comb(j, i) * 2.0**i * (-1.0) ** (j - i) * terms[j] for j in range(i, n + 1)) for i in range(n + 1)
    ]
    return [sum(math.comb(k, i) / math.comb(n, i) * powers[i] for i in range(k + 1)) for k in range(n + 1)]


def corners(entries: Any, n: int, what: str) -> tuple[list[Matrix], list[Matrix], Matrix]:
    """Return the corners of the polynomials of a cell, the slopes along other variables, and the rest."""
    need(isinstance(entries, list) and entries, f"{what}: entries are needed")
    count, others = len(entries[0][2]), len(entries[0][3])
    need(2 <= count <= 9 and others <= 8, f"{what}: terms and slopes")
    found = [[[0.0] * n for _ in range(n)] for _ in range(count)]
    slopes = [[[0.0] * n for _ in range(n)] for _ in range(others)]
    rest = [[0.0] * n for _ in range(n)]
    seen = set[tuple[int, int]]()
    spread = sum(abs(x) for k in range(count) for x in bernstein([float(j == k) for j in range(count)]))
    for i, j, terms, slope, left in entries:
        need(isinstance(i, int) and isinstance(j, int) and 0 <= i < n and 0 <= j < n, f"{what}: place of an entry")
        need((i, j) not in seen, f"{what}: entry {i}, {j} stands there twice")
        need(len(terms) == count and len(slope) == others, f"{what}: lengths of an entry")
        seen.add((i, j))
        terms, slope = [number(x, what) for x in terms], [number(x, what) for x in slope]
        need(number(left, what) >= 0.0, f"{what}: a rest is negative")
        for k, x in enumerate(bernstein(terms)):
            found[k][i][j] = x
        for k, x in enumerate(slope):
            slopes[k][i][j] = x
        whole = sum(map(abs, terms))
        # of the conversion to Bernstein's basis, and of one addition for each slope
        rest[i][j] = float(left) + ROUND * (
            (8 * count + others + 1) * spread * whole + (others + 1) * sum(map(abs, slope))
        )
    return found, slopes, rest


def padded(P: Matrix, last: float) -> Matrix:
    """Return diag(P, last)."""
    n = len(P)
    return [[*row, 0.0] for row in P] + [[*([0.0] * n), last]]


def covered(cells: Sequence[tuple[float, float]], first: float, last: float) -> bool:
    """Return whether intervals, in any order, leave no gap between two positions."""
    reached = first
    for low, high in sorted(set(cells)):
        if low > reached:
            return False
        reached = max(reached, high)
    return reached >= last


def frozen(document: Mapping[str, Any], n: int) -> str:
    """Check the cells of a frozen axis; return a sentence."""
    bound = document["sensitivity_peak"]
    if bound is not None:
        need(number(bound, "sensitivity_peak") > 1.0, "the bound on Ms must be above 1")
    first, last = number(document["from_m"], "from_m"), number(document["to_m"], "to_m")
    need(first < last, "the travel has no length")
    cells: list[tuple[float, float]] = []
    for cell in document["cells"]:
        low, high = number(cell["from_m"], "from_m"), number(cell["to_m"], "to_m")
        what = f"the cell from {low!r} to {high!r} m"
        need(low < high, f"{what} has no length")
        need(cell["branches"], f"{what} has no model")
        ends = [matrix(cell[name], n, what) for name in ("low", "high")]
        for end in ends:
            need(factor(end), f"{what}: P is not positive definite")
        G = mixed(ends[0], 0.5, ends[1], 0.5)
        weight = G if bound is None else padded(G, 1.0)
        lower = factor(weight)
        need(lower, f"{what}: G is not positive definite")
        assert lower is not None
        W = inverse(lower)
        for entries in cell["branches"]:
            found, slopes, rest = corners(entries, n + 1, what)
            need(not slopes, f"{what} has slopes of other variables")
            if bound is None:
                found, rest = [[row[:n] for row in X[:n]] for X in found], [row[:n] for row in rest[:n]]
            for k, X in enumerate(found):
                share = k / (len(found) - 1)
                here = mixed(ends[0], 1.0 - share, ends[1], share)
                most = None if bound is None else bound * bound * (1.0 - 4.0 * UNIT)
                before, after = (here, here) if most is None else (padded(here, most), padded(here, 1.0))
                need(positive(X, rest, before, after, weight, W), f"{what} is not proven")
        cells.append((low, high))
    need(covered(cells, first, last), "the cells leave a gap in the travel")
    robust = "" if bound is None else f" and Ms <= {bound!r}"
    return f"frozen: stable{robust} at every position from {first!r} to {last!r} m, {len(set(cells))} cells"


def moving(document: Mapping[str, Any], n: int) -> Iterator[str]:
    """Check the cells of an axis that moves; yield a sentence, if there are any."""
    part = document["moving"]
    if part is None:
        return
    step, T = number(part["step_m"], "step_m"), number(document["sample_time_s"], "sample_time_s")
    edges = [number(x, "edges_m") for x in part["edges_m"]]
    need(step > 0.0 and T > 0.0, "step and sample time must be positive")
    need(edges[0] <= document["from_m"] and edges[-1] >= document["to_m"], "the edges leave out a part of the travel")
    need(all(b - a >= 2.0 * step for a, b in pairwise(edges)), "a cell is shorter than two steps")
    P = [matrix(rows, n, f"P at {x!r} m") for x, rows in zip(edges, part["P"], strict=True)]
    change = [
        mixed(b, 1.0 / (y - x), a, -1.0 / (y - x)) for (x, y), (a, b) in zip(pairwise(edges), pairwise(P), strict=True)
    ]
    need(len(part["cells"]) == len(change), "the moving axis: a cell is missing")
    for i, branches in enumerate(part["cells"]):
        what = f"the moving axis from {edges[i]!r} to {edges[i + 1]!r} m"
        need(branches, f"{what} has no model")
        weight = mixed(P[i], 0.5, P[i + 1], 0.5)
        lower = factor(weight)
        need(lower, f"{what}: P is not positive definite")
        assert lower is not None
        W = inverse(lower)
        ways = {(1.0, i), (-1.0, i), (1.0, max(i - 1, 0)), (-1.0, min(i + 1, len(change) - 1))}
        for entries in branches:
            found, slopes, rest = corners(entries, n + 1, what)
            found, slopes = ([[row[:n] for row in X[:n]] for X in part_] for part_ in (found, slopes))
            rest = [row[:n] for row in rest[:n]]
            slopes = [slope for slope in slopes if any(map(any, slope))]
            for k, X in enumerate(found):
                after = mixed(P[i], 1.0 - k / (len(found) - 1), P[i + 1], k / (len(found) - 1))
                for sign in product((-1.0, 1.0), repeat=len(slopes)):
                    value = X
                    for s, slope in zip(sign, slopes, strict=True):
                        value = mixed(value, 1.0, slope, s)
                    for way, j in ways:
                        before = mixed(after, 1.0, change[j], -way * 2.0 * step)
                        need(positive(value, rest, before, after, weight, W), f"{what} is not proven")
    yield f"moving: stable up to {step / T:.4g} m/s, {len(change)} cells"


def digest(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the document without its digest entry."""
    rest = {name: value for name, value in document.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def verified(document: Any) -> list[str]:
    """Return what the document proves, in sentences. Raises RefusedError if it does not."""
    need(isinstance(document, dict) and document.get("format") == FORMAT, "it is no proof along a travel")
    need("sha256" in document, MISSING.format("sha256"))
    need(document["sha256"] == digest(document), "the file was changed: its digest is another one")
    n = len(document["states"])
    need(0 < n <= MOST_STATES, f"1 to {MOST_STATES} states are needed")
    return [frozen(document, n), *moving(document, n)]


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
