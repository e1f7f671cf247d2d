"""The catalogue of all concrete blocks, shipped and user-defined.

Shipped blocks are found in the packages under `feeddrive.blocks`. User-defined ones are loaded from installed packages
with an entry point of the group `feeddrive.blocks`, and from the places named in the environment variable
FEEDDRIVE_BLOCKS or by --blocks on the command line.  A place is a file, PACKAGE.MODULE or PACKAGE.MODULE:CLASS. Nothing
else is imported; a machine file never causes an import.

A block belongs to the family that `families.py` declares for it. A concrete block without a family, such as the
actuator, is its own family.
"""

import importlib
import inspect
import os
import sys
from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from importlib.machinery import PathFinder
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any, TypeVar

from feeddrive.language.block import Block
from feeddrive.language.errors import FeeddriveError, ParameterError, StructureError
from feeddrive.language.lazy_package import modules_below

B = TypeVar("B", bound=Block)

# old and new names of kinds; until 1.0 error messages give the new one
RENAMED = MappingProxyType({"shaped": "input_shaped"})
ENTRY_POINTS = "feeddrive.blocks"  # entry-point group of packages with blocks
VARIABLE = "FEEDDRIVE_BLOCKS"  # environment variable: files and modules with blocks, separated by commas
OPT_IN = f"a block of your own is found by --blocks FILE.py, by {VARIABLE}, or once its package is installed"


@cache
def shipped() -> Mapping[type[Block], Mapping[str, type[Block]]]:
    """Return the shipped block classes by family and kind; the first call imports every block."""
    families: dict[type[Block], dict[str, type[Block]]] = {}
    for module in modules():
        for block in blocks_of(module):
            families.setdefault(family_of(block), {})[block.kind] = block
    return MappingProxyType({family: MappingProxyType(members) for family, members in families.items()})


def catalogue() -> Mapping[type[Block], Mapping[str, type[Block]]]:
    """Return all block classes by family and kind: shipped, from installed packages, and from FEEDDRIVE_BLOCKS.

    Raises ParameterError if a place cannot be imported or defines no block, and StructureError if two blocks of a
    family have the same kind.
    """
    # cached by the value of the variable, which `with_blocks` changes within a process
    return _with_user_blocks(os.environ.get(VARIABLE, ""))


@cache
def _with_user_blocks(places: str) -> Mapping[type[Block], Mapping[str, type[Block]]]:
    families = {family: dict(members) for family, members in shipped().items()}
    for origin, block in (*_installed(), *_of_places(places)):
        members = families.setdefault(family_of(block), {})
        other = members.setdefault(block.kind, block)
        if other is not block:
            raise StructureError(
                f"{origin}: the kind '{block.kind}' is that of {other.__module__}:{other.__qualname__} already: give "
                f"the class {block.__qualname__} another name"
            )
    return MappingProxyType({family: MappingProxyType(members) for family, members in families.items()})


@cache
def installed_points(group: str) -> tuple[Any, ...]:
    """Return the entry points of a group in the installed packages."""
    if not _is_named(group):
        return ()
    from importlib.metadata import entry_points  # imported only when a package has some

    # sorted: which of two packages with the same name is refused must not depend on the order of installation
    return tuple(sorted(entry_points(group=group), key=lambda point: (point.name, point.value)))


def _is_named(group: str) -> bool:
    """Return False if no installed package names a group of entry points, without the import of importlib.metadata."""
    # other finders may know packages that are no folders
    if any(hasattr(finder, "find_distributions") for finder in sys.meta_path if finder is not PathFinder):
        return True
    for place in map(os.path.abspath, sys.path):
        # Python names its own library as an archive, whether it is there or not
        if os.path.isfile(place) or place.endswith(".egg"):
            return True
        for folder in os.listdir(place) if os.path.isdir(place) else ():
            if folder.endswith((".dist-info", ".egg-info")):
                with suppress(OSError), open(f"{place}/{folder}/entry_points.txt", "rb") as file:
                    if group.encode() in file.read():
                        return True
            elif folder.endswith(".egg"):
                return True
    return False


def _installed() -> Iterator[tuple[str, type[Block]]]:
    """Yield (origin, block) for every block of the installed packages."""
    for point in installed_points(ENTRY_POINTS):
        package = point.dist.name if point.dist is not None else point.name
        for block in _held(f"the installed package '{package}' (mend or uninstall it)", point.value):
            yield f"the installed package '{package}'", block


