"use strict";
(() => {
  const keys = JSON.parse(document.getElementById("data").textContent).keys;
  const body = document.querySelector("#recordings tbody");
  const headings = [...document.querySelectorAll("#recordings th[data-column]")];
  const compared = (a, b) => typeof a === "string" ? a.localeCompare(b, undefined, { numeric: true }) : a - b;

  function sort(heading) {
    const down = heading.getAttribute("aria-sort") === "ascending";
    const column = keys[heading.dataset.column];
    const order = (a, b) => {
      const x = column[a.dataset.row], y = column[b.dataset.row];
      if (x === null || y === null) return (x === null) - (y === null) || a.dataset.row - b.dataset.row;
      return (down ? -compared(x, y) : compared(x, y)) || a.dataset.row - b.dataset.row;
    };
    headings.forEach(h => h.removeAttribute("aria-sort"));
    heading.setAttribute("aria-sort", down ? "descending" : "ascending");
    body.append(...[...body.rows].sort(order));
  }

  headings.forEach(h => h.querySelector("button").addEventListener("click", () => sort(h)));
})();
