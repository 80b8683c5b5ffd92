"""Certificates and permissions: are the files in order, and does the router hold its rules against our role?"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.x509.oid import NameOID

from env_controller.certs import SOON_DAYS, read_certificate, role_file
from env_controller.health.finding import Finding, Verdict
from luxloop.bus import Bus
from luxloop.bus.access import ROLES, WORKERS, Role
from luxloop.bus.frame import encode
from luxloop.bus.identity import Identity, lets_anybody_in
from luxloop.bus.keys import at
from luxloop.endpoint import is_loopback
from luxloop.errors import InputError, RemoteError
from luxloop.messages import Nothing
from luxloop.settings import Settings

ASK_S = 3.0
RENEW = "luxloop certs --renew --out {folder}, and start again"
RENEW_AFAR = "luxloop certs --renew where the set's ca.key is; bring this role's folder here, and start again"


def certificates(settings: Settings, role: Role) -> Iterator[Finding]:
    """The CA's certificate, and those of the roles whose files lie here: `role`'s must."""
    folder = settings.certs_dir
    if folder is None:
        yield _none(settings)
        return
    try:
        authority = read_certificate(folder / "ca.pem")
    except InputError as error:
        yield Finding("ca.pem", "fail", f"{folder / 'ca.pem'} is missing or damaged", error.mend)
        return
    yield dated("ca.pem", authority, str(folder / "ca.pem"), folder)
    yield from _folder(folder)
    if (folder / "ca.key").exists():
        yield _closed("ca.key", folder / "ca.key", "the CA's private key: on one host only, kept from all others")
    for other in ROLES:
        path = _file_of(folder, other)
        if path.exists() or other == role:
            yield from _certificate(folder, other, path, authority)
        if path.parent != folder and path.parent.is_dir():
            yield from _folder(path.parent)


def _none(settings: Settings) -> Finding:
    if is_loopback(settings.router):
        return Finding("certificates", "ok", "none: plain tcp, on this machine only, open to all of its users")
    mend = "luxloop certs, then set LUXLOOP_CERTS and LUXLOOP_ROUTER=tls/... on all hosts"
    return Finding("certificates", "warn", f"none: whoever reaches {settings.router} may join and submit", mend)


def _file_of(folder: Path, role: Role) -> Path:
    below, alone = role_file(folder, role), folder / f"{role}.pem"
    return alone if alone.exists() and not below.exists() else below


def _certificate(folder: Path, role: Role, path: Path, authority: x509.Certificate) -> Iterator[Finding]:
    """Is it there, whole, of this role and this CA, in its time, and its key for its owner only?"""
    what = f"{role}.pem"
    try:
        certificate = read_certificate(path)
    except InputError as error:
        yield Finding(what, "fail", f"{path} is missing or damaged", error.mend)
        return
    if (closed := _closed(what, path, "")).verdict == "fail":
        yield closed
        return
    try:
        Identity(role, folder / "ca.pem", path).check()
    except InputError as error:
        yield Finding(what, "fail", f"{path} cannot be used", error.mend)
        return
    name = _common_name(certificate)
    if name != role:
        yield Finding(
            what, "fail", f"{path} is the certificate of {name!r}", f"put that of {role} there: luxloop certs"
        )
        return
    try:
        certificate.verify_directly_issued_by(authority)
    except (InvalidSignature, ValueError, TypeError):
        mend = "take both of one set: luxloop certs"
        yield Finding(what, "fail", f"{path} is not signed by the CA of {folder / 'ca.pem'}", mend)
        return
    timely = dated(what, certificate, str(path), folder)
    yield timely if timely.verdict != "ok" or closed.verdict == "ok" else closed


def router_dates(settings: Settings) -> Iterator[Finding]:
    """Is the router's own certificate, and that of its CA, in its time? Nothing where it uses none.

    Raises InputError where one has expired, for then nobody can join, and where a file is missing or cannot be used.
    """
    identity = Identity.of(settings, "router")
    if identity is None:
        return
    for path in (identity.ca, identity.own):
        certificate = read_certificate(path)
        finding = dated(path.name, certificate, str(path), identity.ca.parent)
        if certificate.not_valid_after_utc < datetime.now(UTC):
            where, mend = str(identity.ca.parent), f"{finding.found}; {finding.mend}"
            raise InputError("LUXLOOP_CERTS", where, "certificates that have not expired", mend)
        yield finding


def dated(what: str, certificate: x509.Certificate, path: str, folder: Path) -> Finding:
    """Whether a certificate is in its time, and for how long yet; `folder` holds the set."""
    now, begin, end = datetime.now(UTC), certificate.not_valid_before_utc, certificate.not_valid_after_utc
    renew = RENEW.format(folder=folder) if (folder / "ca.key").exists() else RENEW_AFAR
    mend = renew if what != "ca.pem" else "make a new set in another folder: luxloop certs"
    if now < begin:
        return Finding(what, "fail", f"{path} is valid from {begin:%Y-%m-%d %H:%M} UTC only", "set the clock (NTP)")
    if now > end:
        return Finding(what, "fail", f"{path} has expired on {end:%Y-%m-%d %H:%M} UTC", mend)
    soon = end - now < timedelta(days=SOON_DAYS)
    found = f"{path}, valid until {end:%Y-%m-%d}" + f", {(end - now).days} days" * soon
    return Finding(what, "warn" if soon else "ok", found, mend if soon else "")


def _closed(what: str, path: Path, found: str) -> Finding:
    """`found`, unless the file's group or others may read the key in it."""
    mode = path.stat().st_mode & 0o777
    if not mode & 0o077:
        return Finding(what, "ok", found)
    verdict: Verdict = "fail" if mode & 0o007 else "warn"
    who = "everybody" if mode & 0o007 else "its group"
    return Finding(what, verdict, f"{path} is open to {who} (mode {mode:04o})", f"chmod 600 {path}")


