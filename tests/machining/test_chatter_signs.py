"""The signs of chatter in signals of known kind, and in the run of a machine that cuts, against the predicted µ."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from feeddrive.blocks.controller.cascade_ppi import CascadePPI
from feeddrive.blocks.coupling.milling_cut import MillingCut
from feeddrive.blocks.cutting.mechanistic_cutter import MechanisticCutter
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.blocks.reference.linear_move import LinearMove
from feeddrive.language.errors import ParameterError
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate
from feeddrive.machining.lobes import ChatterSigns, chatter_signs, cut_stability, stability_lobes
from feeddrive.machining.regeneration import regeneration
from feeddrive.machining.tool_point import tool_point

STEP, SPEED, TEETH = 1e-4, 3000.0, 4  # teeth pass at 200 Hz, the spindle turns at 50 Hz
TIME = STEP * np.arange(10000)
CUT = np.maximum(np.sin(2.0 * np.pi * 200.0 * TIME), 0.0)  # N, once per tooth


def signs(values: np.ndarray, *, runout: bool = False, start: float | None = None) -> ChatterSigns:
    return chatter_signs(values, STEP, speed=SPEED, teeth=TEETH, name="force", unit="N", runout=runout, start=start)


def test_a_stable_cut_is_one_dot() -> None:
    found = signs(CUT)
    assert found.dots == 1
    assert found.passing == pytest.approx(200.0)
    assert np.ptp(found.samples) < 1e-2
    assert found.swing == pytest.approx(1.0, abs=0.02)  # 50 samples a tooth
    assert "no chatter" in str(found)
    # what is left of the entry dies out
    assert signs(CUT + 0.1 * np.exp(-TIME / 0.1) * np.sin(2.0 * np.pi * 130.0 * TIME)).dots == 1


def test_a_flip_is_two_dots_and_swings_at_half_the_teeth() -> None:
    found = signs(CUT + 0.1 * np.sin(2.0 * np.pi * 300.0 * TIME), start=1e-3)
    assert found.dots == 2
    assert found.chatter == pytest.approx(300.0, abs=1.0)
    assert found.samples[0] == pytest.approx(found.samples[2], abs=1e-3)
    assert abs(found.samples[0] - found.samples[1]) > 0.1


def test_a_hopf_chatter_is_a_ring_with_its_own_line() -> None:
    found = signs(CUT + 0.1 * np.sin(2.0 * np.pi * 273.0 * TIME))
    assert found.dots == 0
    assert found.chatter == pytest.approx(273.0, abs=1.0)
    assert "run round" in found.sentence()
    assert [row[2] for row in found.table().rows][:2] == ["1 x teeth", "2 x teeth"]
    assert "chatter" in [row[2] for row in found.table().rows]


def test_run_out_is_no_chatter() -> None:
    run_out = CUT * (1.0 + 0.2 * np.cos(2.0 * np.pi * 50.0 * TIME))
    assert signs(run_out).dots == 0
    assert signs(run_out, runout=True).dots == 1


@pytest.mark.parametrize(
    ("said", "call"),
    [
        ("at least 16 are needed", lambda: signs(CUT[:400])),
        ("at least 16 are needed", lambda: signs(CUT[:1500], runout=True)),
        ("sample faster", lambda: chatter_signs(CUT, 2e-3, speed=SPEED, teeth=TEETH)),
        ("speed = 0 rpm", lambda: chatter_signs(CUT, STEP, speed=0.0, teeth=TEETH)),
    ],
)
def test_what_does_not_suffice_is_refused(said: str, call: Callable[[], object]) -> None:
    with pytest.raises(ParameterError, match=said):
        call()


def test_the_picture_says_what_it_is() -> None:
    figure = signs(CUT + 0.1 * np.sin(2.0 * np.pi * 273.0 * TIME)).plot()
    said = [text.get_text() for text in figure.findobj(lambda each: hasattr(each, "get_text"))]
    assert "a ring: Hopf chatter" in said
    assert "273 Hz" in said


T, TURNS, FEED = 2.5e-4, 500.0, 5e-3  # s; rpm: a tooth every 160 samples; m/s: 0.2 mm a tooth


def machine(depth: float) -> Machine:
    """Two tables of 400 kg under sampled position control, and a slot along x with three straight teeth."""
    control = Control(law=CascadePPI(Kv=30.0, Kp=6e4, Tn=0.02))
    loop = Loop(control=control, axis=Axis(plant=Rigid(mass=400.0, viscous=2000.0), substeps=4), sample_time=T)
    cutter = MechanisticCutter(teeth=3, diameter=0.05, axial_depth=depth, Ktc=1.8e9, Krc=0.6e9, slices=1)
    return Machine.of({"x": loop, "y": loop}, (MillingCut(cutter=cutter, spindle_speed=TURNS, direction=0.0),))


@pytest.mark.slow(reason="compiles two machines with a cut, and simulates 10 s of milling")
def test_the_machine_chatters_above_the_limit_and_calms_down_below_as_predicted() -> None:
    point = tool_point(machine(1e-3))
    (coupling,) = machine(1e-3).couplings
    assert isinstance(coupling, MillingCut)
    cut = regeneration(coupling.cutter)
    limit = float(stability_lobes(point, cut, [TURNS]).depth[0])
    duration = 4.8
    feed = LinearMove(distance=FEED * duration, travel_time=duration)
    stands = LinearMove(distance=0.0, travel_time=duration)
    found: dict[float, ChatterSigns] = {}
    for share in (0.9, 1.1):
        run = simulate(machine(share * limit), {"x": feed, "y": stands}, duration=duration)
        predicted = cut_stability(point, cut, TURNS, share * limit)
        change = np.diff(run["x.tracking_error"][::160])  # from tooth to tooth
        late, early = (np.abs(np.fft.rfft(change[i : i + 16] * np.hanning(16))).max() for i in (80, 40))
        if share < 1.0:
            # the fit of the sampled law and the four substeps leave some 1e-4
            assert (late / early) ** (1.0 / 40.0) == pytest.approx(predicted.growth, abs=1e-3)
        else:
            # teeth leave the cut, so that the vibration is bounded: it stays, and does not die out
            assert late > 0.7 * early > 5e-6
        found[share] = chatter_signs(run["x.load_force"][8000:], T, speed=TURNS, teeth=3)
    assert found[0.9].dots == 1
    assert found[1.1].dots == 0
    # the ring turns at |arg µ|/2πτ beside each harmonic; out of the cut it shifts by up to a Hz
    beat = cut_stability(point, cut, TURNS, 1.1 * limit).frequency % 25.0
    seen = found[1.1].chatter % 25.0
    assert min(abs(seen - beat), abs(25.0 - seen - beat)) < 1.0
