// Curves over time: buckets of least and greatest values, and the plots that show them.
const FINE = 0.02, SPANS = [['30 s', 30], ['2 min', 120], ['10 min', 600], ['1 h', 3600], ['All', Infinity]];
const TICKS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 43200];
const view = {follow: true, span: 30, begin: 0, end: 30, limits: false};
const store = {width: FINE, first: 0, last: 0, streams: {}, ring: []};
const plots = new Map();
let marks = [], channels = [], printing = false;

const clear = () => { Object.assign(store, {width: FINE, first: 0, last: 0, streams: {}, ring: []}); };

// One bucket into arrays that are sorted by k; buckets of the same k are united.
function unite(stream, k, channel, low, high) {
  const s = store.streams[stream] ||= {k: [], channels: {}};
  const c = s.channels[channel] ||= {low: [], high: []};
  let i = s.k.length - 1;
  while (i >= 0 && s.k[i] > k) i--;
  if (i < 0 || s.k[i] !== k) {
    if (i < s.k.length - 1) return;
    s.k.push(k);
    i++;
  }
  while (c.low.length <= i) { c.low.push(null); c.high.push(null); }
  if (low !== null && (c.low[i] === null || low < c.low[i])) c.low[i] = low;
  if (high !== null && (c.high[i] === null || high > c.high[i])) c.high[i] = high;
}

function take(streams) {
  const ratio = Math.round(store.width / FINE);
  for (const [name, piece] of Object.entries(streams)) {
    for (const [channel, [low, high]] of Object.entries(piece.channels))
      piece.k.forEach((k, i) => unite(name, Math.floor(k / ratio), channel, low[i], high[i]));
    if (piece.k.length) store.last = Math.max(store.last, (piece.k[piece.k.length - 1] + 1) * FINE);
  }
}

function takeFrame(streams) {
  store.ring.push({at: ms(), streams});
  while (store.ring.length && ms() - store.ring[0].at > 20000) store.ring.shift();
  if (view.follow) take(streams);
  else for (const piece of Object.values(streams))
    if (piece.k.length) store.last = Math.max(store.last, (piece.k[piece.k.length - 1] + 1) * FINE);
  trim();
}

// What is left of the window is forgotten while it moves on.
function trim() {
  if (!view.follow || view.span === Infinity) return;
  for (const s of Object.values(store.streams)) {
    const before = (store.last - 1.5 * view.span) / store.width;
    if (s.k.length < 400 || s.k[Math.floor(s.k.length / 4)] > before) continue;
    const n = s.k.findIndex(k => k >= before);
    if (n <= 0) continue;
    s.k.splice(0, n);
    for (const c of Object.values(s.channels)) { c.low.splice(0, n); c.high.splice(0, n); }
  }
}

function takeHistory(data) {
  Object.assign(store, {width: data.width, first: data.first, last: Math.max(data.last, store.last), streams: {}});
  for (const [name, piece] of Object.entries(data.streams)) {
    const s = store.streams[name] = {k: piece.k, channels: {}};
    for (const [channel, [low, high]] of Object.entries(piece.channels)) s.channels[channel] = {low, high};
  }
  if (view.follow) for (const frame of store.ring) take(frame.streams);
}

function bounds() {
  if (!view.follow) return [view.begin, view.end];
  const begin = view.span === Infinity ? store.first : store.last - view.span;
  return [begin, Math.max(store.last, begin + 1)];
}

// Two points for each bucket in the window, its ends in the order in which the curve goes; a gap where samples are missing.
function seriesOf(channel) {
  const s = store.streams[channel.stream], c = s && s.channels[channel.name];
  const t = [], y = [];
  if (!c) return [t, y];
  let before = null;
  const [begin, end] = bounds(), w = store.width, most = Math.max(2.5, channel.rate ? 2.5 / channel.rate / w : 0);
  for (let i = 0; i < s.k.length; i++) {
    const at = (s.k[i] + 0.5) * w;
    if (at < begin - 2 * w || at > end + 2 * w) continue;
    const low = c.low[i] ?? null, high = c.high[i] ?? null, up = before === null || low + high >= before;
    if (t.length && s.k[i] - s.k[i - 1] > most) { t.push(at - w); y.push(null); }
    t.push(at - w / 4, at + w / 4);
    y.push(up ? low : high, up ? high : low);
    before = low === null ? null : low + high;
  }
  return [t, y];
}

