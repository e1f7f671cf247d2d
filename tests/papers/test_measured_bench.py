"""Pole placement on the measured two-inertia bench: what is measured, what is predicted, what is only computed."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from documented import DOCS, loose
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.identification.response.plant_fit import PlantFit
from feeddrive.language import tree
from feeddrive.language.errors import LogError
from feeddrive.language.progress import Progress
from feeddrive.papers import bench as paper
from feeddrive.papers.bench import Measured, axis_of, bench, left, measured
from feeddrive.papers.claims import Reproduced

LOG = Path(__file__).parents[3] / "shared" / "data" / "tokyo_motor_bench" / "MultisineTypeA.mat"
needs_log = pytest.mark.skipif(not LOG.exists(), reason=f"NOT RUN: the measured log {LOG.name} is not in ../shared")


@cache
def parts() -> tuple[Measured, Measured, PlantFit]:
    odd, even = measured(LOG)
    return odd, even, odd.fit()


@needs_log
def test_the_lines_are_those_of_the_multisine() -> None:
    """Whole Hz from 11 to 250 at 2.5 kHz, odd ones to identify and even ones to predict; no line in both."""
    odd, even, _ = parts()
    for half, first in ((odd, 11), (even, 12)):
        for frf in (half.motor, half.load):
            np.testing.assert_allclose(frf.frequency, np.arange(first, 251, 2), rtol=1e-9)


@needs_log
def test_the_even_lines_are_predicted_and_a_wrong_model_is_noticed() -> None:
    """Claims 6.a to 6.d; a spring 3 % softer or a load 5 % heavier leaves more than the claims allow."""
    _, even, fit = parts()
    loop, box = axis_of(fit)
    best = left(axis_of(even.fit())[0], even)
    assert all(claim.holds for claim in paper._measured_claims(fit, left(loop, even), best))
    for name, factor in (("stiffness", 0.97), ("mass_load", 1.05)):
        path = f"axis.x.plant.{name}"
        wrong = tree.vary(loop, {path: factor * float(tree.get(loop, path))})
        assert [claim for claim in paper._measured_claims(fit, left(wrong, even), best) if not claim.holds]
    # a sample of dead time: the command of a sample acts on the next
    dead_time = box.estimates[-1]
    assert dead_time.value == pytest.approx(paper.T, abs=2.0 * dead_time.error)


@needs_log
def test_the_peak_on_lines_is_that_of_the_loop_with_the_model() -> None:
    """|1 / (1 + L)| from the responses of law and axis, against the linear model of the same loop on these lines."""
    _, even, fit = parts()
    loop, _ = axis_of(fit)
    law = replace(loop, control=replace(loop.control, law=CascadePPI(Kv=70.0, Kp=2.0, Tn=0.02)))
    f = even.motor.frequency
    linear = paper.LinearLoop(law)
    expected = 1.0 / np.min(np.abs(1.0 + linear.model.loop_gain(f).response))
    assert paper.peak_on(law, paper.responses(law, f), f) == pytest.approx(expected, rel=1e-9)


@needs_log
def test_the_box_ends_where_damping_would_be_negative() -> None:
    """The damping of the coupling is known to 45 %: 3.75 errors less would be below 0."""
    _, _, fit = parts()
    loop, box = axis_of(fit)
    corner = box.loop(loop, [-1.0] * len(box.estimates), 1)
    assert float(tree.get(corner, "axis.x.plant.damping")) == 0.0
    assert float(tree.get(corner, "axis.x.plant.mass_load")) > 0.9 * fit["mass_load"].value
    row = next(row for row in box.table(None, "").rows if row[0] == "damping")
    assert float(row[3].value) == 0.0


def test_a_log_on_another_clock_is_refused(tmp_path: Path) -> None:
    channels = {name: np.zeros((100, 1)) for name in ("iq_refx", "theta_mx", "theta_my")}
    path = tmp_path / "slow.mat"
    scipy.io.savemat(path, {"time": 1000.0 * np.arange(100.0)[:, None], **channels})
    with pytest.raises(
        LogError, match=r"slow\.mat: one sample takes 0\.001 s, and the bench was measured every 0\.0004 s"
    ):
        measured(path)


@needs_log
@pytest.mark.slow(reason="two laws tuned over three plants, and judged at 322 each; the parts are tested above")
@pytest.mark.pictures
def test_every_claim_holds_and_the_page_has_its_figures() -> None:
    found = bench(LOG, Progress())
    assert len(found.claims) == 13
    assert not loose(found.claims)
    assert not [(claim.key, claim.shown, claim.bounds) for claim in found.claims if not claim.holds]
    page = Reproduced(found).page
    assert "Nothing was measured under these laws" in page
    assert page.count("<svg") >= 2
    documented = (DOCS / "explanation" / "measured_axis.md").read_text(encoding="utf-8")
    shown = [
        [cell.strip().strip("`*") for cell in line.split(" | ")] for line in re.findall(r"(?m)^\| (.+) \|$", documented)
    ]
    for row in (*found.tables[0].grid().rows, *found.tables[1].grid().rows):
        assert list(map(str, row)) in shown, row
