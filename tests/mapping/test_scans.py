"""Scans joined: a place is covered once, by the scan that comes first."""

from itertools import combinations

import numpy as np
import pytest

from tspslam import GeometryError, InputError
from tspslam.mapping.scans import PlacedScan, join_scans


def sheet(first, last, z=0.0):
    """A sheet of squares of 0.5 m."""
    u, v = np.meshgrid(np.arange(first, last + 0.1, 0.5), np.arange(0, 2.1, 0.5), indexing="ij")
    i, j = (a.ravel() for a in np.meshgrid(np.arange(len(u) - 1), np.arange(4), indexing="ij"))
    corner = 5 * i + j
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 5], 1), np.stack([corner + 1, corner + 6, corner + 5], 1)]
    )
    return PlacedScan(np.column_stack([u.ravel(), v.ravel(), np.full(u.size, z)]), faces.astype(np.int32))


def test_what_an_earlier_scan_has_is_not_covered_again():
    one, other = sheet(0, 4), sheet(2, 8, 0.01)
    joined = join_scans([one, other], 0.2)
    np.testing.assert_array_equal(joined.xyz[: len(one.xyz)], one.xyz)
    added = joined.xyz[len(one.xyz) :]
    assert added[:, 0].min() > 4.0
    assert added[:, 0].max() == 8.0
    assert len(joined.faces) == len(one.faces) + 2 * 4 * 7  # from the row of corners at 4.5 m on
    np.testing.assert_array_equal(join_scans([other], 0.2).faces, other.faces)


def test_the_same_scan_again_adds_nothing_and_another_sheet_all():
    one, above = sheet(0, 4), sheet(0, 4, 1.0)
    assert len(join_scans([one, one, one], 0.1).faces) == len(one.faces)
    assert len(join_scans([one, above], 0.1).faces) == 2 * len(one.faces)


def test_every_point_has_a_face():
    one, other = sheet(0, 4), sheet(2, 8)
    joined = join_scans([one, PlacedScan(np.concatenate([other.xyz, [[50.0, 0, 0]]]), other.faces)], 0.2)
    np.testing.assert_array_equal(np.unique(joined.faces), np.arange(len(joined.xyz)))


def test_what_cannot_be_joined_is_told():
    one = sheet(0, 4)
    with pytest.raises(InputError, match="expected less than"):
        join_scans([one], 1e-7)
    with pytest.raises(InputError, match="expected larger voxels"):
        join_scans([PlacedScan(one.xyz, np.array(list(combinations(range(len(one.xyz)), 3)), np.int32))], 8e-6)
    with pytest.raises(GeometryError, match="no face of 1 scans"):
        join_scans([PlacedScan(one.xyz, one.faces[:0])], 0.1)
