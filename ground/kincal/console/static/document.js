// A page of kincal.pages as elements: the same words, tables and figures as the page in a file.
import { el } from "./dom.js";
import { draw } from "./plots.js";

export function document_(page) {
  const figures = [];
  const node = el("article", { class: "document" },
    el("h1", {}, page.title), el("p", { class: "sub" }, page.subtitle),
    page.verdict ? el("div", { class: "verdict" }, el("b", {}, page.verdict)) : null,
    page.tiles.length ? el("div", { class: "tiles", style: { "--columns": page.tiles.length % 4 ? "3" : "4" } },
      page.tiles.map((t) => el("div", { class: "tile" }, el("span", {}, t.label), el("b", { class: t.mood }, t.text), t.about ? el("small", {}, t.about) : null))) : null,
    page.summary.length ? el("ul", { class: "summary" }, page.summary.map((line) => el("li", { class: line.startsWith("Reason to reject") ? "bad" : "" }, line))) : null,
    page.sections.map((s) => section(s, figures)));
  return { node, draw: () => { for (const [box, figure] of figures) draw(box, figure); } };
}

function section(s, figures) {
  let box = null;
  if (s.figure) {
    box = el("div", { class: "figure", style: { height: `${s.figure.layout.height ?? 400}px` } });
    figures.push([box, s.figure]);
  }
  return el("section", { id: s.key }, el("h2", {}, s.title), s.text ? el("p", {}, s.text) : null, box, s.grid?.rows.length ? grid(s.grid) : null);
}

export function grid(g) {
  return el("div", { class: "wide", tabindex: "0", role: "region", "aria-label": "Table" }, el("table", {},
    el("thead", {}, el("tr", {}, g.columns.map((c) => el("th", { class: c.number ? "n" : "" }, c.title)))),
    el("tbody", {}, g.rows.map((row) => el("tr", {}, row.map((cell, i) => el("td", { class: `${g.columns[i].number ? "n" : "t"}${cell.text.length > 24 ? " long" : ""} ${cell.mood}` }, cell.text)))))),
  g.note ? el("p", { class: "note" }, g.note) : null);
}
