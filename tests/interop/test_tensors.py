import re
import subprocess
import sys
import textwrap
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from tspslam import InputError, build_complex, merge_cells, merge_signals, sample_signals, unsigned_laplacian
from tspslam.interop.tensors import to_pyg, to_torch

from ..patience import PATIENCE

WHY = "`tspslam.interop.tensors` needs it"
COMPLEX = build_complex([[0, 1, 2], [0, 2, 3], [2, 3, 4]], 7, edges=[[4, 5]])
UV = np.array([[1, 1], [20, 2], [18, 17], [3, 22], [9, 28], [27, 28], [np.nan, np.nan]])
IMAGE = np.random.default_rng(0).integers(0, 256, (30, 30, 3), np.uint8)
SIGNALS = sample_signals(IMAGE, UV, COMPLEX)


@pytest.fixture
def torch():
    return pytest.importorskip("torch", reason=WHY)


def matrices():
    levels = ("vertex", "edge", "face")
    found = {name: getattr(COMPLEX, name) for name in ("B1", "B2", "L0", "L1", "L2")}
    found |= {f"unsigned {level}": unsigned_laplacian(COMPLEX, level) for level in levels}
    found |= {f"neighbours {level}": matrix for level, matrix in COMPLEX.neighbours()._asdict().items()}
    nothing = build_complex([], 0)
    return found | {"no edges": build_complex([], 3).B1, "no vertices": nothing.B1, "no faces": nothing.B2}


@pytest.mark.parametrize("matrix", matrices().values(), ids=matrices())
def test_the_dense_tensor_equals_the_matrix(torch, matrix):
    tensor = to_torch(matrix)
    assert tensor.is_sparse
    assert tensor.is_coalesced()
    assert tensor.dtype == torch.float32
    assert tensor.shape == matrix.shape
    np.testing.assert_array_equal(tensor.to_dense().numpy(), matrix.toarray().astype(np.float32))


@pytest.mark.parametrize("kind", ["coo", "csr", "csc", "lil", "dok", "dia", "bsr"])
def test_every_format_gives_the_same_tensor(torch, kind):
    expected, tensor = to_torch(COMPLEX.L1), to_torch(COMPLEX.L1.asformat(kind))
    assert torch.equal(tensor.to_dense(), expected.to_dense())


def test_entries_given_twice_add_up_without_overflow(torch):
    twice = sparse.coo_array((np.array([100, 100], np.int8), ([1, 1], [0, 0])), shape=(2, 2))
    assert to_torch(twice).to_dense().tolist() == [[0, 0], [200, 0]]


def test_the_dtype_is_the_one_asked_for(torch):
    assert to_torch(COMPLEX.L1, torch.float64).dtype == torch.float64
    assert to_torch(COMPLEX.B1, torch.int8).to_dense().tolist() == COMPLEX.B1.toarray().tolist()


def test_boundary_of_boundary_is_zero_in_tensors(torch):
    assert not (to_torch(COMPLEX.B1) @ to_torch(COMPLEX.B2).to_dense()).any()


def test_a_tensor_does_not_share_memory_with_its_matrix(torch):
    matrix, changed = (COMPLEX.B1.astype(np.float64) for _ in range(2))
    tensor = to_torch(changed, torch.float64)
    changed.data[:] = 7
    np.testing.assert_array_equal(tensor.to_dense().numpy(), matrix.toarray())


@pytest.mark.parametrize("matrix", [np.eye(3), [[1.0]], None, COMPLEX.L0 * 1j, sparse.coo_array(np.ones(3))],
                         ids=["dense", "list", "none", "complex", "one axis"])  # fmt: skip
def test_what_is_no_sparse_matrix_of_real_numbers_is_named(torch, matrix):
    with pytest.raises(InputError, match=f"matrix is {type(matrix).__name__} of shape .* expected a SciPy sparse"):
        to_torch(matrix)


def test_what_is_no_torch_dtype_is_named(torch):
    with pytest.raises(InputError, match=r"dtype is 'float64', expected a torch\.dtype"):
        to_torch(COMPLEX.B1, "float64")


