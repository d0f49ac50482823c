// Tables of this console beside those in force: values, read back, difference, send; why a candidate is in.
import { el, mark, show } from "./dom.js";
import { confirmed } from "./confirm.js";
import { grid } from "./document.js";
import { say } from "./said.js";
import { ask, store, tell } from "./store.js";

const ABOUT = {
  ARM: "DH chain, limits, masses, frames", CAMERA: "mast, pan-tilt unit, lens, tags", TERMS: "coefficients and correction terms",
  KIN: "values in force: what calibration changes", SPACE: "candidates, hubs, verified segments", KERNEL: "spectra and hyperparameters", CONFIG: "how a calibration is run",
};
let parts = null, rows = null, chosen = "CONFIG", what = "values", stamp = "";

export function open(root) {
  parts = { list: el("section", { class: "card" }), space: el("section", { class: "card" }), middle: el("div", { class: "middle" }), side: el("aside", { class: "card side", "aria-label": "Actions" }) };
  stamp = "";
  show(root, el("div", { class: "left", tabindex: "0", role: "region", "aria-label": "Tables" }, parts.list, parts.space), parts.middle, parts.side);
  explainer();
  reload();
}
export function close() { parts = null; }
export function recolour() { /* no figures */ }
export function at([kind, view]) { if (kind) { chosen = kind; what = view ?? "values"; if (parts && rows) { draw(); content(); } } }

async function reload() {
  try { rows = await ask("tables"); } catch (error) { say(error.message, false); return; }
  if (!parts) return;
  stamp = "";
  draw();
  content();
}

export function update() {
  if (!parts || !rows) return;
  const key = JSON.stringify([store.values.KC_HK?.data.tables, store.values.KC_HK?.data.state]);
  if (key !== stamp) { stamp = key; draw(); }
}

const board = (kind) => store.values.KC_HK?.data.tables[kind];

function verdict(row) {
  const crc = board(row.kind);
  if (row.trouble) return ["beyond", row.trouble];
  if (!crc) return ["unknown", store.values.KC_HK ? "none in force" : "not heard"];
  return crc === row.crc ? ["ok", "the same is in force"] : ["near", "another one is in force"];
}

function draw() {
  show(parts.list, el("h2", {}, "Tables"), el("ul", {}, rows.map((row) => {
    const [kind, text] = verdict(row);
    return el("li", { class: row.kind === chosen ? "chosen" : "" }, el("a", { href: `#tables/${row.kind}/values` },
      el("b", {}, mark(kind, text), ` ${row.kind}`), el("small", {}, ABOUT[row.kind] ?? ""), el("small", {}, `folder ${row.crc || "none"}, in force ${board(row.kind) || "unknown"}: ${text}`)));
  })));
  const row = rows.find((r) => r.kind === chosen), why = store.about.live ? store.about.why_no_key : "a recording takes no commands";
  const busy = el("button", { type: "button", disabled: Boolean(why), title: why || null, onclick: readBack }, "Read back");
  show(parts.side, el("h2", {}, chosen),
    el("p", {}, "Read back: brings down the table in force and compares it with the one in the folder."), busy,
    row.read ? el("p", { class: "small" }, `last read back: ${row.read} `, el("a", { href: `#tables/${chosen}/difference` }, "difference")) : null,
    el("h2", {}, "Send"), confirmed({
      label: `Send the ${chosen} table …`, act: "SEND", danger: true, path: `tables/${chosen}/send`, key: `send:${chosen}:${row.crc}`, body: () => ({ crc: row.crc }),
      disabled: why || (chosen === "KIN" ? "a correction is reviewed, see Corrections" : row.crc ? "" : "no table in the folder"), done: reload,
      text: () => `${chosen} table ${row.crc} of ${row.file} is staged, checked by flight and put in force, instead of ${board(chosen) || "what is there"}. Flight refuses it while a calibration runs.`,
    }),
    el("p", { class: "muted small" }, "Tables are built from tables/src by kincal table build; a search space takes minutes."));
}

async function readBack(event) {
  const button = event.target, kind = chosen;
  button.disabled = true;
  button.textContent = "reading …";
  try { const said = await tell(`tables/${kind}/read`); say(said.text); location.hash = `tables/${kind}/difference`; } catch (error) { say(error.message, false); }
  reload();
}

async function content() {
  const kind = chosen, view = what;
  let got;
  try { got = await ask(`tables/${kind}/${view}`); } catch (error) { if (parts) show(parts.middle, el("p", { class: "attention" }, error.message)); return; }
  if (!parts || kind !== chosen || view !== what) return;
  const filter = el("input", { type: "text", placeholder: "filter", "aria-label": "Filter of fields", autocomplete: "off" });
  const box = el("div", { class: "values", tabindex: "0", role: "region", "aria-label": "Fields" });
  const fill = () => {
    const word = filter.value.toLowerCase();
    const found = got.grid.rows.filter((r) => !word || r.some((c) => c.text.toLowerCase().includes(word)));
    show(box, grid({ ...got.grid, rows: found }), found.length ? null : el("p", { class: "muted" }, got.grid.rows.length ? "No field fits." : "● No field differs."));
  };
  filter.addEventListener("input", fill);
  show(parts.middle, el("nav", { class: "tabs" }, ["values", "difference"].map((v) => el("a", { href: `#tables/${kind}/${v}`, "aria-current": v === view ? "page" : null }, v)), el("span", { class: "space" }), filter),
    el("p", {}, view === "values" ? `${kind} table ${got.crc} of the folder` : `${kind}: folder ${got.crc}, read back ${got.read}: ${got.n ? `▲ ${got.n} fields differ` : "● the same"}`), box);
  fill();
}

// ------------------------------------------------------------------ search space

function explainer() {
  const input = el("input", { type: "text", inputmode: "numeric", name: "candidate", "aria-label": "Candidate", autocomplete: "off" });
  input.value = String(Math.max(store.values.KC_HK?.data.candidate ?? 0, 0));
  const box = el("div", {});
  const form = el("form", { class: "add" }, input, el("button", { type: "submit" }, "explain"));
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    show(box, el("p", { class: "muted" }, "The first one takes some seconds …"));
    try {
      const got = await ask(`explain/${encodeURIComponent(Number.parseInt(input.value, 10) || 0)}`);
      show(box);
      what = chosen = null;
      show(parts.middle, el("h1", {}, `Candidate ${got.candidate}`), el("p", {}, mark(got.good ? "ok" : "beyond"), got.good ? " passes all checks" : " fails a check", `; the table has 0 to ${got.of - 1}`), el("div", { class: "values", tabindex: "0", role: "region", "aria-label": "Checks" }, grid(got.grid)));
      chosen = "SPACE";
      draw();
    } catch (error) { show(box, el("p", { class: "bad" }, error.message)); }
  });
  show(parts.space, el("h2", {}, "Why is a candidate in the space?"), form, box);
}
