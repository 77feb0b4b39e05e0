"""From odom to the earth: latitude, longitude and height of points."""

from __future__ import annotations

import math
from importlib import import_module

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.export.errors import ExportError
from pipeline_tracker.settings import ExportSettings

Array = NDArray[np.float64]


class Georeference:
    """Places points of odom on the earth (WGS 84)."""

    def __init__(self, settings: ExportSettings) -> None:
        """Set up the transformation.

        Args:
            settings: origin and direction of odom; the origin must be given.

        Raises:
            ExportError: pyproj is not installed.
        """
        try:
            pyproj = import_module("pyproj")
        except ImportError:
            raise ExportError(
                "places on the earth need pyproj, which is not installed; install the extra: pip "
                "install '.[export]' in the clone"
            ) from None
        assert settings.origin is not None  # noqa: S101 - the caller has looked
        latitude, longitude, height = settings.origin
        cos, sin = math.cos(settings.yaw), math.sin(settings.yaw)
        # odom -> east, north, up -> earth-centred -> latitude and longitude.
        self._transformer = pyproj.Transformer.from_pipeline(
            "+proj=pipeline "
            f"+step +proj=affine +s11={cos!r} +s12={-sin!r} +s21={sin!r} +s22={cos!r} "
            f"+step +inv +proj=topocentric +ellps=WGS84 +lat_0={latitude!r} +lon_0={longitude!r} "
            f"+h_0={height!r} "
            "+step +inv +proj=cart +ellps=WGS84 "
            "+step +proj=unitconvert +xy_in=rad +xy_out=deg"
        )

    def place(self, points: Array) -> Array:
        """Return latitude, longitude (deg) and height above the ellipsoid (m) of points.

        Args:
            points: (N, 3), odom, m.

        Returns:
            (N, 3).
        """
        longitude, latitude, height = self._transformer.transform(*points.T)
        return np.stack((latitude, longitude, height), axis=1)
