"""The password of a page that is open to the network: from a file or standard input, and never from the command line,
which every user of the machine can read while the command runs.
"""

from __future__ import annotations

import getpass
import os
import sys
from pathlib import Path

from feeddrive.files.atomic_io import read_whole
from feeddrive.language.errors import ParameterError

OPTION = "--password-file"
STANDARD_INPUT = "-"
_SHORTEST, _LONGEST = 12, 300  # characters; a browser sends up to three bytes for each byte of them
_MOST = 10_000  # bytes of the file
_OTHERS = 0o077  # permissions of group and others


def read_password(path: Path) -> str:
    """Read the password: the first line of a file, or of standard input for `-`, without an echo in a terminal.

    Raises FileError for a file that cannot be read, ParameterError for one that others may read and for a password of
    the wrong length.
    """
    if str(path) != STANDARD_INPUT:
        content = read_whole(path, _MOST)
        permissions = os.stat(path).st_mode
        if os.name == "posix" and permissions & _OTHERS:
            raise ParameterError(
                f"{OPTION} {path}: other users of this machine may read or write it (mode {permissions & 0o777:o}): "
                f"chmod 600 {path}"
            )
        line = content.partition(b"\n")[0]
    elif sys.stdin.isatty():
        line = getpass.getpass("Password of the page: ").encode()
    else:
        line = sys.stdin.buffer.readline(_MOST)
    try:
        password = line.rstrip(b"\r\n").decode()
    except UnicodeDecodeError:
        raise ParameterError(f"{OPTION} {path}: its first line is no text in UTF-8: write the password anew") from None
    if not _SHORTEST <= len(password) <= _LONGEST:
        raise ParameterError(
            f"{OPTION} {path}: its first line has {len(password)} characters: a password has {_SHORTEST} to {_LONGEST}"
        )
    return password
