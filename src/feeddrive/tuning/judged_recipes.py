"""The rules of the trade side by side on an axis: what each gives, and whether it keeps the limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from feeddrive.language.errors import FeeddriveError
from feeddrive.loop.control import Control
from feeddrive.loop.loop import Loop
from feeddrive.tuning.recipes import RECIPES, Recipe
from feeddrive.tuning.shaping.control_response import ControlResponse
from feeddrive.tuning.shaping.criteria import Criteria
from feeddrive.tuning.shaping.figures import Figures, figures
from feeddrive.tuning.shaping.limits import Limits
from feeddrive.tuning.shaping.site import Site, modelled_site


@dataclass(frozen=True, eq=False)
class JudgedRecipe:
    """A rule with its law and the figures at every site; without a law the reason why the rule gives none."""

    name: str
    recipe: Recipe | None
    figures: tuple[Figures, ...]
    reason: str


def judged_recipes(
    sites: Sequence[Site | Loop],
    control: Control,
    limits: Limits,
    step: Callable[[str], None] | None = None,
    velocity: float = 0.05,
) -> tuple[JudgedRecipe, ...]:
    """Every rule, read off at the first site with the filters of a control, and judged at all of them."""
    made = tuple(
        modelled_site(each, f"axis {i + 1}" if len(sites) > 1 else "model", velocity=velocity)
        if isinstance(each, Loop)
        else each
        for i, each in enumerate(sites)
    )
    found: list[JudgedRecipe] = []
    for name, rule in RECIPES.items():
        if step is not None:
            step(f"rule {name}")
        try:
            recipe = rule(made[0], control)
        except FeeddriveError as error:
            found.append(JudgedRecipe(name, None, (), str(error)))
            continue
        whole = replace(control, law=recipe.law, compensation=())
        response = ControlResponse(whole, made[0].sample_time, (), velocity)
        answers = Criteria(made, response, "stiffness", limits, (0.0, np.inf)).answers(np.zeros(0))
        found.append(
            JudgedRecipe(name, recipe, tuple(figures(each, limits.reading_noise) for each in answers), recipe.reason)
        )
    return tuple(found)
