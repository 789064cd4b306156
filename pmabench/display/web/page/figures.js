// The loop of a trial, and a coefficient over what was varied.
const figures = {};
let loop = {number: 0, points: []}, earlier = [], axes = [], curve = null;

function clipped({ctx, bbox: b}, margin) {
  ctx.save();
  ctx.beginPath();
  ctx.rect(b.left - margin, b.top - margin, b.width + 2 * margin, b.height + 2 * margin);
  ctx.clip();
  return ctx;
}

function drawLine(u, i, xs, ys) {
  const ctx = clipped(u, 0), s = u.series[i];
  ctx.beginPath();
  ctx.strokeStyle = s.stroke();
  ctx.globalAlpha = s.alpha ?? 1;
  ctx.lineWidth = px(s.width ?? 1.6);
  if (s.dash) ctx.setLineDash(s.dash.map(px));
  xs.forEach((x, k) => ctx[k ? 'lineTo' : 'moveTo'](u.valToPos(x, 'x', true), u.valToPos(ys[k], 'y', true)));
  ctx.stroke();
  ctx.restore();
}

// Dots: filled where the trial is without doubt, else an open one; the newest has a ring, the newest of a place a bar.
function drawDots(u, i, xs, ys, ok, halves) {
  const r = px(4), ctx = clipped(u, 2 * r), high = y => u.valToPos(y, 'y', true);
  ctx.fillStyle = ctx.strokeStyle = u.series[i].stroke();
  ctx.lineWidth = px(1.5);
  xs.forEach((x, k) => {
    const cx = u.valToPos(x, 'x', true), cy = high(ys[k]);
    ctx.beginPath();
    ctx.arc(cx, cy, r, 0, 7);
    if (ok[k]) ctx.fill(); else ctx.stroke();
    if (halves[k] && !xs.includes(xs[k], k + 1)) straight(ctx, cx, high(ys[k] - halves[k]), cx, high(ys[k] + halves[k]));
    if (k === xs.length - 1) { ctx.beginPath(); ctx.arc(cx, cy, 1.9 * r, 0, 7); ctx.stroke(); }
  });
  ctx.restore();
}

const drawing = (u, i) => { const [xs, ys, ok, halves] = u.data[i]; if (xs.length) (ok ? drawDots : drawLine)(u, i, xs, ys, ok, halves); return null; };
const padded = (low, high) => { const p = 0.07 * (high - low || Math.abs(high) || 1); return [low - p, high + p]; };
const ends = (data, k) => {
  let low = Infinity, high = -Infinity;
  for (const d of data) if (d) for (const v of d[k]) { if (v < low) low = v; if (v > high) high = v; }
  return low > high ? [0, 1] : [low, high];
};

function figure(id, series, titles) {
  const key = JSON.stringify([titles, series.map(s => s.c), colour('ink')]), old = figures[id];
  if (old && old.key === key) return old.u;
  if (old) old.u.destroy();
  const host = $(id), facets = [{scale: 'x', auto: false}, {scale: 'y', auto: false}];
  const titled = title => ({...axis(), label: title, labelFont: '600 12px system-ui', labelSize: 18});
  const kept = figures[id] = {key, x: [0, 1], y: [0, 1]};
  kept.u = new uPlot({
    mode: 2, width: widthFor(host), height: figureHeight(), legend: {show: false}, cursor: {show: false}, padding: [8, 12, 0, 0],
    scales: {x: {time: false, range: () => kept.x}, y: {range: () => kept.y}},
    axes: [{...titled(titles[0]), size: 26}, {...titled(titles[1]), size: 48}],
    series: [null, ...series.map(s => ({stroke: s.c, width: s.width, alpha: s.alpha, dash: s.dash, facets, paths: drawing}))],
  }, [null, ...series.map(() => [[], []])], host);
  return kept.u;
}
const widthFor = host => printing ? 330 : Math.max(200, host.clientWidth);
const figureHeight = () => printing ? 140 : 240;

function setFigure(id, series, titles, data, xRange) {
  const drawn = data.filter(d => d && d[0].length);
  const u = figure(id, series, titles);
  figures[id].x = padded(...(xRange || ends(drawn, 0)));
  figures[id].y = padded(...ends(drawn, 1));
  u.setData([null, ...data], true);
}

