// An action that is never one click away: the first opens a form with what it would do and asks who and why,
// the second does it. What is half typed is kept in this browser until it is sent.
import { el, show } from "./dom.js";
import { keep, kept, tell } from "./store.js";
import { say } from "./said.js";

// label: of the first button; act: of the second; text(): what happens; path, body(): of the request; key: of
// the draft; preview(): elements that show what would change; why: what the reason field asks; more: further fields {name, label, value: as it is offered}; disabled: why it cannot be; closing(): it was cancelled.
export function confirmed({ label, act, text, path, body = () => ({}), key, danger = false, fields = ["by", "why"], more = [], disabled = "", done = () => {}, preview = null, closing = () => {} }) {
  const box = el("div", { class: "confirm" });
  const draft = kept(`draft:${key}`, {});
  const labels = { by: "Your name", why: "Reason, for the record" };

  function closed() {
    show(box, el("button", { type: "button", class: danger ? "danger" : "", disabled: Boolean(disabled), title: disabled || null, onclick: () => { draft.open = true; save(); opened(true); } }, label));
  }
  function save() { keep(`draft:${key}`, draft); }
  function field(name, title, value = "") {
    const made = el("input", { type: "text", name, autocomplete: "off", required: true });
    made.value = draft[name] ?? (name === "by" ? kept("by", "") : value);
    made.addEventListener("input", () => { draft[name] = made.value; if (name === "by") keep("by", made.value); save(); check(); });
    return [el("label", {}, title, made), made];
  }
  let check = () => {};
  function opened(focus) {
    const made = [...fields.map((f) => [f, ...field(f, labels[f])]), ...more.map((m) => [m.name, ...field(m.name, m.label, m.value)])];
    const go = el("button", { type: "submit", class: danger ? "danger" : "primary" }, act);
    const stop = el("button", { type: "button", onclick: () => { draft.open = false; save(); closed(); closing(); } }, "cancel");
    const said = el("p", { class: "bad small", role: "alert" });
    check = () => { go.disabled = made.some(([, , input]) => !input.value.trim()); };
    const form = el("form", {}, el("p", {}, text()), made.map(([, node]) => node), el("div", { class: "buttons" }, go, stop), said);
    form.addEventListener("submit", async (event) => {
      event.preventDefault();
      go.disabled = stop.disabled = true;
      go.textContent = "sent, waits for flight …";
      const words = Object.fromEntries(made.map(([name, , input]) => [name, input.value]));
      try {
        const answer = await tell(path, { ...body(), ...words });
        keep(`draft:${key}`, { });
        say(answer.text, answer.ok !== false);
        closed();
        done(answer);
      } catch (error) {
        show(said, error.message);
        say(error.message, false);
        go.textContent = act;
        stop.disabled = false;
        check();
        done(null);
      }
    });
    show(box, form);
    if (preview) preview().then((nodes) => form.firstChild.after(el("div", { class: "preview" }, nodes)));
    check();
    if (focus) made.find(([, , input]) => !input.value)?.[2].focus();
  }
  if (draft.open && !disabled) opened(false); else closed();
  return box;
}
