"""docker-compose.yml and the Dockerfile, as far as they can be judged without an engine: docker/check.sh uses one."""

from __future__ import annotations

import re
import runpy
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from luxloop.bus.access import ROLES

ROOT = Path(__file__).parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
SERVICES: dict[str, dict[str, Any]] = COMPOSE["services"]
DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text()
LASTING = ("router", "pc1", "pc2", "pc3")
ONE_SHOT = ("certs", "campaign")
ROLE_OF = {"router": "router", "pc1": "controller", "pc2": "thin-film", "pc3": "ray-tracing", "campaign": "client"}
each_service = pytest.mark.parametrize("name", SERVICES)


def mounts(service: dict[str, Any]) -> dict[str, tuple[str, bool]]:
    """Target -> (source, whether it is read-only) of a service's mounts, written in the short or the long way."""
    found = {}
    for volume in service["volumes"]:
        if isinstance(volume, str):
            source, target, *mode = volume.split(":")
            found[target] = source, mode == ["ro"]
        else:
            found[volume["target"]] = volume["source"], volume.get("read_only", False)
    return found


def test_these_are_the_services() -> None:
    """The set of the design: certificates once, router, PC1 to PC3, and the campaign."""
    assert set(SERVICES) == {*LASTING, *ONE_SHOT}


@each_service
def test_a_service_can_do_no_more_than_it_must(name: str) -> None:
    """Not root, root file system read-only, no capability, none to be gained, bounded in memory and processes."""
    service = SERVICES[name]
    assert service["user"] == "${UID:-1000}:${GID:-1000}"
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert "cap_add" not in service
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service.get("privileged", False) is False
    assert {"mem_limit", "pids_limit", "stop_grace_period"} <= set(service)
    assert service["init"] is True


@each_service
def test_nothing_is_published(name: str) -> None:
    """No port on the host, no host network, and the services' own network leads nowhere else."""
    service = SERVICES[name]
    assert "ports" not in service
    assert service.get("network_mode", "none") == "none"
    assert service.get("networks", []) == ([] if name == "certs" else ["bus"])
    assert COMPOSE["networks"]["bus"] == {"internal": True}


@pytest.mark.parametrize("name", LASTING)
def test_a_lasting_service_says_how_it_is(name: str) -> None:
    """A health check with a start period that a compilation fits into; what dies is started again."""
    check = SERVICES[name]["healthcheck"]
    assert check["test"][:3] == ["CMD", "python", "/opt/luxloop/healthy.py"]
    assert int(check["start_period"].removesuffix("s")) >= 120
    assert SERVICES[name]["restart"] == "unless-stopped"


@pytest.mark.parametrize("name", ONE_SHOT)
def test_a_one_shot_service_is_not_started_again(name: str) -> None:
    """A campaign that has ended has ended."""
    assert SERVICES[name]["restart"] == "no"


def test_the_campaign_waits_for_all_and_all_for_the_certificates() -> None:
    """Nothing starts before what it needs is healthy."""
    assert set(SERVICES["campaign"]["depends_on"]) == {"pc1", "pc2", "pc3"}
    assert all(one == {"condition": "service_healthy"} for one in SERVICES["campaign"]["depends_on"].values())
    assert all(SERVICES[name]["depends_on"] == {"router": {"condition": "service_healthy"}} for name in LASTING[1:])
    assert SERVICES["router"]["depends_on"] == {"certs": {"condition": "service_completed_successfully"}}


def test_every_role_has_its_certificate_and_no_other() -> None:
    """Each service mounts its own role's folder read-only and talks TLS; no role is left out."""
    assert set(ROLE_OF.values()) == set(ROLES)
    for name, role in ROLE_OF.items():
        (volume,) = [one for one in SERVICES[name]["volumes"] if isinstance(one, dict)]
        assert volume["target"] == SERVICES[name]["environment"]["LUXLOOP_CERTS"] == "/certs"
        assert (volume["source"], volume["read_only"]) == ("certs", True)
        assert volume["volume"] == {"subpath": f"lab/{role}"}
        assert SERVICES[name]["environment"]["LUXLOOP_ROUTER"].startswith("tls/")


