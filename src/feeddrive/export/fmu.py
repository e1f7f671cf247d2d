"""The targets `fmu2` and `fmu3`: variables, XML descriptions, the archive with its binary, and simulation in FMPy."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import platform
import re
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from feeddrive.cosimulation.simulate_with_fmu import Archive, Instance, opened
from feeddrive.export.c_bundle import compiler
from feeddrive.export.c_code import CODE, SENTENCE, number, texts
from feeddrive.export.design import Answers, Design, Trial
from feeddrive.export.identifiers import ascii_text
from feeddrive.export.layout import Layout
from feeddrive.export.targets import readme, write_bundle
from feeddrive.files.atomic_io import check_directory
from feeddrive.language.block import Declaration
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.language.units import measure
from feeddrive.loop.guard import TRIPS
from feeddrive.loop.loop import quantity
from feeddrive.loop.routine import Routine
from feeddrive.version import __version__

# The variables of an FMU: the C header that declares them, and the XML descriptions.

_BASE = ("m", "kg", "s", "A", "rad")  # in the order of `units.Dimension`
_DISPLAYED = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "s": ("ms", 1e3), "N": ("kN", 1e-3)}
_TAGS = {"number": ("Real", "Float64"), "truth": ("Boolean", "Boolean"), "enumeration": ("Enumeration", "Enumeration")}
_CAUSALITY = {"time": "independent", "sample_time": "parameter", "parameter": "parameter", "start": "parameter"}
# XML 1.0 admits these characters in no form, not even as references
_NOT_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_CATEGORIES = {
    "logEvents": "trips of the guard, and their end",
    "logStatusDiscard": "steps that are no whole multiple of the sample time",
    "logStatusError": "calls and values that are refused",
}


def model_description(
    version: int,
    name: str,
    title: str,
    token: str,
    tool: str,
    sample_time: float,
    variables: Sequence[FmuVariable],
    sources: Sequence[str],
) -> bytes:
    """Return modelDescription.xml of FMI 2.0 or 3.0; `sources` are the files to compile."""
    three = version == 3
    root = Element("fmiModelDescription", fmiVersion="3.0" if three else "2.0", modelName=name)
    root.set("instantiationToken" if three else "guid", token)
    root.set("description", _text(title))
    root.set("generationTool", tool)
    root.set("variableNamingConvention", "flat")
    state = "FMUState" if three else "FMUstate"
    simulated = SubElement(root, "CoSimulation", modelIdentifier=name, canHandleVariableCommunicationStepSize="true")
    simulated.set(f"canGetAndSet{state}", "true")
    simulated.set(f"canSerialize{state}", "true")
    if three:
        simulated.set("fixedInternalStepSize", repr(sample_time))
        simulated.set("providesDirectionalDerivatives", "false")
    else:
        simulated.set("canNotUseMemoryManagementFunctions", "true")
        simulated.set("providesDirectionalDerivative", "false")
        files = SubElement(simulated, "SourceFiles")
        for source in sources:
            SubElement(files, "File", name=source)
    _units(root, variables)
    if any(variable.kind == "enumeration" for variable in variables):
        _trip(root, three)
    categories = SubElement(root, "LogCategories")
    for category, meaning in _CATEGORIES.items():
        SubElement(categories, "Category", name=category, description=meaning)
    SubElement(root, "DefaultExperiment", startTime="0", stopTime="1", stepSize=repr(sample_time))
    _variables(SubElement(root, "ModelVariables"), three, variables)
    _structure(SubElement(root, "ModelStructure"), three, variables)
    return _written(root)


def build_description(name: str, sources: Sequence[str]) -> bytes:
    """Return sources/buildDescription.xml of FMI 3.0."""
    root = Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = SubElement(configuration, "SourceFileSet", language="C99")
    files.set("compilerOptions", "-ffp-contract=off")
    for source in sources:
        SubElement(files, "SourceFile", name=source)
    return _written(root)


def _text(text: str) -> str:
    """Replace each character that XML forbids with a space."""
    return _NOT_XML.sub(" ", text)


def _written(root: Element) -> bytes:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _units(root: Element, variables: Sequence[FmuVariable]) -> None:
    """Add every unit with the powers of its base units; one of them is the angle, so that Hz differs from 1/s."""
    units = sorted({variable.unit for variable in variables if variable.unit})
    definitions = SubElement(root, "UnitDefinitions")
    for name in units:
        unit = SubElement(definitions, "Unit", name=name)
        # the unit of a drive command, "A or V", has no base units
        with contextlib.suppress(ParameterError):
            factor, dimension = measure(name)
            powers = {base: str(power) for base, power in zip(_BASE, dimension, strict=True) if power}
            SubElement(unit, "BaseUnit", powers | ({} if factor == 1.0 else {"factor": repr(factor)}))
        if name in _DISPLAYED:
            shown, times = _DISPLAYED[name]
            SubElement(unit, "DisplayUnit", name=shown, factor=repr(times))


def _trip(root: Element, three: bool) -> None:
    """Add the trip codes of the guard as an enumeration."""
    types = SubElement(root, "TypeDefinitions")
    if three:
        kind = SubElement(types, "EnumerationType", name="Trip")
    else:
        kind = SubElement(SubElement(types, "SimpleType", name="Trip"), "Enumeration")
    for code, meaning in TRIP_NAMES.items():
        SubElement(kind, "Item", name=meaning.removeprefix("the ").removeprefix("a "), value=str(code))


def _variables(parent: Element, three: bool, variables: Sequence[FmuVariable]) -> None:
    for reference, variable in enumerate(variables):
        tag = _TAGS[variable.kind][three]
        outer = SubElement(
            parent, tag if three else "ScalarVariable", name=variable.name, valueReference=str(reference)
        )
        outer.set("causality", _CAUSALITY.get(variable.group, variable.group))
        outer.set("variability", _variability(variable))
        if variable.group != "time":
            if variable.group == "output":
                outer.set("initial", "calculated")
            elif variable.group != "input":
                outer.set("initial", "exact")
        outer.set("description", _text(variable.meaning))
        inner = outer if three else SubElement(outer, tag)
        if variable.kind == "enumeration":
            inner.set("declaredType", "Trip")
        if variable.unit:
            inner.set("unit", variable.unit)
        if variable.least > float("-inf"):
            inner.set("min", _bound(variable.least))
        if variable.most < float("inf"):
            inner.set("max", _bound(variable.most))
        if variable.start is not None:
            inner.set("start", repr(variable.start) if variable.kind == "number" else "false")


def _bound(value: float) -> str:
    """Return a bound as text; the smallest normal number, which represents the bound "above zero", is written as 0."""
    return repr(0.0 if abs(value) == sys.float_info.min else value)


def _variability(variable: FmuVariable) -> str:
    """Return the variability of a variable; inputs and outputs are discrete, so that no tool interpolates them."""
    if variable.group == "time":
        return "continuous"
    if variable.group in ("input", "output"):
        return "discrete"
    return "tunable" if variable.tunable else "fixed"


def _structure(parent: Element, three: bool, variables: Sequence[FmuVariable]) -> None:
    """Add the model structure: outputs are those of the last completed step, so there is no direct feedthrough."""
    outputs = [i for i, variable in enumerate(variables) if variable.group == "output"]
    if three:
        for i in outputs:
            SubElement(parent, "Output", valueReference=str(i), dependencies="")
        for i in outputs:
            SubElement(parent, "InitialUnknown", valueReference=str(i))
        return
    listed, unknown = SubElement(parent, "Outputs"), SubElement(parent, "InitialUnknowns")
    for i in outputs:
        # FMI 2.0 refers to variables by their index from 1, and not by their value reference
        SubElement(listed, "Unknown", index=str(i + 1), dependencies="")
        SubElement(unknown, "Unknown", index=str(i + 1))


TRIP_NAMES = {0: "none"} | {int(code): text for code, text in TRIPS.items()}
_TRUTHS = ("enable", "enabled")


class FmuVariable(NamedTuple):
    """A variable of an FMU; its index in the tuple of all variables is its value reference.

    group        "time", "sample_time", "parameter", "start" (a fixed parameter: the initial state), "input" or "output"
    kind         "number", "truth" or "enumeration"
    start        start value; None for a computed variable
    least, most  bounds that the model checks; infinite if there are none
    """

    name: str
    group: str
    kind: str
    unit: str
    meaning: str
    start: float | None
    tunable: bool = False
    least: float = -math.inf
    most: float = math.inf


def is_plant(routine: Routine) -> bool:
    """Return True if the routine is that of a plant, not of a controller."""
    return routine.memory == "plant"


def variables(routine: Routine) -> tuple[FmuVariable, ...]:
    """Return all variables, in the order of their value references."""
    T = routine.sample_time
    scalars = [
        FmuVariable("time", "time", "number", "s", "simulated time", None),
        # its bounds admit one value only: the control was designed for this sample time
        FmuVariable("sample_time", "sample_time", "number", "s", "from sample to sample; fixed", T, least=T, most=T),
    ]
    for parameter in routine.parameters:
        least, most = _bounds(parameter.declared)
        scalars.append(
            FmuVariable(
                parameter.name,
                "parameter",
                "number",
                parameter.unit,
                parameter.meaning,
                parameter.value,
                not is_plant(routine),
                least,
                most,
            )
        )
    scalars += [
        FmuVariable(
            i.name, "start" if quantity(i.path).startswith("start_") else "input", _kind(i.path), i.unit, i.meaning, 0.0
        )
        for i in routine.inputs
    ]
    for output in routine.outputs:
        scalars.append(FmuVariable(output.name, "output", _kind(output.path), output.unit, output.meaning, None))
    return tuple(scalars)


def _kind(path: str) -> str:
    name = quantity(path)
    return "truth" if name in _TRUTHS else "enumeration" if name == "trip" else "number"


def _bounds(declared: Declaration | None) -> tuple[float, float]:
    """Return the smallest and the largest permitted value; an exclusive bound is replaced by the adjacent number."""
    if declared is None:
        return -math.inf, math.inf
    least = -math.inf if declared.least is None else declared.least
    most = math.inf if declared.most is None else declared.most
    if declared.above is not None:
        least = _beside(declared.above, math.inf)
    if declared.below is not None:
        most = _beside(declared.below, -math.inf)
    return least, most


def _beside(bound: float, towards: float) -> float:
    """Return the number next to a bound; next to 0 the smallest normal one, since tools may flush subnormals to 0."""
    return math.copysign(sys.float_info.min, towards) if bound == 0.0 else math.nextafter(bound, towards)


_GROUPS = {"time": "TIME", "sample_time": "CLOCK", "parameter": "PARAMETER", "start": "START", "input": "INPUT"}
_STRUCTS = {"parameter": "parameters", "start": "inputs", "input": "inputs", "output": "outputs"}
_HEAD = """\
/* The model of this FMU: its token and its variables in the order of their value references. */
#ifndef FMU_MODEL_H
#define FMU_MODEL_H

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "{P}.h"

