"""`feeddrive tune --box`: what is written down of the box, and what is said where there is no model of the plant."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.certificate import box_check
from feeddrive.identification.response.plant_fit import fit_two_mass
from feeddrive.language.errors import ParameterError
from feeddrive.language.judgment import Judgment
from feeddrive.language.table import Table
from feeddrive.loop.box import AUTO, Box
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import linearize
from feeddrive.study.robust import tune_robust
from feeddrive.tuning.worst import box_plants
from feeddrive.workflow.certify import CertifyRequest, certify
from feeddrive.workflow.command import AT_THE_MODEL, OF_ERRORS
from feeddrive.workflow.compare import CompareRequest
from feeddrive.workflow.identify_responses import machine_text
from feeddrive.workflow.tune import NO_MODEL, TuneRequest, tune


def test_nominal_and_worst_stand_beside_each_other(tmp_path: Path) -> None:
    request = TuneRequest(
        "linear_motor", box="mass=0.3,dead_time=1sample", filters="kept", starts=1, out=tmp_path / "out"
    )
    outcome = tune.run(request)
    tables = [table for table in outcome.tables if isinstance(table, Table)]
    figures = next(table for table in tables if "figures of the closed loop" in str(table.title))
    assert [str(getattr(column, "name", column)) for column in figures.columns] == [
        "what", "today", "worst", "new", "worst of new", "unit",
    ]  # fmt: skip
    kept = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert kept["box"]["box"] == "stiffness=0,mass=0.3,dead_time=1sample"
    assert kept["box"]["verdict"] == "holds"
    assert kept["box"]["figures"]["sensitivity_peak"]["worst"] <= 2.0
    assert kept["box_today"]["verdict"] == "undecided"  # today's Ms is 2.001 there
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "mass 28 to 52 kg" in report
    assert "4 of 4 corners" in report
    # the rules of the trade are judged at the model: today's "kept" is not that of the box
    assert "whether the limits are kept there; at the model, without the other plants of the box" in report
    assert "--box mass=0.3,dead_time=1sample" in report


def test_without_a_model_it_says_what_is_done_instead() -> None:
    loop = fd.read_machine("linear_motor").loop("x")
    lines = np.geomspace(2.0, 4000.0, 400)
    response = linearize(loop, ["cut"], ["reading_load"]).response(lines)
    measured = replace(response, output="reading_load", input="force", unit="m/N")
    assert isinstance(measured, FRF)
    request = TuneRequest(measured, motor=("none",), box="standard", filters="kept", starts=1)
    outcome = tune.run(request)
    assert NO_MODEL in outcome.remarks
    assert outcome.result.box is None


def test_a_box_that_cannot_be_read_is_refused_before_the_work() -> None:
    with pytest.raises(ParameterError, match=r"box: mass = 3\.0 must be a share >= 0 and < 1"):
        TuneRequest("linear_motor", box="mass=3")


@pytest.mark.slow(reason="a tuning over the machines of a study and over a box, 15 s")
def test_one_control_for_a_study_holds_over_the_box_of_its_job_too(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(
        'job = "ball_screw"\nsampler = "grid"\n[[vary]]\nparameter = "axis.x.plant.mass_load"\nvalues_kg = [33, 36]\n',
        encoding="utf-8",
    )
    plain = tune_robust(path, filters="kept", starts=1, fresh=16)
    boxed = tune_robust(path, filters="kept", starts=1, fresh=16, box=Box(0.0, 0.0, 2))
    assert plain.tuned.box is None
    assert boxed.tuned.box is not None
    assert boxed.tuned.box.holds is True
    assert "2 samples later" in str(boxed.tuned.box.plant)
    assert boxed.tuned.after[0].rope_snap > 1.05 * plain.tuned.after[0].rope_snap


ERRORS = """
[axis.x.standard_errors]
"plant.mass" = 0.8
"friction_load.viscous" = 2.0
"""


def with_errors(folder: Path, errors: str = ERRORS) -> Path:
    path = folder / "axis.toml"
    bundled = fd.read_machine("linear_motor").file.text
    path.write_text(bundled + errors, encoding="utf-8")
    return path


def test_the_box_of_an_identified_machine_is_that_of_its_errors(tmp_path: Path) -> None:
    """40 kg with a standard error of 0.8 kg: the limits hold from 38.4 to 41.6 kg."""
    path = with_errors(tmp_path)
    outcome = tune.run(TuneRequest(path, box="identified", filters="kept", starts=1))
    found = outcome.result
    assert OF_ERRORS in outcome.notes
    assert found.box.holds is True
    assert "mass 38.4 to 41.6 kg" in str(found.box.text)
    ends = [spread for spread in found.box.spreads if spread.figure.key == "sensitivity_peak"]
    assert ends[0].worst > 1.01 * ends[0].nominal


def test_the_default_box_is_that_of_the_errors_or_the_standard_one(tmp_path: Path) -> None:
    plain, known = fd.read_machine("linear_motor"), fd.read_machine(with_errors(tmp_path))
    assert plain.box(AUTO, "x") == Box()
    identified = known.box(AUTO, "x")
    assert identified is not None
    assert identified.known == (("mass", 2.0 * 0.8 / 40.0),)
    friction = fd.read_machine(with_errors(tmp_path, '[axis.x.standard_errors]\n"friction_load.viscous" = 2.0\n'))
    assert friction.box(AUTO, "x") == Box()
    assert TuneRequest("linear_motor").box == CompareRequest("linear_motor").box == AUTO


def test_a_box_in_which_nothing_of_the_axis_spreads_is_refused() -> None:
    """A rigid axis has no stiffness: limits at its model alone would be called limits over the box."""
    machine = fd.read_machine("linear_motor")
    with pytest.raises(ParameterError, match=r"box 'stiffness=30%': no plant but the model.* axis 'x' .* is mass"):
        machine.box("stiffness=30%", "x")
    # who states that nothing spreads means the model
    assert machine.box("dead_time=0samples", "x") == Box(0.0, 0.0, 0)
    assert machine.box("dead_time=1sample", "x") == Box(0.0, 0.0, 1)
    assert machine.box("stiffness=0.3,mass=0.1", "x") == Box(0.3, 0.1, 0)


def test_a_search_on_a_model_has_a_box_and_a_rule_has_none() -> None:
    found = tune.run(TuneRequest("linear_motor", filters="kept", starts=1))
    assert found.result.box is not None
    assert found.result.box.holds is True
    assert str(found.result.box.box) == str(Box())
    assert not {AT_THE_MODEL, OF_ERRORS} & set(found.notes)
    assert tune.run(TuneRequest("linear_motor", recipe="kv-rule")).result.box is None
    assert tune.run(TuneRequest("linear_motor", filters="kept", starts=1, box="none")).result.box is None


def test_errors_are_asked_of_the_file_that_holds_them(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"linear_motor.toml states no standard error of a mass or stiffness"):
        tune.run(TuneRequest("linear_motor", box="identified"))
    with pytest.raises(ParameterError, match="--box identified takes the standard errors of a machine file"):
        tune.run(TuneRequest(fd.read_machine("linear_motor").loop("x"), box="identified"))
    with pytest.raises(ParameterError, match="a study varies its machines by what it states"):
        tune.run(TuneRequest(study="ball_screw_series", box="identified"))


@pytest.mark.parametrize(
    ("errors", "message"),
    [
        ('"plant.mas" = 0.8', r"standard_errors: 'plant.mas' is no parameter of the axis; did you mean plant.mass"),
        ('"plant.mass" = 0', r"standard_errors: that of plant.mass = 0.0 must be above 0, in the SI unit of its value"),
        ('"plant.mass" = "much"', r"'plant.mass' must be a number in SI, not 'much': standard errors by path"),
    ],
)
def test_errors_that_cannot_be_are_named(errors: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=message):
        fd.read_machine(with_errors(tmp_path, f"[axis.x.standard_errors]\n{errors}\n"))


def test_without_a_box_the_limits_are_said_to_hold_at_the_model() -> None:
    outcome = tune.run(TuneRequest("linear_motor", recipe="kv-rule"))
    assert AT_THE_MODEL in outcome.notes
    boxed = tune.run(TuneRequest("linear_motor", recipe="kv-rule", box="mass=0.05"))
    assert AT_THE_MODEL not in boxed.notes


TIED = """
[axis.x.standard_errors]
"plant.mass_motor" = 2.0
"plant.mass_load" = 6.0
"plant.stiffness" = 5e6
"plant.damping" = 900.0

