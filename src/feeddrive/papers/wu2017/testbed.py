"""The x-y table of the experiments: its axes with either friction model, moves, noise, and the plots of the paper."""

import dataclasses
from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from feeddrive.blocks.feedforward.disturbance_compensator import DisturbanceCompensator
from feeddrive.blocks.friction.directional_stribeck import DirectionalStribeck
from feeddrive.blocks.friction.regularised import Regularised
from feeddrive.blocks.load.recorded_force import RecordedForce
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.files.machine import read_machine
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.learning.iterative_feedforward import compensated
from feeddrive.learning.trials import Trials
from feeddrive.loop.loop import Loop
from feeddrive.plot import style
from feeddrive.plot.chart import LOG, MARKED, PLAIN, Abscissa, Chart, Curve, Disc, Level, Panel, numbered
from feeddrive.plot.curves import Row, curves_chart
from feeddrive.plot.tuning import errors_and_parameters_chart, rms_panel
from feeddrive.report.report import Picture

TRANSITION = 2e-4  # m/s, v_t of the tanh friction of the tables
FORCE_CONSTANT = 300.0  # N/A
NOISE = 5.0  # N, standard deviation of the force noise added in each sample
TRIALS = 6
SAMPLES = 20_000  # number of noise samples, more than in any move
# columns by set, and as the tables call them
SETS = {
    "a, b": ("mass", "viscous"),
    "+ Coulomb": ("mass", "viscous", "coulomb_positive", "coulomb_negative"),
    "+ Stribeck": ("mass", "viscous", "coulomb_positive", "coulomb_negative", "stribeck"),
}
PLANT = (
    "bundled machine xy_table: x 120 kg, 400 N s/m, Coulomb +95/-80 N, static 130 N, v_s 6 mm/s; P-PI Kv 40 1/s, "
    "150 A s/m at 300 N/A, Tn 15 ms; 4 kHz, one sample of dead time, 0.1 um"
)
TANH = "tanh friction, v_t 0.2 mm/s"
SET_VALUED = "set-valued friction"
RULE = Text(
    f"x axis, theta from [0.15 A s²/m, 0, 0, 0], model-free, gamma 1, {Quantity(NOISE, 'N'):6} force noise, seeds 0 to "
    "5"
)


# cached, since `noise` needs the sample time in every trial
@lru_cache
def _machine(axis: str) -> Loop:
    return read_machine("xy_table").loop(axis)


def table_axis(axis: str, columns: tuple[str, ...], *, smooth: bool = True, exact: bool = False) -> Loop:
    """Return an axis of the table with a compensator that has the given basis functions.

    smooth  tanh friction, as in the tables; otherwise the friction model of the machine file
    exact   mass and viscous friction of the axis are fed forward from the start; otherwise 45 kg and 0
    """
    loop = _machine(axis)
    friction = loop.axis.friction_load
    assert isinstance(friction, DirectionalStribeck)
    if smooth:
        tanh = Regularised(
            coulomb=friction.coulomb_positive,
            coulomb_negative=friction.coulomb_negative,
            breakaway=friction.breakaway_positive,
            stribeck_velocity=friction.stribeck_velocity,
            transition_velocity=TRANSITION,
            viscous=friction.viscous,
        )
        loop = dataclasses.replace(loop, axis=dataclasses.replace(loop.axis, friction_load=tanh))
    # 45 kg is the start of `RULE`, 0.15 A s²/m, at 300 N/A
    start_values = dict.fromkeys(columns, 0.0) | {"mass": 45.0}
    if exact:
        start_values |= {"mass": float(loop.axis.plant.rigid_mass()), "viscous": float(friction.viscous)}
    speed = float(friction.stribeck_velocity) if "stribeck" in columns else None
    return compensated(loop, DisturbanceCompensator(**start_values, stribeck_velocity=speed))


def move(distance: float, velocity: float, acceleration: float, jerk: float) -> SnapLimitedMove:
    """Return a move out and back; the snap corresponds to a jerk ramp of 4 ms."""
    return SnapLimitedMove(
        distance=distance,
        velocity=velocity,
        acceleration=acceleration,
        jerk=jerk,
        snap=jerk / 4e-3,
        back=True,
        dwell_before=0.02,
        dwell_between=0.2,
        dwell_after=0.2,
    )


SAME = move(0.1, 0.25, 3.0, 60.0)
OTHERS = (move(0.06, 0.15, 2.0, 40.0), move(0.2, 0.4, 4.0, 80.0), move(0.03, 0.1, 1.5, 50.0))
# ends on the first move, so that its last trial can be compared with six equal ones
CHANGING = (SAME, *OTHERS, SAME, SAME)


def noise(trial: int, size: float = NOISE) -> RecordedForce:
    """Return white force noise; the trial number is its seed."""
    values = np.random.default_rng(trial).standard_normal(SAMPLES)
    return RecordedForce(force=size * values, sample_time=float(_machine("x").sample_time))


def amperes(value: float) -> float:
    """Convert a parameter to units of the drive."""
    return value / FORCE_CONSTANT


RADIUS = 0.02  # m
ZOOM = 400.0  # magnification of contour errors in polar plots


def errors(same: Mapping[str, Trials]) -> Picture:
    """Return the picture of the RMS error over the trials."""
    last = joined(", ", (f"{name} {Quantity(trials.rms[-1], 'm'):.2f}" for name, trials in same.items()))
    caption = "The same 100 mm move six times; each trial uses the parameters of the last one. tanh friction."
    return Picture(
        "errors",
        "Error over the trials",
        caption,
        Text(f"RMS falls within two trials; last: {last}."),
        lambda: errors_chart({name: 1e6 * trials.rms for name, trials in same.items()}),
    )


