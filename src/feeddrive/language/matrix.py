"""Small matrices in plain arithmetic, as tuples of rows; results for floats, arrays and symbols agree to the last bit.

They are intended for `prepare`, which runs once per variant, and for at most about a dozen rows.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np

from feeddrive.language import ops
from feeddrive.language.graph import Symbol

Row: TypeAlias = tuple[Any, ...]
Matrix: TypeAlias = tuple[Row, ...]

ORDER = 16  # order of the Taylor series; for a norm of at most 1/2 the first omitted term is below 2⁻⁶⁵
MOST_SQUARINGS = 10
LARGEST_NORM = 0.5 * 2.0**MOST_SQUARINGS  # largest norm of an argument of `expm1`


def zeros(rows: int, columns: int) -> list[list[Any]]:
    """Return a matrix of zeros as a list of lists, to be filled."""
    return [[0.0] * columns for _ in range(rows)]


def multiply(a: Sequence[Sequence[Any]], b: Sequence[Sequence[Any]]) -> Matrix:
    """Return A·B for shapes (n, m) and (m, p)."""
    columns = list(zip(*b, strict=True))
    if all(type(x) is np.float64 or is_zero(x) for rows in (a, b) for row in rows for x in row):
        return _multiply_numbers(a, columns)
    return tuple(tuple([dot(row, column) for column in columns]) for row in a)


def _multiply_numbers(rows: Sequence[Sequence[Any]], columns: Sequence[Sequence[Any]]) -> Matrix:
    """Return `multiply` of matrices of numpy's numbers and literal zeros.

    Python's floats have the same sums and products to the last bit, in a fifth of the time.
    """
    sparse = [[(k, float(x)) for k, x in enumerate(row) if not is_zero(x)] for row in rows]
    plain = [[None if is_zero(y) else float(y) for y in column] for column in columns]
    product: list[Row] = []
    for row in sparse:
        entries: list[Any] = []
        for column in plain:
            total: Any = None
            for k, x in row:
                y = column[k]
                if y is not None:
                    total = x * y if total is None else total + x * y
            entries.append(0.0 if total is None else np.float64(total))
        product.append(tuple(entries))
    return tuple(product)


def dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """Return Σ aᵢ bᵢ, summed from left to right; literal factors 0.0 and 1.0 cause no operation."""
    total: Any = None
    for x, y in zip(a, b, strict=True):
        # `is_zero` and `is_one` inlined: `prepare` spends nearly all its time here
        if type(x) is float:
            if x == 0.0 or (type(y) is float and y == 0.0):
                continue
            term = y if x == 1.0 else x if type(y) is float and y == 1.0 else x * y
        elif type(y) is float:
            if y == 0.0:
                continue
            term = x if y == 1.0 else x * y
        else:
            term = x * y
        total = term if total is None else total + term
    return 0.0 if total is None else total


def is_zero(x: Any) -> bool:
    """Return True for a literal zero (a plain float), not for a computed number that happens to be zero."""
    return type(x) is float and x == 0.0


def is_one(x: Any) -> bool:
    """Return True for a literal one (a plain float)."""
    return type(x) is float and x == 1.0


def add(a: Sequence[Sequence[Any]], b: Sequence[Sequence[Any]]) -> Matrix:
    """Return A + B."""
    return tuple(
        tuple(
            [  # a list, and `is_zero` inlined, as in `dot`
                y if type(x) is float and x == 0.0 else x if type(y) is float and y == 0.0 else x + y
                for x, y in zip(r, s, strict=True)
            ]
        )
        for r, s in zip(a, b, strict=True)
    )


def scale(factor: Any, a: Sequence[Sequence[Any]]) -> Matrix:
    """Return factor · A."""
    return tuple(tuple([0.0 if type(x) is float and x == 0.0 else factor * x for x in row]) for row in a)


def solve(a: Sequence[Sequence[Any]], b: Sequence[Sequence[Any]]) -> Matrix:
    """Solve A·X = B for X by Gaussian elimination without pivoting; A must be positive definite (a mass matrix)."""
    n = len(a)
    left, right = [list(row) for row in a], [list(row) for row in b]
    for i in range(n):
        for j in range(i + 1, n):
            if is_zero(left[j][i]):
                continue
            ratio = left[j][i] / left[i][i]
            left[j] = [0.0 if k <= i else _minus(left[j][k], ratio, left[i][k]) for k in range(n)]
            right[j] = [_minus(right[j][k], ratio, right[i][k]) for k in range(len(right[j]))]
    solution: list[Row] = [()] * n
    for i in reversed(range(n)):
        row = right[i]
        for k in range(i + 1, n):
            row = [_minus(x, left[i][k], y) for x, y in zip(row, solution[k], strict=True)]
        solution[i] = tuple(0.0 if is_zero(x) else x / left[i][i] for x in row)
    return tuple(solution)


def _minus(x: Any, ratio: Any, y: Any) -> Any:
    if is_zero(ratio) or is_zero(y):
        return x
    return -(ratio * y) if is_zero(x) else x - ratio * y


def expm1(a: Sequence[Sequence[Any]], at_least: int = 0) -> Matrix:
    """Return e^A - I from a Taylor series of fixed order for A/2ˢ and s squarings (I + D)² - I = 2D + D².

    s is the smallest integer with ‖A‖∞/2ˢ <= 1/2, per variant; `LARGEST_NORM` is the largest permitted norm.  Since the
    identity I is not added, no precision is lost for a small A, so rounding does not make an axis at rest creep.

    at_least  smallest value of s, for matrices that usually need as many squarings: these squarings are unconditional,
              which saves branches in exported C code
    """
    return expm1_doubled(a, at_least)[0][-1]


def expm1_doubled(a: Sequence[Sequence[Any]], at_least: int = 0) -> tuple[list[Matrix], Any]:
    """Return the list of intermediate results of `expm1`, e^(A/2ˢ) - I, e^(2A/2ˢ) - I, ..., e^A - I, and s.

    For symbols, for which s is unknown, the list has eleven entries, the last of which repeat e^A - I.
    """
    norm = _norm(a)
    squarings: Any = float(at_least)
    for s in range(at_least, MOST_SQUARINGS):
        squarings = ops.where(norm > 0.5 * 2.0**s, s + 1.0, squarings)
    small = scale(1.0 / ops.power_of_two(squarings), a)
    total = _series(small)
    steps = [total]
    # of one matrix every squaring counts, and there is nothing to select
    single = not isinstance(squarings, np.ndarray | Symbol)
    for s in range(_most(squarings)):
        squared = add(scale(2.0, total), multiply(total, total))
        if s >= at_least:
            more = squarings > s
            # a literal zero stays one, so that later products with it cost no operation
            squared = tuple(
                tuple(
                    x if (is_zero(x) and is_zero(y)) or (single and type(x) is np.float64) else ops.where(more, x, y)
                    for x, y in zip(r, q, strict=True)
                )
                for r, q in zip(squared, total, strict=True)
            )
        total = squared
        steps.append(total)
    return steps, squarings


def _series(a: Matrix) -> Matrix:
    """Return Σ Aⁱ/i! for i = 1 .. ORDER, summed in groups of four terms, which needs few matrix products."""
    second = multiply(a, a)
    fourth = multiply(second, second)
    powers = (a, second, multiply(second, a), fourth)
    total: Matrix | None = None
    for group in reversed(range(0, ORDER, 4)):
        above = None if total is None else multiply(fourth, total)
        for i in reversed(range(4)):  # small terms first
            term = scale(1.0 / math.factorial(group + i + 1), powers[i])
            above = term if above is None else add(above, term)
        total = above
    assert total is not None
    return total


def _norm(a: Sequence[Sequence[Any]]) -> Any:
    """Return the infinity norm: the largest sum of absolute values in a row."""
    largest: Any = 0.0
    for row in a:
        total: Any = 0.0
        for x in row:
            if not is_zero(x):
                total = total + ops.absolute(x)
        largest = ops.maximum(largest, total)
    return largest


def _most(squarings: Any) -> int:
    """Return the largest number of squarings of any variant; for a symbol of unknown value, the permitted maximum."""
    return int(ops.most(squarings, MOST_SQUARINGS))


# 2⁴⁸ powers separate a magnitude of 1 - 1e-13 from 1; products of entries up to 1e150 do not overflow
SQUARINGS, TOO_LARGE = 48, 1e150


def decays(a: Sequence[Sequence[Any]] | np.ndarray) -> Any:
    """Return True if the powers of a square matrix decay to 0: its spectral radius is below 1. For use in rules.

    The matrix is squared repeatedly.  The result is True as soon as the infinity norm is below 1.  It is False if the
    norm exceeds 1e150, or is still not below 1 after 48 squarings: eigenvalue magnitudes within about 1e-13 of 1 count
    as 1.  The result is False for non-finite entries.
    """
    graph = next((x.graph for row in a for x in row if isinstance(x, Symbol)), None)
    if graph is not None:
        return graph.apply("decays", *(x for row in a for x in row))
    power = a if isinstance(a, np.ndarray) else _numbers(a)
    columns = range(len(power))
    decayed, open_ = np.False_, np.True_
    with np.errstate(all="ignore"):
        for _ in range(SQUARINGS):
            sizes = np.abs(power)
            norm = sizes[:, 0]
            # in a fixed order, unlike numpy's sums and products: the same verdict on every processor and on a target
            for k in columns[1:]:
                norm = norm + sizes[:, k]
            below = np.all(norm < 1.0, axis=0)
            decayed = decayed | (open_ & below)
            open_ = open_ & ~below & np.all(norm < TOO_LARGE, axis=0)
            if not np.any(open_):
                break
            squared = power[:, :1] * power[:1, :]
            for k in columns[1:]:
                squared = squared + power[:, k : k + 1] * power[k : k + 1, :]
            power = squared
    return decayed


def all_decay(matrices: Iterable[Sequence[Sequence[Any]]]) -> Any:
    """Return True if `decays` holds for every one of some square matrices of one size.

    Matrices of plain numbers are squared together, as variants of one matrix: the verdict is that of each alone.
    """
    plain: list[np.ndarray] = []
    holds: Any = True
    for a in matrices:
        if any(isinstance(x, Symbol | np.ndarray) for row in a for x in row):
            holds = ops.both(holds, decays(a))
        else:
            plain.append(_numbers(a))
    return ops.both(holds, np.all(decays(np.stack(plain, axis=-1)))) if plain else holds


def _numbers(a: Sequence[Sequence[Any]]) -> np.ndarray:
    """Return a square matrix as an array of shape (n, n), or (n, n, variants) if entries are arrays over variants."""
    entries = [x for row in a for x in row]
    if any(isinstance(x, np.ndarray) for x in entries):
        entries = np.broadcast_arrays(*entries)
        return np.stack(entries).reshape(len(a), len(a), -1)
    return np.array(a, dtype=np.float64)


def growth(a: Sequence[Sequence[Any]]) -> Any:
    """Return the spectral radius of a matrix, max |eigenvalue|, for error messages.

    The result is a float for numbers, an array for arrays over variants, and infinite for non-finite entries.
    """
    matrices = _numbers(a)
    stack = np.moveaxis(matrices.reshape(len(a), len(a), -1), 2, 0)
    # LAPACK refuses a matrix that is not finite
    finite = np.all(np.isfinite(stack), axis=(1, 2))
    rates = np.full(len(stack), math.inf)
    rates[finite] = np.max(np.abs(np.linalg.eigvals(stack[finite])), axis=1)
    return rates if matrices.ndim == 3 else float(rates[0])


def edge(holds: Callable[[Any], Any], values: Sequence[float]) -> float | None:
    """Return the point at which a condition first changes along a row of ordered positive values.

    The condition is true at this point, whose relative accuracy is about 1e-5.  `holds` is called with
    an array of values (vectorized).  Returns None if the condition does not change.
    """
    row, kept = np.array(values, dtype=np.float64), None
    for _ in range(5):
        with np.errstate(all="ignore"):
            holding = np.broadcast_to(holds(row), row.shape)
        changed = np.flatnonzero(holding != holding[0])
        if not changed.size:
            return None
        first = int(changed[0])
        kept = float(row[first - 1 if holding[0] else first])
        row = np.geomspace(row[first - 1], row[first], 40)
    return kept
