"""Random parameters inside and outside of their rules, and what Python says of them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np

import feeddrive as fd
from feeddrive.language import tree
from feeddrive.language.block import Declaration, Rule, enforce
from feeddrive.language.errors import FeeddriveError
from feeddrive.language.graph import reachable
from feeddrive.loop.routine import Routine, Variable

FACTORS = (3.0, 1 / 3.0, -3.0, 30.0, 1 / 30.0, 1e3, 1e-3, 1e6, 1e-6, 1e12, 1e-12)
BROKEN = (np.nan, np.inf, -np.inf, 0.0, -1.0, 1e300, 1e-300)


def cases(routine: Routine, count: int, seed: int) -> Iterator[dict[str, float]]:
    """`count` sets of other parameters by dotted name: some near the old ones, some far, some no number at all."""
    random = np.random.default_rng(seed)
    yield {}
    for _ in range(count - 1):
        size = int(min(len(routine.parameters), random.integers(1, 4)))
        changed: dict[str, float] = {}
        for i in random.choice(len(routine.parameters), size=size, replace=False):
            variable = routine.parameters[int(i)]
            bounds = [getattr(variable.declared, side) for side in ("above", "least", "below", "most")]
            kind = random.random()
            if kind < 0.1:
                value = float(random.choice(np.array(BROKEN)))
            elif kind < 0.2 and any(bound is not None for bound in bounds):
                value = float(next(bound for bound in bounds if bound is not None))  # the bound itself
            elif kind < 0.6:
                value = variable.value * float(random.uniform(0.5, 1.5))
            else:
                value = (variable.value or 1.0) * float(10.0 ** random.uniform(-2.5, 2.5))
            changed[variable.path] = value
        yield changed


def refused(routine: Routine, changed: Mapping[str, float]) -> bool:
    """Whether Python refuses these parameters in the loop that is exported."""
    loop: fd.Loop = routine.origin
    try:
        after = tree.vary(loop, changed)
    except FeeddriveError:
        return True
    # an axis is exported with a number of samples of dead time; with another one it would be another program
    return routine.memory == "plant" and after.timing() != loop.timing()


def broken_rules(loop: fd.Loop) -> list[str]:
    """The sentences of the rules between parameters that a loop breaks, computed as its constructor computes them."""
    found: list[str] = []

    def collect(plain: fd.Loop) -> tuple[Rule, ...]:
        found.extend(rule.sentence for block in tree.blocks(plain) for rule in block.rules() if not rule.holds)
        return ()

    enforce(loop, collect)
    return found


def explained(routine: Routine, changed: Mapping[str, float], code: int) -> bool:
    """Whether a code is that of the first bound, or of a rule, that Python finds broken; 0 if none is."""
    for place, variable in enumerate(routine.parameters, 1):
        assert variable.declared is not None
        if variable.path in changed and not variable.declared.admits(changed[variable.path]):
            return code == place
    loop: fd.Loop = routine.origin
    broken = broken_rules(_varied(loop, changed))
    if code == 0:
        return not broken
    return any(routine.sentences[code].endswith(each) for each in broken) or "dead_time" in routine.sentences[code]


def _varied(loop: fd.Loop, changed: Mapping[str, float]) -> fd.Loop:
    """A loop with other parameters, not checked."""
    leaves = ((tree.path_of(loop, name), old) for name, old in tree.leaves(loop))
    return tree.rebuild(loop, (changed.get(path, old) for path, old in leaves))


def one_for_each_rule(routine: Routine, changeable: Collection[str]) -> dict[int, dict[str, float]]:
    """By code: parameters that break one condition of a routine, where changing one of `changeable` can.

    A bound is broken by the value next to it, or by NaN where a parameter has none.
    """
    found: dict[int, dict[str, float]] = {}
    bounds = len(routine.parameters)
    for code, variable in enumerate(routine.parameters, 1):
        if variable.path in changeable:
            found[code] = {variable.path: _outside(variable.declared)}
    for code, condition in enumerate(routine.conditions[bounds:], bounds + 1):
        below = set(reachable(routine.graph, [condition.node]))
        for variable in (each for each in routine.parameters if each.node in below and each.path in changeable):
            changed = _breaking(routine, variable, condition.sentence)
            if changed:
                found[code] = changed
                break
    return found


def _outside(declared: Declaration | None) -> float:
    assert declared is not None
    if declared.above is not None:
        return declared.above
    if declared.below is not None:
        return declared.below
    if declared.least is not None:
        return float(np.nextafter(declared.least, -np.inf)) if declared.least else -1e-9
    return np.nan if declared.most is None else float(np.nextafter(declared.most, np.inf))


def _breaking(routine: Routine, variable: Variable, sentence: str) -> dict[str, float]:
    """A change of one parameter within its bounds that breaks a rule, no other before it if it can be; else none."""
    loop: fd.Loop = routine.origin
    behind: dict[str, float] = {}
    for value in (*((variable.value or 1.0) * factor for factor in FACTORS), _beyond_control(loop, variable)):
        assert variable.declared is not None
        if not variable.declared.admits(value):
            continue
        varied = _varied(loop, {variable.path: value})
        broken = broken_rules(varied)
        if not broken and routine.memory == "plant" and varied.timing() != loop.timing() and "dead_time" in sentence:
            return {variable.path: value}
        if any(sentence.endswith(each) for each in broken[:1]):
            return {variable.path: value}
        if any(sentence.endswith(each) for each in broken):
            behind = behind or {variable.path: value}
    return behind


def _beyond_control(loop: fd.Loop, variable: Variable) -> float:
    """The friction of a guideway at which the screw's force does not reach one motion: k m / c (`controllable`)."""
    law: Any = loop.control.law
    if not variable.path.endswith("law.model.viscous_load"):
        return np.nan
    return float(law.model.stiffness * law.model.mass_load / law.model.damping)
