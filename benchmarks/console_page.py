#!/usr/bin/env python3
"""
What the page of a console does in headless Chromium: frames per second and time to draw one.

The console runs already: give its address. The time to draw is that of JavaScript, and, in a
second round, with the picture read back, so that Chromium has to paint it then and there; nothing
is drawn by a graphics card.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
import shutil
import tempfile
import time
from typing import Any

from selenium import webdriver

FLAGS = (
    '--headless', '--no-sandbox', '--disable-gpu', '--no-first-run', '--window-size=1280,800',
    '--disable-background-networking', '--disable-component-update', '--disable-sync',
)  # fmt: skip
START_TIMEOUT = 30.0  # [s] until the first frame
WATCH = """
const [lidar, readBack] = arguments, {paint} = Live.prototype, one = {willReadFrequently: false};
find('whose').value = lidar;
find('whose').onchange();
window.TIMES = [];
window.BEGUN = [performance.now(), LIVE.frames];
LIVE.paint = function () {
  const begun = performance.now();
  paint.call(this);
  if (readBack) PLANE.canvas.getContext('2d', one).getImageData(0, 0, 1, 1);
  TIMES.push(performance.now() - begun);
};
"""
RESULT = """
const [begun, frames] = BEGUN, sorted = TIMES.sort((a, b) => a - b);
const at = (share) => sorted[Math.floor(share * (sorted.length - 1))];
return {
  rate: 1000 * (LIVE.frames - frames) / (performance.now() - begun),
  median: at(0.5), most: at(0.95), sheep: LIVE.frame.n, rays: LIVE.frame.rays,
};
"""


def browser(profile: Path) -> webdriver.Chrome:
    """Return a headless Chromium with a profile of its own."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which('chromium') or shutil.which('google-chrome') or ''
    for flag in (*FLAGS, f'--user-data-dir={profile}'):
        options.add_argument(flag)
    return webdriver.Chrome(options, webdriver.ChromeService(shutil.which('chromedriver')))


def page_rates(address: str, seconds: float, lidar: str = '0') -> dict[str, Any]:
    """
    Return what the page of an address does with the rays of a lidar ('none': without).

    rate [1/s], median and 95th percentile of the time to draw [ms], without and with read-back.
    """
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        driver = browser(Path(profile))
        try:
            driver.get(address)
            end = time.monotonic() + START_TIMEOUT
            while not driver.execute_script('return LIVE.frame !== null && team.rows.length > 0'):
                if time.monotonic() > end:
                    raise TimeoutError(f'no frame from {address} in {START_TIMEOUT:g} s')
                time.sleep(0.1)
            found: dict[str, Any] = {}
            for prefix, read_back in (('', False), ('painted_', True)):
                driver.execute_script(WATCH, lidar, read_back)
                time.sleep(seconds)
                found |= {f'{prefix}{k}': v for k, v in driver.execute_script(RESULT).items()}
            return found
        finally:
            driver.quit()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('address', help='as the console prints it, such as http://127.0.0.1:8080/')
    parser.add_argument('--seconds', type=float, default=5.0, help='of each of two rounds')
    parser.add_argument('--lidar', default='0', help='shepherd whose rays are shown, or none')
    args = parser.parse_args()
    print(json.dumps(page_rates(args.address, args.seconds, args.lidar)))


if __name__ == '__main__':
    main()
