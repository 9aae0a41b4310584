"""A town stands off all of the path, on the ground below it, and is one world however often it is passed."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from tests.datasets.standard import DATA
from tspslam import Rig
from tspslam.datasets import synthetic as syn
from tspslam.errors import InputError

RIG = Rig(fx=90, fy=95, cx=61.3, cy=44.7, baseline=0.5, width=128, height=96, skew=0.7, doffs=3.0)
CLEAN = syn.Faults(eight_bit=False)
CLEAR = {"house": 6.0, "car": 2.0, "pole": 2.5}  # m


def wavy(length=150.0, rise=6.0):
    """Poses a metre apart up and down a hill, to and fro in lanes 3.5 m apart."""
    z = np.concatenate([np.arange(0, length), np.arange(length, 0, -1)])
    back = np.arange(len(z)) >= len(z) // 2
    x, y = np.where(back, -3.5, 0.0), -rise * np.sin(z / 25)
    return np.stack([syn.shapes.pose_at(at, (0, np.pi * b, 0)) for *at, b in zip(x, y, z, back, strict=True)])


@pytest.fixture(scope="module")
def scene():
    return syn.town(syn.town_path(block=40), seed=3)


def outline(shape):
    """Points 0.1 m apart around a box's foot, (N, 2); its middle too."""
    corners = np.unique(shape.world_vertices()[:, [0, 2]].round(9), axis=0)
    middle = corners.mean(axis=0)
    order = np.argsort(np.arctan2(*(corners - middle).T))
    ends = corners[order], np.roll(corners[order], -1, axis=0)
    count = int(np.linalg.norm(ends[1] - ends[0], axis=1).max() / 0.1) + 2
    share = np.linspace(0, 1, count)[:, None, None]
    return np.concatenate([((1 - share) * ends[0] + share * ends[1]).reshape(-1, 2), middle[None]])


def within(shape, places):
    """Whether places (N, 2) are on the ground that a box stands on."""
    local = (places - shape.pose[[0, 2], 3]) @ shape.pose[:3, :3][[0, 2]][:, [0, 2]]
    return (np.abs(local) < np.abs(shape.vertices[:, [0, 2]]).max(axis=0) - 1e-9).all(axis=1)


def things(scene):
    return [shape for shape in scene.shapes if shape.name in CLEAR]


def check_clear(scene):
    """Nothing is nearer to any pose than its kind may be, and nothing stands in another thing."""
    road = cKDTree(scene.path[:, :3, 3][:, [0, 2]])
    outlines = [outline(shape) for shape in things(scene)]
    for shape, points in zip(things(scene), outlines, strict=True):
        assert road.query(points)[0].min() > CLEAR[shape.name] - 1e-6
        assert not within(shape, scene.path[:, :3, 3][:, [0, 2]]).any()
    middles = cKDTree([points[-1] for points in outlines])
    for i, j in middles.query_pairs(20.0):
        assert not within(things(scene)[i], outlines[j]).any()
        assert not within(things(scene)[j], outlines[i]).any()


def test_nothing_stands_on_the_road_or_in_another_thing(scene):
    check_clear(scene)
    names = [shape.name for shape in things(scene)]
    assert min(names.count(name) for name in CLEAR) > 10


def test_a_path_that_comes_back_in_another_lane_stays_free():
    check_clear(syn.town(wavy(), seed=1))


def test_the_town_of_a_real_path_stands_off_it():
    file = DATA / "kitti_poses" / "07.txt"
    if not file.exists():
        pytest.skip(f"{file} is not here: set TSPSLAM_DATA")
    poses = np.tile(np.eye(4), (1101, 1, 1))
    poses[:, :3] = np.loadtxt(file).reshape(-1, 3, 4)
    check_clear(syn.town(poses))


def test_a_town_seen_is_that_of_a_plain_ray_caster(scene):
    sequence = syn.SyntheticSequence(scene, RIG, CLEAN)
    seen = sequence.geometry(40)
    v, u = np.mgrid[: RIG.height : 3, : RIG.width : 3].astype(float)
    y = (v - RIG.cy) / RIG.fy
    ray = np.stack([(u - RIG.cx - RIG.skew * y) / RIG.fx, y, np.ones_like(y)], axis=-1).reshape(-1, 3)
    pose, depth, label = scene.path[40], np.full(len(ray), np.inf), np.zeros(len(ray), int)
    for number, shape in enumerate(scene.shapes, 1):
        corners = ((shape.world_vertices() - pose[:3, 3]) @ pose[:3, :3])[shape.faces]
        if (corners[..., 2] < 0).all() and len(corners) != 12:
            continue  # ground behind the camera
        for a, b, c in corners:
            normal = np.cross(b - a, c - a)
            with np.errstate(all="ignore"):
                z = (normal @ a) / (ray @ normal)
                at = z[:, None] * ray
                sides = [np.cross(q - p, at - p) @ normal for p, q in ((a, b), (b, c), (c, a))]
                hit = (np.min(sides, axis=0) >= 0) & (z > 0) & (z < depth)
            depth[hit], label[hit] = z[hit], number
    mine = seen.label[::3, ::3].ravel()
    same = mine == label
    assert same.mean() > 0.999  # rays that graze a side
    hit = same & (label > 0)
    assert len(np.unique(label)) > 8
    np.testing.assert_allclose(seen.depth[::3, ::3].ravel()[hit], depth[hit], rtol=1e-9)


