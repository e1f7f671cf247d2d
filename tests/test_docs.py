"""The written side: code in it runs, links in it lead somewhere, commands in it exist."""

from __future__ import annotations

import importlib
import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from typer.main import get_command

from hal_programs import missing
from slow_share import all_but

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
GENERATED = ("docs/reference/keys.md", "docs/reference/blocks/")  # pages that exist only in the built site
COMPILER = next((found for name in ("gcc", "cc", "clang") if (found := shutil.which(name))), None)
COMMANDS = ("console", "sh", "bash", "text", "powershell", "")


def shown(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(path: Path, *languages: str) -> Iterator[str]:
    """Fenced code of a page in some languages; indented code counts as commands."""
    text = path.read_text(encoding="utf-8")
    for language, code in re.findall(r"^```(\w*)[^\n]*\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        if language in languages:
            yield code
    if "sh" in languages:
        plain = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
        yield "\n".join(re.findall(r"^ {4}(\S.*)$", plain, re.MULTILINE))


def with_python() -> list[Path]:
    return [page for page in PAGES if any(blocks(page, "python"))]


LONG = [
    ROOT / "docs" / name
    for name in (
        "how_to/commission.md",
        "how_to/tuning.md",
        "reference/laws/comparison.md",
        "how_to/fmu.md",
        "how_to/scale.md",
        "explanation/yield.md",
        "how_to/linuxcnc.md",
        *(
            f"reference/python/{each}.md"
            for each in ("certificate", "comparison", "identification", "jobs", "learning")
        ),
        "reference/python/tuning.md",
        "explanation/box.md",
    )
]


@pytest.mark.parametrize(
    "page",
    all_but(
        [page for page in with_python() if page not in LONG],
        with_python(),
        "searches of the tuner, compiled FMUs, a sweep, a session of HAL",
    ),
    ids=shown,
)
def test_python_of_a_page_runs_from_top_to_bottom(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if COMPILER is None and any("fd.verify(" in code or '"fmu' in code for code in blocks(page, "python")):
        pytest.skip("NOT TESTED: the page needs a compiler: apt-get install gcc libc6-dev")
    if missing() and any("linuxcnc_axis" in code for code in blocks(page, "python")):
        pytest.skip(missing())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names = namespace(f"page_{page.stem}", monkeypatch)
    for number, code in enumerate(blocks(page, "python"), start=1):
        exec(compile(code, f"{shown(page)}, block {number}", "exec"), names)


def namespace(name: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """That of a module, since a dataclass looks up the module in which it stands."""
    module = ModuleType(name)
    monkeypatch.setitem(sys.modules, name, module)
    return vars(module)


def test_the_law_that_contributing_adds_works(monkeypatch: pytest.MonkeyPatch):
    """It closes a loop, runs natively, and its linear model has the poles of the equations in its docstring."""
    import numpy as np

    import feeddrive as fd

    names = namespace("example", monkeypatch)
    exec(next(blocks(ROOT / "CONTRIBUTING.md", "python")), names)
    Kv, Kp, mass, T = 20.0, 2000.0, 100.0, 1e-3
    law = names["SmithLaw"](Kv=Kv, Kp=Kp)
    loop = fd.Loop(control=fd.Control(law=law), axis=fd.Axis(plant=fd.blocks.Rigid(mass=mass)), sample_time=T)
    poles = fd.linearize(loop, ["set_position"], ["position_load"]).poles()
    # x(k+1) = x + T v + T²/2m F, v(k+1) = v + T/m F, F = -Kp (Kv x + (x - x(k-1))/T): states x, v, x(k-1)
    by_position, by_last = -Kp * (Kv + 1.0 / T), Kp / T
    a = np.array(
        [
            [1.0 + T * T / (2 * mass) * by_position, T, T * T / (2 * mass) * by_last],
            [T / mass * by_position, 1.0, T / mass * by_last],
            [1.0, 0.0, 0.0],
        ]
    )
    expected = np.linalg.eigvals(a)
    assert np.max(np.abs(np.sort_complex(poles) - np.sort_complex(expected))) < 1e-9  # double poles would be worse


def slug(heading: str) -> str:
    """The anchor of a heading, as GitHub and mkdocs form it for plain words."""
    words = re.sub(r"[^\w\- ]", "", re.sub(r"[`*]", "", heading).strip().lower())
    return words.replace(" ", "-")


def test_links_resolve():
    assert not [f"{shown(page)} links to {target}" for page in PAGES for target in dead_links(page)]


def dead_links(page: Path) -> Iterator[str]:
    """The links of a page that lead nowhere: a file or a heading that is not there, an address that is not https."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            if not target.startswith("https://"):
                yield target
            continue
        name, _, anchor = target.partition("#")
        place = (page.parent / name).resolve() if name else page
        if place.relative_to(ROOT).as_posix().startswith(GENERATED):
            continue
        if not place.exists():
            yield target
        elif anchor:
            headings = re.findall(r"^#+ (.+)$", place.read_text(encoding="utf-8"), re.MULTILINE)
            if anchor not in map(slug, headings):
                yield target


def command_lines() -> list[tuple[str, str]]:
    """Page and command line of everything that calls feeddrive or make."""
    found = []
    for page in PAGES:
        for code in blocks(page, *COMMANDS):
            for line in re.split(r"[\n;]|&&", code):
                words = line.strip().removeprefix("$ ")
                words = re.sub(r"^\.venv[/\\](bin|Scripts)[/\\]", "", words)
                if words.startswith(("feeddrive ", "make ")):
                    found.append((shown(page), words.split("#")[0].strip()))
    return found


# pages whose consoles a test types, and where it stands
WALKED = {
    "docs/reference/laws/dadsc.md": "tests/test_docs.py",
    "docs/reference/laws/disturbance-recovery.md": "tests/test_docs.py",
    "docs/reference/laws/field.md": "tests/test_docs.py",
    "docs/reference/laws/gpi-observer.md": "tests/test_docs.py",
    "docs/reference/laws/iterative-feedforward.md": "tests/test_docs.py",
    "docs/reference/laws/pole-placement.md": "tests/test_docs.py",
    "docs/tutorials/afternoon.md": "tests/test_docs.py",
    "docs/tutorials/first-axis.md": "tests/test_docs.py",
    "docs/tutorials/from_your_log.md": "tests/cli/test_walks.py",
    "docs/tutorials/own_law.md": "tests/test_own_blocks.py",
    "docs/tutorials/shop_linuxcnc.md": "tests/test_docs.py",
    "docs/tutorials/shop_sinumerik.md": "tests/test_docs.py",
}
# code that no test runs as it stands: page, language and the reason. Python runs, and TOML is read, on every page; of
# commands that are not run, the words and options are checked
_OF_A_READER = "names files that a reader has"
_MINUTES = "takes minutes; tests of the commands run them on less"
_SHOWN = "is no code: equations, or what is printed or written"
_ELSEWHERE = "needs other machines, the rights of an administrator or a network"
UNRUN = {
    ("README.md", "sh"): "installs and runs these tests",
    ("README.md", "powershell"): "is of a system on which no test runs",
    ("docs/index.md", "sh"): "installs; the demo is run by tests/cli/test_terminal.py",
    ("docs/explanation/box.md", "sh"): _MINUTES,
    ("docs/explanation/certificate.md", "sh"): _OF_A_READER,
    ("docs/explanation/five_axes.md", "console"): _MINUTES,
    ("docs/explanation/five_axes.md", "text"): _SHOWN,
    ("docs/explanation/robust_tuning.md", "py"): _MINUTES,
    ("docs/explanation/robust_tuning.md", "sh"): _MINUTES,
    ("docs/explanation/travel.md", "sh"): _OF_A_READER,
    ("docs/how_to/commissioning.md", "console"): _OF_A_READER,
    ("docs/how_to/drive_bus.md", "sh"): _ELSEWHERE,
    ("docs/how_to/export.md", "c"): "is a part of a program; tests/export compiles the whole",
    ("docs/how_to/export.md", "sh"): _OF_A_READER,
    ("docs/how_to/export.md", "text"): _SHOWN,
    ("docs/how_to/identification.md", "console"): _OF_A_READER,
    ("docs/how_to/machining.md", ""): _MINUTES,
    ("docs/how_to/machining.md", "sh"): _OF_A_READER,
    ("docs/how_to/plan.md", "console"): _OF_A_READER,
    ("docs/how_to/plan.md", "text"): _SHOWN,
    ("docs/how_to/scale.md", ""): _ELSEWHERE,
    ("docs/how_to/scale.md", "bash"): _MINUTES,
    ("docs/how_to/scale.md", "text"): _ELSEWHERE,
    ("docs/how_to/setpath.md", "text"): _OF_A_READER,
    ("docs/how_to/structured_text.md", ""): _SHOWN,
    ("docs/reference/files.md", "console"): _OF_A_READER,
    ("docs/reference/files.md", "sh"): "writes what tests/workflow/test_schemas.py reads",
    ("docs/reference/files.md", "text"): _SHOWN,
    ("docs/reference/gallery.md", "sh"): "is run by docs/draw_reports.py",
    ("docs/reference/laws/cascade-ppi.md", "text"): _SHOWN,
    ("docs/reference/laws/dadsc.md", "text"): _SHOWN,
    ("docs/reference/laws/disturbance-recovery.md", "text"): _SHOWN,
    ("docs/reference/laws/gpi-observer.md", "text"): _SHOWN,
    ("docs/reference/laws/iterative-feedforward.md", "sh"): _OF_A_READER,
    ("docs/reference/laws/iterative-feedforward.md", "text"): _SHOWN,
    ("docs/reference/laws/milling-force.md", "text"): _SHOWN,
    ("docs/reference/laws/mode-compensation.md", "text"): _SHOWN,
    ("docs/reference/laws/pole-placement.md", "text"): _SHOWN,
    ("docs/reference/laws/trajectory-prefilter.md", "sh"): _OF_A_READER,
    ("docs/reference/laws/trajectory-prefilter.md", "text"): _SHOWN,
    ("docs/reference/part_programs.md", "text"): _SHOWN,
    ("docs/reference/security.md", "nginx"): _ELSEWHERE,
    ("docs/reference/security.md", "sh"): _ELSEWHERE,
    ("docs/reference/security.md", "text"): _ELSEWHERE,
    ("docs/tutorials/first-axis.md", "text"): _OF_A_READER,
}


def test_every_block_of_code_is_run_or_says_why_not():
    found = {
        (shown(page), language)
        for page in PAGES
        for language in re.findall(r"(?ms)^```(\w*)[^\n]*\n.*?^```", page.read_text(encoding="utf-8"))
    }
    run = {(page, language) for page, language in found if language in ("python", "toml")}
    run |= {(page, "console") for page in WALKED}
    assert found - run == set(UNRUN)
    for page, place in WALKED.items():
        assert page.rpartition("/")[2] in (ROOT / place).read_text(encoding="utf-8"), page


def test_every_toml_of_a_page_is_read_and_its_keys_exist():
    """A name of a key is that of a declared one, with a unit behind it where another one is meant."""
    from feeddrive.blocks.catalogue import catalogue
    from feeddrive.files.section import Hint, Section, hints, members
    from feeddrive.language.block import Declared, declarations
    from feeddrive.workflow.schemas import FILES

    known = {"kind", "time", *"xyzabcuvw"}  # a role of a column of a log, and the names of axes
    seen = set[type[Any]]()

    def declare(section: type[Any]) -> None:
        seen.add(section)
        known.update(declarations(section))
        for hint in (hint for hint in hints(section).values() if isinstance(hint, Hint)):
            for inner in {*members(hint).values(), *hint.classes} - seen:
                if issubclass(inner, Section):
                    declare(inner)
                elif issubclass(inner, Declared):
                    known.update(declarations(inner))

    for section in FILES.values():
        declare(section)
    for family in catalogue().values():
        for block in family.values():
            known.update(declarations(block))

    def unknown(table: dict[str, Any]) -> Iterator[str]:
        for key, value in table.items():
            below = value if isinstance(value, list) else [value]
            for each in (each for each in below if isinstance(each, dict)):
                yield from unknown(each)
            parts = key.split("_")
            whole = ["_".join(parts[:count]) for count in range(1, len(parts) + 1)]
            if not (isinstance(below[0], dict) or "." in key or known.intersection(whole)):
                yield key

    read = [(page, tomllib.loads(code)) for page in PAGES for code in blocks(page, "toml")]
    assert len(read) > 30
    assert not {
        (shown(page), key) for page, table in read for key in unknown(table) if "entry-points" not in str(table)
    }


# files that a reader writes, and one that a command writes for him
WRITTEN = {"smith_law.py", "spring_damper.py"}


def test_source_files_that_are_named_exist():
    """In documents and docstrings; a name with folders is the end of a path."""
    files = [f"/{path.relative_to(ROOT).as_posix()}" for path in ROOT.rglob("*.py") if ".venv" not in path.parts]
    texts = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("src/**/*.py")]
    gone = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in texts
        for name in re.findall(r"`([\w/]+\.py)`", path.read_text(encoding="utf-8"))
        if name.rpartition("/")[2] not in WRITTEN and not any(file.endswith(f"/{name}") for file in files)
    ]
    assert not gone


def test_commands_and_their_options_exist():
    lines = command_lines()
    assert len(lines) > 100
    assert not [(page, line, word) for page, line in lines for word in unknown_words(line)]


def unknown_words(line: str) -> Iterator[str]:
    """The words of a command line that name no target of make, no command and no option."""
    from feeddrive.cli.commands import app

    program, *words = line.split()
    if program == "make":
        targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        yield from () if words[0] in targets else words[:1]
        return
    command: Any = get_command(app)
    for word in words:
        if word.startswith("-"):
            known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)}
            if word.split("=")[0] not in {*known, "--help"}:
                yield word
        elif getattr(command, "commands", None):
            if word not in command.commands:
                yield word
                return
            command = command.commands[word]


def test_the_files_of_the_documentation_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from feeddrive.files.job import read_job
    from feeddrive.files.machine import read_machine

    page = ROOT / "docs/reference/files.md"
    found = [code for code in blocks(page, "toml") if "[axis.x]" in code or "[[law]]" in code]
    assert len(found) == 2
    (tmp_path / "my_mill.toml").write_text(found[0], encoding="utf-8")
    (tmp_path / "job.toml").write_text(found[1], encoding="utf-8")
    assert list(read_machine(tmp_path / "my_mill.toml").loops) == ["x"]
    assert list(read_job(tmp_path / "job.toml").loops) == ["today", "half the gain"]


def test_the_error_that_the_documentation_shows_is_the_one_that_comes(tmp_path: Path):
    from feeddrive.files.machine import read_machine
    from feeddrive.language.errors import FeeddriveError

    page = ROOT / "docs/reference/files.md"
    machine = next(code for code in blocks(page, "toml") if "[axis.x]" in code)
    wrong = tmp_path / "my_mill.toml"
    wrong.write_text(machine.replace("mass_load = 260.0", "mass_load = -260"), encoding="utf-8")
    with pytest.raises(FeeddriveError) as caught:
        read_machine(wrong)
    said = str(caught.value).replace(f"{wrong}", "my_mill.toml").replace(f"{tmp_path}/", "")
    assert said in page.read_text(encoding="utf-8")


def test_the_page_of_the_commands_has_each_option_that_the_command_line_takes(monkeypatch: pytest.MonkeyPatch):
    from feeddrive.cli.commands import app

    sections = re.split(r"^### ", script("gen_blocks", monkeypatch).commands(), flags=re.MULTILINE)[1:]
    pages = {section.partition("\n")[0]: section for section in sections}
    offered: Any = get_command(app).commands  # type: ignore[attr-defined]
    assert set(pages) == set(offered)
    of_all = {"--blocks", "--verbose", "--json", "--help"}
    for name, command in offered.items():
        for parameter in command.params:
            row = f"| `{parameter.opts[0] if parameter.opts[0].startswith('-') else parameter.opts[0].upper()}`"
            assert parameter.opts[0] in of_all or row in pages[name], f"{name} {parameter.opts[0]}"
    # a unit and a default in it, not in SI
    assert "| `--max-compliance` | um/N |" in pages["tune"]
    assert re.search(r"\| `--max-ms` \| 1 \| .* \| `2` \|", pages["tune"])


def test_each_public_name_stands_on_one_page_of_python(monkeypatch: pytest.MonkeyPatch):
    from feeddrive.language.lazy_package import public_names

    documents = sorted((ROOT / "docs/reference/python").glob("*.md"))
    asked = [re.findall(r"<!-- names of (.+?) -->", page.read_text(encoding="utf-8")) for page in documents]
    shown = [
        re.findall(r"(?m)^## (\w+)$", script("gen_blocks", monkeypatch).names_of(each.split(", ")))
        for page in asked
        for each in page
    ]
    root = public_names("feeddrive")
    rooms = [name for name, place in root.items() if place == "feeddrive" and name != "blocks"]
    public = {(name, place) for room in rooms for name, place in public_names(f"feeddrive.{room}").items()}
    public |= {(name, place) for name, place in root.items() if place not in ("feeddrive", "feeddrive.version")}
    assert sorted(name for page in shown for name in page) == sorted(name for name, _ in public)


def test_the_page_of_the_keys_has_each_that_a_file_may_hold(monkeypatch: pytest.MonkeyPatch):
    from feeddrive.files.section import Hint, Section, hints, members
    from feeddrive.language.block import declarations
    from feeddrive.workflow.schemas import FILES

    pages = script("gen_blocks", monkeypatch)
    parts = re.split(r"^## ", pages.keys(), flags=re.MULTILINE)[1:]
    assert [part.split(" file\n")[0].lower() for part in parts] == list(FILES)

    def check(section: type[Any], part: str) -> None:
        assert section.__doc__.split("\n")[0] in part
        for name, declared in declarations(section).items():
            assert declared.inline or f"| `{name}`" in part, f"{section.__name__}.{name}"
            assert declared.meaning in part, f"{section.__name__}.{name}"
            hint = hints(section).get(name)
            for inner in members(hint).values() if isinstance(hint, Hint) else ():
                if issubclass(inner, Section):
                    check(inner, part)

    for section, part in zip(FILES.values(), parts, strict=True):
        check(section, part)


@pytest.mark.slow(reason="a page of commands is walked; every command and option of it is checked quickly")
def test_the_first_axis_prints_what_its_page_shows(tmp_path: Path):
    """The tables of the tutorial, line by line; the log of EMPS is not needed."""
    page = ROOT / "docs/tutorials/first-axis.md"
    machine, job = blocks(page, "toml")
    (tmp_path / "my_axis.toml").write_text(machine, encoding="utf-8")
    (tmp_path / "my_job.toml").write_text(job, encoding="utf-8")
    demo, run, wrong = blocks(page, "console")
    assert_prints(demo, tmp_path, 0)
    assert_prints(run, tmp_path, 0)
    assert "coulomb = 180 " in machine
    (tmp_path / "my_axis.toml").write_text(machine.replace("coulomb = 180 ", "coulomb = -180 "), encoding="utf-8")
    assert_prints(wrong, tmp_path, 2)


@pytest.mark.slow(reason="a page of ten commands is walked; every command and option of it is checked quickly")
def test_the_afternoon_goes_as_its_page_shows(tmp_path: Path):
    """From excitation to certificate, one command after the other in one folder."""
    for console in blocks(ROOT / "docs/tutorials/afternoon.md", "console"):
        if "feeddrive verify" in console and COMPILER is None:
            pytest.skip("NOT TESTED to its end: `feeddrive verify` needs a compiler: apt-get install gcc libc6-dev")
        assert_prints(console, tmp_path, 0)
    assert (tmp_path / "tuned" / "report.html").exists()


# laws whose page takes them from a machine file to exported code: page, heading, name for `tune --law`
ONTO_A_MACHINE = [
    ("dadsc.md", "Onto a machine", "dadsc"),
    ("pole-placement.md", "Onto a machine", "pole_placement"),
    ("gpi-observer.md", "Onto a machine", "GPI, 1 Taylor state"),
    ("iterative-feedforward.md", "Onto a machine", "cascade_ppi"),
    ("disturbance-recovery.md", "P-PI with Kalman recovery onto a machine", "P-PI + Kalman recovery"),
    ("field.md", "Super-twisting onto a machine", "super_twisting"),
    ("field.md", "GPC onto a machine", "GPC, short horizon"),
    ("field.md", "P-PI with an observer onto a machine", "P-PI + DOB"),
    ("field.md", "P-P with an observer onto a machine", "P-P + DOB"),
    ("field.md", "LQG onto a machine", "LQG"),
]


def consoles_below(page: Path, heading: str) -> list[str]:
    """The commands with their output below a heading of a page, up to the next heading."""
    (found,) = re.findall(rf"(?ms)^#+ {re.escape(heading)}$(.*?)(?=^#|\Z)", page.read_text(encoding="utf-8"))
    return re.findall(r"(?ms)^```console\n(.*?)^```", found)


@pytest.mark.parametrize(("page", "heading", "law"), ONTO_A_MACHINE, ids=[law for *_, law in ONTO_A_MACHINE])
def test_a_law_gets_onto_a_machine_by_the_same_commands(page: str, heading: str, law: str):
    """Tune, prove, check, simulate, export, each with something printed; learned feedforward is learned first."""
    consoles = consoles_below(ROOT / "docs/reference/laws" / page, heading)
    commands = [shlex.split(console.splitlines()[0].removeprefix("$ ")) for console in consoles]
    first = ["iterate"] if page == "iterative-feedforward.md" else []
    assert [words[1] for words in commands] == [*first, "tune", "certify", "check", "run", "export"]
    tune = commands[len(first)]
    assert tune[tune.index("--law") + 1] == law
    assert all(len(console.splitlines()) > 1 for console in consoles)
    # the index names every page that has the recipe
    anchor = f"{page}#{slug(heading)}"
    assert anchor in (ROOT / "docs/reference/laws/index.md").read_text(encoding="utf-8")


@pytest.mark.slow(reason="a search, a compiled run and three more commands; their order is checked quickly")
@pytest.mark.parametrize(("page", "heading", "law"), ONTO_A_MACHINE, ids=[law for *_, law in ONTO_A_MACHINE])
def test_the_commands_that_get_a_law_onto_a_machine_print_what_its_page_shows(
    page: str, heading: str, law: str, tmp_path: Path
):
    (job,) = blocks(ROOT / "docs/reference/laws/index.md", "toml")
    (tmp_path / "move.toml").write_text(job, encoding="utf-8")
    for console in consoles_below(ROOT / "docs/reference/laws" / page, heading):
        assert_prints(console, tmp_path, 0)
    assert list((tmp_path / "export").glob("*.c"))


def walked(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A page of a shop from its measurement on: Python, the machine file, all commands; its text."""
    page = ROOT / "docs" / "tutorials" / name
    monkeypatch.chdir(folder)
    (writes,) = blocks(page, "python")
    exec(compile(writes, shown(page), "exec"), namespace("shop", monkeypatch))
    (machine,) = blocks(page, "toml")
    (folder / "my_axis.toml").write_text(machine, encoding="utf-8")
    for console in blocks(page, "console"):
        assert_prints(console, folder, 0)
    return page.read_text(encoding="utf-8")


def assert_values(rows: list[tuple[str, str]], written: dict[str, str], names: list[str]) -> None:
    """The rows of a table have the numbers of a file, within 1 %, as their three digits allow."""
    assert [name for name, _ in rows] == names
    for name, value in rows:
        assert float(value.replace(" ", "")) == pytest.approx(float(written[name]), rel=0.01), name


@pytest.mark.slow(reason="a page of commands is walked; every command and option of it is checked quickly")
def test_the_page_for_linuxcnc_goes_as_it_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """From its halscope log to the pid's gains, whose numbers stand in the last table."""
    text = walked("shop_linuxcnc.md", tmp_path, monkeypatch)
    written = (tmp_path / "to_pid/axis-x.ini").read_text(encoding="utf-8")
    names = ["Pgain", "Igain", "Dgain", "FF1", "FF2", "maxoutput"]
    gains = dict(re.findall(r"POSITION_(\w+) = ([\d.]+)", written))
    rows = re.findall(r"(?m)^\| `(\w+)` \| ([\d. ]+) \| V", text)
    assert_values(rows, {name: gains[name.upper()] for name in names}, names)


@pytest.mark.slow(reason="a page of commands is walked; every command and option of it is checked quickly")
def test_the_page_for_sinumerik_goes_as_it_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """From a file in the form of the tuning tool's to machine data, whose numbers stand in the last table."""
    text = walked("shop_sinumerik.md", tmp_path, monkeypatch)
    written = (tmp_path / "to_control/sinumerik.txt").read_text(encoding="utf-8")
    rows = re.findall(r"(?m)^\| `((?:MD|p)[^`]+)` \| ([\d.]+) \|", text)
    names = [
        "MD32200 $MA_POSCTRL_GAIN[0]",
        "MD32610 $MA_VELO_FFW_WEIGHT[0]",
        "p1460[0]",
        "p1462[0]",
        "p1520[0]",
        "p1658[0]",
    ]
    assert_values(rows, dict(re.findall(r"(?m)^([Mp][^=;]+) = ([\d.]+)$", written)), names)


def assert_prints(console: str, folder: Path, code: int) -> None:
    """The first line is a command; it prints every other line, with the same words and numbers within 1 %."""
    first, *lines = console.strip().splitlines()
    asked = [
        sys.executable,
        "-c",
        "from feeddrive.cli import main; main()",
        *shlex.split(first.removeprefix("$ "))[1:],
    ]
    done = subprocess.run(asked, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == code, done.stderr
    printed = (done.stdout + done.stderr).splitlines()
    for line in lines:
        assert any(alike(line, each) for each in printed), f"{line}\nis not in\n{done.stdout}{done.stderr}"


def alike(a: str, b: str) -> bool:
    """Whether two lines have the same words, and numbers within 1 %."""
    left, right = a.split(), b.split()
    return len(left) == len(right) and all(map(same, left, right))


def same(a: str, b: str) -> bool:
    try:
        return abs(float(a) - float(b)) <= 0.01 * abs(float(a))
    except ValueError:
        return a == b


def script(name: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A script of docs/ as a module; it may import its neighbors."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module(name)


def test_the_timeline_is_what_its_script_draws(monkeypatch: pytest.MonkeyPatch):
    timeline = script("draw_timeline", monkeypatch)
    assert timeline.TARGET.read_text(encoding="utf-8") == timeline.drawing()


def test_the_gallery_is_what_its_script_writes(monkeypatch: pytest.MonkeyPatch):
    reports = script("draw_reports", monkeypatch)
    assert reports.PAGE.read_text(encoding="utf-8") == reports.page()


# words of the README, and those of the page that it links for them, from which they were taken
FIGURES = {
    ("1.24 µm RMS", "docs/reference/accuracy.md"): "| by direction, without offset | 1.24 µm |",
    ("578 µm RMS", "docs/reference/accuracy.md"): "578 µm RMS of following error",
    ("1,000,000 random samples", "docs/how_to/export.md"): "a million random samples",
    ("17 kept within 10 %", "docs/how_to/commission.md"): "| **240 to 259, drawn for this table** | 0 | **17**",
    (
        "1.15 times the time of C",
        "docs/reference/speed.md",
    ): "| the same in the default arithmetic | <= 1.5 x | **1.15 x** |",
}


def test_the_figures_of_the_readme_are_those_of_its_pages():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for (words, page), there in FIGURES.items():
        assert any(words in line and page in line for line in readme.splitlines()), words
        assert there in (ROOT / page).read_text(encoding="utf-8"), (words, page)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; a warning or a link that leads nowhere fails its build."""
    folder = tmp_path_factory.mktemp("site")
    asked = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_the_site_has_a_page_a_block(site: Path):
    """From its declaration."""
    page = (site / "reference/blocks/cascade_ppi/index.html").read_text(encoding="utf-8")
    assert "position gain" in page
    assert "1/s" in page


# what people of the trade type, and the page that must be among the first three found
SEARCHED = {
    "rope snap": "how_to/tuning/",
    "load side stiffness": "how_to/tuning/",
    "notch": "reference/blocks/notch/",
    "band stop": "reference/blocks/notch/",
    "GSV": "GLOSSARY/",
    "kv factor": "GLOSSARY/",
    "lag": "reference/conventions/",
    "following error": "reference/conventions/",
    "Schleppfehler": "reference/conventions/",
    "modulus margin": "reference/conventions/",
    "delay margin": "how_to/analysis/",
    "backlash": "how_to/machining/",
    "stick-slip": "explanation/friction/",
    "stribeck": "explanation/friction/",
    "quadrant glitch": "how_to/machining/",
    "ballbar": "how_to/machining/",
    "cogging": "how_to/identification/",
    "torque ripple": "how_to/identification/",
    "jerk": "how_to/plan/",
    "look-ahead": "internals/planner/",
    "G64": "how_to/plan/",
    "RTCP": "explanation/five_axes/",
    "TCPM": "explanation/five_axes/",
    "TRAORI": "explanation/five_axes/",
    "feed override": "internals/planner/",
    "chatter": "how_to/machining/",
    "stability lobes": "how_to/machining/",
    "contour error": "how_to/machining/",
    "scallop": "how_to/machining/",
    "autotune": "how_to/tuning/",
    "dead time": "explanation/timing/",
    "gain scheduling": "explanation/travel/",
    "disturbance observer": "reference/laws/field/",
    "ADRC": "reference/laws/gpi-observer/",
    "sliding mode": "reference/laws/dadsc/",
    "feed forward": "reference/laws/iterative-feedforward/",
    "FF1": "reference/laws/iterative-feedforward/",
    "MD32200": "tutorials/shop_sinumerik/",
    "sinumerik": "tutorials/shop_sinumerik/",
    "fanuc": "how_to/parameters/",
    "halscope": "tutorials/shop_linuxcnc/",
    "pgain": "how_to/linuxcnc_pid/",
    "ethercat": "how_to/drive_bus/",
    "emergency stop": "explanation/safety/",
    "structured text": "how_to/structured_text/",
    "simulink": "how_to/fmu/",
    "STM32": "how_to/cortex_m/",
    "exit code": "reference/files/",
    "inertia ratio": "how_to/identification/",
    "gantry": "how_to/commission_gantry/",
    "max-compliance": "reference/commands/",
    "feeddrive tune": "how_to/tuning/",
    "simulate_batch": "reference/python/loop/",
}
NODE = shutil.which("node")


def test_the_search_finds_by_the_words_of_the_trade(site: Path):
    """The search of the theme itself, on the index of the site."""
    if NODE is None:
        pytest.skip("NOT TESTED: the search of the site runs in node: apt-get install nodejs")
    asked = [NODE, str(ROOT / "tests/search_site.mjs"), str(site)]
    queries = json.dumps(list(SEARCHED))
    done = subprocess.run(asked, input=queries, capture_output=True, text=True, timeout=60, check=True)
    found = {
        query: [place.partition("#")[0] for place in places]
        for query, places in zip(SEARCHED, json.loads(done.stdout), strict=True)
    }
    assert not {query: found[query][:4] for query, page in SEARCHED.items() if page not in found[query][:3]}


def test_each_word_of_the_trade_stands_once():
    """The second of two pages with one word would be found by chance."""
    text = (ROOT / "docs/reference/words.md").read_text(encoding="utf-8")
    rows = re.findall(r"(?m)^\| (.+?) \| .+ \| \[", text)
    words = [word.strip().lower() for row in rows for word in row.split(",")]
    assert len(words) > 200
    assert sorted(words) == sorted(set(words))


def test_a_link_of_the_site_that_leads_nowhere_is_found(tmp_path: Path):
    """mkdocs does not look at what it leaves out of the site, and at what themes and generated pages link to."""
    (tmp_path / "other").mkdir()
    links = ("script.py", "other/", "other/#there", "other/#gone", "#top", "https://example.org/", "../above.html")
    text = '<h1 id="top"></h1>' + "".join(f'<a href="{each}">x</a>' for each in links)
    (tmp_path / "index.html").write_text(text, encoding="utf-8")
    (tmp_path / "other/index.html").write_text('<h2 id="there"></h2><img src="a.svg">', encoding="utf-8")
    asked = [sys.executable, "docs/check_links.py", str(tmp_path)]
    done = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert done.stdout.splitlines() == [
        "index.html: script.py leads nowhere",
        "index.html: other/#gone leads to a place that other/index.html does not have",
        "index.html: ../above.html leads nowhere",
        "other/index.html: a.svg leads nowhere",
    ]


OUTSIDE = re.compile(r"\b(papers|peers|targets|style)\.md\b|(?<![\w.])/(home|root|work|Users)/|https?://\d")


def written() -> list[Path]:
    """Everything that people read or run, but this file."""
    folders = ("src", "tests", "docs", "benchmarks", "examples", ".ci")
    found = [path for folder in folders for path in (ROOT / folder).rglob("*")]
    kinds = {".py", ".md", ".toml", ".c", ".cpp", ".css", ".yml", ""}
    return [*PAGES, *(path for path in found if path.is_file() and path.suffix in kinds and path != Path(__file__))]


def test_nothing_refers_to_what_a_reader_does_not_have():
    for path in written():
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
            assert not OUTSIDE.search(line), f"{shown(path)}:{number}: {line.strip()}"
