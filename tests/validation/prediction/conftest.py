"""Workers that tests of a module share."""

from __future__ import annotations

from pathlib import Path

import pytest

from luxloop.model import Model
from luxloop.model_file import find_model
from tests.validation.workers import Workers


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the films."""
    return tmp_path_factory.mktemp("films")


@pytest.fixture(scope="module")
def shared(folder: Path) -> Workers:
    """Workers that have chips by now."""
    return Workers(folder)


@pytest.fixture
def workers(shared: Workers) -> Workers:
    """The same, nothing asked yet."""
    shared.asked.clear()
    return shared


@pytest.fixture(scope="module")
def model() -> Model:
    """The paper's; its chip absorbs, so walks are short."""
    return find_model("paper")
