"""Every numeric constant of a module has a test that notices when it is halved or doubled, or a reason why none can.

`tests/constants.json` says which; `make mutate` runs them against the changed constants.
"""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from functools import cache

from constant_mutants import CHANGES, LEDGER, TESTS, all_constants

ROWS = json.loads(LEDGER.read_text(encoding="utf-8"))


@cache
def functions(file: str) -> frozenset[str]:
    """The names of the tests in a file."""
    tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
    return frozenset(node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))


def changes() -> Iterator[tuple[str, str, str, dict[str, str]]]:
    """Module, name, change and entry of each change of a constant."""
    for constant in all_constants():
        entry = ROWS.get(constant.module, {}).get(constant.name, {})
        for change in CHANGES:
            if constant.changed(change) is not None:
                yield constant.module, constant.name, change, entry


def test_each_changed_constant_has_a_test_or_a_reason() -> None:
    missing = [
        f"{module}.{name}, {change}"
        for module, name, change, entry in changes()
        if not {change, f"{change} reason", "reason"} & entry.keys()
    ]
    assert not missing, "add a test of what the number decides, then run tests/constant_mutants.py: " + "; ".join(
        missing
    )


def test_no_entry_is_of_a_constant_that_is_gone() -> None:
    there = {(constant.module, constant.name) for constant in all_constants()}
    gone = [f"{module}.{name}" for module, rows in ROWS.items() for name in rows if (module, name) not in there]
    assert not gone, "; ".join(gone)


def test_the_tests_that_are_named_exist() -> None:
    named = {test for rows in ROWS.values() for entry in rows.values() for key, test in entry.items() if key in CHANGES}
    gone = []
    for test in sorted(named):
        file, _, name = test.partition("::")
        if not (TESTS / file).is_file() or name.rpartition("::")[2].partition("[")[0] not in functions(file):
            gone.append(test)
    assert not gone, "; ".join(gone)
