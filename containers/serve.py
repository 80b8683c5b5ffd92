"""`luxloop serve thin-film`: the worker processes of PC2 (and later PC3)."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from luxloop.settings import load_settings, usable_cache


def thin_film(
    router: Annotated[str | None, typer.Option(help="Endpoint of the router (else LUXLOOP_ROUTER).")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")] = False,
) -> None:
    """Be a thin-film worker: film tables and film measurements, until SIGTERM."""
    settings = load_settings(router=router)
    cache = usable_cache(settings)
    os.environ["LUXLOOP_CACHE"] = str(cache)  # where kernels are kept, read when they are declared
    from containers.compiled import release_compiler_pages
    from containers.thin_film.worker import FilmComputation
    from luxloop.bus.zenoh_bus import ZenohBus
    from luxloop.worker import Worker

    computation = FilmComputation.in_folder(cache)
    release_compiler_pages()
    with ZenohBus(settings, patient=True) as bus:
        worker = Worker(computation, bus, settings)
        if not quiet:
            typer.echo(f"{worker.name}: at {settings.router}, database in {cache}", err=True)
        worker.run()
