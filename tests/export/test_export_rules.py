"""What an export refuses is what Python refuses, for the same reason: bounds, and rules between parameters."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import feeddrive as fd
from export.parameter_cases import cases, refused
from exported import LOOPS, MOTOR, ONE, PPI, TWO, loop
from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.families import Compensation, Feedforward, Filter, Law, Motor, Observer, Prefilter
from feeddrive.cosimulation.fmu import Instance, opened
from feeddrive.export.c.header_only import header_only
from feeddrive.export.c.text import texts
from feeddrive.export.fmu.fmu import fmu
from feeddrive.export.layout import layout
from feeddrive.export.structured_text.controller import program
from feeddrive.language import tree
from feeddrive.loop.routine import Routine
from feeddrive.loop.routine_trace import controller_routine, plant_routine
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


def routines() -> list[Routine]:
    """Every law and what may stand beside it, as controls; every friction that has a rule, as axes."""
    made = [controller_routine(each, f"case_{i}") for i, each in enumerate(LOOPS.values()) if each.control.guard]
    axes = [loop(axis, PPI) for axis in PLANTS.values()]
    return [*made, *(plant_routine(each, f"case_{len(LOOPS) + i}") for i, each in enumerate(axes))]


def test_every_block_of_a_control_is_asked() -> None:
    """A block that is new in the catalogue must stand in one of the loops."""
    asked = {block.kind for each in LOOPS.values() for block in tree.blocks(each.control)}
    asked |= {"direct", *(block.kind for block in tree.blocks(MOTOR))}
    known = catalogue()
    for family in (Law, Filter, Feedforward, Prefilter, Compensation, Observer, Motor):
        assert set(known[family]) <= asked, family


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
        retune = f"held.configured = configured; if ({P}_retune(&held, &given) != (rule == 0)) rule = -1;"
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


def judged(routine: Routine, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of parameters, and whether Python refuses each."""
    names = [v.path for v in routine.parameters]
    first = {v.path: v.value for v in routine.parameters}
    rows, verdicts = [], []
    for changed in cases(routine, count, seed):
        values = first | changed
        rows.append([values[name] for name in names])
        verdicts.append(refused(routine, changed))
    return np.array(rows), np.array(verdicts)


def all_agree(count: int, seed: int, place: Path, words: tuple[str, ...]) -> None:
    made = routines()
    asked = [judged(each, count, seed + i) for i, each in enumerate(made)]
    found = codes_of_c(made, [rows for rows, _ in asked], place)
    inside = outside = 0
    reasons: set[str] = set()
    for routine, (rows, wanted), codes in zip(made, asked, found, strict=True):
        assert codes[0] == 0, f"{routine.name}: its own parameters are refused"
        wrong = np.flatnonzero((codes != 0) != wanted)
        names = [v.name for v in routine.parameters]
        shown = {k: dict(zip(names, rows[k].tolist(), strict=True)) for k in wrong[:1]}
        assert wrong.size == 0, f"{routine.name}: code {codes[wrong[:1]]} for {shown}"
        assert codes.min() >= 0, "configure, retune and broken_rule do not agree"
        inside, outside = inside + int(np.sum(~wanted)), outside + int(np.sum(wanted))
        reasons |= {routine.sentences[int(code)] for code in codes if code > len(routine.parameters)}
    assert min(inside, outside) > 0.2 * (inside + outside), (inside, outside)
    for word in words:
        assert any(word in each for each in reasons), f"no case breaks the rule on '{word}'"


@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
def test_c_refuses_what_python_refuses(tmp_path: Path) -> None:
    """Every block in a loop, random parameters inside and outside of bounds and rules."""
    all_agree(24, 5, tmp_path, ("half the sample rate", "free mass", "travel_least is below"))


@pytest.mark.slow(reason="eight times the cases of the quick one")
@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
def test_c_refuses_what_python_refuses_in_many_cases(tmp_path: Path) -> None:
    """The same with 200 sets of parameters a loop."""
    all_agree(
        200,
        77,
        tmp_path,
        ("half the sample rate", "free mass", "omega_o is slow", "dead time that", "breakaway", "travel_least"),
    )


DEFECTS = {
    "dadsc, tracking_rate": ("dadsc", "law.tracking_rate", 1000.0, "free mass"),
    "gpi, zeta_o": ("cascade_ppi, rejection", "compensation.0.observer.zeta_o", 300.0, "omega_o is slow"),
    "gpi, omega_o": ("cascade_ppi, rejection", "compensation.0.observer.omega_o", 50.0, "omega_o is slow"),
    "adrc, zeta_o": ("active_disturbance_rejection", "law.observer.zeta_o", 1000.0, "rigid axis of this mass"),
    "filter beyond half the sample rate": (
        "cascade_ppi, filters and inertia", "filters.0.frequency", 20.0, "half the sample rate"
    ),
}  # fmt: skip


