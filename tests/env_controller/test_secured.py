"""A set over mTLS does what a plain one does, with real processes: films, rays, runs, restarts, the doctor."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from containers.thin_film.packing import unpack
from containers.thin_film.table import FilmTable
from env_controller.certs import make
from luxloop.bus.identity import Identity, refusal
from luxloop.bus.zenoh_bus import ZenohBus
from luxloop.campaign import Action, Step
from luxloop.client import Client
from luxloop.door import RunDoor
from luxloop.errors import RemoteError
from luxloop.film import FilmTableRequest, Spectrum
from luxloop.model import Environment
from luxloop.ray import RayRequest
from luxloop.settings import Settings
from luxloop.words import parse
from tests.campaign_runs import plan_of
from tests.conftest import processes_with, start, stop, wait_for
from tests.doctor import doctor
from tests.secured_set import SecuredSet, free_tls_endpoint, running_router


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredSet]:
    """Router, controller and pretended workers."""
    secured = SecuredSet(tmp_path_factory.mktemp("lab"))
    yield secured
    secured.close()


def test_a_client_starts_a_secured_set_that_computes_a_film_and_rays(tmp_path: Path) -> None:
    """As `luxloop run` does: the set is encrypted, PC3 gets PC2's table by its hash, and nothing is left behind."""
    make(tmp_path / "certs", days=2)
    places = {name: tmp_path / name for name in ("certs", "cache", "runs", "effects")}
    settings = Settings(router="tls/127.0.0.1:1", **places)
    with Client(settings, patience_s=120.0) as client:
        assert client.settings.router.startswith("tls/127.0.0.1:")
        plain = {"certs": None, "router": client.settings.router.replace("tls/", "tcp/")}
        with pytest.raises(RemoteError, match="speaks TLS"):
            ZenohBus(client.settings.model_copy(update=plain))
        film = client.run(FilmTableRequest(environment=Environment(), dbr_pairs=6.5, spectrum=Spectrum()))
        sha256, size = str(film.result["table_sha256"]), int(film.result["table_bytes"])
        table = FilmTable.from_parts(*unpack(client.fetch(sha256, size)))
        assert 0.0 < table.at(table.average("inside").R, 0.5) < 1.0
        design = {"distance_um": 180.0, "width_um": 28.0, "spacing_um": 500.0, "thickness_um": 35.0, "dbr_pairs": 6.5}
        wanted = {"environment": {}, "design": design, "film": {"sha256": sha256, "bytes": size}, "histories": 20_000}
        rays = client.run(parse(RayRequest, wanted))
        assert 0.5 < rays.result["metrics"]["uniformity"]["value"] < 1.0
    wait_for(lambda: not processes_with(f"LUXLOOP_CACHE={settings.cache}"), "the set to end")


def test_a_run_is_begun_acted_in_and_ended(lab: SecuredSet) -> None:
    """A designer's questions all get through: begin, act (which makes the controller ask both workers), note, end."""
    plan = plan_of("secured")
    with RunDoor.begin(lab.client, plan) as door:
        step = door.act(Action(run="secured", designer=door.designer, lane=0, number=0, design=plan.bounds.low))
        assert isinstance(step, Step)
        assert step.failure is None
        door.note(log="all is well")
        assert door.end("enough").records > 0


def test_the_doctor_finds_everything_in_order(lab: SecuredSet) -> None:
    """Exit 0: certificates, admission, permissions, router, controller, both workers; no finding but `ok`."""
    code, found = doctor(lab.settings)
    assert code == 0, found
    assert found["admission"]["verdict"] == found["permissions"]["verdict"] == found["controller"]["verdict"] == "ok"
    assert "status" in found["permissions"]["found"]
    assert {lab.worker("film"), lab.worker("ray")} < set(found)


@pytest.mark.parametrize(("role", "kind"), [("thin-film", "film"), ("ray-tracing", "ray")])
def test_the_doctor_of_a_worker_s_host(lab: SecuredSet, role: str, kind: str) -> None:
    """With that role's folder only: it may pull its own kind, and may not ask status."""
    code, found = doctor(lab.with_certs(lab.certs / role), "--role", role)
    assert code == 0, found
    assert found["permissions"]["verdict"] == "ok"
    assert f"pull/{kind}" in found["permissions"]["found"]
    assert "may not ask luxloop/1/status" in found["permissions"]["found"]


def test_a_worker_does_not_wait_for_a_router_that_refuses_it(lab: SecuredSet, tmp_path: Path) -> None:
    """Of another CA: it ends with 1 and says so, where it would wait for ever for a router that comes back."""
    other = make(tmp_path / "other", days=2).folder
    worker = start(lab.with_certs(other), "-m", "luxloop", "serve", "thin-film", "--quiet")
    try:
        assert worker.wait(60) == 1
    finally:
        stop(worker)


def test_the_name_in_the_endpoint_must_be_the_router_s(lab: SecuredSet) -> None:
    """An address that its certificate does not name: the command that adds it is in the mend."""
    elsewhere = lab.settings.model_copy(update={"router": lab.settings.router.replace("127.0.0.1", "127.0.0.2")})
    with running_router(elsewhere):
        identity = Identity.of(elsewhere, "client")
        failure = refusal(elsewhere, identity)
    assert failure is not None
    assert "not for 127.0.0.2" in failure.message
    assert "--host 127.0.0.2" in failure.mend


def test_renewed_certificates_are_used_after_a_router_restart(tmp_path: Path) -> None:
    """Sessions come back by themselves with the new files: no process but the router need be started again."""
    certs = make(tmp_path / "certs", days=2).folder
    settings = Settings(certs=certs, router=free_tls_endpoint(), cache=tmp_path / "cache", runs=tmp_path / "runs")
    with running_router(settings):
        bus = ZenohBus(settings, patient=True)
    make(certs, days=2, renew=True)
    with bus, running_router(settings):
        wait_for(bus.connected, "the session to come back")
