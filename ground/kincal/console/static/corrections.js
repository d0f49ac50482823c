// Corrections that were proposed: see, question, decide. The same page as `kincal review show`, the same steps as
// `kincal review arm`, `go`, `reject`.
import { el, fixed, mark, mission, prose, show } from "./dom.js";
import { confirmed, onItsWay } from "./confirm.js";
import { document_, grid } from "./document.js";
import { question } from "./benchmore.js";
import { ask, keep, kept, now_s, store, tell } from "./store.js";

const LOOK_MS = 3000; // between two looks whether another program has written into the journal

let parts = null, chosen = null, shown = null, stamp = {}, rolling = false; // rolling: the middle shows a rollback

export function open(root) {
  parts = {
    inbox: el("section", { class: "card inbox" }),
    force: el("section", { class: "card force" }),
    journal: el("section", { class: "card journal" }),
    review: el("div", { class: "review", tabindex: "0", role: "region", "aria-label": "Review" }),
    decide: el("aside", { class: "card decide", "aria-label": "Decision" }),
  };
  stamp = {};
  shown = null;
  rolling = false;
  show(root, el("div", { class: "left", tabindex: "0", role: "region", "aria-label": "Inbox and journal" }, parts.inbox, parts.force, parts.journal), parts.review, parts.decide);
  update();
  if (chosen) load();
  journal();
}
export function close() { parts = null; }
export function at([crc]) {
  if (crc) { rolling &&= crc === chosen; chosen = crc; }
  else update();
  if (chosen && !shown) load(); // also when the view is opened again
  else if (crc && shown.crc !== crc) load();
}
export function recolour() { shown?.page.draw(true); }

export function update() {
  if (!parts) return;
  inbox();
  force();
  const hk = store.values.KC_HK?.data;
  const key = `${hk?.state}/${hk?.proposal}/${hk?.tables.KIN}/${hk?.armed_key}/${hk?.two_holders}`;
  if (stamp.flight !== undefined && stamp.flight !== key) { load(); journal(); }
  stamp.flight = key;
  countdown();
  elsewhere();
}

// What another program writes into the journal is shown here too.
async function elsewhere() {
  if (!store.about.live || store.lostSince_s !== null || Date.now() < (stamp.looked ?? 0) + LOOK_MS) return;
  stamp.looked = Date.now();
  let found;
  try { found = (await ask("journal/version")).version; } catch { return; } // said by what needs the journal
  if (!parts) return;
  if (stamp.journal !== undefined && stamp.journal !== found) { load(); journal(); }
  stamp.journal = found;
}

// ------------------------------------------------------------------ inbox

const KIND = { "change proposed": "ok", "poor fit": "beyond", "no change needed": "unknown" };

function inbox() {
  const hk = store.values.KC_HK?.data, list = store.values.inbox?.data ?? [];
  const key = JSON.stringify([list, hk?.proposal, hk?.tables.KIN, chosen]);
  if (stamp.inbox === key) return;
  stamp.inbox = key;
  if (!chosen && !list.length) show(parts.review, el("p", { class: "muted" }, "Corrections that flight proposes appear here."));
  parts.decide.hidden = !chosen;
  if (!chosen && list.length) { chosen = hk?.proposal || list[0].crc; load(); }
  const what = (p) => (p.crc === hk?.proposal ? "waits for a decision" : p.crc === hk?.tables.KIN ? "in force" : "");
  show(parts.inbox, el("h2", {}, "Inbox"),
    hk?.proposal && !list.some((p) => p.crc === hk.proposal)
      ? el("p", { class: "attention" }, `▲ Correction ${hk.proposal} waits on board, and was sent before this console listened: it cannot be shown here. Its recording shows it: kincal serve --log FILE.`) : null,
    unheard(hk, list),
    list.length ? el("ul", {}, list.map((p) => el("li", { class: p.crc === chosen ? "chosen" : "" },
      el("a", { href: `#corrections/${p.crc}` },
        el("b", {}, mark(KIND[p.verdict] ?? "unknown", p.verdict), ` ${p.crc}`), el("span", { class: "attention" }, what(p)),
        el("small", {}, `${p.verdict}; session ${p.session}, ${p.poses} poses${p.ended ? `, measuring ended: ${p.ended}` : ""}, ${fixed(p.before_mm, 2)} → ${fixed(p.fit_mm, 2, "mm")}; ${mission(p.t_us)}`)))))
      : el("p", { class: "muted" }, "No correction was proposed since this console was started."));
}

