// Small helpers: elements, numbers and times as text.
const $ = id => document.getElementById(id);
const root = document.documentElement;
const aria = (e, name, value) => e.setAttribute(`aria-${name}`, value);
const make = (tag, name, text) => {
  const e = document.createElement(tag);
  if (name) e.className = name;
  if (text !== undefined) e.textContent = text;
  return e;
};
const put = (id, text) => { const e = $(id); if (e.textContent !== text) e.textContent = text; };
const show = (id, on) => { $(id).hidden = !on; };
const ms = () => performance.now();
const straight = (ctx, x, y, to, high) => { ctx.beginPath(); ctx.moveTo(x, y); ctx.lineTo(to, high); ctx.stroke(); };
// Pixels of a canvas.
const px = n => n * devicePixelRatio;
const on = (e, name, does) => e.addEventListener(name, does);
const picture = (e, label) => { e.role = 'img'; aria(e, 'label', label); };
const two = n => String(n).padStart(2, '0');
const clock = s => {
  s = Math.max(0, Math.floor(s));
  const h = Math.floor(s / 3600), m = Math.floor(s / 60) % 60;
  return h ? `${h}:${two(m)}:${two(s % 60)}` : `${m}:${two(s % 60)}`;
};
const fine = s => `${clock(s)}.${Math.floor((Math.max(0, s) % 1) * 10)}`;
const at = date => `${two(date.getHours())}:${two(date.getMinutes())}`;
const number = (v, digits) => v === null || v === undefined ? '–' : v.toFixed(digits).replace(/^-(?=[0.]*$)/, '').replace('-', '−');
const colour = name => getComputedStyle(root).getPropertyValue(`--${name}`).trim();
const colourOf = name => ({pressure: 'P', pressure_command: 'P', supply: 'P', displacement: 'x', angle: 'x', force: 'F'})[name] || 'ink';
const remember = (key, value) => { try { sessionStorage.setItem(key, value); } catch { /* not kept */ } };
const remembered = key => { try { return sessionStorage.getItem(key); } catch { return null; } };
