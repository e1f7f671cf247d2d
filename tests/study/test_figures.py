"""Figures of a study: their page, where they come from, and their values against the functions of the analysis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from feeddrive.analysis.loop_model import loop_model
from feeddrive.figures.catalogue import figure, figures, measurable
from feeddrive.figures.figure import Figure, Statistics
from feeddrive.figures.of_loops import LinearLoop
from feeddrive.figures.ranking import linear
from feeddrive.files.job import read_job
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.loop.simulate import simulate, simulate_batch
from feeddrive.study.study import Bound

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "studies.md"
LOOP = read_job("ball_screw").loops["today"]


def test_the_page_has_every_figure_as_it_is_declared() -> None:
    rows = [
        f"| `{key}` | {figure.unit or '1'} | {figure.description!s} | {figure.needs} |"
        for key, figure in measurable().items()
    ]
    text = PAGE.read_text(encoding="utf-8")
    assert [row for row in rows if row not in text] == []


def test_model_figures_are_those_of_a_comparison() -> None:
    own, theirs = LinearLoop(LOOP, 0.5), linear(LOOP, loop_model(LOOP, velocity=0.5))
    compared = [name for name, each in figures().items() if each.needs == "model" and name in theirs]
    assert len(compared) >= 9
    for name in compared:
        assert figures()[name].value(own) == pytest.approx(theirs[name], rel=1e-12)
    assert figure("stiffness_35.5_Hz_N_per_m").value(own) == pytest.approx(
        1.0 / abs(own.model.closed.response(np.array([35.5]), "position_load", "load_force").response[0]), rel=1e-12
    )


def test_statistics_are_those_of_the_single_runs() -> None:
    job = read_job("ball_screw")
    masses = np.array([30.0, 36.0])
    varied = tree.vary(LOOP, {"axis.x.plant.mass_load": masses})
    names = [each for each in figures().values() if each.needs == "statistics"]
    signals = list(dict.fromkeys(signal for each in names for signal in each.signals))
    batch = Statistics(simulate_batch(varied, job.reference, duration=0.3, gather=signals))
    for i, mass in enumerate(masses):
        run = simulate(tree.vary(LOOP, {"axis.x.plant.mass_load": float(mass)}), job.reference, duration=0.3)
        for each in names:
            values = run[each.signals[0]]
            own = np.sqrt(np.mean(values**2)) if "_rms_" in each.key else np.max(np.abs(values))
            assert each.value(batch)[i] == pytest.approx(own, rel=1e-12)


def test_an_unstable_loop_has_no_figures() -> None:
    fast = tree.vary(LOOP, {"axis.x.control.law.Kp": 1e7})
    with pytest.raises(UnstableError, match="the loop is not stable"):
        figure("sensitivity_peak").value(LinearLoop(fast))


def test_a_module_is_imported_only_if_it_is_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine_of_figures.py").write_text(
        "from feeddrive.figures import Figure\n"
        'own = Figure("end_m", "last error", "m", "run", lambda run: abs(float(run["tracking_error"][-1])))\n',
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ParameterError, match="one of your own is found by --allow MODULE"):
        figure("end_m")
    assert figure("end_m", ["mine_of_figures"]).title == "last error"
    assert "end_m" not in figures()
    with pytest.raises(ParameterError, match="--allow names 'mine_of_nothing': it cannot be imported"):
        figures(["mine_of_nothing"])
    with pytest.raises(ParameterError, match=r"it holds no feeddrive\.figures\.Figure"):
        figures(["json"])


def test_two_figures_of_one_name_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "twice_of_figures.py").write_text(
        'from feeddrive.figures import Figure\nown = Figure("force_rms_N", "mine", "N", "run", len)\n', encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ParameterError, match="there is a figure 'force_rms_N' already"):
        figures(["twice_of_figures"])


def test_a_figure_needs_what_there_is() -> None:
    with pytest.raises(ParameterError, match="needs = 'signals' must be one of statistics, model, run"):
        Figure("a", "b", "", "signals", len)


def test_a_bound_is_kept_up_to_its_ends_and_never_by_nan() -> None:
    bound = Bound(figure("force_rms_N"), 1.0, 2.0)
    assert bound.kept(np.array([0.99, 1.0, 2.0, 2.01, np.nan])).tolist() == [False, True, True, False, False]
