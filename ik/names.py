"""The public names of the package, each from the module that it stands in."""

from .arm import KR210, Arm
from .chain import Axes, chain_axes, chain_frames
from .choice import joint_time, nearest, slide_wrist
from .dh import DH, dh_from_chain, from_dh
from .exceptions import IKError, InvalidPose, UnsupportedArm
from .geometry import from_chain
from .kinematics import (
    forward,
    jacobian,
    link_frames,
    manipulability,
    singular,
    singularity_distances,
    wrist_center,
)
from .limits import Turns, turns, within_limits
from .numeric import NumericOptions, inverse_numeric, numeric_solver
from .poses import check_poses
from .sequence import JointPath, best_sequence, greedy_sequence
from .solve import Solutions, inverse
from .symbolic import dh_formulas, pose_formula

__all__ = [
    "DH",
    "KR210",
    "Arm",
    "Axes",
    "IKError",
    "InvalidPose",
    "JointPath",
    "NumericOptions",
    "Solutions",
    "Turns",
    "UnsupportedArm",
    "best_sequence",
    "chain_axes",
    "chain_frames",
    "check_poses",
    "dh_formulas",
    "dh_from_chain",
    "forward",
    "from_chain",
    "from_dh",
    "greedy_sequence",
    "inverse",
    "inverse_numeric",
    "jacobian",
    "joint_time",
    "link_frames",
    "manipulability",
    "nearest",
    "numeric_solver",
    "pose_formula",
    "singular",
    "singularity_distances",
    "slide_wrist",
    "turns",
    "within_limits",
    "wrist_center",
]
