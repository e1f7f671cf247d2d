"""`feeddrive commission` in csv: a position loop around the velocity loop of a drive, whose gains nobody told."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_commission import TEXT, Drive

import feeddrive as fd
import unknown_drives as ud
from feeddrive.bus.drive_file import drive_of, read_drive
from feeddrive.bus.live import BusAxis
from feeddrive.bus.virtual_bus import VirtualEtherCAT
from feeddrive.files.toml_file import parse_toml
from feeddrive.language.errors import ParameterError


@pytest.mark.slow(reason="60 s: the whole chain on a drive of unknown gains")
@pytest.mark.parametrize("seed", [302])
def test_the_whole_chain_in_csv_is_proven_on_a_drive_that_it_does_not_know(tmp_path: Path, seed: int) -> None:
    unknown = ud.draw(seed)
    axis = BusAxis(read_drive(unknown.write(tmp_path)), transport=lambda _: unknown.transport(), paced=False)
    found = fd.commission(axis, mode="csv", out=tmp_path / "out", progress=unknown.person())
    assert found.kept, found.refusal
    assert found.trial is not None
    # the bar of the command: within 10 % of what was predicted
    assert found.trial.ratio("following_rms") == pytest.approx(1.0, abs=0.1)
    assert found.trial.ratio("stiffness") == pytest.approx(1.0, abs=0.1)
    assert not unknown.excursions()
    law = fd.read_machine(tmp_path / "out" / "8_tune" / "machine.toml").loop("x").control.law
    assert law.kind == "position_loop"


def test_two_drives_of_a_gantry_are_not_commissioned_by_velocities(tmp_path: Path) -> None:
    text = TEXT.replace('mode = "csp"', 'mode = "csv"')
    assert text != TEXT
    first, second = (
        BusAxis(drive_of(parse_toml(each, name)), lambda _: VirtualEtherCAT(Drive().firmware), paced=False)
        for each, name in ((text, "first.toml"), (TEXT, "second.toml"))
    )
    with pytest.raises(ParameterError, match=r'first\.toml: mode = "csv": the drives of a gantry'):
        fd.commission(first, second=second, out=tmp_path / "out")


def test_a_bound_of_the_noise_of_a_force_is_refused_of_a_drive_that_takes_velocities(tmp_path: Path) -> None:
    text = TEXT.replace('mode = "csp"', 'mode = "csv"')
    drive = Drive()
    axis = BusAxis(drive_of(parse_toml(text, "drive.toml")), lambda _: VirtualEtherCAT(drive.firmware), paced=False)
    with pytest.raises(ParameterError, match="--max-noise bounds the noise of a commanded force"):
        fd.commission(axis, max_noise=3.0, out=tmp_path / "out")
    # before anything is written or moves
    assert not (tmp_path / "out").exists()
