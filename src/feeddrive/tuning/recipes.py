"""Classical tuning rules for the P-PI cascade on a measured or modelled axis, with the filters of the controller."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from feeddrive.analysis.margins import margins
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.figures.of_loops import EVERYWHERE, STIFFNESS_MEAN
from feeddrive.language.errors import FeeddriveError, NotIdentifiableError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number, span
from feeddrive.language.table import UNIT, Column, Result, Table
from feeddrive.language.text import Text
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.loop import Loop
from feeddrive.tuning.closed_loop import Figures, figures
from feeddrive.tuning.control_response import ControlResponse, Response
from feeddrive.tuning.criteria import Criteria, Limits
from feeddrive.tuning.operating_point import OperatingPoint, modelled_point, position_loop, response_on

# a gain small enough to count as zero, which is outside the bounds of Kv
_OFF = 1e-9
_STRAIGHT = math.radians(30.0)  # phase lag up to which lines are used for mass and lag
# Kv = ωv/4 damps a position loop around a first-order velocity loop critically
_CRITICAL = 4.0
# ωv τ at which Tn = 4/ωv and Kv = ωv/4 give Ms = 2 on a free mass, at one sample of dead time
_MAKERS = 0.507
_MAKERS_PEAK = 2.0  # largest Ms of the maker's rule
# Tn = 4/ωv: the integral action costs 14° of phase at the crossover
_SLOW = 4.0
GOALS = {"robust": (12.0, 60.0), "dynamic": (7.0, 45.0)}  # gain margin in dB and phase margin in deg


@dataclass(frozen=True, eq=False, repr=False)
class Recipe(Result):
    """The result of a tuning rule: a law, the reason for its gains, and the axis data on which the rule is based.

    mass       mass of the free axis as seen by the velocity loop, kg
    lag        total lag from force command to velocity, s: computation, current loop, filters, differentiation
    """

    name: str
    law: CascadePPI
    reason: str
    source: str
    mass: float
    lag: float

    def table(self) -> Table:
        """Return the gains and the data from which they are computed."""
        law = self.law
        rows = [
            ["Kv", Quantity(law.Kv, "1/s"), UNIT],
            ["Kp", Quantity(law.Kp, "N s/m"), UNIT],
            ["Tn", "none", "s"] if law.Tn is None else ["Tn", Quantity(law.Tn, "s"), UNIT],
            ["moved mass", Quantity(self.mass, "kg"), UNIT],
            ["lag", Quantity(self.lag, "s", form="4 SI"), UNIT],
        ]
        columns = ["what", Column("value", form="5 SI"), "unit"]
        return Table(f"{self.name}: {self.reason} ({self.source})", columns, rows)


class _Axis:
    """The data of an axis for the tuning rules, identified at an operating point from its velocity loop with Kp = 1."""

    def __init__(self, point: OperatingPoint | Loop, control: Control | None) -> None:
        if isinstance(point, Loop):
            control, point = control or point.control, modelled_point(point)
        if control is None:
            control = Control(law=CascadePPI(Kv=1.0, Kp=1.0))
        law = control.law if isinstance(control.law, CascadePPI) else CascadePPI(Kv=1.0, Kp=1.0)
        self.point, self.law = point, replace(law, viscous=None)
        self.control = replace(control, law=self.law, compensation=())
        self.frequency = point.frequency
        self.unit = self.gain(replace(self.law, Kv=_OFF, Kp=1.0, Tn=None))
        self.mass, self.lag = self._read()

    def gain(self, law: CascadePPI) -> np.ndarray:
        """Return the loop gain at the actuator with a law."""
        return -np.einsum("kl,kl->l", self.response(law).value, self.point.by_force)

    def response(self, law: CascadePPI) -> Response:
        """Return the response of the controller with its law replaced by `law`."""
        return response_on(self.point, replace(self.control, law=law))

    def velocity_loop(self, Kp: float, Tn: float | None) -> FRF:
        """Return the loop gain of the PI velocity loop, Kp (P + I/Tn): a search over Kp and Tn takes two responses."""
        proportional, integral = self._velocity_parts
        gain = Kp * (proportional if Tn is None else proportional + integral / Tn)
        return FRF(self.frequency, gain, "cut", "force", "N/N", self.point.sample_time)

    @cached_property
    def _velocity_parts(self) -> tuple[np.ndarray, np.ndarray]:
        """P and I of the loop gain of the PI velocity loop."""
        # without a position loop there is no slower part
        law = replace(self.law.at_one_rate(), Kv=_OFF, Kp=1.0)
        proportional = self.gain(replace(law, Tn=None))
        return proportional, self.gain(replace(law, Tn=1.0)) - proportional

    def _read(self) -> tuple[float, float]:
        """Identify mass m and lag from the lines below all resonances.

        There the response of velocity to force is 1/((m s + b) e^(s lag)) with viscous friction b. Its inverse,
        b + (m + b lag) s + (m lag + ...) s², is fitted with real coefficients and equal relative weight on all lines.
        """
        w = 2.0 * np.pi * self.frequency
        phase = np.angle(self.unit * 1j)  # 0 for a free mass, up to 90° where friction dominates
        late = np.flatnonzero(phase < -_STRAIGHT)
        first = 0.4 * self.antiresonance()
        last = min(int(late[0]) if late.size else w.size, int(np.searchsorted(self.frequency, first)))
        if last < 5 or phase[last - 1] > 2.0 * _STRAIGHT:
            end = self.frequency[max(last - 1, 0)]
            raise NotIdentifiableError(
                f"'{self.point.name}' shows no mass from {span(self.frequency[0], end, 'Hz')}: measure "
                "between the friction, which holds it below, and its first resonance above"
            )
        s = 1j * w[:last] / w[last - 1]
        rows = np.stack([s**0, s, s * s], axis=1) * np.abs(self.unit[:last, None])
        right = np.abs(self.unit[:last]) / self.unit[:last]
        both = np.vstack([np.real(rows), np.imag(rows)])
        c0, c1, c2 = np.linalg.lstsq(both, np.concatenate([np.real(right), np.imag(right)]))[0]
        scale = w[last - 1]
        # the hold of the force alone delays by half a sample
        lag = max(float(c2 / c1 / scale), 0.5 * self.point.sample_time)
        return float(c1 / scale - c0 * lag), lag

    def antiresonance(self) -> float:
        """Return the first antiresonance, Hz, as the velocity loop's encoder shows it; infinite if there is none."""
        level = np.log(np.abs(self.unit) * self.frequency)
        for k in range(2, level.size - 2):
            if level[k] == np.min(level[max(k - 5, 0) : k + 6]):
                above = self.frequency > self.frequency[k]
                below = self.frequency < self.frequency[k]
                if np.max(level[above]) > level[k] + 0.4 and np.max(level[below]) > level[k] + 0.4:
                    return float(self.frequency[k])
        return math.inf

    def recipe(self, name: str, Kp: float, Tn: float | None, Kv: float, reason: str, source: str) -> Recipe:
        """Return a recipe with the given gains and the data of this axis."""
        return Recipe(name, replace(self.law, Kp=Kp, Tn=Tn, Kv=Kv), reason, source, self.mass, self.lag)


