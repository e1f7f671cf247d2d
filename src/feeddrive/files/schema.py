"""JSON Schema of machine and job files, from the declarations of the blocks; an editor completes and checks with it.

    python -m feeddrive.files.schema docs/schema

The schema admits every file that feeddrive reads.  It does not have the checks between parameters of a block, the
bounds of a number in another unit than the declared one, or the rule that a parameter must not be given twice in two
units.
"""

from __future__ import annotations

import json
import sys
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from feeddrive.blocks.coupling.geometry import Geometry
from feeddrive.blocks.families import Load, Reference
from feeddrive.blocks.machine_families import Coupling, Cutter
from feeddrive.files.atomic_io import write_whole
from feeddrive.files.columns import ROLES
from feeddrive.files.cutting import CutSection
from feeddrive.files.from_toml import Hint, defaults, hints, members, options_of_type
from feeddrive.files.planned_program import FILES
from feeddrive.language.block import Block
from feeddrive.language.declaration import Declaration, declarations
from feeddrive.loop.axis import Axis
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.path.limits import AxisLimits

Schema: TypeAlias = dict[str, Any]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
# a unit of `language.units`, word by word, after the name of a parameter
_WORD = "(?:[GMkcmun]?(?:m|g|s|A|rad|N|W|J|V|Hz)|kg|t|min|h|in|deg|mdeg|rev|U|rpm|percent|1|per)[0-9]?"
_SUFFIX = f"(?:_{_WORD})+"
_TEXT: Schema = {"type": "string"}
_POSITIVE: Schema = {"type": "number", "exclusiveMinimum": 0}
_WHOLE: Schema = {"type": "integer", "minimum": 0}


class _Definitions:
    """The schemas of blocks by name, each written once; `$ref` points at them."""

    def __init__(self) -> None:
        self.found: dict[str, Schema] = {}

    def part(self, hint: Hint) -> Schema:
        """One block that fits: by `kind` if there are several."""
        if hint.single():
            return self.block(hint.classes[0])
        name = "any." + "_or_".join(family.kind for family in hint.classes)
        if name not in self.found:
            self.found[name] = {}  # a block may hold one of its own family
            self.found[name] = self._any(members(hint))
        return {"$ref": f"#/$defs/{name}"}

    def _any(self, kinds: Mapping[str, type[Block]]) -> Schema:
        if not kinds:
            return {"not": {}}  # nothing fits
        return {
            "type": "object",
            "required": ["kind"],
            "properties": {"kind": {"enum": list(kinds), "description": "which block it is"}},
            "allOf": [
                {
                    "if": {"properties": {"kind": {"const": kind}}, "required": ["kind"]},
                    "then": self.block(block),
                }
                for kind, block in kinds.items()
            ],
        }

    def block(self, block: type[Block]) -> Schema:
        """A reference to the schema of a block."""
        name = f"{block.__module__.split('.')[-2]}.{block.kind}"
        if name not in self.found:
            self.found[name] = {}
            self.found[name] = self.fields(block)
        return {"$ref": f"#/$defs/{name}"}

    def fields(
        self, block: type[Block], others: Mapping[str, Schema] | None = None, without: Sequence[str] = ()
    ) -> Schema:
        """The schema of a table with the fields of a block, and other keys that are read elsewhere."""
        properties: dict[str, Schema] = {"kind": {"const": block.kind}, **(others or {})}
        patterns: dict[str, Schema] = {}
        needed: list[Schema] = []
        for name, declared in declarations(block).items():
            if name in without or declared.role == "label":
                continue
            properties[name] = self.field(block, name, declared)
            required = name not in defaults(block)
            if declared.role in ("parameter", "table"):
                patterns[f"^{name}{_SUFFIX}$"] = _number_elsewhere(declared)
                if required:  # under one of its names: not all names are others
                    other = {"not": {"pattern": f"^{name}(?:{_SUFFIX})?$"}}
                    needed.append({"not": {"propertyNames": other}})
            elif required:
                needed.append({"required": [name]})
        found: Schema = {
            "type": "object",
            "description": (block.__doc__ or "").strip().split("\n")[0],
            "properties": properties,
            "patternProperties": patterns,
            "additionalProperties": False,
        }
        return found | ({"allOf": needed} if needed else {})

    def field(self, block: type[Block], name: str, declared: Declaration) -> Schema:
        """The schema of one key in its declared unit."""
        described: Schema = {"description": _description(declared)}
        default = defaults(block).get(name)
        if isinstance(default, bool | int | float | str):
            described["default"] = default
        match declared.role:
            case "parameter":
                return {"type": "number", **described, **_bounds(declared)}
            case "table":
                return {"type": "array", "items": {"type": "number"}, "minItems": 2, **described}
            case "choice":
                options = [option for option in declared.options if option is not None]
                kind = {"enum": options} if options else _choice_type(hints(block)[name])
                return {**kind, **described, **({} if options else _bounds(declared))}
            case _:
                hint: Hint = hints(block)[name]
                inner = self.part(hint)
                return {"type": "array", "items": inner, **described} if hint.many else {**inner, **described}


