// The line below the header: what came of the last thing that was asked for.
import { el, show, utc } from "./dom.js";
import { now_s } from "./store.js";

let last = "";

// Takes back what was said, unless something else was said since.
export function unsay(text) {
  if (text && text === last) document.getElementById("said").hidden = true;
}

export function say(text, good = true) {
  last = text;
  const box = document.getElementById("said");
  box.className = good ? "good" : "bad";
  show(box, `${utc(now_s())}  ${text}`, el("button", { type: "button", class: "close", onclick: () => { box.hidden = true; } }, "close"));
  box.hidden = false;
}
