"""A case: one design to be built or tuned, run and evaluated, as a frozen value that can be pickled.

@dataclass(frozen=True, eq=False)
class Peak(Case[float]):
    loop: Loop
    gain: float

    @property
    def name(self) -> str:
        return f"Kv = {self.gain}"

    def outcome(self, progress: Progress) -> float:
        return margins_of(with_gain(self.loop, self.gain)).sensitivity_peak

Engine(workers=4).evaluate([Peak(loop, gain) for gain in gains])
"""

import hashlib
import inspect
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar, cast

import numpy as np

from feeddrive.blocks.catalogue import fault_of_user_code
from feeddrive.files.run_files import versions
from feeddrive.language import tree
from feeddrive.language.block import Block
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.progress import Progress

T = TypeVar("T")


class Case(ABC, Generic[T]):
    """A unit of work of the engine: a frozen dataclass whose fields and outcome can be pickled.

    kind      name on the dashboard of a cluster
    common    names of the fields that are the same object in all cases of an evaluation; sent to each worker once
    stages    number of progress steps that the case counts as
    threaded  True if it computes in machine code that releases the interpreter lock, so that threads are sufficient
    isolated  True if it runs third-party code that may crash its process; even one worker is then a separate process
    """

    kind: ClassVar[str] = "case"
    common: ClassVar[tuple[str, ...]] = ()
    stages: ClassVar[int] = 1
    isolated: ClassVar[bool] = False

    @property
    def threaded(self) -> bool:
        """True if such cases can be computed in parallel by threads of one process."""
        return False

    @property
    @abstractmethod
    def name(self) -> str:
        """The name of the case for progress and errors."""

    @abstractmethod
    def outcome(self, progress: Progress) -> T:
        """Compute the case. The outcome must depend on the fields alone, not on other cases or on where it runs.

        Raises CancelledError once `progress` is cancelled.
        """

    @property
    def digest(self) -> str:
        """The SHA-256 of everything that determines the outcome: fields, code of their blocks, and versions."""
        return content_digest(self)

    def record(self, outcome: T) -> Any:
        """Return the JSON-serializable record of an outcome for a store; None if it is never stored."""
        return None

    def restored(self, record: Any, progress: Progress) -> T:
        """Return the outcome from its record.

        Raises ValueError, KeyError, TypeError or AttributeError for a record that this case did not write.
        """
        raise TypeError(f"{type(self).__name__} keeps no outcomes")


def detached(case: Case[T]) -> tuple[tuple[Any, ...], Case[T]]:
    """Return the fields that a case shares with others, and the case without them."""
    empty: Any = dict.fromkeys(case.common)
    return tuple(getattr(case, name) for name in case.common), replace(cast(Any, case), **empty)


def attached(case: Case[T], common: tuple[Any, ...]) -> Case[T]:
    """Return a case with its shared fields restored, which were sent separately."""
    return replace(cast(Any, case), **dict(zip(case.common, common, strict=True)))


def computed(case: Case[T], progress: Progress) -> T:
    """Compute the outcome of a case; called in a worker process or on a cluster worker.

    An error in a user-defined block is raised as a FeeddriveError that names its line, since the traceback is lost
    between processes.
    """
    try:
        return case.outcome(progress)
    except FeeddriveError:
        raise
    except Exception as error:
        fault = fault_of_user_code(error)
        if fault is None:
            raise
        raise fault from error


def content_digest(*values: Any) -> str:
    """Return the SHA-256 (hex) of the content of values, with all numbers of blocks and the code of their classes.

    Raises TypeError for a value whose content cannot be digested, such as a function.
    """
    # another version may compute another outcome from the same fields
    content = hashlib.sha256(repr(versions()).encode())
    for value in values:
        for part in _content(value):
            content.update(part)
            # a separator: without it the pieces "ab", "c" would have the digest of "a", "bc"
            content.update(b"\0")
    return content.hexdigest()


def _content(value: Any) -> Iterator[bytes]:
    """Yield the content of a value in pieces, each marked with the type of the value."""
    if isinstance(value, Block):
        shape = tree.structure(value)
        yield repr(shape).encode()
        # sorted: the order of a set differs from process to process
        for kind in sorted(_classes(shape), key=lambda kind: kind.__qualname__):
            yield _source(kind)
        for name, leaf in (*tree.leaves(value), *tree.tables(value)):
            yield name.encode()
            yield np.asarray(leaf, dtype=np.float64).tobytes()
    elif isinstance(value, float):
        yield value.hex().encode()
    elif value is None or isinstance(value, bool | int | str | bytes | Path | Enum):
        yield f"{type(value).__name__} {value!r}".encode()
    elif isinstance(value, type):
        yield f"{value.__module__}.{value.__qualname__}".encode()
    elif isinstance(value, np.ndarray):
        array: np.ndarray[Any, Any] = value
        yield f"{array.dtype} {array.shape}".encode()
        yield array.tobytes()
    elif isinstance(value, Mapping):
        entries: Mapping[Any, Any] = value
        yield f"mapping {len(entries)}".encode()
        for key, entry in entries.items():
            yield from _content(key)
            yield from _content(entry)
    elif isinstance(value, tuple | list | range):
        row: Any = value
        yield f"row {len(row)}".encode()
        for entry in row:
            yield from _content(entry)
    elif is_dataclass(value) and not isinstance(value, type):
        yield f"{type(value).__module__}.{type(value).__qualname__}".encode()
        if type(value).__repr__ is not object.__repr__ and hasattr(value, "key"):
            # a Figure: its functions cannot be digested, but its key identifies it
            yield repr(value).encode()
            return
        for field in fields(value):
            yield field.name.encode()
            yield from _content(getattr(value, field.name))
    else:
        raise TypeError(f"a {type(value).__name__} has no content that a digest can be made of")


def _classes(shape: Any) -> set[type[Block]]:
    """Return the classes of the blocks in a structure."""
    if isinstance(shape, type):
        return {shape} if issubclass(shape, Block) else set()
    return set[type[Block]]().union(*map(_classes, shape)) if isinstance(shape, tuple) else set()


@cache
def _source(kind: type[Block]) -> bytes:
    """Return the source code of a class, which may change while a law is developed; empty if unavailable."""
    try:
        # a class typed into an interpreter or a notebook has no file to read
        return inspect.getsource(kind).encode()
    except (OSError, TypeError):
        return b""
