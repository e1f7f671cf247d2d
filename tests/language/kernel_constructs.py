"""Every construct of the language of kernels, a few at a time; numbers named i, j, k, n are drawn small, others any."""

from __future__ import annotations

import math
from math import ceil, floor, sqrt

import kernel_beside
from kernel_beside import halves

from feeddrive.language.errors import ParameterError
from feeddrive.language.kernels.elementary import atan, atan2, cos, sin, tan
from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints, zeros

FACTOR = 2.5
COUNT = 3
ON = True


@kernel
def float_arithmetic(x: float, y: float) -> tuple[float, float, float, float, float]:
    return x + y, x - y, x * y, -x, +y


@kernel
def float_quotients(x: float, y: float) -> tuple[float, float, float]:
    return x / y, x // y, x % y


@kernel
def float_orders(x: float, y: float) -> tuple[bool, bool, bool, bool, bool, bool]:
    return x < y, x <= y, x > y, x >= y, x == y, x != y


@kernel
def float_extremes(x: float, y: float, z: float) -> tuple[float, float, float]:
    return min(x, y, z), max(x, y, z), abs(x)


@kernel
def root(x: float) -> float:
    return sqrt(x) + math.sqrt(2)


@kernel
def angles(x: float, y: float, i: int) -> tuple[float, float, float, float, float]:
    return sin(x) + cos(i), cos(x), atan(x), atan2(y, x), tan(x)


@kernel
def down(x: float) -> int:
    return floor(x)


@kernel
def up(x: float) -> int:
    return ceil(x)


@kernel
def towards_zero(x: float) -> int:
    return int(x)


@kernel
def whole_sum(a: int, b: int) -> int:
    return a + b


@kernel
def whole_difference(a: int, b: int) -> int:
    return a - b


@kernel
def whole_product(a: int, b: int) -> int:
    return a * b


@kernel
def whole_floor(a: int, b: int) -> int:
    return a // b


@kernel
def whole_remainder(a: int, b: int) -> int:
    return a % b


@kernel
def whole_signs(a: int) -> tuple[int, int]:
    return abs(a), -a


@kernel
def whole_quotient(i: int, j: int) -> float:
    return i / j


@kernel
def whole_orders(a: int, b: int) -> tuple[bool, bool, bool, bool, bool, bool]:
    return a < b, a <= b, a > b, a >= b, a == b, a != b


@kernel
def whole_extremes(a: int, b: int) -> tuple[int, int, float]:
    return min(a, b), max(a, b, 7), float(a)


@kernel
def mixed(a: int, x: float) -> tuple[float, float, float, float]:
    return a + x, x - a, a * x, 2 * x


@kernel
def mixed_quotients(a: int, x: float) -> tuple[float, float, float]:
    return a / x, a // x, a % x


@kernel
def mixed_orders(a: int, x: float) -> tuple[bool, bool, bool, bool, bool, bool, bool]:
    return a < x, a <= x, a > x, a >= x, a == x, a != x, x < a


@kernel
def chains(x: float, y: float, z: float) -> tuple[bool, bool]:
    return x < y <= z, x == y != z >= 0.0


@kernel
def short_cuts(x: float, y: float, p: bool) -> tuple[bool, bool, bool]:
    return y != 0.0 and x / y > 1.0, not p or 1.0 / x < y, p == (x < y)


@kernel
def choices(x: float, y: float, p: bool) -> float:
    return (x if p else y) * (1.0 / x if x > y else 3.0)


@kernel
def flags(p: bool, q: bool) -> tuple[int, bool]:
    return int(p) + 2 * int(q), (p and q) or ON


@kernel
def constants(x: float) -> tuple[float, int, float, float]:
    return FACTOR * x, COUNT, math.pi, -math.inf


@kernel
def branches(x: float, n: int) -> float:
    y = 0.0
    if x > 1.0:
        y = x
    elif x > 0.0:
        return 1.0 / x
    elif n > 2:
        pass
    else:
        y = -x
        n += 1
    if n == 1:
        y -= FACTOR
    return y * n


@kernel
def while_loop(x: float, n: int) -> tuple[float, int]:
    turns = 0
    while True:
        turns += 1
        if turns > 20:
            break
        if x > 100.0:
            x /= 3.0
            continue
        x = x * 2.0 + n
        if n < 0 and turns > 3:
            break
    return x, turns


@kernel
def ranges(i: int, j: int, n: int) -> tuple[int, int, int, int]:
    total, last, count, back = 0, -100, 0, 0
    for k in range(n):
        total += k * k
        last = k
        k = 7
    for k in range(i, j):
        count += k
    for k in range(i, j, 3):
        if k == 2:
            continue
        count += 10 * k
    for k in range(j, i, -2):
        back += k
        if back > 5:
            break
        for k in range(j, i, -1):
            back -= k
    return total, last, count, back


