"""Claims 1.a to 1.c: the equations of the paper, in the ideal loop."""

from dataclasses import dataclass, replace

import numpy as np

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.feedforward.inertia import Inertia
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text
from feeddrive.papers.altintas2009 import testbed
from feeddrive.papers.altintas2009.testbed import MASS, PLANT, VISCOUS, Fraction, Ideal, T
from feeddrive.papers.claims import Claim, printed, within
from feeddrive.plot.curves import pole_sweep_chart
from feeddrive.report.report import Picture

R = T / MASS
# r2 and r4 of the pole map, as they grow: r4 faster than r2
SWEEP = ((56e3, 168.0), (56e3, 840.0), (56e3, 16e3), (112e3, 64e3), (224e3, 256e3))
IDEAL = f"ideal loop (force answers the reading of the same sample), {PLANT}"


def residual_6(law: DADSC, run: Ideal) -> np.ndarray:
    """Return the residual of (6) in m/s: (Q + g1 R) s(k) - (1 + Q + g2 R) s(k-1) + s(k-2) + R (F_d(k) - F_d(k-1))."""
    g1, g2 = law.prepare(T)
    Q = 1.0 + law.reaching_rate * T
    s = law.tracking_rate * run.position_error + run.velocity_error
    return (Q + R * g1) * s[2:] - (1.0 + Q + R * g2) * s[1:-1] + s[:-2] + R * np.diff(run.disturbance)[1:]


def residual_7(law: CascadePPI, run: Ideal) -> np.ndarray:
    """Return the residual of (7) in m/s: Q' Δs(k) - Δs(k-1) - Kv T Δe_v(k) + R (Kp T/Tn) s(k) + R ΔF_d(k), Q' = 1 +
    Kp R.
    """
    assert law.Tn is not None
    s = law.Kv * run.position_error + run.velocity_error
    moved = np.diff(s)
    left = (1.0 + law.Kp * R) * moved[1:] - moved[:-1] - law.Kv * T * np.diff(run.velocity_error)[1:]
    return left + R * (law.Kp * T / law.Tn) * s[2:] + R * np.diff(run.disturbance)[1:]


def recovered(law: DADSC, run: Ideal) -> np.ndarray:
    """Return F_d from sample 1 onward, N: [(Q + g1 R) F̂d(k) - Q F̂d(k-1) - (g2 Q - g1) s(k-1)] / (g1 R), the inverse
    of (6).
    """
    g1, g2 = law.prepare(T)
    Q = 1.0 + law.reaching_rate * T
    estimate = np.array([state.estimate for state in run.states])
    s = np.array([state.sliding for state in run.states])
    return ((Q + g1 * R) * estimate[1:] - Q * estimate[:-1] - (g2 * Q - g1) * s[:-1]) / (g1 * R)


def cascade_recovered(law: CascadePPI, run: Ideal) -> np.ndarray:
    """Return F_d as `recovered` does, for the cascade, whose integral is -F̂d, with Q' = 1 + Kp R and g1' = Kp T/Tn."""
    assert law.Tn is not None
    Q, g1 = 1.0 + law.Kp * R, law.Kp * T / law.Tn
    estimate = -np.array([state.integral for state in run.states])
    s = law.Kv * run.position_error + run.velocity_error
    held = g1 * s[:-1] + g1 * law.Kv * T * run.velocity_error[1:]
    return ((Q + g1 * R) * estimate[1:] - Q * estimate[:-1] + held) / (g1 * R)


@dataclass(frozen=True)
class Pair:
    """A law in the ideal loop, and its transfer function by (8)."""

    name: str
    run: Ideal
    closed: Fraction
    printed: Fraction


def _run(law: DADSC | CascadePPI, disturbance: np.ndarray, setpoint: np.ndarray | None = None) -> Ideal:
    # DADSC feeds the acceleration forward itself; the cascade of the paper has it beside the law
    forward = None if isinstance(law, DADSC) else Inertia(mass=MASS)
    return testbed.run_ideal(law, MASS, VISCOUS, T, disturbance, setpoint=setpoint, feedforward=forward)


def equations() -> tuple[list[Claim], list[Picture]]:
    """Return claims 1.a to 1.c, which check the equations, and their pictures."""
    # the second law has g2 = 0.9 g1/Q, so that the coupling of estimate and s does not vanish
    law, ppi = testbed.dadsc(300.0), testbed.cascade(300.0)
    coupled = replace(law, adaptation_ratio=0.9)
    disturbance = 100.0 * np.random.default_rng(1).normal(size=3000)
    claims = [
        *_residuals(law, coupled, ppi, disturbance),
        *_implicit(law, coupled, ppi),
        *_closed_form(law, ppi),
    ]
    poles, pictures = _pole_map()
    return claims + poles, pictures


