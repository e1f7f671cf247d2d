"""Instructions of an exported step: against C by hand on x86-64, and executed on emulated Cortex-M cores.

python benchmarks/step_cost.py

Counts of valgrind's callgrind and of qemu, not times: the same on every machine with the same compiler.  Needs gcc,
valgrind, gcc-arm-none-eabi, libnewlib-arm-none-eabi and qemu-system-arm.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

import feeddrive as fd
from feeddrive.blocks.families import Law
from feeddrive.blocks.plant.two_bodies import lag, two_bodies
from feeddrive.export.c_bundle import c_files
from feeddrive.export.cortex_m import Cost, step_cost, write_cortex_m
from feeddrive.export.design import CONTROL, Design
from feeddrive.export.layout import layout
from feeddrive.files.machine import read_machine
from feeddrive.loop.routine import controller_routine

BY_HAND = Path(__file__).parent / "hand_written"
FLAGS = ["-std=c99", "-O2", "-ffp-contract=off", "-fno-math-errno"]
COUNTED = 40  # samples of each situation
LIMIT = 9000.0  # N

WHOLE = fd.Guard()
_PARTS = ("checks_setpoint", "holds", "aligns", "starts_moving")
_BOUNDS = {"following_error_limit": 2e-3, "velocity_limit": 2.0, "travel_least": -0.5, "travel_most": 0.5}
LEAST = fd.Guard(**dict.fromkeys(_PARTS, False))
GUARDS: dict[str, fd.Guard | None] = {
    "no guard": None,
    "what always remains": LEAST,
    **{f"default without `{part}`": replace(WHOLE, **{part: False}) for part in _PARTS},
    "default": WHOLE,
    **{f"default and `{bound}`": replace(WHOLE, **{bound: value}) for bound, value in _BOUNDS.items()},
    "default and all four bounds": replace(WHOLE, **_BOUNDS),
    "the four bounds alone": replace(LEAST, **_BOUNDS),
}

LAWS: dict[str, Law] = {
    "p_pi": fd.blocks.CascadePPI(Kv=100.0, Kp=6.8e4, Tn=5.4e-3),
    "pole_placement": fd.blocks.PolePlacement(
        model=fd.blocks.TwoMass(mass_motor=130.0, mass_load=33.0, stiffness=1.8e7, damping=700.0), bandwidth=30.0
    ),
    "gpi": fd.blocks.ActiveDisturbanceRejection(
        mass=163.0, omega_c=40.0, observer=fd.blocks.GpiObserver(mass=163.0, omega_o=400.0, taylor_states=5)
    ),
}


class Counted(Design):
    """A design of which only instructions are counted: it may lack a guard, which an export refuses."""

    remarks = ()


def design(
    law: Law, precision: str = "double", filters: tuple[fd.blocks.Notch, ...] = (), guard: fd.Guard | None = WHOLE
) -> Design:
    """A law with a guard (the default one) and a limit, on the bundled ball screw with its two encoders."""
    machine = read_machine("ball_screw")
    control = fd.Control(law=law, filters=filters, force_limit=LIMIT, guard=guard)
    loop = replace(machine.loop("x"), control=control)
    return Counted(machine, "x", CONTROL, layout(controller_routine(loop, "axis_x"), precision))


def motion(count: int) -> np.ndarray:
    """Inputs of a slow sine with small following errors, enabled: shape (count, 8)."""
    t = np.arange(count) * 5e-5
    w = 2 * np.pi * 2.0
    waves = [np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t), -(w**3) * np.cos(w * t), w**4 * np.sin(w * t)]
    set_ = 0.05 * np.array(waves).T
    reading = set_[:, :1] - 2e-6 * np.cos(3 * w * t)[:, None]
    return np.hstack([set_, reading + 1e-3, reading, np.ones((count, 1))])


def situations() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """By name: inputs, and which samples count; before them the loop was enabled and ran for some samples."""
    begun, count = 10, 10 + 4 * COUNTED
    rows, place = motion(count), np.arange(count)
    every = (place >= begun) & (place % 4 == 2)
    NAN, found = np.nan, dict[str, tuple[np.ndarray, np.ndarray]]()

    def add(name: str, change: Mapping[int, object], where: np.ndarray, counted: np.ndarray = every) -> None:
        given = rows.copy()
        for column, value in change.items():
            given[where, column] = value
        found[name] = (given, counted)

    after = place >= begun
    add("usual", {}, after)
    add("saturated", {5: rows[after, 5] - 1.0, 6: rows[after, 6] - 1.0}, after)
    add("subnormal setpoint", {3: 1e-310, 4: -1e-310}, after)
    add("reading NaN, command held", {6: NAN}, every)
    add("both readings NaN, held", {5: NAN, 6: NAN}, every)
    add("reading infinite, held", {6: np.inf}, every)
    add("setpoint NaN, held", {0: NAN}, every)
    add("tripped", {6: NAN}, after & (place < begun + 3), every & (place > begun + 4))
    add("disabled", {7: 0.0}, after)
    add("enabled anew", {7: 0.0}, after & ~every)
    add("enable is NaN", {7: NAN}, after)
    return found


DRIVER = """\
#include <string.h>
#include <valgrind/callgrind.h>
#define ROWS(name) static const double name[][8]
{samples}
static const struct {{ const double (*rows)[8]; const unsigned char *counted; int count; const char *name; }} all[] = {{
{table}
}};
void nothing({controller} *c, const {inputs} *in, {outputs} *out);
int main(void)
{{
    {controller} none;
    {inputs} in = {{0.0}};
    {outputs} out;
    CALLGRIND_TOGGLE_COLLECT;
    nothing(&none, &in, &out);
    CALLGRIND_TOGGLE_COLLECT;
    CALLGRIND_DUMP_STATS_AT("nothing");
    for (unsigned s = 0; s < sizeof all / sizeof all[0]; s++) {{
        {controller} c = begin(all[s].rows[0]);
        for (int k = 0; k < all[s].count; k++) {{
            memcpy(&in, all[s].rows[k], sizeof in);
            if (all[s].counted[k]) {{
                CALLGRIND_TOGGLE_COLLECT;
                {step}(&c, &in, &out);
                CALLGRIND_TOGGLE_COLLECT;
            }} else {{
                {step}(&c, &in, &out);
            }}
        }}
        CALLGRIND_DUMP_STATS_AT(all[s].name);
    }}
    return 0;
}}
"""


def number(value: float) -> str:
    """As C writes it."""
    if value != value or abs(value) == np.inf:
        return '__builtin_nan("")' if value != value else ("-" if value < 0 else "") + "__builtin_inf()"
    return value.hex()


def driver(begin: str, controller: str, inputs: str, outputs: str, step: str) -> str:
    """The program that is counted: every situation from a fresh controller on, with a dump behind it."""
    samples, table = [], []
    for i, (name, (rows, counted)) in enumerate(situations().items()):
        body = ",\n".join("{" + ", ".join(map(number, map(float, row))) + "}" for row in rows)
        samples.append(f"ROWS(rows_{i}) = {{\n{body}}};")
        samples.append(f"static const unsigned char counted_{i}[] = {{{', '.join(str(int(x)) for x in counted)}}};")
        table.append(f'    {{rows_{i}, counted_{i}, {len(rows)}, "{name}"}},')
    return begin + DRIVER.format(
        samples="\n".join(samples),
        table="\n".join(table),
        controller=controller,
        inputs=inputs,
        outputs=outputs,
        step=step,
    )


def counted(folder: Path, sources: list[str]) -> dict[str, float]:
    """Instructions of a step in each situation, without call and return, which an empty function has, too."""
    (folder / "nothing.c").write_text("void nothing(void) {}\n")
    subprocess.run(["gcc", *FLAGS, "-o", "counted", "nothing.c", *sources, "-lm"], cwd=folder, check=True)
    command = ["valgrind", "--tool=callgrind", "--collect-atstart=no", "--callgrind-out-file=dump", "./counted"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    dumps = [file for file in folder.glob("dump.*") if file.suffix[1:].isdigit()]
    nothing, *totals = map(_total, sorted(dumps, key=lambda file: int(file.suffix[1:])))
    return {
        name: total / int(chosen.sum()) - nothing
        for (name, (_, chosen)), total in zip(situations().items(), totals, strict=True)
    }


def _total(dump: Path) -> int:
    found = re.search(r"^(?:totals|summary): (\d+)", dump.read_text(), re.MULTILINE)
    assert found is not None, f"{dump} has no total"
    return int(found[1])


def generated_counts(made: Design) -> dict[str, float]:
    """Of the exported C."""
    with tempfile.TemporaryDirectory() as name:
        folder, P = Path(name), made.name
        for file, text in c_files(made).items():
            (folder / file).write_text(text)
        begin = f"""#include "{P}.h"
