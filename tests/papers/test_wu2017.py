"""The experiments of Wu, Han, Xiong & Ding 2017: every claim holds, and the rows where something loses are there."""

from __future__ import annotations

import pytest

from documented import claims_documented
from feeddrive.language.progress import Progress
from feeddrive.papers.claims import Experiment, paper_report
from feeddrive.papers.wu2017 import wu2017
from feeddrive.papers.wu2017.learning import EXPECTED
from feeddrive.papers.wu2017.rates import identity_error
from feeddrive.report.page import html

learning = pytest.mark.slow(reason="some hundred trials of learning; test_iterative_feedforward.py has the law")


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    return wu2017(Progress())


@learning
def test_every_claim_holds(experiment: Experiment) -> None:
    assert not [(claim.key, claim.claim, claim.shown, claim.bounds) for claim in experiment.broken]


@learning
def test_the_documentation_states_how_many_claims_there_are(experiment: Experiment) -> None:
    assert len(experiment.claims) == claims_documented("Wu")


@learning
def test_every_row_is_there_with_its_rule_and_what_loses(experiment: Experiment) -> None:
    assert {claim.key for claim in experiment.claims} == {f"4.{row}" for row in "abcdefghijklmnopqr"}
    assert all(claim.rule for claim in experiment.claims)
    assert any("loses" in claim.claim for claim in experiment.claims)
    assert any("diverges" in claim.claim for claim in experiment.claims)


@learning
def test_errors_over_the_trials_are_those_of_an_independent_program(experiment: Experiment) -> None:
    """Dwells and noise are not the same there: 12 % of each RMS, a little more than what either moves it by."""
    rows = {(row[0], row[1]): row for row in experiment.tables[0].rows}
    for name, (steps, last) in EXPECTED.items():
        for found, wanted in zip(rows[name, "same"][2:8], steps, strict=False):
            assert found == pytest.approx(1e-6 * wanted, rel=0.12), name
        assert rows[name, "changing"][7] == pytest.approx(1e-6 * last, rel=0.12), name


def test_the_identity_holds_to_rounding() -> None:
    assert identity_error() < 1e-8


@learning
def test_the_page_has_the_papers_kinds_of_pictures(experiment: Experiment) -> None:
    page = html(paper_report(experiment))
    for shown in experiment.pictures:
        assert f"figure-{shown.key}" in page
    assert {s.key for s in experiment.pictures} == {
        "errors",
        "parameters",
        "overtime",
        "convergence",
        "contour",
        "quadrant",
        "signal",
    }
