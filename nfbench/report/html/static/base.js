// What the other scripts share: the data, numbers as text, elements, and the methods that the figures show.
"use strict";
const NF = { data: JSON.parse(document.getElementById("data").textContent), listeners: [], hidden: new Set(), most: 10 };

NF.number = (v) => (v === "inf" ? Infinity : v === "-inf" ? -Infinity : v === null || v === undefined ? NaN : v);

// Three significant digits, with an exponent only for very small and very large numbers.
NF.text = (v) => {
  v = NF.number(v);
  if (Number.isNaN(v)) return "–";
  if (!Number.isFinite(v)) return v > 0 ? "∞" : "−∞";
  if (v === 0) return "0";
  const size = Math.abs(v);
  if (size >= 1e4 && size < 1e7) return Math.round(Number(v.toPrecision(3))).toLocaleString("en-US");
  const short = size >= 1e-4 && size < 1e7 ? String(Number(v.toPrecision(3))) : v.toExponential(2).replace("e+", "e");
  return short.replace("-", "−");
};
NF.percent = (v) => (Number.isNaN(NF.number(v)) ? "–" : `${Math.round(100 * v)} %`);
NF.range = (low, high, show = NF.text) => {
  if (Number.isNaN(NF.number(low)) || Number.isNaN(NF.number(high))) return "";
  return show(low) === show(high) && low !== 0 ? `≈ ${show(low)}` : `${show(low)} – ${show(high)}`;
};

// An element; text is set as text, never as markup.
NF.el = (tag, attributes = {}, ...children) => {
  const space = ["svg", "line", "path", "circle", "rect", "image", "text", "g", "polyline"].includes(tag);
  const node = space ? document.createElementNS("http://www.w3.org/2000/svg", tag) : document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value === true) node.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) node.setAttribute(name, value);
  }
  for (const child of children.flat()) if (child !== null && child !== undefined) node.append(child);
  return node;
};