// What nobody can be shown here can still be rejected: a new calibration is safe.
function unheard(hk, list) {
  if (!hk?.proposal || !store.about.live || list.some((p) => p.crc === hk.proposal)) return null;
  return rejection(hk.proposal, hk, `Reject ${hk.proposal} …`, () => journal());
}
const rejection = (crc, hk, label, done) => confirmed({
  label, act: "REJECT", danger: true, path: `review/${crc}/reject`, key: `reject:${crc}`, disabled: store.about.why_no_key, done,
  text: () => `Correction ${crc} is dropped for good; table ${hk.tables.KIN} stays in force. A new one needs a new calibration.`,
});

function force() {
  const hk = store.values.KC_HK?.data;
  const key = JSON.stringify([hk?.tables.KIN, hk?.state]);
  if (stamp.force === key) return;
  stamp.force = key;
  const crc = hk?.tables.KIN;
  show(parts.force, el("h2", {}, "In force"), el("p", {}, "Kinematics table ", el("code", {}, crc || "unknown")),
    crc && store.about.live ? confirmed({
      label: "Roll back …", act: "ROLLBACK", danger: true, path: "rollback", key: `rollback:${crc}`, body: () => ({ crc }), disabled: store.about.why_no_key, done: () => { rolledBack(); journal(); }, closing: rolledBack,
      text: () => `The table before ${crc} comes in force again, for every motion from then on. Flight refuses it while a calibration runs or if it has no table before this one.`,
      preview: rollbackPreview,
    }) : null);
}

// What changes back, at once, in the middle; clearance and reach follow there when they are computed.
async function rollbackPreview() {
  let found;
  try { found = await ask("rollback/preview"); } catch (error) { return [el("p", { class: "attention" }, `▲ No preview: ${error.message}`)]; }
  const near = el("div"), against = el("div", { class: "bad" }), wait = el("div");
  const draw = (now) => {
    show(against, ...(now.against.length ? [el("p", {}, "◆ Against it:"), el("ul", {}, now.against.map((r) => el("li", {}, r)))] : []));
    show(near, ...now.near.flatMap((s) => [el("h2", {}, s.title), s.text ? el("p", {}, s.text) : null, s.grid ? grid(s.grid) : null]));
    show(wait, computed(now.clearance, () => ask("rollback/preview"), (later) => later.clearance, draw));
  };
  if (!parts) return [];
  rolling = true;
  show(parts.review, el("div", { class: "document" }, el("h1", {}, `Rollback of ${found.crc} to ${found.to}`), el("p", { class: "sub" }, "what the table before changes back; nothing is sent yet"),
    wait, el("h2", {}, "What changes back"), grid(found.grid), near));
  parts.review.scrollTop = 0;
  draw(found);
  return [el("p", {}, el("b", {}, "What changes back: "), `${found.headline}. The values, clearance and reach stand beside.`), against];
}
function rolledBack() { rolling = false; load(); }

let asked = 0;

async function journal() {
  if (!parts || !store.about.live) return;
  const turn = ++asked;
  let lines;
  try { lines = await ask("journal"); } catch (error) {
    if (parts) show(parts.journal, el("h2", {}, "Journal"), el("p", { class: "bad" }, error.message));
    return;
  }
  let missing = "";
  if (!lines.length) try { missing = (await ask("journal/missing")).text; } catch { /* said by the list itself */ }
  if (!parts || turn !== asked) return; // a later question is on its way
  show(parts.journal, el("h2", {}, "Journal"), missing ? el("p", { class: "bad missing" }, `◆ ${missing}`) : null, lines.length
    ? el("ul", {}, lines.slice(0, 100).map((e) => el("li", {}, el("b", {}, `${e.text} ${e.crc}`), ` ${e.by}${e.key ? `, key ${e.key}` : ""}${e.armed_key ? ` (armed by key ${e.armed_key})` : ""}`, el("small", {}, `${utcText(e.time)}: ${e.why}${e.override ? `; override: ${e.override}` : ""}${e.unfinished ? ". ▲ Nothing says what came of it: the state of flight does." : ""}`))))
    : el("p", { class: "muted" }, "No decision was written yet."), el("p", { class: "muted small" }, store.about.journal));
}

