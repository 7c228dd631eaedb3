"""The true error model of distorted poses, for trackers that do not adapt to the stream.

Known are the noise of the simulated sensor, the parameters of correlated errors, and the poses that are not
measured. Only some distortions have such a model.
"""

import json
from dataclasses import replace
from math import radians
from typing import Final

import numpy as np

from contact_tracker.adaptation.candidates import usual_period_s, with_ticks_for
from contact_tracker.config.parameters import Model
from contact_tracker.motion.poses import Poses
from contact_tracker.recording import read_metadata
from distortions import WANDER_DEG, WANDER_M, WANDER_S

CORRELATED: Final = {"slow_wander": (WANDER_M, radians(WANDER_DEG), WANDER_S)}
"""Standard deviations (m, rad) and correlation time (s) of correlated errors."""
SPOILED: Final = frozenset(
    {"default_pose_8pct", "default_pose_stretches", "frozen_stretches", "shifted_bursts"}
)
"""Distortions in which some poses are not measured."""
WHITE: Final = frozenset({"none", "rate_10hz_jitter", "rate_5hz", "dropouts_50pct", "dropout_bursts_30pct"})
"""Distortions in which poses are missing, but the others are as measured."""
KNOWN: Final = (*CORRELATED, *SPOILED, *WHITE)


def measured_poses(distortion: str, clean: Poses, distorted: Poses) -> Poses:
    """The measured poses: those that equal the ``clean`` ones at the same time."""
    if distortion not in SPOILED:
        return distorted
    same = np.searchsorted(clean.stamp_ns, distorted.stamp_ns)
    off_m = np.abs(distorted.position_m - clean.position_m[same]).max(axis=1)
    turned = np.abs(distorted.quat_xyzw - clean.quat_xyzw[same]).max(axis=1)
    return distorted[np.maximum(off_m, turned) < 1e-9]


def true_model(distortion: str, path: str, poses: Poses, model: Model) -> Model:
    """The model for ``poses`` with the noise in the recording's metadata and the errors of the distortion."""
    stated = json.loads(read_metadata(path)["recording"]["noise"])
    known = model.with_noise(stated["pos_std_m"], radians(stated["rot_std_deg"]))
    position_m, rotation_rad, within_s = CORRELATED.get(distortion, (0.0, 0.0, model.noise.wander_s))
    noise = replace(
        known.noise, wander_position_m=position_m, wander_rotation_rad=rotation_rad, wander_s=within_s
    )
    return with_ticks_for(replace(known, noise=noise), usual_period_s(poses.stamp_ns))
