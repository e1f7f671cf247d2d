"""A small planner as kernels: speeds along a row of pieces with caps, between stops, under acceleration, jerk and snap.

Valleys first: on an interval with known speeds at its ends the lowest cap that a ramp could reach is held over its
piece, and the same is done left and right of it; where its ramps do not fit, the peak is found by bisection.
"""

from __future__ import annotations

from kernel_ramps import endless_speed, evaluate, ramp_distance, ramp_pieces

from feeddrive.language.kernels.kernel import kernel
from feeddrive.language.kernels.source import Floats, Floats2, Ints, zeros

HOLD, INTERVAL = 1, 0


@kernel
def lowest_cap(
    ends: Floats, caps: Floats, low: int, high: int, start: float, end: float, limits: Floats
) -> tuple[int, float]:
    """The piece with the lowest cap that a ramp from either end could reach; if there is none -1, the highest cap."""
    found, lowest, highest = -1, 0.0, 0.0
    for k in range(low, high):
        highest = max(highest, caps[k])
        if found >= 0 and caps[k] >= lowest:
            continue
        from_start = endless_speed(start, ends[k + 1] - ends[low], limits[0], limits[1], limits[2])
        from_end = endless_speed(end, ends[high] - ends[k], limits[0], limits[1], limits[2])
        if from_start >= caps[k] and from_end >= caps[k]:
            found, lowest = k, caps[k]
    if found < 0:
        return found, highest
    return found, lowest


@kernel
def peak(start: float, end: float, room: float, cap: float, limits: Floats) -> float:
    """The largest speed, up to a cap, to which and from which ramps fit into a room."""
    low, high = max(start, end), cap
    for _ in range(50):
        middle = 0.5 * (low + high)
        way = ramp_distance(start, middle, limits[0], limits[1], limits[2])
        way += ramp_distance(middle, end, limits[0], limits[1], limits[2])
        if way <= room:
            low = middle
        else:
            high = middle
    return low


@kernel
def held(
    time: float, position: float, speed: float, room: float, times: Floats, pieces: Floats2, count: int
) -> tuple[int, float, float]:
    """Appends a piece of constant speed."""
    if room <= 0.0:
        return count, time, position
    times[count] = time
    pieces[count] = position, speed, 0.0, 0.0, 0.0
    return count + 1, time + room / speed, position + room


@kernel
def plan(
    ends: Floats,
    caps: Floats,
    acceleration: float,
    jerk: float,
    snap: float,
    stack: Ints,
    speeds: Floats2,
    times: Floats,
    pieces: Floats2,
) -> tuple[int, float, float]:
    """The pieces of a motion from rest to rest; gives their count, the time and the way."""
    limits = zeros(3)
    limits[0], limits[1], limits[2] = acceleration, jerk, snap
    depth, count, time, position = 1, 0, 0.0, 0.0
    stack[0], stack[1], stack[2] = INTERVAL, 0, len(caps)
    speeds[0] = 0.0, 0.0
    while depth > 0:
        depth -= 1
        kind, low, high = stack[3 * depth], stack[3 * depth + 1], stack[3 * depth + 2]
        start, end = speeds[depth]
        if low >= high:
            continue
        room = ends[high] - ends[low]
        if kind == HOLD:
            count, time, position = held(time, position, start, room, times, pieces, count)
            continue
        valley, cap = lowest_cap(ends, caps, low, high, start, end, limits)
        fits = False
        if valley >= 0 and cap > max(start, end):
            before = ramp_distance(start, cap, acceleration, jerk, snap)
            behind = ramp_distance(cap, end, acceleration, jerk, snap)
            fits = before <= ends[valley] - ends[low] and behind <= ends[high] - ends[valley + 1]
        if fits:
            for part in range(3):
                place = depth + part
                stack[3 * place] = HOLD if part == 1 else INTERVAL
                stack[3 * place + 1] = low if part == 2 else (valley if part == 1 else valley + 1)
                stack[3 * place + 2] = high if part == 0 else (valley + 1 if part == 1 else valley)
                speeds[place] = (start if part == 2 else cap), (end if part == 0 else cap)
            depth += 3
            continue
        top = peak(start, end, room, max(cap, start, end), limits)
        ways = ramp_distance(start, top, acceleration, jerk, snap) + ramp_distance(top, end, acceleration, jerk, snap)
        count, time, position = ramp_pieces(time, position, start, top, acceleration, jerk, snap, times, pieces, count)
        count, time, position = held(time, position, top, room - ways, times, pieces, count)
        count, time, position = ramp_pieces(time, position, top, end, acceleration, jerk, snap, times, pieces, count)
    return count, time, position


@kernel
def plan_and_sample(
    ends: Floats,
    caps: Floats,
    acceleration: float,
    jerk: float,
    snap: float,
    stack: Ints,
    speeds: Floats2,
    times: Floats,
    pieces: Floats2,
    at: Floats,
    values: Floats2,
) -> tuple[int, float, float]:
    """The plan and its setpoints with all derivatives."""
    count, time, way = plan(ends, caps, acceleration, jerk, snap, stack, speeds, times, pieces)
    evaluate(times, pieces, count, at, values)
    return count, time, way
