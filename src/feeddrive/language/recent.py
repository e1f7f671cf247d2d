"""A bounded cache: the least recently used entries are dropped."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import Generic, TypeVar

Value = TypeVar("Value")


class Recent(Generic[Value]):
    """A cache of up to `size` values by hashable key; when it is full, the least recently used value is dropped.

    A key must contain everything on which the value depends, but not the id of an object: another object may get the
    same id later.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._held: OrderedDict[Hashable, Value] = OrderedDict()
        self._lock = Lock()

    def __len__(self) -> int:
        return len(self._held)

    def get(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return the value of a key, created by `make` on a miss. If two threads create it, the first value is kept."""
        with self._lock:
            if key in self._held:
                self._held.move_to_end(key)
                return self._held[key]
        # not under the lock: what takes long to make must not keep other keys waiting
        value = make()
        with self._lock:
            kept = self._held.setdefault(key, value)
            self._held.move_to_end(key)
            while len(self._held) > self.size:
                self._held.popitem(last=False)
            return kept
