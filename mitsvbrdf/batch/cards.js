// The page of a library. There may be thousands of materials: only the cards near the window are in the page. The hash of the
// address states what is shown: q (the search text), state, sort, down.

const EVERY = 5000;  // ms between two loads of the data while a batch runs
const GAP = 12, LEAST = 160, BELOW = 84;  // pixels: between cards, the least side of a picture, text below it
const $ = (id) => document.getElementById(id);
const view = { q: "", state: "", sort: "name", down: "" };
const LINKS = ["preview", "report", "log"];
let rows = [], shown = [], cards = new Map(), columns = 1, side = LEAST, frame = 0;
history.scrollRestoration = "manual";

function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) if (value != null) element.setAttribute(key, value);
  element.append(...children);  // strings become text, never tags
  return element;
}
const number = (x, digits = 4) => x == null ? null : x.toPrecision(digits).replace(/\.?0+($|e)/, "$1");
const count = (n) => n.toLocaleString("en");
const clock = (date) => date && new Date(date).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
const seconds = (s) => s == null ? null : s < 90 ? `${s.toPrecision(2)} s` : `${Math.round(s / 60)} min`;
const TOLD = { error: (x) => `error ${number(x, 2)}`, held_out_error: (x) => `held out ${number(x, 2)}`, burn_in: (x) => `burn-in ${number(x, 2)}`, seconds, date: clock,
  attempts: (n) => `${n} attempt${n === 1 ? "" : "s"}` };

// ---- Data --------------------------------------------------------------------------------------------------------------
function take(data) {
  const counts = {};
  rows = data.materials;
  for (const row of rows) {
    row.key = row.folder + row.state;
    for (const link of LINKS) row[link] &&= row[link].split("/").map(encodeURIComponent).join("/");
    counts[row.state] = (counts[row.state] ?? 0) + 1;
  }
  for (const card of cards.values()) card.remove();
  cards = new Map();
  for (const option of $("state").options) {
    const n = option.value ? counts[option.value] ?? 0 : rows.length;
    option.textContent = `${option.textContent.replace(/ \(.*/, "")} (${count(n)})`;
  }
  $("made").textContent = `As of ${clock(data.made)} · mitsvbrdf ${data.version}`;
  const [bar, words] = $("progress").children, left = counts.running || counts.pending;
  $("progress").hidden = !data.progress && !left;
  bar.replaceChildren(...Object.entries(counts).map(([state, n]) => {
    const part = make("i", { class: state });
    part.style.width = `${100 * n / rows.length}%`;
    return part;
  }));
  bar.setAttribute("aria-label", Object.entries(counts).map(([state, n]) => `${count(n)} ${state}`).join(", "));
  words.textContent = data.progress || "Stopped with captures left; the same command goes on.";
  document.title = (data.progress ? `${data.progress.split(",")[0]} · ` : "") + data.title;
  if (data.progress) setTimeout(look, EVERY);
}

// A page that is opened from disk may not read a file, but it may load a script again.
function look() {
  const script = make("script", { src: `${DATA}?${Date.now()}` });
  script.nonce = document.querySelector("script[nonce]").nonce;
  script.onload = () => { take(mitsvbrdfLibrary); refresh(); script.remove(); };
  script.onerror = () => { setTimeout(look, EVERY); script.remove(); };
  document.head.append(script);
}

// The text of a row that is searched, made at the first search.
function wordsOf(row) {
  return row.found ??= SEARCHED.map((name) => [row[name]].flat().join(" ")).join("\n").toLowerCase();
}

// ---- What is shown -----------------------------------------------------------------------------------------------------
function refresh() {
  const text = view.q.trim().toLowerCase(), sign = view.down ? -1 : 1;
  shown = rows.filter((row) => (!view.state || row.state === view.state) && (!text || wordsOf(row).includes(text)));
  if (view.sort !== "name") {  // rows come by name; missing values are last either way
    shown.sort((a, b) => {
      const [x, y] = [a[view.sort], b[view.sort]];
      return x == null || y == null ? (x == null) - (y == null) : x < y ? -sign : x > y ? sign : 0;
    });
  } else if (view.down) shown.reverse();
  $("shown").textContent = (shown.length < rows.length ? `${count(shown.length)} of ` : "") + `${count(rows.length)} materials`;
  $("none").hidden = shown.length > 0;
  $("none").textContent = rows.length ? "No material matches." : "There are no captures yet.";
  $("down").textContent = view.down ? "↓" : "↑";
  $("down").setAttribute("aria-pressed", !!view.down);
  measure();
}

function measure() {
  const list = $("cards"), width = list.clientWidth;
  columns = Math.max(2, Math.floor((width + GAP) / (LEAST + GAP)));
  side = Math.floor((width - GAP * (columns - 1)) / columns);
  list.style.setProperty("--side", `${side}px`);
  list.style.height = `${Math.ceil(shown.length / columns) * (side + BELOW)}px`;
  draw();
}

