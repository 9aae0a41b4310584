"""Topological signal processing on what a stereo camera sees.

The walk from a pair of images to a response::

    pair     = tspslam.datasets.motorcycle()  # or read_pair("left.png", "right.png", "calib.yaml")
    cloud    = tspslam.reconstruct(pair)
    surface  = tspslam.delaunay_surface(cloud)
    complex_ = tspslam.build_complex(surface.faces, len(cloud.xyz))
    signals  = tspslam.sample_signals(pair.left, cloud.uv, complex_)
    response = tspslam.tmahf(complex_, cloud.uv, signals, order=1, centering="harmonic")

Names are loaded when they are first used, so importing the package costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import apps as apps
    from . import datasets as datasets
    from . import errors as errors
    from . import frame as frame
    from . import interop as interop
    from . import io as io
    from . import run as run
    from . import scale as scale
    from . import session as session
    from . import settings as settings
    from . import topological_map as topological_map
    from . import topology as topology
    from . import types as types
    from . import view as view
    from . import vision as vision
    from ._threads import set_threads as set_threads
    from .apps.cloud import denoise_cloud as denoise_cloud
    from .apps.mesh import denoise_mesh as denoise_mesh
    from .apps.noise import estimate_noise as estimate_noise
    from .apps.quality import compare_features as compare_features
    from .apps.quality import compare_quality as compare_quality
    from .apps.quality import quality_features as quality_features
    from .apps.recognise import compare_descriptors as compare_descriptors
    from .apps.recognise import describe as describe
    from .apps.recognise import find_places as find_places
    from .apps.segment import disc_labels as disc_labels
    from .apps.segment import segment as segment
    from .apps.signals import denoise_signals as denoise_signals
    from .datasets.folder import read_pair as read_pair
    from .errors import GeometryError as GeometryError
    from .errors import InputError as InputError
    from .errors import OutputError as OutputError
    from .errors import TspSlamError as TspSlamError
    from .frame import Frame as Frame
    from .io.runs import StoredRun as StoredRun
    from .io.runs import load_run as load_run
    from .io.topological import load_map as load_map
    from .mapping.settings import MappingSettings as MappingSettings
    from .mapping.settings import ObservationSettings as ObservationSettings
    from .mapping.settings import SurfaceSettings as SurfaceSettings
    from .mapping.settings import ViewSettings as ViewSettings
    from .run.live import LiveMap as LiveMap
    from .run.map import build_map as build_map
    from .session import Odometry as Odometry
    from .session import Session as Session
    from .settings import Settings as Settings
    from .settings import list_settings as list_settings
    from .topological_map import TopologicalMap as TopologicalMap
    from .topology.cells import CellComplex as CellComplex
    from .topology.cells import build_cells as build_cells
    from .topology.cells import grow_labels as grow_labels
    from .topology.cells import merge_cells as merge_cells
    from .topology.cells import merge_signals as merge_signals
    from .topology.chf import chf as chf
    from .topology.chf import chf_bank as chf_bank
    from .topology.complex import Complex as Complex
    from .topology.complex import build_complex as build_complex
    from .topology.crust import Crust as Crust
    from .topology.crust import crust_surface as crust_surface
    from .topology.diagnosis import diagnose_surface as diagnose_surface
    from .topology.flow import edge_flow as edge_flow
    from .topology.harmonic import Tmahf as Tmahf
    from .topology.harmonic import tmahf as tmahf
    from .topology.harmonic import tmahf_bank as tmahf_bank
    from .topology.hodge import harmonic_basis as harmonic_basis
    from .topology.hodge import hodge_decompose as hodge_decompose
    from .topology.homology import betti_numbers as betti_numbers
    from .topology.laplacian import unsigned_laplacian as unsigned_laplacian
    from .topology.mahf import mahf as mahf
    from .topology.mahf import mahf_bank as mahf_bank
    from .topology.scan_surface import ScanSurface as ScanSurface
    from .topology.scan_surface import scan_surface as scan_surface
    from .topology.spectral import chebyshev_filter as chebyshev_filter
    from .topology.spectral import heat_filter as heat_filter
    from .topology.spectral import heat_kernel as heat_kernel
    from .topology.spectral import smooth_signals as smooth_signals
    from .topology.spectral import tikhonov_filter as tikhonov_filter
    from .topology.spectrum import spectrum as spectrum
    from .topology.surface import DelaunaySurface as DelaunaySurface
    from .topology.surface import delaunay_surface as delaunay_surface
    from .topology.texture import sample_signals as sample_signals
    from .topology.vectors import geometry_signals as geometry_signals
    from .topology.vectors import sample_vectors as sample_vectors
    from .topology.vectors import stack_signals as stack_signals
    from .types import Bank as Bank
    from .types import Camera as Camera
    from .types import Cloud as Cloud
    from .types import Features as Features
    from .types import RawRig as RawRig
    from .types import Response as Response
    from .types import Rig as Rig
    from .types import Signals as Signals
    from .types import StereoPair as StereoPair
    from .types import Surface as Surface
    from .types import Trajectory as Trajectory
    from .vision.calibration.formats import read_calibration as read_calibration
    from .vision.calibration.formats.own import load_rig as load_rig
    from .vision.calibration.rectify import rectification as rectification
    from .vision.evaluate import evaluate_trajectory as evaluate_trajectory
    from .vision.features.grid import GridDetector as GridDetector
    from .vision.features.onnx import OnnxDetector as OnnxDetector
    from .vision.features.orb import OrbDetector as OrbDetector
    from .vision.features.sift_brisk import BriskDetector as BriskDetector
    from .vision.features.sift_brisk import SiftDetector as SiftDetector
    from .vision.slam.keyframes.keyframe import MapSnapshot as MapSnapshot
    from .vision.slam.keyframes.settings import MapSettings as MapSettings
    from .vision.slam.odometry import StereoOdometry as StereoOdometry
    from .vision.slam.odometry import Tracking as Tracking
    from .vision.slam.places.loop_closing import LoopSettings as LoopSettings
    from .vision.slam.pose import Tracked as Tracked
    from .vision.slam.tracking import TrackingSettings as TrackingSettings
    from .vision.stereo.dense import cloud_from_depth as cloud_from_depth
    from .vision.stereo.dense import cloud_from_disparity as cloud_from_disparity
    from .vision.stereo.descriptor_matcher import DescriptorMatcher as DescriptorMatcher
    from .vision.stereo.matches import Matches as Matches
    from .vision.stereo.patches import Patches as Patches
    from .vision.stereo.reconstruct import reconstruct as reconstruct
    from .vision.stereo.row_matcher import RowMatcher as RowMatcher
    from .vision.stereo.sgbm import SgbmMatcher as SgbmMatcher
    from .vision.visibility import visible_uv as visible_uv

__version__ = "0.1.0"

_HOMES = {
    "_threads": ("set_threads",),
    "errors": ("GeometryError", "InputError", "OutputError", "TspSlamError"),
    "types": (
        "Bank",
        "Camera",
        "Cloud",
        "Features",
        "RawRig",
        "Response",
        "Rig",
        "Signals",
        "StereoPair",
        "Surface",
        "Trajectory",
    ),
    "apps.cloud": ("denoise_cloud",),
    "apps.mesh": ("denoise_mesh",),
    "apps.noise": ("estimate_noise",),
    "apps.quality": ("compare_features", "compare_quality", "quality_features"),
    "apps.recognise": ("compare_descriptors", "describe", "find_places"),
    "apps.segment": ("disc_labels", "segment"),
    "apps.signals": ("denoise_signals",),
    "datasets.folder": ("read_pair",),
    "frame": ("Frame",),
    "io.runs": ("StoredRun", "load_run"),
    "io.topological": ("load_map",),
    "vision.features.orb": ("OrbDetector",),
    "vision.features.sift_brisk": ("BriskDetector", "SiftDetector"),
    "vision.features.grid": ("GridDetector",),
    "vision.features.onnx": ("OnnxDetector",),
    "vision.stereo.matches": ("Matches",),
    "vision.stereo.row_matcher": ("RowMatcher",),
    "vision.stereo.descriptor_matcher": ("DescriptorMatcher",),
    "vision.stereo.sgbm": ("SgbmMatcher",),
    "vision.stereo.patches": ("Patches",),
    "vision.stereo.reconstruct": ("reconstruct",),
    "vision.slam.odometry": ("StereoOdometry", "Tracking"),
    "vision.slam.pose": ("Tracked",),
    "vision.slam.tracking": ("TrackingSettings",),
    "vision.slam.keyframes.settings": ("MapSettings",),
    "vision.slam.keyframes.keyframe": ("MapSnapshot",),
    "vision.slam.places.loop_closing": ("LoopSettings",),
    "vision.calibration.formats.own": ("load_rig",),
    "vision.calibration.rectify": ("rectification",),
    "topological_map": ("TopologicalMap",),
    "topology.surface": ("DelaunaySurface", "delaunay_surface"),
    "topology.scan_surface": ("ScanSurface", "scan_surface"),
    "topology.complex": ("Complex", "build_complex"),
    "topology.spectral": ("chebyshev_filter", "heat_filter", "heat_kernel", "smooth_signals", "tikhonov_filter"),
    "topology.spectrum": ("spectrum",),
    "topology.laplacian": ("unsigned_laplacian",),
    "topology.flow": ("edge_flow",),
    "topology.hodge": ("harmonic_basis", "hodge_decompose"),
    "topology.homology": ("betti_numbers",),
    "topology.texture": ("sample_signals",),
    "topology.vectors": ("geometry_signals", "sample_vectors", "stack_signals"),
    "topology.crust": ("Crust", "crust_surface"),
    "topology.diagnosis": ("diagnose_surface",),
    "topology.harmonic": ("Tmahf", "tmahf", "tmahf_bank"),
    "topology.mahf": ("mahf", "mahf_bank"),
    "topology.chf": ("chf", "chf_bank"),
    "topology.cells": ("CellComplex", "build_cells", "grow_labels", "merge_cells", "merge_signals"),
    "vision.evaluate": ("evaluate_trajectory",),
    "vision.calibration.formats": ("read_calibration",),
    "vision.stereo.dense": ("cloud_from_depth", "cloud_from_disparity"),
    "vision.visibility": ("visible_uv",),
    "mapping.settings": ("MappingSettings", "ObservationSettings", "SurfaceSettings", "ViewSettings"),
    "run.live": ("LiveMap",),
    "run.map": ("build_map",),
    "session": ("Odometry", "Session"),
    "settings": ("Settings", "list_settings"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}
_ROOMS = ("datasets", "interop", "io", "view")
_FILES = (  # of common names: not for *
    "apps",
    "errors",
    "frame",
    "mapping",
    "run",
    "scale",
    "session",
    "settings",
    "topological_map",
    "topology",
    "types",
    "vision",
)

__all__ = sorted((*_HOME, *_ROOMS))


def __getattr__(name: str) -> Any:
    if name in _ROOMS or name in _FILES:
        return importlib.import_module(f".{name}", __name__)
    if name in _HOME:
        return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__, *_FILES]