def symmetric_optimum(point: OperatingPoint | Loop, control: Control | None = None, *, a: float = 3.0) -> Recipe:
    """Return PI gains by the symmetric optimum for a free mass with a lag τ, and Kv as a quarter of its crossover.

        Kp = m/(a τ),   Tn = a² τ,   Kv = 1/(4 a τ)

    The phase of L is highest at the crossover 1/(aτ), so that the phase margin is atan a - atan 1/a: 37°, 53° and 62°
    for a = 2, 3 and 4. If the lag is a dead time, Ms of the velocity loop is 1.96, 1.42 and 1.27, and with
    the position loop closed 2.61, 1.56 and 1.33: the textbook value a = 2 is too aggressive for a position loop. The
    rule is unsuitable if there is a resonance below about 3/(aτ).
    Source: Kessler 1958, Das symmetrische Optimum; Kv as in `kv_rule`.
    """
    if not a > 1.0:
        raise ParameterError(f"a = {number(a, 6)} must be > 1")
    axis = _Axis(point, control)
    tau = axis.lag
    reason = Text(f"mass {Quantity(axis.mass, 'kg')}, lag {Quantity(tau, 's'):3}, a = {number(a, 6)}")
    return axis.recipe(
        "symmetric optimum", axis.mass / (a * tau), a * a * tau, 1.0 / (_CRITICAL * a * tau), reason, "Kessler 1958"
    )


