"""Claims 1.d and 1.g to 1.i: dynamic stiffness and its limit due to dead time, tracking, and a step with force
saturation.
"""

from typing import Any

import numpy as np

from feeddrive import plot
from feeddrive.analysis.stiffness import robustness, stiffness
from feeddrive.blocks.compensation.disturbance_rejection import DisturbanceRejection
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.families import Law
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language.quantity import number
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.core import advance
from feeddrive.loop.linearize import compliance
from feeddrive.loop.simulate import simulate
from feeddrive.papers.altintas2009.testbed import (
    MASS,
    PLANT,
    VISCOUS,
    T,
    cascade,
    cascade_column,
    continuous_compliance,
    dadsc,
    dadsc_column,
    ideal_model,
    loop,
    transfer,
)
from feeddrive.papers.claims import Claim, printed, quotient, stated, within
from feeddrive.plot.curves import Row, curves_chart
from feeddrive.report.report import Picture
from feeddrive.tuning.scaling import DelayMap, delay_map
from feeddrive.tuning.tune import tune_control

F = np.geomspace(0.1, 1000.0, 1200)
RATE = 300.0
EDGES = (0.418, 0.198, 0.132, 0.0995)  # p T above which the loop is unstable, for 0 ... 3 samples of dead time
ROBUST = (0.197, 0.096, 0.064, 0.048)  # up to which Ms <= 2
CASES, CASES_SEED = 500, 2


def _compliance(law: Law) -> np.ndarray:
    return compliance(loop(law), F).magnitude


def _ideal(law: Law, lines: np.ndarray = F) -> np.ndarray:
    """Return the compliance in the ideal loop, m/N."""
    return np.abs(ideal_model(law).response(lines, "x"))


def rigidity() -> tuple[list[Claim], list[Picture]]:
    """Return claims 1.d and their pictures."""
    claims, pictures = _equal_velocity_gain()
    return [*claims, *_literal(), *_equal_integral(), *_fair(), *_rejection()], pictures


def _equal_velocity_gain() -> tuple[list[Claim], list[Picture]]:
    law, ppi = dadsc(RATE), cascade(RATE)
    ours, theirs = compliance(loop(law), F), compliance(loop(ppi), F)
    ratio = theirs.magnitude / ours.magnitude
    rule = (
        f"equal velocity gain k_d = 3 m p and all poles of the ideal loop real, p = 300 1/s; {PLANT}, real loop "
        f"(force after the reading)"
    )
    peak = float(np.max(theirs.magnitude) / np.max(ours.magnitude))
    tenth = int(np.argmin(np.abs(F - 10.0)))
    fifty = int(np.argmin(np.abs(F - 50.0)))
    expected = float(np.abs(np.divide(*(continuous_compliance(name, RATE, F[fifty]) for name in ("P-PI", "DADSC")))))
    claims = [
        Claim(
            "1.d",
            "at 0.1 Hz DADSC is 27/16 times as stiff as P-PI",
            rule,
            float(ratio[0]),
            least=0.99 * 27 / 16,
            most=1.01 * 27 / 16,
            expected="27/16 = 1.6875 within 1 %",
        ),
        Claim("1.d", "at 10 Hz the ratio is smaller", rule, float(ratio[tenth]), *printed("1.49"), "", "1.49"),
        Claim(
            "1.d",
            "the compliance peak of P-PI is higher by 5 % or more",
            rule,
            peak,
            *printed("1.07"),
            expected="1.07",
        ),
        Claim(
            "1.d",
            "at 50 Hz P-PI is the stiffer one",
            rule,
            float(ratio[fifty]),
            least=0.96 * expected,
            most=1.0,
            expected=f"{number(expected, 3)} of the two PIDs in continuous time, to 4 % as in 1.m",
        ),
    ]
    picture = Picture(
        "stiffness",
        "Dynamic stiffness at equal velocity gain",
        "Force on the table over its motion, closed loop. Both laws have k_d = 3 m p and real poles in the ideal loop.",
        "Both curves fall to a minimum near 30 Hz and rise again; DADSC is the stiffer one below 35 Hz.",
        lambda: plot.stiffness_chart({"DADSC": stiffness(ours), "P-PI cascade": stiffness(theirs)}),
    )
    bode = Picture(
        "compliance",
        "Compliance at equal velocity gain",
        "The same as a Bode plot of motion over force.",
        "Two curves that rise with 20 dB a decade, meet near 30 Hz and fall with 40 dB a decade above 100 Hz.",
        lambda: plot.bode_chart({"DADSC": ours, "P-PI cascade": theirs}),
    )
    return claims, [picture, bode]


