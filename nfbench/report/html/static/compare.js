// The figures that compare methods: measures, expected running times, distributions, and error against budget.
"use strict";
(() => {
  const d = NF.data, state = { measure: 0, point: NF.worst, axis: 0, ert: 0, target: 0, cost: 0, cpoint: NF.worst, which: 0, ppoint: NF.worst, epoint: NF.worst };
  const costs = Object.keys(d.distributions), costNames = { evaluations: "evaluations", seconds: "seconds" };
  // without a solver a method makes no evaluations: if that is the best one, costs are compared in seconds at first
  const idle = (m) => d.measures.some((one) => one.name === "Evaluations per run" && one.value[m].every((v) => v === 0 || v === null));
  const timed = d.methods.length > 0 && idle(0);
  state.measure = Math.max(d.bound ? d.measures.findIndex((m) => m.bounded) : 0, 0); // that with the bound
  const several = d.points.length > 1, counts = d.axes.map((a) => new Set(a.texts).size);
  state.axis = Math.max(counts.indexOf(Math.max(...counts)), 0);
  const pointSelect = (name, draw, label = "Swept point") => (several ? [NF.select(label, d.points, state[name], (v) => { state[name] = v; draw(); })] : []);
  const pick = (values, places) => (values ? places.map((p) => NF.number(values[p])) : null);

  // The points that differ from the chosen one in one swept key alone, in the order of their values.
  const along = (axis, point) => {
    const same = d.points.map((_, p) => p).filter((p) => d.axes.every((a, k) => k === axis || a.texts[p] === a.texts[point]));
    return d.axes[axis].values ? same.sort((p, q) => d.axes[axis].values[p] - d.axes[axis].values[q]) : same;
  };
  const dots = (measure, point) => {
    const methods = NF.visible().filter((m) => Number.isFinite(NF.number(measure.value[m][point])))
      .sort((a, b) => (measure.log ? 1 : -1) * (measure.value[a][point] - measure.value[b][point]));
    const named = (fits) => NF.visible().filter((m) => fits(measure.value[m][point])).map((m) => d.methods[m]);
    const never = named((v) => v === "inf"), none = named((v) => v === null);
    const bound = measure.bounded && d.bound && d.bound[point] !== null ? NF.number(d.bound[point]) : null;
    return {
      title: measure.name, rows: methods.map((m) => d.methods[m]),
      series: methods.map((m, i) => ({ method: m, name: d.methods[m], x: [NF.number(measure.value[m][point])], y: [i],
        low: pick(measure.low?.[m], [point]), high: pick(measure.high?.[m], [point]) })),
      x: { label: measure.name, log: measure.log, ...(bound === null ? {} : { include: [bound], line: bound }) }, y: { label: "method" },
      note: [bound === null ? "" : `The dashed line is the Cramér–Rao bound, ${NF.text(bound)} m (root mean square over the scenes).`,
        never.length ? `Never: ${never.join(", ")}.` : "", none.length ? `Without a value: ${none.join(", ")}.` : ""].filter(Boolean).join(" "),
    };
  };
  const lines = (measure, axis, point) => {
    const places = along(axis, point), key = d.axes[axis], spots = places.map((p, i) => (key.values ? key.values[p] : i));
    const log = Boolean(key.values) && key.log;
    const series = NF.visible().map((m) => ({ method: m, name: d.methods[m], x: spots, y: pick(measure.value[m], places),
      low: pick(measure.low?.[m], places), high: pick(measure.high?.[m], places) }));
    const bound = measure.bounded && d.bound ? pick(d.bound, places) : [], known = bound.filter(Number.isFinite).length;
    if (known) series.push({ name: "Cramér–Rao bound", x: spots, y: bound, bare: known > 1 });
    return { title: measure.name, series, x: { label: key.name, log, texts: key.values ? null : places.map((p) => key.texts[p]) },
      y: { label: measure.name, log: measure.log },
      note: (known ? `The dotted ${known > 1 ? "line" : "cross"} without a colour is the Cramér–Rao bound, the root mean square over the scenes. ` : "") +
        (d.axes.length > 1 ? `Here ${d.axes.filter((_, k) => k !== axis).map((a) => `${a.name} is ${a.texts[point]}`).join(" and ")}.` : "") };
  };

  NF.picker(document.getElementById("picker"));
  NF.figure("figure-measures", (draw) => [
    NF.select("Measure", d.measures.map((m) => m.name), state.measure, (v) => { state.measure = v; draw(); }),
    ...(several ? [NF.select("Along", [...d.axes.map((a) => a.name), "one point"], state.axis, (v) => { state.axis = v; draw(); })] : []),
    ...(state.axis === d.axes.length ? pointSelect("point", draw) : d.axes.length > 1 ? pointSelect("point", draw, "Other values as at") : []),
  ], () => {
    const measure = d.measures[state.measure];
    return several && state.axis < d.axes.length ? lines(measure, state.axis, state.point) : dots(measure, state.point);
  });

  const erts = d.measures.filter((m) => m.ert);
  if (timed) {
    state.ert = Math.max(erts.findIndex((m) => m.name.startsWith("Seconds")), 0);
    state.cost = Math.max(costs.indexOf("seconds"), 0);
  }
  if (erts.length)
    NF.figure("figure-ert", (draw) => [
      NF.select("Cost and target", erts.map((m) => m.name), state.ert, (v) => { state.ert = v; draw(); }), ...pointSelect("epoint", draw),
    ], () => dots(erts[state.ert], state.epoint));

  if (d.targets.length)
    NF.figure("figure-distribution", (draw) => [
      NF.select("Target", d.targets, state.target, (v) => { state.target = v; draw(); }),
      NF.select("Cost", costs.map((c) => costNames[c]), state.cost, (v) => { state.cost = v; draw(); }), ...pointSelect("cpoint", draw),
    ], () => {
      const cost = costs[state.cost], curve = d.distributions[cost][state.target][state.cpoint];
      const least = cost === "seconds" ? 1e-6 : 0.5, drawn = NF.visible().filter((m) => curve[m]);
      const end = Math.max(...drawn.map((m) => curve[m][0].at(-1)));
      const series = drawn.map((m) => {
        const x = curve[m][0].map((v) => Math.max(NF.number(v), least)), y = curve[m][1].map((v) => v / 10);
        if (x.at(-1) === least && end > least) { x.push(end); y.push(y.at(-1)); } // it costs nothing
        if (y[0] > 0) { x.unshift(x[0] * 0.9999); y.unshift(0); }
        return { method: m, name: d.methods[m], x, y, stepped: true };
      });
      return { title: "Runtime distribution", series, x: { label: cost, log: true }, y: { label: `runs that reach ${d.targets[state.target]} [%]`, span: [-3, 103] },
        note: "Higher and further left is better. Each curve ends at the budget of its method, or at its longest run." + (cost === "evaluations" ? " A method without a solver makes no evaluations, so that its curve is flat." : "") };
    });

  const kinds = Object.keys(d.progress), names = { error: `${d.error}`, gap: "gap to the reference optimum of the first problem" };
  if (kinds.length)
    NF.figure("figure-progress", (draw) => [
      NF.select("Measure", kinds.map((k) => names[k]), state.which, (v) => { state.which = v; draw(); }), ...pointSelect("ppoint", draw),
    ], () => {
      const kind = kinds[state.which], { x, m } = d.progress[kind][state.ppoint], shown = NF.visible();
      const drawn = shown.filter((method) => m[method]), missing = shown.filter((method) => !m[method]).map((method) => d.methods[method]);
      const series = drawn.map((method) => ({ method, name: d.methods[method], x: x.map(NF.number),
        y: m[method][0].map(NF.number), low: m[method][1].map(NF.number), high: m[method][2].map(NF.number) }));
      return { title: "Error against budget", series, x: { label: "evaluations", log: true }, y: { label: `median ${names[kind]}`, log: true },
        note: `The median over the scenes of what is reached within a budget, with its 95 % interval. A curve ends at the largest number of evaluations that a run made. A point at the end alone means that the value on the way is not known.${missing.length ? ` Without a curve here: ${missing.join(", ")}.` : ""}` };
    });
})();
