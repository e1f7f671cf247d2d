"""A hook of mkdocs: pages that are made from what stands elsewhere, while the site is built.

- one page a block, from its declarations: equations, and parameters with unit, meaning, bounds and default;
- the page of the public functions and results, from their docstrings;
- the page of the keys of files, from the declarations of their sections, and the JSON Schemas of the files;
- GLOSSARY, DESIGN, CONTRIBUTING and CHANGELOG of the root, so that they stand once.
"""

from __future__ import annotations

import importlib
import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from textwrap import indent
from types import GenericAlias, UnionType
from typing import Any

from mkdocs.structure.files import File

import feeddrive
from feeddrive.blocks.catalogue import catalogue
from feeddrive.files.section import VARIED, Hint, Section, hints
from feeddrive.files.section import members as members_of
from feeddrive.language.block import Block, Declaration, Declared, declarations, defaults
from feeddrive.language.lazy_package import public_names
from feeddrive.workflow.schemas import FILES, schemas

ROOT = Path(__file__).parent.parent
WHOLE = ("GLOSSARY.md", "DESIGN.md", "CONTRIBUTING.md", "CHANGELOG.md")
PUBLISHED = (".md", ".svg", ".png", ".json")  # what a page may link to
BLOCKS = "reference/blocks"
LOOP = ("Loop", "Axis", "Control", "Guard")


def on_config(config: Any) -> Any:
    """One entry of the navigation for each family of blocks."""
    families = [{"The loop": [place(getattr(feeddrive, name)) for name in LOOP]}]
    families += [{title(family): [place(block) for block in members]} for family, members in families_of_blocks()]
    reference = next(part["Reference"] for part in config.nav if "Reference" in part)
    reference.append({"Blocks": families})
    return config


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages."""
    for name in WHOLE:
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, name, content=re.sub(r"\]\(docs/", "](", text)))
    for block in all_blocks():
        files.append(File.generated(config, place(block), content=page(block)))
    files.append(File.generated(config, "reference/python.md", content=python()))
    files.append(File.generated(config, "reference/keys.md", content=keys()))
    for name, schema in schemas().items():
        place_of = f"reference/schema/{name}.schema.json"
        files.append(File.generated(config, place_of, content=json.dumps(schema, indent=1)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links from docs/ to the files at the root, which are pages beside it in the site, and to files that are none."""
    name = page.file.src_uri
    folder = ROOT if name in WHOLE else (ROOT / "docs" / name).parent
    markdown = re.sub(r"\[([^\]\n]+)\]\(([\w./-]+)\)", lambda found: _source(found, folder), markdown)
    return re.sub(r"\]\(\.\./((?:\.\./)*[A-Z]+\.md)", r"](\1", markdown)


def _source(link: re.Match[str], folder: Path) -> str:
    """A link to a file of the source, which the site does not have, as its path in the source."""
    text, target = link.groups()
    file = (folder / target).resolve()
    if file.suffix in PUBLISHED or not file.is_file():
        return link[0]
    path = f"`{file.relative_to(ROOT).as_posix()}`"
    return path if text.strip("`") == file.name else f"{text} ({path})"


def families_of_blocks() -> Iterator[tuple[type[Block], list[type[Block]]]]:
    """Families and their members; blocks that are their own family, such as parts of others, come last in one."""
    lone = []
    for family, members in catalogue().items():
        if family in members.values():
            lone += members.values()
        else:
            yield family, list(members.values())
    if lone:
        yield Block, lone


def all_blocks() -> list[type[Block]]:
    """Every block that has a page."""
    return [getattr(feeddrive, name) for name in LOOP] + [b for _, members in families_of_blocks() for b in members]


def title(family: type[Block]) -> str:
    """The name of a family over its list."""
    return "Parts" if family is Block else family.kind.replace("_", " ").capitalize()


def place(block: type[Block]) -> str:
    """Where a block's page stands."""
    return f"{BLOCKS}/{block.kind}.md"


def docstring(thing: Any) -> str:
    """A docstring as markdown: indented equations are code there too; a list of aligned names becomes it."""
    if isinstance(thing, GenericAlias):  # names of types have no words of their own
        return f"A `{thing}`."
    if isinstance(thing, UnionType):
        return f"One of {', '.join(f'`{each.__name__}`' for each in thing.__args__)}."
    paragraphs = inspect.cleandoc(thing.__doc__ or "").split("\n\n")
    return "\n\n".join(indent(each, "    ") if re.match(r"\w+ {2,}\S", each) else each for each in paragraphs)


