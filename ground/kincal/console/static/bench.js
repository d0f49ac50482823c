// The model workbench: files -> compare -> diagnose -> add what was found -> fit, until the error no longer falls.
// What takes long runs in a process of its own; the state lies on disk, so a reload or another browser goes on.
import { age, el, fixed, mark, show } from "./dom.js";
import { next, own, uplink } from "./benchmore.js";
import { document_ } from "./document.js";
import { say, unsay } from "./said.js";
import { ask, store, tell, upload } from "./store.js";

const TASKS = [
  ["compare", "Compare", "Does the model explain the data? Seconds."],
  ["diagnose", "Diagnose", "Which effect is missing? Up to some minutes."],
  ["fit", "Fit", "Fit the model, with its error on held-out poses. Seconds to a minute."],
  ["next", "Next poses", "The poses that separate effects best."],
];
const POLL_MS = 700;
let parts = null, state = null, chosen = null, answer = null, timer = null, stamp = "", known = "", said = "", running = null;

export function open(root) {
  parts = {
    files: el("section", { class: "card" }), model: el("section", { class: "card" }), work: el("section", { class: "card work" }),
    tabs: el("nav", { class: "tabs", "aria-label": "Answers" }), answer: el("div", { class: "answer", tabindex: "0", role: "region", "aria-label": "Answer" }), found: el("section", { class: "card found" }), next: el("div", {}), uplink: el("div", {}),
  };
  stamp = known = "";
  answer = null;
  show(root, el("div", { class: "left", tabindex: "0", role: "region", "aria-label": "Files, model, work" }, parts.files, parts.model, parts.work), el("div", { class: "middle" }, parts.tabs, parts.answer), el("aside", { class: "right", tabindex: "0", role: "region", "aria-label": "Findings and what follows" }, parts.found, parts.next, parts.uplink));
  poll();
}
export function close() { clearTimeout(timer); parts = null; unsay(said); }
export function update() { /* flight is not shown here */ }
export function recolour() { answer?.page?.draw(true); }
export function at([what]) { if (what) { chosen = what; load(); } }

async function poll() {
  clearTimeout(timer);
  if (!parts) return;
  try { state = await ask("bench"); } catch (error) { say(error.message, false); }
  if (!parts) return;
  if (state) { ended(state.job); draw(); }
  timer = setTimeout(poll, state?.job?.status === "running" ? POLL_MS : 3000);
}

// "diagnose began" is no longer true when it has ended.
function ended(job) {
  if (running && job?.status !== "running") { unsay(said); said = ""; }
  running = job?.status === "running" ? job.what : null;
}

async function act(path, body) {
  try { said = (await tell(`bench/${path}`, body)).text; say(said); } catch (error) { say(error.message, false); }
  await poll();
}

function draw() {
  const { now_s, ...rest } = state;
  const key = JSON.stringify(rest);
  if (key !== stamp) {
    stamp = key;
    files();
    model();
    work();
    const answers = JSON.stringify([state.answers, state.case.effects, state.case.arm, state.case.data]);
    if (answers !== known) {
      const done = state.job?.status === "done" ? state.job.what : null;
      if (known && done) chosen = done;
      known = answers;
      chosen ??= ["fit", "diagnose", "compare"].find((w) => state.answers[w]) ?? "compare";
      load();
    }
    found();
  }
  const bar = parts.work.querySelector(".elapsed");
  if (bar && state.job?.status === "running") show(bar, age(now_s - state.job.began_s));
}

// ------------------------------------------------------------------ files

function files() {
  const pick = (label, names, value, other) => {
    const made = el("select", { "aria-label": label, onchange: () => act("choose", other(made.value)) },
      el("option", { value: "" }, `${label} …`), names.map((n) => el("option", { value: n }, n)));
    made.value = value;
    return el("label", {}, label, made);
  };
  const { arm, data } = state.case;
  const input = el("input", { type: "file", multiple: true, "aria-label": "Upload", accept: ".csv,.toml,.lcmlog,.npz,.parquet,.mat,.json", onchange: () => send([...input.files]) });
  show(parts.files, el("h2", {}, "Files"),
    pick("Arm table", state.arms, arm, (v) => ({ arm: v })),
    pick("Measurements", state.data, data, (v) => ({ data: v })),
    el("label", {}, "Upload a table (.toml) or measurements (.csv, .lcmlog, …)", input),
    el("p", { class: "muted small" }, `kept in ${store.about.bench}`));
}

