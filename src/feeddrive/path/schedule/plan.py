"""The speeds of nodes along a stretch of path, and the ramps and plateaus between them.

A stretch lies between two nodes, where u'' = u''' = 0.  Its hump is the ramp from the left node up to a peak, a
plateau, and the ramp down to the right node, with the highest peak that the way allows.  First a free hump shows where
caps would bind.  The slowest piece that it crosses too fast is held at its cap, as far as both ramps to it leave room,
and the stretches on either side are planned in the same way; otherwise the stretch gets the highest hump that keeps all
caps.  Each stretch has one, as its nodes were reached by ramps that hold, so that no step is taken back.
"""

from __future__ import annotations

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.plain import zeros
from feeddrive.language.kernels.source import Floats, Floats2, Floats3, Ints
from feeddrive.path.schedule.hump import COLUMNS, brake, fastest_cap, hump, hump_time, least_cap, piece_at, too_fast
from feeddrive.path.schedule.ramp import fit, jerk_before, phase

_TRIES = 8  # slow pieces of a stretch, of which one is held
_HIGHEST, _LEAST = 16.0, 4.0  # times a speed that is held: up to which ramps on either side are compared
MARGIN = 4e-15  # of the way that is planned at once: so long before a joint a ramp ends, for rounding not to cross it


@kernel
def _gain(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2, near: float, far: float, sense: int, end: float,
    c: float,
) -> float:  # fmt: skip
    """What is won by a ramp that begins at `far` with the speed c, not before, at `near`; s.  It may go up to `end`.

    For the highest speed of some to which both have one.
    """
    factor = _HIGHEST
    while factor > _LEAST:
        high = factor * c
        one = piece_at(begin, near, sense > 0)
        good, a, b, d, _ = fit(begin, most, caps, limits, near, one, sense, end, c, high, False, 1.0)
        if good:
            two = piece_at(begin, far, sense > 0)
            good, e, f, g, _ = fit(begin, most, caps, limits, far, two, sense, end, c, high, False, 1.0)
            if good:
                late = abs(far - near) * (1.0 / c - 1.0 / high)
                return (1.0 - 0.5 * (c + high) / high) * (a + b + d - e - f - g) - late
        factor = 0.5 * (1.0 + factor)
    return 0.0


@kernel
def _leaves(
    begin: Floats, caps: Floats2, now: Floats, first: int, low: int, high: int, last: int,
    reached: float, ends: float, goes: float, behind: float, c: float,
) -> bool:  # fmt: skip
    """Whether ramps to c that end at `reached` and begin at `behind` leave a plateau, held from `ends` to `goes`."""
    if ends > goes or ends >= now[1] or goes <= now[0]:
        return False
    # the ramp to the other node alone, as it is
    if (ends <= now[0] and goes == behind) or (goes >= now[1] and ends == reached):
        return False
    return (
        least_cap(caps, begin, first, low, reached, ends) >= c and least_cap(caps, begin, high, last, goes, behind) >= c
    )


@kernel
def _split(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2, now: Floats, p: int, c: float,
    left: Floats, right: Floats,
) -> bool:  # fmt: skip
    """Hold piece p at c from where the ramps from both nodes end: fill in what is left of it and right of it.

    Either it alone is held, or neighbors, too, which ramps may not cross at that speed: what is quicker.  Each of both
    sides has a hump that holds, or no way at all.  Ramps end `MARGIN` before the plateau, and begin so far behind it.
    False if there is no such plateau.
    """
    if c < now[2] or c < now[3]:
        return False
    first = piece_at(begin, now[0], True)
    last = piece_at(begin, now[1], False)
    margin = MARGIN * (begin[len(begin) - 1] - begin[0])
    low = p
    while low > first and caps[low - 1, 1] <= c and caps[low - 1, 0] >= c:
        low = low - 1
    high = p
    while high < last and caps[high + 1, 1] <= c and caps[high + 1, 0] >= c:
        high = high + 1
    farthest = min(now[1], begin[high + 1] + margin)
    good, a, b, d, _ = fit(begin, most, caps, limits, now[0], first, 1, farthest, now[2], c, False, 1.0)
    if not good:
        return False
    reached = now[0] + 0.5 * (now[2] + c) * (a + b + d)
    farthest = max(reached, begin[low] - margin)
    good, e, f, g, _ = fit(begin, most, caps, limits, now[1], last, -1, farthest, now[3], c, False, 1.0)
    if not good:
        return False
    behind = now[1] - 0.5 * (now[3] + c) * (e + f + g)
    ends = max(begin[p] - margin, reached)
    goes = min(begin[p + 1] + margin, behind)
    wide_ends = max(begin[low] - margin, reached)
    wide_goes = min(begin[high + 1] + margin, behind)
    narrow = _leaves(begin, caps, now, first, p, p, last, reached, ends, goes, behind, c)
    wide = (low < p or high > p) and _leaves(
        begin, caps, now, first, low, high, last, reached, wide_ends, wide_goes, behind, c
    )
    if narrow and wide:
        gain = 0.0
        if wide_ends < ends:
            gain = _gain(begin, most, caps, limits, ends, wide_ends, -1, now[0], c)
        if wide_goes > goes:
            gain = gain + _gain(begin, most, caps, limits, goes, wide_goes, 1, now[1], c)
        narrow = gain <= 0.0
    if not narrow and not wide:
        return False
    if not narrow:
        ends = wide_ends
        goes = wide_goes
    for k in range(COLUMNS):
        left[k] = 0.0
        right[k] = 0.0
    left[0] = now[0]
    left[1] = ends
    left[2] = now[2]
    left[3] = c
    left[4] = c
    left[5] = a
    left[6] = b
    left[7] = d
    right[0] = goes
    right[1] = now[1]
    right[2] = c
    right[3] = now[3]
    right[4] = c
    right[8] = e
    right[9] = f
    right[10] = g
    return True