// Put the cards of the window, and of half a window above and below, into the page.
function draw() {
  frame = 0;
  const list = $("cards"), top = list.getBoundingClientRect().top, step = side + BELOW;
  const line = (y) => Math.max(0, Math.floor((y - top) / step));
  const first = line(-0.5 * innerHeight) * columns, last = Math.min(shown.length, (line(1.5 * innerHeight) + 1) * columns);
  const near = new Map();
  for (let i = first; i < last; i++) near.set(shown[i].key, i);
  for (const [key, card] of cards) {
    if (near.has(key) || card.contains(document.activeElement)) continue;
    card.querySelector("img")?.removeAttribute("src");  // ends a request that is under way
    card.remove();
    cards.delete(key);
  }
  for (const [key, i] of near) {
    if (!cards.has(key)) cards.set(key, makeCard(shown[i]));
    const card = cards.get(key);
    card.style.transform = `translate(${(i % columns) * (side + GAP)}px, ${Math.floor(i / columns) * step}px)`;
    card.setAttribute("aria-posinset", i + 1);
    card.setAttribute("aria-setsize", shown.length);
    list.append(card);  // in their order, for the Tab key
  }
}

// ---- One material ------------------------------------------------------------------------------------------------------
function makeCard(row) {
  const main = row.report ? make("a", { class: "card", href: row.report }) : make("button", { class: "card", type: "button" });
  if (!row.report) main.addEventListener("click", () => showDetails(row));
  const picture = make("span", { class: "picture" });
  if (row.preview) picture.append(make("img", { alt: "", decoding: "async", src: row.preview }));
  else picture.append(make("span", { dir: "auto" }, row.state === "failed" ? `Failed: ${row.reason}` : row.state));
  main.append(picture, make("span", { class: "name", dir: "auto", title: `${row.name}\n${row.options ?? ""}` }, row.name));
  const field = TOLD[view.sort] && row[view.sort] != null ? view.sort : "error";
  const told = row[field] == null ? "" : TOLD[field](row[field]);
  const more = make("button", { class: "more", type: "button", "aria-label": `Details of ${row.name}` }, "⋯");
  more.addEventListener("click", () => showDetails(row));
  const warned = row.warnings?.length ? `⚠ ${row.warnings.length}` : "";
  return make("li", { class: row.state }, main, make("div", { class: "under" }, make("span", {}, told),
    make("span", { class: "warned" }, warned), more));
}

function showDetails(row) {
  const dialog = $("details"), [form, image, links, list] = dialog.children;
  form.firstElementChild.textContent = row.name;
  image.hidden = !row.preview;
  if (row.preview) image.src = row.preview;
  links.replaceChildren(...[["Report", row.report], ["Picture", row.preview], ["Log", row.log]]
    .filter(([, to]) => to).map(([name, to]) => make("a", { href: to }, name)));
  const facts = { State: row.state, Reason: row.reason, Warnings: row.warnings?.join("\n"), Error: number(row.error),
    "Held-out error": number(row.held_out_error), "Burn-in": number(row.burn_in), Time: seconds(row.seconds),
    Attempts: row.attempts, Date: clock(row.date), Method: row.method,
    Resolution: row.resolution && `${row.resolution} px`, Photos: row.photos, Tags: row.tags?.join(", "),
    Source: row.source, Options: row.options, Host: row.host, Folder: row.folder };
  list.replaceChildren(...Object.entries(facts).filter(([, value]) => value != null && value !== "")
    .flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, String(value))]));
  dialog.showModal();
  dialog.scrollTop = 0;
}

// ---- Start -------------------------------------------------------------------------------------------------------------
function ask(change) {
  Object.assign(view, change);
  const hash = new URLSearchParams(Object.entries(view).filter(([name, value]) => value && !(name === "sort" && value === "name")));
  history.replaceState(null, "", hash.size ? `#${hash}` : location.pathname + location.search);
  for (const card of cards.values()) card.remove();
  cards = new Map();
  refresh();
  const start = $("cards").getBoundingClientRect().top + scrollY - $("tools").offsetHeight;
  if (scrollY > start) scrollTo(0, start);
}

function follow() {
  const hash = new URLSearchParams(location.hash.slice(1));
  for (const name of Object.keys(view)) view[name] = hash.get(name) ?? "";
  for (const [id, name, usual] of [["state", "state", ""], ["sort", "sort", "name"]]) {
    if (![...$(id).options].some((option) => option.value === view[name])) view[name] = usual;
    $(id).value = view[name];
  }
  $("text").value = view.q;
  refresh();
}

function begin() {
  if (!globalThis.mitsvbrdfLibrary) {
    $("none").hidden = false;
    $("none").textContent = `The file ${DATA}, which belongs beside this page, is missing or broken.`;
    return;
  }
  take(mitsvbrdfLibrary);
  follow();
  $("text").addEventListener("input", () => ask({ q: $("text").value }));
  $("tools").addEventListener("submit", (event) => event.preventDefault());
  for (const id of ["state", "sort"]) $(id).addEventListener("change", () => ask({ [id]: $(id).value }));
  $("down").addEventListener("click", () => ask({ down: view.down ? "" : "1" }));
  $("details").addEventListener("click", (event) => { if (event.target === $("details")) $("details").close(); });
  addEventListener("scroll", () => { frame ||= requestAnimationFrame(draw); }, { passive: true });
  addEventListener("resize", measure);
  addEventListener("hashchange", follow);
}
