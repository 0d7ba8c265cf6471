// Tab Bags: record, list, replay one with scrubbing, and ask what another controller would have
// done.
'use strict';

const LONGEST_FRAME = 0.25; // [s] a longer pause, as of a hidden page, counts as that

class Bags {
  constructor(link, live) {
    Object.assign(this, {link, live, job: null, opened: null, tracks: [], at: 0, playing: false});
    find('record').onclick = () => this.record();
    find('refresh').onclick = () => link.tell('list_bags');
    find('live').onclick = () => this.close();
    find('scrub').oninput = ({target}) => this.show(Number(target.value));
    find('replay-play').onclick = () => this.play(!this.playing);
    find('whatif').onsubmit = (event) => {
      event.preventDefault();
      this.whatIf();
    };
    find('job').querySelector('button').onclick = () => {
      if (this.job !== null) link.tell('cancel', {job: this.job});
    };
  }

  hello({controllers}) {
    options(find('rival'), controllers ?? []);
  }

  // The jobs of a page end with its connection.
  connected() {
    this.hideJob();
    this.link.tell('list_bags');
  }

  // ---- recording ----

  async record() {
    const on = find('record').getAttribute('aria-pressed') === 'true';
    const {ok, text} = await this.link.ask(on ? 'stop_recording' : 'record');
    this.link.hear(ok ? 'said' : 'refused', ok ? text : {name: 'record', text});
  }

  hearRecording({state, bag, seconds, text}) {
    const button = find('record'),
      on = state === 'on';
    button.setAttribute('aria-pressed', on);
    button.disabled = state === 'stopping';
    const rest = String(Math.floor(seconds % 60)).padStart(2, '0');
    const time = `${Math.floor(seconds / 60)}:${rest}`;
    write(
      button.lastElementChild,
      on ? `Stop ${time}` : state === 'stopping' ? 'Stopping' : 'Record',
    );
    button.setAttribute('aria-label', on ? 'Stop recording' : 'Record');
    write(find('recorder'), on ? `Records into ${bag}.` : (text ?? ''));
    if (this.state === 'stopping' && state === 'off') this.link.tell('list_bags');
    this.state = state;
  }

  // ---- the list ----

  hearBags({bags}) {
    const list = find('list');
    list.replaceChildren();
    if (!bags.length) element('li', list, 'No recordings yet.', 'hint');
    for (const bag of bags) {
      const item = element('li', list),
        words = element('span', item, '', 'who');
      element('b', words, bag.name);
      element('span', words, bag.error || this.describe(bag));
      const open = element('button', item, 'Replay', 'wide');
      Object.assign(open, {type: 'button', disabled: Boolean(bag.error || !bag.episodes?.length)});
      open.setAttribute('aria-label', `Replay ${bag.name}`);
      if (bag.episodes?.length > 1) {
        const which = element('select', item);
        which.setAttribute('aria-label', `Episode of ${bag.name}`);
        options(which, [...bag.episodes.keys()], (k) => `episode ${bag.episodes[k].number}`);
        item.insertBefore(which, open);
        open.onclick = () => this.open(bag, Number(which.value));
      } else open.onclick = () => this.open(bag, 0);
    }
  }

  describe({size, duration, episodes, start}) {
    const when = new Date(1000 * start).toLocaleString([], {
      dateStyle: 'short',
      timeStyle: 'short',
    });
    const [first] = episodes ?? [];
    const what = first ? `${first.n_sheep} sheep, ${first.n_shepherds} shepherds, ` : '';
    return `${what}${duration.toFixed(0)} s, ${(size / 1e6).toFixed(1)} MB, ${when}`;
  }

  async open(bag, episode) {
    this.opened = {bag: bag.name, episode};
    await this.ask('replay', this.opened);
  }

  async whatIf() {
    const step = this.tracks[0].steps[this.at],
      controller = find('rival').value;
    this.play(false);
    await this.ask('counterfactual', {...this.opened, step, controller});
  }

  async ask(name, fields) {
    const {ok, text} = await this.link.ask(name, fields);
    if (!ok) this.link.hear('refused', {name, text});
  }

  // ---- jobs ----

