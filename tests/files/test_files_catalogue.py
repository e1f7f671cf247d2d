"""The catalogue: one concrete block a file, named as the file; found by family and kind."""

from __future__ import annotations

import pytest

from feeddrive.blocks.catalogue import blocks_of, catalogue, find, modules
from feeddrive.blocks.families import Friction, Plant
from feeddrive.blocks.friction.stribeck import Stribeck
from feeddrive.language.errors import ParameterError


def test_families_hold_their_members_by_kind() -> None:
    assert catalogue()[Friction]["stribeck"] is Stribeck
    for family, members in catalogue().items():
        for kind, block in members.items():
            assert issubclass(block, family)
            assert block.kind == kind


def test_no_two_blocks_of_a_family_share_a_kind() -> None:
    found = sum(len(members) for members in catalogue().values())
    assert found == sum(len(blocks_of(module)) for module in modules())


def test_find_names_what_is_near() -> None:
    assert find(Friction, "stribeck") is Stribeck
    with pytest.raises(ParameterError, match=r"no friction of kind 'stribek'; did you mean stribeck\?"):
        find(Friction, "stribek")
    with pytest.raises(ParameterError, match=r"no plant of kind 'xyz'; there are: .*rigid"):
        find(Plant, "xyz")


def test_the_catalogue_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        catalogue()[Plant] = {}  # type: ignore[index]
