"""What a page keeps on disk, so that its work is found again after the server has ended, even by `kill -9`.

Each part of the state is one JSON file in the directory `kept` of the page, written whole.  Values are written by the
fields of their dataclasses.  No pickle: a directory that somebody else wrote must not run code, so only dataclasses and
named tuples of feeddrive, and blocks of the catalogue, are made from these files.
"""

from __future__ import annotations

import base64
import json
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, cast
from weakref import WeakKeyDictionary, WeakSet

import numpy as np

from feeddrive.blocks.catalogue import catalogue
from feeddrive.files.atomic_io import write_whole
from feeddrive.language.block import Block
from feeddrive.language.errors import FeeddriveError, FileError
from feeddrive.version import __version__

FOLDER = "kept"
_QUIET, _LONGEST = 0.15, 1.5  # s without a change after which it is written, and the longest wait
_ROOT = "feeddrive."

Hook = Callable[[Any], Any]


class Code:
    """Writes values as JSON data and reads them back.

    held     returns JSON data for a value that is not written by its fields, or None
    restore  returns the value of such data
    """

    def __init__(self, held: Hook = lambda _: None, restore: Hook = lambda known: known) -> None:
        self._held, self._restore = held, restore
        # frozen values that are compared by identity, such as the steps of the history, are written once
        self._known = WeakKeyDictionary[Any, Any]()
        self._blocks = dict[str, Block]()

    def data(self, value: Any) -> Any:
        """Return JSON data. Raises TypeError for a value that has no fields, such as a function."""
        if value is None or isinstance(value, (bool, str)) or type(value) is int:
            return value
        if isinstance(value, np.generic):
            return self.data(value.item())
        if isinstance(value, float):
            return value if math.isfinite(value) else {"float": str(value)}
        if isinstance(value, complex):
            return {"complex": [self.data(value.real), self.data(value.imag)]}
        if isinstance(value, list):
            return [self.data(each) for each in cast("list[Any]", value)]
        if isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                raise TypeError("an array of objects cannot be kept")
            content = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode()
            return {"array": content, "of": value.dtype.str, "shape": list(value.shape)}
        if isinstance(value, Path):
            return {"path": str(value)}
        found = self._held(value)
        if found is not None:
            return {"held": found}
        return self._parts(value)

    def _parts(self, value: Any) -> Any:
        if is_dataclass(value) and not isinstance(value, type):
            names = [each.name for each in fields(value)]
        elif isinstance(value, tuple):
            names = list(getattr(cast("Any", value), "_fields", ()))
            if not names:
                return {"tuple": [self.data(each) for each in cast("tuple[Any, ...]", value)]}
        elif isinstance(value, Mapping):
            pairs = cast("Mapping[Any, Any]", value).items()
            return {"dict": [[self.data(key), self.data(each)] for key, each in pairs]}
        elif isinstance(value, (set, frozenset)):
            return {"set": [self.data(each) for each in cast("set[Any]", value)]}
        else:
            raise TypeError(f"a {type(value).__name__} cannot be kept")
        kind = cast("type[Any]", type(value))
        once = kind.__hash__ is object.__hash__
        if once and value in self._known:
            return self._known[value]
        found = {
            "kind": f"{kind.__module__}:{kind.__qualname__}",
            "has": {n: self.data(getattr(value, n)) for n in names},
        }
        if once:
            self._known[value] = found
        return found

    def value(self, data: Any) -> Any:
        """Return the value of JSON data. Raises FileError for data that this version does not know."""
        if isinstance(data, list):
            return [self.value(each) for each in cast("list[Any]", data)]
        if not isinstance(data, dict):
            return data
        match cast("dict[str, Any]", data):
            case {"float": text}:
                return float(text)
            case {"complex": [real, imaginary]}:
                return complex(self.value(real), self.value(imaginary))
            case {"array": content, "of": kind, "shape": shape}:
                return np.frombuffer(base64.b64decode(content), np.dtype(kind)).reshape(shape).copy()
            case {"path": text}:
                return Path(text)
            case {"tuple": entries}:
                return tuple(self.value(each) for each in entries)
            case {"dict": pairs}:
                return {self.value(key): self.value(each) for key, each in pairs}
            case {"set": entries}:
                return {self.value(each) for each in entries}
            case {"held": found}:
                return self._restore(found)
            case {"kind": kind, "has": has}:
                return self._block(kind, has)
            case _:
                raise FileError(f"holds what is no value: {', '.join(map(str, data)):.60}")

    def _block(self, kind: str, has: dict[str, Any]) -> Any:
        """Make a value from its fields; blocks, which are told apart by identity, are one where they were one."""
        cls = _class(kind)
        if not issubclass(cls, Block):
            return _made(cls, {name: self.value(each) for name, each in has.items()})
        key = json.dumps([kind, has])
        if key not in self._blocks:
            self._blocks[key] = _made(cls, {name: self.value(each) for name, each in has.items()})
        return self._blocks[key]


