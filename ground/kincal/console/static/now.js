// What flight does at this moment, what waits for whom, and how old each of these values is.
import { age, el, fixed, mark, mission, show, svg } from "./dom.js";
import { confirmed } from "./confirm.js";
import { eventList } from "./events.js";
import { LIGHT, draw } from "./plots.js";
import { arm as armOf, dots, layout, line, view as viewOf } from "./scene.js";
import { ask, freshness, store } from "./store.js";

const DRAW_MS = 600;  // between two pictures of the arm
const SHARE = 3, MOST_MS = 2500;  // after a picture as many times the time that it took are left for clicks
const FRAME_MS = 700; // between two frames of the camera
const TRAIL = 600, STEP_M = 0.004, GAP_US = 3e6;  // of the path of the tool: points at most, how far apart, where it breaks
const HEARD = [
  ["KC_HK", "housekeeping"], ["KC_ARM_STATE", "arm"], ["KC_PANTILT_STATE", "pan-tilt unit"],
  ["KC_DETECTION", "tag detection"], ["poses", "last pose"],
];
// One axis over whole decades and thirds of them: by itself plotly writes "5" for 0.5, 5 and 50.
const TICKS = [-3, -2, -1, 0, 1, 2, 3].flatMap((d) => [10 ** d, 3 * 10 ** d]);
const DECADES = { tickmode: "array", tickvals: TICKS, ticktext: TICKS.map((v) => String(Number(v.toPrecision(1)))) };
let parts = null, stamp = {}, drawnAt = 0, cost = 0, shownAt = 0, shownFrame = null, trail = [], trailOf = null, heardAt = 0, known = null;

export function open(root) {
  const events = eventList();
  parts = {
    events,
    state: el("section", { class: "card state" }),
    ages: el("section", { class: "card ages" }),
    joints: el("section", { class: "card joints" }),
    health: el("section", { class: "card health" }),
    arm: el("div", { class: "plot", role: "img", "aria-label": "The arm in three dimensions" }),
    chart: el("div", { class: "plot", role: "img", "aria-label": "Residual and predicted error by pose" }),
    frame: el("div", { class: "frame" }),
    poses: el("div", { class: "poses", tabindex: "0", role: "region", "aria-label": "Poses, newest first" }),
    armText: el("span", { class: "muted" }),
  };
  stamp = {};
  show(root,
    el("div", { class: "left", tabindex: "0", role: "region", "aria-label": "State of flight" }, parts.state, parts.ages, parts.joints, parts.health),
    el("div", { class: "middle" },
      el("section", { class: "card scene", title: "Drawn from the encoders with the ARM table of this console" }, el("h2", {}, "Arm ", parts.armText), parts.arm),
      el("div", { class: "two" },
        el("section", { class: "card" }, el("h2", {}, "Poses"), parts.chart, parts.poses),
        el("section", { class: "card" }, el("h2", {}, "Camera"), parts.frame))),
    events.node);
  update("open");
}

export function close() { parts = null; }
export function recolour() { stamp = {}; drawnAt = shownAt = 0; update("open"); }

export function update() {
  if (!parts) return;
  state();
  ages();
  whenNew("KC_ARM_STATE", joints);
  whenNew("KC_HK", health);
  camera();
  whenNew("poses", poses);
  whenNew("way", () => way(store.values.KC_ARM_STATE?.data, store.values.KC_HK?.data), "KC_ARM_STATE");
  scene();
  parts.events.update();
  for (const [channel, node] of [["KC_ARM_STATE", parts.joints], ["KC_HK", parts.health], ["KC_HK", parts.state], ["KC_DETECTION", parts.frame]]) {
    node.classList.toggle("old", channel !== "KC_DETECTION" && freshness(channel).status !== "fresh" && store.about.live);
  }
}

function whenNew(name, what, channel = name) {
  const value = store.values[channel];
  const key = value ? `${value.received_s}/${value.t_us}` : "none";
  if (stamp[name] === key) return;
  stamp[name] = key;
  what(value?.data);
}

// ------------------------------------------------------------------ state

const WHOM = { operator: ["▲", "You: a decision or command is awaited"], flight: ["●", "Flight: nothing to do here"], camera: ["●", "Camera and tag detector"], nobody: ["○", "Nobody"] };