function limitsOf(channel) {
  const all = [...channel.trip, ...channel.command].filter(v => v !== null);
  return all.length ? [Math.min(...all), Math.max(...all)] : [];
}

function rangeOf(channel) {
  return (_u, low, high) => {
    if (low === null || low === undefined) [low, high] = channel.axis;
    const span = channel.axis[1] - channel.axis[0], trip = channel.trip[1];
    if (view.limits) { for (const v of limitsOf(channel)) { low = Math.min(low, v); high = Math.max(high, v); } }
    else if (trip !== null && high > 0.75 * trip) high = Math.max(high, trip);
    const least = 0.01 * span, middle = (low + high) / 2;
    if (high - low < least) { low = middle - least / 2; high = middle + least / 2; }
    const pad = 0.06 * (high - low);
    return [low - pad, high + pad];
  };
}

// Limits below the curve: the zone beyond a trip limit is filled, a limit of the command is dotted.
function drawLimits(u, channel) {
  const {ctx, bbox} = u, y = v => Math.min(bbox.top + bbox.height, Math.max(bbox.top, u.valToPos(v, 'y', true)));
  const inside = v => v !== null && v > u.scales.y.min && v < u.scales.y.max;
  ctx.save();
  channel.trip.forEach((v, i) => {
    if (v === null || (i ? v >= u.scales.y.max : v <= u.scales.y.min)) return;
    const edge = i ? bbox.top : bbox.top + bbox.height;
    ctx.globalAlpha = 0.12;
    ctx.fillStyle = colour('fault');
    ctx.fillRect(bbox.left, Math.min(edge, y(v)), bbox.width, Math.abs(edge - y(v)));
    ctx.globalAlpha = 1;
    if (!inside(v)) return;
    ctx.fillRect(bbox.left, y(v) - px(1), bbox.width, px(2));
  });
  ctx.strokeStyle = colour('quiet');
  ctx.lineWidth = px(1);
  ctx.setLineDash([px(2), px(4)]);
  for (const v of channel.command) if (v && inside(v)) straight(ctx, bbox.left, y(v), bbox.left + bbox.width, y(v));
  ctx.restore();
}

// Text that lines of the grid do not cross.
function write(ctx, text, x, y) {
  ctx.fillStyle = colour('fault');
  ctx.strokeStyle = colour('paper');
  ctx.lineWidth = px(4);
  ctx.lineJoin = 'round';
  ctx.font = `600 ${px(11)}px system-ui`;
  ctx.strokeText(text, x, y);
  ctx.fillText(text, x, y);
}

// Names of trip limits, and of faults in the first plot: above the grid, below the curve.
function drawNames(u, channel) {
  const {ctx, bbox, scales: {y}, valToPos} = u;
  ctx.save();
  ctx.textAlign = 'left';
  channel.trip.forEach((v, i) => {
    if (v !== null && v > y.min && v < y.max)
      write(ctx, `trip ${String(v).replace('-', '−')} ${channel.unit}`, bbox.left + px(6), valToPos(v, 'y', true) + px(i ? 15 : -6));
  });
  if (channel.name === chosen()[0]) for (const [t, text] of marks) {
    const x = placeOf(u, t), right = x > bbox.left + bbox.width * 0.6;
    ctx.textAlign = right ? 'right' : 'left';
    if (x) write(ctx, text.length > 60 ? `${text.slice(0, 59)}…` : text, x + px(right ? -6 : 6), bbox.top + px(32));
  }
  ctx.restore();
}

// Where a time in view is; 0: elsewhere.
const placeOf = (u, t) => t < u.scales.x.min || t > u.scales.x.max ? 0 : u.valToPos(t, 'x', true);

// A trip, or another fault, as a vertical line.
function drawMarks(u) {
  const {ctx, bbox} = u;
  ctx.save();
  ctx.fillStyle = colour('fault');
  for (const [t] of marks) { const x = placeOf(u, t); if (x) ctx.fillRect(x - px(1), bbox.top, px(2), bbox.height); }
  ctx.restore();
}

const axis = () => ({stroke: colour('quiet'), font: '12px system-ui', ticks: {show: false},
  grid: {stroke: colour('line'), width: 1}});
