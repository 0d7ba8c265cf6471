#!/usr/bin/env python3
"""Write every committed file that follows from code anew: the same as `make generate`."""

from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path
import re
from typing import Any

from manual.pages import pages
from manual.wire import DOCUMENTED
import rclpy
from rclpy.context import Context
from rclpy.parameter import parameter_value_to_python
from shepherd_ros.policy.card import card
from shepherd_ros.policy.checkpoint import (
    checkpoint_file,
    load_policy,
    read_checkpoint_metadata,
    shipped_checkpoints,
)
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.lidar_layout import CHANNELS, PAPER_CHANNELS
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
from shepherd_ros.wire import topics
from shepherd_ros.wire.schemas import (
    config_schema,
    installed_text,
    nested_text,
    schema_name,
    wire_types,
)
from shepherd_ros.wire.topics import (
    families,
    member,
    Topic,
    topic_pattern,
    topic_text,
)
import yaml

ROOT = Path(__file__).resolve().parents[1]
TOPICS = 'msg_schemas/topics.yaml'


def members() -> dict[str, list[Topic]]:
    """Return the rows of the built-in members of each family."""
    scans, values, *_ = families().values()
    stamp = scans.meaning.removeprefix('a channel of a lidar')
    return {
        scans.name: [
            member(scans, name, meaning=CHANNELS[name].meaning + stamp) for name in PAPER_CHANNELS
        ],
        values.name: [
            member(values, m.name, unit=m.unit, meaning=m.meaning)
            for m in {m.name: m for kind in TASKS.values() for m in kind.metrics.values()}.values()
        ],
    }


def topics_text(text: str) -> str:
    """Return topics.yaml with the rows of the members of families anew."""
    for family, rows in members().items():
        old = rf'(^- name: {topic_pattern(family)}\n(  .*\n)*)+'
        text = re.sub(old, ''.join(map(topic_text, rows)), text, flags=re.MULTILINE)
    return text


def episode_text(text: str) -> str:
    """Return episode.schema.json with the world and the flock models anew."""
    episode = json.loads(text)
    nested = {name: {'$ref': f'#/$defs/{name}'} for name in ('spawn', 'flock', 'task')}
    parts = {'world': config_schema(WorldConfig, **nested), 'spawn': config_schema(SpawnConfig)}
    for name, model in FLOCK_MODELS.items():
        constant = {'description': 'name of this flock model', 'const': name}
        parts[name] = config_schema(model.config, model=constant)
    for name, kind in TASKS.items():
        constant = {'description': 'name of this task', 'const': name}
        parts[f'task_{name}'] = config_schema(kind, name=constant)
    parts['world']['required'].remove('task')  # of herding it is left out
    parts['task'] = task_schema()
    episode['$defs'] |= parts
    episode['$defs']['flock']['allOf'] = [
        {'if': {'properties': {'model': {'const': name}}}, 'then': {'$ref': f'#/$defs/{name}'}}
        for name in FLOCK_MODELS
    ]
    return json.dumps(episode, indent=2, ensure_ascii=False) + '\n'


def task_schema() -> dict[str, Any]:
    """Return the schema of a task; one from elsewhere may have any options."""
    about = {'description': 'name of the task', 'type': 'string', 'minLength': 1}
    return {
        'description': 'What the team has to do, and options of its start; herding if absent.',
        'type': 'object',
        'required': ['name'],
        'properties': {'name': about},
        'allOf': [
            {
                'if': {'properties': {'name': {'const': name}}},
                'then': {'$ref': f'#/$defs/task_{name}'},
            }
            for name in TASKS
        ],
    }


def parameter_file(name: str) -> str:
    """Return a parameter file with every default of a node and what it means."""
    context = Context()
    rclpy.init(args=[], context=context)
    node = DOCUMENTED[name](context=context)
    lines = [
        f'# Every parameter of {name} with its default.',
        f'/**/{name}:',
        '  ros__parameters:',
    ]
    for key in sorted(node.list_parameters([], 0).names):
        text = node.describe_parameter(key).description
        if text and key not in ('use_sim_time', 'start_type_description_service'):
            value = parameter_value_to_python(node.get_parameter(key).get_parameter_value())
            value = value if isinstance(value, bool | int | float | str) else list(value)
            shown = yaml.safe_dump(value, default_flow_style=True).removesuffix('\n...\n').strip()
            lines += [f'    # {text}', f'    {key}: {shown}']
    node.destroy_node()
    context.try_shutdown()
    return '\n'.join(lines) + '\n'


def fresh() -> Iterator[tuple[str, str]]:
    """Yield path and content of every file, those first that others are made from."""
    for kind in wire_types():
        yield f'msg_schemas/{schema_name(kind)}', nested_text(kind, installed_text)
    for name, made in (('episode.schema.json', episode_text), ('topics.yaml', topics_text)):
        path = f'msg_schemas/{name}'
        yield path, made((ROOT / path).read_text(encoding='utf-8'))
    for name in DOCUMENTED.keys() - {
        'controller'
    }:  # which has those of the controller that it runs
        yield f'config/{name}.yaml', parameter_file(name)
    for name in shipped_checkpoints():
        record = read_checkpoint_metadata(checkpoint_file(name))[1]
        yield f'docs/checkpoints/{name}.md', card(name, load_policy(name), record)
    for name, text in pages().items():
        yield f'docs/{name}', text


if __name__ == '__main__':
    for path, content in fresh():
        (ROOT / path).parent.mkdir(exist_ok=True)
        (ROOT / path).write_text(content, encoding='utf-8')
        if path == TOPICS:  # which the files after it are made from
            for read in (topics._table, topics.contract, topics.families):
                read.cache_clear()
