"""The targets `fmu2` and `fmu3`: the archive, its binary for this computer, and its run in FMPy."""

from __future__ import annotations

import hashlib
import io
import platform
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from feeddrive.cosimulation.fmu import Archive, Instance, opened
from feeddrive.export.c.programs import compiler
from feeddrive.export.c.text import texts
from feeddrive.export.design import Design
from feeddrive.export.fmu.description import FmuVariable, build_description, model_description, model_header, variables
from feeddrive.export.layout import Layout
from feeddrive.export.manifest import readme, write_bundle
from feeddrive.export.trial import Answers, Trial
from feeddrive.files.atomic_io import check_directory
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.loop.routine import Routine
from feeddrive.version import __version__

VERSIONS = (2, 3)
_HERE = Path(__file__).parent
_SHARED = ("fmu_instance.h", "fmu_functions.h")
# files beside which the model's own stand, and headers of the C library that they would hide
_TAKEN = (
    "fmu_model", "fmu_instance", "fmu_functions", "fmi2", "fmi3", "fmi2functions", "fmi2functiontypes",
    "fmi2typesplatform", "fmi3functions", "fmi3functiontypes", "fmi3platformtypes", "math", "stdarg", "stdbool",
    "stddef", "stdint", "stdio", "stdlib", "string", "xmmintrin",
)  # fmt: skip


# for any compiler and any processor
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
    """The FMU of a laid-out routine, for co-simulation by FMI 2.0 or 3.0; the same routine gives the same bytes.

    title, made_by   what it is, and which program made it from which file; both stand in its texts
    binary           with a library for this machine; without one, tools compile it from the sources that it holds

    Raises ParameterError for another version, single precision or a name that the archive needs itself, FileError and
    MissingProgramError as `binary.compiled`.
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
    files |= {each.name: _read("headers", each.name) for each in sorted((_HERE / "headers").glob(f"fmi{version}*.h"))}
    compiles = [f"{P}.c", f"{P}_configure.c", f"fmi{version}.c"]
    scalars = variables(routine)

    def described(token: str) -> bytes:
        return model_description(version, P, title, token, tool, routine.sample_time, scalars, compiles)

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
    return (_HERE / folder / name).read_text(encoding="utf-8")


def _token(parts: list[bytes]) -> str:
    """A digest of the complete model, in the form of a GUID."""
    digest = hashlib.sha256()
    for each in parts:
        digest.update(len(each).to_bytes(8, "little") + each)
    text = digest.hexdigest()
    return f"{{{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:32]}}}"


def _packed(entries: dict[str, bytes]) -> bytes:
    """A ZIP archive without time stamps and owners."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted(entries.items(), key=lambda each: (each[0] != "modelDescription.xml", each[0])):
            information = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            information.compress_type = zipfile.ZIP_DEFLATED
            executable = name.startswith("binaries/")
            information.external_attr = (0o100755 if executable else 0o100644) << 16
            archive.writestr(information, content)
    return packed.getvalue()


def write_fmu(design: Design, out: Path, *, version: int = 2, binary: bool = True) -> Path:
    """Write the export, completely or not at all; returns the README.

    Raises FileError as `new_directory` and what `fmu` raises.
    """
    check_directory(out)
    content = fmu(design.layout, version, title=design.title, made_by=design.made_by, binary=binary)
    files: dict[str, bytes | str] = {
        f"{design.name}.fmu": content, "README.md": _readme(design, version, binary),
    }  # fmt: skip
    return write_bundle(design, f"fmu{version}", out, files, binary=binary)


def _readme(design: Design, version: int, binary: bool) -> str:
    return readme(
        "fmu.md.j2", design, file=f"{design.name}.fmu", version=version, binary=binary,
        T=f"{1e6 * design.routine.sample_time:g}",
        rows=[(each, _what(each), _start(each)) for each in variables(design.routine) if each.group != "time"],
    )  # fmt: skip


def _what(variable: FmuVariable) -> str:
    if variable.group in ("input", "output"):
        return variable.group
    return "tunable parameter" if variable.tunable else "fixed parameter"


def _start(variable: FmuVariable) -> str:
    return "" if variable.start is None else f"{variable.start:.10g}" if variable.kind == "number" else "false"


_FLAGS = (
    "-std=c99", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden", "-fno-sanitize=undefined",
)  # fmt: skip


def library_place(version: int) -> str:
    """The folder of the FMU in which a tool on this machine looks, and the ending of a library: `linux64/*.so`."""
    system = {"Linux": "linux", "Darwin": "darwin", "Windows": "windows"}.get(platform.system(), "linux")
    wide = sys.maxsize > 2**32
    ending = {"linux": "so", "darwin": "dylib", "windows": "dll"}[system]
    if version == 2:
        return f"{system.replace('windows', 'win')}{64 if wide else 32}/*.{ending}"
    arm = platform.machine().lower() in ("aarch64", "arm64")
    return f"{'aarch64' if arm else 'x86_64' if wide else 'x86'}-{system}/*.{ending}"


def compiled(files: Mapping[str, str], sources: Sequence[str]) -> bytes:
    """The shared library made of some of the files.

    The code that runs once, `*_configure.c`, is compiled without optimization, which would take seconds.

    Raises MissingProgramError without a compiler and FileError with its first message if it refuses.
    """
    words = compiler()
    flags = _FLAGS if platform.system() == "Windows" else (*_FLAGS, "-fPIC")
    with tempfile.TemporaryDirectory(prefix="feeddrive-") as folder:
        for name, text in files.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        objects = [f"{name}.o" for name in sources]
        for name, made in zip(sources, objects, strict=True):
            effort = "-O0" if name.endswith("_configure.c") else "-O2"
            _run([*words, *flags, effort, "-c", name, "-o", made], folder)
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
    "Real": "Real", "Float64": "Float64", "Boolean": "Boolean", "Enumeration": "Integer", "Enumeration 3": "Int64"
}  # fmt: skip


def answers(path: Path, routine: Routine, tried: Trial) -> np.ndarray:
    """The outputs of a controller's FMU, shape (n, outputs), sample by sample, parameters changed between steps.

    Raises FmuError for an FMU that cannot be opened or fails, and MissingExtraError without FMPy.
    """
    parameters = {v.path: v.name for v in routine.parameters}
    T = routine.sample_time
    found = np.empty((len(tried.inputs), len(routine.outputs)))
    with opened(path) as archive, Instance(archive) as held:
        give = _access(archive, held.fmu, "set", [v.name for v in routine.inputs])
        take = _access(archive, held.fmu, "get", [v.name for v in routine.outputs])
        held.begin([], {})
        for k, row in enumerate(tried.inputs):
            for name, value in tried.changes.get(k, {}).items():
                _access(archive, held.fmu, "set", [parameters[name]])([value])
            give(row.tolist())
            held.step(k * T, T)
            found[k] = take(None)
    return found


def _access(archive: Archive, fmu: Any, verb: str, names: Sequence[str]) -> Callable[[Sequence[float] | None], Any]:
    """Sets or gets variables by name, each by the function of its type, those of one type in one call."""
    known = {each.name: each for each in archive.description.modelVariables}
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
    """Run a trial in FMPy. Raises as `answers`."""
    outputs = answers(directory / f"{design.name}.fmu", design.routine, tried)
    import fmpy  # an extra: `answers` has said so if it is missing

    return Answers(outputs, f"FMPy {fmpy.__version__}", "the library in the FMU")
