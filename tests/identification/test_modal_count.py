"""How many modes there are: counted on closed forms and on a measured stage, none of which says its number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from feeddrive.files.frf import read_frfs
from feeddrive.identification.response.modal_fit import fit_modes
from feeddrive.loop.frequency_response import FRF
from heard import Heard

STAGE = Path(__file__).parents[3] / "shared" / "data" / "tokyo_stage_frf" / "frf.csv"
needs_stage = pytest.mark.skipif(not STAGE.exists(), reason="NOT RUN: tokyo_stage_frf is not in ../shared")
MODES = (30.0, 90.0, 180.0, 300.0, 430.0, 580.0)


def stage(unit: str) -> list[FRF]:
    """Velocity over force at both ends of an axis with friction and six modes, ζ = 0.03; two per cent of noise."""
    rng = np.random.default_rng(0)
    f = np.geomspace(0.1, 1000.0, 300)
    s = 2j * np.pi * f
    found = []
    for end in (1.0, -1.0):
        response = 1.0 / (200.0 * s + 200.0)
        for i, place in enumerate(MODES):
            w = 2.0 * np.pi * place
            response = response + end**i * s / 100.0 / (s * s + 0.06 * w * s + w * w)
        noise = rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)
        response = response * np.exp(-5e-4 * s) * (1.0 + 0.02 / np.sqrt(2.0) * noise)
        found.append(FRF(f, response, "force", f"{end:g}", unit))
    return found


@pytest.mark.parametrize(
    "unit",
    [
        pytest.param("(m/s)/N", id="unit stated"),
        pytest.param("", id="velocity without a unit", marks=pytest.mark.slow(reason="fits of up to nine modes")),
    ],
)
def test_all_modes_are_counted(unit: str) -> None:
    """Taken for a position, the responses lie an order off: one mode more helps little until all are there."""
    heard = Heard()
    fit = fit_modes(stage(unit), progress=heard)
    told = [what for what, *_ in heard.steps]
    # 1 %: twenty times the standard errors of these lines
    assert [mode.frequency.value for mode in fit.modes] == pytest.approx(MODES, rel=0.01)
    assert told[0] == "0 modes"
    assert told[-1].endswith("to the end")


@pytest.mark.slow(reason="a fit of each response of a stage, and one of all")
@needs_stage
def test_all_responses_of_the_stage_have_the_modes_that_one_by_one_have() -> None:
    """Velocities and positions of both encoders in one file, without units.

    Published for the velocities: 30.47, 89.17 and 298.05 Hz; one kind or the other lies an order off, so 2 % are let.
    """
    fit = fit_modes(read_frfs(STAGE))
    found = np.array([mode.frequency.value for mode in fit.modes])
    for published in (30.47, 89.17, 298.05):
        assert np.min(np.abs(found / published - 1.0)) < 0.02
    assert 8.686 * fit.agreement.unused < 4.0  # dB; without any mode 10.4
