"""Inertial navigation: a library by itself.

Increments (`core.records.ImuBlock`, freed of coning and sculling here and not before) come from a
reader or the simulator. `Alignment` finds a first estimate; `InsNavigator.advance` carries it
through increments, with its covariance, and gives a `Trajectory` that predicts position, velocity
and attitude of unit and antenna at any instant; measurement models (`measurements`, `ranging`) and
`updates.updated` find the errors that `InsNavigator.corrected` takes off. `integrate` does all
that over whole files (loose coupling), `smoothed` goes back over what it leaves.

Conventions: NED, body FRD, error = estimate − truth, C_nb_estimated = (I − [φ×])·C_nb_true.
"""

from deepgnss.ins.alignment import Alignment, AlignmentSettings
from deepgnss.ins.error_model import InitialSigmas, initial_covariance, process_noise
from deepgnss.ins.error_state import Estimate, Layout
from deepgnss.ins.fixes import GnssFix, WheelSpeeds, fix_of
from deepgnss.ins.integration import Integration, Settings, Vehicle, integrate
from deepgnss.ins.navigator import InsNavigator
from deepgnss.ins.smoother import smoothed
from deepgnss.ins.trajectory import Antenna, Prediction, Trajectory

__all__ = [
    "Alignment",
    "AlignmentSettings",
    "Antenna",
    "Estimate",
    "GnssFix",
    "InitialSigmas",
    "InsNavigator",
    "Integration",
    "Layout",
    "Prediction",
    "Settings",
    "Trajectory",
    "Vehicle",
    "WheelSpeeds",
    "fix_of",
    "initial_covariance",
    "integrate",
    "process_noise",
    "smoothed",
]
