"""Landmarks are found again where they are, and not where they are not."""

import numpy as np
import pytest

from tspslam.mapping.searching import find_again
from tspslam.mapping.settings import ObservationSettings
from tspslam.mapping.views import NOTHING, to_camera

from .worlds import RIG, sightings, wall

SETTINGS = ObservationSettings()
SHIFT = 12.0  # px


def search(world, known, xyz=None, settings=SETTINGS):
    return find_again(world.views, world.rig, world.snapshot.xyz if xyz is None else xyz, known, settings)


def first_known(world, keyframes=(0,)):
    """What some keyframes know, of landmarks with a whole patch around them."""
    known = world.known()
    return known.take(np.isin(known.keyframe, keyframes) & is_whole(known.uv))


def is_whole(uv):
    return ((uv >= 6) & (uv <= (RIG.width - 7, RIG.height - 7))).all(axis=1)


def errors(world, found):
    """Distance of what was found from the truth, px."""
    true = sightings(world.rig, world.snapshot.T_world_camera, world.snapshot.xyz)
    keys = zip(true.landmark.tolist(), true.keyframe.tolist(), strict=True)
    place = dict(zip(keys, true.uv, strict=True))
    keys = zip(found.landmark.tolist(), found.keyframe.tolist(), strict=True)
    return np.linalg.norm([uv - place[key] for key, uv in zip(keys, found.uv, strict=True)], axis=1)


def share_found(world, known, found):
    true = world.known()
    wanted = np.isin(true.landmark, known.landmark) & ~np.isin(true.keyframe, known.keyframe) & is_whole(true.uv)
    return len(found.landmark) / wanted.sum()


@pytest.mark.parametrize("known_by", [0, 3, 6])
def test_landmarks_of_one_keyframe_are_found_in_the_others(known_by):
    world = wall()
    known = first_known(world, (known_by,))
    found = search(world, known)
    assert share_found(world, known, found) > 0.8
    assert np.median(errors(world, found)) < 0.2
    assert (errors(world, found) <= SETTINGS.reach).all()


def test_shifted_projections_hardly_match():
    world = wall()
    known = first_known(world)
    depth = to_camera(world.snapshot.xyz, world.snapshot.T_world_camera[0])[:, 2]
    aside = np.outer(SHIFT * depth / RIG.fx, world.snapshot.T_world_camera[0][:3, 0])
    there, shifted = search(world, known), search(world, known, world.snapshot.xyz + aside)
    assert len(there.landmark) > 400
    assert len(shifted.landmark) < 0.05 * len(there.landmark)


def test_what_is_known_is_not_looked_for():
    world = wall()
    known = first_known(world, (0, 2, 5))
    found = search(world, known)
    given = set(zip(known.landmark.tolist(), known.keyframe.tolist(), strict=True))
    new = list(zip(found.landmark.tolist(), found.keyframe.tolist(), strict=True))
    assert len(set(new)) == len(new)
    assert not given & set(new)
    assert len(search(world, world.known()).landmark) == 0


def test_disparities_are_those_of_the_places_and_keyframes_ascend():
    world = wall()
    found = search(world, first_known(world))
    T = world.snapshot.T_world_camera[found.keyframe]
    depth = np.einsum("oi,oi->o", world.snapshot.xyz[found.landmark] - T[:, :3, 3], T[:, :3, 2])
    assert found.disparity == pytest.approx(RIG.fx * RIG.baseline / depth - RIG.doffs)
    assert (np.diff(found.keyframe) >= 0).all()


def test_plain_images_and_nothing_known_give_nothing():
    world = wall()
    plain = world.show([np.full((RIG.height, RIG.width), 90, np.uint8)] * 7)
    assert len(search(plain, first_known(world)).landmark) == 0
    assert len(search(world, NOTHING).landmark) == 0


def test_a_landmark_is_followed_until_it_is_missed():
    world = wall()
    blind = world.show([v.image if k < 2 or k > 3 else 0 * v.image for k, v in enumerate(world.views)])
    patient = search(blind, first_known(world), settings=ObservationSettings(misses=3, revisits=0))
    hasty = search(blind, first_known(world), settings=ObservationSettings(misses=2, revisits=0))
    assert set(hasty.keyframe) == {1}
    assert set(patient.keyframe) == {1, 4, 5}  # the sixth is no neighbour of the first


def test_keyframes_of_other_passes_are_looked_at():
    world = wall().take([0, 1, 1, 1, 2])
    blind = world.show([v.image if k in (0, 4) else 0 * v.image for k, v in enumerate(world.views)])
    known = first_known(blind, (0, 4))
    known = known.take((known.landmark % 3 == 0) == (known.keyframe == 4))  # no landmark is known to both
    alone = search(blind, known, settings=ObservationSettings(neighbours=1, misses=1, revisits=0))
    again = search(blind, known, settings=ObservationSettings(neighbours=1, misses=1, revisits=3))
    assert len(alone.landmark) == 0
    assert set(again.keyframe) == {0, 4}
    assert set(again.landmark[again.keyframe == 0] % 3) == {0}
    assert len(again.landmark) > 0.8 * len(known.landmark)
