"""The map as a whole: it moves with the world, no order matters, a constant says nothing, one keyframe is itself."""

from dataclasses import fields, replace

import numpy as np
import pytest

from tspslam import Cloud, Frame, Surface, build_complex, sample_signals, set_threads
from tspslam.errors import GeometryError, InputError
from tspslam.mapping.build import make_map, map_of_frame
from tspslam.mapping.settings import MappingSettings, ObservationSettings, SurfaceSettings, ViewSettings
from tspslam.mapping.views import to_camera
from tspslam.mapping.visibility import face_normals
from tspslam.topology.harmonic import Tmahf
from tspslam.vision.rig import back_project, covariance

from .worlds import RIG, border_loops, names, pose_at, room, sightings, wall, world_of

MOTION = pose_at((3.0, -20, 7), (0.3, -1.1, 0.7))


def rough():
    """A wall in general position, with noise."""
    return wall(rough=0.02, noise=0.2)


def same_signals(one, other, abs_):
    for level in ("vertex", "edge", "face"):
        assert getattr(one.signals, level) == pytest.approx(getattr(other.signals, level), abs=abs_)
        assert getattr(one.view_variance, level) == pytest.approx(getattr(other.view_variance, level), abs=abs_)
        assert np.array_equal(getattr(one.view_count, level), getattr(other.view_count, level))


@pytest.mark.parametrize("make", [rough, lambda: room(800, noise=0.2)], ids=["wall", "room"])
def test_to_shift_the_world_shifts_the_map(make):
    T = pose_at((3.0, -20, 7))
    still, moved = make().map(), make().move(T).map()
    assert np.array_equal(moved.landmark_id, still.landmark_id)
    assert np.array_equal(moved.surface.faces, still.surface.faces)
    same_signals(moved, still, 1e-7)
    assert moved.xyz == pytest.approx(still.xyz + T[:3, 3], abs=1e-6)
    assert moved.covariance == pytest.approx(still.covariance, abs=1e-7)
    assert moved.response.z == pytest.approx(still.response.z, abs=1e-6)
    assert moved.direction == pytest.approx(still.direction, abs=1e-4)


@pytest.mark.parametrize("make", [rough, lambda: room(800, noise=0.2)], ids=["wall", "room"])
def test_to_move_the_world_moves_the_map(make):
    still, moved = make().map(), make().move(MOTION).map()
    both = names(still) & names(moved)  # the box around the landmarks does not turn: at its outline a face may differ
    assert len(both) >= 0.98 * max(len(names(still)), len(names(moved)))
    _, a, b = np.intersect1d(still.landmark_id, moved.landmark_id, return_indices=True)
    assert len(a) >= 0.98 * len(still)
    R = MOTION[:3, :3]
    assert moved.xyz[b] == pytest.approx(still.xyz[a] @ R.T + MOTION[:3, 3], abs=1e-6)
    assert moved.covariance[b] == pytest.approx(R @ still.covariance[a] @ R.T, abs=1e-7)
    before, after = stars(still), stars(moved)
    is_same = np.array([before[i] == after[j] for i, j in zip(a, b, strict=True)])
    assert is_same.mean() > 0.9
    a, b = a[is_same], b[is_same]
    off = np.abs(moved.response.z[b] - still.response.z[a])
    turned = np.linalg.norm(moved.direction[b] - still.direction[a] @ R.T, axis=1)
    assert np.mean(off < 1e-6) > 0.98  # a best view may be another one where two are equally good
    assert np.mean(turned < 1e-4) > 0.98
    assert moved.signals.vertex[b] == pytest.approx(still.signals.vertex[a], abs=1e-3)  # gains are of all faces


def stars(found):
    """Faces around each vertex, by the landmarks' numbers."""
    around = [set() for _ in range(len(found))]
    for face in found.surface.faces.tolist():
        for i in face:
            around[i].add(tuple(sorted(found.landmark_id[face].tolist())))
    return around


@pytest.mark.parametrize("seed", [1, 2])
def test_the_order_in_which_keyframes_are_given_does_not_matter(seed):
    world = rough()
    order = np.random.default_rng(seed).permutation(len(world.views))
    assert everything(world.map()) == everything(world.take(order).map())


