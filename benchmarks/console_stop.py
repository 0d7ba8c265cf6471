#!/usr/bin/env python3
"""
How long a shepherd that is driven from a page moves on: from an event in Chromium to zero.

Each time a key is held until the shepherd's commands on cmd_vel say so, then something takes the
key, the page or its connection away. Events have the wall clock of this machine, in the page as
`performance.timeOrigin + performance.now()`, and so has the callback that hears zero.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
import json
import os
from pathlib import Path
import signal
from statistics import median
import tempfile
from threading import Thread
import time
from typing import Any

from console import address_port
from console_page import browser, START_TIMEOUT
from selenium.webdriver import ActionChains
from selenium.webdriver.remote.webdriver import WebDriver
from shepherd_ros.bringup import Process, with_mux
from shepherd_ros.cli.processes import isolate, running
from timing import table

LIMIT = 10.0  # [s] for zero to come
TRIES_LIMIT = 120.0  # [s] for a key to move the shepherd
NOTE = """
window.WHEN = 0;
const note = () => { WHEN = WHEN || performance.timeOrigin + performance.now(); };
addEventListener('keyup', note, true);
addEventListener('blur', note, true);
document.addEventListener('visibilitychange', note, true);
"""
TAKE = """
const button = document.querySelector('#shepherds .wide');
if (DRIVE.held < 0 && button && !button.disabled) button.click();
return team.confirmed;
"""
NOW = 'WHEN = performance.timeOrigin + performance.now();'


class Commands:
    """Commands of one shepherd, with the wall time at which they came [s]."""

    def __init__(self) -> None:
        """Listen in a thread."""
        from geometry_msgs.msg import TwistStamped
        import rclpy  # which reads the environment when it is imported

        rclpy.init()
        self.heard: list[tuple[float, float]] = []  # time [s], speed [m/s]
        self.node = rclpy.create_node('stop_watch')
        self.node.create_subscription(TwistStamped, 'shepherd_0/cmd_vel', self._hear, 100)
        Thread(target=lambda: rclpy.spin(self.node), daemon=True).start()

    def _hear(self, command: Any) -> None:
        linear = command.twist.linear
        self.heard.append((time.time(), abs(linear.x) + abs(linear.y)))

    def moving(self) -> bool:
        """Return whether the last command is not zero."""
        return bool(self.heard) and self.heard[-1][1] > 0

    def last_motion(self) -> float:
        """Return when the first zero came after the last command that was not [s]."""
        moved = max(k for k, (_, speed) in enumerate(self.heard) if speed > 0)
        return self.heard[moved + 1][0]


def until(done: Callable[[], Any], what: str, seconds: float = LIMIT) -> None:
    """Wait."""
    end = time.monotonic() + seconds
    while not done():
        if time.monotonic() > end:
            raise TimeoutError(f'waited {seconds:g} s until {what}')
        time.sleep(0.002)


def renderers(driver: WebDriver) -> list[int]:
    """Return the processes that run the pages of a browser."""
    parents = {}
    for entry in Path('/proc').iterdir():
        if entry.name.isdecimal():
            try:
                words = (entry / 'cmdline').read_bytes()
                fields = (entry / 'stat').read_text().rpartition(')')[2].split()
            except OSError:
                continue
            parents[int(entry.name)] = int(fields[1]), b'--type=renderer' in words
    root = driver.service.process.pid

    def below(pid: int) -> bool:
        while pid in parents and pid != root:
            pid = parents[pid][0]
        return pid == root

    return [pid for pid, (_, renders) in parents.items() if renders and below(pid)]


def signalled(driver: WebDriver, number: signal.Signals) -> float:
    """Send a signal to all pages and return when [s]."""
    when = time.time()
    for pid in renderers(driver):
        os.kill(pid, number)
    return when


def noted(driver: WebDriver) -> float:
    """Return when the page saw the event [s]."""
    return float(driver.execute_script('return WHEN')) / 1000


def key_up(driver: WebDriver) -> float:
    ActionChains(driver).key_up('w').perform()
    return noted(driver)


def blur(driver: WebDriver) -> float:
    driver.execute_script(f"{NOW} dispatchEvent(new Event('blur'))")
    return noted(driver)


def hidden(driver: WebDriver) -> float:
    """Open another tab in front of the page."""
    page = driver.current_window_handle
    driver.switch_to.new_window('tab')
    driver.switch_to.window(page)
    return noted(driver)


def socket_closed(driver: WebDriver) -> float:
    driver.execute_script(f'{NOW} LINK.socket.close()')
    return noted(driver)


def killed(driver: WebDriver) -> float:
    return signalled(driver, signal.SIGKILL)


def stopped(driver: WebDriver) -> float:
    """Let the page run no more, as on a phone that sleeps: nothing tells the server."""
    return signalled(driver, signal.SIGSTOP)


EVENTS: dict[str, Callable[[WebDriver], float]] = {
    'key is let go': key_up,
    'window loses the focus': blur,
    'another tab hides the page': hidden,
    'socket closes': socket_closed,
    'page stands still (SIGSTOP)': stopped,
    'page is killed': killed,
}


def hold_key(driver: WebDriver, address: str) -> None:
    """Open the page, take shepherd 0 and hold a key."""
    driver.execute_cdp_cmd('Page.bringToFront', {})
    driver.get(address)
    end = START_TIMEOUT
    until(lambda: driver.execute_script('return Boolean(LIVE.frame)'), 'the page is there', end)
    driver.execute_script(NOTE)
    # a page that has no time for a sixth of a second gives the shepherd back
    until(lambda: driver.execute_script(TAKE), 'the shepherd is taken', end)
    driver.execute_script('document.activeElement.blur(); WHEN = 0')
    ActionChains(driver).key_down('w').perform()


def moves(driver: WebDriver, address: str, commands: Commands) -> bool:
    """Hold a key and return whether the shepherd moves, as a busy page may have given it back."""
    hold_key(driver, address)
    try:
        until(commands.moving, 'the shepherd moves', 3.0)
    except TimeoutError:
        return False
    time.sleep(0.3)
    return commands.moving()


def stops(commands: Commands, address: str) -> dict[str, float]:
    """Return how long after each event zero came [ms], in one browser."""
    found = {}
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        driver = browser(Path(profile))
        try:
            for name, event in EVENTS.items():
                until(lambda: moves(driver, address, commands), 'the shepherd moves', TRIES_LIMIT)
                when = event(driver)
                until(lambda: not commands.moving(), 'it stands')
                found[name] = 1000 * (commands.last_motion() - when)
                signalled(driver, signal.SIGCONT)
        finally:
            driver.quit()
    return found


def measured(mode: str, rate: float, rounds: int) -> list[dict[str, Any]]:
    """Return a row for each event."""
    world = {'n_sheep': 20, 'n_shepherds': 1, 'episode_steps': 10_000_000, 'rate': rate}
    stack = [
        Process('flock_sim', 'flock_sim', world | {'mode': mode}),
        Process('lidar', 'lidar', {'shepherd_ids': [0]}),
        Process('console', 'console', {'port': 0}),
        Process('idle', 'idle'),
    ]
    times: dict[str, list[float]] = {name: [] for name in EVENTS}
    with tempfile.TemporaryDirectory() as folder, running(Path(folder)) as processes:
        processes.start(with_mux(stack))
        address, commands = f'http://127.0.0.1:{address_port(processes)}/', Commands()
        for _ in range(rounds):
            for name, took in stops(commands, address).items():
                times[name].append(took)
        processes.check()
    return [
        {'event': name, 'median [ms]': median(seen), 'most [ms]': max(seen), 'times': len(seen)}
        for name, seen in times.items()
    ]


def main() -> int:
    """Measure, print a table and write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--mode', default='realtime', choices=('lockstep', 'realtime'))
    parser.add_argument('--rate', type=float, default=20.0, help='steps per second')
    parser.add_argument('--rounds', type=int, default=5)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    isolate(os.environ)
    load = os.getloadavg()[0]
    rows = measured(options.mode, options.rate, options.rounds)
    table(f'{options.mode}, {options.rate:g} steps per second, load {load:.0f}', rows)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + '\n', encoding='utf-8')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
