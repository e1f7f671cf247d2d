"""The screen of plants of a box: against the responses of each plant, and the examination of each on its own."""

from __future__ import annotations

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.figures.figure import Limit
from feeddrive.figures.of_loops import DELAY_MARGIN, FORCE_NOISE, SENSITIVITY_PEAK
from feeddrive.loop.box import Box, Corner
from feeddrive.loop.loop import Loop
from feeddrive.tuning.closed_loop import grows
from feeddrive.tuning.criteria import Limits
from feeddrive.tuning.sampled_plants import SampledPlants
from feeddrive.tuning.screen import Screen, ScreenedPlants, can_screen
from feeddrive.tuning.worst import Examination, box_plants

LIMITS = Limits(
    [Limit(SENSITIVITY_PEAK, 2.0), Limit(DELAY_MARGIN, 2.0), Limit(FORCE_NOISE, 1e-4)], reading_noise=(1e-9, 1e-9)
)
MACHINES = ("ball_screw", "machining_center", "linear_motor", "rotary_table")


def loop_of(machine: str) -> Loop:
    return next(iter(fd.read_machine(machine).loops.values()))


@pytest.mark.parametrize("machine", MACHINES)
def test_responses_are_those_of_each_plant_alone(machine: str) -> None:
    """From polynomials in z - 1 for all plants, and from the Schur form of each."""
    loop, box = loop_of(machine), Box(0.2, 0.3, 2)
    sampled = SampledPlants(box, loop)
    corners = list(box.drawn(loop.axis, 6, 3))
    f = 0.5 / sampled.T * np.geomspace(1e-4, 0.999, 80)
    places, late = np.array([c.place for c in corners]), np.array([c.late for c in corners])
    found = sampled.held(places).at(np.tile(f, (len(corners), 1)), late)
    for corner, response in zip(corners, found, strict=True):
        model = sampled.model(corner)
        for i, reading in enumerate(("reading_motor", "reading_load")):
            true = model.response(f, reading, "cut").response
            # 1e-7: at the lowest line z - 1 is 3e-4, and the coefficients of its powers are known to 1e-16
            assert np.all(np.abs(response[i] - true) < 1e-7 * np.max(np.abs(found[:, :, :]), axis=(0, 1)))


@pytest.mark.parametrize("machine", MACHINES)
def test_a_screen_finds_what_an_examination_finds(machine: str) -> None:
    loop, box = loop_of(machine), Box(0.1, 0.15, 1)
    plants = box_plants(box, loop, "model", 0.05)
    examination = Examination(loop.control, float(loop.sample_time), LIMITS, 0.05)
    assert plants.screen is not None
    assert examination.matrix is not None
    corners = plants.screened.corners[::3]
    some = plants.screen.plants(corners)
    unstable = plants.screen.unstable(some, examination.matrix)
    used = plants.screen.used(some, examination.response, examination.matrix, LIMITS).used
    for i, plant in enumerate(examination.at(plants, corners)):
        assert unstable[i] == (not np.isfinite(plant.used))
        for key, sizes in used.items():
            # below 0.6 limits are not examined; 2 %: Ms of a sharp peak between lines, which is found on its side
            if not unstable[i] and 0.6 < plant.of(key) < 1.5:
                assert sizes[i] == pytest.approx(plant.of(key), rel=0.02), (key, plant.name)


