"""Claims 4.o to 4.r: the shipped compensator, error model and update, compared with an independent evaluation, and the
claim G = 1.
"""

from collections.abc import Callable, Mapping

import numpy as np

from feeddrive.blocks.families import Reference
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import tree
from feeddrive.language.quantity import number
from feeddrive.learning.iterative_feedforward import compensated, convergence, error_model, filtered, next_iteration
from feeddrive.learning.trial import simulated_trial
from feeddrive.loop.linearize import tracking
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import samples, simulate
from feeddrive.papers.claims import RANDOM, SAMPLES, Claim, RandomMotion, misfit, within
from feeddrive.papers.wu2017.rates import TRUE, ideal_axis, ideal_run
from feeddrive.papers.wu2017.testbed import FORCE_CONSTANT, SAME, move

T = 2.5e-4
KV, KP, TN = 40.0, 150.0 * FORCE_CONSTANT, 15e-3  # 1/s, N s/m, s: the gains of the machine file
SHORT = move(0.02, 0.1, 3.0, 60.0)
# powers of 1/z of G_d with a = 0.4 A s²/m, b = 4/3 A s/m, from an independent program
GOLDEN_TOP = (0.0, 7.810330294e-8, -2.169220359e-11, -7.808161073e-8)
GOLDEN_BOTTOM = (1.0, -2.951047569, 2.951466492, -1.047252271, 0.046848966)
OFF = {"mass": 6.0, "viscous": 30.0, "coulomb_positive": 5.0, "coulomb_negative": -4.0}  # initial deviation from θ0


