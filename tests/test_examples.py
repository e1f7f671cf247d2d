"""Every example runs, and says what its page says it says."""

from __future__ import annotations

import re
import runpy
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd

EXAMPLES = Path(__file__).parents[1] / "examples"


def said(name: str, capsys: pytest.CaptureFixture[str]) -> str:
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return capsys.readouterr().out


def test_every_example_is_in_the_readme_and_tested() -> None:
    listed = set(re.findall(r"\[(\w+\.py)\]", (EXAMPLES / "README.md").read_text(encoding="utf-8")))
    assert listed == {path.name for path in EXAMPLES.glob("*.py")}
    text = Path(__file__).read_text(encoding="utf-8")
    assert all(f'said("{name}"' in text for name in listed)


def test_a_law_without_a_slope_is_simulated_and_has_no_margins(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("square_root_mode.py", capsys)
    assert 0.1 < float(re.findall(r"square-root mode: ([0-9.]+) um", text)[0]) < 10.0  # 100 counts of 10 nm: it follows
    assert "a square root of 0 has no finite slope (square_root_mode, square_root_mode.py, line" in text


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


def test_placed_poles_are_stiff_at_low_frequencies_and_not_everywhere(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("pole_placement.py", capsys)
    rows = re.findall(r"Ms ([0-9.]+), +([0-9]+) N/um at 5 Hz, softest +([0-9.]+)", text)
    peaks, low, softest = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    # the first row is P-PI, the last pole placement of the same sensitivity peak
    assert peaks[-1] == pytest.approx(peaks[0], abs=0.02)
    assert low[-1] > 4.0 * low[0]
    assert softest[-1] < softest[0]
    # far below the bandwidth it is k Ki / ((k + K1) ω)
    screw = fd.blocks.TwoMass(
        mass_motor=220, mass_load=90, stiffness=9e7, damping=1800, viscous_motor=2500, viscous_load=100
    )
    gains = fd.blocks.PolePlacement(model=screw, bandwidth=80.0, axial_damping=0.08).gains()
    assert 1e6 * low[-1] == pytest.approx(9e7 * gains.Ki / ((9e7 + gains.K1) * 2.0 * np.pi * 5.0), rel=0.02)
    cascade, placed, rigid = map(float, re.findall(r"([0-9.]+) um RMS", text))
    assert placed < 0.3 * rigid < rigid < cascade


def test_a_prefilter_of_one_move_helps_another(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("trajectory_prefilter.py", capsys)
    moves = re.findall(r"move: +([0-9.]+) -> ([0-9.]+) um", text)
    assert len(moves) == 2
    assert all(float(after) < 0.5 * float(before) for before, after in moves)
    even = re.search(r"snap only: ([0-9.]+)", text)
    assert even is not None
    assert float(even[1]) > 2.0 * float(moves[0][1])


def test_more_taylor_states_cut_better_and_are_less_robust(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("taylor_states.py", capsys)
    found = re.findall(r"Ms ([0-9.]+), .* Hz +(\S+) +(\S+) +(\S+) um/N, cutting +(\S+) um", text)
    rows = [[float(x) for x in row] for row in found]
    assert len(rows) == 4
    peaks, _, _, high, errors = zip(*rows, strict=True)
    assert list(peaks) == sorted(peaks)
    assert list(high) == sorted(high)  # at 140 Hz each state makes the axis softer
    assert list(errors) == sorted(errors, reverse=True)
    assert "sample every 0.00257" in text


def test_the_spindle_gives_what_the_chips_take(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("interrupted_cut.py", capsys)
    pairs = re.findall(r"spindle ([0-9.]+) W, chips ([0-9.]+) W", text)
    assert len(pairs) == 2
    for spindle, chips in pairs:
        assert float(spindle) == pytest.approx(float(chips), rel=1e-6)


def test_dadsc_is_stiffer_at_low_frequency_by_27_over_16(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("three_frequencies.py", capsys)
    ours, theirs = (float(x) for x in re.findall(r"N/um at 1 Hz +([0-9.]+)", text))
    assert ours / theirs == pytest.approx(27 / 16, rel=0.01)
    # 0.19/(d + 1) keeps Ms <= 2, with half of it for d = 1 as the unit of the table
    factors = [float(line.split()[-1]) for line in text.strip().splitlines()[-4:]]
    assert all(f >= 0.99 * 4.0 / (d + 1) for d, f in enumerate(factors))


def test_a_recovered_force_is_rejected_at_the_cost_of_margin(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("recovered_force.py", capsys)
    errors = [float(x) for x in re.findall(r"([0-9.]+) um RMS", text)]
    peaks = [float(x) for x in re.findall(r"Ms ([0-9.]+)", text)]
    assert all(error < errors[0] / 5.0 for error in errors[1:])
    assert all(peak > peaks[0] for peak in peaks[1:])


def test_the_axis_moves_with_the_tool(capsys: pytest.CaptureFixture[str]) -> None:
    none, plain, lead, off = (
        float(x) for x in re.findall(r"([0-9.]+) um RMS", said("moving_with_the_tool.py", capsys))
    )
    assert plain < none / 5.0
    assert lead < none / 30.0
    assert off > 0.5 * none


def test_friction_is_learned_from_moves_that_do_not_repeat(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("learn_by_trials.py", capsys)
    found = re.findall(r"same move +([0-9.]+) -> +([0-9.]+) um, changing moves -> +([0-9.]+) um", text)
    (first, plain, plain_turns), (_, coulomb, coulomb_turns) = (tuple(map(float, row)) for row in found)
    assert plain < 0.4 * first
    assert coulomb < 0.5 * plain
    assert coulomb_turns < 0.7 * plain_turns
    before, after = map(float, re.findall(r"a learned signal.* ([0-9.]+) -> ([0-9.]+) um", text)[0])
    assert after > before


def test_the_estimated_response_is_that_of_the_model(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("frequency_response.py", capsys)
    inside = re.search(r"([0-9.]+) % of [0-9]+ lines within", text)
    assert inside is not None
    # 186 lines of 95 %: 90 % is three deviations away
    assert float(inside[1]) >= 90.0
    assert re.search(r"refused: travel reaches .* an amplitude of [0-9]+ N keeps it", text)


def test_an_axis_is_identified_with_errors_that_hold(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("identify_axis.py", capsys)
    assert "true mass within 95 %: True\ndead time 0 samples; Kv 160.18" in text
    assert re.search(r"Use these values: .* not used to [0-9.]+ % of the force", text)
    # the model that made the runs comes first of all
    assert re.search(r"-----\nstribeck, gaussian +4 ", text)


@pytest.mark.slow(reason="a search from a noisy response, which test_shaping has for other noise")
def test_gains_from_a_noisy_response_hold_on_the_true_axis(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("tune_from_response.py", capsys)
    kept, free, placed = (float(x) for x in re.findall(r"rope snap ([0-9.]+)", text))
    assert kept > free > placed
    assert all(float(x) < 2.01 for x in re.findall(r"true axis ([0-9.]+)", text))
    assert "by rule: Kv" in text


def test_margins_of_a_measured_axis_hold_the_true_one(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("measured_margins.py", capsys)
    low, high = (float(x) for x in re.findall(r"modulus_margin +[0-9.]+ +([0-9.]+) +([0-9.]+)", text)[0])
    true = re.search(r"modulus margin of the true loop: ([0-9.]+)", text)
    assert true is not None
    # one interval of 95 %, of a seed that is fixed
    assert low <= float(true[1]) <= high < 1.1 * low
    assert text.count("the closed loop is stable") == 2


@pytest.mark.slow(reason="what no line tells is searched for long; its fits have quick tests")
def test_masses_come_out_and_what_no_line_tells_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("identify_masses.py", capsys)
    found = {
        name: (float(value), float(error))
        for name, value, error in re.findall(
            r"^(mass_motor|mass_load|stiffness) +\S+ +(\S+) +(\S+)", text, re.MULTILINE
        )
    }
    for name, truth in (("mass_motor", 130.0), ("mass_load", 33.0), ("stiffness", 18.0)):  # kg, N/um
        value, error = found[name]
        assert abs(value - truth) < 4.0 * error
    assert re.search(r"two-mass .* taken", text)
    assert "not identifiable: viscous_load" in text
    assert re.search(r"^1 +131\.6", text, re.MULTILINE)
    open_ = text.split("to 30 Hz with one encoder: ")[1].splitlines()[0]
    assert "stiffness" in open_
    assert "mass_load" in open_


@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: needs gcc: apt-get install gcc libc6-dev")
def test_an_exported_control_is_equal_and_gains_change_without_a_bump(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("export_and_change.py", capsys)
    assert "0 outputs with other bits" in text
    assert ", 0 loops" in text
    steps = re.findall(r"at 0.05 s +([0-9.]+) N, largest of all +([0-9.]+) N", text)
    assert len(steps) == 2
    # a change of gains by a third moves the force by less than the move itself does at its quickest
    assert all(float(at) < float(largest) for at, largest in steps)
