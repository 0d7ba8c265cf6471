// Replays the record of the page. Bodies, goal and rays are painted on a canvas that lies inside
// the plot of the plane; the traces of that plot follow when the replay rests, for hovering.
'use strict';

const RECORD = JSON.parse(document.getElementById('record').textContent);
const COLORS = RECORD.colors;
const FREE = 65535;
const FONT = {family: 'system-ui, "DejaVu Sans", sans-serif', size: 12, color: COLORS.faint};
const WIDE = window.matchMedia('(min-width: 900px)').matches;
const TOUCH = window.matchMedia('(pointer: coarse)').matches;
const TYPES = {
  uint16: Uint16Array, int32: Int32Array, float32: Float32Array, float64: Float64Array,
};

const find = (id) => document.getElementById(id);
const colorOf = (shepherd) => COLORS.shepherds[shepherd % COLORS.shepherds.length];

function element(tag, parent, text = '', name = '') {
  const made = parent.appendChild(document.createElement(tag));
  made.textContent = text;
  made.className = name;
  return made;
}

// ---- data ----

// Numbers that were packed: base64, zlib, then little-endian numbers of a type.
async function unpack(pack) {
  const text = atob(pack.data), bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new TYPES[pack.type](await new Response(stream).arrayBuffer());
}

// Coordinates that were rounded, as x0, y0, x1, y1, ...
async function places(pack) {
  const whole = await unpack(pack), metres = new Float64Array(whole.length);
  for (let k = 0; k < whole.length; k++) metres[k] = pack.low + pack.step * whole[k];
  return metres;
}

async function load() {
  const names = ['times', 'steps', 'goal', 'inGoal'];
  const [times, steps, goal, inGoal] = await Promise.all(names.map((n) => unpack(RECORD[n])));
  const sheep = await places(RECORD.sheep), shepherds = await places(RECORD.shepherds);
  const curves = await Promise.all(RECORD.curves.map(unpack));
  const ranges = RECORD.lidar && await unpack(RECORD.lidar);
  const n = RECORD.sheep.shape[1], team = RECORD.shepherds.shape[1];
  return {times, steps, goal, inGoal, sheep, shepherds, curves, ranges, n, team};
}

// The x (axis 0) or y (axis 1) of all bodies of a kind at a step.
function coordinates(flat, count, step, axis) {
  return Array.from({length: count}, (_, k) => flat[2 * (step * count + k) + axis]);
}

// ---- plane ----

async function makePlane(data, shown) {
  const box = find('plane');
  const [left, right, bottom, top] = RECORD.limits;
  const axis = {
    gridcolor: COLORS.grid, zeroline: false, ticks: '', linecolor: '#C9CFD3', mirror: true,
    showline: true, tickfont: FONT, automargin: false, nticks: WIDE ? 10 : 6,
  };
  const trace = (name, size) => ({
    x: [], y: [], name, mode: 'markers', marker: {size, opacity: 0},
    hovertemplate: `${name} %{pointNumber}<br>%{x:.2f} m, %{y:.2f} m<extra></extra>`,
  });
  const title = (text, standoff) => ({title: {text, standoff, font: FONT}});
  await Plotly.newPlot(box, [trace('sheep', 10), trace('shepherd', 20)], {
    xaxis: {...axis, ...title('x [m]', 8), range: [left, right]},
    yaxis: {...axis, ...title('y [m]', 6), range: [bottom, top], scaleanchor: 'x'},
    margin: {l: 52, r: 14, t: 6, b: 40}, showlegend: false, hovermode: 'closest',
    dragmode: TOUCH ? false : 'pan', font: FONT,
    paper_bgcolor: 'rgba(0,0,0,0)', plot_bgcolor: 'rgba(0,0,0,0)',
    modebar: {
      orientation: 'v', bgcolor: 'rgba(0,0,0,0)', color: COLORS.faint, activecolor: COLORS.ink,
    },
  }, {
    displaylogo: false, scrollZoom: WIDE,
    modeBarButtons: [['zoomIn2d', 'zoomOut2d', 'resetScale2d']],
  });
  const layers = box.querySelector('.svg-container');
  const canvas = document.createElement('canvas');
  layers.insertBefore(canvas, layers.querySelector('.gl-container'));
  const repaint = () => paint(canvas, box._fullLayout, data, shown);
  box.on('plotly_afterplot', repaint);
  box.on('plotly_relayouting', repaint);
  new ResizeObserver(() => Plotly.Plots.resize(box)).observe(box);
  let waiting = 0;
  const follow = (resting) => {
    clearTimeout(waiting);
    const flocks = [[data.sheep, data.n], [data.shepherds, data.team]];
    const along = (axis) => flocks.map(([flat, count]) =>
      resting ? coordinates(flat, count, shown.step, axis) : []);
    const update = () => Plotly.restyle(box, {x: along(0), y: along(1)}, [0, 1]);
    if (resting || box.data[0].x.length) waiting = setTimeout(update, resting ? 120 : 0);
  };
  return {repaint, follow};
}