// ------------------------------------------------------------------ review

async function load() {
  if (!parts || chosen === null) return;
  const crc = chosen;
  stamp.inbox = null;
  let found;
  try {
    found = await ask(`review/${encodeURIComponent(crc)}`);
  } catch (error) {
    if (!parts || crc !== chosen) return;
    const hk = store.values.KC_HK?.data;
    shown = null;
    show(parts.review, el("p", { class: "bad" }, ...prose(error.message)));
    // the inbox offers it where it was not heard
    const listed = hk?.proposal === crc && store.about.live && (store.values.inbox?.data ?? []).some((p) => p.crc === crc);
    if (!onItsWay(crc)) show(parts.decide, el("h2", {}, "Decision"), listed ? rejection(crc, hk, "Reject …", () => { load(); journal(); }) : null);
    return;
  }
  if (!parts || crc !== chosen) return;
  const top = shown?.crc === crc ? parts.review.scrollTop : 0;
  const page = document_(found.page, shown?.crc === crc ? shown.page : null);
  shown = { crc, found, page };
  decide();
  inbox();
  if (rolling) return;
  show(parts.review, page.node);
  page.node.querySelector(".sub").after(...[question(crc), clearance(crc, found.clearance)].filter(Boolean));
  page.draw();
  parts.review.scrollTop = top;
}

// Clearance and reach are computed by a process of the console; the page is drawn again when they are there.
function clearance(crc, state) {
  return computed(state, () => ask(`review/${encodeURIComponent(crc)}/clearance`), (now) => now, () => { if (parts && shown?.crc === crc) load(); });
}

const computing = (state) => ["running", "waiting"].includes(state?.status);

// A bar while they are computed, null if they are not; again(): asks once more; of(answer): how far it is; done(answer).
function computed(state, again, of, done) {
  if (!computing(state)) return null;
  const bar = el("progress", { "aria-label": "Clearance and reach" }), node = el("div", { class: "progress clearance" }, "Clearance and reach are being computed ", bar);
  const fill = (s) => { if (s.of) { bar.max = s.of; bar.value = s.done; } };
  fill(state);
  const begun = Date.now(), timer = setInterval(async () => {
    if (!node.isConnected && Date.now() - begun > 2000) { clearInterval(timer); return; }
    let now;
    try { now = await again(); } catch { return; }
    if (computing(of(now))) { fill(of(now)); return; }
    clearInterval(timer);
    done(now);
  }, 1000);
  return node;
}

// ------------------------------------------------------------------ decide

function decide() {
  if (onItsWay(shown.crc) && parts.decide.childElementCount) return; // drawn when the answer has come
  const at = focused();
  decision();
  if (at) focusAgain(at);
}

// Where the keyboard is in the decision, and there again when it was drawn anew: else at what comes next.
function focused() {
  const node = document.activeElement;
  if (!parts.decide.contains(node)) return null;
  return { key: node.closest("[data-key]")?.dataset.key, name: node.name, from: node.selectionStart, to: node.selectionEnd };
}
function focusAgain({ key, name, from, to }) {
  const box = [...parts.decide.querySelectorAll("[data-key]")].find((b) => b.dataset.key === key);
  const node = (name && box?.querySelector(`[name="${name}"]`)) || box?.querySelector("button:enabled") || parts.decide.querySelector("li.next button:enabled");
  node?.focus();
  if (node && from !== undefined && from !== null && node.name === name) node.setSelectionRange(from, to);
}

