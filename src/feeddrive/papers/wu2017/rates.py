"""Claims 4.g to 4.j: the error model against the simulated loop, rates of convergence, noise and condition number."""

import dataclasses

import numpy as np
from scipy.signal import lsim
from scipy.stats import chi2

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.families import Reference
from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.sequence import Sequence
from feeddrive.language import tree
from feeddrive.language.errors import UnstableError
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text
from feeddrive.learning import iterative_feedforward
from feeddrive.learning.trial import simulated_trial
from feeddrive.loop.loop import Loop
from feeddrive.loop.simulate import Run, samples, simulate
from feeddrive.papers.claims import Claim, printed
from feeddrive.papers.wu2017 import testbed
from feeddrive.papers.wu2017.testbed import SAME, SETS, amperes, move, table_axis
from feeddrive.report.report import Picture

TRUE = {"mass": 120.0, "viscous": 400.0, "coulomb_positive": 95.0, "coulomb_negative": 80.0}
# with the first and the last the model loop is unstable and must be refused
MASSES = (0.01, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
EXPECTED_RATES = {0.1: 0.035, 0.5: 0.020, 1.0: 0.0, 2.0: 0.051, 5.0: 0.253, 10.0: 0.66}
SEEDS, STRONG = 60, 20.0  # number of runs and noise in N of the row on noise
EXPECTED_SCATTER = (0.0008, 0.0115, 0.0067, 0.0059)  # A units, at 20 N
_RECORDED = ("following_error", "force", "requested", "trip")


def rates() -> tuple[list[Claim], list[Table], list[Picture]]:
    """Return claims 4.g to 4.j, their tables and their pictures."""
    by_mass, mass_table, curve = _by_mass()
    gain_table = _by_gain()
    scatter, scatter_table = _scatter()
    return (
        [_identity(), *_one_step(), *by_mass, *scatter, *_condition()],
        [
            mass_table,
            gain_table,
            scatter_table,
        ],
        [curve],
    )


def ideal_axis(theta: dict[str, float]) -> Loop:
    """Return the x axis without quantization and with viscous friction only, for which the error model is exact."""
    loop = table_axis("x", SETS["+ Coulomb"])
    axis = dataclasses.replace(
        loop.axis,
        plant=Rigid(mass=TRUE["mass"], viscous=TRUE["viscous"]),
        friction_load=None,
        encoder_load=None,
        # without dry friction the linear core is exact in one substep
        substeps=1,
    )
    return iterative_feedforward.compensated(dataclasses.replace(loop, axis=axis), DisturbanceCompensator(**theta))


def ideal_run(loop: Loop, reference: Reference, noise: float = 0.0, seed: int = 0) -> Run:
    """Simulate with friction evaluated at the set velocity and delayed by the drive's dead time, plus white force
    noise in N.
    """
    T = float(loop.sample_time)
    t = np.arange(samples(reference.duration, T)) * T
    dry = DisturbanceCompensator(coulomb_positive=95.0, coulomb_negative=80.0)
    along = reference.at(t)
    force = -np.broadcast_to(dry.step(dry.start(along), along, T)[1], t.shape)
    # as late as the drive's force, so that the compensator could cancel it exactly
    late = np.concatenate([[0.0], force[:-1]])
    late = late + noise * np.random.default_rng(seed).standard_normal(t.size)
    return simulate(loop, reference, load=RecordedForce(force=late, sample_time=T), record=_RECORDED)


def identity_error() -> float:
    """Return the largest difference between e(θ) - e(θ0) and G_d φᵀ (θ0 - θ), relative to the largest value of the
    second expression.
    """
    start = {"mass": 30.0, "viscous": 0.0, "coulomb_positive": 0.0, "coulomb_negative": 0.0}
    errors = [ideal_run(ideal_axis(theta), SAME)["following_error"] for theta in (start, TRUE)]
    loop = ideal_axis(start)
    t = np.arange(errors[0].size) * float(loop.sample_time)
    names, phi, _ = iterative_feedforward.regressors(loop, iterative_feedforward.compensator(loop), SAME.at(t))
    off = np.array([TRUE[name] - start[name] for name in names])
    predicted = iterative_feedforward.filtered(iterative_feedforward.true_error_model(loop), phi) @ off
    return float(np.max(np.abs(errors[0] - errors[1] - predicted)) / np.max(np.abs(predicted)))


def _identity() -> Claim:
    rule = "x axis, friction along the set velocity, no noise, no quantizer; theta = [0.1, 0, 0, 0] against theta0"
    title = "e(theta) - e(theta0) is G_d phi' (theta0 - theta): largest deviation over largest value"
    return Claim("4.g", title, rule, identity_error(), None, 1e-8, "", "1.5e-10")


def _one_step() -> list[Claim]:
    start = {"mass": 30.0, "viscous": 0.0, "coulomb_positive": 0.0, "coulomb_negative": 0.0}
    loop = ideal_axis(start)
    trial = simulated_trial(ideal_run(loop, SAME), SAME)
    # mu = 0: a regularized step would be shorter than the exact one
    after = iterative_feedforward.next_iteration(
        loop, trial, form="model_based", plant=loop.axis.plant, mu=0.0, at_rest="none"
    ).after.parameters()
    rule = "as before, one step with the exact model, gamma 1; what is left is the dead time of one sample"
    wanted = {
        "mass": (0.4003, 1e-4),
        "viscous": (1.289, 1e-3),
        "coulomb_positive": (0.323, 1e-3),
        "coulomb_negative": (0.273, 1e-3),
    }
    return [
        Claim(
            "4.g",
            f"one exact-model step from [0.1, 0, 0, 0]: {name}",
            rule,
            amperes(float(after[name])),
            least=value - width,
            most=value + width,
            unit="A units",
            expected=number(value),
        )
        for name, (value, width) in wanted.items()
    ]


def _by_mass() -> tuple[list[Claim], Table, Picture]:
    """Compute the rate of convergence versus the mass assumed by the model; the model used for the figures of the table
    has no dead time.
    """
    loop = table_axis("x", SETS["+ Coulomb"], exact=True)
    prompt = tree.vary(loop, {"axis.x.actuator.dead_time": 0.0})
    free = iterative_feedforward.convergence(loop, SAME).rate
    by_knowledge: dict[str, list[float]] = {"dead time left out": [], "dead time known": []}
    rows: list[list[str | float | Quantity]] = []
    for ratio in MASSES:
        cells: list[str | float] = [ratio]
        for believed, name in ((prompt, "dead time left out"), (loop, "dead time known")):
            rate = _rate(loop, believed, ratio)
            by_knowledge[name].append(rate)
            cells.append("model loop unstable" if rate != rate else rate)
        rows.append([*cells, Quantity(EXPECTED_RATES[ratio]) if ratio in EXPECTED_RATES else "unstable"])
    rule = "x axis, columns a, b, Coulomb, 100 mm move; the true loop has a dead time of one sample, the model none"
    claims = [Claim("4.h", "model-free: rho", rule, free, *printed("0.039"), "", "0.039")]
    prompted = dict(zip(MASSES, by_knowledge["dead time left out"], strict=True))
    for ratio, wanted in EXPECTED_RATES.items():
        heading = f"model-based, assumed mass x {number(ratio)}: rho"
        # 0.002 in addition, since 0 is expected for the right mass; a rate is never less than 0
        claims.append(
            Claim(
                "4.h",
                heading,
                rule,
                prompted[ratio],
                least=max(0.9 * wanted - 0.002, 0.0),
                most=1.1 * wanted + 0.002,
                expected=f"{number(wanted)}, to 10 % and 0.002",
            )
        )
    refused = sum(prompted[ratio] != prompted[ratio] for ratio in (MASSES[0], MASSES[-1]))
    exact = by_knowledge["dead time known"]
    claims += [
        Claim("4.h", "model loops refused as unstable, of the masses x 0.01 and x 20", rule, float(refused), 2.0, 2.0),
        Claim(
            "4.h",
            "assumed mass right, dead time known: rho",
            rule.replace("the model none", "and so has the model"),
            exact[MASSES.index(1.0)],
            most=1e-9,
            expected="0",
        ),
    ]
    columns = [
        Column("assumed mass / mass", ""),
        Column("rho, dead time left out", "", ".3f"),
        Column("rho, dead time known", "", ".3f"),
        "expected",
    ]
    title = f"rate of convergence of the model-based form (model-free: {Quantity(free):.3f})"
    table = Table(title, columns, rows)
    return claims, table, testbed.rates(np.array(MASSES), by_knowledge, free)


def _rate(loop: Loop, believed: Loop, ratio: float) -> float:
    other = iterative_feedforward.compensated(
        believed, dataclasses.replace(iterative_feedforward.compensator(loop), mass=ratio * TRUE["mass"])
    )
    try:
        return iterative_feedforward.convergence(loop, SAME, believed=other, form="model_based").rate
    except UnstableError:
        # an unstable model loop has no rate; NaN is never equal to itself, which counts the refusals
        return float("nan")


def _by_gain() -> Table:
    loop = table_axis("x", SETS["+ Coulomb"])
    rows: list[list[float]] = []
    for factor, expected in ((0.5, 0.52), (1.0, 0.039), (2.0, 1.04)):
        believed = tree.vary(loop, {"axis.x.control.law.Kp": factor * float(tree.get(loop, "axis.x.control.law.Kp"))})
        pair = [
            iterative_feedforward.convergence(loop, SAME, believed=believed, gamma=gamma).rate for gamma in (1.0, 0.5)
        ]
        rows.append([factor, *pair, expected])
    columns = [
        Column("believed gain / gain", ""),
        Column("rho, gamma 1", "", ".3f"),
        Column("rho, gamma 0.5", "", ".3f"),
        Column("expected, gamma 1", ""),
    ]
    return Table("gains that are known roughly: half a step converges for both", columns, rows)


def _scatter() -> tuple[list[Claim], Table]:
    """Compare the scatter of the parameters over several runs with the standard errors from one run."""
    loop = ideal_axis(TRUE)
    estimates, reported = [], []
    for seed in range(SEEDS):
        step = iterative_feedforward.next_iteration(
            loop, simulated_trial(ideal_run(loop, SAME, STRONG, seed), SAME), at_rest="none"
        )
        estimates.append(list(step.after.parameters().values()))
        reported.append([step.errors[name] for name in TRUE])
    # ddof 1: the mean is estimated from the same runs
    scatter, sure = np.std(estimates, axis=0, ddof=1), np.mean(reported, axis=0)
    rows = [
        [name, amperes(scatter[i]), amperes(sure[i]), float(sure[i] / scatter[i]), EXPECTED_SCATTER[i]]
        for i, name in enumerate(TRUE)
    ]
    rule = Text(
        f"x axis, friction along the set velocity, {Quantity(STRONG, 'N'):6} white force noise, seeds 0 to {SEEDS - 1}"
    )
    ratio = sure / scatter
    by_chance = np.sqrt(chi2.ppf([0.005, 0.995], SEEDS - 1) / (SEEDS - 1))
    claims = [
        Claim(
            "4.j",
            "standard error reported over scatter found, the smallest of four",
            rule,
            float(ratio.min()),
            least=1.0 / by_chance[1],
            most=1.0 / by_chance[0],
            expected=f"1, to what the scatter of {SEEDS} runs is known to in 99 % of cases (chi-squared)",
        ),
        Claim(
            "4.j",
            "standard error reported over scatter found, the largest of four",
            rule,
            float(ratio.max()),
            least=1.0 / by_chance[1],
            most=2.0,
            expected="1 or more, on the safe side: the dead time's misfit counts as noise; not more than twice",
        ),
        Claim("4.j", "scatter of a", rule, amperes(float(scatter[0])), 0.0006, 0.0011, "A s²/m", "0.0008"),
        Claim("4.j", "scatter of b", rule, amperes(float(scatter[1])), 0.009, 0.014, "A s/m", "0.0115"),
    ]
    columns = [
        "parameter",
        Column("scatter, A units", "", ".4f"),
        Column("reported, A units", "", ".4f"),
        Column("reported / scatter", "", ".2f"),
        Column("expected scatter", "", ".4f"),
    ]
    title = f"noise of {Quantity(STRONG, 'N'):6}: scatter over {SEEDS} runs and standard errors"
    return claims, Table(title, columns, rows)


def _condition() -> list[Claim]:
    loop = table_axis("x", SETS["+ Coulomb"])
    # hard jerk: the stroke is at constant speed almost throughout, where mass and friction look alike
    hard, slow = move(0.1, 0.25, 30.0, 3e3), move(0.06, 0.1, 30.0, 3e3)
    both = Sequence(references=(hard, slow))
    one = iterative_feedforward.convergence(loop, hard).condition
    two = iterative_feedforward.convergence(loop, both).condition
    ratio = _continuous_condition(loop, both) / _continuous_condition(loop, hard)
    rule = "x axis, columns a, b, Coulomb, scaled to one size, model-free"
    continuous = _continuous_condition(loop, SAME)
    fast = f"{rule}; 100 mm at 0.25 m/s and 30 m/s², with and without 60 mm at 0.1 m/s"
    return [
        Claim(
            "4.k",
            "condition number of the 100 mm move, as the continuous 1/C by scipy has it: ratio",
            f"{rule}; the sampled filter turns by half a sample, which moves it by some percent",
            iterative_feedforward.convergence(loop, SAME).condition / continuous,
            least=0.97,
            most=1.03,
            expected=f"{continuous:.3g} here; 2.6 for one speed and 1.6 for two were stated without the columns",
        ),
        Claim(
            "4.k",
            "a second speed lowers the condition of a stroke that is nearly all at one speed: ratio",
            fast,
            two / one,
            least=0.97 * ratio,
            most=1.03 * ratio,
            expected=f"{ratio:.3g} by the continuous 1/C; 1.6/2.6 = 0.62 of another move at one speed was stated",
        ),
    ]


def _continuous_condition(loop: Loop, reference: Reference) -> float:
    """Return the condition number of the columns of a motion behind s/((s + Kv)(s + 1/Tn)), integrated by scipy.

    This is 1/C up to a factor, and shares no code with the sampled model of the error.
    """
    T = float(loop.sample_time)
    time = T * np.arange(samples(reference.duration, T))
    move_at = reference.at(time)
    law = loop.control.law
    assert isinstance(law, CascadePPI)
    assert law.Tn is not None
    system = ([1.0, 0.0], np.polymul([1.0, float(law.Kv)], [1.0, 1.0 / float(law.Tn)]))
    velocity = np.asarray(move_at.velocity)
    columns = (np.asarray(move_at.acceleration), velocity, velocity > 0.0, velocity < 0.0)
    seen = np.column_stack([lsim(system, np.asarray(column, dtype=float), time)[1] for column in columns])
    return float(np.linalg.cond(seen / np.linalg.norm(seen, axis=0)))
