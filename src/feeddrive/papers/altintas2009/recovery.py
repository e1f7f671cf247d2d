"""Claims 1.e, 1.f, 1.m to 1.q: disturbance recovery, also for machine modes and against simultaneous disturbances.

Claims 1.e: force step and interrupted milling.  Claims 1.f: a machine mode, compensated by the axis.
Claims 1.m to 1.q: stiffness versus frequency, bandwidths, and simultaneous cutting, friction and a machine mode during
motion.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from feeddrive import plot
from feeddrive.analysis.replay import Observation, observe
from feeddrive.blocks.compensation.machine_mode import MachineMode
from feeddrive.blocks.compensation.mode_compensation import ModeCompensation
from feeddrive.blocks.controller.dadsc import DADSC
from feeddrive.blocks.families import Compensation, Friction, Law, Load, Observer, Reference
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.load.sine_force import SineForce
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.observer.kalman_recovery import KalmanRecovery
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.blocks.signals import Reading, Setpoint
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text
from feeddrive.loop.linearize import compliance, loop_gain
from feeddrive.loop.simulate import Run, root_mean_square, simulate
from feeddrive.papers.altintas2009.testbed import (
    MASS,
    PLANT,
    REST,
    VISCOUS,
    T,
    cascade,
    continuous_compliance,
    dadsc,
    loop,
    milling,
)
from feeddrive.papers.claims import KEPT, Claim, kept, printed, quotient, stated, within
from feeddrive.plot.chart import Chart
from feeddrive.plot.curves import Row, curves_chart
from feeddrive.report.report import Picture

# 2000 samples are 0.2 s: 60 time constants of the law
RATE, DURATION, SKIP = 300.0, 0.6, 2000
RESOLUTION = 1e-8
OWN = "F̂d of the law"
OBSERVERS: dict[str, Observer] = {
    "recovery, exact": DisturbanceRecovery(mass=MASS, viscous=VISCOUS, form="exact"),
    "recovery, 500 Hz": DisturbanceRecovery(mass=MASS, viscous=VISCOUS, frequency=500.0),
    "recovery, 1000 Hz": DisturbanceRecovery(mass=MASS, viscous=VISCOUS, frequency=1000.0),
    "recovery, one pole 500 Hz": DisturbanceRecovery(mass=MASS, viscous=VISCOUS, form="one_pole"),
    "Kalman": KalmanRecovery(mass=MASS, viscous=VISCOUS, resolution=RESOLUTION, force_step=20.0),
}
EXPECTED = {
    OWN: (60.2, 60.2),
    "recovery, exact": (17.1, 31.9),
    "recovery, 500 Hz": (12.8, 12.9),
    "recovery, 1000 Hz": (10.4, 10.5),
    "Kalman": (5.3, 12.4),
}


KNOWN_FORCE = 0.2  # share to which the expected errors are known: the cutting force behind them is not published


def _run(load: Load, resolution: float | None) -> Run:
    return simulate(loop(dadsc(RATE), resolution=resolution), REST, load=load, duration=DURATION)


def adaptation(law: DADSC, run: Run) -> Observation:
    """Compute the estimate F̂d of a law along a run by repeating the steps of the law with the recorded readings, since
    a run does not record states.
    """
    prepared = law.prepare(T)
    position, force, wanted = run["reading_load"], run["force"], run["requested"]
    state = law.start(prepared, Setpoint(0.0), Reading(position[0], position[0]))
    estimates = np.empty(position.size)
    applied = requested = 0.0
    for k, x in enumerate(position):
        state, _ = law.step(prepared, state, Setpoint(0.0), Reading(x, x, applied, requested), T)
        estimates[k] = state.estimate
        applied, requested = force[k], wanted[k]
    return Observation(OWN, run.time, position, run["velocity_load"], estimates, T, 0.0)


def _observed(run: Run) -> dict[str, Observation]:
    estimates = {OWN: adaptation(dadsc(RATE), run)}
    return estimates | {
        name: observe(observer, run["reading_load"], run["force"], T) for name, observer in OBSERVERS.items()
    }


def estimation() -> tuple[list[Claim], list[Table], list[Picture]]:
    """Return claims 1.e, their table and their pictures."""
    cutting = milling(DURATION)
    cut = {q: _run(cutting, q) for q in (None, RESOLUTION)}
    seen = {q: _observed(run) for q, run in cut.items()}
    errors = {
        name: tuple(
            # the exact form is used as printed; filtered estimates are compared with the force at the same instant
            seen[q][name].error(run["load_force"], skip=SKIP, aligned=name not in (OWN, "recovery, exact"))
            for q, run in cut.items()
        )
        for name in seen[None]
    }
    rule = (
        f"DADSC with p = 300 1/s; {PLANT}; 161 N RMS of milling at 200 Hz (4 straight teeth, 0 to 90 degrees), "
        f"0.2 to 0.6 s; filtered estimates against the force of their own instant"
    )
    best = errors["recovery, 500 Hz"]
    claims = [
        Claim(
            "1.e",
            "the law's own estimate is off by more than 3 times the filtered recovery",
            rule,
            errors[OWN][1] / best[1],
            *quotient("60.2", "12.9", KNOWN_FORCE),
            expected="60.2 / 12.9 N = 4.7 with a scale of 10 nm, to 20 %; more than 3 was required",
        ),
        Claim(
            "1.e",
            "a scale of 10 nm doubles the error of the exact recovery, not that of the filtered one",
            rule,
            (errors["recovery, exact"][1] / errors["recovery, exact"][0]) / (best[1] / best[0]),
            *within((31.9 / 17.1) / (12.9 / 12.8), KNOWN_FORCE),
            expected="(31.9/17.1)/(12.9/12.8) = 1.85, to 20 %",
        ),
        Claim(
            "1.e",
            "the Kalman filter is the best without a scale's steps",
            rule,
            errors["Kalman"][0] / min(figures[0] for name, figures in errors.items() if name != "Kalman"),
            *quotient("5.3", "10.4", KNOWN_FORCE),
            expected="5.3 / 10.4 N = 0.51, to 20 %",
        ),
        *_table_claims(errors, rule),
    ]
    claims += _steps()
    rows = []
    for name, (smooth, stepped) in errors.items():
        late = seen[None][name].lag / T
        expected = EXPECTED.get(name)
        rows.append([name, smooth, stepped, *(expected or (None, None)), late])
    columns = [
        "estimate",
        Column("RMS error", "N", ".1f"),
        Column("with 10 nm steps", "N", ".1f"),
        Column("expected", "N"),
        Column("expected, 10 nm", "N"),
        Column("late by samples", "", ".2f"),
    ]
    return claims, [Table("Quality of the estimate under milling", columns, rows)], [_picture(cut[RESOLUTION])]


def _table_claims(errors: dict[str, tuple[float, ...]], rule: str) -> list[Claim]:
    """Return a claim for each table cell with bounds of ±20 %, since the cutting force behind the expected figures
    is not fully specified.
    """
    return [
        Claim(
            "1.e",
            f"error of {name}{with_scale}",
            rule,
            errors[name][i],
            *within(expected[i], KNOWN_FORCE),
            unit="N",
            expected=f"{number(expected[i], 6)}, to 20 %",
        )
        for name, expected in EXPECTED.items()
        for i, with_scale in enumerate((", continuous reading", ", 10 nm scale"))
    ]


def _steps() -> list[Claim]:
    """Check how long the estimates of a 200 N force step take to reach 90 % of it."""
    run = _run(StepForce(force=200.0, start=0.1), None)
    seen = _observed(run)
    first = round(0.1 / T)
    times = {
        # 180 N: 90 % of the step
        name: 1e3 * T * float(np.argmax(observation.disturbance[first:] >= 180.0))
        for name, observation in seen.items()
    }
    rule = f"DADSC with p = 300 1/s; {PLANT}; force step of 200 N, time until the estimate has 180 N"
    # ms: the filter alone is late by a sample more, half for the reading and half for the force that answers it
    filtered, kalman = _rise_of_filter() + 1e3 * T, _rise_of_kalman()
    return [
        Claim("1.e", "the law's own estimate of a step takes ln 10/ω_d", rule, times[OWN], 7.3, 8.1, "ms", "7.68"),
        Claim(
            "1.e",
            "the recovery at 500 Hz",
            rule,
            times["recovery, 500 Hz"],
            least=filtered - 1e3 * T,
            most=filtered + 1e3 * T,
            unit="ms",
            expected=f"{number(filtered, 3)} by the continuous Butterworth filter and a sample; to a sample",
        ),
        Claim(
            "1.e",
            "the Kalman filter",
            rule,
            times["Kalman"],
            least=kalman - 0.5e3 * T,
            most=kalman + 0.5e3 * T,
            unit="ms",
            expected=f"{number(kalman, 2)} by scipy's Riccati equation on the free axis; the same sample",
        ),
    ]


def _rise_of_filter() -> float:
    """Return the time in ms that a continuous Butterworth filter of second order at 500 Hz takes to 90 % of a step."""
    from scipy.signal import butter, step

    time = np.linspace(0.0, 2e-3, 20_001)
    _, risen = step(butter(2, 2.0 * np.pi * 500.0, analog=True), T=time)
    return 1e3 * float(time[np.argmax(risen >= 0.9)])


def _rise_of_kalman() -> float:
    """Return the time in ms to 90 % of a force step on a free axis, with the gain of scipy's Riccati equation.

    What a filter that knows the drive's force sees does not depend on that force.
    """
    from scipy.linalg import expm, solve_discrete_are

    A = expm(T * np.array([[0.0, 1.0, 0.0], [0.0, -VISCOUS / MASS, 1.0 / MASS], [0.0, 0.0, 0.0]]))
    C = np.array([[1.0, 0.0, 0.0]])
    P = solve_discrete_are(A.T, C.T, np.diag([0.0, 0.0, 20.0**2]), np.array([[RESOLUTION**2 / 12.0]]))
    gain = (P @ C.T / (C @ P @ C.T + RESOLUTION**2 / 12.0))[:, 0]
    true, seen, samples = np.array([0.0, 0.0, 200.0]), np.zeros(3), 0
    while seen[2] < 180.0:
        true, predicted = A @ true, A @ seen
        seen = predicted + gain * (true[0] - predicted[0])
        samples += 1
    return 1e3 * T * samples


def _picture(run: Run) -> Picture:
    seen = _observed(run)
    chosen = {name: seen[name] for name in (OWN, "recovery, 500 Hz", "Kalman")}
    return Picture(
        "estimate",
        "Estimated disturbance under milling",
        "Gray: the true force. The law's own estimate has a bandwidth of 48 Hz; recovered ones follow the teeth. "
        "Scale of 10 nm, DADSC with p = 300 1/s.",
        "The law's own estimate swings about the mean; recovered forces follow each tooth with a short lag.",
        lambda: plot.disturbance_chart(chosen, run["load_force"], (0.3, 0.32)),
    )


STIFFNESS, DAMPING = 2e7, 0.03
RECOVERY = DisturbanceRecovery(mass=MASS, viscous=VISCOUS, frequency=500.0)
# 10,000 samples are 1 s: 6.6 time constants of the mode at 35 Hz
MODE_DURATION, MODE_SKIP = 2.0, 10_000
FREQUENCIES = (15.0, 25.0, 35.0, 50.0, 70.0, 100.0)
KNOWN_LEFT = 0.25  # share to which what compensation leaves is known: a quarter of it is the last sample's timing
GAINS = {15.0: 100.0, 25.0: 130.0, 35.0: 78.0, 50.0: 19.0, 70.0: 7.0, 100.0: 3.0}  # expected, with lead, p = 600


def swing(mode: MachineMode, force: np.ndarray, sample_time: float = T) -> np.ndarray:
    """Return the position of a mode, m, at kT under a force held over the sample, N, by an independent simulation."""
    from scipy.linalg import expm
    from scipy.signal import lfilter

    w, m = float(mode.omega()), float(mode.modal_mass())
    transition = expm(sample_time * np.array([[0, 1, 0], [-w * w, -2 * mode.damping_ratio * w, 1 / m], [0, 0, 0]]))
    # exact for a held force, and without a line of the library: the shipped block is judged by it
    A, B = transition[:2, :2], transition[:2, 2]
    # x(k) = tr A x(k-1) - det A x(k-2) + B1 F(k-1) + (A12 B2 - A22 B1) F(k-2)
    numerator = [0.0, B[0], A[0, 1] * B[1] - A[1, 1] * B[0]]
    return np.asarray(lfilter(numerator, [1.0, -np.trace(A), np.linalg.det(A)], force))


def mode(frequency: float = 35.0, tuned: float = 1.0) -> MachineMode:
    """Return the machine mode, or a model of it with its frequency scaled by `tuned`."""
    return MachineMode(frequency=tuned * frequency, damping_ratio=DAMPING, stiffness=STIFFNESS)


def compensated(
    frequency: float = 35.0, *, tuned: float = 1.0, lead: bool = True, observer: Observer = RECOVERY
) -> tuple[Compensation, ...]:
    """Return the compensation of one mode, with or without the prediction over the known delay."""
    model = mode(frequency, tuned)
    return (ModeCompensation(modes=(model,), observer=observer, lead_time=None if lead else 0.0),)


def tool_error(rate: float, compensation: tuple[Compensation, ...], load: Load, frequency: float = 35.0) -> np.ndarray:
    """Return the error x - x_s - x_r at the tool in m, where x_r = 0 is the set position, and x_s the deflection of the
    tool side, on which the load force acts with the opposite sign.
    """
    control = loop(dadsc(rate), compensation=compensation)
    run = simulate(control, REST, load=load, duration=MODE_DURATION, record=("position_load", "load_force"))
    # the drive's force acts on the tool side with the opposite sign
    return run["position_load"] - swing(mode(frequency), -run["load_force"])


def _rms(error: np.ndarray, skip: int = MODE_SKIP) -> float:
    return 1e6 * root_mean_square(error[skip:])


def machine_modes() -> tuple[list[Claim], list[Table], list[Picture]]:
    """Return claims 1.f, their table and their picture."""
    sine = SineForce(amplitude=100.0, frequency=35.0)
    named = {
        "no compensation": tool_error(600.0, (), sine),
        "compensated": tool_error(600.0, compensated(lead=False), sine),
        "compensated with lead": tool_error(600.0, compensated(), sine),
    }
    none, plain, lead = (_rms(error) for error in named.values())
    rule = (
        f"mode of 35 Hz, ζ = 0.03, k = 20 N/um on the tool side; 100 N at its resonance; DADSC with p = 600 1/s; "
        f"{PLANT}; recovery at 500 Hz; RMS of the error at the tool from 1 to 2 s"
    )
    claims = [
        Claim("1.f", "error at the tool without compensation", rule, none, 57.0, 59.5, "um", "58.1"),
        Claim("1.f", "compensation takes it down 5 times or more", rule, none / plain, 6.6, 8.0, "", "7.3 times"),
        Claim(
            "1.f",
            "with lead over the known delay 30 times or more",
            rule,
            none / lead,
            *within(78.0, KNOWN_LEFT),
            expected="78 times, of which 0.7 µm are left and a quarter of them is the last sample's timing: to 25 %",
        ),
        *_others(rule, none, sine),
        *_rubbing(sine),
    ]
    table, sweep = _sweep()
    picture = Picture(
        "tool",
        "Error at the tool at resonance",
        "A mode of 35 Hz on the tool side under 100 N at its resonance; the axis moves with the tool.",
        Text(
            f"Error at the tool: {stated(none, 'um')} RMS without, {stated(plain, 'um')} with compensation, "
            f"{stated(lead, 'um')} with lead."
        ),
        lambda: _draw(named),
    )
    return [*claims, *sweep], [table], [picture]


def _draw(named: dict[str, np.ndarray]) -> Chart:
    window = slice(0, round(0.5 / T))
    time = 1e3 * T * np.arange(round(0.5 / T))
    rows = [Row(f"{name} (µm)", {name: 1e6 * error[window]}) for name, error in named.items()]
    return curves_chart("time (ms)", time, rows)


def _others(rule: str, none: float, sine: SineForce) -> list[Claim]:
    """Check the compensation with inaccurate models, and under a force step."""
    # at resonance a mode of ζ = 0.03 has a half width of 3 %: 5 % off is beside it
    off = [_rms(tool_error(600.0, compensated(tuned=tuned), sine)) for tuned in (0.95, 1.05)]
    heavy = [
        none / _rms(tool_error(600.0, compensated(observer=replace(RECOVERY, mass=share * MASS)), sine))
        for share in (0.8, 1.2)
    ]
    step = StepForce(force=300.0, start=0.1)
    stepped = [
        _rms(tool_error(600.0, compensation, step), 0) for compensation in ((), compensated(), compensated(tuned=0.95))
    ]
    step_rule = rule.replace("100 N at its resonance", "force step of 300 N").replace("from 1 to 2 s", "over 2 s")
    return [
        Claim(
            "1.f",
            "the compensation is sensitive: a frequency 5 % off leaves most of the error at resonance",
            rule,
            min(off),
            *printed("49"),
            unit="um",
            expected="49 to 50",
        ),
        Claim(
            "1.f",
            "a mass 20 % off still leaves a gain, the smaller of both",
            rule,
            min(heavy),
            least=2.4,
            most=4.0,
            expected="2.4 to 4",
        ),
        Claim("1.f", "error under a step without compensation", step_rule, stepped[0], 14.0, 16.0, "um", "15.1"),
        *(
            Claim("1.f", claim, step_rule, got, *within(figure, KNOWN_LEFT), "um", f"{number(figure)}, to 25 %")
            for claim, got, figure in (
                ("error under a step with it", stepped[1], 0.22),
                ("and with a frequency 5 % off", stepped[2], 2.3),
            )
        ),
    ]


def _rubbing(sine: SineForce) -> list[Claim]:
    """Show that dry friction on the guideway loads the drive and not the tool side."""
    way = Polynomial7(distance=0.05, travel_time=0.5, back=True)
    dry = DRY

    def left(friction: Friction | None) -> float:
        model = ModeCompensation(modes=(mode(),), observer=RECOVERY, friction=friction)
        run = simulate(loop(dadsc(600.0), compensation=(model,), friction=dry), way, load=sine)
        return _rms(run["position_load"] - run["set_position"] - swing(mode(), -run["load_force"]), 0)

    rule = (
        f"50 mm out and back, 0.5 s a way, Coulomb friction of 30 N, 100 N at the resonance of 35 Hz; p = 600 1/s; "
        f"{PLANT}; RMS of the error at the tool"
    )
    without, removed = left(None), left(dry)
    added = 1e6 * root_mean_square(_moved_by_friction(way, sine))
    together = float(np.hypot(removed, added))
    return [
        Claim(
            "1.f",
            "friction taken for a load of the tool side",
            rule,
            without,
            # neither the delay of the recovery nor its filter is in it
            *within(together, 0.1),
            unit="um",
            expected=f"{number(together, 3)}: a mode that also swings under the friction, {number(added, 3)}; to 10 %",
        ),
        Claim(
            "1.f",
            "friction removed by its model",
            f"{rule}; {KEPT}",
            removed,
            *kept(1.36),
            unit="um",
        ),
    ]


def _moved_by_friction(way: Reference, load: SineForce) -> np.ndarray:
    """Return the part of the swing in m that friction adds, if the axis follows a mode that swings under cut and
    friction: 30 N against the velocity of set motion and swing.
    """
    from scipy.linalg import expm

    model = mode()
    w, m = float(model.omega()), float(model.modal_mass())
    transition = expm(T * np.array([[0.0, 1.0, 0.0], [-w * w, -2.0 * DAMPING * w, 1.0 / m], [0.0, 0.0, 0.0]]))[:2]
    time = T * np.arange(round(way.duration / T) + 1)
    speed = np.asarray(way.at(time).velocity, dtype=float)
    cut = float(load.amplitude) * np.sin(2.0 * np.pi * float(load.frequency) * time)
    state, swung = np.zeros(2), np.empty(time.size)
    for k in range(time.size):
        swung[k] = state[0]
        dry = -float(DRY.coulomb) * np.sign(speed[k] + state[1])
        state = transition @ [*state, -(cut[k] + dry)]
    return swung - swing(model, -cut)


def _sweep() -> tuple[Table, list[Claim]]:
    rows, claims = [], []
    for frequency in FREQUENCIES:
        load = SineForce(amplitude=100.0, frequency=frequency)
        cells = [frequency]
        for rate in (600.0, 300.0):
            none = _rms(tool_error(rate, (), load, frequency))
            lead = _rms(tool_error(rate, compensated(frequency), load, frequency))
            cells += [1e-6 * none, 1e-6 * lead, none / lead]
            if rate == 600.0:
                expected = GAINS[frequency]
                rule = Text(
                    f"100 N at resonance of a mode of {Quantity(frequency, 'Hz'):6}, with lead; p = 600 1/s; else as "
                    "above"
                )
                claims.append(
                    Claim(
                        "1.f",
                        Text(f"gain at {Quantity(frequency, 'Hz'):6}"),
                        rule,
                        none / lead,
                        *within(expected, KNOWN_LEFT),
                        expected=f"{number(expected, 6)} times, to 25 %",
                    )
                )
            elif frequency == 35.0:
                rule = "the same at 35 Hz with p = 300 1/s: the drive's own compliance is the bound"
                claims.append(
                    Claim("1.f", "a slow drive gains little", rule, none / lead, 6.0, 12.0, "", "about 9 times")
                )
        rows.append(cells)
    errors = [
        [Column(f"none, p {rate}", "m", ".1f"), Column("with lead", "m", ".2f"), Column("gain", "", "3")]
        for rate in (600, 300)
    ]
    columns = [Column("mode", "Hz", "6"), *errors[0], *errors[1]]
    return Table("Compensation of one mode at its resonance, 100 N", columns, rows), claims


NAMED = (1.0, 5.0, 10.0, 20.0, 30.0, 50.0, 100.0, 200.0)  # Hz
DRY = Coulomb(coulomb=30.0)
WAY = Polynomial7(distance=0.05, travel_time=0.5, back=True)


def by_frequency() -> list[Claim]:
    """Check the stiffness ratio of DADSC to P-PI against the ratio of their equivalent PIDs, and the sensitivity
    bandwidths of both laws.
    """
    f = np.array(NAMED)
    laws: dict[str, Law] = {"DADSC": dadsc(RATE), "P-PI": cascade(RATE)}
    ours, theirs = (compliance(loop(law), f).magnitude for law in laws.values())
    expected = np.abs(continuous_compliance("P-PI", RATE, f) / continuous_compliance("DADSC", RATE, f))
    rule = f"equal velocity gain k_d = 3 m p and real poles, p = 300 1/s; {PLANT}, running loop"
    claims = [
        Claim(
            "1.m",
            Text(f"stiffness of DADSC over that of P-PI at {Quantity(line, 'Hz'):6}"),
            rule,
            float(ratio),
            least=0.96 * wanted,
            most=1.04 * wanted,
            expected=f"{number(wanted)} of the two PIDs in continuous time",
        )
        for line, ratio, wanted in zip(NAMED, theirs / ours, expected.tolist(), strict=True)
    ]
    lines = np.geomspace(3.0, 1000.0, 6000)
    band = {}
    for name, law in laws.items():
        sensitivity = np.abs(1.0 / (1.0 + loop_gain(loop(law), lines).response))
        band[name] = float(lines[np.argmax(sensitivity >= np.sqrt(0.5))])
    ideal = {}
    for name in laws:
        # x/F_d = P/(1 + L) with the free mass P = 1/(m s²)
        s = 2j * np.pi * lines
        gain = 1.0 / (MASS * s**2 * continuous_compliance(name, RATE, lines)) - 1.0
        for late in (0.0, 1.0):
            sensitivity = np.abs(1.0 / (1.0 + gain * np.exp(-late * T * s)))
            ideal[name, late] = float(lines[np.argmax(sensitivity >= np.sqrt(0.5))])
    return [
        *claims,
        Claim(
            "1.m",
            "high bandwidth: |S| of DADSC stays below 0.707 up to",
            rule,
            band["DADSC"],
            least=ideal["DADSC", 1.0],
            most=ideal["DADSC", 0.0],
            unit="Hz",
            expected="of the continuous PID with a sample of delay and without one",
        ),
        Claim(
            "1.m",
            "and over that of P-PI: equal velocity gains are equal bandwidths",
            rule,
            band["DADSC"] / band["P-PI"],
            *within(ideal["DADSC", 1.0] / ideal["P-PI", 1.0], 0.02),
            expected="of the two continuous PIDs with a sample of delay, to 2 %",
        ),
    ]


def _band(seen: np.ndarray, force: np.ndarray) -> float:
    """Return the -3 dB bandwidth of an estimate relative to a force, Hz; both signals start and end at 0."""
    # padded to lines 0.06 Hz apart, far below the tolerance of the claims
    size = 16 * force.size
    lines = np.fft.rfftfreq(size, T)
    # below 500 Hz, the first zero in the spectrum of a pulse of 2 ms, where the ratio is undefined
    inside = (lines > 1.0) & (lines < 400.0)
    ratio = np.abs(np.fft.rfft(seen, size)[inside] / np.fft.rfft(force, size)[inside])
    return float(lines[inside][np.argmax(ratio < np.sqrt(0.5))])


def bandwidths() -> list[Claim]:
    """Check that the bandwidth of the recovery is independent of the law and its gains, and that the bandwidth of the
    law's own estimate equals the adaptation rate.
    """
    pulse = np.zeros(10_001)
    # 2 ms: a spectrum without zeros below 500 Hz
    pulse[100:120] = 200.0
    adapted, recovered = {}, {}
    laws: dict[str, Law] = {"p 100": dadsc(100.0), "p 300": dadsc(300.0), "p 600": dadsc(600.0), "P-PI": cascade(300.0)}
    for name, law in laws.items():
        run = simulate(loop(law), REST, load=RecordedForce(force=pulse, sample_time=T), duration=1.0)
        force = run["load_force"]
        seen = observe(replace(RECOVERY, frequency=100.0), run["reading_load"], run["force"], T)
        recovered[name] = _band(seen.disturbance, force)
        if name != "P-PI":
            adapted[name] = _band(adaptation(dadsc(float(name[2:])), run).disturbance, force)
    rule = f"pulse of 200 N and 2 ms; -3 dB of the estimate over the force in the running loop; {PLANT}"
    values = list(recovered.values())
    return [
        Claim(
            "1.n",
            "bandwidth of the recovery at 100 Hz, least of p = 100, 300, 600 1/s and P-PI",
            rule,
            min(values),
            least=99.0,
            most=103.0,
            unit="Hz",
            expected="100",
        ),
        Claim(
            "1.n",
            "largest over least: it does not depend on law and gains",
            rule,
            max(values) / min(values),
            least=1.0,
            most=1.02,
            expected="1",
        ),
        *(
            Claim(
                "1.n",
                f"the law's own estimate has that of its rate, {name} 1/s",
                rule,
                got,
                least=0.9 * float(name[2:]) / (2.0 * np.pi),
                most=1.1 * float(name[2:]) / (2.0 * np.pi),
                unit="Hz",
                expected="p/2π",
            )
            for name, got in adapted.items()
        ),
    ]


def _moving(law: Law, compensation: tuple[Compensation, ...] = ()) -> Run:
    """Simulate a move out and back under milling and Coulomb friction."""
    return simulate(loop(law, compensation=compensation, friction=DRY), WAY, load=milling(WAY.duration))


def _pushed(run: Run, counted: slice) -> tuple[dict[str, float], float]:
    """Return RMS errors in µm of both laws and of the tool, and of the swing of the mode under the friction alone, from
    spectra of the forces and the continuous PIDs. The friction opposes the set motion; none of the errors is simulated.
    """
    cut, set_velocity = run["load_force"], np.gradient(run["set_position"], T)
    # slower than 1e-9 m/s is the rounding of a standstill
    dry = -float(DRY.coulomb) * np.where(np.abs(set_velocity) > 1e-9, np.sign(set_velocity), 0.0)
    # twice as long as the run, with zeros, so that its end does not push its beginning
    size = 2 * cut.size
    lines = np.fft.rfftfreq(size, T)
    force = np.fft.rfft(cut + dry, size)
    errors = {}
    for name in ("DADSC", "P-PI"):
        response = continuous_compliance(name, 600.0, lines)
        errors[name] = np.fft.irfft(response * force, size)[: cut.size]
    swung = {"DADSC": errors["DADSC"], "P-PI": errors["P-PI"], "tool": errors["DADSC"] - swing(mode(), -cut)}
    return (
        {name: 1e6 * root_mean_square(error[counted]) for name, error in swung.items()},
        1e6 * root_mean_square(swing(mode(), dry)[counted]),
    )


def in_motion() -> list[Claim]:
    """Check the recovery under simultaneous friction and cutting while the axis moves, and with a machine mode
    added.
    """
    runs = {"DADSC": _moving(dadsc(600.0)), "P-PI": _moving(cascade(600.0))}
    run = runs["DADSC"]
    late = np.concatenate([[0.0], run["load_force"][:-1]])
    # the force in the sample before the reading, which is the latest that the reading contains
    true = late + run["friction_load"]
    counted = slice(500, None)
    seen = observe(OBSERVERS["recovery, 500 Hz"], run["reading_load"], run["force"], T)
    # one sample less than the lag, since `true` is one sample late itself
    shift = round(seen.lag / T) - 1
    recovered = root_mean_square((seen.disturbance[shift:] - true[: true.size - shift])[counted])
    whole = root_mean_square(true[counted])
    errors = {name: 1e6 * root_mean_square(outcome["tracking_error"][counted]) for name, outcome in runs.items()}
    model = ModeCompensation(modes=(mode(),), observer=RECOVERY, friction=DRY)
    blind = ModeCompensation(modes=(mode(),), observer=RECOVERY)
    tool = {}
    for name, compensation in (("none", ()), ("mode", (model,)), ("no friction model", (blind,))):
        compensated_run = run if not compensation else _moving(dadsc(600.0), compensation)
        error = (
            compensated_run["position_load"]
            - compensated_run["set_position"]
            - swing(mode(), -compensated_run["load_force"])
        )
        tool[name] = 1e6 * root_mean_square(error[counted])
    rule = (
        f"50 mm out and back in 0.5 s a way, Coulomb friction of 30 N, 161 N RMS of milling at 200 Hz; p = 600 1/s; "
        f"{PLANT}"
    )
    pushed, rubbed = _pushed(run, counted)
    costs = float(np.hypot(tool["mode"], rubbed) / tool["mode"])
    by_pid = "by the continuous PID under cut and friction of the set motion, to 5 %"
    there = f"{rule}; mode of 35 Hz, ζ = 0.03, 20 N/µm on the tool side; RMS of the error at the tool"
    return [
        Claim(
            "1.o",
            "the recovery at 500 Hz sees friction and cutting together: RMS error over RMS force",
            rule,
            recovered / whole,
            *within(12.8 / 161.0, KNOWN_FORCE),
            expected="0.0795, which is 12.8 of 161 N at rest in 1.e: to 20 %",
        ),
        Claim(
            "1.o",
            "tracking error of P-PI over that of DADSC",
            rule,
            errors["P-PI"] / errors["DADSC"],
            *within(pushed["P-PI"] / pushed["DADSC"], 0.05),
            expected=f"{number(pushed['P-PI'] / pushed['DADSC'], 3)} {by_pid}",
        ),
        Claim(
            "1.o",
            "RMS tracking error of DADSC",
            rule,
            errors["DADSC"],
            *within(pushed["DADSC"], 0.05),
            unit="um",
            expected=f"{number(pushed['DADSC'], 3)} {by_pid}",
        ),
        Claim(
            "1.p",
            "without compensation",
            there,
            tool["none"],
            *within(pushed["tool"], 0.05),
            unit="um",
            expected=f"{number(pushed['tool'], 3)} {by_pid}, and the swing of the mode",
        ),
        Claim(
            "1.p",
            "milling, friction and motion at once: the mode compensated",
            f"{there}; {KEPT}",
            tool["none"] / tool["mode"],
            *kept(7.76),
            unit="times",
        ),
        Claim(
            "1.p",
            "friction taken for a load of the tool side costs",
            there,
            tool["no friction model"] / tool["mode"],
            *within(costs, 0.1),
            unit="times",
            expected=f"{number(costs, 3)}: the swing of the mode under the friction, {number(rubbed, 3)} µm, beside "
            "what else is left; to 10 %",
        ),
    ]


ROWS: tuple[Callable[[], list[Claim]], ...] = (by_frequency, bandwidths, in_motion)