def _literal() -> list[Claim]:
    """Compare both laws at the same r2 and r4, as in the paper's figure if it is taken literally."""
    # table 1 of the paper: r2 = m K = Kp and r4 = g1 = m Q ω_d = Kp T/Tn
    K = 56e3 / MASS
    w = 16e3 / (MASS * (1.0 + K * T))
    law = DADSC(mass=MASS, viscous=VISCOUS, tracking_rate=200.0, reaching_rate=K, adaptation_rate=w)
    ours = _ideal(law)
    theirs = _ideal(CascadePPI(Kv=200.0, Kp=56e3, Tn=56e3 * T / 16e3, viscous=VISCOUS))
    rule = "same r2 = 56000 and r4 = 16000, λ = Kv = 200 1/s, ideal loop of the laws as shipped: r4 is a huge integral "
    rule += "gain for P-PI"
    wins, low, by_closed_form = _random_cases()
    many = (
        f"same r2, r4 and λ = Kv, ideal loop of the laws as shipped; {CASES} cases, log-uniform λ 30 ... 1000 1/s, "
        f"K 30 ... 3000 1/s, ω_d 10 ... 1000 1/s, seed {CASES_SEED}"
    )
    return [
        Claim(
            "1.d",
            "P-PI wins: peak compliance of DADSC",
            rule,
            1e6 * float(np.max(ours)),
            least=0.0311,
            most=0.0317,
            unit="um/N",
            expected="0.0314",
        ),
        Claim(
            "1.d",
            "P-PI wins: its own peak compliance",
            rule,
            1e6 * float(np.max(theirs)),
            least=0.00851,
            most=0.00869,
            unit="um/N",
            expected="0.0086",
        ),
        Claim(
            "1.d",
            "share of cases in which DADSC has the lower peak",
            many,
            wins,
            # a case in which both peaks are equal to the last digits may count either way
            least=by_closed_form - 1.0 / CASES,
            most=by_closed_form + 1.0 / CASES,
            expected=f"{number(by_closed_form, 3)} by (8), to one case; 0.22 over ranges that are not stated",
        ),
        Claim(
            "1.d",
            "share of cases in which DADSC is stiffer at 0.1 Hz",
            many,
            low,
            least=0.0,
            most=0.0,
            expected="none",
        ),
    ]


def _random_cases() -> tuple[float, float, float]:
    """Return the shares of cases in which DADSC has the lower peak and in which it is stiffer at 0.1 Hz, with the laws
    as shipped, and the first share by the closed form (8).
    """
    random = np.random.default_rng(CASES_SEED)
    lines = np.geomspace(0.1, 2000.0, 160)
    wins = stiffer = by_closed_form = 0
    for _ in range(CASES):
        rate, K, w = (
            float(np.exp(random.uniform(np.log(low), np.log(high))))
            for low, high in ((30.0, 1000.0), (30.0, 3000.0), (10.0, 1000.0))
        )
        law = DADSC(mass=MASS, viscous=VISCOUS, tracking_rate=rate, reaching_rate=K, adaptation_rate=w)
        # the adaptation gain of the law as a P-PI would have it: the paper compares by r2 and r4
        r4 = MASS * (1.0 + K * T) * w
        ppi = CascadePPI(Kv=rate, Kp=MASS * K, Tn=MASS * K * T / r4, viscous=VISCOUS)
        ours, theirs = _ideal(law, lines), _ideal(ppi, lines)
        wins += int(np.max(ours) < np.max(theirs))
        stiffer += int(ours[0] < theirs[0])
        peaks = [
            float(np.max(np.abs(transfer(column, MASS, T).response(lines, T))))
            for column in (dadsc_column(law, T), cascade_column(rate, MASS * K, MASS * K * T / r4, T))
        ]
        by_closed_form += int(peaks[0] < peaks[1])
    return wins / CASES, stiffer / CASES, by_closed_form / CASES


