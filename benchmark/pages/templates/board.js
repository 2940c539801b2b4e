// Tabs, sorting and filters of the board. Without this script every table is shown, in the order of the file.
(() => {
  "use strict";
  document.documentElement.classList.add("js");
  const form = document.querySelector("form.filters");
  if (!form) return;
  const tabs = [...document.querySelectorAll("[role=tab]")];
  const sections = tabs.map((tab) => document.getElementById(tab.getAttribute("aria-controls")));
  const status = form.querySelector("output");

  function show(chosen) {
    tabs.forEach((tab, i) => {
      tab.setAttribute("aria-selected", String(i === chosen));
      tab.tabIndex = i === chosen ? 0 : -1;
      sections[i].hidden = i !== chosen;
    });
    filter();
  }

  function matches(row, wanted) {
    if (row.dataset.control === "yes" && !form.elements.controls.checked) return false;
    return wanted.every(([name, value]) => row.dataset[name] === value);
  }

  function filter() {
    const wanted = ["geometry", "learned", "runtime"].map((name) => [name, form.elements[name].value]).filter(([, value]) => value);
    for (const section of sections) {
      const rows = [...section.querySelectorAll("table.board tbody tr")];
      for (const row of rows) row.hidden = !matches(row, wanted);
      for (const group of section.querySelectorAll(".group")) group.hidden = !group.querySelector("tbody tr:not([hidden])");
      const left = rows.filter((row) => !row.hidden).length;
      if (rows.length) section.querySelector(".empty").hidden = left > 0;
      if (!section.hidden) status.textContent = rows.length ? `${left} of ${rows.length} shown` : "";
    }
  }

  function valueOf(row, column) {
    const cell = row.cells[column];
    if (column === 0) return cell.querySelector("a").textContent.toLowerCase();
    return cell.dataset.value === undefined ? null : Number(cell.dataset.value);
  }

  function sort(head, button) {
    const now = head.getAttribute("aria-sort");
    const other = { ascending: "descending", descending: "ascending" };
    const order = now === "none" ? button.dataset.first : other[now];
    for (const each of head.parentElement.cells) each.setAttribute("aria-sort", each === head ? order : "none");
    const body = head.closest("table").tBodies[0];
    const sign = order === "ascending" ? 1 : -1;
    const rows = [...body.rows].map((row) => [valueOf(row, head.cellIndex), row]);
    rows.sort(([a], [b]) => {
      if (a === null || b === null) return (a === null) - (b === null); // missing values come last in both orders
      return a < b ? -sign : a > b ? sign : 0;
    });
    body.append(...rows.map(([, row]) => row));
  }

  document.querySelectorAll("table.board thead th").forEach((head) => {
    const button = head.querySelector("button");
    button.addEventListener("click", () => sort(head, button));
  });
  tabs.forEach((tab, i) => {
    tab.addEventListener("click", () => {
      show(i);
      history.replaceState(null, "", `#${sections[i].id}`);
    });
    tab.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      const next = event.key === "Home" ? 0 : event.key === "End" ? tabs.length - 1 : step && (i + step + tabs.length) % tabs.length;
      if (next === undefined) return;
      event.preventDefault();
      tabs[next].focus();
      tabs[next].click();
    });
  });
  sections.forEach((section) => section.setAttribute("role", "tabpanel"));
  form.addEventListener("change", filter);
  form.addEventListener("submit", (event) => event.preventDefault());
  form.reset();
  form.hidden = false;
  document.querySelector(".tabs").hidden = false;
  const named = () => sections.findIndex((section) => `#${section.id}` === location.hash);
  addEventListener("hashchange", () => named() >= 0 && show(named()));
  show(Math.max(named(), 0));
})();
