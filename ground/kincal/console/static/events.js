// The list of events and acknowledgements, newest first: only the rows in view are elements. Beside it the
// causes of the chosen one, and what to do.
import { el, mark, mission, prose, show, utc, utcFull } from "./dom.js";
import { ask, keep, kept, store } from "./store.js";

const ROW_PX = 24;
const MORE = 8;  // rows drawn beyond the view

export function eventList() {
  let chosen = null, debug = kept("debug", false), frozen = null, drawn = "";
  const space = el("div", { class: "rows" });
  const list = el("div", { class: "list", role: "listbox", tabindex: "0", "aria-label": "Events and acknowledgements, newest first" }, space);
  const count = el("span", { class: "muted" });
  const box = el("input", { type: "checkbox", onchange: (e) => { debug = e.target.checked; keep("debug", debug); drawn = ""; update(); } });
  box.checked = debug;
  const detail = el("div", { class: "detail", tabindex: "0", role: "region", "aria-label": "Chosen event" });
  const older = el("button", { type: "button", onclick: fetchOlder }, "earlier events");
  const node = el("section", { class: "events card" },
    el("h2", {}, "Events ", count, el("span", { class: "space" }), older, el("label", {}, box, " debug")), list, detail);

  const rows = () => (debug ? store.rows : store.rows.filter((r) => r.severity !== "debug"));

  async function fetchOlder() {
    const first = store.rows.find((r) => r.n !== undefined);
    const more = first ? await ask(`rows?before=${first.n}`) : [];
    store.rows.unshift(...more);
    older.disabled = !more.length;
    older.title = more.length ? "" : "earlier ones are in the recording only";
    drawn = "";
    update();
  }

  function update() {
    const all = rows();
    const key = `${all.length}/${all.at(-1)?.n}/${all.at(-1)?.text}`;
    if (key === drawn) return;
    // who reads further down keeps the place
    if (frozen !== null && list.scrollTop > ROW_PX && all.length > frozen) list.scrollTop += (all.length - frozen) * ROW_PX;
    frozen = all.length;
    drawn = key;
    show(count, `${all.length}`);
    space.style.height = `${all.length * ROW_PX}px`;
    place();
    if (chosen === null) about(all.findLast((r) => r.severity === "error" || r.severity === "warning") ?? all.at(-1), false);
  }

  function place() {
    const all = rows();
    const first = Math.max(Math.floor(list.scrollTop / ROW_PX) - MORE, 0);
    const last = Math.min(first + Math.ceil(list.clientHeight / ROW_PX) + 2 * MORE, all.length);
    const made = [];
    for (let k = first; k < last; k += 1) made.push(line(all[all.length - 1 - k], k));
    space.replaceChildren(...made);
  }

  function line(row, k) {
    return el("div", {
      class: `row ${row.severity} ${row.kind}${row === chosen ? " chosen" : ""}`, role: "option",
      "aria-selected": String(row === chosen), style: { top: `${k * ROW_PX}px` }, title: row.text,
      onclick: () => { about(row, true); place(); },
    }, mark(row.severity), el("time", {}, mission(row.t_us)), el("b", {}, row.name), el("span", {}, row.text));
  }

  function about(row, mine) {
    if (!row) return;
    if (mine) chosen = row;
    const known = store.about.dictionary[row.name] ?? store.about.dictionary[row.about] ?? {};
    show(detail,
      el("p", { class: "head" }, mark(row.severity), " ", el("b", {}, row.name), ` ${row.severity}, `,
        el("span", { class: "muted" }, `mission ${mission(row.t_us)}, received ${row.received_s > 1e9 ? utcFull(row.received_s) : "with the recording"}`)),
      el("p", {}, row.text),
      known.cause ? el("p", {}, el("b", {}, "Likely causes: "), ...prose(known.cause)) : null,
      known.do ? el("p", { class: "todo" }, el("b", {}, "What to do: "), ...prose(known.do)) : null,
      mine ? el("button", { type: "button", onclick: () => { chosen = null; drawn = ""; update(); } }, "follow the newest") : null);
  }

  list.addEventListener("scroll", place);
  list.addEventListener("keydown", (event) => {
    const step = { ArrowDown: -1, ArrowUp: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const all = rows();
    const index = chosen ? all.indexOf(chosen) : all.length;
    const next = all[Math.min(Math.max(index + step, 0), all.length - 1)];
    if (!next) return;
    about(next, true);
    const top = (all.length - 1 - all.indexOf(next)) * ROW_PX;
    if (top < list.scrollTop) list.scrollTop = top;
    if (top > list.scrollTop + list.clientHeight - ROW_PX) list.scrollTop = top - list.clientHeight + ROW_PX;
    place();
  });
  new ResizeObserver(place).observe(list);
  return { node, update: () => update() };
}
