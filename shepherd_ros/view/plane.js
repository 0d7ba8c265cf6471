// The plane of a page: one moment of a world, painted on a canvas over its ground (see ground.js).
// A moment is {sheep, shepherds, goal, goalRadius}, positions as x0, y0, x1, y1, ... in metres,
// and where there are any: {trail, rays, labels, held, other, map}; tracks of earlier moments are
// trail.
'use strict';

const BADGE = 9.5; // [px] radius of a shepherd
const TRAIL_ALPHA = 0.8; // of the newest part of a track

const SHARE = 2 / 3; // of a dot's width in pt that is its radius in px
const dotRadius = (count) => SHARE * Math.min(8, Math.max(2, 5.5 * (100 / count) ** 0.3));

class Plane {
  constructor(box) {
    this.ground = new Ground(box);
    this.canvas = element('canvas', box);
    this.tip = new Tip(this, box);
    this.moment = null;
    this.sprites = new Map();
    this.ground.changed = () => this.paint();
    onPalette(() => {
      this.sprites.clear();
      this.ground.paint();
    });
  }

  show(moment) {
    this.moment = moment;
    this.paint();
  }

  paint() {
    const {ground, canvas, moment} = this,
      {width, height, dots, left, right, top, bottom} = ground;
    if (!width || !moment) return;
    const c = sized(canvas, width, height, dots);
    this.size = Math.min(1.3, Math.max(0.75, Math.min(right - left, bottom - top) / 520));
    c.save();
    c.beginPath();
    c.rect(left, top, right - left, bottom - top);
    c.clip();
    if (moment.map) this.paintMap(c, moment.map);
    this.paintGoal(c, moment);
    if (moment.rays) this.paintRays(c, moment.rays);
    this.paintTrail(c, moment.trail ?? []);
    if (moment.other) this.paintOther(c, moment.other);
    this.paintSheep(c, moment.sheep, PALETTE.sheep, PALETTE.ground);
    if (moment.sheep.length > 2) this.paintCenter(c, moment.sheep);
    this.paintShepherds(c, moment);
    c.restore();
    this.tip.tell();
  }

  paintMap(c, {image, limits: [left, right, bottom, top]}) {
    const {ground} = this,
      x = ground.X(left),
      y = ground.Y(top);
    c.globalAlpha = 0.7;
    c.imageSmoothingQuality = 'high';
    c.drawImage(image, x, y, ground.X(right) - x, ground.Y(bottom) - y);
    c.globalAlpha = 1;
  }

  paintGoal(c, {goal, goalRadius, map}) {
    const {ground} = this;
    c.beginPath();
    c.arc(ground.X(goal[0]), ground.Y(goal[1]), goalRadius * ground.scale, 0, 2 * Math.PI);
    c.fillStyle = PALETTE['goal-fill'];
    if (!map) c.fill();
    c.lineWidth = 1.6;
    c.strokeStyle = PALETTE.goal;
    c.stroke();
  }

  // rays: {x, y, pitch, channels: [{ranges, color, hit}]}, ranges [m], Infinity on free ones.
  paintRays(c, {x, y, pitch, channels}) {
    const {ground} = this,
      from = [ground.X(x), ground.Y(y)];
    for (const {ranges, color, hit} of channels) {
      const ends = [];
      ranges.forEach((range, ray) => {
        if (!Number.isFinite(range)) return;
        const angle = ray * pitch;
        ends.push(ground.X(x + range * Math.cos(angle)), ground.Y(y + range * Math.sin(angle)));
      });
      c.beginPath();
      for (let k = 0; k < ends.length; k += 2) {
        c.moveTo(...from);
        c.lineTo(ends[k], ends[k + 1]);
      }
      c.lineWidth = 0.8;
      c.globalAlpha = 0.45;
      c.strokeStyle = color;
      c.stroke();
      c.globalAlpha = 1;
      c.fillStyle = hit;
      for (let k = 0; k < ends.length; k += 2)
        c.fillRect(ends[k] - 1.2, ends[k + 1] - 1.2, 2.4, 2.4);
    }
  }