#define MODEL(word) {P}_##word
#define MODEL_CORE {P}_{held}
#define MODEL_TOKEN "{token}"
#define MODEL_SAMPLE_TIME {P_upper}_SAMPLE_TIME

enum group {{ TIME, CLOCK, PARAMETER, START, INPUT, OUTPUT }};
enum kind {{ NUMBER, TRUTH, ENUMERATION }};

struct variable {{
    const char *name;
    enum group group;
    enum kind kind;
    int tunable;
    size_t offset; /* in the struct of its group; START stands among the inputs */
    double least, most;
}};

static const struct variable VARIABLES[] = {{
"""
_CONTROLLER = """
/* The outputs before the first step: those of a sample in which the loop is off. */
static void model_first(MODEL_CORE *core, const MODEL(inputs) *inputs, MODEL(outputs) *outputs)
{
    MODEL_CORE copy = *core;
    MODEL(inputs) off = *inputs;
ENABLES
    MODEL(reset)(&copy, &off);
    MODEL(step)(&copy, &off, outputs);
}

/* At the first step: off, without a trip, where the axes are. */
static void model_start(MODEL_CORE *core, const MODEL(inputs) *inputs) { MODEL(reset)(core, inputs); }

static void model_tune(MODEL_CORE *core, const MODEL(parameters) *parameters) { MODEL(retune)(core, parameters); }

/* The trip of one of the loops. */
static int model_trip(const MODEL(outputs) *outputs, int loop)
{
    const double trips[] = {TRIPS};
    return (int)trips[loop];
}
"""
_PLANT = """
/* The axis at rest at its start position, and what its encoders read there. */
static void model_first(MODEL_CORE *core, const MODEL(inputs) *inputs, MODEL(outputs) *outputs)
{
    MODEL(reset)(core, inputs, outputs);
}

/* At the first step: all was done when the initialization ended. */
static void model_start(MODEL_CORE *core, const MODEL(inputs) *inputs)
{
    (void)core;
    (void)inputs;
}

/* No parameter of a plant is tunable. */
static void model_tune(MODEL_CORE *core, const MODEL(parameters) *parameters)
{
    (void)core;
    (void)parameters;
}

/* A plant has no guard. */
static int model_trip(const MODEL(outputs) *outputs, int loop)
{
    (void)outputs;
    (void)loop;
    return 0;
}
"""


def model_header(routine: Routine, token: str, variables: Sequence[FmuVariable]) -> str:
    """Return the text of `fmu_model.h`: the variables and the functions that depend on the model."""
    P = routine.name
    head = _HEAD.format(P=P, P_upper=P.upper(), held=routine.memory, token=token)
    rows = ",\n".join(f"    {_row(variable)}" for variable in variables)
    names = ", ".join(json.dumps(text) for text in TRIP_NAMES.values())
    rules = ",\n        ".join(json.dumps(ascii_text(text)) for text in routine.sentences.values()) or '""'
    ports = [""] if is_plant(routine) else [port.rstrip(".") for port in routine.origin.ports()]
    loops = ", ".join(json.dumps(f"axis {port}: " if port else "") for port in ports)
    enables = "\n".join(f"    off.{v.name} = 0.0;" for v in routine.inputs if quantity(v.path) == "enable")
    trips = ", ".join(f"outputs->{v.name}" for v in routine.outputs if quantity(v.path) == "trip")
    model = _PLANT if is_plant(routine) else _CONTROLLER.replace("ENABLES", enables).replace("TRIPS", trips)
    arithmetic = f"code == {CODE} ? {json.dumps(SENTENCE)} : "
    return (
        f"{head}{rows}\n}};\n\nenum {{ VARIABLE_COUNT = sizeof VARIABLES / sizeof VARIABLES[0] }};\n"
        f"{model}\n"
        f"enum {{ LOOP_COUNT = {len(ports)} }};\n"
        f"static const char *const LOOPS[] = {{{loops}}};\n\n"
        f"static const char *model_trip_name(int trip)\n{{\n    static const char *const names[] = {{{names}}};\n"
        f'    return trip >= 0 && trip < {len(TRIP_NAMES)} ? names[trip] : "unknown";\n}}\n\n'
        f"static const char *model_rule(int code)\n{{\n    static const char *const rules[] = {{{rules}}};\n"
        f"    return {arithmetic}"
        f'code > 0 && code <= {len(routine.conditions)} ? rules[code - 1] : "unknown";\n}}\n\n#endif\n'
    )


def _row(variable: FmuVariable) -> str:
    struct = _STRUCTS.get(variable.group)
    offset = "0" if struct is None else f"offsetof(MODEL({struct}), {variable.name})"
    kind = {"number": "NUMBER", "truth": "TRUTH", "enumeration": "ENUMERATION"}[variable.kind]
    group = _GROUPS.get(variable.group, "OUTPUT")
    bounds = f"{number(variable.least)}, {number(variable.most)}"
    return f'{{"{variable.name}", {group}, {kind}, {int(variable.tunable)}, {offset}, {bounds}}}'


# The targets `fmu2` and `fmu3`: the archive, its binary for this computer, and its execution in FMPy.

VERSIONS = (2, 3)
_SOURCES = Path(__file__).parent / "fmi"
_SHARED = ("fmu_instance.h", "fmu_functions.h")
# reserved file names in the folder of the model's sources, and C library headers that they would hide
_TAKEN = (
    "fmu_model",
    "fmu_instance",
    "fmu_functions",
    "fmi2",
    "fmi3",
    "fmi2functions",
    "fmi2functiontypes",
    "fmi2typesplatform",
    "fmi3functions",
    "fmi3functiontypes",
    "fmi3platformtypes",
    "math",
    "stdarg",
    "stdbool",
    "stddef",
    "stdint",
    "stdio",
    "stdlib",
    "string",
    "xmmintrin",
)


# tools compile the sources with their own flags, for any processor
_EXACT = """\
/* A fused multiply-add rounds once and would give other bits than the simulation. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif

"""


def fmu(layout: Layout, version: int, *, title: str, made_by: str, binary: bool = True) -> bytes:
    """Return the FMU of a routine for co-simulation with FMI 2.0 or 3.0; identical routines give identical bytes.

    title, made_by  description of the design, and names of program and machine file; the FMU contains both
    binary          True to include a library for this computer; otherwise tools compile the included sources

    Raises ParameterError for another version, single precision or a name that the archive reserves, FileError and
    MissingProgramError as `compiled` does.
    """
    routine = layout.routine
    if version not in VERSIONS:
        raise ParameterError(f"FMI {version} is not supported: take 2 or 3")
    if layout.precision != "double":
        raise ParameterError("an FMU computes in double precision: leave --precision out")
    if routine.name.lower() in _TAKEN:
        raise ParameterError(f"an FMU cannot be named '{routine.name}': a header has that name; take {routine.name}_x")
    tool = f"feeddrive {__version__}"
    own = texts(layout, title, made_by)
    P = routine.name
    files = {f"{P}.h": own.header, f"{P}.c": _EXACT + own.source, f"{P}_configure.c": _EXACT + own.configure}
    files |= {name: _read("sources", name) for name in (f"fmi{version}.c", *_SHARED)}
    headers = sorted((_SOURCES / "headers").glob(f"fmi{version}*.h"))
    files |= {header.name: _read("headers", header.name) for header in headers}
    compiles = [f"{P}.c", f"{P}_configure.c", f"fmi{version}.c"]
    scalars = variables(routine)

    def described(token: str) -> bytes:
        return model_description(version, P, title, token, tool, routine.sample_time, scalars, compiles)

    # the token appears in the texts of which it is the digest: they are hashed with an empty one
    token = _token([described(""), model_header(routine, "", scalars).encode(), *(t.encode() for t in files.values())])
    files["fmu_model.h"] = model_header(routine, token, scalars)
    entries = {"modelDescription.xml": described(token)}
    entries |= {f"sources/{name}": text.encode() for name, text in files.items()}
    if version == 3:
        entries["sources/buildDescription.xml"] = build_description(P, compiles)
    if binary:
        entries[f"binaries/{library_place(version).replace('*', P)}"] = compiled(files, compiles)
    return _packed(entries)


def _read(folder: str, name: str) -> str:
    return (_SOURCES / folder / name).read_text(encoding="utf-8")


def _token(parts: list[bytes]) -> str:
    """Return a digest of the complete model in the format of a GUID."""
    digest = hashlib.sha256()
    for part in parts:
        # with the length, so that a byte moved from one part to the next changes the digest
        digest.update(len(part).to_bytes(8, "little") + part)
    text = digest.hexdigest()
    return f"{{{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:32]}}}"


def _packed(entries: dict[str, bytes]) -> bytes:
    """Return a ZIP archive without time stamps and owners, so that identical content gives identical bytes."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted(entries.items(), key=lambda entry: (entry[0] != "modelDescription.xml", entry[0])):
            # the earliest time that a ZIP archive can state
            information = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            information.compress_type = zipfile.ZIP_DEFLATED
            executable = name.startswith("binaries/")
            information.external_attr = (0o100755 if executable else 0o100644) << 16
            archive.writestr(information, content)
    return packed.getvalue()


def write_fmu(design: Design, out: Path, *, version: int = 2, binary: bool = True) -> Path:
    """Write the export atomically and return the path of the README.

    Raises FileError as `new_directory` does, and the errors of `fmu`.
    """
    check_directory(out)
    content = fmu(design.layout, version, title=design.title, made_by=design.made_by, binary=binary)
    files: dict[str, bytes | str] = {
        f"{design.name}.fmu": content,
        "README.md": _readme(design, version, binary),
    }
    return write_bundle(design, f"fmu{version}", out, files, binary=binary)


def _readme(design: Design, version: int, binary: bool) -> str:
    return readme(
        "fmu.md.j2",
        design,
        file=f"{design.name}.fmu",
        version=version,
        binary=binary,
        T=f"{1e6 * design.routine.sample_time:g}",
        rows=[
            (variable, _what(variable), _start(variable))
            for variable in variables(design.routine)
            if variable.group != "time"
        ],
    )


def _what(variable: FmuVariable) -> str:
    if variable.group in ("input", "output"):
        return variable.group
    return "tunable parameter" if variable.tunable else "fixed parameter"


def _start(variable: FmuVariable) -> str:
    return "" if variable.start is None else f"{variable.start:.10g}" if variable.kind == "number" else "false"


_FLAGS = (
    "-std=c99",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fvisibility=hidden",
    # ziglang's compiler switches this sanitizer on by itself
    "-fno-sanitize=undefined",
)


def library_place(version: int) -> str:
    """Return the path pattern of the library that tools on this computer load, such as `linux64/*.so`."""
    system = {"Linux": "linux", "Darwin": "darwin", "Windows": "windows"}.get(platform.system(), "linux")
    wide = sys.maxsize > 2**32
    ending = {"linux": "so", "darwin": "dylib", "windows": "dll"}[system]
    if version == 2:
        return f"{system.replace('windows', 'win')}{64 if wide else 32}/*.{ending}"
    arm = platform.machine().lower() in ("aarch64", "arm64")
    return f"{'aarch64' if arm else 'x86_64' if wide else 'x86'}-{system}/*.{ending}"


def compiled(files: Mapping[str, str], sources: Sequence[str]) -> bytes:
    """Compile files into a shared library and return its bytes.

    The code that runs once, `*_configure.c`, is compiled without optimization, since optimizing it takes seconds.

    Raises MissingProgramError if there is no compiler, and FileError, with its first message, if compilation fails.
    """
    words = compiler()
    flags = _FLAGS if platform.system() == "Windows" else (*_FLAGS, "-fPIC")
    with tempfile.TemporaryDirectory(prefix="feeddrive-") as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        objects = [f"{name}.o" for name in sources]
        for name, object_file in zip(sources, objects, strict=True):
            effort = "-O0" if name.endswith("_configure.c") else "-O2"
            _run([*words, *flags, effort, "-c", name, "-o", object_file], folder)
        _run([*words, "-shared", "-s", "-o", "library", *objects, "-lm"], folder)
        return (Path(folder) / "library").read_bytes()


def _run(words: Sequence[str], folder: str) -> None:
    done = subprocess.run(
        words, cwd=folder, capture_output=True, text=True, encoding="utf-8", errors="replace", check=False
    )
    if done.returncode != 0:
        first = (done.stderr.strip() or "no message").splitlines()[0]
        raise FileError(f"the C compiler ({words[0]}) cannot make a shared library: {first}")


_ACCESS = {
    "Real": "Real",
    "Float64": "Float64",
    "Boolean": "Boolean",
    "Enumeration": "Integer",
    "Enumeration 3": "Int64",
}


def answers(path: Path, routine: Routine, tried: Trial) -> np.ndarray:
    """Run a trial, with its parameter changes, on the FMU of a controller; return the outputs, shape (n, outputs).

    Raises FmuError for an FMU that cannot be opened or fails, and MissingExtraError if FMPy is not installed.
    """
    parameters = {v.path: v.name for v in routine.parameters}
    T = routine.sample_time
    outputs = np.empty((len(tried.inputs), len(routine.outputs)))
    with opened(path) as archive, Instance(archive) as held:
        give = _access(archive, held.fmu, "set", [v.name for v in routine.inputs])
        take = _access(archive, held.fmu, "get", [v.name for v in routine.outputs])
        held.begin([], {})
        for k, row in enumerate(tried.inputs):
            for name, value in tried.changes.get(k, {}).items():
                _access(archive, held.fmu, "set", [parameters[name]])([value])
            give(row.tolist())
            held.step(k * T, T)
            outputs[k] = take(None)
    return outputs


def _access(archive: Archive, fmu: Any, verb: str, names: Sequence[str]) -> Callable[[Sequence[float] | None], Any]:
    """Return a function that sets or gets the named variables, with one call of the FMU for each type."""
    known = {variable.name: variable for variable in archive.description.modelVariables}
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        kind = known[name].type
        three = kind == "Enumeration" and archive.three
        groups.setdefault(_ACCESS["Enumeration 3" if three else kind], []).append(i)
    calls = [
        (kind == "Boolean", places, [known[names[i]].valueReference for i in places], getattr(fmu, verb + kind))
        for kind, places in groups.items()
    ]

    def access(values: Sequence[float] | None) -> list[float]:
        row = [0.0] * len(names)
        for truth, places, references, call in calls:
            if values is not None:
                call(references, [values[i] > 0.5 if truth else values[i] for i in places])
            else:
                for i, value in zip(places, call(references), strict=True):
                    row[i] = float(value)
        return row

    return access


def prove(directory: Path, design: Design, tried: Trial) -> Answers:
    """Run a trial in FMPy. Raises the errors of `answers`."""
    outputs = answers(directory / f"{design.name}.fmu", design.routine, tried)
    # an optional package, imported here: if it is missing, `answers` has raised the error that names it
    import fmpy

    return Answers(outputs, f"FMPy {fmpy.__version__}", "the library in the FMU")
