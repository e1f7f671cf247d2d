"""The export of a law that commands a velocity: other units and names, and the targets that take it."""

from __future__ import annotations

from pathlib import Path

import pytest

import feeddrive as fd
from feeddrive.export.targets import TARGETS
from feeddrive.files.machine import machine_of_text
from feeddrive.language.errors import ParameterError

MACHINE = machine_of_text(
    """
sample_time_us = 1000
[axis.x.plant]
kind = "rigid"
mass_kg = 60
[axis.x.actuator.velocity_loop]
Kp = 9e3
Tn_ms = 20
[axis.x.control]
velocity_limit = 0.4
[axis.x.control.law]
kind = "position_loop"
Kv = 40
velocity_feedforward = 0.95
[axis.x.control.guard]
following_error_limit_mm = 2
velocity_limit = 0.5
travel_least = -0.3
travel_most = 0.3
""",
    "machine.toml",
)


@pytest.mark.parametrize("target", ["c", "st"])
def test_it_computes_the_velocity_of_the_simulator_to_the_bit(tmp_path: Path, target: str) -> None:
    fd.write_export(MACHINE, target, tmp_path / "out")
    # 20,000 random samples with trips, broken numbers and changes of the parameters
    if target == "c":
        found = fd.export.verify_export(tmp_path / "out", samples=20_000)
        assert found.holds
        assert found.worst["commanded_velocity"] == 0.0
    text = "".join(each.read_text(encoding="utf-8") for each in (tmp_path / "out").rglob("*") if each.is_file())
    assert "commanded_velocity" in text


@pytest.mark.parametrize("target", sorted(set(TARGETS) - {"c", "st"}))
def test_a_target_of_forces_is_refused(tmp_path: Path, target: str) -> None:
    with pytest.raises(ParameterError, match=r"commanded by velocities.*the control can be exported to c, st"):
        fd.write_export(MACHINE, target, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_its_plant_is_not_exported(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="--plant: the drive of axis x is commanded by velocities"):
        fd.write_export(MACHINE, "fmu2", tmp_path / "out", plant=True)


def test_the_picture_of_a_run_shows_the_commanded_velocity() -> None:
    run = fd.simulate(MACHINE.loop("x"), fd.blocks.Polynomial7(distance=0.02, travel_time=0.2))
    panel = fd.plot.run_chart(run).panels[1]
    assert "commanded" in panel.label
    # mm/s: 0.02 m in 0.2 s reach 35/16 of the mean of 0.1 m/s
    assert max(panel.curves[0].y) == pytest.approx(100.0 * 35 / 16, rel=0.03)
