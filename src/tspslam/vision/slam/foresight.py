"""Whether the next frame's keypoints are likely to be needed: they can then be detected while it is tracked."""

from __future__ import annotations

from collections.abc import Callable

# times the least landmarks: of KITTI 05's 14 keyframes 13 are foreseen, 6 frames in vain; 1: 13 and 4, 1.1: 13 and 7
_MARGIN = 1.05


class Foresight:
    """Landmarks that the last frame tracks, and how fast they become fewer.

    What it says decides when keypoints are detected, never what they are: it is no part of an odometry's state.

    Parameters
    ----------
    keyframe_share : float
        Share of the last keyframe's landmarks; a frame that tracks fewer becomes a keyframe.

    Attributes
    ----------
    is_due : bool
        Whether the next frame is likely to become a keyframe, or is looked for by its keypoints: none was tracked.
    on_due : callable or None
        Called as soon as it is.

    Examples
    --------
    >>> foresight = Foresight(0.5)
    >>> for count in (1000, 800, 640):
    ...     foresight.note(count, 1000, is_keyframe=count == 1000)
    ...     foresight.is_due
    False
    False
    True
    """

    def __init__(self, keyframe_share: float) -> None:
        self._keyframe_share, self._count, self._rate = keyframe_share, 0, 1.0
        self.is_due = False
        self.on_due: Callable[[], object] | None = None

    def note(self, count: int, expected: int, *, is_keyframe: bool) -> None:
        """Note a frame, and tell whether the next one's keypoints are likely to be needed.

        Parameters
        ----------
        count : int
            Landmarks that it tracks; 0 where it is lost, or the first one.
        expected : int
            Landmarks of the last keyframe, which may be this frame.
        is_keyframe : bool
            Whether it is.
        """
        self._rate = min(count / self._count, 1.0) if count and self._count else 1.0
        self._count = expected if is_keyframe else count
        self.is_due = not count or self._count * self._rate < _MARGIN * self._keyframe_share * expected
        if self.is_due and self.on_due is not None:
            self.on_due()