const widthOf = e => Math.max(200, printing ? 690 : e.clientWidth);
const heightOf = () => printing ? 92 : innerWidth < 760 ? 150 : Math.max(150, Math.min(230, (innerHeight - 380) / 3));

// Time and values under the cursor: both ends of its bucket.
function readAt(u, channel) {
  const i = u.cursor.idx, [t, y] = u.data, bucket = j => Math.floor(t[j] / store.width);
  if (i === null || i === undefined || y[i] === null || y[i] === undefined) return '';
  const j = bucket(i - 1) === bucket(i) ? i - 1 : i + 1, other = y[j] ?? y[i];
  const [low, high] = [Math.min(y[i], other), Math.max(y[i], other)].map(v => number(v, channel.digits));
  return `${fine(t[i])}   ${low === high ? low : `${low} … ${high}`} ${channel.unit}`;
}

function buildPlot(channel) {
  const host = make('div', 'curve'), head = make('h3'), place = make('div');
  host.style.setProperty('--c', `var(--${colourOf(channel.name)})`);
  const read = make('span');
  head.append(make('b', '', `${channel.label} [${channel.unit}]`), read);
  place.role = 'img';
  host.append(head, place);
  $('curves').append(host);
  const c = colour(colourOf(channel.name)), line = {stroke: c, width: 1.4, points: {show: false}};
  const u = new uPlot({
    width: widthOf(host), height: heightOf(), legend: {show: false}, padding: [6, 18, 0, 0],
    scales: {x: {time: false, range: () => bounds()}, y: {range: rangeOf(channel)}},
    axes: [{...axis(), size: 26, incrs: TICKS, space: 60, values: (_u, all, _i, _s, step) => all.map(t => t < 0 ? '' : step < 1 ? `${clock(t)}${(t % 1).toFixed(step < 0.1 ? 2 : 1).slice(1)}` : clock(t))},
      {...axis(), size: 56}],
    series: [{}, line],
    cursor: {sync: {key: 'time'}, drag: {x: true, y: false, setScale: false}, points: {show: false}, bind: {dblclick: () => () => follow()}},
    hooks: {
      drawClear: [() => drawLimits(u, channel)], drawAxes: [() => drawNames(u, channel)], draw: [() => drawMarks(u)],
      setSelect: [() => { if (u.select.width > 4) look(u.posToVal(u.select.left, 'x'), u.posToVal(u.select.left + u.select.width, 'x'));
        u.setSelect({left: 0, top: 0, width: 0, height: 0}, false); }],
      setCursor: [() => { read.textContent = readAt(u, channel); }],
    },
  }, seriesOf(channel), place);
  on(u.over, 'wheel', event => {
    event.preventDefault();
    zoom(event.deltaY > 0 ? 1.3 : 1 / 1.3, u.posToVal(event.offsetX, 'x'));
  }, {passive: false});
  plots.set(channel.name, {u, host, place, channel});
}

function chosen() {
  const kept = remembered('curves');
  if (kept) return kept.split(' ');
  const first = ['pressure', 'displacement', 'angle', 'force'].filter(name => channels.some(c => c.name === name));
  return first.length ? first : channels.slice(0, 3).map(c => c.name);
}

function buildPlots() {
  for (const {u} of plots.values()) u.destroy();
  plots.clear();
  $('curves').replaceChildren();
  for (const name of chosen()) { const channel = channels.find(c => c.name === name); if (channel) buildPlot(channel); }
}

function drawCurves() {
  for (const {u, channel} of plots.values()) u.setData(seriesOf(channel));
  const [begin, end] = bounds();
  put('window', view.follow ? '' : `${fine(Math.max(0, begin))} to ${fine(end)}`);
}

function resize() {
  for (const {u, host} of plots.values()) u.setSize({width: widthOf(host), height: heightOf()});
}

// Reading aid for those who do not see the canvas; rebuilt at the end of a trial.
function describe(values) {
  for (const {place, channel} of plots.values()) {
    const v = values && values[channel.name];
    aria(place, 'label', `${channel.label} over time` + (v ? `: ${number(v[1], channel.digits)} to ${number(v[2], channel.digits)} ${channel.unit} so far` : ''));
  }
}
