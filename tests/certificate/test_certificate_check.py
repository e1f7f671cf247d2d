"""The checker: it needs nothing but Python, and refuses whatever was changed, damaged or claimed too high."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import feeddrive as fd
from feeddrive.certificate import check
from feeddrive.language.errors import FileError, NotCertifiedError
from fresh_draws import Seeded

Document = dict[str, Any]


@pytest.fixture(scope="module")
def text() -> str:
    """Of the linear motor, with measured lines."""
    loop = fd.read_machine("linear_motor").loop("x")
    f = np.arange(10.0, 2000.0, 10.0)
    P = fd.linearize(loop, ["cut"], ["reading_load"]).response(f)
    rng = np.random.default_rng(7)
    s = 0.02 * np.abs(P.response)
    noise = s * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / np.sqrt(2.0)
    frf = fd.FRF(f, P.response + noise, "force", "reading_load", "m/N", float(loop.sample_time), None, s**2)
    return fd.certificate.certify_loop(loop, {"model": loop, "measured": [loop, frf]}, arithmetic="float32").text()


def said(path: Path, *, program: Path | None = None) -> tuple[int, str]:
    command = [sys.executable, "-m", "feeddrive.certificate.check"]
    command = command if program is None else [sys.executable, "-I", str(program)]
    done = subprocess.run([*command, str(path)], capture_output=True, text=True, timeout=120, check=False)
    assert not done.stderr
    return done.returncode, done.stdout


def test_a_copy_of_the_checker_alone_proves_it(text: str, tmp_path: Path) -> None:
    """Isolated from this package and from every other one: the file imports the standard library alone."""
    (tmp_path / "loop.json").write_text(text)
    program = tmp_path / "check_alone.py"
    program.write_text(Path(check.__file__).read_text())
    assert "feeddrive." not in "".join(line for line in program.read_text().split("\n") if "import" in line)
    code, words = said(tmp_path / "loop.json", program=program)
    assert code == 0
    assert "PROVEN: plants: 2, coefficients: float32" in words
    assert "saturation" in words
    assert "199 measured lines inside" in words
    assert said(tmp_path / "loop.json")[0] == 0


def changed(text: str, change: Callable[[Document], None], *, signed: bool = True) -> Document:
    document = json.loads(text)
    change(document)
    return {**document, "sha256": check.digest(document)} if signed else document


def times(hexadecimal: str, factor: float) -> str:
    return (float.fromhex(hexadecimal) * factor).hex()


def larger_gain(document: Document) -> None:
    D = document["control"]["D"][0]
    D[:] = [times(x, 1.3) for x in D]


def unstable(document: Document) -> None:
    for name in ("C", "D"):
        document["control"][name] = [[times(x, 30.0) for x in line] for line in document["control"][name]]


def wider(document: Document) -> None:
    document["plants"][0]["radius"][0]["r"][0] *= 1.002


def narrower(document: Document) -> None:
    for band in document["plants"][1]["radius"]:
        band["r"][0] *= 0.3
    document["plants"][1]["reserve"] /= 0.3


def without_step(document: Document) -> None:
    del document["plants"][1]["radius"][0]


def shorter(document: Document) -> None:
    document["plants"][0]["radius"][-1]["to_Hz"] *= 0.9


def more_reserve(document: Document) -> None:
    document["plants"][0]["reserve"] *= 1.01


def less_reserve(document: Document) -> None:
    document["plants"][0]["reserve"] *= 0.98


def moved_line(document: Document) -> None:
    document["plants"][1]["lines"][0][50][1] *= 2.0


def noisier_line(document: Document) -> None:
    document["plants"][1]["lines"][0][50][3] *= 400.0


def surer(document: Document) -> None:
    document["confidence"] = 1.0 - 1e-9


def other_sample_time(document: Document) -> None:
    document["sample_time_s"] = (1.5 * float.fromhex(document["sample_time_s"])).hex()


def fewer_digits(document: Document) -> None:
    document["numbers"]["control.law.Kp"] = times(document["numbers"]["control.law.Kp"], 1.0 + 2.0**-40)


def other_version(document: Document) -> None:
    document["version"] = 2


def other_format(document: Document) -> None:
    document["format"] = "something else"


def a_decimal(document: Document) -> None:
    document["control"]["A"][0][0] = 1.0


def huge(document: Document) -> None:
    document["control"]["D"][0][0] = "0x1.0p+1023"


def beyond_all(document: Document) -> None:
    document["control"]["D"][0][0] = "0x1.0p+9999"


def ragged(document: Document) -> None:
    document["control"]["A"][0].append("0x0.0p+0")


def no_plants(document: Document) -> None:
    document["plants"] = []


def no_outside(document: Document) -> None:
    del document["outside"]


def silent(document: Document) -> None:
    document["outside"] = ["nothing"]


def direct(document: Document) -> None:
    document["plants"][0]["model"]["D"][0][0] = "0x1.0p-10"


def a_word(document: Document) -> None:
    document["plants"][0]["reserve"] = "much"


def a_list(document: Document) -> None:
    document["plants"][0] = []


CHANGES = [
    (larger_gain, "not stable"),
    (unstable, "not stable"),
    (wider, r"r\|L\| is 1 of \|1 \+ L\|"),
    (narrower, "line at .* is outside of r"),
    (without_step, "gap"),
    (shorter, "not at half the sample rate"),
    (more_reserve, "of |reserve"),
    (less_reserve, "reserve"),
    (moved_line, "line at 510 Hz is outside"),
    (noisier_line, "line at 510 Hz is outside"),
    (surer, "outside of r"),
    (other_sample_time, "half the sample rate"),
    (fewer_digits, "Kp is not a number of float32"),
    (other_version, "version"),
    (other_format, "no certificate"),
    (a_decimal, "hexadecimal"),
    (huge, "out of range"),
    (beyond_all, "out of range"),
    (ragged, "length"),
    (no_plants, "no plant"),
    (no_outside, "its entry 'outside' is missing"),
    (silent, "saturation and friction as outside"),
    (direct, "responds without delay"),
    (a_word, "reserve is not a number"),
]


@pytest.mark.parametrize(("change", "reason"), CHANGES, ids=[change.__name__ for change, _ in CHANGES])
def test_a_changed_certificate_is_refused(change: Callable[[Document], None], reason: str, text: str) -> None:
    """Even when its digest was made anew; with the old one already for that."""
    with pytest.raises(check.RefusedError, match=reason):
        check.verified(changed(text, change))
    with pytest.raises(check.RefusedError):
        check.verified(changed(text, change, signed=False))


def test_every_number_counts(text: str, seeded: Seeded) -> None:
    """Any one character that changes a value is noticed, if only by the digest."""
    rng = np.random.default_rng(seeded(0))
    numbers = json.loads(text)
    for place in rng.integers(0, len(text), 60):
        old = text[place]
        if old.isspace():
            continue
        new = text[:place] + ("7" if old != "7" else "3") + text[place + 1 :]
        if is_json(new) and json.loads(new) == numbers:
            continue  # the 17th digit of a decimal number may leave its float64 as it is
        with pytest.raises(check.RefusedError):
            check.verified(check.parse(new.encode()))


def is_json(text: str) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[: len(text) // 2],
        lambda _: "",
        lambda _: "no JSON at all",
        lambda _: "[1, 2]",
        lambda _: "null",
        lambda text: text.replace('"version": 1', '"version": NaN'),
        lambda text: text.replace('"confidence": 0.95', '"confidence": Infinity'),
        lambda text: text.replace('"version": 1', '"version": 1, "version": 1'),
        lambda _: "[" * 100_000,
        lambda _: '{"format": "feeddrive certificate", "version": ' + "9" * 10_000 + "}",
        lambda text: text.replace('"plants"', '"\\ud800"'),
        lambda text: "\x00" + text,
    ],
)
def test_what_is_no_certificate_is_refused_in_one_line(damage: Callable[[str], str], text: str, tmp_path: Path) -> None:
    path = tmp_path / "loop.json"
    path.write_text(damage(text))
    code, words = said(path)
    assert code == 1
    assert words.startswith("REFUSED: ")
    assert words.count("\n") == 1
    with pytest.raises(FileError, match="refused"):
        fd.read_certificate(path)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    code, words = said(tmp_path / "none.json")
    assert code == 1
    assert "none.json cannot be read: " in words


@pytest.mark.parametrize("entry", ["sha256", "plants"])
def test_an_entry_that_is_missing_is_named(entry: str, text: str, tmp_path: Path) -> None:
    path, document = tmp_path / "loop.json", json.loads(text)
    del document[entry]
    path.write_text(json.dumps(document))
    code, words = said(path)
    assert code == 1
    assert f"loop.json: its entry '{entry}' is missing: take the file as feeddrive certify wrote it, or" in words


def test_what_is_built_otherwise_is_refused_in_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "loop.json"
    for name in ("plants", "control", "numbers", "outside", "confidence"):
        for value in (None, 3, "x", [[]], {}):
            document = copy.deepcopy(json.loads(text))
            document[name] = value
            document["sha256"] = check.digest(document)
            path.write_text(json.dumps(document))
            code = check.main([str(path)])
            # that no number is listed takes nothing from the proof
            assert code == 1 or (name, value) == ("numbers", {}), (name, value)
    a = changed(text, a_list)
    path.write_text(json.dumps(a))
    assert check.main([str(path)]) == 1
    assert check.main([str(tmp_path / "nothing.json")]) == 1
    assert check.main([]) == 1


def test_files_are_written_and_read_only_if_they_are_proven(text: str, tmp_path: Path) -> None:
    found = fd.certificate.certify_loop(fd.read_machine("emps").loop("x"))
    path = fd.write_certificate(tmp_path / "emps.json", found)
    again = fd.read_certificate(path)
    assert again.document == found.document
    assert str(again) == str(found)
    wrong = fd.certificate.Certificate(changed(text, wider))
    with pytest.raises(NotCertifiedError, match="not certified"):
        fd.write_certificate(tmp_path / "wrong.json", wrong)
    assert not (tmp_path / "wrong.json").exists()
