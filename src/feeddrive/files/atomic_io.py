"""Atomic file access: files and result directories are read or written completely or not at all.

A file is written under a temporary name in the same directory, flushed to disk and renamed; a directory of results
is built under a temporary name and renamed when it is complete.  Any failure before that, including Ctrl-C, leaves no
new file behind and the old one unchanged.  (A killed process or a power cut may leave the hidden temporary file, but
never a partial result under the final name.)
"""

import contextlib
import errno
import json
import os
import shutil
import stat
from collections.abc import Generator
from pathlib import Path

from feeddrive.language.errors import FileError
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import plain
from feeddrive.version import __version__

MARKER = ".feeddrive"  # in a directory of results: the version that wrote it, and its files

_WHAT_TO_DO = {
    errno.ENOSPC: "free some space or choose another disk",
    errno.EDQUOT: "free some space or choose another disk",
    errno.EACCES: "change its permissions or choose another place",
    errno.EPERM: "change its permissions or choose another place",
    errno.EFBIG: "raise the limit of file sizes (ulimit -f) or choose another disk",
    errno.EROFS: "choose a place that can be written",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOENT: "check the name",
    errno.EEXIST: "a part of its path is a file; choose another name",
    errno.ENOTDIR: "a part of its path is a file; check the name",
}


def refusal(path: str | Path, what: str, error: OSError) -> FileError:
    """Convert an operating system error to a FileError that states the file, the reason and a remedy."""
    reason = (error.strerror or str(error) or type(error).__name__).lower()
    advice = _WHAT_TO_DO.get(error.errno or 0)
    return FileError(f"{path}: cannot be {what}: {reason}" + (f"; {advice}" if advice else ""))


def _check_name(path: str | Path) -> None:
    try:
        named = b"\0" not in os.fsencode(path)
    except UnicodeEncodeError:
        named = False
    if not named:
        raise FileError(f"{str(path)!r}: is not a file name")


def read_whole(path: str | Path, most: int) -> bytes:
    """Read a regular file of at most `most` bytes.

    Raises FileError if the file is missing, unreadable or too large, and for a directory, a device or a pipe (which
    might never end).
    """
    _check_name(path)
    try:
        status = os.stat(path)
        if stat.S_ISDIR(status.st_mode):
            raise FileError(f"{path}: is a directory; give the name of a file in it")
        if not stat.S_ISREG(status.st_mode):
            raise FileError(f"{path}: is a device or pipe, not a file; copy it to a file first")
        if status.st_size > most:
            raise FileError(
                f"{path}: has {Quantity(status.st_size / 1e6, 'MB'):,.1f}, more than the "
                f"{Quantity(most / 1e6, 'MB'):,.1f} that are read; is it the right file?"
            )
        with open(path, "rb") as file:
            # `read` allocates the memory for the whole requested size.
            return file.read(min(most, status.st_size + 1))
    except OSError as error:
        raise refusal(path, "read", error) from None


@contextlib.contextmanager
def written_whole(path: str | Path) -> Generator[Path]:
    """Yield an empty temporary file next to `path`; at the end of the block this file is renamed to `path`.

    On any exception the temporary file is removed and an existing `path` stays unchanged; an OSError becomes a
    FileError.  A symbolic link is followed, and the permissions of an existing file are kept.
    """
    _check_name(path)
    # renaming onto a symbolic link would replace the link, not the file that it leads to
    target = Path(os.path.realpath(path))
    temporary = _beside(target, "part")
    try:
        if target.is_dir():
            raise FileError(f"{path}: cannot be written: is a directory; give the name of a file in it")
        # 0o666 under the umask, as for any new file; tempfile would give 0o600
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        if target.exists():
            temporary.chmod(target.stat().st_mode & 0o777)
        yield temporary
        # before the rename: else a power cut can leave the new name with no content
        _flush(temporary, os.O_RDWR)
        temporary.replace(target)
        # the new name is content of the directory, which is flushed apart from the file
        with contextlib.suppress(OSError):
            # Not every system can flush a directory.
            _flush(target.parent, os.O_RDONLY)
    except OSError as error:
        raise refusal(path, "written", error) from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_whole(path: str | Path, content: bytes | str) -> None:
    """Write a file completely or not at all. Raise FileError with the file and the reason."""
    with written_whole(path) as temporary:
        temporary.write_bytes(plain(content).encode("utf-8") if isinstance(content, str) else content)


