"""The endpoint of a router, `tcp/HOST:PORT` or `tls/HOST:PORT`: what may stand there, does anything listen there."""

from __future__ import annotations

import ipaddress
import re
import socket

from luxloop.errors import InputError

ALLOWED = "tcp/HOST:PORT (tls/ with certificates), HOST a name, an IPv4 or a bracketed IPv6 address, PORT 1 to 65535"
EXAMPLES = "e.g. tcp/127.0.0.1:7447 or tcp/[::1]:7447"
PARTS = re.compile(r"(?:tcp|tls)/(?:\[([0-9A-Fa-f:.]+)\]|([^\[\]:/]+)):([0-9]{1,5})")
LABEL = re.compile(r"[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?")


def checked(endpoint: str) -> str:
    """`endpoint`, or an InputError where it is none that both zenoh and the system's sockets take."""
    parts = PARTS.fullmatch(endpoint)
    if parts is None or not 1 <= int(parts[3]) <= 65535 or not _is_host(parts[1], parts[2]):
        raise InputError("router", endpoint, ALLOWED, EXAMPLES)
    return endpoint


def fits(endpoint: str, certificates: bool) -> str:
    """`endpoint`, or an InputError where it is tls without certificates, or tcp although there are some."""
    if secured(endpoint) == certificates:
        return endpoint
    if certificates:
        mend = f"write tls/{endpoint[4:]}, or unset LUXLOOP_CERTS for a set that anybody can join"
        raise InputError("router", endpoint, "tls/HOST:PORT, as LUXLOOP_CERTS is set", mend)
    mend = f"set LUXLOOP_CERTS to the folder that `luxloop certs` made; without one, {EXAMPLES}"
    raise InputError("router", endpoint, ALLOWED, mend)


def secured(endpoint: str) -> bool:
    """Whether sessions there are encrypted and both sides show a certificate."""
    return endpoint.startswith("tls/")


def is_loopback(endpoint: str) -> bool:
    """Whether only this machine can reach it."""
    host = host_and_port(endpoint)[0]
    return host in ("localhost", "::1") or host.startswith("127.")


def free_loopback(like: str) -> str:
    """An endpoint of this machine with a port that is free now, encrypted where `like` is."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{like.partition('/')[0]}/127.0.0.1:{probe.getsockname()[1]}"


def host_and_port(endpoint: str) -> tuple[str, int]:
    """The two parts of the endpoint, an IPv6 address without its brackets."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    return host.strip("[]"), int(port)


def listening(endpoint: str) -> bool:
    """Whether something accepts connections there: said at once, where opening a session would wait."""
    try:
        with socket.create_connection(host_and_port(endpoint), timeout=2.0):
            return True
    except (OSError, UnicodeError):
        return False


def _is_host(ipv6: str | None, name: str) -> bool:
    """Whether this is an IPv6 address, or a name or IPv4 address: what ends with a number must be an address."""
    try:
        if ipv6 is not None:
            return bool(ipaddress.IPv6Address(ipv6))
        labels = name.split(".")
        if labels[-1].isdecimal():
            return bool(ipaddress.IPv4Address(name))
    except ValueError:
        return False
    return len(name) <= 253 and all(map(LABEL.fullmatch, labels))
