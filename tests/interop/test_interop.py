import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from tspslam import InputError, Rig, build_complex, delaunay_surface, merge_cells, reconstruct, sample_signals
from tspslam.interop import from_arrays, from_colmap, from_file, from_toponetx, from_trimesh, to_toponetx
from tspslam.interop.meshes import doubts_of_mesh
from tspslam.io import write_ply, write_png
from tspslam.vision.calibration.formats.own import save_cameras
from tspslam.vision.rig import project

RIG = Rig(fx=90, fy=95, cx=50, cy=40, baseline=0.2, width=100, height=80)
IMAGE = np.random.default_rng(0).integers(0, 256, (80, 100), np.uint8)
XYZ = np.array([[-1, -1, 4], [1, -1, 4.2], [1, 1, 3.9], [-1, 1, 4.1], [9, 9, 4.0]])
FACES = np.array([[0, 2, 1], [0, 2, 3]])


def same(one, other):
    for name in ("vertex", "edge", "face", "edge_uv", "face_uv"):
        np.testing.assert_array_equal(getattr(one.signals, name), getattr(other.signals, name))


def test_arrays_become_a_complex_with_the_texture_of_the_image():
    got = from_arrays(XYZ, FACES, IMAGE, RIG)
    complex_ = build_complex(FACES, 5)
    expected = sample_signals(IMAGE, project(RIG, XYZ), complex_)
    np.testing.assert_array_equal(got.complex_.faces, complex_.faces)
    np.testing.assert_array_equal(got.surface.faces, FACES)
    np.testing.assert_array_equal(got.signals.face, expected.face)
    assert got.signals.vertex_ok.tolist() == [True] * 4 + [False]
    np.testing.assert_allclose(got.cloud.disparity[:4], RIG.fx * RIG.baseline / XYZ[:4, 2])