def parameters(trials: Trials) -> Picture:
    """Return the picture of the parameters with their standard errors."""
    caption = "Bars are two standard errors, estimated from the residual of each single trial, with its color."
    alt = "The mass is found at once, the friction levels within five trials."
    return Picture(
        "parameters", "Parameters over the trials", caption, alt, lambda: errors_and_parameters_chart({"": trials})
    )


def over_time(same: Mapping[str, Trials]) -> Picture:
    """Return the picture of the first and last following error over time."""

    def draw() -> Chart:
        first = next(iter(same.values())).trials[0]
        time = first.time
        rows = [Row("first trial (µm)", {"start": 1e6 * first.following_error})]
        rows.append(Row("last trial (µm)", {name: 1e6 * t.trials[-1].following_error for name, t in same.items()}))
        return curves_chart("time (s)", time, rows)

    caption = "Following error of the first trial, and of the sixth with each set of columns."
    alt = "With a and b alone a bump is left after each reversal; Coulomb and Stribeck columns remove it."
    return Picture("overtime", "Following error before and after", caption, alt, draw)


def rates(masses: np.ndarray, factors: Mapping[str, list[float]], free: float) -> Picture:
    """Return a plot of the rate of convergence versus the assumed mass."""
    caption = "ρ: factor of the parameters' error from trial to trial. The right mass gives 0, drawn at 1e-3."
    alt = "A mass wrong by a factor of two leaves 5 %; where the curves end the model loop is unstable and refused."
    return Picture("convergence", "Rate of convergence", caption, alt, lambda: rates_chart(masses, factors, free))


def contour(paths: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Picture:
    """Return the polar picture of the contour error; x and y in m relative to the center."""
    caption = f"Circle of 20 mm radius at 0.1 m/s, two turns; the contour error is drawn {number(ZOOM)} times larger."
    alt = "Quadrant glitches stay with a and b alone and nearly vanish with the compensator."
    return Picture("contour", "Contour of the circle", caption, alt, lambda: contour_chart(paths))


def quadrant(time: np.ndarray, errors: Mapping[str, np.ndarray]) -> Picture:
    """Return the picture of the contour error in a window around a reversal."""
    caption = "One quadrant of the second turn, where the x axis reverses."
    alt = "The peak after the reversal falls with the compensator."
    rows = [Row("contour error (µm)", {name: 1e6 * values for name, values in errors.items()})]
    return Picture("quadrant", "Quadrant glitch, zoomed", caption, alt, lambda: curves_chart("time (s)", time, rows))


def against_signal(curves_by_name: Mapping[str, np.ndarray], title: str, key: str) -> Picture:
    """Return the picture of the RMS error over the trials, for learned parameters and for a learned signal."""
    caption = "Parameters that fit any motion, against a force learned sample by sample."
    alt = "The learned force is better while the task repeats, and increases the error when the reference changes."
    rows = {name: 1e6 * rms for name, rms in curves_by_name.items()}
    return Picture(key, title, caption, alt, lambda: errors_chart(rows, 2))


def errors_chart(rows: Mapping[str, np.ndarray], columns: int = 4) -> Chart:
    """Plot the RMS of the following error in µm over the trials, one curve per name."""
    trials = range(1, 1 + max(rms.size for rms in rows.values()))
    panel = rms_panel(rows, "following error RMS")
    low, high = style.padded(float(trials[0]), float(trials[-1]), 0.03)
    return Chart("trial", (panel,), low=low, high=high, ticks=numbered(trials), height=3.2, columns=columns)


def rates_chart(masses: np.ndarray, factors: Mapping[str, list[float]], free: float) -> Chart:
    """Plot the rate of convergence versus the assumed mass."""
    curves = tuple(
        # a logarithmic scale has no 0, the rate of the right mass
        Curve(masses, np.maximum(np.array(values), 1e-3), f"model-based, {name}", i, MARKED)
        for i, (name, values) in enumerate(factors.items())
    )
    level = Level(free, dashed=True, caption="model-free")
    panel = Panel("rate ρ", curves, levels=(level,), scale=LOG)
    return Chart("assumed mass / mass of the axis", (panel,), LOG, height=3.2)


def contour_chart(paths: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> Chart:
    """Plot the contour error in polar form; x and y in m relative to the center."""
    nominal = Disc(0.0, 0.0, 1e3 * RADIUS)
    panels = list[Panel]()
    for i, (name, (x, y)) in enumerate(paths.items()):
        off = np.hypot(x, y) - RADIUS
        shown = 1e3 * (RADIUS + ZOOM * off) * np.exp(1j * np.arctan2(y, x))
        line = Curve(np.real(shown), np.imag(shown), number=i, look=PLAIN, size=0.65)
        caption = Text(f"{name}: RMS {Quantity(np.sqrt(np.mean(off**2)), 'm'):.2f}")
        reach = 1.05 * max(1e3 * RADIUS, float(np.max(np.abs(shown))))
        abscissa = Abscissa("x (mm)", low=-reach, high=reach, square=True)
        panels.append(
            Panel("y (mm)", (line,), discs=(nominal,), low=-reach, high=reach, caption=caption, abscissa=abscissa)
        )
    return Chart("", tuple(panels), across=2, height=3.4 * -(-len(paths) // 2))
