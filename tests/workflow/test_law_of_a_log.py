"""`feeddrive identify --law`: the law that ran is known by its numbers, and no machine file says it."""

from __future__ import annotations

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.identification.motion.motion_log import MotionLog
from feeddrive.language import tree
from feeddrive.language.errors import ParameterError

_T, _MASS = 5e-4, 120.0
_RIGHT = "cascade_ppi:Kv=40,Kp=2.5e4,Tn=0.02"


@pytest.fixture(scope="module")
def log() -> MotionLog:
    """Two strokes of a rigid axis under a cascade with an integral, which no search finds, and two samples late."""
    blocks = fd.blocks
    loop = fd.Loop(
        axis=fd.Axis(
            plant=blocks.Rigid(mass=_MASS),
            friction_load=blocks.Coulomb(coulomb=60.0, viscous=300.0),
            actuator=blocks.Actuator(dead_time=2.0 * _T),
            encoder_load=blocks.Encoder(resolution=1e-7, noise=5e-8),
        ),
        control=fd.Control(law=blocks.CascadePPI(Kv=40.0, Kp=2.5e4, Tn=0.02)),
        sample_time=_T,
    )
    moves = [
        blocks.SnapLimitedMove(
            distance=d, velocity=v, acceleration=a, jerk=40.0, snap=2000.0, back=True, dwell_before=0.1, dwell_after=0.1
        )
        for d, v, a in ((0.2, 0.5, 3.0), (0.05, 0.1, 1.5))
    ]
    reference = np.concatenate([each.at(np.arange(round(each.duration / _T)) * _T).position for each in moves])
    run = fd.simulate(loop, blocks.Recorded(position=reference, sample_time=_T), seed=3)
    rows = slice(0, reference.size)
    return MotionLog(
        name="log", position=run["reading_load"][rows], force=run["force"][rows], set_position=reference, sample_time=_T
    )


def test_the_loop_is_known_whole_with_the_law_and_by_the_log_alone(log: MotionLog) -> None:
    alone = fd.identify(log).loop
    assert alone is not None
    gains = dict(tree.leaves(alone.control.law))
    # Kv and 1/Tn may change places: no log can tell (docs/how_to/identification.md)
    assert sorted((gains["Kv"], 1.0 / gains["Tn"])) == pytest.approx((40.0, 50.0), rel=0.01)
    assert gains["Kp"] == pytest.approx(2.5e4, rel=0.01)
    found = fd.identify(log, law=_RIGHT)
    assert found.loop is not None
    assert found.unusable == ""
    law = dict(tree.leaves(found.loop.control.law))
    assert (law["Kv"], law["Kp"], law["Tn"]) == (40.0, 2.5e4, 0.02)
    assert float(found.loop.axis.actuator.dead_time) == pytest.approx(2.0 * _T)
    mass = next(each for each in found.refinement.estimates if each.name.endswith("mass"))
    assert abs(mass.value - _MASS) < 4.0 * mass.error


def test_another_law_than_the_one_that_ran_is_refused(log: MotionLog) -> None:
    found = fd.identify(log, law="cascade_ppi:Kv=80,Kp=2.5e4,Tn=0.02")
    assert "not the law that ran" in found.unusable


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"law": _RIGHT, "machine": "emps"}, "leave one of them out"),
        ({"law": "cascade_ppi:Kv=40"}, "needs Kp in N s/m"),
        ({"law": "cascade_ppi:Kv=40,Kp=2e4,Ki=3"}, "no number 'Ki'"),
        ({"law": "cascade_ppi:Kv=-1,Kp=2e4"}, "must be > 0"),
    ],
)
def test_a_law_that_cannot_be_says_why(log: MotionLog, given: dict[str, str], reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        fd.identify(log, **given)
