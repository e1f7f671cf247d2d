"""Every example runs, and says what its page says it says."""

from __future__ import annotations

import re
import runpy
from itertools import pairwise
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


def said(name: str, capsys: pytest.CaptureFixture[str]) -> str:
    runpy.run_path(str(EXAMPLES / name))
    return capsys.readouterr().out


def test_every_example_is_in_the_readme_and_tested() -> None:
    listed = set(re.findall(r"\[(\w+\.py)\]", (EXAMPLES / "README.md").read_text(encoding="utf-8")))
    assert listed == {path.name for path in EXAMPLES.glob("*.py")}
    text = Path(__file__).read_text(encoding="utf-8")
    assert all(f'said("{name}"' in text for name in listed)


def test_the_best_gains_keep_the_sensitivity_peak(capsys: pytest.CaptureFixture[str]) -> None:
    found = re.search(r"Ms ([0-9.]+), ([0-9.]+) um RMS", said("gain_map.py", capsys))
    assert found is not None
    # |S| of a sampled loop with a pole at z = 1 is above 1 somewhere (Bode's integral)
    assert 1.0 < float(found[1]) <= 2.0


def test_the_gain_margin_is_the_edge(capsys: pytest.CaptureFixture[str]) -> None:
    verdicts = re.findall(r"um at 1.6 s: (.*)", said("edge_of_stability.py", capsys))
    assert verdicts == ["dies out", "rings on"]


def test_set_valued_friction_holds_and_the_regularised_creeps(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("standstill.py", capsys)
    assert re.search(r"coulomb +moved +0\.00 um .* fastest +0\.000 um/s", text)
    # tanh(v/v_t) = 15/20 at v = 0.973 v_t = 195 um/s
    creep = re.search(r"regularised .* fastest +([0-9.]+) um/s", text)
    assert creep is not None
    assert float(creep[1]) == pytest.approx(194.6, rel=0.001)


def test_a_faster_cascade_is_stiffer_and_less_robust(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("cascade_by_margins.py", capsys)
    peaks, stiff, alone, forward = (
        [float(x) for x in re.findall(rf"{word} +([0-9.]+)", text)] for word in ("Ms", "softest", "alone", "forward")
    )
    assert peaks == sorted(peaks)
    # force over displacement scales with mass times frequency squared where the loop is a scaled copy; dead time is not
    for below, above in pairwise(stiff):
        assert above / below == pytest.approx(4.0, rel=0.1)
    assert all(f < a / 10.0 for a, f in zip(alone, forward, strict=True))