[axis.x.correlations]
"plant.stiffness plant.mass_load" = 0.95
"plant.mass_motor plant.stiffness" = 0.3
"""


def tied_file(folder: Path, errors: str = TIED) -> Path:
    path = folder / "two.toml"
    path.write_text(fd.read_machine("machining_center").file.text + errors, encoding="utf-8")
    return path


def test_correlated_errors_of_a_file_make_a_box_along_their_axes(tmp_path: Path) -> None:
    machine = fd.read_machine(tied_file(tmp_path))
    box = machine.box(AUTO, "x")
    assert box is not None
    assert np.array(box.tied) == pytest.approx(np.array([[1.0, 0.0, 0.3], [0.0, 1.0, 0.95], [0.3, 0.95, 1.0]]))
    # its plants are modelled like all others, and those of a tuning are named by their values
    plants = box_plants(box, machine.loop("x"), "model", 0.05)
    assert plants.screen is not None
    corner = max(plants.corners, key=lambda c: sum(c.place))
    assert str(plants.named(corner)) == f"model: {box.named(machine.loop('x').axis, corner)}"
    # a proof takes each parameter on its own, between the same ends
    proof = certify.run(CertifyRequest(tied_file(tmp_path), axis="x", box="identified")).result
    assert proof.proven is True
    assert proof.box.tied == ()
    ends = [dimension.at(1.0) for dimension in box.dimensions(machine.loop("x").axis)]
    assert [dimension.at(1.0) for dimension in proof.dimensions] == ends


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ('"plant.mass_load plant.stif" = 0.9', r"'plant.mass_load plant.stif' must be two different paths of standard"),
        ('"plant.mass_load plant.mass_load" = 0.9', "must be two different paths of standard_errors"),
        ('"plant.mass_load" = 0.9', "must be two different paths of standard_errors"),
        ('"plant.mass_load plant.stiffness" = 1.1', r"= 1.1 must be from -1 to 1"),
        (
            '"plant.mass_load plant.stiffness" = 0.9\n"plant.stiffness plant.mass_load" = 0.8',
            "a pair is stated twice",
        ),
    ],
)
def test_correlations_that_cannot_be_are_named(pair: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=message):
        fd.read_machine(tied_file(tmp_path, f"{TIED.partition('[axis.x.corr')[0]}[axis.x.correlations]\n{pair}\n"))


def test_identify_writes_the_correlations_of_masses_and_stiffness() -> None:
    loop = fd.read_machine("machining_center").loop("x")
    f, random, lines = np.geomspace(5.0, 900.0, 60), np.random.default_rng(3), []
    for name in ("reading_motor", "reading_load"):
        response = fd.linearize(loop, ["cut"], [name]).response(f).response
        size = 0.02 * np.abs(response)
        noise = size * (random.normal(size=f.size) + 1j * random.normal(size=f.size)) / np.sqrt(2.0)
        lines.append(FRF(f, response + noise, "force", name, "m/N", float(loop.sample_time), None, size**2))
    fit = fit_two_mass(*lines)
    written = tomllib.loads(machine_text(fit, None, "x"))["axis"]["x"]
    names = [estimate.name for estimate in fit.estimates]
    i, j = names.index("mass_load"), names.index("stiffness")
    C = fit.covariance
    pairs = {frozenset(pair.split()): value for pair, value in written["correlations"].items()}
    assert pairs[frozenset(("plant.mass_load", "plant.stiffness"))] == pytest.approx(
        C[i, j] / np.sqrt(C[i, i] * C[j, j]), abs=1e-4
    )
    assert set().union(*pairs) == {"plant.mass_motor", "plant.mass_load", "plant.stiffness"}
    assert written["standard_errors"]["plant.stiffness"] == pytest.approx(fit["stiffness"].error, rel=1e-2)


def test_a_box_is_proven_refuted_or_refused(tmp_path: Path) -> None:
    request = CertifyRequest("linear_motor", box="standard", max_ms=2.3, out=tmp_path / "proof")
    proven = certify.run(request)
    assert proven.judgment is Judgment.BOX_PROVEN
    assert proven.verdict == (
        "Proven: the loop is stable and has Ms <= 2.3 at every plant of the box, each constant in time."
    )
    kept = json.loads((tmp_path / "proof" / "box_proof.json").read_text(encoding="utf-8"))
    assert kept["verdict"] == "proven"
    assert "mass 28 to 52 kg" in kept["parameters"]
    assert kept["machine"]["file"] == "linear_motor.toml"
    assert box_check.checked(str(tmp_path / "proof" / "box_proof.json"))[1] is True
    assert "at every plant of the box" in (tmp_path / "proof" / "report.html").read_text(encoding="utf-8")
    refuted = certify.run(CertifyRequest("linear_motor", box="standard", max_ms=1.9))
    assert refuted.judgment is Judgment.BOX_NOT_PROVEN
    assert refuted.failure
    assert str(refuted.verdict).startswith("The box is not proven: at mass -30 %, 1 sample later |S| is ")
    identified = certify.run(CertifyRequest(with_errors(tmp_path), box="identified", max_ms=2.1))
    assert "mass 38.4 to 41.6 kg" in str(identified.result.text)
    for options, message in (
        ({"max_ms": 2.0}, "--max-ms is proven over a box"),
        ({"box": "standard", "radius": 0.1}, "--radius is about discs, and --box proves the plants of a model"),
        ({"box": "standard", "fit": True}, "--fit is about discs"),
    ):
        with pytest.raises(ParameterError, match=message):
            CertifyRequest("linear_motor", **options)  # type: ignore[arg-type]
