"""Files that a page works on: each is the one that it is called, also if others came after it or share its name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.files.frf import write_frf
from feeddrive.files.machine import BUNDLED
from feeddrive.language.errors import ParameterError
from feeddrive.loop.frequency_response import FRF
from feeddrive.studio.bench import bench_of, bench_of_responses
from feeddrive.tuning.by_hand import ByHand
from feeddrive.tuning.operating_point import modelled_point

_TITLE = fd.read_machine("ball_screw").name


def loaded(path: Path, mass: float) -> Path:
    """The bundled machine with another load, kg, under the same title."""
    text = (BUNDLED / "machines" / "ball_screw.toml").read_text(encoding="utf-8")
    assert text.count("mass_load_kg = 33\n") == 1
    path.parent.mkdir(exist_ok=True)
    path.write_text(text.replace("mass_load_kg = 33\n", f"mass_load_kg = {mass}\n"), encoding="utf-8")
    return path


def test_machines_at_other_places_are_points_of_their_own_also_under_one_title(tmp_path: Path) -> None:
    others = [loaded(tmp_path / each / "other.toml", 99.0) for each in ("one", "two")]
    bench = bench_of("ball_screw", at=[*others, loaded(tmp_path / "heavy.toml", 60.0)])
    points = bench.by_hand.points
    names = [each.name for each in points]
    assert names == [_TITLE, f"{_TITLE} (other)", f"{_TITLE} (other, 2)", f"{_TITLE} (heavy)"]
    masses = [each.loop.axis.plant.mass_load for each in points if each.loop is not None]  # type: ignore[union-attr]
    assert masses == [33.0, 99.0, 99.0, 60.0]
    drawn = [bench.overlays(each)[-1].drawn for each in names]
    found = [float(np.interp(20.0, each.frequency, np.abs(each.response))) for each in drawn if each is not None]
    assert found[1] == found[2]
    assert found[0] > 1.1 * found[3] > 1.1 * 1.1 * found[1]  # 163, 190 and 229 kg on the screw


def test_responses_at_other_places_are_points_of_their_own_also_under_one_file_name(tmp_path: Path) -> None:
    f = np.geomspace(1.0, 500.0, 200)
    paths = list[Path]()
    for name, mass in (("left", 100.0), ("right", 150.0)):
        (tmp_path / name).mkdir()
        paths.append(tmp_path / name / "frf.csv")
        write_frf(paths[-1], FRF(f, 1.0 / (mass * (2j * np.pi * f) ** 2), "force", "load", "m/N", 1e-3))
    bench = bench_of_responses(paths[0], at=paths[1:])
    assert [each.name for each in bench.by_hand.points] == ["frf", "frf (right)"]
    first, last = (bench.overlays(each.name)[-1].measured for each in bench.by_hand.points)
    assert first is not None
    assert last is not None
    np.testing.assert_allclose(np.abs(first.response / last.response), 1.5, rtol=1e-9)


def test_two_points_of_one_name_are_refused() -> None:
    loop = fd.read_machine("ball_screw").loop(None)
    point = modelled_point(loop, "here")
    with pytest.raises(ParameterError, match="names of their own, not here, here"):
        ByHand(loop.control, [point, replace(point, loop=None)])
