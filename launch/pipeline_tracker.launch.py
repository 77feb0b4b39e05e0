"""The four live nodes, one process each.

ros2 launch pipeline_tracker pipeline_tracker.launch.py config:=FILE namespace:=auv
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from pipeline_tracker.nodes.launcher import MODULES, node_parameters
from pipeline_tracker.settings_io import load_settings


def _nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes; the settings are checked before one of them is started."""
    arguments = {
        name: LaunchConfiguration(name).perform(context)
        for name in ("config", "namespace", "use_sim_time")
    }
    config = Path(arguments["config"]) if arguments["config"] else None
    # Only a value that is given wins over the file's.
    overrides = []
    if arguments["use_sim_time"]:
        overrides.append(f"use_sim_time={arguments['use_sim_time'].lower()}")
    parameters = node_parameters(load_settings(config, overrides), config)
    return [
        Node(
            package="pipeline_tracker",
            executable=name,
            name=name,
            namespace=arguments["namespace"],
            parameters=[parameters],
            output="screen",
        )
        for name in MODULES
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "config",
                default_value="",
                description="Settings file (YAML); it must give pipe.diameter, for example",
            ),
            DeclareLaunchArgument(
                "namespace", default_value="", description="Namespace of nodes and topics"
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="",
                description="Take the time from /clock: true or false; empty: as the file says",
            ),
            OpaqueFunction(function=_nodes),
        ]
    )