def test_every_key_has_its_documented_shape_and_type(torch):
    colour = sample_signals(IMAGE, UV, COMPLEX, channels="all")
    for signals, C in ((SIGNALS, 1), (colour, 3)):
        data = to_pyg(COMPLEX, signals)
        found = {key: (tuple(value.shape), value.dtype) for key, value in data.items()}
        N, E, F = 7, 8, 3
        assert found == {
            "x": ((N, C), torch.float32), "edge_index": ((2, 2 * E), torch.int64),
            "edge_attr": ((2 * E, C), torch.float32), "face": ((3, F), torch.int64),
            "x_0": ((N, C), torch.float32), "x_1": ((E, C), torch.float32), "x_2": ((F, C), torch.float32),
            "ok_0": ((N,), torch.bool), "ok_1": ((E,), torch.bool), "ok_2": ((F,), torch.bool),
            "incidence_1": ((N, E), torch.float32), "incidence_2": ((E, F), torch.float32),
        }  # fmt: skip
        documented = re.findall(r"^ {8}(\w[\w, ]*) : ", to_pyg.__doc__, re.MULTILINE)
        assert {key for line in documented for key in line.split(", ")} == set(found)


def test_features_are_the_signals_and_zero_where_the_mask_says_so(torch):
    data = to_pyg(COMPLEX, SIGNALS)
    for level, name in enumerate(("vertex", "edge", "face")):
        values, ok = getattr(SIGNALS, name), getattr(SIGNALS, f"{name}_ok")
        np.testing.assert_array_equal(data[f"x_{level}"][:, 0].numpy(), values.astype(np.float32))
        np.testing.assert_array_equal(data[f"ok_{level}"].numpy(), ok)
        assert not data[f"x_{level}"][~data[f"ok_{level}"]].any()
    assert data["ok_0"].tolist() == [True] * 6 + [False]
    assert data["x"] is data["x_0"]


def test_edge_index_holds_both_directions_of_every_edge_with_its_signal(torch):
    data = to_pyg(COMPLEX, SIGNALS)
    low_high, high_low = data["edge_index"].split(len(COMPLEX.edges), dim=1)
    assert low_high.T.tolist() == COMPLEX.edges.tolist()
    assert torch.equal(high_low, low_high.flip(0))
    adjacency = sparse.coo_array((np.ones(data["edge_index"].shape[1]), data["edge_index"].numpy()), shape=(7, 7))
    assert abs(adjacency - COMPLEX.neighbours().vertex).max() == 0
    assert torch.equal(data["edge_attr"], data["x_1"].repeat(2, 1))


def test_incidences_and_triangles_are_those_of_the_complex(torch):
    data = to_pyg(COMPLEX, SIGNALS)
    np.testing.assert_array_equal(data["incidence_1"].to_dense().numpy(), COMPLEX.B1.toarray())
    np.testing.assert_array_equal(data["incidence_2"].to_dense().numpy(), COMPLEX.B2.toarray())
    assert data["face"].T.tolist() == COMPLEX.faces.tolist()


def test_polygons_go_too_without_triangles(torch):
    labels = [0, 0, 1]
    cells = merge_cells(COMPLEX, labels)
    data = to_pyg(cells, merge_signals(COMPLEX, labels, SIGNALS))
    assert "face" not in data
    np.testing.assert_array_equal(data["incidence_2"].to_dense().numpy(), cells.B2.toarray())
    assert len(data["x_2"]) == 2


def test_an_empty_complex_gives_empty_tensors(torch):
    nothing = build_complex([], 0)
    data = to_pyg(nothing, sample_signals(IMAGE, np.empty((0, 2)), nothing))
    assert all(value.numel() == 0 for value in data.values())


def test_signals_of_another_complex_are_named(torch):
    with pytest.raises(InputError, match=r"signals are of \(7, 8, 3\) .* expected those of the complex, \(3, 3, 1\)"):
        to_pyg(build_complex([[0, 1, 2]], 3), SIGNALS)
    with pytest.raises(InputError, match="signals are of"):
        to_pyg(COMPLEX, replace(SIGNALS, edge_ok=SIGNALS.edge_ok[1:]))


@pytest.mark.parametrize("function", [to_torch, to_pyg], ids=lambda function: function.__name__)
def test_code_in_the_docstrings_runs(torch, function):
    (code,) = re.findall(r"::(?: python)?\n\n((?: {8}.*\n|\n)+)", function.__doc__)
    exec(compile(textwrap.dedent(code), function.__name__, "exec"), {})


def test_without_pytorch_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    for call in (lambda: to_torch(COMPLEX.B1), lambda: to_pyg(COMPLEX, SIGNALS)):
        with pytest.raises(InputError, match=r"^PyTorch is not installed, .*pip install torch$"):
            call()


def test_pytorch_is_imported_only_when_asked():
    code = "import sys, tspslam.interop.tensors; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=PATIENCE).returncode == 0