const pairs = () => {
  const has = name => axes.indexOf(name), x = has('displacement') >= 0 ? 'displacement' : 'angle', all = [];
  if (has('force') >= 0 && has(x) >= 0) all.push([x, 'force']);
  if (has('pressure') >= 0 && has('force') >= 0) all.push(['pressure', 'force']);
  if (has('pressure') >= 0 && has(x) >= 0) all.push(['pressure', x]);
  return all;
};

function drawLoop() {
  const all = pairs(), kept = $('loop-axes').value;
  show('loop-part', all.length > 0 && (loop.points.length > 0 || earlier.length > 0));
  if ($('loop-part').hidden) return;
  const words = {displacement: 'contraction x', angle: 'angle', force: 'force F', pressure: 'pressure P'};
  if ($('loop-axes').options.length !== all.length) {
    $('loop-axes').replaceChildren(...all.map(([a, b]) => { const o = make('option', '', `${words[b]} over ${words[a]}`); o.value = `${a} ${b}`; return o; }));
    if (kept) $('loop-axes').value = kept;
  }
  const [a, b] = ($('loop-axes').value || all[0].join(' ')).split(' '), ia = axes.indexOf(a), ib = axes.indexOf(b);
  const unit = name => (channels.find(c => c.name === name) || {unit: ''}).unit;
  const cut = points => [points.map(p => p[ia]), points.map(p => p[ib])];
  const old = [...Array(2 - earlier.length).fill({points: []}), ...earlier];
  const c = colour(colourOf(b));
  put('loop-title', loop.number ? `Trial ${loop.number}` : 'Loop');
  setFigure('loop', [{c, alpha: 0.22, width: 1.4}, {c, alpha: 0.4, width: 1.4}, {c, width: 2}],
    [`${words[a]} [${unit(a)}]`, `${words[b]} [${unit(b)}]`], [...old.map(o => cut(o.points)), cut(loop.points)]);
  picture($('loop'), `${words[b]} over ${words[a]}, trial ${loop.number}, ${loop.points.length} points`);
}

function drawCoefficient(list) {
  show('coefficient-part', list.length > 0);
  if (!list.length) return;
  const select = $('symbol'), kept = select.value;
  if (select.options.length !== list.length) {
    select.replaceChildren(...list.map(c => make('option', '', c.symbol)));
    if (list.some(c => c.symbol === kept)) select.value = kept;
  }
  curve = list.find(c => c.symbol === select.value) || list[0];
  const p = curve.points, e = curve.expected, ink = colour('P'), quiet = colour('quiet');
  const titled = (symbol, unit) => unit ? `${symbol} [${unit}]` : symbol;
  const column = (rows, ...which) => which.map(k => rows.map(row => row[k]));
  put('coefficient-title', `${curve.symbol} over ${curve.axis.symbol}, trial by trial`);
  setFigure('coefficient', [{c: quiet, dash: [6, 4], width: 1.6}, {c: ink}],
    [titled(curve.axis.symbol, curve.axis.unit), titled(curve.symbol, curve.unit)],
    [column(e, 0, 1), column(p, 0, 1, 3, 4)],
    curve.range && curve.range[0] < curve.range[1] ? curve.range : null);
  put('coefficient-note', `${p.length ? 'dots: by the trials so far' : 'no trial yet'}${p.some(v => v[4]) ? '; bar: ± 95 % by their scatter' : ''}${p.some(v => !v[3]) ? '; open: in doubt' : ''}`
    + `${e.length ? '; dashed: expected' : ''}. pmabench process gives ${curve.symbol} ± U.`);
  const last = p.length ? `, last ${p[p.length - 1][1]} ${curve.unit} at ${p[p.length - 1][0]} ${curve.axis.unit}` : '';
  picture($('coefficient'), `${curve.symbol} over ${curve.axis.symbol}: ${p.length} trials${last}`);
}

function resizeFigures() {
  for (const [id, {u}] of Object.entries(figures)) u.setSize({width: widthFor($(id)), height: figureHeight()});
}
