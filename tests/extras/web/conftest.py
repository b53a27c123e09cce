"""The page of a session of its own, and of one that all tests of a module share."""

from collections.abc import Iterator

import pytest

from tests.extras.web.server import Server, served
from tests.support.world import World


@pytest.fixture
def server(world: World) -> Iterator[Server]:
    with served(world) as made:
        yield made


@pytest.fixture(scope="module")
def live_server(live: World) -> Iterator[Server]:
    with served(live) as made:
        yield made
