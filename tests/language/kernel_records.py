"""Every use of records in kernels, drawn as in `kernel_constructs.py`."""

from __future__ import annotations

import math
from typing import NamedTuple

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Ints, Records, Records2, records


class Ramp(NamedTuple):
    rise: float
    time: float = 1.0


STEEP = Ramp(-2.0, 0.25)


class Stretch(NamedTuple):
    begin: float
    up: Ramp
    held: bool = False
    down: Ramp = STEEP
    end: float = math.inf


class Counted(NamedTuple):
    """Not a row: it has a whole number and a bool."""

    count: int
    ramp: Ramp
    on: bool


class Path(NamedTuple):
    begin: Floats
    caps: Records[Ramp]
    table: Floats2
    piece: Ints
    block: Records2[Ramp]
    first: Counted


@kernel
def record_fields(stretch: Stretch, x: float) -> tuple[float, float, bool, float]:
    return stretch.begin + x, stretch.up.rise * stretch.down.time, stretch.held and x > 0.0, stretch.end


@kernel
def record_made(x: float, y: float, p: bool) -> Stretch:
    return Stretch(x / y, Ramp(y, time=x), end=-x, held=p)


@kernel
def record_defaults(x: float) -> tuple[Stretch, Ramp, float]:
    return Stretch(x, Ramp(x)), STEEP, STEEP.time


@kernel
def record_counted(a: int, x: float, p: bool) -> Counted:
    return Counted(a + 1, Ramp(x), not p)


@kernel
def record_replaced(stretch: Stretch, counted: Counted, x: float) -> tuple[Stretch, Counted]:
    other = stretch._replace(up=stretch.up._replace(rise=x), end=stretch.begin / x)
    stretch = stretch._replace()
    return other._replace(down=stretch.up), counted._replace(count=counted.count * 2, ramp=stretch.down)


@kernel
def record_is_a_value(stretches: Records[Stretch], i: int, j: int, x: float) -> tuple[float, float, Stretch]:
    """What is taken from an array stays, whatever is written there later."""
    now = stretches[i]
    stretches[i] = now._replace(begin=x)
    kept = now.begin
    other = now
    now = now._replace(begin=x + 1.0)
    stretches[j] = stretches[i]
    return kept, other.begin + now.begin, stretches[j]


@kernel
def record_rows(stretches: Records[Stretch], block: Records2[Ramp], i: int, j: int, k: int) -> tuple[float, bool, int]:
    row = block[i]
    row[j] = Ramp(stretches[k].up.rise, block[j, k].time)
    block[k, i] = row[j]
    stretches[i] = Stretch(stretches[k].end, block[i][j], stretches[j].begin > 0.0, down=stretches[j].up)
    stretches[i], stretches[k] = stretches[k], stretches[i]
    return stretches[-1].down.time / row[0].rise, stretches[i].held, len(row) + len(stretches) * len(block[0])


@kernel
def record_bools(stretches: Records[Stretch], n: int) -> int:
    count = 0
    for k in range(len(stretches)):
        if stretches[k].held:
            count += 1
        stretches[k] = stretches[k]._replace(held=k > n)
    return count


@kernel
def record_unpacked(ramps: Records[Ramp], ramp: Ramp, i: int) -> tuple[float, float, float]:
    rise, time = ramp
    a, b = ramps[i]
    c, d = record_lengthened(ramp, a)
    (e,) = record_alone(ramp)
    return rise / time, a + b, c * d + e.rise


@kernel
def record_lengthened(ramp: Ramp, x: float) -> Ramp:
    if x > 0.0:
        return ramp._replace(time=ramp.time / x)
    return STEEP if x < -1.0 else ramp


@kernel
def record_alone(ramp: Ramp) -> tuple[Ramp]:
    return (ramp,)


@kernel
def record_loops(stretch: Stretch, x: float, n: int) -> tuple[Stretch, float]:
    """Of a record that a loop changes nothing is remembered from before."""
    total = stretch.up.rise + stretch.begin
    best = stretch
    for k in range(n):
        total = total + best.up.rise
        if total > x:
            best = best._replace(up=Ramp(total, x))
            continue
        if best.up.rise > stretch.begin:
            break
        best = Stretch(best.up.rise + k, best.down, best.held, best.up)
    return best, total + best.up.rise


@kernel
def record_with_arrays(path: Path, i: int, x: float) -> tuple[float, int]:
    path.begin[i] = x / path.begin[0]
    path.caps[i] = path.first.ramp
    path.piece[i] = path.first.count
    row = path.table[i]
    row[0] = path.caps[i].rise
    other = path._replace(begin=row, first=path.first._replace(count=len(path.caps)))
    return record_first(other, i), other.first.count + path.piece[0]


@kernel
def record_first(path: Path, i: int) -> float:
    path.block[0, i] = path.caps[0]
    return path.begin[i] + path.block[i][0].rise


@kernel
def record_errors(stretches: Records[Stretch], i: int, x: float) -> Stretch:
    stretch = Stretch(
        1.0 / x,
        stretches[i].up,
        end=stretches[i + 1].begin,
    )
    if stretch.begin > 1e6:
        raise ValueError("too steep")
    return stretch


_TWO = 2


@kernel
def record_local(ramp: Ramp, stretch: Stretch, x: float, i: int) -> tuple[float, bool, Ramp]:
    """Arrays of records of its own, cleared at each call, given to others."""
    ramps = records(Ramp, 3)
    table = records(Stretch, _TWO, 3)
    before = ramps[i].rise + table[0, i].end
    ramps[i] = ramp
    table[1, i] = stretch._replace(up=ramps[-1])
    row = table[1]
    row[0] = record_of_rows(ramps, row, x)
    return before, table[1][i].held, ramps[0]


@kernel
def record_of_rows(ramps: Records[Ramp], row: Records[Stretch], x: float) -> Stretch:
    ramps[0] = Ramp(x / ramps[1].time, row[0].begin)
    return row[len(row) - 1]
