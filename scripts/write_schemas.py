"""Write msg_schemas/ anew: texts of installed messages, and the world part of the episode."""

from __future__ import annotations

import json
from pathlib import Path

from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.world import SpawnConfig, WorldConfig
from shepherd_ros.wire.schemas import (
    config_schema,
    installed_text,
    nested_text,
    schema_name,
    wire_types,
)

FOLDER = Path(__file__).resolve().parents[1] / 'msg_schemas'


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
        'episode.schema.json': json.dumps(episode, indent=2, ensure_ascii=False) + '\n'
    }


if __name__ == '__main__':
    for name, content in fresh().items():
        (FOLDER / name).parent.mkdir(exist_ok=True)
        (FOLDER / name).write_text(content, encoding='utf-8')
