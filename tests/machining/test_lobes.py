"""Stability lobes against converged values of an independent program, identities, and the cut in the time domain."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from feeddrive.blocks.actuator.actuator import Actuator
from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.cutting.engagement import arc
from feeddrive.blocks.cutting.helical_cutter import HelicalCutter
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.files.machine import read_machine
from feeddrive.language.errors import ParameterError, UnstableError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.frequency_response import FRF
from feeddrive.loop.linearize import StateSpace
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.machining.lobes import Lobes, cut_stability, kind_of, semi_discretisation, stability_lobes, zero_order
from feeddrive.machining.regeneration import Regeneration, ToothPassage, regeneration
from feeddrive.machining.tool_point import ToolMode, ToolPoint, tool_modes, tool_point

# the benchmark of the literature: Insperger & Stépán 2004, one mode along the feed, two straight teeth
MODE = ToolMode(frequency=922.0, damping_ratio=0.011, mass=0.03993)
TOOL = tool_modes(MODE)
BOTH = tool_modes(MODE, dataclasses.replace(MODE, feed=0.0, normal=1.0))
SLOT = Regeneration(teeth=2, tangential=6e8, radial=2e8)


def engaged(share: float, milling: str) -> Regeneration:
    entry, leave = arc(milling, share, 1.0)
    return dataclasses.replace(SLOT, entry=entry, leave=leave)


CUTS = {
    "slot": SLOT,
    "up 0.5": engaged(0.5, "up"),
    "down 0.5": engaged(0.5, "down"),
    "up 0.1": engaged(0.1, "up"),
    "down 0.1": engaged(0.1, "down"),
}
SPEEDS = (5000.0, 8000.0, 10000.0, 12500.0, 15000.0, 20000.0)
# mm; the zero-order limits to 4 decimals
LIMITS = {
    "slot": (0.4086278075, 0.6763889563, 0.3223790227, 2.7070198257, 0.3865888294, 1.4175059022),
    "up 0.5": (0.2602789544, 0.4060360922, 0.2135340337, 1.5450385222, 0.2588724931, 1.1853002218),
    "down 0.5": (0.8472035133, 0.7979323206, 2.1046896988, 0.6570420025, 2.5962383987, 0.7196431739),
    "up 0.1": (1.0264515360, 1.6840049827, 0.8153439086, 4.9079374154, 0.9659571507, 2.2060315302),
    "down 0.1": (1.2962632427, 1.2204239340, 2.5184120909, 1.0124759129, 4.3436751338, 1.2214665044),
}
ZERO_ORDER = {
    "slot": (0.3699, 0.5694, 0.3069, 2.0469, 0.3734, 1.5568),
    "up 0.5": (0.2543, 0.3914, 0.2109, 1.4069, 0.2566, 1.0700),
    "down 0.5": (0.9218, 0.8687, 3.0182, 0.6824, 5.2022, 0.7939),
    "up 0.1": (0.9346, 1.4386, 0.7752, 5.1712, 0.9434, 3.9332),
    "down 0.1": (1.4375, 1.3547, 4.7066, 1.0641, 8.1124, 1.2380),
}
FLIPS = {"slot": (3, 5), "up 0.5": (), "down 0.5": (2, 4), "up 0.1": (3, 5), "down 0.1": (2, 4)}
MEANS = {
    "slot": 100.0,
    "up 0.5": 145.4929659,
    "down 0.5": -45.49296586,
    "up 0.1": 39.58186964,
    "down 0.1": -29.17306577,
}
LEAST = {
    "slot": 0.2980538427,
    "up 0.5": 0.2048579057,
    "down 0.5": 0.6409078787,
    "up 0.1": 0.7530059732,
    "down 0.1": 0.9994424469,
}
# the last digit of the reference is 1e-10 mm, and roots are found to 1e-10 of their size
EXACT = 3e-9


@pytest.mark.parametrize("name", CUTS)
def test_the_limits_of_the_benchmark(name: str) -> None:
    found = stability_lobes(TOOL, CUTS[name], SPEEDS)
    assert found.depth == pytest.approx(1e-3 * np.array(LIMITS[name]), rel=EXACT)
    assert tuple(np.flatnonzero(found.flip)) == FLIPS[name]
    hopf = found.multiplier[~found.flip]
    assert np.abs(hopf) == pytest.approx(1.0, abs=1e-9)
    # a flip swings at odd multiples of half the frequency of the teeth
    beats = found.frequency[found.flip] * 60.0 / (2.0 * found.spindle_speed[found.flip])
    assert beats % 1.0 == pytest.approx(0.5, abs=1e-9)


def test_multipliers_of_the_slot() -> None:
    depths = np.array([0.2, 0.3, 0.5, 0.7, 1.0]) * 1e-3
    found = ToothPassage(TOOL, SLOT, 5000.0).multipliers(depths)
    expected = [0.8197427842, 0.9073776399, 1.0739755867, 1.2215561357, 1.4064735253]
    assert np.abs(found) == pytest.approx(expected, abs=2e-10)
    assert found[2] == pytest.approx(-0.5050771106 + 0.9477978018j, abs=2e-10)


@pytest.mark.parametrize(
    ("name", "speed", "depth", "size"),
    [
        ("up 0.5", 10000.0, 0.25, 1.0254480692),
        ("down 0.5", 12500.0, 1.0, 1.0678910692),
        ("up 0.1", 15000.0, 1.0, 1.0036447503),
        ("down 0.1", 5000.0, 1.0, 0.8909657657),
        ("down 0.1", 10000.0, 3.2, 1.381906601),
    ],
)
def test_multipliers_of_other_cuts(name: str, speed: float, depth: float, size: float) -> None:
    assert abs(ToothPassage(TOOL, CUTS[name], speed).multipliers([1e-3 * depth])[0]) == pytest.approx(size, abs=2e-9)


@pytest.mark.parametrize(
    ("name", "limits"),
    [
        ("slot", (0.0475065442, 0.0714107806, 0.1144476329)),
        ("up 0.5", (0.1271062024, 0.1810301448, 0.2818420362)),
        ("down 0.5", (0.1271062024, 0.1810301448, 0.2818420362)),  # two equal modes: only the arc counts
        ("down 0.1", (0.9164363532, 0.9701247085, 1.3583806766)),
    ],
)
def test_two_equal_modes(name: str, limits: tuple[float, ...]) -> None:
    for speed, limit in zip((5000.0, 10000.0, 15000.0), limits, strict=True):
        grown = ToothPassage(BOTH, CUTS[name], speed).multipliers(1e-3 * limit * np.array([1.0, 0.999]))
        assert abs(grown[0]) == pytest.approx(1.0, abs=1e-8)
        assert abs(grown[1]) < 1.0


def test_a_mode_along_the_normal_is_one_along_the_feed_of_the_other_milling() -> None:
    normal = tool_modes(dataclasses.replace(MODE, feed=0.0, normal=1.0))
    for name, limit in (("up 0.5", 2.5962383987), ("down 0.5", 0.2588724931)):
        found = ToothPassage(normal, CUTS[name], 15000.0).multipliers([1e-3 * limit])[0]
        assert abs(found) == pytest.approx(1.0, abs=1e-8)
    # the same by turning the feed: t against n is a quarter turn
    turned = TOOL.turned(-0.5 * np.pi)
    assert turned.C[1] == pytest.approx(TOOL.C[0])
    assert turned.C[0] == pytest.approx(0.0 * TOOL.C[0])


@pytest.mark.parametrize("name", CUTS)
def test_zero_order(name: str) -> None:
    assert CUTS[name].mean()[0, 0] == pytest.approx(1e6 * MEANS[name], rel=1e-9)
    found = zero_order(TOOL, CUTS[name], SPEEDS)
    assert 1e3 * found.depth == pytest.approx(ZERO_ORDER[name], abs=6e-5)
    assert 1e3 * found.least == pytest.approx(LEAST[name], rel=1e-6)


def test_a_helix_whose_pitch_is_the_depth_has_the_zero_order_limit() -> None:
    # H is then constant: both theories are exact
    for speed, limit in ((5000.0, 0.3699194593), (10000.0, 0.3068583205), (15000.0, 0.3733967141)):
        helical = dataclasses.replace(SLOT, lag=SLOT.pitch / (1e-3 * limit))
        assert abs(ToothPassage(TOOL, helical, speed).multipliers([1e-3 * limit])[0]) == pytest.approx(1.0, abs=1e-9)
        assert 1e3 * zero_order(TOOL, SLOT, [speed]).depth[0] == pytest.approx(limit, rel=1e-5)


def test_helical_edges_average_the_direction_over_the_depth() -> None:
    helical = dataclasses.replace(CUTS["up 0.5"], teeth=3, lag=900.0)
    depth = 2.1e-3  # 1.89 rad: nearly a pitch
    z = (np.arange(200000) + 0.5) / 200000 * helical.lag * depth
    for piece in helical.steps(depth):
        angle = 0.5 * (piece.begin + piece.end)
        total = np.zeros((2, 2))
        for tooth in range(-1, 5):
            v = angle + tooth * helical.pitch - z
            v = v[(v > 0.0) & (v < 0.5 * np.pi)]
            s, c = np.sin(v), np.cos(v)
            total += [
                [np.sum(s * (6e8 * c + 2e8 * s)), np.sum(c * (6e8 * c + 2e8 * s))],
                [np.sum(s * (2e8 * c - 6e8 * s)), np.sum(c * (2e8 * c - 6e8 * s))],
            ]
        H = helical.matrices(piece, np.array([angle]), depth)[0][0]
        assert np.max(np.abs(H - total / z.size)) < 2e-5 * 6e8  # one slice of 2e5 at each end of an edge
        assert piece.cutting == bool(np.any(total))


def test_a_mode_between_feed_and_normal_is_one_direction() -> None:
    # one of the two eigenvalues of the zero-order theory is 0 at all frequencies; turned by 30 degrees it is one mode
    slanted = tool_modes(dataclasses.replace(MODE, feed=np.cos(np.pi / 6.0), normal=-np.sin(np.pi / 6.0)))
    along = dataclasses.replace(CUTS["up 0.5"], entry=np.pi / 6.0, leave=4.0 * np.pi / 6.0)
    alone = zero_order(TOOL, CUTS["up 0.5"], SPEEDS)
    assert zero_order(slanted, along, SPEEDS).depth == pytest.approx(alone.depth, rel=1e-6)
    assert abs(ToothPassage(slanted, along, 10000.0).multipliers([0.2135340337e-3])[0]) == pytest.approx(1.0, abs=1e-8)


def test_process_damping_raises_the_limit() -> None:
    found = stability_lobes(TOOL, SLOT, [5000.0], diameter=0.01, process_damping=2e4)
    assert 1e3 * found.depth[0] == pytest.approx(0.5412063535, rel=EXACT)


def test_semi_discretisation_comes_closer_with_the_square_of_the_steps() -> None:
    exact = 1.0739755867
    off = [abs(semi_discretisation(TOOL, SLOT, 5000.0, 5e-4, steps=40, order=k)[0]) - exact for k in (0, 1)]
    assert off == pytest.approx([-6.0e-2, -3.0e-2], abs=5e-4)
    fine = abs(semi_discretisation(TOOL, SLOT, 5000.0, 5e-4, steps=160)[0]) - exact
    assert fine == pytest.approx(-1.9e-3, abs=5e-5)
    assert off[1] / fine == pytest.approx(16.0, rel=0.05)


# a table of 400 kg under a continuous P-PI control, from a force on the table to its position
M, VISCOUS, KV, KP, TN = 400.0, 2000.0, 30.0, 6e4, 0.02
DRIVE = ToolPoint(
    np.array([[0.0, 1.0, 0.0], [-(KP * KV + KP / TN) / M, -(KP + VISCOUS) / M, -KP * KV / TN / M], [1.0, 0.0, 0.0]]),
    np.array([[0.0, 0.0], [1.0 / M, 0.0], [0.0, 0.0]]),
    np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
)


def steel(teeth: int, entry: float = 0.0, leave: float = float(np.pi)) -> Regeneration:
    return Regeneration(teeth, 1.8e9, 0.6e9, entry, leave)


@pytest.mark.parametrize(
    ("cut", "least", "limits"),
    [
        (
            steel(5, *arc("symmetric", 0.75, 1.0)),
            16.74065501,
            (18.5081507463, 21.0100842095, 16.9620561827, 21.5395461392, 34.7493894895),
        ),
        (
            steel(4, *arc("up", 0.5, 1.0)),
            12.30736941,
            (13.1550963876, 15.6442898141, 14.1302268857, 13.5856560747, 19.6243185316),
        ),
        (steel(3), 23.87514236, (25.2903849232, 24.5568828063, 30.0165542824, 24.1768202307, 27.3321869413)),
    ],
)
def test_the_drive_as_the_flexible_mode(cut: Regeneration, least: float, limits: tuple[float, ...]) -> None:
    found = stability_lobes(DRIVE, cut, (200.0, 300.0, 400.0, 600.0, 900.0))
    assert 1e3 * found.depth == pytest.approx(np.array(limits), rel=2e-8)  # 10 points fewer than the mode needs
    assert np.all((found.frequency > 17.43) & (found.frequency < 60.0))  # where Re G < 0
    assert 1e3 * zero_order(DRIVE, cut).least == pytest.approx(least, rel=1e-5)


def test_a_table_mode_in_series_adds_its_compliance() -> None:
    both = DRIVE + tool_modes(ToolMode(60.0, 0.03, 1500.0))
    limits = 33.5192138261, 20.2647246355, 32.60605376, 16.6060376145
    found = stability_lobes(both, steel(3), (300.0, 900.0, 1100.0, 2000.0))
    assert 1e3 * found.depth == pytest.approx(np.array(limits), rel=2e-8)


def sampled(dead_time: float = 0.0, T: float = 2.5e-4) -> Loop:
    control = Control(law=CascadePPI(Kv=KV, Kp=KP, Tn=TN))
    axis = Axis(plant=Rigid(mass=M, viscous=VISCOUS), actuator=Actuator(dead_time=dead_time))
    return Loop(control=control, axis=axis, sample_time=T)


def test_the_sampled_law() -> None:
    # the reference has the exact hold with the cut between the samples; the fit leaves out images of the sampling
    for dead_time, limit in ((0.0, 28.8209), (2.5e-4, 29.1009)):
        point = tool_point(sampled(dead_time))
        assert point.missed < 1e-5
        assert 1e3 * stability_lobes(point, steel(3), [500.0]).depth[0] == pytest.approx(limit, rel=1e-5)
    assert 1e3 * stability_lobes(DRIVE, steel(3), [500.0]).depth[0] == pytest.approx(28.1419200657, rel=EXACT)


CUTTER = HelicalCutter(
    teeth=3, diameter=0.05, axial_depth=0.02, helix_angle=0.0, specific_energy=1.8e9, radial_ratio=1.0 / 3.0
)


def test_a_machine_names_the_axes_by_its_cut() -> None:
    stiff = dataclasses.replace(sampled(), control=Control(law=CascadePPI(Kv=KV, Kp=2.0 * KP, Tn=TN)))
    cut = MillingCut(cutter=CUTTER, spindle_speed=500.0, along_x="y", along_y="x")
    machine = Machine.of({"x": stiff, "y": sampled()}, (cut,))
    point = tool_point(machine)
    alone = tool_point(sampled())
    f = np.array([5.0, 30.0, 90.0])
    assert point.response(f)[:, 0, 0] == pytest.approx(alone.response(f)[:, 0, 0], rel=1e-4)
    assert abs(point.response(f)[:, 1, 1]) == pytest.approx(abs(tool_point(stiff).response(f)[:, 0, 0]), rel=1e-4)
    assert regeneration(CUTTER) == Regeneration(3, 1.8e9, 0.6e9, diameter=0.05)


def simulated(tool: ToolPoint, cut: Regeneration, speed: float, depth: float, teeth: int, steps: int) -> np.ndarray:
    """Once-per-tooth feed positions of a mode that is released beside its rest: explicit, in small steps."""
    h = cut.period(speed) / steps
    from scipy.linalg import expm

    d = tool.A.shape[0]
    whole = np.zeros((d + 1, d + 1))
    whole[:d, :d], whole[:d, d] = tool.A, tool.B[:, 0]
    moved = expm(whole * h)
    # the mean of the direction over each step, so that entry and exit need not lie on the grid
    H = [cut.averaged(i / steps * cut.pitch, (i + 1) / steps * cut.pitch)[0, 0] for i in range(steps)]
    y, past, samples = np.array([1e-6, 0.0]), np.zeros((steps, 2)), []
    for k in range(teeth * steps):
        i = k % steps
        before = past[i] + 0.5 * h * np.array([past[i][1], 0.0])
        middle = y[0] + 0.5 * h * y[1]
        force = -depth * H[i] * (middle - before[0])
        past[i] = y
        y = moved[:d, :d] @ y + moved[:d, d] * force
        if i == steps - 1:
            samples.append(y[0])
    return np.array(samples)


@pytest.mark.parametrize(
    ("name", "speed", "limit"), [("slot", 10000.0, 0.3223790227), ("down 0.1", 10000.0, 2.5184120909)]
)
def test_vibration_in_time_dies_out_below_and_grows_above(name: str, speed: float, limit: float) -> None:
    for share in (0.97, 1.03):
        cut = cut_stability(TOOL, CUTS[name], speed, 1e-3 * limit * share)
        samples = simulated(TOOL, CUTS[name], speed, cut.depth, teeth=64, steps=100)
        late = np.abs(np.fft.rfft(samples[-24:] * np.hanning(24)))
        early = np.abs(np.fft.rfft(samples[-48:-24] * np.hanning(24)))
        # over 24 teeth; the steps leave an error of some 1e-3 of |µ|
        growth = (late.max() / early.max()) ** (1.0 / 24.0)
        assert growth == pytest.approx(cut.growth, abs=3e-3)
        assert cut.stable == (share < 1.0) == (growth < 1.0)


def test_a_narrow_tongue_below_the_border_is_found() -> None:
    # at 10000 rpm in half down milling a flip opens at 2.1047 mm and closes before the next step of the scan
    found = stability_lobes(TOOL, CUTS["down 0.5"], [10000.0], islands=True, deepest=4e-3)
    passage = ToothPassage(TOOL, CUTS["down 0.5"], 10000.0)
    assert passage.flips()[0] == pytest.approx(2.1046896988e-3, rel=EXACT)
    assert found.islands
    for _, low, high in found.islands:
        inside, outside = passage.multipliers([0.5 * (low + high)]), passage.multipliers([low * 0.9999])
        assert abs(inside[0]) < 1.0 < abs(outside[0])


def test_what_is_shown() -> None:
    found = stability_lobes(TOOL, SLOT, np.linspace(9000.0, 15000.0, 7), speed=10000.0, depth=5e-4)
    assert found.own is not None
    assert not found.own.stable
    assert "chatters at" in found.own.sentence()
    assert found.own.kind == "hopf"
    assert (27660.0 / 2, 922.0, 2) in [(pytest.approx(n), pytest.approx(f), k) for n, f, k in found.passing()]
    assert "least" in str(found)
    assert kind_of(1.0 + 0j) == "fold"
    deep = cut_stability(TOOL, SLOT, 10000.0, 1e-4, deepest=2e-4)
    assert deep.kind == "none"
    assert deep.stable
    assert "no limit was found up to 0.2 mm" in deep.sentence()


@pytest.mark.parametrize(
    ("said", "call"),
    [
        ("teeth = 0 must be 1 or more", lambda: Regeneration(0, 6e8, 2e8)),
        ("multiply by 1e6", lambda: Regeneration(2, 600.0, 200.0)),
        ("leaves the work after", lambda: Regeneration(2, 6e8, 2e8, 1.0, 0.5)),
        ("give the diameter", lambda: Regeneration(2, 6e8, 2e8, process_damping=1e4)),
        ("spindle that stands", lambda: stability_lobes(TOOL, SLOT, [0.0])),
        ("spindle that stands", lambda: cut_stability(TOOL, SLOT, 0.0, 1e-3)),
        ("depth = 0 m must be > 0", lambda: cut_stability(TOOL, SLOT, 5000.0, 0.0)),
        ("deepest = -1 m must be > 0", lambda: stability_lobes(TOOL, SLOT, [5000.0], deepest=-1.0)),
        ("begin at", lambda: stability_lobes(TOOL, SLOT, [100.0])),
        ("fit_modes", lambda: stability_lobes(FRF(np.array([1.0]), np.array([1j])), SLOT, [5000.0])),
        ("the lobes need m/N", lambda: zero_order(FRF(np.array([1.0]), np.array([1j]), unit="m/s/N"), SLOT)),
        ("at least one mode", lambda: tool_modes()),
        ("frequency = 0 Hz", lambda: ToolMode(0.0, 0.01, 1.0)),
        ("in no direction", lambda: stability_lobes(tool_modes(ToolMode(9.0, 0.1, 1.0, feed=0.0)), SLOT, [5000.0])),
        ("no axis 'w'", lambda: tool_point(sampled(), along=("w",))),
        ("axis 'c' turns", lambda: tool_point(read_machine("rotary_table").machine())),
        ("straight edges", lambda: semi_discretisation(TOOL, dataclasses.replace(SLOT, lag=9.0), 5000.0, 1e-3)),
    ],
)
def test_wrong_input_is_named(said: str, call: object) -> None:
    assert callable(call)
    with pytest.raises(ParameterError, match=said):
        call()


def test_a_tool_point_that_does_not_rest_is_refused() -> None:
    with pytest.raises(UnstableError, match="unstable without any cut"):
        stability_lobes(ToolPoint(np.array([[0.0, 1.0], [-1.0, 0.1]]), TOOL.B, TOOL.C), SLOT, [5000.0])


def test_zero_order_takes_a_measured_response() -> None:
    f = np.linspace(700.0, 1200.0, 5001)
    measured = FRF(f, TOOL.response(f)[:, 0, 0], unit="m/N")
    assert zero_order(measured, SLOT, SPEEDS).depth == pytest.approx(zero_order(TOOL, SLOT, SPEEDS).depth, rel=1e-3)


@pytest.mark.parametrize(("name", "speed"), [("ball_screw", 500.0), ("linear_motor", 200.0)])
def test_poles_that_hardly_move_the_tool_need_no_points(name: str, speed: float) -> None:
    # a pole of the control near 2 or 3.6 kHz, damped by 45 % and more, swings up to 200 times while a tooth cuts
    point = tool_point(read_machine(name).machine())
    grown = [
        abs(ToothPassage(point, steel(4, 0.0, 2.0), speed, share=share).multipliers([3e-3])[0]) for share in (0.6, 1.0)
    ]
    assert grown[0] == pytest.approx(grown[1], rel=1e-8)


@pytest.mark.slow(reason="400 exponentials and products of large maps")
def test_semi_discretisation_extrapolated_meets_the_exact_multiplier() -> None:
    first, second, third = (abs(semi_discretisation(TOOL, SLOT, 5000.0, 5e-4, steps=k)[0]) for k in (100, 200, 400))
    # Richardson twice: the errors of second and fourth order cancel
    found = (16.0 * (4.0 * third - second) - (4.0 * second - first)) / 45.0
    assert found == pytest.approx(1.0739755867, abs=2e-10)


@pytest.mark.slow(reason="scans sixteen random cuts in small steps")
@pytest.mark.parametrize("seed", range(16))
def test_a_finer_scan_finds_no_lower_limit(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(seed)
    modes = [
        ToolMode(random.uniform(200, 1500), 10 ** random.uniform(-2.2, -1.2), 10 ** random.uniform(-2, 0), *shape)
        for shape in random.normal(size=(random.integers(1, 4), 2))
    ]
    entry, leave = arc(str(random.choice(["up", "down"])), random.uniform(0.05, 1.0), 1.0)
    teeth, helix = int(random.integers(1, 6)), random.uniform(0.3, 0.8) if random.random() < 0.3 else 0.0
    radial = 6e8 * random.uniform(0.1, 0.6)
    cut = Regeneration(teeth, 6e8, radial, entry, leave, lag=200.0 * float(np.tan(helix)))
    speed = random.uniform(0.4, 2.5) * 60.0 * modes[0].frequency / teeth
    usual = stability_lobes(tool_modes(*modes), cut, [speed])
    monkeypatch.setattr("feeddrive.machining.lobes._RATIO", 1.03)
    assert stability_lobes(tool_modes(*modes), cut, [speed]).depth == pytest.approx(usual.depth, rel=1e-6)


# ---------------------------------------------------------------- what decides: a case on either side of each bound


def test_a_limit_is_searched_up_to_12_times_the_lowest_zero_order_limit() -> None:
    least = zero_order(TOOL, SLOT).least
    assert stability_lobes(TOOL, SLOT, [5000.0]).deepest == pytest.approx(12.0 * least, rel=1e-12)


def test_a_table_names_five_pockets_and_the_lowest_limit() -> None:
    depth = 1e-3 * np.where(np.arange(41) % 2 == 1, 2.0, 1.0)
    nothing = np.full(41, np.nan)
    lobes = Lobes(np.linspace(1e3, 2e4, 41), depth, nothing, nothing + 0j, 0.01, 2, np.array([922.0]))
    assert len(lobes.table().rows) == 6


@pytest.mark.parametrize(("vibrations", "resolved"), [(42.0, True), (50.5, False)])
def test_a_tooth_in_whose_cut_a_mode_swings_50_times_is_refused(vibrations: float, resolved: bool) -> None:
    """The slot of two teeth is cut all the time: over a tooth period the mode swings f times that."""
    passage = ToothPassage(TOOL, SLOT, 922.0 * np.sqrt(1.0 - 0.011**2) * 30.0 / vibrations)
    if resolved:
        assert np.isfinite(abs(passage.multipliers([1e-6])[0]))
        return
    with pytest.raises(ParameterError, match="at most 50 are resolved"):
        passage.multipliers([1e-6])


@pytest.mark.parametrize(("share", "fastest"), [(0.007, 100.0), (0.014, 1000.0)])
def test_a_pole_that_moves_the_tool_by_a_hundredth_of_the_largest_peak_counts(share: float, fastest: float) -> None:
    """A mode of mass m has a pole of peak 1/(2 m ω_d) over its decay rate ζω; the second one is damped by half."""
    slow, quick = 2.0 * np.pi * 100.0, 2.0 * np.pi * 1000.0

    def compliance(omega: float, ratio: float, mass: float) -> float:
        return 1.0 / (2.0 * mass * omega * np.sqrt(1.0 - ratio**2) * ratio * omega)

    mass = compliance(quick, 0.5, 1.0) / (share * compliance(slow, 0.02, 1.0))
    point = tool_modes(ToolMode(100.0, 0.02, 1.0), ToolMode(1000.0, 0.5, mass))
    ratio = 0.02 if fastest == 100.0 else 0.5
    assert point.fastest() == pytest.approx(2.0 * np.pi * fastest * np.sqrt(1.0 - ratio**2), rel=1e-9)


@pytest.mark.parametrize(("share", "fits"), [(0.008, True), (0.016, False)])
def test_a_response_that_its_poles_miss_by_a_hundredth_is_refused(share: float, fits: bool) -> None:
    """A sampled lag of 20 ms, and a pole at z = -0.5 that moves the tool by a share: no continuous pole is like it."""
    poles = np.array([np.exp(-1e-3 / 0.02), -0.5])
    C = np.array([[1.0 - poles[0], 1.5 * share]])
    ports = ("load_force",), ("position_load",)
    model = StateSpace(np.diag(poles), np.ones((2, 1)), C, np.zeros((1, 1)), 1e-3, ("slow", "alternating"), *ports)
    if fits:
        assert tool_point(model).missed == pytest.approx(share, rel=0.1)
        return
    with pytest.raises(ParameterError, match="a fit misses it"):
        tool_point(model)