def _description(declared: Declaration) -> str:
    return f"{declared.meaning}, {declared.unit}" if declared.unit else declared.meaning


def _bounds(declared: Declaration) -> Schema:
    words = {
        "exclusiveMinimum": declared.above,
        "minimum": declared.least,
        "exclusiveMaximum": declared.below,
        "maximum": declared.most,
    }
    return {word: bound for word, bound in words.items() if bound is not None}


_JSON_TYPES = {int: "integer", float: "number", str: "string", bool: "boolean"}


def _choice_type(annotation: Any) -> Schema:
    """The type of a choice: `int`, `str | None`, `tuple[int, ...]`."""
    options = options_of_type(annotation)
    if len(options) != 1:
        return {"anyOf": [_choice_type(each) for each in options]}
    only: Any = options[0]
    if typing.get_origin(only) is tuple:
        return {"type": "array", "items": _choice_type(typing.get_args(only)[0])}
    return {"type": _JSON_TYPES[only]}


def _number_elsewhere(declared: Declaration) -> Schema:
    """The same parameter in another unit: its bounds are checked when it is read."""
    described = {"description": f"{declared.meaning}, in the unit that the key names"}
    if declared.role == "table":
        return {"type": "array", "items": {"type": "number"}, "minItems": 2, **described}
    return {"type": "number", **described}


def machine_schema() -> Schema:
    """The schema of a machine file."""
    blocks = _Definitions()
    control = blocks.block(Control)
    axis = blocks.fields(Axis, {"control": control, "limits": blocks.block(AxisLimits)})
    axis["required"] = ["control"]
    texts = {
        "name": {**_TEXT, "description": "of the machine"},
        "source": {**_TEXT, "description": "where the numbers come from"},
        "remark": {**_TEXT, "description": "anything else"},
    }
    axes: Schema = {
        "type": "object",
        "minProperties": 1,
        "additionalProperties": axis,
        "description": "axes by name: [axis.x]",
    }
    couplings: Schema = {
        "type": "array",
        "items": blocks.part(Hint((Coupling,))),
        "description": "interactions of the axes: structure modes that they share, a cut, a recorded force",
    }
    more = {"axis": axes, "couplings": couplings, "geometry": blocks.block(Geometry)}
    root = blocks.fields(Loop, {**texts, **more}, without=("axis", "control"))
    root["required"] = ["axis"]
    return _file("machine", "A machine: axes with their physics and today's control", root, blocks)


