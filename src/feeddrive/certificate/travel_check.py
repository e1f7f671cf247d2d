"""Check a proof along the travel of an axis (`travel_proof.json`) with Python's standard library alone.

    python travel_check.py FILE

The file holds, for each cell of positions, polynomials that enclose the closed loop X = [A b; c d], entry by entry, and
a matrix P at both of its ends; with payloads, a cell is a rectangle, X has a slope along the payload, and P stands at
all four corners.  Checked are that the cells cover the travel with all payloads and that, in each of them,

    [ Π'    Xᵀ Γ   ]
    [ Γ X   2Γ - Π ]  > 0,    Γ = diag(G, 1), Π = diag(P, 1), Π' = diag(P', γ²), G the mean of P at all corners,

from which Xᵀ diag(P, 1) X < diag(P, γ²) follows: each frozen loop is stable and |S| < γ at all frequencies.  If it
moves, P is continuous from cell to cell, P' is that of the last sample, at most two steps away, and γ is left out.
At one position all of this is affine in the payload: what holds with two payloads holds between them.

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

FORMAT = "feeddrive travel proof, version 2"
MOST_BYTES = 100_000_000
MOST_STATES = 60
UNIT = 2.0**-53
ROUND = 1.05 * UNIT  # of a sum of products, for each of its operations
BROKEN = (LookupError, TypeError, AttributeError, ValueError, ArithmeticError, RecursionError)

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
    need(2 <= count <= 9 and others <= 10, f"{what}: terms and slopes")
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


def covered_pairs(
    cells: Sequence[tuple[float, float, float, float]], travel: tuple[float, float], loads: tuple[float, float]
) -> bool:
    """Return whether rectangles of positions and payloads, in any order, leave no gap."""
    edges = sorted({x for cell in cells for x in cell[:2]})
    strips: list[list[tuple[float, float]]] = [[] for _ in edges]
    place = {x: i for i, x in enumerate(edges)}
    for low, high, least, most in cells:
        for i in range(place[low], place[high]):
            strips[i].append((least, most))
    found = [pair for pair, strip in zip(pairwise(edges), strips, strict=False) if strip and covered(strip, *loads)]
    return covered(found, *travel)


def span(row: Any, what: str) -> tuple[float, float]:
    """Return the least and the largest payload."""
    need(isinstance(row, list) and len(row) == 2, f"{what}: two payloads are needed")
    least, most = number(row[0], what), number(row[1], what)
    need(least < most, f"{what}: the payloads do not ascend")
    return least, most


def loaded(X: Matrix, slopes: Sequence[Matrix], share: float, end: int) -> Matrix:
    """Return a corner of a cell with its least (end 0) or largest payload (end 1), from two slopes along it."""
    side = 2.0 * end - 1.0
    return mixed(mixed(X, 1.0, slopes[0], side), 1.0, slopes[1], side * (2.0 * share - 1.0))


def frozen(document: Mapping[str, Any], n: int) -> str:
    """Check the cells of a frozen axis; return a sentence."""
    bound = document["sensitivity_peak"]
    if bound is not None:
        need(number(bound, "sensitivity_peak") > 1.0, "the bound on Ms must be above 1")
    first, last = number(document["from_m"], "from_m"), number(document["to_m"], "to_m")
    need(first < last, "the travel has no length")
    loads = None if document["payloads_kg"] is None else span(document["payloads_kg"], "payloads_kg")
    cells: list[tuple[float, float, float, float]] = []
    for cell in document["cells"]:
        low, high = number(cell["from_m"], "from_m"), number(cell["to_m"], "to_m")
        what = f"the cell from {low!r} to {high!r} m"
        need(low < high, f"{what} has no length")
        need(cell["branches"], f"{what} has no model")
        here = (0.0, 0.0) if loads is None else span(cell["payloads_kg"], what)
        what = what if loads is None else f"{what} with {here[0]!r} to {here[1]!r} kg"
        count = 2 if loads is None else 4
        need(isinstance(cell["P"], list) and len(cell["P"]) == count, f"{what}: {count} corners are needed")
        ends = [matrix(rows, n, what) for rows in cell["P"]]
        for end in ends:
            need(factor(end), f"{what}: P is not positive definite")
        G = mixed(ends[0], 1.0 / count, ends[1], 1.0 / count)
        for end in ends[2:]:
            G = mixed(G, 1.0, end, 1.0 / count)
        weight = G if bound is None else padded(G, 1.0)
        lower = factor(weight)
        need(lower, f"{what}: G is not positive definite")
        assert lower is not None
        W = inverse(lower)
        for entries in cell["branches"]:
            found, slopes, rest = corners(entries, n + 1, what)
            need(len(slopes) == count - 2, f"{what} has slopes of other variables")
            if bound is None:
                found, slopes = ([[row[:n] for row in X[:n]] for X in part] for part in (found, slopes))
                rest = [row[:n] for row in rest[:n]]
            for k, X in enumerate(found):
                share = k / (len(found) - 1)
                for i in range(0, count, 2):
                    P = mixed(ends[i], 1.0 - share, ends[i + 1], share)
                    most = None if bound is None else bound * bound * (1.0 - 4.0 * UNIT)
                    before, after = (P, P) if most is None else (padded(P, most), padded(P, 1.0))
                    value = loaded(X, slopes, share, i // 2) if slopes else X
                    need(positive(value, rest, before, after, weight, W), f"{what} is not proven")
        cells.append((low, high, *here))
    need(covered_pairs(cells, (first, last), (0.0, 0.0) if loads is None else loads), "the cells leave a gap in the travel")
    robust = "" if bound is None else f" and Ms <= {bound!r}"
    with_ = "" if loads is None else f" with every payload from {loads[0]!r} to {loads[1]!r} kg"
    return f"frozen: stable{robust} at every position from {first!r} to {last!r} m{with_}, {len(set(cells))} cells"


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
    rows = [[matrix(P, n, f"P at {x!r} m") for x, P in zip(edges, row, strict=True)] for row in part["P"]]
    if document["payloads_kg"] is None:
        need(part["payloads_kg"] is None and len(rows) == 1, "the moving axis: payloads")
        slabs = [(rows[:1], part["cells"][0])]
        need(len(part["cells"]) == 1, "the moving axis: payloads")
    else:
        least, most = span(document["payloads_kg"], "payloads_kg")
        loads = [number(x, "payloads_kg") for x in part["payloads_kg"]]
        need(all(a < b for a, b in pairwise(loads)), "the payloads of the moving axis do not ascend")
        need(loads[0] <= least and loads[-1] >= most, "the moving axis leaves out some payloads")
        need(len(rows) == len(loads) and len(part["cells"]) == len(loads) - 1, "the moving axis: payloads")
        slabs = [([a, b], cells) for (a, b), cells in zip(pairwise(rows), part["cells"], strict=True)]
    for P, cells in slabs:
        need(len(cells) == len(edges) - 1, "the moving axis: a cell is missing")
        for i, branches in enumerate(cells):
            slab(P, edges, i, branches, step)
    with_ = "" if document["payloads_kg"] is None else f", {len(slabs)} intervals of payloads"
    yield f"moving: stable up to {step / T:.4g} m/s, {len(edges) - 1} cells{with_}"


def slab(P: Sequence[Sequence[Matrix]], edges: Sequence[float], i: int, branches: Any, step: float) -> None:
    """Check cell i of an axis that moves; P at all edges, with the least and, if it changes, the largest payload."""
    what = f"the moving axis from {edges[i]!r} to {edges[i + 1]!r} m"
    need(branches, f"{what} has no model")
    n = len(P[0][0])
    for rows in P:
        for end in (rows[i], rows[i + 1]):
            need(factor(end), f"{what}: P is not positive definite")
    weight = mixed(P[0][i], 0.5 / len(P), P[0][i + 1], 0.5 / len(P))
    for rows in P[1:]:
        weight = mixed(mixed(weight, 1.0, rows[i], 0.5 / len(P)), 1.0, rows[i + 1], 0.5 / len(P))
    lower = factor(weight)
    need(lower, f"{what}: G is not positive definite")
    assert lower is not None
    W = inverse(lower)
    last = len(edges) - 2
    ways = {(1.0, i), (-1.0, i), (1.0, max(i - 1, 0)), (-1.0, min(i + 1, last))}
    for entries in branches:
        found, slopes, rest = corners(entries, n + 1, what)
        found, slopes = ([[row[:n] for row in X[:n]] for X in part] for part in (found, slopes))
        rest = [row[:n] for row in rest[:n]]
        along: list[Matrix] = []
        if len(P) > 1:
            need(len(slopes) >= 2, f"{what}: no slope along the payload")
            slopes, along = slopes[:-2], slopes[-2:]
        slopes = [slope for slope in slopes if any(map(any, slope))]
        for end, rows in enumerate(P):
            change = {
                j: mixed(rows[j + 1], 1.0 / (edges[j + 1] - edges[j]), rows[j], -1.0 / (edges[j + 1] - edges[j]))
                for _, j in ways
            }
            for k, X in enumerate(found):
                share = k / (len(found) - 1)
                after = mixed(rows[i], 1.0 - share, rows[i + 1], share)
                here = loaded(X, along, share, end) if along else X
                for sign in product((-1.0, 1.0), repeat=len(slopes)):
                    value = here
                    for s, slope in zip(sign, slopes, strict=True):
                        value = mixed(value, 1.0, slope, s)
                    for way, j in ways:
                        before = mixed(after, 1.0, change[j], -way * 2.0 * step)
                        need(positive(value, rest, before, after, weight, W), f"{what} is not proven")


def digest(document: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the document without its digest entry."""
    rest = {name: value for name, value in document.items() if name != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def verified(document: Any) -> list[str]:
    """Return what the document proves, in sentences. Raises RefusedError if it does not."""
    need(isinstance(document, dict) and document.get("format") == FORMAT, "it is no proof along a travel")
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
