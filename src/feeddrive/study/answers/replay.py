"""One variant of a study as a machine file with a job beside it, for  feeddrive run."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from feeddrive.blocks.families import Load, Reference
from feeddrive.files.job import Job
from feeddrive.files.machine import machine_toml
from feeddrive.files.planned_program import FILES
from feeddrive.files.to_toml import to_toml
from feeddrive.loop.machine import Machine
from feeddrive.study.study import Study
from feeddrive.study.variant_groups import VariantGroup, variant_groups
from feeddrive.study.variants import variants


def replay_files(study: Study, variant: int) -> dict[str, str]:
    """Texts by file name, the job first: `variant_00000012.toml` and `variant_00000012_machine.toml`.

    The machine has the control of the variant's law as its own, so that the job's only row is `today`.  Numbers are
    written to the last bit; the cutting process of a part program becomes a coupling of the machine.
    Raises ParameterError or StructureError for a variant whose numbers make no machine.
    """
    group = next(variant_groups(study, variants(study, variant, 1)))
    system = group.one(0)
    machine = system if isinstance(system, Machine) else Machine.of({group.axis: system})
    file = group.base.job.machine
    limits = {axis: axis_limits for axis, axis_limits in file.limits.items() if axis in machine.axes()}
    name = f"variant_{variant:08d}"
    origin = f"variant {variant} of the study {Path(study.file.name).name}, row '{group.base.row}'"
    return {
        f"{name}.toml": "\n".join(_job(study, group, f"{name}_machine.toml", origin)),
        f"{name}_machine.toml": machine_toml(machine, f"{file.name}, {origin}", file.source, file.remark, limits),
    }


def _job(study: Study, group: VariantGroup, machine: str, origin: str) -> Iterator[str]:
    """The job file, section by section."""
    job = group.base.job
    values: dict[str, Any] = {"title": f"{study.title}: {origin}", "machine": machine, "axis": group.axis}
    values |= {"seed": int(group.seed[0])} | ({} if group.duration is None else {"duration": group.duration})
    yield "\n".join(f"{key} = {_written(value)}" for key, value in values.items()) + "\n"
    references, loads = _by_axis(group.references, group.axis), _by_axis(group.loads, group.axis)
    if job.program is not None:
        yield _program(job)
        references = {}
    rotary = {axis: loop.axis.rotary for axis, loop in group.system.loops().items()}
    for kind, blocks in (("reference", references), ("load", loads)):
        for axis, block in blocks.items():
            key = kind if axis == group.axis else f"others.{axis}.{kind}"
            yield to_toml(block, key, rotary=rotary[axis])


def _by_axis(blocks: Any, axis: str) -> Mapping[str, Reference | Load]:
    """Return motions or loads by the name of their axis; none if there are none."""
    if blocks is None:
        return {}
    return blocks if isinstance(blocks, Mapping) else {axis: blocks}


def _program(job: Job) -> str:
    """The section [program], its files by whole paths."""
    assert job.program is not None
    folder = Path(job.file.name).parent
    values = dict(job.file.content["program"])
    for key in FILES:
        if isinstance(values.get(key), str):
            path = job.program.file if key == "file" and job.program.file is not None else folder / values[key]
            values[key] = str(path.resolve())
    return "\n".join(["[program]", *(f"{key} = {_written(value)}" for key, value in values.items())]) + "\n"


def _written(value: Any) -> str:
    """A value as TOML: text, truth, number, or a table of them on one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(key)} = {_written(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, str | bool):
        return json.dumps(value, ensure_ascii=False)
    return repr(value)
