"""What an export refuses is what Python refuses, for the same reason: bounds, and rules between parameters."""

from __future__ import annotations

import re
import shutil
import subprocess
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from structured_text_machine import program as machine

import feeddrive as fd
from export.parameter_cases import cases, explained, one_for_each_rule, refused
from exported import GUARD, LOOPS, MOTOR, ONE, PPI, TWO, loop
from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.controller import active_disturbance_rejection
from feeddrive.blocks.families import Compensation, Feedforward, Filter, Law, Motor, Observer, Prefilter
from feeddrive.cosimulation.simulate_with_fmu import Instance, opened
from feeddrive.export.c_code import header_only, texts
from feeddrive.export.fmu import fmu, library_place
from feeddrive.export.identifiers import ascii_text
from feeddrive.export.layout import layout
from feeddrive.export.structured_text import program
from feeddrive.language import tree
from feeddrive.loop.routine import Routine, controller_routine, plant_routine
from feeddrive.tuning.candidates import candidates
from slow_share import all_but

PLANTS = {
    "two masses": TWO,
    "rigid": ONE,
    "full mass matrix": fd.Axis(
        plant=fd.blocks.TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0, coupling_mass=65.0),
        actuator=fd.blocks.Actuator(dead_time=1.3e-4, motor=MOTOR),
        friction_motor=fd.blocks.Lugre(coulomb=50.0, breakaway=80.0, stribeck_velocity=2e-3, bristle_stiffness=1e7),
        friction_load=fd.blocks.DirectionalStribeck(
            coulomb_positive=20.0, breakaway_positive=30.0, coulomb_negative=25.0, breakaway_negative=35.0,
            stribeck_velocity=2e-3,
        ),
    ),
    "chain": fd.Axis(
        plant=fd.blocks.ThreeMassChain(
            mass_motor=85.0, mass_screw=45.0, mass_load=33.0, coupling_stiffness=2.352e8, coupling_damping=2496.0,
            stiffness=1.8e7, damping=700.0,
        ),
        friction_motor=fd.blocks.Regularised(
            coulomb=50.0, breakaway=80.0, stribeck_velocity=2e-3, transition_velocity=1e-4, viscous=10.0
        ),
    ),
}  # fmt: skip


@cache
def routines() -> list[Routine]:
    """Every law and what may stand beside it, as controls; every friction that has a rule, as axes."""
    made = [controller_routine(each, f"case_{i}") for i, each in enumerate(LOOPS.values()) if each.control.guard]
    axes = [loop(axis, PPI) for axis in PLANTS.values()]
    return [*made, *(plant_routine(each, f"case_{len(LOOPS) + i}") for i, each in enumerate(axes))]


LONG = 2500  # operations; beyond it gcc takes a second or more for a `configure`


@cache
def covering() -> tuple[int, ...]:
    """Routines in which a block or a condition stands for the first time; the others are left to the slow tests."""
    known: set[str] = set()
    found: list[int] = []
    for number, routine in enumerate(routines()):
        new = {block.kind for _, block in routine.blocks}
        new |= {text.split(": ")[-1] for text in routine.sentences.values()}
        if not new <= known:
            found.append(number)
        known |= new
    return tuple(found)