async function send(list) {
  const files = {}; // only what is new: another page may have chosen the other one
  for (const file of list) {
    try {
      const said = await upload(file.name, await file.arrayBuffer());
      say(said.text);
      if (file.name.endsWith(".toml")) files.arm = said.name; else files.data = said.name;
    } catch (error) { say(error.message, false); return; }
  }
  await act("choose", files);
}

// ------------------------------------------------------------------ model

function model() {
  const { effects, past } = state.case;
  const input = el("input", { type: "text", name: "effect", placeholder: "backlash[4]", "aria-label": "Effect to add", autocomplete: "off", list: "effects-known" });
  const names = el("datalist", { id: "effects-known" }, state.library.map((e) => el("option", { value: e.per === "joint" ? `${e.name}[1]` : e.name }, e.title)));
  const form = el("form", { class: "add" }, input, el("button", { type: "submit" }, "add"), names);
  form.addEventListener("submit", (event) => { event.preventDefault(); if (input.value.trim()) add(input.value.trim()); });
  show(parts.model, el("h2", {}, "Model ", el("span", { class: "space" }), el("button", { type: "button", disabled: !past.length, title: past.length ? `back to: ${past.at(-1).join(", ") || "DH errors alone"}` : null, onclick: () => act("undo") }, "undo")),
    el("ul", { class: "effects" }, el("li", {}, el("span", {}, "DH errors, base and tool frame")),
      effects.map((name) => el("li", {}, el("b", {}, name), el("button", { type: "button", "aria-label": `remove ${name}`, onclick: () => act("effects", { effects: [], without: [name] }) }, "remove")))),
    form, el("p", { class: "small" }, el("a", { href: "#workbench/own" }, "An effect of your own …")), errorOfFits());
}

const add = (...names) => act("effects", { effects: names, without: [] });

// The held-out errors of all fits of this case: they have to fall.
function errorOfFits() {
  const fits = state.case.fits;
  if (!fits.length) return el("p", { class: "muted small" }, "Fit shows here how the error on held-out poses falls with each effect.");
  const most = Math.max(...fits.flatMap((f) => f.errors.map((e) => e.mm)));
  const rows = [];
  const first = fits[0].errors;
  for (const e of first.slice(0, 2)) rows.push([e.model === "nominal" ? "nominal arm" : e.model, e.mm, null]);
  for (const f of fits.filter((x) => x.effects.length)) rows.push([`+ ${f.effects.join(" + ")}`, f.errors.at(-1).mm, f.effects]);
  return el("div", { class: "fits" }, el("h2", {}, "Error on held-out poses"), rows.map(([label, mm, effects]) => el("div", { class: effects && JSON.stringify(effects) === JSON.stringify(state.case.effects) ? "mine" : "" },
    el("span", { title: label }, label), el("i", { style: { width: `${Math.max(Math.log10(1 + 99 * mm / most) * 50, 1)}%` } }), el("b", { class: "n" }, fixed(mm, 3, "mm")))), el("p", { class: "muted small" }, "Bars: logarithmic."));
}

// ------------------------------------------------------------------ work

function work() {
  const job = state.job, running = job?.status === "running", ready = state.case.arm && state.case.data;
  const p = job?.progress ?? {};
  show(parts.work, el("h2", {}, "Work"),
    el("div", { class: "buttons" }, TASKS.filter(([what]) => what !== "next").map(([what, label, about]) => el("button", { type: "button", title: about, disabled: running || !ready, onclick: () => act("run", { what }) }, label))),
    !ready ? el("p", { class: "muted small" }, "Choose an arm and measurements first.") : null,
    running ? el("div", { class: "progress" }, el("progress", p.of ? { max: String(p.of), value: String(p.done) } : {}), el("p", {}, `${job.what}: ${p.what ?? "begins"}${p.of ? ` ${p.done} of ${p.of}` : ""}, `, el("span", { class: "elapsed" })), el("button", { type: "button", onclick: () => act("cancel") }, "cancel")) : null,
    job && !running ? el("p", { class: job.status === "failed" ? "bad" : "muted" }, mark(job.status === "failed" ? "beyond" : job.status === "done" ? "ok" : "unknown", job.status), ` ${job.what} ${job.status === "done" ? job.text : job.status === "failed" ? `failed: ${job.text}` : job.status}`) : null);
}

