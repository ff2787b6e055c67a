// Formulas are drawn by KaTeX, which lies beside this file; nothing is fetched from elsewhere.
const drawFormulas = () => {
  if (window.renderMathInElement) {
    for (const formula of document.querySelectorAll(".arithmatex")) {
      window.renderMathInElement(formula);
    }
  }
};
document.addEventListener("DOMContentLoaded", drawFormulas);