function state() {
  const hk = store.values.KC_HK?.data, about = freshness("KC_HK");
  const left = hk?.approval_left_s ? Math.max(hk.approval_left_s - (store.about.live ? about.age_s : 0), 0) : 0;
  const key = JSON.stringify([hk, Math.round(left), about.status, about.status === "fresh" ? 0 : Math.round(about.age_s)]);
  if (stamp.state === key) return;
  stamp.state = key;
  if (!hk) {
    show(parts.state, el("h1", { class: "unknown" }, "UNKNOWN"), el("p", {}, "No housekeeping was heard yet. Flight sends it once a second: is it running on this network?"));
    return;
  }
  if (hk.several) {
    show(parts.state, el("h1", { class: "unknown" }, "NOT KNOWN", el("small", {}, ` ${hk.state} heard last`)),
      el("p", {}, "Two flights are heard, and each says something else. Nothing but ABORT is sent until the other sender has ended."));
    return;
  }
  const [shape, whom] = WHOM[hk.waits_for] ?? WHOM.flight;
  const calibrating = !["IDLE", "SAFE", "REVIEW", "ARMED"].includes(hk.state);
  show(parts.state,
    el("h1", { class: hk.state === "SAFE" ? "bad" : hk.waits_for === "operator" ? "attention" : "" }, hk.state,
      about.status === "fresh" ? null : el("small", {}, ` as heard ${age(about.age_s)} ago`)),
    el("p", {}, hk.text),
    el("p", { class: `whom ${hk.waits_for}` }, el("b", {}, "Waits for "), `${shape} ${whom}`),
    hk.state === "ARMED" ? el("p", { class: "whom operator" }, `${Math.floor(left / 60)} min ${Math.floor(left % 60)} s left for GO${hk.go_by ? ` with ${hk.go_by}` : ""}`) : null,
    hk.proposal ? el("p", {}, el("a", { href: `#corrections/${hk.proposal}` }, `Correction ${hk.proposal}`), hk.proposal_verdict ? ` ${hk.proposal_verdict}` : " verdict not known") : null,
    calibrating || hk.poses ? el("div", { class: "progress" },
      el("progress", { max: String(Math.max(hk.poses_goal, 1)), value: String(hk.poses), "aria-label": "poses measured" }),
      el("span", { title: "with the local initial poses, which are measured first" }, `${hk.poses} of ${hk.poses_goal} poses${calibrating ? `, candidate ${hk.candidate}, servo step ${hk.servo_steps}` : ""}`)) : null,
    ["IDLE", "SAFE"].includes(hk.state) && store.about.live ? starter() : null);
}

function starter() {
  return confirmed({
    label: "START a calibration …", path: "start", key: "start", disabled: store.about.why_no_key,
    text: () => "The arm will move. Poses, seed and coefficients as CONFIG says; the local initial poses of SPACE come first.", act: "START",
  });
}

// ------------------------------------------------------------------ ages, joints, health

function ages() {
  const rows = HEARD.map(([channel, label]) => {
    const f = freshness(channel), regular = store.periods[channel] !== undefined;
    const status = f.status === "fresh" && !regular ? "ok" : f.status;
    const text = f.age_s === null ? "never received" : store.about.live ? `${age(f.age_s)} ago` : `at ${mission(store.values[channel].t_us ?? store.values[channel].received_s * 1e6)}`;
    return [status, label, f.status === "stale" && regular ? `${text}, ${f.text}` : text, f.text];
  });
  const key = JSON.stringify(rows);
  if (stamp.ages === key) return;
  stamp.ages = key;
  show(parts.ages, el("h2", {}, "Last heard"),
    el("ul", {}, rows.map(([status, label, text, why]) => el("li", { class: status }, mark(status, why), el("span", {}, label), el("span", { class: "n" }, text)))));
}

function joints(data) {
  if (!data) { show(parts.joints, el("h2", {}, "Joints"), el("p", { class: "muted" }, "No arm state was heard.")); return; }
  show(parts.joints,
    el("h2", {}, "Joints ", el("span", { class: "muted" }, data.moving ? "moving" : "at rest"), data.faults ? el("span", { class: "bad" }, " ◆ FAULT") : null),
    el("ul", {}, data.joints.map((j) => el("li", { class: j.limit },
      mark(j.fault ? "beyond" : j.limit, j.fault ? "fault" : { ok: "inside its limits", near: "near a limit", beyond: "beyond a limit" }[j.limit]),
      el("b", {}, j.name), range(j), el("span", { class: "n" }, fixed(j.value, 2, j.unit === "deg" ? "°" : "mm"))))),
    el("p", { class: "muted small" }, data.joints.some((j) => j.fault) ? "A controller reports a fault." : `${fixed(data.temp_c, 1, "°C")}; limits by the ARM table of this console`));
}

function range(j) {
  if (j.min === null || j.value === null) return el("span", {});
  const share = (x) => `${Math.min(Math.max((x - j.min) / (j.max - j.min), 0), 1) * 100}%`;
  return el("span", { class: "range", title: `${j.min} to ${j.max} ${j.unit}, target ${j.target}` },
    j.target === null ? null : el("i", { class: "target", style: { left: share(j.target) } }), el("i", { style: { left: share(j.value) } }));
}

