"""Declarations: what a block checks when it is made, and what it refuses to be."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feeddrive.language.block import Block, Number, choice, declarations, parameter, part, snake_case, table
from feeddrive.language.errors import FeeddriveError, ParameterError, StructureError


class Sample(Block):
    """One field of each role."""

    mass: Number = parameter("kg", "moved mass", above=0, most=5)
    extra: Number = parameter("N", "an optional force", default=None, least=0)
    count: int = choice("how many", default=1, least=1)
    side: str = choice("which side", options=("motor", "load"), default="motor")
    row: np.ndarray = table("N", "a row", default=None)
    inner: Block | None = part("a part", default=None)


def test_a_block_is_frozen_and_keyword_only():
    made = Sample(mass=1)
    assert made.mass == 1.0
    assert isinstance(made.mass, float)
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.mass = 2.0  # type: ignore[misc]
    with pytest.raises(ParameterError, match="by name"):
        Sample(1.0)  # type: ignore[misc]


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"mass": 0}, r"sample\.mass = 0 kg \(moved mass\) must be > 0 kg and <= 5 kg"),
        ({"mass": 5.01}, r"must be > 0 kg and <= 5 kg"),
        ({"mass": float("inf")}, "finite"),
        ({"mass": float("nan")}, "finite"),
        ({"mass": "1"}, "must be a number, not '1'"),
        ({"mass": True}, "must be a number"),
        ({"mass": 1j}, "must be a number"),
        ({"mass": np.array(["a"])}, "must be numbers"),
        ({"mass": np.array([1.0, -1.0])}, "must be > 0"),
        ({"mass": 1, "extra": -1.0}, ">= 0 N"),
        ({"mass": 1, "count": 0}, ">= 1"),
        ({"mass": 1, "count": 1.5}, "whole number"),
        ({"mass": 1, "count": True}, "whole number"),
        ({"mass": 1, "side": "left"}, "must be one of 'motor', 'load'"),
        ({"mass": 1, "row": [1.0]}, "at least two numbers"),
        ({"mass": 1, "row": [[1.0, 2.0]]}, "row of at least two numbers"),
        ({"mass": 1, "row": [1.0, float("nan")]}, "not finite"),
        ({"mass": 1, "inner": 3}, "must be a block"),
    ],
)
def test_what_is_refused_and_in_which_words(fields: dict[str, object], words: str):
    with pytest.raises(ParameterError, match=words):
        Sample(**fields)  # type: ignore[arg-type]


def test_a_missing_parameter_is_named_with_its_meaning():
    with pytest.raises(ParameterError, match=r"Sample needs mass \(moved mass\)"):
        Sample()  # type: ignore[call-arg]


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_a_number_is_kept_or_refused_as_the_declaration_says(value: float):
    admitted = declarations(Sample)["mass"].admits(value) and np.isfinite(value)
    try:
        made = Sample(mass=value)
    except ParameterError:
        assert not admitted
    else:
        assert admitted
        assert made.mass == value


def test_a_table_cannot_be_changed_afterwards():
    given_row = np.array([1.0, 2.0])
    made = Sample(mass=1, row=given_row)
    given_row[0] = 9.0
    assert made.row[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        made.row[0] = 3.0


def test_every_field_must_be_declared():
    with pytest.raises(StructureError, match="must be declared"):

        class Undeclared(Block):
            """Misses its declaration."""

            mass: float = 1.0


def test_all_errors_of_users_have_one_base():
    assert issubclass(ParameterError, FeeddriveError)
    assert issubclass(StructureError, FeeddriveError)


@pytest.mark.parametrize(
    ("name", "kind"), [("CascadePPI", "cascade_ppi"), ("TwoMass", "two_mass"), ("ZV", "zv"), ("LowPass2", "low_pass2")]
)
def test_names_of_files(name: str, kind: str):
    assert snake_case(name) == kind