def columns(v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Compute φ of (7) from velocity and acceleration: a, v and the two Coulomb terms."""
    # below 1e-9 m/s the set velocity is the rounding of a standstill, which has no direction
    return np.column_stack([a, v, np.where(v > 1e-9, 1.0, 0.0), np.where(v < -1e-9, -1.0, 0.0)])


def inverse(kp: float = KP) -> tuple[np.ndarray, np.ndarray]:
    """Return numerator and denominator of Δ/C in powers of 1/z.

    Here Δ = 1 - 1/z and C = Kp (1 + T/Tn - 1/z)(Kv + (1 - 1/z)/T).
    """
    pi = np.array([1.0 + T / TN, -1.0])
    return np.array([1.0, -1.0]), kp * np.polymul(pi, [KV + 1.0 / T, -1.0 / T])


def feedforward() -> list[Claim]:
    """Check φᵀ θ with all basis functions, along a motion through standstill."""
    t = T * np.arange(SAMPLES)
    way = RandomMotion(3)
    middle = t + 0.5 * T
    slower = 1e-2
    v0 = way(1, middle[40:41])
    v = slower * (way(1, middle) - v0)
    theta = {**TRUE, "stribeck": 35.0, "jerk_feedforward": 0.02, "snap_feedforward": 1e-5}
    block = DisturbanceCompensator(**theta, stribeck_velocity=6e-3)
    forces = []
    for k in range(t.size):
        x, vk, *rest = (float(slower * way(i, t[k : k + 1])[0]) for i in range(5))
        forces.append(block.step(None, Setpoint(x, vk - slower * float(v0[0]), *rest), T)[1])
    phi = columns(v, slower * way(2, middle))
    expected = phi @ np.array(list(TRUE.values()))
    expected = expected + 35.0 * np.sign(v) * np.exp(-((v / 6e-3) ** 2))
    expected = expected + 0.02 * slower * way(3, middle) + 1e-5 * slower * way(4, middle)
    return [
        Claim(
            "4.o",
            "The force of the shipped compensator is φᵀ θ in the middle of the sample",
            f"{RANDOM.split(' of random')[0]} along a motion of the fourth degree through standstill, all columns",
            misfit(forces, expected),
            most=1e-9,
            equations=("compensator (6), (7)",),
        ),
    ]


def _exact() -> Loop:
    """Return the x axis with viscous friction only, without quantization and dead time, with the true parameters."""
    return tree.vary(ideal_axis(TRUE), {"axis.x.actuator.dead_time": 0.0})


def models() -> list[Claim]:
    """Check the model-free and model-based Ĝ_d against difference equations."""
    from scipy.signal import lfilter, lfilter_zi

    loop = _exact()
    push = np.zeros((400, 1))
    push[0] = 1.0
    free = filtered(error_model(loop, "model_free"), push)[:, 0]
    based = filtered(error_model(loop, "model_based", plant=Rigid(mass=120.0, viscous=400.0)), push)[:, 0]
    # with the first value at all times before
    steps = np.concatenate([np.full((50, 1), 2.0), np.full((350, 1), -1.0)])
    moving = filtered(error_model(loop, "model_free"), steps, moving=True)[:, 0]
    top, bottom = inverse()
    kept, _ = lfilter(top, bottom, steps[:, 0], zi=2.0 * lfilter_zi(top, bottom))
    expected_free = np.asarray(lfilter(top, bottom, push[:, 0]))
    expected_based = np.asarray(lfilter(GOLDEN_TOP, GOLDEN_BOTTOM, push[:, 0])) / FORCE_CONSTANT
    rule = "impulse response over 400 samples; x axis without dead time; largest difference over the largest value"
    return [
        Claim(
            "4.p",
            "The model-free Ĝ_d is the inverse of the P-PI law",
            rule,
            misfit(free, expected_free),
            most=1e-8,
            equations=("error model, model-free",),
        ),
        Claim(
            "4.p",
            "and goes on from a motion that lasted",
            rule.replace("impulse response", "two steps"),
            misfit(moving, kept),
            most=1e-8,
            equations=("error model, model-free",),
        ),
        Claim(
            "4.p",
            "G_d with the axis's mass is that of an independent program",
            rule,
            misfit(based, expected_based),
            most=2e-5,
            expected="to the ten digits of its coefficients",
            equations=("error model, model-based",),
        ),
    ]


def _step(loop: Loop, believed: Loop, theta: Mapping[str, float], gamma: float) -> dict[str, float]:
    """Return the parameters after one trial of the loop, updated by a tuner that assumes the loop `believed`."""
    run = ideal_run(compensated(loop, DisturbanceCompensator(**theta)), SHORT)
    tuner = compensated(believed, DisturbanceCompensator(**theta))
    after = next_iteration(tuner, simulated_trial(run, SHORT), gamma=gamma, mu=0.0, at_rest="none").after
    return {name: float(value) for name, value in after.parameters().items()}


def update() -> list[Claim]:
    """Check that one update is the least-squares step, and that it converges at the rate predicted by `convergence`."""
    from scipy.signal import lfilter

    loop = ideal_axis(TRUE)
    start = {name: TRUE[name] + off for name, off in OFF.items()}
    run = ideal_run(compensated(loop, DisturbanceCompensator(**start)), SHORT)
    trial = simulated_trial(run, SHORT)
    # gamma other than 1, so that it appears in the claim; mu = 0, since regularization shortens the step
    after = next_iteration(
        compensated(loop, DisturbanceCompensator(**start)), trial, gamma=0.7, mu=0.0, at_rest="none"
    ).after
    psi = lfilter(*inverse(), _along(SHORT), axis=0)
    step = np.linalg.lstsq(psi, run["following_error"], rcond=None)[0]
    expected = np.array(list(start.values())) + 0.7 * step
    rule = "x axis, friction along the set velocity, 20 mm at 0.1 m/s, model-free, gamma 0.7"
    # the distance of two starts: the dead time shifts the fixed point away from θ0, for both alike
    one, other = (
        _step(loop, loop, {name: TRUE[name] + sign * off for name, off in OFF.items()}, 1.0) for sign in (1.0, -1.0)
    )
    moved = np.array([one[name] - other[name] for name in TRUE])
    sizes = np.linalg.norm(psi, axis=0)
    apart_first = 2.0 * np.array(list(OFF.values())) * sizes
    predicted = convergence(loop, SHORT).matrix @ apart_first
    return [
        Claim(
            "4.q",
            "One step is gamma times the least-squares step through Δ/C",
            rule,
            float(np.max(np.abs(np.array(list(after.parameters().values())) / expected - 1.0))),
            most=1e-6,
            equations=("update", "error model, model-free"),
        ),
        Claim(
            "4.q",
            "What is left of two starts after a step is what `convergence` says",
            f"largest difference over the distance of the starts; {rule.replace('0.7', '1')}",
            float(np.max(np.abs(moved * sizes - predicted)) / np.linalg.norm(apart_first)),
            most=1e-6,
            equations=("update", "convergence"),
        ),
    ]


def _along(reference: Reference) -> np.ndarray:
    """Return φ of (7) in the middle of the samples of a reference."""
    at = reference.at(T * (np.arange(samples(reference.duration, T)) + 0.5))
    return columns(np.asarray(at.velocity), np.asarray(at.acceleration))


def believed_gains() -> list[Claim]:
    """Check the rates of convergence of tuners that assume half and twice the actual gain, over four trials each."""
    from scipy.signal import lfilter

    loop = ideal_axis(TRUE)
    claims = []
    size = np.linalg.norm(lfilter(*inverse(), _along(SHORT), axis=0), axis=0)
    true = np.array(list(TRUE.values()))
    for factor, gamma in ((0.5, 1.0), (2.0, 1.0), (2.0, 0.5), (0.5, 0.5)):
        believed = tree.vary(loop, {"axis.x.control.law.Kp": factor * KP})
        # the distance of two starts, as in `update`
        here = {name: TRUE[name] + off for name, off in OFF.items()}
        there = {name: TRUE[name] - off for name, off in OFF.items()}
        distances = []
        for _ in range(5):
            distances.append(sum(((here[name] - there[name]) / TRUE[name]) ** 2 for name in TRUE) ** 0.5)
            here, there = _step(loop, believed, here, gamma), _step(loop, believed, there, gamma)
        matrix = convergence(loop, SHORT, believed=believed, gamma=gamma).matrix
        third, fourth = (
            float(
                np.linalg.norm(
                    np.linalg.matrix_power(matrix, n) @ (2.0 * np.array(list(OFF.values())) * size) / size / true
                )
            )
            for n in (3, 4)
        )
        verb = "diverges" if (factor, gamma) == (2.0, 1.0) else "converges"
        claims.append(
            Claim(
                "4.i",
                f"gains believed x {number(factor)}, gamma {number(gamma)}: {verb}, two starts move together by",
                "x axis, friction along the set velocity, 20 mm at 0.1 m/s, model-free, columns a, b, Coulomb; "
                "ratio of their distance in the fourth trial to that in the third",
                distances[4] / distances[3],
                *within(fourth / third, 0.01),
                expected=f"{number(fourth / third, 3)} by powers of the matrix of `convergence`, to 1 %"
                + {(0.5, 1.0): "; rho 0.52 was stated", (2.0, 1.0): "; rho 1.04 was stated"}.get((factor, gamma), ""),
                equations=("update", "error model, model-free"),
            )
        )
    return claims


def _by_lsim(mass: float) -> float:
    """Return the largest error in µm on the 100 mm move if `mass` in kg too much is fed forward: the force behind
    P/(1 + P C) with P = 1/(m s² + b s) and C = Kp (1 + 1/(Tn s))(Kv + s), integrated by scipy.
    """
    from scipy.signal import lsim

    time = T * np.arange(samples(SAME.duration, T))
    axis = np.polymul([TRUE["mass"], TRUE["viscous"], 0.0], [1.0, 0.0])
    bottom = np.polyadd(axis, KP * np.polymul([1.0, KV], [1.0, 1.0 / TN]))
    force = mass * np.asarray(SAME.at(time).acceleration, dtype=float)
    return 1e6 * float(np.max(np.abs(lsim(([1.0, 0.0], bottom), force, time)[1])))


def unity() -> list[Claim]:
    """Check G = 1 by (4), (6) and (7): with the exact inverse and the set velocity, the set motion causes no error."""
    loop = _exact()
    lines = np.geomspace(1.0, 30.0, 200)
    off = float(np.max(np.abs(tracking(loop, lines).response - 1.0)))
    heavy = compensated(
        loop,
        DisturbanceCompensator(
            **{**TRUE, "mass": 1.05 * TRUE["mass"], "coulomb_positive": 0.0, "coulomb_negative": 0.0}
        ),
    )
    plain = compensated(loop, DisturbanceCompensator(mass=TRUE["mass"], viscous=TRUE["viscous"]))
    still = simulate(plain, SAME, record=("tracking_error",))["tracking_error"]
    wrong = simulate(heavy, SAME, record=("tracking_error",))["tracking_error"]
    rule = "x axis without friction but the viscous one, quantizer and dead time; a and b exact"
    return [
        Claim(
            "4.r",
            "G = 1: largest |G - 1| from 1 to 30 Hz",
            f"linear; {rule}",
            off,
            most=1e-4,
            expected="1 by (4), (6), (7)",
            equations=("compensator (6), (7)",),
        ),
        Claim(
            "4.r",
            "G = 1: largest error on the 100 mm move",
            rule,
            1e9 * float(np.max(np.abs(still))),
            most=5.0,
            unit="nm",
            expected="0",
            equations=("compensator (6), (7)",),
        ),
        Claim(
            "4.r",
            "5 % of the mass undo it: largest error on that move",
            rule,
            1e6 * float(np.max(np.abs(wrong))),
            *within(_by_lsim(0.05 * TRUE["mass"]), 0.01),
            unit="um",
            expected=f"{number(_by_lsim(0.05 * TRUE['mass']), 4)} by scipy in continuous time, to 1 %",
        ),
    ]


ROWS: tuple[Callable[[], list[Claim]], ...] = (feedforward, models, update, unity)
