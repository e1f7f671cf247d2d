"""The speeds of nodes along a stretch of path, and the ramps and plateaus between them.

A stretch lies between two nodes, where u'' = u''' = 0.  Its hump is the ramp from the left node up to a peak, a
plateau, and the ramp down to the right node, with the highest peak that the way allows.  First a free hump shows where
caps would bind.  The slowest piece that it crosses too fast is held at its cap, as far as both ramps to it leave room,
and the stretches on either side are planned in the same way; otherwise the stretch gets the highest hump that keeps all
caps.  Each stretch has one, as its nodes were reached by ramps that hold, so that no step is taken back.
"""

from __future__ import annotations

from math import sqrt

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints
from feeddrive.path.schedule.ramp import fit, jerk_before, phase, speed_at

_HALVINGS = 40  # of the peak of a hump
_TRIES = 8  # slow pieces of a stretch, of which one is held
MARGIN = 4e-15  # of the way that is planned at once: so long before a joint a ramp ends, for rounding not to cross it
COLUMNS = 12  # of a stretch: u and speed of both nodes, peak, lengths of the ramps up and down, whether it is done


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
def _held(caps: Floats2, begin: Floats, first: int, last: int, left: float, right: float, peak: float) -> bool:
    """Whether a plateau from `left` to `right` keeps the caps."""
    for p in range(first, last + 1):
        if peak > caps[p, 0] * (1.0 + 1e-12) and begin[p + 1] > left and begin[p] < right:
            return False
    return True


@kernel
def hump(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2, stretch: Floats, fastest: float, free: bool
) -> bool:
    """Fill in the highest peak up to `fastest` and its ramps; False if not even the faster node can be reached."""
    u0 = stretch[0]
    u1 = stretch[1]
    v0 = stretch[2]
    v1 = stretch[3]
    first = piece_at(begin, u0, True)
    last = piece_at(begin, u1, False)
    least = max(v0, v1)
    a = b = c = d = e = f = up = 0.0
    slowest = fastest
    for p in range(first, last + 1):
        slowest = min(slowest, 0.5 * caps[p, 0])
    low = least
    peak = high = max(fastest, least)
    found = False
    for again in range(_HALVINGS):
        # the fastest, then what surely can be had, then between
        if again == 0:
            peak = high
        elif found:
            peak = sqrt(low * high)
        elif least > 0.0:
            peak = least
        else:
            peak = slowest
            slowest = 0.25 * slowest
        good = peak > 0.0
        if good:
            good, a, b, c = fit(begin, most, caps, limits, u0, first, 1, u1, v0, peak, free)
            if good:
                up = 0.5 * (v0 + peak) * (a + b + c)
                good, d, e, f = fit(begin, most, caps, limits, u1, last, -1, u0 + up, v1, peak, free)
                if good and not free:
                    good = _held(caps, begin, first, last, u0 + up, u1 - 0.5 * (v1 + peak) * (d + e + f), peak)
                if good:
                    found = True
                    low = peak
                    stretch[4] = peak
                    stretch[5] = a
                    stretch[6] = b
                    stretch[7] = c
                    stretch[8] = d
                    stretch[9] = e
                    stretch[10] = f
        if good and again == 0:
            return True
        if not good and least > 0.0 and not found and again > 0:
            return False
        if not good:
            high = peak
        if again > 1 and found and high - low <= 1e-3 * high:
            break
    return found


@kernel
def _slowest(begin: Floats, caps: Floats2, stretch: Floats, above: float) -> int:
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
def _fastest(begin: Floats, caps: Floats2, stretch: Floats) -> float:
    """The highest cap of a stretch."""
    found = 0.0
    for p in range(piece_at(begin, stretch[0], True), piece_at(begin, stretch[1], False) + 1):
        found = max(found, caps[p, 0])
    return found


@kernel
def _time(stretch: Floats) -> float:
    """Of a hump, s."""
    up = stretch[5] + stretch[6] + stretch[7]
    down = stretch[8] + stretch[9] + stretch[10]
    way = stretch[1] - stretch[0] - 0.5 * (stretch[2] + stretch[4]) * up - 0.5 * (stretch[3] + stretch[4]) * down
    return up + down + max(way, 0.0) / stretch[4]


