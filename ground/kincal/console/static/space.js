// Search spaces: why a candidate is in, the description in a form, build, check, difference, send, read back. The
// same answers as `kincal space explain`, `build`, `check`, `diff` and `kincal table uplink`, `dump`.
import { age, el, mark, show } from "./dom.js";
import { confirmed } from "./confirm.js";
import { document_, grid } from "./document.js";
import { form } from "./form.js";
import { LIGHT, draw } from "./plots.js";
import { say } from "./said.js";
import { arm, dots, layout, line, view } from "./scene.js";
import { ask, store, tell } from "./store.js";

const POLL_MS = 700;
const TABS = [["candidates", "Candidates"], ["description", "Description"], ["build", "Built"], ["check", "Checked"], ["difference", "Difference"]];
const NAMES = { folder: "in the folder", made: "built here", read: "read back" };
let parts = null, state = null, of = "folder", to = "made", tab = "candidates", timer = null, stamp = "", space = null, chosen = null, found = null, page = null;

export function open(root) {
  parts = {
    tables: el("section", { class: "card" }), list: el("section", { class: "card list" }),
    tabs: el("nav", { class: "tabs", "aria-label": "Search space" }), content: el("div", { class: "content" }),
    work: el("section", { class: "card work" }), send: el("section", { class: "card" }),
  };
  stamp = "";
  space = found = null;
  show(root,
    el("div", { class: "left", tabindex: "0", role: "region", "aria-label": "Tables and candidates" }, parts.tables, parts.list),
    el("div", { class: "middle" }, parts.tabs, parts.content),
    el("aside", { class: "side", tabindex: "0", role: "region", "aria-label": "Build and send" }, parts.work, parts.send));
  poll(true);
}
export function close() { clearTimeout(timer); parts = null; }
export function recolour() { page?.draw(true); if (tab === "candidates") picture(); if (tab === "difference") difference(); }
export function at([what, which]) {
  if (what && TABS.some(([key]) => key === what)) tab = what;
  if (which !== undefined && what === "candidates") chosen = Number(which);
  if (parts && state) content();
}
export function update() {
  if (!parts || !state) return;
  const key = JSON.stringify([store.values.KC_HK?.data.tables.SPACE, store.values.KC_HK?.data.state]);
  if (key !== update.key) { update.key = key; side(); }
}

async function poll(first = false) {
  clearTimeout(timer);
  if (!parts) return;
  try { state = await ask("space"); } catch (error) { say(error.message, false); }
  if (!parts) return;
  const key = JSON.stringify(state);
  if (state && key !== stamp) {
    const done = stamp && state.job?.status === "done" && JSON.parse(stamp).job?.status === "running";
    stamp = key;
    side();
    if (done) location.hash = `#spaces/${state.job.what}`;
    if (first || done) { if (done) space = null; content(); }
  }
  const about = parts.work.querySelector(".elapsed");
  if (about && state.job) about.textContent = `${age(Date.now() / 1000 + store.skew_s - state.job.began_s)}`;
  timer = setTimeout(poll, state?.job?.status === "running" ? POLL_MS : 3000);
}

async function act(path, body) {
  try { const said = await tell(`space/${path}`, body); say(said.text, said.ok !== false); } catch (error) { say(error.message, false); }
  await poll();
}

// ------------------------------------------------------------------ tables, work, send

const crcOf = (which) => state.tables[which === "folder" ? "crc" : which];
const board = () => store.values.KC_HK?.data.tables.SPACE;

function side() {
  const rows = Object.keys(NAMES).filter((which) => crcOf(which));
  if (!rows.includes(of)) of = rows[0] ?? "folder";
  show(parts.tables, el("h2", {}, "SPACE tables"),
    el("ul", { class: "tables" }, rows.map((which) => el("li", { class: which === of ? "chosen" : "" }, el("button", { type: "button", class: "plain", "aria-pressed": String(which === of), onclick: () => choose(which) },
      el("b", {}, mark(crcOf(which) === board() ? "ok" : "unknown", crcOf(which) === board() ? "in force" : "not in force"), ` ${crcOf(which)}`), el("small", {}, `${NAMES[which]}${crcOf(which) === board() ? ", in force" : ""}`))))),
    el("p", { class: "small muted" }, board() ? (rows.some((which) => crcOf(which) === board()) ? "" : `In force is ${board()}: read it back to see it here.`) : "Flight was not heard: what is in force is not known."));
  work();
  sender();
  tabs();
}

