"""`feeddrive new law NAME`: create a package with a user-defined law, its tests, and a machine file for trying it."""

from __future__ import annotations

import keyword
import re
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from feeddrive.blocks.catalogue import catalogue
from feeddrive.files.atomic_io import MARKER, new_directory
from feeddrive.language.block import snake_case
from feeddrive.language.errors import FileError, ParameterError
from feeddrive.language.progress import Progress
from feeddrive.workflow.command import OUT, Outcome, Request, argument, command, option

_TEMPLATES = files("feeddrive.workflow") / "templates" / "my_law"
# templates are stored as text, so that no tool of this package takes them for its own modules and tests
_SUFFIX = ".txt"


class NewRequest(Request):
    """The kind of package to create, and its name."""

    what: str = argument("What to make: law")
    name: str = argument("Its name, as in a machine file: smith_law, or SmithLaw")
    out: Path | None = option(OUT, short="-o", default=None)

    def check(self) -> None:
        """Raise ParameterError for an unknown kind, and for an invalid or existing name."""
        if self.what != "law":
            raise ParameterError(f"feeddrive new {self.what} is not known; there is: feeddrive new law NAME")
        kind = snake_case(self.name)
        if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", kind) or keyword.iskeyword(kind):
            raise ParameterError(
                f"'{self.name}' cannot be the name of a law: letters, digits and single _, a letter first, no word of "
                f"Python, as in smith_law"
            )
        # single letters are lost in CamelCase: a_b becomes AB, whose kind is ab
        if snake_case(_class(self.name)) != kind:
            raise ParameterError(
                f"'{self.name}' would be the class {_class(self.name)}, of another kind: take longer words"
            )
        for family, members in catalogue().items():
            if kind in members:
                raise ParameterError(
                    f"there is a {family.kind.replace('_', ' ')} of the kind '{kind}': take another name"
                )
        if find_spec(kind) is not None:
            raise ParameterError(f"Python already has a module '{kind}', which the law would hide: take another name")

    def usual_out(self) -> Path:
        return Path(snake_case(self.name))


@command(NewRequest)
def new(request: NewRequest, progress: Progress) -> Outcome[Path]:
    """Create a package for a user-defined law: its file, a test using the battery, a machine file and an entry point.

    The result is the directory. Raises FileError if it exists and is not empty: an existing law is never replaced.
    """
    kind = snake_case(request.name)
    out = request.out if request.out is not None else request.usual_out()
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise FileError(f"{out}: is there already, and a law is never replaced: take another name, or another --out")
    words = {
        "my_law": kind,
        "my-law": kind.replace("_", "-"),
        "my law": kind.replace("_", " "),
        "MyLaw": _class(request.name),
    }
    progress.step("files")
    written: dict[str, Path] = {}
    with new_directory(out) as folder:
        for template in sorted(_TEMPLATES.iterdir(), key=lambda template: template.name):
            name, text = template.name.removesuffix(_SUFFIX), template.read_text(encoding="utf-8")
            for word, own in words.items():
                name, text = name.replace(word, own), text.replace(word, own)
            (folder / name).write_text(text, encoding="utf-8")
            written[name] = out / name
    # the directory is the user's code from now on: without the marker no command replaces it
    (out / MARKER).unlink()
    here = out / f"{kind}.py"
    return Outcome(out, verdict=f"Write the equations into {here}, then follow {out / 'README.md'}.", files=written)


def _class(name: str) -> str:
    """Return the class name: as given, or in CamelCase if the name was given in snake_case."""
    return name if name != snake_case(name) else "".join(part[:1].upper() + part[1:] for part in name.split("_"))
