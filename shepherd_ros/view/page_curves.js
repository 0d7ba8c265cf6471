// Curves of the metrics over time, one below the other, with a cursor that moves (see page.js).
'use strict';

const ROWS = [112, 190]; // [px] least and most for a curve with its heading
const HEAD = 26, LEFT = 48, RIGHT = 12, FOOT = 40; // [px] of the curves

// Lowest and highest of the axis of a curve; a share has the whole of [0, 1].
function span(values, unit) {
  const finite = values.filter(Number.isFinite);
  let low = finite.reduce((a, b) => Math.min(a, b), Infinity);
  let high = finite.reduce((a, b) => Math.max(a, b), -Infinity);
  if (!finite.length || (!unit && low >= 0 && high <= 1)) [low, high] = [0, 1];
  if (low > 0 && low < 0.5 * high) low = 0;
  const room = 0.08 * (high - low) || 0.1 * Math.abs(high) || 1;
  return [low - room, high + room];
}

// How many decimals numbers up to a size are told with.
function decimals(size) {
  const before = Math.floor(Math.log10(size)) + 1; // digits before the point
  return before > 0 ? Math.max(0, Math.min(2, 4 - before)) : Math.min(9, 3 - before);
}

// How many decimals tell a step of time, at least 1 and at most 4.
function exact(step) {
  const enough = (n) => Math.abs(step * 10 ** n - Math.round(step * 10 ** n)) < 1e-6;
  return [1, 2, 3].find(enough) ?? 4;
}

async function makeCurves(data, go) {
  const box = find('curves'), panel = find('panel');
  const {times, curves} = data, count = curves.length;
  if (!count) {
    panel.hidden = true;
    return () => {};
  }
  const end = times.at(-1) > times[0] ? times.at(-1) : times[0] + 1;
  const room = WIDE ? (find('side').clientHeight - find('notes').clientHeight - 80) / count : 0;
  const row = Math.min(ROWS[1], Math.max(ROWS[0], Math.floor(room)));
  const height = count * row + FOOT, inner = row - HEAD;
  const spans = curves.map((values, i) => span(values, RECORD.curves[i].unit));
  const layout = {
    height, margin: {l: LEFT, r: RIGHT, t: HEAD, b: FOOT}, showlegend: false,
    hovermode: 'x', dragmode: false, font: FONT, paper_bgcolor: 'rgba(0,0,0,0)',
    plot_bgcolor: 'rgba(0,0,0,0)',
    xaxis: {
      range: [times[0], end], fixedrange: true, gridcolor: COLORS.grid, zeroline: false,
      title: {text: 'time [s]', font: FONT, standoff: 6}, nticks: 6,
      anchor: count > 1 ? `y${count}` : 'y',
    },
  };
  const area = height - HEAD - FOOT; // [px] between the margins
  const top = (i) => HEAD + i * row; // [px] of a curve's plot
  const traces = curves.map((values, i) => {
    const from = 1 - (i * row + inner) / area, name = i ? `y${i + 1}` : 'y';
    layout[`yaxis${i ? i + 1 : ''}`] = {
      domain: [Math.max(0, from), 1 - i * row / area], range: spans[i], fixedrange: true,
      nticks: 4, gridcolor: COLORS.grid, zeroline: false, automargin: false,
      ticks: 'outside', ticklen: 5, tickcolor: 'rgba(0,0,0,0)',
    };
    const {name: words, unit} = RECORD.curves[i];
    return {
      x: times, y: values, yaxis: name, mode: times.length > 1 ? 'lines' : 'markers',
      name: words, line: {color: COLORS.sheep, width: 2}, connectgaps: false,
      hovertemplate: `%{y:.4~g} ${unit}<extra></extra>`,
    };
  });
  await Plotly.newPlot(box, traces, layout, {displayModeBar: false});
  new ResizeObserver(() => Plotly.Plots.resize(box)).observe(panel);
  const cursors = curves.map(() => element('div', panel, '', 'cursor'));
  const marks = curves.map(() => element('div', panel, '', 'mark'));
  cursors.forEach((cursor, i) => {
    Object.assign(cursor.style, {top: `${top(i)}px`, height: `${inner}px`});
  });
  const values = RECORD.curves.map(({name, unit}, i) => {
    const heading = element('h2', panel, unit ? `${name} [${unit}]` : name);
    Object.assign(heading.style, {
      left: `${LEFT}px`, right: `${RIGHT}px`, top: `${top(i) - HEAD + 6}px`,
    });
    return element('span', heading);
  });
  const whole = (value) => Number.isNaN(value) || Number.isInteger(value);
  const digits = spans.map(([low, high], i) =>
    curves[i].every(whole) ? 0 : decimals(Math.max(-low, high)));
  const width = () => box.clientWidth - LEFT - RIGHT;
  const seek = (event) => {
    const part = (event.clientX - box.getBoundingClientRect().left - LEFT) / width();
    go(nearest(times, times[0] + part * (end - times[0])));
  };
  panel.addEventListener('pointerdown', seek);
  panel.addEventListener('pointermove', (event) => { if (event.buttons & 1) seek(event); });
  return (step) => {
    const x = LEFT + width() * (times[step] - times[0]) / (end - times[0]);
    curves.forEach((curve, i) => {
      const value = curve[step], [low, high] = spans[i];
      marks[i].hidden = !Number.isFinite(value);
      cursors[i].style.left = marks[i].style.left = `${x}px`;
      marks[i].style.top = `${top(i) + inner * (high - value) / (high - low)}px`;
      values[i].textContent = Number.isFinite(value) ? value.toFixed(digits[i]) : 'none';
    });
  };
}
