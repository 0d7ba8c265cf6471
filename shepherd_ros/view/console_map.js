// The value map: what the critic of a checkpoint expects with a shepherd at each place.
'use strict';

class ValueMap {
  // shepherd() says whose places are asked for.
  constructor(link, live, shepherd) {
    Object.assign(this, {link, live, shepherd});
    for (const id of ['valued', 'critic']) find(id).onchange = () => this.ask();
  }

  ask() {
    const on = find('valued').checked;
    const of = {checkpoint: find('critic').value, shepherd: Math.max(0, this.shepherd())};
    this.link.tell('value_map', {on, ...(on ? of : {})});
  }

  // The values of places as a picture, pale to strong, over their part of the plane.
  hear({on, text, values, x, y, shepherd}) {
    find('valued').checked = on;
    let words = on ? text || 'Computing.' : '';
    this.live.map = null;
    if (on && values) {
      const flat = values.flat(),
        low = Math.min(...flat),
        high = Math.max(...flat);
      this.live.map = {image: mapImage(values, low, high), limits: [...x, ...y]};
      words =
        text ||
        `What the critic expects with shepherd ${shepherd} there: ` +
          `${low.toPrecision(3)} (dark) to ${high.toPrecision(3)} (bright).`;
    }
    write(find('map-text'), words);
    this.live.repaint();
  }
}

// Colours of viridis, low to high.
const VIRIDIS = [
  [68, 1, 84],
  [59, 82, 139],
  [33, 145, 140],
  [94, 201, 98],
  [253, 231, 37],
];

function mapImage(values, low, high) {
  const image = document.createElement('canvas'),
    rows = values.length,
    columns = values[0].length;
  Object.assign(image, {width: columns, height: rows});
  const c = image.getContext('2d'),
    pixels = c.createImageData(columns, rows);
  values.forEach((row, k) =>
    row.forEach((value, i) => {
      const place = ((value - low) / (high - low || 1)) * (VIRIDIS.length - 1);
      const from = Math.min(VIRIDIS.length - 2, Math.floor(place)),
        part = place - from;
      const at = 4 * ((rows - 1 - k) * columns + i);
      for (let j = 0; j < 3; j++)
        pixels.data[at + j] = VIRIDIS[from][j] * (1 - part) + VIRIDIS[from + 1][j] * part;
      pixels.data[at + 3] = 255;
    }),
  );
  c.putImageData(pixels, 0, 0);
  return image;
}
