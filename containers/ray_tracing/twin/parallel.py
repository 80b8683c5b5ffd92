"""The same work on several threads at once; kernels run without the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from luxloop.process import usable_cores

Found = TypeVar("Found")


def in_parallel(work: Callable[[int], Found], numbers: Sequence[int], threads: int | None) -> list[Found]:
    """What `work` makes of each number, on several threads at once; all that may be used by default."""
    threads = threads or usable_cores()
    if threads == 1:
        return [work(number) for number in numbers]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, numbers))
