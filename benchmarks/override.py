"""A feed override: the cycle time at 100 %, and each hold's time to standstill beside that of the quickest stop.

    python benchmarks/override.py [--holds 40] [--seed 29] [--chips 3D_Chips.ngc]

The quickest stop is found by direct transcription, with finer spans than those of the planner and without its
reserve: u'''' is constant on each of 40 spans of a time T; the smallest T at which u' .. u''' can be brought from
their values at the hold to 0, with velocity to snap of each axis within the limits at the ends of all spans, is found by bisection.  A
try is a sequence of linear programs about the last motion.  Limits are kept at these points only, so that T is a little
below the quickest time.
"""

from __future__ import annotations

import argparse
import itertools
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from planner import LIMITS, curve, mixed, moves, zigzag
from scipy.optimize import linprog

from feeddrive.path.motion import Part, Pause, Pieces, derivatives, one_after_the_other, part_of_pieces, piece_of, way
from feeddrive.path.program.moves import Move
from feeddrive.path.program.reading import read_program
from feeddrive.path.proof import Prover
from feeddrive.path.schedule.override import Override, override
from feeddrive.path.setpoints import planned

SPANS, TRIES, HALVINGS, FEASIBLE = 40, 5, 6, 1.003


def lasts(part: Part | Pause) -> float:
    return float(np.sum(part.motion.duration)) if isinstance(part, Part) else part.duration


def proven(given: Sequence[Move], factor: Override | None) -> tuple[list[Part | Pause], float]:
    """Plan and prove; return the parts and the cycle time, s."""
    prover = Prover(LIMITS)
    parts = list(planned(given, "XYZ", LIMITS, factor))
    for each in parts:
        if isinstance(each, Part):
            prover.prove(each)
    if prover.proof().count:
        raise SystemExit(f"not proven: {prover.proof().faults[0]}")
    return parts, sum(map(lasts, parts))


def state_at(parts: Sequence[Part | Pause], at: float) -> tuple[Pieces, np.ndarray] | None:
    """Return the rest of the run from a time on and u .. u''' there, or None at rest or within a corner in time."""
    for k, part in enumerate(parts):
        if at >= lasts(part):
            at -= lasts(part)
            continue
        if isinstance(part, Pause) or part.entering is not None:
            return None
        begins = np.cumsum(part.motion.duration) - part.motion.duration
        m = int(np.searchsorted(begins, at, side="right")) - 1
        t, (v, a, j, s) = at - begins[m], (float(column[m]) for column in part.motion[3:])
        p = int(part.motion.piece[m])
        ahead = [part_of_pieces(part.pieces, p, len(part.pieces.length))]
        for later in itertools.takewhile(lambda each: isinstance(each, Part), parts[k + 1 :]):
            if part.ends:
                break
            assert isinstance(later, Part)
            ahead.append(part_of_pieces(later.pieces, 1, len(later.pieces.length)))
            part = later
        u = float(part.motion.x[m]) if not ahead else float(parts[k].motion.x[m])  # type: ignore[union-attr]
        state = [u + way(v, a, j, s, t), v + t * (a + t * (j / 2 + t * s / 6)), a + t * (j + t * s / 2), j + t * s]
        return one_after_the_other(ahead), np.array(state)
    return None


def along(pieces: Pieces, u: np.ndarray) -> np.ndarray:
    """Derivatives of the path at u, shape (n, N, 5)."""
    ends = np.cumsum(pieces.length)
    out, row = np.zeros((len(u), pieces.origin.shape[1], 5)), np.zeros((pieces.origin.shape[1], 5))
    for k, each in enumerate(u):
        p = min(int(np.searchsorted(ends, each)), len(ends) - 1)
        x = min(max(each - (ends[p] - pieces.length[p]), 0.0), float(pieces.length[p]))
        derivatives(*piece_of(pieces, p), x, row)
        out[k] = row
    return out


