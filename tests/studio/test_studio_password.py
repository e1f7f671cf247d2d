"""The password of a page on the network: from a file that is its owner's, or standard input, and never an argument."""

from __future__ import annotations

import io
import os
import re
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from feeddrive.cli.commands import OFFERED, app, offered
from feeddrive.language.errors import FeeddriveError, FileError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.studio import command as command_of_studio
from feeddrive.studio.command import StudioRequest, studio
from feeddrive.studio.protection import read_password
from feeddrive.study.store import place
from feeddrive.workflow.command import fields_of

WORD = "seventeen räder & 4"


def kept(folder: Path, content: bytes, mode: int = 0o600) -> Path:
    path = folder / "password"
    path.write_bytes(content)
    path.chmod(mode)
    return path


@pytest.mark.parametrize("end", ["", "\n", "\r\n", "\nsecond line\n"])
def test_the_first_line_of_a_file_is_the_password(end: str, tmp_path: Path) -> None:
    assert read_password(kept(tmp_path, f"{WORD}{end}".encode())) == WORD


def test_standard_input_gives_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(f"{WORD}\nrest".encode())))
    assert read_password(Path("-")) == WORD


def test_a_terminal_is_asked_without_an_echo(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setattr("sys.stdin", Terminal())
    monkeypatch.setattr("getpass.getpass", lambda _prompt: WORD)
    assert read_password(Path("-")) == WORD


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"elevenchars\n", "its first line has 11 characters: a password has 12 to 300"),
        (b"\n" + WORD.encode(), "its first line has 0 characters"),
        (b"x" * 301, "its first line has 301 characters"),
        (b"\xff" * 20, "its first line is no text in UTF-8"),
    ],
)
def test_what_is_no_password_is_refused_without_being_shown(content: bytes, words: str, tmp_path: Path) -> None:
    path = kept(tmp_path, content)
    with pytest.raises(ParameterError, match=re.escape(f"--password-file {path}: {words}")) as refused:
        read_password(path)
    assert "elevenchars" not in str(refused.value)


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
@pytest.mark.parametrize("mode", [0o644, 0o640, 0o604, 0o602])
def test_a_file_that_others_may_read_is_refused(mode: int, tmp_path: Path) -> None:
    path = kept(tmp_path, WORD.encode(), mode)
    with pytest.raises(ParameterError, match=rf"other users of this machine .* \(mode {mode:o}\): chmod 600 {path}"):
        read_password(path)


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="nowhere"):
        read_password(tmp_path / "nowhere")


def test_the_page_is_protected_by_the_password_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its door has the password, and its address no token."""
    (tmp_path / "index.html").write_text("", encoding="utf-8")
    doors, remarks = list[Any](), list[str]()

    class Said(Progress):
        def remark(self, text: str) -> None:
            remarks.append(text)

    monkeypatch.setattr(command_of_studio, "PAGE", tmp_path)
    monkeypatch.setattr(command_of_studio, "make_app", lambda _bench, door, *_, **__: doors.append(door))
    monkeypatch.setattr(command_of_studio, "serve", lambda _app, _at, ready: ready())
    path = kept(tmp_path, WORD.encode())
    request = StudioRequest(host="0.0.0.0", port=0, no_browser=True, folder=tmp_path / "f", password_file=path)
    studio.run(request, Said())
    assert [door.password for door in doors] == [WORD]
    assert len(remarks) == 2
    assert "token" not in remarks[1]
    assert WORD not in "".join(remarks)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--host", "0.0.0.0"), "give a --password-file too"),
        (("--password-file", "-", "--follow", "-"), "both read standard input"),
        (("--password", WORD), "No such option: --password"),
    ],
)
def test_what_cannot_be_is_refused(words: tuple[str, ...], said: str) -> None:
    done = CliRunner().invoke(app, ["studio", *words])
    text = str(done.exception) if isinstance(done.exception, FeeddriveError) else done.output
    assert said in text
    assert done.exit_code != 0


def test_no_option_of_any_command_is_a_secret() -> None:
    """Every user of the machine can read a command line: a secret is a file or comes from standard input."""
    secret = re.compile(r"password|passphrase|secret|credential|token")
    options = [(name, field) for name in OFFERED for field in fields_of(offered(name).request)]
    assert not [(name, field) for name, field in options if field.kind is not Path and secret.search(field.name)]


@pytest.mark.parametrize("address", ["ftp://joe:hunter2@example.com/rows", "simplecache::sftp://joe:hunter2@host/rows"])
def test_an_address_with_a_password_is_refused_without_it(address: str) -> None:
    with pytest.raises(FileError, match=r"joe:\.\.\.@.* holds a password, .* FSSPEC_S?FTP_PASSWORD") as refused:
        place(address)
    assert "hunter2" not in str(refused.value)