def _equal_integral() -> list[Claim]:
    """Compare both laws at equal integral action: Kp = m K, Kv = λ, 1/Tn = ω_d, with λ half as large as the other two
    rates.
    """
    law = DADSC(mass=MASS, viscous=VISCOUS, tracking_rate=150.0, reaching_rate=300.0, adaptation_rate=300.0)
    ppi = CascadePPI(Kv=150.0, Kp=MASS * 300.0, Tn=1.0 / 300.0, viscous=VISCOUS)
    ours, theirs = _compliance(law), _compliance(ppi)
    rule = (
        f"equal r2 = m K = Kp, λ = Kv = 150 1/s and integral gain per second g1 K/Q = Kp/Tn, K = ω_d = 300 1/s; {PLANT}"
    )
    swing = float(np.max(np.imag(ideal_model(ppi).poles())))
    return [
        Claim(
            "1.d",
            "the same stiffness at 0.1 Hz",
            rule,
            float(theirs[0] / ours[0]),
            *within(1.0, 0.01),
            expected="1: equal integral gains, which alone act at low frequencies",
        ),
        Claim(
            "1.d",
            "P-PI swings: imaginary part of its poles, ideal loop",
            rule,
            swing,
            least=318.0,
            most=324.0,
            unit="rad/s",
            expected="-95 + 321j",
        ),
        Claim(
            "1.d",
            "peak compliance of P-PI over that of DADSC",
            rule,
            float(np.max(theirs) / np.max(ours)),
            least=2.5,
            most=2.6,
            expected="2.55",
        ),
    ]


def _fair() -> list[Claim]:
    """Tune both laws for the least rope-snap error under Ms <= 2 with two samples of dead time."""
    claims = []
    rule = f"least ISE^½ of a force step subject to Ms <= 2, loop cut at the actuator; 2 samples of dead time; {PLANT}"
    errors = {}
    for name, law in (("DADSC", dadsc(RATE)), ("P-PI", cascade(RATE))):
        tuned = tune_control(loop(law, dead_time=2.0 * T), filters="kept", starts=1)
        errors[name] = 1e9 * tuned.after[0].rope_snap
        expected = 1.04 if name == "DADSC" else 0.90
        claims.append(
            Claim(
                "1.d",
                f"fair margins: rope-snap error of {name}",
                rule,
                errors[name],
                least=0.97 * expected,
                most=1.03 * expected,
                unit="nm s^½/N",
                expected=number(expected, 3),
            )
        )
    return [
        *claims,
        Claim(
            "1.d",
            "fair margins, P-PI wins: its error over that of DADSC",
            rule,
            errors["P-PI"] / errors["DADSC"],
            *quotient("0.90", "1.04"),
            expected="0.90/1.04, each to half a unit of its last digit: both are PIDs; the cascade has real zeros, "
            "DADSC real poles",
        ),
    ]


