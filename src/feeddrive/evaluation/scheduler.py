"""The address of a Dask scheduler, the certificates for it, and the warning about one that others can reach.

Dask sends functions as pickles, and unpickling runs code.  Without TLS everyone who reaches the port of a scheduler can
therefore run code on the scheduler, on its workers and on its clients.  With TLS both ends of each connection need a
certificate of one authority.
"""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from feeddrive.language.errors import ParameterError

OPTIONS = "--tls-ca-file, --tls-cert and --tls-key"
_ENCRYPTED = ("tls", "wss")  # protocols of Dask whose connections are encrypted and authenticated


@dataclass(frozen=True)
class Certificates:
    """The files of a client in PEM format: the certificate of the authority, its own certificate, and its key.

    Dask compares no host names: every holder of a certificate of the authority can act as scheduler, worker or client.
    The authority should therefore issue certificates for this cluster alone.
    """

    ca_file: Path
    cert: Path
    key: Path

    @classmethod
    def of(
        cls, scheduler: str | None, ca_file: Path | None, cert: Path | None, key: Path | None
    ) -> Certificates | None:
        """Return the certificates that these options name; None if they name none.

        Raises ParameterError if some of the files are missing, or if the address is not one of TLS.
        """
        files = [file for file in (ca_file, cert, key) if file is not None]
        if not files:
            return None
        if scheduler is None or not is_encrypted(scheduler):
            at = "no scheduler is given" if scheduler is None else f"the scheduler '{scheduler}' is reached without TLS"
            raise ParameterError(f"{OPTIONS}: {at}: give its address as --scheduler tls://10.0.0.5:8786")
        if ca_file is None or cert is None or key is None:
            raise ParameterError(f"{OPTIONS} belong together: {len(files)} of the three files are given")
        return cls(ca_file, cert, key)


def is_loopback(host: str) -> bool:
    """Return True for an address that only this machine can reach."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def is_encrypted(address: str) -> bool:
    """Return True for the address of a scheduler whose connections use TLS."""
    return address.partition("://")[0].lower() in _ENCRYPTED


def exposure(address: str) -> str:
    """Return the warning about a scheduler that is neither on this machine's loopback nor reached by TLS, else "".

    An address of this machine in its network is warned of, too: a port there is open to the network.
    """
    # Dask takes an address without a protocol as one of TCP
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    if is_encrypted(address) or parts.scheme == "inproc" or is_loopback(parts.hostname or ""):
        return ""
    return (
        f"The scheduler at {address} is neither local nor reached by TLS: everyone who reaches its port can run code "
        "on the scheduler, on its workers and on this machine. Use tls:// with certificates, or a tunnel (ssh -L): "
        "docs/reference/security.md shows both."
    )