static {P}_controller begin(const double *row)
{{
    {P}_controller c;
    {P}_parameters parameters;
    {P}_inputs in;
    __builtin_memcpy(&in, row, sizeof in);
    {P}_defaults(&parameters);
    {P}_configure(&c, &parameters);
    {P}_reset(&c, &in);
    return c;
}}
"""
        text = driver(begin, f"{P}_controller", f"{P}_inputs", f"{P}_outputs", f"{P}_step")
        (folder / "driver.c").write_text(text)
        return counted(folder, ["driver.c", f"{P}.c", f"{P}_configure.c"])


def hand_numbers(made: Design, first: np.ndarray) -> np.ndarray:
    """The controller by hand as its numbers in their order, those of the guard first, as a reset leaves it."""
    T, law = made.routine.sample_time, made.loop.control.law
    guard = fd.Guard()
    motor, load = first[5], first[6]
    per_unit = made.loop.axis.actuator.motor.force_per_unit()
    around = [T, guard.reading_limit, guard.hold_samples, guard.safe_force, per_unit]
    around += [0.0, motor, load, motor - load, 0.0, first[0], 0.0, 0.0]
    match law:
        case fd.blocks.CascadePPI():
            own = [law.Kv, law.Kp, law.velocity_feedforward, LIMIT, law.Kp * T / law.Tn]
        case fd.blocks.PolePlacement():
            model = two_bodies(law.kind, law.model)
            own = [*law.gains(), LIMIT, model.led / model.k, model.dragged / model.k, lag(model)]
        case _:
            observer = law.observer
            made_of = observer.prepare(T)
            rows = [x for row in made_of.F for x in row]
            rates = [2.0 * law.zeta_c * law.omega_c, law.omega_c * law.omega_c]
            scale = observer.mass * observer.omega_o * observer.omega_o
            own = [*rows, *made_of.Gu, *made_of.Gy, law.mass, law.share, LIMIT, *rates, observer.omega_o, scale]
    numbers = np.zeros(128)
    values = [*around, *own]
    numbers[: len(values)] = values
    return numbers


def hand_begin(made: Design) -> str:
    """The controller by hand, for the driver."""
    values = ", ".join(number(float(x)) for x in hand_numbers(made, motion(1)[0]))
    return f"""typedef struct {{ double values[128]; }} controller;
