"""A lab's own certificate authority, and one certificate with its private key for each role.

    DIR/ca.pem            the CA's certificate, written last: a folder without it is no set
    DIR/.unfinished       while a new set is made: a ca.key beside it has signed nothing that is in use
    DIR/ca.key            its private key: needed to renew, by no process
    DIR/<role>/ca.pem     the same certificate again, so that one folder is all that a host or container needs
    DIR/<role>/<role>.pem the role's certificate and its private key, in one file that is replaced in one step

Only the router's certificate says `serverAuth` and names hosts: no other role's key can pose as the router.
"""

from __future__ import annotations

import ipaddress
import os
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from luxloop.bus.access import ROLES
from luxloop.errors import InputError, LuxloopError

HOSTS = ("localhost", "127.0.0.1", "::1", "router")
"""Names the router is reached by in any case: on its own machine, and as the service of docker compose."""
CA_DAYS = 3650
SOON_DAYS = 30
CA_NAME = "luxloop lab CA"
UNFINISHED = ".unfinished"
IGNORE = ".gitignore"
EARLY = timedelta(minutes=5)  # a host whose clock is a little behind takes a new certificate, too


@dataclass(frozen=True)
class Authority:
    """A CA that can sign: its certificate and its private key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @classmethod
    def new(cls, name: str = CA_NAME) -> Authority:
        """A new CA on the curve P-256, valid for ten years."""
        key, subject, now = ec.generate_private_key(ec.SECP256R1()), _name(name), datetime.now(UTC)
        usage = x509.KeyUsage(
            digital_signature=True,
            key_cert_sign=True,
            crl_sign=True,
            content_commitment=False,
            key_encipherment=False,
            data_encipherment=False,
            key_agreement=False,
            encipher_only=False,
            decipher_only=False,
        )
        builder = (
            _builder(subject, subject, key.public_key(), now - EARLY, now + timedelta(days=CA_DAYS))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(usage, critical=True)
        )
        return cls(builder.sign(key, hashes.SHA256()), key)

    @classmethod
    def read(cls, folder: Path) -> Authority:
        """The CA in `folder`. Raises InputError where it is not there, or key and certificate do not fit together."""
        certificate = read_certificate(folder / "ca.pem")
        try:
            key = serialization.load_pem_private_key((folder / "ca.key").read_bytes(), password=None)
        except (OSError, ValueError, TypeError) as error:
            mend = "bring ca.key back, or make a new set in another folder"
            raise InputError("certs", str(folder / "ca.key"), "the CA's private key", mend) from error
        if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
            raise InputError("certs", str(folder / "ca.key"), "the private key of ca.pem", "they are of two sets")
        return cls(certificate, key)

    def issue(self, role: str, hosts: Iterable[str], begin: datetime, end: datetime) -> bytes:
        """The certificate of `role`, followed by its new private key, as PEM; `hosts` are for the router only."""
        key = ec.generate_private_key(ec.SECP256R1())
        usages = [ExtendedKeyUsageOID.CLIENT_AUTH] + [ExtendedKeyUsageOID.SERVER_AUTH] * (role == "router")
        names = [_general_name(host) for host in hosts] if role == "router" else [x509.DNSName(role)]
        certificate = (
            _builder(_name(role), self.certificate.subject, key.public_key(), begin, end)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(x509.SubjectAlternativeName(names), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self.key.public_key()), critical=False)
            .sign(self.key, hashes.SHA256())
        )
        return certificate.public_bytes(serialization.Encoding.PEM) + _pem(key)


@dataclass(frozen=True)
class Made:
    """A set that was made or renewed, or left as it was."""

    folder: Path
    roles: tuple[str, ...]
    hosts: tuple[str, ...]
    valid_until: datetime
    ca_valid_until: datetime
    what: str


def make(
    folder: Path, *, days: int, hosts: tuple[str, ...] = (), renew: bool = False, if_needed: bool = False
) -> Made:
    """Make the set in `folder`, renew it, or leave it as it is, as the options say.

    Raises InputError where a set is there already, where a CA's key is there alone, and where a set is to be renewed
    and its CA cannot sign; LuxloopError where the folder cannot be written. Killed at any moment it leaves no
    `ca.pem`, or (renewing) certificates that are old or new, each with its own key.
    """
    there = (folder / "ca.pem").exists()
    if not there:
        _refuse_lone_key(folder)
        _refuse_another_s(folder)
    if there and if_needed and not (lacks := what_it_lacks(folder, hosts)):
        return _made(folder, "left as it is")
    if there and not (renew or if_needed):
        mend = "--renew keeps its CA and renews the rest; --out names another folder"
        raise InputError("out", str(folder), "a folder without a set", mend)
    if renew and not there:
        raise InputError(
            "renew", str(folder), "a folder with a set (ca.pem, ca.key)", "leave --renew out to make one"
        )
    authority = Authority.read(folder) if there else Authority.new()
    hosts = tuple(dict.fromkeys([*HOSTS, *_known_hosts(folder), *hosts]))
    end = min(datetime.now(UTC) + timedelta(days=days), authority.certificate.not_valid_after_utc)
    try:
        _write(folder, authority, hosts, end)
    except OSError as error:
        raise LuxloopError(f"cannot write {folder}: {error.strerror}; name another folder by --out") from error
    return _made(folder, f"renewed ({lacks})" if there and if_needed else "renewed" if there else "made")


def _refuse_lone_key(folder: Path) -> None:
    """InputError where a CA's key lies without its certificate, and a set that we began is not what it belongs to."""
    key = folder / "ca.key"
    if os.path.lexists(key) and not (folder / UNFINISHED).exists():
        mend = (
            f"bring {folder / 'ca.pem'} back (the folder of each role has the same file), or move {folder} away for a"
            f" new set, or name another by --out; is it the rest of a run that was killed, remove {key}"
        )
        raise InputError("out", str(key), "no key of a CA where a new CA is made", mend)


