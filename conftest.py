"""What every test has, also the examples in docstrings."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def _coarse_pictures(request):
    """Pictures that runs draw have a quarter of the dots an inch, except where they are what is tested."""
    with pytest.MonkeyPatch.context() as patch:
        if request.path.parent.name != "view":
            patch.setattr("tspslam.view._style.DPI", 35)
        yield
