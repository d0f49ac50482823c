// Figures by plotly, in the colours of the reader's mode, as on the pages.
import { store } from "./store.js";

const dark = window.matchMedia("(prefers-color-scheme: dark)");
const OPTIONS = { displaylogo: false, displayModeBar: false, responsive: true };

function recoloured(value) {
  if (typeof value === "string") return store.about.dark[value] ?? value;
  if (Array.isArray(value)) return value.map(recoloured);
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, recoloured(inner)]));
}

export function draw(node, figure) {
  if (typeof Plotly === "undefined") {  // the script is still being read
    setTimeout(() => node.isConnected && draw(node, figure), 200);
    return;
  }
  const shown = dark.matches ? recoloured(figure) : figure;
  try {  // a browser without WebGL draws no 3-D scene, but all the others
    Plotly.react(node, shown.data, shown.layout, OPTIONS);
  } catch (error) {
    node.textContent = `not drawn: ${error.message}`;
  }
}

export const LIGHT = {
  paper: "#ffffff", ink: "#1d2733", muted: "#67737f", grey: "#8a97a3", grid: "#dfe4e9", blue: "#1f6fb4",
  orange: "#d9730d", green: "#257a40", red: "#c0392b",
};
