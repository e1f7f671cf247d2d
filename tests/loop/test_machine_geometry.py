"""Geometry errors of a machine: the tool point from the positions of the tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from feeddrive.blocks.coupling.geometry import Geometry
from feeddrive.blocks.coupling.straightness import Straightness
from feeddrive.blocks.reference.circle import Circle
from feeddrive.files.machine import machine_toml, read_machine
from feeddrive.language.errors import ParameterError, StructureError
from feeddrive.loop.linearize import linearize
from feeddrive.loop.machine import Machine
from feeddrive.loop.simulate import simulate

CIRCLE = {
    "x": Circle(radius=0.02, feed=0.1, turns=0.5, phase=90),
    "y": Circle(radius=0.02, feed=0.1, turns=0.5, phase=0),
}


def with_errors() -> tuple[Machine, Machine]:
    """The bundled table without and with errors of scale, squareness and straightness."""
    machine = read_machine("xy_table").machine()
    bow = Straightness(along="x", across="y", row=np.array([0.0, 3e-6, 0.0]), start=-0.02, spacing=0.02)
    geometry = Geometry(scale_x=3e-5, scale_y=-2e-5, squareness_xy=4e-5, straightness=(bow,))
    return machine, Machine.of(machine.loops(), geometry=geometry)


def test_the_tool_point_follows_from_the_tables():
    plain, machine = with_errors()
    alone, found = simulate(plain, CIRCLE), simulate(machine, CIRCLE)
    assert all(np.array_equal(alone[name], found[name]) for name in alone.signals)  # the axes do not see it
    x, y = found["x.position_load"], found["y.position_load"]
    bow = 3e-6 * (1.0 - np.minimum(np.abs(x) / 0.02, 1.0))
    assert found.units["tool.x"] == "m"
    assert np.max(np.abs(found["tool.x"] - (x * (1.0 + 3e-5) + 4e-5 * y))) < 1e-17  # m, an operation more
    assert np.max(np.abs(found["tool.y"] - (y * (1.0 - 2e-5) + bow))) < 1e-17


def test_the_tool_point_is_part_of_the_linear_model():
    """A millimeter of x is one and its scale error at the tool, a millimeter of y is the squareness."""
    _, machine = with_errors()
    tables = [f"{axis}.position_load" for axis in "xy"]
    model = linearize(machine, ["x.set_position", "y.set_position"], ["tool.x", *tables])
    for table, share in zip(tables, (1.0 + 3e-5, 4e-5), strict=True):
        given = f"{table[0]}.set_position"
        tool, alone = (model.response(np.array([5.0]), name, given).response[0] for name in ("tool.x", table))
        assert abs(tool / alone - share) < 1e-12  # rounding of two solutions of one linear system


def test_a_file_holds_it(tmp_path: Path):
    _, machine = with_errors()
    path = tmp_path / "table.toml"
    path.write_text(machine_toml(machine, "table"))
    again = read_machine(path).machine()
    assert again.signals() == machine.signals()
    assert again.geometry is not None
    assert again.geometry.squareness_xy == 4e-5
    wrong = path.read_text().replace('along_y = "y"', 'along_y = "b"')
    path.write_text(wrong)
    with pytest.raises(StructureError, match=r"table\.toml:\d+.*along_y: axis 'b' is not there"):
        read_machine(path)


def test_what_does_not_fit_is_refused():
    with pytest.raises(StructureError, match="different axes"):
        Geometry(along_y="x")
    with pytest.raises(StructureError, match="along and across are both x"):
        Geometry(straightness=(Straightness(along="x", across="x", row=np.zeros(2), start=0.0, spacing=1.0),))
    with pytest.raises(StructureError, match="no axis moves the tool along z"):
        Geometry(straightness=(Straightness(along="x", across="z", row=np.zeros(2), start=0.0, spacing=1.0),))
    machine, _ = with_errors()
    with pytest.raises(ParameterError, match=r"no signal 'tool\.x'"):
        simulate(machine, CIRCLE, record=["tool.x"])
    with pytest.raises(StructureError, match="cannot be named 'tool'"):
        Machine.of({**machine.loops(), "tool": machine.loop("x")}, geometry=Geometry())
