"""The house: floors import only downward, files stay small, step laws keep to `ops`, the door opens quickly."""

from __future__ import annotations

import ast
import importlib
import itertools
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

import feeddrive
from feeddrive.blocks import catalogue
from feeddrive.language.block import Block, snake_case

SOURCE = Path(feeddrive.__file__).parent
FILES = sorted(SOURCE.rglob("*.py"))
DESIGN = (Path(__file__).parents[1] / "DESIGN.md").read_text(encoding="utf-8")


def rooms_of(design: str) -> list[str]:
    """The rooms in the order of the table in section 3 of DESIGN.md: each imports only from those before it."""
    section = design.partition("\n## 3. Floors\n")[2].partition("\n## ")[0]
    first_cells = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    return [room for cell in first_cells for room in re.findall(r"`(\w+)/`", cell)]


FLOORS = rooms_of(DESIGN)
# Blocks that are part of a step, and so are traced; those of reference/ and load/ are sampled and may use numpy.
TRACED = [
    "actuator",
    "compensation",
    "controller",
    "coupling",
    "cutting",
    "feedforward",
    "filter",
    "force",
    "friction",
    "observer",
    "plant",
    "prefilter",
    "sensor",
]
SAMPLED = ["load", "reference"]


class Import(NamedTuple):
    """One imported module, with where it stands: the names of the functions around it, outermost first."""

    module: str
    line: int
    inside: tuple[str, ...]
    typing_only: bool


@cache
def imports(path: Path) -> tuple[Import, ...]:
    return tuple(_imports(ast.parse(path.read_text(encoding="utf-8")), (), False))


def _imports(node: ast.AST, inside: tuple[str, ...], typing_only: bool) -> Iterator[Import]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            for name in child.names:
                yield Import(name.name, child.lineno, inside, typing_only)
        elif isinstance(child, ast.ImportFrom):
            assert child.level == 0, f"line {child.lineno}: imports are written in full"
            for name in child.names:
                yield Import(f"{child.module}.{name.name}", child.lineno, inside, typing_only)
        else:
            deeper = inside
            if isinstance(child, ast.FunctionDef):
                deeper = (*inside, child.name)
            guarded = isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)
            yield from _imports(child, deeper, typing_only or guarded)


def floor_of(parts: tuple[str, ...]) -> int | None:
    return FLOORS.index(parts[0]) if parts and parts[0] in FLOORS else None


def shown(path: Path) -> str:
    return str(path.relative_to(SOURCE))


def test_the_floors_are_the_folders():
    folders = {path.name for path in SOURCE.iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert sorted(FLOORS) == sorted(folders), "the table in DESIGN.md, section 3, names each room once"


def upward(path: Path) -> Iterator[str]:
    """The imports of a file that run upward; none of the package itself, which shows all floors."""
    own = floor_of(path.relative_to(SOURCE).parts)
    if own is None:
        return
    for imported in imports(path):
        if not imported.module.startswith("feeddrive"):
            continue
        other = floor_of(tuple(imported.module.split(".")[1:]))
        # the package itself imports every room: only the version lies outside of the rooms
        outside = other is None and not imported.module.startswith("feeddrive.version.")
        if outside or (other is not None and other > own):
            yield f"{shown(path)}, line {imported.line}: {FLOORS[own]} imports {imported.module} from above"


def test_no_arrow_runs_up():
    assert not [arrow for path in FILES for arrow in upward(path)]


def module_name(path: Path) -> str:
    parts = path.relative_to(SOURCE.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def import_graph() -> dict[str, set[str]]:
    """The files that each file names in an import: at its top, in a function, or for types only."""
    names = {module_name(path) for path in FILES}
    graph: dict[str, set[str]] = {}
    for path in FILES:
        own = module_name(path)
        named = {found.module for found in imports(path)} | named_in_text(path)
        graph[own] = {name if name in names else name.rpartition(".")[0] for name in named} & names - {own}
    return graph


def named_in_text(path: Path) -> set[str]:
    """Modules that are imported by a name in quotes: `import_module("feeddrive...")`."""
    text = path.read_text(encoding="utf-8")
    if "import_module" not in text and "__import__" not in text:
        return set()
    calls = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call)]
    return {
        call.args[0].value
        for call in calls
        if ast.unparse(call.func).rpartition(".")[2] in ("import_module", "__import__")
        and call.args
        and isinstance(call.args[0], ast.Constant)
        and isinstance(call.args[0].value, str)
    }


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Sets of files that import each other, each once (strongly connected components, Tarjan 1972)."""
    number: dict[str, int] = {}
    lowest: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(name: str) -> None:
        number[name] = lowest[name] = len(number)
        stack.append(name)
        for other in sorted(graph[name]):
            if other not in number:
                visit(other)
            if other in stack:
                lowest[name] = min(lowest[name], lowest[other])
        if lowest[name] == number[name]:
            together = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(together) > 1:
                found.append(sorted(together))

    for name in graph:
        if name not in number:
            visit(name)
    return found


def test_circles_are_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()}) == [["b", "c"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_no_files_import_each_other_in_a_circle():
    """Lazy imports and those for types count too: who needs the other's name depends on it."""
    assert circles(import_graph()) == []


def test_modules_have_the_names_of_what_they_are():
    vague = re.compile(r"(^|_)(util|utils|helper|helpers|manager|managers|data|process|misc|common)($|_)")
    assert not [shown(path) for path in FILES if vague.search(path.stem)]


