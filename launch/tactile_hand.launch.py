# SPDX-License-Identifier: Apache-2.0
"""Start the nodes of a hand with the parameters of a scenario.

ros2 launch tactile_hand_ros tactile_hand.launch.py scenario:=human_hold

The simulation has no end. Targets and user grasp forces of the scenario are not sent:
`tactile-hand move` and `squeeze` do that. With simulation:=false, drivers replace the simulation.
"""

import tempfile
from pathlib import Path

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from tactile_hand_ros.ros.parameters import to_params_yaml
from tactile_hand_ros.scenario.scenario import NODES, load_scenario

SIMULATION = ("plant", "tactile_sensor")


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    arguments = (
        ("scenario", "paper", "Name of a scenario, or a YAML file."),
        ("namespace", "", "Namespace of all nodes, such as left."),
        ("simulation", "true", "Whether to start plant and tactile_sensor."),
    )
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, value, text in arguments
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


def nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes, each with a file of its parameters."""
    name, namespace, simulation = (
        LaunchConfiguration(each).perform(context)
        for each in ("scenario", "namespace", "simulation")
    )
    scenario = load_scenario(name)
    scenario = scenario.model_copy(update={"plant": scenario.plant.changed({"duration": 0.0})})
    folder = Path(tempfile.mkdtemp(prefix="tactile_hand_"))
    started = [each for each in NODES if simulation.lower() == "true" or each not in SIMULATION]
    for each in started:
        (folder / each).write_text(to_params_yaml(getattr(scenario, each), each), "utf-8")
    return [
        Node(
            package="tactile_hand_ros",
            executable=each,
            namespace=namespace,
            parameters=[str(folder / each)],
            output="screen",
        )
        for each in started
    ]
