"""The cut of a finished run: forces along feed, normal and spindle, torque and power of the spindle, machined surface.

The surface of an end mill is the envelope of its edges under the actual motion of the axes, with feed marks.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.signals import Motion
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import UNIT, Cell, Column, Result, Table
from feeddrive.loop.simulate import Run
from feeddrive.loop.stepped import stepped


@dataclass(frozen=True, eq=False, repr=False)
class CuttingForces(Result):
    """The forces of the workpiece on the tool over a run, averaged over each sample; all arrays of shape (n,).

    time                 start of each sample, s
    feed, normal, axial  forces in N along the feed, along the cross product of spindle axis and feed, and along the
                         spindle
    torque, power        spindle torque and power, N m and W
    spindle_speed        spindle speed, rpm
    angle                unwrapped spindle angle in the middle of the sample, rad
    along, across        components of the direction of the feed in x and y
    """

    time: np.ndarray
    feed: np.ndarray
    normal: np.ndarray
    axial: np.ndarray
    torque: np.ndarray
    spindle_speed: np.ndarray
    angle: np.ndarray
    along: np.ndarray
    across: np.ndarray

    @property
    def power(self) -> np.ndarray:
        """The spindle power, torque times angular velocity, W."""
        return self.torque * self.spindle_speed * (np.pi / 30.0)

    @property
    def resultant(self) -> np.ndarray:
        """The resultant force in the plane normal to the spindle, N."""
        return np.hypot(self.feed, self.normal)

    def table(self) -> Table:
        """Return a table of mean and peak values while the tool cuts."""
        cuts = self.torque != 0.0
        rows: list[list[Cell]] = []
        units = {"feed": "N", "normal": "N", "axial": "N", "resultant": "N", "torque": "N m", "power": "W"}
        for name, unit in units.items():
            values = getattr(self, name)[cuts]
            mean, peak = (float(np.mean(values)), float(np.max(np.abs(values)))) if values.size else (0.0, 0.0)
            rows.append([name, UNIT, Quantity(mean, unit), Quantity(peak, unit)])
        share = Quantity(float(np.mean(cuts)) if cuts.size else 0.0, "share")
        title = f"force on the tool, which cuts in {share:3} of the samples"
        return Table(title, ["", "unit", "mean", "peak"], rows)


def cutting_forces(run: Run, cut: MillingCut) -> CuttingForces:
    """Compute the cutting forces of a run from the motion of its axes, with the same model as in the run.

    If the run has one substep per sample, the result is exactly the force in the run; otherwise it is the force that
    one substep per sample would give.
    Raises ParameterError for a run that does not begin at 0 s or without the positions and velocities of x and y.
    """
    # Regeneration depends on all earlier surfaces, so the forces cannot start in the middle of a cut.
    if run.first:
        raise ParameterError(
            f"the run begins at sample {run.first}: what the tool cut before is not known; give the whole run"
        )
    names = {f"{axis}.{what}" for axis in (cut.along_x, cut.along_y) for what in ("position_load", "velocity_load")}
    missing = sorted(names - set(run.signals))
    if missing:
        raise ParameterError(f"the run has no {', '.join(missing)}: record these for the cutting force")
    first = {name: np.float64(run[name][0]) for name in names}
    signals = {name: run[name] for name in sorted(names)}
    results = stepped(cut, lambda plain: plain.start(None, _motions(cut, first, 0.0)), _step, signals, run.sample_time)
    middle = run.time + 0.5 * run.sample_time
    acts = middle >= cut.cut_from
    if cut.cut_to is not None:
        acts &= middle < cut.cut_to
    forces = {name: np.where(acts, results[name], 0.0) for name in ("feed", "normal", "axial", "torque")}
    speed = _speed(cut, middle)
    # at mid-sample, where the block evaluates the forces
    turns = (
        np.concatenate([[0.0], np.cumsum(speed[:-1] * (run.sample_time / 60.0))]) + 0.5 * speed * run.sample_time / 60.0
    )
    return CuttingForces(
        run.time,
        **forces,
        spindle_speed=speed,
        angle=cut.start_angle + 2.0 * np.pi * turns,
        along=results["along"],
        across=results["across"],
    )


def _motions(cut: MillingCut, signals: Any, ahead: Any) -> dict[str, Motion]:
    """Return the motions of the axes, extrapolated by a time in s."""
    motions: dict[str, Motion] = {}
    for axis in (cut.along_x, cut.along_y):
        x, v = signals[f"{axis}.position_load"], signals[f"{axis}.velocity_load"]
        motions[axis] = Motion(x, x + ahead * v, v, v)
    return motions


def _speed(cut: MillingCut, time: np.ndarray) -> np.ndarray:
    rows = {} if cut.sections is None else cut.sections.rows()
    if "spindle_speed" not in rows:
        return np.full(time.shape, float(cut.spindle_speed))
    section = np.clip(np.searchsorted(rows["start"], time, side="right") - 1, 0, None)
    return np.asarray(rows["spindle_speed"])[section]


def _step(cut: Any, state: Any, signals: Mapping[str, Any], sample: Any, T: Any) -> tuple[Any, dict[str, Any]]:
    """Return the state of the cut after a sample, its forces, and the direction of the feed."""
    time = sample * T + 0.5 * T
    state, (along, across), forces = cut.forces(state, _motions(cut, signals, 0.5 * T), time, T)
    return state, {**forces._asdict(), "along": along, "across": across}


_SAG = 1e-9  # m between two angles of an edge
_WIDE = 6.0  # feeds of a tooth beside the middle of its mark that it is followed
SIDES = ("up", "down")


@dataclass(frozen=True, eq=False, repr=False)
class Surface(Result):
    """A patch of a machined wall: its height above the nominal surface, positive where material is left.

    along    position along the feed, m, shape (n,)
    heights  height above the tip of the tool, m, shape (k,)
    map      height above the nominal surface, m, shape (k, n)
    feed     mean feed per tooth over the patch, m; `mark` is the theoretical height of its marks, m
    """

    along: np.ndarray
    heights: np.ndarray
    map: np.ndarray
    feed: float
    mark: float

    @property
    def roughness(self) -> tuple[float, float]:
        """The roughness Ra and Rz of the whole patch, m: mean absolute deviation, and peak-to-valley height."""
        off = self.map - np.mean(self.map)
        return float(np.mean(np.abs(off))), float(np.ptp(self.map))

    def table(self) -> Table:
        """Return a table of roughness, mean height and the theoretical height of the feed mark."""
        ra, rz = self.roughness
        columns = ["", *(Column(head, "m") for head in ("Ra", "Rz", "mean", "feed mark"))]
        return Table("wall that the edges leave", columns, [["patch", ra, rz, float(np.mean(self.map)), self.mark]])


def feed_mark(radius: float, feed: float, teeth: int, milling: str) -> float:
    """Return the height in m of the marks of equal teeth along a straight feed: c²/(8R (1 ± cN/2πR)²), + in up milling.

    radius, feed  tool radius R and feed per tooth c, m; `teeth` is the number N of teeth
    Source: Martellotti 1941, to second order.
    """
    _side(milling)
    sign = 1.0 if milling == "up" else -1.0
    return feed**2 / (8.0 * radius * (1.0 + sign * feed * teeth / (2.0 * np.pi * radius)) ** 2)


def runout_mark(radius: float, feed: float, difference: float) -> float:
    """Return the height in m of the marks of two teeth whose radii R differ by Δ: (R/2)(Δ/c + c/2R)², c feed per tooth.

    The tooth paths are approximated by circles.  For Δ >= c²/2R only one tooth leaves marks, as with twice the feed per
    tooth; a difference of 1 µm is often enough for that.
    """
    if difference >= feed**2 / (2.0 * radius):
        return (2.0 * feed) ** 2 / (8.0 * radius)
    return 0.5 * radius * (difference / feed + feed / (2.0 * radius)) ** 2


def scallop(radius: float, step: float) -> float:
    """Return the scallop height R - √(R² - s²/4) in m of a ball end mill of radius R for passes spaced s = `step`
    apart.
    """
    return radius - float(np.sqrt(radius**2 - 0.25 * step**2))


def wall(
    run: Run,
    cut: MillingCut,
    begin: float,
    end: float,
    milling: str,
    *,
    points: int = 400,
    levels: int = 1,
    axial_depth: float | None = None,
) -> Surface:
    """Compute the finished wall that a run generates between two instants, while the feed follows a straight line.

    On each line across the wall, the deepest edge determines the height. At the height z, edge j of N has the angle v =
    angle + 2πj/N - k z, where k is the lag angle per height of a helical edge. It generates the wall near v = 0 in up
    milling and near π in down milling, so that the vibration at that instant is imprinted on the wall.

    begin, end     instants in s; the feed is the straight line between the set positions at these instants
    milling        "up" or "down"
    points, levels number of points along the feed and along the spindle; a single level is at the tool tip
    axial_depth    axial depth of the section, m; default: that of the cutter

    Between samples the motion is a cubic Hermite interpolant of positions and velocities; the path of an edge is a
    polyline with a sagitta of 1 nm, and its crossings are interpolated.  Run-out is neglected.
    Raises ParameterError for instants outside the run, a standstill of the feed, or an unknown kind of milling.
    """
    from scipy.interpolate import CubicHermiteSpline

    _side(milling)
    if not run.time[0] <= begin < end <= run.time[-1]:
        raise ParameterError(
            f"a wall is made between two instants of the run, {Quantity(run.time[0]):6} to "
            f"{Quantity(run.time[-1], 's'):6 SI}"
        )
    axes = (cut.along_x, cut.along_y)
    sign = 1.0 if cut.moves == "tool" else -1.0
    place, speed, meant = (
        sign * np.column_stack([run[f"{axis}.{signal}"] for axis in axes])
        for signal in ("position_load", "velocity_load", "set_position")
    )
    rows = np.searchsorted(run.time, (begin, end))
    origin, way = meant[rows[0]], meant[rows[1]] - meant[rows[0]]
    length = float(np.hypot(*way))
    edge = cut.cutter.edge()
    turned, rpm = float(cut.start_angle), float(cut.spindle_speed)
    if cut.sections is not None:
        # The spindle may have had other speeds before: its angle is integrated over the sections.
        seen = cutting_forces(run, cut)
        rpm = float(seen.spindle_speed[rows[0]])
        turned = float(seen.angle[rows[0]]) - 2.0 * np.pi * rpm / 60.0 * (run.time[rows[0]] + 0.5 * run.sample_time)
    turn = 2.0 * np.pi * rpm / 60.0
    feed = length / (end - begin) * 2.0 * np.pi / (turn * edge.teeth)
    if feed < 1e-9:
        raise ParameterError("the tool stands between these instants: a wall needs a feed")
    t = way / length
    n = np.array([-t[1], t[0]])
    path = CubicHermiteSpline(run.time, (place - origin) @ np.column_stack([t, n]), speed @ np.column_stack([t, n]))
    radius, depth = 0.5 * float(edge.diameter), float(edge.axial_depth if axial_depth is None else axial_depth)
    # whole marks only: away from both ends, where teeth before and after are missing
    along = np.linspace(4.0 * feed, length - 4.0 * feed, points)
    if along[-1] <= along[0]:
        raise ParameterError(f"between these instants {Quantity(length / feed):3} teeth pass: a wall needs 8 or more")
    heights = np.linspace(0.0, depth, levels) if levels > 1 else np.zeros(1)
    lag = 2.0 * np.tan(float(edge.helix_angle)) / float(edge.diameter)
    middle, outward = (0.0, 1.0) if milling == "up" else (np.pi, -1.0)
    half = _WIDE * feed / radius
    # a chord over the angle a of a circle of radius R has the sagitta R a²/8
    walk = np.linspace(-half, half, 2 * int(np.ceil(half / np.sqrt(8.0 * _SAG / radius))) + 1)
    envelope = np.full((levels, points), -np.inf)
    for level, z in enumerate(heights):
        for tooth in range(edge.teeth):
            offset = middle - 2.0 * np.pi * tooth / edge.teeth + lag * z - turned
            first, last = (int(np.ceil((turn * instant - offset) / (2.0 * np.pi))) for instant in (begin, end))
            for pass_ in range(first, last):
                instants = (offset + 2.0 * np.pi * pass_ + walk) / turn
                if instants[0] < begin or instants[-1] > end:
                    continue
                at = path(instants)
                s, w = at[:, 0] + radius * np.sin(middle + walk), at[:, 1] + radius * np.cos(middle + walk)
                # in down milling the edge runs against the feed, and interpolation needs ascending places
                if s[0] > s[-1]:
                    s, w = s[::-1], w[::-1]
                reached = np.interp(along, s, outward * w - radius, left=-np.inf, right=-np.inf)
                envelope[level] = np.maximum(envelope[level], reached)
    return Surface(along, heights, -envelope, feed, feed_mark(radius, feed, edge.teeth, milling))


def _side(milling: str) -> None:
    if milling not in SIDES:
        raise ParameterError(f"milling = {milling!r} must be up or down: a slot has a wall of either kind")