@pytest.fixture(autouse=True)
def verdicts_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A refusal of this law searches for the nearest admissible rates for its sentence, which decides nothing here."""
    monkeypatch.setattr(active_disturbance_rejection, "_nearest", lambda *_: None)


def test_every_block_of_a_control_is_asked() -> None:
    """A block that is new in the catalogue must stand in one of the loops."""
    asked = {block.kind for each in LOOPS.values() for block in tree.blocks(each.control)}
    asked |= {"direct", *(block.kind for block in tree.blocks(MOTOR))}
    known = catalogue()
    for family in (Law, Filter, Feedforward, Prefilter, Compensation, Observer, Motor):
        # an axis that takes velocities is another one
        assert set(known[family]) - {"position_loop"} <= asked, family


def codes_of_c(routines: list[Routine], rows: list[np.ndarray], place: Path) -> list[np.ndarray]:
    """The code of the first broken rule for rows of parameters, of one program that holds all routines.

    -1 where `configure`, `retune` and `broken_rule` do not agree.
    """
    sources, parts, calls = [], [], []
    for i, routine in enumerate(routines):
        P, made = routine.name, texts(layout(routine), "a control under test", "made by a test")
        (place / f"{P}.h").write_text(made.header)
        (place / f"{P}_configure.c").write_text(made.configure)
        sources.append(f"{P}_configure.c")
        retune = f"if ({P}_retune(&held, &given) != (rule == 0)) rule = -1;"
        filled = "\n".join(f"        given.{v.name} = row[{k}];" for k, v in enumerate(routine.parameters))
        parts.append(_ASKED.format(P=P, held=routine.memory, filled=filled, retune=retune if routine.retune else ""))
        calls.append(f"    ask_{P}({len(rows[i])}, {len(routine.parameters)});")
    includes = "\n".join(f'#include "{each.name}.h"' for each in routines)
    main = "\n".join(["int main(void)", "{", *calls, "    return 0;", "}"])
    (place / "main.c").write_text("\n".join([includes, "#include <stdio.h>", "#include <string.h>", *parts, main]))
    flags = ["-std=c99", "-O0", "-ffp-contract=off", "-w"]
    subprocess.run(["gcc", *flags, *sources, "main.c", "-o", "asked", "-lm"], cwd=place, check=True)
    given = np.concatenate([each.ravel() for each in rows]).tobytes()
    done = subprocess.run([place / "asked"], input=given, capture_output=True, check=True)
    found = np.array(done.stdout.split(), dtype=int)
    ends = np.cumsum([len(each) for each in rows])
    return np.split(found, ends[:-1])


_ASKED = """
bool {P}_exact(void) {{ return true; }} /* that of the step, which is not part of this program */
static void ask_{P}(int rows, int columns)
{{
    static {P}_{held} held;
    {P}_parameters given;
    double row[64];
    for (int k = 0; k < rows; k++) {{
        if (fread(row, sizeof(double), (size_t)columns, stdin) != (size_t)columns) return;
{filled}
        int rule = {P}_broken_rule(&given);
        {P}_parameters first;
        {P}_defaults(&first);
        bool configured = {P}_configure(&held, &first);
        if (!configured) rule = -2;
        if ({P}_configure(&held, &given) != (rule == 0)) rule = -1;
        {P}_configure(&held, &first);
        {retune}
        printf("%d\\n", rule);
    }}
}}
"""


@cache
def each_rule(number: int) -> dict[int, dict[str, float]]:
    """Parameters that break each condition of a routine, by code."""
    routine = routines()[number]
    found = one_for_each_rule(routine, {v.path for v in routine.parameters})
    missing = [text for code, text in routine.sentences.items() if code not in found]
    assert not missing, f"{routine.name}: no change of a parameter breaks '{missing[0]}'"
    return found


@cache
def refused_by_python(number: int, changed: tuple[tuple[str, float], ...]) -> bool:
    """Asked once for all targets: a refusal that names the nearest admissible rate searches for it."""
    return refused(routines()[number], dict(changed))


def judged(number: int, asked: list[dict[str, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Rows of parameters, and whether Python refuses each."""
    first = {v.path: v.value for v in routines()[number].parameters}
    rows = [list((first | changed).values()) for changed in asked]
    return np.array(rows), np.array([refused_by_python(number, tuple(each.items())) for each in asked])


