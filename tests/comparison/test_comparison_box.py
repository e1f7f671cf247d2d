"""A comparison over a box: every law keeps the rule there, worst figures stand beside those of the model, and only what
holds is ranked."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.filter.low_pass2 import LowPass2
from feeddrive.blocks.filter.notch import Notch
from feeddrive.blocks.reference.snap_limited_move import SnapLimitedMove
from feeddrive.comparison.compare import TODAY, Comparison, compare_laws
from feeddrive.comparison.report import comparison_report, summary
from feeddrive.evaluation.competitor import OUTSIDE, UNDECIDED, AtWork, Place, Plant
from feeddrive.evaluation.duty import Duty, duty_of
from feeddrive.evaluation.robustness import Design, Rule
from feeddrive.figures.ranking import CRITERIA
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.box import Box
from feeddrive.loop.loop import Loop
from feeddrive.tuning.candidates import PLAIN, Candidate
from feeddrive.tuning.filters import filter_response, with_notch_and_low_pass
from feeddrive.tuning.worst import Examined, OverBox, over_box
from feeddrive.workflow.compare import CompareRequest

SHORT = SnapLimitedMove(
    distance=0.02, velocity=0.2, acceleration=5.0, jerk=400.0, snap=4e4, back=True, dwell_before=0.5, dwell_after=0.2
)


@pytest.fixture(scope="module")
def found() -> Comparison:
    return compare_laws(read_machine("linear_motor"), reference=SHORT, starts=1, laws=["P-PI"], box=Box())


def test_the_rule_holds_over_the_box(found: Comparison) -> None:
    law = found[PLAIN]
    assert law.box is not None
    assert law.box.holds is True
    assert law.figures["sensitivity_peak"] < 1.7 < law.worst["sensitivity_peak"] <= 2.0  # type: ignore[operator]
    assert law.worst["delay_margin_samples"] >= 2.0  # type: ignore[operator]
    assert "all bounds hold over the box: every stiffness ±20 %, every mass ±30 %, up to 1 more sample" in found.rule


def test_worst_figures_are_no_better_than_those_of_the_model(found: Comparison) -> None:
    law = found[PLAIN]
    for criterion in CRITERIA:
        worst, nominal = law.worst.get(criterion.key), law.figures.get(criterion.key)
        if worst is not None and nominal is not None:
            # 0.1 %: the model's figure is that of other frequency lines
            assert worst <= 1.001 * nominal if criterion.higher else worst >= 0.999 * nominal, criterion.key
    assert {"tracking_error_rms_m", "rope_snap_ISE_root_m_per_N", "stiffness_10_Hz_N_per_m"} <= set(law.worst)


def test_every_law_tunes_a_notch_and_a_low_pass(found: Comparison) -> None:
    law = found[PLAIN]
    assert law.tuned is not None
    assert any(name.startswith("filters.") for name in law.tuned.tunables)
    assert found[TODAY].loop.control.filters == read_machine("linear_motor").loop("x").control.filters


def test_tables_show_both(found: Comparison) -> None:
    text = str(found)
    assert text.count("  at worst") == 2
    report = str(list(comparison_report(found).sections))
    assert "at the model, then at the worst plant of the box" in report
    assert "Ms at worst" in report
    row = summary(found)["laws"][PLAIN]
    assert row["box"]["verdict"] == "holds"
    assert row["worst"]["sensitivity_peak"] == found[PLAIN].worst["sensitivity_peak"]
    assert row["searches"] == {"within_5_percent": 1, "all": 1}
    assert "mass 28 to 52 kg" in str(summary(found)["box"])


def test_the_picture_leads_from_the_model_to_the_worst_plant(found: Comparison) -> None:
    panel = found.chart().panels[0]
    assert len(panel.curves) == len(panel.marks) == 2
    way, mark = panel.curves[1], panel.marks[1]
    assert (way.x[0], way.y[0]) == (mark.x, mark.y)
    assert way.x[1] >= way.x[0]
    assert way.y[1] <= way.y[0]


def judged(loop: Loop, rule: Rule) -> AtWork:
    plant = Plant("", loop, duty_of(loop, SHORT, None), rule, (Place("x", loop.axis, loop.axis),), (0,), 0)
    return AtWork(Candidate("law", loop), plant)


@pytest.mark.parametrize(("used", "kind"), [(0.99, ""), (1.001, UNDECIDED), (1.01, OUTSIDE)])
def test_only_what_holds_is_ranked(used: float, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A loop within the rule at its model, with what the examination of its box is said to have found."""
    loop = read_machine("linear_motor").loop("x")
    case = judged(loop, Rule(2.0, 2.0, 1.05, 0.1, 1, box=Box(0.0, 0.1, 0)))

    def found(*examined: Any, **shown: Any) -> tuple[OverBox, list[Examined]]:
        box, plants = over_box(*examined, **shown)
        return replace(box, used=used), plants

    monkeypatch.setattr("feeddrive.evaluation.competitor.over_box", found)
    row = case.outcome(Progress())
    assert row.kind == kind
    assert bool(row.unplaced) is bool(kind)
    if kind:
        assert "over the box Ms" in row.unplaced