def page(block: type[Block]) -> str:
    """One block."""
    lines = [f"# {block.__name__}", "", f'`kind = "{block.kind}"`', "", docstring(block), ""]
    declared = declarations(block)
    if declared:
        lines += ["| name | unit | meaning | bounds | default |", "|---|---|---|---|---|"]
        lines += [row(block, name, each) for name, each in declared.items()]
    source = f"{block.__module__.replace('.', '/')}.py"
    return "\n".join([*lines, "", f"Source: `src/{source}`", ""])


def row(kind: type[Declared], name: str, declared: Declaration) -> str:
    """One field in the table."""
    unit = declared.unit or "1" if declared.role in ("parameter", "table") else ""
    if declared.unit == VARIED:
        unit, declared = "of what varies", replace(declared, unit="")
    allowed = ", ".join(f"`{option}`" for option in declared.options) or declared.bounds()
    role = "" if declared.role == "parameter" else f" ({declared.role})"
    cells = (f"`{name}`{role}", unit, declared.meaning, allowed, default(kind, name))
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def default(kind: type[Declared], name: str) -> str:
    """A default in words."""
    if name not in defaults(kind):
        return "required"
    value = defaults(kind)[name]
    if value is None or value in ((), {}, ""):
        return "absent"
    return f"`{value.kind}`" if isinstance(value, Block) else f"`{value}`"


def keys() -> str:
    """The keys of all files."""
    lines = [
        "# Keys of files",
        "",
        "Every key, its unit, meaning and bounds, as the files are read. A number may be given in another unit of the "
        "same dimension, which its key then names: `duration_min`. [Blocks](../index.md) are chosen by `kind` and have "
        "pages of their own; [Units and files](files.md) explains the files.",
        "",
    ]
    for name, section in FILES.items():
        lines += [f"## {name.capitalize()} file", "", *keys_of(section, "", set())]
    return "\n".join(lines)


def keys_of(section: type[Section], key: str, shown: set[type[Section]], *, many: bool = False) -> Iterator[str]:
    """The keys of a section and of those in it, each of which is shown once in a file."""
    shown.add(section)
    if key:
        yield from [f"### `[[{key}]]`" if many else f"### `[{key}]`", ""]
    yield from [docstring(section), "", "| key | unit | meaning | bounds | default |", "|---|---|---|---|---|"]
    if section.needs_kind:
        yield f'| `kind` |  | `"{section.kind}"` |  | required |'
    below: list[tuple[type[Section], str, bool]] = []
    for name, declared in declarations(section).items():
        hint = hints(section).get(name)
        if declared.inline:
            kind = hint.classes[0]
            link = (
                f"[{kind.__name__}]({place(kind).removeprefix('reference/')})"
                if issubclass(kind, Block)
                else kind.__name__
            )
            yield f"| those of {link} |  | {declared.meaning} |  |  |"
        else:
            yield row(section, name, declared)
        inner = key if declared.inline else ".".join(filter(None, (key, name)))
        inner += ".NAME" if declared.role == "named" else ""
        held = members_of(hint).values() if isinstance(hint, Hint) else ()
        below += [(member, inner, hint.many) for member in held if issubclass(member, Section)]
    yield ""
    for member, inner, is_list in below:
        if member not in shown:
            yield from keys_of(member, inner, shown, many=is_list)


def python() -> str:
    """The public functions and results."""
    lines = [
        "# Python",
        "",
        "Names of `feeddrive` and of its rooms; [blocks](../index.md) are in `fd.blocks`.",
        "",
    ]
    places = {"feeddrive": public_names("feeddrive")}
    rooms = [name for name, module in places["feeddrive"].items() if module == "feeddrive"]
    places |= {f"feeddrive.{room}": public_names(f"feeddrive.{room}") for room in rooms if room != "blocks"}
    public = {
        name: package for package, names in reversed(places.items()) for name in names if name not in {*LOOP, *rooms}
    }
    public.pop("__version__")
    for name in sorted(public, key=lambda name: (name[:1].isupper(), name)):
        thing = getattr(importlib.import_module(public[name]), name)
        written = f"fd.{name}" if public[name] == "feeddrive" else f"fd.{public[name].partition('.')[2]}.{name}"
        lines += [f"## {name}", "", f"`{signature(written, thing)}`", "", docstring(thing), ""]
        if inspect.isclass(thing):
            for member, method in vars(thing).items():
                if not member.startswith("_") and getattr(method, "__doc__", None) and inspect.isfunction(method):
                    summary = docstring(method).split("\n\n")[0].replace("\n", " ")
                    lines.append(f"- `.{signature(member, method)}`: {summary}")
            lines.append("")
    return "\n".join(lines)


def signature(name: str, thing: Any) -> str:
    """Name and arguments without types."""
    if isinstance(thing, UnionType | GenericAlias) or inspect.isclass(thing):
        return name
    return f"{name}({', '.join(p for p in inspect.signature(thing).parameters if p != 'self')})"
