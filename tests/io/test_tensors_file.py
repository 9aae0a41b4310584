"""A map as tensors: NumPy alone reads it, PyTorch Geometric and TopoX find what they call so, and it is the map."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from tests.io.test_io_frames import frame, saved
from tests.io.test_topological import map_
from tests.view.view_maps import ODD_MAPS
from tspslam import InputError
from tspslam.interop import to_pyg
from tspslam.io import write_map
from tspslam.io._form import write_arrays
from tspslam.io.tensors import _FORM, read_tensors, tensors_of, write_tensors

SHOWN = {
    "a map": map_, "a frame": frame, "a frame of three channels": lambda: frame((3,)), "without landmarks": lambda: frame(covariance=False),
    **{name: ODD_MAPS[name] for name in ("wall", "all marked", "no face")},
}  # fmt: skip


def loaded(path):
    with np.load(path, allow_pickle=False) as arrays:
        return dict(arrays)


@pytest.mark.parametrize("make", SHOWN.values(), ids=SHOWN)
def test_numpy_and_our_reader_give_what_was_written(tmp_path, make):
    shown = make()
    write_tensors(tmp_path / "a.npz", shown)
    given, plain, ours = tensors_of(shown), loaded(tmp_path / "a.npz"), read_tensors(tmp_path / "a.npz")
    assert given.keys() == ours.keys() == plain.keys() - {"magic", "version"}
    for name, values in given.items():
        assert np.array_equal(plain[name], values)
        assert np.array_equal(ours[name], values)
        assert plain[name].dtype == values.dtype, name
        assert values.dtype.kind in "iub" or np.isfinite(values).all(), name


def test_its_matrices_are_those_of_the_complex_and_their_product_is_zero(tmp_path):
    for shown in (map_(), frame(), ODD_MAPS["room"]()):
        write_tensors(tmp_path / "a.npz", shown)
        arrays = loaded(tmp_path / "a.npz")
        B1, B2 = (
            sparse.coo_array((arrays[f"{B}_sign"], arrays[f"{B}_index"]), shape=tuple(arrays[f"{B}_shape"]))
            for B in ("B1", "B2")
        )
        assert abs(B1 - shown.complex_.B1).max() == abs(B2 - shown.complex_.B2).max() == 0
        assert abs(B1 @ B2).max() == 0


def test_edges_go_both_ways_with_their_signal_and_faces_ascend():
    made = map_()
    arrays, E = tensors_of(made), len(made.complex_.edges)
    assert arrays["edge_index"][:, :E].T.tolist() == made.complex_.edges.tolist()
    assert np.array_equal(arrays["edge_index"][:, E:], arrays["edge_index"][::-1, :E])
    assert np.array_equal(arrays["edge_attr"], np.tile(arrays["x_1"], (2, 1)))
    assert np.array_equal(arrays["face"].T, made.complex_.faces)
    assert np.array_equal(arrays["face_wound"].T, made.surface.faces)


def test_a_map_has_its_signals_views_response_and_observations():
    made = map_()
    arrays = tensors_of(made)
    for k, level in enumerate(("vertex", "edge", "face")):
        assert np.array_equal(arrays[f"x_{k}"][:, 0], getattr(made.signals, level).astype(np.float32))
        assert np.array_equal(arrays[f"ok_{k}"], getattr(made.signals, f"{level}_ok"))
        assert np.array_equal(arrays[f"views_{k}"], getattr(made.view_count, level))
        assert np.array_equal(arrays[f"variance_{k}"][:, 0], getattr(made.view_variance, level).astype(np.float32))
    assert np.array_equal(arrays["response"][:, 0], made.response.z.astype(np.complex64))
    assert np.array_equal(arrays["response_ok"], made.defined)
    vertex, keyframe = arrays["observation_index"]
    assert vertex.tolist() == made.observations.vertex.tolist() == [0, 0, 2, 2, 2, 3]
    assert keyframe.tolist() == made.observations.keyframe.tolist()
    assert arrays["observation_disparity"].tolist() == [1, 0, 2, 3, 4, 5]
    assert arrays["observation_disparity_ok"].tolist() == [True, False, True, True, True, True]
    np.testing.assert_allclose(arrays["pos"], made.xyz, rtol=1e-6)


def test_a_frame_is_one_keyframe_whose_points_with_pixels_are_observations():
    one = frame()
    one.cloud.uv[1] = np.nan
    arrays = tensors_of(one)
    assert arrays["observation_index"].tolist() == [[0, 2, 3, 4], [0, 0, 0, 0]]
    assert np.array_equal(arrays["observation_uv"], one.cloud.uv[[0, 2, 3, 4]].astype(np.float32))
    assert (arrays["keyframe"].tolist(), arrays["T_world_camera"].shape) == ([12], (1, 4, 4))
    assert not {"views_0", "direction", "covariance"} & arrays.keys()


def test_toponetx_makes_the_complex_of_it_with_its_signals(tmp_path):
    classes = pytest.importorskip("toponetx.classes", reason="TopoNetX is not installed: pip install TopoNetX")
    made = ODD_MAPS["wall"]()
    write_tensors(tmp_path / "a.npz", made)
    arrays = np.load(tmp_path / "a.npz")
    edges = arrays["edge_index"][:, : len(arrays["x_1"])].T
    complex_ = classes.SimplicialComplex([*edges.tolist(), *arrays["face"].T.tolist()])
    complex_.set_simplex_attributes(
        {tuple(edge): x for edge, x in zip(edges.tolist(), arrays["x_1"][:, 0].tolist(), strict=True)}, "signal"
    )
    assert complex_.shape == (len(made), len(made.complex_.edges), len(made.complex_.faces))
    found = (
        complex_.get_edge_attributes("signal")
        if hasattr(complex_, "get_edge_attributes")
        else complex_.get_simplex_attributes("signal")
    )
    assert sorted(found.values()) == sorted(arrays["x_1"][:, 0].tolist())
    B1 = np.asarray(complex_.incidence_matrix(1).todense())
    assert np.array_equal(abs(B1).sum(axis=0), np.full(len(edges), 2))
    order = [sorted(edge) for edge in complex_.skeleton(1)]
    assert np.array_equal(abs(B1), abs(made.complex_.B1.toarray()[:, [edges.tolist().index(edge) for edge in order]]))


def test_pytorch_geometric_takes_it(tmp_path):
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install torch")
    made = ODD_MAPS["wall"]()
    arrays, tensors = tensors_of(made), to_pyg(made.complex_, made.signals)
    for name in ("x", "edge_index", "edge_attr", "face", "x_0", "x_1", "x_2", "ok_0", "ok_1", "ok_2"):
        assert torch.equal(torch.from_numpy(arrays[name]), tensors[name]), name


def test_equal_maps_give_equal_bytes(tmp_path):
    for name in ("a", "b"):
        write_tensors(tmp_path / f"{name}.npz", map_())
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_what_is_neither_and_what_is_no_such_file_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected a Frame"):
        write_tensors(tmp_path / "a.npz", {"x": 1})
    write_map(tmp_path / "map.npz", map_())
    with pytest.raises(InputError, match="expected tensors of format version 1"):
        read_tensors(tmp_path / "map.npz")
    write_tensors(tmp_path / "a.npz", map_())
    whole = (tmp_path / "a.npz").read_bytes()
    for share in (0.2, 0.9):
        with pytest.raises(InputError):
            read_tensors(saved(tmp_path, whole[: int(share * len(whole))], "cut.npz"))


def test_sizes_that_do_not_fit_are_refused(tmp_path):
    arrays = tensors_of(map_())
    for name, wrong in (("B1_shape", np.array([5, 7])), ("B2_shape", np.array([1, 2])), ("B2_sign", arrays["B1_sign"])):
        with pytest.raises(InputError, match=name if name != "B2_sign" else "shape"):
            write_arrays(tmp_path / "a.npz", _FORM, arrays | {name: wrong})
    made = map_()
    with pytest.raises(InputError, match="shape"):
        write_tensors(tmp_path / "a.npz", replace(made, xyz=made.xyz[1:]))
