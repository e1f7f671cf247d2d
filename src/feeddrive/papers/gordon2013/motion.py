"""Rope snap and tracking: with and without prefilter, with friction and machining, and on an imperfect machine.

The imperfect machine has a table heavier than in the design, and sampling jitter of the encoders.
"""

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
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.blocks.sensor.encoder import Encoder
from feeddrive.language import tree
from feeddrive.language.quantity import Quantity, number, unit_name
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text, joined
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, simulate
from feeddrive.papers.claims import KEPT, Claim, kept, quotient, stated, within
from feeddrive.papers.gordon2013 import testbed
from feeddrive.papers.gordon2013.frequency import DIGITS
from feeddrive.papers.gordon2013.testbed import CASCADE, FULL, GAINS, LONG, PLACED, RIGID, SHORT, SOFTER, TRUTH, Part
from feeddrive.plot.chart import LOG, NEUTRAL, THIN, Chart, Curve, Panel
from feeddrive.plot.curves import bars
from feeddrive.report.report import Picture

# shares to which the expected figures are known: their program counts the last half sample of the setpoints otherwise,
# which shows the more the less error is left
KNOWN_RMS, KNOWN_PEAK, KNOWN_LARGE = 0.2, 0.4, 0.06  # an RMS, a peak of 1 µm or less, a peak of 10 µm
# s, when the rope is cut; the table has settled under its force by then
CUT = 0.5
SETTLED = 0.5e-6  # m