def block_files(families: list[str]) -> list[Path]:
    return [
        path for path in FILES if path.relative_to(SOURCE).parts[:1] == ("blocks",) and path.parent.name in families
    ]


def test_every_family_is_traced_or_sampled():
    folders = {path.name for path in (SOURCE / "blocks").iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert folders == {*TRACED, *SAMPLED}


def untraceable(path: Path) -> Iterator[str]:
    """What a file computes with that runs on numbers only."""
    for imported in imports(path):
        if imported.module.split(".")[0] in ("math", "cmath", "numpy", "scipy"):
            yield f"{shown(path)}, line {imported.line}: {imported.module}"
    for line in powers(ast.parse(path.read_text(encoding="utf-8"))):
        yield f"{shown(path)}, line {line}: x*x or ops.power instead of **"


def test_step_laws_are_written_in_ops():
    """`math` and `numpy` compute on numbers only; what is traced must run on symbols too."""
    assert not [place for path in block_files(TRACED) for place in untraceable(path)]


def powers(node: ast.AST) -> Iterator[int]:
    """Lines with ** in what is traced; `check` and `fits` look at numbers before any trace."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef) and child.name in ("check", "fits"):
            continue
        if isinstance(child, ast.BinOp) and isinstance(child.op, ast.Pow):
            yield child.lineno
        yield from powers(child)


def test_a_file_holds_at_most_one_concrete_block_and_has_its_name():
    names = {
        path: [snake_case(block.__name__) for block in catalogue.blocks_of(module_name(path))]
        for path in block_files([*TRACED, *SAMPLED])
        if path.stem != "__init__"
    }
    assert sum(map(len, names.values())) == len(concrete_blocks())
    assert not {shown(path): held for path, held in names.items() if held not in ([path.stem], [])}


def concrete_blocks() -> list[type[Block]]:
    return [block for members in catalogue.catalogue().values() for block in members.values()]


def test_concrete_blocks_are_final():
    assert not [pair for pair in itertools.permutations(concrete_blocks(), 2) if issubclass(*pair)]


HEAVY = ["scipy", "matplotlib", "pandas", "pyarrow", "llvmlite", "rich", "typer", "control", "numpy"]


def loaded_by(code: str) -> set[str]:
    """The heavy packages that a fresh interpreter has loaded after some code."""
    asked = f"import sys\n{code}\nprint(*[name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True, timeout=120)
    return set(done.stdout.split())


def test_import_feeddrive_loads_nothing_heavy():
    assert loaded_by("import feeddrive") == set()


def test_a_loop_is_described_with_numpy_alone():
    code = "import feeddrive; feeddrive.Loop; b = feeddrive.blocks; b.TwoMass; b.CascadePPI; b.Stribeck"
    assert loaded_by(code) == {"numpy"}


PUBLIC = [path.parent for path in sorted(SOURCE.rglob("__init__.pyi"))]


def test_static_names_are_the_ones_that_are_loaded():
    """What type checkers see in a stub is what the package gives, also after modules of these names were imported."""
    for folder in PUBLIC:
        names_of_a_stub(folder)


def names_of_a_stub(folder: Path) -> None:
    package = ".".join(("feeddrive", *folder.relative_to(SOURCE).parts))
    listed = [found.module for found in imports(folder / "__init__.pyi") if found.module.startswith("feeddrive.")]
    assert listed
    made = importlib.import_module(package)
    for path in listed:
        module, _, name = path.rpartition(".")
        held = importlib.import_module(path) if module == package else getattr(importlib.import_module(module), name)
        assert getattr(made, name) is held, name
    names = {path.rpartition(".")[2] for path in listed}
    assert names == set(dir(made)), f"dir({package}) lists the public names and nothing else"


def test_the_top_is_short_and_old_names_say_where_they_went():
    rooms = [name for name in dir(feeddrive) if (SOURCE / name).is_dir()]
    assert 35 <= len(dir(feeddrive)) - len(rooms) <= 45
    for room in rooms:
        for name in set(dir(getattr(feeddrive, room))) - set(dir(feeddrive)) if room != "plot" else ():
            with pytest.raises(AttributeError, match=rf"fd\.{name} is now fd\."):
                getattr(feeddrive, name)
    with pytest.raises(AttributeError, match=r"fd\.get is now fd\.parameters\(loop\)\[path\]"):
        feeddrive.get  # noqa: B018
    assert not {"get", "leaves", "Sequence", "annotations"} & set(dir(feeddrive))


def test_dir_names_every_block_and_each_can_be_had():
    names = dir(feeddrive.blocks)
    for block in concrete_blocks():
        assert block.__name__ in names
        assert getattr(feeddrive.blocks, block.__name__) is block


def test_dir_imports_no_block_and_no_other_room():
    """More than a hundred blocks and scipy take seconds; in a fresh interpreter, with the imports of the package."""
    code = "import sys, feeddrive as fd; dir(fd); dir(fd.blocks); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    loaded = set(done.stdout.split())
    assert not {block.__module__ for block in concrete_blocks()} & loaded
    assert {name.split(".")[1] for name in loaded if name.startswith("feeddrive.")} == {"language", "blocks"}
    assert not {"scipy", "llvmlite", "pyarrow", "matplotlib"} & loaded


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no name 'NoSuchBlock'"):
        feeddrive.NoSuchBlock  # noqa: B018
    with pytest.raises(AttributeError, match="no name 'NoSuchBlock'"):
        feeddrive.blocks.NoSuchBlock  # noqa: B018
