"""Rows 1.m to 1.q: stiffness versus frequency, bandwidths, and simultaneous cutting, friction and a machine mode
during motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from feeddrive.analysis.replay import observe
from feeddrive.blocks.compensation.mode_compensation import ModeCompensation
from feeddrive.blocks.families import Compensation, Law
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.polynomial7 import Polynomial7
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text
from feeddrive.loop.lifting import compliance, loop_gain
from feeddrive.loop.simulate import Run, simulate
from feeddrive.papers.altintas2009.recovery import OBSERVERS, RECOVERY, adaptation, mode, swing
from feeddrive.papers.altintas2009.testbed import MASS, PLANT, REST, T, cascade, dadsc, loop, milling
from feeddrive.papers.claims import Claim

RATE = 300.0
NAMED = (1.0, 5.0, 10.0, 20.0, 30.0, 50.0, 100.0, 200.0)  # Hz
DRY = Coulomb(coulomb=30.0)
WAY = Polynomial7(distance=0.05, travel_time=0.5, back=True)


def by_frequency() -> list[Claim]:
    """Check the stiffness relative to the cascade against the equivalent PIDs, and the sensitivity bandwidth."""
    f = np.array(NAMED)
    laws: dict[str, Law] = {"DADSC": dadsc(RATE), "P-PI": cascade(RATE)}
    ours, theirs = (compliance(loop(law), f).magnitude for law in laws.values())
    s, K = 2j * np.pi * f, 4.0 * RATE / 9.0
    pid = s / (MASS * (s + RATE) ** 3)
    ppi = s / (MASS * (s**3 + 3.0 * RATE * (s + K) ** 2))
    expected = np.abs(ppi / pid)
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
    return [
        *claims,
        Claim("1.m", "high bandwidth: |S| of DADSC stays below 0.707 up to", rule, band["DADSC"], 86.0, 95.0, "Hz"),
        Claim(
            "1.m",
            "and over that of P-PI: equal velocity gains are equal bandwidths",
            rule,
            band["DADSC"] / band["P-PI"],
            least=0.91,
            most=0.96,
        ),
    ]


def _band(seen: np.ndarray, force: np.ndarray) -> float:
    """Return the -3 dB bandwidth of an estimate relative to a force, Hz; both signals start and end at 0."""
    size = 16 * force.size
    lines = np.fft.rfftfreq(size, T)
    inside = (lines > 1.0) & (lines < 400.0)
    ratio = np.abs(np.fft.rfft(seen, size)[inside] / np.fft.rfft(force, size)[inside])
    return float(lines[inside][np.argmax(ratio < np.sqrt(0.5))])


def bandwidths() -> list[Claim]:
    """Check that the bandwidth of the recovery is independent of law and gains, and that the bandwidth of the law's
    own estimate equals its rate.
    """
    pulse = np.zeros(10_001)
    pulse[100:120] = 200.0  # 2 ms: a spectrum without zeros below 500 Hz
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


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def in_motion() -> list[Claim]:
    """Check the recovery under simultaneous friction and cutting while the axis moves, and with a machine mode
    added.
    """
    runs = {"DADSC": _moving(dadsc(600.0)), "P-PI": _moving(cascade(600.0))}
    run = runs["DADSC"]
    late = np.concatenate([[0.0], run["load_force"][:-1]])
    true = late + run["friction_load"]  # what acted in the sample before the reading
    counted = slice(500, None)
    seen = observe(OBSERVERS["recovery, 500 Hz"], run["reading_load"], run["force"], T)
    shift = round(seen.lag / T) - 1
    recovered = _rms((seen.disturbance[shift:] - true[: true.size - shift])[counted])
    whole = _rms(true[counted])
    errors = {name: 1e6 * _rms(outcome["tracking_error"][counted]) for name, outcome in runs.items()}
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
        tool[name] = 1e6 * _rms(error[counted])
    rule = (
        f"50 mm out and back in 0.5 s a way, Coulomb friction of 30 N, 161 N RMS of milling at 200 Hz; p = 600 1/s; "
        f"{PLANT}"
    )
    there = f"{rule}; mode of 35 Hz, ζ = 0.03, 20 N/µm on the tool side; RMS of the error at the tool"
    return [
        Claim(
            "1.o",
            "the recovery at 500 Hz sees friction and cutting together: RMS error over RMS force",
            rule,
            recovered / whole,
            most=0.12,
        ),
        Claim("1.o", "tracking error of P-PI over that of DADSC", rule, errors["P-PI"] / errors["DADSC"], 0.92, 1.0),
        Claim("1.o", "RMS tracking error of DADSC", rule, errors["DADSC"], 0.66, 0.74, "um"),
        Claim("1.p", "without compensation", there, tool["none"], 7.2, 7.9, "um"),
        Claim(
            "1.p",
            "milling, friction and motion at once: the mode compensated",
            there,
            tool["none"] / tool["mode"],
            least=6.8,
            most=8.8,
            unit="times",
        ),
        Claim(
            "1.p",
            "friction taken for a load of the tool side costs",
            there,
            tool["no friction model"] / tool["mode"],
            least=1.7,
            most=2.3,
            unit="times",
        ),
    ]


ROWS: tuple[Callable[[], list[Claim]], ...] = (by_frequency, bandwidths, in_motion)