def _beside(target: Path, suffix: str) -> Path:
    """Return an unused hidden path next to `target`; long names are shortened to the length that file systems allow."""
    # In the same directory, hence the same file system, since a rename across two is not atomic.
    return target.parent / f".{target.name[:60]}.{os.urandom(6).hex()}.{suffix}"


def _flush(path: Path, how: int) -> None:
    """Flush a file or a directory to disk."""
    handle = os.open(path, how)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextlib.contextmanager
def new_directory(path: str | Path) -> Generator[Path]:
    """Yield a temporary directory for results; it appears as `path` at the end of the block, or not at all.

    An existing `path` is replaced only if it is empty, or if feeddrive wrote it and it contains no other files. Raises
    FileError on entry if `path` cannot be replaced or written.
    """
    _check_name(path)
    target = Path(os.path.abspath(path))
    temporary = _beside(target, "part")
    # Noted before they are made, so that a failure removes exactly the parents that this call created.
    missing = [folder for folder in target.parents if not folder.exists()]
    finished = False
    try:
        _check_replaceable(path, target)
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary.mkdir()
        yield temporary
        _sign(temporary)
        # again: the results took their time, and something may have been put there meanwhile
        _check_replaceable(path, target)
        _exchange(temporary, target)
        finished = True
    except OSError as error:
        raise refusal(_seen(error.filename, temporary, target) or path, "written", error) from None
    except FileError as error:
        # An error that names a file in the temporary directory must name the final path instead.
        if str(temporary) not in str(error):
            raise
        raise FileError(str(error).replace(str(temporary), str(target))) from None
    finally:
        if not finished:
            shutil.rmtree(temporary, ignore_errors=True)
            for folder in missing:
                with contextlib.suppress(OSError):
                    folder.rmdir()


def check_directory(path: str | Path) -> None:
    """Raise FileError if `new_directory` cannot write to `path`, as far as this can be checked without writing."""
    _check_name(path)
    target = Path(os.path.abspath(path))
    try:
        _check_replaceable(path, target)
        there = next(folder for folder in target.parents if folder.exists())
        if not there.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not os.access(there, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise refusal(path, "written", error) from None


def _seen(name: object, temporary: Path, target: Path) -> Path | None:
    """Return the path to show in an error, in the final directory instead of the temporary one; None if not a path."""
    if not isinstance(name, str | Path):
        return None
    file = Path(name)
    return target / file.relative_to(temporary) if file.is_relative_to(temporary) else file


def files_of(directory: Path) -> list[str]:
    """Return the sorted relative paths of all files in a directory tree, except the marker file of feeddrive."""
    return sorted(
        str((Path(folder) / name).relative_to(directory))
        for folder, _, names in os.walk(directory)
        for name in names
        if name != MARKER
    )


def _sign(directory: Path) -> None:
    statement = {"written_by": f"feeddrive {__version__}", "files": files_of(directory)}
    write_whole(directory / MARKER, json.dumps(statement, indent=1) + "\n")


def _check_replaceable(path: str | Path, target: Path) -> None:
    # Renaming would replace the link and leave the directory behind it unchanged.
    if target.is_symlink():
        raise FileError(f"{path}: is a symbolic link; give the directory itself")
    if not target.exists():
        return
    if not target.is_dir():
        raise FileError(f"{path}: is a file, not a directory; choose another name")
    try:
        written = set(json.loads((target / MARKER).read_text(encoding="utf-8"))["files"])
    except (OSError, ValueError, KeyError, TypeError):
        # A missing or damaged marker protects the directory.
        if not any(target.iterdir()):
            return
        raise FileError(f"{path}: exists and was not written by feeddrive; choose another name or remove it") from None
    strangers = [name for name in files_of(target) if name not in written]
    if strangers:
        raise FileError(
            f"{path}: holds '{strangers[0]}', which feeddrive did not write; choose another name or move that file away"
        )


def _exchange(new: Path, target: Path) -> None:
    """Replace the directory `target` by `new`; the old directory is moved aside first and restored on failure."""
    old = _beside(target, "old")
    try:
        if target.exists():
            target.rename(old)
        new.rename(target)
    # Ctrl-C included: the old results must not stay under a hidden name
    except BaseException:
        if old.exists() and not target.exists():
            old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)
