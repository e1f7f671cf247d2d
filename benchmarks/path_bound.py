"""A lower bound of the time of a plan: on the path as it was joined, under the same limits, but for the snap.

    pip install clarabel
    python benchmarks/path_bound.py [--step 1] [--only circle ...]

On a path r(u) let z(u) = u'² and τ(u) = 1/u', so that the time is ∫ τ du.  The limits of velocity and acceleration are
linear in z and z', that of the jerk in z, z', z'' and τ:

    |r'_i|² z ≤ V_i²,   |r''_i z + r'_i z'/2| ≤ A_i,   |r'''_i z + 3/2 r''_i z' + r'_i z''/2| ≤ J_i τ

With τ = 1/√z relaxed to τ ≥ 1/√z the problem is convex, and every motion that keeps the limits is feasible: the
minimum is a lower bound of its time.  Clarabel finds it, an interior-point method with power cones, as the value of the
dual.  z is a cubic spline with knots at equal steps in time of the plan, and the limits hold at three Gauss points of
each span.  The bound is exact but for this transcription: the value for twice the step stands beside it.

Where runs overlap (corners in time) there is no one path: each run is bounded from rest to rest, and the sums are
compared.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.interpolate
import scipy.sparse as sparse

try:
    import clarabel
except ImportError:
    print("NOT RUN: pip install clarabel", file=sys.stderr)
    sys.exit()

sys.path.append(str(Path(__file__).parent))

import planner

from feeddrive.language.kernels.source import rows_for
from feeddrive.path.motion import Derivatives, Interval, Motion, Pause, Pieces, derivatives, piece_of, way
from feeddrive.path.program.moves import Move
from feeddrive.path.program.reading import read_program
from feeddrive.path.setpoints import planned

FEWEST, LEAST = 200, 50  # spans of a short run, and where the solver gets stuck
GAUSS = np.polynomial.legendre.leggauss(3)


@dataclass(frozen=True)
class Stretch:
    """Some pieces of a run and the motion on them; u at the start of each piece, and of each time interval (m)."""

    pieces: Pieces
    motion: Motion
    piece_starts: np.ndarray
    interval_starts: np.ndarray


class Run:
    """A run from rest to rest, as planned.

    overlap  s at its start during which the run before moves, too
    """

    def __init__(self) -> None:
        self.stretches = list[Stretch]()
        self.overlap = 0.0

    def add(self, pieces: Pieces, motion: Motion) -> None:
        """Append pieces, of which the first is the one on which the run has come to, and the motion on them."""
        here = self.stretches[-1].interval_starts[-1] if self.stretches else 0.0
        starts = np.concatenate([[0.0], np.cumsum(pieces.length)])[:-1]
        begin = starts[motion.piece] + motion.x
        last = Interval(*(float(each[-1]) for each in (motion.duration, *motion[2:])))
        ends = begin[-1] + way(last.speed, last.acceleration, last.jerk, last.snap, last.duration)
        shift = here - begin[0]
        self.stretches.append(Stretch(pieces, motion, starts + shift, np.append(begin, ends) + shift))

    @property
    def time(self) -> float:
        """Its time, s."""
        return float(sum(stretch.motion.duration.sum() for stretch in self.stretches))

    def at(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return u (m) and u' (m/s) of the plan at times in s."""
        begins = np.concatenate([stretch.interval_starts[:-1] for stretch in self.stretches])
        duration, v, a, j, s = (
            np.concatenate([getattr(stretch.motion, name) for stretch in self.stretches])
            for name in ("duration", "speed", "acceleration", "jerk", "snap")
        )
        clock = np.concatenate([[0.0], np.cumsum(duration)])
        k = np.clip(np.searchsorted(clock, times, side="right") - 1, 0, len(duration) - 1)
        t = times - clock[k]
        u = begins[k] + t * (v[k] + t * (a[k] / 2 + t * (j[k] / 6 + t * s[k] / 24)))
        return u, v[k] + t * (a[k] + t * (j[k] / 2 + t * s[k] / 6))

    def shape(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the first three derivatives of r, shape (n, N, 3), and the feed (m/s), at places u in m."""
        firsts = np.array([stretch.interval_starts[0] for stretch in self.stretches])
        of = np.clip(np.searchsorted(firsts, places, side="right") - 1, 0, len(firsts) - 1)
        axes = self.stretches[0].pieces.origin.shape[1]
        found, feed, row = np.empty((len(places), axes, 3)), np.empty(len(places)), rows_for(Derivatives, axes)
        for n, (place, m) in enumerate(zip(places, of, strict=True)):
            stretch = self.stretches[m]
            k = max(int(np.searchsorted(stretch.piece_starts, place, side="right")) - 1, 0)
            x = min(max(place - stretch.piece_starts[k], 0.0), float(stretch.pieces.length[k]))
            derivatives(*piece_of(stretch.pieces, k)[:2], stretch.pieces.shape[k], x, row)
            found[n], feed[n] = row[:, 1:4], stretch.pieces.feed[k]
        return found, feed


def runs(moves: Iterable[Move], limits: np.ndarray) -> tuple[list[Run], float]:
    """Plan a program; return its runs and the time that it stands still (s)."""
    found, still, run = list[Run](), 0.0, Run()
    for each in planned(moves, "XYZ", limits):
        if isinstance(each, Pause):
            still += each.duration
            continue
        run.add(each.pieces, each.motion)
        if each.entering is not None:
            found.append(run)
            run = Run()
            run.add(each.entering.pieces, each.entering.motion)
            run.overlap = run.time
        elif each.ends:
            found.append(run)
            run = Run()
    return found, still


def bound(run: Run, limits: np.ndarray, step: float, fewest: int = FEWEST) -> float:
    """Return the least time of a run (s), with spans of `step` s of the plan, longer ones if the solver is stuck."""
    step = min(step, run.time / fewest)
    first = 2.0 * step
    spans = round((run.time - 2.0 * first) / step)
    instants = np.linspace(first, run.time - first, spans + 1)
    edges, half = run.at(instants)[0], 0.5 * np.diff(instants)[:, None]
    times = (instants[:-1, None] + half * (1.0 + GAUSS[0])).ravel()
    weights = (half * GAUSS[1]).ravel()
    u, v = run.at(times)
    r, feed = run.shape(u)
    n = len(u)
    # z grows from rest as the power 4/3 of u: it begins and ends near the rests, where the least time is known
    knots = np.concatenate([np.repeat(edges[0], 3), edges, np.repeat(edges[-1], 3)])
    # unknowns: the coefficients of z, each over about its value in the plan, and τ v at the points
    sizes = sparse.diags(_sizes(run, knots))
    z, dz, ddz = (_basis(knots, u, order) @ sizes for order in range(3))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    nothing_z, nothing, tau = (
        sparse.csr_matrix((n, spans + 3)),
        sparse.csr_matrix((n, n)),
        sparse.identity(n, format="csr"),
    )
    rows, most = list[sparse.spmatrix](), list[np.ndarray]()
    with np.errstate(divide="ignore"):
        top = (feed / np.linalg.norm(r[:, :, 0], axis=1)) ** 2
        for i, (velocity, acceleration, jerk, _) in enumerate(limits):
            r1, r2, r3 = r[:, i].T
            top = np.minimum(top, (velocity / np.abs(r1)) ** 2)
            a = (sparse.diags(r2) @ z + sparse.diags(r1 / 2) @ dz) / acceleration
            j = (sparse.diags(r3) @ z + sparse.diags(1.5 * r2) @ dz + sparse.diags(r1 / 2) @ ddz) / jerk
            for sign in (1.0, -1.0):
                rows += [sparse.hstack([sign * a, nothing]), sparse.hstack([sign * sparse.diags(v) @ j, -tau])]
                most += [np.ones(n), np.zeros(n)]
    rows.append(sparse.hstack([sparse.diags(1.0 / top) @ z, nothing]))
    most.append(np.ones(n))
    rests = 0.0
    for place, sign in ((edges[0], 1.0), (edges[-1], -1.0)):
        took, most_z, most_slope = _from_rest(run, limits, float(place))
        rests += took
        for order, largest in ((0, most_z), (1, sign * most_slope)):
            there = _basis(knots, np.array([place]), order) @ sizes
            rows.append(sparse.hstack([there / largest, sparse.csr_matrix((1, n))]))
            most.append(np.ones(1))
    shares = sparse.diags(1.0 / v**2) @ z
    # τ v >= 1/√y for y = z/v²: a cone (τ v)^(2/3) y^(1/3) >= 1 for each point, its three rows in turn
    by_cone = np.arange(3 * n).reshape(3, n).T.ravel()
    cones = sparse.vstack(
        [sparse.hstack([nothing_z, tau]), sparse.hstack([shares, nothing]), sparse.csr_matrix((n, spans + 3 + n))]
    )
    limited = sparse.vstack(rows)
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix((spans + 3 + n, spans + 3 + n)),
        np.concatenate([np.zeros(spans + 3), weights]),
        sparse.vstack([limited, -cones.tocsr()[by_cone]]).tocsc(),
        np.concatenate([*most, np.concatenate([np.zeros(2 * n), np.ones(n)])[by_cone]]),
        [clarabel.NonnegativeConeT(limited.shape[0]), *[clarabel.PowerConeT(2 / 3)] * n],
        settings,
    )
    solved = solver.solve()
    if str(solved.status) == "InsufficientProgress" and fewest > LEAST:
        return bound(run, limits, 1.4 * step, fewest // 2)
    if str(solved.status) not in ("Solved", "AlmostSolved"):
        raise SystemExit(f"the bound of a run of {run.time:.4g} s was not found: {solved.status}")
    return rests + float(solved.obj_val_dual)


def _from_rest(run: Run, limits: np.ndarray, place: float) -> tuple[float, float, float]:
    """Return the least time from rest to a place u near it, and the largest z and z' there, by the jerk alone."""
    length = float(run.at(np.array([run.time]))[0][0])
    slopes = np.abs(run.shape(np.array([0.0 if place < length / 2 else length]))[0][0, :, 0])
    way = min(place, length - place)
    with np.errstate(divide="ignore"):
        jerk = float(np.min(limits[:, 2] / slopes))
    took = (6.0 * way / jerk) ** (1 / 3)
    return took, (0.5 * jerk * took**2) ** 2, 2.0 * jerk * took


def _basis(knots: np.ndarray, places: np.ndarray, order: int) -> sparse.csr_matrix:
    """Return a derivative of all cubic B-splines at places, one row a place."""
    count = len(knots) - 4
    matrix = sparse.identity(count, format="csr")
    for degree in range(3, 3 - order, -1):
        # coefficients of the derivative: degree (c_k - c_(k-1)) / (t_(k+degree) - t_k)
        gaps = knots[degree + 1 : degree + count] - knots[1:count]
        matrix = sparse.diags([-degree / gaps, degree / gaps], [0, 1], shape=(count - 1, count)) @ matrix
        knots, count = knots[1:-1], count - 1
    return (scipy.interpolate.BSpline.design_matrix(places, knots, 3 - order, extrapolate=True) @ matrix).tocsr()


def _sizes(run: Run, knots: np.ndarray) -> np.ndarray:
    """Return z of the plan in the middle of three knots each, where a coefficient of a spline has about its value."""
    u, v = run.at(np.linspace(0.0, run.time, 4 * len(knots)))
    z = np.interp((knots[1:-3] + knots[2:-2] + knots[3:-1]) / 3.0, u, v * v)
    return np.maximum(z, 1e-15 * z.max())


def programs() -> Iterator[tuple[str, list[Move]]]:
    """Yield programs by name: within 10 µm at 100 mm/s unless said."""
    head = "G21 G90 G64 P0.01 F6000\n"
    yield "circle of 20 mm", _read(f"{head}G1 X20\nG2 X20 I-20\nM2\n")
    yield "square of 40 mm", _read(f"{head}G1 X40\nY40\nX0\nY0\nM2\n")
    rings = "".join(
        f"G1 X{a - 3} Y{-a}\nG3 X{a} Y{3 - a} J3\nG1 Y{a - 3}\nG3 X{a - 3} Y{a} I-3\n"
        f"G1 X{3 - a}\nG3 X{-a} Y{a - 3} J-3\nG1 Y{3 - a}\nG3 X{3 - a} Y{-a} I3\n"
        for a in (6, 9, 12, 15)
    )
    yield "pocket of 30 mm", _read(f"{head}{rings}M2\n")
    yield "zigzag of 1 mm, 20 degrees", list(planner.moves(planner.zigzag(1e-3, 150), 1e-5, 0.1))
    yield "chords of 1 mm", list(planner.moves(planner.curve(1e-3, 150), 1e-5, 0.1))
    yield "arcs with lines", list(planner.mixed(150, 1e-5, 0.1))
    chips = Path(__file__).parents[1].parent / "shared" / "data" / "gcode" / "linuxcnc" / "3D_Chips.ngc"
    if chips.exists():
        lines = chips.read_text(encoding="utf-8").splitlines()[:600]
        yield "3D_Chips, 600 lines, 0.1 mm", _read("\n".join(["G21 G64 P0.1", *lines, "M2\n"]))
    else:
        print(f"NOT RUN, there is no {chips}: 3D_Chips", file=sys.stderr)
    for seed in (1, 2, 3):
        draw = np.random.default_rng(seed)
        ways = draw.normal(size=(120, 2)) * draw.uniform(0.2e-3, 5e-3, size=(120, 1))
        points = [(float(x), float(y)) for x, y in np.cumsum(ways, axis=0)]
        yield f"random chain, seed {seed}", list(planner.moves(iter(points), 1e-5, 0.1))


def _read(text: str) -> list[Move]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "program.ngc"
        path.write_text(text, encoding="utf-8")
        return list(read_program(path))


def main() -> None:
    """Print a row a program."""
    parser = argparse.ArgumentParser(description="a lower bound of the time of plans")
    parser.add_argument("--step", type=float, default=1.0, help="ms of the plan between knots")
    parser.add_argument("--only", nargs="*", default=[], help="programs whose names begin so")
    asked = parser.parse_args()
    print("| program | runs | plan, s | bound, s (twice the step) | plan over bound | the same, snap limit x 100 |")
    print("|---|--:|--:|--:|--:|--:|")
    loose = planner.LIMITS * [1.0, 1.0, 1.0, 100.0]
    for name, moves in programs():
        if asked.only and not name.startswith(tuple(asked.only)):
            continue
        cells = list[str]()
        for limits in (planner.LIMITS, loose):
            found, _ = runs(moves, limits)
            took = sum(run.time for run in found)
            least, coarse = (
                sum(bound(run, limits, factor * 1e-3 * asked.step) for run in found) for factor in (1.0, 2.0)
            )
            if limits is not loose:
                cells += [str(len(found)), f"{took:.4f}", f"{least:.4f} ({coarse:.4f})"]
            cells.append(f"{took / least:.3f}")
        print("|", " | ".join([name, *cells]), "|", flush=True)


if __name__ == "__main__":
    main()
