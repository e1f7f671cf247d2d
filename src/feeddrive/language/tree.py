"""Trees of named numbers: blocks with parts, named tuples of states, plain tuples.

`leaves`, `rebuild`, `tables` and `structure` name a leaf by its fields: `law.Kv` in a `Control`, `control.law.Kv` in a
loop.  `parameters`, `get`, `vary` and `declaration` use paths, the names of machine files: a loop places its axis
under `axis.x`, so its gain is `axis.x.control.law.Kv` in Python as in TOML, logs, sweeps and gradients.  Outside
a loop, the path of a parameter of a single block is its dotted field name.
"""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, TypeVar, cast
from weakref import WeakKeyDictionary

import numpy as np

from feeddrive.language import ops
from feeddrive.language.block import (
    STRUCTURE,
    Block,
    Declaration,
    Number,
    Rule,
    check_tree,
    checked,
    declarations,
    enforce,
)
from feeddrive.language.errors import ParameterError, StructureError, nearest
from feeddrive.language.recent import Recent
from feeddrive.language.ring import Ring

Tree = TypeVar("Tree")


@cache
def _walked(block: type[Block]) -> tuple[tuple[str, bool], ...]:
    """Return the fields of a block class that tree traversal visits, with a flag for inline parts."""
    held = {name: declared for name, declared in declarations(block).items() if declared.role in ("parameter", "part")}
    return tuple((name, declared.inline) for name, declared in held.items())


@cache
def _fields(block: type[Block]) -> tuple[tuple[str, str], ...]:
    """Return all fields of a block class with their roles."""
    return tuple((name, declared.role) for name, declared in declarations(block).items())


def _children(tree: Any) -> Iterator[tuple[str, Any]]:
    """Yield names and values of the direct children: parameters and parts of a block (no choices), or tuple items."""
    if isinstance(tree, Block):
        for name, _ in _walked(type(tree)):
            yield name, getattr(tree, name)
    elif isinstance(tree, tuple):
        names = getattr(tree, "_fields", None) or map(str, range(len(tree)))
        yield from zip(names, tree, strict=True)


def _path(tree: Any, prefix: str, name: str) -> str:
    """Return the dotted name of a child; an inline part takes the name of the enclosing block."""
    if isinstance(tree, Block) and declarations(type(tree))[name].inline:
        return prefix
    return f"{prefix}.{name}" if prefix else name


