"""Network interfaces: raw sockets on them, and what to do where one is missing or not permitted."""

from __future__ import annotations

import socket
import struct
import sys

from feeddrive.language.errors import BusError

_FLAGS = 0x8913  # SIOCGIFFLAGS


def check_interface(name: str) -> None:
    """Raise BusError for an interface that is not there or not up, with those that are."""
    there = sorted(each for _, each in socket.if_nameindex())
    if name not in there:
        raise BusError(f"interface '{name}' is not there; there are: {', '.join(there) or 'none'} (ip link shows them)")
    if not _is_up(name):
        raise BusError(f"interface '{name}' is down: run  ip link set {name} up")


def _is_up(name: str) -> bool:
    """By the flags of the interface, in the network namespace of this process."""
    if not sys.platform.startswith("linux"):
        return True
    import fcntl

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        answered = fcntl.ioctl(asking, _FLAGS, struct.pack("16s24x", name.encode()[:15]))
    return bool(struct.unpack_from("<H", answered, 16)[0] & 1)


def opened_socket(interface: str, ethertype: int) -> socket.socket:
    """A raw Ethernet socket. Raises BusError for an interface that is not there, or that may not be opened so."""
    if not sys.platform.startswith("linux"):
        raise BusError("a virtual EtherCAT drive needs the packet sockets of Linux; use  --bus canopen")
    check_interface(interface)
    try:
        line = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ethertype))
        line.bind((interface, ethertype))
    except PermissionError:
        raise BusError(not_permitted(interface)) from None
    except OSError as error:
        raise BusError(f"interface '{interface}' cannot be opened: {error.strerror}") from None
    return line


def not_permitted(interface: str) -> str:
    """What to do without the right to raw sockets."""
    return (
        f"interface '{interface}': raw Ethernet needs CAP_NET_RAW: run as root, give it once by  "
        f"sudo setcap cap_net_raw+ep $(readlink -f {sys.executable}), or try it in a namespace of its own by  "
        "unshare -rn"
    )