def test_every_door_for_meshes_leads_to_the_same(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    expected = from_arrays(XYZ, FACES, IMAGE, RIG)
    same(from_trimesh(trimesh.Trimesh(XYZ, FACES, process=False), IMAGE, RIG), expected)
    lines = [f"v {x} {y} {z}" for x, y, z in XYZ] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    (tmp_path / "mesh.obj").write_text("\n".join(lines) + "\n")
    Image.fromarray(IMAGE).save(tmp_path / "image.png")
    save_cameras(RIG, tmp_path / "calib.yaml")
    same(from_file(tmp_path / "mesh.obj", tmp_path / "image.png", tmp_path / "calib.yaml"), expected)
    (tmp_path / "far.obj").write_text("v 90 0 1\nv 91 0 1\nv 90 1 1\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"far\.obj: none of 3 vertices falls into the image"):
        from_file(tmp_path / "far.obj", tmp_path / "image.png", tmp_path / "calib.yaml")


@pytest.mark.parametrize(("changes", "message"), [
    ({"xyz": XYZ[:, :2]}, r"xyz has shape \(5, 2\), expected \(N, 3\)"),
    ({"xyz": np.where(XYZ > 3, np.inf, XYZ)}, "vertex 0 is at .* expected metres"),
    ({"xyz": XYZ * [1, 1, -1]}, "none of 5 vertices falls into the image"),
    ({"faces": [[0, 1, 5]]}, r"face 0 is \[0, 1, 5\]"),
    ({"image": IMAGE[:-1]}, r"image has shape \(79, 100\), expected the camera's 80 x 100"),
])  # fmt: skip
def test_arrays_that_do_not_fit_are_named(changes, message):
    given = {"xyz": XYZ, "faces": FACES, "image": IMAGE, "rig": RIG} | changes
    with pytest.raises(InputError, match=message):
        from_arrays(**given)


def turned(angle, t):
    """A pose, turned about the vertical by an angle, rad."""
    T = np.eye(4)
    T[0, 0] = T[2, 2] = np.cos(angle)
    T[0, 2], T[2, 0] = np.sin(angle), -np.sin(angle)
    T[:3, 3] = t
    return T


def test_a_posed_photo_sees_what_it_sees_in_its_own_frame(tmp_path):
    T = turned(0.7, (3, -1, 20))
    world = XYZ @ T[:3, :3].T + T[:3, 3]
    expected = from_arrays(XYZ, FACES, IMAGE, RIG)
    lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in world] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    (tmp_path / "mesh.obj").write_text("\n".join(lines) + "\n")
    Image.fromarray(IMAGE).save(tmp_path / "image.png")
    save_cameras(RIG, tmp_path / "calib.yaml")
    files = (tmp_path / "mesh.obj", tmp_path / "image.png", tmp_path / "calib.yaml")
    for got in (
        from_arrays(world, FACES, IMAGE, RIG, T_world_camera=T.tolist()),
        from_trimesh(SimpleNamespace(vertices=world, faces=FACES), IMAGE, RIG, T_world_camera=T),
        from_file(*files, T_world_camera=T),
    ):
        np.testing.assert_allclose(got.cloud.xyz, XYZ, atol=1e-12)
        np.testing.assert_allclose(got.T_world_camera, T, atol=1e-12)
        np.testing.assert_allclose(got.signals.vertex, expected.signals.vertex, atol=1e-9)
        np.testing.assert_allclose(got.cloud.disparity, expected.cloud.disparity, atol=1e-9)
    np.testing.assert_array_equal(expected.T_world_camera, np.eye(4))


@pytest.mark.parametrize(("T", "said"), [
    (np.eye(3), r"T_world_camera is float64 of shape \(3, 3\), expected \(4, 4\) finite numbers"),
    (np.full((4, 4), np.nan), "T_world_camera is float64 .* finite numbers"),
    (turned(0, (0, 0, 3)).T, "expected .* last row 0 0 0 1"),
    (np.diag([2.0, 2, 2, 1]), r"T_world_camera holds no rotation \(R Rᵀ - I has 3\)"),
    (np.diag([1.0, 1, -1, 1]), "T_world_camera holds no rotation"),
    (turned(0, (1e10, 0, 0)), "expected metres, at most 1e[+]09"),
    ("pose.txt", "T_world_camera is the path 'pose.txt'"),
    (turned(3.14, (0, 0, 0)), "none of 5 vertices falls into the image .*, expected the world's frame and the photo's pose"),
])  # fmt: skip
def test_a_pose_that_is_none_is_refused(T, said):
    with pytest.raises(InputError, match=said):
        from_arrays(XYZ, FACES, IMAGE, RIG, T_world_camera=T)


def doubted(xyz, faces=FACES, rig=RIG):
    return doubts_of_mesh(from_arrays(xyz, faces, IMAGE, rig))


def test_a_mesh_in_metres_before_the_camera_is_not_doubted():
    for far in (1, 10):  # 4 to 40 m: 4.5 to 0.45 px
        assert doubted(XYZ * far) == []
    street = replace(RIG, fx=700.0, baseline=0.54)
    assert doubted(XYZ * [10, 10, 300], rig=street) == []  # a hill, 1.2 km away


def test_a_mesh_in_another_unit_or_around_the_camera_is_doubted():
    mm, away = doubted(XYZ * 1000), doubted(XYZ * 1e-3)
    assert mm == [
        "the mesh is 4050 m away in the median, a disparity of 0.00444 px: is it in millimetres? Expected metres"
    ]
    assert "more than the image is wide: is it in another unit? Expected metres" in away[0]
    both = doubted(np.concatenate([XYZ, XYZ * [1, 1, -1]]), np.concatenate([FACES, FACES + 5, [[0, 1, 5]]]))
    assert "4 of the mesh's vertices are behind the camera (z <= 0), 5 before it: a mesh around the camera" in both[0]
    assert doubted(np.concatenate([XYZ, [[0, 0, -1]]])) == []  # of no face


def test_a_mesh_before_a_single_camera_is_doubted_by_its_distance_alone():
    single = replace(RIG, baseline=0.0)
    for far in (1e-3, 1, 3):  # 4 mm to 12 m
        assert doubted(XYZ * far, rig=single) == []
    assert doubted(XYZ * 1000, rig=single) == [
        "the mesh is 4050 m away in the median: is it in millimetres? Expected metres"
    ]


def test_what_is_no_mesh_is_named():
    with pytest.raises(InputError, match="mesh is SimpleNamespace, expected something with vertices and faces"):
        from_trimesh(SimpleNamespace(vertices=XYZ), IMAGE, RIG)


TURN = np.array([0.5, 0.5, 0.5, 0.5])  # w x y z: x -> y -> z -> x
CAMERAS = "# comment\n7 PINHOLE 100 80 90 95 50.5 40.5\n"


def write_model(folder, cloud, images=None, cameras=CAMERAS, points=None):
    """A model whose camera is turned and moved; its points are the cloud's."""
    R = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0.0]])
    t = np.array([1.0, -2, 3])
    world = (cloud.xyz - t) @ R
    seen = " ".join(f"{u + 0.5!r} {v + 0.5!r} {k + 10}" for k, (u, v) in enumerate(cloud.uv.tolist()))
    pose = " ".join(map(str, [*TURN, *t]))
    text = f"# two lines an image\n3 1 0 0 0 0 0 0 7 other.png\n\n4 {pose} 7 my image.png\n{seen} 1.5 2.5 -1\n"
    rows = [f"{k + 10} {x!r} {y!r} {z!r} 0 0 0 0.1 4 {k}" for k, (x, y, z) in enumerate(world.tolist())]
    (folder / "images.txt").write_text(text if images is None else images)
    (folder / "cameras.txt").write_text(cameras)
    (folder / "points3D.txt").write_text("\n".join(rows) + "\n" if points is None else points)
    return folder


