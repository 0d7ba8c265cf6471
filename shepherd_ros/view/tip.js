// The name and the place of the body under the pointer.
'use strict';

const NEAR = 12; // [px] from a body to the pointer that asks for it

class Tip {
  constructor(plane, parent) {
    this.plane = plane;
    this.box = element('div', parent, '', 'tip');
    this.box.hidden = true;
    this.pointer = null; // [px] where it is asked for
    parent.addEventListener('pointermove', (event) => this.ask(event));
    parent.addEventListener('pointerdown', (event) => this.ask(event));
    parent.addEventListener('pointerleave', () => this.ask(null));
  }

  ask(event) {
    const inside = event && !(event.buttons && event.pointerType === 'mouse');
    const rect = inside && this.plane.canvas.getBoundingClientRect();
    this.pointer = inside ? [event.clientX - rect.left, event.clientY - rect.top] : null;
    this.tell();
  }

  // Name the body under the pointer and where it is.
  tell() {
    const found = this.pointer && this.plane.moment && this.nearest(...this.pointer);
    this.box.hidden = !found;
    if (!found) return;
    const {name, x, y} = found,
      {ground} = this.plane;
    this.box.textContent = `${name}\n${x.toFixed(2)} m, ${y.toFixed(2)} m`;
    const flip = ground.X(x) > ground.width - 150;
    this.box.style.transform =
      `translate(${ground.X(x) + (flip ? -12 : 12)}px, ${ground.Y(y) + 10}px)` +
      (flip ? ' translateX(-100%)' : '');
  }

  nearest(px, py) {
    const {ground, moment} = this.plane;
    let best = NEAR,
      found = null;
    for (const [kind, places] of [
      ['shepherd', moment.shepherds],
      ['sheep', moment.sheep],
    ]) {
      for (let k = 0; k < places.length; k += 2) {
        const away = Math.hypot(ground.X(places[k]) - px, ground.Y(places[k + 1]) - py);
        if (away < best) {
          best = away;
          found = {kind, index: k / 2, name: `${kind} ${k / 2}`, x: places[k], y: places[k + 1]};
        }
      }
    }
    return found;
  }
}
