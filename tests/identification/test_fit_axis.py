"""Which structure lines support: by what they predict of lines that were not used."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.files.machine import read_machine
from feeddrive.identification.regression import Estimate
from feeddrive.identification.response.agreement import (
    Agreement,
    blind,
    entangled,
    lines_above_noise,
    predicted,
)
from feeddrive.identification.response.modal_fit import _best_start, _simplest, fit_modes
from feeddrive.identification.response.plant_fit import (
    AxisFits,
    PlantFit,
    SensorLines,
    Task,
    TracedPlant,
    _aliases,
    _of_grid,
    finished,
    fit_axis,
    fit_two_mass,
    with_derived,
)
from feeddrive.identification.response.refine import (
    Refined,
    ResponseUnits,
    Unknown,
    _determined,
    refine,
    taken,
)
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF
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


# ---------------------------------------------------------------- what decides: a case on either side of each bound


def structure(unused: float, parameters: int, autocorrelation: float) -> Any:
    """A fit as the choice between structures sees it."""
    agreement = SimpleNamespace(unused=unused, autocorrelation=lambda: autocorrelation)
    known = SimpleNamespace(name="mass", value=1.0, error=0.0)
    plant = SimpleNamespace(rigid_mass=lambda: 1.0)
    return SimpleNamespace(agreement=agreement, estimates=[known] * parameters, plant=plant)


def chosen(monkeypatch: pytest.MonkeyPatch, **fits: Any) -> AxisFits:
    ways = {name.replace("_", "-"): partial(lambda fit: fit, fit) for name, fit in fits.items()}
    monkeypatch.setattr("feeddrive.identification.response.plant_fit._ways", lambda *_: ways)
    return fit_axis()


@pytest.mark.parametrize(("worse", "name"), [(1.07, "rigid"), (1.2, "two-mass")])
def test_a_structure_within_a_tenth_of_the_least_error_is_as_good(
    monkeypatch: pytest.MonkeyPatch, worse: float, name: str
) -> None:
    fits = chosen(monkeypatch, rigid=structure(worse, 3, 0.9), two_mass=structure(1.0, 7, 0.9))
    assert fits.chosen == name


@pytest.mark.parametrize(("autocorrelation", "tried"), [(0.2, False), (0.45, True)])
def test_modes_are_tried_where_residuals_are_correlated_by_0_3(
    monkeypatch: pytest.MonkeyPatch, autocorrelation: float, tried: bool
) -> None:
    fits = chosen(monkeypatch, rigid=structure(1.0, 3, autocorrelation), modal=structure(1.0, 9, 0.0))
    assert ("modal" in fits.fits) is tried


LINES = np.geomspace(10.0, 100.0, 40)
FLAT = FRF(LINES, np.ones(40) + 0j)


def agreeing(residual: np.ndarray) -> Agreement:
    return Agreement((FLAT,), (FLAT,), (residual,), 0.1, 0.1, 1.0, 0.0, ())


@pytest.mark.parametrize(("correlation", "systematic"), [(0.4, False), (0.7, True)])
def test_residuals_correlated_by_a_half_are_systematic(correlation: float, systematic: bool) -> None:
    """A rotating residual e^(jφk) has the correlation cos φ from line to line."""
    found = agreeing(np.exp(1j * np.arccos(correlation) * np.arange(40)))
    assert found.autocorrelation() == pytest.approx(correlation, abs=0.03)
    assert any("the model lacks a systematic part" in remark for remark in found.remarks()) is systematic


def undetermined(correlation: float, error: float = 1.0) -> tuple[list[Estimate], Refined]:
    """Two parameters of value 1 whose effects have a correlation: singular values √(1 ± r) of unit columns."""
    slopes = np.array([[1.0, correlation], [0.0, np.sqrt(1.0 - correlation**2)]])
    none = np.zeros((2, 2))
    refined = Refined(np.ones(2), none, none, slopes, (), 1.0, 0.0, np.zeros(2, bool), True)
    return [Estimate(name, 1.0, "", error, error) for name in ("mass_motor", "mass_load")], refined


@pytest.mark.parametrize(("correlation", "tied"), [(0.993, False), (0.997, True)])
def test_parameters_correlated_by_0_995_are_one_combination(correlation: float, tied: bool) -> None:
    assert bool(entangled(["mass_motor", "mass_load"], undetermined(correlation)[1])) is tied


@pytest.mark.parametrize(
    ("share", "error", "gone"), [(0.007, 0.5, 2), (0.014, 0.5, 0), (0.005, 0.07, 0), (0.005, 0.14, 2)]
)
def test_parameters_apart_by_a_hundredth_with_an_error_of_a_tenth_are_not_identifiable(
    share: float, error: float, gone: int
) -> None:
    assert len(blind(*undetermined(1.0 - share**2, error))) == gone


@pytest.mark.parametrize(("deviation", "above"), [(0.2, 40), (0.45, 20)])
def test_lines_with_a_deviation_of_0_3_are_noise(deviation: float, above: int) -> None:
    variance = np.where(np.arange(40) < 20, 0.01**2, deviation**2)
    assert np.count_nonzero(lines_above_noise(replace(FLAT, variance=variance))) == above


def test_a_line_in_noise_that_looks_certain_by_chance_is_noise() -> None:
    """Its variance is that of few averages; the lines around it say what it is."""
    variance = np.where(np.arange(40) < 20, 0.01**2, 1.0)
    variance[[25, 32]] = 0.1**2
    assert np.flatnonzero(lines_above_noise(replace(FLAT, variance=variance))).tolist() == [*range(20)]


@pytest.mark.parametrize(("lines", "enough"), [(6, False), (12, True)])
def test_a_fit_has_eight_lines(lines: int, enough: bool) -> None:
    short = replace(FLAT, frequency=LINES[:lines], response=FLAT.response[:lines], unit="m/N")
    if enough:
        assert taken({"motor": short}, None, None, None)[0]["motor"].frequency.size == lines
        return
    with pytest.raises(ParameterError, match="needs 8 at least"):
        taken({"motor": short}, None, None, None)


@pytest.mark.parametrize(("better", "modes"), [(0.95, 0), (0.85, 1)])
def test_a_mode_lowers_the_error_by_a_tenth(better: float, modes: int) -> None:
    """Two modes that lower it by as much once would have to do so twice."""
    candidates: list[Any] = [(1.0, 0, None, None), (better, 1, None, None), (0.99 * better, 2, None, None)]
    assert _simplest(candidates)[1] == modes


@pytest.mark.parametrize(("modes", "said"), [(30, "do not hold 30 resonances"), (60, "must be >= 0 and <= 40")])
def test_forty_modes_may_be_asked_for(modes: int, said: str) -> None:
    with pytest.raises(ParameterError, match=said):
        fit_modes(replace(FLAT, unit="m/N"), modes)


@pytest.mark.parametrize(("error", "known"), [(0.35, True), (0.7, False)])
def test_a_value_with_an_error_of_a_half_is_not_identifiable(error: float, known: bool) -> None:
    units = ResponseUnits("m", "N", 0)
    mass = Estimate("mass", 10.0, "kg", 10.0 * error, 10.0 * error)
    fit = PlantFit(
        Rigid(mass=10.0), Actuator(), (mass,), np.array([[(10.0 * error) ** 2]]), (), {}, agreeing(LINES), units, ()
    )
    assert ("total" not in with_derived(fit, [("total", "kg", lambda plant: plant.mass)]).not_identifiable) is known


def test_unused_lines_are_every_fifth(monkeypatch: pytest.MonkeyPatch) -> None:
    left_out: list[np.ndarray] = []

    def refined(*_: Any, use: list[np.ndarray], **__: Any) -> Any:
        left_out.append(np.flatnonzero(~use[0]))
        return SimpleNamespace(values=np.ones(1))

    monkeypatch.setattr("feeddrive.identification.response.agreement.refine", refined)
    model: Any = lambda _: [(FLAT.response, np.ones((40, 1)))]  # noqa: E731
    start: Any = SimpleNamespace(values=np.ones(1), model_error=0.0)
    predicted(model, (), (FLAT,), start)
    assert [lines.tolist() for lines in left_out] == [list(range(fold, 40, 5)) for fold in range(5)]


def counted(monkeypatch: pytest.MonkeyPatch, *errors: float) -> int:
    """The number of modes that is taken when each further mode has such an error."""
    module = "feeddrive.identification.response.modal_fit"
    many = FRF(np.geomspace(1.0, 100.0, 400), np.ones(400) + 0j, unit="m/N")
    start: Any = SimpleNamespace(values=None)
    monkeypatch.setattr(f"{module}._best_start", lambda model, *_: (errors[model.modes], [], start))
    monkeypatch.setattr(f"{module}.refine", lambda *_, **__: None)
    monkeypatch.setattr(f"{module}._result", lambda model, *_: model.modes)
    modes: Any = fit_modes(many)
    return modes


def test_eight_modes_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    assert counted(monkeypatch, *(0.5**k for k in range(20))) == 8


@pytest.mark.parametrize(("at", "modes"), [(2, 2), (3, 3), (4, 0)])
def test_three_modes_beyond_the_best_are_tried(monkeypatch: pytest.MonkeyPatch, at: int, modes: int) -> None:
    errors = [0.05, 0.049, 0.049, 0.049, 0.049, *([0.049] * 10)]
    errors[at:] = [1e-3] * (len(errors) - at)
    assert counted(monkeypatch, *errors) == modes


@pytest.mark.parametrize(("error", "modes"), [(0.07, 0), (0.15, 5)])
def test_a_fit_that_is_wrong_by_a_tenth_is_tried_with_more_modes(
    monkeypatch: pytest.MonkeyPatch, error: float, modes: int
) -> None:
    assert counted(monkeypatch, *[error] * 5, *[1e-3] * 5) == modes


@pytest.mark.parametrize(("best", "followed"), [(2, True), (3, False)])
def test_three_starts_are_followed(monkeypatch: pytest.MonkeyPatch, best: int, followed: bool) -> None:
    """Of six starts, ranked by their error, one would end in a far better minimum than the others."""
    module = "feeddrive.identification.response.modal_fit"
    ranks = iter(range(6))
    monkeypatch.setattr(f"{module}.initial", lambda *_: (rank := next(ranks), np.array([rank])))
    monkeypatch.setattr(f"{module}.unknowns", lambda *call: [SimpleNamespace(rank=call[1][0])])
    monkeypatch.setattr(f"{module}._settled", lambda parameter, *_: parameter)
    monkeypatch.setattr(
        f"{module}.refine", lambda _, sought, *__, **___: SimpleNamespace(
            residuals=[np.array([0.1 if sought[0].rank == best else 0.9])]
        )
    )  # fmt: skip
    model: Any = SimpleNamespace(modes=1)
    poles: Any = SimpleNamespace(most=lambda *_: np.ones(1))
    found = _best_start(model, [FLAT], ("",), ResponseUnits("m", "N", 0), None, poles)
    assert found is not None
    assert bool(found[0] < 0.5) is followed


@pytest.mark.parametrize(("times", "ideal"), [(14.0, False), (28.0, True)])
def test_a_current_loop_twenty_times_beyond_the_lines_is_ideal(
    monkeypatch: pytest.MonkeyPatch, times: float, ideal: bool
) -> None:
    module = "feeddrive.identification.response.plant_fit"
    empty = np.zeros((0, 0))

    def refined(names: list[str]) -> Refined:
        n = len(names)
        return Refined(np.ones(n), empty, empty, np.zeros((40, n)), (), 1.0, 0.0, np.zeros(n, bool), True)

    monkeypatch.setattr(f"{module}.solve", lambda task, names, **_: (task, refined(names)))
    monkeypatch.setattr(f"{module}._covariance", lambda *call: (1e6 * np.eye(len(call[1])),) * 2)
    monkeypatch.setattr(f"{module}.agreement", lambda *_: agreeing(np.ones(40)))
    task = Task(Rigid(mass=10.0), Actuator(current_loop=times * 100.0), {}, {"motor": FLAT}, ResponseUnits("m", "N", 0))
    assert (finished(task, ["current_loop"]).actuator.current_loop is None) is ideal


def test_a_resonance_is_sought_up_to_four_times_beyond_the_lines() -> None:
    def highest(times: float) -> float:
        """Of the best starts for lines that end at a part of the resonance."""
        frequency = np.geomspace(10.0, 100.0, 40)
        plant = tree.vary(SCREW, {"damping": 0.0})
        scale = (times * 100.0 * 2.0 * np.pi) ** 2 / (1.0 / plant.mass_motor + 1.0 / plant.mass_load)
        plant = tree.vary(plant, {"stiffness": scale})
        lines = [SensorLines(frequency, "motor")]
        response = FRF(frequency, TracedPlant(plant, (), lines, {}).responses({})[0])
        starts = _of_grid({"motor": response}, ResponseUnits("m", "N", 0))
        return max(
            float(np.sqrt(p.stiffness * (1.0 / p.mass_motor + 1.0 / p.mass_load))) / (2.0 * np.pi) for p in starts
        )

    assert highest(3.5) > 250.0
    assert highest(8.0) == pytest.approx(400.0)


def test_aliases_below_3e_5_are_left_out() -> None:
    """The next alias m of a held mass is (f/(m f_s - f))³ of the line."""
    for share in np.linspace(0.005, 0.2, 79):
        most = _aliases(np.array([share]), 1.0)
        if most < 4:
            assert (share / (most + 1.0 - share)) ** 3 < 3e-5
        if most > 1:
            assert (share / (most - share)) ** 3 >= 3e-5


@pytest.mark.parametrize(("error", "determined"), [(0.7, True), (1.4, False)])
def test_a_logarithm_with_an_error_of_less_than_1_is_determined(error: float, determined: bool) -> None:
    directions = _determined(np.array([[1.0 / error**2]]), np.array([True]), 1.0)
    assert bool(directions.shape[1]) is determined


def test_lines_two_standard_deviations_off_are_bounded() -> None:
    """The mean of ±1 and of one line at 30: Σ r/√(1 + (r/2s)²) is 0, s the deviation by the median of all parts."""
    frequency = np.arange(1.0, 42.0)
    data = 10.0 + np.where(np.arange(41) % 2 == 0, 1.0, -1.0) * (1.0 + 1.0j)
    data[20] = 40.0 + 1.0j
    model: Any = lambda values: [(values[0] + np.zeros(41, complex), np.ones((41, 1), complex))]  # noqa: E731
    found = refine(model, [Unknown("level", "", 9.0)], [FRF(frequency, data, variance=4.0 * np.ones(41))])
    apart = data - found.values[0]
    spread = 1.4826 * float(np.median(np.abs(np.concatenate([apart.real, apart.imag]))))

    def pull(far: float) -> float:
        return float(np.sum(apart.real / np.sqrt(1.0 + (apart.real / far) ** 2)))

    assert abs(pull(2.0 * spread)) < 0.05 * min(abs(pull(spread)), abs(pull(4.0 * spread)))
