"""COLMAP's camera models in the words of OpenCV and ROS."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spinpipe.schemas.poses import Calibration

MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5),
    4: ("OPENCV", 8), 5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4), 9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16), 12: ("SIMPLE_DIVISION", 4), 13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3), 15: ("FISHEYE", 4), 16: ("EUCM", 6), 17: ("EQUIRECTANGULAR", 2),
}  # fmt: skip
"""Name and number of parameters of each camera model [COLMAP 4.2, sensor/models.h]."""

_ONE_FOCAL_LENGTH = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE",
                     "RADIAL_FISHEYE", "SIMPLE_DIVISION", "SIMPLE_FISHEYE")  # fmt: skip
_SAME = {
    "SIMPLE_PINHOLE": ("plumb_bob", 5), "PINHOLE": ("plumb_bob", 5),
    "SIMPLE_RADIAL": ("plumb_bob", 5), "RADIAL": ("plumb_bob", 5), "OPENCV": ("plumb_bob", 5),
    "FULL_OPENCV": ("rational_polynomial", 8), "OPENCV_FISHEYE": ("kannala_brandt", 4),
    "SIMPLE_RADIAL_FISHEYE": ("kannala_brandt", 4), "RADIAL_FISHEYE": ("kannala_brandt", 4),
    "SIMPLE_FISHEYE": ("kannala_brandt", 4), "FISHEYE": ("kannala_brandt", 4),
}  # fmt: skip
"""Models that are another with its last parameters zero: name in ROS [sensor_msgs/CameraInfo,
REP 118], number of parameters there, all in the same order."""


def calibration(
    camera: str, model: str, size: tuple[int, int], params: Sequence[float]
) -> Calibration:
    """What COLMAP says of a camera, as OpenCV has it.

    Parameters
    ----------
    camera : name of the photo.
    model : COLMAP's name of the camera model.
    size : width and height in pixels.
    params : of the model in COLMAP's order: focal lengths, principal point, distortion.

    Raises
    ------
    ValueError
        If the model is not known, or has another number of parameters.
    """
    if len(params) != dict(MODELS.values()).get(model):
        raise ValueError(f"no camera model {model} with {len(params)} parameters")
    if model == "EQUIRECTANGULAR":
        return Calibration(camera, *size, np.zeros((3, 3)), model, tuple(params))
    focal = 1 if model in _ONE_FOCAL_LENGTH else 2
    # to COLMAP the middle of the first pixel is at (0.5, 0.5)
    cx, cy = params[focal] - 0.5, params[focal + 1] - 0.5
    K = np.array([[params[0], 0.0, cx], [0.0, params[focal - 1], cy], [0.0, 0.0, 1.0]])
    rest = tuple(params[focal + 2 :])
    name, length = _SAME.get(model, (model, len(rest)))
    return Calibration(camera, *size, K, name, rest + (0.0,) * (length - len(rest)))