@kernel
def _split(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2, now: Floats, p: int, reach: float,
    left: Floats, right: Floats,
) -> float:  # fmt: skip
    """Hold piece p at its cap from where the ramps from both nodes end: fill in what is left of it and right of it.

    Each of both has a hump that holds, or no way at all.  With `reach` 1 neighbors are held, too, which ramps may not
    cross at that speed.  Ramps end `MARGIN` before the piece, and begin so far behind it.  The time of both humps and
    the plateau, s; 0 if there is no such plateau.
    """
    c = caps[p, 0]
    if c < now[2] or c < now[3]:
        return 0.0
    first = piece_at(begin, now[0], True)
    last = piece_at(begin, now[1], False)
    low = p
    while low > first and caps[low - 1, 1] <= reach * c and caps[low - 1, 0] >= c:
        low = low - 1
    high = p
    while high < last and caps[high + 1, 1] <= reach * c and caps[high + 1, 0] >= c:
        high = high + 1
    good, a, b, d = fit(begin, most, caps, limits, now[0], first, 1, now[1], now[2], c, False)
    if not good:
        return 0.0
    margin = MARGIN * (begin[len(begin) - 1] - begin[0])
    ends = max(begin[low] - margin, now[0] + 0.5 * (now[2] + c) * (a + b + d))
    good, a, b, d = fit(begin, most, caps, limits, now[1], last, -1, now[0], now[3], c, False)
    if not good:
        return 0.0
    goes = min(begin[high + 1] + margin, now[1] - 0.5 * (now[3] + c) * (a + b + d))
    if ends > goes or ends >= now[1] or goes <= now[0]:
        return 0.0
    left[0] = now[0]
    left[1] = ends
    left[2] = now[2]
    left[3] = c
    right[0] = goes
    right[1] = now[1]
    right[2] = c
    right[3] = now[3]
    time = (goes - ends) / c
    if ends > now[0]:
        if not hump(begin, most, caps, limits, left, _fastest(begin, caps, left), False):
            return 0.0
        time = time + _time(left)
    if goes < now[1]:
        if not hump(begin, most, caps, limits, right, _fastest(begin, caps, right), False):
            return 0.0
        time = time + _time(right)
    return time


@kernel
def plan(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2,
    u0: float, u1: float, v0: float, v1: float, stack: Floats2, out: Floats2,
) -> int:  # fmt: skip
    """Plan from u0 at speed v0 to u1 at speed v1: rows of `out` filled, or 0 if v0 is too fast to stop in time."""
    free = zeros(COLUMNS)
    left = zeros(COLUMNS)
    right = zeros(COLUMNS)
    left2 = zeros(COLUMNS)
    right2 = zeros(COLUMNS)
    stack[0, 0] = u0
    stack[0, 1] = u1
    stack[0, 2] = v0
    stack[0, 3] = v1
    stack[0, 11] = 0.0
    if not hump(begin, most, caps, limits, stack[0], _fastest(begin, caps, stack[0]), False):
        return 0
    height = 1
    count = 0
    while height > 0:
        height = height - 1
        now = stack[height]
        # a stretch is split while there is room for the rows of all that are waiting; its own hump holds anyway
        if now[11] == 0.0 and height + 3 <= len(stack) and count + height + 3 <= len(out):
            for k in range(4):
                free[k] = now[k]
            p = -1
            if hump(begin, most, caps, limits, free, _fastest(begin, caps, free), True):
                p = _slowest(begin, caps, free, 0.0)
                if p < 0 and free[4] > now[4]:
                    for k in range(4, 11):
                        now[k] = free[k]
            split = 0.0
            for _ in range(_TRIES):
                if p < 0:
                    break
                split = _split(begin, most, caps, limits, now, p, 0.0, left, right)
                other = _split(begin, most, caps, limits, now, p, 1.0, left2, right2)
                if other > 0.0 and (split == 0.0 or other < split):
                    split = other
                    for k in range(11):
                        left[k] = left2[k]
                        right[k] = right2[k]
                if split > 0.0:
                    break
                p = _slowest(begin, caps, free, caps[p, 0])
            if split > 0.0:
                if right[1] > right[0]:
                    for k in range(11):
                        stack[height, k] = right[k]
                    stack[height, 11] = 0.0
                    height = height + 1
                if right[0] > left[1]:
                    stack[height, 0] = left[1]
                    stack[height, 1] = right[0]
                    stack[height, 2] = caps[p, 0]
                    stack[height, 3] = caps[p, 0]
                    stack[height, 4] = caps[p, 0]
                    for k in range(5, 11):
                        stack[height, k] = 0.0
                    stack[height, 11] = 1.0
                    height = height + 1
                if left[1] > left[0]:
                    for k in range(11):
                        stack[height, k] = left[k]
                    stack[height, 11] = 0.0
                    height = height + 1
                continue
        for k in range(11):
            out[count, k] = now[k]
        count = count + 1
    return count


