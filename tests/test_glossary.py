"""GLOSSARY.md against the code: every name is there, with the unit that the code declares."""

from __future__ import annotations

import importlib
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import feeddrive.blocks
import feeddrive.loop
from feeddrive.blocks.catalogue import members
from feeddrive.blocks.families import Law
from feeddrive.language.block import Block, Declaration, declarations
from feeddrive.language.units import factor, measure
from feeddrive.loop.linearize import INPUT_UNITS
from feeddrive.loop.loop import UNITS

PAGE = Path(__file__).parent.parent / "GLOSSARY.md"
SECTION_OF_SIGNALS, SECTION_OF_PARTS, SECTION_OF_OBJECTS = "Signals", "Parts", "Objects"


def rows(section: str) -> Iterator[tuple[list[str], list[str]]]:
    """Names (in backticks) and cells of each row of a section's tables."""
    text = PAGE.read_text(encoding="utf-8")
    found = re.search(rf"^## {re.escape(section)}\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    assert found, section
    for line in found[1].splitlines():
        if line.startswith("| `"):
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            yield re.findall(r"`([^`]+)`", cells[0]), cells


def sections() -> list[str]:
    return re.findall(r"^## (.+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


def named(section: str) -> dict[str, set[str]]:
    """Name -> units in one section; names of choices have none."""
    found: dict[str, set[str]] = {}
    for names, cells in rows(section):
        units = set(re.findall(r"`([^`]+)`", cells[2])) if len(cells) > 2 else set()
        for name in names:
            found.setdefault(name, set()).update("" if unit == "1" else unit for unit in units)
    return found


OTHER = ("Suffixes", "Signs", SECTION_OF_SIGNALS, SECTION_OF_PARTS, SECTION_OF_OBJECTS)


def parameters() -> dict[str, set[str]]:
    """Name -> units over all sections of parameters."""
    found: dict[str, set[str]] = {}
    for section in sections():
        if section not in OTHER and not section.startswith(("Kv,", "Quantities")):
            for name, units in named(section).items():
                found.setdefault(name, set()).update(units)
    return found


def declared() -> list[tuple[str, str, Declaration]]:
    """Block, field and declaration of every block: they stand in the floors `blocks` and `loop`."""
    for floor in (feeddrive.blocks, feeddrive.loop):
        for module in pkgutil.walk_packages(floor.__path__, f"{floor.__name__}."):
            importlib.import_module(module.name)
    found = []

    def walk(family: type[Block]) -> None:
        for block in family.__subclasses__():
            if block.__module__.startswith(("feeddrive.blocks.", "feeddrive.loop.")):  # not what a drive file declares
                found.extend((block.__name__, name, each) for name, each in declarations(block).items())
            walk(block)

    walk(Block)
    return found


FIELDS = declared()
LAWS = {law.__name__ for law in members(Law).values()}  # type: ignore[type-abstract]


def of_one_law(block: str, name: str) -> bool:
    """A name that one law alone has: its declaration, which is on the page of the law, is its entry."""
    return block in LAWS and {other for other, field, _ in FIELDS if field == name} == {block}


def test_every_field_is_in_the_glossary_with_its_unit():
    parts, known = named(SECTION_OF_PARTS), parameters()
    missing = list[str]()
    for block, name, field in FIELDS:
        if field.role == "part":
            if name not in parts:
                missing.append(f"{block}.{name} ({field.meaning}) is missing under Parts")
        elif name not in known:
            if not of_one_law(block, name):
                missing.append(f"{block}.{name} ({field.meaning}, in {field.unit or '1'}) is missing")
        elif field.role in ("parameter", "table") and field.unit not in known[name]:
            missing.append(f"{block}.{name} is declared in '{field.unit or '1'}', not in {known[name]}")
    assert len(FIELDS) > 500
    assert not missing


def test_the_glossary_has_no_unit_that_nobody_declares():
    used: dict[str, set[str]] = {}
    for _, name, each in FIELDS:
        if each.role in ("parameter", "table"):
            used.setdefault(name, set()).add(each.unit)
    for name, units in parameters().items():
        if units:
            assert units <= used.get(name, set()), f"{name}: {units - used.get(name, set())} is declared by no block"


def test_every_name_of_the_glossary_is_in_the_code():
    names = {name for _, name, _ in FIELDS}
    assert not set(parameters()) - names
    assert not set(named(SECTION_OF_PARTS)) - names


def test_every_object_of_the_glossary_is_a_class():
    source = Path(feeddrive.blocks.__path__[0]).parent
    classes = {
        name for path in source.rglob("*.py") for name in re.findall(r"(?m)^class (\w+)", path.read_text("utf-8"))
    }
    objects = {names[0] for names, _ in rows(SECTION_OF_OBJECTS)}
    assert len(objects) > 10
    assert objects <= classes


def test_every_signal_is_in_the_glossary_with_its_unit():
    known = named(SECTION_OF_SIGNALS)
    signals = {"enable": "", **INPUT_UNITS, **UNITS}
    assert {name: known.get(name) for name in signals} == {name: {unit} for name, unit in signals.items()}


def test_every_unit_is_one_that_the_reader_of_files_knows():
    for name, units in parameters().items():
        for unit in units:
            assert measure(unit)[0] > 0.0, name


def test_the_factors_of_kv():
    factors = {unit: float(found.split("=")[-1]) for unit, _, found in tail("Kv, one gain and four units")}
    assert factors["m/(min mm)"] == pytest.approx(factor("m_per_min_per_mm", "1/s"), rel=1e-4)  # shown to 5 digits
    assert factors["1000/min"] == pytest.approx(1000 * factor("1_per_min", "1/s"), rel=1e-4)
    assert factors["0.01/s"] == 0.01


def tail(section: str) -> Iterator[list[str]]:
    """The cells of a table without backticks."""
    text = PAGE.read_text(encoding="utf-8").split(f"## {section}\n")[1].split("\n## ")[0]
    for line in text.splitlines():
        if line.startswith("| ") and not line.startswith("| unit"):
            yield [cell.strip() for cell in line.split("|")[1:-1]]
