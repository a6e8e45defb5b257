// Before MathJax: where formulas are. Notebooks keep their dollar signs, other pages have
// been through arithmatex.
window.MathJax = {
  tex: {
    inlineMath: [["\\(", "\\)"], ["$", "$"]],
    displayMath: [["\\[", "\\]"], ["$$", "$$"]],
    processEscapes: true,
  },
  svg: { scale: 0.92 },
  options: {
    ignoreHtmlClass: "md-header|md-container",
    processHtmlClass: "arithmatex|jp-RenderedMarkdown",
    enableMenu: false, // its accessibility add-ons are not part of this site
  },
};
