// Draws the figures of the page, in the colours of the reader's mode, and in light ones on paper.
// DARK: light colour -> dark colour, from the theme.
const dark = window.matchMedia("(prefers-color-scheme: dark)");

function recoloured(value) {
  if (typeof value === "string") return DARK[value] ?? value;
  if (Array.isArray(value)) return value.map(recoloured);
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).map(([key, inner]) => [key, recoloured(inner)]));
}

function draw(inDark) {
  for (const source of document.querySelectorAll("script[data-figure]")) {
    const figure = JSON.parse(source.textContent);
    const shown = inDark ? recoloured(figure) : figure;
    Plotly.react(source.dataset.figure, shown.data, shown.layout, {
      displaylogo: false, displayModeBar: false, responsive: true,
    });
  }
}

draw(dark.matches);
dark.addEventListener("change", () => draw(dark.matches));
window.addEventListener("beforeprint", () => draw(false));
window.addEventListener("afterprint", () => draw(dark.matches));
