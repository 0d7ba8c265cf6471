// Curves of metrics over time, one below the other, with a cursor; for episodes that are over and
// for those that go on.
'use strict';

const LEFT = 44,
  RIGHT = 12,
  FOOT = 20; // [px] beside and below a curve
const DENSE = 3; // points per px from which lines are drawn through the extremes of each px

// Lowest and highest of the axis of a curve; a share has the whole of [0, 1].
function span(values, unit) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (low > high || (!unit && low >= 0 && high <= 1)) [low, high] = [0, 1];
  if (low > 0 && low < 0.5 * high) low = 0;
  const room = 0.08 * (high - low) || 0.1 * Math.abs(high) || 1;
  return [low - room, high + room];
}

// How many decimals numbers up to a size are told with.
function decimals(size) {
  const before = Math.floor(Math.log10(size)) + 1; // digits before the point
  return before > 0 ? Math.max(0, Math.min(2, 4 - before)) : Math.min(9, 3 - before);
}

const whole = (value) => Number.isNaN(value) || Number.isInteger(value);

// The index of the last time that is not after a moment, at least 0.
function reached(times, moment) {
  let [low, high] = [0, times.length];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= moment) low = middle;
    else high = middle;
  }
  return low;
}

function nearest(times, moment) {
  const k = reached(times, moment);
  return k + 1 < times.length && times[k + 1] - moment < moment - times[k] ? k + 1 : k;
}

class Curves {
  // metrics: [{name, unit}]; go(time) is called when a person points at one.
  constructor(box, metrics, go = null) {
    this.box = box;
    this.rows = metrics.map(({name, unit}, index) => {
      const row = element('div', box, '', 'curve');
      const heading = element('h2', row, unit ? `${name} [${unit}]` : name);
      const value = element('span', heading);
      const plot = element('div', row, '', 'plot');
      const canvas = element('canvas', plot),
        cursor = element('i', plot, '', 'cursor');
      const last = index === metrics.length - 1;
      if (last) row.classList.add('last');
      return {
        unit,
        value,
        plot,
        canvas,
        cursor,
        mark: element('i', plot, '', 'mark'),
        last,
        values: [],
      };
    });
    this.times = [];
    this.end = 1; // [s] at the right
    this.index = -1; // of the cursor
    this.repaint = () => this.paint();
    this.observer = new ResizeObserver(this.repaint);
    this.observer.observe(box);
    onPalette(this.repaint);
    if (go) this.lead(go);
  }

  // Take the curves from the page.
  close() {
    this.observer.disconnect();
    repainters.delete(this.repaint);
    this.box.replaceChildren();
  }

  // Take times (T,) [s] and for each metric values (T,), NaN where there is none; other is another
  // future with times and curves of its own.
  set(times, curves, other = null) {
    this.times = times;
    this.other = other;
    this.begin = times[0] ?? 0;
    const end = Math.max(times.at(-1), other?.times.at(-1) ?? -Infinity);
    this.end = end > this.begin ? end : this.begin + 1;
    this.rows.forEach((row, i) => {
      row.values = curves[i];
      row.span = span([...curves[i], ...(other?.curves[i] ?? [])], row.unit);
      row.digits = curves[i].every(whole) ? 0 : decimals(Math.max(-row.span[0], row.span[1]));
    });
    this.paint();
  }

  across(time) {
    return LEFT + (this.width * (time - this.begin)) / (this.end - this.begin);
  }

  // Put the cursor on a point of the curves, -1 for the newest.
  point(index) {
    this.index = index;
    const k = index < 0 ? this.times.length - 1 : index,
      x = this.across(this.times[k]);
    for (const row of this.rows) {
      const value = row.values[k],
        known = Number.isFinite(value);
      row.value.textContent = known ? value.toFixed(row.digits) : 'none';
      row.cursor.hidden = index < 0;
      row.mark.hidden = !known;
      row.cursor.style.left = row.mark.style.left = `${x}px`;
      if (known) row.mark.style.top = `${this.down(row, value)}px`;
    }
  }

  down({span: [low, high]}, value) {
    return (this.height * (high - value)) / (high - low);
  }

  paint() {
    if (!this.times.length || !this.box.clientWidth) return;
    this.width = this.box.clientWidth - LEFT - RIGHT;
    this.height = this.rows[0].plot.clientHeight - (this.rows[0].last ? FOOT : 0);
    for (const row of this.rows) this.paintRow(row);
    this.point(this.index);
  }

  paintRow(row) {
    const {width, height} = this,
      dots = window.devicePixelRatio || 1,
      [low, high] = row.span;
    const c = sized(row.canvas, LEFT + width + RIGHT, height + (row.last ? FOOT : 0), dots);
    row.cursor.style.height = `${height}px`;
    c.font = `12px ${FAMILY}`;
    c.strokeStyle = PALETTE.grid;
    c.fillStyle = PALETTE.faint;
    const up = ticks(low, high, Math.max(2, height / 26));
    const along = ticks(this.begin, this.end, Math.max(2, width / 70));
    c.beginPath();
    for (const y of up.numbers) {
      c.moveTo(LEFT, Math.round(this.down(row, y)) + 0.5);
      c.lineTo(LEFT + width, Math.round(this.down(row, y)) + 0.5);
    }
    for (const time of along.numbers) {
      c.moveTo(Math.round(this.across(time)) + 0.5, 0);
      c.lineTo(Math.round(this.across(time)) + 0.5, height);
    }
    c.stroke();
    c.textAlign = 'right';
    for (const y of up.numbers) {
      const at = this.down(row, y);
      if (at > 3 && at < height - 1) c.fillText(tickText(y, up.decimals), LEFT - 6, at + 4);
    }
    c.textAlign = 'center';
    const last = along.numbers.at(-1),
      words = (t) => tickText(t, along.decimals);
    for (const time of row.last ? along.numbers : [])
      c.fillText(words(time) + (time === last ? ' s' : ''), this.across(time), height + 15);
    const {other} = this;
    if (other)
      this.paintLine(c, row, other.times, other.curves[this.rows.indexOf(row)], PALETTE.warn);
    this.paintLine(c, row, this.times, row.values, PALETTE.accent);
  }

  paintLine(c, row, times, values, color) {
    c.strokeStyle = color;
    c.lineWidth = 2;
    c.lineJoin = 'round';
    c.beginPath();
    const every = Math.max(1, Math.floor(times.length / (DENSE * this.width)));
    let drawing = false;
    const to = (k) => {
      if (Number.isFinite(values[k])) {
        c[drawing ? 'lineTo' : 'moveTo'](this.across(times[k]), this.down(row, values[k]));
        drawing = true;
      } else drawing = false;
    };
    for (let k = 0; k < times.length; k += every) {
      let [low, high] = [k, k];
      for (let i = k + 1; i < Math.min(k + every, times.length); i++) {
        if (values[i] < values[low]) low = i;
        if (values[i] > values[high]) high = i;
      }
      to(Math.min(low, high));
      if (low !== high) to(Math.max(low, high));
    }
    c.stroke();
  }

  lead(go) {
    const seek = (event) => {
      const part = (event.clientX - this.box.getBoundingClientRect().left - LEFT) / this.width;
      go(this.begin + part * (this.end - this.begin));
    };
    this.box.classList.add('leads');
    this.box.addEventListener('pointerdown', seek);
    this.box.addEventListener('pointermove', (event) => {
      if (event.buttons & 1) seek(event);
    });
  }
}
