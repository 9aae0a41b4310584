"""Where a frame was taken: near a motion that goes on, or, where none is known, by descriptors first."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....types import Features, FloatArray
from ...features.binary import Descriptors, binary_descriptors, match_descriptors
from ...features.detecting import detect_usable
from ...images import PreparedImage
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..places.loop_closing import PlaceRecognition
from ..pose import PoseEstimate, distances_to_sights, expected_sights, fit_robustly, solve_pnp
from ..tracking import Reference, TrackingSettings, track_closely, track_pose
from .choosing import are_close, choose_pose, choose_widest, is_clear, with_rival, with_unknown
from .uncertainty import Sources, pose_covariance, rival_spread

_HELD = 0.5  # share of the landmarks from which the last keyframe is the one that a pose is held by
_MOTIONS = 3  # that descriptors may show: the world's, that of something large before the camera, and a mixture
_BOX = (0.1, 0.9)  # quantiles along both axes: what is far away agrees with any motion, and is everywhere
_AHEAD = (0.0, 0.05, 0.1, 0.2)  # of the landmarks' distance: patches reach as far from each
_ONCE_MORE = 2  # of the motions found around the largest, tried from where they are: the right one may have fewer
_REST = 0.4  # of what the largest motion leaves in view: 0.48 to 0.72 where the motion is right, 0.33 at most elsewhere
_GATE = 2.5  # standard deviations of a keypoint beyond which it is dropped
_LEAST_PLACE = 2  # times the landmarks that prove a place: where a recording begins, nothing else says where that is
_CANDIDATES = 20  # keyframes that a recording may begin near, some 10 ms each: it is asked once
_LEAST_MATCHES = 8  # that lead to a pose: P3P takes four; whether it is one, patches tell


@dataclass(frozen=True)
class Locator:
    """Finds the pose of a frame in a map.

    Attributes
    ----------
    map_ : Map
        Keyframes and landmarks.
    places : PlaceRecognition
        Finds places seen before.
    settings : TrackingSettings
        How landmarks are tracked, and when a pose is believed.
    detect : callable
        Grey image -> `Features`.
    """

    map_: Map
    places: PlaceRecognition
    settings: TrackingSettings
    detect: Callable[[NDArray[np.uint8]], Features]

    def follow(self, image: PreparedImage, predicted: FloatArray, *, is_doubted: bool) -> PoseEstimate | None:
        """Find a pose near the one that a steady motion leads to; by descriptors where that is not clear.

        Where another motion explained the last frame about as well, it is looked for in this one, too.

        Parameters
        ----------
        image : PreparedImage
            The left image.
        predicted : (4, 4) float64
            Where the motion leads.
        is_doubted : bool
            Whether another motion explained the last frame about as well.

        Returns
        -------
        PoseEstimate or None
            Without disparities; None if no pose is believed.
        """
        found = self._follow(image, predicted)
        if found is None or not is_doubted:
            return found
        described = self._describe(image)
        others = list(self._recognise(image, *described))
        around = self._track_around(image, predicted, [found, *others])
        return self._beside(found, [*others, *([] if around is None else [around])])

    def _follow(self, image: PreparedImage, predicted: FloatArray) -> PoseEstimate | None:
        """A pose near the one that a steady motion leads to; by descriptors where that is not clear."""
        tracked = self._track(image, predicted)
        if tracked is None or not self._is_expected(tracked, predicted):
            closely = self._track_closely(image, predicted)  # something else may have drawn the first one away
            both = [one for one in (tracked, closely) if one is not None]
            chosen = self._choose(both)
            tracked = (
                max(both, key=len, default=None) if chosen is None else self._unless_steady(chosen, both, predicted)
            )
        else:
            both = [tracked]
        if tracked is not None and is_clear(tracked, self.map_.xyz, predicted, self.settings):
            return tracked
        described = self._describe(image)
        relocalized = self.places.relocalize(image.pyramid, *described)
        chosen = choose_pose(tracked, relocalized, self.map_.xyz, self.settings)
        if chosen is None:
            return self._choose(list(self._recognise(image, *described)))
        return self._unless_steady(chosen, both, predicted)

    def _is_expected(self, tracked: PoseEstimate, predicted: FloatArray) -> bool:
        """Whether a pose is where the motion leads, and many landmarks agree."""
        is_close = are_close(tracked, predicted, self.map_.xyz, self.settings)
        return is_close and tracked.share >= self.settings.clear_share

    def _unless_steady(self, chosen: PoseEstimate, found: list[PoseEstimate], predicted: FloatArray) -> PoseEstimate:
        """The chosen pose; the one where the motion leads if that is about as likely."""
        chosen = self._beside(chosen, found)
        for one in found:
            is_rival = chosen.rival is not None and chosen.rival.T_world_camera is one.T_world_camera
            if is_rival and are_close(one, predicted, self.map_.xyz, self.settings):
                return self._beside(one, [chosen])
        return chosen

    def _beside(self, chosen: PoseEstimate, others: list[PoseEstimate]) -> PoseEstimate:
        return with_rival(self.map_.rig, chosen, others, self.map_.xyz, self.settings)

    def find(self, image: PreparedImage, guesses: Sequence[FloatArray]) -> PoseEstimate | None:
        """Find a pose wherever it is: by descriptors of the last keyframes, then near guesses, then in the whole map.

        Each is tried by patches; the next one where the poses so far are not clear. A second motion that descriptors
        show is always tried: the first may be that of something large that moves.

        Parameters
        ----------
        image : PreparedImage
            The left image.
        guesses : sequence of (4, 4) float64
            Poses that the camera may have.

        Returns
        -------
        PoseEstimate or None
            Without disparities; None if no pose is believed.
        """
        found: list[PoseEstimate] = []
        best = None
        for estimates in self._attempts(image, guesses, self._describe(image)):
            found += estimates
            best = self._choose(found)
            if best is not None and best.share >= self.settings.clear_share:
                break
        if best is None:
            return None
        rows = np.unique(np.concatenate([reference.landmark for reference in self.map_.references()]))
        return with_unknown(self.map_.rig, best, rows, self.map_.xyz, self.settings)

    def look_up(self, image: PreparedImage) -> PoseEstimate | None:
        """Find where in the whole map a recording begins, by its descriptors.

        Nothing is known of where that is, and no second keyframe confirms it: so twice as many landmarks must agree as
        prove a place (`LoopSettings.min_landmarks`), and as large a share as a pose needs alone (`lone_share`). Of 48
        views of other worlds and streets none had 15.

        Parameters
        ----------
        image : PreparedImage
            The left image.

        Returns
        -------
        PoseEstimate or None
            Without disparities; None if no pose is believed.
        """
        found = self.places.relocalize(image.pyramid, *self._describe(image), _CANDIDATES)
        least = _LEAST_PLACE * self.places.loops.min_landmarks
        is_sure = found is not None and len(found) >= least and found.share >= self.settings.lone_share
        return found if is_sure else None

    def _choose(self, found: list[PoseEstimate]) -> PoseEstimate | None:
        return choose_widest(self.map_.rig, found, self.map_.xyz, self.settings)

    def _attempts(
        self, image: PreparedImage, guesses: Sequence[FloatArray], described: tuple[FloatArray, Descriptors]
    ) -> Iterator[list[PoseEstimate]]:
        """Poses found in one way after another."""
        found = list(self._recognise(image, *described))
        around = self._track_around(image, guesses[0], found)
        yield found if around is None else [*found, around]
        for guess in guesses:
            tracked = self._track(image, guess)
            yield [] if tracked is None else [tracked]
        relocalized = self.places.relocalize(image.pyramid, *described)
        yield [] if relocalized is None else [relocalized]

    def is_dark(self, image: PreparedImage) -> bool:
        """Whether an image shows too little to say where it was taken.

        Parameters
        ----------
        image : PreparedImage
            The left image.

        Returns
        -------
        bool
        """
        return len(detect_usable(image, self.detect).uv) < self.settings.min_matches

    def _describe(self, image: PreparedImage) -> tuple[FloatArray, Descriptors]:
        features = detect_usable(image, self.detect)
        return features.uv, binary_descriptors(features.descriptor)

    def _track(self, image: PreparedImage, T: FloatArray) -> PoseEstimate | None:
        map_ = self.map_
        return track_pose(map_.rig, image.pyramid, map_.references(), map_.xyz, T, self.settings)

    def _track_closely(self, image: PreparedImage, T: FloatArray) -> PoseEstimate | None:
        map_ = self.map_
        return track_closely(map_.rig, image.pyramid, map_.references(), map_.xyz, T, self.settings)

    def _recognise(self, image: PreparedImage, uv: FloatArray, descriptors: Descriptors) -> Iterator[PoseEstimate]:
        """Poses from descriptors of the landmarks that are tracked, each without what agrees with those before it."""
        map_, loops = self.map_, self.places.loops
        rows = np.concatenate([reference.landmark for reference in map_.references()])
        keypoint, known = match_descriptors(
            descriptors, map_.descriptors[rows], max_hamming=loops.max_hamming, ratio=loops.ratio
        )
        rows, uv = rows[known], uv[keypoint]
        for _ in range(_MOTIONS):
            T = self._solve(rows, uv)
            if T is None:
                return
            estimate = self._track_again(image, self._track_closely(image, T) or self._track(image, T))
            if estimate is not None:
                yield estimate
                T = estimate.T_world_camera
            is_left = ~(distances_to_sights(map_.rig, T, map_.xyz[rows], uv) <= loops.pnp_error)
            if is_left.all():  # patches led elsewhere
                return
            rows, uv = rows[is_left], uv[is_left]

    def _track_around(
        self, image: PreparedImage, guess: FloatArray, found: Sequence[PoseEstimate]
    ) -> PoseEstimate | None:
        """A further motion, near one found, a guess, or ahead: of the landmarks around those of the largest."""
        map_ = self.map_
        taken = max((one.landmark for one in found), key=len, default=np.empty(0, np.int64))
        rest = [_around(each, taken) for each in map_.references()]
        rows = np.concatenate([each.landmark for each in rest])
        if not len(rows):
            return None
        far = float(np.median((map_.xyz[rows] - guess[:3, 3]) @ guess[:3, 2]))
        ahead = [guess.copy() for _ in _AHEAD]
        for T, share in zip(ahead, _AHEAD, strict=True):
            T[:3, 3] += share * far * guess[:3, 2]
        places = [*(one.T_world_camera for one in found), *ahead]
        for track in (track_pose, track_closely):  # the second where the coarse levels see too little of what is left
            most = self._search(track, image, rest, places)[-_ONCE_MORE:]
            if most:
                again = self._search(track, image, rest, [one.T_world_camera for one in most])
                return self._widened(image, max(most + again, key=len), rest)
        return None

    def _search(
        self, track: Callable[..., PoseEstimate | None], image: PreparedImage, references: list[Reference],
        guesses: Sequence[FloatArray],
    ) -> list[PoseEstimate]:  # fmt: skip
        """Poses tracked from some guesses, those with most landmarks last."""
        map_ = self.map_
        tried = (track(map_.rig, image.pyramid, references, map_.xyz, T, self.settings) for T in guesses)
        return sorted((one for one in tried if one is not None), key=len)

    def _widened(self, image: PreparedImage, near: PoseEstimate, rest: list[Reference]) -> PoseEstimate | None:
        """A pose of landmarks around the largest motion, with all that agree; without those where they are too few."""
        wide = self._track_closely(image, near.T_world_camera)
        if wide is not None and wide.share >= self.settings.relocalized_share:
            return wide
        map_ = self.map_
        again = track_closely(map_.rig, image.pyramid, rest, map_.xyz, near.T_world_camera, self.settings)
        near = max(near, again or near, key=len)
        return near if near.share >= _REST else None

    def _track_again(self, image: PreparedImage, found: PoseEstimate | None) -> PoseEstimate | None:
        """A pose from few landmarks once more, from where it is: a second motion's keypoints lead there roughly."""
        if found is None or found.share >= self.settings.clear_share:
            return found
        again = self._track(image, found.T_world_camera)
        return found if again is None or len(again) <= len(found) else again

    def _solve(self, rows: NDArray[np.int64], uv: FloatArray) -> FloatArray | None:
        """Pose from landmarks, some of them wrong, and where keypoints have them: P3P, then least squares."""
        map_, most = self.map_, self.places.loops.pnp_error
        T = solve_pnp(map_.rig, map_.xyz[rows], uv, max_error=most, min_matches=_LEAST_MATCHES)
        if T is None:
            return None
        agree = distances_to_sights(map_.rig, T, map_.xyz[rows], uv) <= most
        known = PoseEstimate(T, rows[agree], uv[agree], np.full(agree.sum(), np.nan), np.eye(6))
        fitted = fit_robustly(map_.rig, map_.xyz, known, (self.settings.rough_sigma_uv, 1.0), (_GATE,), _LEAST_MATCHES)
        return T if fitted is None else fitted.T_world_camera


