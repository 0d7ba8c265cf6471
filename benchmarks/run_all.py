#!/usr/bin/env python3
"""Run all benchmarks, or those that are named; a page and JSON come to out/bench/."""

import argparse
from importlib.metadata import version
import os
from pathlib import Path
import platform
import subprocess
import sys
import time

from shepherd_ros.cli.code import commit

HERE = Path(__file__).parent
# name -> options that keep the whole within half an hour
RUNS = {
    'core': ['--seconds', '0.6'],
    'growth': ['--seconds', '0.4', '--picture', '{out}/growth.png'],
    'peers': ['--seconds', '8', '--rounds', '2'],
    'learning': ['--threads', '1'],
    'ring': ['--seconds', '6', '--steps', '1000'],
    'latency': ['--seconds', '20'],
    'console': [],
    'startup': [],
    'bags': [],
}


def machine() -> str:
    """Return what ran, in a sentence."""
    names = Path('/proc/cpuinfo').read_text(encoding='utf-8')
    model = names.split('model name')[1].split(':')[1].splitlines()[0].strip()
    parts = ', '.join(f'{name} {version(name)}' for name in ('torch', 'numba', 'numpy'))
    return (
        f'{os.cpu_count()} cores ({model}), Python {platform.python_version()}, {parts}, '
        f'commit `{commit()}`, {time.strftime("%Y-%m-%d")}'
    )


def main() -> int:
    """Run, and write the page as it grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('names', nargs='*', help=f'some of {", ".join(RUNS)}')
    parser.add_argument('--out', type=Path, default=Path('out/bench'))
    options = parser.parse_args()
    strange = set(options.names) - RUNS.keys()
    if strange:
        parser.error(f'unknown {", ".join(sorted(strange))}: expected some of {", ".join(RUNS)}')
    options.out.mkdir(parents=True, exist_ok=True)
    page, failed = f'# Benchmarks\n\n{machine()}\n', 0
    for name in options.names or RUNS:
        words = [word.format(out=options.out) for word in RUNS[name]]
        words += ['--json', str(options.out / f'{name}.json')]
        load = os.getloadavg()[0]
        print(f'{name} ...', flush=True)
        done = subprocess.run(
            [sys.executable, str(HERE / f'{name}.py'), *words],
            capture_output=True,
            text=True,
            check=False,
        )
        failed += done.returncode != 0
        output = done.stdout if done.returncode == 0 else done.stderr
        command = ' '.join(['python', f'benchmarks/{name}.py', *words])
        page += f'\n## {name}\n\n`{command}`, load {load:.1f} at its start\n\n{output.strip()}\n'
        (options.out / 'README.md').write_text(page, encoding='utf-8')
        print(output)
    print(options.out / 'README.md')
    return 1 if failed else 0


if __name__ == '__main__':
    sys.exit(main())