@pytest.fixture
def cloud(small_pair):
    left, right, rig = small_pair
    from tspslam import StereoPair

    return reconstruct(StereoPair(left, right, rig)), left, rig


def test_an_image_of_a_model_gives_what_its_own_cloud_gives(tmp_path, cloud):
    points, left, rig = cloud
    model = write_model(tmp_path, points, cameras=f"7 PINHOLE {rig.width} {rig.height} {rig.fx} {rig.fy} 0 0\n")
    got = from_colmap(model, "my image.png", left)
    np.testing.assert_allclose(got.cloud.xyz, points.xyz, atol=1e-9)
    np.testing.assert_allclose(got.cloud.uv, points.uv, atol=1e-9)
    expected = delaunay_surface(replace(points, covariance=None))
    np.testing.assert_array_equal(np.sort(got.surface.faces, axis=1), np.sort(expected.faces, axis=1))
    assert got.signals.face_ok.all()
    np.testing.assert_allclose(got.cloud.disparity, rig.fx / points.xyz[:, 2])


def tiny():
    from tspslam import Cloud

    uv = np.array([[10, 10], [80, 12], [15, 70.0]])
    return Cloud(np.column_stack([(uv - [50, 40]) / [90, 95] * 4, np.full(3, 4.0)]), uv, np.ones(3))


def test_points_seen_twice_or_behind_the_camera_are_left_out(tmp_path):
    model = write_model(tmp_path, tiny())
    text = (model / "images.txt").read_text().replace(" 1.5 2.5 -1", " 33 33 10 9 9 99")
    (model / "images.txt").write_text(text)
    (model / "points3D.txt").write_text((model / "points3D.txt").read_text() + "99 0 -50 0 0 0 0 0\n")
    got = from_colmap(model, "my image.png", IMAGE)
    np.testing.assert_allclose(got.cloud.uv, tiny().uv)


@pytest.mark.parametrize(("camera", "cx", "cy"), [
    ("PINHOLE 100 80 90 95 50.5 40.5", 50, 40), ("OPENCV 100 80 90 95 50.5 40.5 0.1 0 0 0", 50, 40),
    ("SIMPLE_RADIAL 100 80 90 50.5 40.5 0.1", 50, 40),
])  # fmt: skip
def test_a_frame_of_a_model_knows_its_camera_its_pose_and_its_points(tmp_path, camera, cx, cy):
    got = from_colmap(write_model(tmp_path, tiny(), cameras=f"7 {camera}\n"), "my image.png", IMAGE)
    assert got.rig == Rig(90, 95 if "95" in camera else 90, cx, cy, 1.0, 100, 80)
    assert (got.name, got.landmark.tolist()) == ("my image.png", [10, 11, 12])
    R, t = got.T_world_camera[:3, :3], got.T_world_camera[:3, 3]
    rows = [line.split() for line in (tmp_path / "points3D.txt").read_text().splitlines()]
    np.testing.assert_allclose(got.cloud.xyz @ R.T + t, [[float(x) for x in row[1:4]] for row in rows], atol=1e-9)


HEAD = "4 1 0 0 0 0 0 0 7 my image.png\n"


