"""What the extra ``[sim]`` brings, imported only when a scene is made."""

from __future__ import annotations

import importlib
from typing import Any

from pipeline_tracker.errors import PipelineTrackerError


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise PipelineTrackerError(
            f"simulate needs {package}, which cannot be imported ({error}); "
            "install the extra: pip install '.[sim]' in the clone"
        ) from error


def trimesh_module() -> Any:
    """Return trimesh.

    Raises:
        PipelineTrackerError: it is not installed.
    """
    return _module("trimesh")


def embree_modules() -> tuple[Any, Any]:
    """Return embreex's modules of scenes and of meshes.

    Raises:
        PipelineTrackerError: it is not installed.
    """
    return _module("embreex.rtcore_scene"), _module("embreex.mesh_construction")
