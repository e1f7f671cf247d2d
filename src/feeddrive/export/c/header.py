"""The header of exported C: structs with units and meanings, and the functions."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Sequence

from feeddrive.export.c.arithmetic import CODE, STRICT
from feeddrive.export.c.statements import FLUSH
from feeddrive.export.layout import Layout
from feeddrive.loop import guard as guards
from feeddrive.loop.routine import Variable

_WIDTH = 116
_FLUSHES = re.compile(r"\b(flush|restore)\b")


def header(layout: Layout, title: str, made_by: str) -> str:
    """The text of P.h; `title` says what it is, `made_by` which program made it from which file."""
    routine, real, P = layout.routine, layout.precision, layout.routine.name
    held = routine.memory
    guard = f"{P.upper()}_H"
    arguments = f"{P}_{held} *{held}"
    reset_outputs = f", {P}_outputs *outputs" if layout.reset.outputs else ""
    lines = [
        *comment(f"{title}\n\n{made_by}\n\n{_USE.format(P=P, held=held)}"),
        f"#ifndef {guard}", f"#define {guard}", "",
        "#include <float.h>", "#include <stdbool.h>", "#include <stdint.h>", "",
        "#ifdef __cplusplus", 'extern "C" {', "#endif", "",
        *STRICT,
        f"#define {P.upper()}_SAMPLE_TIME {routine.sample_time!r} /* s, {routine.sample_time.hex()} */", "",
        "/* Value of `configured` after a successful configure; uninitialized memory has another one. */",
        f"#define {mark(P)} UINT32_C(0x00C500C5)", "",
        *_trips(layout),
        "/* Parameters; see configure and retune. */",
        *_struct(f"{P}_parameters", [("double", v.name, _meaning(v)) for v in routine.parameters]),
        "/* Inputs of each sample. */",
        *_struct(f"{P}_inputs", [(real, v.name, _meaning(v)) for v in routine.inputs]),
        "/* Outputs of each sample. */",
        *_struct(f"{P}_outputs", [(real, v.name, _meaning(v)) for v in routine.outputs]),
        "/* Numbers that depend on parameters only. */",
        *_designed(f"{P}_design", layout),
        "/* State from sample to sample. */",
        *_grouped(f"{P}_state", [(real, v.name, routine.said.get(v.path, "")) for v in routine.states]),
        f"/* All of a {held}: plain data, which may be copied. */",
        "typedef struct {",
        f"    {P}_design design;", f"    {P}_state state;", f"    {P}_parameters parameters;",
        f"    uint32_t configured; /* {mark(P)} after a successful configure */",
        f"}} {P}_{held};", "",
        "/* The values of the machine file. */",
        f"void {P}_defaults({P}_parameters *parameters);", "",
        "/* Does this compiler round as the simulation does? configure and broken_rule ask it. */",
        f"bool {P}_exact(void);", "",
        "/* 0, or the code of the first rule that the parameters break: README.md and export.json explain it.",
        f"   {CODE} if this compiler rounds otherwise than the simulation: then configure refuses, too. */",
        f"int {P}_broken_rule(const {P}_parameters *parameters);", "",
        "/* All work that depends on parameters only: once, outside the interrupt. The state is left alone.",
        f"   False if a rule is broken, or {P}_exact is false: {_OFF[held]}. */",
        f"bool {P}_configure({arguments}, const {P}_parameters *parameters);", "",
        "/* The state where the axis is: off, without a trip. Once before the first step, after configure. */",
        f"void {P}_reset({arguments}, const {P}_inputs *inputs{reset_outputs});", "",
        "/* One sample. */",
        f"void {P}_step({arguments}, const {P}_inputs *inputs, {P}_outputs *outputs);", "",
    ]  # fmt: skip
    if routine.retune is not None:
        lines += [
            "/* Other parameters between two samples: the state follows, so that the command has no bump.",
            "   False, and the old parameters go on, if a rule is broken. */",
            f"bool {P}_retune({arguments}, const {P}_parameters *parameters);", "",
        ]  # fmt: skip
    lines += [
        "/* Between these two calls numbers below the normal ones count as zero, as they do in the simulator. */",
        *_flushes(P),
        "#ifdef __cplusplus", "}", "#endif", "", f"#endif /* {guard} */",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def mark(P: str) -> str:
    """The name for the value of `configured` after a successful configure."""
    return f"{P.upper()}_CONFIGURED"


_OFF = {
    "controller": "then a step does nothing but command the safe force of the machine file",
    "plant": "then reset and step do nothing",
}
_USE = """\
    {P}_parameters parameters;
    {P}_{held} {held};
    {P}_defaults(&parameters);
    {P}_configure(&{held}, &parameters);
    {P}_reset(&{held}, &inputs);
    each sample: {P}_step(&{held}, &inputs, &outputs);

