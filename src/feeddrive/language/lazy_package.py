"""Packages whose public names are imported on first use.

`make_lazy` declares the public names of a package once; `tests/stubs.py` generates the stub `__init__.pyi` for editors
and type checkers from them.  A module often has the same name as its function (`margins.margins`); the public name
refers to the function, even after the module has been imported.
"""

import pkgutil
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from types import MappingProxyType, ModuleType
from typing import Any

from feeddrive.language.errors import nearest


def public_names(package: str) -> Mapping[str, str]:
    """Return a mapping from each public name of a package to its module; empty for a package that is not lazy."""
    return vars(import_module(package)).get("_public", {})


def modules_below(package: str) -> Iterator[str]:
    """Yield the dotted names of the modules in the subfolders of a package, excluding its top-level modules."""
    for module in pkgutil.walk_packages(sys.modules[package].__path__, f"{package}."):
        if not module.ispkg and module.name.count(".") > package.count(".") + 1:
            yield module.name


class LazyPackage(ModuleType):
    """A package that imports its public names on first use; `dir` lists only these."""

    def __getattr__(self, name: str) -> Any:
        place = self.__dict__["_public"].get(name)
        former = self.__dict__.get("_former", {}).get(name)
        if former is not None:
            # not kept in the dictionary: each use is told where it stands
            new, version = former
            text = f"{self.__name__}.{name} is now {new}; the former name is removed in {version}"
            warnings.warn(text, DeprecationWarning, stacklevel=2)
            package, _, new_name = new.rpartition(".")
            return getattr(import_module(package), new_name)
        if place is None and name.startswith("_"):
            # what Python and its tools ask of any object; no person mistyped a public name
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
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
        # importing a submodule sets it on the package, where it would hide the public name
        if place == self.__name__ or not isinstance(value, ModuleType):
            super().__setattr__(name, value)

    def __call__(self, *args: Any, **options: Any) -> Any:
        """Raise TypeError: a package cannot be called (earlier versions had a function of this name)."""
        raise TypeError(self.__dict__["_no_function"])

    def __dir__(self) -> list[str]:
        return sorted(self.__dict__["_public"])


def make_lazy(
    package: str,
    names: Mapping[str, str],
    other: Callable[[str], Any] | None = None,
    no_function: str = "",
    former: Mapping[str, tuple[str, str]] = MappingProxyType({}),
) -> None:
    """Make a package import its public names on first use; call this at the end of its `__init__.py`.

    names        maps each module, relative to the package, to its public names, separated by blanks; "" denotes
                 the package itself, whose public names are modules
    other        returns the values of names that are not public, or raises AttributeError
    no_function  error message if the package is called as a function
    former       maps each former name to the full name that replaces it and the version that removes it; until then
                 it works, with a DeprecationWarning
    """

    def missing(name: str) -> Any:
        raise AttributeError(f"{package} has no name '{name}'{nearest(name, dir(sys.modules[package]))}")

    module = sys.modules[package]
    module.__dict__["_public"] = {
        name: f"{package}.{place}" if place else package for place, text in names.items() for name in text.split()
    }
    module.__dict__["_other"] = other or missing
    module.__dict__["_former"] = former
    module.__dict__["_no_function"] = no_function or f"'{package}' is a package, not a function"
    # the class of the module is changed, since importers already hold this object
    module.__class__ = LazyPackage
