"""The reference problem: an arm, its limits, a duration and a number of samples, on which designs are compared.

The chapter states no link lengths, limits, duration or rate; these are the reference problem's of this project.
"""

from __future__ import annotations

import numpy as np

from design.trajectories.fourier import FreeSeries, PaperSeries
from modeling.kinematics.arm import PlanarArm
from modeling.rig import Limits, Rig

ARM = PlanarArm((1.0, 0.97, 0.4))
PERIOD, SAMPLES = 5.0, 200
PARAMETERS = 6
"""bias_fx, bias_fy, bias_tau, m, mlg, I (22.6)."""
LARGEST = np.array([np.radians([60.0, 70.0, 80.0]), [2.0, 2.2, 3.5], [10.0, 10.0, 15.0]])
"""(3, n): the largest |q|, |dq| and |ddq| of each joint, rad, rad/s, rad/s²."""
POSITION, VELOCITY, ACCELERATION = (np.stack([-largest, largest], axis=1) for largest in LARGEST)
LIMITS = Limits(position=POSITION, velocity=VELOCITY, acceleration=ACCELERATION)
RIG = Rig(name="reference problem", link_lengths=ARM.link_lengths, tip_length=0.2, limits=LIMITS)
CHAPTER = PaperSeries(period=PERIOD)
"""22.10, 15 coefficients."""
FREE = FreeSeries(joints=ARM.joints, harmonics=(1, 2, 3, 4, 5), period=PERIOD)
"""33 coefficients: of 4, 5, 6 and 12 harmonics those with which optimisers without exact derivatives come furthest."""
