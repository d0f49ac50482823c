"""Pages and pictures of results: one theme, plotly figures, HTML that opens from disk.

Every figure is made by a function that returns a plotly figure; pages hold them as they are, and PNG and
SVG are drawn from the same figures (kincal.pages.image)."""