def all_agree(numbers: Iterable[int], count: int, seed: int, place: Path, words: tuple[str, ...]) -> None:
    numbers = tuple(numbers)
    made = [routines()[i] for i in numbers]
    tried = [[*cases(routines()[i], count, seed + i), *each_rule(i).values()] for i in numbers]
    asked = [judged(i, each) for i, each in zip(numbers, tried, strict=True)]
    found = codes_of_c(made, [rows for rows, _ in asked], place)
    inside = outside = 0
    reasons: set[str] = set()
    for routine, changes, (rows, wanted), codes in zip(made, tried, asked, found, strict=True):
        assert codes[0] == 0, f"{routine.name}: its own parameters are refused"
        wrong = np.flatnonzero((codes != 0) != wanted)
        names = [v.name for v in routine.parameters]
        shown = {k: dict(zip(names, rows[k].tolist(), strict=True)) for k in wrong[:1]}
        assert wrong.size == 0, f"{routine.name}: code {codes[wrong[:1]]} for {shown}"
        assert codes.min() >= 0, "configure, retune and broken_rule do not agree"
        for changed, code in zip(changes, codes.tolist(), strict=True):
            assert explained(routine, changed, code), (routine.name, changed, routine.sentences[code])
        inside, outside = inside + int(np.sum(~wanted)), outside + int(np.sum(wanted))
        reasons |= {routine.sentences[int(code)] for code in codes if code > len(routine.parameters)}
    assert min(inside, outside) > 0.15 * (inside + outside), (inside, outside)
    for word in words:
        assert any(word in each for each in reasons), f"no case breaks the rule on '{word}'"


@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
def test_c_refuses_what_python_refuses(tmp_path: Path) -> None:
    """Random parameters inside and outside of bounds and rules, of the loops whose rules are quickly compiled.

    Those on the exponential of a matrix are asked by the tests of the defects below, and by the slow one.
    """
    short = [i for i in covering() if len(routines()[i].graph.nodes) < LONG]
    all_agree(short, 8, 5, tmp_path, ("half the sample rate", "free mass", "travel_least is below"))


@pytest.mark.slow(reason="all loops, 25 times the cases of the quick one")
@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
def test_c_refuses_what_python_refuses_in_many_cases(tmp_path: Path) -> None:
    """The same with 200 sets of parameters a loop."""
    all_agree(
        range(len(routines())),
        200,
        77,
        tmp_path,
        ("half the sample rate", "free mass", "omega_o is slow", "dead time that", "breakaway", "travel_least"),
    )


@pytest.mark.slow(reason="four laws are compiled; the rules are broken one by one quickly")
@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
def test_laws_on_the_ball_screw_once_accepted_on_the_target_what_python_refused(tmp_path: Path) -> None:
    """A far too fast DADSC and GPI observer: refused for five Taylor states, accepted by both for three and one."""
    found, _ = candidates(fd.read_machine("ball_screw").loop("x"))
    laws = {each.name: each.loop for each in found if each.name == "DADSC" or each.name.startswith("GPI")}
    made, rows, wanted = [], [], []
    for i, each in enumerate(laws.values()):
        guarded = replace(each, control=replace(each.control, guard=GUARD))
        routine = controller_routine(guarded, f"case_{i}")
        first = {v.path: v.value for v in routine.parameters}
        factors = {"tracking_rate": 1000.0, "zeta_o": 30.0}
        path = next(path for path in first if path.rpartition(".")[2] in factors)
        changed = {path: factors[path.rpartition(".")[2]] * first[path]}
        made.append(routine)
        rows.append(np.array([list((first | each).values()) for each in ({}, changed)]))
        wanted.append(refused(routine, changed))
    codes = codes_of_c(made, rows, tmp_path)
    assert [code[0] for code in codes] == [0] * len(made)
    assert [code[1] != 0 for code in codes] == wanted
    assert {name for name, each in zip(laws, wanted, strict=True) if each} == {"DADSC", "GPI, 5 Taylor states"}
    assert all("stable" in r.sentences[c[1]] for r, c in zip(made, codes, strict=True) if c[1])