@kernel
def _beginning(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2, quick: Floats2, u0: float, u1: float, v0: float,
    slow: Ints, stack: Floats2,
) -> int:  # fmt: skip
    """A plan to a stop at u1 that holds, its last stretch first: how many stretches; 0: there is none.

    From rest a hump.  A motion that comes faster than a piece ahead allows is braked before pieces that are slower than
    all before them: `slow` holds them.  Of these as few as possible.
    """
    row = stack[0]
    for k in range(COLUMNS):
        row[k] = 0.0
    row[0] = u0
    row[1] = u1
    if v0 == 0.0:
        return 1 if hump(begin, most, caps, limits, row, fastest_cap(begin, caps, row), False) else 0
    margin = MARGIN * (begin[len(begin) - 1] - begin[0])
    many = 0
    least = v0
    for p in range(piece_at(begin, u0, True) + 1, piece_at(begin, u1, False) + 1):
        if caps[p, 0] < least:
            least = caps[p, 0]
            slow[many] = p
            many = many + 1
    right = u1
    v1 = 0.0
    count = 0
    while True:
        # the farthest of them from which one ramp brakes: -1 is the motion itself
        found = -2
        misses = 0
        for back in range(many + 1):
            k = many - 1 - back
            left = u0 if k < 0 else begin[slow[k]] - margin
            good = False
            if k < 0:
                good = brake(begin, most, quick, limits, u0, right, v0, v1, stack[count])
            elif left < right:
                good = brake(begin, most, caps, limits, left, right, caps[slow[k], 0], v1, stack[count])
            if good:
                found = k
                misses = 0
            elif found > -2:
                misses = misses + 1
                if misses == 2:
                    break
        if found == -2:
            return 0
        count = count + 1
        if found < 0:
            brake(begin, most, quick, limits, u0, right, v0, v1, stack[count - 1])
            return count
        left = begin[slow[found]] - margin
        brake(begin, most, caps, limits, left, right, caps[slow[found], 0], v1, stack[count - 1])
        right = left
        v1 = caps[slow[found], 0]
        many = found


@kernel
def _whole(begin: Floats, most: Floats3, caps: Floats2, limits: Floats2, left: Floats, right: Floats) -> float:
    """The time of both humps and of the plateau between them, s."""
    time = (right[0] - left[1]) / left[3]
    if left[1] > left[0]:
        hump(begin, most, caps, limits, left, fastest_cap(begin, caps, left), False)
        time = time + hump_time(left)
    if right[1] > right[0]:
        hump(begin, most, caps, limits, right, fastest_cap(begin, caps, right), False)
        time = time + hump_time(right)
    return time


@kernel
def plan(
    begin: Floats, most: Floats3, caps: Floats2, limits: Floats2, quick: Floats2, u0: float, u1: float, v0: float,
    slow: Ints, stack: Floats2, out: Floats2,
) -> int:  # fmt: skip
    """Plan from u0 at speed v0 to a stop at u1: rows of `out` filled, or 0 if v0 is too fast to stop in time."""
    free = zeros(COLUMNS)
    left = zeros(COLUMNS)
    right = zeros(COLUMNS)
    height = _beginning(begin, most, caps, limits, quick, u0, u1, v0, slow, stack)
    count = 0
    while height > 0:
        height = height - 1
        now = stack[height]
        if now[11] == 0.0:
            for k in range(COLUMNS):
                free[k] = now[k]
            p = -1
            if hump(begin, most, caps, limits, free, fastest_cap(begin, caps, free), True):
                p = too_fast(begin, caps, free, 0.0)
            split = False
            # a stretch is split while there is room for the rows of all that are waiting; its own hump holds anyway
            if p < 0:
                for k in range(4, COLUMNS):
                    now[k] = free[k]
            elif height + 3 <= len(stack) and count + height + 3 <= len(out):
                # the slowest that is not slower than both nodes; else the next; else more slowly
                p = too_fast(begin, caps, free, max(now[2], now[3]) * (1.0 - 1e-9))
                slowest = p
                for _ in range(_TRIES):
                    if p < 0 or split:
                        break
                    split = _split(begin, most, caps, limits, now, p, caps[p, 0], left, right)
                    p = too_fast(begin, caps, free, caps[p, 0])
                if not split:
                    hump(begin, most, caps, limits, now, fastest_cap(begin, caps, now), False)
                    c = 1.0
                    for _ in range(2):
                        if slowest < 0 or split:
                            break
                        c = 0.5 * c
                        split = _split(
                            begin, most, caps, limits, now, slowest, c * caps[slowest, 0], left, right
                        ) and _whole(begin, most, caps, limits, left, right) < hump_time(now)
            if split:
                if right[1] > right[0]:
                    for k in range(COLUMNS):
                        stack[height, k] = right[k]
                    height = height + 1
                if right[0] > left[1]:
                    for k in range(COLUMNS):
                        stack[height, k] = 0.0
                    stack[height, 0] = left[1]
                    stack[height, 1] = right[0]
                    stack[height, 2] = left[3]
                    stack[height, 3] = left[3]
                    stack[height, 4] = left[3]
                    stack[height, 11] = 1.0
                    height = height + 1
                if left[1] > left[0]:
                    for k in range(COLUMNS):
                        stack[height, k] = left[k]
                    height = height + 1
                continue
            if height + 3 > len(stack) or count + height + 3 > len(out):
                hump(begin, most, caps, limits, now, fastest_cap(begin, caps, now), False)
        for k in range(COLUMNS):
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
        if u1 - down - u > MARGIN * (begin[len(begin) - 1] - begin[0]):
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
