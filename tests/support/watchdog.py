"""A pytest plugin: a test that has failed is still watched.

pytest-timeout and pytest's faulthandler end their watch at the first failure, because a debugger
may open then. A teardown that waits for ever would stop the whole run.
"""

import faulthandler

import pytest
import pytest_timeout
from _pytest.faulthandler import fault_handler_stderr_fd_key


@pytest.hookimpl(trylast=True)
def pytest_exception_interact(node: pytest.Item | pytest.Collector) -> None:
    """Begins both watches anew for the rest of the test: the end of the test ends them."""
    if not isinstance(node, pytest.Item) or node.config.option.usepdb:
        return
    settings = pytest_timeout._get_item_settings(node)
    if settings.timeout:
        node.config.hook.pytest_timeout_set_timer(item=node, settings=settings)
    hung_s = float(node.config.getini("faulthandler_timeout"))
    if hung_s:
        stderr = node.config.stash[fault_handler_stderr_fd_key]  # the one that nothing captures
        faulthandler.dump_traceback_later(hung_s, file=stderr, exit=True)
