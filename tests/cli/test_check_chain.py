"""The chain log -> machine file -> certificate, export -> verification: a single edit anywhere is named.

The log is of the foreign simulator. Edits are drawn: of bytes, and, in a certificate, of values under a new digest.
"""

from __future__ import annotations

import copy
import json
import random
import re
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
import foreign_axis as fa
from feeddrive import cli
from feeddrive.certificate import check as checker

COMPILER = next((found for name in ("gcc", "cc", "clang") if (found := shutil.which(name))), None)
T = 1e-3
CERTIFICATE, EXPORT, RECORD = "proven/certificate.json", "code", "verified.txt"
LOG, IDENTIFIED, MACHINE = "lathe.csv", "identified.toml", "lathe.toml"

Edit = tuple[str, Callable[[], None]]
"""The file that an edit changes, and the function that changes it."""


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the foreign simulator, and all that is made of it."""
    folder = tmp_path_factory.mktemp("chain")
    axes = fa.Axes(
        mass=37.0, viscous=55.0, coulomb_positive=14.0, coulomb_negative=14.0, noise_log=0.05, resolution=1e-6
    )
    moves = fa.smooth_moves(T, (0.08, 0.0) * 2, 0.2, 2.0, 80.0, 0.15, 0.2)
    law = fa.Cascade(Kv=21.0, Kp=4100.0)
    log = fa.simulate(axes, law, moves, T, np.random.default_rng(88), count=1).log(0)
    columns = np.column_stack([log["time"], 1e3 * log["setpoint"], 1e3 * log["position"], log["force"]])
    head = "time (s),target (mm),actual (mm),thrust (N)"
    np.savetxt(folder / LOG, columns, delimiter=",", header=head, comments="", fmt="%.9g")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        fd.workflow.identify(LOG, out="found")
        shutil.move("found/machine.toml", IDENTIFIED)
        fd.workflow.adjust(IDENTIFIED, guard="following_error_limit=0.004,velocity_limit=0.9", out=MACHINE)
        fd.workflow.certify(MACHINE, out="proven")
        fd.workflow.export(MACHINE, target="c", out=EXPORT)
        if COMPILER is not None:
            fd.workflow.verify(EXPORT, samples=300, out=RECORD)
    return folder


@pytest.fixture
def copied(chain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    place = tmp_path / "chain"
    shutil.copytree(chain, place)
    monkeypatch.chdir(place)
    return place


def words(*more: str) -> list[str]:
    record = ["--verified", RECORD] if Path(RECORD).exists() else []
    sources = ["--source", IDENTIFIED, "--source", LOG]
    return ["check", CERTIFICATE, "--machine", MACHINE, "--export", EXPORT, *record, *sources, *more]


Run = Callable[[list[str]], tuple[int, str]]


@pytest.fixture
def run(copied: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `feeddrive` beside the files: exit code, and all that it says in one line."""

    def called(arguments: list[str]) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["feeddrive", *arguments])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return int(ended.value.code or 0), " ".join("".join(capsys.readouterr()).split())

    return called


def test_a_chain_that_nobody_touched_belongs_together(run: Run) -> None:
    code, said = run(words())
    assert (code, "The files belong together" in said, "BROKEN" in said) == (0, True, False), said
    links = (LOG, IDENTIFIED), (IDENTIFIED, MACHINE), ("certificate.json", MACHINE), (EXPORT, MACHINE)
    assert [link for link in links if ", ".join(link) not in said] == []
    assert "Not given" not in said
    _, said = run(["check", CERTIFICATE, "--machine", MACHINE])
    assert f"Not given, and not compared: {IDENTIFIED}" in said


def typed(path: str, place: random.Random) -> None:
    """One character of a file becomes another one."""
    file = Path(path)
    content = bytearray(file.read_bytes())
    spots = [k for k, byte in enumerate(content) if chr(byte).isalnum()]
    at = place.choice(spots)
    content[at] = ord(place.choice([c for c in "0123456789abcdefgh" if ord(c) != content[at]]))
    file.write_bytes(content)


def renewed(change: Callable[[dict[str, Any]], None]) -> None:
    """A certificate with a changed value, and the digest of its new content."""
    document = json.loads(Path(CERTIFICATE).read_text(encoding="utf-8"))
    change(document)
    document["sha256"] = checker.digest(document)
    Path(CERTIFICATE).write_text(json.dumps(document, indent=1), encoding="utf-8")


def scaled(document: dict[str, Any], path: tuple[Any, ...], factor: float) -> None:
    *inner, last = path
    for key in inner:
        document = document[key]
    value = document[last]
    document[last] = (float.fromhex(value) * factor).hex() if isinstance(value, str) else value * factor


