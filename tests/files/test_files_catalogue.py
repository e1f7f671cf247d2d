"""The catalogue: one concrete block a file, named as the file; found by family and kind."""

from __future__ import annotations

import subprocess
import sys

import pytest

from feeddrive.blocks.catalogue import blocks_of, catalogue, find, member, modules
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


def test_a_member_is_that_of_the_catalogue_and_only_its_file_is_imported() -> None:
    """For each family and kind, and none for a kind of another family; in a process of its own for the imports."""
    kinds = {kind for members in catalogue().values() for kind in members}
    for family, members in catalogue().items():
        assert {kind: block for kind in kinds if (block := member(family, kind)) is not None} == members
    code = (
        "import sys\nfrom feeddrive.blocks.catalogue import member\nfrom feeddrive.blocks.families import Friction\n"
        "print(member(Friction, 'stribeck').kind)\n"
        "print('feeddrive.blocks.friction.stribeck' in sys.modules, 'feeddrive.blocks.friction.lugre' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["stribeck", "True", "False"]


def test_the_catalogue_cannot_be_changed() -> None:
    with pytest.raises(TypeError):
        catalogue()[Plant] = {}  # type: ignore[index]
