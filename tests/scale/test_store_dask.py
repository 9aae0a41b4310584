"""A store filtered by processes: the same bytes, whatever dies on the way."""

import os
import signal
import sys

import pytest

from tspslam.errors import InputError
from tspslam.scale import write_store
from tspslam.scale.stores import cluster
from tspslam.scale.stores.filtering import filter_run
from tspslam.scale.stores.sources import of_arrays
from tspslam.scale.stores.stored_response import begin
from tspslam.scale.stores.tiled_filter import Options

from .meshes import tangled

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes are killed as on Unix")


@pytest.fixture(scope="module")
def client():
    with cluster.opened(None, 2, 1 << 30) as found:
        yield found


def made(folder, **given):
    xyz, faces, uv = tangled(11, 120)
    return write_store(folder, of_arrays(xyz, faces, uv=uv, luminance=uv[:, 0], **given), chunk=16)


def stored(folder):
    return {path.name: path.read_bytes() for path in (folder / "responses").rglob("c.*")}


def test_processes_write_the_same_bytes_and_a_killed_one_costs_a_smaller_tile(tmp_path, client):
    alone = made(tmp_path / "alone.zarr").filter()
    store, options = made(tmp_path / "a.zarr"), Options.checked(1, None, None)
    place, told = str(store.path), vars(options)
    begin(store.mesh, options)

    def work(first, last, tile):
        if first == 32 and tile > 8:
            os.kill(os.getpid(), signal.SIGKILL)
        return filter_run((place, None), told, first, last, tile)

    rows = {run: row for row, run in cluster.spread(client, work, [(0, 32), (32, 64), (64, 96)], 64)}
    assert sorted(rows) == [(0, 32), (32, 64), (64, 96)]
    assert rows[32, 64]["tile"] == 8
    response = store.filter(client=client)  # the rest
    assert response.summary["split"] >= 1
    assert stored(store.path) == stored(alone.store.path)


def test_a_tile_that_always_kills_its_worker_is_given_up_in_a_line(client):
    def work(first, last, tile):
        os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(InputError, match=r"rows 0 to 2 kill their worker even 1 vertices at a time, expected a worker"):
        list(cluster.spread(client, work, [(0, 2)], 2))


def test_what_is_wrong_in_a_worker_is_said_here(tmp_path, client):
    store = made(tmp_path / "a.zarr")
    path = store.path / "luminance" / "c.3"
    path.write_bytes(bytes(len(path.read_bytes()) - 1) + b"x")
    with pytest.raises(InputError, match=r"luminance.c\.3: is damaged: its checksum is another; expected a store"):
        store.filter(client=client)
    with pytest.raises(InputError, match="is not visible to a worker"):
        filter_run((str(tmp_path / "nowhere"), None), vars(Options.checked(1, None, None)), 0, 1, 1)


def test_a_scheduler_that_runs_already_serves_too(tmp_path, client):
    alone, store = made(tmp_path / "alone.zarr").filter(), made(tmp_path / "a.zarr")
    with cluster.connected(client.scheduler.address, store.path) as other:
        store.filter(client=other)
    assert stored(store.path) == stored(alone.store.path)