function health(hk) {
  if (!hk) { show(parts.health); return; }
  const rows = [
    ["commands", `${hk.commands_accepted} accepted, ${hk.commands_refused} refused`, "ok"],
    ["poses rejected", `${hk.rejected}`, hk.rejected ? "near" : "ok"],
    ["events lost on board", `${hk.events_dropped}`, hk.events_dropped ? "near" : "ok"],
    ["message errors", `${hk.rx_errors} received, ${hk.tx_errors} sent`, hk.rx_errors + hk.tx_errors ? "near" : "ok"],
    ["monitor", hk.monitor.text, hk.monitor.limit],
    ["energy", fixed(hk.energy_j, 0, "J"), "ok"],
    ["kinematics table", hk.tables.KIN || "none", hk.tables.KIN ? "ok" : "near"],
    ["starts of flight", `${hk.boot_count}`, "ok"],
  ];
  show(parts.health, el("h2", {}, "Health"),
    el("ul", {}, rows.map(([label, text, limit]) => el("li", { class: limit }, mark(limit), el("span", {}, label), el("span", { class: "n" }, text)))),
    hk.tables_differ.length ? el("p", { class: "bad small" }, `◆ Names and pictures may be wrong: ${hk.tables_differ.join("; ")}. Start the console with --tables of the tables that fly.`) : null);
}

// ------------------------------------------------------------------ camera

// Frames come faster than they are shown; tags are drawn with the frame that they were found in, if it was transmitted.
function camera() {
  const image = store.values.KC_IMAGE, tags = store.values.KC_DETECTION;
  const key = JSON.stringify([image?.data.seq, image?.received_s, tags?.data.seq, tags?.received_s]);
  if (stamp.camera === key || Date.now() - shownAt < FRAME_MS) return;
  stamp.camera = key;
  shownAt = Date.now();
  shownFrame = image ? image.data : null;
  frame(tags?.data);
}

function frame(data) {
  if (!data && !shownFrame) { show(parts.frame, el("p", { class: "muted" }, "No detection and no frame was heard.")); return; }
  const [width, height] = data?.image_px ?? shownFrame.size_px;
  const made = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": `${shownFrame ? `frame ${shownFrame.seq} of the camera, ` : ""}${data?.tags.length ?? 0} tags` });
  if (shownFrame) made.append(svg("image", { href: `/api/frame/${shownFrame.key}`, x: 0, y: 0, width, height, preserveAspectRatio: "none" }));
  made.append(svg("rect", { x: 0, y: 0, width, height, class: "image" }));
  for (const tag of data?.tags ?? []) {
    const corners = tag.corners_px;
    made.append(svg("polygon", { points: corners.map((c) => c.join(",")).join(" "), class: "tag-shape" }));
    const text = svg("text", { x: corners[0][0], y: Math.min(...corners.map((c) => c[1])) - height * 0.03, "font-size": height * 0.09 });
    text.textContent = `tag ${tag.id}`;
    made.append(text);
  }
  if (data?.tool_px) made.append(svg("circle", { cx: data.tool_px[0], cy: data.tool_px[1], r: height * 0.02, class: "tool" }));
  const of = !shownFrame ? store.about.live ? "tags only: no frame is transmitted on KC_IMAGE" : "tags only: no frame was recorded up to here" : !data ? `frame ${shownFrame.seq}` : data.seq === shownFrame.seq ? `frame ${shownFrame.seq} and its tags` : `▲ frame ${shownFrame.seq}, tags of frame ${data.seq}`;
  show(parts.frame, made, el("p", { class: "small muted" }, of), data ? el("p", { class: "small" }, mark(data.tags.length ? "ok" : "near"), data.tags.length
    ? ` ${data.tags.length} tag${data.tags.length === 1 ? "" : "s"}, range ${fixed(data.range_m, 2, "m")}, incidence ${fixed(data.incidence_deg, 0, "°")}, residual ${fixed(data.rms_px, 2, "px")}`
    : " no tags in the last frame") : null);
}

// ------------------------------------------------------------------ poses

