"""`python -m containers.warm_up`: compile the kernels of both workers, so that no first task has to wait for it."""

from __future__ import annotations


def main() -> None:
    """Compile what is not in the folder of kernels yet."""
    from containers import thin_film
    from containers.ray_tracing.exit_source import ExitSource
    from containers.ray_tracing.worker import warm_up

    thin_film.warm_up()
    warm_up(ExitSource())


if __name__ == "__main__":
    main()
