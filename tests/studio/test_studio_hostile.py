"""Files and requests of somebody who means ill, against the real server, whose every process is watched: nothing of
them is executed, and nothing is read or written outside the chosen folder.

What C libraries open by themselves is not seen; readers give pyarrow and HDF5 the bytes of a file, and no name.
"""

from __future__ import annotations

import ast
import gzip
import io
import json
import os
import re
import shlex
import struct
import sys
import tomllib
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import h5py
import matplotlib
import numpy as np
import pyarrow as arrow
import pytest
from pyarrow import parquet

from feeddrive.files.machine import BUNDLED
from feeddrive.studio.server import PAGE
from studio_server import Served, Talking, memory_of, needs_proc

pytestmark = pytest.mark.skipif(
    not (PAGE / "index.html").is_file(), reason="NOT TESTED: the page is not built: make page"
)
SECRET = "sesame_7319"
NASTY = "<img src=x onerror=alert(1)>\x1b[2J\x1b[31m"
MACHINE = (BUNDLED / "machines" / "linear_motor.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def outside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder beside the chosen one, with things that nobody named on purpose."""
    made = tmp_path_factory.mktemp("watched") / "outside"
    made.mkdir()
    (made / "secret.csv").write_text(f"t,{SECRET}\n0,1\n1,2\n", encoding="utf-8")
    (made / "secret.toml").write_text(MACHINE.replace("linear", SECRET), encoding="utf-8")
    (made / "secret.ngc").write_text(f"G1 X1 F100 ({SECRET})\n", encoding="utf-8")
    (made / "evil.py").write_text("open('executed', 'w').close()\n", encoding="utf-8")
    return made


@pytest.fixture(scope="module")
def served(outside: Path) -> Iterator[Served]:
    made = Served(outside.parent / "folder", "linear_motor", watched=True, cwd=outside)
    yield made
    if made.process.poll() is None:
        made.close()


def brought(served: Served, page: Talking, files: Mapping[str, bytes]) -> dict[str, str]:
    """Bring files and have them looked at: what is wrong with each, or what it is."""
    for name, content in files.items():
        assert served.upload(page.session, name, content) == (200, {"name": name})
    page.job = None
    assert "error" not in page.ask("import.look", names=[*files])
    job = page.ended()
    assert job["state"] == "done", job["error"]
    found = {each["name"]: str(each["wrong"] or each["kind"]) for each in page.ask("import.show")["files"]}
    return {name: found[name] for name in files}


def hdf5_links(outside: Path) -> bytes:
    """A file whose columns stand in another one: a link, a virtual column, an external column."""
    file = io.BytesIO()
    with h5py.File(file, "w") as made:
        made["t"] = np.arange(100.0)
        made["link"] = h5py.ExternalLink(str(outside / "secret.csv"), "/t")
        layout = h5py.VirtualLayout(shape=(100,), dtype="f8")
        layout[:] = h5py.VirtualSource(str(outside / "secret.csv"), "t", shape=(100,))
        made.create_virtual_dataset("virtual", layout)
        made.create_dataset("external", (16,), "u1", external=[(str(outside / "secret.csv"), 0, 16)])
    return file.getvalue()


def pickled(code: str) -> bytes:
    """An array of objects of numpy, which a careless reader executes."""

    class Evil:
        def __reduce__(self) -> tuple[Any, ...]:
            return exec, (code,)

    file = io.BytesIO()
    np.save(file, np.array([Evil()], dtype=object), allow_pickle=True)
    return file.getvalue()


def test_files_that_name_other_files_or_hold_code_are_refused_and_nothing_else_is_opened(
    served: Served, outside: Path
) -> None:
    code = "open('executed', 'w').close()"
    entity = f'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY e SYSTEM "{(outside / "secret.csv").as_uri()}">]><a>&e;</a>'
    laughs = (
        '<!DOCTYPE a [<!ENTITY a "'
        + "x" * 1000
        + '">'
        + "".join(f'<!ENTITY {b} "{f"&{a};" * 50}">' for a, b in zip("abcdef", "bcdefg", strict=True))
        + "]><a>&g;</a>"
    )
    secret = json.dumps(str(outside / "secret.toml"))
    wanted = {
        "job.toml": (f'machine = {secret}\n[program]\nfile = "secret.ngc"\n', "no machine file"),
        "up.toml": ('machine = "../../../outside/secret.toml"\n[log]\nfile = "../../secret.csv"\n', "no machine file"),
        "include.toml": (f"include = {secret}\n" + MACHINE, "include"),
        "within.toml": (MACHINE + f"\n[machine]\nfile = {secret}\n", "machine"),
        "deep.toml": ("x = " + "[" * 100_000, "deep"),
        "entity.xml": (entity, "XML"),
        "laughs.xml": (laughs, "XML"),
        "object.npy": (pickled(code), "objects"),
        "code.py": (code, "code.py"),
        "cut.uff": ("    -1\n    58\n", "universal file"),  # its reader needs a file of its own
        "links.mat": (hdf5_links(outside), "log"),
        "call.ngc": ("o<secret> call\nM98 P/secret\nG1 X1 F100\n", "part program"),
    }
    with served.page("names") as page:
        files = {name: text if isinstance(text, bytes) else text.encode() for name, (text, _) in wanted.items()}
        for name, found in brought(served, page, files).items():
            assert wanted[name][1] in found, f"{name}: {found}"
            assert SECRET not in found
        shown = json.dumps({**page.ask("import.pick", name="links.mat"), "numbers": None})
        assert SECRET not in shown
        assert "a link to another place" in shown
        assert shown.count("stored in another file") == 2


def test_names_in_requests_stay_in_the_folder(served: Served, outside: Path) -> None:
    session = "requests"
    names = ["../../outside/secret.csv", str(outside / "secret.csv"), "..\\..\\outside\\secret.csv", "secret.csv", "."]
    with served.page(session) as page:
        brought(served, page, {"mine.csv": b"t_s,x\n0,1\n1,2\n"})
        (mine,) = served.folder.glob("*/brought/mine.csv")
        own = mine.parents[1]
        if sys.platform != "win32":  # somebody with access to the folder may have put links there
            names.append("linked.csv")
            (own / "brought" / "linked.csv").symlink_to(outside / "secret.csv")
            (own / "linked.toml").symlink_to(outside / "secret.toml")
            assert served.result(session, "linked.toml")[0] == 404
            assert served.upload(session, "linked.csv", b"overwritten")[0] == 400
        for name in names:
            assert served.result(session, name)[0] == 404
            for do in (
                "import.look",
                "import.axis",
                "import.identify",
                "program.plan",
                "program.text",
                "export.result",
                "export.export",
                "scope.follow",
            ):
                said = page.ask(do, name=name, names=[name], target=name, at=[name])
                assert "error" in said, do
                assert SECRET not in json.dumps(said["error"])
        for name, place in (("optimize.set", "value"), ("compare.choose", "laws")):
            evil = f"{outside / 'evil.py'}:Evil"
            page.job = None
            said = page.ask(name, **{"field": "law", place: evil if place == "value" else [evil], "starts": 1})
            if name == "optimize.set" and "error" not in said:
                page.ask("optimize.tune")
                assert page.ended()["state"] == "failed"
            else:
                assert "error" in said
    assert SECRET in (outside / "secret.csv").read_text(encoding="utf-8")
    assert not (outside / "executed").exists()


def bombs() -> dict[str, bytes]:
    """Small files that hold much: by name."""
    zeros = zlib.compressobj(9, zlib.DEFLATED, 31)
    piece = b"0,0\n" * 1_000_000
    gz = gzip.compress(b"t,x\n") + b"".join([*(zeros.compress(piece) for _ in range(150)), zeros.flush()])
    table = io.BytesIO()
    parquet.write_table(arrow.table({"t": np.zeros(30_000_000)}), table, compression="zstd")
    hdf5 = io.BytesIO()
    with h5py.File(hdf5, "w") as made:
        made.create_dataset("x", (10**12,), "f8", chunks=(10**6,), fillvalue=0.0)  # stored nowhere
    head = "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }"
    npy = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head) + 1) + head.encode() + b"\n"
    return {
        "gzip.csv.gz": gz,
        "parquet.parquet": table.getvalue(),
        "hdf5.mat": hdf5.getvalue(),
        "numpy.npy": npy,
        "nested.gz": gzip.compress(gzip.compress(gzip.compress(b"0" * 1_000_000))),
        "zip.xlsx": b"PK\x03\x04" + b"0" * 99,
    }


