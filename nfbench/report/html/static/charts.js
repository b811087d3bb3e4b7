// Draws figures with uPlot: lines or dots with intervals, logarithmic axes, and a readout for mouse and keyboard.
"use strict";

NF.css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

NF.usable = (v, log) => Number.isFinite(v) && (!log || v > 0);

// The ticks of a logarithmic axis that is so many pixels long: powers of ten, with multiples of them where there are few,
// or even steps; labels are at least gap pixels apart.
NF.logSplits = (low, high, pixels, gap) => {
  const ratio = high / low, first = Math.floor(Math.log10(low)), last = Math.ceil(Math.log10(high));
  const apart = (found, least) => found.every((v, i) => i === 0 || (Math.log(v / found[i - 1]) / Math.log(ratio)) * pixels >= least);
  if (ratio < 5) {
    const steps = [1, 2, 5, 10, 20, 50].map((f) => f * 10 ** Math.floor(Math.log10((high - low) / 10)));
    const even = steps.map((step) => Array.from({ length: Math.floor(high / step) - Math.ceil(low / step) + 1 },
      (_, i) => Number(((Math.ceil(low / step) + i) * step).toPrecision(12)))).filter((found) => found.length);
    return even.find((found) => apart(found, Math.max(gap, pixels / 6))) ?? even.at(-1).slice(0, 1);
  }
  const ticks = (factors, every) => {
    const found = [];
    for (let k = first; k <= last; k++)
      for (const f of k % every === 0 ? factors : []) {
        const v = Number(`${f}e${k}`);
        if (v >= low && v <= high) found.push(v);
      }
    return found;
  };
  const fine = ratio >= 1000 ? [] : ratio >= 30 ? [[1, 2, 5], [1, 3]] : [[1, 2, 3, 5, 7], [1, 2, 5], [1, 3]];
  const tried = [...fine.map((factors) => ticks(factors, 1)), ...Array.from({ length: last - first }, (_, k) => ticks([1], k + 1))];
  return tried.find((found) => found.length && apart(found, gap)) ?? tried[0].slice(0, 1);
};

NF.tick = (v) => {
  if (v === null) return "";
  const exponent = Math.round(Math.log10(Math.abs(v)));
  if (v !== 0 && (Math.abs(v) < 1e-3 || Math.abs(v) >= 1e6) && Math.abs(Math.abs(v) / 10 ** exponent - 1) < 1e-9)
    return (v < 0 ? "−" : "") + "10" + String(exponent).replace(/./g, (c) => "⁰¹²³⁴⁵⁶⁷⁸⁹"[c] ?? "⁻");
  return NF.text(v);
};

