"""Access to the console: who may open it, by token, Host and Origin of a request."""

from __future__ import annotations

from dataclasses import dataclass
import hmac
import ipaddress
import secrets
import socket
from urllib.parse import urlsplit

from shepherd_ros.config import ConfigError

TOKEN_BYTES = 24  # of a token that is made
SHORTEST_TOKEN = 16  # characters of a token that is given
LOOPBACK_NAMES = frozenset({'localhost', '127.0.0.1', '::1'})


@dataclass(frozen=True)
class Access:
    """
    Rules by which requests are refused.

    A page of another site may reach a server of this machine in two ways: by its address, and
    then the request has a foreign Origin; or by a name that its owner lets point here (DNS
    rebinding), and then it has a foreign Host.
    """

    token: str = ''  # '' if none is needed
    hosts: frozenset[str] = LOOPBACK_NAMES  # names by which the server may be called
    any_address: bool = False  # whether any IP address may stand for it

    def refusal(self, host: str, origin: str | None, token: str) -> str:
        """Return why a request with these headers and this token is refused, '' if it is not."""
        name = host_name(host)
        if not self._known(name):
            known = ', '.join(sorted(self.hosts))
            return f'Host is {host!r:.100}: expected one of {known}; see parameter allowed_hosts'
        if origin is not None and _origin_place(origin) != host.lower():
            return f'Origin is {origin!r:.100}: expected the page of this console'
        if self.token and not hmac.compare_digest(self.token.encode(), token.encode()):
            return 'the token is missing or wrong: open the address that the console has printed'
        return ''

    def _known(self, name: str) -> bool:
        if name in self.hosts:
            return True
        try:
            return self.any_address and bool(ipaddress.ip_address(name))
        except ValueError:
            return False


def host_name(host: str) -> str:
    """Return the name in a Host header, without its port; '' if it cannot be read."""
    try:
        return (urlsplit(f'//{host}').hostname or '').rstrip('.')
    except ValueError:
        return ''


def _origin_place(origin: str) -> str:
    try:
        parts = urlsplit(origin)
    except ValueError:
        return ''
    return parts.netloc.lower() if parts.scheme in ('http', 'https') else ''


def is_loopback(host: str) -> bool:
    """Return whether a host is this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'


def make_access(host: str, token: str, allowed_hosts: list[str]) -> Access:
    """
    Return the rules of a server that listens on a host, or raise ConfigError.

    On the loopback device no token is needed unless one is given; elsewhere one is made.
    """
    if not host:
        raise ConfigError("host is '': expected an address, such as 127.0.0.1, or 0.0.0.0 for all")
    if token and len(token) < SHORTEST_TOKEN:
        raise ConfigError(
            f'token has {len(token)} characters: expected at least {SHORTEST_TOKEN}, or none for '
            'one that is made'
        )
    names = {name.lower() for name in allowed_hosts if name} | LOOPBACK_NAMES
    if is_loopback(host):
        return Access(token, frozenset(names))
    own = {socket.gethostname().lower(), host.lower()}
    made = token or secrets.token_urlsafe(TOKEN_BYTES)
    return Access(made, frozenset(names | own), any_address=True)
