"use strict";
// Sorts the table by a column when its heading is pressed; what has no value stays at the end. Rows are laid out as
// they are asked for, since thousands take a browser seconds.
(() => {
  const table = document.getElementById("photographs");
  const body = table.tBodies[0];
  const more = document.getElementById("more");
  const step = Number(more.dataset.step);
  let shown = step;
  const heads = [...table.tHead.rows[0].cells];

  const value = (row, column) => {
    const cell = row.cells[column];
    return cell === undefined ? "" : cell.dataset.value ?? cell.textContent;
  };

  const lay = () => {
    const left = body.rows.length - shown;
    [...body.rows].forEach((row, index) => { row.hidden = index >= shown; });
    more.hidden = left <= 0;
    more.textContent = `Show ${Math.min(step, left)} more of ${left}`;
  };

  const sort = (column) => {
    const head = heads[column];
    const down = head.getAttribute("aria-sort") === "ascending";
    const numbers = head.classList.contains("number");
    const compare = (a, b) => (numbers ? Number(a) - Number(b) : a.localeCompare(b, undefined, { numeric: true }));
    const rows = [...body.rows].map((row) => [value(row, column), row]);
    rows.sort(([a], [b]) => (a === "" || b === "" ? (a === "") - (b === "") : down ? compare(b, a) : compare(a, b)));
    const sorted = document.createDocumentFragment();
    rows.forEach(([, row], index) => { row.hidden = index >= shown; sorted.append(row); });
    body.append(sorted);
    lay();
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
  };

  heads.forEach((head, column) => head.querySelector("button")?.addEventListener("click", () => sort(column)));
  more.addEventListener("click", () => { shown += step; lay(); });
  lay();
  document.documentElement.dataset.ready = "yes";
})();
