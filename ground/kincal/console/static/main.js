// The frame around the views: navigation, clocks, the state of the links, ABORT.
import { age, el, mark, mission, show, utc } from "./dom.js";
import { begin, freshness, now_s, seek, store, subscribe, tell } from "./store.js";
import { say } from "./said.js";
import * as now from "./now.js";
import * as corrections from "./corrections.js";
import * as bench from "./bench.js";
import * as tables from "./tables.js";
import * as space from "./space.js";
import * as history from "./history.js";

const VIEWS = [
  { key: "now", title: "Now", view: now },
  { key: "corrections", title: "Corrections", view: corrections },
  { key: "workbench", title: "Workbench", view: bench },
  { key: "tables", title: "Tables", view: tables },
  { key: "spaces", title: "Space", view: space },
  { key: "history", title: "History", view: history },
];
const at = (id) => document.getElementById(id);
let current = null;

// ------------------------------------------------------------------ views

function navigate() {
  const [key, ...rest] = location.hash.slice(1).split("/");
  const chosen = VIEWS.find((v) => v.key === key) ?? VIEWS[0];
  if (current !== chosen) {
    current?.view.close?.();
    current = chosen;
    at("view").className = chosen.key;
    chosen.view.open(at("view"));
    document.title = `${chosen.title} · KinCal`;
  }
  chosen.view.at?.(rest.map(decodeURIComponent));
  navigation();
}

function navigation() {
  const waits = store.values.KC_HK?.data.proposal;
  const links = VIEWS.map((v, i) => el(
    "a", { href: `#${v.key}`, "aria-current": v === current ? "page" : null, title: `Alt+${i + 1}` },
    v.title, v.key === "corrections" && waits ? el("span", { class: "badge", role: "img", title: "1 correction waits for a decision", "aria-label": "1 correction waits for a decision" }, "1") : null,
  ));
  const text = links.map((l) => l.outerHTML).join();
  if (at("views").dataset.text !== text) {
    at("views").dataset.text = text;
    at("views").replaceChildren(...links);
  }
}

// ------------------------------------------------------------------ header

function header() {
  at("clock").textContent = store.about.live
    ? `${utc(now_s())} · mission ${mission(store.t_us)}` : `recording · mission ${mission(store.t_us)}`;
  const hk = freshness("KC_HK");
  const text = hk.age_s === null ? "flight: never heard" : `flight: heard ${age(hk.age_s)} ago`;
  if (store.about.live) show(at("flight-link"), mark(hk.status, `housekeeping: ${hk.text}`), " ", text);
  document.body.classList.toggle("lost", store.lostSince_s !== null);
  document.body.classList.toggle("waiting", !store.connected);
  const several = store.about.live && store.values.KC_HK?.data?.several;
  at("lost").hidden = store.lostSince_s === null && !several;
  if (several && store.lostSince_s === null) show(at("lost"), `◆ NOT KNOWN: ${several}. Nothing but ABORT is sent: end the other sender.`);
  if (store.lostSince_s !== null) {
    const s = store.lostSince_s + store.skew_s;
    show(at("lost"), `Link to server lost since ${utc(s)} (${age(Date.now() / 1000 - store.lostSince_s)}). ` +
      "Values below are the last that were heard. If the server was started anew, open the address that it printed.");
  }
}

async function abort() {
  say("ABORT is being sent …");
  try {
    const answer = await tell("abort");
    say(answer.text, answer.ok);
  } catch (error) {
    say(`ABORT was not confirmed: ${error.message}. On the command line: kincal command abort`, false);
  }
}

// ------------------------------------------------------------------ recording

function player() {
  const [first, last] = store.about.span_us;
  const slider = el("input", { type: "range", min: String(first), max: String(last), step: "100000", value: String(last), "aria-label": "mission time" });
  const text = el("output", {}, mission(last));
  const speed = el("select", { "aria-label": "speed" }, ...[1, 5, 20, 100].map((x) => el("option", { value: String(x) }, `${x} times`)));
  speed.value = "20";
  const button = el("button", { type: "button" }, "play");
  let timer = null;
  const go = (t) => { slider.value = String(t); text.textContent = mission(t); seek(t); };
  const stop = () => { clearInterval(timer); timer = null; button.textContent = "play"; };
  slider.addEventListener("input", () => go(Number(slider.value)));
  button.addEventListener("click", () => {
    if (timer) { stop(); return; }
    if (Number(slider.value) >= last) go(first);
    button.textContent = "pause";
    timer = setInterval(() => {
      const t = Math.min(Number(slider.value) + 200_000 * Number(speed.value), last);
      go(t);
      if (t >= last) stop();
    }, 200);
  });
  at("player").replaceChildren(el("b", {}, "Recording"), button, speed, slider, text);
  at("player").hidden = false;
}

// ------------------------------------------------------------------ start

const dark = window.matchMedia("(prefers-color-scheme: dark)");

async function start() {
  try {
    await begin();
  } catch (error) {
    show(at("lost"), `The console does not answer: ${error.message}`);
    at("lost").hidden = false;
    return;
  }
  at("source").textContent = store.about.source;
  if (store.about.live) {
    at("abort").addEventListener("click", abort);
    at("source").title = store.about.recordings ? `recorded in ${store.about.recordings}` : "not recorded";
    at("source").append(el("span", { class: "muted" }, store.about.recordings ? " · recorded" : " · not recorded"));
    if (store.about.why_no_key) at("source").append(el("span", { class: "tag", title: store.about.why_no_key }, "no key: look only, ABORT works"));
  } else {
    at("abort").hidden = true;
    player();
  }
  window.addEventListener("hashchange", navigate);
  dark.addEventListener("change", () => current.view.recolour?.());
  document.addEventListener("keydown", (event) => {
    if (!event.altKey) return;
    if (event.ctrlKey && event.code === "KeyA" && store.about.live) { event.preventDefault(); abort(); }
    const chosen = VIEWS[Number(event.key) - 1];
    if (!event.ctrlKey && chosen) { event.preventDefault(); location.hash = chosen.key; }
  });
  navigate();
  subscribe((what) => { header(); navigation(); current.view.update(what); });
}

start();
