// Tables of this console beside those in force: values, read back, difference, send.
import { el, mark, show } from "./dom.js";
import { confirmed } from "./confirm.js";
import { grid } from "./document.js";
import { say } from "./said.js";
import { ask, store, tell } from "./store.js";

const ABOUT = {
  ARM: "DH chain, limits, masses, frames", CAMERA: "mast, pan-tilt unit, lens, tags", TERMS: "coefficients and correction terms",
  KIN: "values in force: what calibration changes", SPACE: "candidates, hubs, verified segments", KERNEL: "spectra and hyperparameters", CONFIG: "how a calibration is run",
};
// what flight drops when a table of this kind changes (docs/TABLES.md)
const DROPS = {
  ARM: " ▲ Flight drops SPACE and the correction in force (KIN): the arm moves by its nominal values until another correction is approved, and START is refused until a SPACE for this arm is sent.",
  TERMS: " ▲ Flight drops the correction in force (KIN): the arm moves by its nominal values until a correction of these terms is approved.",
};
const SHOWN = 60;  // fields that differ, before a table is sent
const NAMES = { folder: "in the folder", made: "made here" };
let parts = null, rows = null, chosen = "CONFIG", what = "values", of = "folder", stamp = "";

export function open(root) {
  parts = { list: el("section", { class: "card" }), middle: el("div", { class: "middle" }), side: el("aside", { class: "card side", "aria-label": "Actions" }) };
  stamp = "";
  show(root, el("div", { class: "left", tabindex: "0", role: "region", "aria-label": "Tables" }, parts.list), parts.middle, parts.side);
  reload();
}
export function close() { parts = null; }
export function recolour() { /* no figures */ }
export function at([kind, view, which]) { if (kind) { chosen = kind; what = view ?? "values"; of = NAMES[which] ? which : "folder"; if (parts && rows) { draw(); content(); } } }

async function reload() {
  try { rows = await ask("tables"); } catch (error) { say(error.message, false); return; }
  if (!parts) return;
  stamp = "";
  draw();
  content();
}

export function update() {
  if (!parts || !rows) return;
  const key = JSON.stringify([store.values.KC_HK?.data.tables, store.values.KC_HK?.data.state, store.values.KC_HK?.data.staged, store.values.KC_HK?.data.staged_checked]);
  if (key !== stamp) { stamp = key; draw(); }
}

const crcOf = (row, which) => row[which === "folder" ? "crc" : which];
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
  const row = rows.find((r) => r.kind === chosen), why = store.about.live ? store.about.why_no_key : "a recording takes no commands", crc = crcOf(row, of);
  const there = ["read", "folder", "made"].find((which) => crcOf(row, which) && crcOf(row, which) === board(chosen) && which !== of);
  const busy = el("button", { type: "button", disabled: Boolean(why), title: why || null, onclick: readBack }, "Read back");
  show(parts.side, el("h2", {}, chosen),
    el("p", {}, "Read back: brings down the table in force and compares it with the one in the folder."), busy,
    row.read ? el("p", { class: "small" }, `last read back: ${row.read} `, el("a", { href: `#tables/${chosen}/difference/${of}` }, "difference")) : null,
    el("h2", {}, "Send"),
    row.made ? el("ul", { class: "tables" }, Object.keys(NAMES).map((which) => el("li", { class: which === of ? "chosen" : "" }, el("a", { href: `#tables/${chosen}/values/${which}`, "aria-current": which === of ? "true" : null }, el("b", {}, crcOf(row, which)), el("small", {}, `${NAMES[which]}${crcOf(row, which) === board(chosen) ? ", in force" : ""}`))))) : null,
    confirmed({
      label: `Send the ${chosen} table …`, act: "SEND", danger: true, path: `tables/${chosen}/send`, key: `send:${chosen}:${crc}`, body: () => ({ crc, of }),
      disabled: why || (chosen === "KIN" ? "a correction is reviewed, see Corrections" : crc ? "" : "no such table"), done: reload,
      text: () => `${chosen} table ${crc}, ${NAMES[of]}${of === "folder" ? ` (${row.file})` : ""}, is staged, checked by flight and put in force, instead of ${board(chosen) || "what is there"}. Flight refuses it while a calibration runs.${DROPS[chosen] ?? ""}`,
      preview: there ? () => preview(there) : null,
    }),
    ...staged(crc, why, there),
    el("p", { class: "muted small" }, "A search space is built in Space, the terms of a model in Workbench, other tables by kincal table build."));
}

