"""Completion in a shell: commands, options, the values of choices, bundled names, and files."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MAIN = "import sys; sys.argv[0] = 'feeddrive'; from feeddrive.cli import main; main()"


def program(folder: Path) -> Path:
    """A program `feeddrive` of this source tree."""
    path = folder / "bin" / "feeddrive"
    path.parent.mkdir()
    path.write_text(f'#!/bin/sh\nexec {sys.executable} -c "{MAIN}" "$@"\n', encoding="utf-8")
    path.chmod(0o755)
    return path


def environment(program: Path, **more: str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT / "src"), "PATH": f"{program.parent}:{os.environ['PATH']}", **more}


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not there")
def test_bash_completes(tmp_path: Path) -> None:
    """By the script that `--install-completion` installs, in a bash."""
    feeddrive, work = program(tmp_path), tmp_path / "work"
    work.mkdir()
    for name in ("s_part.ngc", "screw.toml"):
        (work / name).write_text("", encoding="utf-8")
    (work / "s_old").mkdir()
    script = subprocess.run(
        [str(feeddrive)], env=environment(feeddrive, _FEEDDRIVE_COMPLETE="source_bash"),
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    words = {
        "do": {"doctor"},
        "plan s_": {"s_curve", "s_curve_vectors", "s_old/", "s_part.ngc"},
        "plan blade --machine tr": {"trunnion_ac"},
        "tune ball_screw --goal st": {"stiffness"},
    }
    lines = [script]
    for line in words:
        parts = ["feeddrive", *line.split()]
        lines.append(f"COMP_WORDS=({' '.join(parts)}); COMP_CWORD={len(parts) - 1}; COMPREPLY=()")
        lines.append('_feeddrive_completion feeddrive; echo "${COMPREPLY[*]}"')
    done = subprocess.run(
        ["bash", "--norc", "-c", "\n".join(lines)], cwd=work, env=environment(feeddrive),
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert [set(line.split()) for line in done.stdout.splitlines()] == list(words.values())
