"""Evaluation of a part program on a machine: errors with program lines, form errors, motor load and cutting force.

A tool of radius R in peripheral milling generates a wall w alongside its path p (clockwise spindle rotation, M3):

    w(t) = p(t) + R n(t),   n towards the workpiece: right of the feed in down milling, left of it in up milling

A point of that wall belongs to the part if

1. no other point of the same cut removes it:   min over s of |w(t) - p(s)| >= R.  This excludes a lead-in, a lead-out
   and the corners of the path around an outer corner of the part, where the tool touches nothing.
2. it lies on the same side of the closed path as most of the wall: inside a path around the part, outside a path in a
   pocket.  This excludes a lead-in and a lead-out on the other side.

The path of a cut along a single edge encloses no area; all of it counts, since the end of the part is not known.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from feeddrive.analysis.replay import observe
from feeddrive.blocks.families import Observer
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.language import matrix
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.language.units import turning_key
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import Run, root_mean_square
from feeddrive.machining.circle_test import circle_fit, minimum_zone
from feeddrive.machining.contour import ContourError, Corner, Worst, contour_error, size, unit
from feeddrive.machining.load import MachineLoad, SpindleLoad, machine_load
from feeddrive.machining.tip_error import TipError, tip_error
from feeddrive.path.kinematics import LINEAR, Kinematics

_PARTS, _FINEST = 20_000, 2e-5  # pieces for the curvature of a path: largest number, shortest length in m
_SAME = 0.05  # relative change of the curvature from one element to another
_STRAIGHT = 1e-2  # 1/m: a smaller curvature is straight
_SHORTEST = 2e-3  # m, of an element
_TURN = 0.3  # rad: a smaller turn is no arc
_ENDS = 0.05  # of an element, excluded at both ends, where the axes settle after a corner


class Element(NamedTuple):
    """A line or an arc of the path with the form errors of the tool's motion.

    kind    "line" or "arc"
    begin, end  path length at both ends, m
    angle   angle of a line to the first axis, or the angle of an arc, rad
    radius  radius of an arc, m; 0 for a line
    form    straightness error of a line or roundness error of an arc: the width of its zone, m
    tilt    angular deviation of a line, rad, positive counter-clockwise; 0 for an arc
    size    radius error of an arc: actual radius minus that of the path, m; 0 for a line
    error   the largest contour error, m, unsigned
    line    part program line, if known
    """

    kind: str
    begin: float
    end: float
    angle: float
    radius: float
    form: float
    tilt: float
    size: float
    error: float
    line: int | None


@dataclass(frozen=True, eq=False, repr=False)
class Elements(Result):
    """The lines and arcs of a path in order, and its corners."""

    name: str
    elements: tuple[Element, ...]
    corners: tuple[Corner, ...]

    def table(self) -> Table:
        """Return a table with one row for each element, then one for each corner."""
        rows: list[list[str | float | Quantity]] = [
            [
                f"{i + 1} {element.kind}{_in_line(element.line)}",
                element.end - element.begin,
                element.angle,
                element.form,
                Quantity(element.tilt, "rad", form="4 urad")
                if element.kind == "line"
                else Quantity(element.size, "m", form="+.4g"),
                element.error,
            ]
            for i, element in enumerate(self.elements)
        ]
        rows += [
            [
                f"corner{_in_line(corner.line)}",
                "",
                corner.turn,
                "",
                Text(f"passed at {Quantity(corner.nearest, 'm')}"),
                corner.error,
            ]
            for corner in self.corners
        ]
        columns = [
            "element",
            Column("length", "m", "4 mm"),
            Column("angle", "rad", "4 deg"),
            Column("straight, round", "m"),
            "tilt, radius",
            Column("contour error", "m"),
        ]
        return Table(f"{self.name}: {len(self.elements)} elements, {len(self.corners)} corners", columns, rows)


def _in_line(line: int | None) -> str:
    return "" if line is None else f", line {line}"


def elements(contour: ContourError, *, ends: float = _ENDS) -> Elements:
    """Split the path of a two-axis contour error into lines and arcs.

    ends  fraction of each element that is excluded at each of its ends, 0 to 0.4

    An element is at least 2 mm long; an arc turns by at least 17 degrees.  Straightness and tilt are those of the
    least-squares line; roundness is that of the minimum zone for arcs of at least half a turn, otherwise about the
    center of the arc.  Raises ParameterError for more than two axes and for `ends` out of range.
    """
    if not contour.signed:
        raise ParameterError(f"elements are those of a plane path, not of {', '.join(contour.axes)}: choose two axes")
    if not 0.0 <= ends <= 0.4:
        raise ParameterError(f"ends = {Quantity(ends):6} must be >= 0 and <= 0.4")
    curve = contour.curve
    whole = float(curve.along[-1])
    marks = np.linspace(0.0, whole, min(_PARTS, max(3, int(whole / _FINEST))) + 1)
    rows = np.unique(np.searchsorted(curve.along, marks).clip(0, len(curve.along) - 1))
    node, along = curve.node[rows], curve.along[rows]
    step = np.diff(node, axis=0)
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    length = np.diff(along)
    bend = np.diff(heading) / (0.5 * (length[1:] + length[:-1]))  # at the nodes between two stretches
    change = np.abs(np.diff(bend)) > _SAME * np.maximum(np.abs(bend[1:]), np.abs(bend[:-1])) + _STRAIGHT
    cuts = np.concatenate([[0], np.flatnonzero(change) + 1, [len(bend)]])
    parts: list[Element] = []
    for first, last in pairwise(cuts.tolist()):
        begin, end = float(along[first]), float(along[last + 1])
        if end - begin < _SHORTEST:
            continue
        turn = float(heading[last] - heading[first])
        straight = abs(turn) < _STRAIGHT * (end - begin) + 1e-6
        if not straight and abs(turn) < _TURN:
            continue
        kept = ends * (end - begin)
        inside = (contour.along >= begin + kept) & (contour.along <= end - kept)
        if np.count_nonzero(inside) < 8:
            continue
        nodes = node[first : last + 2]
        place = contour.position[inside]
        # samples near both ends may belong to the neighboring lines of the program
        line = None if contour.line is None else int(np.median(contour.line[inside]))
        error = float(np.max(np.abs(contour.error[inside])))
        if straight:
            angle, form, tilt = _line(place, nodes[-1] - nodes[0])
            parts.append(Element("line", begin, end, angle, 0.0, form, tilt, 0.0, error, line))
        else:
            radius, form, size = _arc(place, nodes, abs(turn))
            parts.append(Element("arc", begin, end, turn, radius, form, 0.0, size, error, line))
    return Elements(contour.name, tuple(parts), tuple(contour.corners()))


def _line(place: np.ndarray, along: np.ndarray) -> tuple[float, float, float]:
    """Return the direction angle of a line of the path, the straightness error of the positions on it, and their tilt.

    The tilt is the angle from that line to the line fitted through the positions.
    """
    t = along / np.linalg.norm(along)
    middle = place - np.mean(place, axis=0)
    s, off = middle @ t, middle @ np.array([-t[1], t[0]])
    slope = float(s @ off / (s @ s))
    tilt = float(np.arctan(slope))
    return float(np.arctan2(t[1], t[0])), float(np.ptp(off - slope * s)) * float(np.cos(tilt)), tilt


def _arc(place: np.ndarray, nodes: np.ndarray, turn: float) -> tuple[float, float, float]:
    """Return the radius of an arc of the path, the roundness of the positions on it, and their error of radius.

    The error is the radius of the positions minus the radius of the arc: the radius of a fitted circle for at least
    half a turn, otherwise the mean distance from the center of the arc.
    """
    center, radius = circle_fit(nodes[:, 0], nodes[:, 1])
    if turn >= np.pi:
        zone = minimum_zone(place[:, 0], place[:, 1])
        return radius, zone.width, circle_fit(place[:, 0], place[:, 1])[1] - radius
    r = np.hypot(*(place - center).T)
    return radius, float(np.ptp(r)), float(np.mean(r)) - radius


_TOUCHES = 5e-3  # of the radius: rounded corners and the distance between samples
_WALL_STEP = 1e-2  # of the radius: spacing of the tool positions to which the wall is compared; distance error 5e-5 / 4
_CORNERS = 300  # vertices of the polygon that decides which points lie inside the path


def on_part(position: np.ndarray, velocity: np.ndarray, radius: float, milling: str) -> np.ndarray:
    """Return a mask of the samples of one cut, shape (n,): True where the tool generates a finished wall of the part.

    position, velocity  setpoint in the plane of the cut, m and m/s, shape (n, 2); a standstill generates no wall
    radius              tool radius, m
    milling             "up" or "down", with clockwise spindle rotation
    """
    from scipy.spatial import KDTree

    feed = unit(velocity)
    to_right = np.column_stack([feed[:, 1], -feed[:, 0]])
    wall = position + radius * (to_right if milling == "down" else -to_right)
    step = float(np.max(size(np.diff(position, axis=0)), initial=0.0))
    stride = max(1, int(_WALL_STEP * radius / step)) if step > 0.0 else 1
    nearest, _ = KDTree(position[::stride]).query(wall)
    # speed weights by path length: where the tool dwells does not decide on which side the part lies
    speed = size(velocity)
    stays = (speed > 0.0) & (nearest >= radius * (1.0 - _TOUCHES))
    inside = enclosed(wall, position)
    around = float(np.sum(speed[stays & inside])) >= float(np.sum(speed[stays & ~inside]))
    return stays & (inside if around else ~inside)


def enclosed(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    """Return True for each point that lies inside a path, closed by a straight line: the path winds around it.

    points  shape (n, 2); path  shape (m, 2)
    """
    polygon = path[:: max(1, len(path) // _CORNERS)]
    begin, end = polygon, np.roll(polygon, -1, axis=0)
    turns = np.zeros(len(points), dtype=np.int64)
    for (x0, y0), (x1, y1) in zip(begin, end, strict=True):
        # A horizontal edge is not crossed by a horizontal ray.
        if y0 == y1:
            continue
        low, high, sign = (y0, y1, 1) if y0 < y1 else (y1, y0, -1)
        # half open, so that a ray through a vertex of the polygon counts it once
        crosses = (points[:, 1] >= low) & (points[:, 1] < high)
        at = x0 + (points[crosses, 1] - y0) * (x1 - x0) / (y1 - y0)
        turns[np.flatnonzero(crosses)[at > points[crosses, 0]]] += sign
    # parity would call the overlap of lead-in and lead-out outside
    return turns != 0


_AFTER = 0.05  # s after a reversal in which its glitch appears
# Speed along the path above which an axis counts as reversing, m/s: another axis moves meanwhile.
_MOVES = 1e-3
_BEGUN = 0.2  # s: start-up of an observer, not evaluated
_LISTED = 8
_SAME_PLACE = 3e-3  # m of path: places that lie closer are one


class AxisRun(NamedTuple):
    """The figures of one axis under a part program, in SI units (rad for a rotary axis); `line` and `time` are those
    of the largest following error.

    following_rms, following_peak  RMS and peak of the following error over all samples, m
    glitch, glitches               the largest contour error in the 50 ms after a reversal, m; the number of reversals
    """

    following_rms: float
    following_peak: float
    line: int
    time: float
    glitch: float
    glitches: int


class Estimated(NamedTuple):
    """The accuracy of a disturbance observer on an axis, compared with the true disturbance.

    The true disturbance is that of `disturbance_of` without the viscous friction in the observer's own model.

    error, true  RMS of the estimation error, with the lag of the estimate compensated, and RMS of the true
                 disturbance without its mean, N
    slow         RMS of the error averaged over a turn of the spindle, N; None if there is no spindle
    lag          time by which the estimate lags the true disturbance, s
    disturbance  the estimate, N, shape (n,)
    """

    error: float
    true: float
    slow: float | None
    lag: float
    disturbance: np.ndarray


@dataclass(frozen=True, eq=False, repr=False)
class PartRun(Result):
    """The result of a controller under a part program.

    contour    contour error of all moving axes, or of the tip of the tool on a five-axis machine; it includes only
               samples at which the tool generates a finished wall of the part (`on_part`) or moves at a feed rate
    axes       figures by axis
    load       load of the motors, and of the spindle if there is a cut
    cutting    cutting force on those of the axes x, y and z that the machine has, N, shape (n, N); None if there is no
               cut
    estimates  accuracy of the observers, by observer and axis
    disturbances  true disturbance of the axes with observers, by axis, N
    tip        error of the tip and of the direction of the tool on a five-axis machine, otherwise None
    """

    name: str
    contour: ContourError
    axes: Mapping[str, AxisRun]
    load: MachineLoad
    cutting: np.ndarray | None
    estimates: Mapping[str, Mapping[str, Estimated]]
    disturbances: Mapping[str, np.ndarray]
    tip: TipError | None = None

    def worst(self, count: int = _LISTED) -> list[Worst]:
        """Return the largest contour errors of the included samples, at least a few millimeters of path apart."""
        return self.contour.worst(count, apart=max(_SAME_PLACE, 2e-3 * float(self.contour.along[-1])))

    @property
    def cutting_rms(self) -> float | None:
        """The RMS of the resultant cutting force on all axes during the cut, N, or None if there is no cut."""
        if self.cutting is None or not np.any(self.contour.counted):
            return None
        return root_mean_square(np.linalg.norm(self.cutting[self.contour.counted], axis=1))

    def turns(self, axis: str) -> bool:
        """Return True for a rotary joint of a five-axis machine, whose figures are in rad and N m."""
        return self.tip is not None and self.load.axes[axis].turning

    def error_of(self, axis: str, size: float, digits: str = "4") -> Quantity:
        """Return an error of an axis with its unit."""
        if self.turns(axis):
            return Quantity(size, "rad", form=f"{digits} urad", stays=True)
        return Quantity(size, "m", form=digits)

    def force_of(self, axis: str, size: float, digits: str = "4") -> Quantity:
        """Return a force or torque of an axis with its unit."""
        return Quantity(size, "N m" if self.turns(axis) else "N", form=digits, stays=self.turns(axis))

    @property
    def duty(self) -> float | None:
        """The largest ratio of RMS force to continuous force of any axis; None if no continuous force is stated."""
        shares = [axis.of_continuous for axis in self.load.axes.values() if axis.of_continuous is not None]
        return max(shares, default=None)

    def numbers(self) -> dict[str, float | None]:
        """Return all figures by name, in SI units."""
        figures: dict[str, float | None] = {
            "contour_error_rms_m": self.contour.rms,
            "contour_error_95_percent_m": self.contour.within(),
            "contour_error_peak_m": self.contour.largest,
        }
        figures |= {} if self.tip is None else self.tip.numbers()
        for axis, axis_run in self.axes.items():
            key = turning_key if self.turns(axis) else str
            figures |= {
                key(f"{axis}.following_error_rms_m"): axis_run.following_rms,
                key(f"{axis}.following_error_peak_m"): axis_run.following_peak,
                f"{axis}.following_error_peak_line": float(axis_run.line),
                f"{axis}.reversals": float(axis_run.glitches),
                f"{axis}.reversal_glitch_m": axis_run.glitch,
            }
        for axis, motor in self.load.axes.items():
            key = turning_key if self.turns(axis) else str
            figures |= {
                key(f"{axis}.drive_force_rms_N"): motor.rms,
                key(f"{axis}.drive_force_peak_N"): motor.peak,
                f"{axis}.force_rms_of_continuous": motor.of_continuous,
                f"{axis}.force_peak_of_peak": motor.of_peak,
                f"{axis}.work_J": motor.work,
                f"{axis}.drawn_without_recovery_J": motor.drawn,
            }
        figures["energy_J"] = self.load.energy()
        figures["energy_without_recovery_J"] = self.load.energy(recovers=False)
        if self.load.spindle is not None:
            figures["spindle_power_mean_W"] = self.load.spindle.power
            figures["spindle_power_peak_W"] = self.load.spindle.peak
            figures["spindle_energy_J"] = self.load.spindle.energy
            figures["chip_volume_m3"] = self.load.spindle.volume
            figures["specific_energy_J_per_m3"] = self.load.spindle.specific_energy
        if self.cutting is not None:
            figures["cutting_force_rms_N"] = self.cutting_rms
            figures["cutting_force_peak_N"] = float(np.max(np.linalg.norm(self.cutting, axis=1)))
        for observer, axes in self.estimates.items():
            for axis, estimate in axes.items():
                figures[f"{axis}.{observer}.disturbance_error_rms_N"] = estimate.error
                figures[f"{axis}.{observer}.disturbance_error_over_a_turn_rms_N"] = estimate.slow
                figures[f"{axis}.disturbance_deviation_N"] = estimate.true
        return figures

    def table(self) -> Table:
        """Return a table with one row for each axis."""
        title = Text(
            f"{self.name}: contour error {Quantity(self.contour.largest, 'm')} at most, "
            f"{Quantity(self.contour.rms, 'm')} RMS, {Quantity(self.contour.within(), 'm')} on 95 % of the path that "
            "counts"
        )
        columns = [
            "axis",
            "following RMS",
            "peak",
            "in line",
            "force RMS",
            "peak",
            Column("reversal", "m"),
        ]
        rows = [
            [
                name,
                *(self.error_of(name, size) for size in (axis.following_rms, axis.following_peak)),
                axis.line,
                *(self.force_of(name, size) for size in (motor.rms, motor.peak)),
                axis.glitch if axis.glitches else None,
            ]
            for name, axis, motor in ((name, axis, self.load.axes[name]) for name, axis in self.axes.items())
        ]
        return Table(title, columns, rows)


def part_run(
    run: Run,
    machine: Machine,
    axes: Iterable[str],
    line: np.ndarray,
    *,
    counted: np.ndarray | None = None,
    cuts: bool = False,
    turn: float | None = None,
    spindle: SpindleLoad | None = None,
    observers: Mapping[str, Mapping[str, Observer]] | None = None,
    kinematics: Kinematics | None = None,
) -> PartRun:
    """Evaluate a run of a machine along a part program.

    run        run of the machine, with all signals
    machine    the machine that was simulated
    axes       axes that the program moves
    line       program line of each sample, shape (n,); the run may be longer
    counted    True for samples that are included in the contour error, shape (n,); default: all
    cuts       True if cutting is simulated; `load_force` is then the cutting force
    turn       longest duration of a spindle turn, s; None if there is no spindle
    spindle    load of the spindle, if known
    observers  observers by name and axis, applied to the readings and forces of the run by `observe`
    kinematics  of a five-axis machine with its tool, all of whose joints the program moves: the contour error is then
               that of the tip of the tool in the frame of the workpiece

    Raises ParameterError for lines that do not match the run, and the errors of `contour_error`.
    """
    names, loops = tuple(axes), machine.loops()
    n = min(run.samples, len(line))
    if abs(run.samples - len(line)) > 2:
        raise ParameterError(f"the run has {run.samples} samples, the program {len(line)}: they do not belong together")
    lines = np.append(line[:n], np.full(run.samples - n, line[n - 1]))
    mask = np.ones(run.samples, bool) if counted is None else np.append(counted[:n], np.zeros(run.samples - n, bool))
    tip = None
    if kinematics is not None:
        by_letter = {name.upper(): name for name in names}
        joints = [by_letter[letter] for letter in kinematics.letters]
        tip = tip_error(run, kinematics, joints, line=lines, counted=mask)
    contour = contour_error(run, axes=names, line=lines, counted=mask) if tip is None else tip.contour
    speed = np.sqrt(sum(run[f"{axis}.set_velocity"] ** 2 for axis in names))
    by_axis = {axis: _axis(run, axis, lines, contour, speed) for axis in names}
    linear = names if tip is None else [name for name in names if name.upper() in LINEAR]
    cutting = np.column_stack([run[f"{axis}.load_force"] for axis in linear]) if cuts else None
    heard = {axis for by in (observers or {}).values() for axis in by if axis in names}
    true = {axis: disturbance_of(run, loops[axis], axis) for axis in names if axis in heard}
    estimates = {
        name: {
            axis: _estimated(run, axis, observer, true[axis], turn) for axis, observer in by.items() if axis in names
        }
        for name, by in (observers or {}).items()
    }
    acting = {axis: disturbance.astype(np.float32) for axis, disturbance in true.items()}
    load = machine_load(run, machine, spindle=spindle)
    return PartRun(run.name, contour, by_axis, load, cutting, estimates, acting, tip)


def _axis(run: Run, axis: str, line: np.ndarray, contour: ContourError, speed: np.ndarray) -> AxisRun:
    error = run[f"{axis}.following_error"]
    worst = int(np.argmax(np.abs(error)))
    velocity = run[f"{axis}.set_velocity"]
    turns = np.flatnonzero((np.sign(velocity[1:]) * np.sign(velocity[:-1]) <= 0.0) & (velocity[:-1] != 0.0))
    turns = turns[(speed[turns] > _MOVES) & contour.counted[turns]]
    after = max(1, round(_AFTER / run.sample_time))
    heights = [float(np.max(np.abs(contour.error[i : i + after]))) for i in turns]
    return AxisRun(
        root_mean_square(error),
        float(np.abs(error[worst])),
        int(line[worst]),
        float(run.time[worst]),
        max(heights, default=0.0),
        len(heights),
    )


def _estimated(run: Run, axis: str, observer: Observer, true: np.ndarray, turn: float | None) -> Estimated:
    """Compare an observer with the true disturbance in the same run."""
    encoder = getattr(observer, "encoder", "load")
    T, before = run.sample_time, float(run[f"{axis}.force"][0])
    seen = observe(observer, run[f"{axis}.reading_{encoder}"], run[f"{axis}.force"], T, before=before)
    late, skip = round(seen.lag / T), round(_BEGUN / T)
    # viscous friction that the observer's own model holds is none of its disturbance
    true = true + float(getattr(observer, "viscous", 0.0)) * run[f"{axis}.velocity_load"]
    off = (seen.disturbance[late:] - true[: len(true) - late])[skip:]
    slow = None
    if turn is not None:
        width = max(1, round(turn / T))
        total = np.cumsum(np.insert(off, 0, 0.0))
        slow = root_mean_square((total[width:] - total[:-width]) / width)
    estimate = seen.disturbance.astype(np.float32)
    return Estimated(root_mean_square(off), float(np.std(true[skip:])), slow, seen.lag, estimate)


def disturbance_of(run: Run, loop: Loop, axis: str) -> np.ndarray:
    """Return the true disturbance of an axis in each sample, N, shape (n,): cut, weight, dry and viscous friction."""
    mechanics = loop.axis.mechanics()
    # Only the damping of rigid motion disturbs the axis; that between its bodies belongs to a mode.
    along = mechanics.rigid_motion()
    viscous = float(matrix.dot([matrix.dot(row, along) for row in mechanics.damping], along))
    weight = sum(float(force.force) for force in loop.axis.forces if isinstance(force, Gravity))
    dry = run[f"{axis}.friction_motor"] + run[f"{axis}.friction_load"]
    return run[f"{axis}.load_force"] + weight + dry - viscous * run[f"{axis}.velocity_load"]