function choose(which) {
  of = which;
  space = found = chosen = null;
  side();
  if (tab !== "candidates") location.hash = "#spaces/candidates"; else content();
}

function work() {
  const job = state.job, running = job?.status === "running", p = job?.progress ?? {};
  show(parts.work, el("h2", {}, "Build and check"),
    el("div", { class: "buttons" },
      el("button", { type: "button", disabled: running || state.wrong > 0, title: state.wrong ? "the description is wrong" : "the description as it is kept; a full space takes minutes", onclick: () => act("run", { what: "build" }) }, "Build"),
      el("button", { type: "button", disabled: running || !crcOf(of), title: "every candidate, hub and segment once more, with other random numbers", onclick: () => act("run", { what: "check", of }) }, `Check ${crcOf(of) || ""}`)),
    running ? el("div", { class: "progress" }, el("progress", p.of ? { max: String(p.of), value: String(p.done), "aria-label": job.what } : { "aria-label": job.what }),
      el("p", {}, `${job.what}: ${p.what ?? "begins"}${p.of ? ` ${p.done} of ${p.of}` : ""}, `, el("span", { class: "elapsed" })), el("button", { type: "button", onclick: () => act("cancel") }, "cancel")) : null,
    job && !running ? el("p", { class: job.status === "failed" ? "bad" : "muted" }, mark(job.status === "failed" ? "beyond" : job.status === "done" ? "ok" : "unknown", job.status), ` ${job.what} ${job.status === "done" ? job.text : job.status === "failed" ? `failed: ${job.text}` : job.status}`) : null,
    el("p", { class: "small muted" }, "For the arm, camera and kernel tables in force, as far as they lie here."));
}

function sender() {
  const why = store.about.live ? store.about.why_no_key : "a recording takes no commands", crc = crcOf(of);
  const checked = state.answers.check?.crc === crc;
  show(parts.send, el("h2", {}, "On board"),
    el("p", { class: "small" }, "Read back brings the table in force down."),
    el("button", { type: "button", disabled: Boolean(why), title: why || null, onclick: readBack }, "Read back"),
    el("h2", {}, "Send"),
    checked || of !== "made" ? null : el("p", { class: "small attention" }, "▲ This table was built and not checked again."),
    confirmed({
      label: `Send ${crc || "it"} …`, act: "SEND", danger: true, path: "tables/SPACE/send", key: `send:SPACE:${crc}`, body: () => ({ crc, of }), done: () => poll(),
      disabled: why || (of === "read" ? "it was read back: choose another one" : crc ? "" : "no table") || (crc === board() ? "it is in force" : ""),
      text: () => `SPACE table ${crc}, ${NAMES[of]}, is staged, checked by flight and put in force instead of ${board() || "what is there"}: the next calibration chooses its poses from it. Flight refuses it while a calibration runs.`,
      preview: board() && Object.keys(NAMES).some((which) => crcOf(which) === board()) ? preview : null,
    }));
}

async function preview() {
  const from = Object.keys(NAMES).find((which) => crcOf(which) === board());
  try {
    const got = await ask(`space/difference?of=${from}&to=${of}`);
    return [el("p", {}, el("b", {}, "What changes: ")), grid(got.grid)];
  } catch (error) { return [el("p", { class: "attention" }, `▲ No preview: ${error.message}`)]; }
}

async function readBack(event) {
  const button = event.target;
  button.disabled = true;
  button.textContent = "reading …";
  try { const said = await tell("tables/SPACE/read"); say(said.text); } catch (error) { say(error.message, false); }
  button.disabled = false;
  button.textContent = "Read back";
  await poll();
}

// ------------------------------------------------------------------ what is shown

function tabs() {
  show(parts.tabs, TABS.map(([key, label]) => el("a", { href: `#spaces/${key}`, "aria-current": key === tab ? "page" : null }, label, ["build", "check"].includes(key) && !state.answers[key] ? el("span", { class: "muted" }, " –") : null)));
}

function content() {
  tabs();
  page = null;
  if (tab === "candidates") candidates();
  else if (tab === "description") description();
  else if (tab === "difference") difference();
  else answer(tab);
}

const scroller = (name, ...children) => el("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": name }, ...children);

