"""The tunings of a comparison, sequential or in parallel processes."""

from __future__ import annotations

import contextlib
import multiprocessing
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass, replace
from queue import Empty
from typing import Any

import numpy as np

from feeddrive.blocks.catalogue import fault_of_own
from feeddrive.comparison.kept import Keeps
from feeddrive.figures.figure import Limit
from feeddrive.figures.of_loops import DELAY_MARGIN, FORCE_NOISE, NOISE_GAIN, SENSITIVITY_PEAK
from feeddrive.language.errors import CancelledError, FeeddriveError, UnstableError
from feeddrive.language.processes import follow_parent, one_thread
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal
from feeddrive.tuning.limits import Limits
from feeddrive.tuning.tunables import law_tunables
from feeddrive.tuning.tune import tune_control
from feeddrive.tuning.tuned import Tuned, goal_of

STAGES = 6  # steps of the progress that one law is counted as
_NEWS = 0.1  # s between two looks at what the processes tell
_ROOM = 1e-3  # of a bound, for what lines miss
AGREE = 0.05  # of the goal: whole tunings this near the best agree with it
NANO = 1e-9  # m: the noise of a reading in which the bound is stated


@dataclass(frozen=True)
class Rule:
    """What all laws are tuned to.

    sensitivity_peak, delay_margin_samples   bounds of Ms and delay margin
    noise_ratio   how much more noise than P-PI a law may make in the force
    velocity      m/s of the axis
    starts        searches for each law
    noise         N/m: the bound that follows once P-PI is tuned; None before
    repeats       whole tunings of each law, each with its own random starts; with several a law has settled only if
                  all of them end within 5 % of the best
    also          the axis at further positions or loads: the bounds hold there too, and the worst goal counts
    """

    sensitivity_peak: float
    delay_margin_samples: float
    noise_ratio: float
    velocity: float
    starts: int
    noise: float | None = None
    repeats: int = 1
    also: tuple[Axis, ...] = ()

    @property
    def sentence(self) -> str:
        """The rule in words."""
        said = (
            "every law but today's is tuned for the least rope-snap error subject to Ms <= "
            f"{number(self.sensitivity_peak, 6)}, a delay margin of at least {number(self.delay_margin_samples, 6)} "
            "samples, "
        )
        if self.noise is not None:
            said += Text(
                f"at most {Quantity(NANO * self.noise, 'N'):3} RMS of force per nm RMS of white noise in the readings "
                f"({Quantity(self.noise_ratio):6} times that of P-PI, which is tuned to the other bounds alone), "
            )
        return said + (
            "and all eigenvalues inside the unit circle, the loop cut at the actuator; all laws are told the same "
            "mass, viscous friction and delay"
        )

    def limits(self) -> Limits:
        """The bounds of one tuning."""
        bounds = [Limit(SENSITIVITY_PEAK, self.sensitivity_peak), Limit(DELAY_MARGIN, self.delay_margin_samples)]
        if self.noise is None:
            return Limits(bounds)
        return Limits([*bounds, Limit(FORCE_NOISE, NANO * self.noise)], reading_noise=(NANO, NANO))

    def broken(self, figures: Mapping[str, float | None]) -> str:
        """The bounds that a loop does not keep, in words; empty if it keeps all."""
        peak, delay, noise = (figures.get(figure.key) for figure in (SENSITIVITY_PEAK, DELAY_MARGIN, NOISE_GAIN))
        said: list[str] = []
        if peak is None or delay is None or noise is None:
            return "it has no margins"
        if peak > self.sensitivity_peak * (1.0 + _ROOM):
            said.append(f"Ms {Quantity(peak):3}")
        if delay < self.delay_margin_samples * (1.0 - _ROOM):
            said.append(f"a delay margin of {Quantity(delay):3} samples")
        if self.noise is not None and noise > self.noise * (1.0 + _ROOM):
            said.append(f"{Quantity(NANO * noise, 'N'):3} per nm of noise")
        return joined(", ", said)

    def with_noise_of(self, plain: Tuned | Refusal) -> Rule:
        """The rule for all others, once P-PI is tuned."""
        if not isinstance(plain, Tuned) or plain.after[0].force_noise is None:
            return self
        return replace(self, noise=self.noise_ratio * plain.after[0].force_noise / NANO)


def tuned_all(
    candidates: Sequence[Candidate], rule: Rule, workers: int, bar: Bar, kept: Keeps | None = None
) -> tuple[dict[str, Tuned | Refusal], Rule]:
    """Every candidate by name: tuned, or refused with the reason; and the rule with the noise that P-PI makes.

    P-PI is first, since its noise bounds that of the others.  `kept` has what was tuned before a stop.
    `bar` is told every stage; the work ends at the cancel of its progress.
    """
    found: dict[str, Tuned | Refusal] = {}
    plain = [each for each in candidates if each.name == PLAIN]
    for candidate in plain:
        found[PLAIN] = _tuned(candidate, rule, kept, bar.of(PLAIN))
        bar.finished(PLAIN)
        rule = rule.with_noise_of(found[PLAIN])
    # those with the most tunables take longest: they go first
    rest = sorted(
        (each for each in candidates if each.name != PLAIN), key=lambda each: -len(law_tunables(each.loop.control))
    )
    if min(workers, len(rest)) <= 1:
        for candidate in rest:
            found[candidate.name] = _tuned(candidate, rule, kept, bar.of(candidate.name))
            bar.finished(candidate.name)
    else:
        found |= _side_by_side(rest, rule, min(workers, len(rest)), bar, kept)
    return {candidate.name: found[candidate.name] for candidate in candidates}, rule


