// The console: one link, one plane, and the parts of the page that use both.
'use strict';

const ALERT_TIME = 8000; // [ms] that an alert stays
const MOST_ALERTS = 3;
const NARROW = matchMedia('(max-width: 899px)');

// Words that stay for a while; errors are read out at once.
function alertWith(text, level = 'bad') {
  const box = find('alerts'),
    same = [...box.children].find((item) => item.firstChild.textContent === text);
  same?.remove();
  while (box.children.length >= MOST_ALERTS) box.firstElementChild.remove();
  const item = element('p', box, '', level);
  element('span', item, text);
  const close = () => item.remove();
  iconButton(
    item,
    'Close',
    'M6.4 5 5 6.4l5.6 5.6L5 17.6 6.4 19l5.6-5.6 5.6 5.6 1.4-1.4-5.6-5.6L19 6.4 17.6 5 12 10.6z',
    close,
  );
  setTimeout(close, ALERT_TIME);
}

// ---- tabs and panel ----

const tabs = () => [...document.querySelectorAll('[role=tab]')];

function openTab(tab) {
  for (const other of tabs()) {
    const on = other === tab;
    other.setAttribute('aria-selected', on);
    other.tabIndex = on ? 0 : -1;
    find(other.getAttribute('aria-controls')).classList.toggle('open', on);
  }
}

function fold(on) {
  document.body.classList.toggle('folded', on);
  find('fold').setAttribute('aria-expanded', !on);
}

function makePanel() {
  for (const tab of tabs()) {
    tab.onclick = () => {
      const again = tab.getAttribute('aria-selected') === 'true' && NARROW.matches;
      openTab(tab);
      fold(again && !document.body.classList.contains('folded'));
    };
    tab.onkeydown = ({key}) => {
      const shown = tabs().filter((other) => other.offsetParent),
        k = shown.indexOf(tab);
      const to = {ArrowRight: k + 1, ArrowLeft: k - 1, Home: 0, End: -1}[key];
      if (to === undefined) return;
      const next = shown.at(to % shown.length);
      openTab(next);
      next.focus();
    };
  }
  openTab(find('tab-team'));
  find('fold').onclick = () => fold(!document.body.classList.contains('folded'));
  find('health').onclick = () => {
    openTab(find('tab-nodes'));
    fold(false);
  };
}

// ---- choice of metrics ----

function makeChoice(live) {
  find('choice').replaceChildren();
  for (const {name, meaning} of live.metrics) {
    const label = element('label', find('choice'), '', 'check');
    label.title = meaning;
    const box = Object.assign(element('input', label), {type: 'checkbox', value: name});
    box.checked = live.shownMetrics.some((shown) => shown.name === name);
    label.append(name.replaceAll('_', ' '));
    box.onchange = () => {
      live.chosen = [...find('choice').querySelectorAll(':checked')].map(({value}) => value);
      if (!live.paused) live.makeCurves();
    };
  }
}

// ---- start ----

const PLANE = new Plane(find('plane'));
const LIVE = new Live(PLANE);
const LINK = new Link((frame) => {
  LIVE.draw(frame);
  team.setTeam(frame.team);
});
const DRIVE = new Drive(LINK, () => {});
const team = new Team(LINK, LIVE, DRIVE);
const world = new World(LINK, LIVE);
const bags = new Bags(LINK, LIVE);
const nodes = new Nodes();

LIVE.repaint = () => {
  if (!LIVE.paused) LIVE.paint();
  else bags.show(bags.at);
};

function showLink(state, words) {
  const chip = find('link');
  chip.dataset.state = state;
  write(chip, words);
  document.body.classList.toggle('offline', state !== 'live');
}

LINK.on('live', (on) => {
  if (on) {
    showLink('live', 'Live');
    team.watch();
    bags.connected();
  } else {
    showLink('lost', 'Reconnecting');
    if (DRIVE.held >= 0) DRIVE.forget();
  }
});
LINK.on('hello', (hello) => {
  if (hello.namespace !== '/') document.title = `${hello.namespace} - Console - shepherd_ros`;
  team.hello(hello);
  bags.hello(hello);
});
LINK.on('pages', (message) => team.hearPages(message));
LINK.on('episode', (message) => {
  world.hearEpisode(message);
  team.hearEpisode(message);
});
LINK.on('world', (message) => world.hearWorld(message));
LINK.on('drivers', (message) => team.hearDrivers(message));
LINK.on('metric_names', ({metrics}) => {
  if (LIVE.paused) return;
  LIVE.setMetrics(metrics);
  if (find('choice').children.length !== metrics.length) makeChoice(LIVE);
});
LINK.on('metrics', (message) => LIVE.hearMetrics(message));
LINK.on('curves', (message) => LIVE.hearCurves(message));
LINK.on('diagnostics', (message) => nodes.hear(message));
LINK.on('recording', (message) => bags.hearRecording(message));
LINK.on('bags', (message) => bags.hearBags(message));
LINK.on('job', (message) => bags.hearJob(message));
LINK.on('value_map', (message) => team.map.hear(message));
LINK.on('refused', ({text}) => alertWith(text));
LINK.on('note', (text) => alertWith(text, 'note'));
LINK.on('hands', () => {
  if (LIVE.paused) bags.close(); // who drives sees what runs
});
LINK.on('said', (text) => write(find('said'), text));
LINK.on('lost', (reason) => {
  if (reason) alertWith(`The console closed the connection: ${reason}.`);
});

makePanel();
LINK.connect();
document.body.dataset.ready = 'yes';