@pytest.mark.parametrize("make", [rough, lambda: room(800, noise=0.2)], ids=["wall", "room"])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_order_in_which_keyframes_came_does_not_matter_to_what_the_path_knows(make, seed):
    """Every keyframe knows all that it sees, so that nothing is left to be found."""
    world = make()
    order = np.random.default_rng(seed).permutation(len(world.views))
    one, other = world.map(), world.take(order).renumber().map()
    assert names(one) == names(other)
    assert np.array_equal(one.landmark_id, other.landmark_id)
    assert np.array_equal(one.complex_.faces, other.complex_.faces)
    assert other.xyz == pytest.approx(one.xyz, abs=1e-9)
    assert other.response.z == pytest.approx(one.response.z, abs=1e-9)
    # gains compare keyframes that follow one another
    assert other.gain == pytest.approx(one.gain[order], abs=0.01)
    same_signals(one, other, 5e-3)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_order_in_which_keyframes_came_does_not_matter_to_signals_of_one_exposure(seed):
    world = room(800, noise=0.2)
    alike = MappingSettings(views=ViewSettings(min_shared=10_000))  # exposures are not compared
    order = np.random.default_rng(seed).permutation(len(world.views))
    same_signals(world.map(alike), world.take(order).renumber().map(alike), 1e-9)


def test_the_order_in_which_keyframes_came_hardly_matters_to_what_is_found():
    world = rough()
    known = world.known()
    some = known.take((known.landmark + 3 * known.keyframe) % 7 < 3)
    snapshot = world.snapshot
    less = world_of(RIG, snapshot.T_world_camera, snapshot.xyz, [view.image for view in world.views], known=some)
    one, other = less.map(), less.take(np.arange(7)[::-1]).renumber().map()
    ids, a, b = np.intersect1d(one.landmark_id, other.landmark_id, return_indices=True)
    assert len(ids) > 0.95 * max(len(one), len(other))
    sigma = np.sqrt(np.trace(one.covariance[a], axis1=1, axis2=2))
    assert (np.linalg.norm(one.xyz[a] - other.xyz[b], axis=1) < 3 * sigma).mean() > 0.95
    assert len(one.observations) == pytest.approx(len(other.observations), rel=0.1)


@pytest.mark.parametrize("luminance", [0.0, 0.4, 0.4137, 1.0])
def test_a_constant_world_gives_no_response_and_gains_of_one(luminance):
    world = rough()
    found = world.show([np.full((RIG.height, RIG.width), luminance)] * 7).map()
    assert np.abs(found.response.z).max() < 1e-12
    assert not found.direction.any()
    assert not found.direction_spread.any()
    assert found.gain == pytest.approx(1, abs=1e-12)
    for values, count in zip(
        (found.signals.vertex, found.signals.edge, found.signals.face), found.view_count, strict=True
    ):
        assert values[count > 0] == pytest.approx(luminance, abs=1e-12)
        assert (count > 0).all()
    assert max(variance.max() for variance in found.view_variance) < 1e-20


def test_another_exposure_is_taken_out():
    world = rough()
    plain = [view.image / 510.0 for view in world.views]
    gains = 2.0 ** np.array([0.3, -0.5, 0.1, 0.7, -0.2, -0.4, 0])
    one = world.show(plain).map()
    other = world.show([gain * image for gain, image in zip(gains, plain, strict=True)]).map()
    assert np.log2(other.gain * gains / one.gain) == pytest.approx(0, abs=0.02)
    assert other.signals.face == pytest.approx(one.signals.face, rel=0.02)


@pytest.mark.parametrize("k", [0, 4])
def test_a_keyframe_that_goes_takes_only_its_sightings(k):
    """Of vertices of both maps, the sightings that the path knows are the same but for the keyframe's own."""
    world = wall()
    rest = np.delete(np.arange(7), k)
    whole, less = world.map(), world.take(rest).map()
    assert np.array_equal(less.keyframes, np.delete(whole.keyframes, k))

    def seen(found):
        of = found.observations
        return {
            (i, number): tuple(uv)
            for i, number, uv in zip(
                found.landmark_id[of.vertex].tolist(),
                found.keyframes[of.keyframe].tolist(),
                of.uv.tolist(),
                strict=True,
            )
        }

    common = set(whole.landmark_id.tolist()) & set(less.landmark_id.tolist())
    before = {key: uv for key, uv in seen(whole).items() if key[0] in common and key[1] != whole.keyframes[k]}
    after = {key: uv for key, uv in seen(less).items() if key[0] in common}
    assert len(common) > 140
    assert before == after


def test_a_plane_is_a_disc_and_each_of_its_landmarks_a_vertex():
    found = wall().map()
    assert found.complex_.euler == 1
    assert border_loops(found.surface.faces) == 1
    assert found.part.max() == 0
    assert len(found) == 150
    assert np.abs(found.xyz[:, 2] - 4).max() < 1e-6