@pytest.mark.parametrize(("files", "message"), [
    ({"images": "4 1 0 0\n\n"}, "line 1 has 4 words"),
    ({"images": HEAD.replace("my", "your") + "\n"}, "has no image 'my image.png'"),
    ({"images": HEAD + "1 2\n"}, "line 2 has 2 numbers, not three a point"),
    ({"images": HEAD + "1 2 x\n"}, "line 2 holds a word that is no number: 'x'"),
    ({"images": HEAD + "1 nan 3\n"}, "line 2 has a number that is not finite"),
    ({"images": HEAD.replace("4 1 0", "4 0 0") + "1 2 10\n"}, "quaternion of 0"),
    ({"images": HEAD + "1 2 10\n"}, "image my image.png observes 0 points in front of it; expected at least 3"),
    ({"images": HEAD}, "observes 0 points"),
    ({"cameras": "8 PINHOLE 100 80 90\n"}, "has no camera 7"),
    ({"cameras": "7 PINHOLE 100\n"}, "line 1 has 1 numbers"),
    ({"cameras": "7 PINHOLE 100 80 90 95 50\n"}, "line 1 has no principal point"),
    ({"cameras": "7 PINHOLE 100 80 0 95 50 40\n"}, "line 1 is no camera .rig: fx is 0"),
    ({"cameras": "7 PINHOLE 100 90 90\n"}, r"image has shape \(80, 100\), expected the camera's 90 x 100"),
    ({"points": "10 1 2\n"}, "line 1 has 2 numbers"),
    ({"points": ""}, "points3D.txt: is empty"),
])  # fmt: skip
def test_models_that_cannot_be_used_are_named(tmp_path, files, message):
    with pytest.raises(InputError, match=message):
        from_colmap(write_model(tmp_path, tiny(), **files), "my image.png", IMAGE)


def test_a_complex_goes_to_toponetx_and_comes_back():
    pytest.importorskip("toponetx")
    complex_ = build_complex([[0, 1, 2], [1, 2, 3]], 7, edges=[[3, 5]])
    there = to_toponetx(complex_)
    assert abs(there.incidence_matrix(1) - complex_.B1).max() == 0
    assert abs(there.incidence_matrix(2) - complex_.B2).max() == 0
    back = from_toponetx(there)
    assert (back.n, back.edges.tolist(), back.faces.tolist()) == (7, complex_.edges.tolist(), complex_.faces.tolist())
    for small in (build_complex([], 3), build_complex([], 2, edges=[[0, 1]])):
        assert from_toponetx(to_toponetx(small)).edges.tolist() == small.edges.tolist()


def test_what_toponetx_cannot_hold_or_we_cannot_is_named(monkeypatch):
    classes = pytest.importorskip("toponetx.classes")
    for simplices, message in (
        ([[0, 1, 2, 3]], "has dimension 3"),
        ([["a", "b"]], "no integers"),
        ([[3, 4]], "2 vertices, 3 to 4"),
    ):
        with pytest.raises(InputError, match=message):
            from_toponetx(classes.SimplicialComplex(simplices))
    with pytest.raises(InputError, match="complex is list, expected a toponetx SimplicialComplex"):
        from_toponetx([])
    with pytest.raises(InputError, match="its faces are polygons, expected triangles"):
        to_toponetx(merge_cells(build_complex([[0, 1, 2], [0, 2, 3]], 4), [0, 0]))
    monkeypatch.setitem(sys.modules, "toponetx", None)
    with pytest.raises(InputError, match="TopoNetX is not installed"):
        to_toponetx(build_complex([], 2))


def test_the_signal_of_a_camera_of_12_bits_is_that_of_its_range(tmp_path):
    write_ply(tmp_path / "mesh.ply", np.array([[-0.1, -0.1, 5], [0.1, -0.1, 5], [0, 0.1, 5.0]]), np.array([[0, 1, 2]]))
    save_cameras(Rig(fx=50, fy=50, cx=20, cy=15, baseline=1, width=40, height=30), tmp_path / "calib.yaml")
    write_png(tmp_path / "white.png", np.full((30, 40), 4095, np.uint16))
    files = tmp_path / "mesh.ply", tmp_path / "white.png", tmp_path / "calib.yaml"
    for bits, wanted in ((None, 1.0), (14, 0.25)):
        np.testing.assert_allclose(from_file(*files, bits=bits).signals.vertex, wanted, atol=1e-3)
