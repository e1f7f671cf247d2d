"""Row 1.f: a mode of the machine, compensated by the axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from feeddrive.blocks.compensation.machine_mode import MachineMode
from feeddrive.blocks.compensation.mode_compensation import ModeCompensation
from feeddrive.blocks.families import Compensation, Friction, Load, Observer
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.load.sine_force import SineForce
from feeddrive.blocks.load.step_force import StepForce
from feeddrive.blocks.observer.disturbance_recovery import DisturbanceRecovery
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.language.table import Table
from feeddrive.loop.simulate import simulate
from feeddrive.papers.altintas2009.setting import MASS, PLANT, REST, VISCOUS, T, dadsc, loop
from feeddrive.papers.claims import Claim
from feeddrive.plot.curves import Row, curves
from feeddrive.report.content import Shown

STIFFNESS, DAMPING = 2e7, 0.03
RECOVERY = DisturbanceRecovery(mass=MASS, viscous=VISCOUS, frequency=500.0)
DURATION, SKIP = 2.0, 10_000
FREQUENCIES = (15.0, 25.0, 35.0, 50.0, 70.0, 100.0)
GAINS = {15.0: 100.0, 25.0: 130.0, 35.0: 78.0, 50.0: 19.0, 70.0: 7.0, 100.0: 3.0}  # expected, with lead, p = 600


def swing(mode: MachineMode, force: np.ndarray, sample_time: float = T) -> np.ndarray:
    """Position in m at kT of a mode under a force held over the sample, N: an independent simulation of the machine."""
    from scipy.linalg import expm
    from scipy.signal import lfilter

    w, m = float(mode.omega()), float(mode.modal_mass())
    made = expm(sample_time * np.array([[0, 1, 0], [-w * w, -2 * mode.damping_ratio * w, 1 / m], [0, 0, 0]]))
    A, B = made[:2, :2], made[:2, 2]
    # x(k) = tr A x(k-1) - det A x(k-2) + B1 F(k-1) + (A12 B2 - A22 B1) F(k-2)
    numerator = [0.0, B[0], A[0, 1] * B[1] - A[1, 1] * B[0]]
    return np.asarray(lfilter(numerator, [1.0, -np.trace(A), np.linalg.det(A)], force))


def mode(frequency: float = 35.0, tuned: float = 1.0) -> MachineMode:
    """The machine's mode, or a model of it whose frequency is off by a factor."""
    return MachineMode(frequency=tuned * frequency, damping_ratio=DAMPING, stiffness=STIFFNESS)


def compensated(
    frequency: float = 35.0, *, tuned: float = 1.0, lead: bool = True, observer: Observer = RECOVERY
) -> tuple[Compensation, ...]:
    """The compensation of one mode, with or without the prediction over the known delay."""
    model = mode(frequency, tuned)
    return (ModeCompensation(modes=(model,), observer=observer, lead_time=None if lead else 0.0),)


def tool_error(rate: float, compensation: tuple[Compensation, ...], load: Load, frequency: float = 35.0) -> np.ndarray:
    """x - x_s - x_r at the tool in m: the machine's side gives way to the reaction of the force on the table."""
    control = loop(dadsc(rate), compensation=compensation)
    run = simulate(control, REST, load=load, duration=DURATION, record=("position_load", "load_force"))
    return run["position_load"] - swing(mode(frequency), -run["load_force"])


def _rms(error: np.ndarray, skip: int = SKIP) -> float:
    return 1e6 * float(np.sqrt(np.mean(error[skip:] ** 2)))


def machine_modes() -> tuple[list[Claim], list[Table], list[Shown]]:
    """Claims, table and picture of row 1.f."""
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
        Claim("1.f", "compensation takes it down 5 times or more", rule, none / plain, 5.0, None, "", "7.3 times"),
        Claim("1.f", "with lead over the known delay 30 times or more", rule, none / lead, 30.0, None, "", "78 times"),
        *_others(rule, none, sine),
        *_rubbing(sine),
    ]
    table, sweep = _sweep()
    picture = Shown(
        "tool",
        "Error at the tool at resonance",
        "A mode of 35 Hz on the tool side under 100 N at its resonance; the axis moves with the tool.",
        f"Error at the tool: {none:.1f} um RMS without, {plain:.1f} with compensation, {lead:.2f} with lead.",
        lambda: _draw(named),
    )
    return [*claims, *sweep], [table], [picture]