def _rejection() -> list[Claim]:
    """Check disturbance recovery with another law: a P-PI with moderate gains."""
    law = CascadePPI(Kv=100.0, Kp=24e3, Tn=0.01, viscous=VISCOUS)
    recovery = DisturbanceRecovery(mass=MASS, viscous=VISCOUS, frequency=500.0)
    alone = robustness(loop(law))
    beside = robustness(loop(law, compensation=(DisturbanceRejection(observer=recovery),)))
    rule = (
        f"P-PI with Kv = 100 1/s, Kp = 24000 N s/m, Tn = 10 ms, alone and with recovery at 500 Hz subtracted; {PLANT}"
    )
    fall, cost = _by_polynomials(law, 500.0)
    beside_us = "by the z transforms of axis, law and Butterworth filter"
    return [
        Claim(
            "1.d",
            "recovery under P-PI: rope-snap error falls by",
            rule,
            alone.rope_snap / beside.rope_snap,
            # rope snap there from 0.1 Hz on, and at the samples only
            *within(fall, 0.01),
            expected=f"{number(fall, 3)} times {beside_us}, to 1 %",
        ),
        Claim(
            "1.d",
            "and what it costs: Ms",
            rule,
            beside.sensitivity_peak,
            *within(cost, 0.01),
            expected=f"{number(cost, 4)} {beside_us}, to 1 %; {number(alone.sensitivity_peak, 4)} without",
        ),
    ]


def _by_polynomials(law: CascadePPI, frequency: float) -> tuple[float, float]:
    """Return the fall of the rope-snap error by recovery, and Ms with it, without a line of the shipped blocks.

    With the held axis P(z), the law C(z), the filter Q(z) and N(z) = (m Δ²/T² + b Δ/T) P, Δ = 1 - 1/z, the recovery
    sees Q (N F - F/z), so that the sensitivity is S = (1 - Q/z)/(1 + C P + Q (N - 1/z)), and 1/(1 + C P) without it.
    """
    from scipy.signal import butter

    lines = np.geomspace(0.1, 0.4999 / T, 50_000)
    z = np.exp(2j * np.pi * lines * T)
    late = 1.0 - 1.0 / z
    p = VISCOUS / MASS
    e = np.exp(-p * T)
    P = ((p * T - 1.0 + e) / z + (1.0 - e - p * T * e) / z**2) / (MASS * p**2 * late * (1.0 - e / z))
    assert law.Tn is not None
    # the law gives the viscous friction back
    C = law.Kp * (1.0 + T / law.Tn / late) * (law.Kv + late / T) - VISCOUS * late / T
    # numerator and denominator in powers of 1/z, as many of each
    section: Any = butter(2, frequency, fs=1.0 / T)
    Q = np.polyval(section[0], z) / np.polyval(section[1], z)
    N = (MASS * late**2 / T**2 + VISCOUS * late / T) * P
    alone, beside = 1.0 / (1.0 + C * P), (1.0 - Q / z) / (1.0 + C * P + Q * (N - 1.0 / z))
    errors = [np.trapezoid(np.abs(P * S / lines) ** 2, lines) for S in (alone, beside)]
    return float(np.sqrt(errors[0] / errors[1])), float(np.max(np.abs(beside)))


def delays() -> tuple[list[Claim], list[Table], list[Picture]]:
    """Return claims 1.i, their table and their picture."""
    samples = (0, 1, 2, 3)
    # all three rates together, so that the triple pole stays triple
    names = [f"axis.x.control.law.{name}" for name in DADSC.tunables]
    delay = delay_map(loop(dadsc(RATE)), names, [d * T for d in samples])
    edge, robust = T * delay.at_edge(names[0]), T * delay.at_robust(names[0])
    rule = f"triple pole p = λ = K = ω_d; {PLANT}; dead time in whole samples"
    claims = []
    for i, d in enumerate(samples):
        for what, got, expected in (
            ("unstable above p T", edge[i], EDGES[i]),
            ("Ms <= 2 up to p T", robust[i], ROBUST[i]),
        ):
            claims.append(
                Claim(
                    "1.i",
                    f"{d} samples of dead time: {what}",
                    rule,
                    float(got),
                    least=0.98 * expected,
                    most=1.02 * expected,
                    expected=f"{number(expected, 6)} within 2 %",
                )
            )
    margin = float(np.min(robust * (np.array(samples) + 1.0)))
    claims.append(
        Claim(
            "1.i",
            "p <= 0.19/((d + 1) T) keeps Ms <= 2: least p T (d + 1) at Ms = 2",
            rule,
            margin,
            least=0.19,
            most=0.194,
            expected="0.064 · 3 and 0.048 · 4 = 0.192, to half a unit of the last digit",
        )
    )
    rows = [
        [d, float(a), float(EDGES[i]), float(b), float(ROBUST[i])]
        for i, (d, a, b) in enumerate(zip(samples, edge, robust, strict=True))
    ]
    columns = [
        "samples of dead time",
        Column("p T at the edge", "", ".4f"),
        Column("expected", ""),
        Column("p T at Ms = 2", "", ".4f"),
        Column("expected", ""),
    ]
    table = Table("Stability over dead time", columns, rows)
    fine = delay_map(loop(dadsc(RATE)), names, [0.5 * d * T for d in range(7)])
    return claims, [table], [_map(fine, names[0])]


