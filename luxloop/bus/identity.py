"""The certificate that a process shows and the CA it trusts: which files, and why a router and a process do not meet.

zenoh says of everything that goes wrong here "Timeout". So the handshake is tried once more with the standard
library, whose errors and alerts name the cause.
"""

from __future__ import annotations

import socket
import ssl
from dataclasses import dataclass
from pathlib import Path

from luxloop.bus.access import Role
from luxloop.endpoint import host_and_port, listening
from luxloop.errors import InputError
from luxloop.failure import Failure
from luxloop.settings import Settings

HANDSHAKE_S = 2.0
VERDICT_S = 0.3  # in TLS 1.3 the router judges our certificate when we are through, and then waits for us
NO_TLS = ("what listens there speaks no TLS", "was the router started without LUXLOOP_CERTS?")
NO_WORD = (
    "what listens there does not begin TLS",
    "was the router started without LUXLOOP_CERTS? else wait: it pauses for 0.1 s after each handshake that fails",
)
ANOTHER_CA = ("the router's certificate is of another CA than {ca}", "use the set that the router uses")
ANOTHER_NAME = (
    "the router's certificate is not for {host}",
    "luxloop certs --renew --host {host}, and start the router again",
)
ALERTS = {  # what the router says of our certificate
    "certificate required": ("the router asks for a certificate", "set LUXLOOP_CERTS"),
    "unknown ca": ("the router trusts another CA than the one that signed {file}", "use the set that it uses"),
    "decrypt error": ("the router trusts another CA of the same name", "use the set that it uses"),
    "bad certificate": ("the router does not take {file}", "use the set that it uses"),
    "certificate expired": (
        "{file} is out of its time: it has expired, or is not valid yet by the router's clock",
        "luxloop certs --renew; set the clocks of both hosts (NTP)",
    ),
    "certificate unknown": ("the router does not take {file}", "is it valid yet? set the clocks of both hosts"),
}
VERDICTS = {  # what we find in the router's certificate, by OpenSSL's code
    9: ("the router's certificate is not valid yet", "set the clocks of both hosts (NTP)"),
    10: ("the router's certificate has expired", "luxloop certs --renew, and start the router again"),
    26: ("what listens there shows a certificate that is none of a router", "who has this port?"),
    62: ANOTHER_NAME,  # a host name
    64: ANOTHER_NAME,  # an address
}


@dataclass(frozen=True)
class Identity:
    """The files of one role: the CA's certificate, and its own certificate with the private key."""

    role: Role
    ca: Path
    own: Path

    @classmethod
    def of(cls, settings: Settings, role: Role) -> Identity | None:
        """The identity of `role` in LUXLOOP_CERTS; None where that is not set.

        Raises InputError, naming the file and the mend, where one is missing, cannot be read or used, or where
        others may read the key.
        """
        folder = settings.certs_dir
        if folder is None:
            return None
        below, alone = folder / role / f"{role}.pem", folder / f"{role}.pem"
        identity = cls(role, folder / "ca.pem", below if below.parent.is_dir() or not alone.exists() else alone)
        identity.check()
        return identity

    def check(self) -> None:
        """Raises InputError where the files cannot be used; see `of`."""
        for path in (self.ca, self.own):
            try:
                path.read_bytes()
            except OSError as error:
                whose = "; it must belong to who starts the process" * isinstance(error, PermissionError)
                raise self._unusable(f"{path}: {error.strerror}{whose}; luxloop certs makes a set") from error
        if self.own.stat().st_mode & 0o007:
            raise self._unusable(f"others may read the key in it: chmod 600 {self.own}")
        self.context()

    def context(self) -> ssl.SSLContext:
        """A client's side of TLS with this identity, as zenoh has it. Raises InputError where a file is damaged."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        path = self.ca
        try:
            context.load_verify_locations(path)
            path = self.own
            context.load_cert_chain(path)
        except (ssl.SSLError, OSError) as error:
            mend = f"{path} is damaged, or its key is not its certificate's: luxloop certs --renew makes it anew"
            raise self._unusable(mend) from error
        return context

    def _unusable(self, mend: str) -> InputError:
        return InputError("LUXLOOP_CERTS", str(self.ca.parent), f"a folder with ca.pem and {self.own.name}", mend)


def refusal(settings: Settings, identity: Identity | None) -> Failure | None:
    """Why this process and what listens at `settings.router` cannot meet, as far as TLS knows; else None."""
    if identity is None:
        return _unexpected_tls(settings)
    try:
        _shake_hands(settings, identity.context(), VERDICT_S)
    except ssl.SSLCertVerificationError as error:
        said = VERDICTS.get(error.verify_code, ANOTHER_CA)
    except ssl.SSLError as error:
        text = str(error).lower().replace("_", " ")
        said = next((said for alert, said in ALERTS.items() if alert in text), NO_TLS)
    except TimeoutError:
        said = NO_WORD
    except (OSError, UnicodeError):  # nobody there, or it has hung up: nothing that TLS knows of
        return None
    else:
        return None
    names = {"host": host_and_port(settings.router)[0], "file": str(identity.own), "ca": str(identity.ca)}
    return _failure(settings, said[0].format(**names), said[1].format(**names))


def answering(settings: Settings, identity: Identity | None) -> bool:
    """Whether something accepts connections at `settings.router`.

    Said of a TLS port after a whole handshake: one that is begun and left makes zenoh's router pause for 0.1 s.
    """
    if identity is None:
        return listening(settings.router)
    try:
        _shake_hands(settings, identity.context(), 0.0)
    except (ssl.SSLError, TimeoutError):
        return True
    except (OSError, UnicodeError):
        return False
    return True


def lets_anybody_in(settings: Settings, identity: Identity) -> bool:
    """Whether the router at `settings.router` speaks with who shows no certificate."""
    stranger = ssl.create_default_context(cafile=str(identity.ca))
    try:
        return _shake_hands(settings, stranger, VERDICT_S)
    except (OSError, UnicodeError):
        return False


def _shake_hands(settings: Settings, context: ssl.SSLContext, verdict_s: float) -> bool:
    """Whether after the handshake, and `verdict_s` more, the other side still listens. Raises what is raised."""
    address = host_and_port(settings.router)
    context.sslsocket_class = _Closing
    with (
        socket.create_connection(address, HANDSHAKE_S) as plain,
        context.wrap_socket(plain, server_hostname=address[0]) as tls,
    ):
        if verdict_s:
            tls.settimeout(verdict_s)
            try:
                return bool(tls.recv(1))
            except TimeoutError:
                pass
        return True


class _Closing(ssl.SSLSocket):
    """Closes itself: `wrap_socket` leaves one behind where the other side was killed before the handshake."""

    def __del__(self) -> None:
        self.close()


def _unexpected_tls(settings: Settings) -> Failure | None:
    """Whether it is a TLS port that plain tcp was tried at."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        _shake_hands(settings, context, VERDICT_S)
    except ssl.SSLError as error:
        if "certificate required" not in str(error).lower().replace("_", " "):
            return None
    except (OSError, UnicodeError):
        return None
    mend = f"set LUXLOOP_CERTS to a folder with your certificate, LUXLOOP_ROUTER to tls/{settings.router[4:]}"
    return _failure(settings, "what listens there speaks TLS, and we spoke plain tcp", mend)


def _failure(settings: Settings, why: str, mend: str) -> Failure:
    return Failure(
        code="refused", message=f"no session at {settings.router}: {why}", mend=f"{mend}; luxloop doctor says more"
    )