function decision() {
  const { crc, found } = shown, hk = store.values.KC_HK?.data;
  const waits = hk?.proposal === crc, armed = waits && hk.state === "ARMED";
  const why = store.about.why_no_key;
  if (!store.about.live) { show(parts.decide, el("h2", {}, "Decision"), el("p", { class: "muted" }, "A recording: nothing can be sent.")); return; }
  if (!waits) {
    const text = hk?.tables.KIN === crc ? "● In force. Nothing to decide." : "This correction does not wait on board. Nothing to decide.";
    show(parts.decide, el("h2", {}, "Decision"), el("p", {}, text));
    return;
  }
  const poor = found.reasons.length > 0, wait = computing(found.clearance) ? "clearance and reach are still being computed" : "";
  const again = () => { load(); journal(); };
  const open = found.remarks.filter((r) => r.open).length; // they stand below, each with its answer
  const asks = open ? ` ▲ ${open > 1 ? `${open} questions are` : "1 question is"} open.` : "";
  const first = [...found.look_at.filter((text) => !text.startsWith("open question by ")), ...(open ? [`${open} open question${open > 1 ? "s" : ""}, below`] : [])];
  show(parts.decide, el("h2", {}, "Decision"),
    poor ? el("div", { class: "bad" }, el("p", {}, "◆ There are reasons to reject it:"), el("ul", {}, found.reasons.map((r) => el("li", {}, r)))) : el("p", {}, wait ? `● No number fails its threshold so far; ${wait}.` : "● No number fails its threshold. Read the page beside before you decide."),
    first.length ? el("div", { class: "attention" }, el("p", {}, "▲ Look at this first:"), el("ul", {}, first.map((r) => el("li", {}, r)))) : null,
    remarks(crc, found.remarks, why, again),
    el("ol", { class: "steps" },
      el("li", { class: found.seen_by.length ? "done" : "next" }, el("b", {}, "Seen"), el("p", { class: "small" }, found.seen_by.length ? `by ${found.seen_by.join(", ")}` : "Who approves must have seen it: this is written into the journal."), seen(crc, found.shown, again, wait)),
      el("li", { class: armed ? "done" : found.seen_by.length ? "next" : "" }, el("b", {}, "ARM"), twoPersons(hk, armed), armed ? el("p", { class: "small" }, hk.armed_key ? `armed by key ${hk.armed_key}` : "armed") : confirmed({
        label: "Arm the approval …", act: "ARM", path: `review/${crc}/arm`, key: `arm:${crc}`, disabled: why || wait || (found.seen_by.length ? "" : "nobody has seen it yet"), done: again,
        more: poor ? [OVERRIDE] : [],
        text: () => `First step: flight is armed for correction ${crc}. Nothing is in force yet.${asks}`,
      })),
      el("li", { class: armed ? "next" : "" }, el("b", {}, "GO"), el("p", { class: "small countdown" }), otherKey(armed, found.go), armed ? confirmed({
        label: "Put it in force …", act: "GO", danger: true, path: `review/${crc}/go`, key: `go:${crc}`, disabled: why || found.go.why_not, done: again,
        more: found.go.override ? [OVERRIDE] : [],
        text: () => `Second step: correction ${crc} replaces ${hk.tables.KIN} for every motion from now on.${found.go.override ? " It was armed elsewhere: the journal of this console does not say why the reasons to reject it are overridden." : ""}${asks}`,
      }) : el("p", { class: "small muted" }, "after ARM"))),
    el("h2", {}, "Or reject it"), rejection(crc, hk, "Reject …", again),
    el("h2", {}, "Ask or comment"), el("p", { class: "small muted" }, "A question stays open, for everybody who decides, until somebody answers it. Whoever has seen the correction before has to look at it again."), confirmed({
      label: "Write to the journal …", act: "Write", path: `review/${crc}/remark`, key: `remark:${crc}`, disabled: why, done: again, fields: ["by"],
      more: [{ name: "what", label: "Kind", value: "question", choices: [["question", "question, that somebody has to answer"], ["comment", "comment"]] }, { name: "text", label: "Text", long: true }],
      text: () => `About correction ${crc}; the journal keeps it.`,
    }));
  countdown();
}

