// What was in force when, and the trend of each coefficient and of the monitor: as `kincal review history`.
import { el, show } from "./dom.js";
import { document_ } from "./document.js";
import { ask, store } from "./store.js";

let parts = null, page = null, stamp = "";

export function open(root) {
  parts = el("div", { class: "review", tabindex: "0", role: "region", "aria-label": "History" }, el("p", { class: "muted" }, "Recordings are read …"));
  stamp = "";
  show(root, parts);
  update();
}
export function close() { parts = page = null; }
export function recolour() { page?.draw(true); }

export function update() {
  const hk = store.values.KC_HK?.data, key = JSON.stringify([hk?.tables, hk?.proposal, hk?.monitor?.limit]);
  if (parts && key !== stamp) { stamp = key; load(); }
}

async function load() {
  let got;
  try { got = await ask("history"); } catch (error) { if (parts) show(parts, el("p", { class: "bad" }, error.message)); return; }
  if (!parts) return;
  const top = parts.scrollTop;
  page = document_(got.page);
  show(parts, got.trouble ? el("p", { class: "bad pre" }, `◆ The journal cannot be read: ${got.trouble}`) : null, page.node);
  page.draw();
  parts.scrollTop = top;
}
