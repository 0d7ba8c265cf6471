"""
Play a bag on its topics, to look at it or to let another controller answer.

Arguments: ros2 launch shepherd_ros replay.launch.py --show-args
"""

from launch import LaunchContext, LaunchDescription
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown, TimerAction
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from shepherd_ros.bringup import controller_process
from shepherd_ros.launch_arguments import REPLAY_ARGUMENTS, replay_values, require_success
from shepherd_ros.resources import share_file
from shepherd_ros.rosbag2.reader import open_bag
from shepherd_ros.wire.topics import renamed_topics


def on_exit(event: ProcessExited, context: LaunchContext) -> list[Action]:
    """End all when the bag has ended, or with exit code 1 when a node has failed."""
    require_success(event.process_name, event.returncode)
    return [Shutdown()] if event.process_name.startswith('player') else []


def nodes(context: LaunchContext) -> list[Action]:
    """Return the nodes that the arguments ask for."""
    given = {name: LaunchConfiguration(name).perform(context) for name in REPLAY_ARGUMENTS}
    values = replay_values(given, list(open_bag(given['bag']).topics))
    player = Node(
        package='shepherd_ros',
        executable='player',
        arguments=values.player,
        remappings=values.remaps,
        output='screen',
        on_exit=on_exit,
    )
    actions: list[Action] = [TimerAction(period=values.delay, actions=[player])]
    if values.controller:
        process = controller_process(values.controller, {})
        actions.append(
            Node(
                package='shepherd_ros',
                executable=process.executable,
                name=process.name,
                namespace=values.namespace,
                parameters=[part for part in (process.parameters, values.params_file) if part],
                output='screen',
                on_exit=on_exit,
            )
        )
    if values.rviz:
        view = ['-d', str(share_file('config', 'shepherd.rviz'))]
        renames = renamed_topics(values.namespace, values.n_shepherds)
        actions.append(
            Node(package='rviz2', executable='rviz2', arguments=view, remappings=renames)
        )
    if values.foxglove:
        actions.append(
            Node(package='shepherd_ros', executable='foxglove', output='screen', on_exit=on_exit)
        )
    return actions


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and what follows from them; the bag has to be given."""
    arguments = [
        DeclareLaunchArgument(
            name, default_value=None if name == 'bag' else default, description=doc
        )
        for name, (default, doc) in REPLAY_ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