DEFECTS = {
    "dadsc, tracking_rate": ("dadsc", "law.tracking_rate", 1000.0, "free mass"),
    "gpi, zeta_o": ("cascade_ppi, rejection", "compensation.0.observer.zeta_o", 300.0, "omega_o is slow"),
    "gpi, omega_o": ("cascade_ppi, rejection", "compensation.0.observer.omega_o", 50.0, "omega_o is slow"),
    "adrc, zeta_o": ("active_disturbance_rejection", "law.observer.zeta_o", 1000.0, "rigid axis of this mass"),
    "filter beyond half the sample rate": (
        "cascade_ppi, filters and inertia",
        "filters.0.frequency",
        20.0,
        "half the sample rate",
    ),
}


@pytest.fixture(scope="module")
def asking(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], tuple[Routine, Path]]:
    """A program for each loop and form, compiled once: it takes the name of a parameter and a factor.

    Not optimized: the GPI observer's `configure` takes gcc 0.8 s so, and 5.2 s at -O1.
    """

    @cache
    def program_of(loop_name: str, form: str) -> tuple[Routine, Path]:
        place = tmp_path_factory.mktemp("refused")
        routine = controller_routine(LOOPS[loop_name], "axis_x")
        made = texts(layout(routine), "a control under test", "made by a test")
        files = {"axis_x.h": made.header, "axis_x.c": made.source, "axis_x_configure.c": made.configure}
        files = files if form == "c" else {"axis_x.h": header_only("axis_x", made)}
        changes = "\n".join(
            f'    if (strcmp(argv[1], "{v.name}") == 0) {{ bad.{v.name} *= factor; }}' for v in routine.parameters
        )
        files["main.c"] = _REFUSED.replace("CHANGES", changes)
        for file, text in files.items():
            (place / file).write_text(text, encoding="utf-8")
        sources = [file for file in files if file.endswith(".c")]
        flags = ["-std=c99", "-O0", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-ffp-contract=off"]
        subprocess.run(["gcc", *flags, *sources, "-o", "refused", "-lm"], cwd=place, check=True)
        return routine, place / "refused"

    return program_of


@pytest.mark.parametrize("form", all_but(["c"], ["c", "header"], "the same text in one file"))
@pytest.mark.parametrize("name", DEFECTS)
@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
def test_a_refused_change_leaves_the_old_control_and_a_refused_start_the_safe_force(
    name: str, form: str, asking: Callable[[str, str], tuple[Routine, Path]]
) -> None:
    """Python refuses each of these; the exported `configure` and `retune` once answered true."""
    loop_name, last, factor, words = DEFECTS[name]
    path = f"axis.x.control.{last}"
    routine, compiled = asking(loop_name, form)
    variable = next(v for v in routine.parameters if v.path == path)
    assert refused(routine, {path: factor * variable.value})
    command = [compiled, variable.name, repr(factor)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    answers = done.stdout.split()
    assert answers[0] == "refused", "configure and retune refuse"
    assert words in routine.sentences[int(answers[1])]
    assert answers[2] == "same", "after a refused retune the old parameters run on"
    assert float(answers[3]) == 20.0, "after a refused configure the safe force is commanded"
    assert float(answers[4]) == 0.0, "and the loop is off"


_REFUSED = """
#include "axis_x.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int main(int argc, char **argv)
{
    const double factor = argc == 3 ? strtod(argv[2], NULL) : 1.0;
    static axis_x_controller held, other;
    axis_x_parameters good, bad;
    axis_x_inputs inputs = {0};
    axis_x_outputs a, b;
    bool refused, same = true;
    axis_x_defaults(&good);
    bad = good;
CHANGES
    inputs.enable = 1.0;
    refused = axis_x_configure(&held, &good) && axis_x_configure(&other, &good);
    axis_x_reset(&held, &inputs);
    axis_x_reset(&other, &inputs);
    for (int k = 0; k < 100; k++) {
        inputs.set_position = 1e-6 * k;
        if (k == 50) {
            refused = refused && !axis_x_retune(&held, &bad);
        }
        axis_x_step(&held, &inputs, &a);
        axis_x_step(&other, &inputs, &b);
        same = same && a.force == b.force && a.enabled == 1.0;
    }
    refused = refused && !axis_x_configure(&held, &bad) && !axis_x_retune(&held, &good);
    axis_x_step(&held, &inputs, &a);
    printf("%s %d %s %.17g %g\\n", refused ? "refused" : "accepted", axis_x_broken_rule(&bad),
           same ? "same" : "other", a.force, a.enabled);
    return 0;
}
"""


@pytest.mark.parametrize("filled", [0x00, 0x01, 0xAA, 0xFF])
@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
def test_what_was_never_configured_commands_the_safe_force(filled: int, tmp_path: Path) -> None:
    """Whatever stands in memory that nobody filled: not NaN, and not a law on numbers that are none."""
    made = texts(layout(controller_routine(LOOPS["cascade_ppi"], "axis_x")), "under test", "made by a test")
    files = {"axis_x.h": made.header, "axis_x.c": made.source, "axis_x_configure.c": made.configure}
    for file, text in (files | {"main.c": _NEVER.replace("FILLED", str(filled))}).items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"]
    sources = ["axis_x.c", "axis_x_configure.c", "main.c"]
    subprocess.run(["gcc", *flags, *sources, "-o", "never", "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "never"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["20", "0", "0", "refused"]


_NEVER = """
#include "axis_x.h"
#include <stdio.h>
#include <string.h>

int main(void)
{
    axis_x_controller controller;
    axis_x_parameters parameters;
    axis_x_inputs inputs = {0};
    axis_x_outputs outputs;
    memset(&controller, FILLED, sizeof controller);
    memset(&outputs, 0xFF, sizeof outputs);
    axis_x_defaults(&parameters);
    inputs.enable = 1.0;
    axis_x_reset(&controller, &inputs);
    axis_x_step(&controller, &inputs, &outputs);
    printf("%g %g %g %s\\n", outputs.force, outputs.trip, outputs.enabled,
           axis_x_retune(&controller, &parameters) ? "retuned" : "refused");
    return 0;
}
"""


@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only", "-Ofast"])
@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
def test_options_that_lose_the_detection_of_nan_do_not_compile(flag: str, tmp_path: Path) -> None:
    made = texts(layout(controller_routine(LOOPS["cascade_ppi"], "axis_x")), "under test", "made by a test")
    (tmp_path / "axis_x.h").write_text(made.header, encoding="utf-8")
    (tmp_path / "axis_x.c").write_text(made.source, encoding="utf-8")
    command = ["gcc", "-std=c99", "-fsyntax-only", "axis_x.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    done = subprocess.run([*command, flag], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "broken readings could not be detected" in done.stderr


def verdicts_of_structured_text(number: int, count: int) -> None:
    """The block that a PLC configures by, asked for one of each rule and `count` random sets of parameters.

    What is fixed by the export cannot be changed on a PLC and is left alone.
    """
    routine = routines()[number]
    printed = program(layout(routine), "a control under test")
    block = machine(printed.text()).blocks[f"{routine.name}_configure"].instance()
    first = block.s.parameters.copy()

    def rule_of(changed: dict[str, float]) -> int:
        given = first.copy()
        for path, value in changed.items():
            setattr(given, printed.names[path], value)
        return block.call(parameters=given).rule

    each = one_for_each_rule(routine, printed.names)
    checked = {int(code) for code in re.findall(r"rule := (\d+);", printed.text())} - {0}
    assert checked == set(each), "a rule that can be broken on the PLC is not checked there"
    random = ({path: x for path, x in some.items() if path in printed.names} for some in cases(routine, count, 9))
    hit = set()
    for changed in ({}, *each.values(), *random):
        code = rule_of(changed)
        assert (code != 0) == refused_by_python(number, tuple(changed.items())), (changed, routine.sentences.get(code))
        assert explained(routine, changed, code), (changed, routine.sentences.get(code))
        hit.add(code)
    bounds = {code for code in each if code <= len(routine.parameters)}
    assert {0, *bounds} <= hit


@pytest.mark.slow(reason="the compiler takes 7 s; in C the same is quick")
def test_structured_text_refuses_what_python_refuses() -> None:
    """Every block in a loop: one set of parameters inside, one that breaks each rule, a few by chance."""
    for number in covering():
        if routines()[number].memory == "controller":
            verdicts_of_structured_text(number, 4)


@pytest.mark.slow(reason="200 sets of parameters a loop")
@pytest.mark.parametrize("number", range(len(LOOPS)))
def test_structured_text_refuses_what_python_refuses_in_many_cases(number: int) -> None:
    verdicts_of_structured_text(number, 200)


def fmus(routine: Routine, folder: Path, versions: tuple[int, ...]) -> dict[int, Path]:
    """FMUs with a library that was translated as it stands, since optimizing 28 models takes a minute."""
    folder.mkdir()
    found: dict[int, Path] = {}
    flags = ["gcc", "-std=c99", "-O0", "-w", "-fPIC", "-ffp-contract=off"]
    for version in versions:
        file = folder / f"fmi{version}.fmu"
        content = fmu(layout(routine), version, title="under test", made_by="made by a test", binary=False)
        file.write_bytes(content)
        with zipfile.ZipFile(file, "a") as archive:
            for name in (each for each in archive.namelist() if each.startswith("sources/")):
                (folder / Path(name).name).write_bytes(archive.read(name))
            own = [f"{routine.name}.c", f"{routine.name}_configure.c"] if not found else []
            subprocess.run([*flags, "-c", *own, f"fmi{version}.c"], cwd=folder, check=True)
            objects = [f"{routine.name}.o", f"{routine.name}_configure.o", f"fmi{version}.o"]
            subprocess.run([*flags, "-shared", *objects, "-o", "library", "-lm"], cwd=folder, check=True)
            place = library_place(version).replace("*", routine.name)
            archive.write(folder / "library", f"binaries/{place}")
        found[version] = file
    return found


def verdicts_of_fmus(number: int, count: int, folder: Path, versions: tuple[int, ...]) -> None:
    """At the end of the initialization, with the sentence in the message."""
    routine = routines()[number]
    names = {v.path: v.name for v in routine.parameters}
    each = each_rule(number)
    tried = [(None, changed) for changed in cases(routine, count, 21)] + list(each.items())
    judged = [(code, changed, refused_by_python(number, tuple(changed.items()))) for code, changed in tried]
    for file in fmus(routine, folder, versions).values():
        with opened(file) as archive:
            for code, changed, wanted in judged:
                said = ""
                try:
                    with Instance(archive) as held:
                        held.begin([], {names[path]: value for path, value in changed.items()})
                except fd.FeeddriveError as error:
                    said = str(error)
                assert bool(said) == wanted, (routine.name, file.name, changed, said)
                rule = re.search(r"rule (\d+): ", said)
                if rule:
                    assert explained(routine, changed, int(rule[1])), (changed, said)
                    assert ascii_text(routine.sentences[int(rule[1])])[:60] in said
                assert rule or code is None or code <= len(routine.parameters), said


needs_fmu = pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: an FMU needs gcc: apt-get install gcc")


@pytest.mark.slow(reason="nineteen models are compiled; C and ST ask the same conditions")
@needs_fmu
def test_fmus_refuse_what_python_refuses(tmp_path: Path) -> None:
    """Every block: parameters inside and one set that breaks each rule; FMI 2 and 3 by turns, which share the check."""
    pytest.importorskip("fmpy", reason="NOT TESTED: an FMU needs FMPy")
    for number in covering():
        verdicts_of_fmus(number, 2, tmp_path / routines()[number].name, (2 + number % 2,))


@needs_fmu
@pytest.mark.slow(reason="both versions of all models, 100 sets of parameters each")
@pytest.mark.parametrize("number", range(len(LOOPS) + len(PLANTS)))
def test_fmus_refuse_what_python_refuses_in_many_cases(number: int, tmp_path: Path) -> None:
    pytest.importorskip("fmpy", reason="NOT TESTED: an FMU needs FMPy")
    verdicts_of_fmus(number, 100, tmp_path / "both", (2, 3))
