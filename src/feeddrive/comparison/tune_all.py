"""The rule of equal robustness, and the tuning of laws under it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from feeddrive.evaluation.case import Case
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.figures.figure import Limit
from feeddrive.figures.of_loops import DELAY_MARGIN, FORCE_NOISE, NOISE_GAIN, SENSITIVITY_PEAK
from feeddrive.language import tree
from feeddrive.language.errors import CancelledError, FeeddriveError, UnstableError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.tune import HeldBack, Tuned, assess, goal_of, law_tunables, tune_control

_ROOM = 1e-3  # of a bound: tolerance for peaks between the frequency lines
AGREE = 0.05  # of the goal: complete tunings this close to the best one agree with it
NANO = 1e-9  # m: the reading noise for which the bound is stated


@dataclass(frozen=True)
class Rule:
    """The rule of equal robustness to which all laws are tuned.

    sensitivity_peak, delay_margin_samples   bounds of Ms and delay margin
    noise_ratio   largest force noise of a law relative to P-PI
    velocity      velocity of the axis, m/s
    starts        number of searches per law
    noise         noise-gain limit in N/m, known once P-PI is tuned; None before
    repeats       number of complete tunings per law, each with its own random starts; with several, a law has settled
                  only if all of them end within 5 % of the best
    also          the axis at further positions or loads: the bounds apply there too, and the worst objective counts
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
        noise = ""
        if self.noise is not None:
            noise = Text(
                f"at most {Quantity(NANO * self.noise, 'N'):3} RMS of force per nm RMS of white noise in the readings "
                f"({Quantity(self.noise_ratio):6} times that of P-PI, which is tuned to the other bounds alone), "
            )
        return Text(
            "every law but today's is tuned for the least rope-snap error subject to Ms <= "
            f"{number(self.sensitivity_peak, 6)}, a delay margin of at least {number(self.delay_margin_samples, 6)} "
            f"samples, {noise}and all eigenvalues inside the unit circle, the loop cut at the actuator; all laws are "
            "told the same mass, viscous friction and delay"
        )

    def limits(self) -> Limits:
        """Return the limits of one tuning; force noise is computed even where it is not limited."""
        bounds = [Limit(SENSITIVITY_PEAK, self.sensitivity_peak), Limit(DELAY_MARGIN, self.delay_margin_samples)]
        if self.noise is not None:
            bounds.append(Limit(FORCE_NOISE, NANO * self.noise))
        return Limits(bounds, reading_noise=(NANO, NANO))

    def broken(self, figures: Mapping[str, float | None]) -> str:
        """Return the bounds that a loop exceeds, in words; empty if it meets all."""
        peak, delay, noise = (figures.get(figure.key) for figure in (SENSITIVITY_PEAK, DELAY_MARGIN, NOISE_GAIN))
        if peak is None or delay is None or noise is None:
            return "it has no margins"
        exceeded: list[str] = []
        if peak > self.sensitivity_peak * (1.0 + _ROOM):
            exceeded.append(f"Ms {Quantity(peak):3}")
        if delay < self.delay_margin_samples * (1.0 - _ROOM):
            exceeded.append(f"a delay margin of {Quantity(delay):3} samples")
        if self.noise is not None and noise > self.noise * (1.0 + _ROOM):
            exceeded.append(f"{Quantity(NANO * noise, 'N'):3} per nm of noise")
        return joined(", ", exceeded)

    def with_noise_of(self, plain: Tuned | Refusal) -> Rule:
        """Return the rule for the other laws, with the noise limit taken from the tuned P-PI."""
        if not isinstance(plain, Tuned) or plain.after[0].force_noise is None:
            return self
        return replace(self, noise=self.noise_ratio * plain.after[0].force_noise / NANO)


