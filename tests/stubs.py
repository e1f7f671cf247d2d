"""The stubs `__init__.pyi`, which editors and type checkers read: written from the names that the packages hold.

`make stubs` writes them.  The names of a package stand in its `__init__.py`; those of blocks follow from their files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path

import feeddrive
import feeddrive.blocks
from feeddrive.language.lazy_package import public_names

SOURCE = Path(feeddrive.__file__).parent


def packages() -> Iterator[tuple[str, Mapping[str, str]]]:
    """Each package with public names, and these with the modules that hold them."""
    for init in sorted(SOURCE.rglob("__init__.py")):
        package = ".".join(("feeddrive", *init.parent.relative_to(SOURCE).parts))
        if names := feeddrive.blocks.by_file() if package == "feeddrive.blocks" else public_names(package):
            yield package, names


def place(package: str) -> Path:
    return SOURCE.joinpath(*package.split(".")[1:], "__init__.pyi")


def stub(package: str, names: Mapping[str, str]) -> str:
    """The text, in the order and in the lines of ruff."""
    summary = (import_module(package).__doc__ or "").strip().splitlines()[0]
    lines = [f'"""{summary}"""', "", "# written by `make stubs`", ""]
    for name, module in sorted(names.items(), key=lambda item: (item[1], kind(item[0]), item[0])):
        line = f"from {module} import {name} as {name}"
        lines.append(line if len(line) <= 120 else f"from {module} import (\n    {name} as {name},\n)")
    return "\n".join(lines) + "\n"


def kind(name: str) -> int:
    """Constants, then classes, then functions."""
    return 0 if name.isupper() and len(name) > 1 else 1 if name[:1].isupper() else 2


if __name__ == "__main__":
    for package, names in packages():
        place(package).write_text(stub(package, names), encoding="utf-8")
