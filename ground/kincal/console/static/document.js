// A page of kincal.pages as elements: the same words, tables and figures as the page in a file.
import { el } from "./dom.js";
import { draw } from "./plots.js";

// before: what stood there: sections that say the same stay as the reader has them, with zoomed figures.
export function document_(page, before = null) {
  const sections = page.sections.map((s) => {
    const text = JSON.stringify(s);
    return before?.sections.find((b) => b.text === text) ?? { text, figure: s.figure, drawn: false, ...section(s) };
  });
  const node = el("article", { class: "document" },
    el("h1", {}, page.title), el("p", { class: "sub" }, page.subtitle),
    page.verdict ? el("div", { class: "verdict" }, el("b", {}, page.verdict)) : null,
    page.tiles.length ? el("div", { class: "tiles", style: { "--columns": page.tiles.length % 4 ? "3" : "4" } },
      page.tiles.map((t) => el("div", { class: "tile" }, el("span", {}, t.label), el("b", { class: t.mood }, t.text), t.about ? el("small", {}, t.about) : null))) : null,
    page.summary.length ? el("ul", { class: "summary" }, page.summary.map((line) => el("li", { class: line.startsWith("Reason to reject") ? "bad" : "" }, line))) : null,
    sections.map((s) => s.node));
  // all: also what is drawn already, in other colours
  const draws = (all = false) => {
    for (const s of sections.filter((one) => one.box && (all || !one.drawn))) { draw(s.box, s.figure); s.drawn = true; }
  };
  return { node, sections, draw: draws };
}

function section(s) {
  const box = s.figure ? el("div", { class: "figure", style: { height: `${s.figure.layout.height ?? 400}px` } }) : null;
  const node = el("section", { id: s.key }, el("h2", {}, s.title), s.text ? el("p", {}, s.text) : null, box, s.grid?.rows.length ? grid(s.grid) : null);
  return { node, box };
}

export function grid(g) {
  return el("div", { class: "wide", tabindex: "0", role: "region", "aria-label": "Table" }, el("table", {},
    el("thead", {}, el("tr", {}, g.columns.map((c) => el("th", { class: c.number ? "n" : "" }, c.title)))),
    el("tbody", {}, g.rows.map((row) => el("tr", {}, row.map((cell, i) => el("td", { class: `${g.columns[i].number ? "n" : "t"}${cell.text.length > 24 ? " long" : ""} ${cell.mood}` }, cell.text)))))),
  g.note ? el("p", { class: "note" }, g.note) : null);
}
