// What the workbench leads to: an effect of one's own, the poses to measure next, the model as a table for flight.
import { el, show } from "./dom.js";
import { form } from "./form.js";
import { say } from "./said.js";
import { ask, keep, kept, store, tell } from "./store.js";

// An effect of one's own; added(name): after it was kept.
export async function own(box, added) {
  let got;
  try { got = await ask("bench/own"); } catch (error) { show(box, el("p", { class: "bad" }, error.message)); return; }
  const made = form({ key: "own", sections: got.sections, problems: [], whole: true, label: "Check and keep", send: (values) => tell("bench/own", { values }), done: (said) => added(said.name) });
  show(box, el("h1", {}, "An effect of your own"),
    el("p", { class: "small muted" }, "A coefficient times at most two functions, at a place of the arm: the example is the one of docs/EFFECTS.md, which lists functions, variables and places. It is kept in this workbench; kincal model add --effects takes the file."),
    made.head, made.node);
}

// The poses that separate effects which cannot be told apart.
export function next(names, act, running) {
  const input = el("input", { type: "text", name: "alternatives", "aria-label": "Effects to separate", placeholder: "backlash[1], encoder_gain[1]", autocomplete: "off" });
  input.value = kept("alternatives", "") || names.join(", ");
  input.addEventListener("input", () => keep("alternatives", input.value));
  const node = el("form", { class: "stack" }, el("label", {}, "Effects to separate, two or more", input), el("button", { type: "submit", disabled: running }, "Plan next poses"));
  node.addEventListener("submit", (event) => {
    event.preventDefault();
    // commas inside brackets belong to a name
    act("run", { what: "next", alternatives: input.value.split(/,(?![^[(]*[\])])/).map((x) => x.trim()).filter(Boolean) });
  });
  return el("section", { class: "card" }, el("h2", {}, "Next poses"), node);
}

// The fitted model as a TERMS table.
export function uplink(state) {
  const fitted = state.answers.fit, key = JSON.stringify(state.case.effects), same = fitted && fitted.arm === state.case.arm && fitted.data === state.case.data && JSON.stringify(fitted.effects) === key;
  const said = el("div", { role: "status" });
  const drop = el("input", { type: "text", name: "drop", "aria-label": "Effects to leave out", placeholder: "leave out, if flight cannot carry all", autocomplete: "off" });
  const button = el("button", { type: "button", disabled: !same, title: same ? null : "fit this model first", onclick: make }, "Make the TERMS table");
  async function make() {
    button.disabled = true;
    show(said, el("p", { class: "muted" }, "…"));
    try {
      const got = await tell("bench/uplink", { drop: drop.value.split(/,(?![^[(]*[\])])/).map((x) => x.trim()).filter(Boolean) });
      say(got.text);
      show(said, el("p", {}, `● ${got.text}`), el("p", { class: "small muted" }, got.about), el("p", {}, el("a", { href: "#tables/TERMS/values/made" }, `Look at ${got.crc} and send it`)));
    } catch (error) { show(said, el("p", { class: "bad pre" }, error.message)); }
    button.disabled = !same;
  }
  return el("section", { class: "card" }, el("h2", {}, "For flight"),
    el("p", { class: "small" }, same ? "Flight then estimates these effects with the DH errors." : "Fit the model first: the table is made of the fit."), el("div", { class: "stack" }, drop, button), said);
}

// In a review: one click to what the same measurements say of named effects.
export function question(crc) {
  if (!store.about.bench) return null;
  const said = el("span", { class: "bad small", role: "alert" });
  const button = el("button", { type: "button", title: "Their diagnosis runs in Workbench; it replaces the case there. The decision here stays open." }, "Diagnose these measurements");
  button.addEventListener("click", async () => {
    button.disabled = true;
    try { say((await tell("bench/take", { crc })).text); location.hash = "#workbench/diagnose"; } catch (error) { show(said, error.message); button.disabled = false; }
  });
  return el("p", { class: "question" }, "What do the same poses say of effects that the model lacks? ", button, " ", said);
}
