// The parts of the page as the server sends them.
const S = {run: {}, now: {}, channels: [], trials: null, coefficients: [], log: [], loops: [], list: [], values: {}};
const bars = new Map();

function partRun(run) {
  const before = S.run;
  S.run = run;
  if (before.id && before.id !== run.id) { clear(); loop = {number: 0, points: []}; bars.clear(); $('numbers').replaceChildren(); }
  axes = run.axes || [];
  show('simulated', !!run.simulated);
  put('kind', run.kind || 'pmabench');
  put('specimen', run.specimen || '');
  const status = run.there ? run.status : 'waiting';
  put('status', status + (run.vent ? `, vent ${run.vent}` : ''));
  const bad = !['running', 'finished', 'waiting'].includes(status) || (run.vent && run.vent !== 'confirmed');
  $('status').className = `pill ${bad ? 'bad' : status}`;
  const why = $('why'), texts = [];
  if (run.problem) texts.push(run.problem);
  if (run.why && run.why !== run.status) texts.push(run.why);
  if (run.reading) texts.push('reading the record …');
  why.replaceChildren(texts.join('; '));
  if (run.next) why.append(texts.length ? '. Next: ' : 'Next: ', make('code', '', run.next));
  why.className = `notice ${bad && status !== 'failed' ? 'doubt' : run.next ? 'good' : ''}`;
  why.hidden = !why.textContent;
  show('vent', !!run.may_vent);
  crumbs(run);
  title();
}

function crumbs(run) {
  const parts = [['newest', '/']];
  if (run.session) parts.push([`session ${run.session}`, `/session/${run.session}`]);
  if (run.campaign) parts.push([`campaign ${run.campaign}`, `/campaign/${encodeURIComponent(run.campaign)}`]);
  if (run.id) parts.push([`run ${run.id}`, `/run/${encodeURIComponent(run.id)}`]);
  const nodes = [];
  for (const [text, href] of parts) {
    if (nodes.length) nodes.push(' › ');
    nodes.push(linkTo(text, href));
  }
  $('crumbs').replaceChildren(...nodes);
}

function linkTo(text, href) {
  const a = make('a', '', text);
  a.href = href;
  if (location.pathname === href) aria(a, 'current', 'page');
  on(a, 'click', event => {
    if (event.ctrlKey || event.metaKey || event.shiftKey || event.button) return;
    event.preventDefault();
    go(href);
  });
  return a;
}

function title() {
  const {now, run} = S, of = now.of;
  document.title = !run.there ? 'pmabench: waiting' : run.status !== 'running' ? `${run.status} · pmabench`
    : of ? `trial ${now.number}/${of} · pmabench` : `${run.kind} · pmabench`;
}

function partNow(now) {
  S.now = now;
  put('trial', now.trial);
  put('point', now.point + (now.repeat ? `, repeat ${now.repeat}` : ''));
  put('doing', now.doing);
  const parts = [`${clock(now.elapsed)} elapsed`];
  if (now.left !== null) {
    parts.push(`by the plan ${clock(now.left)} left`);
    if (!now.paused) parts.push(`ends about ${at(new Date(Date.now() + 1000 * now.left))}`);
  }
  put('time', S.run.there === false ? '' : parts.join(', '));
  $('bar').firstElementChild.style.width = `${100 * now.done}%`;
  aria($('bar'), 'valuenow', Math.round(100 * now.done));
  const asked = $('asked');
  asked.hidden = !now.asked;
  if (now.asked) put('asked', `${now.asked}  (measured pressure ${pressureText()}; answered at the terminal of the run)`);
  const flags = Object.entries(now.flagged).map(([name, n]) => `${name} ${n}`);
  put('rows', `${now.rows.toLocaleString('en').replaceAll(',', '\u2009')} rows${now.rate ? ` at ${now.rate} Hz` : ''}${flags.length ? `; flagged: ${flags.join(', ')}` : ''}. `
    + (now.commanded.length ? `Commanded: ${now.commanded.join(', ')}. ` : ''));
  title();
}

function pressureText() {
  const v = S.values.pressure, c = channels.find(p => p.name === 'pressure');
  return v && c && v[3] !== null && v[3] < 3 ? `${number(v[0], c.digits)} ${c.unit}` : 'not known at this moment';
}

function partChannels(list) {
  const same = JSON.stringify(list.map(c => c.name)) === JSON.stringify(channels.map(c => c.name));
  channels = S.channels = list;
  if (!same || plots.size === 0) {
    bars.clear();
    $('numbers').replaceChildren(...list.slice(0, 4).map(numberBox));
    $('channels').tBodies[0].replaceChildren(...list.map(channelRow));
  }
  buildPlots();
}

function numberBox(c) {
  const box = make('div', 'number'), label = make('div', 'label'), value = make('b', '', '–');
  box.style.setProperty('--c', `var(--${colourOf(c.name)})`);
  const seen = make('span', 'seen');
  label.append(make('span', '', c.symbol && c.symbol !== c.label ? `${c.symbol}  ${c.label}` : c.label), seen);
  box.append(label, value, make('span', 'quiet', ` ${c.unit}`), limitBar(c));
  bars.set(c.name, {box, value, seen, bar: box.lastChild});
  return box;
}