def test_the_right_image_shows_the_left_one_at_the_disparity_and_on_its_row(scene):
    sequence = syn.SyntheticSequence(scene, RIG, CLEAN)
    pair, geometry = sequence[40], sequence.geometry(40)
    v, u = np.mgrid[: RIG.height, : RIG.width].astype(float)
    there = u - geometry.disparity
    inside = (there > 2) & (there < RIG.width - 3) & (geometry.label > 0)
    off = {}
    for row in (-1.0, -0.5, 0.0, 0.5, 1.0):
        seen = map_coordinates(pair.right.astype(float), [v + row, np.nan_to_num(there)], order=3, mode="nearest")
        off[row] = np.median(np.abs(seen - pair.left)[inside])
    assert min(off, key=off.get) == 0.0
    assert off[0.0] < 0.3 * min(off[-0.5], off[0.5])


def test_the_ground_lies_below_the_path_at_its_height():
    path, rig = wavy(rise=3.0), Rig(fx=60, fy=60, cx=40, cy=5, baseline=0.5, width=80, height=60)
    scene = syn.town(path, height=1.2)
    sequence = syn.SyntheticSequence(scene, rig, CLEAN)
    road = cKDTree(path[:, :3, 3][:, [0, 2]])
    for k in (5, 60, 200):
        geometry = sequence.geometry(k)
        is_ground = np.isin(geometry.label, [n for n, s in enumerate(scene.shapes, 1) if s.name == "ground"])
        v, u = np.nonzero(is_ground & (geometry.depth < 15))
        z = geometry.depth[v, u]
        local = np.stack([(u - rig.cx) / rig.fx * z, (v - rig.cy) / rig.fy * z, z], axis=1)
        world = local @ path[k, :3, :3].T + path[k, :3, 3]
        away = road.query(world[:, [0, 2]])[0]
        off = world[:, 1] - (1.2 - 3 * np.sin(world[:, 2] / 25))
        assert (away < 2).sum() > 100
        assert np.abs(off[away < 2]).max() < 0.15  # evened over 4 m of a hill whose slope changes by 0.5 % a metre


def test_the_same_seed_gives_the_same_town(scene):
    again, other = syn.town(syn.town_path(block=40), seed=3), syn.town(syn.town_path(block=40), seed=4)

    def images(made):
        pair = syn.SyntheticSequence(made, RIG, syn.Faults(noise=0.01))[7]
        return pair.left.tobytes() + pair.right.tobytes()

    assert images(scene) == images(again)
    assert images(scene) != images(other)


def test_a_round_through_town_comes_back_and_never_jumps():
    path = syn.town_path(2, block=60, step=0.5)
    one = len(path) // 2
    np.testing.assert_allclose(path[0], np.eye(4), atol=1e-9)
    step = np.linalg.norm(np.diff(path[:, :3, 3], axis=0), axis=1)
    assert step.max() < 0.5 + 1e-6
    assert step.min() > 0.4  # chords of corners are shorter
    ahead = np.einsum("ki,ki->k", path[:-1, :3, 2], path[1:, :3, 2])
    assert np.degrees(np.arccos(np.clip(ahead, -1, 1))).max() < 8
    along = np.einsum("ki,ki->k", np.diff(path[:, :3, 3], axis=0), path[:-1, :3, 2])
    assert (along > 0.99 * step).all()
    away = cKDTree(path[:one, :3, 3]).query(path[one:, :3, 3])[0]
    assert away.max() < 0.5  # the second lap is the first


def bad_path(**changed):
    path = wavy()
    for key, value in changed.items():
        path[int(key[1:])] = value
    return path


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: syn.town(bad_path(k5=2 * np.eye(4))), "path[5] is off a rigid motion"),
        (lambda: syn.town(np.tile(np.eye(4), (4, 1, 1))), "path goes 0 m along x and z, expected 1 to 20000"),
        (lambda: syn.town(np.eye(4)), "path has shape (4, 4)"),
        (lambda: syn.town(wavy(), height=-1), "height is -1, expected a number from 0.1 to 100"),
        (lambda: syn.town(wavy(), seed=-1), "seed is -1"),
        (lambda: syn.town_path(0), "laps is 0, expected a whole number from 1 to 100"),
        (lambda: syn.town_path(block=5), "block is 5, expected a number from 40 to 1000 m"),
        (lambda: syn.town_path(100, step=1e-3), "step is 0.001"),
    ],
)
def test_what_makes_no_town_is_one_line(call, said):
    with pytest.raises(InputError) as refused:
        call()
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
