"""The log of the tour: always the same, and with the axis in it that was simulated."""

from __future__ import annotations

from pathlib import Path

import pytest

import feeddrive as fd
from feeddrive.language import tree
from feeddrive.workflow.tour import MACHINE, WORKPIECE, axis

_SURE = 4.0  # standard errors: a right interval leaves out one estimate of 16,000


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tour")
    fd.workflow.tour(out=folder / "tour")
    return folder / "tour" / "tour.csv"


def test_the_log_is_the_same_each_time(written: Path, tmp_path: Path) -> None:
    fd.workflow.tour(out=tmp_path / "again")
    assert (tmp_path / "again" / "tour.csv").read_bytes() == written.read_bytes()


def test_identification_finds_the_workpiece_and_the_friction_within_its_own_errors(written: Path) -> None:
    found = fd.identify(written, machine=MACHINE)
    assert found.refinement is not None
    loop, found_by_name = axis(), {each.name: each for each in found.refinement.estimates}
    for name, each in found_by_name.items():
        assert abs(each.value - float(tree.get(loop, name))) < _SURE * each.error, name
    at_load = found_by_name[f"{loop.place_of('axis')}.plant.mass_load"]
    assert at_load.error < 0.01 * WORKPIECE  # the workpiece is found, and not merely possible
