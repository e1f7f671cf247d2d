"""The JSON Schema of machine and job files agrees with the reader: what is read is admitted."""

from __future__ import annotations

import json
import random
import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from feeddrive.blocks.catalogue import catalogue
from feeddrive.blocks.families import Load, Reference
from feeddrive.files import job, machine
from feeddrive.files.to_toml import to_toml
from feeddrive.files.job import read_job
from feeddrive.files.machine import read_machine
from feeddrive.files.schema import _SUFFIX, job_schema, machine_schema, write_schemas
from feeddrive.language.declaration import declarations
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.units import _BASE, _OTHER, _PREFIX
from feeddrive.testing.strategies import blocks_of
from fresh_draws import Seeded
from slow_share import all_but

MACHINE = Draft202012Validator(machine_schema())
JOB = Draft202012Validator(job_schema())
MACHINES = sorted((machine.BUNDLED / "machines").glob("*.toml"))
JOBS = sorted((machine.BUNDLED / "jobs").glob("*.toml"))
THREE_AXES = ("mill", "machining_center", "circle_diamond_square", "circle", "slot")


MOVE = '[reference]\nkind = "snap_limited_move"\n' + "".join(
    f"{name} = 1\n" for name in ("distance", "velocity", "acceleration", "jerk", "snap")
)


def problems(validator: Any, text: str) -> list[str]:
    return [
        f"{'.'.join(map(str, error.path))}: {error.message[:200]}"
        for error in validator.iter_errors(tomllib.loads(text))
    ]


def test_the_schemas_are_schemas() -> None:
    for schema in (machine_schema(), job_schema()):
        Draft202012Validator.check_schema(schema)
        text = json.dumps(schema)
        names = set(schema["$defs"])
        assert {each.split('"')[0] for each in text.split("#/$defs/")[1:]} == names


@pytest.mark.parametrize("path", [*MACHINES, *JOBS], ids=lambda path: f"{path.parent.name}.{path.stem}")
def test_bundled_files_are_valid(path: Path) -> None:
    assert problems(MACHINE if path in MACHINES else JOB, path.read_text(encoding="utf-8")) == []


def test_every_block_is_in_a_schema() -> None:
    found = {**machine_schema()["$defs"], **job_schema()["$defs"]}
    names = {name.split(".")[1] for name in found if not name.startswith("any.")}
    for family, members in catalogue().items():
        # an observer is a part of laws that take one; couplings are given in Python, machine files have none yet
        if family.__name__ in ("Observer", "Coupling"):
            continue
        for kind, block in members.items():
            assert kind in names or family is block, f"{family.kind}.{kind}"


@pytest.mark.parametrize("family", [Reference, Load])
@settings(max_examples=5, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_every_reference_and_load_is_valid_in_a_job(family: type, data: st.DataObject) -> None:
    for kind in catalogue()[family].values():
        text = 'machine = "emps"\n' + to_toml(data.draw(blocks_of(kind)), family.kind)
        assert problems(JOB, text if family is Reference else text + MOVE) == []


def test_units_of_the_language_are_units_of_the_schema() -> None:
    words = [*_OTHER, *_BASE, *(prefix + word for prefix in _PREFIX for word in _BASE), "per", "kg2", "N_per_um"]
    for word in words:
        assert re.fullmatch(_SUFFIX, f"_{word}"), word
    for word in ("load", "motor", "viscous", "x", "N_per_"):
        assert not re.fullmatch(_SUFFIX, f"_{word}"), word


def test_keys_are_those_of_the_readers() -> None:
    assert set(job_schema()["properties"]) == set(job.KEYS)
    properties = machine_schema()["properties"]
    assert set(properties) == {"kind", "axis", "couplings", "geometry", "sample_time", *machine._TEXTS}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("mass_load", "mass_lod"),
        ("mass_load_kg = 33", "mass_load_kg = '33'"),
        ("mass_load_kg = 33", "mass_load = 0"),
        ("mass_load_kg = 33", ""),
        ('kind = "stribeck"', 'kind = "strib"'),
        ('kind = "three_mass_chain"', ""),
        ("sample_time_us = 50", ""),
        ("[[axis.x.control.filters]]", "[axis.x.control.filter]"),
        ("velocity_limit = 3.2", "velocity_limits = 3.2"),
        ("[axis.x.control.law]", "[axis.x.law]"),
    ],
)
def test_what_the_reader_refuses_the_schema_refuses(tmp_path: Path, old: str, new: str) -> None:
    text = (machine.BUNDLED / "machines" / "ball_screw.toml").read_text(encoding="utf-8")
    assert old in text
    text = text.replace(old, new, 1)
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    with pytest.raises(FeeddriveError):
        read_machine(tmp_path / "m.toml")
    assert problems(MACHINE, text) != []


VALUES = [1, -1, 0, 1.5, True, "a", [], [1.0, 2.0], {}, [{}], {"kind": "rigid"}, 1e9, "motor", 3]


def tables(value: Any) -> list[Any]:
    """Every table in a document."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else []
    return [*([value] if isinstance(value, dict) else []), *(table for each in inner for table in tables(each))]


def as_toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {as_toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    return json.dumps(value)


@pytest.mark.parametrize(
    "path",
    all_but(
        [path for path in (*MACHINES, *JOBS) if path.stem not in THREE_AXES],
        [*MACHINES, *JOBS],
        "three axes, 5 s, and the plan of a program for each; all others are read quickly",
    ),
    ids=lambda path: f"{path.parent.name}.{path.stem}",
)
def test_what_the_reader_reads_the_schema_admits(tmp_path: Path, path: Path, seeded: Seeded) -> None:
    """Random changes of keys and values: the schema must never refuse what is read."""
    draw = random.Random(seeded(path.stem))
    blocks = [block for members in catalogue().values() for block in members.values()]
    text = path.read_text(encoding="utf-8")
    admitted = refused = 0
    for _ in range({"mill": 150, "circle_diamond_square": 12, "circle": 12, "slot": 12}.get(path.stem, 60)):
        content = tomllib.loads(text)
        table = draw.choice(tables(content))
        if draw.random() < 0.4 and table:
            del table[draw.choice(list(table))]
        if draw.random() < 0.8:
            names = [*table, *declarations(draw.choice(blocks)), "kind"]
            table[draw.choice(names) + draw.choice(["", "", "_mm", "_N_per_um"])] = draw.choice(VALUES)
        changed = "\n".join(f"{json.dumps(key)} = {as_toml(value)}" for key, value in content.items())
        (tmp_path / path.name).write_text(changed, encoding="utf-8")
        try:
            with np.errstate(all="ignore"):
                (read_machine if path in MACHINES else read_job)(tmp_path / path.name)
        except FeeddriveError:
            refused += 1
            continue
        admitted += 1
        assert problems(MACHINE if path in MACHINES else JOB, changed) == [], changed
    assert min(admitted, refused) > 3


def test_schemas_are_written(tmp_path: Path) -> None:
    found = write_schemas(tmp_path)
    assert [path.name for path in found] == ["machine.schema.json", "job.schema.json"]
    assert json.loads(found[0].read_text(encoding="utf-8")) == machine_schema()
