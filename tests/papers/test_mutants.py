"""A few mutants of the shipped laws: a claim of the law's own paper must notice each. `make mutate` runs them all."""

from __future__ import annotations

import multiprocessing

import pytest

from mutants import EQUIVALENT, PLACES, Mutant, broken_by, mutants

FEW = (
    ("DADSC (4)", "5 % of `self.reaching_rate * s`"),
    ("pole placement", "5 % of `K4 * ev2`"),
    ("pole placement", "late: `Ki * state.integral` for `Ki * integral`"),
    ("gains by (2)", "5 % of `Ki`"),
    ("ADR (9)", "5 % of `self.share * estimate.disturbance`"),
    ("compensator (6), (7)", "5 % of `middle.acceleration`"),
)


def noticed(mutant: Mutant) -> list[str]:
    """In a process of its own: the mutant ends with it."""
    with multiprocessing.get_context("fork").Pool(1) as pool:
        return pool.apply(broken_by, (mutant,))


@pytest.mark.parametrize(("equation", "words"), FEW)
def test_a_small_change_of_an_equation_breaks_a_claim_that_names_it(equation: str, words: str) -> None:
    every = [each for place in PLACES if place.equation == equation for each in mutants(place)]
    assert noticed(next(each for each in every if each.words == words))


def test_every_place_has_mutants_and_every_exception_is_one() -> None:
    every = [each for place in PLACES for each in mutants(place)]
    assert {each.place for each in every} == set(PLACES)
    assert set(EQUIVALENT) <= {(each.place.function, each.words) for each in every}
    kinds = {kind for each in every for kind in ("sign", "5 %", "late") if each.words.startswith(kind)}
    assert kinds == {"sign", "5 %", "late"}
