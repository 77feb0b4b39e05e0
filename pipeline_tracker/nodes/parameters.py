"""Settings as ROS parameters: dotted names, descriptions and ranges from the settings model."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import dotted_values, settings_from_values
from pipeline_tracker.settings_rows import SettingRow, describe_settings

USE_SIM_TIME = "use_sim_time"
AUTOSTART = "autostart"
# Parameters of ROS itself.
_OF_ROS = ("qos_overrides.", "start_type_description_service")


def as_parameters(values: Mapping[str, Any]) -> list[Parameter]:
    """Return values by name as ROS parameters; values that are None are left out."""
    return [Parameter(name, value=value) for name, value in values.items() if value is not None]


def declare_settings(node: Node) -> None:
    """Declare the settings that a new node was not given, with their defaults.

    The node must have been made with ``automatically_declare_parameters_from_overrides``, so that
    an unknown name is seen and refused rather than ignored. Nothing is checked yet, and every value
    may be set until the node is configured.
    """
    for row in describe_settings():
        if not node.has_parameter(row.key):
            node.declare_parameter(
                row.key, row.default, ParameterDescriptor(dynamic_typing=True), ignore_override=True
            )


def read_settings(node: Node) -> Settings:
    """Read and check a node's settings, and describe each parameter.

    Raises:
        SettingsError: a setting is unknown, missing or out of its range.
    """
    given = {
        name: getattr(parameter, "value", parameter)
        for name, parameter in node.get_parameters_by_prefix("").items()
        if not name.startswith(_OF_ROS)
    }
    settings = settings_from_values(
        {name: _plain(value) for name, value in given.items() if value is not None}
    )
    values = dotted_values(settings)
    for row in describe_settings():
        # ROS declares this one itself.
        if row.key == USE_SIM_TIME:
            continue
        # Declared anew with description and range, and with 1 become 1.0 for a number.
        node.undeclare_parameter(row.key)
        node.declare_parameter(
            row.key, values[row.key], descriptor(row, values[row.key]), ignore_override=True
        )
    return settings


def descriptor(row: SettingRow, value: Any = None) -> ParameterDescriptor:
    """Return the descriptor of a setting.

    Args:
        row: the setting.
        value: its value; a parameter of more than one type, or without a value, is typed
            dynamically.
    """
    words = ", ".join(filter(None, (row.unit, row.range)))
    described = ParameterDescriptor(
        name=row.key,
        description=row.description,
        additional_constraints=words,
        read_only=True,
        dynamic_typing=value is None or row.kind == "choice",
    )
    if row.minimum is None and row.maximum is None and row.above is None:
        return described
    low = row.minimum if row.minimum is not None else row.above
    if row.kind == "number":
        least = -sys.float_info.max if low is None else float(low)
        most = sys.float_info.max if row.maximum is None else float(row.maximum)
        described.floating_point_range = [FloatingPointRange(from_value=least, to_value=most)]
    elif row.kind == "integer":
        least_int = -(2**63) if low is None else int(low)
        most_int = 2**63 - 1 if row.maximum is None else int(row.maximum)
        described.integer_range = [IntegerRange(from_value=least_int, to_value=most_int)]
    return described


def _plain(value: Any) -> Any:
    """Return rclpy's arrays as lists."""
    return list(value) if hasattr(value, "typecode") else value
