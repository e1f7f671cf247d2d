"""Claims 1.j to 1.l: the shipped blocks, compared with an independent evaluation of their equations."""

from typing import Any

import numpy as np

from feeddrive.blocks.compensation.disturbance_rejection import DisturbanceRejection
from feeddrive.blocks.compensation.machine_mode import MachineMode
from feeddrive.blocks.compensation.mode_compensation import ModeCompensation
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.families import Observer
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.observer.kalman_recovery import KalmanRecovery
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text
from feeddrive.papers.altintas2009.testbed import cascade, continuous, dadsc, ideal_model
from feeddrive.papers.claims import RANDOM, SAMPLES, Claim, RandomMotion, RandomReadings, misfit, stepped

T = 2e-4
MASS, VISCOUS = 37.0, 55.0
# unequal rates and a ratio other than 1, so that no term of the equations cancels
LAW = DADSC(
    mass=MASS, viscous=VISCOUS, tracking_rate=210.0, reaching_rate=340.0, adaptation_rate=130.0, adaptation_ratio=0.8
)
PPI = CascadePPI(Kv=120.0, Kp=2.4e4, Tn=6e-3, velocity_feedforward=0.9, viscous=VISCOUS)
RULE = Text(
    f"{RANDOM}; m = {Quantity(MASS, 'kg'):6}, b = {Quantity(VISCOUS, 'N s/m'):6}, T = 0.2 ms; largest difference over "
    "the largest value"
)


def _signals() -> tuple[np.ndarray, RandomMotion, RandomReadings]:
    t = T * np.arange(SAMPLES)
    way = RandomMotion()
    return t, way, RandomReadings(way, t)


def law_equations() -> list[Claim]:
    """Check DADSC against (3) to (5), and the cascade, sample by sample."""
    t, way, read = _signals()
    states, force = stepped(LAW, T, way.setpoints(t), read.readings())
    v = np.diff(read.motor) / T
    e_x, e_v = (way(0, t) - read.load)[1:], (way(0, t[1:]) - way(0, t[1:] - T)) / T - v
    s = np.array([0.0, *(state.sliding for state in states)])
    estimate = np.array([0.0, *(state.estimate for state in states)])
    g1 = MASS * (1.0 + LAW.reaching_rate * T) * LAW.adaptation_rate
    g2 = LAW.adaptation_ratio * MASS * LAW.adaptation_rate
    cut = (read.requested - read.applied)[1:]
    middle = way(2, t[1:] + 0.5 * T)
    by_4 = MASS * (middle + LAW.reaching_rate * s[1:] + LAW.tracking_rate * e_v) - estimate[1:] + VISCOUS * v
    by_5 = estimate[:-1] + cut - g1 * s[1:] + g2 * s[:-1]

    e = PPI.Kv * e_x + PPI.velocity_feedforward * (e_v + v) - v
    assert PPI.Tn is not None
    integral = np.cumsum(PPI.Kp * T / PPI.Tn * e - cut)
    _, cascaded = stepped(PPI, T, way.setpoints(t), read.readings())
    _, alone = stepped(CascadePPI(Kv=PPI.Kv, Kp=PPI.Kp), T, way.setpoints(t), read.readings())
    inertia = Inertia(mass=MASS, viscous=VISCOUS)
    fed = [inertia.step(None, setpoint, T)[1] for setpoint in way.setpoints(t)]
    return [
        Claim(
            "1.j",
            "the sliding variable of the shipped DADSC is (3)",
            RULE,
            misfit(s[1:], LAW.tracking_rate * e_x + e_v),
            most=1e-9,
            equations=("DADSC (3)",),
        ),
        Claim(
            "1.j",
            "its force is (4), with the acceleration in the middle of the sample",
            RULE,
            misfit(force, by_4),
            most=1e-9,
            equations=("DADSC (4)",),
        ),
        Claim(
            "1.j",
            "its estimate is (5) with g1 = m Q ω_d, less what the limit cut off",
            RULE,
            misfit(estimate[1:], by_5),
            most=1e-9,
            equations=("DADSC (5)", "DADSC g1, g2"),
        ),
        Claim(
            "1.j",
            "the force of the shipped cascade, with b x' and what the limit cut off",
            RULE,
            misfit(cascaded, PPI.Kp * e + VISCOUS * v + integral),
            most=1e-9,
            equations=("cascade (7)",),
        ),
        Claim(
            "1.j",
            "the same without integral and without b x'",
            RULE,
            misfit(alone, PPI.Kp * (PPI.Kv * e_x + e_v)),
            most=1e-9,
            equations=("cascade (7)",),
        ),
        Claim(
            "1.j",
            "its acceleration is fed forward in the middle of the sample",
            RULE,
            misfit(fed, MASS * way(2, t + 0.5 * T) + VISCOUS * way(1, t + 0.5 * T)),
            most=1e-9,
            equations=("acceleration feedforward",),
        ),
    ]


