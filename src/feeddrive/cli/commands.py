"""The command line generated from the requests: every command, its arguments and options, and its output.

A command's module is imported when it is called or its `--help` is shown; `feeddrive --help` needs only the names.
"""

import inspect
import json
import sys
from collections.abc import Callable, Generator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from functools import cached_property
from glob import escape, glob
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from feeddrive.cli.terminal import UNBROKEN, TerminalProgress, open_console, show
from feeddrive.language import units
from feeddrive.language.errors import CancelledError, FeeddriveError
from feeddrive.language.table import visible
from feeddrive.language.text import Text, resolve
from feeddrive.workflow.command import COMMANDS, Command, Field, Listed, failure, fields_of, load

# interactive front ends, which are not commands with a result
SKINS = {
    "studio": Listed(
        "studio",
        "Open a page in the browser on which an axis is brought, tuned by hand or by goal, proven and exported.",
        "Tune and compare",
        ("", "--tour", "ball_screw", "run.csv", "mine.toml --axis x --no-browser --port 8765"),
    ),
}
OFFERED = {**COMMANDS, **SKINS}
STOPPED = CancelledError.exit_code


def offered(name: str) -> Command[Any, Any, Any]:
    """Return the command with this name."""
    if name not in SKINS:
        return load(name)
    from feeddrive.studio.command import studio  # not for `--help`

    return studio


class _Later(TyperCommand):
    """A command with its name and summary only; its module is imported when its options are needed."""

    @cached_property
    def real(self) -> Any:
        """The actual command."""
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=self.rich_markup_mode)
        examples = [f"feeddrive {self.name} {arguments}".rstrip() for arguments in OFFERED[str(self.name)].examples]
        epilog = "\n\n".join(["Example:" if len(examples) == 1 else "Examples:", *examples])
        app.command(self.name, help=self.help, epilog=epilog)(_function(offered(str(self.name))))
        return get_command(app)

    @property
    def params(self) -> Any:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The arguments and options."""
        return self.real.params

    @params.setter
    def params(self, _: Any) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Ignore the assignment: the parameters are those of the actual command."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Return the context of the actual command."""
        return self.real.make_context(*args, **kwargs)


class Commands(TyperGroup):
    """The group of all commands; help and usage errors appear in boxes on a terminal, and as plain lines elsewhere."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        mode = self.rich_markup_mode
        self.later = [
            _Later(name, help=command.summary, rich_help_panel=command.group, rich_markup_mode=mode)
            for name, command in OFFERED.items()
        ]
        self.commands = {str(command.name): command for command in self.later}

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the commands by group for plain output; on a terminal each group has its own panel."""
        for group in dict.fromkeys(command.group for command in OFFERED.values()):
            with formatter.section(group):
                formatter.write_dl(
                    [(name, command.summary) for name, command in OFFERED.items() if command.group == group]
                )

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run the command given by the arguments."""
        if not (sys.stdout.isatty() and sys.stderr.isatty()):
            # boxes and wrapped lines would hamper programs that read the output
            extra["terminal_width"] = UNBROKEN
            self.rich_markup_mode = None
            for later in self.later:
                later.rich_markup_mode = None
        arguments = sys.argv[1:] if args is None else args
        if JSON not in arguments:
            return super().main(args, prog_name, complete_var, standalone_mode, windows_expand_args, **extra)
        name = next((word for word in arguments if word in OFFERED), "")
        try:
            # not standalone: there typer prints usage errors and exits, and no JSON object would be written
            code = super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        except typer.Abort:
            _write_error(name, FeeddriveError("the question was not answered with yes"), 1)
            sys.exit(1)
        except Exception as error:
            _write_error(name, error, 1 if isinstance(error, MemoryError) else getattr(error, "exit_code", None))
            if not hasattr(error, "show"):
                raise
            # wrong usage is explained on the error stream as well, as without --json
            error.show()  # pyright: ignore[reportAttributeAccessIssue]
            sys.exit(error.exit_code)  # pyright: ignore[reportAttributeAccessIssue]
        # without standalone mode typer returns the exit code of a Ctrl-C instead of raising it
        if code == STOPPED:
            _write_error(name, CancelledError("stopped; nothing was written"), STOPPED)
        sys.exit(code)


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    help="Feed drives of machine tools: from a machine file or a measured log to a servo loop that is proven.",
)


def _version(wanted: bool) -> None:
    if wanted:
        from feeddrive.version import __version__

        typer.echo(f"feeddrive {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Declare the options that precede the command."""


JSON = "--json"
BLOCKS = "A file or PACKAGE.MODULE with laws or other blocks of your own, whose code is then run; may be repeated."


def _function(command: Command[Any, Any, Any]) -> Any:
    """Return the function from which typer makes a command, with a parameter for each field of the request."""
    fields = {field.name: field for field in fields_of(command.request)}  # type: ignore[arg-type]

    def perform(blocks: list[str] | None, verbose: bool, json: bool, **values: Any) -> None:
        entered = {name: _entered(fields[name], value) for name, value in values.items()}
        with _opted_in(blocks or ()), _in_one_line():
            _perform(command, entered, verbose=verbose, as_json=json)

    parameters = [*(_parameter(field) for field in fields.values()), _BLOCKS, _VERBOSE, _JSON]
    # typer reads parameters from the signature and their types from the annotations; both must be set
    perform.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    perform.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return perform


