"""All figures that a study can measure, by name.

    statistics  of signals over the whole run, gathered while a batch of variants runs: cheapest
    model       the linear model of the loop of one variant
    run         the signals of one variant over time

The figures of feeddrive stand in `run_figures.py` and `model_figures.py`; an installed package adds its own by an entry
point of the group `feeddrive.figures`, and `--allow MODULE` those of a module: each is a `Figure`, or a list of them.
What a study file says never imports anything.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from feeddrive.blocks.catalogue import module_at
from feeddrive.language.errors import ParameterError, nearest
from feeddrive.study.figure import Figure
from feeddrive.study.model_figures import OF_MODELS, at_frequency
from feeddrive.study.run_figures import OF_RUNS

ENTRY_POINTS = "feeddrive.figures"  # group of the entry points of packages with figures


def figures(allow: Sequence[str] = ()) -> Mapping[str, Figure]:
    """By name the figures of feeddrive, of installed packages, and of modules that a person allows.

    Raises ParameterError for a module that cannot be imported or holds no figure, and for a name that two have.
    """
    return _with_own(tuple(allow))


def figure(name: str, allow: Sequence[str] = ()) -> Figure:
    """The figure of a name, with a frequency in it or not. Raises ParameterError with near names."""
    known = figures(allow)
    found = known.get(name) or at_frequency(name)
    if found is None:
        raise ParameterError(
            f"there is no figure '{name}'{nearest(name, known)}; stiffness_F_Hz_N_per_m is there for every frequency "
            "F; one of your own is found by --allow MODULE, or once its package is installed"
        )
    return found


@cache
def _with_own(allow: tuple[str, ...]) -> Mapping[str, Figure]:
    found = {each.name: each for each in (*OF_RUNS, *OF_MODELS)}
    for origin, each in (*_installed(), *_allowed(allow)):
        if found.setdefault(each.name, each) is not each:
            raise ParameterError(f"{origin}: there is a figure '{each.name}' already: give it another name")
    return found


def _installed() -> Iterator[tuple[str, Figure]]:
    from importlib.metadata import entry_points

    for point in sorted(entry_points(group=ENTRY_POINTS), key=lambda each: (each.name, each.value)):
        package = point.dist.name if point.dist is not None else point.name
        origin = f"the installed package '{package}' (mend or uninstall it)"
        for each in _held(origin, point.value):
            yield origin, each


def _allowed(places: Iterable[str]) -> Iterator[tuple[str, Figure]]:
    for place in places:
        for each in _held(f"--allow names '{place}'", place):
            yield f"--allow {place}", each


def _held(origin: str, place: str) -> list[Figure]:
    """The figures at a place: a module, FILE.py, or MODULE:NAME of a figure or a list of them."""
    try:
        held, name = module_at(place)
        found = getattr(held, name) if name else [each for each in vars(held).values() if isinstance(each, Figure)]
    except Exception as error:
        raise ParameterError(f"{origin}: it cannot be imported: {type(error).__name__}: {error}") from None
    made: list[Any] = [found] if isinstance(found, Figure) else list(found) if isinstance(found, Iterable) else []
    if not made or not all(isinstance(each, Figure) for each in made):
        raise ParameterError(f"{origin}: it holds no feeddrive.study.Figure, or not only such")
    return made
