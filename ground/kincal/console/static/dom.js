// Elements, numbers and times. Text from outside only ever becomes a text node.

// What a browser would obey is shown instead, as on a terminal: characters that turn the direction of what follows.
const OBEYED = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]/g;
const shown = (child) => (typeof child === "string" ? child.replace(OBEYED, (c) => `\\x${c.charCodeAt(0).toString(16).padStart(2, "0")}`) : child);
const inside = (children) => children.flat().filter((c) => c !== null && c !== undefined && c !== false).map(shown);

export function el(tag, given = {}, ...children) {
  const made = document.createElement(tag);
  for (const [key, value] of Object.entries(given)) {
    if (value === undefined || value === null || value === false) continue;
    if (key === "class") made.className = value;
    else if (key === "style") for (const [name, v] of Object.entries(value)) made.style.setProperty(name, v);
    else if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value === true) made.setAttribute(key, "");
    else made.setAttribute(key, key === "value" ? value : shown(value));
  }
  made.append(...inside(children));
  return made;
}

// Text with commands between backticks, as the dictionary of events has it.
export const prose = (text) => text.split("`").map((part, k) => (k % 2 ? el("code", {}, part) : part));

export function svg(tag, given = {}, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(given)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

// Replaces the content of an element, unless it is the same text already.
export function show(node, ...children) {
  if (children.length === 1 && typeof children[0] === "string") {
    if (node.textContent !== shown(children[0])) node.textContent = shown(children[0]);
  } else {
    node.replaceChildren(...inside(children));
  }
}

export const utc = (seconds) => `${new Date(seconds * 1000).toISOString().slice(11, 19)} UTC`;
export const utcFull = (seconds) => new Date(seconds * 1000).toISOString().replace("T", " ").replace("Z", " UTC");

export function age(seconds) {
  const s = Math.max(seconds, 0);
  if (s < 10) return `${s.toFixed(1)} s`;
  if (s < 120) return `${s.toFixed(0)} s`;
  if (s < 7200) return `${(s / 60).toFixed(0)} min`;
  return `${(s / 3600).toFixed(1)} h`;
}

export function mission(t_us) {
  if (t_us === null || t_us === undefined) return "unknown";
  if (t_us > 1e15) return utc(t_us * 1e-6);  // flight's clock counts from 1970
  return `${(t_us * 1e-6).toFixed(1)} s`;
}

export const fixed = (value, digits, unit = "") =>
  value === null || value === undefined ? "unknown" : `${value.toFixed(digits)}${unit ? ` ${unit}` : ""}`;

// Colour and shape of a state, so that neither alone carries it.
const SHAPES = { ok: "●", near: "▲", beyond: "◆", stale: "◐", unknown: "○", fresh: "●", info: "●", warning: "▲", error: "◆", debug: "·" };
export const mark = (kind, label = "") =>
  el("span", { class: `mark ${kind}`, role: "img", "aria-label": label || kind, title: label || kind }, SHAPES[kind] ?? "●");
