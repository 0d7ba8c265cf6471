"""Write msg_schemas/ anew: texts of messages, the world of the episode, and rows of topics."""

from __future__ import annotations

import json
from pathlib import Path
import re

from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.lidar_layout import CHANNELS
from shepherd_ros.sim.metrics import METRICS
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
from shepherd_ros.wire.schemas import (
    config_schema,
    installed_text,
    nested_text,
    schema_name,
    wire_types,
)
from shepherd_ros.wire.topics import families, member, Topic, topic_pattern, topic_text

FOLDER = Path(__file__).resolve().parents[1] / 'msg_schemas'


def members() -> dict[str, list[Topic]]:
    """Return the rows of the built-in members of each family."""
    scans, values = families().values()
    stamp = scans.meaning.removeprefix('a channel of a lidar')
    return {
        scans.name: [member(scans, c.name, meaning=c.meaning + stamp) for c in CHANNELS.values()],
        values.name: [
            member(values, m.name, unit=m.unit, meaning=m.meaning) for m in METRICS.values()
        ],
    }


def topics_text(text: str) -> str:
    """Return topics.yaml with the rows of the members of families anew."""
    for family, rows in members().items():
        old = rf'(^- name: {topic_pattern(family)}\n(  .*\n)*)+'
        text = re.sub(old, ''.join(map(topic_text, rows)), text, flags=re.MULTILINE)
    return text


def fresh() -> dict[str, str]:
    """Return file name -> content of every file that is made from something else."""
    texts = {schema_name(kind): nested_text(kind, installed_text) for kind in wire_types()}
    episode = json.loads((FOLDER / 'episode.schema.json').read_text(encoding='utf-8'))
    nested = {name: {'$ref': f'#/$defs/{name}'} for name in ('spawn', 'flock')}
    parts = {'world': config_schema(WorldConfig, **nested), 'spawn': config_schema(SpawnConfig)}
    for name, model in FLOCK_MODELS.items():
        constant = {'description': 'name of this flock model', 'const': name}
        parts[name] = config_schema(model.config, model=constant)
    episode['$defs'] |= parts
    return texts | {
        'episode.schema.json': json.dumps(episode, indent=2, ensure_ascii=False) + '\n',
        'topics.yaml': topics_text((FOLDER / 'topics.yaml').read_text(encoding='utf-8')),
    }


if __name__ == '__main__':
    for name, content in fresh().items():
        (FOLDER / name).parent.mkdir(exist_ok=True)
        (FOLDER / name).write_text(content, encoding='utf-8')
