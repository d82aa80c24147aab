// The page of a library. Its data are in the global mitsvbrdfLibrary (page.py); what is shown follows from the address's hash:
// q (the expression), sort, down, and at (which material is at the top of the window).

const EVERY = 5000;  // ms between two looks at a library that a batch works at
const TAGS = 8;  // shown at first
const $ = (id) => document.getElementById(id);
const where = JSON.parse($("asked").textContent);
const view = { text: "", sort: "name", down: false };
let library = null, rows = [], shown = [], states = {}, tags = [], orders = new Map(), allTags = false;
history.scrollRestoration = "manual";

// ---- Data --------------------------------------------------------------------------------------------------------------
function take(data) {
  library = data;
  const names = Object.keys(data.columns), keys = new Set(), found = new Map();
  states = Object.fromEntries(where.states.map((state) => [state, 0]));
  rows = data.columns.name.map((_, i) => {
    const row = {};
    for (const name of names) row[name] = data.columns[name][i];
    for (row.key = row.id || row.name; keys.has(row.key);) row.key += "+";
    keys.add(row.key);
    states[row.state]++;
    for (const tag of new Set(row.tags ?? [])) found.set(tag, (found.get(tag) ?? 0) + 1);
    return row;
  });
  tags = [...found].sort((a, b) => b[1] - a[1]);
  orders = new Map();
  const twins = [...Map.groupBy(rows, (row) => row.name).values()].filter((alike) => alike.length > 1);
  for (const alike of twins) apart(alike).forEach((words, i) => alike[i].apart = words);
  $("cards").classList.toggle("twins", twins.length > 0);
}

// All rows in the order asked for; missing values last either way, equal ones by name.
function ordered() {
  const id = view.sort + view.down;
  if (!orders.has(id)) orders.set(id, view.sort === "name" ? byName(view.down) : byValue(view.sort, view.down));
  return orders.get(id);
}
function byName(down) {
  return down ? rows.toReversed() : rows;
}
function byValue(field, down) {
  const value = field === "date" ? (row) => row.date ? Date.parse(row.date) : null : (row) => numberOf(row, field);
  const values = Float64Array.from(rows, (row) => value(row) ?? NaN), there = [], missing = [];
  values.forEach((x, i) => (Number.isNaN(x) ? missing : there).push(i));
  there.sort(down ? (a, b) => values[b] - values[a] || a - b : (a, b) => values[a] - values[b] || a - b);
  return [...there, ...missing].map((i) => rows[i]);
}

// ---- What is shown -----------------------------------------------------------------------------------------------------
// The caller scrolls, and draws the cards.
let drawing = 0;
function refresh() {
  let problem = "";
  try {
    shown = ordered().filter(matcher(where, view.text));
  } catch (error) {
    if (!(error instanceof RangeError)) throw error;
    problem = error.message;
    shown = [];
  }
  $("shown").textContent = problem ? problem[0].toUpperCase() + problem.slice(1) + "." :
    (shown.length < rows.length ? `${count(shown.length)} of ` : "") + several(rows.length, "material");
  $("shown").className = problem ? "bad" : "";
  $("none").hidden = shown.length > 0 || problem !== "";
  $("none").textContent = rows.length ? "No material is like that." : "There are no captures yet.";
  $("tools").hidden = !rows.length;
  $("down").textContent = view.down ? "↓" : "↑";
  $("down").setAttribute("aria-pressed", view.down);
  $("sort").value = view.sort;
  showChips();
  cards.set(shown);
  clearTimeout(drawing);
  if ($("errors").hidden) showErrors($("errors"), rows, shown);
  else drawing = setTimeout(() => showErrors($("errors"), rows, shown), 100);  // not between two letters typed
}

// Something else is asked for: from its beginning, where the window was further down. What stands in the box holds, also where
// its frame is still to come.
function ask(change) {
  if (change.text !== undefined) $("where").value = change.text;
  Object.assign(view, change, { text: $("where").value });
  refresh();
  const start = $("cards").getBoundingClientRect().top + scrollY - $("tools").offsetHeight;
  if (scrollY > start) scrollTo(0, start);
  cards.draw(true);
  keep();
}

function chip(text, n, pressed, press) {
  const button = make("button", { type: "button", "aria-pressed": pressed, "data-name": text }, make("bdi", {}, text));
  if (n !== null) button.append(make("span", {}, count(n)));
  button.addEventListener("click", press);
  return button;
}

