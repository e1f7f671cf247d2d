"""Contour error: the nearest point of the path, against closed forms and against loops that ran."""

from __future__ import annotations

import numpy as np
import pytest

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.reference.recorded import Recorded
from feeddrive.language.errors import ParameterError
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.machining.contour import ContourError, Curve, contour_error, curve_through, feet
from machining.circles import axis, circle, response, smooth_xy_table

UM = 1e-6
R, V, KV = 0.02, 0.1, 40.0


def displaced(path: np.ndarray, row: int, e: tuple[float, float]) -> np.ndarray:
    """On the path but for one row, which lacks e (µm)."""
    found = path.copy()
    found[row] -= UM * np.array(e)
    return found


def test_the_foot_on_an_ellipse() -> None:
    u = np.linspace(-0.2, 2.2, 2401)
    path = np.column_stack([0.03 * np.cos(u), 0.02 * np.sin(u)])
    speed = np.column_stack([-0.03 * np.sin(u), 0.02 * np.cos(u)])
    row = 900
    assert u[row] == pytest.approx(0.7, abs=1e-12)
    found = contour_error(displaced(path, row, (20, -35)), path, velocity=speed, acceleration=-path)
    foot = found.position[row] - found.vector[row]
    # the golden numbers, to their last digits
    assert np.arctan2(foot[1] / 0.02, foot[0] / 0.03) == pytest.approx(0.7015161636, abs=2e-10)
    assert found.error[row] / UM == pytest.approx(-15.0594989832, abs=2e-10)
    assert found.estimate is not None
    assert found.estimate[row] / UM == pytest.approx(-15.0595330772, abs=2e-10)
    # tangents from set positions alone: a chord of 30 um between curvatures that change
    rough = contour_error(displaced(path, row, (20, -35)), path)
    assert rough.error[row] == pytest.approx(found.error[row], abs=1e-13)
    assert rough.estimate is None
    # a sample on the path has no error, and only one sample is off it
    assert np.max(np.abs(np.delete(found.error, row))) < 1e-17


def test_second_order_on_a_circle() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 3601)
    path = R * np.column_stack([np.cos(angle), np.sin(angle)])
    speed = R * np.column_stack([-np.sin(angle), np.cos(angle)])
    found = contour_error(displaced(path, 300, (30, 10)), path, velocity=speed, acceleration=-path)
    assert found.estimate is not None
    assert -found.error[300] / UM == pytest.approx(-30.9797557452, abs=1e-10)
    assert -found.estimate[300] / UM == pytest.approx(-30.9797573041, abs=1e-10)
    clockwise = contour_error(displaced(path, 300, (30, 10))[::-1], path[::-1])
    assert clockwise.error[::-1][300] / UM == pytest.approx(-30.9797557452, abs=1e-9)  # outside is now left


def test_arcs_between_set_positions() -> None:
    """The rule that the docstring states: R δ⁶/1000."""
    for step in (0.3, 0.1):
        angle = np.arange(0.0, 6.0, step)
        curve = curve_through(R * np.column_stack([np.cos(angle), np.sin(angle)]))
        between = angle[:-1] + 0.5 * step
        outside = 1.001 * R * np.column_stack([np.cos(between), np.sin(between)])
        distance = np.linalg.norm(feet(curve, outside, None, 1.0).vector, axis=1)
        assert np.max(np.abs(distance - 0.001 * R)) < 1e-3 * R * step**6


