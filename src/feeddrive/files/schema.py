"""JSON Schema of the user's files, generated from the declarations of sections and blocks.

Editors use it to complete and check keys.  The schema accepts every file that feeddrive reads.  It does not contain
checks that involve several parameters of a block, bounds of a number in a unit other than the declared one, or the rule
that a parameter must not be given twice in two units.  `workflow/schemas.py` lists the kinds of files and writes the
schemas.
"""

import typing
from collections.abc import Mapping
from typing import Any, TypeAlias

from feeddrive.files.section import VARIED, Hint, Section, hints, members, options_of_type
from feeddrive.language.block import Block, Declaration, declarations, defaults
from feeddrive.language.units import WORD

Schema: TypeAlias = dict[str, Any]

DIALECT = "https://json-schema.org/draft/2020-12/schema"
# a unit of `language.units`, word by word, after the name of a parameter
_WORD = f"(?:{WORD}|per)[0-9]?"
_SUFFIX = f"(?:_{_WORD})+"
_TEXT: Schema = {"type": "string"}
_NUMBERS = "numbers_by_path"


def schema_of(section: type[Section], name: str) -> Schema:
    """Return the schema of a file whose content is a section; `name` is the kind of file, for the title."""
    definitions = _Definitions()
    content = definitions.fields(section)
    return {
        "$schema": DIALECT,
        "title": f"feeddrive {name} file",
        **content,
        "$defs": dict(sorted(definitions.by_name.items())),
    }


