"""The engagement of helical edges: entry and exit of the chip, and the force from the tool motion since earlier cuts.

The angle v of an edge is measured from the normal n = spindle axis x feed t towards t, clockwise seen from the spindle.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Self

from feeddrive.blocks.families import Edge
from feeddrive.language import ops
from feeddrive.language.block import Number, Rule
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text

# m; smaller values are rounding errors of positions, not a chip
LEAST_CHIP = 1e-12
LEAST_ANGLE = 1e-6  # rad; least angle over which a straight edge enters and leaves the cut


def arc(milling: str, radial_depth: Number | None, diameter: Number) -> tuple[Any, Any]:
    """Return the entry and exit angle of the chip in rad for a radial depth in m, or for a slot if it is None.

    up 0 .. a,   down π - a .. π,   a = arccos(1 - 2 radial_depth / diameter)
    symmetric π/2 ∓ arcsin(radial_depth / diameter)
    """
    if radial_depth is None:
        return 0.0, ops.pi
    share = radial_depth / diameter
    if milling == "symmetric":
        half = ops.atan2(share, ops.sqrt(ops.maximum(1.0 - share * share, 0.0)))
        return 0.5 * ops.pi - half, 0.5 * ops.pi + half
    # arccos(1 - 2 share) by the half angle, which loses no digits at either end
    angle = 2.0 * ops.atan2(ops.sqrt(share), ops.sqrt(ops.maximum(1.0 - share, 0.0)))
    return (0.0, angle) if milling == "up" else (ops.pi - angle, ops.pi)


def arc_on_circle(radial_depth: Number, diameter: Number, path_radius: Number, *, concave: bool) -> Any:
    """Return the arc in rad over which a tooth cuts while the tool center moves on a circle with a radius in m.

        concave wall: cos ψ = ((r_c + R - a_e)² - r_c² - R²) / (2 r_c R)
        convex wall:  cos ψ = (r_c² + R² - (r_c - R + a_e)²) / (2 r_c R)

    a_e = radial_depth, R = diameter / 2, r_c = path_radius.  In an inside corner the arc is longer than
    along a straight wall with the same radial depth; around an outside corner it is shorter.
    """
    radius = 0.5 * diameter
    if concave:
        wall = path_radius + radius - radial_depth
        cosine = (wall * wall - path_radius * path_radius - radius * radius) / (2.0 * path_radius * radius)
    else:
        wall = path_radius - radius + radial_depth
        cosine = (path_radius * path_radius + radius * radius - wall * wall) / (2.0 * path_radius * radius)
    # arccos; rounding may put the cosine of a full engagement just beyond ±1
    return ops.atan2(ops.sqrt(ops.maximum(1.0 - cosine * cosine, 0.0)), cosine)


def trochoid_chip(angle: Number, chip_load: Number, radius: Number, teeth: int) -> Any:
    """Return the chip thickness (m) of a tooth on its true path, a trochoid; to first order it is chip_load · sin v.

        R sin δ = (c - ρδ) cos v,   h = R (1 - cos δ) + (c - ρδ) sin v,   ρ = c teeth / 2π, the feed per rad

    angle      angle v of the tooth, rad
    chip_load  feed per tooth c, m
    radius     radius R of the tool, m

    The two values differ most, by c²/2R, at entry and exit, since on its true path a tooth cuts before 0 and after π.
    """
    feed = chip_load * float(teeth) / (2.0 * ops.pi)
    sine, cosine = ops.sin(angle), ops.cos(angle)
    delta = chip_load * cosine / radius
    # four Newton steps: the relative error of the first guess is chip_load / radius, and each step squares it
    for _ in range(4):
        left = radius * ops.sin(delta) - (chip_load - feed * delta) * cosine
        delta = delta - left / (radius * ops.cos(delta) + feed * cosine)
    # 1 - cos δ = 2 sin²(δ/2), which keeps the digits of a small δ
    half = ops.sin(0.5 * delta)
    return 2.0 * radius * half * half + (chip_load - feed * delta) * sine


class Cut(NamedTuple):
    """The force on the tool along feed, normal and spindle axis in N, and the spindle torque in N m."""

    feed: Any
    normal: Any
    axial: Any
    torque: Any


class Rubbing(NamedTuple):
    """The process damping of an edge: its velocity along t and n (m/s), and damping / cutting speed (N s/m2)."""

    along: Any
    across: Any
    damping: Any


def lag(edge: Edge) -> Any:
    """Return the lag angle of an edge from its tip to its top, rad."""
    return 2.0 * edge.axial_depth * ops.tan(edge.helix_angle) / edge.diameter


def fits_slices(kind: str, edge: Edge) -> Rule:
    """Return the rule that a slice spans at most a quarter of a turn.

    The closed forms require that no slice spans the whole unengaged arc.
    """
    turn, slices = lag(edge), edge.slices
    return Rule(
        turn <= 0.5 * ops.pi * float(slices),
        "a slice of the edge turns by at most a quarter of a turn",
        lambda: Text(
            f"{kind}.slices = {slices}: an edge that turns by {Quantity(float(turn), 'rad'):3} over its depth of "
            f"{Quantity(float(edge.axial_depth), 'm'):6 SI} needs at least {-int(-(float(turn) / (0.5 * ops.pi)) // 1)}"
        ),
    )


def cut(
    edge: Edge, angle: Number, sweep: Number, steps: Sequence[tuple[Any, Any]], rubbing: Rubbing | None = None
) -> Cut:
    """Return the force of all teeth at an angle of the spindle in rad, averaged over the angle `sweep` around it.

    steps  the motion of the tool along t and n in m since each earlier tooth, latest first, was at this angle

    The chip thickness of a slice is the smallest over the surfaces left by earlier teeth; where it is not positive,
    there is no force, not even an edge force:

        h(v) = min over m of (step_m + o(angle) - o(angle - 2π m/teeth)) · e(v),    e = (sin v, cos v)

    with the run-out o as a displacement of the tool center, exact to first order in offset / diameter.  Over the
    engaged part of a slice, h sin v, h cos v and h are integrated in closed form.  If the sweep exceeds the lag of the
    slice, they are integrated over the sweep instead: the entry of a straight edge is thus averaged over the sweep.
    """
    slices, teeth = float(edge.slices), float(edge.teeth)
    turn = lag(edge)
    width = ops.maximum(turn / slices, ops.maximum(sweep, LEAST_ANGLE))
    # the edge that is widened to the sweep keeps its middle
    tip = angle + 0.5 * (slices * width - turn)
    moved = _with_run_out(edge, angle, steps)
    arms = _Arms.of(edge)
    sine, cosine = ops.sin(tip), ops.cos(tip)
    back = ops.sin(width), ops.cos(width)
    begin = (tip - 0.5 * (edge.entry + edge.exit)) / (2.0 * ops.pi) + 0.5
    step = width / (2.0 * ops.pi)
    # a longer edge may leave and reenter the engaged part, and its two ends do not show that
    short = slices * width <= ops.pi - arms.half
    begin_of_work = 0.5 - 0.5 * arms.half / ops.pi  # in turns from the middle of the unengaged part
    total = [ops.zero(sine)] * 9
    for tooth in range(edge.teeth):
        s, c = _turned(sine, cosine, *_of_tooth(tooth, edge.teeth))
        place = begin + float(tooth) / teeth
        before = arms.end(s, c, place)
        tip_end, sums = before, [ops.zero(sine)] * len(total)
        for slice_ in range(1, edge.slices + 1):
            # a rotation, which is cheaper than a sine and a cosine for each slice of each tooth
            s, c = s * back[1] - c * back[0], c * back[1] + s * back[0]
            after = arms.end(s, c, place - float(slice_) * step)
            sums = [a + b for a, b in zip(sums, _slice(after, before, moved), strict=True)]
            before = after
        # in a single run an edge out of the cut costs nothing, and one in full contact as much as one slice
        past = place - begin_of_work
        works = past - ops.floor(past) < arms.half / ops.pi + slices * step
        whole = ops.both(short, _in_contact(before, tip_end, moved))
        # in contact everywhere, the edge cuts the surface of the last tooth alone
        at_once = _slice(before, tip_end, moved[:1])
        sums = [ops.where(whole, a, b) for a, b in zip(at_once, sums, strict=True)]
        total = [a + ops.where(works, b, 0.0) for a, b in zip(total, sums, strict=True)]
    return _forces(edge, total, edge.axial_depth / (slices * width), rubbing)


class _End(NamedTuple):
    """One end of a slice, limited to the engaged part: its angle, sin, cos, sin cos and sin²."""

    angle: Any
    sine: Any
    cosine: Any
    both: Any
    square: Any


class _Arms(NamedTuple):
    """The engaged arc of an edge: half of its angle, and sine and cosine of entry and exit."""

    half: Any
    entry: tuple[Any, Any]
    exit: tuple[Any, Any]

    @classmethod
    def of(cls, edge: Edge) -> Self:
        """Return the engaged arc of an edge."""
        begin, end = edge.entry, edge.exit
        return cls(0.5 * (end - begin), (ops.sin(begin), ops.cos(begin)), (ops.sin(end), ops.cos(end)))

    def end(self, sine: Any, cosine: Any, turns: Any) -> _End:
        """Return a slice end, clamped to the engaged arc; `turns` is its angle from the middle of the unengaged arc."""
        angle = 2.0 * ops.pi * (turns - ops.floor(turns)) - ops.pi
        below, above = angle < -self.half, angle > self.half
        held = ops.where(below, -self.half, ops.where(above, self.half, angle))
        s = ops.where(below, self.entry[0], ops.where(above, self.exit[0], sine))
        c = ops.where(below, self.entry[1], ops.where(above, self.exit[1], cosine))
        return _End(held, s, c, s * c, s * s)


def _in_contact(low: _End, high: _End, moved: Sequence[tuple[Any, Any]]) -> Any:
    """Return True if the whole slice cuts into the surface left by the previous tooth.

    The chip thickness is sinusoidal in the angle: if it is not negative at two ends less than π apart, it is not
    negative between them.
    """
    (x, y), *others = moved
    signs = [(x, y), *((other_x - x, other_y - y) for other_x, other_y in others)]
    found: Any = True
    for a, b in signs:
        for end in (low, high):
            above = a * end.sine + b * end.cosine >= 0.0
            found = above if found is True else ops.both(found, above)
    return found


def _slice(low: _End, high: _End, moved: Sequence[tuple[Any, Any]]) -> list[Any]:
    """Return 2∫h sin v, 2∫h cos v, ∫h, ∫sin v, ∫cos v, ∫1, 2∫sin², 2∫sin cos, 2∫cos² over a slice; 0 if there is no
    cut.
    """
    angle, ds, dc = high.angle - low.angle, high.sine - low.sine, low.cosine - high.cosine
    both, mixed = high.both - low.both, high.square - low.square
    sines, cosines = angle - both, angle + both
    (x, y), *others = moved
    chip = x * dc + y * ds
    for other_x, other_y in others:
        other = other_x * dc + other_y * ds
        less = other < chip
        chip = ops.where(less, other, chip)
        x, y = ops.where(less, other_x, x), ops.where(less, other_y, y)
    # the angle is negative here for an edge with its ends on both sides of the middle of the unengaged part
    cuts = ops.both(angle > 0.0, chip > LEAST_CHIP * angle)
    found = (x * sines + y * mixed, x * mixed + y * cosines, chip, dc, ds, angle, sines, mixed, cosines)
    return [ops.where(cuts, value, 0.0) for value in found]


def edge_force(cutting: Any, edge: Any, chip: Any, length: Any) -> Any:
    """Return the force of a cutting edge in one direction, the mechanistic law K_c · chip + K_e · length, in N.

    cutting  K_c, force per area of the chip, N/m2
    edge     K_e, force per length of the edge, N/m; None: none
    chip     area of the chip, thickness times width of cut, m2; or its integral with a weight
    length   length of the edge in the cut, m; or its integral with the same weight

    Source: Altintas, Manufacturing Automation (2nd ed. 2012), chapter 2, F = K_c b h + K_e b, with b the width of cut
    and h the chip thickness; milling, turning and drilling differ in the chip and the direction of the force only.
    """
    force = cutting * chip
    return force if edge is None else force + edge * length


def _forces(edge: Edge, total: list[Any], depth: Any, rubbing: Rubbing | None) -> Cut:
    """Return the forces from the sums over all slices; `depth` is the height of an edge in m per rad of its lag."""
    sine, cosine, chip, dc, ds, angle, sines, mixed, cosines = total
    tangential, radial, axial = zip(edge.cutting, edge.rubbing or (None, None, None), strict=True)
    along, across = (0.5 * sine, dc), (0.5 * cosine, ds)
    feed = edge_force(*tangential, *across) + edge_force(*radial, *along)
    normal = edge_force(*tangential, *along) - edge_force(*radial, *across)
    if rubbing is not None:
        x, y, damping = rubbing
        feed = feed + 0.5 * damping * (x * sines + y * mixed)
        normal = normal - 0.5 * damping * (x * mixed + y * cosines)
    lift, turned = edge_force(*axial, chip, angle), edge_force(*tangential, chip, angle)
    return Cut(-(depth * feed), depth * normal, depth * lift, 0.5 * edge.diameter * (depth * turned))


def _with_run_out(edge: Edge, angle: Any, steps: Sequence[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """Return the motions of the tool center since earlier teeth, with the run-out included."""
    if edge.run_out is None:
        return list(steps)
    offset, place = edge.run_out
    sine, cosine = ops.sin(angle + place), ops.cos(angle + place)
    motions: list[tuple[Any, Any]] = []
    for earlier, (x, y) in enumerate(steps, 1):
        s, c = _turned(sine, cosine, *_of_tooth(-earlier, edge.teeth))
        motions.append((x + offset * (sine - s), y + offset * (cosine - c)))
    return motions


def _turned(sine: Any, cosine: Any, s: float, c: float) -> tuple[Any, Any]:
    """Return the sine and cosine of the sum of two angles, from sine and cosine of each."""
    if s == 0.0 and c == 1.0:
        return sine, cosine
    return sine * c + cosine * s, cosine * c - sine * s


def _of_tooth(tooth: int, teeth: int) -> tuple[float, float]:
    """Return the sine and cosine of the angle between the first tooth and this tooth."""
    angle = 2.0 * ops.pi * (float(tooth % teeth) / float(teeth))
    # exact for the first tooth, which `_turned` then leaves as it is
    return (0.0, 1.0) if tooth % teeth == 0 else (float(ops.sin(angle)), float(ops.cos(angle)))