function showChips() {
  const focused = document.activeElement, [group, name] = [focused.parentElement, focused.dataset.name];
  const terms = termsOf(view.text), others = terms.filter((term) => !/^state[:=]/i.test(term));
  const without = (term) => terms.filter((each) => each !== term);
  const press = (term) => () => ask({ text: (terms.includes(term) ? without(term) : [...terms, term]).join(" ") });
  $("states").hidden = Object.values(states).filter(Boolean).length < 2;
  $("states").replaceChildren(
    chip("All", rows.length, terms.length === others.length, () => ask({ text: others.join(" ") })),
    ...where.states.filter((state) => states[state]).map((state) => chip(state[0].toUpperCase() + state.slice(1), states[state],
      terms.includes("state:" + state), () => ask({ text: [...others, "state:" + state].join(" ") }))));
  const warned = rows.warned ??= rows.filter((row) => row.warnings?.length).length;
  const wanted = tags.map(([tag, n]) => [tag, n, termFor("tag", tag)]);
  const listed = wanted.filter(([, , term], k) => allTags || k < TAGS || terms.includes(term));
  $("tags").replaceChildren(
    ...warned ? [chip("with warnings", warned, terms.includes("warnings>0"), press("warnings>0"))] : [],
    ...listed.map(([tag, n, term]) => chip(tag, n, terms.includes(term), press(term))),
    ...listed.length < wanted.length ? [chip("more tags", wanted.length - listed.length, false, showAllTags)] : []);
  if (name !== undefined) [...group.children].find((button) => button.dataset.name === name)?.focus({ preventScroll: true });
}

function showAllTags() {
  allTags = true;
  showChips();
}

// ---- The address's hash ------------------------------------------------------------------------------------------------
let keeping = 0;
function keep() {
  clearTimeout(keeping);
  keeping = setTimeout(keepNow, 250);  // browsers refuse more than a few changes a second
}
function keepNow() {
  const place = cards.place(), hash = new URLSearchParams();
  if (view.text) hash.set("q", view.text);
  if (view.sort !== "name") hash.set("sort", view.sort);
  if (view.down) hash.set("down", "1");
  if (place) hash.set("at", `${place.above}.${place.key}`);
  const next = hash.size ? "#" + hash : "";
  if (next !== location.hash) history.replaceState(null, "", next || location.pathname + location.search);
}
function follow() {
  const hash = new URLSearchParams(location.hash.slice(1)), sort = hash.get("sort");
  const known = [...$("sort").options].some((option) => option.value === sort);
  Object.assign(view, { text: hash.get("q") ?? "", sort: known ? sort : "name", down: hash.has("down") });
  $("where").value = view.text;
  refresh();
  const [, above, key] = /^(\d{1,5})\.([^]*)$/.exec(hash.get("at") ?? "") ?? [];
  if (!cards.go(key === undefined ? null : { key, above: Number(above) })) scrollTo(0, 0);
  cards.draw(true);
}

// ---- A batch at work ---------------------------------------------------------------------------------------------------
let version = null;  // headers that ask whether library.js is another one
function showAbout() {
  const made = library.made ? ["As of ", moments(library.made), " · "] : [];
  $("made").replaceChildren(...made, `mitsvbrdf ${library.version ?? ""}`);
  showNumbers($("numbers"), rows, library.progress);
  showStanding();
}
function showStanding() {
  const stands = standing(states, library, Date.now());
  const percent = Math.floor(100 * (states.done + states.failed) / rows.length);
  document.title = (!stands || !isServed() ? "" : stands.command ? "stopped · " : `${percent} % · `) + library.title;
  showProgress($("progress"), states, stands);
}
function isServed() {
  return location.protocol.startsWith("http");
}
function follows() {
  return where.served || isServed() && states.running + states.pending > 0;
}
async function look() {
  const begun = performance.now();
  try {
    const answer = await fetch("library.js", { cache: "no-store", headers: version ?? {} });
    $("lost").hidden = true;
    if (answer.status === 200) {
      const text = await answer.text(), place = cards.place();
      take(JSON.parse(text.slice(text.indexOf("{"), text.lastIndexOf("}") + 1)));
      const [unique, changed] = [answer.headers.get("ETag"), answer.headers.get("Last-Modified")];
      version = unique ? { "If-None-Match": unique } : changed ? { "If-Modified-Since": changed } : null;
      showAbout();
      refresh();
      cards.go(place);
      cards.draw(true);
    } else showStanding();  // no news may be news, too
  } catch (problem) {
    if (!(problem instanceof TypeError || problem instanceof SyntaxError)) throw problem;  // nobody there, or half a file
    $("lost").hidden = false;
  }
  if (follows()) setTimeout(look, Math.max(EVERY, 20 * (performance.now() - begun)));  // at a large library less often
}

// ---- Start -------------------------------------------------------------------------------------------------------------
const cards = new Cards($("cards"), makeCard, stampOf);
if (!globalThis.mitsvbrdfLibrary) {
  $("none").hidden = false;
  $("none").textContent = "The file library.js, which belongs beside this page, is missing or broken.";
} else {
  take(globalThis.mitsvbrdfLibrary);
  showAbout();
  follow();
  let typed = 0;
  $("where").addEventListener("input", () => {
    cancelAnimationFrame(typed);
    typed = requestAnimationFrame(() => ask({}));
  });
  $("tools").addEventListener("submit", (event) => event.preventDefault());
  $("sort").addEventListener("change", () => ask({ sort: $("sort").value }));
  $("down").addEventListener("click", () => ask({ down: !view.down }));
  $("help").addEventListener("click", () => $("askable").showModal());
  for (const dialog of document.querySelectorAll("dialog"))
    dialog.addEventListener("click", (event) => { if (event.target === dialog) dialog.close(); });
  addEventListener("scroll", keep, { passive: true });
  addEventListener("pagehide", keepNow);
  addEventListener("hashchange", follow);
  if (follows()) setTimeout(look, EVERY);
}