typedef struct {{ double values[8]; }} inputs;
typedef struct {{ double values[4]; }} outputs;
void hand_step(controller *, const inputs *, outputs *);
static controller begin(const double *row)
{{
    (void)row;
    controller c = {{{{{values}}}}};
    return c;
}}
"""


def hand_counts(law: str, made: Design) -> dict[str, float]:
    """Of the C by hand."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        text = driver(hand_begin(made), "controller", "inputs", "outputs", "hand_step")
        (folder / "driver.c").write_text(text)
        return counted(folder, ["driver.c", str(BY_HAND / f"{law}.c")])


def core_cost(made: Design, optimise: str = "-O2") -> Cost:
    """Executed instructions on an emulated core, over the stored random samples of the bundle."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "bundle"
        write_cortex_m(made, folder)
        return step_cost(folder, optimise)


def main() -> None:
    """All tables."""
    print("| guard of P-PI | M4F least | most | flash | RAM | x86 usual | tripped |\n|---|---|---|---|---|---|---|")
    for name, guard in GUARDS.items():
        cost = core_cost(design(LAWS["p_pi"], "float", (), guard))
        count = generated_counts(design(LAWS["p_pi"], "double", (), guard))
        print(
            f"| {name} | {cost.least} | {cost.most} | {cost.flash} | {cost.memory} | {count['usual']:.6g} | "
            f"{count['tripped']:.6g} |"
        )
    print()
    print("| law | situation | exported | by hand | ratio |\n|---|---|---|---|---|")
    for name, law in LAWS.items():
        made = design(law)
        ours, theirs = generated_counts(made), hand_counts(name, made)
        for situation, count in ours.items():
            other = theirs[situation]
            print(f"| {name} | {situation} | {count:.6g} | {other:.6g} | {count / other:.2f} |")
    print("\n| law | core | -O | least | most | flash | configure | prepared | RAM |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, law in LAWS.items():
        for filters in ((), (fd.blocks.Notch(frequency=400.0),)):
            for precision, core in (("float", "M4F"), ("double", "M7")):
                for optimise in ("-O2", "-Os"):
                    cost = core_cost(design(law, precision, filters), optimise)
                    called = f"{name} + {len(filters)} biquad" if filters else name
                    print(
                        f"| {called} | {core} {precision} | {optimise} | {cost.least} | {cost.most} | {cost.flash} | "
                        f"{cost.configure} | {cost.prepared} | {cost.memory} |"
                    )


if __name__ == "__main__":
    main()
