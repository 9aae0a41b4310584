"""Where pairs come from: a sample, folders in known layouts, bags, videos, depth maps, worlds with a known truth."""

from . import synthetic as synthetic
from . import views as views
from .euroc import EurocSequence as EurocSequence
from .folder import StereoFolder as StereoFolder
from .folder import pair_from_files as pair_from_files
from .folder import read_pair as read_pair
from .joined import JoinedSequence as JoinedSequence
from .kitti import KittiSequence as KittiSequence
from .layouts import open_sequence as open_sequence
from .live import LiveSequence as LiveSequence
from .maps import pair_from_map as pair_from_map
from .maps import read_map as read_map
from .rgbd import RgbdSequence as RgbdSequence
from .rosbag import RosbagSequence as RosbagSequence
from .rosbag_depth import RgbdBag as RgbdBag
from .samples import motorcycle as motorcycle
from .samples import motorcycle_truth as motorcycle_truth
from .utias import UtiasRun as UtiasRun
from .video import VideoImages as VideoImages
from .video import VideoSequence as VideoSequence

__all__ = [
    "EurocSequence",
    "JoinedSequence",
    "KittiSequence",
    "LiveSequence",
    "RgbdBag",
    "RgbdSequence",
    "RosbagSequence",
    "StereoFolder",
    "UtiasRun",
    "VideoImages",
    "VideoSequence",
    "motorcycle",
    "motorcycle_truth",
    "open_sequence",
    "pair_from_files",
    "pair_from_map",
    "read_map",
    "read_pair",
    "synthetic",
]
