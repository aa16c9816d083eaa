"""Edges and runs that the tests of the sensor share."""

import math

import cv2
import numpy as np

from infrablend import api
from infrablend.compositing.measure import edge_profiles
from tests.run_files import records


def slanted_alpha(size, degrees=8.0):
    """A half-plane, area-sampled from 4x."""
    fine = 4
    y, x = (np.mgrid[: size * fine, : size * fine] + 0.5) / fine - size / 2
    side = (x * math.cos(math.radians(degrees)) + y * math.sin(math.radians(degrees)) > 0).astype(np.float32)
    return cv2.resize(side, (size, size), interpolation=cv2.INTER_AREA)


def overshoot(picture):
    mean = edge_profiles(picture)[0].mean(axis=0)
    return mean.max() - 1, -mean.min()


def generate(pictures, out, **settings):
    """Return the records of a run over pictures, with settings such as `sensor_profile` for `sensor.profile`."""
    fields = {"camera.pitch": {"fixed_deg": 40}, **{k.replace("_", ".", 1): v for k, v in settings.items()}}
    execution = api.Execution(renderer="flat", in_process=True)
    api.generate("hit-uav-drone", pictures, out, seed=3, execution=execution, settings=fields)
    return records(out)
