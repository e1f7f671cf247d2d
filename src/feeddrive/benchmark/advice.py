"""Which law of the benchmark has the least rope-snap error, in one sentence."""

from __future__ import annotations

from feeddrive.benchmark.score import FIGURES, Benchmark
from feeddrive.language.judgment import Advice, Judgment
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, capitalized
from feeddrive.tuning.candidates import PLAIN

_MANY = 1.02  # times better than P-PI that is worth a sentence


def advice(found: Benchmark, *, asked: bool = False) -> Advice:
    """Who has the least rope-snap error on all plants, and on how many P-PI is not beaten.

    asked  laws were named: that none of them has a place is a bad judgment
    """
    snap = FIGURES[0]
    tried = {each.law for each in found.rows if not each.recipe and each.law != PLAIN}
    if asked and tried and not tried & {*found.laws}:
        return Judgment.NO_PLACE.because("the table above says why")
    whole = [law for law in found.laws if len(found.ratios(law, snap)) == len(found.plants)]
    if not whole:
        return Advice(Judgment.NONE_PLACED, f"{Judgment.NONE_PLACED.says}.")
    best = whole[0]
    beaten = [
        plant for plant in found.plants if any(found.ratios(law, snap).get(plant, 0.0) > _MANY for law in found.laws)
    ]
    said = (
        "no law that has a place on all plants beats P-PI by 2 % in rope-snap error"
        if best == PLAIN or (found.score(best, snap).value or 0.0) < _MANY
        else f"of the laws with a place on all plants '{best}' has the least rope-snap error, "
        f"{Quantity(found.score(best, snap).value or 0.0):.2f} times better than P-PI"
    )
    rest = len(found.plants) - len(beaten)
    how = f"on {rest} of {len(found.plants)} plants {Judgment.SCORED.says}"
    return Advice(Judgment.SCORED, Text(f"{capitalized(said)}; {how}."))