Compile without -ffast-math and its parts, with -ffp-contract=off and not for an x87: then the bits are those of the
simulation."""


def _trips(layout: Layout) -> list[str]:
    """Names for the codes of `trip`."""
    if layout.routine.memory != "controller":
        return []
    codes = [(name, value) for name, value in vars(guards).items() if name.startswith("TRIP_")]
    P = layout.routine.name.upper()
    wide = max(len(name) for name, _ in codes)
    said = {0.0: "nothing", **guards.TRIPS}
    lines = [f"#define {P}_{name:<{wide}} {int(code)} /* {said[code]} */" for name, code in codes]
    return ["/* What outputs.trip says: tripped by ... */", *lines, ""]


def _designed(name: str, layout: Layout) -> list[str]:
    """The struct of design numbers: parameters with unit and meaning, prepared ones under what their block says."""
    prepared = {node: each for each, node in reversed(layout.prepared)}
    lines, group = [], ""
    wide = max((len(field.name) for field in layout.design), default=0) + len(layout.precision) + 2
    for field in layout.design:
        kind, place = layout.leaves.get(field.node, ("", 0))
        said = layout.routine.said.get(prepared.get(field.node, ""), "") if kind == "" else ""
        if said != group:
            group = said
            lines += [f"    {line}".rstrip() for line in comment(said)] if said else [""]
        member = f"{'bool' if field.truth else layout.precision} {field.name};"
        beside = _meaning(layout.routine.parameters[place]) if kind == "parameter" else "s" if kind else ""
        lines.append(f"    {member:<{wide}} /* {beside} */" if beside else f"    {member}")
    return ["typedef struct {", *(lines or ["    char none; /* nothing is kept here */"]), f"}} {name};", ""]


def _meaning(variable: Variable) -> str:
    meaning = variable.meaning
    bounds = str(variable.declared.bounds()) if variable.declared is not None else ""
    bounds = bounds.replace(f" {variable.unit}", "") if variable.unit else bounds
    unit = f"{variable.unit}: " if variable.unit else ""
    return f"{unit}{meaning}" + (f"; {bounds}" if bounds else "")


def _struct(name: str, members: Sequence[tuple[str, str, str]]) -> list[str]:
    """A struct with what each member is; C has no empty one."""
    members = members or [("char", "none", "nothing is kept here")]
    lines = [f"    {kind} {member};" for kind, member, _ in members]
    wide = max(len(line) for line in lines)
    said = [f"{line:<{wide}} /* {text} */" if text else line for line, (_, _, text) in zip(lines, members, strict=True)]
    return ["typedef struct {", *said, f"}} {name};", ""]


def _grouped(name: str, members: Sequence[tuple[str, str, str]]) -> list[str]:
    """A struct with members in groups, each under its comment."""
    lines, group = [], ""
    for kind, member, said in members or [("char", "none", "")]:
        if said != group:
            group = said
            lines += [f"    {line}".rstrip() for line in comment(said)] if said else []
        lines.append(f"    {kind} {member};")
    return ["typedef struct {", *lines, f"}} {name};", ""]


def comment(text: str) -> list[str]:
    """A comment of one line or several; what could end it is taken apart."""
    lines = [""]
    for line in text.replace("*/", "* /").replace("/*", "/ *").split("\n"):
        lines += textwrap.wrap(line, _WIDTH, subsequent_indent=" " * (len(line) - len(line.lstrip()))) or [""]
    if len(lines) == 2:
        return [f"/* {lines[1]} */"]
    return ["/*", *(f" * {line}".rstrip() for line in lines[1:]), " */"]


def _flushes(P: str) -> list[str]:
    text = _FLUSHES.sub(lambda found: f"{P}_flush_{'begin' if found[0] == 'flush' else 'end'}", FLUSH)
    return [text.replace("static ", "static inline ")]
