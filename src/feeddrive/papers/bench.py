"""Pole placement (paper 2) on a measured axis with two encoders: the two-inertia bench of the University of Tokyo.

A model is identified from the odd frequency lines of a multisine, and the even lines are predicted.  Pole placement and
P-PI are designed on it by the same bounds, and judged over the box of the covariance and on the measured responses at
the even lines.  Nothing was measured under these laws.

Source of the log: T. Beauduin, W. Ohnishi, FdiTools, Hori-Fujimoto Laboratory, The University of Tokyo, 2016.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from feeddrive import plot
from feeddrive.analysis.stability import stability
from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.figures.of_loops import LinearLoop
from feeddrive.files.columns import Column as LogColumn
from feeddrive.files.read_log import read_log
from feeddrive.identification.excitation.estimate_frf import estimate_frf
from feeddrive.identification.excitation.frequency_estimate import Record
from feeddrive.identification.response.plant_fit import PlantFit, fit_two_mass
from feeddrive.language.errors import LogError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity
from feeddrive.language.table import Column, Table
from feeddrive.language.text import Text
from feeddrive.loop.axis import Axis
from feeddrive.loop.box import Box
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize
from feeddrive.loop.loop import Loop
from feeddrive.papers.claims import KEPT, LESS, Claim, Experiment, kept
from feeddrive.papers.covariance_box import DRAWS, Uncertain
from feeddrive.report.report import Picture
from feeddrive.tuning.candidates import control_with
from feeddrive.tuning.control_response import ControlResponse
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.tune import tune_control

T = 4e-4  # s, sample time of the bench
BAND = 11.0, 250.0  # Hz, lines of the multisine; below it the friction of the bearings answers
LIMITS = Limits(sensitivity_peak=2.0, delay_margin_samples=2.0)
CASCADE, PLACED = "P-PI", "pole placement (paper 2)"
LAWS = {CASCADE: "cascade_ppi", PLACED: "pole_placement"}
# any stable P-PI: the search starts from it
BEGUN = CascadePPI(Kv=10.0, Kp=0.3, Tn=0.1)
UNMEASURED = "computed on the identified axis: nothing was measured under this law"


@dataclass(frozen=True)
class Measured:
    """The measured responses of motor and load angle to the commanded current, rad/A, at odd or at even lines."""

    motor: FRF
    load: FRF

    def fit(self) -> PlantFit:
        """Fit two inertias and a spring to both responses."""
        return fit_two_mass(self.motor, self.load, held=True)


def measured(log: str | Path) -> tuple[Measured, Measured]:
    """Return the responses at the odd and at the even frequency lines (whole Hz) of the multisine.

    Raises LogError for a log without the channels of the bench, or with another sample time.
    """
    time = LogColumn(name="time", unit="us")
    channels = {"current": "iq_refx", "motor": "theta_mx", "load": "theta_my"}
    found = {}
    for role, name in channels.items():
        read = read_log(log, {"time": time, "command": name})
        # the record of 20 s has 50,000 rows: with a difference of 1e-4 it would end 5 samples elsewhere
        if abs(read.sample_time / T - 1.0) > 1e-4:
            raise LogError(
                f"{Path(log).name}: one sample takes {Quantity(read.sample_time, 's'):6 SI}, and the bench was "
                f"measured every {Quantity(T, 's'):6 SI}: give the published log, MultisineTypeA.mat"
            )
        found[role] = read["command"]
    responses = []
    for role, sign in (("motor", 1.0), ("load", -1.0)):  # the encoder of the load counts the other way
        record = Record(
            input=found["current"],
            output=sign * found[role],
            sample_time=T,
            input_name="current",
            output_name=role,
            unit="rad/A",
        )
        responses.append(estimate_frf(record, method="periodic", band=BAND).frf)
    motor, load = responses
    odd, even = (Measured(_lines(motor, rest), _lines(load, rest)) for rest in (1, 0))
    return odd, even


def _lines(frf: FRF, rest: int) -> FRF:
    """Return the lines at odd (rest 1) or even (rest 0) whole frequencies in Hz."""
    kept = np.round(frf.frequency).astype(int) % 2 == rest
    rows = {"frequency": frf.frequency[kept], "response": frf.response[kept]}
    rows |= {name: row[kept] for name in ("variance", "coherence") if (row := getattr(frf, name)) is not None}
    return replace(frf, **rows)


def axis_of(fit: PlantFit) -> tuple[Loop, Uncertain]:
    """Return the loop with the identified axis, and the box of its covariance; a torque of 1 N m stands for 1 A."""
    actuator = Actuator(dead_time=fit.actuator.dead_time)
    control = Control(law=BEGUN)
    loop = Loop(control=control, axis=Axis(plant=fit.plant, actuator=actuator, rotary=True), sample_time=T)
    places = {name: f"axis.x.actuator.{name}" for name in ("dead_time", "current_loop")}
    estimates = tuple(
        replace(estimate, name=places.get(estimate.name, f"axis.x.plant.{estimate.name}")) for estimate in fit.estimates
    )
    return loop, Uncertain(loop, estimates)


def tolerances(box: Uncertain) -> Box:
    """Return the box of a tuning: the largest relative error of both inertias, that of the stiffness, one sample more.

    It has no tolerance of damping and friction: `judged` varies them too.
    """
    shares = {
        estimate.name.rsplit(".", 1)[-1]: box.factor * estimate.error / estimate.value for estimate in box.estimates
    }
    return Box(stiffness=shares["stiffness"], mass=max(shares["mass_motor"], shares["mass_load"]), dead_time=1)


def responses(loop: Loop, frequency: np.ndarray) -> np.ndarray:
    """Return the responses of motor and load reading of the model to the command, shape (2, lines)."""
    outputs = ["reading_motor", "reading_load"]
    model = linearize(loop, ["cut"], outputs)
    return np.array([model.response(frequency, output, "cut").response for output in outputs])


def peak_on(law: Loop, by_force: np.ndarray, frequency: np.ndarray) -> float:
    """Return the largest |1 / (1 + L)| on lines where the axis has the stated responses, shape (2, lines)."""
    control = ControlResponse(law.control, float(law.sample_time), ()).at((), frequency).value
    gain = -np.einsum("kl,kl->l", control, by_force)
    return float(np.max(1.0 / np.abs(1.0 + gain)))


@dataclass(frozen=True)
class Judged:
    """A law on the identified axis, over the box, and on the measured lines.

    peaks       Ms at the model, and the largest over the box
    slowest     largest absolute value of a pole over the box
    stiff       stiffness in A/rad at 1, 10 and 60 Hz
    snap        rope-snap error, rad √s/A
    lines       largest |S| on the even lines, with the model's responses and with the measured ones
    """

    name: str
    linear: LinearLoop
    peaks: tuple[float, float]
    slowest: float
    stiff: tuple[float, float, float]
    snap: float
    lines: tuple[float, float]

    def row(self) -> list[str | Quantity]:
        """Return the row of the table."""
        numbers = [(*self.peaks, *self.lines), self.stiff]
        return [
            self.name,
            *(Quantity(peak, form=".2f") for peak in numbers[0]),
            Quantity(self.slowest, form=".4f"),
            *(Quantity(stiff, form="3") for stiff in numbers[1]),
        ]


COLUMNS = (
    "law",
    "Ms",
    "worst Ms",
    "peak of S on even lines, model",
    "measured",
    "largest pole",
    *(Column(f"A/rad at {frequency} Hz") for frequency in (1, 10, 60)),
)


def judged(name: str, law: Loop, box: Uncertain, even: Measured) -> Judged:
    """Judge a law at the model, at the corners of the box and within it, and on the measured responses."""
    peaks, poles = list[float](), list[float]()
    for place, late in box.places():
        loop = box.loop(law, place, late)
        growth = stability(loop).growth
        poles.append(growth)
        peaks.append(LinearLoop(loop).margins.sensitivity_peak or math.inf if growth < 1.0 else math.inf)
    linear, f = LinearLoop(law), even.motor.frequency
    answers = (responses(law, f), np.array([even.motor.response, even.load.response]))
    return Judged(
        name,
        linear,
        (peaks[0], max(peaks)),
        max(poles),
        (linear.stiffness_at(1.0), linear.stiffness_at(10.0), linear.stiffness_at(60.0)),
        linear.rope_snap,
        (peak_on(law, answers[0], f), peak_on(law, answers[1], f)),
    )


def designs(loop: Loop, box: Uncertain) -> dict[str, Loop]:
    """Return both laws, tuned by the same bounds over the box; the controls have no filters and no feedforward.

    The bounds hold around the identified axis, and around two that are least damped and latest within the box, with the
    least and the most friction of the motor: the log hardly tells these numbers, and they decide how high the mode
    rises.
    """
    laws = {}
    for name, kind in LAWS.items():
        begun = control_with(loop, kind)
        points = [loop, *(_ends(loop, box, friction) for friction in (-1.0, 1.0))]
        tuned = tune_control(begun, points, limits=LIMITS, filters="kept", box=tolerances(box))
        laws[name] = replace(loop, control=tuned.control)
    return laws


def _ends(loop: Loop, box: Uncertain, friction: float) -> Loop:
    """Return the loop with the least damped and latest axis, and friction of the motor at an end of the box."""
    ends = {"damping": -1.0, "viscous_motor": friction, "viscous_load": -1.0, "dead_time": 1.0}
    return box.loop(loop, [ends.get(estimate.name.rsplit(".", 1)[-1], 0.0) for estimate in box.estimates], 0)


def left(loop: Loop, even: Measured) -> tuple[float, float]:
    """Return the RMS relative difference of model and measurement at the even lines, of motor and load."""
    model = responses(loop, even.motor.frequency)
    rows = zip(model, (even.motor, even.load), strict=True)
    motor, load = (float(np.sqrt(np.mean(np.abs(row / frf.response - 1.0) ** 2))) for row, frf in rows)
    return motor, load


def bench(log: str | Path, progress: Progress) -> Experiment:
    """Identify the bench from the odd lines, predict the even ones, and judge pole placement beside P-PI.

    Raises LogError for another log.
    """
    progress.step("reading the log")
    odd, even = measured(log)
    progress.step("identification from the odd lines")
    fit, other = odd.fit(), even.fit()
    loop, box = axis_of(fit)
    progress.step("laws")
    laws = designs(loop, box)
    rows: dict[str, Judged] = {}
    for name, law in laws.items():
        progress.step(f"box: {name}")
        rows[name] = judged(name, law, box, even)
    return Experiment(
        name="bench",
        title="Pole placement on a measured axis with two encoders",
        citation="Log: T. Beauduin, W. Ohnishi, FdiTools, Hori-Fujimoto Laboratory, The University of Tokyo, 2016",
        claims=(*_measured_claims(fit, left(loop, even), left(axis_of(other)[0], even)), *_law_claims(rows)),
        tables=(
            box.table(None, "the axis by the odd lines"),
            Table("Both laws on the identified axis, over the box, and on the measured lines", COLUMNS, _rows(rows)),
        ),
        pictures=_pictures(rows),
        facts={
            "log": f"{Path(log).name}; {odd.motor.frequency.size} odd lines identify, {even.motor.frequency.size} even "
            "ones are predicted",
            "box": Text(
                f"± {Quantity(box.factor):3} errors of inertias, spring, damping, friction and dead time (95 % "
                f"ellipsoid), 0 or 1 more sample of dead time; {2 ** (len(box.estimates) + 1)} corners and {DRAWS} "
                "draws, seed 0"
            ),
            "bounds of the designs": LIMITS.sentence(),
        },
        notes=NOTES,
    )


NOTES = (
    "Nothing was measured under these laws. The peak of S on the measured lines is that of the law with the responses "
    "that were measured, without a model between them; it says nothing of frequencies outside 12 to 250 Hz.",
    "The log has no torque constant: torques, inertias and stiffnesses are in A, and 1 N m in a file stands for 1 A.",
    "The bench is a motor on a coupling, and no ball screw: its inertia ratio is 0.98, its mode at 76 Hz.",
    "The damping of the coupling depends on the amplitude of the motion (rolling friction of the bearings): a linear "
    "model leaves some percent of each response, which its errors include.",
)


def _rows(rows: Mapping[str, Judged]) -> list[list[str | Quantity]]:
    return [row.row() for row in rows.values()]


def _measured_claims(fit: PlantFit, model: tuple[float, float], own: tuple[float, float]) -> Iterator[Claim]:
    rule = "two inertias and a spring, fitted to motor and load angle by commanded current, odd lines of 11 to 250 Hz"
    for key, name, expected in (("6.a", "resonance", 76.21), ("6.b", "antiresonance", 53.95)):
        estimate = fit[name]
        yield Claim(
            key,
            f"The {name} of the odd lines is that of another fit: difference over its error",
            rule,
            abs(estimate.value - expected) / estimate.error,
            most=1.96,
            expected=f"{expected} Hz, an independent fit by the measured current; within the 95 % of a normal error",
            one_sided=LESS,
        )
    for key, name, found, best in zip(("6.c", "6.d"), ("motor", "load"), model, own, strict=True):
        yield Claim(
            key,
            f"The even lines of the {name} are predicted as well as by a model that was fitted to them: ratio",
            f"RMS of |model / measured - 1| over the even lines, {100.0 * found:.1f} % and {100.0 * best:.1f} %",
            found / best,
            least=0.9,
            most=1.1,
        )


def _law_claims(rows: Mapping[str, Judged]) -> Iterator[Claim]:
    placed, cascade = rows[PLACED], rows[CASCADE]
    rule = f"{LIMITS.sentence()} over the box for both, no filters; {UNMEASURED}"
    for key, row in (("6.e", cascade), ("6.f", placed)):
        yield Claim(
            key,
            f"{row.name} keeps Ms <= 2 over the box of the covariance, and uses it",
            rule,
            row.peaks[1],
            least=1.85,
            most=2.02,
            expected="2, and a percent for damping and friction, which the tuner's box does not vary",
        )
    yield Claim(
        "6.g",
        "Both are stable on every plant of it: largest pole",
        rule,
        max(placed.slowest, cascade.slowest),
        most=0.9999,
        one_sided=LESS,
    )
    for key, place, frequency, figure, expected in (
        ("6.h", 0, 1, 4.34, "2.4 on the paper's axis at equal Ms; more, as the mode is nearer to the crossover"),
        ("6.i", 1, 10, 2.74, "more than 1"),
        ("6.j", 2, 60, 0.670, "0.75 at 60 Hz on the paper's axis: it pays at the mode"),
    ):
        yield Claim(
            key,
            f"Pole placement is {'stiffer' if figure > 1.0 else 'softer'} than P-PI at {frequency} Hz: ratio",
            f"{rule}; {KEPT}",
            placed.stiff[place] / cascade.stiff[place],
            *kept(figure),
            expected=expected,
        )
    yield Claim(
        "6.k",
        "It recovers from a rope snap with a smaller error: ratio",
        f"{rule}; {KEPT}",
        placed.snap / cascade.snap,
        *kept(0.427),
        expected="no figure was given; in the paper it recovers in half of the time",
    )
    for key, row in (("6.l", cascade), ("6.m", placed)):
        yield Claim(
            key,
            f"With the measured responses in place of the model {row.name} has the predicted peak of S: ratio",
            "even lines, which the model has not seen; largest |1/(1 + L)|; no run under this law",
            row.lines[1] / row.lines[0],
            least=0.9,
            most=1.1,
        )


def _pictures(rows: Mapping[str, Judged]) -> tuple[Picture, ...]:
    return (
        Picture(
            "stiffness",
            "Dynamic stiffness of the load",
            "Both laws by the same bounds on the identified axis; 1 N m stands for 1 A.",
            "pole placement is stiffer at low frequencies and softer about the mode",
            partial(plot.stiffness_chart, {name: row.linear.stiffness for name, row in rows.items()}),
        ),
        Picture(
            "sensitivity",
            "Sensitivity",
            "At the model; the bound holds over the box.",
            "both peaks are below 2 at the model, and reach 2 at the worst plants of the box",
            partial(plot.sensitivity_chart, {name: row.linear.margins for name, row in rows.items()}),
        ),
    )