def _map(delay_map: DelayMap, name: str) -> Picture:
    rows = [
        Row(
            "p T",
            {
                "unstable above": T * delay_map.at_edge(name),
                "Ms = 2": T * delay_map.at_robust(name),
                "0.19/(d + 1)": 0.19 / (delay_map.dead_time / T + 1.0),
            },
        )
    ]
    return Picture(
        "delay",
        "How fast the law may be",
        "Triple pole p over the dead time: the edge of stability, Ms = 2, and the rule of thumb.",
        "Three falling curves; the rule of thumb lies just below Ms = 2.",
        lambda: curves_chart("dead time (samples)", delay_map.dead_time / T, rows),
    )


MOVE = Polynomial7(distance=0.1, travel_time=0.4)
STEP, LIMIT, LENGTH = 5e-3, 400.0, 6000


def motion() -> tuple[list[Claim], list[Picture]]:
    """Return claims 1.g and 1.h and their pictures."""
    claims, pictures = _tracking()
    more, other = _saturation()
    return claims + more, pictures + other


def _error(law: Law, mass: float = MASS) -> np.ndarray:
    run = simulate(loop(law, mass=mass), MOVE, duration=0.6, record=("tracking_error",))
    return 1e6 * run["tracking_error"]


def _tracking() -> tuple[list[Claim], list[Picture]]:
    exact = {"DADSC": _error(dadsc(RATE)), "P-PI cascade": _error(cascade(RATE))}
    light = 0.8 * MASS
    # law and feedforward assume the same wrong mass
    off = {"DADSC": _error(dadsc(RATE, light)), "P-PI cascade": _error(cascade(RATE, light), light)}
    largest = {name: float(np.max(np.abs(error))) for name, error in exact.items()}
    wrong = {name: float(np.max(np.abs(error))) for name, error in off.items()}
    rule = f"polynomial of degree 7, 100 mm in 0.4 s; equal velocity gain, p = 300 1/s; {PLANT}; largest true error"
    light_rule = f"{rule}; mass of law and feedforward 0.8 m"
    claims = [
        *(Claim("1.g", f"{name} with the exact model", rule, got, None, 0.01, "um") for name, got in largest.items()),
        *(
            Claim("1.g", f"{short} with 0.8 of the mass", light_rule, wrong[name], *printed(figure), "um", figure)
            for name, short, figure in (("DADSC", "DADSC", "0.756"), ("P-PI cascade", "P-PI", "1.261"))
        ),
        Claim(
            "1.g",
            "P-PI over DADSC with 0.8 of the mass",
            light_rule,
            wrong["P-PI cascade"] / wrong["DADSC"],
            *printed("1.67"),
            expected="1.67; at least 1.5 was required",
        ),
    ]
    picture = Picture(
        "tracking",
        "Tracking with a wrong mass",
        "True error over a move of 100 mm in 0.4 s; law and feedforward assume 0.8 of the mass.",
        Text(
            f"Largest error {stated(wrong['DADSC'], 'um'):.2f} with DADSC, {stated(wrong['P-PI cascade'], 'um'):.2f} "
            "with P-PI."
        ),
        lambda: curves_chart("time (ms)", 1e3 * T * np.arange(off["DADSC"].size), [Row("error (µm)", off)]),
    )
    return claims, [picture]


