"""The hump of one stretch: the ramp from its left node up to a peak, a plateau, and the ramp down to its right node.

A stretch is a row of `COLUMNS` numbers: u and speed of both nodes, the peak (0: none is known), the lengths of the
ramps up and down, and whether it is done.  A brake is a stretch without a ramp up.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Floats3
from feeddrive.path.schedule.ramp import boxcars, fit, speed_at, straight

_PEAKS = 40  # tried for a hump
_FAR = 6  # of them none of which holds
_FULL = 1.0 - 3e-6  # of a stretch: more ways of ramps need not be
COLUMNS = 12


@kernel
def piece_at(begin: Floats, u: float, right: bool) -> int:
    """The piece on which u lies; at a joint the one to the right, or to the left."""
    low = 0
    high = len(begin) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if begin[middle] < u or (right and begin[middle] == u):
            low = middle
        else:
            high = middle
    return low


@kernel
def least_cap(caps: Floats2, begin: Floats, first: int, last: int, left: float, right: float) -> float:
    """Of the pieces under a plateau from `left` to `right`."""
    found = 1e300
    for p in range(first, last + 1):
        if begin[p + 1] > left and begin[p] < right:
            found = min(found, caps[p, 0])
    return found


@kernel
def _filling(
    space: float, v0: float, v1: float, fastest: float, a: float, b: float, c: float, d: float, e: float, f: float,
    up: float, down: float,
) -> float:  # fmt: skip
    """The peak whose ramps fill a space, `up` and `down` slower than on pieces that leave a, b, c and d, e, f."""
    low = max(v0, v1)
    high = fastest
    peak = fastest
    miss_low = -space
    miss_high = 0.0
    for again in range(60):
        L1, L2, L3 = boxcars(peak - v0, a, b, c)
        M1, M2, M3 = boxcars(peak - v1, d, e, f)
        miss = 0.5 * ((v0 + peak) * up * (L1 + L2 + L3) + (v1 + peak) * down * (M1 + M2 + M3)) - space
        if miss <= 0.0:
            if again == 0 or miss >= -1e-6 * space:
                return peak
            low = peak
            miss_low = miss
            miss_high = 0.5 * miss_high
        else:
            high = peak
            miss_high = miss
            miss_low = 0.5 * miss_low
        if high - low <= 1e-7 * low or again > 50:
            return low
        # the regula falsi, with the end that stays at half its weight
        peak = low - miss_low * (high - low) / (miss_high - miss_low) if again > 0 else 0.5 * (low + high)
    return low


@kernel
def hump(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2, stretch: Floats, fastest: float, free: bool
) -> bool:
    """Fill in the highest peak up to `fastest` and its ramps, at least those it has; False if there is none."""
    u0 = stretch[0]
    u1 = stretch[1]
    v0 = stretch[2]
    v1 = stretch[3]
    first = piece_at(begin, u0, True)
    last = piece_at(begin, u1, False)
    a, b, c = straight(most[first], limits)
    d, e, f = straight(most[last], limits)
    least = max(v0, v1)
    low = stretch[4]
    high = fastest
    up = 1.0
    down = 1.0
    fails = False  # whether the high one does
    if low >= high:
        return True
    peak = max(_filling(u1 - u0, v0, v1, high, a, b, c, d, e, f, up, down), least)
    if low > 0.0 and peak <= 1.0005 * low:
        return True
    for again in range(_PEAKS):
        if peak <= 0.0:
            break
        wanted = 0.0
        full = False
        good, L1, L2, L3, up = fit(begin, most, caps, limits, u0, first, 1, u1, v0, peak, free, up)
        if good:
            ends = u0 + 0.5 * (v0 + peak) * (L1 + L2 + L3)
            good, M1, M2, M3, down = fit(begin, most, caps, limits, u1, last, -1, ends, v1, peak, free, down)
            if good:
                goes = u1 - 0.5 * (v1 + peak) * (M1 + M2 + M3)
                full = ends - u0 + u1 - goes >= _FULL * (u1 - u0)
                if not free:
                    # no peak a little above the cap of a plateau holds
                    cap = least_cap(caps, begin, first, last, ends, goes)
                    good = peak <= cap * (1.0 + 1e-12)
                    full = full or peak >= cap * (1.0 - 1e-9)
                    if not good:
                        wanted = cap
                if good:
                    low = peak
                    stretch[4] = peak
                    stretch[5] = L1
                    stretch[6] = L2
                    stretch[7] = L3
                    stretch[8] = M1
                    stretch[9] = M2
                    stretch[10] = M3
        if good and (full or peak >= fastest):
            break
        if not good:
            high = peak
            fails = True
            if high <= least:
                break
        if fails and high - low <= 1e-3 * high:
            break
        if wanted <= low or wanted >= high:
            wanted = _filling(u1 - u0, v0, v1, high, a, b, c, d, e, f, up, down)
            if wanted <= 1.0005 * low and good:
                break
            if wanted <= 1.0005 * low or (fails and wanted >= 0.9995 * high):
                wanted = sqrt(low * high) if low > 0.0 else max(0.3 * high, least)
            if low == 0.0 and again >= _FAR:
                # a slow piece is far from where the ramps are looked at: no peak near the high one holds
                wanted = max(min(wanted, 0.3 * high), least)
        peak = wanted
    return stretch[4] > 0.0


@kernel
def too_fast(begin: Floats, caps: Floats2, stretch: Floats, above: float) -> int:
    """Of the pieces that a hump crosses faster than ramps should, the one with the lowest cap > `above`; -1: none."""
    u0 = stretch[0]
    u1 = stretch[1]
    first = piece_at(begin, u0, True)
    last = piece_at(begin, u1, False)
    found = -1
    for p in range(first, last + 1):
        if caps[p, 0] <= above or (found >= 0 and caps[p, 0] >= caps[found, 0]):
            continue
        v = min(
            speed_at(begin[p + 1] - u0, stretch[2], stretch[4] - stretch[2], stretch[5], stretch[6], stretch[7]),
            speed_at(u1 - begin[p], stretch[3], stretch[4] - stretch[3], stretch[8], stretch[9], stretch[10]),
        )
        if v > caps[p, 1] * (1.0 + 1e-9):
            found = p
    return found


@kernel
def fastest_cap(begin: Floats, caps: Floats2, stretch: Floats) -> float:
    """The highest cap of a stretch."""
    found = 0.0
    for p in range(piece_at(begin, stretch[0], True), piece_at(begin, stretch[1], False) + 1):
        found = max(found, caps[p, 0])
    return found


@kernel
def hump_time(stretch: Floats) -> float:
    """Of a hump, s."""
    up = stretch[5] + stretch[6] + stretch[7]
    down = stretch[8] + stretch[9] + stretch[10]
    way = stretch[1] - stretch[0] - 0.5 * (stretch[2] + stretch[4]) * up - 0.5 * (stretch[3] + stretch[4]) * down
    return up + down + max(way, 0.0) / stretch[4]


@kernel
def brake(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2,
    left: float, right: float, v0: float, v1: float, row: Floats,
) -> bool:  # fmt: skip
    """Fill in a stretch that holds v0 and then brakes to v1; whether there is one."""
    for k in range(COLUMNS):
        row[k] = 0.0
    row[0] = left
    row[1] = right
    row[2] = v0
    row[3] = v1
    row[4] = v0
    last = piece_at(begin, right, False)
    good, row[8], row[9], row[10], _ = fit(begin, most, caps, limits, right, last, -1, left, v1, v0, False, 1.0)
    goes = right - 0.5 * (v0 + v1) * (row[8] + row[9] + row[10])
    return good and least_cap(caps, begin, piece_at(begin, left, True), last, left, goes) >= v0 * (1.0 - 1e-12)


@kernel
def brake_soon(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2,
    left: float, stop: float, v0: float, v1: float, row: Floats,
) -> bool:  # fmt: skip
    """Fill in a stretch from `left` that brakes from v0 to v1 in as little way as is found; whether there is one.

    It ends at `stop` at the latest.
    """
    a, j, s = straight(most[piece_at(begin, left, True)], limits)
    L1, L2, L3 = boxcars(v0 - v1, a, j, s)
    way = 0.5 * (v0 + v1) * (L1 + L2 + L3) * (1.0 + 1e-8)
    low = 0.0
    high = 0.0
    for _ in range(60):
        high = min(way, stop - left)
        if brake(begin, most, caps, limits, left, left + high, v0, v1, row):
            break
        if way >= stop - left:
            return False
        low = high
        way = 1.3 * way
    while high - low > 1e-3 * high and low > 0.0:
        middle = 0.5 * (low + high)
        if brake(begin, most, caps, limits, left, left + middle, v0, v1, row):
            high = middle
        else:
            low = middle
    return brake(begin, most, caps, limits, left, left + high, v0, v1, row)
