"""The lab's certificates: what a set holds, how it is renewed, what is refused, what the doctor finds."""

from __future__ import annotations

import json
import os
import ssl
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from env_controller import certs as certs_module
from env_controller.certs import HOSTS, Authority, hosts_of, make, read_certificate, role_file, what_it_lacks
from env_controller.certs_command import _checked_host
from env_controller.health.certificates import certificates
from luxloop.bus.access import ROLES
from luxloop.bus.identity import Identity
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.endpoint import listening
from luxloop.errors import InputError, LuxloopError
from luxloop.settings import Settings, as_environment
from tests.conftest import stop, wait_for
from tests.doctor import ill
from tests.forks import luxloop
from tests.secured_set import free_tls_endpoint

DAY = timedelta(days=1)
ROOT = Path(__file__).parents[2]


def command(*argv: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """`luxloop certs ...` as a process of its own."""
    return luxloop("certs", *argv, cwd=cwd)


def found_by_the_doctor(folder: Path, *argv: str) -> dict[str, dict[str, Any]]:
    """What the doctor says of a folder of certificates, by what it looked at; no router is there."""
    settings = Settings(certs=folder, router=free_tls_endpoint(), cache=folder.parent / "cache")
    return ill(settings, *argv)


@pytest.fixture
def certs(tmp_path: Path) -> Path:
    """A whole set."""
    return make(tmp_path / "certs", days=90).folder


class TestASet:
    """What `luxloop certs` makes."""

    def test_each_role_has_a_certificate_of_the_one_ca(self, certs: Path) -> None:
        """CN = role, signed by the CA, and the private key in the same file fits; a copy of the CA's beside it."""
        authority = read_certificate(certs / "ca.pem")
        for role in ROLES:
            certificate = read_certificate(role_file(certs, role))
            certificate.verify_directly_issued_by(authority)
            (name,) = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
            assert name.value == role
            assert (certs / role / "ca.pem").read_bytes() == (certs / "ca.pem").read_bytes()
            ssl.create_default_context(cafile=str(certs / "ca.pem")).load_cert_chain(role_file(certs, role))

    def test_only_the_router_may_serve(self, certs: Path) -> None:
        """No other role's key can be used to listen in the router's place; all may connect."""
        for role in ROLES:
            certificate = read_certificate(role_file(certs, role))
            usage = set(certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
            assert ExtendedKeyUsageOID.CLIENT_AUTH in usage
            assert (ExtendedKeyUsageOID.SERVER_AUTH in usage) == (role == "router")
            assert (hosts_of(certificate) == HOSTS) == (role == "router")

    def test_keys_are_their_owner_s_alone(self, certs: Path) -> None:
        """0600 for what holds a private key, 0700 for folders, whatever the umask."""
        holds_key = [path for path in certs.rglob("*") if path.is_file() and b"PRIVATE KEY" in path.read_bytes()]
        assert {path.name for path in holds_key} == {"ca.key", *(f"{role}.pem" for role in ROLES)}
        assert {path.stat().st_mode & 0o777 for path in holds_key} == {0o600}
        folders = [certs, *(path for path in certs.iterdir() if path.is_dir())]
        assert {path.stat().st_mode & 0o777 for path in folders} == {0o700}

    def test_git_ignores_the_set_wherever_it_is_made(self, tmp_path: Path) -> None:
        """In somebody's repository; a set that is renewed leaves alone what is there."""
        subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
        certs = make(tmp_path / "lab-certs", days=90).folder
        told = subprocess.run(
            ["git", "-C", str(tmp_path), "status", "--porcelain", "--untracked-files=all"],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert told.stdout == ""
        (certs / ".gitignore").write_text("*.pem\n")
        make(certs, days=90, renew=True)
        assert (certs / ".gitignore").read_text() == "*.pem\n"

    def test_a_folder_of_which_only_that_is_left_gets_a_set(self, tmp_path: Path, certs: Path) -> None:
        """A set was moved away by `mv certs/* ...`."""
        (tmp_path / "away").mkdir()
        for path in certs.iterdir():
            if path.name != ".gitignore":
                path.rename(tmp_path / "away" / path.name)
        assert make(certs, days=90).what == "made"

    def test_the_clone_of_this_project_ignores_the_default_folder(self) -> None:
        """And keys in any other."""
        if not (ROOT / ".git").exists():
            pytest.skip("no clone")
        for path in ("certs/ca.key", "certs/router/router.pem", "docker/ca.key"):
            assert subprocess.run(["git", "-C", str(ROOT), "check-ignore", "-q", path], check=False).returncode == 0

    def test_a_clock_that_is_a_little_behind_takes_it(self, certs: Path) -> None:
        """Valid from some minutes ago, for the days asked for."""
        certificate = read_certificate(role_file(certs, "client"))
        now = datetime.now(UTC)
        assert certificate.not_valid_before_utc < now - timedelta(minutes=4)
        assert abs(certificate.not_valid_after_utc - now - 90 * DAY) < timedelta(minutes=1)

    def test_no_certificate_outlives_its_ca(self, certs: Path) -> None:
        """Asked for more days than the CA has, it ends with the CA."""
        made = make(certs, days=100_000, renew=True)
        assert made.valid_until == made.ca_valid_until


class TestAgain:
    """A folder that has a set already."""

    def test_a_set_is_not_overwritten(self, tmp_path: Path, certs: Path) -> None:
        """Exit code 2, both ways out named, nothing changed."""
        before = (certs / "ca.pem").read_bytes()
        done = command("--out", str(certs), cwd=tmp_path)
        assert done.returncode == 2
        assert "--renew" in done.stderr
        assert "--out" in done.stderr
        assert (certs / "ca.pem").read_bytes() == before

    def test_renewing_keeps_the_ca_and_the_hosts(self, certs: Path) -> None:
        """New keys for all roles, of the same CA; the router keeps its names and gets the new one."""
        make(certs, days=90, hosts=("pc1.lab",), renew=True)
        ca, keys = (certs / "ca.pem").read_bytes(), [role_file(certs, role).read_bytes() for role in ROLES]
        made = make(certs, days=5, hosts=("10.0.0.5",), renew=True)
        assert (certs / "ca.pem").read_bytes() == ca
        assert not set(keys) & {role_file(certs, role).read_bytes() for role in ROLES}
        assert made.hosts == (*HOSTS, "pc1.lab", "10.0.0.5")
        assert made.valid_until - datetime.now(UTC) < 6 * DAY

    def test_if_needed_leaves_a_good_set_alone(self, tmp_path: Path, certs: Path) -> None:
        """For a service that runs at every start: nothing happens until something is due, then it is said."""
        before = role_file(certs, "router").read_bytes()
        assert make(certs, days=90, if_needed=True).what == "left as it is"
        assert role_file(certs, "router").read_bytes() == before
        assert "pc9" in make(certs, days=90, hosts=("pc9",), if_needed=True).what
        assert make(certs, days=90, hosts=("pc9",), if_needed=True).what == "left as it is"
        for written in ("2001:DB8::1", "2001:db8:0::1"):
            made = make(certs, days=90, hosts=(_checked_host(written),), if_needed=True)
        assert (made.what, made.hosts) == ("left as it is", (*HOSTS, "pc9", "2001:db8::1"))
        make(certs, days=5, renew=True)
        assert "ends on" in make(certs, days=90, if_needed=True).what
        role_file(certs, "client").write_text("damaged")
        assert "client.pem is missing or damaged" in make(certs, days=90, if_needed=True).what
        assert what_it_lacks(certs) == ""
        assert make(tmp_path / "new", days=90, if_needed=True).what == "made"

    def test_renewing_needs_the_ca_s_key(self, certs: Path) -> None:
        """Missing, of another set, damaged: named; and no set at all."""
        (certs / "ca.key").write_bytes(b"damaged")
        with pytest.raises(InputError, match=r"ca\.key"):
            make(certs, days=90, renew=True)
        other = make(certs.parent / "other", days=90).folder
        (certs / "ca.key").write_bytes((other / "ca.key").read_bytes())
        with pytest.raises(InputError, match="two sets"):
            make(certs, days=90, renew=True)
        with pytest.raises(InputError, match="leave --renew out"):
            make(certs.parent / "nothing", days=90, renew=True)

    def test_a_ca_s_key_without_its_certificate_is_not_overwritten(self, certs: Path) -> None:
        """Whatever is asked for: both ways out are named, nothing is changed; a role's copy brings the set back."""
        (certs / "ca.pem").unlink()
        before = {path: path.read_bytes() for path in certs.rglob("*") if path.is_file()}
        for how in ({}, {"if_needed": True}, {"renew": True}):
            with pytest.raises(InputError, match=r"bring .*ca\.pem back.*move .* away.*remove .*ca\.key"):
                make(certs, days=90, **how)
        assert {path: path.read_bytes() for path in certs.rglob("*") if path.is_file()} == before
        (certs / "ca.pem").write_bytes((certs / "client" / "ca.pem").read_bytes())
        assert what_it_lacks(certs) == ""

    def test_a_folder_of_somebody_s_is_left_as_it_is(self, tmp_path: Path) -> None:
        """Not a set: refused with the way out; nothing is deleted there, and it stays as open as it was."""
        home = tmp_path / "home"
        (home / "editor").mkdir(parents=True)
        files = [home / ".notes.txt-draft", home / "editor" / ".a.swp-1"]
        for file in files:
            file.touch()
        home.chmod(0o755)
        for how in ({}, {"if_needed": True}):
            with pytest.raises(InputError, match=r"an empty folder, a new one.*--out"):
                make(home, days=90, **how)
        assert all(file.exists() for file in files)
        assert home.stat().st_mode & 0o777 == 0o755

    def test_in_a_set_only_what_it_left_itself_is_taken_away(self, certs: Path) -> None:
        """Others' hidden files beside it and below it stay; so does the mode that its owner gave a folder."""
        (certs / "backup").mkdir()
        kept = [certs / ".my.pem-old", certs / "backup" / ".ca.pem-old", certs / "client" / ".vimrc.x-y"]
        left = [certs / ".ca.pem-abc", certs / "client" / ".client.pem-abc"]
        for file in (*kept, *left):
            file.touch()
        certs.chmod(0o750)
        make(certs, days=90, renew=True)
        assert [file.exists() for file in (*kept, *left)] == [True] * 3 + [False] * 2
        assert certs.stat().st_mode & 0o777 == 0o750

    def test_an_empty_folder_and_one_that_is_missing_get_a_set(self, tmp_path: Path) -> None:
        """As a volume of docker compose is: with a folder of its own in it, which is nobody else's to enter."""
        assert make(tmp_path, days=90, if_needed=True).what == "made"
        made = make(tmp_path / "volume" / "lab", days=90, if_needed=True)
        assert made.folder.stat().st_mode & 0o777 == 0o700

    def test_a_place_that_cannot_be_written_is_named(self, tmp_path: Path) -> None:
        """A file in the way."""
        (tmp_path / "file").touch()
        with pytest.raises(LuxloopError, match=r"cannot write .*file.*--out"):
            make(tmp_path / "file" / "certs", days=90)


class TestTheCommand:
    """`luxloop certs` as it is typed."""

    def test_it_tells_what_was_made(self, tmp_path: Path) -> None:
        """As text and as one JSON object: folder, roles, hosts, until when."""
        done = command("--out", "c", "--host", "pc1.lab", "--days", "30", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "router, controller, client, thin-film, ray-tracing" in done.stdout
        assert "pc1.lab" in done.stdout
        told = json.loads(command("--out", "c", "--renew", "--json", cwd=tmp_path).stdout)
        assert told["what"] == "renewed"
        assert told["roles"] == list(ROLES)
        assert told["hosts"] == [*HOSTS, "pc1.lab"]
        assert datetime.fromisoformat(told["valid_until"]) > datetime.now(UTC) + 360 * DAY

    @pytest.mark.parametrize("host", ["", "a b", "pc1:7447", "tls/pc1", "*.lab", "1.2.3"])
    def test_what_is_no_host_is_refused(self, tmp_path: Path, host: str) -> None:
        """Exit code 2 with an example, nothing made."""
        done = command("--out", "c", "--host", host, cwd=tmp_path)
        assert done.returncode == 2
        assert "--host pc1.lab" in done.stderr
        assert not (tmp_path / "c").exists()


class TestKilled:
    """A run that ends between any two files it writes, or in the middle of one."""

    def cut(self, folder: Path, after: int, monkeypatch: pytest.MonkeyPatch, *, renew: bool = False) -> bool:
        """Make or renew a set, ended when so many files have been written; whether that was before the end."""
        written: list[Path] = []

        def replace(path: Path, content: bytes, mode: int) -> None:
            if len(written) == after:
                (path.parent / f".{path.name}-left").write_bytes(content[:100])
                raise KeyboardInterrupt
            written.append(path)
            whole(path, content, mode)

        whole = certs_module._replace
        with monkeypatch.context() as patch:
            patch.setattr(certs_module, "_replace", replace)
            try:
                make(folder, days=90, renew=renew)
            except KeyboardInterrupt:
                return True
        return False

    def test_a_new_set_is_whole_or_none(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Cut after any file there is no ca.pem, so no process starts with it; the next run makes it whole."""
        files = 2 * len(ROLES) + 3
        for after in range(files):
            folder = tmp_path / f"c{after}"
            assert self.cut(folder, after, monkeypatch)
            assert not (folder / "ca.pem").exists()
            make(folder, days=90)
            assert what_it_lacks(folder) == ""
            assert list(folder.rglob(".*")) == [folder / ".gitignore"]
        assert not self.cut(tmp_path / "last", files, monkeypatch)

    def test_a_renewed_set_is_whole_at_every_moment(self, certs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        """Cut after any file each role has its old certificate or its new one, with the key that belongs to it."""
        for after in range(2 * len(ROLES) + 2):
            assert self.cut(certs, after, monkeypatch, renew=True)
            assert what_it_lacks(certs) == ""
            for role in ROLES:
                Identity(role, certs / "ca.pem", role_file(certs, role)).check()


class TestFilesThatCannotBeUsed:
    """A process refuses to start with them, says which, and how to mend it."""

    def settings(self, folder: Path) -> Settings:
        """Settings with these certificates."""
        return Settings(certs=folder, router=free_tls_endpoint(), cache=folder.parent / "cache")

    def refused(self, folder: Path) -> str:
        """What opening a session says; there is no router, and it does not come to that."""
        with pytest.raises(InputError) as caught:
            ZenohBus(self.settings(folder))
        assert caught.value.field == "LUXLOOP_CERTS"
        return str(caught.value)

    def test_a_folder_that_is_not_there(self, tmp_path: Path) -> None:
        """The mend makes one."""
        assert "luxloop certs" in self.refused(tmp_path / "nowhere")

    def test_another_role_s_folder(self, certs: Path) -> None:
        """A worker's folder has no certificate of a client."""
        assert "client.pem" in self.refused(certs / "thin-film")

    def test_a_set_that_was_never_finished(self, certs: Path) -> None:
        """Without ca.pem, however many roles are there."""
        (certs / "ca.pem").unlink()
        assert "ca.pem" in self.refused(certs)

    def test_a_key_that_others_can_read(self, certs: Path) -> None:
        """The command that closes it is named."""
        role_file(certs, "client").chmod(0o644)
        assert f"chmod 600 {role_file(certs, 'client')}" in self.refused(certs)

    def test_a_damaged_file_and_a_key_of_another(self, certs: Path) -> None:
        """What is no certificate; a certificate with a key that is not its own."""
        theirs, ours = role_file(certs, "router").read_bytes(), role_file(certs, "client").read_bytes()
        role_file(certs, "client").write_bytes(ours[: ours.index(b"-----BEGIN PRIVATE")])
        assert "client.pem" in self.refused(certs)
        mixed = ours[: ours.index(b"-----BEGIN PRIVATE")] + theirs[theirs.index(b"-----BEGIN PRIVATE") :]
        role_file(certs, "client").write_bytes(mixed)
        assert "client.pem" in self.refused(certs)

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
    def test_a_file_that_we_may_not_read(self, certs: Path) -> None:
        """Somebody else's."""
        role_file(certs, "client").chmod(0o000)
        assert "Permission denied" in self.refused(certs)

    def test_a_role_s_own_folder_is_enough(self, certs: Path) -> None:
        """What a container mounts: found there, and by the whole set's folder alike."""
        alone = Identity.of(self.settings(certs / "thin-film"), "thin-film")
        whole = Identity.of(self.settings(certs), "thin-film")
        assert alone is not None
        assert whole is not None
        assert alone.own == whole.own == role_file(certs, "thin-film")


class TestTheRouter:
    """What it says of its certificates when it starts."""

    def started(self, certs: Path, *argv: str) -> subprocess.CompletedProcess[str]:
        """A router that is ended as soon as it listens."""
        settings = Settings(certs=certs, router=free_tls_endpoint(), cache=certs.parent / "cache")
        process = subprocess.Popen(
            [sys.executable, "-m", "luxloop", "serve", "router", *argv],
            env=as_environment(settings), text=True, stderr=subprocess.PIPE,
        )  # fmt: skip
        try:
            wait_for(lambda: process.poll() is not None or listening(settings.router), "the router")
            process.terminate()
            _, said = process.communicate(timeout=20)
        finally:
            stop(process)
        return subprocess.CompletedProcess([], process.returncode, "", said)

    def test_one_that_has_expired_does_not_start(self, certs: Path) -> None:
        """Nobody could join: which file, since when, and the command that renews it."""
        now = datetime.now(UTC)
        old = Authority.read(certs).issue("router", HOSTS, now - 2 * DAY, now - DAY)
        role_file(certs, "router").write_bytes(old)
        done = self.started(certs, "--quiet")
        assert done.returncode == 2
        assert f"{role_file(certs, 'router')} has expired on {now - DAY:%Y-%m-%d}" in done.stderr
        assert f"luxloop certs --renew --out {certs}" in done.stderr

    @pytest.mark.parametrize(("days", "argv", "warned"), [(9, (), True), (9, ("--quiet",), False), (90, (), False)])
    def test_one_that_ends_soon_is_told(self, certs: Path, days: int, argv: tuple[str, ...], warned: bool) -> None:
        """It starts all the same."""
        make(certs, days=days, renew=True)
        done = self.started(certs, *argv)
        assert done.returncode == 0, done.stderr
        assert ("valid until" in done.stderr and "--renew" in done.stderr) == warned
        assert "ca.pem" not in done.stderr


class TestTheDoctor:
    """What it finds in a folder of certificates."""

    def test_a_good_set(self, certs: Path) -> None:
        """Every file is named with the day it ends."""
        found = found_by_the_doctor(certs)
        for role in ROLES:
            assert found[f"{role}.pem"]["verdict"] == "ok"
            assert "valid until" in found[f"{role}.pem"]["found"]
        assert found["ca.pem"]["verdict"] == found["ca.key"]["verdict"] == "ok"
        assert found["router"]["verdict"] == "fail"

    def test_a_role_s_own_folder(self, certs: Path) -> None:
        """On a worker's host the doctor shows that worker's certificate, and looks at no other."""
        found = found_by_the_doctor(certs / "thin-film", "--role", "thin-film")
        assert found["thin-film.pem"]["verdict"] == "ok"
        assert not {"client.pem", "router.pem", "ca.key"} & set(found)

    def test_every_fault_is_found_and_has_a_mend(self, certs: Path) -> None:
        """Expired, soon to end, of another role, of another CA, open to the group, open to all, missing."""
        authority, now = Authority.read(certs), datetime.now(UTC)
        role_file(certs, "router").write_bytes(authority.issue("router", HOSTS, now - 2 * DAY, now - DAY))
        role_file(certs, "controller").write_bytes(authority.issue("controller", (), now - DAY, now + 9.5 * DAY))
        role_file(certs, "thin-film").write_bytes(authority.issue("ray-tracing", (), now - DAY, now + 90 * DAY))
        role_file(certs, "ray-tracing").write_bytes(
            Authority.new().issue("ray-tracing", (), now - DAY, now + 90 * DAY)
        )
        role_file(certs, "client").unlink()
        (certs / "ca.key").chmod(0o640)
        found = found_by_the_doctor(certs)
        said = {what: (found[what]["verdict"], found[what]["found"], found[what]["mend"]) for what in found}
        for what, verdict, text, mend in (
            ("router.pem", "fail", "has expired", "--renew"),
            ("controller.pem", "warn", "9 days", "--renew"),
            ("thin-film.pem", "fail", "certificate of 'ray-tracing'", "luxloop certs"),
            ("ray-tracing.pem", "fail", "not signed by the CA", "one set"),
            ("client.pem", "fail", "client.pem", "luxloop certs"),
            ("ca.key", "warn", "open to its group", "chmod 600"),
        ):
            assert said[what][0] == verdict, what
            assert text in said[what][1], what
            assert mend in said[what][2], what
        (certs / "ca.key").chmod(0o604)
        assert found_by_the_doctor(certs)["ca.key"]["verdict"] == "fail"

    @pytest.mark.parametrize(
        ("mode", "verdict", "who"), [(0o777, "fail", "everybody"), (0o770, "warn", "its group"), (0o755, "", "")]
    )
    def test_a_folder_that_others_may_write(self, certs: Path, mode: int, verdict: str, who: str) -> None:
        """Who may write there may replace the CA that is trusted: of the set, and of a role, alone or in its set."""
        settings = Settings(certs=certs, cache=certs.parent / "cache", router=free_tls_endpoint())
        alone = settings.model_copy(update={"certs": certs / "client"})
        for folder, seen_by in ((certs, settings), (certs / "client", settings), (certs / "client", alone)):
            folder.chmod(mode)
            found = {finding.what: finding for finding in certificates(seen_by, "client")}
            folder.chmod(0o700)
            finding = found.pop(f"folder {folder.name}", None)
            assert {one.verdict for one in found.values()} == {"ok"}
            assert (finding.verdict if finding else "") == verdict
            if finding:
                assert who in finding.found
                assert finding.mend == f"chmod 700 {folder}"

    def test_a_role_s_own_folder_is_renewed_where_the_ca_is(self, certs: Path) -> None:
        """A worker's host has no ca.key: the mend does not send anybody to renew there."""
        make(certs, days=5, renew=True)
        alone = Settings(certs=certs / "client", cache=certs.parent / "cache", router=free_tls_endpoint())
        found = {finding.what: finding for finding in certificates(alone, "client")}
        assert found["client.pem"].verdict == "warn"
        assert "where the set's ca.key is" in found["client.pem"].mend

    def test_a_plain_set_that_others_can_reach_is_a_warning(self, tmp_path: Path) -> None:
        """On loopback it is in order; at an address of a network whoever reaches it may join."""
        (here,) = certificates(Settings(cache=tmp_path), "client")
        (there,) = certificates(Settings(cache=tmp_path, router="tcp/10.0.0.5:7447"), "client")
        assert (here.verdict, there.verdict) == ("ok", "warn")
        assert "LUXLOOP_CERTS" in there.mend
