"""A loop is closed: a graph of the keyframes' poses takes its error out of the map, and landmarks go with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...._brief import Brief
from ....errors import GeometryError
from ....types import BoolArray, FloatArray, Rig
from ...se3 import inverse, move_points, normalised
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..keyframes.parts import join_parts
from ..least_squares.bundle import lens_of
from ..least_squares.pose_graph import PoseEdges, optimise_poses
from ..pose import PoseEstimate
from .seen_again import called_now, join_sights

_AT_ONCE = 8192  # landmarks that are moved at a time: their motions, 1 MB, stay near the processor
_LEAST_SHARED = 15  # landmarks that make two keyframes neighbours (Mur-Artal et al. 2015)
# Information of each edge besides that of the landmarks: neighbours are some metres and less than a right angle apart.
_LOOSE = np.diag([1.0] * 3 + [1e-2] * 3)  # 1 rad, 10 m
_GUESSED = np.diag([1e-2] * 3 + [1e-6] * 3)  # of a step that was guessed: 10 rad, 1 km
_MAX_STEPS = 20  # five times what a loop of 6 km with 60 m of error took
_FELT = 0.1  # standard deviations; the end of the town along KITTI 06, 0.26 m off, leaves 0.002 in the median
_HUBER = 2.5  # standard deviations, as in `adjust`


@dataclass(frozen=True, repr=False)
class LoopCorrection(Brief):
    """What closes a loop, whatever has become of the map meanwhile.

    Attributes
    ----------
    keyframe : (K,) int64
        Numbers of the frames that were keyframes, ascending.
    motions : (K, 4, 4) float64
        How each moves in the world, so that neighbours keep their relative poses and the loop is closed.
    landmark_id : (M,) int64
        Numbers of the landmarks, ascending.
    holder : (M,) int64
        Which of the keyframes each moves with: the first that saw it.
    unsettled : (U,) int64
        Numbers of the frames whose sights have moved against those of a neighbour, by over a tenth of their standard
        deviations in the root mean square: they are to be adjusted.
    """

    keyframe: NDArray[np.int64]
    motions: FloatArray
    landmark_id: NDArray[np.int64]
    holder: NDArray[np.int64]
    unsettled: NDArray[np.int64]


@dataclass(frozen=True, repr=False)
class LoopProblem(Brief):
    """The keyframes of a map, of which the last is seen from an older place; the map may go on meanwhile.

    Attributes
    ----------
    frames : tuple of Keyframe
        K keyframes.
    loop : Keyframe
        The last one as older landmarks have it: its pose and what it sees of them.
    landmark_id : (M,) int64
        Numbers of the landmarks.
    xyz : (M, 3) float64
        Where they are, m.
    rig : Rig
        The cameras.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    """

    frames: tuple[Keyframe, ...]
    loop: Keyframe
    landmark_id: NDArray[np.int64]
    xyz: FloatArray
    rig: Rig
    sigma_uv: float

    @classmethod
    def of(cls, map_: Map, sigma_uv: float) -> LoopProblem:
        """Collect the keyframes of a map of which a loop is being closed.

        Parameters
        ----------
        map_ : Map
            Keyframes and landmarks.
        sigma_uv : float
            Standard deviation of a tracked point, px.

        Returns
        -------
        LoopProblem
        """
        numbers, xyz = map_.landmark_id.copy(), map_.xyz.copy()
        return cls(tuple(map_.keyframes), _seen_again(map_), numbers, xyz, map_.rig, sigma_uv)

    def solve(self) -> LoopCorrection:
        """Find how each keyframe moves, and which of them each landmark goes with.

        An edge joins keyframes that follow each other or see landmarks in common; its information is what these
        landmarks tell of the pose. The loop's edge joins the last keyframe to the one that sees most of the loop's.

        Returns
        -------
        LoopCorrection

        Raises
        ------
        GeometryError
            If the edges do not fix the keyframes.
        """
        T = np.stack([frame.T_world_camera for frame in self.frames])
        i, j, own, information = self.neighbours(T)
        older, T_loop, told = self._loop_edge(T)
        T_ij = normalised(inverse(T[i]) @ T[j])
        edges = PoseEdges(
            np.append(i, older), np.append(j, len(T) - 1),
            np.concatenate([T_ij, [T_loop]]), np.concatenate([information, [told]]),
        )  # fmt: skip
        found = optimise_poses(T, edges, max_steps=_MAX_STEPS).T_world
        moved = self._are_moved(inverse(T_ij) @ inverse(found[i]) @ found[j], j, own)
        numbers = np.array([frame.index for frame in self.frames], np.int64)
        motions = normalised(found @ inverse(T))
        motions[0] = np.eye(4)
        return LoopCorrection(numbers, motions, self.landmark_id, self.first_seen(), numbers[1:][moved[1:]])

    def _are_moved(self, bent: FloatArray, j: NDArray[np.int64], own: FloatArray) -> BoolArray:
        """Which keyframes see their landmarks elsewhere, where edges that end at j were bent so."""
        from scipy.spatial.transform import Rotation

        x = np.concatenate([Rotation.from_matrix(bent[:, :3, :3]).as_rotvec(), bent[:, :3, 3]], axis=1)
        count = np.array([max(len(frame.landmark), 1) for frame in self.frames])
        square = np.einsum("ei,eij,ej->e", x, own[j], x) / count[j]
        moved = np.zeros(len(self.frames), np.bool_)
        moved[j[square > _FELT**2]] = True
        return moved

    def first_seen(self) -> NDArray[np.int64]:
        """Find which keyframe first saw each landmark.

        Returns
        -------
        (M,) int64
        """
        frames = self.frames[::-1]
        first_seen = np.zeros(len(self.xyz), np.int64)
        places = np.repeat(np.arange(len(frames))[::-1], [len(frame.landmark) for frame in frames])
        first_seen[np.concatenate([frame.landmark for frame in frames])] = places
        return first_seen

    def correct(self) -> LoopCorrection | None:
        """Find what closes the loop; may be called in another thread while the map goes on.

        Returns
        -------
        LoopCorrection or None
            None if the graph of the poses has no solution.
        """
        try:
            return self.solve()
        except GeometryError:
            return None

    def neighbours(self, T: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray, FloatArray]:
        """Find pairs of keyframes, and what landmarks in common tell of one against the other.

        Parameters
        ----------
        T : (K, 4, 4) float64
            Poses of the keyframes.

        Returns
        -------
        i, j : (E,) int64
            Which follow each other, or see enough landmarks in common.
        own : (K, 6, 6) float64
            What the sights of each keyframe tell of its pose.
        information : (E, 6, 6) float64
            The share of that which each pair has.
        """
        i, j, shared = _sharing(self.frames, len(self.xyz))
        share = shared / np.array([max(len(frame.landmark), 1) for frame in self.frames])[j]
        own = self._informations(self.frames, T)
        information = share[:, None, None] * own[j] + _LOOSE
        is_guess = np.array([frame.is_start for frame in self.frames])[j] & (j == i + 1)
        information[is_guess] = _GUESSED
        return i, j, own, information

    def _informations(self, frames: Sequence[Keyframe], T: FloatArray) -> FloatArray:
        """What the sights of keyframes at T tell of their poses, (K, 6, 6), each in its own frame."""
        from ..least_squares._pose_graph import informations

        lens, T_camera_world, S = lens_of(self.rig), inverse(T), np.empty((len(frames), 6, 6))
        R, t = np.ascontiguousarray(T_camera_world[:, :3, :3]), T_camera_world[:, :3, 3].copy()
        landmark, uv, disparity, sigma = (
            np.concatenate([getattr(f, name) for f in frames]) for name in ("landmark", "uv", "disparity", "sigma")
        )
        xyz, seen, weights = self.xyz[landmark], np.column_stack([uv, disparity]), np.empty((len(uv), 2))
        weights[:, 0], weights[:, 1] = self.sigma_uv**-2.0, sigma**-2.0
        start = np.cumsum([0, *(len(frame.landmark) for frame in frames)])
        informations(lens, R, t, start, xyz, seen, weights, _HUBER, S)
        return S

    def _loop_edge(self, T: FloatArray) -> tuple[int, FloatArray, FloatArray]:
        """The older keyframe, where the last one is seen from there, and the information."""
        older = _older_place(self.frames, self.loop, len(self.xyz))
        return older, *self.edge_from(older, self.loop, T)

    def edge_from(self, place: int, loop: Keyframe, T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Find what sights of older landmarks tell of a keyframe against one that it sees again.

        Parameters
        ----------
        place : int
            Which keyframe is seen again.
        loop : Keyframe
            Pose and sights of the other, as the older landmarks have them.
        T : (K, 4, 4) float64
            Poses of the keyframes.

        Returns
        -------
        (4, 4) float64, (6, 6) float64
            ``T_place_loop`` and its information.
        """
        information = self._informations([loop], loop.T_world_camera[None])[0] + _LOOSE
        return normalised(inverse(T[place]) @ loop.T_world_camera), information