class Bar:
    """Counts the steps of a comparison: `STAGES` for each law that is tuned, and those that follow.

    At most `STAGES` - 1 are counted while a law is searched, all of them when it is done.
    """

    def __init__(self, progress: Progress, laws: int, more: int) -> None:
        self.progress, self.all, self.told = progress, STAGES * laws + more, dict[str, int]()

    def stage(self, law: str, what: str) -> None:
        """What begins within a law."""
        self.told[law] = min(self.told.get(law, 0) + 1, STAGES - 1)
        self.progress.step(f"{law}: {what}", sum(self.told.values()), self.all)

    def next(self, what: str) -> None:
        """One of the steps that follow."""
        self.told[what] = 1
        self.progress.step(what, sum(self.told.values()), self.all)

    def finished(self, law: str) -> None:
        """A law is tuned."""
        self.told[law] = STAGES
        self.progress.step(law, sum(self.told.values()), self.all)

    def of(self, law: str) -> Progress:
        """The progress of one law."""
        return _Stages(self, law)


class _Stages(Progress):
    """Tells the bar; ends with it."""

    def __init__(self, bar: Bar, law: str) -> None:
        super().__init__()
        self._bar, self._law = bar, law

    @property
    def cancelled(self) -> bool:
        return self._bar.progress.cancelled

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        self._bar.stage(self._law, what)


def _side_by_side(
    candidates: Sequence[Candidate], rule: Rule, workers: int, bar: Bar, kept: Keeps | None
) -> dict[str, Tuned | Refusal]:
    # a fresh interpreter each: a fork would copy the locks of the caller's threads
    context = multiprocessing.get_context("spawn")
    news: Any = context.Queue()
    with one_thread(), ProcessPoolExecutor(workers, context, _begin, (news,)) as pool:
        futures = {pool.submit(_elsewhere, candidate, rule, kept): candidate.name for candidate in candidates}
        try:
            done: dict[str, Tuned | Refusal] = {}
            waiting = set(futures)
            while waiting:
                ended, waiting = wait(waiting, _NEWS, FIRST_COMPLETED)
                with contextlib.suppress(Empty):
                    while True:
                        bar.stage(*news.get_nowait())
                for future in ended:
                    done[futures[future]] = future.result()
                    bar.finished(futures[future])
                bar.progress.check()
            return done
        except BaseException:
            for child in multiprocessing.active_children():
                child.terminate()
            raise


_news: Any = None  # of a process: where it tells its stages


def _begin(news: Any) -> None:
    """Where a process tells its stages."""
    global _news
    follow_parent()
    _news = news


class _Told(Progress):
    """The progress of a law in a process of its own."""

    def __init__(self, law: str) -> None:
        super().__init__()
        self._law = law

    def show_step(self, what: str, done: int | None, of: int | None, part: str) -> None:
        _news.put((self._law, what))


def _elsewhere(candidate: Candidate, rule: Rule, kept: Keeps | None) -> Tuned | Refusal:
    try:
        return _tuned(candidate, rule, kept, _Told(candidate.name))
    except FeeddriveError:
        raise
    except Exception as error:  # its frames stay in this process: the place of the fault is said here
        said = fault_of_own(error)
        if said is None:
            raise
        raise said from error


def _tuned(candidate: Candidate, rule: Rule, kept: Keeps | None, progress: Progress) -> Tuned | Refusal:
    """A law tuned, as it was kept or anew."""
    limits = rule.limits()
    if limits.limit(FORCE_NOISE) is None:  # measured, not bounded
        limits = limits.having(reading_noise=(NANO, NANO))
    try:
        known = None if kept is None else kept.read(candidate, limits, rule, progress)
        if known is not None:
            return known
        made = _repeated(candidate.loop, limits, rule, progress)
    except CancelledError:
        raise
    except FeeddriveError as error:
        made = Refusal(candidate.name, Text(f"{error}"))
    if kept is not None:
        kept.write(candidate, limits, rule, made)
    return made


def _repeated(loop: Loop, limits: Limits, rule: Rule, progress: Progress) -> Tuned:
    """The best of whole tunings of a loop, settled if all of them agree."""
    points = [loop, *(replace(loop, axis=axis) for axis in rule.also)]
    tried: list[Tuned] = []
    failed: list[FeeddriveError] = []
    for seed in range(rule.repeats):
        try:
            tried.append(
                tune_control(
                    loop, points, limits=limits, filters="kept", starts=rule.starts, seed=seed,
                    velocity=rule.velocity, progress=progress,
                )
            )  # fmt: skip
        except UnstableError as error:
            failed.append(error)
    if not tried:
        raise failed[0]
    if rule.repeats == 1:
        return tried[0]
    goals = np.log([goal_of(each, each.after) for each in tried])
    spread = float(np.ptp(goals))
    apart = Text(f"{rule.repeats} whole tunings end up to {Quantity(np.expm1(spread), 'share'):2} apart")
    said = apart if spread > np.log1p(AGREE) else ""
    if failed:
        said = f"{len(failed)} of {rule.repeats} whole tunings found no setting that keeps the rule"
    return replace(
        tried[int(np.argmin(goals))], spread=spread, evaluations=sum(each.evaluations for each in tried),
        unsettled=said,
    )  # fmt: skip
