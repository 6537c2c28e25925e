"""Where the explorer listens, and the link that lets other devices in."""

import dataclasses
import functools
import hmac
import ipaddress
import re
import secrets
import socket
from urllib.parse import parse_qsl, urlencode

_OWN = "127.0.0.1"
_HOST = re.compile(r"(?P<name>\[[0-9a-f:.]+\]|[^:\[\]]+)(?::\d{1,5})?")
_PARAMETER = "token"


@dataclasses.dataclass(frozen=True)
class Address:
    """Host and port of the explorer.

    On 127.0.0.1 only this machine's users reach it. On another host every device of the network does, and so each of
    them must open a link with a token first, which is new at every start of the explorer.

    Args:
        host: an address of this machine: "127.0.0.1", "0.0.0.0" for all of its IPv4 addresses, "192.168.1.20".
        port: on which it listens.
        token: what lets a device in; empty where only this machine can reach the explorer.
    """

    host: str
    port: int
    token: str = dataclasses.field(default="", repr=False)

    @classmethod
    def free(cls, host: str, port: int) -> "Address":
        """The address of a free port; 0 asks for any.

        Raises:
            OSError: if the port is not free, not for this user, or the host is no address of this machine.
        """
        with socket.socket(_family(host)) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            bound = probe.getsockname()[1]
        return cls(host, bound, "" if is_loopback(host) else secrets.token_urlsafe(16))

    @property
    def path(self) -> str:
        """The path of the link."""
        return f"/?{_PARAMETER}={self.token}" if self.token else "/"

    @functools.cached_property
    def link(self) -> str:
        """What to open in a browser; other devices need the token in it."""
        name = _reachable_host(self.host)
        return f"http://{f'[{name}]' if ':' in name else name}:{self.port}{self.path}"

    @property
    def cookie(self) -> str:
        """The name of the cookie that holds the token; cookies do not tell the ports of a host apart."""
        return f"erosion-{self.port}"

    def admits(self, token: str) -> bool:
        """Whether this is the token, or none is needed."""
        return not self.token or hmac.compare_digest(token.encode(), self.token.encode())

    def is_own(self, host: str, reached: str | None) -> bool:
        """Whether a request's `Host` names this machine.

        Another page may let a name of its own point here (DNS rebinding), but it cannot take one of these names.

        Args:
            host: in small letters, with or without a port. Whoever reaches a distant machine's explorer through
                another port of their own (ssh -L) names that port.
            reached: the address of this machine to which the request came.
        """
        match = _HOST.fullmatch(host)
        if match is None:
            return False
        names = {_OWN, "localhost"}
        if self.token:
            machine = socket.gethostname().lower()
            names |= {self.host.lower(), str(reached), machine, f"{machine}.local"} - {"0.0.0.0", "::"}
        return match["name"].strip("[]") in names


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach the host."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def without_token(query: str) -> tuple[str | None, str]:
    """The token in a link's query, None without one, and the rest of the query."""
    fields = parse_qsl(query, keep_blank_values=True)
    tokens = [value for name, value in fields if name == _PARAMETER]
    rest = urlencode([(name, value) for name, value in fields if name != _PARAMETER])
    return (tokens[-1] if tokens else None), rest


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def _reachable_host(host: str) -> str:
    """The address by which other devices reach a host; of all addresses that of the route to the network."""
    if host not in ("0.0.0.0", "::"):
        return host
    # No packet is sent: the system only says from which of its addresses one would go. The target is reserved for
    # documentation (RFC 5737, RFC 3849).
    target = "2001:db8::1" if host == "::" else "192.0.2.1"
    try:
        with socket.socket(_family(host), socket.SOCK_DGRAM) as probe:
            probe.connect((target, 9))
            return probe.getsockname()[0]
    except OSError:
        return socket.gethostname()
