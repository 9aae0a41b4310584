"""Where pairs come from: the sample that ships with scikit-image, folders of files, worlds with a known truth."""

from . import synthetic as synthetic
from .folder import StereoFolder as StereoFolder
from .folder import pair_from_files as pair_from_files
from .maps import pair_from_map as pair_from_map
from .maps import read_map as read_map
from .samples import motorcycle as motorcycle
from .samples import motorcycle_truth as motorcycle_truth

__all__ = [
    "StereoFolder", "motorcycle", "motorcycle_truth", "pair_from_files", "pair_from_map", "read_map", "synthetic",
]  # fmt: skip
