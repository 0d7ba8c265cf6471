// Hands on a shepherd: keys and a virtual stick. The command goes out again and again while a
// shepherd is held; it is zero whenever nothing is held down, and whatever takes the page from its
// user stops the shepherd and gives it back.
'use strict';

const PERIOD = 30; // [ms] between two commands; after 100 ms without one a shepherd stops
const SLOW = 0.4; // share of the speed while shift is held
const DEAD_ZONE = 0.08; // share of the stick's way that means zero
const KEYS = {
  ArrowUp: [0, 1],
  ArrowDown: [0, -1],
  ArrowLeft: [-1, 0],
  ArrowRight: [1, 0],
  KeyW: [0, 1],
  KeyS: [0, -1],
  KeyA: [-1, 0],
  KeyD: [1, 0],
};

class Drive {
  // changed() is called when another shepherd is held, or none.
  constructor(link, changed) {
    this.link = link;
    this.changed = changed;
    this.held = -1; // shepherd that this page drives
    this.speed = 1; // [m/s] of a full stick
    this.frame = 'world';
    this.guarded = false; // moves only while the dead-man's switch is held
    this.guard = new Set(); // what holds it: a key, a pointer
    this.keys = new Set();
    this.slow = false;
    this.stick = [0, 0]; // [-1, 1]
    this.sent = [0, 0];
    this.listen();
    this.makeStick(find('stick'));
    this.makeGuard(find('guard'));
  }

  async take(shepherd) {
    if (shepherd === this.held || !this.link.live) return;
    if (this.held >= 0) this.release();
    this.held = shepherd;
    this.rest();
    this.timer = setInterval(() => this.send(), PERIOD);
    this.changed();
    const first = {shepherd, x: 0, y: 0, frame: this.frame};
    const {ok, text} = await this.link.ask('drive', first);
    if (ok || this.held !== shepherd) return;
    this.forget();
    this.link.hear('refused', {name: 'drive', text});
  }

  // Stop the shepherd and give it back.
  release() {
    if (this.held < 0) return;
    if (this.link.live) this.link.tell('release', {shepherd: this.held});
    this.forget();
  }

  // Note that the shepherd is no longer this page's.
  forget() {
    clearInterval(this.timer);
    this.held = -1;
    this.rest();
    this.changed();
  }

  // Forget all that was held down.
  rest() {
    this.keys.clear();
    this.guard.clear();
    this.slow = false;
    this.stick = [0, 0];
    this.showStick();
  }

  // What the page is told to do when it loses its user.
  leave() {
    const had = this.held;
    if (had < 0) return;
    if (this.link.live) this.link.tell('blur');
    this.forget();
    this.link.hear(
      'note',
      `Shepherd ${had} stands still and was given back: this page lost the focus.`,
    );
  }

  // The velocity [m/s] that is asked for, x to the right and y up; forward and left in frame body.
  get velocity() {
    if (this.guarded && !this.guard.size) return [0, 0];
    let [x, y] = this.stick;
    for (const key of this.keys) [x, y] = [x + KEYS[key][0], y + KEYS[key][1]];
    const size = Math.hypot(x, y),
      full = this.speed * (this.slow ? SLOW : 1);
    if (size < DEAD_ZONE) return [0, 0];
    const scale = full / Math.max(1, size);
    return this.frame === 'body' ? [y * scale, -x * scale] : [x * scale, y * scale];
  }

  send() {
    if (this.held < 0) return;
    const [x, y] = (this.sent = this.velocity);
    this.link.send('drive', {shepherd: this.held, x, y, frame: this.frame});
  }

  // Send at once what has changed, not only at the next beat.
  update() {
    this.showStick();
    const [x, y] = this.velocity;
    if (x !== this.sent[0] || y !== this.sent[1]) this.send();
  }

  // ---- what a person does ----

  listen() {
    const typing = ({target}) =>
      target.closest?.('input:not([type=checkbox], [type=range]), select, textarea');
    addEventListener('keydown', (event) => {
      if (this.held < 0) return;
      if (event.ctrlKey || event.altKey || event.metaKey) this.rest();
      else if (event.key === 'Escape') this.release();
      else if (event.code === 'Space' && this.guarded) this.guard.add('Space');
      else if (KEYS[event.code] && !typing(event)) this.keys.add(event.code);
      else if (event.key === 'Shift') this.slow = true;
      else return;
      event.preventDefault();
      this.update();
    });
    addEventListener('keyup', (event) => {
      this.keys.delete(event.code);
      if (event.code === 'Space' && this.guard.delete('Space')) event.preventDefault();
      if (event.key === 'Shift') this.slow = false;
      if (event.key === 'Meta') this.keys.clear(); // key-ups get lost while it is held
      this.update();
    });
    addEventListener('focusin', (event) => {
      if (!typing(event)) return;
      this.rest();
      this.update();
    });
    addEventListener('contextmenu', () => {
      this.rest();
      this.update();
    });
    addEventListener('blur', () => this.leave());
    addEventListener('pagehide', () => this.leave());
    document.addEventListener('freeze', () => this.leave());
    document.addEventListener('visibilitychange', () => {
      if (document.hidden) this.leave();
    });
  }

  makeStick(stick) {
    this.knob = stick.querySelector('i');
    let pointer = null;
    const move = (event) => {
      const {left, top, width} = stick.getBoundingClientRect(),
        half = width / 2;
      const x = (event.clientX - left - half) / (0.7 * half);
      const y = -(event.clientY - top - half) / (0.7 * half);
      const size = Math.max(1, Math.hypot(x, y));
      this.stick = [x / size, y / size];
      this.update();
    };
    stick.addEventListener('pointerdown', (event) => {
      if (pointer !== null) return;
      pointer = event.pointerId;
      stick.setPointerCapture(pointer);
      event.preventDefault();
      move(event);
    });
    stick.addEventListener('pointermove', (event) => {
      if (event.pointerId === pointer) move(event);
    });
    for (const kind of ['pointerup', 'pointercancel', 'lostpointercapture']) {
      stick.addEventListener(kind, (event) => {
        if (event.pointerId !== pointer) return;
        pointer = null;
        this.stick = [0, 0];
        this.update();
      });
    }
  }

  // The knob shows keys, too.
  showStick() {
    let [x, y] = this.held < 0 ? [0, 0] : this.velocity.map((v) => v / this.speed);
    if (this.frame === 'body') [x, y] = [-y, x];
    if (this.knob) this.knob.style.transform = `translate(${35 * x}%, ${-35 * y}%)`;
  }

  makeGuard(button) {
    button.addEventListener('pointerdown', (event) => {
      button.setPointerCapture(event.pointerId);
      event.preventDefault();
      this.guard.add(event.pointerId);
      this.update();
    });
    for (const kind of ['pointerup', 'pointercancel', 'lostpointercapture']) {
      button.addEventListener(kind, (event) => {
        this.guard.delete(event.pointerId);
        this.update();
      });
    }
  }
}
