"""Pages about files: bags, data sets, checkpoints, presets."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from shepherd_ros.controllers import CONTROLLERS
from shepherd_ros.datasets import lerobot_format
from shepherd_ros.experiments.catalog import EXPERIMENTS
from shepherd_ros.policy.checkpoint import (
    checkpoint_file,
    CHECKPOINT_FORMAT,
    read_checkpoint_metadata,
    shipped_checkpoints,
)
from shepherd_ros.policy.policy import PolicyConfig
from shepherd_ros.recordings import recording_writer
from shepherd_ros.recordings.export import SCHEMAS
from shepherd_ros.rosbag2 import metadata
from shepherd_ros.sim.flocking import FLOCK_MODELS
from shepherd_ros.sim.presets import PRESETS
from shepherd_ros.sim.rollout import EnvConfig
from shepherd_ros.sim.tasks import TASKS
from shepherd_ros.wire.topics import contract

from manual.tables import code, escaped, FIELDS, fields_of, page, table

KEYS = {
    'VERSION_KEY': 'version of the package that wrote the bag',
    'CONTRACT_KEY': 'hash of the topics, their types and their quality of service',
    'TOPICS_KEY': 'JSON: a hash for each topic',
    'EPISODE_KEY': 'the first message on `episode`',
    'LOST_KEY': 'JSON: messages that the recorder missed, by topic',
}
RECORD = {
    'command': 'the command that made it',
    'seed': 'seed of the training',
    'wall_time_s': 'duration [s]',
    'machine': 'where it ran',
    'code': 'commit, with + if the files were changed',
    'version': 'version of the package',
    'torch': 'version of torch',
    'config': 'the whole configuration: policy, run, checkpoint that it started from',
    'progress': 'updates, samples and seconds at which it was kept',
    'eval': 'what validation measured: metrics and return',
    'note': 'a remark, written by hand',
    'teacher': 'the controller that was imitated',
}


def _columns(schema: Iterable[Any]) -> str:
    """Return a table of the columns of an Arrow schema."""
    return table(('column', 'type'), [[code(f.name), code(f.type)] for f in schema])


def bags() -> str:
    """Return the page of the bag layout."""
    layout = f"""