def ideal_poles() -> list[Claim]:
    """Check the poles of the ideal loop with the shipped law."""
    law, w = dadsc(300.0), 300.0
    law = DADSC(mass=law.mass, viscous=law.viscous, tracking_rate=200.0, reaching_rate=350.0, adaptation_rate=w)
    poles = np.sort(np.real(ideal_model(law).poles()))
    rates = np.array([200.0, 350.0, w])
    expected = np.sort(np.real(continuous(1.0 / (1.0 + rates * 1e-4), 1e-4)))
    ppi = cascade(300.0)
    lines = np.geomspace(5.0, 500.0, 8000)
    # so short that the bandwidths are those of continuous time
    step = 1e-5
    bands = {}
    for name, ideal, state, plus in (("DADSC", dadsc(300.0), "estimate", 1.0), ("P-PI", ppi, "integral", -1.0)):
        seen = np.abs(plus * ideal_model(ideal, step).response(lines, state, step))
        bands[name] = float(lines[np.argmax(seen < np.sqrt(0.5))])
    rule = "ideal loop of the shipped law, m = 40 kg, b = 60 N s/m, T = 0.1 ms; λ = 200, K = 350, ω_d = 300 1/s"
    band_rule = "-3 dB of estimate (integral) over F_d in the ideal loop of the shipped law, p = 300 1/s, T = 0.01 ms"
    names = ("DADSC (3)", "DADSC (4)", "DADSC (5)", "DADSC g1, g2")
    return [
        Claim(
            "1.k",
            "the poles of the loop are ln(1 + λT)/T, ln(1 + KT)/T and ln(1 + ω_d T)/T",
            rule,
            misfit(poles, expected),
            most=1e-8,
            equations=names,
        ),
        Claim(
            "1.e",
            "bandwidth of the estimate of DADSC",
            band_rule,
            bands["DADSC"],
            least=47.4,
            most=47.9,
            unit="Hz",
            expected="47.7",
            equations=("DADSC g1, g2",),
        ),
        Claim(
            "1.e",
            "bandwidth of the integral of P-PI",
            band_rule,
            bands["P-PI"],
            least=25.8,
            most=26.2,
            unit="Hz",
            expected="26.0",
            equations=("cascade (7)",),
        ),
    ]


def recoveries() -> list[Claim]:
    """Check the exact recovery, its filters, and the Kalman filter."""
    from scipy.linalg import expm, solve_discrete_are
    from scipy.signal import butter, lfilter

    _, _, read = _signals()
    x, F = read.load, read.applied
    v = np.concatenate([[0.0], np.diff(x) / T])
    exact = MASS * np.diff(v) / T + VISCOUS * v[1:] - F[1:]
    late = MASS * np.diff(v) / T + VISCOUS * v[1:] - np.concatenate([[0.0, 0.0], F])[1:SAMPLES]
    corner = 400.0
    pole = np.exp(-2.0 * np.pi * corner * T)
    one = np.asarray(lfilter([1.0 - pole], [1.0, -pole], exact))
    butterworth: Any = butter(2, corner, fs=1.0 / T)
    two = np.asarray(lfilter(butterworth[0], butterworth[1], exact))

    resolution, walk = 1e-7, 8.0
    transition = expm(T * np.array([[0, 1, 0, 0], [0, -VISCOUS / MASS, 1 / MASS, 1 / MASS], [0] * 4, [0] * 4]))
    phi, gamma = transition[:3, :3], transition[:3, 3]
    # the states in counts, so that the Riccati equation is well scaled; a count has the variance 1/12
    size = np.array([resolution, resolution / T, MASS * resolution / T**2])
    scaled, noise = phi * size / size[:, None], 1.0 / 12.0
    # scipy solves the equation of the regulator, of which that of the filter is the dual
    P = solve_discrete_are(scaled.T, np.eye(3)[:, :1], np.diag([0.0, 0.0, (walk / size[2]) ** 2]), [[noise]])
    gain = size * P[:, 0] / (P[0, 0] + noise) / resolution
    state, kalman = np.array([x[0], 0.0, 0.0]), []
    for reading, force in zip(x[1:], F[1:], strict=True):
        before = phi @ state + gamma * force
        state = before + gain * (reading - before[0])
        kalman.append(state)
    by_kalman = np.array(kalman)

    def seen(observer: Observer, what: int = 2) -> list[float]:
        prepared = observer.prepare(T)
        readings = read.readings()
        held = observer.start(prepared, readings[0])
        estimates = []
        for reading in readings[1:]:
            held, estimate = observer.step(prepared, held, reading, T)
            estimates.append(estimate[what])
        return estimates

    made_of: dict[str, Any] = {"mass": MASS, "viscous": VISCOUS}
    kinds: list[tuple[str, Observer, np.ndarray, float, tuple[str, ...]]] = [
        (
            "the exact recovery is the inverse of the axis",
            DisturbanceRecovery(**made_of, form="exact"),
            exact,
            1e-9,
            ("recovery from (6)",),
        ),
        (
            "with two samples of dead time it takes the command before them",
            DisturbanceRecovery(**made_of, form="exact", delay_samples=2),
            late,
            1e-9,
            ("recovery from (6)",),
        ),
        (
            "the first-order form has the pole e^(-2π f T)",
            DisturbanceRecovery(**made_of, form="one_pole", frequency=corner),
            one,
            1e-9,
            ("recovery, filter", "recovery from (6)"),
        ),
        (
            "the second-order form is that of Butterworth",
            DisturbanceRecovery(**made_of, frequency=corner),
            two,
            1e-9,
            ("recovery, Butterworth", "recovery, filter", "recovery from (6)"),
        ),
        (
            "the Kalman filter has the gain of the Riccati equation",
            KalmanRecovery(**made_of, resolution=resolution, force_step=walk),
            by_kalman[:, 2],
            1e-6,
            ("Kalman recovery",),
        ),
    ]
    kalman_filter = kinds[-1][1]
    return [
        Claim(
            "1.l",
            f"{title}, beside scipy",
            RULE,
            misfit(seen(observer), expected),
            most=most,
            equations=names,
        )
        for title, observer, expected, most, names in kinds
    ] + [
        Claim(
            "1.l",
            f"its {name}, beside scipy",
            RULE,
            misfit(seen(kalman_filter, i), by_kalman[:, i]),
            most=1e-6,
            equations=("Kalman recovery",),
        )
        for i, name in enumerate(("position", "velocity"))
    ]


