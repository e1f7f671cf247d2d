"""The catalogue of figures: an entry is enough for a goal and a limit of a tuning, wherever figures are named."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.figures import catalogue, of_loops
from feeddrive.figures.figure import HIGHER, MODEL, Figure, Goal, Limit
from feeddrive.figures.of_loops import (
    COMPLIANCE_PEAK,
    OF_LOOPS,
    PHASE_MARGIN,
    SENSITIVITY_PEAK,
    STIFFNESS_LEAST,
    LinearLoop,
)
from feeddrive.figures.ranking import LINEAR
from feeddrive.figures.slopes import (
    _near,
    _tilts,
    compliance_peak_slope,
)
from feeddrive.files.run_files import figure_key
from feeddrive.language.errors import ParameterError
from feeddrive.language.quantity import Quantity, Units
from feeddrive.language.units import in_key, turning
from feeddrive.loop.loop import Loop
from feeddrive.tuning.closed_loop import reported
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.tune import tune_control

LOOP = fd.read_machine("linear_motor").loop(None)
SOFT = Figure(
    "softness_m_per_N",
    "softness",
    "m/N",
    MODEL,
    lambda loop: 1.0 / loop.stiffness.minimum,
    meaning="by a package",
    tuned=True,
    goal=Goal("softness", "softness", lambda loop, _: float(np.max(loop.compliance.magnitude)), compliance_peak_slope),
    limit=replace(COMPLIANCE_PEAK.limit, option="most_softness") if COMPLIANCE_PEAK.limit else None,
)


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A package that brings one figure, which can be a goal and have a limit."""
    caches = (catalogue._with_own, catalogue.goals, catalogue.limitable, reported)
    monkeypatch.setattr(catalogue, "_installed", lambda: iter([("a package", SOFT)]))
    for cache in caches:
        cache.cache_clear()
    yield
    for cache in caches:
        cache.cache_clear()


@pytest.mark.usefixtures("installed")
def test_a_goal_and_a_limit_of_a_package_are_one_entry() -> None:
    from feeddrive.workflow.tune import limit_options

    assert "softness" in catalogue.goals()
    assert "most_softness" in limit_options()
    assert catalogue.figure("softness_m_per_N").value(LinearLoop(LOOP)) > 0.0
    found = tune_control(LOOP, goal="softness", limits=[Limit(SENSITIVITY_PEAK, 1.8), Limit(SOFT, 1e-7)], starts=1)
    assert found.rule == "least softness subject to Ms <= 1.8, softness <= 0.1 um/N"
    assert found.after[0].margins.sensitivity_peak <= 1.8 * 1.002
    assert any(row[0] == "softness" for row in found.table().rows)
    known = tune_control(LOOP, goal="least-stiffness", limits=Limits(sensitivity_peak=1.8), starts=1)
    assert found.tunables == pytest.approx(known.tunables, rel=1e-3)


@pytest.mark.parametrize("figure", OF_LOOPS, ids=[figure.key for figure in OF_LOOPS])
def test_every_figure_of_a_loop_has_a_value(figure: Figure) -> None:
    value = figure.value(LinearLoop(LOOP))
    assert isinstance(value, float)
    assert math.isfinite(value)


def test_a_figure_names_its_unit_in_files() -> None:
    with pytest.raises(ParameterError, match=r"'a_mm' must end with its unit: \.\.\._m"):
        Figure("a_mm", "a", "m", MODEL, len)
    with pytest.raises(ParameterError, match="needs `of`"):
        Figure("a_m", "a", "m", MODEL)
    assert figure_key("force_peak_N", Units(rotary=True)) == "force_peak_N_m"
    assert figure_key("integral_gain_N_per_m_s", Units(rotary=True)) == "integral_gain_N_m_per_rad_s"


@pytest.mark.parametrize("figure", catalogue.figures().values(), ids=list(catalogue.figures()))
def test_the_key_of_a_figure_turns_with_its_unit(figure: Figure) -> None:
    stem = figure.key.removesuffix(in_key(figure.unit))
    assert figure_key(figure.key, Units(rotary=True)) == stem + in_key(turning(figure.unit))
    assert figure_key(figure.key, Units()) == figure.key


@pytest.mark.parametrize(
    ("unit", "turned"),
    [
        ("m/(s N)", "rad_per_s_N_m"),
        ("m/s2", "rad_per_s2"),
        ("N s/m", "N_m_s_per_rad"),
        ("kg", "kg_m2"),
        ("N m", "N_m"),
        ("Hz", "Hz"),
    ],
)
def test_a_unit_that_no_shipped_figure_has_turns_too(unit: str, turned: str) -> None:
    figure = Figure(f"own_{in_key(unit)}", "of a package", unit, MODEL, len)
    assert figure_key(figure.key, Units(rotary=True)) == f"own_{turned}"


def test_a_key_without_a_unit_does_not_turn() -> None:
    for key in ("m", "operations", "delay_margin_samples", "yield_of_machines"):
        assert figure_key(key, Units(rotary=True)) == key