@kernel
def _phases(
    v0: float, v1: float, peak: float, L1: float, L2: float, L3: float, up: bool,
    u: float, p: int, begin: Floats, count: int,
    duration: Floats, piece: Ints, x: Floats, speed: Floats, acceleration: Floats, jerk: Floats, snap: Floats,
) -> tuple[int, float, int]:  # fmt: skip
    """Append the phases of one ramp; the new count, u and piece."""
    low = v0 if up else v1
    rise = peak - low
    v = v0 if up else peak
    a = 0.0
    j = 0.0
    if rise <= 0.0 or L1 <= 0.0:
        return count, u, p
    sense = 1.0 if up else -1.0
    jerk_most = rise / (L2 * L3)
    for number in range(7):
        T, s = phase(number, rise, L1, L2, L3)
        s = sense * s
        if T > 0.0:
            while p + 1 < len(begin) - 1 and begin[p + 1] <= u:
                p = p + 1
            duration[count] = T
            piece[count] = p
            x[count] = u - begin[p]
            speed[count] = v
            acceleration[count] = a
            jerk[count] = j
            snap[count] = s
            count = count + 1
            u = u + T * (v + T * (0.5 * a + T * (j / 6.0 + T * s / 24.0)))
            v = v + T * (a + T * (0.5 * j + T * s / 6.0))
            a = a + T * (j + 0.5 * T * s)
        # in closed form, so that it does not gather rounding
        j = sense * jerk_before(number + 1, jerk_most)
    return count, u, p


@kernel
def timed(
    begin: Floats, rows: Floats2, many: int,
    duration: Floats, piece: Ints, x: Floats, speed: Floats, acceleration: Floats, jerk: Floats, snap: Floats,
) -> int:  # fmt: skip
    """The pieces of constant snap of the first `many` stretches; how many."""
    count = 0
    p = 0
    for k in range(many):
        u0 = rows[k, 0]
        u1 = rows[k, 1]
        v0 = rows[k, 2]
        v1 = rows[k, 3]
        peak = rows[k, 4]
        p = piece_at(begin, u0, True)
        count, u, p = _phases(
            v0, v1, peak, rows[k, 5], rows[k, 6], rows[k, 7], True, u0, p, begin, count,
            duration, piece, x, speed, acceleration, jerk, snap,
        )  # fmt: skip
        down = 0.5 * (v1 + peak) * (rows[k, 8] + rows[k, 9] + rows[k, 10])
        if u1 - down > u:
            p = piece_at(begin, u, True)
            duration[count] = (u1 - down - u) / peak
            piece[count] = p
            x[count] = u - begin[p]
            speed[count] = peak
            acceleration[count] = 0.0
            jerk[count] = 0.0
            snap[count] = 0.0
            count = count + 1
        p = piece_at(begin, u1 - down, True)
        count, u, p = _phases(
            v0, v1, peak, rows[k, 8], rows[k, 9], rows[k, 10], False, u1 - down, p, begin, count,
            duration, piece, x, speed, acceleration, jerk, snap,
        )  # fmt: skip
    return count
