// Draws the figures of the page, in the colours of the reader's mode, and in light ones on paper; links the
// plots that show the same poses; copies commands. DARK: light colour -> dark colour, from the theme.
const dark = window.matchMedia("(prefers-color-scheme: dark)");

function recoloured(value) {
  if (typeof value === "string") return DARK[value] ?? value;
  if (Array.isArray(value)) return value.map(recoloured);
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, recoloured(inner)]));
}

// On paper a figure has this width, and the style sheet shrinks it to that of the page.
const PAPER_WIDTH_PX = 960;

function draw(inDark, width) {
  for (const source of document.querySelectorAll("script[data-figure]")) {
    const figure = JSON.parse(source.textContent);
    const shown = inDark ? recoloured(figure) : figure;
    try {  // a browser without WebGL draws no 3-D scene, but all the others
      const layout = width ? { ...shown.layout, width } : shown.layout;
      Plotly.react(source.dataset.figure, shown.data, layout, {
        displaylogo: false, displayModeBar: false, responsive: true,
      });
    } catch (error) {
      document.getElementById(source.dataset.figure).textContent = `not drawn: ${error.message}`;
    }
  }
}

// ------------------------------------------------------------------ linked poses
// A trace with meta.poses holds the id of each pose in customdata. The pose under the pointer and those
// that were clicked are ringed in every plot; the clicked ones become an option to copy.

const poses = JSON.parse(document.getElementById("pose-data")?.textContent ?? "null");
const number = new Map(poses?.ids.map((id, k) => [id, k]));
const excluded = new Set();
let under = null;

function linkedTraces(plot) {
  return (plot._fullData ?? []).filter((trace) => trace.meta?.poses && trace.visible === true);
}

function place(plot, trace, pose) {
  const k = trace.customdata.indexOf(pose);
  if (k < 0) return null;
  const x = plot._fullLayout[trace.xaxis.replace("x", "xaxis")];
  const y = plot._fullLayout[trace.yaxis.replace("y", "yaxis")];
  return [x._offset + x.d2p(trace.x[k]), y._offset + y.d2p(trace.y[k])];
}

function ring(layer, at, kind) {
  const mark = document.createElement("i");
  mark.className = kind;
  mark.style.left = `${at[0]}px`;
  mark.style.top = `${at[1]}px`;
  layer.append(mark);
}

function rings(plot) {
  let layer = plot.querySelector(":scope > .rings");
  if (!layer) {
    layer = document.createElement("div");
    layer.className = "rings";
    plot.append(layer);
  }
  layer.replaceChildren();
  const marked = [...excluded].map((pose) => [pose, "out"]);
  if (under !== null) marked.push([under, "under"]);
  if (!marked.length) return;
  for (const trace of linkedTraces(plot)) {
    for (const [pose, kind] of marked) {
      const at = place(plot, trace, pose);
      if (at) ring(layer, at, kind);
    }
  }
}

function said(pose) {
  const k = number.get(pose);
  const parts = [`pose ${pose}`, `${poses.now[k]} mm now`];
  if (poses.after.length) parts.push(`${poses.after[k]} mm with the findings`);
  if (poses.about[k]) parts.push(poses.about[k]);
  return parts.join(" · ");
}

function showPicked() {
  document.querySelectorAll(".figure").forEach(rings);
  const bar = document.getElementById("picked");
  bar.hidden = under === null && !excluded.size;
  document.getElementById("pose-under").textContent =
    under === null ? "Click a pose to exclude it." : said(under);
  const list = document.getElementById("pose-list");
  list.hidden = !excluded.size;
  list.querySelector("span").textContent = `${excluded.size} picked:`;
  list.querySelector("code").textContent = `--exclude ${[...excluded].join(",")}`;
}

function poseOf(event) {
  const point = event.points?.[0];
  return point?.data.meta?.poses ? point.customdata : null;
}

function link(plot) {
  plot.on("plotly_hover", (event) => { under = poseOf(event); showPicked(); });
  plot.on("plotly_unhover", () => { under = null; showPicked(); });
  plot.on("plotly_click", (event) => {
    const pose = poseOf(event);
    if (pose === null) return;
    if (!excluded.delete(pose)) excluded.add(pose);
    showPicked();
  });
  plot.on("plotly_afterplot", () => rings(plot));
}

function copy(text) {
  if (navigator.clipboard && window.isSecureContext) return navigator.clipboard.writeText(text);
  const field = document.createElement("textarea");  // pages from disk may have no clipboard
  field.value = text;
  document.body.append(field);
  field.select();
  document.execCommand("copy");
  field.remove();
}

document.addEventListener("click", (event) => {
  const button = event.target.closest("button[data-copy]");
  if (!button) return;
  copy(button.parentElement.querySelector("code").textContent);
  button.textContent = "copied";
  setTimeout(() => { button.textContent = "copy"; }, 1200);
});

// A link to a word opens the list that it is in.
function unfold() {
  const word = location.hash.startsWith("#word-") && document.getElementById(location.hash.slice(1));
  if (!word) return;
  word.closest("details").open = true;
  word.scrollIntoView();
}
window.addEventListener("hashchange", unfold);
unfold();

draw(dark.matches);
if (poses) {
  document.querySelectorAll(".figure").forEach(link);
  document.getElementById("pose-clear").addEventListener("click", () => { excluded.clear(); showPicked(); });
}
dark.addEventListener("change", () => draw(dark.matches));
window.addEventListener("beforeprint", () => draw(false, PAPER_WIDTH_PX));
window.addEventListener("afterprint", () => draw(dark.matches));
