"""Packages whose public names are imported on first use.

`make_lazy` holds the names of a package, once; the stub `__init__.pyi` that editors and type checkers read is written
from them by `tests/stubs.py`.  A module often has the name of its function (`margins.margins`); the public name is the
function, also after the module was imported.
"""

from __future__ import annotations

import pkgutil
import sys
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from types import ModuleType
from typing import Any

from feeddrive.language.errors import nearest


def public_names(package: str) -> Mapping[str, str]:
    """Public name -> module that holds it, of a package of feeddrive; empty for a package that is not lazy."""
    return vars(import_module(package)).get("_public", {})


def modules_below(package: str) -> Iterator[str]:
    """Dotted names of the modules in the subfolders of a package, without its own modules."""
    for module in pkgutil.walk_packages(sys.modules[package].__path__, f"{package}."):
        if not module.ispkg and module.name.count(".") > package.count(".") + 1:
            yield module.name


class LazyPackage(ModuleType):
    """A package that imports its public names on first use; `dir` lists nothing else."""

    def __getattr__(self, name: str) -> Any:
        place = self.__dict__["_public"].get(name)
        if place is None:
            value = self.__dict__["_other"](name)
        elif place == self.__name__:
            value = import_module(f"{place}.{name}")
        else:
            value = getattr(import_module(place), name)
        self.__dict__[name] = value
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        place = self.__dict__["_public"].get(name, self.__name__)
        if place == self.__name__ or not isinstance(value, ModuleType):  # an import may not hide the public name
            super().__setattr__(name, value)

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Raise TypeError: a package cannot be called; a function of this name existed earlier."""
        raise TypeError(self.__dict__["_no_function"])

    def __dir__(self) -> list[str]:
        return sorted(self.__dict__["_public"])


def make_lazy(
    package: str, names: Mapping[str, str], other: Callable[[str], Any] | None = None, no_function: str = ""
) -> None:
    """Let a package import its public names on first use; called at the end of its `__init__.py`.

    names        by module, separated by blanks: a module relative to the package; "" for modules that are public
                 themselves
    other        gives names that are not public, or raises AttributeError
    no_function  what the error says if the package is called as a function
    """

    def missing(name: str) -> Any:
        raise AttributeError(f"{package} has no name '{name}'{nearest(name, dir(sys.modules[package]))}")

    module = sys.modules[package]
    module.__dict__["_public"] = {
        name: f"{package}.{place}" if place else package for place, text in names.items() for name in text.split()
    }
    module.__dict__["_other"] = other or missing
    module.__dict__["_no_function"] = no_function or f"'{package}' is a package, not a function"
    module.__class__ = LazyPackage
