"""`feeddrive doctor`: what is there, what is missing with its remedy, and an installation that is broken."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from importlib import import_module, metadata
from pathlib import Path

import pytest

import feeddrive as fd
from feeddrive.language.progress import Progress
from feeddrive.workflow.doctor import EXTRAS, Installation, Part

doctor = import_module("feeddrive.workflow.doctor")

ROOT = Path(__file__).resolve().parents[2]
MAIN = "from feeddrive.cli import main; main()"


def parts() -> dict[str, Part]:
    found = doctor.doctor.run(doctor.DoctorRequest(), Progress()).result
    return {part.name: part for part in found.parts}


def test_every_extra_of_the_package_is_listed() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {*EXTRAS, *doctor.DEVELOPMENT} == set(project["optional-dependencies"])
    assert set(doctor.requirements()) - {""} == set(project["optional-dependencies"])
    assert {"numpy", "llvmlite", "typer"} <= set(doctor.requirements()[""])


def test_what_is_missing_has_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = metadata.version

    def version(name: str) -> str:
        if name == "pyuff":
            raise metadata.PackageNotFoundError(name)
        return whole(name)

    monkeypatch.setattr(metadata, "version", version)
    monkeypatch.setenv("PATH", "")
    found = parts()
    assert found["extra uff"] == ("extra uff", EXTRAS["uff"], "", "pip install 'feeddrive[uff]'", False)
    assert found["extra pandas"].found == f"pandas {whole('pandas')}"
    assert found["LinuxCNC"].remedy.startswith("apt-get install linuxcnc-uspace linuxcnc-uspace-dev gcc make")
    assert found["Cortex-M"].remedy == (
        "apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm make"
    )
    outcome = doctor.doctor.run(doctor.DoctorRequest(), Progress())
    assert not outcome.judgment.bad
    assert f"{len(outcome.result.missing)} optional parts are not there" in outcome.verdict
    assert outcome.then == "feeddrive demo"


@pytest.mark.parametrize(("package", "words"), [("numpy", ("check", "none.json")), ("pyarrow", ("doctor", "--json"))])
def test_a_package_that_cannot_be_imported_is_named(package: str, words: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / f"{package}.py").write_text("raise ImportError('libfast.so: no such file')\n", encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), str(ROOT / "src")])
    done = subprocess.run(
        [sys.executable, "-c", MAIN, *words],
        capture_output=True, text=True, encoding="utf-8", check=False, env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    if package == "numpy":
        assert done.stderr == (
            "feeddrive: error: the package numpy cannot be imported (libfast.so: no such file): "
            "run pip install --force-reinstall numpy\n"
        )
    else:
        record = json.loads(done.stdout)
        assert record["judgment"] == "does_not_work"
        assert "pyarrow: pip install --force-reinstall pyarrow   (ImportError: libfast.so" in record["verdict"]


def test_a_loop_that_does_not_run_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise OSError("no memory for machine code")

    monkeypatch.setattr(sys.modules["feeddrive.loop.simulate"], "simulate", fails)
    outcome = doctor.doctor.run(doctor.DoctorRequest(), Progress())
    assert outcome.judgment.exit_code == 1
    assert outcome.verdict.endswith("simulation: OSError: no memory for machine code.")


def test_it_is_called_from_python_too() -> None:
    assert isinstance(fd.workflow.doctor(), Installation)
