// The link of the console to its server: commands and their answers, messages by kind, and frames,
// of which only the newest is kept and drawn.
'use strict';

const HEADER = 64; // [bytes] of a frame
const WAITS = [250, 500, 1000, 2000, 4000]; // [ms] before each further try to connect
const PATIENCE = 10_000; // [ms] for an answer

// The parts of a binary frame, views of it without a copy (docs/reference/console.md).
function readFrame(buffer) {
  const head = new DataView(buffer),
    word = (k) => head.getUint32(k, true);
  const [n, team, channels, rays] = [word(24), word(28), word(36), word(40)];
  const frame = {
    number: word(4),
    time: head.getFloat64(8, true),
    episode: word(16),
    step: word(20),
    n,
    team,
    lidar: head.getInt32(32, true),
    channels,
    rays,
    goal: [head.getFloat32(44, true), head.getFloat32(48, true)],
    goalRadius: head.getFloat32(52, true),
    origin: [head.getFloat32(56, true), head.getFloat32(60, true)],
  };
  const numbers = new Float32Array(buffer, HEADER);
  let from = 0;
  const take = (count) => numbers.subarray(from, (from += count));
  return Object.assign(frame, {
    sheep: take(2 * n),
    sheepHeading: take(2 * n),
    inGoal: take(n),
    shepherds: take(2 * team),
    shepherdHeading: take(2 * team),
    driver: take(team),
    ranges: take(channels * rays),
  });
}

class Link {
  // draw(frame) is called at most once for each frame of the screen, with the newest frame.
  constructor(draw) {
    this.draw = draw;
    this.hears = new Map();
    this.asked = new Map();
    this.number = 0;
    this.tries = 0;
    this.fresh = null; // newest frame that is not drawn
    this.waiting = false;
    this.live = false;
  }

  on(kind, hear) {
    this.hears.set(kind, [...(this.hears.get(kind) ?? []), hear]);
  }

  hear(kind, message) {
    for (const hear of this.hears.get(kind) ?? []) hear(message);
  }

  connect() {
    const url = new URL('ws', location.href);
    url.protocol = location.protocol === 'https:' ? 'wss:' : 'ws:';
    url.search = location.search;
    this.socket = new WebSocket(url);
    this.socket.binaryType = 'arraybuffer';
    this.socket.onmessage = ({data}) =>
      typeof data === 'string' ? this.read(data) : this.keep(data);
    this.socket.onclose = ({reason}) => this.lost(reason);
  }

  read(text) {
    const {type, ...message} = JSON.parse(text);
    if (type === 'answer') this.answered(message);
    else {
      const first = type === 'hello' && !this.live;
      if (first) {
        this.tries = 0;
        this.live = true;
      }
      this.hear(type, message);
      if (first) this.hear('live', true);
    }
  }

  lost(reason) {
    this.live = false;
    this.fresh = null;
    for (const {resolve} of this.asked.values())
      resolve({ok: false, text: 'The connection was lost.'});
    this.asked.clear();
    this.hear('live', false);
    this.hear('lost', reason);
    setTimeout(() => this.connect(), WAITS[Math.min(this.tries++, WAITS.length - 1)]);
  }

  // ---- commands ----

  // Give a command; the answer is {ok, text}.
  ask(name, fields = {}) {
    const id = ++this.number;
    if (!this.send(name, {id, ...fields}))
      return Promise.resolve({ok: false, text: 'There is no connection.'});
    return new Promise((resolve) => {
      this.asked.set(id, {resolve, since: performance.now()});
      if (this.asked.size === 1) setTimeout(() => this.expire(), PATIENCE);
    });
  }

  // Send a command that is not answered, unless with an error; return whether it could be sent.
  send(name, fields = {}) {
    const open = this.live && this.socket.readyState === WebSocket.OPEN;
    if (open) this.socket.send(JSON.stringify({do: name, ...fields}));
    return open;
  }

  // Give a command whose answer counts only if it is an error.
  tell(name, fields = {}) {
    this.ask(name, fields).then(({ok, text}) => {
      if (!ok) this.hear('refused', {name, text});
    });
  }

  answered({id, ok, text}) {
    this.asked.get(id)?.resolve({ok, text});
    if (!this.asked.delete(id) && !ok) this.hear('refused', {name: '', text});
  }

  expire() {
    const late = performance.now() - 0.9 * PATIENCE;
    for (const [id, {resolve, since}] of this.asked) {
      if (since > late) continue;
      this.asked.delete(id);
      resolve({ok: false, text: 'The console did not answer in 10 s.'});
    }
    if (this.asked.size) setTimeout(() => this.expire(), PATIENCE);
  }

  // ---- frames ----

  keep(buffer) {
    this.fresh = buffer;
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      if (!this.fresh) return;
      const frame = readFrame(this.fresh);
      this.fresh = null;
      this.draw(frame);
      this.send('ack', {frame: frame.number});
    });
  }
}
