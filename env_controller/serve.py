"""`luxloop serve router|controller|local`: the processes of PC1's side."""

from __future__ import annotations

import signal
import threading
from typing import Annotated

import typer

from luxloop.process import orphaned
from luxloop.settings import Settings, load_settings

Router = Annotated[
    str | None,
    typer.Option(
        help="Endpoint, e.g. tcp/127.0.0.1:7447 (else LUXLOOP_ROUTER, else this default; tls/... with certificates)."
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")]


def router(router: Router = None, quiet: Quiet = False) -> None:
    """Be the router that all processes meet at; binds to loopback unless told otherwise."""
    from env_controller.taken import refuse_taken
    from luxloop.bus.zenoh_bus import run_router

    settings = load_settings(router=router)
    _look_at_dates(settings, quiet)
    refuse_taken(settings.router)
    _tell(quiet, f"router: listening at {settings.router}")
    run_router(settings, stop_event())


def _look_at_dates(settings: Settings, quiet: bool) -> None:
    """Say where a certificate of the router ends soon. Raises InputError where one has expired."""
    if settings.certs_dir is None:
        return
    from env_controller.health.certificates import router_dates

    for finding in router_dates(settings):
        if finding.verdict != "ok":
            _tell(quiet, f"router: {finding.found}; {finding.mend}")


def controller(router: Router = None, quiet: Quiet = False) -> None:
    """Be the controller: takes tasks from clients, gives them to workers, brings the outcomes back."""
    from env_controller.dispatcher import Dispatcher
    from luxloop.bus.zenoh_bus import ZenohBus
    from luxloop.endpoint import listening

    settings = load_settings(router=router)
    stop = stop_event()
    while not listening(settings.router) and not stop.wait(0.2):  # opening a session could not be interrupted
        pass
    if stop.is_set():
        return
    with ZenohBus(settings, patient=True, role="controller") as bus:
        dispatcher = Dispatcher(bus, settings)
        _tell(quiet, f"controller: epoch {dispatcher.epoch} at {settings.router}")
        dispatcher.run(stop)


def local(
    router: Router = None,
    thin_film: Annotated[int, typer.Option(min=0, max=64, help="How many thin-film workers.")] = 1,
    ray_tracing: Annotated[int, typer.Option(min=0, max=64, help="How many ray-tracing workers.")] = 1,
    quiet: Quiet = False,
) -> None:
    """Run router, controller and workers on this machine until Ctrl-C; what ends is started again."""
    from env_controller.local_set import run_local

    workers = {"thin-film": thin_film, "ray-tracing": ray_tracing}
    run_local(load_settings(router=router), workers, stop_event(), quiet=quiet)


def stop_event() -> threading.Event:
    """An event that SIGTERM, SIGINT, and the death of the process that this one is to end with set."""
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    threading.Thread(target=_watch_parent, args=(stop,), daemon=True).start()
    return stop


def _watch_parent(stop: threading.Event) -> None:
    while not stop.wait(0.5):
        if orphaned():
            stop.set()


def _tell(quiet: bool, text: str) -> None:
    if not quiet:
        typer.echo(text, err=True)