def values_of(document: dict[str, Any]) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of the numbers whose change makes it a certificate of something else."""
    for name, value in document["control"]["parameters"].items():
        if value:
            yield "control", "parameters", name
    for name, value in document["numbers"].items():
        if float.fromhex(value):
            yield "numbers", name
    matrices = [("control",), ("plants", 0, "model")]
    for where in matrices:
        entry: Any = document
        for key in where:
            entry = entry[key]
        for name in "ABCD":
            for i, row in enumerate(entry[name]):
                yield from ((*where, name, i, k) for k, value in enumerate(row) if float.fromhex(value))
    yield ("sample_time_s",)
    yield ("velocity",)
    yield from (("plants", 0, "radius", k, "r", 0) for k in range(len(document["plants"][0]["radius"])))


def halved_gains(document: dict[str, Any]) -> None:
    """The command of half the gains: its matrices and its parameters, all of them true of each other."""
    for name in ("C", "D"):
        for row in document["control"][name]:
            row[:] = [(0.5 * float.fromhex(x)).hex() for x in row]
    document["control"]["parameters"]["law.Kp"] *= 0.5


def drawn(count: int, seed: int) -> Iterator[Edit]:
    place = random.Random(seed)
    document = json.loads(Path(CERTIFICATE).read_text(encoding="utf-8"))
    paths = [*values_of(document)]
    files = [LOG, IDENTIFIED, MACHINE, CERTIFICATE, f"{EXPORT}/export.json"]
    inside = sorted(str(file) for file in Path(EXPORT).iterdir() if file.suffix in (".c", ".h", ".md", ".toml"))
    record = [RECORD] if Path(RECORD).exists() else []
    for k in range(count):
        match k % 4:
            case 0:
                file = place.choice([*files, *record])
                yield file, lambda file=file: typed(file, place)
            case 1:
                path, factor = place.choice(paths), place.choice([0.5, 1.01, 2.0])
                yield CERTIFICATE, lambda path=path, factor=factor: renewed(lambda d: scaled(d, path, factor))
            case 2:
                file = place.choice(inside)
                yield file, lambda file=file: typed(file, place)
            case _:
                file = place.choice([*inside, *files])
                yield file, lambda file=file: Path(file).write_bytes(Path(file).read_bytes() + b"\n# x\n")


def edited(edits: Iterator[Edit], run: Run) -> int:
    count = 0
    for file, change in edits:
        count += 1
        kept = {name: Path(name).read_bytes() for name in {file}}
        change()
        assert Path(file).read_bytes() != kept[file]
        code, said = run(words())
        assert code != 0, f"{file}: {said}"
        assert "The files belong together" not in said
        assert Path(file).name in said, f"{file} is not named: {said}"
        Path(file).write_bytes(kept[file])
    return count


def test_single_edits_are_named(run: Run) -> None:
    assert edited(drawn(32, 5), run) == 32


@pytest.mark.slow(reason="300 edits at 0.15 s; 32 of another seed are checked quickly")
def test_three_hundred_single_edits_are_named(run: Run) -> None:
    assert edited(drawn(300, 6), run) == 300


def test_half_the_gains_under_a_new_digest_are_proven_and_named(run: Run) -> None:
    renewed(halved_gains)
    # the reserve is another one, too, and the checker computes it; without it this is a true certificate
    assert run(["check", CERTIFICATE])[0] == 1
    document = json.loads(Path(CERTIFICATE).read_text(encoding="utf-8"))
    document["plants"][0]["reserve"] = None
    renewed(lambda d: d.update(copy.deepcopy(document)))
    assert run(["check", CERTIFICATE])[0] == 0
    code, said = run(words())
    assert (code, "other matrices" in said, "law.Kp = " in said) == (1, True, True), said


def test_a_machine_file_of_another_axis_is_named(run: Run) -> None:
    code, said = run(["check", CERTIFICATE, "--machine", IDENTIFIED])
    assert code == 1
    # the guard is no part of the linear law, whose matrices are the same
    assert ("guard.velocity_limit" in said, "other matrices" in said) == (True, False), said
    # three of its five parameters are named, and twelve digits of a digest
    assert "2 more parameters" in said
    assert re.search(r"SHA-256 [0-9a-f]{12}\.\.\.", said)


@pytest.mark.parametrize(("factor", "same"), [(1.0 + 0.7e-9, True), (1.0 + 1.4e-9, False)])
def test_matrices_are_the_same_up_to_rounding(run: Run, factor: float, same: bool) -> None:
    """Other versions of numpy round otherwise, by some 1e-15: a change of 1e-9 of the largest number is another one."""
    document = json.loads(Path(CERTIFICATE).read_text(encoding="utf-8"))
    row = [abs(float.fromhex(x)) for x in document["control"]["D"][0]]
    renewed(lambda d: scaled(d, ("control", "D", 0, row.index(max(row))), factor))
    code, said = run(words())
    assert (code, "other matrices" in said) == ((0, False) if same else (1, True)), said


def test_a_certificate_without_velocity_is_of_five_hundredths(run: Run) -> None:
    """Those of earlier versions did not state it, and the text of their plants does."""
    renewed(lambda d: d.pop("velocity"))
    assert run(words())[0] == 0


def test_a_machine_with_another_sample_time_is_named(run: Run) -> None:
    """Its filters cannot run at the sample time of the certificate, at which nothing can be computed again."""
    code, said = run(["check", CERTIFICATE, "--machine", "ball_screw"])
    assert (code, "These files do not belong together" in said, "cannot be computed again" in said) == (
        1,
        True,
        True,
    ), said


def test_single_precision_needs_its_own_certificate(run: Run) -> None:
    shutil.rmtree(EXPORT)
    fd.workflow.export(MACHINE, target="c", precision="float", out=EXPORT)
    code, said = run(["check", CERTIFICATE, "--machine", MACHINE, "--export", EXPORT])
    assert (code, "certify with --arithmetic float32" in said) == (1, True), said
    fd.workflow.certify(MACHINE, arithmetic="float32", out="proven")
    assert run(["check", CERTIFICATE, "--machine", MACHINE, "--export", EXPORT])[0] == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--export", EXPORT], "--export and --source are compared with the machine file: give it as --machine FILE"),
        (["--machine", MACHINE, "--verified", RECORD], "give its directory as --export DIR"),
        (["--machine", MACHINE, "--export", "proven"], "holds no export.json"),
        (["--machine", MACHINE, "--source", "nowhere.csv"], "nowhere.csv: cannot be read"),
        (["--machine", CERTIFICATE], "certificate.json"),
    ],
)
def test_options_that_lack_a_file_are_refused(run: Run, arguments: list[str], message: str) -> None:
    code, said = run(["check", CERTIFICATE, *arguments])
    assert (code, message in said) == (2, True), said
    assert "Traceback" not in said
