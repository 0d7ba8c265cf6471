// Tab Nodes: the health of each node, from /diagnostics.
'use strict';

const LEVELS = ['ok', 'warn', 'error', 'stale'];

class Nodes {
  constructor() {
    this.rows = new Map();
  }

  hear({reports}) {
    const counts = {ok: 0, warn: 0, error: 0, stale: 0},
      names = new Set();
    for (const report of reports) {
      names.add(report.name);
      counts[LEVELS[report.level] ?? 'stale']++;
      this.show(report);
    }
    for (const [name, {item}] of this.rows) {
      if (names.has(name)) continue;
      item.remove();
      this.rows.delete(name);
    }
    const worst = ['error', 'stale', 'warn', 'ok'].find((level) => counts[level]) ?? 'none';
    const words = {
      error: `${counts.error} error${counts.error === 1 ? '' : 's'}`,
      stale: `${counts.stale} silent`,
      warn: `${counts.warn} warning${counts.warn === 1 ? '' : 's'}`,
      ok: 'nodes well',
      none: 'no nodes',
    };
    find('health').dataset.level = worst;
    write(find('health'), words[worst]);
  }

  show({name, level, message, values}) {
    if (!this.rows.has(name)) {
      const item = element('li', find('reports')),
        more = element('details', item);
      const summary = element('summary', more);
      const mark = element('i', summary, '', 'level');
      element('b', summary, name);
      this.rows.set(name, {
        item,
        mark,
        words: element('span', summary),
        list: element('dl', more),
        keys: '',
      });
    }
    const row = this.rows.get(name),
      word = LEVELS[level] ?? 'stale';
    row.mark.dataset.level = word;
    write(row.words, `${word === 'ok' ? '' : `${word.toUpperCase()}: `}${message}`);
    const keys = Object.keys(values).join('\n');
    if (keys !== row.keys) {
      row.keys = keys;
      row.list.replaceChildren();
      for (const key of Object.keys(values)) {
        element('dt', row.list, key);
        element('dd', row.list);
      }
    }
    const cells = row.list.querySelectorAll('dd');
    Object.values(values).forEach((value, k) => write(cells[k], value));
  }
}
