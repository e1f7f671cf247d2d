"""Kinematics against LinuxCNC's own, run in a real HAL: joints and tip of random positions agree to 1e-12 m."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from feeddrive.export.linuxcnc_session import halrun, stream_pin
from feeddrive.path.kinematics import Kinematics
from hal_programs import needs_linuxcnc

pytestmark = needs_linuxcnc

# kinematics are functions of a module, not of a thread: a component beside them calls both with what it is given
CALLER = """\
component kinscall "Call the kinematics that are loaded";
pin in float j#[6];
pin in float w#[6];
pin out float tip#[6];
pin out float joint#[6];
function _ fp;
license "GPL";
;;
#include "kinematics.h"
FUNCTION(_) {
    double joints[16] = {0};
    EmcPose pose = {{0}};
    KINEMATICS_FORWARD_FLAGS forward = 0;
    KINEMATICS_INVERSE_FLAGS inverse = 0;
    int k;
    for (k = 0; k < 6; k++) joints[k] = j(k);
    kinematicsForward(joints, &pose, &forward, &inverse);
    tip(0) = pose.tran.x; tip(1) = pose.tran.y; tip(2) = pose.tran.z;
    tip(3) = pose.a; tip(4) = pose.b; tip(5) = pose.c;
    pose.tran.x = w(0); pose.tran.y = w(1); pose.tran.z = w(2);
    pose.a = w(3); pose.b = w(4); pose.c = w(5);
    pose.u = pose.v = 0; pose.w = j(5);
    kinematicsInverse(&pose, joints, &inverse, &forward);
    for (k = 0; k < 6; k++) joint(k) = joints[k];
}
"""
SAME = 1e-12  # m: positions of 1 m have a last digit of 1e-16 m, and both sides add some ten products
LENGTH = 0.085  # m, of the tool

CASES = {
    "xyzac-trt-kins": (
        # x y z of a point on both axes; A lies further by the offsets, C does not
        {"x-rot-point": 0.11, "y-rot-point": -0.07, "z-rot-point": 0.23, "y-offset": 0.013, "z-offset": -0.031},
        Kinematics.of(
            "table_table", "AC", (0.0, -0.057, 0.199), (0.11, -0.07, 0.0), tool_length=LENGTH, reversed_joints="AC"
        ),
    ),
    "xyzbc-trt-kins": (
        {"x-rot-point": 0.11, "y-rot-point": -0.07, "z-rot-point": 0.23, "x-offset": 0.013, "z-offset": -0.031},
        Kinematics.of(
            "table_table", "BC", (0.123, 0.0, 0.199), (0.11, -0.07, 0.0), tool_length=LENGTH, reversed_joints="BC"
        ),
    ),
    # the tool's length is its joint W; B counts against ISO 841
    "5axiskins": (
        {"pivot-length": 0.25},
        Kinematics.of("head_head", "CB", (0.0, 0.0, 0.25), (0.0, 0.0, 0.25), tool_length=LENGTH, reversed_joints="B"),
    ),
}


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The folder of the component, and that of the runs, which share what was compiled."""
    return tmp_path_factory.mktemp("component"), tmp_path_factory.mktemp("run")


@pytest.mark.parametrize("module", CASES)
def test_joints_and_tip_are_those_of_linuxcnc(module: str, folders: tuple[Path, Path]) -> None:
    numbers, kinematics = CASES[module]
    table = module != "5axiskins"
    rng = np.random.default_rng(29)
    n = 400
    linear, tip = rng.uniform(-0.5, 0.5, (2, 3, n))
    degrees = rng.uniform(-175.0, 175.0, (2, n))
    rotary = np.radians(degrees)
    # joints X Y Z and the two rotary ones, then W; a world pose has A B C
    joints = np.stack([*linear, *degrees, np.full(n, 0.0 if table else LENGTH)])
    letters = [kinematics.rotary_letters.index(x) if x in kinematics.rotary_letters else None for x in "ABC"]
    # the tool's length is added to the programmed z before a table's kinematics see it
    added = np.array([0.0, 0.0, LENGTH if table else 0.0])[:, None]
    world = np.stack([*(tip + added), *(np.zeros(n) if k is None else degrees[k] for k in letters)])
    component, run = folders
    if not (component / "kinscall.comp").exists():
        (component / "kinscall.comp").write_text(CALLER, encoding="utf-8")
    pins = [*(f"j{i}" for i in range(6)), *(f"w{i}" for i in range(6))]
    taken = [*(f"tip{i}" for i in range(6)), *(f"joint{i}" for i in range(6))]
    wiring = [
        f"loadrt {module}" + ("" if table else " coordinates=xyzbcw"),
        *(f"setp {module}.{name} {value!r}" for name, value in numbers.items()),
        *([f"setp {module}.tool-offset {LENGTH!r}"] if table else []),
        "loadrt kinscall",
        "addf kinscall.0 servo-thread",
        *(f"net in{i} {stream_pin(i)} => kinscall.0.{pin}" for i, pin in enumerate(pins)),
        *(f"net out{i} kinscall.0.{pin} => sampler.0.pin.{i}" for i, pin in enumerate(taken)),
    ]
    ran = halrun(
        [component / "kinscall.comp"],
        run,
        1_000_000,
        wiring,
        np.vstack([joints, world]).T,
        "f" * 12,
        "f" * 12,
    )
    theirs = ran.rows.T
    assert np.abs(theirs[3 + np.array([k for k in range(3) if letters[k] is not None])] - degrees).max() == 0.0
    assert np.abs(theirs[:3] - added - np.array(kinematics.tip(linear, rotary))).max() < SAME
    assert np.abs(theirs[6:9] - np.array(kinematics.linear(tip, rotary))).max() < SAME