def test_observations_are_rows_by_vertex_and_keyframe():
    found = room(800).map()
    of = found.observations
    assert of.start[0] == 0
    assert of.start[-1] == len(of)
    assert (np.diff(of.start) >= 2).all()
    key = of.vertex * len(found.keyframes) + of.keyframe
    assert (np.diff(key) > 0).all()
    true = {(i, k): uv for i, k, uv in zip(*sightings(found.rig, found.T_world_camera, found.xyz)[:3], strict=True)}
    off = [np.linalg.norm(uv - true[i, k]) for i, k, uv in zip(of.vertex, of.keyframe, of.uv, strict=True)]
    assert max(off) < 1e-3
    assert of.weight.min() >= 0
    assert of.weight.max() <= 1


def everything(found):
    """All arrays of a map as bytes."""
    parts = []
    for field in fields(found):
        value = getattr(found, field.name)
        values = (
            [getattr(value, name.name) for name in fields(value)] if hasattr(value, "__dataclass_fields__") else value
        )
        values = values if isinstance(values, list | tuple) else [values]
        parts += [np.asarray(one).tobytes() if isinstance(one, np.ndarray) else one for one in values]
    return parts


@pytest.fixture
def threads():
    yield set_threads
    set_threads(None)


def test_the_same_input_gives_the_same_bytes_with_any_number_of_threads(threads):
    world = rough()
    known = world.known()
    some = known.take(known.keyframe % 3 == 0)
    snapshot = world.snapshot
    less = world_of(RIG, snapshot.T_world_camera, snapshot.xyz, [view.image for view in world.views], known=some)
    maps = []
    for count in (1, 1, 2):
        threads(count)
        maps.append(everything(less.map()))
    assert maps[0] == maps[1] == maps[2]


@pytest.mark.parametrize("kind", ["one view", "nothing seen", "line"])
def test_landmarks_without_a_surface_are_one_clear_line(kind):
    world = wall()
    given = world.snapshot.xyz, world.snapshot.T_world_camera, [view.image for view in world.views]
    if kind == "one view":
        world = world_of(RIG, given[1][:1], given[0], given[2][:1])
    elif kind == "nothing seen":
        world = world_of(RIG, given[1], given[0] - (0, 0, 90), given[2])
    else:
        world = world_of(RIG, given[1], np.linspace((-1, -0.5, 4), (1, 0.3, 4.2), 30), given[2])
    with pytest.raises(GeometryError, match=r"^map: \d+ landmarks [^\n]*expected [^\n]*$"):
        world.map()


def test_doubled_landmarks_have_one_vertex():
    world = rough()
    xyz = np.concatenate([world.snapshot.xyz, world.snapshot.xyz[:20]])
    found = world_of(RIG, world.snapshot.T_world_camera, xyz, [view.image for view in world.views]).map()
    assert len(np.unique(found.xyz.round(6), axis=0)) == len(found)
    assert len(found) > 140
    assert found.complex_.euler == border_loops(found.surface.faces) == 1


def test_a_keyframe_with_a_wild_pose_bends_nothing():
    world = wall()
    poses = world.snapshot.T_world_camera.copy()
    poses[3] = poses[3] @ pose_at((0.6, 0.2, -0.3), (0.05, 0.1, 0))
    images = [view.image for view in world.views]
    found = world_of(RIG, poses, world.snapshot.xyz, images, known=world.known()).map()
    assert 3 not in found.observations.keyframe
    assert len(found) == 150
    assert found.complex_.euler == 1
    assert np.abs(found.xyz[:, 2] - 4).max() < 1e-3
    assert found.view_count.face.max() == len(world.views) - 1  # it is not looked through either
    assert found.view_variance.face.max() < 4 * world.map().view_variance.face.max() + 1e-6


def test_no_keyframes_and_too_many_landmarks_are_refused():
    world = wall(60)
    with pytest.raises(InputError, match="map: no keyframe, expected one or more"):
        make_map([], world.snapshot, RIG, Tmahf(), MappingSettings())
    small = MappingSettings(surface=SurfaceSettings(max_bytes=1e6))
    with pytest.raises(
        InputError, match=r"150 landmarks take about 0.0018 GB, expected at most 0.001 \(mapping.surface"
    ):
        make_map(wall().views, wall().snapshot, RIG, Tmahf(), small)


def test_parts_that_were_never_joined_are_two():
    world = wall()
    away = pose_at((100.0, 0, 0))
    poses = world.snapshot.T_world_camera
    xyz = np.concatenate([world.snapshot.xyz, world.snapshot.xyz[:60] + away[:3, 3]])
    images = [view.image for view in world.views]
    found = world_of(RIG, np.concatenate([poses, away @ poses]), xyz, images + images).map()
    assert found.part.max() == 1
    assert np.array_equal(found.part, (found.xyz[:, 0] > 50).astype(int))
    assert found.complex_.euler == 2


