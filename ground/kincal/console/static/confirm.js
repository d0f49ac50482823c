// An action that is never one click away: the first opens a form with what it would do and asks who and why,
// the second does it. What is half typed is kept in this browser until it is sent.
import { el, show, utc } from "./dom.js";
import { keep, kept, now_s, tell } from "./store.js";
import { say } from "./said.js";

// label: of the first button; act: of the second; text(): what happens; path, body(): of the request; key: of
// the draft; preview(): elements that show what would change; more: further fields {name, label, value: as it is
// offered, long: several lines, words: how many it needs at least, choices}; disabled: why it cannot be; closing():
// it was cancelled.
const sending = new Set();
// Whether something of these keys is on its way: what would offer it again has to wait.
export const onItsWay = (end) => [...sending].some((key) => key.endsWith(end));

// Words with a letter or a digit, as flight's ground tool counts them.
const counted = (text) => text.split(/\s+/).filter((word) => /[\p{L}\p{N}]/u.test(word)).length;

export function confirmed({ label, act, text, path, body = () => ({}), key, danger = false, fields = ["by", "why"], more = [], disabled = "", done = () => {}, preview = null, closing = () => {} }) {
  const box = el("div", { class: "confirm", "data-key": key });
  const draft = kept(`draft:${key}`, {});
  const labels = { by: "Your name", why: "Reason, for the record" };

  function closed() {
    show(box, el("button", { type: "button", class: danger ? "danger" : "", disabled: Boolean(disabled), title: disabled || null, onclick: () => { draft.open = true; save(); opened(true); } }, label));
  }
  function save() { keep(`draft:${key}`, draft); }
  function field({ name, label: title, value = "", long = false, words = 0, choices = null }) {
    const id = `confirm-${key}-${name}`, hint = words ? el("small", { id: `${id}-hint` }) : null;
    const more = { id, name, required: true, "aria-describedby": hint?.id };
    const made = choices ? el("select", more, choices.map(([v, text]) => el("option", { value: v }, text)))
      : el(long ? "textarea" : "input", { ...more, autocomplete: "off", maxlength: name === "by" ? "200" : "20000", ...(long ? { rows: "3" } : { type: "text" }) });
    made.value = draft[name] ?? (name === "by" ? kept("by", "") : value);
    made.enough = () => Boolean(made.value.trim()) && counted(made.value) >= words;
    const count = () => { if (hint) show(hint, `${made.enough() ? "●" : "▲"} at least ${words} words; ${counted(made.value)} so far`); };
    made.addEventListener("input", () => { draft[name] = made.value; if (name === "by") keep("by", made.value); save(); count(); check(); });
    count();
    return [el("label", {}, title, made, hint), made];
  }
  let check = () => {};
  function cancel() { draft.open = false; delete draft.error; save(); closed(); box.querySelector("button").focus(); closing(); }
  function opened(focus) {
    const made = [...fields.map((name) => ({ name, label: labels[name] })), ...more].map((f) => [f.name, ...field(f)]);
    const go = el("button", { type: "submit", class: danger ? "danger" : "primary" }, act);
    const stop = el("button", { type: "button", onclick: cancel }, "cancel");
    const said = el("p", { class: "bad small", role: "alert" });
    check = () => { go.disabled = made.some(([, , input]) => !input.enough()); };
    const form = el("form", {}, el("p", {}, text()), made.map(([, node]) => node), el("div", { class: "buttons" }, go, stop), said);
    form.addEventListener("keydown", (event) => { if (event.key === "Escape" && !stop.disabled) cancel(); });
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      go.disabled = stop.disabled = true;
      sending.add(key);
      delete draft.error;
      show(said);
      go.textContent = "sent, waits for flight …";
      const words = Object.fromEntries(made.map(([name, , input]) => [name, input.value]));
      try {
        const answer = await tell(path, { ...body(), ...words });
        for (const name of Object.keys(draft)) delete draft[name];
        save();
        sending.delete(key);
        say(answer.text, answer.ok !== false);
        closed();
        box.querySelector("button").focus();
        done(answer);
      } catch (error) {
        sending.delete(key);
        draft.error = `${utc(now_s())}: ${error.message}`; // it may be drawn anew
        save();
        show(said, error.message);
        say(error.message, false);
        go.textContent = act;
        stop.disabled = false;
        check();
        done(null);
      }
    });
    show(said, draft.error ?? "");
    show(box, form);
    if (preview) preview().then((nodes) => form.firstChild.after(el("div", { class: "preview" }, nodes)));
    check();
    if (focus) made.find(([, , input]) => !input.value)?.[2].focus();
  }
  if (draft.open && !disabled) opened(false); else closed();
  return box;
}