class _Definitions:
    """The schemas of blocks and sections by name, each defined once and referenced by `$ref`."""

    def __init__(self) -> None:
        self.by_name: dict[str, Schema] = {}

    def part(self, hint: Hint) -> Schema:
        """Return the schema of a part: that of the only matching class, or a choice among several classes."""
        first = hint.classes[0]
        if issubclass(first, Section):
            fitting = [self.reference(member) for member in members(hint).values()]
            fitting += [_TEXT] if first.shorthand else []
            return fitting[0] if len(fitting) == 1 else {"anyOf": fitting}
        if hint.single():
            return self.reference(first)
        name = "any." + "_or_".join(family.kind for family in hint.classes)
        if name not in self.by_name:
            # Entered before it is filled: a block may hold one of its own family, which ends the recursion.
            self.by_name[name] = {}
            self.by_name[name] = self._any(members(hint))
        return {"$ref": f"#/$defs/{name}"}

    def _any(self, kinds: Mapping[str, type[Block]]) -> Schema:
        if not kinds:
            # No value satisfies `not` the empty schema.
            return {"not": {}}
        return {
            "type": "object",
            "required": ["kind"],
            "properties": {"kind": {"enum": list(kinds), "description": "which block it is"}},
            "allOf": [
                {
                    # Conditions rather than `anyOf`: an editor then reports the fault of the chosen kind, not that none
                    # fits.
                    "if": {"properties": {"kind": {"const": kind}}, "required": ["kind"]},
                    "then": self.reference(block),
                }
                for kind, block in kinds.items()
            ],
        }

    def reference(self, kind: type[Block] | type[Section]) -> Schema:
        """Return a reference to the schema of a block or section."""
        name = f"{kind.__module__.split('.')[-2]}.{kind.kind}"
        if name not in self.by_name:
            self.by_name[name] = {}
            self.by_name[name] = self.fields(kind)
        return {"$ref": f"#/$defs/{name}"}

    def fields(self, kind: type[Block] | type[Section]) -> Schema:
        """Return the schema of a table with the fields of a block or section."""
        properties: dict[str, Schema] = {"kind": {"const": kind.kind}}
        patterns: dict[str, Schema] = {}
        needed: list[Schema] = []
        for name, declared in declarations(kind).items():
            if declared.role == "label":
                continue
            if issubclass(kind, Section) and declared.inline:
                inner = self.fields(hints(kind)[name].classes[0])
                properties = {**inner["properties"], **properties, "kind": inner["properties"]["kind"]}
                patterns |= inner["patternProperties"]
                needed += inner.get("allOf", [])
                continue
            properties[name] = self.field(kind, name, declared)
            if declared.role in ("parameter", "table"):
                patterns[f"^{name}{_SUFFIX}$"] = _number_elsewhere(declared)
            if name not in defaults(kind):
                needed.append(_needed(name, declared))
        schema: Schema = {
            "type": "object",
            "description": (kind.__doc__ or "").strip().split("\n")[0],
            "properties": properties,
            "patternProperties": patterns,
            "additionalProperties": False,
        }
        if issubclass(kind, Section):
            needed += self._of_section(kind)
            schema["additionalProperties"] = kind.is_open
            if kind.is_open:
                # Keys of other readers are not checked here, `kind` among them.
                del properties["kind"]
        schema |= {"allOf": needed} if needed else {}
        return self._with_inlined(kind, schema) if issubclass(kind, Section) and kind.inlined else schema

    def _of_section(self, section: type[Section]) -> list[Schema]:
        """Return the requirements of a section other than its required fields: `kind`, and exactly one alternative."""
        needed: list[Schema] = [{"required": ["kind"]}] if section.needs_kind else []
        if section.exactly:
            alternatives = [{"anyOf": [{"required": [name]} for name in names]} for names in section.exactly]
            needed.append({"oneOf": alternatives})
        return needed

    def _with_inlined(self, section: type[Section], own: Schema) -> Schema:
        """Return the schema of a section that contains the keys of another one inline if one of its fields is absent.

        These keys are not required here, since a study may set them through its choices.
        """
        ((name, other),) = section.inlined.items()
        inner = self.fields(other)
        properties = {**inner["properties"], **own["properties"]}
        whole = {**own, "properties": properties, "patternProperties": inner["patternProperties"]}
        own = {key: value for key, value in own.items() if key not in ("type", "description")}
        return {
            "type": "object",
            "description": whole.pop("description"),
            # Repeated at the top for editors, which complete keys from here and not from branches.
            "properties": properties,
            "if": {"required": [name]},
            "then": own,
            "else": whole,
        }

    def field(self, kind: type[Block] | type[Section], name: str, declared: Declaration) -> Schema:
        """Return the schema of one key in its declared unit."""
        described: Schema = {"description": _description(declared)}
        default = defaults(kind).get(name)
        if isinstance(default, bool | int | float | str) and default not in ("", float("inf")):
            described["default"] = default
        match declared.role:
            case "parameter":
                return {"type": "number", **described, **_bounds(declared)}
            case "table":
                return {"type": "array", "items": {"type": "number"}, "minItems": declared.shortest, **described}
            case "choice":
                options = [option for option in declared.options if option is not None]
                allowed = {"enum": options} if options else _choice_type(hints(kind)[name])
                return {**allowed, **described, **({} if options else _bounds(declared))}
            case "text" | "file":
                return {**_TEXT, **({"minLength": declared.shortest} if declared.shortest else {}), **described}
            case "named":
                return {**self._under_names(declared, hints(kind)[name]), **described}
            case "numbers":
                self.by_name[_NUMBERS] = {
                    "type": "object",
                    "additionalProperties": {"anyOf": [{"type": "number"}, {"$ref": f"#/$defs/{_NUMBERS}"}]},
                }
                return {"$ref": f"#/$defs/{_NUMBERS}", **described}
            case _:
                hint: Hint = hints(kind)[name]
                inner = self.part(hint)
                return {"type": "array", "items": inner, **described} if hint.many else {**inner, **described}

    def _under_names(self, declared: Declaration, hint: Any) -> Schema:
        """Return the schema of a `named` field: sections or values by name."""
        inner = self.part(hint) if isinstance(hint, Hint) else _choice_type(hint)
        least = {"minProperties": declared.shortest} if declared.shortest else {}
        if declared.options:
            return {
                "type": "object",
                "properties": dict.fromkeys(declared.options, inner),
                "additionalProperties": False,
                **least,
            }
        if declared.pattern:
            patterns = {f"^(?:{declared.pattern})$": inner}
            return {"type": "object", "patternProperties": patterns, "additionalProperties": False, **least}
        return {"type": "object", "additionalProperties": inner, **least}


def _needed(name: str, declared: Declaration) -> Schema:
    """Return a schema that requires a field; the key of a number may carry any unit suffix."""
    if declared.role not in ("parameter", "table"):
        return {"required": [name]}
    # JSON Schema has no `required` for a pattern: not all names fail to match it.
    return {"not": {"propertyNames": {"not": {"pattern": f"^{name}(?:{_SUFFIX})?$"}}}}


def _description(declared: Declaration) -> str:
    unit = "in the unit of what it is about" if declared.unit == VARIED else declared.unit
    return f"{declared.meaning}, {unit}" if unit else declared.meaning


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
    """Return the schema of the type of a choice, such as `int`, `str | None` or `tuple[int, ...]`."""
    options = options_of_type(annotation)
    if len(options) != 1:
        return {"anyOf": [_choice_type(option) for option in options]}
    only: Any = options[0]
    if typing.get_origin(only) is tuple:
        return {"type": "array", "items": _choice_type(typing.get_args(only)[0])}
    return {"type": _JSON_TYPES[only]}


def _number_elsewhere(declared: Declaration) -> Schema:
    """Return the schema of a parameter in another unit; the bounds are checked only when the file is read."""
    described = {"description": f"{declared.meaning}, in the unit that the key names"}
    if declared.role == "table":
        return {"type": "array", "items": {"type": "number"}, "minItems": declared.shortest, **described}
    return {"type": "number", **described}
