"""Heat over a store is that over the whole mesh."""

import numpy as np
import pytest

import tspslam
from tspslam.errors import InputError
from tspslam.scale import write_store
from tspslam.scale.stores.heat import smooth_store
from tspslam.scale.stores.sources import of_arrays

from .meshes import tangled


@pytest.mark.parametrize("chunk", [7, 1000])
def test_heat_by_chunks_is_that_of_the_whole(tmp_path, chunk):
    xyz, faces, _ = tangled(41, 60)
    own = np.random.default_rng(0).random(60)
    own[[3, 20]] = np.nan
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=own), chunk=chunk)
    ok = np.isfinite(own)
    L = tspslam.unsigned_laplacian(tspslam.build_complex(faces, 60), "vertex", ok)
    for t in (0.0, 0.3, 5.0):
        whole = tspslam.heat_filter(L, np.where(ok, own, 0), t, error=1e-12)
        number = store.read("id", 0, 60)
        got = smooth_store(store.mesh, t)
        assert np.abs(got - whole[number])[ok[number]].max() < 1e-10
        assert np.isnan(got[~ok[number]]).all()
        assert np.array_equal(got, smooth_store(store.mesh, t), equal_nan=True)
    assert sorted(path.name for path in (store.path / "heat").iterdir() if path.is_dir()) == [
        "luminance-0.0", "luminance-0.3", "luminance-5.0",
    ]  # fmt: skip
    assert not list(store.path.rglob("unsorted"))


def test_heat_without_values_or_time_is_refused(tmp_path):
    xyz, faces, uv = tangled(42)
    bare = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces))
    with pytest.raises(InputError, match="has no values 'luminance'; expected luminance of the vertices"):
        smooth_store(bare.mesh, 1.0)
    lit = write_store(tmp_path / "b.zarr", of_arrays(xyz, faces, luminance=uv[:, 0]))
    with pytest.raises(InputError, match="t is -1"):
        smooth_store(lit.mesh, -1)
