"""The speeds of nodes along a stretch of path, and the ramps and plateaus between them.

A stretch lies between two nodes, where u'' = u''' = 0.  Its hump is the ramp from the left node up to a peak speed, a
plateau, and the ramp down to the right node, with the highest peak that the distance allows.  First, a hump that
ignores the caps (speed limits of pieces) shows which of them are active.  The slowest piece that this hump crosses too
fast is passed at its cap, if both ramps to it leave room, and the stretches on either side are planned recursively;
otherwise the stretch gets the highest hump that satisfies all caps.  Such a hump always exists, as the nodes were
reached by feasible ramps: no backtracking is needed.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Ints, Records
from feeddrive.path.motion import Interval, Motion, appended
from feeddrive.path.schedule.ramp import (
    NO_RAMP,
    Bounds,
    Cap,
    Path,
    Ramp,
    acceleration_before,
    boxcars,
    duration,
    fit,
    jerk_before,
    phase,
    ramp_jerk,
    speed_at,
    straight,
)

_PEAKS = 40  # largest number of trial peaks of a hump
_FAR = 6  # number of tries without success after which peaks near the upper end are abandoned
_FULL = 1.0 - 3e-6  # of a stretch: ramps that use this much of it need no higher peak


class Stretch(NamedTuple):
    """A stretch of path between two nodes: a ramp up, a plateau and a ramp down.

    begin, end  u of the nodes, m
    v0, v1      speeds at the nodes, m/s
    peak        speed of the plateau, m/s; 0 if there is no hump yet
    up, down    the ramps; a braking stretch has no ramp up
    held        True for a final stretch at the cap of a piece, which is not replanned
    """

    begin: float
    end: float
    v0: float
    v1: float
    peak: float = 0.0
    up: Ramp = NO_RAMP
    down: Ramp = NO_RAMP
    held: bool = False


@kernel
def piece_at(begin: Floats, u: float, right: bool) -> int:
    """Return the index of the piece that contains u; at a joint the piece to the right if `right`, otherwise to the
    left.
    """
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
def least_cap(path: Path, first: int, last: int, left: float, right: float) -> float:
    """Return the lowest cap of the pieces under a plateau from `left` to `right`."""
    lowest = 1e300
    for p in range(first, last + 1):
        if path.begin[p + 1] > left and path.begin[p] < right:
            lowest = min(lowest, path.caps[p].plateau)
    return lowest


@kernel
def _highest_cap(path: Path, first: int, last: int) -> float:
    """Return the highest cap of some pieces."""
    highest = 0.0
    for p in range(first, last + 1):
        highest = max(highest, path.caps[p].plateau)
    return highest


@kernel
def plateau_begin(stretch: Stretch) -> float:
    """Return the u at which the ramp up ends, m."""
    L1, L2, L3 = stretch.up
    return stretch.begin + 0.5 * (stretch.v0 + stretch.peak) * (L1 + L2 + L3)


@kernel
def plateau_end(stretch: Stretch) -> float:
    """Return the u at which the ramp down begins, m."""
    L1, L2, L3 = stretch.down
    return stretch.end - 0.5 * (stretch.v1 + stretch.peak) * (L1 + L2 + L3)


@kernel
def _filling(
    space: float, v0: float, v1: float, fastest: float, left: Bounds, right: Bounds, up: float, down: float
) -> float:
    """Return the peak speed at which the ramps up and down together cover a given distance.

    `left` and `right` are the bounds of the ramps up and down on straight pieces; the actual ramps last `up` and `down`
    times as long.
    """
    low = max(v0, v1)
    high = fastest
    peak = fastest
    miss_low = -space
    miss_high = 0.0
    for again in range(60):
        rising = duration(boxcars(peak - v0, left.acceleration, left.jerk, left.snap))
        falling = duration(boxcars(peak - v1, right.acceleration, right.jerk, right.snap))
        miss = 0.5 * ((v0 + peak) * up * rising + (v1 + peak) * down * falling) - space
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
        # regula falsi (Illinois): the retained end gets half its weight
        peak = low - miss_low * (high - low) / (miss_high - miss_low) if again > 0 else 0.5 * (low + high)
    return low


@kernel
def hump(path: Path, stretch: Stretch, free: bool) -> Stretch:
    """Return the stretch with the highest peak speed found, not lower than its present peak; if none is found, the
    returned stretch has peak 0.

    A `free` hump may exceed the caps of pieces, but not the highest of them.
    """
    first = piece_at(path.begin, stretch.begin, True)
    last = piece_at(path.begin, stretch.end, False)
    left = straight(path.most[first], path.limits)
    right = straight(path.most[last], path.limits)
    space = stretch.end - stretch.begin
    v0 = stretch.v0
    v1 = stretch.v1
    least = max(v0, v1)
    best = stretch
    low = stretch.peak
    fastest = _highest_cap(path, first, last)
    high = fastest
    up = 1.0
    down = 1.0
    fails = False  # True if the highest peak is infeasible
    if low >= high:
        return stretch
    peak = max(_filling(space, v0, v1, high, left, right, up, down), least)
    if low > 0.0 and peak <= 1.0005 * low:
        return stretch
    for again in range(_PEAKS):
        if peak <= 0.0:
            break
        wanted = 0.0
        full = False
        good, rising, up = fit(path, stretch.begin, first, 1, stretch.end, v0, peak, free, up)
        if good:
            tried = stretch._replace(peak=peak, up=rising)
            ends = plateau_begin(tried)
            good, falling, down = fit(path, stretch.end, last, -1, ends, v1, peak, free, down)
            if good:
                tried = tried._replace(down=falling)
                goes = plateau_end(tried)
                full = ends - stretch.begin + stretch.end - goes >= _FULL * space
                if not free:
                    # no peak slightly above the cap of a plateau is feasible
                    cap = least_cap(path, first, last, ends, goes)
                    good = peak <= cap * (1.0 + 1e-12)
                    full = full or peak >= cap * (1.0 - 1e-9)
                    if not good:
                        wanted = cap
                if good:
                    low = peak
                    best = tried
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
            wanted = _filling(space, v0, v1, high, left, right, up, down)
            if wanted <= 1.0005 * low and good:
                break
            if wanted <= 1.0005 * low or (fails and wanted >= 0.9995 * high):
                wanted = sqrt(low * high) if low > 0.0 else max(0.3 * high, least)
            if low == 0.0 and again >= _FAR:
                # a slow piece lies beyond the ramps evaluated: no peak near the highest one is feasible
                wanted = max(min(wanted, 0.3 * high), least)
        peak = wanted
    return best


@kernel
def too_fast(path: Path, stretch: Stretch, above: float) -> int:
    """Return the piece with the lowest cap > `above` among those where a hump exceeds the cap for ramps, or -1 if there
    is none.
    """
    first = piece_at(path.begin, stretch.begin, True)
    last = piece_at(path.begin, stretch.end, False)
    slowest = -1
    for p in range(first, last + 1):
        cap = path.caps[p]
        if cap.plateau <= above or (slowest >= 0 and cap.plateau >= path.caps[slowest].plateau):
            continue
        v = min(
            speed_at(path.begin[p + 1] - stretch.begin, stretch.v0, stretch.peak - stretch.v0, stretch.up),
            speed_at(stretch.end - path.begin[p], stretch.v1, stretch.peak - stretch.v1, stretch.down),
        )
        if v > cap.ramp * (1.0 + 1e-9):
            slowest = p
    return slowest


@kernel
def hump_time(stretch: Stretch) -> float:
    """Return the duration of a hump, s."""
    up = duration(stretch.up)
    down = duration(stretch.down)
    way = stretch.end - stretch.begin
    way = way - 0.5 * (stretch.v0 + stretch.peak) * up - 0.5 * (stretch.v1 + stretch.peak) * down
    return up + down + max(way, 0.0) / stretch.peak


@kernel
def brake(path: Path, left: float, right: float, v0: float, v1: float) -> Stretch:
    """Return the stretch with constant speed v0 > 0 from `left` that then brakes to v1 at `right`; if there is none,
    the returned stretch has peak 0.
    """
    last = piece_at(path.begin, right, False)
    good, down, _ = fit(path, right, last, -1, left, v1, v0, False, 1.0)
    stretch = Stretch(left, right, v0, v1, peak=v0, down=down)
    if good:
        cap = least_cap(path, piece_at(path.begin, left, True), last, left, plateau_end(stretch))
        if cap >= v0 * (1.0 - 1e-12):
            return stretch
    return stretch._replace(peak=0.0)


@kernel
def brake_soon(path: Path, left: float, stop: float, v0: float, v1: float) -> Stretch:
    """Return a stretch from `left` that brakes from v0 > 0 to v1 in as short a distance as possible; if there is none,
    the returned stretch has peak 0.

    It ends no later than at `stop`.
    """
    bounds = straight(path.most[piece_at(path.begin, left, True)], path.limits)
    ramp = boxcars(v0 - v1, bounds.acceleration, bounds.jerk, bounds.snap)
    # slightly more than the closed form, which on a straight piece leaves nothing for rounding
    way = 0.5 * (v0 + v1) * duration(ramp) * (1.0 + 1e-8)
    low = 0.0
    high = 0.0
    stretch = Stretch(left, stop, v0, v1)
    for _ in range(60):
        high = min(way, stop - left)
        stretch = brake(path, left, left + high, v0, v1)
        if stretch.peak > 0.0 or way >= stop - left:
            break
        low = high
        way = 1.3 * way
    if stretch.peak == 0.0:
        return stretch
    while high - low > 1e-3 * high and low > 0.0:
        middle = 0.5 * (low + high)
        if brake(path, left, left + middle, v0, v1).peak > 0.0:
            high = middle
        else:
            low = middle
    return brake(path, left, left + high, v0, v1)


_HIGHEST, _LEAST = 16.0, 4.0  # speeds, relative to the plateau, up to which ramps on either side are compared
# rounding must not move the end of a ramp to the piece behind a joint, for which it was not made
MARGIN = 4e-15  # of the planned length: distance of the ends of ramps from joints


@kernel
def _gain(path: Path, near: float, far: float, sense: int, end: float, c: float) -> float:
    """Return the time, s, that a ramp from the speed c gains if it starts at `far` instead of `near`.  The ramp may
    extend to `end`.

    The ramps end at the highest of several trial speeds for which both exist.
    """
    factor = _HIGHEST
    while factor > _LEAST:
        high = factor * c
        one = piece_at(path.begin, near, sense > 0)
        good, soon, _ = fit(path, near, one, sense, end, c, high, False, 1.0)
        if good:
            two = piece_at(path.begin, far, sense > 0)
            good, later, _ = fit(path, far, two, sense, end, c, high, False, 1.0)
            if good:
                late = abs(far - near) * (1.0 / c - 1.0 / high)
                less = duration(soon) - later.L1 - later.L2 - later.L3
                return (1.0 - 0.5 * (c + high) / high) * less - late
        factor = 0.5 * (1.0 + factor)
    return 0.0


@kernel
def _leaves(
    path: Path,
    now: Stretch,
    first: int,
    low: int,
    high: int,
    last: int,
    reached: float,
    ends: float,
    goes: float,
    behind: float,
    c: float,
) -> bool:
    """Return True if a plateau at the speed c from `ends` to `goes` fits between the ramp to c, which ends at
    `reached`, and the ramp from c, which begins at `behind`.
    """
    if ends > goes or ends >= now.end or goes <= now.begin:
        return False
    # a plateau at the end of a ramp only repeats the single ramp between the nodes
    if (ends <= now.begin and goes == behind) or (goes >= now.end and ends == reached):
        return False
    return least_cap(path, first, low, reached, ends) >= c and least_cap(path, high, last, goes, behind) >= c


@kernel
def _split(path: Path, now: Stretch, p: int, c: float) -> tuple[bool, Stretch, Stretch]:
    """Pass piece p at the constant speed c between ramps from both nodes; return the stretches to the left and right of
    the plateau.

    The plateau covers only this piece, or also neighbors that ramps may not cross at that speed, whichever is faster.
    Each side has a feasible hump or zero length.  Ramps end `MARGIN` before the plateau and begin `MARGIN` after it.
    The first result is False if there is no such plateau.
    """
    # the invariant of the search: no plateau is slower than the nodes, so that both ramps to them can exist
    if c < now.v0 or c < now.v1:
        return False, now, now
    begin = path.begin
    first = piece_at(begin, now.begin, True)
    last = piece_at(begin, now.end, False)
    margin = MARGIN * (begin[len(begin) - 1] - begin[0])
    low = p
    while low > first and path.caps[low - 1].ramp <= c and path.caps[low - 1].plateau >= c:
        low = low - 1
    high = p
    while high < last and path.caps[high + 1].ramp <= c and path.caps[high + 1].plateau >= c:
        high = high + 1
    farthest = min(now.end, begin[high + 1] + margin)
    good, up, _ = fit(path, now.begin, first, 1, farthest, now.v0, c, False, 1.0)
    if not good:
        return False, now, now
    reached = now.begin + 0.5 * (now.v0 + c) * duration(up)
    farthest = max(reached, begin[low] - margin)
    good, down, _ = fit(path, now.end, last, -1, farthest, now.v1, c, False, 1.0)
    if not good:
        return False, now, now
    behind = now.end - 0.5 * (now.v1 + c) * duration(down)
    ends = max(begin[p] - margin, reached)
    goes = min(begin[p + 1] + margin, behind)
    wide_ends = max(begin[low] - margin, reached)
    wide_goes = min(begin[high + 1] + margin, behind)
    narrow = _leaves(path, now, first, p, p, last, reached, ends, goes, behind, c)
    wide = (low < p or high > p) and _leaves(
        path, now, first, low, high, last, reached, wide_ends, wide_goes, behind, c
    )
    if narrow and wide:
        gain = 0.0
        if wide_ends < ends:
            gain = _gain(path, ends, wide_ends, -1, now.begin, c)
        if wide_goes > goes:
            gain = gain + _gain(path, goes, wide_goes, 1, now.end, c)
        narrow = gain <= 0.0
    if not narrow and not wide:
        return False, now, now
    if not narrow:
        ends = wide_ends
        goes = wide_goes
    left = Stretch(now.begin, ends, now.v0, c, peak=c, up=up)
    return True, left, Stretch(goes, now.end, c, now.v1, peak=c, down=down)


@kernel
def _beginning(
    path: Path, quick: Records[Cap], u0: float, u1: float, v0: float, slow: Ints, stack: Records[Stretch]
) -> int:
    """Write a feasible plan to a stop at u1 into `stack`, last stretch first; return the number of stretches, or 0 if
    there is no such plan.

    From rest the plan is a single hump.  If a piece ahead is too slow for the present speed, the motion is braked in as
    few steps as possible, each to the cap of a piece that is slower than all pieces before it; `slow` is workspace for
    these pieces.
    """
    if v0 == 0.0:
        whole = Stretch(u0, u1, 0.0, 0.0)
        stack[0] = hump(path, whole, False)
        return 1 if stack[0].peak > 0.0 else 0
    begin = path.begin
    # the present speed may come from a plan with the higher caps, so that only these apply to it
    quickly = path._replace(caps=quick)
    margin = MARGIN * (begin[len(begin) - 1] - begin[0])
    many = 0
    least = v0
    for p in range(piece_at(begin, u0, True) + 1, piece_at(begin, u1, False) + 1):
        if path.caps[p].plateau < least:
            least = path.caps[p].plateau
            slow[many] = p
            many = many + 1
    right = u1
    v1 = 0.0
    count = 0
    while True:
        # the farthest of them from which one ramp brakes: -1 is the motion itself
        farthest = -2
        misses = 0
        for back in range(many + 1):
            k = many - 1 - back
            left = u0 if k < 0 else begin[slow[k]] - margin
            good = False
            if k < 0:
                good = brake(quickly, u0, right, v0, v1).peak > 0.0
            elif left < right:
                good = brake(path, left, right, path.caps[slow[k]].plateau, v1).peak > 0.0
            if good:
                farthest = k
                misses = 0
            elif farthest > -2:
                misses = misses + 1
                if misses == 2:
                    break
        if farthest == -2:
            return 0
        count = count + 1
        if farthest < 0:
            stack[count - 1] = brake(quickly, u0, right, v0, v1)
            return count
        left = begin[slow[farthest]] - margin
        stack[count - 1] = brake(path, left, right, path.caps[slow[farthest]].plateau, v1)
        right = left
        v1 = path.caps[slow[farthest]].plateau
        many = farthest


@kernel
def _slowest(path: Path, now: Stretch, free: Stretch) -> int:
    """Return the slowest piece that a free hump crosses too fast and that is not slower than both nodes, or -1."""
    return too_fast(path, free, max(now.v0, now.v1) * (1.0 - 1e-9)) if free.peak > 0.0 else -1


@kernel
def _slow_piece(path: Path, now: Stretch, free: Stretch, p: int) -> tuple[bool, Stretch, Stretch]:
    """Pass piece p, or one of the next faster ones that a free hump crosses too fast, at its cap by `_split`.

    The first result is False if there is no such plateau.
    """
    split = False
    left = now
    right = now
    while p >= 0 and not split:
        split, left, right = _split(path, now, p, path.caps[p].plateau)
        p = too_fast(path, free, path.caps[p].plateau)
    return split, left, right


@kernel
def _whole(path: Path, left: Stretch, right: Stretch) -> tuple[float, Stretch, Stretch]:
    """Return the time of both humps and of the plateau between them, s, and both stretches with their humps."""
    time = (right.begin - left.end) / left.v1
    if left.end > left.begin:
        left = hump(path, left, False)
        time = time + hump_time(left)
    if right.end > right.begin:
        right = hump(path, right, False)
        time = time + hump_time(right)
    return time, left, right


@kernel
def takes_time(stretch: Stretch, begin: Floats) -> bool:
    """Return True if a stretch has a ramp or a plateau longer than rounding errors, as others have no motion."""
    L1, L2, L3 = stretch.up
    M1, M2, M3 = stretch.down
    return L1 + L2 + L3 + M1 + M2 + M3 > 0.0 or stretch.end - stretch.begin > MARGIN * (begin[-1] - begin[0])


@kernel
def plan(
    path: Path,
    quick: Records[Cap],
    u0: float,
    u1: float,
    v0: float,
    slow: Ints,
    stack: Records[Stretch],
    out: Records[Stretch],
) -> int:
    """Plan from u0 at speed v0 to a stop at u1; return the number of stretches written to `out`, or -1 if v0 is too
    fast to stop in time.
    """
    height = _beginning(path, quick, u0, u1, v0, slow, stack)
    if height == 0:
        return -1
    count = 0
    while height > 0:
        height = height - 1
        now = stack[height]
        if not now.held:
            free = hump(path, now, True)
            p = too_fast(path, free, 0.0) if free.peak > 0.0 else -1
            split = False
            left = now
            right = now
            # split only while there is room for the rows of all waiting stretches; the unsplit hump is feasible as well
            if p < 0:
                now = free
            elif height + 3 <= len(stack) and count + height + 3 <= len(out):
                slowest = _slowest(path, now, free)
                split, left, right = _slow_piece(path, now, free, slowest)
                if not split and now.peak > 0.0:
                    # the ramps of this free hump may be as slow as those of the feasible one from which it was found,
                    # and so miss the slowest piece, which a plateau anywhere else would then cross too fast
                    free = hump(path, now._replace(peak=0.0), True)
                    p = _slowest(path, now, free)
                    if p >= 0 and p != slowest:
                        slowest = p
                        split, left, right = _slow_piece(path, now, free, p)
                if not split:
                    now = hump(path, now, False)
                    c = 1.0
                    for _ in range(2):
                        if slowest < 0 or split:
                            break
                        c = 0.5 * c
                        split, left, right = _split(path, now, slowest, c * path.caps[slowest].plateau)
                        if split:
                            time, left, right = _whole(path, left, right)
                            split = time < hump_time(now)
            if split:
                if right.end > right.begin:
                    stack[height] = right
                    height = height + 1
                if right.begin > left.end:
                    c = left.v1
                    stack[height] = Stretch(left.end, right.begin, c, c, peak=c, held=True)
                    height = height + 1
                if left.end > left.begin:
                    stack[height] = left
                    height = height + 1
                continue
            if height + 3 > len(stack) or count + height + 3 > len(out):
                now = hump(path, now, False)
        out[count] = now
        count = count + 1
    kept = 0
    for k in range(count):
        if takes_time(out[k], path.begin):
            out[kept] = out[k]
            kept = kept + 1
    return kept


@kernel
def _phases(
    begin: Floats, motion: Motion, count: int, u: float, low: float, peak: float, ramp: Ramp, up: bool
) -> tuple[int, float]:
    """Append the phases of a ramp that begins at u; return the new count, and u at its end."""
    rise = peak - low
    if rise <= 0.0 or ramp.L3 <= 0.0:
        return count, u
    p = piece_at(begin, u, True)
    v = low if up else peak
    a = 0.0
    j = 0.0
    sense = 1.0 if up else -1.0
    jerk_most = ramp_jerk(rise, ramp)
    for number in range(7):
        T, s = phase(number, rise, ramp)
        s = sense * s
        if T > 0.0:
            while p + 1 < len(begin) - 1 and begin[p + 1] <= u:
                p = p + 1
            count = appended(motion, count, Interval(T, u - begin[p], v, a, j, s), p)
            u = u + T * (v + T * (0.5 * a + T * (j / 6.0 + T * s / 24.0)))
            v = v + T * (a + T * (0.5 * j + T * s / 6.0))
            a = a + T * (j + 0.5 * T * s)
        a = sense * acceleration_before(number + 1, rise, ramp, sense * a)
        # in closed form, so that rounding does not accumulate
        j = sense * jerk_before(number + 1, jerk_most)
    return count, u


@kernel
def timed(begin: Floats, stretches: Records[Stretch], motion: Motion) -> int:
    """Write the time intervals of constant snap of some stretches into `motion`; return their number."""
    count = 0
    rounding = MARGIN * (begin[-1] - begin[0])
    for k in range(len(stretches)):
        now = stretches[k]
        count, u = _phases(begin, motion, count, now.begin, now.v0, now.peak, now.up, True)
        # counted back from the node, so that the rounding of the ramp up does not move the end of the ramp down
        brakes = now.end - 0.5 * (now.v1 + now.peak) * duration(now.down)
        # a plateau shorter than rounding is left out: its duration would be noise
        if brakes - u > rounding:
            p = piece_at(begin, u, True)
            count = appended(motion, count, Interval((brakes - u) / now.peak, u - begin[p], now.peak, 0.0, 0.0, 0.0), p)
        count, u = _phases(begin, motion, count, brakes, now.v1, now.peak, now.down, False)
    return count
