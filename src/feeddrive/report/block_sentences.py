"""Blocks and controls in sentences, for reports."""

from __future__ import annotations

from feeddrive.language.block import Block, declarations
from feeddrive.loop.control import Control


def block_sentence(block: Block) -> str:
    """A block by its kind, the parameters that are there, and its parts in brackets."""
    declared = declarations(type(block))
    values = {name: getattr(block, name) for name in declared}
    given = [
        f"{name.replace('_', ' ')} {value:.6g} {declared[name].unit}".rstrip()
        for name, value in values.items()
        if isinstance(value, float)
    ]
    parts = [
        f"({block_sentence(part)})"
        for value in values.values()
        for part in (value if isinstance(value, tuple) else (value,))
        if isinstance(part, Block)
    ]
    return f"{block.kind.replace('_', ' ')}: {', '.join([*given, *parts])}"


def described(control: Control) -> str:
    """What a control consists of, part by part, with the parameters that are there."""
    parts = [block_sentence(control.law)]
    parts += [f"compensation {block_sentence(block)}" for block in control.compensation]
    parts += [f"filter {block_sentence(block)}" for block in control.filters]
    parts += [f"feedforward {block_sentence(block)}" for block in control.feedforward]
    if control.prefilter is not None:
        parts.append(f"prefilter {block_sentence(control.prefilter)}")
    if control.force_limit is not None:
        parts.append(f"limit {control.force_limit:.4g} N")
    return "; ".join(parts)