@needs_proc
def test_zip_bombs_are_refused_with_bounded_memory(served: Served) -> None:
    before, files = served.memory(), bombs()
    assert all(len(content) < 3_000_000 for content in files.values())
    with served.page("bombs") as page:
        for name, said in brought(served, page, files).items():
            words = ("zip bomb", "once unpacked", "of an unknown kind", "ZIP archive", "more than the", "are stated")
            assert any(each in said for each in words), f"{name}: {said}"
    assert served.memory() - before < 60.0  # MB: only a process that ends with it reads a file
    peaks = [1e-3 * int(what[1]) for what in served.kept() if what[0] == "peak"]
    assert max(peaks) < 900.0


@needs_proc
@pytest.mark.parametrize("promised", [True, False])
def test_an_upload_of_a_gigabyte_is_refused_while_it_arrives(served: Served, promised: bool) -> None:
    piece, sent, most = b"x" * 1_000_000, 0, served.memory()
    before = most

    def pieces() -> Iterator[bytes]:
        nonlocal sent, most
        for _ in range(1_000):
            sent += 1
            if sent % 50 == 0:
                most = max(most, memory_of(served.process.pid))
            yield piece

    status, said = served.upload("gigabyte", "big.csv", pieces(), 1_000_000_000 if promised else None)
    assert status == 413
    assert "larger than 256 MB: take a shorter piece of the log" in said["error"]
    assert sent < (20 if promised else 300)
    assert most - before < 60.0
    assert not list(served.folder.rglob("*big.csv*"))


