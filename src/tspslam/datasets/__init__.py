"""Where pairs come from: the sample that ships with scikit-image, and folders of files."""

from .folder import StereoFolder as StereoFolder
from .folder import pair_from_files as pair_from_files
from .samples import motorcycle as motorcycle
from .samples import motorcycle_truth as motorcycle_truth

__all__ = ["StereoFolder", "motorcycle", "motorcycle_truth", "pair_from_files"]
