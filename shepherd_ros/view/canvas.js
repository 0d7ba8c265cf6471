// Parts of a page, its colours, and canvases that are sharp on every screen.
'use strict';

const FAMILY = 'system-ui, -apple-system, "Segoe UI", Roboto, "DejaVu Sans", sans-serif';
const PALETTE = {};
const PAINTED = [
  'sheep',
  'other',
  'goal',
  'goal-fill',
  'ground',
  'grid',
  'frame',
  'ink',
  'faint',
  'accent',
  'warn',
  'on-shepherd',
  'shepherd-0',
  'shepherd-1',
  'shepherd-2',
  'shepherd-3',
  'shepherd-4',
];
const repainters = new Set();

const find = (id) => document.getElementById(id);
const shepherdColor = (h) => PALETTE[`shepherd-${h % 5}`];

function element(tag, parent, text = '', name = '') {
  const made = parent.appendChild(document.createElement(tag));
  made.textContent = text;
  made.className = name;
  return made;
}

// A button with a picture, a path of 24 x 24, and words for those who do not see it.
function iconButton(parent, name, path, act) {
  const button = element('button', parent);
  Object.assign(button, {type: 'button', title: name, onclick: act});
  button.setAttribute('aria-label', name);
  button.innerHTML = `<svg viewBox="0 0 24 24" aria-hidden="true"><path d="${path}"/></svg>`;
  return button;
}

function readPalette() {
  const style = getComputedStyle(document.documentElement);
  for (const name of PAINTED) PALETTE[name] = style.getPropertyValue(`--${name}`).trim();
  for (const repaint of repainters) repaint();
}

// Call when the colours change, as in the evening.
function onPalette(repaint) {
  if (!PALETTE.ink) readPalette();
  repainters.add(repaint);
}
matchMedia('(prefers-color-scheme: dark)').addEventListener('change', readPalette);

// Set the text of an element, if it is another.
function write(where, text) {
  if (where.textContent !== text) where.textContent = text;
}

// The choices of a menu; a menu that has them already is left alone.
function options(menu, values, nameOf = String) {
  const wanted = values.map((value) => `${value}\n${nameOf(value)}`).join('\n');
  if (menu.dataset.options === wanted) return;
  menu.dataset.options = wanted;
  const before = menu.value;
  menu.replaceChildren(...values.map((value) => new Option(nameOf(value), value)));
  if (values.map(String).includes(before)) menu.value = before;
}

// The context of a canvas of a size in px, empty, on a screen with dots per px.
function sized(canvas, width, height, dots) {
  const c = canvas.getContext('2d'),
    [across, down] = [width, height].map((s) => Math.round(s * dots));
  if (canvas.width !== across || canvas.height !== down) {
    canvas.width = across;
    canvas.height = down;
    canvas.style.width = `${width}px`;
    canvas.style.height = `${height}px`;
  }
  c.setTransform(dots, 0, 0, dots, 0, 0);
  c.clearRect(0, 0, width, height);
  return c;
}

// Round numbers inside a span, about so many, and how many decimals tell them apart.
function ticks(low, high, count) {
  const rough = (high - low) / Math.max(1, count),
    decade = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * decade).find((s) => s >= rough * 0.999) ?? 10 * decade;
  const numbers = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++)
    numbers.push(k * step || 0);
  return {numbers, step, decimals: Math.max(0, -Math.floor(Math.log10(step) + 1e-9))};
}

const tickText = (number, decimals) => number.toFixed(decimals).replace('-', '\u2212');
