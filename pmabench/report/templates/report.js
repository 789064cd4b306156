"use strict";
// Draws the charts of a report anew with uPlot: zoom, linked cursors, values, methods on and off.
// The static pictures stay in the page for print, and for browsers without scripts; what is folded is drawn when opened.
(function () {
  var store = document.getElementById("charts");
  if (!store || !window.uPlot || !window.ResizeObserver) return;
  var INK = "#16202a", QUIET = "#52606d", GRID = "#e8edf2", UNTESTED = "#eef1f5", STAMP = "#8a4b00";
  var GLYPHS = { "": "\u2014", o: "\u25cf", s: "\u25a0", "^": "\u25b2", v: "\u25bc", D: "\u25c6", "<": "\u25c0", x: "\u00d7", "+": "+", "*": "\u2217", ".": "\u00b7" };
  var OPEN = { o: "\u25cb", s: "\u25a1", "^": "\u25b3", v: "\u25bd", D: "\u25c7", "<": "\u25c1" };
  var SYMBOL = /([A-Za-zα-ω]+)_([A-Za-z0-9]{1,4})/g;

  function element(tag, name, parent) {
    var made = document.createElement(tag);
    if (name) made.className = name;
    if (parent) parent.appendChild(made);
    return made;
  }

  function number(value) {
    if (value === null || !isFinite(value)) return "";
    return String(+(+value).toPrecision(5)).replace("-", "\u2212");
  }

  function lower(s, i) {  // end of an interval
    var end = s.y[i] - (s.half && s.half[i] || 0);
    return s.positive && s.y[i] >= 0 ? Math.max(end, 0) : end;
  }

  function pieces(text) {  // text cut into [words, lowered]
    var found = [], end = 0;
    text.replace(SYMBOL, function (all, base, sub, at) {
      found.push([text.slice(end, at) + base, sub]);
      end = at + all.length;
      return all;
    });
    found.push([text.slice(end), ""]);
    return found;
  }

  function say(parent, text, tag) {
    var into = tag ? element(tag, "", parent) : parent;
    pieces(text).forEach(function (piece) {
      into.appendChild(document.createTextNode(piece[0]));
      if (piece[1]) element("sub", "", into).textContent = piece[1];
    });
  }

  function write(ctx, text, x, y, size, color, bold, end, halo) {
    var font = function (s) { return (bold ? "600 " : "") + s + "px Inter, sans-serif"; };
    var cut = pieces(text), wide = 0;
    cut.forEach(function (piece) {
      ctx.font = font(size); wide += ctx.measureText(piece[0]).width;
      ctx.font = font(0.75 * size); wide += ctx.measureText(piece[1]).width;
    });
    ctx.fillStyle = color;
    ctx.textAlign = "left";
    ctx.textBaseline = "middle";
    x -= (end || 0) * wide;
    if (halo) {
      ctx.strokeStyle = "#fff"; ctx.lineWidth = 0.3 * size; ctx.font = font(size);
      ctx.strokeText(cut.map(function (piece) { return piece[0] + piece[1]; }).join(""), x, y);
    }
    cut.forEach(function (piece) {
      ctx.font = font(size); ctx.fillText(piece[0], x, y); x += ctx.measureText(piece[0]).width;
      ctx.font = font(0.75 * size); ctx.fillText(piece[1], x, y + 0.25 * size); x += ctx.measureText(piece[1]).width;
    });
  }

  function unit(label) { var found = /\[([^\]]*)\]/.exec(label); return found ? "\u2009" + found[1] : ""; }

  function union(series) {
    var all = new Set();
    series.forEach(function (s) { s.x.forEach(function (x) { if (x !== null) all.add(x); }); });
    return Array.from(all).sort(function (a, b) { return a - b; });
  }

  function shown(chart, on) {
    return chart.series.filter(function (s) { return !s.method || on[s.method]; });
  }

  function reach(chart, on, low, high) {  // least and largest y between two x, with room
    var near = 1e-4 * (chart.range[1] - chart.range[0]);
    var whole = low <= chart.range[0] + near && high >= chart.range[1] - near, ends = whole ? chart.range.slice(2) : [];
    shown(chart, on).forEach(function (s) {
      if (whole && !s.method) return;
      s.x.forEach(function (x, i) {
        if (s.y[i] === null || x < low || x > high) return;
        var half = s.half && s.half[i] || 0;
        ends.push(lower(s, i), s.y[i] + half);
      });
      if (!s.mark) [low, high].forEach(function (x) {  // a straight line may have no point between them
        for (var i = 1; i < s.x.length; i++)
          if (s.y[i - 1] !== null && s.y[i] !== null && (s.x[i - 1] - x) * (s.x[i] - x) < 0)
            ends.push(between(s, i - 1, i, x, chart.log));
      });
    });
    if (!ends.length) return chart.range.slice(2);
    var least = Math.min.apply(null, ends), most = Math.max.apply(null, ends);
    var room = whole && ends.length === 2 ? 0 : 0.06 * (most - least || Math.abs(most) || 1);
    return [least - room, most + room];
  }

  function under(u, chart, on) {  // drawn below the curves: what was not tested, bands
    var ctx = u.ctx, box = u.bbox;
    var X = function (v) { return u.valToPos(v, "x", true); }, Y = function (v) { return u.valToPos(v, "y", true); };
    ctx.save();
    ctx.beginPath(); ctx.rect(box.left, box.top, box.width, box.height); ctx.clip();
    if (chart.tested) {
      ctx.fillStyle = UNTESTED; ctx.fillRect(box.left, box.top, box.width, box.height);
      ctx.fillStyle = "#fff"; ctx.beginPath();
      chart.tested[0].forEach(function (x, i) { ctx[i ? "lineTo" : "moveTo"](X(x), Y(chart.tested[1][i])); });
      ctx.fill();
    }
    shown(chart, on).forEach(function (s) {
      if (s.mark || !s.half) return;
      ctx.globalAlpha = 0.16; ctx.fillStyle = s.color; ctx.beginPath();
      for (var i = 0; i < s.x.length; i++) ctx[i ? "lineTo" : "moveTo"](X(s.x[i]), Y(s.y[i] + (s.half[i] || 0)));
      for (i = s.x.length - 1; i >= 0; i--) ctx.lineTo(X(s.x[i]), Y(lower(s, i)));
      ctx.fill(); ctx.globalAlpha = 1;
    });
    chart.levels.forEach(function (l) {
      var a = l.upright ? X(l.at) : Y(l.at), b = l.to === null ? a : l.upright ? X(l.to) : Y(l.to), p = window.devicePixelRatio || 1;
      ctx.fillStyle = ctx.strokeStyle = l.color; ctx.globalAlpha = l.to === null ? 1 : 0.13; ctx.lineWidth = p; ctx.beginPath();
      if (l.upright) ctx.rect(Math.min(a, b), box.top, Math.abs(b - a), box.height);
      else ctx.rect(box.left, Math.min(a, b), box.width, Math.abs(b - a));
      ctx.setLineDash(l.dashed ? [5 * p, 4 * p] : []);
      if (l.to === null) ctx.stroke(); else ctx.fill();
      ctx.setLineDash([]); ctx.globalAlpha = 1;
    });
    ctx.restore();
  }

  function curve(ctx, s, X, Y, p) {  // a line with its gaps; x need not rise
    var known = false;
    ctx.strokeStyle = s.color; ctx.lineWidth = 1.25 * s.width * p; ctx.lineJoin = "round";
    ctx.setLineDash(s.dashed ? [5 * p, 4 * p] : []); ctx.beginPath();
    s.x.forEach(function (x, i) {
      var there = x !== null && s.y[i] !== null;
      if (there) ctx[known ? "lineTo" : "moveTo"](X(x), Y(s.y[i]));
      known = there;
    });
    ctx.stroke(); ctx.setLineDash([]);
  }

  function mark(ctx, s, a, b, r) {
    ctx.beginPath();
    if (s.shape) s.shape.forEach(function (line) {
      line.forEach(function (at, i) { ctx[i ? "lineTo" : "moveTo"](a + r * at[0], b + r * at[1]); });
      if (line.length > 2) ctx.closePath();
    });
    else ctx.arc(a, b, s.mark === "." ? 0.35 * r : r, 0, 7);
    if (!s.shape || s.shape[0].length > 2) ctx.fill();
    if (s.hollow || (s.shape && s.shape[0].length < 3)) ctx.stroke();
  }

  function over(u, chart, on) {  // lines, marks with bars; names at the curves and of levels
    var ctx = u.ctx, box = u.bbox, p = window.devicePixelRatio || 1, names = [], firsts = [];
    var X = function (v) { return u.valToPos(v, "x", true); }, Y = function (v) { return u.valToPos(v, "y", true); };
    ctx.save();
    ctx.beginPath(); ctx.rect(box.left - 4 * p, box.top - 4 * p, box.width + 8 * p, box.height + 8 * p); ctx.clip();
    shown(chart, on).forEach(function (s) {
      var last = null;
      if (!s.mark) curve(ctx, s, X, Y, p);
      s.x.forEach(function (x, i) {
        if (s.y[i] === null || x < u.scales.x.min || x > u.scales.x.max) return;
        if (last === null || x >= s.x[last]) last = i;
        if (!s.mark) return;
        var a = X(x), b = Y(s.y[i]), half = s.half && s.half[i], r = 3.2 * p;
        ctx.strokeStyle = s.color; ctx.fillStyle = s.hollow ? "#fff" : s.color; ctx.lineWidth = 1.6 * p;
        ctx.beginPath();
        if (half) { ctx.moveTo(a, Y(lower(s, i))); ctx.lineTo(a, Y(s.y[i] + half)); ctx.stroke(); ctx.beginPath(); }
        if (s.hollow) ctx.lineWidth = 1.3 * p;
        mark(ctx, s, a, b, r);
      });
      var text = s.method ? s.said : chart.legend ? "" : s.label, right = u.scales.x.max;
      var end = last === null ? null : [s.x[last], s.y[last]], cut = s.mark || s.hidden ? null : at(s, right, chart.log);
      if (cut && cut[0] === right) end = cut;
      if (text && s.first) firsts.push({ text: text, y: Y(s.y[0]), color: s.name });
      else if (text && end) names.push({ text: text, x: X(end[0]), y: Y(end[1]), color: s.name });
    });
    ctx.restore();
    [names, firsts].forEach(function (list) {
      list.sort(function (a, b) { return a.y - b.y; });
      var low = box.top + box.height - 5 * p;
      for (var round = 0; round < 80; round++) {
        for (var n = 0; n + 1 < list.length; n++) {
          var one = list[n], next = list[n + 1], lack = 13 * p - (next.y - one.y);
          var wide = 7 * p * Math.max(one.text.length, next.text.length);
          if (lack > 0 && !(Math.abs(next.x - one.x) >= wide)) { one.y -= lack / 2; next.y += lack / 2; }
        }
        list.forEach(function (name) { name.y = Math.min(Math.max(name.y, box.top + 2 * p), low); });
      }
    });
    if (u.scales.x.min <= chart.range[0]) firsts.forEach(function (name) {
      write(ctx, name.text, box.left - 6 * p, name.y, 11.5 * p, name.color, true, true);
    });
    var edge = u.ctx.canvas.width - 2 * p;
    names.forEach(function (name) {
      ctx.font = 11.5 * p + "px Inter, sans-serif";
      var wide = 1.05 * ctx.measureText(name.text).width;
      write(ctx, name.text, Math.min(Math.min(name.x, box.left + box.width) + 6 * p, edge - wide), name.y, 11.5 * p,
        name.color, true);
    });
    chart.levels.forEach(function (l) {
      var x = l.upright ? X(l.at) + (l.right ? 4 : -4) * p : l.right ? box.left + 4 * p : box.left + box.width - 4 * p;
      var y = l.upright ? (l.first ? box.top + box.height - 9 * p : box.top + 9 * p) : Y(l.at) + (l.first ? -8 : 9) * p;
      if (l.name) write(ctx, l.name, x, y, 11 * p, l.color, false, !l.right, true);
    });
    var head = (chart.title ? 24 : 8) * p;
    write(ctx, chart.title, chart.yNamed ? 1 : box.left, 8 * p, 12 * p, INK, true);
    if (chart.yNamed) write(ctx, chart.y, 1, head, 12 * p, INK, false);
    if (chart.named) write(ctx, chart.x, box.left + box.width / 2, ctx.canvas.height - 10 * p, 12 * p, INK, false, 0.5);
    write(ctx, chart.stamp, edge, head, 10.5 * p, STAMP, true, true);
  }

  function between(s, a, b, x, log) {  // y of the straight line between two points
    var place = function (v) { return log ? Math.log(v) : v; }, from = place(s.x[a]);
    return s.y[a] + (place(x) - from) / (place(s.x[b]) - from || 1) * (s.y[b] - s.y[a]);
  }

  function at(s, x, log) {  // [x, y, half] of a line at x, or of the nearest dot
    var best = -1;
    for (var i = 0; i < s.x.length; i++)
      if (s.y[i] !== null && (best < 0 || Math.abs(s.x[i] - x) < Math.abs(s.x[best] - x))) best = i;
    if (best < 0) return null;
    if (s.mark) return [s.x[best], s.y[best], s.half && s.half[best]];
    var first = Math.min.apply(null, s.x.slice(0, 1)), end = s.x[s.x.length - 1];
    if (x < first || x > end) return null;
    var next = s.x[best] < x ? best + 1 : best - 1;
    if (next < 0 || next >= s.x.length || s.y[next] === null) return [s.x[best], s.y[best], null];
    return [x, between(s, best, next, x, log), null];
  }

  function values(line, charts, chart, on, x, y) {
    line.textContent = "";
    var linked = charts.filter(function (c) { return c === chart || (c.together && c.together === chart.together); });
    var texts = [], place = x;
    linked.forEach(function (c) {
      var lines = shown(c, on).filter(function (s) { return !s.mark && !s.hidden; });
      var from = lines.length ? lines : shown(c, on).filter(function (s) { return s.mark && s.mark !== "."; });
      from.forEach(function (s) {
        var found = at(s, x, c.log), span = c.range[1] - c.range[0];
        if (!found || Math.abs(found[0] - x) > 0.08 * span) return;
        if (s.mark) place = found[0];
        var half = found[2] ? " \u00b1\u2009" + number(+(+found[2]).toPrecision(2)) : "";
        texts.push((s.said || c.y.replace(/ \[.*/, "")) + " " + number(found[1]) + half + unit(c.y));
      });
    });
    if (!texts.length) texts.push(chart.y.replace(/ \[.*/, "") + " " + number(+y.toPrecision(3)) + unit(chart.y));
    say(line, chart.x.replace(/ \[.*/, "") + " = " + number(place) + unit(chart.x), "b");
    texts.forEach(function (text) { say(line, text, "span"); });
  }

  function plot(chart, box, on, charts, line, moved) {
    var xs = union(chart.series.concat({ x: chart.range.slice(0, 2) }));
    var longest = Math.max.apply(null, chart.series.map(function (s) {
      return chart.legend || s.method || s.first || !s.label ? 0 : s.label.length;
    }));
    var gutter = 7.6 * Math.max.apply(null, chart.series.map(function (s) { return s.first && s.label ? s.label.length : 0; }));
    var size = function () {
      var wide = Math.max(200, box.clientWidth);
      return { width: wide, height: Math.round(Math.max(charts.length > 1 ? 170 : 270, Math.min(wide * chart.ratio, 420))) };
    };
    var ticks = function (u, splits) { return splits.map(number); };
    var span = chart.range.slice(0, 2);  // of x as it is about to be: the range of y is asked for before u.scales has it
    var within = function (u) {
      var ends = [u.scales.x.min, u.scales.x.max];
      var found = chart.ticks.filter(function (x) { return x >= ends[0] && x <= ends[1]; });
      return found.length ? found : ends;
    };
    var axis = { stroke: QUIET, font: "11px Inter, sans-serif", values: ticks };
    var options = Object.assign(size(), {
      padding: [chart.title ? 38 : 22, chart.sides ? 1.4 * chart.sides[1] : 12 + 6.4 * longest, chart.named ? 2 : 6, 2],
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false },
        sync: chart.together ? { key: box.dataset.key + chart.together } : undefined },
      scales: {
        x: { time: false, distr: chart.log ? 3 : 1, range: function (u, low, high) {
          var whole = low == null || high - low >= 0.999 * (xs[xs.length - 1] - xs[0]);
          return span = whole ? chart.range.slice(0, 2) : [low, high];
        } },
        y: { range: function () { return reach(chart, on, span[0], span[1]); } }
      },
      axes: [
        Object.assign({ grid: { show: false }, ticks: { stroke: QUIET, width: 1, size: 3 }, gap: 3, space: 60,
          border: { show: true, stroke: QUIET, width: 1 }, label: chart.named ? " " : undefined, labelSize: 18,
          labelFont: "12px Inter, sans-serif", size: chart.named ? 24 : 8 }, axis,
          chart.ticks.length ? { splits: within, filter: function (u, at) { return at; } } : {},
          chart.named ? {} : { values: function (u, splits) { return splits.map(function () { return ""; }); } }),
        Object.assign({ grid: { stroke: GRID, width: 1 }, ticks: { show: false }, gap: 6 + gutter, space: 34,
          size: function (u, texts) {
            if (chart.sides) return 1.6 * chart.sides[0];
            return texts ? 12 + gutter + 6.6 * Math.max.apply(null, texts.map(function (t) { return t.length; })) : 40;
          } }, axis, chart.yNamed ? {} : { values: function (u, splits) { return splits.map(function () { return ""; }); } })
      ],
      series: [{}, { points: { show: false } }],
      hooks: {
        drawClear: [function (u) { under(u, chart, on); }],
        draw: [function (u) { over(u, chart, on); }],
        setCursor: [function (u) {
          if (u.cursor.event && u.cursor.left >= 0)
            values(line, charts, chart, on, u.posToVal(u.cursor.left, "x"), u.posToVal(u.cursor.top, "y"));
        }],
        setScale: [function (u, key) {
          var near = 1e-4 * (chart.range[1] - chart.range[0]);
          if (key === "x")
            moved(u.scales.x.min > chart.range[0] + near || u.scales.x.max < chart.range[1] - near);
        }]
      }
    });
    var made = new uPlot(options, [xs, new Array(xs.length).fill(null)], element("div", "live", box));
    new ResizeObserver(function () {
      var wanted = size();
      if (wanted.width !== made.width || wanted.height !== made.height) made.setSize(wanted);
    }).observe(box);
    return made;
  }

  function names(entry, parent) {  // what the marks mean, once each
    var known = new Set(), line = element("p", "names", parent);
    entry.charts.forEach(function (c) {
      c.series.forEach(function (s) {
        if (!c.legend || !s.label || known.has(s.label)) return;
        known.add(s.label);
        var one = element("span", "", line), glyph = element("b", "", one);
        glyph.textContent = (s.dashed ? "\u2013 \u2013" : s.hollow && OPEN[s.mark] || GLYPHS[s.mark || ""]) + " ";
        glyph.style.color = s.color;
        say(one, s.label);
      });
    });
    if (!known.size) line.remove();
  }

  function figure(entry) {
    var whole = document.getElementById("figure-" + entry.n), still = whole.querySelector(".still"), on = {}, plots = [];
    var drawn = element("div", "");
    still.after(drawn);
    names(entry, drawn);
    var holder = element("div", "charts " + entry.layout, drawn), boxes = entry.charts.map(function (chart) {
      var box = element("div", "chart", holder);
      box.style.gridColumn = chart.column;
      return box;
    });
    holder.style.gridTemplateColumns = entry.widths.map(function (wide) { return wide + "fr"; }).join(" ");
    var bar = element("div", "controls"), line = element("p", "values");
    drawn.append(bar, line);
    var hint = "Point at a curve for its values; drag to zoom.";
    line.textContent = hint;
    var reset = element("button", "", bar);
    reset.type = "button"; reset.textContent = "Whole range"; reset.hidden = true;
    reset.addEventListener("click", function () {
      plots.forEach(function (u) { u.setScale("x", { min: u.data[0][0], max: u.data[0][u.data[0].length - 1] }); });
    });
    var methods = new Set();
    entry.charts.forEach(function (c) { c.series.forEach(function (s) { if (s.method) methods.add(s.method); }); });
    if (methods.size) element("span", "", bar).textContent = "Other methods on the same data:";
    methods.forEach(function (method) {
      var button = element("button", "", bar);
      button.type = "button"; button.setAttribute("aria-pressed", "false");
      say(button, method);
      button.addEventListener("click", function () {
        on[method] = !on[method];
        button.setAttribute("aria-pressed", String(on[method]));
        plots.forEach(function (u) { u.setScale("x", { min: u.scales.x.min, max: u.scales.x.max }); u.redraw(false); });
      });
    });
    entry.charts.forEach(function (chart, i) {
      boxes[i].dataset.key = entry.n + "-";
      plots.push(plot(chart, boxes[i], on, entry.charts, line, function (zoomed) { reset.hidden = !zoomed; }));
      var live = boxes[i].querySelector(".live");
      live.setAttribute("role", "img");
      live.setAttribute("aria-label", chart.alt);
    });
    holder.addEventListener("mouseleave", function () { line.textContent = hint; });
    whole.classList.add("drawn");
  }

  function start() {
    JSON.parse(store.textContent).forEach(function (entry) {
      var still = document.querySelector("#figure-" + entry.n + " .still");
      var seen = new ResizeObserver(function () {
        if (!still.clientWidth) return;
        seen.disconnect();
        figure(entry);
      });
      if (still) seen.observe(still);
    });
  }
  if (document.fonts && document.fonts.ready) document.fonts.ready.then(start, start); else start();
})();
