"""A law is one file: the one of CONTRIBUTING, put into a copy of the sources, and nothing else is touched."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import feeddrive
from slow_share import all_but

ROOT = Path(__file__).parents[1]
READ = """
import feeddrive as fd
from feeddrive.blocks.catalogue import members
from feeddrive.blocks.families import Law
from feeddrive.tuning.candidates import candidates

assert fd.blocks.SmithLaw is members(Law)["smith_law"] and "SmithLaw" in dir(fd.blocks)
loop = fd.read_machine("machine.toml").loop("x")
assert loop.control.law.held == 0.25
assert "smith law" in {each.name for each in candidates(loop)[0]}
fd.write_export("machine.toml", "c", "exported")
fd.write_export("machine.toml", "st", "exported_st")
assert fd.export.verify_export("exported", samples=200).holds
"""
MACHINE = """\
sample_time_us = 100
[axis.x.plant]
kind = "rigid"
mass_kg = 100
[axis.x.control]
force_limit_N = 500
[axis.x.control.law]
kind = "smith_law"
Kv = 20
Kp = 2000
held = 0.25
[axis.x.control.guard]
following_error_limit_mm = 2
"""
# what knows all blocks: floors and stubs, the battery, the glossary, the rules of exports
ROWS = {
    "test_architecture.py": "public_names or stubs or dir or arrow or step_laws or concrete_block",
    "test_battery.py": "SmithLaw or smith_law",
    "test_glossary.py": "every",
    "export/test_export_rules.py": "every_block",
}


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sources, tests and pages with one more file."""
    folder = tmp_path_factory.mktemp("clone")
    for name in ("src/feeddrive", "tests"):
        # with what is compiled of them: the times of files come along, and each process would compile all of it
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("page"))
    for page in ROOT.glob("*.[mt]*"):
        if page.is_file():
            shutil.copy(page, folder)
    code = next(re.finditer(r"```python\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text("utf-8"), re.DOTALL))[1]
    code = code.replace("share: Number", "held: Number").replace("self.share", "self.held")  # a name of its own
    (folder / "src/feeddrive/blocks/controller/smith_law.py").write_text(code, encoding="utf-8")
    (folder / "machine.toml").write_text(MACHINE, encoding="utf-8")
    return folder


def ran(clone: Path, *words: str) -> None:
    environment = {**os.environ, "PYTHONPATH": f"{clone / 'src'}{os.pathsep}{clone / 'tests'}"}
    done = subprocess.run(
        [sys.executable, *words], cwd=clone, env=environment, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


def test_a_law_of_one_file_is_read_tuned_exported_and_proven(clone: Path) -> None:
    assert not hasattr(feeddrive.blocks, "SmithLaw")
    if shutil.which("gcc") is None and shutil.which("cc") is None:
        pytest.skip("NOT TESTED: verifying the exported C needs a compiler: apt-get install gcc libc6-dev")
    ran(clone, "-c", READ)


@pytest.mark.parametrize("file", all_but(list(ROWS)[1:], ROWS, "the imports of all files are read once more: 7 s"))
def test_the_tests_that_know_all_blocks_pass_with_it(clone: Path, file: str) -> None:
    ran(clone, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", f"tests/{file}", "-k", ROWS[file])