function paint(canvas, layout, data, shown) {
  const {xaxis, yaxis, width, height} = layout;
  const dots = window.devicePixelRatio || 1, c = canvas.getContext('2d');
  if (canvas.width !== Math.round(width * dots) || canvas.height !== Math.round(height * dots)) {
    canvas.width = Math.round(width * dots);
    canvas.height = Math.round(height * dots);
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
  }
  const scale = xaxis._length / (xaxis.range[1] - xaxis.range[0]); // px per m
  const X = (x) => xaxis._offset + (x - xaxis.range[0]) * scale;
  const Y = (y) => yaxis._offset + (yaxis.range[1] - y) * scale;
  const size = Math.min(1.3, Math.max(0.75, Math.min(xaxis._length, yaxis._length) / 520));
  c.setTransform(dots, 0, 0, dots, 0, 0);
  c.clearRect(0, 0, width, height);
  c.save();
  c.beginPath();
  c.rect(xaxis._offset, yaxis._offset, xaxis._length, yaxis._length);
  c.clip();
  const disc = (x, y, radius, fill, edge, line) => {
    c.beginPath();
    c.arc(x, y, radius, 0, 2 * Math.PI);
    c.fillStyle = fill;
    c.fill();
    c.lineWidth = line;
    c.strokeStyle = edge;
    c.stroke();
  };
  const {step} = shown, {sheep, shepherds, goal, n, team} = data;
  disc(X(goal[2 * step]), Y(goal[2 * step + 1]), RECORD.goalRadius * scale, COLORS.goalFill,
    COLORS.goal, 1.6);
  if (shown.lidar !== null) paintRays(c, X, Y, data, shown);
  c.lineWidth = 2.4;
  for (let h = 0; h < team; h++) {
    c.strokeStyle = colorOf(h);
    for (let k = Math.max(1, step - RECORD.trail + 1); k <= step; k++) {
      const from = 2 * ((k - 1) * team + h), to = from + 2 * team;
      c.globalAlpha = 0.8 * (1 - (step - k) / RECORD.trail);
      c.beginPath();
      c.moveTo(X(shepherds[from]), Y(shepherds[from + 1]));
      c.lineTo(X(shepherds[to]), Y(shepherds[to + 1]));
      c.stroke();
    }
  }
  c.globalAlpha = 1;
  const radius = size * RECORD.sheepSize * 2 / 3; // pt across -> px
  let [mx, my] = [0, 0];
  for (let k = 2 * step * n; k < 2 * (step + 1) * n; k += 2) {
    disc(X(sheep[k]), Y(sheep[k + 1]), radius, COLORS.sheep, 'white', 0.22 * radius);
    mx += sheep[k] / n;
    my += sheep[k + 1] / n;
  }
  for (const [style, line, arm] of n > 1 ? [['white', 5, 8], [COLORS.ink, 2.2, 6.5]] : []) {
    c.strokeStyle = style;
    c.lineWidth = line;
    c.beginPath();
    c.moveTo(X(mx) - arm, Y(my));
    c.lineTo(X(mx) + arm, Y(my));
    c.moveTo(X(mx), Y(my) - arm);
    c.lineTo(X(mx), Y(my) + arm);
    c.stroke();
  }
  c.font = `bold ${11.5 * size}px ${FONT.family}`;
  c.textAlign = 'center';
  const seer = shown.lidar === null ? -1 : RECORD.lidar.of[shown.lidar]; // on top of all others
  const order = [...Array(team).keys()].sort((a, b) => (a === seer) - (b === seer));
  for (const h of order) {
    const k = 2 * (step * team + h), [x, y] = [X(shepherds[k]), Y(shepherds[k + 1])];
    disc(x, y, 9.5 * size, colorOf(h), h === seer ? COLORS.ink : 'white', 1.8);
    c.fillStyle = 'white';
    c.fillText(h, x, y + 4.1 * size);
  }
  c.restore();
}

function paintRays(c, X, Y, data, shown) {
  const [, count, channels, rays] = RECORD.lidar.shape, shepherd = RECORD.lidar.of[shown.lidar];
  const k = 2 * (shown.step * data.team + shepherd);
  const x = data.shepherds[k], y = data.shepherds[k + 1];
  for (const channel of shown.channels) {
    const start = ((shown.step * count + shown.lidar) * channels + channel) * rays;
    const ends = [];
    for (let ray = 0; ray < rays; ray++) {
      const whole = data.ranges[start + ray], angle = ray * RECORD.lidar.pitch;
      if (whole === FREE) continue;
      const range = whole * RECORD.lidar.step;
      ends.push([X(x + range * Math.cos(angle)), Y(y + range * Math.sin(angle))]);
    }
    c.beginPath();
    for (const end of ends) {
      c.moveTo(X(x), Y(y));
      c.lineTo(...end);
    }
    c.lineWidth = 0.8;
    c.globalAlpha = 0.45;
    c.strokeStyle = COLORS.rays[channel];
    c.stroke();
    c.globalAlpha = 1;
    c.fillStyle = COLORS.hits[channel];
    for (const end of ends) c.fillRect(end[0] - 1.2, end[1] - 1.2, 2.4, 2.4);
  }
}