def _residuals(law: DADSC, coupled: DADSC, ppi: CascadePPI, disturbance: np.ndarray) -> list[Claim]:
    rule = f"{IDEAL}; 3000 samples of white F_d, 100 N RMS, seed 1"
    free, other, cascaded = (_run(loop_, disturbance) for loop_ in (law, coupled, ppi))
    worst = {
        "(6), DADSC": residual_6(law, free),
        "(6) with g2 = 0.9 g1/Q": residual_6(coupled, other),
        "(7), cascade with b x'": residual_7(ppi, cascaded),
    }
    exact = {
        "DADSC": recovered(law, free),
        "DADSC with g2 = 0.9 g1/Q": recovered(coupled, other),
        "the cascade": cascade_recovered(ppi, cascaded),
    }
    return [
        *(
            Claim("1.a", f"{name} holds along a run", rule, float(np.max(np.abs(left))), None, 1e-10, "m/s")
            for name, left in worst.items()
        ),
        *(
            Claim(
                "1.a",
                f"the inverse of the loop gives F_d back exactly under {name}",
                rule,
                float(np.max(np.abs(recovered_force - disturbance[1:]))),
                most=1e-9,
                unit="N",
            )
            for name, recovered_force in exact.items()
        ),
    ]


def _implicit(law: DADSC, coupled: DADSC, ppi: CascadePPI) -> list[Claim]:
    """Check x/x_r = 1, the disturbance estimate without and with the coupling term, and the Lyapunov function."""
    still = np.zeros(2000)
    # the third power has no velocity and no acceleration at t = 0, where the loop is at rest
    way = 0.05 * np.sin(2.0 * np.pi * 5.0 * T * np.arange(still.size)) ** 3
    rule = f"{IDEAL}; x_r = 50 mm · sin³ at 5 Hz, no disturbance"
    claims = [
        Claim(
            "1.a",
            f"x/x_r = 1 under {name}",
            rule,
            float(np.max(np.abs(_run(loop_, still, way).position_error))),
            most=1e-12,
            unit="m",
        )
        for name, loop_ in (("DADSC", law), ("the cascade", ppi))
    ]
    step = np.full(600, 200.0)
    fall = 1.0 / (1.0 + law.adaptation_rate * T)
    rule = f"{IDEAL}; F_d = 200 N from the first sample on"
    off, states = {}, {}
    for name, loop_ in (("free", law), ("coupled", coupled)):
        states[name] = _run(loop_, step).states
        left = 200.0 - np.array([state.estimate for state in states[name]])
        off[name] = float(np.max(np.abs(left[1:] - fall * left[:-1])))
    # from (6): the estimate leaves the line by (g2 Q - g1) s(k-1) / (Q + g1 R)
    g1, g2 = coupled.prepare(T)
    Q = 1.0 + coupled.reaching_rate * T
    largest = max(abs(state.sliding) for state in states["coupled"])
    leaves = abs(g2 * Q - g1) * largest / (Q + g1 * R)
    claims += [
        Claim(
            "1.a",
            "with g2 = g1/Q the estimate's error falls by 1/(1 + ω_d T) each sample",
            rule,
            off["free"],
            most=1e-9,
            unit="N",
        ),
        Claim(
            "1.a",
            "with g2 Q - g1 = -0.1 g1 the estimate depends on s: the error leaves that line",
            rule,
            off["coupled"],
            *within(leaves, 1e-6),
            unit="N",
            expected="(g2 Q - g1) s/(Q + g1 R) by (6)",
        ),
    ]
    run = _run(law, step)
    mu = lyapunov_weight(law)
    s = np.array([state.sliding for state in run.states])
    left = 200.0 - np.array([state.estimate for state in run.states])
    value = s**2 + mu * left**2
    growth = float(np.max(value[1:] / value[:-1]))
    # of (s, F̃), with V = zᵀ P z: no state lets V fall less than the largest eigenvalue of P⁻¹ Aᵀ P A
    A = np.array([[1.0 / Q, -R * fall / Q], [0.0, fall]])
    scaled = np.diag([1.0, mu**0.5]) @ A @ np.diag([1.0, mu**-0.5])
    slowest = float(np.linalg.norm(scaled, 2) ** 2)
    return [
        *claims,
        Claim(
            "1.a",
            Text(f"V = s² + μ F̃² falls in every sample (μ = {Quantity(mu, 'm'):3 SI}²/(s² N²))"),
            rule,
            growth,
            # in the end the states fall by the slowest pole alone
            least=fall**2,
            most=slowest * (1.0 + 1e-6),
            expected=f"largest factor in a sample {number(slowest, 4)} from any state, {number(fall**2, 4)} in the end",
        ),
    ]


