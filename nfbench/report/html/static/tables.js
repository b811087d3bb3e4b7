// Tables that sort and filter, and the table of methods at each swept point.
"use strict";
(() => {
  const value = (cell) => {
    const text = cell?.dataset.value ?? cell?.textContent ?? "";
    const number = Number(text);
    return text !== "" && !Number.isNaN(number) ? number : text.toLowerCase();
  };
  const order = (a, b) => (typeof a === "number" && typeof b === "number" ? a - b : typeof a === "number" ? -1 : typeof b === "number" ? 1 : a.localeCompare(b));

  const sortable = (table) => {
    table.querySelectorAll("thead th").forEach((head, column) => {
      const button = NF.el("button", { type: "button", class: "sort", onclick: () => {
        const up = head.getAttribute("aria-sort") !== "ascending";
        table.querySelectorAll("thead th").forEach((each) => each.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", up ? "ascending" : "descending");
        const rows = [...table.tBodies[0].rows];
        const missing = (row) => ["", "–"].includes(row.cells[column]?.dataset.value ?? row.cells[column]?.textContent.trim());
        rows.sort((p, q) => missing(p) - missing(q) || (up ? 1 : -1) * order(value(p.cells[column]), value(q.cells[column])));
        table.tBodies[0].append(...rows);
      } }, ...head.childNodes);
      head.append(button);
    });
  };
  const filterable = (table) => {
    const input = NF.el("input", { type: "search", oninput: () => apply() });
    const count = NF.el("span", { class: "note", role: "status" });
    const apply = () => {
      const words = input.value.toLowerCase().split(/\s+/).filter(Boolean), rows = [...table.tBodies[0].rows];
      rows.forEach((row) => { row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word)); });
      count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows`;
    };
    const bar = NF.el("div", { class: "controls" }, NF.el("label", { class: "control" }, NF.el("span", {}, "Filter"), input), count);
    table.closest(".scroll").before(bar);
    table.refilter = apply;
    apply();
    return bar;
  };

  const cell = (text, sort, attributes = {}) => NF.el("td", { "data-value": Number.isFinite(sort) ? sort : sort === Infinity ? 1e308 : "", ...attributes }, text);
  const line = (row) => NF.el("tr", { class: row.best ? "best" : null },
    NF.el("th", { scope: "row" }, row.best ? "● " : "", NF.name(row.method)),
    cell(NF.percent(row.solved_share), NF.number(row.solved_share)), cell(NF.range(row.solved_low, row.solved_high, (v) => String(Math.round(100 * v))) + (row.solved_low === null ? "" : " %"), NF.number(row.solved_low)),
    cell(NF.text(row.error_ratio), NF.number(row.error_ratio)), cell(NF.range(row.ratio_low, row.ratio_high), NF.number(row.ratio_low)),
    cell(row.ert === 0 ? "–" : NF.text(row.ert), NF.number(row.ert)), cell(NF.text(row.seconds), NF.number(row.seconds)),
    cell(NF.text(row.median), NF.number(row.median)), cell(NF.text(row.rms), NF.number(row.rms)),
    cell(NF.text(row.time), NF.number(row.time)), cell(String(row.failed), row.failed));

  const methods = document.getElementById("methods-table");
  if (methods) methods.tBodies[0].replaceChildren(...NF.data.tables[0].rows.map(line));
  const tidy = (table) => { // hide the columns without values
    [...table.tHead.rows[0].cells].forEach((head, i) => {
      const cells = [...table.tBodies[0].rows].map((row) => row.cells[i]), empty = cells.every((each) => ["–", ""].includes(each.textContent));
      [head, ...cells].forEach((each) => { each.hidden = empty; });
    });
  };
  if (methods) tidy(methods);
  document.querySelectorAll("table.sortable").forEach(sortable);
  document.querySelectorAll("table.filterable").forEach((table) => {
    const bar = filterable(table);
    if (table.id !== "methods-table" || NF.data.tables.length < 2) return;
    const names = NF.data.tables.map((each) => (each.point < 0 ? "all points together" : NF.data.points[each.point]));
    bar.prepend(NF.select("Swept point", names, 0, (i) => {
      table.tBodies[0].replaceChildren(...NF.data.tables[i].rows.map(line));
      table.querySelectorAll("thead th").forEach((each) => each.removeAttribute("aria-sort"));
      tidy(table);
      table.refilter();
    }));
  });

  document.querySelectorAll("tbody th, td.name").forEach((each) => { // names from the server may break at the same places
    const method = each.childElementCount ? -1 : NF.data.methods.indexOf(each.textContent.replace("● ", ""));
    if (method >= 0) each.replaceChildren(each.textContent.startsWith("● ") ? "● " : "", ...NF.name(method));
  });
  document.querySelectorAll("button.copy").forEach((button) => button.addEventListener("click", async () => {
    const text = document.getElementById(button.dataset.of).textContent;
    try { await navigator.clipboard.writeText(text); button.textContent = "Copied"; } catch { button.textContent = "Select it and copy"; }
  }));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", NF.changed);
  let width = innerWidth, timer = 0;
  addEventListener("resize", () => { if (innerWidth !== width) { width = innerWidth; clearTimeout(timer); timer = setTimeout(NF.changed, 150); } });
  addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((each) => { each.open = true; }));
})();
