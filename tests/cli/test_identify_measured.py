"""`feeddrive frf` and `feeddrive identify` on measured axes, with their files as they are published."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from feeddrive.cli.commands import app
from feeddrive.files.frf import read_frfs, write_frf
from feeddrive.workflow.identify import identify

DATA = Path(__file__).parents[3] / "shared" / "data"
BENCH = DATA / "tokyo_motor_bench"
STAGE = DATA / "tokyo_stage_frf" / "frf.csv"
needs_bench = pytest.mark.skipif(not BENCH.exists(), reason="NOT RUN: tokyo_motor_bench is not in ../shared")
needs_stage = pytest.mark.skipif(not STAGE.exists(), reason="NOT RUN: tokyo_stage_frf is not in ../shared")

runner = CliRunner()


def called(*asked: str, code: int = 0) -> str:
    done = runner.invoke(app, list(asked), catch_exceptions=False)
    assert done.exit_code == code, done.output
    return done.output


def value(output: str, name: str) -> float:
    """The first number after the unit in the row of a parameter."""
    row = next(line for line in output.splitlines() if line.strip().startswith(name))
    return float(re.findall(r"-?\d+\.?\d*(?:e[+-]?\d+)?", row.replace("s2", ""))[0])


def check_bench(output: str) -> None:
    """Published: antiresonance 53.95 Hz, resonance 76.21 Hz, ratio of the inertias 0.995."""
    assert re.search(r"two-mass .* taken", output)
    assert value(output, "antiresonance") == pytest.approx(53.95, rel=0.002)
    assert value(output, "resonance") == pytest.approx(76.21, rel=0.002)
    assert value(output, "inertia_ratio") == pytest.approx(0.995, rel=0.01)


@needs_bench
def test_from_the_log_of_a_bench_to_its_two_inertias(tmp_path: Path) -> None:
    columns = ["--input", "iq_adx:A", "--output", "theta_mx:rad", "--output", "theta_my*-1:rad"]
    shown = called(
        "frf", str(BENCH / "MultisineTypeA.mat"), *columns, "--band", "11..250", "--out", str(tmp_path / "frf")
    )
    assert "Noise of the mean, scatter beyond noise, odd and even distortion" in shown
    page = (tmp_path / "frf" / "report.html").read_text(encoding="utf-8")
    for said in ('noise <span class="unit">%</span>', 'odd <span class="unit">%</span>', "coherence"):
        assert said in page
    found = str(tmp_path / "frf" / "frf.csv")
    shown = called(
        "identify",
        found,
        "--verbose",
        "--motor",
        "theta_mx",
        "--load",
        "theta_my",
        "--measured-input",
        "--out",
        str(tmp_path / "o"),
    )
    check_bench(shown)
    page = (tmp_path / "o" / "report.html").read_text(encoding="utf-8")
    for figure in ("figure-fit", "figure-residual", "figure-nyquist"):
        assert figure in page
    assert "95 % band" in page
    assert not (tmp_path / "o" / "machine.toml").exists()  # in A and rad; no constants were given


@needs_bench
@pytest.mark.slow(reason="three fits of a measured bench")
def test_errors_of_the_bench_hold_what_even_and_odd_lines_say_apart(tmp_path: Path) -> None:
    """Half of the difference of both halves is one draw of the error of all: twice the stated one at most."""
    whole = read_frfs(BENCH / "frf_typeA.csv")

    def found(name: str, rest: int | None) -> dict[str, tuple[float, float]]:
        path = tmp_path / f"{name}.csv"
        odd = np.round(next(iter(whole.values())).frequency).astype(int) % 2
        kept = np.ones(odd.size, bool) if rest is None else odd == rest
        write_frf(path, *(replace(g, frequency=g.frequency[kept], response=g.response[kept]) for g in whole.values()))
        fit = identify(path, motor="Gm", load="Gl", unit=("rad/A",), model="two-mass").fit
        return {row[0]: (row[2].value, row[3].value) for row in fit.table().rows if "resonance" in row[0]}

    both, odd, even = found("both", None), found("odd", 1), found("even", 0)
    assert both.keys() == {"resonance", "antiresonance"}
    for name, (_, error) in both.items():
        assert 0.5 * abs(odd[name][0] - even[name][0]) < 2.0 * error
        assert error > 0.03  # Hz: 0.0059 Hz was stated once


@needs_bench
def test_the_averaged_response_of_the_bench_as_it_is_published(tmp_path: Path) -> None:
    asked = ["--verbose", "--motor", "Gm", "--load", "Gl", "--unit", "rad/A", "--force-constant", "2", "--lead", "0.01"]
    shown = called("identify", str(BENCH / "frf_typeA.csv"), *asked, "--out", str(tmp_path))
    check_bench(shown)
    assert (tmp_path / "machine.toml").exists()


@needs_stage
@pytest.mark.parametrize(
    "band",
    [
        pytest.param(("--band", "10..400"), id="to 400 Hz"),
        pytest.param((), id="all lines", marks=pytest.mark.slow(reason="the fit has a quick test; the command, above")),
    ],
)
def test_modes_of_a_stage(tmp_path: Path, band: tuple[str, ...]) -> None:
    """Published: 30.47, 89.17 and 298.05 Hz with damping ratios of 0.0285, 0.0405 and 0.07."""
    asked = ["--motor", "Pv1", "--load", "Pv2", "--unit", "(m/s)/N", "--model", "modes", *band]
    shown = called("identify", str(STAGE), *asked, "--out", str(tmp_path), code=0 if band else 1)
    assert ("Use this model" in shown) == bool(band)  # all lines hold resonances of the foundation, too
    rows = [line.split() for line in shown.splitlines() if re.match(r"^ [123] +\d", line)]
    for row, f, ratio in zip(rows, (30.47, 89.17, 298.05), (0.0285, 0.0405, 0.07), strict=True):
        assert float(row[1]) == pytest.approx(f, rel=0.01)
        assert float(row[3]) == pytest.approx(ratio, rel=0.15)


@needs_stage
@pytest.mark.slow(reason="the fit that says so has a quick test; two masses are searched long where none fit")
def test_a_stage_that_is_driven_elsewhere_gets_no_machine(tmp_path: Path) -> None:
    asked = ["--motor", "Pv1", "--load", "Pv2", "--unit", "(m/s)/N", "--band", "10..400"]
    shown = called("identify", str(STAGE), *asked, "--out", str(tmp_path), code=1)
    assert "Do not use this model" in shown
    assert "--model modes" in " ".join(shown.split())
    assert not (tmp_path / "machine.toml").exists()