def _around(reference: Reference, taken: NDArray[np.int64]) -> Reference:
    """A keyframe with those landmarks only that lie outside the box that holds most of some that are taken."""
    is_left = ~np.isin(reference.landmark, taken)
    if not is_left.all():
        low, high = np.quantile(reference.uv[~is_left], _BOX, axis=0)
        is_left &= ~((reference.uv > low) & (reference.uv < high)).all(axis=1)
    return replace(reference, uv=reference.uv[is_left], landmark=reference.landmark[is_left])


def covariance_against_keyframe(
    map_: Map, estimate: PoseEstimate, sigma_uv: float, sigma_disparity: FloatArray, offset_std: float,
    place: int | None = None,
) -> tuple[int, FloatArray]:  # fmt: skip
    """Find the covariance of a pose against the keyframe that measured its landmarks.

    That is `pose_covariance`, with `rival_spread` where another pose may be the right one.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.
    estimate : PoseEstimate
        The pose, refined by disparities.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    sigma_disparity : (K,) float64
        Standard deviations of disparities, px.
    offset_std : float
        Standard deviation of the offset that all disparities have in common, px.
    place : int, optional
        Which keyframe that is; by default the last one, unless it saw less than half: then that which saw most.

    Returns
    -------
    (int, (6, 6) float64)
        Number of that keyframe's frame, and the covariance.
    """
    rows, window = estimate.landmark, map_.keyframes[-map_.window :]
    seen, sight = _match(rows, np.concatenate([frame.landmark for frame in window]))
    views = np.maximum(np.bincount(seen, minlength=len(rows)), 1)
    if place is None:
        place = len(map_.keyframes) - 1
        before_last = sum(len(frame.landmark) for frame in window[:-1])
        if np.count_nonzero(sight >= before_last) < _HELD * len(rows):
            place = max(map_.seen_by(rows), key=lambda k: int(np.isin(rows, map_.keyframes[k].landmark).sum()))
    holder = map_.keyframes[place]
    pull = _pull(map_, holder, rows)
    sources = Sources(holder.T_world_camera, pull, views, sigma_uv, sigma_disparity, offset_std)
    covariance = pose_covariance(map_.rig, estimate, map_.xyz, sources)
    if estimate.rival is not None:
        covariance = covariance + rival_spread(estimate.T_world_camera, estimate.rival)
    return holder.index, covariance


def _pull(map_: Map, frame: Keyframe, landmark: NDArray[np.int64]) -> FloatArray:
    """How far from where its pose has them a keyframe saw landmarks, (K, 3) px; 0 where it did not."""
    pull, (rows, own) = np.zeros((len(landmark), 3)), _match(landmark, frame.landmark)
    expected = expected_sights(map_.rig, frame.T_world_camera, map_.xyz[landmark[rows]])
    pull[rows] = np.nan_to_num(np.column_stack([frame.uv[own], frame.disparity[own]]) - expected)
    return pull


def _match(landmark: NDArray[np.int64], seen: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which of the landmarks, each there once, are seen, and which sights these are: one look-up for all keyframes."""
    order = np.argsort(landmark)
    ascending = landmark[order]
    at = np.minimum(np.searchsorted(ascending, seen), len(landmark) - 1)
    own = np.flatnonzero(ascending[at] == seen)
    return order[at[own]], own