def _of_places(places: str) -> Iterator[tuple[str, type[Block]]]:
    for place in filter(None, map(str.strip, places.split(","))):
        for block in _held(f"{VARIABLE} or --blocks names '{place}'", place):
            yield f"'{place}'", block


def _held(origin: str, place: str) -> list[type[Block]]:
    """Return the concrete blocks at a place: all blocks of a module and its submodules, or a single class."""
    try:
        module, name = module_at(place)
        blocks = [getattr(module, name)] if name else _defined_blocks(module)
    except FeeddriveError as error:
        raise type(error)(f"{origin}: {error}") from None
    # the import runs foreign code, which may raise anything: the message must name its source
    except Exception as error:
        line = error.lineno if isinstance(error, SyntaxError) else _line_in(error)
        at = f", line {line}" if line else ""
        raise ParameterError(f"{origin}: it cannot be imported: {type(error).__name__}: {error}{at}") from None
    wrong = [block for block in blocks if not _is_concrete(block)]
    if wrong or not blocks:
        raise ParameterError(f"{origin}: it holds no concrete block{f': {wrong[0]!r}' if wrong else ''}")
    return blocks


def _line_in(error: BaseException) -> str:
    """Return the line and file name of the innermost user code in a traceback; an empty string if there is none."""
    trace, place = error.__traceback__, ""
    while trace is not None:
        code = trace.tb_frame.f_code
        # <frozen importlib._bootstrap> and the like are no files of a user
        if not code.co_filename.startswith("<") and "feeddrive" not in trace.tb_frame.f_globals.get("__name__", ""):
            place = f"{trace.tb_lineno} of {os.path.basename(code.co_filename)}"
        trace = trace.tb_next
    return place


def module_at(place: str) -> tuple[ModuleType, str]:
    """Import the module of a place; return it with the class name, which is empty if the place names no class.

    Modules are searched for on Python's path, then in the working directory; a file is imported from its own folder.
    """
    head, _, name = place.rpartition(":") if not place.endswith(".py") else (place, "", "")
    if not head:
        head, name = name, ""
    if not head.endswith(".py"):
        _search(Path.cwd())
        return importlib.import_module(head), name
    file = Path(head).resolve()
    if not file.is_file():
        raise ParameterError(f"there is no file {head}")
    _search(file.parent)
    module = importlib.import_module(file.stem)
    # a file called like an installed module is not found: the search path has it last
    if Path(module.__file__ or "").resolve() != file:
        raise ParameterError(f"Python already has a module '{file.stem}', {module.__file__}: give {file} another name")
    return module, name


def fault_of_user_code(error: Exception) -> FeeddriveError | None:
    """Return a one-sentence error with file and line for an exception in user-defined block code, otherwise None.

    Only the command line, which shows no traceback, uses this function; Python users get the original exception.
    """
    trace, line = error.__traceback__, ""
    while trace is not None:
        # no break: the innermost frame of the user's code is the line to correct
        if _defines_blocks(trace.tb_frame.f_globals):
            line = f"{os.path.basename(trace.tb_frame.f_code.co_filename)}, line {trace.tb_lineno}"
        trace = trace.tb_next
    return StructureError(f"{line}: {type(error).__name__}: {error}") if line else None


def _defines_blocks(module: Mapping[str, Any]) -> bool:
    """Return True if `module`, the globals of a module, is outside this package and defines at least one block."""
    name = str(module.get("__name__", ""))
    return name.partition(".")[0] != "feeddrive" and any(
        isinstance(block, type) and issubclass(block, Block) and block.__module__ == name for block in module.values()
    )


def _search(folder: Path) -> None:
    # appended, not inserted: a user's file must not hide a module of Python or of a package
    if str(folder) not in sys.path:
        sys.path.append(str(folder))


def _is_concrete(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, Block) and not inspect.isabstract(value)


def _defined_blocks(module: ModuleType) -> list[type[Block]]:
    """Return the concrete blocks in the namespace of a module that are defined in it or in one of its submodules."""
    below = f"{module.__name__}."
    return [
        member for member in vars(module).values() if _is_concrete(member) and f"{member.__module__}.".startswith(below)
    ]


