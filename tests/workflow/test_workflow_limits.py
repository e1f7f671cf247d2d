"""Limits of the commands: what is judged, listed, written or refused on either side of each."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from feeddrive.files.machine import read_machine
from feeddrive.identification.response.agreement import Agreement
from feeddrive.jobs import measured
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.language.progress import Progress
from feeddrive.loop.frequency_response import FRF
from feeddrive.workflow import identify_responses, run_job, tune_sources
from feeddrive.workflow.circle import CircleRequest, _simulated
from feeddrive.workflow.cogging import _listed, _orders, advice
from feeddrive.workflow.control_text import machine_text
from feeddrive.workflow.excite import _lost
from feeddrive.workflow.lobes import _speeds
from feeddrive.workflow.tour import MACHINE, axis

DOCS = Path(__file__).parents[2] / "docs" / "tutorials"


# cogging


def order(number: int, amplitude: float) -> Any:
    return SimpleNamespace(order=number, amplitude=amplitude)


@pytest.mark.parametrize(("text", "accepted"), [("7,900", True), ("7,1500", False)])
def test_orders_go_up_to_a_thousand(text: str, accepted: bool) -> None:
    if accepted:
        assert _orders(text) == (7, 900)
    else:
        with pytest.raises(ParameterError, match="whole numbers from 1 to"):
            _orders(text)


@pytest.mark.parametrize(("count", "text"), [(5, "orders 1, 2, 3, 4, 5"), (8, "orders 1, 2, 3, 4, 5, 6 and 2 more")])
def test_a_sentence_names_six_orders(count: int, text: str) -> None:
    assert _listed([order(number + 1, 1.0) for number in range(count)]) == text


def test_an_order_with_a_twentieth_of_the_strongest_is_named() -> None:
    orders = (order(1, 1.0), order(2, 0.06), order(3, 0.04))
    fit: Any = SimpleNamespace(significant=orders, orders=orders, coulomb=None)
    assert "orders 1, 2 stand out" in str(advice(fit).sentence)


# excitation and responses


def test_a_line_with_a_standard_deviation_of_30_percent_is_useless() -> None:
    text = str(_lost(np.array([10.0, 20.0, 40.0]), np.array([0.2, 0.25, 0.4])))
    assert text.startswith(" 1 of 3 lines are not known to 30 %, all above 20 Hz")


@pytest.mark.parametrize(("unused", "misses"), [(0.3, False), (0.5, True)])
def test_a_model_that_misses_by_three_decibels_is_no_plant(unused: float, misses: bool) -> None:
    agreement: Any = SimpleNamespace(unused=unused)
    agreement.poor = Agreement.poor.__get__(agreement)
    fit: Any = SimpleNamespace(agreement=agreement, units=SimpleNamespace(si=False, turns=False, of=lambda unit: unit))
    text = str(identify_responses.told_by(fit))
    assert text.startswith("the model misses lines") == misses
    if misses:
        assert text.endswith(f" {20.0 * math.log10(math.exp(unused)):.2g} dB")


# circles


def test_a_simulated_circle_has_a_whole_turn_between_run_in_and_run_out(monkeypatch: pytest.MonkeyPatch) -> None:
    moved = list[Any]()
    of = sys.modules[_simulated.__module__]
    monkeypatch.setattr(of, "simulate", lambda _, motion, **__: moved.append(motion["x"]))
    monkeypatch.setattr(of, "circle_of_run", lambda *_, **__: None)
    _simulated(read_machine("xy_table"), CircleRequest(sources=(Path("xy_table"),)), Progress())
    for circle in moved:
        at_feed = circle.duration - 2.0 * circle.run_up_time
        assert at_feed > 2.0 * math.pi * circle.radius / circle.feed
    assert moved


# lobes


@pytest.mark.parametrize(("count", "accepted"), [(4000, True), (8000, False)])
def test_lobes_have_up_to_five_thousand_speeds(count: int, accepted: bool) -> None:
    if accepted:
        assert _speeds(f"2000:9000:{count}", 1.0, 2).size == count
    else:
        with pytest.raises(ParameterError, match="must be first:last:count"):
            _speeds(f"2000:9000:{count}", 1.0, 2)


# results of a run


@pytest.mark.parametrize(("samples", "text"), [(80_000, True), (150_000, False)])
def test_a_run_of_up_to_100_000_rows_is_written_as_text_too(
    samples: int, text: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = list[str]()
    for name in ("html", "job_report", "summary", "summary_text", "repeatable"):
        monkeypatch.setattr(run_job, name, lambda *_, **__: "")
    for name in ("write_run_parquet", "write_run_csv"):
        monkeypatch.setattr(run_job, name, lambda path, *_: written.append(path.suffix))
    monkeypatch.setattr(run_job, "file_names", lambda _: ["today"])
    run = SimpleNamespace(samples=samples, time=None, signals=None, units=None, sample_time=None)
    job = SimpleNamespace(seed=1, program=None, machine=SimpleNamespace(file=SimpleNamespace(text="")))
    row = SimpleNamespace(run=run, together=None, name="today")
    result: Any = SimpleNamespace(job=job, rows=[row], log=None, versions={}, rotary=False, quoted=())
    run_job.write_results(result, tmp_path / "out")
    assert written == [".parquet", *([".csv"] if text else [])]


# the tour


def test_the_axis_of_the_tour_is_the_one_of_its_page() -> None:
    page = (DOCS / "studio_tour.md").read_text(encoding="utf-8")
    found = re.search(r"(\d+) kg of workpiece .* friction is (\d+) N higher.* have (\d+) nm of noise", page)
    assert found is not None
    mass, friction, noise = map(float, found.groups())
    loop, usual = axis(), read_machine(MACHINE).loop("x")
    place = loop.place_of("axis")
    for name, more in (("plant.mass_load", mass), ("friction_motor.coulomb", friction)):
        changed, there = (float(tree.get(each, f"{place}.{name}")) for each in (loop, usual))
        assert changed - there == pytest.approx(more)
    assert loop.axis.encoder_load.noise == pytest.approx(1e-9 * noise)


# a machine file with tuned numbers


def test_tuned_numbers_are_written_with_seven_digits() -> None:
    machine = read_machine("linear_motor")
    tuned = tree.vary(machine.loop("x"), {"axis.x.control.law.Kv": 123.456789123})
    assert re.search(r"(?m)^Kv = 123\.4568\b", machine_text(machine, "x", tuned.control))


# measured responses in place of a plant


@pytest.mark.parametrize(("ratio", "doubted"), [(2.5, False), (0.4, False), (4.0, True), (0.25, True)])
def test_a_response_without_a_unit_is_within_a_factor_of_three_of_the_plant(
    ratio: float, doubted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = SimpleNamespace(response=lambda lines, *_: SimpleNamespace(response=np.ones(lines.size)))
    monkeypatch.setattr(tune_sources, "linearize", lambda *_: model)
    lines = np.array([1.0, 2.0, 3.0])
    point: Any = SimpleNamespace(frequency=lines, by_force=np.full((2, 3), ratio))
    if doubted:
        with pytest.raises(ParameterError, match="it states no unit"):
            tune_sources._check_size("axis.csv", point, SimpleNamespace(), stated=False)  # type: ignore[arg-type]
    else:
        tune_sources._check_size("axis.csv", point, SimpleNamespace(), stated=False)  # type: ignore[arg-type]


@pytest.mark.parametrize(("apart", "differ"), [(0.2, False), (0.4, True)])
def test_motor_and_load_that_differ_by_a_quarter_need_both_encoders(
    apart: float, differ: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def response(lines: np.ndarray, reading: str, _: str) -> Any:
        return SimpleNamespace(
            response=np.full(lines.size, 1.0 if reading == tune_sources.READINGS[1] else 1.0 + apart)
        )

    monkeypatch.setattr(tune_sources, "linearize", lambda *_: SimpleNamespace(response=response))
    control = SimpleNamespace(at=lambda _, lines: SimpleNamespace(value=np.ones((2, lines.size))))
    monkeypatch.setattr(tune_sources, "ControlResponse", lambda *_: control)
    loop: Any = SimpleNamespace(sample_time=1e-3, control=SimpleNamespace(law=SimpleNamespace(kind="both")))
    if differ:
        with pytest.raises(ParameterError, match="on this axis both differ"):
            tune_sources._check_encoders("axis.csv", loop)
    else:
        tune_sources._check_encoders("axis.csv", loop)


def test_a_modal_fit_keeps_a_line_in_each_resonance() -> None:
    """Of three decades: a mode with a damping ratio of 2 % is 4 % wide at half of its power."""
    lines = np.geomspace(1.0, 1000.0, 5000)
    frf = FRF(lines, np.ones(lines.size, dtype=complex), "force", "position_load", "m/N")
    kept = tune_sources._fewer(frf).frequency
    assert np.all(kept[1:] / kept[:-1] < 1.04)


# measured runs of a job


def remarks(residual: float, scale: float, monkeypatch: pytest.MonkeyPatch) -> str:
    """What is said of an injected force that leaves this part of the residual if it is taken `scale` times."""
    better = SimpleNamespace(rms=lambda _: residual)
    monkeypatch.setattr(measured, "injected_scale", lambda *_: (scale, better))
    motor = SimpleNamespace(force_per_unit=lambda: 2.0)
    loop: Any = SimpleNamespace(axis=SimpleNamespace(actuator=SimpleNamespace(motor=motor)))
    replayed: Any = SimpleNamespace(contained=False, rms=lambda _: 1.0)
    return " ".join(map(str, measured.of_injected(loop, {measured.INJECTED[0]: np.zeros(2)}, replayed)))


@pytest.mark.parametrize(("residual", "remarked"), [(0.7, True), (0.9, False)])
def test_another_scale_that_leaves_four_fifths_of_the_residual_is_remarked(
    residual: float, remarked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert bool(remarks(residual, 1.0, monkeypatch)) == remarked


@pytest.mark.parametrize(("scale", "of_the_motor"), [(2.14, True), (1.86, True), (2.3, False), (1.7, False)])
def test_a_scale_within_ten_percent_of_the_motor_constant_is_explained_by_it(
    scale: float, of_the_motor: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ("the motor's force per unit" in remarks(0.5, scale, monkeypatch)) == of_the_motor