def _sharing(frames: Sequence[Keyframe], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Pairs i < j of keyframes that follow each other or see landmarks in common, of `count`; how many these are."""
    from scipy.sparse import csr_matrix, eye_array, triu

    start = np.cumsum([0, *(len(frame.landmark) for frame in frames)])
    landmark = np.concatenate([frame.landmark for frame in frames])
    sees = csr_matrix((np.ones(len(landmark), np.int64), landmark, start), (len(frames), count))
    pairs = triu(sees @ sees.T, 1) + triu(eye_array(len(frames), k=1, dtype=np.int64))  # one more where they follow
    pairs = pairs.tocoo()
    order = np.lexsort((pairs.col, pairs.row))
    i, j = pairs.row[order].astype(np.int64), pairs.col[order].astype(np.int64)
    shared = pairs.data[order] - (j == i + 1)
    kept = (shared >= _LEAST_SHARED) | (j == i + 1)
    return i[kept], j[kept], shared[kept]


def _older_place(frames: Sequence[Keyframe], loop: Keyframe, count: int) -> int:
    """Which keyframe before the last sees most of the older landmarks of a loop, of `count` in the map."""
    is_seen = np.zeros(count, np.bool_)
    is_seen[loop.landmark] = True
    return int(np.argmax([is_seen[frame.landmark].sum() for frame in frames[:-1]]))


def prepare() -> None:
    """Have what closes loops compiled, or read from disk, before the camera waits for it."""
    from ..least_squares._pose_graph import informations

    T, one, none = np.tile(np.eye(4), (3, 1, 1)), np.tile(np.eye(6), (2, 1, 1)), np.empty((0, 3))
    informations(
        none[:, 0].copy(), np.empty((0, 3, 3)), none, np.zeros(1, np.int64), none, none, np.empty((0, 2)), 1.0, one[:0]
    )
    optimise_poses(T, PoseEdges(np.array([0, 1]), np.array([1, 2]), T[:2], one), max_steps=1)


def note_loop(
    map_: Map, again: PoseEstimate, ids: NDArray[np.int64], spread: Callable[[FloatArray], FloatArray]
) -> None:
    """Note what the last keyframe sees of an older place, until the loop is closed.

    Parameters
    ----------
    map_ : Map
        Changed: its `loop`.
    again : PoseEstimate
        Older landmarks with disparities, and the pose that they give.
    ids : (K,) int64
        Numbers of these landmarks: rows may have moved since.
    spread : callable
        Standard deviations of the disparities at places (K, 2) of the image, (K,) px.
    """
    index, T = map_.keyframes[-1].index, again.T_world_camera
    map_.loop = Keyframe(index, T, None, ids, again.uv, again.disparity, spread(again.uv))


def _seen_again(map_: Map) -> Keyframe:
    """The loop that is being closed, with the rows of those of its landmarks that the map still has."""
    assert map_.loop is not None
    return called_now(map_, map_.loop)


def correction_state(correction: LoopCorrection | None) -> dict[str, NDArray[Any]]:
    """Collect what closes a loop as arrays; `correction_of` takes them.

    Parameters
    ----------
    correction : LoopCorrection or None
        None where no loop is being closed, or the graph of the poses has no solution.

    Returns
    -------
    dict of str to array
        As `_state.SCHEMA` has them, such as ``correction_motions`` (K, 4, 4) float64.
    """
    rows = np.empty(0, np.int64)
    found = correction or LoopCorrection(rows, np.empty((0, 4, 4)), rows, rows, rows)
    return {f"correction_{each.name}": getattr(found, each.name) for each in fields(LoopCorrection)}


def correction_of(state: Mapping[str, NDArray[Any]]) -> LoopCorrection | None:
    """Make what closes a loop from arrays.

    Parameters
    ----------
    state : dict of str to array
        As `correction_state` gave them.

    Returns
    -------
    LoopCorrection or None
    """
    found = LoopCorrection(*(state[f"correction_{each.name}"] for each in fields(LoopCorrection)))
    return found if len(found.keyframe) else None


def close_loop(map_: Map, correction: LoopCorrection, same_landmark: float) -> None:
    """Put what a loop has moved in its place, and join what the camera saw of both ends.

    What has come since moves with what it is seen from: a keyframe with the one before it that sees most of its
    landmarks, a landmark with the keyframe that first saw it.

    Parameters
    ----------
    map_ : Map
        That of the `LoopProblem`; changed: its `loop` is closed, and keyframes are not settled.
    correction : LoopCorrection
        What that gave.
    same_landmark : float
        Distance of two observations, in u, v and disparity, of one landmark, px.
    """
    loop, frames = _seen_again(map_), map_.keyframes
    of_frame, of_landmark = _followed(map_, correction)
    T = correction.motions[of_frame] @ np.stack([frame.T_world_camera for frame in frames])
    map_.keyframes = [frame.at(pose) for frame, pose in zip(frames, T, strict=True)]
    for first in range(0, len(map_.xyz), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        map_.xyz[some] = move_points(correction.motions[of_landmark[some]], map_.xyz[some])
    map_.unsettled |= set(correction.unsettled.tolist()) & {frame.index for frame in frames}
    map_.loop = None
    _join_sights(map_, loop, same_landmark)


def _followed(map_: Map, correction: LoopCorrection) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which of the corrected keyframes each keyframe of a map moves with, and each landmark."""
    numbers = np.array([frame.index for frame in map_.keyframes])
    count = int(np.searchsorted(numbers, correction.keyframe[-1], "right"))
    of_frame = np.append(np.searchsorted(correction.keyframe, numbers[:count]), np.zeros(len(numbers) - count, int))
    for k in range(count, len(numbers)):
        near = [(shared, place) for place, shared in map_.covisible(k, least=1) if place < k]
        of_frame[k] = of_frame[max(near)[1] if near else k - 1]
    old = int(np.searchsorted(map_.landmark_id, correction.landmark_id[-1], "right"))
    of_landmark = np.zeros(len(map_.xyz), np.int64)
    for k in range(len(numbers) - 1, count - 1, -1):
        of_landmark[map_.keyframes[k].landmark] = of_frame[k]
    of_landmark[:old] = correction.holder[np.searchsorted(correction.landmark_id, map_.landmark_id[:old])]
    return of_frame, of_landmark


def _join_sights(map_: Map, again: Keyframe, same_landmark: float) -> None:
    """Have the keyframe that came back see what it sees again; landmarks that it sees in the same place become one."""
    place = map_.place_of(again.index)
    _, seen_by = map_.sightings.of(again.landmark)
    seen_by = seen_by[seen_by < again.index]
    if not len(seen_by):  # all of them were culled meanwhile
        return
    older = map_.place_of(int(np.bincount(seen_by).argmax()))
    map_.keyframes = join_parts(map_.keyframes, older, place)
    again, _ = join_sights(map_, place, again, same_landmark)
    map_.observe(place, again)
