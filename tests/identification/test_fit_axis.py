"""Which structure lines support: by what they predict of lines that were not used."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.files.machine import read_machine
from feeddrive.identification.response.plant_fit import fit_axis, fit_two_mass
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from screw_responses import SCREW, responses


@pytest.mark.slow(reason="what no line tells is searched for long; the command asks it once, quickly")
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
    assert "no systematic residual is left" in found.refused["modal"]
    assert found.fits["rigid"].agreement.unused > 10.0 * found.fit.agreement.unused
    with pytest.raises(ParameterError, match="no structure has all of"):
        fit_axis(motor, load, fixed={"mass_motor": 130.0, "frequency": 3.0})


@pytest.mark.parametrize("seed", range(2))
def test_friction_that_no_line_tells_keeps_the_value_of_the_machine(seed: int) -> None:
    """At zero it would bend the masses that hang together with it by far more than their errors.

    Lines up to 700 Hz tell the split of rotor and screw by a thousandth of what each of them does.
    """
    axis = read_machine("ball_screw").loop("x").axis
    motor, load = responses(axis.plant, np.geomspace(5.0, 700.0, 300), noise=0.001, seed=seed)
    start = tree.vary(axis.plant, {"mass_motor": 75.0, "mass_load": 36.0})
    fit = fit_axis(motor, load, plant=start, actuator=axis.actuator, structure="machine").fit
    assert "viscous_motor" in fit.not_identifiable
    assert tree.get(fit.plant, "viscous_motor") == axis.plant.viscous_motor
    assert "mass_screw" in fit.not_identifiable
    for name in ("mass_motor", "mass_screw", "mass_load", "coupling_stiffness", "stiffness"):
        assert abs(fit[name].value - tree.get(axis.plant, name)) < 3.0 * fit[name].error, name
