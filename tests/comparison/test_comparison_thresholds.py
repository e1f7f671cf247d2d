"""Thresholds of a comparison of laws: a case on either side of each."""

# pyright: reportPrivateUsage=false

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.comparison.compare import advice, noisy
from feeddrive.evaluation.competitor import Competitor
from feeddrive.evaluation.robustness import Rule
from feeddrive.figures import of_loops
from feeddrive.figures.ranking import CRITERIA
from feeddrive.files.machine import read_machine
from feeddrive.loop.loop import Loop
from feeddrive.plot import laws
from feeddrive.tuning import candidates
from feeddrive.tuning.candidates import PLAIN, Candidate


@pytest.fixture(scope="module")
def loop() -> Loop:
    return read_machine("linear_motor").loop("x")


@pytest.mark.parametrize(("share", "remarks"), [(0.015, 0), (0.03, 1)])
def test_a_force_noise_of_two_percent_of_the_limit_is_named(loop: Loop, share: float, remarks: int) -> None:
    limited = replace(loop, control=replace(loop.control, force_limit=1000.0))
    row = Competitor("law", limited, {of_loops.FORCE_NOISE.key: 1000.0 * share})
    assert len(noisy(SimpleNamespace(competitors=(row,)))) == remarks  # type: ignore[arg-type]


@pytest.mark.parametrize(("worse", "more"), [(3, ""), (4, ""), (6, ", and 2 more.")])
def test_the_four_worst_losses_are_named(loop: Loop, worse: int, more: str) -> None:
    """A law that is better in rope snap and worse in some other figures."""
    snap = of_loops.ROPE_SNAP
    others = [criterion for criterion in CRITERIA if criterion.key != snap.key][:worse]
    ours = {snap.key: 1.0} | {c.key: (0.25 if c.higher else 4.0) for c in others}
    theirs = {snap.key: 2.0} | {c.key: 1.0 for c in others}
    rows = {name: Competitor(name, loop, figures) for name, figures in (("law", ours), (PLAIN, theirs))}

    class Compared(SimpleNamespace):
        def __getitem__(self, name: str) -> Competitor:
            return rows[name]

    said = str(advice(Compared(competitors=tuple(rows.values()))).sentence)  # type: ignore[arg-type]
    assert said.count(" times") - 1 == min(worse, 4)
    assert ("more." in said) == bool(more)
    assert more in said


@pytest.mark.parametrize(("share", "exceeded"), [(0.0007, False), (0.0015, True)])
def test_a_bound_is_exceeded_by_more_than_a_thousandth(share: float, exceeded: bool) -> None:
    """Ms and the noise from above, the delay margin from below."""
    rule = Rule(2.0, 3.0, 1.05, 0.1, 1, noise=1e9)
    held = {of_loops.SENSITIVITY_PEAK.key: 2.0, of_loops.DELAY_MARGIN.key: 3.0, of_loops.NOISE_GAIN.key: 1e9}
    assert not rule.broken(held)
    for key, sign in zip(held, (1.0, -1.0, 1.0), strict=True):
        assert bool(rule.broken(held | {key: held[key] * (1.0 + sign * share)})) == exceeded, key


@pytest.mark.parametrize(("ratio", "saturated"), [(6.0, False), (10.0, True), (1.0 / 6.0, False), (0.1, True)])
def test_the_color_of_a_ratio_ends_between_6_and_10(ratio: float, saturated: bool) -> None:
    _, level = laws._cell(ratio, 1.0, higher=False)
    assert (abs(level) == 1.0) == saturated
    assert level * (ratio - 1.0) > 0.0


def test_a_compensator_learns_in_as_many_trials_as_the_document_says(
    loop: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (Path(__file__).parents[2] / "docs" / "reference" / "laws" / "comparison.md").read_text(encoding="utf-8")
    assert "learned in six trials of the move" in text
    trials = list[int]()

    def learned(loop: Loop, move: object, count: int, *, seed: int) -> SimpleNamespace:
        trials.append(count)
        return SimpleNamespace(loop=loop)

    monkeypatch.setattr(candidates, "iterate_trials", learned)
    move = SnapLimitedMove(distance=0.02, velocity=0.2, acceleration=5.0, jerk=400.0, snap=4e4)
    Candidate("law", loop, then="trials").adapted(move, 1)
    assert trials == [6]