def compensations() -> list[Claim]:
    """Check mode compensation of position, velocity and acceleration with lead time, and the subtracted estimate."""
    from scipy.linalg import expm

    t, way, read = _signals()
    observer = DisturbanceRecovery(mass=MASS, viscous=VISCOUS, form="exact")
    reject = DisturbanceRejection(observer=observer, share=0.7)
    setpoints, readings = way.setpoints(t), read.readings()
    other = reject.prepare(T)
    state, force = reject.start(other, setpoints[0], readings[0]), []
    for setpoint, reading in zip(setpoints[1:], readings[1:], strict=True):
        state, _, push = reject.step(other, state, setpoint, reading, T)
        force.append(push)

    v = np.concatenate([[0.0], np.diff(read.load) / T])
    seen = MASS * np.diff(v) / T + VISCOUS * v[1:] - read.applied[1:]
    w, damping = 2.0 * np.pi * 35.0, 0.03
    m = 2e7 / w**2
    rate = np.array([[0.0, 1.0, 0.0], [-w * w, -2.0 * damping * w, 1.0 / m], [0.0, 0.0, 0.0]])
    sample, lead = expm(rate * T), expm(rate * 1.5 * T)
    pushes = {"tool": -seen, "base": -read.applied[1:], "fixture": seen - m * way(2, t[1:])}
    rule = f"mode of 35 Hz, ζ 0.03, 20 N/µm, lead 1.5 T; {RULE}"
    claims = []
    for place, push in pushes.items():
        mode = MachineMode(frequency=35.0, damping_ratio=0.03, stiffness=2e7, place=place)
        moved = _moved(ModeCompensation(modes=(mode,), observer=observer), setpoints, readings)
        at, expected = np.zeros(2), []
        sign = 1.0 if place == "tool" else -1.0
        for pushed in push:
            after = (sample @ [*at, pushed])[:2]
            now = after if place == "base" else (lead @ [*at, pushed])[:2]
            expected.append([*now, pushed / m - 2.0 * damping * w * now[1] - w * w * now[0]])
            at = after
        wanted = sign * np.array(expected)
        # the set position is about 10 mm, the added part a few nm: differences in m lose digits
        claims += [
            Claim(
                "1.l",
                f"what compensation of a mode of the {place} adds to the set {name}, beside scipy",
                rule,
                misfit(moved[:, i], wanted[:, i]),
                most=most,
                equations=("mode compensation",),
            )
            for i, (name, most) in enumerate((("position", 1e-5), ("velocity", 1e-9), ("acceleration", 1e-9)))
        ]
    return [
        *claims,
        Claim(
            "1.l",
            "the force of a rejection with a share of 0.7",
            RULE,
            misfit(force, -0.7 * seen),
            most=1e-9,
            equations=("disturbance rejection",),
        ),
    ]


def _moved(block: ModeCompensation, setpoints: list[Setpoint], readings: list[Reading]) -> np.ndarray:
    """Return the corrections to position, velocity and acceleration, from the second sample on."""
    prepared = block.prepare(T)
    held, moves = block.start(prepared, setpoints[0], readings[0]), []
    for setpoint, reading in zip(setpoints[1:], readings[1:], strict=True):
        held, there, _ = block.step(prepared, held, setpoint, reading, T)
        moves.append([there[i] - setpoint[i] for i in range(3)])
    return np.array(moves)


ROWS = (law_equations, ideal_poles, recoveries, compensations)
