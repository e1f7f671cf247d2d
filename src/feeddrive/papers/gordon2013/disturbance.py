"""Friction, machining, and imperfections of a real machine: a wrong table mass and sampling jitter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from feeddrive import plot
from feeddrive.blocks.cutting.helical_cutter import HelicalCutter
from feeddrive.blocks.families import Friction
from feeddrive.blocks.feedforward.friction_feedforward import FrictionFeedforward
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.blocks.load.milling_force import MillingForce
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.language import tree
from feeddrive.language.quantity import Quantity, unit_name
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate
from feeddrive.papers.claims import Claim, stated
from feeddrive.papers.gordon2013.testbed import (
    CASCADE,
    GAINS,
    LONG,
    PLACED,
    SOFTER,
    TRUTH,
    Part,
    cascade,
    figures,
    fits,
    follow,
    peak,
    placed,
    rms,
    with_friction,
    with_prefilter,
)
from feeddrive.plot.chart import NEUTRAL, THIN, Chart, Curve, Panel
from feeddrive.report.report import Picture

SMOOTH = Regularised(coulomb=70.0, breakaway=110.0, stribeck_velocity=4e-3, transition_velocity=2e-4)
SET_VALUED = Stribeck(coulomb=70.0, breakaway=110.0, stribeck_velocity=4e-3)
FED = FrictionFeedforward(
    coulomb_positive=70.0, coulomb_negative=70.0, breakaway=110.0, stribeck_velocity=4e-3, smoothing=2e-4
)
ENTRY, STEADY = 0.1, 0.3  # s: entry of the tool, and start of the steady cut
CUTTING_MEAN = 23.0  # N


def friction() -> Part:
    """Check Stribeck friction on the screw, with and without its feedforward."""
    laws = {PLACED: with_prefilter(placed(), fits(placed(), LONG)[0]), CASCADE: cascade()}
    kinds: Mapping[str, Friction] = {"tanh, v_t = 0.2 mm/s": SMOOTH, "set-valued": SET_VALUED}
    runs: dict[tuple[str, str, bool], Run] = {}
    for kind, contact in kinds.items():
        for law, loop in laws.items():
            plain = with_friction(loop, contact)
            control = plain.control
            fed = replace(plain, control=replace(control, feedforward=(*control.feedforward, FED)))
            runs[kind, law, False], runs[kind, law, True] = follow(plain, LONG, law), follow(fed, LONG, law)

    def gain(kind: str, law: str, measure: Any) -> float:
        without, with_it = (measure(runs[kind, law, fed]["tracking_error"]) for fed in (False, True))
        return without / with_it

    smooth, exact = kinds
    rule = f"friction 110 N falling to 70 N on the screw as tanh, v_t = 0.2 mm/s; 300 mm move; {GAINS}"
    beside = f"the same with set-valued friction; {GAINS}"
    claims = [
        Claim(
            "2.e rms",
            "Friction feedforward takes most of the error under pole placement",
            rule,
            gain(smooth, PLACED, rms),
            least=2.5,
            expected="RMS 0.446 -> 0.136 µm",
        ),
        Claim("2.e peak", "And of its peak", rule, gain(smooth, PLACED, peak), 2.5, None, "", "peak 3.84 -> 0.96 µm"),
        Claim(
            "2.e P-PI",
            "It reduces the error of P-PI little, since that error is not caused by friction",
            rule,
            gain(smooth, CASCADE, peak),
            least=1.1,
            most=1.5,
            expected="peak 13.9 -> 11.4 µm",
        ),
        Claim(
            "2.e set-valued",
            "The order is the same with set-valued friction",
            beside,
            gain(exact, PLACED, rms),
            least=1.5,
            expected="ordering only",
        ),
        Claim(
            "2.e laws",
            "Pole placement stays far closer than P-PI",
            rule,
            rms(runs[smooth, CASCADE, True]["tracking_error"]) / rms(runs[smooth, PLACED, True]["tracking_error"]),
            least=8.0,
            expected="peak 11.4 / 0.96 µm",
        ),
    ]
    rows = [
        [f"{kind}, {law}", *(figures(runs[kind, law, fed]) for fed in (False, True))] for kind in kinds for law in laws
    ]
    heads = [f"tracking error, peak / RMS in {unit_name('m')}", "without", "with friction feedforward"]
    shown = {
        f"{PLACED}, no friction feedforward": runs[smooth, PLACED, False],
        f"{PLACED}, with it": runs[smooth, PLACED, True],
        f"{CASCADE}, with it": runs[smooth, CASCADE, True],
    }
    drawing = Picture(
        "friction",
        "Friction",
        "Stribeck friction on the screw; pole placement with its prefilter. Each row has its own scale.",
        "Tracking error with friction, with and without its feedforward.",
        lambda: plot.following_error_chart(shown),
    )
    return Part(claims, [Table("Friction of the screw, 110 N falling to 70 N", heads, rows)], [drawing])


def _cut(speed: float) -> MillingForce:
    """Return half-immersion up milling with two straight edges; the feed is chosen for a mean force of 23 N."""
    tool = HelicalCutter(teeth=2, diameter=0.01, axial_depth=1e-3, radial_depth=5e-3, specific_energy=8e8)
    one = MillingForce(cutter=tool, spindle_speed=speed, chip_load=1e-4, start=ENTRY)
    turn = ENTRY + 60.0 / speed * np.arange(4000) / 4000
    return replace(one, chip_load=1e-4 * CUTTING_MEAN / abs(float(np.mean(one.at(turn)))))


def machining() -> Part:
    """Check the entry into a cut, and tooth passing at several spindle speeds."""
    rest = SnapLimitedMove(distance=0.0, velocity=1.0, acceleration=1.0, jerk=1.0, snap=1.0, dwell_before=0.8)

    def cut(loop: Loop, speed: float, name: str) -> Run:
        return simulate(loop, rest, load=_cut(speed), record=("position_load", "load_force"), name=name)

    def entering(run: Run) -> float:
        start = round(ENTRY / run.sample_time)
        return rms(run["position_load"][start : start + round(0.06 / run.sample_time)])

    def steady(run: Run) -> float:
        return rms(run["position_load"][round(STEADY / run.sample_time) :])

    runs = {name: cut(loop, 6000.0, name) for name, loop in ((PLACED, placed()), (CASCADE, cascade()))}
    ppc, ppi = runs[PLACED], runs[CASCADE]
    rule = f"half immersion, up, two straight edges, 6000 rpm, mean 23 N along the feed; {GAINS}"
    claims = [
        Claim(
            "2.f entry",
            "Less error in the first 60 ms of a cut",
            rule,
            entering(ppc) / entering(ppi),
            most=0.95,
            expected="RMS 1.12 / 1.22 µm",
        ),
        Claim(
            "2.f steady",
            "No difference in the steady cut",
            rule,
            steady(ppc) / steady(ppi),
            least=0.95,
            most=1.05,
            expected="RMS 0.75 / 0.74 µm",
        ),
    ]
    rows: list[list[str | Quantity | None]] = [
        ["6000 rpm, first 60 ms", stated(entering(ppc), "µm"), None, stated(entering(ppi), "µm")]
    ]
    for speed in (6000.0, 3000.0, 1800.0, 900.0):
        errors = [steady(cut(loop, speed, "")) for loop in (placed(), placed(SOFTER), cascade())]
        words = Text(f"{Quantity(speed, 'rpm'):6}, steady, {Quantity(speed / 30.0, 'Hz'):6}")
        rows.append([words, *(stated(error, "µm") for error in errors)])
    columns = ["RMS of the position", *(Column(head, "m", "3") for head in (PLACED, "with softer gains", CASCADE))]
    drawing = Picture(
        "cut",
        "Entry into a cut",
        "Two edges at 6000 rpm, 23 N in the mean, from 0.1 s on.",
        "Position of the table under both laws as the cut begins.",
        lambda: _drawn(runs),
    )
    return Part(claims, [Table("Milling, mean force 23 N", columns, rows)], [drawing])


def _drawn(runs: Mapping[str, Run]) -> Chart:
    positions, forces = list[Curve](), list[Curve]()
    for i, (name, run) in enumerate(runs.items()):
        seen = slice(round((ENTRY - 0.01) / run.sample_time), round((ENTRY + 0.1) / run.sample_time))
        time = 1e3 * run.time[seen]
        positions.append(Curve(time, 1e6 * run["position_load"][seen], name, i))
        if i == 0:
            forces.append(Curve(time, run["load_force"][seen], number=NEUTRAL, look=THIN, size=1.3))
    panels = Panel("position (µm)", tuple(positions), share=2.0), Panel("force on the\ntable (N)", tuple(forces))
    return Chart("time (ms)", panels, height=4.2)


def other_axis() -> Part:
    """Check a table heavier than in the design, and sampling jitter of the encoders."""
    heavy = {"axis.x.plant.mass_load": 43.0}
    loops = {PLACED: tree.vary(placed(SOFTER), heavy), CASCADE: tree.vary(cascade(), heavy)}
    rows: list[list[str | None]] = []
    peaks: dict[str, tuple[float, float]] = {}
    for name, loop in loops.items():
        before, after = follow(loop, LONG, name), follow(with_prefilter(loop, fits(loop, LONG)[0]), LONG, name)
        peaks[name] = (peak(before["tracking_error"]), peak(after["tracking_error"]))
        rows.append([f"{name}, table 43 kg", figures(before), figures(after)])
    calm, shaken = ({name: _jittered(loop, by) for name, loop in _both().items()} for by in (None, 1.5e-3))
    for words, runs in (("no jitter", calm), ("jitter 0.15 % of T", shaken)):
        rows += [[f"{name}, {words}", figures(run), None] for name, run in runs.items()]
    errors = {name: rms(run["tracking_error"]) for name, run in shaken.items()}
    rule = f"true table 43 kg, nothing identified anew, gains of 45 Hz and ζ 0.6; 300 mm move; {TRUTH}"
    jitter = (
        f"each encoder is read at kT + δ, δ white, normal, 0.15 % of T, independent for the two; the force still acts "
        f"on time; seed 0, 300 mm move; {GAINS}"
    )
    claims = [
        Claim(
            "2.g heavy table",
            "Pole placement keeps its advantage with another table mass",
            rule,
            peaks[CASCADE][0] / peaks[PLACED][0],
            least=2.5,
            expected="peak 19.6 / 5.7 µm",
        ),
        Claim(
            "2.g prefilter",
            "The prefilter corrects the errors of the model",
            rule,
            peaks[PLACED][0] / peaks[PLACED][1],
            least=2.0,
            expected="peak 5.7 -> 2.5 µm",
        ),
        Claim(
            "2.g prefilter, P-PI",
            "It finds less of that of P-PI",
            rule,
            peaks[CASCADE][0] / peaks[CASCADE][1],
            least=1.2,
            most=2.0,
            expected="peak 19.6 -> 14.4 µm",
        ),
        Claim(
            "2.g jitter",
            "Pole placement stays ahead although the clock jitters",
            jitter,
            errors[CASCADE] / errors[PLACED],
            least=3.0,
            expected="no figure was given",
        ),
    ]
    heads = [f"tracking error, peak / RMS in {unit_name('m')}", "as designed", "with prefilter"]
    return Part(claims, [Table("Another table, and a clock that jitters", heads, rows)])


def _both() -> dict[str, Loop]:
    return {PLACED: placed(), CASCADE: cascade()}


def _jittered(loop: Loop, jitter: float | None) -> Run:
    encoder = Encoder(resolution=1e-8, jitter=jitter)
    shaken = replace(loop, axis=replace(loop.axis, encoder_motor=encoder, encoder_load=encoder))
    return follow(shaken, LONG, loop.control.law.kind)
