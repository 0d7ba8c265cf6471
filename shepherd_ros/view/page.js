// The replay of the record of the page: the controls, and the clock that moves plane and curves
// (see record.js, plane.js, curves.js).
'use strict';

const RECORD = JSON.parse(find('record').textContent);
const SPEEDS = [1, 2, 5].flatMap((d) => [-3, -2, -1, 0, 1, 2, 3].map((e) => Number(`${d}e${e}`)));
const WATCHED = 25; // [s] in which an episode is over at the first speed, about
const SLOWEST_FRAME = 0.25; // [s] a longer pause, as of a hidden page, counts as that

// How many decimals tell a step of time, at least 1 and at most 4.
function exact(step) {
  const enough = (n) => Math.abs(step * 10 ** n - Math.round(step * 10 ** n)) < 1e-6;
  return [1, 2, 3].find(enough) ?? 4;
}

// ---- controls ----

function makeLegend(seen, changed) {
  find('center').hidden = RECORD.sheep.shape[1] === 1;
  find('lidar').hidden = !RECORD.lidar;
  if (!RECORD.lidar) return;
  const whose = find('whose');
  whose.add(new Option('none', ''));
  RECORD.lidar.of.forEach((h, k) => whose.add(new Option(`${RECORD.words[1]} ${h}`, k)));
  whose.value = '0';
  const boxes = RECORD.lidar.names.map((name, channel) => {
    const label = element('label', find('channels'));
    const box = element('input', label);
    Object.assign(box, {type: 'checkbox', checked: true, value: channel});
    element('i', label, '', 'ray').style.background = RECORD.colors.rays[channel];
    label.append(name);
    return box;
  });
  const read = () => {
    seen.lidar = whose.value === '' ? null : Number(whose.value);
    seen.channels = boxes.filter((box) => box.checked).map((box) => Number(box.value));
    boxes.forEach((box) => {
      box.disabled = seen.lidar === null;
    });
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

function makeCurves(data, show) {
  find('panel').hidden = !data.curves.length;
  if (!data.curves.length) return null;
  const curves = new Curves(find('panel'), RECORD.curves, (t) => show(nearest(data.times, t)));
  curves.set(data.times, data.curves);
  return curves;
}

let PLANE = null;

async function start() {
  const data = await unpackRecord(RECORD),
    {times, steps} = data,
    last = times.length - 1;
  const seen = {lidar: null, channels: []};
  const scrub = find('scrub'),
    play = find('play'),
    total = steps.at(-1);
  const speed = makeSpeeds(times);
  const precision = last ? exact(times[1] - times[0]) : 1;
  let playing = false,
    at = 0,
    moment = times[0],
    then = 0,
    frame = 0;

  PLANE = new Plane(find('plane'));
  PLANE.ground.fit(RECORD.limits);
  const repaint = () => PLANE.show(momentAt(data, at, seen));
  const show = (step, now = times[step]) => {
    at = step;
    moment = now;
    scrub.value = step;
    const share = insideText(data, step);
    find('clock').textContent = `${times[step].toFixed(precision)} s`;
    find('count').textContent = `step ${steps[step]} of ${total}, ${share}`;
    scrub.setAttribute('aria-valuetext', find('clock').textContent);
    repaint();
    curves?.point(step);
  };
  const curves = makeCurves(data, show);
  const set = (on) => {
    playing = on && last > 0;
    play.classList.toggle('playing', playing);
    play.setAttribute('aria-label', playing ? 'Pause' : 'Play');
    cancelAnimationFrame(frame);
    if (playing) {
      then = performance.now();
      frame = requestAnimationFrame(tick);
    }
    show(playing && at === last ? 0 : at);
  };
  const tick = (now) => {
    const passed = Math.min(SLOWEST_FRAME, Math.max(0, (now - then) / 1000));
    then = now;
    moment += speed() * passed;
    const step = reached(times, moment);
    if (step !== at) show(step, moment);
    if (step === last) set(false);
    else frame = requestAnimationFrame(tick);
  };
  const jump = (by) => show(Math.min(last, Math.max(0, at + by)));

  scrub.max = last;
  for (const control of [scrub, play, find('back'), find('ahead')]) control.disabled = !last;
  scrub.addEventListener('input', () => show(Number(scrub.value)));
  play.addEventListener('click', () => set(!playing));
  for (const [name, by] of [
    ['back', -1],
    ['ahead', 1],
  ]) {
    find(name).addEventListener('click', () => {
      set(false);
      jump(by);
    });
  }
  listenToKeys(
    {
      ' ': () => set(!playing),
      ArrowLeft: (far) => jump(-far),
      ArrowRight: (far) => jump(far),
      Home: () => show(0),
      End: () => show(last),
    },
    () => set(false),
  );
  makeLegend(seen, repaint);
  show(0);
  document.body.dataset.ready = 'yes';
}

// Keys go to the replay, too, after a click on a control.
function listenToKeys(acts, rest) {
  let pointed = false;
  document.addEventListener('pointerdown', () => {
    pointed = true;
  });
  for (const kind of ['click', 'change']) {
    document.addEventListener(kind, ({target}) => {
      const control = kind === 'click' ? target.closest('button, [type=checkbox]') : target;
      if (pointed) control?.blur();
    });
  }
  document.addEventListener('keydown', (event) => {
    const {key, target} = event;
    pointed = false;
    if (event.ctrlKey || event.altKey || event.metaKey || target.closest('select')) return;
    if (key === ' ' && target.closest('button, [type=checkbox]')) return; // their own key
    if (!acts[key]) return;
    event.preventDefault();
    if (key !== ' ') rest();
    acts[key](event.shiftKey ? 10 : 1);
  });
}

start().catch((error) => {
  console.error(error);
  find('failure').hidden = false;
  find('failure').textContent =
    `The replay could not be started (${error}). It needs a browser of 2023 or later.`;
});
