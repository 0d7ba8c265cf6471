"""
The messages of the console to a page: JSON texts with a type, each with what it tells.

A latched message reaches every page when it opens, and again when it changes.
"""

from __future__ import annotations

from dataclasses import dataclass
import json
from typing import Any


@dataclass(frozen=True)
class MessageKind:
    """A message by its type; fields have a meaning each."""

    doc: str
    latched: bool
    fields: dict[str, str]


_JOB = {
    'job': 'number of the job',
    'kind': 'replay, counterfactual',
    'state': 'running, done, failed or cancelled',
    'done': 'share that is done, 0 to 1',
    'text': 'what it does now, or why it failed',
    'result': (
        'null until it is done; then `tracks`: a list of `name` and `url`, from which the '
        'record of a replay page is fetched; for a counterfactual the recorded episode first, '
        'the future second, `parting`: the step at which they part, and `table`: their metrics'
    ),
}
MESSAGE_KINDS: dict[str, MessageKind] = {
    'hello': MessageKind(
        'the first message of a page',
        True,
        {
            'protocol': 'version of frames and messages',
            'version': 'version of shepherd_ros',
            'page': 'number of this page',
            'namespace': 'namespace of the graph',
            'dead_man': 'seconds without a command after which a driven shepherd stops',
            'channels': 'channels of the lidar in their order: `name`, `color`, `hit`',
            'commands': 'commands by name: `doc`, and `fields` by name with their limits',
            'record_dir': 'folder of the bags',
            'controllers': 'controllers that may drive on in a counterfactual',
            'checkpoints': 'names of the shipped checkpoints with a trained critic',
        },
    ),
    'pages': MessageKind(
        'who else is there',
        True,
        {'count': 'open pages', 'driven': 'number of the page that drives, by shepherd'},
    ),
    'episode': MessageKind(
        'the running episode, as topic `episode` has it (msg_schemas/episode.schema.json)',
        True,
        {
            'number': 'counted from 0',
            'seed': 'its seed',
            'n_sheep': 'sheep',
            'n_shepherds': 'shepherds',
            'goal_radius': 'm',
            'mode': 'lockstep or realtime',
            'world': 'every option of the world; `dt` and `episode_steps` among them',
        },
    ),
    'world': MessageKind(
        'what flock_sim of the namespace is set to',
        True,
        {
            'present': 'whether it answers',
            'paused': 'whether it is paused, null if that is not known',
            'rate': 'steps per second that are asked for; 0: that of the world',
            'settings': (
                'parameters of the next episode by name: `value`, `type`, `doc`, and where there '
                'are any `low`, `high`, `choices`'
            ),
        },
    ),
    'drivers': MessageKind(
        'who drives each shepherd',
        True,
        {
            'present': 'whether a mux says it; without one no shepherd can be taken',
            'sources': 'names of the sources, as commands and frames use them',
            'active': 'names of those that somebody publishes',
            'drivers': 'of each shepherd the source that drives it, null: none, it stands still',
            'selected': 'of each shepherd the source that was chosen, or auto: by priority',
            'locked': 'of each shepherd whether it is locked',
        },
    ),
    'metric_names': MessageKind(
        'the metrics that are published', True, {'metrics': 'list of `name`, `unit`, `meaning`'}
    ),
    'metrics': MessageKind(
        'metrics of the running episode, ten times a second while they change',
        True,
        {'episode': 'its number', 'step': 'step that they are of', 'values': 'by name'},
    ),
    'curves': MessageKind(
        'metrics of the running episode so far, for a page that has just opened',
        True,
        {
            'episode': 'its number',
            'steps': 'increasing steps, at most 2000',
            'values': 'by name, as long as `steps`, null where there is none',
        },
    ),
    'diagnostics': MessageKind(
        'reports of all nodes, once a second',
        True,
        {'reports': 'list of `name`, `level` (0 OK, 1 WARN, 2 ERROR), `message`, `values`'},
    ),
    'recording': MessageKind(
        'the recorder of the console',
        True,
        {
            'state': 'off, on or stopping',
            'bag': 'name of the bag, or of the last one',
            'seconds': 'since it began',
            'text': 'last words of the recorder, such as whether the bag is whole',
        },
    ),
    'bags': MessageKind(
        'answer to list_bags',
        True,
        {
            'bags': (
                'newest first: `name`, `size` [bytes], `start` [s since 1970], `duration` [s], '
                '`messages`, `episodes` (a list of `number`, `seed`, `n_sheep`, `n_shepherds`, '
                '`steps`), `error` if it cannot be read'
            )
        },
    ),
    'job': MessageKind('a job of this page, while it runs and when it ends', False, _JOB),
    'value_map': MessageKind(
        'values of the places of a shepherd in the state of a step, while it is on',
        True,
        {
            'on': 'whether it is on',
            'text': 'what is wrong, if anything is',
            'checkpoint': 'whose critic it is',
            'shepherd': 'whose places they are',
            'step': 'step of the state, null before the first',
            'x': 'lowest and highest x [m] of the grid',
            'y': 'lowest and highest y [m] of the grid',
            'values': 'rows along y of values along x, null before the first',
        },
    ),
    'answer': MessageKind(
        'answer to a command',
        False,
        {
            'id': 'that of the command, null without one',
            'ok': 'whether it was done',
            'text': 'what was done, or why it was not',
        },
    ),
}


def message_text(kind: str, /, **content: Any) -> str:
    """Return a message as JSON; ValueError for what is not finite."""
    return json.dumps({'type': kind, **content}, allow_nan=False)
