"""Synthetic worlds: what is rendered agrees with closed forms and with a plain ray caster, and repeats."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

import tspslam
from tspslam.datasets import synthetic as syn
from tspslam.errors import InputError

RIG = tspslam.Rig(fx=90, fy=95, cx=61.3, cy=44.7, baseline=0.2, width=128, height=96, skew=0.7, doffs=3.0)
CLEAN = syn.Faults(eight_bit=False)


def rays(rig):
    v, u = np.mgrid[: rig.height, : rig.width].astype(float)
    y = (v - rig.cy) / rig.fy
    return np.stack([(u - rig.cx - rig.skew * y) / rig.fx, y, np.ones_like(y)], axis=-1)


def one(*shapes, rig=RIG, faults=CLEAN, **more):
    return syn.SyntheticSequence(syn.Scene(shapes, **more), rig, faults)


def plain_depth(scene, rig, pose):
    """Depth and label by testing every ray against every triangle (Möller and Trumbore)."""
    ray, depth, label = rays(rig).reshape(-1, 3), np.full(rig.width * rig.height, np.inf), 0
    label = np.zeros(len(ray), int)
    for number, shape in enumerate(scene.shapes, 1):
        corners = ((shape.world_vertices() - pose[:3, 3]) @ pose[:3, :3])[shape.faces]
        for a, b, c in corners:
            p = np.cross(ray, c - a)
            det = p @ (b - a)
            with np.errstate(all="ignore"):
                s = p @ -a / det
                q = np.cross(-a, b - a)
                t = ray @ q / det
                z = (c - a) @ q / det
            hit = (s >= 0) & (t >= 0) & (s + t <= 1) & (z > 0) & (z < depth)
            depth[hit], label[hit] = z[hit], number
    return depth.reshape(rig.height, -1), label.reshape(rig.height, -1)


def test_a_slanted_plane_has_the_depth_of_its_equation():
    wall = syn.plane(50, 50).at(0, 0, 4, turn=(0.3, -0.5, 0.1))
    geometry = one(wall).geometry(0)
    normal = wall.pose[:3, 2]
    expected = normal @ (0, 0, 4) / (rays(RIG) @ normal)
    np.testing.assert_allclose(geometry.depth, expected, rtol=1e-12)
    np.testing.assert_allclose(geometry.normal, np.broadcast_to(-normal, geometry.normal.shape), atol=1e-12)
    np.testing.assert_allclose(geometry.disparity, RIG.fx * RIG.baseline / expected - RIG.doffs, atol=1e-12)


def test_a_sphere_has_the_depth_of_its_equation():
    geometry = one(syn.sphere(1.0, rows=400).at(0.2, -0.1, 4)).geometry(0)
    ray, centre = rays(RIG), np.array([0.2, -0.1, 4])
    a, b = (ray**2).sum(-1), ray @ centre
    root = b**2 - a * (centre @ centre - 1)
    inside = root > 0.1
    np.testing.assert_allclose(geometry.depth[inside], ((b - np.sqrt(np.abs(root))) / a)[inside], rtol=1e-4)
    assert np.isnan(geometry.depth[root < 0]).all()
    assert ((geometry.label == 0) == np.isnan(geometry.depth)).all()


@pytest.mark.parametrize("seed", range(4))
def test_any_heap_of_triangles_is_cast_as_by_a_plain_ray_caster(seed):
    rng = np.random.default_rng(seed)
    heap = [syn.Shape(f"s{k}", rng.uniform(-4, 4, (30, 3)), rng.permutation(30).reshape(10, 3)) for k in range(3)]
    scene = syn.Scene(tuple(heap), path=syn.shapes.pose_at(rng.normal(0, 1, 3), rng.normal(0, 1, 3))[None])
    geometry = syn.SyntheticSequence(scene, RIG, CLEAN).geometry(0)
    depth, label = plain_depth(scene, RIG, scene.path[0])
    same = geometry.label == label
    assert same.mean() > 0.9995  # rays that graze a side
    hit = same & (label > 0)
    np.testing.assert_allclose(geometry.depth[hit], depth[hit], rtol=1e-9)


def test_surfaces_have_no_cracks():
    room = syn.room(frames=8)
    sequence = syn.SyntheticSequence(room, RIG, CLEAN)
    assert all((sequence.geometry(k).label > 0).all() for k in range(len(sequence)))


def test_the_right_image_shows_the_left_one_at_the_disparity():
    sequence = one(syn.plane(20, 20, texture=syn.Texture(1, 0.05)).at(0, 0, 3, turn=(0.2, 0.4, 0)))
    pair, disparity = sequence[0], sequence.geometry(0).disparity
    v, u = np.mgrid[: RIG.height, : RIG.width].astype(float)
    seen = map_coordinates(pair.right.astype(float), [v, u - disparity], order=3, cval=np.nan)
    inside = (u - disparity > 2) & (u - disparity < RIG.width - 3)
    assert np.abs(seen - pair.left)[inside].mean() < 0.01 < 5 * pair.left.std()


def test_a_pair_is_reconstructed_without_bias():
    rig = syn.PAPER_RIG
    sequence = one(syn.plane(20, 20, texture=syn.Texture(2, 0.012)).at(0, 0, 3, turn=(0, 0.3, 0)), rig=rig, faults=None)
    cloud = tspslam.reconstruct(sequence[0])
    column, row = np.floor(cloud.uv + 0.5).astype(int).T
    error = cloud.disparity - map_coordinates(sequence.geometry(0).disparity, cloud.uv.T[::-1], order=1)
    assert len(row) == len(column) > 500
    assert abs(np.median(error)) < 0.02
    assert np.median(np.abs(error)) < 0.1


def test_a_texture_seen_from_afar_fades_to_its_mean():
    tile = syn.Texture(image=np.kron([[0.0, 1.0], [1.0, 0.0]], np.ones((8, 8))))
    image = one(syn.plane(9000, 9000, texture=tile).at(0, 0, 1000))[0].left
    assert np.ptp(image) < 1e-6


def test_a_leaf_keeps_its_size_at_any_distance():
    stripes = np.kron(np.tile([[0.0, 1.0]], (2, 1)), np.ones((32, 32)))
    texture = syn.Texture(texel=0.02, image=stripes, brightness=0.5)
    near, far = (one(syn.plane(90, 90, texture=texture).at(0, 0, z))[0].left > 0.5 for z in (4, 8))
    turns = [np.abs(np.diff(image[48].astype(int))).sum() for image in (near, far)]
    assert abs(turns[1] - 2 * turns[0]) <= 2


def test_edges_of_shapes_are_smoothed():
    plain = syn.Texture(brightness=0.4, contrast=0)
    image = one(syn.plane(2, 2, texture=plain).at(0, 0, 4, turn=(0, 0, 0.3)), background=1.0)[0].left
    levels = np.unique(image.round(5))
    assert 4 < len(levels) < 18  # sixteen rays through a pixel at an edge
    area = (1 - image).sum() / (1 - image.min())
    assert area == pytest.approx(4 * RIG.fx * RIG.fy / 16, rel=2e-3)


def test_poses_move_the_camera():
    box = syn.box(1, 2, 3).at(0.5, 0, 6)
    pose = syn.shapes.pose_at((0.3, -0.2, 1), (0.1, 0.2, -0.1))
    moved = one(box, path=pose[None]).geometry(0)
    inverse = np.linalg.inv(pose)
    same = one(replace(box, pose=inverse @ box.pose)).geometry(0)
    np.testing.assert_allclose(moved.depth, same.depth, rtol=1e-9)


def test_a_moving_shape_is_where_its_velocity_takes_it():
    wall = replace(syn.plane(50, 50).at(0, 0, 4), velocity=(0.0, 0.0, 2.0))
    sequence = one(wall, path=np.eye(4)[None].repeat(6, axis=0))
    assert sequence.geometry(5).depth[40, 40] == pytest.approx(5.0)
    assert sequence.stamps[5] == pytest.approx(0.5)


def test_labels_number_the_shapes():
    sequence = one(syn.plane(90, 90).at(0, 0, 9), syn.sphere(1).at(0, 0, 5))
    assert set(np.unique(sequence.geometry(0).label)) == {1, 2}
    assert one(syn.sphere(1).at(0, 0, 5)).geometry(0).label.min() == 0


def test_frames_repeat_in_any_order_and_differ_by_seed():
    scene, faults = syn.still(4), syn.Faults(noise=0.02, exposure=0.5)
    first, again, other = (syn.SyntheticSequence(scene, RIG, faults, seed=seed) for seed in (5, 5, 6))
    forward = [pair.left.tobytes() + pair.right.tobytes() for pair in first]
    backward = [again[k].left.tobytes() + again[k].right.tobytes() for k in (3, 2, 1, 0)][::-1]
    assert forward == backward
    assert len(set(forward)) == 4
    assert other[0].left.tobytes() != first[0].left.tobytes()


def test_each_fault_does_what_it_says():
    scene = syn.still(3)
    clean = syn.SyntheticSequence(scene, RIG, CLEAN)[0]

    def with_faults(**faults):
        return syn.SyntheticSequence(scene, RIG, replace(CLEAN, **faults))

    noisy = with_faults(noise=0.05)[0].left - clean.left
    assert noisy[(clean.left > 0.2) & (clean.left < 0.8)].std() == pytest.approx(0.05, rel=0.1)
    assert np.abs(np.diff(with_faults(blur=2)[0].left)).mean() < 0.6 * np.abs(np.diff(clean.left)).mean()
    darker = with_faults(exposure=(0.0, -1.0, 0.0))
    np.testing.assert_allclose(darker[1].left, clean.left / 2, atol=1e-6)
    left_out = with_faults(dropped=(1,))
    assert [pair.index for pair in left_out] == [0, 2]
    assert left_out.stamps.tolist() == [0.0, 0.2]
    assert with_faults(right_shift=(0.0, 4.0))[0].right[4:].tobytes() == clean.right[:-4].tobytes()
    assert not np.array_equal(with_faults(right_turn=(0.01, 0, 0))[0].right, clean.right)
    assert syn.SyntheticSequence(scene, RIG)[0].left.dtype == np.uint8


def test_scenes_go_as_far_as_they_say_and_begin_at_the_origin():
    for scene, length in ((syn.street(50), 50), (syn.corridor(20), 20)):
        steps = np.linalg.norm(np.diff(scene.path[:, :3, 3], axis=0), axis=1)
        assert steps.sum() == pytest.approx(length, rel=1e-3)
        np.testing.assert_allclose(scene.path[0], np.eye(4), atol=1e-12)
    loop = syn.room(frames=40, laps=1.5)
    np.testing.assert_allclose(loop.path[40], loop.path[0], atol=1e-9)
    ahead = np.diff(loop.path[:, :3, 3], axis=0)
    looks = loop.path[:-1, :3, 2]
    assert ((ahead * looks).sum(axis=1) > 0.98 * np.linalg.norm(ahead, axis=1)).all()
    assert syn.street(50, seed=1).shapes[1].texture != syn.street(50).shapes[1].texture


def test_a_camera_never_stands_inside_a_thing():
    for scene in (syn.street(60), syn.corridor(30), syn.room(frames=40)):
        sequence = syn.SyntheticSequence(scene, RIG, CLEAN)
        assert min(np.nanmin(sequence.geometry(k).depth) for k in range(0, len(sequence), 5)) > 0.3


def test_what_was_given_is_copied_and_what_is_kept_cannot_be_written_to():
    vertices, faces, pose, path = np.eye(3), np.array([[0, 1, 2]]), np.eye(4), np.eye(4)[None]
    tile, exposure = np.zeros((4, 4)), np.zeros(1)
    shape = syn.Shape("s", vertices, faces, syn.Texture(image=tile), pose, (1, 0, 0))
    scene, faults = syn.Scene([shape], path), syn.Faults(exposure=exposure, dropped=np.array([], int))
    vertices[:], faces[:], pose[:], path[:], tile[:], exposure[:] = np.nan, 9, 0, 0, 9, np.nan
    again = syn.Shape("s", np.eye(3), np.array([[0, 1, 2]]))
    assert scene.shapes[0] is shape
    assert faults == syn.Faults(exposure=(0.0,))
    kept = (shape.vertices, shape.faces, shape.pose, scene.path[0], shape.texture.image)
    for array, expected in zip(
        kept, (again.vertices, again.faces, again.pose, np.eye(4), np.zeros((4, 4))), strict=True
    ):
        assert array.tolist() == expected.tolist()
        with pytest.raises(ValueError, match="read-only"):
            array[:] = 1


def test_one_tile_of_two_textures_is_kept_once():
    tile = np.random.default_rng(0).random((64, 64))
    shapes = [syn.plane(1, 1, texture=syn.Texture(image=tile, brightness=level)) for level in (0.2, 0.8)]
    assert len(syn.render.triangles(syn.Scene(shapes)).levels) == 1


def test_the_ground_reaches_beyond_a_long_street():
    scene = syn.street(9000, step=500)
    assert 1 in syn.SyntheticSequence(scene, RIG, CLEAN).geometry(-1).label[-5:]
    ground = scene.shapes[0].world_vertices()[:, 2]
    assert ground.min() <= -1000 < 10_000 <= ground.max()


def test_small_types_of_numpy_do_not_overflow():
    assert len(syn.sphere(1, rows=np.int8(100)).vertices) == 101 * 200
    assert len(syn.torus(1, 0.4, rows=np.uint8(200), columns=np.int16(300)).vertices) == 60_000
    assert syn.plane(np.float16(2), 1).vertices[2].tolist() == [1, 0.5, 0]
    assert syn.street(np.int8(100), step=np.float32(50)).path.shape == (3, 4, 4)
    assert len(syn.SyntheticSequence(syn.still(np.int8(2)), RIG, CLEAN)[np.int64(-1)].left) == RIG.height


WALL = syn.plane(1, 1)
BAD = {
    "texture: texel is 0": lambda: syn.Texture(texel=0),
    "texture: brightness is nan": lambda: syn.Texture(brightness=np.nan),
    "texture: contrast is array": lambda: syn.Texture(contrast=np.ones((9, 9))),
    "texture: brightness is 'b'": lambda: syn.Texture(brightness="b"),
    "a power of two": lambda: syn.Texture(image=np.zeros((3, 3))),
    "texture: image is <U1": lambda: syn.Texture(image="a"),
    "floats from 0 to 1": lambda: syn.Texture(image=np.full((4, 4), 2.0)),
    "image is bool from 0 to 1, expected floats": lambda: syn.Texture(image=np.eye(4) > 0),
    "image is float64 from nan to nan": lambda: syn.Texture(image=np.full((4, 4), np.nan)),
    "faces name vertices": lambda: syn.Shape("s", np.eye(3), np.array([[0, 1, 3]])),
    "expected \\(F, 3\\) integers": lambda: syn.Shape("s", np.eye(3), np.array([[0.0, 1.0, 2.0]])),
    "vertices holds nan, expected n x 3 finite": lambda: syn.Shape("s", np.full((3, 3), np.nan), np.array([[0, 1, 2]])),
    "vertices has shape \\(3,\\)": lambda: syn.Shape("s", np.ones(3), np.array([[0, 1, 2]])),
    "shape: name is 'a": lambda: syn.plane(1, 1, name="a\nb"),
    "shape: name is None": lambda: syn.Shape(None, np.eye(3), np.array([[0, 1, 2]])),
    "shape plane: texture is ''": lambda: syn.plane(1, 1, texture=""),
    "pose is off a rigid motion": lambda: replace(WALL, pose=np.diag([2.0, 1, 1, 1])),
    "velocity": lambda: replace(WALL, velocity=(np.inf, 0, 0)),
    "stamp is nan": lambda: WALL.world_vertices(np.nan),
    "one Shape or more": lambda: syn.Scene(()),
    "shapes is None": lambda: syn.Scene(None),
    "shapes is <generator": lambda: syn.Scene(shape for shape in [WALL]),
    "shapes is \\(1,\\)": lambda: syn.Scene((1,)),
    "number of poses is 0": lambda: syn.Scene((WALL,), path=np.zeros((0, 4, 4))),
    "number of poses is 100001": lambda: syn.Scene((WALL,), path=np.tile(np.eye(4), (100_001, 1, 1))),
    "path\\[1\\] is off": lambda: syn.Scene((WALL,), path=[np.eye(4), np.zeros((4, 4))]),
    "background is nan": lambda: syn.Scene((WALL,), background=np.nan),
    "scene: name is 'a": lambda: syn.Scene((WALL,), name="a\x1b"),
    "width is -1": lambda: syn.plane(-1, 1),
    "width is 'a', expected a number from 1e-06 to 1e\\+06 m": lambda: syn.plane("a", 1),
    "width is True": lambda: syn.plane(True, 1),
    "place is <U": lambda: syn.plane(1, 1).at("a", 0, 0),
    "less than the major": lambda: syn.torus(1, 1),
    "rows is 2": lambda: syn.torus(1, 0.4, rows=2),
    "rows is 708": lambda: syn.sphere(1, rows=708),
    "columns is 1001": lambda: syn.torus(1, 0.4, rows=1000, columns=1001),
    "noise is -1": lambda: syn.Faults(noise=-1),
    "blur is None": lambda: syn.Faults(blur=None),
    "exposure is -0.5": lambda: syn.Faults(exposure=-0.5),
    "exposure is <U1": lambda: syn.Faults(exposure="a"),
    "exposure has rows of different": lambda: syn.Faults(exposure=[[1], [1, 2]]),
    "exposure holds 11": lambda: syn.Faults(exposure=(11.0,)),
    "right_turn": lambda: syn.Faults(right_turn=(0, 0)),
    "right_shift is object": lambda: syn.Faults(right_shift=None),
    "eight_bit is 'no'": lambda: syn.Faults(eight_bit="no"),
    "dropped is 3": lambda: syn.Faults(dropped=3),
    "dropped is <U1": lambda: syn.Faults(dropped=("a",)),
    "dropped is \\(0.5,\\)": lambda: syn.Faults(dropped=(0.5,)),
    "dropped frames": lambda: one(WALL, faults=syn.Faults(dropped=(0,))),
    "exposure has 2 values": lambda: one(WALL, faults=syn.Faults(exposure=(0.0, 1.0))),
    "sequence: scene is None": lambda: syn.SyntheticSequence(None),
    "sequence: faults is 'x'": lambda: one(WALL, faults="x"),
    "sequence: rig is None": lambda: one(WALL, rig=None),
    "is for 8001 x 8000 px": lambda: one(WALL, rig=replace(RIG, width=8001, height=8000)),
    "is for 32768 x 1 px": lambda: one(WALL, rig=replace(RIG, width=32768, height=1)),
    "index is slice": lambda: one(WALL)[:1],
    "index is '0'": lambda: one(WALL).geometry("0"),
    "rate is 0": lambda: syn.SyntheticSequence(syn.still(1), rate=0),
    "street: length is -3": lambda: syn.street(-3),
    "street: step is 0.001": lambda: syn.street(300, step=0.001),
    "corridor: step is 0": lambda: syn.corridor(3, step=0),
    "corridor: length is None": lambda: syn.corridor(None),
    "room: laps is 0,": lambda: syn.room(laps=0),
    "room: laps is 0.01": lambda: syn.room(laps=0.01, frames=8),
    "room: laps is 90": lambda: syn.room(laps=90, frames=10_000),
    "room: frames is 8.5": lambda: syn.room(frames=8.5),
    "still: frames is True": lambda: syn.still(True),
    "still: depth is inf": lambda: syn.still(1, depth=np.inf),
    "texture: seed": lambda: syn.Texture(seed=-1),
    "sequence: seed": lambda: syn.SyntheticSequence(syn.still(1), seed=0.5),
    "street: seed": lambda: syn.street(20, seed=-1),
    "have no face": lambda: syn.Scene((syn.Shape("s", np.eye(3), np.zeros((0, 3), int)),)),
    "still: frames is 0": lambda: syn.still(0),
}


@pytest.mark.parametrize("said", BAD)
def test_bad_input_gets_one_line(said):
    with pytest.raises(InputError, match=said) as error:
        BAD[said]()
    assert "\n" not in str(error.value)