// The name of a method, which may break after a bracket or before the budget.
NF.name = (method) => {
  const parts = NF.data.methods[method].split(/(?<=[(,=+])(?=\S)|(?=@)/);
  return parts.flatMap((part, i) => (i ? [NF.el("wbr"), part] : [part]));
};

NF.select = (label, options, value, change) => {
  const box = NF.el("select", { onchange: (event) => change(Number(event.target.value)) });
  options.forEach((text, i) => box.append(NF.el("option", { value: i, selected: i === value }, text)));
  return NF.el("label", { class: "control" }, NF.el("span", {}, label), box);
};

// The point at which the most scenes are missed: what is shown of one point begins there.
NF.misses = (table) => (table ? table.hits.reduce((sum, column, c) => sum + column.filter((h) => h < table.runs[c]).length, 0) : -1);
NF.worst = NF.data.scenes.reduce((worst, table, p) => (NF.misses(table) > NF.misses(NF.data.scenes[worst]) ? p : worst), 0);

// Methods: each that is shown has a slot, which decides its colour, its dashes and its marker.
NF.slots = NF.data.shown.slice();
NF.dashes = [[], [7, 4], [2, 3], [9, 3, 2, 3], [4, 2], [12, 4], [1, 2], [6, 2, 1, 2, 1, 2], [3, 6], [10, 2]];
NF.markers = ["circle", "square", "triangle", "diamond", "cross", "down", "plus", "ring", "box", "star"];
NF.look = (method) => {
  const slot = Math.max(NF.slots.indexOf(method), 0) % NF.most;
  const colour = getComputedStyle(document.documentElement).getPropertyValue(`--series-${slot}`).trim();
  return { colour, dash: NF.dashes[slot], marker: NF.markers[slot] };
};
NF.visible = () => NF.slots.filter((method) => !NF.hidden.has(method));
NF.changed = () => NF.listeners.forEach((draw) => draw());
NF.onchange = (draw) => { NF.listeners.push(draw); draw(); };

// The path of a marker around (x, y).
NF.mark = (kind, x, y, r) => {
  const path = new Path2D(NF.shape(kind, x, y, r));
  return { path, hollow: ["cross", "plus", "ring", "box", "star"].includes(kind) };
};
NF.shape = (kind, x, y, r) => {
  const polygon = (...pairs) => "M" + pairs.map(([a, b]) => `${x + a * r},${y + b * r}`).join("L") + "Z";
  const strokes = (...lines) => lines.map(([a, b, c, d]) => `M${x + a * r},${y + b * r}L${x + c * r},${y + d * r}`).join("");
  switch (kind) {
    case "square": case "box": return polygon([-0.85, -0.85], [0.85, -0.85], [0.85, 0.85], [-0.85, 0.85]);
    case "triangle": return polygon([0, -1.1], [1, 0.8], [-1, 0.8]);
    case "down": return polygon([0, 1.1], [1, -0.8], [-1, -0.8]);
    case "diamond": return polygon([0, -1.2], [1.1, 0], [0, 1.2], [-1.1, 0]);
    case "cross": return strokes([-1, -1, 1, 1], [-1, 1, 1, -1]);
    case "plus": return strokes([-1.2, 0, 1.2, 0], [0, -1.2, 0, 1.2]);
    case "star": return strokes([-1, -1, 1, 1], [-1, 1, 1, -1], [-1.2, 0, 1.2, 0], [0, -1.2, 0, 1.2]);
    default: return `M${x - r},${y}a${r},${r} 0 1,0 ${2 * r},0a${r},${r} 0 1,0 ${-2 * r},0Z`;
  }
};
NF.sample = (method) => {
  const look = NF.look(method), { hollow } = NF.mark(look.marker, 0, 0, 1);
  return NF.el("svg", { width: 34, height: 14, viewBox: "0 0 34 14", "aria-hidden": "true" },
    NF.el("line", { x1: 0, y1: 7, x2: 34, y2: 7, stroke: look.colour, "stroke-width": 2, "stroke-dasharray": look.dash.join(" ") }),
    NF.el("path", { d: NF.shape(look.marker, 17, 7, 4), stroke: look.colour, "stroke-width": 1.6,
      fill: hollow ? "var(--paper)" : look.colour }));
};

// The legend of a figure: a button for each method, which hides it in all figures.
NF.legend = (host, methods = NF.slots) => {
  const focused = host.contains(document.activeElement) ? document.activeElement.dataset.method : null;
  host.replaceChildren(...methods.map((method) => NF.el("button", {
    type: "button", class: "key", "aria-pressed": String(!NF.hidden.has(method)), "data-method": method,
    onclick: () => { if (!NF.hidden.delete(method)) NF.hidden.add(method); NF.changed(); },
  }, NF.sample(method), NF.el("span", {}, NF.name(method)))));
  if (focused !== null) host.querySelector(`[data-method="${focused}"]`)?.focus();
};

// The list from which methods are chosen for all figures.
NF.picker = (host) => {
  const note = NF.el("p", { class: "note", role: "status" });
  const list = NF.el("div", { class: "choices" });
  const filter = NF.el("input", { type: "search", oninput: () => show() });
  const show = () => {
    const wanted = filter.value.toLowerCase();
    list.replaceChildren(...NF.data.methods.map((name, method) => [name, method])
      .filter(([name]) => name.toLowerCase().includes(wanted)).map(([name, method]) => NF.el("label", {},
        NF.el("input", { type: "checkbox", checked: NF.slots.includes(method), onchange: (event) => pick(event, method) }), name)));
    note.textContent = `${NF.slots.length} of ${NF.data.methods.length} methods are shown; at most ${NF.most} fit.`;
  };
  const pick = (event, method) => {
    if (!event.target.checked) NF.slots = NF.slots.filter((each) => each !== method);
    else if (NF.slots.length < NF.most) NF.slots = [...NF.slots, method];
    else event.target.checked = false;
    note.textContent = `${NF.slots.length} of ${NF.data.methods.length} methods are shown; at most ${NF.most} fit.`;
    NF.hidden.delete(method);
    NF.changed();
  };
  host.append(NF.el("summary", {}, "Choose the methods in the figures"),
    NF.el("label", { class: "control" }, NF.el("span", {}, "Filter"), filter), list, note);
  show();
};
