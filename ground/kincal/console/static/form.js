// Values in a form: each with what it is, and with what is wrong with it. What is typed is kept in this browser until
// it was taken.
import { el, show } from "./dom.js";
import { say } from "./said.js";
import { keep, kept } from "./store.js";

// key: of the draft; sections: [{title, about, fields: [{path, key, unit, about, text, long, choices}]}]; problems:
// [{field, text}]; send(values): answers {ok, text, problems}; done(): after they were taken; whole: all values are sent,
// not only those that were changed.
export function form({ key, sections, problems, send, done, whole = false, label = "Check and keep" }) {
  const draft = kept(`draft:form:${key}`, {}), inputs = new Map(), errors = new Map();
  const general = el("div", { class: "bad", role: "alert" }), count = el("span", { class: "muted" });
  const button = el("button", { type: "submit", class: "primary" }, label);
  const typed = () => Object.fromEntries([...inputs].filter(([path, [input, was]]) => whole || input.value !== was || draft[path] !== undefined).map(([path, [input]]) => [path, input.value]));

  function changed(path) {
    const [input, was] = inputs.get(path);
    if (input.value === was) delete draft[path]; else draft[path] = input.value;
    keep(`draft:form:${key}`, draft);
    counted();
  }
  function counted() {
    const n = Object.keys(draft).length;
    show(count, n ? `▲ ${n} changed, not kept yet` : whole ? "" : "as kept");
    button.disabled = !n && !whole;
  }
  function wrong(list) {
    for (const [path, node] of errors) {
      const mine = list.filter((p) => p.field === path);
      show(node, ...mine.map((p) => el("span", {}, `◆ ${p.text}`)));
      inputs.get(path)[0].setAttribute("aria-invalid", String(mine.length > 0));
    }
    show(general, ...list.filter((p) => !errors.has(p.field)).map((p) => el("p", {}, `◆ ${p.path ? `${p.path}: ` : ""}${p.text}`)));
  }
  function field(f) {
    const id = `field-${key}-${f.path}`;
    let input;
    if (f.choices) { input = el("select", { id }, f.choices.map((c) => el("option", { value: c }, c))); input.value = draft[f.path] ?? f.text; } else {
      input = el(f.long ? "textarea" : "input", { id, name: f.path, autocomplete: "off", spellcheck: "false", ...(f.long ? { rows: String(Math.min(f.text.split("\n").length + 1, 8)) } : { type: "text" }) });
      input.value = draft[f.path] ?? f.text;
    }
    const error = el("p", { class: "bad small", id: `${id}-error` });
    input.setAttribute("aria-describedby", `${id}-about ${id}-error`);
    input.addEventListener("input", () => changed(f.path));
    inputs.set(f.path, [input, f.text]);
    errors.set(f.path, error);
    return el("div", { class: `field${f.long ? " long" : ""}` }, el("label", { for: id }, f.key, f.unit ? el("span", { class: "muted" }, ` [${f.unit}]`) : null), input, el("p", { class: "small muted", id: `${id}-about` }, f.about), error);
  }

  const id = `form-${key}`;
  const node = el("form", { id, class: "values" }, sections.map((s) => el("fieldset", {}, el("legend", {}, s.title), s.about ? el("p", { class: "small muted" }, s.about) : null, el("div", { class: "fields" }, s.fields.map(field)))));
  button.setAttribute("form", id);
  node.addEventListener("submit", async (event) => {
    event.preventDefault();
    button.disabled = true;
    try {
      const said = await send(typed());
      wrong(said.problems ?? []);
      say(said.text, said.ok !== false);
      if (said.ok !== false) { keep(`draft:form:${key}`, {}); done(said); return; }
      const first = node.querySelector("[aria-invalid=true]");
      first?.focus();
      first?.closest(".field").scrollIntoView({ block: "center" });
    } catch (error) { say(error.message, false); }
    button.disabled = false;
  });
  const undo = el("button", { type: "button", onclick: () => { for (const [path, [input, was]] of inputs) { input.value = was; delete draft[path]; } keep(`draft:form:${key}`, {}); wrong(problems); counted(); } }, "undo changes");
  wrong(problems);
  counted();
  return { head: el("div", { class: "form-head" }, button, undo, count, general), node };
}