function poses(rows) {
  if (!rows?.length) { show(parts.poses, el("p", { class: "muted" }, "No pose was measured yet.")); return; }
  const x = rows.map((p) => p.pose);
  const trace = (key, name, colour, symbol) => ({
    x, y: rows.map((p) => p[key]), name, mode: "lines+markers", line: { color: colour, width: 1.5 },
    marker: { color: colour, size: 6, symbol }, hovertemplate: `pose %{x}: %{y:.2f} mm<extra>${name}</extra>`,
  });
  const axis = { gridcolor: LIGHT.grid, linecolor: LIGHT.grey, zeroline: false, automargin: true };
  draw(parts.chart, {
    data: [trace("res_mm", "residual", LIGHT.orange, "circle"), trace("pred_mm", "predicted 1 σ", LIGHT.blue, "square")],
    layout: {
      height: 170, margin: { l: 44, r: 8, t: 6, b: 30 }, paper_bgcolor: LIGHT.paper, plot_bgcolor: LIGHT.paper,
      font: { size: 11, color: LIGHT.ink }, xaxis: { ...axis, title: { text: "pose", standoff: 2 }, range: [0.5, Math.max(rows.at(-1).goal, x.length) + 0.5] },
      yaxis: { ...axis, type: "log", ...DECADES, title: { text: "position [mm]", standoff: 4 } }, legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0, font: { size: 10 } }, showlegend: true,
    },
  });
  show(parts.poses, el("table", {},
    el("thead", {}, el("tr", {}, [["pose"], ["cand.", "candidate of the search space"], ["res. mm", "residual, position"], ["mrad", "residual, rotation"], ["pred. mm", "predicted error, 1 sigma"], ["rank", "of the coefficients asked for"]].map(([t, title]) => el("th", { class: "n", title }, t)))),
    el("tbody", {}, rows.slice().reverse().map((p) => el("tr", {},
      [p.pose, p.candidate, fixed(p.res_mm, 2), fixed(p.res_mrad, 2), fixed(p.pred_mm, 2), `${p.rank}/${p.free}`].map((t) => el("td", { class: "n" }, String(t))))))));
}

// ------------------------------------------------------------------ arm

// Candidates of the SPACE table in force: of this console's own, or of one that lies here; else none, and said.
function spaceInForce(hk) {
  const crc = hk?.tables.SPACE || store.about.scene.space;
  if (crc === store.about.scene.space) return store.about.scene;
  if (known?.space !== crc) {
    known = { space: crc, candidates_m: [], missing: true };
    ask(`candidates/${crc}`).then((got) => { known = got; stamp.scene = null; }).catch(() => { /* said beside the picture */ });
  }
  return known;
}

// Where the tool was in this session, by the encoders.
function way(arm, hk) {
  const tool = arm?.points_m?.at(-1), session = hk?.session;
  if (trailOf !== session || store.t_us < heardAt) { trail = []; trailOf = session; }  // another one, or back in a recording
  const last = trail.at(-1), silent = store.t_us - heardAt;
  heardAt = store.t_us;
  if (!tool || (last && Math.hypot(...tool.map((x, k) => x - last[k])) <= STEP_M)) return;
  if (last && silent > GAP_US) trail.push([null, null, null]);  // what was between is not known
  trail.push(tool);
  if (trail.length > TRAIL) trail.shift();
}

function scene() {
  const arm = store.values.KC_ARM_STATE?.data, view = store.values.KC_PANTILT_STATE?.data, hk = store.values.KC_HK?.data;
  const key = JSON.stringify([arm?.points_m, arm?.corrected_m, view?.view_m, hk?.candidate]);
  if (stamp.scene === key || Date.now() - drawnAt < Math.max(DRAW_MS, Math.min(SHARE * cost, MOST_MS))) return;
  stamp.scene = key;
  drawnAt = Date.now();
  const f = freshness("KC_ARM_STATE");
  show(parts.armText, arm ? (f.status === "fresh" || !store.about.live ? "by its encoders" : `as heard ${age(f.age_s)} ago`) : "not heard yet: candidates only", spaceInForce(hk).missing ? el("span", { class: "attention" }, ` ▲ candidates of SPACE ${hk.tables.SPACE} do not lie here`) : null);
  const still = store.about.scene, space = spaceInForce(hk);
  const data = [{ ...dots(space.candidates_m, "candidates", LIGHT.grey, 1.8), showlegend: false }, line(still.mast_m, "camera mast", LIGHT.grey, 8, { showlegend: false })];
  if (view?.view_m) data.push(viewOf(view.view_m));
  const target = space.candidates_m[hk?.candidate];
  if (target && hk.poses_goal) data.push(dots([target], `candidate ${hk.candidate}`, LIGHT.blue, 6));
  if (arm?.corrected_m) data.push(line(arm.corrected_m, "as the correction has it", LIGHT.green, 6, { mode: "lines+markers", marker: { size: 3, color: LIGHT.green }, opacity: 0.8 }));
  if (trail.length > 1) data.push(line(trail, "path of the tool", LIGHT.blue, 3, { opacity: 0.7 }));
  if (arm?.points_m) data.push(armOf(arm.points_m, "arm", LIGHT.ink));
  const begun = performance.now();
  draw(parts.arm, { data, layout: layout("arm") });
  requestAnimationFrame(() => requestAnimationFrame(() => { cost = performance.now() - begun; }));
}
