"""The rule of equal robustness, the tuning of laws under it, and their stored designs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, ClassVar, Self

import numpy as np

from feeddrive.analysis.loop_model import loop_model
from feeddrive.evaluation.case import Case
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.figures.figure import Limit
from feeddrive.figures.of_loops import (
    DELAY_MARGIN,
    FORCE_NOISE,
    NOISE_GAIN,
    ROPE_SNAP,
    SENSITIVITY_PEAK,
    LinearLoop,
)
from feeddrive.figures.ranking import Values
from feeddrive.files.run_files import versions
from feeddrive.language import tree
from feeddrive.language.errors import CancelledError, FeeddriveError, UnstableError
from feeddrive.language.progress import Progress
from feeddrive.language.quantity import Quantity, number
from feeddrive.language.text import Text, joined
from feeddrive.language.units import rounded
from feeddrive.loop.axis import Axis
from feeddrive.loop.box import Box
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.tune import HeldBack, Tuned, assess, goal_of, law_tunables, tune_control
from feeddrive.tuning.worst import VERDICTS

_ROOM = 1e-3  # of a bound: tolerance for peaks between the frequency lines
AGREE = 0.05  # of the goal: complete tunings this close to the best one agree with it
STALE = 1e-4  # of a figure: a design whose figures differ by more belongs to another law, plant or rule
NANO = 1e-9  # m: the reading noise for which the bound is stated


@dataclass(frozen=True)
class Rule:
    """The rule of equal robustness to which all laws are tuned.

    sensitivity_peak, delay_margin_samples   bounds of Ms and delay margin
    noise_ratio   largest force noise of a law relative to P-PI
    velocity      velocity at which the loop is linearized, m/s
    starts        number of searches per law
    noise         noise-gain limit in N/m; None until P-PI is tuned, which sets it
    repeats       number of complete tunings per law, each with its own random starts; with several, a law has settled
                  only if all of them end within 5 % of the best
    also          the axis at further positions or loads: the bounds apply there too, and the worst objective counts
    box           tolerances of every plant: the bounds hold over this box; the objective is that of the models
    filters       filters of the control in a tuning: kept, or free
    seed          seed of the first tuning of every law; the next ones have the numbers after it
    """

    sensitivity_peak: float
    delay_margin_samples: float
    noise_ratio: float
    velocity: float
    starts: int
    noise: float | None = None
    repeats: int = 1
    also: tuple[Axis, ...] = ()
    box: Box | None = None
    filters: str = "kept"
    seed: int = 0

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
            f"{self._of_filters}{self._over}"
        )

    @property
    def _of_filters(self) -> str:
        return "; every law tunes the same filters, a notch and a low-pass among them" if self.filters == "free" else ""

    @property
    def _over(self) -> str:
        return "" if self.box is None else Text(f"; all bounds hold over the box: {self.box.sentence}")

    def limits(self) -> Limits:
        """Return the limits of one tuning; force noise is computed even where it is not limited."""
        bounds = [Limit(SENSITIVITY_PEAK, self.sensitivity_peak), Limit(DELAY_MARGIN, self.delay_margin_samples)]
        if self.noise is not None:
            bounds.append(Limit(FORCE_NOISE, NANO * self.noise))
        return Limits(bounds, reading_noise=(NANO, NANO))

    def broken(self, figures: Mapping[str, float | None]) -> str:
        """Return the bounds that a loop violates, in words; empty if it satisfies all."""
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

    def figures(self, loop: Loop) -> dict[str, float]:
        """Return the figures of a stable loop, by key, which show whether a stored design is still up to date."""
        linear = LinearLoop(loop, known=loop_model(loop, velocity=self.velocity))
        values = {figure.key: figure.value(linear) for figure in (ROPE_SNAP, SENSITIVITY_PEAK, NOISE_GAIN)}
        return {key: float(value) for key, value in values.items() if value is not None}

    def with_noise_of(self, plain: Tuned | Refusal) -> Self:
        """Return the rule for the other laws, with the noise limit taken from the tuned P-PI."""
        # without a tuned P-PI there is no noise to compare with: the other laws are then tuned without this limit
        noise = plain.after[0].force_noise if isinstance(plain, Tuned) else None
        if not isinstance(plain, Tuned) or noise is None:
            return self
        over = None if plain.box is None else plain.box.spread(FORCE_NOISE)
        # at its worst plant: a bound at the model would be broken over the box by P-PI itself
        if over is not None and over.worst is not None:
            noise = max(noise, over.worst)
        return replace(self, noise=self.noise_ratio * noise / NANO)


@dataclass(frozen=True)
class Design:
    """A tuned law as stored by the engine and in the folders of the benchmark.

    plant, rules        name of the plant and version of the rules, for a design in the folders of the benchmark
    tunables, started   values after and before the tuning, by dotted name within the controller
    refused    the reason if no design was found; otherwise empty
    figures    figures by key, at the nominal position; the design is stale once the recomputed figures differ
    noise      the noise-gain limit of its tuning, N/m; None for P-PI, which sets the limit
    agreed     number of searches that ended within 5 % of the best one of their tuning, and of all
    box        the law over the box of its rule (`OverBox.record`); empty without a box
    held       the active constraints, as sentences; `bounds` contains them as values
    """

    law: str
    plant: str = ""
    rules: int = 0
    tunables: Mapping[str, float] = field(default_factory=dict[str, float])
    figures: Mapping[str, float] = field(default_factory=dict[str, float])
    noise: float | None = None
    refused: str = ""
    unsettled: str = ""
    spread: float = 0.0
    repeats: int = 0
    evaluations: int = 0
    held: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=versions)
    started: Mapping[str, float] = field(default_factory=dict[str, float])
    bounds: tuple[HeldBack, ...] = ()
    advice: tuple[str, ...] = ()
    agreed: tuple[int, int] = (0, 0)
    box: Mapping[str, Any] = field(default_factory=dict[str, Any])

    @property
    def holds(self) -> bool:
        """True if the bounds hold over the box of the rule, to the tolerance of `Rule.broken`; True without a box."""
        if not self.box or self.box["verdict"] == VERDICTS[True]:
            return True
        used = self.box["limit_used"]
        return used is not None and used <= 1.0 + _ROOM

    @property
    def exceeded(self) -> str:
        """How far the bounds are exceeded over the box, in words."""
        used, plant = self.box["limit_used"], self.box["worst_plant"]
        return f"unstable at {plant}" if used is None else Text(f"{Quantity(used):5} of a bound is used at {plant}")

    @property
    def noise_gain(self) -> float | None:
        """The largest gain from reading noise to force over the box, or without a box at the model, N/m."""
        worst = self.box["figures"][FORCE_NOISE.key]["worst"] if self.box else None
        return self.figures.get(NOISE_GAIN.key) if worst is None else worst / NANO

    @classmethod
    def of(cls, law: str, outcome: Tuned | Refusal, rule: Rule) -> Self:
        """Return the design of a law that was tuned under a rule."""
        if isinstance(outcome, Refusal):
            return cls(law, noise=rule.noise, refused=outcome.reason)
        return cls(
            law,
            tunables=outcome.tunables,
            figures=rule.figures(outcome.loops[0]),
            noise=rule.noise,
            unsettled=outcome.unsettled,
            spread=outcome.spread,
            repeats=rule.repeats,
            evaluations=outcome.evaluations,
            held=tuple(bound.sentence() for bound in outcome.held),
            started=outcome.started,
            bounds=outcome.held,
            advice=outcome.advice,
            agreed=outcome.agreed,
            box={} if outcome.box is None else outcome.box.record(),
        )

    def record(self) -> dict[str, Any]:
        """Return the design for a JSON file, with exact tunables and, for a reader, tunables rounded to six digits."""
        exact = {name: float(value).hex() for name, value in self.tunables.items()}
        return asdict(self) | {
            "tunables": exact,
            "values": {name: rounded(value, 6) for name, value in self.tunables.items()},
        }

    @classmethod
    def read(cls, record: Any) -> Self:
        """Return the design from its record; fields that earlier versions did not store may be missing.

        Raises ValueError, KeyError, TypeError or AttributeError for any other content.
        """
        # for a reader only: the exact numbers are those of `tunables`
        values: dict[str, Any] = {name: value for name, value in record.items() if name != "values"}
        values["tunables"] = {name: float.fromhex(value) for name, value in record["tunables"].items()}
        values["bounds"] = tuple(HeldBack(**bound) for bound in record.get("bounds", ()))
        values |= {name: tuple(record.get(name, ())) for name in ("held", "advice")}
        values["agreed"] = tuple(record.get("agreed", (0, 0)))
        return cls(**values)

    def control(self, candidate: Candidate) -> Control:
        """Return the controller of a candidate with these tunables.

        Raises ParameterError if the controller has no parameters of these names.
        """
        return tree.vary(candidate.loop.control, dict(self.tunables))

    def moved(self, figures: Values) -> str:
        """Return a sentence on the first stored figure whose value has changed; empty if none has."""
        for key, stored in self.figures.items():
            now = figures.get(key)
            if now is None or abs(now - stored) > STALE * abs(stored):
                present = None if now is None else number(now, 6)
                return f"{key} was {number(stored, 6)} when its design was stored and is {present}"
        return ""

    def stale(self, loop: Loop, rule: Rule) -> str:
        """Return the reason why the design is out of date (a changed figure or noise limit); empty if it is not."""
        moved = self.moved(rule.figures(loop))
        if moved or self.noise is None or rule.noise is None or abs(self.noise / rule.noise - 1.0) <= STALE:
            return moved
        return Text(
            f"it was tuned to a noise bound of {Quantity(self.noise, 'N/m'):6 SI}, which is "
            f"{Quantity(rule.noise, 'N/m'):6 SI} now"
        )


@dataclass(frozen=True, eq=False)
class Tuning(Case["Tuned | Refusal"]):
    """The case of tuning one law under the rule; the outcome is a refusal if no setting satisfies the rule."""

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
        # a cancellation says nothing about the law and must not be stored as its refusal
        except CancelledError:
            raise
        except FeeddriveError as error:
            return Refusal(self.name, Text(f"{error}"))

    def record(self, outcome: Tuned | Refusal) -> dict[str, Any]:
        """Return the design of the law as a record."""
        return Design.of(self.name, outcome, self.rule).record()

    def restored(self, record: Any, progress: Progress) -> Tuned | Refusal:
        """Restore the tuning from the record of its design."""
        return self.as_designed(Design.read(record), progress)

    def as_designed(self, design: Design, progress: Progress) -> Tuned | Refusal:
        """Return the tuning of a stored design; figures and proof are recomputed, without a search."""
        if design.refused:
            return Refusal(self.name, design.refused)
        progress.step("as it was kept")
        control, limits = design.control(self.candidate), self.rule.limits()
        return replace(
            assess(control, self.points, rule="kept", limits=limits, velocity=self.rule.velocity, box=self.rule.box),
            tunables=dict(design.tunables),
            started=dict(design.started),
            held=design.bounds,
            advice=design.advice,
            evaluations=design.evaluations,
            spread=design.spread,
            unsettled=design.unsettled,
            agreed=design.agreed,
            recipe="",
        )

    def repeated(self, progress: Progress) -> Tuned:
        """Return the best of several complete tunings, marked as settled if all of them agree.

        Raises UnstableError if none of them satisfies the rule.
        """
        rule = self.rule
        tunings: list[Tuned] = []
        errors: list[FeeddriveError] = []
        for seed in range(rule.seed, rule.seed + rule.repeats):
            try:
                tunings.append(
                    tune_control(
                        self.candidate.loop,
                        self.points,
                        limits=rule.limits(),
                        filters=rule.filters,
                        box=rule.box,
                        starts=rule.starts,
                        seed=seed,
                        velocity=rule.velocity,
                        # a comparison examines the present control once, and not with every law
                        today_over_box=False,
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
            agreed=(sum(tuned.agreed[0] for tuned in tunings), sum(tuned.agreed[1] for tuned in tunings)),
            unsettled=unsettled,
        )


def tuned_all(
    candidates: Sequence[Candidate], rule: Rule, engine: Engine, bar: Bar
) -> tuple[dict[str, Tuned | Refusal], Rule]:
    """Tune every candidate; return the results by name, and the rule with the noise limit from P-PI.

    P-PI is tuned first, since its noise sets the limit for the others.  `bar` counts the stages of all candidates.
    """

    def tuned(some: Iterable[Candidate]) -> dict[str, Tuned | Refusal]:
        cases = [Tuning(candidate, rule) for candidate in some]
        return dict(zip((case.name for case in cases), engine.evaluate(cases, bar), strict=True))

    outcomes = tuned(candidate for candidate in candidates if candidate.name == PLAIN)
    if PLAIN in outcomes:
        rule = rule.with_noise_of(outcomes[PLAIN])
    # longest first: a law with many tunables that starts last would keep one worker busy alone at the end
    longest = sorted(candidates, key=lambda candidate: -len(law_tunables(candidate.loop.control)))
    outcomes |= tuned(candidate for candidate in longest if candidate.name != PLAIN)
    return {candidate.name: outcomes[candidate.name] for candidate in candidates}, rule