A bag is a folder of [rosbag2](https://github.com/ros2/rosbag2): `{metadata.FILE}`
(metadata version {metadata.VERSION}) and one or several [MCAP](https://mcap.dev) files.
`shepherd` reads bags without a ROS installation, and refuses nothing that rosbag2 writes.

```text
my_bag/
  {metadata.FILE}
  my_bag_0.mcap
```

Topics, types and units are those of [](topics.md).
A bag of `shepherd train dagger --bag-folder` also has `teacher/shepherd_<h>/cmd_vel`.
"""
    keys = [[code(getattr(recording_writer, name)), text] for name, text in KEYS.items()]
    exported = [f'### {name}\n\n{_columns(schema)}' for name, schema in SCHEMAS.items()]
    return page(
        'Bags',
        layout,
        '## Custom data in the metadata',
        table(('key', 'content'), keys),
        '## Tables of `shepherd bag export`',
        'Positions are in m, velocities in m/s. `x` and `y` of `commands` are a velocity in the '
        'world frame. A scan has a list of ranges for each channel.',
        *exported,
    )


def dataset() -> str:
    """Return the page of the columns of a data set."""
    intro = f"""
`shepherd dataset build` writes the folders and columns of LeRobot 3.0, format
`{lerobot_format.DATASET_FORMAT}`. A row is a step of one shepherd. A LeRobot episode is a run of
one shepherd's steps, by one driver and without a hole.

| file | content |
| --- | --- |
| `{lerobot_format.DATA_PATH}` | the steps |
| `{lerobot_format.EPISODES_PATH}` | the episodes |
| `{lerobot_format.TASK_TABLE}` | tasks of the episodes, such as `{TASKS['herding'].meaning}` |
| `{lerobot_format.INFO}` | shapes and types of the columns, as LeRobot reads them |
| `{lerobot_format.STATS}` | mean, deviation and limits; rays without a return are left out |
| `{lerobot_format.ABOUT}` | time step, rays, number of bags, what was left out and why |
"""
    return page(
        'Data sets',
        intro,
        '## Steps',
        f'`{lerobot_format.LIDAR}` is channels by rays in m, `+inf` for no return. '
        f'`{lerobot_format.ACTION}` is a velocity in m/s, world frame.',
        _columns(lerobot_format.STEP_SCHEMA),
        '## Episodes',
        _columns(lerobot_format.EPISODE_SCHEMA),
    )


def checkpoints() -> str:
    """Return the page of the fields of a checkpoint."""
    records = {n: read_checkpoint_metadata(checkpoint_file(n))[1] for n in shipped_checkpoints()}
    known = dict.fromkeys(key for record in records.values() for key in record)
    rows = [[code(key), RECORD.get(key, '')] for key in RECORD if key in known]
    head = [
        ['`format`', code(CHECKPOINT_FORMAT)],
        ['`version`', 'version of the package'],
        ['`config`', 'JSON: the policy, below'],
        ['`record`', 'JSON: how it was made, below'],
    ]
    names = [
        [f'[{name}](../checkpoints/{name}.md)', code(' '.join(record['command'].split()[:3]))]
        for name, record in records.items()
    ]
    return page(
        'Checkpoints',
        'A checkpoint is a [safetensors](https://github.com/huggingface/safetensors) file: '
        'weights, and metadata that says everything about them. Opening one runs no code.',
        table(('key of the metadata', 'content'), head),
        '## Policy',
        table(FIELDS, fields_of(PolicyConfig())),
        '## Record',
        table(('key', 'content'), rows),
        '## Shipped checkpoints',
        table(('card', 'trained by'), names),
    )


def presets() -> str:
    """Return the page of presets, worlds, flock models, controllers and experiments."""
    rows = []
    for name, preset in PRESETS.items():
        parts = {**preset.flock, **{f'{k} (controller)': v for k, v in preset.controllers.items()}}
        changes = [
            f'{k}.{f} = {format(v, ".4g") if isinstance(v, float) else v}'
            for k, part in parts.items()
            for f, v in part.items()
        ]
        rows.append([code(name), f'{preset.dt:g}', escaped(preset.doc), ', '.join(changes)])
    models = [
        f'### {name}\n\n{table(FIELDS, fields_of(model.config()))}'
        for name, model in FLOCK_MODELS.items()
    ]
    laws = []
    for name, kind in CONTROLLERS.items():
        options = fields_of(kind.config_type())
        laws.append(f'### {name}\n\n{table(FIELDS, options) if options else "No options."}')
    world = [row for row in fields_of(EnvConfig()) if not row[0].startswith('`world.flock')]
    experiments = [
        [code(e.name), escaped(e.title), str(len(e.settings)), str(e.episodes)]
        for e in EXPERIMENTS.values()
    ]
    return page(
        'Presets and configuration',
        'A preset changes defaults where the paper leaves a value open. '
        'Every value can still be set by itself. `(choice)` marks what the paper leaves open.',
        table(('preset', 'dt [s]', 'meaning', 'changes'), rows),
        '## Environment',
        table(FIELDS, world),
        '## Flock models',
        *models,
        '## Controllers',
        *laws,
        '## Experiments',
        'Names that `shepherd evaluate` takes.',
        table(('experiment', 'title', 'settings', 'episodes each'), experiments),
    )


def metric_names() -> str:
    """Return the page of the metrics."""
    rows = [
        [code(t.name.removeprefix('metrics/')), t.unit, escaped(t.meaning)]
        for t in contract()[0].values()
        if t.name.startswith('metrics/')
    ]
    return page(
        'Metrics',
        'The first five are those of the paper. Why there are more: [](../concepts/metrics.md).',
        table(('metric', 'unit', 'meaning'), rows),
    )