async function answer(what) {
  if (!state.answers[what]) {
    show(parts.content, el("p", { class: "muted" }, what === "build" ? "Nothing was built yet: Build at the right takes the description as it is kept." : "Nothing was checked yet: Check at the right takes the chosen table."));
    return;
  }
  let got;
  try { got = await ask(`space/answer/${what}`); } catch (error) { show(parts.content, el("p", { class: "bad" }, error.message)); return; }
  if (!parts || tab !== what) return;
  page = document_(got.page);
  show(parts.content, scroller(what, what === "build" ? el("p", {}, "Take away: ", el("a", { href: "/api/space/file/space.tbl", download: "space.tbl" }, "space.tbl")) : null, page.node));
  page.draw();
}

// ------------------------------------------------------------------ candidates

async function candidates() {
  if (!space || space.of !== of) {
    show(parts.content, el("p", { class: "muted" }, "…"));
    show(parts.list);
    const which = of;
    let got;
    try { got = await ask(`space/candidates?of=${which}`); } catch (error) { if (parts) show(parts.content, el("p", { class: "bad" }, error.message)); return; }
    if (!parts || which !== of) return;
    space = { ...got, of: which };
    found = null;
  }
  if (tab !== "candidates") return;
  list();
  parts.plot = el("div", { class: "plot", role: "img", "aria-label": "Candidates and the arm in three dimensions; the list at the left holds the same" });
  parts.about = el("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Explanation" });
  show(parts.content, el("section", { class: "card scene" }, el("h2", {}, `Candidates of ${space.crc} `, el("span", { class: "muted" }, "tool positions, initial poses blue; a click explains one")), parts.plot), parts.about);
  picture();
  explain();
}

function list() {
  const rows = space.rows.map((row, i) => el("li", { role: "option", id: `candidate-${i}`, class: i === chosen ? "chosen" : "", "aria-selected": String(i === chosen), onclick: () => pick(i) },
    el("b", {}, `${i}`), el("span", { class: "n" }, row.p_m.map((x) => x.toFixed(2)).join("  ")), el("span", { class: "muted" }, `${row.tags} tag${row.tags === 1 ? "" : "s"}${row.initial ? ", initial" : ""}`)));
  const box = el("ul", { role: "listbox", tabindex: "0", "aria-label": "Candidates", "aria-activedescendant": chosen === null ? null : `candidate-${chosen}` }, rows);
  box.addEventListener("keydown", (event) => {
    const step = { ArrowDown: 1, ArrowUp: -1, PageDown: 10, PageUp: -10, Home: -1e6, End: 1e6 }[event.key];
    if (!step) return;
    event.preventDefault();
    pick(Math.min(Math.max((chosen ?? (step > 0 ? -1 : 0)) + step, 0), space.rows.length - 1));
  });
  show(parts.list, el("h2", {}, "Candidates ", el("span", { class: "muted" }, "x y z [m]")), box);
}

function pick(i) {
  if (i === chosen) return;
  chosen = i;
  found = null;
  for (const node of parts.list.querySelectorAll("li")) {
    const mine = node.id === `candidate-${i}`;
    node.classList.toggle("chosen", mine);
    node.setAttribute("aria-selected", String(mine));
    if (mine) { node.scrollIntoView({ block: "nearest" }); node.parentNode.setAttribute("aria-activedescendant", node.id); }
  }
  history.replaceState(null, "", `#spaces/candidates/${i}`);
  picture();
  clearTimeout(pick.timer);
  pick.timer = setTimeout(explain, 150);  // who walks through the list with the arrow keys asks for the last one only
}

async function explain() {
  if (!parts?.about || !space) return;
  if (chosen === null || chosen >= space.rows.length) { show(parts.about, el("h2", {}, `Numbers of ${space.crc}`), grid(space.facts)); return; }
  const asked = chosen, which = of;
  if (found?.candidate !== asked) {
    show(parts.about, el("p", { class: "muted" }, `Candidate ${asked}: all checks are made again, the first time this takes some seconds …`));
    let got;
    try { got = await ask(`space/explain/${asked}?of=${which}`); } catch (error) { if (asked === chosen && parts) show(parts.about, el("p", { class: "bad" }, error.message)); return; }
    if (!parts || asked !== chosen || which !== of) return;
    found = got;
  }
  show(parts.about, el("h2", {}, mark(found.good ? "ok" : "beyond", found.good ? "passes" : "fails"), ` Candidate ${found.candidate} ${found.good ? "passes all checks" : "fails a check"}`,
    el("span", { class: "space" }), el("button", { type: "button", onclick: () => { chosen = null; history.replaceState(null, "", "#spaces/candidates"); list(); picture(); explain(); } }, "numbers of the table")),
  grid(found.grid), el("p", { class: "small muted" }, `Checked by ${found.against}`));
  picture();
}

