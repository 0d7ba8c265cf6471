"""
Simulate a flock with its shepherds: flock_sim, a lidar per shepherd, a controller and metrics.

Arguments: ros2 launch shepherd_ros simulate.launch.py --show-args
"""

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from shepherd_ros.bringup import Process, stack_in, with_console
from shepherd_ros.launch_arguments import LAUNCH_ARGUMENTS, launch_values, require_success
from shepherd_ros.resources import share_file
from shepherd_ros.wire.topics import renamed_topics


def on_exit(event: ProcessExited, context: LaunchContext) -> list[Action]:
    """End all when the world has ended, or with exit code 1 when a node has failed."""
    require_success(event.process_name, event.returncode)
    return [Shutdown()] if event.process_name.startswith('flock_sim') else []


def nodes(context: LaunchContext) -> list[Action]:
    """Return the nodes that the arguments ask for."""
    given = {name: LaunchConfiguration(name).perform(context) for name in LAUNCH_ARGUMENTS}
    values = launch_values(given)
    stack = stack_in(
        values.setting,
        values.controller,
        mux=values.mux,
        standby=values.standby,
        **values.flock_sim,
    )
    if values.console:
        stack = with_console(stack)
    if values.record:
        stack.insert(0, Process('recorder', 'recorder'))
    words = {'recorder': ['--output', values.record]}
    files = [values.params_file] if values.params_file else []
    actions: list[Action] = [
        Node(
            package='shepherd_ros',
            executable=process.executable,
            name=process.name,
            namespace=values.namespace,
            parameters=[process.parameters, *files],
            arguments=words.get(process.name),
            output='screen',
            on_exit=on_exit,
        )
        for process in stack
    ]
    if values.rviz:
        view = ['-d', str(share_file('config', 'shepherd.rviz'))]
        renames = renamed_topics(values.namespace, values.setting.shepherds)
        actions.append(
            Node(package='rviz2', executable='rviz2', arguments=view, remappings=renames)
        )
    if values.foxglove:
        actions.append(
            Node(package='shepherd_ros', executable='foxglove', output='screen', on_exit=on_exit)
        )
    return actions


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and what follows from them."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=doc)
        for name, (default, doc) in LAUNCH_ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
