"""Claims that can fail, their page, and what `reproduce` leaves behind."""

from __future__ import annotations

import json
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path

import pytest

from documented import DOCS, claims_documented, loose
from feeddrive.language.errors import ParameterError
from feeddrive.language.table import Table
from feeddrive.papers import claims as papers
from feeddrive.papers.claims import (
    ORDER,
    Claim,
    Experiment,
    Reproduced,
    chosen,
    kept,
    paper_report,
    printed,
    quotient,
    within,
    write_reproduced,
)
from feeddrive.report.page import html


def claim(got: float, least: float | None = None, most: float | None = None) -> Claim:
    return Claim("1.a", "The <ratio> is right.", "equal gains", got, least, most, "um")


@pytest.mark.parametrize(
    ("got", "least", "most", "holds"),
    [
        (1.0, 1.0, 1.0, True),
        (0.99, 1.0, None, False),
        (1.01, None, 1.0, False),
        (5.0, None, None, True),
        (float("nan"), None, None, False),
        (float("nan"), 0.0, 1.0, False),
        (float("inf"), 0.0, None, True),
    ],
)
def test_a_claim_holds_within_its_bounds_and_never_for_nan(
    got: float, least: float | None, most: float | None, holds: bool
) -> None:
    assert claim(got, least, most).holds is holds


def test_figures_are_shown_with_four_digits_and_their_unit() -> None:
    shown = claim(1.23456e-7, 1e-10, 1.0)
    assert str(shown.shown) == "1.235e-07 um"
    assert shown.bounds == "1e-10 to 1 um"
    assert claim(1.0).bounds == "any number um"


def test_a_claim_with_one_bound_says_why() -> None:
    """But for a difference within rounding, 1e-4 in SI units, which is 100 µm; 2 % is more than that."""
    assert loose([claim(1.0, 0.5), claim(1.0, None, 200.0), Claim("1.a", "c", "r", 1.0, most=2.0, unit="%")])
    assert len(loose([claim(1.0, 0.5), claim(0.0, None, 0.0), claim(2.0, 1.0, 3.1)])) == 3
    assert loose([claim(1.0, None, 150.0)])
    assert not loose([claim(1.0, None, 80.0), claim(2.0, 1.0, 3.0), claim(0.1, 0.0, 1.0)])
    order = replace(claim(1.0, 0.5), one_sided=ORDER)
    assert not loose([order])
    assert order.cells()[3] == "at least 0.5 um; an order, for which no figure was given"


def test_a_printed_figure_is_known_to_half_a_unit_of_its_last_digit() -> None:
    for figure, low, high in (("0.179", 0.1785, 0.1795), ("118", 117.5, 118.5), ("7.2e-9", 7.15e-9, 7.25e-9)):
        assert printed(figure) == pytest.approx((low, high), rel=1e-12)
    assert quotient("286", "118") == pytest.approx((285.5 / 118.5, 286.5 / 117.5), rel=1e-12)
    assert quotient("286", "118", 0.2) == pytest.approx((0.8 * 285.5 / 118.5, 1.2 * 286.5 / 117.5), rel=1e-12)
    each = (0.8 * 285.5 / (1.4 * 118.5), 1.2 * 286.5 / (0.6 * 117.5))
    assert quotient("286", "118", 0.2, known_below=0.4) == pytest.approx(each, rel=1e-12)
    assert within(2.0, 0.25) == (1.5, 2.5)
    assert kept(2.0) == pytest.approx((1.8, 2.2), rel=1e-12)


def experiment(*claims: Claim) -> Experiment:
    return Experiment(
        "altintas2009",
        "A paper",
        "Somebody, A paper, 2009",
        claims,
        tables=(Table("errors & co", ["law", "um"], [["P-PI", "1.0"]]),),
        facts={"Plant": "rigid"},
        notes=("said <b>honestly</b>",),
    )


def test_the_page_escapes_and_marks_what_does_not_hold() -> None:
    page = html(paper_report(experiment(claim(2.0, None, 1.0), claim(0.5, None, 1.0))))
    assert page.count('<tr class="broken">') == 1
    assert "The &lt;ratio&gt; is right." in page
    assert "said &lt;b&gt;honestly&lt;/b&gt;" in page
    assert "1 of 2 claims hold; these do not: 1.a." in page
    assert "<script" not in page


def test_what_is_written_holds_every_claim(tmp_path: Path) -> None:
    one = Reproduced(experiment(claim(float("nan"), None, 1.0)))
    report = write_reproduced([one], tmp_path / "one")
    assert report.read_text(encoding="utf-8") == one.page
    rows = json.loads((tmp_path / "one" / "claims.json").read_text(encoding="utf-8"))["papers"]["altintas2009"]
    assert rows[0]["got"] is None
    assert rows[0]["holds"] is False
    other = Reproduced(replace(experiment(claim(1.0)), name="gordon2013"))
    index = write_reproduced([one, other], tmp_path / "two").read_text(encoding="utf-8")
    assert 'href="altintas2009.html"' in index


def test_a_paper_that_is_not_known_is_named_with_its_neighbour() -> None:
    assert chosen("all") == papers.PAPERS
    with pytest.raises(ParameterError, match=r"not known\. There are: altintas2009"):
        chosen("nobody")
    with pytest.raises(ParameterError, match="did you mean gordon2013"):
        chosen("gordon2031")


def test_the_documentation_adds_its_claims_up_and_says_them_once() -> None:
    """The tests of each paper compare its row with the claims themselves."""
    many = sum(claims_documented(author) for author in ("Altintas", "Gordon", "Beltrán", "Wu"))
    dadsc = f"`feeddrive reproduce altintas2009` prints {claims_documented('Altintas')} claims"
    said = {
        DOCS / "reference" / "reproduced.md": f"Every one of the {many} claims holds",
        DOCS / "reference" / "laws" / "dadsc.md": dadsc,
        DOCS.parent / "README.md": f"[{many} claims]",
    }
    assert [page for page, words in said.items() if words not in page.read_text(encoding="utf-8")] == []


def test_the_first_paper_that_fails_ends_the_run_and_waits_for_no_other():
    running, failed = Future[Reproduced](), Future[Reproduced]()
    failed.set_exception(ParameterError("the paper failed"))
    with pytest.raises(ParameterError, match="the paper failed"):
        papers._results([running, failed])
