"""What pip installs holds all that the package reads: templates, bundled machines, headers, stubs."""

from __future__ import annotations

import importlib.util
import itertools
import json
import re
import tomllib
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement

import feeddrive
import sbom

ROOT = Path(__file__).parents[1]
SOURCE = Path(feeddrive.__file__).parent


def test_a_wheel_holds_every_file_of_the_package() -> None:
    """The build backend lists what it would pack, without a build; `.gitignore` counts there."""
    packed = {Path(each.path).resolve() for each in WheelBuilder(str(ROOT)).recurse_included_files()}
    there = {path.resolve() for path in SOURCE.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert {path.suffix for path in there} >= {".py", ".pyi", ".toml", ".j2", ".html", ".css", ".h", ".c"}
    assert SOURCE / "py.typed" in there
    assert there - packed == set()


@pytest.mark.parametrize(
    ("clone", "built", "needed"),
    [
        (True, True, True),
        (True, False, True),
        (False, False, True),
        (False, True, False),
    ],
)
def test_node_is_taken_as_a_package_wherever_the_page_is_built_and_the_machine_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clone: bool, built: bool, needed: bool
) -> None:
    """In a clone the page is always built, since it may be older than its sources; a source distribution holds it."""
    monkeypatch.setenv("PATH", str(tmp_path))
    if clone:
        (tmp_path / ".git").touch()
    if built:
        (tmp_path / "src/feeddrive/studio/page").mkdir(parents=True)
        (tmp_path / "src/feeddrive/studio/page/index.html").touch()
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    hatch_build = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hatch_build)
    hook = hatch_build.PageHook(str(tmp_path), {}, None, None, str(tmp_path), "wheel")
    assert bool(hook.dependencies()) == needed


@pytest.fixture(scope="module")
def editable(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An editable wheel: it has the metadata of a released one, and needs no page."""
    return Path(
        next(WheelBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("dist")), versions=["editable"]))
    )


def test_the_metadata_of_the_wheel_names_the_licenses_of_bundled_parts(editable: Path) -> None:
    """The text of each is in the wheel; the page bundles the packages that package.json depends on."""
    stated = sbom.metadata_of(editable)
    assert stated["License-Expression"] == "MIT AND BSD-2-Clause"
    named = stated.get_all("License-File")
    assert named == ["LICENSE", "licenses/FMI-headers.txt", "licenses/uPlot.txt"]
    with zipfile.ZipFile(editable) as packed:
        folder = f"feeddrive-{stated['Version']}.dist-info/licenses"
        texts = {name: packed.read(f"{folder}/{name}").decode() for name in named}
    assert texts["LICENSE"] == (ROOT / "LICENSE").read_text(encoding="utf-8")
    page = json.loads((ROOT / "page/package.json").read_text(encoding="utf-8"))
    assert [name.lower() for name in page["dependencies"]] == ["uplot"]
    assert "Leon Sorokin" in texts["licenses/uPlot.txt"]
    installed = ROOT / "page/node_modules/uplot/LICENSE"
    if installed.is_file():
        assert texts["licenses/uPlot.txt"] == installed.read_text(encoding="utf-8")
    # each header has the text of its license, whose conditions are the same in all
    words = " ".join(texts["licenses/FMI-headers.txt"].partition("Redistribution")[2].split("-----")[0].split())
    for header in sorted((SOURCE / "export/fmi/headers").glob("*.h")):
        assert words in " ".join(header.read_text(encoding="utf-8").split()), header.name


def test_the_lock_has_a_hash_for_all_that_the_package_names() -> None:
    """What pyproject.toml names is in locks/dev.txt within its bounds; if this fails, run make lock."""
    packages: dict[str, list[sbom.Locked]] = {}
    for package in sbom.locked(sbom.LOCK.read_text(encoding="utf-8")):
        assert package.hashes, package.name
        packages.setdefault(package.name, []).append(package)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = [*project["dependencies"], *itertools.chain(*project["optional-dependencies"].values())]
    for requirement in map(Requirement, named):
        if requirement.name != "feeddrive":
            for package in packages[sbom.normal(requirement.name)]:
                assert requirement.specifier.contains(package.version), requirement


def test_the_bill_of_materials_names_what_is_in_the_wheel_and_what_it_needs(editable: Path) -> None:
    page = json.loads((ROOT / "page/package-lock.json").read_text(encoding="utf-8"))
    lock = sbom.LOCK.read_text(encoding="utf-8")
    stated = sbom.metadata_of(editable)
    whole = sbom.bill(stated, "0" * 64, lock, page, datetime(2026, 1, 2, tzinfo=UTC))
    by_name = {part["name"]: part for part in whole["components"]}
    assert {name for name, part in by_name.items() if "scope" not in part} == {"uplot", "FMI headers"}
    required = {name for name, part in by_name.items() if part.get("scope") == "required"}
    # some of them named, some needed by those that are named
    assert required >= {"numpy", "scipy", "llvmlite", "markupsafe", "fonttools", "pillow"}
    assert by_name["distributed"]["scope"] == by_name["msgpack"]["scope"] == "optional"
    assert not {"pytest", "ruff", "mkdocs", "playwright"} & by_name.keys()
    refs = [part["bom-ref"] for part in whole["components"]]
    assert len(set(refs)) == len(refs)
    for row in whole["dependencies"]:
        assert set(row["dependsOn"]) <= set(refs)
    assert {row["ref"] for row in whole["dependencies"]} >= {
        part["purl"] for part in by_name.values() if "scope" in part
    }
    assert all(part["externalReferences"][0]["hashes"] for part in by_name.values() if "scope" in part)
    assert whole["metadata"]["timestamp"] == "2026-01-02T00:00:00Z"
    # a package that the lock lacks is named, not left out
    with pytest.raises(SystemExit, match=r"dev\.txt lacks llvmlite: run  make lock"):
        sbom.bill(stated, "0" * 64, re.sub(r"(?m)^llvmlite==.*", "other==1 \\\\", lock), page, datetime.now(UTC))