// One chart. view: {series: [{method, name, x, y, low, high, stepped, bare}], x: {label, log, texts}, y: {label, log},
// rows: labels of rows for dots, height, equal}. Returns the number of values that could not be drawn.
NF.chart = (host, view) => {
  host.chart?.destroy();
  host.replaceChildren();
  host.chart = null;
  let lost = 0;
  const series = view.series.map((one) => {
    const kept = one.x.map((_, i) => i).filter((i) => {
      const fine = NF.usable(one.x[i], view.x.log) && NF.usable(one.y[i], view.y.log);
      lost += !fine && !(Number.isNaN(one.y[i]) || Number.isNaN(one.x[i]));
      return fine;
    });
    const pick = (values) => (values ? kept.map((i) => values[i]) : null);
    return { ...one, x: pick(one.x), y: pick(one.y), low: pick(one.low), high: pick(one.high) };
  }).filter((one) => one.x.length);
  if (!series.length) {
    host.append(NF.el("p", { class: "empty" }, "Nothing to draw: no method that is shown has values here."));
    return lost;
  }
  const look = (one) => (one.method === undefined ? { colour: NF.css(one.faint ? "--muted" : "--ink"), dash: one.dash ?? [3, 3], marker: one.marker ?? "plus" } : NF.look(one.method));
  const ink = NF.css("--ink"), grid = NF.css("--line"), font = "12px system-ui, sans-serif";
  const width = Math.max(host.clientWidth, 260);
  const data = uPlot.join(series.map((one) => {
    const order = one.x.map((_, i) => i).sort((a, b) => one.x[a] - one.x[b]);
    return [order.map((i) => one.x[i]), order.map((i) => one.y[i])];
  }));
  const span = (which, log) => {
    const values = series.flatMap((one) => [...one[which], ...(which === "y" && !view.rows ? [...(one.low ?? []), ...(one.high ?? [])] : []),
      ...(which === "x" && view.rows ? [...(one.low ?? []), ...(one.high ?? [])] : [])]).filter((v) => NF.usable(v, log));
    const extra = (view[which].include ?? []).filter((v) => NF.usable(v, log));
    let low = Math.min(...values, ...extra), high = Math.max(...values, ...extra);
    if (log) {
      if (high / low < 1.6) { low /= 1.4; high *= 1.4; }
      const pad = (high / low) ** 0.04;
      return [low / pad, high * pad];
    }
    const pad = (high - low || Math.abs(high) || 1) * 0.05;
    return [low - pad, high + pad];
  };
  let spanX = view.x.span ?? span("x", view.x.log), spanY = view.rows ? [view.rows.length - 0.4, -0.75] : view.y.span ?? span("y", view.y.log);
  const height = view.rows ? 36 * view.rows.length + 64 : view.height ?? Math.min(Math.max(width * 0.6, 260), 420);
  if (view.equal) {
    const inner = [width - 90, height - 70], scale = Math.max((spanX[1] - spanX[0]) / inner[0], (spanY[1] - spanY[0]) / inner[1]);
    const widen = ([a, b], n) => [(a + b - scale * n) / 2, (a + b + scale * n) / 2];
    [spanX, spanY] = [widen(spanX, inner[0]), widen(spanY, inner[1])];
  }
  const axis = (which, settings) => ({
    stroke: ink, font, labelFont: font, label: settings.label, labelSize: 22, labelGap: 2, gap: 4,
    grid: { stroke: grid, width: 1 }, ticks: { stroke: grid, width: 1 },
    size: which === "x" ? 32 : 58, space: which === "x" ? 56 : 34,
    ...(settings.log ? { splits: (u, i, low, high) => NF.logSplits(low, high, ...(which === "x" ? [width - 84, 50] : [height - 64, 24])), filter: (u, splits) => splits } : {}),
    ...(settings.texts ? { splits: () => settings.texts.map((_, i) => i), values: () => settings.texts } : { values: (u, splits) => splits.map(NF.tick) }),
  });
  const options = {
    width, height, legend: { show: false }, padding: [10, 26, 0, 0],
    cursor: { drag: { x: false, y: false }, points: { show: false }, x: false, y: false },
    scales: {
      x: { time: false, distr: view.x.log ? 3 : 1, range: spanX },
      y: { distr: view.y.log && !view.rows ? 3 : 1, range: view.rows ? [spanY[0], spanY[1]] : spanY, dir: 1 },
    },
    axes: [axis("x", view.x), view.rows ? { show: false } : axis("y", view.y)],
    series: [{}, ...series.map((one) => ({
      label: one.name, stroke: look(one).colour, width: 2, dash: look(one).dash, spanGaps: true,
      points: { show: false }, ...(one.stepped ? { paths: uPlot.paths.stepped({ align: 1 }) } : {}),
      ...(one.dots || view.rows ? { paths: () => null } : {}),
    }))],
    hooks: {
      draw: [(u) => NF.overlay(u, series, view, look)],
      setCursor: [(u) => NF.hover(host, u, series, view)],
    },
  };
  const plot = NF.el("div", { class: "plot", tabindex: 0, role: "img", "aria-label": `${view.title ?? view.y.label}. Use the arrow keys to read values.` });
  host.append(plot, NF.el("div", { class: "readout", "aria-live": "polite" }));
  host.chart = new uPlot(options, data, plot);
  NF.keys(host, plot, series, view);
  return lost;
};

// Intervals, markers and the names of rows, which uPlot does not draw itself.
NF.overlay = (u, series, view, look) => {
  const c = u.ctx, ratio = devicePixelRatio, at = (v, scale) => u.valToPos(v, scale, true);
  const box = u.bbox;
  c.save();
  c.beginPath();
  c.rect(box.left - 6 * ratio, box.top - 6 * ratio, box.width + 12 * ratio, box.height + 12 * ratio);
  c.clip();
  if (view.rows && view.x.line !== undefined) {
    c.strokeStyle = NF.css("--ink");
    c.lineWidth = 1.5 * ratio;
    c.setLineDash([3 * ratio, 3 * ratio]);
    c.beginPath();
    c.moveTo(at(view.x.line, "x"), box.top);
    c.lineTo(at(view.x.line, "x"), box.top + box.height);
    c.stroke();
  }
  for (const one of series) {
    const { colour, marker } = look(one);
    c.strokeStyle = c.fillStyle = colour;
    c.lineWidth = 1.3 * ratio;
    c.setLineDash([]);
    const sparse = one.dots || view.rows || one.x.length <= 30;
    const every = one.stepped ? Math.ceil(one.x.length / 8) : sparse ? 1 : Math.ceil(one.x.length / 8);
    one.x.forEach((x, i) => {
      const px = at(x, "x"), py = at(one.y[i], "y");
      if (one.low && sparse && NF.usable(one.low[i], false)) {
        const ends = [one.low[i], one.high[i]].map((v) => (view.rows ? at(v > 0 || !view.x.log ? v : 1e-300, "x") : at(v > 0 || !view.y.log ? v : 1e-300, "y")));
        if (!Number.isFinite(ends[1])) ends[1] = view.rows ? box.left + box.width + 20 * ratio : box.top - 20 * ratio;
        c.beginPath();
        if (view.rows) { c.moveTo(ends[0], py); c.lineTo(ends[1], py); } else { c.moveTo(px, ends[0]); c.lineTo(px, ends[1]); }
        c.stroke();
      }
      if (one.bare || i % every) return;
      const { path, hollow } = NF.mark(marker, px, py, (one.large ? 6.5 : 4) * ratio);
      c.lineWidth = 1.6 * ratio;
      if (!hollow && !one.open) c.fill(path);
      c.stroke(path);
    });
  }
  if (view.rows) {
    c.fillStyle = NF.css("--ink");
    c.font = `${12 * ratio}px system-ui, sans-serif`;
    c.textBaseline = "bottom";
    c.textAlign = "left";
    view.rows.forEach((name, i) => {
      let text = name;
      while (text.length > 4 && c.measureText(text).width > box.width - 8 * ratio) text = text.slice(0, -2) + "…";
      const where = [text, box.left + 4 * ratio, at(i, "y") - 7 * ratio];
      c.strokeStyle = NF.css("--paper"); // no grid line or interval crosses the text
      c.lineWidth = 4 * ratio;
      c.strokeText(...where);
      c.fillText(...where);
    });
  }
  c.restore();
};