def test_limits_are_data() -> None:
    limits = Limits([Limit(PHASE_MARGIN, 30.0)], sensitivity_peak=None)
    assert limits.sentence() == "phase margin >= 30 deg"
    assert limits.eased(PHASE_MARGIN, 1.5).bound(PHASE_MARGIN) == 20.0
    assert Limits().eased(SENSITIVITY_PEAK, 1.5).bound(SENSITIVITY_PEAK) == 2.5
    assert [limit.figure for limit in limits.having(Limit(SENSITIVITY_PEAK, 1.5)).limits] == [
        SENSITIVITY_PEAK,
        PHASE_MARGIN,
    ]
    with pytest.raises(ParameterError, match="no tuning can limit 'crossover_Hz'"):
        Limits(crossover_Hz=10.0)
    with pytest.raises(ParameterError, match="phase_margin_deg = 180 must be < 180"):
        Limit(PHASE_MARGIN, 180.0)
    with pytest.raises(ParameterError, match="no tuning can keep a limit of 'operations'"):
        Limit(catalogue.figures()["operations"], 3.0)


def test_a_limit_knows_how_much_of_it_is_used() -> None:
    phase, peak = Limit(PHASE_MARGIN, 30.0), Limit(SENSITIVITY_PEAK, 2.0)
    assert (phase.used(-60.0), phase.used(15.0), phase.used(None)) == (0.5, 2.0, 0.0)
    assert (peak.used(1.0), peak.used(4.0)) == (0.5, 2.0)
    assert phase.keeps(-30.0)
    assert not phase.keeps(29.0)
    assert phase.keeps(29.0, room=0.05)
    assert peak.keeps(2.0)
    assert not peak.keeps(2.001)
    assert PHASE_MARGIN.better == HIGHER
    assert isinstance(LOOP, Loop)


def test_a_tuning_reports_the_stiffness_at_10_hz_and_a_study_measures_that_at_100_hz() -> None:
    shipped = catalogue.figures()
    assert (shipped["stiffness_10_Hz_N_per_m"].tuned, shipped["stiffness_100_Hz_N_per_m"].tuned) == (True, False)


@pytest.mark.parametrize(("sample_time", "lowest"), [(1e-4, 1.0), (0.02, 0.25)])
def test_the_least_stiffness_counts_from_1_hz_on(sample_time: float, lowest: float) -> None:
    """A slowly sampled loop keeps two decades of lines below its Nyquist frequency of 25 Hz; 200 lines a decade."""
    law = fd.blocks.CascadePPI(Kv=5.0, Kp=500.0)
    loop = Loop(control=fd.Control(law=law), axis=fd.Axis(plant=fd.blocks.Rigid(mass=100.0)), sample_time=sample_time)
    assert lowest <= LinearLoop(loop).stiffness.frequency[0] < lowest * 10.0 ** (1.0 / 200.0)


def test_a_mean_stiffness_is_that_of_sixty_lines() -> None:
    """Each end of the band counts as much as a line within, and not half: that is the error of the mean."""
    linear = LinearLoop(LOOP)
    f = np.geomspace(10.0, 100.0, 2001)
    level = -np.log(linear.model.closed.response(f, "position_load", "load_force").magnitude)
    mean = float(np.trapezoid(level, np.log(f)) / np.log(10.0))
    most = abs(0.5 * float(level[0] + level[-1]) - mean) / 59.0
    assert abs(np.log(linear.mean_stiffness(10.0, 100.0)) - mean) < 1.1 * most


@pytest.mark.parametrize(("slack", "kept"), [(0.6, True), (0.8, False)])
def test_a_bound_that_a_step_of_the_search_may_reach_is_kept(slack: float, kept: bool) -> None:
    """The trust region is at most 0.6 of a logarithm wide."""
    loop = SimpleNamespace(gain_slope=np.zeros((2, 1)), thinned=False)
    assert bool(_near(np.array([slack, 5.0]), loop).size) is kept  # type: ignore[arg-type]


@pytest.mark.parametrize(("kink", "straight"), [(0.06, False), (0.1, True)])
def test_the_tilt_of_a_loop_gain_is_that_of_its_lines_within_eight_percent(kink: float, straight: bool) -> None:
    """|L| ~ 1/f up to a kink of its curve, at a distance in ln f."""
    x = 0.01 * np.arange(-50.0, 51.0)
    level = -x - 3.0 * np.maximum(x - kink, 0.0)
    tilt, _ = _tilts(x, level, np.zeros(x.size - 1), 50)
    assert (tilt == pytest.approx(-1.0)) is straight


def test_one_entry_in_the_module_is_enough() -> None:
    assert of_loops.__file__ is not None
    source = Path(of_loops.__file__).read_text(encoding="utf-8")
    above, head, below = source.partition("\nOF_LOOPS = ")
    entry = 'MOBILITY = Figure("mobility_m_per_s_N", "mobility", "m/(s N)", MODEL, len, judges_laws=True)\n'
    module: dict[str, Any] = {"__name__": of_loops.__name__}
    exec(compile(f"{above}\n{entry}{head}{below}", of_loops.__file__, "exec"), module)
    assert [figure.key for figure in module["OF_LOOPS"]] == [*(figure.key for figure in OF_LOOPS), "mobility_m_per_s_N"]


def test_a_comparison_judges_laws_by_what_the_figures_say() -> None:
    assert [figure.key for figure in LINEAR if not figure.judges_laws] == []
    assert STIFFNESS_LEAST in LINEAR
    assert COMPLIANCE_PEAK not in LINEAR


def test_a_length_per_force_is_shown_in_micrometres() -> None:
    assert str(Quantity(1.052e-4, "m/(s N)")) == "105.2 um/(s N)"
    assert Units(rotary=True).text(Quantity(1.052e-4, "m/(s N)")) == "105.2 urad/(s N m)"
    assert str(Quantity(2e-9, "m/N")) == "0.002 um/N"
    assert str(Quantity(0.5, "m s/kg")) == "0.5 m s/kg"