def _draw(named: dict[str, np.ndarray]) -> object:
    window = slice(0, round(0.5 / T))
    time = 1e3 * T * np.arange(round(0.5 / T))
    rows = [Row(f"{name} (µm)", {name: 1e6 * error[window]}) for name, error in named.items()]
    return curves("time (ms)", time, rows)


def _others(rule: str, none: float, sine: Load) -> list[Claim]:
    """Wrong models, and a step."""
    off = [_rms(tool_error(600.0, compensated(tuned=tuned), sine)) for tuned in (0.95, 1.05)]
    heavy = [
        none / _rms(tool_error(600.0, compensated(observer=replace(RECOVERY, mass=share * MASS)), sine))
        for share in (0.8, 1.2)
    ]
    step = StepForce(force=300.0, start=0.1)
    stepped = [_rms(tool_error(600.0, each, step), 0) for each in ((), compensated(), compensated(tuned=0.95))]
    said = rule.replace("100 N at its resonance", "force step of 300 N").replace("from 1 to 2 s", "over 2 s")
    return [
        Claim("1.f", "the compensation loses: a frequency 5 % off leaves most of the error at resonance", rule,
              min(off), 40.0, None, "um", "49 to 50"),
        Claim("1.f", "a mass 20 % off still leaves a gain, the smaller of both", rule, min(heavy), 2.4, None, "",
              "2.4 to 4"),
        Claim("1.f", "error under a step without compensation", said, stepped[0], 14.0, 16.0, "um", "15.1"),
        Claim("1.f", "error under a step with it", said, stepped[1], None, 0.4, "um", "0.22"),
        Claim("1.f", "and with a frequency 5 % off", said, stepped[2], None, 3.0, "um", "2.3"),
    ]  # fmt: skip


def _rubbing(sine: Load) -> list[Claim]:
    """Dry friction on the guideway loads the drive and not the tool side."""
    way = Polynomial7(distance=0.05, travel_time=0.5, back=True)
    dry = Coulomb(coulomb=30.0)

    def left(friction: Friction | None) -> float:
        model = ModeCompensation(modes=(mode(),), observer=RECOVERY, friction=friction)
        run = simulate(loop(dadsc(600.0), compensation=(model,), friction=dry), way, load=sine)
        return _rms(run["position_load"] - run["set_position"] - swing(mode(), -run["load_force"]), 0)

    rule = (
        f"50 mm out and back, 0.5 s a way, Coulomb friction of 30 N, 100 N at the resonance of 35 Hz; p = 600 1/s; "
        f"{PLANT}; RMS of the error at the tool"
    )
    without, removed = left(None), left(dry)
    return [
        Claim("1.f", "friction taken for a load of the tool side", rule, without, 1.5 * removed, None, "um"),
        Claim("1.f", "friction removed by its model", rule, removed, None, 2.0, "um"),
    ]


def _sweep() -> tuple[Table, list[Claim]]:
    rows, claims = [], []
    for frequency in FREQUENCIES:
        load = SineForce(amplitude=100.0, frequency=frequency)
        cells = [f"{frequency:g}"]
        for rate in (600.0, 300.0):
            none = _rms(tool_error(rate, (), load, frequency))
            lead = _rms(tool_error(rate, compensated(frequency), load, frequency))
            cells += [f"{none:.1f}", f"{lead:.2f}", f"{none / lead:.3g}"]
            if rate == 600.0:
                expected = GAINS[frequency]
                rule = f"100 N at resonance of a mode of {frequency:g} Hz, with lead; p = 600 1/s; else as above"
                claims.append(
                    Claim("1.f", f"gain at {frequency:g} Hz", rule, none / lead, 0.7 * expected, None, "",
                          f"{expected:g} times")
                )  # fmt: skip
            elif frequency == 35.0:
                rule = "the same at 35 Hz with p = 300 1/s: the drive's own compliance is the bound"
                claims.append(
                    Claim("1.f", "a slow drive gains little", rule, none / lead, 6.0, 12.0, "", "about 9 times")
                )
        rows.append(cells)
    heads = ["mode Hz", "none um, p 600", "with lead", "gain", "none um, p 300", "with lead", "gain"]
    return Table("Compensation of one mode at its resonance, 100 N", heads, rows), claims
