"""READMEs of exports: the Jinja2 templates of `templates/`, filled as plain text.

A template that names what it was not given is an error; nothing is escaped but `|` in a cell of a table, by the filter
`cell`.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from feeddrive.export.design import CONTROL, Design
from feeddrive.loop.guard import TRIPS

if TYPE_CHECKING:
    from jinja2 import Environment


def readme(template: str, design: Design, **content: Any) -> str:
    """The README of a design in Markdown. Pure: the same content gives the same text.

    template  a file of `templates/`; beside `content` it has `design`, `routine`, `P` (the prefix of all names),
              `title`, `made_by`, `control` (true for a control, false for an axis) and `trips`
    """
    return (
        _environment()
        .get_template(template)
        .render(
            design=design,
            routine=design.routine,
            P=design.name,
            title=design.title,
            made_by=design.made_by,
            control=design.what == CONTROL,
            trips=TRIPS,
            **content,
        )
    )


@cache
def _environment() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("feeddrive.export"),
        autoescape=False,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters["cell"] = _cell
    return made


def _cell(text: str) -> str:
    """A text for a cell of a table in Markdown."""
    return text.replace("|", "\\|")