def _refuse_another_s(folder: Path) -> None:
    """InputError where a folder holds anything, and no set that is whole or was begun: nothing is touched there."""
    with suppress(OSError):  # what cannot be looked into cannot be written either: that is told then
        if all(path.name == IGNORE for path in folder.iterdir()) or (folder / UNFINISHED).exists():
            return
        mend = f"name a new one: --out {folder / 'certs'}; is it the rest of a set, move it away"
        raise InputError("out", str(folder), "an empty folder, a new one, or one with a set", mend)


def what_it_lacks(folder: Path, hosts: Iterable[str] = ()) -> str:
    """Why the set in `folder` should be renewed; empty where it is whole and good for 30 days more."""
    soon = datetime.now(UTC) + timedelta(days=SOON_DAYS)
    try:
        authority = read_certificate(folder / "ca.pem")
        for role in ROLES:
            certificate = read_certificate(role_file(folder, role))
            certificate.verify_directly_issued_by(authority)
            if certificate.not_valid_after_utc < soon:
                return f"{role}'s certificate ends on {certificate.not_valid_after_utc:%Y-%m-%d}"
            if role == "router" and (new := sorted(set(hosts) - set(hosts_of(certificate)))):
                return f"the router is not known as {', '.join(new)}"
    except InputError as error:
        return f"{error.value} is missing or damaged"
    except Exception as error:  # noqa: BLE001  cryptography raises several kinds for a signature that does not fit
        return f"a certificate is of another CA ({type(error).__name__})"
    return ""


def role_file(folder: Path, role: str) -> Path:
    """Where a whole set keeps a role's certificate and key."""
    return folder / role / f"{role}.pem"


def read_certificate(path: Path) -> x509.Certificate:
    """The certificate in a PEM file. Raises InputError naming the file."""
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "no certificate in it"
        raise InputError("certs", str(path), "a certificate (PEM)", f"{why}: luxloop certs makes a set") from error


def hosts_of(certificate: x509.Certificate) -> tuple[str, ...]:
    """The names and addresses that a certificate is for."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    return tuple(str(name.value) for name in names)


def _write(folder: Path, authority: Authority, hosts: Iterable[str], end: datetime) -> None:
    """Roles first, the CA last, each file in one step; a new set bears a mark until it is whole."""
    begin = max(datetime.now(UTC) - EARLY, authority.certificate.not_valid_before_utc)
    ca = authority.certificate.public_bytes(serialization.Encoding.PEM)
    _private_folder(folder)
    if not (folder / "ca.pem").exists():
        (folder / UNFINISHED).touch()
        if not (folder / IGNORE).exists():
            _replace(folder / IGNORE, b"*\n", 0o644)  # keys belong into no repository
    for left in _left_behind(folder):
        left.unlink()
    for role in ROLES:
        _private_folder(folder / role)
        _replace(role_file(folder, role), authority.issue(role, hosts, begin, end), 0o600)
        _replace(folder / role / "ca.pem", ca, 0o644)
    _replace(folder / "ca.key", _pem(authority.key), 0o600)
    _replace(folder / "ca.pem", ca, 0o644)
    (folder / UNFINISHED).unlink(missing_ok=True)


def _left_behind(folder: Path) -> list[Path]:
    """What `_replace` wrote in a run that was killed."""
    files = [folder / name for name in (IGNORE, "ca.key", "ca.pem")]
    files += [folder / role / name for role in ROLES for name in (f"{role}.pem", "ca.pem")]
    return [left for file in files for left in file.parent.glob(f".{file.name}-*")]


def _known_hosts(folder: Path) -> tuple[str, ...]:
    """The router's names so far; none where its certificate is missing or damaged."""
    try:
        return hosts_of(read_certificate(role_file(folder, "router")))
    except InputError:
        return ()


def _private_folder(folder: Path) -> None:
    """Make a folder that its owner alone may enter; one that is there stays as open as it is."""
    try:
        folder.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        if not folder.is_dir():
            raise
        return
    folder.chmod(0o700)  # whatever the umask


def _replace(path: Path, content: bytes, mode: int) -> None:
    """Write a file that is either as before or whole, and at no moment open to others."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}-")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
            os.fchmod(file.fileno(), mode)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _made(folder: Path, what: str) -> Made:
    router, ca = read_certificate(role_file(folder, "router")), read_certificate(folder / "ca.pem")
    ends = [read_certificate(role_file(folder, role)).not_valid_after_utc for role in ROLES]
    return Made(folder, ROLES, hosts_of(router), min(ends), ca.not_valid_after_utc, what)


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, begin: datetime, end: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(end)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
