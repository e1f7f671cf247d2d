"""Shape a control on measured or modelled axes: gains and filters together, within limits at every one of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from feeddrive.language.errors import ParameterError
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.shaping.control_response import ControlResponse
from feeddrive.tuning.shaping.criteria import GOALS
from feeddrive.tuning.shaping.limits import Limits
from feeddrive.tuning.shaping.result import result
from feeddrive.tuning.shaping.shaped_loop import Tuned
from feeddrive.tuning.shaping.site import Site, modelled_site
from feeddrive.tuning.shaping.tunables import filter_tunables, law_tunables
from feeddrive.tuning.shaping.work import Work

FILTERS = ("kept", "free", "placed")


def tune(
    control: Control | Loop,
    sites: Site | Loop | Sequence[Site | Loop] | None = None,
    *,
    goal: str = "rope-snap",
    limits: Limits | None = None,
    tunables: Sequence[str] | None = None,
    filters: str = "free",
    band: tuple[float, float] = (0.0, math.inf),
    confidence: float = 0.95,
    starts: int = 2,
    seed: int = 0,
    velocity: float = 0.05,
    today: Control | None = None,
    step: Callable[[str], None] | None = None,
) -> Tuned:
    """The control with the tunables that are best for the goal while all limits hold at every site.

        minimise  max over sites of the goal   over ln(tunables)   subject to   slack_i >= k σ_i  for all limits i

    goal        rope-snap: ISE^½ = [∫ |y|²/ω² dω/π]^½;  stiffness: the mean of |y|² over ln f in the band;
                least-stiffness: max |y| in the band;  bandwidth: 1/(frequency at which |1/(1 + L)| rises to -3 dB);
                y is the compliance of the closed loop
    control     where the search begins; a loop stands for its control, on its own axis if no site is given
    sites       axes at several positions and loads: `measured_site`, or loops, whose axis is taken
    tunables    dotted names below the control, such as law.Kp; default: those of the law
    filters     kept: as they are;  free: their frequencies and dampings are tuned too;  placed: and notches are added
                where they pay
    confidence  that all limits hold at once on the true axis, if the sites know their variance: k follows from it
    today       the control to compare with; default: `control` itself
    step        is told what is done next

    The response of the control is that of the control itself, linearised (`ControlResponse`), its slopes are exact.
    The stable side of -1 is kept by encirclement at every step.  A tuning for loops is run on them with friction,
    counts and limits, and one that fails there says so (`Tuned.holds`).  Where the searches do not agree, more are made
    (`Tuned.settled`).
    Raises UnstableError if nothing is found within the limits, NotIdentifiableError if the measurement is too poor to
    tune on, with the band in which to measure again, ParameterError for what does not fit.
    """
    if sites is None:
        if not isinstance(control, Loop):
            raise ParameterError("a control alone has no axis: give a loop, or the control and its sites")
        sites = control
    control = control.control if isinstance(control, Loop) else control
    if filters not in FILTERS:
        raise ParameterError(f"filters = {filters!r} must be one of {', '.join(FILTERS)}")
    work = _work(control, sites, goal, limits, band, confidence, starts, seed, velocity, step)
    chosen = law_tunables(control) if tunables is None else tuple(tunables)
    best = work.tuned(
        control, chosen if filters == "kept" else tuple(dict.fromkeys([*chosen, *filter_tunables(control)]))
    )
    tried: list[str] = []
    if filters == "placed":
        best = work.with_notches(best, tried)
    work.step("proof")
    return result(work, best, today or control, tuple(tried))


def assess(
    control: Control,
    sites: Site | Loop | Sequence[Site | Loop],
    *,
    rule: str,
    goal: str = "rope-snap",
    limits: Limits | None = None,
    band: tuple[float, float] = (0.0, math.inf),
    confidence: float = 0.95,
    velocity: float = 0.05,
    today: Control | None = None,
    step: Callable[[str], None] | None = None,
) -> Tuned:
    """A control as it is, such as a recipe gives it, with the figures and the proof of `shape` and without a search.

    rule  what it was made by, in words; the rest as in `shape`.  Raises as `shape` does, and UnstableError if the loop
    is unstable at a site.
    """
    work = _work(control, sites, goal, limits, band, confidence, 1, 0, velocity, step)
    names = law_tunables(control)
    return result(work, work.as_it_is(control, names), today or control, (), rule)


def _work(
    control: Control, sites: Site | Loop | Sequence[Site | Loop], goal: str, limits: Limits | None,
    band: tuple[float, float], confidence: float, starts: int, seed: int, velocity: float,
    step: Callable[[str], None] | None,
) -> Work:  # fmt: skip
    """What is asked for, checked."""
    if goal not in GOALS:
        raise ParameterError(f"goal = {goal!r} must be one of {', '.join(GOALS)}")
    if not 0.5 <= confidence < 1.0:
        raise ParameterError(f"confidence = {confidence:g} must be >= 0.5 and < 1")
    if not 0.0 <= band[0] < band[1]:
        raise ParameterError(f"the band from {band[0]:g} to {band[1]:g} Hz is empty: the lower frequency comes first")
    given = (sites,) if isinstance(sites, (Site, Loop)) else tuple(sites)
    made = tuple(
        modelled_site(each, f"axis {i + 1}" if len(given) > 1 else "model", velocity=velocity)
        if isinstance(each, Loop)
        else each
        for i, each in enumerate(given)
    )
    if not made:
        raise ParameterError("shaping needs at least one site")
    if len({each.sample_time for each in made}) > 1:
        said = ", ".join(f"'{each.name}' {1e3 * each.sample_time:g} ms" for each in made)
        raise ParameterError(f"one control has one sample time, but the sites have {said}")
    _check_band(made, band)
    work = Work(made, goal, limits or Limits(), band, confidence, starts, seed, velocity, step or _silent)
    if goal == "rope-snap" and not ControlResponse(control, made[0].sample_time, (), velocity).integrates(()):
        raise ParameterError(
            f"goal = 'rope-snap' needs a control with integral action: without it ('{control.law.kind}' as it is) the "
            f"table stays off under a force for ever; give it one, such as law.Tn, or take the goal stiffness"
        )
    return work


def _check_band(sites: Sequence[Site], band: tuple[float, float]) -> None:
    for each in sites:
        inside = np.count_nonzero((each.frequency >= band[0]) & (each.frequency <= band[1]))
        if inside < 3:
            raise ParameterError(
                f"the band from {band[0]:g} to {band[1]:g} Hz holds {inside} lines of '{each.name}', which has "
                f"{each.frequency[0]:.4g} to {each.frequency[-1]:.4g} Hz: at least 3"
            )


def _silent(text: str) -> None:
    """Nobody is told."""
