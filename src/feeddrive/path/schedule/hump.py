"""The hump of one stretch: the ramp from its left node up to a peak, a plateau, and the ramp down to its right node."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats
from feeddrive.path.schedule.ramp import NO_RAMP, Bounds, Path, Ramp, boxcars, duration, fit, speed_at, straight

_PEAKS = 40  # tried for a hump
_FAR = 6  # tries after which a peak near the upper end is given up, if none has held
_FULL = 1.0 - 3e-6  # of a stretch: ramps that take up this much of it need no higher peak


class Stretch(NamedTuple):
    """A stretch of path between two nodes: a ramp up, a plateau and a ramp down.

    begin, end  u of the nodes, m
    v0, v1      speeds at the nodes, m/s
    peak        speed of the plateau, m/s; 0 if no hump is known
    up, down    the ramps; a brake has none upwards
    held        true for a plateau at the cap of a piece, which is not planned again
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
def least_cap(path: Path, first: int, last: int, left: float, right: float) -> float:
    """The lowest cap of the pieces under a plateau from `left` to `right`."""
    lowest = 1e300
    for p in range(first, last + 1):
        if path.begin[p + 1] > left and path.begin[p] < right:
            lowest = min(lowest, path.caps[p].plateau)
    return lowest


@kernel
def _highest_cap(path: Path, first: int, last: int) -> float:
    """The highest cap of some pieces."""
    highest = 0.0
    for p in range(first, last + 1):
        highest = max(highest, path.caps[p].plateau)
    return highest


@kernel
def plateau_begin(stretch: Stretch) -> float:
    """The u at which the ramp up ends, m."""
    return stretch.begin + 0.5 * (stretch.v0 + stretch.peak) * duration(stretch.up)


@kernel
def plateau_end(stretch: Stretch) -> float:
    """The u at which the ramp down begins, m."""
    return stretch.end - 0.5 * (stretch.v1 + stretch.peak) * duration(stretch.down)


@kernel
def _filling(
    space: float, v0: float, v1: float, fastest: float, left: Bounds, right: Bounds, up: float, down: float
) -> float:
    """The peak whose ramps fill a space.

    `left` and `right` are the bounds of the ramps up and down on straight pieces, of which they take `up` and `down`
    times the time.
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
        # the regula falsi, with the end that stays at half its weight
        peak = low - miss_low * (high - low) / (miss_high - miss_low) if again > 0 else 0.5 * (low + high)
    return low


@kernel
def hump(path: Path, stretch: Stretch, free: bool) -> Stretch:
    """The stretch with the highest peak that is found, at least its own; peak 0 if there is none.

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
    fails = False  # whether the high one does
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
                    # no peak a little above the cap of a plateau holds
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
                # a slow piece is far from where the ramps are looked at: no peak near the high one holds
                wanted = max(min(wanted, 0.3 * high), least)
        peak = wanted
    return best


@kernel
def too_fast(path: Path, stretch: Stretch, above: float) -> int:
    """Of the pieces that a hump crosses faster than ramps should, the one with the lowest cap > `above`; -1: none."""
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
    """The duration of a hump, s."""
    up = duration(stretch.up)
    down = duration(stretch.down)
    way = stretch.end - stretch.begin
    way = way - 0.5 * (stretch.v0 + stretch.peak) * up - 0.5 * (stretch.v1 + stretch.peak) * down
    return up + down + max(way, 0.0) / stretch.peak


@kernel
def brake(path: Path, left: float, right: float, v0: float, v1: float) -> Stretch:
    """The stretch that holds v0 > 0 from `left` on and then brakes to v1 at `right`; peak 0 if there is none."""
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
    """A stretch from `left` that brakes from v0 > 0 to v1 in as little way as is found; peak 0 if there is none.

    It ends at `stop` at the latest.
    """
    bounds = straight(path.most[piece_at(path.begin, left, True)], path.limits)
    ramp = boxcars(v0 - v1, bounds.acceleration, bounds.jerk, bounds.snap)
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