@dataclass(frozen=True, eq=False)
class Tuning(Case["Tuned | Refusal"]):
    """The case of tuning one law under the rule; refused with the reason if no setting satisfies it."""

    kind: ClassVar[str] = "law"
    common: ClassVar[tuple[str, ...]] = ("rule",)
    stages: ClassVar[int] = 6

    candidate: Candidate
    rule: Rule

    @property
    def name(self) -> str:
        """The name of the law."""
        return self.candidate.name

    @property
    def points(self) -> list[Loop]:
        """The loop at all positions of the rule."""
        return [self.candidate.loop, *(replace(self.candidate.loop, axis=axis) for axis in self.rule.also)]

    def outcome(self, progress: Progress) -> Tuned | Refusal:
        """Return the best result of all searches, or a refusal."""
        try:
            return self.repeated(progress)
        except CancelledError:
            raise
        except FeeddriveError as error:
            return Refusal(self.name, Text(f"{error}"))

    def record(self, outcome: Tuned | Refusal) -> dict[str, Any]:
        """Return a record with the exact values of the tunables and details of the search."""
        if isinstance(outcome, Refusal):
            return {"refused": outcome.reason}
        return {
            "refused": None,
            "tunables": {name: float(value).hex() for name, value in outcome.tunables.items()},
            "started": dict(outcome.started),
            "held": [list(vars(bound).values()) for bound in outcome.held],
            "advice": list(outcome.advice),
            "evaluations": outcome.evaluations,
            "spread": outcome.spread,
            "unsettled": outcome.unsettled,
        }

    def restored(self, record: Any, progress: Progress) -> Tuned | Refusal:
        """Restore the tuning from a record; figures and proof are recomputed."""
        if record["refused"] is not None:
            return Refusal(self.name, str(record["refused"]))
        tunables = {str(name): float.fromhex(value) for name, value in record["tunables"].items()}
        held = tuple(HeldBack(*bound) for bound in record["held"])
        return replace(
            self.assessed(tunables, progress),
            started=dict(record["started"]),
            held=held,
            advice=tuple(record["advice"]),
            evaluations=int(record["evaluations"]),
            spread=float(record["spread"]),
            unsettled=str(record["unsettled"]),
        )

    def assessed(self, tunables: Mapping[str, float], progress: Progress) -> Tuned:
        """Compute figures and proof of the law with known tunables, without a search."""
        control = tree.vary(self.candidate.loop.control, dict(tunables))
        progress.step("as it was kept")
        known = assess(control, self.points, rule="kept", limits=self.rule.limits(), velocity=self.rule.velocity)
        return replace(known, tunables=dict(tunables), recipe="")

    def repeated(self, progress: Progress) -> Tuned:
        """Return the best of several complete tunings, settled if all of them agree. Raises UnstableError if none
        satisfies the rule.
        """
        rule = self.rule
        tunings: list[Tuned] = []
        errors: list[FeeddriveError] = []
        for seed in range(rule.repeats):
            try:
                tunings.append(
                    tune_control(
                        self.candidate.loop,
                        self.points,
                        limits=rule.limits(),
                        filters="kept",
                        starts=rule.starts,
                        seed=seed,
                        velocity=rule.velocity,
                        progress=progress,
                    )
                )
            except UnstableError as error:
                errors.append(error)
        if not tunings:
            raise errors[0]
        if rule.repeats == 1:
            return tunings[0]
        goals = np.log([goal_of(tuned, tuned.after) for tuned in tunings])
        spread, unsettled = float(np.ptp(goals)), ""
        if errors:
            unsettled = f"{len(errors)} of {rule.repeats} whole tunings found no setting that keeps the rule"
        elif spread > np.log1p(AGREE):
            apart = Quantity(np.expm1(spread), "share")
            unsettled = Text(f"{rule.repeats} whole tunings end up to {apart:2} apart")
        return replace(
            tunings[int(np.argmin(goals))],
            spread=spread,
            evaluations=sum(tuned.evaluations for tuned in tunings),
            unsettled=unsettled,
        )


def tuned_all(
    candidates: Sequence[Candidate], rule: Rule, engine: Engine, bar: Bar
) -> tuple[dict[str, Tuned | Refusal], Rule]:
    """Tune every candidate; return the results by name, and the rule with the noise limit from P-PI.

    P-PI comes first, since its noise sets the limit for the others.  `bar` counts the stages of all candidates.
    """

    def tuned(some: Iterable[Candidate]) -> dict[str, Tuned | Refusal]:
        cases = [Tuning(candidate, rule) for candidate in some]
        return dict(zip((case.name for case in cases), engine.evaluate(cases, bar), strict=True))

    outcomes = tuned(candidate for candidate in candidates if candidate.name == PLAIN)
    if PLAIN in outcomes:
        rule = rule.with_noise_of(outcomes[PLAIN])
    # those with the most tunables take longest: they go first
    longest = sorted(candidates, key=lambda candidate: -len(law_tunables(candidate.loop.control)))
    outcomes |= tuned(candidate for candidate in longest if candidate.name != PLAIN)
    return {candidate.name: outcomes[candidate.name] for candidate in candidates}, rule