def _made(cls: type[Any], has: dict[str, Any]) -> Any:
    """Make a value from its fields."""
    if is_dataclass(cls) and not cls.__dataclass_params__.init:  # type: ignore[attr-defined]
        made = object.__new__(cls)
        for name, value in has.items():
            object.__setattr__(made, name, value)
        return made
    return cls(**has)


def _class(kind: str) -> type[Any]:
    module, _, name = kind.partition(":")
    found: Any = None
    if not module.startswith(_ROOT):
        blocks = [block for family in catalogue().values() for block in family.values()]
        found = next((block for block in blocks if (block.__module__, block.__qualname__) == (module, name)), None)
    elif name.isidentifier():
        try:
            found = getattr(import_module(module), name, None)
        except ImportError:
            found = None
    plain = isinstance(found, type) and found.__module__ == module
    if not plain or not (is_dataclass(found) or issubclass(found, tuple)):
        raise FileError(f"holds a {kind:.80}, which this version of feeddrive does not know")
    return cast("type[Any]", found)


def same(one: Any, other: Any) -> bool:
    """Return True if two states have the same content: containers by their entries, all that is frozen by identity."""
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, dict):
        pairs, known = cast("dict[Any, Any]", one), cast("dict[Any, Any]", other)
        return list(pairs) == list(known) and all(same(value, known[key]) for key, value in pairs.items())
    if isinstance(one, (list, tuple)):
        entries, others = cast("Sequence[Any]", one), cast("Sequence[Any]", other)
        return len(entries) == len(others) and all(map(same, entries, others))
    return isinstance(one, (str, int, float, Path)) and one == other


def copied(state: Any) -> Any:
    """Return a state whose containers do not change any more."""
    if isinstance(state, dict):
        return {key: copied(value) for key, value in cast("dict[Any, Any]", state).items()}
    if type(state) is list:
        return [copied(value) for value in cast("list[Any]", state)]
    if isinstance(state, set):
        return frozenset(cast("set[Any]", state))
    return state


_KEEPERS = WeakSet["Keeper"]()  # of all pages


def write_all() -> None:
    """Write the state of all pages for the last time, when the server stops: with the jobs that this interrupts."""
    for keeper in tuple(_KEEPERS):
        keeper.end()


class Keeper:
    """Writes the state of a page after it has changed, in a thread of its own.

    folder   directory of the page
    parts()  returns the state by part, with containers that do not change any more
    """

    def __init__(self, folder: Path, code: Code, parts: Callable[[], Mapping[str, Any]]) -> None:
        self._folder, self._code, self._parts = folder / FOLDER, code, parts
        self._written = dict[str, Any]()
        self._changed, self._ended, self._writing = threading.Event(), threading.Event(), threading.Lock()
        self._thread: threading.Thread | None = None
        self.failed = ""  # why it could not be written

    def touch(self) -> None:
        """Write what has changed, soon."""
        self._changed.set()
        if self._thread is None:
            _KEEPERS.add(self)
            self._thread = threading.Thread(target=self._follow, daemon=True)
            self._thread.start()

    def end(self) -> None:
        """Write what has changed, and end."""
        if self._thread is not None and not self._ended.is_set():
            self._ended.set()
            self._changed.set()
            self._thread.join(5.0)

    def _follow(self) -> None:
        while not self._ended.is_set():
            self._changed.wait()
            # a drag changes something thirty times a second: it is written once the hand rests
            begun = time.monotonic()
            while not self._ended.is_set() and time.monotonic() - begun < _LONGEST:
                self._changed.clear()
                if not self._changed.wait(_QUIET):
                    break
            self._changed.clear()
            self.write()
        self.write()

    def write(self) -> None:
        """Write the parts that have changed."""
        with self._writing:
            for name, state in self._parts().items():
                if name in self._written and same(self._written[name], state):
                    continue
                try:
                    content = {"version": __version__, "state": self._code.data(state)}
                    self._folder.mkdir(parents=True, exist_ok=True)
                    write_whole(self._folder / f"{name}.json", json.dumps(content, allow_nan=False).encode())
                    self._written[name], self.failed = state, ""
                except (FeeddriveError, OSError, TypeError) as error:
                    # the page goes on; it says that a restart would not find this
                    self._written[name], self.failed = state, str(error)


def read_part(folder: Path, name: str, code: Code) -> Any:
    """Read a part of what a page kept; None if there is none. Raises FileError for a part that cannot be read."""
    path = folder / FOLDER / f"{name}.json"
    if not path.is_file():
        return None
    try:
        return code.value(json.loads(path.read_bytes())["state"])
    except FeeddriveError as error:
        raise FileError(f"{path}: {error}") from None
    except (ValueError, KeyError, TypeError, AttributeError, OSError, RecursionError) as error:
        raise FileError(f"{path}: cannot be read: {error}; what it held is lost, all else stays") from None
