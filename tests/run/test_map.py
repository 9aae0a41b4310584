"""Frames laid side by side keep their cells, signals and responses; only places move."""

import numpy as np
import pytest

from tspslam import Session
from tspslam.io import read_frame, write_frame
from tspslam.run.map import merge_frames
from tspslam.vision.se3 import inverse

from ..sequences import corridor


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    folder, found = tmp_path_factory.mktemp("frames"), []
    walk = corridor(2.0)
    session = Session(walk.rig)
    for pair in (walk[0], walk[3]):
        write_frame(folder / "frame.npz", session.process(pair))
        found.append(read_frame(folder / "frame.npz"))
    return found, walk.truth[[0, 3]]


def test_the_union_is_made_of_its_parts(frames):
    parts, poses = frames
    whole = merge_frames(parts, poses)
    n, e = len(parts[0].cloud), len(parts[0].complex_.edges)
    assert whole.complex_.n == len(whole.cloud) == n + len(parts[1].cloud)
    assert whole.complex_.euler == sum(part.complex_.euler for part in parts)
    assert np.array_equal(whole.complex_.edges[e:], parts[1].complex_.edges + n)
    assert np.array_equal(whole.complex_.faces, np.concatenate([parts[0].complex_.faces, parts[1].complex_.faces + n]))
    assert np.array_equal(whole.signals.edge[e:], parts[1].signals.edge)
    assert np.array_equal(whole.response.z[n:], parts[1].response.z)


def test_points_lie_in_the_world_and_their_covariance_turns_along(frames):
    parts, poses = frames
    whole, n = merge_frames(parts, poses), len(parts[0].cloud)
    back = inverse(poses[1])
    np.testing.assert_allclose(whole.cloud.xyz[n:] @ back[:3, :3].T + back[:3, 3], parts[1].cloud.xyz, atol=1e-9)
    volumes = [np.linalg.det(cloud.covariance) for cloud in (whole.cloud, parts[1].cloud)]
    np.testing.assert_allclose(volumes[0][n:], volumes[1], rtol=1e-6)


def test_one_frame_stays_what_it_is(frames):
    parts, _ = frames
    whole = merge_frames(parts[:1], np.eye(4)[None])
    assert np.array_equal(whole.cloud.xyz, parts[0].cloud.xyz)
    assert whole.complex_ is parts[0].complex_