def makers_rule(point: OperatingPoint | Loop, control: Control | None = None) -> Recipe:
    """Return gains in the ratios that drive makers recommend.

    The velocity gain is the one for which Ms = 2 on a free mass with lag τ:

        Kp = m ωv,   Tn = 4/ωv,   Kv = ωv/4,   ωv = 0.507/τ

    If the real loop, with its filters and resonances, exceeds Ms = 2, ωv is reduced to the largest value that keeps
    Ms <= 2.
    Raises NotIdentifiableError if no gain gives Ms <= 2.
    Source: manuals of Yaskawa's Σ series (Tn >= 4/ωv) and of Mitsubishi's MR-J (an outer loop 4 to 6 times slower than
    the next inner one); 0.507 is computed for a dead time of one sample.
    """
    axis = _Axis(point, control)

    def law(rate: float) -> CascadePPI:
        return replace(axis.law, Kp=axis.mass * rate, Tn=_SLOW / rate, Kv=rate / _CRITICAL)

    def keeps(rate: float) -> bool:
        loop = FRF(axis.frequency, axis.gain(law(rate)), "cut", "force", "N/N", axis.point.sample_time)
        return margins(loop).sensitivity_peak <= _MAKERS_PEAK

    usual = _MAKERS / axis.lag
    rate = _largest(keeps, 1e-3 * usual, usual)
    if rate is None:
        raise NotIdentifiableError("no velocity gain keeps Ms <= 2: filter the resonances first")
    lowered = "" if rate == usual else Text(f", lowered from {Quantity(usual / (2.0 * math.pi), 'Hz')} to keep Ms <= 2")
    reason = Text(
        f"mass {Quantity(axis.mass, 'kg')}, velocity loop at {Quantity(rate / (2.0 * math.pi), 'Hz')}{lowered}"
    )
    gains = law(rate)
    return axis.recipe("maker's rule", gains.Kp, gains.Tn, gains.Kv, reason, "manuals of drives")


def kv_rule(point: OperatingPoint | Loop, control: Control | None = None, *, damping: float = 1.0) -> Recipe:
    """Return Kv from the crossover ωv of the present velocity loop: Kv = ωv/(4 D²) with D = `damping`.

    If the velocity loop behaves like a first-order lag with time constant 1/ωv, the position loop has the damping
    ratio D.
    Raises ParameterError for a velocity loop without crossover.
    Source: Weck & Brecher, Werkzeugmaschinen 3, position loops of feed drives.
    """
    axis = _Axis(point, control)
    law = axis.law
    crossover = margins(axis.velocity_loop(law.Kp, law.Tn)).crossover
    if crossover is None:
        raise ParameterError(
            f"with Kp = {Quantity(law.Kp, 'N s/m'):6} the velocity loop has no crossover: set Kp first"
        )
    Kv = 2.0 * math.pi * crossover / (4.0 * damping * damping)
    reason = Text(f"the velocity loop crosses over at {Quantity(crossover, 'Hz')}, damping ratio {number(damping, 6)}")
    return axis.recipe("Kv rule", law.Kp, law.Tn, Kv, reason, "Weck & Brecher")


def half_antiresonance(point: OperatingPoint | Loop, control: Control | None = None) -> Recipe:
    """Return gains with the velocity crossover at half of the first antiresonance, Tn = 4/ωv and Kv = ωv/4.

    Below the antiresonance, motor and table move together, so that the spring does not affect the velocity loop. The
    crossover is limited to 1/(2τ), where τ is the lag.
    Raises NotIdentifiableError if the axis shows no antiresonance.
    Source: a rule of thumb for drives with an elastic coupling.
    """
    axis = _Axis(point, control)
    first = axis.antiresonance()
    if not math.isfinite(first):
        raise NotIdentifiableError(
            f"'{axis.point.name}' shows no antiresonance up to {Quantity(axis.frequency[-1], 'Hz')}: take "
            "symmetric_optimum, or measure higher"
        )
    rate = min(math.pi * first, 0.5 / axis.lag)
    reason = Text(f"first antiresonance {Quantity(first, 'Hz')}, crossover {Quantity(rate / (2.0 * math.pi), 'Hz')}")
    Kp = _by_crossover(axis, rate)
    return axis.recipe("half the first antiresonance", Kp, _SLOW / rate, rate / _CRITICAL, reason, "rule of the trade")


