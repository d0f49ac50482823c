// What the server has said: newest values, rows of the log, and whether anything can be heard.
import { utc } from "./dom.js";

const SILENT_MS = 3000;   // without a message: the link is lost
const RETRY_MS = [500, 1000, 2000, 4000];
const KEPT = 60000;       // rows of the log in this window

export const store = {
  values: {},             // channel -> {received_s, t_us, data}
  rows: [],               // of the log, oldest first
  periods: {},
  t_us: null,             // newest mission time
  skew_s: 0,              // server's clock - this browser's
  lostSince_s: null,      // browser's clock; null: heard
  about: null,
  connected: false,
};

const listeners = new Set();
export const subscribe = (fn) => { listeners.add(fn); return () => listeners.delete(fn); };
const changed = (what) => { for (const fn of listeners) fn(what); };

export const now_s = () => (store.about?.live === false && store.playing_s !== undefined
  ? store.playing_s : Date.now() / 1000 + store.skew_s);

// "fresh", "stale" or "unknown", by when it came and by its stamp against the newest one.
export function freshness(channel) {
  const value = store.values[channel];
  if (!value) return { status: "unknown", text: "never received", age_s: null };
  const age_s = Math.max(now_s() - value.received_s, 0);
  const behind_s = value.t_us === null || store.t_us === null ? 0 : (store.t_us - value.t_us) * 1e-6;
  const most = 3 * (store.periods[channel] ?? Infinity);
  if (store.lostSince_s !== null) return { status: "unknown", text: "link to server lost", age_s };
  if (age_s > most) return { status: "stale", text: "nothing comes", age_s };
  if (behind_s > Math.max(most, 3)) return { status: "stale", text: `stamp ${behind_s.toFixed(0)} s old`, age_s };
  return { status: "fresh", text: "fresh", age_s };
}

let socket = null, heard = 0, attempt = 0;

export function seek(t_us) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ seek_us: Math.round(t_us) }));
}

function take(message) {
  heard = Date.now();
  attempt = 0;
  store.connected = true;
  if (store.about?.live === false) store.playing_s = message.now_s;
  else store.skew_s = message.now_s - Date.now() / 1000;
  store.t_us = message.t_us;
  if (message.kind === "snapshot") {
    store.values = {};
    store.periods = message.periods_s;
    store.rows = joined(message);
  } else if (message.rows_lost) {
    gap(`${message.rows_lost} rows were not kept by the server`);
  }
  if (store.lostSince_s !== null) {
    gap(`link to server lost from ${utc(store.lostSince_s + store.skew_s)} to ${utc(message.now_s)}; ` +
        "values of that time were not seen, events and acknowledgements are listed");
    store.lostSince_s = null;
  }
  if (message.kind !== "snapshot" && message.rows?.length) {
    store.rows.push(...message.rows);
    if (store.rows.length > KEPT) store.rows.splice(0, store.rows.length - KEPT);
  }
  Object.assign(store.values, message.values);
  changed(message.kind);
}

// Rows that were here before a gap stay; the snapshot goes on where they ended, if it reaches that far back.
function joined(message) {
  if (store.about?.live === false) return message.rows;
  const last = store.rows.findLast((row) => row.n !== undefined);
  if (!last || !message.rows.length || message.rows[0].n > last.n + 1) return message.rows;
  if (message.rows.at(-1).n < last.n) return message.rows;  // another server: its count began anew
  const same = message.rows.find((row) => row.n === last.n);
  if (!same || same.text !== last.text || same.t_us !== last.t_us) return message.rows;
  return [...store.rows, ...message.rows.filter((row) => row.n > last.n)];
}

function gap(text) {
  store.rows.push({ kind: "gap", severity: "warning", name: "GAP", text, t_us: store.t_us, received_s: now_s() });
}

function lost() {
  if (store.lostSince_s !== null) return;
  store.lostSince_s = heard ? heard / 1000 : Date.now() / 1000;
  store.connected = false;
  changed("lost");
}

function open() {
  const mine = new WebSocket(`ws://${location.host}/api/feed`);
  socket = mine;
  mine.onmessage = (event) => take(JSON.parse(event.data));
  mine.onclose = () => {
    if (socket !== mine) return;
    lost();
    setTimeout(open, RETRY_MS[Math.min(attempt++, RETRY_MS.length - 1)]);
  };
}

export async function begin() {
  store.about = await ask("about");
  open();
  setInterval(() => {
    if (store.about.live && heard && store.lostSince_s === null && Date.now() - heard > SILENT_MS) {
      lost();
      socket.close();
    }
    changed("tick");
  }, 500);
}

// ------------------------------------------------------------------ requests

export async function ask(path) {
  const answer = await fetch(`/api/${path}`);
  const body = await answer.json().catch(() => ({ ok: false, text: `the server answered ${answer.status}` }));
  if (!answer.ok) throw new Error(body.text ?? `the server answered ${answer.status}`);
  return body;
}

// A request carries a number: if its answer is lost it can be sent again, and is carried out once.
export async function tell(path, body = {}) {
  const number = crypto.randomUUID();
  for (let turn = 0; ; turn += 1) {
    let answer;
    try {
      answer = await fetch(`/api/${path}`, {
        method: "POST",
        headers: { "Content-Type": "application/json" },
        body: JSON.stringify({ ...body, number }),
      });
    } catch {
      if (turn < 2) { await new Promise((done) => setTimeout(done, 700)); continue; }
      throw new Error("no answer from the server of this console: look at the state before you do it again");
    }
    const said = await answer.json().catch(() => ({ ok: false, text: `the server answered ${answer.status}` }));
    if (!answer.ok) throw new Error(said.text ?? `the server answered ${answer.status}`);
    return said;
  }
}

export async function upload(name, data) {
  const answer = await fetch(`/api/bench/upload?name=${encodeURIComponent(name)}`, {
    method: "POST", headers: { "Content-Type": "application/octet-stream" }, body: data,
  });
  const said = await answer.json().catch(() => ({ text: `the server answered ${answer.status}` }));
  if (!answer.ok) throw new Error(said.text);
  return said;
}

// ------------------------------------------------------------------ kept in this browser

export function kept(key, fallback) {
  try { return JSON.parse(localStorage.getItem(`kincal:${key}`)) ?? fallback; } catch { return fallback; }
}
export function keep(key, value) {
  try { localStorage.setItem(`kincal:${key}`, JSON.stringify(value)); } catch { /* a full store loses a draft */ }
}
