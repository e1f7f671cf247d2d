"""A hook of mkdocs: pages that are made from what stands elsewhere, while the site is built.

- one page a block, from its declarations: equations, and parameters with unit, meaning, bounds and default;
- on the pages of Python, the public functions and types of the packages that a comment names, from their docstrings;
- the commands, from their requests;
- the page of the keys of files, from the declarations of their sections, and the JSON Schemas of the files;
- in the index of the search, the words of the trade beside the sections that reference/words.md names for them;
- GLOSSARY, DESIGN, CONTRIBUTING and CHANGELOG of the root, so that they stand once.
"""

from __future__ import annotations

import importlib
import inspect
import json
import posixpath
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from textwrap import indent
from types import GenericAlias, UnionType
from typing import Any

from mkdocs.structure.files import File
from numpy.typing import ArrayLike

import feeddrive
from feeddrive.blocks.catalogue import catalogue
from feeddrive.cli.commands import OFFERED, offered
from feeddrive.files.section import VARIED, Hint, Section, hints
from feeddrive.files.section import members as members_of
from feeddrive.language.block import Block, Declaration, Declared, declarations, defaults
from feeddrive.language.lazy_package import public_names
from feeddrive.workflow.command import Command, Field, fields_of
from feeddrive.workflow.schemas import FILES, outcome_schema, schemas

ROOT = Path(__file__).parent.parent
WHOLE = ("GLOSSARY.md", "DESIGN.md", "CONTRIBUTING.md", "CHANGELOG.md")
PUBLISHED = (".md", ".svg", ".png", ".webp", ".json")  # what a page may link to
BLOCKS = "reference/blocks"
LOOP = ("Loop", "Axis", "Control", "Guard")
WORDS = "reference/words.md"
UNSEARCHED = ("internals/mutants.md", "CHANGELOG.md")  # their thousand rows would stand before the pages of a subject
_LINE = 100


