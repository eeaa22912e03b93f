"use strict";
const body = document.querySelector("tbody");
const rows = [...body.rows];
const find = document.getElementById("find");
const kind = document.getElementById("kind");
const texts = new Map(rows.map((row) => [row, row.textContent.toLowerCase()]));

function isShown(row) {
  const flags = row.dataset.flags;
  const wanted = kind.value;
  const fits =
    wanted === "" ||
    (wanted === "=flagged" ? flags !== "" :
      wanted.startsWith("=") ? row.dataset.state === wanted.slice(1) :
        flags.split("|").includes(wanted));
  return fits && texts.get(row).includes(find.value.trim().toLowerCase());
}

function filter() {
  let shown = 0;
  for (const row of rows) {
    row.hidden = !isShown(row);
    shown += row.hidden ? 0 : 1;
  }
  document.getElementById("count").textContent = `${shown} of ${rows.length}`;
}

const collator = new Intl.Collator("en", { numeric: true });

// Unknown values come last in both directions.
function compare(a, b, place, sign) {
  const [x, y] = [a.cells[place], b.cells[place]];
  const [p, q] = [x.dataset.order, y.dataset.order];
  const known = (cell, order) => order !== undefined || cell.textContent !== "–" && cell.textContent !== "";
  if (known(x, p) !== known(y, q)) return known(x, p) ? -1 : 1;
  if (p !== undefined && q !== undefined) return sign * (Number(p) - Number(q));
  return sign * collator.compare(x.textContent, y.textContent);
}

function sort(head) {
  const place = head.cellIndex;
  const isNext = head.getAttribute("aria-sort") === "ascending";
  for (const other of head.parentElement.cells) other.setAttribute("aria-sort", "none");
  head.setAttribute("aria-sort", isNext ? "descending" : "ascending");
  rows.sort((a, b) => compare(a, b, place, isNext ? -1 : 1));
  body.append(...rows);
}

for (const button of document.querySelectorAll("thead button")) {
  button.addEventListener("click", () => sort(button.closest("th")));
}
find.addEventListener("input", filter);
kind.addEventListener("change", filter);