// ------------------------------------------------------------------ answers

async function load() {
  if (!parts || !state) return;
  tabs();
  const what = chosen;
  follow();
  if (what === "own") {
    answer = null;
    own(parts.answer, async (name) => { await add(name); location.hash = "#workbench/fit"; });
    found();
    return;
  }
  if (!state.answers[what]) {
    answer = null;
    show(parts.answer, el("p", { class: "muted" }, state.case.arm && state.case.data ? `No answer of ${what} yet: start it at the left.` : "Choose an arm and measurements at the left, or upload them."));
    found();
    return;
  }
  let got;
  try { got = await ask(`bench/answer/${what}`); } catch (error) { show(parts.answer, el("p", { class: "bad" }, error.message)); return; }
  if (!parts || what !== chosen) return;
  const page = document_(got.page);
  answer = { ...got, page, what };
  show(parts.answer,
    got.current ? null : el("p", { class: "attention" }, `▲ This answer is of another case: ${got.key.arm}, ${got.key.data}, effects: ${got.key.effects.join(", ") || "none"}.`),
    got.note ? el("p", { class: "attention" }, `▲ ${got.note}`) : null,
    got.files?.length ? el("p", {}, "Take away: ", got.files.flatMap((f) => [el("a", { href: `/api/bench/file/${what}/${encodeURIComponent(f)}`, download: f }, f), " "])) : null,
    page.node, got.text ? el("details", { open: what === "compare" }, el("summary", {}, "The answer as text"), el("pre", {}, got.text)) : null);
  page.draw();
  found();
}

// What an answer leads to.
function follow() {
  const running = state.job?.status === "running";
  show(parts.next, next(state.case.effects.slice(-2), act, running));
  show(parts.uplink, uplink(state));
}

function tabs() {
  show(parts.tabs, TASKS.map(([what, label]) => el("a", { href: `#workbench/${what}`, "aria-current": what === chosen ? "page" : null }, label, state.answers[what] ? null : el("span", { class: "muted" }, " –"))), el("a", { href: "#workbench/own", "aria-current": chosen === "own" ? "page" : null }, "Own effect"));
}

async function found() {
  if (!parts) return;
  if (!state?.answers.diagnose) { show(parts.found, el("h2", {}, "Findings"), el("p", { class: "muted" }, "Diagnose names the effects that the model lacks; they can be added from here.")); return; }
  let got = answer?.what === "diagnose" ? answer : null;
  if (!got) { try { got = await ask("bench/answer/diagnose"); } catch { return; } }
  if (!parts) return;
  const mine = new Set(state.case.effects);
  const all = got.findings.filter((f) => f.found && !mine.has(f.name)).map((f) => f.name);
  const same = got.key.arm === state.case.arm && got.key.data === state.case.data;
  show(parts.found, el("h2", {}, "Findings"),
    same ? null : el("p", { class: "attention" }, "▲ of other measurements than the chosen ones"),
    same && all.length ? el("button", { type: "button", class: "primary", onclick: () => add(...all) }, all.length === 1 ? "add the effect found" : `add all ${all.length} effects found`) : null,
    got.findings.length ? el("ul", {}, got.findings.map((f) => el("li", {},
      el("p", {}, mark(f.found ? "ok" : "unknown", f.found ? "found" : "alternative"), " ", el("b", {}, f.label), ` ${f.found ? "found" : "alternative"}, ${f.probability > 0.99 ? "P > 0.99" : `P = ${f.probability.toFixed(2)}`}`),
      el("p", { class: "small" }, f.gain), f.confounded.length ? el("p", { class: "small attention" }, `▲ confounded with ${f.confounded.slice(0, 4).join(", ")}`) : null,
      mine.has(f.name) ? el("span", { class: "muted" }, "in the model") : same ? el("button", { type: "button", onclick: () => add(f.name) }, "add") : null)))
      : el("p", {}, "● These measurements show no missing effect."));
}
