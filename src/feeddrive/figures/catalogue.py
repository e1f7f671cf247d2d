"""All figures by key, and those that a tuning can optimize or limit.

The figures of feeddrive are entries of `of_loops.py` and `of_runs.py`. An installed package adds its own figures by
entry points of the group `feeddrive.figures`, and `--allow MODULE` adds those of a module. An entry point or
MODULE:NAME names a `Figure` or a list of them. A study file itself never triggers an import.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from feeddrive.blocks.catalogue import installed_points, module_at
from feeddrive.figures.figure import DUTY, Figure
from feeddrive.figures.of_loops import OF_LOOPS, at_frequency
from feeddrive.figures.of_runs import OF_RUNS
from feeddrive.language.errors import ParameterError, nearest

ENTRY_POINTS = "feeddrive.figures"  # entry-point group of packages with figures


def figures(allow: Sequence[str] = ()) -> Mapping[str, Figure]:
    """Return the figures of feeddrive, of installed packages and of modules that the user allows, by key.

    Raises ParameterError for a module that cannot be imported or contains no figure, and for a duplicate name.
    """
    return _with_own(tuple(allow))


@cache
def goals() -> Mapping[str, Figure]:
    """Return the figures that a tuning can optimize, by the name of the goal."""
    return {figure.goal.name: figure for figure in figures().values() if figure.goal is not None}


@cache
def limitable() -> tuple[Figure, ...]:
    """Return the figures that a tuning can limit."""
    return tuple(figure for figure in figures().values() if figure.limit is not None)


def measurable(allow: Sequence[str] = ()) -> Mapping[str, Figure]:
    """Return the figures that a study can measure, by key."""
    return {key: figure for key, figure in figures(allow).items() if figure.needs != DUTY}


def figure(name: str, allow: Sequence[str] = ()) -> Figure:
    """Return the figure that a study measures under a name. Raise ParameterError, which suggests names, if unknown."""
    candidates = measurable(allow)
    figure_ = candidates.get(name) or at_frequency(name)
    if figure_ is None:
        raise ParameterError(
            f"there is no figure '{name}'{nearest(name, candidates)}; stiffness_F_Hz_N_per_m is there for every "
            "frequency F; one of your own is found by --allow MODULE, or once its package is installed"
        )
    return figure_


@cache
def _with_own(allow: tuple[str, ...]) -> Mapping[str, Figure]:
    by_key = {shipped.key: shipped for shipped in (*OF_RUNS, *OF_LOOPS)}
    for origin, added in (*_installed(), *_allowed(allow)):
        if by_key.setdefault(added.key, added) is not added:
            raise ParameterError(f"{origin}: there is a figure '{added.key}' already: give it another name")
    return by_key


def _installed() -> Iterator[tuple[str, Figure]]:
    for point in installed_points(ENTRY_POINTS):
        package = point.dist.name if point.dist is not None else point.name
        origin = f"the installed package '{package}' (mend or uninstall it)"
        for member in _held(origin, point.value):
            yield origin, member


def _allowed(places: Iterable[str]) -> Iterator[tuple[str, Figure]]:
    for place in places:
        for member in _held(f"--allow names '{place}'", place):
            yield f"--allow {place}", member


def _held(origin: str, place: str) -> list[Figure]:
    """Import and return the figures in a module or FILE.py, or the figure or list of figures named by MODULE:NAME."""
    try:
        held, name = module_at(place)
        members = getattr(held, name) if name else [value for value in vars(held).values() if isinstance(value, Figure)]
    # importing runs code of other people, which can raise anything
    except Exception as error:
        raise ParameterError(f"{origin}: it cannot be imported: {type(error).__name__}: {error}") from None
    listed: list[Any] = (
        [members] if isinstance(members, Figure) else list(members) if isinstance(members, Iterable) else []
    )
    if not listed or not all(isinstance(figure, Figure) for figure in listed):
        raise ParameterError(f"{origin}: it holds no feeddrive.figures.Figure, or not only such")
    return listed
