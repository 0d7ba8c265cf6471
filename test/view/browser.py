"""A browser, and somebody who reads a page in it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import json
from pathlib import Path
import shutil
import time
from typing import Any

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement

CHROMIUMS = ('chromium', 'chromium-browser', 'google-chrome')
FLAGS = (
    '--headless', '--no-sandbox', '--disable-gpu', '--no-first-run',
    '--disable-background-networking', '--disable-component-update', '--disable-sync',
    '--disable-dev-shm-usage', '--window-size=1280,800',
)  # fmt: skip
PATIENCE = 60.0  # [s] for anything to happen
PIXEL = """
const [x, y, beside] = arguments, {ground, canvas} = PLANE, dots = window.devicePixelRatio;
const column = ground.X(x) + beside, row = ground.Y(y);
const one = new OffscreenCanvas(1, 1).getContext('2d', {willReadFrequently: true});
one.drawImage(canvas, -Math.floor(column * dots), -Math.floor(row * dots));
return Array.from(one.getImageData(0, 0, 1, 1).data);
"""
WINDOW = """
const {left, top} = PLANE.canvas.getBoundingClientRect(), [x, y] = arguments;
return [left + PLANE.ground.X(x), top + PLANE.ground.Y(y)];
"""
GO = """
const slider = document.getElementById('scrub');
slider.value = arguments[0];
slider.dispatchEvent(new Event('input'));
"""


def chromium(profile: Path) -> webdriver.Chrome:
    """Start a browser that keeps what it must remember in a folder."""
    browser = next(filter(None, map(shutil.which, CHROMIUMS)), None)
    driver = shutil.which('chromedriver')
    if not (browser and driver):
        pytest.fail('chromium and chromedriver are not both installed: run `make browser`')
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for flag in (*FLAGS, f'--user-data-dir={profile}'):
        options.add_argument(flag)
    options.set_capability('goog:loggingPrefs', {'browser': 'ALL', 'performance': 'ALL'})
    return webdriver.Chrome(options, webdriver.ChromeService(driver))


class Reader:
    """Somebody who has a page open."""

    def __init__(self, driver: webdriver.Chrome) -> None:
        self.driver = driver

    def open(self, path: Path | str) -> None:
        self.driver.get(path if isinstance(path, str) else path.as_uri())
        self.until(lambda: self.run('return document.body.dataset.ready') == 'yes', 'it is ready')

    def run(self, script: str, *arguments: object) -> Any:
        return self.driver.execute_script(script, *arguments)

    def find(self, selector: str) -> WebElement:
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def until(self, done: Callable[[], bool], what: str, seconds: float = PATIENCE) -> None:
        limit = time.monotonic() + seconds
        while not done():
            assert time.monotonic() < limit, f'waited {seconds} s until {what}'
            time.sleep(0.02)

    def press(self, *keys: str) -> None:
        ActionChains(self.driver).send_keys(*keys).perform()

    def point(self, x: float, y: float) -> ActionChains:
        """Return the actions of pointing at a place in the window, in px."""
        actions = ActionChains(self.driver)
        actions.w3c_actions.pointer_action.move_to_location(round(x), round(y))
        return actions

    def go(self, step: int) -> None:
        """Put the slider on a step."""
        self.run(GO, step)

    def step(self) -> int:
        return int(self.find('#scrub').get_property('value'))

    def painted(self) -> list[np.ndarray]:
        """Return where sheep and shepherds are painted, (N, 2) and (H, 2) m."""
        both = self.run('const m = PLANE.moment; return [m.sheep, m.shepherds].map((p) => [...p])')
        return [np.array(places, dtype=float).reshape(-1, 2) for places in both]

    def pixel(self, place: np.ndarray) -> list[float]:
        """Return where in the window a place in metres is painted, px."""
        return self.run(WINDOW, float(place[0]), float(place[1]))

    def zoom(self) -> float:
        """Return how many px a metre has."""
        return self.run('return PLANE.ground.scale')

    def color(self, place: np.ndarray, beside: float = 0) -> str:
        """Return the colour painted at a place in metres, px to its right; '' where none is."""
        *rgb, alpha = self.run(PIXEL, float(place[0]), float(place[1]), beside)
        return '#{:02X}{:02X}{:02X}'.format(*rgb) if alpha == 255 else ''

    def complaints(self) -> list[str]:
        return [entry['message'] for entry in self.driver.get_log('browser')]

    def requests(self) -> set[str]:
        """Return the addresses that the browser has asked for since the last time."""
        events = [json.loads(entry['message']) for entry in self.driver.get_log('performance')]
        found = set()
        for event in (event['message'] for event in events):
            if event['method'] == 'Network.requestWillBeSent':
                found.add(event['params']['request']['url'])
            elif event['method'] == 'Network.webSocketCreated':
                found.add(event['params']['url'])
        return found

    @contextmanager
    def window(self, width: int, dark: bool = False) -> Iterator[None]:
        """Make the window as wide as said, a phone's below 500 px, by day or by night."""
        size = {'width': width, 'height': 800, 'deviceScaleFactor': 1, 'mobile': width < 500}
        scheme = {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}
        self.driver.execute_cdp_cmd('Emulation.setDeviceMetricsOverride', size)
        self.driver.execute_cdp_cmd('Emulation.setEmulatedMedia', {'features': [scheme]})
        try:
            yield
        finally:
            self.driver.execute_cdp_cmd('Emulation.clearDeviceMetricsOverride', {})
            self.driver.execute_cdp_cmd('Emulation.setEmulatedMedia', {'features': []})
