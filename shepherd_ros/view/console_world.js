// The world: start, pause, step, reset and speed; what the next episode is set to; the goal, which
// can be dragged.
'use strict';

const RATES = [0, 1, 2, 5, 10, 20, 50, 100, 200];
const GRAB = {mouse: 8, pen: 12, touch: 22}; // [px] from the rim of the goal
const NUDGE = 0.5; // [m] by an arrow key on the plane

class World {
  constructor(link, live) {
    Object.assign(this, {link, live, paused: null, fields: new Map(), settings: null});
    find('go').onclick = () => this.toggle();
    find('step').onclick = () => link.tell('step', {steps: 1});
    find('reset').onclick = () => this.reset();
    find('seed').onkeydown = ({key}) => {
      if (key === 'Enter') this.reset();
    };
    options(find('rate'), RATES, (rate) => (rate ? `${rate} steps/s` : 'auto'));
    find('rate').onchange = ({target}) => link.tell('rate', {rate: Number(target.value)});
    find('settings').onsubmit = (event) => {
      event.preventDefault();
      this.apply(event.submitter?.name === 'reset');
    };
    live.plane.ground.grab = (x, y, kind) => this.grabGoal(x, y, kind);
    find('plane').addEventListener('keydown', (event) => this.nudge(event));
    find('plane').addEventListener('pointermove', (event) => this.hint(event));
  }

  toggle() {
    this.link.tell(this.paused ? 'resume' : 'pause');
  }

  async reset() {
    const text = find('seed').value.trim();
    const seed = text === '' ? {} : {seed: Number(text)};
    const {ok, text: words} = await this.link.ask('reset', seed);
    if (!ok) return this.link.hear('refused', {name: 'reset', text: words});
    find('seed').value = '';
    return this.link.hear('said', words);
  }

  // ---- messages ----

  hearEpisode({number, seed, n_sheep, n_shepherds, goal_radius, mode, world}) {
    this.live.dt = world.dt;
    write(
      find('facts'),
      `Episode ${number}, seed ${seed}: ${n_sheep} sheep, ${n_shepherds} ` +
        `shepherd${n_shepherds === 1 ? '' : 's'}`,
    );
    const about = {
      number,
      seed,
      sheep: n_sheep,
      shepherds: n_shepherds,
      'goal radius': `${goal_radius} m`,
      mode,
      flock: world.flock?.model,
      'time of a step': `${world.dt} s`,
      steps: world.episode_steps,
    };
    find('about').replaceChildren();
    for (const [name, value] of Object.entries(about)) {
      if (value === '' || value === undefined) continue;
      element('dt', find('about'), name);
      element('dd', find('about'), String(value));
    }
  }

  hearWorld({present, paused, rate, settings}) {
    this.paused = paused;
    this.present = present;
    const go = find('go');
    go.classList.toggle('playing', paused === false);
    go.setAttribute('aria-label', paused ? 'Start' : 'Pause');
    go.title = paused ? 'Start' : 'Pause';
    for (const id of ['go', 'step', 'reset', 'rate', 'seed']) find(id).disabled = !present;
    const menu = find('rate');
    if (!RATES.includes(rate))
      options(menu, [...RATES, rate], (r) => (r ? `${r} steps/s` : 'auto'));
    if (document.activeElement !== menu) menu.value = rate;
    this.showSettings(settings ?? {});
  }

  // ---- the next episode ----

  showSettings(settings) {
    const names = Object.keys(settings);
    if (names.join() !== [...this.fields.keys()].join()) this.makeFields(settings);
    for (const name of names) {
      const field = this.fields.get(name),
        before = field.known;
      field.known = settings[name].value;
      if (field.input.value === String(before) || before === undefined)
        field.input.value = field.known;
    }
  }

  makeFields(settings) {
    const form = find('settings');
    form.replaceChildren();
    this.fields.clear();
    for (const [name, {type, doc, low, high, choices}] of Object.entries(settings)) {
      const label = element('label', form, '', 'setting');
      element('span', label, name.replace(/^n_/, '').replaceAll('_', ' '));
      const input = element(choices ? 'select' : 'input', label);
      if (choices) options(input, choices);
      else
        Object.assign(input, {
          type: 'number',
          min: low,
          max: high,
          step: type === 'int' ? 1 : 'any',
        });
      input.name = name;
      label.title = doc ?? '';
      this.fields.set(name, {input, type, known: undefined});
    }
    if (!this.fields.size) {
      element('p', form, 'No flock_sim answers in this namespace.', 'hint');
      return;
    }
    const row = element('div', form, '', 'row');
    for (const [name, text, style] of [
      ['reset', 'Apply and reset', 'wide main'],
      ['later', 'Apply', 'wide'],
    ])
      Object.assign(element('button', row, text, style), {name, type: 'submit'});
  }

  async apply(reset) {
    const values = {};
    for (const [name, {input, type, known}] of this.fields) {
      if (input.value === String(known)) continue;
      const number = ['int', 'float'].includes(type);
      values[name] = number ? Number(input.value) : input.value;
    }
    if (Object.keys(values).length) {
      const {ok, text} = await this.link.ask('settings', {values});
      this.link.hear(ok ? 'said' : 'refused', ok ? text : {name: 'settings', text});
      if (!ok) return;
    }
    if (reset) await this.reset();
  }

  // ---- the goal ----

  // Whether the rim of the goal, or its middle, is at a place.
  atGoal(x, y, kind) {
    const {frame, plane, paused} = this.live;
    if (!frame || paused || !this.present) return false;
    const away = Math.hypot(x - frame.goal[0], y - frame.goal[1]) * plane.ground.scale;
    const rim = frame.goalRadius * plane.ground.scale;
    return Math.abs(away - rim) < GRAB[kind] || away < Math.min(GRAB[kind] * 1.5, rim / 2);
  }

  grabGoal(x, y, kind) {
    if (!this.atGoal(x, y, kind)) return null;
    const {live} = this,
      [gx, gy] = live.frame.goal;
    return {
      move: (nx, ny) => {
        live.goal = [gx + nx - x, gy + ny - y];
        live.repaint();
      },
      drop: async (dropped) => {
        const {goal} = live;
        if (goal && dropped) {
          const {ok, text} = await this.link.ask('goal', {x: goal[0], y: goal[1]});
          this.link.hear(ok ? 'said' : 'refused', ok ? text : {name: 'goal', text});
        }
        live.goal = null;
        live.repaint();
      },
    };
  }

  hint({offsetX, offsetY, pointerType, buttons}) {
    if (buttons || pointerType !== 'mouse') return;
    const place = this.live.plane.ground.place(offsetX, offsetY);
    find('plane').classList.toggle('grabs', this.atGoal(...place, 'mouse'));
  }

  // Keys on the plane: + - 0 for the view, shift with arrows for the goal.
  nudge(event) {
    const {plane, frame, paused} = this.live,
      {ground} = plane,
      step = 60;
    const views = {
      '+': () => ground.zoom(ZOOM),
      '=': () => ground.zoom(ZOOM),
      '-': () => ground.zoom(1 / ZOOM),
      0: () => ground.reset(),
    };
    const arrows = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1]};
    const arrow = arrows[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (views[event.key]) views[event.key]();
    else if (arrow && document.body.classList.contains('hands')) return;
    else if (arrow && event.shiftKey && frame && !paused) {
      const [x, y] = [frame.goal[0] + NUDGE * arrow[0], frame.goal[1] + NUDGE * arrow[1]];
      this.link.tell('goal', {x, y});
    } else if (arrow) ground.pan(-step * arrow[0], step * arrow[1]);
    else return;
    event.preventDefault();
  }
}