def _folder(folder: Path) -> Iterator[Finding]:
    """What others may write, they may replace: the CA that we trust, and our own key."""
    mode = folder.stat().st_mode & 0o777
    if mode & 0o022:
        verdict: Verdict = "fail" if mode & 0o002 else "warn"
        who = "everybody" if mode & 0o002 else "its group"
        found = f"{who} may write in {folder} (mode {mode:04o}), and so replace what is trusted here"
        yield Finding(f"folder {folder.name}", verdict, found, f"chmod 700 {folder}")


def _common_name(certificate: x509.Certificate) -> str:
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def admission(settings: Settings, identity: Identity) -> Finding:
    """Whether the router turns away who shows no certificate."""
    if lets_anybody_in(settings, identity):
        mend = "is this the router of luxloop? start it with LUXLOOP_CERTS set"
        return Finding("admission", "fail", f"{settings.router} takes who shows no certificate", mend)
    return Finding("admission", "ok", "who shows no certificate is turned away")


def permissions(bus: Bus, settings: Settings, role: Role) -> Finding:
    """Whether a question that `role` may ask reaches the controller, and one that it may not does not."""
    kind = WORKERS.get(role)
    if role not in ("client", *WORKERS):
        return Finding("permissions", "ok", f"not tested: {role} asks nothing of the controller")
    may = at(settings.realm, "pull", kind=kind) if kind else at(settings.realm, "status")
    may_not = at(settings.realm, "status") if kind else at(settings.realm, "pull", kind="film")
    reached = {key: _reaches(bus, key) for key in (may, may_not)}
    if None in reached.values():
        return Finding("permissions", "warn", "not tested: no controller answers", "luxloop serve controller")
    if not reached[may]:
        mend = f"the router must be started after a change of release, and know the role: is {role}.pem of it?"
        return Finding("permissions", "fail", f"{role} may not ask {may}", mend)
    if reached[may_not]:
        mend = "is this the router of luxloop? start it with LUXLOOP_CERTS set"
        return Finding("permissions", "fail", f"the router lets {role} ask {may_not}", mend)
    return Finding("permissions", "ok", f"{role} may ask {may}, and may not ask {may_not}")


def _reaches(bus: Bus, key: str) -> bool | None:
    """Whether the controller answers a message that is none for this key; None where no controller is there."""
    try:
        bus.ask(key, encode(Nothing()), ASK_S)
    except RemoteError as error:
        return None if error.failure.code in ("no_controller", "no_router") else False
    return True