def test_runs_and_effects_lie_on_the_host() -> None:
    """Who writes runs mounts ./runs; the workers see ./effects and cannot change it."""
    for name in ("pc1", "campaign"):
        assert mounts(SERVICES[name])["/luxloop/runs"] == ("./runs", False)
        assert SERVICES[name]["environment"]["LUXLOOP_RUNS"] == "/luxloop/runs"
    for name in ("pc2", "pc3"):
        assert mounts(SERVICES[name])["/luxloop/effects"] == ("./effects", True)
        assert SERVICES[name]["environment"]["LUXLOOP_EFFECTS"] == "/luxloop/effects"


def test_every_named_volume_is_declared() -> None:
    """No service names a volume that compose does not know, and none is declared in vain."""
    named = {source for service in SERVICES.values() for source, _ in mounts(service).values()}
    assert {source for source in named if not source.startswith(".")} == set(COMPOSE["volumes"])


def test_each_service_is_built_here_from_a_target_that_is_there() -> None:
    """All images come from the one Dockerfile."""
    targets = set(re.findall(r"^FROM \S+ AS (\S+)$", DOCKERFILE, re.MULTILINE))
    for service in SERVICES.values():
        assert service["build"]["dockerfile"] == "docker/Dockerfile"
        assert service["image"] == f"luxloop-{service['build']['target']}:${{IMAGE_TAG:-latest}}"
        assert service["build"]["target"] in targets


def test_the_dockerfile_needs_no_other_front_end_and_takes_its_base_as_an_argument() -> None:
    """No `# syntax=` line (it would be pulled), and every stage stands on BASE_IMAGE."""
    assert "syntax=" not in DOCKERFILE
    sources = re.findall(r"^FROM (\S+) AS (\S+)$", DOCKERFILE, re.MULTILINE)
    known = {"${BASE_IMAGE}"}
    for source, name in sources:
        assert source in known
        known.add(name)


@pytest.mark.parametrize("target", ["core", "workers", "designer"])
def test_an_image_runs_as_nobody_by_default(target: str) -> None:
    """Started by hand, too, no image is root; each enters the same way."""
    stage = re.split(r"^FROM ", DOCKERFILE, flags=re.MULTILINE)[1:]
    (lines,) = [text for text in stage if text.splitlines()[0].endswith(f" AS {target}")]
    assert "USER 10001:10001" in lines
    assert 'ENTRYPOINT ["/opt/luxloop/enter.sh", "luxloop"]' in lines


def test_torch_is_in_the_designer_alone() -> None:
    """Each role's packages are its extras'; the list is made from pyproject.toml."""
    wanted = runpy.run_path(str(ROOT / "docker" / "requirements.py"))["wanted"](ROOT / "pyproject.toml", ["workers"])
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert wanted == project["dependencies"] + project["optional-dependencies"]["workers"]
    assert not any(one.startswith("torch") for one in wanted)
    assert DOCKERFILE.count("-r designer.txt") == 1


def test_the_build_sees_what_it_needs_and_no_more() -> None:
    """.dockerignore lets in the packages and what is copied; runs, certificates and wheels of others stay out."""
    allowed = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert set(project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]) <= allowed
    copied = re.findall(r"^COPY (?!--from)(.+) \S+$", DOCKERFILE, re.MULTILINE)
    assert {source.split("/")[0] for line in copied for source in line.split()} <= allowed
    assert not allowed & {"runs", "certs", ".env", ".git"}


def test_a_check_leaves_the_images_of_others_alone() -> None:
    """docker/check.sh built over the tags of `docker compose up` without saying so; its own go at its end."""
    script = (ROOT / "docker" / "check.sh").read_text()
    (tag,) = re.findall(r"^export .*IMAGE_TAG=(\w+)", script, re.MULTILINE)
    assert tag != "latest"
    assert "down --remove-orphans" in script
    assert "down --volumes --rmi all" in script
    assert set(re.findall(r"luxloop-\$image\S*?(?=\))", script)) == {"luxloop-$image:$IMAGE_TAG"}


def test_who_asks_for_no_ray_worker_learns_it_from_what_would_wait_for_one() -> None:
    """The campaign is told how many there are to be; its enter.sh refuses 0. Others would be made anew."""
    assert SERVICES["pc3"]["scale"] == "${RAY_WORKERS:-1}"
    told = {name: service.get("environment", {}).get("RAY_WORKERS") for name, service in SERVICES.items()}
    assert {name: number for name, number in told.items() if number} == {"campaign": "${RAY_WORKERS:-1}"}
