// What a person does: time window, keys, theme, print, vent; and the clock that draws.
let due = true;

const parts = {run: partRun, now: partNow, channels: partChannels, trials: partTrials, log: partLog,
  list: list => { S.list = list; partList(list); }, loops: list => { earlier = list; due = true; },
  coefficients: list => { S.coefficients = list; drawCoefficient(list); }};

followStream((name, data) => {
  if (name === 'frame') {
    if (data.streams) { takeFrame(data.streams); due = true; }
    if (data.loop) {
      if (data.loop.start === 0) loop = {number: data.loop.number, points: data.loop.points};
      else loop.points.splice(data.loop.start, Infinity, ...data.loop.points);
    }
    if (data.values) partValues(data.values);
  } else if (parts[name]) {
    const reading = S.run.reading;
    parts[name](data);
    if (name === 'run' && reading && !data.reading) link.wanted = true;
    due = true;
  }
  if (link.wanted && S.run.there && name === 'run') { link.wanted = false; fetchHistory(); }
});

const PACE = matchMedia('(prefers-reduced-motion: reduce)').matches ? 1000 : 100;
function draw() {
  if (!due || document.hidden) return;
  due = false;
  drawCurves();
  drawLoop();
  const widest = Object.values(store.streams)[0];
  if (view.follow && view.span === Infinity && widest && widest.k.length > 4000) fetchHistory();
}
setInterval(draw, PACE);

setInterval(() => {
  const silent = (ms() - link.heard) / 1000, lost = !document.hidden && (silent > 3 || !!link.refused);
  document.body.classList.toggle('lost', lost);
  show('trouble', lost);
  if (lost) put('trouble', link.refused || `no data for ${Math.floor(silent)} s; trying again`);
  if (ms() - Math.max(link.heard, link.begun) > 6000 && !link.refused) cut();
}, 500);

// -- the window in time
function mark() {
  for (const b of $('spans').children) aria(b, 'pressed', view.follow && Number(b.value) === view.span);
  aria($('live'), 'pressed', view.follow);
  aria($('limits'), 'pressed', view.limits);
}
let later = 0;
function changed() { mark(); due = true; draw(); clearTimeout(later); later = setTimeout(fetchHistory, 120); }
function follow(span) { view.follow = true; if (span) view.span = span; changed(); }
// Before the run there is nothing to see.
function look(begin, end) {
  const least = 0.1, first = Math.max(-1, begin);
  Object.assign(view, {follow: false, begin: first, end: Math.max(first + least, end)});
  changed();
}
function zoom(factor, around) {
  const [begin, end] = bounds(), c = around ?? (view.follow ? end : (begin + end) / 2);
  look(c - (c - begin) * factor, c + (end - c) * factor);
}
function pan(share) { const [begin, end] = bounds(), d = share * (end - begin); look(begin + d, end + d); }

for (const [text, span] of SPANS) {
  const b = make('button', '', text);
  b.value = span;
  on(b, 'click', () => follow(span));
  $('spans').append(b);
}
const flip = () => { view.limits = !view.limits; mark(); due = true; };
const another = () => { const s = $('symbol'); s.selectedIndex = (s.selectedIndex + 1) % s.length; drawCoefficient(S.coefficients); };
const press = {back: () => pan(-0.4), forth: () => pan(0.4), in: () => zoom(0.6), out: () => zoom(1 / 0.6), live: () => follow(), limits: flip, symbol: another,
  print: () => print(), keys: () => $('help').showModal(), theme: () => theme(!('dark' in root.dataset), true)};
for (const b of document.querySelectorAll('button[id]')) if (press[b.id]) on(b, 'click', press[b.id]);
on(window, 'keydown', event => {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches('select, input, dialog *, .scroll')) return;
  const keys = {ArrowLeft: 'back', ArrowRight: 'forth', '+': 'in', '=': 'in', '-': 'out', l: 'live', y: 'limits', s: 'symbol', d: 'theme', p: 'print', '?': 'keys'};
  const id = keys[event.key] || keys[event.key.toLowerCase()];
  if (id) press[id]();
  else if (event.key >= '1' && event.key <= '5') follow(SPANS[event.key - 1][1]);
  else return;
  event.preventDefault();
});

on($('loop-axes'), 'change', drawLoop);
on($('symbol'), 'change', () => drawCoefficient(S.coefficients));

// -- places
function go(href) {
  history.pushState(null, '', href);
  link.wanted = true;
  cut();
}
on(window, 'popstate', cut);

// -- theme, size, print
function redrawAll() { buildPlots(); describe(S.values); drawLoop(); drawCoefficient(S.coefficients); due = true; }
function theme(dark, keep) {
  root.toggleAttribute('data-dark', dark);
  if (keep) remember('dark', dark ? '1' : '0');
  if (channels.length) redrawAll();
}
const wish = matchMedia('(prefers-color-scheme: dark)'), kept = remembered('dark');
theme(kept ? kept === '1' : wish.matches);
on(wish, 'change', () => { if (!remembered('dark')) theme(wish.matches); });
let size = 0;
on(window, 'resize', () => { clearTimeout(size); size = setTimeout(() => { resize(); resizeFigures(); due = true; }, 80); });
function forPrint(on) {
  const dark = 'dark' in root.dataset;
  printing = on;
  if (on) {
    put('printed', `${S.run.id}, printed ${new Date().toLocaleString('sv')}. `);
    forPrint.dark = dark;
    root.removeAttribute('data-dark');
  } else root.toggleAttribute('data-dark', !!forPrint.dark);
  redrawAll();
  resizeFigures();
}
on(window, 'beforeprint', () => forPrint(true));
on(window, 'afterprint', () => forPrint(false));

// -- vent, in two steps: hold for 0.8 s, or Enter twice within 3 s
const button = $('vent');
let held = 0, entered = -Infinity;
function vented(how, text) { put('vented', text); $('vented').className = `notice ${how}`; show('vented', true); }
async function vent() {
  if (button.disabled) return;
  button.disabled = true;
  vented('doubt', 'venting …');
  let result;
  try { result = await postVent(); } catch (error) { result = {confirmed: false, result: `the server did not answer (${error.message})`, actions: []}; }
  if (result.confirmed) vented('good', `vent confirmed: ${result.actions.join('; ')}`);
  else vented('fault', `VENT NOT CONFIRMED: ${result.result}. Keep away; shut the supply by hand, then pmabench vent.`);
  button.disabled = false;
}
const release = () => { clearTimeout(held); button.classList.remove('held'); };
on(button, 'pointerdown', () => { button.classList.add('held'); held = setTimeout(() => { release(); vent(); }, 800); });
for (const name of ['pointerup', 'pointerleave', 'pointercancel', 'blur']) on(button, name, release);
on(button, 'keydown', event => {
  if (!['Enter', ' '].includes(event.key)) return;
  event.preventDefault();
  event.stopPropagation();
  if (event.repeat) return;
  if (ms() - entered < 3000) { entered = -Infinity; vent(); } else {
    entered = ms();
    vented('doubt', 'press Enter once more within 3 s to vent');
  }
});
mark();
