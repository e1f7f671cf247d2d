"""What a tuning gives: the loop, its knobs, which bound held it back, and the proof."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from feeddrive.language import tree
from feeddrive.language.table import Result, Table
from feeddrive.loop.loop import Loop
from feeddrive.tuning.robustness import Robustness


class Checked(NamedTuple):
    """One line of a proof: what was checked, whether it holds (None: it could not be checked), and the figures."""

    what: str
    holds: bool | None
    said: str


@dataclass(frozen=True, eq=False, repr=False)
class Tuned(Result):
    """A loop tuned for the least rope-snap error within equal robustness.

    knobs, started   values by dotted name, at the end and at the beginning
    robustness       Ms, delay margin in samples, rope-snap error in m s^½/N
    active           the bounds that held the search back
    evaluations      how many loops were judged
    spread           by which share the worst end of the searches is above the best
    proof            what was computed anew in another way
    """

    loop: Loop
    knobs: Mapping[str, float]
    started: Mapping[str, float]
    robustness: Robustness
    sensitivity_bound: float
    delay_bound: float
    active: tuple[str, ...]
    evaluations: int
    spread: float
    proof: tuple[Checked, ...]

    @property
    def proven(self) -> bool:
        """Whether all lines of the proof hold."""
        return all(line.holds is True for line in self.proof)

    @property
    def rule(self) -> str:
        """What it was tuned for, as a sentence."""
        return (
            f"least rope-snap error subject to Ms <= {self.sensitivity_bound:g} and a delay margin of at least "
            f"{self.delay_bound:g} samples, the loop cut at the actuator"
        )

    def table(self) -> Table:
        """Knobs before and after, the figures, and the proof."""
        rows = [
            [
                name.removeprefix("control."),
                f"{self.started[name]:.5g}",
                f"{value:.5g}",
                tree.declaration(self.loop, name).unit,
            ]
            for name, value in self.knobs.items()
        ]
        found = self.robustness
        rows += [
            ["rope-snap error", "", f"{found.rope_snap:.4g}", "m s^1/2/N"],
            ["Ms", "", f"{found.sensitivity_peak:.4f}", ""],
            ["delay margin", "", f"{found.delay_margin_samples:.2f}", "samples"],
            ["held back by", "", "; ".join(self.active) or "nothing", ""],
            *([f"proof: {line.what}", "", _verdict(line.holds), line.said] for line in self.proof),
        ]
        return Table(self.rule, ["what", "begun at", "now", "unit"], rows)


def _verdict(holds: bool | None) -> str:
    return "not proven" if holds is None else "holds" if holds else "DOES NOT HOLD"