def test_each_place_of_a_limit_is_one_of_the_plant() -> None:
    """Peaks of |S| against those on dense lines, crossovers where |L| is 1; the largest is that of the plant."""
    loop = loop_of("machining_center")
    plants = box_plants(Box(0.1, 0.15, 1), loop, "model", 0.05)
    examination = Examination(loop.control, float(loop.sample_time), LIMITS, 0.05)
    screen, matrix = plants.screen, examination.matrix
    assert screen is not None
    assert matrix is not None
    some = screen.plants(plants.corners)
    given = some, examination.response, matrix, LIMITS
    whole = screen.used(*given)
    places = {limit.figure.key: found for limit, found in screen.each_place(*given)}
    assert set(places) == set(whole.used)
    for key, found in places.items():
        assert np.array_equal(found.largest(len(plants.corners)), whole.used[key])
    f = np.geomspace(1.0, 0.499 / screen.T, 20_000)
    several = 0
    for i, corner in enumerate(plants.corners):
        response = screen.sampled.held(np.array([corner.place])).at(f[None], np.array([corner.late]))[0]
        C = examination.response.of_model(matrix, f).value
        L = -(C[0] * response[0] + C[1] * response[1])
        size = 1.0 / np.abs(1.0 + L)
        for key, y in ((SENSITIVITY_PEAK.key, size / 2.0), (DELAY_MARGIN.key, np.abs(L))):
            if key == SENSITIVITY_PEAK.key:
                true = f[1:-1][(size[1:-1] > size[:-2]) & (size[1:-1] > size[2:]) & (size[1:-1] > 1.05)]
            else:
                true = f[:-1][(y[:-1] - 1.0) * (y[1:] - 1.0) < 0.0]
            there = places[key].frequency[places[key].plant == i]
            several += true.size > 1
            for place in true:
                # a line of the screen is at most 3 % away
                assert np.min(np.abs(np.log(there / place))) < 0.03
    assert several > 10


def test_instability_is_that_of_one_loop_at_a_time() -> None:
    loop = loop_of("ball_screw")
    plants = box_plants(Box(), loop, "model", 0.05)
    examination = Examination(loop.control, float(loop.sample_time), Limits(), 0.05)
    assert plants.screen is not None
    assert examination.matrix is not None
    unstable = plants.screen.unstable(plants.screened, examination.matrix)
    assert 0 < np.count_nonzero(unstable) < len(unstable)
    sampled = SampledPlants(Box(), loop)
    for corner, bad in list(zip(plants.screened.corners, unstable, strict=True))[::5]:
        assert bad == grows(sampled.model(corner), examination.matrix[None])


def test_a_screen_stays_on_the_lines_of_a_plant() -> None:
    """Around a frequency only: the same Ms where its peak lies there."""
    loop = loop_of("machining_center")
    box = Box(0.1, 0.15, 1)
    screen = Screen(SampledPlants(box, loop))
    examination = Examination(loop.control, float(loop.sample_time), LIMITS, 0.05)
    assert examination.matrix is not None
    corners = [Corner((1.0, -1.0, 0.5)[: len(box.dimensions(loop.axis))], 1)]
    whole = screen.used(screen.plants(corners), examination.response, examination.matrix, LIMITS)
    key = SENSITIVITY_PEAK.key
    beside = screen.used(
        screen.beside(corners, whole.where[key]), examination.response, examination.matrix, LIMITS.only(key)
    )
    assert beside.used[key] == pytest.approx(whole.used[key], rel=2e-3)


def test_what_cannot_be_screened_is_examined_plant_by_plant() -> None:
    loop = loop_of("linear_motor")
    examination = Examination(loop.control, float(loop.sample_time), LIMITS, 0.05)
    assert can_screen(examination.response, LIMITS)
    other = Limits(gain_margin_dB=6.0)
    assert not can_screen(examination.response, other)
    assert Examination(loop.control, float(loop.sample_time), other, 0.05).matrix is None


def test_a_look_that_the_first_limit_rules_out_asks_for_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = loop_of("linear_motor")
    plants = box_plants(Box(), loop, "model", 0.05)
    examination = Examination(loop.control, float(loop.sample_time), LIMITS, 0.05)
    assert plants.screen is not None
    assert examination.matrix is not None
    screened = ScreenedPlants(plants.screen, plants.corners)
    whole = list(screened.bounds(examination.response, examination.matrix, LIMITS))
    assert [bound.figure for bound in whole] == [limit.figure for limit in LIMITS.limits]
    monkeypatch.setattr(Screen, "_delay", None)  # of the second limit
    first = next(iter(screened.bounds(examination.response, examination.matrix, LIMITS)))
    assert (first.key, first.slack) == (whole[0].key, whole[0].slack)
