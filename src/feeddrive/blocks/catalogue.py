"""The catalogue of all concrete blocks, found by walking the packages under `feeddrive.blocks`.

A block belongs to the family that `families.py` declares for it.  A concrete block without a family, such as the
actuator, is its own family.
"""

from __future__ import annotations

import importlib
import inspect
import os
import sys
from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from functools import cache
from types import MappingProxyType
from typing import TypeVar

from feeddrive.language.block import Block
from feeddrive.language.errors import ParameterError
from feeddrive.language.lazy_package import modules_below

B = TypeVar("B", bound=Block)

# old names of kinds and their new names; until 1.0 errors name the new one
RENAMED = MappingProxyType({"shaped": "input_shaped"})


@cache
def catalogue() -> Mapping[type[Block], Mapping[str, type[Block]]]:
    """Family -> kind -> class, in the order of the folders; the first call imports every block."""
    found: dict[type[Block], dict[str, type[Block]]] = {}
    for module in modules():
        for block in blocks_of(module):
            found.setdefault(family_of(block), {})[block.kind] = block
    return MappingProxyType({family: MappingProxyType(members) for family, members in found.items()})


def members(family: type[B]) -> Mapping[str, type[B]]:
    """The blocks of one family by kind."""
    return catalogue().get(family, {})  # type: ignore[return-value]


def modules() -> Iterator[str]:
    """Dotted names of the modules that hold blocks: those one folder down."""
    return modules_below("feeddrive.blocks")


def blocks_of(module: str) -> list[type[Block]]:
    """The concrete blocks defined in a module; imported ones do not count."""
    found = vars(importlib.import_module(module)).values()
    return [
        member
        for member in found
        if isinstance(member, type)
        and issubclass(member, Block)
        and member.__module__ == module
        and not inspect.isabstract(member)
    ]


def imported(family: type[B], place: str) -> type[B]:
    """The block that a person names by PACKAGE.MODULE:CLASS; its module is imported, and so its code is run.

    Modules are looked for where Python does, and then in the working directory.  For what stands on a command line,
    never for what is only read in a file.
    Raises ParameterError if there is no such module or class, or if it is no concrete block of the family.
    """
    module, _, name = place.partition(":")
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)
    try:
        found = getattr(importlib.import_module(module), name, None)
    except ImportError as error:
        raise ParameterError(
            f"'{place}': the module cannot be imported ({error}): check its name and where it is"
        ) from None
    if not isinstance(found, type):
        raise ParameterError(f"'{place}': there is no class '{name}' in {module}")
    if not issubclass(found, family) or inspect.isabstract(found):
        missing = ", ".join(sorted(getattr(found, "__abstractmethods__", ())))
        why = f"it lacks {missing}" if issubclass(found, family) else f"it must derive from {family.__name__}"
        raise ParameterError(f"'{place}' is no {family.kind.replace('_', ' ')}: {why}")
    return found


def family_of(block: type[Block]) -> type[Block]:
    """The abstract class directly under Block from which the block derives, or the block itself."""
    return next(base for base in reversed(block.__mro__) if issubclass(base, Block) and base is not Block)


def find(family: type[B], kind: str) -> type[B]:
    """The block of a family with a name such as `two_mass`. Raises ParameterError, with similar names."""
    known = members(family)
    if kind in known:
        return known[kind]
    near = [RENAMED[kind]] if RENAMED.get(kind) in known else get_close_matches(kind, known, 3)
    hint = f"did you mean {' or '.join(near)}?" if near else f"there are: {', '.join(known) or 'none'}"
    raise ParameterError(f"there is no {family.kind.replace('_', ' ')} of kind '{kind}'; {hint}")
