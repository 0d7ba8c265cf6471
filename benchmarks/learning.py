#!/usr/bin/env python3
"""
Samples per second of learning, beside what the network alone needs on the same cores.

A sample is a decision of one shepherd. Parts: forms (the network as the paper draws it, and the
forms that are used), rollout, update, dagger. Every number is the median of some rounds, in which
whatever is compared takes turns. `wall` is by the clock on the wall, `cpu` by the CPU time of all
threads of this process: what other load takes of the cores does not count there, but what it does
to their caches and clock rate does, and so does the waiting of threads for each other.
"""

import argparse
from collections.abc import Callable
from dataclasses import fields, replace
import json
import os
from pathlib import Path
from statistics import median
from typing import Any

from shepherd_ros.learning.clone import CloneLearner, Examples
from shepherd_ros.learning.dagger import LabelledWorlds
from shepherd_ros.learning.dagger_config import DaggerConfig
from shepherd_ros.learning.ppo import PPOConfig, PPOLearner
from shepherd_ros.learning.ppo_rollout import Rollout
from shepherd_ros.learning.task import TaskConfig
from shepherd_ros.learning.train_ppo import PPORunConfig
from shepherd_ros.memory import keep_memory
from shepherd_ros.policy.network import Actor, fast_dtype, NetworkConfig
from shepherd_ros.policy.policy import Policy, PolicyConfig
from shepherd_ros.sim.observation import ObservationConfig
from timing import CLOCKS, in_turns, rates, shares_of, table
import torch
from torch import Tensor

SEEN = ObservationConfig(align='goal', unit=10.0)
FROM_SCRATCH = PolicyConfig(decision_interval=4.0, observation=replace(SEEN, frame_interval=4.0))
IMITATION = PolicyConfig(observation=replace(SEEN, frame_interval=2.0))
RING = replace(
    FROM_SCRATCH,
    observation=replace(FROM_SCRATCH.observation, layout='ring'),
    network=NetworkConfig(padding='circular'),
)
RUN = PPORunConfig()
PART = 128  # samples at a time, whose layers stay in the cache

# ---- the network ----


def small_rollout(policy: Policy, decisions: int, dtype: torch.dtype) -> Rollout:
    """Return worlds as shepherd train ppo has them, with fewer decisions."""
    return Rollout(TaskConfig(), policy, RUN.groups, RUN.worlds, decisions, 0, dtype)