  // trail: where the shepherds were at the moments before, the newest last.
  paintTrail(c, trail) {
    const {ground} = this,
      team = (trail[0]?.length ?? 0) / 2;
    c.lineWidth = 2.4;
    for (let h = 0; h < team; h++) {
      c.strokeStyle = shepherdColor(h);
      for (let k = 1; k < trail.length; k++) {
        const from = trail[k - 1],
          to = trail[k];
        c.globalAlpha = (TRAIL_ALPHA * (k + 1)) / trail.length;
        c.beginPath();
        c.moveTo(ground.X(from[2 * h]), ground.Y(from[2 * h + 1]));
        c.lineTo(ground.X(to[2 * h]), ground.Y(to[2 * h + 1]));
        c.stroke();
      }
    }
    c.globalAlpha = 1;
  }

  // Another future of the same world, paler than this one and with rings for shepherds.
  paintOther(c, {sheep, shepherds}) {
    const {ground} = this;
    this.paintSheep(c, sheep, PALETTE.other, PALETTE.ground);
    c.lineWidth = 2.4;
    for (let h = 0; h < shepherds.length / 2; h++) {
      c.beginPath();
      c.arc(
        ground.X(shepherds[2 * h]),
        ground.Y(shepherds[2 * h + 1]),
        BADGE * this.size - 1,
        0,
        2 * Math.PI,
      );
      c.strokeStyle = shepherdColor(h);
      c.stroke();
    }
  }

  paintSheep(c, sheep, color, edge) {
    const {ground} = this,
      radius = this.size * dotRadius(sheep.length / 2);
    const {image, half} = this.dot(radius, color, edge);
    for (let k = 0; k < sheep.length; k += 2)
      c.drawImage(
        image,
        ground.X(sheep[k]) - half,
        ground.Y(sheep[k + 1]) - half,
        2 * half,
        2 * half,
      );
  }

  // The picture of a sheep, painted once and copied for each.
  dot(radius, color, edge) {
    const {dots} = this.ground,
      key = `${radius} ${color} ${dots}`;
    if (!this.sprites.has(key)) {
      if (this.sprites.size > 20) this.sprites.clear();
      const half = Math.ceil((radius * 1.12 + 1) * dots) / dots,
        image = document.createElement('canvas');
      const c = sized(image, 2 * half, 2 * half, dots);
      c.beginPath();
      c.arc(half, half, radius, 0, 2 * Math.PI);
      c.fillStyle = color;
      c.fill();
      c.lineWidth = 0.22 * radius;
      c.strokeStyle = edge;
      c.stroke();
      this.sprites.set(key, {image, half});
    }
    return this.sprites.get(key);
  }

  paintCenter(c, sheep) {
    const {ground} = this,
      n = sheep.length / 2;
    let [mx, my] = [0, 0];
    for (let k = 0; k < sheep.length; k += 2) {
      mx += sheep[k] / n;
      my += sheep[k + 1] / n;
    }
    const x = ground.X(mx),
      y = ground.Y(my);
    for (const [style, line, arm] of [
      [PALETTE.ground, 5, 8],
      [PALETTE.ink, 2.2, 6.5],
    ]) {
      c.strokeStyle = style;
      c.lineWidth = line;
      c.beginPath();
      c.moveTo(x - arm, y);
      c.lineTo(x + arm, y);
      c.moveTo(x, y - arm);
      c.lineTo(x, y + arm);
      c.stroke();
    }
  }

  // held: shepherds with a ring, painted on top of all others; labels: words below each.
  paintShepherds(c, {shepherds, held = [], labels = []}) {
    const {ground, size} = this,
      team = shepherds.length / 2;
    const order = [...Array(team).keys()].sort((a, b) => held.includes(a) - held.includes(b));
    c.textAlign = 'center';
    c.lineJoin = 'round';
    for (const h of order) {
      const x = ground.X(shepherds[2 * h]),
        y = ground.Y(shepherds[2 * h + 1]);
      c.beginPath();
      c.arc(x, y, BADGE * size, 0, 2 * Math.PI);
      c.fillStyle = shepherdColor(h);
      c.fill();
      c.lineWidth = 1.8;
      c.strokeStyle = held.includes(h) ? PALETTE.ink : PALETTE.ground;
      c.stroke();
      c.font = `bold ${11.5 * size}px ${FAMILY}`;
      c.fillStyle = PALETTE['on-shepherd'];
      c.fillText(h, x, y + 4.1 * size);
      if (!labels[h]) continue;
      c.font = `600 11px ${FAMILY}`;
      c.lineWidth = 3.5;
      c.strokeStyle = PALETTE.ground;
      c.strokeText(labels[h], x, y + BADGE * size + 13);
      c.fillStyle = PALETTE.ink;
      c.fillText(labels[h], x, y + BADGE * size + 13);
    }
  }
}