def rope_snap() -> Part:
    """Check the response of the table to a rope snap."""
    # a move by 0 m: the axis holds its position until the table has settled after the cut
    rest = SnapLimitedMove(distance=0.0, velocity=1.0, acceleration=1.0, jerk=1.0, snap=1.0, dwell_before=CUT + 0.2)
    runs: dict[str, Run] = {}
    for name, loop in ((PLACED, testbed.placed()), (CASCADE, testbed.cascade())):
        runs[name] = simulate(loop, rest, load=StepForce(force=-150.0, end=CUT), record=("position_load",), name=name)
    # the encoders' counts are the only nonlinearity: twice the force must give twice the peak
    stronger = simulate(testbed.placed(), rest, load=StepForce(force=-300.0, end=CUT), record=("position_load",))
    peaks, left, settled = ([f(run) for run in runs.values()] for f in (_peak, _left, _settling))
    rule = Text(f"-150 N on the table until {Quantity(CUT, 's'):6 SI}, then 0 N; {GAINS}")
    claims = [
        Claim(
            "2.b peak",
            "The peak hardly differs: table mass and screw set it",
            rule,
            peaks[0] / peaks[1],
            *quotient("17.7", "18.4"),
            expected=f"17.7 / 18.4 µm, {DIGITS}",
        ),
        Claim(
            "2.b rms",
            "Less is left in the first 50 ms",
            rule,
            left[0] / left[1],
            *quotient("4.84", "6.16"),
            expected=f"4.84 / 6.16 µm RMS, {DIGITS}",
        ),
        Claim(
            "2.b settling",
            "Pole placement is back within 0.5 µm in half the time",
            rule,
            settled[0] / settled[1],
            *quotient("18.8", "40.4", 0.003),
            expected=f"18.8 / 40.4 ms, {DIGITS}; a sample is 0.3 % of the shorter one",
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
    return testbed.peak(_after(run))


def _left(run: Run) -> float:
    return testbed.rms(_after(run)[: round(0.05 / run.sample_time)])


def _settling(run: Run) -> float:
    """Return the settling time, ms."""
    # the last sample outside: the table swings through the band before it stays
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
    for name, loop in ((PLACED, testbed.placed()), (CASCADE, testbed.cascade())):
        first, second = testbed.fits(loop, LONG, 2)
        short = testbed.fits(loop, SHORT)[0]
        for words, reference, fit in (
            ("long move", LONG, None),
            ("long move, prefilter", LONG, first),
            ("long move, prefilter fitted twice", LONG, second),
            ("short move", SHORT, None),
            ("short move, prefilter of the long one", SHORT, first),
            ("short move, its own prefilter", SHORT, short),
        ):
            held = loop if fit is None else testbed.with_prefilter(loop, fit)
            runs[name, words] = testbed.follow(held, reference, name)
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
                    one_sided="0.2 was required, and less would be as good",
                )
            )
    rows = [
        [words, *(testbed.figures(runs[name, words]) for name in (PLACED, CASCADE))]
        for words in dict.fromkeys(words for _, words in runs)
    ]

    def rated(name: str, words: str) -> float:
        return testbed.rms(runs[name, words]["tracking_error"])

    def largest_of(name: str, words: str) -> float:
        return testbed.peak(runs[name, words]["tracking_error"])

    slow = f"100 mm at 0.3 m/s, 5 m/s², 400 m/s³, 4e4 m/s⁴, no friction; {GAINS}"
    claims[:0] = [
        Claim(
            "2.c laws",
            "Pole placement follows at least eight times closer",
            rule,
            rated(CASCADE, "long move") / rated(PLACED, "long move"),
            *quotient("2.99", "0.204", KNOWN_RMS),
            expected="RMS 2.99 / 0.204 µm, to 20 %",
        ),
        Claim(
            "2.c laws, peak",
            "Its peak too",
            rule,
            largest_of(CASCADE, "long move") / largest_of(PLACED, "long move"),
            *quotient("11.2", "0.66", known_below=KNOWN_PEAK),
            expected="11.2 / 0.66 µm, the peak below 1 µm to 40 %; at least 8 was required",
        ),
        Claim(
            "2.c prefilter",
            "One fit of the prefilter takes much of what is left",
            rule,
            rated(PLACED, "long move") / rated(PLACED, "long move, prefilter"),
            least=1.6,
            most=quotient("0.204", "0.107")[1],
            expected="1.76 times, and RMS 0.204 -> 0.107 µm = 1.91 times, were stated; at least 1.6 was required",
        ),
        Claim(
            "2.c prefilter, P-PI",
            "It helps P-PI as well, which stays behind",
            rule,
            rated(CASCADE, "long move") / rated(CASCADE, "long move, prefilter"),
            *quotient("2.99", "1.21", KNOWN_RMS),
            expected="RMS 2.99 -> 1.21 µm, to 20 %",
        ),
        Claim(
            "2.c other move",
            "Fitted on the long move it helps on the short one",
            slow,
            rated(PLACED, "short move") / rated(PLACED, "short move, prefilter of the long one"),
            *quotient("0.095", "0.064", KNOWN_RMS),
            expected="RMS 0.095 -> 0.064 µm, to 20 %",
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
    """Check the effect of each contribution to the command: compatible setpoints, inverse dynamics and prefilter."""

    def loop(commands: str, feedforward: tuple[Any, ...]) -> Loop:
        return testbed.placed(replace(SOFTER, commands=commands), feedforward)

    whole = loop("series", (FULL,))
    bare = loop("series", ())
    kinds = {
        "feedback alone, x1r = x2r": (loop("rigid", ()), "44.9"),
        "+ compatible x1r": (bare, "33.2"),
        "+ prefilter, no feedforward": (testbed.with_prefilter(bare, testbed.fits(bare, LONG)[0]), "11"),
        "rigid inverse, x1r = x2r": (loop("rigid", (RIGID,)), "11.9"),
        "rigid inverse, compatible": (loop("series", (RIGID,)), "1.51"),
        "full inverse, x1r = x2r": (loop("rigid", (FULL,)), "12.8"),
        "full inverse, compatible": (whole, "0.74"),
        "all, and prefilter": (testbed.with_prefilter(whole, testbed.fits(whole, LONG)[0]), "0.48"),
    }
    peaks = {
        name: testbed.peak(testbed.follow(variant, LONG, name)["tracking_error"])
        for name, (variant, _) in kinds.items()
    }
    rule = f"largest tracking error on the 300 mm move, no friction; gains of 45 Hz and ζ 0.6; {TRUTH}"
    # in the order of `kinds`, whose indices the claims use
    order = list(peaks.values())

    def falls(after: int, before: int) -> float:
        return order[after] / order[before]

    claims = [
        Claim(
            "2.d commands",
            "Compatible commands alone are worth little",
            rule,
            falls(1, 0),
            *quotient("33.2", "44.9", 0.02),
            expected="44.9 -> 33.2 µm, to 2 %",
        ),
        Claim("2.d stall", "The prefilter stalls without feedforward", rule, order[2], 9.9, 12.1, "µm", "11 µm"),
        Claim(
            "2.d inverse",
            "Inverse dynamics without compatible commands are worth little",
            rule,
            min(order[3], order[5]),
            *within(11.9, KNOWN_LARGE),
            unit="µm",
            expected="the smaller of 11.9 and 12.8 µm, to 6 %",
        ),
        Claim(
            "2.d rigid",
            "A rigid inverse with compatible commands is worth more than both alone",
            rule,
            order[4] / min(order[1], order[3]),
            *quotient("1.51", "11.9", KNOWN_PEAK, known_below=KNOWN_LARGE),
            expected="1.51 µm to 40 % of 11.9 µm to 6 %",
        ),
        Claim(
            "2.d full",
            "The full inverse with compatible commands is worth most",
            rule,
            falls(6, 4),
            *quotient("0.74", "1.51", KNOWN_PEAK),
            expected="1.51 -> 0.74 µm, to 40 %",
        ),
        Claim(
            "2.d together",
            "Commands and inverse are effective only together",
            rule,
            order[6] / min(order[1], order[3], order[5]),
            *quotient("0.74", "11.9", KNOWN_PEAK),
            expected="0.74 of 11.9 µm, to 40 %",
        ),
        Claim(
            "2.d prefilter",
            "The prefilter takes off the rest",
            rule,
            falls(7, 6),
            *quotient("0.48", "0.74", 0.2),
            expected="0.74 -> 0.48 µm: both peaks of one loop and move, to 20 %",
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


# both kinds: the expected figures are those of a tanh, while a guideway stands still
SMOOTH = Regularised(coulomb=70.0, breakaway=110.0, stribeck_velocity=4e-3, transition_velocity=2e-4)
SET_VALUED = Stribeck(coulomb=70.0, breakaway=110.0, stribeck_velocity=4e-3)
FED = FrictionFeedforward(
    coulomb_positive=70.0, coulomb_negative=70.0, breakaway=110.0, stribeck_velocity=4e-3, smoothing=2e-4
)
ENTRY, STEADY = 0.1, 0.3  # s: entry of the tool, and start of the steady cut
CUTTING_MEAN = 23.0  # N


def friction() -> Part:
    """Check the effect of Stribeck friction on the screw, with and without its feedforward."""
    laws = {
        PLACED: testbed.with_prefilter(testbed.placed(), testbed.fits(testbed.placed(), LONG)[0]),
        CASCADE: testbed.cascade(),
    }
    kinds: Mapping[str, Friction] = {"tanh, v_t = 0.2 mm/s": SMOOTH, "set-valued": SET_VALUED}
    runs: dict[tuple[str, str, bool], Run] = {}
    for kind, contact in kinds.items():
        for law, loop in laws.items():
            plain = testbed.with_friction(loop, contact)
            runs[kind, law, False], runs[kind, law, True] = (
                testbed.follow(plain, LONG, law),
                testbed.follow(_fed(plain), LONG, law),
            )

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
            gain(smooth, PLACED, testbed.rms),
            *quotient("0.446", "0.136", KNOWN_RMS),
            expected="RMS 0.446 -> 0.136 µm, to 20 %",
        ),
        Claim(
            "2.e peak",
            "And of its peak",
            rule,
            gain(smooth, PLACED, testbed.peak),
            *quotient("3.84", "0.96", known_below=KNOWN_PEAK),
            expected="peak 3.84 -> 0.96 µm, the peak below 1 µm to 40 %",
        ),
        Claim(
            "2.e P-PI",
            "It reduces the error of P-PI little, since that error is not caused by friction",
            rule,
            gain(smooth, CASCADE, testbed.peak),
            *quotient("13.9", "11.4"),
            expected=f"peak 13.9 -> 11.4 µm, {DIGITS}",
        ),
        Claim(
            "2.e set-valued",
            "The order is the same with set-valued friction",
            f"{beside}; the size: {KEPT}",
            gain(exact, PLACED, testbed.rms),
            *kept(2.03),
            expected="ordering only: more than 1",
        ),
        Claim(
            "2.e laws",
            "Pole placement stays far closer than P-PI: its peak",
            rule,
            testbed.peak(runs[smooth, CASCADE, True]["tracking_error"])
            / testbed.peak(runs[smooth, PLACED, True]["tracking_error"]),
            *quotient("11.4", "0.96", known_below=KNOWN_PEAK),
            expected="peak 11.4 / 0.96 µm, the peak below 1 µm to 40 %",
        ),
    ]
    rows = [
        [f"{kind}, {law}", *(testbed.figures(runs[kind, law, fed]) for fed in (False, True))]
        for kind in kinds
        for law in laws
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


def _fed(loop: Loop) -> Loop:
    """Return the loop with the friction of the screw fed forward."""
    return replace(loop, control=replace(loop.control, feedforward=(*loop.control.feedforward, FED)))


def _cut(speed: float) -> MillingForce:
    """Return half-immersion up milling with two straight edges; the feed is chosen for a mean force of 23 N."""
    tool = HelicalCutter(teeth=2, diameter=0.01, axial_depth=1e-3, radial_depth=5e-3, specific_energy=8e8)
    one = MillingForce(cutter=tool, spindle_speed=speed, chip_load=1e-4, start=ENTRY)
    turn = ENTRY + 60.0 / speed * np.arange(4000) / 4000
    # the force is proportional to the chip: one evaluation scales it
    return replace(one, chip_load=1e-4 * CUTTING_MEAN / abs(float(np.mean(one.at(turn)))))


def machining() -> Part:
    """Check the response to the entry into a cut, and to tooth passing at several spindle speeds."""
    rest = SnapLimitedMove(distance=0.0, velocity=1.0, acceleration=1.0, jerk=1.0, snap=1.0, dwell_before=0.8)

    def cut(loop: Loop, speed: float, name: str) -> Run:
        return simulate(loop, rest, load=_cut(speed), record=("position_load", "load_force"), name=name)

    def entering(run: Run) -> float:
        start = round(ENTRY / run.sample_time)
        return testbed.rms(run["position_load"][start : start + round(0.06 / run.sample_time)])

    def steady(run: Run) -> float:
        return testbed.rms(run["position_load"][round(STEADY / run.sample_time) :])

    runs = {name: cut(loop, 6000.0, name) for name, loop in ((PLACED, testbed.placed()), (CASCADE, testbed.cascade()))}
    ppc, ppi = runs[PLACED], runs[CASCADE]
    rule = f"half immersion, up, two straight edges, 6000 rpm, mean 23 N along the feed; {GAINS}"
    claims = [
        Claim(
            "2.f entry",
            "Less error in the first 60 ms of a cut",
            rule,
            entering(ppc) / entering(ppi),
            *quotient("1.12", "1.22"),
            expected=f"RMS 1.12 / 1.22 µm, {DIGITS}",
        ),
        Claim(
            "2.f steady",
            "No difference in the steady cut",
            rule,
            steady(ppc) / steady(ppi),
            *quotient("0.75", "0.74"),
            expected=f"RMS 0.75 / 0.74 µm, {DIGITS}",
        ),
    ]
    rows: list[list[str | Quantity | None]] = [
        ["6000 rpm, first 60 ms", stated(entering(ppc), "µm"), None, stated(entering(ppi), "µm")]
    ]
    for speed in (6000.0, 3000.0, 1800.0, 900.0):
        errors = [
            steady(cut(loop, speed, "")) for loop in (testbed.placed(), testbed.placed(SOFTER), testbed.cascade())
        ]
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
    """Check the effect of a table heavier than in the design, and of sampling jitter of the encoders."""
    heavy = {"axis.x.plant.mass_load": 43.0}
    loops = {PLACED: tree.vary(testbed.placed(SOFTER), heavy), CASCADE: tree.vary(testbed.cascade(), heavy)}
    rows: list[list[str | None]] = []
    peaks: dict[tuple[str, bool], tuple[float, float]] = {}
    for name, loop in loops.items():
        for rubs in (False, True):
            axis = _fed(testbed.with_friction(loop, SMOOTH)) if rubs else loop
            before, after = (
                testbed.follow(axis, LONG, name),
                testbed.follow(testbed.with_prefilter(axis, testbed.fits(axis, LONG)[0]), LONG, name),
            )
            peaks[name, rubs] = (testbed.peak(before["tracking_error"]), testbed.peak(after["tracking_error"]))
            words = ", friction fed forward" if rubs else ""
            rows.append([f"{name}, table 43 kg{words}", testbed.figures(before), testbed.figures(after)])
    # jitter of the reading alone: a jitter of the force would be another experiment
    calm, shaken = ({name: _jittered(loop, by) for name, loop in _both().items()} for by in (None, 1.5e-3))
    for words, runs in (("no jitter", calm), ("jitter 0.15 % of T", shaken)):
        rows += [[f"{name}, {words}", testbed.figures(run), None] for name, run in runs.items()]
    undisturbed, errors = (
        {name: testbed.rms(run["tracking_error"]) for name, run in runs.items()} for runs in (calm, shaken)
    )
    rule = f"true table 43 kg, nothing identified anew, gains of 45 Hz and ζ 0.6; 300 mm move; {TRUTH}"
    rubbing = f"{rule}; friction 110 N falling to 70 N on the screw as tanh, fed forward"
    jitter = (
        f"each encoder is read at kT + δ, δ white, normal, 0.15 % of T, independent for the two; the force still acts "
        f"on time; seed 0, 300 mm move; {GAINS}"
    )
    claims = [
        Claim(
            "2.g heavy table",
            "Pole placement keeps its advantage with another table mass",
            rule,
            peaks[CASCADE, False][0] / peaks[PLACED, False][0],
            least=2.75,
            most=4.1,
            expected="peak 19.6 / 5.7 µm, 3.4 to 20 %",
        ),
        Claim(
            "2.g prefilter",
            "Without friction the prefilter takes all but a sixth of the errors of the model",
            f"{rule}; {KEPT}",
            peaks[PLACED, False][0] / peaks[PLACED, False][1],
            *kept(5.80),
            expected="no figure was given: what is left is of second order in the prefilter",
        ),
        Claim(
            "2.g prefilter, P-PI",
            "It finds less of that of P-PI",
            f"{rule}; {KEPT}",
            peaks[CASCADE, False][0] / peaks[CASCADE, False][1],
            *kept(1.61),
            expected="no figure was given",
        ),
        Claim(
            "2.g friction",
            "With friction fed forward the prefilter leaves of it the peak as the axis stops",
            rubbing,
            peaks[PLACED, True][1],
            least=1.5,
            most=3.5,
            unit="µm",
            expected="5.7 -> 2.5 µm, peaks known to 40 %",
        ),
        Claim(
            "2.g friction, P-PI",
            "and of that of P-PI",
            rubbing,
            peaks[CASCADE, True][1],
            least=11.5,
            most=17.3,
            unit="µm",
            expected="19.6 -> 14.4 µm, to 20 %",
        ),
        Claim(
            "2.g jitter",
            "Pole placement stays ahead although the clock jitters",
            jitter,
            errors[CASCADE] / errors[PLACED],
            # at 1 m/s δ is white noise of 75 nm in the reading, of which the loop, 150 Hz of 10 kHz, passes some 10 nm:
            # 0.2 % of 0.2 µm RMS, since squares add
            *within(undisturbed[CASCADE] / undisturbed[PLACED], 0.02),
            expected="as without jitter, to 2 %: of the 75 nm of noise that it is at 1 m/s the loop passes some 10 nm",
        ),
    ]
    heads = [f"tracking error, peak / RMS in {unit_name('m')}", "as designed", "with prefilter"]
    return Part(claims, [Table("Another table, and a clock that jitters", heads, rows)])


def _both() -> dict[str, Loop]:
    return {PLACED: testbed.placed(), CASCADE: testbed.cascade()}


def _jittered(loop: Loop, jitter: float | None) -> Run:
    encoder = Encoder(resolution=1e-8, jitter=jitter)
    shaken = replace(loop, axis=replace(loop.axis, encoder_motor=encoder, encoder_load=encoder))
    return testbed.follow(shaken, LONG, loop.control.law.kind)