@pytest.mark.parametrize("form", ["c", "header"])
@pytest.mark.parametrize("name", DEFECTS)
@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: exported C needs gcc: apt-get install gcc")
def test_a_refused_change_leaves_the_old_control_and_a_refused_start_the_safe_force(
    name: str, form: str, tmp_path: Path
) -> None:
    """Python refuses each of these; the exported `configure` and `retune` once answered true."""
    loop_name, last, factor, words = DEFECTS[name]
    path = f"axis.x.control.{last}"
    routine = controller_routine(LOOPS[loop_name], "axis_x")
    variable = next(v for v in routine.parameters if v.path == path)
    assert refused(routine, {path: factor * variable.value})
    made = texts(layout(routine), "a control under test", "made by a test")
    files = {"axis_x.h": made.header, "axis_x.c": made.source, "axis_x_configure.c": made.configure}
    files = files if form == "c" else {"axis_x.h": header_only("axis_x", made)}
    files["main.c"] = _REFUSED.replace("PARAMETER", variable.name).replace("FACTOR", repr(factor))
    for file, text in files.items():
        (tmp_path / file).write_text(text, encoding="utf-8")
    sources = [file for file in files if file.endswith(".c")]
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-ffp-contract=off"]
    subprocess.run(["gcc", *flags, *sources, "-o", "refused", "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run([tmp_path / "refused"], capture_output=True, text=True, check=False)
    answers = done.stdout.split()
    assert answers[0] == "refused", "configure and retune refuse"
    assert words in routine.sentences[int(answers[1])]
    assert answers[2] == "same", "after a refused retune the old parameters run on"
    assert float(answers[3]) == 20.0, "after a refused configure the safe force is commanded"
    assert float(answers[4]) == 0.0, "and the loop is off"


_REFUSED = """
#include "axis_x.h"
#include <stdio.h>

int main(void)
{
    static axis_x_controller held, other;
    axis_x_parameters good, bad;
    axis_x_inputs inputs = {0};
    axis_x_outputs a, b;
    bool refused, same = true;
    axis_x_defaults(&good);
    bad = good;
    bad.PARAMETER = bad.PARAMETER * FACTOR;
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


ST_LOOPS = ("cascade_ppi, filters and inertia", "dadsc, mode", "pole_placement", "active_disturbance_rejection")


@pytest.mark.parametrize(
    "name",
    all_but(ST_LOOPS[:1], ST_LOOPS, "a parser in Python reads thousands of lines; the first has bounds and rules"),
)
def test_structured_text_refuses_what_python_refuses(name: str) -> None:
    """What is fixed by the export cannot be changed on a PLC and is left alone here."""
    pytest.importorskip("blark", reason="NOT TESTED: Structured Text needs blark")
    from structured_text_machine import program as machine

    routine = controller_routine(LOOPS[name], "axis_x")
    printed = program(layout(routine), "a control under test")
    block = machine(printed.text()).blocks["axis_x_configure"].instance()
    first = block.s.parameters.copy()
    codes = []
    for changed in cases(routine, 60, 9):
        changed = {path: value for path, value in changed.items() if path in printed.names}
        given = first.copy()
        for path, value in changed.items():
            setattr(given, printed.names[path], value)
        rule = block.call(parameters=given).rule
        assert (rule != 0) == refused(routine, changed), (changed, routine.sentences.get(rule))
        codes.append(rule)
    assert codes[0] == 0
    assert any(code > len(routine.parameters) for code in codes), "no case breaks a rule between parameters"


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.skipif(shutil.which("gcc") is None, reason="NOT TESTED: an FMU needs gcc: apt-get install gcc")
def test_an_fmu_refuses_what_python_refuses(version: int, tmp_path: Path) -> None:
    """At the end of the initialization, with the sentence in its message."""
    pytest.importorskip("fmpy", reason="NOT TESTED: an FMU needs FMPy")
    routine = controller_routine(LOOPS["dadsc, mode"], "axis_x")
    file = tmp_path / "axis_x.fmu"
    file.write_bytes(fmu(layout(routine), version, title="a control under test", made_by="made by a test"))
    names = {v.path: v.name for v in routine.parameters}
    inside = 0
    with opened(file) as archive:
        for changed in cases(routine, 40, 21):
            wanted = refused(routine, changed)
            try:
                with Instance(archive) as held:
                    held.begin([], {names[path]: value for path, value in changed.items()})
                found = False
            except fd.FeeddriveError:
                found = True
            assert found == wanted, changed
            inside += not wanted
    assert 5 < inside < 35
