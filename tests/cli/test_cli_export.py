"""`feeddrive export` and `feeddrive verify` as a user meets them: the directory, the certificate, what is refused."""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
from pathlib import Path

import pytest
from typer.testing import CliRunner

from feeddrive.cli import main
from feeddrive.cli.commands import app
from feeddrive.export.design import LONGEST_TABLE
from feeddrive.files.machine import read_machine

needs_gcc = pytest.mark.skipif(
    shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc libc6-dev"
)
AXIS = """\
sample_time_us = 100
[axis.x.plant]
kind = "rigid"
mass_kg = 10
[axis.x.control]
force_limit_N = 500
[axis.x.control.law]
kind = "cascade_ppi"
Kv = {Kv}
Kp = 1000
"""
GUARD = "[axis.x.control.guard]\nfollowing_error_limit_mm = 2\n"


def said(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """What a command that must fail says, in one line and without a traceback."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["feeddrive", *words])
        with pytest.raises(SystemExit) as ended:
            main()
    assert ended.value.code not in (0, None)
    text = capsys.readouterr().err
    assert text.startswith("feeddrive: error: ")
    assert "Traceback" not in text
    return text


def exported(out: Path, *words: str) -> str:
    """What a command that must succeed says."""
    result = CliRunner().invoke(app, ["export", *words, "--out", str(out)])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    file = tmp_path / "machine.toml"
    file.write_text(AXIS.format(Kv=50) + GUARD, encoding="utf-8")
    return file


@needs_gcc
@pytest.mark.parametrize(
    "words",
    [
        [],
        pytest.param(["--header-only"], marks=pytest.mark.slow(reason="the same text in one file")),
        pytest.param(["--precision", "float"], marks=pytest.mark.slow(reason="the same proof in other numbers")),
    ],
)
def test_what_is_exported_verifies(words: list[str], tmp_path: Path) -> None:
    """The whole way: export, the README that is named, make, verify with a certificate in a file."""
    out = tmp_path / "c"
    assert str(out / "README.md") in exported(out, "ball_screw", "--target", "c", *words)
    made = subprocess.run(["make", "-C", str(out)], capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr
    assert "0 outputs differ" in made.stdout
    certificate = tmp_path / "certificate.txt"
    result = CliRunner().invoke(app, ["verify", str(out), "--samples", "2000", "--out", str(certificate)])
    assert result.exit_code == 0, result.output
    assert "EQUAL, bit for bit" in result.output
    text = certificate.read_text(encoding="utf-8")
    table, _, digest_of_text = text.rpartition("SHA-256 ")
    assert table.strip() in result.output
    assert hashlib.sha256(table.encode()).hexdigest() == digest_of_text.strip()
    digest = json.loads((out / "export.json").read_text(encoding="utf-8"))["machine"]["sha256"]
    assert digest[:16] in text


@needs_gcc
def test_a_machine_file_without_a_name_verifies(tmp_path: Path) -> None:
    """It has that of its file, which the copy in the export lost: "not what this feeddrive writes"."""
    file = tmp_path / "lathe.toml"
    file.write_text(AXIS.format(Kv=50) + GUARD, encoding="utf-8")
    exported(tmp_path / "c", str(file), "--target", "c")
    result = CliRunner().invoke(app, ["verify", str(tmp_path / "c"), "--samples", "200"])
    assert result.exit_code == 0, result.output


@needs_gcc
@pytest.mark.parametrize(
    ("target", "samples", "program", "package"),
    [
        ("linuxcnc", "3000", "halrun", "linuxcnc-uspace linuxcnc-uspace-dev"),
        pytest.param("fmu2", "3000", None, "", marks=pytest.mark.slow(reason="the other version of fmu3")),
        ("fmu3", "3000", None, ""),
        ("cortex-m", "300", "qemu-system-arm", "gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm"),
    ],
)
def test_every_target_is_verified_in_its_own_program(
    target: str, samples: str, program: str | None, package: str, tmp_path: Path
) -> None:
    """The component in a real HAL, the FMU in FMPy, the bundle on an emulated board: all bits of the simulation."""
    if program is not None and shutil.which(program) is None:
        pytest.skip(f"NOT TESTED: the target {target} needs {program}: apt-get install {package}")
    out = tmp_path / target
    exported(out, "linear_motor", "--target", target)
    result = CliRunner().invoke(app, ["verify", str(out), "--samples", samples])
    assert result.exit_code == 0, result.output
    assert "EQUAL, bit for bit" in result.output
    assert f"{samples}, seed 1" in result.output


def test_what_nothing_here_can_run_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for target, part in (("st", "axis_x_check.st"), ("parameters", "for a person to check")):
        exported(tmp_path / target, "linear_motor", "--target", target)
        assert part in said(capsys, "verify", str(tmp_path / target))


@needs_gcc
def test_altered_c_is_refused(machine: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A changed text is named and not compiled, also with a renewed digest; the simulator's answers differ besides."""
    out = tmp_path / "c"
    exported(out, str(machine), "--target", "c")
    source = out / "axis_x_configure.c"
    source.write_text(
        source.read_text(encoding="utf-8").replace("law_Kp = 1000.0", "law_Kp = 1000.25"), encoding="utf-8"
    )
    touched = tmp_path / "PWNED"
    with source.open("a", encoding="utf-8") as file:
        file.write(
            "#include <stdlib.h>\n__attribute__((constructor)) static void own(void)"
            f'{{ if (system("touch {touched}")) exit(1); }}\n'
        )
    words = "Nothing was compiled or run. It was written by feeddrive"
    text = said(capsys, "verify", str(out), "--samples", "2000")
    assert "axis_x_configure.c (edited)" in text
    assert words in text
    renewed(out, "axis_x_configure.c")
    text = said(capsys, "verify", str(out), "--samples", "2000")
    assert "axis_x_configure.c (not what this feeddrive writes)" in text
    assert words in text
    found = json.loads((out / "export.json").read_text(encoding="utf-8"))
    (out / "export.json").write_text(json.dumps(found | {"made_by": "feeddrive 0.0.7"}), encoding="utf-8")
    text = said(capsys, "verify", str(out), "--samples", "2000")
    assert "It was written by feeddrive 0.0.7, and this is feeddrive 0.1.0: verify it there" in text
    assert not touched.exists()


def renewed(out: Path, name: str) -> None:
    """The digest of a file in export.json as somebody would forge it."""
    found = json.loads((out / "export.json").read_text(encoding="utf-8"))
    found["files"][name] = hashlib.sha256((out / name).read_bytes()).hexdigest()
    (out / "export.json").write_text(json.dumps(found), encoding="utf-8")


@needs_gcc
def test_a_link_a_stranger_and_another_version_are_said(machine: Path, tmp_path: Path) -> None:
    """A text that is not run does not stop the proof; what is odd stands in the certificate, and its status is 1."""
    out = tmp_path / "c"
    exported(out, str(machine), "--target", "c")
    (tmp_path / "README.md").write_bytes((out / "README.md").read_bytes())
    (out / "README.md").unlink()
    (out / "README.md").symlink_to(tmp_path / "README.md")
    (out / "math.h").write_text("#error 'this would be included'\n", encoding="utf-8")
    result = CliRunner().invoke(app, ["verify", str(out), "--samples", "500"])
    assert result.exit_code == 1
    assert "files as written         no: README.md (a symbolic link)\n" in result.output
    assert "EQUAL, bit for bit, but CHANGED SINCE THE EXPORT" in result.output
    assert "files besides            math.h\n" in result.output
    assert "written by               feeddrive 0.1.0" in result.output


def test_an_edit_is_kept_when_it_is_exported_again(machine: Path, tmp_path: Path) -> None:
    """The wiring that its README says to write stays, and the new file stands beside it, every time and in words."""
    out = tmp_path / "linuxcnc"
    exported(out, str(machine), "--target", "linuxcnc")
    wiring, fresh = out / "axis_x.hal", (out / "axis_x.hal").read_text(encoding="utf-8")
    mine = fresh + "net card axis-x.force => hm2.0.pwmgen.00.value\n"
    wiring.write_text(mine, encoding="utf-8")
    for _ in range(2):
        text = " ".join(exported(out, str(machine), "--target", "linuxcnc").split())
        assert "axis_x.hal: was edited since the last export and is kept; the new file is axis_x.hal.new" in text
        assert wiring.read_text(encoding="utf-8") == mine
        assert (out / "axis_x.hal.new").read_text(encoding="utf-8") == fresh
    wiring.write_text(fresh, encoding="utf-8")  # taken over: there is nothing to keep any more
    assert "is kept" not in exported(out, str(machine), "--target", "linuxcnc")
    assert not (out / "axis_x.hal.new").exists()


@needs_gcc
def test_a_compiler_that_computes_otherwise_is_found(machine: Path, tmp_path: Path) -> None:
    """Two are refused by the header; one changes a bit, which the certificate says; -O3 changes none."""
    out = tmp_path / "c"
    exported(out, "ball_screw", "--target", "c")
    for flag in ("-ffast-math", "-funsafe-math-optimizations"):
        refused = CliRunner().invoke(app, ["verify", str(out), "--samples", "5000", "--flag", flag])
        assert refused.exit_code == 1
        assert f"compile without {flag}" in str(refused.exception)
    flag = "-fsingle-precision-constant"
    other = CliRunner().invoke(app, ["verify", str(out), "--samples", "5000", "--flag", flag])
    assert other.exit_code == 1
    assert flag in other.output
    assert "NOT EQUAL" in other.output
    strict = CliRunner().invoke(app, ["verify", str(out), "--samples", "5000", "--flag", "-O3"])
    assert strict.exit_code == 0, strict.output


@needs_gcc
@pytest.mark.skipif(shutil.which("cmake") is None, reason="NOT TESTED: the CMake build needs cmake: pip install cmake")
def test_cmake_builds_it_and_runs_the_self_test(machine: Path, tmp_path: Path) -> None:
    out = tmp_path / "c"
    exported(out, str(machine), "--target", "c")
    build = tmp_path / "build"
    for words in (["cmake", "-S", str(out), "-B", str(build)], ["cmake", "--build", str(build)]):
        subprocess.run(words, check=True, capture_output=True)
    subprocess.run(["ctest", "--test-dir", str(build), "--output-on-failure"], check=True, capture_output=True)


def test_the_text_is_that_of_the_machine_file(machine: Path, tmp_path: Path) -> None:
    """Units and meanings in the header, the law's source in the C, and nothing of the machine that wrote it."""
    out = tmp_path / "c"
    exported(out, str(machine), "--target", "c", "--name", "feed")
    header, source = ((out / f"feed.{end}").read_text(encoding="utf-8") for end in "hc")
    assert "1/s: position gain" in header
    T = float(read_machine(machine).loop("x").sample_time)
    assert f"#define FEED_SAMPLE_TIME {T!r} /* s, {T.hex()} */" in header
    assert "Altintas & Okwudire 2009" in source
    assert "const double law_velocity =" in source or "const double law_e =" in source
    assert (out / "machine.toml").read_text(encoding="utf-8") == machine.read_text(encoding="utf-8")
    for file in out.iterdir():
        assert str(tmp_path) not in file.read_text(encoding="utf-8"), file


def test_two_exports_are_the_same_to_the_byte(machine: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        exported(tmp_path / name, str(machine), "--target", "c")
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["--target", "matlab"], ["--target = 'matlab'", "is not a target", "c, linuxcnc"]),
        (["--target", "c", "--name", "float"], ["--name", "'float'", "word of"]),
        (["--target", "c", "--name", "my axis"], ["--name", "'my axis'", "letters"]),
        (["--target", "c", "--name", "a" * 60], ["--name", "60 characters", "47"]),
        (["--target", "c", "--precision", "half"], ["precision = 'half'", "double, float"]),
        (["--target", "c", "--joint", "1"], ["--joint", "means nothing for the target c"]),
        (["--target", "c", "--axis", "y"], ["axis 'y' is not there"]),
    ],
)
def test_what_makes_no_sense_is_refused(
    words: list[str], parts: list[str], machine: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new"
    text = said(capsys, "export", str(machine), *words, "--out", str(out))
    for part in parts:
        assert part in text
    assert not out.exists()


def test_a_directory_of_somebody_else_is_left_alone(
    machine: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine"
    out.mkdir()
    (out / "thesis.txt").write_text("years of work", encoding="utf-8")
    assert "was not written by feeddrive" in said(capsys, "export", str(machine), "--target", "c", "--out", str(out))
    assert [file.name for file in out.iterdir()] == ["thesis.txt"]


def test_a_gain_beyond_single_precision_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Kv · Kp of 1e41 is a number in double, none in float: the parameter, its value and the bound are named."""
    file = tmp_path / "huge.toml"
    file.write_text(AXIS.format(Kv="1e39") + GUARD, encoding="utf-8")
    text = said(capsys, "export", str(file), "--target", "c", "--precision", "float", "--out", str(tmp_path / "new"))
    for part in ("axis.x.control.law.Kv = 1e+39", "single precision", "3.4e38", "--precision double"):
        assert part in text
    assert not (tmp_path / "new").exists()


def test_a_table_that_no_flash_holds_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    forces = ", ".join(["1.0"] * (LONGEST_TABLE + 5))
    file = tmp_path / "long.toml"
    compensation = f'[[axis.x.control.compensation]]\nkind = "learned_force"\nforce = [{forces}]\n'
    file.write_text(AXIS.format(Kv=50) + GUARD + compensation, encoding="utf-8")
    text = said(capsys, "export", str(file), "--target", "c", "--out", str(tmp_path / "new"))
    assert f"{LONGEST_TABLE + 5} numbers, 5 more than the {LONGEST_TABLE}" in text


@pytest.mark.parametrize(
    ("damage", "part"),
    [
        (lambda out: (out / "export.json").unlink(), "holds no export.json"),
        (lambda out: (out / "export.json").write_text("{", encoding="utf-8"), "is not what `feeddrive export` writes"),
        (
            lambda out: (out / "export.json").write_text("[1]", encoding="utf-8"),
            "is not what `feeddrive export` writes",
        ),
        (lambda out: (out / "machine.toml").unlink(), "machine.toml: is missing"),
        (lambda out: (out / "axis_x.h").unlink(), "axis_x.h (missing)"),
        (lambda out: (out / "axis_x.c").write_text("int main", encoding="utf-8"), "axis_x.c (edited)"),
    ],
)
@needs_gcc
def test_a_damaged_export_is_named(
    damage: object, part: str, machine: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "c"
    exported(out, str(machine), "--target", "c")
    damage(out)  # type: ignore[operator]
    assert part in said(capsys, "verify", str(out), "--samples", "100")


def test_a_manifest_cannot_reach_outside(machine: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names of files in export.json are read, so that none may leave the directory."""
    out = tmp_path / "c"
    exported(out, str(machine), "--target", "c")
    found = json.loads((out / "export.json").read_text(encoding="utf-8"))
    found["files"]["../../secret"] = "0" * 64
    (out / "export.json").write_text(json.dumps(found), encoding="utf-8")
    assert "outside the export" in said(capsys, "verify", str(out), "--samples", "100")


def test_no_compiler_names_the_package(
    machine: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "c"
    exported(out, str(machine), "--target", "c")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("feeddrive.export.c_bundle.importlib.util.find_spec", lambda _: None)
    text = said(capsys, "verify", str(out), "--samples", "100")
    assert "'gcc', which is not found" in text
    assert "apt-get install gcc libc6-dev" in text


def test_a_loop_that_is_not_stable_is_not_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A position gain of 30 000 1/s at 10 kHz: the export would compute what was simulated, and throw the axis."""
    file = tmp_path / "unstable.toml"
    file.write_text(AXIS.format(Kv=30_000) + GUARD, encoding="utf-8")
    assert "unstable" in said(capsys, "export", str(file), "--target", "c", "--out", str(tmp_path / "new"))
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("more", "part"),
    [
        (
            '[[axis.x.forces]]\nkind = "gravity"\nforce_N = -98.1\n[axis.x.control.guard]\nvelocity_limit = 1\n',
            "A HANGING AXIS FALLS: gravity pulls with -98.1 N",
        ),
        ("[axis.x.control.guard]\nvelocity_limit = 1\n", "no following_error_limit"),
    ],
)
def test_what_the_machine_file_leaves_open_is_said(more: str, part: str, tmp_path: Path) -> None:
    """On the terminal and in the README, before an axis falls or runs away."""
    file = tmp_path / "machine.toml"
    file.write_text(AXIS.format(Kv=50) + more, encoding="utf-8")
    assert part in exported(tmp_path / "c", str(file), "--target", "c")
    assert part in (tmp_path / "c" / "README.md").read_text(encoding="utf-8")