@contextmanager
def with_blocks(places: Sequence[str]) -> Generator[None]:
    """Context manager that adds the blocks at these places to the catalogue, also in child processes.

    Raises the same errors as `catalogue`.
    """
    before = os.environ.get(VARIABLE)
    # absolute: a child process may run in another folder
    resolved = [str(Path(place).resolve()) if place.endswith(".py") else place for place in places]
    if resolved:
        # in the environment, which child processes inherit
        os.environ[VARIABLE] = ",".join([*filter(None, [before]), *resolved])
    try:
        if resolved:
            # a place that cannot be imported is refused here, not at the first use of a block
            catalogue()
        yield
    finally:
        if resolved:
            os.environ.pop(VARIABLE)
            if before is not None:
                os.environ[VARIABLE] = before


def members(family: type[B]) -> Mapping[str, type[B]]:
    """Return the blocks of a family by kind."""
    return catalogue().get(family, {})  # type: ignore[return-value]


def member(family: type[B], kind: str) -> type[B] | None:
    """Return the block of a kind in a family, or None if there is none.

    A shipped block has the name of its file.  If there are no user-defined blocks, whose kinds may clash, only this
    file is imported: a machine has a tenth of all blocks.
    """
    if not (installed_points(ENTRY_POINTS) or os.environ.get(VARIABLE)):
        for module in _files().get(kind, ()):
            for block in blocks_of(module):
                if block.kind == kind and family_of(block) is family:
                    return block  # type: ignore[return-value]
    return members(family).get(kind)


@cache
def _files() -> Mapping[str, tuple[str, ...]]:
    """Return the dotted names of the modules that define blocks, by the name of their file."""
    named: dict[str, tuple[str, ...]] = {}
    for module in modules():
        name = module.rpartition(".")[2]
        named[name] = (*named.get(name, ()), module)
    return MappingProxyType(named)


def modules() -> Iterator[str]:
    """Return the dotted names of the modules that define blocks, one package level below `feeddrive.blocks`."""
    return modules_below("feeddrive.blocks")


def blocks_of(module: str) -> list[type[Block]]:
    """Return the concrete blocks that a module defines, excluding those that it imports."""
    values = vars(importlib.import_module(module)).values()
    return [value for value in values if _is_concrete(value) and value.__module__ == module]


def imported(family: type[B], place: str) -> type[B]:
    """Import the block that a user specifies as PACKAGE.MODULE:CLASS; the import runs the code of the module.

    Modules are searched for on Python's path, then in the working directory. Use this function for names from a command
    line, never for names read from a file.

    Raises ParameterError if there is no such module or class, or if it is not a concrete block of the family.
    """
    try:
        module, name = module_at(place)
    except ImportError as error:
        raise ParameterError(
            f"'{place}': the module cannot be imported ({error}): check its name and where it is"
        ) from None
    return required(getattr(module, name, None), family, place, f"there is no class '{name}' in {module.__name__}")


def required(value: Any, family: type[B], place: str, missing: str = "it is no class") -> type[B]:
    """Return `value` if it is a concrete block class of a family; otherwise raise ParameterError with the reason."""
    if not isinstance(value, type):
        raise ParameterError(f"'{place}': {missing}")
    if not issubclass(value, family) or inspect.isabstract(value):
        lacking = ", ".join(sorted(getattr(value, "__abstractmethods__", ())))
        why = f"it lacks {lacking}" if issubclass(value, family) else f"it must derive from {family.__name__}"
        raise ParameterError(f"'{place}' is no {family.kind.replace('_', ' ')}: {why}")
    return value


def family_of(block: type[Block]) -> type[Block]:
    """Return the family of a block: the direct subclass of Block that is its ancestor, or the block itself."""
    return next(base for base in reversed(block.__mro__) if issubclass(base, Block) and base is not Block)


def find(family: type[B], kind: str) -> type[B]:
    """Return the block class of a kind, such as `two_mass`, in a family.

    Raises ParameterError, which suggests similar names, for an unknown kind.
    """
    kinds = members(family)
    if kind in kinds:
        return kinds[kind]
    from difflib import get_close_matches  # only for a message

    near = [RENAMED[kind]] if RENAMED.get(kind) in kinds else get_close_matches(kind, kinds, 3)
    hint = f"did you mean {' or '.join(near)}?" if near else f"there are: {', '.join(kinds) or 'none'}"
    raise ParameterError(f"there is no {family.kind.replace('_', ' ')} of kind '{kind}'; {hint}; {OPT_IN}")
