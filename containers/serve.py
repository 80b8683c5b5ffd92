"""`luxloop serve thin-film|ray-tracing`: the worker processes of PC2 and PC3."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from luxloop.settings import Settings, load_settings, usable_cache

if TYPE_CHECKING:
    from luxloop.bus import Bus
    from luxloop.bus.access import Role
    from luxloop.computation import Computation

Router = Annotated[str | None, typer.Option(help="Endpoint of the router (else LUXLOOP_ROUTER).")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")]


def thin_film(router: Router = None, quiet: Quiet = False) -> None:
    """Be a thin-film worker: film tables and film measurements, until SIGTERM."""
    settings, cache = _prepared(router)
    from containers.catalogue import Catalogue
    from containers.thin_film.worker import FilmComputation

    computation = FilmComputation.in_folder(cache, Catalogue(settings.effects_dir))
    _serve("thin-film", settings, lambda _: computation, f"database in {cache}", quiet)


def ray_tracing(router: Router = None, quiet: Quiet = False) -> None:
    """Be a ray-tracing worker: maps, uniformities, images of designs, until SIGTERM; on LUXLOOP_THREADS threads."""
    settings, cache = _prepared(router)
    from containers.catalogue import Catalogue
    from containers.ray_tracing.exit_source import ExitSource
    from containers.ray_tracing.field_source import FieldSource
    from containers.ray_tracing.worker import RayComputation, wanted_threads, warm_up
    from luxloop.bus.blobs import fetcher
    from luxloop.store import BlobStore

    threads = wanted_threads()
    source, fields = ExitSource(cache / "exits", threads=threads), FieldSource(cache / "fields")
    warm_up(source, threads)
    catalogue = Catalogue(settings.effects_dir)

    def computation(bus: Bus) -> Computation:
        fetch = fetcher(bus, settings.realm, BlobStore(cache / "blobs"))
        return RayComputation(fetch, source, threads, catalogue, fields)

    _serve("ray-tracing", settings, computation, f"{threads} threads", quiet)


def _prepared(router: str | None) -> tuple[Settings, Path]:
    """The settings, and the cache folder, told to the kernels: where they are kept is read when they are declared."""
    settings = load_settings(router=router)
    cache = usable_cache(settings)
    os.environ["LUXLOOP_CACHE"] = str(cache)
    return settings, cache


def _serve(
    role: Role, settings: Settings, computation: Callable[[Bus], Computation], about: str, quiet: bool
) -> None:
    """Work until SIGTERM; the kernels have been compiled or loaded."""
    from containers.compiled import release_compiler_pages
    from luxloop.bus.zenoh_bus import ZenohBus
    from luxloop.worker import Worker

    release_compiler_pages()
    with ZenohBus(settings, patient=True, role=role) as bus:
        worker = Worker(computation(bus), bus, settings)
        if not quiet:
            typer.echo(f"{worker.name}: at {settings.router}, {about}", err=True)
        worker.run()
