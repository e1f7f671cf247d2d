"""Schedule and geometry of a path name what they compute with: no numbers for columns, no long lists of parameters."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import feeddrive.path

MOST = 12
FILES = [
    file
    for room in ("geometry", "schedule")
    for file in sorted((Path(feeddrive.path.__file__).parent / room).glob("*.py"))
]


def _literal(node: ast.expr) -> bool:
    """Return True for a whole number, as written or with a sign."""
    node = node.operand if isinstance(node, ast.UnaryOp) else node
    return isinstance(node, ast.Constant) and type(node.value) is int


def numbered(tree: ast.AST, numbers: set[str]) -> Iterator[ast.Subscript]:
    """Yield the subscripts by a whole number, or by a constant of the module that is one.

    Not the first and the last entry of a row or a tuple, nor slices.
    """
    for node in ast.walk(tree):
        if not isinstance(node, ast.Subscript):
            continue
        places = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        alone = len(places) == 1 and ast.unparse(places[0]) in ("0", "-1")
        named = any(isinstance(place, ast.Name) and place.id in numbers for place in places)
        if named or (any(map(_literal, places)) and not alone):
            yield node


def constants(tree: ast.Module) -> set[str]:
    """Return the names of whole numbers of a module, without ENDS: so many knots lie beyond either end of a spline."""
    names = set[str]()
    for node in tree.body:
        if isinstance(node, ast.Assign):
            values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
            targets = [
                each for target in node.targets for each in (target.elts if isinstance(target, ast.Tuple) else [target])
            ]
            names |= {
                each.id
                for each, value in zip(targets, values, strict=False)
                if isinstance(each, ast.Name) and _literal(value)
            }
    return names - {"ENDS"}


def test_columns_have_names_and_parameters_are_few() -> None:
    assert len(FILES) > 8
    for file in FILES:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        found = [f"{file.name}, line {node.lineno}: {ast.unparse(node)}" for node in numbered(tree, constants(tree))]
        assert not found
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                count = len(node.args.posonlyargs) + len(node.args.args) + len(node.args.kwonlyargs)
                assert count <= MOST, f"{file.name}: {node.name} has {count} parameters"


def test_a_number_of_a_column_is_found() -> None:
    text = "SPEED = 3\nA, B = 1, 2\nx = row[3] + row[SPEED] + row[k, 0] + row[B] + row[0] + row[-1]"
    text += " + row[k] + row[k + 1] + row[1:]"
    tree = ast.parse(text)
    found = [ast.unparse(node) for node in numbered(tree, constants(tree))]
    assert sorted(found) == ["row[3]", "row[B]", "row[SPEED]", "row[k, 0]"]
