"""The page of a report: structure and text; `page.css` has its looks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files

from feeddrive.language.errors import ParameterError
from feeddrive.report import tables, words
from feeddrive.report.content import Shown, Study
from feeddrive.report.figures import chosen, figures
from feeddrive.report.svg import svg

# nothing may be loaded, run or sent: a report is read on machines that belong to somebody else
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"

# control characters, which no page may hold, apart from the ends of lines and tabs
_CONTROL = dict.fromkeys([*range(9), *range(11, 32), *range(127, 160)])


def build(study: Study) -> str:
    """The report as one HTML page: no scripts, no other files, less than 1 MB.

    Pure: the same study gives the same text.  Raises ParameterError for a study without entries.
    """
    if not study.entries:
        raise ParameterError("a report needs at least one law")
    drawn = [*study.pictures, *figures(study)]
    parts = [
        _header(study, drawn),
        _result(study),
        _facts(study),
        _pictures(study, drawn),
        _repeat(study),
    ]
    return page(study.title, parts)


def page(title: str, parts: Sequence[str]) -> str:
    """Sections as one page with the looks of a report: no scripts, no other files."""
    sheet = files("feeddrive.report").joinpath("page.css").read_text(encoding="utf-8")
    whole = (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta name="color-scheme" content="light dark">\n<title>{escape(title)}</title>\n<style>\n{sheet}</style>\n'
        f"</head>\n<body>\n<main>\n{''.join(parts)}</main>\n</body>\n</html>\n"
    )
    return whole.translate(_CONTROL)


def header(kind: str, title: str, lead: Sequence[str], links: Sequence[tuple[str, str]]) -> str:
    """Headline, the result in sentences, and links to what follows: (identifier, text)."""
    said = "".join(f"<p>{escape(sentence)}</p>" for sentence in lead)
    listed = "".join(f'<li><a href="#{key}">{escape(text)}</a></li>' for key, text in links)
    return (
        f'<header>\n<p class="kind">{escape(kind)}</p>\n<h1>{escape(title)}</h1>\n'
        f'<div class="lead">{said}</div>\n<nav aria-label="contents"><ul>{listed}</ul></nav>\n</header>\n'
    )


def definitions(pairs: Iterable[tuple[str, str]]) -> str:
    """A list of headlines and texts."""
    listed = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in pairs)
    return f"<dl>{listed}</dl>"


def picture(shown: Shown) -> str:
    """A picture with its headline and how to read it."""
    return (
        f'<figure id="figure-{shown.key}">\n<h3>{escape(shown.title)}</h3>\n'
        f"{svg(shown.draw(), shown.key, shown.alt)}\n"
        f"<figcaption>{escape(shown.caption)}</figcaption>\n</figure>\n"
    )


def _header(study: Study, drawn: list[Shown]) -> str:
    links = [("result", "Result"), ("facts", "What was run"), *((f"figure-{s.key}", s.title) for s in drawn)]
    links.append(("repeat", "How to repeat it"))
    return header("feeddrive report", study.title, words.result(study), links)


def _result(study: Study) -> str:
    replay = next((entry.replay for entry in study.entries if entry.replay is not None), None)
    shown = [tables.prediction(replay)] if replay is not None else []
    shown += [tables.extra(each) for each in study.extras]
    shown += [tables.errors(study), f"<p>{escape(tables.limits(study))}</p>", tables.frequency(study)]
    said = "".join(f"<li>{escape(remark)}</li>" for remark in words.remarks(study))
    remarks = f'<div class="remarks"><h3>Remarks</h3><ul>{said}</ul></div>' if said else ""
    return f'<section id="result">\n<h2>Result</h2>\n{"".join(shown)}{remarks}\n</section>\n'


def _facts(study: Study) -> str:
    pairs = [*study.facts.items(), *((f"Law '{entry.name}'", entry.description) for entry in study.entries)]
    if study.rule:
        pairs.append(("Rule of comparison", study.rule))
    return f'<section id="facts">\n<h2>What was run</h2>\n{definitions(pairs)}\n</section>\n'


def _pictures(study: Study, drawn: list[Shown]) -> str:
    all_laws, shown_laws = len(study.entries), len(chosen(study).entries)
    note = ""
    if shown_laws < all_laws:
        note = f"<p>The pictures show {shown_laws} of {all_laws} laws: the first, and those that follow best.</p>"
    made = [picture(shown) for shown in drawn]
    return f'<section id="pictures">\n<h2>Pictures</h2>\n{note}{"".join(made)}</section>\n'


def _repeat(study: Study) -> str:
    parts = ["<p>The same job, with the same versions and seed, gives the same numbers to the last bit.</p>"]
    if study.job:
        parts.append(f"<h3>Job</h3><pre>{escape(study.job)}</pre>")
    if study.versions:
        rows = [[name, version] for name, version in study.versions.items()]
        parts.append(tables.table("Versions.", ["of", "version"], rows))
    parts.append(f"<details><summary>All parameters</summary>{tables.parameters(study)}</details>")
    return f'<section id="repeat">\n<h2>How to repeat it</h2>\n{"".join(parts)}\n</section>\n'