def job_schema() -> Schema:
    """The schema of a job file."""
    blocks = _Definitions()
    column: Schema = {
        "oneOf": [
            _TEXT,
            {
                "type": "object",
                "required": ["column"],
                "properties": {
                    "column": _TEXT,
                    "unit": _TEXT,
                    "factor": {"type": "number", "description": "number · factor is in the unit, or in SI without one"},
                    "reason": {**_TEXT, "description": "why the column has the role"},
                },
                "additionalProperties": False,
            },
        ]
    }
    channels: Schema = {
        "type": "object",
        "properties": {
            role: {**column, "description": f"column that holds it, {unit or 'unit of the drive'}"}
            for role, unit in ROLES.items()
        },
        "additionalProperties": False,
    }
    log: Schema = {
        "type": "object",
        "description": "a measured log, whose reference is replayed",
        "properties": {
            "file": {**_TEXT, "description": "name of the log, beside the job"},
            "skip_samples": {**_WHOLE, "description": "samples at the start that do not count", "default": 0},
            "sample_time": {"type": "number", "exclusiveMinimum": 0, "description": "of a log without time, s"},
            "axis": {**_TEXT, "description": "of a log with several: that of the columns, as they name it"},
            "channels": {**channels, "description": "roles of columns"},
            "optional": {**channels, "description": "the same for columns that may be missing"},
        },
        "patternProperties": {f"^sample_time{_SUFFIX}$": {"type": "number", "exclusiveMinimum": 0}},
        "additionalProperties": False,
    }
    program: Schema = {
        "type": "object",
        "description": "a part program, planned, which moves all axes that it names",
        "oneOf": [{"required": ["file"]}, {"required": ["recorded", "columns"]}],
        "properties": {
            **dict.fromkeys(FILES, _TEXT),
            "columns": {
                "type": "object",
                "additionalProperties": _TEXT,
                "description": "of recorded setpoints by axis",
            },
            "tables_inch": {"type": "boolean", "description": "tools and offsets are in inches"},
            "skip_deleted": {"type": "boolean", "description": "leave out lines that begin with /"},
        },
        "patternProperties": {f"^(sample_time|average)({_SUFFIX})?$": _POSITIVE},
        "additionalProperties": False,
    }
    process: Schema = {
        "type": "object",
        "description": "what the part program cuts",
        "required": ["tool"],
        "properties": {
            "tool": {
                "type": "object",
                "description": "tools by their numbers in the program: [process.tool.1]",
                "patternProperties": {"^[0-9]+$": blocks.part(Hint((Cutter,)))},
                "additionalProperties": False,
            },
            "section": {
                "type": "array",
                "items": blocks.block(CutSection),
                "description": "what lines cut, over what comments say: (ap=4 ae=0.3 down)",
            },
        },
        "additionalProperties": False,
    }
    law: Schema = {
        "type": "object",
        "required": ["name"],
        "oneOf": [{"anyOf": [{"required": ["control"]}, {"required": ["axis"]}]}, {"required": ["set"]}],
        "properties": {
            "name": {**_TEXT, "minLength": 1, "description": "of the row"},
            "control": blocks.block(Control),
            "axis": {
                "type": "object",
                "description": "controls of axes by name: [law.axis.y.control]",
                "additionalProperties": {
                    "type": "object",
                    "required": ["control"],
                    "properties": {"control": blocks.block(Control)},
                    "additionalProperties": False,
                },
            },
            "set": {
                "type": "object",
                "description": 'changes of today\'s control by path: { "axis.x.control.law.Kv" = 80 }',
            },
        },
        "additionalProperties": False,
    }
    root: Schema = {
        "type": "object",
        "required": ["machine"],
        "oneOf": [{"required": ["reference"]}, {"required": ["log"]}, {"required": ["program"]}],
        "properties": {
            "title": {**_TEXT, "description": "of the report"},
            "machine": {**_TEXT, "description": "machine file beside the job, or the name of a bundled one"},
            "axis": {**_TEXT, "description": "name of the axis, if the machine has several"},
            "seed": {**_WHOLE, "description": "of the noise", "default": 0},
            "rule": {**_TEXT, "description": "what makes the rows comparable; printed in the report"},
            "duration": {"type": "number", "exclusiveMinimum": 0, "description": "of the runs, s"},
            "reference": {**blocks.part(Hint((Reference,))), "description": "the motion"},
            "load": {**blocks.part(Hint((Load,))), "description": "a force on the table"},
            "others": {
                "type": "object",
                "description": "motions of the other axes: [others.y.reference]; axes without one stand still",
                "additionalProperties": {
                    "type": "object",
                    "properties": {"reference": blocks.part(Hint((Reference,))), "load": blocks.part(Hint((Load,)))},
                    "additionalProperties": False,
                },
            },
            "log": log,
            "program": program,
            "process": process,
            "law": {"type": "array", "items": law, "description": "rows of the comparison after today's control"},
        },
        "additionalProperties": False,
    }
    return _file("job", "A job: a machine, its motion and loads, and the laws to compare on it", root, blocks)


def _file(name: str, title: str, root: Schema, blocks: _Definitions) -> Schema:
    return {
        "$schema": DIALECT,
        "title": f"feeddrive {name} file",
        **root,
        "description": title,
        "$defs": dict(sorted(blocks.found.items())),
    }


def write_schemas(folder: str | Path) -> list[Path]:
    """Write `machine.schema.json` and `job.schema.json` into a folder. Raises FileError if it cannot be written."""
    found: list[Path] = []
    for name, schema in (("machine", machine_schema()), ("job", job_schema())):
        found.append(Path(folder) / f"{name}.schema.json")
        write_whole(found[-1], json.dumps(schema, indent=2, ensure_ascii=False) + "\n")
    return found


if __name__ == "__main__":
    write_schemas(sys.argv[1])
