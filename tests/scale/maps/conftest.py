"""Runs that are joined, made once."""

import pytest

from tspslam.scale.maps.joining import join_runs

from .walks import write_runs


@pytest.fixture(scope="package", autouse=True)
def _coarse():
    """Pictures as all tests have them, also in what is made once."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tspslam.view._style.DPI", 35)
        yield


@pytest.fixture(scope="package")
def runs(tmp_path_factory):
    """Folder of the runs; true poses of the walk."""
    folder = tmp_path_factory.mktemp("runs")
    return folder, write_runs(folder)


@pytest.fixture(scope="package")
def both(runs, tmp_path_factory):
    """Two runs joined in this process."""
    out = tmp_path_factory.mktemp("both") / "map"
    join_runs([runs[0] / "start", runs[0] / "middle"], out)
    return out


@pytest.fixture(scope="package")
def chain(runs, tmp_path_factory):
    """Three runs, of which the first and the last share no place, and one of another place."""
    out = tmp_path_factory.mktemp("chain") / "map"
    result = join_runs([runs[0] / name for name in ("start", "other", "end", "middle")], out)
    return out, result
