"""The command line program `feeddrive`.

Every user error is reported as one line on the error stream, with the exit code of its class
(`FeeddriveError.exit_code`): 2 for wrong usage or input, 1 for an outcome with a negative judgment, 130 for Ctrl-C, a
termination signal and a closed terminal.
"""

import gc
import os
import signal
import sys
from typing import NoReturn

from feeddrive.language.errors import CancelledError, FeeddriveError
from feeddrive.language.progress import ENDINGS
from feeddrive.language.table import visible
from feeddrive.language.text import Text

STOPPED = CancelledError.exit_code


def _stopped(message: object = "stopped; nothing was written") -> NoReturn:
    sys.stderr.write(visible(Text(f"feeddrive: {message}\n")))
    sys.exit(STOPPED)


def _broken_package(error: ImportError) -> str:
    """Return the package whose import failed; empty for a fault of feeddrive itself."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    # a package that is there and does not load, as numpy without its shared library, names no module
    name = error.name or ("" if trace is None else str(trace.tb_frame.f_globals.get("__name__", "")))
    package = name.partition(".")[0]
    return "" if package in ("feeddrive", "__main__") else package


def main() -> None:
    """Run the command line and exit."""
    # Set before numpy is imported: its threads split matrices that are too small and wait longer than they work.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Python looks for cyclic garbage after 700 new objects: a twentieth of a command's time, whose graphs have many
    gc.set_threshold(20_000)
    # Child processes are started by `python -c`, which would import modules from the working directory first: a
    # numpy.py in a folder with logs of somebody else would be run.
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    for number in ENDINGS:
        # only where nothing else is set: a signal ignored by nohup stays ignored
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)
    try:
        # imported inside `try`, so that Ctrl-C during a slow import ends like any other, without a traceback
        from feeddrive.cli.terminal import own_words

        with own_words():
            from feeddrive.cli.commands import app

            app()
    except CancelledError as error:
        _stopped(error)
    except FeeddriveError as error:
        sys.stderr.write(visible(Text(f"feeddrive: error: {error}\n")))
        sys.exit(error.exit_code)
    except ImportError as error:
        package = _broken_package(error)
        if not package:
            raise
        text = f"the package {package} cannot be imported ({error}): run  pip install --force-reinstall {package}"
        sys.stderr.write(visible(Text(f"feeddrive: error: {' '.join(text.split())}\n")))
        sys.exit(1)
    except MemoryError:
        sys.stderr.write("feeddrive: error: more memory is needed than there is: shorten the work, or sample slower\n")
        sys.exit(1)
    except KeyboardInterrupt:
        _stopped()
    except RuntimeError as error:
        # Python wraps a Ctrl-C during the creation of a class in a RuntimeError
        if isinstance(error.__cause__, KeyboardInterrupt):
            _stopped()
        raise
    except SystemExit as ended:
        # typer turns Ctrl-C within a command into this exit code, without a message
        if ended.code == STOPPED:
            _stopped()
        raise
    except BrokenPipeError:
        # 128 + SIGPIPE, as a shell reports it: `feeddrive ... | head` is no error to report
        sys.exit(141)
    except OSError as error:
        sys.stderr.write(f"feeddrive: error: the output cannot be written: {error.strerror}\n")
        sys.exit(1)
