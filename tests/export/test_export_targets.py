"""The targets of exports: what the command asks for is what their functions take."""

from __future__ import annotations

import inspect
from importlib import import_module

import pytest

from feeddrive.export.targets import OPTIONS, TARGETS
from feeddrive.workflow.command import fields_of
from feeddrive.workflow.export import ExportRequest

FIELDS = {field.name: field for field in fields_of(ExportRequest)}


@pytest.mark.parametrize("name", TARGETS)
def test_a_target_lists_the_options_that_its_function_takes(name: str) -> None:
    target = TARGETS[name]
    function = getattr(import_module(f"feeddrive.export.{target.module}"), target.function)
    assert {*target.options, *target.fixed} <= inspect.signature(function).parameters.keys()
    assert set(target.options) <= OPTIONS.keys()
    assert name in FIELDS["target"].help().lower().replace(",", "").rstrip(".").split()


@pytest.mark.parametrize("name", OPTIONS)
def test_an_option_of_targets_is_one_of_the_command(name: str) -> None:
    field = FIELDS[OPTIONS[name].asked or name]
    takers = [target for target, entry in TARGETS.items() if name in entry.options]
    assert field.help().lower().startswith(f"{', '.join(takers)}: {OPTIONS[name].meaning}".lower())
    assert not field.required