def lyapunov_weight(law: DADSC, sample_time: float = T) -> float:
    """Return twice the smallest μ for which V = s² + μ F̃² decreases for every s and F̃ under a constant disturbance,
    m²/(s² N²).

    F̃(k) = f F̃(k-1) and Q s(k) = s(k-1) - R f F̃(k-1) with f = 1/(1 + ω_d T).  V decreases for all states if P - AᵀPA
    is positive definite, where A is the transition matrix of (s, F̃) and P = diag(1, μ):

    μ (1 - f²) > (R f/Q)² (1 + 1/(Q² - 1))
    """
    Q = 1.0 + law.reaching_rate * sample_time
    f = 1.0 / (1.0 + law.adaptation_rate * sample_time)
    r = sample_time / law.mass * f / Q
    return 2.0 * r * r * (1.0 + 1.0 / (Q * Q - 1.0)) / (1.0 - f * f)


def _closed_form(law: DADSC, ppi: CascadePPI) -> list[Claim]:
    kick = np.zeros(1000)
    kick[0] = 1.0
    assert ppi.Tn is not None
    claims = []
    columns = (
        ("DADSC", law, testbed.dadsc_column(law, T)),
        ("cascade", ppi, testbed.cascade_column(ppi.Kv, ppi.Kp, ppi.Tn, T)),
    )
    for name, loop_, column in columns:
        response = _run(loop_, kick).position
        # the printed form is evaluated, too: the claim shows that it is a misprint
        for as_printed in (False, True):
            expected = testbed.transfer(column, MASS, T, printed=as_printed).impulse(kick.size)
            off = float(np.max(np.abs(response - expected)) / np.max(np.abs(response)))
            rule = f"{IDEAL}; F_d = 1 N in sample 0; largest difference over the peak, 1000 samples"
            if as_printed:
                claims.append(
                    Claim(
                        "1.b",
                        f"(8) as printed, z² - 1, is not the loop: {name}",
                        rule,
                        off,
                        least=0.1,
                        one_sided="any difference beyond rounding shows the misprint",
                    )
                )
            else:
                claims.append(Claim("1.b", f"(8) with z² - z is the impulse response: {name}", rule, off, None, 1e-9))
    # coefficients, not roots: a triple root keeps only a third of the digits
    factors = np.poly(testbed.closed_form_poles(law, T))
    denominator = testbed.transfer(testbed.dadsc_column(law, T), MASS, T).denominator
    off = float(np.max(np.abs(denominator / denominator[0] - factors)))
    rule = "coefficients of the denominator of (8) against the product of its three factors"
    return [*claims, Claim("1.b", "with g2 = g1/Q the poles are 1/(1+λT), 1/Q, Q/(Q+g1R)", rule, off, None, 1e-13)]


def _pole_map() -> tuple[list[Claim], list[Picture]]:
    """Compare the poles of both laws at the same r2 and r4, with λ = Kv = 200 1/s."""
    ours, theirs = [], []
    for r2, r4 in SWEEP:
        # table 1 of the paper: r2 = m K = Kp and r4 = g1 = m Q ω_d = Kp T/Tn
        K = r2 / MASS
        law = DADSC(
            mass=MASS,
            viscous=VISCOUS,
            tracking_rate=200.0,
            reaching_rate=K,
            adaptation_rate=r4 / (MASS * (1.0 + K * T)),
        )
        ours.append(testbed.ideal_model(law).poles())
        theirs.append(testbed.ideal_model(CascadePPI(Kv=200.0, Kp=r2, Tn=r2 * T / r4, viscous=VISCOUS)).poles())
    rule = "poles of the ideal loop with the laws as shipped, s = ln z / T; λ = Kv = 200 1/s; "
    rule += "(r2, r4) = (56000, 168), (56000, 840), (56000, 16000), "
    rule += "(112000, 64000), (224000, 256000)"
    swing = [float(np.max(np.abs(poles.imag))) for poles in theirs]
    largest = theirs[-1][np.argmax(theirs[-1].imag)]
    claims = [
        Claim(
            "1.c",
            "all poles of DADSC are real along the sweep",
            rule,
            max(float(np.max(np.abs(poles.imag))) for poles in ours),
            most=1e-4,
            unit="rad/s",
        ),
        Claim("1.c", "the cascade's are real at the first two points", rule, max(swing[:2]), None, 1e-4, "rad/s"),
        Claim(
            "1.c",
            "and complex from the third on: the least imaginary part",
            rule,
            min(swing[2:]),
            *printed("1790"),
            unit="rad/s",
            expected="-745 + 1790j",
        ),
        Claim(
            "1.c", "the cascade's last pair: real part", rule, largest.real, -3900.0, -3896.0, "rad/s", "-3898 + 5354j"
        ),
        Claim("1.c", "the cascade's last pair: imaginary part", rule, largest.imag, 5350.0, 5358.0, "rad/s", "5354"),
    ]
    picture = Picture(
        "poles",
        "Poles as the gains grow",
        "Poles of (8) with the same r2 and r4, which grow along the sweep (marks grow with them; r4 faster than r2). "
        "Raised together, r2 and r4 would bring the cascade's poles back to the real axis.",
        "Pole map: DADSC stays on the real axis, the cascade leaves it from the third point on.",
        lambda: pole_sweep_chart({"DADSC": ours, "P-PI cascade": theirs}),
    )
    return claims, [picture]
