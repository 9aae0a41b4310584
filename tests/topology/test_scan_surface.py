"""The surface of a scan: a manifold that faces the scanner, closed around the turn, without a face over a step."""

import os
from pathlib import Path

import numpy as np
import pytest

from tspslam import GeometryError, InputError
from tspslam.datasets import synthetic
from tspslam.datasets.synthetic.scanner import AXES
from tspslam.io.clouds import read_scan
from tspslam.topology.diagnosis import diagnose_surface
from tspslam.topology.scan_surface import ScanSurface, find_rings, scan_surface

DATA = Path(os.environ.get("TSPSLAM_DATA", Path(__file__).parents[3] / "shared" / "data"))
SCANNER = synthetic.Scanner(beams=32, columns=720, lowest=-30, highest=20)
CORRIDOR = synthetic.corridor(10.0)
POSE = CORRIDOR.path[4] @ AXES


@pytest.fixture(scope="module")
def echoes():
    return synthetic.scan(CORRIDOR, POSE, SCANNER)


@pytest.fixture(scope="module")
def rays():
    """Directions of a whole scan."""
    return synthetic.scan(synthetic.Scene((synthetic.sphere(50.0),)), AXES, SCANNER)


def areas(xyz, faces):
    a, b, c = (xyz[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    return 0.5 * np.linalg.norm(normal, axis=1), normal, a


def both(echoes):
    """The surface by rings, and by Delaunay: shuffled points of a noisy scanner are in no rings that one could find."""
    shuffled = np.random.default_rng(1).permutation(len(echoes.xyz))
    turned = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    yield echoes.xyz, scan_surface(echoes.xyz, echoes.ring), True
    mixed = (echoes.xyz @ turned.T)[shuffled]
    yield mixed, scan_surface(mixed), False


def test_the_sheet_is_a_manifold_that_faces_the_scanner(echoes):
    for xyz, surface, has_rings in both(echoes):
        assert (surface.rings == 32) == has_rings
        told = diagnose_surface(surface.faces, xyz)
        assert told.is_edge_manifold
        assert told.is_oriented
        _, normal, corner = areas(xyz, surface.faces)
        assert (np.einsum("fi,fi->f", normal, corner) < 0).mean() > 0.999


def test_a_scan_without_steps_is_one_annulus_closed_around_the_turn(rays):
    told = diagnose_surface(scan_surface(rays.xyz, rays.ring).faces, rays.xyz)
    assert (told.components, told.euler, len(told.boundary_loops)) == (1, 0, 2)
    assert not len(told.unused)
    assert not len(told.pinched)


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_no_face_is_over_a_step(noise):
    """Shapes that float before one another: a face with corners on two of them is over a step. Without cuts are many."""
    floating = (
        synthetic.sphere(20.0),
        synthetic.box(1, 3, 1).at(0.5, 0, 5, turn=(0, 0.5, 0)),
        synthetic.plane(3, 2).at(-2, 0, 8, turn=(0.3, 0.6, 0)),
        synthetic.sphere(0.7).at(0, 0.3, -3),
    )
    found = synthetic.scan(
        synthetic.Scene(floating), AXES, synthetic.Scanner(beams=64, columns=720, lowest=-30, highest=20, noise=noise)
    )

    def over(faces):
        label = found.label[faces]
        return int((label.min(axis=1) != label.max(axis=1)).sum())

    everything = ScanSurface(max_range_ratio=1e9)(found.xyz, found.ring).faces
    assert over(everything) > 500
    kept = scan_surface(found.xyz, found.ring).faces
    assert over(kept) == 0
    assert len(kept) > 0.99 * (len(everything) - over(everything))


def test_slopes_are_no_steps():
    """A road seen at a grazing angle keeps its faces though ranges of rings differ by more than the limit."""
    road = synthetic.Scene((synthetic.plane(400, 400).at(0, 1.65, 0, turn=(np.pi / 2, 0, 0)),))
    low = synthetic.Scanner(beams=32, columns=720, lowest=-25, highest=-2, noise=0.01)
    found = synthetic.scan(road, AXES, low)
    kept = scan_surface(found.xyz, found.ring).faces
    whole = ScanSurface(max_range_ratio=1e9)(found.xyz, found.ring).faces
    distance = np.linalg.norm(found.xyz, axis=1)[whole]
    assert (distance.max(axis=1) > 1.02 * distance.min(axis=1)).mean() > 0.3
    inner = len(whole) - 2 * 720  # those at the border have no two neighbours to agree with
    assert len(kept) > 0.97 * inner


def test_areas_are_those_of_the_walls(echoes):
    """The corridor is 2.6 m wide and 2.7 m high; a piece of wall is as large as its outline says."""
    surface = scan_surface(echoes.xyz, echoes.ring)
    world = echoes.xyz @ POSE[:3, :3].T + POSE[:3, 3]
    label = echoes.label[surface.faces]
    floor = surface.faces[(label == 1).all(axis=1)]
    assert len(floor) > 1000
    size, normal, _ = areas(world, floor)
    unit = np.abs(normal[:, 1]) / np.linalg.norm(normal, axis=1)
    assert unit.min() > 1 - 1e-9  # it is flat
    flat = world[floor][:, :, [0, 2]]
    p, q = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    signed = 0.5 * (p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    assert abs(signed.sum()) == pytest.approx(size.sum(), rel=1e-9)  # and covers no place twice


def test_rings_are_found_in_rows_ring_by_ring_and_by_elevation(echoes):
    np.testing.assert_array_equal(find_rings(echoes.xyz), echoes.ring)
    mixed = np.random.default_rng(3).permutation(len(echoes.xyz))
    by_elevation = find_rings(echoes.xyz[mixed])
    np.testing.assert_array_equal(31 - by_elevation, echoes.ring[mixed])


def test_no_rings_are_found_where_there_are_none():
    rng = np.random.default_rng(4)
    cloud = rng.normal(size=(5000, 3))
    assert find_rings(cloud) is None
    assert find_rings(cloud[:1]) is None
    assert scan_surface(np.add(cloud[:500], (9, 0, 0)), np.arange(500) % 16).rings == 0  # rings that explain nothing


def test_faces_do_not_depend_on_the_order_of_the_rows(echoes):
    mixed = np.random.default_rng(5).permutation(len(echoes.xyz))
    one = scan_surface(echoes.xyz, echoes.ring).faces
    other = mixed[scan_surface(echoes.xyz[mixed], echoes.ring[mixed]).faces]
    assert {tuple(sorted(face)) for face in one.tolist()} == {tuple(sorted(face)) for face in other.tolist()}


def doubled(echoes):
    """Rows twice; second returns behind the first of each beam; both from a scanner that turns the other way."""
    ring = np.repeat(echoes.ring, 2)
    yield np.repeat(echoes.xyz, 2, axis=0), ring
    behind = np.repeat(echoes.xyz, 2, axis=0)
    behind[1::2] = (1.3 * behind[1::2]).astype(np.float32)  # rounded as in files
    yield behind, ring
    turn = np.radians(0.1)  # so that no column is at the seam of azimuths
    x, y = (
        np.cos(turn) * behind[:, 0] - np.sin(turn) * behind[:, 1],
        np.sin(turn) * behind[:, 0] + np.cos(turn) * behind[:, 1],
    )
    yield np.column_stack([x, -y, behind[:, 2]]), ring


@pytest.mark.parametrize("has_rings", [True, False])
def test_second_returns_and_doubled_rows_change_no_face(echoes, has_rings):
    for xyz, ring in doubled(echoes):
        once = scan_surface(xyz[::2], ring[::2] if has_rings else None)
        twice = scan_surface(xyz, ring if has_rings else None)
        assert (twice.merged, twice.rings) == (len(echoes.xyz), once.rings)
        np.testing.assert_array_equal(twice.faces, 2 * once.faces)


def test_doubled_directions_in_no_ring_change_no_face(echoes):
    turned = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    xyz = (echoes.xyz @ turned.T)[np.random.default_rng(1).permutation(len(echoes.xyz))][:4000]
    once, twice = scan_surface(xyz), scan_surface(np.concatenate([1.2 * xyz, xyz]))
    assert (twice.rings, twice.merged) == (0, 4000)
    assert {tuple(sorted(face)) for face in twice.faces - 4000} == {tuple(sorted(face)) for face in once.faces}


def test_returns_on_both_sides_of_the_seam_are_one_beam():
    turn = np.linspace(-np.pi, np.pi, 91)  # the last is the first
    xyz = np.concatenate([np.column_stack([np.cos(turn), np.sin(turn), np.full(91, z)]) for z in (-0.3, -0.2, -0.1, 0)])
    surface = scan_surface(xyz, np.repeat(np.arange(4), 91))
    assert (surface.merged, len(surface.faces)) == (4, 2 * 3 * 90)


def test_missing_returns_leave_a_hole(rays):
    azimuth = np.degrees(np.arctan2(rays.xyz[:, 1], rays.xyz[:, 0]))
    some = (np.abs(azimuth - 40) > 5) | (rays.ring < 10) | (rays.ring > 20)
    told = diagnose_surface(scan_surface(rays.xyz[some], rays.ring[some]).faces, rays.xyz[some])
    assert (told.components, len(told.boundary_loops)) == (1, 3)


@pytest.mark.parametrize(
    ("xyz", "ring", "said"),
    [
        (np.zeros((3, 3)), None, "point 0 is at the scanner itself"),
        ([[1.0, 0, 0], [0, 1, 0], [np.nan, 0, 1]], None, "point 2 is"),
        (np.ones((3, 2)), None, "expected numbers of shape"),
        (np.eye(3), [0, 1], "ring is"),
        (np.eye(3), [0.0, 1, 2], "ring is"),
    ],
)
def test_bad_input_is_refused(xyz, ring, said):
    with pytest.raises(InputError, match=said):
        scan_surface(xyz, ring)


def test_points_that_span_nothing_are_told():
    with pytest.raises(GeometryError, match="2 points"):
        scan_surface(np.eye(3)[:2])
    with pytest.raises(GeometryError, match="points are in 1 directions"):
        scan_surface(np.outer(np.arange(1.0, 9.0), (1, 2, 3)))
    with pytest.raises(InputError, match="max_gap is 0"):
        ScanSurface(max_gap=0.5)


def test_real_scans_have_64_rings():
    files = sorted((DATA / "kitti_raw_0926/velodyne").glob("*.txt"))
    if not files:
        pytest.skip("kitti_raw_0926 is not in the data folder (TSPSLAM_DATA)")
    xyz = read_scan(files[0]).xyz
    surface = scan_surface(xyz)
    assert surface.rings == 64
    told = diagnose_surface(surface.faces, xyz)
    assert told.is_edge_manifold
    assert told.is_oriented
    assert len(surface.faces) > 1.5 * len(xyz)
