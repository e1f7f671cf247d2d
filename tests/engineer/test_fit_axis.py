"""Which structure lines support: by what they predict of lines that were not used."""

from __future__ import annotations

import pytest

from engineer.test_response_fit import SCREW, responses
from feeddrive.engineer.identification.fit_axis import fit_axis
from feeddrive.engineer.identification.two_mass_fit import fit_two_mass
from feeddrive.language.errors import ParameterError


def test_lines_far_below_the_resonance_tell_the_total_mass_alone() -> None:
    motor, _ = responses(SCREW, noise=0.01, variance=True)
    fit = fit_two_mass(motor, band=(5.0, 30.0))
    assert {"mass_load", "stiffness", "resonance"} <= set(fit.not_identifiable)
    assert any("measure next up to" in said for said in fit.remarks)
    found = fit_axis(motor, band=(5.0, 30.0))
    assert found.chosen == "rigid"
    assert found.fit["mass"].value == pytest.approx(163.0, rel=0.05)


def test_the_structure_is_chosen_by_lines_that_were_not_used() -> None:
    motor, load = responses(SCREW, noise=0.01)
    found = fit_axis(motor, load)
    assert found.chosen == "two-mass"
    assert "nothing regular is left" in found.refused["modal"]
    assert found.fits["rigid"].agreement.unused > 10.0 * found.fit.agreement.unused
    with pytest.raises(ParameterError, match="no structure has all of"):
        fit_axis(motor, load, fixed={"mass_motor": 130.0, "frequency": 3.0})
