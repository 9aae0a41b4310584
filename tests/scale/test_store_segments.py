"""Regions of a store: those of the whole where one chunk holds it, and within each chunk else."""

import numpy as np

import tspslam
from tspslam.scale import write_store
from tspslam.scale.stores.segmenting import segment_store
from tspslam.scale.stores.sources import of_arrays

from .meshes import tangled, two_images


def test_regions_of_one_chunk_are_those_of_the_whole(tmp_path):
    xyz, faces, uv = tangled(51, 80)
    references, pixels = two_images(tmp_path)
    given = of_arrays(xyz, faces, uv=uv, image=np.zeros(80), images=references)
    store = write_store(tmp_path / "a.zarr", given, chunk=1000)
    number = store.read("id", 0, 80)
    local = np.argsort(number)[faces]
    complex_ = tspslam.build_complex(local, 80)
    signals = tspslam.sample_signals(pixels[0], uv[number], complex_)
    whole = tspslam.segment(complex_, signals, xyz=xyz[number])
    places = {tuple(face): label for face, label in zip(complex_.faces.tolist(), whole.tolist(), strict=True)}
    labels = segment_store(store.mesh)
    rows = store.read("face_rows", 0, len(faces))
    assert labels.tolist() == [places[tuple(sorted(face))] for face in rows.tolist()]
    assert labels.max() > 0
    assert np.array_equal(labels, segment_store(store.mesh))


def test_each_face_has_one_label_and_no_region_leaves_its_chunk(tmp_path):
    xyz, faces, uv = tangled(52, 100)
    store = write_store(tmp_path / "a.zarr", of_arrays(xyz, faces, luminance=uv[:, 0] / 60), chunk=16)
    labels = segment_store(store.mesh, scale=2)
    ends = store.mesh.face_end
    number, chunk = store.read("face_id", 0, ends[-1]), np.repeat(np.arange(len(ends)), np.diff(ends, prepend=0))
    assert np.sort(number[labels >= 0]).tolist() == list(range(len(faces)))
    assert np.unique(labels[labels >= 0]).tolist() == list(range(labels.max() + 1))
    assert all(len(np.unique(chunk[labels == k])) == 1 for k in range(labels.max() + 1))
