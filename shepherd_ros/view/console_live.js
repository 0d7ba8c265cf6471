// What runs now: the newest frame on the plane, tracks behind it, curves of the episode so far,
// and the words about both.
'use strict';

const TRACK = 40; // moments of a track
const POINTS = 2000; // of a curve; then every second one is forgotten
const FIVE = [
  'completion_time',
  'shepherd_path_length',
  'flock_path_length',
  'flock_spread',
  'fraction_reached',
];
const SPARE = 1.25; // how much more than all bodies is in view
const RIM = 0.03; // share of the view at its edge that is not used
const CURVE_PERIOD = 200; // [ms] between two paintings of the curves

class Live {
  constructor(plane) {
    this.plane = plane;
    this.frame = null;
    this.trail = [];
    this.channels = []; // of the lidar: {name, color, hit}
    this.shown = {channels: [], trails: true, names: true};
    this.sources = [];
    this.drivers = [];
    this.held = -1;
    this.map = null;
    this.paused = false; // while a recording is on the plane
    this.drawTime = 0; // [ms] of the last drawing
    this.frames = 0;
    this.metrics = []; // {name, unit, meaning}
    this.chosen = null; // names of those that are shown; null: the five
    this.forgetCurves();
  }

  // ---- plane ----

  draw(frame) {
    const before = this.frame;
    this.frame = frame;
    this.frames++;
    if (!before || before.episode !== frame.episode || frame.step < before.step) {
      this.trail = [];
      this.limits = null;
    }
    if (!before || before.step !== frame.step || before.episode !== frame.episode) {
      this.trail.push(frame.shepherds);
      if (this.trail.length > TRACK) this.trail.shift();
    }
    this.say();
    if (!this.paused) this.paint();
  }

  paint() {
    const {frame, plane} = this;
    if (!frame) return;
    const begun = performance.now();
    this.follow();
    plane.show(this.moment(frame));
    this.drawTime = performance.now() - begun;
  }

  moment(frame) {
    const {shown, sources} = this;
    const named = shown.names ? [...frame.driver].map((k) => sources[k] ?? '') : [];
    return {
      sheep: frame.sheep,
      shepherds: frame.shepherds,
      goal: this.goal ?? frame.goal,
      goalRadius: frame.goalRadius,
      trail: shown.trails ? this.trail : [],
      labels: named,
      held: this.held >= 0 ? [this.held] : [],
      rays: this.rays(frame),
      map: this.map,
    };
  }

  rays({lidar, origin: [x, y], ranges, rays}) {
    if (lidar < 0 || !rays) return null;
    const channels = this.shown.channels
      .filter((k) => k < this.channels.length)
      .map((k) => ({
        ranges: ranges.subarray(k * rays, (k + 1) * rays),
        color: this.channels[k].color,
        hit: this.channels[k].hit,
      }));
    return {x, y, pitch: (2 * Math.PI) / rays, channels};
  }

  // Keep all in view: enlarge what is seen at once where somebody leaves it, never the other way.
  follow() {
    const {frame, plane} = this,
      {ground} = plane;
    if (!ground.fitted || ground.pointers.size) return;
    const [gx, gy] = this.goal ?? frame.goal,
      r = frame.goalRadius;
    let [left, right, bottom, top] = [gx - r, gx + r, gy - r, gy + r];
    for (const places of [frame.sheep, frame.shepherds]) {
      for (let k = 0; k < places.length; k += 2) {
        left = Math.min(left, places[k]);
        right = Math.max(right, places[k]);
        bottom = Math.min(bottom, places[k + 1]);
        top = Math.max(top, places[k + 1]);
      }
    }
    const seen = this.limits;
    const rim = seen ? RIM * Math.max(seen[1] - seen[0], seen[3] - seen[2]) : 0;
    const inside = seen && left > seen[0] + rim && right < seen[1] - rim;
    if (inside && bottom > seen[2] + rim && top < seen[3] - rim) return;
    const [x, y] = [(left + right) / 2, (bottom + top) / 2];
    const [w, h] = [((right - left) / 2) * SPARE, ((top - bottom) / 2) * SPARE];
    this.limits = [x - w, x + w, y - h, y + h];
    ground.fit(this.limits);
    ground.paint();
  }

  say() {
    const {frame} = this,
      share = frame.inGoal.reduce((sum, one) => sum + one, 0) / frame.n;
    find('empty').hidden = true;
    write(find('clock'), `${(frame.step * (this.dt ?? 1)).toFixed(1)} s`);
    write(find('count'), `step ${frame.step}, ${Math.floor(100 * share)} % in the goal`);
  }

  // ---- curves ----

  forgetCurves() {
    this.steps = [];
    this.values = new Map();
  }

  setMetrics(metrics) {
    const names = metrics.map(({name}) => name).join();
    if (names === this.metrics.map(({name}) => name).join()) return;
    this.metrics = metrics;
    this.makeCurves();
  }

  get shownMetrics() {
    const chosen = this.chosen ?? FIVE;
    const order = ({name}) => (FIVE.includes(name) ? FIVE.indexOf(name) : FIVE.length);
    return this.metrics
      .filter(({name}) => chosen.includes(name))
      .sort((a, b) => order(a) - order(b));
  }

  makeCurves() {
    const shown = this.shownMetrics;
    find('no-metrics').hidden = Boolean(this.metrics.length);
    this.curves?.close();
    const rows = shown.map(({name, unit}) => ({
      name: name.replaceAll('_', ' '),
      unit: unit === '1' ? '' : unit,
    }));
    this.curves = shown.length ? new Curves(find('curves'), rows) : null;
    this.paintCurves();
  }

  // Take the metrics of a step, or those so far with a list of steps.
  hearMetrics({episode, step, values}) {
    if (episode !== this.episodeOfCurves || step < this.steps.at(-1)) {
      this.forgetCurves();
      this.episodeOfCurves = episode;
    }
    if (step === this.steps.at(-1)) this.dropLast();
    this.steps.push(step);
    for (const [name, value] of Object.entries(values))
      this.columnOf(name)[this.steps.length - 1] = value;
    for (const column of this.values.values()) column.length = this.steps.length;
    if (this.steps.length > POINTS) this.thin();
    this.paintLater();
  }

  hearCurves({episode, steps, values}) {
    this.forgetCurves();
    this.episodeOfCurves = episode;
    this.steps = [...steps];
    for (const [name, column] of Object.entries(values))
      this.values.set(
        name,
        column.map((value) => value ?? NaN),
      );
    this.paintLater();
  }

  columnOf(name) {
    if (!this.values.has(name)) this.values.set(name, Array(this.steps.length).fill(NaN));
    return this.values.get(name);
  }

  dropLast() {
    this.steps.pop();
    for (const column of this.values.values()) column.pop();
  }

  thin() {
    const half = (column) =>
      Array.from({length: Math.ceil(this.steps.length / 2)}, (_, k) => column[2 * k]);
    for (const [name, column] of this.values) this.values.set(name, half(column));
    this.steps = half(this.steps);
  }

  paintLater() {
    this.later ??= setTimeout(() => {
      this.later = null;
      if (!this.paused && !document.hidden) this.paintCurves();
    }, CURVE_PERIOD);
  }

  paintCurves() {
    if (!this.curves || !this.steps.length) return;
    const dt = this.dt ?? 1;
    const column = ({name}) => Array.from(this.columnOf(name), (value) => value ?? NaN);
    this.curves.set(
      this.steps.map((step) => step * dt),
      this.shownMetrics.map(column),
    );
    this.curves.point(-1);
  }
}