// What somebody has sent and flight has checked, but not put in force: where CONFIG asks for two persons, the second one does that.
function staged(crc, why, there) {
  const hk = store.values.KC_HK?.data;
  if (!hk?.staged || hk.staged !== chosen) return [];
  return [el("h2", {}, "Staged"),
    el("p", {}, `${chosen} table, ${hk.staged_bytes} bytes: ${hk.staged_checked ? "● checked by flight, not in force" : "▲ not checked yet"}`),
    confirmed({
      label: "Activate the staged table …", act: "ACTIVATE", danger: true, path: `tables/${chosen}/activate`, key: `activate:${chosen}`,
      more: [{ name: "crc", label: "CRC of the staged table, as whoever sent it says", value: crc }], done: reload,
      disabled: why || (chosen === "KIN" ? "a correction is reviewed, see Corrections" : hk.staged_checked ? "" : "flight has not checked it"),
      text: () => `What is staged on board comes in force instead of ${board(chosen) || "what is there"}, if its CRC is the one below; nothing is sent again. Flight refuses it while a calibration runs.${DROPS[chosen] ?? ""}`,
      preview: there ? () => preview(there) : null,
    })];
}

// What changes against the table in force, where that lies here.
async function preview(there) {
  try {
    const got = await ask(`tables/${chosen}/difference?of=${there}&to=${of}`), rest = got.n - SHOWN;
    return [el("p", {}, el("b", {}, "What changes: "), `${got.n} fields`), grid({ ...got.grid, rows: got.grid.rows.slice(0, SHOWN), note: rest > 0 ? `${rest} more` : "" })];
  } catch (error) { return [el("p", { class: "attention" }, `▲ No preview: ${error.message}`)]; }
}

async function readBack(event) {
  const button = event.target, kind = chosen;
  button.disabled = true;
  button.textContent = "reading …";
  try { const said = await tell(`tables/${kind}/read`); say(said.text); location.hash = `tables/${kind}/difference`; } catch (error) { say(error.message, false); }
  reload();
}

async function content() {
  const kind = chosen, view = what, which = of;
  let got;
  try { got = await ask(`tables/${kind}/${view}?of=${which}`); } catch (error) { if (parts) show(parts.middle, el("p", { class: "attention" }, error.message)); return; }
  if (!parts || kind !== chosen || view !== what || which !== of) return;
  const filter = el("input", { type: "text", placeholder: "filter", "aria-label": "Filter of fields", autocomplete: "off" });
  const box = el("div", { class: "values", tabindex: "0", role: "region", "aria-label": "Fields" });
  const fill = () => {
    const word = filter.value.toLowerCase();
    const found = got.grid.rows.filter((r) => !word || r.some((c) => c.text.toLowerCase().includes(word)));
    show(box, grid({ ...got.grid, rows: found }), found.length ? null : el("p", { class: "muted" }, got.grid.rows.length ? "No field fits." : "● No field differs."));
  };
  filter.addEventListener("input", fill);
  show(parts.middle, el("nav", { class: "tabs" }, ["values", "difference"].map((v) => el("a", { href: `#tables/${kind}/${v}/${which}`, "aria-current": v === view ? "page" : null }, v)), el("span", { class: "space" }), filter),
    el("p", {}, view === "values" ? `${kind} table ${got.crc} ${NAMES[which]}` : `${kind}: ${NAMES[which]} ${got.crc}, read back ${got.read}: ${got.n ? `▲ ${got.n} fields differ` : "● the same"}`), box);
  fill();
}
