"""CAN buses by python-can, named in one text: `socketcan:can0`, `virtual:bench`, `udp_multicast:239.74.163.2`."""

from __future__ import annotations

from typing import Any

from feeddrive.language.errors import BusError, MissingExtraError


def packages() -> Any:
    """The canopen package. Raises MissingExtraError without it."""
    try:
        import canopen
    except ImportError as missing:
        raise MissingExtraError(missing.name or "canopen", "bus", "CANopen") from None
    return canopen


def opened_network(interface: str, bitrate: int | None) -> Any:
    """A canopen network on the bus. Raises BusError for one that cannot be opened."""
    canopen = packages()
    import can

    kind, _, channel = interface.partition(":")
    if kind not in can.VALID_INTERFACES or not channel:
        raise BusError(
            f"interface '{interface}' must name what python-can calls interface and channel, as socketcan:can0; "
            f"it knows {', '.join(sorted(can.VALID_INTERFACES))}"
        )
    rate: dict[str, Any] = {} if bitrate is None else {"bitrate": bitrate}
    try:
        line = can.Bus(channel=channel, interface=kind, **rate)
    except (can.CanError, OSError, ValueError, ImportError) as error:
        raise BusError(
            f"interface '{interface}' cannot be opened: {error}; is it there and up "
            "(ip link set can0 up type can bitrate 1000000)?"
        ) from None
    network = canopen.Network(line)
    network.NOTIFIER_CYCLE = 0.1  # s that its end may have to wait for
    network.connect()
    return network
