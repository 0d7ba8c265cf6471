// The ground of a plane: metres to pixels, grid and axes, and how a person moves and enlarges it.
'use strict';

const ZOOM = 1.3; // of a button or a key
const [NEAREST, FARTHEST] = [400, 0.05]; // [px/m] how far one can zoom

class Ground {
  constructor(box) {
    this.box = box;
    this.canvas = element('canvas', box);
    this.center = [0, 0]; // [m] in the middle
    this.scale = 10; // [px/m]
    this.limits = null; // left, right, bottom, top [m] to hold in view, until a person moves it
    this.fitted = true;
    this.pointers = new Map();
    this.changed = () => {};
    this.grab = () => null; // returns {move, drop} where a person takes something at x, y [m]
    new ResizeObserver(() => this.resize()).observe(box);
    this.listen();
  }

  X(x) {
    return (this.left + this.right) / 2 + (x - this.center[0]) * this.scale;
  }
  Y(y) {
    return (this.top + this.bottom) / 2 - (y - this.center[1]) * this.scale;
  }
  place(px, py) {
    return [
      this.center[0] + (px - (this.left + this.right) / 2) / this.scale,
      this.center[1] - (py - (this.top + this.bottom) / 2) / this.scale,
    ];
  }

  resize() {
    this.dots = window.devicePixelRatio || 1;
    this.width = this.box.clientWidth;
    this.height = this.box.clientHeight;
    const narrow = this.width < 500;
    [this.left, this.right] = [narrow ? 34 : 44, this.width - (narrow ? 6 : 14)];
    [this.top, this.bottom] = [8, this.height - 26];
    if (this.fitted) this.fit();
    this.paint();
  }

  // Hold limits in view; without any those of before.
  fit(limits = this.limits) {
    this.limits = limits;
    this.fitted = true;
    if (!limits || !this.width) return;
    const [left, right, bottom, top] = limits;
    this.center = [(left + right) / 2, (bottom + top) / 2];
    const across = (this.right - this.left) / (right - left);
    this.scale = Math.max(1e-6, Math.min(across, (this.bottom - this.top) / (top - bottom)));
  }

  reset() {
    this.fit();
    this.paint();
  }

  // Enlarge around a pixel, by default the middle.
  zoom(factor, px = (this.left + this.right) / 2, py = (this.top + this.bottom) / 2) {
    const [x, y] = this.place(px, py);
    this.scale = Math.min(NEAREST, Math.max(FARTHEST, this.scale * factor));
    this.fitted = false;
    const [nx, ny] = this.place(px, py);
    this.center = [this.center[0] + x - nx, this.center[1] + y - ny];
    this.paint();
  }

  pan(dx, dy) {
    this.center = [this.center[0] - dx / this.scale, this.center[1] + dy / this.scale];
    this.fitted = false;
    this.paint();
  }

  paint() {
    if (!this.width) return;
    const c = sized(this.canvas, this.width, this.height, this.dots);
    const {left, right, top, bottom} = this;
    c.font = `12px ${FAMILY}`;
    c.lineWidth = 1;
    c.strokeStyle = PALETTE.grid;
    c.fillStyle = PALETTE.faint;
    const [[x0, y1], [x1, y0]] = [this.place(left, top), this.place(right, bottom)];
    const count = (pixels) => Math.max(2, pixels / 80);
    const along = ticks(x0, x1, count(right - left)),
      up = ticks(y0, y1, count(bottom - top));
    c.beginPath();
    for (const x of along.numbers) {
      c.moveTo(Math.round(this.X(x)) + 0.5, top);
      c.lineTo(Math.round(this.X(x)) + 0.5, bottom);
    }
    for (const y of up.numbers) {
      c.moveTo(left, Math.round(this.Y(y)) + 0.5);
      c.lineTo(right, Math.round(this.Y(y)) + 0.5);
    }
    c.stroke();
    c.strokeStyle = PALETTE.frame;
    c.strokeRect(left + 0.5, top + 0.5, right - left - 1, bottom - top - 1);
    c.textAlign = 'center';
    const lastX = along.numbers.findLast((x) => this.X(x) < right - 24);
    for (const x of along.numbers.filter((x) => x <= lastX))
      c.fillText(tickText(x, along.decimals) + (x === lastX ? ' m' : ''), this.X(x), bottom + 17);
    c.textAlign = 'right';
    for (const y of up.numbers.filter((y) => this.Y(y) > top + 8))
      c.fillText(tickText(y, up.decimals), left - 7, this.Y(y) + 4);
    this.changed();
  }

  // ---- a person ----

  listen() {
    const {box, pointers} = this;
    let held = null;
    const at = (event) => {
      const rect = box.getBoundingClientRect();
      return [event.clientX - rect.left, event.clientY - rect.top];
    };
    const between = () => {
      const [[ax, ay], [bx, by]] = [...pointers.values()];
      return [Math.hypot(ax - bx, ay - by), (ax + bx) / 2, (ay + by) / 2];
    };
    box.addEventListener('pointerdown', (event) => {
      if (event.button || event.target.closest('button')) return;
      box.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, at(event));
      held =
        pointers.size === 1 ? this.grab(...this.place(...at(event)), event.pointerType) : null;
    });
    box.addEventListener('pointermove', (event) => {
      if (!pointers.has(event.pointerId)) return;
      const [x, y] = at(event),
        [fromX, fromY] = pointers.get(event.pointerId);
      const before = pointers.size === 2 ? between() : null;
      pointers.set(event.pointerId, [x, y]);
      if (held) held.move(...this.place(x, y));
      else if (pointers.size === 1) this.pan(x - fromX, y - fromY);
      else if (before) {
        const [far, mx, my] = between();
        this.pan(mx - before[1], my - before[2]);
        if (before[0] > 10) this.zoom(far / before[0], mx, my);
      }
    });
    for (const [kind, dropped] of [
      ['pointerup', true],
      ['pointercancel', false],
    ]) {
      box.addEventListener(kind, (event) => {
        if (!pointers.delete(event.pointerId)) return;
        held?.drop(dropped);
        held = null;
      });
    }
    box.addEventListener(
      'wheel',
      (event) => {
        event.preventDefault();
        this.zoom(Math.exp(-0.0015 * event.deltaY * (event.deltaMode ? 20 : 1)), ...at(event));
      },
      {passive: false},
    );
    const bar = element('div', box, '', 'zooms');
    for (const [name, path, act] of [
      ['Zoom in', 'M11 5h2v6h6v2h-6v6h-2v-6H5v-2h6z', () => this.zoom(ZOOM)],
      ['Zoom out', 'M5 11h14v2H5z', () => this.zoom(1 / ZOOM)],
      [
        'Fit all in view',
        'M4 4h6v2H6v4H4zM14 4h6v6h-2V6h-4zM4 14h2v4h4v2H4zM18 14h2v6h-6v-2h4z',
        () => this.reset(),
      ],
    ])
      iconButton(bar, name, path, act);
  }
}
