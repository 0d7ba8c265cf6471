"""The composite: whose turn it is, and that each part acts as it would alone."""

from __future__ import annotations

from dataclasses import replace

import pytest
from reference import batch, make_state
from shepherd_ros.config import ConfigError
from shepherd_ros.controllers import make_controller
from shepherd_ros.controllers.composite import CompositeConfig, CompositeController, HOME
from shepherd_ros.sim.presets import PRESETS, world_preset
from shepherd_ros.sim.spawn import spawn
from shepherd_ros.sim.state import WorldState
from shepherd_ros.sim.transition import step
from shepherd_ros.sim.world import WorldConfig
import torch

WORLD = WorldConfig(n_sheep=20)


def at_distance(state: WorldState, radii: float) -> WorldState:
    """Return a state whose flock's middle is so many goal radii from the goal."""
    middle = state.goal + torch.tensor([radii, 0.0]) * state.goal_radius
    return replace(state, sheep=state.sheep - state.center[..., None, :] + middle[..., None, :])


def test_the_flock_is_home_within_one_distance_until_it_is_beyond_the_other() -> None:
    options = {'drive': 'random', 'hold': 'idle', 'home_within': 0.5, 'away_beyond': 1.5}
    law, driver = make_controller('composite', WORLD, **options), make_controller('random', WORLD)
    start = make_state(3, 20, 2, dtype=torch.float32)
    memory, homes = law.begin(start), []
    for radii in (2.0, 0.51, 0.49, 1.0, 1.49, 1.51, 1.0, 0.51, 0.4):
        state = at_distance(start, radii)
        command, memory = law.act(state, memory)
        homes.append(bool(memory[HOME]))
        drive, _ = driver.act(state, {})
        assert torch.equal(command, torch.zeros_like(drive) if homes[-1] else drive)
    assert homes == [False, False, True, True, True, False, False, False, True]


def test_worlds_of_a_batch_have_turns_of_their_own() -> None:
    law = make_controller('composite', WORLD, drive='strombom', hold='drover', home_within=1.0)
    one = make_state(3, 20, 2, dtype=torch.float32)
    two = batch([at_distance(one, radii) for radii in (0.5, 3.0)])
    command, memory = law.act(two, law.begin(two))
    assert memory[HOME].tolist() == [True, False]
    for k, name in enumerate(('drover', 'strombom')):
        alone = make_controller(name, WORLD)
        expected, _ = alone.act(two, alone.begin(two))
        assert torch.equal(command[k], expected[k])


def test_each_part_remembers_what_it_remembers_alone() -> None:
    law = make_controller('composite', WORLD, drive='pierson', hold='strombom', home_within=1.5)
    parts = {name: make_controller(name, WORLD) for name in ('pierson', 'strombom')}
    state = spawn(WORLD, torch.arange(4))
    memory = law.begin(state)
    alone = {name: part.begin(state) for name, part in parts.items()}
    turns = set()
    for _ in range(120):
        command, memory = law.act(state, memory)
        expected = {}
        for name, part in parts.items():
            expected[name], alone[name] = part.act(state, alone[name])
        home = memory[HOME][:, None, None]
        assert torch.equal(command, torch.where(home, expected['strombom'], expected['pierson']))
        turns |= set(memory[HOME].tolist())
        state = step(state, command, WORLD)
    assert turns == {False, True}
    assert alone['pierson']
    for prefix, name in (('drive', 'pierson'), ('hold', 'strombom')):
        for key, value in alone[name].items():
            assert torch.equal(memory[f'{prefix}.{key}'], value)


def test_parts_have_the_options_of_the_preset() -> None:
    config = CompositeConfig(drive='strombom', hold='pierson')
    law = CompositeController.in_preset(config, world_preset('paper'), 'paper')
    assert isinstance(law, CompositeController)
    for part in (law.drive, law.hold):
        given = PRESETS['paper'].controllers[part.name]
        assert given == {name: getattr(part.config, name) for name in given}
        assert part.config != type(part.config)()


def test_a_word_names_parts_and_distances() -> None:
    options = CompositeController.options_of
    assert options('policy:strombom,drover') == {'drive': 'policy:strombom', 'hold': 'drover'}
    assert options('idle,drover,0.5,2') == {
        'drive': 'idle', 'hold': 'drover', 'home_within': 0.5, 'away_beyond': 2.0
    }  # fmt: skip


@pytest.mark.parametrize('text', ['', 'drover', 'idle,', 'idle,drover,1', 'a,b,1,2,3'])
def test_a_word_of_another_form_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=f"'composite:{text}': expected composite:DRIVE,HOLD"):
        CompositeController.options_of(text)


@pytest.mark.parametrize(
    ('options', 'message'),
    [
        ({'home_within': 2.0, 'away_beyond': 1.0}, 'home_within is 2.0: expected at most'),
        ({'drive': 'composite'}, "drive is 'composite': expected one that is not composite"),
        ({'hold': 'nobody'}, "controller is 'nobody': expected one of"),
        ({'hold': 'drover:x'}, "controller is 'drover:x': expected drover alone; a colon"),
    ],
)
def test_options_that_cannot_be_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_controller('composite', WORLD, **options)
