// Tab Team: who drives each shepherd, hands on one of them, and the layers of the plane.
'use strict';

const AUTO = 'auto';
const ALL = -1;

class Team {
  constructor(link, live, drive) {
    Object.assign(this, {link, live, drive, rows: [], drivers: null, driven: {}, page: 0});
    drive.changed = () => this.showHeld();
    this.makeLayers();
    this.map = new ValueMap(link, live, () => this.seen);
    find('lock').onclick = () => {
      link.tell('lock', {locked: find('lock').getAttribute('aria-pressed') !== 'true'});
    };
    find('everyone').onchange = ({target}) => {
      if (target.value) link.tell('driver', {shepherd: ALL, source: target.value});
      target.value = '';
    };
    find('give').onclick = () => drive.release();
    find('frame').onchange = ({target}) => {
      drive.frame = target.value;
    };
    find('speed').onchange = ({target}) => {
      const speed = Number(target.value);
      this.fast = speed > 0 ? speed : null; // null: that of the world
      this.setSpeed(this.fast ?? this.speed);
    };
    find('guarded').onchange = ({target}) => {
      drive.guarded = target.checked;
      this.showHeld();
    };
  }

  // ---- messages ----

  hello({page, channels, checkpoints}) {
    this.page = page;
    options(find('critic'), checkpoints ?? []);
    if (JSON.stringify(channels) === JSON.stringify(this.live.channels)) return;
    this.live.channels = channels;
    find('channels').replaceChildren();
    channels.forEach(({name, color}) => {
      const label = element('label', find('channels'), '', 'check');
      Object.assign(element('input', label), {
        type: 'checkbox',
        checked: true,
        onchange: () => this.readLayers(),
      });
      element('i', label, '', 'ray').style.background = color;
      label.append(name);
    });
    this.readLayers();
  }

  hearDrivers(drivers) {
    this.drivers = drivers;
    this.live.sources = drivers.sources;
    find('no-mux').hidden = drivers.present;
    const locked = drivers.locked.length > 0 && drivers.locked.every(Boolean);
    find('lock').setAttribute('aria-pressed', locked);
    find('lock').disabled = !drivers.present;
    write(find('lock'), locked ? 'Let shepherds go' : 'Stop all shepherds');
    this.show();
  }

  hearPages({driven}) {
    this.driven = driven;
    const {held} = this.drive,
      mine = held >= 0 && driven[held] === this.page;
    if (held >= 0 && this.confirmed && !mine) {
      this.drive.forget();
      this.link.hear(
        'note',
        `Shepherd ${held} was given back: nothing was heard of this page in time.`,
      );
    }
    this.confirmed = mine;
    this.show();
  }

  hearEpisode({world}) {
    this.speed = world.shepherd_speed ?? 1;
    this.setSpeed(this.fast ?? this.speed);
  }

  setSpeed(speed) {
    this.drive.speed = speed;
    find('speed').value = speed;
  }

  setTeam(count) {
    if (count === this.rows.length) return;
    if (this.drive.held >= count) this.drive.release();
    find('shepherds').replaceChildren();
    this.rows = Array.from({length: count}, (_, h) => this.makeRow(h));
    const whose = find('whose'),
      before = whose.value;
    options(whose, ['none', ...Array(count).keys()], (k) => (k === 'none' ? k : `shepherd ${k}`));
    whose.value = before && before < count ? before : 'none';
    this.watch();
    this.show();
  }

  // ---- drivers ----

  makeRow(h) {
    const item = element('li', find('shepherds'));
    element('i', item, '', 'badge').style.background = `var(--shepherd-${h % 5})`;
    const words = element('span', item, '', 'who');
    element('b', words, `Shepherd ${h}`);
    const now = element('span', words);
    const choice = element('select', item);
    choice.setAttribute('aria-label', `Driver of shepherd ${h}`);
    choice.onchange = () => this.link.tell('driver', {shepherd: h, source: choice.value});
    const lock = element('button', item, '', 'stop');
    element('i', lock);
    lock.type = 'button';
    lock.onclick = () =>
      this.link.tell('lock', {shepherd: h, locked: lock.getAttribute('aria-pressed') !== 'true'});
    const hand = element('button', item, 'Drive', 'wide');
    hand.type = 'button';
    hand.onclick = () => {
      if (this.drive.held === h) return this.drive.release();
      this.link.hear('hands');
      return this.drive.take(h);
    };
    return {now, choice, lock, hand};
  }

  show() {
    const {drivers} = this;
    if (!drivers) return;
    const names = [AUTO, ...drivers.sources];
    const nameOf = (name) => this.nameOf(name);
    options(find('everyone'), ['', ...names], (name) => (name ? nameOf(name) : 'as below'));
    find('everyone').disabled = !drivers.present;
    this.rows.forEach((row, h) => {
      const source = drivers.drivers[h],
        page = this.driven[h],
        mine = page === this.page;
      const words = drivers.locked[h]
        ? 'locked'
        : page && !mine
          ? `page ${page}`
          : mine
            ? 'you'
            : (source ?? (drivers.present ? 'stands still' : 'not known'));
      write(row.now, words);
      options(row.choice, names, nameOf);
      if (document.activeElement !== row.choice) row.choice.value = drivers.selected[h] ?? AUTO;
      const locked = Boolean(drivers.locked[h]);
      row.lock.setAttribute('aria-pressed', locked);
      row.lock.title = locked ? `Let shepherd ${h} go` : `Stop shepherd ${h}`;
      row.lock.setAttribute('aria-label', row.lock.title);
      row.choice.disabled = row.hand.disabled = row.lock.disabled = !drivers.present;
    });
    this.showHeld();
  }

  nameOf(name) {
    const silent = name !== AUTO && !this.drivers.active.includes(name);
    return name + (silent ? ' (silent)' : '');
  }

  showHeld() {
    const {held} = this.drive,
      {live} = this;
    if (held !== this.before) this.confirmed = false;
    this.before = held;
    this.rows.forEach(({hand}, h) => {
      hand.setAttribute('aria-pressed', h === held);
      write(hand, h === held ? 'Give back' : 'Drive');
      hand.setAttribute('aria-label', `${hand.textContent} shepherd ${h}`);
    });
    find('driving').hidden = find('stick').hidden = held < 0;
    find('guard').hidden = held < 0 || !this.drive.guarded;
    write(find('driving').firstElementChild, `You drive shepherd ${held}`);
    document.body.classList.toggle('hands', held >= 0);
    live.held =
      held >= 0 ? held : Number(find('whose').value === 'none' ? -1 : find('whose').value);
    live.repaint();
  }

  // ---- layers ----

  makeLayers() {
    options(find('whose'), ['none']);
    find('whose').onchange = () => this.watch();
    for (const id of ['trails', 'names']) find(id).onchange = () => this.readLayers();
  }

  get seen() {
    return find('whose').value === 'none' ? -1 : Number(find('whose').value);
  }

  watch() {
    if (this.link.live) this.link.tell('watch', {shepherd: this.seen});
    if (find('valued').checked) this.map.ask();
    this.showHeld();
  }

  readLayers() {
    const boxes = [...find('channels').querySelectorAll('input')];
    this.live.shown = {
      channels: [...boxes.keys()].filter((k) => boxes[k].checked),
      trails: find('trails').checked,
      names: find('names').checked,
    };
    this.live.repaint();
  }
}