_BLOCKS = inspect.Parameter(
    "blocks",
    inspect.Parameter.KEYWORD_ONLY,
    default=None,
    annotation=Annotated[
        list[str] | None, typer.Option("--blocks", help=BLOCKS, metavar="<place>", show_default=False)
    ],
)
_VERBOSE = inspect.Parameter(
    "verbose",
    inspect.Parameter.KEYWORD_ONLY,
    default=False,
    annotation=Annotated[bool, typer.Option("--verbose", help="Show the details too.", show_default=False)],
)
_JSON = inspect.Parameter(
    "json",
    inspect.Parameter.KEYWORD_ONLY,
    default=False,
    annotation=Annotated[
        bool, typer.Option(JSON, help="Print one JSON object: tables in SI, sentences, files.", show_default=False)
    ],
)


def _opted_in(places: Sequence[str]) -> AbstractContextManager[None]:
    """Register the user-defined blocks in these files or modules, if there are any."""
    if not places:
        return nullcontext()
    from feeddrive.blocks.catalogue import with_blocks  # not for `--help`

    return with_blocks(places)


@contextmanager
def _in_one_line() -> Generator[None]:
    """Report exceptions from user-defined blocks like any other error."""
    try:
        yield
    except (FeeddriveError, typer.Exit, typer.Abort):
        raise
    except Exception as error:
        # imported only after a failure, as `--help` needs no blocks
        from feeddrive.blocks.catalogue import fault_of_user_code

        fault = fault_of_user_code(error)
        if fault is None:
            raise
        raise fault from error


def _parameter(field: Field) -> inspect.Parameter:
    """Convert a field of a request to a parameter for typer."""
    kind: Any = list[field.kind] if field.many else field.kind  # type: ignore[name-defined]
    default: Any = inspect.Parameter.empty
    if not field.required:
        default = (
            None
            if field.many or field.default is None
            else field.default / field.factor
            if field.unit
            else field.default
        )
        kind = kind | None if default is None else kind
    if field.flag:
        names = [field.flag, field.short] if field.short else [field.flag]
        # by identity: a default of 0 equals False, but must be shown
        shown = not any(default is absent for absent in (None, False, inspect.Parameter.empty))
        info = typer.Option(*names, help=field.help(), show_default=shown, autocompletion=_completion(field))
    else:
        info = typer.Argument(help=field.help(), autocompletion=_completion(field))
    return inspect.Parameter(
        field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, info]
    )


BUNDLED_OF = {"MachineFile": "machines", "Job": "jobs", "Study": "studies"}
"""The folder of the bundled files whose names a field accepts, by the class that it accepts too."""


def _completion(field: Field) -> Callable[[str], list[str]] | None:
    """Return the function by which a shell completes a value; None if it has nothing to offer."""
    folders = {BUNDLED_OF[kind.__name__] for kind in field.kinds if kind.__name__ in BUNDLED_OF}
    if field.name == "program" and Path in field.kinds:
        folders.add("programs")
    if not (field.declared.options or folders or Path in field.kinds):
        return None

    def offered_values(incomplete: str) -> list[str]:
        bundled = Path(__file__).parents[1] / "files" / "bundled"
        names = [str(value) for value in field.declared.options]
        names += [path.stem for folder in sorted(folders) for path in sorted((bundled / folder).iterdir())]
        # a shell completes no files where the program answers
        files = sorted(glob(f"{escape(incomplete)}*")) if folders or Path in field.kinds else []
        files = [f"{name}/" if Path(name).is_dir() else name for name in files]
        return [*dict.fromkeys(name for name in names if name.startswith(incomplete)), *files]

    return offered_values


def _entered(field: Field, value: Any) -> Any:
    """Convert a value from the command line for the request: to SI, and to a tuple if several are allowed."""
    if field.many:
        return tuple(_in_si(field, item) for item in value or ())
    return value if value is None else _in_si(field, value)


def _in_si(field: Field, value: Any) -> Any:
    return value if field.kind is not float or field.factor == 1.0 else units.scaled(value, field.factor)


def _perform(command: Command[Any, Any, Any], values: dict[str, Any], *, verbose: bool, as_json: bool) -> None:
    """Run the command and show its outcome; end with the exit code for the judgment of the outcome."""
    request = command.build_request(**values)
    usual = request.usual_out()
    if usual is not None and request.out is None:
        request = replace(request, out=usual)
    console = open_console(errors=as_json)
    with TerminalProgress(console) as progress:
        outcome = command.run(request, progress)
    if as_json:
        _write(outcome.record(command.__name__.replace("_", "-")))
    else:
        for item in outcome.shown(verbose=verbose):
            show(console, item)
        for line in outcome.written():
            show(console, line, soft_wrap=True)
    if outcome.error is not None and as_json:
        sys.stderr.write(visible(Text(f"feeddrive: error: {outcome.error}\n")))
        raise typer.Exit(outcome.error.exit_code)
    if outcome.error is not None:
        raise outcome.error
    if outcome.judgment.bad:
        if outcome.failure:
            sys.stderr.write(visible(resolve(f"feeddrive: {outcome.failure}\n", outcome.units)))
        raise typer.Exit(outcome.judgment.exit_code)


def _write(record: dict[str, Any]) -> None:
    """Write a JSON object to the standard output, in ASCII, so that it contains no terminal control sequences."""
    sys.stdout.write(json.dumps(record, allow_nan=False, indent=1) + "\n")
    # a closed pipe must fail here, where `main` still handles it, and not when the interpreter exits
    sys.stdout.flush()


def _write_error(command: str, error: Exception, code: int | None) -> None:
    """Write an error with its exit code as JSON; write nothing for an internal fault, which has no code."""
    if code is not None:
        told = getattr(error, "format_message", error.__str__)()
        _write({"command": command, "exit_code": code, "error": {**failure(error), "message": told}})
