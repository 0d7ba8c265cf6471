// The controls, and the clock that moves plane and curves (see page_plane.js, page_curves.js).
'use strict';

const SPEEDS = [1, 2, 5].flatMap((d) => [-3, -2, -1, 0, 1, 2, 3].map((e) => Number(`${d}e${e}`)));
const WATCHED = 25; // [s] in which an episode is over at the first speed, about
const SLOWEST_FRAME = 0.25; // [s] a longer pause, as of a hidden page, counts as that

// ---- time ----

// The index of the last time that is not after a moment, at least 0.
function reached(times, moment) {
  let [low, high] = [0, times.length];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= moment) low = middle; else high = middle;
  }
  return low;
}

function nearest(times, moment) {
  const k = reached(times, moment);
  return k + 1 < times.length && times[k + 1] - moment < moment - times[k] ? k + 1 : k;
}

// ---- controls ----

function makeLegend(shown, changed) {
  for (const mark of document.querySelectorAll('[data-color]')) {
    const color = COLORS[mark.dataset.color];
    mark.style.background = Array.isArray(color) ? color[0] : color;
    if (mark.dataset.edge) mark.style.borderColor = COLORS[mark.dataset.edge];
  }
  find('center').hidden = RECORD.sheep.shape[1] === 1;
  find('lidar').hidden = !RECORD.lidar;
  if (!RECORD.lidar) return;
  const whose = find('whose');
  whose.add(new Option('none', ''));
  RECORD.lidar.of.forEach((h, k) => whose.add(new Option(`shepherd ${h}`, k)));
  whose.value = '0';
  const boxes = RECORD.lidar.names.map((name, channel) => {
    const label = element('label', find('channels'));
    const box = element('input', label);
    Object.assign(box, {type: 'checkbox', checked: true, value: channel});
    element('i', label, '', 'ray').style.background = COLORS.rays[channel];
    label.append(name);
    return box;
  });
  const read = () => {
    shown.lidar = whose.value === '' ? null : Number(whose.value);
    shown.channels = boxes.filter((box) => box.checked).map((box) => Number(box.value));
    boxes.forEach((box) => { box.disabled = shown.lidar === null; });
    changed();
  };
  find('lidar').addEventListener('change', read);
  read();
}

// The choices of speed, in seconds of the episode per second of watching.
function makeSpeeds(times) {
  const right = times.length > 1 ? (times.at(-1) - times[0]) / WATCHED : 1;
  const sorted = SPEEDS.sort((a, b) => a - b);
  const away = (speed) => Math.abs(Math.log(speed / right));
  const first = sorted.reduce((best, speed) => (away(speed) < away(best) ? speed : best));
  const menu = find('speed');
  for (const speed of sorted) {
    if (speed === 1 || (speed >= first / 20.1 && speed <= first * 10.1))
      menu.add(new Option(`${speed}\u00d7`, speed, false, speed === first));
  }
  return () => Number(menu.value);
}

async function start() {
  const data = await load(), {times, steps, inGoal, n} = data, last = times.length - 1;
  const shown = {step: 0, lidar: null, channels: []};
  const scrub = find('scrub'), play = find('play'), total = steps.at(-1);
  const speed = makeSpeeds(times);
  const precision = last ? exact(times[1] - times[0]) : 1;
  let playing = false, moment = times[0], then = 0, frame = 0;

  const plane = await makePlane(data, shown);
  const moveCursor = await makeCurves(data, (step) => show(step));
  const show = (step, now = times[step]) => {
    shown.step = step;
    moment = now;
    scrub.value = step;
    const share = `${Math.floor(100 * inGoal[step] / n)} % in the goal`;
    find('clock').textContent = `${times[step].toFixed(precision)} s`;
    find('count').textContent = `step ${steps[step]} of ${total}, ${share}`;
    scrub.setAttribute('aria-valuetext', find('clock').textContent);
    plane.repaint();
    plane.follow(!playing);
    moveCursor(step);
  };
  const set = (on) => {
    playing = on && last > 0;
    play.classList.toggle('playing', playing);
    play.setAttribute('aria-label', playing ? 'Pause' : 'Play');
    cancelAnimationFrame(frame);
    if (playing) {
      then = performance.now();
      frame = requestAnimationFrame(tick);
    }
    show(playing && shown.step === last ? 0 : shown.step);
  };
  const tick = (now) => {
    const passed = Math.min(SLOWEST_FRAME, Math.max(0, (now - then) / 1000));
    then = now;
    moment += speed() * passed;
    const step = reached(times, moment);
    if (step !== shown.step) show(step, moment);
    if (step === last) set(false); else frame = requestAnimationFrame(tick);
  };
  const jump = (by) => show(Math.min(last, Math.max(0, shown.step + by)));

  scrub.max = last;
  for (const control of [scrub, play, find('back'), find('ahead')]) control.disabled = !last;
  scrub.addEventListener('input', () => show(Number(scrub.value)));
  play.addEventListener('click', () => set(!playing));
  for (const [name, by] of [['back', -1], ['ahead', 1]]) {
    find(name).addEventListener('click', () => { set(false); jump(by); });
  }
  let pointed = false; // keys go to the replay after a click
  document.addEventListener('pointerdown', () => { pointed = true; });
  for (const kind of ['click', 'change']) {
    document.addEventListener(kind, ({target}) => {
      const control = kind === 'click' ? target.closest('button, [type=checkbox]') : target;
      if (pointed) control?.blur();
    });
  }
  document.addEventListener('keydown', (event) => {
    const far = event.shiftKey ? 10 : 1, {key, target} = event;
    pointed = false;
    if (event.ctrlKey || event.altKey || event.metaKey || target.closest('select')) return;
    if (key === ' ' && target.closest('button, [type=checkbox]')) return; // their own key
    const acts = {
      ' ': () => set(!playing), ArrowLeft: () => jump(-far), ArrowRight: () => jump(far),
      Home: () => show(0), End: () => show(last),
    };
    if (!acts[key]) return;
    event.preventDefault();
    if (key !== ' ') set(false);
    acts[key]();
  });
  new ResizeObserver(() => moveCursor(shown.step)).observe(find('panel'));
  makeLegend(shown, plane.repaint);
  show(0);
  document.body.dataset.ready = 'yes';
}

start().catch((error) => {
  console.error(error);
  find('failure').hidden = false;
  find('failure').textContent = `The replay could not be started (${error}). It needs a browser of 2023 or later.`;
});