@kernel
def counting_parameter(row: Floats, k: int, n: int) -> tuple[float, float]:
    last = 0.0
    for i in range(1, n):
        last = row[i * i + i - 2] - row[i - 3]
    for k in range(n):
        last += row[k]
    return last, row[k]


@kernel
def far_ranges(a: int) -> tuple[int, int]:
    turns, last = 0, 0
    for k in range(a, 9223372036854775807, 4611686018427387904):
        turns += 1
        last = k
    for k in range(a, -9223372036854775807, -4611686018427387904):
        turns += 10
        last = k
    return turns, last


@kernel
def cells(row: Floats, table: Floats2, block: Floats3, whole: Ints, i: int, j: int, k: int) -> tuple[float, int, int]:
    row[i] = table[i, j] + block[i, j, k]
    table[-1, j] -= row[-2]
    block[i][j][-1] *= FACTOR
    whole[k] += 2
    return table[i][j] / row[k], whole[j] // whole[k], len(row) + len(table) * len(block[0]) + len(whole)


@kernel
def rows(table: Floats2, block: Floats3, i: int, j: int) -> tuple[float, float]:
    row = table[i]
    row[0], row[-1] = row[-1], row[0]
    for k in range(len(row)):
        row[k] += 1.0
    row = block[i, j]
    first, second, third = row
    row[1] = first
    table[j] = third, second, first
    a, b, c = table[i]
    return a + b + c, row[2]


@kernel
def tuple_row(table: Floats2, i: int, x: float) -> None:
    table[i] = x, 2.0 * x, 3.0


@kernel
def lengths(table: Floats2, row: Floats, n: int) -> float:
    if n > 3:
        a, b = table[0]
        return a + b
    row[0], row[1], row[2] = table[n]
    return row[n]


@kernel
def order_of_errors(row: Floats, i: int, j: int, x: float) -> float:
    row[i] = row[j] / x
    row[j], row[i] = x, sqrt(row[i])
    return row[floor(min(max(x, -9.0), 9.0))]


@kernel
def local_arrays(x: float, n: int, i: int) -> tuple[float, float]:
    row = zeros(COUNT)
    table = zeros(2, 3)
    for k in range(n):
        row[k] = x
        table[1] = x, row[0], 1.0
        x = x * 0.5
    return row[i] + row[2], table[1, i]


@kernel
def raises(x: float, n: int) -> float:
    if x < 0.0:
        raise ValueError("x is less than 0")
    if n > 3:
        raise ParameterError("n is more than 3")
    while x > 1.0 and x <= 1e308:  # inf would never come down
        x = x / n
        if n < 2:
            raise ArithmeticError("no end")
    return x


@kernel
def first_root(x: float, y: float) -> float:
    return sqrt(x) / y


@kernel
def two(x: float, i: int) -> tuple[float, int]:
    return first_root(x, x - 1.0), i + 1


@kernel
def fills(row: Floats, x: float) -> None:
    for k in range(len(row)):
        row[k] = x / row[k]
        if row[k] > 1e3:
            return


@kernel
def calls(row: Floats, table: Floats2, x: float, i: int) -> tuple[float, int]:
    fills(row, x)
    fills(table[i], 2.0 * x)
    y, k = two(x, i)
    z = halves(y) + kernel_beside.thirds(row[0]) if x > 0.0 else 0.0
    return y + z, k


@kernel
def several_names(x: float, row: Floats, i: int) -> float:
    a = b = row[i] = x + 1.0
    a, b, c = b, a, 1.0
    return a * b + c


@kernel
def forgotten(row: Floats, table: Floats2, x: float, y: float, n: int, i: int) -> tuple[float, float, int, float]:
    """What is computed already is taken again, but not where a path has changed what it was computed from."""
    a = x + y
    b = a
    k = n
    if x > y:
        a = y
        b = row[k]
    elif x + y > 0.0:
        k = i
    c = a + (x + y) + row[k]
    for m in range(3):
        b = b + a
        if (b > c and row[m] > x + b) or row[i] < 0.0:
            a = a - row[m]
            continue
        while k < 6:
            k = k + 1
            if row[m] + a > c:
                break
            a = a + table[m, 1]
        else_side = table[i, 2] if x > 0.0 else row[n]
        c = c + else_side + table[i, 2]
    view = table[0]
    for m in range(len(table)):
        c = c + view[1]
        view = table[m]
    return a, b, k, c + view[1] + (x + y)


@kernel
def branches_forget(x: float, y: float, n: int, i: int) -> tuple[float, int, float]:
    a = x
    k = n
    if x > y:
        a = y
    elif x < 0.0:
        k = i
    elif y > 1.0:
        return a, k, x + y
    else:
        a = x + y
    return a, k, x + y