class Stop:
    """Stops in a time T from a state along pieces: all of u .. u''' at the ends of spans are linear in the snaps."""

    def __init__(self, pieces: Pieces, state: np.ndarray, T: float) -> None:
        h, n = T / SPANS, SPANS
        self.pieces = pieces
        step = np.array([[1, h, h * h / 2, h**3 / 6], [0, 1, h, h * h / 2], [0, 0, 1, h], [0, 0, 0, 1]])
        snap = np.array([h**4 / 24, h**3 / 6, h * h / 2, h])
        self.constant, self.slope = np.zeros((n + 1, 4)), np.zeros((n + 1, 4, n))
        self.constant[0] = state
        for k in range(n):
            self.constant[k + 1] = step @ self.constant[k]
            self.slope[k + 1] = step @ self.slope[k]
            self.slope[k + 1, :, k] += snap

    def shares(self, snaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the use of each limit at both ends of each span, and its slopes by the snaps."""
        states = self.constant + self.slope @ snaps
        values, slopes = [], []
        n = SPANS
        rows = np.concatenate([np.arange(n), np.arange(1, n + 1)])
        spans = np.concatenate([np.arange(n), np.arange(n)])
        r = along(self.pieces, states[:, 0])[rows]
        v, a, j = (each[:, None] for each in states[rows].T[1:])
        s = snaps[spans][:, None]
        r1, r2, r3, r4 = (r[:, :, k] for k in range(1, 5))
        du, dv, da, dj = (self.slope[rows, k][:, None, :] for k in range(4))
        ds = np.eye(n)[spans][:, None, :]

        def add(value: np.ndarray, limit: np.ndarray, *parts: tuple[np.ndarray, np.ndarray]) -> None:
            values.append((value / limit).ravel())
            slopes.append(
                (sum(factor[:, :, None] * each for factor, each in parts) / limit[None, :, None]).reshape(-1, n)
            )

        V, A, J, S = LIMITS.T
        add(r1 * v, V, (r2 * v, du), (r1, dv))
        add(r2 * v * v + r1 * a, A, (r3 * v * v + r2 * a, du), (2 * r2 * v, dv), (r1, da))
        add(
            r3 * v**3 + 3 * r2 * v * a + r1 * j,
            J,
            (r4 * v**3 + 3 * r3 * v * a + r2 * j, du),
            (3 * r3 * v * v + 3 * r2 * a, dv),
            (3 * r2 * v, da),
            (r1, dj),
        )
        add(
            r4 * v**4 + 6 * r3 * v * v * a + r2 * (3 * a * a + 4 * v * j) + r1 * s,
            S,
            (6 * r4 * v * v * a + r3 * (3 * a * a + 4 * v * j) + r2 * s, du),
            (4 * r4 * v**3 + 12 * r3 * v * a + 4 * r2 * j, dv),
            (6 * r3 * v * v + 6 * r2 * a, da),
            (4 * r2 * v, dj),
            (r1, ds),
        )
        return np.concatenate(values), np.concatenate(slopes)

    def possible(self) -> bool:
        """True if the linear programs come to a stop within the limits."""
        n, top = SPANS, float(LIMITS[:, 3].max()) * 1.8
        snaps = np.zeros(n)
        # any stop to begin with: the one of least squares
        equal = self.slope[-1, 1:]
        snaps = np.linalg.lstsq(equal, -self.constant[-1, 1:], rcond=None)[0]
        scale = np.max(np.abs(equal), axis=1)
        way_left = float(np.sum(self.pieces.length))
        for k in range(TRIES):
            values, slopes = self.shares(snaps)
            change = slopes * top
            offset = values - slopes @ snaps
            backward = -self.slope[:, 1] * top
            beyond = self.slope[-1:, 0] * top / way_left
            rows = np.vstack(
                [
                    np.column_stack([change, -np.ones(len(values))]),
                    np.column_stack([-change, -np.ones(len(values))]),
                    np.column_stack([backward, np.zeros(n + 1)]),
                    np.column_stack([beyond, np.zeros(1)]),
                ]
            )
            right = np.concatenate([-offset, offset, self.constant[:, 1], [1.0 - self.constant[-1, 0] / way_left]])
            trust = 2.0 if k == 0 else 1.0 * 0.6**k
            now = snaps / top
            found = linprog(
                np.append(np.zeros(n), 1.0),
                rows,
                right,
                np.column_stack([equal * top / (scale[:, None] * top), np.zeros(3)]),
                -self.constant[-1, 1:] / (scale * top),
                [*((max(-1.0, x - trust), min(1.0, x + trust)) for x in np.clip(now, -1, 1)), (0.0, None)],
            )
            if found.x is None:
                return False
            snaps = found.x[:n] * top
            if found.x[n] > 1.3 and k:
                return False
            if float(np.max(np.abs(self.shares(snaps)[0]))) <= FEASIBLE:
                return True
        return False


def quickest(pieces: Pieces, state: np.ndarray, at_most: float) -> float:
    """Return the time of the quickest stop, s, or infinity if none is found that is as quick as `at_most`."""
    low, high = 0.5 * at_most, at_most * 1.02
    if not Stop(pieces, state, high).possible():
        return np.inf
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if Stop(pieces, state, middle).possible():
            high = middle
        else:
            low = middle
    return high


def holds(name: str, given: Sequence[Move], parts: Sequence[Part | Pause], times: np.ndarray) -> None:
    """A row: time to standstill over that of the quickest stop, and of those in corners in time."""
    ratios, inside, spent, unknown = list[float](), list[float](), 0.0, 0
    for begin in times.tolist():
        now, took = 0.0, time.process_time()
        stands = None
        for each in planned(given, "XYZ", LIMITS, override([(begin, 0.0), (begin + 3.0, 1.0)])):
            if isinstance(each, Pause) and each.why == "Hold":
                stands = now
                break
            now += lasts(each)
        spent += time.process_time() - took
        found = state_at(parts, begin)
        if stands is None or stands <= begin + 1e-9:
            continue
        if found is None:
            inside.append(stands - begin)
            continue
        pieces, state = found
        least = quickest(pieces, state, stands - begin)
        if not np.isfinite(least):
            unknown += 1
            continue
        ratios.append((stands - begin) / least)
        if ratios[-1] > 1.1:
            print(f"   {name}: hold at {begin:.6f} s stands after {stands - begin:.5f} s, quickest {least:.5f} s")
    q = np.quantile(ratios, [0.5, 0.95, 1.0]) if ratios else [np.nan] * 3
    most = f"{1e3 * max(inside):.0f} ms" if inside else "-"
    print(
        f"| {name} | {len(ratios)} | {q[0]:.3f} | {q[1]:.3f} | {q[2]:.3f} | {len(inside)} | {most} | {unknown} | "
        f"{spent:.1f} s |",
        flush=True,
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--holds", type=int, default=40)
    parser.add_argument("--seed", type=int, default=29)
    parser.add_argument("--chips", type=Path)
    parser.add_argument("--only", default="")
    asked = parser.parse_args()
    programs: dict[str, list[Move]] = {
        "arcs of 2 to 6 mm and lines": list(mixed(150, 1e-5, 0.05)),
        "the same, 150 mm/s": list(mixed(150, 1e-4, 0.15)),
        "chords of 1 mm": list(moves(curve(1e-3, 300), 1e-5, 0.1)),
        "chords of 1 mm, 400 mm/s": list(moves(curve(1e-3, 600), 1e-4, 0.4)),
        "zigzag of 20 degrees, 5 mm": list(moves(zigzag(5e-3, 40), 1e-5, 0.1)),
    }
    if asked.chips:
        lines = asked.chips.read_text(encoding="utf-8").splitlines()[:600]
        short = Path("chips_begin.ngc")
        short.write_text("\n".join([*lines, "M2"]), encoding="utf-8")
        programs["3D_Chips, 600 lines"] = list(read_program(short))
        short.unlink()
    programs = {name: given for name, given in programs.items() if asked.only in name}
    print("| program | without | 100 % | ratio | 60 %, from a third on 100 %, from two thirds on 150 % |")
    print("|---|--:|--:|--:|--:|")
    known = {}
    for name, given in programs.items():
        parts, without = proven(given, None)
        _, at_100 = proven(given, override([]))
        _, steps = proven(given, override([(0.0, 0.6), (without / 3, 1.0), (2 * without / 3, 1.5)]))
        known[name] = parts, without
        print(f"| {name} | {without:.3f} s | {at_100:.3f} s | {at_100 / without:.4f} | {steps:.3f} s |", flush=True)
    print("\n| holds | number | median | 95 % | largest | in corners in time | longest there | no reference | CPU |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    draw = np.random.default_rng(asked.seed)
    for name, given in programs.items():
        parts, without = known[name]
        holds(name, given, parts, np.sort(draw.uniform(0.0, without, asked.holds)))
