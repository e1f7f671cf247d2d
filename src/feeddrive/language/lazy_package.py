"""Packages whose public names are imported on first use, from the modules listed in their stub `__init__.pyi`.

The stub is what editors and type checkers read.  A module often has the name of its function (`margins.margins`); the
public name is the function, also after the module was imported.
"""

from __future__ import annotations

import pkgutil
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

from feeddrive.language.errors import nearest

_IMPORT = re.compile(r"(?m)^from (feeddrive[.\w]*) import \(?\s*(\w+)")


@cache
def public_names(package: str) -> Mapping[str, str]:
    """Public name -> module that holds it, of a package of feeddrive; none for a package without a stub."""
    try:
        stub = (pkgutil.get_data(package, "__init__.pyi") or b"").decode()
    except FileNotFoundError:
        return {}
    return {name: module for module, name in _IMPORT.findall(stub)}


def modules_below(package: str) -> Iterator[str]:
    """Dotted names of the modules in the subfolders of a package, without its own modules."""
    for module in pkgutil.walk_packages(sys.modules[package].__path__, f"{package}."):
        if not module.ispkg and module.name.count(".") > package.count(".") + 1:
            yield module.name


class LazyPackage(ModuleType):
    """A package that gives its public names; `dir` lists nothing else."""

    def __getattr__(self, name: str) -> Any:
        place = public_names(self.__name__).get(name)
        if place is None:
            value = self.__dict__["_other"](name)
        elif place == self.__name__:
            value = import_module(f"{place}.{name}")
        else:
            value = getattr(import_module(place), name)
        self.__dict__[name] = value
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        place = public_names(self.__name__).get(name, self.__name__)
        if place == self.__name__ or not isinstance(value, ModuleType):  # an import may not hide the public name
            super().__setattr__(name, value)

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Raise TypeError: a package cannot be called; a function of this name existed earlier."""
        raise TypeError(self.__dict__["_no_function"])

    def __dir__(self) -> list[str]:
        return sorted({*public_names(self.__name__), *self.__dict__["_more"]()})


def make_lazy(
    package: str,
    other: Callable[[str], Any] | None = None,
    more: Callable[[], list[str]] | None = None,
    no_function: str = "",
) -> None:
    """Let a package load the names of its stub on first use; called at the end of its `__init__.py`.

    other        gives names that the stub does not list, or raises AttributeError
    more         further names for `dir`
    no_function  what the error says if the package is called as a function
    """

    def missing(name: str) -> Any:
        raise AttributeError(f"{package} has no name '{name}'{nearest(name, dir(sys.modules[package]))}")

    module = sys.modules[package]
    module.__dict__["_other"] = other or missing
    module.__dict__["_more"] = more or list[str]
    module.__dict__["_no_function"] = no_function or f"'{package}' is a package, not a function"
    module.__class__ = LazyPackage