def test_a_loop_that_is_unstable_in_the_box_has_no_worst_runs() -> None:
    loop = read_machine("linear_motor").loop("x")
    law = replace(loop.control.law, Kp=90_000.0)
    case = judged(
        replace(loop, control=replace(loop.control, law=law)), Rule(9.0, 0.1, 1.05, 0.1, 1, box=Box(0.0, 0.5, 3))
    )
    row = case.outcome(Progress())
    assert row.kind == OUTSIDE
    assert "over the box unstable at model: mass -50 %" in row.unplaced
    assert "tracking_error_rms_m" not in row.worst


def test_every_law_runs_at_the_same_plants(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever its worst plants are, which differ between these gains."""
    loop, box = read_machine("linear_motor").loop("x"), Box()
    seen = list[list[tuple[float, float]]]()
    runs = Duty.runs

    def noted(duty: Duty, run: Loop, *rest: Any) -> Any:
        seen[-1].append((float(run.axis.plant.rigid_mass()), float(run.axis.actuator.dead_time)))
        return runs(duty, run, *rest)

    monkeypatch.setattr(Duty, "runs", noted)
    worst = list[Any]()
    for Kp in (15_000.0, 31_000.0):
        seen.append([])
        law = replace(loop.control.law, Kp=Kp)
        row = judged(replace(loop, control=replace(loop.control, law=law)), Rule(9.0, 0.1, 9.0, 0.1, 1, box=box))
        worst.append(row.outcome(Progress()))
    assert seen[0] == seen[1]
    mass, dead, T = 40.0, float(loop.axis.actuator.dead_time), float(loop.sample_time)
    assert seen[0] == [(mass, dead), *((mass * (1.0 + u), dead + late * T) for late in (0, 1) for u in (-0.3, 0.3))]
    assert worst[0].box.plant != worst[1].box.plant
    # the worst of these runs, and not that of the model
    assert all(row.worst["tracking_error_rms_m"] > 1.2 * row.figures["tracking_error_rms_m"] for row in worst)


def test_the_noise_of_p_pi_counts_at_its_worst_plant(found: Comparison) -> None:
    """Otherwise P-PI would break over the box the bound that it sets."""
    plain = found[PLAIN].tuned
    assert plain is not None
    rule = Rule(2.0, 2.0, 1.05, 0.1, 1, box=Box()).with_noise_of(plain)  # type: ignore[arg-type]
    assert rule.noise is not None
    assert rule.noise > 1.05 * found[PLAIN].figures["noise_gain_N_per_m"]  # type: ignore[operator]


def test_a_design_keeps_how_many_searches_agreed(found: Comparison) -> None:
    plain = found[PLAIN].tuned
    design = Design.of(PLAIN, plain, Rule(2.0, 2.0, 1.05, 0.1, 1))  # type: ignore[arg-type]
    assert Design.read(design.record()).agreed == (1, 1)
    # designs of earlier versions have no such number
    old = {name: value for name, value in design.record().items() if name != "agreed"}
    assert Design.read(old).agreed == (0, 0)


def test_added_filters_are_nearly_without_effect() -> None:
    loop = read_machine("machining_center").loop("x")
    assert not loop.control.filters
    filters = with_notch_and_low_pass(loop).control.filters
    assert [type(block) for block in filters] == [Notch, LowPass2]
    # the axial mode of the screw, 204 Hz by the remark of the machine file
    assert filters[0].frequency == pytest.approx(204.0, rel=0.02)  # type: ignore[attr-defined]
    f = np.array([10.0, 50.0])
    gain = np.prod([filter_response(block, f, float(loop.sample_time)) for block in filters], axis=0)
    # at 50 Hz, the crossover: the delay of a low-pass at 0.4 of the sample rate is 2 · 0.7/(2π 2000 Hz) = 0.11 ms
    assert np.all(np.abs(np.abs(gain) - 1.0) < 0.02)
    assert np.all(np.abs(np.degrees(np.angle(gain))) < 4.0)
    # what is there stays
    screw = read_machine("ball_screw").loop("x")
    assert with_notch_and_low_pass(screw).control.filters == screw.control.filters


def test_options_that_no_comparison_has_are_refused() -> None:
    machine = read_machine("linear_motor")
    with pytest.raises(ParameterError, match="filters = 'placed' must be kept or free"):
        compare_laws(machine, filters="placed")
    with pytest.raises(ParameterError, match="box 'wide': 'wide' is no tolerance"):
        CompareRequest("linear_motor", box="wide")
