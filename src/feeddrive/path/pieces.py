"""Piecewise polynomials in time: kernels that find the piece of an instant and evaluate it with all derivatives."""

from __future__ import annotations

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2


@kernel
def piece_at(times: Floats, count: int, time: float, first: int) -> int:
    """The last piece, from `first` on, that begins at or before an instant; `first` if none does.

    Ascending instants are found in few steps: the search doubles its stride before it halves it.
    """
    low, stride = first, 1
    while low + stride < count and times[low + stride] <= time:
        low, stride = low + stride, 2 * stride
    high = min(low + stride, count)
    while high - low > 1:
        middle = (low + high) // 2
        if times[middle] <= time:
            low = middle
        else:
            high = middle
    return low


@kernel
def derivative(coefficients: Floats, order: int, t: float) -> float:
    """A derivative of a polynomial, by Horner's rule: coefficients of degree 0, 1, ..."""
    value = 0.0
    for k in range(len(coefficients) - 1, order - 1, -1):
        factor = 1.0
        for m in range(order):
            factor *= k - m
        value = value * t + factor * coefficients[k]
    return value


@kernel
def evaluate(times: Floats, pieces: Floats2, count: int, at: Floats, values: Floats2) -> None:
    """Value and derivatives, one a column of `values`, of the first `count` pieces at ascending instants.

    Before the first piece and behind the last one their polynomials go on. Instants that do not ascend are an error.
    """
    place, last = 0, at[0] if len(at) > 0 else 0.0
    for k in range(len(at)):
        if at[k] < last:
            raise ValueError("instants must ascend: sort them")
        last = at[k]
        place = piece_at(times, count, last, place)
        row, coefficients = values[k], pieces[place]
        for order in range(len(row)):
            row[order] = derivative(coefficients, order, last - times[place])