NF.say = (host, view, one, i) => {
  const ends = one.low ? NF.range(one.low[i], one.high[i]) : "";
  const x = view.x.texts ? view.x.texts[one.x[i]] : NF.text(one.x[i]);
  const text = view.rows
    ? `${one.name}: ${NF.text(one.x[i])}${ends ? `, 95 % interval ${ends}` : ""}`
    : `${one.name}: ${view.y.label} ${NF.text(one.y[i])}${ends ? ` (95 % interval ${ends})` : ""} at ${view.x.label} ${x}`;
  host.querySelector(".readout").textContent = text;
};

NF.hover = (host, u, series, view) => {
  const { left, top } = u.cursor, readout = host.querySelector(".readout");
  if (!readout || left === undefined || left < 0) return;
  let best = null, distance = 40;
  for (const one of series)
    one.x.forEach((x, i) => {
      const d = Math.hypot(u.valToPos(x, "x") - left, u.valToPos(one.y[i], "y") - top);
      if (d < distance) [best, distance] = [[one, i], d];
    });
  if (best) NF.say(host, view, ...best);
};

NF.keys = (host, plot, series, view) => {
  let s = 0, i = 0;
  plot.addEventListener("keydown", (event) => {
    const along = view.rows ? { ArrowUp: -1, ArrowDown: 1 } : { ArrowLeft: -1, ArrowRight: 1 };
    const across = view.rows ? {} : { ArrowUp: -1, ArrowDown: 1 };
    if (event.key in along) {
      if (view.rows) s = (s + along[event.key] + series.length) % series.length;
      else i = Math.min(Math.max(i + along[event.key], 0), series[s].x.length - 1);
    } else if (event.key in across) {
      s = (s + across[event.key] + series.length) % series.length;
      i = Math.min(i, series[s].x.length - 1);
    } else return;
    event.preventDefault();
    NF.say(host, view, series[s], i);
  });
};

// A figure: controls, chart, legend, and the drawn values as a table.
NF.figure = (id, controls, view) => {
  const host = document.getElementById(id);
  if (!host) return;
  const box = NF.el("div", { class: "controls" }), chart = NF.el("div", { class: "chart" });
  const note = NF.el("p", { class: "note" }), keys = NF.el("div", { class: "legend", role: "group", "aria-label": "Methods in this figure" });
  const values = NF.el("div", { class: "scroll" });
  const details = NF.el("details", { ontoggle: () => fill() }, NF.el("summary", {}, "The values as a table"), values);
  host.append(box, chart, note, keys, details);
  let last = null;
  const fill = () => {
    if (!details.open || !last) return;
    const ranged = last.series.some((one) => one.low), interval = ranged ? ["95 % interval"] : [];
    const head = NF.el("tr", {}, ["method", ...(last.rows ? ["value"] : [last.x.label, last.y.label]), ...interval].map((t) => NF.el("th", { scope: "col" }, t)));
    const rows = last.series.flatMap((one) => one.x.slice(0, 100).map((x, i) => {
      const shown = last.x.texts ? last.x.texts[x] : NF.text(x), ends = one.low ? NF.range(one.low[i], one.high[i]) : "";
      return NF.el("tr", {}, [one.name, shown, ...(last.rows ? [] : [NF.text(one.y[i])]), ...(ranged ? [ends] : [])].map((t) => NF.el("td", {}, t)));
    }));
    values.replaceChildren(NF.el("table", {}, NF.el("thead", {}, head), NF.el("tbody", {}, rows)));
  };
  const draw = () => {
    const active = box.contains(document.activeElement) ? [...box.querySelectorAll("select")].indexOf(document.activeElement) : -1;
    box.replaceChildren(...controls(draw));
    if (active >= 0) box.querySelectorAll("select")[active]?.focus();
    last = view();
    const lost = NF.chart(chart, last);
    note.textContent = [last.note, lost ? `${lost} values are not drawn: they are infinite, or not above 0 on a logarithmic axis.` : ""].filter(Boolean).join(" ");
    NF.legend(keys);
    fill();
  };
  NF.onchange(draw);
};