def forms(rounds: int, size: int) -> list[dict[str, Any]]:
    """Return rates of the actor's forward and forward with backward in its forms."""
    decisions = -(-size // (RUN.groups * RUN.worlds))  # each world has a shepherd or more
    rollout = small_rollout(Policy(FROM_SCRATCH), decisions, torch.float32)
    batch, _ = rollout.collect(0.96, 0.95, 1.0)
    chosen = torch.randperm(len(batch.value))[:size]
    frames = rollout.store.frames(batch.rows[chosen])
    nets = {'types': Policy(FROM_SCRATCH), 'ring': Policy(RING)}
    inputs = {name: p.arrange(frames, batch.first[chosen]) for name, p in nets.items()}

    def plain(actor: Actor, x: Tensor) -> Tensor:
        return actor.head(actor.body.plain(x))

    def fast(actor: Actor, x: Tensor) -> Tensor:
        return torch.cat(actor(x), dim=-1)

    def forward(form: Callable[[Actor, Tensor], Tensor], actor: Actor, x: Tensor) -> None:
        with torch.no_grad():
            form(actor, x)

    def both(form: Callable[[Actor, Tensor], Tensor], actor: Actor, x: Tensor) -> None:
        actor.zero_grad(set_to_none=True)
        form(actor, x).square().mean().backward()

    rows = []
    for name, run in (('forward', forward), ('forward, backward', both)):
        works: dict[str, Callable[[], object]] = {}
        for net, policy in nets.items():
            x, actor = inputs[net], policy.actor
            low = x.to(torch.bfloat16)
            works[f'{net}, plain, float32'] = lambda r=run, a=actor, x=x: r(plain, a, x)
            works[f'{net}, fast, float32'] = lambda r=run, a=actor, x=x: r(fast, a, x)
            works[f'{net}, fast, bfloat16'] = lambda r=run, a=actor, x=low: r(fast, a, x)
            works[f'{net}, fast, bfloat16, {PART} at a time'] = lambda r=run, a=actor, x=low: [
                r(fast, a, part) for part in x.split(PART)
            ]
        times = in_turns(works, rounds)
        reference = times['types, plain, float32']
        rows += [rates(f'{name}: {k}', len(chosen), t, reference) for k, t in times.items()]
    return rows


# ---- PPO ----


def ppo(
    rounds: int, decisions: int, interval: float
) -> tuple[list[dict[str, Any]], dict[str, float]]:
    """Return rates of rollout and update beside the bare network, and shares of the rollout."""
    dtype = fast_dtype()
    policy = Policy(replace(FROM_SCRATCH, decision_interval=interval))
    rollout = small_rollout(policy, decisions, dtype)
    config = PPOConfig(target_kl=1e9)  # or the actor might rest
    learner, draw = PPOLearner(policy, config), torch.Generator().manual_seed(0)
    batch, _ = rollout.collect(0.96, 0.95, 1.0)
    made = len(batch.value)
    learned = made // config.minibatch_size * config.minibatch_size  # whole minibatches
    batch = replace(batch, **{f.name: getattr(batch, f.name)[:learned] for f in fields(batch)})
    x = rollout.store.inputs(batch.rows, batch.first)
    at_once = x[: made // decisions]

    def collect() -> None:
        rollout.roll()
        rollout.collect(0.96, 0.95, 1.0)

    def bare_forward() -> None:
        with torch.no_grad():
            for _ in range(decisions):
                policy.actor(at_once)
                policy.critic(at_once)

    def bare_both() -> None:
        for m in x.split(config.minibatch_size) * config.update_epochs:
            policy.zero_grad(set_to_none=True)
            torch.cat(policy.actor(m), dim=-1).square().mean().backward()
            policy.critic(m).square().mean().backward()

    times = in_turns(
        {
            'bare forward': bare_forward,
            'rollout': collect,
            'bare forward and backward': bare_both,
            'update': lambda: learner.update(rollout.store, batch, draw),
        },
        rounds,
    )
    forward, both = times['bare forward'], times['bare forward and backward']
    rows = [rates(name, made, times[name], forward) for name in list(times)[:2]]
    rows += [rates(name, learned, times[name], both) for name in list(times)[2:]]
    sums = (
        {c: parts[0][c] / made + parts[1][c] / learned for c in CLOCKS}
        for parts in ((times['rollout'], times['update']), (forward, both))
    )
    rows.append(rates('rollout and update', 1, *sums))
    return rows, rollout_shares(rollout, collect, rounds)


def rollout_shares(rollout: Rollout, collect: Callable[[], None], rounds: int) -> dict[str, float]:
    """Return the shares of the CPU time of a rollout."""
    told: dict[str, float] = {}
    parts = {
        'simulator': [(g, name) for g in rollout.groups for name in ('hold', 'begin')],
        'lidar': [(rollout.store, 'put')],
        'network': [(net, 'forward') for net in (rollout.policy.actor, rollout.policy.critic)],
    }
    with shares_of(parts, told):
        for _ in range(rounds):
            collect()
    return told


# ---- DAgger ----


def dagger(rounds: int) -> list[dict[str, Any]]:
    """Return rates of the two halves of a round and of the whole, as shepherd train dagger."""
    config, dtype, policy = DaggerConfig(), fast_dtype(), Policy(IMITATION)
    lessons = [LabelledWorlds(config, policy, i, dtype) for i in range(config.groups)]
    examples = Examples(policy, 20_000, dtype)
    cloner = CloneLearner(policy, config.clone, config.seed)
    driven: list[int] = []

    def drive() -> None:
        for lesson in lessons:
            lesson.run(config.steps_per_round, False, examples)
        team = sum(int(lesson.group.moment.state.shepherd_mask.sum()) for lesson in lessons)
        driven.append(team * config.steps_per_round)

    times = in_turns({'drive': drive, 'learn': lambda: cloner.learn(examples)}, rounds)
    learned = config.clone.updates_per_round * config.clone.batch_size
    rows = [
        rates('driving: decisions', round(median(driven)), times['drive'], None),
        rates('learning: examples', learned, times['learn'], None),
    ]
    whole = {clock: times['drive'][clock] + times['learn'][clock] for clock in CLOCKS}
    rows.append(rates('rounds per minute', 60, whole, None))
    return [{k: v for k, v in row.items() if 'ratio' not in k} for row in rows]


def main() -> None:
    """Measure everything on each number of threads, print tables, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--threads', type=int, nargs='+', default=[1, 2])
    parser.add_argument('--rounds', type=int, default=5, help='of which a median is taken')
    parser.add_argument('--size', type=int, default=1024, help='samples of a batch in forms')
    parser.add_argument('--decisions', type=int, default=8, help='of each shepherd in a rollout')
    parser.add_argument(
        '--decision-interval', type=float, default=4.0, help='seconds that an action is held'
    )
    parser.add_argument('--parts', nargs='+', default=['forms', 'ppo', 'dagger'])
    parser.add_argument('--json', default='')
    options = parser.parse_args()
    keep_memory()  # as the trainers do
    results: list[dict[str, Any]] = []
    print(f'samples per second; 3 x 3 x 512 rays; work in {fast_dtype()} unless told')
    for threads in options.threads:
        torch.set_num_threads(threads)
        torch.manual_seed(0)
        result: dict[str, Any] = {'threads': threads, 'load': os.getloadavg()[0]}
        title = f'{threads} thread(s), load {result["load"]:.1f}'
        if 'forms' in options.parts:
            result['forms'] = forms(options.rounds, options.size)
            table(f'Actor, batches of {options.size}, {title}', result['forms'])
        if 'ppo' in options.parts:
            result['ppo'], result['shares'] = ppo(
                options.rounds, options.decisions, options.decision_interval
            )
            table(f'PPO, actor and critic, {title}', result['ppo'])
            table('Shares of the CPU time of a rollout', [{'': '', **result['shares']}])
        if 'dagger' in options.parts:
            result['dagger'] = dagger(max(options.rounds // 2, 1))
            table(f'A round of DAgger, {title}', result['dagger'])
        results.append(result)
    if options.json:
        Path(options.json).write_text(json.dumps(results, indent=1), encoding='utf-8')


if __name__ == '__main__':
    main()
