"""What every test has, also the examples in docstrings."""

import signal

import pytest


def pytest_configure():
    """Have processes that tests start hear of ctrl-C, also where the tests run in the background."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="module", autouse=True)
def _coarse_pictures(request):
    """Pictures that runs draw have a quarter of the dots an inch, except where they are what is tested."""
    with pytest.MonkeyPatch.context() as patch:
        if request.path.parent.name != "view":
            patch.setattr("tspslam.view._style.DPI", 35)
        yield
