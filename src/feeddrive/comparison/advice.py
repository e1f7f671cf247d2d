"""Which of the laws of a comparison to take, in one sentence."""

from __future__ import annotations

import math

from feeddrive.comparison.compare import TODAY, Comparison
from feeddrive.comparison.figures import CRITERIA, beats
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.quantity import number
from feeddrive.tuning.candidates import PLAIN
from feeddrive.tuning.tune import two_digits

_NAMED = 4  # criteria in which a law is worse that are named, the worst first


def advice(found: Comparison) -> Advice:
    """The law with the least rope-snap error, and first in what it is worse than P-PI, or P-PI than today's gains."""
    key = "rope_snap_ISE_root_m_per_N"
    ranked = {each.name: each for each in found.competitors if not each.unplaced and each.figures.get(key) is not None}
    if set(ranked) <= {TODAY}:
        return Advice(Judgment.NONE_RANKED, f"{Judgment.NONE_RANKED.says}.")
    best = min(ranked.values(), key=lambda each: each.figures[key] or 0.0)
    if best.name == TODAY:
        return Advice(Judgment.KEEP_GAINS, f"{Judgment.KEEP_GAINS.says}.")
    there = {each.name: each for each in found.competitors if each.figures.get(key) is not None}
    least = f"'{best.name}' {Judgment.RANKED.says}"
    other = there.get(PLAIN if best.name != PLAIN else TODAY)
    if other is None:
        return Advice(Judgment.RANKED, f"{least}.")
    worse = list[tuple[float, str]]()
    for criterion in CRITERIA:
        ours, theirs = best.figures.get(criterion.key), other.figures.get(criterion.key)
        if ours is None or theirs is None or not beats(criterion, theirs, ours):
            continue
        ratio = ours / theirs if theirs else math.inf
        said = f"{criterion.title} {_times(ratio)} times" if math.isfinite(ratio) else f"{criterion.title} never"
        worse.append((abs(math.log(ratio)) if 0.0 < ratio < math.inf else math.inf, said))
    worst = [text for _, text in sorted(worse, key=lambda each: -each[0])]
    more = f", and {len(worst) - _NAMED} more" if len(worst) > _NAMED else ""
    lost = f"Worse than with {other.name}: {', '.join(worst[:_NAMED])}{more}." if worst else ""
    gain = (best.figures[key] or 0.0) / (other.figures[key] or math.inf)
    won = f"{least}, {_times(gain)} times that of {other.name}{'' if lost else ', and is worse in nothing'}."
    return Advice(Judgment.RANKED, f"{lost} {won}".strip())


def _times(ratio: float) -> str:
    """Two digits, or three near 1: 0.83, 1.05."""
    return number(ratio, 3) if 0.9 < ratio < 1.1 else two_digits(ratio)
