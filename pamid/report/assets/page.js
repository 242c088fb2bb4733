"use strict";
// What the page itself offers: its colours by choice, and tables that can be taken along.
(() => {
  const root = document.documentElement, MODES = ["", "light", "dark"];
  const make = (name, settings) => Object.assign(document.createElement(name), settings);
  root.classList.add("js");

  // ---- colours: the system's, or the reader's choice, kept where the browser allows it --------------------------------
  const store = (act) => { try { return act(localStorage); } catch { return null; } };
  const toggle = make("button", {type: "button", className: "colours"});
  function paint(mode) {
    if (mode) root.dataset.colours = mode;
    else delete root.dataset.colours;
    toggle.textContent = {"": "◐ system", light: "☀ light", dark: "☾ dark"}[mode];
    toggle.setAttribute("aria-label", `colours: ${mode || "as the system"}; change`);
    document.dispatchEvent(new Event("pamid-colours"));
  }
  toggle.addEventListener("click", () => {
    const next = MODES[(MODES.indexOf(root.dataset.colours ?? "") + 1) % MODES.length];
    store((kept) => kept.setItem("pamid-colours", next));
    paint(next);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => paint(root.dataset.colours ?? ""));
  document.querySelector("header")?.prepend(toggle);
  const kept = store((one) => one.getItem("pamid-colours"));
  paint(MODES.includes(kept) ? kept : "");

  // ---- the rig's diagram: a block that is chosen or has the focus shows what is known of it ------------------------
  const panels = [...document.querySelectorAll(".port-panel")], blocks = [...document.querySelectorAll("a.block")];
  function choose(id) {
    for (const panel of panels) panel.classList.toggle("shown", panel.id === id);
    for (const block of blocks) block.classList.toggle("chosen", block.getAttribute("href") === "#" + id);
  }
  for (const block of blocks) {
    const id = block.getAttribute("href").slice(1);
    block.addEventListener("focus", () => choose(id));
    block.addEventListener("click", (event) => { event.preventDefault(); choose(id); });
  }
  const first = panels.find((panel) => panel.classList.contains("shown"));
  if (first) choose(first.id);
  document.querySelectorAll(".port-panels").forEach((one) => one.setAttribute("aria-live", "polite"));

  // ---- the ranking: a row that is chosen shows its added-variable plot ---------------------------------------------
  const plots = [...document.querySelectorAll(".added-panel")];
  function plot(id) {
    for (const one of plots) one.classList.toggle("shown", one.id === id);
    document.getElementById(id).scrollIntoView({block: "nearest"});
  }
  for (const row of document.querySelectorAll("[data-figure]")) row.addEventListener("click", () => plot(row.dataset.figure));
  for (const {id} of plots)
    for (const link of document.querySelectorAll(`a[href="#${id}"]`))
      link.addEventListener("click", (event) => { event.preventDefault(); plot(id); document.getElementById(id).focus(); });

  // ---- contents: where the reader is ---------------------------------------------------------------------------------
  const listed = new Map([...document.querySelectorAll(".contents a")].map((link) =>
    [document.getElementById(decodeURIComponent(link.hash.slice(1))), link]));
  listed.delete(null);
  function mark() {
    let here = null;
    for (const heading of listed.keys()) if (heading.getBoundingClientRect().top < 0.3 * innerHeight) here = heading;
    for (const [heading, link] of listed) link.classList.toggle("here", heading === here);
  }
  let asked = 0;
  if (listed.size) addEventListener("scroll", () => { asked ||= requestAnimationFrame(() => { asked = 0; mark(); }); },
    {passive: true});

  // ---- print: what is folded is opened -----------------------------------------------------------------------------
  let opened = [];
  addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    for (const one of opened) one.open = true;
  });
  addEventListener("afterprint", () => { for (const one of opened) one.open = false; });

  // ---- tables as text --------------------------------------------------------------------------------------------
  const SUPERSCRIPTS = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  const power = (text) => [...text].map((one) => one === "⁻" ? "-" : SUPERSCRIPTS.indexOf(one)).join("");
  /** A cell as a spreadsheet reads it: plain spaces and signs, powers of ten as an exponent. */
  const plain = (text) => text.replace(/[\s\u00a0]+/g, " ").trim().replaceAll("−", "-").replace(/^–$/, "")
    .replace(/ × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)/g, (_, digits) => `e${power(digits)}`);
  const grid = (table) => [...table.rows].map((row) => [...row.cells].map((cell) =>
    plain([...cell.childNodes].map((node) => node.textContent).join(" "))));
  const FORMS = {
    TSV: (rows) => rows.map((row) => row.join("\t")).join("\n"),
    Markdown: ([head, ...rows]) => {
      const line = (cells) => `| ${cells.map((cell) => cell.replaceAll("|", "\\|")).join(" | ")} |`;
      return [line(head), line(head.map(() => "---")), ...rows.map(line)].join("\n");
    },
  };
  async function copy(table, form, button) {
    const text = FORMS[form](grid(table)) + "\n";
    let told = "copied";
    try { await navigator.clipboard.writeText(text); } catch {
      getSelection().selectAllChildren(table);
      told = "selected: press Ctrl+C";
    }
    button.textContent = told;
    setTimeout(() => { button.textContent = form; }, 1500);
  }
  for (const table of document.querySelectorAll(".scroll > table")) {
    const bar = make("div", {className: "copy"});
    bar.append(make("span", {className: "more", textContent: "more to the right →"}), "copy as ");
    // a cue beside the shadow at the edge: touch screens show no scroll bar
    new ResizeObserver(() => bar.classList.toggle("sideways", table.parentElement.scrollWidth > table.parentElement.clientWidth + 1))
      .observe(table.parentElement);
    for (const form of Object.keys(FORMS)) {
      const button = make("button", {type: "button", textContent: form});
      button.addEventListener("click", () => copy(table, form, button));
      bar.append(button, " ");
    }
    table.parentElement.before(bar);
  }
  window.pamidTable = (table, form) => FORMS[form](grid(table));
})();
