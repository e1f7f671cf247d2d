"""Certificates in files: written after the checker has passed over them, and read only if it does."""

from __future__ import annotations

from pathlib import Path

from feeddrive.certificate import check
from feeddrive.certificate.certificate import Certificate
from feeddrive.files.atomic_io import read_whole, write_whole
from feeddrive.language.errors import FileError


def write_certificate(path: str | Path, certificate: Certificate) -> Path:
    """Write a certificate as JSON, whole or not at all; its path.

    Raises FileError if it cannot be written, NotCertifiedError if the checker refuses it.
    """
    certificate.verify()
    write_whole(path, certificate.text())
    return Path(path)


def read_certificate(path: str | Path) -> Certificate:
    """The certificate in a file. Raises FileError, with the checker's reason, for one that is not proven."""
    content = read_whole(path, check.MOST_BYTES)
    try:
        document = check.parse(content)
        check.verified(document)
    except check.RefusedError as error:
        raise FileError(f"{path}: refused: {error}") from None
    except check.BROKEN as error:
        raise FileError(f"{path}: refused: it is not built as a certificate is: {error}") from None
    return Certificate(document)