def step_response(law: DADSC, windup: str) -> np.ndarray:
    """Return the position in m after an unfiltered setpoint step with limited force; `windup` selects how the estimate
    is treated in saturation.

    none              the estimate continues regardless of the limit
    freezing          the estimate is held in saturated samples
    back-calculation  the anti-windup of the law itself, which uses `applied` and `requested`
    """
    axis = Axis(plant=Rigid(mass=MASS, viscous=VISCOUS))
    timing = axis.timing(T)
    hold, state = axis.prepare(T, timing), axis.start(0.0, 0.0, timing)
    prepared = law.prepare(T)
    kept: Any = law.start(prepared, Setpoint(0.0), Reading(0.0, 0.0))
    response = np.empty(LENGTH)
    applied = requested = 0.0
    for k in range(LENGTH):
        x = state.position[0]
        response[k] = x
        # by hand and not by simulate: two of the three treatments are not those of the shipped law
        seen = applied if windup == "back-calculation" else requested
        after, requested = law.step(prepared, kept, Setpoint(STEP), Reading(x, x, seen, requested), T)
        applied = min(max(requested, -LIMIT), LIMIT)
        held = windup == "freezing" and applied != requested
        kept = after._replace(estimate=kept.estimate) if held else after
        state, _ = advance(axis, hold, state, applied, None, k * T, T)
    return response


def _saturation() -> tuple[list[Claim], list[Picture]]:
    named = {windup: step_response(dadsc(RATE), windup) for windup in ("none", "freezing", "back-calculation")}
    over = {name: 1e3 * float(np.max(x) - STEP) for name, x in named.items()}
    inside = np.abs(named["back-calculation"] - STEP) <= 0.001 * STEP
    # the last sample outside of the band
    settled = 1e3 * T * float(LENGTH - np.argmin(inside[::-1]))
    rule = f"raw step of 5 mm, force limit 400 N, DADSC with p = 300 1/s; {PLANT}"
    claims = [
        Claim(
            "1.h",
            "overshoot with back-calculation: no runaway",
            rule,
            over["back-calculation"],
            *printed("0.72"),
            unit="mm",
            expected="0.72",
        ),
        Claim(
            "1.h",
            "settled to 0.1 % with back-calculation",
            rule,
            settled,
            least=77.4,
            most=78.6,
            unit="ms",
            expected="78, to half a unit of its last digit and a sample; of which share was not stated",
        ),
        Claim(
            "1.h",
            "overshoot when the estimate is frozen instead",
            rule,
            over["freezing"],
            least=max(1.4, over["back-calculation"]),
            most=1.6,
            unit="mm",
            expected="1.5; more than with back-calculation",
        ),
        Claim(
            "1.h",
            "overshoot without any of it: it runs away",
            rule,
            over["none"],
            285.0,
            295.0,
            "mm",
            "290",
        ),
    ]
    shown = {name: 1e3 * named[name][:1500] for name in ("freezing", "back-calculation")}
    picture = Picture(
        "saturation",
        "A step that saturates the drive",
        Text(
            "Set position steps by 5 mm, force limit 400 N. Without anti-windup the axis overshoots by "
            f"{stated(over['none'], 'mm', '3')}."
        ),
        "Two overshoots of a step of 5 mm; the one with back-calculation is the smaller.",
        lambda: curves_chart(
            "time (ms)", 1e3 * T * np.arange(1500), [Row("position (mm)", shown)], levels={"set": 5.0}
        ),
    )
    return claims, [picture]
