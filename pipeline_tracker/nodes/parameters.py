"""Settings as ROS parameters: dotted names, descriptions and ranges from the settings model."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import dotted_values, replace_settings, settings_from_values
from pipeline_tracker.settings_rows import SettingRow, describe_settings

if TYPE_CHECKING:
    from pipeline_tracker.nodes.base import PipelineNode

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
        node.declare_parameter(row.key, values[row.key], descriptor(row), ignore_override=True)
    return settings


def descriptor(row: SettingRow) -> ParameterDescriptor:
    """Return the descriptor of a setting."""
    live = "may change at run time" if row.live else ""
    words = ", ".join(filter(None, (row.unit, row.range, live)))
    described = ParameterDescriptor(
        name=row.key,
        description=row.description,
        additional_constraints=words,
        # A value of another type is refused by the settings' model, which says more.
        dynamic_typing=True,
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


class ParameterGate:
    """Lets parameters of a node change: all that are set in one call, or none.

    While the node is not configured, all may be set; they are checked when it is configured. Then
    those may change that the settings' model names for this node, with the same checks.
    """

    def __init__(self, node: PipelineNode) -> None:
        """Watch over a node's parameters.

        ``settled`` is whether the node goes by them: rclpy asks here too where they are declared.
        """
        self._node = node
        self.settled = False
        node.add_pre_set_parameters_callback(self._as_numbers)
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._take_over)

    def _as_numbers(self, parameters: list[Parameter]) -> list[Parameter]:
        """Take 1 for 1.0, as everywhere else."""
        rows = {row.key: row for row in describe_settings()}
        return [
            Parameter(p.name, value=float(p.value))
            if p.name in rows and rows[p.name].kind == "number" and type(p.value) is int
            else p
            for p in parameters
        ]

    def _check(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        try:
            self._changed(parameters)
        except SettingsError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_over(self, parameters: Sequence[Parameter]) -> None:
        changed = self._changed(parameters)
        if changed is not None:
            self._node.change_settings(changed)

    def _changed(self, parameters: Sequence[Parameter]) -> Settings | None:
        """Return the settings with other parameters; None where they are none of the node's yet.

        Raises:
            SettingsError: one may not change now, or is out of its range.
        """
        rows = {row.key: row for row in describe_settings()}
        given = {p.name: _plain(p.value) for p in parameters if p.name in rows}
        if not self.settled or not given:
            return None
        settings, name = self._node.settings, self._node.NAME
        now = dotted_values(settings)
        changes = {key: value for key, value in given.items() if value != now[key]}
        for key in changes:
            if rows[key].live and name not in rows[key].live:
                raise SettingsError(
                    f"{key}: {name} does not use it; set it on {' and '.join(rows[key].live)}"
                )
            if not rows[key].live:
                raise SettingsError(
                    f"{key} cannot change while {name} is configured; clean the node up "
                    "(lifecycle), set it, and configure the node, or start it anew"
                )
        return replace_settings(settings, changes)


def _plain(value: Any) -> Any:
    """Return rclpy's arrays as lists."""
    return list(value) if hasattr(value, "typecode") else value