def test_a_broken_image_is_one_clear_line():
    world = wall()
    images = [view.image / 255.0 for view in world.views]
    images[3][40:50, 40:50] = np.nan
    with pytest.raises(InputError, match=r"^image has values from nan[^\n]*expected 0 to 1[^\n]*$"):
        world.show(images).map()


@pytest.mark.parametrize("tangent", ["projection", "gradient"])
def test_directions_are_unit_tangents_where_defined(tangent):
    found = rough().map(MappingSettings(views=ViewSettings(tangent=tangent)))
    length = np.linalg.norm(found.direction, axis=1)
    assert length[found.defined] == pytest.approx(1)
    assert not length[~found.defined].any()
    normals = np.zeros((len(found), 3))
    for k in range(3):
        np.add.at(normals, found.surface.faces[:, k], face_normals(found.xyz, found.surface.faces))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert np.einsum("ni,ni->n", normals, found.direction) == pytest.approx(0, abs=1e-9)


def test_no_keyframe_need_be_looked_at_for_landmarks():
    world = rough()
    blind = MappingSettings(observe=ObservationSettings(misses=1, neighbours=1, revisits=0))
    assert names(world.map(blind)) == names(world.map())


def one_frame(seed=0, landmark=True):
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(seed)
    uv = rng.uniform((1, 1), (RIG.width - 2, RIG.height - 2), (50, 2))
    disparity = rng.uniform(4, 9, 50)
    cloud = Cloud(back_project(RIG, uv, disparity), uv, disparity, covariance(RIG, uv, disparity, 0.5))
    faces = rng.permuted(Delaunay(uv).simplices, axis=1).astype(np.int32)  # wound at random
    complex_ = build_complex(faces, 50)
    image = rng.integers(0, 255, (RIG.height, RIG.width)).astype(np.uint8)
    signals = sample_signals(image, uv, complex_)
    response = Tmahf()(complex_, uv, signals)
    ids = np.where(rng.random(50) < 0.5, np.arange(50) + 9, -1) if landmark else None
    return Frame(12, 0.5, "twelfth", RIG, cloud, Surface(faces), complex_, signals, response, image=image, landmark=ids)


@pytest.mark.parametrize("landmark", [True, False])
@pytest.mark.parametrize("T", [np.eye(4), MOTION], ids=["origin", "moved"])
def test_a_map_of_one_keyframe_is_that_keyframe(T, landmark):
    frame = one_frame(landmark=landmark)
    found = map_of_frame(frame, RIG, T)
    assert found.complex_ is frame.complex_
    for field in fields(frame.signals):
        assert np.array_equal(getattr(found.signals, field.name), getattr(frame.signals, field.name))
    assert np.array_equal(found.response.z, frame.response.z)
    assert np.array_equal(found.response.defined, frame.response.defined)
    assert found.response.order == frame.response.order
    assert to_camera(found.xyz, T) == pytest.approx(frame.cloud.xyz, abs=1e-9)
    assert found.covariance == pytest.approx(T[:3, :3] @ frame.cloud.covariance @ T[:3, :3].T)
    assert np.array_equal(np.sort(found.surface.faces), frame.complex_.faces)
    towards = T[:3, 3] - found.xyz[found.surface.faces[:, 0]]
    assert (np.einsum("fi,fi->f", face_normals(found.xyz, found.surface.faces), towards) > 0).all()
    assert found.keyframes.tolist() == [12]
    assert found.landmark_id.tolist() == ([-1] * 50 if frame.landmark is None else frame.landmark.tolist())
    assert np.array_equal(found.observations.uv, frame.cloud.uv)
    assert np.array_equal(found.view_count.face, frame.signals.face_ok)
    assert not found.view_variance.face.any()
    assert np.linalg.norm(found.direction, axis=1) == pytest.approx(frame.response.defined.astype(float))
    assert found.gain.tolist() == [1]


def test_a_keyframe_of_several_channels_has_the_direction_of_one():
    frame = one_frame()
    colour = np.stack([frame.image, frame.image // 2, 255 - frame.image], axis=-1)
    signals = sample_signals(colour, frame.cloud.uv, frame.complex_, channels="all")
    response = Tmahf()(frame.complex_, frame.cloud.uv, signals)
    found = map_of_frame(replace(frame, signals=signals, response=response), RIG, MOTION)
    assert found.signals.face.shape == (len(frame.complex_.faces), 3)
    assert np.array_equal(found.response.z, response.z)
    assert found.direction.shape == (50, 3)
