// Pictures in three dimensions: lines and points in the base frame, and the frame around them.
import { LIGHT } from "./plots.js";

const of = (points, k) => points.map((p) => p[k]);
export const line = (points, name, colour, width, more = {}) => ({
  type: "scatter3d", mode: "lines", name, x: of(points, 0), y: of(points, 1), z: of(points, 2), line: { color: colour, width }, hoverinfo: "name", ...more,
});
export const dots = (points, name, colour, size, more = {}) => ({ ...line(points, name, colour, 1), mode: "markers", marker: { color: colour, size, opacity: 0.6 }, ...more });
export const arm = (points, name, colour, more = {}) => line(points, name, colour, 8, { mode: "lines+markers", marker: { size: 4, color: colour }, ...more });

// The camera's view: its place, then the corners of its image.
export function view([eye, ...c]) {
  return line([eye, c[0], c[1], eye, c[2], c[3], eye, c[0], c[3], c[2], c[1]], "camera view", LIGHT.orange, 2, { showlegend: false });
}

const axis = (text) => ({ title: { text, font: { size: 11 } }, gridcolor: LIGHT.grid, backgroundcolor: LIGHT.paper, color: LIGHT.muted, tickfont: { size: 10 } });

// key: as long as it is the same, the reader's point of view stays.
export const layout = (key) => ({
  uirevision: key, margin: { l: 0, r: 0, t: 0, b: 0 }, paper_bgcolor: LIGHT.paper, font: { size: 11, color: LIGHT.ink }, autosize: true,
  scene: { uirevision: key, aspectmode: "data", xaxis: axis("x forward [m]"), yaxis: axis("y left [m]"), zaxis: axis("z up [m]"), camera: { eye: { x: 1.2, y: -1.6, z: 0.75 }, center: { x: 0, y: 0, z: -0.08 } } },
  legend: { x: 0, y: 1, yanchor: "top", orientation: "h", bgcolor: "rgba(0,0,0,0)", font: { size: 10 } },
});
