"""The laws for one axis: those that can control it, those that are tuned, and those that are refused, with the reasons.

A comparison takes the gains from a search, the benchmark from stored designs. `Lineup.trials` applies the gains to the
laws, and `judged` evaluates the resulting trials.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

from feeddrive.blocks.catalogue import members, shipped
from feeddrive.blocks.families import Law
from feeddrive.evaluation.competitor import (
    OUTSIDE,
    REFUSED,
    STALE,
    UNDECIDED,
    UNSEARCHED,
    UNSETTLED,
    AtWork,
    Competitor,
    Plant,
)
from feeddrive.evaluation.engine import Bar, Engine
from feeddrive.evaluation.robustness import Design
from feeddrive.language import tree
from feeddrive.language.errors import FeeddriveError, ParameterError
from feeddrive.language.text import Text, joined
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN, Candidate, Refusal, candidates, names_of
from feeddrive.tuning.tune import Tuned, own_tunables
from feeddrive.tuning.worst import VERDICTS

FIXED = "it has nothing to tune and is judged as it is"


class Trial(NamedTuple):
    """A law to evaluate, or a finished row if it has no gains to evaluate, with the tuning of its gains."""

    law: AtWork | Competitor
    tuned: Tuned | Design | None = None

    @property
    def name(self) -> str:
        """The name of the law."""
        return self.law.candidate.name if isinstance(self.law, AtWork) else self.law.name

    def placed(self, row: Competitor) -> Competitor:
        """Return the evaluated row with its tuning; it is not ranked if the tuning is unsettled or the design stale."""
        law, tuned, moved = self.law, self.tuned, ""
        row = replace(row, tuned=tuned)
        if tuned is None or row.kind not in ("", OUTSIDE):
            return row
        # the stored figures are those of the law at the nominal position; those of a row are the worst of all positions
        if isinstance(law, AtWork) and isinstance(tuned, Design) and tuned.law == row.name:
            at_model = row.nominal or (row.figures if len(law.plant.places) == 1 else {})
            moved = tuned.moved(at_model) if at_model else ""
        if moved:
            return replace(row, unplaced=f"{STALE}: {moved}: --retune searches it anew")
        if isinstance(tuned, Design) and not tuned.holds:
            kind = UNDECIDED if tuned.box["verdict"] == VERDICTS[None] else OUTSIDE
            return replace(row, unplaced=Text(f"{kind}: over the box {tuned.exceeded}"))
        # on drawn plants an unsettled law keeps its place, as one that is at least so good: `Order` knows of it
        lacking = tuned.unsettled and not row.draws
        return replace(row, unplaced=Text(f"{UNSETTLED}: {tuned.unsettled}")) if lacking else row


@dataclass(frozen=True)
class Lineup:
    """The laws that can control an axis, P-PI first, and the refused ones."""

    possible: tuple[Candidate, ...]
    refused: tuple[Refusal, ...]

    @classmethod
    def of(cls, loop: Loop, own: Sequence[type[Law]] = ()) -> Self:
        """Return the laws for an axis; `own` are user-defined classes that are not in the catalog."""
        return cls(*candidates(loop, own))

    @property
    def searched(self) -> list[Candidate]:
        """The laws that have tunables and do not reuse the gains of another law."""
        return [law for law in self.possible if not law.like and own_tunables(law.loop.control)]

    @property
    def user_defined(self) -> tuple[str, ...]:
        """The names of laws in the catalog that are not shipped with feeddrive."""
        own = set(members(Law).values()) - set(shipped()[Law].values())
        return tuple(law.name for law in self.possible if type(law.loop.control.law) in own)

    def names(self, laws: Iterable[str | type[Law]]) -> tuple[str, ...]:
        """Return the names of laws given by name, kind or class. Raises ParameterError for an unknown one."""
        return tuple(dict.fromkeys(name for law in laws for name in names_of(law, self.possible, self.refused)))

    def only(self, names: Collection[str]) -> Self:
        """Return the named laws, plain P-PI, and any law whose gains are reused by one of the named laws."""
        wanted = {PLAIN, *names, *(law.like for law in self.possible if law.name in names)}
        return replace(
            self,
            possible=tuple(law for law in self.possible if law.name in wanted),
            refused=tuple(law for law in self.refused if law.name in wanted),
        )

    def fitting(self, law: str) -> str:
        """Return the name of a law on this axis. Raises ParameterError if the law is unknown or refused."""
        name = self.names([law])[0]
        reason = next((refusal.reason for refusal in self.refused if refusal.name == name), "")
        if reason:
            raise ParameterError(f"'{name}' cannot control this axis: {reason}")
        return name

    def trials(self, tunings: Mapping[str, Tuned | Design | Refusal], plant: Plant) -> Iterator[Trial]:
        """Yield a trial of each law with its gains, which may be those of another law, and then the refused laws."""

        def left_out(law: str, why: str) -> Trial:
            return Trial(Competitor(law, plant.model, unplaced=why, plant=plant.name))

        bases = {law.name: law for law in self.possible}
        for law in self.possible:
            base = bases[law.like or law.name]
            tuned = tunings.get(base.name)
            if isinstance(tuned, Refusal):
                yield left_out(law.name, Text(f"{REFUSED}: {tuned.reason}"))
            elif tuned is not None:
                try:
                    gains = tree.vary(base.loop.control, dict(tuned.tunables))
                # the law no longer has the tunables with which its design was stored
                except FeeddriveError as error:
                    yield left_out(law.name, f"{STALE}: {error}")
                else:
                    yield Trial(AtWork(law.tuned(gains), plant), tuned)
            elif own_tunables(base.loop.control):
                yield left_out(law.name, f"{UNSEARCHED}: --retune searches it")
            else:
                remark = joined("; ", filter(None, (law.remark, FIXED)))
                yield Trial(AtWork(replace(law, remark=remark), plant))
        for refusal in self.refused:
            yield left_out(refusal.name, Text(f"{REFUSED}: {refusal.reason}"))


def judged(trials: Sequence[Trial], engine: Engine, bar: Bar) -> list[Competitor]:
    """Evaluate the laws that have gains; return the rows of all laws in order."""
    for row in (trial.law for trial in trials if isinstance(trial.law, Competitor)):
        bar.step(": ".join(filter(None, (row.plant, row.name))))
    evaluated = iter(engine.evaluate([trial.law for trial in trials if isinstance(trial.law, AtWork)], bar))
    return [trial.placed(next(evaluated) if isinstance(trial.law, AtWork) else trial.law) for trial in trials]
