"""Every command that reads a file, given one of another kind: one line with its name, what it is or lacks, a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from feeddrive.cli.commands import app
from feeddrive.files.machine import BUNDLED
from feeddrive.language.errors import FeeddriveError

WRONG = {
    "machine.toml": (BUNDLED / "machines" / "emps.toml").read_text(encoding="utf-8"),
    "job.toml": (BUNDLED / "jobs" / "emps.toml").read_text(encoding="utf-8"),
    "roles.toml": '[log]\nfile = "log.csv"\n[log.channels]\nforce = "f"\n',
    "drive.toml": 'interface = "eth1"\n',
    "log.csv": "time_s,position_m,force_N\n" + "".join(f"{0.001 * k},{k},1\n" for k in range(60)),
    "certificate.json": '{"format": "another"}',
    "part.ngc": "G1 X1 F100\nM2\n",
    "picture.png": "\x89PNG\r\n\x1a\n\x00",
    "empty.toml": "",
}
MACHINES = ("job.toml", "roles.toml", "log.csv", "certificate.json", "part.ngc", "picture.png", "empty.toml")
LOGS = ("machine.toml", "job.toml", "certificate.json", "part.ngc", "picture.png", "empty.toml")
# the command with FILE in place of the file, and the kinds that it cannot take
COMMANDS = {
    "tune FILE --out OUT": MACHINES,
    "compare FILE --out OUT": MACHINES,
    "certify FILE --out OUT": MACHINES,
    "export FILE --target c --out OUT": MACHINES,
    "excite FILE --band 10..100 --amplitude 10 --out OUT": MACHINES,
    "virtual-drive FILE --interface vcan7": MACHINES,
    "iterate FILE --out OUT": MACHINES,
    "run FILE --out OUT": ("machine.toml", *MACHINES[1:]),
    "cosimulate FILE FILE --out OUT": ("machine.toml", *MACHINES[1:]),
    "channels FILE": LOGS,
    "identify FILE --out OUT": LOGS,
    "friction FILE --velocity v:m/s --force f:N --out OUT": LOGS,
    "cogging FILE --position x:m --force f:N --out OUT": LOGS,
    "frf FILE --input force --output position_load --out OUT": LOGS,
    "prefilter FILE --job FILE --out OUT": LOGS,
    "play FILE --drive FILE --yes --out OUT": ("machine.toml", *MACHINES[1:]),
    "listen --drive FILE --out OUT": ("machine.toml", *MACHINES[1:]),
    "follow FILE --timeout 0.2 --out OUT": LOGS,
    "check FILE": tuple(WRONG),
    "verify FILE": tuple(WRONG),
}


@pytest.mark.parametrize("words", COMMANDS)
def test_a_file_of_another_kind_is_named_and_nothing_is_written(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in COMMANDS[words]:
        Path(name).write_bytes(WRONG[name].encode("latin-1" if name.endswith("png") else "utf-8"))
        asked = words.replace("FILE", name).replace("OUT", "out").split()
        done = CliRunner().invoke(app, asked)
        assert done.exit_code != 0, (asked, done.output)
        assert isinstance(done.exception, FeeddriveError | SystemExit), (asked, done.exception)
        said = str(done.exception) if isinstance(done.exception, FeeddriveError) else done.output
        assert name in said, (asked, said)
        assert len(said.strip().split("\n")) == 1, (asked, said)
        assert not Path("out").exists(), asked


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("export job.toml --target c", "is a job, not a machine file; it names a machine file"),
        ("run machine.toml", "is a machine file, not a job; it has sections [axis.NAME]"),
        ("tune roles.toml", "is roles of a log's columns, not a machine file; `feeddrive channels` writes it"),
        ("tune log.csv --law dadsc", "log.csv"),
        ("channels machine.toml", "is a TOML file, not a log that can be read"),
        ("check job.toml", "job.toml: it is no certificate; give the certificate.json that `feeddrive certify` wrote"),
        ("run part.ngc", "is no TOML text; a job is wanted here: it names a machine file"),
        ("listen --drive machine.toml", "is a machine file, not a drive file"),
    ],
)
def test_the_kind_and_the_remedy_are_said(
    words: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in WRONG.items():
        Path(name).write_bytes(text.encode("latin-1" if name.endswith("png") else "utf-8"))
    done = CliRunner().invoke(app, words.split())
    assert said in f"{done.output} {done.exception}"