function limitBar(c) {
  const bar = make('div', 'limit'), [low, high] = c.axis;
  bar.append(make('i'));
  const place = (v, name) => {
    if (v === null || v <= low || v >= high) return;
    const u = make('u', name);
    u.style.left = `${100 * (v - low) / (high - low)}%`;
    bar.append(u);
  };
  for (const v of c.command) place(v, '');
  for (const v of c.trip) place(v, 'trip');
  const words = [c.trip[1] !== null ? `trip at ${c.trip[1]} ${c.unit}` : '', c.command[1] !== null ? `commanded at most ${c.command[1]} ${c.unit}` : ''];
  bar.title = words.filter(Boolean).join(', ') || 'no limit';
  return bar;
}

function channelRow(c) {
  const row = make('tr'), name = make('td', '', c.label), value = make('td'), seen = make('td', 'quiet'), cell = make('td');
  const button = make('button', '', 'curve');
  aria(button, 'pressed', chosen().includes(c.name));
  aria(button, 'label', `curve of ${c.label}`);
  on(button, 'click', () => {
    const now = chosen(), next = now.includes(c.name) ? now.filter(n => n !== c.name) : [...now, c.name];
    remember('curves', next.join(' '));
    aria(button, 'pressed', next.includes(c.name));
    buildPlots();
  });
  cell.append(button);
  row.append(name, value, seen, cell);
  bars.set(`row ${c.name}`, {value, seen});
  return row;
}

function partValues(values) {
  S.values = values;
  const recording = S.now.recording;
  for (const c of channels) {
    const [v, least, most, age, alarm] = values[c.name] || [null, null, null, null, 0];
    const range = least === null ? '' : `${number(least, c.digits)} … ${number(most, c.digits)}`;
    const row = bars.get(`row ${c.name}`);
    if (row) { row.value.textContent = `${number(v, c.digits)} ${c.unit}`; row.seen.textContent = range; }
    const b = bars.get(c.name);
    if (!b) continue;
    const old = recording && age !== null && age > 1;
    b.value.textContent = number(v, c.digits);
    b.seen.className = old || alarm ? 'seen' : 'seen range';
    b.seen.textContent = old ? `${age.toFixed(1)} s old` : alarm === 2 ? '‼ at its limit' : alarm === 1 ? '! near its limit' : range;
    b.box.className = `number${old ? ' old' : ''}${alarm === 2 ? ' over' : alarm === 1 ? ' near' : ''}`;
    const [low, high] = c.axis, share = x => Math.max(0, Math.min(1, (x - low) / (high - low)));
    const [from, to] = [share(0), v === null ? share(0) : share(v)].sort((x, y) => x - y);
    b.bar.firstChild.style.left = `${100 * from}%`;
    b.bar.firstChild.style.width = `${100 * (to - from)}%`;
  }
}

function partTrials(table) {
  S.trials = table;
  show('trials-part', table.rows.length > 0);
  const doubtful = table.rows.filter(r => !r.ok).length;
  put('trials-count', `${table.rows.length}${S.now.of ? ` of ${S.now.of}` : ''}${doubtful ? `, ${doubtful} in doubt` : ''}`);
  const head = make('tr');
  head.append(make('th', '', 'trial'), ...[...table.point, ...table.numbers].map(c => make('th', '', c.unit ? `${c.symbol} [${c.unit}]` : c.symbol)));
  $('trials').tHead.replaceChildren(head);
  const rows = [];
  for (const r of [...table.rows].reverse()) {
    const row = make('tr');
    row.append(make('td', '', `${r.mark} ${r.trial}${r.again ? ' again' : ''}`), ...r.point.map(text => make('td', '', text)));
    for (const [text, off] of r.numbers) { const cell = make('td', '', text); if (off) cell.append(make('small', '', off)); row.append(cell); }
    rows.push(row);
    if (r.doubts.length) {
      const why = make('tr'), cell = make('td', 'why', r.doubts.join('; '));
      cell.colSpan = 1 + table.point.length + table.numbers.length;
      why.append(cell);
      rows.push(why);
    }
  }
  $('trials').tBodies[0].replaceChildren(...rows);
  put('trials-note', [table.against ? `% against ${table.against}` : '', table.assumed ? '* depends on the specimen file' : ''].filter(Boolean).join('; '));
  describe(S.values);
}

function partLog(log) {
  marks = log.filter(([t, , level]) => t !== null && level === 'fault').map(([t, text]) => [t, text]);
  $('log').replaceChildren(...[...log].reverse().map(([t, text, level]) => {
    const item = make('li');
    item.append(make('time', '', t === null ? '' : fine(t)), make('span', level, text));
    return item;
  }));
}

function partList(list) {
  show('list-part', list.length > 1);
  const one = list[0];
  if (one) put('list-title', one.campaign && list.every(r => r.campaign === one.campaign) ? `Campaign ${one.campaign}` : `Runs of ${one.session}`);
  $('list').replaceChildren(...list.map(r => {
    const item = make('li');
    if (r.id === S.run.id) aria(item, 'current', 'true');
    item.append(make('span', 'quiet', at(new Date(r.started))), linkTo(r.kind || r.id, `/run/${encodeURIComponent(r.id)}`), make('span', '', r.status));
    return item;
  }));
}