def on_config(config: Any) -> Any:
    """One entry of the navigation for each family of blocks."""
    families = [{"The loop": [place(getattr(feeddrive, name)) for name in LOOP]}]
    families += [{title(family): [place(block) for block in members]} for family, members in families_of_blocks()]
    reference = next(part["Reference"] for part in config.nav if "Reference" in part)
    reference.append({"Blocks": [f"{BLOCKS}/index.md", *families]})
    return config


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages."""
    for name in WHOLE:
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, name, content=re.sub(r"\]\(docs/", "](", text)))
    for block in all_blocks():
        files.append(File.generated(config, place(block), content=page(block)))
    files.append(File.generated(config, f"{BLOCKS}/index.md", content=index_of_blocks()))
    files.append(File.generated(config, "reference/keys.md", content=keys()))
    for name, schema in {**schemas(), "outcome": outcome_schema()}.items():
        place_of = f"reference/schema/{name}.schema.json"
        files.append(File.generated(config, place_of, content=json.dumps(schema, indent=1)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """What comments ask for; links to the files at the root, which are pages of the site, and to the source."""
    name = page.file.src_uri
    if name in UNSEARCHED:
        page.meta["search"] = {"exclude": True}
    folder = ROOT if name in WHOLE else (ROOT / "docs" / name).parent
    markdown = re.sub(r"\[([^\]\n]+)\]\(([\w./-]+)\)", lambda found: _source(found, folder), markdown)
    markdown = re.sub(r"\]\(\.\./((?:\.\./)*[A-Z]+\.md)", r"](\1", markdown)
    markdown = re.sub(r"<!-- names of (.+?) -->", lambda found: names_of(found[1].split(", ")), markdown)
    return markdown.replace("<!-- commands -->", commands()) if "<!-- commands -->" in markdown else markdown


def on_post_build(config: Any) -> None:
    """Gives the words of the trade to the sections of the index that the page of words names for them.

    The search of the theme ranks an entry by its tags before its title and text.
    """
    file = Path(config.site_dir) / "search/search_index.json"
    index = json.loads(file.read_text(encoding="utf-8"))
    entries = {each["location"]: each for each in index["docs"]}
    for location, words in words_by_location().items():
        entries[location].setdefault("tags", []).extend(words)
    file.write_text(json.dumps(index, separators=(",", ":")), encoding="utf-8")


def words_by_location() -> dict[str, list[str]]:
    """The words in the first column of the table of words, by the place in the site to which the last column links."""
    found: dict[str, list[str]] = {}
    for line in (ROOT / "docs" / WORDS).read_text(encoding="utf-8").splitlines():
        link = re.fullmatch(r"\| (.+?) \| .* \| \[.+\]\((\S+?)\) \|", line)
        if link:
            page, _, anchor = link[2].partition("#")
            at = posixpath.normpath(posixpath.join(posixpath.dirname(WORDS), page))
            at = at.removesuffix(".md").removesuffix("index")
            at = at.removeprefix("../") + ("" if at.endswith("/") or not at else "/") + (f"#{anchor}" if anchor else "")
            found.setdefault(at, []).extend(word.strip() for word in link[1].split(","))
    return found


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


def index_of_blocks() -> str:
    """The families and their blocks."""
    lines = [
        "# Blocks",
        "",
        "Everything a loop consists of, by family, with a page for each block: equations, and parameters with unit, "
        "meaning, bounds and default. In Python they are `fd.blocks.NAME`, in files a section with this `kind`.",
        "",
    ]
    for family, blocks in families_of_blocks():
        lines += [f"## {title(family)}", "", "| kind | block |", "|---|---|"]
        for block in blocks:
            lines.append(f"| [`{block.kind}`]({block.kind}.md) | {docstring(block).split(chr(10))[0]} |")
        lines.append("")
    return "\n".join(lines)


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
        "same dimension, which its key then names: `duration_min`. [Blocks](blocks/index.md) are chosen by `kind` and "
        "have pages of their own; [Units and files](files.md) explains the files.",
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


def names_of(packages: Sequence[str]) -> str:
    """The public functions, then the public types, of some packages: signature, docstring, fields and methods."""
    root = public_names("feeddrive")
    public = {
        (name, place)
        for package in ("feeddrive", *packages)
        for name, place in public_names(package).items()
        if place.startswith(tuple(f"{package}." for package in packages))
    }
    lines: list[str] = []
    for name, place in sorted(public, key=lambda named: (named[0][:1].isupper(), *named)):
        thing = getattr(importlib.import_module(place), name)
        written = f"fd.{name}" if root.get(name) == place else f"fd.{place.split('.')[1]}.{name}"
        lines += [f"## {name}", "", code(signature(written, thing)), "", docstring(thing), ""]
        if isinstance(thing, Command):
            lines += [f"Options with units, bounds and defaults: [{named(thing)}](../commands.md#{named(thing)})", ""]
        if inspect.isclass(thing):
            lines += [*members(thing), ""]
    return "\n".join(lines)


def members(kind: type) -> Iterator[str]:
    """The fields of a type with their types and defaults, and its methods."""
    fields = getattr(kind, "__dataclass_fields__", None) or getattr(kind, "_fields", ())
    if fields and issubclass(kind, Declared):
        yield from ["| name | unit | meaning | bounds | default |", "|---|---|---|---|---|"]
        yield from (row(kind, name, declared) for name, declared in declarations(kind).items())
    elif fields:
        annotations = inspect.get_annotations(kind)
        shown = [f"{name}: {typed(annotations[name])}" for name in fields if name in annotations and name[0] != "_"]
        yield code("\n".join(shown))
    yield ""
    for name, method in vars(kind).items():
        if not name.startswith("_") and inspect.isfunction(method) and method.__doc__:
            summary = docstring(method).split("\n\n")[0].replace("\n", " ")
            yield f"- `.{signature(name, method)}`: {summary}"


def code(text: str) -> str:
    """Code as HTML: to color the signatures of all names would take a tenth of the time of the build."""
    return f"<pre><code>{escape(text, quote=False)}</code></pre>" if text else ""


def signature(name: str, thing: Any) -> str:
    """Name, arguments with types and defaults, and the type of the result; a line an argument where they are many."""
    if isinstance(thing, UnionType | GenericAlias) or inspect.isclass(thing):
        return name
    described = inspect.signature(thing)
    words: list[str] = []
    for parameter in described.parameters.values():
        if parameter.name == "self":
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in words and not any(w[0] == "*" for w in words):
            words.append("*")
        star = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
        kind = f": {typed(parameter.annotation)}" if parameter.annotation is not parameter.empty else ""
        value = f" = {literal(parameter.default)}" if parameter.default is not parameter.empty else ""
        words.append(f"{star}{parameter.name}{kind}{value}")
    empty = described.return_annotation is described.empty
    result = "" if empty else f" -> {typed(described.return_annotation)}"
    line = f"{name}({', '.join(words)}){result}"
    return line if len(line) < _LINE else "\n".join([f"{name}(", *(f"    {word}," for word in words), f"){result}"])


def typed(annotation: Any) -> str:
    """An annotation as it is written."""
    if annotation == ArrayLike:
        return "ArrayLike"
    if isinstance(annotation, str) or (inspect.isclass(annotation) and not isinstance(annotation, GenericAlias)):
        return annotation if isinstance(annotation, str) else annotation.__name__
    return re.sub(r"\b(?:\w+\.)+(?=\w)|~", "", str(annotation))


def literal(value: Any) -> str:
    """A default as Python; an object without a short literal as `...`."""
    return repr(value) if value is None or isinstance(value, str | int | float | tuple) else "..."


def named(command: Command[Any, Any, Any]) -> str:
    """The name of a command on the command line."""
    return command.__name__.replace("_", "-")


def commands() -> str:
    """Every command with its arguments and options, from the declarations of its request."""
    lines: list[str] = []
    for group in dict.fromkeys(listed.group for listed in OFFERED.values()):
        lines += [f"## {group}", ""]
        for name, listed in OFFERED.items():
            if listed.group == group:
                lines += [f"### {name}", "", listed.summary, ""]
                lines += ["```sh", *(f"feeddrive {name} {words}".rstrip() for words in listed.examples), "```", ""]
                lines += ["| argument or option | unit | meaning | bounds | default |", "|---|---|---|---|---|"]
                lines += [entry(field) for field in fields_of(offered(name).request)]
                lines.append("")
    return "\n".join(lines)


def entry(field: Field) -> str:
    """One argument or option in the table of its command."""
    declared = field.declared
    flag = f"`{field.flag}`" if field.flag else f"`{field.name.upper()}`"
    flag += f", `{field.short}`" if field.short else ""
    flag += " (several)" if field.many else ""
    allowed = ", ".join(f"`{option}`" for option in declared.options) or declared.bounds()
    value = "required" if field.required else "absent" if field.default in (None, (), False) else ""
    value = value or f"`{field.shown(field.default)}`"
    unit = declared.unit or ("1" if field.kind is float else "")
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in (flag, unit, declared.meaning, allowed, value)) + " |"
