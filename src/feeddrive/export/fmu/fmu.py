"""The targets `fmu2` and `fmu3`: the archive with description, C sources and binary, and a README."""

from __future__ import annotations

import hashlib
import io
import zipfile
from pathlib import Path

from feeddrive.export.c.text import texts
from feeddrive.export.design import MACHINE_FILE, Design
from feeddrive.export.fmu.binary import compiled, library_place
from feeddrive.export.fmu.description import build_description, model_description
from feeddrive.export.fmu.model import FmuVariable, model_header, variables
from feeddrive.export.layout import Layout
from feeddrive.export.manifest import FILE, manifest_text
from feeddrive.export.readme import readme
from feeddrive.files.atomic_io import check_directory, new_directory
from feeddrive.language.errors import ParameterError
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
/* A product and a sum that are rounded once would give other bits than the simulation. */
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
        raise ParameterError(f"there is no export to FMI {version}: take 2 or 3")
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
    """A digest of all that the model is, in the form of a GUID."""
    digest = hashlib.sha256()
    for each in parts:
        digest.update(len(each).to_bytes(8, "little") + each)
    text = digest.hexdigest()
    return f"{{{text[:8]}-{text[8:12]}-{text[12:16]}-{text[16:20]}-{text[20:32]}}}"


def _packed(entries: dict[str, bytes]) -> bytes:
    """A ZIP archive without clocks and owners."""
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
    """Write the export, whole or not at all; the README is returned.

    Raises FileError as `new_directory` and what `fmu` raises.
    """
    check_directory(out)
    content = fmu(design.layout, version, title=design.title, made_by=design.made_by, binary=binary)
    files: dict[str, bytes | str] = {
        f"{design.name}.fmu": content, "README.md": _readme(design, version, binary),
        MACHINE_FILE: design.machine.file.text,
    }  # fmt: skip
    files[FILE] = manifest_text(design, f"fmu{version}", files, binary=binary)
    with new_directory(out) as folder:
        for name, each in files.items():
            (folder / name).write_bytes(each.encode() if isinstance(each, str) else each)
    return out / "README.md"


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
