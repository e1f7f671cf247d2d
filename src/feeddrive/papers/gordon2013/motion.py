"""Rope snap, high-speed tracking with and without prefilter, and the effect of each contribution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from feeddrive import plot
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.language.quantity import Quantity, number, unit_name
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate
from feeddrive.papers.claims import Claim, stated
from feeddrive.papers.gordon2013.testbed import (
    CASCADE,
    FULL,
    GAINS,
    LONG,
    PLACED,
    RIGID,
    SHORT,
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
    with_prefilter,
)
from feeddrive.plot.chart import LOG, Chart, Curve, Panel
from feeddrive.plot.curves import bars
from feeddrive.report.report import Picture

CUT = 0.5  # s, when the rope is cut; the table has settled under its force by then
SETTLED = 0.5e-6  # m


def rope_snap() -> Part:
    """Check the response of the table to a rope snap."""
    rest = SnapLimitedMove(distance=0.0, velocity=1.0, acceleration=1.0, jerk=1.0, snap=1.0, dwell_before=CUT + 0.2)
    runs: dict[str, Run] = {}
    for name, loop in ((PLACED, placed()), (CASCADE, cascade())):
        runs[name] = simulate(loop, rest, load=StepForce(force=-150.0, end=CUT), record=("position_load",), name=name)
    stronger = simulate(placed(), rest, load=StepForce(force=-300.0, end=CUT), record=("position_load",))
    peaks, left, settled = ([f(run) for run in runs.values()] for f in (_peak, _left, _settling))
    rule = Text(f"-150 N on the table until {Quantity(CUT, 's'):6 SI}, then 0 N; {GAINS}")
    claims = [
        Claim(
            "2.b peak",
            "The peak hardly differs: table mass and screw set it",
            rule,
            peaks[0] / peaks[1],
            least=0.9,
            most=1.1,
            expected="17.7 / 18.4 µm",
        ),
        Claim(
            "2.b rms", "Less is left in the first 50 ms", rule, left[0] / left[1], None, 0.85, "", "4.84 / 6.16 µm RMS"
        ),
        Claim(
            "2.b settling",
            "Pole placement is back within 0.5 µm in half the time",
            rule,
            settled[0] / settled[1],
            most=0.55,
            expected="18.8 / 40.4 ms",
        ),
        Claim(
            "2.b linear",
            "100 to 300 N give the same picture",
            f"300 against 150 N; {rule}",
            _peak(stronger) / peaks[0],
            least=1.99,
            most=2.01,
            expected="linear but for the counts of the encoders",
        ),
    ]
    rows = [
        [name, stated(a, "µm"), stated(b, "µm"), stated(c, "ms")]
        for name, a, b, c in zip(runs, peaks, left, settled, strict=True)
    ]
    columns = [
        "law",
        Column("peak", "m", "3"),
        Column("RMS of 50 ms", "m", "3"),
        Column(f"settled to {Quantity(SETTLED, 'm')}", "s", "3"),
    ]
    caption = "Position of the table after 150 N are let go."
    alt = Text(
        f"Both peaks are {stated(peaks[0], 'µm', '3', bare=True)} and {stated(peaks[1], 'µm', '3')}; pole placement "
        f"settles in {stated(settled[0], 'ms', '3')}."
    )
    drawing = Picture("rope", "Rope snap", caption, alt, lambda: _rope(runs))
    return Part(claims, [Table("Rope snap from 150 N", columns, rows)], [drawing])


def _after(run: Run) -> np.ndarray:
    return run["position_load"][round(CUT / run.sample_time) :]


def _peak(run: Run) -> float:
    return peak(_after(run))


def _left(run: Run) -> float:
    return rms(_after(run)[: round(0.05 / run.sample_time)])


def _settling(run: Run) -> float:
    """Return the settling time, ms."""
    return 1e3 * run.sample_time * float(np.flatnonzero(np.abs(_after(run)) > SETTLED)[-1])


def _rope(runs: Mapping[str, Run]) -> Chart:
    curves = list[Curve]()
    for i, (name, run) in enumerate(runs.items()):
        after = _after(run)[:2000]
        curves.append(Curve(1e3 * run.sample_time * np.arange(after.size), 1e6 * after, name, i))
    return Chart("time after the rope is cut (ms)", (Panel("position (µm)", tuple(curves)),))


def tracking_error() -> Part:
    """Check the tracking error of a fast and a slower move, without and with prefilter."""
    rule = f"300 mm at 1 m/s, 10 m/s², 800 m/s³, 8e4 m/s⁴, 0.1 s dwell, no friction; {GAINS}"
    claims: list[Claim] = []
    shown: dict[str, Run] = {}
    runs: dict[tuple[str, str], Run] = {}
    for name, loop in ((PLACED, placed()), (CASCADE, cascade())):
        first, second = fits(loop, LONG, 2)
        short = fits(loop, SHORT)[0]
        for words, reference, fit in (
            ("long move", LONG, None),
            ("long move, prefilter", LONG, first),
            ("long move, prefilter fitted twice", LONG, second),
            ("short move", SHORT, None),
            ("short move, prefilter of the long one", SHORT, first),
            ("short move, its own prefilter", SHORT, short),
        ):
            held = loop if fit is None else with_prefilter(loop, fit)
            runs[name, words] = follow(held, reference, name)
        shown[name] = runs[name, "long move"]
        shown[f"{name}, prefilter"] = runs[name, "long move, prefilter"]
        if name == PLACED:
            after = runs[name, "long move, prefilter fitted twice"]
            largest = max(map(abs, second.correlation(after["following_error"]).values()))
            claims.append(
                Claim(
                    "2.c correlation",
                    "After two fits the error is hardly one of the derivatives",
                    rule,
                    largest,
                    most=0.2,
                    expected="largest |correlation| 0.14",
                )
            )
    rows = [
        [words, *(figures(runs[name, words]) for name in (PLACED, CASCADE))]
        for words in dict.fromkeys(words for _, words in runs)
    ]

    def rated(name: str, words: str) -> float:
        return rms(runs[name, words]["tracking_error"])

    def largest_of(name: str, words: str) -> float:
        return peak(runs[name, words]["tracking_error"])

    slow = f"100 mm at 0.3 m/s, 5 m/s², 400 m/s³, 4e4 m/s⁴, no friction; {GAINS}"
    claims[:0] = [
        Claim(
            "2.c laws",
            "Pole placement follows at least eight times closer",
            rule,
            rated(CASCADE, "long move") / rated(PLACED, "long move"),
            least=8.0,
            expected="RMS 2.99 / 0.204 µm, peak 11.2 / 0.66 µm",
        ),
        Claim(
            "2.c laws, peak",
            "Its peak too",
            rule,
            largest_of(CASCADE, "long move") / largest_of(PLACED, "long move"),
            least=8.0,
            expected="11.2 / 0.66 µm",
        ),
        Claim(
            "2.c prefilter",
            "One fit of the prefilter takes much of what is left",
            rule,
            rated(PLACED, "long move") / rated(PLACED, "long move, prefilter"),
            least=1.6,
            expected="RMS 0.204 -> 0.107 µm",
        ),
        Claim(
            "2.c prefilter, P-PI",
            "It helps P-PI as well, which stays behind",
            rule,
            rated(CASCADE, "long move") / rated(CASCADE, "long move, prefilter"),
            least=1.6,
            expected="RMS 2.99 -> 1.21 µm",
        ),
        Claim(
            "2.c other move",
            "Fitted on the long move it helps on the short one",
            slow,
            rated(PLACED, "short move") / rated(PLACED, "short move, prefilter of the long one"),
            least=1.2,
            expected="RMS 0.095 -> 0.064 µm",
        ),
    ]
    heads = [f"tracking error, peak / RMS in {unit_name('m')}", PLACED, CASCADE]
    alt = "Tracking error of both laws over time without and with prefilter; each row has its own scale."
    picture = Picture(
        "tracking",
        "High-speed tracking",
        "300 mm at 1 m/s and 10 m/s². Each row has its own scale.",
        alt,
        lambda: plot.following_error_chart(shown),
    )
    return Part(claims, [Table("High-speed tracking without friction", heads, rows)], [picture])


def ablation() -> Part:
    """Check the effect of each contribution alone."""

    def loop(commands: str, feedforward: tuple[Any, ...]) -> Loop:
        return placed(replace(SOFTER, commands=commands), feedforward)

    whole = loop("series", (FULL,))
    bare = loop("series", ())
    kinds = {
        "feedback alone, x1r = x2r": (loop("rigid", ()), "44.9"),
        "+ compatible x1r": (bare, "33.2"),
        "+ prefilter, no feedforward": (with_prefilter(bare, fits(bare, LONG)[0]), "11"),
        "rigid inverse, x1r = x2r": (loop("rigid", (RIGID,)), "11.9"),
        "rigid inverse, compatible": (loop("series", (RIGID,)), "1.51"),
        "full inverse, x1r = x2r": (loop("rigid", (FULL,)), "12.8"),
        "full inverse, compatible": (whole, "0.74"),
        "all, and prefilter": (with_prefilter(whole, fits(whole, LONG)[0]), "0.48"),
    }
    peaks = {name: peak(follow(variant, LONG, name)["tracking_error"]) for name, (variant, _) in kinds.items()}
    rule = f"largest tracking error on the 300 mm move, no friction; gains of 45 Hz and ζ 0.6; {TRUTH}"
    order = list(peaks.values())

    def falls(after: int, before: int) -> float:
        return order[after] / order[before]

    claims = [
        Claim(
            "2.d commands",
            "Compatible commands alone are worth little",
            rule,
            falls(1, 0),
            least=0.6,
            most=1.0,
            expected="44.9 -> 33.2 µm",
        ),
        Claim("2.d stall", "The prefilter stalls without feedforward", rule, order[2], 5.0, None, "µm", "11 µm"),
        Claim(
            "2.d inverse",
            "Inverse dynamics without compatible commands are worth little",
            rule,
            min(order[3], order[5]),
            least=8.0,
            unit="µm",
            expected="11.9 and 12.8 µm",
        ),
        Claim(
            "2.d rigid",
            "A rigid inverse with compatible commands is worth more than both alone",
            rule,
            order[4] / min(order[1], order[3]),
            most=0.3,
            expected="1.51 µm",
        ),
        Claim(
            "2.d full",
            "The full inverse with compatible commands is worth most",
            rule,
            falls(6, 4),
            most=0.7,
            expected="1.51 -> 0.74 µm",
        ),
        Claim(
            "2.d together",
            "Commands and inverse are effective only together",
            rule,
            order[6] / min(order[1], order[3], order[5]),
            most=0.1,
            expected="0.74 of 12 µm",
        ),
        Claim(
            "2.d prefilter", "The prefilter takes off the rest", rule, falls(7, 6), None, 0.75, "", "0.74 -> 0.48 µm"
        ),
    ]
    rows = [[name, stated(float(kinds[name][1]), "µm"), stated(value, "µm", "3")] for name, value in peaks.items()]
    title = "Ablation: largest tracking error"
    alt = joined(", ", (f"{name} {stated(value, 'µm', '3')}" for name, value in peaks.items()))
    drawing = Picture(
        "ablation", "What each contribution is worth", "Largest tracking error, logarithmic.", alt, lambda: _bars(peaks)
    )
    columns = ["contributions", Column("expected", "m"), Column("got", "m")]
    return Part(claims, [Table(title, columns, rows)], [drawing])


def _bars(errors: Mapping[str, float]) -> Chart:
    sizes = list(errors.values())
    low, high = 0.5 * min(sizes), 2.0 * max(sizes)
    panel = bars(list(errors), sizes, [number(size, 3) for size in sizes], base=low)
    return Chart("largest tracking error (µm)", (panel,), LOG, low, high, height=3.2)
