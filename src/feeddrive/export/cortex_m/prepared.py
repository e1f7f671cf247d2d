"""What configure makes of the parameters of the machine file, as constants: for a step whose gains never change."""

from __future__ import annotations

from feeddrive.export.c.expressions import number
from feeddrive.export.layout import Layout
from feeddrive.export.layout_run import LayoutRun


def prepared_files(layout: Layout) -> dict[str, str]:
    """`P_prepared.h` and `P_prepared.c`; with it neither configure nor what it calls need to be linked."""
    P, run = layout.routine.name, LayoutRun(layout)
    numbers = [f"        .{field.name} = {_text(run.design[field.node], layout.precision)}," for field in layout.design]
    parameters = [f"        .{v.name} = {number(v.value)}," for v in layout.routine.parameters]
    source = [
        f'#include "{P}_prepared.h"',
        "",
        "#include <math.h>",
        "",
        f"void {P}_prepared({P}_controller *controller)",
        "{",
        *_constant(f"{P}_design", "design", numbers),
        *_constant(f"{P}_parameters", "parameters", parameters),
        *(f"    controller->{name} = {name};" for name, rows in _given(numbers, parameters) if rows),
        "    controller->configured = true;",
        "}",
        "",
    ]  # fmt: skip
    header = _HEADER.format(P=P, guard=f"{P.upper()}_PREPARED_H")
    return {f"{P}_prepared.h": header, f"{P}_prepared.c": "\n".join(source)}


def _given(numbers: list[str], parameters: list[str]) -> tuple[tuple[str, list[str]], ...]:
    return (("design", numbers), ("parameters", parameters))


def _constant(kind: str, name: str, lines: list[str]) -> list[str]:
    return [f"    static const {kind} {name} = {{", *lines, "    };"] if lines else []


def _text(value: object, real: str) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return number(float(value), real)  # type: ignore[arg-type]


_HEADER = """\
/* In place of {P}_defaults and {P}_configure where no parameter changes: the same numbers, computed by the export. */
#ifndef {guard}
#define {guard}

#include "{P}.h"

#ifdef __cplusplus
extern "C" {{
#endif

void {P}_prepared({P}_controller *controller);

#ifdef __cplusplus
}}
#endif

#endif
"""
