"""Where exits come from: the same bits from memory, a folder or a walk, and from memory the same set."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from containers.ray_tracing.exit_source import BATCH, ExitSource
from containers.ray_tracing.exits import Exits, make_exits
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.tally import GROUPS
from luxloop.errors import InputError
from tests.ray_scenes import scene


def same_bits(a: Exits, b: Exits) -> bool:
    """Whether two sets are equal to the last bit."""
    pairs = (a.rays, b.rays), (a.notes, b.notes), (a.ends, b.ends), (a.ledger, b.ledger)
    return a.first_block == b.first_block and all(np.array_equal(one, other) for one, other in pairs)


@pytest.mark.parametrize("blocks", [2, BATCH, BATCH + 1, 3 * BATCH])
def test_a_set_in_memory_is_handed_out_as_it_is(blocks: int) -> None:
    """However many batches it is of; for another chip, seed, place or number of blocks it is another one."""
    source = ExitSource()
    found = source.exits(scene(), 1, blocks)
    assert source.exits(scene(distance_um=100.0), 1, blocks) is found
    others = [
        source.exits(scene(chip=replace(scene().chip, width_um=90.0)), 1, blocks),
        source.exits(scene(), 2, blocks),
        source.exits(scene(), 1, blocks, first_block=BATCH),
        source.exits(scene(), 1, blocks, notes=True),
        source.exits(scene(), 1, blocks + 1),
    ]
    assert len({id(one) for one in (found, *others)}) == 6
    assert same_bits(found, make_exits(scene(), 1, blocks * BLOCK))


def test_of_what_was_joined_the_parts_are_not_kept_besides() -> None:
    """A bound that holds the set holds nothing for its batches; who asks for one afterwards has it walked again."""
    source = ExitSource()
    whole = source.exits(scene(), 1, 2 * BATCH)
    assert source.made == 2
    tight = ExitSource(memory_bytes=int(1.2 * whole.nbytes))
    other = tight.exits(scene(), 2, 1)
    assert tight.exits(scene(), 1, 2 * BATCH) is tight.exits(scene(), 1, 2 * BATCH)
    assert tight.exits(scene(), 2, 1) is other
    tight.batches(scene(), 1)(0)
    assert tight.made == 4


def test_a_folder_gives_what_was_walked(tmp_path: Path) -> None:
    """To the last bit, and nothing is walked twice; batches on their own come from the same files."""
    first, second = ExitSource(tmp_path), ExitSource(tmp_path)
    whole = first.exits(scene(), 1, 2 * BATCH, first_block=BATCH, notes=True)
    assert first.made == 2
    assert same_bits(second.exits(scene(), 1, 2 * BATCH, first_block=BATCH, notes=True), whole)
    batch = second.batches(scene(), 1, notes=True)(2 * BATCH + 1)
    assert (second.made, batch.first_block) == (0, 2 * BATCH)
    assert np.array_equal(batch.ledger, whole.ledger[:, BATCH:])
    assert batch.ledger.shape[0] == GROUPS


@pytest.mark.parametrize(("blocks", "first", "field"), [(0, 0, "blocks"), (-1, 0, "blocks"), (1, 3, "first_block")])
def test_what_is_no_set_is_refused(blocks: int, first: int, field: str) -> None:
    """By the name of what is wrong."""
    with pytest.raises(InputError) as caught:
        ExitSource().exits(scene(), 1, blocks, first_block=first)
    assert caught.value.field == field
