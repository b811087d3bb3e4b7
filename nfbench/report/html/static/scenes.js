// The view of single scenes: which are hard, and for whom; and the positions, traces and landscapes of one of them.
"use strict";
(() => {
  const d = NF.data, host = document.getElementById("scene-map"), detail = document.getElementById("scene-detail");
  const state = { point: 0, scene: null, trace: 0, methods: 0 };
  state.point = NF.worst;
  if (d.methods.length <= 12) state.methods = 2;
  const sets = ["the methods in the figures", "the best 25 methods", "all methods"];
  const kinds = Object.keys(d.traces).filter((kind) => Object.keys(d.traces[kind]).length);

  const symbol = (table, column, row) => {
    const hits = table.hits[column][row], runs = table.runs[column], failed = table.failed[column]?.[row] ?? 0;
    if (hits === runs) return ["●", "hit", "reached"];
    if (failed === runs) return ["✕", "failed", "failed"];
    return hits ? ["◐", "partly", `reached in ${hits} of ${runs} runs`] : ["○", "miss", "missed"];
  };
  // How the sources of a scene lie, as seen from the origin: the smallest angle between two, and the distances.
  const facts = (point, scene) => {
    const truth = d.places[point]?.[scene]?.truth;
    if (!truth || !truth.length) return null;
    const far = truth.map((p) => Math.hypot(...p));
    const angle = (i, j) => (180 / Math.PI) * Math.acos(Math.min(Math.max(truth[i].reduce((sum, v, k) => sum + v * truth[j][k], 0) / (far[i] * far[j]), -1), 1));
    let closest = null;
    for (let i = 0; i < truth.length; i++)
      for (let j = 0; j < i; j++) if (closest === null || angle(i, j) < closest) closest = angle(i, j);
    return { closest, far: far.sort((a, b) => a - b) };
  };
  const factCells = (one) => [NF.el("td", {}, one && one.closest !== null ? NF.text(one.closest) : "–"),
    NF.el("td", {}, one ? one.far.map(NF.text).join(", ") : "–")];
  const columnsOf = (table) => {
    const wanted = state.methods === 0 ? NF.slots : state.methods === 1 ? table.methods.slice(0, 25) : table.methods;
    return wanted.map((m) => table.methods.indexOf(m)).filter((c) => c >= 0);
  };

  const map = () => {
    const table = d.scenes[state.point];
    const active = document.activeElement, index = host.contains(active) ? [...host.querySelectorAll("select")].indexOf(active) : -1;
    const controls = NF.el("div", { class: "controls" },
      d.points.length > 1 ? NF.select("Swept point", d.points, state.point, (v) => { state.point = v; state.scene = null; map(); show(); }) : null,
      NF.select("Columns", sets, state.methods, (v) => { state.methods = v; map(); }));
    if (!table || !table.scenes.length) {
      host.replaceChildren(controls, NF.el("p", { class: "empty" }, "No scene was finished by all methods here."));
      return;
    }
    const columns = columnsOf(table), goal = table.target || "an estimate";
    const known = table.scenes.some((scene) => facts(state.point, scene));
    const head = NF.el("tr", {}, NF.el("th", { scope: "col" }, "scene"), NF.el("th", { scope: "col" }, `solved by, of ${table.all}`),
      known ? [["closest", "pair [°]"], ["distances", "[m]"]].map((lines) => NF.el("th", { scope: "col" }, lines[0], NF.el("br"), lines[1])) : null,
      columns.map((c) => NF.el("th", { scope: "col", class: "turned" }, NF.el("span", {}, NF.name(table.methods[c])))));
    const rows = table.scenes.map((scene, r) => NF.el("tr", {},
      NF.el("th", { scope: "row" }, NF.el("button", { type: "button", class: "link", onclick: () => { state.scene = scene; show(); detail.scrollIntoView({ block: "start" }); } }, String(scene))),
      NF.el("td", {}, NF.el("meter", { min: 0, max: table.all, value: table.solved[r], "aria-hidden": "true" }), ` ${table.solved[r]}`),
      known ? factCells(facts(state.point, scene)) : null,
      columns.map((c) => {
        const [glyph, kind, words] = symbol(table, c, r);
        return NF.el("td", { class: `mark ${kind}`, title: `${d.methods[table.methods[c]]}, scene ${scene}: ${words}, error ${NF.text(table.error[c][r])}` },
          NF.el("span", { "aria-label": words, role: "img" }, glyph));
      })));
    const missed = columns.map((c) => [c, table.hits[c].reduce((n, h) => n + (h < table.runs[c]), 0)]);
    const foot = NF.el("tr", {}, NF.el("th", { scope: "row", colspan: known ? 4 : 2 }, "scenes not solved"), missed.map(([, n]) => NF.el("td", { class: "mark" }, String(n))));
    const top = host.querySelector(".scroll")?.scrollTop ?? 0;
    host.replaceChildren(controls,
      NF.el("p", { class: "note" }, `The hardest of ${table.scenes.length} scenes comes first, by the share of hits and then by the median error; scroll down for the others. ● reached ${goal} in all runs, ◐ in some, ○ missed it, ✕ no estimate. Press a scene's number to open it.`),
      NF.el("div", { class: "scroll tall", tabindex: 0, role: "region", "aria-label": "Scenes and methods" },
        NF.el("table", { class: "map" }, NF.el("thead", {}, head), NF.el("tbody", {}, rows), NF.el("tfoot", {}, foot))));
    host.querySelector(".scroll").scrollTop = top;
    if (index >= 0) host.querySelectorAll("select")[index]?.focus();
  };

  // A landscape: stars at the true positions, and a ring at the best point.
  const picture = (one) => {
    const [x0, x1, y0, y1] = one.box.map(NF.number), w = 330, h = 200, l = 46, b = 36;
    const px = (v) => l + ((v - x0) / (x1 - x0)) * w, py = (v) => 8 + (1 - (v - y0) / (y1 - y0)) * h;
    const text = (x, y, words, anchor = "middle") => NF.el("text", { x, y, "text-anchor": anchor, "font-size": 12, fill: "currentColor" }, words);
    const ring = (width, colour) => NF.el("circle", { cx: px(one.lowest[0]), cy: py(one.lowest[1]), r: 8, fill: "none", stroke: colour, "stroke-width": width });
    const star = ([x, y]) => [["#000", 4], ["#fff", 1.8]].map(([colour, width]) => NF.el("path", { d: NF.shape("star", px(x), py(y), 5), fill: "none", stroke: colour, "stroke-width": width }));
    const svg = NF.el("svg", { viewBox: `0 0 ${l + w + 12} ${h + 8 + b}`, role: "img", "aria-label": `Landscape of ${one.name} in scene ${one.scene}` },
      NF.el("image", { x: l, y: 8, width: w, height: h, preserveAspectRatio: "none", href: `data:image/png;base64,${one.png}` }),
      NF.el("rect", { x: l, y: 8, width: w, height: h, fill: "none", stroke: "currentColor" }), ring(4, "#000"), ring(2, "#fff"), one.marks.flatMap(star),
      text(px(x0), h + 24, NF.text(x0), "start"), text(px(x1), h + 24, NF.text(x1), "end"), text(l + w / 2, h + 38, one.axes[0]),
      text(l - 5, py(y0), NF.text(y0), "end"), text(l - 5, py(y1) + 10, NF.text(y1), "end"), NF.el("text", { transform: `translate(14 ${8 + h / 2}) rotate(-90)`, "text-anchor": "middle", "font-size": 12, fill: "currentColor" }, one.axes[1]));
    const where = `scene ${one.scene}${d.points.length > 1 ? `, ${d.points[one.point]}` : ""}`, fixed = one.unknowns > 2;
    const words = one.marks.length
      ? `${one.name}, ${where}. ${one.about ? `${one.about} ` : ""}Darker is better, by rank; stars are the true positions, the ring is the best point of the picture.${fixed ? ` The other ${one.unknowns - 2} unknowns are the true ones.` : ""}`
      : `${one.name}, ${where}: the objective of the first problem over two unknowns. Darker is smaller, by rank; the ring is the best point of any run.${fixed ? ` The other ${one.unknowns - 2} unknowns are those of this point.` : ""}`;
    return NF.el("figure", { class: "landscape" }, svg, NF.el("figcaption", {}, words));
  };

  // True and found positions in the plane in which they vary, with the array.
  const positions = (target, place, methods, cloud) => {
    const all = [...place.truth, ...cloud], spread = [0, 1, 2].map((k) => Math.max(...all.map((p) => p[k])) - Math.min(...all.map((p) => p[k])));
    const [i, j] = [0, 1, 2].sort((a, b) => spread[b] - spread[a]).slice(0, 2).sort(), names = "xyz", series = [];
    const put = (name, points, more) => { if (points.length) series.push({ name, x: points.map((p) => p[i]), y: points.map((p) => p[j]), dots: true, ...more }); };
    const all2 = NF.chart(target, { series: (put("other scenes", cloud, { marker: "ring", faint: true }), put("array", d.elements ?? [[0, 0, 0]], { marker: "box" }),
      put("true position", place.truth, { marker: "star", large: true }), methods.forEach((m) => put(d.methods[m], place.found[m] ?? [], { method: m, open: true })), series),
    x: { label: `${names[i]} [m]` }, y: { label: `${names[j]} [m]` }, equal: true, title: "Positions", height: 380 });
    return all2;
  };

  const show = () => {
    const table = d.scenes[state.point];
    if (!detail || !table || !table.scenes.length) { detail?.replaceChildren(); return; }
    if (state.scene === null) state.scene = table.scenes[0];
    const row = table.scenes.indexOf(state.scene), place = d.places[state.point]?.[state.scene];
    const step = (by) => { state.scene = table.scenes[(row + by + table.scenes.length) % table.scenes.length]; show(); };
    const focused = document.activeElement?.dataset?.step, selecting = detail.contains(document.activeElement) && document.activeElement.tagName === "SELECT";
    const controls = NF.el("div", { class: "controls" },
      NF.select("Scene (hardest first)", table.scenes.map((s, r) => `${s}: solved by ${table.solved[r]} of ${table.all}`), row, (v) => { state.scene = table.scenes[v]; show(); }),
      NF.el("button", { type: "button", "data-step": -1, onclick: () => step(-1) }, "Harder"),
      NF.el("button", { type: "button", "data-step": 1, onclick: () => step(1) }, "Easier"),
      kinds.length > 1 ? NF.select("Traces of", kinds.map((k) => (k === "gap" ? "gap" : d.error)), state.trace, (v) => { state.trace = v; show(); }) : null);
    const plane = NF.el("div", { class: "chart" }), curves = NF.el("div", { class: "chart" }), keys = NF.el("div", { class: "legend", role: "group", "aria-label": "Methods in this figure" });
    const lands = d.landscapes.filter((one) => one.point === state.point && one.scene === state.scene);
    const elsewhere = d.landscapes.filter((one) => one.point === state.point).map((one) => one.scene);
    const errors = NF.el("table", {}, NF.el("thead", {}, NF.el("tr", {}, ["method", d.error, "target"].map((t) => NF.el("th", { scope: "col" }, t)))),
      NF.el("tbody", {}, NF.slots.map((m) => table.methods.indexOf(m)).filter((c) => c >= 0).map((c) => NF.el("tr", {},
        NF.el("th", { scope: "row" }, NF.name(table.methods[c])), NF.el("td", {}, NF.text(table.error[c][row])), NF.el("td", {}, symbol(table, c, row).filter((_, k) => k !== 1).join(" "))))));
    detail.replaceChildren(NF.el("h3", {}, `Scene ${state.scene}${d.points.length > 1 ? ` at ${d.points[state.point]}` : ""}`), controls, NF.el("div", { class: "pair" },
      NF.el("div", {}, NF.el("h4", {}, "Truth and estimates"), plane), NF.el("div", {}, NF.el("h4", {}, "Traces"), curves)), keys,
    NF.el("div", { class: "scroll" }, errors),
    lands.length ? NF.el("div", { class: "pair three" }, lands.map(picture))
      : NF.el("p", { class: "note" }, d.landscapes.length ? `There is a picture of the landscape for the scenes ${[...new Set(elsewhere)].join(", ") || "of other points"} only.` : "There is no picture of the landscape."));
    if (place) {
      positions(plane, place, NF.visible(), []);
      const { closest, far } = facts(state.point, state.scene);
      plane.append(NF.el("p", { class: "note" }, `Stars are the true positions, at ${far.map(NF.text).join(", ")} m from the origin${closest === null ? "" : `; the two closest are ${NF.text(closest)}° apart as seen from it`}. Boxes are the elements of the array. Marks of the methods may lie on each other; the table below has their errors.`));
    }
    else plane.append(NF.el("p", { class: "empty" }, document.body.dataset.reason || "The positions of this scene are not in this page."));
    const kind = kinds[state.trace], lines = kind ? d.traces[kind][state.point]?.[state.scene] ?? {} : {};
    NF.chart(curves, { title: "Traces", series: NF.visible().filter((m) => lines[m]).map((m) => ({ method: m, name: d.methods[m], x: lines[m][0].map(NF.number), y: lines[m][1].map(NF.number), stepped: true })),
      x: { label: "evaluations", log: true }, y: { label: kind === "gap" ? "gap of the first problem" : d.error, log: true }, height: 380 });
    const untraced = NF.visible().filter((m) => !lines[m]).map((m) => d.methods[m]);
    if (untraced.length) curves.append(NF.el("p", { class: "note" }, `Without a trace: ${untraced.join(", ")}.`));
    NF.legend(keys);
    if (focused) detail.querySelector(`[data-step="${focused}"]`).focus();
    else if (selecting) detail.querySelector("select").focus();
  };

  // One draw of the scenario at the top of the page, before the sources of all other scenes.
  const draw = document.getElementById("scene-draw"), first = d.places[0] ?? Object.values(d.places)[0];
  if (draw && first) {
    const number = Math.min(...Object.keys(first).map(Number));
    const cloud = Object.entries(first).filter(([s]) => Number(s) !== number).flatMap(([, place]) => place.truth);
    NF.onchange(() => positions(draw, { truth: first[number].truth, found: {} }, [], cloud));
    document.getElementById("scene-words").textContent = `Scene ${number}${d.points.length > 1 ? ` at ${d.points[0]}` : ""}: stars are its sources, rings those of the other ${Object.keys(first).length - 1} scenes that this page holds, boxes the elements of the array.`;
  } else if (draw) draw.append(NF.el("p", { class: "empty" }, document.body.dataset.reason || "This scenario has no positions to show."));
  const lands = document.getElementById("scene-landscapes"), begin = d.landscapes[0];
  if (lands) lands.append(...d.landscapes.filter((one) => one.point === begin.point && one.scene === begin.scene).slice(0, 3).map(picture));
  NF.onchange(() => { map(); show(); });
})();