  async hearJob({job, kind, state, done, text, result}) {
    this.job = this.newest = job;
    if (state === 'running') {
      find('job').hidden = false;
      find('job').firstElementChild.value = done;
      write(find('job').querySelector('span'), text || kind);
      return;
    }
    this.hideJob();
    if (state === 'failed') this.link.hear('refused', {name: kind, text});
    if (state !== 'done') return;
    try {
      const records = await Promise.all(
        result.tracks.map(async ({url}) => (await fetch(url)).json()),
      );
      const tracks = await Promise.all(records.map(unpackRecord));
      if (this.newest === job && this.opened) this.present(tracks, result);
    } catch (error) {
      this.link.hear('refused', {name: kind, text: `The recording could not be read (${error}).`});
    }
  }

  hideJob() {
    this.job = null;
    find('job').hidden = true;
  }

  // ---- replay ----

  present(tracks, {parting, table, tracks: named}) {
    this.tracks = tracks;
    const [first, second] = tracks,
      {live} = this;
    live.paused = true;
    live.plane.ground.fit(first.record.limits);
    live.plane.ground.paint();
    document.body.classList.add('replaying');
    find('player').hidden = find('opened').hidden = false;
    write(find('opened').firstElementChild, this.opened.bag);
    find('scrub').max = first.times.length - 1;
    find('legend').querySelector('.future').hidden = !second;
    this.showTable(table, named);
    const curves = first.record.curves;
    live.curves?.close();
    live.curves = curves.length
      ? new Curves(find('curves'), curves, (t) => this.show(nearest(first.times, t)))
      : null;
    live.curves?.set(first.times, first.curves, second);
    this.show(second ? Math.max(0, first.steps.indexOf(parting)) : 0);
    if (second) this.play(true);
  }

  showTable(table, named) {
    const box = find('futures');
    box.hidden = !table;
    box.replaceChildren();
    if (!table) return;
    const head = element('tr', element('thead', box));
    for (const words of ['', ...named.map(({name}) => name)])
      element('th', head, words).scope = 'col';
    const body = element('tbody', box);
    for (const {name, unit, values} of table) {
      const row = element('tr', body);
      const words = name.replaceAll('_', ' ') + (unit && unit !== '1' ? ` [${unit}]` : '');
      element('th', row, words).scope = 'row';
      for (const value of values)
        element('td', row, value === null ? 'none' : String(Number(value.toPrecision(4))));
    }
  }

  show(index, now = this.tracks[0].times[index]) {
    const [first, second] = this.tracks,
      {live} = this;
    if (!first) return;
    this.at = index;
    this.moment = now;
    const seen = {
      lidar:
        live.held >= 0 && first.record.lidar?.of.includes(live.held)
          ? first.record.lidar.of.indexOf(live.held)
          : null,
      channels: live.shown.channels,
    };
    const moment = momentAt(first, index, seen);
    if (!live.shown.trails) moment.trail = [];
    const k = second ? reached(second.times, first.times[index]) : -1;
    if (second && first.times[index] >= second.times[0])
      moment.other = {
        sheep: placesAt(second.sheep, second.n, k),
        shepherds: placesAt(second.shepherds, second.team, k),
      };
    live.plane.show(moment);
    live.curves?.point(index);
    const scrub = find('scrub');
    scrub.value = index;
    const clock = `${first.times[index].toFixed(1)} s, ${insideText(first, index)}`;
    write(find('replay-clock'), clock);
    scrub.setAttribute('aria-valuetext', clock);
  }

  play(on) {
    const {times} = this.tracks[0],
      last = times.length - 1,
      button = find('replay-play');
    this.playing = on && last > 0;
    button.classList.toggle('playing', this.playing);
    button.setAttribute('aria-label', this.playing ? 'Pause' : 'Play');
    if (!this.playing) return;
    if (this.at === last) this.show(0);
    let then = performance.now();
    const tick = (now) => {
      if (!this.playing || !this.tracks.length) return;
      const passed = Math.min(LONGEST_FRAME, Math.max(0, (now - then) / 1000));
      then = now;
      const moment = this.moment + Number(find('replay-speed').value) * passed,
        step = reached(times, moment);
      if (step !== this.at) this.show(step, moment);
      else this.moment = moment;
      if (step === last) this.play(false);
      else requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
  }

  // Back to what runs now.
  close() {
    const {live} = this;
    this.playing = false;
    this.tracks = [];
    this.opened = null;
    live.paused = false;
    live.limits = null;
    live.plane.ground.fitted = true;
    document.body.classList.remove('replaying');
    find('player').hidden = find('opened').hidden = true;
    find('legend').querySelector('.future').hidden = true;
    live.makeCurves();
    live.repaint();
  }
}
