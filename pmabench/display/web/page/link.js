// The link to the server: the token, the stream of what is new, history; it comes back by itself.
const fragment = new URLSearchParams(location.hash.slice(1)).get('t');
if (fragment) { remember('token', fragment); history.replaceState(null, '', location.pathname + location.search); }
const token = fragment || remembered('token') || '';
const headers = {Authorization: `Bearer ${token}`};
const link = {heard: ms(), begun: 0, controller: null, wait: 500, wanted: true, refused: '', asking: null};

const sleep = ms => new Promise(done => setTimeout(done, ms));
const visible = () => new Promise(done => document.addEventListener('visibilitychange', done, {once: true}));

async function followStream(take) {
  for (;;) {
    if (document.hidden) { await visible(); link.heard = ms(); }
    link.controller = new AbortController();
    link.begun = ms();
    let again = link.wait;
    try {
      const answer = await fetch(`/api/stream?at=${encodeURIComponent(location.pathname)}`, {headers, signal: link.controller.signal, cache: 'no-store'});
      if (!answer.ok) { link.refused = (await answer.text()).trim(); if (answer.status === 401) return; throw Error(link.refused); }
      link.refused = '';
      link.wanted = true;
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      let text = '';
      for (;;) {
        const {done, value} = await reader.read();
        if (done) break;
        link.heard = ms();
        link.wait = 500;
        text += value;
        const messages = text.split('\n\n');
        text = messages.pop();
        for (const message of messages) again = message.startsWith('retry: ') ? Number(message.slice(7)) : (handle(message, take), again);
      }
    } catch { link.wait = Math.min(2000, 1.5 * link.wait); }
    await sleep(again);
  }
}

function handle(message, take) {
  const lines = message.split('\n'), name = lines[0].replace('event: ', '');
  if (lines.length === 2) take(name, JSON.parse(lines[1].slice(6)));
}

// Buckets of the window that is shown; the newest request counts.
async function fetchHistory() {
  const query = new URLSearchParams({at: location.pathname, most: innerWidth < 760 ? 1000 : 2000});
  if (!view.follow) { const pad = 0.25 * (view.end - view.begin); query.set('begin', view.begin - pad); query.set('end', view.end + pad); }
  else if (view.span !== Infinity) query.set('span', 1.2 * view.span);
  if (link.asking) link.asking.abort();
  const asking = link.asking = new AbortController();
  try {
    const answer = await fetch(`/api/history?${query}`, {headers, signal: asking.signal, cache: 'no-store'});
    if (!answer.ok) return;
    const data = await answer.json();
    if (data.run === S.run.id) { takeHistory(data); due = true; }
  } catch { link.wanted = link.wanted || !asking.signal.aborted; }
}

const cut = () => { if (link.controller) link.controller.abort(); };
on(document, 'visibilitychange', () => { if (document.hidden) cut(); });

async function postVent() {
  const answer = await fetch('/api/vent', {method: 'POST', headers: {...headers, 'Content-Type': 'application/json'}, body: JSON.stringify({run: S.run.id})});
  return answer.ok ? answer.json() : {confirmed: false, result: (await answer.text()).trim(), actions: []};
}
