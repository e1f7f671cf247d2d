"""Rows 4.l and 4.m: the circle of two axes, its contour error and its quadrant glitches."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from feeddrive.blocks.reference.circle import Circle
from feeddrive.language.table import Table
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.papers.claims import Claim
from feeddrive.papers.wu2017 import pictures
from feeddrive.papers.wu2017.testbed import NOISE, SAME, SET_VALUED, SETS, TANH, noise, table_axis
from feeddrive.report.content import Shown
from feeddrive.tuning.trials import iterate_trials

AXES = {"x": 0, "y": 90}
RUN_UP = 0.5  # s
LEARNED = 4  # trials


class Drawn(NamedTuple):
    """A circle that was driven: s, and x and y in m about its center."""

    time: np.ndarray
    x: np.ndarray
    y: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """Contour error, m."""
        return np.hypot(self.x, self.y) - pictures.RADIUS

    @property
    def rms(self) -> float:
        """µm."""
        return 1e6 * float(np.sqrt(np.mean(self.error**2)))

    @property
    def peak(self) -> float:
        """µm."""
        return 1e6 * float(np.max(np.abs(self.error)))


def circle(axis: str) -> Circle:
    """R = 20 mm, 0.1 m/s, two turns."""
    return Circle(radius=pictures.RADIUS, feed=0.1, turns=2, phase=AXES[axis], run_up_time=RUN_UP)


def contouring() -> tuple[list[Claim], list[Table], list[Shown]]:
    """Claims, tables and pictures."""
    smooth, hard = _all(smooth=True), _all(smooth=False)
    heads = ["learned", "RMS um", "peak um", f"RMS um, {SET_VALUED}", "peak um"]
    rows = [
        [name, f"{each.rms:.3g}", f"{each.peak:.3g}", f"{hard[name].rms:.3g}", f"{hard[name].peak:.3g}"]
        for name, each in smooth.items()
    ]
    table = Table(f"contour error of the circle, {TANH} unless said; expected 10.8, 9.5, 2.3 to 2.5 um", heads, rows)
    time = smooth["start"].time
    # the x axis reverses at y = 0: half a turn after the first full one
    middle = RUN_UP / 2 + 1.5 * 2.0 * np.pi * pictures.RADIUS / 0.1
    window = (time > middle - 0.1) & (time < middle + 0.2)
    on_circle = ["start", *SETS]
    shown = [
        pictures.contour({name: (smooth[name].x, smooth[name].y) for name in on_circle}),
        pictures.quadrant(time[window], {name: smooth[name].error[window] for name in on_circle}),
    ]
    return _claims(smooth, hard), [table], shown


def _all(*, smooth: bool) -> dict[str, Drawn]:
    """The start, each set of columns learned on the circle, and the compensator learned on the line."""
    poor = {axis: table_axis(axis, SETS["+ Coulomb"], smooth=smooth) for axis in AXES}
    found = {"start": _driven({axis: table_axis(axis, SETS["+ Coulomb"], smooth=smooth, known=True) for axis in AXES})}
    for name, columns in SETS.items():
        found[name] = _driven({axis: _learned(axis, columns, smooth) for axis in AXES})
    found["+ Coulomb, learned on the line"] = _driven(
        {axis: _learned(axis, SETS["+ Coulomb"], smooth, line=True) for axis in AXES}
    )
    found["nothing: 45 kg and b = 0"] = _driven(poor)
    return found


def _learned(axis: str, columns: tuple[str, ...], smooth: bool, *, line: bool = False) -> Loop:
    loop = table_axis(axis, columns, smooth=smooth, known=True)
    return iterate_trials(loop, SAME if line else circle(axis), LEARNED, load=noise).loop


def _driven(loops: dict[str, Loop]) -> Drawn:
    """Both axes in one run."""
    found = simulate(
        Machine.of(loops), {axis: circle(axis) for axis in loops},
        load={axis: noise(20 + AXES[axis]) for axis in loops}, record=("x.position_load", "y.position_load"),
    )  # fmt: skip
    return Drawn(found.time, found["x.position_load"], found["y.position_load"])


def _claims(smooth: dict[str, Drawn], hard: dict[str, Drawn]) -> list[Claim]:
    rule = (
        f"x and y axis, circle R 20 mm, 0.1 m/s, two turns; start: the mass and viscous friction of the axes; learned "
        f"on the circle in {LEARNED - 1} updates; {NOISE:g} N noise; {TANH}"
    )
    start = smooth["start"]
    removed = 100.0 * (1.0 - smooth["+ Coulomb"].rms / start.rms)
    elsewhere = 100.0 * (1.0 - smooth["+ Coulomb, learned on the line"].rms / start.rms)
    other = rule.replace("learned on the circle", "learned on the 100 mm move of each axis alone")
    ordered = rule.replace(TANH, f"{SET_VALUED}, ordering only")
    return [
        Claim("4.l", "a, b only leaves the glitches: RMS over that of the start", rule,
              100.0 * smooth["a, b"].rms / start.rms, 85.0, None, "%", "9.5/10.8 = 88"),
        Claim("4.l", "the compensator removes RMS contour error", rule, removed, 70.0, None, "%", "78"),
        Claim("4.l", "largest contour error, start", rule, start.peak, 44.0, 52.0, "um", "48"),
        Claim("4.l", "largest contour error, a and b", rule, smooth["a, b"].peak, 38.0, 46.0, "um", "42"),
        Claim("4.l", "largest contour error, with Coulomb", rule, smooth["+ Coulomb"].peak, None, 18.0, "um",
              "14 to 16"),
        Claim("4.l", "the Stribeck column gains little here: RMS over Coulomb only", rule,
              smooth["+ Stribeck"].rms / smooth["+ Coulomb"].rms, 0.85, 1.15, "", "no gain"),
        Claim("4.l", "parameters of another motion: RMS removed on the circle", other, elsewhere, 70.0, None, "%"),
        Claim("4.m", "the compensator lowers the RMS contour error", ordered,
              hard["+ Coulomb"].rms / hard["a, b"].rms, None, 1.0),
    ]  # fmt: skip