def leaves(tree: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Return the dotted name and value of every leaf, in a fixed order; None is not a leaf."""
    leaves_: list[tuple[str, Any]] = []
    _collect(tree, prefix, leaves_)
    return iter(leaves_)


def _collect(tree: Any, prefix: str, collected: list[tuple[str, Any]]) -> None:
    """Append the leaves of a tree to a list, which is much faster than a generator for each block."""
    if isinstance(tree, Block):
        for name, inline in _walked(type(tree)):
            child = getattr(tree, name)
            if child is not None:
                path = prefix if inline else f"{prefix}.{name}" if prefix else name
                if isinstance(child, (Block, tuple)):
                    _collect(child, path, collected)
                else:
                    collected.append((path, child))
    elif isinstance(tree, tuple):
        names = getattr(tree, "_fields", None) or range(len(tree))
        for name, child in zip(names, tree, strict=True):
            if child is not None:
                _collect(child, f"{prefix}.{name}" if prefix else str(name), collected)
    elif tree is not None:
        collected.append((prefix, tree))


def rebuild(tree: Tree, values: Iterator[Any]) -> Tree:
    """Copy a tree with new leaf values, given in the order of `leaves`, without running constructors or checks."""
    if isinstance(tree, Block):
        changed: dict[str, Any] = {}
        for name, _ in _walked(type(tree)):
            child = getattr(tree, name)
            if child is not None:
                changed[name] = rebuild(child, values) if isinstance(child, (Block, tuple)) else next(values)
        return _replaced(tree, changed)
    if isinstance(tree, tuple):
        children = [rebuild(child, values) for child in tree]  # type: ignore[reportUnknownVariableType]
        return type(tree)(*children) if hasattr(tree, "_fields") else tuple(children)  # type: ignore[return-value]
    return next(values) if tree is not None else cast(Tree, None)


def _replaced(block: Any, changed: Mapping[str, Any]) -> Any:
    copy = object.__new__(type(block))
    held = vars(copy)
    for name, _ in _fields(type(block)):
        held[name] = changed[name] if name in changed else getattr(block, name)
    return copy


def select(condition: Any, a: Tree, b: Tree) -> Tree:
    """Select between two states: every leaf of `a` where the condition is true, otherwise that of `b`."""
    left, right = [value for _, value in leaves(a)], [value for _, value in leaves(b)]
    return rebuild(a, (_either(condition, x, y) for x, y in zip(left, right, strict=True)))


def _either(condition: Any, a: Any, b: Any) -> Any:
    """Select between two leaves; of an existing and a new ring, keep the existing one: a reset does not clear cells."""
    if isinstance(a, Ring) and isinstance(b, Ring):
        if a.cells is not None and b.cells is not None and a is not b:
            raise StructureError("a choice between two rings: write to one ring and choose the value")
        return b if a.cells is None else a
    # the same leaf in both states needs no operation, in exports neither
    return a if a is b else ops.where(condition, a, b)


def cases(*pairs: tuple[Any, Any], otherwise: Any) -> Any:
    """Select the tree of the first (condition, tree) pair whose condition is true; all trees need the same leaves."""
    rows = [[value for _, value in leaves(choice)] for _, choice in pairs]
    chosen = [value for _, value in leaves(otherwise)]
    for (condition, _), row in zip(reversed(pairs), reversed(rows), strict=True):
        chosen = [_either(condition, x, y) for x, y in zip(row, chosen, strict=True)]
    return rebuild(pairs[0][1], iter(chosen))


def parameters(tree: Any) -> dict[str, Any]:
    """Return the value of every leaf by path (`axis.x.control.law.Kv`), in the order of `leaves`."""
    check_tree(tree)
    return {path: value for path, _, value in _placed(tree, "", "")}


def path_of(tree: Any, name: str) -> str:
    """Convert a dotted field name to a path: `control.law.Kv` of a loop -> `axis.x.control.law.Kv`."""
    first, dot, rest = name.partition(".")
    is_field = isinstance(tree, Block) and first in declarations(type(tree))
    return f"{tree.place_of(first)}{dot}{rest}" if is_field else name


def in_paths(block: Block, text: str) -> str:
    """Replace the dotted field names in a sentence, such as `control.law.Kp / control.law.Tn`, with paths."""
    fields = [field for field in declarations(type(block)) if block.place_of(field) != field]
    pattern = rf"(?<![\w.])({'|'.join(fields)})(?=\.\w)"
    return re.sub(pattern, lambda part: block.place_of(part[1]), text) if fields else text


def name_of(block: Any, path: str, names: Mapping[str, str] | None = None) -> str:
    """Convert the path of a leaf to its dotted field name. Raises ParameterError for an unknown path.

    names  the field names of all paths, if already known
    """
    names = names or {place: name for place, name, _ in _placed(block, "", "")}
    if path not in names:
        raise _unknown(block, path, list(names))
    return names[path]


def _placed(tree: Any, path: str, name: str) -> Iterator[tuple[str, str, Any]]:
    """Yield the path, dotted field name, and value of every leaf."""
    if isinstance(tree, (Block, tuple)):
        for field, child in _children(tree):
            if child is not None:
                yield from _placed(child, _place(tree, path, field), _path(tree, name, field))
    elif tree is not None:
        yield path, name, tree


def _unknown(block: Any, path: str, paths: list[str]) -> ParameterError:
    """Return the error for an unknown path; for a dotted field name its message gives the correct path."""
    if path_of(block, path) in paths:
        return ParameterError(f"'{path}' is written '{path_of(block, path)}', as in a machine file")
    return ParameterError(f"there is no parameter '{path}'{nearest(path_of(block, path), paths)}")


def declaration(block: Block, path: str, names: Mapping[str, str] | None = None) -> Declaration:
    """Return the declaration of a leaf, in the units of its axis. Raises ParameterError for an unknown path."""
    owner, last = _owner(block, path, names)
    return declarations(type(owner))[last].of_axis(bool(getattr(getattr(block, "axis", block), "rotary", False)))


def _owner(block: Block, path: str, names: Mapping[str, str] | None = None) -> tuple[Block, str]:
    *fields, last = name_of(block, path, names).split(".")
    owner: Any = block
    for field in fields:
        owner = _step(owner, field)
    return _holder(owner, last), last


def _holder(owner: Any, name: str) -> Any:
    """Return the block that declares a field: the owner, or one of its inline parts."""
    if not isinstance(owner, Block) or name in declarations(type(owner)):
        return owner
    inline = (getattr(owner, field) for field, declared in declarations(type(owner)).items() if declared.inline)
    return next(part for part in inline if name in declarations(type(part)))


def _step(owner: Any, name: str) -> Any:
    plain = isinstance(owner, tuple) and not hasattr(owner, "_fields")
    return owner[int(name)] if plain else getattr(_holder(owner, name), name)


def get(block: Block, path: str) -> Any:
    """Return the value of the leaf at a path. Raises ParameterError for an unknown path."""
    return getattr(*_owner(block, path))


def vary(block: Tree, changes: Mapping[str, Any]) -> Tree:
    """Copy a block with new values (numbers, or arrays over variants) at some paths; bounds are checked.

    fd.vary(loop, {"axis.x.control.law.Kv": 80.0})

    Raises ParameterError for an unknown path, a value out of bounds or arrays of unequal length, and if the block or
    one of the variants violates a rule; the message then gives the number of the variant.
    """
    check_tree(block)
    placed = list(_placed(block, "", ""))
    names = {path: name for path, name, _ in placed}
    values: dict[str, Any] = {}
    for name, value in changes.items():
        value = np.asarray(value, dtype=np.float64) if isinstance(value, (list, np.ndarray)) else value
        values[name] = checked("", name, declaration(block, name, names), value)  # type: ignore[arg-type]
    lengths = {name: value.size for name, value in values.items() if isinstance(value, np.ndarray)}
    if len(set(lengths.values())) > 1:
        shown = ", ".join(f"{name}: {length}" for name, length in lengths.items())
        raise ParameterError(f"arrays of variants must have one length, not {shown}")
    varied = rebuild(block, (values.get(path, value) for path, _, value in placed))
    _require(varied)
    return varied


def _require(block: Any) -> None:
    """Run all checks of a block and of its parts; error messages name a part by its path instead of its kind."""
    for path, part in _parts(block, ""):
        try:
            part.require()
        except (ParameterError, StructureError) as error:
            place = f"{path}." if path else ""
            # a block is checked under its kind; a user knows it by its path
            raise type(error)(re.sub(rf"(?<![\w.]){part.kind}\.(?=\w)", place, str(error))) from None


def _parts(tree: Any, path: str) -> Iterator[tuple[str, Block]]:
    """Yield the path and block of every block in a tree, outermost first."""
    if isinstance(tree, Block):
        yield path, tree
    for field, child in _children(tree):
        # a leaf has no parts, and its path would take as long to form as that of a block
        if isinstance(child, (Block, tuple)):
            yield from _parts(child, _place(tree, path, field))


def _place(tree: Any, path: str, field: str) -> str:
    """Return the path of a child, given the path of its parent."""
    place = tree.place_of(field) if isinstance(tree, Block) else field
    return _path(tree, path, field) if place == field else f"{path}.{place}" if path else place


def sampled_rules(tree: Any, T: Number) -> Iterator[Rule]:
    """Yield the sampled rules of every block in a tree at a sample time in s, outermost first."""
    return (rule for block in blocks(tree) for rule in block.sampled_rules(T))


def check_sampled(block: Block, sample_time: float) -> None:
    """Raise ParameterError for the first rule that a block or one of its parts violates at a sample time in s.

    A part that was checked at this sample time, in this or another block, is not checked again.
    """
    for part in blocks(block):
        if type(part).sampled_rules is Block.sampled_rules:
            continue
        # blocks do not change; a machine makes the loop of an axis from the same parts many times
        sound = _sound.setdefault(part, set())
        if sample_time not in sound:
            enforce(part, lambda plain: plain.sampled_rules(np.float64(sample_time)))
            sound.add(sample_time)


_sound = WeakKeyDictionary[Block, set[float]]()
"""The sample times, in s, at which the sampled rules of a block have been checked."""


def blocks(tree: Any) -> Iterator[Block]:
    """Yield every block in a tree, outermost first."""
    return (part for _, part in _parts(tree, ""))


def tables(tree: Any, prefix: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Return the dotted name and values of every table in a tree."""
    rows: list[tuple[str, np.ndarray]] = []
    _collect_tables(tree, prefix, rows)
    return iter(rows)


def _collect_tables(tree: Any, prefix: str, collected: list[tuple[str, np.ndarray]]) -> None:
    """Append the tables of a tree to a list."""
    if isinstance(tree, Block):
        fields = _fields(type(tree))
        for name, role in fields:
            if role == "table" and getattr(tree, name) is not None:
                collected.append((_path(tree, prefix, name), getattr(tree, name)))
        for name, role in fields:
            if role == "part" and getattr(tree, name) is not None:
                _collect_tables(getattr(tree, name), _path(tree, prefix, name), collected)
    elif isinstance(tree, tuple):
        for name, child in _children(tree):
            if isinstance(child, (Block, tuple)):
                _collect_tables(child, _path(tree, prefix, name), collected)


def with_tables(tree: Tree, replacements: Mapping[str, Any], prefix: str = "") -> Tree:
    """Copy a tree and replace the tables with the given dotted names; checks are not run."""
    if isinstance(tree, Block):
        changed: dict[str, Any] = {}
        for name, declared in declarations(type(tree)).items():
            path = _path(tree, prefix, name)
            if declared.role == "table" and path in replacements:
                changed[name] = replacements[path]
            elif declared.role == "part":
                changed[name] = with_tables(getattr(tree, name), replacements, path)
        return _replaced(tree, changed)
    if isinstance(tree, tuple):
        items = [with_tables(child, replacements, _path(tree, prefix, name)) for name, child in _children(tree)]
        return type(tree)(*items) if hasattr(tree, "_fields") else tuple(items)  # type: ignore[return-value]
    return tree


def structure(tree: Any) -> Any:
    """Return a hashable key that determines the graph of a tree: types, choices, present leaves and table lengths."""
    return structure_and_values(tree)[0]


def structure_and_values(tree: Any) -> tuple[Any, list[Any]]:
    """Return the structure of a tree, and all leaves and tables in field order; callers must not modify the list.

    A block caches both, since it is immutable.
    """
    kept = vars(tree).get(STRUCTURE) if isinstance(tree, Block) else None
    if kept is None:
        values: list[Any] = []
        shape = Shape((_shape(tree, values),))
        # equal structures are one object, so that dictionaries compare them by identity
        kept = _shapes.get(shape, lambda: shape), values
        if isinstance(tree, Block):
            vars(tree)[STRUCTURE] = kept
    return kept


class Shape(tuple[Any, ...]):
    """A structure for use as a dictionary key; its hash is cached, and equal structures share one object."""

    _hash: int | None = None

    def __hash__(self) -> int:
        if self._hash is None:
            self._hash = super().__hash__()
        return self._hash


_shapes: Recent[Shape] = Recent(256)


def _shape(tree: Any, values: list[Any]) -> Any:
    """Return the structure of a tree, and append its leaves and tables to the list `values`."""
    if isinstance(tree, Block):
        shape: list[Any] = [type(tree)]
        for name, role in _fields(type(tree)):
            value = getattr(tree, name)
            if role == "parameter":
                shape.append(value is None)
                if value is not None:
                    values.append(value)
            elif role == "part":
                shape.append(True if value is None else _shape(value, values))
            elif role == "choice":
                shape.append(value)
            elif role == "table":
                shape.append(None if value is None else len(value))
                if value is not None:
                    values.append(value)
        return tuple(shape)
    if isinstance(tree, tuple):
        return (type(tree), *[_shape(child, values) for child in tree])  # type: ignore[reportUnknownVariableType]
    if tree is not None:
        values.append(tree)
    return tree is None


def difference(a: Any, b: Any, prefix: str = "") -> str | None:
    """Describe the first structural difference between two trees; return None if only numbers differ."""
    if isinstance(a, Block) and type(a) is type(b):
        for name, declared in declarations(type(a)).items():
            path = _path(a, prefix, name)
            old, new = getattr(a, name), getattr(b, name)
            if declared.role == "part":
                place = difference(old, new, path)
                if place is not None:
                    return place
            elif declared.role == "choice" and old != new:
                return f"{path} would go from {old!r} to {new!r}"
            elif (old is None) != (new is None):
                return f"{path} would {'come in' if old is None else 'be left out'}"
            elif declared.role == "table" and old is not new and not np.array_equal(old, new):
                return f"the table {path} would change"
        return None
    if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
        pairs = (difference(x, y, f"{prefix}.{i}") for i, (x, y) in enumerate(zip(a, b, strict=True)))
        return next((place for place in pairs if place is not None), None)
    return None if a is None and b is None else f"{prefix} would go from {_kind(a)} to {_kind(b)}"


def _kind(tree: Any) -> str:
    if isinstance(tree, tuple):
        return f"{len(tree)} blocks"
    return "nothing" if tree is None else tree.kind
