"""A console in a browser, and what a person does with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import axe_core_python
import numpy as np
from selenium.webdriver import ActionChains, Keys
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.select import Select
from view.browser import Reader

AXE = Path(axe_core_python.__file__).with_name('axe.min.js').read_text(encoding='utf-8')
FINDINGS = """
const done = arguments[0];
axe.run().then(({violations}) => done(violations
  .filter(({impact}) => ['serious', 'critical'].includes(impact))
  .map(({id, nodes}) => `${id}: ${nodes.map(({html}) => html.slice(0, 120)).join(' ')}`)));
"""
SENT = """
window.SENT = [];
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (data) {
  const command = JSON.parse(data);
  if (command.do !== 'ack') SENT.push(command);
  return send.call(this, data);
};
"""


class ConsolePage(Reader):
    """Somebody who has the console open."""

    def open_console(self, address: str) -> None:
        """Open the page, and wait for the first state."""
        self.open(address)
        self.run(SENT)
        self.until(lambda: self.run('return LIVE.frame !== null'), 'there is a state')

    def stamp(self) -> int:
        """Return the stamp of the state that was drawn last [ns]."""
        return round(self.run('return LIVE.frame.time') * 1e9)

    def tab(self, name: str) -> None:
        """Show a tab: team, metrics, world, bags or nodes."""
        self.find(f'#tab-{name}').click()

    def choose(self, selector: str, text: str) -> None:
        """Choose an entry of a menu."""
        Select(self.find(selector)).select_by_visible_text(text)

    def write(self, selector: str, text: str) -> None:
        """Write into a field, in place of what is there."""
        field = self.find(selector)
        field.send_keys(Keys.CONTROL, 'a')
        field.send_keys(text)

    def click(self, selector: str) -> WebElement:
        """Click on something once it can be clicked on; return it."""
        found = self.find(selector)
        self.until(found.is_enabled, f'{selector} can be used')
        found.click()
        return found

    def text(self, selector: str) -> str:
        return self.find(selector).text

    def texts(self, selector: str) -> list[str]:
        return [found.text for found in self.driver.find_elements(By.CSS_SELECTOR, selector)]

    def until_text(self, selector: str, done: Callable[[str], Any]) -> None:
        self.until(lambda: bool(done(self.text(selector))), f'{selector}: {self.text(selector)}')

    def alert(self) -> str:
        """Return the newest words of an alert once there are any, and close it."""
        self.until(lambda: self.texts('#alerts p') != [], 'there is an alert')
        words = self.texts('#alerts p')[-1]
        self.run("document.querySelectorAll('#alerts p').forEach((item) => item.remove())")
        return words

    # ---- hands ----

    def take(self, shepherd: int) -> None:
        """Take a shepherd by hand."""
        self.click(f'#shepherds li:nth-child({shepherd + 1}) .wide')
        self.until(lambda: self.run('return team.confirmed') is True, 'it is driven from here')

    def hold(self, key: str) -> None:
        ActionChains(self.driver).key_down(key).perform()

    def let_go(self, key: str) -> None:
        ActionChains(self.driver).key_up(key).perform()

    def drag(self, start: np.ndarray, end: np.ndarray) -> None:
        """Drag from a place in metres to another."""
        actions = self.point(*self.pixel(start))
        actions.w3c_actions.pointer_action.pointer_down()
        actions.w3c_actions.pointer_action.move_to_location(*map(round, self.pixel(end)))
        actions.w3c_actions.pointer_action.pointer_up()
        actions.perform()

    def touch(self, kind: str, fingers: list[dict[str, float]]) -> None:
        """Put fingers on the screen, move or lift them: places in the window, px, with an id."""
        event = {'type': kind, 'touchPoints': fingers}
        self.driver.execute_cdp_cmd('Input.dispatchTouchEvent', event)

    def sent(self) -> list[dict[str, Any]]:
        """Return the commands that the page has given since the last time."""
        return self.run('return SENT.splice(0)')

    def said_by(self, script: str) -> list[dict[str, Any]]:
        """Return the commands that the page gives while a script runs, before anything else."""
        return self.run(f'SENT.length = 0; {script}; return SENT.splice(0)')

    # ---- what is wrong ----

    def findings(self) -> list[str]:
        """Return the serious findings of axe-core."""
        if not self.run('return Boolean(window.axe)'):
            self.driver.execute_cdp_cmd('Runtime.evaluate', {'expression': AXE})
        return self.driver.execute_async_script(FINDINGS)