def margin_goals(point: OperatingPoint | Loop, control: Control | None = None, *, goal: str = "robust") -> Recipe:
    """Return the highest velocity gain, and then the highest Kv, for which the real loop has the required margins.

        robust: 12 dB and 60°,   dynamic: 7 dB and 45°,   Tn = 4/ωv,   Kv <= ωv/4

    The velocity loop is tuned first, as in the automatic tuning of commercial controllers; the margins of both goals
    are our own choice.
    Raises NotIdentifiableError if no gain gives these margins.
    """
    if goal not in GOALS:
        raise ParameterError(f"goal = {goal!r} must be one of {', '.join(GOALS)}")
    least_gain, least_phase = GOALS[goal]
    axis = _Axis(point, control)

    def keeps(L: FRF) -> bool:
        loop_margins = margins(L)
        gain, phase = loop_margins.gain_increase_dB, loop_margins.phase_margin_deg
        return (gain is None or gain >= least_gain) and (phase is None or phase >= least_phase)

    def integral(Kp: float) -> float:
        return _SLOW * axis.mass / Kp

    highest = axis.mass / axis.lag
    Kp = _largest(lambda value: keeps(axis.velocity_loop(value, integral(value))), 1e-3 * highest, 3.0 * highest)
    if Kp is None:
        raise NotIdentifiableError(
            f"no velocity gain keeps {Quantity(least_gain, 'dB'):6} and {Quantity(least_phase, 'deg'):6}: filter the "
            "resonances first"
        )
    Tn, rate = integral(Kp), Kp / axis.mass
    most = rate / _CRITICAL
    inner, outer = (axis.response(replace(axis.law, Kv=Kv, Kp=Kp, Tn=Tn)) for Kv in (_OFF, most))
    # the position loop around the closed velocity loop is proportional to Kv, also at its own slower rate
    whole = position_loop(axis.point, outer, inner)
    Kv = _largest(lambda value: keeps(replace(whole, response=value / most * whole.response)), 1e-3 * rate, most)
    if Kv is None:
        raise NotIdentifiableError(
            f"no Kv keeps {Quantity(least_gain, 'dB'):6} and {Quantity(least_phase, 'deg'):6} with Kp = "
            f"{Quantity(Kp, 'N s/m'):6}"
        )
    reason = Text(
        f"gain margin >= {Quantity(least_gain, 'dB'):6} and phase margin >= {Quantity(least_phase, 'deg'):6}, velocity "
        "loop first"
    )
    return axis.recipe(f"margins, {goal}", Kp, Tn, Kv, reason, "own numbers")


def _by_crossover(axis: _Axis, rate: float) -> float:
    """Return the Kp for which the velocity loop without integral action has its crossover at `rate` in rad/s."""
    size = np.interp(np.log(rate / (2.0 * np.pi)), np.log(axis.frequency), np.log(np.abs(axis.unit)))
    return float(np.exp(-size))


def _largest(admits: Callable[[float], bool], low: float, high: float) -> float | None:
    """Return the largest value such that all values from `low` up to it are admissible; None if `low` is not.

    A scan in small steps finds the first inadmissible value; bisection refines it.
    """
    if not admits(low):
        return None
    steps = np.geomspace(low, high, 40)
    last = low
    # in small steps from below: bisection alone could end in an admissible range above one that is not
    for value in steps[1:]:
        if not admits(float(value)):
            low, high = last, float(value)
            break
        last = float(value)
    else:
        return high
    for _ in range(12):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if admits(middle) else (low, middle)
    return low


RECIPES: dict[str, Callable[..., Recipe]] = {
    "symmetric-optimum": symmetric_optimum,
    "makers-rule": makers_rule,
    "kv-rule": kv_rule,
    "half-antiresonance": half_antiresonance,
    "margins-robust": margin_goals,
    "margins-dynamic": lambda point, control=None: margin_goals(point, control, goal="dynamic"),
}


@dataclass(frozen=True, eq=False)
class JudgedRecipe:
    """A tuning rule applied to an axis.

    recipe   the result; None if the rule does not apply
    figures  figures of the loop at every operating point
    reason   reason why the rule does not apply
    """

    name: str
    recipe: Recipe | None
    figures: tuple[Figures, ...]
    reason: str


def judged_recipes(
    points: Sequence[OperatingPoint | Loop],
    control: Control,
    limits: Limits,
    progress: Progress | None = None,
    velocity: float = 0.05,
) -> tuple[JudgedRecipe, ...]:
    """Apply every tuning rule at the first point, and evaluate the resulting laws at all points.

    The filters are those of `control`.
    """
    operating_points = tuple(
        modelled_point(source, f"axis {i + 1}" if len(points) > 1 else "model", velocity=velocity)
        if isinstance(source, Loop)
        else source
        for i, source in enumerate(points)
    )
    recipes: list[JudgedRecipe] = []
    for name, rule in RECIPES.items():
        if progress is not None:
            progress.step(f"rule {name}")
        try:
            recipe = rule(operating_points[0], control)
        except FeeddriveError as error:
            recipes.append(JudgedRecipe(name, None, (), str(error)))
            continue
        whole = replace(control, law=recipe.law, compensation=())
        response = ControlResponse(whole, operating_points[0].sample_time, (), velocity)
        answers = Criteria(operating_points, response, STIFFNESS_MEAN, limits, EVERYWHERE).answers(np.zeros(0))
        recipes.append(
            JudgedRecipe(
                name, recipe, tuple(figures(answer, limits.reading_noise) for answer in answers), recipe.reason
            )
        )
    return tuple(recipes)