def test_names_in_files_do_nothing_in_answers_and_in_the_recipe(served: Served, outside: Path) -> None:
    evil = """$(touch executed)`touch executed`'";touch executed#"""
    title = "<img src=x onerror=alert(1)> \U0001f600"
    machine = re.sub(r"\[axis\.x", lambda _: f"[axis.{json.dumps(evil)}", MACHINE)
    machine = re.sub(r"^name = .*$", lambda _: f'name = "{title}"', machine, flags=re.MULTILINE)
    log = io.BytesIO()
    parquet.write_table(
        arrow.table({"t_s": 1e-3 * np.arange(99), NASTY: np.sin(np.arange(99)), evil: np.ones(99)}), log
    )
    with served.page("words") as page:
        found = brought(served, page, {"run.parquet": log.getvalue(), "named.toml": machine.encode()})
        assert found == {"run.parquet": "log", "named.toml": "machine"}
        page.ask("import.role", name="run.parquet", column=NASTY, role="position", unit="\x1b[31mmm")
        page.job = None
        if "error" not in page.ask("import.identify", name="run.parquet"):
            assert NASTY not in str(page.ended()["error"])
        said = page.ask("import.axis", name="named.toml")
        assert "error" not in said
        values = page.ask("tune.show")["values"]
        assert "error" not in page.ask("tune.move", name="law.Kp", value=0.9 * values["law.Kp"])
        page.job = None
        assert "error" not in page.ask("prove.certify")
        job = page.ended()
        assert job["state"] == "done", job["error"]
        found = page.ask("export.show")
    words = shlex.split(found["commands"])
    assert [words[i + 1] for i, each in enumerate(words) if each == "--axis"] == [evil] * 2
    calls = [each for each in ast.walk(ast.parse(found["python"])) if isinstance(each, ast.Call)]
    given = [key.value for each in calls for key in each.keywords if key.arg == "axis"]
    assert [each.value for each in given if isinstance(each, ast.Constant)] == [evil] * 2
    job = tomllib.loads(found["job_file"])
    assert job["axis"] == evil
    assert job["title"].startswith(title)
    assert [*job["law"][0]["set"]] == [f"axis.{evil}.control.law.Kp"]


def test_in_all_this_nothing_was_opened_written_or_begun_that_is_not_of_feeddrive(
    served: Served, outside: Path
) -> None:
    """The last of this file: what the processes of the server did in all tests before."""
    said = served.close()
    assert "\x1b" not in said
    assert "Traceback" not in said
    kept = served.kept()
    own = str(served.folder) + os.sep
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "feeddrive"
    caches = (str(cache), matplotlib.get_cachedir(), matplotlib.get_configdir())  # machine code, fonts
    written = {what[1] for what in kept if what[0] == "write"}
    assert [each for each in written if not each.startswith((own[:-1], *caches)) and each != os.devnull] == []
    assert any(each.startswith(own) for each in written)  # it was watched
    touched = {what[1] for what in kept if what[0] == "read"}
    assert [each for each in touched if each.startswith(str(outside) + os.sep)] == []
    assert any(each.startswith(own) for each in touched)
    assert {what[1] for what in kept if what[0] == "begin"} <= {
        sys.executable,
        "uname",
    }  # Python asks for the processor
    assert not any("evil" in what[1] for what in kept if what[0] == "import")
    assert not any(what[0] == "connect" for what in kept)
    assert not (outside / "executed").exists()
