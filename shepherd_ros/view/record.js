// The record of an episode: its numbers unpacked, and the moments that a plane shows.
'use strict';

const FREE = 65535;
const TYPES = {
  uint16: Uint16Array,
  int32: Int32Array,
  float32: Float32Array,
  float64: Float64Array,
};

// Numbers that were packed: base64, zlib, then little-endian numbers of a type.
async function unpack(pack) {
  const text = atob(pack.data),
    bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new TYPES[pack.type](await new Response(stream).arrayBuffer());
}

// Coordinates that were rounded, as x0, y0, x1, y1, ...
async function places(pack) {
  const codes = await unpack(pack),
    metres = new Float64Array(codes.length);
  for (let k = 0; k < codes.length; k++) metres[k] = pack.low + pack.step * codes[k];
  return metres;
}

// The numbers of a record; the record itself has what is the same at all times.
async function unpackRecord(record) {
  const names = ['times', 'steps', 'goal', 'inGoal'];
  const [times, steps, goal, inGoal] = await Promise.all(names.map((n) => unpack(record[n])));
  const sheep = await places(record.sheep),
    shepherds = await places(record.shepherds);
  const curves = await Promise.all(record.curves.map(unpack));
  const ranges = record.lidar && (await unpack(record.lidar));
  const n = record.sheep.shape[1],
    team = record.shepherds.shape[1];
  return {record, times, steps, goal, inGoal, sheep, shepherds, curves, ranges, n, team};
}

// Who is in the goal at a step, in words: a share of a flock, or breaches so far.
function insideText(data, step) {
  const {record, inGoal, n} = data;
  if (record.words[0] === 'sheep') return `${Math.floor((100 * inGoal[step]) / n)} % in the goal`;
  const breaches = inGoal.subarray(0, step + 1).reduce((sum, one) => sum + (one > 0), 0);
  return `${breaches} steps with a breach`;
}

const placesAt = (flat, count, step) => flat.subarray(2 * step * count, 2 * (step + 1) * count);

// The moment of a step for the plane; seen says whose lidar and which channels.
function momentAt(data, step, seen) {
  const {record, sheep, shepherds, goal, n, team} = data,
    first = Math.max(0, step - record.trail);
  const trail = [];
  for (let k = first; k <= step; k++) trail.push(placesAt(shepherds, team, k));
  return {
    sheep: placesAt(sheep, n, step),
    shepherds: trail.at(-1),
    trail,
    goal: placesAt(goal, 1, step),
    goalRadius: record.goalRadius,
    rays: seen.lidar === null ? null : raysAt(data, step, seen),
    held: seen.lidar === null ? [] : [record.lidar.of[seen.lidar]],
  };
}

function raysAt(data, step, seen) {
  const {record} = data;
  const [, count, channels, rays] = record.lidar.shape,
    h = record.lidar.of[seen.lidar];
  const [x, y] = placesAt(data.shepherds, data.team, step).subarray(2 * h);
  const ranges = (channel) => {
    const start = ((step * count + seen.lidar) * channels + channel) * rays;
    const metres = (code) => (code === FREE ? Infinity : code * record.lidar.step);
    return Array.from(data.ranges.subarray(start, start + rays), metres);
  };
  const shown = seen.channels.map((channel) => ({
    ranges: ranges(channel),
    color: record.colors.rays[channel],
    hit: record.colors.hits[channel],
  }));
  return {x, y, pitch: record.lidar.pitch, channels: shown};
}