@pytest.mark.parametrize(
    ("dead_time", "share", "T", "golden"),
    [
        (0.0, 0.0, None, -152.3525165885),
        (0.0, 0.5, None, -113.6253627226),
        (0.0, 1.0, None, 2.1062135790),
        (0.0, 0.0, 2.5e-4, -153.8793480402),
        (0.0, 0.5, 2.5e-4, -114.3814641803),
        (0.0, 1.0, 2.5e-4, 2.1059257832),
        (3.75e-4, 0.0, 2.5e-4, -153.8832564282),
        (3.75e-4, 1.0, 2.5e-4, 2.1019866763),
        (0.0, 1.0, 1e-4, 2.1060984767),
    ],
)
def test_a_circle_under_p_pi_has_the_radius_of_the_closed_form(
    dead_time: float, share: float, T: float | None, golden: float
) -> None:
    closed = response(V / R, T, share, dead_time)
    assert 1e6 * R * (abs(closed) - 1.0) == pytest.approx(golden, abs=2e-9)
    if T is None:
        return
    loop = axis(T, share, actuator=Actuator(dead_time=dead_time))
    run = simulate(Machine.of({"x": loop, "y": loop}), circle(R, V))
    settled = (run.time > 1.4) & (run.time < 2.4)  # at the feed; the transient of e^(-40 t) is below 1e-15 m
    reached = (run["x.position_load"] + 1j * run["y.position_load"])[settled]
    wanted = (run["x.set_position"] + 1j * run["y.set_position"])[settled]
    assert np.max(np.abs(reached - closed * wanted)) < 1e-14  # m
    found = contour_error(run)
    assert found.error[settled] == pytest.approx(-R * (abs(closed) - 1.0), abs=1e-13)
    # + leads; the path length of the foot point is behind the set position by the lag
    assert found.lag[settled] == pytest.approx(-R * np.angle(closed), abs=1e-12)
    assert found.estimate is not None
    e_n, e_t = R * (1.0 - closed.real), R * closed.imag  # the estimate leaves these, micrometers at a lag of 2.5 mm
    left_over = e_t**4 / (8.0 * R**3) + e_n * e_t**2 / (2.0 * R**2) + 1e-12
    assert found.estimate[settled] == pytest.approx(found.error[settled], abs=left_over)


def test_the_bundled_table_within_a_tenth_of_a_micrometer() -> None:
    """Dead time, a guard, substeps and unequal axes: each axis has the response of its own traced loop."""
    from feeddrive.loop.linearize import tracking

    machine = smooth_xy_table()
    run = simulate(machine, circle(R, V))
    settled = (run.time > 1.4) & (run.time < 2.4)
    both = [complex(tracking(loop, np.array([V / R / (2 * np.pi)])).response[0]) for loop in machine.loops().values()]
    found = contour_error(run)
    angle = np.unwrap(np.arctan2(run["y.set_position"], run["x.set_position"]))[settled]
    outward = 0.5 * R * (abs(both[0]) + abs(both[1]) - 2.0) + 0.5 * R * (abs(both[0]) - abs(both[1])) * np.cos(
        2 * angle
    )
    lags = -np.angle(both)
    outward += 0.5 * R * (lags[0] - lags[1]) * np.sin(2.0 * angle)
    assert -found.error[settled] == pytest.approx(outward, abs=1e-8)  # products of two small numbers; the bar is 0.1 um


def p_loops(direction: int, angle: np.ndarray, rates: tuple[float, float]) -> np.ndarray:
    """Positions of two ideal P loops on the circle when the set angle is this one."""
    w = direction * V / R
    x, y = (1.0 / (1.0 + 1j * w / rate) for rate in rates)
    return R * np.column_stack([(np.exp(1j * angle) * x).real, (np.exp(1j * angle) * y).imag])


def test_unequal_gains_draw_an_ellipse() -> None:
    angle = np.linspace(-1.0, 2.0 * np.pi, 20_001)
    path = R * np.column_stack([np.cos(angle), np.sin(angle)])
    found = contour_error(p_loops(1, angle, (40.0, 38.0)), path)
    whole = slice(10_000, None)
    outward = -found.error[whole] / UM
    assert np.max(outward) == pytest.approx(-98.0585920477, abs=4e-6)  # um: between two samples the peak falls by 2e-6
    assert np.min(outward) == pytest.approx(-227.5057187897, abs=4e-6)
    foot = (found.position - found.vector)[whole][np.argmax(outward)]
    assert np.degrees(np.arctan2(foot[1], foot[0])) % 180.0 == pytest.approx(138.6552569979, abs=0.01)