const OVERRIDE = { name: "override", label: "Override: why it is approved in spite of the reasons to reject it", long: true, words: 3 };

// What people have asked and said of it, oldest first; an open question is answered here.
function remarks(crc, list, why, again) {
  if (!list.length) return null;
  const typed = (line) => kept(`draft:answer:${line}:${crc}`, {}).text;
  const answers = (line) => list.filter((r) => r.answers === line);
  const head = (r) => el("p", {}, el("b", {}, `${r.open ? "▲ open question" : r.what === "question" ? "● question, answered" : r.answers ? "answer" : "comment"} `), el("small", {}, `${r.by}, key ${r.key}, ${utcText(r.time)}, line ${r.line}${r.answers ? `, to line ${r.answers}` : ""}`));
  const one = (r) => el("li", { class: r.open ? "open" : "" }, head(r), el("p", { class: "pre" }, r.text),
    ...answers(r.line).map((a) => el("div", { class: "answered" }, head(a), el("p", { class: "pre" }, a.text))),
    r.open || typed(r.line) ? confirmed({
      label: `${r.open ? "Answer" : "Add to"} line ${r.line} …`, act: "Write the answer", path: `review/${crc}/remark`, key: `answer:${r.line}:${crc}`, disabled: why, done: again, fields: ["by"],
      body: () => ({ what: "comment", answers: r.line }), more: [{ name: "text", label: `Answer to ${r.by}`, long: true }],
      text: () => r.open ? "The question is closed by it; the journal keeps both." : "▲ Somebody has answered meanwhile. What you have typed is added to it.",
      closing: () => { if (!r.open) { keep(`draft:answer:${r.line}:${crc}`, {}); again(); } },
    }) : null);
  const lines = new Set(list.map((r) => r.line));
  return el("section", { class: "remarks", "aria-label": "Questions and comments" }, el("h2", {}, "Questions and comments"), el("ul", {}, list.filter((r) => !lines.has(r.answers)).map(one)));
}

const utcText = (time) => time.replace("T", " ").replace("+00:00", " UTC");

function twoPersons(hk, armed) {
  return hk.two_holders && !armed ? el("p", { class: "small" }, "Two persons: GO has to be given with a key of another holder than ARM.") : null;
}

// What keeps this console from the second step.
function otherKey(armed, go) {
  return armed && go.why_not ? el("p", { class: "attention small other-key" }, `▲ ${go.why_not}. This console signs with key ${go.key}: the second person gives GO at a console or terminal of his own.`) : null;
}

function seen(crc, page, again, wait) {
  const input = el("input", { type: "text", name: "seen", autocomplete: "off", "aria-label": "Your name" });
  input.value = kept("by", "");
  input.addEventListener("input", () => keep("by", input.value));
  const said = el("span", { class: "bad small", role: "alert" }, stamp.notSeen?.crc === crc ? stamp.notSeen.text : "");
  const form = el("form", { class: "seen", "data-key": "seen" }, el("label", {}, "Your name", input), el("button", { type: "submit", disabled: Boolean(store.about.why_no_key || wait), title: wait || null }, "I have seen it"), said);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    stamp.notSeen = null;
    try { await tell(`review/${crc}/seen`, { by: input.value, shown: page }); } catch (error) { stamp.notSeen = { crc, text: error.message }; }
    again();
  });
  return form;
}

function countdown() {
  const node = parts?.decide.querySelector(".countdown"), value = store.values.KC_HK;
  if (!node || !value) return;
  const left = value.data.state === "ARMED" ? value.data.approval_left_s - (now_s() - value.received_s) : 0;
  const by = value.data.go_by && !parts.decide.querySelector(".other-key") ? `; GO with ${value.data.go_by}` : "";
  show(node, left > 0 ? `expires in ${Math.floor(left / 60)} min ${Math.floor(left % 60)} s${by}` : "");
}