function picture() {
  if (!parts?.plot || !space) return;
  const still = store.about.scene, rows = space.rows, places = rows.map((r) => r.p_m);
  const data = [
    dots(places, "candidates", LIGHT.grey, 3, { text: rows.map((_, i) => `candidate ${i}`), hoverinfo: "text", marker: { size: 2.5, opacity: 0.8, color: rows.map((r) => (r.initial ? LIGHT.blue : LIGHT.grey)) }, showlegend: false }),
    line(still.mast_m, "camera mast", LIGHT.grey, 8, { showlegend: false }),
  ];
  if (rows[chosen]) data.push(dots([places[chosen]], `candidate ${chosen}`, LIGHT.orange, 8));
  if (found && found.candidate === chosen) {
    if (found.points_m) data.push(arm(found.points_m, "arm there, nominal", LIGHT.ink));
    data.push(view(found.view_m));
  }
  const node = parts.plot;
  draw(node, { data, layout: layout("space") });
  if (node.on && !node.dataset.bound) {
    node.dataset.bound = "1";
    node.on("plotly_click", (event) => { const hit = event.points[0]; if (hit.curveNumber === 0) pick(hit.pointNumber); });
  }
}

// ------------------------------------------------------------------ description

async function description() {
  let got;
  try { got = await ask("space/description"); } catch (error) { show(parts.content, el("p", { class: "bad" }, error.message)); return; }
  if (!parts || tab !== "description") return;
  const made = form({ key: "space", sections: got.sections, problems: got.problems, send: (values) => tell("space/description", { values }), done: () => { poll(); description(); } });
  show(parts.content, made.head, el("p", { class: "small muted" }, `${got.file}: values as TOML, angles in radians or as 50*deg. Shapes, keep-out volumes and pairs that may touch are edited in the file. `,
    el("a", { href: "/api/space/file/space.toml", download: "space.toml" }, "take it away"), " ", el("button", { type: "button", onclick: anew }, "begin anew with the one that ships")), scroller("Values", made.node));
}

async function anew() {
  try { say((await tell("space/anew")).text); } catch (error) { say(error.message, false); }
  await poll();
  description();
}

// ------------------------------------------------------------------ difference

async function difference() {
  const there = Object.keys(NAMES).filter((which) => crcOf(which));
  if (!there.includes(to) || to === of) to = there.find((which) => which !== of) ?? of;
  if (there.length < 2) { show(parts.content, el("p", { class: "muted" }, "There is one table only: build another, or read back the one in force.")); return; }
  const select = (label, value, set) => {
    const made = el("select", { "aria-label": label }, there.map((which) => el("option", { value: which }, `${crcOf(which)} ${NAMES[which]}`)));
    made.value = value;
    made.addEventListener("change", () => { set(made.value); difference(); });
    return made;
  };
  const head = el("p", {}, "From ", select("From", of, (x) => { of = x; space = null; side(); }), " to ", select("To", to, (x) => { to = x; }));
  let got;
  try { got = await ask(`space/difference?of=${of}&to=${to}`); } catch (error) { show(parts.content, head, el("p", { class: "bad" }, error.message)); return; }
  if (!parts || tab !== "difference") return;
  const plot = el("div", { class: "plot", role: "img", "aria-label": "Candidates that go and that come" });
  show(parts.content, head, el("p", {}, got.same ? "● the same table" : `▲ ${got.gone_m.length} candidates go, ${got.new_m.length} come`), el("section", { class: "card scene" }, plot), scroller("Difference", grid(got.grid)));
  draw(plot, { data: [dots(got.gone_m, "only in the first", LIGHT.red, 4), dots(got.new_m, "only in the second", LIGHT.green, 4, { marker: { symbol: "diamond", size: 4, color: LIGHT.green, opacity: 0.8 } }), line(store.about.scene.mast_m, "camera mast", LIGHT.grey, 8, { showlegend: false })], layout: layout("difference") });
}