def corner(turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Set and actual positions of ideal P loops around a corner at constant feed, from rest."""
    t = np.arange(-20_000, 20_000) * 5e-5
    legs = np.array([[1.0, 0.0], [np.cos(turn), np.sin(turn)]])
    path = V * np.where(t[:, None] < 0, t[:, None] * legs[0], t[:, None] * legs[1])
    left = np.exp(-KV * np.maximum(t, 0.0))[:, None]
    begun = -np.expm1(-KV * (t + 1.0))[:, None]  # from rest: 1 - e^-40 of the lag at the corner
    return path, path - V / KV * (left * begun * legs[0] + (1.0 - left) * legs[1])


@pytest.mark.parametrize(
    ("degrees", "nearest"),
    [(30, 0.1899706023), (60, 0.3643051285), (90, 0.5088630062), (120, 0.6132527787), (150, 0.6737797421)],
)
def test_corners_of_p_loops(degrees: int, nearest: float) -> None:
    turn = np.radians(degrees)
    path, actual = corner(turn)
    found = contour_error(actual, path, sample_time=5e-5)
    assert found.largest == pytest.approx(V / KV * np.sin(turn) / np.e, rel=1e-6)  # between two samples
    (passed,) = found.corners()
    assert passed.turn == pytest.approx(turn, abs=1e-9)
    assert passed.nearest == pytest.approx(V / KV * nearest, rel=1e-6)
    assert passed.error == pytest.approx(found.largest, rel=1e-12)
    assert passed.position == pytest.approx(0.0, abs=1e-15)
    # a larger window finds the same: where both legs are near, the nearer one counts
    wide = contour_error(actual, path, window=0.05)
    assert np.array_equal(wide.error, found.error)


def test_a_corner_on_the_machine_against_every_point_of_its_legs() -> None:
    machine = smooth_xy_table()
    T = 2.5e-4
    path, _ = corner(np.radians(120.0))
    path = path[:: round(T / 5e-5)]
    references = {name: Recorded(position=path[:, i] - path[0, i], sample_time=T) for i, name in enumerate(("x", "y"))}
    run = simulate(machine, references)
    found = contour_error(run)
    vertex, end = -path[0], path[-1] - path[0]
    place = found.position
    both = [to_segment(place, np.zeros(2), vertex), to_segment(place, vertex, end)]
    assert np.abs(found.error) == pytest.approx(np.minimum(*both), abs=1e-15)
    (passed,) = found.corners()
    assert passed.error == pytest.approx(np.max(np.minimum(*both)[run.time > 0.9]), rel=1e-12)


def to_segment(place: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Distance of places from a straight line."""
    d = end - begin
    share = np.clip((place - begin) @ d / (d @ d), 0.0, 1.0)
    return np.linalg.norm(place - begin - share[:, None] * d, axis=1)


def test_unequal_gains_on_a_line() -> None:
    t = np.arange(0.0, 1.0, 1e-3)
    path = V * np.sqrt(0.5) * np.column_stack([t, t])
    actual = path - V * np.sqrt(0.5) / np.array([40.0, 38.0])
    found = contour_error(actual, path)
    assert found.error[500] / UM == pytest.approx(-65.7894736842, abs=1e-9)  # right of the travel: y is slower


def test_a_path_that_crosses_itself_is_not_left_at_the_crossing() -> None:
    u = np.linspace(0.0, 2.0 * np.pi, 4001)
    path = 0.05 * np.column_stack([np.sin(u), np.sin(2.0 * u)])
    t = np.gradient(path, axis=0)
    normal = np.column_stack([-t[:, 1], t[:, 0]]) / np.linalg.norm(t, axis=1)[:, None]
    found = contour_error(path + 20 * UM * normal, path)
    inner = slice(50, -50)
    assert found.error[inner] == pytest.approx(20 * UM, abs=1e-10)
    assert np.max(np.abs(found.lag)) < 1e-6
    # within 20 um of the crossing the other branch is nearer; a window of the whole path takes it
    assert np.min(np.abs(contour_error(path + 20 * UM * normal, path, window=1.0).error[inner])) < 15 * UM


def test_three_axes_have_a_distance_and_a_direction() -> None:
    s = np.linspace(0.0, 0.1, 501)
    path = np.column_stack([s, 2.0 * s, -s])
    off = np.array([0.0, 1e-5, 2e-5])  # across the path
    found = contour_error(path + off, path, axes=("x", "y", "z"))
    assert found.error == pytest.approx(np.linalg.norm(off), rel=1e-9)
    assert found.vector[250] == pytest.approx(off, abs=1e-12)
    assert not found.signed


def test_standstills_and_ends() -> None:
    leg = np.linspace(0.0, 0.01, 201)
    still = np.full(300, 0.01)
    x = np.concatenate([leg, still, still, np.full(200, 0.01)])
    y = np.concatenate([np.zeros(201), np.zeros(300), np.zeros(300), leg[1:]])
    path = np.column_stack([x, y])
    line = np.concatenate([np.full(501, 10), np.full(500, 20)])
    actual = path.copy()
    actual[250] += (3e-6, -4e-6)  # beyond the corner, where it has no normal
    found = contour_error(actual, path, line=line)
    assert found.at_corner[250]
    assert found.error[250] == pytest.approx(5e-6, rel=1e-9)
    assert found.weights[250] == 0.0  # nothing of the path passes while it stands
    assert found.rms == 0.0
    (worst,) = found.worst(1)
    assert worst.line == 10
    assert [each.along for each in found.worst(5, apart=1e-3)] == [worst.along]
    assert [each.line for each in found.corners()] == [20]


def test_figures_count_the_path_and_not_the_time() -> None:
    x = np.concatenate([np.linspace(0.0, 0.1, 101), np.full(10_000, 0.1)])
    path = np.column_stack([x, np.zeros_like(x)])
    actual = path + np.column_stack([np.zeros_like(x), np.where(np.arange(len(x)) < 11, 1e-5, 1e-6)])
    found = contour_error(actual, path)
    assert found.within(0.5) == pytest.approx(1e-6)
    assert found.within(0.95) == pytest.approx(1e-5)
    # 10.5 of 100 steps have 10 um
    assert found.rms == pytest.approx(np.sqrt(0.105 * 1e-10 + 0.895 * 1e-12), rel=1e-9)


def test_wrong_input_is_named() -> None:
    path = np.column_stack([np.arange(5.0), np.zeros(5)])
    bad = path.copy()
    bad[3, 1] = np.nan
    for wrong, said in (
        (lambda: contour_error(path[:, :1], path[:, :1]), "two or more axes"),
        (lambda: contour_error(path, path[:-1]), r"path is of shape \(4, 2\), the positions are of shape \(5, 2\)"),
        (lambda: contour_error(path, 0.0 * path), "do not move"),
        (lambda: contour_error(bad, path), "positions: row 3"),
        (lambda: contour_error(path), "need a path"),
        (lambda: contour_error(path, path, line=np.zeros(3)), "line has 3 rows"),
        (lambda: contour_error(path[:, 0], path), "must be of shape"),
    ):
        with pytest.raises(ParameterError, match=said):
            wrong()
    loop = axis()
    run = simulate(Machine.of({"x": loop, "y": loop}), circle(R, V), duration=0.01)
    with pytest.raises(ParameterError, match="no axis 'z'; it has x, y"):
        contour_error(run, axes=("x", "z"))
    with pytest.raises(ParameterError, match="no reference of axis y; there are x"):
        contour_error(run, {"x": circle(R, V)["x"]})


def test_the_tool_point_of_a_machine_with_geometry_errors_counts() -> None:
    from feeddrive.blocks.coupling.geometry import Geometry

    loop = axis()
    machine = Machine.of({"x": loop, "y": loop}, geometry=Geometry(scale_x=1e-3, scale_y=1e-3))
    run = simulate(machine, circle(R, V))
    table, tool = contour_error(run, signal="position_load"), contour_error(run)
    settled = (run.time > 1.4) & (run.time < 2.4)
    assert (table.error - tool.error)[settled] == pytest.approx(1e-3 * R, rel=2e-4)  # the circle itself is 2.1 um large


# ---------------------------------------------------------------- what decides: a case on either side of each bound


@pytest.mark.parametrize(("nanometers", "moves"), [(0.8, False), (1.5, True)])
def test_a_path_that_moves_by_less_than_a_nanometer_is_one_point(nanometers: float, moves: bool) -> None:
    path = np.column_stack([1e-9 * nanometers * np.linspace(0.0, 1.0, 9), np.zeros(9)])
    if moves:
        assert len(curve_through(path).node) == 2
        return
    with pytest.raises(ParameterError, match="do not move"):
        curve_through(path)


@pytest.mark.parametrize(("radians", "sharp"), [(0.25, False), (0.45, True)])
def test_chords_that_turn_by_more_than_20_degrees_are_a_corner(radians: float, sharp: bool) -> None:
    legs = np.array([[-2.0, 0.0], [-1.0, 0.0], [0.0, 0.0], [np.cos(radians), np.sin(radians)]])
    curve = curve_through(np.vstack([legs, legs[-1] + (legs[-1] - legs[-2])]))
    assert curve.turn[2] == pytest.approx(radians if sharp else 0.0)


@pytest.mark.parametrize(("degrees", "tangent"), [(50.0, 50.0), (70.0, 0.0)])
def test_a_velocity_within_60_degrees_of_the_chord_is_a_tangent(degrees: float, tangent: float) -> None:
    path = np.column_stack([np.linspace(0.0, 1.0, 3), np.zeros(3)])
    aside = np.radians(degrees)
    curve = curve_through(path, np.tile([np.cos(aside), np.sin(aside)], (3, 1)))
    assert np.degrees(np.arctan2(*curve.begin[0][::-1])) == pytest.approx(tangent)


@pytest.mark.parametrize(("turn", "corner"), [(0.7e-3, False), (1.5e-3, True)])
def test_a_turn_of_less_than_a_milliradian_is_no_corner(turn: float, corner: bool) -> None:
    node = np.array([[-1.0, 0.0], [0.0, 0.0], [np.cos(turn), np.sin(turn)]])
    chord = np.diff(node, axis=0)
    curve = Curve(node, np.array([0.0, 1.0, 2.0]), chord, chord, np.arange(3))
    assert bool(feet(curve, np.array([[0.0, -1e-3]]), None, 1.0).corner[0]) is corner


def peaked(*peaks: float, rest: float = 0.0, path: float = 1.0) -> ContourError:
    """Errors of 10 um over 0.1 mm at these places of a straight path in m, and a share `rest` of them between."""
    x = np.linspace(0.0, path, 20001)
    error = np.max([10 * UM * (np.abs(x - place) < 5e-5) for place in peaks], axis=0)
    between = (x > min(peaks)) & (x < max(peaks))
    error = np.where(between, np.maximum(error, rest * 10 * UM), error)
    return contour_error(np.column_stack([x, error]), np.column_stack([x, np.zeros(20001)]))


def test_a_table_names_the_five_worst_places() -> None:
    assert len(peaked(*np.linspace(0.1, 0.9, 12)).table().rows) == 5


@pytest.mark.parametrize(("apart", "places"), [(0.8e-3, 1), (1.5e-3, 2)])
def test_places_within_a_thousandth_of_the_path_are_one(apart: float, places: int) -> None:
    assert len(peaked(0.5, 0.5 + apart).worst()) == places


@pytest.mark.parametrize(("rest", "places"), [(0.4, 2), (0.6, 1)])
def test_places_are_parted_by_half_of_the_error(rest: float, places: int) -> None:
    found = peaked(0.4, 0.6, rest=rest).worst()
    assert sum(abs(each.error) > 9 * UM for each in found) == places


@pytest.mark.parametrize(("speed", "known"), [(0.7e-6, False), (1.5e-6, True)])
def test_a_path_slower_than_a_micrometer_per_second_has_no_direction(speed: float, known: bool) -> None:
    x = speed * np.arange(50.0)
    path = np.column_stack([x, np.zeros(50)])
    # the velocity of the instant, a little more than the difference: not that of a control which differences
    velocity = np.column_stack([np.full(50, 1.0001 * speed), np.zeros(50)])
    found = contour_error(path, path, velocity=velocity, acceleration=0.0 * path)
    assert found.estimate is not None
    assert np.all(np.isfinite(found.estimate)) if known else np.all(np.isnan(found.estimate))
