"""The job that is written beside a report runs again from there, however its file was written."""

from __future__ import annotations

import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

from feeddrive.files.job import read_job
from feeddrive.workflow.run_job import repeatable

_JOB = """
title = "file = 'no.ngc'"
rule = "as it is"
machine = {machine}  # machine = "none"
[program]
# file = "other.ngc"
{line}
[[law]]
name = "stiffer"
set = {{ "axis.x.control.law.Kv" = 80.0 }}
"""


@pytest.mark.parametrize(
    "line",
    [
        'file = "a part.ngc"',
        "file = 'a part.ngc'",
        'file = "a\\u0020part.ngc"  # file = "b.ngc"',
        '"file" = "a part.ngc"',
    ],
)
def test_a_program_is_found_again_however_it_is_quoted(tmp_path: Path, line: str) -> None:
    (tmp_path / "a part.ngc").write_text("G21 G90 G1 X5 F600\nX0\nM2\n", encoding="utf-8")
    (tmp_path / "job.toml").write_text(_JOB.format(machine="'xy_table'", line=line), encoding="utf-8")
    job = read_job(tmp_path / "job.toml")
    copy = repeatable(SimpleNamespace(job=job))  # type: ignore[arg-type]  # of the result only its job
    assert tomllib.loads(copy)["program"] == {"file": "a part.ngc"}
    assert tomllib.loads(copy)["machine"] == "machine.toml"
    assert tomllib.loads(copy)["title"] == "file = 'no.ngc'"
    assert '# file = "other.ngc"' in copy
